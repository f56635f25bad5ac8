"""A simulated Nanotec CL3-E with its motor: profile position and homing mode.

Its dictionary is its maker's. Sources: Nanotec, "CL3-E CANopen/USB Technical Manual", chapter
"Profile Position" (in the text: the chapter); the maker's EDS of FIR-v1419 (`cl3e_objects`);
CiA 402 for the state machine and 0x60F2; CiA 301 for life guarding. Homing: CiA 402, with the bits
of the status word that Nanotec describes publicly; 0x607C moves nothing there. Internally
positions are in user units (counts), time in ms.

Not simulated, and refused: other modes than these (and 0, none), homing methods against a stop,
event timers of TPDOs, rotary axes (bits 6–7 of 0x60F2), other units of position and velocity in
0x60A8 and 0x60A9 than they are preset to.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from enum import Enum
from functools import partial
from typing import NamedTuple

from . import cl3e_objects, ramps
from .dictionary import (
    LOAD,
    SAVE,
    UNSIGNED8,
    UNSIGNED16,
    UNSIGNED32,
    AbortCode,
    Entry,
    SdoAbort,
    check_signature,
)
from .homing import ACTUAL_POSITION, Search, Switches, plan
from .motor import Motor
from .ramps import Limits
from .recorder import Recorder
from .slave import HEARTBEAT, HEARTBEAT_ERROR, INF, SYNC_PRODUCER, Identity, Slave

NANOTEC = 0x0000_026C
FOLLOWING_ERROR = 0x8611
LIFE_GUARD_ERROR = HEARTBEAT_ERROR
CYCLE_US = 1000.0
BOOT_MS = 300.0  # from the boot loader's boot-up to the drive's own: a guess, no document says
MODE_MS = 2.0  # from 0x6060 to 0x6061: a guess, too
PROFILE_POSITION, HOMING = 1, 6
HOMING_METHODS = (1, 2, 7, 11, 17, 18, 23, 27, 33, 34, 35)
JERK_LIMITED = 3  # in 0x6086
TENTH_DEGREES, RPM = 0xFF41_0000, 0x00B4_4700  # presets of 0x60A8 and 0x60A9
UNLIMITED = 0xFFFF_FFFF
_SETTLED = 1e-3


class Firmware(Enum):
    """Editions whose dictionaries differ; the value is what 0x100A begins with."""

    V1419 = "FIR-v1419"  # of the maker's EDS
    V1446 = "FIR-v1446"  # has 0x60F2, as the chapter
    V1738 = "FIR-v1738"  # 0x60A8 and 0x60A9 instead of 0x2061 … 0x2066


class State(Enum):
    """CiA 402 states by the bits 0–3, 5 and 6 of the status word."""

    SWITCH_ON_DISABLED = 0x40
    READY_TO_SWITCH_ON = 0x21
    SWITCHED_ON = 0x23
    OPERATION_ENABLED = 0x27
    QUICK_STOP_ACTIVE = 0x07
    FAULT_REACTION_ACTIVE = 0x0F
    FAULT = 0x08


class Control:
    """Bits of the control word (the chapter, "Control word")."""

    SWITCH_ON = 1 << 0
    ENABLE_VOLTAGE = 1 << 1
    QUICK_STOP = 1 << 2  # low active
    ENABLE_OPERATION = 1 << 3
    NEW_SETPOINT = HOMING_START = 1 << 4
    CHANGE_IMMEDIATELY = 1 << 5
    RELATIVE = 1 << 6
    FAULT_RESET = 1 << 7
    HALT = 1 << 8
    CHANGE_ON_SETPOINT = 1 << 9


class Status:
    """Bits of the status word besides those of the state (the chapter, "Status word")."""

    VOLTAGE_ENABLED = 1 << 4
    REMOTE = 1 << 9
    TARGET_REACHED = 1 << 10
    SETPOINT_ACKNOWLEDGE = 1 << 12
    HOMING_ATTAINED = SETPOINT_ACKNOWLEDGE
    FOLLOWING_ERROR = HOMING_ERROR = 1 << 13


# Relative and request-response options in 0x60F2 (CiA 402).
_PREVIOUS_TARGET, _DEMAND, _ACTUAL = 0, 1, 2
_RELEASE_AT_TARGET, _RELEASE_AT_ONCE = 1, 2

_POWERED = (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE, State.FAULT_REACTION_ACTIVE)
# Option codes: at once, by 0x6084, by 0x6085; 5 and 6 stay in quick stop active.
_OPTIONS = {
    0x605A: (0, 1, 2, 5, 6),
    0x605B: (0, 1),
    0x605C: (0, 1),
    0x605D: (1, 2),
    0x605E: (0, 1, 2),
    0x3700: (-1, 0, 1, 2),
}


class Order(NamedTuple):
    """A set-point with the marginal conditions that came with it."""

    target: int  # 0x607A
    relative: bool
    holds_speed: bool  # bit 9: the one before does not brake
    limits: Limits
    end_speed: float


class Cl3e(Slave):
    """One drive.

    node_id:    1 … 127
    position:   where the axis stands at power-on [counts]
    counts_per_turn: encoder increments (0x608F) somebody has stored in it
    lag_ms:     time constant with which the axis follows the demand in closed loop; 0: none
    firmware:   which edition
    switches:   of the machine, for homing
    drift_ppm:  of its clock against true time
    record:     keep what it makes of set-points, for `executed`; one that is to be carried out
                immediately (bit 5) begins a motion
    """

    def __init__(
        self,
        node_id: int,
        *,
        position: int = 0,
        counts_per_turn: int = 2000,
        lag_ms: float = 0.4,
        firmware: Firmware = Firmware.V1446,
        switches: Switches | None = None,
        drift_ppm: float = 0.0,
        record: bool = False,
        serial: int = 1,
        t_us: float = 0.0,
        boot_ms: float = BOOT_MS,
    ) -> None:
        identity = Identity(
            device_type=0x0004_0192,
            vendor_id=NANOTEC,
            product_code=3,
            revision=1,
            serial=serial,
            device_name=b"CL3-E-1-0F",
            hardware_version=b"0",
            software_version=firmware.value.encode(),
        )
        self._firmware = firmware
        self._switches = switches or Switches()
        self._machine_zero = 0.0  # where the machine's zero is since homing
        self._motor = Motor(float(position), lag_ms, 0.0, 0)
        self._demand = ramps.State(float(position), 0.0, 0.0)
        self._profile: ramps.Profile | None = None
        self._origin_us = t_us  # of cycle 0
        self._cycle = self._profile_start = 0
        self.started_us = t_us  # when the last profile began
        self.arrived_us = -math.inf  # when the demand was last at a target
        self._alarm_us = INF
        self.recorder = Recorder() if record else None
        self._motion_us = t_us  # when the motion that is recorded began
        super().__init__(node_id, identity, t_us, boot_ms)
        self.outbox.appendleft((HEARTBEAT + node_id, bytes(1)))  # the boot loader's
        self.rate = 1.0 + drift_ppm * 1e-6
        self._build_objects()
        self.dictionary[0x608F, 1].preset(counts_per_turn)
        self._reset_application()

    # --- observation and faults ---------------------------------------------------------

    @property
    def position_actual(self) -> int:
        """0x6064."""
        return self._sign * self._motor.measured

    @property
    def position_demand(self) -> int:
        """0x6062."""
        return self._sign * round(self._demand.position)

    @property
    def status_word(self) -> int:
        """0x6041."""
        word = self.state.value
        if self.state not in (State.SWITCH_ON_DISABLED, State.FAULT):
            word |= Status.VOLTAGE_ENABLED
        if self._operational:
            word |= Status.REMOTE
        if self.state in (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE) and self._reached:
            word |= Status.TARGET_REACHED
        if self.state is State.OPERATION_ENABLED and self._acknowledged:
            word |= Status.SETPOINT_ACKNOWLEDGE
        if self._mode == PROFILE_POSITION and self._following_error:
            word |= Status.FOLLOWING_ERROR
        if self._mode == HOMING and self.state is State.OPERATION_ENABLED:
            if self._homed:
                word |= Status.HOMING_ATTAINED
            if self._homing_error:
                word |= Status.HOMING_ERROR
        return word

    def executed(self) -> list[tuple[int, float]]:
        """(ms since its motion began, position demand) in each cycle of it that moved something."""
        if self.recorder is None:
            raise ValueError(f"node {self.node_id} was not told to record")
        return self.recorder.executed()

    def fail(self, code: int) -> None:
        """Something in the drive breaks: emergency `code` and fault reaction."""
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
        self._demand = ramps.State(self._motor.position, 0.0, 0.0)
        self._dirty = True
        self._send_events()
        self._arm()
        return True

    # --- object dictionary --------------------------------------------------------------

    def _build_objects(self) -> None:
        od, node = self.dictionary, self.node_id
        rows = {(row.index, row.subindex): row for row in cl3e_objects.rows()}
        od.keep({*rows, *(key for key, _ in od.items() if 0x1400 <= key[0] <= 0x1BFF)})
        for (index, subindex), row in rows.items():
            if (index, subindex) not in od:
                od.variable(index, Entry(row.name, row.type), subindex)
            entry = od[index, subindex]
            entry.name, entry.access, entry.mappable = row.name, row.access, row.mappable
            if (default := row.default_of(node)) is not None and index != 0x1018:
                entry.preset(default)
        od[0x2009, 0].preset(node)
        self._add_later_objects()
        self._bind_communication()
        self._bind_motion()
        for rpdo, factory in zip(self.rpdos, cl3e_objects.RPDOS, strict=True):
            rpdo.preset(factory.cob_id + node, factory.mapping)
        for tpdo, factory in zip(self.tpdos, cl3e_objects.TPDOS, strict=True):
            tpdo.preset(factory.cob_id + node, factory.mapping)
        for n in range(len(self.tpdos)):
            od.variable(0x1800 + n, Entry("Compatibility entry", UNSIGNED8), 4)
            od.variable(0x1800 + n, Entry("Event timer", UNSIGNED16, low=0, high=0), 5)
            od[0x1800 + n, 0].preset(5)
        self._reconfigure()

    def _add_later_objects(self) -> None:
        """What firmware after that of the EDS has, and has no more."""
        od = self.dictionary
        if self._firmware is Firmware.V1419:
            return
        od.variable(0x2067, Entry("Jerk limit (internal)", UNSIGNED32, value=UNLIMITED, low=1))
        od.variable(
            0x60F2,
            Entry(
                "Positioning option code",
                UNSIGNED16,
                "rww",
                _DEMAND,
                mappable=True,
                check=_check_positioning_option,
            ),
        )
        if self._firmware is Firmware.V1738:
            od.keep({key for key, _ in od.items() if not 0x2061 <= key[0] <= 0x2066})
            for index, name, unit in (
                (0x60A8, "SI unit position", TENTH_DEGREES),
                (0x60A9, "SI unit velocity", RPM),
            ):
                od.variable(index, Entry(name, UNSIGNED32, "rw", unit, low=unit, high=unit))

    def _bind_communication(self) -> None:
        od = self.dictionary
        self._sync_cob_id.check = _check_no_producer
        for subindex, last in ((1, 0xFFFF), (2, 0x1FFF)):
            entry = od[0x1010, subindex]
            entry.read, entry.check = lambda: 1, partial(check_signature, SAVE)
            entry.write = partial(self._save, last)
        entry = od[0x1011, 1]
        entry.read, entry.check = lambda: 0, partial(check_signature, LOAD)
        entry.write = self._load
        for n in range(6, 9):
            od[0x1003, n].read = partial(self._past_error, n - 1)

    def _bind_motion(self) -> None:
        od = self.dictionary

        def shows(index: int, read: Callable[[], int], fast: bool = True) -> None:
            entry = od[index, 0]
            entry.read, entry.fast = read, fast

        shows(0x603F, lambda: self._history[0] if self._history else 0, False)
        shows(0x6041, lambda: self.status_word, False)
        shows(0x6061, lambda: self._mode, False)
        shows(0x6062, lambda: self.position_demand)
        shows(0x6063, lambda: self._motor.measured)
        shows(0x6064, lambda: self.position_actual)
        shows(0x606B, lambda: self._in_velocity_units(self._demand.velocity))
        shows(0x606C, lambda: self._in_velocity_units(self._motor.velocity))
        shows(0x60F4, lambda: self.position_demand - self.position_actual)
        control = od[0x6040, 0]
        control.read, control.write = lambda: self._word, self._on_controlword
        mode = od[0x6060, 0]
        mode.check, mode.write = _check_mode, self._on_mode
        for index, allowed in _OPTIONS.items():
            od[index, 0].check = partial(_check_one_of, allowed)
        od[0x6098, 0].check = partial(_check_one_of, HOMING_METHODS)
        od[0x6086, 0].check = partial(_check_one_of, (0, JERK_LIMITED))
        od[0x607E, 0].check = self._check_polarity
        for index in (0x608F, 0x6091, 0x6092):
            for subindex in (1, 2):
                od[index, subindex].low = 1
        for index in range(0x2061, 0x2067):
            if (index, 0) in od:
                od[index, 0].low = 1

    def _save(self, last: int, signature: int) -> None:
        """Parameters up to this index, as they are now, are there after power-on."""
        for (index, _), entry in self.dictionary.items():
            if index <= last and entry.access in ("rw", "rww", "rwr"):
                entry.keep()

    def _load(self, signature: int) -> None:
        """After the next reset all parameters are as they left the factory."""
        for _, entry in self.dictionary.items():
            entry.stored = entry.default

    def _value(self, index: int, subindex: int = 0) -> int:
        return self.dictionary[index, subindex].value

    # --- units --------------------------------------------------------------------------

    @property
    def _sign(self) -> int:
        """Bit 7 of 0x607E turns the direction of the user's positions round."""
        return -1 if self._value(0x607E) & 0x80 else 1

    def _check_polarity(self, value: int) -> None:
        if self.state in _POWERED:
            raise SdoAbort(AbortCode.DEVICE_STATE)

    @property
    def counts_per_turn(self) -> float:
        """Of the motor.

        READING: the encoder's increments (0x608F) by feed (0x6092) and gear ratio (0x6091).
        """
        if self._firmware is Firmware.V1738:
            return 3600.0
        encoder, gear, feed = (
            self._value(index, 1) / self._value(index, 2) for index in (0x608F, 0x6091, 0x6092)
        )
        return encoder * feed / gear

    def _unit(self, index: int, per_second: int) -> float:
        """One unit of velocity, acceleration or jerk [counts/ms^n] by its pair from `index` on."""
        share = 1 / 60
        if (index, 0) in self.dictionary:
            share = self._value(index) / self._value(index + 1)
        return self.counts_per_turn * share * 1e-3**per_second

    @property
    def _velocity_unit(self) -> float:
        return self._unit(0x2061, 1)

    @property
    def _acceleration_unit(self) -> float:
        return self._unit(0x2063, 2)

    @property
    def _jerk_unit(self) -> float:
        return self._unit(0x2065, 3)

    def _in_velocity_units(self, velocity: float) -> int:
        return self._sign * round(velocity / self._velocity_unit)

    # --- communication ------------------------------------------------------------------

    def _reset_node(self) -> None:
        """The boot loader says boot-up, then the drive itself."""
        self._send(HEARTBEAT + self.node_id, bytes(1))
        super()._reset_node()

    def _on_alarm(self) -> None:
        self._alarm_us = INF
        self._enter_mode()

    def _on_communication_error(self, code: int) -> None:
        self._fault(code)

    # --- state machine (CiA 402) --------------------------------------------------------

    def _reset_application(self) -> None:
        self.state = State.SWITCH_ON_DISABLED
        self._word = 0
        self._mode = self._value(0x6060)
        self._alarm_us = INF
        self._following_error = False
        self._target: int | None = None  # the last one, absolute
        self._reached = False
        self._release()

    def _release(self) -> None:
        """No power: the axis stands, nothing is left of any order."""
        self._profile = None
        self._active: Order | None = None  # the present set-point
        self._next: Order | None = None  # the one behind it
        self._moving = self._acknowledged = False
        self._homing: list[Search] = []  # what is left of a homing method
        self._homed = self._homing_error = False
        self._when_stopped: State | None = None
        self._window_since = self._behind_since = self._cycle
        self._motor.stand(round(self._motor.position))
        self._demand = ramps.State(self._motor.position, 0.0, 0.0)
        self._tick_us = INF

    def _switch_off(self, state: State) -> None:
        self.state = state
        self._release()
        self._dirty = True

    def _on_controlword(self, word: int) -> None:
        last, self._word = self._word, word
        state = self.state
        if state is State.FAULT:
            if word & ~last & Control.FAULT_RESET:
                self._following_error = False
                self.state = State.SWITCH_ON_DISABLED
                self.clear_emergency()
        elif state is not State.FAULT_REACTION_ACTIVE:
            self._command(word)
            if state is State.OPERATION_ENABLED and self.state is State.OPERATION_ENABLED:
                self._command_profile(last, word)
        self._dirty = True

    def _command(self, word: int) -> None:
        state = self.state
        if not word & Control.ENABLE_VOLTAGE:
            self._switch_off(State.SWITCH_ON_DISABLED)
        elif not word & Control.QUICK_STOP:
            if state is State.OPERATION_ENABLED:
                self._stop_quickly()
            elif state is not State.QUICK_STOP_ACTIVE:
                self._switch_off(State.SWITCH_ON_DISABLED)
        elif state is State.QUICK_STOP_ACTIVE:
            if word & 0x0F == 0x0F and self._when_stopped is None:
                self._enable()
        elif not word & Control.SWITCH_ON:
            self._leave(State.READY_TO_SWITCH_ON, 0x605B)
        elif state is State.SWITCH_ON_DISABLED:
            pass  # it takes "shutdown" first
        elif not word & Control.ENABLE_OPERATION:
            self._leave(State.SWITCHED_ON, 0x605C)
        elif state is State.OPERATION_ENABLED:
            self._when_stopped = None
        else:
            self._enable()

    def _enable(self) -> None:
        self.state = State.OPERATION_ENABLED
        self._release()
        self._reached = False

    def _leave(self, state: State, option: int) -> None:
        """Out of operation enabled: at once or after braking, by the option code."""
        if self.state is State.OPERATION_ENABLED and self._value(option):
            self._brake(self._value(0x6084), state)
        else:
            self._switch_off(state)

    def _stop_quickly(self) -> None:
        option = self._value(0x605A)
        if not option:
            self._switch_off(State.SWITCH_ON_DISABLED)
            return
        self.state = State.QUICK_STOP_ACTIVE
        rate = self._value(0x6084 if option in (1, 5) else 0x6085)
        self._brake(rate, State.SWITCH_ON_DISABLED if option < 5 else None)

    def _fault(self, code: int, option: int = 0x605E) -> None:
        reaction = self._value(option)
        if self.state in _POWERED and reaction:
            if self.state is not State.FAULT_REACTION_ACTIVE:
                self.state = State.FAULT_REACTION_ACTIVE
                self._brake(self._value(0x6084 if reaction == 1 else 0x6085), State.FAULT)
        else:
            self._switch_off(State.FAULT)
        self.emergency(code)

    # --- profile position mode (the chapter) --------------------------------------------

    def _on_mode(self, value: int) -> None:
        self._alarm_us = self.now_us + 1000.0 * MODE_MS / self.rate

    def _enter_mode(self) -> None:
        mode = self._value(0x6060)
        if mode != self._mode and self.state is State.OPERATION_ENABLED:
            self._next, self._acknowledged, self._moving = None, False, False
            self._homing, self._homed, self._homing_error = [], False, False
            if self._profile is not None:
                self._brake(self._value(0x6084))
        self._mode = mode
        self._dirty = True

    def _command_profile(self, last: int, word: int) -> None:
        if self._mode == HOMING:
            self._command_homing(last, word)
        if self._mode != PROFILE_POSITION:
            return  # silently, also while 0x6061 has not followed yet
        rising = word & ~last
        if rising & Control.HALT:
            rate = 0x6084 if self._value(0x605D) == 1 else 0x6085
            self._brake(self._value(rate), jerk_limited=True)
        elif last & ~word & Control.HALT and self._active is not None and self._moving:
            self._go(self._active)
        if rising & Control.NEW_SETPOINT and not self._acknowledged:
            self._take(word)
        self._settle_handshake()

    def _settle_handshake(self) -> None:
        """Bit 12 falls with bit 4, as soon as another set-point could be taken."""
        free = self._next is None
        if free and self._acknowledged and self._request_option == _RELEASE_AT_ONCE:
            self._word &= ~Control.NEW_SETPOINT
        if free and not self._word & Control.NEW_SETPOINT:
            self._acknowledged = False

    @property
    def _option(self) -> int:
        return self._value(0x60F2) if (0x60F2, 0) in self.dictionary else _PREVIOUS_TARGET

    @property
    def _request_option(self) -> int:
        return self._option >> 4 & 3

    def _take(self, word: int) -> None:
        """A new set-point: begun, kept for when the present one is reached, or refused.

        READING: while bit 12 is set every set-point is ignored, also one that is to be carried out
        immediately.
        """
        order = self._order(word)
        if not self._possible(order):
            return
        self._acknowledged = True
        if self.recorder is not None and word & Control.CHANGE_IMMEDIATELY:
            self._motion_us = self.now_us
            self.recorder.begin()
        if not self._moving or word & Control.CHANGE_IMMEDIATELY:
            self._begin(order)
            return
        self._next = order
        if order.holds_speed and not word & Control.HALT:
            self._hold_speed()

    def _order(self, word: int) -> Order:
        """The parameters as they are now; what comes later is for the next set-point."""
        velocity, acceleration = self._velocity_unit, self._acceleration_unit
        return Order(
            self._value(0x607A),
            bool(word & Control.RELATIVE),
            bool(word & Control.CHANGE_ON_SETPOINT),
            Limits(
                self._value(0x6081) * velocity,
                min(self._value(0x6083), self._value(0x60C5)) * acceleration,
                min(self._value(0x6084), self._value(0x60C6)) * acceleration,
                self._jerks(),
            ),
            min(self._value(0x6082), self._value(0x6081)) * velocity,
        )

    def _jerks(self) -> tuple[float, float, float, float]:
        """READING: an entry of 0 is no limit at its place, whatever 0x2067 is."""
        if self._value(0x6086) != JERK_LIMITED:
            return (math.inf,) * 4
        most = self._value(0x2067) if (0x2067, 0) in self.dictionary else UNLIMITED
        first, second, third, fourth = (
            min(jerk, most) * self._jerk_unit if (jerk := self._value(0x60A4, n)) else math.inf
            for n in range(1, 5)
        )
        return first, second, third, fourth

    def _possible(self, order: Order) -> bool:
        """Whether it can be reached, and is within the limits of position."""
        limits = order.limits
        if not (limits.velocity and limits.acceleration and limits.deceleration):
            return False
        target = self._absolute(order)
        return all(
            self._value(index, 1) <= target <= self._value(index, 2) for index in (0x607B, 0x607D)
        )

    def _absolute(self, order: Order) -> int:
        """Where it leads; one that has to wait counts from where the present one leads."""
        if not order.relative:
            return order.target
        option = self._option & 3
        waits = self._moving and not self._word & Control.CHANGE_IMMEDIATELY
        if option == _PREVIOUS_TARGET or waits:
            return order.target + (self._target or 0)
        return order.target + (self.position_demand if option == _DEMAND else self.position_actual)

    def _begin(self, order: Order) -> None:
        """It is the present one from now on."""
        self._next, self._moving = None, False
        self._target = self._absolute(order)
        self._active, self._moving, self._reached = order, True, False
        if not self._word & Control.HALT:
            self._go(order)

    def _go(self, order: Order) -> None:
        assert self._target is not None
        self._reached = False
        profile, _ = ramps.move(
            self._demand, float(self._sign * self._target), order.end_speed, order.limits
        )
        self._follow(profile)

    def _hold_speed(self) -> None:
        """Bit 9: the present target is passed at profile velocity.

        READING: it is ignored where that velocity can't be reached any more before the target, for
        which the axis would have to back up and take a run-up.
        """
        assert self._active is not None and self._target is not None
        limits = self._active.limits
        target = float(self._sign * self._target)
        profile, kept = ramps.move(self._demand, target, limits.velocity, limits)
        if kept:
            self._follow(profile)

    def _brake(self, rate: int, then: State | None = None, *, jerk_limited: bool = False) -> None:
        """To rest. READING: only a halt keeps the limits of jerk."""
        self._when_stopped = then
        if self.state is not State.OPERATION_ENABLED or then is not None:
            self._next, self._acknowledged = None, False
            self._moving = False
        self._reached = False
        deceleration = max(1, rate) * self._acceleration_unit
        jerks = self._jerks() if jerk_limited else (math.inf,) * 4
        limits = Limits(math.inf, deceleration, deceleration, jerks)
        self._follow(ramps.stop(self._demand, limits))

    # --- homing mode (CiA 402) ----------------------------------------------------------

    def _command_homing(self, last: int, word: int) -> None:
        """Bit 4 has to stay while the axis searches."""
        rising = word & ~last
        if rising & Control.HALT or last & ~word & Control.HOMING_START:
            if self._homing:
                self._homing = []
                self._brake(self._value(0x609A))
        elif rising & Control.HOMING_START and not word & Control.HALT:
            self._homed = self._homing_error = self._reached = False
            method, here = self._value(0x6098), self._motor.position
            if not self._value(0x3202) & 1 and self._value(0x320A, 4) != 1:
                self._fail_homing()  # READING: open loop has no position to search by
            elif method in ACTUAL_POSITION:
                self._home_found(here)
            else:
                turn = round(self.counts_per_turn)
                self._homing = plan(method, here - self._machine_zero, self._switches, turn)
                self._begin_search()

    def _begin_search(self) -> None:
        search = self._homing[0]
        speed = self._value(0x6099, 2 if search.slow else 1) * self._velocity_unit
        rate = max(1, self._value(0x609A)) * self._acceleration_unit
        limits = Limits(math.inf, rate, rate)
        self._follow(ramps.jog(self._demand, search.direction * speed, limits))

    def _search(self) -> None:
        """Looks whether the axis has passed what it is searching."""
        search = self._homing[0]
        machine = self._motor.position - self._machine_zero
        ahead = "positive_limit" if search.direction > 0 else "negative_limit"
        if (machine - search.edge) * search.direction >= 0:
            del self._homing[0]
            if self._homing:
                self._begin_search()
            else:
                self._home_found(search.edge + self._machine_zero)
        elif (machine - getattr(self._switches, ahead)) * search.direction > 0:
            self._fail_homing()  # a limit switch before what it searches

    def _fail_homing(self) -> None:
        self._homing, self._homing_error = [], True
        self._brake(self._value(0x609A))

    def _home_found(self, place: float) -> None:
        """READING: zero is 0x607C on from `place`; the axis brakes and does not go back there."""
        shift = -self._value(0x607C) - place
        self._machine_zero += shift
        self._motor.position += shift
        self._motor.measured = round(self._motor.position)
        self._demand = self._demand._replace(position=self._demand.position + shift)
        self._target = None
        self._homed = True
        self._brake(self._value(0x609A))

    # --- control cycle ------------------------------------------------------------------

    def _follow(self, profile: ramps.Profile) -> None:
        self._start_cycles()
        self._profile, self._profile_start = profile, self._cycle
        self.started_us = self.now_us
        self._dirty = True

    def _start_cycles(self) -> None:
        """Cycles of 1 ms of the drive's clock count while something moves."""
        if self._tick_us == INF and self.state in _POWERED:
            self._origin_us, self._cycle = self.now_us, 0
            self._window_since = self._behind_since = 0
            self._schedule()

    def _schedule(self) -> None:
        self._tick_us = self._origin_us + (self._cycle + 1) * CYCLE_US / self.rate
        self.next_event_us = min(self._tick_us, self._timers_us)

    def _tick(self) -> None:
        self._cycle += 1
        self._tick_us = self._origin_us + (self._cycle + 1) * CYCLE_US / self.rate
        if self._profile is not None:
            elapsed = self._cycle - self._profile_start
            self._demand = self._profile.at(elapsed)
            if elapsed >= self._profile.duration:
                self._arrive(self._profile)
                if self.state not in _POWERED:
                    return
        if self._value(0x3202) & 1:
            self._motor.step(self._demand.position)
        else:  # open loop: no encoder, what is told is what is done
            self._motor.stand(self._demand.position)
            self._motor.velocity = self._demand.velocity
        if self.recorder is not None and self._mode == PROFILE_POSITION:
            since_ms = round((self.now_us - self._motion_us) * self.rate / 1000)
            level = (self._active is not None and self._moving) + (self._next is not None)
            demand, actual = self._sign * self._demand.position, float(self.position_actual)
            self.recorder.add(self.now_us, since_ms, demand, actual, level)
        lag = abs(self._demand.position - self._motor.position)
        self._watch(lag)
        if self._homing:
            self._search()
        if self._profile is None and self.state in _POWERED:
            self._settle(lag)

    def _arrive(self, profile: ramps.Profile) -> None:
        """The profile is at its end: a target, or rest."""
        self._dirty = True
        if self._when_stopped is not None:
            self._switch_off(self._when_stopped)
            return
        halted = self.state is not State.OPERATION_ENABLED or self._word & Control.HALT
        if not self._moving or halted:
            if not profile.end.velocity:
                self._rest()
            return
        self._moving = False
        self.arrived_us = self.now_us
        if self._request_option == _RELEASE_AT_TARGET:
            self._word &= ~Control.NEW_SETPOINT
        if self._next is not None:
            self._begin(self._next)
        elif not profile.end.velocity:
            self._rest()
        # READING: with an end velocity and no other set-point the axis goes on at that velocity.
        self._settle_handshake()

    def _rest(self) -> None:
        self._profile = None
        self._demand = self._demand._replace(velocity=0.0, acceleration=0.0)
        self._window_since = self._cycle

    def _watch(self, lag: float) -> None:
        """Following error (0x6065, 0x6066), in closed loop."""
        if not self._value(0x3202) & 1 or lag <= self._value(0x6065):
            self._behind_since = self._cycle
            if self._following_error and self.state is not State.FAULT_REACTION_ACTIVE:
                self._following_error, self._dirty = False, True
        elif not self._following_error and self._cycle - self._behind_since >= self._value(0x6066):
            self._following_error, self._dirty = True, True
            if self._value(0x3700) >= 0:
                self._fault(FOLLOWING_ERROR, 0x3700)

    def _settle(self, lag: float) -> None:
        """The demand rests: target reached (0x6067, 0x6068), then no more cycles."""
        window = self._value(0x6067)
        if window != UNLIMITED and lag > window:
            self._window_since = self._cycle
            if self._reached:
                self._reached, self._dirty = False, True
        elif not self._reached and (
            window == UNLIMITED or self._cycle - self._window_since >= self._value(0x6068)
        ):
            self._reached, self._dirty = True, True
        if lag < _SETTLED and self._reached:
            self._motor.stand(self._demand.position)
            self._dirty = True
            self._tick_us = INF


def _check_no_producer(value: int) -> None:
    if value & SYNC_PRODUCER or not 0x01 <= value <= 0x7FF:
        raise SdoAbort(AbortCode.VALUE_RANGE)


def _check_mode(value: int) -> None:
    _check_one_of((0, PROFILE_POSITION, HOMING), value)


def _check_one_of(allowed: tuple[int, ...], value: int) -> None:
    if value not in allowed:
        raise SdoAbort(AbortCode.VALUE_RANGE)


def _check_positioning_option(value: int) -> None:
    if value & ~0x33 or value & 3 == 3 or value >> 4 & 3 == 3:
        raise SdoAbort(AbortCode.VALUE_RANGE)
