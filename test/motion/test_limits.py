"""Limits on the whole curve, against dense evaluation of it."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from trajectories import NAMES, curve_of, example, trajectories

from epos2_ros.configuration.driver import AxisConfig
from epos2_ros.errors import ConfigurationError, TrajectoryError
from epos2_ros.motion.curve import Curve
from epos2_ros.motion.limits import Limits, check, extremes
from epos2_ros.motion.trajectory import Trajectory

KINDS = ("position", "velocity", "acceleration")


def dense(curve: Curve, order: int, samples: int = 400) -> tuple[np.ndarray, np.ndarray]:
    """Times and values of a derivative, with both ends of each piece nearly touched."""
    u = np.concatenate(([1e-9], np.linspace(0, 1, samples)[1:-1], [1 - 1e-9]))
    t = (curve.times_s[:-1, None] + np.diff(curve.times_s)[:, None] * u).ravel()
    return t, curve.evaluate(t, order)


def limits_of(curve: Curve, kind: str, share: float) -> Limits:
    """Limits of two joints, one of which is `share` of what the curve reaches."""
    axes = [AxisConfig("a", 1), AxisConfig("b", 2)]
    _, value = dense(curve, KINDS.index(kind))
    if kind == "position":
        middle = (value[:, 1].max() + value[:, 1].min()) / 2
        half = (value[:, 1].max() - value[:, 1].min()) / 2
        bounds = {"min_position": middle - share * half, "max_position": middle + share * half}
    else:
        bounds = {f"max_{kind}": share * float(np.abs(value[:, 1]).max())}
    axes[1] = AxisConfig("b", 2, **bounds)
    return Limits.of(axes)


@given(trajectories())
def test_extremes_are_those_of_a_dense_evaluation(trajectory: Trajectory) -> None:
    curve = curve_of(trajectory)
    for order, extreme in enumerate(extremes(curve)):
        _, value = dense(curve, order)
        low, high = value.min(axis=0), value.max(axis=0)
        size = 1e-6 + 1e-3 * (high - low)  # what 400 samples of a piece can miss
        assert (extreme.high >= high - 1e-7 * (1 + np.abs(high))).all()
        assert (extreme.low <= low + 1e-7 * (1 + np.abs(low))).all()
        assert (extreme.high <= high + size).all() and (extreme.low >= low - size).all()
        # They are reached when it says so (from the left at the end of a piece).
        for axis in range(2):
            for found, when in (
                (extreme.high[axis], extreme.high_s[axis]),
                (extreme.low[axis], extreme.low_s[axis]),
            ):
                there = curve.evaluate(np.array([when, when - 1e-9]), order)[:, axis]
                assert np.abs(there - found).min() <= 1e-4 * (1 + abs(found))


@settings(max_examples=200)
@given(
    trajectories(),
    st.sampled_from(KINDS),
    st.one_of(st.floats(0.3, 0.998), st.floats(1.002, 3.0)),
)
def test_over_is_refused_and_within_is_not(trajectory: Trajectory, kind: str, share: float) -> None:
    curve = curve_of(trajectory)
    _, value = dense(curve, KINDS.index(kind))
    reach = value[:, 1]
    assume(0.01 < (np.ptp(reach) if kind == "position" else np.abs(reach).max()) < 20)
    limits = limits_of(curve, kind, share)
    if share > 1:
        check(curve, limits)
        return
    with pytest.raises(TrajectoryError) as refusal:
        check(curve, limits)
    found = re.fullmatch(
        r"joint 'b': (\w+) (\S+) (rad\S*) at (\S+) s, allowed (±|at most |at least )(\S+) (rad\S*)",
        str(refusal.value),
    )
    assert found is not None and found[1] == kind and found[3] == found[7]
    worst, when, limit = (float(found[n]) for n in (2, 4, 6))
    assert (found[5] == "±") == (kind != "position")
    low = -limit if found[5] == "±" else limit if found[5] == "at least " else -math.inf
    high = math.inf if found[5] == "at least " else limit
    assert worst > high or worst < low
    # It names the worst value, and when it is reached (times are printed in milliseconds).
    assert max(reach.max() - high, low - reach.min()) == pytest.approx(
        max(worst - high, low - worst), rel=1e-2, abs=1e-4 * (1 + abs(worst))
    )
    near = np.linspace(when - 0.0006, when + 0.0006, 201)
    there = curve.evaluate(near, KINDS.index(kind))[:, 1]
    assert np.abs(there - worst).min() <= 0.02 * (1 + abs(worst))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", NAMES)
def test_nine_digits_at_the_limit_pass(name: str, kind: str) -> None:
    """A planner's output may touch its own limits; what is clearly over them may not."""
    trajectory = example(name)
    curve = curve_of(trajectory)
    order = KINDS.index(kind)
    _, value = dense(curve, order, 100 + 100_000 // len(curve.times_s))

    def limits(share: float) -> Limits:
        axes = []
        for axis, joint in enumerate(trajectory.joint_names):
            low, high = value[:, axis].min(), value[:, axis].max()
            bounds = (
                {"min_position": low * share - 1e-9, "max_position": high * share + 1e-9}
                if kind == "position"
                else {f"max_{kind}": share * max(high, -low)}
            )
            axes.append(AxisConfig(joint, axis + 1, **bounds))
        return Limits.of(axes)

    check(curve, limits(1.0))
    with pytest.raises(TrajectoryError, match=kind):
        check(curve, limits(0.9999))


def test_rounding_to_nine_digits_is_forgiven_however_short_the_pieces() -> None:
    """Full acceleration to full speed and back, every millisecond, written with nine digits."""
    t = np.arange(2001) * 1e-3
    most = 2 / math.sqrt(3)  # so that nine digits are too few to write any of it
    v = most * np.where(t < 1, t, 2 - t)
    p = most / 2 * np.where(t < 1, t**2, 2 - (2 - t) ** 2)
    curve = Curve(t, *(np.round(x, 9)[:, None] for x in (p, v)))
    axes = [AxisConfig("a", 1, gear_ratio=100.0, max_velocity=most, max_acceleration=most)]
    check(curve, Limits.of(axes))
    axes = [AxisConfig("a", 1, gear_ratio=100.0, max_acceleration=0.99 * most)]
    with pytest.raises(TrajectoryError, match="acceleration"):
        check(curve, Limits.of(axes))


def test_between_the_points_counts() -> None:
    """0.5 rad in 1 s from rest to rest is 0.75 rad/s halfway, though every point stands."""
    curve = Curve(np.array([0.0, 1.0]), np.array([[0.0], [0.5]]), np.zeros((2, 1)))
    check(curve, Limits.of([AxisConfig("a", 1, max_velocity=0.75, max_acceleration=3.0)]))
    with pytest.raises(TrajectoryError, match=r"velocity 0.75 rad/s at 0.500 s, allowed ±0.74"):
        check(curve, Limits.of([AxisConfig("a", 1, max_velocity=0.74)]))
    with pytest.raises(TrajectoryError, match=r"acceleration -?3 rad/s² at [01].000 s"):
        check(curve, Limits.of([AxisConfig("a", 1, max_acceleration=2.99)]))


def test_the_drives_own_range_counts_without_configured_limits() -> None:
    limits = Limits.of([AxisConfig("a", 1, gear_ratio=100.0)])
    far = 2**31 / (200_000 / (2 * math.pi))  # [rad]
    check(Curve.resting(np.array([far * 0.999])), limits)
    with pytest.raises(TrajectoryError, match="joint 'a': position"):
        check(Curve.resting(np.array([far * 1.001])), limits)
    for speed, fits in ((26.0, True), (26.4, False)):  # 25,000 rpm are 26.18 rad/s
        curve = Curve(np.array([0.0, 1.0]), np.array([[0.0], [speed]]), np.full((2, 1), speed))
        if fits:
            check(curve, limits)
        else:
            with pytest.raises(TrajectoryError, match="joint 'a': velocity"):
                check(curve, limits)


def test_contradicting_limits_are_refused() -> None:
    with pytest.raises(ConfigurationError, match="axes.a.min_position"):
        Limits.of([AxisConfig("a", 1, min_position=1.0, max_position=1.0)])
