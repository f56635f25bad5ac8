"""Whether somebody else commands these drives, by frames that only their host sends.

Two hosts on one bus (a driver started twice, a maker's tool, a PLC) give the drives two sets of
orders; CANopen has one NMT master and one SYNC producer (CiA 301, 7.2.5 and 7.2.8). Frames of ours
that an adapter held back come at once when it is opened again; so before the drives are brought up
it takes two, some time apart.
"""

from __future__ import annotations

from collections.abc import Mapping

from epos2_ros.protocol import epos2
from epos2_ros.protocol.frame import Frame
from epos2_ros.protocol.timekeeper import HOST_NODE_ID

APART_US = 50_000.0
MEMORY_US = 1_000_000.0  # after this without another frame of its, it is gone
_RPDOS = (epos2.RPDO1, epos2.RPDO2, epos2.RPDO3, epos2.RPDO4)


class OtherHost:
    """`names`: the drives, by node id. `sends_sync`: whether we do. Times are host µs."""

    def __init__(self, names: Mapping[int, str], sends_sync: bool) -> None:
        self._names = names
        self._sends_sync = sends_sync
        self._first_us: dict[int, float] = {}  # by COB-ID
        self._last_us: dict[int, float] = {}
        self._told = ""
        self._told_us = -MEMORY_US

    def look(self, frame: Frame, t_us: float, at_work: bool) -> str:
        """A frame that is none of ours: what it says of another host, "" if nothing.

        `at_work`: the drives are brought up, and SYNC and heartbeat are ours.
        """
        what = self._sign(frame, at_work)
        if not what:
            return ""
        can_id = frame.can_id
        if t_us > self._last_us.get(can_id, t_us) + MEMORY_US or can_id not in self._first_us:
            self._first_us[can_id] = t_us
        self._last_us[can_id] = t_us
        if not at_work and t_us < self._first_us[can_id] + APART_US:
            return ""
        self._told = f"another host is on this bus: {what}; stop it, or give it a bus of its own"
        self._told_us = t_us
        return self._told

    def still_there(self, now_us: float) -> str:
        """What was said of it, if that was a moment ago; else ""."""
        return self._told if now_us < self._told_us + MEMORY_US else ""

    def _sign(self, frame: Frame, at_work: bool) -> str:
        """What only a host sends, in words."""
        function, node = frame.can_id & 0x780, frame.can_id & 0x7F
        if frame.can_id == epos2.HEARTBEAT + HOST_NODE_ID:
            return f"there is a heartbeat of node {HOST_NODE_ID} that is not ours"
        if frame.can_id == epos2.NMT:
            return "there is an NMT command that is not ours"
        if frame.can_id == epos2.TIME:
            return "there is a TIME that is not ours"
        if frame.can_id == epos2.SYNC and self._sends_sync and at_work:
            return "there is a SYNC that is not ours (a drive may send it, too: 0x1005)"
        if function in _RPDOS and node in self._names:
            return f"somebody else sends PDOs to {self._names[node]} (0x{frame.can_id:03X})"
        return ""
