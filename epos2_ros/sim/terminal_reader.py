"""Reads a terminal in a process of its own, and says of what comes when it came.

A socket's frames are stamped by the kernel, a terminal's bytes are not. Whoever simulates drives
on a busy computer gets to them late, and would take a record for late that was there in time. This
program does nothing else, so it is there when something comes; it needs only the standard library,
so it is ready soon.
"""

from __future__ import annotations

import os
import select
import struct
import subprocess
import sys
import time

_HEADER = struct.Struct("<dI")  # wall clock [s], number of bytes that follow
_MOST = 4000  # bytes at once: a pipe takes so many as one


class TerminalReader:
    """What comes from an open terminal, from now on until `close`."""

    def __init__(self, terminal: int) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-IS", __file__, str(terminal)],
            stdin=subprocess.PIPE,  # its end is ours
            stdout=subprocess.PIPE,
            pass_fds=[terminal],
            start_new_session=True,  # an interrupt from the keyboard is not for it
        )
        assert self._process.stdout is not None
        self._told = bytearray()
        self._pipe = self._process.stdout.fileno()

    def fileno(self) -> int:
        """Readable when there is something to `look` at."""
        return self._pipe

    def look(self) -> None:
        """Take in what was told. Raises OSError when nothing can come any more."""
        more = os.read(self._pipe, 1 << 16)
        if not more:
            raise OSError("the terminal is read no more: its reader has ended")
        self._told += more

    def read(self, timeout_s: float | None) -> tuple[float, bytes] | None:
        """The next bytes, and when they came (wall clock [s]); None: nothing in time."""
        while (end := self._end()) is None:
            if not select.select([self], [], [], timeout_s)[0]:
                return None
            self.look()
        came_s, _ = _HEADER.unpack_from(self._told)
        data = bytes(self._told[_HEADER.size : end])
        del self._told[:end]
        return came_s, data

    def _end(self) -> int | None:
        """Of the first that was told, if that is whole."""
        if len(self._told) < _HEADER.size:
            return None
        end = _HEADER.size + int(_HEADER.unpack_from(self._told)[1])
        return end if len(self._told) >= end else None

    def close(self) -> None:
        self._process.kill()
        self._process.communicate()


def main(terminal: int) -> None:
    """Until whoever started it is gone, or the terminal is."""
    while True:
        ready, _, _ = select.select([terminal, sys.stdin.fileno()], [], [])
        if sys.stdin.fileno() in ready:
            return
        try:
            data = os.read(terminal, _MOST)
        except BlockingIOError:
            continue
        except OSError:
            return
        os.write(sys.stdout.fileno(), _HEADER.pack(time.time(), len(data)) + data)


if __name__ == "__main__":
    main(int(sys.argv[1]))
