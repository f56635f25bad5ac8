"""Stopping on the path: against the geometry of the path and the limits of the axes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from trajectories import JOINTS, NAMES, Array, curve_of, example, from_rest, gentle, limited

from epos2_ros.configuration.driver import AxisConfig
from epos2_ros.motion.join import join
from epos2_ros.motion.limits import Limits, extremes
from epos2_ros.motion.reference import Reference
from epos2_ros.motion.stop import stop
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.motion.units import AxisUnits


def own_limits(name: str) -> tuple[Trajectory, tuple[AxisConfig, ...]]:
    """An example and axes that can do just what it asks for."""
    trajectory = example(name)
    _, velocity, acceleration = extremes(curve_of(trajectory))
    return trajectory, tuple(
        AxisConfig(
            joint,
            i + 1,
            gear_ratio=100.0,
            max_velocity=float(max(velocity.high[i], -velocity.low[i])),
            max_acceleration=float(max(acceleration.high[i], -acceleration.low[i])),
        )
        for i, joint in enumerate(trajectory.joint_names)
    )


def assert_stops_on_the_path(
    current: Reference, stopped: Reference, limits: Limits, at_ms: int
) -> None:
    k = np.arange(at_ms + 1)
    np.testing.assert_array_equal(stopped.positions(k), current.positions(k))
    step = 1e-4
    t = np.arange(at_ms * 10 - 10, stopped.end_ms * 10 + 20) * step
    position, velocity, acceleration = (stopped.evaluate(t, order) for order in range(3))
    most_a = np.maximum(limits.acceleration * (1 + 1e-6), 1e-9)
    assert (np.abs(acceleration) <= most_a).all()
    mean = (velocity[1:] + velocity[:-1]) / 2
    assert (np.abs(np.diff(position, axis=0) - mean * step) <= most_a * step**2 + 1e-9).all()
    assert (np.abs(np.diff(velocity, axis=0)) <= most_a * step + 1e-9).all()
    assert not velocity[t >= stopped.end_ms / 1000].any()
    # On the path: having gone as far along it as the current motion had at some earlier
    # time, all axes are where that had them.
    dense = np.arange(at_ms * 20 - 20, stopped.end_ms * 20 + 20) * step / 2
    path = current.evaluate(dense)
    earlier = np.interp(distance(position), distance(path), dense)
    np.testing.assert_allclose(current.evaluate(earlier), position, rtol=0, atol=1e-6)
    assert (distance(position) <= np.interp(t, dense, distance(path)) + 1e-6).all()


def distance(position: Array) -> Array:
    """How far positions [m, axes] have come along the curve through them [m]."""
    return np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(position, axis=0), axis=1))))


@pytest.mark.parametrize("at_ms", [0, 432, 1500, 2345, 4000])
@pytest.mark.parametrize("name", NAMES)
def test_the_axes_stop_together_on_their_path(name: str, at_ms: int) -> None:
    trajectory, axes = own_limits(name)
    limits, current = Limits.of(axes), from_rest(trajectory, axes)
    stopped = stop(current, at_ms, limits)
    assert_stops_on_the_path(current, stopped, limits, at_ms)
    assert stopped.end_ms <= current.end_ms


def test_a_straight_line_is_braked_as_hard_as_the_weakest_axis_allows() -> None:
    """1 and 0.5 rad/s; the second axis may brake at 1 rad/s², so both take 0.5 s."""
    line = Trajectory(
        JOINTS,
        np.array([0.0, 1.0, 5.0, 6.0]),
        np.array([[0.0, 0.0], [0.5, 0.25], [4.5, 2.25], [5.0, 2.5]]),
        np.array([[0.0, 0.0], [1.0, 0.5], [1.0, 0.5], [0.0, 0.0]]),
    )
    axes = (
        AxisConfig("a", 1, gear_ratio=10.0, max_acceleration=100.0),
        AxisConfig("b", 2, gear_ratio=10.0, max_acceleration=1.0),
    )
    current = from_rest(line, axes)
    stopped = stop(current, 2000, Limits.of(axes))
    assert 2500 <= stopped.end_ms <= 2502
    way = stopped.evaluate(np.array([3.0])) - current.evaluate(np.array([2.0]))
    np.testing.assert_allclose(way[0], [0.25, 0.125], rtol=2e-3)


def test_without_a_limit_it_brakes_like_the_drives_profile_acceleration() -> None:
    """10,000 rpm/s of a motor with gear 100 are 10.47 rad/s² of the joint."""
    line = Trajectory(
        ("a",),
        np.array([0.0, 1.0, 5.0, 6.0]),
        np.array([[0.0], [0.5], [4.5], [5.0]]),
        np.array([[0.0], [1.0], [1.0], [0.0]]),
    )
    axes = (AxisConfig("a", 1, gear_ratio=100.0),)
    stopped = stop(from_rest(line, axes), 2000, Limits.of(axes))
    assert stopped.end_ms - 2000 == pytest.approx(1000 / 10.472, abs=1.5)


@settings(max_examples=40, deadline=None)
@given(gentle(), st.floats(0, 1), st.sampled_from([1.0, 1.5, 5.0]))
def test_any_motion_can_be_stopped(trajectory: Trajectory, when: float, share: float) -> None:
    axes = limited(curve_of(trajectory), share=share)
    limits, current = Limits.of(axes), from_rest(trajectory, axes)
    at_ms = round(when * current.end_ms)
    stopped = stop(current, at_ms, limits)
    assert_stops_on_the_path(current, stopped, limits, at_ms)


def test_standing_or_stopping_goes_on_as_it_is() -> None:
    trajectory, axes = own_limits("pick_place")
    limits, current = Limits.of(axes), from_rest(trajectory, axes)
    k = np.arange(current.end_ms + 100)
    for at_ms in (current.end_ms, current.end_ms + 50):
        np.testing.assert_array_equal(
            stop(current, at_ms, limits).positions(k), current.positions(k)
        )
    once = stop(current, 1000, limits)
    for at_ms in (1000, 1050, once.end_ms + 10):
        np.testing.assert_array_equal(stop(once, at_ms, limits).positions(k), once.positions(k))


@pytest.mark.parametrize("again_ms", [2010, 2500])  # while it slows down; when it stands
def test_stopping_again_cancels_what_was_to_begin_after_the_stop(again_ms: int) -> None:
    there = Trajectory(("a",), np.array([0.0, 5.0]), np.array([[0.0], [5.0]]))
    axes = (AxisConfig("a", 1, gear_ratio=100.0, max_acceleration=5.0),)
    limits = Limits.of(axes)
    once = stop(from_rest(there, axes), 2000, limits)
    back = Trajectory(("a",), np.array([2.0, 5.0]), np.array([[3.0], [0.0]]))
    later = join(once, back, limits, at_ms=2005, start_ms=4000)
    assert later.end_ms == 9000
    k = np.arange(9000)
    np.testing.assert_array_equal(stop(later, again_ms, limits).positions(k), once.positions(k))


def test_a_stop_can_be_followed_by_a_trajectory_and_a_transition_stopped() -> None:
    trajectory, axes = own_limits("jerk_limited")
    limits, current = Limits.of(axes), from_rest(trajectory, axes)
    slower = tuple(
        AxisConfig(a.joint, a.node_id, gear_ratio=100.0, max_velocity=9.0, max_acceleration=40.0)
        for a in axes
    )
    wide = Limits.of(slower)
    stopping = stop(current, 1200, limits)
    again = join(stopping, trajectory, wide, at_ms=1250, start_ms=500)
    t = np.arange(12000, 20000) / 10000
    position, velocity = again.evaluate(t), again.evaluate(t, 1)
    assert np.abs(np.diff(position, axis=0)).max() < 9e-4
    assert np.abs(np.diff(velocity, axis=0)).max() < 40e-4
    np.testing.assert_allclose(
        again.evaluate(np.array([3.0])), curve_of(trajectory).evaluate(np.array([2.5])), atol=1e-9
    )
    crossing = stop(again, 1300, wide)
    assert_stops_on_the_path(again, crossing, wide, 1300)


def test_stopping_needs_no_past() -> None:
    trajectory, axes = own_limits("raster_scan")
    current = from_rest(trajectory, axes)
    stopped = stop(current, 700, Limits.of(axes)).trimmed(700)
    assert len(stopped.motions) == 1
    assert stopped.units == tuple(AxisUnits.of(axis) for axis in axes)
