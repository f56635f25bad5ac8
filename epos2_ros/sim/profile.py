"""Motion profiles of constant acceleration, as the drive makes them itself.

Positions in qc, time in ms, velocity in qc/ms, acceleration in qc/ms².
"""

from __future__ import annotations

import math
from typing import NamedTuple


class Phase(NamedTuple):
    """Constant acceleration from `start_ms` on."""

    start_ms: float
    position: float
    velocity: float
    acceleration: float


class Profile:
    """Phases one after the other, then at rest at `target` (or going on, if it is `None`)."""

    def __init__(self, position: float, velocity: float) -> None:
        self._phases: list[Phase] = []
        self.duration_ms = 0.0
        self.target: float | None = None
        self._position, self._velocity = position, velocity

    def add(self, duration_ms: float, acceleration: float) -> None:
        self._phases.append(
            Phase(self.duration_ms, self._position, self._velocity, acceleration)
        )
        self._position += (self._velocity + 0.5 * acceleration * duration_ms) * duration_ms
        self._velocity += acceleration * duration_ms
        self.duration_ms += duration_ms

    def end(self, target: float | None = None) -> Profile:
        """Rests at `target`, or at the whole count the phases lead to."""
        self.target = round(self._position) if target is None else target
        return self

    def cruise(self) -> Profile:
        """Goes on at the velocity the phases lead to."""
        self._phases.append(Phase(self.duration_ms, self._position, self._velocity, 0.0))
        self.duration_ms = math.inf
        return self

    def at(self, t_ms: float) -> tuple[float, float]:
        """Position and velocity."""
        if t_ms >= self.duration_ms and self.target is not None:
            return self.target, 0.0
        start_ms, position, velocity, acceleration = next(
            phase for phase in reversed(self._phases) if phase.start_ms <= t_ms
        )
        t = t_ms - start_ms
        return position + (velocity + 0.5 * acceleration * t) * t, velocity + acceleration * t


def stop(position: float, velocity: float, deceleration: float) -> Profile:
    """Slows down to rest."""
    profile = Profile(position, velocity)
    if velocity:
        profile.add(abs(velocity) / deceleration, -math.copysign(deceleration, velocity))
    return profile.end()


def jog(position: float, velocity: float, speed: float, acceleration: float) -> Profile:
    """Changes to the signed `speed` and keeps it."""
    profile = Profile(position, velocity)
    change = speed - velocity
    if change:
        profile.add(abs(change) / acceleration, math.copysign(acceleration, change))
    return profile.cruise()


def trapezoid(
    position: float,
    velocity: float,
    target: float,
    speed: float,
    acceleration: float,
    deceleration: float,
) -> Profile:
    """To rest at `target` as fast as the limits allow, from any position and velocity."""
    profile = Profile(position, velocity)
    overrun = position + velocity * abs(velocity) / (2 * deceleration) - target
    sign = math.copysign(1.0, -overrun)
    forward = velocity * sign
    if forward < 0:  # the wrong way, or too fast to stop in time: stop, then come back
        profile.add(-forward / deceleration, sign * deceleration)
        position, forward = overrun + target, 0.0
    distance = (target - position) * sign
    if forward > speed:
        profile.add((forward - speed) / deceleration, -sign * deceleration)
        distance -= (forward**2 - speed**2) / (2 * deceleration)
        peak = speed
    else:
        peak = math.sqrt(
            (distance + forward**2 / (2 * acceleration))
            * (2 * acceleration * deceleration / (acceleration + deceleration))
        )
        peak = min(max(peak, forward), speed)
        if peak > forward:
            profile.add((peak - forward) / acceleration, sign * acceleration)
            distance -= (peak**2 - forward**2) / (2 * acceleration)
    cruise = distance - peak**2 / (2 * deceleration)
    if peak > 0:
        if cruise > 0:
            profile.add(cruise / peak, 0.0)
        profile.add(peak / deceleration, -sign * deceleration)
    return profile.end(target)
