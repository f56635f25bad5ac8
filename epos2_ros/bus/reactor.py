"""One thread that owns all state; everything else hands it jobs.

Jobs run in the order in which they come, so no thread can starve another by holding a lock. What
is due by the clock runs after those that have come meanwhile: it sees all that is known by then.
After jobs that only read nothing can have become due. What raises is reported, and the next job
runs.

Who calls waits for the answer, so callers are bounded by themselves; what the bus sends is not, and
is refused where too much of it waits already.
"""

from __future__ import annotations

import math
import queue
import threading
from collections.abc import Callable
from concurrent.futures import Future
from concurrent.futures import TimeoutError as FutureTimeoutError
from typing import TypeVar

from epos2_ros.bus.lateness import Lateness
from epos2_ros.bus.realtime import Scheduling
from epos2_ros.bus.timestamps import now_us
from epos2_ros.errors import BusError

T = TypeVar("T")
Job = Callable[[], None]

CALL_TIMEOUT_S = 10.0  # no job takes so long
LOOK_AGAIN_S = 0.5  # whether the thread is still there
MOST_WAITING = 20_000  # jobs: what a bus at 1 Mbit/s brings in two seconds, in some ten megabytes
RETRY_US = 10_000.0  # until `step` is called again when it has raised


class Reactor:
    """Runs `step` when it is due, and jobs as they come.

    `step()` does what is due and returns when it wants to be called next (host time, µs).
    `on_error` gets what it or a job raises. `priority`: of SCHED_FIFO; 0: an ordinary thread.
    `lateness` is by how much later than it was due, or than the last one had begun, `step` was
    called: the thread woke late, or was at something else.
    """

    def __init__(
        self,
        step: Callable[[], float],
        on_error: Callable[[Exception], None],
        priority: int = 0,
    ) -> None:
        self._step = step
        self._on_error = on_error
        self.scheduling = Scheduling(priority)
        self.lateness = Lateness()
        self._inbox: queue.SimpleQueue[Job] = queue.SimpleQueue()
        self._changed = True  # by a job, since `step` was called
        self._stopping = False
        self._thread = threading.Thread(target=self._run, name="reactor", daemon=True)

    def start(self) -> None:
        """From now on jobs and `step` run."""
        self._thread.start()

    def stop(self) -> None:
        """Returns when the thread has ended; jobs that came too late are not run."""
        if self._thread.is_alive():
            self.post(self._end)
            self._thread.join()

    def post(self, job: Job) -> None:
        """Run `job` soon; from any thread."""

        def changing() -> None:
            self._changed = True
            job()

        self._inbox.put(changing)

    def offer(self, job: Job) -> bool:
        """`post`, unless too much waits already; whether it was taken."""
        if self._inbox.qsize() >= MOST_WAITING:
            return False
        self.post(job)
        return True

    def call(self, function: Callable[[], T]) -> T:
        """Run `function` in the reactor and return what it returns, or raise what it raises.

        BusError when the reactor does not get to it.
        """

        def changing() -> T:
            self._changed = True
            return function()

        return self.read(changing)

    def read(self, function: Callable[[], T]) -> T:
        """As `call`, for what changes nothing."""
        if not self._thread.is_alive():
            raise BusError("the bus is not open: configure first")
        answer: Future[T] = Future()

        def job() -> None:
            try:
                answer.set_result(function())
            except Exception as error:  # handed to the caller
                answer.set_exception(error)

        self._inbox.put(job)
        until_s = now_us() / 1e6 + CALL_TIMEOUT_S
        while now_us() / 1e6 < until_s:
            try:
                return answer.result(LOOK_AGAIN_S)
            except FutureTimeoutError:
                if answer.done():  # what the function has raised
                    raise
                if not self._thread.is_alive():
                    raise BusError("the bus is closed") from None
        raise BusError(
            f"the driver's thread has been busy for {CALL_TIMEOUT_S:g} s: does the CAN adapter "
            "still take frames?"
        )

    def _end(self) -> None:
        self._stopping = True

    def _run(self) -> None:
        self.scheduling.begin()
        due_us, stepped_us = -math.inf, now_us()
        while not self._stopping:
            now = now_us()
            if self._changed or now >= due_us:
                if now >= due_us:
                    self.lateness.add(now - max(due_us, stepped_us))
                self._changed, stepped_us = False, now
                due_us = self._guarded_step()
            wait_s = (due_us - now_us()) / 1e6
            try:
                job = self._inbox.get(timeout=max(0.0, wait_s))
            except queue.Empty:
                continue
            self._guarded(job)
            for _ in range(self._inbox.qsize()):
                self._guarded(self._inbox.get_nowait())

    def _guarded_step(self) -> float:
        self.scheduling.look()
        try:
            return self._step()
        except Exception as error:
            self._on_error(error)
            return now_us() + RETRY_US

    def _guarded(self, job: Job) -> None:
        self.scheduling.look()
        try:
            job()
        except Exception as error:
            self._on_error(error)
