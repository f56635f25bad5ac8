"""Keys as they are pressed, from a terminal (POSIX)."""

from __future__ import annotations

import os
import re
import select
import termios
import tty
from types import TracebackType

_SEQUENCES = {
    "\x1b[A": "up",
    "\x1b[B": "down",
    "\x1bOA": "up",  # in the application mode of cursor keys
    "\x1bOB": "down",
    "\x1b[5~": "page up",
    "\x1b[6~": "page down",
}
_KEY = re.compile(r"\x1b[\[O][0-9;]*[A-Za-z~]|.", re.DOTALL)


class Keyboard:
    """A terminal without line editing and echo while the context lasts; Ctrl-C goes on to work."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor

    def __enter__(self) -> Keyboard:
        self._before = termios.tcgetattr(self._descriptor)
        tty.setcbreak(self._descriptor)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        termios.tcsetattr(self._descriptor, termios.TCSADRAIN, self._before)

    def pressed(self, wait_s: float) -> list[str]:
        """Characters, or `up`, `down`, …, as soon as there are some, [] after `wait_s`.

        EOFError when the terminal is gone.
        """
        if not select.select([self._descriptor], [], [], wait_s)[0]:
            return []
        data = os.read(self._descriptor, 1024)
        if not data:
            raise EOFError
        return keys_in(data.decode(errors="replace"))


def keys_in(text: str) -> list[str]:
    """What a terminal sends for keys, as their names; sequences of others are left out."""
    found = (_SEQUENCES.get(key, key) for key in _KEY.findall(text))
    return [key for key in found if not key.startswith("\x1b")]
