"""The driver at work: one bus, one group of axes, real time.

The reactor's thread owns group, path and link; frames, requests and deadlines all come to it as
jobs. What blocks (SDO) runs on a worker, so that feeding never waits for an answer.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures import TimeoutError as FutureTimeoutError
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TypeVar

from epos2_ros.bus.copley_axes import CopleyAxes
from epos2_ros.bus.epos2 import Epos2Node
from epos2_ros.bus.health import Health
from epos2_ros.bus.link import Link
from epos2_ros.bus.output_service import OutputService
from epos2_ros.bus.predictor import Predictor
from epos2_ros.bus.reactor import Reactor
from epos2_ros.bus.settings import axis_setup, drive_settings, group_settings
from epos2_ros.bus.simulation import Simulation
from epos2_ros.bus.snapshot import AxisSnapshot, OutputSnapshot, Snapshot
from epos2_ros.bus.supervisor import Supervisor
from epos2_ros.bus.timestamps import now_us, wall_offset_us
from epos2_ros.bus.tracking import Tracking, tracked
from epos2_ros.bus.worker import Worker
from epos2_ros.buslog import inputs
from epos2_ros.buslog.plain import to_plain
from epos2_ros.buslog.writer import LogWriter
from epos2_ros.compare_config import CompareConfig
from epos2_ros.config import AxisConfig, DriverConfig
from epos2_ros.errors import (
    ConfigurationError,
    DriveError,
    MotionAborted,
    TrajectoryError,
)
from epos2_ros.motion.move import refuse_trajectory
from epos2_ros.motion.reference import Reference
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.motion.units import AxisUnits
from epos2_ros.protocol.clock import time_of_day
from epos2_ros.protocol.epos2 import BUFFER_SIZE
from epos2_ros.protocol.execution import Execution
from epos2_ros.protocol.frame import Frame
from epos2_ros.protocol.group import IN_MOTION, Event, Group, Phase
from epos2_ros.protocol.intake import Rejects, Reporter, intake_of
from epos2_ros.protocol.outputs import OutputEvent
from epos2_ros.protocol.path import PathCommander, Placement, refuse_ended
from epos2_ros.protocol.profile_axes import IN_MOTION as IN_PROFILE_MOTION
from epos2_ros.protocol.profile_axes import Phase as ProfilePhase
from epos2_ros.protocol.timekeeper import HOST_NODE_ID, Timekeeper
from epos2_ros.protocol.trace import Trace

T = TypeVar("T")

REQUEST_TIMEOUT_S = 30.0  # the group's own limits are shorter; this one guards the wait
IDLE_US = 100_000.0


class Driver:
    """All drives on one bus. All methods are thread-safe and bounded in time."""

    def __init__(
        self,
        config: DriverConfig,
        on_event: Callable[[Event], None] = lambda event: None,
        on_output: Callable[[OutputEvent], None] = lambda event: None,
        on_trace: Callable[[str], None] | None = None,
    ) -> None:
        self._all_axes = config.axes
        # The group moves in interpolated position mode; the others beside it.
        config = replace(config, axes=tuple(a for a in config.axes if a.drive == "epos2"))
        self._config = config
        self._on_event = on_event
        self._supervisor = Supervisor(self._fail)
        self._reactor = Reactor(self._step, partial(self._supervisor.broke, "the driver's thread"))
        self._units = [AxisUnits.of(axis) for axis in config.axes]
        self._simulation: Simulation | None = None
        self._link: Link | None = None
        self._log: LogWriter | None = None
        self._nodes: list[Epos2Node] = []
        self._brought_up = False  # all drives, since the link was opened
        self._doubtful = False  # something of ours has raised: what it knows may be half of it
        self._stops = 0  # how often motions were ended on request, those not yet begun included
        settings = group_settings(config)
        self._producer = settings.sync_producer
        self._group = Group([axis_setup(axis) for axis in config.axes], settings)
        self._path = PathCommander(self._group, config)
        self._worker = Worker(partial(self._supervisor.broke, "SDO"))
        self._announcer = ThreadPoolExecutor(1, thread_name_prefix="events")
        copley = [axis for axis in self._all_axes if axis.drive == "copley"]
        self._copley = CopleyAxes(copley, self._worker, self._reactor)
        self._outputs = OutputService(
            self._all_axes,
            config.outputs,
            self._group,
            self._copley.protocol,
            self._worker,
            self._reactor,
            partial(self._announce, on_output),
            self._warn,
        )
        self._trace: Trace | None = None
        if on_trace is not None:  # every step, for whoever looks for what is wrong
            listener = on_trace
            self._trace = Trace(
                self._group,
                self._copley.protocol,
                lambda line: self._announce(listener, line),
            )
        self._predictor = Predictor(
            [axis.joint for axis in self._all_axes],
            self._group,
            self._copley.protocol,
            self._outputs.protocol,
            self._reactor,
            self._warn,
            self._supervisor,
        )
        self._rejects = Rejects()

    # ------------------------------------------------------------------ life

    def configure(self) -> None:
        """Open the bus, bring every drive up, start TIME, SYNC and heartbeat.

        Raises ConfigurationError, BusError or DriveError; the bus is closed again then.
        """
        try:
            self._configure()
        except Exception as error:
            self._note("configure_failed", str(error))
            self.close()
            raise

    def _configure(self) -> None:
        for axis in self._all_axes:
            if axis.drive not in ("epos2", "copley"):
                raise ConfigurationError(
                    f"axes.{axis.joint}.drive is {axis.drive!r}; it must be epos2 or copley"
                )
            if axis.node_id == HOST_NODE_ID:
                raise ConfigurationError(
                    f"axes.{axis.joint}.node_id is {HOST_NODE_ID}, which the host's heartbeat "
                    f"has; it must be from 1 to {HOST_NODE_ID - 1}"
                )
            if axis.homing is not None:
                raise ConfigurationError(
                    f"axes.{axis.joint}.homing is given, but homing is not offered yet; leave it "
                    "out, and home the drive with its maker's tool"
                )
        shortest_s = Timekeeper.shortest_period_us(len(self._config.axes)) / 1e6
        if self._producer is not None and self._config.sync_period < shortest_s:
            raise ConfigurationError(
                f"sync.period is {self._config.sync_period:g} s; with SYNC from a drive "
                f"(sync.producer) {len(self._config.axes)} axes need at least {shortest_s:g} s"
            )
        if self._config.log_file is not None:
            self._open_log(Path(self._config.log_file).expanduser())
        if self._config.simulate:
            self._simulation = Simulation(self._config, self._copley.configs)
        self._reactor.start()
        self._open()
        self._bring_up(range(len(self._nodes)), range(len(self._copley.nodes)))

    def _open_log(self, file: Path) -> None:
        config = replace(self._config, axes=self._all_axes)
        size_bytes = round(config.log_size * 1e6)
        preamble = (("configuration", to_plain(config)),)
        self._log = LogWriter(file, size_bytes, now_us(), wall_offset_us, self._warn, preamble)
        inputs.record(self._group, self._path, self._log, now_us)

    def _open(self) -> None:
        config = self._config
        self._brought_up = self._doubtful = False
        axes: list[Reporter] = [*self._group.axes, *self._copley.protocol.axes]
        self._link = Link(
            config.interface,
            config.channel,
            config.bitrate,
            intake_of(axes, self._rejects),
            self._on_frame,
            self._group.fail,
            self._on_failure,
            self._reactor.post,
            self._on_other,
        )
        self._nodes = [
            Epos2Node(self._link.network, drive_settings(axis, config)) for axis in config.axes
        ]
        self._copley.open(self._link.network)
        nodes = {node.settings.joint: node.node for node in self._nodes}
        nodes |= {node.settings.joint: node.node for node in self._copley.nodes}
        self._outputs.open(nodes)

    def _bring_up(self, indices: Iterable[int], copley: Iterable[int]) -> None:
        for index in indices:
            self._worker.run(partial(self._bring_up_epos2, index))
        for index in copley:
            self._worker.run(partial(self._bring_up_copley, index))
        self._reactor.call(self._start_clock)
        self._produce_sync(round(self._config.sync_period * 1e6))
        self._brought_up = True

    def _produce_sync(self, period_us: int) -> None:
        if self._producer is not None:
            node = self._nodes[self._producer]
            self._worker.run(lambda: node.produce_sync(period_us))

    def _start_clock(self) -> None:
        now = now_us()
        self._group.start_clock(now, time_of_day(time.time()))
        self._copley.protocol.start_watch(now)

    def _bring_up_epos2(self, index: int) -> None:
        statusword = self._nodes[index].configure()
        self._reactor.call(lambda: self._group.reconfigured(index, statusword, now_us()))
        self._outputs.arm(self._nodes[index].settings.joint)

    def _bring_up_copley(self, index: int) -> None:
        self._copley.bring_up(index)
        self._outputs.arm(self._copley.configs[index].joint)

    def close(self) -> None:
        """Close the bus. Drives that are still enabled stop on the host's missing heartbeat."""
        if self._brought_up and self._link is not None and not self._link.failed:
            self._brought_up = False
            try:
                self._switch_off()
                self._produce_sync(0)
            except DriveError as error:
                self._warn(str(error))
        self._worker.close()
        self._reactor.stop()
        if self._log is not None:
            self._log.close()
        self._predictor.close()
        self._announcer.shutdown()
        if self._link is not None:
            self._link.close()
        if self._simulation is not None:
            self._simulation.close()

    def _switch_off(self) -> None:
        """Nothing is left enabled behind a closed bus: axes that still are stop at once."""
        group, profile = self._group, self._copley.protocol
        if self._reactor.call(lambda: group.phase is not Phase.DISABLED):
            self._wait_for("quick stop", group.quick_stop)
            self._wait_for("disable", group.disable)
        if self._reactor.call(lambda: profile.phase is not ProfilePhase.DISABLED):
            self._wait_for("quick stop", profile.quick_stop)
            self._wait_for("disable", profile.disable)

    # ------------------------------------------------------------------ requests

    def enable(self) -> None:
        """Every axis to "operation enabled", holding. DriveError says which axis is where."""
        self._wait_for("enable", self._group.enable, self._copley.protocol.enable)

    def disable(self) -> None:
        """Stop on the path, then switch every axis off; what has not begun does not begin.

        Axes that don't come to rest in time on their path are halted.
        """
        self._stops += 1
        profile = self._copley.protocol
        off = self._reactor.call(self._path.disable)
        self._wait_for("halt", profile.halt)
        try:
            off.result(REQUEST_TIMEOUT_S)
        except FutureTimeoutError:
            self._reactor.call(self._group.halt)
            self._wait(off, "disable")
        self._wait_for("disable", profile.disable)

    @property
    def trajectory_axes(self) -> tuple[AxisConfig, ...]:
        """Those that follow trajectories."""
        return self._config.axes

    def check(self, trajectory: Trajectory) -> None:
        """TrajectoryError for what can't be meant: its joints, or an end in the past."""
        refuse_trajectory(self._copley.configs, trajectory.joint_names)
        joints = [axis.joint for axis in self._config.axes]
        trajectory.axes(joints, self._config.allow_partial_joints_goal)
        refuse_ended(trajectory, _start_us(trajectory), now_us())

    def submit(self, trajectory: Trajectory) -> Execution | None:
        """Run a trajectory, or stop on the path if it has no points. TrajectoryError: refused."""
        refuse_trajectory(self._copley.configs, trajectory.joint_names)
        if not len(trajectory.times_s):
            self._reactor.call(self._stop_path)
            return None
        start_us, execution = _start_us(trajectory), Execution()
        lead_ms, stops = 0, self._stops
        while True:
            begun_us = now_us()
            placement = self._reactor.call(
                partial(self._path.place, trajectory, start_us, begun_us, lead_ms)
            )
            try:
                reference = placement.join()
            except TrajectoryError as error:
                self._note("refused", str(error))
                raise
            if self._reactor.call(partial(self._commit, placement, reference, execution, stops)):
                return execution
            lead_ms = round((now_us() - begun_us) / 500)  # twice as long as it took

    def cancel(self, execution: Execution, reason: str) -> None:
        """Stop on the path, if it is this trajectory that the axes follow or wait for."""
        self._reactor.call(lambda: self._cancel(execution, reason))

    def track(self) -> Tracking:
        """What the axes that follow trajectories are to do, and do."""
        return self._reactor.call(
            lambda: tracked(self._group, self._path, self._units, self._config, now_us())
        )

    def move_to(self, targets: Mapping[str, float], duration_s: float = 0.0) -> None:
        """Axes in profile position mode to positions [unit], leaving and arriving together.

        Returns when they have left. TrajectoryError: refused.
        """
        self._reactor.call(lambda: self._move_to(targets, duration_s))

    def set_positions(self, output: str, positions: Sequence[float]) -> None:
        """A series gets other positions [unit]; ConfigurationError if it can't."""
        self._reactor.call(lambda: self._outputs.protocol.set_positions(output, positions))

    def set_output(self, config: CompareConfig) -> None:
        """An output gets other parameters. ConfigurationError if it can't, or while axes move;
        DriveError if the drive refuses. It is then as before.
        """
        if not self._reactor.call(self._standing):
            raise ConfigurationError(
                f"compare.{config.name} can't change while the axes move, except for positions"
            )
        self._worker.run(partial(self._outputs.reconfigure, config))

    def stop_on_path(self) -> None:
        """All axes slow down together along the commanded path; returns when they stand.

        What has not begun does not begin.
        """
        motion = self._reactor.call(self._stop_path)
        if motion is not None:
            try:
                self._wait(motion, "stop")
            except MotionAborted as error:
                raise DriveError(str(error)) from error

    def halt(self) -> None:
        """Each axis stops at once on its own ramp, off the path, and holds."""
        self._stops += 1
        self._wait_for("halt", self._group.halt, self._copley.protocol.halt)

    def quick_stop(self) -> None:
        """Each axis stops on its quick stop ramp and leaves "operation enabled"."""
        self._stops += 1
        stops = self._group.quick_stop, self._copley.protocol.quick_stop
        self._wait_for("quick stop", *stops)

    def reset_fault(self) -> None:
        """Reopen a bus that failed, bring restarted or lost drives up again, reset every fault.

        After an internal error all begins anew. The axes stay off.
        """
        lost = self._reactor.call(self._group.lost_axes)
        lost_copley = self._reactor.call(self._copley.protocol.lost_axes)
        sound = self._link is not None and not self._link.failed and self._brought_up
        if self._link is not None and (not sound or self._doubtful):
            self._link.close()
            self._open()
            lost = list(range(len(self._nodes)))
            lost_copley = list(range(len(self._copley.nodes)))
        if lost or lost_copley:
            self._bring_up(lost, lost_copley)
        resets = self._group.reset_fault, self._copley.protocol.reset_fault
        self._wait_for("reset fault", *resets)

    def snapshot(self) -> Snapshot:
        """Everything the topics show."""
        return self._reactor.call(self._snapshot)

    # ------------------------------------------------------------------ inside

    def _snapshot(self) -> Snapshot:
        path_ms = self._group.path_ms(now_us())
        if self._group.phase not in IN_MOTION:
            path_ms = math.inf
        link = self._link
        health = link.health if link else Health()
        axes = [self._axis_snapshot(index, path_ms) for index in range(len(self._units))]
        by_joint = {axis.joint: axis for axis in [*axes, *self._copley_snapshots()]}
        state, reason = self._state()
        return Snapshot(
            axes=tuple(by_joint[axis.joint] for axis in self._all_axes),
            outputs=self._output_snapshots(),
            state=state,
            reason=reason,
            bus_load=link.load if link else 0.0,
            sync_count=self._group.time.sync_count,
            sync_time_source=self._sync_time_source(),
            dropped_frames=link.dropped if link else 0,
            error_frames=health.error_frames,
            refused_frames=link.refused if link else 0,
            bus_state=health.state.value,
            transmit_errors=health.transmit_errors,
            receive_errors=health.receive_errors,
            start_error_us=self._group.start_error_us,
            simulated=self._config.simulate,
            rejected=dict(self._rejects.counts),
            internal_errors=self._supervisor.mistakes,
        )

    def _sync_time_source(self) -> str:
        if self._link is None:
            return ""
        if self._producer is None:
            return self._link.time_source
        return f"received from {self._config.sync_producer}, {self._link.clock.source}"

    def _axis_snapshot(self, index: int, path_ms: float | None) -> AxisSnapshot:
        axis, units, clock = self._group.axes[index], self._units[index], self._group.time.clock
        nan = math.nan
        known = axis.position_qc is not None
        position_qc = float(axis.position_qc or 0)
        return AxisSnapshot(
            joint=axis.joint,
            node_id=axis.node_id,
            state=axis.state.value,
            position=units.from_qc(position_qc) if known else nan,
            velocity=units.from_velocity_units(float(axis.velocity)) if known else nan,
            effort=nan if axis.current_ma is None else axis.current_ma / 1000,
            stamp_us=axis.measured_us(1e6 / self._config.state_rate),
            used=axis.account.level(path_ms),
            free=BUFFER_SIZE - axis.account.level(path_ms),
            size=BUFFER_SIZE,
            buffered_ms=max(0.0, axis.account.ahead_ms(path_ms)),
            status_word=axis.buffer_status,
            fault=axis.trouble(),
            following_error_qc=axis.following_error_qc,
            clock_offset_us=float(clock.offset_us[index]),
            clock_drift_ppm=1e6 * float(clock.drift[index]),
            executed_qc=axis.demand_qc,
            records_sent=axis.account.sent,
            silent_s=self._silent_s(axis.heard_us, self._group.silent(index)),
        )

    def _silent_s(self, heard_us: float, silent: bool) -> float:
        """How long a drive has not been heard, if that is longer than it may be."""
        silent_us = now_us() - heard_us
        lost = silent or self._link is None or self._link.failed
        return silent_us / 1e6 if lost else 0.0

    def _state(self) -> tuple[str, str]:
        """Of all axes: what is wrong with some of them comes first."""
        group, profile = self._group, self._copley.protocol
        fine = group.phase is not Phase.FAULT
        if fine and (profile.phase is ProfilePhase.FAULT or not group.axes):
            return profile.phase.value, profile.reason
        return group.phase.value, group.reason

    def _output_snapshots(self) -> tuple[OutputSnapshot, ...]:
        outputs, node_ids = self._outputs.protocol, {a.joint: a.node_id for a in self._all_axes}
        return tuple(
            OutputSnapshot(
                output.name, output.joint, node_ids[output.joint], outputs.tally(output.name)
            )
            for output in self._config.outputs
        )

    def _copley_snapshots(self) -> list[AxisSnapshot]:
        nan = math.nan
        snapshots = []
        profile = self._copley.protocol
        for index, (axis, config) in enumerate(
            zip(profile.axes, self._copley.configs, strict=True)
        ):
            units, known = AxisUnits.of(config), axis.position_qc is not None
            snapshots.append(
                AxisSnapshot(
                    joint=axis.joint,
                    node_id=axis.node_id,
                    state=axis.state.value,
                    position=units.from_qc(float(axis.position_qc or 0)) if known else nan,
                    velocity=units.from_qc_s(axis.velocity_qc_s) if known else nan,
                    effort=nan,
                    stamp_us=axis.sample_us,
                    used=0,
                    free=0,
                    size=0,
                    buffered_ms=0.0,
                    status_word=0,
                    fault=axis.trouble,
                    following_error_qc=None,
                    clock_offset_us=None,
                    clock_drift_ppm=None,
                    executed_qc=axis.position_qc,
                    records_sent=0,
                    silent_s=self._silent_s(axis.heard_us, profile.silent(index)),
                )
            )
        return snapshots

    def _standing(self) -> bool:
        return (
            self._group.phase in (Phase.DISABLED, Phase.STANDING, Phase.FAULT)
            and self._copley.protocol.phase not in IN_PROFILE_MOTION
        )

    def _wait_for(self, what: str, *requests: Callable[[], Future[None]]) -> None:
        """Make the requests, then wait for all of them."""
        for answer in [self._reactor.call(request) for request in requests]:
            self._wait(answer, what)

    @staticmethod
    def _wait(answer: Future[None], what: str) -> None:
        try:
            answer.result(REQUEST_TIMEOUT_S)
        except FutureTimeoutError as error:
            raise DriveError(f"{what}: no result within {REQUEST_TIMEOUT_S:g} s") from error

    def _on_frame(self, frame: Frame, t_us: float, echo: bool) -> None:
        t_us = round(t_us, 3)  # what a log holds: run over it again, all is the same
        self._group.receive(frame, t_us, echo)
        self._copley.receive(frame, t_us, echo)
        self._outputs.receive(frame, t_us, echo)
        self._flush()

    def broke(self, where: str, error: BaseException) -> None:
        """A callback of the caller's raised `error`: said, all axes stop, and are in fault."""
        self._supervisor.broke(where, error)

    def _fail(self, reason: str) -> None:
        """From any thread: stop all axes, and be in fault."""
        self._reactor.post(partial(self._stop_in_fault, reason))

    def _stop_in_fault(self, reason: str) -> None:
        self._doubtful = True
        try:
            self._group.fail(reason)
            self._copley.protocol.fail(reason)
            self._flush()
        except Exception:
            # Not even that: the drives stop by themselves when the host is silent.
            logging.getLogger("epos2_ros").critical("can't stop the axes", exc_info=True)
            if self._link is not None:
                self._link.fail(reason)

    def _on_failure(self, text: str) -> None:
        self._group.bus_failed(text)
        if self._copley.protocol.axes:
            self._copley.protocol.bus_failed(text)

    def _step(self) -> float:
        """What is due, in the reactor; when it is to be called next [host µs]."""
        link = self._link
        if link is not None:
            link.pump()
        now = now_us()
        self._path.advance(now)
        self._group.advance(now)
        beside_us = self._copley.advance(now)
        self._outputs.flush()
        self._flush()
        deadline = min(self._group.deadline_us, beside_us, now + IDLE_US)
        return min(deadline, link.deadline_us) if link is not None else deadline

    def _flush(self) -> None:
        """Carry out what the axes ask for."""
        self._stop_together()
        self._predictor.watch(now_us())
        while self._group.outbox and self._link is not None:
            self._link.send(self._group.outbox.popleft())
        while self._group.clearing:
            self._worker.post(partial(self._clear_buffer, self._group.clearing.popleft()))
        while self._group.reads.outbox:
            self._worker.post(partial(self._ask_buffer, self._group.reads.outbox.popleft()))
        while self._copley.protocol.outbox and self._link is not None:
            self._link.send(self._copley.protocol.outbox.popleft())
        while self._rejects.notices:
            self._warn(self._rejects.notices.popleft())
        while self._group.events:
            self._announce(self._on_event, self._group.events.popleft())
        while self._copley.protocol.events:
            self._announce(self._on_event, Event(*self._copley.protocol.events.popleft()))
        if self._trace is not None:
            self._trace.watch()

    def _stop_together(self) -> None:
        """One axis in trouble stops all, and at once."""
        group, profile = self._group, self._copley.protocol
        if group.phase in (Phase.HALTING, Phase.FAULT):
            profile.halt(group.reason)
        if profile.phase is ProfilePhase.FAULT and group.phase in IN_MOTION:
            group.halt(profile.reason)

    def _warn(self, text: str) -> None:
        self._announce(self._on_event, Event("warning", text))

    def _announce(self, tell: Callable[[T], None], event: T) -> None:
        if isinstance(event, Event):
            self._note(event.kind, event.text)
        elif isinstance(event, OutputEvent):
            self._note("output", event._asdict())
        self._announcer.submit(self._supervisor.guarded("announcing", partial(tell, event)))

    def _note(self, name: str, data: object) -> None:
        """Into the log, if there is one."""
        if self._log is not None:
            self._log.event(now_us(), name, data)

    def _on_other(self, kind: str, can_id: int, data: bytes, t_us: float) -> None:
        if kind in ("dropped", "fd"):
            self._note(kind, [f"{can_id:03X}", data.hex()])
        elif self._log is not None:
            self._log.other(t_us, kind, can_id, data)

    def _move_to(self, targets: Mapping[str, float], duration_s: float) -> None:
        if self._group.phase is Phase.FAULT:  # one axis in trouble stops all
            raise TrajectoryError(f"can't move: the drives are {self._group.describe_phase()}")
        self._copley.move_to(targets, duration_s)

    def _cancel(self, execution: Execution, reason: str) -> None:
        self._path.cancel(execution, reason)
        self._predictor.watch(now_us())

    def _commit(
        self, placement: Placement, reference: Reference, execution: Execution, stops: int
    ) -> bool:
        if stops != self._stops:
            raise TrajectoryError("the axes were stopped while it was worked out")
        if self._copley.protocol.phase is ProfilePhase.FAULT:
            raise TrajectoryError(f"can't move: {self._copley.protocol.reason}")
        done = self._path.commit(placement, reference, execution)
        self._predictor.watch(now_us())
        return done

    def _stop_path(self) -> Future[None] | None:
        self._stops += 1
        motion = self._path.stop()
        self._predictor.watch(now_us())
        return motion

    def _clear_buffer(self, index: int) -> None:
        try:
            self._nodes[index].clear_buffer()
            error = ""
        except DriveError as refusal:
            error = str(refusal)
        self._reactor.post(lambda: self._group.buffer_cleared(index, error))

    def _ask_buffer(self, index: int) -> None:
        """The group sees the answer on the bus."""
        try:
            self._nodes[index].free_records()
        except DriveError as refusal:
            error = str(refusal)
            self._reactor.post(lambda: self._group.buffer_not_read(index, error))


def _start_us(trajectory: Trajectory) -> float | None:
    """When its own zero is [host µs]; None: as soon as possible."""
    return trajectory.stamp_s * 1e6 + wall_offset_us() if trajectory.stamp_s else None
