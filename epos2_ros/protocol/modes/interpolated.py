"""Interpolated position mode of the EPOS2: records in each drive's buffer, executed on one clock.

maxon, application note "Interpolation Position Mode". A record is the end of a segment; the drive
interpolates a cubic at 1 kHz. Before the start every drive has to report every record it was sent;
in motion its buffer is fed by the books, its reports are held against them, and at every SYNC its
position demand against the records (`pvt.path_audit`). What a halt leaves is "ip mode inactive".
"""

from __future__ import annotations

import math
from collections.abc import Sequence, Set
from functools import partial

from epos2_ros.errors import TrajectoryError
from epos2_ros.motion.reference import Reference
from epos2_ros.protocol import cia402, epos2
from epos2_ros.protocol.drive import Drive
from epos2_ros.protocol.modes.mode import Mode
from epos2_ros.protocol.outbox import Outbox
from epos2_ros.protocol.path_time import PathTime
from epos2_ros.protocol.pvt.axis import PvtAxis
from epos2_ros.protocol.pvt.buffer_reads import BufferReads
from epos2_ros.protocol.pvt.feeder import Feeder
from epos2_ros.protocol.sdo import SdoWrite

END_TIMEOUT_MS = 500.0  # after the end record, for "ip mode inactive"
EARLY_END_MS = 50.0  # before the end of its records an axis may be seen to have ended
_CLOCK = (epos2.HIGH_RESOLUTION_TIME_STAMP, 0)
_DEMAND = (epos2.POSITION_DEMAND, 0)


