"""Position compare and position marker of the EPOS2.

Neither is in the application note "Interpolation Position Mode"; objects and bits are from public
descriptions of the EPOS2's firmware. 0x207A-01: bit 0 enable; bits 1–2 mode (0 single, 1
sequence); bits 3–4 interval direction; bits 5–6 direction dependency (0 negative, 1 positive, 2
both). A digital output is given to the position compare by 1 in its entry of 0x2079. The drive
reports nothing when it fires: events are computed from the executed path.

The position marker captures the position at an edge of a digital input that has been given to it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum

from epos2_ros.configuration.outputs import CompareConfig
from epos2_ros.motion.compare import Trigger
from epos2_ros.motion.crossings import Counts, Grid, Points
from epos2_ros.motion.units import AxisUnits
from epos2_ros.protocol.outputs.events import ComputedTracker, MarkerTracker, Tracker
from epos2_ros.protocol.outputs.output import CountScale
from epos2_ros.protocol.sdo import SdoRead, SdoWrite

POSITION_MARKER = 0x2074
MARKER_CAPTURED, MARKER_EDGE, MARKER_MODE, MARKER_COUNTER = 1, 2, 3, 4
MARKER_HISTORY = (5, 6)
DIGITAL_OUTPUT_CONFIGURATION = 0x2079  # sub-index n: output n
OUTPUT_POSITION_COMPARE = 1
POSITION_COMPARE = 0x207A
COMPARE_CONFIGURATION, COMPARE_REFERENCE, COMPARE_WIDTH = 1, 2, 3
COMPARE_REPETITIONS, COMPARE_PULSE = 4, 5

NUMBER_OF_OUTPUTS = 5
MAX_PULSE_US = (1 << 16) - 1
MAX_REPETITIONS = (1 << 16) - 1
MARKER_CONTINUOUS = 0


class Direction(IntEnum):
    """Bits 3–4 and 5–6 of 0x207A-01."""

    NEGATIVE = 0
    POSITIVE = 1
    BOTH = 2

    @classmethod
    def of(cls, rising: bool, falling: bool) -> Direction:
        return cls.BOTH if rising and falling else cls.POSITIVE if rising else cls.NEGATIVE


class Edge(IntEnum):
    """0x2074-02: edges of the input that capture the position."""

    BOTH = 0
    RISING = 1
    FALLING = 2


@dataclass(frozen=True)
class PositionCompare:
    """The settings of 0x207A. In a sequence `repetitions` counts its positions."""

    reference: int
    dependency: Direction = Direction.BOTH
    sequence: bool = False
    interval_direction: Direction = Direction.NEGATIVE
    width: int = 0
    repetitions: int = 0
    pulse_us: int = 0

    @property
    def configuration(self) -> int:
        """0x207A-01 with the compare enabled."""
        return 1 | self.sequence << 1 | self.interval_direction << 3 | self.dependency << 5

    @property
    def counts(self) -> Counts:
        """Where it fires."""
        if not self.sequence:
            return Points((self.reference,))
        last = self.repetitions - 1
        low = 0 if self.interval_direction is Direction.POSITIVE else -last
        high = 0 if self.interval_direction is Direction.NEGATIVE else last
        return Grid(self.reference, self.width, low, high)

    def writes(self) -> list[SdoWrite]:
        """Off, values, on."""
        return [
            _integer(POSITION_COMPARE, COMPARE_CONFIGURATION, 0, 2),
            _integer(POSITION_COMPARE, COMPARE_REFERENCE, self.reference, 4, signed=True),
            _integer(POSITION_COMPARE, COMPARE_WIDTH, self.width, 4, signed=True),
            _integer(POSITION_COMPARE, COMPARE_REPETITIONS, self.repetitions, 2),
            _integer(POSITION_COMPARE, COMPARE_PULSE, self.pulse_us, 2),
            _integer(POSITION_COMPARE, COMPARE_CONFIGURATION, self.configuration, 2),
        ]


_integer = SdoWrite.integer


@dataclass(frozen=True)
class CompareOutput:
    """A digital output on the drive's position compare."""

    config: CompareConfig
    units: AxisUnits
    trigger: Trigger = field(init=False)
    _settings: PositionCompare = field(init=False)

    def __post_init__(self) -> None:
        settings = _position_compare(self.config, CountScale(self.config, self.units))
        rising = settings.dependency is not Direction.NEGATIVE
        falling = settings.dependency is not Direction.POSITIVE
        object.__setattr__(self, "_settings", settings)
        object.__setattr__(
            self,
            "trigger",
            Trigger(settings.counts, rising, falling, pulse_us=float(settings.pulse_us)),
        )

    def arm(self, position_qc: int) -> list[SdoWrite]:
        return [
            *self._settings.writes(),
            _integer(DIGITAL_OUTPUT_CONFIGURATION, self.config.pin, OUTPUT_POSITION_COMPARE, 2),
        ]

    def disarm(self) -> list[SdoWrite]:
        return [_integer(POSITION_COMPARE, COMPARE_CONFIGURATION, 0, 2)]

    def tracker(self, position_qc: int) -> Tracker:
        return ComputedTracker(self.trigger)


