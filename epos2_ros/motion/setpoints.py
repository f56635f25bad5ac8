"""From a reference curve to set-points of profile position mode, for a drive without a buffer.

Such a drive has one set-point active and one queued behind it (Nanotec, "CL3-E CANopen/USB
Technical Manual", chapter "Profile Position"). If the queued one came with "change on set-point"
(bit 9 of the controlword), the active target is passed at its profile velocity, and the next one
begins there. So what a drive executes of a set-point is a ramp from the velocity at which it begins
to its own profile velocity, by its acceleration or deceleration, then that velocity up to its
target; or, where the next does not come with bit 9, a ramp to rest at the target.

* The end velocity (0x6082) stays 0: a drive that gets no further set-point brakes to its target by
  itself. So every target can be reached with braking from the velocity at which its set-point
  begins, and the drive does not begin to brake for one that it is to pass before its host had
  `feeding_ms` to queue the next.
* READING: a drive looks once a millisecond where it is, and begins the next set-point in the first
  cycle at or after the target, from where it is then ("Precision loss with relative movements"
  says so of relative moves). Targets are passed in the middle of a millisecond, where that can be.
* READING: to a lower profile velocity a drive comes by its deceleration (CiA 402).
* Ramps are not limited in jerk (0x6086 is 0): no document says what a drive does with a set-point
  that is changed while its acceleration still rises.

Whole units of the drive make durations that are known exactly: the next set-point is always chosen
from where the drive will really be, and nothing accumulates.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import floor, inf
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from epos2_ros.motion import setpoint_search as search
from epos2_ros.motion.fit import Reference
from epos2_ros.motion.pvt import Executed

FEEDING_MS = 70
"""A host needs at most so long from a set-point's begin until the next one is queued, also where it
hears of the first only because it asks."""


LONGEST_MS = 400
_STOOD_MS = 1 << 16  # looked at in one piece


class SetPoint(NamedTuple):
    """What a drive is told, in its units, and when it does it; path times are whole milliseconds.

    One that begins later than the one before ended finds the drive at rest: it is started by the
    SYNC at that time, as the first is. All others are queued.
    """

    begin_ms: int
    end_ms: int  # from here on it has passed its target, or rests there
    target_qc: int  # 0x607A
    velocity: int  # 0x6081
    acceleration: int  # 0x6083
    deceleration: int  # 0x6084
    passes: bool  # its target is not braked for: the next is queued with bit 9


@dataclass(frozen=True)
class SetPointAxis:
    """What the fitter must know of an axis. A limit is kept by whole units, at least by one."""

    velocity_unit_qc_s: float
    acceleration_unit_qc_s2: float
    max_velocity_qc_s: float
    max_acceleration_qc_s2: float  # of all ramps
    feeding_ms: int = FEEDING_MS
    sync_ms: float = 100.0  # where the drive stands, set-points begin at multiples of it


class SetPointFitter:
    """Turns one axis of a reference into set-points, on demand, one ahead of the active one."""

    def __init__(self, axis: SetPointAxis, column: int, longest_ms: int = LONGEST_MS) -> None:
        """`column` is the axis' place in references; set-points last about `longest_ms` at most."""
        self.axis = axis
        self.column = column
        self.longest_ms = longest_ms
        self.due_ms = -inf
        """Path time from which on `next` may be called: the drive's queue is free from then on."""
        self.error_qc = 0.0
        """Largest distance from the commanded curve at every millisecond of what is committed."""
        self.ended = False
        """Whether `next` has found that there is no further set-point."""
        self._reference: Reference | None = None
        self._state = search.state_at_rest(0.0, axis.feeding_ms)
        self._plan = search.no_plan()
        self._samples: NDArray[np.float64] = np.empty(0)  # commanded positions [qc]
        self._first_ms = 0  # where they begin
        search.prepare()

    def begin(self, reference: Reference, position_qc: int) -> None:
        """A new motion from rest at `position_qc`; path time 0 is its start SYNC."""
        self._state = search.state_at_rest(float(position_qc), self.axis.feeding_ms)
        self._plan = search.no_plan()
        self.due_ms, self.error_qc, self.ended = -inf, 0.0, False
        self.replace(reference)

    def replace(self, reference: Reference) -> None:
        """Go on along `reference`, which is the old one up to the end of what is committed."""
        if self.ended:
            raise ValueError("the end of the motion is committed; begin a new one")
        self._reference = reference
        self._samples = np.empty(0)

    @property
    def committed_ms(self) -> int:
        """Path time at which the last committed set-point ends, or up to which the axis stands."""
        return int(self._state[0])

    def next(self, path_ms: float = -inf) -> SetPoint | None:
        """Commit the next set-point, at a path time; −inf before the start.

        None after the last, and where none begins soon: the axis stands until `due_ms`, at least.
        """
        reference = self._reference
        if reference is None or self.ended:
            return None
        if self._state[2] == 0 and path_ms + self.axis.feeding_ms > self.committed_ms:
            self._stand(reference, max(self.committed_ms, floor(path_ms)))
            self._state[3] = max(self._state[3], path_ms + self.axis.feeding_ms)
        begin_ms, position, velocity = self.committed_ms, self._state[1], self._state[2]
        commanded = self._sample(reference, begin_ms + search.horizon_ms(self.longest_ms))
        aims, plan = self._aims(), self._plan
        match search.find(commanded, reference.end_ms - begin_ms, aims, self._state, plan):
            case search.NEXT:
                error_qc = search.astray(commanded, begin_ms, position, velocity, aims, plan)
                self.error_qc = max(self.error_qc, error_qc)
                self.due_ms = plan[1]
                begin, end, target, velocity, up, down = (int(x) for x in plan[1:7])
                return SetPoint(begin, end, target, velocity, up, down, bool(plan[7]))
            case search.ENDED:
                self._stand(reference, max(begin_ms, reference.end_ms))
                self.ended, self.due_ms = True, inf
            case _:
                self.due_ms = max(float(begin_ms), path_ms) + self.axis.sync_ms
        return None

    def _stand(self, reference: Reference, until_ms: int) -> None:
        """The axis stands where it is until then."""
        commanded = self._sample(reference, until_ms)
        stood = np.asarray(commanded)[: until_ms - self.committed_ms + 1]
        self.error_qc = max(self.error_qc, float(np.abs(stood - self._state[1]).max()))
        self._state[0] = until_ms

    def _aims(self) -> search.Vector:
        axis = self.axis
        velocity, rate = axis.velocity_unit_qc_s, axis.acceleration_unit_qc_s2
        return search.vector(
            (
                velocity * 1e-3,
                rate * 1e-6,
                max(1, floor(axis.max_velocity_qc_s / velocity + 1e-9)),
                max(1, floor(axis.max_acceleration_qc_s2 / rate + 1e-9)),
                axis.feeding_ms,
                axis.sync_ms,
                self.longest_ms,
            )
        )

    def _sample(self, reference: Reference, last_ms: int) -> search.Vector:
        """The commanded curve from what is committed to `last_ms` at least."""
        known = self._samples[self.committed_ms - self._first_ms :]
        k = np.arange(self.committed_ms + len(known), last_ms + 1)
        if len(k):
            known = np.concatenate((known, reference.positions(k)[:, self.column]))
        self._samples, self._first_ms = known, self.committed_ms
        return search.vector(known)


