"""A Copley drive as the host sees it: its objects, its PDOs, its units of motion.

Device control and profile position mode are those of CiA 402. Units of velocity and acceleration
(0.1 counts/s and 10 counts/s²) are from public descriptions of Copley's CANopen objects; they are
not in Copley, "Setting outputs at position", whose objects are in `copley_compare`.

| PDO   | COB-ID | transmission      | objects                                      |
|-------|--------|-------------------|----------------------------------------------|
| RPDO2 | 300+id | synchronous (1)   | controlword: takes effect at the next SYNC   |
| RPDO4 | 500+id | asynchronous (255)| controlword: takes effect at once            |
| TPDO1 | 180+id | event             | statusword                                   |
| TPDO2 | 280+id | synchronous (1)   | position actual, velocity actual             |

The numbers are those of the EPOS2's PDOs with the same content.
"""

from __future__ import annotations

import struct

from epos2_ros.protocol import epos2
from epos2_ros.protocol.epos2 import ASYNCHRONOUS, SYNCHRONOUS, PdoMapping

VENDOR_ID = 0x000000AB
MODE_PROFILE_POSITION = 1

TARGET_POSITION = 0x607A
VELOCITY_UNIT_COUNTS_S = 0.1
ACCELERATION_UNIT_COUNTS_S2 = 10.0

# Controlword and statusword bits of profile position mode (CiA 402).
NEW_SETPOINT = 0x0010
CHANGE_IMMEDIATELY = 0x0020
SETPOINT_ACKNOWLEDGED = 0x1000

RPDO_MAPPINGS = (
    PdoMapping(2, epos2.RPDO2, SYNCHRONOUS, ((epos2.CONTROLWORD, 0),)),
    PdoMapping(4, epos2.RPDO4, ASYNCHRONOUS, ((epos2.CONTROLWORD, 0),)),
)
TPDO_MAPPINGS = (
    PdoMapping(1, epos2.TPDO1, ASYNCHRONOUS, ((epos2.STATUSWORD, 0),)),
    PdoMapping(
        2, epos2.TPDO2, SYNCHRONOUS, ((epos2.POSITION_ACTUAL, 0), (epos2.VELOCITY_ACTUAL, 0))
    ),
)
TPDO1_LAYOUT = struct.Struct("<H")
TPDO2_LAYOUT = struct.Struct("<ii")


def velocity_object(counts_s: float) -> int:
    """A speed [counts/s, > 0] for 0x6081: 0.1 counts/s, at least one."""
    return max(1, round(counts_s / VELOCITY_UNIT_COUNTS_S))


def acceleration_object(counts_s2: float) -> int:
    """An acceleration [counts/s², > 0] for 0x6083 … 0x6085: 10 counts/s², at least one."""
    return max(1, round(counts_s2 / ACCELERATION_UNIT_COUNTS_S2))
