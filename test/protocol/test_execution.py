"""Each accepted trajectory ends once, with what has become of it, and when its axes rest."""

from __future__ import annotations

import math

import numpy as np
import pytest
from simulated_time import Bench, axes

from epos2_ros.bus.tracking import Tracking, tracked
from epos2_ros.configuration.driver import DriverConfig
from epos2_ros.errors import MotionAborted, MotionStopped
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.protocol.execution import Execution
from epos2_ros.protocol.phase import Phase
from epos2_ros.sim.epos2 import Epos2

QC_PER_RAD = 2000 * 100 / (2 * math.pi)
JOINTS = ("joint_1", "joint_2")


@pytest.fixture
def bench() -> Bench:
    config = DriverConfig(axes=axes(2, max_velocity=3.0, max_acceleration=12.0))
    made = Bench(config, [Epos2(n, record=True) for n in (1, 2)])
    made.enable()
    return made


def submit(bench: Bench, to: float, duration_s: float = 1.0, ahead_s: float = 0.0) -> Execution:
    """From wherever the axes are."""
    points = np.array([[to, -to]])
    trajectory = Trajectory(JOINTS, np.array([duration_s]), points, np.zeros((1, 2)))
    stamp_us = bench.now_us + ahead_s * 1e6 if ahead_s else None
    return bench.path.submit(trajectory, stamp_us, bench.now_us)


def ended(bench: Bench, execution: Execution) -> BaseException | None:
    """What it ends with; the axes rest then, by what the drives themselves do."""
    bench.run(10.0, execution.ended.done)
    before = [drive._demand for drive in bench.drives]
    bench.run(0.1)
    assert [drive._demand for drive in bench.drives] == before
    return execution.ended.exception(timeout=0)


def test_it_ends_at_its_end(bench):
    execution = submit(bench, 0.5)
    assert ended(bench, execution) is None
    assert bench.drives[0]._demand == pytest.approx(0.5 * QC_PER_RAD, abs=1)


@pytest.mark.parametrize("after_s", [0.02, 0.3, 0.5])
def test_stopped_on_its_path(bench, after_s):
    execution = submit(bench, 2.0, 2.0)
    bench.run(after_s)
    bench.path.stop("somebody wants it")
    error = ended(bench, execution)
    assert isinstance(error, MotionStopped)
    assert "somebody wants it" in str(error)
    assert bench.drives[0]._demand < 1.9 * QC_PER_RAD


def test_stopped_before_it_begins(bench):
    execution = submit(bench, 0.5, ahead_s=2.0)
    bench.run(0.5)
    bench.path.cancel(execution, "not this one")
    assert isinstance(ended(bench, execution), MotionStopped)
    bench.run(3.0)
    assert bench.drives[0]._demand == 0


def test_another_one_takes_over(bench):
    first = submit(bench, 1.0, 2.0)
    bench.run(0.6)
    second = submit(bench, 0.2, 2.0)
    assert isinstance(first.ended.exception(timeout=0), MotionStopped)
    assert "another trajectory" in str(first.ended.exception())
    bench.path.cancel(first, "too late")  # what is over can't stop the other
    assert ended(bench, second) is None
    assert bench.drives[0]._demand == pytest.approx(0.2 * QC_PER_RAD, abs=1)


def test_another_one_takes_over_from_one_that_has_not_begun(bench):
    first = submit(bench, 1.0, ahead_s=3.0)
    bench.run(0.3)
    second = submit(bench, 0.2)
    assert isinstance(first.ended.exception(timeout=0), MotionStopped)
    assert ended(bench, second) is None


def waiting_for_the_end(bench: Bench) -> tuple[Execution, Execution]:
    """One whose end is committed, and one that waits for it."""
    first = submit(bench, 0.4, 1.0)
    bench.run(5.0, lambda: bench.feeder.ending)
    return first, submit(bench, 0.8, 1.0)


