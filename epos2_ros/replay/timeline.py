"""What happened, in words: of frames what changed, of events all.

What comes again and again (SYNC, time stamps, records, reports of position and buffer) is not
told one by one; at the end of each motion there is a line for each axis instead.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from epos2_ros.buslog.asc import EventLine, FrameLine
from epos2_ros.configuration.driver import DriverConfig
from epos2_ros.protocol import cia402, epos2
from epos2_ros.protocol.cia402 import State
from epos2_ros.protocol.families import FAMILIES
from epos2_ros.replay import words
from epos2_ros.replay.decode import (
    Emergency,
    Heartbeat,
    Key,
    Meaning,
    Nmt,
    Pdo,
    Sdo,
    Sync,
    Time,
    Unknown,
)
from epos2_ros.replay.objects import Objects
from epos2_ros.replay.sdo import Transfer

SILENCE_S = 1.5  # a node not heard so long is told
HOST_NODE = 127
_STATUSWORD: Key = (epos2.STATUSWORD, 0)
_CONTROLWORD: Key = (epos2.CONTROLWORD, 0)
_FLAGS: Key = (epos2.INTERPOLATION_STATUS, 1)
_FREE: Key = (epos2.INTERPOLATION_DATA_CONFIGURATION, epos2.ACTUAL_BUFFER_SUBINDEX)
_CLOCK = (epos2.HIGH_RESOLUTION_TIME_STAMP, 0)
_RECORD: Key = (epos2.INTERPOLATION_DATA_RECORD, 0)
_TIME_FIELD = 7  # of a record: 0 ends the motion
_TOLD_FLAGS = ~(epos2.BufferStatus.IP_MODE_ACTIVE | epos2.BufferStatus.BUFFER_ENABLED)
_REQUESTS = {
    "enable": "enable",
    "disable": "disable",
    "halt": "halt",
    "quick_stop": "quick stop",
    "reset_fault": "reset fault",
    "stop": "stop on the path",
}
_SAID = {
    "fault": "FAULT",
    "fail": "the driver sees",
    "bus_failed": "the bus failed",
    "configure_failed": "configure failed",
    "refused": "trajectory refused",
    "rejected": "the frame that comes now is none that the driver takes",
    "fd": "a CAN FD frame",
}
_SILENT = frozenset(
    {"log", "clocks", "advance", "points", "continued", "commit", "start_clock", "state"}
    | {"drop_waiting"}
)


class Told(NamedTuple):
    """A line of the timeline; `node` None: it concerns all."""

    t_s: float
    node: int | None
    text: str


@dataclass
class _Node:
    """What is known of a node."""

    heard_s: float = 0.0
    silent: bool = False
    nmt: int | None = None
    mode: int | None = None  # of operation
    statusword: int | None = None
    controlword: int | None = None
    flags: int = 0
    warned: int = 0  # warnings told since the motion began
    records: int = 0
    awaits_sync: bool = False  # a synchronous controlword that starts the motion
    short: set[int] = field(default_factory=set)  # PDOs told to have another length


class Timeline:
    """Takes the lines of a log with their meanings, gives what is to be told.

    `brief` leaves out SDO transfers that went well.
    """

    def __init__(
        self, objects: Objects, config: DriverConfig | None = None, brief: bool = False
    ) -> None:
        self._objects = objects
        self._brief = brief
        self._trajectory = ""
        self._nodes: dict[int, _Node] = {}
        for axis in config.axes if config else ():
            self._node(axis.node_id).mode = FAMILIES[axis.drive].rest_operation
        self._unknown: dict[tuple[str, int], int] = {}
        self._joints = {axis.node_id: axis.joint for axis in config.axes} if config else {}
        self._group = [a.node_id for a in config.axes] if config else []
        self._node_ids = {joint: node for node, joint in self._joints.items()}

    def name(self, node: int) -> str:
        """A node as its user knows it."""
        if node in self._joints:
            return f"{self._joints[node]} (node {node})"
        return "the host" if node == HOST_NODE else f"node {node}"

    # ------------------------------------------------------------------ frames

    def frame(self, line: FrameLine, meanings: list[Meaning]) -> Iterator[Told]:
        """A frame that was on the bus."""
        t_s = line.t_s
        yield from self._silences(t_s)
        for meaning in meanings:
            yield from self._meaning(t_s, line, meaning)

    def _meaning(self, t_s: float, line: FrameLine, meaning: Meaning) -> Iterator[Told]:
        match meaning:
            case Nmt(node, command):
                whom = self.name(node) if node else "all nodes"
                yield Told(t_s, node or None, f"NMT: {words.nmt_command(command)}, {whom}")
            case Time():
                yield Told(t_s, None, "TIME: every drive's motion clock is set to zero")
            case Sync():
                yield from self._sync(t_s)
            case Emergency(node, code, register, more):
                yield from self._heard(t_s, node)
                yield Told(t_s, node, words.emergency(code, register, more))
            case Heartbeat(node, state):
                yield from self._heard(t_s, node)
                known = self._node(node)
                if known.nmt != state:
                    known.nmt = state
                    yield Told(t_s, node, f"NMT state: {words.nmt_state(state)}")
            case Sdo(transfer):
                yield from self._heard(t_s, transfer.node)
                self._mode(transfer)
                plain = transfer.abort is None and not transfer.unanswered
                if not plain or not (self._brief or _again_and_again(transfer)):
                    yield Told(t_s, transfer.node, f"SDO: {self._objects.transfer(transfer)}")
            case Pdo():
                yield from self._pdo(t_s, meaning)
            case Unknown(kind, can_id):
                yield from self._not_explained(t_s, line, kind, can_id)

    def _mode(self, transfer: Transfer) -> None:
        known = transfer.data if transfer.abort is None and not transfer.unanswered else None
        if known and transfer.entry in (epos2.MODES_OF_OPERATION, epos2.MODES_OF_OPERATION_DISPLAY):
            self._node(transfer.node).mode = int.from_bytes(known, "little", signed=True)

    def _node(self, node: int) -> _Node:
        return self._nodes.setdefault(node, _Node())

    def _heard(self, t_s: float, node: int) -> Iterator[Told]:
        known = self._node(node)
        if known.silent:
            known.silent = False
            yield Told(t_s, node, f"heard again after {t_s - known.heard_s:.3f} s")
        known.heard_s = t_s

    def _silences(self, t_s: float) -> Iterator[Told]:
        for number, node in self._nodes.items():
            watched = node.nmt is not None and not node.silent
            if watched and t_s > node.heard_s + SILENCE_S:
                node.silent = True
                yield Told(
                    node.heard_s + SILENCE_S,
                    number,
                    f"not heard for {SILENCE_S:g} s (last at {node.heard_s:.3f} s)",
                )

    def _sync(self, t_s: float) -> Iterator[Told]:
        starting = [number for number, node in self._nodes.items() if node.awaits_sync]
        for number in starting:
            self._nodes[number].awaits_sync = False
            self._nodes[number].warned = 0
        if starting:
            who = ", ".join(map(self.name, starting))
            yield Told(t_s, None, f"the start SYNC, path time zero of {who}")

    def _pdo(self, t_s: float, pdo: Pdo) -> Iterator[Told]:
        node = self._node(pdo.node)
        if pdo.transmit:
            yield from self._heard(t_s, pdo.node)
        kind = f"{'T' if pdo.transmit else 'R'}PDO{pdo.number}"
        if pdo.short and pdo.number + 512 * pdo.transmit not in node.short:
            node.short.add(pdo.number + 512 * pdo.transmit)
            yield Told(t_s, pdo.node, f"{kind} has another length than its mapping")
        if _STATUSWORD in pdo.values:
            yield from self._statusword(t_s, pdo.node, _number(pdo.values[_STATUSWORD]))
        if _FLAGS in pdo.values and pdo.transmit:
            flags = _number(pdo.values[_FLAGS]) & _TOLD_FLAGS
            if new := flags & ~node.flags & ~node.warned:
                said = ", ".join(words.buffer_flags(new))
                yield Told(t_s, pdo.node, f"buffer status: {said}")
            node.flags = flags
            node.warned |= flags & ~epos2.BufferStatus.ERRORS
        if _RECORD in pdo.values and not pdo.transmit:
            if pdo.values[_RECORD][_TIME_FIELD]:
                node.records += 1
            else:
                yield Told(t_s, pdo.node, f"end record, after {node.records} records")
                node.records = 0
        if _CONTROLWORD in pdo.values and not pdo.transmit:
            value = _number(pdo.values[_CONTROLWORD])
            node.awaits_sync = pdo.synchronous and bool(value & epos2.ENABLE_IP_MODE)
            if not value & epos2.ENABLE_IP_MODE:
                node.records = 0
            when = ", at the next SYNC" if pdo.synchronous else ""
            yield Told(t_s, pdo.node, f"controlword {words.controlword(value, node.mode)}{when}")

    def _statusword(self, t_s: float, number: int, value: int) -> Iterator[Told]:
        node = self._node(number)
        before, node.statusword = node.statusword, value
        now = cia402.state_of(value)
        if before is None or cia402.state_of(before) is not now:
            came = "" if before is None else f"{cia402.state_of(before).value} → "
            yield Told(t_s, number, f"state: {came}{now.value} ({value:04X}h)")
        active = value & epos2.IP_MODE_ACTIVE_STATUSWORD
        was = (before or 0) & epos2.IP_MODE_ACTIVE_STATUSWORD
        if active != was and now is State.OPERATION_ENABLED:
            yield Told(t_s, number, words.bit_12(node.mode, bool(active)))

    def _not_explained(self, t_s: float, line: FrameLine, kind: str, can_id: int) -> Iterator[Told]:
        """The first of each kind; `end` says how many there were."""
        key = (kind, 0 if kind == "error" else can_id)
        self._unknown[key] = self._unknown.get(key, 0) + 1
        if self._unknown[key] > 1:
            return
        node = can_id & 0x7F if kind == "PDO" else None
        text = {
            "error": "error frame of the controller",
            "PDO": f"PDO {can_id:03X}h: its mapping is not in the log; --params may say it",
            "remote": f"remote frame {can_id:03X}h",
            "extended": f"frame {can_id:08X}h with a 29-bit identifier, none of CANopen's",
        }.get(kind, f"frame {can_id:03X}h, none of CANopen's: {line.data.hex(' ')}")
        yield Told(t_s, node, text)

    # ------------------------------------------------------------------ events of the driver

    def event(self, line: EventLine) -> Iterator[Told]:
        """Something the driver has noted."""
        t_s, name, data = line
        if name == "points":
            self._points(data)
        if name in _SILENT or (name == "sdo" and not _failed(data)):
            return
        try:
            told = Told(t_s, self._node_of(name, data), self._event_words(name, data))
        except (TypeError, ValueError):  # no driver has written this
            told = Told(t_s, None, f"{name}: {data}")
        yield told

    def _points(self, data: Any) -> None:
        match data:
            case {"of": int(count), "times_s": [*_, last], "joint_names": [*joints]}:
                who = ", ".join(map(str, joints))
                points = "1 point" if count == 1 else f"{count} points"
                self._trajectory = f" of {points} over {last:g} s for {who}"

    def _node_of(self, name: str, data: Any) -> int | None:
        if name == "output" and isinstance(data, Mapping):
            return self._node_ids.get(data.get("joint", ""))
        if name == "reconfigured" and isinstance(data, list) and data:
            return self._nth(data[0])
        return None

    def _nth(self, index: Any) -> int | None:
        """The node of an axis by its place in the group."""
        known = isinstance(index, int) and 0 <= index < len(self._group)
        return self._group[index] if known else None

    def _event_words(self, name: str, data: Any) -> str:
        if name in _REQUESTS:
            why = f": {data[0]}" if isinstance(data, list) and data else ""
            return f"asked to {_REQUESTS[name]}{why}"
        match name, data:
            case "configuration", {"axes": list(axes), "interface": interface, "channel": channel}:
                return f"the driver's configuration: {len(axes)} axes on {interface} {channel}"
            case "answer", [str(what), str(error)]:
                what = _REQUESTS.get(what, what)
                return f"{what} failed: {error}" if error else f"{what}: done"
            case "place", [_, stamp, now, _, str(refusal)]:
                if refusal:
                    return f"trajectory refused: {refusal}"
                return f"trajectory{self._trajectory}, {_when(stamp, now)}"
            case "reconfigured", [_, int(statusword), *_]:
                return f"brought up, {cia402.state_of(statusword).value}"
            case "sdo", [_, _, str(error)] if error:
                return f"an SDO request came to nothing: {error}"
            case "unreadable", {"line": int(number)}:
                return f"line {number} of the log can't be read"
            case "move_to", [dict(targets), *_]:
                return f"asked to move {', '.join(f'{j} to {p:.6g}' for j, p in targets.items())}"
            case "dropped", {"entries": int(entries)}:
                return f"{entries} entries are missing here: the disk was too slow for the log"
            case "output", {"name": str(output), "position": position}:
                return f"output {output} fired at {position:.6g}"
        text = data if isinstance(data, str) else "; ".join(map(str, data or ()))
        said = _SAID.get(name, name)
        return f"{said}: {text}" if text else said

    def end(self, t_s: float) -> Iterator[Told]:
        """What is to be said when there is no more."""
        for (kind, can_id), count in self._unknown.items():
            if count > 1:
                what = "error frames" if kind == "error" else f"{kind} frames {can_id:03X}h"
                yield Told(t_s, None, f"{count} {what} in all that nothing explains")


def _again_and_again(transfer: Transfer) -> bool:
    """Whether it is a question that the driver repeats all the time."""
    return not transfer.write and (transfer.entry, transfer.subindex) in (_FREE, _CLOCK)


def _when(stamp_us: float | None, now_us: float) -> str:
    """When a trajectory is to begin."""
    if stamp_us is None:
        return "at once"
    ahead_s = (stamp_us - now_us) / 1e6
    if ahead_s < 0:
        return f"by its stamp {-ahead_s:.3f} s under way"
    return f"by its stamp in {ahead_s:.3f} s"


def _number(data: bytes) -> int:
    return int.from_bytes(data, "little")


def _failed(answer: Any) -> bool:
    """Whether an SDO request of the driver's came to nothing."""
    return isinstance(answer, list) and len(answer) == 3 and bool(answer[2])
