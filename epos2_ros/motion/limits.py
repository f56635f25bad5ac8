"""Position, velocity and acceleration of a whole curve against the limits of its axes.

Nothing is sampled. A polynomial piece stays within the hull of its Bézier control points,
and so do its derivatives within theirs: one pass over all pieces clears those whose hull
is within the limits. Only the others are halved again and again (de Casteljau), which
closes in on the true extremum four times faster with each halving.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from epos2_ros.configuration.driver import AxisConfig
from epos2_ros.errors import ConfigurationError, TrajectoryError
from epos2_ros.motion.curve import Curve
from epos2_ros.motion.units import PROFILE_ACCELERATION_RPM_S, AxisUnits, drive_limits

Array = NDArray[np.float64]

# A planner that writes nine digits may not be refused at its own limit: numbers are
# compared to a millionth, and points are taken to be known to half a unit of the ninth digit.
RELATIVE_SLACK = 1e-6
ROUNDING = 0.5e-9  # [unit], [unit/s], [unit/s²]
# What the driver plans itself it looks at instant by instant, and keeps this share of a limit.
PLANNED_SHARE = 0.999
# How far the curve through a trajectory's points may be beyond the limits where none keeps them, as
# shares of position, velocity and acceleration. Planners keep limits at grid points of their own
# only: between them TOPP-RA's are commonly 0.3 % and 10 %, sometimes 4 % and 20 %, beyond. What
# drives enforce is 5 % and 25 % above (bus/settings); what is left of that is for the records.
MARGINS = (0.0, 0.04, 0.2)
NOTED = 1e-3  # share of a limit; less than that is rounding of the points
BEYOND_POINTS = "no curve through the trajectory's points keeps the limits"
CHUNK = 8192  # pieces at a time: large enough for NumPy, small enough for the memory


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
                    axis.max_velocity or units.velocity_unasked,
                    np.inf if acceleration is None else acceleration,
                    acceleration or default,
                )
            )
        return cls(
            tuple(axis.joint for axis in axes),
            tuple(AxisUnits.of(axis).unit for axis in axes),
            *np.array(rows, dtype=np.float64).reshape(-1, 5).T,
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
    value, when = _peaks(_pieces(curve), np.full((3, 2, curve.positions.shape[1]), -np.inf))
    position, velocity, acceleration = (
        Extreme(-value[order, 1], when[order, 1], value[order, 0], when[order, 0])
        for order in range(3)
    )
    return position, velocity, acceleration


def check(
    curve: Curve, limits: Limits, zero_s: float = 0.0, margins: tuple[float, ...] = (0, 0, 0)
) -> str:
    """Raise TrajectoryError when the curve leaves the limits of an axis anywhere by more than these
    shares of them (of position, velocity, acceleration).

    The message names joint, time (counted from `zero_s` of the curve's own), value and
    limit; of several violations the worst, of position before velocity and acceleration.
    Returns what is to be said of those that are less, the worst of each quantity; "" if none is
    as much as NOTED.
    """
    remarks = []
    bounds = np.array(
        [
            [limits.upper, -limits.lower],
            [limits.velocity, limits.velocity],
            [limits.acceleration, limits.acceleration],
        ]
    )
    with np.errstate(invalid="ignore"):  # inf: no limit
        allowed = bounds + RELATIVE_SLACK * np.abs(bounds)
    value, when = _peaks(_pieces(curve), allowed, ROUNDING)
    for order, quantity in enumerate(("position", "velocity", "acceleration")):
        beyond = np.isfinite(value[order])
        if not beyond.any():
            continue
        over = np.full(beyond.shape, -np.inf)
        bound = bounds[order][beyond]
        over[beyond] = (value[order][beyond] - bound) / np.maximum(np.abs(bound), 1e-9)
        side, joint = np.unravel_index(np.argmax(over), over.shape)
        unit = limits.units[joint] + ("", "/s", "/s²")[order]
        sign = (1, -1)[side]
        worst, allowed = value[order, side, joint] * sign, bounds[order, side, joint]
        limit = f"±{allowed:.6g}"
        if order == 0:
            limit = f"at {('most', 'least')[side]} {allowed * sign:.6g}"
        text = (
            f"joint '{limits.joints[joint]}': {quantity} {worst:.6g} {unit} "
            f"at {when[order, side, joint] - zero_s:.3f} s, allowed {limit} {unit}"
        )
        if over[side, joint] > margins[order] * (1 + RELATIVE_SLACK):
            raise TrajectoryError(text)
        if over[side, joint] < NOTED:
            continue
        remarks.append(f"{text} ({100 * over[side, joint]:.2g} % more)")
    return "; ".join(remarks)


def _pieces(curve: Curve) -> Curve:
    """A curve of a single point has no pieces; it gets one that stands still."""
    if len(curve.times_s) > 1:
        return curve
    return Curve(curve.times_s + np.array([0.0, 1.0]), np.repeat(curve.positions, 2, axis=0))


def _peaks(curve: Curve, floor: Array, rounding: float = 0.0) -> tuple[Array, Array]:
    """Largest values above `floor` [3 derivatives, 2 signs, axes], and their times.

    Sign 0 is the quantity itself, sign 1 its negative. -inf where nothing is above.
    `rounding` is the error of the curve's points, which `floor` is raised by.
    """
    best, when = np.full(floor.shape, -np.inf), np.full(floor.shape, curve.start_s)
    for first in range(0, len(curve.times_s) - 1, CHUNK):
        last = min(first + CHUNK, len(curve.times_s) - 1)
        h, points = curve.bezier(first, last)
        for order in range(3):
            if order:
                points = np.diff(points, axis=0)
                points *= (curve.degree + 1 - order) / h
            for side, hull in enumerate((points.max(axis=(0, 2)), -points.min(axis=(0, 2)))):
                least = np.maximum(floor[order, side], best[order, side])
                axes = np.flatnonzero(hull > least)
                if len(axes) == 0:
                    continue
                signed = points[:, axes] * (1, -1)[side]
                above = least[axes, None] + rounding * amplification(h, order)
                axis, piece = np.nonzero(signed.max(axis=0) > above)
                refine(
                    signed[:, axis, piece],
                    axes[axis],
                    curve.times_s[first + piece],
                    h[piece],
                    above[axis, piece],
                    best[order, side],
                    when[order, side],
                )
    return best, when


def amplification(h: Array, order: int) -> Array:
    """How much errors of a piece's points show in its `order`-th derivative [pieces].

    From the Hermite bases: ends of a quintic that are off by e in opposite directions move
    its velocity by 2·15/8·e/h and its acceleration by 2·10/√3·e/h²; velocities at the ends
    move the acceleration by up to 8·e/h. Cubics are a little better.
    """
    return np.asarray(1.0 + (np.zeros_like(h), 1 + 4 / h, 1 + 8 / h + 12 / (h * h))[order])


def refine(
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
            np.maximum.at(best, axis, value)
            reached = (value == best[axis]) & (value > floor)
            when[axis[reached]] = at[reached]
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
