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


def follows_records(axis: AxisConfig) -> bool:
    """Whether it follows a trajectory, by records; ConfigurationError if it was told to and can't.

    Other axes move in their drives' profile position mode only.
    """
    family = FAMILIES[axis.drive]
    if axis.trajectory == "pvt" and family.pvt is None:
        raise ConfigurationError(
            f"axes.{axis.joint}.trajectory is 'pvt'; {family.maker}'s drives have no buffer for "
            "PVT records: leave it out, or set it to profile"
        )
    return family.pvt is not None and axis.trajectory != "profile"
