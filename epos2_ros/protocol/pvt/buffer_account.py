"""Every record of one drive accounted for: sent, taken out by time, told by the drive.

Records are unconfirmed (asynchronous PDOs), so the host keeps its own books of the drive's FIFO and
compares them with what the drive says of it. A record leaves the FIFO when its segment begins.
maxon's note does not say whether the segment in execution still counts (3.6.3), and no text whether
the first record is a segment or only the point where the path starts: two records are kept besides
the segment in execution, and all of it is accepted in a report. What a report means is the
family's: `counted`, `numbered`.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from bisect import bisect_right

from epos2_ros.motion.record import Record

SEND_LATENCY_MS = 30.0
"""So long after it was handed over a record is in the drive, or lost."""
REPORT_LATENCY_US = 20_000.0
"""So long before a drive is asked a record has to be on the bus to be surely in its report: an echo
may only say that the adapter has the frame, whose queue is still before it."""


class BufferAccount(ABC):
    """The books of one drive, for one motion. `size`: records that its buffer takes."""

    def __init__(self, size: int) -> None:
        self.size = size
        self.reported = False  # before the start: the drive has told of every record it was sent
        self.sent = 0
        self.committed_ms = 0  # path time at which the last sent segment ends
        self.ended = False  # the end record (time 0) was sent
        self.last_position_qc = 0
        self.reserve_ms: float | None = None  # the least so far: see `note_reserve`
        self._begins: list[int] = []  # path time at which each record leaves the FIFO
        self._forgotten = 0  # records dropped from the head of it

    # ------------------------------------------------------------------ what is on the bus

    def send(self, record: Record, path_ms: float) -> list[bytes]:
        """Enter one more record, at a path time (0 before the start); the PDOs that carry it."""
        self._begins.append(self.committed_ms)
        self.committed_ms += record.time
        self.ended = record.time == 0
        self.last_position_qc = record.position
        self.sent += 1
        self.reported = False
        return self._pack(record, path_ms)

    @abstractmethod
    def _pack(self, record: Record, path_ms: float) -> list[bytes]: ...

    @abstractmethod
    def seen_on_bus(self, pdo: bytes, t_us: float) -> None:
        """A PDO was echoed at `t_us`: the oldest that was not yet seen, but for what was lost."""

    @property
    @abstractmethod
    def all_on_bus(self) -> bool:
        """Whether all that was sent has been seen on the bus."""

    @abstractmethod
    def report(
        self, value: int, asked_us: float, from_ms: float | None, to_ms: float | None
    ) -> str:
        """What the drive, asked at host time `asked_us`, has said between two path times.

        Before the start (None) it has to have every record. What is wrong, or "".
        """

    @abstractmethod
    def missing(self) -> str:
        """What the drive has told before the start, where that is not all."""

    @property
    def blocked(self) -> bool:
        """Whether nothing more may be sent before the drive has told of what was."""
        return False

    def repeats(self) -> list[bytes]:
        """PDOs that make good what was lost."""
        return []

    @property
    def ask_us(self) -> float:
        """When the drive has to be asked out of turn."""
        return math.inf

    def asked(self, now_us: float) -> None:  # noqa: B027
        """It is asked, whether out of turn or not."""

    def assume_received(self) -> None:  # noqa: B027
        """There is no drive: take all that was sent for received."""

    # ------------------------------------------------------------------ the books

    def level(self, path_ms: float | None) -> int:
        """Records in the FIFO by the books, corrected by what the drive last said."""
        return min(max(self.used(path_ms), 0), self.size)

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

    def _forget_begins(self, count: int) -> None:
        """Drop the oldest, which have left the FIFO, so that hours of motion need no memory."""
        del self._begins[:count]
        self._forgotten += count
