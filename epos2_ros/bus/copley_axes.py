"""The Copley axes of a bus at work: brought up, enabled, moved in step, stopped.

The reactor's thread calls everything but `bring_up`, which does SDO and so runs on the worker.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Future
from functools import partial

from epos2_ros.bus.copley import CopleyNode, CopleySettings
from epos2_ros.bus.link import Network
from epos2_ros.bus.reactor import Reactor
from epos2_ros.bus.sdo_jobs import write_all
from epos2_ros.bus.timestamps import now_us
from epos2_ros.bus.worker import Worker
from epos2_ros.config import AxisConfig
from epos2_ros.errors import DriveError
from epos2_ros.motion.move import moves
from epos2_ros.protocol.frame import Frame
from epos2_ros.protocol.profile_axes import ProfileAxes
from epos2_ros.protocol.sdo import SdoWrite


class CopleyAxes:
    """All axes of `configs`, which are those with `drive: copley`.

    ConfigurationError for what their drives can't hold.
    """

    def __init__(self, configs: Sequence[AxisConfig], worker: Worker, reactor: Reactor) -> None:
        self.configs = tuple(configs)
        self.protocol = ProfileAxes([(axis.joint, axis.node_id) for axis in configs])
        self.nodes: list[CopleyNode] = []
        self._settings = [CopleySettings.of(axis) for axis in configs]
        self._worker = worker
        self._reactor = reactor

    def open(self, network: Network) -> None:
        """A bus has been opened."""
        self.nodes = [CopleyNode(network, settings) for settings in self._settings]

    def bring_up(self, index: int) -> None:
        """Configure a drive, on the worker."""
        statusword = self.nodes[index].configure()
        self._reactor.call(lambda: self.protocol.reconfigured(index, statusword, now_us()))

    def move_to(self, targets: Mapping[str, float], duration_s: float = 0.0) -> Future[None]:
        """Start for these positions [unit], leaving and arriving together.

        As fast as the slowest axis can, or in `duration_s` if that is longer. TrajectoryError for
        a joint that is not one of these, a target outside the limits, or axes that don't stand.
        """
        standing = {axis.joint: axis.position_qc for axis in self.protocol.axes}
        together = moves(self.configs, standing, targets, duration_s)
        return self.protocol.move([together.get(axis.joint) for axis in self.protocol.axes])

    # ------------------------------------------------------------------ frames and time

    def receive(self, frame: Frame, t_us: float, echo: bool) -> None:
        """Take in a frame."""
        self.protocol.receive(frame, t_us, echo)

    def advance(self, now: float) -> float:
        """Do what is due; when it is wanted next."""
        self.protocol.advance(now)
        while self.protocol.writing:
            index, writes = self.protocol.writing.popleft()
            self._worker.post(partial(self._write, index, writes))
        return self.protocol.deadline_us

    def _write(self, index: int, writes: Sequence[SdoWrite]) -> None:
        try:
            write_all(self.nodes[index].node, writes)
            error = ""
        except DriveError as refusal:
            error = str(refusal)
        self._reactor.post(lambda: self.protocol.written(index, error))