class Interpolated(Mode):
    """All `axes` follow one reference."""

    operation = epos2.MODE_INTERPOLATED_POSITION
    words = "interpolated position mode"
    start = epos2.ENABLE_IP_MODE
    brakes_with = epos2.ENABLE_IP_MODE
    confirm_timeout_us = 200_000.0
    unconfirmed_words = "ip mode not active after the start SYNC"

    def __init__(
        self,
        axes: Sequence[PvtAxis],
        feeder: Feeder,
        reads: BufferReads,
        path_time: PathTime,
        out: Outbox,
    ) -> None:
        super().__init__([axis.drive for axis in axes], out)
        self.axes = tuple(axes)
        self.feeder = feeder
        self._reads = reads
        self._path_time = path_time
        self._axis_of = {axis.drive: axis for axis in axes}
        self._planned: Reference | None = None
        self._broken = ""  # why the reference can't be followed

    def plan(self, reference: Reference) -> None:
        """What `begin` begins, from where the axes stand."""
        self._planned = reference

    # ------------------------------------------------------------------ at rest

    def rest(self, drive: Drive) -> Sequence[SdoWrite]:
        """Empty the buffer and enable access to it; of what was in it nothing is executed."""
        self.on_rest(drive)
        index, subindex = epos2.INTERPOLATION_DATA_CONFIGURATION, epos2.BUFFER_CLEAR_SUBINDEX
        return [SdoWrite.integer(index, subindex, value, 1) for value in (0, 1)]

    def on_rest(self, drive: Drive) -> None:
        self._axis_of[drive].audit.rest(drive.demand_qc or 0)

    # ------------------------------------------------------------------ before the start

    def begin(self) -> None:
        assert self._planned is not None
        self._broken = ""
        self.feeder.begin(self._planned)
        self._reads.begin()

    def prepare(self, now_us: float) -> bool:
        if self._feed(0.0):
            return True
        self._reads.ask_all(now_us)
        self._ask()
        return False

    def unprepared(self) -> str:
        if missing := self._reads.unreported():
            axis = missing[0]
            return (
                f"{axis} reports {axis.account.level(None)} records in its buffer where "
                f"{axis.account.sent} were sent"
            )
        return ""

    def refused(self) -> str:
        return self._broken

    # ------------------------------------------------------------------ in motion

    def unconfirmed(self) -> Sequence[Drive]:
        start_us = self._path_time.start_us or math.inf
        return [
            axis.drive
            for axis in self.axes
            if axis.drive.active_us < start_us and not self._over(axis)
        ]

    def _over(self, axis: PvtAxis) -> bool:
        """Whether a drive has come to the end of its records, and has said so since."""
        reported_ms = self._path_time.at_ms(axis.drive.statusword_us)
        return (
            axis.account.ended
            and not axis.ip_active
            and reported_ms is not None
            and reported_ms > axis.account.committed_ms
        )

    def advance(self, path_ms: float, now_us: float) -> str:
        self._feed(path_ms)
        if self._broken:
            return self._broken
        if not self.unconfirmed():
            self._reads.watch(now_us)
            self._ask()
        for axis in self.axes:
            account = axis.account
            gone = not axis.ip_active and axis.drive not in self.unconfirmed()
            early_ms = EARLY_END_MS + self._path_time.late_us / 1000
            if gone and not (account.ended and path_ms > account.committed_ms - early_ms):
                return f"{axis} left interpolated position mode on its own"
            told_ms = self._path_time.at_ms(axis.drive.statusword_us) or 0.0
            ended = account.ended and told_ms > account.committed_ms + END_TIMEOUT_MS
            if axis.ip_active and ended:
                return f"{axis} is still active after its end record"
        return ""

    def due_ms(self) -> float:
        reads_ms = self._path_time.at_ms(self._reads.due_us)
        return min(self.feeder.due_ms, math.inf if reads_ms is None else reads_ms)

    def arrived(self) -> bool:
        return not any(axis.ip_active for axis in self.axes)

    def finish(self) -> None:
        """Bit 4 has to fall so that it can rise again."""
        for axis in self.axes:
            self._out.frames.append(axis.drive.controlword(cia402.ENABLE_OPERATION))
            axis.drive.demand_qc = axis.account.last_position_qc

    def active(self, drive: Drive) -> bool:
        return self._axis_of[drive].ip_active

    # ------------------------------------------------------------------ feeding

    def _feed(self, path_ms: float) -> bool:
        """One record for the axis that needs it most; False if none needs any."""
        try:
            frame = self.feeder.next(path_ms)
        except TrajectoryError as error:
            self._broken = str(error)
            return False
        if frame is not None:
            self._out.frames.append(frame)
        return frame is not None

    def _ask(self) -> None:
        """Let drives say how many records they still take, by SDO."""
        while self._reads.outbox:
            index = self._reads.outbox.popleft()
            node_id, then = self.axes[index].drive.node_id, partial(self._asked, index)
            self._out.ask(node_id, reads=(epos2.FREE_RECORDS,), then=then)

    def _asked(self, index: int, values: Sequence[int], error: str) -> None:
        """The answer was seen on the bus, as any other frame; without one no motion starts."""
        if error and self._reads.unanswered(index):
            if self._path_time.start_us is None:
                self._broken = error
            else:
                self._out.announce("warning", error)

    # ------------------------------------------------------------------ what was on the bus

    def on_report(self, drive: Drive, reported: Set[tuple[int, int]], t_us: float) -> str:
        audit = self._axis_of[drive].audit
        wrong = ""
        if _CLOCK in reported and drive.latched is not None:
            wrong = audit.on_clock(drive.latched, t_us)
        if _DEMAND in reported and drive.demand_qc is not None:
            wrong = wrong or audit.on_demand(drive.demand_qc, t_us)
        return wrong

    def on_answer(self, drive: Drive, data: bytes, t_us: float) -> str:
        free = epos2.FREE_RECORDS.answered(data)
        if free is None:
            return ""
        asked_us = drive.asked_us
        from_ms, to_ms = self._path_time.at_ms(asked_us), self._path_time.at_ms(t_us)
        return self._reads.answer(self.drives.index(drive), free, asked_us, from_ms, to_ms)

    def on_sync(self, drive: Drive, t_us: float, starts: bool) -> str:
        return self._axis_of[drive].audit.on_sync(t_us, starts)

    def on_echo(self, drive: Drive, t_us: float) -> None:
        self._axis_of[drive].account.seen_on_bus(t_us)
