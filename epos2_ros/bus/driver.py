"""The driver at work: one bus, one group of axes, real time.

The reactor's thread owns group, path and link; frames, requests and deadlines all come to it as
jobs. What blocks (SDO) runs on a worker, so that feeding never waits for an answer.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures import TimeoutError as FutureTimeoutError
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from epos2_ros.bus import realtime
from epos2_ros.bus.health import Health
from epos2_ros.bus.identity import read_identity
from epos2_ros.bus.link import Link
from epos2_ros.bus.nodes import DriveNode, check, node_of
from epos2_ros.bus.outputs.predictor import Predictor
from epos2_ros.bus.outputs.service import OutputService
from epos2_ros.bus.poller import Poller
from epos2_ros.bus.reactor import Reactor
from epos2_ros.bus.sdo_client import RemoteNode
from epos2_ros.bus.sdo_jobs import perform
from epos2_ros.bus.settings import machine_of
from epos2_ros.bus.simulation import Simulation
from epos2_ros.bus.snapshot import (
    JointStates,
    OutputSnapshot,
    Snapshot,
    axis_snapshots,
    joint_states,
)
from epos2_ros.bus.supervisor import Supervisor
from epos2_ros.bus.timestamps import now_us, wall_offset_us
from epos2_ros.bus.tracking import Tracking, tracked
from epos2_ros.bus.worker import Worker
from epos2_ros.buslog import inputs
from epos2_ros.buslog.plain import to_plain
from epos2_ros.buslog.writer import LogWriter
from epos2_ros.configuration.driver import AxisConfig, DriverConfig
from epos2_ros.configuration.outputs import CompareConfig
from epos2_ros.errors import (
    BusError,
    ConfigurationError,
    DriveError,
    MotionAborted,
    MotionStopped,
    TrajectoryError,
)
from epos2_ros.motion import knots
from epos2_ros.motion.move import refuse_trajectory
from epos2_ros.motion.reference import Reference
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.protocol.cia402 import State
from epos2_ros.protocol.clock import time_of_day
from epos2_ros.protocol.drive import Drive
from epos2_ros.protocol.execution import Execution
from epos2_ros.protocol.frame import Frame
from epos2_ros.protocol.identity import Identity
from epos2_ros.protocol.intake import Rejects, intake_of
from epos2_ros.protocol.other_host import OtherHost
from epos2_ros.protocol.outbox import Event, SdoRequest
from epos2_ros.protocol.outputs.outputs import OutputEvent
from epos2_ros.protocol.path import Placement, refuse_ended
from epos2_ros.protocol.phase import Phase
from epos2_ros.protocol.timekeeper import HOST_NODE_ID, Timekeeper
from epos2_ros.protocol.trace import Trace
from epos2_ros.protocol.whereabouts import Whereabouts

T = TypeVar("T")

REQUEST_TIMEOUT_S = 30.0  # the group's own limits are shorter; this one guards the wait
IDLE_US = 100_000.0
LISTEN_S = 0.25  # for another host: two of its heartbeats


class Driver:
    """All drives on one bus. All methods are thread-safe and bounded in time."""

    def __init__(
        self,
        config: DriverConfig,
        on_event: Callable[[Event], None] = lambda event: None,
        on_output: Callable[[OutputEvent], None] = lambda event: None,
        on_trace: Callable[[str], None] | None = None,
    ) -> None:
        for axis in config.axes:
            check(axis, config)
        self._config = config
        self._on_event = on_event
        self._supervisor = Supervisor(self._fail)
        # Where nothing real moves, nobody else is to wait for it.
        self._priority = 0 if config.simulate else config.realtime_priority
        self._reactor = Reactor(
            self._step,
            partial(self._supervisor.broke, "the driver's thread"),
            self._priority,
        )
        self._memory_locked = False
        self._simulation: Simulation | None = None
        self._link: Link | None = None
        self._log: LogWriter | None = None
        self._nodes: dict[Drive, DriveNode] = {}
        self._brought_up = False  # all drives, since the link was opened
        self._identities: Mapping[str, Identity] = {}  # by joint
        self._resetting = threading.Lock()  # held while the link is opened anew, or closed for good
        self._closing = False
        self._doubtful = False  # something of ours has raised: what it knows may be half of it
        self._stops = 0  # how often motions were ended on request, those not yet begun included
        knots.prepare()  # by the first motion it is too late
        self._machine = machine_of(config)
        self._group, self._path = self._machine.group, self._machine.path
        self._whereabouts = Whereabouts(self._machine)
        self._worker = Worker(partial(self._supervisor.broke, "SDO"))
        self._poller = Poller(self._canopen_node, partial(self._supervisor.broke, "SDO"))
        self._announcer = ThreadPoolExecutor(1, thread_name_prefix="events")
        self._outputs = OutputService(
            config.axes,
            config.outputs,
            self._machine,
            self._worker,
            self._reactor,
            partial(self._announce, on_output),
            self._warn,
        )
        self._trace: Trace | None = None
        if on_trace is not None:  # every step, for whoever looks for what is wrong
            listener = on_trace
            self._trace = Trace(self._machine, lambda line: self._announce(listener, line))
        self._predictor = Predictor(
            [axis.joint for axis in config.axes],
            self._machine,
            self._outputs.protocol,
            self._reactor,
            self._warn,
            self._supervisor,
        )
        self._rejects = Rejects()
        names = {drive.node_id: str(drive) for drive in self._machine.drives}
        self._other_host = OtherHost(names, self._machine.time.producer is None)
        self._another = threading.Event()  # another host was heard before the bring-up

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
        for axis in self._config.axes:
            if axis.node_id == HOST_NODE_ID:
                raise ConfigurationError(
                    f"axes.{axis.joint}.node_id is {HOST_NODE_ID}, which the host's heartbeat "
                    f"has; it must be from 1 to {HOST_NODE_ID - 1}"
                )
        answering, producer = len(self._machine.drives), self._machine.time.producer
        shortest_s = Timekeeper.shortest_period_us(answering) / 1e6
        if producer is not None and self._config.sync_period < shortest_s:
            raise ConfigurationError(
                f"sync.period is {self._config.sync_period:g} s; with SYNC from a drive "
                f"(sync.producer) {answering} axes need at least {shortest_s:g} s"
            )
        if self._config.log_file is not None:
            self._open_log(Path(self._config.log_file).expanduser())
        if self._config.simulate:
            self._simulation = Simulation(self._config)
        self._reactor.start()
        if self._priority:
            self._ask_for_real_time()
        self._open()
        self._bring_up(self._machine.drives)

    def _ask_for_real_time(self) -> None:
        scheduling = self._reactor.call(lambda: self._reactor.scheduling.refusal)
        memory = realtime.lock_memory()
        self._memory_locked = not memory
        if refused := "; ".join(filter(None, (scheduling, memory))):
            self._warn(f"no real time: {refused}; {realtime.DO}")

    def _open_log(self, file: Path) -> None:
        config = self._config
        size_bytes = round(config.log_size * 1e6)
        preamble = (("configuration", to_plain(config)),)
        self._log = LogWriter(file, size_bytes, now_us(), wall_offset_us, self._warn, preamble)
        inputs.record(self._machine, self._log, now_us)

    def _open(self) -> None:
        config = self._config
        self._brought_up = self._doubtful = False
        self._another.clear()
        self._link = Link(
            config.interface,
            config.channel,
            config.bitrate,
            intake_of(self._machine.drives, self._rejects),
            self._on_frame,
            self._group.fail,
            self._on_failure,
            self._reactor.post,
            self._reactor.offer,
            self._on_other,
            self._priority,
        )
        # Before anything is sent: what another host does with these drives goes on untouched.
        if not config.simulate and self._another.wait(LISTEN_S):
            self._link.close()
            raise BusError(self._other_host.still_there(now_us()))
        self._link.probe()
        network = self._link.network
        self._nodes = {
            drive: node_of(network, axis, config)
            for drive, axis in zip(self._machine.drives, config.axes, strict=True)
        }
        self._outputs.open({drive.joint: node.node for drive, node in self._nodes.items()})

    def _bring_up(self, drives: Iterable[Drive]) -> None:
        self._worker.run(partial(self._bring_up_drives, tuple(drives)))
        assert self._link is not None
        echoes = self._link.echoes
        self._reactor.call(
            lambda: self._group.start_clock(now_us(), time_of_day(time.time()), echoes)
        )
        self._produce_sync(round(self._config.sync_period * 1e6))
        self._refuse_another_host()
        self._brought_up = True

    def _refuse_another_host(self) -> None:
        if told := self._reactor.call(lambda: self._other_host.still_there(now_us())):
            raise BusError(told)

    def _produce_sync(self, period_us: int) -> None:
        if (producer := self._machine.time.producer) is not None:
            node = self._nodes[producer]
            self._worker.run(lambda: node.produce_sync(period_us))

    def _bring_up_drives(self, drives: Sequence[Drive]) -> None:
        """All at once: each answers in its own time, and most of it is waiting for that."""
        with ThreadPoolExecutor(len(drives), thread_name_prefix="bring-up") as pool:
            identities = list(pool.map(self._bring_up_drive, drives))
        for drive, identity in zip(drives, identities, strict=True):
            self._introduce(drive, identity)

    def _bring_up_drive(self, drive: Drive) -> Identity:
        if self._closing:
            raise BusError("the bus is being closed")
        node = self._nodes[drive]
        statusword = node.configure()
        identity = self._identify(drive)
        self._reactor.call(
            lambda: self._group.reconfigured(drive, statusword, now_us(), node.units)
        )
        self._outputs.arm(drive.joint)
        return identity

    def _identify(self, drive: Drive) -> Identity:
        """Ask a drive who it is.

        DriveError for another model in its place: what it was told may not be meant for that one.
        """
        identity = read_identity(self._nodes[drive].node)
        known = self._identities.get(drive.joint, identity)
        if not identity.same_model(known):
            raise DriveError(
                f"{drive} was a {known.maker} {known.product} and is now a {identity.maker} "
                f"{identity.product}: put one like it in its place, or configure the driver anew "
                "if this one is to stay"
            )
        return identity

    def _introduce(self, drive: Drive, identity: Identity) -> None:
        """Say who a drive is, unless that is known."""
        if self._identities.get(drive.joint) != identity:
            self._identities = {**self._identities, drive.joint: identity}
            text = f"{drive.joint} (node {drive.node_id}): {identity}"
            self._announce(self._on_event, Event("drive", text))

    def close(self) -> None:
        """Stop the axes and switch them off, let the drives go, close the bus.

        Drives that can't be reached any more stop on the host's missing heartbeat.

        Whoever waits for an answer gets one.
        """
        self._closing = True
        with self._resetting:  # which ends now
            self._close()

    def _close(self) -> None:
        if self._brought_up and self._link is not None and not self._link.failed:
            self._brought_up = False
            try:
                self._switch_off()
                self._produce_sync(0)
                self._leave()
            except DriveError as error:
                self._warn(str(error))
        self._worker.close()
        self._poller.close()
        self._reactor.stop()
        self._group.give_up("the bus is closed")  # from now on it is this thread's
        if self._log is not None:
            self._log.close()
        self._predictor.close()
        self._announcer.shutdown()
        if self._link is not None:
            self._link.close()
        if self._simulation is not None:
            self._simulation.close()

    def _leave(self) -> None:
        """The drives are not to take the end of our heartbeat for a fault."""
        lost = self._reactor.call(self._group.lost)
        for drive, node in self._nodes.items():
            if drive not in lost:
                self._worker.run(node.leave)

    def _switch_off(self) -> None:
        """Nothing is left enabled behind a closed bus: axes that still are stop at once."""
        group = self._group
        if self._reactor.call(lambda: group.phase is not Phase.DISABLED):
            self._wait_for("quick stop", group.quick_stop)
            self._wait_for("disable", group.disable)

    # ------------------------------------------------------------------ requests

    def enable(self) -> None:
        """Every axis to "operation enabled", holding. DriveError says which axis is where."""
        self._wait_for("enable", self._group.enable)

    def disable(self) -> None:
        """Stop on the path, then switch every axis off; what has not begun does not begin.

        Axes that don't come to rest in time on their path are halted.
        """
        self._stops += 1
        off = self._reactor.call(self._path.disable)
        try:
            off.result(REQUEST_TIMEOUT_S)
        except FutureTimeoutError:
            self._reactor.call(self._group.halt)
        self._wait(off, "disable")

    @property
    def trajectory_axes(self) -> tuple[AxisConfig, ...]:
        """Those that follow trajectories."""
        return self._path.axes

    def check(self, trajectory: Trajectory) -> None:
        """TrajectoryError for what can't be meant: its joints, or an end in the past."""
        refuse_trajectory(self._machine.movers, trajectory.joint_names)
        joints = [axis.joint for axis in self._path.axes]
        trajectory.axes(joints, self._config.allow_partial_joints_goal)
        refuse_ended(trajectory, _start_us(trajectory), now_us())

    def submit(self, trajectory: Trajectory) -> Execution | None:
        """Run a trajectory, or stop on the path if it has no points. TrajectoryError: refused."""
        refuse_trajectory(self._machine.movers, trajectory.joint_names)
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
                if self._reactor.call(
                    partial(self._commit, placement, reference, execution, stops)
                ):
                    return execution
            except TrajectoryError as error:
                self._note("refused", str(error))
                raise
            lead_ms = round((now_us() - begun_us) / 500)  # twice as long as it took

    def cancel(self, execution: Execution, reason: str) -> None:
        """Stop on the path, if it is this trajectory that the axes follow or wait for."""
        self._reactor.call(lambda: self._cancel(execution, reason))

    def track(self) -> Tracking:
        """What the axes that follow trajectories are to do, and do."""
        return self._reactor.read(self._track)

    def move_to(self, targets: Mapping[str, float], duration_s: float = 0.0) -> None:
        """Axes in profile position mode to positions [unit], leaving and arriving together.

        Returns when they have left. TrajectoryError: refused.
        """
        self._reactor.call(lambda: self._machine.move_to(targets, duration_s))

    def home(self) -> None:
        """All axes with a homing method look for their homes, those of the lowest order first.

        Returns when they are home. DriveError says which axis is not, where it stands, and why.
        """
        orders = self._machine.homing_orders()
        if not orders:
            raise DriveError("no joint has a homing method: set axes.<joint>.homing.method")
        for drives in orders:
            if not self._reactor.call(lambda: self._group.standing):
                raise DriveError(f"can't move: the drives are {self._group.describe_phase()}")
            for drive in drives:
                self._worker.run(partial(self._outputs.disarm, drive.joint))
            wrong = [self._home(drives)]
            lost = self._reactor.call(self._group.lost)  # armed when they are brought up anew
            wrong += [self._arm(drive) for drive in drives if drive not in lost]
            if any(wrong):
                raise DriveError("; ".join(filter(None, wrong)))

    def _home(self, drives: Sequence[Drive]) -> str:
        """All of these at once; what went wrong, or ""."""
        places = [self._machine.drives.index(drive) for drive in drives]
        try:
            motion = self._reactor.call(partial(self._machine.home, places))
            self._wait(motion, "home", self._machine.home_limit_s(places) + REQUEST_TIMEOUT_S)
        except (TrajectoryError, MotionAborted, MotionStopped, DriveError) as error:
            return str(error)
        return ""

    def _arm(self, drive: Drive) -> str:
        """The outputs of a drive that stands; what went wrong, or ""."""
        try:
            self._worker.run(partial(self._outputs.arm, drive.joint))
        except DriveError as error:
            return str(error)
        return ""

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
        self._wait_for("halt", self._group.halt)

    def quick_stop(self) -> None:
        """Each axis stops on its quick stop ramp and leaves "operation enabled"."""
        self._stops += 1
        self._wait_for("quick stop", self._group.quick_stop)

    def reset_fault(self) -> None:
        """Reopen a bus that failed, bring restarted or lost drives up again, reset every fault.

        After an internal error all begins anew. The axes stay off. DriveError if somebody else is
        at it.
        """
        if not self._resetting.acquire(blocking=False):
            raise DriveError("a fault is being reset already, or the bus closed")
        try:
            self._reset_fault()
        finally:
            self._resetting.release()

    def _reset_fault(self) -> None:
        self._refuse_another_host()
        lost: Sequence[Drive] = self._reactor.call(self._group.lost)
        sound = self._link is not None and not self._link.failed and self._brought_up
        if self._link is not None and (not sound or self._doubtful):
            self._link.close()
            self._open()
            lost = self._machine.drives
        if lost:
            self._bring_up(lost)
        faulty = self._reactor.call(
            lambda: [drive for drive in self._machine.drives if drive.state is State.FAULT]
        )
        for drive in faulty:
            self._worker.run(self._nodes[drive].clear_faults)
        self._wait_for("reset fault", self._group.reset_fault)

    def snapshot(self) -> Snapshot:
        """Everything the topics show."""
        return self._reactor.read(self._snapshot)

    def joint_states(self) -> JointStates:
        """Where the joints are now; those that are not heard any more are left out."""
        return self._reactor.read(self._joint_states)

    # ------------------------------------------------------------------ inside

    def _track(self) -> Tracking:
        return tracked(self._machine, self._path.axes, self._whereabouts, now_us())

    def _joint_states(self) -> JointStates:
        now = now_us()
        if self._link is None or self._link.failed:
            return JointStates(now, [], [], [], [])
        return joint_states(self._whereabouts, self._machine, now)

    def _snapshot(self) -> Snapshot:
        link = self._link
        health = link.health if link else Health()
        return Snapshot(
            axes=axis_snapshots(
                self._machine, now_us(), link is None or link.failed, self._identities
            ),
            outputs=self._output_snapshots(),
            state=self._group.phase.value,
            reason=self._group.reason,
            bus_load=link.load if link else 0.0,
            sync_count=self._group.time.sync_count,
            sync_time_source=self._sync_time_source(),
            dropped_frames=link.dropped if link else 0,
            error_frames=health.error_frames,
            refused_frames=link.refused if link else 0,
            bus_state=health.state.value,
            transmit_errors=health.transmit_errors,
            receive_errors=health.receive_errors,
            start_error_us=self._machine.path_time.start_error_us,
            simulated=self._config.simulate,
            rejected=dict(self._rejects.counts),
            internal_errors=self._supervisor.mistakes,
            late=self._reactor.lateness.figures(),
            scheduling=str(self._reactor.scheduling),
            memory_locked=self._memory_locked,
        )

    def _sync_time_source(self) -> str:
        if self._link is None:
            return ""
        if self._machine.time.produces:
            return self._link.time_source
        return f"received from {self._config.sync_producer}, {self._link.clock.source}"

    def _output_snapshots(self) -> tuple[OutputSnapshot, ...]:
        outputs, node_ids = self._outputs.protocol, {a.joint: a.node_id for a in self._config.axes}
        return tuple(
            OutputSnapshot(
                output.name, output.joint, node_ids[output.joint], outputs.tally(output.name)
            )
            for output in self._config.outputs
        )

    def _standing(self) -> bool:
        return self._group.phase in (Phase.DISABLED, Phase.STANDING, Phase.FAULT)

    def _wait_for(self, what: str, *requests: Callable[[], Future[None]]) -> None:
        """Make the requests, then wait for all of them."""
        for answer in [self._reactor.call(request) for request in requests]:
            self._wait(answer, what)

    @staticmethod
    def _wait(answer: Future[Any], what: str, timeout_s: float = REQUEST_TIMEOUT_S) -> None:
        try:
            answer.result(timeout_s)
        except FutureTimeoutError as error:
            raise DriveError(f"{what}: no result within {timeout_s:g} s") from error

    def _on_frame(self, frame: Frame, t_us: float, echo: bool) -> None:
        t_us = round(t_us, 3)  # what a log holds: run over it again, all is the same
        if not echo:
            self._look_for_another_host(frame, t_us)
        self._machine.receive(frame, t_us, echo)
        self._outputs.receive(frame, t_us, echo)
        self._flush()

    def _look_for_another_host(self, frame: Frame, t_us: float) -> None:
        if self._link is not None and self._link.failed:
            return  # and knows its own frames no more
        told = self._other_host.look(frame, t_us, self._brought_up)
        if told:
            self._another.set()
        if told and self._brought_up:
            self._group.fail(told)

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
            self._flush()
        except Exception:
            # Not even that: the drives stop by themselves when the host is silent.
            logging.getLogger("epos2_ros").critical("can't stop the axes", exc_info=True)
            if self._link is not None:
                self._link.fail(reason)

    def _on_failure(self, text: str) -> None:
        self._group.bus_failed(text)

    def _step(self) -> float:
        """What is due, in the reactor; when it is to be called next [host µs]."""
        link = self._link
        if link is not None:
            link.pump()
        now = now_us()
        self._machine.advance(now)
        self._outputs.flush()
        self._flush()
        deadline = min(self._machine.deadline_us, now + IDLE_US)
        return min(deadline, link.deadline_us) if link is not None else deadline

    def _flush(self) -> None:
        """Carry out what the axes ask for."""
        out = self._machine.out
        self._predictor.watch(now_us())
        while out.frames and self._link is not None:
            self._link.send(out.frames.popleft())
        while out.requests:
            self._worker.post(partial(self._perform, out.requests.popleft()))
        while out.polls:
            self._poller.poll(out.polls.popleft())
        while self._rejects.notices:
            self._warn(self._rejects.notices.popleft())
        while out.events:
            self._announce(self._on_event, out.events.popleft())
        if self._trace is not None:
            self._trace.watch()

    def _canopen_node(self, node_id: int) -> RemoteNode:
        return next(n.node for n in self._nodes.values() if n.node.id == node_id)

    def _perform(self, request: SdoRequest) -> None:
        node = self._canopen_node(request.node_id)
        values: Sequence[int] = ()
        error = ""
        try:
            values, _, _ = perform(node, request, now_us)
        except DriveError as refusal:
            error = str(refusal)
        self._reactor.post(lambda: self._machine.out.answer(request.number, values, error))

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
        if self._log is None:
            return
        if kind == "dropped":
            self._log.event(t_us, "rejected")  # the frame that follows
            self._log.frame(t_us, can_id, data, False)
        elif kind == "fd":
            self._log.event(t_us, kind, [f"{can_id:03X}h", data.hex(" ")])
        else:
            self._log.other(t_us, kind, can_id, data)

    def _cancel(self, execution: Execution, reason: str) -> None:
        self._path.cancel(execution, reason)
        self._predictor.watch(now_us())

    def _commit(
        self, placement: Placement, reference: Reference, execution: Execution, stops: int
    ) -> bool:
        if stops != self._stops:
            raise TrajectoryError("the axes were stopped while it was worked out")
        done = self._path.commit(placement, reference, execution)
        self._predictor.watch(now_us())
        return done

    def _stop_path(self) -> Future[None] | None:
        self._stops += 1
        motion = self._path.stop()
        self._predictor.watch(now_us())
        return motion


def _start_us(trajectory: Trajectory) -> float | None:
    """When its own zero is [host µs]; None: as soon as possible."""
    return trajectory.stamp_s * 1e6 + wall_offset_us() if trajectory.stamp_s else None
