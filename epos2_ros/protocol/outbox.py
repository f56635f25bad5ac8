"""What the machine of the axes wants done: frames, accesses by SDO, lines for the log.

The machine does no I/O; whoever drives it empties these queues after each call.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from epos2_ros.protocol.frame import Frame
from epos2_ros.protocol.sdo import SdoRead, SdoWrite


class Event(NamedTuple):
    """Something a user wants to read in the log."""

    # "waiting", "started", "replaced", "done", "followed" (how near, by set-points), "cancelled",
    # "stopped" (on request, off the path), "aborted", "fault", "warning", "debug" or "drive" (who
    # it is)
    kind: str
    text: str


class SdoRequest(NamedTuple):
    """Accesses to one drive, in order: first the writes, then the reads. `Outbox.answer` it."""

    number: int
    node_id: int
    writes: tuple[SdoWrite, ...] = ()
    reads: tuple[SdoRead, ...] = ()


class Poll(NamedTuple):
    """A read from several drives at once, now or never: whose answer does not come, or who is busy
    with another access for long, is not asked again. The answers are seen on the bus as any other
    frame.
    """

    node_ids: tuple[int, ...]
    read: SdoRead


class _Asked(NamedTuple):
    """A request that was made."""

    node_id: int
    writes: bool
    then: Callable[[Sequence[int], str], None]


@dataclass
class Outbox:
    """The queues, in the order in which things came up."""

    frames: deque[Frame] = field(default_factory=deque)
    requests: deque[SdoRequest] = field(default_factory=deque)
    polls: deque[Poll] = field(default_factory=deque)
    events: deque[Event] = field(default_factory=deque)
    count: int = 0  # of requests so far
    half_written: set[int] = field(default_factory=set)  # node ids: not all got there
    _asked: dict[int, _Asked] = field(default_factory=dict)  # and not answered, by number

    def announce(self, kind: str, text: str) -> None:
        """A line for the log."""
        self.events.append(Event(kind, text))

    def ask(
        self,
        node_id: int,
        writes: Sequence[SdoWrite] = (),
        reads: Sequence[SdoRead] = (),
        then: Callable[[Sequence[int], str], None] = lambda values, error: None,
    ) -> None:
        """Access a drive; `then(values, error)` with what was read, or why something was not."""
        self.count += 1
        self._asked[self.count] = _Asked(node_id, bool(writes), then)
        self.requests.append(SdoRequest(self.count, node_id, tuple(writes), tuple(reads)))

    def answer(self, number: int, values: Sequence[int] = (), error: str = "") -> None:
        """A request has been carried out, or could not be."""
        if asked := self._asked.pop(number, None):
            if error and asked.writes:
                self.half_written.add(asked.node_id)
            asked.then(values, error)

    def forget(self, node_id: int) -> None:
        """A drive has been brought up anew: nobody waits any more for what it was asked."""
        self.half_written.discard(node_id)
        for number in [n for n, asked in self._asked.items() if asked.node_id == node_id]:
            del self._asked[number]

    @property
    def unanswered(self) -> set[int]:
        """Ids of the nodes that have not yet done what they were asked."""
        return {asked.node_id for asked in self._asked.values()}
