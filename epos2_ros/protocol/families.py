"""The makers whose drives can be axes, by their name in `axes.<joint>.drive`."""

from __future__ import annotations

from collections.abc import Mapping

from epos2_ros.configuration.driver import AxisConfig
from epos2_ros.errors import ConfigurationError
from epos2_ros.protocol import cl3e, copley, epos2
from epos2_ros.protocol.family import Family

FAMILIES: Mapping[str, Family] = {
    family.key: family for family in (epos2.FAMILY, copley.FAMILY, cl3e.FAMILY)
}


PVT, SET_POINTS, PROFILE = "pvt", "setpoints", "profile"  # `axes.<joint>.trajectory`


def follows_by(axis: AxisConfig) -> str:
    """How it follows a trajectory, PVT or SET_POINTS; PROFILE: it moves from point to point only.

    ConfigurationError if it was told to follow in a way that its family can't.
    """
    family, told = FAMILIES[axis.drive], axis.trajectory
    if told == PVT and family.pvt is None:
        raise ConfigurationError(
            f"axes.{axis.joint}.trajectory is 'pvt'; {family.maker}'s drives have no buffer for "
            "PVT records: leave it out, or set it to setpoints or profile"
        )
    if told == SET_POINTS and not family.passes_set_points:
        raise ConfigurationError(
            f"axes.{axis.joint}.trajectory is 'setpoints'; {family.maker}'s drives can't pass a "
            "set-point without braking: leave it out, or set it to pvt or profile"
        )
    best = PVT if family.pvt is not None else SET_POINTS if family.passes_set_points else PROFILE
    return told or best


def follows_records(axis: AxisConfig) -> bool:
    """Whether it follows trajectories by records."""
    return follows_by(axis) == PVT
