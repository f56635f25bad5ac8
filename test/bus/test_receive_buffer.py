"""Frames that come in while nobody reads are kept, on interfaces that are sockets."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable

import can
import pytest

from epos2_ros.receive_buffer import deepen

FRAME = bytes(60)  # about as long as python-can's udp_multicast makes one


class FileBus(can.BusABC):
    """A bus with a file descriptor, and nothing else."""

    def __init__(self, fileno: Callable[[], int]) -> None:
        super().__init__(None)
        self._fileno = fileno

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        raise NotImplementedError

    def fileno(self) -> int:
        return self._fileno()


def kept(prepare: Callable[[can.BusABC], None]) -> int:
    """How many of 400 frames are there when at last somebody looks."""
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ours,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as theirs,
    ):
        ours.bind(("127.0.0.1", 0))
        with FileBus(ours.fileno) as bus:
            prepare(bus)
        for _ in range(400):
            theirs.sendto(FRAME, ours.getsockname())
        ours.setblocking(False)
        for count in range(400):
            try:
                ours.recv(100)
            except BlockingIOError:
                return count
        return 400


def test_frames_that_nobody_reads_yet_are_kept() -> None:
    """400 fit even where the kernel grants no more than twice its default."""
    assert kept(lambda bus: None) < 400
    assert kept(deepen) == 400


def test_interfaces_without_a_socket_are_left_alone() -> None:
    deepen(can.Bus("deepen", "virtual"))
    master, slave = os.openpty()
    try:
        with FileBus(lambda: master) as bus:
            deepen(bus)
    finally:
        os.close(master)
        os.close(slave)


def test_without_privilege_it_is_as_deep_as_the_kernel_allows(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Unprivileged(socket.socket):
        def setsockopt(self, level: int, option: int, value: int) -> None:  # type: ignore[override]
            if option != socket.SO_RCVBUF:
                raise PermissionError
            super().setsockopt(level, option, value)

    monkeypatch.setattr(socket, "socket", Unprivileged)
    assert kept(deepen) == 400
