"""From a reference curve to PVT records: as few as stay within the tolerance.

Per axis a record ends a segment of 1 … 255 ms at an integer position [qc] and an integer
velocity [drive velocity units]; between the knots the drive interpolates a cubic. The
deviation of the executed curve is checked at every millisecond, which is all the drive
evaluates (maxon, application note "Interpolation Position Mode", 2.1), rounding included.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from epos2_ros.errors import ConfigurationError, TrajectoryError
from epos2_ros.motion.pvt import Cubic
from epos2_ros.motion.record import MAX_SEGMENT_MS, Record


class Reference(Protocol):
    """A commanded curve on the path-time grid; it rests from `end_ms` on."""

    @property
    def end_ms(self) -> int: ...

    def positions(self, k: NDArray[np.int64]) -> NDArray[np.float64]:
        """[m] times [ms] → [m, axes] positions [qc]."""

    def velocities(self, k: NDArray[np.int64]) -> NDArray[np.float64]:
        """[m] times [ms] → [m, axes] velocities [qc/s]."""


@dataclass(frozen=True)
class FitAxis:
    """What the fitter must know of an axis; the limits are those its drive enforces."""

    velocity_unit_qc_s: float  # one drive velocity unit
    max_velocity_qc_s: float = inf  # 0x607F
    max_acceleration_qc_s2: float = inf  # 0x60C5


@dataclass
class _Knot:
    """Where an axis' committed records end."""

    k: int  # path time [ms]
    position: int
    velocity: int
    ended: bool = False
    segments: int = 0


class Fitter:
    """Turns a reference into records, axis by axis, on demand."""

    def __init__(
        self,
        axes: Sequence[FitAxis],
        tolerance_qc: float = 1.0,
        max_segment_ms: int = MAX_SEGMENT_MS,
        smoothness: float = 0.0,
    ) -> None:
        if not tolerance_qc >= 0.5:
            raise ConfigurationError(
                f"tolerance is {tolerance_qc:g} qc; positions are whole counts, "
                "so it must be at least 0.5 qc"
            )
        if not 1 <= max_segment_ms <= MAX_SEGMENT_MS:
            raise ConfigurationError(
                f"longest segment is {max_segment_ms} ms; allowed are 1 … {MAX_SEGMENT_MS} ms"
            )
        self._axes = tuple(axes)
        self._tolerance = tolerance_qc
        self.max_segment_ms = max_segment_ms
        self._reference: Reference | None = None
        self._knots: list[_Knot] = []

    def begin(self, reference: Reference, positions_qc: Sequence[int]) -> None:
        """A new motion; every axis rests at `positions_qc` at path time 0."""
        self._knots = [_Knot(0, int(p), 0) for p in positions_qc]
        self._reference = reference

    def replace(self, reference: Reference) -> None:
        """Go on along `reference`, which is the old one up to every axis' committed knot."""
        if any(knot.ended for knot in self._knots):
            raise ValueError("an axis' end record is committed; begin a new motion")
        self._reference = reference

    def committed_ms(self, axis: int) -> int:
        """Path time of the axis' last committed knot."""
        return self._knots[axis].k

    def next(self, axis: int) -> Record | None:
        """Commit the axis' next record; `Record(p, 0, 0)` ends the motion, then None."""
        knot, reference = self._knots[axis], self._reference
        if reference is None or knot.ended:
            return None
        if knot.k >= reference.end_ms:
            knot.ended = True
            return Record(knot.position, 0, 0)
        record = self._longest(axis, knot, reference)
        knot.k += record.time
        knot.position, knot.velocity = record.position, record.velocity
        knot.segments += 1
        return record

    def _longest(self, axis: int, knot: _Knot, reference: Reference) -> Record:
        """The longest segment from `knot` that keeps tolerance and limits."""
        limits = self._axes[axis]
        unit = limits.velocity_unit_qc_s
        left = reference.end_ms - knot.k
        longest = min(self.max_segment_ms, left)
        if knot.segments < 2:  # three segments: two records besides the one in execution
            longest = min(longest, max(1, (left - 1) // (2 - knot.segments)))
        grid = knot.k + np.arange(longest + 1)
        p = reference.positions(grid)[:, axis] - knot.position
        v = reference.velocities(grid)[:, axis]
        trials = [longest]
        while trials[-1] > 1:
            trials.append(trials[-1] * 7 // 8)
        for time in trials:
            final = time == left
            base = np.array([round(p[time] + knot.position) - knot.position])
            speed = np.zeros(1) if final else np.round(v[time] / unit) + np.arange(-1, 2)
            if not final:
                base = base[0] + np.arange(-1, 2)
            position, velocity = (x.ravel() for x in np.meshgrid(base, speed))
            duration = time * 1e-3
            cubic = Cubic.between(0.0, knot.velocity * unit, position, velocity * unit, duration)
            t = (np.arange(1, time + 1) - time)[:, None] * 1e-3
            error = np.max(np.abs(cubic.position(t) - p[1 : time + 1, None]), axis=0)
            top_v, top_a = cubic.extremes(np.full(len(position), duration))
            good = (
                (error <= self._tolerance)
                & (top_v <= limits.max_velocity_qc_s)
                & (top_a <= limits.max_acceleration_qc_s2)
            )
            if np.any(good):
                best = int(np.argmin(np.where(good, error, inf)))
                return Record(knot.position + int(position[best]), int(velocity[best]), time)
        raise TrajectoryError(
            f"axis {axis}: no segment from {knot.k} ms on stays within {self._tolerance:g} qc "
            "and the drive's velocity and acceleration limits"
        )
