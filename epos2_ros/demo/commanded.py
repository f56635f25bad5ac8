"""What was commanded: the trajectory in counts, evaluated without the driver's own code.

In Bernstein form, and with the joints' scales read from the parameter file, so that an error in
the driver's curve or units shows up as a path error.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import comb, pi
from typing import Any

import numpy as np
from numpy.typing import NDArray

from epos2_ros.motion.trajectory import Trajectory

Array = NDArray[np.float64]
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
            )
        )
    return result


class Commanded:
    """The curve through a trajectory's points; the axes rest where it begins and ends.

    If its first point has a time_from_start, they rest at its zero and leave then. `zero_s` is
    when that is, on the time axis of `at`.
    """

    def __init__(self, trajectory: Trajectory, zero_s: float = 0.0) -> None:
        times, positions = trajectory.times_s, trajectory.positions
        velocities, accelerations = trajectory.velocities, trajectory.accelerations
        if times[0] > 0:
            times, positions = np.append(0.0, times), np.vstack((positions[:1], positions))
            rest = np.zeros_like(positions[:1])
            velocities = None if velocities is None else np.vstack((rest, velocities))
            accelerations = None if accelerations is None else np.vstack((rest, accelerations))
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

    @property
    def duration_s(self) -> float:
        return float(self._times[-1])

    def at(self, t_s: Array) -> Array:
        """Positions [unit] at times t_s [m] → [m, joints]."""
        t_s = np.clip(t_s, self._times[0], self._times[-1])
        last = len(self._times) - 2
        piece = np.clip(np.searchsorted(self._times, t_s, side="right") - 1, 0, last)
        u = ((t_s - self._times[piece]) / np.diff(self._times)[piece])[:, None]
        n = len(self._points) - 1
        total: Array = sum(
            comb(n, k) * u**k * (1 - u) ** (n - k) * self._points[k, piece] for k in range(n + 1)
        )
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
