"""The protocol layer run over a log: what it would send, against what was sent.

What the driver was asked and received goes into the same `Machine`, at the same times
(`buslog.inputs`), so the same code sends the same. Where it does not, the code is another, or
something reached the driver that the log does not hold. Only this module and `buslog.inputs` know
the protocol layer.

A frame counts by its COB-ID and its place among those; where one is queued behind others on the
bus does not matter. A log whose beginning or middle is lost is entered where the axes next stand.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Iterator
from typing import Any

from epos2_ros.bus.settings import machine_of
from epos2_ros.buslog.asc import EventLine, FrameLine
from epos2_ros.buslog.inputs import Repeater
from epos2_ros.configuration.driver import DriverConfig
from epos2_ros.motion.record import Record
from epos2_ros.protocol import epos2
from epos2_ros.protocol.frame import Frame
from epos2_ros.protocol.timekeeper import HOST_NODE_ID
from epos2_ros.replay import words
from epos2_ros.replay.timeline import Told

STAMP_TOLERANCE_US = 1  # of a high resolution time stamp, which is rounded to this
PATIENCE_US = 1_000_000.0  # a frame that would be sent and was not for so long is told
ON_THE_WAY_S = 0.1  # a frame that had been sent is on the bus by then
EVENTS = frozenset(
    {"waiting", "started", "replaced", "stopped", "cancelled", "done", "aborted", "fault"}
)
_LENGTHS = {epos2.RPDO1: 8, epos2.RPDO2: 2, epos2.RPDO3: 4, epos2.RPDO4: 2}


class Rerun:
    """Takes the lines of a log; gives what differs, and the group's phases.

    `whole`: whether the log begins with the run. `compared` and `differing` count the frames that
    the driver sent.
    """

    def __init__(self, config: DriverConfig, host_us: float, whole: bool = True) -> None:
        self._config = config
        self._host_us = host_us
        self._running = whole
        self._rejected = False  # the next frame did not reach the protocol
        self._entered_s = -math.inf  # when the log was entered after its beginning
        self._told: set[int] = set()  # COB-IDs whose first difference in this motion was told
        self.compared = 0
        self.differing: Counter[str] = Counter()
        self._begin()

    def _begin(self) -> None:
        """A machine that has done nothing yet."""
        self._machine = machine_of(self._config)
        self._group = self._machine.group
        self._pdo_bytes: dict[int, int] = {}
        for drive in self._machine.drives:
            self._pdo_bytes |= drive.pdo_bytes
        self._recorded = {d.node_id for d in self._machine.drives if d.family is epos2.FAMILY}
        self._names = {drive.node_id: str(drive) for drive in self._machine.drives}
        self._repeater = Repeater(self._machine)
        self._phase = self._group.phase
        self._expected: dict[int, deque[tuple[float, bytes]]] = {}
        self._replaced: dict[int, bytes] = {}  # what another frame was sent in place of
        self._events: deque[tuple[str, str]] = deque()
        self._bus_works = True

    # ------------------------------------------------------------------ lines of the log

    def frame(self, line: FrameLine) -> Iterator[Told]:
        """A frame that was received, or that the driver's adapter gave back."""
        rejected, self._rejected = self._rejected, False
        if line.kind != "data" or rejected or not self._running:
            return
        if not line.sent and len(line.data) != self._pdo_bytes.get(line.can_id, len(line.data)):
            return  # the driver did not let it in either, or the log is cut here
        if line.sent and self._is_ours(line.can_id):
            yield from self._compare(line)
        try:
            t_us = round(self._host_us + 1e6 * line.t_s, 3)
            self._machine.receive(Frame(line.can_id, line.data), t_us, line.sent)
        except Exception as error:  # whatever a log holds, the timeline goes on
            yield self._give_up(line.t_s, error)
            return
        yield from self._gather(line.t_s)

    def event(self, line: EventLine) -> Iterator[Told]:
        """Something that the driver was asked, or said."""
        t_s, name, data = line
        self._rejected |= name == "rejected"
        if name in ("dropped", "unreadable"):
            if self._running:
                yield self._leave(t_s, "something is missing in it")
        elif not self._running and name == "state":
            yield from self._enter(t_s, data)
        elif self._running and name in EVENTS:
            yield from self._compare_event(t_s, name, str(data))
        elif self._running:
            yield from self._repeat(t_s, name, data)

    def summary(self) -> str:
        """What the comparison came to."""
        if not self.compared:
            return "nothing that the driver sent could be compared with what it would send now"
        if not self.differing:
            return f"all {self.compared} frames that the driver sent are what it would send now"
        count = sum(self.differing.values())
        which = ", ".join(f"{count} × {what}" for what, count in self.differing.most_common())
        return (
            f"of {self.compared} frames that the driver sent, "
            f"{count} are not what it would send now: {which}"
        )

    # ------------------------------------------------------------------ inside

    def _repeat(self, t_s: float, name: str, data: Any) -> Iterator[Told]:
        if name in ("bus_failed", "start_clock"):
            self._bus_works = name == "start_clock"
        try:
            otherwise = self._repeater.event(round(self._host_us + 1e6 * t_s, 3), name, data)
        except Exception as error:  # whatever a log holds, the timeline goes on
            yield self._give_up(t_s, error)
            return
        if otherwise:
            yield Told(t_s, None, f"≠ {otherwise}")
        if name == "commit":
            self._told.clear()
        yield from self._gather(t_s)
        yield from self._overdue(t_s)

    def _enter(self, t_s: float, state: Any) -> Iterator[Told]:
        """Go on where the axes stand."""
        self._begin()
        try:
            self._repeater.enter(state)
        except Exception as error:  # whatever a log holds, the timeline goes on
            yield self._give_up(t_s, error)
            return
        self._running, self._phase, self._entered_s = True, self._group.phase, t_s
        text = f"from here on the protocol is run over the log; group: {self._phase.value}"
        yield Told(t_s, None, text)

    def _is_ours(self, can_id: int) -> bool:
        if can_id in (epos2.SYNC, epos2.TIME, epos2.HEARTBEAT + HOST_NODE_ID):
            return True
        return can_id & 0x780 in _LENGTHS and can_id & 0x7F in self._names

    def _gather(self, t_s: float) -> Iterator[Told]:
        """What the group has made of it."""
        group, out = self._group, self._machine.out
        while out.frames:
            frame = out.frames.popleft()
            if self._bus_works and not frame.remote:
                self._expected.setdefault(frame.can_id, deque()).append((t_s, frame.data))
        out.requests.clear()  # the log has the answers, …
        out.polls.clear()  # … and these are frames of it
        while out.events:
            event = out.events.popleft()
            if event.kind in EVENTS:
                self._events.append((event.kind, event.text))
        if group.phase is not self._phase:
            text = f"group: {self._phase.value} → {group.phase.value}"
            self._phase = group.phase
            if not self._bus_works:
                self._expected.clear()
            yield Told(t_s, None, text)

    def _compare(self, line: FrameLine) -> Iterator[Told]:
        waiting = self._expected.setdefault(line.can_id, deque())
        place = next((n for n, (_, data) in enumerate(waiting) if self._alike(line, data)), None)
        if place is None and line.t_s < self._entered_s + ON_THE_WAY_S:
            return  # it was on its way when the log was entered
        self.compared += 1
        if place is not None:
            for due_s, data in [waiting.popleft() for _ in range(place + 1)][:-1]:
                yield from self._missing(due_s, line.can_id, data)
        elif self._alike(line, self._replaced.get(line.can_id)):
            del self._replaced[line.can_id]  # what took its place was one too many
        elif waiting:
            _, data = waiting.popleft()
            self._replaced[line.can_id] = data
            would = self._words(line._replace(data=data))
            text = f"{self._words(line)}: sent; it would be {would}"
            yield from self._differs(line.t_s, line.can_id, text)
        else:
            yield from self._differs(line.t_s, line.can_id, f"{self._words(line)}: sent")

    def _missing(self, due_s: float, can_id: int, data: bytes) -> Iterator[Told]:
        would = self._words(FrameLine(due_s, can_id, data, True))
        text = f"{would}: not on the bus, though it would be sent"
        yield from self._differs(due_s, can_id, text)

    @staticmethod
    def _alike(line: FrameLine, data: bytes | None) -> bool:
        if data is None:
            return False
        if line.can_id & 0x780 == epos2.RPDO3 and len(line.data) == len(data) == 4:
            sent, would = (int.from_bytes(stamp, "little") for stamp in (line.data, data))
            apart = (sent - would) % (1 << 32)
            return min(apart, (1 << 32) - apart) <= STAMP_TOLERANCE_US
        return line.data == data

    def _overdue(self, t_s: float) -> Iterator[Told]:
        """Frames that never were on the bus."""
        for can_id, waiting in self._expected.items():
            while waiting and t_s - waiting[0][0] > PATIENCE_US / 1e6:
                due_s, data = waiting.popleft()
                yield from self._missing(due_s, can_id, data)

    def _differs(self, t_s: float, can_id: int, text: str) -> Iterator[Told]:
        self.differing[self._kind(can_id)] += 1
        if can_id not in self._told:  # one difference makes the next
            self._told.add(can_id)
            node = can_id & 0x7F if can_id & 0x7F in self._names else None
            yield Told(t_s, node, f"≠ {text}")

    def _compare_event(self, t_s: float, kind: str, text: str) -> Iterator[Told]:
        said = f"{kind}: {text}"
        if self._events and self._events[0] == (kind, text):
            self._events.popleft()
        elif self._events:
            would = "{}: {}".format(*self._events.popleft())
            yield Told(t_s, None, f"≠ the driver said {said}; it would say {would}")
        else:
            yield Told(t_s, None, f"≠ the driver said {said}; it would not")

    @staticmethod
    def _kind(can_id: int) -> str:
        if can_id == epos2.SYNC:
            return "SYNC"
        if can_id == epos2.TIME:
            return "TIME"
        return {
            epos2.RPDO1: "record",
            epos2.RPDO2: "synchronous controlword",
            epos2.RPDO3: "time stamp",
            epos2.RPDO4: "controlword",
        }.get(can_id & 0x780, "heartbeat")

    def _words(self, line: FrameLine) -> str:
        function, data = line.can_id & 0x780, line.data
        kind = self._kind(line.can_id)
        if len(data) != _LENGTHS.get(function, -1):
            return f"{kind} {data.hex(' ')}".rstrip()
        if function == epos2.RPDO1:
            if line.can_id & 0x7F not in self._recorded:
                return f"segment {data.hex(' ')}"
            position, velocity, time = Record.unpack(data)
            return f"{kind} to {position} qc, velocity {velocity}, {time} ms"
        number = int.from_bytes(data, "little")
        return f"{kind} {number}" if function == epos2.RPDO3 else f"{kind} {_command(number)}"

    def _give_up(self, t_s: float, error: Exception) -> Told:
        return self._leave(t_s, " ".join(f"{type(error).__name__} {error}".split()))

    def _leave(self, t_s: float, why: str) -> Told:
        self._running = False
        text = f"the protocol can't be run over the log from here until the axes stand: {why}"
        return Told(t_s, None, f"≠ {text}")


def _command(value: int) -> str:
    return words.controlword(value)
