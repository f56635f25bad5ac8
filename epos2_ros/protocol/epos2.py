"""The EPOS2 as the host sees it: its objects, its PDOs, its emergencies.

Object names, types and bits: maxon, application note "Interpolation Position Mode", 3.3 – 3.6;
velocity and acceleration errors are bits 10 and 11 of 0x20C4-01 (table 13 repeats 2 and 3, the
warnings), and quick stop deceleration is 0x6085 (table 17 prints 0x6084, profile deceleration).

PDOs (note, 3.7 and "Motion Synchronisation"). Identifiers are the predefined connection set.

| PDO   | COB-ID  | transmission       | objects                                            |
|-------|---------|--------------------|----------------------------------------------------|
| RPDO1 | 200+id  | asynchronous (255) | interpolation data record                          |
| RPDO2 | 300+id  | synchronous (1)    | controlword: takes effect at the next SYNC         |
| RPDO3 | 400+id  | asynchronous (255) | high resolution time stamp                         |
| RPDO4 | 500+id  | asynchronous (255) | controlword: takes effect at once                  |
| TPDO1 | 180+id  | event, inhibited   | statusword, buffer status                          |
| TPDO2 | 280+id  | event, inhibited   | position actual, buffer status, average current    |
| TPDO4 | 480+id  | synchronous (1)    | position demand, statusword, following error       |

TPDO4 repeats the statusword at every SYNC, so that a lost event is made good within one SYNC
period, and says where the axis was at it, as long as the drive controls its position: at the
demand, less the following error. TPDO2 says where it is besides, and makes good a lost buffer
status within its inhibit time, which is long: what it has changes all the time in motion. (By the
maker's dictionaries a synchronous TPDO comes at each SYNC or not at all.)

Two objects are read by SDO that the note maps into transmit PDOs: how many records are free
(0x60C4-02), which by the maker's own EDS can't be mapped, and what the drive's clock was at the
last SYNC (0x1013), which by those of 2011 and 2013 can be mapped for reception only.

With a drive as clock master ("Motion Synchronisation") the host sends no time stamps: TPDO3 of the
master, synchronous, carries the time stamp and nothing else, and RPDO3 of the others is on its
COB-ID. So the master has to be a drive that does map 0x1013 for transmission.
"""

from __future__ import annotations

import math
import struct

from epos2_ros.protocol import homing_methods
from epos2_ros.protocol.family import Family, Field, PvtBuffer
from epos2_ros.protocol.pdo import ASYNCHRONOUS, SYNCHRONOUS, PdoMapping
from epos2_ros.protocol.pvt.counted import CountedRecords
from epos2_ros.protocol.sdo import SdoRead, SdoWrite

VENDOR_ID = 0x000000FB
DEVICE_PROFILE = 402
BUFFER_SIZE = 64
MODE_INTERPOLATED_POSITION = 7
FIRST_SOFTWARE = 0x2101  # that has it
QUICK_STOP_OPTION = 3  # of 0x6007

# Controlword and statusword bits of the interpolated position mode (tables 7 and 10).
ENABLE_IP_MODE = 0x0010
IP_MODE_ACTIVE_STATUSWORD = 0x1000
REFERENCED = 0x8000  # maxon's own: the axis is homed
REFRESH_CYCLE = 0x4000  # maxon's own: 4123h refreshes the power stage, 4133h measures the motor

# Object dictionary.
DEVICE_TYPE = 0x1000
ERROR_REGISTER = 0x1001
COB_ID_SYNC = 0x1005
COMMUNICATION_CYCLE_PERIOD = 0x1006
GUARD_TIME = 0x100C
LIFE_TIME_FACTOR = 0x100D
CONSUMER_HEARTBEAT_TIME = 0x1016
PRODUCER_HEARTBEAT_TIME = 0x1017
IDENTITY = 0x1018
REVISION_SUBINDEX = 3
HIGH_RESOLUTION_TIME_STAMP = 0x1013
VERSION = 0x2003  # -01 software, -02 hardware
INTERPOLATION_DATA_RECORD = 0x20C1
INTERPOLATION_STATUS = 0x20C4
FOLLOWING_ERROR_ACTUAL = 0x20F4
ABORT_CONNECTION_OPTION = 0x6007
CONTROLWORD = 0x6040
STATUSWORD = 0x6041
MODES_OF_OPERATION = 0x6060
MODES_OF_OPERATION_DISPLAY = 0x6061
POSITION_DEMAND = 0x6062
TARGET_POSITION = 0x607A
POSITION_ACTUAL = 0x6064
MAX_FOLLOWING_ERROR = 0x6065
VELOCITY_ACTUAL = 0x606C
CURRENT_AVERAGED = 0x2027  # of 0x6078, which follows every spike
SOFTWARE_POSITION_LIMIT = 0x607D
MAX_PROFILE_VELOCITY = 0x607F
PROFILE_VELOCITY = 0x6081
MOTION_PROFILE_TYPE = 0x6086
HOMING_METHOD = 0x6098
HOMING_SPEEDS = 0x6099  # -01 to the switch, -02 to zero
HOMING_ACCELERATION = 0x609A
HOME_OFFSET = 0x607C  # on an EPOS2 it moves the axis
HOME_POSITION = 0x2081  # what the position then is
PROFILE_ACCELERATION = 0x6083
PROFILE_DECELERATION = 0x6084
QUICK_STOP_DECELERATION = 0x6085
VELOCITY_NOTATION_INDEX = 0x608B
INTERPOLATION_SUB_MODE = 0x60C0
INTERPOLATION_TIME_PERIOD = 0x60C2
INTERPOLATION_DATA_CONFIGURATION = 0x60C4
ACTUAL_BUFFER_SUBINDEX = 2  # free records
BUFFER_CLEAR_SUBINDEX = 6
MAX_ACCELERATION = 0x60C5

