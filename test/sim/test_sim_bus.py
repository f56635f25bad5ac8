"""The simulated bus: bit counts, arbitration, queues, losses (ISO 11898-1).

Frame lengths are checked against a bit-by-bit construction of the frame.
"""

from __future__ import annotations

import math
from collections import deque

import pytest
from hypothesis import given
from hypothesis import strategies as st
from sim_host import Host, prompt_drive

from epos2_ros.sim.can_bus import SimulatedBus, TransmitQueueFull, frame_bits

INTERFRAME = 3
Frames = list[tuple[int, bytes, float, bool]]


def bits_by_hand(can_id: int, data: bytes) -> int:
    """The frame as a string of bits: fields, CRC by long division, stuffing."""
    bits = "0" + f"{can_id:011b}" + "0" + "0" + "0" + f"{len(data):04b}"
    bits += "".join(f"{byte:08b}" for byte in data)
    remainder = [int(bit) for bit in bits] + [0] * 15
    polynomial = [int(bit) for bit in f"{0xC599:016b}"]  # x^15 + 0x4599
    for n in range(len(bits)):
        if remainder[n]:
            for k, bit in enumerate(polynomial):
                remainder[n + k] ^= bit
    bits += "".join(str(bit) for bit in remainder[-15:])
    stuffed = ""
    for bit in bits:
        stuffed += bit
        if len(stuffed) >= 5 and len(set(stuffed[-5:])) == 1:
            stuffed += "1" if bit == "0" else "0"
    return len(stuffed) + 1 + 1 + 1 + 7  # CRC delimiter, ACK slot and delimiter, end of frame


@given(st.integers(0, 0x7FF), st.binary(max_size=8))
def test_frame_length(can_id: int, data: bytes) -> None:
    assert frame_bits(can_id, data) == bits_by_hand(can_id, data)


@given(st.integers(0, 0x7FF), st.binary(max_size=8))
def test_frame_length_is_within_the_known_bounds(can_id: int, data: bytes) -> None:
    """44 + 8n bits without stuffing, and at most one stuff bit per four of 34 + 8n."""
    n = len(data)
    assert 44 + 8 * n <= frame_bits(can_id, data) <= 44 + 8 * n + (33 + 8 * n) // 4


def collect(bus: SimulatedBus, until_us: float) -> Frames:
    seen: Frames = []
    bus.run_until(until_us, lambda *frame: seen.append(frame))
    return seen


def test_frame_takes_its_time() -> None:
    bus = SimulatedBus(bitrate=125_000)
    bus.host_send(0x123, b"\x55\xaa")
    (frame,) = collect(bus, 10_000)
    assert frame == (0x123, b"\x55\xaa", bits_by_hand(0x123, b"\x55\xaa") * 8.0, True)


def test_frames_follow_after_the_interframe_space() -> None:
    bus = SimulatedBus()
    for _ in range(3):
        bus.host_send(0x100, b"abc")
    length = bits_by_hand(0x100, b"abc")
    times = [t_us for _, _, t_us, _ in collect(bus, 10_000)]
    assert times == [length, 2 * length + INTERFRAME, 3 * length + 2 * INTERFRAME]


def test_lowest_identifier_wins() -> None:
    """All contend at the end of the frame before; within a queue order is kept."""
    drives = [prompt_drive(n) for n in (3, 1, 2)]
    bus = SimulatedBus()
    for drive in drives:
        bus.add(drive)
    collect(bus, 5_000)  # boot-up
    bus.host_send(0x400, bytes(8))
    collect(bus, 5_010)  # on the bus now
    for drive in drives:
        drive.outbox.append((0x180 + drive.node_id, b""))
        drive.outbox.append((0x100 + drive.node_id, b""))
    bus.host_send(0x182, b"host")
    order = [(can_id, echo) for can_id, _, _, echo in collect(bus, 10_000)]
    assert order == [
        (0x400, True),
        (0x181, False),
        (0x101, False),
        (0x182, True),
        (0x182, False),
        (0x102, False),
        (0x183, False),
        (0x103, False),
    ]


