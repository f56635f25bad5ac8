"""Position-triggered outputs of Copley drives.

Source: Copley, "Setting outputs at position" (in the text: "the note"). The ten bytes of an
output's configuration 0x2193-n are little-endian throughout: a configuration word, then two 32-bit
values. Trace memory is addressed in 16-bit words; 0x250A and 0x250B are 16 bits. The manufacturer
objects of a second axis lie 0x800 higher; the outputs are the drive's, and say in bits 12 and 13
which axis they follow.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum

from epos2_ros.configuration.outputs import CompareConfig
from epos2_ros.motion.compare import Trigger
from epos2_ros.motion.crossings import Grid, Points
from epos2_ros.motion.units import INT32_MAX, INT32_MIN, AxisUnits
from epos2_ros.protocol.outputs.events import (
    ComputedTracker,
    DualTracker,
    FlagTracker,
    SingleTracker,
    Tracker,
    WindowTracker,
)
from epos2_ros.protocol.outputs.output import CountScale, Output
from epos2_ros.protocol.sdo import SdoRead, SdoWrite

OUTPUT_CONFIGURATION = 0x2193  # sub-index n: output n
COMPARE_CONFIGURATION = 0x2160
COMPARE_STATUS = 0x2161
COMPARE_VALUE_0 = 0x2162
COMPARE_VALUE_1 = 0x2163
COMPARE_INCREMENT = 0x2164
COMPARE_PULSE_PERIOD = 0x2165
TRACE_RESERVED = 0x250A
TRACE_OFFSET = 0x250B
TRACE_DATA = 0x250C
SECOND_AXIS = 0x800  # how much higher its manufacturer objects lie

PULSE_UNIT_S = 10e-9
MAX_PULSE = (1 << 20) - 1  # [10 ns], 20 bits
MAX_SOFTWARE_PULSE_MS = (1 << 32) - 1
MAX_SERIES_PULSE_MS = (1 << 16) - 1
WORDS_PER_POSITION = 2
MAX_TRACE_WORDS = (1 << 16) - 1  # what 0x250A can reserve

_OUTPUT = struct.Struct("<HII")
_MASK = 0xFFFF_FFFF


class Function(IntEnum):
    """What an output does (bits 0–7 of its configuration word)."""

    WINDOW = 4
    CROSSING_UP = 5
    CROSSING_DOWN = 6
    CROSSING = 7
    SERIES = 9
    COMPARE_MODULE = 16


class Mode(IntEnum):
    """Of the compare module (bits 3–4 of 0x2160)."""

    DUAL = 0
    SINGLE = 1
    WINDOW = 2
    SINGLE_WITH_END = 3


@dataclass(frozen=True)
class OutputPin:
    """The configuration of one output, 0x2193-n."""

    function: Function
    first: int = 0  # int32 or uint32
    second: int = 0
    inverted: bool = False
    axis: int = 0
    commanded: bool = False

    @property
    def configuration(self) -> int:
        """The 16-bit configuration word."""
        return self.function | self.inverted << 8 | self.axis << 12 | self.commanded << 14

    def write(self, pin: int) -> SdoWrite:
        """Output `pin`, counted from 1."""
        data = _OUTPUT.pack(self.configuration, self.first & _MASK, self.second & _MASK)
        return SdoWrite(OUTPUT_CONFIGURATION, pin, data)

    @classmethod
    def inactive(cls, inverted: bool = False) -> OutputPin:
        """A window that holds no position."""
        return cls(Function.WINDOW, INT32_MAX, INT32_MIN, inverted)

    @classmethod
    def series(
        cls,
        number: int,
        offset: int,
        pulse_ms: int,
        *,
        inverted: bool = False,
        axis: int = 0,
        commanded: bool = False,
    ) -> OutputPin:
        """Function 9: `number` positions from word `offset` of the reserved trace memory on."""
        first = offset << 16 | number
        return cls(Function.SERIES, first, pulse_ms, inverted, axis, commanded)


@dataclass(frozen=True)
class CompareModule:
    """The settings of the compare hardware, 0x2160 … 0x2165."""

    mode: Mode
    value_0: int
    value_1: int = 0
    increment: int = 0
    pulse: int = 0  # [10 ns]
    toggle: bool = False
    inverted: bool = False

    @property
    def configuration(self) -> int:
        """0x2160 with the module enabled."""
        return 1 | self.inverted << 1 | self.toggle << 2 | self.mode << 3

    def writes(self, axis: int = 0) -> list[SdoWrite]:
        """Off, values, flags cleared, on: never on with only half of the values."""
        values = (
            (COMPARE_CONFIGURATION, 0),
            (COMPARE_VALUE_0, self.value_0),
            (COMPARE_VALUE_1, self.value_1),
            (COMPARE_INCREMENT, self.increment),
            (COMPARE_PULSE_PERIOD, self.pulse),
            (COMPARE_STATUS, 0b110),  # write 1 to clear
            (COMPARE_CONFIGURATION, self.configuration),
        )
        base = SECOND_AXIS * axis
        return [SdoWrite.integer(base + index, 0, value & _MASK, 4) for index, value in values]


def reserve(words: int) -> SdoWrite:
    """Reserve trace memory [16-bit words]; it holds two for each position."""
    return SdoWrite.integer(TRACE_RESERVED, 0, words, 2)


def load_positions(positions: Sequence[int], offset: int, at_once: bool = True) -> list[SdoWrite]:
    """Write positions to the reserved memory, from word `offset` on: in one write, or one each."""
    data = [position.to_bytes(4, "little", signed=True) for position in positions]
    parts = [b"".join(data)] if at_once else data
    return [
        SdoWrite.integer(TRACE_OFFSET, 0, offset, 2),
        *(SdoWrite(TRACE_DATA, 0, part) for part in parts),
    ]


def compare_reads(axis: int = 0) -> tuple[SdoRead, ...]:
    """Status first: a match that comes between the reads stays flagged for the next time."""
    base = SECOND_AXIS * axis
    return (
        SdoRead(base + COMPARE_STATUS, 0, 4),
        SdoRead(base + COMPARE_VALUE_0, 0, 4, signed=True),
        SdoRead(base + COMPARE_VALUE_1, 0, 4, signed=True),
    )


@dataclass(frozen=True)
class HardwareOutput:
    """An output that follows the axis' compare module."""

    config: CompareConfig
    units: AxisUnits
    trigger: Trigger = field(init=False)
    _module: CompareModule = field(init=False)

    def __post_init__(self) -> None:
        module, trigger = _compare_module(self.config, CountScale(self.config, self.units))
        object.__setattr__(self, "_module", module)
        object.__setattr__(self, "trigger", trigger)

    def arm(self, position_qc: int) -> list[SdoWrite]:
        """Values first, then the pin; in dual mode they flank `position_qc`."""
        return [
            *self._at(position_qc).writes(),
            OutputPin(Function.COMPARE_MODULE).write(self.config.pin),
        ]

    def disarm(self) -> list[SdoWrite]:
        return [
            SdoWrite.integer(COMPARE_CONFIGURATION, 0, 0, 4),
            OutputPin.inactive(self.config.inverted).write(self.config.pin),
        ]

    def tracker(self, position_qc: int) -> Tracker:
        module, reads = self._at(position_qc), compare_reads()
        if module.mode in (Mode.SINGLE, Mode.SINGLE_WITH_END):
            return SingleTracker(reads, module.value_0, module.increment)
        if module.mode is Mode.DUAL and module.increment:
            assert isinstance(self.trigger.counts, Grid)
            return DualTracker(reads, self.trigger.counts, position_qc)
        assert isinstance(self.trigger.counts, Points)
        if module.mode is Mode.WINDOW:
            return WindowTracker(reads, self.trigger.counts, position_qc)
        return FlagTracker(reads, self.trigger.counts, (module.value_0, module.value_1))

    def _at(self, position_qc: int) -> CompareModule:
        grid = self.trigger.counts
        if self._module.mode is not Mode.DUAL or not isinstance(grid, Grid):
            return self._module
        below = int(grid.count(grid.cell(position_qc) - 1))  # the count that was crossed last
        return replace(self._module, value_0=below, value_1=below + grid.step)


