"""Objects of one drive by SDO, with errors that say what was attempted and what to check.

canopen's client does the transfers. Whatever goes wrong with one of them becomes a DriveError of
one line: the drive, what was attempted in words, what the drive answered, what to do about it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

import canopen
from canopen.objectdictionary import datatypes

from epos2_ros.bus.sdo_client import RemoteNode
from epos2_ros.errors import DriveError
from epos2_ros.protocol.sdo import NO_OBJECT, NO_SUBINDEX, OTHER_DRIVE, describe_abort

T = TypeVar("T")


class Refused(DriveError):
    """The drive answered with an abort code."""

    def __init__(self, line: str, code: int) -> None:
        super().__init__(line)
        self.code = code

    @property
    def absent(self) -> bool:
        """Whether the drive has no such object."""
        return self.code in (NO_OBJECT, NO_SUBINDEX)


class NoAnswer(DriveError):
    """The drive did not answer in time, or not what it was asked."""


class SdoAccess:
    """Reads and writes objects of `node`. All methods raise DriveError: Refused or NoAnswer."""

    def __init__(self, node: RemoteNode) -> None:
        self._node = node
        self._limit_s = 0.0
        self._deadline_s = float("inf")

    @contextmanager
    def within(self, seconds: float) -> Iterator[None]:
        """What is attempted in here has to be within this time; NoAnswer after it."""
        self._limit_s, self._deadline_s = seconds, time.monotonic() + seconds
        try:
            yield
        finally:
            self._deadline_s = float("inf")

    def name(self, index: int, subindex: int = 0) -> str:
        """The object as its maker names it, with its number."""
        entry = self._node.object_dictionary.get(index)
        number = f"0x{index:04X}-{subindex:02X}"
        if entry is None:
            return number
        if isinstance(entry, canopen.objectdictionary.ODVariable):
            return f"{entry.name} ({number})"
        part = entry.subindices.get(subindex)
        return f"{entry.name}: {part.name} ({number})" if part else f"{entry.name} ({number})"

    def size(self, index: int, subindex: int = 0) -> int:
        """Of an object [bits]."""
        return len(self._variable(index, subindex))

    def read(self, index: int, subindex: int = 0, attempt: str = "") -> int:
        """The value of an object; `attempt`: what that is, in words."""
        attempt = attempt or f"read {self.name(index, subindex)}"
        variable = self._variable(index, subindex)
        check = OTHER_DRIVE.format(joint=self._node.joint)
        data = self._transfer(attempt, check, lambda: self._node.sdo.upload(index, subindex))
        size = self.size(index, subindex) // 8
        signed = variable.data_type in datatypes.SIGNED_TYPES
        return int.from_bytes(data[:size], "little", signed=signed)

    def find(self, index: int, subindex: int = 0) -> int | None:
        """The value of an object that a drive may have or not; None: it has no such object."""
        try:
            return self.read(index, subindex)
        except Refused as refusal:
            if refusal.absent:
                return None
            raise

    def write(
        self, index: int, value: int, subindex: int = 0, attempt: str = "", check: str = ""
    ) -> None:
        """Set an object.

        `attempt`: what that does, in words; `check`: what a refused value came from, if it is none
        of the driver's own.
        """
        check = check or OTHER_DRIVE.format(joint=self._node.joint)
        done = attempt or f"set {self.name(index, subindex)} to {value}"
        data = self._variable(index, subindex).encode_raw(value)
        self._transfer(done, check, lambda: self._node.sdo.download(index, subindex, data))

    def upload(self, index: int, subindex: int) -> bytes:
        """The value of an object as it is on the bus, whether the EDS has it or not."""
        attempt = f"read {self.name(index, subindex)}"
        return self._transfer(attempt, "", lambda: self._node.sdo.upload(index, subindex))

    def download(self, index: int, subindex: int, data: bytes) -> None:
        """Set an object likewise."""
        value = f" to {int.from_bytes(data, 'little')}" if len(data) <= 4 else ""
        attempt = f"set {self.name(index, subindex)}{value}"
        self._transfer(attempt, "", lambda: self._node.sdo.download(index, subindex, data))

    def keep(self, index: int, value: int, subindex: int, attempt: str, lest: str) -> None:
        """Set an object, and see that the drive keeps it; `lest`: what would come of it if not."""
        self.write(index, value, subindex, attempt)
        kept = self.read(index, subindex)
        if kept != value:
            raise DriveError(
                f"{self._node} does not keep {value} in {self.name(index, subindex)}, but {kept}: "
                f"{lest}; check its power supply, and that its firmware is one that is supported"
            )

    def _variable(self, index: int, subindex: int) -> canopen.objectdictionary.ODVariable:
        variable = self._node.object_dictionary.get_variable(index, subindex)
        if variable is None:
            raise ValueError(f"0x{index:04X}-{subindex:02X} is not in the EDS")
        return variable

    def _transfer(self, attempt: str, check: str, transfer: Callable[[], T]) -> T:
        failed = f"{self._node}: can't {attempt}: "
        if time.monotonic() > self._deadline_s:
            raise NoAnswer(
                f"{failed}the {self._limit_s:g} s are over in which a drive has to be set up; "
                "check the bus for disturbances and load"
            )
        try:
            return transfer()
        except canopen.SdoAbortedError as error:
            answer = describe_abort(error.code, self._node.joint, check)
            raise Refused(f"{failed}the drive refuses it: {answer}", error.code) from error
        except canopen.SdoCommunicationError as error:
            raise NoAnswer(
                f"{failed}{error}; check the drive's power and the wiring, and that no other "
                "program talks to the drive"
            ) from error
