"""TIME, SYNC, the time stamps that follow each SYNC, and the host's heartbeat.

One correction per SYNC (application note, 2.4): the stamp of a SYNC goes to all drives once, when
every drive has answered the SYNC with its own clock, or when the wait for that is over.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

from epos2_ros.protocol import epos2
from epos2_ros.protocol.axis import Axis
from epos2_ros.protocol.clock import MasterClock
from epos2_ros.protocol.frame import Frame

HEARTBEAT_PERIOD_US = 100_000.0  # of the host; the drives watch it (0x1016)
HOST_NODE_ID = 127
OPERATIONAL = b"\x05"
ANSWER_US = 500.0  # per axis, for its two synchronous TPDOs, before the next SYNC
FOLLOW_UP_US = 40_000.0  # a SYNC's time stamp waits no longer for a drive's answer


class Timekeeper:
    """Keeps the clocks of `axes` together; puts its frames into `outbox`. Times are host µs."""

    def __init__(self, axes: Sequence[Axis], period_us: float, outbox: deque[Frame]) -> None:
        self.clock = MasterClock()
        self.sync_count = 0
        self.sync_on_its_way = False  # handed over, not yet seen on the bus
        self._axes = axes
        self._period_us = period_us
        self._outbox = outbox
        self._last_sync_us = -math.inf
        self._interval_us = 0.0
        self._unstamped_us = math.inf  # when the SYNC was that awaits its time stamp
        self._sync_due_us = math.inf
        self._heartbeat_due_us = math.inf

    @property
    def running(self) -> bool:
        return self._heartbeat_due_us < math.inf

    def start(self, now_us: float, time_of_day: bytes) -> None:
        """TIME sets every drive's motion clock to zero; SYNC and heartbeat begin."""
        self._outbox.append(Frame(epos2.TIME, time_of_day))
        self._sync_due_us = now_us + self._period_us
        self._heartbeat_due_us = now_us

    def on_sync(self, t_us: float) -> None:
        """A SYNC was on the bus; the drives now say what their clocks were."""
        self.sync_on_its_way = False
        self._follow_up()  # of the last one, if a drive never answered it
        self.sync_count += 1
        self._interval_us = t_us - self._last_sync_us
        self._last_sync_us = self._unstamped_us = t_us
        for axis in self._axes:
            axis.latched = None

    def on_answer(self) -> None:
        """A drive has answered the last SYNC."""
        if all(axis.latched is not None for axis in self._axes):
            self._follow_up()

    def advance(self, now_us: float, may_sync: bool) -> None:
        """Send what is due; `may_sync` says whether a SYNC may go out now."""
        if now_us >= self._unstamped_us + FOLLOW_UP_US:
            self._follow_up()
        if now_us >= self._heartbeat_due_us:
            self._outbox.append(Frame(epos2.HEARTBEAT + HOST_NODE_ID, OPERATIONAL))
            self._heartbeat_due_us = now_us + HEARTBEAT_PERIOD_US
        if may_sync and not self.sync_on_its_way and now_us >= self._sync_due_us:
            self._send_sync(now_us)

    def deadline_us(self, may_sync: bool) -> float:
        """When `advance` is wanted next."""
        due = min(self._heartbeat_due_us, self._unstamped_us + FOLLOW_UP_US)
        return min(due, self._sync_due_us) if may_sync and not self.sync_on_its_way else due

    def sync_now(self, now_us: float) -> None:
        """A SYNC out of turn; the period counts from it."""
        self._sync_due_us = now_us
        self._send_sync(now_us)

    @property
    def answered_us(self) -> float:
        """When the answers to the last SYNC are through: no other should go out before."""
        return self._last_sync_us + ANSWER_US * (len(self._axes) + 1)

    def _send_sync(self, now_us: float) -> None:
        self.sync_on_its_way = True
        self._outbox.append(Frame(epos2.SYNC))
        self._sync_due_us += self._period_us
        if not now_us < self._sync_due_us <= now_us + self._period_us:
            self._sync_due_us = now_us + self._period_us

    def _follow_up(self) -> None:
        if self._unstamped_us == math.inf:
            return
        corrected = self.clock.last_stamp is not None  # the drives were set right by a stamp
        latched = [axis.latched for axis in self._axes if axis.latched is not None]
        stamp = self.clock.stamp(self._unstamped_us, latched)
        self._unstamped_us = math.inf
        for axis in self._axes:
            axis.compare_clock(stamp, self._interval_us if corrected else 0.0)
        self._outbox.append(Frame(epos2.TIME_STAMP, stamp.to_bytes(4, "little")))
