"""Point-to-point moves of several joints in their drives' profile position mode, in step."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from epos2_ros.configuration.driver import AxisConfig
from epos2_ros.errors import TrajectoryError
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.motion.trapezoid import Trapezoid, in_step
from epos2_ros.motion.units import AxisUnits

_MAKERS = {"epos2": "maxon", "copley": "Copley", "cl3e": "Nanotec"}


def target_of(message: Trajectory) -> tuple[dict[str, float], float]:
    """Where a message for `~/move_to` sends its joints [unit], and in what time [s] (0: as fast as
    they can). TrajectoryError if it is none."""
    if len(message.times_s) != 1:
        raise TrajectoryError(f"{len(message.times_s)} points; a move has one, its target")
    targets = dict(zip(message.joint_names, message.positions[0].tolist(), strict=True))
    return targets, float(message.times_s[0])


def moves(
    axes: Sequence[AxisConfig],
    standing_qc: Mapping[str, int | None],
    targets: Mapping[str, float],
    duration_s: float = 0.0,
) -> dict[str, Trapezoid]:
    """By joint, the move [counts] from where it stands to its target [unit].

    As fast as the slowest joint can, or in `duration_s` if that is longer. TrajectoryError for a
    joint that is not one of `axes`, has no limits, has not said where it stands (None), or a
    target outside its limits.
    """
    by_joint = {axis.joint: axis for axis in axes}
    found: dict[str, Trapezoid] = {}
    for joint, target in targets.items():
        if joint not in by_joint:
            raise TrajectoryError(
                f"unknown joint '{joint}'; the joints are {', '.join(by_joint)}",
                TrajectoryError.INVALID_JOINTS,
            )
        found[joint] = _move(by_joint[joint], standing_qc[joint], target)
    return dict(zip(found, in_step(list(found.values()), duration_s), strict=True))


def refuse_trajectory(axes: Sequence[AxisConfig], joints: Sequence[str]) -> None:
    """TrajectoryError if one of `joints` is among `axes`, which follow no trajectory."""
    for axis in axes:
        if axis.joint in joints:
            chosen = f" (axes.{axis.joint}.trajectory)" if axis.trajectory else ""
            raise TrajectoryError(
                f"joint '{axis.joint}' can't follow a trajectory: its {_MAKERS[axis.drive]} drive "
                f"moves in profile position mode, by ~/move_to{chosen}",
                TrajectoryError.INVALID_JOINTS,
            )


def _move(axis: AxisConfig, standing_qc: int | None, target: float) -> Trapezoid:
    units = AxisUnits.of(axis)
    low, high = units.position_range
    low = low if axis.min_position is None else max(low, axis.min_position)
    high = high if axis.max_position is None else min(high, axis.max_position)
    if not low <= target <= high:
        raise TrajectoryError(
            f"joint '{axis.joint}': position {target:g} {units.unit} is outside its limits "
            f"{low:g} … {high:g} {units.unit}"
        )
    missing = "max_velocity" if axis.max_velocity is None else "max_acceleration"
    if axis.max_velocity is None or axis.max_acceleration is None:
        raise TrajectoryError(
            f"axes.{axis.joint}.{missing} is not set; a move in profile position mode needs it"
        )
    if standing_qc is None:
        raise TrajectoryError(f"joint '{axis.joint}': its drive has not said where it stands")
    return Trapezoid(
        float(standing_qc),
        units.to_qc(target),
        abs(units.to_qc_s(axis.max_velocity)),
        abs(units.to_qc_s(axis.max_acceleration)),
        math.inf if axis.max_jerk is None else abs(units.to_qc_s(axis.max_jerk)),
    )