# COB-IDs.
NMT = 0x000
SYNC = 0x080
EMCY = 0x080  # + node id
TIME = 0x100
TPDO1, TPDO2, TPDO3, TPDO4 = 0x180, 0x280, 0x380, 0x480
RPDO1, RPDO2, RPDO3, RPDO4 = 0x200, 0x300, 0x400, 0x500
SDO_ANSWER, SDO_REQUEST = 0x580, 0x600
HEARTBEAT = 0x700

GENERATES_SYNC = 1 << 30  # in 0x1005: the drive sends SYNC (CiA 301)

RPDO_MAPPINGS = (
    PdoMapping(1, RPDO1, ASYNCHRONOUS, ((INTERPOLATION_DATA_RECORD, 0),)),
    PdoMapping(2, RPDO2, SYNCHRONOUS, ((CONTROLWORD, 0),)),
    PdoMapping(3, RPDO3, ASYNCHRONOUS, ((HIGH_RESOLUTION_TIME_STAMP, 0),)),
    PdoMapping(4, RPDO4, ASYNCHRONOUS, ((CONTROLWORD, 0),)),
)
TPDO_MAPPINGS = (
    PdoMapping(1, TPDO1, ASYNCHRONOUS, ((STATUSWORD, 0), (INTERPOLATION_STATUS, 1))),
    PdoMapping(
        2,
        TPDO2,
        ASYNCHRONOUS,
        ((POSITION_ACTUAL, 0), (INTERPOLATION_STATUS, 1), (CURRENT_AVERAGED, 0)),
    ),
    PdoMapping(
        4,
        TPDO4,
        SYNCHRONOUS,
        ((POSITION_DEMAND, 0), (STATUSWORD, 0), (FOLLOWING_ERROR_ACTUAL, 0)),
    ),
)
CLOCK_MASTER_TPDO_MAPPINGS = (
    *TPDO_MAPPINGS,
    PdoMapping(3, TPDO3, SYNCHRONOUS, ((HIGH_RESOLUTION_TIME_STAMP, 0),)),
)


def clock_slave_rpdo_mappings(
    rpdos: tuple[PdoMapping, ...], master_id: int
) -> tuple[PdoMapping, ...]:
    """Of a drive that follows the clock of another, the node `master_id`."""
    stamp = PdoMapping(3, TPDO3, ASYNCHRONOUS, ((HIGH_RESOLUTION_TIME_STAMP, 0),), master_id)
    return tuple(stamp if rpdo.number == stamp.number else rpdo for rpdo in rpdos)


EMCY_LAYOUT = struct.Struct("<HB5s")


class BufferStatus:
    """Bits of the interpolation buffer status word 0x20C4-01 (tables 12 and 13)."""

    UNDERFLOW_WARNING = 1 << 0
    OVERFLOW_WARNING = 1 << 1
    VELOCITY_WARNING = 1 << 2
    ACCELERATION_WARNING = 1 << 3
    UNDERFLOW_ERROR = 1 << 8
    OVERFLOW_ERROR = 1 << 9
    VELOCITY_ERROR = 1 << 10
    ACCELERATION_ERROR = 1 << 11
    BUFFER_ENABLED = 1 << 14
    IP_MODE_ACTIVE = 1 << 15
    ERRORS = UNDERFLOW_ERROR | OVERFLOW_ERROR | VELOCITY_ERROR | ACCELERATION_ERROR
    FLAGS = {
        "underflow_warning": UNDERFLOW_WARNING,
        "overflow_warning": OVERFLOW_WARNING,
        "velocity_warning": VELOCITY_WARNING,
        "acceleration_warning": ACCELERATION_WARNING,
        "underflow_error": UNDERFLOW_ERROR,
        "overflow_error": OVERFLOW_ERROR,
        "velocity_error": VELOCITY_ERROR,
        "acceleration_error": ACCELERATION_ERROR,
        "buffer_enabled": BUFFER_ENABLED,
        "ip_mode_active": IP_MODE_ACTIVE,
    }


