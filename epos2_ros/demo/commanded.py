"""What was commanded: the trajectory in counts, evaluated without the driver's own code.

In Bernstein form, and with the joints' scales read from the parameter file, so that an error in
the driver's curve or units shows up as a path error.

Where the polynomial between two points exceeds a limit of its joint, the driver takes another curve
(docs/motion.md). Which one is its own choice: right is whatever passes the points, with their
velocities if they have any, and is nowhere further beyond the limits than the margins said there.
So instead of one position there is a range then, within which every such curve is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import comb, pi
from typing import Any

import numpy as np
from numpy.typing import NDArray

from epos2_ros.motion.trajectory import Trajectory

Array = NDArray[np.float64]
# What docs/motion.md allows beyond max_velocity and max_acceleration, as shares of them.
MARGINS = (0.04, 0.2)
_SAMPLES = 65  # of a piece
HOLD_S = 0.001  # a trajectory's zero after the start SYNC: the first record only holds the position


@dataclass(frozen=True)
class Scale:
    """One joint, its drive, and its counts: qc = (position − offset)·qc_per_unit."""

    joint: str
    node_id: int
    drive: str
    unit: str  # "rad" or "m"
    qc_per_unit: float
    offset: float  # [unit]
    max_velocity: float = np.inf  # [unit/s]
    max_acceleration: float = np.inf  # [unit/s²]

    def to_qc(self, position: Array) -> Array:
        return (position - self.offset) * self.qc_per_unit


def scales(parameters: Mapping[str, Any]) -> list[Scale]:
    """The joints of a parameter file, with the driver's defaults where it says nothing."""
    result = []
    joints = parameters.get("joints", [f"joint_{n}" for n in range(1, 7)])
    for place, joint in enumerate(joints, start=1):

        def value(name: str, default: Any, joint: str = joint) -> Any:
            return parameters.get(f"axes.{joint}.{name}", default)

        prismatic = value("type", "revolute") == "prismatic"
        turns_per_unit = value("gear_ratio", 1.0) / (value("lead", 0.0) if prismatic else 2 * pi)
        result.append(
            Scale(
                joint=joint,
                node_id=value("node_id", place),
                drive=value("drive", "epos2"),
                unit="m" if prismatic else "rad",
                qc_per_unit=value("direction", 1) * value("counts_per_turn", 2000) * turns_per_unit,
                offset=value("offset", 0.0),
                max_velocity=value("max_velocity", np.inf),
                max_acceleration=value("max_acceleration", np.inf),
            )
        )
    return result


