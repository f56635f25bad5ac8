"""The host killed, stopped or cut off at any moment: the drives come to rest by themselves.

They watch the host's heartbeat (0x1016: 0.5 s) and then stop on their quick stop ramp (0x6007 = 3,
0x6085: 10,000 rpm/s by default); CiA 301, 7.5.2.19, and maxon's object dictionary. What is in their
buffers is shorter: it ends the motion by an underflow, or by the end record.
"""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from simulated_time import Bench, axes, move_on
from six_axes import there_and_back
from two_processes import ROOT, Drives, assert_moves, rig

from epos2_ros.configuration.driver import DriverConfig
from epos2_ros.errors import DriveError
from epos2_ros.protocol.phase import Phase
from epos2_ros.sim.epos2 import Epos2

WATCH_S = 0.5
RAMP_RPM_S = 10_000.0
QC_PER_RPM_S = 2000 / 60


def rest_s(made: Bench) -> float:
    """How long from now on until no drive's demand changes any more, with nobody there."""
    begin_us, moved_us = made.now_us, made.now_us
    last = [drive._demand for drive in made.drives]
    for _ in range(200):
        made.bus.run_until(made.now_us + 10_000, lambda *frame: None)
        demands = [drive._demand for drive in made.drives]
        if demands != last:
            last, moved_us = demands, made.now_us
    return (moved_us - begin_us) / 1e6


def bound_s(made: Bench) -> float:
    """The watch, and the longest ramp from the speed that the drives have now."""
    velocity_qc_s = 1000 * max(abs(speed_of(drive)) for drive in made.drives)
    # In the time of the watch they go on as they were told, and may become faster.
    faster_rpm = 2000.0
    return WATCH_S + (velocity_qc_s / QC_PER_RPM_S + faster_rpm) / RAMP_RPM_S + 0.02


def speed_of(drive: Epos2) -> float:
    return drive._motor.velocity  # [qc/ms]


def test_killed_or_cut_off_at_any_moment(fuzz: int) -> None:
    moving = 0
    for seed in range(5 * fuzz):
        rng = random.Random(seed)
        made = Bench(DriverConfig(axes=axes(3)), [Epos2(n) for n in (1, 2, 3)])
        made.enable()
        made.path.submit(there_and_back(joints=3), None, made.now_us)
        made.run(rng.uniform(0.0, 2.2))
        if rng.random() < 0.3:
            made.group.halt() if rng.random() < 0.5 else made.group.quick_stop()
            made.run(rng.uniform(0.0, 0.05))
        moving += made.group.phase is Phase.MOVING
        limit_s, cut_off = bound_s(made), rng.random() < 0.5
        for drive in made.drives if cut_off else ():
            drive.disconnect()
        assert rest_s(made) <= limit_s, seed
        for drive in made.drives:
            drive.reconnect()
        assert all(drive.status_word & 0x6F != 0x27 for drive in made.drives)  # off, or in fault
        # Another host finds them so.
        again = Bench(made.config, made.drives, bring_up=False, bus=made.bus)
        again.bring_up()
        again.enable()
        move_on(again)
    assert moving >= 2 * fuzz


@pytest.mark.parametrize("option", [0, 1, 2])
def test_a_stored_reaction_to_a_silent_host_is_put_right(option: int) -> None:
    drive = Epos2(1)
    drive.dictionary[0x6007, 0].value = option
    made = Bench(DriverConfig(axes=axes(1)), [drive])
    assert drive.dictionary[0x6007, 0].value == 3
    made.enable()
    made.path.submit(there_and_back(joints=1), None, made.now_us)
    made.run(0.7)
    limit_s = bound_s(made)
    assert rest_s(made) <= limit_s


@pytest.mark.parametrize(("index", "subindex"), [(0x6007, 0), (0x1016, 1)])
def test_a_drive_that_would_go_on_without_its_host_is_refused(index: int, subindex: int) -> None:
    drive = Epos2(1)
    entry = drive.dictionary[index, subindex]
    entry.read = lambda: 0  # it takes what is written, and keeps to itself what it does
    made = Bench(DriverConfig(axes=axes(1)), [drive], bring_up=False)
    with pytest.raises(DriveError) as refused:
        made.bring_up()
    line = str(refused.value)
    assert line.startswith("joint_1 (node 1) does not keep ")
    assert f"0x{index:04X}-{subindex:02X}" in line and "when the host falls silent" in line


# ---------------------------------------------------------------------------- real processes

DRIVER = """
import sys
sys.path.insert(0, {test!r})
from two_processes import SCAN, rig
with rig("slcan", sys.argv[1]) as made:
    made.driver.submit(SCAN)
    made.wait(lambda snapshot: snapshot.state == "moving")
    print("moving", flush=True)
    for word in sys.stdin:
        snapshot = made.snapshot()
        print(snapshot.state, snapshot.reason, flush=True)
"""


class Host:
    """A driver of the gantry in a process of its own, running the example."""

    def __init__(self, channel: str) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-c", DRIVER.format(test=str(ROOT / "test")), channel],
            cwd=ROOT,
            env={**os.environ, "PYTHONUNBUFFERED": "1"},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self._line() == "moving"

    def _line(self) -> str:
        assert self.process.stdout is not None
        return self.process.stdout.readline().strip()

    def says(self) -> str:
        assert self.process.stdin is not None
        print(file=self.process.stdin, flush=True)
        return self._line()


@pytest.fixture
def drives(tmp_path: Path) -> Iterator[Drives]:
    pytest.importorskip("serial")
    made = Drives("--slcan", "--nodes", "1-2", log=tmp_path / "log.npz")
    yield made
    made.kill()


def last_moved_s(log: dict[str, np.ndarray], until_s: float) -> float:
    """When the demand of either drive changed last, before a time of the monotonic clock."""
    moved_us = [0.0]
    for node in (1, 2):
        demand, t_us = log[f"node_{node}_demand_qc"], log[f"node_{node}_time_us"]
        changed = t_us[1:][np.diff(demand) != 0]
        moved_us += list(changed[changed < 1e6 * until_s][-1:])
    return max(moved_us) / 1e6


def test_sigstop_and_sigkill_in_mid_motion_and_a_new_driver(drives: Drives) -> None:
    channel = drives.says.split()[-1]
    host = Host(channel)
    host.process.send_signal(signal.SIGSTOP)
    time.sleep(0.2)
    host.process.send_signal(signal.SIGCONT)
    time.sleep(0.5)
    assert host.says().startswith("moving")
    killed_s = time.monotonic()
    host.process.send_signal(signal.SIGKILL)
    host.process.wait()
    time.sleep(1.5)
    again_s = time.monotonic()
    with rig("slcan", channel) as made:
        assert_moves(made)
    assert -0.1 < last_moved_s(drives.close(), again_s) - killed_s < WATCH_S + 0.3
