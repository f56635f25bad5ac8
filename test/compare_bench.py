"""Position-triggered outputs of EPOS2 and Copley axes on one simulated bus, in simulated time.

The driver's way: frames go to the group, to the axes in profile position mode, then to the
outputs; SDO jobs run one after another.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Future
from dataclasses import replace

from simulated_time import Bench

from epos2_ros.bus.copley import CopleyNode, CopleySettings
from epos2_ros.bus.sdo_jobs import perform, read_position, write_all
from epos2_ros.compare_config import CompareConfig
from epos2_ros.config import AxisConfig, DriverConfig
from epos2_ros.errors import DriveError
from epos2_ros.motion.trapezoid import Trapezoid, in_step
from epos2_ros.motion.units import AxisUnits
from epos2_ros.protocol import epos2
from epos2_ros.protocol.outputs import OutputEvent, Outputs
from epos2_ros.protocol.path_watch import PathWatch, ProfilePathWatch, RecordPathWatch
from epos2_ros.protocol.profile_axes import ProfileAxes
from epos2_ros.sim.copley import Copley
from epos2_ros.sim.epos2 import Epos2


class CompareBench(Bench):
    """The EPOS2 axes of `config` in the group, the Copley axes beside it."""

    def __init__(
        self,
        config: DriverConfig,
        outputs: Sequence[CompareConfig],
        drives: Sequence[Epos2 | Copley],
    ) -> None:
        self.all_axes = config.axes
        in_group = tuple(axis for axis in config.axes if axis.drive == "epos2")
        copley = [axis for axis in config.axes if axis.drive == "copley"]
        self.fired: list[OutputEvent] = []
        self.notices: list[str] = []
        self.profile = ProfileAxes([(axis.joint, axis.node_id) for axis in copley])
        super().__init__(replace(config, axes=in_group), drives, bring_up=False)  # type: ignore[arg-type]
        self.copley_nodes = [CopleyNode(self.network, CopleySettings.of(axis)) for axis in copley]
        by_joint: dict[str, PathWatch] = {
            axis.joint: RecordPathWatch(self.group, n) for n, axis in enumerate(in_group)
        }
        by_joint |= {axis.joint: ProfilePathWatch(axis) for axis in self.profile.axes}
        self.outputs = Outputs(config.axes, outputs, [by_joint[axis.joint] for axis in config.axes])
        nodes = {node.settings.joint: node.node for node in [*self.nodes, *self.copley_nodes]}
        self.sdo = [nodes[axis.joint] for axis in config.axes]
        self.bring_up()

    def bring_up(self) -> None:
        for index, node in enumerate(self.copley_nodes):
            self.profile.reconfigured(index, node.configure(), self.now_us)
        for index, node in enumerate(self.nodes):
            self.group.reconfigured(index, node.configure(), self.now_us)
        for index, node in enumerate(self.sdo):
            if self.outputs.on_axis(index):
                write_all(node, self.outputs.arm(index, read_position(node)))
        self.group.start_clock(self.now_us, bytes(6))
        self.profile.start_watch(self.now_us)
        self._flush()

    def enable(self) -> None:
        super().enable()
        self.wait(self.profile.enable(), 5.0)

    def move(self, seconds: float = 60.0, **targets: float) -> float:
        """Copley joints to positions [unit], each within its own limits; the start SYNC's time."""
        self.wait(self.start(**targets), seconds)
        return self.started_us

    def start(self, **targets: float) -> Future[None]:
        moves: dict[str, Trapezoid] = {}
        for axis in self.profile.axes:
            config = next(c for c in self.all_axes if c.joint == axis.joint)
            units = AxisUnits.of(config)
            if axis.joint not in targets:
                continue
            assert axis.position_qc is not None
            assert config.max_velocity is not None
            assert config.max_acceleration is not None
            moves[axis.joint] = Trapezoid(
                float(axis.position_qc),
                units.to_qc(targets[axis.joint]),
                abs(units.to_qc_s(config.max_velocity)),
                abs(units.to_qc_s(config.max_acceleration)),
            )
        together = dict(zip(moves, in_step(list(moves.values())), strict=True))
        return self.profile.move([together.get(axis.joint) for axis in self.profile.axes])

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
        self.profile.advance(self.now_us)
        self._flush()
        while self.profile.writing:
            index, writes = self.profile.writing.popleft()
            write_all(self.copley_nodes[index].node, writes)
            self.profile.written(index)
        while self.outputs.jobs:
            job = self.outputs.jobs.popleft()
            try:
                answer = perform(self.sdo[job.axis], job, lambda: self.now_us)
            except DriveError as error:
                self.outputs.failed(job, str(error))
            else:
                self.outputs.answered(job, *answer)

    def run(self, seconds: float, until=lambda: False) -> None:  # type: ignore[no-untyped-def]
        end_us = self.now_us + seconds * 1e6
        while self.now_us < end_us and not until():
            self._step()
            due = min(
                end_us,
                self.group.deadline_us,
                self.transmitter.deadline_us,
                self.profile.deadline_us,
                self.now_us + 20_000 if self.outputs.jobs else end_us,
            )
            self.bus.run_until(max(due, self.now_us), self._on_frame)
            self._step()

    def _flush(self) -> None:
        while self.profile.outbox:
            self.transmitter.push(self.profile.outbox.popleft())
        super()._flush()
        self.fired.extend(self.outputs.events)
        self.outputs.events.clear()
        self.notices.extend(self.outputs.notices)
        self.outputs.notices.clear()

    def _on_frame(self, can_id: int, data: bytes, t_us: float, echo: bool) -> None:
        super()._on_frame(can_id, data, t_us, echo)
        _, frame, _ = self.frames[-1]
        t_us = self.stamp_us(t_us)
        self.profile.receive(frame, t_us, echo)
        self.outputs.receive(frame, t_us, echo)
        self.profile.advance(self.now_us)
        self._flush()


def copley_axis(joint: str = "x", node_id: int = 1, **changes: object) -> AxisConfig:
    """0.5 µm a count, 0.2 m/s, 1 m/s², as gantry_x of the raster scan."""
    settings: dict[str, object] = {
        "drive": "copley", "type": "prismatic", "counts_per_turn": 2000, "gear_ratio": 100.0,
        "lead": 0.1, "max_velocity": 0.2, "max_acceleration": 1.0, **changes,
    }  # fmt: skip
    return AxisConfig(joint, node_id, **settings)  # type: ignore[arg-type]
