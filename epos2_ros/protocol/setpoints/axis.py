"""One axis that follows a path by set-points: which one its drive gets next, and by when.

Plans are in the drive's own time, which begins when it leaves from rest; by how much that is late
on the path's the audit says, and the next set-point is chosen for it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from epos2_ros.motion.reference import Reference
from epos2_ros.motion.setpoints import SetPoint, SetPointAxis, SetPointFitter
from epos2_ros.motion.stream import Stream
from epos2_ros.protocol import cia402
from epos2_ros.protocol.drive import Drive
from epos2_ros.protocol.frame import Frame
from epos2_ros.protocol.setpoints.audit import Audit
from epos2_ros.protocol.setpoints.handshake import RESEND_US, Handshake, Step

STANDING_MS = 10.0  # set-points from rest begin at multiples of this
STREAM_LONGEST = 1.5  # times what feeding takes: a stream's points are only a moment ahead
LATE_MS = 20.0  # by so much at most one from rest may begin late
_UNHEARD_MS = 5.0  # after its set-point should have begun a drive has said that there is room
_SOON_MS, _STEP_MS = 100.0, 5.0  # how far ahead, beside, it is looked for motion, and how closely
_RELOCATED_MS = 0.2  # of being late: less is not worth choosing anew for


@dataclass(frozen=True, eq=False)
class _Late:
    """A reference as a drive has to follow it that is `by_ms` late."""

    reference: Reference
    by_ms: float

    @property
    def end_ms(self) -> int:
        return max(0, math.ceil(self.reference.end_ms - self.by_ms))

    def positions(self, k: NDArray[np.int64]) -> NDArray[np.float64]:
        """[m] times [ms] → [m, axes] positions [qc]."""
        return self.reference.positions_at(k.astype(np.float64) + self.by_ms)


class QueuedAxis:
    """A drive with the set-points it was given. Path times are ms since the start SYNC."""

    def __init__(self, drive: Drive, limits: SetPointAxis, column: int, patience: int) -> None:
        self.drive = drive
        self.handshake = Handshake(drive)
        self.audit = Audit(patience)
        self._limits = limits
        self._fitter = SetPointFitter(limits, column)
        self._longest_ms = self._fitter.longest_ms
        self._rest()

    def __str__(self) -> str:
        return str(self.drive)

    def _rest(self) -> None:
        self._reference: Reference | None = None
        self._next: SetPoint | None = None  # chosen, and not yet begun to be given
        self._given: SetPoint | None = None  # the last that the drive was given, or is being
        self._taken: SetPoint | None = None  # the last that it has taken
        self._brakes_ms = math.inf  # when it brakes for that without another, on its plan
        self._given_brakes_ms = math.inf  # likewise for the last that it was given
        self._look_ms = -math.inf  # when it is looked for the next
        self._used_ms = 0.0  # how late the drive was taken to be
        self._asked_us = -math.inf  # when its statusword was last asked for
        self.count = 0  # of set-points that the drive has taken

    @property
    def standing_qc(self) -> int:
        return self.drive.demand_qc or 0

    @property
    def error_qc(self) -> float:
        """The largest distance of what it is told from the commanded curve, so far."""
        return self._fitter.error_qc

    def rest(self) -> None:
        """It stands, and its drive has no set-point."""
        self._rest()
        self.handshake.rest()
        self.audit.rest(self.standing_qc)

    # ------------------------------------------------------------------ what it follows

    def begin(self, reference: Reference) -> None:
        """A new motion, from where it stands."""
        self.rest()
        self.drive.demand = None
        drive = self.drive
        self._fitter.axis = replace(
            self._limits,
            velocity_unit_qc_s=drive.velocity_unit,
            acceleration_unit_qc_s2=drive.acceleration_unit,
        )
        self._reference = reference
        self._fitter.longest_ms = self._longest(reference)
        self._fitter.begin(reference, self.standing_qc)

    def replace(self, reference: Reference) -> None:
        """Go on along `reference`, equal to the current one up to the end of what is committed."""
        self._reference = reference
        self._fitter.longest_ms = self._longest(reference)
        self._fitter.replace(_Late(reference, self._used_ms))
        self._look_ms = -math.inf

    def _longest(self, reference: Reference) -> int:
        streamed = isinstance(reference.motions[-1], Stream)
        return self.stream_longest_ms if streamed else self._longest_ms

    @property
    def stream_longest_ms(self) -> int:
        """Of set-points of a stream."""
        return round(STREAM_LONGEST * self._limits.feeding_ms)

    @property
    def committed_ms(self) -> float:
        """Path time at which what the drive was given ends, or up to which it stands."""
        return self._fitter.committed_ms + max(0.0, self._used_ms)

    @property
    def ended(self) -> bool:
        """Whether it has nothing to do any more."""
        return self._fitter.ended

    def demand(self, path_ms: float) -> tuple[float, float]:
        """Position [qc] and velocity [qc/s] of the drive's demand at a path time."""
        position, velocity = self.audit.path.at(path_ms - self.audit.late_ms)
        return position, velocity * 1000

    # ------------------------------------------------------------------ before the start

    def prepare(self, now_us: float) -> Sequence[Frame]:
        """What the drive gets before the start: the first set-point, or one to where it stands.

        The latter takes the place of whatever it was doing when it was halted.
        """
        first = None
        if not self._goes_on_standing(0.0, self.standing_qc):
            first = self._fitter.next()
        if first is not None and first.begin_ms > 0:
            first, self._next = None, first
        if first is None:
            most = self._limits
            first = SetPoint(
                0,
                0,
                self.standing_qc,
                max(1, int(most.max_velocity_qc_s / self.drive.velocity_unit)),
                max(1, int(most.max_acceleration_qc_s2 / self.drive.acceleration_unit)),
                max(1, int(most.max_acceleration_qc_s2 / self.drive.acceleration_unit)),
                False,
            )
        self._give(first)
        return self.handshake.offer(first, cia402.CHANGE_IMMEDIATELY, now_us, math.inf)

    @property
    def prepared(self) -> bool:
        """Whether `prepare` was called."""
        return self._given is not None

    def started(self, now_us: float, seen_late_ms: float) -> None:
        """The start SYNC was on the bus, and may have been seen so late."""
        self.handshake.raised(now_us)
        self.audit.begin(0.0, -seen_late_ms, 0.0)

    @property
    def has_started(self) -> bool:
        """Whether the drive has taken its first set-point."""
        return self._taken is not None

    # ------------------------------------------------------------------ in motion

    def advance(self, path_ms: float, now_us: float) -> Sequence[Frame]:
        """What the drive is told now."""
        handshake = self.handshake
        offered = handshake.step is Step.OFFERED
        frames = list(handshake.advance(now_us))
        if offered and handshake.step is Step.RAISED and not self._queued:
            assert self._given is not None
            late_ms = path_ms - self._given.begin_ms
            self.audit.begin(path_ms, late_ms, late_ms)
        if self._room_unheard(path_ms) and now_us >= self._asked_us + RESEND_US:
            frames += handshake.lower(now_us)
        if handshake.step is not Step.FREE or self._taken is None:
            return frames
        if self._next is None and path_ms >= self._look_ms and not self._fitter.ended:
            self._choose(path_ms)
        found, self._next = self._next, None
        if found is not None:
            bits = cia402.CHANGE_ON_SETPOINT if self._taken.passes else 0
            begin_us = now_us + (found.begin_ms - path_ms) * 1000
            self._give(found)
            raise_us = -math.inf if self._queued else begin_us
            frames += handshake.offer(found, bits, now_us, raise_us)
        return frames

    @property
    def _queued(self) -> bool:
        """Whether what the drive is being given begins where the one before ends."""
        given, taken = self._given, self._taken
        assert given is not None
        return taken is not None and given.begin_ms <= taken.end_ms

    def _choose(self, path_ms: float) -> None:
        reference, taken = self._reference, self._taken
        assert reference is not None and taken is not None
        self._look_ms = path_ms + STANDING_MS
        if not taken.passes and self._goes_on_standing(path_ms, taken.target_qc):
            return
        late_ms = self.audit.late_ms if taken.passes else 0.0
        if abs(late_ms - self._used_ms) > _RELOCATED_MS or (self._used_ms and not taken.passes):
            self._used_ms = late_ms
            self._fitter.replace(_Late(reference, late_ms))
        self._next = self._fitter.next(path_ms - self._used_ms)

    def _goes_on_standing(self, path_ms: float, at_qc: int) -> bool:
        """Whether nothing is to be chosen yet for an axis that stands, or will: what is not chosen
        another reference may still take the place of."""
        reference = self._reference
        assert reference is not None
        if path_ms >= reference.end_ms:
            return False
        until_ms = path_ms + self._limits.feeding_ms + _SOON_MS
        k = np.arange(math.floor(path_ms), until_ms, _STEP_MS).astype(np.int64)
        positions = reference.positions(k)[:, self._fitter.column]
        return bool(np.abs(positions - at_qc).max() < 0.5)

    def _give(self, set_point: SetPoint) -> None:
        drive = self.drive
        self._given = set_point
        self._given_brakes_ms = self.audit.add(
            set_point, drive.velocity_unit, drive.acceleration_unit
        )

    def missed(self, path_ms: float) -> str:
        """What the drive has not taken in time, or ""."""
        if path_ms <= self._deadline_ms:
            return ""
        if self.handshake.step is Step.TAKEN and math.isfinite(self._asked_us):
            return "its queue of set-points is not free in time (bit 12 stays set)"
        if self.handshake.step is Step.RAISED:
            return "a set-point was not acknowledged in time (bit 12 stays clear)"
        return "it was given no further set-point in time: the host was late"

    @property
    def _deadline_ms(self) -> float:
        """Path time by which the drive has to have taken another set-point."""
        given, taken, late_ms = self._given, self._taken, self.audit.late_ms
        if taken is None or given is None:
            return math.inf
        if taken.passes:
            return self._brakes_ms + late_ms + 1.0
        return math.inf if given is taken else given.begin_ms + max(0.0, late_ms) + LATE_MS

    def _room_unheard(self, path_ms: float) -> bool:
        """Whether its queue should be free, and it has not said so."""
        given = self._given
        if self.handshake.step is not Step.TAKEN or given is None:
            return False
        return path_ms > given.begin_ms + self.audit.late_ms + _UNHEARD_MS

    def asks(self, path_ms: float, now_us: float) -> bool:
        """Whether the drive is to be asked for its statusword: what it had to say was lost."""
        if now_us < self._asked_us + RESEND_US:
            return False
        if not (self.handshake.unanswered(now_us) or self._room_unheard(path_ms)):
            return False
        self._asked_us = now_us
        return True

    def due_ms(self, at_ms: Callable[[float], float | None]) -> float:
        """Path time at which `advance` is wanted next; `at_ms` gives it of a host time."""
        handshake, due_ms = self.handshake, self._deadline_ms
        if handshake.step is Step.FREE and not self._fitter.ended:
            due_ms = min(due_ms, self._look_ms)
        due_us = handshake.due_us
        if handshake.step is Step.RAISED:
            due_us = min(due_us, max(due_us - RESEND_US / 2, self._asked_us + RESEND_US))
        if handshake.step is Step.TAKEN and self._given is not None:
            room_ms = self._given.begin_ms + self.audit.late_ms + _UNHEARD_MS
            again_ms = at_ms(self._asked_us + RESEND_US) if math.isfinite(self._asked_us) else None
            due_ms = min(due_ms, max(room_ms, again_ms or room_ms) + 0.01)
        if math.isfinite(due_us):
            due_ms = min(due_ms, at_ms(due_us) or due_ms)
        return due_ms

    @property
    def over(self) -> bool:
        """Whether the drive has taken all that it was to do."""
        return self._fitter.ended and self._next is None and self.handshake.step is Step.FREE

    @property
    def ends_ms(self) -> float:
        """Path time at which it is to rest at the last target."""
        return 0.0 if self._taken is None else self._taken.end_ms + self.audit.late_ms

    # ------------------------------------------------------------------ what was on the bus

    def on_statusword(self, now_us: float, path_ms: float | None) -> Sequence[Frame]:
        """The drive has told its statusword."""
        before = self.handshake.step
        frames = self.handshake.on_statusword(now_us)
        if before is Step.RAISED and self.handshake.step is Step.TAKEN:
            if path_ms is not None and self._given is not None and not self._queued:
                self.audit.has_begun(path_ms - self._given.begin_ms)
            self._taken, self._brakes_ms = self._given, self._given_brakes_ms
            self.count += 1
            self._asked_us = -math.inf
        return frames
