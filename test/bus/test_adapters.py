"""The driver on adapters that need neither CAN hardware nor privileges: `virtual` and `slcan`.

The drives are in another process; those on `virtual` can only be in the same.
"""

from __future__ import annotations

import os
import random
import time
import tty
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from two_processes import SCAN, TARGET_M, Drives, assert_log_ends_at, assert_moves, rig

from epos2_ros.bus.slcan import SlcanBus
from epos2_ros.configuration.driver import SimulationConfig
from epos2_ros.errors import BusError

# ---------------------------------------------------------------------------- virtual


def test_virtual(tmp_path: Path) -> None:
    log = tmp_path / "log.npz"
    simulation = SimulationConfig(log=str(log))
    with rig("virtual", "adapters", simulate=True, simulation=simulation) as made:
        assert made.snapshot().sync_time_source.startswith("echo")
        assert_moves(made)
    with np.load(log) as columns:
        assert_log_ends_at(dict(columns), TARGET_M)


# ---------------------------------------------------------------------------- slcan


class Port:
    """A serial port with a simulated slcan adapter plugged in, or none."""

    def __init__(self, folder: Path, dictionary: str) -> None:
        self._dictionary = dictionary
        self.path = folder / "ttyACM0"
        self._folder = folder
        self._drives: Drives | None = None

    def plug_in(self) -> None:
        arguments = "--slcan", "--nodes", "1-2", "--dictionary", self._dictionary
        drives = self._drives = Drives(*arguments, log=self._folder / "log.npz")
        self.path.symlink_to(drives.says.split()[-1])

    def pull_out(self) -> dict[str, np.ndarray]:
        """Also what the drives behind it executed."""
        assert self._drives is not None
        self.path.unlink()
        return self._drives.close()

    def close(self) -> None:
        if self._drives is not None:
            self._drives.kill()


@pytest.fixture
def port(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Port]:
    """With drives of the maker's dictionary, or of that the test is parametrised with."""
    pytest.importorskip("serial")
    made = Port(tmp_path, getattr(request, "param", "maker"))
    made.plug_in()
    yield made
    made.close()


def test_slcan_frames_come_whole_however_the_port_cuts_them() -> None:
    pytest.importorskip("serial")
    master, slave = os.openpty()
    tty.setraw(slave)
    with SlcanBus(os.ttyname(slave), sleep_after_open=0) as bus:
        for part in (b"t181", b"2CA", b"FE\rz\rt0800\r\at7", b"01105\r"):
            os.write(master, part)
        got = [bus.recv(5.0) for _ in range(3)]
        assert [(m.arbitration_id, bytes(m.data)) for m in got if m] == [
            (0x181, b"\xca\xfe"),
            (0x080, b""),
            (0x701, b"\x05"),
        ]
        os.write(master, b"t7011")
        assert bus.recv(0.05) is None
        os.write(master, b"7F\r")
        late = bus.recv(5.0)
        assert late is not None and bytes(late.data) == b"\x7f"
    os.close(master)
    os.close(slave)


class Line:
    """A serial line with an adapter's end of it in our hands; `told` is what was dropped."""

    def __init__(self) -> None:
        pytest.importorskip("serial")
        self.end, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.bus = SlcanBus(os.ttyname(self._slave), sleep_after_open=0)
        self.told: list[tuple[str, str]] = []
        self.bus.on_reject = lambda kind, what: self.told.append((kind, what))

    def heard(self, *parts: bytes) -> list[tuple[int, bytes]]:
        """The frames in what the adapter says; the last of them is 0x7FF."""
        for part in (*parts, b"t7FF0\r"):
            os.write(self.end, part)
        frames = []
        while (message := self.bus.recv(5.0)) is not None:
            if message.arbitration_id == 0x7FF:
                return frames
            frames.append((message.arbitration_id, bytes(message.data)))
        raise AssertionError("deaf")

    def close(self) -> None:
        self.bus.shutdown()
        os.close(self.end)
        os.close(self._slave)


@pytest.fixture
def line() -> Iterator[Line]:
    made = Line()
    yield made
    made.close()


def test_slcan_lines_that_end_with_cr_and_lf(line: Line) -> None:
    assert line.heard(b"t1812CAFE\r\nz\r\n\r\nt0800\r\nt701105\r\n") == [
        (0x181, b"\xca\xfe"),
        (0x080, b""),
        (0x701, b"\x05"),
    ]
    assert not line.told