def test_one_after_the_other(bench):
    first, second = waiting_for_the_end(bench)
    bench.run(5.0, first.ended.done)
    assert first.ended.exception(timeout=0) is None
    assert ended(bench, second) is None
    assert bench.drives[0]._demand == pytest.approx(0.8 * QC_PER_RAD, abs=1)


def test_cancelling_the_one_that_waits_leaves_the_other_alone(bench):
    first, second = waiting_for_the_end(bench)
    bench.path.cancel(second, "not that one")
    assert isinstance(second.ended.exception(timeout=0), MotionStopped)
    assert ended(bench, first) is None
    assert bench.drives[0]._demand == pytest.approx(0.4 * QC_PER_RAD, abs=1)


def test_cancelling_the_one_that_is_at_its_end_leaves_the_next_alone(bench):
    first, second = waiting_for_the_end(bench)
    bench.path.cancel(first, "it is nearly there")
    assert ended(bench, second) is None
    assert first.ended.exception(timeout=0) is None


@pytest.mark.parametrize("request_", ["halt", "quick_stop"])
def test_off_its_path(bench, request_):
    execution = submit(bench, 1.0, 2.0)
    bench.run(0.8)
    bench.wait(getattr(bench.group, request_)())
    error = ended(bench, execution)
    assert isinstance(error, MotionAborted)
    assert not isinstance(error, MotionStopped)


def test_disabled(bench):
    execution = submit(bench, 1.0, 2.0)
    bench.run(0.8)
    bench.wait(bench.path.disable())
    assert "disabled" in str(ended(bench, execution))
    assert bench.path.execution is None


def track(bench: Bench) -> Tracking:
    return tracked(bench.machine, bench.config.axes, bench.whereabouts, bench.now_us)


def test_what_is_desired_is_what_is_measured(bench):
    """Along a motion with two take-overs, by simulated drives that follow to a count: a position
    is compared with what was commanded when it was measured, not with what is commanded now."""
    submit(bench, 1.0, 2.0)
    largest = 0.0
    for step in range(380):
        bench.run(0.01)
        if step == 70:
            submit(bench, 0.3, 2.0)
        elif step == 130:
            submit(bench, 0.6, 2.0)
        now = track(bench)
        off, speed = np.abs(now.desired.position - now.position), np.abs(now.desired.velocity)
        late_s = 2e-3  # a drive samples every millisecond; then the frame has to wait and pass
        assert (off <= 2 / QC_PER_RAD + late_s * speed).all(), step
        largest = max(largest, float(speed.max()))
    assert bench.group.phase is Phase.STANDING
    assert largest > 0.5


def test_a_blocked_axis_is_seen():
    config = DriverConfig(axes=axes(2, max_velocity=3.0, max_following_error=20_000))
    bench = Bench(config, [Epos2(n) for n in (1, 2)])
    bench.enable()
    submit(bench, 1.0, 2.0)
    bench.run(0.6)
    bench.drives[0].block_rotor()
    bench.run(0.4)
    now = track(bench)
    assert now.desired.position[0] - now.position[0] > 0.1
    assert abs(now.desired.position[1] - now.position[1]) < 0.001
    assert bench.now_us - now.reported_us[0] < 110_000  # a SYNC period, and its answer


def test_states_of_axes_that_rest_are_fresh_as_long_as_the_drives_are_heard(bench):
    """MoveIt executes nothing unless the robot's state is younger than a second."""
    bench.run(3.0)
    assert track(bench).now_us == track(bench).stamp_us == bench.now_us
    bench.drives[0].disconnect()
    bench.run(2.5)
    now = track(bench)
    assert now.now_us - now.measured_us[0] > 2e6
    assert now.measured_us[1] == now.now_us


def test_time_from_start_is_the_trajectorys_own(bench):
    execution = submit(bench, 0.5, 1.0, ahead_s=0.5)
    bench.run(0.4)
    assert track(bench).time_from_start_s(execution) == 0.0
    bench.run(0.6)
    now = track(bench)
    ago_s = (bench.now_us - now.stamp_us) / 1e6
    assert now.time_from_start_s(execution) == pytest.approx(0.5 - ago_s, abs=0.002)
