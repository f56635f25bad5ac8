"""The master clock, and every drive's motion clock against it.

Application note 2.4: TIME sets the motion clock of a drive to zero; every SYNC latches it; the
master then tells the drive when that SYNC really was (0x1013), and the drive corrects its clock
by the difference. Stamps count microseconds since TIME and wrap at 2³² (every 71.6 minutes), as
the drives' clocks do.

The host's own time of a SYNC is noisy (interrupt latency, a late thread), while every drive
latches it to a microsecond by a quartz. So one drive that says what its clock was at a SYNC tells
when that SYNC was: since the one before its clock has gone on by as much as has passed, but for
what its quartz is fast. How far the quartzes differ is compared at SYNCs of which more than one
drive tells; what the others' clocks were then follows. So all clocks are known at every SYNC
of which any drive tells its own.

What has passed by the drives' clocks, all SYNCs together, is their common clock. The master clock
is a line fitted through the host's times over it; a late time stamp is an outlier of that line and
moves no drive. All drives see the same SYNCs: what is left of the noise moves them together.

Between two corrections a drive drifts, and by how much is known. So a drive is not set right but
ahead by half of what it loses until the next: its error then swings evenly around zero. One that
loses little is corrected less often.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from statistics import median
from types import MappingProxyType

import numpy as np

WRAP_US = 1 << 32
WINDOW = 100  # SYNCs a line is fitted through
STEADY = 50  # of them, and it does not change much any more
MIN_FIT = 4  # with fewer, the host's time is all there is
OUTLIER = 5.0  # times the median deviation from the line …
OUTLIER_FLOOR_US = 5.0  # … and never less than this is an outlier
MAX_DRIFT = 500e-6  # of a quartz against the host's: a steeper line is a mistake
LEARN = 1 / 32  # of what a comparison of two quartzes says, once there have been many
BEND = 50e-6  # and no more than this: a clock that jumps says nothing of its quartz
DOUBT_US = 20.0  # two drives that differ by more are not to be believed, …
DOUBT_NOISE = 8.0  # … nor is one that differs from the host by so many times its noise …
DOUBT_FLOOR_US = 200.0  # … and at least by this, before all have been asked
NEAR = 20e-6  # of a period a drive may be off before it is corrected, if it is so slow to get there
TICK_US = 1.0  # of a stamp
MOST_PERIODS = 10  # between two corrections of a drive
SLEW = 1e-6  # of the master's time towards the line: the drives get it one after another, …
EARLY_SLEW, EARLY = 5e-6, 20  # … and so much while the line is made of fewer SYNCs
_SECONDS_TO_1984 = 441_763_200  # from 1970-01-01 to 1984-01-01, the epoch of TIME_OF_DAY


def wrapped(difference_us: float) -> float:
    """A difference of two stamps as a signed number, whichever of them has wrapped."""
    return (difference_us + WRAP_US // 2) % WRAP_US - WRAP_US // 2


def _median(values: np.ndarray) -> float:
    """NumPy's own takes ten times as long for so few values."""
    ordered, half = np.sort(values), len(values) // 2
    return float(ordered[half] + ordered[-half - 1]) / 2


