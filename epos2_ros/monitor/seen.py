"""What the driver's topics have said so far. Messages go in; no ROS, no terminal, no clock.

Times `now_s` are of one monotonic clock [s]. What makes no sense in a message is dropped and
counted in `dropped`; a status of other nodes is none of ours.
"""

from __future__ import annotations

import math
import re
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from time import localtime, strftime
from typing import Any

from epos2_ros.configuration.names import Names

OK, WARN, ERROR, STALE = range(4)  # diagnostic_msgs/DiagnosticStatus
EVENTS_KEPT = 200
LIFE_SIGN_S = 3.5  # /diagnostics come every second
_LEVELS = ((40, ERROR), (30, WARN), (0, OK))  # of rcl_interfaces/Log, from which value on


@dataclass
class Axis:
    """One axis; NaN or None where nothing has been said."""

    joint: str
    level: int = OK
    state: str = ""  # of CiA 402; "unknown": the drive is not heard
    message: str = ""
    position: float = math.nan  # [rad or m]
    velocity: float = math.nan  # [per second]
    error_qc: float | None = None
    clock_us: float | None = None
    used: int = 0  # records in the drive's buffer
    size: int = 0  # 0: no buffer
    buffered_ms: float = 0.0
    buffer_level: int = OK
    event: str = ""  # the last that has to do with it


@dataclass(frozen=True)
class Event:
    """Something that has happened, `time` in words."""

    time: str
    level: int
    text: str


@dataclass
class Seen:
    """All of it. `axes` are in the order of the driver's joints, `bus` has its keys' texts."""

    names: Names
    axes: dict[str, Axis] = field(default_factory=dict)
    bus: Mapping[str, str] = field(default_factory=dict)
    bus_level: int = STALE
    bus_message: str = ""
    outputs: dict[str, int] = field(default_factory=dict)  # how often each has fired
    events: deque[Event] = field(default_factory=lambda: deque(maxlen=EVENTS_KEPT))
    most_ms: float = 0.0  # the most motion that a buffer has held
    dropped: int = 0
    heard_s: float = -math.inf  # when /diagnostics came last

    def silent(self, now_s: float) -> bool:
        """Whether the driver is gone, or not configured."""
        return now_s - self.heard_s > LIFE_SIGN_S

    def on_joint_states(self, message: Any) -> None:
        """`sensor_msgs/JointState`."""
        sizes = {len(message.name), len(message.position), len(message.velocity)}
        if len(sizes) > 1:
            self.dropped += 1
            return
        for joint, *state in zip(message.name, message.position, message.velocity, strict=True):
            if (axis := self.axes.get(joint)) is not None:
                axis.position, axis.velocity = state

    def on_buffer_status(self, message: Any) -> None:
        """`diagnostic_msgs/DiagnosticArray` of `~/buffer_status`."""
        for status in message.status:
            values = _values(status)
            used, size = _number(values.get("used")), _number(values.get("size"))
            ahead = _number(values.get("buffered_ms"))
            if used is None or size is None or ahead is None:
                self.dropped += 1
            elif (axis := self.axes.get(status.name)) is not None:
                axis.used, axis.size, axis.buffered_ms = int(used), int(size), ahead
                axis.buffer_level = status.level[0]
                self.most_ms = max(self.most_ms, ahead)

    def on_diagnostics(self, message: Any, now_s: float) -> None:
        """`diagnostic_msgs/DiagnosticArray` of `/diagnostics`, on which others publish, too."""
        prefix = self.names.status("")
        ours = [status for status in message.status if status.name.startswith(prefix)]
        if not ours:
            return
        self.heard_s = now_s
        axes: dict[str, Axis] = {}
        for status in ours:
            part, values, level = status.name.removeprefix(prefix), _values(status), status.level[0]
            if "state" in values:
                axis, state = self.axes.get(part) or Axis(part), values["state"]
                axes[part] = axis
                if level > OK and status.message not in (state, axis.message):
                    axis.event = status.message
                axis.level, axis.state, axis.message = level, state, status.message
                axis.error_qc = _number(values.get("following error [qc]"))
                axis.clock_us = _number(values.get("clock offset [us]"))
            elif "group" in values:
                self.bus, self.bus_level, self.bus_message = values, level, status.message
            elif part.startswith("compare."):
                fired = _number(values.get("events"))
                self.outputs[part.removeprefix("compare.")] = int(fired or 0)
        self.axes = axes

    def on_output(self, name: str, message: Any) -> None:
        """`sensor_msgs/JointState` of `~/compare/<output>`: it has fired."""
        for joint, position in zip(message.name, message.position, strict=False):
            if (axis := self.axes.get(joint)) is not None:
                axis.event = f"{name} fired at {position:+.4f}"

    def on_log(self, message: Any) -> None:
        """`rcl_interfaces/Log` of `/rosout`: a line of the driver."""
        if message.name != self.names.logger:
            return
        text = " ".join(message.msg.split())
        level = next(level for least, level in _LEVELS if message.level >= least)
        self.tell(text, level, message.stamp.sec)
        for word in set(re.findall(r"[\w./-]+", text)):
            if (axis := self.axes.get(word)) is not None:
                axis.event = text.removeprefix(f"{word}: ")

    def tell(self, text: str, level: int, at_s: float) -> None:
        """Something happened at this time of day [s since the epoch].

        The last line again only gets its new time: an answer to the monitor is a line of the
        driver's log, too.
        """
        if self.events and self.events[-1].text == text:
            self.events.pop()
        self.events.append(Event(strftime("%H:%M:%S", localtime(at_s)), level, text))

    def in_trouble(self) -> Sequence[Axis]:
        """The axes whose drives are in fault or not heard."""
        return [axis for axis in self.axes.values() if axis.level >= ERROR]


def _values(status: Any) -> dict[str, str]:
    return {pair.key: pair.value for pair in status.values}


def _number(text: str | None) -> float | None:
    """None: not given, or no number."""
    try:
        number = float(text or "")
    except ValueError:
        return None
    return number if math.isfinite(number) else None
