"""What tells one maker's drives from another's, as data."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

from epos2_ros.motion.units import AxisUnits
from epos2_ros.protocol.homing_methods import Method
from epos2_ros.protocol.pdo import PdoMapping
from epos2_ros.protocol.pvt.buffer_account import BufferAccount
from epos2_ros.protocol.sdo import SdoRead, SdoWrite


class Field(NamedTuple):
    """An object in a PDO: its `struct` code, and which attribute of a `Drive` it is."""

    code: str
    name: str


@dataclass(frozen=True, eq=False)
class PvtBuffer:
    """How one maker's drives follow records: what their buffer takes, and what it says of itself.

    Every family's records make the same curve, a cubic between knots. `status` is the object that
    says what is in the buffer, here always as that number.
    """

    cycle_us: float  # of its control loop, of which a position demand is …
    free_cycles: bool  # … and which does not go by the path's clock
    velocity_unit_qc_s: Callable[[AxisUnits, float], float]  # of records; of the fastest [qc/s]
    account: Callable[[float, int], BufferAccount]  # of a motion: velocity unit, status at rest
    status: SdoRead
    describe_errors: Callable[[int], str]  # of a status that an axis can't go on with; "": none
    flags: Callable[[int, int], Mapping[str, bool]]  # by the keys of ~/buffer_status; statusword
    empty: tuple[SdoWrite, ...] = ()  # what empties it at rest, by SDO …
    remedy: Callable[[int], bytes] | None = None  # … or the next command (RPDO1) to that end
    pause_us: float = 0.0  # that a command takes


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
    pvt: PvtBuffer | None  # None: they follow no records
    has_clock: bool  # high resolution time stamp (0x1013): it can be kept in step with the others
    passes_set_points: bool = False  # "change on set-point" (bit 9): it needs not brake for each
    backs_off: bool = False  # after homing, by `homing.back_off`
    jerk_objects: tuple[tuple[int, int], ...] = ()  # that limit the jerk of a profile; none: ()
    life_guarding: bool = False  # it watches the host by 0x100C and 0x100D: it has no 0x1016
    pdos: int = 4  # each way
    referenced_bit: int = 0  # of the statusword: the axis is homed
    power_up_bit: int = 0  # of the statusword: "switched on", on its own way to "operation enabled"

    def describe_emergency(self, code: int) -> str:
        """An emergency error code in words, with the number for the manual."""
        return f"{self.emergencies.get(code, 'unknown emergency')} (0x{code:04X})"
