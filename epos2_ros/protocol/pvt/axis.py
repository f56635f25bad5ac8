"""One axis that follows a path of records."""

from __future__ import annotations

from dataclasses import dataclass, field

from epos2_ros.motion.fit import FitAxis
from epos2_ros.motion.record import Record
from epos2_ros.protocol import epos2
from epos2_ros.protocol.drive import Drive
from epos2_ros.protocol.frame import Frame
from epos2_ros.protocol.pvt.buffer_account import BufferAccount
from epos2_ros.protocol.pvt.path_audit import PathAudit


@dataclass(eq=False)
class PvtAxis:
    """A drive with the books of its buffer and the audit of what it executes."""

    drive: Drive
    fit: FitAxis
    audit: PathAudit
    account: BufferAccount = field(default_factory=BufferAccount)

    def __str__(self) -> str:
        return str(self.drive)

    @property
    def ip_active(self) -> bool:
        return bool(self.drive.statusword & epos2.IP_MODE_ACTIVE_STATUSWORD)

    @property
    def standing_qc(self) -> int:
        """Where it stands, by its own demand."""
        return self.drive.demand_qc or 0

    def begin(self) -> None:
        """A new motion, from where it stands."""
        self.account = BufferAccount()
        self.drive.demand = None  # it is the records that it follows
        self.audit.rest(self.standing_qc)

    def send(self, record: Record, path_ms: float) -> Frame:
        """One more reference point for its buffer (RPDO1), at a path time; 0 before the start."""
        self.account.send(record, path_ms)
        self.audit.send(record)
        return Frame(epos2.RPDO1 + self.drive.node_id, record.pack())
