"""Which frame goes to the adapter next, and when.

SocketCAN's transmit queue holds ten frames by default and answers a burst with ENOBUFS; other
adapters block or drop. So few frames are handed over at a time, the next when the bus has taken
one, which the adapter's echo tells or, where there is none, the time that a frame needs. A host
that computes listens late; what it has not listened for is taken for sent in its time, or a busy
host would send less and less. What the adapter has not taken stays here, in order. SYNC and
controlwords overtake records, records overtake SDO requests; within a lane nothing overtakes
anything.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from enum import IntEnum
from typing import NamedTuple

from epos2_ros.protocol import epos2
from epos2_ros.protocol.frame import Frame

MAX_IN_FLIGHT = 3  # handed over, not yet on the bus: bounds how long a SYNC waits
MAX_UNHEARD = 100  # handed over, no echo heard: a host so far behind has to listen first
ECHO_TIMEOUT_US = 500_000.0
LOOK_AGAIN_US = 20_000.0  # when an echo is overdue and the bus was not yet listened to so far


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


class _Sent(NamedTuple):
    """A frame handed over."""

    frame: Frame
    due_us: float  # when it should be through, by its length and those before it
    echoes: int  # how many will have been seen when all before it are through


class Transmitter:
    """Paces frames into an adapter.

    `send(frame)` hands a frame over and returns False when the adapter's queue is full.
    `echoes` says whether the adapter gives our own frames back. Times are host µs.
    """

    def __init__(self, send: Callable[[Frame], bool], bitrate: int, echoes: bool) -> None:
        self.echoes = echoes
        self.deadline_us = math.inf  # when `pump` is wanted next
        self.refused = 0  # times the adapter's queue was full
        self.dropped = 0  # frames of which no echo was seen
        self.stalled = False  # the adapter has stopped putting frames on the bus
        self._send = send
        self._us_per_bit = 1e6 / bitrate
        self._lanes: tuple[deque[Frame], ...] = tuple(deque() for _ in Lane)
        self._in_flight: deque[_Sent] = deque()  # handed over, not yet seen on the bus
        self._echoes_seen = 0
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
        for position, sent in enumerate(self._in_flight):
            if sent.frame == frame:
                del self._in_flight[position]
                self._echoes_seen += 1
                return True
        return False

    def pump(self, now_us: float, heard_us: float | None = None) -> list[tuple[Frame, float]]:
        """Send what may be sent now; `heard_us` is up to when the bus was listened to (None: now).

        Returns frames that are through by now though no echo told, and the time at which each,
        by its length and those before it, was on the bus: all frames, for adapters without echo.
        """
        heard_us = now_us if heard_us is None else heard_us
        if not any(self._lanes) and not self._overdue(now_us, heard_us):
            self.deadline_us = self._overdue_us(now_us)
            return []
        through = self._settle(now_us, heard_us)
        room = self._room(now_us, heard_us)
        for _ in range(room if now_us >= self._retry_us else 0):
            lane = next(filter(None, self._lanes), None)
            if lane is None:
                break
            if not self._send(lane[0]):
                self.refused += 1
                self._retry_us = now_us + self._duration_us(lane[0])
                break
            frame = lane.popleft()
            before_us = self._in_flight[-1].due_us if self._in_flight else now_us
            due_us = max(before_us, now_us) + self._duration_us(frame)
            echoes = self._echoes_seen + len(self._in_flight)
            self._in_flight.append(_Sent(frame, due_us, echoes))
        self.deadline_us = self._next_us(now_us, heard_us)
        return through

    def reset(self) -> None:
        """Forget everything queued: the bus was lost."""
        for lane in self._lanes:
            lane.clear()
        self._in_flight.clear()
        self.stalled = False

    def _duration_us(self, frame: Frame) -> float:
        return worst_case_bits(len(frame.data)) * self._us_per_bit

    def _overdue(self, now_us: float, heard_us: float) -> bool:
        """Whether the first frame handed over is through by now, or lost, though no echo told."""
        if not self._in_flight:
            return False
        due_us = self._in_flight[0].due_us
        return due_us + ECHO_TIMEOUT_US <= heard_us if self.echoes else due_us <= now_us

    def _overdue_us(self, now_us: float) -> float:
        """When that is to be looked at again."""
        if not self._in_flight:
            return math.inf
        due_us = self._in_flight[0].due_us
        return max(due_us + ECHO_TIMEOUT_US, now_us + LOOK_AGAIN_US) if self.echoes else due_us

    def _settle(self, now_us: float, heard_us: float) -> list[tuple[Frame, float]]:
        through = []
        while self._overdue(now_us, heard_us):
            sent = self._in_flight.popleft()
            self.dropped += self.echoes
            # Later frames have come back: so did this one, only that nobody saw it.
            if not self.echoes or self._echoes_seen > sent.echoes:
                through.append((sent.frame, sent.due_us))
            else:
                self.stalled = True
        return through

    def _room(self, now_us: float, heard_us: float) -> int:
        """How many frames may be handed over now."""
        on_the_way = 0
        for sent in self._in_flight:
            on_the_way += sent.due_us > now_us or sent.due_us <= heard_us
        return min(MAX_IN_FLIGHT - on_the_way, MAX_UNHEARD - len(self._in_flight))

    def _next_us(self, now_us: float, heard_us: float) -> float:
        due = self._overdue_us(now_us)
        if any(self._lanes):
            if self._room(now_us, heard_us) > 0:
                return min(due, max(self._retry_us, now_us))
            awaited = (sent.due_us for sent in self._in_flight if sent.due_us > now_us)
            due = min(due, min(awaited, default=math.inf))
        return due
