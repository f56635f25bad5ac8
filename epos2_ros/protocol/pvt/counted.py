"""Records of a drive that says how many it still takes (EPOS2, 0x60C4-02), and nothing of which.

A record that was lost can't be named, so it is a fault: found before it is due.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import deque

from epos2_ros.motion.record import Record
from epos2_ros.protocol.pvt.buffer_account import (
    REPORT_LATENCY_US,
    SEND_LATENCY_MS,
    BufferAccount,
)


class CountedRecords(BufferAccount):
    """A record is a PDO; a report is the number of free places."""

    def __init__(self, size: int) -> None:
        super().__init__(size)
        self._excess = 0  # records that the drive had more than accounted for, at the last report
        self._on_bus_us: deque[float] = deque()  # when each record was seen on the bus
        self._sent_ms: list[float] = []  # path time at which each was handed over

    def _pack(self, record: Record, path_ms: float) -> list[bytes]:
        self._sent_ms.append(path_ms)
        return [record.pack()]

    def seen_on_bus(self, pdo: bytes, t_us: float) -> None:
        self._on_bus_us.append(t_us)

    @property
    def all_on_bus(self) -> bool:
        return self._forgotten + len(self._on_bus_us) == self.sent

    def level(self, path_ms: float | None) -> int:
        return min(max(self.used(path_ms) + self._excess, 0), self.size)

    def missing(self) -> str:
        return f"reports {self.level(None)} records in its buffer where {self.sent} were sent"

    def report(
        self, value: int, asked_us: float, from_ms: float | None, to_ms: float | None
    ) -> str:
        reported = self.size - value
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
        self.reported = not self._excess
        if not self._excess:
            return ""
        accounted = f"{least} to {most} are" if least < most else f"{most} {_are(most)}"
        return (
            f"its buffer holds {reported} records where {accounted} accounted for: "
            f"records were lost or repeated on the bus"
        )

    def _forget(self, path_ms: float) -> None:
        """Drop what left the FIFO before `path_ms`."""
        gone = min(bisect_right(self._begins, path_ms) - 4, len(self._on_bus_us) - 4)
        if gone > 64:
            self._forget_begins(gone)
            del self._sent_ms[:gone]
            for _ in range(gone):
                self._on_bus_us.popleft()


def _are(count: int) -> str:
    return "is" if count == 1 else "are"
