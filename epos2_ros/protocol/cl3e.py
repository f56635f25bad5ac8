"""A Nanotec CL3-E as the host sees it: its objects, its PDOs, its units of motion.

Device control and profile position mode are those of Nanotec, "CL3-E CANopen/USB Technical Manual",
chapter "Profile Position", and CiA 402.

| PDO   | COB-ID | transmission      | objects                                      |
|-------|--------|-------------------|----------------------------------------------|
| RPDO1 | 200+id | asynchronous (255)| target position, profile velocity            |
| RPDO2 | 300+id | synchronous (1)   | controlword: takes effect at the next SYNC   |
| RPDO3 | 400+id | asynchronous (255)| profile acceleration, profile deceleration   |
| RPDO4 | 500+id | asynchronous (255)| controlword: takes effect at once            |
| TPDO1 | 180+id | event             | statusword                                   |
| TPDO2 | 280+id | synchronous (1)   | position actual, velocity actual             |
| TPDO3 | 380+id | synchronous (1)   | statusword, position demand                  |

The numbers are those of the EPOS2's PDOs with the same content, or the same purpose: RPDO1 brings
what the next piece of a path is made of. As the drive leaves the factory RPDO1 has the motor drive
submode (0x3202) mapped, where a frame of zeros selects open loop; so it is mapped anew before the
drive listens. TPDO4 is valid then, too, and is switched off.
"""

from __future__ import annotations

from epos2_ros.protocol import epos2, homing_methods
from epos2_ros.protocol.family import Family, Field
from epos2_ros.protocol.pdo import ASYNCHRONOUS, SYNCHRONOUS, PdoMapping

VENDOR_ID = 0x0000026C
MODE_PROFILE_POSITION = 1

# Objects that are Nanotec's own, or that the other families do not have.
SOFTWARE_VERSION = 0x100A
VELOCITY_UNIT = 0x2061  # numerator, 0x2062 denominator: turns per second
ACCELERATION_UNIT = 0x2063  # 0x2064: turns per second²
JERK_UNIT = 0x2065  # 0x2066: turns per second³
FOLLOWING_ERROR_OPTION = 0x3700
QUICK_STOP_OPTION = 0x605A
SUBMODE = 0x3202  # bit 0: closed loop
OPEN_LOOP_SOURCE = 0x320A  # -04 1: position is that of the encoder
HALT_OPTION = 0x605D
FOLLOWING_ERROR_WINDOW = 0x6065
END_VELOCITY = 0x6082
ENCODER_RESOLUTION = 0x608F  # -01 increments per -02 turns
GEAR_RATIO = 0x6091
FEED_CONSTANT = 0x6092
PROFILE_JERK = 0x60A4
UNIT_POSITION = 0x60A8
UNIT_VELOCITY = 0x60A9
MAX_DECELERATION = 0x60C6
POSITIONING_OPTION = 0x60F2

TENTH_DEGREES, RPM = 0xFF41_0000, 0x00B4_4700  # in 0x60A8 and 0x60A9, their presets
TENTHS_PER_TURN = 3600
RPM_FRACTION = (1, 60)  # in 0x2061 … 0x2066, their presets
FINE_FRACTION = (1, 6000)  # what the driver sets 0x2061 … 0x2064 to: 0.01 rpm, 0.01 rpm/s
# What is in the units of 0x2061 and of 0x2063.
VELOCITIES = (
    (epos2.PROFILE_VELOCITY, 0),
    (END_VELOCITY, 0),
    (epos2.HOMING_SPEEDS, 1),
    (epos2.HOMING_SPEEDS, 2),
)
ACCELERATIONS = (
    (epos2.PROFILE_ACCELERATION, 0),
    (epos2.PROFILE_DECELERATION, 0),
    (epos2.QUICK_STOP_DECELERATION, 0),
    (epos2.HOMING_ACCELERATION, 0),
    (epos2.MAX_ACCELERATION, 0),
    (MAX_DECELERATION, 0),
)
HALF_WAY = 3  # a numerator that no unit has: the drive's values are being converted
STAY_IN_QUICK_STOP = 6  # brakes by 0x6085
HALT_BY_QUICK_STOP_RAMP = 2
FAULT_BY_QUICK_STOP_RAMP = 2
NO_RELEASE = 0x0001  # bit 4 is the host's; relative moves count from the demand


