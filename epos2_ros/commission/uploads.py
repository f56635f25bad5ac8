"""SDO uploads from many nodes at once: frames and times in, frames out; no I/O.

The rules this file keeps:

* Nothing is ever sent but "initiate SDO upload" and "upload SDO segment" (CiA 301, 7.2.4.3): who
  reads by these alone changes nothing on a device.
* A node is asked one thing at a time, the nodes are asked side by side.
* Frames go out no closer than `gap_us`, so that the bus stays free for those who work on it.
* After an answer a node is left alone for `settle_us`: a second answer in this time is of a second
  device with the same node id. All that nobody asked for is kept in `strays`.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Generator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

from epos2_ros.protocol.frame import Frame

REQUEST, RESPONSE = 0x600, 0x580  # + node id (CiA 301, 7.3.5)
INITIATE_UPLOAD, UPLOAD_SEGMENT = 0x40, 0x60
ATTEMPTS = 2  # a request may be lost, a device may be busy
LONGEST = 4096  # bytes of a value; what is longer is no parameter of a drive


class Refusal(NamedTuple):
    """A node aborts the transfer, with this code (CiA 301, table 22)."""

    code: int


Answer = bytes | Refusal | None
"""The value as it is on the bus (little-endian); None: no answer, or one that makes no sense."""

Address = tuple[int, int]
Questions = Generator[Address, Answer, None]
"""What to ask one node: yields (index, subindex), is sent the answer."""


class Stray(NamedTuple):
    """An SDO response that nobody asked for, and what was accepted last before it."""

    data: bytes
    accepted: bytes


@dataclass
class _Talk:
    """With one node."""

    questions: Questions
    address: Address = (0, 0)
    request: bytes = b""
    attempts: int = 0
    asked: bool = False  # the request is on its way, an answer is due
    due_us: float = 0.0  # to ask, or to give up waiting
    segments: bytearray | None = None  # of a segmented upload, so far

    def initiate(self) -> None:
        index, subindex = self.address
        multiplexer = index.to_bytes(2, "little") + bytes([subindex])
        self.request = bytes([INITIATE_UPLOAD]) + multiplexer + bytes(4)
        self.segments = None


class Uploads:
    """Asks each node of `questions` what its generator yields.

    `advance(t_us)` has to be called at `deadline_us`; what is to be sent is in `outbox`. `done`
    when every generator has ended.
    """

    def __init__(
        self,
        questions: Mapping[int, Questions],
        t_us: float,
        *,
        gap_us: float,
        settle_us: float,
        timeout_us: float,
    ) -> None:
        self.outbox: deque[Frame] = deque()
        self.strays: dict[int, list[Stray]] = {}
        self._accepted: dict[int, bytes] = {}
        self._late: Counter[int] = Counter()  # answers that may still come, too late
        self._gap_us, self._settle_us, self._timeout_us = gap_us, settle_us, timeout_us
        self._send_us = t_us  # not before
        self._talks: dict[int, _Talk] = {}
        for node_id, asks in questions.items():
            talk = _Talk(asks, due_us=t_us)
            try:
                talk.address = next(asks)
            except StopIteration:
                continue
            talk.initiate()
            self._talks[node_id] = talk

    @property
    def done(self) -> bool:
        return not self._talks

    @property
    def deadline_us(self) -> float:
        """When something is due; inf when nothing is."""
        return min(
            (
                talk.due_us if talk.asked else max(talk.due_us, self._send_us)
                for talk in self._talks.values()
            ),
            default=math.inf,
        )

    def advance(self, t_us: float) -> None:
        """Ask what is to be asked now, give up what was not answered in time."""
        for node_id, talk in list(self._talks.items()):
            if talk.asked and talk.due_us <= t_us:
                self._on_silence(node_id, talk, t_us)
        waiting = [item for item in self._talks.items() if not item[1].asked]
        for node_id, talk in sorted(waiting, key=lambda item: item[1].due_us):
            if max(talk.due_us, self._send_us) > t_us:
                break
            self.outbox.append(Frame(REQUEST + node_id, talk.request))
            talk.asked, talk.due_us = True, t_us + self._timeout_us
            talk.attempts += talk.segments is None
            self._send_us = max(self._send_us + self._gap_us, t_us)

    def receive(self, frame: Frame, t_us: float) -> None:
        """A frame of another node was on the bus."""
        node_id = frame.can_id - RESPONSE
        if frame.can_id & 0x780 != RESPONSE or node_id == 0:
            return
        talk, data = self._talks.get(node_id), frame.data
        if talk is not None and talk.asked and len(data) == 8 and self._take(node_id, data, t_us):
            self._accepted[node_id] = data
        elif self._late[node_id]:
            self._late[node_id] -= 1
        else:
            stray = Stray(data, self._accepted.get(node_id, b""))
            self.strays.setdefault(node_id, []).append(stray)

    # ------------------------------------------------------------------ inside

    def _take(self, node_id: int, data: bytes, t_us: float) -> bool:
        """Whether this is the answer that is waited for."""
        talk = self._talks[node_id]
        specifier = data[0] >> 5
        initiated = data[1:4] == talk.request[1:4]
        if specifier == 4:  # abort; in a segmented transfer, too, it names the object
            index, subindex = talk.address
            if data[1:4] != index.to_bytes(2, "little") + bytes([subindex]):
                return False
            self._answer(node_id, Refusal(int.from_bytes(data[4:], "little")), t_us)
        elif talk.segments is None:
            if specifier != 2 or not initiated:
                return False
            if data[0] & 2:  # expedited; without a size all four bytes may count
                unused = data[0] >> 2 & 3 if data[0] & 1 else 0
                self._answer(node_id, data[4 : 8 - unused], t_us)
            else:
                talk.segments = bytearray()
                self._next_segment(talk, 0, t_us)
        else:
            toggle = talk.request[0] & 0x10
            if specifier != 0 or data[0] & 0x10 != toggle:
                return False
            talk.segments += data[1 : 8 - (data[0] >> 1 & 7)]
            if data[0] & 1:
                self._answer(node_id, bytes(talk.segments), t_us)
            elif len(talk.segments) > LONGEST:
                self._answer(node_id, None, t_us)
            else:
                self._next_segment(talk, toggle ^ 0x10, t_us)
        return True

    def _next_segment(self, talk: _Talk, toggle: int, t_us: float) -> None:
        talk.request = bytes([UPLOAD_SEGMENT | toggle]) + bytes(7)
        talk.asked, talk.due_us = False, t_us + self._settle_us

    def _answer(self, node_id: int, answer: Answer, t_us: float) -> None:
        """On to the node's next question."""
        talk = self._talks[node_id]
        try:
            talk.address = talk.questions.send(answer)
        except StopIteration:
            del self._talks[node_id]
            return
        talk.initiate()
        talk.attempts, talk.asked, talk.due_us = 0, False, t_us + self._settle_us

    def _on_silence(self, node_id: int, talk: _Talk, t_us: float) -> None:
        self._late[node_id] += 1
        if talk.attempts >= ATTEMPTS:
            self._answer(node_id, None, t_us)
        else:  # from the beginning: a device forgets a transfer when another one is initiated
            talk.initiate()
            talk.asked, talk.due_us = False, t_us
