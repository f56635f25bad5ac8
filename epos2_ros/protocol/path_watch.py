"""From the frames on the bus to the path that each axis has executed, piece by piece.

At every SYNC a drive says where its axis is; what the axis was to do in between is known from the
records that were sent (interpolated position mode) or from the move that was started (profile
position mode).
"""

from __future__ import annotations

from typing import Protocol

from epos2_ros.motion.compare import LOOP_US
from epos2_ros.motion.crossings import Path
from epos2_ros.motion.record import Record
from epos2_ros.protocol import epos2
from epos2_ros.protocol.drive import Drive
from epos2_ros.protocol.executed_path import Demand, ExecutedPath
from epos2_ros.protocol.frame import Frame
from epos2_ros.protocol.group import Group
from epos2_ros.protocol.modes.homing import Homing
from epos2_ros.protocol.phase import IN_MOTION, Phase
from epos2_ros.protocol.pvt.axis import PvtAxis
from epos2_ros.protocol.pvt.buffer_account import BufferAccount

_DEMAND = (epos2.POSITION_DEMAND, 0)
_ON_THE_PATH = IN_MOTION | {Phase.STANDING}


class PathWatch(Protocol):
    """One axis."""

    executed: ExecutedPath

    def receive(self, frame: Frame, t_us: float, echo: bool) -> Path | None:
        """The piece of path that this frame completes, if any."""


class RecordPathWatch:
    """One axis that follows records, or moves of its own. The group takes a frame in first."""

    def __init__(self, group: Group, axis: PvtAxis) -> None:
        self.executed = ExecutedPath()
        self._group = group
        self._axis = axis
        self._drive = axis.drive
        self._account: BufferAccount | None = None  # of the motion the records belong to
        self._records: list[Record] = []  # sent before its start
        self._started = False
        self._demand: Demand | None = None
        self._zero_us = 0.0  # where it begins
        self._sync_us: float | None = None
        self._age_us = 0.0  # of what the drive says at a SYNC
        axis.watchers.append(self._on_record)

    def receive(self, frame: Frame, t_us: float, echo: bool) -> Path | None:
        """The piece of path that this frame completes, if any."""
        if frame.can_id == epos2.SYNC:
            self._on_sync(t_us)
        elif not echo and _DEMAND in self._drive.objects_of(frame.can_id):
            return self._on_sample()
        return None

    def _on_record(self, record: Record) -> None:
        if self._axis.account is not self._account:
            self._account, self._records, self._started = self._axis.account, [], False
        if not self._started:
            self._records.append(record)
        elif self._demand is not None:
            self._demand.add(record, self._axis.fit.velocity_unit_qc_s)

    def _on_sync(self, t_us: float) -> None:
        self._sync_us = t_us
        if not self._started and self._records and self._group.path_time.start_us == t_us:
            assert self._drive.demand_qc is not None
            self._started = True
            self._demand, self._zero_us = Demand.resting(self._drive.demand_qc, t_us), t_us
            for record in self._records:
                self._demand.add(record, self._axis.fit.velocity_unit_qc_s)
        elif self._started and self._demand is not None:
            zero_us = self._group.path_time.zero_us(t_us)
            self._demand.shift(zero_us - self._zero_us)
            self._zero_us = zero_us

    def _on_sample(self) -> Path | None:
        demand_qc = self._drive.demand_qc
        if self._sync_us is None or demand_qc is None:
            return None
        if self._group.phase not in _ON_THE_PATH or self._drive.operation == Homing.operation:
            self._demand = None
        demand = self._drive.demand or self._demand
        # What the drive says is from its last control cycle; the demand tells when that was.
        if demand is not None:
            when_us = demand.when(demand_qc, self._sync_us)
            if when_us is not None:
                self._age_us = self._sync_us - when_us
        error_qc, position = self._drive.following_error_qc, self._drive.position_qc
        if error_qc is not None or position is None:
            position = demand_qc - (error_qc or 0)
        return self.executed.sample(self._sync_us - self._age_us, position, 0.0, demand)


class ProfilePathWatch:
    """One axis that moves in profile position mode. The group takes a frame in first."""

    def __init__(self, drive: Drive) -> None:
        self.executed = ExecutedPath()
        self._drive = drive

    def receive(self, frame: Frame, t_us: float, echo: bool) -> Path | None:
        """The piece of path that this frame completes, if any."""
        drive = self._drive
        if echo or frame.can_id != epos2.TPDO2 + drive.node_id or drive.position_qc is None:
            return None
        # The position is from the drive's last loop, half a loop ago on average.
        t_us = drive.sample_us - LOOP_US / 2
        return self.executed.sample(t_us, drive.position_qc, drive.velocity_qc_s, drive.demand)
