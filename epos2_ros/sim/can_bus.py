"""A CAN bus in simulated time: bit-exact frame lengths and arbitration by identifier.

Source: ISO 11898-1 (classical base format frames).
"""

from __future__ import annotations

import heapq
import math
from collections import Counter, deque
from collections.abc import Callable
from functools import lru_cache

from epos2_ros.errors import BusError

from .slave import Slave

_CRC_POLYNOMIAL = 0x4599
_TAIL_BITS = 10  # CRC delimiter, ACK slot and delimiter, end of frame: never stuffed
INTERFRAME_BITS = 3
HOST = 0  # as the source of a frame; drives are their node ids


class TransmitQueueFull(BusError):
    """What SocketCAN reports as ENOBUFS: the frame was not taken."""


def _crc_table() -> list[int]:
    table = []
    for byte in range(256):
        crc = byte << 7
        for _ in range(8):
            crc = (crc << 1 ^ (_CRC_POLYNOMIAL if crc & 0x4000 else 0)) & 0x7FFF
        table.append(crc)
    return table


def _stuff_bit(state: int, bit: int) -> tuple[int, int]:
    """The stuffing automaton: state is 8·(last bit) + run length; gives (state, stuff bits)."""
    last, run = state >> 3, state & 7
    run = run + 1 if bit == last else 1
    if run == 5:  # a complementary bit follows and starts a run of its own
        return (1 - bit) << 3 | 1, 1
    return bit << 3 | run, 0


def _stuff_table() -> list[tuple[int, int]]:
    table = []
    for state in range(16):
        for byte in range(256):
            now, stuffed = state, 0
            for position in range(7, -1, -1):
                now, more = _stuff_bit(now, byte >> position & 1)
                stuffed += more
            table.append((now, stuffed))
    return table


_CRC = _crc_table()
_STUFF = _stuff_table()


