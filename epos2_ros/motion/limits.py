"""Position, velocity and acceleration of a whole curve against the limits of its axes.

Nothing is sampled. A polynomial piece stays within the hull of its Bézier control points,
and so do its derivatives within theirs: one pass over all pieces clears those whose hull
is within the limits. Only the others are halved again and again (de Casteljau), which
closes in on the true extremum four times faster with each halving.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from epos2_ros.config import AxisConfig
from epos2_ros.errors import ConfigurationError, TrajectoryError
from epos2_ros.motion.curve import Curve
from epos2_ros.motion.units import PROFILE_ACCELERATION_RPM_S, AxisUnits, drive_limits

Array = NDArray[np.float64]

# A planner that writes nine digits may not be refused at its own limit: numbers are
# compared to a millionth, and points are taken to be known to half a unit of the ninth digit.
RELATIVE_SLACK = 1e-6
ROUNDING = 0.5e-9  # [unit], [unit/s], [unit/s²]
_CHUNK = 4096  # pieces at a time, so that the work stays in the cache
_DERIVATIVES = ("position", "velocity", "acceleration")


@dataclass(frozen=True, eq=False)
class Limits:
    """What the axes of a group may do; arrays are [axes].

    What is not configured is bounded by what the drive can hold: an int32 position and
    25,000 rpm. Accelerations are then not bounded (inf) and `agility` says how quickly
    the driver itself changes speed where it has to choose.
    """

    joints: tuple[str, ...]
    units: tuple[str, ...]
    lower: Array  # [unit]
    upper: Array  # [unit]
    velocity: Array  # [unit/s]
    acceleration: Array  # [unit/s²]
    agility: Array  # for joins and stops [unit/s²]: the limit, else the drive's 10,000 rpm/s

    @classmethod
    def of(cls, axes: Sequence[AxisConfig]) -> Limits:
        """Limits of configured axes; raises ConfigurationError for what no drive can do."""
        rows = []
        for axis in axes:
            drive_limits(axis)  # refuses what does not fit into the drive's objects
            units = AxisUnits.of(axis)
            low, high = units.position_range
            low = low if axis.min_position is None else axis.min_position
            high = high if axis.max_position is None else axis.max_position
            if low >= high:
                raise ConfigurationError(
                    f"axes.{axis.joint}.min_position: {low:g} must be below max_position {high:g}"
                )
            default = abs(units.from_rpm(float(PROFILE_ACCELERATION_RPM_S)))
            acceleration = axis.max_acceleration
            rows.append(
                (
                    low,
                    high,
                    axis.max_velocity or units.velocity_range,
                    np.inf if acceleration is None else acceleration,
                    acceleration or default,
                )
            )
        return cls(
            tuple(axis.joint for axis in axes),
            tuple(AxisUnits.of(axis).unit for axis in axes),
            *np.array(rows, dtype=np.float64).T,
        )


@dataclass(frozen=True, eq=False)
class Extreme:
    """Smallest and largest value of a quantity on every axis, and when; all [axes]."""

    low: Array
    low_s: Array
    high: Array
    high_s: Array


def extremes(curve: Curve) -> tuple[Extreme, Extreme, Extreme]:
    """Extremes of position, velocity and acceleration over the whole curve."""
    axes = curve.positions.shape[1]
    if len(curve.times_s) == 1:
        still, when = np.zeros(axes), np.full(axes, curve.start_s)
        here = curve.positions[0]
        return (
            Extreme(here, when, here, when),
            Extreme(still, when, still, when),
            Extreme(still, when, still, when),
        )
    nothing = np.full(axes, -np.inf)
    result = []
    for order in range(3):
        high, high_s = _peaks(curve, order, 1, lambda h: nothing[:, None])
        low, low_s = _peaks(curve, order, -1, lambda h: nothing[:, None])
        result.append(Extreme(-low, low_s, high, high_s))
    return result[0], result[1], result[2]


def check(curve: Curve, limits: Limits, zero_s: float = 0.0) -> None:
    """Raise TrajectoryError when the curve leaves the limits of an axis anywhere.

    The message names joint, time (counted from `zero_s` on the curve's axis), value and
    limit; of several, the worst of the first kind of position, velocity, acceleration.
    """
    if len(curve.times_s) == 1:
        curve = Curve(curve.times_s + (0.0, 1.0), np.repeat(curve.positions, 2, axis=0))
    for order, (low, high) in enumerate(
        (
            (limits.lower, limits.upper),
            (-limits.velocity, limits.velocity),
            (-limits.acceleration, limits.acceleration),
        )
    ):
        if np.isinf(high).all():
            continue
        for sign, bound in ((1, high), (-1, -low)):
            allowed = bound + RELATIVE_SLACK * np.abs(bound)
            value, when = _peaks(
                curve, order, sign, lambda h, a=allowed, o=order: a[:, None] + _rounding(h, o)
            )
            over = np.nan_to_num((value - bound) / np.maximum(np.abs(bound), 1e-9), neginf=-1)
            joint = int(np.argmax(over))
            if np.isfinite(value[joint]):
                unit = limits.units[joint] + ("", "/s", "/s²")[order]
                raise TrajectoryError(
                    f"joint '{limits.joints[joint]}': {_DERIVATIVES[order]} "
                    f"{sign * value[joint]:.6g} {unit} at {when[joint] - zero_s:.3f} s, allowed "
                    f"{low[joint]:.6g} … {high[joint]:.6g} {unit}"
                )


def _rounding(h: Array, order: int) -> Array:
    """How far rounding of a piece's points can move its `order`-th derivative [pieces].

    From the Hermite bases: ends of a quintic that are off by e move its velocity by up to
    2·15/8·e/h and its acceleration by up to 2·10/√3·e/h² (and by e for each given one).
    """
    return ROUNDING * (1 + (0.0, 4 / h, 12 / (h * h) + 16 / h)[order])


def _peaks(
    curve: Curve, order: int, sign: int, threshold: Callable[[Array], Array]
) -> tuple[Array, Array]:
    """Largest value of sign·(derivative) on every axis where it exceeds `threshold`.

    `threshold(h)` gives [axes, pieces] (or [axes, 1]) for pieces of duration h. Returns the
    values and their times, both [axes]; -inf where nothing exceeds it.
    """
    axes = curve.positions.shape[1]
    best, when = np.full(axes, -np.inf), np.full(axes, curve.start_s)
    for first in range(0, len(curve.times_s) - 1, _CHUNK):
        last = min(first + _CHUNK, len(curve.times_s) - 1)
        h, points = curve.bezier(first, last)
        for degree in range(curve.degree, curve.degree - order, -1):
            points = np.diff(points, axis=0) * (degree / h)
        if sign < 0:
            points = -points
        floor = np.maximum(threshold(h), best[:, None])
        axis, piece = np.nonzero(points.max(axis=0) > floor)
        if len(axis):
            _refine(
                points[:, axis, piece],
                axis,
                curve.times_s[first + piece],
                h[piece],
                np.broadcast_to(floor, (axes, last - first))[axis, piece],
                best,
                when,
            )
    return best, when


def _refine(
    points: Array,
    axis: NDArray[np.intp],
    start: Array,
    h: Array,
    floor: Array,
    best: Array,
    when: Array,
) -> None:
    """Raise best[axis], when[axis] to the true maxima of pieces by halving them.

    Arrays are [candidates], `points` [degree + 1, candidates]. A piece is dropped as soon
    as its hull is not above its `floor` or the best value found on its axis.
    """
    while len(axis):
        for value, at in ((points[0], start), (points[-1], start + h)):
            value = np.where(value > floor, value, -np.inf)
            order = np.argsort(value)  # so that the largest of an axis is written last
            better = order[value[order] > best[axis[order]]]
            best[axis[better]] = value[better]
            when[axis[better]] = at[better]
        hull = points.max(axis=0)
        close = 1e-9 * np.maximum(np.abs(hull), 1e-3)
        keep = (hull > floor + close) & (hull > best[axis] + close)
        points, axis, start, h, floor = (
            points[:, keep],
            axis[keep],
            start[keep],
            h[keep] / 2,
            floor[keep],
        )
        left, right = _halves(points)
        points = np.concatenate((left, right), axis=1)
        axis, floor, start = np.tile(axis, 2), np.tile(floor, 2), np.concatenate((start, start + h))
        h = np.tile(h, 2)


def _halves(points: Array) -> tuple[Array, Array]:
    """De Casteljau at one half: control points of both halves."""
    left, right = [points[0]], [points[-1]]
    while len(points) > 1:
        points = (points[1:] + points[:-1]) / 2
        left.append(points[0])
        right.append(points[-1])
    return np.array(left), np.array(right[::-1])
