"""Who is on a bus: listen first, then ask every node id, and keep all that was heard. No I/O.

First nothing is sent at all for a while: boot-ups, heartbeats, emergencies and the traffic of
others are counted. Then every node id is asked for its device type and identity, those that answer
for the rest, by SDO uploads alone (`uploads`): nothing changes on any device.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field

from epos2_ros.bus.transmitter import worst_case_bits
from epos2_ros.commission import makers
from epos2_ros.commission.found import Found
from epos2_ros.commission.uploads import REQUEST, RESPONSE, Stray, Uploads
from epos2_ros.protocol.frame import Frame

NODE_IDS = range(1, 128)
NMT, SYNC, TIME, HEARTBEAT = 0x000, 0x080, 0x100, 0x700
BOOT_UP = 0
SETTLE_US, TIMEOUT_US = 10_000.0, 250_000.0
SETTLE_FRAMES, TIMEOUT_FRAMES = 4, 64  # on a slow bus frames take longer than devices
SDO_BITS = worst_case_bits(8)
SHARE = 0.5  # of the bus, at most, for our requests


@dataclass
class Heard:
    """What came from others without being asked for."""

    frames: int = 0
    boot_ups: Counter[int] = field(default_factory=Counter)  # by node id, like the following
    heartbeats: dict[int, list[tuple[float, int]]] = field(default_factory=dict)  # time, state
    emergencies: dict[int, list[int]] = field(default_factory=dict)  # error codes
    requests: Counter[int] = field(default_factory=Counter)  # SDO, to this node
    nmt: int = 0
    sync: int = 0
    time: int = 0
    pdos: int = 0

    def take(self, frame: Frame, t_us: float) -> None:
        """Sort a frame by the predefined connection set (CiA 301, 7.3.5)."""
        can_id, data, _ = frame
        function, node_id = can_id & 0x780, can_id & 0x7F
        self.frames += 1
        if can_id == NMT:
            self.nmt += 1
        elif can_id == SYNC:
            self.sync += 1
        elif can_id == TIME:
            self.time += 1
        elif function == HEARTBEAT and node_id and len(data) == 1:
            state = data[0] & 0x7F
            if state == BOOT_UP:
                self.boot_ups[node_id] += 1
            self.heartbeats.setdefault(node_id, []).append((t_us, state))
        elif function == SYNC and len(data) == 8:
            self.emergencies.setdefault(node_id, []).append(int.from_bytes(data[:2], "little"))
        elif function == REQUEST and node_id:
            self.requests[node_id] += 1
        elif 0x180 <= function <= 0x500:
            self.pdos += 1


class Survey:
    """Frames and times in, frames out: `receive` each frame, `advance` at `deadline_us`.

    `bitrate` of the bus; `listen_us` is how long nothing is sent.
    """

    def __init__(self, t_us: float, bitrate: int, listen_us: float) -> None:
        frame_us = 1e6 * SDO_BITS / bitrate
        self.heard = Heard()
        self.began_us = t_us
        self.ended_us = math.inf
        self.nodes = {node_id: Found(node_id) for node_id in NODE_IDS}
        self._listen_until_us = t_us + listen_us
        self._settle_us = max(SETTLE_US, SETTLE_FRAMES * frame_us)
        self._uploads = Uploads(
            {node_id: makers.interview(found) for node_id, found in self.nodes.items()},
            self._listen_until_us,
            gap_us=frame_us / SHARE,
            settle_us=self._settle_us,
            timeout_us=max(TIMEOUT_US, TIMEOUT_FRAMES * frame_us),
        )
        self.outbox = self._uploads.outbox
        self._unseen: Counter[Frame] = Counter()  # own frames, their echo not yet seen

    @property
    def done(self) -> bool:
        return self.ended_us < math.inf

    @property
    def deadline_us(self) -> float:
        return self._uploads.deadline_us if not self._uploads.done else self._quiet_us

    @property
    def strays(self) -> dict[int, list[Stray]]:
        """By node id."""
        return self._uploads.strays

    def present(self) -> Iterator[Found]:
        """The devices that answered, by node id."""
        return (found for found in self.nodes.values() if found.answered)

    def sent(self, frame: Frame) -> None:
        """A frame of `outbox` was handed to the adapter, which may give it back."""
        self._unseen[frame] += 1

    def receive(self, frame: Frame, t_us: float) -> None:
        """A frame was on the bus, whoever sent it."""
        if self._unseen[frame]:
            self._unseen[frame] -= 1
            return
        if frame.can_id & 0x780 != RESPONSE:
            self.heard.take(frame, t_us)
        else:
            self.heard.frames += 1
            self._uploads.receive(frame, t_us)
        self._look(t_us)

    def advance(self, t_us: float) -> None:
        """Do what is due."""
        self._uploads.advance(t_us)
        self._look(t_us)

    def give_up(self, t_us: float) -> None:
        """Nothing can be sent: it ends with what was heard."""
        self.ended_us = t_us

    _quiet_us = math.inf

    def _look(self, t_us: float) -> None:
        """The last answer may have a second one: it ends a while after it."""
        if self._uploads.done and self._quiet_us == math.inf:
            self._quiet_us = t_us + self._settle_us
        if t_us >= self._quiet_us:
            self.ended_us = min(self.ended_us, t_us)
