"""Every record of one drive accounted for: sent, taken out by time, reported free.

Records are unconfirmed (asynchronous PDOs), so the host keeps its own books of the drive's FIFO
and compares them with what the drive says when it is asked (0x60C4-02). A record leaves the FIFO
when its segment begins. The note does not say whether the segment in execution still counts
(3.6.3), and no text whether the first record is a segment or only the point where the path starts:
the books keep two records besides the segment in execution and accept all of it in a report.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import deque

from epos2_ros.motion.record import Record
from epos2_ros.protocol.epos2 import BUFFER_SIZE

SEND_LATENCY_MS = 30.0
"""So long after it was handed over a record is in the drive, or lost."""
REPORT_LATENCY_US = 20_000.0
"""So long before a drive is asked a record has to be on the bus to be surely in its report: an echo
may only say that the adapter has the frame, whose queue is still before it."""


class BufferAccount:
    """The books of one drive, for one motion."""

    def __init__(self) -> None:
        self.sent = 0
        self.committed_ms = 0  # path time at which the last sent segment ends
        self.ended = False  # the end record (time 0) was sent
        self.last_position_qc = 0
        self._excess = 0  # records that the drive had more than accounted for, at the last report
        self.reserve_ms: float | None = None  # the least so far: see `note_reserve`
        self._begins: list[int] = []  # path time at which each record leaves the FIFO
        self._on_bus_us: deque[float] = deque()  # when each record was seen on the bus
        self._sent_ms: list[float] = []  # path time at which each was handed over
        self._forgotten = 0  # records dropped from the head of these three

    def send(self, record: Record, path_ms: float) -> None:
        """Enter a record that was handed to the bus at a path time; 0 before the start."""
        self._begins.append(self.committed_ms)
        self._sent_ms.append(path_ms)
        self.committed_ms += record.time
        self.ended = record.time == 0
        self.last_position_qc = record.position
        self.sent += 1

    def seen_on_bus(self, t_us: float) -> None:
        """The oldest record not yet seen on the bus was echoed at `t_us`."""
        self._on_bus_us.append(t_us)

    @property
    def all_on_bus(self) -> bool:
        """Whether every record that was sent has been seen on the bus."""
        return self._forgotten + len(self._on_bus_us) == self.sent

    def level(self, path_ms: float | None) -> int:
        """Records in the FIFO by the books, corrected by what the drive last said."""
        return min(max(self.used(path_ms) + self._excess, 0), BUFFER_SIZE)

    def used(self, path_ms: float | None) -> int:
        """Records in the FIFO at `path_ms` besides the one in execution; None: not started."""
        if path_ms is None:
            return self.sent
        return len(self._begins) - bisect_right(self._begins, path_ms)

    def ahead_ms(self, path_ms: float | None) -> float:
        """Motion that the drive still has before it [ms]."""
        return self.committed_ms - (path_ms or 0.0)

    def leaves_ms(self, count: int) -> float:
        """Path time from which fewer than `count` records are in the FIFO; 0 if never so many."""
        return self._begins[-count] if len(self._begins) >= count else 0.0

    def note_reserve(self, path_ms: float) -> None:
        """How long the drive could do without a record at `path_ms`, before two are left."""
        if path_ms > 0 and not self.ended:
            reserve_ms = self.leaves_ms(2) - path_ms
            if self.reserve_ms is None or reserve_ms < self.reserve_ms:
                self.reserve_ms = reserve_ms

    def report(self, free: int, asked_us: float, from_ms: float | None, to_ms: float | None) -> str:
        """The drive, asked at host time `asked_us`, had `free` records free between two path times.

        Before the start (None) it has to have every record, after it what is accounted for. What
        is wrong, or "".
        """
        reported = BUFFER_SIZE - free
        if to_ms is None:
            least = most = self.sent
        else:
            from_ms = from_ms or 0.0
            surely = self._forgotten + max(
                bisect_right(self._on_bus_us, asked_us - REPORT_LATENCY_US),
                bisect_right(self._sent_ms, from_ms - SEND_LATENCY_MS),
            )
            least = surely - min(surely, self.sent - self.used(to_ms + 2.0))
            most = self.used(from_ms - 2.0) + 1  # with the one in execution
            self._forget(from_ms - REPORT_LATENCY_US / 1000)
        self._excess = reported - min(max(reported, least), most)
        if not self._excess:
            return ""
        accounted = f"{least} to {most} are" if least < most else f"{most} {_are(most)}"
        return (
            f"its buffer holds {reported} records where {accounted} accounted for: "
            f"records were lost or repeated on the bus"
        )

    def _forget(self, path_ms: float) -> None:
        """Drop what left the FIFO before `path_ms`, so that hours of motion need no memory."""
        gone = min(bisect_right(self._begins, path_ms) - 4, len(self._on_bus_us) - 4)
        if gone > 64:
            del self._begins[:gone], self._sent_ms[:gone]
            for _ in range(gone):
                self._on_bus_us.popleft()
            self._forgotten += gone


def _are(count: int) -> str:
    return "is" if count == 1 else "are"
