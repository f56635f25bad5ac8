"""Streamed points, as MoveIt Servo sends them: one point a moment ahead, again and again."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from trajectories import JOINTS, Array, axes_of

from epos2_ros.errors import TrajectoryError
from epos2_ros.motion.join import join
from epos2_ros.motion.limits import Limits
from epos2_ros.motion.reference import Reference
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.motion.units import AxisUnits

Path = Callable[[float], Array]


def stream(
    path: Path,
    times_s: Array,
    *,
    ahead_s: float = 0.12,
    committed_ms: int = 50,
    limits: Limits | None = None,
    largest: list[int] | None = None,
) -> tuple[Array, Array, Array, Array]:
    """What is commanded at every millisecond when the point path(t) is sent at each of times_s.

    Each message takes over at the end of what is committed, and says its point is due
    `ahead_s` later. Returns times [s], positions, velocities and accelerations.
    """
    axes = axes_of(JOINTS)
    limits = limits or Limits.of(axes)
    reference = Reference.at_rest([AxisUnits.of(axis) for axis in axes], path(float(times_s[0])))
    at = [round(t * 1000) + committed_ms for t in times_s]
    parts: list[Array] = [np.arange(at[0])]
    values = [[reference.evaluate(parts[0] / 1000, order)] for order in range(3)]
    for i, t in enumerate(times_s):
        point = Trajectory(JOINTS, np.array([ahead_s]), path(float(t))[None, :])
        reference = join(reference, point, limits, at_ms=at[i], start_ms=at[i])
        until = at[i + 1] if i + 1 < len(at) else reference.end_ms + 50
        k = np.arange(at[i], until)
        parts.append(k)
        for order in range(3):
            values[order].append(reference.evaluate(k / 1000, order))
        reference = reference.trimmed(until)
        if largest is not None:
            largest.append(sum(getattr(m, "starts_s", np.zeros(1)).size for m in reference.motions))
    return (np.concatenate(parts) / 1000, *(np.concatenate(value) for value in values))


def assert_continuous(t: Array, position: Array, velocity: Array, acceleration: Array) -> None:
    np.testing.assert_allclose(np.diff(t), 1e-3)
    most_a = np.abs(acceleration).max() + 1e-9
    mean = (velocity[1:] + velocity[:-1]) / 2
    assert np.abs(np.diff(position, axis=0) - mean * 1e-3).max() <= most_a * 1e-6
    assert np.abs(np.diff(velocity, axis=0)).max() <= most_a * 1.01e-3


def straight(t: float) -> Array:
    return np.array([0.5, -0.25]) * t


@pytest.mark.parametrize("ahead_s", [0.1, 0.12, 0.15])
@pytest.mark.parametrize("committed_ms", [50, 100, 500])
def test_a_steady_stream_gives_a_steady_motion(ahead_s: float, committed_ms: int) -> None:
    t, position, velocity, acceleration = stream(
        straight, np.arange(0, 2, 0.02), ahead_s=ahead_s, committed_ms=committed_ms
    )
    assert_continuous(t, position, velocity, acceleration)
    steady = (t > 0.3 + committed_ms / 1000) & (t < 2 + committed_ms / 1000)
    np.testing.assert_allclose(
        velocity[steady], np.tile([0.5, -0.25], (steady.sum(), 1)), rtol=0.01
    )
    assert (velocity[:, 0] >= 0).all() and (velocity[:, 1] <= 0).all()
    # It rests on the last point, not before and not beyond, and the line stays a line.
    np.testing.assert_allclose(position[-1], straight(1.98), atol=1e-12)
    assert not velocity[-1].any()
    assert position[:, 0].max() <= straight(1.98)[0] + 1e-12
    np.testing.assert_allclose(position[:, 1], -0.5 * position[:, 0], atol=1e-12)


@settings(max_examples=25, deadline=None)
@given(st.lists(st.floats(0.012, 0.03), min_size=40, max_size=60), st.floats(0.02, 0.2))
def test_uneven_messages_neither_stop_it_nor_turn_it_back(
    periods: list[float], ahead_s: float
) -> None:
    times = np.cumsum(periods)
    t, position, velocity, acceleration = stream(straight, times, ahead_s=ahead_s)
    assert_continuous(t, position, velocity, acceleration)
    assert (velocity[:, 0] >= -1e-12).all()
    on_its_way = (t > times[0] + 0.35) & (t < times[-1] + 0.05)
    assert (velocity[on_its_way, 0] > 0.3).all()
    np.testing.assert_allclose(position[-1], straight(times[-1]), atol=1e-12)


def test_a_lost_message_only_slows_it_down_for_a_moment() -> None:
    times = np.delete(np.arange(0, 2, 0.02), [50])
    t, _, velocity, _ = stream(straight, times)
    steady = (t > 0.4) & (t < 2)
    assert velocity[steady, 0].min() > 0.3
    assert (velocity[:, 0] >= 0).all()


def test_points_with_zero_velocities_stream_alike() -> None:
    axes = axes_of(JOINTS)
    reference = Reference.at_rest([AxisUnits.of(axis) for axis in axes], np.zeros(2))
    plain = reference
    for i in range(10):
        due, point = np.array([0.12]), straight(0.02 * (i + 1))[None, :]
        at = 50 + 20 * i
        plain = join(plain, Trajectory(JOINTS, due, point), Limits.of(axes), at_ms=at, start_ms=at)
        reference = join(
            reference,
            Trajectory(JOINTS, due, point, np.zeros((1, 2)), np.zeros((1, 2))),
            Limits.of(axes),
            at_ms=at,
            start_ms=at,
        )
    k = np.arange(500)
    np.testing.assert_array_equal(reference.positions(k), plain.positions(k))


@pytest.mark.parametrize("acceleration", [3.0, 10.0, 100.0])
def test_limits_hold_even_if_the_operator_does_not_keep_them(acceleration: float) -> None:
    """0.5 rad/s one way, and at once back: faster than the axes can, they follow as they can."""

    def there_and_back(t: float) -> Array:
        return np.array([0.5 * (min(t, 1) - max(t - 1, 0)), 0.0])

    limits = Limits.of(axes_of(JOINTS, max_velocity=0.6, max_acceleration=acceleration))
    t, position, velocity, accelerations = stream(
        there_and_back, np.arange(0, 2.0, 0.02), limits=limits
    )
    assert_continuous(t, position, velocity, accelerations)
    assert np.abs(velocity).max() <= 0.6
    assert np.abs(accelerations).max() <= acceleration * (1 + 1e-9)
    np.testing.assert_allclose(position[-1], there_and_back(1.98), atol=1e-9)
    moving = (t > 0.5) & (t < 1.0)
    assert velocity[moving, 0].min() > 0.2


def test_a_smooth_stream_is_followed_closely() -> None:
    """Half a window ahead of when the points are due, with the points' own speed."""

    def circle(t: float) -> Array:
        return 0.3 * np.array([np.cos(2 * t), np.sin(2 * t)])

    t, position, velocity, _ = stream(circle, np.arange(0, 4, 0.02), ahead_s=0.1)
    inner = (t > 0.5) & (t < 3.9)
    # A point sent at s is taken over at s + 0.05 and stepped to until s + 0.15.
    wanted = np.array([circle(now - 0.1) for now in t[inner]])
    assert np.abs(position[inner] - wanted).max() < 0.6 * 0.012
    assert np.abs(np.hypot(*position[inner].T) - 0.3).max() < 1e-3
    np.testing.assert_allclose(np.hypot(*velocity[inner].T), 0.6, rtol=0.02)


