"""What to ask a drive, and what its answers mean: one class per maker.

Objects are those of the makers' own dictionaries (EDS files: maxon 2007 – 2013, Copley 2016,
Nanotec 2014). Reading is all that is needed: "write only" says as well that an object is there.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from epos2_ros.bus.identity import DEVICE_NAME, IDENTITY, SOFTWARE_VERSION
from epos2_ros.commission.found import DEVICE_TYPE, Found
from epos2_ros.commission.uploads import Address, Questions
from epos2_ros.configuration.parameters import AXIS
from epos2_ros.protocol import cia402, cl3e, copley, copley_pvt, epos2
from epos2_ros.protocol.identity import COPLEY, MAXON, NANOTEC

ERROR_FIELD = 0x1003
HEARTBEAT_TIME = 0x1017
SUPPORTED_MODES = 0x6502
PROFILE_POSITION, INTERPOLATED_POSITION = 1, 7
ENCODER_RESOLUTION, GEAR_RATIO, FEED_CONSTANT = 0x608F, 0x6091, 0x6092

ABOUT = (
    *((IDENTITY, subindex) for subindex in range(1, 5)),
    (DEVICE_NAME, 0),
    (SOFTWARE_VERSION, 0),
    (HEARTBEAT_TIME, 0),
    (ERROR_FIELD, 0),
    (ERROR_FIELD, 1),
)
DRIVE = (
    (epos2.STATUSWORD, 0),
    (epos2.MODES_OF_OPERATION_DISPLAY, 0),
    (SUPPORTED_MODES, 0),
    (epos2.POSITION_ACTUAL, 0),
    (epos2.SOFTWARE_POSITION_LIMIT, 1),
    (epos2.SOFTWARE_POSITION_LIMIT, 2),
)
FACTORS = tuple((i, s) for i in (ENCODER_RESOLUTION, GEAR_RATIO, FEED_CONSTANT) for s in (1, 2))

MAKERS_OWN = 0xFF00  # error codes from here on mean what the maker says (CiA 301, table 26)
# Error codes by their upper byte or digit (CiA 301, table 26).
ERROR_CLASSES = {
    0x10: "generic error",
    0x2: "current",
    0x3: "voltage",
    0x4: "temperature",
    0x5: "device hardware",
    0x6: "device software",
    0x7: "additional modules",
    0x81: "communication",
    0x82: "protocol error",
    0x8: "monitoring",
    0x9: "external error",
    0xFF: "of the maker's own",
}


def interview(found: Found) -> Questions:
    """All that is asked of one node; ends early where nobody answers, or no drive does."""
    yield from _ask(found, [(DEVICE_TYPE, 0)])
    if found.answered:
        yield from _ask(found, ABOUT)
        if is_drive(found):
            yield from _ask(found, DRIVE)
            yield from _ask(found, maker_of(found).questions)


def _ask(found: Found, addresses: Iterable[Address]) -> Questions:
    for address in addresses:
        found.answers[address] = yield address


def is_drive(found: Found) -> bool:
    """Whether the device type names CiA 402."""
    return epos2.is_drive_profile(found.integer(DEVICE_TYPE) or 0)


class Maker:
    """A maker of whose drives nothing is known but what CiA 402 says."""

    drive = ""  # as of axes.<joint>.drive
    counts = "units"  # what 0x6064 counts
    modes: Mapping[int, str] = {}  # of operation that the driver needs, by their bits in 0x6502
    needed: Mapping[Address, str] = {}  # objects that it needs besides CiA 402's
    questions: tuple[Address, ...] = ()
    boot_ups = 2  # boot-up messages at one start, at most: some boot loaders send one, too

    def firmware(self, found: Found) -> str:
        return found.identity.firmware

    def emergency(self, code: int) -> str:
        """An error code in words, with the number for the manual."""
        if code in epos2.EMERGENCIES and code < MAKERS_OWN:  # those of CiA 301 and 402
            return epos2.FAMILY.describe_emergency(code)
        for digits in (code >> 8, code >> 12):
            if digits in ERROR_CLASSES:
                return f"{ERROR_CLASSES[digits]} (0x{code:04X})"
        return f"0x{code:04X}"

    def operational(self, statusword: int) -> bool | None:
        """NMT operational or not, where the statusword tells."""
        return None

    def units(self, found: Found) -> str:
        """What it is set to count in."""
        return ""

    def counts_per_turn(self, found: Found) -> int | None:
        """Of the motor's encoder [counts], where the drive knows."""
        return None

    def velocity_notation(self, found: Found) -> int:
        return 0

    def lacks(self, found: Found) -> list[str]:
        """What keeps the driver from moving it."""
        if not is_drive(found):
            return ["it is no drive of CiA 402"]
        if self.drive not in AXIS["drive"].choices:
            return [f"the driver knows no drives of {found.identity.maker}"]
        for mode, name in self.modes.items():
            if not _has_mode(found, mode):
                return [f"it has no {name} mode (0x6502)"]
        return [
            f"it has no {name} (0x{address[0]:04X}-{address[1]:02X})"
            for address, name in self.needed.items()
            if found.lacks(*address)
        ]


