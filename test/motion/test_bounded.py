"""Trajectories that planners made at exactly the driver's limits: followed within them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from planners import from_ruckig, from_toppra, planned_axes
from simulated_time import Bench
from trajectories import JOINTS, axes_of, curve_of, from_rest, gentle, limited

from epos2_ros.bus.settings import ACCELERATION_HEADROOM, VELOCITY_HEADROOM
from epos2_ros.configuration.driver import DriverConfig
from epos2_ros.errors import TrajectoryError
from epos2_ros.motion.bounded import bounded
from epos2_ros.motion.curve import Curve
from epos2_ros.motion.limits import MARGINS, NOTED, Limits, check
from epos2_ros.motion.pace import paced
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.plan import report
from epos2_ros.plan.planning import make_plan
from epos2_ros.protocol.phase import Phase

STEPS_S = (0.1, 0.05, 0.02, 0.01)  # 10 to 100 Hz
BUDGET = settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow])


def switched(
    seed: int, step_s: float, velocity: float, acceleration: float, accelerations: bool
) -> Trajectory:
    """Both joints switch between full acceleration, none and full deceleration at random times,
    never faster than allowed, and come to rest: sampled every `step_s`, and at the end."""
    random = np.random.default_rng(seed)
    phases, ends = [], []
    for _ in JOINTS:
        v, own = 0.0, []
        for _ in range(8):
            a = float(random.choice((-1, 0, 1))) * acceleration
            most = np.inf if a == 0 else (velocity - np.sign(a) * v) / abs(a)
            own.append((a, min(float(random.exponential(0.15)), most)))
            v += a * own[-1][1]
        own.append((-np.sign(v) * acceleration, abs(v) / acceleration))
        phases.append(own)
        ends.append(sum(duration for _, duration in own))
    t = np.append(np.arange(0, max(ends) - step_s / 2, step_s), max(ends))
    states = np.zeros((3, len(t), len(JOINTS)))
    for joint, own in enumerate(phases):
        began, p, v = 0.0, 0.0, 0.0
        for a, duration in [*own, (0.0, np.inf)]:
            mine, dt = t >= began, t - began
            states[0, mine, joint] = (p + v * dt + a * dt**2 / 2)[mine]
            states[1, mine, joint] = (v + a * dt)[mine]
            states[2, mine, joint] = a
            if duration < np.inf:
                began, p, v = (
                    began + duration,
                    p + (v + a * duration / 2) * duration,
                    v + a * duration,
                )
    states = np.round(states, 9)
    states[1, -1] = 0.0
    return Trajectory(JOINTS, t, states[0], states[1], states[2] if accelerations else None)


def assert_joins_the_points(curve: Curve, trajectory: Trajectory) -> None:
    """It passes them with their velocities, and positions and velocities have no jumps."""
    np.testing.assert_allclose(curve.evaluate(trajectory.times_s), trajectory.positions, atol=1e-12)
    assert trajectory.velocities is not None
    np.testing.assert_allclose(
        curve.evaluate(trajectory.times_s[:-1], 1), trajectory.velocities[:-1], atol=1e-9
    )
    t = np.linspace(0, trajectory.duration_s, 40_001)
    position, velocity, acceleration = (curve.evaluate(t, order) for order in range(3))
    step, most = t[1], np.abs(acceleration).max(axis=0) * 1.01 + 1e-6
    assert (np.abs(np.diff(velocity, axis=0)) <= most * step).all()
    mean = (velocity[1:] + velocity[:-1]) / 2
    assert (np.abs(np.diff(position, axis=0) - mean * step) <= most * step**2 + 1e-12).all()


def sampled(curve: Curve, limits: Limits) -> tuple[float, float]:
    """Largest velocity and acceleration as shares of the limits, looked at closely."""
    pieces = np.diff(curve.times_s)
    whole = pieces > 1e-4  # in a piece of some µs, double precision is some 0.01 rad/s²
    begins = curve.times_s[:-1][whole]
    t = np.concatenate([begins + share * pieces[whole] for share in np.linspace(0, 0.999999, 41)])
    velocity, acceleration = (np.abs(curve.evaluate(t, order)).max(axis=0) for order in (1, 2))
    return float((velocity / limits.velocity).max()), float(
        (acceleration / limits.acceleration).max()
    )


@BUDGET
@given(
    seed=st.integers(0, 2**32 - 1),
    step_s=st.sampled_from(STEPS_S),
    velocity=st.floats(0.1, 3.0),
    ramp_s=st.floats(0.03, 1.0),
    accelerations=st.booleans(),
)
def test_a_plan_that_keeps_the_limits_is_followed_within_them(
    seed: int, step_s: float, velocity: float, ramp_s: float, accelerations: bool
) -> None:
    """Whatever the planner did between its points, there is a curve that keeps the limits."""
    acceleration = velocity / ramp_s
    trajectory = switched(seed, step_s, velocity, acceleration, accelerations)
    axes = axes_of(JOINTS, max_velocity=velocity, max_acceleration=acceleration)
    limits = Limits.of(axes)
    assert not from_rest(trajectory, axes).remark
    curve = bounded(curve_of(trajectory), limits)
    assert_joins_the_points(curve, trajectory)
    fastest, steepest = sampled(curve, limits)
    assert fastest <= 1 + 1e-5
    # Positions have nine digits; and within 0.4 µs of a point nothing switches.
    assert steepest * acceleration <= acceleration * (1 + NOTED + 16 * 4e-7 / step_s) + 1e-3


@pytest.mark.parametrize("step_s", STEPS_S)
@pytest.mark.parametrize("seed", range(3))
def test_ruckigs_motions_keep_their_limits(seed: int, step_s: float) -> None:
    trajectory = from_ruckig(seed, step_s=step_s)
    assert not from_rest(trajectory, planned_axes(trajectory)).remark


@pytest.mark.parametrize("step_s", STEPS_S)
@pytest.mark.parametrize("seed", range(3))
def test_time_optimal_motions_are_beyond_by_what_their_planner_is_and_said_so(
    seed: int, step_s: float
) -> None:
    trajectory = from_toppra(seed, step_s=step_s)
    axes = planned_axes(trajectory)
    limits = Limits.of(axes)
    with pytest.raises(TrajectoryError, match="allowed"):
        check(curve_of(trajectory), limits)
    remark = from_rest(trajectory, axes).remark
    curve = bounded(curve_of(trajectory), limits)
    assert_joins_the_points(curve, trajectory)
    fastest, steepest = sampled(curve, limits)
    assert fastest <= 1 + MARGINS[1] and steepest <= 1 + MARGINS[2]
    assert ("velocity" in remark) == (fastest > 1 + NOTED)
    assert ("acceleration" in remark) == (steepest > 1 + NOTED)
    if remark:
        assert "joint 'joint_" in remark and " s, allowed ±" in remark and "% more)" in remark


@settings(max_examples=25, deadline=None)
@given(gentle(), st.floats(1.0, 2.0))
def test_what_keeps_the_limits_is_left_alone(trajectory: Trajectory, share: float) -> None:
    curve = curve_of(trajectory)
    same = bounded(curve, Limits.of(limited(curve, share=share)))
    np.testing.assert_array_equal(same.times_s, curve.times_s)
    t = np.linspace(0, curve.end_s, 1001)
    np.testing.assert_allclose(same.evaluate(t), curve.evaluate(t), atol=1e-9)


def test_the_margins_leave_room_below_what_drives_enforce() -> None:
    assert MARGINS[0] == 0
    assert 1 + MARGINS[1] < VELOCITY_HEADROOM
    assert 1 + MARGINS[2] < ACCELERATION_HEADROOM


def rushed(share: float) -> tuple[Trajectory, DriverConfig]:
    """From rest to rest as fast as can be with `share` times the limits of the axis."""
    t = np.array([0.0, 0.5, 1.0]) / np.sqrt(share)
    p = np.array([0.0, 0.5, 1.0])[:, None]
    v = np.array([0.0, 2.0, 0.0])[:, None] * np.sqrt(share)
    axes = axes_of(("a",), max_velocity=2.5, max_acceleration=4.0)
    return Trajectory(("a",), t, p, v), DriverConfig(axes)


def test_within_the_margin_plan_and_driver_warn_and_the_drive_follows() -> None:
    trajectory, config = rushed(1.1)
    plan = make_plan(trajectory, config, [0.0])
    words = "joint 'a': acceleration"
    assert any("warning" in note and words in note for note in report.notes(plan))
    bench = Bench(config)
    bench.enable()
    bench.path.submit(trajectory, None, bench.now_us)
    (warning,) = [event for event in bench.events if event.kind == "warning"] or [
        event for event in bench.group.out.events if event.kind == "warning"
    ]
    assert words in warning.text and "(10 % more)" in warning.text
    bench.run(10.0, lambda: bench.group.phase is Phase.STANDING)
    assert bench.group.phase is Phase.STANDING, bench.group.describe_phase()


def test_beyond_the_margin_it_is_refused() -> None:
    trajectory, config = rushed(1.25)
    with pytest.raises(TrajectoryError, match=r"joint 'a': acceleration -?5 rad/s² .* allowed ±4"):
        make_plan(trajectory, config, [0.0])


def alone(trajectory: Trajectory) -> Trajectory:
    """Its positions and times only."""
    return replace(trajectory, velocities=None, accelerations=None)


@BUDGET
@given(
    seed=st.integers(0, 2**32 - 1),
    step_s=st.sampled_from(STEPS_S),
    velocity=st.floats(0.5, 3.0),
    ramp_s=st.floats(0.03, 1.0),
    unlimited=st.booleans(),
)
def test_positions_alone_of_a_plan_within_the_limits_are_followed_within_them(
    seed: int, step_s: float, velocity: float, ramp_s: float, unlimited: bool
) -> None:
    """There are velocities at the points with which they can be kept: those the planner had."""
    acceleration = velocity / ramp_s
    trajectory = alone(switched(seed, step_s, velocity, acceleration, False))
    most = {} if unlimited else {"max_acceleration": acceleration}
    axes = axes_of(JOINTS, max_velocity=velocity, **most)
    limits = Limits.of(axes)
    assert not from_rest(trajectory, axes).remark
    curve = bounded(paced(curve_of(trajectory), limits), limits)
    assert curve.velocities is not None
    np.testing.assert_allclose(curve.velocities[[0, -1]], 0, atol=1e-9)
    fastest, steepest = sampled(curve, limits)
    assert fastest <= 1 + NOTED
    if not unlimited:
        velocities = curve.evaluate(trajectory.times_s, 1)
        assert_joins_the_points(curve, replace(trajectory, velocities=velocities))
        # Positions have nine digits; and within 0.4 µs of a point nothing switches.
        rounding = (12e-9 / step_s**2 + 1e-3) / acceleration
        assert steepest <= 1 + NOTED + rounding + 16 * 4e-7 / step_s


@pytest.mark.parametrize("step_s", STEPS_S)
@pytest.mark.parametrize("seed", range(3))
def test_positions_alone_of_planners_are_followed(seed: int, step_s: float) -> None:
    """Within the limits where the planner kept them, else within the margins."""
    trajectory = from_ruckig(seed, step_s=step_s)
    assert not from_rest(alone(trajectory), planned_axes(trajectory)).remark
    trajectory = from_toppra(seed, step_s=step_s)
    axes = planned_axes(trajectory)
    from_rest(alone(trajectory), axes)
    limits = Limits.of(axes)
    curve = bounded(paced(curve_of(alone(trajectory)), limits), limits)
    fastest, steepest = sampled(curve, limits)
    assert fastest <= 1 + MARGINS[1] and steepest <= 1 + MARGINS[2]


def test_positions_that_no_motion_within_the_limits_passes_are_refused() -> None:
    """1 rad in 1 s, from rest to rest, takes 4 rad/s² at least, or 1 rad/s all the time."""
    points = Trajectory(("a",), np.array([0.0, 1.0]), np.array([[0.0], [1.0]]))
    gentle = axes_of(("a",), max_velocity=3.0, max_acceleration=4.0 / 1.25)
    with pytest.raises(TrajectoryError, match=r"joint 'a': acceleration"):
        from_rest(points, gentle)
    with pytest.raises(TrajectoryError, match=r"joint 'a': velocity"):
        from_rest(points, axes_of(("a",), max_velocity=0.9))
    remark = from_rest(points, axes_of(("a",), max_velocity=3.0, max_acceleration=4 / 1.1)).remark
    assert "acceleration" in remark and "(10 % more)" in remark


def test_of_positions_alone_the_leg_that_asks_for_too_much_is_named() -> None:
    """1 rad in 0.8 s to where a plan begins takes joint_2 more than 4 rad/s². The plan itself is
    right, though what joins its points by their shape alone has more acceleration still."""
    plan = from_toppra(1)
    first = plan.positions[:1] + np.array([0, 1.0, 0, 0, 0, 0])
    spoilt = Trajectory(
        plan.joint_names,
        np.append(0.0, plan.times_s + 0.8),
        np.vstack((first, plan.positions)),
    )
    with pytest.raises(TrajectoryError, match="joint 'joint_2': acceleration") as refused:
        from_rest(spoilt, planned_axes(plan))
    assert float(str(refused.value).split(" s,")[0].split()[-1]) <= 1.1


@settings(max_examples=25, deadline=None)
@given(gentle(kinds=("positions",)), st.floats(1.0, 2.0))
def test_positions_alone_keep_their_shape_where_that_keeps_the_limits(
    trajectory: Trajectory, share: float
) -> None:
    curve = curve_of(trajectory)
    same = paced(curve, Limits.of(limited(curve, share=share)))
    t = np.linspace(0, curve.end_s, 1001)
    np.testing.assert_allclose(same.evaluate(t), curve.evaluate(t), atol=1e-9)
