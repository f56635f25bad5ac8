"""The driver on `udp_multicast`, its drives in another process, in a network of the tests' own.

Such a network is where SocketCAN is (marker `socketcan`).
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from socketcan_guest import run_tool
from two_processes import Drives, assert_log_ends_at, assert_moves, rig

from epos2_ros.errors import BusError

pytestmark = pytest.mark.socketcan

UDP_GROUP = "239.74.163.2"


@pytest.fixture
def loopback() -> Iterator[None]:
    """Multicast stays on this machine; `ip link set lo down` breaks it."""
    run_tool("ip", "link", "set", "lo", "multicast", "on", "up")
    run_tool("ip", "route", "replace", "239.0.0.0/8", "dev", "lo")
    yield
    run_tool("ip", "link", "set", "lo", "up")


def test_udp_multicast_without_a_network_and_with_one_again(loopback: None, tmp_path: Path) -> None:
    place = ("--interface", "udp_multicast", "--channel", UDP_GROUP)
    drives = Drives(*place, "--nodes", "1-2", log=tmp_path / "log.npz")
    try:
        with rig("udp_multicast", UDP_GROUP) as made:
            assert_moves(made)
            run_tool("ip", "link", "set", "lo", "down")
            snapshot = made.wait(lambda snapshot: snapshot.state == "fault")
            assert f"udp_multicast:{UDP_GROUP} " in snapshot.reason
            with pytest.raises(BusError):
                made.driver.reset_fault()
            run_tool("ip", "link", "set", "lo", "up")
            run_tool("ip", "route", "replace", "239.0.0.0/8", "dev", "lo")
            made.driver.reset_fault()
            made.driver.enable()
            made.go_back()
        assert_log_ends_at(drives.close(), (0.0, 0.0))
    finally:
        drives.kill()
