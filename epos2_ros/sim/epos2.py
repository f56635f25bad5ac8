"""A simulated maxon EPOS2 positioning controller with its motor.

A CiA 402 drive with interpolated position mode and a motion clock that SYNC latches.
Source: maxon, application note "Interpolation Position Mode" (in the text: "the note").
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
  warnings last as long as the segment, errors until the buffer is cleared or ip mode starts.
- Bit 4 has to rise while "operation enabled" with mode 7 is on.
- Ip mode that ends in motion (bit 4, halt, the mode, an end record too early) leaves the
  axis to the profile deceleration.
- TIME and time stamps move the clock of the path, also in motion.

Its object dictionary is the maker's (`epos2_objects`), or the note's where that is asked for.
"""

from __future__ import annotations

import math
from enum import Enum
from functools import partial

from . import epos2_objects
from .cia402 import SOFTWARE_POSITION_LIMIT, Control, Delays, Mode, State, Status
from .clock import MotionClock
from .dictionary import (
    INTEGER8,
    INTEGER16,
    LOAD,
    SAVE,
    UNSIGNED8,
    UNSIGNED16,
    UNSIGNED32,
    UNSIGNED64,
    AbortCode,
    Entry,
    SdoAbort,
    check_signature,
)
from .epos2_compare import PositionOutputs
from .homing import Switches
from .interpolation import BUFFER_SIZE, BufferStatus, Fifo, Point, Segment
from .motor import Motor
from .recorder import Recorder
from .slave import Identity

MAXON = 0x0000_00FB
IPM_ERROR = 0xFF0C
_AVERAGING = 1 - math.exp(-2 * math.pi * 50 / 1000)
"""READING: no document says over how long 0x2027 is averaged; 50 Hz, as maxon's later drives do."""
_TOLERANCE = 1 + 1e-9  # for limits that are met exactly


class Dictionary(Enum):
    """Whose object dictionary a drive has."""

    MAKER = "maker"
    NOTE = "note"


class FirstRecord(Enum):
    """What the first record of a path is; no document says it."""

    SEGMENT = "segment"  # the end of a segment that begins where the axis stands
    START = "start"  # the point at which the path begins; its time doesn't count


REAL = Delays(refresh=25.0, measure=130.0, fault_reset=25.0, boot=262.0)
"""Of drives that have been watched: a reset takes 262 ms to the boot-up message, enabling well over
125 ms, a fault reset 25 ms; how enabling divides is a guess."""


