"""The driver on SocketCAN, simulated drives as another process: motion, a slow bus, trouble."""

from __future__ import annotations

import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from itertools import count
from pathlib import Path

import can
import pytest
from builtin_interfaces.msg import Time
from can.interfaces.socketcan import SocketcanBus
from diagnostic_msgs.msg import DiagnosticStatus
from socketcan_guest import run_tool
from two_processes import QC_PER_M, SCAN, Drives, Rig, assert_executed, rig

from epos2_ros.bus.link import Link
from epos2_ros.bus.snapshot import AxisSnapshot
from epos2_ros.configuration.driver import ClockLimits
from epos2_ros.errors import BusError, DriveError
from epos2_ros.node.messages import diagnostics
from epos2_ros.protocol.frame import Frame
from epos2_ros.protocol.intake import Intake, Rejects

pytestmark = pytest.mark.socketcan

SO_RCVBUFFORCE = 33
SO_TIMESTAMPNS = 35
FIRST_RECORD_US = 1_000.0  # holds; then the trajectory begins
CAN_ERR_FLAG = 0x2000_0000


class Tap:
    """All frames on an interface since it was opened, read when they are asked for."""

    def __init__(self, channel: str) -> None:
        self._socket = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        self._socket.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, 256 << 20)
        self._socket.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        self._socket.bind((channel,))
        self._socket.setblocking(False)
        self._frames: list[tuple[float, Frame]] = []

    def frames(self) -> list[tuple[float, Frame]]:
        """With the wall-clock time [s] at which the kernel had them."""
        while True:
            try:
                data, [(_, _, stamp)], _, _ = self._socket.recvmsg(16, 64)
            except BlockingIOError:
                return self._frames
            seconds, nanoseconds = struct.unpack("@ll", stamp)
            frame = Frame(int.from_bytes(data[:4], "little"), data[8 : 8 + data[4]])
            self._frames.append((seconds + 1e-9 * nanoseconds, frame))

    def records(self) -> dict[int, list[bytes]]:
        """The PVT records (RPDO1) by node."""
        found: dict[int, list[bytes]] = {1: [], 2: []}
        for _, frame in self.frames():
            if frame.can_id in (0x201, 0x202):
                found[frame.can_id - 0x200].append(frame.data)
        return found

    def started_s(self) -> float:
        """When the SYNC was sent that made "enable ip mode" (bit 4, RPDO2) count in both drives."""
        enabled = set()
        for at_s, frame in self.frames():
            if frame.can_id in (0x301, 0x302) and frame.data[0] & 0x10:
                enabled.add(frame.can_id)
            elif frame.can_id == 0x080 and len(enabled) == 2:
                return at_s
        raise AssertionError("no start")


@pytest.fixture
def drives(vcan: str, tmp_path: Path) -> Iterator[Drives]:
    made = Drives(
        *("--interface", "socketcan", "--channel", vcan, "--nodes", "1-2"),
        *("--drift-ppm", "100", "--seed", "1"),
        log=tmp_path / "log.npz",
    )
    yield made
    made.kill()


def assert_every_record_arrived(tap: Tap, made: Rig) -> None:
    records = tap.records()
    for axis in made.snapshot().axes:
        assert len(records[axis.node_id]) == axis.records_sent > 20
        ends = [n for n, record in enumerate(records[axis.node_id]) if record[7] == 0]
        assert ends == [axis.records_sent - 1]


def there(axis: AxisSnapshot, end_m: float) -> bool:
    return abs(axis.position - end_m) < 1e-4


def send_error_frame(channel: str, classes: int, data: bytes = b"") -> None:
    """As a controller's driver does; `data` as in linux/can/error.h."""
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as raw:
        raw.bind((channel,))
        raw.send(struct.pack("<IB3x8s", CAN_ERR_FLAG | classes, 8, data))


# ---------------------------------------------------------------------------- motion


def test_a_trajectory_runs_on_drives_in_another_process(vcan: str, drives: Drives) -> None:
    tap = Tap(vcan)
    with rig("socketcan", vcan) as made:
        assert made.snapshot().sync_time_source.startswith("echo, system clock")
        at_s = time.time() + 1.0
        snapshot = made.scan(at_s)
        kinds = [event.kind for event in made.events if event.kind != "drive"]
        assert kinds == ["waiting", "started", "done"]
        assert_every_record_arrived(tap, made)
        assert snapshot.dropped_frames == snapshot.error_frames == 0
        assert snapshot.bus_state == "error active"
        for axis, end in zip(snapshot.axes, SCAN.positions[-1], strict=True):
            assert axis.executed_qc == round(end * QC_PER_M)
            assert abs(axis.clock_drift_ppm) <= 200
        # The measured positions come in reports of their own, after the one that ended it.
        made.wait(lambda snapshot: all(map(there, snapshot.axes, SCAN.positions[-1])))
        made.driver.disable()
        assert {axis.state for axis in made.snapshot().axes} == {"ready to switch on"}
    assert_executed(drives.close())
    late_us = 1e6 * (tap.started_s() - at_s) + FIRST_RECORD_US
    assert 0 <= late_us == pytest.approx(snapshot.start_error_us, abs=20)


