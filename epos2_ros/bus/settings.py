"""From the configuration, in joint units, to what drives are set to and the group works with."""

from __future__ import annotations

import math

from epos2_ros.bus.epos2 import Epos2Settings
from epos2_ros.configuration.driver import AxisConfig, DriverConfig
from epos2_ros.motion.fit import FitAxis
from epos2_ros.motion.setpoints import FEEDING_MS, SetPointAxis
from epos2_ros.motion.units import PROFILE_ACCELERATION_RPM_S, AxisUnits, drive_limits
from epos2_ros.protocol.families import FAMILIES
from epos2_ros.protocol.machine import Machine
from epos2_ros.protocol.pvt.feeder import STREAM_SEGMENT_MS
from epos2_ros.protocol.setpoints.axis import STANDING_MS

VELOCITY_HEADROOM = 1.05
ACCELERATION_HEADROOM = 1.25
"""A drive faults at the joint's limit times this and warns halfway there: cubics between rounded
knots overshoot a commanded curve that runs along its limit. The commanded curve itself is held
to the limit exactly, before anything is sent."""
FEEDING_SHARE = 0.12  # of the buffer time, for which a drive has a set-point more than it needs
ROUNDING_S = STREAM_SEGMENT_MS / 1000
"""What rounding takes comes on top. Knots are whole counts and whole velocity units, and a segment
of a stream, the shortest there are, lasts this long at most. Within it an axis that creeps has to
be able to go on by a count, from rest to rest (1.5 counts per this time of velocity, 6 per its
square of acceleration), or to become a velocity unit faster. Between knots slower than the joint's
limit it could not go on at that, so a whole unit not below it is allowed in any case."""
_SWAY = 4
"""Where a unit is coarse, that takes less time: between two velocities next to the commanded one a
cubic is off by up to an eighth of a unit times its duration; a duration of so many tolerances per
unit leaves half a tolerance for rounded positions."""


def drive_settings(axis: AxisConfig, config: DriverConfig) -> Epos2Settings:
    """The objects of one drive."""
    units = AxisUnits.of(axis)
    limits = drive_limits(axis, margin_qc=math.ceil(config.tolerance) + 1)
    stop = axis.stop_deceleration

    def velocity(headroom: float) -> int:  # 0x607F, 0x6081 [velocity units]
        return units.velocity_object(_velocity(axis, config, headroom))

    def acceleration(headroom: float) -> int | None:  # 0x60C5, 0x6083 [rpm/s]
        value = _acceleration(axis, config, headroom)
        return None if value is None else units.acceleration_object(value)

    return Epos2Settings(
        joint=axis.joint,
        node_id=axis.node_id,
        velocity_notation=axis.velocity_notation,
        max_following_error_qc=axis.max_following_error,
        min_position_qc=limits.min_position,
        max_position_qc=limits.max_position,
        max_velocity=velocity(VELOCITY_HEADROOM),
        warning_velocity=velocity((1 + VELOCITY_HEADROOM) / 2),
        max_acceleration_rpm_s=acceleration(ACCELERATION_HEADROOM),
        warning_acceleration_rpm_s=acceleration((1 + ACCELERATION_HEADROOM) / 2),
        stop_deceleration_rpm_s=(
            None if stop is None else units.acceleration_object(stop, "stop_deceleration")
        ),
        produces_sync=config.sync_producer == axis.joint,
        clock_master=clock_master(config),
    )


def fit_axis(axis: AxisConfig, config: DriverConfig) -> FitAxis:
    """What the search for records has to keep: of an EPOS2 no more than what it enforces."""
    units = AxisUnits.of(axis)
    acceleration = _acceleration(axis, config, ACCELERATION_HEADROOM)
    if acceleration is None or axis.max_acceleration is None:
        most = math.inf
        agility_rpm_s = (ACCELERATION_HEADROOM - 1) * PROFILE_ACCELERATION_RPM_S
        spare = agility_rpm_s / 60 * axis.counts_per_turn
    else:
        most = abs(units.to_qc_s(acceleration))
        spare = most - abs(units.to_qc_s(axis.max_acceleration))
    unit_qc_s = _unit_qc_s(axis)
    fastest_qc_s = abs(units.to_qc_s(_velocity(axis, config, VELOCITY_HEADROOM)))
    # Where that is whole units, the last digit of a float is not to take one away.
    whole_qc_s = round(fastest_qc_s / unit_qc_s) * unit_qc_s
    if math.isclose(fastest_qc_s, whole_qc_s, rel_tol=1e-12):
        fastest_qc_s = max(fastest_qc_s, whole_qc_s)
    return FitAxis(
        unit_qc_s,
        fastest_qc_s,
        most,
        spare,
        config.least_velocity / 60 * axis.counts_per_turn,
    )


