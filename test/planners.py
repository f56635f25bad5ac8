"""Fresh trajectories from two motion planners, the way a user would publish them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import ruckig
import toppra
from numpy.typing import NDArray
from toppra.algorithm import TOPPRA
from toppra.constraint import JointAccelerationConstraint, JointVelocityConstraint
from trajectories import axes_of

from epos2_ros.configuration.driver import AxisConfig
from epos2_ros.motion.trajectory import Trajectory

Array = NDArray[np.float64]

JOINTS = 6
# A mid-size arm's: rad/s, rad/s², rad/s³ from base to wrist.
MAX_VELOCITY = np.array([2.0, 2.0, 2.5, 3.0, 3.0, 3.5])
MAX_ACCELERATION = np.array([4.0, 4.0, 6.0, 8.0, 8.0, 10.0])
MAX_JERK = 10 * MAX_ACCELERATION


def from_ruckig(
    seed: int, moves: int = 4, step_s: float = 0.01, joints: int = JOINTS
) -> Trajectory:
    """Jerk-limited, through random points: it passes all but the last moving, if slowly.

    Sampled every `step_s` with accelerations, as a controller that runs Ruckig would. More than
    six joints are several arms.
    """
    random = np.random.default_rng(seed)
    velocity, acceleration, jerk = (
        np.resize(limit, joints) for limit in (MAX_VELOCITY, MAX_ACCELERATION, MAX_JERK)
    )
    otg = ruckig.Ruckig(joints)
    state = np.array([random.uniform(-1.5, 1.5, joints), np.zeros(joints), np.zeros(joints)])
    times, states, start_s = [np.zeros(1)], [state[None]], 0.0
    for move in range(moves):
        last = move == moves - 1
        plan = ruckig.InputParameter(joints)
        plan.current_position, plan.current_velocity, plan.current_acceleration = state.tolist()
        plan.target_position = random.uniform(-1.5, 1.5, joints).tolist()
        pass_by = np.zeros(joints) if last else 0.2 * velocity * random.uniform(-1, 1, joints)
        plan.target_velocity = pass_by.tolist()
        plan.max_velocity = velocity.tolist()
        plan.max_acceleration = acceleration.tolist()
        plan.max_jerk = jerk.tolist()
        curve = ruckig.Trajectory(joints)
        if otg.calculate(plan, curve) is not ruckig.Result.Working:
            raise ValueError(f"Ruckig finds no way with seed {seed}")
        # The move's end is a point, too; a sample just before it would make a sliver.
        at = np.append(np.arange(step_s, curve.duration - step_s / 2, step_s), curve.duration)
        sampled = np.array([curve.at_time(t)[:3] for t in at])
        times.append(start_s + at)
        states.append(sampled)
        state, start_s = sampled[-1], start_s + curve.duration
    return _published(np.concatenate(times), np.concatenate(states))


def from_toppra(seed: int, points: int = 6, step_s: float = 0.1) -> Trajectory:
    """Time-optimal along a spline through random points.

    Sampled every `step_s` with accelerations; 0.1 s is what MoveIt resamples to.
    """
    random = np.random.default_rng(seed)
    knots = np.linspace(0, 1, points)
    path = toppra.SplineInterpolator(knots, random.uniform(-1.5, 1.5, (points, JOINTS)))
    constraints = [
        JointVelocityConstraint(np.column_stack((-MAX_VELOCITY, MAX_VELOCITY))),
        JointAccelerationConstraint(np.column_stack((-MAX_ACCELERATION, MAX_ACCELERATION))),
    ]
    curve = TOPPRA(constraints, path, solver_wrapper="seidel").compute_trajectory()
    if curve is None:
        raise ValueError(f"TOPP-RA finds no way with seed {seed}")
    times = np.append(np.arange(0, curve.duration - step_s / 2, step_s), curve.duration)
    return _published(times, np.stack([curve(times, order) for order in range(3)], axis=1))


def planned_axes(trajectory: Trajectory) -> tuple[AxisConfig, ...]:
    """Axes of six joints with the limits that the planners keep to."""
    return tuple(
        replace(axis, max_velocity=float(velocity), max_acceleration=float(acceleration))
        for axis, velocity, acceleration in zip(
            axes_of(trajectory.joint_names), MAX_VELOCITY, MAX_ACCELERATION, strict=True
        )
    )


def _published(times_s: Array, states: Array) -> Trajectory:
    """Points as a message holds them: nine digits, at rest at the end; states [points, 3, axes]."""
    states = np.round(states, 9)
    states[[0, -1], 1] = 0.0
    joints = tuple(f"joint_{number}" for number in range(1, states.shape[2] + 1))
    return Trajectory(joints, np.round(times_s, 9), *np.ascontiguousarray(states.swapaxes(0, 1)))
