"""Interpolated position mode: records in each drive's buffer, executed on one clock.

A record is the end of a segment, between whose ends the drive makes a cubic; what its buffer takes
for it is its family's. Before the start every drive has to report every record it was sent; in
motion its buffer is fed by the books, its reports are held against them, and at every SYNC its
position demand against the records (`pvt.path_audit`). What a halt leaves is "ip mode inactive".
Sources: maxon, application note "Interpolation Position Mode"; for Copley `copley_pvt`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence, Set
from functools import partial

from epos2_ros.errors import TrajectoryError
from epos2_ros.motion.reference import Reference
from epos2_ros.protocol import cia402, epos2
from epos2_ros.protocol.drive import Drive
from epos2_ros.protocol.modes.follower import Follower
from epos2_ros.protocol.outbox import Outbox
from epos2_ros.protocol.path_time import PathTime
from epos2_ros.protocol.pvt.axis import PvtAxis
from epos2_ros.protocol.pvt.buffer_reads import BufferReads
from epos2_ros.protocol.pvt.emptying import Emptying
from epos2_ros.protocol.pvt.feeder import Feeder
from epos2_ros.protocol.sdo import SdoWrite

END_TIMEOUT_MS = 500.0  # after the end record, for "ip mode inactive"
EARLY_END_MS = 50.0  # before the end of its records an axis may be seen to have ended
_CLOCK = (epos2.HIGH_RESOLUTION_TIME_STAMP, 0)
_DEMAND = (epos2.POSITION_DEMAND, 0)


class Interpolated(Follower):
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
        self._emptying = {
            axis.drive: Emptying(axis.drive, axis.buffer, out)
            for axis in axes
            if axis.buffer.remedy is not None
        }
        self._planned: Reference | None = None
        self._broken = ""  # why the reference can't be followed

    def plan(self, reference: Reference) -> None:
        self._planned = reference

    # ------------------------------------------------------------------ at rest

    def rest(self, drive: Drive) -> Sequence[SdoWrite]:
        """Empty the buffer; of what was in it nothing is executed."""
        self.on_rest(drive)
        if emptying := self._emptying.get(drive):
            emptying.begin()
        return self._axis_of[drive].buffer.empty

    def unready(self, drive: Drive, now_us: float) -> str:
        emptying = self._emptying.get(drive)
        return emptying.advance(now_us) if emptying else ""

    def on_rest(self, drive: Drive) -> None:
        self._axis_of[drive].rest()

    # ------------------------------------------------------------------ before the start

    def begin(self) -> None:
        assert self._planned is not None
        self._broken = ""
        self.path_ms = 0.0
        self.feeder.begin(self._planned)
        self._reads.begin()

    def prepare(self, now_us: float) -> bool:
        self._repeat()
        if self._feed(0.0):
            return True
        self._reads.ask_all(now_us)
        self._ask()
        return False

    def unprepared(self) -> str:
        if missing := self._reads.unreported():
            return f"{missing[0]} {missing[0].account.missing()}"
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
        self.path_ms = path_ms
        self._repeat()
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
        due_us = self._reads.due_us
        reads_ms = None if due_us == math.inf else self._path_time.at_ms(due_us)
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

    # ------------------------------------------------------------------ what they follow

    def replace(self, reference: Reference) -> None:
        self.feeder.replace(reference)

    @property
    def committed_ms(self) -> int:
        return self.feeder.committed_ms

    @property
    def stream_take_over_ms(self) -> float:
        return self.feeder.stream_take_over_ms

    @property
    def ending(self) -> bool:
        return self.feeder.ending

    def demand(self, drive: Drive, path_ms: float) -> tuple[float, float]:
        return self._axis_of[drive].audit.demand(path_ms)

    # ------------------------------------------------------------------ feeding

    def _feed(self, path_ms: float) -> bool:
        """One record for the axis that needs it most; False if none needs any."""
        try:
            fed = self.feeder.next(path_ms)
        except TrajectoryError as error:
            self._broken = str(error)
            return False
        while self.feeder.remarks:
            self._out.announce("warning", self.feeder.remarks.pop(0))
        if fed is not None:
            axis, record = fed
            self._out.frames.extend(axis.send(record, path_ms))
        return fed is not None

    def _repeat(self) -> None:
        """What drives have told to be missing, before anything new."""
        for axis in self.axes:
            self._out.frames.extend(axis.repeats())

    def _ask(self) -> None:
        """Let drives say what is in their buffers, by SDO."""
        while self._reads.outbox:
            index = self._reads.outbox.popleft()
            axis = self.axes[index]
            self._out.ask(
                axis.drive.node_id,
                reads=(axis.buffer.status,),
                then=partial(self._asked, index),
            )

    def _asked(self, index: int, values: Sequence[int], error: str) -> None:
        """The answer was seen on the bus, as any other frame; without one no motion starts."""
        if error and self._reads.unanswered(index):
            if self._path_time.start_us is None:
                self._broken = error
            else:
                self._out.announce("warning", error)

    # ------------------------------------------------------------------ what was on the bus

    def on_report(self, drive: Drive, reported: Set[tuple[int, int]], t_us: float) -> str:
        axis = self._axis_of[drive]
        audit, status, wrong = axis.audit, axis.buffer.status, ""
        if axis.account.sent and (status.index, status.subindex) in reported:
            at_ms = self._path_time.at_ms(t_us)
            if wrong := axis.account.report(drive.buffer_status, t_us, at_ms, at_ms):
                return wrong
        if _CLOCK in reported and drive.latched is not None:
            wrong = audit.on_clock(drive.latched, t_us)
        if _DEMAND in reported and drive.demand_qc is not None:
            wrong = wrong or audit.on_demand(drive.demand_qc, t_us)
        return wrong

    def on_answer(self, drive: Drive, data: bytes, t_us: float) -> str:
        axis = self._axis_of[drive]
        value = axis.buffer.status.answered(data)
        if value is None or not axis.account.sent:
            return ""
        asked_us = drive.asked_us
        from_ms, to_ms = self._path_time.at_ms(asked_us), self._path_time.at_ms(t_us)
        return self._reads.answer(self.drives.index(drive), value, asked_us, from_ms, to_ms)

    def on_sync(self, drive: Drive, t_us: float, starts: bool) -> str:
        return self._axis_of[drive].audit.on_sync(t_us, starts)

    def on_echo(self, drive: Drive, data: bytes, t_us: float) -> None:
        self._axis_of[drive].account.seen_on_bus(data, t_us)
