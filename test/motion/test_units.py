"""Joint units and drive units, against figures worked out by hand."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from epos2_ros.configuration.driver import AxisConfig
from epos2_ros.errors import ConfigurationError
from epos2_ros.motion.units import INT32_MAX, INT32_MIN, AxisUnits, drive_limits

axis_configs = st.builds(
    AxisConfig,
    joint=st.just("joint_1"),
    node_id=st.just(1),
    type=st.sampled_from(["revolute", "prismatic"]),
    counts_per_turn=st.integers(16, 20_000),
    gear_ratio=st.floats(0.1, 500),
    lead=st.floats(1e-4, 0.5),
    direction=st.sampled_from([1, -1]),
    offset=st.floats(-10, 10),
    velocity_notation=st.integers(-3, 0),
)


def test_a_revolute_axis() -> None:
    # One output turn is 2π rad, 100 motor turns, 200,000 counts.
    units = AxisUnits.of(AxisConfig("joint_1", 1, counts_per_turn=2000, gear_ratio=100.0))
    assert units.to_qc(2 * math.pi) == pytest.approx(200_000)
    assert units.to_qc_s(math.pi) == pytest.approx(100_000)
    # 2π rad/s are 100 motor turns/s, 6000 rpm.
    assert units.to_velocity_units(2 * math.pi) == pytest.approx(6000)
    assert units.to_rpm_s(2 * math.pi) == pytest.approx(6000)


def test_a_prismatic_axis_that_runs_backwards() -> None:
    # 5 mm per screw turn, 4 motor turns per screw turn, 500 counts per motor turn.
    axis = AxisConfig(
        "gantry_x",
        1,
        type="prismatic",
        lead=0.005,
        gear_ratio=4.0,
        counts_per_turn=500,
        direction=-1,
        offset=0.1,
    )
    units = AxisUnits.of(axis)
    assert units.to_qc(0.1) == 0
    assert units.to_qc(0.105) == pytest.approx(-2000)
    assert units.from_qc(2000.0) == pytest.approx(0.095)
    assert units.to_velocity_units(0.005) == pytest.approx(-240)


@pytest.mark.parametrize(("notation", "unit_qc_s"), [(0, 2000 / 60), (-1, 200 / 60), (-3, 2 / 60)])
def test_the_velocity_unit_is_a_power_of_ten_of_an_rpm(notation: int, unit_qc_s: float) -> None:
    units = AxisUnits.of(AxisConfig("joint_1", 1, velocity_notation=notation))
    assert units.velocity_unit_qc_s == pytest.approx(unit_qc_s, rel=1e-12)
    assert units.from_velocity_units(60.0 * 10**-notation) == pytest.approx(2 * math.pi)


@given(axis_configs, st.floats(-100, 100), st.floats(-100, 100))
def test_what_goes_in_comes_out(axis: AxisConfig, position: float, velocity: float) -> None:
    units = AxisUnits.of(axis)
    assert units.from_qc(units.to_qc(position)) == pytest.approx(position, abs=1e-9)
    assert units.from_qc_s(units.to_qc_s(velocity)) == pytest.approx(velocity, abs=1e-9)
    there = units.to_velocity_units(velocity)
    assert units.from_velocity_units(there) == pytest.approx(velocity, abs=1e-9)
    # Velocity is the slope of position in the drive's units, too.
    moved = units.to_qc(position + velocity) - units.to_qc(position)
    assert units.to_qc_s(velocity) == pytest.approx(moved, rel=1e-6, abs=1e-3)
    assert np.sign(units.to_qc_s(velocity)) == np.sign(velocity) * axis.direction


def test_a_prismatic_axis_needs_its_lead() -> None:
    with pytest.raises(ConfigurationError, match="axes.gantry_x.lead"):
        AxisUnits.of(AxisConfig("gantry_x", 1, type="prismatic"))


def test_no_limits_leave_the_drives_own() -> None:
    limits = drive_limits(AxisConfig("joint_1", 1))
    assert (limits.min_position, limits.max_position) == (INT32_MIN, INT32_MAX)
    assert limits.velocity is None and limits.acceleration is None


def test_limits_in_the_drives_units() -> None:
    axis = AxisConfig(
        "joint_1",
        1,
        gear_ratio=100.0,
        min_position=-math.pi,
        max_position=math.pi / 2,
        max_velocity=math.pi,
        max_acceleration=2 * math.pi,
    )
    limits = drive_limits(axis, margin_qc=2)
    assert (limits.min_position, limits.max_position) == (-100_002, 50_002)
    assert (limits.velocity, limits.acceleration) == (3000, 6000)


def test_running_backwards_swaps_the_position_limits() -> None:
    axis = AxisConfig(
        "joint_1", 1, gear_ratio=100.0, direction=-1, min_position=-math.pi, max_position=0.5
    )
    limits = drive_limits(axis)
    assert limits.max_position == 100_000
    assert limits.min_position == round(-0.5 / math.pi * 100_000)


@given(axis_configs, st.floats(0.001, 1.0))
def test_limits_are_never_tighter_than_configured(axis: AxisConfig, share: float) -> None:
    units = AxisUnits.of(axis)
    velocity = units.velocity_range * share
    assert units.velocity_object(velocity) >= abs(units.to_velocity_units(velocity)) * (1 - 1e-9)
    assert units.velocity_object(velocity) <= abs(units.to_velocity_units(velocity)) + 1
    assert units.acceleration_object(velocity) >= 1


@pytest.mark.parametrize(
    ("limit", "value"),
    [
        ("max_velocity", 30.0),  # 25,000 rpm of the motor are 26.18 rad/s
        ("max_position", 70_000.0),  # int32 counts end at 67,465 rad
        ("max_acceleration", 5e6),  # uint32 rpm/s end at 4.5e6 rad/s²
    ],
)
def test_limits_the_drive_can_not_hold_are_refused(limit: str, value: float) -> None:
    axis = AxisConfig("joint_1", 1, gear_ratio=100.0, **{limit: value})
    with pytest.raises(ConfigurationError, match=re.escape(f"axes.joint_1.{limit}: {value:g} rad")):
        drive_limits(axis)


def test_fine_velocity_units_bound_the_velocity_a_record_can_hold() -> None:
    coarse = AxisUnits.of(AxisConfig("joint_1", 1))
    fine = AxisUnits.of(AxisConfig("joint_1", 1, velocity_notation=-3))
    assert coarse.velocity_range == pytest.approx(25_000 / 60 * 2 * math.pi)
    assert fine.velocity_range == pytest.approx(8388.607 / 60 * 2 * math.pi)
