"""Pacing frames into an adapter: order, refusals, echoes, and how long a SYNC waits.

The adapter here is a queue in front of a bus that sends one frame after another.
"""

from __future__ import annotations

import math
import random
from collections import deque

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from epos2_ros.bus.transmitter import (
    MAX_IN_FLIGHT,
    MAX_UNHEARD,
    Lane,
    Transmitter,
    lane_of,
    worst_case_bits,
)
from epos2_ros.protocol.frame import Frame
from epos2_ros.sim.can_bus import INTERFRAME_BITS, frame_bits

BITRATE = 125_000
FRAME_US = 135 * 8  # of 8 bytes at worst, at 125 kbit/s
SYNC = Frame(0x080)
NODES = range(1, 7)


class Adapter:
    """Takes up to `queue` frames and puts one on the bus every FRAME_US."""

    def __init__(self, queue: int, echoes: bool = True) -> None:
        self.queue = queue
        self.waiting: deque[Frame] = deque()
        self.sent: list[Frame] = []
        self.refused = 0
        self.now_us = 0.0
        self.transmitter = Transmitter(self._take, BITRATE, echoes)
        self.through: list[tuple[Frame, float]] = []
        self._free_us = 0.0

    def _take(self, frame: Frame) -> bool:
        if len(self.waiting) >= self.queue:
            self.refused += 1
            return False
        if not self.waiting:
            self._free_us = max(self._free_us, self.now_us) + FRAME_US
        self.waiting.append(frame)
        return True

    def run(self, seconds: float) -> None:
        end_us = self.now_us + seconds * 1e6
        while True:
            self.through += self.transmitter.pump(self.now_us)
            sends_us = self._free_us if self.waiting else math.inf
            self.now_us = min(sends_us, max(self.transmitter.deadline_us, self.now_us), end_us)
            if self.now_us >= end_us:
                return
            if self.now_us >= sends_us:
                frame = self.waiting.popleft()
                self.sent.append(frame)
                if self.waiting:
                    self._free_us += FRAME_US
                if self.transmitter.echoes:
                    assert self.transmitter.on_echo(frame)


def record(node: int, number: int) -> Frame:
    return Frame(0x200 + node, number.to_bytes(8, "little"))


# ---------------------------------------------------------------------------- order and loss


@given(
    st.lists(
        st.tuples(st.sampled_from([0x000, 0x080, 0x201, 0x206, 0x403, 0x501, 0x603]), st.booleans())
    ),
    st.integers(1, 12),
    st.booleans(),
)
@settings(deadline=None)
def test_nothing_is_lost_and_nothing_overtakes_its_like(pushes, queue, echoes):
    adapter = Adapter(queue, echoes)
    for number, (can_id, pause) in enumerate(pushes):
        adapter.transmitter.push(Frame(can_id, bytes([number % 256])))
        adapter.run(0.0005 if pause else 0.0)
    adapter.run(1.0)
    pushed = [Frame(can_id, bytes([n % 256])) for n, (can_id, _) in enumerate(pushes)]
    for lane in Lane:
        assert [f for f in adapter.sent if lane_of(f.can_id) is lane] == [
            f for f in pushed if lane_of(f.can_id) is lane
        ]
    assert adapter.transmitter.waiting == 0
    assert adapter.transmitter.refused == adapter.refused
    assert adapter.transmitter.dropped == 0


def test_a_full_queue_delays_and_loses_nothing():
    """SocketCAN answers ENOBUFS as long as other programs' frames fill the queue."""
    adapter = Adapter(queue=2)
    for number in range(50):
        adapter.transmitter.push(record(1, number))
    adapter.run(1.0)
    assert adapter.refused > 10
    assert adapter.sent == [record(1, number) for number in range(50)]


@pytest.mark.parametrize("burst", [1, 20, 200])
def test_a_sync_waits_for_no_more_than_the_frames_in_flight(burst):
    adapter = Adapter(queue=10)
    for number in range(burst):
        adapter.transmitter.push(record(1 + number % 6, number))
        adapter.transmitter.push(Frame(0x601, bytes(8)))
    adapter.run(0.0)
    adapter.transmitter.push(SYNC)
    adapter.run(1.0)
    assert adapter.sent.index(SYNC) <= MAX_IN_FLIGHT
    assert len(adapter.sent) == 2 * burst + 1


@pytest.mark.parametrize(
    ("can_id", "lane"),
    [
        *[(can_id, Lane.URGENT) for can_id in (0x000, 0x080, 0x100, 0x301, 0x401, 0x501, 0x77F)],
        *[(0x200 + node, Lane.RECORDS) for node in (1, 127)],
        *[(0x600 + node, Lane.SERVICE) for node in (1, 127)],
    ],
)
def test_only_records_and_sdo_can_be_overtaken(can_id, lane):
    assert lane_of(can_id) is lane


# ---------------------------------------------------------------------------- echoes


def test_without_echo_a_frames_time_on_the_bus_is_estimated_from_its_length():
    adapter = Adapter(queue=10, echoes=False)
    for number in range(5):
        adapter.transmitter.push(record(1, number))
    adapter.run(1.0)
    assert adapter.through == [(record(1, n), (n + 1) * FRAME_US) for n in range(5)]


