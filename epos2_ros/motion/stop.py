"""Stopping on the path: all axes slow down together along what they were to do anyway.

The commanded curve q(t) becomes q(σ(t)), where σ runs ever slower: its rate u falls from
1 to 0. The acceleration of an axis is then q''·u² + q'·u', so the acceleration limits of
all axes bound how steeply u may fall at each place of the path. Braking as hard as they
allow everywhere is the shortest stop: over σ, u² obeys a first-order equation, whose
lowest slope gives the lowest curve. Not braking is always allowed, since u ≤ 1.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from epos2_ros.motion.limits import PLANNED_SHARE, Limits
from epos2_ros.motion.reference import Motion, Reference

Array = NDArray[np.float64]

_CELL_S = 0.001  # u falls linearly in time over cells of σ of this length
_SAMPLES = 4  # instants of a cell at which its acceleration is bounded
_BLOCK = 256  # cells looked at in one go


@dataclass(frozen=True, eq=False)
class Slowed:
    """`motion` run at a rate that falls to zero.

    At path time t_s[i] the motion has come to sigma_s[i] and runs at rate[i]; in between
    the rate is linear in time. All are [cells + 1].
    """

    motion: Motion
    t_s: Array
    sigma_s: Array
    rate: Array

    @property
    def end_s(self) -> float:
        return float(self.t_s[-1])

    def evaluate(self, t_s: Array, derivative: int = 0) -> Array:
        """Position or its 1st or 2nd derivative at path times t_s [m] → [m, axes]."""
        i = np.clip(np.searchsorted(self.t_s, t_s, side="right") - 1, 0, len(self.t_s) - 2)
        dt = np.clip(t_s, self.t_s[0], self.end_s) - self.t_s[i]
        slope = (self.rate[i + 1] - self.rate[i]) / (self.t_s[i + 1] - self.t_s[i])
        sigma = self.sigma_s[i] + (self.rate[i] + slope * dt / 2) * dt
        if derivative == 0:
            return self.motion.evaluate(sigma)
        moving = (t_s < self.end_s)[:, None]
        rate = (self.rate[i] + slope * dt)[:, None] * moving
        velocity = self.motion.evaluate(sigma, 1)
        if derivative == 1:
            return velocity * rate
        return self.motion.evaluate(sigma, 2) * rate**2 + velocity * slope[:, None] * moving


def stop(current: Reference, from_ms: int, limits: Limits) -> Reference:
    """`current` until `from_ms`, from there on slowing down along its path to rest.

    As short as `limits.agility` allows. A stop in progress goes on as it is; what was to begin
    after it does not.
    """
    if from_ms >= current.end_ms:
        return current
    governing = current.governs(from_ms)
    if isinstance(governing, Slowed):
        return current.followed_by(governing, from_ms)
    path = current.trimmed(from_ms)
    return current.followed_by(
        _brake(path, from_ms / 1000, limits.agility * PLANNED_SHARE), from_ms
    )


def _brake(path: Reference, start_s: float, acceleration: Array) -> Slowed:
    t, sigma, energy = [start_s], [start_s], [1.0]  # energy: u²
    for speed, bend in _cells(path, start_s):
        u2 = energy[-1]
        # A + bend·u² is what an axis can still brake; the least u² counts where the path
        # speeds up, the largest where it brakes by itself. u' is σ's second derivative.
        steepest = -np.min((acceleration + bend * u2) / speed)
        least = np.where(bend > 0, max(u2 + 2 * _CELL_S * steepest, 0.0), u2)
        slope = min(-float(np.min((acceleration + bend * least) / speed)), 0.0)
        left = u2 + 2 * _CELL_S * slope
        length = _CELL_S if left > 0 else u2 / (-2 * slope)
        left = max(left, 0.0)
        t.append(t[-1] + 2 * length / (u2**0.5 + left**0.5))
        sigma.append(sigma[-1] + length)
        energy.append(left)
        if left == 0 or sigma[-1] >= path.end_s:
            break
    return Slowed(path, np.array(t), np.array(sigma), np.sqrt(energy))


def _cells(path: Reference, start_s: float) -> Iterator[tuple[Array, Array]]:
    """|q'| and q'' in the direction of q' at the instants of one cell after another.

    Each [samples, axes].
    """
    instants = np.arange(_BLOCK * _SAMPLES + 1) / _SAMPLES * _CELL_S
    while True:
        velocity = path.evaluate(start_s + instants, 1)
        bend = path.evaluate(start_s + instants, 2) * np.sign(velocity)
        speed = np.maximum(np.abs(velocity), 1e-9)
        for first in range(0, _BLOCK * _SAMPLES, _SAMPLES):
            cell = slice(first, first + _SAMPLES + 1)
            yield speed[cell], bend[cell]
        start_s += _BLOCK * _CELL_S
