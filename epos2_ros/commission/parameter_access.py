"""Reading, comparing and restoring the stored parameters of one drive, by SDO.

canopen's client does the transfers, on objects by number: no EDS has all of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import can
import canopen

from epos2_ros.bus.identity import read_identity
from epos2_ros.commission.stored import COB_ID, LAST_STEP, Parameter, Value, parameters_of
from epos2_ros.errors import BusError, DriveError
from epos2_ros.protocol import cia402, epos2
from epos2_ros.protocol.cia402 import State

DEVICE_TYPE = 0x1000
STORE = (0x1010, 1)
SAVE = b"save"  # 65766173h, lowest byte first (CiA 301, 7.5.2.13)
STORE_TIMEOUT_S = 10.0  # flash is slow
INVALID = 1 << 31  # of a COB-ID: the PDO, or the emergency object, does not exist (CiA 301)
EMERGENCY_COB_ID = 0x1014
PDO_STEP = 4
OFF = (
    State.NOT_READY_TO_SWITCH_ON,
    State.SWITCH_ON_DISABLED,
    State.READY_TO_SWITCH_ON,
    State.FAULT,
)
Values = dict[str, Value]
"""By address."""


@dataclass(frozen=True)
class Difference:
    """A parameter that is not as wanted."""

    parameter: Parameter
    wanted: Value | None
    found: Value | None  # None: the drive has no such object, or does not tell
    why: str = ""

    def __str__(self) -> str:
        unit = f" {self.parameter.unit}" if self.parameter.unit else ""
        wanted, found = (
            "none" if value is None else f"{written(self.parameter, value)}{unit}"
            for value in (self.wanted, self.found)
        )
        because = f" ({self.why})" if self.why else ""
        name = f"{self.parameter.address} {self.parameter.name}"
        return f"{name}: {wanted} wanted, {found} found{because}"


def written(parameter: Parameter, value: Value) -> str:
    """A value as it stands in a file: what is a set of bits in hex."""
    if isinstance(value, int) and (parameter.type == COB_ID or parameter.is_mapping):
        return f"0x{value:08X}"
    return str(value)


class DriveParameters:
    """The stored parameters of one drive on an open bus. DriveError when it does not answer."""

    def __init__(self, network: canopen.Network, node_id: int) -> None:
        self.node_id = node_id
        self._node = canopen.RemoteNode(node_id, canopen.ObjectDictionary())
        network[node_id] = self._node
        self._upload(DEVICE_TYPE, 0)  # says what to do when there is nobody
        self.identity = read_identity(self._node)
        self.parameters = parameters_of(self.identity.vendor_id)

    def __str__(self) -> str:
        return f"node {self.node_id} ({self.identity})"

    def read(self) -> Values:
        """All that the drive has and tells; of a PDO the objects that are mapped."""
        values: Values = {}
        for address, parameter in self.parameters.items():
            mapped = values.get(f"0x{parameter.index:04X}-00") if parameter.is_mapping else None
            if mapped is not None and parameter.subindex > int(mapped):
                continue
            if (value := self._read(parameter)) is not None:
                values[address] = value
        return values

    def differences(self, wanted: Mapping[str, Value]) -> list[Difference]:
        """Where the drive is not as wanted; ConfigurationError for a value that can't be."""
        found = {address: self._read(self.parameters[address]) for address in wanted}
        return [
            Difference(self.parameters[address], value, found[address])
            for address, value in wanted.items()
            if found[address] != self._normal(self.parameters[address], value)
        ]

    def powered(self) -> bool:
        """Whether the motor is, or may be, under power."""
        word = self._upload(epos2.STATUSWORD, 0)
        return word is None or cia402.state_of(int.from_bytes(word, "little")) not in OFF

    def restore(self, wanted: Mapping[str, Value]) -> list[Difference]:
        """Write what differs; what then still does, with the drive's reason.

        The drive has to be without power; it is in NMT pre-operational from then on. What is
        refused because of something that is written later is tried once more after it.
        """
        todo = [difference.parameter for difference in self.differences(wanted)]
        self._node.nmt.send_command(0x80)  # PDOs are mapped in pre-operational
        refused: dict[str, str] = {}
        for _ in range(2):
            refused = {}
            for step in range(1, LAST_STEP + 1):
                for parameter in todo:
                    if parameter.step == step and not parameter.is_pdo:
                        self._write(parameter, wanted[parameter.address], refused)
                if step == PDO_STEP:
                    pdos = sorted({p.index & ~0x200 for p in todo if p.is_pdo})
                    for index in pdos:
                        self._map(index, wanted, refused)
            if not refused:
                break
        return [
            Difference(d.parameter, d.wanted, d.found, refused.get(d.parameter.address, ""))
            for d in self.differences(wanted)
        ]

    def store(self) -> None:
        """Let the drive keep what it is set to through a power-off (0x1010-01)."""
        self._node.sdo.RESPONSE_TIMEOUT = STORE_TIMEOUT_S
        try:
            self._node.sdo.download(*STORE, SAVE)
        except (canopen.SdoAbortedError, canopen.SdoCommunicationError) as error:
            raise DriveError(f"{self} does not store its parameters: {error}") from error

    # ------------------------------------------------------------------ inside

    def _upload(self, index: int, subindex: int) -> bytes | None:
        """None where the drive refuses."""
        try:
            return bytes(self._node.sdo.upload(index, subindex))
        except canopen.SdoAbortedError:
            return None
        except canopen.SdoCommunicationError as error:
            raise DriveError(
                f"no answer from node {self.node_id} (`scan` shows who is on the bus)"
            ) from error
        except can.CanError as error:
            raise BusError(f"can't send: {error}") from error

    def _read(self, parameter: Parameter) -> Value | None:
        data = self._upload(parameter.index, parameter.subindex)
        return None if data is None else parameter.decode(data, self.node_id)

    def _normal(self, parameter: Parameter, value: Value) -> Value:
        """As it would be read."""
        return parameter.decode(parameter.encode(value, self.node_id), self.node_id)

    def _write(self, parameter: Parameter, value: Value, refused: dict[str, str]) -> None:
        """Set one object; what the drive refuses goes to `refused`, with its reason."""
        data = parameter.encode(value, self.node_id)
        try:
            if parameter.index == EMERGENCY_COB_ID:  # it changes only while it does not exist
                off = INVALID | int.from_bytes(data, "little")
                self._node.sdo.download(parameter.index, 0, off.to_bytes(4, "little"))
            self._node.sdo.download(parameter.index, parameter.subindex, data)
        except canopen.SdoAbortedError as error:
            refused[parameter.address] = str(error)
        except canopen.SdoCommunicationError as error:
            raise DriveError(
                f"{self} stopped answering at {parameter.address} ({parameter.name}): it is "
                "restored in part only; restore again"
            ) from error

    def _map(self, index: int, wanted: Mapping[str, Value], refused: dict[str, str]) -> None:
        """One PDO as CiA 301, 7.5.2.36 asks for: switch it off, unmap, map, count, switch it on."""
        communication, mapping = f"0x{index:04X}-", f"0x{index + 0x200:04X}-"
        cob_id = self.parameters[f"{communication}01"]
        if cob_id.address not in wanted:
            value = self._read(cob_id)
            if value is None:
                return
            wanted = {**wanted, cob_id.address: value}
        final = int.from_bytes(cob_id.encode(wanted[cob_id.address], self.node_id), "little")
        self._write(cob_id, final | INVALID, refused)
        self._write_present([f"{communication}{n:02X}" for n in (2, 3)], wanted, refused)
        count = self.parameters[f"{mapping}00"]
        if count.address in wanted:
            objects = int(wanted[count.address])
            self._write(count, 0, refused)
            places = [f"{mapping}{n:02X}" for n in range(1, objects + 1)]
            self._write_present(places, wanted, refused)
            self._write(count, objects, refused)
        self._write(cob_id, final, refused)

    def _write_present(
        self, addresses: Iterable[str], wanted: Mapping[str, Value], refused: dict[str, str]
    ) -> None:
        for address in addresses:
            if address in wanted:
                self._write(self.parameters[address], wanted[address], refused)
