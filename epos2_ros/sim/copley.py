"""A simulated Copley drive of the plus family with its motor and position-triggered outputs.

Sources: Copley, "Setting outputs at position" (in the text: "the note"); CiA 402 for the state
machine and profile position mode; for interpolated position mode `copley_pvt` names them. Units of
CiA 402's objects on a Copley drive: position in counts, velocity in 0.1 counts/s, acceleration in
10 counts/s² (public descriptions of its CANopen objects). Internally positions are in counts, time
in ms, velocity in counts/ms.

In interpolated position mode, where no text says: READING: bit 4 has to rise while "operation
enabled" in this mode, as on an EPOS2; the SYNC that makes it count is the path's zero, and 0x1013
shifts the path with the clock. A halt, bit 4 low, a flush, an underflow and another mode end the
path on a ramp (0x6084; 0x6085 where 0x605D is 2, as the maker has it, and for an underflow), and
what is in the buffer stays there: halt released with bit 4 set, the next path is made of it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from enum import Enum
from functools import partial

from . import copley_objects, ramps
from .clock import MotionClock
from .copley_compare import CompareModule, SoftwarePin, TraceMemory
from .copley_homing import Homing
from .copley_pvt import FLUSH, PvtBuffer, PvtPath
from .dictionary import (
    INTEGER8,
    INTEGER16,
    INTEGER32,
    SAVE,
    UNSIGNED16,
    UNSIGNED32,
    UNSIGNED64,
    AbortCode,
    DataType,
    Entry,
    ObjectDictionary,
    SdoAbort,
    check_signature,
)
from .homing import Switches
from .maker_table import PdoRow
from .profile import Profile, stop, trapezoid
from .recorder import Recorder
from .sdo import SdoServer
from .slave import INF, Identity, Pdos, Slave

COPLEY_CONTROLS = 0x0000_00AB
LOOP_US = 250.0  # 4 kHz (the note, "Position extrapolation")
NUMBER_OF_OUTPUTS = 8
TRACE_WORDS = 8192
PROFILE_POSITION, HOMING, INTERPOLATED_POSITION = 1, 6, 7
CUBIC = -2  # 0x60C0: PVT
TRAPEZOIDAL, JERK_LIMITED = 0, 3  # of 0x6086
SLOW_DOWN_ON_QUICK_STOP_RAMP = 2  # of 0x605D
CANOPEN_MODE = 30  # of 0x2300
FOLLOWING_ERROR, FOLLOWING_ERROR_BIT = 0x8611, 9
MAX_SPEED = 500_000_000
PDOS = Pdos(number=8, entries=4, inhibits=False)
# From the factory, by its EDS; the others are off.
RPDOS = (
    PdoRow(0x200, (0x6040_0010,)),
    PdoRow(0x300, (0x6040_0010, 0x6060_0008)),
    PdoRow(0x400, (0x6040_0010, 0x607A_0020)),
    PdoRow(0x500, (0x6040_0010, 0x60FF_0020)),
)
TPDOS = (
    PdoRow(0x180, (0x6041_0010,)),
    PdoRow(0x280, (0x6041_0010, 0x6061_0008)),
    PdoRow(0x380, (0x6041_0010, 0x6064_0020)),
    PdoRow(0x480, (0x6041_0010, 0x606C_0020)),
)

VELOCITY_UNIT = 0.1e-3  # 0.1 counts/s [counts/ms]
ACCELERATION_UNIT = 10e-6  # 10 counts/s² [counts/ms²]
JERK_UNIT = 100e-9  # 100 counts/s³ [counts/ms³]
OUTPUT_BYTES = DataType(10)

Motion = Callable[[float], tuple[float, float]]


class State(Enum):
    """CiA 402 states by the bits 0–3, 5 and 6 of the status word."""

    SWITCH_ON_DISABLED = 0x40
    READY_TO_SWITCH_ON = 0x21
    SWITCHED_ON = 0x23
    OPERATION_ENABLED = 0x27
    QUICK_STOP_ACTIVE = 0x07
    FAULT = 0x08


class Control:
    """Bits of the control word."""

    SWITCH_ON = 1 << 0
    ENABLE_VOLTAGE = 1 << 1
    QUICK_STOP = 1 << 2  # low active
    ENABLE_OPERATION = 1 << 3
    NEW_SETPOINT = ENABLE_INTERPOLATION = 1 << 4
    CHANGE_IMMEDIATELY = 1 << 5
    RELATIVE = 1 << 6
    FAULT_RESET = 1 << 7
    HALT = 1 << 8


class Status:
    """Bits of the status word besides those of the state."""

    VOLTAGE_ENABLED = 1 << 4
    REMOTE = 1 << 9
    TARGET_REACHED = 1 << 10
    SETPOINT_ACKNOWLEDGE = INTERPOLATION_ACTIVE = HOMING_ATTAINED = 1 << 12
    HOMING_ERROR = 1 << 13


_PARTS = (
    "Save all parameters",
    "Save communication parameters",
    "Save application parameters",
    "Save manufacturer defined parameters",
)
_POWERED = (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE)


class Copley(Slave):
    """One drive.

    node_id:      1 … 127
    position:     where the axis stands at power-on [counts]
    quadrature:   a quadrature encoder on the primary input: the compare module sees every count.
                  Else the drive samples the encoder once a loop and extrapolates until the next
    count_offset: the encoder says floor(position + count_offset)
    lag_ms:       time constant with which the axis follows the commanded position; 0: none
    drift_ppm:    of its clock against true time
    offset_us:    its motion clock at true time 0
    record:       keep what it makes of PVT segments, for `executed`
    factors:      newer firmware's 0x608F, 0x6091 and 0x6092, as (value, value); older has none
    stuck_faults: bits of 0x2183 that come back when they are cleared
    switches:     of the machine, for homing
    turn:         of the motor, from index to index [counts]
    """

    velocity_unit = VELOCITY_UNIT
    acceleration_unit = ACCELERATION_UNIT

    def __init__(
        self,
        node_id: int,
        *,
        position: int = 0,
        quadrature: bool = True,
        count_offset: float = 0.5,
        lag_ms: float = 0.0,
        drift_ppm: float = 0.0,
        offset_us: float = 0.0,
        record: bool = False,
        serial: int = 1,
        t_us: float = 0.0,
        factors: Mapping[int, tuple[int, int]] | None = None,
        stuck_faults: int = 0,
        boot_ms: float = 0.0,
        switches: Switches | None = None,
        turn: int = 2000,
    ) -> None:
        self._homing = Homing(self, switches or Switches(), turn)
        self._factors = factors or {}
        self._stuck_faults = stuck_faults
        self.faults = stuck_faults  # 0x2183
        identity = Identity(
            device_type=0x0007_0192,
            vendor_id=COPLEY_CONTROLS,
            product_code=0x0000_0380,
            revision=0x0001_0028,  # firmware 1.40, the first with a compare module
            serial=serial,
            device_name=b"AEP",
            hardware_version=b"1",
            software_version=b"1.40",
        )
        self.module = CompareModule()
        self.trace = TraceMemory(TRACE_WORDS)
        self.pins = [SoftwarePin(self.trace) for _ in range(NUMBER_OF_OUTPUTS)]
        self.seen = (position, position)  # least and largest count the module has seen
        self._quadrature = quadrature
        self._offset = count_offset
        self._follow = 1.0 - math.exp(-LOOP_US / 1000 / lag_ms) if lag_ms else 1.0
        self._shaft = self._commanded = float(position)
        self._velocity = 0.0
        self.extrapolated = float(position)  # what it thinks at the end of the loop
        self._moved: Motion | None = None  # by hand
        self._profile: Profile | None = None
        self._profile_us = 0.0  # when it began
        self._setpoint: int | None = None
        self._next_setpoint: int | None = None
        self.arrived_us = -math.inf  # when the last profile was over
        self.clock = MotionClock(offset_us, drift_ppm, 1.0)
        self.pvt = PvtBuffer()
        self.recorder = Recorder() if record else None
        self.ip_start_us = math.nan  # true time of the last path's zero
        self._path: PvtPath | None = None
        self._origin_us = 0.0  # where its time begins, as the clock has it
        self._path_ms = 0  # last recorded
        super().__init__(node_id, identity, t_us, boot_ms, pdos=PDOS)
        self.rate = self.clock.rate
        self._build_objects()
        self._sdo = SdoServer(_WithTraceData(self.dictionary, self.trace))
        self._loop_us = t_us  # when the last loop began
        self._reset_application()

    # --- observation --------------------------------------------------------------------

    @property
    def position_actual(self) -> int:
        """What the encoder says."""
        return math.floor(self._shaft + self._offset)

    @property
    def started_us(self) -> float:
        """When the last profile began."""
        return self._profile_us

    @property
    def status_word(self) -> int:
        """0x6041."""
        word = self.state.value
        if self.state is not State.SWITCH_ON_DISABLED and self.state is not State.FAULT:
            word |= Status.VOLTAGE_ENABLED
        if self._operational:
            word |= Status.REMOTE
        if self._profile is None and self._path is None:
            word |= Status.TARGET_REACHED
        if self._acknowledged:
            word |= Status.SETPOINT_ACKNOWLEDGE
        if self.ip_active:
            word |= Status.INTERPOLATION_ACTIVE
        if self._homing.attained:
            word |= Status.HOMING_ATTAINED
        if self._homing.failed:
            word |= Status.HOMING_ERROR
        return word

    # --- what homing mode moves -----------------------------------------------------------

    @property
    def place(self) -> float:
        return self._shaft

    def demand_now(self) -> tuple[float, float]:
        return self._demand_at(self.now_us)

    def follow(self, profile: Profile) -> None:
        self._follow_profile(profile)
        self._dirty = True

    def rename(self, shift: float) -> None:
        position, velocity = self._demand_at(self.now_us)
        self._shaft += shift
        self.extrapolated += shift
        self._commanded = position + shift
        self._profile = Profile(position + shift, velocity).cruise()
        self._profile_us = self.now_us
        self._setpoint = self._next_setpoint = None
        self.module.stand(self.position_actual)

    # --- more observation -----------------------------------------------------------------

    @property
    def ip_active(self) -> bool:
        """Whether it follows a path of PVT segments."""
        return self._path is not None

    @property
    def position_demand(self) -> int:
        """0x6062."""
        return round(self._demand)

    @property
    def _demand(self) -> float:
        """It, not rounded."""
        return self._commanded

    @property
    def executed(self) -> list[tuple[int, float]]:
        """(path time [ms], position demand [counts], not rounded) of the last path."""
        if self.recorder is None:
            raise ValueError(f"node {self.node_id} was not told to record")
        return self.recorder.executed()

    def output(self, pin: int) -> bool:
        """The level at output `pin`, counted from 1."""
        output = self.pins[pin - 1]
        if output.function == 16:
            return self.module.output(self.now_us) != bool(output.word & 1 << 8)
        return output.output(self.now_us)

    def move_by_hand(self, motion: Motion | None) -> None:
        """Someone else moves the shaft: position and velocity [counts, counts/s] at time [µs]."""
        self._moved = motion
        self._run_loop()
        self._arm()

    def push(self, counts: float) -> bool:
        """A hand turns the shaft so far; `False`: the motor holds it."""
        if self.state in _POWERED:
            return False
        place = self._shaft + counts
        self.move_by_hand(lambda _: (place, 0.0))
        self.move_by_hand(None)
        return True

    # --- object dictionary --------------------------------------------------------------

    def _build_objects(self) -> None:
        od = self.dictionary
        mapped = partial(Entry, mappable=True)
        od.variable(0x6040, mapped("Controlword", UNSIGNED16, write=self._on_controlword))
        od.variable(0x6041, mapped("Statusword", UNSIGNED16, "ro", read=lambda: self.status_word))
        self._mode: Entry = od.variable(
            0x6060,
            mapped(
                "Modes of operation",
                INTEGER8,
                value=PROFILE_POSITION,
                check=self._check_mode,
                write=self._on_mode,
            ),
        )
        od.variable(
            0x6061,
            mapped("Modes of operation display", INTEGER8, "ro", read=lambda: self._mode.value),
        )
        for index, name, read in (
            (0x6062, "Position demand value", lambda: self.position_demand),
            (0x606C, "Velocity actual value", lambda: round(self._velocity / VELOCITY_UNIT)),
        ):
            od.variable(index, Entry(name, INTEGER32, "ro", mappable=True, read=read, fast=True))
        od.variable(
            0x6064,
            mapped(
                "Position actual value",
                INTEGER32,
                read=lambda: self.position_actual,
                check=self._check_position,
                fast=True,
            ),
        )
        self._target = od.variable(0x607A, mapped("Target position", INTEGER32))
        self._limits = (
            mapped("Min position limit", INTEGER32, value=INTEGER32.low),
            mapped("Max position limit", INTEGER32, value=INTEGER32.high),
        )
        od.record(0x607D, *self._limits)
        positive = partial(Entry, type=INTEGER32, low=1, mappable=True)
        self._speed = od.variable(
            0x6081,
            mapped("Profile velocity", INTEGER32, value=1_000_000, low=0, high=MAX_SPEED),
        )
        self._acceleration = od.variable(0x6083, positive("Profile acceleration", value=100_000))
        self._deceleration = od.variable(0x6084, positive("Profile deceleration", value=100_000))
        self._quick_stop = od.variable(0x6085, positive("Quick stop deceleration", value=1_000_000))
        self._profile_type = od.variable(
            0x6086, mapped("Motion profile type", INTEGER16, check=self._check_profile_type)
        )
        self._jerk = od.variable(0x2121, mapped("Profile target jerk", INTEGER32, low=0))
        od.variable(0x6502, Entry("Supported drive modes", UNSIGNED32, "ro", 1005))
        od.variable(0x60FF, mapped("Target velocity", INTEGER32))
        self._tracking_error = od.variable(
            0x2120, mapped("Tracking error distance", INTEGER32, value=4000, low=0)
        )
        od.variable(0x6065, mapped("Tracking warning distance", INTEGER32, value=2000))
        od.variable(
            0x2183,
            mapped(
                "Latching faults", UNSIGNED32, read=lambda: self.faults, write=self._clear_faults
            ),
        )
        self._desired_state = od.variable(
            0x2300, mapped("Desired amplifier state", UNSIGNED16, value=CANOPEN_MODE)
        )
        self._build_interpolation()
        self._homing.build(od)
        for index, values in self._factors.items():
            od.record(index, *(Entry("Factor", UNSIGNED32, value=value) for value in values))
        self._build_outputs()
        self._build_storing()
        self._take_makers_objects()

    def _build_interpolation(self) -> None:
        od, pvt = self.dictionary, self.pvt
        mapped = partial(Entry, mappable=True)
        od.variable(
            0x1013,
            mapped(
                "High resolution time stamp",
                UNSIGNED32,
                read=lambda: self.clock.latched,
                write=self._on_timestamp,
            ),
        )
        od.variable(0x2010, mapped("PVT buffer data", UNSIGNED64, write=self._on_pvt))
        for index, name, kind, read in (
            (0x2011, "PVT buffer count", UNSIGNED16, lambda: pvt.free),
            (0x2012, "PVT buffer status", UNSIGNED32, lambda: pvt.status),
            (0x2013, "PVT segment ID", UNSIGNED16, lambda: pvt.next_id),
        ):
            od.variable(index, mapped(name, kind, "ro", read=read, event=lambda: pvt.events))
        self._submode = od.variable(
            0x60C0, mapped("Interpolation submode select", INTEGER16, low=CUBIC, high=0)
        )
        self._halt_option = od.variable(0x605D, mapped("Halt option code", INTEGER16, value=1))

    @staticmethod
    def _check_profile_type(value: int) -> None:
        if value not in (TRAPEZOIDAL, JERK_LIMITED):
            raise SdoAbort(AbortCode.VALUE_RANGE)

    @staticmethod
    def _check_mode(mode: int) -> None:
        if mode not in (PROFILE_POSITION, HOMING, INTERPOLATED_POSITION):
            raise SdoAbort(AbortCode.VALUE_RANGE)

    def _on_mode(self, _: int) -> None:
        self._leave_path(self._deceleration)
        self._homing.reset()

    def _take_makers_objects(self) -> None:
        """Its objects, and its PDOs from the factory; what nothing here reads just keeps its value.

        No others but those of the note and of newer firmware.
        """
        od, node = self.dictionary, self.node_id
        rows = {(row.index, row.subindex): row for row in copley_objects.rows()}
        besides = {*range(0x1400, 0x1C00), *range(0x2160, 0x2166), *self._factors}
        od.keep({key for key, _ in od.items() if key in rows or key[0] in besides})
        for (index, subindex), row in rows.items():
            if (index, subindex) not in od:
                od.variable(index, Entry(row.name, row.type), subindex)
            entry = od[index, subindex]
            entry.name, entry.access, entry.mappable = row.name, row.access, row.mappable
            if row.low is not None:
                entry.low, entry.high = row.low, row.high
            if (default := row.default_of(node)) is not None:
                entry.preset(default)
        for number, pdo in enumerate((*self.rpdos, *self.tpdos)):
            pdo.types = range(256)
            kinds, place = (RPDOS, number) if number < PDOS.number else (TPDOS, number - 8)
            if place < len(kinds):
                factory = kinds[place]
                pdo.preset(factory.cob_id + node, factory.mapping)
                pdo.transmission.preset(0 if kinds is TPDOS and place >= 2 else 255)
        self._reconfigure()

    def _clear_faults(self, ones: int) -> None:
        self.faults = self.faults & ~ones | self._stuck_faults

    def _latch(self, fault: int, code: int) -> None:
        """A fault that stays until its bit in 0x2183 is cleared."""
        self.faults |= 1 << fault
        self._on_communication_error(code)

    @staticmethod
    def _check_position(value: int) -> None:
        """To set the position is not simulated."""
        raise SdoAbort(AbortCode.DEVICE_STATE)

    def _build_storing(self) -> None:
        """0x1010; its EDS has no 0x1011, so there is no way back but the maker's tool."""
        parts = (0x1000, 0xFFFF), (0x1000, 0x1FFF), (0x6000, 0x9FFF), (0x2000, 0x5FFF)
        self.dictionary.record(
            0x1010,
            *(
                Entry(
                    name,
                    UNSIGNED32,
                    read=lambda: 1,
                    check=partial(check_signature, SAVE),
                    write=partial(self._save, *part),
                )
                for name, part in zip(_PARTS, parts, strict=True)
            ),
        )

    def _save(self, first: int, last: int, signature: int) -> None:
        """Parameters of these objects, as they are now, are there after power-on."""
        for (index, _), entry in self.dictionary.items():
            if first <= index <= last and entry.access == "rw":
                entry.keep()

    def _build_outputs(self) -> None:
        od, module, trace = self.dictionary, self.module, self.trace
        od.record(
            0x2193,
            *(
                Entry(
                    f"Output {n} configuration",
                    OUTPUT_BYTES,
                    mappable=True,
                    check=self._check_output,
                    write=partial(self._on_output, pin),
                )
                for n, pin in enumerate(self.pins, 1)
            ),
        )

        def register(index: int, name: str, **hooks: object) -> None:
            od.variable(index, Entry(name, **hooks))  # type: ignore[arg-type]

        def value(number: int, new: int) -> None:
            module.values[number] = new

        register(
            0x2160,
            "Compare module configuration",
            type=UNSIGNED32,
            high=0x1F,
            read=lambda: module.configuration,
            write=self._on_module,
        )
        register(
            0x2161,
            "Compare module status",
            type=UNSIGNED32,
            read=lambda: module.status(self.now_us),
            write=self._on_clear,
        )
        for n in (0, 1):
            register(
                0x2162 + n,
                f"Compare value {n}",
                type=INTEGER32,
                read=lambda n=n: module.values[n],
                write=partial(value, n),
            )
        register(
            0x2164,
            "Compare increment",
            type=INTEGER32,
            write=lambda new: setattr(module, "increment", new),
        )
        register(
            0x2165,
            "Compare pulse period",
            type=UNSIGNED32,
            write=lambda new: setattr(module, "pulse_period", new),
        )
        register(
            0x250A,
            "Reserved trace memory",
            type=UNSIGNED16,
            mappable=True,
            high=trace.size,
            read=lambda: trace.reserved,
            write=trace.reserve,
        )
        register(
            0x250B,
            "Offset into the reserved trace memory",
            type=UNSIGNED16,
            mappable=True,
            read=lambda: trace.offset,
            write=lambda new: setattr(trace, "offset", new),
        )

    def _check_output(self, value: int) -> None:
        """Bits 9–11 and 15 of the configuration word are reserved, bits 12–13 another axis."""
        if value & 0xBE00 or value & 0xFF not in (4, 5, 6, 7, 9, 16):
            raise SdoAbort(AbortCode.VALUE_RANGE)

    def _on_output(self, pin: SoftwarePin, value: int) -> None:
        pin.configure(OUTPUT_BYTES.pack(value))
        self._sample(pin)

    def _on_module(self, value: int) -> None:
        self.module.configure(value)
        self.module.stand(self.position_actual)

    def _on_clear(self, value: int) -> None:
        self.module.matches &= ~value

    # --- state machine (CiA 402) --------------------------------------------------------

    def _reset_application(self) -> None:
        self.state = State.FAULT if self.faults else State.SWITCH_ON_DISABLED
        self._word = 0
        self._acknowledged = False
        self._setpoint = self._next_setpoint = None
        self._profile = self._path = None
        self.pvt.reset()
        self._commanded = self._shaft
        self.module.reset()
        self.trace.reserve(0)
        for n, pin in enumerate(self.pins, 1):
            pin.configure(self.dictionary[0x2193, n].pack())
        self._tick_us = INF if self._moved is None else self.now_us

    def _on_controlword(self, word: int) -> None:
        last, self._word = self._word, word
        if self.state is State.FAULT:
            if word & ~last & Control.FAULT_RESET and not self.faults:
                self.state = State.SWITCH_ON_DISABLED
                self.clear_emergency()
        elif not word & Control.ENABLE_VOLTAGE:
            self._switch_off(State.SWITCH_ON_DISABLED)
        elif not word & Control.QUICK_STOP:
            self._stop_quickly()
        elif self.state is not State.QUICK_STOP_ACTIVE:
            self._command(last, word)
        self._dirty = True

    def _command(self, last: int, word: int) -> None:
        if not word & Control.SWITCH_ON:
            self._switch_off(State.READY_TO_SWITCH_ON)
        elif self.state is State.SWITCH_ON_DISABLED:
            pass  # it takes "shutdown" first
        elif not word & Control.ENABLE_OPERATION:
            self._switch_off(State.SWITCHED_ON)
        elif self.state is not State.OPERATION_ENABLED:
            self.state = State.OPERATION_ENABLED
            self._commanded = float(self.position_actual)
            self._setpoint = self._next_setpoint = None
            self._acknowledged = False
        elif self._mode.value == INTERPOLATED_POSITION:
            self._command_path(last, word)
        elif self._mode.value == HOMING:
            self._homing.command(last, word)
        else:
            self._command_profile(last, word)

    def _switch_off(self, state: State) -> None:
        self.state = state
        self._homing.reset()
        self._profile = self._path = self._next_setpoint = None
        self._acknowledged = False
        if self._moved is None:
            self._commanded = self._shaft
            self._velocity, self._tick_us = 0.0, INF

    def _stop_quickly(self) -> None:
        if self.state is State.OPERATION_ENABLED:
            self.state = State.QUICK_STOP_ACTIVE
            self._next_setpoint = None
            self._decelerate(self._quick_stop)
        elif self.state is not State.QUICK_STOP_ACTIVE:
            self._switch_off(State.SWITCH_ON_DISABLED)

    def _on_communication_error(self, code: int) -> None:
        if self.state in _POWERED:
            self._switch_off(State.FAULT)
        self.state = State.FAULT
        self.emergency(code)

    # --- interpolated position mode: PVT ------------------------------------------------

    def _on_sync(self) -> None:
        self.clock.latch(self.received_us)

    def _on_timestamp(self, value: int) -> None:
        self._origin_us -= self.clock.correct(value) / self.rate

    def _on_pvt(self, value: int) -> None:
        command = self.pvt.write(value.to_bytes(8, "little"), self.received_us)
        if command == FLUSH:
            self._leave_path(self._deceleration)
        self._dirty = True

    def _command_path(self, last: int, word: int) -> None:
        ask = word & Control.ENABLE_INTERPOLATION and not word & Control.HALT
        asked = last & Control.ENABLE_INTERPOLATION and not last & Control.HALT
        if ask and not asked:
            self._begin_path()
        elif not ask:
            quick = self._halt_option.value == SLOW_DOWN_ON_QUICK_STOP_RAMP
            self._leave_path(self._quick_stop if quick else self._deceleration)

    def _begin_path(self) -> None:
        """From now on; in another state of 0x2300, or by another submode, nothing happens."""
        commanded = self._desired_state.value == CANOPEN_MODE
        if not commanded or self._submode.value != CUBIC or self.pvt.errors:
            return
        self._profile, self._path_ms = None, -1
        self.ip_start_us = self._origin_us = self._loop_us = self.received_us
        self._tick_us = self.received_us + LOOP_US / self.rate
        self._path = PvtPath(self.pvt, self._commanded)
        if self.recorder is not None:
            self.recorder.begin()
        self._follow_path()

    def _follow_path(self) -> None:
        """What the path says now; a new end of it is one of the drive."""
        path, told = self._path, self.pvt.events
        assert path is not None
        t_ms = max((self.now_us - self._origin_us) / 1000 * self.rate, 0.0)
        while self._path_ms < math.floor(t_ms + 1e-9) and not path.aborted:
            self._path_ms += 1
            position, _ = path.at(self._path_ms)
            if self.recorder is not None and not path.aborted:
                actual, level = float(self.position_actual), len(self.pvt)
                self.recorder.add(self.now_us, self._path_ms, position, actual, level)
            if path.ended:
                break
        self._dirty = self._dirty or self.pvt.events != told
        if path.aborted:
            self._leave_path(self._quick_stop)
        elif path.ended:
            self._commanded, self._path, self._dirty = path.at(t_ms)[0], None, True

    def _leave_path(self, deceleration: Entry) -> None:
        if self._path is not None:
            self._decelerate(deceleration)
            self._dirty = True

    # --- profile position mode (CiA 402) ------------------------------------------------

    def _command_profile(self, last: int, word: int) -> None:
        if (word ^ last) & Control.HALT:
            if word & Control.HALT:
                self._decelerate(self._deceleration)
            elif self._setpoint is not None:
                self._go_to(self._setpoint)
        commanded = self._desired_state.value == CANOPEN_MODE  # else it ignores set-points
        if word & ~last & Control.NEW_SETPOINT and not self._acknowledged and commanded:
            self._take_setpoint(word)
        if not word & Control.NEW_SETPOINT and self._next_setpoint is None:
            self._acknowledged = False

    def _take_setpoint(self, word: int) -> None:
        """One outside the limits is not acknowledged."""
        target = self._target.value
        if word & Control.RELATIVE:
            target += round(self._commanded) if self._setpoint is None else self._setpoint
        low, high = (limit.value for limit in self._limits)
        if not low <= target <= high:
            return
        self._acknowledged = True
        if self._profile is not None and not word & Control.CHANGE_IMMEDIATELY:
            self._next_setpoint = target
            return
        self._setpoint, self._next_setpoint = target, None
        if not word & Control.HALT:
            self._go_to(target)

    def _go_to(self, target: int) -> None:
        if not self._speed.value:
            return  # READING: with a profile velocity of 0, the EDS' default, no move begins
        position, velocity = self._demand_at(self.now_us)
        if self._profile_type.value == JERK_LIMITED:
            self._follow_profile(self._jerk_limited(position, velocity, target))
            return
        self._follow_profile(
            trapezoid(
                position,
                velocity,
                target,
                self._speed.value * VELOCITY_UNIT,
                self._acceleration.value * ACCELERATION_UNIT,
                self._deceleration.value * ACCELERATION_UNIT,
            )
        )

    def _jerk_limited(self, position: float, velocity: float, target: int) -> Profile:
        """READING: without a jerk there is no such profile, and no motion."""
        rate = self._acceleration.value * ACCELERATION_UNIT
        jerks = (max(1, self._jerk.value) * JERK_UNIT,) * 4
        limits = ramps.Limits(self._speed.value * VELOCITY_UNIT, rate, rate, jerks)
        state = ramps.State(position, velocity, 0.0)
        return _Smooth(ramps.move(state, target if self._jerk.value else position, 0.0, limits)[0])

    def _decelerate(self, deceleration: Entry) -> None:
        position, velocity = self._demand_at(self.now_us)
        self._follow_profile(stop(position, velocity, deceleration.value * ACCELERATION_UNIT))

    def _follow_profile(self, profile: Profile) -> None:
        self._profile, self._profile_us, self._path = profile, self.now_us, None
        if self._tick_us == INF:
            self._loop_us = self.now_us
            self._tick_us = self.now_us + LOOP_US / self.rate

    def _demand_at(self, t_us: float) -> tuple[float, float]:
        """Commanded position and velocity [counts, counts/ms]."""
        if self._path is not None:
            return self._path.at(max((t_us - self._origin_us) / 1000 * self.rate, 0.0))
        if self._profile is None:
            return self._commanded, 0.0
        return self._profile.at((t_us - self._profile_us) / 1000 * self.rate)

    # --- position loop ------------------------------------------------------------------

    def _tick(self) -> None:
        self._run_loop()

    def _run_loop(self) -> None:
        """What happens once in a loop, at `now_us`."""
        begin_us, self._loop_us = self._loop_us, self.now_us
        before = self._shaft
        self._step_axis()
        if self._quadrature:
            self._see(before, self._shaft, begin_us, self.now_us)
        else:  # taken back to what the encoder says, then on from there
            count = float(self.position_actual)
            self._see(self.extrapolated, count, self.now_us, self.now_us)
            end = count + self._velocity * LOOP_US / 1000
            self.extrapolated = math.nextafter(end, count)  # then comes the next sample
            next_us = self.now_us + LOOP_US / self.rate
            self._see(count, self.extrapolated, self.now_us, next_us)
        for pin in self.pins:
            if pin.word:  # else it has no function
                self._sample(pin)
        driven = self._moved is not None or self._profile is not None or self._path is not None
        resting = not driven and self._shaft == before
        self._tick_us = INF if resting else self.now_us + LOOP_US / self.rate

    def _sample(self, pin: SoftwarePin) -> None:
        count = round(self._commanded) if pin.commanded else self.position_actual
        pin.sample(count, self.now_us)

    def _step_axis(self) -> None:
        if self._moved is not None:
            self._shaft, velocity = self._moved(self.now_us)
            self._velocity = velocity / 1000
            self._commanded = self._shaft
            return
        if self._path is not None:
            self._follow_path()
        self._commanded, velocity = self._demand_at(self.now_us)
        if self._follow < 1.0:
            step = (self._commanded - self._shaft) * self._follow
            self._shaft += step
            velocity = step / LOOP_US * 1000
            still = self._profile is None and self._path is None
            if still and abs(self._commanded - self._shaft) < 1e-3:
                self._shaft = self._commanded
        else:
            self._shaft = self._commanded
        self._velocity = velocity
        self._homing.watch()
        if abs(self._commanded - self._shaft) > self._tracking_error.value:
            self._latch(FOLLOWING_ERROR_BIT, FOLLOWING_ERROR)
        profile = self._profile
        if profile is not None:
            elapsed_ms = (self.now_us - self._profile_us) / 1000 * self.rate
            if elapsed_ms >= profile.duration_ms:
                self._arrive()

    def _arrive(self) -> None:
        self._profile = None
        self.arrived_us = self.now_us
        self._dirty = True
        if self._next_setpoint is not None:
            self._setpoint, self._next_setpoint = self._next_setpoint, None
            if not self._word & Control.NEW_SETPOINT:
                self._acknowledged = False
            self._go_to(self._setpoint)

    def _see(self, start: float, end: float, begin_us: float, end_us: float) -> None:
        """The compare module sees the position go from `start` to `end`, evenly."""

        def when_us(value: int) -> float:
            share = (value - self._offset - start) / (end - start) if end != start else 1.0
            return begin_us + min(max(share, 0.0), 1.0) * (end_us - begin_us)

        count = math.floor(end + self._offset)
        self.seen = (min(self.seen[0], count), max(self.seen[1], count))
        self.module.move(count, when_us)


