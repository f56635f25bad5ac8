"""Room for frames that come in while the thread that reads them waits for its turn."""

from __future__ import annotations

import os
import socket
import stat

import can

RECEIVE_BUFFER_BYTES = 4 << 20  # some 10,000 frames: seconds of a bus that is full
_SO_RCVBUFFORCE = 33  # Linux, asm-generic/socket.h: beyond net.core.rmem_max, for root


def deepen(bus: can.BusABC) -> None:
    """Raise the receive buffer of a bus that is a socket, as far as the kernel allows.

    A frame that finds it full is dropped without a word, and Linux' default of 208 KiB holds just
    256 frames: 32 drives fill it in a tenth of a second.
    """
    try:
        descriptor = bus.fileno()
    except NotImplementedError:
        return  # `virtual`
    if not stat.S_ISSOCK(os.fstat(descriptor).st_mode):
        return  # a serial port
    with socket.socket(fileno=os.dup(descriptor)) as its:
        try:
            its.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, RECEIVE_BUFFER_BYTES)
        except PermissionError:
            its.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)
