"""canopen's SDO client, made to keep in step with drives that answer late, wrongly or not at all.

Client and server take turns, so answers come in the order of the requests (CiA 301, 7.2.4.3). An
answer that has not come in time may come yet, and canopen takes it for the answer to the next
request, and so on. Here an answer counts only for the request it belongs to: by command specifier
and index, in a segmented transfer by the toggle bit. As one to an earlier request for the same
object looks alike, after a time-out an object that never changes is read first: what comes before
the answer to that is old. Then the request is made again.

One transfer at a time: whoever begins one while another is at work, on another thread, waits; a
poll (`begin`, `end`) not for long.
"""

from __future__ import annotations

import queue
import threading
import time
from contextlib import suppress

import canopen
from canopen.sdo import SdoClient as CanopenSdoClient
from canopen.sdo import SdoCommunicationError

from epos2_ros.protocol import epos2
from epos2_ros.protocol.sdo import SdoRead

RESPONSE_TIMEOUT_S = 0.3
ATTEMPTS = 3
MAX_SEGMENTS = 10_000  # of a transfer: 70 kB, more than any object of a drive has
TIMED_OUT = 0x05040000  # abort code
_UPLOAD, _DOWNLOAD, _UPLOAD_SEGMENT, _DOWNLOAD_SEGMENT, _ABORT = 2, 1, 3, 0, 4
_ANSWER = {_UPLOAD: 2, _DOWNLOAD: 3, _UPLOAD_SEGMENT: 0, _DOWNLOAD_SEGMENT: 1}
_TOGGLE = 0x10
# Read to get in step again; both exist in every device and never change (CiA 301).
_CONSTANTS = (SdoRead(epos2.DEVICE_TYPE, 0, 4), SdoRead(epos2.IDENTITY, 1, 4))


class SdoClient(CanopenSdoClient):
    """Raises SdoAbortedError or SdoCommunicationError, whatever the drive answers."""

    RESPONSE_TIMEOUT = RESPONSE_TIMEOUT_S

    def __init__(self, rx_cobid: int, tx_cobid: int, od: canopen.ObjectDictionary) -> None:
        super().__init__(rx_cobid, tx_cobid, od)
        self._transfer = threading.RLock()  # held while one is in progress
        self._of = b""  # index and subindex of the transfer in progress
        self._segments = 0
        self._behind = False  # answers may be on their way that nobody waits for any more
        self._polled = b""  # the request that was begun, …
        self._polled_s = 0.0  # … and when

    def upload(self, index: int, subindex: int) -> bytes:
        """The data of an object, as long as the EDS says if it is there."""
        with self._transfer:
            data = bytes(super().upload(index, subindex))
        variable = self.od.get_variable(index, subindex)
        if variable is not None and variable.fixed_size and len(data) < len(variable) // 8:
            raise SdoCommunicationError(
                f"0x{index:04X}-{subindex:02X} has {len(data)} bytes, not {len(variable) // 8}"
            )
        return data

    def download(self, index: int, subindex: int, data: bytes, force_segment: bool = False) -> None:
        """Write an object."""
        try:
            with self._transfer:
                super().download(index, subindex, data, force_segment)
        except RuntimeError as error:  # canopen, closing a transfer that has failed
            raise SdoCommunicationError(str(error)) from error

    # ------------------------------------------------------------------ polls

    def begin(self, request: bytes, wait_s: float = 0.0) -> bool:
        """Ask without waiting for the answer; False if another transfer is at work so long.

        Else `end` it, in the same thread.
        """
        if not self._transfer.acquire(timeout=max(wait_s, 0.0)):
            return False
        self._polled = _constant(request[1:4])[1] if self._behind else request
        self._drop_answers()
        self.send_request(self._polled)
        self._polled_s = time.monotonic()
        return True

    def end(self, patience_s: float) -> None:
        """Take in the answer to what was begun, so long after that at most."""
        end_s = self._polled_s + patience_s
        self._behind = self._response_to(self._polled, self._polled[1:4], end_s) is None
        self._transfer.release()

    # ------------------------------------------------------------------ inside

    def request_response(self, sdo_request: bytes) -> bytes:
        """One request and the answer to it."""
        request = bytes(sdo_request)
        starts = request[0] >> 5 in (_UPLOAD, _DOWNLOAD)
        if starts:
            self._of, self._segments = request[1:4], 0
        else:
            self._segments += 1
        for _ in range(ATTEMPTS if starts else 1):
            if self._behind:
                self._catch_up()
            self._drop_answers()
            self.send_request(request)
            response = self._response_to(request, self._of)
            if response is not None and self._segments <= MAX_SEGMENTS:
                if response[0] >> 5 == _ABORT:
                    raise canopen.SdoAbortedError(int.from_bytes(response[4:], "little"))
                return response
            self._behind = True
            self.abort(TIMED_OUT)
        raise SdoCommunicationError(f"no answer about {_name(self._of)} in time")

    def _drop_answers(self) -> None:
        """Those to what nobody waits for any more."""
        while not self.responses.empty():
            with suppress(queue.Empty):
                self.responses.get_nowait()

    def _catch_up(self) -> None:
        of, request = _constant(self._of)
        for _ in range(ATTEMPTS):
            self.send_request(request)
            if self._response_to(request, of) is not None:
                self._behind = False
                return
        raise SdoCommunicationError(f"no answer about {_name(self._of)} in time")

    def _response_to(self, request: bytes, of: bytes, end_s: float | None = None) -> bytes | None:
        """None if it does not come in time; what comes before it is none of it."""
        end_s = end_s or time.monotonic() + self.RESPONSE_TIMEOUT
        while (left_s := end_s - time.monotonic()) > 0:
            try:
                response = self.responses.get(timeout=left_s)
            except queue.Empty:
                break
            if len(response) == 8 and _answers(response, request, of):
                return response
        return None


class RemoteNode(canopen.RemoteNode):
    """canopen's node, with this client; `str` names the drive."""

    def __init__(self, node_id: int, dictionary: canopen.ObjectDictionary, joint: str) -> None:
        super().__init__(node_id, dictionary)
        self.joint = joint

    def __str__(self) -> str:
        return f"{self.joint} (node {self.id})"

    def add_sdo(self, rx_cobid: int, tx_cobid: int) -> SdoClient:
        """An SDO channel; canopen makes the first when the node is made."""
        client = SdoClient(rx_cobid, tx_cobid, self.object_dictionary)
        self.sdo_channels.append(client)
        return client


def _constant(of: bytes) -> tuple[bytes, bytes]:
    """Another object, that never changes, and the frame that reads it."""
    read = next(read for read in _CONSTANTS if read.request[1:4] != of)
    return read.request[1:4], read.request


def _answers(response: bytes, request: bytes, of: bytes) -> bool:
    command, answer = request[0] >> 5, response[0] >> 5
    if answer == _ABORT:
        return response[1:4] == of
    if answer != _ANSWER[command]:
        return False
    if command in (_UPLOAD, _DOWNLOAD):
        return response[1:4] == of
    return not (response[0] ^ request[0]) & _TOGGLE


def _name(of: bytes) -> str:
    return f"0x{of[1]:02X}{of[0]:02X}-{of[2]:02X}"
