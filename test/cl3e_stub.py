"""A Nanotec CL3-E that only answers SDO requests: its identity and units, nothing moves.

Values are Nanotec's own for firmware FIR-v1419; it is a device of its own, no simulated slave of
the package.
"""

from __future__ import annotations

import math
from collections import deque

from epos2_ros.sim.dictionary import (
    INTEGER8,
    INTEGER16,
    INTEGER32,
    UNSIGNED8,
    UNSIGNED16,
    UNSIGNED32,
    VISIBLE_STRING,
    Entry,
    ObjectDictionary,
)
from epos2_ros.sim.sdo import SdoServer

VENDOR_ID = 0x26C
FIRMWARE = b"FIR-v1419-B29378"


class Cl3eStub:
    """To a simulated bus a drive like others. NMT pre-operational, switched off."""

    def __init__(self, node_id: int, serial: int = 1) -> None:
        self.node_id = node_id
        self.outbox: deque[tuple[int, bytes]] = deque([(0x700 + node_id, bytes(1))] * 2)
        self.next_event_us = math.inf
        od = self.dictionary = ObjectDictionary()
        for index, kind, value in (
            (0x1000, UNSIGNED32, 0x0004_0192),
            (0x100C, UNSIGNED16, 0),
            (0x1017, UNSIGNED16, 0),
            (0x2061, UNSIGNED32, 1),
            (0x2062, UNSIGNED32, 60),
            (0x3700, INTEGER16, -1),
            (0x6041, UNSIGNED16, 0x0240),
            (0x6061, INTEGER8, 0),
            (0x6064, INTEGER32, -4000),
            (0x6502, UNSIGNED32, 0xAF),
        ):
            od.variable(index, Entry(f"{index:04X}", kind, "ro", value))
        od.variable(0x1003, Entry("number of errors", UNSIGNED8))
        od.variable(0x1003, Entry("standard error field", UNSIGNED32, "ro"), 1)
        for index, text in ((0x1008, b"CL3-E-1-0F"), (0x100A, FIRMWARE)):
            od.variable(index, Entry(f"{index:04X}", VISIBLE_STRING, "const", text=text))
        od.record(
            0x1018, *(Entry("identity", UNSIGNED32, "ro", v) for v in (VENDOR_ID, 3, 0, serial))
        )
        for index, values in ((0x608F, (2000, 1)), (0x6091, (1, 1)), (0x6092, (1, 1))):
            od.record(index, *(Entry(f"{index:04X}", UNSIGNED32, "rw", v) for v in values))
        self._sdo = SdoServer(od)

    def advance(self, t_us: float) -> None:
        """It does nothing by itself."""

    def transmitted(self, can_id: int, t_us: float) -> None:
        """Nor does it listen to itself."""

    def receive(self, can_id: int, data: bytes, t_us: float, remote: bool = False) -> bool:
        if can_id != 0x600 + self.node_id or remote:
            return False
        response = self._sdo.request(data)
        if response is not None:
            self.outbox.append((0x580 + self.node_id, response))
        return True
