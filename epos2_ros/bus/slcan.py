"""python-can's slcan bus, reading what has come at once, and only what makes sense.

A byte at a time, each with two system calls, is 0.2 ms of CPU time per frame: a core for a bus that
is half full. At once it is a thirtieth of that, and no thread wakes up every millisecond.

A line that is no frame and no answer of an adapter is dropped and told: bytes get lost on serial
lines, and python-can raises on what is left of a line. Lines end with CR (LAWICEL AB, CANUSB manual
1.0), on some adapters with CR and LF.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from typing import Any

import can
from can.exceptions import error_check
from can.interfaces.slcan import slcanBus

WRITE_TIMEOUT_S = 1.0  # an adapter that takes nothing for so long is stuck
LONGEST_LINE = 64  # bytes; a frame has up to 31
_END = re.compile(rb"[\r\n\a]")  # of a line; \a: the command was refused
_HEX = rb"[0-9A-Fa-f]"
# Frame and remote request, with 11 and 29 bits; an adapter may add a time stamp of four digits.
_FRAME = re.compile(
    rb"(?:(?P<kind>[tr])(?P<id>%b{3})|(?P<long_kind>[TR])(?P<long_id>[01]%b{7}))"
    rb"(?P<length>[0-8])(?P<rest>%b*)" % (_HEX, _HEX, _HEX)
)
_STAMP = 4
# Done (with automatic polling "z" and "Z" for a frame sent), version, serial number, flags.
_ANSWER = re.compile(rb"|[zZ]|[vV]%b{4}|N\w{4}|F%b{2}" % (_HEX, _HEX))


class SlcanBus(slcanBus):
    """As `slcanBus`. `on_reject(kind, what)` is told of lines that were dropped."""

    # S7 is 800 kbit/s by the manual, of which python-can makes 750
    _BITRATES = {**slcanBus._BITRATES, 800_000: "S7"}

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        self.on_reject: Callable[[str, str], None] = lambda kind, what: None
        self._in_step = False  # what the adapter was saying when it was opened is over
        self._heard = False  # it has given us a frame
        super().__init__(*args, **kwargs)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Raises CanOperationError, also for an adapter that takes nothing any more."""
        super().send(msg, WRITE_TIMEOUT_S if timeout is None else timeout)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        line = self._read_line(timeout)
        if line is None:
            return None, False
        message = _message(line)
        if message is not None:
            self._heard = True
        elif not _ANSWER.fullmatch(line):
            self._drop(line)
        self._in_step = True
        return message, False

    def _read_line(self, timeout: float | None) -> bytes | None:
        """The next line; None if none has come in time (`None`: without limit)."""
        until = time.monotonic() + (timeout or 0.0)
        while (end := _END.search(self._buffer)) is None:
            if len(self._buffer) > LONGEST_LINE:
                self._drop(bytes(self._buffer))
                self._buffer.clear()
                self._in_step = False  # what follows is no whole line either
            with error_check("Could not read from serial device"):
                if self.serialPortOrig.timeout != timeout:  # to set it takes longer than to read
                    self.serialPortOrig.timeout = timeout
                chunk = self.serialPortOrig.read(max(1, self.serialPortOrig.in_waiting))
            self._buffer += chunk
            if not chunk or (timeout and time.monotonic() > until):
                return None
        line = bytes(self._buffer[: end.start()])
        if self._heard and end.group() == b"\a":
            self.on_reject("frame refused by the serial adapter", "the adapter can't send a frame")
        del self._buffer[: end.end()]
        return line

    def _drop(self, line: bytes) -> None:
        if self._in_step:
            self.on_reject("garbled serial line", f"garbled line {line[:LONGEST_LINE]!r}")


def _message(line: bytes) -> can.Message | None:
    """The frame that a line stands for; None if it is none."""
    found = _FRAME.fullmatch(line)
    if found is None:
        return None
    kind, rest = found["kind"] or found["long_kind"], found["rest"]
    length, remote = int(found["length"]), kind in b"rR"
    digits = 0 if remote else 2 * length
    if len(rest) not in (digits, digits + _STAMP):
        return None
    return can.Message(
        arbitration_id=int(found["id"] or found["long_id"], 16),
        is_extended_id=kind in b"TR",
        is_remote_frame=remote,
        dlc=length,
        data=None if remote else bytes.fromhex(rest[:digits].decode("ascii")),
    )
