"""The interpolated position mode of the EPOS2: its buffer and its cubic.

Source: maxon, application note "Interpolation Position Mode" (in the text: "the note").
Positions in qc, time in ms, velocity in qc/ms, acceleration in qc/ms².
"""

from __future__ import annotations

from collections import deque
from enum import IntFlag
from typing import NamedTuple

BUFFER_SIZE = 64  # 3.1.2


class BufferStatus(IntFlag):
    """0x20C4-01 (the note, tables 12 and 13).

    Table 13 prints bits 2 and 3 for the velocity and acceleration errors, which are those
    of the warnings; table 12 leaves bits 10 and 11 for them.
    """

    UNDERFLOW_WARNING = 1 << 0
    OVERFLOW_WARNING = 1 << 1
    VELOCITY_WARNING = 1 << 2
    ACCELERATION_WARNING = 1 << 3
    UNDERFLOW_ERROR = 1 << 8
    OVERFLOW_ERROR = 1 << 9
    VELOCITY_ERROR = 1 << 10
    ACCELERATION_ERROR = 1 << 11
    BUFFER_ENABLED = 1 << 14
    IP_MODE_ACTIVE = 1 << 15


class Point(NamedTuple):
    """A PVT reference point in the units of the record (the note, table 1)."""

    position: int
    velocity: int
    time_ms: int

    @classmethod
    def unpack(cls, record: int) -> Point:
        """From the 64 bits of 0x20C1: position int32, velocity int24, time uint8."""
        position = (record & 0xFFFF_FFFF ^ 0x8000_0000) - 0x8000_0000
        velocity = (record >> 32 & 0xFF_FFFF ^ 0x80_0000) - 0x80_0000
        return cls(position, velocity, record >> 56)


class Fifo:
    """The input buffer (the note, 3.1.2 and table 16)."""

    def __init__(self) -> None:
        self._points: deque[Point] = deque()
        self._ends = 0  # records with time 0 in it
        self.enabled = False

    def __len__(self) -> int:
        return len(self._points)

    @property
    def full(self) -> bool:
        return len(self._points) >= BUFFER_SIZE

    @property
    def starved(self) -> bool:
        """Fewer than two records and none of them ends the motion (3.6.3).

        The note doesn't say whether the segment in execution still counts; here it doesn't.
        """
        return len(self._points) < 2 and not self._ends

    def clear(self) -> None:
        """Forgets all records and denies access."""
        self._points.clear()
        self._ends = 0
        self.enabled = False

    def push(self, point: Point) -> None:
        self._points.append(point)
        self._ends += point.time_ms == 0

    def pop(self) -> Point:
        point = self._points.popleft()
        self._ends -= point.time_ms == 0
        return point


class Segment:
    """The cubic from one reference point to the next (the note, 2.3).

    With u = t − t0 ≤ 0 counted from the segment's end: P = a·u³ + b·u² + c·u + d. The note
    prints a and b with the indices n and n−1 swapped against c and d; these are the ones of
    the cubic that has P and V at both ends.
    """

    __slots__ = ("a", "b", "c", "d", "duration_ms", "end_ms")

    def __init__(
        self, start_ms: int, p0: float, v0: float, p1: float, v1: float, duration_ms: int
    ) -> None:
        t = duration_ms
        self.duration_ms = t
        self.end_ms = start_ms + t
        self.a = (2 * (p0 - p1) + t * (v0 + v1)) / t**3
        self.b = (3 * (p0 - p1) + t * (v0 + 2 * v1)) / t**2
        self.c = v1
        self.d = p1

    def position(self, t_ms: float) -> float:
        u = t_ms - self.end_ms
        return ((self.a * u + self.b) * u + self.c) * u + self.d

    def velocity(self, t_ms: float) -> float:
        u = t_ms - self.end_ms
        return (3 * self.a * u + 2 * self.b) * u + self.c

    def peak_velocity(self) -> float:
        """Largest |velocity|: at an end or where the acceleration is zero."""
        ends = [float(self.end_ms - self.duration_ms), float(self.end_ms)]
        if self.a:
            ends.append(min(max(self.end_ms - self.b / (3 * self.a), ends[0]), ends[1]))
        return max(abs(self.velocity(t)) for t in ends)

    def peak_acceleration(self) -> float:
        """Largest |acceleration|: it is linear, so at an end."""
        return max(abs(2 * self.b - 6 * self.a * self.duration_ms), abs(2 * self.b))

    def hull(self) -> tuple[float, float]:
        """Positions the segment can't leave: those of its Bézier control points."""
        start_ms = self.end_ms - self.duration_ms
        p0, v0, third = self.position(start_ms), self.velocity(start_ms), self.duration_ms / 3
        points = (p0, p0 + v0 * third, self.d - self.c * third, self.d)
        return min(points), max(points)
