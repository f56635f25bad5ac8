"""One EPOS2 as the group sees it: what it last reported, and the frames that command it."""

from __future__ import annotations

import math
from dataclasses import dataclass

from epos2_ros.motion.fit import FitAxis
from epos2_ros.motion.record import Record
from epos2_ros.protocol import cia402, epos2
from epos2_ros.protocol.buffer_account import BufferAccount
from epos2_ros.protocol.cia402 import State
from epos2_ros.protocol.frame import Frame
from epos2_ros.protocol.path_audit import PathAudit

HOLDS_PERIODS = 2.0  # so many of its inhibit time after a change a drive has reported it
SYNC_ANSWER_AGE_US = 50_000.0  # an answer to SYNC may wait so long for its turn on the bus


@dataclass(frozen=True)
class AxisSetup:
    """What the group has to know of an axis."""

    joint: str
    node_id: int
    fit: FitAxis


class Axis:
    """Reported state of one drive. Fields are raw drive units; times are host µs.

    `clock_master`: its clock is the others' master, which leaves no room in its PDOs for the motor
    current, and for the buffer status in TPDO1 only.
    """

    def __init__(self, setup: AxisSetup, audit: PathAudit, clock_master: bool = False) -> None:
        self._clock_master = clock_master
        self.joint = setup.joint
        self.node_id = setup.node_id
        self.fit = setup.fit
        self.statusword = 0
        self.statusword_us = -math.inf
        self.active_us = -math.inf  # when it last reported ip mode active
        self._event_us = -math.inf  # of the last TPDO1
        self.buffer_status = 0
        self.position_qc: int | None = None
        self.velocity = 0
        self.sample_us = -math.inf
        self.current_ma: int | None = None
        self.demand_qc: int | None = None
        self.demand_us = -math.inf
        self.following_error_qc = 0
        self.emergency = 0
        self.heard_us = -math.inf
        self.asked_us = -math.inf  # when the last SDO request to it was on the bus
        self.restarted = False
        self.account = BufferAccount()
        self.audit = audit

    def __str__(self) -> str:
        return f"{self.joint} (node {self.node_id})"

    # What the drive says ---------------------------------------------------------------

    @property
    def pdo_bytes(self) -> dict[int, int]:
        """By COB-ID, how long what it sends has to be for the methods below."""
        stamp = epos2.CLOCK_MASTER_TPDO3_LAYOUT if self._clock_master else epos2.TPDO3_LAYOUT
        return {
            epos2.TPDO1 + self.node_id: epos2.TPDO1_LAYOUT.size,
            epos2.TPDO2 + self.node_id: epos2.TPDO2_LAYOUT.size,
            epos2.TPDO3 + self.node_id: stamp.size,
            epos2.TPDO4 + self.node_id: epos2.TPDO4_LAYOUT.size,
        }

    @property
    def state(self) -> State:
        return cia402.state_of(self.statusword)

    @property
    def powering_up(self) -> bool:
        """Whether it is on its own way to "operation enabled": refresh cycle, measure init."""
        return self.state is State.SWITCHED_ON and bool(self.statusword & epos2.REFRESH_CYCLE)

    @property
    def ip_active(self) -> bool:
        return bool(self.statusword & epos2.IP_MODE_ACTIVE_STATUSWORD)

    def measured_us(self, inhibit_us: float) -> float:
        """The newest time at which it was at `position_qc`; -inf: it has not said yet.

        A position that has changed is reported within the inhibit time. As long as the drive is
        heard, one that was reported before is therefore where the axis still is: one that rests
        or is blocked does not repeat it.
        """
        if self.position_qc is None:
            return -math.inf
        return max(self.sample_us, self.heard_us - HOLDS_PERIODS * inhibit_us)

    def report(self, statusword: int, t_us: float) -> None:
        """A statusword, from a PDO or read at bring-up."""
        self.statusword = statusword
        self.statusword_us = t_us
        if self.ip_active:
            self.active_us = t_us

    def on_tpdo1(self, data: bytes, t_us: float) -> None:
        statusword, self.buffer_status = epos2.TPDO1_LAYOUT.unpack(data)
        self.report(statusword, t_us)
        self._event_us = t_us

    def on_tpdo2(self, data: bytes, t_us: float) -> None:
        self.position_qc, self.velocity = epos2.TPDO2_LAYOUT.unpack(data)
        self.sample_us = t_us

    def on_tpdo3(self, data: bytes, t_us: float) -> int:
        """Returns what its clock was at the SYNC that this answers."""
        if self._clock_master:
            (latched,) = epos2.CLOCK_MASTER_TPDO3_LAYOUT.unpack(data)
        else:
            latched, statusword, self.current_ma = epos2.TPDO3_LAYOUT.unpack(data)
            if self._repeats(t_us):
                self.report(statusword, t_us)
        return int(latched)

    def on_tpdo4(self, data: bytes, t_us: float) -> None:
        self.demand_qc, repeated, self.following_error_qc = epos2.TPDO4_LAYOUT.unpack(data)
        if self._repeats(t_us):
            if self._clock_master:
                self.report(repeated, t_us)
            else:
                self.buffer_status = repeated
        self.demand_us = t_us

    def _repeats(self, t_us: float) -> bool:
        """Whether a state sampled at the last SYNC is at least as new as that of TPDO1."""
        return t_us > self._event_us + SYNC_ANSWER_AGE_US

    def on_emergency(self, data: bytes) -> int:
        """Error code of the emergency; 0 says that all errors are gone."""
        self.emergency = epos2.EMCY_LAYOUT.unpack(data)[0]
        return self.emergency

    def trouble(self) -> str:
        """What the drive complains of, in words; "" if nothing."""
        words = []
        if self.emergency:
            words.append(epos2.describe_emergency(self.emergency))
        if errors := epos2.describe_buffer_errors(self.buffer_status):
            words.append(errors)
        if not words and self.statusword & cia402.FAULT_BIT:
            words.append(self.state.value)
        return ": ".join(words)

    # What the drive is told ------------------------------------------------------------

    def controlword(self, value: int) -> Frame:
        """RPDO4: takes effect at once."""
        return Frame(epos2.RPDO4 + self.node_id, value.to_bytes(2, "little"))

    def synchronous_controlword(self, value: int) -> Frame:
        """RPDO2: takes effect at the next SYNC."""
        return Frame(epos2.RPDO2 + self.node_id, value.to_bytes(2, "little"))

    def record(self, record: Record) -> Frame:
        """RPDO1: one more reference point for the FIFO."""
        return Frame(epos2.RPDO1 + self.node_id, record.pack())

    def time_stamp(self, stamp: int) -> Frame:
        """RPDO3: when the last SYNC was."""
        return Frame(epos2.RPDO3 + self.node_id, stamp.to_bytes(4, "little"))
