"""A CAN frame as the protocol layer sees it: no bus, no library."""

from __future__ import annotations

from typing import NamedTuple


class Frame(NamedTuple):
    """11-bit identifier and up to 8 data bytes; `remote`: a request for a frame, without data."""

    can_id: int
    data: bytes = b""
    remote: bool = False
