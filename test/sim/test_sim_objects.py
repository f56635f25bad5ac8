"""Objects of the simulated EPOS2: type, access, default, range and PDO mapping.

The tables are typed from maxon, application note "Interpolation Position Mode" (tables 4,
5, 8 and 17, section 3.6), where misprinted with the correction in a comment, and from CiA 301.
"""

from __future__ import annotations

import pytest
from sim_host import Abort, Host, prompt_drive

READ_ONLY, WRITE_ONLY = 0x06010002, 0x06010001

# index, sub-index, bytes, signed, access, default (None: not given), PDO mapping (None: not given)
NOTE = [
    (0x1012, 0, 4, False, "rw", 0x100, False),
    (0x1013, 0, 4, False, "rw", None, True),
    (0x20C1, 0, 8, False, "wo", None, True),
    (0x20C4, 1, 2, False, "ro", None, True),
    (0x20C4, 2, 2, False, "rw", 4, False),
    (0x20C4, 3, 2, False, "rw", 60, False),
    (0x60C0, 0, 2, True, "rw", -1, False),
    (0x60C2, 1, 1, False, "rw", 1, False),
    (0x60C2, 2, 1, True, "rw", -3, False),  # printed as sub-index 1
    (0x60C4, 1, 4, False, "ro", 64, False),
    (0x60C4, 2, 4, False, "ro", 64, True),
    (0x60C4, 3, 1, False, "rw", 0, False),
    (0x60C4, 4, 2, False, "rw", 0, False),
    (0x60C4, 5, 1, False, "wo", None, False),
    (0x60C4, 6, 1, False, "wo", None, False),
    # table 17
    (0x6065, 0, 4, False, "rw", 2000, None),
    (0x607D, 1, 4, True, "rw", -2147483648, None),
    (0x607D, 2, 4, True, "rw", 2147483647, None),
    (0x607F, 0, 4, False, "rw", 25000, None),
    (0x60C5, 0, 4, False, "rw", 4294967295, None),
    (0x6081, 0, 4, False, "rw", 1000, None),
    (0x6083, 0, 4, False, "rw", 10000, None),
    (0x6084, 0, 4, False, "rw", 10000, None),
    (0x6085, 0, 4, False, "rw", 10000, None),  # printed as 0x6084
    # CiA 402
    (0x6040, 0, 2, False, "rw", 0, True),
    (0x6041, 0, 2, False, "ro", None, True),
    (0x6060, 0, 1, True, "rw", None, True),
    (0x6061, 0, 1, True, "ro", None, True),
    (0x6062, 0, 4, True, "ro", 0, True),
    (0x6064, 0, 4, True, "ro", 0, True),
    (0x6067, 0, 4, False, "rw", 4294967295, None),
    (0x6068, 0, 2, False, "rw", 0, None),
    (0x606C, 0, 4, True, "ro", 0, True),
    (0x6078, 0, 2, True, "ro", 0, True),
    (0x2027, 0, 2, True, "ro", 0, True),
    (0x20F4, 0, 2, True, "ro", 0, True),
    (0x607A, 0, 4, True, "rw", 0, True),
    (0x607C, 0, 4, True, "rw", 0, None),
    (0x6086, 0, 2, True, "rw", 0, None),
    (0x608B, 0, 1, True, "rw", 0, None),
    (0x6098, 0, 1, True, "rw", None, None),
    (0x6099, 1, 4, False, "rw", None, None),
    (0x6099, 2, 4, False, "rw", None, None),
    (0x609A, 0, 4, False, "rw", None, None),
    # CiA 301
    (0x1000, 0, 4, False, "ro", 0x00020192, False),
    (0x1001, 0, 1, False, "ro", 0, True),
    (0x1005, 0, 4, False, "rw", 0x80, False),
    (0x1006, 0, 4, False, "rw", 0, False),
    (0x1014, 0, 4, False, "rw", 0x81, False),
    (0x1016, 1, 4, False, "rw", 0, False),
    (0x1017, 0, 2, False, "rw", 0, False),
    (0x1018, 1, 4, False, "ro", 0x000000FB, False),
]
ENTRIES = {0x1018: 4, 0x20C4: 3, 0x60C2: 2, 0x60C4: 6, 0x607D: 2, 0x6099: 2}
# index, sub-index, bytes, values that are taken
ONLY = [
    (0x1012, 0, 4, [0x100]),
    (0x20C4, 2, 2, [0, 63]),
    (0x20C4, 3, 2, [1, 64]),
    (0x60C0, 0, 2, [-1]),
    (0x60C2, 1, 1, [1]),
    (0x60C2, 2, 1, [-3]),
    (0x60C4, 3, 1, [0]),
    (0x60C4, 4, 2, [0, 64]),
    (0x60C4, 5, 1, [8]),
    (0x60C4, 6, 1, [0, 1]),
    (0x608B, 0, 1, [-3, 0]),
    (0x6086, 0, 2, [0]),
]


