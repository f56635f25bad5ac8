"""Segments of a drive that numbers them (Copley, 0x2010 and 0x2012) and says which it wants next.

A record is the end of a segment, a segment of such a drive says its start: the same path, each
record one segment later on the bus, and one more position before the first.

A lost segment is sent again, from a cache: the drive notices when another comes (sequence error),
and takes nothing more until that error is cleared, by a command that has its time; or it is not
told of although it was on the bus. So that the counter's three bits never run around, no more are
sent than it tells apart before the drive has told of them. What can't be made good in time is an
underflow, which the drive tells.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import deque

from epos2_ros.motion.record import Record
from epos2_ros.protocol import copley_pvt
from epos2_ros.protocol.copley_pvt import COUNTED, IDS, PAUSE_US, SEQUENCE, BufferStatus
from epos2_ros.protocol.pvt.buffer_account import (
    REPORT_LATENCY_US,
    SEND_LATENCY_MS,
    BufferAccount,
)

BUFFER_SIZE = 32  # READING: as many as the maker's library sends at once; an empty one tells
IN_FLIGHT = COUNTED - 1
PAUSE_MARGIN_US = 2_000.0  # by which an echo may be told early
_COMMAND = -1  # in place of the number of a segment


class NumberedSegments(BufferAccount):
    """A report is 0x2012. Numbers count from 0; the drive's ids from what it had at rest.

    `unit_counts_s`: of velocities; `status`: what it said at rest.
    """

    def __init__(self, unit_counts_s: float, status: int) -> None:
        at_rest = BufferStatus.of(status)
        super().__init__(at_rest.free if at_rest.empty and at_rest.free else BUFFER_SIZE)
        self._coarse = unit_counts_s == copley_pvt.COARSE_COUNTS_S
        self._first_id = at_rest.next_id
        self._count = 0  # segments made
        self._accepted = 0  # of them, as last told
        self._start: Record | None = None  # where the next begins
        self._before = 0  # and where the one before it did
        self._cache: dict[int, bytes] = {}  # those that are not told of, by number
        self._on_bus_us: dict[int, float] = {}  # since when they have been on it
        self._sent_ms: dict[int, float] = {}  # and at what path time they were handed over
        self._unseen: deque[tuple[int, bytes]] = deque()  # in the order in which they were sent
        self._repeats: deque[bytes] = deque()
        self._told_us = -math.inf  # when the newest report was asked for
        self._recovering = False  # from a sequence error, by a command …
        self._command_us = math.inf  # … that was on the bus then, …
        self._ready_us = math.inf  # … and whose effect is to be asked for from then on

    def _pack(self, record: Record, path_ms: float) -> list[bytes]:
        pdos = []
        if self._start is None:  # the first record holds where the axis stands
            self._start, self._before = record, record.position
            pdos.append(copley_pvt.initial_position(self._next_id, record.position))
            self._enter(pdos[-1], path_ms)
        start = self._start
        pdos.append(
            copley_pvt.segment(
                self._next_id,
                self._before,
                start.position,
                start.velocity,
                record.time,
                self._coarse,
            )
        )
        self._enter(pdos[-1], path_ms)
        self._start, self._before = record, start.position
        return pdos

    @property
    def _next_id(self) -> int:
        return (self._first_id + self._count) % IDS

    def _enter(self, pdo: bytes, path_ms: float) -> None:
        self._cache[self._count], self._sent_ms[self._count] = pdo, path_ms
        self._unseen.append((self._count, pdo))
        self._count += 1

    def seen_on_bus(self, pdo: bytes, t_us: float) -> None:
        """Those before it that were not seen have had their time, too."""
        if all(sent != pdo for _, sent in self._unseen):
            return
        while self._unseen:
            number, sent = self._unseen.popleft()
            if number == _COMMAND:
                self._command_us, self._ready_us = t_us, t_us + PAUSE_US + PAUSE_MARGIN_US
            elif number in self._cache:
                self._on_bus_us[number] = t_us
            if sent == pdo:
                return

    @property
    def all_on_bus(self) -> bool:
        """It does not matter: a drive says itself which it has got."""
        return True

    @property
    def blocked(self) -> bool:
        return self._recovering or self._count - self._accepted >= IN_FLIGHT

    @property
    def ask_us(self) -> float:
        return self._ready_us if self._recovering else math.inf

    def asked(self, now_us: float) -> None:
        if now_us >= self._ready_us:
            self._ready_us = now_us + PAUSE_US  # should there be no answer

    def missing(self) -> str:
        return f"has taken {self._accepted} of {self._count} segments that were sent"

    def report(
        self, value: int, asked_us: float, from_ms: float | None, to_ms: float | None
    ) -> str:
        told = BufferStatus.of(value)
        new = (told.next_id - self._first_id - self._accepted + IDS // 2) % IDS - IDS // 2
        if new < 0 or asked_us < self._told_us:
            return ""  # of before
        if self._accepted + new > self._count:
            return (
                f"it wants segment {told.next_id} next where {self._next_id} is next: they were "
                "altered on the bus, or somebody else sends it some"
            )
        self._told_us = asked_us
        for number in range(self._accepted, self._accepted + new):
            self._cache.pop(number, None)
            self._on_bus_us.pop(number, None)
            self._sent_ms.pop(number, None)
        self._accepted += new
        self.reported = self._accepted == self._count and not told.errors
        self._forget(from_ms)
        if words := copley_pvt.describe_errors(value):
            return words
        if self._recovering and asked_us < self._command_us + PAUSE_US:
            return ""  # the command is under way
        if told.errors & SEQUENCE:
            self._recover(asked_us)
        elif self._recovering or self._lost(asked_us, from_ms or 0.0):
            self._recovering = False
            self._repeat(to_ms or 0.0)
        return ""

    def _lost(self, asked_us: float, from_ms: float) -> bool:
        """Whether the segment that it wants next has had its time before the drive was asked."""
        seen_us = self._on_bus_us.get(self._accepted, math.inf)
        sent_ms = self._sent_ms.get(self._accepted, math.inf)
        return seen_us < asked_us - REPORT_LATENCY_US or sent_ms < from_ms - SEND_LATENCY_MS

    def _recover(self, now_us: float) -> None:
        self._recovering, self._command_us = True, now_us
        self._ready_us = now_us + PAUSE_US + 1000 * SEND_LATENCY_MS
        self._queue(_COMMAND, copley_pvt.clear_errors(SEQUENCE))

    def _repeat(self, path_ms: float) -> None:
        """Everything from there on, in order."""
        for number in range(self._accepted, self._count):
            self._on_bus_us.pop(number, None)
            self._sent_ms[number] = path_ms
            self._queue(number, self._cache[number])

    def _queue(self, number: int, pdo: bytes) -> None:
        self._repeats.append(pdo)
        self._unseen.append((number, pdo))

    def _forget(self, path_ms: float | None) -> None:
        """Drop what left the FIFO before `path_ms`."""
        gone = 0 if path_ms is None else bisect_right(self._begins, path_ms) - 4
        if gone > 64:
            self._forget_begins(gone)

    def repeats(self) -> list[bytes]:
        pdos, self._repeats = list(self._repeats), deque()
        return pdos

    def assume_received(self) -> None:
        self._cache.clear()
        self._sent_ms.clear()
        self._unseen.clear()
        self._accepted = self._count
