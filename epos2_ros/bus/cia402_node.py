"""Configuring one CiA 402 drive by SDO, with canopen's own classes: what all families share.

Identity, faults, the family's own objects, PDO mapping; the drive ends up in NMT operational,
powered off, without a fault. canopen reads names and types from the EDS in `epos2_ros/eds/`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import resources

import canopen

from epos2_ros.bus.link import Network
from epos2_ros.bus.sdo_client import RemoteNode
from epos2_ros.errors import DriveError
from epos2_ros.protocol import cia402, epos2
from epos2_ros.protocol.cia402 import State
from epos2_ros.protocol.epos2 import PdoMapping
from epos2_ros.protocol.timekeeper import HOST_NODE_ID

DRIVE_HEARTBEAT_MS = 200
HOST_HEARTBEAT_TIMEOUT_MS = 500  # the drive stops by itself when the host is silent so long
STATE_TIMEOUT_S = 5.0
ERROR_FIELD = 0x1003


@dataclass(frozen=True)
class Family:
    """What tells one maker's drives from another's."""

    name: str  # with its article
    maker: str
    vendor_id: int
    eds: str  # in epos2_ros/eds
    rpdos: tuple[PdoMapping, ...]
    tpdos: tuple[PdoMapping, ...]

    def object_dictionary(self) -> canopen.ObjectDictionary:
        """From the package's EDS."""
        with resources.as_file(resources.files("epos2_ros") / "eds" / self.eds) as path:
            return canopen.import_od(str(path))


class Cia402Node:
    """SDO access to one drive."""

    def __init__(self, network: Network, family: Family, joint: str, node_id: int) -> None:
        self.joint = joint
        self._node_id = node_id
        self.node = RemoteNode(node_id, family.object_dictionary())
        self._family = family
        network[node_id] = self.node

    def __str__(self) -> str:
        return f"{self.joint} (node {self._node_id})"

    def configure(
        self, write_objects: Callable[[], None], inhibit_us: Mapping[int, int] | None = None
    ) -> int:
        """Check identity, configure, go operational; the statusword the drive then has.

        `inhibit_us`: by COB-ID, of the transmit PDOs that have an inhibit time.
        """
        try:
            self.node.nmt.send_command(0x80)  # pre-operational: PDOs are mapped there
            self._check_identity()
            self._leave_operation()
            write_objects()
            self.write(epos2.PRODUCER_HEARTBEAT_TIME, DRIVE_HEARTBEAT_MS)
            watched = HOST_NODE_ID << 16 | HOST_HEARTBEAT_TIMEOUT_MS
            self.write(epos2.CONSUMER_HEARTBEAT_TIME, watched, 1)
            for mapping in self._family.rpdos:
                self._map(self.node.rpdo[mapping.number], mapping)
            for mapping in self._family.tpdos:
                inhibit = (inhibit_us or {}).get(mapping.cob_id)
                self._map(self.node.tpdo[mapping.number], mapping, inhibit)
            self.node.nmt.send_command(0x01)  # operational
            return self.read(epos2.STATUSWORD)
        except canopen.SdoAbortedError as error:
            raise DriveError(f"{self}: SDO aborted by the drive: {error}") from error
        except canopen.SdoCommunicationError as error:
            raise DriveError(f"{self} stopped answering SDO requests: {error}") from error

    def read(self, index: int, subindex: int = 0) -> int:
        """The value of an object of the EDS."""
        return int(self._variable(index, subindex).raw)

    def write(self, index: int, value: int, subindex: int = 0) -> None:
        """Set an object of the EDS."""
        self._variable(index, subindex).raw = value

    def _variable(self, index: int, subindex: int) -> canopen.sdo.SdoVariable:
        entry = self.node.sdo[index]
        return entry if isinstance(entry, canopen.sdo.SdoVariable) else entry[subindex]

    def _check_identity(self) -> None:
        family = self._family
        try:
            device_type = self.read(epos2.DEVICE_TYPE)
        except canopen.SdoCommunicationError as error:
            raise DriveError(
                f"no answer from {self}: check power, wiring, termination, the node id "
                "set on the drive and can.bitrate"
            ) from error
        vendor = self.read(epos2.IDENTITY, 1)
        if not epos2.is_drive_profile(device_type) or vendor != family.vendor_id:
            raise DriveError(
                f"{self} is not {family.name}: device type 0x{device_type:08X}, vendor "
                f"0x{vendor:08X}; expected profile 402 and {family.maker}'s "
                f"0x{family.vendor_id:08X}; check axes.{self.joint}.node_id and .drive"
            )

    def _leave_operation(self) -> None:
        """Power off, faults reset: from whatever state an earlier host has left."""
        deadline = time.monotonic() + STATE_TIMEOUT_S
        told: State | None = None
        while True:
            state = cia402.state_of(self.read(epos2.STATUSWORD))
            controlword = cia402.step(state, State.SWITCH_ON_DISABLED)
            if state is State.SWITCH_ON_DISABLED:
                return
            if time.monotonic() > deadline or (state is State.FAULT and told is State.FAULT):
                code = self.read(ERROR_FIELD, 1) & 0xFFFF
                raise DriveError(f"{self} stays in {state.value}: {epos2.describe_emergency(code)}")
            if controlword is not None and state is not told:
                if controlword == cia402.FAULT_RESET:
                    self.write(epos2.CONTROLWORD, cia402.DISABLE_VOLTAGE)  # bit 7 has to rise
                self.write(epos2.CONTROLWORD, controlword)
                told = state

    def _map(
        self, pdo: canopen.pdo.PdoMap, mapping: PdoMapping, inhibit_us: int | None = None
    ) -> None:
        pdo.clear()
        pdo.cob_id = mapping.cob_id + (mapping.of_node or self._node_id)
        pdo.trans_type = mapping.transmission_type
        pdo.event_timer = None
        pdo.inhibit_time = None if inhibit_us is None else inhibit_us // 100
        pdo.enabled = True
        for index, subindex in mapping.objects:
            pdo.add_variable(index, subindex)
        pdo.save()