def test_host_queue_is_first_in_first_out_and_finite() -> None:
    """Like SocketCAN's: SYNC waits behind what was queued before it; the eleventh is refused."""
    bus = SimulatedBus(host_queue=10)
    for n in range(9):
        bus.host_send(0x300 + n, b"")
    bus.host_send(0x080, b"")
    with pytest.raises(TransmitQueueFull):
        bus.host_send(0x001, b"")
    assert bus.host_pending == 10
    assert [can_id for can_id, *_ in collect(bus, 5_000)] == [*range(0x300, 0x309), 0x080]
    assert bus.host_pending == 0
    bus.host_send(0x001, b"")


def test_callback_can_stop_the_run_and_answer_at_once() -> None:
    bus = SimulatedBus()
    bus.host_send(0x100, b"")
    stopped = bus.run_until(1e6, lambda *_: True)
    assert stopped == bus.now_us == bits_by_hand(0x100, b"")
    answers = deque([0x200, 0x201])

    def answer(can_id: int, data: bytes, t_us: float, echo: bool) -> None:
        if answers:
            bus.host_send(answers.popleft(), b"")

    bus.host_send(0x1FF, b"")
    bus.run_until(stopped + 1000, answer)
    assert bus.frames == 4
    assert bus.now_us == stopped + 1000


def test_load() -> None:
    bus = SimulatedBus(bitrate=500_000)
    for n in range(10):
        bus.host_send(0x181, bytes([n]))
        bus.host_send(0x080, b"")
        collect(bus, 1000 * (n + 1))
    records = sum(bits_by_hand(0x181, bytes([n])) + INTERFRAME for n in range(10))
    syncs = 10 * (bits_by_hand(0x080, b"") + INTERFRAME)
    assert bus.bits == records + syncs
    assert dict(bus.bits_by_function) == {0x180: records, 0x080: syncs}
    assert bus.load() == pytest.approx((records + syncs) * 2 / 10_000)


def test_lost_frame_takes_time_and_reaches_nobody() -> None:
    drive = prompt_drive(1)
    host = Host(drive)
    host.bus.drop = lambda can_id, data, source: can_id == 0x601 and source == 0
    host.send(0x601, "40 00 10 00 00 00 00 00", ms=2)
    assert host.heard(0x581) == []
    assert [f for f in host.frames if f.can_id == 0x601] == []
    host.bus.drop = None
    assert host.read(0x1000) == 0x00020192


def test_late_host_sees_true_time_stamps() -> None:
    bus = SimulatedBus()
    bus.host_delay_us = lambda can_id, data: 700.0
    bus.host_send(0x100, b"")
    seen: list[tuple[float, float]] = []
    bus.run_until(600, lambda i, d, t_us, e: seen.append((t_us, bus.now_us)))
    assert seen == []
    bus.run_until(2000, lambda i, d, t_us, e: seen.append((t_us, bus.now_us)))
    length = bits_by_hand(0x100, b"")
    assert seen == [(length, length + 700)]


def test_drives_hear_each_other_and_not_themselves() -> None:
    """Node 2 watches node 1's heartbeat; node 1 watching itself would hear nothing."""
    host = Host(prompt_drive(1), prompt_drive(2))
    for node in (1, 2):
        host.write(0x1016, 1, 1 << 16 | 50, 4, node)
    host.write(0x1017, 0, 20, 2)
    host.run(100)
    host.write(0x1017, 0, 0, 2)
    host.run(100)
    assert host.heard(0x081) == []
    assert host.heard(0x082)[0][:2] == b"\x30\x81"


def test_silence_costs_nothing() -> None:
    """A day without a frame is one jump."""
    drive = prompt_drive(1)
    host = Host(drive)
    assert drive.next_event_us == math.inf
    host.run(86_400_000)
    assert host.read(0x1000) == 0x00020192


def test_switched_off_in_mid_frame() -> None:
    drive = prompt_drive(1)
    bus = SimulatedBus()
    bus.add(drive)
    collect(bus, 20)  # the boot-up message is on the bus
    drive.power_off()
    assert collect(bus, 1000) == []
    drive.power_on(bus.now_us)
    assert [can_id for can_id, *_ in collect(bus, 2000)] == [0x701]
