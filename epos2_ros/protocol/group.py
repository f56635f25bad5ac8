"""All axes of one bus as a single machine: enable, start together, feed, stop together.

No I/O: frames and times go in (`receive`, `advance`), frames, requests to clear and read buffers,
and events come out (`outbox`, `clearing`, `reads.outbox`, `events`), and `deadline_us` says when
`advance` is wanted next. Times are host microseconds.

The rules this file keeps:

* Motion starts as the application note says ("Motion Synchronisation"): records in every
  buffer, reported by every drive; "enable ip mode" in every synchronous RPDO, seen on the bus;
  then one SYNC, whose time on the bus is the zero of every axis' path. No other SYNC is sent
  between the first of those controlwords and that one. Where a drive sends SYNC, they go out right
  after one, and the next is the start.
* What has not begun never begins once it is stopped or replaced: until the start SYNC is handed
  over, "enable ip mode" is taken back in every drive, seen on the bus before the next SYNC, and
  the records are cleared out of the buffers.
* One axis in trouble stops all. Nothing starts again by itself.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from epos2_ros.errors import DriveError, MotionAborted, MotionStopped, TrajectoryError
from epos2_ros.motion.reference import Reference
from epos2_ros.protocol import cia402, epos2
from epos2_ros.protocol.axis import Axis, AxisSetup
from epos2_ros.protocol.buffer_reads import BufferReads
from epos2_ros.protocol.cia402 import State
from epos2_ros.protocol.feeder import Feeder
from epos2_ros.protocol.frame import Frame
from epos2_ros.protocol.path_audit import PathAudit
from epos2_ros.protocol.silence import Silence
from epos2_ros.protocol.timekeeper import LEAD_US, Timekeeper

SETTLING_SYNCS = 10  # as many periods, and REPLY_TIMEOUT_US, has a group to be ready in
REPLY_TIMEOUT_US = 1_000_000.0  # for one step of a drive that has been told something
RESEND_US = 200_000.0  # a controlword without effect so long is sent again
STOP_TIMEOUT_US = 5_000_000.0  # for an axis to come to rest after a halt or quick stop
HALT_REACTION_US = 100_000.0  # a drive that has not begun to halt by then is quick-stopped
ACTIVE_TIMEOUT_US = 200_000.0  # after the start SYNC, for "ip mode active"
END_TIMEOUT_MS = 500.0  # after the end record, for "ip mode inactive"
ROUNDING_US = 1.0  # so much later than due, path time has come to it whatever its last digit
WAIT_SAID_US = 500_000.0  # a motion that waits longer than this for its stamp is told of


class Phase(Enum):
    """What the group is doing."""

    DISABLED = "disabled"
    ENABLING = "enabling"
    CLEARING = "clearing buffers"
    SETTLING = "reading the position demand"
    STANDING = "standing"
    PRIMING = "filling buffers"
    ARMING = "arming the start"
    STARTING = "starting"
    MOVING = "moving"
    CANCELLING = "taking back the start"
    HALTING = "halting"
    QUICK_STOPPING = "quick stop"
    DISABLING = "disabling"
    RESETTING = "resetting faults"
    FAULT = "fault"


NOT_BEGUN = frozenset({Phase.PRIMING, Phase.ARMING})
BEGUN = frozenset({Phase.STARTING, Phase.MOVING})
IN_MOTION = NOT_BEGUN | BEGUN
_GETTING_ENABLED = frozenset(
    {Phase.ENABLING, Phase.CLEARING, Phase.SETTLING, Phase.CANCELLING, Phase.STANDING} | IN_MOTION
)
_NO_CHANGE = {
    State.OPERATION_ENABLED: cia402.ENABLE_OPERATION,
    State.QUICK_STOP_ACTIVE: cia402.QUICK_STOP,
}
_WALK_TARGET = {
    Phase.ENABLING: State.OPERATION_ENABLED,
    Phase.DISABLING: State.READY_TO_SWITCH_ON,
    Phase.RESETTING: State.SWITCH_ON_DISABLED,
}


class Event(NamedTuple):
    """Something a user wants to read in the log."""

    # "waiting", "started", "replaced", "done", "cancelled", "stopped" (on request, off the path),
    # "aborted", "fault", "warning" or "debug"
    kind: str
    text: str


HALTED, QUICK_STOPPED = "halted on request", "quick stop on request"
ON_REQUEST = (HALTED, QUICK_STOPPED)  # reasons that are no fault


class End(Enum):
    """How a motion ended that was not aborted."""

    ARRIVED = "all axes have arrived"
    STOPPED = "stopped on the path"


@dataclass(frozen=True)
class GroupSettings:
    """Parameters of the whole group, as in the ROS contract."""

    sync_period_us: float = 100_000.0
    buffer_time_ms: float = 500.0
    tolerance_qc: float = 1.0
    smoothness: float = 0.0
    clock_master: int | None = None  # index of the axis whose drive is; None: the host
    sync_producer: int | None = None


class _Step(NamedTuple):
    """The last controlword of a walk through the CiA 402 states."""

    state: State
    sent_us: float


class Group:
    """The protocol of a group of EPOS2 axes on one bus."""

    def __init__(self, setups: Sequence[AxisSetup], settings: GroupSettings) -> None:
        self.axes = [
            Axis(
                setup,
                PathAudit(
                    setup.fit.velocity_unit_qc_s, settings.tolerance_qc, settings.sync_period_us
                ),
                n == settings.clock_master,
            )
            for n, setup in enumerate(setups)
        ]
        self.settings = settings
        self.phase = Phase.DISABLED
        self.outbox: deque[Frame] = deque()
        self.clearing: deque[int] = deque()  # axes whose buffer is to be cleared (0x60C4-06)
        self.events: deque[Event] = deque()
        self.deadline_us = -math.inf
        self._hosts_sync = settings.sync_producer is None
        self.time = Timekeeper(
            self.axes,
            settings.sync_period_us,
            self.outbox,
            settings.clock_master,
            self._hosts_sync,
        )
        self._silence = Silence(len(self.axes))
        self.start_us: float | None = None  # host time of the start SYNC: path time zero
        self._start_master_us = 0.0  # the same by the master's clock
        self.reason = ""  # why the last motion was aborted, or what is wrong now
        self.feeder = Feeder(
            self.axes, settings.buffer_time_ms, settings.tolerance_qc, settings.smoothness
        )
        self.reads = BufferReads(self.axes, settings.buffer_time_ms)
        self._now_us = -math.inf
        self._requests: list[Future[None]] = []  # that end with what the group is at
        self._disable_next: Future[None] | None = None  # as soon as the axes are at rest
        self._when_started: list[Callable[[], None]] = []  # what waits for the start SYNC
        self.motion: Future[End] | None = None  # ends with the motion in progress
        self._next: tuple[Reference, float | None] | None = None  # begins when buffers are empty
        self._end = End.ARRIVED
        self._faulted = False  # somebody has to reset it
        self._phase_us = -math.inf  # since when the group is in this phase
        self._steps: dict[int, _Step] = {}
        self._uncleared: Counter[int] = Counter()  # buffers asked to be cleared, by axis
        self._moved = True  # the axes, since their demand was last read
        self._planned_start_us: float | None = None
        self._fed_us = -math.inf  # when the last record before the start was handed over
        # By node id: synchronous controlwords that are not yet seen on the bus, and since when.
        self._unseen: Counter[int] = Counter()
        self._unseen_us = -math.inf
        self._latched = False  # a SYNC is still to make the last of them count
        self._halt_is_fault = False
        self._quick_stopped: set[int] = set()  # axes by index that the halt did not stop
        self._said = ""  # of the fault in the log
        self._why = ""  # the axes were halted, …
        self._when = ""  # … and how long after the start
        self._handlers: dict[int, Callable[[bytes, float], None]] = {}
        self._echo_handlers: dict[int, Callable[[float], None]] = {
            epos2.SYNC: self._on_sync,
            epos2.TIME: self.time.clock.reset,
        }
        if not self._hosts_sync:
            self._handlers[epos2.SYNC] = lambda data, t_us: self._on_sync(t_us)
        for index in range(len(self.axes)):
            self._subscribe(index)

    # ------------------------------------------------------------------ frames in

    def _subscribe(self, index: int) -> None:
        axis = self.axes[index]

        def tpdo3(data: bytes, t_us: float) -> None:
            latched = axis.on_tpdo3(data, t_us)
            axis.audit.on_clock(latched, t_us)
            self.time.on_answer(index, latched, t_us)

        def tpdo4(data: bytes, t_us: float) -> None:
            axis.on_tpdo4(data, t_us)
            if axis.demand_qc is not None:
                self._off_path(axis, axis.audit.on_demand(axis.demand_qc, t_us))

        def emergency(data: bytes, t_us: float) -> None:
            if axis.on_emergency(data):
                self._trouble()

        def heartbeat(data: bytes, t_us: float) -> None:
            if data == b"\x00":  # boot-up: its configuration is gone
                axis.restarted = True
                self._trouble()

        def sdo_answer(data: bytes, t_us: float) -> None:
            if (free := epos2.free_records(data)) is not None:
                self._on_free_records(index, free, t_us)

        def asked(t_us: float) -> None:
            axis.asked_us = t_us

        node = axis.node_id
        for cob_id, handler in (
            (epos2.TPDO1 + node, axis.on_tpdo1),
            (epos2.TPDO2 + node, axis.on_tpdo2),
            (epos2.TPDO3 + node, tpdo3),
            (epos2.TPDO4 + node, tpdo4),
            (epos2.EMCY + node, emergency),
            (epos2.HEARTBEAT + node, heartbeat),
            (epos2.SDO_ANSWER + node, sdo_answer),
        ):
            self._handlers[cob_id] = self._heard(index, handler)
        self._echo_handlers[epos2.SDO_REQUEST + node] = asked
        self._echo_handlers[epos2.RPDO1 + node] = lambda t_us: axis.account.seen_on_bus(t_us)
        self._echo_handlers[epos2.RPDO2 + node] = lambda t_us: self._seen(node)
        self._echo_handlers[epos2.RPDO3 + node] = lambda t_us: self.time.on_stamp(index)

    def _heard(
        self, index: int, handler: Callable[[bytes, float], None]
    ) -> Callable[[bytes, float], None]:
        axis = self.axes[index]

        def receive(data: bytes, t_us: float) -> None:
            axis.heard_us = t_us
            self._silence.heard(index)
            handler(data, t_us)
            if axis.statusword & cia402.FAULT_BIT:
                self._trouble()

        return receive

    def receive(self, frame: Frame, t_us: float, echo: bool = False) -> None:
        """Take in a frame from the bus; `echo` marks one of our own, `t_us` when it was sent.

        Call `advance` afterwards.
        """
        self._silence.listened(t_us)
        if echo:
            if on_echo := self._echo_handlers.get(frame.can_id):
                on_echo(t_us)
        elif handler := self._handlers.get(frame.can_id):
            handler(frame.data, t_us)

    def _seen(self, node_id: int) -> None:
        """A synchronous controlword of a drive was on the bus."""
        self._unseen -= Counter((node_id,))

    def _on_sync(self, t_us: float) -> None:
        late = len(self._unseen)
        self._latched &= late > 0
        if late and self.phase is Phase.CANCELLING:  # of a drive: some have started
            self._halt_is_fault = False
            self._halt_all()
        elif not self._hosts_sync and self.phase is Phase.ARMING:
            self._enter(Phase.STARTING)
            if late:
                self.start_us = t_us
                self._stop_all(
                    f"SYNC came before the start controlword was on the bus for {late} axes"
                )
        starts = self.phase is Phase.STARTING and self.start_us is None
        if starts:
            self.start_us, self._start_master_us = t_us, self.time.clock.master_us(t_us)
        self.time.on_sync(t_us, begins_path=starts)
        for axis in self.axes:
            self._off_path(axis, axis.audit.on_sync(t_us, starts))
        if starts:
            self._now_us = max(self._now_us, t_us)
            self._begun()

    # ------------------------------------------------------------------ requests

    def start_clock(self, now_us: float, time_of_day: bytes) -> None:
        """Begin with TIME (which sets every drive's motion clock to zero), SYNC and heartbeat.

        Call it when all drives are brought up; from now on they are watched.
        """
        self.time.start(now_us, time_of_day)
        for index, axis in enumerate(self.axes):
            axis.heard_us = now_us
            self._silence.heard(index)
        self.advance(now_us)

    def enable(self) -> Future[None]:
        """Bring every drive to "operation enabled", holding its position."""
        request: Future[None] = Future()
        if self.phase is Phase.FAULT:
            request.set_exception(DriveError(f"can't enable: {self.reason}; reset the fault first"))
        elif self._disable_next is not None:
            request.set_exception(DriveError("can't enable: the drives are about to be disabled"))
        elif self.phase is Phase.DISABLED:
            self._accept(request, Phase.ENABLING)
        elif self.phase is Phase.STANDING or self.phase in IN_MOTION:
            request.set_result(None)
        elif self.phase in _GETTING_ENABLED:
            self._requests.append(request)
        else:
            request.set_exception(DriveError(f"can't enable while {self.phase.value}"))
        return request

    def disable(self) -> Future[None]:
        """Switch all drives off where they stand.

        What has not begun does not begin; axes that move are switched off when they have come to
        rest, which is the caller's to see to.
        """
        request: Future[None] = Future()
        if self.phase is Phase.DISABLING:
            self._requests.append(request)
        elif self.phase in BEGUN or self.phase in (Phase.HALTING, Phase.QUICK_STOPPING):
            if self._disable_next is not None:
                self._disable_next.add_done_callback(lambda other: _copy(other, request))
            else:
                self._disable_next = request
        else:
            self._drop_motion("the drives are to be disabled")
            self._take_back(cia402.SHUTDOWN)
            self._accept(request, Phase.DISABLING)
        return request

    def halt(self, reason: str = HALTED) -> Future[None]:
        """Stop every axis on its own ramp (profile deceleration), at once; then hold."""
        request: Future[None] = Future()
        if self.phase in NOT_BEGUN:
            return self.cancel(reason)
        self._drop_motion(reason)
        if self.phase in BEGUN:
            self._once_started(request, lambda: self._stop_all(reason, fault=False))
        elif self.phase in (Phase.HALTING, Phase.QUICK_STOPPING, Phase.CANCELLING):
            self._requests.append(request)
        else:
            request.set_result(None)
        return request

    def quick_stop(self) -> Future[None]:
        """Stop every axis on its quick stop ramp; the drives leave "operation enabled"."""
        request: Future[None] = Future()
        if self.phase is Phase.DISABLED:
            request.set_result(None)
        elif self.phase is Phase.QUICK_STOPPING:
            self._requests.append(request)
        else:
            self._fail_requests("given up for another request (quick stop)")
            self._drop_motion(QUICK_STOPPED)
            self._once_started(request, self._quick_stop)
        return request

    def reset_fault(self) -> Future[None]:
        """Leave the fault state; the axes stay off until they are enabled."""
        request: Future[None] = Future()
        if self.phase is Phase.RESETTING:
            self._requests.append(request)
        elif self.phase is Phase.FAULT:
            self._accept(request, Phase.RESETTING)
            self._said = ""
            for axis in self.axes:
                axis.emergency = 0
        elif self.phase is Phase.HALTING and self._halt_is_fault:
            request.set_exception(DriveError(f"still halting: {self.reason}"))
        else:
            request.set_result(None)
        return request

    def cancel(self, reason: str) -> Future[None]:
        """What is to begin does not, and the axes go on standing; answered when that is certain.

        Only for a motion that has not begun (`standing`).
        """
        request: Future[None] = Future()
        self._drop_motion(reason)
        if self.phase in NOT_BEGUN:
            self._cancel()
        if self.phase is Phase.STANDING:
            request.set_result(None)
        else:
            self._requests.append(request)
        return request

    def reconfigured(self, index: int, statusword: int, now_us: float) -> None:
        """The drive of axis `index` was brought up anew and answers with `statusword`."""
        axis = self.axes[index]
        del self._uncleared[index]  # whatever became of that
        axis.restarted = False
        axis.heard_us = now_us
        self._silence.heard(index)
        axis.report(statusword, now_us)

    def fail(self, reason: str) -> None:
        """Something is wrong that no drive says: stop all, and be in fault."""
        if self.phase in IN_MOTION:
            self._once_started(None, lambda: self._stop_all(reason))
        elif self.phase not in (Phase.FAULT, Phase.HALTING, Phase.RESETTING):
            self._settle_fault(reason)

    def bus_failed(self, reason: str) -> None:
        """Nothing gets through any more: the drives stop by themselves, the group is in fault."""
        self._unseen.clear()
        self._settle_fault(reason)

    def lost_axes(self) -> list[int]:
        """Axes to be brought up anew: restarted, silent, clock astray, or without their SYNC."""
        missing = self.settings.sync_producer if self.time.sync_missing(self._now_us) else None
        return [
            index
            for index, axis in enumerate(self.axes)
            if axis.restarted or self.silent(index) or self.time.astray(index) or index == missing
        ]

    def buffer_cleared(self, index: int, error: str = "") -> None:
        """Answer to a request in `clearing`: access to the buffer is enabled and it is empty."""
        self._uncleared -= Counter((index,))
        if error:
            self._settle_fault(f"{self.axes[index]}: {error}")

    @property
    def moving(self) -> bool:
        """Whether the start SYNC has been handed over, and the axes are not yet at rest."""
        return self.phase in BEGUN

    @property
    def standing(self) -> bool:
        """Whether a motion can begin where the axes stand: also in place of one that has not."""
        return self._disable_next is None and (
            self.phase in NOT_BEGUN
            or self.phase in (Phase.STANDING, Phase.CANCELLING)
            or (self.phase is Phase.CLEARING and not self._moved)
        )

    def buffer_not_read(self, index: int, error: str) -> None:
        """An axis in `reads.outbox` could not be asked.

        Without its answer no motion starts; one in progress goes on.
        """
        if self.reads.unanswered(index):
            if self.phase is Phase.PRIMING:
                self._stop_all(error)
            elif self.phase is Phase.MOVING:
                self.announce("warning", error)

    def begin(self, reference: Reference, start_us: float | None = None) -> None:
        """Start a motion from rest; its SYNC goes out at `start_us`, or as soon as possible.

        Of the SYNCs that a drive sends it is the nearest that can still be armed for.

        `motion` then ends with it: a result when all axes rest at its end, `MotionStopped` when
        it was cancelled, `MotionAborted` when it was halted. One that has not begun is cancelled
        for it. `TrajectoryError` when no motion can begin.
        """
        if not self.standing:
            raise TrajectoryError(f"can't move: the drives are {self.describe_phase()}")
        self._drop_motion("another trajectory came before it began")
        self.reason = ""
        self.start_us = None
        self._planned_start_us = start_us
        self._end = End.ARRIVED
        if start_us is not None and start_us > self._now_us + WAIT_SAID_US:
            ahead_s = (start_us - self._now_us) / 1e6
            self.announce("waiting", f"the trajectory waits for its stamp, {ahead_s:.1f} s ahead")
        self.motion = Future()
        self._next = reference, start_us
        if self.phase in NOT_BEGUN:
            self._cancel()
        elif self.phase is Phase.STANDING:
            self._begin_next()

    def replace(self, reference: Reference, end: End = End.ARRIVED) -> None:
        """Go on along `reference`, equal to the current one up to the end of what is committed."""
        self.feeder.replace(reference)
        self._end = end

    def _begin_next(self) -> None:
        """The motion that waited for the buffers to be empty."""
        assert self._next is not None
        (reference, start_us), self._next = self._next, None
        self._planned_start_us = start_us
        self.feeder.begin(reference)
        self.reads.begin()
        self._enter(Phase.PRIMING)
        self.time.before_path(max(self._now_us, (start_us or -math.inf) - 2 * LEAD_US))

    # ------------------------------------------------------------------ what is known

    def path_ms(self, now_us: float) -> float | None:
        """Path time at `now_us`; None before the start SYNC."""
        return None if self.start_us is None else (now_us - self.zero_us(now_us)) / 1000

    def zero_us(self, now_us: float) -> float:
        """Host time of path time zero; before the start SYNC, as far as is known.

        Path time goes by the master's clock. Where that is a drive's, the zero wanders with it.
        """
        if self.start_us is None:
            return self._planned_start_us or now_us
        if self.settings.clock_master is None:
            return self.start_us
        return now_us - self.time.clock.master_us(now_us) + self._start_master_us

    @property
    def start_error_us(self) -> float | None:
        """How much after the time asked for the last motion began; None: none was asked for."""
        if self.start_us is None or self._planned_start_us is None:
            return None
        return self.start_us - self._planned_start_us

    def announce(self, kind: str, text: str) -> None:
        """Add an event for the log."""
        self.events.append(Event(kind, text))

    def describe_phase(self) -> str:
        """The phase in words, with the reason where there is one."""
        return f"{self.phase.value} ({self.reason})" if self.reason else self.phase.value

    # ------------------------------------------------------------------ time

    def advance(self, now_us: float) -> None:
        """Do what is due at `now_us`, and set `deadline_us`."""
        self._now_us = now_us
        self._watch_drives()
        self._watch_take_back()
        self._progress()
        self.time.advance(now_us, self._may_sync())
        self.deadline_us = min(self.time.deadline_us(self._may_sync()), self._phase_deadline_us())

    def _may_sync(self) -> bool:
        """Between arming and the start no SYNC but the start's; none overtakes a controlword."""
        return self.phase is not Phase.ARMING and not self._unseen

    def _enter(self, phase: Phase) -> None:
        self.phase = phase
        self._phase_us = self._now_us
        self._steps.clear()
        if phase is not Phase.STARTING:
            self._when_started.clear()
        if phase not in IN_MOTION:
            self.time.after_path()

    def _accept(self, request: Future[None], phase: Phase) -> None:
        self._fail_requests(f"given up for another request ({phase.value})")
        self._requests.append(request)
        self._enter(phase)

    def _once_started(self, request: Future[None] | None, action: Callable[[], None]) -> None:
        """Do `action` now, or with a start SYNC that is on its way: it can't be called back.

        A halt that got ahead of that SYNC would be undone by the controlword it makes count.
        """
        if request is not None:
            self._requests.append(request)
        if self.phase is Phase.STARTING and self.start_us is None:
            self._when_started.append(action)
        else:
            action()

    def _begun(self) -> None:
        self._moved = True
        actions, self._when_started = self._when_started, []
        for action in actions:
            action()

    def _phase_deadline_us(self) -> float:
        if self.phase in (Phase.DISABLED, Phase.STANDING, Phase.FAULT):
            return math.inf
        if self.phase is Phase.MOVING and self.start_us is not None:
            end_ms = self.feeder.committed_ms + END_TIMEOUT_MS
            due_ms = min(self.feeder.due_ms, end_ms)
            due_us = self.zero_us(self._now_us) + 1000 * due_ms + ROUNDING_US
            return min(due_us, self.reads.due_us)
        if self.phase is Phase.PRIMING and self.feeder.due_ms <= 0:
            return self._now_us
        if self.phase is Phase.PRIMING and self.reads.unreported():
            return self._now_us + RESEND_US / 4
        if self.phase is Phase.PRIMING and self._arm_due_us() > self._now_us:
            return self._arm_due_us()
        if self.phase is Phase.ARMING and self._hosts_sync:
            due = self._start_due_us()
            return due if due > self._now_us else self._now_us + RESEND_US
        return self._now_us + RESEND_US / 4

    # ------------------------------------------------------------------ phases

    def _progress(self) -> None:
        match self.phase:
            case Phase.ENABLING | Phase.DISABLING | Phase.RESETTING:
                self._walk()
            case Phase.CANCELLING:
                if not self._unseen:
                    self._clear_buffers()
            case Phase.CLEARING:
                if not self._uncleared and self._moved:
                    self._enter(Phase.SETTLING)
                elif not self._uncleared:
                    self._stand()
            case Phase.SETTLING:
                self._settle()
            case Phase.PRIMING:
                self._prime()
            case Phase.ARMING:
                self._arm()
            case Phase.STARTING:
                self._confirm_start()
            case Phase.MOVING:
                self._move()
            case Phase.HALTING:
                self._finish_halt()
            case Phase.QUICK_STOPPING:
                self._finish_quick_stop()
            case Phase.DISABLED | Phase.STANDING | Phase.FAULT:
                pass

    def _walk(self) -> None:
        """One transition for every axis that is not where the phase wants it."""
        if self._latched and self.phase is Phase.ENABLING:
            return  # what the next SYNC makes count would undo it
        target = _WALK_TARGET[self.phase]
        waiting = []
        for axis in self.axes:
            if self._arrived(axis, target):
                continue
            waiting.append(axis)
            last = self._steps.get(axis.node_id)
            if last and last.state is axis.state and self._now_us < last.sent_us + RESEND_US:
                continue
            controlword = cia402.step(axis.state, target)
            if controlword is None or axis.powering_up:
                continue
            if controlword == cia402.FAULT_RESET:  # bit 7 has to rise
                self.outbox.append(axis.controlword(cia402.DISABLE_VOLTAGE))
            self.outbox.append(axis.controlword(controlword))
            self._steps[axis.node_id] = _Step(axis.state, self._now_us)
        if not waiting:
            self._walked()
        elif self._now_us > self._phase_us + STOP_TIMEOUT_US:
            self._settle_fault(
                f"{self.phase.value}: "
                + "; ".join(
                    f"{axis} is in {axis.state.value}"
                    + (f": {trouble}" if (trouble := axis.trouble()) else "")
                    for axis in waiting
                )
            )

    def _arrived(self, axis: Axis, target: State) -> bool:
        if self.phase is Phase.DISABLING and axis.state is State.FAULT:
            return True  # its power stage is off; the fault stays for whoever resets it
        return axis.state is target

    def _walked(self) -> None:
        if self.phase is Phase.ENABLING:
            self._moved = True
            self._clear_buffers()
        else:
            self._faulted &= self.phase is not Phase.RESETTING
            self._off()

    def _off(self) -> None:
        """The drives are off, or in quick stop: the request is granted, a fault stays one."""
        faulty = self._faulted or any(axis.state is State.FAULT for axis in self.axes)
        self._enter(Phase.FAULT if faulty else Phase.DISABLED)
        if not faulty:
            self.reason = ""
        self._grant_requests()
        self._disable_if_asked()

    def _clear_buffers(self) -> None:
        """Clear and enable every buffer; then the next SYNC brings the position demand."""
        self._enter(Phase.CLEARING)
        every = range(len(self.axes))
        self._uncleared += Counter(every)
        self.clearing.extend(every)

    def _stand(self) -> None:
        """All axes are enabled and hold, their buffers empty."""
        self._moved = False
        self._enter(Phase.STANDING)
        if self.motion is None:
            self.reason = ""
        self._grant_requests()
        if not self._disable_if_asked() and self._next is not None:
            self._begin_next()

    def _disable_if_asked(self) -> bool:
        """Whether the axes, now at rest, are to be switched off."""
        request, self._disable_next = self._disable_next, None
        if request is None:
            return False
        self._drop_motion("the drives are to be disabled")
        self._accept(request, Phase.DISABLING)
        return True

    def _settle(self) -> None:
        """Motion can begin once every drive has said, since it stands, where its demand is.

        And once the clocks are known: before that a time stamp can be wrong by what the host was
        late, and would jolt an axis in motion.
        """
        late = [
            axis
            for axis in self.axes
            if axis.demand_us <= self._phase_us or axis.statusword_us <= self._phase_us
        ]
        timeout_us = REPLY_TIMEOUT_US + SETTLING_SYNCS * self.settings.sync_period_us
        if not late and self.time.clock.settled:
            for axis in self.axes:
                axis.audit.rest(axis.demand_qc or 0)
            self._stand()
        elif self._now_us > self._phase_us + timeout_us:
            names = ", ".join(str(axis) for axis in late)
            self._settle_fault(
                f"no answer to SYNC from {names}"
                if late
                else "the drives' clocks don't go by the times of SYNC that the host sees"
            )

    # ------------------------------------------------------------------ start

    def _prime(self) -> None:
        """Wait until every drive has reported every record, and for the time to arm."""
        if self._feed():
            self._fed_us = self._now_us
            return
        missing = self.reads.unreported()
        self.reads.ask_all(self._now_us)
        if not missing:
            if not self.time.clear or not self._may_arm():
                return
            self._enter(Phase.ARMING)
            start = cia402.ENABLE_OPERATION | epos2.ENABLE_IP_MODE
            self._synchronous([start] * len(self.axes))
        elif self._now_us > self._fed_us + REPLY_TIMEOUT_US:
            axis = missing[0]
            self._stop_all(
                f"{axis} reports {axis.account.level(None)} records in its buffer where "
                f"{axis.account.sent} were sent"
            )

    def _arm_due_us(self) -> float:
        """The earliest time to arm."""
        if self._hosts_sync:
            return (self._planned_start_us or -math.inf) - LEAD_US
        return self.time.answered_us

    def _may_arm(self) -> bool:
        if self._now_us < self._arm_due_us():
            return False
        if self._hosts_sync:
            return True
        next_us = self.time.next_sync_us
        nearest_us = (self._planned_start_us or -math.inf) - self.settings.sync_period_us / 2
        return self._now_us <= next_us - LEAD_US and next_us >= nearest_us

    def _arm(self) -> None:
        """All controlwords seen on the bus: now the SYNC that makes them count."""
        if self._unseen:
            if self._now_us > self._phase_us + REPLY_TIMEOUT_US:
                self._stop_all(
                    f"the start controlword was not seen on the bus for {len(self._unseen)} axes"
                )
        elif self._hosts_sync and self.time.clear and self._now_us >= self._start_due_us():
            self._enter(Phase.STARTING)
            self.time.sync(self._now_us)

    def _start_due_us(self) -> float:
        """When the start SYNC goes out: not before the answers to the last SYNC are through."""
        return max(self._planned_start_us or -math.inf, self.time.answered_us)

    def _confirm_start(self) -> None:
        if self.start_us is None:
            if self._now_us > self._phase_us + REPLY_TIMEOUT_US:
                self._stop_all("the start SYNC was not seen on the bus")
            return
        self._feed()
        inactive = [
            axis for axis in self.axes if axis.active_us < self.start_us and not self._over(axis)
        ]
        if not inactive:
            self._enter(Phase.MOVING)
            text = f"{len(self.axes)} axes started on one SYNC"
            if self.start_error_us is not None:
                text += f", {self.start_error_us:.0f} us after the time asked for"
            self.events.append(Event("started", text))
            self._move()
        elif self._now_us > self.start_us + ACTIVE_TIMEOUT_US:
            names = ", ".join(f"{axis} ({axis.state.value})" for axis in inactive)
            self._stop_all(f"ip mode not active after the start SYNC: {names}")

    def _over(self, axis: Axis) -> bool:
        """Whether a drive has come to the end of its records, and has said so since."""
        ends_us = self.zero_us(self._now_us) + 1000 * axis.account.committed_ms
        return axis.account.ended and not axis.ip_active and axis.statusword_us > ends_us

    # ------------------------------------------------------------------ motion

    def _feed(self) -> bool:
        """One record for the axis that needs it most; False if none needs any."""
        try:
            frame = self.feeder.next(self.path_ms(self._now_us) or 0.0)
        except TrajectoryError as error:
            self._stop_all(str(error))
            return False
        if frame is not None:
            self.outbox.append(frame)
        return frame is not None

    def _move(self) -> None:
        self._feed()
        if self.phase is not Phase.MOVING:
            return
        self.reads.watch(self._now_us)
        path_ms = self.path_ms(self._now_us)
        assert path_ms is not None
        active = [axis for axis in self.axes if axis.ip_active]
        for axis in self.axes:
            account = axis.account
            gone = not axis.ip_active
            if gone and not (account.ended and path_ms > account.committed_ms - 50):
                self._stop_all(f"{axis} left interpolated position mode on its own")
                return
        if not active:
            self._finish_motion()
        elif path_ms > self.feeder.committed_ms + END_TIMEOUT_MS and self.feeder.ending:
            self._stop_all(f"{active[0]} is still active after its end record")

    def _on_free_records(self, index: int, free: int, t_us: float) -> None:
        asked_us = self.axes[index].asked_us
        from_ms, to_ms = self.path_ms(asked_us), self.path_ms(t_us)
        wrong = self.reads.answer(index, free, asked_us, from_ms, to_ms)
        if wrong and self.phase is Phase.MOVING:
            self._stop_all(f"{self.axes[index]}: {wrong}")

    def _off_path(self, axis: Axis, wrong: str) -> None:
        """What the audit of the executed path says, where a path is executed or all stand."""
        if wrong and self.phase in IN_MOTION:
            self.fail(f"{axis}: {wrong}")
        elif wrong and self.phase is Phase.STANDING:
            self._stop_all(f"{axis}: {wrong}")

    def _finish_motion(self) -> None:
        """All axes stand at their ends, enabled; bit 4 has to fall so that it can rise again."""
        for axis in self.axes:
            self.outbox.append(axis.controlword(cia402.ENABLE_OPERATION))
            axis.demand_qc = axis.account.last_position_qc
        motion, self.motion = self.motion, None
        self.events.append(Event("done", self._end.value))
        if motion:
            motion.set_result(self._end)
        self._stand()

    # ------------------------------------------------------------------ stopping and trouble

    def _synchronous(self, controlwords: Sequence[int]) -> None:
        """In the drives' synchronous RPDOs; no SYNC of ours goes out before they are on the bus."""
        self._latched, self._unseen_us = True, self._now_us
        for axis, controlword in zip(self.axes, controlwords, strict=True):
            self._unseen += Counter((axis.node_id,))
            self.outbox.append(axis.synchronous_controlword(controlword))

    def _take_back(self, controlword: int | None = None) -> None:
        """Let the next SYNC bring `controlword`, if one is to bring any; None: let it change
        nothing."""
        if self._latched:
            self._synchronous(
                [
                    _NO_CHANGE.get(axis.state, cia402.DISABLE_VOLTAGE)
                    if controlword is None
                    else controlword
                    for axis in self.axes
                ]
            )

    def _watch_take_back(self) -> None:
        """No SYNC goes out while a controlword is on its way, so that can't be for ever."""
        if self._unseen and self._now_us > self._unseen_us + REPLY_TIMEOUT_US:
            if self.phase is Phase.ARMING:
                return  # which has words of its own
            names = ", ".join(str(axis) for axis in self.axes if axis.node_id in self._unseen)
            self._unseen.clear()
            self.fail(f"a controlword was not seen on the bus for {names}")

    def _cancel(self) -> None:
        """Take back what has not begun, then empty the buffers."""
        self._take_back()
        self._enter(Phase.CANCELLING)

    def _drop_motion(self, reason: str) -> None:
        """A motion that has not begun, or waits for empty buffers, is not going to begin."""
        if self._next is None and self.phase not in NOT_BEGUN:
            return
        self._next = None
        motion, self.motion = self.motion, None
        if motion:
            text = f"cancelled before it began: {reason}"
            self.events.append(Event("cancelled", text))
            motion.set_exception(MotionStopped(text))

    def _stop_all(self, reason: str, fault: bool = True) -> None:
        """Halt every axis that is in operation; `_finish_halt` goes on when they stand.

        A fault takes a reset before anything moves again.
        """
        self._why, self._when = reason, ""
        path_ms = self.path_ms(self._now_us)
        if fault and self.phase in BEGUN and path_ms is not None:
            self._when = f", {path_ms / 1000:.3f} s into the motion"
        self.reason = reason + self._when
        self._halt_is_fault = fault
        if fault:
            self._say_fault(self.reason)
            self._fail_requests(f"given up: {reason}")
        self._halt_all()

    def _halt_all(self) -> None:
        """Who may be moving keeps bit 4 beside the halt, so that it brakes on its ramp."""
        self._take_back()
        still = self.phase in NOT_BEGUN or self.phase is Phase.STANDING
        moving = 0 if still else epos2.ENABLE_IP_MODE
        self._quick_stopped.clear()
        self._enter(Phase.HALTING)
        for axis in self.axes:
            if axis.state is State.OPERATION_ENABLED:
                self.outbox.append(axis.controlword(cia402.ENABLE_OPERATION | moving | cia402.HALT))

    def _quick_stop(self) -> None:
        self._take_back(cia402.QUICK_STOP)
        if self.phase is not Phase.FAULT:
            self.reason = QUICK_STOPPED
        self._fail_motion(self.reason)
        self._enter(Phase.QUICK_STOPPING)
        for axis in self.axes:
            if axis.state is State.OPERATION_ENABLED:
                self.outbox.append(axis.controlword(cia402.QUICK_STOP))

    def _finish_halt(self) -> None:
        """When all stand: clear bit 4 first, then release the halt, or motion starts again."""
        late = [index for index in range(len(self.axes)) if not self._halted(index)]
        complaints = self._complaints()
        if late and self._now_us <= self._phase_us + STOP_TIMEOUT_US:
            self._quick_stop_who_does_not_halt(late)
            return
        for axis in self.axes:
            if axis.state is State.OPERATION_ENABLED:
                self.outbox.append(axis.controlword(cia402.ENABLE_OPERATION | cia402.HALT))
                self.outbox.append(axis.controlword(cia402.ENABLE_OPERATION))
        names = ", ".join(str(self.axes[index]) for index in late)
        if late:
            self._settle_fault(f"{self.reason}; not at rest after halt and quick stop: {names}")
        elif self._halt_is_fault:
            known = self._why in complaints
            why = complaints if known else f"{self._why}; {complaints}".rstrip("; ")
            self._settle_fault(why + self._when)
        elif complaints:
            self._settle_fault(complaints)
        elif self._quick_stopped:
            names = ", ".join(str(self.axes[index]) for index in sorted(self._quick_stopped))
            self._settle_fault(f"{self.reason}; stopped by quick stop, as the halt failed: {names}")
        else:
            if self._next is None:
                self._fail_motion(self.reason)
            self._moved = True
            self._clear_buffers()

    def _quick_stop_who_does_not_halt(self, late: Sequence[int]) -> None:
        """Ip mode ends at once with a halt (note, table 7); the ramp may take its time, half of
        what there is."""
        if self._now_us <= self._phase_us + HALT_REACTION_US:
            return
        on_ramp = self._now_us <= self._phase_us + STOP_TIMEOUT_US / 2
        for index in late:
            axis = self.axes[index]
            if index in self._quick_stopped or (on_ramp and not axis.ip_active):
                continue
            if axis.state is State.OPERATION_ENABLED:
                self._quick_stopped.add(index)
                self.outbox.append(axis.controlword(cia402.QUICK_STOP))

    def _halted(self, index: int) -> bool:
        axis = self.axes[index]
        if axis.restarted or self.silent(index):
            return True  # nothing to wait for; it has no power, or its own watch stops it
        at_rest = bool(axis.statusword & cia402.TARGET_REACHED)
        if axis.state is State.OPERATION_ENABLED:
            return axis.statusword_us > self._phase_us and not axis.ip_active and at_rest
        if axis.state is State.QUICK_STOP_ACTIVE:
            return at_rest
        return axis.state is not State.FAULT_REACTION_ACTIVE

    def _finish_quick_stop(self) -> None:
        moving = [
            axis
            for axis in self.axes
            if axis.state in (State.OPERATION_ENABLED, State.FAULT_REACTION_ACTIVE)
            or (
                axis.state is State.QUICK_STOP_ACTIVE
                and not axis.statusword & cia402.TARGET_REACHED
            )
        ]
        if not moving:
            self._faulted |= bool(self._complaints())
            self._off()
        elif self._now_us > self._phase_us + STOP_TIMEOUT_US:
            self._settle_fault(
                "quick stop: " + ", ".join(f"{axis} is in {axis.state.value}" for axis in moving)
            )

    def silent(self, index: int) -> bool:
        """Whether a drive is not heard any more."""
        return self.time.running and self._silence.silent(index)

    def _watch_drives(self) -> None:
        """What no frame tells: silence, and clocks that are off."""
        watched = self.phase not in (Phase.FAULT, Phase.HALTING, Phase.RESETTING)
        if watched and (
            any(self.silent(n) or self._clock_trouble(n) for n in range(len(self.axes)))
            or self.time.sync_missing(self._now_us)
        ):
            self._trouble()

    def _clock_trouble(self, index: int) -> str:
        """What is wrong with the clock of a drive, or ""; in motion it takes less."""
        return self.time.trouble(index, self.phase in BEGUN)

    def _complaints(self) -> str:
        """What is wrong with the drives, axis by axis; "" if nothing."""
        words = []
        for index, axis in enumerate(self.axes):
            if self.silent(index):
                words.append(f"{axis} is silent: check its power and the bus")
            elif axis.restarted:
                words.append(f"{axis} has restarted: was its power off?")
            elif trouble := axis.trouble() or self._clock_trouble(index):
                words.append(f"{axis}: {trouble}")
        if self.settings.sync_producer is not None and self.time.sync_missing(self._now_us):
            words.append(f"no SYNC from {self.axes[self.settings.sync_producer]}")
        return "; ".join(words)

    def _trouble(self) -> None:
        """An axis complains: all stop, whatever the group is doing."""
        if self.time.running:
            self.fail(self._complaints())

    def _settle_fault(self, reason: str) -> None:
        """Come to rest in the fault phase, which only somebody's request leaves."""
        self.reason = reason
        self._take_back()
        self._faulted = True
        self._enter(Phase.FAULT)
        self._say_fault(reason)
        self._fail_motion(reason)
        self._fail_requests(reason)
        self._disable_if_asked()

    def _say_fault(self, reason: str) -> None:
        """At once, and what has come to it when all stand."""
        if reason != self._said:
            self.events.append(Event("fault", reason))
        self._said = reason

    def _fail_motion(self, reason: str) -> None:
        self._next = None
        motion, self.motion = self.motion, None
        if motion:
            self.events.append(Event("stopped" if reason in ON_REQUEST else "aborted", reason))
            motion.set_exception(MotionAborted(reason))

    def _fail_requests(self, reason: str) -> None:
        requests, self._requests = self._requests, []
        for request in requests:
            request.set_exception(DriveError(reason))

    def _grant_requests(self) -> None:
        requests, self._requests = self._requests, []
        for request in requests:
            request.set_result(None)


def _copy(answer: Future[None], to: Future[None]) -> None:
    """The same answer once more."""
    if error := answer.exception():
        to.set_exception(error)
    else:
        to.set_result(None)
