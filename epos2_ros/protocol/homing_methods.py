"""Homing methods by name, and what each maker's drives call them (0x6098).

Methods 1 … 35 are those of CiA 402-2; negative ones are the maker's own and mean different things:
−1 is "current threshold positive and index" on an EPOS2 (maxon, EPOS2 firmware specification) and
"hard stop positive" on a Copley drive (its EDS and CANopen manual).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from epos2_ros.errors import ConfigurationError
from epos2_ros.protocol.sdo import SdoWrite

HOME_OFFSET = 0x607C


class Method(NamedTuple):
    """`direction`: which way the search goes, seen from the drive; 0: the axis does not move."""

    name: str
    direction: int


HERE = "here"
STANDARD: Mapping[int, Method] = {
    1: Method("negative_limit_switch_index", -1),
    2: Method("positive_limit_switch_index", 1),
    7: Method("home_switch_positive_index", 1),
    11: Method("home_switch_negative_index", -1),
    17: Method("negative_limit_switch", -1),
    18: Method("positive_limit_switch", 1),
    23: Method("home_switch_positive", 1),
    27: Method("home_switch_negative", -1),
    33: Method("index_negative", -1),
    34: Method("index_positive", 1),
    35: Method(HERE, 0),
}
EPOS2: Mapping[int, Method] = {
    **STANDARD,
    -1: Method("current_threshold_positive_index", 1),
    -2: Method("current_threshold_negative_index", -1),
    -3: Method("current_threshold_positive", 1),
    -4: Method("current_threshold_negative", -1),
}
COPLEY: Mapping[int, Method] = {
    **STANDARD,
    -1: Method("hard_stop_positive", 1),
    -2: Method("hard_stop_negative", -1),
    -3: Method("hard_stop_positive_index", 1),
    -4: Method("hard_stop_negative_index", -1),
}


def shifted_zero(position_qc: int, back_off_qc: int) -> tuple[SdoWrite, ...]:
    """Where 0x607C moves nothing: the home is at `position_qc`, and the axis stays about there.

    READING: zero is the home offset on from the home (CiA 402), so the home is at minus that.
    """
    return (SdoWrite.integer(HOME_OFFSET, 0, -position_qc, 4, signed=True),)


def find(method: str, methods: Mapping[int, Method], parameter: str, maker: str) -> int:
    """The number of a method by its name, or by the number in its maker's sense.

    ConfigurationError for what these drives don't have.
    """
    for number, known in methods.items():
        if method in (known.name, str(number)):
            return number
    names = ", ".join(known.name for known in methods.values())
    raise ConfigurationError(f"{parameter} is {method!r}; {maker}'s drives have {names}")