def test_hours_of_streaming_need_no_more_than_seconds() -> None:
    steps: list[int] = []
    stream(straight, np.arange(0, 20, 0.02), largest=steps)
    assert max(steps[100:]) <= max(steps[:100]) <= 10


@settings(max_examples=8, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    period_s=st.floats(0.03, 0.2),
    dues_s=st.sampled_from([(0.034, 0.034), (0.05, 0.5), (0.25, 3.0)]),
    ramp_s=st.floats(0.1, 0.4),
    turns=st.booleans(),
)
def test_an_operator_at_the_velocity_limit_is_followed_whenever_its_points_are_due(
    seed: int, period_s: float, dues_s: tuple[float, float], ramp_s: float, turns: bool
) -> None:
    """Messages at uneven times, points due at random times after them, sometimes turning back."""
    random, velocity = np.random.default_rng(seed), 2.0
    axes = axes_of(JOINTS, max_velocity=velocity, max_acceleration=velocity / ramp_s)
    limits = Limits.of(axes)
    reference = Reference.at_rest([AxisUnits.of(axis) for axis in axes], np.zeros(2))
    now_s, place, way, latest_s = 0.0, np.zeros(2), np.array([velocity, -velocity / 2]), 0.0
    while now_s < 1.2:
        after_s = period_s * random.uniform(0.5, 1.5)
        way = -way if turns and random.random() < 0.1 else way
        now_s, place = now_s + after_s, place + way * after_s
        due_s = random.uniform(*dues_s)
        latest_s = max(latest_s, now_s + due_s)
        at_ms = round(now_s * 1000) + 140
        reference = join(
            reference,
            Trajectory(JOINTS, np.array([due_s]), place[None, :], published=True),
            limits,
            at_ms=at_ms,
            start_ms=round(now_s * 1000),
        ).trimmed(at_ms)
        t = at_ms / 1000 + np.arange(0, 0.3, 0.002)
        assert (np.abs(reference.evaluate(t, 1)) <= limits.velocity).all()
        assert (np.abs(reference.evaluate(t, 2)) <= limits.acceleration * 1.001).all()
    np.testing.assert_allclose(reference.evaluate(np.array([reference.end_s]))[0], place, atol=1e-9)
    # Behind by what it takes to get up to speed, and by steps that are longer than asked for.
    assert reference.end_s - 0.4 <= latest_s + 0.14 + 1.0 + 2 * ramp_s


