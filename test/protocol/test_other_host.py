"""Another host on the bus: refused at bring-up without a frame of ours, a fault when it appears."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator

import can
import numpy as np
import pytest
from campaign import Director
from simulated_time import Bench, axes
from two_processes import SCAN, Rig, rig

from epos2_ros.bus.link import Link
from epos2_ros.configuration.driver import DriverConfig
from epos2_ros.errors import BusError
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.protocol.frame import Frame
from epos2_ros.protocol.intake import Intake, Rejects
from epos2_ros.protocol.other_host import OtherHost
from epos2_ros.sim.epos2 import Epos2

JOINTS = ("joint_1", "joint_2")
NAMES = {1: "x (node 1)", 2: "y (node 2)"}
HEARTBEAT = Frame(0x77F, b"\x05")
COMMANDS = [
    (HEARTBEAT, "a heartbeat of node 127"),
    (Frame(0x080), "a SYNC"),
    (Frame(0x080, b"\x07"), "a SYNC"),
    (Frame(0x000, b"\x01\x00"), "an NMT command"),
    (Frame(0x100, bytes(6)), "a TIME"),
    (Frame(0x502, b"\x0f\x00"), r"PDOs to y \(node 2\) \(0x502\)"),
    (Frame(0x201, bytes(8)), r"PDOs to x \(node 1\) \(0x201\)"),
]
OTHERS = [
    Frame(0x181, bytes(8)), Frame(0x701, b"\x05"), Frame(0x581, bytes(8)), Frame(0x081, bytes(8)),
    Frame(0x703, b"\x05"), Frame(0x503, b"\x0f\x00"), Frame(0x601, bytes(8)),
]  # fmt: skip


class Stranger:
    """A host that is not ours; its frames go out every 100 ms until it is closed."""

    def __init__(self, channel: str, frame: Frame) -> None:
        self._bus = can.Bus(channel, "virtual")
        self._frame = frame
        self._gone = threading.Event()
        self.heard: list[can.Message] = []
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        while not self._gone.is_set():
            message = can.Message(
                arbitration_id=self._frame.can_id, data=self._frame.data, is_extended_id=False
            )
            self._bus.send(message)
            self._gone.wait(0.1)
            while (heard := self._bus.recv(0.0)) is not None:
                self.heard.append(heard)

    def close(self) -> None:
        self._gone.set()
        self._thread.join()
        self._bus.shutdown()


@pytest.fixture
def channel() -> str:
    return f"other host {time.monotonic_ns()}"


@pytest.fixture
def made(channel: str) -> Iterator[Rig]:
    with rig("virtual", channel, simulate=True) as made:
        yield made


@pytest.mark.parametrize(("frame", "what"), COMMANDS)
def test_one_frame_of_a_host_at_work(frame: Frame, what: str) -> None:
    told = OtherHost(NAMES, sends_sync=True).look(frame, 0.0, at_work=True)
    assert told.startswith("another host is on this bus: ")
    assert what.replace("\\", "") in told


def test_what_drives_and_tools_send_is_no_sign_of_a_host() -> None:
    other = OtherHost(NAMES, sends_sync=False)
    for frame in (*OTHERS, Frame(0x080)):  # which a drive sends here
        assert other.look(frame, 0.0, at_work=True) == ""
    assert other.still_there(0.0) == ""


def test_before_the_bring_up_it_takes_two_frames_some_time_apart() -> None:
    other = OtherHost(NAMES, sends_sync=True)
    for t_us in (0.0, 100.0, 200.0):  # of ours, that an adapter had held back
        assert other.look(HEARTBEAT, t_us, at_work=False) == ""
    assert other.look(Frame(0x080), 1e5, at_work=False) == ""  # a drive of an earlier host
    assert other.look(HEARTBEAT, 3e6, at_work=False) == ""
    assert other.look(HEARTBEAT, 3.1e6, at_work=False)
    assert other.still_there(3.2e6)
    assert not other.still_there(4.2e6)


def test_a_bus_with_another_host_is_refused_and_not_disturbed(channel: str) -> None:
    stranger = Stranger(channel, HEARTBEAT)
    try:
        with (
            pytest.raises(BusError, match="another host is on this bus: there is a heartbeat"),
            rig("virtual", channel),
        ):
            pass
    finally:
        stranger.close()
    assert not stranger.heard


def test_nothing_is_sent_until_the_bus_was_listened_to(channel: str) -> None:
    lock = threading.RLock()

    def post(job: Callable[[], None]) -> bool:
        with lock:
            job()
        return True

    intake = Intake({}, {}, Rejects())
    with can.Bus(channel, "virtual") as other:
        on = (lambda *_: None, print, print)
        link = Link("virtual", channel, 1_000_000, intake, *on, post, post)
        try:
            post(lambda: link.send(HEARTBEAT))  # of a group that goes on while the bus is reopened
            assert other.recv(0.1) is None
            link.probe()
            post(lambda: link.send(HEARTBEAT))
            heard = [other.recv(1.0), other.recv(1.0)]
        finally:
            link.close()
    assert [m.arbitration_id for m in heard if m is not None] == [0x000, 0x77F]


@pytest.mark.parametrize("frame", [HEARTBEAT, Frame(0x080), Frame(0x502, b"\x06\x00")])
def test_a_host_that_appears_stops_all_until_it_is_gone(
    frame: Frame, channel: str, made: Rig
) -> None:
    made.driver.submit(Trajectory(SCAN.joint_names, np.array([4.0]), np.array([[0.2, -0.1]])))
    made.wait(lambda snapshot: snapshot.state == "moving")
    stranger = Stranger(channel, frame)
    try:
        snapshot = made.wait(lambda snapshot: snapshot.state == "fault")
        assert "another host is on this bus" in snapshot.reason
        with pytest.raises(BusError, match="another host is on this bus"):
            made.driver.reset_fault()
    finally:
        stranger.close()
    time.sleep(1.1)
    made.driver.reset_fault()
    made.driver.enable()
    assert made.snapshot().state == "standing"


@pytest.mark.parametrize("after_s", [0.003, 0.03, 0.06])
@pytest.mark.parametrize("frame", [Frame(0x080), Frame(0x100, bytes(6))])
def test_the_clocks_are_known_again_after_the_sync_or_time_of_a_host_that_is_gone(
    frame: Frame, after_s: float
) -> None:
    """In simulated time. It comes so long after one of ours: a slow drive, which has its time stamp
    half a period after the SYNC, takes it for that of this one."""
    drives = [Epos2(n, drift_ppm=drift, offset_us=1e6 * n) for n, drift in ((1, 80), (2, -190))]
    bench = Bench(DriverConfig(axes=axes(2)), drives)
    bench.enable()
    stranger = Director()
    bench.bus.add(stranger)  # type: ignore[arg-type]
    bench.run(1.0)
    at_us = next(t for t, sent, _ in reversed(bench.frames) if sent.can_id == 0x080)
    at_us += 0.2e6 + after_s * 1e6
    stranger.at(at_us, lambda _: stranger.outbox.append((frame.can_id, frame.data)))
    bench.run(0.9)
    ends = np.array([[0.0, 0.0], [0.2, -0.2]])
    bench.path.submit(Trajectory(JOINTS, np.array([0.0, 1.5]), ends), None, bench.now_us)
    bench.wait(bench.group.motion)  # type: ignore[arg-type]
    assert [d.position_demand for d in drives] == [round(d * 2e5 / math.tau) for d in (0.2, -0.2)]
