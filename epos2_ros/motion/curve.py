"""The commanded curve in joint units: polynomial pieces between points.

Points with positions, velocities and accelerations are joined by quintics, with
velocities by cubics; positions alone by a cubic that keeps the shape of the points
(no overshoot; slopes after Fritsch and Butland, "A method for constructing local
monotone piecewise cubic interpolants", 1984), at rest at both ends.

A curve stores its points only. Coefficients belong to the pieces that are asked for, so
a window of a curve of a million points costs what the window costs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Hermite bases over u = 0 … 1, ascending powers; rows weigh p1 − p0, h·v0, h·v1, h²·a0, h²·a1.
_CUBIC = np.array([[0, 0, 3, -2], [0, 1, -2, 1], [0, 0, -1, 1]], dtype=np.float64)
_QUINTIC = np.array(
    [
        [0, 0, 0, 10, -15, 6],
        [0, 1, 0, -6, 8, -3],
        [0, 0, 0, -4, 7, -3],
        [0, 0, 0.5, -1.5, 1.5, -0.5],
        [0, 0, 0, 0.5, -1, 0.5],
    ]
)


def _derivatives(basis: Array) -> tuple[Array, ...]:
    """The basis and its first three derivatives over u."""
    result = [basis]
    for _ in range(3):
        result.append(result[-1][:, 1:] * np.arange(1, result[-1].shape[1]))
    return tuple(result)


_CUBIC_BASES, _QUINTIC_BASES = _derivatives(_CUBIC), _derivatives(_QUINTIC)


def hermite(
    u: Array,
    h: Array,
    ends: tuple[tuple[Array, Array], ...],
    derivative: int = 0,
) -> Array:
    """A Hermite piece, or a derivative of it, at u = 0 … 1 of its duration h [s].

    `ends` is ((p0, p1), (v0, v1)) for a cubic, with (a0, a1) for a quintic; all arguments
    broadcast against each other.
    """
    basis = (_QUINTIC_BASES if len(ends) == 3 else _CUBIC_BASES)[derivative]
    weights = np.zeros((len(basis), *u.shape))
    for coefficients in basis.T[::-1]:  # Horner, all rows at once
        weights *= u
        weights += coefficients.reshape(-1, *(1,) * u.ndim)
    (p0, p1), *slopes = ends
    value = weights[0] * (p1 - p0)
    for order, pair in enumerate(slopes, start=1):
        weights *= h
        value += weights[2 * order - 1] * pair[0]
        value += weights[2 * order] * pair[1]
    return p0 + value if derivative == 0 else value / h**derivative


@dataclass(frozen=True, eq=False)
class Curve:
    """A curve through points; it holds its first and last point outside of them."""

    times_s: Array  # [points], increasing; any zero
    positions: Array  # [points, axes] [unit]
    velocities: Array | None = None  # [points, axes] [unit/s]
    accelerations: Array | None = None  # [points, axes] [unit/s²]
    start_velocity: Array | None = None  # [axes]; of a curve through positions alone

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

        At a point where pieces of different curvature meet, that of the later one.
        """
        if len(self.times_s) == 1:
            value = np.repeat(self.positions, len(t_s), axis=0)
            return value if derivative == 0 else np.zeros_like(value)
        i = np.searchsorted(self.times_s, t_s, side="right") - 1
        np.clip(i, 0, len(self.times_s) - 2, out=i)
        start = self.times_s[i]
        h = self.times_s[i + 1] - start
        u = (t_s - start) / h
        # Of the times, not of u, which is rounded: 1 may stand for a moment before a point.
        outside = (t_s < self.times_s[0]) | (t_s >= self.times_s[-1])
        value = hermite(np.clip(u, 0, 1)[:, None], h[:, None], self._ends(i), derivative)
        if derivative and outside.any():
            value[outside] = 0.0
        return value

    def bezier(self, first: int, last: int) -> tuple[Array, Array]:
        """Durations [pieces] and control points [degree + 1, axes, pieces] of some pieces.

        The pieces are `first` … `last` − 1. The curve stays between the smallest and the
        largest of a piece's control points.
        """
        part = slice(first, last + 1)
        h = np.diff(self.times_s[part])
        if self.velocities is None:
            v = self._slopes(np.arange(first, last + 1)).T
        else:
            v = self.velocities[part].T
        p, v = np.ascontiguousarray(self.positions[part].T), np.ascontiguousarray(v)
        points = np.empty((self.degree + 1, len(p), len(h)))
        points[0], points[-1] = p[:, :-1], p[:, 1:]
        step = h / self.degree
        points[1] = points[0] + step * v[:, :-1]
        points[-2] = points[-1] - step * v[:, 1:]
        if self.accelerations is not None:
            a = np.ascontiguousarray(self.accelerations[part].T)
            bend = h * h / 20
            points[2] = 2 * points[1] - points[0] + bend * a[:, :-1]
            points[3] = 2 * points[4] - points[5] + bend * a[:, 1:]
        return h, points

    def _ends(self, i: NDArray[np.intp]) -> tuple[tuple[Array, Array], ...]:
        """(p0, p1), (v0, v1) and (a0, a1) of the pieces i [m], each [m, axes]."""
        if self.velocities is None:
            pieces, of = np.unique(i, return_inverse=True)
            slopes = self._slopes(pieces).take(of, 0), self._slopes(pieces + 1).take(of, 0)
            return _both(self.positions, i), slopes
        given = (self.positions, self.velocities, self.accelerations)
        return tuple(_both(values, i) for values in given if values is not None)

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


def _both(values: Array, i: NDArray[np.intp]) -> tuple[Array, Array]:
    """Values at both ends of the pieces i; `take` is much faster than indexing."""
    return values.take(i, axis=0), values.take(i + 1, axis=0)
