"""Joint units (rad or m) and drive units (qc, motor rpm), one axis at a time.

The drive's position is counted in quadrature counts of the motor encoder [qc]; its
velocity unit is 10^n rpm of the motor with n the velocity notation index 0x608B; its
acceleration unit is rpm/s of the motor (maxon, application note "Interpolation Position
Mode", 3.6.3 and 3.7).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from epos2_ros.configuration.driver import AxisConfig
from epos2_ros.errors import ConfigurationError

INT32_MIN, INT32_MAX = -(2**31), 2**31 - 1
INT24_MAX = 2**23 - 1  # velocity field of an interpolation data record 0x20C1
UINT32_MAX = 2**32 - 1
FASTEST_QC_S = {"copley": INT24_MAX / 0.255}
"""By the family of the drive: the longest segment is 24 bits long, at most (Copley, 0x2010)."""
# Defaults of the drive, application note 3.7:
MAX_PROFILE_VELOCITY_RPM = 25_000  # 0x607F
PROFILE_ACCELERATION_RPM_S = 10_000  # 0x6083

Number = TypeVar("Number", float, NDArray[np.float64])


@dataclass(frozen=True)
class DriveLimits:
    """The limits of one axis as the drive's objects hold them; None leaves the drive's own."""

    min_position: int  # 0x607D-01 [qc]
    max_position: int  # 0x607D-02 [qc]
    velocity: int | None  # 0x607F, 0x6081 [10^n rpm]
    acceleration: int | None  # 0x60C5, 0x6083 [rpm/s]


@dataclass(frozen=True)
class AxisUnits:
    """The scale between a joint and its drive: qc = (position − offset)·qc_per_unit."""

    joint: str
    unit: str  # "rad" or "m"
    counts_per_turn: int  # [qc per motor turn]
    qc_per_unit: float  # signed [qc/rad or qc/m]
    offset: float = 0.0  # joint position where the drive reads 0 [unit]
    velocity_notation: int = 0  # n of 10^n rpm
    fastest_qc_s: float = math.inf  # what the records of another drive than an EPOS2 hold

    @classmethod
    def of(cls, axis: AxisConfig) -> AxisUnits:
        """Scale of a configured axis; a prismatic one needs its lead."""
        if axis.type == "prismatic":
            if axis.lead is None:
                raise ConfigurationError(
                    f"axes.{axis.joint}.lead is not set: a prismatic joint needs metres per turn"
                )
            unit, per_turn = "m", axis.lead
        else:
            unit, per_turn = "rad", 2 * math.pi
        scale = axis.direction * axis.counts_per_turn * axis.gear_ratio / per_turn
        return cls(
            axis.joint,
            unit,
            axis.counts_per_turn,
            scale,
            axis.offset,
            axis.velocity_notation,
            FASTEST_QC_S.get(axis.drive, math.inf),
        )

    def to_qc(self, position: Number) -> Number:
        """Joint position [unit] → drive position [qc], not rounded."""
        return (position - self.offset) * self.qc_per_unit

    def from_qc(self, position_qc: Number) -> Number:
        """Drive position [qc] → joint position [unit]."""
        return position_qc / self.qc_per_unit + self.offset

    def to_qc_s(self, velocity: Number) -> Number:
        """Joint velocity [unit/s] → drive velocity [qc/s]; accelerations scale alike."""
        return velocity * self.qc_per_unit

    def from_qc_s(self, velocity_qc_s: Number) -> Number:
        """Drive velocity [qc/s] → joint velocity [unit/s]; accelerations scale alike."""
        return velocity_qc_s / self.qc_per_unit

    @property
    def velocity_unit_qc_s(self) -> float:
        """One drive velocity unit (10^n rpm of the motor) [qc/s]."""
        return self.counts_per_turn / 60 * 10.0**self.velocity_notation

    def to_velocity_units(self, velocity: Number) -> Number:
        """Joint velocity [unit/s] → drive velocity units [10^n rpm], signed, not rounded."""
        return self.to_qc_s(velocity) / self.velocity_unit_qc_s

    def from_velocity_units(self, velocity_units: Number) -> Number:
        """Drive velocity units [10^n rpm] → joint velocity [unit/s]."""
        return self.from_qc_s(velocity_units * self.velocity_unit_qc_s)

    def to_rpm_s(self, acceleration: Number) -> Number:
        """Joint acceleration [unit/s²] → motor acceleration [rpm/s], signed, not rounded."""
        return acceleration * self.qc_per_unit / self.counts_per_turn * 60

    def from_rpm(self, rpm: Number) -> Number:
        """Motor speed [rpm] → joint velocity [unit/s]; [rpm/s] → [unit/s²] alike."""
        return rpm / 60 * self.counts_per_turn / self.qc_per_unit

    @property
    def position_range(self) -> tuple[float, float]:
        """Joint positions the drive's int32 can hold (min, max) [unit]."""
        ends = self.from_qc(float(INT32_MIN)), self.from_qc(float(INT32_MAX))
        return min(ends), max(ends)

    @property
    def velocity_range(self) -> float:
        """Largest joint speed a record and the drive can hold [unit/s].

        Of an EPOS2 the smaller of its 25,000 rpm and what int24 holds in its velocity unit.
        """
        if self.fastest_qc_s < math.inf:
            return abs(self.from_qc_s(self.fastest_qc_s))
        rpm = min(float(MAX_PROFILE_VELOCITY_RPM), INT24_MAX * 10.0**self.velocity_notation)
        return abs(self.from_rpm(rpm))

    @property
    def velocity_unasked(self) -> float:
        """Largest joint speed where none is configured [unit/s]: what any drive takes.

        READING: maxon's EDS has 0x607F up to 25,000 whatever the velocity unit. So a drive may take
        no more than 25,000 units, or no more than 25,000 rpm; what is asked for it may refuse.
        """
        if self.fastest_qc_s < math.inf:
            return self.velocity_range
        most_rpm = MAX_PROFILE_VELOCITY_RPM * 10.0**self.velocity_notation
        return min(self.velocity_range, abs(self.from_rpm(most_rpm)))

    def velocity_object(self, velocity: float, parameter: str = "max_velocity") -> int:
        """A speed [unit/s, > 0] for 0x607F, 0x6081, 0x6099: [10^n rpm], rounded up."""
        if velocity > self.velocity_range * (1 + 1e-9):
            raise ConfigurationError(
                f"axes.{self.joint}.{parameter}: {velocity:g} {self.unit}/s is more than "
                f"the drive can do ({self.velocity_range:g} {self.unit}/s)"
            )
        return _up(abs(self.to_velocity_units(velocity)))

    def acceleration_object(self, acceleration: float, parameter: str = "max_acceleration") -> int:
        """An acceleration [unit/s², > 0] for 0x60C5, 0x6083 … 0x6085, 0x609A: [rpm/s], up."""
        value = _up(abs(self.to_rpm_s(acceleration)))
        if value > UINT32_MAX:
            raise ConfigurationError(
                f"axes.{self.joint}.{parameter}: {acceleration:g} {self.unit}/s² is more than "
                f"the drive can hold ({abs(self.from_rpm(float(UINT32_MAX))):g} {self.unit}/s²)"
            )
        return value

    def position_object(self, position: float, parameter: str) -> int:
        """A joint position [unit] as int32 [qc], to nearest."""
        value = round(self.to_qc(position))
        if not INT32_MIN <= value <= INT32_MAX:
            low, high = self.position_range
            raise ConfigurationError(
                f"axes.{self.joint}.{parameter}: {position:g} {self.unit} is outside what the "
                f"drive can count ({low:g} … {high:g} {self.unit})"
            )
        return value