class _Smooth(Profile):
    """One with limits of jerk."""

    def __init__(self, ramp: ramps.Profile) -> None:
        super().__init__(0.0, 0.0)
        self._ramp = ramp
        self.duration_ms = ramp.duration

    def at(self, t_ms: float) -> tuple[float, float]:
        state = self._ramp.at(t_ms)
        return state.position, state.velocity


class _WithTraceData(ObjectDictionary):
    """The dictionary with 0x250C, which takes one 32-bit position in a write, or many."""

    def __init__(self, dictionary: ObjectDictionary, trace: TraceMemory) -> None:
        super().__init__()
        self._dictionary = dictionary
        self._trace = trace
        self._data = dictionary.variable(0x250C, Entry("Trace data", UNSIGNED32, "wo"))

    def upload(self, index: int, subindex: int) -> bytes:
        return self._dictionary.upload(index, subindex)

    def check_download(self, index: int, subindex: int, size: int | None) -> Entry:
        if (index, subindex) == (0x250C, 0):
            return self._data
        return self._dictionary.check_download(index, subindex, size)

    def download(self, index: int, subindex: int, data: bytes) -> None:
        if (index, subindex) != (0x250C, 0):
            self._dictionary.download(index, subindex, data)
        elif not self._trace.fits(data):
            raise SdoAbort(AbortCode.LENGTH_MISMATCH)
        else:
            self._trace.write(data)