def executed(
    start_qc: int, points: Sequence[SetPoint], axis: SetPointAxis
) -> Iterator[tuple[int, Executed]]:
    """What a drive standing at `start_qc` makes of `points`, at every millisecond.

    One set-point after the other, and what it stands before it: the path time at which that begins
    and the curve from there to its end. Where it ends the acceleration is that before.
    """
    velocity_unit, rate_unit = axis.velocity_unit_qc_s * 1e-3, axis.acceleration_unit_qc_s2 * 1e-6
    now_ms, position, speed = 0, float(start_qc), 0.0  # signed [qc/ms]
    for point in points:
        while now_ms < point.begin_ms:
            until_ms = min(now_ms + _STOOD_MS, point.begin_ms)
            still = np.zeros(until_ms - now_ms + 1)
            yield now_ms, Executed(still + position, still, still)
            now_ms = until_ms
        sign = 1.0 if point.target_qc > position else -1.0
        of = search.shape(
            abs(point.target_qc - position),
            speed * sign,
            point.velocity * velocity_unit,
            point.acceleration * rate_unit,
            point.deceleration * rate_unit,
            float(point.passes),
        )
        t = np.arange(point.end_ms - point.begin_ms + 1.0)
        if not point.passes:
            t = np.minimum(t, of.duration)
        ramped = np.minimum(t, of.ramp)
        braked = np.maximum(t - of.brakes, 0.0) if of.braking else np.zeros(len(t))
        way = of.speed * ramped + of.rate * ramped**2 / 2
        way += of.top * (t - ramped) - of.braking * braked**2 / 2
        velocity = of.speed + of.rate * ramped - of.braking * braked
        rate = np.where(t <= of.ramp, of.rate, np.where(braked > 0.0, -of.braking, 0.0))
        yield (
            point.begin_ms,
            Executed(position + sign * way, sign * velocity * 1e3, sign * rate * 1e6),
        )
        now_ms, position = point.end_ms, float(position + sign * way[-1])
        speed = float(sign * of.top) if point.passes else 0.0
        position = position if point.passes else float(point.target_qc)
