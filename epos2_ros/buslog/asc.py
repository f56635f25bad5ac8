"""The lines of a log: Vector's ASC format, as python-can reads and writes it.

    date Fri Nov 27 17:41:01.250 2026
    base hex  timestamps absolute
    internal events logged
    Begin Triggerblock Fri Nov 27 17:41:01.250 2026
    // @0.000000000 log {"version": 2, "host_us": 81234567.0, "wall_s": 1795801261.25, …}
    // @0.000012000 configuration {…}
    0.004817031 1  601             Tx   d 8 40 00 10 00 00 00 00 00
    0.005125874 1  581             Rx   d 8 43 00 10 00 92 01 02 00
    // @12.500871240 fault {"text": "joint_3 (node 3): following error (0x8611)"}

Text, because a log is wanted most when its writer was killed: whatever was written is readable to
the last line, by other tools and by eye. Time stamps are seconds of the host's monotonic clock
since `host_us`, to the nanosecond, which is all that the driver itself knows; `wall_s` is the wall
clock then, and `clocks` events say how the two have parted. An event is a comment, which other
readers skip: `// @`, its time, its name, and its data as JSON.
"""

from __future__ import annotations

import json
import re
from datetime import datetime
from typing import Any, NamedTuple

VERSION = 2  # of the events; another when the protocol layer is asked or answered otherwise
CHANNEL = 1
LONGEST_S = 1e9
_FRAME = re.compile(
    r"\s*(?P<t>\d+\.\d+)\s+\d+\s+(?P<id>[0-9A-F]+)(?P<extended>x?)\s+(?P<way>Rx|Tx)\s+"
    r"(?P<kind>[dr])(?:\s+(?P<length>[0-9A-F]+)(?P<data>(?:\s+[0-9A-F]{1,3})*).*)?$",
    re.ASCII | re.IGNORECASE,
)
_ERROR_FRAME = re.compile(r"\s*(?P<t>\d+\.\d+)\s+\d+\s+ErrorFrame", re.ASCII | re.IGNORECASE)
_EVENT = re.compile(r"// @(?P<t>\d+\.\d+) (?P<name>\w+)(?: (?P<data>.+))?$", re.ASCII)
# What else such a file may hold, and nothing of it is lost on us.
_SKIPPED = re.compile(
    r"\s*($|//|date\s|base\s|(no\s+)?internal\s+events|begin\s+trigger|end\s+trigger|"
    r"\d+\.\d+\s+(start of measurement|can\s|\d+\s+statistic|canfd\s|triggerevent|log\s))",
    re.ASCII | re.IGNORECASE,
)


class FrameLine(NamedTuple):
    """A data frame, or a remote or error frame of no data."""

    t_s: float
    can_id: int
    data: bytes
    sent: bool  # by the one who wrote the log
    kind: str = "data"  # or "extended", "remote", "error"


class EventLine(NamedTuple):
    """Something else that happened."""

    t_s: float
    name: str
    data: Any = None


def header(wall_s: float) -> str:
    """The first lines of a file whose time stamps count from `wall_s` [s since 1970]."""
    began = datetime.fromtimestamp(wall_s)
    date = began.strftime(f"%a %b %d %H:%M:%S.{began.microsecond // 1000:03d} %Y")
    return (
        f"date {date}\nbase hex  timestamps absolute\ninternal events logged\n"
        f"Begin Triggerblock {date}\n"
    )


def frame_line(t_s: float, can_id: int, data: bytes, sent: bool) -> str:
    """A data frame with an 11-bit identifier."""
    way = "Tx" if sent else "Rx"
    return f"{t_s:.9f} {CHANNEL}  {can_id:<15X} {way}   d {len(data):x} {data.hex(' ').upper()}\n"


def other_line(t_s: float, kind: str, can_id: int, data: bytes) -> str:
    """A frame that is not of CANopen as the driver speaks it."""
    if kind == "error":
        return f"{t_s:.9f} {CHANNEL}  ErrorFrame\n"
    if kind in ("remote", "request"):  # somebody else's, our own
        way = "Tx" if kind == "request" else "Rx"
        return f"{t_s:.9f} {CHANNEL}  {can_id:<15X} {way}   r 0\n"
    number = f"{can_id:X}x"
    return f"{t_s:.9f} {CHANNEL}  {number:<15} Rx   d {len(data):x} {data.hex(' ').upper()}\n"


def event_line(t_s: float, name: str, data: Any = None) -> str:
    """An event; `data` is what JSON can hold."""
    written = "" if data is None else f" {json.dumps(data, ensure_ascii=False, default=str)}"
    return f"// @{t_s:.9f} {name}{written}\n"


def parse(line: str, base: int = 16) -> FrameLine | EventLine | None:
    """What a line says; None for one that says nothing to us, ValueError for garbage.

    `base` is that of identifiers and data, as the line `base` of the file says.
    """
    if event := _EVENT.match(line):
        try:
            data = json.loads(event["data"]) if event["data"] else None
        except RecursionError:
            raise ValueError("nested too deep") from None
        return EventLine(_seconds(event["t"]), event["name"], data)
    if frame := _FRAME.match(line):
        length = int(frame["length"] or "0", 16)
        values = (frame["data"] or "").split()[:length]
        remote = frame["kind"] in "rR"
        if not remote and (len(values) < length or length > 8):
            raise ValueError("a frame cut short")
        kind = "remote" if remote else "extended" if frame["extended"] else "data"
        return FrameLine(
            _seconds(frame["t"]),
            int(frame["id"], base),
            b"" if remote else bytes(int(value, base) for value in values),
            frame["way"] in ("Tx", "TX", "tx"),
            kind,
        )
    if error := _ERROR_FRAME.match(line):
        return FrameLine(_seconds(error["t"]), 0, b"", False, "error")
    if _SKIPPED.match(line):
        return None
    raise ValueError("not a line of an ASC file")


def _seconds(text: str) -> float:
    """A time stamp; ValueError for one that no log lasts to."""
    seconds = float(text)
    if seconds > LONGEST_S:
        raise ValueError("a time beyond all logs")
    return seconds