@pytest.fixture
def host() -> Host:
    return Host(prompt_drive(1))


def name(row: tuple[object, ...]) -> str:
    return f"{row[0]:04X}-{row[1]:02X}"


@pytest.mark.parametrize("row", NOTE, ids=name)
def test_type_access_and_default(host: Host, row: tuple[int, int, int, bool, str, int]) -> None:
    index, subindex, size, signed, access, default, *_ = row
    if access == "wo":
        with pytest.raises(Abort) as abort:
            host.read(index, subindex)
        assert abort.value.code == WRITE_ONLY
    else:
        data = host.read_bytes(index, subindex)
        assert len(data) == size
        if default is not None:
            assert int.from_bytes(data, "little", signed=signed) == default
    if access == "ro":
        with pytest.raises(Abort) as abort:
            host.write_bytes(index, subindex, bytes(size))
        assert abort.value.code == READ_ONLY
    elif size <= 4:
        with pytest.raises(Abort) as abort:
            host.write_bytes(index, subindex, bytes(size % 4 + 1))
        assert abort.value.code in (0x06070012, 0x06070013)


@pytest.mark.parametrize("row", [row for row in NOTE if row[-1] is not None], ids=name)
def test_pdo_mapping(host: Host, row: tuple[int, int, int, bool, str, int, bool]) -> None:
    """A mappable object goes into PDOs of the direction its access allows, others into none."""
    index, subindex, size, _, access, _, mappable = row
    entry = index << 16 | subindex << 8 | 8 * size
    for mapping, allowed in ((0x1600, access != "ro"), (0x1A00, access != "wo")):
        if mappable and allowed:
            host.write(mapping, 1, entry, 4)
        else:
            with pytest.raises(Abort) as abort:
                host.write(mapping, 1, entry, 4)
            assert abort.value.code == 0x06040041


@pytest.mark.parametrize(("index", "count"), ENTRIES.items(), ids=lambda x: f"{x:X}")
def test_number_of_entries(host: Host, index: int, count: int) -> None:
    assert host.read(index, 0) == count


@pytest.mark.parametrize("row", ONLY, ids=name)
def test_value_range(host: Host, row: tuple[int, int, int, list[int]]) -> None:
    index, subindex, size, bounds = row
    low, high = bounds[0], bounds[-1]
    for value in bounds:
        host.write(index, subindex, value, size)
    out_of_range = {0x06090030, 0x06090031, 0x06090032}
    for value in (low - 1, high + 1):
        if value < 0 <= low:
            continue  # not in an unsigned object
        with pytest.raises(Abort) as abort:
            host.write(index, subindex, value, size)
        assert abort.value.code in out_of_range


def test_buffer_position_ignores_what_is_written(host: Host) -> None:
    """0x60C4-04: "Writing to this object has no effect"."""
    host.write(0x60C4, 4, 17, 2)
    assert host.read(0x60C4, 4) == 0


def test_identity_is_what_was_ordered() -> None:
    host = Host(prompt_drive(7, product_code=0x6321_0000, revision=0x2126_0000, serial=42))
    assert host.read(0x1018, 1, node=7) == 0xFB
    assert host.read(0x1018, 2, node=7) == 0x6321_0000
    assert host.read(0x1018, 3, node=7) == 0x2126_0000
    assert host.read(0x1018, 4, node=7) == 42


@pytest.mark.parametrize("node", [0, 128, -1])
def test_node_ids(node: int) -> None:
    with pytest.raises(ValueError, match="1 … 127"):
        prompt_drive(node)


def test_supported_modes(host: Host) -> None:
    """Profile position is bit 0, homing bit 5, interpolated position bit 6 (CiA 402)."""
    assert host.read(0x6502) == 0b0110_0001


def test_velocity_limit_is_25000_rpm_in_every_notation(host: Host) -> None:
    with pytest.raises(Abort):
        host.write(0x607F, 0, 25_001, 4)
    host.write(0x608B, 0, -3, 1)
    host.write(0x607F, 0, 25_000_000, 4)
    with pytest.raises(Abort):
        host.write(0x607F, 0, 25_000_001, 4)


def test_velocity_notation_does_not_change_under_power(host: Host) -> None:
    host.enable(7)
    with pytest.raises(Abort) as abort:
        host.write(0x608B, 0, -1, 1)
    assert abort.value.code == 0x08000022
