"""Trajectories placed on path time: stamps, replacement, streams, stops, one after another.

What the axes do is read off the simulated drives at every millisecond.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from simulated_time import Bench, drive_of, makers

from epos2_ros.configuration.driver import DriverConfig
from epos2_ros.errors import TrajectoryError
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.protocol.phase import Phase

HOLD_MS = 1  # after the start SYNC: the first record holds the position
QC_PER_RAD = 2000 * 100 / (2 * math.pi)
JOINTS = ("joint_1", "joint_2")
MAX_VELOCITY, MAX_ACCELERATION = 2.0, 8.0


def move(
    times_s: list[float], positions: list[list[float]], joints: tuple[str, ...] = JOINTS
) -> Trajectory:
    """Quintic from point to point, at rest at each."""
    still = np.zeros((len(times_s), len(joints)))
    return Trajectory(joints, np.array(times_s), np.array(positions), still, still.copy())


def made_bench(buffer_time: float = 0.5, **settings) -> Bench:
    config = DriverConfig(
        axes=makers(
            "epos2", "copley", max_velocity=MAX_VELOCITY, max_acceleration=MAX_ACCELERATION
        ),
        buffer_time=buffer_time,
        **settings,
    )
    bench = Bench(config, [
        drive_of(axis, drift_ppm=60.0 * (-1) ** axis.node_id, record=True) for axis in config.axes
    ])
    bench.enable()
    return bench


def executed(bench: Bench) -> np.ndarray:
    """Demand of both axes over path time, [ms, axes] [rad]."""
    columns = [[q for _, q in drive.recorder.executed()] for drive in bench.drives]
    length = min(map(len, columns))
    return np.array([c[:length] for c in columns]).T / QC_PER_RAD


def assert_smooth(path: np.ndarray) -> None:
    """No jump in position or velocity at any millisecond on any axis, limits kept."""
    velocity = np.diff(path, axis=0) * 1000
    acceleration = np.diff(velocity, axis=0) * 1000
    assert np.abs(velocity).max() <= MAX_VELOCITY * 1.06
    assert np.abs(acceleration).max() <= MAX_ACCELERATION * 1.3


def run_to_end(bench: Bench, seconds: float = 30.0) -> None:
    bench.run(seconds, lambda: bench.group.phase is Phase.STANDING)
    assert bench.group.phase is Phase.STANDING, bench.group.describe_phase()


@pytest.mark.parametrize("buffer_time", [0.05, 0.2, 0.5])
def test_replacement_without_a_stop(buffer_time):
    bench = made_bench(buffer_time)
    bench.path.submit(move([0.0, 3.0], [[0.0, 0.0], [1.0, -1.0]]), None, bench.now_us)
    bench.run(1.4)
    sent_us = bench.now_us
    away_ms = (sent_us - bench.machine.path_time.start_us) / 1000
    new = move([1.6, 3.6], [[0.8, -0.2], [0.0, 0.5]])
    bench.path.submit(new, None, sent_us)
    run_to_end(bench)
    path = executed(bench)
    assert_smooth(path)
    assert path[-1] == pytest.approx([0.0, 0.5], abs=0.6 / QC_PER_RAD)
    # Until the end of what was committed it was the old motion (minimum jerk, 3 s) …
    committed = int(away_ms)
    u = np.clip(np.arange(committed) - HOLD_MS, 0, 3000) / 3000
    old = (10 * u**3 - 15 * u**4 + 6 * u**5)[:, None] * [1.0, -1.0]
    assert np.abs(path[:committed] - old).max() <= 1.0 / QC_PER_RAD
    # … which is at most the buffer time, and it did not stop anywhere between.
    t = np.arange(len(path)) / 1000 - away_ms / 1000
    speed = np.abs(np.diff(path, axis=0)).max(axis=1) * 1000
    assert speed[(t[1:] > 0) & (t[1:] < 0.5)].min() > 0.05
    # The new trajectory's points are where and when it says, counted from its message.
    k = int(round(away_ms + 3600))
    assert len(path) == pytest.approx(k, abs=20)


def test_a_refused_replacement_leaves_the_motion_alone():
    bench = made_bench()
    bench.path.submit(move([0.0, 2.0], [[0.0, 0.0], [0.5, 0.5]]), None, bench.now_us)
    bench.run(0.6)
    for wrong, words in (
        (move([0.1], [[1.0, 1.0]], ("joint_1", "other")), "unknown"),
        (move([0.0, 0.3], [[0.0, 0.0], [1.5, 0.0]]), "joint_1"),  # too fast
    ):
        with pytest.raises(TrajectoryError, match=words):
            bench.path.submit(wrong, None, bench.now_us)
    run_to_end(bench)
    path = executed(bench)
    u = np.clip(np.arange(2001) - HOLD_MS, 0, 2000) / 2000
    wanted = 0.5 * (10 * u**3 - 15 * u**4 + 6 * u**5)
    assert np.abs(path[:2001] - wanted[:, None]).max() <= 1.0 / QC_PER_RAD


def test_the_same_trajectory_again_with_the_same_stamp_changes_nothing():
    bench = made_bench()
    trajectory = move([0.0, 2.0], [[0.0, 0.0], [0.5, -0.5]])
    start_us = bench.now_us + 100_000
    bench.path.submit(trajectory, start_us, bench.now_us)
    bench.run(0.8)
    bench.path.submit(trajectory, start_us, bench.now_us)
    run_to_end(bench)
    u = np.clip((np.arange(2001) - HOLD_MS) / 2000, 0, 1)
    wanted = 0.5 * (10 * u**3 - 15 * u**4 + 6 * u**5)
    path = executed(bench)[:2001]
    # the path's zero is on the bus some µs after the stamp, rounded to a millisecond
    assert np.abs(path - wanted[:, None] * [1, -1]).max() <= 1.5 / QC_PER_RAD


def test_a_new_trajectory_while_the_old_one_ends_runs_after_it():
    bench = made_bench()
    bench.path.submit(move([0.0, 1.0], [[0.0, 0.0], [0.3, 0.3]]), None, bench.now_us)
    bench.run(0.9)
    bench.path.submit(move([0.0, 1.0], [[0.3, 0.3], [0.0, 0.1]]), None, bench.now_us)
    bench.run(0.3)
    run_to_end(bench)
    for drive, end in zip(bench.drives, (0.0, 0.1), strict=True):
        assert drive.recorder.demand_qc[-1] == pytest.approx(end * QC_PER_RAD, abs=0.6)


def test_a_stamp_in_the_past_joins_where_the_trajectory_would_be():
    bench = made_bench()
    trajectory = move([0.0, 3.0], [[0.0, 0.0], [1.0, -0.5]])
    bench.path.submit(trajectory, bench.now_us - 600_000, bench.now_us)
    submitted = bench.now_us
    run_to_end(bench)
    path = executed(bench)
    assert_smooth(path)
    start_ms = (bench.machine.path_time.start_us - (submitted - 600_000)) / 1000
    t = (np.arange(len(path)) + start_ms) / 3000
    wanted = (10 * t**3 - 15 * t**4 + 6 * t**5)[:, None] * [1.0, -0.5]
    late = t > 0.6  # joined by then
    assert np.abs(path - wanted)[late & (t < 1)].max() <= 3.0 / QC_PER_RAD


def test_a_trajectory_that_ended_is_refused():
    bench = made_bench()
    with pytest.raises(TrajectoryError, match="ended 1.000 s ago") as refused:
        bench.path.submit(
            move([0.0, 1.0], [[0.0, 0.0], [0.1, 0.1]]), bench.now_us - 2e6, bench.now_us
        )
    assert refused.value.code == TrajectoryError.OLD_HEADER_TIMESTAMP
    bench.run(0.5)
    assert bench.group.phase is Phase.STANDING


def test_the_first_point_must_be_where_the_robot_is():
    bench = made_bench()
    with pytest.raises(TrajectoryError, match=r"joint_2.*point 0.*away from where"):
        bench.path.submit(move([0.0, 1.0], [[0.0, 0.05], [0.1, 0.1]]), None, bench.now_us)


def test_a_small_start_offset_is_blended_out():
    bench = made_bench()
    bench.path.submit(move([0.0, 2.0], [[0.008, -0.008], [0.5, 0.5]]), None, bench.now_us)
    run_to_end(bench)
    path = executed(bench)
    assert np.abs(path[0]).max() <= 0.6 / QC_PER_RAD
    assert_smooth(path)
    assert path[-1] == pytest.approx([0.5, 0.5], abs=0.6 / QC_PER_RAD)


def test_partial_joints_hold_the_others():
    bench = made_bench(allow_partial_joints_goal=True)
    bench.path.submit(move([0.0, 1.0], [[0.0], [0.4]], ("joint_2",)), None, bench.now_us)
    run_to_end(bench)
    path = executed(bench)
    assert np.abs(path[:, 0]).max() <= 0.6 / QC_PER_RAD
    assert path[-1, 1] == pytest.approx(0.4, abs=0.6 / QC_PER_RAD)


@pytest.mark.parametrize("buffer_time", [0.05, 0.5])
def test_a_stream_of_points_runs_smoothly_along(buffer_time):
    """MoveIt Servo's habit: every 20 ms one point, 120 ms ahead."""
    bench = made_bench(buffer_time)
    zero_us = bench.now_us

    def servo(t_s: float) -> list[float]:
        return [0.3 * min(t_s, 3.0), 0.1 * math.sin(2 * min(t_s, 3.0))]

    while bench.now_us < zero_us + 3e6:
        t_s = (bench.now_us - zero_us) / 1e6
        point = Trajectory(JOINTS, np.array([0.12]), np.array([servo(t_s + 0.12)]))
        bench.path.submit(point, None, bench.now_us)
        bench.run(0.02)
    run_to_end(bench)
    path = executed(bench)
    assert_smooth(path)
    assert path[-1] == pytest.approx(servo(3.0), abs=2.0 / QC_PER_RAD)
    velocity = np.diff(path[:, 0]) * 1000
    under_way = velocity[500:2500]  # joint_1 runs at 0.3 rad/s: no stop-and-go, no way back
    assert under_way.min() > 0.2
    assert under_way.max() < 0.4
    assert velocity.min() > -0.01


