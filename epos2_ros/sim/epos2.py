"""A simulated maxon EPOS2 positioning controller with its motor.

Sources: maxon, application note "Interpolation Position Mode" (in the text: "the note");
CiA 402 for the state machine and the modes of operation; the EPOS2 firmware
specification for bits 8, 9 and 15 of the status word and the objects the note names only.
Internally positions are in qc, time in ms, velocity in qc/ms, acceleration in qc/ms².

Where the note leaves a choice, this drive takes the one that forgives less:

- The automaton of the note's 3.2 begins whenever "operation enabled" and mode 7 come
  together. Its transition I leaves the buffer as table 16 describes a cleared one: empty,
  access disabled.
- Records are taken only in that automaton and with access enabled. Others are refused: by
  SDO with "device state", by PDO without an answer (`refused_records` counts them).
- The segment in execution has left the buffer. With ip mode active two records have to be
  in it, unless the end record is among them.
- Velocity and acceleration of a segment are judged when it begins, all of it. Their
  warnings last as long as the segment, errors until the buffer is cleared.
- Bit 4 has to rise while "operation enabled" with mode 7 is on.
- Ip mode that ends in motion (bit 4, halt, the mode, an end record too early) leaves the
  axis to the profile deceleration.
- TIME and time stamps move the clock of the path, also in motion.
"""

from __future__ import annotations

import math
from enum import Enum, IntEnum
from functools import partial

from .clock import MotionClock
from .dictionary import (
    INTEGER8,
    INTEGER16,
    INTEGER32,
    UNSIGNED8,
    UNSIGNED16,
    UNSIGNED32,
    UNSIGNED64,
    AbortCode,
    Entry,
    SdoAbort,
)
from .homing import ACTUAL_POSITION, METHODS, Search, Switches, plan
from .interpolation import BUFFER_SIZE, BufferStatus, Fifo, Point, Segment
from .motor import Motor
from .profile import Profile, jog, stop, trapezoid
from .recorder import Recorder
from .slave import INF, Identity, Slave

FOLLOWING_ERROR = 0x8611
SOFTWARE_POSITION_LIMIT = 0xFF09
IPM_ERROR = 0xFF0C

MAXON = 0x0000_00FB
UNLIMITED = 0xFFFF_FFFF
_TOLERANCE = 1 + 1e-9  # for limits that are met exactly
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


_POWERED = (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE, State.FAULT_REACTION_ACTIVE)


