"""What blocks, in threads of its own.

The executor has one thread, for all callbacks. What waits for drives or has to be worked out first
is handed on to a lane: a thread that does one thing after the other. A service whose callback runs
in a lane answers from there.

rclpy's executor of many threads is no way to have that: it submits a callback again and again until
one of its threads has begun it, and holds the interpreter's lock meanwhile
(https://github.com/ros2/rclpy/issues/1452).
"""

from __future__ import annotations

import signal
from collections import deque
from collections.abc import Callable
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from functools import partial
from typing import Any

from rclpy.context import Context
from rclpy.executors import Executor
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.service import Service
from rclpy.task import Future as ROSFuture

NEWEST = 10  # messages of a topic that wait for its lane
# Without an end the executor waits until the end of time, which overflows in an rclpy that was
# built for a C library before 2.30: it then waits busily, and holds a lock.
SPIN_S = 3600.0

_TAKEN_SIGNALS = (signal.SIGINT, signal.SIGTERM)


def events_executor(context: Context | None = None) -> Executor:
    """rclpy's executor that is woken by what has happened, and gathers nothing to wait for.

    It would take two signals for itself; they are left to the handlers that there are. Only in the
    main thread.
    """
    handlers = {number: signal.getsignal(number) for number in _TAKEN_SIGNALS}
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _TAKEN_SIGNALS)
    try:
        executor = EventsExecutor(context=context)
        for number, handler in handlers.items():
            signal.signal(number, handler)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    return executor


def spin(executor: Executor, ended: ROSFuture, broke: Callable[[str, BaseException], None]) -> None:
    """Run callbacks until `ended` is done or the context shut down; none that raises ends it."""
    while executor.context.ok() and not ended.done():
        try:
            executor.spin_until_future_complete(ended, SPIN_S)
        except Exception as error:
            broke("a callback", error)


class Lanes:
    """Threads by name. `broke(where, error)` is told what a callback raises."""

    def __init__(self, broke: Callable[[str, BaseException], None]) -> None:
        self._broke = broke
        self._threads: dict[str, ThreadPoolExecutor] = {}

    def run(self, lane: str, callback: Callable[..., Any], *args: Any) -> Future[Any]:
        """Call `callback` after all that was given to this lane before."""
        thread = self._threads.get(lane)
        if thread is None:
            thread = self._threads[lane] = ThreadPoolExecutor(1, thread_name_prefix=lane)
        done = thread.submit(callback, *args)
        done.add_done_callback(self._look)
        return done

    def answers(self, lane: str, service: Service) -> None:
        """This service's callback runs in a lane from now on; the executor does not wait for it."""
        callback, send = service.callback, service.send_response

        def begin(request: Any, response: Any) -> Any:
            return self.run(lane, callback, request, response)

        def send_when_done(answer: Future[Any], header: Any) -> None:
            answer.add_done_callback(partial(_send, send, header))

        service.callback = begin
        service.send_response = send_when_done  # type: ignore[method-assign,assignment]

    def takes(self, lane: str, callback: Callable[[Any], None]) -> Callable[[Any], None]:
        """A topic's callback that runs in a lane; the newest messages wait for it."""
        waiting: deque[Any] = deque(maxlen=NEWEST)

        def take() -> None:
            callback(waiting.popleft())

        def on_message(message: Any) -> None:
            full = len(waiting) == NEWEST  # whoever takes next gets one of them in any case
            waiting.append(message)
            if not full:
                self.run(lane, take)

        return on_message

    def close(self) -> None:
        """Returns when all that has begun is done; the rest never begins."""
        for thread in self._threads.values():
            thread.shutdown(cancel_futures=True)

    def _look(self, done: Future[Any]) -> None:
        if not done.cancelled() and (error := done.exception()) is not None:
            self._broke("a callback", error)


def _send(send: Callable[[Any, Any], None], header: Any, answer: Future[Any]) -> None:
    try:
        response = answer.result()
    except (CancelledError, Exception):  # which the lane has told
        return
    send(response, header)
