"""A gentler curve through the same points, where the polynomials between them exceed a limit.

A planner that drives the axes at their limits switches accelerations between its points. A quintic
or cubic through the points rounds such a switch off, and goes beyond the limits beside it, where
the planner's own motion did not. So in a piece that does, an axis takes the cubic through positions
and velocities if that keeps the limits, and else the motion with the least acceleration there is:
up to some velocity with an acceleration, from there on with its opposite, and with the velocity
limit in between where it would be exceeded. No motion between these positions and velocities gets
by with less, so if the planner's kept the limits, this one does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from epos2_ros.motion.curve import Curve, hermite
from epos2_ros.motion.limits import MARGINS, RELATIVE_SLACK, ROUNDING, Limits, amplification, refine

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_SHORTEST_S = 2e-6  # phases shorter than this are left out
_SAME_S = 1e-6  # and times less apart than this are made one


def bounded(curve: Curve, limits: Limits) -> Curve:
    """The same points, joined so that velocity and acceleration keep the limits where they can.

    What keeps them already stays as it is. The curve has further points where accelerations jump.
    """
    count = len(curve.times_s) - 1
    h, points = curve.bezier(0, count)
    too_far = np.abs(points[-1] - points[0]) > (1 + MARGINS[1]) * limits.velocity[:, None] * h
    beyond = _beyond(h, points, limits) & ~too_far  # for any curve
    if not beyond.any():
        return curve
    axis, piece = np.nonzero(beyond)
    velocities = np.diff(points, axis=0) * curve.degree / h
    p0, p1, v0, v1 = (
        values[axis, piece] for values in (points[0], points[-1], velocities[0], velocities[-1])
    )
    cubic = _cubic_keeps(h[piece], p0, p1, v0, v1, limits, axis)
    phases = _Phases.least(h[piece], p0, p1, v0, v1, limits.velocity[axis])
    cubic |= ~phases.inside.any(axis=0)  # as good as one phase
    phases, switches = phases.together(curve.times_s[piece], ~cubic)
    times = np.unique(np.concatenate((curve.times_s, switches)))
    # Both ends of every piece of the new curve, as places on the pieces of the old one.
    old = np.minimum(np.searchsorted(curve.times_s, times[:-1], side="right") - 1, count - 1)
    starts, ends = times[:-1] - curve.times_s[old], times[1:] - curve.times_s[old]
    values = [_evaluated(curve, old, np.stack((starts, ends)), order) for order in range(3)]
    row = np.full(beyond.shape, -1)
    row[axis, piece] = np.arange(len(axis))
    for i in np.flatnonzero(beyond.any(axis=1)):
        mine = row[i, old]
        replaced = mine >= 0
        one = mine[replaced]
        at = np.stack((starts[replaced], ends[replaced]))
        for order in range(3):
            own = hermite(
                at / h[piece[one]], h[piece[one]], ((p0[one], p1[one]), (v0[one], v1[one])), order
            )
            values[order][:, replaced, i] = np.where(cubic[one], own, phases.at(one, at, order))
    return Curve(
        times,
        np.concatenate((values[0][0], values[0][1, -1:])),
        np.concatenate((values[1][0], values[1][1, -1:])),
        np.concatenate((values[2][0], values[2][1, -1:])),
        arriving=np.concatenate((values[2][0, :1], values[2][1])),
    )


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
    def least(cls, h: Array, p0: Array, p1: Array, v0: Array, v1: Array, most: Array) -> _Phases:
        """With the least acceleration, and no faster than `most` where the ends aren't."""
        # From a·(2·s − 1)·h = v1 − v0 and a·(2·s − s² − 1/2)·h² = p1 − p0 − v0·h, s = first/h.
        slope = (v1 - v0) / h
        bend = 2 * ((p1 - p0 - v0 * h) / (h * h) - slope / 2)
        a = bend + np.where(bend < 0, -1.0, 1.0) * np.hypot(bend, slope)
        first_s = h * np.clip(
            (1 + np.divide(slope, a, out=np.zeros_like(a), where=a != 0)) / 2, 0, 1
        )
        top = v0 + a * first_s
        sign = np.where(top < 0, -1.0, 1.0)
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


def _evaluated(curve: Curve, piece: NDArray[np.intp], at_s: Array, order: int) -> Array:
    """A derivative of pieces at times since they began [2, pieces] → [2, pieces, axes]."""
    h, ends = curve.pieces(0, len(curve.times_s) - 1)
    h, own = h[piece], tuple((a[:, piece], b[:, piece]) for a, b in ends)
    return np.stack([hermite(at / h, h, own, order).T for at in at_s])


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
    """Which pieces exceed velocity or acceleration limits [axes, pieces]."""
    degree = len(points) - 1
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
    return result