GARBLED = [
    b"t", b"t18", b"t181", b"t1812", b"t1812CA", b"t1812CAF", b"t1812CAFEE", b"t1812CAFE80",
    b"t1819CAFE", b"tXYZ0", b"t-010", b"t 810", b"t1_10", b"t1812CA FE", b"\xff\xfe\x00",
    b"t1812CAt1812CAFE", b"T00000181", b"T200001810", b"r1819", b"d1819", b"hello", b"t1812CA\xfe",
]  # fmt: skip


def test_garbled_slcan_lines_are_dropped_and_the_next_is_heard(line: Line) -> None:
    line.heard()
    for garbage in GARBLED:
        line.told.clear()
        assert line.heard(garbage + b"\r", b"t1812CAFE\r") == [(0x181, b"\xca\xfe")], garbage
        assert line.told == [("garbled serial line", f"garbled line {garbage!r}")]
    assert line.heard(b"t1812CAFE12AB\r") == [(0x181, b"\xca\xfe")]  # with a time stamp
    line.told.clear()
    assert line.heard(bytes(3000), b"\rt1812CAFE\r") == [(0x181, b"\xca\xfe")]
    assert 1 <= len(line.told) <= 3000 / 64 + 1


def test_any_bytes_on_an_slcan_line_do_not_deafen(line: Line, fuzz: int) -> None:
    rng = random.Random(1)
    line.heard()
    for _ in range(200 * fuzz):
        words = [b"t1812CAFE", b"\r", b"\n", b"\a", b"z", b"T", b"r", rng.randbytes(3), b"7", b"F"]
        data = b"".join(rng.choice(words) for _ in range(rng.randrange(30)))
        for can_id, content in line.heard(data, b"\r"):
            assert can_id < 1 << 29 and len(content) <= 8


def test_a_frame_that_the_slcan_adapter_refuses_is_told(line: Line) -> None:
    assert line.heard(b"\a\a") == []  # whatever it refused while it was opened
    assert not line.told
    assert line.heard(b"z\r\az\r") == []
    assert [kind for kind, _ in line.told] == ["frame refused by the serial adapter"]


def test_slcan_pulled_out_and_plugged_in_again(port: Port) -> None:
    """The drives lose their power with it, so they are configured anew, too."""
    with rig("slcan", str(port.path)) as made:
        assert made.snapshot().sync_time_source.startswith("no echo")
        assert_moves(made)
        assert_log_ends_at(port.pull_out(), TARGET_M)
        snapshot = made.wait(lambda snapshot: snapshot.state == "fault")
        assert f"slcan:{port.path} can't " in snapshot.reason
        assert all(axis.silent_s > 0 for axis in snapshot.axes)
        with pytest.raises(BusError, match="can't open CAN interface 'slcan'"):
            made.driver.reset_fault()
        port.plug_in()
        made.driver.reset_fault()
        made.driver.enable()
        assert made.snapshot().axes[0].position == 0.0  # not the old drives
        assert not any(axis.silent_s for axis in made.snapshot().axes)
        assert_moves(made)


@pytest.mark.parametrize("port", ["note"], indirect=True)  # whose drives can send SYNC
def test_slcan_has_no_time_stamps_so_a_drive_is_the_clock_and_sends_sync(port: Port) -> None:
    x, y = SCAN.joint_names
    with rig("slcan", str(port.path), sync_source=x, sync_producer=y) as made:
        assert made.snapshot().sync_time_source.startswith(f"received from {y}")
        assert_moves(made)
        snapshot = made.wait(lambda snapshot: snapshot.sync_count > 30)
        offsets_us = [axis.clock_offset_us for axis in snapshot.axes]
        assert offsets_us == pytest.approx([0.0, 0.0], abs=2.0)  # these drives don't drift
    with SlcanBus(str(port.path)) as bus:
        end_s = time.monotonic() + 1.0
        heard = set()
        while time.monotonic() < end_s:
            if (message := bus.recv(0.1)) is not None:
                heard.add(message.arbitration_id)
    assert heard >= {0x701, 0x702}  # heartbeats
    assert 0x080 not in heard  # the driver has left, and its SYNC with it
    assert_log_ends_at(port.pull_out(), TARGET_M)
