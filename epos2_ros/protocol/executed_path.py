"""Where an axis has been: what it was to do, put right by where it was at every SYNC.

Between two SYNCs the demand is known exactly (the records that were sent, or the profile the drive
makes of a set-point), and at each of them the drive says where the axis really is. An axis that
follows its demand is late by a nearly constant time, the following error over the velocity; so in
between it is taken to have followed the demand with that delay, and to have been where the drive
said at both ends. Without a demand (halted, moved by hand) the samples alone are joined.
"""

from __future__ import annotations

import numpy as np

from epos2_ros.motion.crossings import FloatArray, Path
from epos2_ros.motion.record import Record

MAX_DELAY_US = 20_000.0
MAX_AGE_US = 100_000.0  # of what a drive says at a SYNC; most of it by hosts that see SYNC late
MIN_SPEED_QC_S = 20_000.0  # below, times are not to be seen in whole counts
_SEARCH_US = 1_000.0
_NEAREST = 0.499


class Demand:
    """The commanded path of one motion, growing; it rests before and after."""

    def __init__(self, path: Path) -> None:
        self._t_us = list(path.t_us)
        self._position = list(path.position_qc)
        self._velocity = list(path.velocity_qc_s)

    @classmethod
    def resting(cls, position_qc: float, from_us: float) -> Demand:
        """Where a motion of records begins."""
        return cls(Path(np.array([from_us]), np.array([position_qc]), np.zeros(1)))

    def add(self, record: Record, velocity_unit_qc_s: float) -> None:
        """One more segment; the record that ends the motion adds nothing."""
        if record.time:
            self._t_us.append(self._t_us[-1] + 1000.0 * record.time)
            self._position.append(float(record.position))
            self._velocity.append(record.velocity * velocity_unit_qc_s)

    def shift(self, by_us: float) -> None:
        """All of it so much later: the clock that it goes by does not go as the host's."""
        self._t_us = [t_us + by_us for t_us in self._t_us]

    def at(self, t_us: float) -> tuple[float, float]:
        """Position [qc] and velocity [qc/s]."""
        path = self.between(t_us, t_us)
        return float(path.position_qc[0]), float(path.velocity_qc_s[0])

    def when(self, position_qc: int, near_us: float) -> float | None:
        """The time nearest to `near_us` at which it was there; None where that is not clear."""
        now_qc, velocity = self.at(near_us)
        slow = abs(velocity) < MIN_SPEED_QC_S
        if slow and abs(now_qc - position_qc) <= 1:
            return None
        times = near_us + np.arange(-MAX_AGE_US, MAX_AGE_US + _SEARCH_US, _SEARCH_US)
        off = self._evaluate(times)[0] - position_qc
        passed = np.flatnonzero((off[:-1] <= 0) != (off[1:] <= 0))
        if not len(passed):
            return None
        i = passed[np.argmin(np.abs(times[passed] - near_us))]
        t_us = float(times[i] - off[i] / (off[i + 1] - off[i]) * _SEARCH_US)
        position, velocity = self.at(t_us)
        if abs(velocity) < MIN_SPEED_QC_S:
            return t_us
        return t_us + (position_qc - position) / velocity * 1e6

    def between(self, begin_us: float, end_us: float) -> Path:
        """This part of it: its knots inside, and both ends."""
        t = np.array(self._t_us)
        inside = t[(t > begin_us) & (t < end_us)]
        times = np.unique(np.concatenate([[begin_us], inside, [end_us]]))
        return Path(times, *self._evaluate(times))

    def _evaluate(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Positions [qc] and velocities [qc/s]."""
        t = np.array(self._t_us)
        i = np.clip(np.searchsorted(t, times, side="right") - 1, 0, max(len(t) - 2, 0))
        j = np.minimum(i + 1, len(t) - 1)
        p, v = np.array(self._position), np.array(self._velocity)
        h = np.where(j > i, (t[j] - t[i]) * 1e-6, 1.0)
        u = np.clip((times - t[i]) * 1e-6 / h, 0.0, 1.0)
        moving = (times >= t[0]) & (times < t[-1])
        position = (
            p[i]
            + u * h * v[i]
            + u**2 * (3 * (p[j] - p[i]) - h * (2 * v[i] + v[j]))
            + u**3 * (2 * (p[i] - p[j]) + h * (v[i] + v[j]))
        )
        velocity = (
            v[i]
            + 2 * u * (3 * (p[j] - p[i]) / h - (2 * v[i] + v[j]))
            + 3 * u**2 * (2 * (p[i] - p[j]) / h + v[i] + v[j])
        )
        return position, np.where(moving, velocity, 0.0)

    def forget(self, before_us: float) -> None:
        """Drop what is not needed any more."""
        while len(self._t_us) > 2 and self._t_us[1] < before_us:
            del self._t_us[0], self._position[0], self._velocity[0]


class ExecutedPath:
    """The path of one axis, piece by piece from sample to sample."""

    def __init__(self) -> None:
        self.delay_us = 0.0
        self.commanded: Path | None = None  # over the time of the last piece
        self._t_us: float | None = None
        self._position = 0.0
        self._velocity = 0.0

    def sample(
        self, t_us: float, position_qc: int, velocity_qc_s: float, demand: Demand | None
    ) -> Path | None:
        """The axis was there at `t_us`; the piece since the last sample, None at the first.

        `demand` is what it was to do in between, if that is known.
        """
        since_us, before, speed = self._t_us, self._position, self._velocity
        if since_us is not None and t_us <= since_us:
            return None
        self._t_us, self._position, self._velocity = t_us, float(position_qc), velocity_qc_s
        if since_us is None:
            return None
        if demand is None:
            ends = np.array([before, self._position])
            times, speeds = np.array([since_us, t_us]), np.array([speed, velocity_qc_s])
            self.commanded = Path(times, ends, speeds)
            return self.commanded
        self.commanded = demand.between(since_us, t_us)
        self._measure_delay(t_us, position_qc, demand)
        late = demand.between(since_us - self.delay_us, t_us - self.delay_us)
        demand.forget(since_us - 2 * MAX_DELAY_US)
        begin, end = float(late.position_qc[0]), float(late.position_qc[-1])
        # A whole count stands for all positions that are nearest to it.
        self._position = float(np.clip(end, position_qc - _NEAREST, position_qc + _NEAREST))
        slope = (self._position - end - (before - begin)) / (t_us - since_us)
        times = late.t_us + self.delay_us
        times[0], times[-1] = since_us, t_us
        position = late.position_qc + before - begin + slope * (times - since_us)
        position[0], position[-1] = before, self._position
        return Path(times, position, late.velocity_qc_s + slope * 1e6)

    def _measure_delay(self, t_us: float, position_qc: int, demand: Demand) -> None:
        position, velocity = demand.at(t_us)
        if abs(velocity) >= MIN_SPEED_QC_S:
            delay_us = (position - position_qc) / velocity * 1e6
            self.delay_us = float(np.clip(delay_us, -MAX_DELAY_US, MAX_DELAY_US))