class Commanded:
    """The curve through a trajectory's points; the axes rest where it begins and ends.

    If its first point has a time_from_start, they rest at its zero and leave then. `zero_s` is
    when that is, on the time axis of `at`. Joints of which no limits are given have none.
    """

    def __init__(
        self, trajectory: Trajectory, zero_s: float = 0.0, scales: Sequence[Scale] = ()
    ) -> None:
        times, positions = trajectory.times_s, trajectory.positions
        velocities, accelerations = trajectory.velocities, trajectory.accelerations
        if times[0] > 0:
            times, positions = np.append(0.0, times), np.vstack((positions[:1], positions))
            rest = np.zeros_like(positions[:1])
            velocities = None if velocities is None else np.vstack((rest, velocities))
            accelerations = None if accelerations is None else np.vstack((rest, accelerations))
        self._passes = velocities
        if velocities is None:
            velocities = _shape_preserving(times, positions)
        self._times = times + zero_s
        h = np.diff(times)[:, None]
        p0, p1, v0, v1 = positions[:-1], positions[1:], velocities[:-1], velocities[1:]
        if accelerations is None:
            points = [p0, p0 + h * v0 / 3, p1 - h * v1 / 3, p1]
        else:
            bend0, bend1 = h**2 * accelerations[:-1] / 20, h**2 * accelerations[1:] / 20
            points = [
                *(p0, p0 + h * v0 / 5, p0 + 2 * h * v0 / 5 + bend0),
                *(p1 - 2 * h * v1 / 5 + bend1, p1 - h * v1 / 5, p1),
            ]
        self._points = np.array(points)  # [degree + 1, pieces, joints]
        by_joint = {scale.joint: (scale.max_velocity, scale.max_acceleration) for scale in scales}
        none = np.inf, np.inf
        self._limits = np.array([by_joint.get(j, none) for j in trajectory.joint_names]).T
        self._free = self._exceeds()
        if self._passes is None:  # the driver may have chosen other velocities at all of them
            self._free |= self._free.any(axis=0)

    @property
    def duration_s(self) -> float:
        return float(self._times[-1])

    def at(self, t_s: Array) -> Array:
        """Positions [unit] at times t_s [m] → [m, joints]."""
        piece, since_s = self._pieces(t_s)
        return _bernstein(self._points[:, piece], since_s / np.diff(self._times)[piece, None])

    def between(self, t_s: Array) -> tuple[Array, Array]:
        """Least and greatest position [unit] that is right at times t_s [m] → [m, joints] each.

        `at`, or what can be reached between two points where the driver had to choose a curve.
        """
        piece, since_s = self._pieces(t_s)
        left_s = np.diff(self._times)[piece, None] - since_s
        p0, p1 = self._points[0, piece], self._points[-1, piece]
        v0 = v1 = None
        if self._passes is not None:
            v0, v1 = self._passes[piece], -self._passes[piece + 1]  # the latter backward in time
        up0, down0 = self._reach(since_s, v0)
        up1, down1 = self._reach(left_s, v1)
        free, exact = self._free[piece], self.at(t_s)
        low = np.where(free, np.maximum(p0 + down0, p1 + down1), exact)
        high = np.where(free, np.minimum(p0 + up0, p1 + up1), exact)
        return low, high

    def _pieces(self, t_s: Array) -> tuple[NDArray[np.intp], Array]:
        """In which pieces times [m] are, and how long after they begin [m, 1] [s]."""
        t_s = np.clip(t_s, self._times[0], self._times[-1])
        last = len(self._times) - 2
        piece = np.clip(np.searchsorted(self._times, t_s, side="right") - 1, 0, last)
        return piece, (t_s - self._times[piece])[:, None]

    def _exceeds(self) -> NDArray[np.bool_]:
        """In which pieces the polynomials exceed limits [pieces, joints]."""
        u = np.linspace(0, 1, _SAMPLES)[:, None, None]
        result = np.zeros(self._points.shape[1:], dtype=bool)
        points, h = self._points, np.diff(self._times)[:, None]
        for limit in self._limits:
            points = np.diff(points, axis=0) * (len(points) - 1) / h
            value = np.abs(_bernstein(points, u))
            # The peak of a parabola through the largest sample and its neighbours.
            before, here, after = value[:-2], value[1:-1], value[2:]
            bend = np.maximum(2 * here - before - after, 1e-300)
            inner = (here >= before) & (here >= after)
            peak = np.where(inner, here + (after - before) ** 2 / (8 * bend), 0.0)
            result |= np.maximum(value.max(axis=0), peak.max(axis=0)) > limit * (1 + 1e-6)
        return result

    def _reach(self, t_s: Array, velocity: Array | None) -> tuple[Array, Array]:
        """How far up and down a joint can get in times [m, 1] from velocities [m, joints] or, if
        these are unknown, any: with the limits and the margins beyond them [m, joints]."""
        fastest, steepest = self._limits * (1 + np.array(MARGINS))[:, None]
        if velocity is None:
            return fastest * t_s, -fastest * t_s

        def up(velocity: Array) -> Array:
            ramp_s = np.fmin(np.maximum(fastest - velocity, 0) / steepest, t_s)
            ramp = velocity * ramp_s + np.where(ramp_s > 0, steepest * ramp_s**2 / 2, 0.0)
            return ramp + np.where(ramp_s < t_s, fastest * (t_s - ramp_s), 0.0)

        with np.errstate(invalid="ignore"):  # no limit of acceleration: no ramp
            return up(velocity), -up(-velocity)


def _bernstein(points: Array, u: Array) -> Array:
    """Polynomials by their control points [degree + 1, …] at u = 0 … 1."""
    n = len(points) - 1
    total: Array = sum(comb(n, k) * u**k * (1 - u) ** (n - k) * points[k] for k in range(n + 1))
    return total


def _shape_preserving(times: Array, positions: Array) -> Array:
    """Velocities for points that have none: no overshoot, at rest at both ends.

    Fritsch and Butland, "A method for constructing local monotone piecewise cubic
    interpolants", 1984: between secants of one sign a weighted harmonic mean, else 0.
    """
    velocities = np.zeros_like(positions)
    h = np.diff(times)
    secants = np.diff(positions, axis=0) / h[:, None]
    for i in range(1, len(times) - 1):
        left, right = 2 * h[i] + h[i - 1], h[i] + 2 * h[i - 1]
        for joint in range(positions.shape[1]):
            before, after = secants[i - 1, joint], secants[i, joint]
            if before * after > 0:
                velocities[i, joint] = (left + right) / (left / before + right / after)
    return velocities
