"""Records for fresh trajectories of two planners, looked at the way the drive executes them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from planners import from_ruckig, from_toppra
from trajectories import axes_of, curve_of, from_rest

from epos2_ros.bus.settings import fit_axis
from epos2_ros.configuration.driver import AxisConfig, DriverConfig
from epos2_ros.motion.fit import Fitter
from epos2_ros.motion.limits import extremes
from epos2_ros.motion.pvt import executed, segments
from epos2_ros.motion.record import Record
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.motion.units import AxisUnits

PLANNERS = [from_ruckig, from_toppra]
BUDGET = settings(
    max_examples=20,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow],
    print_blob=True,
)


def limited_axes(trajectory: Trajectory) -> tuple[AxisConfig, ...]:
    """Axes that may do exactly what the trajectory asks of them."""
    _, velocity, acceleration = extremes(curve_of(trajectory))
    return tuple(
        replace(
            axis,
            max_velocity=float(max(velocity.high[i], -velocity.low[i])),
            max_acceleration=float(max(acceleration.high[i], -acceleration.low[i])),
        )
        for i, axis in enumerate(axes_of(trajectory.joint_names))
    )


def from_zero(trajectory: Trajectory) -> Trajectory:
    """The same motion from the joints' zeros, where the drives stand at whole counts."""
    return replace(trajectory, positions=trajectory.positions - trajectory.positions[0])


@pytest.mark.parametrize("plan", PLANNERS)
@BUDGET
@given(
    seed=st.integers(0, 2**32 - 1),
    tolerance=st.sampled_from([1.0, 2.5, 10.0]),
    longest=st.sampled_from([50, 166, 255]),
)
def test_planned_motions(
    plan: Callable[[int], Trajectory], seed: int, tolerance: float, longest: int
) -> None:
    trajectory = from_zero(plan(seed))
    axes = limited_axes(trajectory)
    reference = from_rest(trajectory, axes)
    config = DriverConfig(axes, tolerance=tolerance)
    fits = [fit_axis(axis, config) for axis in axes]
    fitter = Fitter(fits, tolerance, longest)
    fitter.begin(reference, [0] * len(axes))
    k = np.arange(reference.end_ms + 1)
    commanded = reference.positions(k)
    for i, (axis, fit) in enumerate(zip(axes, fits, strict=True)):
        records: list[Record] = []
        while (record := fitter.next(i)) is not None:
            records.append(record)
        unit = AxisUnits.of(axis).velocity_unit_qc_s
        curve = executed(0, records, unit)

        assert len(curve.position_qc) == len(k), "it lasts as long as the trajectory"
        assert np.abs(curve.position_qc - commanded[:, i]).max() <= tolerance + 1e-6
        last = Record(round(commanded[-1, i]), 0, 0)
        assert records[-1] == last and records[-2][:2] == last[:2], "it ends where told to, at rest"
        assert all(1 <= record.time <= longest for record in records[:-1])
        cubics, times_ms = segments(0, records, unit)
        velocity, acceleration = cubics.extremes(times_ms * 1e-3)
        assert velocity.max() <= fit.max_velocity_qc_s * (1 + 1e-9)
        assert acceleration.max() <= fit.max_acceleration_qc_s2 * (1 + 1e-9)
