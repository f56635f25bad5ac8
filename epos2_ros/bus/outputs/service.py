"""The position-triggered outputs of a bus at work.

The reactor's thread calls everything but `arm` and `reconfigure`. These do SDO, so they run on the
worker, as all SDO does.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial

from epos2_ros.bus.reactor import Reactor
from epos2_ros.bus.sdo_client import RemoteNode
from epos2_ros.bus.sdo_jobs import perform, read_position, write_all
from epos2_ros.bus.timestamps import now_us
from epos2_ros.bus.worker import Worker
from epos2_ros.configuration.driver import AxisConfig
from epos2_ros.configuration.outputs import CompareConfig
from epos2_ros.errors import DriveError
from epos2_ros.protocol.frame import Frame
from epos2_ros.protocol.machine import Machine
from epos2_ros.protocol.outputs.outputs import OutputEvent, Outputs, SdoJob
from epos2_ros.protocol.path_watch import PathWatch, ProfilePathWatch, RecordPathWatch


class OutputService:
    """ConfigurationError for what the drives of `axes` can't do."""

    def __init__(
        self,
        axes: Sequence[AxisConfig],
        configs: Sequence[CompareConfig],
        machine: Machine,
        worker: Worker,
        reactor: Reactor,
        on_event: Callable[[OutputEvent], None],
        on_notice: Callable[[str], None],
    ) -> None:
        watches: dict[str, PathWatch] = {
            axis.drive.joint: RecordPathWatch(machine.group, axis)
            for axis in machine.interpolated.axes
        }
        watches = {d.joint: ProfilePathWatch(d) for d in machine.drives} | watches
        self.protocol = Outputs(axes, configs, [watches[axis.joint] for axis in axes])
        self._joints = [axis.joint for axis in axes]
        self._nodes: list[RemoteNode] = []
        self._worker = worker
        self._reactor = reactor
        self._on_event = on_event
        self._on_notice = on_notice

    def open(self, nodes: Mapping[str, RemoteNode]) -> None:
        """A bus has been opened; by joint, the nodes on it."""
        self._nodes = [nodes[joint] for joint in self._joints]

    # ------------------------------------------------------------------ on the worker

    def arm(self, joint: str) -> None:
        """Set the outputs of a drive that has just been configured and stands.

        DriveError if the drive refuses.
        """
        axis = self._joints.index(joint)
        if self.protocol.on_axis(axis):
            node = self._nodes[axis]
            position = read_position(node)
            writes = self._reactor.call(lambda: self.protocol.arm(axis, position))
            try:
                write_all(node, writes)
            except DriveError as error:
                raise DriveError(
                    f"the outputs of {joint} can't be set as configured (pin, positions, "
                    f"capacity): {error}"
                ) from error

    def disarm(self, joint: str) -> None:
        """Switch the outputs of a drive off, whose positions are about to change; then `arm`."""
        axis = self._joints.index(joint)
        if self.protocol.on_axis(axis):
            write_all(self._nodes[axis], self._reactor.call(lambda: self.protocol.disarm(axis)))

    def reconfigure(self, config: CompareConfig) -> None:
        """An output gets other parameters while its axis stands.

        ConfigurationError if it can't, DriveError if the drive refuses; it is then as before.
        """
        axis, before = self._reactor.call(lambda: self.protocol.find(config.name))
        try:
            self._configure(axis, config)
        except DriveError:
            self._configure(axis, before)
            raise

    def _configure(self, axis: int, config: CompareConfig) -> None:
        node = self._nodes[axis]
        position = read_position(node)
        write_all(node, self._reactor.call(lambda: self.protocol.reconfigure(config, position)))

    # ------------------------------------------------------------------ in the reactor's thread

    def receive(self, frame: Frame, t_us: float, echo: bool) -> None:
        """Take in a frame, after the axes have."""
        self.protocol.receive(frame, t_us, echo)
        self.flush()

    def flush(self) -> None:
        """Pass on what has come up."""
        while self.protocol.events:
            self._on_event(self.protocol.events.popleft())
        while self.protocol.notices:
            self._on_notice(self.protocol.notices.popleft())
        while self.protocol.jobs:
            self._worker.post(partial(self._perform, self.protocol.jobs.popleft()))

    def _perform(self, job: SdoJob) -> None:
        try:
            answer = perform(self._nodes[job.axis], job, now_us)
        except DriveError as refusal:
            reason = str(refusal)
            self._reactor.post(lambda: self.protocol.failed(job, reason))
        else:
            self._reactor.post(lambda: self.protocol.answered(job, *answer))