def test_an_operator_faster_than_the_limit_is_followed_at_the_limit_and_then_waited_for() -> None:
    """At 1.5 times the limit it is 0.4 s ahead after 0.8 s. It waits, and goes on slowly."""
    axes = axes_of(JOINTS, max_velocity=1.0, max_acceleration=10.0)
    limits = Limits.of(axes)
    reference = Reference.at_rest([AxisUnits.of(axis) for axis in axes], np.zeros(2))
    place, refused = np.zeros(2), []
    for n in range(1, 91):
        speed = 1.5 if n <= 30 else 0.0 if n <= 50 else 0.5
        place = place + np.array([speed, 0.0]) * 0.05
        at_ms = 50 * n + 140
        point = Trajectory(JOINTS, np.array([0.05]), place[None, :], published=True)
        try:
            reference = join(reference, point, limits, at_ms=at_ms, start_ms=50 * n)
        except TrajectoryError as error:
            refused.append(n)
            assert "joint 'a': velocity" in str(error) and "allowed 1 rad/s" in str(error)
        reference = reference.trimmed(at_ms)
        speeds = reference.evaluate(at_ms / 1000 + np.arange(0, 0.05, 0.001), 1)
        assert np.abs(speeds).max() <= 1.0
    assert 0.6 <= 0.05 * refused[0] <= 0.8
    assert 0.05 * refused[-1] <= 1.5 + 0.5 * 1.5  # until the axes are as far at the limit
    np.testing.assert_allclose(reference.evaluate(np.array([99.0]))[0], place, atol=1e-9)


def test_a_step_much_faster_than_the_velocity_limit_is_refused() -> None:
    """0.4 s is what the axes may be late."""
    axes = axes_of(JOINTS, max_velocity=1.0)
    reference = Reference.at_rest([AxisUnits.of(axis) for axis in axes], np.zeros(2))
    far = Trajectory(JOINTS, np.array([0.15]), np.array([[0.0, 0.6]]))
    with pytest.raises(TrajectoryError, match=r"joint 'b': velocity 1\.5 rad/s .*allowed 1 rad"):
        join(reference, far, Limits.of(axes), at_ms=50, start_ms=50)
    far = Trajectory(JOINTS, np.array([0.15]), np.array([[0.0, 0.2]]))
    late = join(reference, far, Limits.of(axes), at_ms=50, start_ms=50)
    assert np.abs(late.evaluate(np.arange(0, 1, 0.001), 1)).max() <= 1.0
    axes = axes_of(JOINTS, max_position=0.1)
    with pytest.raises(TrajectoryError, match=r"joint 'b': position 0\.2 rad"):
        join(reference, far, Limits.of(axes), at_ms=50, start_ms=50)


def test_a_streamed_point_ends_a_trajectory_in_progress_smoothly() -> None:
    axes = axes_of(JOINTS, max_velocity=1.0, max_acceleration=4.0)
    limits = Limits.of(axes)
    line = Trajectory(JOINTS, np.array([0.0, 4.0]), np.array([[0.0, 0.0], [2.0, 1.0]]))
    here = Reference.at_rest([AxisUnits.of(axis) for axis in axes], np.zeros(2))
    current = join(here, line, limits, at_ms=0, start_ms=0)
    goal = current.evaluate(np.array([2.2]))
    point = Trajectory(JOINTS, np.array([0.12]), goal)
    replaced = join(current, point, limits, at_ms=2000, start_ms=2000)
    t = np.arange(19900, 35000) / 10000
    velocity, acceleration = replaced.evaluate(t, 1), replaced.evaluate(t, 2)
    assert np.abs(np.diff(velocity, axis=0)).max() <= 4.0e-4 * (1 + 1e-6)
    assert np.abs(velocity).max() <= 1.0 and np.abs(acceleration).max() <= 4.0
    np.testing.assert_allclose(replaced.evaluate(np.array([3.5])), goal, atol=1e-9)
