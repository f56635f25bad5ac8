"""The Copley EDS against the documents, as a CANopen master reads it, and the simulated drive.

The tables are typed from Copley, "Setting outputs at position", and CiA 402; the simulated drive is
held to the maker's own EDS of 2016.
"""

from __future__ import annotations

import configparser
from importlib import resources

import canopen
import pytest
from canopen.objectdictionary import ODVariable, datatypes
from makers import facts
from sim_host import Abort, Host

from epos2_ros.protocol import copley
from epos2_ros.sim.copley import Copley
from epos2_ros.sim.dictionary import SdoAbort

NODE_ID = 5
EDS = resources.files("epos2_ros") / "eds" / "copley.eds"
I16, I32 = datatypes.INTEGER16, datatypes.INTEGER32
I8, U8, U16, U32 = (
    datatypes.INTEGER8, datatypes.UNSIGNED8, datatypes.UNSIGNED16, datatypes.UNSIGNED32,
)  # fmt: skip
OCTETS, DOMAIN = datatypes.OCTET_STRING, datatypes.DOMAIN

# index, sub-index, type, access
NOTE = [
    (0x2160, 0, U32, "rw"),  # compare module configuration
    (0x2161, 0, U32, "rw"),  # status, write 1 to clear
    (0x2162, 0, I32, "rw"),  # compare value 0
    (0x2163, 0, I32, "rw"),  # compare value 1
    (0x2164, 0, I32, "rw"),  # increment: "signed 32-bit value"
    (0x2165, 0, U32, "rw"),  # pulse period: "the lower 20-bits"
    *[(0x2193, n, OCTETS, "rw") for n in range(1, 9)],  # "a total of 10 bytes"
    (0x250A, 0, U16, "rw"),  # number of 16-bit words to reserve
    (0x250B, 0, U16, "rw"),  # offset into the reserved portion
    (0x250C, 0, DOMAIN, "wo"),  # a 16-byte write or four 4-byte writes
]
DRIVE = [
    (0x6040, 0, U16, "rw"),
    (0x6041, 0, U16, "ro"),
    (0x6060, 0, I8, "rw"),
    (0x6061, 0, I8, "ro"),
    (0x6062, 0, I32, "ro"),
    (0x6064, 0, I32, "rw"),
    (0x606C, 0, I32, "ro"),
    (0x607A, 0, I32, "rw"),
    (0x607D, 1, I32, "rw"),
    (0x607D, 2, I32, "rw"),
    (0x6081, 0, I32, "rw"),
    (0x6083, 0, I32, "rw"),
    (0x6084, 0, I32, "rw"),
    (0x6085, 0, I32, "rw"),
    (0x6086, 0, I16, "rw"),
    (0x6502, 0, U32, "ro"),
]
MAKER = [  # that the driver needs besides
    (0x100C, 0, U16, "rw"),
    (0x100D, 0, U8, "rw"),
    (0x1013, 0, U32, "rw"),
    (0x2010, 0, datatypes.UNSIGNED64, "rw"),
    (0x2011, 0, U16, "ro"),
    (0x2012, 0, U32, "ro"),
    (0x2013, 0, U16, "ro"),
    (0x605D, 0, I16, "rw"),
    (0x60C0, 0, I16, "rw"),
    (0x2120, 0, I32, "rw"),
    (0x2183, 0, U32, "rw"),
    (0x2300, 0, U16, "rw"),
]
NEWER = [(index, n, U32, "rw") for index in (0x608F, 0x6091, 0x6092) for n in (1, 2)]


@pytest.fixture(scope="module")
def dictionary() -> canopen.ObjectDictionary:
    return canopen.import_od(str(EDS), NODE_ID)


def variables(dictionary: canopen.ObjectDictionary) -> dict[tuple[int, int], ODVariable]:
    return {
        (variable.index, variable.subindex): variable
        for thing in dictionary.values()
        for variable in ([thing] if isinstance(thing, ODVariable) else thing.values())
    }


@pytest.mark.parametrize("row", NOTE + DRIVE + MAKER, ids=lambda row: f"{row[0]:04X}-{row[1]:02X}")
def test_object_is_as_documented(dictionary: canopen.ObjectDictionary, row: tuple) -> None:
    index, subindex, data_type, access = row
    found = variables(dictionary)[index, subindex]
    assert (found.data_type, found.access_type) == (data_type, access)


def test_no_other_objects_of_the_manufacturer_or_the_profile(
    dictionary: canopen.ObjectDictionary,
) -> None:
    found = {key for key in variables(dictionary) if key[0] >= 0x2000}
    counts = {(0x2193, 0), (0x607D, 0), (0x608F, 0), (0x6091, 0), (0x6092, 0)}
    named = {row[:2] for row in NOTE + DRIVE + MAKER + NEWER}
    assert found - counts == {key for key in named if key[0] >= 0x2000}
    assert 0x1016 not in dictionary  # the drive has no heartbeat consumer


def test_identity(dictionary: canopen.ObjectDictionary) -> None:
    assert dictionary[0x1000].default & 0xFFFF == 402
    assert dictionary[0x1018][1].default == 0xAB  # Copley Controls' number at CiA


