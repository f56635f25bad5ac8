"""Names, sizes and values of objects, by the dictionary of each node's maker."""

from __future__ import annotations

import functools

import canopen
from canopen.objectdictionary import ODArray, ODRecord, ODVariable

from epos2_ros.bus.cia402_node import object_dictionary
from epos2_ros.configuration.driver import DriverConfig
from epos2_ros.protocol import cia402, epos2
from epos2_ros.protocol.families import FAMILIES
from epos2_ros.protocol.family import Family
from epos2_ros.replay import words
from epos2_ros.replay.sdo import Transfer

_STRINGS = frozenset(
    {
        canopen.objectdictionary.datatypes.VISIBLE_STRING,
        canopen.objectdictionary.datatypes.UNICODE_STRING,
    }
)
# Numbers made of parts: device type, errors, COB-IDs, consumer heartbeat, identity (CiA 301).
_BITS = frozenset({0x1000, 0x1001, 0x1002, 0x1003, 0x1005, 0x1012, 0x1014, 0x1016, 0x1018})
_MODES = {1: "profile position", 3: "profile velocity", 6: "homing", 7: "interpolated position"}


@functools.cache
def _dictionary(family: Family) -> canopen.ObjectDictionary:
    return object_dictionary(family)


class Objects:
    """The object dictionaries of the nodes of a bus.

    `config` says whose drives they are, and so does the vendor id where the log holds it.
    """

    def __init__(self, config: DriverConfig | None = None) -> None:
        self._families = {
            axis.node_id: FAMILIES[axis.drive] for axis in (config.axes if config else ())
        }

    def learn(self, transfer: Transfer) -> None:
        """A transfer that was done may say whose drive it is."""
        if (transfer.entry, transfer.subindex) == (epos2.IDENTITY, 1) and transfer.data:
            vendor = int.from_bytes(transfer.data, "little")
            for family in FAMILIES.values():
                if family.vendor_id == vendor:
                    self._families[transfer.node] = family

    def size(self, node: int, index: int, subindex: int) -> int:
        """Bytes of an object; 0 if it is unknown or has no fixed size."""
        variable = self._variable(node, index, subindex)
        return 0 if variable is None else len(variable) // 8

    def name(self, node: int, index: int, subindex: int) -> str:
        """As the maker calls it, with the number for the manual."""
        number = f"0x{index:04X}-{subindex:02X}"
        variable = self._variable(node, index, subindex)
        if variable is None:
            return number
        parent = variable.parent
        pdos = 0x1400 <= index < 0x1C00  # the entries say which
        if isinstance(parent, (ODRecord, ODArray)) and parent.name != variable.name and not pdos:
            return f"{parent.name}, {variable.name} ({number})"
        return f"{variable.name} ({number})"

    def value(self, node: int, index: int, subindex: int, data: bytes) -> str:
        """What an object holds, in words where there are any."""
        number = int.from_bytes(data, "little")
        if index == epos2.CONTROLWORD:
            return words.controlword(number)
        if index == epos2.STATUSWORD:
            return f"{number:04X}h, {cia402.state_of(number).value}"
        if index in (epos2.MODES_OF_OPERATION, epos2.MODES_OF_OPERATION_DISPLAY):
            mode = int.from_bytes(data, "little", signed=True)
            return f"{mode} ({_MODES[mode]})" if mode in _MODES else str(mode)
        if index >> 9 in (0x1400 >> 9, 0x1800 >> 9) and subindex == 1:
            off = ", switched off" if number >> 31 else ""
            return f"{number & 0x7FF:03X}h{off}"
        if index >> 9 in (0x1600 >> 9, 0x1A00 >> 9) and subindex:
            mapped = self.name(node, number >> 16, number >> 8 & 0xFF)
            return f"{mapped}, {number & 0xFF} bits" if number else "nothing"
        variable = self._variable(node, index, subindex)
        if variable is not None and variable.data_type in _STRINGS:
            return repr(data.rstrip(b"\0").decode("ascii", "replace"))
        if len(data) > 4 or not data:
            return data.hex(" ") or "nothing"
        if index in _BITS:
            return f"{number:X}h"
        signed = variable is not None and (
            variable.data_type in canopen.objectdictionary.datatypes.SIGNED_TYPES
        )
        return str(int.from_bytes(data, "little", signed=signed))

    def transfer(self, transfer: Transfer) -> str:
        """An SDO transfer as one line."""
        node, index, subindex = transfer.node, transfer.entry, transfer.subindex
        text = f"{'write' if transfer.write else 'read'} {self.name(node, index, subindex)}"
        if transfer.data is not None and (transfer.write or transfer.data):
            text += f" = {self.value(node, index, subindex, transfer.data)}"
        if transfer.block:
            text += ", a block transfer"
        if transfer.abort is not None:
            who = "by the host" if transfer.by_client else "by the drive"
            text += f": aborted {who}, {words.abort_code(transfer.abort)}"
        if transfer.unanswered:
            text += ": no answer"
        return text

    def _variable(self, node: int, index: int, subindex: int) -> ODVariable | None:
        entry = _dictionary(self._families.get(node, epos2.FAMILY)).get(index)
        if isinstance(entry, ODVariable):
            return entry if subindex == 0 else None
        return None if entry is None else entry.get(subindex)
