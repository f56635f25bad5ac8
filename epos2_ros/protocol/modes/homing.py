"""Homing mode: each drive looks for its home by itself (CiA 402-2, mode 6).

Bit 4 in the synchronous controlword starts all axes of an order on one SYNC. A drive says that it
is home with bits 10 and 12 of the statusword, that it can't get there with bit 13. Whatever the
drive does, an axis that has gone farther than it may, or for longer than that takes, is stopped: a
dead switch must not send it to the far end. Soft limits mean nothing before the axis is home; they
are off meanwhile, and on again afterwards.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from epos2_ros.motion.units import INT32_MAX, INT32_MIN
from epos2_ros.protocol import cia402, epos2
from epos2_ros.protocol.drive import Drive, names
from epos2_ros.protocol.modes.mode import Mode
from epos2_ros.protocol.outbox import Outbox
from epos2_ros.protocol.sdo import SdoRead, SdoWrite

START = 0x0010
ATTAINED = 0x1000
ERROR = 0x2000

# What a drive said so soon after the start SYNC may be of before it.
STALE_US = 60_000.0
TIME_MARGIN_S = 10.0  # for turning round, the index, ramps
TIME_FACTOR = 3.0  # a method may go the way there, back, and once more slowly
UNBOUNDED_S = 120.0  # for a search whose travel nobody has bounded
STRAY_SAMPLES = 2  # so many samples in a row beyond the bound, while the drive still searches


@dataclass(frozen=True)
class Search:
    """What a drive is told. Positions are counts, the rest is in units of its motion objects.

    `objects`: what its family wants written besides. None leaves the drive's own.
    """

    number: int  # 0x6098
    words: str  # the method by its name
    speeds: tuple[int, int] | None  # 0x6099: to the switch, to zero
    acceleration: int | None  # 0x609A
    max_travel_qc: float
    objects: tuple[SdoWrite, ...] = ()


class Homing(Mode):
    """Searches of several axes that begin on one SYNC."""

    operation = 6
    words = "homing mode"
    start = START
    finds_its_way = True
    prepare_timeout_us = 2_000_000.0
    confirm_timeout_us = 1_000_000.0
    unconfirmed_words = "homing has not begun"

    def __init__(self, drives: Sequence[Drive], out: Outbox) -> None:
        super().__init__(drives, out)
        self._planned: dict[Drive, Search] = {}
        self._searches: dict[Drive, Search] = {}
        self._refused = ""
        self._start_us = math.inf
        self._from_qc: dict[Drive, int] = {}
        self._strays: dict[Drive, tuple[float, int]] = {}  # last sample beyond, how many

    def plan(self, searches: Mapping[Drive, Search]) -> None:
        """What `begin` begins."""
        self._planned = dict(searches)

    @property
    def taking_part(self) -> Sequence[Drive]:
        return tuple(self._searches)

    def time_limit_s(self, searches: Mapping[Drive, Search]) -> float:
        """How long they may take together; what is longer ends in a fault."""
        return max(map(_time_limit_s, searches, searches.values()), default=0.0)

    # ------------------------------------------------------------------ before the start

    def begin(self) -> None:
        self._searches, self._refused, self._strays = dict(self._planned), "", {}
        self._from_qc = {drive: drive.position_qc or 0 for drive in self._searches}
        for drive, search in self._searches.items():
            drive.homed, drive.demand = "", None
            drive.borrow(_limits(INT32_MIN, INT32_MAX), _LIMITS, self._out, self._written)
            self._out.ask(drive.node_id, _writes(search), then=self._written)

    def _written(self, values: Sequence[int], error: str) -> None:
        self._refused = self._refused or error

    def unprepared(self) -> str:
        waiting = [drive for drive in self._searches if drive.node_id in self._out.unanswered]
        return f"homing could not be set up in {names(waiting)}" if waiting else ""

    def refused(self) -> str:
        return self._refused

    # ------------------------------------------------------------------ in motion

    def started(self, start_us: float) -> None:
        self._start_us = start_us

    def unconfirmed(self) -> Sequence[Drive]:
        """Bit 10 alone says "interrupted or not started" (CiA 402-2, homing mode)."""
        return [
            drive
            for drive in self._searches
            if not self._said(drive)
            or drive.statusword & (cia402.TARGET_REACHED | ATTAINED | ERROR)
            == cia402.TARGET_REACHED
        ]

    def advance(self, path_ms: float, now_us: float) -> str:
        for drive, search in self._searches.items():
            if self._home(drive):
                continue
            if self._said(drive) and drive.statusword & ERROR:
                return self._failed(drive, "its drive reports a homing error (bit 13)")
            if self._strayed(drive, search):
                limit = f"{search.max_travel_qc:.0f} qc from where it began"
                return self._failed(drive, f"it has gone {limit} (homing.max_travel)")
            if path_ms > 1000 * _time_limit_s(drive, search):
                return self._failed(drive, f"not home after {path_ms / 1000:.0f} s")
        return ""

    def due_ms(self) -> float:
        searching = [item for item in self._searches.items() if not self._home(item[0])]
        return 1000 * min((_time_limit_s(*item) for item in searching), default=math.inf)

    def arrived(self) -> bool:
        return all(self._home(drive) for drive in self._searches)

    def finish(self) -> None:
        for drive, search in self._searches.items():
            drive.homed = search.words
            drive.rests()
            self._out.frames.append(drive.controlword(cia402.ENABLE_OPERATION))
        self._searches = {}

    def ended(self) -> None:
        self._searches = {}

    # ------------------------------------------------------------------ what drives say

    def _said(self, drive: Drive) -> bool:
        """Whether the statusword is of after the start."""
        return drive.statusword_us > self._start_us + STALE_US

    def _home(self, drive: Drive) -> bool:
        done = ATTAINED | cia402.TARGET_REACHED
        return self._said(drive) and drive.statusword & (done | ERROR) == done

    def _strayed(self, drive: Drive, search: Search) -> bool:
        """Beyond the bound, and not only by the jump of the position that ends a search."""
        if drive.position_qc is None or drive.statusword_us < drive.sample_us:
            return False
        if abs(drive.position_qc - self._from_qc[drive]) <= search.max_travel_qc:
            self._strays.pop(drive, None)
            return False
        last_us, count = self._strays.get(drive, (-math.inf, 0))
        if drive.sample_us > last_us:
            self._strays[drive] = drive.sample_us, count + 1
        return self._strays[drive][1] >= STRAY_SAMPLES

    def _failed(self, drive: Drive, why: str) -> str:
        at = (
            f"at {drive.position_qc} qc" if drive.position_qc is not None else "at an unknown place"
        )
        return f"{drive}: homing by {self._searches[drive].words} failed {at}: {why}"


_LIMITS = tuple(SdoRead(epos2.SOFTWARE_POSITION_LIMIT, n, 4, signed=True) for n in (1, 2))


def _limits(least: int, most: int) -> list[SdoWrite]:
    return [
        SdoWrite.integer(epos2.SOFTWARE_POSITION_LIMIT, n, value, 4, signed=True)
        for n, value in ((1, least), (2, most))
    ]


def _writes(search: Search) -> list[SdoWrite]:
    writes = [SdoWrite.integer(epos2.HOMING_METHOD, 0, search.number, 1, signed=True)]
    if search.speeds is not None:
        for subindex, speed in enumerate(search.speeds, 1):
            writes.append(SdoWrite.integer(epos2.HOMING_SPEEDS, subindex, speed, 4))
    if search.acceleration is not None:
        writes.append(SdoWrite.integer(epos2.HOMING_ACCELERATION, 0, search.acceleration, 4))
    return [*writes, *search.objects]


def _time_limit_s(drive: Drive, search: Search) -> float:
    """By the travel and the slower of the speeds, where both are known."""
    if search.speeds is None or not math.isfinite(search.max_travel_qc):
        return UNBOUNDED_S
    slowest = min(search.speeds) * drive.velocity_unit
    return TIME_MARGIN_S + TIME_FACTOR * search.max_travel_qc / slowest
