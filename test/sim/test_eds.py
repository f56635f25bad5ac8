"""The EDS against the documents, row by row, as a CANopen master reads it.

The tables below are typed from the documents: maxon, application note "Interpolation Position
Mode" (its misprints corrected, see the comments), CiA 301 and CiA 402.
"""

from __future__ import annotations

import configparser
from importlib import resources

import canopen
import pytest
from canopen.objectdictionary import ODVariable, datatypes

from epos2_ros.protocol import epos2
from epos2_ros.sim.epos2 import Dictionary, Epos2

NODE_ID = 5
EDS = resources.files("epos2_ros") / "eds" / "epos2.eds"

I8, I16, I32 = datatypes.INTEGER8, datatypes.INTEGER16, datatypes.INTEGER32
U8, U16, U32 = datatypes.UNSIGNED8, datatypes.UNSIGNED16, datatypes.UNSIGNED32
U64, STRING = datatypes.UNSIGNED64, datatypes.VISIBLE_STRING
MIN32, MAX32, MAXU32 = -2147483648, 2147483647, 4294967295

# index, sub-index, type, access, default, (low, high), PDO mapping

# maxon, application note, 3.6.1 … 3.6.7
NOTE = [
    (0x1012, 0, U32, "rw", 0x100, (0x100, 0x100), False),
    (0x1013, 0, U32, "rw", None, None, True),
    (0x20C1, 0, U64, "wo", None, None, True),  # complex data structure 0x0040: 64 bits
    (0x20C4, 0, U8, "ro", 3, None, False),
    (0x20C4, 1, U16, "ro", None, None, True),
    (0x20C4, 2, U16, "rw", 4, (0, 63), False),
    (0x20C4, 3, U16, "rw", 60, (1, 64), False),
    (0x60C0, 0, I16, "rw", -1, (-1, -1), False),
    (0x60C2, 0, U8, "ro", 2, None, False),
    (0x60C2, 1, U8, "rw", 1, (1, 1), False),
    (0x60C2, 2, I8, "rw", -3, (-3, -3), False),  # printed as sub-index 1 again
    (0x60C4, 0, U8, "ro", 6, None, False),
    (0x60C4, 1, U32, "ro", None, (64, 64), False),
    (0x60C4, 2, U32, "ro", 64, (0, 64), True),
    (0x60C4, 3, U8, "rw", 0, (0, 0), False),
    (0x60C4, 4, U16, "rw", 0, (0, 64), False),
    (0x60C4, 5, U8, "wo", None, (8, 8), False),
    (0x60C4, 6, U8, "wo", 0, (0, 1), False),
]
# types and mapping: CiA 402; defaults: the note's table 17, where it gives one
DRIVE = [
    (0x6040, 0, U16, "rw", None, None, True),
    (0x6041, 0, U16, "ro", None, None, True),
    (0x6060, 0, I8, "rw", None, None, True),
    (0x6061, 0, I8, "ro", None, None, True),
    (0x6062, 0, I32, "ro", None, None, True),
    (0x6064, 0, I32, "ro", None, None, True),
    (0x6065, 0, U32, "rw", 2000, None, False),
    (0x6067, 0, U32, "rw", MAXU32, None, False),  # "off", CiA 402
    (0x6068, 0, U16, "rw", 0, None, False),
    (0x606C, 0, I32, "ro", None, None, True),
    (0x2027, 0, I16, "ro", None, None, True),
    (0x6078, 0, I16, "ro", None, None, True),
    (0x607A, 0, I32, "rw", None, None, True),
    (0x607C, 0, I32, "rw", 0, None, False),
    (0x607D, 0, U8, "ro", 2, None, False),
    (0x607D, 1, I32, "rw", MIN32, None, False),
    (0x607D, 2, I32, "rw", MAX32, None, False),
    (0x607F, 0, U32, "rw", 25000, None, False),
    (0x6081, 0, U32, "rw", 1000, None, True),
    (0x6083, 0, U32, "rw", 10000, None, True),
    (0x6084, 0, U32, "rw", 10000, None, True),
    (0x6085, 0, U32, "rw", 10000, None, False),  # printed as 0x6084
    (0x6086, 0, I16, "rw", 0, (0, 1), False),
    (0x608B, 0, I8, "rw", 0, (-3, 0), False),
    (0x6098, 0, I8, "rw", None, None, False),
    (0x6099, 0, U8, "ro", 2, None, False),
    (0x6099, 1, U32, "rw", None, None, False),
    (0x6099, 2, U32, "rw", None, None, False),
    (0x609A, 0, U32, "rw", None, None, False),
    (0x60C5, 0, U32, "rw", MAXU32, None, False),
    (0x6502, 0, U32, "ro", None, None, False),
]
# maxon's own objects outside the note
VENDOR = [
    (0x2003, 0, U8, "ro", 5, None, False),
    *[(0x2003, sub, U16, "ro", None, None, False) for sub in range(1, 6)],
    (0x6007, 0, I16, "rw", 3, (0, 3), False),
    (0x2074, 0, U8, "ro", 6, None, False),
    (0x2074, 1, I32, "ro", None, None, True),
    (0x2074, 2, U8, "rw", 0, (0, 2), False),
    (0x2074, 3, U8, "rw", 0, (0, 2), False),
    (0x2074, 4, U16, "rw", 0, None, False),
    (0x2074, 5, I32, "ro", None, None, False),
    (0x2074, 6, I32, "ro", None, None, False),
    (0x2079, 0, U8, "ro", 5, None, False),
    *[(0x2079, sub, U16, "rw", None, None, False) for sub in range(1, 6)],
    (0x207A, 0, U8, "ro", 5, None, False),
    (0x207A, 1, U16, "rw", 0, None, True),
    (0x207A, 2, I32, "rw", 0, None, True),
    (0x207A, 3, I32, "rw", 0, None, False),
    (0x207A, 4, U16, "rw", 0, None, False),
    (0x207A, 5, U16, "rw", 0, None, False),
    (0x2081, 0, I32, "rw", 0, None, False),
    (0x20F4, 0, I16, "ro", None, None, True),
]
# CiA 301, 7.5; COB-IDs: predefined connection set (7.3.5)
COMMUNICATION = [
    (0x1000, 0, U32, "ro", 0x00020192, None, False),  # servo drive, profile 402
    (0x1001, 0, U8, "ro", None, None, True),
    (0x1003, 0, U8, "rw", 0, None, False),
    *[(0x1003, sub, U32, "ro", None, None, False) for sub in range(1, 6)],
    (0x1005, 0, U32, "rw", 0x80, None, False),
    (0x1006, 0, U32, "rw", 0, None, False),
    *[(index, 0, STRING, "const", None, None, False) for index in (0x1008, 0x1009, 0x100A)],
    (0x100C, 0, U16, "rw", 0, None, False),
    (0x100D, 0, U8, "rw", 0, None, False),
    (0x1010, 0, U8, "ro", 1, None, False),
    (0x1010, 1, U32, "rw", None, None, False),
    (0x1011, 0, U8, "ro", 1, None, False),
    (0x1011, 1, U32, "rw", None, None, False),
    (0x1014, 0, U32, "rw", 0x80 + NODE_ID, None, False),
    (0x1016, 0, U8, "ro", 2, None, False),
    *[(0x1016, sub, U32, "rw", 0, None, False) for sub in (1, 2)],
    (0x1017, 0, U16, "rw", 0, None, False),
    (0x1018, 0, U8, "ro", 4, None, False),
    (0x1018, 1, U32, "ro", 0xFB, None, False),  # maxon's number at CiA
    *[(0x1018, sub, U32, "ro", None, None, False) for sub in (2, 3, 4)],
    (0x1200, 0, U8, "ro", 2, None, False),
    (0x1200, 1, U32, "ro", 0x600 + NODE_ID, None, False),
    (0x1200, 2, U32, "ro", 0x580 + NODE_ID, None, False),
]
RPDO_COB_IDS = (0x200, 0x300, 0x400, 0x500)
TPDO_COB_IDS = (0x180, 0x280, 0x380, 0x480)
PDOS = [
    row
    for communication, cob_ids, sub0 in ((0x1400, RPDO_COB_IDS, 2), (0x1800, TPDO_COB_IDS, 3))
    for n, cob_id in enumerate(cob_ids)
    for row in [
        (communication + n, 0, U8, "ro", sub0, None, False),
        (communication + n, 1, U32, "rw", cob_id + NODE_ID, None, False),
        (communication + n, 2, U8, "rw", 255, None, False),
        *([(communication + n, 3, U16, "rw", 0, None, False)] if sub0 == 3 else []),
        (communication + 0x200 + n, 0, U8, "rw", None, (0, 8), False),
        *[(communication + 0x200 + n, sub, U32, "rw", None, None, False) for sub in range(1, 9)],
    ]
]
ROWS = NOTE + DRIVE + VENDOR + COMMUNICATION + PDOS

