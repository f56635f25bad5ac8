"""Object accesses as values: the protocol layer says what to write and read, the bus does it."""

from __future__ import annotations

from dataclasses import dataclass


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


@dataclass(frozen=True)
class SdoRead:
    """A sub-object that holds an integer."""

    index: int
    subindex: int
    size: int
    signed: bool = False

    def decode(self, data: bytes) -> int:
        return int.from_bytes(data[: self.size], "little", signed=self.signed)