def test_the_simulated_drive_has_every_object_with_its_size(
    dictionary: canopen.ObjectDictionary,
) -> None:
    drive = Copley(NODE_ID, factors={0x608F: (1, 1), 0x6091: (1, 1), 0x6092: (1, 1)})
    sizes = {I8: 1, U8: 1, I16: 2, U16: 2, I32: 4, U32: 4, OCTETS: 10}
    for (index, subindex), variable in variables(dictionary).items():
        if variable.data_type not in sizes or 0x1400 <= index < 0x2000:
            continue  # of a length of their own; PDO parameters
        entry = drive.dictionary[index, subindex]
        assert entry.type.size == sizes[variable.data_type], f"{index:04X}-{subindex:02X}"
        assert (entry.access in ("ro", "const")) == (variable.access_type in ("ro", "const"))


def test_the_simulated_drive_is_as_in_the_makers_table() -> None:
    """All its objects: access, type, range, default and PDO mapping. No other but the note's."""
    simulated = dict(Copley(NODE_ID).dictionary.items())
    checked = 0
    for fact in facts("copley_accelnet_2016.csv", NODE_ID):
        if fact.index in (0x2001, 0x250C):  # updating firmware; reading trace memory
            simulated.pop((fact.index, 0), None)
            continue  # is not simulated
        entry, name = simulated.pop((fact.index, fact.subindex)), fact.key
        if fact.size:  # else a string, or bytes
            assert (entry.type.size, entry.type.signed) == (fact.size, fact.signed), name
        assert entry.access.replace("const", "ro") == fact.access.replace("const", "ro"), name
        assert entry.mappable == fact.mappable, name
        if fact.default is not None and fact.access != "ro":
            off = 0x1400 <= fact.index <= 0x1BFF and fact.index & 4  # PDOs that are not used
            assert entry.default == fact.default or off, name
        if fact.limits is not None and fact.access != "ro":
            assert (
                entry.type.low if entry.low is None else entry.low,
                entry.type.high if entry.high is None else entry.high,
            ) == fact.limits, name
        checked += 1
    assert set(simulated) == {(index, 0) for index in range(0x2160, 0x2166)}
    assert checked > 500


def test_texts_and_bytes_are_kept_when_they_are_stored() -> None:
    drive = Copley(1)
    host = Host(drive)
    host.write_bytes(0x21A0, 0, b"elbow")  # axis name
    host.write_bytes(0x2106, 0, bytes(range(14)))  # coefficients of a filter
    host.write(0x1010, 4, 0x6576_6173, 4)  # save, manufacturer defined parameters
    host.write_bytes(0x21A0, 0, b"wrist, not stored")
    drive.power_off()
    drive.power_on(host.bus.now_us)
    assert drive.dictionary.upload(0x21A0, 0) == b"elbow"
    assert drive.dictionary.upload(0x2106, 0) == bytes(range(14))


@pytest.mark.parametrize(
    ("index", "subindex", "value", "size", "code"),
    [
        (0x2103, 0, -1, 4, 0x0609_0032),  # velocity loop limit: 0 … 500,000,000
        (0x2103, 0, 500_000_001, 4, 0x0609_0031),
        (0x2115, 0, 0, 2, 0x0601_0002),  # RMS current: read only
        (0x2110, 0, 0, 4, 0x0607_0012),  # peak current has two bytes
        (0x2110, 1, 0, 2, 0x0609_0011),
        (0x6007, 0, 3, 2, 0x0602_0000),
    ],
)
def test_what_the_maker_does_not_allow_is_refused(index, subindex, value, size, code) -> None:
    with pytest.raises(Abort) as abort:
        Host(Copley(1)).write(index, subindex, value, size)
    assert abort.value.code == code


@pytest.mark.parametrize("index", [0x1012, 0x1016, 0x6007])
def test_objects_that_the_maker_does_not_have(index: int) -> None:
    with pytest.raises(SdoAbort):
        Copley(NODE_ID).dictionary[index, 0]


def test_the_drivers_pdos_can_be_mapped() -> None:
    drive = Copley(NODE_ID)
    for mapping in (*copley.RPDO_MAPPINGS, *copley.TPDO_MAPPINGS):
        entries = [drive.dictionary[key] for key in mapping.objects]
        assert all(entry.mappable for entry in entries)
        assert sum(entry.type.size for entry in entries) <= 8


def test_object_lists_name_every_section_once() -> None:
    """CiA 306."""
    sections = configparser.RawConfigParser()
    sections.read_string(EDS.read_text(encoding="ascii"))
    listed: list[int] = []
    for name in ("MandatoryObjects", "OptionalObjects", "ManufacturerObjects"):
        section = sections[name]
        numbers = range(1, int(section["SupportedObjects"]) + 1)
        listed += [int(section[str(n)], 16) for n in numbers]
        assert len(section) == len(numbers) + 1
    described = {
        name[:4] for name in sections.sections() if name[:4].isalnum() and name[0] in "126"
    }
    assert sorted(f"{index:04X}" for index in listed) == sorted(described)