NAMES = {  # as the documents write them
    (0x1013, 0): "High Resolution Time Stamp",
    (0x20C1, 0): "Interpolation data record",
    (0x20C4, 1): "Interpolation buffer status",
    (0x20C4, 2): "Interpolation buffer underflow warning",
    (0x20C4, 3): "Interpolation buffer overflow warning",
    (0x6040, 0): "Controlword",
    (0x6041, 0): "Statusword",
    (0x6060, 0): "Modes of Operation",
    (0x6062, 0): "Position Demand Value",
    (0x6064, 0): "Position Actual Value",
    (0x6081, 0): "Profile Velocity",
    (0x6083, 0): "Profile Acceleration",
    (0x6085, 0): "Quick Stop Deceleration",
    (0x60C0, 0): "Interpolation sub mode selection",
    (0x60C2, 2): "Interpolation time index",
    (0x60C4, 1): "Maximum buffer size",
    (0x60C4, 2): "Actual buffer size",
    (0x60C4, 3): "Buffer organisation",
    (0x60C4, 4): "Buffer position",
    (0x60C4, 5): "Size of data record",
    (0x60C4, 6): "Buffer clear",
}


@pytest.fixture(scope="module")
def dictionary() -> canopen.ObjectDictionary:
    return canopen.import_od(str(EDS), NODE_ID)


