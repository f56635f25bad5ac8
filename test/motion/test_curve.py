"""The commanded curve, against polynomials solved from their end conditions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from trajectories import NAMES, curve_of, example, polynomial, trajectories

from epos2_ros.motion.curve import Curve
from epos2_ros.motion.trajectory import Trajectory


@given(trajectories(kinds=("velocities", "accelerations")), st.integers(0, 3))
def test_pieces_are_the_polynomials_their_ends_ask_for(
    trajectory: Trajectory, derivative: int
) -> None:
    curve = curve_of(trajectory)
    fields = [trajectory.positions, trajectory.velocities, trajectory.accelerations]
    given_fields = [field for field in fields if field is not None]
    for i in range(len(trajectory.times_s) - 1):
        start, end = trajectory.times_s[i : i + 2]
        t = start + (end - start) * np.array([0.0, 0.1, 0.37, 0.5, 0.93])
        for axis in range(2):
            exact = polynomial(
                [
                    tuple(field[i, axis] for field in given_fields),
                    tuple(field[i + 1, axis] for field in given_fields),
                ],
                end - start,
            ).deriv(derivative)(t - start)
            size = 1e-6 * max(1.0, float(np.abs(exact).max()), (end - start) ** -derivative)
            np.testing.assert_allclose(
                curve.evaluate(t, derivative)[:, axis], exact, rtol=0, atol=size
            )


@given(trajectories())
def test_the_points_are_met_with_all_they_ask_for(trajectory: Trajectory) -> None:
    curve, inner = curve_of(trajectory), trajectory.times_s[:-1]
    np.testing.assert_allclose(curve.evaluate(trajectory.times_s), trajectory.positions, atol=1e-12)
    if trajectory.velocities is not None:
        np.testing.assert_allclose(curve.evaluate(inner, 1), trajectory.velocities[:-1], atol=1e-9)
    if trajectory.accelerations is not None:
        np.testing.assert_allclose(
            curve.evaluate(inner, 2), trajectory.accelerations[:-1], atol=1e-6
        )


@given(trajectories())
def test_position_and_velocity_have_no_jumps(trajectory: Trajectory) -> None:
    curve, step = curve_of(trajectory), 1e-7
    for derivative in (0, 1):
        before = curve.evaluate(trajectory.times_s - step, derivative)
        after = curve.evaluate(trajectory.times_s + step, derivative)
        # 2 steps at the largest slope random points can have (5.8·6/0.02² and 2·2/0.02²·6).
        np.testing.assert_allclose(before, after, rtol=0, atol=2 * step * 2e5)


@given(trajectories(), st.floats(0.001, 100.0))
def test_outside_the_points_it_stands(trajectory: Trajectory, far: float) -> None:
    curve = curve_of(trajectory)
    before, after = np.array([curve.start_s - far]), np.array([curve.end_s, curve.end_s + far])
    np.testing.assert_array_equal(curve.evaluate(before)[0], trajectory.positions[0])
    last = trajectory.positions[[-1, -1]]
    np.testing.assert_allclose(curve.evaluate(after), last, rtol=0, atol=1e-12)
    for derivative in (1, 2, 3):
        assert not curve.evaluate(before, derivative).any()
        assert not curve.evaluate(after, derivative).any()


@given(trajectories(kinds=("positions",), points=(2, 9)))
def test_positions_alone_keep_their_shape(trajectory: Trajectory) -> None:
    """Between two points the curve only goes from one to the other; it turns at turning points."""
    curve = curve_of(trajectory)
    for i in range(len(trajectory.times_s) - 1):
        t = np.linspace(*trajectory.times_s[i : i + 2], 101)
        steps = np.diff(curve.evaluate(t), axis=0)
        way = trajectory.positions[i + 1] - trajectory.positions[i]
        assert (steps * np.sign(way) >= -1e-12).all()
        assert (np.abs(steps[:, way == 0]) < 1e-12).all()
    for t in trajectory.times_s[[0, -1]]:
        assert not curve.evaluate(np.array([t]), 1).any()


def test_positions_alone_are_a_straight_line_where_they_lie_on_one() -> None:
    times = np.arange(6.0)
    curve = Curve(times, np.column_stack([2 * times, -3 * times]))
    t = np.linspace(1.0, 4.0, 50)
    np.testing.assert_allclose(curve.evaluate(t), np.column_stack([2 * t, -3 * t]), atol=1e-12)
    np.testing.assert_allclose(curve.evaluate(t, 1), np.tile([2.0, -3.0], (50, 1)), atol=1e-12)


def test_positions_alone_can_start_in_motion() -> None:
    curve = Curve(
        np.array([1.0, 2.0, 3.0]), np.array([[0.0], [1.0], [1.5]]), start_velocity=np.array([-0.7])
    )
    assert curve.evaluate(np.array([1.0]), 1)[0, 0] == pytest.approx(-0.7)
    assert curve.evaluate(np.array([3.0 - 1e-9]), 1)[0, 0] == pytest.approx(0.0, abs=1e-6)


def test_a_single_point_stands() -> None:
    curve = Curve.resting(np.array([0.3, -0.2]))
    t = np.array([-1.0, 0.0, 5.0])
    np.testing.assert_array_equal(curve.evaluate(t), np.tile([0.3, -0.2], (3, 1)))
    assert not curve.evaluate(t, 1).any()


@settings(max_examples=50)
@given(trajectories(), st.integers(0, 2))
def test_a_piece_stays_within_its_control_points(trajectory: Trajectory, derivative: int) -> None:
    curve = curve_of(trajectory)
    h, points = curve.bezier(0, len(trajectory.times_s) - 1)
    for order in range(derivative):
        points = np.diff(points, axis=0) * (curve.degree - order) / h
    for i in range(len(h)):
        t = curve.times_s[i] + h[i] * np.linspace(0, 0.999, 60)
        value = curve.evaluate(t, derivative)
        size = 1e-9 * (1 + np.abs(points[:, :, i]).max())
        assert (value <= points[:, :, i].max(axis=0) + size).all()
        assert (value >= points[:, :, i].min(axis=0) - size).all()
        np.testing.assert_allclose(value[0], points[0, :, i], atol=size)


@pytest.mark.parametrize("name", NAMES)
def test_part_of_a_long_curve_is_like_the_whole(name: str) -> None:
    trajectory = example(name)
    curve = curve_of(trajectory)
    t = np.linspace(0, trajectory.duration_s, 4001)
    for derivative in range(3):
        whole = curve.evaluate(t, derivative)
        np.testing.assert_array_equal(curve.evaluate(t[1234:1299], derivative), whole[1234:1299])
        np.testing.assert_array_equal(curve.evaluate(t[::-1], derivative), whole[::-1])


def test_a_moment_before_a_point_is_not_outside() -> None:
    """(t − start)/h rounds to 1 there; the velocity is that of the point, not that of rest."""
    times = np.array([0.551, 0.551 + 1.1, 2.651])
    still = np.zeros((3, 1))
    curve = Curve(times, still, np.array([[0.0], [0.3], [0.0]]))
    just_before = 16510 * 1e-4
    assert just_before < times[1]
    assert (just_before - times[0]) / (times[1] - times[0]) >= 1
    assert curve.evaluate(np.array([just_before]), 1)[0, 0] == pytest.approx(0.3, abs=1e-9)
