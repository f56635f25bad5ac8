"""Axes that move in their drives' own profile position mode: enabled, moved in step, stopped.

No I/O: frames and times go in (`receive`, `advance`), frames, SDO writes and events come out
(`outbox`, `writing`, `events`). SYNC is the group's; this machine only uses it:

* A move's set-point is written by SDO to every drive that takes part. Then, right after a SYNC,
  "new set-point" goes out in each drive's synchronous RPDO, is seen on the bus, and the next SYNC
  starts all of them: no SYNC can come between two of these controlwords.
* A set-point that a drive does not want is only seen by bit 12 staying low, so the handshake has
  a time limit (CiA 402, profile position mode).
* One axis in trouble stops all. Nothing starts again by itself.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field
from enum import Enum

from epos2_ros.errors import DriveError, MotionAborted, TrajectoryError
from epos2_ros.motion.trapezoid import Trapezoid
from epos2_ros.protocol import cia402, copley, epos2
from epos2_ros.protocol.cia402 import State
from epos2_ros.protocol.executed_path import Demand
from epos2_ros.protocol.frame import Frame
from epos2_ros.protocol.group import HALTED, ON_REQUEST, QUICK_STOPPED
from epos2_ros.protocol.sdo import SdoWrite
from epos2_ros.protocol.silence import Silence

RESEND_US = 200_000.0  # a controlword without effect so long is sent again
REPLY_TIMEOUT_US = 2_000_000.0  # for one step of a drive that has been told something
STOP_TIMEOUT_US = 5_000_000.0  # for an axis to come to rest
ARRIVAL_MARGIN_US = 1_000_000.0  # after a move should be over


class Phase(Enum):
    """What the axes are doing."""

    DISABLED = "disabled"
    ENABLING = "enabling"
    STANDING = "standing"
    PREPARING = "writing set-points"
    ARMED = "waiting for SYNC"
    STARTING = "starting"
    MOVING = "moving"
    HALTING = "halting"
    QUICK_STOPPING = "quick stop"
    DISABLING = "disabling"
    RESETTING = "resetting faults"
    FAULT = "fault"


IN_MOTION = frozenset({Phase.PREPARING, Phase.ARMED, Phase.STARTING, Phase.MOVING})
_WALK_TARGET = {
    Phase.ENABLING: State.OPERATION_ENABLED,
    Phase.DISABLING: State.READY_TO_SWITCH_ON,
    Phase.RESETTING: State.SWITCH_ON_DISABLED,
}


@dataclass
class ProfileAxis:
    """Reported state of one drive in counts; times are host µs."""

    joint: str
    node_id: int
    statusword: int = 0
    statusword_us: float = -math.inf
    position_qc: int | None = None
    velocity_qc_s: float = 0.0
    sample_us: float = -math.inf  # the SYNC at which the position was taken
    emergency: int = 0
    heard_us: float = -math.inf
    restarted: bool = False
    demand: Demand | None = None  # what it was last told to do; None: not known
    move: Trapezoid | None = None  # prepared, not yet over
    told: tuple[State, float] | None = field(default=None, repr=False)

    def __str__(self) -> str:
        return f"{self.joint} (node {self.node_id})"

    @property
    def pdo_bytes(self) -> dict[int, int]:
        """By COB-ID, how long the PDOs are that it sends."""
        return {
            epos2.TPDO1 + self.node_id: copley.TPDO1_LAYOUT.size,
            epos2.TPDO2 + self.node_id: copley.TPDO2_LAYOUT.size,
        }

    @property
    def state(self) -> State:
        return cia402.state_of(self.statusword)

    @property
    def acknowledged(self) -> bool:
        """Bit 12: the set-point was taken."""
        return bool(self.statusword & copley.SETPOINT_ACKNOWLEDGED)

    @property
    def at_rest(self) -> bool:
        """Bit 10: target reached, or halted and standing."""
        return bool(self.statusword & cia402.TARGET_REACHED)

    @property
    def trouble(self) -> str:
        """What the drive complains of; "" if nothing."""
        if self.restarted:
            return "has restarted"
        if self.emergency:
            return epos2.describe_emergency(self.emergency)
        return self.state.value if self.statusword & cia402.FAULT_BIT else ""

    def controlword(self, value: int) -> Frame:
        """Takes effect at once."""
        return Frame(epos2.RPDO4 + self.node_id, value.to_bytes(2, "little"))

    def synchronous_controlword(self, value: int) -> Frame:
        """Takes effect at the next SYNC."""
        return Frame(epos2.RPDO2 + self.node_id, value.to_bytes(2, "little"))


class ProfileAxes:
    """The protocol of all axes of one bus that move in profile position mode."""

    def __init__(self, axes: Sequence[tuple[str, int]]) -> None:
        self.axes = [ProfileAxis(joint, node_id) for joint, node_id in axes]
        self.phase = Phase.DISABLED
        self.outbox: deque[Frame] = deque()
        self.writing: deque[tuple[int, list[SdoWrite]]] = deque()  # (axis, what to write)
        self.events: deque[tuple[str, str]] = deque()  # (kind, text), as the group's
        self.deadline_us = math.inf
        self.reason = ""
        self.start_us = -math.inf  # the SYNC that started the last move
        self._now_us = -math.inf
        self._phase_us = -math.inf
        self._sync_us = -math.inf
        self._watching = False
        self._silence = Silence(len(self.axes))
        self._unwritten: set[int] = set()
        self._armed: set[int] = set()  # node ids whose "new set-point" is not yet on the bus
        self._request: Future[None] | None = None
        self._motion: Future[None] | None = None

    # ------------------------------------------------------------------ frames in

    def receive(self, frame: Frame, t_us: float, echo: bool = False) -> None:
        """Take in a frame; call `advance` afterwards."""
        self._silence.listened(t_us)
        if frame.can_id == epos2.SYNC:
            self._on_sync(t_us)
        elif echo and frame.can_id & 0x780 == epos2.RPDO2:
            self._armed.discard(frame.can_id & 0x7F)
        elif not echo:
            for index in range(len(self.axes)):
                self._on_frame(index, frame, t_us)

    def _on_sync(self, t_us: float) -> None:
        self._sync_us = t_us
        if self.phase is Phase.PREPARING and not self._unwritten:
            for axis in self._taking_part():
                self._armed.add(axis.node_id)
                self.outbox.append(axis.synchronous_controlword(_START))
            self._enter(Phase.ARMED, t_us)
        elif self.phase is Phase.ARMED and self._armed:
            self._stop_all(f"the start was not seen on the bus for {len(self._armed)} axes")
        elif self.phase is Phase.ARMED:
            for axis in self._taking_part():
                assert axis.move is not None
                axis.demand = Demand(axis.move.path(t_us))
            self.start_us = t_us
            self._enter(Phase.STARTING, t_us)

    def _on_frame(self, index: int, frame: Frame, t_us: float) -> None:
        axis = self.axes[index]
        node = axis.node_id
        if frame.can_id == epos2.TPDO1 + node:
            self.report(index, copley.TPDO1_LAYOUT.unpack(frame.data)[0], t_us)
        elif frame.can_id == epos2.TPDO2 + node:
            position, velocity = copley.TPDO2_LAYOUT.unpack(frame.data)
            axis.position_qc = position
            axis.velocity_qc_s = velocity * copley.VELOCITY_UNIT_COUNTS_S
            axis.sample_us = self._sync_us
        elif frame.can_id == epos2.EMCY + node:
            axis.emergency = epos2.EMCY_LAYOUT.unpack(frame.data)[0]
        elif frame.can_id == epos2.HEARTBEAT + node:
            axis.restarted = axis.restarted or frame.data == b"\x00"  # boot-up
        else:
            return
        axis.heard_us = t_us
        self._silence.heard(index)

    def report(self, index: int, statusword: int, t_us: float) -> None:
        """A statusword, from a PDO or read at bring-up."""
        axis = self.axes[index]
        axis.statusword, axis.statusword_us, axis.heard_us = statusword, t_us, t_us
        self._silence.heard(index)

    def reconfigured(self, index: int, statusword: int, now_us: float) -> None:
        """The drive of axis `index` was brought up anew."""
        self.axes[index].restarted = False
        self.axes[index].emergency = 0
        self.report(index, statusword, now_us)

    def start_watch(self, now_us: float) -> None:
        """All drives are brought up: from now on one that is silent or restarts is trouble."""
        self._watching = True
        for index, axis in enumerate(self.axes):
            axis.heard_us = now_us
            self._silence.heard(index)

    def fail(self, reason: str) -> None:
        """Something is wrong that no drive says: stop all, and be in fault."""
        self._stop_all(reason)

    def bus_failed(self, reason: str) -> None:
        """Nothing gets through any more; the drives stop by themselves."""
        if self.phase is not Phase.FAULT:
            self.reason = reason
            self._settle_fault()

    def silent(self, index: int) -> bool:
        """Whether a drive is not heard any more."""
        return self._silence.silent(index)

    def lost_axes(self) -> list[int]:
        """Axes that need to be brought up anew: restarted, or silent."""
        return [n for n, a in enumerate(self.axes) if a.restarted or self.silent(n)]

    def written(self, index: int, error: str = "") -> None:
        """Answer to a request in `writing`."""
        if error:
            self._stop_all(f"{self.axes[index]}: {error}")
        else:
            self._unwritten.discard(index)

    # ------------------------------------------------------------------ requests

    def enable(self) -> Future[None]:
        """Bring every drive to "operation enabled", holding its position."""
        if self.phase in (Phase.DISABLED, Phase.QUICK_STOPPING):
            return self._accept(Phase.ENABLING)
        if self.phase is Phase.STANDING or self.phase in IN_MOTION:
            return _done()
        return _refused(f"can't enable while {self._describe()}")

    def disable(self) -> Future[None]:
        """Switch all drives off where they stand."""
        if self.phase in IN_MOTION:
            return _refused("can't disable while moving: stop first")
        return self._accept(Phase.DISABLING)

    def halt(self, reason: str = HALTED) -> Future[None]:
        """Stop every axis on its deceleration; they hold."""
        if self.phase not in IN_MOTION:
            return _done()
        request = self._accept(Phase.HALTING)
        self.reason = reason
        self._send_halt()
        return request

    def quick_stop(self) -> Future[None]:
        """Stop every axis on its quick stop ramp; the drives leave "operation enabled"."""
        if self.phase is Phase.DISABLED:
            return _done()
        request = self._accept(Phase.QUICK_STOPPING)
        self.reason = QUICK_STOPPED
        self._fail_motion(self.reason)
        for axis in self.axes:
            axis.demand = None
            if axis.state is State.OPERATION_ENABLED:
                self.outbox.append(axis.controlword(cia402.QUICK_STOP))
        return request

    def reset_fault(self) -> Future[None]:
        """Leave the fault state; the axes stay off."""
        if self.phase is not Phase.FAULT:
            return _done()
        for axis in self.axes:
            axis.emergency = 0
        return self._accept(Phase.RESETTING)

    def move(self, moves: Sequence[Trapezoid | None]) -> Future[None]:
        """Start moves, [axes] in counts; None leaves an axis where it is.

        The future ends with the motion: a result when all axes have arrived, `MotionAborted` when
        they were stopped. `TrajectoryError` when no motion can begin.
        """
        if self.phase is not Phase.STANDING:
            raise TrajectoryError(f"can't move: the drives are {self._describe()}")
        self.reason = ""
        self._motion = Future()
        for index, (axis, move) in enumerate(zip(self.axes, moves, strict=True)):
            axis.move = as_written(move) if move and move.start != move.end else None
            if axis.move:
                self._unwritten.add(index)
                self.writing.append((index, setpoint(axis.move)))
        self._enter(Phase.PREPARING, self._now_us)
        return self._motion

    # ------------------------------------------------------------------ time

    def advance(self, now_us: float) -> None:
        """Do what is due at `now_us`, and set `deadline_us`."""
        self._now_us = now_us
        if self._watching and self.phase not in (Phase.FAULT, Phase.HALTING, Phase.RESETTING):
            self._watch()
        self._progress()
        idle = self.phase in (Phase.DISABLED, Phase.STANDING, Phase.FAULT)
        self.deadline_us = math.inf if idle else now_us + RESEND_US / 4

    def _progress(self) -> None:
        match self.phase:
            case Phase.ENABLING | Phase.DISABLING | Phase.RESETTING:
                self._walk()
            case Phase.PREPARING:
                what = "set-points could not be written" if self._unwritten else "no SYNC came"
                self._limit(REPLY_TIMEOUT_US, what)
            case Phase.ARMED:
                self._limit(REPLY_TIMEOUT_US, "no SYNC came to start the move")
            case Phase.STARTING:
                self._confirm()
            case Phase.MOVING:
                self._finish_move()
            case Phase.HALTING:
                self._finish_halt()
            case Phase.QUICK_STOPPING:
                self._finish_quick_stop()
            case Phase.DISABLED | Phase.STANDING | Phase.FAULT:
                pass

    def _walk(self) -> None:
        """One transition for every axis that is not where the phase wants it."""
        target, waiting = _WALK_TARGET[self.phase], []
        for axis in self.axes:
            if self._arrived(axis, target):
                continue
            waiting.append(axis)
            controlword = cia402.step(axis.state, target)
            told = axis.told
            again = (
                told is None or told[0] is not axis.state or (self._now_us >= told[1] + RESEND_US)
            )
            if controlword is not None and again:
                if controlword == cia402.FAULT_RESET:  # bit 7 has to rise
                    self.outbox.append(axis.controlword(cia402.DISABLE_VOLTAGE))
                self.outbox.append(axis.controlword(controlword))
                axis.told = (axis.state, self._now_us)
        if waiting:
            where = "; ".join(
                f"{axis} has not answered SYNC"
                if axis.state is target
                else f"{axis} is in {axis.state.value}"
                for axis in waiting
            )
            self._limit(STOP_TIMEOUT_US, f"{self.phase.value}: {where}")
            return
        after = Phase.STANDING if self.phase is Phase.ENABLING else Phase.DISABLED
        self._enter(after, self._now_us)
        self.reason = ""
        self._grant()

    def _arrived(self, axis: ProfileAxis, target: State) -> bool:
        if self.phase is Phase.RESETTING:
            return axis.state not in (State.FAULT, State.FAULT_REACTION_ACTIVE)
        if self.phase is Phase.DISABLING and axis.state is State.FAULT:
            return True  # its power stage is off
        if self.phase is Phase.ENABLING and axis.sample_us <= self._phase_us:
            return False  # where it stands is known from the next SYNC on
        return axis.state is target

    # ------------------------------------------------------------------ moves

    def _taking_part(self) -> list[ProfileAxis]:
        return [axis for axis in self.axes if axis.move is not None]

    def _moved(self) -> str:
        return ", ".join(axis.joint for axis in self._taking_part())

    def _confirm(self) -> None:
        """Every drive acknowledges; then bit 4 falls, or the next set-point could not rise."""
        late = [axis for axis in self._taking_part() if not axis.acknowledged]
        if late:
            names = ", ".join(map(str, late))
            self._limit(REPLY_TIMEOUT_US, f"set-point not acknowledged (bit 12) by {names}")
            return
        for axis in self._taking_part():
            self.outbox.append(axis.controlword(cia402.ENABLE_OPERATION))
        self.events.append(("started", f"started on one SYNC: {self._moved()}"))
        self._enter(Phase.MOVING, self._now_us)

    def _finish_move(self) -> None:
        moving = [
            axis
            for axis in self._taking_part()
            if axis.acknowledged or not axis.at_rest or axis.statusword_us <= self._phase_us
        ]
        if moving:
            longest = max(axis.move.duration_s for axis in moving if axis.move) * 1e6
            names = ", ".join(map(str, moving))
            self._limit(longest + ARRIVAL_MARGIN_US, f"target not reached by {names}")
            return
        self.events.append(("done", f"arrived: {self._moved()}"))
        for axis in self.axes:
            axis.move = None
        self._enter(Phase.STANDING, self._now_us)
        motion, self._motion = self._motion, None
        if motion:
            motion.set_result(None)

    # ------------------------------------------------------------------ stopping and trouble

    def _send_halt(self) -> None:
        for axis in self.axes:
            axis.demand = axis.move = None
            if axis.state is State.OPERATION_ENABLED:
                # Bit 4 low in the synchronous one, too: what has not started must not.
                self.outbox.append(axis.synchronous_controlword(_HALTED))
                self.outbox.append(axis.controlword(_HALTED))
        self._unwritten.clear()
        self._armed.clear()

    def _stop_all(self, reason: str) -> None:
        """Halt what can be halted; a fault, which takes a reset before anything moves again."""
        if self.phase is Phase.FAULT:
            return
        self.reason = reason
        self._send_halt()
        self._settle_fault()

    def _finish_halt(self) -> None:
        late = [
            axis
            for index, axis in enumerate(self.axes)
            if axis.state is State.OPERATION_ENABLED
            and not (axis.at_rest and axis.statusword_us > self._phase_us)
            and not self.silent(index)
        ]
        if late:
            names = ", ".join(map(str, late))
            self._limit(STOP_TIMEOUT_US, f"{self.reason}; not at rest after the halt: {names}")
            return
        # The halt bit stays: without it the drive would go on to its target. It falls together
        # with the next set-point, which takes the old one's place at once.
        self._enter(Phase.STANDING, self._now_us)
        self._fail_motion(self.reason)
        self._grant()

    def _finish_quick_stop(self) -> None:
        moving = [
            axis
            for axis in self.axes
            if axis.state is State.OPERATION_ENABLED
            or (axis.state is State.QUICK_STOP_ACTIVE and not axis.at_rest)
        ]
        if moving:
            where = ", ".join(f"{axis} is in {axis.state.value}" for axis in moving)
            self._limit(STOP_TIMEOUT_US, f"quick stop: {where}")
            return
        self._enter(Phase.DISABLED, self._now_us)
        self._grant()

    def _watch(self) -> None:
        complaints = [f"{axis}: {axis.trouble}" for axis in self.axes if axis.trouble]
        complaints += [
            f"{axis} is silent: check its power and the bus"
            for index, axis in enumerate(self.axes)
            if self.silent(index)
        ]
        if complaints:
            self._stop_all("; ".join(complaints))

    def _limit(self, limit_us: float, reason: str) -> None:
        """A fault if the phase has lasted longer."""
        if self._now_us > self._phase_us + limit_us:
            self._stop_all(reason)

    def _settle_fault(self) -> None:
        self._enter(Phase.FAULT, self._now_us)
        self.events.append(("fault", self.reason))
        self._fail_motion(self.reason)
        request, self._request = self._request, None
        if request:
            request.set_exception(DriveError(self.reason))

    def _fail_motion(self, reason: str) -> None:
        motion, self._motion = self._motion, None
        if motion:
            self.events.append(("stopped" if reason in ON_REQUEST else "aborted", reason))
            motion.set_exception(MotionAborted(reason))

    # ------------------------------------------------------------------ bookkeeping

    def _enter(self, phase: Phase, now_us: float) -> None:
        self.phase = phase
        self._phase_us = now_us
        for axis in self.axes:
            axis.told = None

    def _accept(self, phase: Phase) -> Future[None]:
        request, self._request = self._request, Future()
        if request:
            request.set_exception(DriveError(f"given up for another request ({phase.value})"))
        self._enter(phase, self._now_us)
        return self._request

    def _grant(self) -> None:
        request, self._request = self._request, None
        if request:
            request.set_result(None)

    def _describe(self) -> str:
        return f"{self.phase.value} ({self.reason})" if self.reason else self.phase.value


_HALTED = cia402.ENABLE_OPERATION | cia402.HALT
_START = cia402.ENABLE_OPERATION | copley.NEW_SETPOINT | copley.CHANGE_IMMEDIATELY


def setpoint(move: Trapezoid) -> list[SdoWrite]:
    """Target, velocity and acceleration of a move for profile position mode."""
    velocity = copley.velocity_object(move.velocity)
    acceleration = copley.acceleration_object(move.acceleration)
    return [
        SdoWrite.integer(copley.TARGET_POSITION, 0, round(move.end), 4, signed=True),
        SdoWrite.integer(epos2.PROFILE_VELOCITY, 0, velocity, 4),
        SdoWrite.integer(epos2.PROFILE_ACCELERATION, 0, acceleration, 4),
        SdoWrite.integer(epos2.PROFILE_DECELERATION, 0, acceleration, 4),
    ]


def as_written(move: Trapezoid) -> Trapezoid:
    """The move as the drive makes it of whole units."""
    return Trapezoid(
        float(round(move.start)),
        float(round(move.end)),
        copley.velocity_object(move.velocity) * copley.VELOCITY_UNIT_COUNTS_S,
        copley.acceleration_object(move.acceleration) * copley.ACCELERATION_UNIT_COUNTS_S2,
    )


def _done() -> Future[None]:
    answer: Future[None] = Future()
    answer.set_result(None)
    return answer


def _refused(reason: str) -> Future[None]:
    answer: Future[None] = Future()
    answer.set_exception(DriveError(reason))
    return answer
