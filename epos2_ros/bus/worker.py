"""The one thread on which all SDO runs: canopen's client of a node does one thing at a time."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from typing import TypeVar

from epos2_ros.errors import BusError

T = TypeVar("T")


def tell_failure(job: Future[None]) -> None:
    """For a job whose answer nobody waits for: what it raised is told, not swallowed."""
    if not job.cancelled():
        job.result()  # in a callback of a future, this is logged with its traceback


class Worker:
    """Jobs run one after another, in the order in which they come from any thread."""

    def __init__(self) -> None:
        self._executor = ThreadPoolExecutor(1, thread_name_prefix="sdo")
        self._open = True
        self._lock = threading.Lock()

    def post(self, job: Callable[[], None]) -> None:
        """Run `job` soon. Once the worker is closed nothing is: the bus is about to be."""
        if (answer := self._submit(job)) is not None:
            answer.add_done_callback(tell_failure)

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
