"""Commands that leave a drive's buffer empty at rest, one after the other, each given its time.

The drive is asked what is in its buffer, told what helps, and asked again: so what gets lost on the
way costs its time, and nothing that an earlier host or motion has left is ever executed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from epos2_ros.protocol import epos2
from epos2_ros.protocol.drive import Drive
from epos2_ros.protocol.family import PvtBuffer
from epos2_ros.protocol.frame import Frame
from epos2_ros.protocol.outbox import Outbox

ON_THE_WAY_US = 10_000.0  # a command, to the drive


class Emptying:
    """Of a drive whose buffer takes commands. Times are host µs."""

    def __init__(self, drive: Drive, buffer: PvtBuffer, out: Outbox) -> None:
        self._drive = drive
        self._buffer = buffer
        self._out = out
        self._due_us = math.inf  # when it is asked next
        self._answered = True
        self._command = b""  # to be sent
        self._failed = ""

    def begin(self) -> None:
        """What is in the buffer is not known, and to go."""
        self._due_us, self._answered = -math.inf, True
        self._command, self._failed = b"", ""

    def advance(self, now_us: float) -> str:
        """Do what is due; what keeps the buffer from being empty, "" if nothing."""
        if self._command:
            self._out.frames.append(Frame(epos2.RPDO1 + self._drive.node_id, self._command))
            self._command, self._due_us = b"", now_us + self._buffer.pause_us + ON_THE_WAY_US
        elif self._due_us == math.inf:
            return self._failed
        elif self._answered and now_us >= self._due_us:
            self._answered = False
            read = self._buffer.status
            self._out.ask(self._drive.node_id, reads=(read,), then=self._on_answer)
        return f"{self._drive}: its buffer is not empty"

    def _on_answer(self, values: Sequence[int], error: str) -> None:
        self._answered, self._failed = True, error
        if error:
            self._due_us = math.inf
            return
        assert self._buffer.remedy is not None
        self._drive.buffer_status = values[0]
        self._command = self._buffer.remedy(values[0])
        self._due_us = math.inf
