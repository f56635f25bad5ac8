"""SDO with a drive that answers late, twice, out of nowhere, wrongly or not at all.

The server is that of the simulated drive, so what an object holds is known apart from the client.
"""

from __future__ import annotations

import random
import struct
import threading
import time
from collections.abc import Callable

import canopen
import pytest
from canopen.sdo.exceptions import SdoError
from simulated_time import Bench, axes, move_on

from epos2_ros.bus.cia402_node import object_dictionary
from epos2_ros.bus.link import Network
from epos2_ros.bus.sdo_client import RemoteNode
from epos2_ros.configuration.driver import DriverConfig
from epos2_ros.errors import DriveError
from epos2_ros.protocol import epos2
from epos2_ros.protocol.frame import Frame
from epos2_ros.sim.epos2 import Epos2
from epos2_ros.sim.sdo import SdoServer

# Index, subindex, bytes: objects of the EDS that can be read and written.
OBJECTS = [(0x6065, 0, 4), (0x6081, 0, 4), (0x6083, 0, 4), (0x6084, 0, 4), (0x6085, 0, 4)]
DICTIONARY = object_dictionary(epos2.FAMILY)
Answers = Callable[[bytes, bytes | None], list[bytes]]  # what comes back for request and answer


class Wire:
    """A node of the driver and the server of a drive; `answers` is what lies between."""

    def __init__(self, answers: Answers) -> None:
        self.drive = Epos2(1)
        self.server = SdoServer(self.drive.dictionary)
        self.answers = answers
        self.requests: list[bytes] = []
        network = Network(self._send)
        self.node = RemoteNode(1, DICTIONARY, "joint_1")
        network[1] = self.node
        self.sdo = self.node.sdo
        self.sdo.RESPONSE_TIMEOUT = 0.005

    def _send(self, frame: Frame) -> None:
        assert frame.can_id == 0x601 and len(frame.data) == 8
        self.requests.append(frame.data)
        answer = self.server.request(frame.data)
        for data in self.answers(frame.data, answer):
            self.sdo.on_response(0x581, bytearray(data), 0.0)

    def value(self, index: int, subindex: int, size: int) -> int:
        return int.from_bytes(self.drive.dictionary[index, subindex].pack()[:size], "little")


def right(request: bytes, answer: bytes | None) -> list[bytes]:
    return [] if answer is None else [answer]


class Late:
    """Each answer comes in time, or when up to three more requests have been made."""

    def __init__(self, rng: random.Random, share: float) -> None:
        self._rng = rng
        self._share = share
        self._waiting: list[tuple[int, bytes]] = []

    def __call__(self, request: bytes, answer: bytes | None) -> list[bytes]:
        self._waiting = [(turns - 1, data) for turns, data in self._waiting]
        if answer is not None:
            turns = self._rng.randint(1, 3) if self._rng.random() < self._share else 0
            # In order: none overtakes those before it.
            self._waiting.append((max([turns, *(t for t, _ in self._waiting)]), answer))
        come = [data for turns, data in self._waiting if turns <= 0]
        self._waiting = [(turns, data) for turns, data in self._waiting if turns > 0]
        return come


def test_a_late_answer_is_never_taken_for_that_to_the_next_request(fuzz: int) -> None:
    done = 0
    for seed in range(10 * fuzz):
        rng = random.Random(seed)
        wire = Wire(Late(rng, 0.1))
        for _ in range(30):
            index, subindex, size = rng.choice(OBJECTS)
            try:
                if rng.random() < 0.5:
                    value = rng.randrange(1, 2**31)
                    wire.sdo.download(index, subindex, struct.pack("<I", value))
                    assert wire.value(index, subindex, size) == value
                else:
                    data = wire.sdo.upload(index, subindex)
                    assert int.from_bytes(data, "little") == wire.value(index, subindex, size)
                done += 1
            except canopen.SdoCommunicationError:
                pass  # late over and over
    assert done >= 295 * fuzz


def test_one_late_answer_costs_its_lateness_and_one_request_more() -> None:
    wire = Wire(right)
    late: list[bytes] = []

    def once(request: bytes, answer: bytes | None) -> list[bytes]:
        if answer is not None and not late:
            late.append(answer)
            return []
        if answer is None:
            return []
        return [*late[len(wire.requests) != 3 :], answer]  # with the answer to the next request

    wire.answers = once
    assert wire.sdo.upload(0x6065, 0) == struct.pack("<I", 2000)
    kinds = [data[0] for data in wire.requests]
    # Read, given up (abort), read what never changes, read again.
    assert kinds == [0x40, 0x80, 0x40, 0x40]
    assert wire.requests[2][1:4] != wire.requests[0][1:4] == wire.requests[3][1:4]


def test_an_answer_of_another_object_or_direction_is_not_ours() -> None:
    wire = Wire(right)
    other = b"\x43\x81\x60\x00" + struct.pack("<I", 7)  # the value of 0x6081
    stored = b"\x60\x65\x60\x00" + bytes(4)  # "0x6065 is written"
    refused = b"\x80\x81\x60\x00\x00\x00\x04\x05"
    wire.answers = lambda request, answer: [other, stored, refused, *right(request, answer)]
    assert wire.sdo.upload(0x6065, 0) == struct.pack("<I", 2000)
    assert len(wire.requests) == 1


