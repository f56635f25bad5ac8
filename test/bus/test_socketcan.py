"""SocketCAN as the driver relies on it: echo, time stamps and the full transmit queue."""

from __future__ import annotations

import errno
import time

import can
import pytest

pytestmark = pytest.mark.socketcan

TIMEOUT_S = 5.0


def receive(bus: can.BusABC) -> can.Message:
    message = bus.recv(TIMEOUT_S)
    assert message is not None
    return message


def test_frame_arrives_and_comes_back_with_the_kernels_time(vcan: str) -> None:
    with (
        can.Bus(vcan, "socketcan", receive_own_messages=True) as ours,
        can.Bus(vcan, "socketcan") as other,
    ):
        before = time.time()
        ours.send(can.Message(arbitration_id=0x205, data=range(8), is_extended_id=False))
        echo, arrived = receive(ours), receive(other)
        after = time.time()
    # python-can's `is_rx` says "from another machine", not "from another socket"
    assert not echo.is_rx and not arrived.is_rx
    for message in (echo, arrived):
        assert (message.arbitration_id, bytes(message.data)) == (0x205, bytes(range(8)))
        assert before <= message.timestamp <= after
    assert echo.timestamp == arrived.timestamp


def test_frames_of_one_sender_stay_in_order(vcan: str) -> None:
    with can.Bus(vcan, "socketcan") as ours, can.Bus(vcan, "socketcan") as other:
        for n in range(200):
            identifier = 0x080 if n % 10 == 0 else 0x201 + n % 6
            ours.send(can.Message(arbitration_id=identifier, data=[n], is_extended_id=False))
        assert [receive(other).data[0] for _ in range(200)] == list(range(200))


def test_slow_adapter_refuses_a_burst_and_loses_nothing_it_took(slow_vcan: str) -> None:
    """The queue fills up; what was accepted is sent at about a frame a millisecond."""
    with (
        can.Bus(slow_vcan, "socketcan", receive_own_messages=True) as ours,
        can.Bus(slow_vcan, "socketcan") as other,
    ):
        accepted, refused = [], []
        for n in range(60):
            try:
                ours.send(can.Message(arbitration_id=0x205, data=[n], is_extended_id=False))
                accepted.append(n)
            except can.CanOperationError as error:
                assert error.error_code == errno.ENOBUFS
                refused.append(n)
        arrived = [receive(other) for _ in accepted]
        echoes = [receive(ours) for _ in accepted]
        assert other.recv(0.1) is None
    assert refused and len(accepted) >= 10
    assert [message.data[0] for message in arrived] == accepted
    assert [message.data[0] for message in echoes] == accepted
    # the echo's time is that of the transmission, not of the call
    duration = echoes[-1].timestamp - echoes[0].timestamp
    assert duration >= 0.9e-3 * (len(accepted) - 2)
