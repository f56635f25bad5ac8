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

from epos2_ros.protocol import epos2
from epos2_ros.protocol.family import Family, Field
from epos2_ros.protocol.pdo import ASYNCHRONOUS, SYNCHRONOUS, PdoMapping

VENDOR_ID = 0x000000AB
MODE_PROFILE_POSITION = 1

VELOCITY_UNIT_COUNTS_S = 0.1
ACCELERATION_UNIT_COUNTS_S2 = 10.0

RPDO_MAPPINGS = (
    PdoMapping(2, epos2.RPDO2, SYNCHRONOUS, ((epos2.CONTROLWORD, 0),)),
    PdoMapping(4, epos2.RPDO4, ASYNCHRONOUS, ((epos2.CONTROLWORD, 0),)),
)
TPDO_MAPPINGS = (
    PdoMapping(1, epos2.TPDO1, ASYNCHRONOUS, ((epos2.STATUSWORD, 0),)),
    PdoMapping(
        2, epos2.TPDO2, SYNCHRONOUS, ((epos2.POSITION_ACTUAL, 0), (epos2.VELOCITY_ACTUAL, 0))
    ),
    PdoMapping(3, epos2.TPDO3, SYNCHRONOUS, ((epos2.STATUSWORD, 0), (epos2.POSITION_DEMAND, 0))),
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
        (epos2.POSITION_ACTUAL, 0): Field("i", "position_qc"),
        (epos2.VELOCITY_ACTUAL, 0): Field("i", "velocity"),
        (epos2.POSITION_DEMAND, 0): Field("i", "demand_qc"),
    },
    emergencies=epos2.EMERGENCIES,
    rest_operation=MODE_PROFILE_POSITION,
    motion_units=lambda units: (VELOCITY_UNIT_COUNTS_S, ACCELERATION_UNIT_COUNTS_S2),
    home_objects=lambda position_qc, back_off_qc: (),
    homing_methods={},  # not offered yet
    has_clock=False,
)
