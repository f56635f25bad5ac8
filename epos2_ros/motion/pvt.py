"""The curve a drive executes when it is given PVT records.

Every segment is the one cubic with position and velocity given at both ends. With t
counted from the segment's *end* (so −T ≤ t ≤ 0) it is

    P(t) = a·t³ + b·t² + c·t + d,  V(t) = 3a·t² + 2b·t + c,  A(t) = 6a·t + 2b
    d = P[n]
    c = V[n]
    b = (3·(P[n−1] − P[n]) + T·(V[n−1] + 2·V[n])) / T²
    a = (2·(P[n−1] − P[n]) + T·(V[n−1] + V[n])) / T³

Source: maxon, application note "Interpolation Position Mode", 2.3. The note prints a and
b with the indices n and n−1 swapped against c and d; put in as printed the cubic does not
pass through P[n−1]. The drive evaluates it at 1 kHz, so whole milliseconds are all there is.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from epos2_ros.motion.record import Record

FloatArray = NDArray[np.floating]


class Cubic(NamedTuple):
    """Coefficients for t in seconds from the segment's end; floats, or arrays of one shape."""

    a: FloatArray
    b: FloatArray
    c: FloatArray
    d: FloatArray

    @classmethod
    def between(
        cls,
        p0_qc: ArrayLike,
        v0_qc_s: ArrayLike,
        p1_qc: ArrayLike,
        v1_qc_s: ArrayLike,
        duration_s: ArrayLike,
    ) -> Cubic:
        """The segment from (p0, v0) to (p1, v1); arguments broadcast together."""
        p0, v0, p1, v1, t = (
            np.asarray(x, dtype=float) for x in (p0_qc, v0_qc_s, p1_qc, v1_qc_s, duration_s)
        )
        a = (2 * (p0 - p1) + t * (v0 + v1)) / t**3
        b = (3 * (p0 - p1) + t * (v0 + 2 * v1)) / t**2
        return cls(a, b, v1, p1)

    def position(self, t_s: FloatArray) -> FloatArray:
        return ((self.a * t_s + self.b) * t_s + self.c) * t_s + self.d

    def velocity(self, t_s: FloatArray) -> FloatArray:
        return (3 * self.a * t_s + 2 * self.b) * t_s + self.c

    def acceleration(self, t_s: FloatArray) -> FloatArray:
        return 6 * self.a * t_s + 2 * self.b

    def extremes(self, duration_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Largest |velocity| [qc/s] and |acceleration| [qc/s²] anywhere on the segment."""
        start = -np.asarray(duration_s, dtype=float)
        acceleration = np.maximum(np.abs(2 * self.b), np.abs(self.acceleration(start)))
        velocity = np.maximum(np.abs(self.c), np.abs(self.velocity(start)))
        with np.errstate(divide="ignore", invalid="ignore"):
            turn = -self.b / (3 * self.a)  # where the acceleration is zero
            inside = (turn > start) & (turn < 0)
            top = np.where(inside, np.abs(self.velocity(turn)), 0.0)
        return np.maximum(velocity, top), acceleration


class Executed(NamedTuple):
    """The executed curve at k = 0 … end [ms], three arrays of end + 1 values.

    At a knot the acceleration is that of the segment ending there.
    """

    position_qc: FloatArray
    velocity_qc_s: FloatArray
    acceleration_qc_s2: FloatArray


def segments(
    start_qc: int, records: Sequence[Record], velocity_unit_qc_s: float, start_velocity: int = 0
) -> tuple[Cubic, NDArray[np.int64]]:
    """The cubics of `records` and their durations [ms].

    The first segment starts at `start_qc` with `start_velocity` [velocity units]; a record
    with time 0 ends the motion and whatever follows it is an error of the caller's.
    """
    rows = [(start_qc, start_velocity, 0), *(r for r in records if r.time > 0)]
    position, velocity, time = np.array(rows, dtype=np.int64).T
    speed = velocity * velocity_unit_qc_s
    # Subtracting the start keeps the cubic's arithmetic exact for any int32 position.
    cubic = Cubic.between(position[:-1] - position[1:], speed[:-1], 0.0, speed[1:], time[1:] * 1e-3)
    return cubic._replace(d=position[1:].astype(float)), time[1:]


def executed(
    start_qc: int, records: Sequence[Record], velocity_unit_qc_s: float, start_velocity: int = 0
) -> Executed:
    """What a drive standing at `start_qc` makes of `records`, at every millisecond."""
    cubic, time = segments(start_qc, records, velocity_unit_qc_s, start_velocity)
    if len(time) == 0:
        return Executed(
            np.array([float(start_qc)]),
            np.array([start_velocity * velocity_unit_qc_s]),
            np.zeros(1),
        )
    end = np.cumsum(time)
    k = np.arange(end[-1] + 1)
    index = np.searchsorted(end, k)  # the segment that ends at or after k
    t = (k - end[index]) * 1e-3
    at = Cubic(*(coefficient[index] for coefficient in cubic))
    return Executed(at.position(t), at.velocity(t), at.acceleration(t))
