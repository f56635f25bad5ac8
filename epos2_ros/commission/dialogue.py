"""Questions to a person on a terminal, and their answers."""

from __future__ import annotations

import math
import re
import select
import shutil
import time
from collections.abc import Callable
from typing import TextIO

from epos2_ros.errors import Epos2RosError

REFRESH_S = 0.1
UNITS = {  # of an angle or a length, in rad or m
    "rad": {"": 1.0, "rad": 1.0, "deg": math.pi / 180, "°": math.pi / 180},
    "m": {"": 1.0, "m": 1.0, "mm": 1e-3, "cm": 1e-2},
}
_AMOUNT = re.compile(r"\s*([-+]?[\d.]+(?:[eE][-+]?\d+)?)\s*(\S*)\s*")


class NoMoreAnswers(Epos2RosError):
    """The input is at its end: whoever asked goes no further."""


class Dialogue:
    """Lines out, answers in; on a terminal something can be shown while an answer is awaited."""

    def __init__(self, answers: TextIO, out: TextIO) -> None:
        self._answers, self._out = answers, out
        self._shown_s = -math.inf
        self._live = answers.isatty() and out.isatty()

    def say(self, text: str = "") -> None:
        self._out.write(f"{text}\n")
        self._out.flush()

    def show(self, text: str) -> None:
        """In place of what was shown last, a few times a second; only on a terminal."""
        if self._live and time.monotonic() - self._shown_s > REFRESH_S:
            self._shown_s = time.monotonic()
            self._put(text)

    def clear(self) -> None:
        """Nothing is shown any more."""
        self._put("")

    def _put(self, text: str) -> None:
        if self._live:
            width = shutil.get_terminal_size().columns
            self._out.write(f"\r\x1b[K{text[: width - 1]}")
            self._out.flush()

    def ask(self, question: str, meanwhile: Callable[[], str] | None = None) -> str:
        """The line that is typed, without blanks around it; `meanwhile` is shown until then."""
        if meanwhile is not None and self._live:
            self.say(question)
            while not select.select([self._answers], [], [], REFRESH_S)[0]:
                self.show(meanwhile())
        else:
            self._out.write(f"{question} ")
            self._out.flush()
        line = self._answers.readline()
        if not line:
            self.say()
            raise NoMoreAnswers("no answer: ended here")
        return line.strip()

    def agreed(self, question: str) -> bool:
        """Yes or no; an empty line is no."""
        while True:
            answer = self.ask(f"{question} [y/N]").lower()
            if answer in ("y", "yes"):
                return True
            if answer in ("", "n", "no"):
                return False
            self.say("please answer y or n")

    def amount(self, question: str, unit: str) -> float | None:
        """An angle [rad] or length [m], also given in deg, mm or cm; None for an empty line."""
        while True:
            answer = self.ask(question)
            if not answer:
                return None
            try:
                return amount(answer, unit)
            except ValueError as error:
                self.say(str(error))


def amount(text: str, unit: str) -> float:
    """What `text` says, in `unit`, rad or m. ValueError with what is allowed."""
    found = _AMOUNT.fullmatch(text)
    scale = UNITS[unit].get(found[2]) if found else None
    try:
        if found is not None and scale is not None:
            return float(found[1]) * scale
    except ValueError:
        pass
    units = ", ".join(name for name in UNITS[unit] if name)
    raise ValueError(f"{text!r}: must be a number, of {unit} or with one of {units}")
