"""SDO transfers out of the frames of client and server (CiA 301, 7.2.4).

Expedited and segmented transfers are followed; of a block transfer it is told that there was one.
An answer may stand before its request: where an adapter has no echo, a log has the request at the
time at which it was through by its length.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

REQUEST, RESPONSE = 0x600, 0x580  # + node id

_DOWNLOAD_SEGMENT, _DOWNLOAD, _UPLOAD, _UPLOAD_SEGMENT, _ABORT = range(5)  # client's commands
_UPLOAD_SEGMENT_ANSWER, _DOWNLOAD_SEGMENT_ANSWER, _UPLOAD_ANSWER, _DOWNLOAD_ANSWER = range(4)
_BLOCK = (5, 6)
_BLOCK_WRITTEN, _BLOCK_READ = 0xA1, 0xC1  # the last frame of a node in a block transfer


class Transfer(NamedTuple):
    """An access to an object of `node`, as far as it went."""

    node: int
    write: bool
    entry: int  # its index (a tuple has a method of that name)
    subindex: int
    data: bytes | None  # what was written or read; None: not known
    abort: int | None = None  # the code, where it was aborted
    by_client: bool = False  # who aborted
    unanswered: bool = False
    block: bool = False


@dataclass
class _Pending:
    """A transfer under way."""

    write: bool
    entry: int
    subindex: int
    data: bytearray = field(default_factory=bytearray)
    last: bool = True  # the request was the last that carries data
    awaited: bool = True  # an answer to the last request
    block: bool = False

    def ended(self, node: int, unanswered: bool = False) -> Transfer:
        known = not self.block and (self.write or not unanswered)
        return Transfer(
            node,
            self.write,
            self.entry,
            self.subindex,
            bytes(self.data) if known else None,
            unanswered=unanswered,
            block=self.block,
        )


class SdoFollower:
    """Follows the SDO channels of all nodes."""

    def __init__(self) -> None:
        self._pending: dict[int, _Pending] = {}
        self._early: dict[int, bytes] = {}  # answers whose request is still to come

    def request(self, node: int, data: bytes) -> list[Transfer]:
        """A frame to a node; transfers that it ends or shows to have stayed unanswered."""
        ended = self._request(node, data.ljust(8, b"\0"))
        early = self._early.pop(node, None)
        if early is not None and node in self._pending:
            ended += self._response(node, early)
        return ended

    def response(self, node: int, data: bytes) -> list[Transfer]:
        """A frame of a node; the transfer that it ends."""
        data = data.ljust(8, b"\0")
        current = self._pending.get(node)
        if current is None or not current.awaited:
            self._early[node] = data
            return []
        return self._response(node, data)

    def _request(self, node: int, data: bytes) -> list[Transfer]:
        command = data[0] >> 5
        current = self._pending.get(node)
        if current is not None and current.block and data[0] != _ABORT << 5:
            return []  # its segments look like anything
        if command in (_DOWNLOAD, _UPLOAD):
            index, subindex = int.from_bytes(data[1:3], "little"), data[3]
            pending = self._pending[node] = _Pending(command == _DOWNLOAD, index, subindex)
            if command == _DOWNLOAD:
                pending.last = bool(data[0] & 2)
                if data[0] & 2:  # expedited
                    size = 4 - (data[0] >> 2 & 3) if data[0] & 1 else 4
                    pending.data += data[4 : 4 + size]
            return [current.ended(node, unanswered=True)] if current else []
        if command in _BLOCK:
            index, subindex = int.from_bytes(data[1:3], "little"), data[3]
            self._pending[node] = _Pending(command == 6, index, subindex, block=True)
            return [current.ended(node, unanswered=True)] if current else []
        if current is None:
            return []
        current.awaited = True
        if command == _DOWNLOAD_SEGMENT and current.write:
            current.data += data[1 : 8 - (data[0] >> 1 & 7)]
            current.last = bool(data[0] & 1)
        elif command == _ABORT:
            del self._pending[node]
            return [self._aborted(node, current, data, by_client=True)]
        return []

    def _response(self, node: int, data: bytes) -> list[Transfer]:
        current = self._pending[node]
        current.awaited = False
        answer = data[0] >> 5
        if answer == _ABORT:
            del self._pending[node]
            return [self._aborted(node, current, data, by_client=False)]
        if current.block:
            current.awaited = True
            if data[0] & 0xE3 not in (_BLOCK_WRITTEN, _BLOCK_READ):
                return []
            current.data.clear()
        elif current.write:
            if answer not in (_DOWNLOAD_ANSWER, _DOWNLOAD_SEGMENT_ANSWER) or not current.last:
                return []
        elif answer == _UPLOAD_ANSWER:
            if not data[0] & 2:
                return []  # segments follow
            current.data += data[4 : 8 - (data[0] >> 2 & 3 if data[0] & 1 else 0)]
        elif answer == _UPLOAD_SEGMENT_ANSWER:
            current.data += data[1 : 8 - (data[0] >> 1 & 7)]
            if not data[0] & 1:
                return []
        else:
            return []
        del self._pending[node]
        return [current.ended(node)]

    def unanswered(self) -> list[Transfer]:
        """At the end of the log: what was asked and not answered."""
        return [
            pending.ended(node, unanswered=True) for node, pending in sorted(self._pending.items())
        ]

    @staticmethod
    def _aborted(node: int, current: _Pending, data: bytes, by_client: bool) -> Transfer:
        return Transfer(
            node,
            current.write,
            current.entry,
            current.subindex,
            bytes(current.data) if current.write else None,
            int.from_bytes(data[4:8], "little"),
            by_client,
        )
