"""What the axes that follow trajectories are to do and do, side by side."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from epos2_ros.configuration.driver import AxisConfig
from epos2_ros.errors import TrajectoryError
from epos2_ros.motion.reference import Reference, State
from epos2_ros.motion.units import AxisUnits
from epos2_ros.protocol.execution import Execution
from epos2_ros.protocol.machine import Machine

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Tracking:
    """At one instant. Arrays are [axes] in joint units, times host µs."""

    now_us: float
    joints: tuple[str, ...]
    reference: Reference  # what is commanded …
    zero_us: float  # … when its path time is zero …
    known_us: float  # … and from when on it is what was commanded, too
    execution: Execution | None  # what they follow, or hold the end of
    state: str  # of the axes, in words
    position: Array  # measured; NaN: the drive has not said yet
    velocity: Array
    measured_us: Array

    @property
    def stamp_us(self) -> float:
        """Of the newest measurement."""
        return float(self.measured_us.max())

    @property
    def desired(self) -> State:
        """What was commanded when each axis was measured; NaN where that is not known any more."""
        t_s = (self.measured_us - self.zero_us) / 1e6
        unknown = np.where(self.measured_us < self.known_us, math.nan, 0.0)
        orders = (self.reference.evaluate(t_s, order) for order in range(3))
        return State(*(np.diagonal(values) + unknown for values in orders))

    def commanded(self, t_us: float) -> State:
        """What is commanded at a time, as far as is known now. TrajectoryError for one that is
        too long ago."""
        if t_us < self.known_us:
            raise TrajectoryError(
                f"that is {(self.now_us - t_us) / 1e6:.3f} s ago; what was commanded is known from "
                f"{(self.now_us - self.known_us) / 1e6:.3f} s ago on"
            )
        return State.of(self.reference, (t_us - self.zero_us) / 1e6)

    def time_from_start_s(self, execution: Execution) -> float:
        """How far a trajectory has come, by its own time; 0 before it begins."""
        if execution.start_ms is None:
            return 0.0
        return max(0.0, (self.stamp_us - self.zero_us) / 1e6 - execution.start_ms / 1e3)


def tracked(machine: Machine, configs: Sequence[AxisConfig], now_us: float) -> Tracking:
    """What they are doing now; `configs` are those of these axes."""
    units = [AxisUnits.of(axis) for axis in configs]
    path, feeder, drives = machine.path, machine.interpolated.feeder, machine.interpolated.drives
    axes = list(zip(units, drives, strict=True))
    reference, zero_us, known_us = feeder.reference, machine.path_time.zero_us(now_us), -math.inf
    if path.execution is None or reference is None:
        here = [unit.from_qc(float(axis.demand_qc or 0)) for unit, axis in axes]
        reference = Reference.at_rest(units, here)
    else:
        known_us = zero_us + 1000 * feeder.known_from_ms
    inhibit_us = machine.config.state_inhibit_us
    times = np.array([drive.measured_us(inhibit_us) for drive in drives])
    return Tracking(
        now_us=now_us,
        joints=tuple(drive.joint for drive in drives),
        reference=reference,
        zero_us=zero_us,
        known_us=known_us,
        execution=path.execution,
        state=machine.group.describe_phase(),
        position=np.array([_measured(unit, axis.position_qc) for unit, axis in axes]),
        velocity=np.array(
            [unit.from_qc_s(axis.velocity_now_qc_s(inhibit_us)) for unit, axis in axes]
        ),
        measured_us=np.where(np.isfinite(times), times, now_us),
    )


def _measured(units: AxisUnits, position_qc: int | None) -> float:
    return math.nan if position_qc is None else units.from_qc(float(position_qc))
