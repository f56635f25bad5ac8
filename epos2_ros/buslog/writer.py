"""Writing a log without making anybody wait for it.

Whoever logs puts a value into a queue and goes on. A thread of the log's own turns what has
gathered into lines a few times a second and writes it. The queue is bounded: when the disk is too
slow, entries are dropped, counted, and the log says how many and where.

Files rotate: `run.asc` is being written, `run.1.asc` was before, and so on; the oldest are
deleted so that all of them together stay within the size given. Every file begins with the
configuration and can be read by itself. What an earlier run has left is kept the same way, since
it may be what somebody restarted the driver for.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO

from epos2_ros.buslog import asc
from epos2_ros.errors import ConfigurationError

FLUSH_S = 0.2
QUEUE_ENTRIES = 100_000  # about a minute of a full bus
FILES = 8  # so many files share the size
CLOCKS_S = 10.0  # so often the wall clock is noted
SUFFIX = ".asc"

Payload = Callable[[], Any]  # makes an event's data, on the log's thread
_Entry = tuple[float, str, Any]


class LogWriter:
    """A log that is open. Times are host µs; all methods but `close` return at once.

    `preamble` are the events, name and data, that every file begins with. `wall_offset_us` gives
    host time minus wall clock [µs]; `on_problem` gets one line, once, if the log can't go on.
    ConfigurationError when the file can't be written. `name` is what the user calls the file.
    """

    def __init__(
        self,
        file: Path,
        size_bytes: int,
        begin_us: float,
        wall_offset_us: Callable[[], float],
        on_problem: Callable[[str], None] = lambda text: None,
        preamble: tuple[tuple[str, Any], ...] = (),
        name: str = "log.file",
    ) -> None:
        if file.suffix != SUFFIX:
            raise ConfigurationError(f"{name} is '{file}'; it must end in {SUFFIX}")
        self._name = name
        self.file = file
        self.dropped = 0
        self._begin_us = begin_us
        self._wall_offset_us = wall_offset_us
        self._on_problem = on_problem
        self._preamble = preamble
        self._size = size_bytes
        self._part = 0
        self._clocks_due_s = CLOCKS_S
        self._told_dropped = 0
        self._out: BinaryIO | None = None
        self._written = 0  # bytes of the file
        self._queue: queue.SimpleQueue[_Entry] = queue.SimpleQueue()
        self._closing = threading.Event()
        try:
            self._begin_file()
        except OSError as error:
            raise ConfigurationError(
                f"{name} is '{file}', which can't be written: {error.strerror}"
            ) from error
        self._thread = threading.Thread(target=self._run, name="log", daemon=True)
        self._thread.start()

    # ------------------------------------------------------------------ from any thread

    def frame(self, t_us: float, can_id: int, data: bytes, sent: bool) -> None:
        """A data frame was on the bus, `sent` by us or received."""
        self._put((t_us, "Tx" if sent else "Rx", (can_id, data)))

    def other(self, t_us: float, kind: str, can_id: int, data: bytes) -> None:
        """Another frame was: `kind` is "error", "remote" or "extended"."""
        self._put((t_us, "other", (kind, can_id, data)))

    def event(self, t_us: float, name: str, data: Any = None) -> None:
        """Something happened; `data` is what JSON can hold, or makes it on the log's thread."""
        self._put((t_us, f"@{name}", data))

    def close(self) -> None:
        """Write what is waiting, and end."""
        self._closing.set()
        self._thread.join()

    def _put(self, entry: _Entry) -> None:
        if self._queue.qsize() < QUEUE_ENTRIES:
            self._queue.put(entry)
        else:
            self.dropped += 1

    # ------------------------------------------------------------------ the log's thread

    def _run(self) -> None:
        ending = False
        while not ending:
            ending = self._closing.wait(FLUSH_S)
            entries = list(self._waiting())
            if self._out is None:
                continue
            try:
                self._write(entries)
            except OSError as error:
                with suppress(OSError):
                    self._out.close()
                self._out = None
                self._on_problem(
                    f"{self._name} '{self.file}' can't be written any more: {error.strerror}; "
                    "it ends here"
                )
        if self._out is not None:
            self._out.close()

    def _waiting(self) -> Iterator[_Entry]:
        for _ in range(self._queue.qsize()):
            yield self._queue.get_nowait()

    def _write(self, entries: list[_Entry]) -> None:
        for t_us, what, data in entries:
            t_s = max(0.0, t_us - self._begin_us) / 1e6
            if t_s > self._clocks_due_s:
                self._clocks_due_s = t_s + CLOCKS_S
                self._line(asc.event_line(t_s, "clocks", self._clocks()))
            self._line(_line(t_s, what, data))
            if self._written > self._size // FILES:
                self._next_file(t_s)
        if self.dropped > self._told_dropped and entries:
            t_s = max(0.0, entries[-1][0] - self._begin_us) / 1e6
            lost, self._told_dropped = self.dropped - self._told_dropped, self.dropped
            self._line(asc.event_line(t_s, "dropped", {"entries": lost}))
            if lost == self.dropped:
                self._on_problem(
                    f"{self._name} '{self.file}': entries were dropped, since the disk is too "
                    "slow; the log says where"
                )
        if self._out is not None:
            self._out.flush()

    def _line(self, line: str) -> None:
        written = line.encode("utf-8", "replace")
        self._written += len(written)
        if self._out is not None:
            self._out.write(written)

    def _clocks(self) -> dict[str, float]:
        return {"wall_offset_us": self._wall_offset_us()}

    # ------------------------------------------------------------------ files

    def _next_file(self, t_s: float) -> None:
        self._line(asc.event_line(t_s, "continued"))
        if self._out is not None:
            self._out.close()
        self._begin_file()

    def _begin_file(self) -> None:
        self._rotate()
        self._out, self._written = self.file.open("wb"), 0
        wall_s = (self._begin_us - self._wall_offset_us()) / 1e6
        self._part += 1
        about = {
            "version": asc.VERSION,
            "host_us": self._begin_us,
            "wall_s": wall_s,
            "part": self._part,
        }
        self._line(asc.header(wall_s))
        for name, data in (("log", about), *self._preamble):
            self._line(asc.event_line(0.0, name, data))
        self._out.flush()

    def _rotate(self) -> None:
        """Make room for a new file: the others move on by one, the oldest are deleted."""
        older = list(earlier_files(self.file))
        room = self._size - self._size // FILES
        kept = []
        for path in [*([self.file] if self.file.is_file() else []), *older]:
            room -= path.stat().st_size
            if room >= 0:
                kept.append(path)
            else:
                path.unlink()
        for number, path in reversed(list(enumerate(kept, start=1))):
            path.rename(numbered(self.file, number))


def _line(t_s: float, what: str, data: Any) -> str:
    if what[0] == "@":
        return asc.event_line(t_s, what[1:], data() if callable(data) else data)
    if what == "other":
        return asc.other_line(t_s, *data)
    can_id, payload = data
    return asc.frame_line(t_s, can_id, payload, what == "Tx")


def numbered(file: Path, number: int) -> Path:
    """The `number`-th file before `file`, compressed if that is."""
    suffix = f"{SUFFIX}.gz" if file.name.endswith(f"{SUFFIX}.gz") else file.suffix
    return file.with_name(f"{file.name.removesuffix(suffix)}.{number}{suffix}")


def earlier_files(file: Path) -> Iterator[Path]:
    """The files that were written before `file`, the newest first."""
    number = 1
    while (path := numbered(file, number)).exists():
        yield path
        number += 1
