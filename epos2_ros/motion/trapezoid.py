"""Point-to-point moves as a drive's profile position mode makes them, and several in step.

A move accelerates, goes on at its velocity and decelerates; a short one turns from acceleration to
deceleration before it has reached its velocity. Accelerations are constant, or rise and fall at
constant jerk. Any unit of position.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from epos2_ros.motion.crossings import Path

MOST_JERK = 1.25  # of what is asked for, where whole units leave no other way to be in step


@dataclass(frozen=True)
class Trapezoid:
    """From rest at `start` to rest at `end`; velocity, acceleration and jerk are positive."""

    start: float
    end: float
    velocity: float  # [1/s]
    acceleration: float  # [1/s²], of the deceleration as well
    jerk: float = math.inf  # [1/s³]

    @property
    def peak(self) -> float:
        """The velocity it reaches [1/s].

        Two ramps of v / a + a / j, or 2 √(v / j) where the acceleration is never reached, take
        the whole way at the most.
        """
        way, rise = abs(self.end - self.start), self.acceleration * self._rise_s
        peak = math.hypot(rise / 2, math.sqrt(way * self.acceleration)) - rise / 2
        if peak < rise:
            peak = (way / 2 * math.sqrt(self.jerk)) ** (2 / 3)
        return min(self.velocity, peak)

    @property
    def _rise_s(self) -> float:
        """From no acceleration to all of it."""
        return self.acceleration / self.jerk

    @property
    def ramp_s(self) -> float:
        """From rest to the peak."""
        rise_s = min(self._rise_s, math.sqrt(self.peak / self.jerk))
        return self.peak / self.acceleration + rise_s if rise_s == self._rise_s else 2 * rise_s

    @property
    def duration_s(self) -> float:
        """From rest to rest."""
        if self.end == self.start:
            return 0.0
        return abs(self.end - self.start) / self.peak + self.ramp_s

    def lasting(self, duration_s: float) -> Trapezoid:
        """The same move over a longer time: everything slower in proportion."""
        if self.end == self.start:
            return self
        slower = self.duration_s / duration_s
        return Trapezoid(
            self.start,
            self.end,
            self.peak * slower,
            self.acceleration * slower**2,
            self.jerk * slower**3,
        )

    def in_units(
        self, velocity_unit: float, acceleration_unit: float, jerk_unit: float = math.nan
    ) -> Trapezoid:
        """As a drive makes it of whole counts and whole units, at least one of each.

        Of the velocities and accelerations near, those with which it lasts as long: several axes
        that are to arrive together do, however coarse their units are.
        """
        start, end = float(round(self.start)), float(round(self.end))
        if start == end:
            return Trapezoid(start, end, velocity_unit, acceleration_unit)
        wanted_s, way = self.duration_s, abs(end - start)
        most = math.ceil(1.005 * self.velocity / velocity_unit)
        if self.jerk == math.inf:
            pairs = self._near(way, wanted_s, velocity_unit, acceleration_unit)
            near = [(v, a, math.inf) for v, a in pairs]
        else:
            units = velocity_unit, acceleration_unit, jerk_unit
            near = [
                (v, a, max(1, round(j / jerk_unit)) * jerk_unit)
                for v, a, j in self._near_jerk(way, wanted_s, *units)
            ]
        made = [
            Trapezoid(start, end, max(1, v) * velocity_unit, max(1, a) * acceleration_unit, jerk)
            for v, a, jerk in near
            if v <= most
        ]
        return min(made, key=lambda move: abs(move.duration_s - wanted_s))

    def _near(
        self, way: float, wanted_s: float, velocity_unit: float, acceleration_unit: float
    ) -> list[tuple[int, int]]:
        """Velocity and acceleration in units, one of them rounded, the other to fit."""
        near_v, near_a = self.peak / velocity_unit, self.acceleration / acceleration_unit
        pairs = [(math.ceil(self.velocity / velocity_unit), round(near_a))]
        for steps in range(math.floor(near_v) - 2, math.floor(near_v) + 3):  # in units
            cruise_s = way / max(steps * velocity_unit, 1e-300)
            if wanted_s / 2 <= cruise_s < wanted_s:
                ramp_s = wanted_s - cruise_s
                pairs.append((steps, round(steps * velocity_unit / ramp_s / acceleration_unit)))
        for steps in range(math.floor(near_a) - 1, math.floor(near_a) + 3):
            rate = steps * acceleration_unit
            root = (rate * wanted_s) ** 2 - 4 * rate * way
            if rate > 0 and root >= 0:
                velocity = (rate * wanted_s - math.sqrt(root)) / 2
                pairs.append((round(velocity / velocity_unit), steps))
        return pairs

    def _near_jerk(
        self,
        way: float,
        wanted_s: float,
        velocity_unit: float,
        acceleration_unit: float,
        jerk_unit: float,
    ) -> list[tuple[int, int, float]]:
        """Velocity and acceleration in units, and the jerk with which they take that time.

        Or, where a unit of jerk is much, that of whole units and the velocity to fit.
        """
        near_v, near_a = self.peak / velocity_unit, self.acceleration / acceleration_unit
        triples = [(math.ceil(self.velocity / velocity_unit), round(near_a), self.jerk)]
        for v in range(max(1, math.floor(near_v) - 2), math.floor(near_v) + 3):
            velocity = v * velocity_unit
            ramp_s = wanted_s - way / velocity
            if not 0.0 < ramp_s <= wanted_s / 2:
                continue
            triples.append((v, max(1, math.ceil(near_a)), 4 * velocity / ramp_s**2))
            for a in range(max(1, math.floor(near_a) - 2), math.floor(near_a) + 3):
                rate = a * acceleration_unit
                if ramp_s > velocity / rate:
                    triples.append((v, a, rate / (ramp_s - velocity / rate)))
        near_j, a = math.floor(self.jerk / jerk_unit), max(1, math.ceil(near_a))
        for steps in range(max(1, near_j - 1), near_j + 3):
            move = Trapezoid(0.0, way, self.velocity, a * acceleration_unit, steps * jerk_unit)
            triples.append((round(move.slowed_to(wanted_s) / velocity_unit), a, move.jerk))
        most = max(MOST_JERK * self.jerk, jerk_unit)
        return [(v, a, jerk) for v, a, jerk in triples if jerk <= most]

    def slowed_to(self, duration_s: float) -> float:
        """The velocity at which it lasts so long, its own at most."""
        low, high = 0.0, self.peak
        if self.duration_s >= duration_s:
            return high
        for _ in range(50):
            middle = (low + high) / 2
            slower = replace(self, velocity=middle)
            low, high = (middle, high) if slower.duration_s > duration_s else (low, middle)
        return high

    def path(self, begin_us: float) -> Path:
        """As a path that begins at `begin_us`; a standing axis has one knot."""
        if self.end == self.start:
            return Path(np.array([begin_us]), np.array([self.start]), np.zeros(1))
        way, sign = self.end - self.start, math.copysign(1.0, self.end - self.start)
        ramp_s, peak = self.ramp_s, self.peak
        rise_s = min(self._rise_s, ramp_s / 2)
        rate = peak / (ramp_s - rise_s)  # the acceleration it reaches
        cruise_s = max(0.0, self.duration_s - 2 * ramp_s)
        knots = [(0.0, 0.0, 0.0)]  # of the ramp: time, way and velocity, all rising
        if rise_s > 0.0:
            velocity, so_far = rate * rise_s / 2, rate * rise_s**2 / 6
            knots.append((rise_s, so_far, velocity))
            if ramp_s - 2 * rise_s > 1e-9 * ramp_s:
                way_there = peak * (ramp_s / 2 - rise_s) + so_far
                knots.append((ramp_s - rise_s, way_there, peak - velocity))
        knots.append((ramp_s, peak * ramp_s / 2, peak))
        down = [(self.duration_s - t, abs(way) - x, v) for t, x, v in reversed(knots)]
        if cruise_s * peak < 1e-9 * abs(way):
            del down[0]
        t, position, velocity_ = np.array([*knots, *down]).T
        return Path(begin_us + t * 1e6, self.start + sign * position, sign * velocity_)


def in_step(moves: Sequence[Trapezoid], duration_s: float = 0.0) -> list[Trapezoid]:
    """The moves made to last as long as the longest, or as `duration_s` if that is longer."""
    longest = max([duration_s, *(move.duration_s for move in moves)])
    return [move.lasting(longest) if longest else move for move in moves]
