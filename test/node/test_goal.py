"""What becomes of a goal, in numbers and in simulated time: status, code and words."""

from __future__ import annotations

import math
import os
import random
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
from simulated_time import Bench, axes

from epos2_ros.bus.tracking import Tracking, tracked
from epos2_ros.configuration.driver import DriverConfig
from epos2_ros.errors import MotionAborted, MotionStopped, TrajectoryError
from epos2_ros.motion.reference import Reference
from epos2_ros.motion.tolerance import JointTolerance, Tolerances
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.motion.units import AxisUnits
from epos2_ros.node.goal import (
    GOAL_TOLERANCE_VIOLATED,
    INVALID_GOAL,
    PATH_TOLERANCE_VIOLATED,
    SUCCESSFUL,
    Pursuit,
    Status,
    refused,
)
from epos2_ros.protocol.execution import Execution
from epos2_ros.protocol.phase import Phase
from epos2_ros.sim.epos2 import Epos2

JOINTS = ("joint_1", "joint_2")
AXES = axes(2, max_velocity=3.0, max_acceleration=12.0)
UNITS = tuple(AxisUnits.of(axis) for axis in AXES)
END_US = 5e6


def tolerances(path: float = 0.0, goal: float = 0.0, time_s: float = 0.0) -> Tolerances:
    """Of the first joint; the parameter of the goal time is 1 s."""
    of_goal, warning = Tolerances.of(AXES, 1.0).overridden(
        [JointTolerance("joint_1", path)], [JointTolerance("joint_1", goal)], time_s
    )
    assert not warning
    return of_goal


def seen(
    execution: Execution | None, off: float, at_us: float = END_US, age_us: float = 0.0
) -> Tracking:
    """The axes are to be at (1, 1); the first is `off` so much."""
    return Tracking(
        now_us=at_us,
        joints=JOINTS,
        reference=Reference.at_rest(UNITS, [1.0, 1.0]),
        zero_us=0.0,
        known_us=-math.inf,
        execution=execution,
        state="standing",
        position=np.array([1.0 + off, 1.0]),
        velocity=np.zeros(2),
        measured_us=np.array([at_us, at_us]),
        reported_us=np.array([at_us - age_us, at_us]),
    )


@pytest.fixture
def execution() -> Execution:
    return Execution()


def test_within_its_tolerances_it_goes_on_to_its_end(execution):
    pursuit = Pursuit(execution, tolerances(path=0.1, goal=0.01))
    assert pursuit.look(seen(execution, 0.099)) is None
    assert pursuit.stop_for == ""
    execution.ended.set_result(None)
    assert pursuit.look(seen(execution, 0.009)) == (Status.SUCCEEDED, SUCCESSFUL, "")


def test_off_its_path_it_is_stopped_and_ends_when_it_rests(execution):
    pursuit = Pursuit(execution, tolerances(path=0.1))
    assert pursuit.look(seen(execution, 0.11)) is None
    assert "joint 'joint_1'" in pursuit.stop_for
    assert pursuit.look(seen(execution, 0.0)) is None  # that it is back helps no more
    execution.ended.set_exception(MotionStopped("stopped on the path"))
    status, code, words = pursuit.look(seen(execution, 0.0))
    assert (status, code) == (Status.ABORTED, PATH_TOLERANCE_VIOLATED)
    assert "0.11 rad away" in words
    assert "allowed 0.1 (path_tolerance)" in words


@pytest.mark.parametrize(
    ("time_s", "limit_s"), [(0.0, 1.0), (0.25, 0.25), (3.0, 3.0), (-1.0, math.inf)]
)
def test_the_goal_is_waited_for_as_long_as_the_goal_time(execution, time_s, limit_s):
    pursuit = Pursuit(execution, tolerances(goal=0.01, time_s=time_s))
    execution.ended.set_result(None)
    for after_s in (0.0, 0.2, 0.9, 2.9, 100.0):
        outcome = pursuit.look(seen(execution, 0.02, END_US + 1e6 * after_s))
        if after_s < limit_s:
            assert outcome is None
        else:
            assert outcome[:2] == (Status.ABORTED, GOAL_TOLERANCE_VIOLATED)
            assert f"{after_s:.3f} s after its end" in outcome.words
            break
    else:
        assert pursuit.look(seen(execution, 0.005, END_US + 2e8)).status is Status.SUCCEEDED


def test_a_measurement_from_before_the_end_is_nobodys_fault(execution):
    pursuit = Pursuit(execution, tolerances(goal=0.01, time_s=0.001))
    execution.ended.set_result(None)
    assert pursuit.look(seen(execution, 0.02)) is None
    assert pursuit.look(seen(execution, 0.02, END_US + 5e4, age_us=6e4)) is None
    assert pursuit.look(seen(execution, 0.02, END_US + 5e4)).code == GOAL_TOLERANCE_VIOLATED


def test_what_is_not_held_any_more_is_given_up(execution):
    pursuit = Pursuit(execution, tolerances(goal=0.01))
    execution.ended.set_result(None)
    assert pursuit.look(seen(execution, 0.02)) is None
    outcome = pursuit.look(replace(seen(None, 0.02), state="disabled"))
    assert outcome[:2] == (Status.ABORTED, INVALID_GOAL)
    assert "disabled" in outcome.words


def test_one_that_has_arrived_has_succeeded_although_the_next_has_begun(execution):
    pursuit = Pursuit(execution, tolerances())
    execution.ended.set_result(None)
    assert pursuit.look(seen(Execution(), 0.5)).status is Status.SUCCEEDED


