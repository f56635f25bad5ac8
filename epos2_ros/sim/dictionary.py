"""The object dictionary of a simulated CANopen device.

An `Entry` is one sub-object: its type, access, value range and whether it can be mapped
into a PDO. `ObjectDictionary` finds entries and applies the rules of an SDO access to
them; what it refuses it refuses with the abort code of CiA 301, table 22.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, field
from enum import IntEnum


class AbortCode(IntEnum):
    """SDO abort codes (CiA 301, 7.2.4.3.17)."""

    TOGGLE_BIT = 0x0503_0000
    COMMAND_SPECIFIER = 0x0504_0001
    UNSUPPORTED_ACCESS = 0x0601_0000
    WRITE_ONLY = 0x0601_0001
    READ_ONLY = 0x0601_0002
    NO_OBJECT = 0x0602_0000
    NOT_MAPPABLE = 0x0604_0041
    PDO_LENGTH = 0x0604_0042
    PARAMETER_INCOMPATIBLE = 0x0604_0043
    LENGTH_MISMATCH = 0x0607_0010
    LENGTH_TOO_HIGH = 0x0607_0012
    LENGTH_TOO_LOW = 0x0607_0013
    NO_SUBINDEX = 0x0609_0011
    VALUE_RANGE = 0x0609_0030
    VALUE_TOO_HIGH = 0x0609_0031
    VALUE_TOO_LOW = 0x0609_0032
    STORING = 0x0800_0020  # data can't be transferred or stored
    DEVICE_STATE = 0x0800_0022


SAVE, LOAD = 0x6576_6173, 0x6461_6F6C  # "save" and "load" (CiA 301, 7.5.2.13 and 7.5.2.14)


class SdoAbort(Exception):
    """An access the device refuses; `code` goes out in the abort message."""

    def __init__(self, code: AbortCode) -> None:
        super().__init__(f"{code.name} (0x{code:08X})")
        self.code = code


def check_signature(signature: int, value: int) -> None:
    """Storing and restoring take their own signature, so that nothing does it by chance."""
    if value != signature:
        raise SdoAbort(AbortCode.STORING)


@dataclass(frozen=True)
class DataType:
    """A data type of CiA 301, 7.1; `size` in bytes, 0 for a string of any length."""

    size: int
    signed: bool = False

    @property
    def low(self) -> int:
        return -(1 << (8 * self.size - 1)) if self.signed else 0

    @property
    def high(self) -> int:
        return (1 << (8 * self.size - self.signed)) - 1

    def pack(self, value: int) -> bytes:
        return value.to_bytes(self.size, "little", signed=self.signed)

    def unpack(self, data: bytes) -> int:
        return int.from_bytes(data, "little", signed=self.signed)


INTEGER8 = DataType(1, signed=True)
INTEGER16 = DataType(2, signed=True)
INTEGER32 = DataType(4, signed=True)
UNSIGNED8 = DataType(1)
UNSIGNED16 = DataType(2)
UNSIGNED32 = DataType(4)
UNSIGNED64 = DataType(8)
VISIBLE_STRING = DataType(0)
OCTET_STRING = DataType(0)
LONGEST_TEXT = 255  # bytes that an object of either takes


@dataclass(slots=True)
class Entry:
    """One sub-object.

    The hooks bind it to the device: `read()` gives the value at this moment, `check(value)`
    may raise `SdoAbort` to refuse a new one, `write(value)` acts on it once it is stored.
    `fast` marks values that may change in any control cycle (a PDO that holds one has to be
    looked at in each). Where a PDO is not sent for every change of the value, `event()` changes
    with what it is sent for.
    """

    name: str
    type: DataType
    access: str = "rw"  # "ro", "rw", "rww" (mappable for reception only), "wo" or "const"
    value: int = 0
    low: int | None = None  # range narrower than the type's
    high: int | None = None
    mappable: bool = False
    read: Callable[[], int] | None = None
    check: Callable[[int], None] | None = None
    write: Callable[[int], None] | None = None
    fast: bool = False
    event: Callable[[], int] | None = None
    text: bytes = b""  # the value of one without a size
    default: int = field(init=False)  # as it left the factory
    stored: int = field(init=False)  # what it has after power-on
    stored_text: bytes = field(init=False)

    def __post_init__(self) -> None:
        self.stored_text = self.text
        self.preset(self.value)

    def preset(self, value: int) -> None:
        """The value the device left the factory with, and has now."""
        self.value = self.stored = self.default = value

    def keep(self) -> None:
        """What it holds now it has after power-on."""
        self.stored, self.stored_text = self.value, self.text

    def restore(self) -> None:
        """Power-on."""
        self.value, self.text = self.stored, self.stored_text

    def get(self) -> int:
        return self.value if self.read is None else self.read()

    def pack(self) -> bytes:
        """The value as it is on the bus."""
        return self.type.pack(self.get()) if self.type.size else self.text

    def trigger(self) -> bytes:
        """What an event-driven PDO that holds it is sent for, when it changes."""
        return self.pack() if self.event is None else self.event().to_bytes(8, "little")

    def set(self, value: int) -> None:
        """Checks, stores and acts. Raises `SdoAbort`."""
        low = self.type.low if self.low is None else self.low
        high = self.type.high if self.high is None else self.high
        if not low <= value <= high:
            if low == high:
                raise SdoAbort(AbortCode.VALUE_RANGE)
            raise SdoAbort(AbortCode.VALUE_TOO_HIGH if value > high else AbortCode.VALUE_TOO_LOW)
        if self.check is not None:
            self.check(value)
        self.value = value
        if self.write is not None:
            self.write(value)


class ObjectDictionary:
    """Entries by (index, subindex)."""

    def __init__(self) -> None:
        self._entries: dict[tuple[int, int], Entry] = {}
        self._indices: set[int] = set()

    def variable(self, index: int, entry: Entry, subindex: int = 0) -> Entry:
        """Adds one entry and gives it back."""
        self._entries[index, subindex] = entry
        self._indices.add(index)
        return entry

    def record(self, index: int, *entries: Entry) -> None:
        """Sub-objects 1 … n and the constant number of entries at sub-index 0."""
        self.variable(index, Entry("Number of entries", UNSIGNED8, "const", len(entries)))
        for subindex, entry in enumerate(entries, 1):
            self.variable(index, entry, subindex)

    def keep(self, keys: Collection[tuple[int, int]]) -> None:
        """Forgets every entry that is not at one of these (index, subindex)."""
        self._entries = {key: entry for key, entry in self._entries.items() if key in keys}
        self._indices = {index for index, _ in self._entries}

    def __contains__(self, key: tuple[int, int]) -> bool:
        return key in self._entries

    def __getitem__(self, key: tuple[int, int]) -> Entry:
        """The entry at (index, subindex). Raises `SdoAbort` if there is none."""
        entry = self._entries.get(key)
        if entry is None:
            known = key[0] in self._indices
            raise SdoAbort(AbortCode.NO_SUBINDEX if known else AbortCode.NO_OBJECT)
        return entry

    def items(self) -> Iterable[tuple[tuple[int, int], Entry]]:
        return self._entries.items()

    def upload(self, index: int, subindex: int) -> bytes:
        """Reads like an SDO client. Raises `SdoAbort`."""
        entry = self[index, subindex]
        if entry.access == "wo":
            raise SdoAbort(AbortCode.WRITE_ONLY)
        return entry.pack()

    def check_download(self, index: int, subindex: int, size: int | None) -> Entry:
        """The entry, if a client may write `size` bytes (`None`: not told) to it."""
        entry = self[index, subindex]
        if entry.access in ("ro", "const"):
            raise SdoAbort(AbortCode.READ_ONLY)
        if size is not None and not entry.type.size:
            if size > LONGEST_TEXT:
                raise SdoAbort(AbortCode.LENGTH_TOO_HIGH)
        elif size is not None and size != entry.type.size:
            too_long = size > entry.type.size
            raise SdoAbort(AbortCode.LENGTH_TOO_HIGH if too_long else AbortCode.LENGTH_TOO_LOW)
        return entry

    def download(self, index: int, subindex: int, data: bytes) -> None:
        """Writes like an SDO client. Raises `SdoAbort`."""
        entry = self.check_download(index, subindex, len(data))
        if entry.type.size:
            entry.set(entry.type.unpack(data))
        else:
            entry.text = data