@pytest.mark.parametrize("size", [0, 1, 2, 3])
def test_an_answer_that_is_too_short_for_its_object_is_refused(size: int) -> None:
    wire = Wire(right)
    short = bytes([0x43 | (4 - size) << 2 if size else 0x41]) + b"\x65\x60\x00" + bytes(4)
    ends = b"\x0f" + bytes(7)  # a last segment of no bytes
    wire.answers = lambda request, answer: [short if request[0] == 0x40 else ends]
    with pytest.raises(canopen.SdoCommunicationError, match=f"has {size} bytes, not 4"):
        wire.sdo.upload(0x6065, 0)


def test_a_transfer_that_never_ends_does() -> None:
    wire = Wire(right)
    endless = b"\x41\x65\x60\x00" + bytes(4)
    wire.answers = lambda request, answer: (
        [endless] if request[0] == 0x40 else [bytes([request[0] & 0x10]) + bytes(7)]
    )
    with pytest.raises(canopen.SdoCommunicationError):
        wire.sdo.upload(0x6065, 0)


def test_a_silent_drive_is_given_up_at_once() -> None:
    wire = Wire(lambda request, answer: [])
    begun_s = time.monotonic()
    with pytest.raises(canopen.SdoCommunicationError, match="no answer about 0x6065-00"):
        wire.sdo.upload(0x6065, 0)
    assert len(wire.requests) == 5 and time.monotonic() - begun_s < 1.0


def test_any_answers_raise_nothing_but_sdo_errors(fuzz: int) -> None:
    errors = 0
    for seed in range(100 * fuzz):
        rng = random.Random(seed)

        def noise(request: bytes, answer: bytes | None, rng: random.Random = rng) -> list[bytes]:
            some = [] if rng.random() < 0.3 else right(request, answer)
            for _ in range(rng.randrange(3)):
                data = bytearray(rng.choice([rng.randbytes(8), answer or bytes(8), request]))
                for _ in range(rng.randrange(3)):
                    data[rng.randrange(8)] ^= 1 << rng.randrange(8)
                some.insert(rng.randrange(len(some) + 1), bytes(data))
            return some

        wire = Wire(noise)
        wire.sdo.RESPONSE_TIMEOUT = 0.001
        for _ in range(5):
            index, subindex, _size = rng.choice([*OBJECTS, (0x1008, 0, 5), (0x60C2, 1, 1)])
            try:
                if rng.random() < 0.5:
                    variable = wire.sdo[index]
                    _ = (variable[subindex] if subindex else variable).raw
                else:
                    wire.sdo.download(index, subindex, rng.randbytes(rng.choice([1, 4, 9, 20])))
            except SdoError:
                errors += 1
    assert errors


def test_bring_up_with_answers_late_by_up_to_a_few_requests() -> None:
    made = Bench(DriverConfig(axes=axes(2)), bring_up=False)
    rng = random.Random(1)
    made.bus.host_delay_us = lambda can_id, data: (
        rng.choice([30e3, 60e3]) if can_id & 0x780 == 0x580 and rng.random() < 0.05 else 0.0
    )
    made.bring_up()
    made.bus.host_delay_us = None
    made.enable()
    move_on(made)


def test_a_drive_that_falls_silent_in_bring_up_is_named() -> None:
    made = Bench(DriverConfig(axes=axes(2)), bring_up=False)
    asked = 0

    def drop(can_id: int, data: bytes, source: int) -> bool:
        nonlocal asked
        asked += can_id == 0x582
        return can_id == 0x582 and asked > 20

    made.bus.drop = drop
    with pytest.raises(DriveError, match=r"joint_2 \(node 2\): can.t .*no answer about"):
        made.bring_up()


def test_the_time_for_setting_up_is_not_that_of_what_follows(monkeypatch):
    """However long ago the drive was set up, it can be asked."""
    bench = Bench()
    later = time.monotonic() + 3600.0
    monkeypatch.setattr("epos2_ros.bus.sdo_access.time.monotonic", lambda: later)
    assert bench.nodes[0]._access.objects.read(0x6041)


# --- polls --------------------------------------------------------------------------------------


CLOCK = bytes.fromhex("4013100000000000")


def test_a_poll_leaves_out_who_is_busy_with_a_transfer() -> None:
    """The second request would be answered in place of the first, or not at all."""
    wire = Wire(right)
    refused: list[bool] = []

    def while_it_is_at_work(request: bytes, answer: bytes | None) -> list[bytes]:
        other = threading.Thread(target=lambda: refused.append(wire.sdo.begin(CLOCK)))
        other.start()
        other.join()
        return [] if answer is None else [answer]

    wire.answers = while_it_is_at_work
    wire.sdo.upload(0x6065, 0)
    assert refused == [False]
    assert len(wire.requests) == 1
    wire.answers = right
    assert wire.sdo.begin(CLOCK)
    wire.sdo.end(0.05)
    assert wire.requests[1:] == [CLOCK]


def test_after_a_poll_without_an_answer_one_that_comes_late_is_taken_for_no_other() -> None:
    wire = Wire(right)
    late: list[bytes] = []

    def in_the_next_turn(request: bytes, answer: bytes | None) -> list[bytes]:
        before = list(late)
        late[:] = [] if answer is None else [answer]
        return before

    wire.answers = in_the_next_turn
    assert wire.sdo.begin(CLOCK)
    wire.sdo.end(0.01)
    wire.answers = lambda request, answer: in_the_next_turn(request, None) + right(request, answer)
    assert wire.sdo.upload(0x6065, 0) == struct.pack("<I", 2000)
    assert wire.requests[1][1:4] != CLOCK[1:4]  # what never changes, first
