"""From a reference curve to PVT records: as few as stay within the tolerance.

Per axis a record ends a segment of 1 … 255 ms at an integer position [qc] and an integer
velocity [drive velocity units]; between the knots the drive interpolates a cubic. The
deviation of the executed curve is checked at every millisecond, which is all the drive
evaluates (maxon, application note "Interpolation Position Mode", 2.1), rounding included.

Some segments are looked ahead (`knots` says how) and one record at a time is committed, so the
first records cost the same whether the reference lasts ten seconds or ten minutes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, inf
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from epos2_ros.errors import ConfigurationError, TrajectoryError
from epos2_ros.motion import knots
from epos2_ros.motion.record import MAX_SEGMENT_MS, Record

_BLOCK = 16384  # positions sampled at once: what they take stays in the cache


class Reference(Protocol):
    """A commanded curve on the path-time grid; it rests from `end_ms` on."""

    @property
    def end_ms(self) -> int: ...

    def positions(self, k: NDArray[np.int64]) -> NDArray[np.float64]:
        """[m] times [ms] → [m, axes] positions [qc]."""


@dataclass(frozen=True)
class FitAxis:
    """What the fitter must know of an axis; the limits are those its drive enforces."""

    velocity_unit_qc_s: float  # one drive velocity unit
    max_velocity_qc_s: float = inf  # 0x607F
    max_acceleration_qc_s2: float = inf  # 0x60C5
    # What this leaves beside any commanded acceleration, or is to be enough without a limit.
    spare_acceleration_qc_s2: float = inf
    # The velocity in a record is none or at least this; 0: any whole drive velocity unit.
    least_velocity_qc_s: float = 0.0


class Fitter:
    """Turns a reference into records, axis by axis, on demand.

    `smoothness` weighs fewest records against how well the commanded acceleration is kept: it is
    the number of records given for the mean square of the deviation's acceleration to be lower
    by (1000 tolerances/s²)² during a second. At 0 it decides between ends that get equally far.
    """

    def __init__(
        self,
        axes: Sequence[FitAxis],
        tolerance_qc: float = 1.0,
        max_segment_ms: int = MAX_SEGMENT_MS,
        smoothness: float = 0.0,
    ) -> None:
        if not 0.5 <= tolerance_qc < inf:
            raise ConfigurationError(
                f"tolerance is {tolerance_qc:g} qc; positions are whole counts, "
                "so it must be at least 0.5 qc"
            )
        if not 1 <= max_segment_ms <= MAX_SEGMENT_MS:
            raise ConfigurationError(
                f"longest segment is {max_segment_ms} ms; allowed are 1 … {MAX_SEGMENT_MS} ms"
            )
        if not 0 <= smoothness < inf:
            raise ConfigurationError(f"smoothness is {smoothness:g}; it must be at least 0")
        self._tolerance_qc = tolerance_qc
        self._max_segment_ms = max_segment_ms
        self._aims = [
            knots.vector(
                (
                    axis.velocity_unit_qc_s * 1e-3,
                    tolerance_qc,
                    axis.max_velocity_qc_s * 1e-3,
                    axis.max_acceleration_qc_s2 * 1e-6,
                    max(smoothness, 1e-6),
                    max_segment_ms,
                    min(axis.spare_acceleration_qc_s2 * 1e-6, 1e9),
                    _whole(axis.least_velocity_qc_s, axis.velocity_unit_qc_s) * 1e-3,
                )
            )
            for axis in axes
        ]
        self._samples: _Samples | None = None
        self._plans: list[knots.Vector] = []
        self._ended: list[bool] = []

    @property
    def max_segment_ms(self) -> int:
        """Longest segment [ms] of what is committed from now on."""
        return self._max_segment_ms

    @max_segment_ms.setter
    def max_segment_ms(self, longest: int) -> None:
        self._max_segment_ms = longest
        for aims in self._aims:
            aims[5] = longest

    def begin(self, reference: Reference, positions_qc: Sequence[int], at_ms: int = 0) -> None:
        """A new motion; every axis still rests at `positions_qc` at path time `at_ms`.

        Waits for `knots.prepare`, if that has not been called before.
        """
        knots.prepare()
        self._plans = [knots.plan_from_rest(position, at_ms) for position in positions_qc]
        self._ended = [False for _ in positions_qc]
        self.replace(reference)

    def replace(self, reference: Reference) -> None:
        """Go on along `reference`, which is the old one up to every axis' committed knot."""
        if any(self._ended):
            raise ValueError("an axis' end record is committed; begin a new motion")
        for plan in self._plans:
            knots.forget(plan)
        self._samples = _Samples(reference, len(self._plans))

    def committed_ms(self, axis: int) -> int:
        """Path time of the axis' last committed knot."""
        return int(self._plans[axis][0])

    def off_qc(self, axis: int) -> float:
        """How far from the reference the segment to the axis' last committed knot gets [qc].

        More than the tolerance only where no segment keeps that and the drive's limits: by half a
        count at most for rounding, or half of what the commanded curve jumps within 1 ms.
        """
        return float(self._plans[axis][knots.OFF])

    def next(self, axis: int) -> Record | None:
        """Commit the axis' next record; `Record(p, 0, 0)` ends the motion, then None.

        TrajectoryError when no segment keeps tolerance and limits; `off_qc` says where one was
        taken that does not keep the tolerance.
        """
        samples, plan = self._samples, self._plans[axis]
        if samples is None or self._ended[axis]:
            return None
        k = int(plan[0])
        looked_at = k + knots.looked_at(self.max_segment_ms)
        if looked_at > samples.last_ms:
            earliest = min(int(plan[0]) for plan in self._plans)
            further = 4 if samples.last_ms < 0 else 12  # longest segments; the first are urgent
            samples.extend(earliest, looked_at + further * self.max_segment_ms)
        positions, bends = samples.paths[axis]
        time = knots.advance(
            positions, bends, samples.first_ms, samples.end_ms, self._aims[axis], plan
        )
        if time < 0:
            self._ended[axis] = True
            return Record(int(plan[1]), 0, 0)
        if time == 0:
            raise TrajectoryError(
                f"no segment from {k} ms on stays within {self._tolerance_qc:g} qc "
                "and the drive's velocity and acceleration limits"
            )
        return Record(int(plan[1]), int(plan[2]), time)


