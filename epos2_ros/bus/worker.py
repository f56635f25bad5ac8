"""The one thread on which all SDO runs: canopen's client of a node does one thing at a time."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from typing import TypeVar

from epos2_ros.errors import BusError

T = TypeVar("T")


class Worker:
    """Jobs run one after another, in the order in which they come from any thread.

    `on_error` gets what a job raises that nobody waits for.
    """

    def __init__(self, on_error: Callable[[Exception], None]) -> None:
        self._on_error = on_error
        self._executor = ThreadPoolExecutor(1, thread_name_prefix="sdo")
        self._open = True
        self._lock = threading.Lock()

    def post(self, job: Callable[[], None]) -> None:
        """Run `job` soon. Once the worker is closed nothing is: the bus is about to be."""

        def run() -> None:
            try:
                job()
            except Exception as error:
                self._on_error(error)

        self._submit(run)

    def run(self, job: Callable[[], T]) -> T:
        """What `job` returns or raises; BusError when the worker is closed before it is run."""
        answer = self._submit(job)
        try:
            if answer is not None:
                return answer.result()
        except CancelledError:
            pass
        raise BusError("the bus is closed")

    def close(self) -> None:
        """Returns when the job at work has ended; the others are given up."""
        with self._lock:
            self._open = False
        self._executor.shutdown(cancel_futures=True)

    def _submit(self, job: Callable[[], T]) -> Future[T] | None:
        with self._lock:
            return self._executor.submit(job) if self._open else None