def position_limits(axis: AxisConfig, margin_qc: int = 0) -> tuple[int, int]:
    """The axis' limits for 0x607D [qc], widened by `margin_qc`."""
    units = AxisUnits.of(axis)
    ends: dict[bool, int] = {False: INT32_MIN, True: INT32_MAX}  # by "is the upper end"
    for position, name, upper in (
        (axis.min_position, "min_position", False),
        (axis.max_position, "max_position", True),
    ):
        if position is not None:
            value = units.position_object(position, name)
            upper_qc = upper == (units.qc_per_unit > 0)
            ends[upper_qc] = value + margin_qc if upper_qc else value - margin_qc
    return max(ends[False], INT32_MIN), min(ends[True], INT32_MAX)


def drive_limits(axis: AxisConfig, margin_qc: int = 0) -> DriveLimits:
    """The axis' limits for 0x607D, 0x607F/0x6081 and 0x60C5/0x6083.

    `margin_qc` widens the position limits: the executed curve may run past the
    commanded one by the tolerance, which must not be a fault when it touches a limit.
    """
    units = AxisUnits.of(axis)
    return DriveLimits(
        *position_limits(axis, margin_qc),
        None if axis.max_velocity is None else units.velocity_object(axis.max_velocity),
        None if axis.max_acceleration is None else units.acceleration_object(axis.max_acceleration),
    )


def _up(value: float) -> int:
    """Round up to a whole number ≥ 1, forgiving rounding noise."""
    return max(1, math.ceil(value * (1 - 1e-12)))
