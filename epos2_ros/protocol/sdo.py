"""Object accesses as values: the protocol layer says what to write and read, the bus does it."""

from __future__ import annotations

from dataclasses import dataclass

NO_OBJECT, NO_SUBINDEX, NOT_MAPPABLE = 0x0602_0000, 0x0609_0011, 0x0604_0041

OTHER_DRIVE = "check axes.{joint}.drive and the drive's firmware"
_VALUE = "check the parameters of axes.{joint} that it comes from"
_BUSY = "switch the drive off and on again; if it stays so, it is broken"
_CONTROL = "close other programs that talk to the drive, by USB or RS232, too"
_FRAMES = "check that no other device has this node id and that the bus is not disturbed"

# In words, and what to check: CiA 301, 7.2.4.3.17, and from 0x0F00FFB9 on what maxon adds.
_ABORTS = {
    0x0503_0000: ("the toggle bit was not alternated", _FRAMES),
    0x0504_0000: ("the transfer took too long", _FRAMES),
    0x0504_0001: ("unknown command", OTHER_DRIVE),
    0x0504_0002: ("invalid block size", OTHER_DRIVE),
    0x0504_0003: ("invalid sequence number", _FRAMES),
    0x0504_0004: ("CRC error", _FRAMES),
    0x0504_0005: ("out of memory", _BUSY),
    0x0601_0000: ("the object can't be accessed like that", OTHER_DRIVE),
    0x0601_0001: ("the object can only be written", OTHER_DRIVE),
    0x0601_0002: ("the object can only be read", OTHER_DRIVE),
    NO_OBJECT: ("it has no such object", OTHER_DRIVE),
    NOT_MAPPABLE: ("the object can't be mapped into this PDO", OTHER_DRIVE),
    0x0604_0042: ("the objects are too many or too long for a PDO", OTHER_DRIVE),
    0x0604_0043: ("the parameters don't go together", _VALUE),
    0x0604_0047: ("incompatible inside the drive", _BUSY),
    0x0606_0000: ("a hardware error", _BUSY),
    0x0607_0010: ("the value has another length", OTHER_DRIVE),
    0x0607_0012: ("the value is too long", OTHER_DRIVE),
    0x0607_0013: ("the value is too short", OTHER_DRIVE),
    NO_SUBINDEX: ("the object has no such sub-index", OTHER_DRIVE),
    0x0609_0030: ("the value is out of range", _VALUE),
    0x0609_0031: ("the value is too high", _VALUE),
    0x0609_0032: ("the value is too low", _VALUE),
    0x0609_0036: ("the maximum is below the minimum", _VALUE),
    0x060A_0023: ("it has no resources for that", _BUSY),
    0x0800_0000: ("a general error", _BUSY),
    0x0800_0020: ("the value can't be transferred or stored", _BUSY),
    0x0800_0021: ("something else has the control", _CONTROL),
    0x0800_0022: ("not in the state that the drive is in", _CONTROL),
    0x0800_0023: ("it has no object dictionary", _BUSY),
    0x0800_0024: ("there is no data", _BUSY),
    0x0F00_FFB9: ("wrong node id", _FRAMES),
    0x0F00_FFBC: ("it is not in service mode", _CONTROL),
    0x0F00_FFBE: ("the password is wrong", _CONTROL),
    0x0F00_FFBF: ("it has no such command", OTHER_DRIVE),
    0x0F00_FFC0: ("not in this NMT state", _CONTROL),
}
ABORT_CODES = tuple(_ABORTS)


def describe_abort(code: int, joint: str, check: str = "") -> str:
    """An SDO abort code in words, and what to check; `check` is that for a refused value."""
    words, advice = _ABORTS.get(code, ("for a reason that no document gives", _BUSY))
    advice = check if check and advice is _VALUE else advice.format(joint=joint)
    return f"{words} (0x{code:08X}); {advice}"


def multiplexer(index: int, subindex: int) -> bytes:
    """A sub-object, as SDO frames name it."""
    return index.to_bytes(2, "little") + bytes([subindex])


@dataclass(frozen=True)
class SdoWrite:
    """Data for one sub-object, as it is on the bus (little-endian)."""

    index: int
    subindex: int
    data: bytes

    @classmethod
    def integer(
        cls, index: int, subindex: int, value: int, size: int, signed: bool = False
    ) -> SdoWrite:
        """An integer of `size` bytes; OverflowError when it does not fit."""
        return cls(index, subindex, value.to_bytes(size, "little", signed=signed))

    @property
    def request(self) -> bytes:
        """The frame that writes it at once, where it has no more than four bytes."""
        expedited = bytes([0x23 | (4 - len(self.data)) << 2])
        return expedited + multiplexer(self.index, self.subindex) + self.data.ljust(4, b"\0")


@dataclass(frozen=True)
class SdoRead:
    """A sub-object that holds an integer."""

    index: int
    subindex: int
    size: int
    signed: bool = False

    def decode(self, data: bytes) -> int:
        return int.from_bytes(data[: self.size], "little", signed=self.signed)

    @property
    def request(self) -> bytes:
        """The frame that asks for it."""
        return b"\x40" + multiplexer(self.index, self.subindex) + bytes(4)

    def answered(self, frame: bytes) -> int | None:
        """The value in a frame that answers it at once; None if it is of anything else."""
        expedited = bytes([0x43 | (4 - self.size) << 2])
        wanted = expedited + multiplexer(self.index, self.subindex)
        return self.decode(frame[4:]) if len(frame) == 8 and frame[:4] == wanted else None
