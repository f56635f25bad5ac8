"""The driver at work: one bus, one group of axes, real time.

The reactor's thread owns group, path and link; frames, requests and deadlines all come to it as
jobs. What blocks (SDO) runs on a worker, so that feeding never waits for an answer.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures import TimeoutError as FutureTimeoutError
from dataclasses import dataclass
from functools import partial

from epos2_ros.bus.bringup import Epos2Node
from epos2_ros.bus.link import Link, open_bus
from epos2_ros.bus.reactor import Reactor
from epos2_ros.bus.settings import axis_setup, drive_settings, group_settings
from epos2_ros.bus.timestamps import now_us, wall_offset_us
from epos2_ros.config import DriverConfig
from epos2_ros.errors import ConfigurationError, DriveError, Epos2RosError, MotionAborted
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.motion.units import AxisUnits
from epos2_ros.protocol.clock import time_of_day
from epos2_ros.protocol.epos2 import BUFFER_SIZE
from epos2_ros.protocol.frame import Frame
from epos2_ros.protocol.group import IN_MOTION, Event, Group
from epos2_ros.protocol.path import PathCommander
from epos2_ros.protocol.timekeeper import HOST_NODE_ID
from epos2_ros.sim.realtime import RealtimeSimulator, build_drives, save_log

REQUEST_TIMEOUT_S = 30.0  # the group's own limits are shorter; this one guards the wait
IDLE_US = 100_000.0


@dataclass(frozen=True)
class AxisSnapshot:
    """One axis as last reported. Joint units; NaN where the drive has not said yet."""

    joint: str
    node_id: int
    state: str  # CiA 402 state
    position: float
    velocity: float
    effort: float  # motor current [A]
    stamp_us: float  # host time of the position sample
    used: int
    free: int
    size: int
    buffered_ms: float
    status_word: int  # 0x20C4-01
    fault: str
    following_error_qc: int
    clock_offset_us: float
    clock_drift_ppm: float
    executed_qc: int | None  # position demand at the last SYNC
    records_sent: int


@dataclass(frozen=True)
class Snapshot:
    """The whole group at one instant."""

    axes: tuple[AxisSnapshot, ...]
    state: str
    reason: str
    bus_load: float  # 0 … 1
    sync_count: int
    sync_time_source: str
    dropped_frames: int
    error_frames: int
    refused_frames: int


class Driver:
    """One group of drives on one bus. All methods are thread-safe and bounded in time."""

    def __init__(
        self, config: DriverConfig, on_event: Callable[[Event], None] = lambda event: None
    ) -> None:
        self._config = config
        self._on_event = on_event
        self._reactor = Reactor(self._step)
        self._units = [AxisUnits.of(axis) for axis in config.axes]
        self._simulation: Simulation | None = None
        self._link: Link | None = None
        self._nodes: list[Epos2Node] = []
        self._group = Group([axis_setup(axis) for axis in config.axes], group_settings(config))
        self._path = PathCommander(self._group, config)
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="sdo")
        self._announcer = ThreadPoolExecutor(1, thread_name_prefix="events")

    # ------------------------------------------------------------------ life

    def configure(self) -> None:
        """Open the bus, bring every drive up, start TIME, SYNC and heartbeat.

        Raises ConfigurationError, BusError or DriveError; the bus is closed again then.
        """
        try:
            self._configure()
        except Epos2RosError:
            self.close()
            raise

    def _configure(self) -> None:
        for axis in self._config.axes:
            if axis.drive != "epos2":
                raise ConfigurationError(
                    f"axes.{axis.joint}.drive: {axis.drive!r} can't run in interpolated position "
                    "mode; allowed is 'epos2'"
                )
            if axis.node_id == HOST_NODE_ID:
                raise ConfigurationError(
                    f"axes.{axis.joint}.node_id is {HOST_NODE_ID}, which the host's heartbeat "
                    f"has; it must be from 1 to {HOST_NODE_ID - 1}"
                )
        if self._config.sync_source != "host":
            raise ConfigurationError(
                f"sync.source is {self._config.sync_source!r}: a drive as clock master is not "
                "supported yet; it must be host"
            )
        if self._config.simulate:
            self._simulation = Simulation(self._config)
        self._reactor.start()
        self._open()
        for index in range(len(self._nodes)):
            self._bring_up(index)
        self._reactor.call(self._start_clock)

    def _open(self) -> None:
        config = self._config
        self._link = Link(
            config.interface,
            config.channel,
            config.bitrate,
            self._on_frame,
            self._on_failure,
            self._reactor.post,
        )
        self._nodes = [
            Epos2Node(self._link.network, drive_settings(axis, config)) for axis in config.axes
        ]

    def _start_clock(self) -> None:
        self._group.start_clock(now_us(), time_of_day(time.time()))

    def _bring_up(self, index: int) -> None:
        statusword = self._nodes[index].configure()
        self._reactor.call(lambda: self._group.reconfigured(index, statusword, now_us()))

    def close(self) -> None:
        """Close the bus. Drives that are still enabled stop on the host's missing heartbeat."""
        self._worker.shutdown()
        self._reactor.stop()
        self._announcer.shutdown()
        if self._link is not None:
            self._link.close()
        if self._simulation is not None:
            self._simulation.close()

    # ------------------------------------------------------------------ requests

    def enable(self) -> None:
        """Every axis to "operation enabled", holding. DriveError says which axis is where."""
        self._wait(self._reactor.call(self._group.enable), "enable")

    def disable(self) -> None:
        """Stop on the path, then switch every axis off."""
        if self._moving():
            self.stop_on_path()
        self._wait(self._reactor.call(self._group.disable), "disable")

    def submit(self, trajectory: Trajectory) -> None:
        """Run a trajectory, or stop on the path if it has no points. TrajectoryError: refused."""
        if not len(trajectory.times_s):
            self._reactor.call(self._path.stop)
            return
        start_us = None
        if trajectory.stamp_s:
            start_us = trajectory.stamp_s * 1e6 + wall_offset_us()
        lead_ms = 0
        while True:
            begun_us = now_us()
            placement = self._reactor.call(
                partial(self._path.place, trajectory, start_us, begun_us, lead_ms)
            )
            reference = placement.join()
            if self._reactor.call(partial(self._path.commit, placement, reference)):
                return
            lead_ms = round((now_us() - begun_us) / 500)  # twice as long as it took

    def stop_on_path(self) -> None:
        """All axes slow down together along the commanded path; returns when they stand."""
        motion = self._reactor.call(self._path.stop)
        if motion is not None:
            try:
                self._wait(motion, "stop")
            except MotionAborted as error:
                raise DriveError(str(error)) from error

    def halt(self) -> None:
        """Each axis stops at once on its own ramp, off the path, and holds."""
        self._wait(self._reactor.call(self._group.halt), "halt")

    def quick_stop(self) -> None:
        """Each axis stops on its quick stop ramp and leaves "operation enabled"."""
        self._wait(self._reactor.call(self._group.quick_stop), "quick stop")

    def reset_fault(self) -> None:
        """Reopen a bus that failed, bring restarted or lost drives up again, reset every fault.

        The axes stay off.
        """
        lost = self._reactor.call(self._group.lost_axes)
        if self._link is not None and self._link.failed:
            self._link.close()
            self._open()
            lost = list(range(len(self._nodes)))
        for index in lost:
            self._bring_up(index)
        if lost:
            self._reactor.call(self._start_clock)
        self._wait(self._reactor.call(self._group.reset_fault), "reset fault")

    def snapshot(self) -> Snapshot:
        """Everything the topics show."""
        return self._reactor.call(self._snapshot)

    # ------------------------------------------------------------------ inside

    def _snapshot(self) -> Snapshot:
        path_ms = self._group.path_ms(now_us())
        if self._group.phase not in IN_MOTION:
            path_ms = math.inf
        link = self._link
        return Snapshot(
            axes=tuple(self._axis_snapshot(index, path_ms) for index in range(len(self._units))),
            state=self._group.phase.value,
            reason=self._group.reason,
            bus_load=link.load if link else 0.0,
            sync_count=self._group.time.sync_count,
            sync_time_source=link.time_source if link else "",
            dropped_frames=link.dropped if link else 0,
            error_frames=link.error_frames if link else 0,
            refused_frames=link.refused if link else 0,
        )

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
            stamp_us=axis.sample_us,
            used=axis.used,
            free=axis.free,
            size=BUFFER_SIZE,
            buffered_ms=max(0.0, axis.account.ahead_ms(path_ms)),
            status_word=axis.buffer_status,
            fault=axis.trouble(),
            following_error_qc=axis.following_error_qc,
            clock_offset_us=float(clock.offset_us[index]),
            clock_drift_ppm=1e6 * float(clock.drift[index]),
            executed_qc=axis.demand_qc,
            records_sent=axis.account.sent,
        )

    def _moving(self) -> bool:
        return self._reactor.call(lambda: self._group.phase in IN_MOTION)

    @staticmethod
    def _wait(answer: Future[None], what: str) -> None:
        try:
            answer.result(REQUEST_TIMEOUT_S)
        except FutureTimeoutError as error:
            raise DriveError(f"{what}: no result within {REQUEST_TIMEOUT_S:g} s") from error

    def _on_frame(self, frame: Frame, t_us: float, echo: bool) -> None:
        self._group.receive(frame, t_us, echo)
        self._group.advance(now_us())
        self._flush()

    def _on_failure(self, text: str) -> None:
        self._group.bus_failed(text)

    def _step(self) -> float:
        """What is due, in the reactor; when it is to be called next [host µs]."""
        link = self._link
        if link is not None:
            link.pump()
            if link.stalled:
                self._group.bus_failed(
                    f"{link.name} no longer puts frames on the bus: check the cable, its "
                    "termination and whether any drive is powered"
                )
        now = now_us()
        self._path.advance(now)
        self._group.advance(now)
        self._flush()
        deadline = min(self._group.deadline_us, now + IDLE_US)
        return min(deadline, link.deadline_us) if link is not None else deadline

    def _flush(self) -> None:
        """Carry out what the group asks for."""
        while self._group.outbox and self._link is not None:
            self._link.send(self._group.outbox.popleft())
        while self._group.clearing:
            self._worker.submit(self._clear_buffer, self._group.clearing.popleft())
        while self._group.events:
            self._announcer.submit(self._on_event, self._group.events.popleft())

    def _clear_buffer(self, index: int) -> None:
        try:
            self._nodes[index].clear_buffer()
            error = ""
        except DriveError as refusal:
            error = str(refusal)
        self._reactor.post(lambda: self._group.buffer_cleared(index, error))


class Simulation:
    """Simulated drives for every joint of the configuration, on the driver's own bus."""

    def __init__(self, config: DriverConfig) -> None:
        self._log = config.simulation.log
        self._drives = build_drives(
            [axis.node_id for axis in config.axes],
            counts_per_turn=[axis.counts_per_turn for axis in config.axes],
            drift_ppm=config.simulation.drift_ppm,
            seed=config.simulation.seed,
            bitrate=config.bitrate,
            record=self._log is not None,
        )
        self._bus = open_bus(config.interface, config.channel, config.bitrate, echoes=False)
        self._simulator = RealtimeSimulator(self._bus, self._drives)
        self._simulator.start()

    def close(self) -> None:
        """Stop them and write their log."""
        self._simulator.stop()
        self._bus.shutdown()
        if self._log is not None:
            save_log(self._log, self._drives)
