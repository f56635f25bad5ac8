"""What a drive keeps through a power-off: the writable parameters of its dictionary, by maker.

The tables beside this file (`epos2.csv`, `copley.csv`, `cl3e.csv`) are from the makers' EDS of
2013, 2016 and 2014, with the tenth input of the EPOS2 50/5, and what later firmware of the CL3-E
has: everything that can be read and written, except what is not a setting (controlword, set-points,
buffers, counters, clocks, commands), what the maker calls internal, and node id and bit rate, which
say where on the bus the drive is. `step` is the order in which they are set: units (1), sensors and
motor (2), limits (3), what depends on these (4), mode and state (5). PDOs come after 4.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources

from epos2_ros.errors import ConfigurationError
from epos2_ros.protocol.identity import COPLEY, MAXON, NANOTEC

Value = int | str
INTEGERS = {
    f"{'i' if signed else 'u'}{8 * size}": (size, signed)
    for size in (1, 2, 4, 8)
    for signed in (False, True)
}
COB_ID, STRING, BYTES = "cob", "str", "bytes"
NODE = "$NODEID+"  # as in an EDS (CiA 306): the COB-ID follows the drive's own node id
LAST_STEP = 5


@dataclass(frozen=True)
class Parameter:
    """One sub-object that is stored."""

    index: int
    subindex: int
    type: str
    step: int
    unit: str
    name: str

    @property
    def address(self) -> str:
        return f"0x{self.index:04X}-{self.subindex:02X}"

    @property
    def is_pdo(self) -> bool:
        return 0x1400 <= self.index <= 0x1BFF

    @property
    def is_mapping(self) -> bool:
        """Whether it is one of the objects in a PDO."""
        return self.is_pdo and bool(self.index & 0x200) and self.subindex > 0

    def decode(self, data: bytes, node_id: int) -> Value:
        """From the bus. A COB-ID with the node id in it is told without; bytes are in hex."""
        if self.type == COB_ID:
            value = int.from_bytes(data, "little")
            return f"{NODE}0x{value - node_id:X}" if value & 0x7F == node_id else value
        if self.type == STRING:
            return data.rstrip(b"\0").decode("latin-1")
        if self.type == BYTES:
            return data.hex()
        size, signed = INTEGERS[self.type]
        return int.from_bytes(data[:size], "little", signed=signed)

    def encode(self, value: Value, node_id: int) -> bytes:
        """For the bus; ConfigurationError when the object can't hold it."""
        try:
            return self._encode(value, node_id)
        except (ValueError, OverflowError, UnicodeEncodeError, AttributeError):
            raise ConfigurationError(
                f"{self.address} ({self.name}): {value!r} is no value of type {self.type}"
            ) from None

    def _encode(self, value: Value, node_id: int) -> bytes:
        if self.type == STRING:
            return str(value).encode("latin-1")
        if self.type == BYTES:
            return bytes.fromhex(str(value))
        if self.type == COB_ID:
            if isinstance(value, str):
                if not value.startswith(NODE):
                    raise ValueError
                value = int(value.removeprefix(NODE), 0) + node_id
            return value.to_bytes(4, "little")
        if not isinstance(value, int) or isinstance(value, bool):
            raise ValueError
        size, signed = INTEGERS[self.type]
        return value.to_bytes(size, "little", signed=signed)


@dataclass(frozen=True)
class Pdos:
    """How many PDOs a drive has each way, and how many objects in one."""

    count: int
    objects: int


_TABLES: Mapping[int, tuple[str, Pdos]] = {
    MAXON: ("epos2.csv", Pdos(4, 8)),
    COPLEY: ("copley.csv", Pdos(8, 4)),
    NANOTEC: ("cl3e.csv", Pdos(4, 8)),
}


@cache
def parameters_of(vendor_id: int) -> dict[str, Parameter]:
    """By address, for a maker's drives; ConfigurationError when there is no table."""
    if vendor_id not in _TABLES:
        raise ConfigurationError(
            f"the parameters of drives of vendor 0x{vendor_id:08X} are not known; those of maxon "
            "EPOS2, Copley and Nanotec CL3-E drives are"
        )
    name, pdos = _TABLES[vendor_id]
    text = (resources.files("epos2_ros") / "commission" / name).read_text(encoding="utf-8")
    listed = [
        Parameter(*_address(row["object"]), row["type"], int(row["step"]), row["unit"], row["name"])
        for row in csv.DictReader(text.splitlines())
    ]
    return {parameter.address: parameter for parameter in [*listed, *_pdo_parameters(pdos)]}


def _address(text: str) -> tuple[int, int]:
    index, _, subindex = text.partition("-")
    return int(index, 16), int(subindex, 16)


def _pdo_parameters(pdos: Pdos) -> list[Parameter]:
    """Communication and mapping parameters (CiA 301, 7.5.2.35 – 38)."""
    made = []
    for kind, base in (("RPDO", 0x1400), ("TPDO", 0x1800)):
        for number in range(1, pdos.count + 1):
            index, name = base + number - 1, f"{kind}{number}"
            made += [
                Parameter(index, 1, COB_ID, 4, "", f"COB-ID of {name}"),
                Parameter(index, 2, "u8", 4, "", f"Transmission type of {name}"),
            ]
            if kind == "TPDO":
                made += [Parameter(index, 3, "u16", 4, "100 us", f"Inhibit time of {name}")]
            index += 0x200
            made += [Parameter(index, 0, "u8", 4, "", f"Number of objects in {name}")]
            made += [
                Parameter(index, place, "u32", 4, "", f"Object {place} in {name}")
                for place in range(1, pdos.objects + 1)
            ]
    return made
