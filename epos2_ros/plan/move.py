"""A move in profile position mode (`~/move_to`) as the driver would run it, and in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from epos2_ros.configuration.driver import AxisConfig, DriverConfig
from epos2_ros.motion.move import moves, target_of
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.motion.trapezoid import Trapezoid
from epos2_ros.motion.units import AxisUnits
from epos2_ros.plan.outputs import OutputPlans
from epos2_ros.protocol.families import FAMILIES

HEADINGS = ("axis", "from", "to", "velocity", "allowed", "acceleration", "allowed")


@dataclass(frozen=True)
class MovePlan:
    """The axes leave on one SYNC and arrive together."""

    axes: tuple[tuple[AxisConfig, Trapezoid], ...]  # those that take part
    outputs: OutputPlans

    @property
    def rows(self) -> list[tuple[str, ...]]:
        """The cells of the table, a row for each axis."""
        return [_row(axis, move) for axis, move in self.axes]

    @property
    def figures(self) -> list[tuple[str, str]]:
        """Name and value of what concerns all of them."""
        duration_s = max((move.duration_s for _, move in self.axes), default=0.0)
        return [("duration", f"{duration_s:.3f} s")]


def make_move_plan(
    trajectory: Trajectory, config: DriverConfig, start: Sequence[float]
) -> MovePlan:
    """What the driver would do with the one point of `trajectory` when its joints stand at
    `start` [unit]. Raises what the driver raises."""
    axes = {axis.joint: axis for axis in config.axes}
    standing = {
        joint: round(AxisUnits.of(axes[joint]).to_qc(position))
        for joint, position in zip(trajectory.joint_names, start, strict=True)
    }
    found = moves(list(axes.values()), standing, *target_of(trajectory))
    together = {
        joint: move.in_units(*FAMILIES[axes[joint].drive].motion_units(AxisUnits.of(axes[joint])))
        for joint, move in found.items()
    }
    return MovePlan(
        tuple((axes[joint], move) for joint, move in together.items()),
        OutputPlans.of(config, {joint: [move.path(0.0)] for joint, move in together.items()}),
    )


def _row(axis: AxisConfig, move: Trapezoid) -> tuple[str, ...]:
    units = AxisUnits.of(axis)
    peak = move.peak if move.end != move.start else 0.0
    return (
        f"{axis.joint} [{units.unit}]",
        f"{units.from_qc(move.start):.5f}",
        f"{units.from_qc(move.end):.5f}",
        f"{abs(units.from_qc_s(peak)):.4f}",
        f"{axis.max_velocity:.4g}",
        f"{abs(units.from_qc_s(move.acceleration)):.3f}",
        f"{axis.max_acceleration:.4g}",
    )
