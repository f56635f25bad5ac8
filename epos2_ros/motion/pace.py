"""Velocities for points that have none, with which the limits can be kept between them.

A curve that keeps the shape of the points takes no heed of limits: a planner that drove the axes at
theirs passed its points at other velocities. Of the velocities with which an axis can leave a
point, those with which it can come to the next one are an interval: the faster it leaves, the
slower it can arrive. So intervals are taken from the first point to the last, and velocities back
from the last, of each interval the one that is nearest to that of the shape.

This is scalar code for `motion/compiled`, and so one module. In it an axis has the average velocity
`mean` between two points, may go `fastest`, and can change its velocity by twice `spare`.
"""

from __future__ import annotations

from math import inf, sqrt

import numpy as np

from epos2_ros.motion.bounded import AT_ONCE
from epos2_ros.motion.compiled import Vector, compiled, room, vector
from epos2_ros.motion.curve import Curve
from epos2_ros.motion.limits import MARGINS, NOTED, Limits

_NINE_DIGITS = (
    12e-9  # acceleration that rounded positions take, times the time between them squared
)
# What an axis may be beyond its limits of velocity and acceleration: rounding, or part of the
# margins. A little of them is left for the curve that is made through the points.
_SHARES = ((NOTED / 2, NOTED / 2),) + tuple(
    (0.98 * part * MARGINS[1], 0.98 * part * MARGINS[2]) for part in (0.25, 0.5, 1.0)
)


def paced(curve: Curve, limits: Limits) -> Curve:
    """A curve through positions alone, with velocities between which there are motions within the
    limits, or as little beyond them as can be, within MARGINS.

    Of axes for which there are none, with velocities that exceed limits only where they have to, so
    that what is refused is said of the right place.
    """
    durations, ((starts, ends), (v0, v1)) = curve.pieces(0, len(curve.times_s) - 1)
    times, own = vector(durations), np.column_stack((v0, v1[:, -1]))
    velocities = own.T.copy()
    for axis, wished in enumerate(own):
        ways, found = vector(ends[axis] - starts[axis]), vector(wished)
        for faster, steeper in _SHARES:
            fastest = float(limits.velocity[axis]) * (1 + faster)
            steepest = float(limits.acceleration[axis]) * (1 + steeper)
            last = (faster, steeper) == _SHARES[-1]
            if _pass(times, ways, vector(wished), fastest, steepest, last, found):
                break
        velocities[:, axis] = found
    return Curve(curve.times_s, curve.positions, velocities)


def prepare() -> None:
    """Compile this module, or load what an earlier run has compiled, before time matters."""
    _pass(vector([1.0]), vector([0.0]), vector([0.0] * 2), 1.0, 1.0, False, vector([0.0] * 2))


@compiled
def _pass(
    durations: Vector,
    ways: Vector,
    wished: Vector,
    fastest: float,
    steepest: float,
    anyway: bool,
    found: Vector,
) -> bool:
    """Velocities at the points, from the first of those `wished` for to the last of them, into
    `found`; False if there are none, and not some are wanted `anyway`."""
    pieces = len(ways)
    low, high = room(pieces + 1), room(pieces + 1)
    low[0] = high[0] = wished[0]
    for i in range(pieces):
        mean, spare = ways[i] / durations[i], _spare(durations[i], fastest, steepest)
        low[i] = max(low[i], _least(mean, spare, fastest))
        high[i] = min(high[i], -_least(-mean, spare, fastest))
        if low[i] > high[i]:
            low[i] = high[i] = (low[i] + high[i]) / 2
            if not anyway:
                return False
        low[i + 1] = max(_slowest(high[i], mean, spare, fastest), -fastest)
        high[i + 1] = min(-_slowest(-low[i], -mean, spare, fastest), fastest)
        if low[i + 1] > high[i + 1]:
            low[i + 1] = high[i + 1] = (low[i + 1] + high[i + 1]) / 2
            if not anyway:
                return False
    if not (anyway or low[pieces] <= wished[pieces] <= high[pieces]):
        return False
    for i in range(pieces - 1, 0, -1):  # the same, backward in time
        mean, spare = ways[i] / durations[i], _spare(durations[i], fastest, steepest)
        slow = max(low[i], _slowest(found[i + 1], mean, spare, fastest))
        fast = min(high[i], -_slowest(-found[i + 1], -mean, spare, fastest))
        found[i] = min(max(wished[i], slow), max(slow, fast))
    return True


@compiled
def _spare(duration: float, fastest: float, steepest: float) -> float:
    """Half of what velocity can change by between two points."""
    if steepest == inf:
        return AT_ONCE * fastest / 2
    return (steepest * duration + _NINE_DIGITS / duration) / 2


@compiled
def _least(mean: float, spare: float, fastest: float) -> float:
    """The least velocity at one point, whatever that at the other is.

    From it velocity rises all the time, or up to the fastest, and goes on at that.
    """
    if mean + spare <= fastest:
        return mean - spare
    return fastest - 2 * sqrt(max(spare * (fastest - mean), 0.0))


@compiled
def _slowest(velocity: float, mean: float, spare: float, fastest: float) -> float:
    """The least velocity at one point with this one at the other.

    Full acceleration leads up from one and down to the other, with a steady part at the fastest if
    that is reached.
    """
    down = sqrt(
        0.5 - min(max((mean - velocity) / (2 * spare), -0.5), 0.5)
    )  # this share of the time
    if velocity + 2 * spare * (1 - down) <= fastest:
        return velocity + 2 * spare * (1 - 2 * down)
    square = 4 * spare * (fastest - mean) - (fastest - velocity) ** 2
    return fastest - sqrt(max(square, 0.0))