class MasterClock:
    """The time since TIME, and what to tell each drive after a SYNC. Times in µs.

    The master is the host, or the drive with index `master`, whose stamps the others take by
    themselves: then this only tells the time and the diagnostics. `period_us`: from one correction
    of a drive to the next.
    """

    def __init__(self, drives: int, period_us: float, master: int | None = None) -> None:
        self.noise_us = 0.0  # median deviation of the host's times from the line
        self.outliers = 0
        self.offset_us = np.full(drives, math.nan)  # of each drive at the last SYNC it has told of
        self._period_us = period_us
        self._master = master
        self._kept_us = np.zeros(drives)  # how far from the master's time each drive is kept
        self._faster = np.zeros(drives)  # each drive's quartz than the common clock
        self._rate = 0.0  # of the common clock against the host's
        self.reset(0.0)

    def reset(self, t_us: float) -> None:
        """TIME was on the bus at host time `t_us`: the drives count from there."""
        drives = len(self._faster)
        self._zero_us = t_us
        self._sync_us = self._sync_host_us = 0.0  # the last SYNC by the master and by the host, …
        self._common_us = 0.0  # … and by the common clock
        self._free_us = 0.0  # likewise by the master's own, had it never been corrected
        self._shown: list[float | None] = [None] * drives  # by each drive, corrected, …
        self._at_us = np.zeros(drives)  # … when it was this by the common clock
        self._compared = np.zeros(drives, int)  # how often its quartz was, with others
        self._seen: deque[tuple[float, float]] = deque(maxlen=WINDOW)  # host's time, common clock
        self._line: tuple[float, float] | None = None  # host's time, common clock ahead of it there

    @property
    def drift(self) -> np.ndarray:
        """Of each drive's quartz against the host's clock."""
        return self._rate + self._faster

    def master_us(self, t_us: float) -> float:
        """The master's time at host time `t_us`, near the last SYNC."""
        rate = 1.0 if self._master is None else 1.0 + float(self.drift[self._master])
        return self._sync_us + rate * (t_us - self._zero_us - self._sync_host_us)

    @property
    def sync_us(self) -> float:
        """Host time of the last SYNC, by the clocks of the drives that have told of it."""
        return self._zero_us + self._sync_host_us

    @property
    def settled(self) -> bool:
        """Whether the master's time no longer depends on when the host noticed a single SYNC."""
        return self._line is not None or not len(self._faster)

    @property
    def steady(self) -> bool:
        """Whether it is well known how fast each quartz is, and how noisy the host's times are."""
        return len(self._seen) >= STEADY

    def begin_anew(self) -> None:
        """No drive's clock fits the host's times of the SYNCs so far: they were wrong."""
        self.reset(self._zero_us)

    def ahead_us(self, drive: int, latched: int, t_us: float) -> float:
        """How far a drive's clock is ahead of what it was to be at host time `t_us`."""
        shown = self._shown[drive]
        if shown is None:
            return 0.0
        passed_us = self._common_at(t_us - self._zero_us) - float(self._at_us[drive])
        return wrapped(latched - shown) - passed_us * (1 + float(self._faster[drive]))

    def on_sync(
        self,
        t_us: float,
        latched: Sequence[int | None],
        jumped_us: Mapping[int, float] = MappingProxyType({}),
    ) -> bool:
        """A SYNC was on the bus at host time `t_us`; False: what the drives say is in doubt.

        `latched` are the drives' clocks at that SYNC, before they are corrected; None: not told. In
        doubt it counts for nothing, and all drives should tell of the next. `jumped_us`: by how
        much the clocks of some have jumped, which the common clock is not to follow.
        """
        host_us, now_us = t_us - self._zero_us, self.master_us(t_us)
        told = {
            drive: float(
                self._at_us[drive] + wrapped(clock - shown) / (1 + self._faster[drive])
            )
            for drive, (clock, shown) in enumerate(zip(latched, self._shown, strict=True))
            if clock is not None and shown is not None
        }
        common_us = median(told.values()) if told else self._common_at(host_us)
        if told and self._doubtful(list(told.values()), common_us, host_us):
            return False
        if told:
            told = {n: at_us - jumped_us.get(n, 0.0) for n, at_us in told.items()}
            common_us = median(told.values())
            self._compare(latched, [n for n in told if n not in jumped_us], common_us)
            self._seen.append((host_us, common_us))
            self._fit()
        if self._line is None or not told:
            self._sync_us, self._sync_host_us = now_us, host_us
        else:
            due_us = self._sync_us + (common_us - self._common_us) / (1 + self._rate)
            at_us, ahead_us = self._line
            self._sync_host_us = common_us - ahead_us - self._rate * (host_us - at_us)
            self._sync_us = self._slew(due_us)
        if self._master is not None:
            self._sync_us = self._count_master(latched[self._master], bool(told), common_us, now_us)
        self._common_us = common_us
        self._go_on(latched, bool(told))
        return True

    def stamp(self, drive: int, after_us: float) -> int:
        """What to tell a drive (0x1013) `after_us` after the last SYNC, which it has answered."""
        drift = float(self.drift[drive])
        periods = min(max(1.0, 2 * NEAR // max(abs(drift), 1e-9)), MOST_PERIODS)
        ahead_us = -drift * (after_us + periods * self._period_us / 2)
        return round(self._sync_us + float(self._kept_us[drive]) + ahead_us) % WRAP_US

    def wants_stamp(self, drive: int) -> bool:
        """Whether a drive has to be corrected now, or will be off before it can be again."""
        if self._shown[drive] is None:
            return False
        error_us = self._error_us(drive)
        until_us = error_us + float(self.drift[drive]) * self._period_us
        near_us = 1.2 * NEAR * self._period_us + TICK_US / 2
        return not self.steady or max(abs(error_us), abs(until_us)) > near_us

    def told(self, drive: int) -> int | None:
        """What its clock was at the last SYNC, before it is corrected, whoever has told of it."""
        shown = self._shown[drive]
        known = shown is not None and self._at_us[drive] == self._common_us
        return round(shown) % WRAP_US if known and shown is not None else None

    def corrected(self, drive: int, stamp: int) -> None:
        """The drive has got its stamp of the last SYNC."""
        self._shown[drive] = stamp

    def keep(self) -> None:
        """The last SYNC was the zero of a path: from there the drives go on as they were.

        The time of a path is that of the drive's clock since its zero, so putting right what a
        clock was off at the zero would put the path out of step by just that.
        """
        for drive in range(len(self._shown)):
            if self.told(drive) is not None:
                self._kept_us[drive] += self._error_us(drive)
        self.offset_us[:] = 0.0

    def release(self) -> None:
        """No path any more: all drives go back to the master's time."""
        self._kept_us[:] = 0.0

    # ------------------------------------------------------------------ inside

    def _error_us(self, drive: int) -> float:
        return wrapped((self._shown[drive] or 0) - self._sync_us - float(self._kept_us[drive]))

    def _common_at(self, host_us: float) -> float:
        """The common clock by the host's, near the last SYNC."""
        return self._common_us + (host_us - self._sync_host_us) * (1 + self._rate)

    def _doubtful(self, told_us: Sequence[float], common_us: float, host_us: float) -> bool:
        """Whether the few that have told may be wrong. Of three the median is believed, and all
        that there are."""
        known = sum(shown is not None for shown in self._shown)
        if len(told_us) > 2 or len(told_us) == known or not self.steady:
            return False
        off_us = abs(common_us - self._common_at(host_us))
        noise_us = max(DOUBT_NOISE * self.noise_us, DOUBT_FLOOR_US)
        return max(told_us) - min(told_us) > DOUBT_US or off_us > noise_us

    def _compare(
        self, latched: Sequence[int | None], drives: Sequence[int], common_us: float
    ) -> None:
        """How far the quartzes of these drives differ from the rate of the common clock."""
        for drive in drives if len(drives) > 1 else ():
            clock, passed_us = latched[drive], common_us - float(self._at_us[drive])
            if clock is None or passed_us <= 0:
                continue
            rate = wrapped(clock - (self._shown[drive] or 0)) / passed_us - 1
            if abs(rate) > 2 * MAX_DRIFT:
                continue  # no two quartzes differ so much: one has jumped
            count = self._compared[drive] = self._compared[drive] + 1
            bend = rate - float(self._faster[drive])
            if count > MIN_FIT:
                bend = min(max(bend, -BEND), BEND)
            self._faster[drive] += max(1 / count, LEARN) * bend

    def _count_master(
        self, clock: int | None, counted: bool, common_us: float, now_us: float
    ) -> float:
        """The time by the clock of the drive that is the master, as it has told or follows."""
        assert self._master is not None
        shown = self._shown[self._master]
        if clock is not None:
            self._free_us += clock if shown is None else wrapped(clock - shown)
        elif shown is not None and counted:
            passed_us = common_us - float(self._at_us[self._master])
            self._free_us += passed_us * (1 + float(self._faster[self._master]))
        else:
            return now_us
        return self._free_us

    def _go_on(self, latched: Sequence[int | None], counted: bool) -> None:
        """What each clock was at this SYNC, as it has told or as it follows."""
        for drive, clock in enumerate(latched):
            shown = self._shown[drive]
            if clock is not None:
                self._shown[drive] = clock
                self.offset_us[drive] = self._error_us(drive)
            elif shown is not None and counted:
                passed_us = self._common_us - float(self._at_us[drive])
                self._shown[drive] = shown + passed_us * (1 + float(self._faster[drive]))
            else:
                continue
            self._at_us[drive] = self._common_us

    def _slew(self, due_us: float) -> float:
        """The master's time, due to be `due_us`, on its way to that of the lines."""
        most_us = self._period_us * (SLEW if len(self._seen) >= EARLY else EARLY_SLEW)
        return due_us + min(most_us, max(-most_us, self._sync_host_us - due_us))

    def _fit(self) -> None:
        """How far the common clock is ahead of the host, over the host's time."""
        if len(self._seen) < MIN_FIT:
            return
        seen = np.array(self._seen)
        x, ahead = seen[:, 0] - seen[-1, 0], seen[:, 1] - seen[:, 0]
        noise = ahead - self._rate * x
        deviation = np.abs(noise - _median(noise))
        self.noise_us = float(_median(deviation))
        good = deviation <= max(OUTLIER * self.noise_us, OUTLIER_FLOOR_US)
        self.outliers += int(not good[-1])
        x, ahead = x[good], ahead[good]
        middle, dx = float(ahead.mean()), x - x.mean()
        slope = float((dx * (ahead - middle)).sum() / (dx * dx).sum())
        self._rate = min(max(slope, -MAX_DRIFT), MAX_DRIFT)
        self._line = float(seen[-1, 0]), middle - self._rate * float(x.mean())


def time_of_day(unix_s: float) -> bytes:
    """The six bytes of TIME (CiA 301, TIME_OF_DAY): ms since midnight, days since 1984-01-01."""
    days, seconds = divmod(unix_s - _SECONDS_TO_1984, 86_400)
    return (int(seconds * 1000) & 0x0FFF_FFFF).to_bytes(4, "little") + int(days).to_bytes(
        2, "little"
    )