FREE_RECORDS = SdoRead(INTERPOLATION_DATA_CONFIGURATION, ACTUAL_BUFFER_SUBINDEX, 4)
CLOCK_AT_SYNC = SdoRead(HIGH_RESOLUTION_TIME_STAMP, 0, 4)  # the last one [µs]


EMERGENCIES = {
    0x1000: "generic error",
    0x2310: "over-current",
    0x3210: "over-voltage",
    0x3220: "under-voltage",
    0x4210: "over-temperature",
    0x5113: "logic supply voltage too low",
    0x5114: "supply voltage of the output stage too low",
    0x6100: "internal software error",
    0x6320: "software parameter error",
    0x7320: "position sensor error",
    0x8110: "CAN overrun: objects lost",
    0x8111: "CAN overrun",
    0x8120: "CAN in error passive mode",
    0x8130: "life guard or heartbeat error: the host was not heard",
    0x8150: "COB-ID collision on transmission",
    0x81FD: "CAN bus off",
    0x81FE: "CAN receive queue overrun",
    0x81FF: "CAN transmit queue overrun",
    0x8210: "PDO not processed: wrong length",
    0x8611: "following error",
    0xFF01: "hall sensor error",
    0xFF02: "index processing error",
    0xFF03: "encoder resolution error",
    0xFF04: "hall sensor not found",
    0xFF06: "negative limit switch",
    0xFF07: "positive limit switch",
    0xFF08: "hall angle detection error",
    0xFF09: "software position limit",
    0xFF0A: "position sensor breach",
    0xFF0B: "system overloaded",
    0xFF0C: "interpolated position mode error",
    0xFF0D: "auto tuning identification error",
    0xFF0F: "gear scaling factor error",
    0xFF10: "controller gain error",
    0xFF11: "main sensor direction error",
    0xFF12: "auxiliary sensor direction error",
}
IPM_EMERGENCY = 0xFF0C  # the cause is in 0x20C4-01


def describe_buffer_errors(status_word: int) -> str:
    """The error flags of 0x20C4-01 in words, "" when there are none."""
    return ", ".join(
        name.replace("_", " ")
        for name, bit in BufferStatus.FLAGS.items()
        if bit & BufferStatus.ERRORS & status_word
    )


def is_drive_profile(device_type: int) -> bool:
    """Whether 0x1000 names a drive of CiA 402 (low word: profile number)."""
    return device_type & 0xFFFF == DEVICE_PROFILE


def home_objects(position_qc: int, back_off_qc: int) -> tuple[SdoWrite, ...]:
    """The axis goes `back_off_qc` on from where its home is, and is then at `position_qc`."""
    return (
        SdoWrite.integer(HOME_OFFSET, 0, back_off_qc, 4, signed=True),
        SdoWrite.integer(HOME_POSITION, 0, position_qc, 4, signed=True),
    )


FAMILY = Family(
    key="epos2",
    name="an EPOS2",
    maker="maxon",
    vendor_id=VENDOR_ID,
    eds="epos2.eds",
    rpdos=RPDO_MAPPINGS,
    tpdos=TPDO_MAPPINGS,
    fields={
        (STATUSWORD, 0): Field("H", "statusword"),
        (INTERPOLATION_STATUS, 1): Field("H", "buffer_status"),
        (POSITION_ACTUAL, 0): Field("i", "position_qc"),
        (HIGH_RESOLUTION_TIME_STAMP, 0): Field("I", "latched"),
        (CURRENT_AVERAGED, 0): Field("h", "current_ma"),
        (POSITION_DEMAND, 0): Field("i", "demand_qc"),
        (FOLLOWING_ERROR_ACTUAL, 0): Field("h", "following_error_qc"),
    },
    emergencies=EMERGENCIES,
    rest_operation=MODE_INTERPOLATED_POSITION,
    motion_units=lambda units: (units.velocity_unit_qc_s, units.counts_per_turn / 60, math.nan),
    home_objects=home_objects,
    homing_methods=homing_methods.EPOS2,
    pvt=PvtBuffer(
        cycle_us=1000.0,
        free_cycles=False,
        velocity_unit_qc_s=lambda units, fastest_qc_s: units.velocity_unit_qc_s,
        account=lambda velocity_unit_qc_s, status: CountedRecords(BUFFER_SIZE),
        status=FREE_RECORDS,
        empty=tuple(
            SdoWrite.integer(INTERPOLATION_DATA_CONFIGURATION, BUFFER_CLEAR_SUBINDEX, value, 1)
            for value in (0, 1)
        ),
        describe_errors=describe_buffer_errors,
        flags=lambda status, statusword: {
            name: bool(status & bit) for name, bit in BufferStatus.FLAGS.items()
        },
    ),
    has_clock=True,
    backs_off=True,
    referenced_bit=REFERENCED,
    power_up_bit=REFRESH_CYCLE,
)
