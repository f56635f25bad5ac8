"""Controlwords that the next SYNC makes count, in every drive at once (RPDO2).

What was put into a drive's synchronous RPDO stays there until a SYNC: it can't be withdrawn, only
replaced. So whoever changes his mind sends another controlword, and no SYNC of ours goes out before
all of them are on the bus; a controller with several mailboxes may let it overtake them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

from epos2_ros.protocol import cia402
from epos2_ros.protocol.cia402 import State
from epos2_ros.protocol.drive import Drive
from epos2_ros.protocol.outbox import Outbox

_NO_CHANGE = {
    State.OPERATION_ENABLED: cia402.ENABLE_OPERATION,
    State.QUICK_STOP_ACTIVE: cia402.QUICK_STOP,
}


class SynchronousControlwords:
    """Of all drives of a bus. Times are host µs."""

    def __init__(self, drives: Sequence[Drive], out: Outbox) -> None:
        self.latched = False  # a SYNC is still to make the last of them count
        self.sent_us = 0.0  # when the last were handed over
        self._drives = tuple(drives)
        self._out = out
        self._unseen: Counter[int] = Counter()  # by node id: not yet seen on the bus

    def send(self, controlwords: Mapping[Drive, int], now_us: float) -> None:
        """By drive."""
        self.latched, self.sent_us = True, now_us
        for drive, controlword in controlwords.items():
            self._unseen[drive.node_id] += 1
            self._out.frames.append(drive.synchronous_controlword(controlword))

    def take_back(self, now_us: float, controlword: int | None = None) -> None:
        """If the next SYNC is to bring anything, let it bring `controlword`; None: let it change
        nothing."""
        if self.latched:
            self.send(
                {
                    drive: _NO_CHANGE.get(drive.state, cia402.DISABLE_VOLTAGE)
                    if controlword is None
                    else controlword
                    for drive in self._drives
                },
                now_us,
            )

    @property
    def on_their_way(self) -> bool:
        """Whether some are not yet on the bus."""
        return bool(self._unseen)

    @property
    def unseen(self) -> list[Drive]:
        """The drives whose controlword is not yet on the bus."""
        unseen = self._unseen
        return [drive for drive in self._drives if drive.node_id in unseen] if unseen else []

    def forget(self) -> None:
        """Those that are not on the bus will not get there."""
        self._unseen.clear()

    # ------------------------------------------------------------------ what was on the bus

    def on_echo(self, node_id: int) -> None:
        """One of a drive's was on the bus."""
        self._unseen -= Counter((node_id,))

    def on_sync(self) -> None:
        """A SYNC made those count that were on the bus."""
        self.latched = bool(self._unseen)