def preset_units(counts_per_turn: int) -> tuple[float, float, float]:
    """rpm, rpm/s and rpm/s² of the motor: what newer firmware has, whose units are not changed.

    READING: such firmware, which has no object for the unit of jerk, has it in rpm/s² as well.
    """
    rpm = counts_per_turn / 60
    return rpm, rpm, rpm


def fine_units(counts_per_turn: int) -> tuple[float, float, float]:
    """What the driver sets the units to where there are fractions; that of jerk stays."""
    numerator, denominator = FINE_FRACTION
    fine = counts_per_turn * numerator / denominator
    return fine, fine, counts_per_turn / 60


def likely_units(counts_per_turn: int) -> tuple[float, float, float]:
    """Of a drive that was not asked: newer firmware counts tenths of a degree, and only that."""
    newer = counts_per_turn == TENTHS_PER_TURN
    return preset_units(counts_per_turn) if newer else fine_units(counts_per_turn)


FAMILY = Family(
    key="cl3e",
    name="a Nanotec CL3-E",
    maker="Nanotec",
    vendor_id=VENDOR_ID,
    eds="cl3e.eds",
    rpdos=(
        PdoMapping(
            1, epos2.RPDO1, ASYNCHRONOUS, ((epos2.TARGET_POSITION, 0), (epos2.PROFILE_VELOCITY, 0))
        ),
        PdoMapping(2, epos2.RPDO2, SYNCHRONOUS, ((epos2.CONTROLWORD, 0),)),
        PdoMapping(
            3,
            epos2.RPDO3,
            ASYNCHRONOUS,
            ((epos2.PROFILE_ACCELERATION, 0), (epos2.PROFILE_DECELERATION, 0)),
        ),
        PdoMapping(4, epos2.RPDO4, ASYNCHRONOUS, ((epos2.CONTROLWORD, 0),)),
    ),
    tpdos=(
        PdoMapping(1, epos2.TPDO1, ASYNCHRONOUS, ((epos2.STATUSWORD, 0),)),
        PdoMapping(
            2, epos2.TPDO2, SYNCHRONOUS, ((epos2.POSITION_ACTUAL, 0), (epos2.VELOCITY_ACTUAL, 0))
        ),
        PdoMapping(
            3, epos2.TPDO3, SYNCHRONOUS, ((epos2.STATUSWORD, 0), (epos2.POSITION_DEMAND, 0))
        ),
    ),
    fields={
        (epos2.STATUSWORD, 0): Field("H", "statusword"),
        (epos2.POSITION_ACTUAL, 0): Field("i", "position_qc"),
        (epos2.VELOCITY_ACTUAL, 0): Field("i", "velocity"),
        (epos2.POSITION_DEMAND, 0): Field("i", "demand_qc"),
    },
    emergencies={
        0x1000: "generic error",
        0x2300: "current at the output",
        0x3100: "supply voltage",
        0x4200: "temperature",
        0x6100: "internal software error",
        0x8130: "life guard or heartbeat error: the host was not heard",
        0x8210: "PDO not processed: wrong length",
        0x8611: "following error",
    },  # CiA 301, 7.2.7.1, and CiA 402
    rest_operation=MODE_PROFILE_POSITION,
    motion_units=lambda units: likely_units(units.counts_per_turn),  # until it has said
    jerk_objects=tuple((PROFILE_JERK, subindex) for subindex in range(1, 5)),
    home_objects=homing_methods.shifted_zero,
    homing_methods=homing_methods.STANDARD,
    pvt=None,
    has_clock=False,
    passes_set_points=True,
    life_guarding=True,
)
