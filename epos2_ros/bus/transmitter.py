"""Which frame goes to the adapter next, and when.

SocketCAN's transmit queue holds ten frames by default and answers a burst with ENOBUFS; other
adapters block or drop. So few frames are handed over at a time, the next when the bus has taken
one, which the adapter's echo tells or, where there is none, the time that a frame needs. What
the adapter has not taken stays here, in order. SYNC and controlwords overtake records, records
overtake SDO requests; within a lane nothing overtakes anything.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from enum import IntEnum

from epos2_ros.protocol import epos2
from epos2_ros.protocol.frame import Frame

MAX_IN_FLIGHT = 3  # handed over, not yet on the bus: bounds how long a SYNC waits
ECHO_TIMEOUT_US = 500_000.0


def worst_case_bits(data_bytes: int) -> int:
    """Bits of a data frame with an 11-bit identifier at worst: 47 and the data, stuff bits of
    the 34 + 8·n bits that are stuffed, interframe space included (ISO 11898-1)."""
    return 47 + 8 * data_bytes + (33 + 8 * data_bytes) // 4


class Lane(IntEnum):
    """In the order in which frames are sent."""

    URGENT = 0  # NMT, SYNC, time stamp, controlwords, heartbeat
    RECORDS = 1
    SERVICE = 2  # SDO


def lane_of(can_id: int) -> Lane:
    """The lane of a frame, by its function code."""
    function = can_id & 0x780
    if function == epos2.RPDO1:
        return Lane.RECORDS
    return Lane.SERVICE if function == 0x600 else Lane.URGENT


class Transmitter:
    """Paces frames into an adapter.

    `send(frame)` hands a frame over and returns False when the adapter's queue is full.
    `echoes` says whether the adapter gives our own frames back. Times are host µs.
    """

    def __init__(self, send: Callable[[Frame], bool], bitrate: int, echoes: bool) -> None:
        self.echoes = echoes
        self.deadline_us = math.inf  # when `pump` is wanted next
        self.refused = 0  # times the adapter's queue was full
        self.dropped = 0  # frames whose echo never came
        self.stalled = False  # the adapter has stopped putting frames on the bus
        self._send = send
        self._us_per_bit = 1e6 / bitrate
        self._lanes: tuple[deque[Frame], ...] = tuple(deque() for _ in Lane)
        self._in_flight: deque[tuple[Frame, float]] = deque()  # and when it should be through
        self._retry_us = -math.inf

    def push(self, frame: Frame) -> None:
        """Queue a frame; `pump` sends it."""
        self._lanes[lane_of(frame.can_id)].append(frame)

    @property
    def waiting(self) -> int:
        """Frames not yet handed to the adapter."""
        return sum(len(lane) for lane in self._lanes)

    def on_echo(self, frame: Frame) -> bool:
        """One of our frames came back from the bus; False if it is not one of those sent."""
        for position, (sent, _) in enumerate(self._in_flight):
            if sent == frame:
                del self._in_flight[position]
                self.stalled = False
                return True
        return False

    def pump(self, now_us: float) -> list[tuple[Frame, float]]:
        """Send what may be sent now.

        Returns, for adapters without echo, the frames that are through by now and the time at
        which each, by its length and those before it, was on the bus.
        """
        through = self._settle(now_us)
        while len(self._in_flight) < MAX_IN_FLIGHT and now_us >= self._retry_us:
            lane = next((lane for lane in self._lanes if lane), None)
            if lane is None:
                break
            if not self._send(lane[0]):
                self.refused += 1
                self._retry_us = now_us + self._duration_us(lane[0])
                break
            frame = lane.popleft()
            before = self._in_flight[-1][1] if self._in_flight else now_us
            self._in_flight.append((frame, max(before, now_us) + self._duration_us(frame)))
        self.deadline_us = self._next_us(now_us)
        return through

    def reset(self) -> None:
        """Forget everything queued: the bus was lost."""
        for lane in self._lanes:
            lane.clear()
        self._in_flight.clear()
        self.stalled = False

    def _duration_us(self, frame: Frame) -> float:
        return worst_case_bits(len(frame.data)) * self._us_per_bit

    def _settle(self, now_us: float) -> list[tuple[Frame, float]]:
        through = []
        allowance = ECHO_TIMEOUT_US if self.echoes else 0.0
        while self._in_flight and self._in_flight[0][1] + allowance <= now_us:
            frame, due_us = self._in_flight.popleft()
            if self.echoes:
                self.dropped += 1
                self.stalled = True
            else:
                through.append((frame, due_us))
        return through

    def _next_us(self, now_us: float) -> float:
        due = math.inf
        if self._in_flight:
            due = self._in_flight[0][1] + (ECHO_TIMEOUT_US if self.echoes else 0.0)
        if self.waiting and len(self._in_flight) < MAX_IN_FLIGHT:
            due = min(due, max(self._retry_us, now_us))
        return due
