"""Any log of a CAN bus as lines in order, as far as it can be read.

A log of the driver's is read here, since its events are comments to everybody else; other formats
by python-can. Whatever is wrong with a file is counted and becomes one line in `complaints`, and an
event `unreadable` in its place; only a file in which there is nothing to be read raises.
"""

from __future__ import annotations

import gzip
import math
import re
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import TextIO

import can

from epos2_ros.buslog import asc
from epos2_ros.buslog.asc import EventLine, FrameLine
from epos2_ros.buslog.writer import earlier_files
from epos2_ros.errors import Epos2RosError

Line = FrameLine | EventLine
SUFFIXES = (".asc", ".asc.gz", ".log", ".blf", ".trc", ".csv")
HEAD_LINES = 50  # in so many the event `log` has to come
_BASE = re.compile(r"base\s+(hex|dec)", re.IGNORECASE)


class LogReader:
    """Iterate over it once; then `complaints` says what could not be read.

    Files that the driver began before this one, in the same run, are read first, where they lie
    beside it. `host_us` is the host time at 0 s, None in a log of others; `wall_s` the wall clock
    then, if the log says.
    """

    def __init__(self, file: Path) -> None:
        self.complaints: list[str] = []
        self.host_us: float | None = None
        self.wall_s: float | None = None
        self.from_the_start = True
        self._file = file
        if not file.name.lower().endswith(SUFFIXES):
            raise Epos2RosError(
                f"{file} is no log by its name: it must end in {', '.join(SUFFIXES)}"
            )
        try:
            self._files = self._parts() if _is_asc(file) else [file]
            self._first = self._begin()
        except OSError as error:
            raise Epos2RosError(f"can't read {file}: {error.strerror or error}") from error

    def __iter__(self) -> Iterator[Line]:
        yield from self._first

    # ------------------------------------------------------------------ inside

    def _begin(self) -> Iterator[Line]:
        """All lines; Epos2RosError when there is none, so that a wrong file is said at once."""
        lines = self._lines()
        first = next(lines, None)
        if first is None:
            why = f" ({self.complaints[0]})" if self.complaints else ""
            raise Epos2RosError(
                f"{self._file} holds no CAN frame{why}; give a log that the driver or simulator "
                "has written (log.file), or one that python-can reads, such as of candump -L"
            )
        return chain([first], lines)

    def _lines(self) -> Iterator[Line]:
        for file in self._files:
            yield from self._asc(file) if _is_asc(file) else self._foreign(file)

    def _asc(self, file: Path) -> Iterator[Line]:
        base, garbage, first, cut, last_s = 16, 0, 0, False, math.nan
        with _opened(file) as lines:
            for number, line in enumerate(_until_broken(lines), start=1):
                try:
                    parsed = asc.parse(line.rstrip("\r\n"), base)
                except ValueError:
                    if line.endswith("\n"):
                        garbage, first = garbage + 1, first or number
                        if not math.isnan(last_s):
                            yield EventLine(last_s, "unreadable", {"line": number})
                    else:
                        cut = True
                    continue
                if parsed is not None:
                    last_s = parsed.t_s
                    yield parsed
                elif said := _BASE.match(line):
                    base = 10 if said[1].lower() == "dec" else 16
        if garbage:
            many = f"; {garbage} such lines are left out" if garbage > 1 else "; it is left out"
            self.complaints.append(f"{file.name}, line {first}: not a line of an ASC file{many}")
        if cut:
            self.complaints.append(f"{file.name} ends in the middle of a line")

    def _foreign(self, file: Path) -> Iterator[FrameLine]:
        read, begin_s, beside = 0, 0.0, 0
        try:
            for message in can.LogReader(file):
                if not read:
                    begin_s = message.timestamp
                    self.wall_s = begin_s if begin_s > 1e9 else None
                read += 1
                if message.is_fd:
                    beside += 1
                    continue
                kind = (
                    "error"
                    if message.is_error_frame
                    else "remote"
                    if message.is_remote_frame
                    else "extended"
                    if message.is_extended_id
                    else "data"
                )
                t_s = message.timestamp - begin_s
                yield FrameLine(
                    t_s, message.arbitration_id, bytes(message.data), not message.is_rx, kind
                )
        except Exception as error:  # python-can's readers raise whatever a broken file makes them
            words = " ".join(str(error).split()) or type(error).__name__
            self.complaints.append(f"{file.name} can't be read beyond frame {read}: {words}")
        if beside:
            self.complaints.append(f"{file.name}: {beside} CAN FD frames are left out")

    def _parts(self) -> list[Path]:
        """The files of one run, the oldest first."""
        about = _about(self._file)
        if about is None:
            return [self._file]
        self.host_us, self.wall_s = float(about["host_us"]), float(about["wall_s"])
        if about.get("version") != asc.VERSION:
            self.complaints.append(
                f"{self._file.name} has events of another version ({about.get('version')}, here "
                f"{asc.VERSION}): lines with ≠ may come of that"
            )
        files, part = [self._file], int(about["part"])
        for earlier in earlier_files(self._file):
            before = _about(earlier) if part > 1 else None
            if before is None or before["host_us"] != self.host_us or before["part"] != part - 1:
                break
            part -= 1
            files.insert(0, earlier)
        if part > 1:
            self.from_the_start = False
            self.complaints.append(
                f"{files[0].name} is part {part} of a log; the parts before it are not beside it"
            )
        return files


def _is_asc(file: Path) -> bool:
    return file.name.lower().endswith((".asc", ".asc.gz"))


def _opened(file: Path) -> TextIO:
    if file.suffix.lower() == ".gz":
        return gzip.open(file, "rt", encoding="utf-8", errors="replace")
    return file.open(encoding="utf-8", errors="replace")


def _until_broken(lines: TextIO) -> Iterator[str]:
    """Lines as far as a compressed file goes."""
    try:
        yield from lines
    except EOFError:
        yield "end of a compressed file that was cut short"


def _about(file: Path) -> dict[str, float] | None:
    """What the driver says of its file at its head; None if it is not the driver's."""
    with _opened(file) as lines:
        for line, _ in zip(_until_broken(lines), range(HEAD_LINES), strict=False):
            try:
                parsed = asc.parse(line.rstrip("\r\n"))
            except ValueError:
                continue
            if isinstance(parsed, EventLine) and parsed.name == "log":
                data = parsed.data if isinstance(parsed.data, dict) else {}
                numbers = [data.get(name) for name in ("host_us", "wall_s", "part")]
                known = all(isinstance(number, (int, float)) for number in numbers)
                return data if known else None
    return None