def test_a_full_transmit_queue_loses_and_reorders_nothing(
    slow_vcan: str, drives: Drives, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another program fills SocketCAN's queue of ten frames, one sent a millisecond, again and
    again just before the driver sends a frame, which then gets ENOBUFS."""
    tap = Tap(slow_vcan)
    crowd = can.Message(arbitration_id=0x6E0, is_extended_id=False)
    frames = count()
    send = SocketcanBus.send

    with can.Bus(slow_vcan, "socketcan") as other:

        def crowded(bus: SocketcanBus, message: can.Message, timeout: float | None = None) -> None:
            if next(frames) % 30 == 0:
                with suppress(can.CanOperationError):
                    for _ in range(15):
                        send(other, crowd)
            send(bus, message, timeout)

        with rig("socketcan", slow_vcan, bitrate=125_000) as made:
            monkeypatch.setattr(SocketcanBus, "send", crowded)
            snapshot = made.scan()
            assert snapshot.refused_frames > 0
            assert snapshot.dropped_frames == 0
            assert_every_record_arrived(tap, made)
    assert_executed(drives.close())


# ---------------------------------------------------------------------------- echoes


def test_only_our_own_frames_are_taken_for_echoes(vcan: str) -> None:
    """To the kernel every frame on this machine is a local one, whichever program sent it."""
    seen: list[tuple[Frame, bool]] = []
    done = threading.Event()

    def on_frame(frame: Frame, t_us: float, echo: bool) -> None:
        seen.append((frame, echo))
        if frame.can_id == 0x7FF:
            done.set()

    lock = threading.RLock()

    def post(job: Callable[[], None]) -> bool:
        with lock:
            job()
        return True

    ours, theirs = Frame(0x080), Frame(0x183, b"\x01")
    intake = Intake({}, {}, Rejects())
    link = Link("socketcan", vcan, 1_000_000, intake, on_frame, print, print, post, post)
    link.probe()
    with can.Bus(vcan, "socketcan") as other:
        for frame in (theirs, ours, Frame(0x7FF)):  # a SYNC that we have not sent, too
            if frame is ours:
                post(lambda: link.send(ours))
            other.send(
                can.Message(arbitration_id=frame.can_id, data=frame.data, is_extended_id=False)
            )
        try:
            assert done.wait(10)
        finally:
            link.close()
    assert [echo for frame, echo in seen if frame == theirs] == [False]
    assert sorted(echo for frame, echo in seen if frame == ours) == [False, True]


# ---------------------------------------------------------------------------- trouble


def assert_back_after_reset(made: Rig) -> None:
    made.driver.reset_fault()
    assert made.snapshot().state == "disabled"
    made.driver.enable()
    made.go_back()


def test_an_interface_that_goes_down_and_comes_back(vcan: str, drives: Drives) -> None:
    with rig("socketcan", vcan) as made:
        made.driver.submit(SCAN)
        made.wait(lambda snapshot: snapshot.state == "moving")
        run_tool("ip", "link", "set", vcan, "down")
        snapshot = made.wait(lambda snapshot: snapshot.state == "fault")
        assert f"socketcan:{vcan}" in snapshot.reason
        with pytest.raises(BusError, match="interface up"):
            made.driver.reset_fault()
        run_tool("ip", "link", "set", vcan, "up")
        assert_back_after_reset(made)


def test_a_cable_pulled_out_and_put_back(vcan: str, drives: Drives) -> None:
    """A controller that nobody acknowledges keeps its frames: here the queue lets none through."""
    with rig("socketcan", vcan) as made:
        shape = ["rate", "8bit", "burst", "16", "limit", "1600"]
        run_tool("tc", "qdisc", "add", "dev", vcan, "root", "tbf", *shape)
        snapshot = made.wait(lambda snapshot: snapshot.state == "fault")
        assert "no longer puts frames on the bus: check the cable" in snapshot.reason
        assert snapshot.dropped_frames > 0
        with pytest.raises((BusError, DriveError)):
            made.driver.reset_fault()
        run_tool("tc", "qdisc", "delete", "dev", vcan, "root")
        assert_back_after_reset(made)


@pytest.mark.parametrize(
    ("classes", "data", "state", "counters"),
    [
        (0x040, b"", "bus off", (0, 0)),
        (0x004, b"\x00\x20\x00\x00\x00\x00\x80\x07", "error passive", (128, 7)),
    ],
)
def test_a_bad_bus_stops_the_motion(
    vcan: str, drives: Drives, classes: int, data: bytes, state: str, counters: tuple[int, int]
) -> None:
    with rig("socketcan", vcan) as made:
        made.driver.submit(SCAN)
        made.wait(lambda snapshot: snapshot.state == "moving")
        send_error_frame(vcan, classes, data)
        snapshot = made.wait(lambda snapshot: snapshot.state == "fault")
        assert f"is {state}" in snapshot.reason
        assert (snapshot.bus_state, snapshot.error_frames) == (state, 1)
        assert (snapshot.transmit_errors, snapshot.receive_errors) == counters
        *_, bus = diagnostics(snapshot, "driver", vcan, Time(), ClockLimits()).status
        assert (bus.level, bus.message) == (DiagnosticStatus.ERROR, snapshot.reason)
        assert {"controller": state, "error frames": "1"}.items() <= {
            value.key: value.value for value in bus.values
        }.items()
        made.driver.reset_fault()
        made.driver.enable()
        assert made.snapshot().state == "standing"


def test_an_error_warning_is_told_and_stops_nothing(vcan: str, drives: Drives) -> None:
    with rig("socketcan", vcan) as made:
        send_error_frame(vcan, 0x004, b"\x00\x08\x00\x00\x00\x00\x60\x00")
        snapshot = made.wait(lambda snapshot: snapshot.error_frames == 1)
        assert (snapshot.bus_state, snapshot.transmit_errors) == ("error warning", 96)
        assert made.snapshot().state == "standing"
        send_error_frame(vcan, 0x004, b"\x00\x40")
        made.wait(lambda snapshot: snapshot.bus_state == "error active")