def _compare_module(config: CompareConfig, scale: CountScale) -> tuple[CompareModule, Trigger]:
    """What the hardware is set to, and what it then does. In dual mode the values are open."""
    if config.reference == "commanded":
        raise config.refuse(
            "reference", "the compare hardware sees the encoder; method software can follow it"
        )
    pulse = round(config.pulse / PULSE_UNIT_S)
    if not 1 <= pulse <= MAX_PULSE:
        raise config.refuse(
            "pulse",
            f"the compare hardware makes pulses of 1e-08 to {MAX_PULSE * PULSE_UNIT_S:.8g} s "
            "(20 bits of 10 ns); method software goes to hours, in whole milliseconds",
        )
    module = CompareModule(
        Mode.DUAL, 0, pulse=pulse, toggle=config.toggle, inverted=config.inverted
    )
    pulse_us = None if config.toggle else config.pulse * 1e6
    rising, falling = scale.directions
    trigger = Trigger(
        Points(()), rising, falling, pulse_us=pulse_us, extrapolated=config.extrapolated
    )
    if config.kind == "window":
        low, high = scale.window()
        trigger = replace(trigger, counts=Points((low + 1, high + 1)), pulse_us=None)
        return replace(module, mode=Mode.WINDOW, value_0=low, value_1=high), trigger
    if config.kind == "crossing":
        if config.direction != "both":
            raise config.refuse(
                "direction", "the compare hardware pulses both ways there; method software can"
            )
        counts = scale.counts(config.positions)
        trigger = replace(trigger, counts=Points(counts))
        return replace(module, value_0=counts[0], value_1=counts[-1]), trigger
    if config.kind == "interval":
        assert config.start is not None
        start, step = scale.count("start", config.start), scale.step()
        trigger = replace(trigger, counts=Grid(start, step))
        if config.end is None and config.direction == "both":
            return replace(module, increment=2 * step), trigger
        end = None if config.end is None else scale.count("end", config.end)
        if end is not None:
            if end == start:
                raise config.refuse("end", "it must be a count or more from start")
            rising = end > start
        trigger = replace(trigger, sequence=True, rising=rising, falling=not rising, end=end)
        return replace(
            module,
            mode=Mode.SINGLE if end is None else Mode.SINGLE_WITH_END,
            value_0=start,
            value_1=0 if end is None else end,
            increment=step if rising else -step,
        ), trigger
    raise config.refuse("kind", "the compare hardware does window, crossing and interval")


