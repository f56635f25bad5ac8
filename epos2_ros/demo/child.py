"""A program of the package as a child process: its log, its end."""

from __future__ import annotations

import os
import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Mapping, Sequence
from types import TracebackType

from epos2_ros.errors import Epos2RosError

STOP_TIMEOUT_S = 15.0  # for stopping on the path, disabling, closing and writing the log


class Child:
    """`epos2_ros NAME …`, interrupted (SIGINT) when the context ends, whatever ends it.

    What it writes comes as lines. It has a process group of its own: a Ctrl-C in the terminal
    reaches it only as the interrupt with which the demo ends it.
    """

    def __init__(self, name: str, arguments: Sequence[str], env: Mapping[str, str]) -> None:
        self.name = name
        self._lines: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._process = subprocess.Popen(
            [sys.executable, "-m", "epos2_ros", name, *arguments],
            env={**os.environ, **env, "PYTHONUNBUFFERED": "1"},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            start_new_session=True,
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self._lines.put(line.rstrip())

    def lines(self) -> list[str]:
        """What it has written since the last call."""
        new = []
        while not self._lines.empty():
            new.append(self._lines.get())
        return new

    def first_line(self, timeout_s: float) -> str:
        """Waits for the first line; Epos2RosError if none comes in time."""
        try:
            return self._lines.get(timeout=timeout_s)
        except queue.Empty:
            raise Epos2RosError(f"the {self.name} says nothing for {timeout_s:.0f} s") from None

    def check(self) -> None:
        """Epos2RosError when it has ended by itself."""
        status = self._process.poll()
        if status is not None:
            raise Epos2RosError(f"the {self.name} ended with status {status}")

    def stop(self) -> int:
        """Interrupts it, waits, and gives its exit status (negative: killed by that signal)."""
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)
            try:
                self._process.wait(STOP_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
        status = self._process.wait()
        self._reader.join()
        return status

    def __enter__(self) -> Child:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.stop()
