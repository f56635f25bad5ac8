"""Set-points: what a drive with a queue of one makes of them, by the simulated drive's ramps."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from random import Random

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from set_points import Executed, drive_executes
from trajectories import axes_of, curve_of, example, trajectories

from epos2_ros.motion.join import join
from epos2_ros.motion.limits import Limits
from epos2_ros.motion.reference import Reference
from epos2_ros.motion.setpoints import SetPoint, SetPointAxis, SetPointFitter
from epos2_ros.motion.stop import stop
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.motion.units import AxisUnits

RPM = 2000 / 60  # of an axis with 2000 counts per turn [qc/s], [qc/s²]
FEEDING_MS = 70
SYNC_MS = 20.0


def axis_of(velocity_qc_s: float, acceleration_qc_s2: float, share: float = 1.0) -> SetPointAxis:
    return SetPointAxis(
        share * RPM, share * RPM, velocity_qc_s, acceleration_qc_s2, FEEDING_MS, SYNC_MS
    )


def followed(fitter: SetPointFitter) -> list[SetPoint]:
    """All set-points from now on, asked for as soon as there is room."""
    points = []
    while not fitter.ended:
        if (point := fitter.next(fitter.due_ms)) is not None:
            points.append(point)
    return points


def largest_error_qc(reference: Reference, column: int, made: Executed) -> float:
    k = np.arange(len(made.position_qc))
    return float(np.abs(made.position_qc - reference.positions(k)[:, column]).max())


def check(
    points: Sequence[SetPoint],
    made: Executed,
    reference: Reference,
    column: int,
    axis: SetPointAxis,
    error_qc: float,
) -> None:
    """What holds for every motion from rest to rest."""
    assert [point.begin_ms for point in points] == made.begun_ms
    assert made.velocity_qc_ms[-1] == 0.0
    end_qc = reference.positions(np.array([reference.end_ms]))[0, column]
    assert made.position_qc[-1] == np.floor(end_qc + 0.5)
    assert largest_error_qc(reference, column, made) == pytest.approx(error_qc, abs=1e-3)
    assert np.abs(made.velocity_qc_ms).max() <= axis.max_velocity_qc_s * 1e-3 + 1e-9
    bends_qc_s2 = np.abs(np.diff(made.velocity_qc_ms)) * 1e6
    assert bends_qc_s2.max(initial=0.0) <= axis.max_acceleration_qc_s2 + 1e-3
    if points and points[0].begin_ms > 0:  # the drive stood at the start, and was told this then
        assert points[0].begin_ms >= FEEDING_MS
    for point in points:
        assert all(type(x) is int for x in point[:6])
        assert min(point.velocity, point.acceleration, point.deceleration) >= 1


def until_ms(reference: Reference, points: Sequence[SetPoint]) -> int:
    """When all is over."""
    return max([reference.end_ms, *(point.end_ms for point in points)]) + 5


def reference_of(trajectory: Trajectory) -> Reference:
    units = tuple(AxisUnits.of(axis) for axis in axes_of(trajectory.joint_names))
    return Reference(units, (curve_of(trajectory),))


@pytest.mark.parametrize(("name", "column"), [("pick_place", 1), ("jerk_limited", 3)])
def test_an_axis_of_an_example(name: str, column: int) -> None:
    """The joints turn up to 2 rad/s and 4 rad/s² (31,831 counts/rad)."""
    reference = reference_of(example(name))
    axis = axis_of(3.0 * 31_831, 12.5 * 31_831)
    fitter = SetPointFitter(axis, column)
    fitter.begin(reference, 0)
    points = followed(fitter)
    made = drive_executes(0, points, axis, lambda: FEEDING_MS - 2, until_ms(reference, points))
    check(points, made, reference, column, axis, fitter.error_qc)
    assert fitter.error_qc < 0.005 * 31_831
    assert sum(not point.passes for point in points) <= 6, "it stops where the curve moves"


@settings(max_examples=12, deadline=None)
@given(
    trajectory=trajectories(kinds=("velocities", "accelerations"), joints=("a",), points=(2, 4)),
    share=st.sampled_from([1.0, 0.1]),
    handshakes=st.randoms(use_true_random=False),
    replaced=st.sampled_from(["", "stop", "other"]),
    asked=st.integers(0, 20),
)
def test_any_motion_is_made_as_it_was_said(
    trajectory: Trajectory, share: float, handshakes: Random, replaced: str, asked: int
) -> None:
    """However late within its time the host is, and what the motion is replaced by."""
    axes = axes_of(("a",), max_velocity=20.0, max_acceleration=60.0)
    limits, scale = Limits.of(axes), 31_831
    assume(_within(trajectory, limits))
    rest = Reference.at_rest([AxisUnits.of(axes[0])], trajectory.positions[0])
    reference = join(rest, trajectory, limits, at_ms=1, start_ms=1)
    start_qc = round(float(rest.positions(np.array([0]))[0, 0]))
    axis = axis_of(20.0 * scale, 75.0 * scale, share)
    fitter = SetPointFitter(axis, 0)
    fitter.begin(reference, start_qc)
    points: list[SetPoint] = []
    while not fitter.ended:
        if (point := fitter.next(fitter.due_ms)) is not None:
            points.append(point)
            if len(points) == asked and replaced:
                at_ms = fitter.committed_ms
                if replaced == "stop":
                    reference = stop(reference, at_ms, limits)
                else:
                    reference = join(
                        reference, trajectory, limits, at_ms=at_ms, start_ms=at_ms + 100
                    )
                fitter.replace(reference.trimmed(at_ms))
    until = until_ms(reference, points)
    late = FEEDING_MS - 2
    made = drive_executes(start_qc, points, axis, lambda: handshakes.randint(2, late), until)
    check(points, made, reference, 0, axis, fitter.error_qc)


def test_an_axis_that_does_not_move_gets_no_set_point() -> None:
    fitter = SetPointFitter(axis_of(1e5, 1e6), 0)
    fitter.begin(Reference.at_rest([AxisUnits.of(axes_of(("a",))[0])], [1.0]), 31_831)
    assert followed(fitter) == []
    assert fitter.error_qc <= 0.5


@pytest.mark.parametrize("beside", [-1.0, -0.6, -0.51, 0.0, 0.49, 0.55, 0.9])
def test_an_axis_that_stands_within_a_count_of_the_end_is_at_its_end(beside: float) -> None:
    """Whether the last count is worth a set-point or not: the motion ends, and soon."""
    fitter = SetPointFitter(axis_of(1e5, 1e6), 0)
    units = [AxisUnits.of(axes_of(("a",))[0])]
    fitter.begin(Reference.at_rest(units, [units[0].from_qc(7592 + beside)]), 7592)
    for path_ms in range(0, 400, 4):
        fitter.next(path_ms)
    assert fitter.ended
    assert fitter.error_qc <= 1.0


def test_an_axis_that_stands_a_count_beside_its_end_still_goes_there() -> None:
    fitter = SetPointFitter(axis_of(1e5, 1e6), 0)
    fitter.begin(Reference.at_rest([AxisUnits.of(axes_of(("a",))[0])], [10 / 31_830.99]), 9)
    points = [fitter.next(fitter.due_ms) for _ in range(10)]
    assert fitter.ended
    assert [point.target_qc for point in points if point is not None][-1:] == [10]


def test_a_rest_in_between_is_stood_through_and_left_on_a_sync() -> None:
    """It is not known long before that the axis will move on: so much is not committed."""
    trajectory = Trajectory(
        ("a",),
        np.array([0.0, 1.0, 6.0, 7.0]),
        np.array([[0.0], [1.0], [1.0], [0.0]]),
        np.zeros((4, 1)),
        np.zeros((4, 1)),
    )
    reference = reference_of(trajectory)
    axis = axis_of(3.0 * 31_831, 12.5 * 31_831)
    fitter = SetPointFitter(axis, 0)
    fitter.begin(reference, 0)
    points, waited = [], 0
    while not fitter.ended:
        asked_ms = fitter.due_ms
        point = fitter.next(asked_ms)
        if point is None:
            waited += 1
            continue
        points.append(point)
        queued_ms = points[-2].end_ms if points[1:] else 0
        assert point.begin_ms <= max(asked_ms, queued_ms) + FEEDING_MS + 3 * SYNC_MS
    gaps_ms = [later.begin_ms - point.end_ms for point, later in pairwise(points)]
    restart = 1 + int(np.argmax(gaps_ms))
    assert points[restart].begin_ms % SYNC_MS == 0
    assert abs(points[restart].begin_ms - 6000) <= 200
    assert not points[restart - 1].passes
    assert points[restart - 1].target_qc == 31_831
    assert waited > 100
    until = until_ms(reference, points)
    made = drive_executes(0, points, axis, lambda: 10, until)
    check(points, made, reference, 0, axis, fitter.error_qc)


def test_after_its_end_a_motion_is_not_replaced() -> None:
    fitter = SetPointFitter(axis_of(1e5, 1e6), 0)
    reference = Reference.at_rest([AxisUnits.of(axes_of(("a",))[0])], [0.0])
    fitter.begin(reference, 0)
    assert fitter.next() is None
    assert fitter.ended
    with pytest.raises(ValueError, match="committed"):
        fitter.replace(reference)


def _within(trajectory: Trajectory, limits: Limits) -> bool:
    k = np.linspace(0.0, trajectory.duration_s, 500)
    curve = curve_of(trajectory)
    return bool(
        np.abs(curve.evaluate(k, 1)).max() <= 0.9 * limits.velocity[0]
        and np.abs(curve.evaluate(k, 2)).max() <= 0.9 * limits.acceleration[0]
    )
