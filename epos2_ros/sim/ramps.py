"""Point-to-point profiles with limits of acceleration and, if asked for, of jerk, and end velocity.

The four jerks are those of CiA 402's object 0x60A4: at the beginning and at the end of the
acceleration, at the beginning and at the end of the deceleration; `math.inf` is no limit. Any unit
of position and time. READING: how a drive gets from one profile to another while it accelerates no
document says; here the acceleration first goes to zero within the jerk limit, then the new profile
begins.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from typing import NamedTuple


class Limits(NamedTuple):
    """What a profile keeps; all are positive."""

    velocity: float
    acceleration: float
    deceleration: float
    jerks: tuple[float, float, float, float] = (math.inf,) * 4


class State(NamedTuple):
    """Where the demand is."""

    position: float
    velocity: float
    acceleration: float


class _Phase(NamedTuple):
    """Constant jerk; `start` has the acceleration it begins with, which may be a step."""

    begins: float
    start: State
    jerk: float

    def at(self, t: float) -> State:
        x, v, a = self.start
        j = self.jerk
        return State(x + t * (v + t * (a / 2 + t * j / 6)), v + t * (a + t * j / 2), a + t * j)


class Profile:
    """Phases one after the other, then on at the velocity they lead to."""

    def __init__(self, start: State) -> None:
        self.duration = 0.0
        self.end = start
        self._phases: list[_Phase] = []

    def add(self, duration: float, acceleration: float, jerk: float = 0.0) -> None:
        """A phase that begins with `acceleration`."""
        if duration <= 0.0:
            return
        start = State(self.end.position, self.end.velocity, acceleration)
        phase = _Phase(self.duration, start, jerk)
        self._phases.append(phase)
        self.duration += duration
        self.end = phase.at(duration)

    def ramp(self, velocity: float, rate: float, begin: float, end: float) -> None:
        """From the present velocity, at acceleration zero, to another."""
        change = velocity - self.end.velocity
        sign, slopes = math.copysign(1.0, change), 1 / begin + 1 / end
        peak = rate if not slopes else min(rate, math.sqrt(2 * abs(change) / slopes))
        if not change:
            return
        rise, fall = peak / begin, peak / end
        self.add(rise, 0.0, sign * begin if rise else 0.0)
        self.add(abs(change) / peak - (rise + fall) / 2, sign * peak)
        self.add(fall, sign * peak, -sign * end if fall else 0.0)
        self.end = State(self.end.position, velocity, 0.0)

    def finish(self, position: float, velocity: float) -> Profile:
        """Exactly there, without what rounding has left."""
        self.end = State(position, velocity, 0.0)
        return self

    def at(self, t: float) -> State:
        if t >= self.duration:
            past = t - self.duration
            return self.end._replace(position=self.end.position + past * self.end.velocity)
        place = bisect_right(self._phases, t, key=lambda phase: phase.begins) - 1
        return self._phases[place].at(t - self._phases[place].begins)


def _settled(start: State, limits: Limits) -> Profile:
    """The acceleration has gone to zero."""
    profile = Profile(start)
    a = start.acceleration
    if a:
        jerk = limits.jerks[1] if a * start.velocity >= 0 else limits.jerks[3]
        profile.add(abs(a) / jerk, a, -math.copysign(jerk, a) if jerk < math.inf else 0.0)
        profile.end = profile.end._replace(acceleration=0.0)
    return profile


def _change(profile: Profile, velocity: float, limits: Limits) -> None:
    """A ramp in one direction, up or down."""
    first, second, third, fourth = limits.jerks
    if abs(velocity) > abs(profile.end.velocity):
        profile.ramp(velocity, limits.acceleration, first, second)
    else:
        profile.ramp(velocity, limits.deceleration, third, fourth)


def _way(start: float, velocity: float, limits: Limits) -> float:
    """How far a ramp goes."""
    profile = Profile(State(0.0, start, 0.0))
    _change(profile, velocity, limits)
    return profile.end.position


def stop(start: State, limits: Limits) -> Profile:
    """To rest as soon as the limits allow."""
    profile = _settled(start, limits)
    _change(profile, 0.0, limits)
    return profile.finish(profile.end.position, 0.0)


def jog(start: State, velocity: float, limits: Limits) -> Profile:
    """Changes to this velocity, of either sign, and keeps it."""
    profile = _settled(start, limits)
    if profile.end.velocity * velocity < 0.0:
        _change(profile, 0.0, limits)
    _change(profile, velocity, limits)
    return profile.finish(profile.end.position, velocity)


def move(start: State, target: float, end_speed: float, limits: Limits) -> tuple[Profile, bool]:
    """To `target`, there with `end_speed` (not negative) in the direction of the move.

    Whether it gets there with that speed is told, too: where the axis would have to back up and
    take a run-up for it, it comes to rest instead.
    """
    profile = _settled(start, limits)
    if _overruns(profile.end, target, min(end_speed, limits.velocity), limits):
        _change(profile, 0.0, limits)
    sign = math.copysign(1.0, target - profile.end.position)
    now, way = profile.end.velocity * sign, abs(target - profile.end.position)
    if way == 0.0 and now == 0.0:
        return profile.finish(target, 0.0), end_speed == 0.0
    speed = min(end_speed, limits.velocity)
    kept = now > speed or way + 1e-9 >= _way(now, speed, limits)
    if not kept:
        speed = 0.0
    peak = _peak(now, speed, way, limits)
    _change(profile, sign * peak, limits)
    if peak:
        cruise = (way - _way(now, peak, limits) - _way(peak, speed, limits)) / peak
        profile.add(cruise, 0.0)
    _change(profile, sign * speed, limits)
    return profile.finish(target, sign * speed), kept


def _overruns(at: State, target: float, speed: float, limits: Limits) -> bool:
    """Whether it has to stop first: it goes the wrong way, or too fast to be slow in time."""
    velocity, way = at.velocity, target - at.position
    if velocity == 0.0:
        return False
    if velocity * way < 0.0:
        return True
    speed = min(speed, abs(velocity))
    return abs(way) < _way(abs(velocity), speed, limits) - 1e-9


def _peak(now: float, end: float, way: float, limits: Limits) -> float:
    """The velocity between two ramps that together go at most `way`, at most the limit."""

    def needed(peak: float) -> float:
        return _way(now, peak, limits) + _way(peak, end, limits)

    if now >= limits.velocity:
        return limits.velocity if needed(limits.velocity) <= way else now
    low, high = max(end, now), limits.velocity
    if low >= high or needed(high) <= way:
        return high
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if needed(middle) <= way else (low, middle)
    return low
