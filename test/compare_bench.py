"""Position-triggered outputs of EPOS2 and Copley axes on one simulated bus, in simulated time.

The driver's way: frames go to the group, then to the outputs; SDO jobs run one after another.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import Future

from simulated_time import Bench

from epos2_ros.bus.sdo_jobs import perform, read_position, write_all
from epos2_ros.configuration.driver import AxisConfig, DriverConfig
from epos2_ros.configuration.outputs import CompareConfig
from epos2_ros.errors import DriveError
from epos2_ros.protocol import epos2
from epos2_ros.protocol.outputs.outputs import OutputEvent, Outputs
from epos2_ros.protocol.path_watch import PathWatch, ProfilePathWatch, RecordPathWatch
from epos2_ros.sim.copley import Copley
from epos2_ros.sim.epos2 import Epos2


class CompareBench(Bench):
    """Axes of both families in one group, with their outputs."""

    def __init__(
        self,
        config: DriverConfig,
        outputs: Sequence[CompareConfig],
        drives: Sequence[Epos2 | Copley],
    ) -> None:
        self.fired: list[OutputEvent] = []
        self.notices: list[str] = []
        super().__init__(config, drives, bring_up=False)  # type: ignore[arg-type]
        group, machine = self.group, self.machine
        by_joint: dict[str, PathWatch] = {
            axis.drive.joint: RecordPathWatch(group, axis) for axis in machine.interpolated.axes
        }
        by_joint = {drive.joint: ProfilePathWatch(drive) for drive in machine.drives} | by_joint
        self.outputs = Outputs(config.axes, outputs, [by_joint[axis.joint] for axis in config.axes])
        self.sdo = [node.node for node in self.nodes]
        self.bring_up()

    def bring_up(self) -> None:
        for index, node in enumerate(self.sdo):
            self.bring_up_drive(index)
            if self.outputs.on_axis(index):
                write_all(node, self.outputs.arm(index, read_position(node)))
        self.group.start_clock(self.now_us, bytes(6))
        self._flush()

    def move(self, seconds: float = 60.0, **targets: float) -> float:
        """Copley joints to positions [unit], each within its own limits; the start SYNC's time."""
        self.wait(self.start(**targets), seconds)
        return self.started_us

    def start(self, **targets: float) -> Future[object]:
        return self.machine.move_to(targets)

    @property
    def started_us(self) -> float:
        """When the SYNC was on the bus that started the last move."""
        starts = [t for t, frame, echo in self.frames if frame.can_id & 0x780 == epos2.RPDO2]
        return min(
            t for t, frame, _ in self.frames if frame.can_id == epos2.SYNC and t > starts[-1]
        )

    def of(self, name: str) -> list[OutputEvent]:
        return [event for event in self.fired if event.name == name]

    # ------------------------------------------------------------------ inside

    def _step(self) -> None:
        super()._step()
        self._flush()
        while self.outputs.jobs:
            job = self.outputs.jobs.popleft()
            try:
                answer = perform(self.sdo[job.axis], job, lambda: self.now_us)
            except DriveError as error:
                self.outputs.failed(job, str(error))
            else:
                self.outputs.answered(job, *answer)

    @property
    def _deadline_us(self) -> float:
        soon = self.now_us + 20_000 if self.outputs.jobs else math.inf
        return min(super()._deadline_us, soon)

    def _flush(self) -> None:
        super()._flush()
        self.fired.extend(self.outputs.events)
        self.outputs.events.clear()
        self.notices.extend(self.outputs.notices)
        self.outputs.notices.clear()

    def _on_frame(self, can_id: int, data: bytes, t_us: float, echo: bool) -> bool:
        due = super()._on_frame(can_id, data, t_us, echo)
        _, frame, _ = self.frames[-1]
        self.outputs.receive(frame, self.stamp_us(t_us), echo)
        self._flush()
        return due


def copley_axis(joint: str = "x", node_id: int = 1, **changes: object) -> AxisConfig:
    """0.5 µm a count, 0.2 m/s, 1 m/s², as gantry_x of the raster scan."""
    settings: dict[str, object] = {
        "drive": "copley", "type": "prismatic", "counts_per_turn": 2000, "gear_ratio": 100.0,
        "lead": 0.1, "max_velocity": 0.2, "max_acceleration": 1.0, **changes,
    }  # fmt: skip
    return AxisConfig(joint, node_id, **settings)  # type: ignore[arg-type]