@pytest.mark.parametrize(
    ("ends", "canceled", "status", "code"),
    [
        (None, True, Status.CANCELED, SUCCESSFUL),
        (MotionStopped("it stopped"), True, Status.CANCELED, SUCCESSFUL),
        (MotionAborted("a fault"), True, Status.ABORTED, INVALID_GOAL),
        (MotionStopped("it stopped"), False, Status.ABORTED, INVALID_GOAL),
        (MotionAborted("a fault"), False, Status.ABORTED, INVALID_GOAL),
    ],
)
def test_ends_that_nobody_or_somebody_asked_for(execution, ends, canceled, status, code):
    pursuit = Pursuit(execution, tolerances())
    if canceled:
        pursuit.cancel()
        assert pursuit.stop_for
        assert pursuit.look(seen(execution, 0.0)) is None
    if ends is None:
        execution.ended.set_result(None)
    else:
        execution.ended.set_exception(ends)
    outcome = pursuit.look(seen(execution, 0.0))
    assert outcome[:2] == (status, code)
    assert ends is None or str(ends) in outcome.words


def test_a_refusal_has_its_own_code():
    error = TrajectoryError("over already", TrajectoryError.OLD_HEADER_TIMESTAMP)
    assert refused(error) == (Status.ABORTED, -3, "over already")


# -- in simulated time -------------------------------------------------------------------------


def bench_of(buffer_time: float) -> Bench:
    config = DriverConfig(axes=AXES, buffer_time=buffer_time)
    bench = Bench(config, [Epos2(n) for n in (1, 2)])
    bench.enable()
    return bench


def track(bench: Bench) -> Tracking:
    return tracked(bench.machine, bench.config.axes, bench.whereabouts, bench.now_us)


class Client:
    """A goal on the bench, looked at as often as the node does it."""

    def __init__(self, bench: Bench, to: list[float], duration_s: float, ahead_s: float) -> None:
        trajectory = Trajectory(JOINTS, np.array([duration_s]), np.array([to]), np.zeros((1, 2)))
        stamp_us = bench.now_us + 1e6 * ahead_s if ahead_s else None
        self.bench = bench
        self.to = np.array(to)
        self.execution = bench.path.submit(trajectory, stamp_us, bench.now_us)
        self.pursuit = Pursuit(self.execution, tolerances(path=0.05, goal=0.01))
        self.outcome = None
        self.canceled = False
        self.stopped = False

    def look(self) -> None:
        if self.outcome is not None:
            return
        self.outcome = self.pursuit.look(track(self.bench))
        if self.pursuit.stop_for and not self.stopped:
            self.bench.path.cancel(self.execution, self.pursuit.stop_for)
            self.stopped = True


@pytest.mark.parametrize("seed", range(int(os.environ.get("GOALS_SEEDS", "5"))))
def test_every_goal_has_one_outcome_and_the_right_one(seed):
    """Goals and cancellations at random instants, one after the other or each into the last:
    each ends, succeeded at its goal, canceled at rest, or aborted because of the next.
    `GOALS_SEEDS=n` tries n times."""
    random_ = random.Random(seed)
    bench = bench_of(random_.choice([0.1, 0.3, 0.5]))
    clients: list[Client] = []
    end_us = bench.now_us + 12e6
    next_us = bench.now_us
    while bench.now_us < end_us or any(client.outcome is None for client in clients):
        assert bench.now_us < end_us + 10e6, "a goal has no outcome"
        if next_us <= bench.now_us < end_us:
            if clients and clients[-1].outcome is None and random_.random() < 0.4:
                clients[-1].canceled = True
                clients[-1].pursuit.cancel()
            else:
                to = [random_.uniform(-0.5, 0.5) for _ in JOINTS]
                ahead_s = random_.choice([0.0, 0.0, 0.4])
                with suppress(TrajectoryError):  # from where it is now it can't be there in time
                    clients.append(Client(bench, to, random_.uniform(0.9, 1.6), ahead_s))
            next_us = bench.now_us + 1e6 * random_.choice([0.0, 0.01, 0.3, 0.8, 2.5])
        for client in clients:
            client.look()
            last = client.outcome is not None and client is clients[-1]
            if last and "before it began" not in client.outcome.words:
                assert bench.group.standing, bench.group.describe_phase()
        bench.run(0.02)
    assert len(clients) > 3
    for client, after in zip(clients, [*clients[1:], None], strict=True):
        status, code, words = client.outcome
        if status is Status.CANCELED:
            assert client.canceled
        elif status is Status.ABORTED:
            assert code == INVALID_GOAL, words  # the simulated axes follow: no tolerance violated
            assert after is not None
            assert "another" in words or "given up" in words
        else:
            assert not client.canceled
    if clients[-1].outcome.status is Status.SUCCEEDED:
        assert track(bench).position == pytest.approx(clients[-1].to, abs=1e-3)


def test_a_blocked_axis_leaves_its_path_and_all_stop_on_theirs():
    axes_ = tuple(replace(axis, max_following_error=10**9) for axis in AXES)
    bench = Bench(DriverConfig(axes=axes_), [Epos2(n) for n in (1, 2)])
    bench.enable()
    client = Client(bench, [1.0, -1.0], 3.0, 0.0)
    bench.run(0.7)
    bench.drives[0].block_rotor()
    where = bench.drives[0]._motor.position
    bench.run(10.0, lambda: client.look() or client.outcome is not None)
    assert client.outcome[:2] == (Status.ABORTED, PATH_TOLERANCE_VIOLATED)
    assert "joint_1" in client.outcome.words
    assert bench.group.phase is Phase.STANDING
    assert bench.drives[0]._motor.position == where
    assert abs(bench.drives[1]._demand) < 0.9 * 1.0 * UNITS[1].qc_per_unit
    assert abs(bench.drives[0]._demand) == pytest.approx(abs(bench.drives[1]._demand), abs=2)
