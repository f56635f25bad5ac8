"""One device as it answered: values by object, or why there is none."""

from __future__ import annotations

from dataclasses import dataclass, field

from epos2_ros.bus.identity import DEVICE_NAME, IDENTITY, SOFTWARE_VERSION
from epos2_ros.commission.uploads import Address, Answer, Refusal
from epos2_ros.protocol.identity import Identity

DEVICE_TYPE = 0x1000
NO_OBJECT, NO_SUBINDEX = 0x0602_0000, 0x0609_0011  # abort codes (CiA 301, table 22)


@dataclass
class Found:
    """The answers of one node id."""

    node_id: int
    answers: dict[Address, Answer] = field(default_factory=dict)

    @property
    def answered(self) -> bool:
        """Whether there is a device: even a refusal comes from one."""
        return any(answer is not None for answer in self.answers.values())

    def integer(self, index: int, subindex: int = 0, signed: bool = False) -> int | None:
        """The value of an object; None when it has not been told."""
        answer = self.answers.get((index, subindex))
        if not isinstance(answer, bytes) or not answer:
            return None
        return int.from_bytes(answer, "little", signed=signed)

    def text(self, index: int) -> str:
        """The value of a string object, what can't be printed left out; "" when there is none."""
        answer = self.answers.get((index, 0))
        if not isinstance(answer, bytes):
            return ""
        return "".join(filter(str.isprintable, answer.decode("latin-1"))).strip()

    def lacks(self, index: int, subindex: int = 0) -> bool:
        """Whether the device says that it does not know the object."""
        answer = self.answers.get((index, subindex))
        return isinstance(answer, Refusal) and answer.code in (NO_OBJECT, NO_SUBINDEX)

    @property
    def identity(self) -> Identity:
        vendor, product, revision, serial = (self.integer(IDENTITY, n) or 0 for n in range(1, 5))
        return Identity(
            vendor,
            product,
            revision,
            serial,
            self.text(DEVICE_NAME),
            self.text(SOFTWARE_VERSION),
        )
