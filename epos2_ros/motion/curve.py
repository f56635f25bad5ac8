"""The commanded curve in joint units: polynomial pieces between points.

Points with positions, velocities and accelerations are joined by quintics, with
velocities by cubics; positions alone by a cubic that keeps the shape of the points
(no overshoot; slopes after Fritsch and Butland, "A method for constructing local
monotone piecewise cubic interpolants", 1984), at rest at both ends.

A curve stores its points only. Coefficients belong to the pieces that are asked for, so
a window of a curve of a million points costs what the window costs.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import prod

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Hermite bases: powers of u = 0 … 1, of p1 − p0, h·v0, h·v1, h²·a0, h²·a1.
_CUBIC = np.array([[0, 0, 0], [0, 1, 0], [3, -2, -1], [-2, 1, 1]], dtype=np.float64)
_QUINTIC = np.array(
    [
        [0, 0, 0, 0, 0],
        [0, 1, 0, 0, 0],
        [0, 0, 0, 0.5, 0],
        [10, -6, -4, -1.5, 0.5],
        [-15, 8, 7, 1.5, -1],
        [6, -3, -3, -0.5, 0.5],
    ]
)


def _derivatives(basis: Array) -> tuple[Array, ...]:
    """The basis and its first three derivatives over u."""
    result = [basis]
    for _ in range(3):
        result.append(result[-1][1:] * np.arange(1, len(result[-1]))[:, None])
    return tuple(result)


_CUBIC_BASES, _QUINTIC_BASES = _derivatives(_CUBIC), _derivatives(_QUINTIC)
Ends = tuple[tuple[Array, Array], ...]  # (p0, p1), (v0, v1) of cubics, with (a0, a1) of quintics


def hermite(u: Array, h: Array, ends: Ends, derivative: int = 0) -> Array:
    """A Hermite piece, or a derivative of it, at u = 0 … 1 of its duration h [s].

    All arguments broadcast against each other.
    """
    return _at(u, reversed(_powers(h, ends, derivative))) / h**derivative


def _powers(h: Array, ends: Ends, derivative: int) -> Array:
    """Coefficients of the powers of u of a piece, or of its derivative by u [powers, …]."""
    (p0, p1), *slopes = ends
    basis = (_QUINTIC_BASES if len(ends) == 3 else _CUBIC_BASES)[derivative]
    shape = np.broadcast_shapes(np.shape(h), np.shape(p0))
    rows = np.empty((basis.shape[1], *shape))
    rows[0] = p1 - p0
    scale = h
    for at, (start, end) in enumerate(slopes):
        rows[2 * at + 1], rows[2 * at + 2] = scale * start, scale * end
        scale = scale * h
    powers: Array = (basis @ rows.reshape(len(rows), prod(shape))).reshape(len(basis), *shape)
    if derivative == 0:
        powers[0] += p0
    return powers


def _at(u: Array, falling: Iterator[Array]) -> Array:
    """A polynomial of u by Horner's scheme; the coefficient of the highest power comes first."""
    value = next(falling)
    for coefficient in falling:
        value = value * u
        value += coefficient
    return value


