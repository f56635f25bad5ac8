"""Process data objects of a simulated device, with the rules of CiA 301, 7.2.2 and 7.5.2.35 ff.

A PDO is a communication record (COB-ID, transmission type, inhibit time) and a mapping.
The mapping changes only while the PDO is invalid (bit 31 of the COB-ID) and its number
of entries is 0; writing that number checks objects and length.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Sequence
from contextlib import suppress

from .dictionary import (
    UNSIGNED8,
    UNSIGNED16,
    UNSIGNED32,
    AbortCode,
    Entry,
    ObjectDictionary,
    SdoAbort,
)

INVALID = 1 << 31
NO_REMOTE = 1 << 30
EXTENDED = 1 << 29
MAX_ENTRIES = 8
PREDEFINED = 4  # PDOs each way have an identifier of the predefined connection set (7.3.5)

ACYCLIC = 0  # at a SYNC, if anything has changed
REMOTE_REQUEST = 253
MAX_SYNCHRONOUS = 240
_ID_BITS = 0x1FFF_FFFF


def is_restricted(can_id: int) -> bool:
    """Whether no PDO may use the identifier (CiA 301, 7.3.5, table 40)."""
    return (
        can_id <= 0x07F
        or 0x101 <= can_id <= 0x180
        or 0x581 <= can_id <= 0x5FF
        or 0x601 <= can_id <= 0x67F
        or 0x6E0 <= can_id <= 0x6FF
        or can_id >= 0x701
    )


class Pdo:
    """What both directions share: COB-ID, transmission type and mapping.

    `changed` is called after the PDO was switched on or off.
    """

    def __init__(
        self,
        communication_index: int,
        default_can_id: int,
        dictionary: ObjectDictionary,
        changed: Callable[[], None],
        entries: int,
    ) -> None:
        self._dictionary = dictionary
        self._changed = changed
        self.cob_id = Entry("COB-ID", UNSIGNED32, value=INVALID | default_can_id)
        self.cob_id.check, self.cob_id.write = self._check_cob_id, self._on_configured
        self.transmission = Entry("Transmission type", UNSIGNED8, value=255)
        self.transmission.check = self._check_transmission
        self.transmission.write = self._on_configured
        self.count = Entry("Number of mapped objects", UNSIGNED8, low=0, high=entries)
        self.count.check, self.count.write = self._check_count, self._on_count
        self.slots = [
            Entry(f"Mapped object {n}", UNSIGNED32, check=self._check_slot)
            for n in range(1, entries + 1)
        ]
        self.types: Container[int] = range(1, 256)  # that this device has, of those that exist
        self.entries: list[Entry] = []  # what the mapping stands for
        self.fast = False  # one of them may change in any control cycle
        dictionary.record(
            communication_index, self.cob_id, self.transmission, *self._more_communication()
        )
        mapping_index = communication_index + 0x200
        dictionary.variable(mapping_index, self.count)
        for subindex, slot in enumerate(self.slots, 1):
            dictionary.variable(mapping_index, slot, subindex)

    def _more_communication(self) -> tuple[Entry, ...]:
        return ()

    def _fits(self, entry: Entry) -> bool:
        """Whether the access of a mappable entry suits the direction."""
        raise NotImplementedError

    @property
    def valid(self) -> bool:
        return not self.cob_id.value & INVALID

    @property
    def can_id(self) -> int:
        return self.cob_id.value & 0x7FF

    @property
    def synchronous(self) -> bool:
        return self.transmission.value <= MAX_SYNCHRONOUS

    def preset(self, cob_id: int, mapping: Sequence[int]) -> None:
        """As the device leaves the factory; the objects have to be in the dictionary."""
        self.cob_id.preset(cob_id)
        self.count.preset(len(mapping))
        for slot, mapped in zip(self.slots, mapping, strict=False):
            slot.preset(mapped)
        self.reset()

    def reset(self) -> None:
        """All entries went back to what they have after power-on."""
        self._on_count(self.count.value)
        self.restart()

    def restart(self) -> None:
        """The PDO was configured anew, or the NMT state has changed."""

    def _on_configured(self, _: int) -> None:
        self.restart()
        self._changed()

    def _check_cob_id(self, value: int) -> None:
        if value & EXTENDED or value & _ID_BITS > 0x7FF:
            raise SdoAbort(AbortCode.VALUE_RANGE)
        if not value & INVALID:
            if is_restricted(value & 0x7FF):
                raise SdoAbort(AbortCode.VALUE_RANGE)
            if self.valid and (value ^ self.cob_id.value) & _ID_BITS:
                raise SdoAbort(AbortCode.VALUE_RANGE)

    def _check_transmission(self, value: int) -> None:
        if value not in self.types or not self._exists(value):
            raise SdoAbort(AbortCode.VALUE_RANGE)

    def _exists(self, transmission: int) -> bool:
        """Whether the direction has this transmission type (CiA 301, 7.5.2.35 and 7.5.2.37)."""
        return 0 <= transmission <= MAX_SYNCHRONOUS or transmission in (254, 255)

    def _check_slot(self, value: int) -> None:
        if self.valid or self.count.value != 0:
            raise SdoAbort(AbortCode.DEVICE_STATE)
        if value:
            self._resolve(value)

    def _resolve(self, mapped: int) -> Entry:
        index, subindex, bits = mapped >> 16, mapped >> 8 & 0xFF, mapped & 0xFF
        entry = self._dictionary[index, subindex]
        if not entry.mappable or not self._fits(entry) or bits != 8 * entry.type.size:
            raise SdoAbort(AbortCode.NOT_MAPPABLE)
        return entry

    def _mapped(self, count: int) -> list[Entry]:
        return [self._resolve(slot.value) for slot in self.slots[:count]]

    def _check_count(self, value: int) -> None:
        if self.valid:
            raise SdoAbort(AbortCode.DEVICE_STATE)
        if sum(entry.type.size for entry in self._mapped(value)) > 8:
            raise SdoAbort(AbortCode.PDO_LENGTH)

    def _on_count(self, value: int) -> None:
        self.entries = self._mapped(value)
        self.fast = any(entry.fast for entry in self.entries)


class ReceivePdo(Pdo):
    """Data from the bus: acted on at once, or at the next SYNC if synchronous."""

    def __init__(
        self,
        number: int,
        node_id: int,
        dictionary: ObjectDictionary,
        changed: Callable[[], None],
        entries: int = MAX_ENTRIES,
    ) -> None:
        can_id = 0x100 + 0x100 * number + node_id if number <= PREDEFINED else 0
        super().__init__(0x13FF + number, can_id, dictionary, changed, entries)
        self._waiting: bytes | None = None

    def _fits(self, entry: Entry) -> bool:
        return entry.access in ("rw", "rww", "wo")

    def restart(self) -> None:
        self._waiting = None

    def receive(self, data: bytes) -> bool:
        """Takes a frame; `False` if it is shorter than the mapping (nothing is done)."""
        if len(data) < sum(entry.type.size for entry in self.entries):
            return False
        if self.synchronous:
            self._waiting = data
        else:
            self._apply(data)
        return True

    def sync(self) -> None:
        """A SYNC came in: what waited for it counts now, once."""
        if self._waiting is not None:
            data, self._waiting = self._waiting, None
            self._apply(data)

    def _apply(self, data: bytes) -> None:
        offset = 0
        for entry in self.entries:
            end = offset + entry.type.size
            with suppress(SdoAbort):  # a PDO has no answer: a refused value changes nothing
                entry.set(entry.type.unpack(data[offset:end]))
            offset = end


class TransmitPdo(Pdo):
    """Data to the bus: every n-th SYNC, on request, or when a mapped value has changed."""

    def __init__(
        self,
        number: int,
        node_id: int,
        dictionary: ObjectDictionary,
        changed: Callable[[], None],
        entries: int = MAX_ENTRIES,
        inhibits: bool = True,
    ) -> None:
        self._inhibits = inhibits
        can_id = 0x080 + 0x100 * number + node_id if number <= PREDEFINED else 0
        super().__init__(0x17FF + number, can_id, dictionary, changed, entries)
        self.ready_us = -math.inf  # the inhibit time is over
        self.waiting = False  # for that, with something to say
        self.sent: bytes | None = None
        self._syncs = 0

    def _more_communication(self) -> tuple[Entry, ...]:
        self.inhibit = Entry("Inhibit time", UNSIGNED16, check=self._check_inhibit)
        return (self.inhibit,) if self._inhibits else ()

    def _fits(self, entry: Entry) -> bool:
        return entry.access not in ("rww", "wo")

    @property
    def event_driven(self) -> bool:
        return self.transmission.value >= 254

    @property
    def inhibit_us(self) -> float:
        return 100.0 * self.inhibit.value

    def restart(self) -> None:
        self.ready_us, self.waiting, self.sent, self._syncs = -math.inf, False, None, 0

    def _exists(self, transmission: int) -> bool:
        return transmission == REMOTE_REQUEST or super()._exists(transmission)

    def _check_inhibit(self, value: int) -> None:
        if self.valid:
            raise SdoAbort(AbortCode.DEVICE_STATE)

    def sample(self) -> bytes:
        return b"".join(entry.pack() for entry in self.entries)

    def trigger(self) -> bytes:
        """What it is sent for, as an event, when it changes."""
        return b"".join(entry.trigger() for entry in self.entries)

    def on_sync(self) -> bool:
        """Counts a SYNC; `True` if it is the n-th, or something has changed since the last."""
        if self.transmission.value == ACYCLIC:
            data, before = self.sample(), self.sent
            self.sent = data
            return data != before
        self._syncs += 1
        if self._syncs < self.transmission.value:
            return False
        self._syncs = 0
        return True