class Epos2(Slave):
    """One drive.

    node_id:            1 … 127
    counts_per_turn:    quadrature counts of the encoder per motor turn [qc]
    position_qc:        where the axis stands at power-on
    drift_ppm, offset_us: of its motion clock against true time
    bitrate:            of the bus; the motion clock counts its bit times
    lag_ms:             time constant with which the axis follows the demand; 0: without lag
    noise_qc:           standard deviation of the measured position while it moves
    switches:           of the machine, for homing
    record:             keep what is executed in `recorder`
    """

    def __init__(
        self,
        node_id: int,
        *,
        counts_per_turn: int = 2000,
        position_qc: int = 0,
        drift_ppm: float = 0.0,
        offset_us: float = 0.0,
        bitrate: int = 1_000_000,
        lag_ms: float = 1.0,
        noise_qc: float = 0.0,
        switches: Switches | None = None,
        seed: int = 0,
        record: bool = False,
        vendor_id: int = MAXON,
        product_code: int = 0x6210_0000,
        revision: int = 0x2101_0000,
        serial: int = 1,
        t_us: float = 0.0,
    ) -> None:
        identity = Identity(
            device_type=0x0002_0192,
            vendor_id=vendor_id,
            product_code=product_code,
            revision=revision,
            serial=serial,
            device_name=b"EPOS2",
            hardware_version=f"{product_code >> 16:04X}h".encode(),
            software_version=f"{revision >> 16:04X}h".encode(),
        )
        self.counts_per_turn = counts_per_turn
        self.clock = MotionClock(offset_us, drift_ppm, 1e6 / bitrate)
        self.recorder = Recorder() if record else None
        self.ip_start_us = math.nan  # true time of the last path's zero
        self.refused_records = 0  # PVT records that came when none was accepted
        self._motor = Motor(float(position_qc), lag_ms, noise_qc, seed)
        self._switches = switches or Switches()
        self._machine_zero = 0.0  # where the machine's zero is since homing
        # the trajectory generator
        self._demand = float(position_qc)
        self._demand_velocity = 0.0
        self._fifo = Fifo()
        self._origin_us = 0.0  # true time of cycle 0
        self._cycle = 0
        self._profile: Profile | None = None
        self._profile_start = 0
        super().__init__(node_id, identity, t_us)
        self.rate = self.clock.rate
        self._build_objects()
        self._reset_application()

    # --- observation and faults ---------------------------------------------------------

    @property
    def executed(self) -> list[tuple[int, float]]:
        """(path time [ms], position demand [qc], not rounded) of the last motion in ip mode."""
        if self.recorder is None:
            raise ValueError(f"node {self.node_id} was not told to record")
        return self.recorder.executed()

    @property
    def ip_active(self) -> bool:
        return self._ip_active

    @property
    def buffer_level(self) -> int:
        """Records in the buffer."""
        return len(self._fifo)

    @property
    def position_demand(self) -> int:
        return round(self._demand)

    @property
    def position_actual(self) -> int:
        return self._motor.measured

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
            if self.mode == Mode.INTERPOLATED_POSITION:
                if self._ip_active:
                    word |= Status.IP_MODE_ACTIVE
            elif self.mode == Mode.PROFILE_POSITION:
                if self._acknowledged:
                    word |= Status.SETPOINT_ACKNOWLEDGE
            else:
                if self._homed:
                    word |= Status.HOMING_ATTAINED
                if self._homing_error:
                    word |= Status.HOMING_ERROR
        if self.mode == Mode.PROFILE_POSITION and self._following_error:
            word |= Status.FOLLOWING_ERROR
        return word

    @property
    def buffer_status(self) -> int:
        """0x20C4-01."""
        status = self._ip_flags
        level = len(self._fifo)
        if level < self._underflow_level.value:
            status |= BufferStatus.UNDERFLOW_WARNING
        if level > self._overflow_level.value:
            status |= BufferStatus.OVERFLOW_WARNING
        if self._fifo.enabled:
            status |= BufferStatus.BUFFER_ENABLED
        if self._ip_active:
            status |= BufferStatus.IP_MODE_ACTIVE
        return int(status)

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

    # --- object dictionary --------------------------------------------------------------

    def _build_objects(self) -> None:
        od = self.dictionary
        mapped = partial(Entry, mappable=True)
        fast = partial(Entry, access="ro", mappable=True, fast=True)

        # SYNC time stamp mechanism (the note, 3.6.2)
        od.variable(
            0x1013,
            mapped(
                "High resolution time stamp",
                UNSIGNED32,
                read=lambda: self.clock.latched,
                write=self._on_timestamp,
            ),
        )
        # interpolated position mode (the note, 3.6)
        od.variable(
            0x20C1,
            mapped(
                "Interpolation data record",
                UNSIGNED64,
                "wo",
                check=self._check_record,
                write=self._on_record,
            ),
        )
        self._underflow_level = Entry(
            "Interpolation buffer underflow warning", UNSIGNED16, value=4, high=63
        )
        self._overflow_level = Entry(
            "Interpolation buffer overflow warning", UNSIGNED16, value=60, low=1, high=64
        )
        od.record(
            0x20C4,
            mapped(
                "Interpolation buffer status", UNSIGNED16, "ro", read=lambda: self.buffer_status
            ),
            self._underflow_level,
            self._overflow_level,
        )
        od.variable(
            0x60C0, Entry("Interpolation sub mode selection", INTEGER16, value=-1, low=-1, high=-1)
        )
        od.record(
            0x60C2,
            Entry("Interpolation time period value", UNSIGNED8, value=1, low=1, high=1),
            Entry("Interpolation time index", INTEGER8, value=-3, low=-3, high=-3),
        )
        od.record(
            0x60C4,
            Entry("Maximum buffer size", UNSIGNED32, "ro", BUFFER_SIZE),
            mapped(
                "Actual buffer size",
                UNSIGNED32,
                "ro",
                read=lambda: BUFFER_SIZE - len(self._fifo),
            ),
            Entry("Buffer organisation", UNSIGNED8, high=0),
            Entry("Buffer position", UNSIGNED16, high=BUFFER_SIZE, read=lambda: len(self._fifo)),
            Entry("Size of data record", UNSIGNED8, "wo", 8, low=8, high=8),
            Entry("Buffer clear", UNSIGNED8, "wo", high=1, write=self._on_buffer_clear),
        )
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
        modes = sum(1 << mode - 1 for mode in Mode)
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
                read=lambda: round(self._motor.velocity / self._velocity_unit),
            ),
        )
        od.variable(
            0x6078,
            fast(
                "Current actual value",
                INTEGER16,
                read=lambda: _int16(
                    self._motor.acceleration / self._acceleration_unit * _MA_PER_RPM_S
                ),
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
                value=25_000,
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
        if self.state in _POWERED:
            raise SdoAbort(AbortCode.DEVICE_STATE)

    def _check_homing_method(self, value: int) -> None:
        if value not in METHODS:
            raise SdoAbort(AbortCode.VALUE_RANGE)

    def _check_max_velocity(self, value: int) -> None:
        if value > 25_000 * 10**-self._velocity_notation.value:
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
        self._word = 0  # the last control word
        self._mode = self._selected_mode.value
        self._referenced = False
        self._ip_active = False
        self._clear_buffer()
        self._segment: Segment | None = None
        self._check_position = False
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
                self.state = State.SWITCH_ON_DISABLED
                self._following_error = False
                self.clear_emergency()
        elif state is not State.FAULT_REACTION_ACTIVE:
            self._command(word)
            if state is State.OPERATION_ENABLED and self.state is State.OPERATION_ENABLED:
                if self.mode == Mode.INTERPOLATED_POSITION:
                    self._command_interpolation(last, word)
                elif self.mode == Mode.PROFILE_POSITION:
                    self._command_profile(last, word)
                else:
                    self._command_homing(last, word)

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
            else:
                self._enable_operation()

    def _enable_operation(self) -> None:
        self.state = State.OPERATION_ENABLED
        self._target_reached = True
        self._enter_mode()

    def _switch_off(self, state: State) -> None:
        """Power stage off, at once."""
        if self.state in _POWERED:
            self._release()
        self.state = state

    def _release(self) -> None:
        """The demand follows the axis, which stands."""
        self._deactivate()
        self._profile = None
        self._when_stopped = None
        self._homing, self._home_target = [], None
        self._motor.stand(round(self._motor.position))
        self._demand, self._demand_velocity = self._motor.position, 0.0
        self._tick_us = INF
        self._dirty = True

    def _stop(self, deceleration: Entry) -> None:
        """Decelerates from the present demand."""
        self._deactivate()
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
            self.state = State.FAULT
            self.emergency(code)

    def _on_communication_error(self, code: int) -> None:
        self._fault(code)

    # --- modes of operation -------------------------------------------------------------

    def _check_mode(self, value: int) -> None:
        if value not in list(Mode):
            raise SdoAbort(AbortCode.VALUE_RANGE)

    def _on_mode(self, value: int) -> None:
        if value == self._mode:
            return
        self._mode = value
        if self.state is State.OPERATION_ENABLED:
            if self._ip_active or self._profile is not None:
                self._stop(self._profile_deceleration)
            self._enter_mode()

    def _enter_mode(self) -> None:
        self._acknowledged, self._setpoint, self._next_setpoint = False, None, None
        self._homed = self._homing_error = False
        if self.mode == Mode.INTERPOLATED_POSITION:  # transition I (the note, table 3)
            self._clear_buffer()

    # --- interpolated position mode (the note, 3.2) -------------------------------------

    @property
    def _ip_selected(self) -> bool:
        """Whether the automaton of the note's figure 5 exists."""
        return (
            self.state is State.OPERATION_ENABLED and self.mode == Mode.INTERPOLATED_POSITION
        )

    def _clear_buffer(self) -> None:
        self._fifo.clear()
        self._ip_flags = BufferStatus(0)

    def _on_buffer_clear(self, value: int) -> None:
        if value:
            self._fifo.enabled = True
        else:
            self._clear_buffer()
            self._check_supply()

    def _check_record(self, _: int) -> None:
        if not (self._fifo.enabled and self._ip_selected):
            self.refused_records += 1
            raise SdoAbort(AbortCode.DEVICE_STATE)
        if self._fifo.full:
            self._ip_error(BufferStatus.OVERFLOW_ERROR)
            raise SdoAbort(AbortCode.DEVICE_STATE)

    def _on_record(self, record: int) -> None:
        self._fifo.push(Point.unpack(record))

    def _command_interpolation(self, last: int, word: int) -> None:
        ask = word & Control.ENABLE_IP_MODE and not word & Control.HALT
        asked = last & Control.ENABLE_IP_MODE and not last & Control.HALT
        if ask and not asked:
            self._activate()
        elif not ask and self._ip_active:
            self._stop(self._profile_deceleration)

    def _activate(self) -> None:
        """Transition III; what came in now is the zero of the path."""
        self._ip_active = True
        self._ip_flags = BufferStatus(0)
        self._profile = None
        self._target_reached = False
        self.ip_start_us = self.received_us
        self._origin_us, self._cycle = self.received_us, 0
        self._schedule_cycle()
        self._segment = None
        self._next_segment()
        if self.recorder is not None:
            self.recorder.begin()
            self._record()

    def _deactivate(self) -> None:
        """Transition IV."""
        if self._segment is not None:
            self._demand_velocity = self._segment.velocity(self._cycle)
        self._ip_active = False
        self._segment = None
        self._ip_flags &= ~(BufferStatus.VELOCITY_WARNING | BufferStatus.ACCELERATION_WARNING)
        self._dirty = True

    def _next_segment(self) -> None:
        """Takes a record out of the buffer, for the segment that starts in this cycle."""
        self._dirty = True
        if not len(self._fifo):
            self._check_supply()
            return
        point = self._fifo.pop()
        if point.time_ms == 0:
            self._stop(self._profile_deceleration)
            return
        if self._segment is not None:
            self._demand_velocity = self._segment.c
        unit = self._velocity_unit
        segment = Segment(
            self._cycle,
            self._demand,
            self._demand_velocity,
            point.position,
            point.velocity * unit,
            point.time_ms,
        )
        self._segment = segment
        low, high = segment.hull()
        self._check_position = not (
            self._min_position.value <= low and high <= self._max_position.value
        )
        velocity = segment.peak_velocity() / unit / _TOLERANCE
        acceleration = segment.peak_acceleration() / self._acceleration_unit / _TOLERANCE
        self._ip_flags = BufferStatus(0)
        if velocity > self._profile_velocity.value:
            self._ip_flags |= BufferStatus.VELOCITY_WARNING
        if acceleration > self._profile_acceleration.value:
            self._ip_flags |= BufferStatus.ACCELERATION_WARNING
        if velocity > self._max_velocity.value:
            self._ip_error(BufferStatus.VELOCITY_ERROR)
        elif acceleration > self._max_acceleration.value:
            self._ip_error(BufferStatus.ACCELERATION_ERROR)
        else:
            self._check_supply()

    def _check_supply(self) -> None:
        if self._ip_active and self._fifo.starved:
            self._ip_error(BufferStatus.UNDERFLOW_ERROR)

    def _ip_error(self, flag: BufferStatus) -> None:
        self._ip_flags |= flag
        self._fault(IPM_ERROR)

    # --- the motion clock (the note, 2.4) -----------------------------------------------

    def _on_sync(self) -> None:
        self.clock.latch(self.received_us)

    def _on_timestamp(self, value: int) -> None:
        self._shift_path(self.clock.correct(value))

    def _on_time(self) -> None:
        self._shift_path(self.clock.reset(self.received_us))

    def _shift_path(self, shift_us: float) -> None:
        """The interpolation keeps to the motion clock: it goes on by `shift_us` at once."""
        if self._ip_active:
            self._origin_us -= shift_us / self.rate
            self._schedule_cycle()

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
                method, here - self._machine_zero, self._switches, self.counts_per_turn
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

    def _tick(self) -> None:
        cycle = self._cycle = self._cycle + 1
        self._tick_us = self._origin_us + (cycle + 1) * 1000.0 / self.rate
        segment, arrived = self._segment, False
        if segment is not None:
            u = cycle - segment.end_ms
            demand = ((segment.a * u + segment.b) * u + segment.c) * u + segment.d
            if self._check_position and not self._allowed(demand):
                self._fault(SOFTWARE_POSITION_LIMIT)
            else:
                self._demand = demand
        elif self._profile is not None:
            elapsed = cycle - self._profile_start
            self._demand, self._demand_velocity = self._profile.at(elapsed)
            arrived = elapsed >= self._profile.duration_ms

        motor = self._motor
        motor.step(self._demand)
        lag = self._demand - motor.position
        limit = self._max_following_error.value
        if (lag > limit or -lag > limit) and self.state is not State.FAULT_REACTION_ACTIVE:
            self._following_error = True
            self._fault(FOLLOWING_ERROR)

        if segment is not None:
            if cycle == segment.end_ms and self._segment is segment:
                self._next_segment()
            if self.recorder is not None:
                self._record()
        elif self._homing:
            self._search()
        elif arrived:
            self._arrive()
        elif self._profile is None:
            self._settle(lag)

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

    def _settle(self, lag: float) -> None:
        """No demand is moving any more: target reached, then rest."""
        window = self._window.value
        if window != UNLIMITED and abs(lag) > window:
            self._window_since = self._cycle
        if not self._target_reached:
            waited = self._cycle - self._window_since
            if window == UNLIMITED or waited >= self._window_time.value:
                self._target_reached = True
                self._dirty = True
        if self._motor.blocked or abs(lag) < _SETTLED_QC:
            self._motor.stand(None if self._motor.blocked else self._demand)
            self._dirty = True
            if self._target_reached or self._motor.blocked:
                self._tick_us = INF

    def _record(self) -> None:
        assert self.recorder is not None
        self.recorder.add(
            self.now_us, self._cycle, self._demand, self._motor.measured, len(self._fifo)
        )


def _int16(value: float) -> int:
    return max(-32768, min(32767, round(value)))
