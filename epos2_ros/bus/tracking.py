"""What the axes that follow trajectories are to do and do, side by side."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from epos2_ros.configuration.driver import AxisConfig
from epos2_ros.errors import TrajectoryError
from epos2_ros.motion.reference import Reference, State
from epos2_ros.motion.units import AxisUnits
from epos2_ros.protocol.drive import Drive
from epos2_ros.protocol.execution import Execution
from epos2_ros.protocol.machine import Machine
from epos2_ros.protocol.whereabouts import AxisNow, Whereabouts

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
    position: Array  # where they are, by what they say at SYNC; NaN: they have not said yet
    velocity: Array
    measured_us: Array  # when they are there: now, or when a drive was last heard
    reported_us: Array  # when each drive last said where its axis is

    @property
    def stamp_us(self) -> float:
        """Of the newest position."""
        return float(self.measured_us.max())

    @property
    def desired(self) -> State:
        """What is commanded when each axis is there; NaN where that is not known any more."""
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


def tracked(
    machine: Machine, configs: Sequence[AxisConfig], whereabouts: Whereabouts, now_us: float
) -> Tracking:
    """What they are doing now; `configs` are those of these axes, `whereabouts` of all."""
    units = [AxisUnits.of(axis) for axis in configs]
    path, followers = machine.path, machine.followers
    drives = followers.drives
    axes = list(zip(units, drives, strict=True))
    reference, zero_us, known_us = followers.reference, machine.path_time.zero_us(now_us), -math.inf
    if path.execution is None or reference is None:
        here = [unit.from_qc(float(axis.demand_qc or 0)) for unit, axis in axes]
        reference = Reference.at_rest(units, here)
    else:
        known_us = zero_us + 1000 * followers.known_from_ms
    heard = {machine.drives[axis.place]: axis for axis in whereabouts.at(now_us)}
    places = [_place(drive, heard.get(drive), now_us) for drive in drives]
    return Tracking(
        now_us=now_us,
        joints=tuple(drive.joint for drive in drives),
        reference=reference,
        zero_us=zero_us,
        known_us=known_us,
        execution=path.execution,
        state=machine.group.describe_phase(),
        position=np.array([u.from_qc(p.qc) for u, p in zip(units, places, strict=True)]),
        velocity=np.array([u.from_qc_s(p.qc_s) for u, p in zip(units, places, strict=True)]),
        measured_us=np.array([place.t_us for place in places]),
        reported_us=np.array([drive.sample_us for drive in drives]),
    )


class _Place(NamedTuple):
    t_us: float
    qc: float
    qc_s: float


def _place(drive: Drive, heard: AxisNow | None, now_us: float) -> _Place:
    """Where an axis is, or was when its drive was last heard."""
    if heard is not None:
        return _Place(now_us, heard.position_qc, heard.velocity_qc_s)
    if drive.position_qc is None:
        return _Place(now_us, math.nan, 0.0)
    return _Place(drive.sample_us, float(drive.position_qc), drive.velocity_qc_s)
