"""From the configuration, in joint units, to what drives are set to and the group works with."""

from __future__ import annotations

import math

from epos2_ros.bus.epos2 import Epos2Settings
from epos2_ros.config import AxisConfig, DriverConfig
from epos2_ros.motion.fit import FitAxis
from epos2_ros.motion.units import AxisUnits, drive_limits
from epos2_ros.protocol.machine import Machine

VELOCITY_HEADROOM = 1.05
ACCELERATION_HEADROOM = 1.25
"""A drive faults at the joint's limit times this and warns halfway there: cubics between rounded
knots overshoot a commanded curve that runs along its limit. The commanded curve itself is held
to the limit exactly, before anything is sent."""
ROUNDING_S = 0.02
"""Acceleration has a velocity unit within this time on top: a knot's velocity is rounded."""


def drive_settings(axis: AxisConfig, config: DriverConfig) -> Epos2Settings:
    """The objects of one drive."""
    units = AxisUnits.of(axis)
    limits = drive_limits(axis, margin_qc=math.ceil(config.tolerance) + 1)
    stop = axis.stop_deceleration
    master = _index(config, config.sync_source)
    return Epos2Settings(
        joint=axis.joint,
        node_id=axis.node_id,
        velocity_notation=axis.velocity_notation,
        max_following_error_qc=axis.max_following_error,
        min_position_qc=limits.min_position,
        max_position_qc=limits.max_position,
        max_velocity=_velocity(axis, units, VELOCITY_HEADROOM),
        warning_velocity=_velocity(axis, units, (1 + VELOCITY_HEADROOM) / 2),
        max_acceleration_rpm_s=_acceleration(axis, units, ACCELERATION_HEADROOM),
        warning_acceleration_rpm_s=_acceleration(axis, units, (1 + ACCELERATION_HEADROOM) / 2),
        stop_deceleration_rpm_s=(
            None if stop is None else units.acceleration_object(stop, "stop_deceleration")
        ),
        state_inhibit_us=round(1e6 / config.state_rate),
        produces_sync=config.sync_producer == axis.joint,
        clock_master=None if master is None else config.axes[master].node_id,
    )


def fit_axis(axis: AxisConfig) -> FitAxis:
    """What the search for records has to keep: what the drive enforces."""
    units = AxisUnits.of(axis)
    acceleration = _acceleration(axis, units, ACCELERATION_HEADROOM)
    return FitAxis(
        units.velocity_unit_qc_s,
        _velocity(axis, units, VELOCITY_HEADROOM) * units.velocity_unit_qc_s,
        math.inf if acceleration is None else acceleration / 60 * axis.counts_per_turn,
    )


def machine_of(config: DriverConfig) -> Machine:
    """The protocol of all axes."""
    return Machine(config, fit_axis)


def _index(config: DriverConfig, joint: str) -> int | None:
    """Which of the axes is meant; None: the host."""
    return None if joint == "host" else [axis.joint for axis in config.axes].index(joint)


def _velocity(axis: AxisConfig, units: AxisUnits, headroom: float) -> int:
    """0x607F, 0x6081 [velocity units]; without a limit what the drive can hold."""
    most = units.velocity_range
    limit = most if axis.max_velocity is None else min(axis.max_velocity * headroom, most)
    return units.velocity_object(limit)


def _acceleration(axis: AxisConfig, units: AxisUnits, headroom: float) -> int | None:
    """0x60C5, 0x6083 [rpm/s]; None leaves the drive's."""
    if axis.max_acceleration is None:
        return None
    rounding = abs(units.from_velocity_units(1.0)) / ROUNDING_S
    return units.acceleration_object(axis.max_acceleration * headroom + rounding)
