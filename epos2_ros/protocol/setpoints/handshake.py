"""How a drive is given one set-point after the other, frame by frame (Nanotec, "Profile Position").

What the set-point is made of goes first, by RPDO1 and RPDO3; when both were on the bus "new
set-point" (bit 4) rises in an asynchronous controlword (RPDO4). The drive takes the set-point by
setting bit 12 of the statusword; bit 4 falls; bit 12 falls when there is room for another. A
controlword that is lost shows in bit 12, and is repeated: without an edge it does nothing.

READING: bit 9 ("change on set-point") counts when bit 4 rises; it stays as it is meanwhile, for a
drive that would look at it later. Of what a set-point is made of nothing shows that it was lost; so
it is sent twice.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import Enum

from epos2_ros.motion.setpoints import SetPoint
from epos2_ros.protocol import cia402, epos2
from epos2_ros.protocol.drive import Drive
from epos2_ros.protocol.frame import Frame

RESEND_US = 15_000.0  # what is not answered by then is told again
COPIES = 2


def parameters(set_point: SetPoint, node_id: int) -> tuple[Frame, Frame]:
    """The frames that tell a drive what a set-point is made of."""
    target = set_point.target_qc.to_bytes(4, "little", signed=True)
    velocity, up, down = (
        value.to_bytes(4, "little")
        for value in (set_point.velocity, set_point.acceleration, set_point.deceleration)
    )
    return (
        Frame(epos2.RPDO1 + node_id, target + velocity),
        Frame(epos2.RPDO3 + node_id, up + down),
    )


class Step(Enum):
    """Where the handshake is."""

    FREE = "another set-point may be given"
    OFFERED = "what it is made of is on its way"
    RAISED = "bit 4 has risen, bit 12 has not"
    TAKEN = "bit 12 is set: the drive has it, and no room for another"


class Handshake:
    """With one drive. Times are host µs."""

    def __init__(self, drive: Drive) -> None:
        self._drive = drive
        self.rest()

    def rest(self) -> None:
        """The drive has no set-point, and bit 4 is low."""
        self.step = Step.FREE
        self._bits = 0  # of the controlword, as it was last told
        self._raise_us = math.inf
        self._parts: tuple[Frame, ...] = ()
        self._unseen: list[bytes] = []
        self._told_us = -math.inf
        self._low_again = False  # the falling bit 4 was told twice

    @property
    def acknowledged(self) -> bool:
        return bool(self._drive.statusword & cia402.SETPOINT_ACKNOWLEDGED)

    # ------------------------------------------------------------------ what is told

    def offer(
        self, set_point: SetPoint, bits: int, now_us: float, raise_us: float = -math.inf
    ) -> Sequence[Frame]:
        """Give the next one, with these bits of the controlword besides bit 4, at `raise_us`.

        At infinity somebody else tells the drive: a synchronous controlword, and then `raised`.
        """
        self._parts = parameters(set_point, self._drive.node_id)
        self.step, self._bits, self._raise_us = Step.OFFERED, bits, raise_us
        return self._send_parts(now_us)

    def _send_parts(self, now_us: float) -> Sequence[Frame]:
        self._told_us = now_us
        frames = self._parts * COPIES
        self._unseen = [frame.data for frame in frames]
        return frames

    def raised(self, now_us: float) -> None:
        """The controlword with the rising bit 4 is there."""
        self.step, self._told_us = Step.RAISED, now_us

    def advance(self, now_us: float) -> Sequence[Frame]:
        """What is due."""
        late = now_us >= self._told_us + RESEND_US
        match self.step:
            case Step.OFFERED if self._unseen and late:
                return self._send_parts(now_us)
            case Step.OFFERED if not self._unseen and now_us >= self._raise_us:
                self.raised(now_us)
                return [self._word(cia402.NEW_SETPOINT)]
            case Step.RAISED if late and self._raise_us < math.inf:
                return [*self._send_parts(now_us), self._word(cia402.NEW_SETPOINT)]
            case Step.TAKEN if late and not self._low_again:
                self._low_again = True
                return self.lower(now_us)
        return ()

    def lower(self, now_us: float) -> Sequence[Frame]:
        """Bit 4 falls: without that bit 12 would not fall."""
        self._told_us = now_us
        return [self._word(0)]

    def _word(self, bits: int) -> Frame:
        return self._drive.controlword(cia402.ENABLE_OPERATION | self._bits | bits)

    @property
    def due_us(self) -> float:
        """When `advance` is wanted next."""
        match self.step:
            case Step.OFFERED if self._unseen:
                return self._told_us + RESEND_US
            case Step.OFFERED:
                return self._raise_us
            case Step.RAISED:
                return self._told_us + RESEND_US
            case Step.TAKEN if not self._low_again:
                return self._told_us + RESEND_US
        return math.inf

    def unanswered(self, now_us: float) -> bool:
        """Whether the drive's bit 12 should have been heard of by now, where it is to rise."""
        return self.step is Step.RAISED and now_us >= self._told_us + RESEND_US / 2

    # ------------------------------------------------------------------ what was on the bus

    def on_echo(self, data: bytes) -> None:
        """A part of a set-point was on the bus."""
        if data in self._unseen:
            self._unseen.remove(data)

    @property
    def offered(self) -> bool:
        """Whether all that the set-point is made of was on the bus."""
        return self.step is not Step.OFFERED or not self._unseen

    def on_statusword(self, now_us: float) -> Sequence[Frame]:
        """The drive has told its statusword."""
        if self.step is Step.RAISED and self.acknowledged:
            self.step, self._low_again = Step.TAKEN, False
            self._bits &= ~cia402.CHANGE_IMMEDIATELY
            return self.lower(now_us)
        if self.step is Step.TAKEN and not self.acknowledged:
            self.step = Step.FREE
        return ()
