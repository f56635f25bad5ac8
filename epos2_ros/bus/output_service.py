"""The position-triggered outputs of a bus at work.

The owner's thread (the reactor) calls everything but `arm` and `reconfigure`. These do SDO, so they
run on `worker`, as all SDO does: canopen's client of a node does one thing at a time. What comes
back from there comes by `post`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor

import canopen

from epos2_ros.bus.sdo_jobs import perform, read_position, write_all
from epos2_ros.bus.timestamps import now_us
from epos2_ros.compare_config import CompareConfig
from epos2_ros.config import AxisConfig
from epos2_ros.errors import DriveError
from epos2_ros.protocol.frame import Frame
from epos2_ros.protocol.group import Group
from epos2_ros.protocol.outputs import OutputEvent, Outputs, SdoJob
from epos2_ros.protocol.path_watch import PathWatch, ProfilePathWatch, RecordPathWatch
from epos2_ros.protocol.profile_axes import ProfileAxes

Job = Callable[[], None]


class OutputService:
    """ConfigurationError for what the drives of `axes` can't do."""

    def __init__(
        self,
        axes: Sequence[AxisConfig],
        configs: Sequence[CompareConfig],
        group: Group,
        profile: ProfileAxes,
        worker: Executor,
        post: Callable[[Job], None],
        on_event: Callable[[OutputEvent], None],
        on_notice: Callable[[str], None],
    ) -> None:
        watches: dict[str, PathWatch] = {
            axis.joint: RecordPathWatch(group, index) for index, axis in enumerate(group.axes)
        }
        watches |= {axis.joint: ProfilePathWatch(axis) for axis in profile.axes}
        self.protocol = Outputs(axes, configs, [watches[axis.joint] for axis in axes])
        self._joints = [axis.joint for axis in axes]
        self._nodes: list[canopen.RemoteNode] = []
        self._worker = worker
        self._post = post
        self._on_event = on_event
        self._on_notice = on_notice

    def open(self, nodes: Mapping[str, canopen.RemoteNode]) -> None:
        """A bus has been opened; by joint, the nodes on it."""
        self._nodes = [nodes[joint] for joint in self._joints]

    def arm(self, joint: str, call: Callable[[Callable[[], object]], object]) -> None:
        """Set the outputs of a drive that has just been configured and stands.

        On the worker; `call` runs in the owner's thread. DriveError if the drive refuses.
        """
        index = self._joints.index(joint)
        if self.protocol.on_axis(index):
            position = read_position(self._nodes[index])
            write_all(self._nodes[index], call(lambda: self.protocol.arm(index, position)))  # type: ignore[arg-type]

    def reconfigure(self, config: CompareConfig, call: Callable[[Job], None]) -> None:
        """An output gets other parameters while its axis stands; ConfigurationError if it can't.

        On the worker; `call` runs in the owner's thread.
        """
        index = self._joints.index(config.joint)
        position = read_position(self._nodes[index])
        call(lambda: self.protocol.reconfigure(config, position))

    # ------------------------------------------------------------------ the owner's thread

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
            self._worker.submit(self._perform, self.protocol.jobs.popleft())

    def _perform(self, job: SdoJob) -> None:
        try:
            answer = perform(self._nodes[job.axis], job, now_us)
        except DriveError as refusal:
            reason = str(refusal)
            self._post(lambda: self.protocol.failed(job, reason))
        else:
            self._post(lambda: self.protocol.answered(job, *answer))
