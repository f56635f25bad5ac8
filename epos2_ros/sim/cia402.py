"""A drive of CiA 402: state machine, profile position, homing, and the axis it moves.

What the EPOS2 adds is in `epos2`. The objects are those of CiA 402 with the EPOS2's names,
defaults (maxon, application note "Interpolation Position Mode", table 17) and units; bits 8,
9 and 15 of the status word are as publicly described for the EPOS family.
Internally positions are in qc, time in ms, velocity in qc/ms, acceleration in qc/ms².
"""

from __future__ import annotations

from enum import Enum, IntEnum
from functools import partial
from typing import NamedTuple

from .dictionary import (
    INTEGER8,
    INTEGER16,
    INTEGER32,
    UNSIGNED16,
    UNSIGNED32,
    AbortCode,
    Entry,
    SdoAbort,
)
from .homing import ACTUAL_POSITION, STANDARD, Search, Stop, Switches, plan
from .motor import Motor
from .profile import Profile, jog, stop, trapezoid
from .slave import HEARTBEAT_ERROR, INF, Identity, Slave

FOLLOWING_ERROR = 0x8611
SOFTWARE_POSITION_LIMIT = 0xFF09
MAX_RPM = 25_000
UNLIMITED = 0xFFFF_FFFF
# maxon's own homing methods: against a current threshold, the first two back to an index
CURRENT_THRESHOLD = {-1: Stop(1, True), -2: Stop(-1, True), -3: Stop(1, False), -4: Stop(-1, False)}
_SETTLED_QC = 1e-3
_MA_PER_RPM_S = 0.02  # motor current for an acceleration: an inertia, no friction


class State(Enum):
    """CiA 402 states with the bits 0–6 and 8 of the EPOS2's status word in them."""

    SWITCH_ON_DISABLED = 0x0140
    READY_TO_SWITCH_ON = 0x0121
    SWITCHED_ON = 0x0123
    OPERATION_ENABLED = 0x0137
    QUICK_STOP_ACTIVE = 0x0117
    FAULT_REACTION_ACTIVE = 0x011F
    FAULT = 0x0108
    # between "switched on" and "operation enabled", by themselves
    REFRESH = 0x4123  # of the power stage
    MEASURE_INIT = 0x4133  # of the motor, once after power-on


class Mode(IntEnum):
    """Modes of operation (0x6060)."""

    PROFILE_POSITION = 1
    HOMING = 6
    INTERPOLATED_POSITION = 7


class Control:
    """Bits of the control word."""

    SWITCH_ON = 1 << 0
    ENABLE_VOLTAGE = 1 << 1
    QUICK_STOP = 1 << 2  # low active
    ENABLE_OPERATION = 1 << 3
    ENABLE_IP_MODE = NEW_SETPOINT = HOMING_START = 1 << 4
    CHANGE_IMMEDIATELY = 1 << 5
    RELATIVE = 1 << 6
    FAULT_RESET = 1 << 7
    HALT = 1 << 8


class Status:
    """Bits of the status word besides those of the state."""

    REMOTE = 1 << 9
    TARGET_REACHED = 1 << 10
    IP_MODE_ACTIVE = SETPOINT_ACKNOWLEDGE = HOMING_ATTAINED = 1 << 12
    FOLLOWING_ERROR = HOMING_ERROR = 1 << 13
    HOME_REFERENCED = 1 << 15


_NO_ACTION, _DISABLE_VOLTAGE = 0, 2  # in 0x6007

_POWERED = (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE, State.FAULT_REACTION_ACTIVE)
_POWERING_UP = (State.REFRESH, State.MEASURE_INIT)


class Delays(NamedTuple):
    """How long the drive takes [ms]."""

    refresh: float = 0.0
    measure: float = 0.0
    fault_reset: float = 0.0
    boot: float = 0.0  # from a reset or power-on to the boot-up message


