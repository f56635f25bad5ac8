"""Lines for the log that nobody can flood it with: of each kind so many a second."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

LINES_A_SECOND = 10


class LogLines:
    """Thread-safe. `now_s`: a clock that is never set."""

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        self._now_s = now_s
        self._lock = threading.Lock()
        self._window: dict[str, tuple[float, int]] = {}  # by kind: since when, how many lines
        self._left_out: dict[str, int] = {}

    def admit(self, kind: str, line: str) -> str | None:
        """The line to be written, saying how many before it were not; None: neither is this."""
        with self._lock:
            now_s = self._now_s()
            since_s, count = self._window.get(kind, (now_s, 0))
            if now_s >= since_s + 1.0:
                since_s, count = now_s, 0
            self._window[kind] = since_s, count + 1
            if count >= LINES_A_SECOND:
                self._left_out[kind] = self._left_out.get(kind, 0) + 1
                return None
            left_out = self._left_out.pop(kind, 0)
        return f"{line} ({left_out} lines of this kind were left out)" if left_out else line
