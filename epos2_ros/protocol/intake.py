"""Which frames of the bus are let in: lengths are looked at here, contents elsewhere.

A drive's PDOs mean what they were mapped to from the NMT start on that ends its configuration,
until it boots again or is taken back to pre-operational. Before, they are what somebody else has
mapped, and no report. Whatever no drive can have sent like that (CiA 301: a PDO is as long as it is
mapped, emergencies and SDO have eight bytes, a heartbeat one) is dropped, counted by kind, and said
once for each sender.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Mapping, Sequence
from typing import Protocol

from epos2_ros.protocol import epos2
from epos2_ros.protocol.frame import Frame

BOOT_UP = b"\x00"
NMT_STATES = frozenset({0x04, 0x05, 0x7F})  # in a heartbeat, besides 0 (CiA 301, 7.2.8.3.2)
TOGGLE_BIT = 0x80  # in an answer to node guarding, which has the same COB-ID
SDO_RESPONSE = 0x580
_EIGHT_BYTES = {epos2.EMCY: "emergency", SDO_RESPONSE: "SDO response"}
NMT_START = 0x01
NMT_PRE_OPERATIONAL = 0x80
_FUNCTION, _NODE = 0x780, 0x7F


class Rejects:
    """What was dropped on its way in, by kind. What is new is said once (`notices`)."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self.notices: deque[str] = deque()  # for the log
        self._said: set[tuple[str, object]] = set()

    def add(self, kind: str, sender: object, what: str, times: int = 1) -> None:
        """`what` is the line for the first of this kind from this sender."""
        self.counts[kind] += times
        if (kind, sender) not in self._said:
            self._said.add((kind, sender))
            self.notices.append(f"{what}; dropped, as all like it will be")


class Reporter(Protocol):
    """A drive, as far as what it sends is looked at here."""

    node_id: int

    @property
    def pdo_bytes(self) -> Mapping[int, int]:
        """By COB-ID, how long its PDOs are mapped."""


def intake_of(axes: Sequence[Reporter], rejects: Rejects) -> Intake:
    """For the drives of these axes."""
    pdo_bytes: dict[int, int] = {}
    for axis in axes:
        pdo_bytes |= axis.pdo_bytes
    return Intake(pdo_bytes, {axis.node_id: str(axis) for axis in axes}, rejects)


class Intake:
    """`pdo_bytes`: by COB-ID, how long the drives' PDOs are mapped; `names`: of the nodes."""

    def __init__(
        self, pdo_bytes: Mapping[int, int], names: Mapping[int, str], rejects: Rejects
    ) -> None:
        self.rejects = rejects
        self._pdo_bytes = pdo_bytes
        self._names = names
        self._mapped: set[int] = set()  # nodes whose PDOs are what we have mapped

    def sending(self, frame: Frame) -> None:
        """A frame of ours is about to go out."""
        if frame.can_id == epos2.NMT:
            command, node = frame.data
            nodes = {node} if node else set(self._names)
            if command == NMT_START:
                self._mapped |= nodes
            else:  # its configuration begins anew
                self._mapped -= nodes

    def accepts(self, frame: Frame) -> bool:
        """Whether a frame from the bus, none of our own, may be read."""
        function, node = frame.can_id & _FUNCTION, frame.can_id & _NODE
        if frame.can_id == epos2.SYNC:  # with a counter it has one byte (CiA 301, 7.2.5.3.1)
            return len(frame.data) <= 1 or self._drop("SYNC", "the bus", frame, "0 or 1")
        if node not in self._names:
            return True
        name = self._names[node]
        if frame.can_id in self._pdo_bytes:
            if node not in self._mapped:
                return False  # nothing is wrong with it, only that it is none of ours
            due = self._pdo_bytes[frame.can_id]
            return len(frame.data) == due or self._drop("PDO", name, frame, str(due))
        if function in _EIGHT_BYTES:
            return len(frame.data) == 8 or self._drop(_EIGHT_BYTES[function], name, frame, "8")
        if function == epos2.HEARTBEAT:
            return self._accepts_heartbeat(node, frame)
        return True

    def _accepts_heartbeat(self, node: int, frame: Frame) -> bool:
        name = self._names[node]
        if len(frame.data) != 1:
            return self._drop("heartbeat", name, frame, "1")
        state = frame.data[0]
        if state != 0 and state & ~TOGGLE_BIT not in NMT_STATES:
            told = f"{name} says that it is in NMT state 0x{state:02X}, which there is not"
            self.rejects.add("heartbeat of unknown state", name, told)
            return False
        if frame.data == BOOT_UP:
            self._mapped.discard(node)
        return True

    def _drop(self, kind: str, sender: str, frame: Frame, due: str) -> bool:
        told = f"{sender}: {kind} 0x{frame.can_id:03X} of {len(frame.data)} bytes, not {due}"
        self.rejects.add(f"{kind} of wrong length", sender, told)
        return False
