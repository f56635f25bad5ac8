"""SDO transfers out of the frames of client and server (CiA 301, 7.2.4).

Expedited and segmented transfers are followed; of a block transfer it is told that there was one.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

REQUEST, RESPONSE = 0x600, 0x580  # + node id

_DOWNLOAD_SEGMENT, _DOWNLOAD, _UPLOAD, _UPLOAD_SEGMENT, _ABORT = range(5)  # client's commands
_UPLOAD_SEGMENT_ANSWER, _DOWNLOAD_SEGMENT_ANSWER, _UPLOAD_ANSWER, _DOWNLOAD_ANSWER = range(4)
_BLOCK = (5, 6)


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

    def ended(self, node: int, **how: bool) -> Transfer:
        whole = bytes(self.data) if self.write or not how else None
        return Transfer(node, self.write, self.entry, self.subindex, whole, **how)


class SdoFollower:
    """Follows the SDO channels of all nodes."""

    def __init__(self) -> None:
        self._pending: dict[int, _Pending] = {}

    def request(self, node: int, data: bytes) -> Transfer | None:
        """A frame to a node; a transfer that it ends or shows to have stayed unanswered."""
        data = data.ljust(8, b"\0")
        command = data[0] >> 5
        if command in (_DOWNLOAD, _UPLOAD) or command in _BLOCK:
            before = self._pending.get(node)
            if command in _BLOCK and before is not None and before.last is False:
                return None  # goes on
            index, subindex = int.from_bytes(data[1:3], "little"), data[3]
            pending = _Pending(command in (_DOWNLOAD, 6), index, subindex)
            if command == _DOWNLOAD:
                pending.last = bool(data[0] & 2)
                if data[0] & 2:  # expedited
                    size = 4 - (data[0] >> 2 & 3) if data[0] & 1 else 4
                    pending.data += data[4 : 4 + size]
            if command in _BLOCK:
                self._pending.pop(node, None)
                return pending.ended(node, block=True)
            self._pending[node] = pending
            return before.ended(node, unanswered=True) if before else None
        current = self._pending.get(node)
        if current is None:
            return None
        if command == _DOWNLOAD_SEGMENT and current.write:
            current.data += data[1 : 8 - (data[0] >> 1 & 7)]
            current.last = bool(data[0] & 1)
        elif command == _ABORT:
            del self._pending[node]
            return self._aborted(node, current, data, by_client=True)
        return None

    def response(self, node: int, data: bytes) -> Transfer | None:
        """A frame of a node; the transfer that it ends."""
        data = data.ljust(8, b"\0")
        current = self._pending.get(node)
        if current is None:
            return None
        answer = data[0] >> 5
        if answer == _ABORT:
            del self._pending[node]
            return self._aborted(node, current, data, by_client=False)
        if current.write:
            if answer in (_DOWNLOAD_ANSWER, _DOWNLOAD_SEGMENT_ANSWER) and current.last:
                del self._pending[node]
                return current.ended(node)
            return None
        if answer == _UPLOAD_ANSWER:
            if not data[0] & 2:
                return None  # segments follow
            current.data += data[4 : 8 - (data[0] >> 2 & 3 if data[0] & 1 else 0)]
        elif answer == _UPLOAD_SEGMENT_ANSWER:
            current.data += data[1 : 8 - (data[0] >> 1 & 7)]
            if not data[0] & 1:
                return None
        else:
            return None
        del self._pending[node]
        return current.ended(node)

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
