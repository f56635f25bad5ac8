"""The master clock, and every drive's motion clock against it.

Application note 2.4: TIME sets the motion clock of a drive to zero; every SYNC latches it; the
master then tells the drive when that SYNC really was (0x1013), and the drive corrects its clock
by the difference. Stamps count microseconds since TIME and wrap at 2³² (every 71.6 minutes), as
the drives' clocks do.

The host's own time of a SYNC is noisy (interrupt latency, a late thread), while every drive
latches it to a microsecond by a quartz. So the master clock is a line fitted through the host's
times over the drives' clocks, corrections taken out; a late time stamp is an outlier of that line
and moves no drive. All drives see the same SYNCs: what is left of the noise moves them together.

Between two corrections a drive drifts, and the line's slope says how fast. So a drive is not set
right but ahead by what it loses in half a period: its error then swings evenly around zero.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

import numpy as np

WRAP_US = 1 << 32
WINDOW = 100  # SYNCs a line is fitted through
MIN_FIT = 4  # with fewer, the host's time is all there is
OUTLIER = 5.0  # times the median deviation from the line …
OUTLIER_FLOOR_US = 5.0  # … and never less than this is an outlier
MAX_DRIFT = 500e-6  # of a quartz against the host's: a steeper line is a mistake
COARSEST_CLOCK_US = 10.0  # drives count bit times; to this a clock's ticks are smoothed
SLEW = 1e-6  # of the master's time towards the line: the drives get it one after another, …
EARLY_SLEW, EARLY = 5e-6, 20  # … and so much while the line is made of fewer SYNCs
_SECONDS_TO_1984 = 441_763_200  # from 1970-01-01 to 1984-01-01, the epoch of TIME_OF_DAY


def wrapped(difference_us: float) -> float:
    """A difference of two stamps as a signed number, whichever of them has wrapped."""
    return (difference_us + WRAP_US // 2) % WRAP_US - WRAP_US // 2


def _median(values: np.ndarray) -> np.ndarray:
    """Along the first axis; NumPy's own takes ten times as long for so few values."""
    ordered, half = np.sort(values, axis=0), len(values) // 2
    return (ordered[half] + ordered[-half - 1]) / 2


