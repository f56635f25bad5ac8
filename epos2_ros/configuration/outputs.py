"""What the driver is told of its position-triggered outputs, in joint units.

The names are those of the ROS parameters (`compare.<output>.joint` is `CompareConfig.joint`);
`None` and an empty tuple mean "not set". What is wrong whatever drive it is meant for is refused
here, what a certain drive can't do where that drive's settings are made.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from typing import Any

from epos2_ros.errors import ConfigurationError

KINDS = ("window", "crossing", "series", "interval", "marker")
METHODS = ("hardware", "software")
DIRECTIONS = ("up", "down", "both")
REFERENCES = ("actual", "commanded")


@dataclass(frozen=True)
class CompareConfig:
    """`compare.<output>.*`; ConfigurationError for what no drive could do."""

    name: str
    joint: str
    kind: str  # window, crossing, series, interval or marker
    pin: int = 1  # output number on the joint's drive
    method: str | None = None  # hardware or software; None: hardware where the drive has it
    window: tuple[float, float] | None = None  # (lower, upper) [unit]
    positions: tuple[float, ...] = ()  # of crossing and series [unit]
    start: float | None = None  # of interval [unit]
    interval: float | None = None  # [unit], positive
    end: float | None = None  # [unit]
    direction: str = "both"
    pulse: float = 0.001  # [s]
    toggle: bool = False
    inverted: bool = False
    reference: str = "actual"
    capacity: int = 0  # positions a series may grow to while in use; 0: as many as it starts with
    extrapolated: bool = False  # the drive samples the encoder and extrapolates in between

    def __post_init__(self) -> None:
        if not self.joint:
            raise self.refuse("joint", "it must name the joint whose position triggers the output")
        for parameter, allowed in (
            ("kind", KINDS),
            ("method", (None, *METHODS)),
            ("direction", DIRECTIONS),
            ("reference", REFERENCES),
        ):
            if getattr(self, parameter) not in allowed:
                words = ", ".join(filter(None, allowed))
                raise self.refuse(parameter, f"it must be one of {words}")
        if self.pin < 1:
            raise self.refuse("pin", "outputs are counted from 1")
        if not (isfinite(self.pulse) and self.pulse > 0):
            raise self.refuse("pulse", "it must be above 0 s")
        self._check_finite()
        if self.kind == "window":
            self._check_window()
        elif self.kind == "interval":
            self._check_interval()
        elif self.kind in ("crossing", "series"):
            self._check_positions()

    def refuse(self, parameter: str, allowed: str, value: Any = None) -> ConfigurationError:
        """The error for a parameter's value: its name, the value and what is allowed."""
        shown = getattr(self, parameter) if value is None else value
        if isinstance(shown, tuple):
            shown = list(shown) if len(shown) <= 8 else f"a list of {len(shown)}"
        elif isinstance(shown, float):
            shown = f"{shown:.12g}"
        elif isinstance(shown, bool):
            shown = str(shown).lower()
        state = "is not set" if shown in (None, "") else f"is {shown}"
        return ConfigurationError(f"compare.{self.name}.{parameter} {state}; {allowed}")

    def _check_positions(self) -> None:
        positions = self.positions
        if not positions or not all(isfinite(position) for position in positions):
            raise self.refuse("positions", f"a {self.kind} needs positions, all finite")
        if self.kind == "crossing" and len(positions) > 2:
            raise self.refuse(
                "positions", "a crossing has one position or two; take kind series for more"
            )
        wrong = [n for n in range(1, len(positions)) if not positions[n - 1] < positions[n]]
        if wrong:
            n = wrong[0]
            pair = f"{positions[n - 1]:.12g} followed by {positions[n]:.12g}"
            raise self.refuse("positions", "they must be sorted, lowest first, each once", pair)

    def _check_finite(self) -> None:
        for parameter in ("start", "interval", "end", "window"):
            value = getattr(self, parameter)
            for number in value if isinstance(value, tuple) else (value,):
                if number is not None and not isfinite(number):
                    raise self.refuse(parameter, "it must be finite")

    def _check_window(self) -> None:
        if self.window is None:
            raise self.refuse("window", "a window needs [lower, upper]")
        if not self.window[0] < self.window[1]:
            raise self.refuse("window", "the lower end comes first: [lower, upper]")
        if self.toggle:
            raise self.refuse("toggle", "in a window the output is active, there is no toggling")

    def _check_interval(self) -> None:
        if self.start is None:
            raise self.refuse("start", "an interval needs the position of a first pulse")
        if self.interval is None or not self.interval > 0:
            raise self.refuse("interval", "it must be above 0; start, end and direction say where")
        if self.end is None:
            return
        if self.end == self.start:
            raise self.refuse("end", f"it must differ from start, {self.start:.12g}")
        runs = "up" if self.end > self.start else "down"
        if self.direction not in ("both", runs):
            raise self.refuse(
                "direction", f"from start {self.start:.12g} to end {self.end:.12g} it is {runs}"
            )
