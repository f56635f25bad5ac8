"""Carrying out what the protocol layer asks for by SDO."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Protocol

from epos2_ros.bus.sdo_access import SdoAccess
from epos2_ros.bus.sdo_client import RemoteNode
from epos2_ros.protocol import epos2
from epos2_ros.protocol.sdo import SdoRead, SdoWrite

Answer = tuple[list[int], float, float]


class Accesses(Protocol):
    """First the writes, then the reads."""

    @property
    def writes(self) -> tuple[SdoWrite, ...]: ...

    @property
    def reads(self) -> tuple[SdoRead, ...]: ...


def write_all(node: RemoteNode, writes: Iterable[SdoWrite]) -> None:
    """In order; DriveError with the object that is refused."""
    objects = SdoAccess(node)
    for write in writes:
        objects.download(write.index, write.subindex, write.data)


def read(node: RemoteNode, what: SdoRead) -> int:
    """DriveError if the drive does not answer, or has no such object."""
    return what.decode(SdoAccess(node).upload(what.index, what.subindex))


def read_position(node: RemoteNode) -> int:
    """Position actual value [counts]."""
    return read(node, SdoRead(epos2.POSITION_ACTUAL, 0, 4, signed=True))


def perform(node: RemoteNode, job: Accesses, now_us: Callable[[], float]) -> Answer:
    """The values that were read, and the times between which they were."""
    write_all(node, job.writes)
    begin_us = now_us()
    values = [read(node, what) for what in job.reads]
    return values, begin_us, now_us()
