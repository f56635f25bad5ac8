"""What some axes of a group do while they move: what all modes have in common.

A mode knows its drives and no group. The group asks, in this order:

* `rest(drive)` when a drive comes to stand in this mode: what has to be written to it; then
  `unready(drive)` until nothing keeps it from being ready;
* `begin()`, then `prepare()` again and again: what has to be in the drives before the start, until
  `unprepared()` is empty;
* at the start SYNC the controlword bits `start` count in every drive that takes part; then
  `started()`, and `unconfirmed()` until every drive has shown that it is under way;
* `advance()` whenever something is due (`due_us`), until `arrived()`; then `finish()`.

Whatever is wrong is a line of text, "" where nothing is.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence, Set
from typing import ClassVar

from epos2_ros.protocol.drive import Drive
from epos2_ros.protocol.outbox import Outbox
from epos2_ros.protocol.sdo import SdoWrite


class Mode(ABC):
    """One mode of operation of the drives that are in it, or can be. Times are host µs."""

    operation: ClassVar[int]  # 0x6060
    words: ClassVar[str]  # its name
    start: ClassVar[int]  # controlword bits beside "enable operation" that begin it
    brakes_with: ClassVar[int] = 0  # those that stay beside "halt" while an axis brakes
    finds_its_way: ClassVar[bool] = False  # a drive, which alone knows what it does next
    resumes: ClassVar[bool] = False  # whether an axis goes on when its halt is released
    prepare_timeout_us: ClassVar[float] = 1_000_000.0  # for what has been handed over last
    confirm_timeout_us: ClassVar[float]  # from the start SYNC on
    unconfirmed_words: ClassVar[str]  # what it means that a drive has not confirmed

    def __init__(self, drives: Sequence[Drive], out: Outbox) -> None:
        self.drives = tuple(drives)
        self._out = out

    @property
    def taking_part(self) -> Sequence[Drive]:
        """The drives that the motion to come, or in progress, moves."""
        return self.drives

    # ------------------------------------------------------------------ at rest

    def rest(self, drive: Drive) -> Sequence[SdoWrite]:
        """What makes a standing drive ready for the next motion, right after the mode was set."""
        return ()

    def unready(self, drive: Drive, now_us: float) -> str:
        """What keeps it from being ready, beside what `rest` has it written; asked now and then."""
        return ""

    def on_rest(self, drive: Drive) -> None:  # noqa: B027
        """A drive stands, in this mode, and has said where."""

    # ------------------------------------------------------------------ before the start

    @abstractmethod
    def begin(self) -> None:
        """What was planned is to be prepared now; the axes stand."""

    def prepare(self, now_us: float) -> bool:
        """Hand over one thing more that the drives need before the start; False: there is none."""
        return False

    def unprepared(self) -> str:
        """Which drive has not yet got what it was handed, and what that is."""
        return ""

    def refused(self) -> str:
        """Which drive does not take what it was handed, and why: the motion can't begin."""
        return ""

    # ------------------------------------------------------------------ in motion

    def started(self, start_us: float) -> None:  # noqa: B027
        """The start SYNC was on the bus at `start_us`."""

    @abstractmethod
    def unconfirmed(self) -> Sequence[Drive]:
        """The drives that have not shown yet that they have started."""

    def confirmed(self, now_us: float) -> None:  # noqa: B027
        """All drives of the group have started."""

    def advance(self, path_ms: float, now_us: float) -> str:
        """Do what is due at this path time; what is wrong."""
        return ""

    def due_ms(self) -> float:
        """The path time at which `advance` is wanted next."""
        return math.inf

    @abstractmethod
    def arrived(self) -> bool:
        """Whether all its axes rest where they were to go."""

    def finish(self) -> None:  # noqa: B027
        """All axes of the group have arrived."""

    def ended(self) -> None:  # noqa: B027
        """The motion came to another end, or does not begin."""

    def active(self, drive: Drive) -> bool:
        """Whether a drive that was told to halt is still in motion by its mode's own bits."""
        return False

    # ------------------------------------------------------------------ what was on the bus

    def on_report(self, drive: Drive, reported: Set[tuple[int, int]], t_us: float) -> str:
        """A drive has reported these objects, in a PDO; what is wrong with that."""
        return ""

    def on_answer(self, drive: Drive, data: bytes, t_us: float) -> str:
        """A drive has answered an SDO request; what is wrong with that."""
        return ""

    def on_sync(self, drive: Drive, t_us: float, starts: bool) -> str:
        """A SYNC was on the bus, the one that starts the motion if so; what is wrong."""
        return ""

    def on_echo(self, drive: Drive, data: bytes, t_us: float) -> None:  # noqa: B027
        """A frame of this mode's own (RPDO1, RPDO3) to a drive was on the bus."""
