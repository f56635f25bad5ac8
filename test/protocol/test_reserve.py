"""What a stall of the host costs: nothing, as long as the buffers cover it.

A simulated drive takes the strict reading of the application note, 3.6.3: two records in the buffer
besides the one in execution, unless the end record is among them, or it is a fault.
"""

from __future__ import annotations

import random

import numpy as np
import pytest
from simulated_time import axes
from six_axes import there_and_back
from test_one_for_all import Patient, StoppedHost

from epos2_ros.configuration.driver import DriverConfig
from epos2_ros.motion.trajectory import Trajectory

JOINTS = ("joint_1", "joint_2")


def made(buffer_time: float, smoothness: float = 0.0) -> StoppedHost:
    """`Patient` drives: how long a host may be silent is not what is looked at."""
    config = DriverConfig(axes=axes(2), buffer_time=buffer_time, smoothness=smoothness)
    bench = StoppedHost(config, [Patient(n, record=True) for n in (1, 2)])
    bench.enable()
    return bench


def jagged(seed: int) -> Trajectory:
    """Points of all distances, each axis anywhere."""
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.choice([0.1, 0.2, 0.6, 1.5], 12))
    positions = np.cumsum(rng.uniform(-0.03, 0.03, (12, 2)), axis=0)
    return Trajectory(JOINTS, np.concatenate([[0.0], times]), np.vstack([[0, 0], positions]))


@pytest.mark.parametrize("buffer_time", [0.2, 0.5, 1.0])
@pytest.mark.parametrize("seed", range(4))
def test_a_stall_that_the_buffer_covers_changes_nothing(buffer_time, seed):
    """Of 100 ms less than the buffer time, at any instant, also right after the start."""
    rng = random.Random(seed)
    bench = made(buffer_time, rng.choice([0.0, 1.0]))
    for number in range(2):
        trajectory = jagged(10 * seed + number) if seed % 2 else there_and_back(3.0, joints=2)
        here = [drive._demand for drive in bench.drives]
        start = [unit.from_qc(qc) for unit, qc in zip(bench.path._units, here, strict=True)]
        moved = trajectory.positions - trajectory.positions[0] + start
        bench.path.submit(Trajectory(JOINTS, trajectory.times_s, moved), None, bench.now_us)
        motion = bench.group.motion
        bench.run(1.0, lambda: bench.machine.path_time.start_us is not None)
        bench.run(number * rng.uniform(0.0, 2.0))
        while not motion.done():
            bench.nap(buffer_time - 0.1)
            for drive in bench.drives:
                ending = not drive.ip_active or drive._fifo._ends
                assert ending or drive.buffer_level >= 2
            bench.run(rng.uniform(0.03, 0.4), motion.done)
        motion.result()
        for axis in bench.machine.interpolated.axes:
            assert axis.account.reserve_ms >= 15.0


def test_the_reserve_is_what_a_stall_has_left_of_it():
    bench = made(0.5)
    bench.path.submit(there_and_back(6.0, joints=2), None, bench.now_us)
    bench.run(2.0)
    undisturbed = [axis.account.reserve_ms for axis in bench.machine.interpolated.axes]
    assert all(415 <= reserve_ms <= 420 for reserve_ms in undisturbed)
    bench.nap(0.25)
    bench.run(0.1)
    for axis, before in zip(bench.machine.interpolated.axes, undisturbed, strict=True):
        assert 0 < axis.account.reserve_ms < before
        assert before - axis.account.reserve_ms <= 251
    least = [axis.account.reserve_ms for axis in bench.machine.interpolated.axes]
    assert min(least) == pytest.approx(420 - 250, abs=25 + 126)
    bench.wait(bench.group.motion)
    assert [axis.account.reserve_ms for axis in bench.machine.interpolated.axes] == least
    bench.path.submit(there_and_back(2.0, joints=2), None, bench.now_us)
    assert all(axis.account.reserve_ms is None for axis in bench.machine.interpolated.axes)


@pytest.mark.parametrize("buffer_time", [0.2, 0.5, 1.0])
def test_no_more_is_committed_than_that_takes(buffer_time):
    """The buffer time less 80 ms, and three of the longest segments."""
    bench = made(buffer_time)
    bench.path.submit(there_and_back(6.0, joints=2), None, bench.now_us)
    ahead = []
    while not bench.group.motion.done() and not bench.feeder.ending:
        bench.run(0.003)
        path_ms = bench.machine.path_time.at_ms(bench.now_us)
        if path_ms is not None:
            ahead.append(bench.feeder.committed_ms - path_ms)
    assert len(ahead) > 1000
    assert max(ahead) <= 1000 * buffer_time * 1.75 - 80 + 5
