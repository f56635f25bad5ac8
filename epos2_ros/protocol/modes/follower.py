"""What modes have in common whose axes follow a reference, which may be replaced on the way."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence

from epos2_ros.motion.reference import Reference
from epos2_ros.protocol.drive import Drive
from epos2_ros.protocol.modes.mode import Mode
from epos2_ros.protocol.outbox import Outbox


class Follower(Mode):
    """References have columns for all axes that follow one, in whatever modes they do.

    Path times are ms since the start SYNC.
    """

    def __init__(self, drives: Sequence[Drive], out: Outbox) -> None:
        super().__init__(drives, out)
        self.path_ms = 0.0  # when it was last advanced

    @abstractmethod
    def plan(self, reference: Reference) -> None:
        """What `begin` begins, from where the axes stand."""

    @abstractmethod
    def replace(self, reference: Reference) -> None:
        """Go on along `reference`, equal to the current one up to the end of what is committed."""

    @property
    @abstractmethod
    def committed_ms(self) -> int:
        """Path time up to which every drive has, or must get, what was committed."""

    @property
    @abstractmethod
    def stream_take_over_ms(self) -> float:
        """By how much a streamed point takes over later than now: always the same, so that evenly
        sent points begin evenly."""

    @property
    @abstractmethod
    def ending(self) -> bool:
        """Whether the end of the motion is already committed to a drive."""

    @abstractmethod
    def demand(self, drive: Drive, path_ms: float) -> tuple[float, float]:
        """Position [qc] and velocity [qc/s] of a drive's demand, by what it was sent."""
