"""A Copley drive as the host sees it: its objects, its PDOs, its units of motion.

Device control and profile position mode are those of CiA 402, interpolated position mode goes by
PVT segments (`copley_pvt`). Units of velocity and acceleration
(0.1 counts/s and 10 counts/s²) are from public descriptions of Copley's CANopen objects; they are
not in Copley, "Setting outputs at position", whose objects are in `outputs/copley`.

| PDO   | COB-ID | transmission      | objects                                      |
|-------|--------|-------------------|----------------------------------------------|
| RPDO1 | 200+id | asynchronous (255)| PVT buffer data: segments and commands       |
| RPDO2 | 300+id | synchronous (1)   | controlword: takes effect at the next SYNC   |
| RPDO3 | 400+id | asynchronous (255)| high resolution time stamp                   |
| RPDO4 | 500+id | asynchronous (255)| controlword: takes effect at once            |
| TPDO1 | 180+id | event             | statusword, PVT buffer status                |
| TPDO2 | 280+id | synchronous (1)   | position actual, velocity actual             |
| TPDO3 | 380+id | synchronous (1)   | time stamp of the SYNC, position demand      |
| TPDO4 | 480+id | synchronous (1)   | statusword, PVT buffer status                |

The numbers are those of the EPOS2's PDOs with the same content. The buffer status comes as an event
when a segment is taken or an error appears, not when a segment comes in.

The maker's dictionary (its EDS of 2016) has no 0x1016: the drive watches the host by life guarding.
It has eight PDOs each way with at most four objects, and no inhibit time. Newer firmware scales all
units by the factor groups 0x608F, 0x6091 and 0x6092.
"""

from __future__ import annotations

from epos2_ros.protocol import copley_pvt, epos2, homing_methods
from epos2_ros.protocol.copley_pvt import BUFFER_STATUS, PVT_DATA
from epos2_ros.protocol.family import Family, Field, PvtBuffer
from epos2_ros.protocol.pdo import ASYNCHRONOUS, SYNCHRONOUS, PdoMapping
from epos2_ros.protocol.pvt.numbered import NumberedSegments

VENDOR_ID = 0x000000AB

TRACKING_ERROR_DISTANCE = 0x2120  # of the following error, a fault; 0x6065 only warns
LATCHED_FAULTS = 0x2183  # ones clear them
DESIRED_STATE = 0x2300
CANOPEN_MODE = 30  # of 0x2300: motion is commanded by CANopen; in others commands are ignored
ENCODER_RESOLUTION, GEAR_RATIO, FEED_CONSTANT = 0x608F, 0x6091, 0x6092
MAX_SPEED = 500_000_000  # of 0x6081 [0.1 counts/s]
FAULTS = {
    0: "memory",
    1: "A/D converter",
    2: "short circuit",
    3: "amplifier over-temperature",
    4: "motor over-temperature",
    5: "over-voltage",
    6: "under-voltage",
    7: "feedback",
    8: "phasing",
    9: "following error",
    10: "current limited",
    11: "FPGA",
    12: "command input lost",
    13: "FPGA",
    14: "safety circuit",
    15: "current can't be controlled",
}
"""Bits of 0x2183, by public descriptions of Copley's drives."""

LOOP_US = 250.0  # 4 kHz (Copley, "Setting outputs at position", "Position extrapolation")
VELOCITY_UNIT_COUNTS_S = 0.1
ACCELERATION_UNIT_COUNTS_S2 = 10.0
JERK_UNIT_COUNTS_S3 = 100.0
PROFILE_JERK = 0x2121

_STATUS = (BUFFER_STATUS.index, BUFFER_STATUS.subindex)

RPDO_MAPPINGS = (
    PdoMapping(1, epos2.RPDO1, ASYNCHRONOUS, ((PVT_DATA, 0),)),
    PdoMapping(2, epos2.RPDO2, SYNCHRONOUS, ((epos2.CONTROLWORD, 0),)),
    PdoMapping(3, epos2.RPDO3, ASYNCHRONOUS, ((epos2.HIGH_RESOLUTION_TIME_STAMP, 0),)),
    PdoMapping(4, epos2.RPDO4, ASYNCHRONOUS, ((epos2.CONTROLWORD, 0),)),
)
TPDO_MAPPINGS = (
    PdoMapping(1, epos2.TPDO1, ASYNCHRONOUS, ((epos2.STATUSWORD, 0), _STATUS)),
    PdoMapping(
        2, epos2.TPDO2, SYNCHRONOUS, ((epos2.POSITION_ACTUAL, 0), (epos2.VELOCITY_ACTUAL, 0))
    ),
    PdoMapping(
        3,
        epos2.TPDO3,
        SYNCHRONOUS,
        ((epos2.HIGH_RESOLUTION_TIME_STAMP, 0), (epos2.POSITION_DEMAND, 0)),
    ),
    PdoMapping(4, epos2.TPDO4, SYNCHRONOUS, ((epos2.STATUSWORD, 0), _STATUS)),
)
FAMILY = Family(
    key="copley",
    name="a Copley drive",
    maker="Copley",
    vendor_id=VENDOR_ID,
    eds="copley.eds",
    rpdos=RPDO_MAPPINGS,
    tpdos=TPDO_MAPPINGS,
    fields={
        (epos2.STATUSWORD, 0): Field("H", "statusword"),
        _STATUS: Field("I", "buffer_status"),
        (epos2.HIGH_RESOLUTION_TIME_STAMP, 0): Field("I", "latched"),
        (epos2.POSITION_ACTUAL, 0): Field("i", "position_qc"),
        (epos2.VELOCITY_ACTUAL, 0): Field("i", "velocity"),
        (epos2.POSITION_DEMAND, 0): Field("i", "demand_qc"),
    },
    emergencies=epos2.EMERGENCIES,
    rest_operation=epos2.MODE_INTERPOLATED_POSITION,
    motion_units=lambda units: (
        VELOCITY_UNIT_COUNTS_S,
        ACCELERATION_UNIT_COUNTS_S2,
        JERK_UNIT_COUNTS_S3,
    ),
    jerk_objects=((PROFILE_JERK, 0),),
    home_objects=homing_methods.shifted_zero,
    homing_methods=homing_methods.COPLEY,
    pvt=PvtBuffer(
        cycle_us=LOOP_US,
        free_cycles=True,
        velocity_unit_qc_s=lambda units, fastest_qc_s: copley_pvt.velocity_unit(fastest_qc_s),
        account=NumberedSegments,
        status=BUFFER_STATUS,
        describe_errors=copley_pvt.describe_errors,
        flags=copley_pvt.flags,
        remedy=copley_pvt.remedy,
        pause_us=copley_pvt.PAUSE_US,
    ),
    has_clock=True,
    life_guarding=True,
    pdos=8,
)


def describe_faults(bits: int) -> str:
    """0x2183 in words, with the number for the manual."""
    words = [word for bit, word in FAULTS.items() if bits >> bit & 1]
    return f"{', '.join(words) or 'unknown fault'} (0x{bits:08X})"
