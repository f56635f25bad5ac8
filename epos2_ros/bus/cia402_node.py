"""Configuring one CiA 402 drive by SDO, with canopen's own classes: what all families share.

Identity, faults, the family's own objects, PDO mapping; the drive ends up in NMT operational,
powered off, without a fault. canopen reads names and types from the EDS in `epos2_ros/eds/`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from importlib import resources
from typing import NamedTuple

import canopen

from epos2_ros.bus.link import Network
from epos2_ros.bus.sdo_access import NoAnswer, SdoAccess
from epos2_ros.bus.sdo_client import RemoteNode
from epos2_ros.errors import DriveError
from epos2_ros.protocol import cia402, epos2
from epos2_ros.protocol.cia402 import State
from epos2_ros.protocol.family import Family
from epos2_ros.protocol.pdo import PdoMapping
from epos2_ros.protocol.timekeeper import HOST_NODE_ID

FIRST_ATTEMPTS = 2  # of more than a second each, for a drive that may be starting up
BRING_UP_LIMIT_S = 20.0  # of one drive, from its first answer on
FAULT_RESET_TIMEOUT_S = 1.0  # real drives take 25 ms
PDO_INVALID, PDO_NO_REMOTE = 1 << 31, 1 << 30  # in a PDO's COB-ID (CiA 301, 7.5.2.35)
DRIVE_HEARTBEAT_MS = 300  # its answers to SYNC say as well that it lives
HOST_HEARTBEAT_TIMEOUT_MS = 500  # the drive stops by itself when the host is silent so long
WATCHED_HEARTBEAT = HOST_NODE_ID << 16 | HOST_HEARTBEAT_TIMEOUT_MS
GUARD_TIME_MS, LIFE_TIME_FACTOR = 100, 5  # likewise: the product
GOES_ON = "it would go on moving when the host falls silent"
STATE_TIMEOUT_S = 5.0
QUICK_STOP_LIMIT_S = 2.5
ERROR_FIELD = 0x1003

_ON = frozenset(
    {State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE, State.FAULT_REACTION_ACTIVE}
)


class Direction(NamedTuple):
    """Where the records of a kind of PDO begin in the object dictionary."""

    name: str
    record: int
    mapping: int


RECEIVE = Direction("RPDO", 0x1400, 0x1600)
TRANSMIT = Direction("TPDO", 0x1800, 0x1A00)



def object_dictionary(family: Family) -> canopen.ObjectDictionary:
    """From the package's EDS."""
    with resources.as_file(resources.files("epos2_ros") / "eds" / family.eds) as path:
        return canopen.import_od(str(path))


