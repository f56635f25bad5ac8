"""The interpolation data record 0x20C1 of the EPOS2 as a value.

Source: application note "Interpolation Position Mode", table 1 and 3.6.3; what a
record means: a record is the *end* of a segment and its time is how long the segment
lasts; the record with time 0 only ends the motion.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

MAX_SEGMENT_MS = 255
_POSITION = struct.Struct("<i")


class Record(NamedTuple):
    """One PVT reference point in the drive's units."""

    position: int  # absolute [qc], int32
    velocity: int  # [velocity units: 10^n rpm of the motor], int24
    time: int  # duration of the segment that ends here [ms], 1 … 255; 0 ends the motion

    def pack(self) -> bytes:
        """The 8 bytes on the bus: position int32, velocity int24, time uint8, little-endian."""
        return (
            _POSITION.pack(self.position)
            + self.velocity.to_bytes(3, "little", signed=True)
            + self.time.to_bytes(1, "little")
        )

    @classmethod
    def unpack(cls, data: bytes) -> Record:
        """Inverse of `pack`; `data` has 8 bytes."""
        return cls(
            _POSITION.unpack_from(data)[0],
            int.from_bytes(data[4:7], "little", signed=True),
            data[7],
        )
