"""The master clock that the drives' motion clocks follow.

Application note 2.4: TIME sets the motion clock of a drive to zero; after every SYNC the master
sends the time at which that SYNC was really on the bus (0x1013), and each drive corrects its
clock by the difference to what it latched. The stamp counts microseconds since TIME and wraps at
2³² (every 71.6 minutes), as the drives' clocks do.

The host's own time of a SYNC is noisy (interrupt latency, a late thread), while every drive
latches it to a microsecond by a quartz. So the stamps are a line fitted through the host's times
over the time that passed on the drives' clocks, the median of them; a late time stamp is an
outlier of that line and moves no drive.
"""

from __future__ import annotations

from collections import deque
from statistics import median

import numpy as np

WRAP_US = 1 << 32
WINDOW = 100  # SYNCs the line is fitted through
MIN_FIT = 4  # with fewer, the host's time is all there is
OUTLIER = 4.0  # times the median deviation from the line …
OUTLIER_FLOOR_US = 5.0  # … and never less than this is an outlier
MAX_DRIFT = 500e-6  # of a quartz against the host's: a line steeper than this is a mistake
_SECONDS_TO_1984 = 441_763_200  # from 1970-01-01 to 1984-01-01, the epoch of TIME_OF_DAY


def wrapped(difference_us: int) -> int:
    """A difference of two stamps as a signed number, whichever of them has wrapped."""
    return (difference_us + WRAP_US // 2) % WRAP_US - WRAP_US // 2


class MasterClock:
    """Gives every SYNC the stamp that the drives get."""

    def __init__(self) -> None:
        self.last_stamp: int | None = None  # what the drives were last set to
        self.noise_us = 0.0  # median deviation of the host's times from the line
        self.outliers = 0
        self._zero_us = 0.0
        self._elapsed_us = 0.0  # on the drives' clocks since the first SYNC
        self._seen: deque[tuple[float, float]] = deque(maxlen=WINDOW)  # elapsed, host's time

    def reset(self, t_us: float) -> None:
        """TIME was on the bus at host time `t_us`: the drives count from there."""
        self._zero_us = t_us
        self._elapsed_us = 0.0
        self._seen.clear()
        self.last_stamp = None

    def stamp(self, t_us: float, latched: list[int]) -> int:
        """Stamp (0x1013) of a SYNC seen on the bus at host time `t_us`.

        `latched` are the clocks of the drives that answered it, before they are corrected.
        """
        host_us = t_us - self._zero_us
        passed = [wrapped(clock - self.last_stamp) for clock in latched] if self.last_stamp else []
        if passed:
            self._elapsed_us += median(passed)
        else:  # nothing but the host's clock to go by: begin anew
            self._seen.clear()
            self._elapsed_us = 0.0
        self._seen.append((self._elapsed_us, host_us))
        self.last_stamp = round(self._fitted(host_us)) % WRAP_US
        return self.last_stamp

    def _fitted(self, host_us: float) -> float:
        """The line's value at the newest SYNC."""
        if len(self._seen) < MIN_FIT:
            return host_us
        elapsed, seen = np.array(self._seen).T
        x = elapsed - elapsed[-1]
        late = seen - elapsed  # varies by drift and noise only
        offset, slope = _line(x, late)
        deviation = np.abs(late - offset - slope * x)
        self.noise_us = float(np.median(deviation))
        good = deviation <= max(OUTLIER * self.noise_us, OUTLIER_FLOOR_US)
        if not good.all():
            self.outliers += int(not good[-1])
            offset, slope = _line(x[good], late[good])
        return float(elapsed[-1] + offset)


def _line(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Offset at x = 0 and slope of the least-squares line, the slope within what a quartz does."""
    mean_x, mean_y = x.mean(), y.mean()
    spread = ((x - mean_x) ** 2).sum()
    slope = ((x - mean_x) * (y - mean_y)).sum() / spread if spread else 0.0
    slope = min(MAX_DRIFT, max(-MAX_DRIFT, slope))
    return float(mean_y - slope * mean_x), float(slope)


def time_of_day(unix_s: float) -> bytes:
    """The six bytes of TIME (CiA 301, TIME_OF_DAY): ms since midnight, days since 1984-01-01."""
    days, seconds = divmod(unix_s - _SECONDS_TO_1984, 86_400)
    return (int(seconds * 1000) & 0x0FFF_FFFF).to_bytes(4, "little") + int(days).to_bytes(
        2, "little"
    )