@lru_cache(maxsize=4096)
def frame_bits(can_id: int, data: bytes) -> int:
    """Bits a data frame occupies, stuff bits included, the gap to the next one not."""
    header = can_id << 7 | len(data)  # SOF, identifier, RTR, IDE, r0, DLC: 19 bits
    payload = header.to_bytes(3, "big") + data  # leading zeros don't change the CRC
    crc = 0
    for byte in payload:
        crc = (crc << 8 ^ _CRC[crc >> 7 ^ byte]) & 0x7FFF
    length = 34 + 8 * len(data)
    bits = (int.from_bytes(payload, "big") << 15 | crc).to_bytes(length // 8 + 1, "big")
    state, stuffed = 8, 0  # the bus was recessive; 34 + 8n bits: two, then whole bytes
    for bit in (bits[0] >> 1 & 1, bits[0] & 1):
        state, _ = _stuff_bit(state, bit)
    for byte in bits[1:]:
        state, more = _STUFF[state << 8 | byte]
        stuffed += more
    return length + stuffed + _TAIL_BITS


class Remote(bytes):
    """In place of its data: a remote frame, which has none."""


class SimulatedBus:
    """Drives and one host on a bus.

    The host has a first-in first-out transmit queue of `host_queue` frames (`None`: without
    end), like SocketCAN. At the end of a frame the heads of all queues contend, the lowest
    identifier wins. A completed frame reaches all other nodes, and the host as its echo.

    `drop(can_id, data, source)`: `True` loses the frame on the wire (it still takes its time).
    `host_delay_us(can_id, data)`: how much later the host gets to see a frame; its time
    stamp remains that of the bus.
    """

    def __init__(self, bitrate: int = 1_000_000, host_queue: int | None = None) -> None:
        self.bit_us = 1e6 / bitrate
        self.host_queue = host_queue
        self.now_us = 0.0
        self.drives: list[Slave] = []
        self.drop: Callable[[int, bytes, int], bool] | None = None
        self.host_delay_us: Callable[[int, bytes], float] | None = None
        self.frames = 0
        self.bits = 0  # interframe space included
        self.bits_by_function: Counter[int] = Counter()  # by identifier & 0x780
        self._host: deque[tuple[int, bytes]] = deque()
        self._sending: tuple[int, bytes] | None = None
        self._source = HOST  # of the frame being sent
        self._queue = self._host  # and where it waits
        self._end_us = math.inf  # of the frame being sent
        self._free_us = 0.0  # no frame can start before
        self._late: list[tuple[float, int, tuple[int, bytes, float, bool]]] = []  # to the host
        self._agenda: list[tuple[float, int]] = []  # heap of next events, by place in `drives`
        self._scheduled: list[float] = []  # the one of them that counts, per drive
        self._talking: set[int] = set()  # drives with something to send
        self._interrupted = False

    def add(self, drive: Slave) -> None:
        """Connects a drive."""
        self.drives.append(drive)

    def host_send(self, can_id: int, data: bytes, remote: bool = False) -> None:
        """Puts a frame of the host into its queue, a remote frame if so.

        Raises `TransmitQueueFull`.
        """
        if self.host_queue is not None and len(self._host) >= self.host_queue:
            raise TransmitQueueFull(f"transmit queue full ({self.host_queue} frames)")
        self._host.append((can_id, Remote() if remote else data))

    @property
    def host_pending(self) -> int:
        """Frames of the host that are not on the bus yet, the one being sent included."""
        return len(self._host)

    def load(self) -> float:
        """Share of the time so far in which the bus was busy, 0 … 1."""
        return self.bits * self.bit_us / self.now_us if self.now_us else 0.0

    def run_until(
        self, t_us: float, on_frame: Callable[[int, bytes, float, bool], bool | None]
    ) -> float:
        """Runs the bus up to `t_us`.

        Calls `on_frame(can_id, data, t_us, is_echo)` for every frame the host sees, with
        `now_us` the time it sees it; if that returns `True`, returns at once. Gives `now_us`.
        """
        self._interrupted = False
        self._agenda, self._scheduled = [], [math.inf] * len(self.drives)
        for place in range(len(self.drives)):
            self._look_at(place)
        while True:
            horizon_us = min(self._start_frame(), self._end_us, t_us)
            if self._late:
                horizon_us = min(horizon_us, self._late[0][0])
            if self._run_drives(horizon_us):
                if self._interrupted:
                    return self.now_us
                continue  # one of them has something to say, and the bus is free
            self.now_us = max(self.now_us, horizon_us)
            if self._end_us <= horizon_us:
                self._complete()
            stop = False
            while self._late and self._late[0][0] <= horizon_us:
                stop = bool(on_frame(*heapq.heappop(self._late)[2])) or stop
            if stop or horizon_us >= t_us:
                return self.now_us

    def interrupt(self) -> None:
        """`run_until` returns at once; from within a drive's `advance`."""
        self._interrupted = True

    def _run_drives(self, horizon_us: float) -> bool:
        """Advances the drives; stops early, with `True`, when one has something to say."""
        agenda, scheduled = self._agenda, self._scheduled
        while agenda and agenda[0][0] <= horizon_us:
            due_us, place = heapq.heappop(agenda)
            if due_us == scheduled[place]:
                self.now_us = max(self.now_us, due_us)
                self.drives[place].advance(due_us)
                self._look_at(place)
                if self._interrupted or (self._talking and self._sending is None):
                    return True
        return False

    def _look_at(self, place: int) -> None:
        """Notes when a drive is next due and whether it has something to send."""
        drive = self.drives[place]
        next_us = drive.next_event_us
        if next_us != self._scheduled[place]:
            self._scheduled[place] = next_us
            if next_us < math.inf:
                heapq.heappush(self._agenda, (next_us, place))
        if drive.outbox:
            self._talking.add(place)

    def _start_frame(self) -> float:
        """Arbitration, if the bus is free; else when that will be (inf: nothing to send)."""
        if self._sending is not None:
            return math.inf
        first: tuple[int, bytes] | None = None
        if self._host:
            first, self._source, self._queue = self._host[0], HOST, self._host
        for place in sorted(self._talking):
            drive = self.drives[place]
            if not drive.outbox:
                self._talking.discard(place)
            elif first is None or drive.outbox[0][0] < first[0]:
                first, self._source, self._queue = drive.outbox[0], drive.node_id, drive.outbox
        if first is None:
            return math.inf
        if self.now_us < self._free_us:
            return self._free_us
        self._sending = first
        self._end_us = self.now_us + frame_bits(*first) * self.bit_us
        return math.inf

    def _complete(self) -> None:
        assert self._sending is not None
        t_us, source, frame = self._end_us, self._source, self._sending
        self._sending, self._end_us = None, math.inf
        self._free_us = t_us + INTERFRAME_BITS * self.bit_us
        if not self._queue or self._queue[0] is not frame:
            return  # its device was switched off meanwhile
        can_id, data = self._queue.popleft()
        bits = frame_bits(can_id, data) + INTERFRAME_BITS
        self.frames += 1
        self.bits += bits
        self.bits_by_function[can_id & 0x780] += bits
        if self.drop is not None and self.drop(can_id, data, source):
            return
        for place, drive in enumerate(self.drives):
            if drive.node_id == source:
                drive.transmitted(can_id, t_us)
            elif not drive.receive(can_id, data, t_us, isinstance(data, Remote)):
                continue
            self._look_at(place)
        seen_us = t_us
        if self.host_delay_us is not None:
            seen_us += self.host_delay_us(can_id, data)
        heapq.heappush(
            self._late, (seen_us, self.frames, (can_id, data, t_us, source == HOST))
        )