def test_an_empty_trajectory_stops_on_the_path():
    bench = made_bench()
    bench.path.submit(move([0.0, 4.0], [[0.0, 0.0], [1.0, 0.5]]), None, bench.now_us)
    bench.run(1.5)
    bench.path.stop()
    run_to_end(bench)
    path = executed(bench)
    assert_smooth(path)
    assert 0.05 < path[-1, 0] < 0.95
    assert np.abs(path[:, 1] - 0.5 * path[:, 0]).max() <= 2.0 / QC_PER_RAD


def kinds(bench: Bench) -> list[str]:
    return [event.kind for event in bench.events]


def test_the_log_tells_of_each_motion_how_it_began_and_ended():
    bench = made_bench()
    there = move([0.0, 3.0], [[0.0, 0.0], [1.0, -1.0]])
    bench.path.submit(there, None, bench.now_us)
    bench.run(1.0)
    bench.path.submit(move([2.0], [[0.5, 0.0]]), None, bench.now_us)
    bench.run(0.5)
    bench.path.stop()
    run_to_end(bench)
    assert kinds(bench) == ["started", "replaced", "done"]
    assert bench.events[-1].text == "stopped on the path"
    bench.events.clear()
    bench.path.submit(move([1.0], [[0.0, 0.0]]), bench.now_us + 4e6, bench.now_us)
    bench.run(1.0)
    bench.path.stop()
    bench.run(0.2)
    assert kinds(bench) == ["waiting", "cancelled"]
    assert "4.0 s ahead" in bench.events[0].text
    bench.events.clear()
    bench.path.submit(move([2.0], [[0.0, 0.0]]), None, bench.now_us)
    bench.run(1.0)
    bench.group.halt()
    bench.run(1.0)
    assert kinds(bench) == ["started", "stopped"]  # on request: no error
    assert bench.events[-1].text == "halted on request"


def test_points_of_a_stream_are_no_lines_of_their_own():
    bench = made_bench()
    for n in range(1, 20):
        point = np.array([[0.002 * n, 0.0]])
        bench.path.submit(Trajectory(JOINTS, np.array([0.12]), point), None, bench.now_us)
        bench.run(0.05)
    run_to_end(bench)
    assert kinds(bench) == ["started", "done"]
