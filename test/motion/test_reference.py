"""What the drives are told to follow, and how a new trajectory takes over from it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import event, given, settings
from hypothesis import strategies as st
from trajectories import JOINTS, NAMES, axes_of, curve_of, example, from_rest, gentle, limited, rest

from epos2_ros.configuration.driver import AxisConfig
from epos2_ros.errors import TrajectoryError
from epos2_ros.motion.join import join
from epos2_ros.motion.limits import MARGINS, NOTED, Limits, extremes
from epos2_ros.motion.reference import Reference
from epos2_ros.motion.trajectory import Trajectory


def assert_smooth_and_within(
    reference: Reference, limits: Limits, from_ms: int, to_ms: int, slack: float = 1e-6
) -> None:
    """No jumps of position or velocity from one millisecond to the next, and no limit exceeded.

    Looked at ten times a millisecond; `limits.acceleration` has to be finite.
    """
    step = 1e-4
    t = np.arange(from_ms * 10, to_ms * 10 + 1) * step
    position, velocity, acceleration = (reference.evaluate(t, order) for order in range(3))
    same = np.array([2e-4 / abs(u.qc_per_unit) for u in reference.units])  # no difference: 2e-4 qc
    most_v = limits.velocity * (1 + slack) + 1e-9
    most_a = limits.acceleration * (1 + slack) + 1e-9
    assert (np.abs(velocity) <= most_v).all()
    assert (np.abs(acceleration) <= most_a).all()
    # The derivatives are those of what is really commanded.
    mean = (velocity[1:] + velocity[:-1]) / 2
    assert (np.abs(np.diff(position, axis=0) - mean * step) <= most_a * step**2 + same).all()
    assert (np.abs(np.diff(velocity, axis=0)) <= most_a * step + 10 * same).all()


# ------------------------------------------------------------------------- a trajectory


@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("name", NAMES)
def test_the_reference_is_the_trajectory_in_counts(name: str, direction: int) -> None:
    trajectory = example(name)
    axes = tuple(
        AxisConfig(joint, i + 1, gear_ratio=100.0, direction=direction, offset=0.25)
        for i, joint in enumerate(trajectory.joint_names)
    )
    reference = from_rest(trajectory, axes)
    scale = direction * 200_000 / (2 * math.pi)
    assert reference.end_ms == math.ceil(trajectory.duration_s * 1000 - 1e-6)
    k = np.arange(reference.end_ms + 10)
    curve = curve_of(trajectory)
    np.testing.assert_allclose(
        reference.positions(k), (curve.evaluate(k / 1000) - 0.25) * scale, atol=1e-6
    )
    np.testing.assert_allclose(
        reference.velocities(k), curve.evaluate(k / 1000, 1) * scale, atol=1e-6
    )
    assert not reference.velocities(k[reference.end_ms :]).any()
    at_points = np.flatnonzero(np.abs(trajectory.times_s * 1000 % 1) < 1e-9)
    np.testing.assert_allclose(
        reference.positions(np.round(trajectory.times_s[at_points] * 1000).astype(int)),
        (trajectory.positions[at_points] - 0.25) * scale,
        atol=1e-6,
    )


def test_joints_in_any_order() -> None:
    trajectory = example("pick_place")
    axes = axes_of(trajectory.joint_names)
    order = [3, 0, 5, 1, 4, 2]
    assert trajectory.velocities is not None and trajectory.accelerations is not None
    shuffled = Trajectory(
        tuple(trajectory.joint_names[i] for i in order),
        trajectory.times_s,
        trajectory.positions[:, order],
        trajectory.velocities[:, order],
        trajectory.accelerations[:, order],
    )
    k = np.arange(0, 9000, 7)
    reference = join(
        rest(axes, trajectory.positions[0]), shuffled, Limits.of(axes), at_ms=0, start_ms=0
    )
    np.testing.assert_array_equal(reference.positions(k), from_rest(trajectory, axes).positions(k))


def test_limits_are_checked_before_anything_moves() -> None:
    trajectory = example("pick_place")
    axes = axes_of(trajectory.joint_names, max_velocity=1.0)
    with pytest.raises(TrajectoryError, match=r"joint '\w+': velocity \S+ rad/s at \S+ s") as e:
        from_rest(trajectory, axes)
    named = trajectory.joint_names.index(str(e.value).split("'")[1])
    assert trajectory.velocities is not None
    assert np.abs(trajectory.velocities[:, named]).max() > 1.0


# ------------------------------------------------------------------------------- start


def test_a_single_point_that_is_due_at_once_must_be_near() -> None:
    axes = axes_of(JOINTS)
    here = rest(axes, np.zeros(2))
    jump = Trajectory(JOINTS, np.zeros(1), np.array([[0.0, 0.5]]))
    with pytest.raises(TrajectoryError, match="joint 'b', point 0: 0.5 rad is 0.5 rad away"):
        join(here, jump, Limits.of(axes), at_ms=0, start_ms=0, start_tolerance=0.01)


def test_far_from_the_first_point_is_refused() -> None:
    trajectory = example("pick_place")
    axes = axes_of(trajectory.joint_names)
    here = trajectory.positions[0].copy()
    here[2] += 0.0101
    with pytest.raises(TrajectoryError, match=r"joint 'elbow_joint', point 0: .*allowed 0\.01"):
        join(
            rest(axes, here), trajectory, Limits.of(axes),
            at_ms=0, start_ms=0, start_tolerance=0.01,
        )  # fmt: skip


@settings(max_examples=20, deadline=None)
@given(
    st.sampled_from(NAMES),
    st.lists(st.floats(-0.01, 0.01), min_size=6, max_size=6),
    st.sampled_from([1.0, 1.1, 2.0]),
)
def test_near_the_first_point_the_difference_fades(
    name: str, offsets: list[float], share: float
) -> None:
    """Within the limits, also when the trajectory itself uses them up; and it ends exact."""
    trajectory = example(name)
    curve = curve_of(trajectory)
    _, velocity, acceleration = extremes(curve)
    offset = np.array(offsets[: len(trajectory.joint_names)])
    axes = tuple(
        AxisConfig(
            joint,
            i + 1,
            gear_ratio=100.0,
            max_velocity=share * float(max(velocity.high[i], -velocity.low[i])),
            max_acceleration=share * float(max(acceleration.high[i], -acceleration.low[i])),
        )
        for i, joint in enumerate(trajectory.joint_names)
    )
    limits = Limits.of(axes)
    count = 2 * np.pi / (2000 * 100)  # [rad]; drives stand on whole ones
    here = np.round((trajectory.positions[0] + offset) / count) * count
    reference = join(
        rest(axes, here), trajectory, limits, at_ms=0, start_ms=0, start_tolerance=0.0101
    )
    # There is nothing to be done about less than a count.
    apart = np.abs(trajectory.positions[0] - here) > 0.501 * count
    start = np.where(apart, here, trajectory.positions[0])
    np.testing.assert_allclose(reference.evaluate(np.zeros(1))[0], start, atol=1e-9)
    assert not reference.evaluate(np.zeros(1), 1).any()
    assert_smooth_and_within(reference, limits, 0, 3000)
    t = np.linspace(3.0, trajectory.duration_s, 500)
    np.testing.assert_allclose(reference.evaluate(t), curve.evaluate(t), atol=1e-9)


def test_a_first_point_in_the_future_is_reached_from_where_the_axes_are() -> None:
    axes = axes_of(JOINTS)
    here = np.array([0.3, -0.2])
    goal = Trajectory(JOINTS, np.array([2.0]), np.array([[1.3, -0.7]]))
    reference = join(
        rest(axes, here), goal, Limits.of(axes), at_ms=0, start_ms=0, start_tolerance=0.01
    )
    # Positions alone, at rest at both ends: 3u² − 2u³ of the way.
    u = np.linspace(0, 1, 21)[:, None]
    np.testing.assert_allclose(
        reference.evaluate(2 * u[:, 0]),
        here + (goal.positions[0] - here) * (3 * u**2 - 2 * u**3),
        atol=1e-12,
    )


# ------------------------------------------------------------------------- replacement


@settings(max_examples=40, deadline=None)
@given(
    gentle(),
    gentle(first_s=st.sampled_from([0.0, 0.0, 0.7])),
    st.sampled_from([1.0, 1.2, 2.0, 4.0]),
    st.floats(0, 1),
    st.integers(-800, 300),
)
def test_replacement_is_smooth_and_within_the_limits(
    old: Trajectory, new: Trajectory, share: float, when: float, shift_ms: int
) -> None:
    axes = limited(curve_of(old), curve_of(new), share=share)
    limits = Limits.of(axes)
    current = from_rest(old, axes)
    at_ms = round(when * current.end_ms)
    start_ms = at_ms + shift_ms
    k = np.arange(current.end_ms + 1)
    before = current.positions(k)
    try:
        replaced = join(current, new, limits, at_ms=at_ms, start_ms=start_ms)
    except TrajectoryError as refusal:
        event("refused")
        assert "\n" not in str(refusal) and "joint '" in str(refusal)
    else:
        event("joined")
        take_over = max(at_ms, start_ms)
        np.testing.assert_array_equal(
            replaced.positions(k[:take_over]), current.positions(k[:take_over])
        )
        slack = MARGINS[2] if replaced.remark else NOTED
        assert_smooth_and_within(
            replaced, limits, max(take_over - 5, 0), replaced.end_ms + 5, slack
        )
        # It comes to rest on the last point, at most a second late.
        late = max(start_ms + new.duration_s * 1000, take_over) + 1001
        assert replaced.end_ms <= late
        end = np.array([replaced.end_ms / 1000])
        np.testing.assert_allclose(replaced.evaluate(end)[0], new.positions[-1], atol=1e-9)
        assert np.abs(replaced.evaluate(end, 1)).max() < 1e-12
    np.testing.assert_array_equal(current.positions(k), before)


@settings(max_examples=20, deadline=None)
@given(gentle(points=(4, 7)), gentle(points=(4, 7)), st.floats(0, 1))
def test_with_room_for_it_a_replacement_is_on_the_new_trajectory_soon(
    old: Trajectory, new: Trajectory, when: float
) -> None:
    axes = limited(curve_of(old), curve_of(new), share=8.0)
    current = from_rest(old, axes)
    at_ms = round(when * current.end_ms)
    replaced = join(current, new, Limits.of(axes), at_ms=at_ms, start_ms=at_ms)
    t = np.linspace(0.85, new.duration_s, 200)
    np.testing.assert_allclose(
        replaced.evaluate(at_ms / 1000 + t), curve_of(new).evaluate(t), atol=1e-9
    )


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("at_ms", [0, 1, 733, 2345, 60_000])
def test_the_same_trajectory_again_changes_nothing(name: str, at_ms: int) -> None:
    trajectory = example(name)
    axes = axes_of(trajectory.joint_names)
    current = from_rest(trajectory, axes)
    again = join(current, trajectory, Limits.of(axes), at_ms=at_ms, start_ms=0)
    k = np.arange(current.end_ms + 100)
    np.testing.assert_allclose(again.positions(k), current.positions(k), rtol=0, atol=1e-3)
    np.testing.assert_allclose(again.velocities(k), current.velocities(k), rtol=0, atol=1e-2)


def test_a_start_in_the_future_lets_the_old_one_go_on_until_then() -> None:
    trajectory = example("raster_scan")
    axes = axes_of(trajectory.joint_names)
    current = from_rest(trajectory, axes)
    later = join(current, trajectory, Limits.of(axes), at_ms=500, start_ms=9500)
    k = np.arange(9501)
    np.testing.assert_array_equal(later.positions(k), current.positions(k))
    t = np.linspace(2.0, trajectory.duration_s + 1, 300)
    np.testing.assert_allclose(
        later.evaluate(9.5 + t), curve_of(trajectory).evaluate(t), rtol=0, atol=1e-9
    )


def test_a_start_in_the_past_joins_where_the_trajectory_would_be() -> None:
    trajectory = example("jerk_limited")
    axes = axes_of(trajectory.joint_names, max_velocity=3.0, max_acceleration=20.0)
    limits = Limits.of(axes)
    late = join(rest(axes, trajectory.positions[0]), trajectory, limits, at_ms=0, start_ms=-500)
    assert_smooth_and_within(late, limits, 0, late.end_ms)
    t = np.linspace(1.5, trajectory.duration_s, 300)
    np.testing.assert_allclose(
        late.evaluate(t - 0.5), curve_of(trajectory).evaluate(t), rtol=0, atol=1e-9
    )


def test_who_is_late_need_not_stand_at_the_first_point() -> None:
    trajectory = example("jerk_limited")
    axes = axes_of(trajectory.joint_names, max_velocity=3.0, max_acceleration=20.0)
    there = curve_of(trajectory).evaluate(np.array([0.5]))[0]
    assert np.abs(there - trajectory.positions[0]).max() > 0.02
    late = join(
        rest(axes, there), trajectory, Limits.of(axes),
        at_ms=0, start_ms=-500, start_tolerance=0.01,
    )  # fmt: skip
    np.testing.assert_allclose(late.evaluate(np.zeros(1))[0], there, atol=1e-9)


def test_the_time_of_a_violation_is_the_trajectorys_own() -> None:
    """0.5 rad in 2 s is fastest halfway, 0.375 rad/s; wherever on path time that is."""
    axes = axes_of(JOINTS, max_velocity=0.2)
    move = Trajectory(
        JOINTS, np.array([0.0, 2.0]), np.array([[0.0, 0.0], [0.5, 0.0]]), np.zeros((2, 2))
    )
    for at_ms, start_ms in ((0, 0), (3000, 3500), (3000, 2900)):
        with pytest.raises(TrajectoryError, match=r"'a': velocity 0\.375 rad/s at 1\.000 s"):
            join(rest(axes, np.zeros(2)), move, Limits.of(axes), at_ms=at_ms, start_ms=start_ms)


def test_what_can_not_be_joined_in_time_is_refused() -> None:
    axes = axes_of(JOINTS, max_velocity=0.5, max_acceleration=1.0)
    current = from_rest(
        Trajectory(JOINTS, np.array([0.0, 4.0]), np.array([[0.0, 0.0], [1.0, 0.0]])), axes
    )
    far = Trajectory(JOINTS, np.array([0.0, 1.0]), np.array([[-1.0, 0.0], [-1.1, 0.0]]))
    with pytest.raises(TrajectoryError, match=r"joint 'a' can't get onto the trajectory within"):
        join(current, far, Limits.of(axes), at_ms=2000, start_ms=2000)


def test_joints_that_are_not_named_come_to_rest_and_hold() -> None:
    axes = axes_of(JOINTS, max_velocity=1.0, max_acceleration=3.0)
    limits = Limits.of(axes)
    current = from_rest(
        Trajectory(JOINTS, np.array([0.0, 3.0]), np.array([[0.0, 0.0], [1.0, 1.0]])), axes
    )
    only = Trajectory(("b",), np.array([0.0, 2.0]), np.array([[0.5], [0.0]]))
    with pytest.raises(TrajectoryError, match="joint a missing"):
        join(current, only, limits, at_ms=1500, start_ms=1500)
    replaced = join(current, only, limits, at_ms=1500, start_ms=1500, allow_partial=True)
    assert_smooth_and_within(replaced, limits, 1490, replaced.end_ms + 5)
    t = np.arange(1500, 4000) / 1000
    way, speed = replaced.evaluate(t)[:, 0], replaced.evaluate(t, 1)[:, 0]
    assert (speed >= -1e-9).all()  # it slows down, and does not come back
    # 0.5 rad/s at 3 rad/s² take 0.042 rad; a smooth ramp half as much again.
    assert way[-1] - way[0] == pytest.approx(0.0625, rel=0.02)
    assert not speed[t > 2.0].any()
    end = replaced.evaluate(np.array([3.5]))[0]
    assert end[1] == pytest.approx(0.0, abs=1e-9)


def test_many_replacements_leave_nothing_behind() -> None:
    """What lies before the earliest millisecond still needed is dropped, its value kept."""
    trajectory = example("pick_place")
    axes = axes_of(trajectory.joint_names)
    limits, current = Limits.of(axes), from_rest(trajectory, axes)
    for i in range(1, 60):
        current = join(current, trajectory, limits, at_ms=100 * i, start_ms=100 * i - 1000)
        k = np.arange(100 * i - 50, 100 * i + 200)
        trimmed = current.trimmed(100 * i - 50)
        np.testing.assert_array_equal(trimmed.positions(k), current.positions(k))
        current = trimmed
        assert len(current.motions) <= 3