def test_an_echo_is_ours_once_for_each_frame_in_flight():
    transmitter = Transmitter(lambda frame: True, BITRATE, echoes=True)
    for _ in range(2):
        transmitter.push(SYNC)
    transmitter.pump(0.0)
    assert not transmitter.on_echo(Frame(0x181, bytes(8)))  # a drive's
    assert [transmitter.on_echo(SYNC) for _ in range(3)] == [True, True, False]


def test_an_adapter_with_several_mailboxes_may_send_out_of_order():
    transmitter = Transmitter(lambda frame: True, BITRATE, echoes=True)
    for frame in (record(1, 1), record(2, 2), SYNC):
        transmitter.push(frame)
    transmitter.pump(0.0)
    for frame in (SYNC, record(2, 2), record(1, 1)):
        assert transmitter.on_echo(frame)
    assert transmitter.pump(1e3) == []
    assert transmitter.deadline_us == math.inf


def test_echoes_that_stay_away_are_noticed_in_half_a_second():
    transmitter = Transmitter(lambda frame: True, BITRATE, echoes=True)
    transmitter.push(SYNC)
    transmitter.pump(0.0)
    transmitter.pump(0.4e6)
    assert not transmitter.stalled
    assert transmitter.deadline_us < 0.6e6
    transmitter.pump(transmitter.deadline_us)
    assert transmitter.stalled
    assert transmitter.dropped == 1


def test_a_host_that_was_stopped_does_not_blame_the_adapter():
    """Echoes wait to be read: nothing is missing before the bus has been listened to."""
    transmitter = Transmitter(lambda frame: True, BITRATE, echoes=True)
    transmitter.push(SYNC)
    transmitter.pump(0.0)
    transmitter.pump(5e6, heard_us=1000.0)
    assert not transmitter.stalled
    assert 5e6 < transmitter.deadline_us < 5.1e6
    assert transmitter.on_echo(SYNC)
    assert transmitter.pump(5.1e6) == []
    assert not transmitter.stalled


def test_a_host_that_listens_late_goes_on_sending_at_the_pace_of_the_bus():
    """Frames that wait to be read say nothing about the adapter: by its time each is through."""
    transmitter = Transmitter(lambda frame: True, BITRATE, echoes=True)
    for number in range(20):
        transmitter.push(record(1, number))
    handed = []
    for now_us in (0.0, 1.0, FRAME_US, 2 * FRAME_US, 4 * FRAME_US):
        transmitter.pump(now_us, heard_us=-1.0)
        handed.append(20 - transmitter.waiting)
    assert handed == [3, 3, 4, 5, 7]
    assert transmitter.deadline_us == 5 * FRAME_US
    transmitter.pump(8 * FRAME_US, heard_us=8 * FRAME_US)  # now it has listened: no echo came
    assert transmitter.waiting == 13
    for number in range(7):
        assert transmitter.on_echo(record(1, number))


def test_a_host_that_never_listens_stops_sending():
    transmitter = Transmitter(lambda frame: True, BITRATE, echoes=True)
    for number in range(500):
        transmitter.push(record(1, number))
        transmitter.pump(number * FRAME_US, heard_us=-1.0)
    assert 500 - transmitter.waiting == MAX_UNHEARD
    assert transmitter.deadline_us > 500 * FRAME_US
    assert not transmitter.stalled


def test_an_echo_that_nobody_saw_is_known_by_those_that_follow():
    """A receive queue that overflowed: the frame was on the bus, and the start may depend on it."""
    transmitter = Transmitter(lambda frame: True, BITRATE, echoes=True)
    transmitter.push(record(1, 0))
    transmitter.pump(0.0)
    for number in range(1, 6):
        transmitter.push(record(1, number))
        assert transmitter.pump(number * 0.08e6) == []
        assert transmitter.on_echo(record(1, number))
    assert transmitter.pump(0.7e6) == [(record(1, 0), FRAME_US)]
    assert (transmitter.dropped, transmitter.stalled) == (1, False)


# ---------------------------------------------------------------------------- length


@given(st.integers(0, 0x7FF), st.binary(max_size=8))
def test_no_frame_is_longer_than_its_worst_case(can_id, data):
    assert frame_bits(can_id, data) + INTERFRAME_BITS <= worst_case_bits(len(data))


def test_the_worst_case_is_the_documented_one():
    """ISO 11898-1: 47 bits, the data, and a stuff bit for four of the 33 + 8·n after the first."""
    assert [worst_case_bits(n) for n in (0, 4, 8)] == [55, 95, 135]


def test_random_traffic_reaches_the_bus_at_its_full_rate():
    """Pacing must not leave the bus idle while frames wait."""
    rng = random.Random(1)
    adapter = Adapter(queue=10)
    for number in range(400):
        adapter.transmitter.push(record(rng.choice(NODES), number))
    adapter.run(401 * FRAME_US / 1e6)
    assert len(adapter.sent) == 400
