"""The SDO server of a simulated device: expedited and segmented transfers.

CiA 301, 7.2.4.3. Block transfer is not offered, as on the EPOS2; a request for it gets
the abort code for an unknown command specifier.
"""

from __future__ import annotations

from .dictionary import AbortCode, ObjectDictionary, SdoAbort

_SEGMENT = 7  # data bytes in a segment


class SdoServer:
    """One request in, one response out."""

    def __init__(self, dictionary: ObjectDictionary) -> None:
        self._dictionary = dictionary
        self._multiplexer = bytes(3)
        self._upload: bytes | None = None  # what is still to be sent
        self._download: bytearray | None = None  # what has come so far
        self._download_size: int | None = None  # announced size
        self._toggle = 0

    def reset(self) -> None:
        """Forgets a transfer in progress."""
        self._upload = self._download = None

    def request(self, data: bytes) -> bytes | None:
        """The response [8 bytes] to a request, `None` to an abort from the client."""
        if len(data) != 8:
            return None  # an SDO has always 8 bytes (7.2.4.3); anything else is not one
        command = data[0] >> 5
        if command == 4:
            self.reset()
            return None
        try:
            if command == 0:
                return self._download_segment(data)
            if command == 3:
                return self._upload_segment(data)
            self.reset()
            self._multiplexer = data[1:4]
            if command == 1:
                return self._initiate_download(data)
            if command == 2:
                return self._initiate_upload()
            raise SdoAbort(AbortCode.COMMAND_SPECIFIER)
        except SdoAbort as abort:
            self.reset()
            return b"\x80" + self._multiplexer + abort.code.to_bytes(4, "little")

    def _address(self) -> tuple[int, int]:
        return int.from_bytes(self._multiplexer[:2], "little"), self._multiplexer[2]

    def _initiate_download(self, data: bytes) -> bytes:
        index, subindex = self._address()
        expedited, sized = data[0] & 2, data[0] & 1
        if expedited:
            if sized:
                size = 4 - (data[0] >> 2 & 3)
            else:  # as many bytes as the object has
                size = min(4, self._dictionary.check_download(index, subindex, None).type.size)
            self._dictionary.download(index, subindex, data[4 : 4 + size])
        else:
            self._download_size = int.from_bytes(data[4:8], "little") if sized else None
            self._dictionary.check_download(index, subindex, self._download_size)
            self._download, self._toggle = bytearray(), 0
        return b"\x60" + self._multiplexer + bytes(4)

    def _download_segment(self, data: bytes) -> bytes:
        if self._download is None:
            raise SdoAbort(AbortCode.COMMAND_SPECIFIER)
        self._check_toggle(data)
        self._download += data[1 : 8 - (data[0] >> 1 & 7)]
        if data[0] & 1:  # the last one
            index, subindex = self._address()
            if self._download_size not in (None, len(self._download)):
                raise SdoAbort(AbortCode.LENGTH_MISMATCH)
            self._dictionary.download(index, subindex, bytes(self._download))
            self._download = None
        response = 0x20 | self._toggle << 4
        self._toggle ^= 1
        return bytes([response]) + bytes(7)

    def _initiate_upload(self) -> bytes:
        value = self._dictionary.upload(*self._address())
        if 0 < len(value) <= 4:
            command = 0x43 | (4 - len(value)) << 2
            return bytes([command]) + self._multiplexer + value.ljust(4, b"\0")
        self._upload, self._toggle = value, 0
        return b"\x41" + self._multiplexer + len(value).to_bytes(4, "little")

    def _upload_segment(self, data: bytes) -> bytes:
        if self._upload is None:
            raise SdoAbort(AbortCode.COMMAND_SPECIFIER)
        self._check_toggle(data)
        segment, rest = self._upload[:_SEGMENT], self._upload[_SEGMENT:]
        command = self._toggle << 4 | (_SEGMENT - len(segment)) << 1 | (not rest)
        self._upload = rest or None
        self._toggle ^= 1
        return bytes([command]) + segment.ljust(_SEGMENT, b"\0")

    def _check_toggle(self, data: bytes) -> None:
        if data[0] >> 4 & 1 != self._toggle:
            raise SdoAbort(AbortCode.TOGGLE_BIT)