class Cia402Node:
    """SDO access to one drive, in `objects`. All of it raises DriveError."""

    def __init__(self, network: Network, family: Family, joint: str, node_id: int) -> None:
        self.joint = joint
        self._node_id = node_id
        self.node = RemoteNode(node_id, object_dictionary(family), joint)
        self.objects = SdoAccess(self.node)
        self._family = family
        self._told_first: tuple[int, int, int] | None = None  # index, subindex, value
        network[node_id] = self.node

    def __str__(self) -> str:
        return f"{self.joint} (node {self._node_id})"

    def configure(
        self,
        write_objects: Callable[[], None],
        inhibit_us: Mapping[int, int] | None = None,
        clear_faults: Callable[[], None] = lambda: None,
    ) -> int:
        """Check identity, configure, go operational; the statusword the drive then has.

        `inhibit_us`: by COB-ID, of the transmit PDOs that have an inhibit time; `clear_faults`:
        what a fault reset needs before.
        """
        with self.objects.within(BRING_UP_LIMIT_S):
            self._check_identity()
            clear_faults()
            self._leave_operation()
            self._told_first = None
            try:
                write_objects()
                statusword = self._start(inhibit_us or {})
            except NoAnswer:
                raise
            except DriveError as error:
                self._refuse_restarted(error)
                raise
            self._refuse_restarted()
            return statusword

    def _start(self, inhibit_us: Mapping[int, int]) -> int:
        """Map the PDOs, then NMT start."""
        objects, family = self.objects, self._family
        for mapping in family.rpdos:
            self._map(RECEIVE, mapping)
        for mapping in family.tpdos:
            self._map(TRANSMIT, mapping, inhibit_us.get(mapping.cob_id))
        for direction, mappings in ((RECEIVE, family.rpdos), (TRANSMIT, family.tpdos)):
            used = {mapping.number for mapping in mappings}
            for number in sorted(set(range(1, family.pdos + 1)) - used):
                self._switch_off(direction, number)
        self.node.nmt.send_command(0x01)  # operational
        return objects.read(epos2.STATUSWORD)

    def reset_node(self) -> None:
        """The drive starts anew, with its stored parameters (NMT); `configure` waits for it."""
        self.node.nmt.send_command(0x81)

    def watch_host(self) -> None:
        """The drive stops by itself when the host's heartbeat fails to appear, and sends its own.

        By life guarding where its family does it so: it has to be asked again and again for its
        state (a remote frame of 700h+id), and produces no heartbeat, which would replace that.
        """
        if self._family.life_guarding:
            self._be_guarded()
            return
        self.objects.write(epos2.PRODUCER_HEARTBEAT_TIME, DRIVE_HEARTBEAT_MS)
        self.objects.keep(
            epos2.CONSUMER_HEARTBEAT_TIME,
            WATCHED_HEARTBEAT,
            1,
            f"let it watch the host's heartbeat (node {HOST_NODE_ID}, {HOST_HEARTBEAT_TIMEOUT_MS} "
            f"ms), {self.objects.name(epos2.CONSUMER_HEARTBEAT_TIME, 1)}",
            GOES_ON,
        )
        self._told_first = epos2.CONSUMER_HEARTBEAT_TIME, 1, WATCHED_HEARTBEAT

    def _refuse_restarted(self, error: DriveError | None = None) -> None:
        """DriveError where a drive does not have any more what it was told first: then it has its
        stored parameters again, and what it was told later alone leaves it half set up."""
        if self._told_first is None:
            return
        index, subindex, value = self._told_first
        if self.objects.read(index, subindex) != value:
            raise DriveError(
                f"{self} has restarted while it was being set up: check its power supply, and try "
                "again"
            ) from error

    def leave(self) -> None:
        """The host goes: a drive that is off need not watch it any more, and stays without fault.

        It goes back to pre-operational, where no PDO can switch it on. One that is still on keeps
        its watch, which is what stops it.
        """
        objects = self.objects
        if cia402.state_of(objects.read(epos2.STATUSWORD)) in _ON:
            return
        if self._family.life_guarding:
            objects.write(epos2.LIFE_TIME_FACTOR, 0)
            objects.write(epos2.GUARD_TIME, 0)
        else:
            objects.write(epos2.CONSUMER_HEARTBEAT_TIME, 0, 1)
        self.node.nmt.send_command(0x80)  # pre-operational

    def _be_guarded(self) -> None:
        objects = self.objects
        objects.write(epos2.PRODUCER_HEARTBEAT_TIME, 0)
        for index, value, what in (
            (epos2.GUARD_TIME, GUARD_TIME_MS, f"guard time of {GUARD_TIME_MS} ms"),
            (epos2.LIFE_TIME_FACTOR, LIFE_TIME_FACTOR, f"life time factor of {LIFE_TIME_FACTOR}"),
        ):
            attempt = f"let it watch the host by a {what}, {objects.name(index)}"
            objects.keep(index, value, 0, attempt, GOES_ON)
        self._told_first = epos2.GUARD_TIME, 0, GUARD_TIME_MS

    def _check_identity(self) -> None:
        family = self._family
        device_type = self._first_answer()
        vendor = self.objects.read(epos2.IDENTITY, 1)
        if not epos2.is_drive_profile(device_type) or vendor != family.vendor_id:
            raise DriveError(
                f"{self} is not {family.name}: device type 0x{device_type:08X}, vendor "
                f"0x{vendor:08X}; expected profile 402 and {family.maker}'s "
                f"0x{family.vendor_id:08X}; check axes.{self.joint}.node_id and .drive"
            )

    def _first_answer(self) -> int:
        """The device type, from a drive that may still be starting up.

        One that has been reset takes a quarter of a second to its boot-up message, and one that
        detects the bus's bit rate is not there at all before it has heard some frames.
        """
        for attempt in range(1, FIRST_ATTEMPTS + 1):
            self.node.nmt.send_command(0x80)  # pre-operational: PDOs are mapped there
            try:
                return self.objects.read(epos2.DEVICE_TYPE)
            except NoAnswer as error:
                if attempt == FIRST_ATTEMPTS:
                    raise DriveError(
                        f"no answer from {self}: check power, wiring, termination, the node id "
                        "set on the drive and can.bitrate"
                    ) from error
        raise AssertionError

    def _leave_operation(self) -> None:
        """Power off, faults reset: from whatever state an earlier host has left.

        An axis that may be moving is stopped first, or it would coast.
        """
        self._quick_stop()
        since, told = time.monotonic(), None
        while True:
            state = cia402.state_of(self.objects.read(epos2.STATUSWORD))
            if state is State.SWITCH_ON_DISABLED:
                return
            limit_s = FAULT_RESET_TIMEOUT_S if state is State.FAULT else STATE_TIMEOUT_S
            if state is told and time.monotonic() > since + limit_s:
                raise DriveError(f"{self} stays in {state.value}{self._last_error()}")
            controlword = cia402.step(state, State.SWITCH_ON_DISABLED)
            if state is not told:
                since, told = time.monotonic(), state
                if controlword == cia402.FAULT_RESET:
                    self._command(cia402.DISABLE_VOLTAGE, "disable voltage")  # bit 7 has to rise
                    self._command(controlword, "reset its fault")
                elif controlword is not None:
                    self._command(controlword, "disable voltage")

    def _quick_stop(self) -> None:
        """Until it rests by its own word, or for as long as a ramp may take."""
        statusword = self.objects.read(epos2.STATUSWORD)
        if cia402.state_of(statusword) is State.OPERATION_ENABLED:
            self._command(cia402.QUICK_STOP, "quick stop")
        until = time.monotonic() + QUICK_STOP_LIMIT_S
        while time.monotonic() < until:
            statusword = self.objects.read(epos2.STATUSWORD)
            state = cia402.state_of(statusword)
            stopping = state in (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE)
            if not stopping and state is not State.FAULT_REACTION_ACTIVE:
                return
            if state is State.QUICK_STOP_ACTIVE and statusword & cia402.TARGET_REACHED:
                return

    def _command(self, controlword: int, what: str) -> None:
        name = self.objects.name(epos2.CONTROLWORD)
        self.objects.write(epos2.CONTROLWORD, controlword, attempt=f"{what}, by {name}")

    def _last_error(self) -> str:
        """The newest entry of the error history in words."""
        if not self.objects.read(ERROR_FIELD):
            return ", with no error in its history (0x1003)"
        code = self.objects.read(ERROR_FIELD, 1) & 0xFFFF
        return f": {self._family.describe_emergency(code)}"

    def _switch_off(self, direction: Direction, number: int) -> None:
        """A PDO that is not used: what the drive has left the factory with, say."""
        pdo, record = f"{direction.name}{number}", direction.record + number - 1
        cob_id = self.objects.read(record, 1, f"read the COB-ID of {pdo} (0x{record:04X}-01)")
        if not cob_id & PDO_INVALID:
            attempt = f"switch {pdo} off (0x{record:04X}-01)"
            self.objects.write(record, cob_id | PDO_INVALID, 1, attempt)

    def _map(
        self, direction: Direction, mapping: PdoMapping, inhibit_us: int | None = None
    ) -> None:
        """In the order of CiA 301, 7.5.2.36: off, type, mapping, on."""
        objects, number = self.objects, mapping.number
        pdo = f"{direction.name}{number}"
        record, contents = direction.record + number - 1, direction.mapping + number - 1
        cob_id = mapping.cob_id + (mapping.of_node or self._node_id)

        def write(index: int, subindex: int, value: int, what: str) -> None:
            attempt = f"{what} (0x{index:04X}-{subindex:02X})"
            objects.write(index, value, subindex, attempt)

        before = objects.read(record, 1, f"read the COB-ID of {pdo} (0x{record:04X}-01)")
        write(record, 1, before | PDO_INVALID, f"switch {pdo} off")
        kind = mapping.transmission_type
        write(record, 2, kind, f"set the transmission type of {pdo} to {kind}")
        if inhibit_us is not None:
            text = f"set the inhibit time of {pdo} to {inhibit_us / 1000:g} ms"
            write(record, 3, inhibit_us // 100, text)
        write(contents, 0, 0, f"clear the mapping of {pdo}")
        for place, (index, subindex) in enumerate(mapping.objects, 1):
            bits = objects.size(index, subindex)
            mapped = index << 16 | subindex << 8 | bits
            name = objects.name(index, subindex)
            write(contents, place, mapped, f"map {name} as object {place} of {pdo}")
        names = ", ".join(objects.name(*key) for key in mapping.objects)
        count = len(mapping.objects)
        write(contents, 0, count, f"close the mapping of {pdo} with {count} objects ({names})")
        on = cob_id | before & PDO_NO_REMOTE
        write(record, 1, on, f"switch {pdo} on with COB-ID 0x{cob_id:03X}")
