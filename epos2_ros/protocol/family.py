"""What tells one maker's drives from another's, as data."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

from epos2_ros.motion.units import AxisUnits
from epos2_ros.protocol.homing_methods import Method
from epos2_ros.protocol.pdo import PdoMapping
from epos2_ros.protocol.sdo import SdoWrite


class Field(NamedTuple):
    """An object in a PDO: its `struct` code, and which attribute of a `Drive` it is."""

    code: str
    name: str


@dataclass(frozen=True, eq=False)
class Family:
    """One maker's drives.

    `rest_operation`: the mode of operation (0x6060) in which they stand, ready for a trajectory or
    a move. `fields`: the objects that can come in PDOs.
    """

    key: str  # as in `axes.<joint>.drive`
    name: str  # with its article
    maker: str
    vendor_id: int
    eds: str  # in epos2_ros/eds
    rpdos: tuple[PdoMapping, ...]
    tpdos: tuple[PdoMapping, ...]
    fields: Mapping[tuple[int, int], Field]
    emergencies: Mapping[int, str]
    rest_operation: int
    motion_units: Callable[[AxisUnits], tuple[float, float, float]]  # [qc/s], [qc/s²], [qc/s³]
    home_objects: Callable[[int, int], tuple[SdoWrite, ...]]  # of position and back-off [qc]
    homing_methods: Mapping[int, Method]  # 0x6098
    has_clock: bool  # high resolution time stamp (0x1013): it can be kept in step with the others
    backs_off: bool = False  # after homing, by `homing.back_off`
    jerk_objects: tuple[tuple[int, int], ...] = ()  # that limit the jerk of a profile; none: ()
    life_guarding: bool = False  # it watches the host by 0x100C and 0x100D: it has no 0x1016
    pdos: int = 4  # each way
    referenced_bit: int = 0  # of the statusword: the axis is homed
    velocity_step_qc_s: float = 0.0  # in which it tells its velocity
    power_up_bit: int = 0  # of the statusword: "switched on", on its own way to "operation enabled"

    def describe_emergency(self, code: int) -> str:
        """An emergency error code in words, with the number for the manual."""
        return f"{self.emergencies.get(code, 'unknown emergency')} (0x{code:04X})"
