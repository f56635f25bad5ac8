"""All axes of one bus as a single machine: enabled, started together, stopped together.

No I/O: frames and times go in (`receive`, `advance`); frames, SDO requests and events come out
(`out`), and `deadline_us` says when `advance` is wanted next. Times are host µs. What axes do while
they move is their modes' affair; who made a drive its family's.

The rules this file keeps:

* Motion starts as the application note says ("Motion Synchronisation"): what a mode wants in the
  drives is there, as the drives say; its start in every synchronous controlword RPDO, seen on the
  bus; then one SYNC, whose time on the bus is the zero of every axis' path. No other SYNC is sent
  between the first of those controlwords and that one. Where a drive sends SYNC, they go out right
  after one, and the next is the start.
* What has not begun never begins once it is stopped or replaced: until the start SYNC is handed
  over, the start is taken back in every drive, seen on the bus before the next SYNC, and what the
  drives were given for it is cleared.
* One axis in trouble stops all. Nothing starts again by itself.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence, Set
from concurrent.futures import Future
from typing import NamedTuple

from epos2_ros.errors import DriveError, MotionAborted, MotionStopped, TrajectoryError
from epos2_ros.protocol import cia402, epos2
from epos2_ros.protocol.cia402 import State
from epos2_ros.protocol.drive import Drive, names
from epos2_ros.protocol.frame import Frame
from epos2_ros.protocol.intake import NMT_PRE_OPERATIONAL, NMT_START
from epos2_ros.protocol.modes.mode import Mode
from epos2_ros.protocol.outbox import Outbox
from epos2_ros.protocol.path_time import PathTime
from epos2_ros.protocol.phase import (
    BEGUN,
    BRAKING,
    GETTING_ENABLED,
    HALTED,
    IN_MOTION,
    NOT_BEGUN,
    ON_REQUEST,
    QUICK_STOPPED,
    WALK_TARGET,
    End,
    Phase,
)
from epos2_ros.protocol.sdo import SdoRead, SdoWrite
from epos2_ros.protocol.synchronous import SynchronousControlwords
from epos2_ros.protocol.timekeeper import LEAD_US, Timekeeper
from epos2_ros.protocol.walk import RESEND_US, Walk
from epos2_ros.protocol.watch import Watch

SETTLING_SYNCS = 10  # as many periods, and REPLY_TIMEOUT_US, has a group to be ready in
REPLY_TIMEOUT_US = 1_000_000.0  # for one step of a drive that has been told something
READY_TIMEOUT_US = 3_000_000.0  # for a mode to be set, and what it takes to stand in it
_CLOCK = (epos2.HIGH_RESOLUTION_TIME_STAMP, 0)
UNKNOWN_MODE = 0  # of operation
STOP_TIMEOUT_US = 5_000_000.0  # for an axis to come to rest after a halt or quick stop
HALT_REACTION_US = 100_000.0  # a drive that has not begun to halt by then is quick-stopped
BRAKING_SYNC_US, FINDING_SYNC_US = 10_000.0, 20_000.0  # instead of the period, if that is longer
ROUNDING_US = 1.0  # so much later than due, path time has come to it whatever its last digit
STARTING_US = 1_000.0  # before all drives have started it is not looked more often than this
WAIT_SAID_US = 500_000.0  # a motion that waits longer than this for its stamp is told of


class Motion(NamedTuple):
    """Modes that begin together, at `start_us` or as soon as possible."""

    modes: tuple[Mode, ...]
    start_us: float | None


class Group:
    """The drives of one bus. `rest`: the mode in which each of them stands, ready to move."""

    def __init__(
        self, rest: Mapping[Drive, Mode], time: Timekeeper, path_time: PathTime, out: Outbox
    ) -> None:
        self.drives = tuple(rest)
        self.phase = Phase.DISABLED
        self.out = out
        self.deadline_us = -math.inf
        self.time = time
        self.path_time = path_time
        self.reason = ""  # why the last motion was aborted, or what is wrong now
        self.motion: Future[End] | None = None  # ends with the motion in progress or to come
        self.modes: tuple[Mode, ...] = ()  # of the motion in progress, or last
        self._taking_part: dict[Drive, Mode] = {}  # in the motion in progress, or last
        self._halted_again = False  # they were told twice
        self._braking: dict[Drive, Mode] = {}  # who is halted in motion
        self._held: dict[Drive, Mode] = {}  # halted, in a mode that would go on without the halt
        self._rest = dict(rest)
        self._words = SynchronousControlwords(self.drives, out)
        self._now_us = -math.inf  # of the last `advance`
        self._seen_us = -math.inf  # of that, or of the frame that is looked at
        self._requests: list[Future[None]] = []  # that end with what the group is at
        self._disable_next: Future[None] | None = None  # as soon as the axes are at rest
        self._when_started: list[Callable[[], None]] = []  # what waits for the start SYNC
        self._next: Motion | None = None  # begins when the axes stand
        self._end = End.ARRIVED
        self._arrived = False  # at the end of the motion, and not yet ready for the next
        self._faulted = False  # somebody has to reset it
        self._halt_is_fault = False
        self._quick_stopped: set[Drive] = set()  # that the halt did not stop
        self._said = ""  # of the fault in the log
        self._why = ""  # the axes were halted, …
        self._when = ""  # … and how long after the start
        self._watch = Watch(self.drives, time, out)
        self._moved = True  # the axes, since their demand was last read
        self._phase_us = -math.inf  # since when the group is in this phase
        self._handing_over = False  # a mode has more to give its drives
        self._handed_over_us = -math.inf  # when one last did
        self._walk = Walk(out)
        self._by_node = {drive.node_id: drive for drive in self.drives}
        self._clocked = {drive: index for index, drive in enumerate(time.drives)}

    # ------------------------------------------------------------------ frames in

    def receive(self, frame: Frame, t_us: float, echo: bool = False) -> None:
        """Take in a frame from the bus; `echo` marks one of our own, `t_us` when it was sent.

        Call `advance` afterwards.
        """
        self._watch.listened(t_us, echo)
        self._seen_us = t_us
        if frame.can_id == epos2.SYNC and echo is self.time.produces:
            self._on_sync(t_us)
        elif frame.can_id == epos2.NMT:
            if not echo and len(frame.data) == 2:
                self._on_nmt(*frame.data)
            elif echo and frame.data[0] == NMT_PRE_OPERATIONAL:
                self._watch.taken_in_hand(frame.data[1])
        elif drive := self._by_node.get(frame.can_id & 0x7F):
            if echo:
                self._on_echo(drive, frame, t_us)
            else:
                self._on_frame(drive, frame, t_us)
        elif frame.can_id == epos2.TIME and echo:
            self.time.clock.reset(t_us)
        elif frame.can_id in (epos2.SYNC, epos2.TIME):
            self.time.disturbed()

    def _on_echo(self, drive: Drive, frame: Frame, t_us: float) -> None:
        function = frame.can_id & 0x780
        if function == epos2.RPDO1:
            self._rest[drive].on_echo(drive, frame.data, t_us)
        elif function == epos2.RPDO2:
            self._words.on_echo(drive.node_id)
        elif function == epos2.RPDO3 and drive in self._clocked:
            self.time.on_stamp(self._clocked[drive])
        elif function == epos2.RPDO3:
            self._rest[drive].on_echo(drive, frame.data, t_us)
        elif function == epos2.SDO_REQUEST and frame.data == epos2.CLOCK_AT_SYNC.request:
            drive.asked_clock = True
            if drive in self._clocked:
                self.time.on_asked(t_us)
        elif function == epos2.SDO_REQUEST:
            drive.asked_us = t_us

    def _on_frame(self, drive: Drive, frame: Frame, t_us: float) -> None:
        function = frame.can_id & 0x780
        if frame.can_id in drive.pdo_bytes:
            self._on_report(drive, drive.on_pdo(frame.can_id, frame.data, t_us), t_us)
        elif function == epos2.EMCY:
            if drive.on_emergency(frame.data):
                self._trouble()
        elif function == epos2.HEARTBEAT:
            if self._watch.on_heartbeat(drive, frame.data):
                self._trouble()
        elif function == epos2.SDO_ANSWER:
            self._on_report(drive, drive.on_clock_answer(frame.data), t_us)
            self._off_path(drive, self._mode_of(drive).on_answer(drive, frame.data, t_us))
        else:
            return
        self._watch.heard(drive, t_us)
        if drive.statusword & cia402.FAULT_BIT:
            self._trouble()
        if self.phase is Phase.DISABLED and drive.state is State.OPERATION_ENABLED:
            self._walk.tell(drive, cia402.SHUTDOWN, self._now_us)  # whatever has enabled it

    def _on_nmt(self, command: int, node_id: int) -> None:
        """Another master's: what it stops does not listen to us any more."""
        if self._watch.on_nmt(command, node_id):
            if self.phase is Phase.HALTING:  # what was sent may come too late
                self._send_halts()
            else:
                self._trouble()

    def _on_report(self, drive: Drive, reported: Set[tuple[int, int]], t_us: float) -> None:
        """A drive has told these objects."""
        if not reported:
            return
        if _CLOCK in reported and not self._on_clock(drive, t_us):
            reported = reported - {_CLOCK}
        self._off_path(drive, self._mode_of(drive).on_report(drive, reported, t_us))

    def _on_clock(self, drive: Drive, t_us: float) -> bool:
        """A drive has told its clock at a SYNC; False: at one before the last."""
        index = self._clocked.get(drive)
        if index is None or drive.latched is None:
            return True
        return self.time.on_answer(index, drive.latched, t_us)

    def _off_path(self, drive: Drive, wrong: str) -> None:
        """What a mode says of what its drive reports, where it matters."""
        if not wrong:
            return
        if self.phase in IN_MOTION or self.phase is Phase.STANDING:
            self._watch.doubt((drive,))  # somebody may have told it something else
        if self.phase in IN_MOTION:
            self.fail(f"{drive}: {wrong}")
        elif self.phase is Phase.STANDING:
            self._stop_all(f"{drive}: {wrong}")

    def _mode_of(self, drive: Drive) -> Mode:
        """The mode that a drive is in."""
        rest = self._rest[drive]
        return self._taking_part.get(drive, rest) if self.phase in IN_MOTION else rest

    def _on_sync(self, t_us: float) -> None:
        self._watch.on_sync()
        self._words.on_sync()
        late = len(self._words.unseen)
        if late and self.phase is Phase.CANCELLING:  # of a drive: some have started
            self._halt_is_fault = False
            self._halt_all()
        elif not self.time.produces and self.phase is Phase.ARMING:
            self._enter(Phase.STARTING)
            if late:
                self.path_time.begin(t_us)
                self._stop_all(
                    f"SYNC came before the start controlword was on the bus for {late} axes"
                )
        starts = self.phase is Phase.STARTING and self.path_time.start_us is None
        if starts:
            self.path_time.begin(t_us)
        for drive in self.drives:
            drive.on_sync(t_us)
        self.time.on_sync(t_us, begins_path=starts)
        if starts:
            late_us = self.time.seen_late_us
            self.path_time.late_us = late_us if math.isfinite(late_us) else 0.0
        for drive in self.drives:
            begins = starts and drive in self._taking_part
            self._off_path(drive, self._mode_of(drive).on_sync(drive, t_us, begins))
        if starts:
            self._now_us = max(self._now_us, t_us)
            self._begun(t_us)

    # ------------------------------------------------------------------ requests

    def start_clock(self, now_us: float, time_of_day: bytes, echoes: bool = True) -> None:
        """Begin with TIME (which sets every drive's motion clock to zero), SYNC and heartbeat.

        Call it when all drives are brought up; from now on they are watched.
        """
        self.time.start(now_us, time_of_day, echoes)
        self._watch.clocks_begin()
        for drive in self.drives:
            self._watch.heard(drive, now_us)
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
        elif self.phase in GETTING_ENABLED:
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
            self._words.take_back(self._now_us, cia402.SHUTDOWN)
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
            for drive in self.drives:
                drive.emergency = 0
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

    def begin(self, modes: Sequence[Mode], start_us: float | None = None) -> None:
        """Start a motion from rest, of drives each in one of `modes`, which know what they are to
        do; its SYNC goes out at `start_us`, or as soon as possible.

        Of the SYNCs that a drive sends it is the nearest that can still be armed for.

        `motion` then ends with it: a result when all axes rest at its end, `MotionStopped` when
        it was cancelled, `MotionAborted` when it was halted. One that has not begun is cancelled
        for it. `TrajectoryError` when no motion can begin.
        """
        if not self.standing:
            raise TrajectoryError(f"can't move: the drives are {self.describe_phase()}")
        self._drop_motion("another motion came before it began")
        self.reason = ""
        self.path_time.plan(start_us)
        self._end = End.ARRIVED
        if start_us is not None and start_us > self._now_us + WAIT_SAID_US:
            ahead_s = (start_us - self._now_us) / 1e6
            text = f"the trajectory waits for its stamp, {ahead_s:.1f} s ahead"
            self.out.announce("waiting", text)
        self.motion = Future()
        self._next = Motion(tuple(modes), start_us)
        if self.phase in NOT_BEGUN:
            self._cancel()
        elif self.phase is Phase.STANDING:
            self._begin_next()

    def go_on(self, end: End) -> None:
        """The motion in progress goes on to another end; its mode knows the way."""
        self._end = end

    def reconfigured(
        self,
        drive: Drive,
        statusword: int,
        now_us: float,
        units: Sequence[float] | None = None,
    ) -> None:
        """A drive was brought up anew and answers with `statusword`.

        `units` of its motion objects, as it has said: velocity [qc/s], acceleration [qc/s²] and
        jerk [qc/s³]; None: those of its family.
        """
        if units is not None:
            drive.velocity_unit, drive.acceleration_unit, drive.jerk_unit = units
        if self._watch.may_have_restarted(drive):
            drive.homed = ""
        if statusword & drive.family.referenced_bit:
            drive.homed = drive.homed or "by an earlier host"
        self._watch.brought_up(drive)
        self.out.forget(drive.node_id)  # whatever became of what it was asked
        drive.operation = drive.family.rest_operation
        self._watch.heard(drive, now_us)
        drive.report(statusword, now_us)

    def fail(self, reason: str) -> None:
        """Something is wrong that no drive says: stop all, and be in fault."""
        if self.phase in IN_MOTION:
            self._once_started(None, lambda: self._stop_all(reason))
        elif self.phase in (Phase.QUICK_STOPPING, Phase.DISABLING):  # which go on, and end in it
            if not self._faulted:
                self._faulted, self.reason = True, reason
                self._say_fault(reason)
        elif self.phase not in (Phase.FAULT, Phase.HALTING, Phase.RESETTING):
            self._settle_fault(reason)

    def bus_failed(self, reason: str) -> None:
        """Nothing gets through any more: the drives stop by themselves, the group is in fault."""
        self._words.forget()
        self._settle_fault(reason)

    def give_up(self, reason: str) -> None:
        """Nobody will call `advance` any more: who waits for an answer gets this."""
        self._fail_requests(reason)
        request, self._disable_next = self._disable_next, None
        if request is not None:
            request.set_exception(DriveError(reason))

    # ------------------------------------------------------------------ what is known

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
            or (self.phase is Phase.READYING and not self._moved)
        )

    def lost(self) -> list[Drive]:
        """To be brought up anew, until they are (`reconfigured`)."""
        return self._watch.lost()

    def describe_phase(self) -> str:
        """The phase in words, with the reason where there is one."""
        return f"{self.phase.value} ({self.reason})" if self.reason else self.phase.value

    # ------------------------------------------------------------------ time

    def advance(self, now_us: float) -> None:
        """Do what is due at `now_us`, and set `deadline_us`."""
        self._now_us = self._seen_us = now_us
        if self.phase in BEGUN and self.time.path_began_us is not None:
            self.path_time.correct(self.time.path_began_us)
            self.time.path_began_us = None
        self._watch_drives()
        self._watch_words()
        self._progress()
        self.time.advance(now_us, self._may_sync())
        self._judge_followed()
        self.deadline_us = min(self.time.deadline_us(self._may_sync()), self._phase_deadline_us())

    def _judge_followed(self) -> None:
        """Clocks at the last SYNC that were not asked for tell where an axis was to be as well."""
        followed, self.time.followed = self.time.followed, []
        for index, clock in followed:
            drive = self.time.drives[index]
            drive.latched = clock
            told = frozenset({(epos2.HIGH_RESOLUTION_TIME_STAMP, 0)})
            self._off_path(drive, self._mode_of(drive).on_report(drive, told, self._now_us))

    def _may_sync(self) -> bool:
        """Between arming and the start no SYNC but the start's; none overtakes a controlword."""
        return self.phase is not Phase.ARMING and not self._words.on_their_way

    def _enter(self, phase: Phase) -> None:
        self.phase = phase
        if self._arrived and phase not in (Phase.READYING, Phase.SETTLING):
            self._tell_arrival()
        self._phase_us = self._now_us
        self._walk.begin()
        if phase is not Phase.STARTING:
            self._when_started.clear()
        if phase not in IN_MOTION:
            self.time.after_path()
        self.time.often_us = self._sync_pause_us()

    def _sync_pause_us(self) -> float:
        """Where only the drives know how they move, they are asked where they are more often."""
        if self.phase in BRAKING:
            return BRAKING_SYNC_US
        homing = self.phase in BEGUN and any(mode.finds_its_way for mode in self.modes)
        return FINDING_SYNC_US if homing else math.inf

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
        if self.phase is Phase.STARTING and self.path_time.start_us is None:
            self._when_started.append(action)
        else:
            action()

    def _phase_deadline_us(self) -> float:
        now_us = self._now_us
        if self.phase in (Phase.DISABLED, Phase.STANDING, Phase.FAULT):
            return math.inf
        if self.phase in BEGUN and self.path_time.start_us is not None:
            due_ms = min(mode.due_ms() for mode in self.modes)
            due_us = self.path_time.zero_us(now_us) + 1000 * due_ms + ROUNDING_US
            if self.phase is Phase.MOVING:
                return due_us
            return min(max(due_us, now_us + STARTING_US), now_us + RESEND_US / 4)
        if self.phase is Phase.PREPARING and self._handing_over:
            return now_us
        if self.phase is Phase.PREPARING and any(mode.unprepared() for mode in self.modes):
            return now_us + RESEND_US / 4
        if self.phase is Phase.PREPARING and self._arm_due_us() > now_us:
            return self._arm_due_us()
        if self.phase is Phase.ARMING and self.time.produces:
            due = self._start_due_us()
            return due if due > now_us else now_us + RESEND_US
        return now_us + RESEND_US / 4

    # ------------------------------------------------------------------ phases

    def _progress(self) -> None:
        match self.phase:
            case Phase.ENABLING | Phase.DISABLING | Phase.RESETTING:
                self._walk_on()
            case Phase.CANCELLING:
                if not self._words.unseen:
                    self._get_ready()
            case Phase.READYING:
                self._finish_readying()
            case Phase.SETTLING:
                self._settle()
            case Phase.SWITCHING:
                self._finish_switching()
            case Phase.PREPARING:
                self._prepare()
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

    def _walk_on(self) -> None:
        """One transition for every axis that is not where the phase wants it."""
        if self._words.latched and self.phase is Phase.ENABLING:
            return  # what the next SYNC makes count would undo it
        gone = self._gone() if self.phase is Phase.DISABLING else ()
        there = [drive for drive in self.drives if drive not in gone]
        waiting = self._walk.step(there, WALK_TARGET[self.phase], self._now_us)
        if not waiting:
            self._walked()
        elif self._now_us > self._phase_us + STOP_TIMEOUT_US:
            self._watch.doubt(waiting)
            self._settle_fault(
                f"{self.phase.value}: "
                + "; ".join(
                    f"{drive} is in {drive.state.value}"
                    + (f": {trouble}" if (trouble := drive.trouble()) else "")
                    for drive in waiting
                )
            )

    def _walked(self) -> None:
        if self.phase is Phase.ENABLING:
            self._moved = True
            self._get_ready()
        else:
            self._faulted &= self.phase is not Phase.RESETTING
            self._off()

    def _off(self) -> None:
        """The drives are off, or in quick stop: the request is granted, a fault stays one.

        Not of drives that are gone: what became of them nobody knows.
        """
        gone = bool(self._gone())
        self._faulted |= gone or any(drive.state is State.FAULT for drive in self.drives)
        if not self._faulted:
            self.reason = ""
        elif gone:
            self.reason = self._complaints()
            self._say_fault(self.reason)
        self._enter(Phase.FAULT if self._faulted else Phase.DISABLED)
        if gone:
            self._fail_requests(self.reason)
        self._grant_requests()
        self._disable_if_asked()

    def _gone(self) -> list[Drive]:
        """Drives that nothing can be told: without power, or stopped by their own watch."""
        return [drive for drive in self.drives if drive.restarted or self.silent(drive)]

    # ------------------------------------------------------------------ getting ready

    def _get_ready(self) -> None:
        """Every drive into the mode in which it stands, with nothing left of a motion."""
        self._enter(Phase.READYING)
        for drive, mode in self._rest.items():
            self._set_mode(drive, mode)
            if writes := [*drive.give_back(), *mode.rest(drive)]:
                self.out.ask(drive.node_id, writes, then=self._answer_of(drive))

    def _set_mode(self, drive: Drive, mode: Mode) -> None:
        """Ask for the mode of operation, unless the drive is in it."""
        if drive.operation != mode.operation:
            drive.operation = mode.operation
            write = SdoWrite.integer(epos2.MODES_OF_OPERATION, 0, mode.operation, 1, signed=True)
            self.out.ask(drive.node_id, (write,), then=self._answer_of(drive))
            self._ask_mode(drive)

    def _ask_mode(self, drive: Drive) -> None:
        """Again and again, until the drive shows the mode that it was told (0x6061)."""
        wanted = drive.operation

        def then(values: Sequence[int], error: str) -> None:
            if error:
                self._answer_of(drive)((), error)
            elif values[0] != wanted and drive.operation == wanted:
                self._ask_mode(drive)

        read = SdoRead(epos2.MODES_OF_OPERATION_DISPLAY, 0, 1, signed=True)
        self.out.ask(drive.node_id, reads=(read,), then=then)

    def _answer_of(self, drive: Drive) -> Callable[[Sequence[int], str], None]:
        def then(values: Sequence[int], error: str) -> None:
            if error:
                drive.operation = UNKNOWN_MODE
            if error and self.phase is not Phase.FAULT:
                self.fail(error)

        return then

    def _finish_readying(self) -> None:
        if self._unanswered():
            return
        ready = [mode.unready(drive, self._now_us) for drive, mode in self._rest.items()]
        if unready := next(filter(None, ready), ""):
            if self._now_us > self._phase_us + READY_TIMEOUT_US:
                self._settle_fault(f"{self.phase.value}: {unready}")
            return
        for drive in [d for d in self._held if not self._rest[d].resumes]:
            del self._held[drive]
            self.out.frames.append(drive.controlword(cia402.ENABLE_OPERATION))
        if self._moved:
            self._enter(Phase.SETTLING)
        else:
            self._stand()

    def _unanswered(self) -> bool:
        """Whether drives have not done yet what they were told by SDO."""
        waiting = [drive for drive in self.drives if drive.node_id in self.out.unanswered]
        if waiting and self._now_us > self._phase_us + READY_TIMEOUT_US:
            self._watch.doubt(waiting)
            self._settle_fault(f"{self.phase.value}: no answer from {names(waiting)}")
        return bool(waiting)

    def _settle(self) -> None:
        """Motion can begin once every drive has said, since it stands, where its demand is.

        And once the clocks are known: before that a time stamp can be wrong by what the host was
        late, and would jolt an axis in motion.
        """
        late = [drive for drive in self.drives if not drive.answered_since(self._phase_us)]
        timeout_us = REPLY_TIMEOUT_US + SETTLING_SYNCS * self.time.period_us
        if not late and self.time.clock.settled:
            for drive, mode in self._rest.items():
                mode.on_rest(drive)
            self._stand()
        elif self._now_us > self._phase_us + timeout_us:
            self._watch.doubt(late)
            self._settle_fault(
                f"no answer to SYNC from {names(late)}"
                if late
                else "the drives' clocks don't go by the times of SYNC that the host sees: their "
                "answers come late, or this computer listens late; check the load of both"
            )

    def _tell_arrival(self) -> None:
        """The motion that has come to its end is over, and the axes are ready for the next."""
        self._arrived = False
        motion, self.motion = self.motion, None
        self.out.announce("done", self._end.value)
        if motion:
            motion.set_result(self._end)

    def _stand(self) -> None:
        """All axes are enabled and hold, each in the mode in which it stands."""
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

    # ------------------------------------------------------------------ start

    def _begin_next(self) -> None:
        """The motion that waited for the axes to stand."""
        assert self._next is not None
        motion, self._next = self._next, None
        self.modes = motion.modes
        self.path_time.plan(motion.start_us)
        self._enter(Phase.SWITCHING)
        for mode in self.modes:
            mode.begin()
        self._taking_part = {drive: mode for mode in self.modes for drive in mode.taking_part}
        for drive, mode in self._taking_part.items():
            self._clear_start(drive)
            self._set_mode(drive, mode)
        self.time.before_path(max(self._now_us, (motion.start_us or -math.inf) - 2 * LEAD_US))
        if not self.out.unanswered:
            self._finish_switching()

    def _clear_start(self, drive: Drive) -> None:
        """Once more: where the last controlword was lost bit 4 is still set, and could not rise.

        It is on the bus before any SDO request of ours (0x500 + id goes before 0x600 + id), and a
        start waits for the answers to some.
        """
        halt = cia402.HALT if drive in self._held else 0
        self.out.frames.append(drive.controlword(cia402.ENABLE_OPERATION | halt))

    def _finish_switching(self) -> None:
        if not self._unanswered():
            self._enter(Phase.PREPARING)
            self._handing_over, self._handed_over_us = True, self._now_us

    def _prepare(self) -> None:
        """Wait until every drive has all it needs, and for the time to arm."""
        gave = [mode.prepare(self._now_us) for mode in self.modes]
        self._handing_over = any(gave)
        if self._handing_over:
            self._handed_over_us = self._now_us
            return
        missing = next(filter(None, (mode.unprepared() for mode in self.modes)), "")
        refused = next(filter(None, (mode.refused() for mode in self.modes)), "")
        timeout_us = max(mode.prepare_timeout_us for mode in self.modes)
        if refused:
            self._stop_all(refused)
        elif not missing:
            if self.time.clear and self._may_arm():
                self._enter(Phase.ARMING)
                starts = {
                    drive: cia402.ENABLE_OPERATION | mode.start
                    for drive, mode in self._taking_part.items()
                }
                self._words.send(starts, self._now_us)
        elif self._now_us > self._handed_over_us + timeout_us:
            self._watch.doubt(self._taking_part)
            self._stop_all(missing)

    def _arm_due_us(self) -> float:
        """The earliest time to arm."""
        if self.time.produces:
            return (self.path_time.planned_us or -math.inf) - LEAD_US
        return self.time.answered_us

    def _may_arm(self) -> bool:
        if self._now_us < self._arm_due_us():
            return False
        if self.time.produces:
            return True
        next_us = self.time.next_sync_us
        nearest_us = (self.path_time.planned_us or -math.inf) - self.time.period_us / 2
        return self._now_us <= next_us - LEAD_US and next_us >= nearest_us

    def _arm(self) -> None:
        """All controlwords seen on the bus: now the SYNC that makes them count."""
        if unseen := self._words.unseen:
            if self._now_us > self._phase_us + REPLY_TIMEOUT_US:
                self._stop_all(
                    f"the start controlword was not seen on the bus for {len(unseen)} axes"
                )
        elif self.time.produces and self.time.clear and self._now_us >= self._start_due_us():
            self._enter(Phase.STARTING)
            self.time.sync(self._now_us)

    def _start_due_us(self) -> float:
        """When the start SYNC goes out: not before the answers to the last SYNC are through."""
        return max(self.path_time.planned_us or -math.inf, self.time.answered_us)

    def _begun(self, t_us: float) -> None:
        """The start SYNC was on the bus."""
        self._moved = True
        for drive in self._taking_part:
            self._held.pop(drive, None)  # the start has released it
        for mode in self.modes:
            mode.started(t_us)
        actions, self._when_started = self._when_started, []
        for action in actions:
            action()

    def _confirm_start(self) -> None:
        start_us = self.path_time.start_us
        if start_us is None:
            if self._now_us > self._phase_us + REPLY_TIMEOUT_US:
                self._stop_all("the start SYNC was not seen on the bus")
            return
        if not self._advance_modes():
            return
        missing = [(mode, late) for mode in self.modes if (late := mode.unconfirmed())]
        if not missing:
            for mode in self.modes:
                mode.confirmed(self._now_us)
            self._enter(Phase.MOVING)
            count = len(self._taking_part)
            text = f"{count} {'axes' if count != 1 else 'axis'} started on one SYNC"
            if (error_us := self.path_time.start_error_us) is not None:
                text += f", {error_us:.0f} us after the time asked for"
            self.out.announce("started", text)
            self._move()
            return
        for mode, late in missing:
            if all(drive.heard_us > start_us + mode.confirm_timeout_us for drive in late):
                self._watch.doubt(late)
                where = ", ".join(f"{drive} ({drive.state.value})" for drive in late)
                self._stop_all(f"{mode.unconfirmed_words}: {where}")
                return

    # ------------------------------------------------------------------ motion

    def _advance_modes(self) -> bool:
        """Let every mode do what is due; False when that ended in a stop."""
        path_ms = self.path_time.at_ms(self._now_us) or 0.0
        for mode in self.modes:
            if wrong := mode.advance(path_ms, self._now_us):
                self._stop_all(wrong)
                return False
        return True

    def _move(self) -> None:
        if self._advance_modes() and all(mode.arrived() for mode in self.modes):
            self._finish_motion()

    def _finish_motion(self) -> None:
        """All axes stand at their ends, enabled."""
        for mode in self.modes:
            mode.finish()
        self._arrived = True
        if all(self._rest[drive] is mode for drive, mode in self._taking_part.items()):
            self._stand()
        else:
            self._get_ready()

    # ------------------------------------------------------------------ stopping and trouble

    def _watch_words(self) -> None:
        """No SYNC goes out while a controlword is on its way, so that can't be for ever."""
        words = self._words
        if words.on_their_way and self._now_us > words.sent_us + REPLY_TIMEOUT_US:
            if self.phase is Phase.ARMING:
                return  # which has words of its own
            unseen = words.unseen
            words.forget()
            self.fail(f"a controlword was not seen on the bus for {names(unseen)}")

    def _cancel(self) -> None:
        """Take back what has not begun, then clear what the drives were given."""
        self._words.take_back(self._now_us)
        self._end_modes()
        self._enter(Phase.CANCELLING)

    def _end_modes(self) -> None:
        for mode in self.modes:
            mode.ended()

    def _drop_motion(self, reason: str) -> None:
        """A motion that has not begun, or waits for the axes to stand, is not going to begin."""
        if self._next is None and self.phase not in NOT_BEGUN:
            return
        self._next = None
        motion, self.motion = self.motion, None
        if motion:
            text = f"cancelled before it began: {reason}"
            self.out.announce("cancelled", text)
            motion.set_exception(MotionStopped(text))

    def _stop_all(self, reason: str, fault: bool = True) -> None:
        """Halt every axis that is in operation; `_finish_halt` goes on when they stand.

        A fault takes a reset before anything moves again.
        """
        self._why, self._when = reason, ""
        path_ms = self.path_time.at_ms(self._seen_us)
        if fault and self.phase in BEGUN and path_ms is not None:
            self._when = f", {path_ms / 1000:.3f} s into the motion"
        self.reason = reason + self._when
        self._halt_is_fault = fault
        if fault:
            self._say_fault(self.reason)
            self._fail_requests(f"given up: {reason}")
        self._halt_all()

    def _halt_all(self) -> None:
        """Who may be moving keeps the bits with which it brakes on its ramp."""
        self._words.take_back(self._now_us)
        still = self.phase in NOT_BEGUN or self.phase is Phase.STANDING
        self._braking = {} if still else dict(self._taking_part)
        self._quick_stopped.clear()
        self._halted_again = False
        self._held |= {drive: mode for drive, mode in self._braking.items() if mode.resumes}
        self._enter(Phase.HALTING)
        self._end_modes()
        self._send_halts()

    def _send_halts(self) -> None:
        for drive in self.drives:
            self._make_listen(drive)
            if drive.state is State.OPERATION_ENABLED:
                brakes = self._braking[drive].brakes_with if drive in self._braking else 0
                word = cia402.ENABLE_OPERATION | cia402.HALT | brakes
                self.out.frames.append(drive.controlword(word))

    def _make_listen(self, drive: Drive) -> None:
        """Who has left NMT operational hears no controlword; his PDOs are as they were mapped."""
        if self._watch.stopped_listening(drive):
            self.out.frames.append(Frame(epos2.NMT, bytes((NMT_START, drive.node_id))))

    def _quick_stop(self) -> None:
        self._words.take_back(self._now_us, cia402.QUICK_STOP)
        if self.phase is not Phase.FAULT:
            self.reason = QUICK_STOPPED
        self._fail_motion(self.reason)
        self._end_modes()
        self._enter(Phase.QUICK_STOPPING)
        for drive in self.drives:
            self._make_listen(drive)
            if drive.state is not State.FAULT:  # also who is about to be enabled
                self._walk.tell(drive, cia402.QUICK_STOP, self._now_us)

    def _finish_halt(self) -> None:
        """When all stand: the bits fall before the halt is released, or motion starts again."""
        late = [drive for drive in self.drives if not self._halted(drive)]
        complaints = self._complaints()
        if late and self._now_us <= self._phase_us + STOP_TIMEOUT_US:
            self._quick_stop_who_does_not_halt(late)
            return
        for drive in self.drives:
            if drive.state is State.OPERATION_ENABLED and drive not in self._held:
                halted = cia402.ENABLE_OPERATION | cia402.HALT
                self.out.frames.append(drive.controlword(halted))
                self.out.frames.append(drive.controlword(cia402.ENABLE_OPERATION))
        if late:
            self._watch.doubt(late)
            who = names(late)
            self._settle_fault(f"{self.reason}; not at rest after halt and quick stop: {who}")
        elif self._halt_is_fault:
            known = self._why in complaints
            why = complaints if known else f"{self._why}; {complaints}".rstrip("; ")
            self._settle_fault(why + self._when)
        elif complaints:
            self._settle_fault(complaints)
        elif self._quick_stopped:
            who = names(drive for drive in self.drives if drive in self._quick_stopped)
            self._settle_fault(f"{self.reason}; stopped by quick stop, as the halt failed: {who}")
        else:
            if self._next is None:
                self._fail_motion(self.reason)
            self._moved = True
            self._get_ready()

    def _quick_stop_who_does_not_halt(self, late: Sequence[Drive]) -> None:
        """A mode's own bits tell at once that it halts; the ramp may take its time, half of what
        there is. Where there are no such bits the halt is sent once more."""
        if self._now_us <= self._phase_us + HALT_REACTION_US:
            return
        if not self._halted_again:  # one that has missed it looks like one on its ramp
            self._halted_again = True
            self._send_halts()
        on_ramp = self._now_us <= self._phase_us + STOP_TIMEOUT_US / 2
        for drive in late:
            if drive in self._quick_stopped or (on_ramp and not self._active(drive)):
                continue
            if drive.state is State.OPERATION_ENABLED:
                self._quick_stopped.add(drive)
                self.out.frames.append(drive.controlword(cia402.QUICK_STOP))

    def _active(self, drive: Drive) -> bool:
        """Whether a halting drive is still in motion by the bits of its mode."""
        return self._taking_part.get(drive, self._rest[drive]).active(drive)

    def _halted(self, drive: Drive) -> bool:
        if drive in self._gone():
            return True  # nothing to wait for; it has no power, or its own watch stops it
        at_rest = bool(drive.statusword & cia402.TARGET_REACHED)
        if drive.state is State.OPERATION_ENABLED:
            return drive.statusword_us > self._phase_us and not self._active(drive) and at_rest
        if drive.state is State.QUICK_STOP_ACTIVE:
            return at_rest
        return drive.state is not State.FAULT_REACTION_ACTIVE

    def _finish_quick_stop(self) -> None:
        gone = self._gone()
        moving = [d for d in self.drives if d not in gone and not self._quick_stop_done(d)]
        for drive in moving:
            if drive.state is State.OPERATION_ENABLED:
                self._walk.tell(drive, cia402.QUICK_STOP, self._now_us)
        if not moving:
            self._faulted |= bool(self._complaints())
            self._off()
        elif self._now_us > self._phase_us + STOP_TIMEOUT_US:
            self._settle_fault(
                "quick stop: " + ", ".join(f"{drive} is in {drive.state.value}" for drive in moving)
            )

    def _quick_stop_done(self, drive: Drive) -> bool:
        match drive.state:
            case State.OPERATION_ENABLED | State.FAULT_REACTION_ACTIVE:
                return False
            case State.QUICK_STOP_ACTIVE:
                return bool(drive.statusword & cia402.TARGET_REACHED)
            case State.FAULT:
                return True
            case _:
                return self._walk.has_taken(drive, drive.state, self._now_us)

    def silent(self, drive: Drive) -> bool:
        """Whether a drive is not heard any more, as far as the bus was listened to."""
        return self._watch.silent(drive)

    def _watch_drives(self) -> None:
        """What no frame tells: silence, and clocks that are off."""
        wrong = self._watch.look(self.phase)
        if wrong and self.phase not in (Phase.FAULT, Phase.HALTING, Phase.RESETTING):
            self._trouble()

    def _complaints(self) -> str:
        """What is wrong with the drives, axis by axis; "" if nothing."""
        return self._watch.complaints(self.phase)

    def _trouble(self) -> None:
        """An axis complains: all stop, whatever the group is doing."""
        if self.time.running:
            self.fail(self._complaints())

    def _settle_fault(self, reason: str) -> None:
        """Come to rest in the fault phase, which only somebody's request leaves."""
        self.reason = reason
        self._words.take_back(self._now_us)
        self._faulted = True
        self._enter(Phase.FAULT)
        self._say_fault(reason)
        self._fail_motion(reason)
        self._fail_requests(reason)
        self._disable_if_asked()

    def _say_fault(self, reason: str) -> None:
        """At once, and what has come to it when all stand."""
        if reason != self._said:
            self.out.announce("fault", reason)
        self._said = reason

    def _fail_motion(self, reason: str) -> None:
        self._next = None
        motion, self.motion = self.motion, None
        if motion:
            self.out.announce("stopped" if reason in ON_REQUEST else "aborted", reason)
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