@dataclass(frozen=True, eq=False)
class Curve:
    """A curve through points; it holds its first and last point outside of them."""

    times_s: Array  # [points], increasing; any zero
    positions: Array  # [points, axes] [unit]
    velocities: Array | None = None  # [points, axes] [unit/s]
    accelerations: Array | None = None  # [points, axes] [unit/s²]
    start_velocity: Array | None = None  # [axes]; of a curve through positions alone
    arriving: Array | None = None  # as `accelerations`, up to the points, where these jump there

    @classmethod
    def resting(cls, position: Array) -> Curve:
        """Stays at `position` [axes] for ever."""
        return cls(np.zeros(1), np.asarray(position, dtype=np.float64)[None, :])

    @property
    def start_s(self) -> float:
        return float(self.times_s[0])

    @property
    def end_s(self) -> float:
        return float(self.times_s[-1])

    @property
    def degree(self) -> int:
        return 3 if self.accelerations is None else 5

    def evaluate(self, t_s: Array, derivative: int = 0) -> Array:
        """Position or its 1st … 3rd derivative at times t_s [m] → [m, axes].

        At a point where pieces of different curvature meet, that of the later one. All pieces
        between the first and the last of the times are worked out.
        """
        if len(self.times_s) == 1:
            value = np.repeat(self.positions, len(t_s), axis=0)
            return value if derivative == 0 else np.zeros_like(value)
        i: NDArray[np.intp] = self.times_s.searchsorted(t_s, side="right")
        i = np.minimum(np.maximum(i, 1), len(self.times_s) - 1) - 1  # faster than clip
        first, last = (int(np.min(i)), int(np.max(i)) + 1) if i.size else (0, 1)
        h, ends = self.pieces(first, last)
        i -= first
        u = (t_s - self.times_s[first:].take(i)) / h.take(i)
        u = np.minimum(np.maximum(u, 0.0), 1.0)
        powers = reversed(_powers(h, ends, derivative))
        value = _at(u, (power.take(i, axis=1) for power in powers))
        if derivative:
            value /= h.take(i) ** derivative
            # Of the times, not of u, which is rounded: 1 may stand for a moment before a point.
            value[:, (t_s < self.times_s[0]) | (t_s >= self.times_s[-1])] = 0.0
        return value.T

    def bezier(self, first: int, last: int) -> tuple[Array, Array]:
        """Durations [pieces] and control points [degree + 1, axes, pieces] of some pieces.

        The pieces are `first` … `last` − 1. The curve stays between the smallest and the
        largest of a piece's control points.
        """
        h, ((p0, p1), (v0, v1), *bends) = self.pieces(first, last)
        points = np.empty((self.degree + 1, *p0.shape))
        points[0], points[-1] = p0, p1
        step = h / self.degree
        points[1] = p0 + step * v0
        points[-2] = p1 - step * v1
        for a0, a1 in bends:
            bend = h * h / 20
            points[2] = 2 * points[1] - p0 + bend * a0
            points[3] = 2 * points[4] - p1 + bend * a1
        return h, points

    def pieces(self, first: int, last: int) -> tuple[Array, Ends]:
        """Durations [pieces] and ends, each [axes, pieces], of the pieces first … last − 1."""
        part = slice(first, last + 1)
        if self.velocities is None:
            velocities = self._slopes(np.arange(first, last + 1))
        else:
            velocities = self.velocities[part]
        given = [self.positions[part], velocities]
        if self.accelerations is not None:
            given.append(self.accelerations[part])
        rows = [np.ascontiguousarray(values.T) for values in given]
        ends = [(row[:, :-1], row[:, 1:]) for row in rows]
        if self.arriving is not None:
            ends[-1] = ends[-1][0], np.ascontiguousarray(self.arriving[part].T)[:, 1:]
        times_s = self.times_s[part]
        return times_s[1:] - times_s[:-1], tuple(ends)

    def _slopes(self, i: NDArray[np.intp]) -> Array:
        """Velocities at the points i of a curve through positions alone [m, axes].

        Fritsch–Butland: a harmonic mean of the secants on both sides, weighted by their
        durations; 0 at a turning point and at both ends.
        """
        last = len(self.times_s) - 1
        before, here, after = np.maximum(i - 1, 0), i, np.minimum(i + 1, last)
        inner = (i > 0) & (i < last)
        h0 = np.where(inner, self.times_s[here] - self.times_s[before], 1.0)[:, None]
        h1 = np.where(inner, self.times_s[after] - self.times_s[here], 1.0)[:, None]
        d0 = (self.positions[here] - self.positions[before]) / h0
        d1 = (self.positions[after] - self.positions[here]) / h1
        keeps = inner[:, None] & (d0 * d1 > 0)
        d0, d1 = np.where(keeps, d0, 1.0), np.where(keeps, d1, 1.0)
        slopes = 3 * (h0 + h1) / ((h0 + 2 * h1) / d0 + (2 * h0 + h1) / d1)
        slopes = np.where(keeps, slopes, 0.0)
        if self.start_velocity is not None:
            slopes[i == 0] = self.start_velocity
        return slopes
