"""Which record goes to which drive, and when: the fitter on one side, the books on the other.

A path begins with a record that holds the position for HOLD_MS, and references begin after it.
READING: no text says whether the first record is the end of a segment or only the point where the
path starts. Either way the drive stays where it is; if it is only the starting point everything is
HOLD_MS early, in all drives alike.

3.6.3 of the application note asks for two records in the FIFO and leaves open whether the executing
segment counts. So what a buffer is good for is its *reserve*: for how long two records remain in it
besides the one in execution. A record is sent when that gets less than `buffer_time_ms` without
MARGIN_MS, or, however short that is, when fewer than three are left: a host that stalls for 100 ms
less than the buffer time changes nothing. Nothing is sent that time does not leave room for.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from epos2_ros.errors import TrajectoryError
from epos2_ros.motion.fit import Fitter
from epos2_ros.motion.record import MAX_SEGMENT_MS, Record
from epos2_ros.motion.reference import Columns, Reference
from epos2_ros.motion.stream import Stream
from epos2_ros.protocol.pvt.axis import PvtAxis
from epos2_ros.protocol.pvt.buffer_account import BufferAccount

HOLD_MS = 1
MIN_RECORDS = 2  # in the FIFO besides the one in execution, or it underflows
MIN_RECORDS_AHEAD = 3  # so that two remain when the next segment begins
MARGIN_MS = 80.0  # less than 100 by what a host needs to send after its stall
SHARE = 4  # of the buffer time is the longest segment: this bounds what is committed
SPARE_RECORDS = 4  # of a buffer, that are never used
STREAM_SEGMENT_MS = 16
"""Longest segment of a stream: its points are a moment ahead, and what is committed is lag."""

_SLACK_QC = 1e-6

class Feeder:
    """Feeds the buffers of `axes` along a reference. Path times are ms since the start SYNC.

    `columns`: the axes' places in references.
    """

    def __init__(
        self,
        axes: Sequence[PvtAxis],
        columns: Sequence[int],
        buffer_time_ms: float,
        stream_ahead_ms: float,
        tolerance_qc: float,
        smoothness: float,
    ) -> None:
        self.reference: Reference | None = None
        self.known_from_ms = -math.inf  # from here on `reference` is what was commanded, too
        self.remarks: list[str] = []  # what a user should know of the motion and has not been told
        self._path_ms = 0.0
        self._tolerance_qc = tolerance_qc
        self._strayed: set[int] = set()  # axes of which it was said that they can't keep it
        self._axes = axes
        self._columns = tuple(columns)
        self._buffer_time_ms = buffer_time_ms
        self._stream_ahead_ms = min(stream_ahead_ms, buffer_time_ms)
        self._ahead_ms = self._reserve_ms = 0.0  # by which the drives have motion, and two records
        self._fitter = Fitter([axis.fit for axis in axes], tolerance_qc, smoothness=smoothness)

    def begin(self, reference: Reference) -> None:
        """A new motion, from where the drives stand."""
        self._follow(reference)
        self.remarks.clear()
        self._strayed.clear()
        self._fitter.begin(self._own(reference), [axis.standing_qc for axis in self._axes], HOLD_MS)
        for axis in self._axes:
            axis.begin()

    def replace(self, reference: Reference) -> None:
        """Go on along `reference`, equal to the current one up to the end of what is committed."""
        if self.ending:
            raise ValueError("the end of the motion is committed already")
        earliest = min(axis.account.committed_ms for axis in self._axes)
        self._follow(reference)
        self._fitter.replace(self._own(reference.trimmed(earliest)))

    def _own(self, reference: Reference) -> Columns:
        return Columns(reference, self._columns)

    def _follow(self, reference: Reference) -> None:
        streamed = isinstance(reference.motions[-1], Stream)
        if streamed:
            self._ahead_ms, self._reserve_ms = self._stream_ahead_ms, 0.0
            longest: float = STREAM_SEGMENT_MS
        else:
            self._ahead_ms = 0.0
            self._reserve_ms = max(self._buffer_time_ms - MARGIN_MS, 0.0)
            longest = self._buffer_time_ms // SHARE
        self._fitter.max_segment_ms = int(min(MAX_SEGMENT_MS, max(4, longest)))

    @property
    def committed_ms(self) -> int:
        """Path time up to which every drive has, or must get, records of what was committed."""
        return max(axis.account.committed_ms for axis in self._axes)

    @property
    def stream_take_over_ms(self) -> float:
        """By how much a streamed point takes over later than now: always the same, so that evenly
        sent points begin evenly."""
        return self._stream_ahead_ms + STREAM_SEGMENT_MS

    @property
    def ending(self) -> bool:
        """Whether the end of the motion is already committed to a drive."""
        return any(axis.account.ended for axis in self._axes)

    @property
    def due_ms(self) -> float:
        """Path time at which some axis takes its next record; inf when all have ended."""
        return min((self._due_ms(axis.account) for axis in self._axes), default=math.inf)

    def next(self, path_ms: float) -> tuple[PvtAxis, Record] | None:
        """One record for the axis that needs it most, to be sent; None if none needs any.

        One at a time, so that between records whoever calls looks at the bus. TrajectoryError
        when the reference can't be followed within tolerance and limits.
        """
        if self.due_ms > path_ms:
            return None
        index, axis = min(
            enumerate(self._axes),
            key=lambda candidate: self._due_ms(candidate[1].account),
        )
        record = self._next_record(index, axis)
        if record is None:
            return None
        axis.account.note_reserve(path_ms)
        return axis, record

    def _next_record(self, index: int, axis: PvtAxis) -> Record | None:
        if not axis.account.sent:
            return Record(axis.standing_qc, 0, HOLD_MS)
        from_ms = self._fitter.committed_ms(index)
        try:
            record = self._fitter.next(index)
        except TrajectoryError as error:
            raise TrajectoryError(f"{axis}: {error}") from error
        off_qc = self._fitter.off_qc(index)
        if off_qc > self._tolerance_qc + _SLACK_QC and index not in self._strayed:
            self._strayed.add(index)
            self.remarks.append(
                f"{axis} is {off_qc:.3g} qc off the commanded path at {from_ms / 1000:.3f} s, "
                f"ipm.tolerance is {self._tolerance_qc:g} qc: no segment of whole counts and "
                "velocity units within its limits is nearer"
            )
        return record

    def _due_ms(self, account: BufferAccount) -> float:
        if account.ended or account.blocked:
            return math.inf
        due = min(
            account.committed_ms - self._ahead_ms,
            account.leaves_ms(MIN_RECORDS) - self._reserve_ms,
            account.leaves_ms(MIN_RECORDS_AHEAD),
        )
        return max(due, account.leaves_ms(account.size - SPARE_RECORDS))
