"""Output that is a pleasure on a terminal and plain everywhere else."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Sequence
from typing import TextIO

BAR = " ▏▎▍▌▋▊▉█"


class Terminal:
    """Lines, and a block of lines that is redrawn in place."""

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = sys.stdout if stream is None else stream
        self.interactive = self._stream.isatty() and os.environ.get("TERM") != "dumb"
        self._colours = self.interactive and "NO_COLOR" not in os.environ
        self._block = 0  # lines of the block that stands at the end

    def line(self, text: str = "") -> None:
        """A line that stays; a block that stood below is drawn anew by its owner."""
        self._erase()
        self._stream.write(f"{text}\n")
        self._stream.flush()

    def block(self, lines: Sequence[str]) -> None:
        """Shows these lines in place of the last block; only on an interactive terminal."""
        width = shutil.get_terminal_size().columns
        self._erase()
        for line in lines:
            self._stream.write(f"{line[: width - 1]}\n")
        self._block = len(lines)
        self._stream.flush()

    def _erase(self) -> None:
        if self._block:
            self._stream.write(f"\x1b[{self._block}A\x1b[J")
            self._block = 0

    def bold(self, text: str) -> str:
        return self._coloured(text, "1")

    def faint(self, text: str) -> str:
        return self._coloured(text, "2")

    def judged(self, text: str, good: bool) -> str:
        """Green or red; without colours what is bad gets a mark."""
        if self._colours:
            return self._coloured(text, "32" if good else "31")
        return text if good else f"{text}!"

    def _coloured(self, text: str, code: str) -> str:
        return f"\x1b[{code}m{text}\x1b[0m" if self._colours else text


def bar(share: float, width: int) -> str:
    """`share` (0 … 1) of `width` characters, in eighths."""
    eighths = round(max(0.0, min(1.0, share)) * width * 8)
    full, rest = divmod(eighths, 8)
    return ("█" * full + (BAR[rest] if rest else "")).ljust(width)
