"""TIME, SYNC, the time stamps that follow each SYNC, and the host's heartbeat.

After a SYNC an EPOS2 is asked by SDO what its clock was at it (0x1013): by maxon's EDS of 2011
and 2013 no PDO can carry it to the host. Copley's say it in one. One drive tells when the SYNC
was, and that what all clocks were (`clock`): so they are asked in turn, one at a SYNC, now and then
another beside it, so that their quartzes can be compared; and all of them, at once, while that is
not known yet, where a path begins, and where what was told is in doubt. No more than READ_SHARE of
the bus is taken for it; at the SYNCs between the clocks run on, uncorrected.
READING: the latched time that is read is not moved by the correction that follows it.

One correction per SYNC and drive (application note, 2.4), and only for a drive that has answered
the SYNC (by a PDO): a stamp for a SYNC that it missed would move it by a whole period. A SYNC goes
out when the stamps of the last one are seen on the bus, or a drive could take a stamp for that of
the next.

Fast drives are corrected right after the SYNC, slow ones half a period later. Fast and slow drives
part the fastest; so the distance between any two never grows for longer than half a period.

With a drive as clock master ("Motion Synchronisation") the host sends no time stamps: the others
take the master's answer to the SYNC. With a drive as SYNC producer the host sends no SYNC, but
notes the time of each.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from statistics import fmean, median

from epos2_ros.protocol import epos2
from epos2_ros.protocol.clock import MAX_DRIFT, WINDOW, MasterClock
from epos2_ros.protocol.drive import Drive
from epos2_ros.protocol.frame import Frame
from epos2_ros.protocol.outbox import Outbox, Poll
from epos2_ros.protocol.pvt.path_audit import patience_syncs

HEARTBEAT_PERIOD_US = 80_000.0  # of the host; the drives watch it for 0.5 s (0x1016)
HOST_NODE_ID = 127
OPERATIONAL = b"\x05"
ANSWER_US = 500.0  # per axis, for its two synchronous TPDOs, before the next SYNC
ANSWER_BITS, ANSWERS_SHARE = 135, 0.3  # no more of the bus is taken for SYNC and its answers
READ_BITS = 250  # to read a drive's clock: two SDO frames
READ_SHARE = 0.05  # of the bus, for all drives
CLOCK_ROUND_US = 1_000_000.0  # within so long each is asked once, if the bus can take that, …
LONGEST_ROUND_US = 1_600_000.0  # … and within this whatever it takes
PAIR_EVERY = 10  # reads of one drive; then of two together
EARLY_SHARE = 0.25  # of the period, by which it may be more: SYNCs come when they can
FOLLOW_UP_US = 40_000.0  # the time stamps wait no longer for a drive's answer, …
FOLLOW_UP_SHARE = 0.4  # … and no longer than this share of the period
LEAD_US = 20_000.0  # before a SYNC at a given time: what is to be on the bus before it is sent
ASTRAY_US = 1_000.0  # a clock so far from the others' is off …
LATE_US = 5_000.0  # … unless it is, within this, what it was at one of the SYNCs before
UNREAD_US = ASTRAY_US / MAX_DRIFT  # by now a clock may be so far off that is not read
_LATE = "its answers to SYNC come late"
_REMEMBERED = 8  # SYNCs
MISSED_SYNCS = 5  # so many periods without the SYNC of a drive, …
SYNC_SILENCE_US = 1_000_000.0  # … and at least so long: it does not come any more


class Timekeeper:
    """Keeps the clocks of `drives` together; puts frames and polls into `out`. Times are host µs.

    `master`: the drive that is the clock master; None: the host. `producer`: the one that sends
    SYNC; None: the host. `answering`: how many drives answer a SYNC. `guarded`: those that watch
    the host by life guarding, and have to be asked with each of its heartbeats.
    """

    def __init__(
        self,
        drives: Sequence[Drive],
        answering: int,
        period_us: float,
        bitrate: int,
        out: Outbox,
        master: Drive | None = None,
        producer: Drive | None = None,
        guarded: Sequence[Drive] = (),
    ) -> None:
        self._guarded = [drive.node_id for drive in guarded]
        self.drives = tuple(drives)
        self.period_us = period_us
        self.producer = producer
        master_index = None if master is None else self.drives.index(master)
        self._asked = [n for n, drive in enumerate(self.drives) if not drive.tells_clock]
        read_us = READ_BITS / READ_SHARE / bitrate * 1e6  # from one to the next, on average
        corrected_us = period_us * max(1, math.ceil(read_us / period_us - EARLY_SHARE))
        self._pause_us = max(read_us, corrected_us) if self._asked else 0.0
        self._affords_all = len(self._asked) * read_us <= period_us
        self._each = _each(len(self._asked), corrected_us, read_us)
        self._read_due_us = -math.inf  # the next SYNC at which clocks are read
        self._turn = self._pairs = 0  # whose turn it is to be asked, and how often two were
        self._told_by: set[int] = set()  # who is to tell of the last SYNC
        self._ask_all = True  # at the next SYNC
        self.clock = MasterClock(len(drives), corrected_us, master_index)
        self.sync_count = 0
        self.often_us = math.inf  # from SYNC to SYNC, where the period is too long, …
        self._least_us = ANSWER_BITS * (answering + 1) / ANSWERS_SHARE / bitrate * 1e6  # … at least
        self._master = master_index
        self._answering = answering
        self._out = out
        self._last_sync_us = -math.inf
        self._handed_over_us = -math.inf  # when it was, if it is ours
        self._delays_us: deque[float] = deque(maxlen=WINDOW)  # from there until the host saw it
        self._sync_due_us = math.inf
        self._heartbeat_due_us = math.inf
        self._path_sync_us = math.inf  # from this SYNC on a path is about to begin
        self._begins_path = False  # the last SYNC did
        self.path_began_us: float | None = None  # when it was, by the drives' clocks
        self._patience = patience_syncs(period_us)
        self._syncs_us: deque[float] = deque(maxlen=_REMEMBERED)  # before the last
        self._missed = [0] * len(drives)  # SYNCs in a row without an answer that can be of them
        self._stray = [""] * len(drives)  # what was wrong with the last answer that can't
        self._off_us = [0.0] * len(drives)  # of each clock, from the others' at the last SYNC
        self._read_us = [-math.inf] * len(drives)  # the last SYNC whose clock each has told, …
        self._unread_us = [0.0] * len(drives)  # … and how long before the last read that was
        self.well = True  # no drive has trouble with its clock, not even by what counts in motion
        self._sees_syncs = self.produces
        self._reads = False  # the clocks at the last SYNC count
        self._forget()

    def _forget(self) -> None:
        """Nothing is on its way."""
        self._syncing = False  # a SYNC was handed over and is not yet seen on the bus
        self._unstamped_us = math.inf  # when the SYNC was that awaits its time stamps
        self._asked_us = -math.inf  # when a drive was last asked for its clock at it
        self._latched: list[int | None] = [None] * len(self.drives)  # the answers to it
        self._ahead_us: dict[int, float] = {}  # how far each was from what the clock was to be
        self._slow: list[int] = []  # drives to be corrected half a period after the SYNC
        self._stamps: dict[int, int] = {}  # by drive: handed over, not yet seen on the bus
        self.followed: list[tuple[int, int]] = []  # what clocks were that were not asked for

    @property
    def produces(self) -> bool:
        """Whether the host sends SYNC."""
        return self.producer is None

    @property
    def running(self) -> bool:
        return self._heartbeat_due_us < math.inf

    def start(self, now_us: float, time_of_day: bytes, echoes: bool = True) -> None:
        """TIME sets every drive's motion clock to zero; SYNC and heartbeat begin.

        `echoes`: the adapter gives our own frames back, so that their times are known.
        """
        self._forget()
        self._sees_syncs = self.produces and echoes
        self._missed = [0] * len(self.drives)
        self._off_us = [0.0] * len(self.drives)
        self._read_us = [now_us] * len(self.drives)
        self._unread_us = [0.0] * len(self.drives)
        self.well = True
        self._syncs_us.clear()
        self._delays_us.clear()
        self._read_due_us, self._ask_all = now_us, True
        self._out.frames.append(Frame(epos2.TIME, time_of_day))
        if self.produces:
            self._sync_due_us = now_us + self.period_us
        self._last_sync_us = now_us
        self._heartbeat_due_us = now_us

    # ------------------------------------------------------------------ what was on the bus

    def on_sync(self, t_us: float, begins_path: bool = False) -> None:
        """A SYNC was on the bus; the drives are asked what their clocks were, if that is due."""
        self._forget()
        self.sync_count += 1
        self._delays_us.append(t_us - self._handed_over_us)
        self._syncs_us.appendleft(self._last_sync_us)
        self._last_sync_us = t_us
        self._begins_path = begins_path
        self._reads = self._reads_at(t_us)
        if self._reads:
            self._unstamped_us = t_us
            self._read_due_us = t_us + self._pause_us
            asked = self._whom()
            tell = set(range(len(self.drives))).difference(self._asked)
            self._told_by = tell.union(asked)
            if asked:
                node_ids = tuple(self.drives[drive].node_id for drive in asked)
                self._out.polls.append(Poll(node_ids, epos2.CLOCK_AT_SYNC))
        if begins_path:
            self._path_sync_us, self.path_began_us = math.inf, None

    def _reads_at(self, sync_us: float) -> bool:
        """Whether clocks are read at this SYNC: at each, if the bus can take that."""
        early_us = EARLY_SHARE * self.period_us
        return self._asks_all or sync_us >= self._read_due_us - early_us

    @property
    def _asks_all(self) -> bool:
        """While the quartzes are not known, where a path begins and before, where what was told is
        in doubt; and where a drive is the clock master: it corrects the others at each SYNC."""
        begins = self._begins_path or self._last_sync_us >= self._path_sync_us - 2 * self.period_us
        unknown = not self.clock.settled or (self._affords_all and not self.clock.steady)
        return unknown or self._ask_all or begins or self._master is not None

    def _whom(self) -> Sequence[int]:
        """The drives that are asked at this SYNC, of those that have to be."""
        asked = self._asked
        if self._asks_all or len(asked) < 2:
            return asked
        count = self._each if self.clock.steady else max(self._each, 2)
        self._turn += count
        drives = [asked[(self._turn - n) % len(asked)] for n in range(count)]
        if count == 1 and len(asked) == len(self.drives) and self._turn % PAIR_EVERY == 0:
            self._pairs += 1
            other = 1 + self._pairs % (len(asked) - 1)
            drives.append(asked[(self._turn + other) % len(asked)])
        return drives

    def disturbed(self) -> None:
        """A SYNC or TIME of another host was on the bus: it has latched or set the drives' clocks,
        so that a stamp of our last SYNC puts them wrong. What they were before does not count."""
        self._forget()
        self.clock.begin_anew()

    def on_asked(self, t_us: float) -> None:
        """The request to a drive for its clock was on the bus."""
        self._asked_us = t_us

    def on_answer(self, drive: int, latched: int, now_us: float) -> bool:
        """A drive has answered a SYNC with what its clock was then; False: not the last one."""
        if self._unstamped_us == math.inf:
            if self._reads and self._latched[drive] is None:
                self._stray[drive] = _LATE
                return False
            return True
        ahead_us = self.clock.ahead_us(drive, latched, self._unstamped_us)
        if any(
            abs(self.clock.ahead_us(drive, latched, sync_us)) < min(LATE_US, abs(ahead_us))
            for sync_us in self._syncs_us
        ):
            self._stray[drive] = _LATE
            return False
        self._ahead_us[drive] = ahead_us
        if abs(ahead_us) > (self._unstamped_us - self._syncs_us[0]) / 2:
            self._stray[drive] = f"its clock is off by {ahead_us / 1000:+.1f} ms"
            return True
        self._missed[drive], self._stray[drive] = 0, ""
        self._read_us[drive] = self._unstamped_us
        self._latched[drive] = latched
        return True

    def on_stamp(self, drive: int) -> None:
        """A drive has got its time stamp."""
        if drive in self._stamps:
            self.clock.corrected(drive, self._stamps.pop(drive))

    # ------------------------------------------------------------------ what is due

    def advance(self, now_us: float, may_sync: bool) -> None:
        """Send what is due; `may_sync` says whether a SYNC may go out now."""
        if now_us >= self._follow_up_due_us or self._all_told:
            self._follow_up(now_us)
        if self._slow and now_us >= self._slow_due_us:
            slow, self._slow = self._slow, []
            self._correct(slow, now_us)
        if now_us >= self._heartbeat_due_us:
            self._out.frames.append(Frame(epos2.HEARTBEAT + HOST_NODE_ID, OPERATIONAL))
            for node_id in self._guarded:
                self._out.frames.append(Frame(epos2.HEARTBEAT + node_id, remote=True))
            self._heartbeat_due_us = now_us + HEARTBEAT_PERIOD_US
        if may_sync and self.clear and now_us >= self._next_due_us:
            self.sync(now_us)

    def deadline_us(self, may_sync: bool) -> float:
        """When `advance` is wanted next."""
        due = min(self._heartbeat_due_us, self._follow_up_due_us)
        if self._slow:
            due = min(due, self._slow_due_us)
        return min(due, self._next_due_us) if may_sync and self.clear else due

    @property
    def _next_due_us(self) -> float:
        """When a SYNC of ours goes out."""
        if self.often_us == math.inf or not self.produces:
            return self._sync_due_us
        return min(self._sync_due_us, self._last_sync_us + max(self.often_us, self._least_us))

    @property
    def clear(self) -> bool:
        """Whether a SYNC may follow: nothing that belongs to the last one is on its way."""
        return not self._syncing and self._unstamped_us == math.inf and not self._stamps

    @property
    def answered_us(self) -> float:
        """When the answers to the last SYNC are through: no other should go out before."""
        return self._last_sync_us + ANSWER_US * (self._answering + 1)

    @property
    def next_sync_us(self) -> float:
        """When the next SYNC of a drive is to be expected."""
        return self._last_sync_us + self.period_us

    @property
    def seen_late_us(self) -> float:
        """By how much the host may have seen the last SYNC too late.

        None of ours was on the bus before it was handed over: what it took longer than others from
        there until it was seen. Of a drive's nothing is known, nor of one of ours where the adapter
        does not give frames back: then `on_sync` gets when it should have been.
        """
        return self._delays_us[-1] - min(self._delays_us) if self._sees_syncs else math.inf

    @property
    def _line_late_us(self) -> float:
        """By how much SYNCs seen late may have moved the end of the clocks' lines.

        Of a line of least squares through n points each moves it by 4/n of its own at most.
        """
        if not self._sees_syncs:
            return math.inf
        return 4 * (fmean(self._delays_us) - min(self._delays_us))

    @staticmethod
    def shortest_period_us(axes: int) -> float:
        """Of a SYNC that a drive sends: between two the axes answer, and a start can be armed."""
        return ANSWER_US * (axes + 1) + 2 * LEAD_US

    def astray(self, drive: int) -> bool:
        """Whether a drive's clock is so far off that it can't be corrected, or may be."""
        return self._missed[drive] >= self._patience or self._unread_us[drive] > UNREAD_US

    def trouble(self, drive: int, in_motion: bool) -> str:
        """What is wrong with a drive's clock or its answers, or "".

        In motion a clock off by more than ASTRAY_US is: the axis is off its path with it.
        """
        if self._missed[drive] >= self._patience:
            return self._stray[drive]
        if self._unread_us[drive] > UNREAD_US:
            return f"its clock (0x1013) was not read for {self._unread_us[drive] / 1e6:.1f} s"
        off_us = max(self._off_us[drive], float(self.clock.offset_us[drive]), key=abs)
        if in_motion and abs(off_us) > ASTRAY_US:
            return f"its clock is off by {off_us / 1000:+.1f} ms"
        return ""

    @property
    def sync_patience_us(self) -> float:
        """After this without the SYNC of a drive it does not come any more."""
        return max(MISSED_SYNCS * self.period_us, SYNC_SILENCE_US)

    def sync(self, now_us: float) -> None:
        """A SYNC goes out; the period counts from it if it is out of turn.

        Who has no stamp of the last one by now gets none: it would take it for that of this one.
        """
        self._syncing = True
        self._handed_over_us = now_us
        self._slow = []
        self._out.frames.append(Frame(epos2.SYNC))
        self._sync_due_us += self.period_us
        if not now_us < self._sync_due_us <= now_us + self.period_us:
            self._sync_due_us = now_us + self.period_us
        if now_us < self._path_sync_us:
            self._sync_due_us = min(self._sync_due_us, self._path_sync_us)

    # ------------------------------------------------------------------ paths

    def before_path(self, sync_us: float) -> None:
        """A path is going to begin: a SYNC at `sync_us`, and the clocks as close as can be."""
        self._path_sync_us = sync_us
        if self.produces:
            self._sync_due_us = min(self._sync_due_us, sync_us)

    def after_path(self) -> None:
        """No path in progress or to come."""
        self._path_sync_us = math.inf
        self.clock.release()

    # ------------------------------------------------------------------ inside

    @property
    def _follow_up_due_us(self) -> float:
        if self._unstamped_us == math.inf:
            return math.inf
        wait_us = min(FOLLOW_UP_US, FOLLOW_UP_SHARE * self.period_us)
        if all(value is None for value in self._latched):
            wait_us *= 2  # there is nobody to correct yet
        return max(self._unstamped_us, self._asked_us) + wait_us

    @property
    def _all_told(self) -> bool:
        """Whether nothing is waited for any more before the time stamps."""
        return (
            self._unstamped_us < math.inf
            and all(self._latched[drive] is not None for drive in self._told_by)
            and not any(drive.unanswered for drive in self.drives)
        )

    @property
    def _slow_due_us(self) -> float:
        return self._last_sync_us + self.period_us / 2

    def _follow_up(self, now_us: float) -> None:
        """The drives have answered, or had their time: correct those that have."""
        if self._unstamped_us == math.inf:
            return
        told = [drive for drive, value in enumerate(self._latched) if value is not None]
        sure = self._take_in()
        self._unstamped_us = math.inf
        off = any(abs(off_us) > ASTRAY_US / 2 for off_us in self._off_us)
        self._ask_all = not sure or not told or off or any(self._stray)
        if self._master is not None:
            stamp = self._latched[self._master]
            if stamp is not None:
                for drive in told:
                    self.clock.corrected(drive, stamp)
        else:
            self._put_right(told, sure, now_us)
        self.well = not any(self.trouble(drive, True) for drive in range(len(self.drives)))

    def _take_in(self) -> bool:
        """What the drives have told, and which have not; False: it is in doubt."""
        clock, sure = self.clock, True
        if all(self._stray) and not clock.settled:
            clock.begin_anew()
            self._missed = [0] * len(self.drives)
            self._stray = [""] * len(self.drives)
        elif self.drives:  # else there is no clock to keep
            self._compare()
            off_us = self._off_us if clock.settled else ()
            jumped_us = {drive: off for drive, off in enumerate(off_us) if abs(off) > ASTRAY_US}
            sure = clock.on_sync(self._unstamped_us, self._latched, jumped_us)
        return sure

    def _put_right(self, told: Sequence[int], sure: bool, now_us: float) -> None:
        """The drives that have answered the SYNC, by what some of them have told of it."""
        clock = self.clock
        if self._begins_path:
            clock.keep()
            self.path_began_us = clock.sync_us if told and clock.settled else None
        if not (sure and told):
            return
        answered = [n for n, drive in enumerate(self.drives) if not drive.unanswered]
        for drive in answered:
            clock_us = clock.told(drive)
            if clock_us is not None and drive not in told:
                self.followed.append((drive, clock_us))
        wanting = [drive for drive in answered if clock.wants_stamp(drive)]
        if self._last_sync_us < self._path_sync_us and self.often_us == math.inf:
            self._slow = [drive for drive in wanting if clock.drift[drive] < 0]
        self._correct([drive for drive in wanting if drive not in self._slow], now_us)

    def _compare(self) -> None:
        """Who has not answered, and whose clock is off, going by the others'.

        The host may have noticed the SYNC late: that has put all of them off alike. By how much
        at most is known.
        """
        ahead_us = self._ahead_us.values()
        common_us = median(ahead_us) if len(ahead_us) > 2 else min(ahead_us, key=abs, default=0.0)
        if self.clock.settled:
            common_us = max(common_us, -self.seen_late_us)
            common_us = min(common_us, self._line_late_us)
        for drive, latched in enumerate(self._latched):
            self._unread_us[drive] = self._last_sync_us - self._read_us[drive]
            if drive not in self._told_by:
                continue
            self._missed[drive] += latched is None and bool(self._stray[drive])
            self._off_us[drive] = self._ahead_us.get(drive, common_us) - common_us

    def _correct(self, drives: Sequence[int], now_us: float) -> None:
        if not self.produces and now_us > self.next_sync_us - LEAD_US:
            return  # it would be taken for the stamp of the next SYNC
        for drive in drives:
            stamp = self.clock.stamp(drive, now_us - self._last_sync_us)
            self._stamps[drive] = stamp
            self._out.frames.append(self.drives[drive].time_stamp(stamp))


def _each(drives: int, period_us: float, read_us: float) -> int:
    """How many of the drives are asked at a SYNC, from one to the next of which `period_us` pass.

    `read_us`: from one read to the next, where reads take their share of the bus.
    """
    wanted = math.ceil(drives * period_us / CLOCK_ROUND_US)
    needed = math.ceil(drives * period_us / LONGEST_ROUND_US)
    return max(1, needed, min(wanted, math.floor(period_us / read_us)))