@dataclass(frozen=True)
class SoftwareOutput:
    """An output that the drive's firmware sets, once a loop. `offset`: of its trace memory."""

    config: CompareConfig
    units: AxisUnits
    offset: int = 0  # [16-bit words]
    trigger: Trigger = field(init=False)
    _pin: OutputPin = field(init=False)

    def __post_init__(self) -> None:
        pin, trigger = _output_pin(self.config, CountScale(self.config, self.units), self.offset)
        object.__setattr__(self, "_pin", pin)
        object.__setattr__(self, "trigger", trigger)

    @property
    def words(self) -> int:
        """Trace memory it needs [16-bit words]."""
        if self._pin.function is not Function.SERIES:
            return 0
        return WORDS_PER_POSITION * max(self.config.capacity, len(self.config.positions))

    def arm(self, position_qc: int) -> list[SdoWrite]:
        """The trace memory has been reserved for all outputs of the drive before."""
        return [*self._load(), self._pin.write(self.config.pin)]

    def disarm(self) -> list[SdoWrite]:
        return [OutputPin.inactive(self.config.inverted).write(self.config.pin)]

    def with_positions(self, positions: Sequence[float]) -> SoftwareOutput:
        """A series with other positions [unit]; ConfigurationError if they can't be."""
        if self.config.kind != "series":
            raise self.config.refuse("kind", "only a series takes new positions while in use")
        room = self.words // WORDS_PER_POSITION
        if len(positions) > room:
            raise self.config.refuse(
                "positions",
                f"memory is reserved for {room}; set compare.{self.config.name}.capacity to more",
                f"a list of {len(positions)}",
            )
        config = replace(self.config, positions=tuple(positions), capacity=room)
        return SoftwareOutput(config, self.units, self.offset)

    def update(self, before: SoftwareOutput) -> list[SdoWrite]:
        """What takes the place of `before` while the axis moves.

        No more positions are counted than have been written, at any time.
        """
        if self._pin == before._pin:
            return self._load()
        if len(self.config.positions) < len(before.config.positions):
            return [self._pin.write(self.config.pin), *self._load()]
        return [*self._load(), self._pin.write(self.config.pin)]

    def tracker(self, position_qc: int) -> Tracker:
        return ComputedTracker(self.trigger)

    def _load(self) -> list[SdoWrite]:
        if self._pin.function is not Function.SERIES:
            return []
        assert isinstance(self.trigger.counts, Points)
        return load_positions(self.trigger.counts.counts, self.offset)


