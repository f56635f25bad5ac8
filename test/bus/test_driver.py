"""The driver with simulated drives in its own process: what neither group nor node decides."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from threading import Barrier, Event

import numpy as np
import pytest
from two_processes import SCAN, rig

from epos2_ros.bus import driver as driver_module
from epos2_ros.bus.epos2 import Epos2Node
from epos2_ros.errors import DriveError, TrajectoryError
from epos2_ros.motion.reference import Reference
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.protocol.identity import Identity
from epos2_ros.protocol.path import Placement


@pytest.mark.parametrize("stop", ["halt", "quick_stop", "stop_on_path"])
def test_what_is_worked_out_while_the_axes_are_stopped_does_not_begin(
    stop: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    at_work, stopped = Event(), Event()
    join = Placement.join

    def slow_join(placement: Placement) -> Reference:
        at_work.set()
        assert stopped.wait(10)
        return join(placement)

    monkeypatch.setattr(Placement, "join", slow_join)
    trajectory = Trajectory(SCAN.joint_names, np.array([1.0]), np.array([[0.05, -0.02]]))
    with rig("virtual", f"driver {stop}", simulate=True) as made, ThreadPoolExecutor(1) as pool:
        answer = pool.submit(made.driver.submit, trajectory)
        assert at_work.wait(10)
        getattr(made.driver, stop)()
        made.driver.enable()
        stopped.set()
        with pytest.raises(TrajectoryError, match="stopped while it was worked out"):
            answer.result(10)
        assert made.snapshot().state == "standing"


def test_another_model_in_a_drive_s_place_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Until one like the first is there again; another of its kind is welcome."""
    identities = {
        1: Identity(0xFB, 0x6420_0000, 0x2126_0000, 17, "EPOS2"),
        2: Identity(0xFB, 0x6322_0000, 0x2126_0000, 5, "EPOS2"),
    }
    monkeypatch.setattr(driver_module, "read_identity", lambda node: identities[node.id])
    with rig("virtual", "driver swap", simulate=True) as made:
        told = identities[1]
        identities[1] = identities[2]
        lost = made.driver._group._watch._lost
        made.driver._reactor.call(lambda: lost.update(made.driver._nodes))
        with pytest.raises(DriveError, match="was a maxon EPOS2 70/10 and is now a maxon"):
            made.driver.reset_fault()
        identities[1] = replace(told, revision=0x2120_0000, serial_number=18)
        made.driver.reset_fault()
        made.driver.enable()


def test_drives_are_brought_up_side_by_side(monkeypatch: pytest.MonkeyPatch) -> None:
    """Six that answer late take as long as one."""
    both, configure = Barrier(2), Epos2Node.configure

    def together(node: Epos2Node) -> int:
        both.wait(10)
        return configure(node)

    monkeypatch.setattr(Epos2Node, "configure", together)
    with rig("virtual", "driver bring-up", simulate=True) as made:
        assert made.snapshot().state == "standing"