@dataclass(frozen=True)
class MarkerOutput:
    """Not an output but an input, which captures the position; configured and told alike."""

    config: CompareConfig
    units: AxisUnits
    trigger: None = None

    def arm(self, position_qc: int) -> list[SdoWrite]:
        edge = {"up": Edge.RISING, "down": Edge.FALLING, "both": Edge.BOTH}[self.config.direction]
        return [
            _integer(POSITION_MARKER, MARKER_EDGE, edge, 1),
            _integer(POSITION_MARKER, MARKER_MODE, MARKER_CONTINUOUS, 1),
            _integer(POSITION_MARKER, MARKER_COUNTER, 0, 2),
        ]

    def disarm(self) -> list[SdoWrite]:
        return []

    def tracker(self, position_qc: int) -> Tracker:
        """Counter first: what is captured while the rest is read is told the next time."""
        captured = (MARKER_CAPTURED, *MARKER_HISTORY)
        return MarkerTracker(
            (
                SdoRead(POSITION_MARKER, MARKER_COUNTER, 2),
                *(SdoRead(POSITION_MARKER, sub, 4, signed=True) for sub in captured),
            )
        )


def _position_compare(config: CompareConfig, scale: CountScale) -> PositionCompare:
    """What the position compare is set to."""
    for parameter, allowed, wrong in (
        ("method", "the EPOS2 compares in hardware only", config.method == "software"),
        ("reference", "the EPOS2 compares the actual position", config.reference != "actual"),
        ("toggle", "the EPOS2's position compare pulses", config.toggle),
        ("inverted", "the EPOS2's polarity is that of the digital output", config.inverted),
        ("pin", f"the EPOS2 has outputs 1 to {NUMBER_OF_OUTPUTS}", config.pin > NUMBER_OF_OUTPUTS),
        (
            "kind",
            "the EPOS2 has crossing, interval and marker",
            config.kind not in ("crossing", "interval"),
        ),
        (
            "positions",
            "the EPOS2 compares with one position, or with an interval of them",
            len(config.positions) > 1,
        ),
    ):
        if wrong:
            raise config.refuse(parameter, allowed)
    pulse_us = round(config.pulse * 1e6)
    if not 1 <= pulse_us <= MAX_PULSE_US:
        raise config.refuse("pulse", f"the EPOS2's pulses last 1e-06 to {MAX_PULSE_US / 1e6:g} s")
    rising, falling = scale.directions
    dependency = Direction.of(rising, falling)
    if config.kind == "crossing":
        reference = scale.count("positions", config.positions[0])
        return PositionCompare(reference, dependency, pulse_us=pulse_us)
    assert config.start is not None
    settings = PositionCompare(
        scale.count("start", config.start),
        dependency,
        sequence=True,
        interval_direction=dependency,
        width=scale.step(),
        repetitions=MAX_REPETITIONS,
        pulse_us=pulse_us,
    )
    if config.end is None:
        return settings
    distance = scale.count("end", config.end) - settings.reference
    number = abs(distance) // settings.width + 1
    if number > MAX_REPETITIONS:
        raise config.refuse(
            "end", f"the EPOS2 compares with up to {MAX_REPETITIONS} positions, here {number}"
        )
    direction = Direction.POSITIVE if distance > 0 else Direction.NEGATIVE
    return replace(settings, interval_direction=direction, repetitions=number)


def make_outputs(
    configs: Sequence[CompareConfig], units: AxisUnits
) -> list[CompareOutput | MarkerOutput]:
    """The outputs of one drive; ConfigurationError for what it can't do."""
    outputs: list[CompareOutput | MarkerOutput] = []
    taken: dict[bool, str] = {}
    for config in configs:
        marker = config.kind == "marker"
        what = "position marker" if marker else "position compare"
        if marker in taken:
            raise config.refuse(
                "kind", f"the one {what} of {config.joint} serves compare.{taken[marker]}"
            )
        taken[marker] = config.name
        outputs.append((MarkerOutput if marker else CompareOutput)(config, units))
    return outputs