def _output_pin(config: CompareConfig, scale: CountScale, offset: int) -> tuple[OutputPin, Trigger]:
    """What the output is set to, and what it then does."""
    if config.toggle:
        raise config.refuse("toggle", "software outputs pulse; method hardware can toggle")
    if config.kind == "interval" and config.method is None:
        raise config.refuse("reference", "an interval is compared with the actual position only")
    if config.kind not in ("window", "crossing", "series"):
        raise config.refuse("kind", "software outputs do window, crossing and series")
    rising, falling = scale.directions
    pin = OutputPin(
        Function.WINDOW, inverted=config.inverted, commanded=config.reference == "commanded"
    )
    if config.kind == "window":
        low, high = scale.window()
        trigger = Trigger(Points((low, high + 1)), sampled=True)
        return replace(pin, first=low, second=high), trigger
    counts = scale.counts(config.positions)
    trigger = Trigger(Points(counts), rising, falling, pulse_us=config.pulse * 1e6, sampled=True)
    if config.kind == "crossing" and len(counts) == 1:
        function = {
            (True, False): Function.CROSSING_UP,
            (False, True): Function.CROSSING_DOWN,
            (True, True): Function.CROSSING,
        }[rising, falling]
        pulse = _milliseconds(config, MAX_SOFTWARE_PULSE_MS)
        return replace(pin, function=function, first=counts[0], second=pulse), trigger
    if config.direction != "both":
        raise config.refuse("direction", f"software pulses both ways at {len(counts)} positions")
    pulse = _milliseconds(config, MAX_SERIES_PULSE_MS)
    return OutputPin.series(
        len(counts), offset, pulse, inverted=pin.inverted, commanded=pin.commanded
    ), trigger


def _milliseconds(config: CompareConfig, longest: int) -> int:
    pulse = round(config.pulse * 1e3)
    if not (1 <= pulse <= longest and abs(pulse - config.pulse * 1e3) < 1e-6):
        raise config.refuse(
            "pulse", f"software pulses last whole milliseconds, 0.001 to {longest / 1000:.10g} s"
        )
    return pulse


def make_outputs(
    configs: Sequence[CompareConfig], units: AxisUnits
) -> list[HardwareOutput | SoftwareOutput]:
    """The outputs of one drive; ConfigurationError for what it can't do.

    Software outputs share the trace memory: `trace_words` of the list is what to reserve.
    """
    outputs: list[HardwareOutput | SoftwareOutput] = []
    module: CompareConfig | None = None
    offset = 0
    for config in configs:
        if config.kind == "marker":
            raise config.refuse("kind", "a Copley drive has window, crossing, series and interval")
        if _in_hardware(config):
            if module is not None:
                raise config.refuse(
                    "method",
                    f"the one compare module of {config.joint} serves compare.{module.name}; "
                    "method software needs none",
                    "hardware",
                )
            module = config
            outputs.append(HardwareOutput(config, units))
            continue
        output = SoftwareOutput(config, units, offset)
        offset += output.words
        if offset > MAX_TRACE_WORDS:
            room = (MAX_TRACE_WORDS - (offset - output.words)) // WORDS_PER_POSITION
            raise config.refuse(
                "positions" if len(config.positions) >= config.capacity else "capacity",
                f"the drive's trace memory has room for {room} positions here",
            )
        outputs.append(output)
    return outputs


def trace_words(outputs: Sequence[Output]) -> int:
    """Trace memory that the outputs of one drive need [16-bit words]."""
    return sum(output.words for output in outputs if isinstance(output, SoftwareOutput))


def _in_hardware(config: CompareConfig) -> bool:
    """Hardware where the drive has it: a series, one direction, `commanded` it has not."""
    if config.method is not None:
        return config.method == "hardware"
    return (
        config.reference == "actual"
        and config.kind != "series"
        and (config.kind != "crossing" or config.direction == "both")
    )
