"""The makers whose drives can be axes, by their name in `axes.<joint>.drive`."""

from __future__ import annotations

from collections.abc import Mapping

from epos2_ros.protocol import cl3e, copley, epos2
from epos2_ros.protocol.family import Family

FAMILIES: Mapping[str, Family] = {
    family.key: family for family in (epos2.FAMILY, copley.FAMILY, cl3e.FAMILY)
}
