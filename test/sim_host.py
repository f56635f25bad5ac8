"""A bare CAN host for the tests of the simulated drives: raw frames, CiA 301 by hand.

It uses nothing of the driver and no CANopen library, so that what it asserts is what the
documents say is on the bus.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from epos2_ros.sim.can_bus import SimulatedBus
from epos2_ros.sim.cia402 import Delays
from epos2_ros.sim.epos2 import Dictionary, Epos2

ASYNCHRONOUS = 255


class Seen(NamedTuple):
    """A frame on the bus."""

    can_id: int
    data: bytes
    t_us: float
    echo: bool


class Abort(Exception):
    """The drive aborted an SDO transfer."""

    def __init__(self, code: int) -> None:
        super().__init__(f"0x{code:08X}")
        self.code = code


def prompt_drive(node_id: int, **settings: Any) -> Epos2:
    """A drive with the note's dictionary that does everything at once."""
    return Epos2(node_id, **{"dictionary": Dictionary.NOTE, "delays": Delays(), **settings})


def pvt(position: int, velocity: int, time_ms: int) -> bytes:
    """The 8 bytes of a reference point (the note, table 1)."""
    return struct.pack("<i", position) + struct.pack("<i", velocity)[:3] + bytes([time_ms])


class Host:
    """Drives on a bus in simulated time, and the one who talks to them."""

    def __init__(self, *drives: Epos2, bitrate: int = 1_000_000) -> None:
        self.bus = SimulatedBus(bitrate)
        for drive in drives:
            self.bus.add(drive)
        self.frames: list[Seen] = []
        self.run(1)

    # --- the bus ------------------------------------------------------------------------

    def run(self, ms: float) -> None:
        self.bus.run_until(self.bus.now_us + 1000 * ms, self._see)

    def run_until(self, condition: Callable[[], bool], ms: float) -> None:
        """In steps of 0.1 ms; fails after `ms`."""
        end_us = self.bus.now_us + 1000 * ms
        while not condition():
            assert self.bus.now_us < end_us, f"not within {ms} ms"
            self.run(0.1)

    def _see(self, can_id: int, data: bytes, t_us: float, echo: bool) -> None:
        self.frames.append(Seen(can_id, data, t_us, echo))

    def send(self, can_id: int, data: bytes | str = b"", ms: float = 0.5) -> None:
        """Sends a frame (hex text or bytes) and lets the bus run for `ms`."""
        self.bus.host_send(can_id, bytes.fromhex(data) if isinstance(data, str) else data)
        self.run(ms)

    def heard(self, can_id: int) -> list[bytes]:
        """What drives have sent under an identifier so far."""
        return [frame.data for frame in self.frames if frame.can_id == can_id and not frame.echo]

    def nmt(self, command: int, node: int = 0) -> None:
        self.send(0x000, bytes([command, node]))

    def sync(self, ms: float = 0.5) -> float:
        """Sends SYNC; gives the time it was complete [µs]."""
        self.send(0x080, ms=ms)
        return [f.t_us for f in self.frames if f.can_id == 0x080 and f.echo][-1]

    # --- SDO ----------------------------------------------------------------------------

    def ask(self, request: bytes | str, node: int = 1) -> bytes:
        """One SDO frame there, one back."""
        before = len(self.heard(0x580 + node))
        self.send(0x600 + node, request, ms=self.bus.bit_us)  # 1 ms at 1 Mbit/s
        answers = self.heard(0x580 + node)[before:]
        assert len(answers) == 1, f"{len(answers)} answers"
        return answers[0]

    @staticmethod
    def _check(answer: bytes) -> bytes:
        if answer[0] == 0x80:
            raise Abort(int.from_bytes(answer[4:], "little"))
        return answer

    def read_bytes(self, index: int, subindex: int = 0, node: int = 1) -> bytes:
        """Expedited or segmented upload."""
        multiplexer = struct.pack("<HB", index, subindex)
        answer = self._check(self.ask(b"\x40" + multiplexer + bytes(4), node))
        assert answer[1:4] == multiplexer
        if answer[0] & 2:
            assert answer[0] & 1, "expedited without a size"
            return answer[4 : 8 - (answer[0] >> 2 & 3)]
        size, data, toggle = int.from_bytes(answer[4:], "little"), b"", 0
        while True:
            answer = self._check(self.ask(bytes([0x60 | toggle << 4]) + bytes(7), node))
            assert answer[0] >> 4 & 1 == toggle
            data += answer[1 : 8 - (answer[0] >> 1 & 7)]
            toggle ^= 1
            if answer[0] & 1:
                assert len(data) == size
                return data

    def read(self, index: int, subindex: int = 0, node: int = 1, signed: bool = False) -> int:
        data = self.read_bytes(index, subindex, node)
        return int.from_bytes(data, "little", signed=signed)

    def write_bytes(self, index: int, subindex: int, data: bytes, node: int = 1) -> None:
        """Expedited or segmented download. Raises `Abort`."""
        multiplexer = struct.pack("<HB", index, subindex)
        if len(data) <= 4:
            command = 0x23 | (4 - len(data)) << 2
            request = bytes([command]) + multiplexer + data.ljust(4, b"\0")
            assert self._check(self.ask(request, node)) == b"\x60" + multiplexer + bytes(4)
            return
        size = len(data).to_bytes(4, "little")
        assert self._check(self.ask(b"\x21" + multiplexer + size, node))[0] == 0x60
        toggle = 0
        while data:
            segment, data = data[:7], data[7:]
            command = toggle << 4 | (7 - len(segment)) << 1 | (not data)
            answer = self._check(self.ask(bytes([command]) + segment.ljust(7, b"\0"), node))
            assert answer[0] == 0x20 | toggle << 4
            toggle ^= 1

    def write(self, index: int, subindex: int, value: int, size: int, node: int = 1) -> None:
        data = value.to_bytes(size, "little", signed=value < 0)
        self.write_bytes(index, subindex, data, node)

    # --- drives -------------------------------------------------------------------------

    def map(
        self,
        communication: int,
        cob_id: int,
        entries: Sequence[int],
        transmission: int = ASYNCHRONOUS,
        inhibit: int = 0,
        node: int = 1,
    ) -> None:
        """Configures a PDO in the order CiA 301 prescribes (7.5.2.36)."""
        self.write(communication, 1, 1 << 31 | cob_id, 4, node)
        self.write(communication, 2, transmission, 1, node)
        if communication >= 0x1800:
            self.write(communication, 3, inhibit, 2, node)
        self.write(communication + 0x200, 0, 0, 1, node)
        for number, entry in enumerate(entries, 1):
            self.write(communication + 0x200, number, entry, 4, node)
        self.write(communication + 0x200, 0, len(entries), 1, node)
        self.write(communication, 1, cob_id, 4, node)

    def control(self, word: int, node: int = 1) -> None:
        """Control word by SDO."""
        self.write(0x6040, 0, word, 2, node)

    def status(self, node: int = 1) -> int:
        return self.read(0x6041, 0, node)

    def buffer_status(self, node: int = 1) -> int:
        return self.read(0x20C4, 1, node)

    def enable(self, mode: int, node: int = 1) -> None:
        """The first steps of the note's table 17."""
        self.write(0x6060, 0, mode, 1, node)
        self.control(0x0006, node)
        self.control(0x000F, node)
        self.run_until(lambda: self.status(node) & 0x6F == 0x27, 500)

    def prepare_ip(self, node: int = 1) -> None:
        """Ready for records on 0x200 + node; the control word by SYNC on 0x300 + node."""
        self.map(0x1400, 0x200 + node, [0x20C1_0040], node=node)
        self.map(0x1401, 0x300 + node, [0x6040_0010], transmission=1, node=node)
        self.nmt(0x01, node)
        self.enable(7, node)
        self.write(0x60C4, 6, 1, 1, node)

    def feed(self, *points: tuple[int, int, int], node: int = 1) -> None:
        for point in points:
            self.send(0x200 + node, pvt(*point), ms=0.2)
