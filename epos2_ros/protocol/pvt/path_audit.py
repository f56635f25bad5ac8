"""Whether a drive executes what it was sent, looked at at every SYNC.

The drive answers each SYNC with its position demand (TPDO4), and says what its motion clock was
then when it is asked (0x1013). Path time begins at the start SYNC and goes by the drive's own clock
(application note, 2.4), so the clock says to a microsecond where on the path the drive has to be,
however late the host has seen the SYNC; and the records that were sent say what the demand is
there, to a count. That a drive's clock is right is the timekeeper's to say, not looked at here.

How far off is wrong. The demand has to be that of a control cycle of the drive, a whole millisecond
k of the path on an EPOS2, within ROUNDING_QC and the tolerance of the records. Which cycle, no
document says exactly: READING: CiA 301 has a synchronous TPDO sampled at the SYNC, the note has
motion begin with it; a drive may begin with its next cycle and sample in another. So there is a
delay between SYNC and sample, unknown but the same at every SYNC: at first anything up to
MAX_DELAY_US either way, then what the answers so far leave of that. An axis can be off unnoticed by
its velocity times what is left, at least one control cycle and 2 · JITTER_US, and by tolerance and
rounding. READING: a drive whose cycles do not go by the path's clock (Copley's are 4 kHz) samples
at any time of one, and that time wanders.

Which SYNC an answer belongs to. A clock counts only when it was asked for after that SYNC. TPDO4
doesn't say it: it is taken for the answer to the same SYNC where both came between the same two
SYNCs, in whatever order; where the clock was not read, the demand is not judged. Where one of the
SYNCs before is without an answer, it might be that one, late; then the next is believed. So lost,
late and repeated answers do no harm; too many in a row are told.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections import deque
from collections.abc import Sequence

from epos2_ros.motion.pvt import Cubic
from epos2_ros.motion.record import Record
from epos2_ros.protocol.clock import wrapped

ROUNDING_QC = 1.0  # the demand in whole counts, rounded or cut off
MAX_DELAY_US = 2_000.0  # from SYNC to sample, or of the start after its SYNC; a cycle for each
JITTER_US = 100.0  # of that delay; twice the coarsest clock (a bit time at 20 kbit/s) is included
MISSED_ANSWERS = 3  # in a row, …
MISSED_ANSWERS_US = 500_000.0  # … and for so long: something is wrong with a drive's answers
LATE_SYNCS = 4  # an answer may be to one so many SYNCs ago
STAMP_NOISE_US = 1_000.0  # a frame with a time stamp so much before a SYNC was before it
_REMEMBERED = 8  # SYNCs, and answers that wait for the other
_KEPT_MS = 3_000  # of the executed path, for answers that come late


def patience_syncs(sync_period_us: float) -> int:
    """How many SYNCs in a row a drive may leave without an answer."""
    return max(MISSED_ANSWERS, math.ceil(MISSED_ANSWERS_US / sync_period_us))


class PathAudit:
    """Of one drive: through a motion and the rest before and after. Positions are qc, times µs.

    `tolerance_qc`: how far off its records an axis may be besides rounding; `cycle_us`: of control,
    `free` where it does not go by the path's clock.
    """

    def __init__(
        self,
        velocity_unit_qc_s: float,
        tolerance_qc: float,
        sync_period_us: float,
        cycle_us: float = 1000.0,
        free: bool = False,
    ) -> None:
        self._cycle_us = cycle_us
        self._wanders_us = cycle_us if free else 0.0
        self._unit_qc_s = velocity_unit_qc_s
        self._allowed_qc = tolerance_qc + ROUNDING_QC
        self._period_us = sync_period_us
        self._syncs: deque[tuple[int, float]] = deque(maxlen=_REMEMBERED)  # number, host time
        self.rest(0)

    def rest(self, position_qc: int) -> None:
        """The drive stands there; what is sent from now on leads away from it."""
        self._knot = Record(position_qc, 0, 0)  # the last that was sent
        self._start_qc = position_qc
        self._ends_ms: list[int] = []  # of the segments in `_cubics`
        self._cubics: list[list[float]] = []  # coefficients, as in `Cubic`
        self._committed_ms = 0
        self._ended = True
        self._forgot = False  # segments dropped from the head of both
        self._start: tuple[int, float] | None = None  # the start SYNC
        self._late_start_us = 0.0  # path time at the SYNC after it
        self._latched = 0  # the clock at the last SYNC that was answered, …
        self._path_us = 0.0  # … and path time then
        self._zeroed = False  # path time is known since the start SYNC
        self._clocks_us: dict[int, float] = {}  # path time at SYNCs without a demand yet
        self._demands_qc: dict[int, list[int]] = {}  # at SYNCs without path time yet
        self._known_us: deque[float] = deque(maxlen=LATE_SYNCS + 1)  # at SYNCs, newest first
        self._least_us, self._most_us = -MAX_DELAY_US, MAX_DELAY_US  # the delay
        self._follows = False  # it was once where only a drive on its path can be
        self._open: deque[int] = deque()  # of the last SYNCs those without an answer that fits
        self._misfit: set[int] | None = None  # how many SYNCs late the last may be that didn't fit
        self._unanswered, self._unanswered_us = 0, math.inf

    def send(self, record: Record) -> None:
        """A record was handed to the bus."""
        self._ended = record.time == 0
        if self._ended:
            return
        duration_s = record.time * 1e-3
        last, unit = self._knot, self._unit_qc_s
        cubic = Cubic.between(
            last.position, last.velocity * unit, record.position, record.velocity * unit, duration_s
        )
        self._committed_ms += record.time
        self._cubics.append([float(coefficient) for coefficient in cubic])
        self._ends_ms.append(self._committed_ms)
        self._knot = record

    def demand(self, path_ms: float) -> tuple[float, float]:
        """Position [qc] and velocity [qc/s] of the demand at a path time, also between cycles.

        Before the start and after the last record it rests. A drive that is ahead of its path, or
        behind it, by all its answers so far, is taken to be so by the least that explains them.
        """
        if self._follows:
            path_ms += max(0.0, self._least_us + JITTER_US) / 1000
            path_ms += min(0.0, self._most_us - JITTER_US) / 1000
        index = bisect_left(self._ends_ms, path_ms)
        if path_ms <= 0 or index == len(self._ends_ms):
            return float(self._start_qc if path_ms <= 0 else self._knot.position), 0.0
        t_s = (path_ms - self._ends_ms[index]) * 1e-3
        a, b, c, d = self._cubics[index]
        return ((a * t_s + b) * t_s + c) * t_s + d, (3 * a * t_s + 2 * b) * t_s + c

    # ------------------------------------------------------------------ what was on the bus

    def on_sync(self, t_us: float, starts: bool) -> str:
        """A SYNC was on the bus, the one that starts the motion if so; what is wrong, or ""."""
        number = self._syncs[-1][0] + 1 if self._syncs else 0
        self._syncs.append((number, t_us))
        self._open.append(number)
        if self._open[0] < number - LATE_SYNCS:
            self._open.popleft()
        if starts:
            self._start = number, t_us
        elif self._start and not self._late_start_us:
            self._late_start_us = t_us - self._start[1]
        if not self._unanswered:
            self._unanswered_us = t_us
        self._unanswered += 1
        unanswered = self._unanswered - 1  # the last may still be
        since_us = t_us - self._unanswered_us + STAMP_NOISE_US
        if unanswered < MISSED_ANSWERS or since_us < MISSED_ANSWERS_US:
            return ""
        return f"{unanswered} SYNCs in a row without its position demand"

    def on_clock(self, latched: int, t_us: float) -> str:
        """What the drive's clock was at a SYNC; what is wrong with its demand then, or ""."""
        number, sync_us = self._sync_before(t_us)
        passed_us = wrapped(latched - self._latched)
        self._latched = latched
        if self._start is None or number < self._start[0]:
            return ""
        if number == self._start[0] and (passed_us > 0 or not self._zeroed):
            self._path_us, self._zeroed = 0.0, True
        elif not self._zeroed:
            # The answer to the start SYNC is lost: the host's times have to do.
            self._path_us, self._zeroed = sync_us - self._start[1], True
            self._least_us, self._most_us = -self._period_us / 2, self._period_us / 2
        else:
            self._path_us += passed_us
        self._clocks_us[number] = self._path_us
        self._known_us.appendleft(self._path_us)
        return self._judge(number)

    def on_demand(self, demand_qc: int, t_us: float) -> str:
        """The position demand at a SYNC (TPDO4); what is wrong with it, or ""."""
        number, _ = self._sync_before(t_us)
        if number < 0:
            return ""
        if self._start is None or number < self._start[0] or not self._cubics:
            off_qc = demand_qc - self._start_qc
            if abs(off_qc) <= self._allowed_qc:
                self._answered(number)
                return ""
            return f"its demand has moved by {off_qc} qc while it was to stand"
        self._unanswered = 0
        self._demands_qc.setdefault(number, []).append(demand_qc)
        return self._judge(number)

    def _judge(self, number: int) -> str:
        """Once both are known of a SYNC; what is wrong, or ""."""
        if number not in self._clocks_us or number not in self._demands_qc:
            return ""
        path_us, demands_qc = self._clocks_us.pop(number), self._demands_qc.pop(number)
        for known in (self._clocks_us, self._demands_qc):
            for older in [n for n in known if n < number - _REMEMBERED]:
                del known[older]
        for demand_qc in demands_qc:
            cycles = self._cycles(path_us, demand_qc, self._least_us, self._most_us)
            if cycles is not None:
                break
        else:
            open_before = any(before < number for before in self._open)
            misfit, self._misfit = self._misfit, self._late_by(demand_qc)
            if self._follows and open_before and misfit is None:
                return ""
            if self._misfit & (misfit or set()):
                return "its answers to SYNC come late"
            return self._complaint(path_us, demand_qc)
        self._misfit = None
        self._answered(number)
        first, last = cycles
        cycle_us, play_us = self._cycle_us, JITTER_US + self._wanders_us
        self._least_us = max(self._least_us, cycle_us * first - path_us - play_us)
        self._most_us = min(self._most_us, cycle_us * (last + 1) - path_us + play_us)
        self._follows = self._follows or not self._started_late(path_us, demand_qc)
        self._forget(int(path_us / 1000) - _KEPT_MS)
        return ""

    def _late_by(self, demand_qc: int) -> set[int]:
        """Of how many SYNCs before a demand may be that does not fit the last one."""
        return {
            syncs
            for syncs, path_us in enumerate(self._known_us)
            if syncs and self._cycles(path_us, demand_qc, self._least_us, self._most_us)
        }

    def _answered(self, number: int) -> None:
        self._unanswered = 0
        if number in self._open:
            self._open.remove(number)

    def _sync_before(self, t_us: float) -> tuple[int, float]:
        """Number and host time of the last SYNC that is known to have been before `t_us`.

        A frame that the host has got after a SYNC was after it, but for what its stamp says.
        """
        for number, sync_us in reversed(self._syncs):
            if t_us > sync_us - STAMP_NOISE_US:
                return number, sync_us
        return -1, math.nan

    # ------------------------------------------------------------------ the path

    def _position_qc(self, k_ms: float) -> float:
        """The demand at a path time; NaN where it is not known (any more, or yet)."""
        if k_ms <= 0:
            return float(self._start_qc)
        index = bisect_left(self._ends_ms, k_ms)
        if index == len(self._ends_ms):
            return float(self._knot.position) if self._ended else math.nan
        if index == 0 and self._forgot:
            return math.nan
        t_s = (k_ms - self._ends_ms[index]) * 1e-3
        a, b, c, d = self._cubics[index]
        return ((a * t_s + b) * t_s + c) * t_s + d

    def _cycles(
        self, path_us: float, demand_qc: int, least_us: float, most_us: float
    ) -> tuple[int, int] | None:
        """First and last cycle within a delay's reach whose demand this could be."""
        cycle_us = self._cycle_us
        first = math.floor((path_us + least_us - JITTER_US) / cycle_us)
        last = math.floor((path_us + most_us + JITTER_US) / cycle_us)
        cycles = 2 if self._wanders_us else 1  # at both ends of one, or at its beginning
        path = [self._position_qc(k * cycle_us / 1000) for k in range(first, last + 1 + cycles)]
        fitting = [
            first + i
            for i in range(last + 1 - first)
            if self._may_be(demand_qc, path[i : i + cycles])
        ]
        return (fitting[0], fitting[-1]) if fitting else None

    def _may_be(self, demand_qc: int, path: Sequence[float]) -> bool:
        """Whether the demand can be between these positions; it can where one is unknown."""
        if any(map(math.isnan, path)):
            return True
        return min(path) - self._allowed_qc <= demand_qc <= max(path) + self._allowed_qc

    def _started_late(self, path_us: float, demand_qc: int) -> bool:
        """Whether the demand is that of a drive that started with the SYNC after the start's."""
        at_us = path_us - self._late_start_us
        return self._cycles(at_us, demand_qc, -MAX_DELAY_US, MAX_DELAY_US) is not None

    def _complaint(self, path_us: float, demand_qc: int) -> str:
        off_qc = abs(demand_qc - self._position_qc(math.floor(path_us / 1000)))
        text = f"its demand is {off_qc:.0f} qc off its path: "
        if self._follows:
            return text + "a record was lost, repeated or altered"
        if abs(demand_qc - self._start_qc) <= self._allowed_qc:
            return text + "it has not started with the start SYNC"
        if self._late_start_us and self._started_late(path_us, demand_qc):
            return text + "it started one SYNC late"
        return text + (
            "a record was lost, repeated or altered, or the drive goes by another velocity "
            "notation, polarity or interpolation than it was told"
        )

    def _forget(self, before_ms: int) -> None:
        """Drop what ended long ago, but the last segment: hours of motion need no memory."""
        gone = min(bisect_left(self._ends_ms, before_ms), len(self._ends_ms) - 1)
        if gone > 64:
            self._forgot = True
            del self._ends_ms[:gone], self._cubics[:gone]
