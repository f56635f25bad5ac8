"""Position-triggered outputs of any drive: from joint units to counts, and what an output is.

What each drive family has and how it is told: `copley`, `epos2`. How it becomes known that an
output has fired: `events`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from epos2_ros.configuration.outputs import CompareConfig
from epos2_ros.errors import ConfigurationError
from epos2_ros.motion.compare import Trigger
from epos2_ros.motion.units import INT32_MAX, INT32_MIN, AxisUnits
from epos2_ros.protocol.outputs.events import Tracker
from epos2_ros.protocol.sdo import SdoWrite


class Output(Protocol):
    """One configured output of one drive."""

    @property
    def config(self) -> CompareConfig: ...

    @property
    def trigger(self) -> Trigger | None:
        """What fires it; None where that is not a matter of position (the marker's input)."""

    def arm(self, position_qc: int) -> list[SdoWrite]:
        """What switches it on while the axis stands at `position_qc`."""

    def disarm(self) -> list[SdoWrite]:
        """What switches it off."""

    def tracker(self, position_qc: int) -> Tracker:
        """What makes events of it, from when it was armed at `position_qc`."""


@dataclass(frozen=True)
class CountScale:
    """An output's parameters in counts; ConfigurationError for what int32 can't hold."""

    config: CompareConfig
    units: AxisUnits

    @property
    def upward(self) -> bool:
        """Whether counts rise where joint positions do."""
        return self.units.qc_per_unit > 0

    @property
    def directions(self) -> tuple[bool, bool]:
        """Whether to fire on counts rising, and falling."""
        up = self.config.direction in ("up", "both")
        down = self.config.direction in ("down", "both")
        return (up, down) if self.upward else (down, up)

    def count(self, parameter: str, position: float) -> int:
        """The count nearest to a joint position [unit]."""
        value = round(self.units.to_qc(position))
        if not INT32_MIN <= value <= INT32_MAX:
            low, high = self.units.position_range
            raise self.config.refuse(
                parameter, f"the drive counts from {low:g} to {high:g} {self.units.unit}", position
            )
        return value

    def counts(self, positions: Sequence[float]) -> tuple[int, ...]:
        """Sorted joint positions [unit] as counts, ascending."""
        values = [self.count("positions", position) for position in positions]
        for n in range(1, len(values)):
            if values[n - 1] == values[n]:
                pair = f"{positions[n - 1]:.12g} followed by {positions[n]:.12g}"
                raise self.config.refuse(
                    "positions", f"they must be {self._one_count} or more apart", pair
                )
        return tuple(values if self.upward else reversed(values))

    def window(self) -> tuple[int, int]:
        """Lower and upper end of the window in counts."""
        assert self.config.window is not None
        ends = [self.count("window", position) for position in self.config.window]
        if ends[0] == ends[1]:
            raise self.config.refuse("window", f"it must be {self._one_count} wide or more")
        return min(ends), max(ends)

    def step(self) -> int:
        """The interval in whole counts."""
        assert self.config.interval is not None
        exact = self.config.interval * abs(self.units.qc_per_unit)
        if not 1 <= round(exact) <= INT32_MAX // 2:
            raise self.config.refuse("interval", f"it must be {self._one_count} or more")
        return round(exact)

    @property
    def remarks(self) -> tuple[str, ...]:
        """What a user should know of the conversion."""
        if self.config.kind != "interval":
            return ()
        assert self.config.interval is not None
        got = self.step() / abs(self.units.qc_per_unit)
        if abs(got - self.config.interval) < 1e-9 * self.config.interval:
            return ()
        return (
            f"compare.{self.config.name}.interval is {self.config.interval:.12g}, which is not a "
            f"whole number of counts: outputs are {got:.12g} {self.units.unit} apart",
        )

    @property
    def _one_count(self) -> str:
        return f"{abs(1 / self.units.qc_per_unit):.6g} {self.units.unit} (one count)"


def check_pins(configs: Sequence[CompareConfig]) -> None:
    """Refuses two outputs of one name or on one pin. Markers use an input, not a pin."""
    names: set[str] = set()
    used: dict[tuple[str, int], str] = {}
    for config in configs:
        if config.name in names:
            raise ConfigurationError(f"outputs names {config.name} twice; each output once")
        names.add(config.name)
        if config.kind == "marker":
            continue
        other = used.setdefault((config.joint, config.pin), config.name)
        if other != config.name:
            raise config.refuse(
                "pin",
                f"compare.{other} uses output {config.pin} of the drive of {config.joint}; "
                "each output can do one thing",
            )
