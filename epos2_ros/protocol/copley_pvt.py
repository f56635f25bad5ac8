"""The PVT buffer of Copley drives: what goes into 0x2010, and what 0x2012 says.

Bytes and bits are those of the maker's EDS and motion library. A segment has position and velocity
at its *start* and the time to the next; that of time 0 ends the path. Byte 0 has a counter, the low
3 bits of a 16-bit id, by which the drive notices that one is missing, and the format: positions are
24 bits, absolute or, beyond them, relative to the segment before; velocities are 24 bits of 0.1 or
10 counts/s. A 32-bit position alone, of no time, says where the first segment counts from. With
bit 7 set byte 0 is a command to the buffer, after which it needs PAUSE_US.
"""

from __future__ import annotations

from typing import NamedTuple

from epos2_ros.motion.units import INT24_MAX
from epos2_ros.protocol.sdo import SdoRead

PVT_DATA = 0x2010
BUFFER_STATUS = SdoRead(0x2012, 0, 4)
INTERPOLATION_CUBIC = -2  # of 0x60C0

IDS = 1 << 16
COUNTED = 8  # ids that the counter tells apart
PAUSE_US = 50_000.0  # after a command to the buffer, by those who drive real ones
FINE_COUNTS_S, COARSE_COUNTS_S = 0.1, 10.0  # units of velocity

FLUSH, CLEAR_ERRORS = b"\x80", b"\x82"  # commands; errors by the mask in byte 1
SEQUENCE, OVERFLOW, UNDERFLOW = 1, 2, 4
_COARSE, _RELATIVE, _POSITION = 1, 2, 4  # formats, in bits 3–6 of byte 0


class BufferStatus(NamedTuple):
    """0x2012."""

    next_id: int
    free: int
    errors: int
    empty: bool

    @classmethod
    def of(cls, value: int) -> BufferStatus:
        return cls(value & 0xFFFF, value >> 16 & 0xFF, value >> 24 & 7, bool(value >> 31))


def velocity_unit(fastest_counts_s: float) -> float:
    """The finest unit in which the velocities of an axis have 24 bits [counts/s]."""
    return FINE_COUNTS_S if fastest_counts_s <= INT24_MAX * FINE_COUNTS_S else COARSE_COUNTS_S


def initial_position(number: int, position: int) -> bytes:
    """Where a path counts from."""
    return bytes([_head(number, _POSITION)]) + _signed(position, 4) + bytes(3)


def segment(
    number: int, before: int, position: int, velocity: int, time_ms: int, coarse: bool
) -> bytes:
    """One that begins at `position` [counts] with `velocity` [0.1 or, `coarse`, 10 counts/s].

    `before`: where the one before it began.
    """
    relative = not -INT24_MAX <= position <= INT24_MAX
    kind = _COARSE * coarse | _RELATIVE * relative
    place = position - before if relative else position
    return bytes([_head(number, kind), time_ms]) + _signed(place, 3) + _signed(velocity, 3)


def clear_errors(errors: int) -> bytes:
    """The command that clears these bits."""
    return (CLEAR_ERRORS + bytes([errors])).ljust(8, b"\0")


def remedy(status: int) -> bytes:
    """The next command towards an empty buffer without errors; b"" if it is that."""
    told = BufferStatus.of(status)
    if not told.empty:
        return FLUSH.ljust(8, b"\0")
    return clear_errors(told.errors) if told.errors else b""


def describe_errors(status: int) -> str:
    """What can't be made good; a sequence error can."""
    errors = BufferStatus.of(status).errors
    words = {UNDERFLOW: "its PVT buffer has run empty", OVERFLOW: "its PVT buffer was overfull"}
    return ", ".join(text for bit, text in words.items() if errors & bit)


def flags(status: int, statusword: int) -> dict[str, bool]:
    """What this status has of that of an EPOS2's buffer, by its names."""
    errors = BufferStatus.of(status).errors
    active = bool(statusword & 0x1000)
    names = "underflow_warning", "overflow_warning", "velocity_warning", "acceleration_warning"
    return {
        **dict.fromkeys(names, False),
        "underflow_error": bool(errors & UNDERFLOW),
        "overflow_error": bool(errors & OVERFLOW),
        "velocity_error": False,
        "acceleration_error": False,
        "buffer_enabled": True,
        "ip_mode_active": active,
    }


def _head(number: int, kind: int) -> int:
    return number % COUNTED | kind << 3


def _signed(value: int, size: int) -> bytes:
    return value.to_bytes(size, "little", signed=True)
