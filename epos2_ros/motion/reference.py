"""What the drives have to follow: motions one after another on the path-time axis.

Path time counts milliseconds from the SYNC that started the motion. A *motion* is a
function of path time in joint units that is at rest from its `end_s` on; a `Reference`
says which motion governs from which millisecond on, and speaks drive units. The motions
are made by `join` and `stop`, so that each goes on from the state the last one leaves:
position and velocity have no jumps.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from epos2_ros.motion.curve import Curve
from epos2_ros.motion.units import AxisUnits

Array = NDArray[np.float64]


class Motion(Protocol):
    """A function of path time in joint units, at rest from `end_s` on."""

    @property
    def end_s(self) -> float: ...

    def evaluate(self, t_s: Array, derivative: int = 0) -> Array:
        """Position or its 1st or 2nd derivative at path times t_s [m] → [m, axes]."""


class State(NamedTuple):
    """State of all axes at one instant, joint units; each [axes]."""

    position: Array
    velocity: Array
    acceleration: Array

    @classmethod
    def of(cls, motion: Motion, t_s: float) -> State:
        at = np.array([t_s])
        return cls(*(motion.evaluate(at, derivative)[0] for derivative in range(3)))


@dataclass(frozen=True, eq=False)
class Reference:
    """Motions in their order; the first holds from ever, each later one from its start on."""

    units: tuple[AxisUnits, ...]
    motions: tuple[Motion, ...]
    starts_ms: tuple[int, ...] = ()  # of motions[1:]
    remark: str = ""  # what a user should know of the last motion

    @classmethod
    def at_rest(cls, units: Sequence[AxisUnits], position: Array | Sequence[float]) -> Reference:
        """Stands at a joint position [axes] [unit]."""
        return cls(tuple(units), (Curve.resting(np.asarray(position, dtype=np.float64)),))

    @property
    def end_ms(self) -> int:
        """From here on it rests at its end."""
        return max(math.ceil(self.end_s * 1000 - 1e-6), *self.starts_ms[-1:], 0)

    @property
    def end_s(self) -> float:
        """Path time from which on it rests; a reference is a motion, too."""
        return self.motions[-1].end_s

    def positions(self, k: NDArray[np.int64]) -> Array:
        """Commanded positions at milliseconds k [m] → [m, axes] [qc], drive frame."""
        return self.positions_at(k.astype(np.float64))

    def positions_at(self, t_ms: Array) -> Array:
        """Likewise at any times t_ms [m]."""
        offset = np.array([u.offset for u in self.units])
        return (self.evaluate(t_ms / 1000) - offset) * self._scale

    def velocities(self, k: NDArray[np.int64]) -> Array:
        """Commanded velocities at milliseconds k [m] → [m, axes] [qc/s], drive frame."""
        return self.evaluate(k / 1000, 1) * self._scale

    def state(self, at_ms: int) -> State:
        """Where the axes are commanded to be at a millisecond; joint units."""
        return State.of(self, at_ms / 1000)

    def evaluate(self, t_s: Array, derivative: int = 0) -> Array:
        """Position or its 1st or 2nd derivative at path times t_s [m] → [m, axes]; joint units."""
        if not self.starts_ms:
            return self.motions[0].evaluate(t_s, derivative)
        which = np.searchsorted(np.array(self.starts_ms) / 1000, t_s, side="right")
        value = np.empty((len(t_s), len(self.units)))
        for i in np.unique(which):
            mine = which == i
            value[mine] = self.motions[i].evaluate(t_s[mine], derivative)
        return value

    def governs(self, at_ms: int) -> Motion:
        """The motion that governs at a millisecond."""
        return self.motions[bisect_right(self.starts_ms, at_ms)]

    def rests(self, at_ms: int) -> bool:
        """Whether the axes stand at a millisecond, and would go on standing."""
        return self.governs(at_ms).end_s <= at_ms / 1000 + 1e-9

    def followed_by(self, motion: Motion, at_ms: int, remark: str = "") -> Reference:
        """This reference until `at_ms`, then `motion`."""
        keep = bisect_right(self.starts_ms, at_ms - 1)
        return Reference(
            self.units,
            (*self.motions[: keep + 1], motion),
            (*self.starts_ms[:keep], at_ms),
            remark,
        )

    def trimmed(self, from_ms: int) -> Reference:
        """The same from `from_ms` on, without what is only needed before."""
        first = bisect_right(self.starts_ms, from_ms)
        return Reference(self.units, self.motions[first:], self.starts_ms[first:])

    @property
    def _scale(self) -> Array:
        return np.array([u.qc_per_unit for u in self.units])


@dataclass(frozen=True, eq=False)
class Columns:
    """Some of a reference's axes, by their places in it."""

    reference: Reference
    places: tuple[int, ...]

    @property
    def end_ms(self) -> int:
        return self.reference.end_ms

    def positions(self, k: NDArray[np.int64]) -> Array:
        """Commanded positions at milliseconds k [m] → [m, places] [qc], drive frame."""
        return self.reference.positions(k)[:, self.places]
