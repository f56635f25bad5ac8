"""Whatever a thread could not handle ends here: said, and the axes are stopped.

An exception that nobody expected is a mistake in the driver, or in a library it uses. None may end
a thread, or leave it deaf, while axes move: the thread goes on with its next job, all axes stop,
and the group is in fault, from which `reset_fault` gets back.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path
from traceback import extract_tb

MAX_SAID = 100  # different mistakes of which the traceback is shown


class Supervisor:
    """`stop(reason)` stops all axes; it is called in whatever thread has failed."""

    def __init__(self, stop: Callable[[str], None]) -> None:
        self.mistakes = 0
        self._stop = stop
        self._said: set[str] = set()

    def broke(self, where: str, error: BaseException) -> None:
        """`where`: the thread or callback that raised `error`."""
        self.mistakes += 1
        text = f"internal error in {where}: {described(error)}"
        if text not in self._said and len(self._said) < MAX_SAID:
            self._said.add(text)
            logging.getLogger("epos2_ros").critical(text, exc_info=error)
        self._stop(text)

    def guarded(self, where: str, job: Callable[[], None]) -> Callable[[], None]:
        """The job, raising nothing."""

        def run() -> None:
            try:
                job()
            except Exception as error:
                self.broke(where, error)

        return run


def described(error: BaseException) -> str:
    """Kind, message and place of an exception, in one line."""
    words = " ".join(f"{type(error).__name__}: {error}".split())
    frames = extract_tb(error.__traceback__)
    return f"{words} ({Path(frames[-1].filename).name}:{frames[-1].lineno})" if frames else words
