"""What the tables are about: the example trajectories, and fresh ones from two planners."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from planners import from_ruckig, from_toppra

from epos2_ros.bus.settings import fit_axis
from epos2_ros.configuration.driver import AxisConfig, DriverConfig
from epos2_ros.configuration.files import (
    read_parameters,
    read_trajectory,
    share,
    shipped_parameters,
)
from epos2_ros.configuration.parameters import DriverParameters
from epos2_ros.motion.fit import Fitter
from epos2_ros.motion.join import join
from epos2_ros.motion.limits import Limits
from epos2_ros.motion.record import MAX_SEGMENT_MS, Record
from epos2_ros.motion.reference import Reference
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.motion.units import AxisUnits

Array = NDArray[np.float64]

EXAMPLES = ("pick_place", "jerk_limited", "positions_only", "raster_scan")
SMOOTHNESS = DriverConfig(()).smoothness
GEAR_RATIO = 100.0  # of planned trajectories' axes, as in config/arm.yaml


@dataclass(frozen=True)
class Case:
    """A trajectory and the axes that run it from rest, as the driver would."""

    name: str
    trajectory: Trajectory
    configs: tuple[AxisConfig, ...]

    @cached_property
    def units(self) -> tuple[AxisUnits, ...]:
        return tuple(AxisUnits.of(axis) for axis in self.configs)

    @cached_property
    def start_qc(self) -> list[int]:
        """Where the drives stand; whole counts."""
        places = zip(self.units, self.trajectory.positions[0].tolist(), strict=True)
        return [round(units.to_qc(place)) for units, place in places]

    @cached_property
    def limits(self) -> Limits:
        return Limits.of(self.configs)

    @cached_property
    def rest(self) -> Reference:
        """The drives stand."""
        stand = zip(self.units, self.start_qc, strict=True)
        return Reference.at_rest(self.units, [units.from_qc(float(qc)) for units, qc in stand])

    @cached_property
    def reference(self) -> Reference:
        return self.joined()

    def joined(self) -> Reference:
        """From where the drives stand onto the trajectory and along it."""
        return join(self.rest, self.trajectory, self.limits, at_ms=0, start_ms=0)

    @property
    def seconds(self) -> float:
        return self.reference.end_ms / 1000

    @cached_property
    def curves(self) -> list[tuple[Array, Array, float]]:
        """Per axis the commanded position [qc] and velocity [qc/s] at k = 0 … end [ms], and the
        drive's velocity unit [qc/s]."""
        k = np.arange(self.reference.end_ms + 1)
        positions, velocities = self.reference.positions(k).T, self.reference.velocities(k).T
        units = [units.velocity_unit_qc_s for units in self.units]
        return list(zip(positions, velocities, units, strict=True))

    def records(self, tolerance_qc: float, smoothness: float = SMOOTHNESS) -> list[list[Record]]:
        """What the driver sends to each axis, the record that ends the motion included."""
        return fit(self.fitter(tolerance_qc, smoothness), self.reference, self.start_qc)

    def fitter(self, tolerance_qc: float, smoothness: float = SMOOTHNESS) -> Fitter:
        config = DriverConfig(self.configs, tolerance=tolerance_qc)
        fits = [fit_axis(axis, config) for axis in self.configs]
        return Fitter(fits, tolerance_qc, MAX_SEGMENT_MS, smoothness=smoothness)


def fit(
    fitter: Fitter, reference: Reference, start_qc: Sequence[int], until_ms: float = math.inf
) -> list[list[Record]]:
    """The records of a motion, the axes served in the order in which theirs run out."""
    fitter.begin(reference, start_qc)
    records: list[list[Record]] = [[] for _ in start_qc]
    active = set(range(len(start_qc)))
    while active:
        axis = min(active, key=fitter.committed_ms)
        record = fitter.next(axis) if fitter.committed_ms(axis) < until_ms else None
        if record is None:
            active.remove(axis)
        else:
            records[axis].append(record)
    return records


def example(name: str) -> Case:
    """One of examples/*.yaml, on the axes of the shipped parameter file with its joints."""
    trajectory = read_trajectory(share() / "examples" / f"{name}.yaml")
    file = shipped_parameters(trajectory.joint_names)
    if file is None:
        raise ValueError(f"no parameters are shipped for the joints of {name}")
    by_joint = {axis.joint: axis for axis in DriverParameters(read_parameters(file)).config().axes}
    return Case(name, trajectory, tuple(by_joint[joint] for joint in trajectory.joint_names))


def planned(name: str, trajectory: Trajectory) -> Case:
    axes = (
        AxisConfig(joint, node_id, gear_ratio=GEAR_RATIO)
        for node_id, joint in enumerate(trajectory.joint_names, start=1)
    )
    return Case(name, trajectory, tuple(axes))


def all_cases(seeds: Sequence[int]) -> list[Case]:
    return [
        *map(example, EXAMPLES),
        *(planned(f"Ruckig, seed {seed}", from_ruckig(seed)) for seed in seeds),
        *(planned(f"TOPP-RA, seed {seed}", from_toppra(seed)) for seed in seeds),
    ]