class Drive(Slave):
    """The drive; a subclass has more modes than profile position and homing.

    It overrides `MODES`, `_build_objects`, `_reset_application`, `_mode_bits`, `_command_mode`,
    `_enter_mode`, `_leave_path` and `_tick`.
    """

    MODES: tuple[Mode, ...] = (Mode.PROFILE_POSITION, Mode.HOMING)

    def __init__(
        self,
        node_id: int,
        identity: Identity,
        *,
        counts_per_turn: int,
        motor: Motor,
        switches: Switches,
        rate: float,
        t_us: float,
        delays: Delays,
        frames_needed: int,
    ) -> None:
        self._delays = delays
        self.counts_per_turn = counts_per_turn
        self._motor = motor
        self._switches = switches
        self._machine_zero = 0.0  # where the machine's zero is since homing
        # the trajectory generator
        self._demand = motor.position
        self._demand_velocity = 0.0
        self._origin_us = 0.0  # true time of cycle 0
        self._cycle = 0
        self._profile: Profile | None = None
        self._profile_start = 0
        super().__init__(node_id, identity, t_us, delays.boot, frames_needed)
        self.rate = rate
        self._build_objects()
        self._reset_application()

    # --- observation and faults ---------------------------------------------------------

    @property
    def position_demand(self) -> int:
        """0x6062."""
        return round(self._demand)

    @property
    def position_actual(self) -> int:
        """0x6064."""
        return self._motor.measured

    @property
    def velocity_actual(self) -> int:
        """0x606C: from the counts of one control cycle, so in steps of 1 qc/ms."""
        return round(round(self._motor.velocity) / self._velocity_unit)

    @property
    def current_actual(self) -> int:
        """0x6078 [mA]: what accelerates the axis."""
        return _int16(self._motor.acceleration / self._acceleration_unit * _MA_PER_RPM_S)

    @property
    def mode(self) -> int:
        """0x6061."""
        return self._mode

    @property
    def status_word(self) -> int:
        """0x6041."""
        word = self.state.value
        if self._operational:
            word |= Status.REMOTE
        if self._referenced:
            word |= Status.HOME_REFERENCED
        if self.state is State.QUICK_STOP_ACTIVE and self._profile is None:
            word |= Status.TARGET_REACHED
        if self.state is State.OPERATION_ENABLED:
            if self._target_reached:
                word |= Status.TARGET_REACHED
            word |= self._mode_bits()
        if self.mode == Mode.PROFILE_POSITION and self._following_error:
            word |= Status.FOLLOWING_ERROR
        return word

    def _mode_bits(self) -> int:
        """Bits 12 and 13 of the status word in "operation enabled"."""
        bits = 0
        if self.mode == Mode.PROFILE_POSITION and self._acknowledged:
            bits |= Status.SETPOINT_ACKNOWLEDGE
        if self.mode == Mode.HOMING and self._homed:
            bits |= Status.HOMING_ATTAINED
        if self.mode == Mode.HOMING and self._homing_error:
            bits |= Status.HOMING_ERROR
        return bits

    def fail(self, code: int, t_us: float | None = None) -> None:
        """Something in the drive breaks: emergency `code` and fault reaction."""
        if t_us is not None:
            self.advance(t_us)
        self._fault(code)
        self._send_events()
        self._arm()

    def block_rotor(self, blocked: bool = True) -> None:
        """The axis can't move, or can again."""
        self._motor.blocked = blocked
        self._motor.stand()
        self._start_cycles()
        self._arm()

    def push(self, counts: float) -> bool:
        """A hand turns the shaft so far, to a whole count; `False`: the motor holds it."""
        if self.state in _POWERED:
            return False
        self._motor.stand(round(self._motor.position + counts))
        self._demand = self._motor.position
        self._dirty = True
        self._send_events()
        self._arm()
        return True

    # --- object dictionary --------------------------------------------------------------

    def _build_objects(self) -> None:
        od = self.dictionary
        mapped = partial(Entry, mappable=True)
        fast = partial(Entry, access="ro", mappable=True, fast=True)
        # state and mode (CiA 402)
        od.variable(0x6040, mapped("Controlword", UNSIGNED16, write=self._on_controlword))
        od.variable(0x6041, mapped("Statusword", UNSIGNED16, "ro", read=lambda: self.status_word))
        self._selected_mode = od.variable(
            0x6060,
            mapped(
                "Modes of operation",
                INTEGER8,
                value=Mode.PROFILE_POSITION,
                check=self._check_mode,
                write=self._on_mode,
            ),
        )
        od.variable(
            0x6061, mapped("Modes of operation display", INTEGER8, "ro", read=lambda: self.mode)
        )
        modes = sum(1 << mode - 1 for mode in self.MODES)
        od.variable(0x6502, Entry("Supported drive modes", UNSIGNED32, "ro", modes))
        # values that change while the axis moves
        od.variable(
            0x6062, fast("Position demand value", INTEGER32, read=lambda: self.position_demand)
        )
        od.variable(
            0x6064, fast("Position actual value", INTEGER32, read=lambda: self.position_actual)
        )
        od.variable(
            0x606C,
            fast(
                "Velocity actual value",
                INTEGER32,
                read=lambda: self.velocity_actual,
            ),
        )
        od.variable(
            0x6078,
            fast(
                "Current actual value",
                INTEGER16,
                read=lambda: self.current_actual,
            ),
        )
        od.variable(
            0x20F4,
            fast(
                "Following error actual value",
                INTEGER16,
                read=lambda: _int16(self.position_demand - self._motor.measured),
            ),
        )
        self._abort_connection = od.variable(
            0x6007, Entry("Abort connection option code", INTEGER16, value=3, low=0, high=3)
        )
        # parameters of motion (the note, tables 4 and 17)
        self._max_following_error = od.variable(
            0x6065, mapped("Max following error", UNSIGNED32, value=2000)
        )
        self._window = od.variable(0x6067, mapped("Position window", UNSIGNED32, value=UNLIMITED))
        self._window_time = od.variable(0x6068, mapped("Position window time", UNSIGNED16))
        self._target = od.variable(0x607A, mapped("Target position", INTEGER32))
        self._min_position = Entry("Min position limit", INTEGER32, value=INTEGER32.low)
        self._max_position = Entry("Max position limit", INTEGER32, value=INTEGER32.high)
        od.record(0x607D, self._min_position, self._max_position)
        self._max_velocity = od.variable(
            0x607F,
            Entry(
                "Max profile velocity",
                UNSIGNED32,
                value=MAX_RPM,
                low=1,
                check=self._check_max_velocity,
            ),
        )
        self._profile_velocity = od.variable(
            0x6081, mapped("Profile velocity", UNSIGNED32, value=1000, low=1)
        )
        self._profile_acceleration = od.variable(
            0x6083, mapped("Profile acceleration", UNSIGNED32, value=10_000, low=1)
        )
        self._profile_deceleration = od.variable(
            0x6084, mapped("Profile deceleration", UNSIGNED32, value=10_000, low=1)
        )
        self._quick_stop_deceleration = od.variable(
            0x6085, Entry("Quick stop deceleration", UNSIGNED32, value=10_000, low=1)
        )
        self._max_acceleration = od.variable(
            0x60C5, Entry("Max acceleration", UNSIGNED32, value=UNLIMITED, low=1)
        )
        od.variable(0x6086, Entry("Motion profile type", INTEGER16, low=0, high=0))
        # homing
        self._home_offset = od.variable(0x607C, Entry("Home offset", INTEGER32))
        self._home_position = od.variable(0x2081, Entry("Home position", INTEGER32))
        self._homing_method = od.variable(
            0x6098, Entry("Homing method", INTEGER8, value=7, check=self._check_homing_method)
        )
        self._switch_speed = Entry("Speed for switch search", UNSIGNED32, value=100, low=1)
        self._zero_speed = Entry("Speed for zero search", UNSIGNED32, value=10, low=1)
        od.record(0x6099, self._switch_speed, self._zero_speed)
        self._homing_acceleration = od.variable(
            0x609A, Entry("Homing acceleration", UNSIGNED32, value=1000, low=1)
        )
        self._velocity_notation = od.variable(
            0x608B,
            Entry(
                "Velocity notation index", INTEGER8, low=-3, high=0, check=self._check_not_enabled
            ),
        )

    def _check_not_enabled(self, _: int) -> None:
        if self.state in _POWERED or self.state in _POWERING_UP:
            raise SdoAbort(AbortCode.DEVICE_STATE)

    def _check_homing_method(self, value: int) -> None:
        if value not in STANDARD and value not in CURRENT_THRESHOLD:
            raise SdoAbort(AbortCode.VALUE_RANGE)

    def _check_max_velocity(self, value: int) -> None:
        if value > MAX_RPM * 10**-self._velocity_notation.value:
            raise SdoAbort(AbortCode.VALUE_TOO_HIGH)

    # --- units --------------------------------------------------------------------------

    @property
    def _velocity_unit(self) -> float:
        """One velocity unit, 10^n rpm of the motor [qc/ms]."""
        return self.counts_per_turn / 60e3 * 10.0**self._velocity_notation.value

    @property
    def _acceleration_unit(self) -> float:
        """1 rpm/s [qc/ms²]."""
        return self.counts_per_turn / 60e6

    # --- state machine (CiA 402) --------------------------------------------------------

    def _reset_application(self) -> None:
        self.state = State.SWITCH_ON_DISABLED
        self._measured = False  # the motor, since power-on
        self._word = 0  # the last control word
        self._mode = self._selected_mode.value
        self._referenced = False
        self._acknowledged = False
        self._setpoint: int | None = None  # what profile position mode moves to
        self._next_setpoint: int | None = None
        self._homing: list[Search] = []  # what is left of a homing method
        self._home_target: float | None = None  # its last move goes there
        self._homed = False
        self._homing_error = False
        self._following_error = False
        self._target_reached = False
        self._window_since = 0  # the cycle the axis came into the position window
        self._when_stopped: State | None = None
        self._release()

    def _on_controlword(self, word: int) -> None:
        last, self._word = self._word, word
        rising = word & ~last
        state = self.state
        if state is State.FAULT:
            if rising & Control.FAULT_RESET:
                self._in(self._delays.fault_reset)
        elif state is not State.FAULT_REACTION_ACTIVE:
            self._command(word)
            if state is State.OPERATION_ENABLED and self.state is State.OPERATION_ENABLED:
                self._command_mode(last, word)

    def _command(self, word: int) -> None:
        """The transitions a control word asks for (CiA 402, device control)."""
        state = self.state
        if not word & Control.ENABLE_VOLTAGE:
            self._switch_off(State.SWITCH_ON_DISABLED)
        elif not word & Control.QUICK_STOP:
            if state is State.OPERATION_ENABLED:
                self.state = State.QUICK_STOP_ACTIVE
                self._stop(self._quick_stop_deceleration)
            elif state is not State.QUICK_STOP_ACTIVE:
                self._switch_off(State.SWITCH_ON_DISABLED)
        elif state is State.QUICK_STOP_ACTIVE:
            if word & 0x0F == 0x0F:
                self._enable_operation()
        elif not word & Control.SWITCH_ON:
            self._switch_off(State.READY_TO_SWITCH_ON)
        elif state is not State.SWITCH_ON_DISABLED:
            if not word & Control.ENABLE_OPERATION:
                if state is State.READY_TO_SWITCH_ON:
                    self.state = State.SWITCHED_ON
                elif state is State.OPERATION_ENABLED:  # slow down first (0x605C = 1)
                    self._when_stopped = State.SWITCHED_ON
                    self._stop(self._profile_deceleration)
            elif state is State.OPERATION_ENABLED:
                self._when_stopped = None
            elif state not in _POWERING_UP:
                self._power_up()

    def _power_up(self) -> None:
        """On the way to "operation enabled": the power stage first, then the motor, if need be."""
        self.state = State.REFRESH
        self._in(self._delays.refresh)

    def _in(self, delay_ms: float) -> None:
        """`_on_alarm` in a while, or at once."""
        if delay_ms:
            self._alarm_us = self.now_us + 1000.0 * delay_ms
        else:
            self._on_alarm()

    def _on_alarm(self) -> None:
        self._dirty = True
        if self.state is State.FAULT:
            self.state = State.SWITCH_ON_DISABLED
            self._following_error = False
            self.clear_emergency()
        elif self.state is State.REFRESH and not self._measured:
            self.state = State.MEASURE_INIT
            self._in(self._delays.measure)
        elif self.state in _POWERING_UP:
            self._measured = True
            self._enable_operation()

    def _enable_operation(self) -> None:
        self.state = State.OPERATION_ENABLED
        self._target_reached = True
        self._enter_mode()

    def _switch_off(self, state: State) -> None:
        """Power stage off, at once."""
        self._alarm_us = INF
        if self.state in _POWERED:
            self._release()
        self.state = state

    def _release(self) -> None:
        """The demand follows the axis, which stands."""
        self._leave_path()
        self._profile = None
        self._when_stopped = None
        self._homing, self._home_target = [], None
        self._motor.stand(round(self._motor.position))
        self._demand, self._demand_velocity = self._motor.position, 0.0
        self._tick_us = INF
        self._dirty = True

    def _stop(self, deceleration: Entry) -> None:
        """Decelerates from the present demand."""
        self._leave_path()
        self._homing, self._home_target = [], None
        self._follow_profile(
            stop(
                self._demand, self._demand_velocity, deceleration.value * self._acceleration_unit
            )
        )

    def _fault(self, code: int) -> None:
        """Emergency, then fault reaction: slow down on the quick stop ramp (0x605E = 2)."""
        if self.state is State.FAULT:
            self.emergency(code)
        elif self.state in _POWERED:
            already = self.state is State.FAULT_REACTION_ACTIVE
            self.state = State.FAULT_REACTION_ACTIVE
            self.emergency(code)
            if not already:
                self._when_stopped = State.FAULT
                self._stop(self._quick_stop_deceleration)
        else:
            self._alarm_us = INF
            self.state = State.FAULT
            self.emergency(code)

    def _on_communication_error(self, code: int) -> None:
        """What a heartbeat that fails to appear does is said by 0x6007 (CiA 402).

        0: no action; 1: fault; 2: disable voltage; 3: quick stop. READING: after 2 and 3 the drive
        is in fault, too, as for every emergency.
        """
        option = self._abort_connection.value
        if code == HEARTBEAT_ERROR and option == _NO_ACTION:
            self.emergency(code)
            return
        if code == HEARTBEAT_ERROR and option == _DISABLE_VOLTAGE and self.state in _POWERED:
            self._switch_off(State.SWITCH_ON_DISABLED)
        self._fault(code)

    # --- modes of operation -------------------------------------------------------------

    def _check_mode(self, value: int) -> None:
        if value not in self.MODES:
            raise SdoAbort(AbortCode.VALUE_RANGE)

    def _on_mode(self, value: int) -> None:
        if value == self._mode:
            return
        self._mode = value
        if self.state is State.OPERATION_ENABLED:
            if self._moving:
                self._stop(self._profile_deceleration)
            self._enter_mode()

    @property
    def _moving(self) -> bool:
        """Whether the demand is on its way."""
        return self._profile is not None

    def _enter_mode(self) -> None:
        """Operation enabled and the mode have come together."""
        self._acknowledged, self._setpoint, self._next_setpoint = False, None, None
        self._homed = self._homing_error = False

    def _command_mode(self, last: int, word: int) -> None:
        """What a control word means to the mode; `last` is the one before."""
        if self.mode == Mode.PROFILE_POSITION:
            self._command_profile(last, word)
        else:
            self._command_homing(last, word)

    def _leave_path(self) -> None:
        """The demand is no longer what the mode makes it; `_demand_velocity` has to be right."""

    # --- profile position mode (CiA 402) ------------------------------------------------

    def _command_profile(self, last: int, word: int) -> None:
        rising = word & ~last
        if (word ^ last) & Control.HALT:
            if word & Control.HALT:
                self._stop(self._profile_deceleration)
            elif self._setpoint is not None:
                self._move_to(self._setpoint)
        if rising & Control.NEW_SETPOINT and not self._acknowledged:
            self._take_setpoint(word)
        if not word & Control.NEW_SETPOINT and self._next_setpoint is None:
            self._acknowledged = False

    def _take_setpoint(self, word: int) -> None:
        target = self._target.value
        if word & Control.RELATIVE:
            target += round(self._demand) if self._setpoint is None else self._setpoint
        if not self._min_position.value <= target <= self._max_position.value:
            self._fault(SOFTWARE_POSITION_LIMIT)
            return
        self._acknowledged = True
        if self._profile is not None and not word & Control.CHANGE_IMMEDIATELY:
            self._next_setpoint = target
            return
        self._setpoint, self._next_setpoint = target, None
        if not word & Control.HALT:
            self._move_to(target)

    def _move_to(self, target: int) -> None:
        limit = self._max_acceleration.value
        self._move(
            target,
            min(self._profile_velocity.value, self._max_velocity.value),
            min(self._profile_acceleration.value, limit),
            min(self._profile_deceleration.value, limit),
        )

    def _move(self, target: float, speed: int, acceleration: int, deceleration: int) -> None:
        """Goes to `target`, within limits in the drive's units."""
        self._follow_profile(
            trapezoid(
                self._demand,
                self._demand_velocity,
                target,
                speed * self._velocity_unit,
                acceleration * self._acceleration_unit,
                deceleration * self._acceleration_unit,
            )
        )

    # --- homing mode (CiA 402) ----------------------------------------------------------

    def _command_homing(self, last: int, word: int) -> None:
        rising = word & ~last
        if rising & Control.HALT or last & ~word & Control.HOMING_START:
            if self._homing or self._home_target is not None:
                self._stop(self._homing_acceleration)
        elif rising & Control.HOMING_START and not word & Control.HALT:
            self._homed = self._homing_error = self._referenced = False
            method = self._homing_method.value
            here = self._motor.position
            if method in ACTUAL_POSITION:
                self._home_found(here + self._home_offset.value)
                return
            self._homing = plan(
                method,
                here - self._machine_zero,
                self._switches,
                self.counts_per_turn,
                CURRENT_THRESHOLD,
            )
            self._begin_search()

    def _begin_search(self) -> None:
        search = self._homing[0]
        speed = (self._zero_speed if search.slow else self._switch_speed).value
        self._follow_profile(
            jog(
                self._demand,
                self._demand_velocity,
                search.direction * speed * self._velocity_unit,
                self._homing_acceleration.value * self._acceleration_unit,
            )
        )

    def _search(self) -> None:
        """Looks whether the axis has passed what it is searching."""
        search = self._homing[0]
        machine = self._motor.position - self._machine_zero
        if (machine - search.edge) * search.direction >= 0:
            del self._homing[0]
            if self._homing:
                self._begin_search()
            else:
                self._home_target = search.edge + self._machine_zero + self._home_offset.value
                acceleration = self._homing_acceleration.value
                self._move(
                    self._home_target, self._switch_speed.value, acceleration, acceleration
                )
        else:
            limit = (
                self._switches.positive_limit
                if search.direction > 0
                else self._switches.negative_limit
            )
            if (machine - limit) * search.direction > 0:  # a limit switch before what it searches
                self._homing_error = True
                self._stop(self._homing_acceleration)

    def _home_found(self, place: float) -> None:
        """From now on `place` is called home position (0x2081)."""
        shift = self._home_position.value - place
        self._machine_zero += shift
        self._motor.stand(self._motor.position + shift)
        self._demand += shift
        self._home_target = None
        self._homed = self._referenced = True
        self._dirty = True

    # --- control cycle ------------------------------------------------------------------

    def _follow_profile(self, profile: Profile) -> None:
        self._start_cycles()
        self._profile, self._profile_start = profile, self._cycle
        self._target_reached = False
        self._dirty = True

    def _start_cycles(self) -> None:
        """Control cycles count only while something moves; they are 1 ms of the drive's clock."""
        if self._tick_us == INF and self.state in _POWERED:
            self._origin_us, self._cycle, self._window_since = self.now_us, 0, 0
            self._schedule_cycle()

    def _schedule_cycle(self) -> None:
        self._tick_us = self._origin_us + (self._cycle + 1) * 1000.0 / self.rate
        self.next_event_us = min(self._tick_us, self._timers_us)

    def _next_cycle(self) -> int:
        self._cycle += 1
        self._tick_us = self._origin_us + (self._cycle + 1) * 1000.0 / self.rate
        return self._cycle

    def _tick(self) -> None:
        cycle, arrived = self._next_cycle(), False
        if self._profile is not None:
            elapsed = cycle - self._profile_start
            self._demand, self._demand_velocity = self._profile.at(elapsed)
            arrived = elapsed >= self._profile.duration_ms
        self._control()
        if self._homing:
            self._search()
        elif arrived:
            self._arrive()
        elif self._profile is None:
            self._settle()

    def _control(self) -> None:
        """One cycle of position control, and the watch over it."""
        motor, demand = self._motor, self._demand
        motor.step(demand)
        lag = demand - motor.position
        limit = self._max_following_error.value
        if (lag > limit or -lag > limit) and self.state is not State.FAULT_REACTION_ACTIVE:
            self._following_error = True
            self._fault(FOLLOWING_ERROR)

    def _allowed(self, demand: float) -> bool:
        return self._min_position.value <= round(demand) <= self._max_position.value

    def _arrive(self) -> None:
        """The profile is at its end."""
        self._profile = None
        self._window_since = self._cycle
        self._dirty = True
        if self._when_stopped is not None:
            self._switch_off(self._when_stopped)
        elif self._home_target is not None:
            self._home_found(self._home_target)
        elif self._next_setpoint is not None and not self._word & Control.HALT:
            self._setpoint, self._next_setpoint = self._next_setpoint, None
            if not self._word & Control.NEW_SETPOINT:
                self._acknowledged = False
            self._move_to(self._setpoint)

    def _settle(self) -> None:
        """No demand is moving any more: target reached, then rest."""
        window, lag = self._window.value, abs(self._demand - self._motor.position)
        if window != UNLIMITED and lag > window:
            self._window_since = self._cycle
        if not self._target_reached:
            waited = self._cycle - self._window_since
            if window == UNLIMITED or waited >= self._window_time.value:
                self._target_reached = True
                self._dirty = True
        if self._motor.blocked or lag < _SETTLED_QC:
            self._motor.stand(None if self._motor.blocked else self._demand)
            self._dirty = True
            if self._target_reached or self._motor.blocked:
                self._tick_us = INF


def _int16(value: float) -> int:
    return max(-32768, min(32767, round(value)))
