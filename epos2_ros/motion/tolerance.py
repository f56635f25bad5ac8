"""How far the axes may be from a trajectory: the tolerances of an action goal, and their judge.

The rules are those of joint_trajectory_controller and of control_msgs/FollowJointTrajectory. A
tolerance of the goal that is positive holds, 0 stands for the parameter, -1 for none; any other
negative number, or a joint that is not there, is a mistake, and then the parameters hold for all.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from epos2_ros.configuration.driver import AxisConfig
from epos2_ros.motion.reference import State
from epos2_ros.motion.units import AxisUnits

Array = NDArray[np.float64]

NONE = -1.0  # in a goal: no tolerance, whatever the parameters say


class JointTolerance(NamedTuple):
    """As control_msgs/JointTolerance: joint units, [unit/s] and [unit/s²]."""

    name: str
    position: float
    velocity: float = 0.0
    acceleration: float = 0.0


@dataclass(frozen=True, eq=False)
class Bounds:
    """Largest errors of position [unit] and velocity [unit/s]; each [axes], inf: any."""

    joints: tuple[str, ...]
    units: tuple[str, ...]
    field: str  # of the goal: path_tolerance or goal_tolerance
    parameter: str  # constraints.<joint>. …: trajectory or goal
    position: Array
    velocity: Array
    given: NDArray[np.bool_]  # [2, axes], position and velocity: by the goal, not a parameter

    @classmethod
    def of(cls, axes: Sequence[AxisConfig], field: str, parameter: str) -> Bounds:
        """What the parameters say."""
        position = [getattr(axis, field) or math.inf for axis in axes]
        return cls(
            tuple(axis.joint for axis in axes),
            tuple(AxisUnits.of(axis).unit for axis in axes),
            field,
            parameter,
            np.array(position, dtype=np.float64),
            np.full(len(axes), np.inf),
            np.zeros((2, len(axes)), dtype=np.bool_),
        )

    def overridden(self, tolerances: Sequence[JointTolerance]) -> Bounds:
        """With what a goal asks for; ValueError says what it can't ask for."""
        limits, given = np.array([self.position, self.velocity]), self.given.copy()
        for wanted in tolerances:
            if wanted.name not in self.joints:
                raise ValueError(f"{self.field}: there is no joint '{wanted.name}'")
            axis = self.joints.index(wanted.name)
            for row, quantity in enumerate(("position", "velocity", "acceleration")):
                value = getattr(wanted, quantity)
                if value == 0:
                    continue
                if not (value > 0 or value == NONE):
                    raise ValueError(
                        f"{self.field} of joint '{wanted.name}': {quantity} is {value:g}; it must "
                        "be positive, 0 for the parameter or -1 for none"
                    )
                if row < len(limits):  # no drive measures its acceleration
                    limits[row, axis] = math.inf if value == NONE else value
                    given[row, axis] = True
        return replace(self, position=limits[0], velocity=limits[1], given=given)

    @property
    def any(self) -> bool:
        """Whether anything is bounded."""
        return bool(np.isfinite([self.position, self.velocity]).any())

    def violation(self, desired: State, position: Array, velocity: Array) -> str:
        """The worst of what is too far from where it should be, in words, or "".

        `position` and `velocity` are measured, [axes] in joint units. What a drive has not
        measured (NaN) is not too far.
        """
        limits = np.array([self.position, self.velocity])
        errors = np.abs([position - desired.position, velocity - desired.velocity])
        with np.errstate(invalid="ignore"):
            beyond = np.nan_to_num(errors / limits, nan=0.0)
        row, axis = np.unravel_index(np.argmax(beyond), beyond.shape)
        if not errors[row, axis] > limits[row, axis]:
            return ""
        joint, unit = self.joints[axis], self.units[axis] + ("/s" if row else "")
        measured, should = ((position, desired.position), (velocity, desired.velocity))[row]
        source = self.field if self.given[row, axis] else f"constraints.{joint}.{self.parameter}"
        return (
            f"joint '{joint}': {'velocity' if row else 'position'} {measured[axis]:.6g} {unit} is "
            f"{errors[row, axis]:.4g} {unit} away from {should[axis]:.6g}, allowed "
            f"{limits[row, axis]:g} ({source})"
        )


@dataclass(frozen=True, eq=False)
class Tolerances:
    """Of one goal: along its path, at its end, and how long after its end [s]."""

    path: Bounds
    goal: Bounds
    goal_time_s: float

    @classmethod
    def of(cls, axes: Sequence[AxisConfig], goal_time_s: float) -> Tolerances:
        """What the parameters say; a goal time of 0 is no limit."""
        return cls(
            Bounds.of(axes, "path_tolerance", "trajectory"),
            Bounds.of(axes, "goal_tolerance", "goal"),
            goal_time_s or math.inf,
        )

    def overridden(
        self,
        path: Sequence[JointTolerance],
        goal: Sequence[JointTolerance],
        goal_time_s: float,
    ) -> tuple[Tolerances, str]:
        """With what a goal asks for, and a warning: "", or what is wrong with it; nothing of it
        holds then."""
        try:
            if goal_time_s < 0 and goal_time_s != NONE:
                raise ValueError(
                    f"goal_time_tolerance is {goal_time_s:g} s; it must be positive, 0 for the "
                    "parameter or -1 for none"
                )
            result = Tolerances(
                self.path.overridden(path),
                self.goal.overridden(goal),
                math.inf if goal_time_s == NONE else goal_time_s or self.goal_time_s,
            )
        except ValueError as mistake:
            return self, f"{mistake}; all tolerances are those of the parameters"
        ignored = any(wanted.acceleration > 0 for wanted in (*path, *goal))
        warning = "no drive measures acceleration: its tolerance is not watched"
        return result, warning if ignored else ""
