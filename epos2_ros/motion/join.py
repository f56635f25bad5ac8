"""A new trajectory takes over from what the axes are doing, at one common instant."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from epos2_ros.errors import TrajectoryError
from epos2_ros.motion.bounded import bounded
from epos2_ros.motion.curve import Curve
from epos2_ros.motion.limits import MARGINS, Limits, check
from epos2_ros.motion.pace import paced
from epos2_ros.motion.reference import Reference, State
from epos2_ros.motion.stream import Operator, Stream, is_streamed
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.motion.transition import GRACE_S, cross, resting_place

Array = NDArray[np.float64]

# Curves this near to each other need no crossing from one to the other.
_SAME_QC, _SAME_QC_S = 1e-4, 1e-3
_INSTANT_S = 1e-6  # times this near to each other are one


def join(
    current: Reference,
    trajectory: Trajectory,
    limits: Limits,
    *,
    at_ms: int,
    start_ms: int,
    start_tolerance: float = np.inf,
    allow_partial: bool = False,
) -> Reference:
    """`current` until the take-over, then onto `trajectory` and along it to rest.

    The take-over is at path time `at_ms`, or at `start_ms` if that is later: the path time
    of the trajectory's own zero. If that is earlier, the trajectory is joined where it
    would be. If its first point has a time_from_start that is still to come, the way there
    starts from the state the axes are in. Joints it does not name come to rest and hold.
    Starting from rest, the first point may be `start_tolerance` [unit] away; a difference that
    is none in whole counts is left to the tolerance of the records.

    A trajectory that goes beyond limits within MARGINS, whatever curve joins its points, is
    followed; the `remark` of the reference says where. Raises TrajectoryError; `current` is then
    still valid.
    """
    axes = trajectory.axes(limits.joints, allow_partial)
    at_ms = max(at_ms, start_ms)
    at_s, start_s = at_ms / 1000, start_ms / 1000
    state = current.state(at_ms)
    streamed = is_streamed(trajectory)
    comes_at_once = at_ms <= start_ms and trajectory.times_s[0] <= _INSTANT_S
    if current.rests(at_ms) and comes_at_once and (not streamed or len(trajectory.times_s) == 1):
        _check_start(trajectory, axes, state, limits, start_tolerance)
    if streamed:
        due_s = start_s + trajectory.duration_s
        asked_s = trajectory.duration_s if len(trajectory.times_s) == 1 else 0.0
        point = trajectory.positions[-1]
        return current.followed_by(
            _stream(current, point, axes, state, limits, at_ms, due_s, asked_s, start_tolerance),
            at_ms,
        )
    trajectory.check_rest()
    curve = _placed(trajectory, axes, state, limits, at_s, start_s)
    remark = check(curve, limits, start_s, (0, np.inf, np.inf))
    if remark:
        if curve.velocities is None:
            curve = paced(curve, limits)
        curve = bounded(curve, limits)
        remark = check(curve, limits, start_s, MARGINS)
    same = partial(_same, current, state, current.rests(at_ms))
    return current.followed_by(cross(curve, state, limits, at_s, same), at_ms, remark)


def _placed(
    trajectory: Trajectory,
    axes: Sequence[int],
    state: State,
    limits: Limits,
    at_s: float,
    start_s: float,
) -> Curve:
    """The trajectory as a curve of all axes over path time."""
    held = resting_place(state, limits)
    still = np.zeros_like(held)
    named = np.isin(np.arange(len(held)), axes)
    in_order = list(axes) == list(range(len(held)))
    times_s = trajectory.times_s + start_s
    comes = times_s[0] > at_s + _INSTANT_S
    if not comes:
        times_s[0] = min(times_s[0], at_s)

    def columns(values: Array, start: Array, others: Array) -> Array:
        """Values of all axes at the points, with the present state before them if needed."""
        if in_order:
            full = values
        else:
            full = np.tile(others, (len(values), 1))
            full[:, axes] = values
        return np.vstack((np.where(named, start, others), full)) if comes else full

    velocities = accelerations = None
    if trajectory.velocities is not None:
        velocities = columns(trajectory.velocities, state.velocity, still)
        if trajectory.accelerations is not None:
            accelerations = columns(trajectory.accelerations, state.acceleration, still)
    return Curve(
        np.concatenate(([at_s], times_s)) if comes else times_s,
        columns(trajectory.positions, state.position, held),
        velocities,
        accelerations,
        np.where(named, state.velocity, 0.0) if comes and velocities is None else None,
    )


def _stream(
    current: Reference,
    point: Array,
    axes: Sequence[int],
    state: State,
    limits: Limits,
    at_ms: int,
    due_s: float,
    asked_s: float,
    near: float,
) -> Stream:
    """On to a streamed point: a further step, or a transition where that is not possible."""
    at_s = at_ms / 1000
    going_on = current.governs(at_ms)
    stream = None
    if current.rests(at_ms):
        stream = Stream.after(Curve.resting(state.position))
    elif isinstance(going_on, Stream):
        stream = going_on
    target = resting_place(state, limits) if stream is None else stream.target.copy()
    target[axes] = point
    rest = Curve.resting(target)
    check(rest, limits)
    sent_s = due_s - asked_s
    if stream is None:
        operator = Operator.of(target[None, :], np.array([sent_s]))
    else:
        operator = stream.operator.sends(
            target, stream.target, state.position, limits, sent_s, asked_s
        )
        going = stream.to(target, operator, limits, at_s, due_s, near)
        if going:
            return going
    same = partial(_same, current, state, False)
    soonest_s, grace_s = max(due_s - at_s, 0.0), GRACE_S + _unhurried_s(rest, state, limits)
    return Stream.after(cross(rest, state, limits, at_s, same, soonest_s, grace_s), operator)


def _unhurried_s(rest: Curve, state: State, limits: Limits) -> float:
    """Enough for every axis to brake, to turn back and to brake again."""
    brake_s = 1.5 * np.abs(state.velocity) / limits.agility
    away = np.abs(rest.positions[0] - state.position) + brake_s * np.abs(state.velocity)
    back_s = 4 * np.sqrt(away / limits.agility) + 2 * away / limits.velocity
    return float(np.max(brake_s + back_s))


def _check_start(
    trajectory: Trajectory, axes: Sequence[int], state: State, limits: Limits, tolerance: float
) -> None:
    away = np.abs(trajectory.positions[0] - state.position[axes])
    worst = int(np.argmax(away))
    if away[worst] > tolerance:
        joint = axes[worst]
        raise TrajectoryError(
            f"joint '{limits.joints[joint]}', point 0: {trajectory.positions[0, worst]:.6g} "
            f"{limits.units[joint]} is {away[worst]:.4g} {limits.units[joint]} away from where "
            f"it is, allowed {tolerance:g} (constraints.start_tolerance)"
        )


def _same(current: Reference, state: State, at_rest: bool, there: State) -> NDArray[np.bool_]:
    """Which axes are `there` already; where one stands is known in whole counts of its drive."""
    position, target = (
        np.array([units.to_qc(x) for units, x in zip(current.units, at, strict=True)])
        for at in (state.position.tolist(), there.position.tolist())
    )
    near = np.abs(position - target) <= _SAME_QC
    if at_rest:
        near |= np.floor(position + 0.5) == np.floor(target + 0.5)
    scale = np.array([abs(units.qc_per_unit) for units in current.units])
    steady: NDArray[np.bool_] = scale * np.abs(state.velocity - there.velocity) <= _SAME_QC_S
    return near & steady
