"""Whether a drive executes the set-points it was given, looked at at every SYNC.

The drive answers each SYNC with its position demand (TPDO3). It has no clock that could be read or
set, and begins each set-point by itself, in a control cycle of its own; so where it is on its plan
is what its answers say: it is *late* by so much. At the start that is within START_MS, and from one
answer to the next it changes by no more than DRIFT of the time (two quartzes), a cycle for each
set-point that has begun since, and JITTER_MS. (READING: no text says in which cycle exactly a drive
goes over to the next. It may have left from between two counts, so the first target is reached half
a count earlier or later than planned.) What it tells is from its last cycle, at any time of one.
Every answer has to fit that, within ROUNDING_QC: what does not is off the path, by a set-point that
was lost, altered or not executed as it was told.

So nothing accumulates: how late the drive is is known from every answer at speed, and the next
set-point is chosen for where the commanded curve will be by then.

When a SYNC was is known between when it was handed over and when the host saw it, or the answer.
One without an answer may be the one that the next answer belongs to: after it one that misfits is
let pass.
"""

from __future__ import annotations

import math
from collections import deque

from epos2_ros.motion.setpoints import SetPoint
from epos2_ros.protocol.setpoints.profile_path import ProfilePath

START_MS = 2.0  # of the start, before or after its SYNC: a cycle each way, and one to spare
CYCLE_MS = 1.0
DRIFT = 200e-6
JITTER_MS = 0.1
ROUNDING_QC = 1.0  # the demand in whole counts, rounded or cut off
MOST_LATE_MS = 100.0  # a drive that is so much late by and by does not keep the units it was told
_STEP_MS = 0.25  # at which the path is looked at


class Audit:
    """Of one drive. `patience`: so many SYNCs in a row may go unanswered."""

    def __init__(self, patience: int) -> None:
        self._patience = patience
        self.rest(0)

    def rest(self, position_qc: int) -> None:
        """The drive stands there, and has no set-point."""
        self._standing_qc: int | None = position_qc
        self.path = ProfilePath(position_qc)
        self._least_ms = self._most_ms = 0.0  # by which it can be late
        self.late_ms = 0.0  # by which it is, as far as is known
        self._judged_ms = 0.0  # path time of the last SYNC whose answer fitted, or of the start
        self._begins: deque[tuple[float, float]] = deque()  # of set-points: when, and how unsure
        self._unsure_ms = 0.0  # by those that have begun since
        self._from_rest = True  # the last set-point began so
        self._unanswered = 0
        self._sync_ms = 0.0, 0.0  # path time of the last SYNC, from and to

    def begin(self, path_ms: float, least_ms: float, most_ms: float) -> None:
        """It leaves from rest at this path time, so much after its plan."""
        self._standing_qc = None
        self._least_ms, self._most_ms = least_ms - START_MS, most_ms + START_MS
        self.late_ms, self._judged_ms = most_ms, path_ms

    def has_begun(self, late_ms: float) -> None:
        """It has told that it has left: no later than so much after its plan."""
        self._most_ms = max(self._most_ms, late_ms + START_MS)

    def add(
        self, set_point: SetPoint, velocity_unit_qc_s: float, acceleration_unit_qc_s2: float
    ) -> float:
        """It is given one more; `ProfilePath.add`."""
        unsure_ms, speed = CYCLE_MS, abs(self.path.at(set_point.begin_ms)[1])
        if self._from_rest and speed:
            unsure_ms += ROUNDING_QC / 2 / speed  # it may have stood between two counts
        self._from_rest = not speed
        self._begins.append((set_point.begin_ms, unsure_ms))
        return self.path.add(set_point, velocity_unit_qc_s, acceleration_unit_qc_s2)

    def on_sync(self, within_ms: tuple[float, float] | None) -> str:
        """A SYNC was on the bus, from and to when on the path; what is wrong, or ""."""
        if within_ms is not None:
            self._sync_ms = within_ms
        self._unanswered += 1
        if self._unanswered <= self._patience:
            return ""
        return f"{self._patience} SYNCs in a row without its position demand"

    def on_demand(self, demand_qc: int, path_ms: float | None) -> str:
        """The position demand at the last SYNC, told at this path time; what is wrong, or ""."""
        answers_last = self._unanswered == 1
        if path_ms is not None:
            self._sync_ms = self._sync_ms[0], max(min(self._sync_ms[1], path_ms), self._sync_ms[0])
        if self._standing_qc is not None:
            off_qc = demand_qc - self._standing_qc
            if abs(off_qc) > ROUNDING_QC and answers_last:
                return f"its demand has moved by {off_qc} qc while it was to stand"
        elif not self._fits(demand_qc) and answers_last:
            path_ms = self._sync_ms[1] - self.late_ms
            off_qc = round(abs(demand_qc - self.path.at(path_ms)[0]))
            return (
                f"its demand is {off_qc} qc off its path: a set-point was lost, altered or not "
                "executed as it was told"
            )
        self._unanswered = 0
        if abs(self.late_ms) > MOST_LATE_MS:
            return f"it is {self.late_ms:+.0f} ms late: its units are other than it says"
        return ""

    def _fits(self, demand_qc: int) -> bool:
        """Whether it can be there; by how much it can be late is known better then."""
        from_ms, to_ms = self._sync_ms
        passed_ms = max(0.0, to_ms - self._judged_ms)
        while self._begins and self._begins[0][0] <= to_ms - self._least_ms:
            self._unsure_ms += self._begins.popleft()[1]
        play_ms = JITTER_MS + DRIFT * passed_ms + self._unsure_ms
        least_ms, most_ms = self._least_ms - play_ms, self._most_ms + play_ms
        first_ms, last_ms = from_ms - CYCLE_MS - most_ms, to_ms - least_ms
        steps = max(1, math.ceil((last_ms - first_ms) / _STEP_MS))
        times = [first_ms + (last_ms - first_ms) * i / steps for i in range(steps + 1)]
        places = [self.path.at(t_ms)[0] - demand_qc for t_ms in times]
        fitting = [
            i
            for i in range(steps)
            if min(places[i : i + 2]) <= ROUNDING_QC and max(places[i : i + 2]) >= -ROUNDING_QC
        ]
        if not fitting:
            return False
        self._least_ms = max(least_ms, from_ms - CYCLE_MS - times[fitting[-1] + 1])
        self._most_ms = min(most_ms, to_ms - times[fitting[0]])
        self._judged_ms, self._unsure_ms = to_ms, 0.0
        # What it was, where that is still possible: else no further than it must be.
        self.late_ms = min(max(self.late_ms, self._least_ms), self._most_ms)
        self.path.forget(times[0])
        return True
