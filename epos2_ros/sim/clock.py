"""The motion clock of a simulated drive.

maxon, application note "Interpolation Position Mode", 2.4 and 3.6.2: a microsecond timer
latched by each SYNC, corrected by writing 0x1013, reset by TIME. It runs on the drive's
own oscillator and counts bit times of the bus.
"""

from __future__ import annotations

WRAP = 1 << 32


class MotionClock:
    """value(t) = offset + rate · t; only what is read or latched is quantised and wrapped."""

    def __init__(self, offset_us: float, drift_ppm: float, resolution_us: float) -> None:
        self.rate = 1.0 + drift_ppm * 1e-6
        self._offset_us = offset_us
        self._resolution_us = resolution_us
        self.latched = 0  # at the last SYNC, 32 bits

    def value(self, t_us: float) -> float:
        """The clock [µs] at true time `t_us`, not wrapped."""
        return self._offset_us + self.rate * t_us

    def latch(self, t_us: float) -> None:
        """A SYNC came in at true time `t_us`."""
        ticks = self.value(t_us) // self._resolution_us
        self.latched = int(ticks * self._resolution_us) % WRAP

    def correct(self, timestamp: int) -> float:
        """Shifts the clock by timestamp − latched, the shorter way around; gives the shift [µs].

        By the letter of the note a second timestamp for the same SYNC corrects once more.
        """
        shift = (timestamp - self.latched + WRAP // 2) % WRAP - WRAP // 2
        self._offset_us += shift
        return shift

    def reset(self, t_us: float) -> float:
        """TIME came in: zero from here on; gives the shift [µs]."""
        shift = -self.value(t_us)
        self._offset_us += shift
        return shift
