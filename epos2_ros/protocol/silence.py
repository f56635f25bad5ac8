"""Which drives are not heard any more, held against them only while the bus is listened to.

A host that is busy, stopped or swamped hears nobody, and what it has missed meanwhile it takes in
late or never. So silence is not measured by a clock but by what comes in: every frame says that
the bus was listened to up to its time. The host's own heartbeat is among them every 80 ms; where
that was not there for longer than MAX_GAP_US, the host was busy elsewhere, and the rest of the gap
doesn't count: a drive with life guarding says nothing when it is not asked. (A bus on which the
host's own frames don't appear is the link's to notice.)
"""

from __future__ import annotations

import math

SILENCE_US = 400_000.0
"""A drive not heard for so long is lost. It produces a heartbeat every 0.3 s and answers every
SYNC; with a frame of the host every 80 ms it is noticed within half a second."""
MAX_GAP_US = 150_000.0


class Silence:
    """How long each of some senders was not heard. Times are host µs."""

    def __init__(self, senders: int) -> None:
        self._last_us = -math.inf  # of all frames
        self._ours_us = -math.inf  # of the host's own
        self._listened_us = 0.0  # for so long the bus was listened to
        self._heard_us = [0.0] * senders  # the same when each was last heard

    def listened(self, t_us: float, ours: bool) -> None:
        """There was a frame on the bus at `t_us`, one of `ours` or anybody's."""
        if t_us > self._last_us:
            until_us = min(t_us, self._ours_us + MAX_GAP_US)
            if until_us > self._last_us:
                self._listened_us += until_us - self._last_us
            self._last_us = t_us
        if ours:
            self._ours_us = max(self._ours_us, t_us)

    def heard(self, sender: int) -> None:
        """The frame was of this one."""
        self._heard_us[sender] = self._listened_us

    def silent(self, sender: int, patience_us: float = SILENCE_US) -> bool:
        """Whether it was not heard for longer than `patience_us` of listening."""
        return self._listened_us > self._heard_us[sender] + patience_us
