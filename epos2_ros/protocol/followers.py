"""All axes that follow trajectories, in whatever modes they do: one reference for all of them.

What was committed is what any of their drives was sent; a reference that replaces another is equal
to it up to there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from epos2_ros.motion.reference import Reference
from epos2_ros.protocol.drive import Drive
from epos2_ros.protocol.modes.follower import Follower

KEPT_MS = 1000.0  # of what was commanded, for those who compare it with what is measured


class Followers:
    """`drives` in the order of a reference's columns. Path times are ms since the start SYNC."""

    def __init__(self, modes: Sequence[Follower], drives: Sequence[Drive]) -> None:
        self.modes = tuple(mode for mode in modes if mode.drives)
        self.drives = tuple(drives)
        self.reference: Reference | None = None
        self.known_from_ms = -math.inf  # from here on `reference` is what was commanded, too
        self._mode_of = {drive: mode for mode in self.modes for drive in mode.drives}

    def plan(self, reference: Reference) -> None:
        """What they begin with, from where they stand."""
        self.reference, self.known_from_ms = reference, -math.inf
        for mode in self.modes:
            mode.plan(reference)

    def replace(self, reference: Reference) -> None:
        """Go on along `reference`, equal to the current one up to the end of what is committed."""
        if self.ending:
            raise ValueError("the end of the motion is committed already")
        path_ms = max(mode.path_ms for mode in self.modes)
        self.known_from_ms = max(self.known_from_ms, path_ms - KEPT_MS)
        self.reference = reference.trimmed(int(max(self.known_from_ms, 0)))
        for mode in self.modes:
            mode.replace(self.reference)

    @property
    def committed_ms(self) -> int:
        """Path time up to which every drive has, or must get, what was committed."""
        return max((mode.committed_ms for mode in self.modes), default=0)

    @property
    def stream_take_over_ms(self) -> float:
        """By how much a streamed point takes over later than now."""
        return max((mode.stream_take_over_ms for mode in self.modes), default=0.0)

    @property
    def ending(self) -> bool:
        """Whether the end of the motion is already committed to a drive."""
        return any(mode.ending for mode in self.modes)

    def follows(self, drive: Drive) -> bool:
        """Whether it is one of them."""
        return drive in self._mode_of

    def demand(self, drive: Drive, path_ms: float) -> tuple[float, float]:
        """Position [qc] and velocity [qc/s] of a drive's demand, by what it was sent."""
        return self._mode_of[drive].demand(drive, path_ms)
