"""When a moving axis passes given encoder counts.

An encoder says the count nearest to where the shaft is, so it goes from V − 1 to V where the
shaft passes V − ½; that is what "V is crossed upward" means here, and the same place passed the
other way is "V is crossed downward" (Copley's compare hardware sees whole counts: at 1200 going
down it fires when the encoder says 1199).

Counts of interest cut the line into cells: `cell(x)` is how many of them lie at or below x, and a
crossing is a step from one cell to the next. So what one piece of a path leaves off is where the
next goes on, and no crossing is found twice or missed at a seam.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_EDGE = 0.5  # the encoder changes to V half a count below it
_BISECTIONS = 32  # of a piece of 1 ms: far below a nanosecond


@dataclass(frozen=True)
class Points:
    """Any counts, ascending, each once."""

    counts: tuple[int, ...]

    @cached_property
    def _array(self) -> IntArray:
        return np.array(self.counts, dtype=np.int64)

    def cell(self, position: ArrayLike) -> IntArray:
        """How many of the counts an encoder at `position` [counts] has reached."""
        x = np.asarray(position, dtype=np.float64)
        return np.searchsorted(self._array - _EDGE, x, side="right").astype(np.int64)

    def count(self, index: IntArray) -> IntArray:
        """The count between the cells `index` and `index` + 1."""
        return self._array[index]

    @property
    def spacing(self) -> float:
        """The smallest distance between two of them [counts]."""
        return float(min(np.diff(self._array), default=np.inf))


@dataclass(frozen=True)
class Grid:
    """Every `step`-th count through `origin`; step > 0. It ends at indices `low` and `high`."""

    origin: int
    step: int
    low: int | None = None
    high: int | None = None

    def cell(self, position: ArrayLike) -> IntArray:
        """Cell 0 ends at the origin; below it cells are negative."""
        x = np.asarray(position, dtype=np.float64)
        cell = np.floor_divide(x + _EDGE - self.origin, self.step).astype(np.int64) + 1
        if self.low is None and self.high is None:
            return cell
        return np.clip(cell, self.low, None if self.high is None else self.high + 1)

    def count(self, index: IntArray) -> IntArray:
        """The count between the cells `index` and `index` + 1."""
        return self.origin + self.step * index

    def at_or_below(self, count: int) -> int:
        """The index of the last of them that is not above `count`."""
        return (count - self.origin) // self.step

    @property
    def spacing(self) -> float:
        """The distance between two of them [counts]."""
        return float(self.step)


Counts = Points | Grid


class Path(NamedTuple):
    """A piece of an axis' motion: a cubic between each two knots (position and velocity given).

    A curve that is evaluated at 1 kHz, as the drives do, is such a path exactly.
    """

    t_us: FloatArray  # [knots], increasing
    position_qc: FloatArray  # [knots]
    velocity_qc_s: FloatArray  # [knots]


@dataclass(frozen=True, eq=False)
class Crossings:
    """In the order in which they happen; arrays of one length."""

    t_us: FloatArray
    count: IntArray  # the V that was crossed
    index: IntArray  # its number among the counts of interest
    rising: NDArray[np.bool_]
    velocity_qc_s: FloatArray
    acceleration_qc_s2: FloatArray

    def __len__(self) -> int:
        return len(self.t_us)

    def where(self, mask: NDArray[np.bool_]) -> Crossings:
        """Those of them that the mask selects."""
        return Crossings(*(getattr(self, column.name)[mask] for column in fields(self)))

    @classmethod
    def joined(cls, parts: Sequence[Crossings]) -> Crossings:
        """One after another."""
        if len(parts) == 1:
            return parts[0]
        columns = (column.name for column in fields(cls))
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in columns))


class Rests(NamedTuple):
    """Where an axis turns round or comes to rest; arrays of one length."""

    t_us: FloatArray
    position_qc: FloatArray
    acceleration_qc_s2: FloatArray  # with which it got there

    def where(self, mask: NDArray[np.bool_]) -> Rests:
        """Those of them that the mask selects."""
        return Rests(*(column[mask] for column in self))

    @classmethod
    def joined(cls, parts: Sequence[Rests]) -> Rests:
        """One after another."""
        return cls(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def crossings(counts: Counts, path: Path) -> Crossings:
    """Every crossing of `counts` on the way along `path`."""
    pieces = _Pieces.of(path)
    piece, u0, u1 = pieces.monotone()
    # At a knot the position itself counts, not the cubic's rounding of it.
    first = counts.cell(np.where(u0 > 0, pieces.position(piece, u0), path.position_qc[piece]))
    last = counts.cell(np.where(u1 < 1, pieces.position(piece, u1), path.position_qc[piece + 1]))
    many = np.abs(last - first)
    row = np.repeat(np.arange(len(piece)), many)
    nth = np.arange(len(row)) - np.repeat(np.cumsum(many) - many, many)
    rising = last[row] > first[row]
    index = np.where(rising, first[row] + nth, first[row] - 1 - nth)
    count = counts.count(index)
    edge = count.astype(np.float64) - _EDGE
    u = pieces.solve(piece[row], u0[row], u1[row], edge, rising)
    velocity, acceleration = pieces.slopes(piece[row], u)
    t_us = path.t_us[piece[row]] + u * pieces.duration_us[piece[row]]
    return Crossings(t_us, count, index, rising, velocity, acceleration)


def rests(path: Path) -> Rests:
    """Where the axis turns round or comes to rest on the way along `path`."""
    pieces = _Pieces.of(path)
    piece, u0, u1 = pieces.monotone()
    velocity, acceleration = pieces.slopes(piece, u1)
    moved = np.abs(pieces.position(piece, u1) - pieces.position(piece, u0))
    here = (np.abs(velocity) * pieces.duration_us[piece] * 1e-6 <= 1e-6 * moved) & (moved > 0)
    t_us = path.t_us[piece] + u1 * pieces.duration_us[piece]
    return Rests(t_us[here], pieces.position(piece, u1)[here], acceleration[here])


@dataclass(frozen=True)
class _Pieces:
    """Coefficients of c0 + c1·u + c2·u² + c3·u³ with u = 0 … 1 between two knots."""

    duration_us: FloatArray
    c: FloatArray  # [4, pieces]

    @classmethod
    def of(cls, path: Path) -> _Pieces:
        duration_us = np.diff(path.t_us)
        h = duration_us * 1e-6
        p0, p1 = path.position_qc[:-1], path.position_qc[1:]
        v0, v1 = path.velocity_qc_s[:-1] * h, path.velocity_qc_s[1:] * h
        return cls(
            duration_us, np.array([p0, v0, 3 * (p1 - p0) - 2 * v0 - v1, 2 * (p0 - p1) + v0 + v1])
        )

    def position(self, piece: IntArray, u: FloatArray) -> FloatArray:
        c0, c1, c2, c3 = self.c[:, piece]
        return ((c3 * u + c2) * u + c1) * u + c0

    def slopes(self, piece: IntArray, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Velocity [qc/s] and acceleration [qc/s²]."""
        _, c1, c2, c3 = self.c[:, piece]
        h = self.duration_us[piece] * 1e-6
        return ((3 * c3 * u + 2 * c2) * u + c1) / h, (6 * c3 * u + 2 * c2) / h**2

    def monotone(self) -> tuple[IntArray, FloatArray, FloatArray]:
        """The pieces cut where the axis turns round: piece, from u, to u."""
        _, c1, c2, c3 = self.c
        n = len(c1)
        with np.errstate(divide="ignore", invalid="ignore"):
            root = np.sqrt(c2**2 - 3 * c3 * c1)
            q = -(c2 + np.where(c2 < 0, -root, root))  # the sum that does not cancel
            turns = np.concatenate([q / (3 * c3), c1 / q])
        owner = np.tile(np.arange(n), 2)
        inside = (turns > 0) & (turns < 1)
        piece = np.concatenate([np.arange(n), owner[inside]])
        u0 = np.concatenate([np.zeros(n), turns[inside]])
        order = np.lexsort((u0, piece))
        piece, u0 = piece[order], u0[order]
        u1 = np.ones(len(u0))
        same = piece[1:] == piece[:-1]
        u1[:-1][same] = u0[1:][same]
        return piece, u0, u1

    def solve(
        self,
        piece: IntArray,
        low: FloatArray,
        high: FloatArray,
        position: FloatArray,
        rising: NDArray[np.bool_],
    ) -> FloatArray:
        """Where on its monotone stretch each piece is at `position`."""
        low, high = low.copy(), high.copy()
        for _ in range(_BISECTIONS):
            middle = (low + high) / 2
            before = (self.position(piece, middle) < position) == rising
            low, high = np.where(before, middle, low), np.where(before, high, middle)
        return high
