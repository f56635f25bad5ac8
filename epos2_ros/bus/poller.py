"""Polls: the same object read from several drives at once, on a thread of its own.

A poll does not wait for a drive that is slow, nor for the worker, which may be waiting for one that
is dead: what its clock was at a SYNC is worth something only until the next.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from threading import Lock

from epos2_ros.bus.sdo_client import RemoteNode
from epos2_ros.protocol.outbox import Poll

PATIENCE_S = 0.05  # for all answers to a poll
BUSY_S = 0.02  # for so long, with whoever has another access at work


class Poller:
    """`node(node_id)`: whom to ask; `on_error` gets what nobody waits for."""

    def __init__(
        self, node: Callable[[int], RemoteNode], on_error: Callable[[Exception], None]
    ) -> None:
        self._node = node
        self._on_error = on_error
        self._executor = ThreadPoolExecutor(1, thread_name_prefix="poll")
        self._busy = Lock()

    def poll(self, poll: Poll) -> None:
        """Ask soon, from any thread; nobody while the poll before is not over."""
        if self._busy.acquire(blocking=False):
            try:
                self._executor.submit(self._run, poll)
            except RuntimeError:  # it is closed
                self._busy.release()

    def close(self) -> None:
        """Returns when the poll at work is over."""
        self._executor.shutdown(cancel_futures=True)

    def _run(self, poll: Poll) -> None:
        try:
            ask_together((self._node(node_id) for node_id in poll.node_ids), poll.read.request)
        except Exception as error:
            self._on_error(error)
        finally:
            self._busy.release()


def ask_together(nodes: Iterable[RemoteNode], request: bytes) -> None:
    """Ask each, and see that they answer; last whoever has another access at work."""
    busy_until_s = time.monotonic() + BUSY_S
    clients = [node.sdo for node in nodes]
    asked = [client for client in clients if client.begin(request)]
    for client in asked:
        client.end(PATIENCE_S)
    for client in clients:
        if client not in asked and client.begin(request, busy_until_s - time.monotonic()):
            client.end(PATIENCE_S)