class Maxon(Maker):
    """The EPOS2."""

    drive = "epos2"
    boot_ups = 1
    counts = "qc"
    SOFTWARE = 0x2003
    SENSOR = 0x2210
    PULSES, SENSOR_TYPE = 1, 2
    INCREMENTAL_ENCODERS = (1, 2)  # sensor types: with index, without
    OLDEST = 0x2101  # with interpolated position mode (the note, 1)
    modes = {INTERPOLATED_POSITION: "interpolated position"}
    needed = {
        (epos2.INTERPOLATION_DATA_RECORD, 0): "interpolation data record",
        (epos2.INTERPOLATION_STATUS, 1): "interpolation buffer status",
        (epos2.INTERPOLATION_DATA_CONFIGURATION, 1): "interpolation buffer size",
        (epos2.HIGH_RESOLUTION_TIME_STAMP, 0): "high resolution time stamp",
        (epos2.CONSUMER_HEARTBEAT_TIME, 1): "consumer heartbeat time",
    }
    questions = (
        (SOFTWARE, 1),
        (SENSOR, PULSES),
        (SENSOR, SENSOR_TYPE),
        (epos2.VELOCITY_NOTATION_INDEX, 0),
        (epos2.MAX_FOLLOWING_ERROR, 0),
        *needed,
    )

    def firmware(self, found: Found) -> str:
        version = found.integer(self.SOFTWARE, 1)
        return found.identity.firmware if version is None else f"{version:04X}h"

    def emergency(self, code: int) -> str:
        return epos2.FAMILY.describe_emergency(code)

    def operational(self, statusword: int) -> bool | None:
        return bool(statusword & 0x0200)  # "remote"

    def units(self, found: Found) -> str:
        turn = self.counts_per_turn(found)
        encoder = [] if turn is None else [f"{turn} qc/turn"]
        return ", ".join([*encoder, f"{10.0 ** self.velocity_notation(found):g} rpm"])

    def counts_per_turn(self, found: Found) -> int | None:
        pulses = found.integer(self.SENSOR, self.PULSES)
        kind = found.integer(self.SENSOR, self.SENSOR_TYPE)
        return 4 * pulses if pulses and kind in self.INCREMENTAL_ENCODERS else None

    def velocity_notation(self, found: Found) -> int:
        return found.integer(epos2.VELOCITY_NOTATION_INDEX, signed=True) or 0

    def lacks(self, found: Found) -> list[str]:
        if is_drive(found) and (version := int(self.firmware(found)[:-1], 16)) < self.OLDEST:
            return [
                f"firmware {version:04X}h has no interpolated position mode: update it to "
                f"{self.OLDEST:04X}h or newer with EPOS Studio"
            ]
        return super().lacks(found)


class Copley(Maker):
    """Accelnet, Xenus and others of the plus family."""

    drive = "copley"
    boot_ups = 1
    counts = "counts"
    modes = {PROFILE_POSITION: "profile position", INTERPOLATED_POSITION: "interpolated position"}
    needed = {
        (copley_pvt.BUFFER_STATUS.index, 0): "PVT buffer status",
        (copley.DESIRED_STATE, 0): "desired amplifier state",
        (epos2.HIGH_RESOLUTION_TIME_STAMP, 0): "high resolution time stamp",
        (epos2.GUARD_TIME, 0): "guard time",
    }
    questions = (*FACTORS, *needed)

    def units(self, found: Found) -> str:
        return ", ".join(["0.1 counts/s", *_factors(found)])


class Nanotec(Maker):
    """CL3-E: units are fractions of its own up to FIR-v17xx, 0x60A8 and 0x60A9 in newer ones."""

    drive = "cl3e"
    modes = {PROFILE_POSITION: "profile position"}
    needed = {
        (epos2.GUARD_TIME, 0): "guard time",
        (cl3e.FOLLOWING_ERROR_OPTION, 0): "following error option code",
    }
    VELOCITY_NUMERATOR, VELOCITY_DENOMINATOR, SI_VELOCITY = 0x2061, 0x2062, 0x60A9
    questions = (
        (VELOCITY_NUMERATOR, 0),
        (VELOCITY_DENOMINATOR, 0),
        (SI_VELOCITY, 0),
        *FACTORS,
        *needed,
    )

    def units(self, found: Found) -> str:
        fraction = [found.integer(i) for i in (self.VELOCITY_NUMERATOR, self.VELOCITY_DENOMINATOR)]
        unit = found.integer(self.SI_VELOCITY)
        velocity = []
        if None not in fraction:
            velocity = ["rpm" if fraction == [1, 60] else f"{fraction[0]}/{fraction[1]} turns/s"]
        elif unit is not None:
            velocity = [f"velocity unit 0x{unit:08X}"]
        return ", ".join([*velocity, *_factors(found)])


MAKERS = {MAXON: Maxon(), COPLEY: Copley(), NANOTEC: Nanotec()}


def maker_of(found: Found) -> Maker:
    """By the vendor id."""
    return MAKERS.get(found.identity.vendor_id, Maker())


def state_in_words(found: Found) -> str:
    """Of the power drive system (CiA 402)."""
    word = found.integer(epos2.STATUSWORD)
    return "" if word is None else cia402.state_of(word).value


def last_error(found: Found) -> str:
    """The newest entry of the error history in words; "" when it is empty."""
    if not found.integer(ERROR_FIELD) or not (entry := found.integer(ERROR_FIELD, 1)):
        return ""
    return maker_of(found).emergency(entry & 0xFFFF)


def _has_mode(found: Found, mode: int) -> bool:
    """By 0x6502; a drive that does not tell is given the benefit of the doubt."""
    modes = found.integer(SUPPORTED_MODES)
    return modes is None or bool(modes >> (mode - 1) & 1)


def _factors(found: Found) -> list[str]:
    """The factor groups that are not 1."""
    words = []
    for index, name in (
        (ENCODER_RESOLUTION, "encoder"),
        (GEAR_RATIO, "gear"),
        (FEED_CONSTANT, "feed"),
    ):
        above, below = found.integer(index, 1), found.integer(index, 2)
        if above is not None and below is not None and (above, below) != (1, 1):
            words.append(f"{name} {above}/{below}")
    return words