@pytest.fixture(scope="module")
def sections() -> configparser.RawConfigParser:
    parser = configparser.RawConfigParser()
    parser.read_string(EDS.read_text(encoding="ascii"))
    return parser


def entry(dictionary: canopen.ObjectDictionary, index: int, subindex: int) -> ODVariable:
    found = dictionary[index]
    return found if isinstance(found, ODVariable) else found[subindex]


@pytest.mark.parametrize("row", ROWS, ids=lambda row: f"{row[0]:04X}-{row[1]:02X}")
def test_object_is_as_documented(dictionary: canopen.ObjectDictionary, row: tuple) -> None:
    index, subindex, data_type, access, default, limits, mappable = row
    found = entry(dictionary, index, subindex)
    assert (found.subindex, found.data_type, found.access_type) == (subindex, data_type, access)
    assert found.default == default
    assert (found.min, found.max) == (limits or (None, None))
    assert found.pdo_mappable == mappable


def test_nothing_is_in_the_eds_that_the_tables_do_not_name(
    dictionary: canopen.ObjectDictionary,
) -> None:
    found = {
        (variable.index, variable.subindex)
        for thing in dictionary.values()
        for variable in ([thing] if isinstance(thing, ODVariable) else thing.values())
    }
    assert found == {row[:2] for row in ROWS}
    assert len(ROWS) == len(found)


@pytest.mark.parametrize("key", NAMES, ids=lambda key: f"{key[0]:04X}-{key[1]:02X}")
def test_object_has_the_vendors_name(
    dictionary: canopen.ObjectDictionary, key: tuple[int, int]
) -> None:
    assert entry(dictionary, *key).name == NAMES[key]


def test_object_lists_name_every_section_once(sections: configparser.RawConfigParser) -> None:
    """CiA 306: every object is listed as mandatory, optional or the manufacturer's."""
    listed = []
    for name, belongs in (
        ("MandatoryObjects", lambda index: index in (0x1000, 0x1001, 0x1018)),
        ("OptionalObjects", lambda index: index < 0x2000 or index >= 0x6000),
        ("ManufacturerObjects", lambda index: 0x2000 <= index < 0x6000),
    ):
        section = sections[name]
        indices = [int(section[str(n)], 16) for n in range(1, int(section["SupportedObjects"]) + 1)]
        assert len(section) == len(indices) + 1
        assert all(belongs(index) for index in indices), name
        listed += indices
    assert sorted(listed) == sorted({row[0] for row in ROWS})
    assert all(sections.has_section(f"{index:04X}") for index in listed)


def test_sub_numbers_count_the_sub_objects(sections: configparser.RawConfigParser) -> None:
    for index in {row[0] for row in ROWS}:
        subs = [name for name in sections.sections() if name.startswith(f"{index:04X}sub")]
        assert sections.getint(f"{index:04X}", "SubNumber", fallback=0) == len(subs)


def test_canopen_sees_four_pdos_each_way() -> None:
    node = canopen.RemoteNode(NODE_ID, str(EDS))
    assert len(node.rpdo) == len(node.tpdo) == 4


@pytest.mark.parametrize(
    "pdo", epos2.RPDO_MAPPINGS + epos2.TPDO_MAPPINGS, ids=lambda pdo: f"{pdo.cob_id:03X}"
)
def test_drivers_pdos_can_be_mapped(
    dictionary: canopen.ObjectDictionary, pdo: epos2.PdoMapping
) -> None:
    """CiA 301, 7.2.2: mappable objects only, up to 64 bits, received ones writable."""
    entries = [entry(dictionary, *key) for key in pdo.objects]
    assert all(found.pdo_mappable for found in entries)
    assert sum(len(found) for found in entries) <= 64
    received = pdo in epos2.RPDO_MAPPINGS
    assert all(found.writable if received else found.readable for found in entries)


def test_simulated_drive_was_read_from_the_documents_alike(
    dictionary: canopen.ObjectDictionary,
) -> None:
    """Two people's readings: type, access and mapping of every object that both have."""
    common = 0
    drive = Epos2(NODE_ID, dictionary=Dictionary.NOTE)
    for (index, subindex), simulated in drive.dictionary.items():
        found = entry(dictionary, index, subindex)
        key = f"{index:04X}-{subindex:02X}"
        if found.data_type != STRING:
            assert 8 * simulated.type.size == len(found), key
            assert simulated.type.signed == (found.data_type in datatypes.SIGNED_TYPES), key
        access = found.access_type.replace("const", "ro")
        assert simulated.access.replace("const", "ro") == access, key
        assert simulated.mappable >= found.pdo_mappable, key
        common += 1
    assert common > 100
