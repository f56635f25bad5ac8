"""The driver in this process, simulated drives in one of their own, on a real bus."""

from __future__ import annotations

import gc
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
from trajectories import example, polynomial

from epos2_ros.bus.driver import Driver
from epos2_ros.bus.snapshot import Snapshot
from epos2_ros.configuration.driver import AxisConfig, DriverConfig
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.protocol.outbox import Event

ROOT = Path(__file__).parents[1]
LEAD = 0.02  # metres of the gantry per motor turn of 2000 qc
QC_PER_M = 2000 / LEAD
TARGET_M = (0.05, -0.02)  # a short move
SCAN = example("raster_scan")  # gantry_x and gantry_y, positions and velocities, 9 s


class Drives:
    """The program `simulator`; ends with `close`."""

    def __init__(self, *arguments: str, log: Path) -> None:
        self._log = log
        self._process = subprocess.Popen(
            [sys.executable, "-m", "epos2_ros", "simulator", *arguments, "--log", str(log)],
            cwd=ROOT,
            env={**os.environ, "PYTHONUNBUFFERED": "1"},
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self._process.stdout is not None
        self.says = self._process.stdout.readline().strip()
        assert self.says.startswith("simulated EPOS2 drives"), self.says

    def close(self) -> dict[str, np.ndarray]:
        """What the drives executed, by node and column."""
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGTERM)
            assert self._process.wait(30) == 0
        with np.load(self._log) as columns:
            return dict(columns)

    def kill(self) -> None:
        """Nothing left of them, whatever became of the test."""
        self._process.kill()
        self._process.wait()


class Rig:
    """A driver of the gantry's two axes; its events are kept."""

    def __init__(self, interface: str, channel: str, **settings: object) -> None:
        self.events: list[Event] = []
        axes = tuple(
            AxisConfig(joint, node, type="prismatic", lead=LEAD)
            for node, joint in enumerate(SCAN.joint_names, start=1)
        )
        settings = {
            "simulate": False,
            "realtime_priority": 0,  # of the tests' process, where these threads run
            "buffer_time": 2.0,  # a busy test machine is no real-time one, …
            "state_rate": 10.0,  # … and under user-mode Linux a frame costs a millisecond
            **settings,
        }
        config = DriverConfig(axes=axes, interface=interface, channel=channel, **settings)  # type: ignore[arg-type]
        self.driver = Driver(config, self.events.append)

    def snapshot(self) -> Snapshot:
        return self.driver.snapshot()

    def wait(self, condition: Callable[[Snapshot], bool], seconds: float = 30.0) -> Snapshot:
        """Until the snapshot is as wanted; fails with what it is instead."""
        end = time.monotonic() + seconds
        while not condition(snapshot := self.driver.snapshot()):
            assert time.monotonic() < end, f"still {snapshot.state}: {snapshot.reason}"
            time.sleep(0.05)
        return snapshot

    def scan(self, at_s: float | None = None) -> Snapshot:
        """Run the example from rest to its end, from the wall-clock time `at_s` on."""
        return self._run(replace(SCAN, stamp_s=at_s))

    def go_back(self) -> Snapshot:
        """From wherever the axes stand to where the example begins."""
        return self.go_to(SCAN.positions[0])

    def go_to(self, target_m: Sequence[float] | np.ndarray) -> Snapshot:
        """From wherever the axes stand, in two seconds."""
        here = [axis.position for axis in self.snapshot().axes]
        positions = np.array([here, target_m])
        snapshot = self._run(Trajectory(SCAN.joint_names, np.array([0.0, 2.0]), positions))
        for axis, wanted in zip(snapshot.axes, target_m, strict=True):
            assert axis.executed_qc == round(wanted * QC_PER_M)
        return snapshot

    def _run(self, trajectory: Trajectory) -> Snapshot:
        self.driver.submit(trajectory)
        snapshot = self.wait(lambda snapshot: snapshot.state in ("standing", "fault"))
        assert snapshot.state == "standing", snapshot.reason
        return snapshot


@contextmanager
def rig(interface: str, channel: str, **settings: object) -> Iterator[Rig]:
    """Brought up and enabled; threads take turns, and garbage is looked for, as in the node's
    process."""
    made = Rig(interface, channel, **settings)
    interval = sys.getswitchinterval()
    sys.setswitchinterval(0.0005)
    try:
        gc.collect()
        made.driver.configure()
        gc.freeze()
        made.driver.enable()
        yield made
    finally:
        made.driver.close()
        gc.unfreeze()
        sys.setswitchinterval(interval)


def commanded_qc(t_ms: np.ndarray) -> np.ndarray:
    """The example's curve, one cubic for each pair of points [len(t_ms), 2]."""
    assert SCAN.velocities is not None
    t_s = np.clip((t_ms - 1) / 1000, 0, SCAN.times_s[-1])  # the first record holds for 1 ms
    piece = np.clip(np.searchsorted(SCAN.times_s, t_s, side="right") - 1, 0, len(SCAN.times_s) - 2)
    result = np.empty((len(t_ms), 2))
    for n in range(len(SCAN.times_s) - 1):
        for joint in range(2):
            ends = [(SCAN.positions[k, joint], SCAN.velocities[k, joint]) for k in (n, n + 1)]
            curve = polynomial(ends, SCAN.times_s[n + 1] - SCAN.times_s[n])
            here = piece == n
            result[here, joint] = curve(t_s[here] - SCAN.times_s[n])
    return result * QC_PER_M


def assert_executed(log: dict[str, np.ndarray], tolerance_qc: float = 1.0) -> float:
    """Both drives were on the commanded curve at each millisecond, and started as one: when."""
    starts = set()
    for joint, node in enumerate((1, 2)):
        path_ms = log[f"node_{node}_path_ms"]
        begin = np.flatnonzero(path_ms == 0)[-1]  # of the last motion
        path_ms, demand = path_ms[begin:], log[f"node_{node}_demand_qc"][begin:]
        assert path_ms[-1] >= SCAN.times_s[-1] * 1000 - 1
        error = np.abs(demand - commanded_qc(path_ms)[:, joint])
        assert error.max() <= tolerance_qc, f"node {node} at {path_ms[error.argmax()]} ms"
        starts.add(log[f"node_{node}_time_us"][begin])
    assert len(starts) == 1
    return starts.pop()


def assert_log_ends_at(log: dict[str, np.ndarray], target_m: tuple[float, float]) -> None:
    for node, wanted in enumerate(target_m, start=1):
        assert log[f"node_{node}_demand_qc"][-1] == round(wanted * QC_PER_M)


def assert_moves(made: Rig) -> None:
    snapshot = made.go_to(TARGET_M)
    assert (snapshot.dropped_frames, snapshot.error_frames) == (0, 0)
    assert all(axis.records_sent > 3 for axis in snapshot.axes)