class MasterClock:
    """The time since TIME, and what to tell each drive after a SYNC. Times in µs.

    The master is the host, or the drive with index `master`, whose stamps the others take by
    themselves: then this only tells the time and the diagnostics. `period_us`: from one correction
    of a drive to the next.
    """

    def __init__(self, drives: int, period_us: float, master: int | None = None) -> None:
        self.noise_us = 0.0  # median deviation of the host's times from the line
        self.outliers = 0
        self.offset_us = np.full(drives, math.nan)  # of each drive at the last SYNC it answered
        self.drift = np.zeros(drives)  # of each drive's quartz against the host's clock
        self._period_us = period_us
        self._master = master
        self._kept_us = np.zeros(drives)  # how far from the master's time each drive is kept
        self.reset(0.0)

    def reset(self, t_us: float) -> None:
        """TIME was on the bus at host time `t_us`: the drives count from there."""
        self._zero_us = t_us
        self._sync_us = self._sync_host_us = 0.0  # the last SYNC by the master and by the host
        self._shown: list[int | None] = [None] * len(self.drift)  # by each drive, corrected, …
        self._shown_us = np.zeros(len(self.drift))  # … at the last SYNC it answered, at this time
        self._free_us = np.zeros(len(self.drift))  # the clocks, had none ever been corrected
        self._rest_us = np.zeros(len(self.drift))  # of them at the last SYNC, not in whole ticks
        self._seen: deque[tuple[float, ...]] = deque(maxlen=WINDOW)  # host's time, `_free_us`
        self._line: tuple[float, np.ndarray] | None = None  # host's time, ahead of it there

    def master_us(self, t_us: float) -> float:
        """The master's time at host time `t_us`, near the last SYNC."""
        rate = 1.0 if self._master is None else 1.0 + float(self.drift[self._master])
        return self._sync_us + rate * (t_us - self._zero_us - self._sync_host_us)

    @property
    def sync_us(self) -> float:
        """Host time of the last SYNC, by the clocks of the drives that have answered it."""
        return self._zero_us + self._sync_host_us

    @property
    def settled(self) -> bool:
        """Whether the master's time no longer depends on when the host noticed a single SYNC."""
        return self._line is not None or not len(self.drift)

    def begin_anew(self) -> None:
        """No drive's clock fits the host's times of the SYNCs so far: they were wrong."""
        self.reset(self._zero_us)

    def ahead_us(self, drive: int, latched: int, t_us: float) -> float:
        """How far a drive's clock is ahead of what it was to be at host time `t_us`."""
        shown = self._shown[drive]
        if shown is None:
            return 0.0
        return float(wrapped(latched - shown) - (self.master_us(t_us) - self._shown_us[drive]))

    def on_sync(self, t_us: float, latched: Sequence[int | None]) -> None:
        """A SYNC was on the bus at host time `t_us`.

        `latched` are the drives' clocks at that SYNC, before they are corrected; None: no answer.
        """
        host_us = t_us - self._zero_us
        answered = [drive for drive, clock in enumerate(latched) if clock is not None]
        passed_us = self._count(latched)
        now_us = self.master_us(t_us)
        if len(answered) == len(latched):
            self._seen.append((host_us, *self._free_us))
            self._fit()
        if self._line is None or not answered:
            self._sync_us, self._sync_host_us = now_us, host_us
        else:
            late_us = self._late_us(host_us)
            late = float(_median(late_us[answered]))
            self._rest_us = late - late_us
            self._rest_us[np.abs(self._rest_us) > COARSEST_CLOCK_US] = 0.0
            self._sync_host_us = host_us + late
            due_us = self._shown_us + passed_us / (1 + self.drift)
            self._sync_us = self._slew(float(_median(due_us[answered])))
        if self._master is not None:
            known = latched[self._master] is not None
            self._sync_us = float(self._free_us[self._master]) if known else now_us
        for drive in answered:
            self._shown_us[drive] = self._sync_us
            off_us = (latched[drive] or 0) - self._sync_us - self._kept_us[drive]
            self.offset_us[drive] = wrapped(off_us + self._rest_us[drive])

    def stamp(self, drive: int, after_us: float) -> int:
        """What to tell a drive (0x1013) `after_us` after the last SYNC, which it answered."""
        ahead_us = -self.drift[drive] * (after_us + self._period_us / 2) - self._rest_us[drive]
        return round(self._sync_us + self._kept_us[drive] + ahead_us) % WRAP_US

    def corrected(self, drive: int, stamp: int) -> None:
        """The drive has got its stamp of the last SYNC."""
        self._shown[drive] = stamp

    def keep(self) -> None:
        """The last SYNC was the zero of a path: from there the drives go on as they were.

        The time of a path is that of the drive's clock since its zero, so putting right what a
        clock was off at the zero would put the path out of step by just that.
        """
        self._kept_us += np.nan_to_num(self.offset_us)
        self.offset_us[:] = 0.0

    def release(self) -> None:
        """No path any more: all drives go back to the master's time."""
        self._kept_us[:] = 0.0

    def _count(self, latched: Sequence[int | None]) -> np.ndarray:
        """Go on counting; what has passed on each drive's clock since it last answered."""
        before_us = self._free_us.copy()
        for drive, (clock, shown) in enumerate(zip(latched, self._shown, strict=True)):
            if clock is not None:
                self._free_us[drive] += clock if shown is None else wrapped(clock - shown)
                self._shown[drive] = clock
        return self._free_us - before_us

    def _slew(self, due_us: float) -> float:
        """The master's time, due to be `due_us`, on its way to that of the lines."""
        most_us = self._period_us * (SLEW if len(self._seen) >= EARLY else EARLY_SLEW)
        return due_us + min(most_us, max(-most_us, self._sync_host_us - due_us))

    def _fit(self) -> None:
        """A line per drive: how far it is ahead of the host, over the host's time."""
        if len(self._seen) < MIN_FIT:
            return
        seen = np.array(self._seen)
        x, ahead = seen[:, :1] - seen[-1, 0], seen[:, 1:] - seen[:, :1]
        # The noise is the host's and common to all drives: one verdict per SYNC.
        bent = ahead - self.drift * x
        noise = (bent - _median(bent)).sum(axis=1) / len(self.drift)
        deviation = np.abs(noise - _median(noise))
        self.noise_us = float(_median(deviation))
        good = deviation <= max(OUTLIER * self.noise_us, OUTLIER_FLOOR_US)
        self.outliers += int(not good[-1])
        x, ahead = x[good], ahead[good]
        middle, dx = ahead.mean(axis=0), x - x.mean()
        slope = (dx * (ahead - middle)).sum(axis=0) / (dx * dx).sum()
        self.drift = np.clip(slope, -MAX_DRIFT, MAX_DRIFT)
        self._line = seen[-1, 0], middle - self.drift * x.mean()

    def _late_us(self, host_us: float) -> np.ndarray:
        """How much later than by the host's clock a SYNC was, going by each drive's line."""
        assert self._line is not None
        at_us, ahead_us = self._line
        return self._free_us - host_us - ahead_us - self.drift * (host_us - at_us)


def time_of_day(unix_s: float) -> bytes:
    """The six bytes of TIME (CiA 301, TIME_OF_DAY): ms since midnight, days since 1984-01-01."""
    days, seconds = divmod(unix_s - _SECONDS_TO_1984, 86_400)
    return (int(seconds * 1000) & 0x0FFF_FFFF).to_bytes(4, "little") + int(days).to_bytes(
        2, "little"
    )
