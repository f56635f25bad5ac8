"""Point-to-point moves as a drive's profile position mode makes them, and several in step.

A move accelerates, goes on at its velocity and decelerates, all constant; a short one turns from
acceleration to deceleration before it has reached its velocity. Any unit of position.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from epos2_ros.motion.crossings import Path


@dataclass(frozen=True)
class Trapezoid:
    """From rest at `start` to rest at `end`; velocity and acceleration are positive."""

    start: float
    end: float
    velocity: float  # [1/s]
    acceleration: float  # [1/s²], of the deceleration as well

    @property
    def peak(self) -> float:
        """The velocity it reaches [1/s]."""
        return min(self.velocity, math.sqrt(abs(self.end - self.start) * self.acceleration))

    @property
    def duration_s(self) -> float:
        """From rest to rest."""
        if self.end == self.start:
            return 0.0
        return abs(self.end - self.start) / self.peak + self.peak / self.acceleration

    def lasting(self, duration_s: float) -> Trapezoid:
        """The same move over a longer time: everything slower in proportion."""
        if self.end == self.start:
            return self
        slower = self.duration_s / duration_s
        return Trapezoid(self.start, self.end, self.peak * slower, self.acceleration * slower**2)

    def in_units(self, velocity_unit: float, acceleration_unit: float) -> Trapezoid:
        """As a drive makes it of whole counts and whole units, at least one of each.

        Of the velocities and accelerations near, those with which it lasts as long: several axes
        that are to arrive together do, however coarse their units are.
        """
        start, end = float(round(self.start)), float(round(self.end))
        if start == end:
            return Trapezoid(start, end, velocity_unit, acceleration_unit)
        wanted_s, way = self.duration_s, abs(end - start)
        near_v, near_a = self.peak / velocity_unit, self.acceleration / acceleration_unit
        most = math.ceil(1.005 * self.velocity / velocity_unit)
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
        made = [
            Trapezoid(start, end, max(1, v) * velocity_unit, max(1, a) * acceleration_unit)
            for v, a in pairs
            if v <= most
        ]
        return min(made, key=lambda move: abs(move.duration_s - wanted_s))

    def path(self, begin_us: float) -> Path:
        """As a path that begins at `begin_us`; a standing axis has one knot."""
        if self.end == self.start:
            return Path(np.array([begin_us]), np.array([self.start]), np.zeros(1))
        sign = math.copysign(1.0, self.end - self.start)
        ramp_s = self.peak / self.acceleration
        ramp = 0.5 * self.peak * ramp_s
        cruise_s = max(0.0, self.duration_s - 2 * ramp_s)
        knots = [
            (0.0, self.start, 0.0),
            (ramp_s, self.start + sign * ramp, sign * self.peak),
            (ramp_s + cruise_s, self.end - sign * ramp, sign * self.peak),
            (self.duration_s, self.end, 0.0),
        ]
        if cruise_s * self.peak < 1e-9 * abs(self.end - self.start):
            del knots[2]
        t, position, velocity = np.array(knots).T
        return Path(begin_us + t * 1e6, position, velocity)


def in_step(moves: Sequence[Trapezoid], duration_s: float = 0.0) -> list[Trapezoid]:
    """The moves made to last as long as the longest, or as `duration_s` if that is longer."""
    longest = max([duration_s, *(move.duration_s for move in moves)])
    return [move.lasting(longest) if longest else move for move in moves]