def set_point_axis(axis: AxisConfig, config: DriverConfig) -> SetPointAxis:
    """What the search for set-points has to keep, in the units that the drive is likely to have.

    A host that may be late needs longer set-points, as it needs a longer buffer. READING: without
    limits of its own an axis has those that its drive can hold.
    """
    units = AxisUnits.of(axis)
    velocity, acceleration = axis.max_velocity, axis.max_acceleration
    if velocity is None:
        velocity = units.velocity_unasked
    fastest = VELOCITY_HEADROOM * abs(units.to_qc_s(velocity))
    steepest = PROFILE_ACCELERATION_RPM_S / 60 * axis.counts_per_turn
    if acceleration is not None:
        steepest = ACCELERATION_HEADROOM * abs(units.to_qc_s(acceleration))
    velocity_unit, acceleration_unit, _ = FAMILIES[axis.drive].motion_units(units)
    return SetPointAxis(
        velocity_unit,
        acceleration_unit,
        fastest,
        steepest,
        max(FEEDING_MS, round(FEEDING_SHARE * config.buffer_time * 1e3)),
        STANDING_MS,
    )


def machine_of(config: DriverConfig) -> Machine:
    """The protocol of all axes."""
    return Machine(
        config,
        lambda axis: fit_axis(axis, config),
        lambda axis: set_point_axis(axis, config),
    )


def clock_master(config: DriverConfig) -> int | None:
    """Node id of the drive that is it; None: the host."""
    ids = (axis.node_id for axis in config.axes if axis.joint == config.sync_source)
    return next(ids, None)


def _unit_qc_s(axis: AxisConfig) -> float:
    """The unit in which the velocities of its records are told."""
    units, pvt = AxisUnits.of(axis), FAMILIES[axis.drive].pvt
    assert pvt is not None
    fastest = VELOCITY_HEADROOM * (axis.max_velocity or units.velocity_unasked)
    return pvt.velocity_unit_qc_s(units, abs(units.to_qc_s(fastest)))


def _velocity(axis: AxisConfig, config: DriverConfig, headroom: float) -> float:
    """What an axis may reach [unit/s]; without a limit what its drive can hold."""
    units = AxisUnits.of(axis)
    if axis.max_velocity is None:
        return units.velocity_unasked
    modest = axis.max_velocity <= units.velocity_unasked
    most = units.velocity_unasked if modest else units.velocity_range
    rounding = 1.5 / _rounding_s(axis, config) / abs(units.qc_per_unit)
    unit = _unit_qc_s(axis) / abs(units.qc_per_unit)
    whole = math.ceil(axis.max_velocity / unit * (1 - 1e-9)) * unit
    return min(max(axis.max_velocity * headroom + rounding, whole), most)


def _acceleration(axis: AxisConfig, config: DriverConfig, headroom: float) -> float | None:
    """Likewise [unit/s²]; None: it has no limit."""
    if axis.max_acceleration is None:
        return None
    within_s = _rounding_s(axis, config)
    rounding_qc_s2 = _unit_qc_s(axis) / within_s + 6 / within_s**2
    return axis.max_acceleration * headroom + rounding_qc_s2 / abs(AxisUnits.of(axis).qc_per_unit)


def _rounding_s(axis: AxisConfig, config: DriverConfig) -> float:
    """The time within which what rounding takes has to be made up for."""
    return min(ROUNDING_S, _SWAY * config.tolerance / _unit_qc_s(axis))
