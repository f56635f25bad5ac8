"""One axis that follows a path of records."""

from __future__ import annotations

from collections.abc import Callable

from epos2_ros.motion.fit import FitAxis
from epos2_ros.motion.record import Record
from epos2_ros.protocol import epos2
from epos2_ros.protocol.drive import Drive
from epos2_ros.protocol.family import PvtBuffer
from epos2_ros.protocol.frame import Frame
from epos2_ros.protocol.pvt.buffer_account import BufferAccount
from epos2_ros.protocol.pvt.path_audit import PathAudit


class PvtAxis:
    """A drive with the books of its buffer and the audit of what it executes."""

    def __init__(
        self, drive: Drive, fit: FitAxis, tolerance_qc: float, sync_period_us: float
    ) -> None:
        assert drive.family.pvt is not None
        self.drive = drive
        self.fit = fit
        self.buffer: PvtBuffer = drive.family.pvt
        self.audit = PathAudit(
            fit.velocity_unit_qc_s,
            tolerance_qc,
            sync_period_us,
            self.buffer.cycle_us,
            self.buffer.free_cycles,
        )
        self.account = self._new_account()
        self.watchers: list[Callable[[Record], None]] = []  # who wants to know of each record

    def __str__(self) -> str:
        return str(self.drive)

    def _new_account(self) -> BufferAccount:
        return self.buffer.account(self.fit.velocity_unit_qc_s, self.drive.buffer_status)

    @property
    def ip_active(self) -> bool:
        return bool(self.drive.statusword & epos2.IP_MODE_ACTIVE_STATUSWORD)

    @property
    def standing_qc(self) -> int:
        """Where it stands, by its own demand."""
        return self.drive.demand_qc or 0

    def rest(self) -> None:
        """It stands, with nothing in its buffer."""
        self.account = self._new_account()
        self.audit.rest(self.standing_qc)

    def begin(self) -> None:
        """A new motion, from where it stands."""
        self.rest()
        self.drive.demand = None  # it is the records that it follows

    def send(self, record: Record, path_ms: float) -> list[Frame]:
        """One more reference point for its buffer, at a path time; 0 before the start."""
        self.audit.send(record)
        for watcher in self.watchers:
            watcher(record)
        return self._frames(self.account.send(record, path_ms))

    def repeats(self) -> list[Frame]:
        """What makes good what was lost."""
        return self._frames(self.account.repeats())

    def _frames(self, pdos: list[bytes]) -> list[Frame]:
        return [Frame(epos2.RPDO1 + self.drive.node_id, pdo) for pdo in pdos]
