"""The PVT buffer of a simulated Copley drive: what comes into 0x2010, and the path it makes.

Sources: Copley's EDS (names and types), its motion library (bytes, errors, what to do about them)
and public transcriptions of its CANopen manual. A segment says position and velocity at its
*start* and the time to the next, which is its end; that of time 0 is the end of the path. Positions
are in counts, time in ms, velocity in counts/ms.

Where no text says, this drive takes the reading that forgives less:

- READING: the buffer has 32 places, as many as the maker's library sends at once; the segment in
  execution has left it.
- READING: as long as a sequence error is there no segment is taken in, and as long as there is any
  error no path begins.
- READING: whatever comes within 50 ms after a buffer command is lost: those who drive real ones
  wait so long.
- READING: popping gives the ids of what it drops back; a flush gives none.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

BUFFER_SIZE = 32
PAUSE_US = 50_000.0  # that a buffer command takes
COMMAND = 0x80  # in byte 0
FLUSH, POP, CLEAR_ERRORS, RESET_COUNTER = range(4)
SEQUENCE_ERROR, OVERFLOW, UNDERFLOW = 1, 2, 4  # bits 24 … 26 of 0x2012, and of the mask
ERRORS = SEQUENCE_ERROR | OVERFLOW | UNDERFLOW
EMPTY = 1 << 31

INITIAL_POSITION, LINEAR, LINEAR_RELATIVE = 4, 5, 6  # formats; below are those of PVT
_FINE, _COARSE = 0.1e-3, 10e-3  # 0.1 and 10 counts/s [counts/ms]


class Segment(NamedTuple):
    """What one place of the buffer holds."""

    format: int
    position: int  # or the distance from the segment before
    velocity: float
    time_ms: int

    @classmethod
    def unpack(cls, data: bytes) -> Segment | None:
        """From the eight bytes of 0x2010; None for a format that there is not."""

        def signed(first: int, last: int) -> int:
            return int.from_bytes(data[first : last + 1], "little", signed=True)

        kind = data[0] >> 3 & 0xF
        if kind < INITIAL_POSITION:
            unit = _COARSE if kind & 1 else _FINE
            return cls(kind, signed(2, 4), signed(5, 7) * unit, data[1])
        if kind == INITIAL_POSITION:
            return cls(kind, signed(1, 4), 0.0, 0)
        if kind <= LINEAR_RELATIVE:
            return cls(kind, signed(2, 5), 0.0, data[1])
        return None

    def place(self, before: int) -> int:
        """Where it begins, after a segment that began at `before`."""
        return self.position + (before if self.format in (2, 3, LINEAR_RELATIVE) else 0)


class PvtBuffer:
    """Objects 0x2010 … 0x2013."""

    def __init__(self, size: int = BUFFER_SIZE) -> None:
        self.size = size
        self.ignored = 0  # that came within the pause after a command
        self.refused = 0  # out of sequence, too many, or of no format
        self.events = 0  # that it tells of by itself: a segment was taken, an error has appeared
        self.reset()

    def reset(self) -> None:
        """The drive was switched on."""
        self.errors = 0
        self.next_id = 0
        self._segments: deque[Segment] = deque()
        self._ready_us = 0.0

    def __len__(self) -> int:
        return len(self._segments)

    @property
    def free(self) -> int:
        return self.size - len(self._segments)

    @property
    def status(self) -> int:
        """0x2012."""
        empty = 0 if self._segments else EMPTY
        return self.next_id | self.free << 16 | self.errors << 24 | empty

    def write(self, data: bytes, now_us: float) -> int | None:
        """Takes in a segment or a command, whose number is returned."""
        if now_us < self._ready_us:
            self.ignored += 1
            return None
        if data[0] & COMMAND:
            self._ready_us = now_us + PAUSE_US
            return self._command(data[0] & 0x7F, data[1:])
        segment = Segment.unpack(data)
        if segment is not None and self._accepts(data[0] & 7):
            self._segments.append(segment)
            self.next_id = self.next_id + 1 & 0xFFFF
        else:
            self.refused += 1
        return None

    def _accepts(self, counter: int) -> bool:
        if self.errors & SEQUENCE_ERROR or counter != self.next_id & 7:
            self._fail(SEQUENCE_ERROR)
        elif not self.free:
            self._fail(OVERFLOW)
        else:
            return True
        return False

    def _fail(self, error: int) -> None:
        self.events += not self.errors & error
        self.errors |= error

    def _command(self, number: int, operand: bytes) -> int:
        if number == FLUSH:
            self._segments.clear()
        elif number == POP:
            for _ in range(min(int.from_bytes(operand[:2], "little"), len(self._segments))):
                self._segments.pop()
                self.next_id = self.next_id - 1 & 0xFFFF
        elif number == CLEAR_ERRORS:
            self.errors &= ~operand[0]
        elif number == RESET_COUNTER:
            self.next_id = 0
        return number

    def take(self) -> Segment | None:
        """The oldest segment; None, and an underflow, when there is none."""
        if not self._segments:
            self._fail(UNDERFLOW)
            return None
        self.events += 1
        return self._segments.popleft()

    def peek(self) -> Segment | None:
        """The one after that; likewise."""
        if not self._segments:
            self._fail(UNDERFLOW)
            return None
        return self._segments[0]


class PvtPath:
    """The curve of a buffer's segments from now on. Times are ms since its start."""

    def __init__(self, buffer: PvtBuffer, position: float) -> None:
        self.ended = False  # at its last position, or for want of segments
        self.aborted = False
        self._buffer = buffer
        self._base = round(position)
        self._start: tuple[float, float] = position, 0.0
        self._end: tuple[float, float] = self._start
        self._linear = False
        self._start_ms = self._end_ms = 0.0
        self._next()

    def at(self, t_ms: float) -> tuple[float, float]:
        """Position and velocity; segments are taken as their time comes."""
        while not self.ended and t_ms >= self._end_ms:
            self._start, self._start_ms = self._end, self._end_ms
            self._next()
        if self.ended:
            return self._start
        return self._curve(max(t_ms - self._start_ms, 0.0), self._end_ms - self._start_ms)

    def _next(self) -> None:
        segment = self._buffer.take()
        while segment is not None and segment.format == INITIAL_POSITION:
            self._base = segment.position
            segment = self._buffer.take()
        if segment is None:
            self.ended = self.aborted = True
            return
        self._base = segment.place(self._base)
        self._start = float(self._base), segment.velocity
        if not segment.time_ms:
            self._start = float(self._base), 0.0
            self.ended = True
            return
        following = self._buffer.peek()
        if following is None:
            self.ended = self.aborted = True
            return
        self._end = float(following.place(self._base)), following.velocity
        self._end_ms = self._start_ms + segment.time_ms
        self._linear = segment.format >= LINEAR

    def _curve(self, t: float, duration: float) -> tuple[float, float]:
        """The one cubic with position and velocity given at both ends, or a straight line."""
        (p0, v0), (p1, v1) = self._start, self._end
        mean = (p1 - p0) / duration
        if self._linear:
            return p0 + mean * t, mean
        b = (3 * mean - 2 * v0 - v1) / duration
        a = (v0 + v1 - 2 * mean) / duration**2
        return p0 + (v0 + (b + a * t) * t) * t, v0 + (2 * b + 3 * a * t) * t
