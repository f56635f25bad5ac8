"""Profile position mode: each drive makes its own way to a set-point (CiA 402-2, mode 1).

Target, velocity and accelerations are written by SDO before the start; "new set-point" (bit 4) in
the synchronous controlword starts all axes on one SYNC. A drive that takes its set-point sets bit
12 of the statusword; one that does not want it leaves it low, so the handshake has a time limit.
Bit 4 falls once every drive has acknowledged, or the next set-point could not rise.

A halted axis would go on to its target if the halt were released. So the halt stays, and falls in
the controlword that brings the next set-point, which takes the old one's place at once.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from epos2_ros.motion.trapezoid import Trapezoid
from epos2_ros.protocol import cia402, epos2
from epos2_ros.protocol.drive import Drive, names
from epos2_ros.protocol.executed_path import Demand
from epos2_ros.protocol.modes.mode import Mode
from epos2_ros.protocol.outbox import Outbox
from epos2_ros.protocol.sdo import SdoRead, SdoWrite

ARRIVAL_MARGIN_MS = 1_000.0  # after a move should be over


class Profile(Mode):
    """Moves of several axes that leave on one SYNC."""

    operation = 1
    words = "profile position mode"
    start = cia402.NEW_SETPOINT | cia402.CHANGE_IMMEDIATELY
    resumes = True
    prepare_timeout_us = 2_000_000.0
    confirm_timeout_us = 2_000_000.0
    unconfirmed_words = "set-point not acknowledged (bit 12)"

    def __init__(self, drives: Sequence[Drive], out: Outbox) -> None:
        super().__init__(drives, out)
        self.moves: dict[Drive, Trapezoid] = {}  # prepared or under way [counts]
        self._planned: dict[Drive, Trapezoid] = {}
        self._refused = ""
        self._confirmed_us = math.inf

    def plan(self, moves: Mapping[Drive, Trapezoid]) -> None:
        """What `begin` begins; a drive whose move goes nowhere takes no part."""
        made = {
            drive: move.in_units(drive.velocity_unit, drive.acceleration_unit, drive.jerk_unit)
            for drive, move in moves.items()
        }
        self._planned = {drive: move for drive, move in made.items() if move.start != move.end}

    @property
    def taking_part(self) -> Sequence[Drive]:
        return tuple(self.moves)

    def begin(self) -> None:
        self.moves, self._refused, self._confirmed_us = dict(self._planned), "", math.inf
        for drive, move in self.moves.items():
            reads = () if drive.family.rest_operation == self.operation else _SHARED
            drive.borrow(setpoint(drive, move), reads, self._out, self._written)

    def _written(self, values: Sequence[int], error: str) -> None:
        self._refused = self._refused or error

    def unprepared(self) -> str:
        waiting = [drive for drive in self.moves if drive.node_id in self._out.unanswered]
        return f"set-points could not be written to {names(waiting)}" if waiting else ""

    def refused(self) -> str:
        return self._refused

    def started(self, start_us: float) -> None:
        for drive, move in self.moves.items():
            drive.demand = Demand(move.path(start_us))

    def unconfirmed(self) -> Sequence[Drive]:
        return [drive for drive in self.moves if not _acknowledged(drive)]

    def confirmed(self, now_us: float) -> None:
        """Bit 4 falls in all of them."""
        self._confirmed_us = now_us
        for drive in self.moves:
            self._out.frames.append(drive.controlword(cia402.ENABLE_OPERATION))

    def advance(self, path_ms: float, now_us: float) -> str:
        if self._confirmed_us == math.inf:
            return ""  # whether all of them start is watched first
        moving = self._moving()
        longest_s = max((self.moves[drive].duration_s for drive in moving), default=math.inf)
        if path_ms > 1000 * longest_s + ARRIVAL_MARGIN_MS:
            return f"target not reached by {names(moving)}"
        return ""

    def due_ms(self) -> float:
        return ARRIVAL_MARGIN_MS + 1000 * max(move.duration_s for move in self.moves.values())

    def arrived(self) -> bool:
        return not self._moving()

    def _moving(self) -> list[Drive]:
        return [
            drive
            for drive in self.moves
            if _acknowledged(drive)
            or not drive.statusword & cia402.TARGET_REACHED
            or drive.statusword_us <= self._confirmed_us
        ]

    def finish(self) -> None:
        self.moves = {}

    def ended(self) -> None:
        for drive in self.moves:
            drive.demand = None
        self.moves = {}


# What interpolated position mode goes by as well: its warnings, its halt.
_SHARED = (
    SdoRead(epos2.PROFILE_VELOCITY, 0, 4),
    SdoRead(epos2.PROFILE_ACCELERATION, 0, 4),
    SdoRead(epos2.PROFILE_DECELERATION, 0, 4),
)


def setpoint(drive: Drive, move: Trapezoid) -> list[SdoWrite]:
    """What a move needs that is in whole units of the drive.

    READING: the deceleration is written beside a limit of jerk as well, though some of Copley's
    texts say that the acceleration then counts for both.
    """
    velocity = round(move.velocity / drive.velocity_unit)
    acceleration = round(move.acceleration / drive.acceleration_unit)
    profile, jerks = cia402.TRAPEZOIDAL, []
    if move.jerk < math.inf:
        profile, jerk = cia402.JERK_LIMITED, round(move.jerk / drive.jerk_unit)
        jerks = [SdoWrite.integer(*place, jerk, 4) for place in drive.family.jerk_objects]
    return [
        SdoWrite.integer(epos2.MOTION_PROFILE_TYPE, 0, profile, 2),
        SdoWrite.integer(epos2.TARGET_POSITION, 0, round(move.end), 4, signed=True),
        SdoWrite.integer(epos2.PROFILE_VELOCITY, 0, velocity, 4),
        SdoWrite.integer(epos2.PROFILE_ACCELERATION, 0, acceleration, 4),
        SdoWrite.integer(epos2.PROFILE_DECELERATION, 0, acceleration, 4),
        *jerks,
    ]


def _acknowledged(drive: Drive) -> bool:
    return bool(drive.statusword & cia402.SETPOINT_ACKNOWLEDGED)
