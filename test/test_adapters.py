"""The driver on adapters that need neither CAN hardware nor privileges: `virtual` and `slcan`.

The drives are in another process; those on `virtual` can only be in the same.
"""

from __future__ import annotations

import os
import time
import tty
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from two_processes import SCAN, TARGET_M, Drives, assert_log_ends_at, assert_moves, rig

from epos2_ros.bus.slcan import SlcanBus
from epos2_ros.config import SimulationConfig
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

    def __init__(self, folder: Path) -> None:
        self.path = folder / "ttyACM0"
        self._folder = folder
        self._drives: Drives | None = None

    def plug_in(self) -> None:
        drives = self._drives = Drives("--slcan", "--nodes", "1-2", log=self._folder / "log.npz")
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
def port(tmp_path: Path) -> Iterator[Port]:
    pytest.importorskip("serial")
    made = Port(tmp_path)
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
