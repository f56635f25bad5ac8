"""A gentler curve through the same points, where the polynomials between them exceed a limit.

A planner that drives the axes at their limits switches accelerations between its points. A quintic
or cubic through the points rounds such a switch off, and goes beyond the limits beside it, where
the planner's own motion did not. So in a piece that does, an axis takes the cubic through positions
and velocities if that keeps the limits, and else the motion with the least acceleration there is:
up to some velocity with an acceleration, from there on with its opposite, and with the velocity
limit in between where it would be exceeded. No motion between these positions and velocities gets
by with less, so if the planner's kept the limits, this one does; if not, it exceeds the velocity,
within its margin, rather than the acceleration.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from epos2_ros.motion.curve import Curve, hermite
from epos2_ros.motion.limits import (
    CHUNK,
    MARGINS,
    NOTED,
    RELATIVE_SLACK,
    ROUNDING,
    Limits,
    amplification,
    refine,
)

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# An axis without a limit of acceleration changes its velocity between two points by so many times
# the limit of velocity, at the most where that keeps it within the latter.
AT_ONCE = 20.0
_SHORTEST_S = 4e-7  # phases shorter than this are left out
_SAME_S = 2e-7  # and times less apart than this are made one


def bounded(curve: Curve, limits: Limits) -> Curve:
    """The same points, joined so that velocity and acceleration keep the limits where they can.

    What keeps them already stays as it is. The curve has further points where accelerations jump.
    """
    count = len(curve.times_s) - 1
    parts = [
        _part(curve, first, min(first + CHUNK, count), limits) for first in range(0, count, CHUNK)
    ]
    begins_s = np.concatenate([part[0] for part in parts])
    position, velocity, acceleration = (
        np.concatenate([part[1][order] for part in parts], axis=1) for order in range(3)
    )  # [2, pieces, axes]: at both ends of every piece
    return Curve(
        np.append(begins_s, curve.end_s),
        np.concatenate((position[0], position[1, -1:])),
        np.concatenate((velocity[0], velocity[1, -1:])),
        np.concatenate((acceleration[0], acceleration[1, -1:])),
        arriving=np.concatenate((acceleration[0, :1], acceleration[1])),
    )


def _part(curve: Curve, first: int, last: int, limits: Limits) -> tuple[Array, list[Array]]:
    """When the pieces of the new curve begin that stand for pieces first … last − 1, and positions,
    velocities and accelerations at both ends of them, each [2, pieces, axes]."""
    times_s = curve.times_s[first : last + 1]
    h, points = curve.bezier(first, last)
    _, ends = curve.pieces(first, last)
    beyond = _beyond(h, points, limits)
    axis, piece = np.nonzero(beyond)
    p0, p1, v0, v1 = (values[axis, piece] for pair in ends[:2] for values in pair)
    cubic = _cubic_keeps(h[piece], p0, p1, v0, v1, limits, axis)
    most, steepest = limits.velocity[axis], limits.acceleration[axis] * (1 + 0.6 * NOTED)
    steepest = np.where(np.isfinite(steepest), steepest, AT_ONCE * most / h[piece])
    phases = _Phases.least(h[piece], p0, p1, v0, v1, most, steepest)
    cubic |= ~phases.inside.any(axis=0)  # as good as one phase
    phases, switches = phases.together(times_s[piece], ~cubic)
    begins_s = np.unique(np.concatenate((times_s[:-1], switches)))
    # Both ends of every new piece, as places on the old ones.
    old = np.searchsorted(times_s[:-1], begins_s, side="right") - 1
    at_s = np.stack((begins_s, np.append(begins_s[1:], times_s[-1]))) - times_s[old]
    given = tuple((start[:, old], end[:, old]) for start, end in ends)
    row = np.full(beyond.shape, -1)
    row[axis, piece] = np.arange(len(axis))
    values = []
    for order in range(3):
        value = np.stack([hermite(at / h[old], h[old], given, order).T for at in at_s])
        for i in np.flatnonzero(beyond.any(axis=1)):
            new = row[i, old] >= 0
            one = row[i, old][new]
            least = phases.at(one, at_s[:, new], order)
            length, states = h[piece[one]], ((p0[one], p1[one]), (v0[one], v1[one]))
            simple = hermite(at_s[:, new] / length, length, states, order)
            value[:, new, i] = np.where(cubic[one], simple, least)
        values.append(value)
    return begins_s, values


@dataclass(frozen=True, eq=False)
class _Phases:
    """Motions of three phases: accelerating, steady, accelerating; all arrays are [motions]."""

    h: Array
    p0: Array
    p1: Array
    v0: Array
    v1: Array
    first_s: Array  # the end of the first phase, and
    second_s: Array  # of the second, which may be none
    a0: Array  # of the first phase
    a1: Array  # of the last

    @classmethod
    def least(
        cls, h: Array, p0: Array, p1: Array, v0: Array, v1: Array, most: Array, steepest: Array
    ) -> _Phases:
        """With the least acceleration, and no faster than `most` where the ends aren't; within the
        margin a little faster where it would take more than the acceleration `steepest`."""
        # From a·(2·s − 1)·h = v1 − v0 and a·(2·s − s² − 1/2)·h² = p1 − p0 − v0·h, s = first/h.
        slope = (v1 - v0) / h
        bend = 2 * ((p1 - p0 - v0 * h) / (h * h) - slope / 2)
        a = bend + np.where(bend < 0, -1.0, 1.0) * np.hypot(bend, slope)
        first_s = h * np.clip(
            (1 + np.divide(slope, a, out=np.zeros_like(a), where=a != 0)) / 2, 0, 1
        )
        top = v0 + a * first_s
        sign = np.where(top < 0, -1.0, 1.0)
        # Where the fastest is c: (c − v0)² + (c − v1)² = 2·steepest·(c·h − p1 + p0).
        half = (sign * (v0 + v1) + steepest * h) / 2
        rest = (v0 * v0 + v1 * v1) / 2 + steepest * sign * (p1 - p0)
        needed = half - np.sqrt(np.maximum(half * half - rest, 0.0))
        most = np.clip(needed, most, most * (1 + MARGINS[1]))
        most = np.maximum(most, np.maximum(sign * v0, sign * v1))
        room = most * h - sign * (p1 - p0)
        steady = (sign * top > most) & (room > 0)
        up, down = most - sign * v0, most - sign * v1
        steep = np.where(steady, (up**2 + down**2) / (2 * np.where(steady, room, 1.0)), 1.0)
        steep = np.where(steep > 0, steep, 1.0)
        return cls(
            h,
            p0,
            p1,
            v0,
            v1,
            np.where(steady, up / steep, first_s),
            np.where(steady, h - down / steep, first_s),
            np.where(steady, sign * steep, a),
            np.where(steady, -sign * steep, -a),
        )

    @property
    def inside(self) -> Mask:
        """Whether first and second phase end within the motion [2, motions]."""
        ends_s = np.stack((self.first_s, self.second_s))
        result = (ends_s > _SHORTEST_S) & (ends_s < self.h - _SHORTEST_S)
        result[1] &= self.second_s - self.first_s > _SHORTEST_S
        return result

    def together(self, start_s: Array, of: Mask) -> tuple[_Phases, Array]:
        """The same, but that phases of several axes that end within _SAME_S end together; and when
        phases end. Motions begin at `start_s`; only some are `of` interest."""
        ends_s, inside = np.stack((self.first_s, self.second_s)), self.inside & of
        at_s = (start_s + ends_s)[inside]
        times_s = np.unique(at_s)
        times_s = times_s[np.diff(times_s, prepend=-np.inf) > _SAME_S]
        moved_s = ends_s.copy()
        moved_s[inside] += times_s[np.searchsorted(times_s, at_s, side="right") - 1] - at_s
        moved_s[1] = np.where(self.second_s > self.first_s, moved_s[1], moved_s[0])
        again = (moved_s != ends_s).any(axis=0) & (moved_s[0] > 0) & (moved_s[1] < self.h)
        moved_s = np.where(again, moved_s, ends_s)  # where there is just one phase, it stays
        # a0·first + a1·last = v1 − v0; a0·first·(h − first/2) + a1·last²/2 = p1 − p0 − v0·h.
        first, last = moved_s[0], self.h - moved_s[1]
        change, way = self.v1 - self.v0, self.p1 - self.p0 - self.v0 * self.h
        whole = np.where(again, first * last * (last / 2 - self.h + first / 2), 1.0)
        a0 = (change * last**2 / 2 - way * last) / whole
        a1 = (way * first - change * first * (self.h - first / 2)) / whole
        accelerations = np.where(again, a0, self.a0), np.where(again, a1, self.a1)
        ends = self.h, self.p0, self.p1, self.v0, self.v1
        return _Phases(*ends, moved_s[0], moved_s[1], *accelerations), times_s

    def at(self, some: NDArray[np.intp], t_s: Array, order: int) -> Array:
        """Position, velocity or acceleration of motions, at both ends of spans [2, spans]."""
        h, p0, p1, v0, v1, first, second, a0, a1 = (
            values[some]
            for values in (
                *(self.h, self.p0, self.p1, self.v0, self.v1),
                *(self.first_s, self.second_s, self.a0, self.a1),
            )
        )
        at = t_s if order < 2 else t_s.mean(axis=0)  # an acceleration is that of the span
        left, steady = t_s - h, v0 + a0 * first
        before, between, after = (
            (
                p0 + (v0 + a0 * t_s / 2) * t_s,
                p0 + (v0 + a0 * first / 2) * first + steady * (t_s - first),
                p1 + (v1 + a1 * left / 2) * left,
            ),
            (v0 + a0 * t_s, steady + 0 * t_s, v1 + a1 * left),
            (a0 + 0 * t_s, 0 * t_s, a1 + 0 * t_s),
        )[order]
        return np.where(at < first, before, np.where(at <= second, between, after))


def _cubic_keeps(
    h: Array, p0: Array, p1: Array, v0: Array, v1: Array, limits: Limits, axis: NDArray[np.intp]
) -> Mask:
    """Whether cubics keep the limits of velocity and acceleration [cubics]."""
    mean = (p1 - p0) / h
    b, a = (3 * mean - 2 * v0 - v1) / h, (v0 + v1 - 2 * mean) / (h * h)
    with np.errstate(divide="ignore", invalid="ignore"):
        turn = -b / (3 * a)
        top = np.where((turn > 0) & (turn < h), v0 + b * turn, 0.0)
    fastest = np.max(np.abs((v0, v1, top)), axis=0)
    steepest = np.maximum(np.abs(2 * b), np.abs(2 * b + 6 * a * h))
    slack = 1 + RELATIVE_SLACK
    keeps: Mask = fastest <= limits.velocity[axis] * slack
    return keeps & (steepest <= limits.acceleration[axis] * slack)


def _beyond(h: Array, points: Array, limits: Limits) -> Mask:
    """In which pieces, given by their Bézier points, axes exceed limits of velocity or acceleration
    and another curve could be better [axes, pieces]."""
    degree = len(points) - 1
    way = np.abs(points[-1] - points[0])
    result = np.zeros(points.shape[1:], dtype=bool)
    for order, bounds in ((1, limits.velocity), (2, limits.acceleration)):
        points = np.diff(points, axis=0) * (degree + 1 - order) / h
        most = bounds[:, None] * (1 + RELATIVE_SLACK) + ROUNDING * amplification(h, order)
        axis, piece = np.nonzero(np.abs(points).max(axis=0) > most)
        found, when = np.full(len(axis), -np.inf), np.zeros(len(axis))
        for sign in (1, -1):
            each, part = np.arange(len(axis)), sign * points[:, axis, piece]
            refine(part, each, when.copy(), h[piece], most[axis, piece], found, when)
        result[axis, piece] |= found > -np.inf
    return result & (way <= (1 + MARGINS[1]) * limits.velocity[:, None] * h)
