"""From frames to what was meant by them, going by CiA 301 and by what the log itself says.

Which objects a PDO holds is what was written to its mapping; until that is seen, what the driver
writes to the drives of the configuration.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from epos2_ros.bus.epos2 import family_of
from epos2_ros.bus.settings import drive_settings
from epos2_ros.buslog.asc import FrameLine
from epos2_ros.configuration.driver import DriverConfig
from epos2_ros.protocol import epos2
from epos2_ros.protocol.epos2 import PdoMapping
from epos2_ros.protocol.families import FAMILIES
from epos2_ros.replay.objects import Objects
from epos2_ros.replay.sdo import REQUEST, RESPONSE, SdoFollower, Transfer

_INVALID = 1 << 31
_PARAMETERS = {0x1400: False, 0x1800: True}  # of receive and transmit PDOs
_MAPPINGS = {0x1600: False, 0x1A00: True}
_PDOS = 0x200  # of each kind at most
_SYNCHRONOUS = 240  # transmission types up to here

Key = tuple[int, int]  # index, subindex


class Nmt(NamedTuple):
    """A command to a node, or to all (0)."""

    node: int
    command: int


class Sync(NamedTuple):
    """SYNC."""


class Time(NamedTuple):
    """TIME: sets every EPOS2's motion clock to zero."""


class Emergency(NamedTuple):
    """EMCY; `code` 0 says that an error has gone."""

    node: int
    code: int
    register: int
    more: bytes


class Heartbeat(NamedTuple):
    """Heartbeat, boot-up (state 0), or an answer to a guarding request."""

    node: int
    state: int


class Pdo(NamedTuple):
    """A PDO and the objects in it, those it was too short for left out."""

    node: int
    transmit: bool  # by the drive
    number: int
    synchronous: bool
    values: Mapping[Key, bytes]
    short: bool  # its length is not that of its mapping


class Sdo(NamedTuple):
    """An SDO transfer has ended."""

    transfer: Transfer


class Unknown(NamedTuple):
    """A frame that nothing in the log explains."""

    kind: str  # "error", "remote", "extended", "PDO" or "data"
    can_id: int


Meaning = Nmt | Sync | Time | Emergency | Heartbeat | Pdo | Sdo | Unknown


@dataclass
class _PdoSetting:
    """What was written about one PDO of one node."""

    node: int
    transmit: bool
    number: int
    cob_id: int = _INVALID
    synchronous: bool = False
    entries: dict[int, int] = field(default_factory=dict)
    count: int = 0

    def objects(self) -> list[tuple[Key, int]]:
        """Objects and their lengths in bytes, in order."""
        known = [self.entries.get(place, 0) for place in range(1, self.count + 1)]
        return [((e >> 16, e >> 8 & 0xFF), (e & 0xFF) // 8) for e in known]


class Decoder:
    """Gives each frame its meaning. `config`: of the driver, if it is known."""

    def __init__(self, objects: Objects, config: DriverConfig | None = None) -> None:
        self._objects = objects
        self._sdo = SdoFollower()
        self._settings: dict[tuple[int, bool, int], _PdoSetting] = {}
        self._pdos: dict[int, list[_PdoSetting]] = {}  # by COB-ID
        for axis in config.axes if config else ():
            family = FAMILIES[axis.drive]
            if config and axis.drive == "epos2":
                family = family_of(drive_settings(axis, config))
            self._default(axis.node_id, False, family.rpdos)
            self._default(axis.node_id, True, family.tpdos)
        self._index()

    def take(self, frame: FrameLine) -> list[Meaning]:
        """What a frame means. Most mean one thing, and parts of a transfer nothing."""
        if frame.kind != "data":
            if frame.kind == "remote" and frame.can_id & 0x780 == epos2.HEARTBEAT:
                return []  # node guarding
            return [Unknown(frame.kind, frame.can_id)]
        function, node = frame.can_id & 0x780, frame.can_id & 0x7F
        data = frame.data
        if settings := self._pdos.get(frame.can_id):
            return [_pdo(setting, data) for setting in settings]
        if frame.can_id == epos2.NMT and len(data) == 2:
            return [Nmt(data[1], data[0])]
        if frame.can_id == epos2.SYNC:
            return [Sync()]
        if frame.can_id == epos2.TIME:
            return [Time()]
        if not node:
            return [Unknown("data", frame.can_id)]
        if function == epos2.EMCY and len(data) >= 3:
            return [Emergency(node, int.from_bytes(data[:2], "little"), data[2], data[3:])]
        if function == epos2.HEARTBEAT and len(data) == 1:
            return [Heartbeat(node, data[0] & 0x7F)]
        if function in (REQUEST, RESPONSE) and data:
            follow = self._sdo.request if function == REQUEST else self._sdo.response
            return [self._transferred(transfer) for transfer in follow(node, data)]
        if epos2.TPDO1 <= frame.can_id < RESPONSE:
            return [Unknown("PDO", frame.can_id)]
        return [Unknown("data", frame.can_id)]

    def unanswered(self) -> list[Meaning]:
        """At the end of the log: SDO requests without an answer."""
        return [Sdo(transfer) for transfer in self._sdo.unanswered()]

    # ------------------------------------------------------------------ inside

    def _transferred(self, transfer: Transfer) -> Meaning:
        done = transfer.abort is None and not transfer.unanswered and not transfer.block
        if done:
            self._objects.learn(transfer)
        if done and transfer.write and transfer.data is not None and len(transfer.data) <= 4:
            self._written(transfer, int.from_bytes(transfer.data, "little"))
        return Sdo(transfer)

    def _written(self, transfer: Transfer, value: int) -> None:
        base, place = transfer.entry & ~(_PDOS - 1), transfer.entry & (_PDOS - 1)
        if base in _PARAMETERS:
            setting = self._setting(transfer.node, _PARAMETERS[base], place + 1)
            if transfer.subindex == 1:
                setting.cob_id = value & (_INVALID | 0x7FF)
            elif transfer.subindex == 2:
                setting.synchronous = value <= _SYNCHRONOUS
        elif base in _MAPPINGS:
            setting = self._setting(transfer.node, _MAPPINGS[base], place + 1)
            if transfer.subindex:
                setting.entries[transfer.subindex] = value
            else:
                setting.count = value
        else:
            return
        self._index()

    def _setting(self, node: int, transmit: bool, number: int) -> _PdoSetting:
        key = node, transmit, number
        if key not in self._settings:
            self._settings[key] = _PdoSetting(*key)
        return self._settings[key]

    def _default(self, node: int, transmit: bool, mappings: Iterable[PdoMapping]) -> None:
        for mapping in mappings:
            setting = self._setting(node, transmit, mapping.number)
            setting.cob_id = mapping.cob_id + (mapping.of_node or node)
            setting.synchronous = mapping.transmission_type <= _SYNCHRONOUS
            for place, (index, subindex) in enumerate(mapping.objects, start=1):
                bits = 8 * self._objects.size(node, index, subindex)
                setting.entries[place] = index << 16 | subindex << 8 | bits
            setting.count = len(mapping.objects)

    def _index(self) -> None:
        self._pdos = {}
        for setting in self._settings.values():
            if not setting.cob_id & _INVALID and setting.count:
                self._pdos.setdefault(setting.cob_id, []).append(setting)


def _pdo(setting: _PdoSetting, data: bytes) -> Pdo:
    values, at = {}, 0
    for key, size in setting.objects():
        if at + size <= len(data):
            values[key] = data[at : at + size]
        at += size
    return Pdo(
        setting.node,
        setting.transmit,
        setting.number,
        setting.synchronous,
        values,
        at != len(data),
    )
