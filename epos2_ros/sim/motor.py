"""The axis a simulated drive moves: it follows the demand with a lag.

Positions in qc, time in ms, velocity in qc/ms, acceleration in qc/ms².
"""

from __future__ import annotations

import math
import random


class Motor:
    """First-order lag behind the demand: what is left of a step falls by 1/e every `lag_ms`."""

    def __init__(self, position: float, lag_ms: float, noise_qc: float, seed: int) -> None:
        self.position = position
        self.velocity = 0.0
        self.acceleration = 0.0
        self.measured = round(position)  # [qc], what the encoder tells
        self.blocked = False
        self._follow = 1.0 - math.exp(-1.0 / lag_ms) if lag_ms else 1.0
        self._noise_qc = noise_qc
        self._random = random.Random(seed)

    def step(self, demand: float) -> None:
        """One millisecond."""
        if not self.blocked:
            velocity = (demand - self.position) * self._follow
            self.acceleration = velocity - self.velocity
            self.velocity = velocity
            self.position += velocity
        if self._noise_qc:
            self.measured = round(self.position + self._random.gauss(0.0, self._noise_qc))
        else:
            self.measured = round(self.position)

    def stand(self, position: float | None = None) -> None:
        """Stands still, at `position` or where it is."""
        if position is not None:
            self.position = float(position)
            self.measured = round(position)
        self.velocity = self.acceleration = 0.0
