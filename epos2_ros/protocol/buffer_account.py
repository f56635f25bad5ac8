"""Every record of one drive accounted for: sent, taken out by time, reported free.

Records are unconfirmed (asynchronous PDOs), so the host keeps its own books of the drive's FIFO
and compares them with what the drive reports (0x60C4-02). A record leaves the FIFO when its
segment begins. The note does not say whether the segment in execution still counts (3.6.3); the
books keep two records besides it and accept both readings in a report.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import deque

from epos2_ros.motion.record import Record
from epos2_ros.protocol.epos2 import BUFFER_SIZE

REPORT_LATENCY_US = 50_000.0
"""A report may describe the buffer as it was this long before it arrived: inhibit time of the
TPDO, arbitration, and the host's own scheduling."""


class BufferAccount:
    """The books of one drive, for one motion."""

    def __init__(self) -> None:
        self.sent = 0
        self.committed_ms = 0  # path time at which the last sent segment ends
        self.ended = False  # the end record (time 0) was sent
        self.last_position_qc = 0
        self.wrong_since_us: float | None = None  # host time of the first report that disagreed
        self._begins: list[int] = []  # path time at which each record leaves the FIFO
        self._on_bus_us: deque[float] = deque()  # when each record was seen on the bus
        self._forgotten = 0  # records dropped from the head of `_begins`

    def send(self, record: Record) -> None:
        """Enter a record that was handed to the bus."""
        self._begins.append(self.committed_ms)
        self.committed_ms += record.time
        self.ended = record.time == 0
        self.last_position_qc = record.position
        self.sent += 1

    def seen_on_bus(self, t_us: float) -> None:
        """The oldest record not yet seen on the bus was echoed at `t_us`."""
        self._on_bus_us.append(t_us)

    @property
    def on_bus(self) -> int:
        """How many records have been seen on the bus."""
        return self._forgotten + len(self._on_bus_us)

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

    def mismatch(self, free: int, t_us: float, path_ms: float | None) -> str:
        """What is wrong with a report of `free` records at host time `t_us`, or ""."""
        reported = BUFFER_SIZE - free
        surely = self._forgotten + bisect_right(self._on_bus_us, t_us - REPORT_LATENCY_US)
        if path_ms is None:
            least, most = surely, self.sent
        else:
            # On either side of the report's instant, and with or without the one in execution.
            early = path_ms - REPORT_LATENCY_US / 1000
            taken_late = self.sent - self.used(path_ms + 2.0)
            taken_early = self.sent - self.used(early)
            least = surely - min(surely, taken_late)
            most = self.sent - taken_early + 1
            self._forget(early)
        if least <= reported <= most:
            return ""
        return (
            f"its buffer holds {reported} records where {least} to {most} are accounted for: "
            f"records were lost or repeated on the bus"
        )

    def _forget(self, path_ms: float) -> None:
        """Drop what left the FIFO before `path_ms`, so that hours of motion need no memory."""
        gone = min(bisect_right(self._begins, path_ms) - 4, len(self._on_bus_us) - 4)
        if gone > 64:
            del self._begins[:gone]
            for _ in range(gone):
                self._on_bus_us.popleft()
            self._forgotten += gone
