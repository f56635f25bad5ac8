"""The driver on the adapters that need no CAN hardware.

The drives are in another process; those on `virtual` can only be in the same. `udp_multicast`
runs where SocketCAN does (marker `socketcan`), in a network of the tests' own.
"""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from two_processes import QC_PER_M, Drives, Rig, rig

from epos2_ros.config import SimulationConfig
from epos2_ros.errors import BusError

UDP_GROUP = "239.74.163.2"
TARGET_M = (0.05, -0.02)


def assert_log_ends_at(log: dict[str, np.ndarray], target_m: tuple[float, float]) -> None:
    for node, wanted in enumerate(target_m, start=1):
        assert log[f"node_{node}_demand_qc"][-1] == round(wanted * QC_PER_M)


def assert_moves(made: Rig) -> None:
    snapshot = made.go_to(TARGET_M)
    assert (snapshot.dropped_frames, snapshot.error_frames) == (0, 0)
    assert all(axis.records_sent > 3 for axis in snapshot.axes)


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


def test_slcan_pulled_out_and_plugged_in_again(port: Port) -> None:
    """The drives lose their power with it, so they are configured anew, too."""
    with rig("slcan", str(port.path)) as made:
        assert made.snapshot().sync_time_source.startswith("no echo")
        assert_moves(made)
        assert_log_ends_at(port.pull_out(), TARGET_M)
        snapshot = made.wait(lambda snapshot: snapshot.state == "fault")
        assert f"slcan:{port.path} can't " in snapshot.reason
        with pytest.raises(BusError, match="can't open CAN interface 'slcan'"):
            made.driver.reset_fault()
        port.plug_in()
        made.driver.reset_fault()
        made.driver.enable()
        assert made.snapshot().axes[0].position == 0.0  # not the old drives
        assert_moves(made)


# ---------------------------------------------------------------------------- udp_multicast


def ip(*arguments: str) -> None:
    subprocess.run(["ip", *arguments], check=True)


@pytest.fixture
def loopback() -> Iterator[None]:
    """Multicast stays on this machine; `ip link set lo down` breaks it."""
    ip("link", "set", "lo", "multicast", "on", "up")
    ip("route", "replace", "239.0.0.0/8", "dev", "lo")
    yield
    ip("link", "set", "lo", "up")


@pytest.mark.socketcan
def test_udp_multicast_without_a_network_and_with_one_again(loopback: None, tmp_path: Path) -> None:
    place = ("--interface", "udp_multicast", "--channel", UDP_GROUP)
    drives = Drives(*place, "--nodes", "1-2", log=tmp_path / "log.npz")
    try:
        with rig("udp_multicast", UDP_GROUP) as made:
            assert_moves(made)
            ip("link", "set", "lo", "down")
            snapshot = made.wait(lambda snapshot: snapshot.state == "fault")
            assert f"udp_multicast:{UDP_GROUP} " in snapshot.reason
            with pytest.raises(BusError):
                made.driver.reset_fault()
            ip("link", "set", "lo", "up")
            ip("route", "replace", "239.0.0.0/8", "dev", "lo")
            made.driver.reset_fault()
            made.driver.enable()
            made.go_back()
        assert_log_ends_at(drives.close(), (0.0, 0.0))
    finally:
        drives.kill()