class Epos2(PositionOutputs):
    """One drive.

    node_id:            1 … 127
    counts_per_turn:    quadrature counts of the encoder per motor turn [qc]
    position_qc:        where the axis stands at power-on
    drift_ppm, offset_us: of its motion clock against true time
    bitrate:            of the bus; the motion clock counts its bit times
    lag_ms:             time constant with which the axis follows the demand; 0: without lag.
                        No document gives one; the default has a tuned regulator with
                        velocity feed-forward in mind, which is late by a tenth of a cycle
    noise_qc:           standard deviation of the measured position while it moves
    switches:           of the machine, for homing
    record:             keep what is executed in `recorder`
    dictionary:         its objects: the maker's, or the note's, where 0x1013 and 0x60C4-02 can be
                        mapped into a TPDO
    first_record:       what it takes the first record of a path for
    delays:             how long boot-up, enabling and the reset of a fault take
    frames_needed:      of others, before it has detected the bus's bit rate; 0: it is set
    """

    MODES = (*PositionOutputs.MODES, Mode.INTERPOLATED_POSITION)

    def __init__(
        self,
        node_id: int,
        *,
        counts_per_turn: int = 2000,
        position_qc: int = 0,
        drift_ppm: float = 0.0,
        offset_us: float = 0.0,
        bitrate: int = 1_000_000,
        lag_ms: float = 0.4,
        noise_qc: float = 0.0,
        switches: Switches | None = None,
        seed: int = 0,
        record: bool = False,
        vendor_id: int = MAXON,
        product_code: int = 0x6420_0000,
        revision: int = 0x2126_0000,
        serial: int = 1,
        t_us: float = 0.0,
        dictionary: Dictionary = Dictionary.MAKER,
        first_record: FirstRecord = FirstRecord.SEGMENT,
        delays: Delays = REAL,
        frames_needed: int = 0,
    ) -> None:
        self._dictionary = dictionary
        self._first_record = first_record
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
        self.clock = MotionClock(offset_us, drift_ppm, 1e6 / bitrate)
        self.recorder = Recorder() if record else None
        self.ip_start_us = math.nan  # true time of the last path's zero
        self._current_ma = 0.0  # averaged
        self.refused_records = 0  # PVT records that came when none was accepted
        self._fifo = Fifo()
        self._segment: Segment | None = None
        super().__init__(
            node_id,
            identity,
            counts_per_turn=counts_per_turn,
            motor=Motor(float(position_qc), lag_ms, noise_qc, seed),
            switches=switches or Switches(),
            rate=self.clock.rate,
            t_us=t_us,
            delays=delays,
            frames_needed=frames_needed,
        )

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

    @property
    def current_averaged(self) -> int:
        """0x2027 [mA]; of an axis at rest, whose cycles are not counted, there is none."""
        return 0 if self._tick_us == math.inf else round(self._current_ma)

    def _control(self) -> None:
        super()._control()
        self._current_ma += _AVERAGING * (self.current_actual - self._current_ma)

    # --- object dictionary --------------------------------------------------------------

    def _build_objects(self) -> None:
        super()._build_objects()
        od = self.dictionary
        mapped = partial(Entry, mappable=True)
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
        od.variable(
            0x2027,
            mapped(
                "Current actual value averaged", INTEGER16, "ro", read=lambda: self.current_averaged
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
        if self._dictionary is Dictionary.MAKER:
            self._take_makers_objects()

    def _take_makers_objects(self) -> None:
        """No other objects than the maker's; what nothing here reads just keeps its value."""
        od, node = self.dictionary, self.node_id
        pdos = [key for key, _ in od.items() if 0x1400 <= key[0] <= 0x1BFF]
        od.keep({*pdos, *((row.index, row.subindex) for row in epos2_objects.rows())})
        for row in epos2_objects.rows():
            key = row.index, row.subindex
            entry = od[key] if key in od else od.variable(row.index, Entry("", row.type), key[1])
            entry.name, entry.access, entry.mappable = row.name, row.access, row.mappable
            if row.low is not None:
                entry.low, entry.high = row.low, row.high
            if (default := row.default_of(node)) is not None:
                entry.preset(default)
        for index, subindex, value in (
            (0x2000, 0, node),
            (0x2003, 1, od[0x1018, 3].value >> 16),
            (0x2003, 2, od[0x1018, 2].value >> 16),
            (0x2004, 0, od[0x1018, 4].value),
        ):
            od[index, subindex].preset(value)
        self._selected_mode.preset(Mode.PROFILE_POSITION)
        for storage, signature, act in ((0x1010, SAVE, self._save), (0x1011, LOAD, self._load)):
            entry = od[storage, 1]
            entry.read, entry.check = lambda: 1, partial(check_signature, signature)
            entry.write = act
        for rpdo, factory in zip(self.rpdos, epos2_objects.RPDOS, strict=True):
            rpdo.types = epos2_objects.RPDO_TYPES
            rpdo.preset(factory.cob_id + node, factory.mapping)
        for tpdo, factory in zip(self.tpdos, epos2_objects.TPDOS, strict=True):
            tpdo.types = epos2_objects.TPDO_TYPES
            tpdo.inhibit.preset(epos2_objects.INHIBIT_100US)
            tpdo.preset(factory.cob_id + node, factory.mapping)
        self._reconfigure()

    def _save(self, signature: int) -> None:
        """All parameters as they are now are there after power-on."""
        for _, entry in self.dictionary.items():
            if entry.access in ("rw", "rww"):
                entry.keep()

    def _load(self, signature: int) -> None:
        """After the next reset all parameters are as they left the factory."""
        for _, entry in self.dictionary.items():
            entry.stored = entry.default

    def _reset_application(self) -> None:
        self._ip_active = False
        self._check_position = False
        self._clear_buffer()
        super()._reset_application()

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

    def _enter_mode(self) -> None:
        super()._enter_mode()
        if self.mode == Mode.INTERPOLATED_POSITION:  # transition I (the note, table 3)
            self._clear_buffer()

    def _mode_bits(self) -> int:
        return Status.IP_MODE_ACTIVE if self._ip_active else super()._mode_bits()

    @property
    def _moving(self) -> bool:
        return self._ip_active or super()._moving

    def _command_mode(self, last: int, word: int) -> None:
        if self.mode != Mode.INTERPOLATED_POSITION:
            super()._command_mode(last, word)
            return
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
        if self._first_record is FirstRecord.START and len(self._fifo):
            start = self._fifo.pop()
            self._demand = start.position
            self._demand_velocity = start.velocity * self._velocity_unit
        self._next_segment()
        if self.recorder is not None:
            self.recorder.begin()
            self._record(self.recorder)

    def _leave_path(self) -> None:
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

    # --- control cycle ------------------------------------------------------------------

    def _tick(self) -> None:
        segment = self._segment
        if segment is None:
            super()._tick()
            return
        cycle = self._next_cycle()
        u = cycle - segment.end_ms
        demand = ((segment.a * u + segment.b) * u + segment.c) * u + segment.d
        if self._check_position and not self._allowed(demand):
            self._fault(SOFTWARE_POSITION_LIMIT)
        else:
            self._demand = demand
        self._control()
        if u == 0 and self._segment is segment:
            self._next_segment()
        if self.recorder is not None:
            self._record(self.recorder)

    def _record(self, recorder: Recorder) -> None:
        recorder.add(
            self.now_us, self._cycle, self._demand, self._motor.measured, len(self._fifo)
        )