def _whole(velocity_qc_s: float, unit_qc_s: float) -> float:
    """The least whole number of units that is not less [qc/s]."""
    return ceil(velocity_qc_s / unit_qc_s - 1e-9) * unit_qc_s


class _Samples:
    """A reference on the path-time grid, from the earliest committed knot to what is looked at."""

    def __init__(self, reference: Reference, axes: int) -> None:
        self.end_ms = reference.end_ms
        self.first_ms = 0
        self.last_ms = -1
        self.paths: list[tuple[knots.Vector, knots.Vector]] = []
        self._reference = reference
        self._positions = np.empty((axes, 0))  # [axes, times] [qc]
        self._block = 1 + _BLOCK // max(axes, 1)

    def extend(self, earliest_ms: int, last_ms: int) -> None:
        """Sample up to `last_ms` and forget what is before `earliest_ms`."""
        known = self._positions[:, earliest_ms - self.first_ms :]
        positions = np.empty((known.shape[0], last_ms + 1 - earliest_ms))
        have = known.shape[1]
        positions[:, :have] = known
        moving = min(max(have, self.end_ms + 1 - earliest_ms, 1), positions.shape[1])
        for at in range(have, moving, self._block):
            k = np.arange(at, min(at + self._block, moving))
            positions[:, k[0] : k[-1] + 1] = self._reference.positions(k + earliest_ms).T
        positions[:, moving:] = positions[:, moving - 1 : moving]
        self._positions = positions
        self.first_ms, self.last_ms = earliest_ms, last_ms
        vectors = [knots.vector(own) for own in positions]
        self.paths = [(vector, knots.bends_of(vector)) for vector in vectors]
