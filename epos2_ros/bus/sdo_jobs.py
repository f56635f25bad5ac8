"""Carrying out what the protocol layer asks for by SDO."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Protocol

import canopen

from epos2_ros.errors import DriveError
from epos2_ros.protocol import epos2
from epos2_ros.protocol.sdo import SdoRead, SdoWrite

Answer = tuple[list[int], float, float]


class Accesses(Protocol):
    """First the writes, then the reads."""

    @property
    def writes(self) -> tuple[SdoWrite, ...]: ...

    @property
    def reads(self) -> tuple[SdoRead, ...]: ...


def write_all(node: canopen.RemoteNode, writes: Iterable[SdoWrite]) -> None:
    """In order; DriveError with the object that is refused."""
    for write in writes:
        try:
            node.sdo.download(write.index, write.subindex, write.data)
        except canopen.SdoAbortedError as error:
            value = int.from_bytes(write.data, "little") if len(write.data) <= 4 else "its data"
            raise DriveError(
                f"node {node.id} refuses {value} for 0x{write.index:04X}-{write.subindex:02X}: "
                f"{error}"
            ) from error
        except canopen.SdoCommunicationError as error:
            raise DriveError(f"node {node.id} stopped answering SDO requests: {error}") from error


def read(node: canopen.RemoteNode, what: SdoRead) -> int:
    """DriveError if the drive does not answer, or has no such object."""
    try:
        return what.decode(node.sdo.upload(what.index, what.subindex))
    except (canopen.SdoAbortedError, canopen.SdoCommunicationError) as error:
        raise DriveError(
            f"node {node.id} does not tell 0x{what.index:04X}-{what.subindex:02X}: {error}"
        ) from error


def read_position(node: canopen.RemoteNode) -> int:
    """Position actual value [counts]."""
    return read(node, SdoRead(epos2.POSITION_ACTUAL, 0, 4, signed=True))


def perform(node: canopen.RemoteNode, job: Accesses, now_us: Callable[[], float]) -> Answer:
    """The values that were read, and the times between which they were."""
    write_all(node, job.writes)
    begin_us = now_us()
    values = [read(node, what) for what in job.reads]
    return values, begin_us, now_us()
