"""Profile position mode, following: set-points lead each axis along a path (Nanotec, the chapter
"Profile Position").

The first set-point starts with "new set-point" (bit 4) in the synchronous controlword, on the same
SYNC as the axes that follow records. From then on the drive has one active and the next one queued
with "change on set-point" (bit 9), so that targets are passed without braking; when it says that
there is room for another (bit 12 falls), it gets one. A drive that gets none in time brakes to its
target by itself; then all axes stop.

What a halt leaves in the drive's queue keeps bit 12 set, and nothing can take its place. So a drive
whose set-points were not all executed is told another mode of operation and this one again before
the next motion. READING: a drive forgets its set-points when its mode is left.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence, Set
from functools import partial

from epos2_ros.motion.reference import Reference
from epos2_ros.protocol import cia402, epos2
from epos2_ros.protocol.drive import Drive, names
from epos2_ros.protocol.modes.follower import Follower
from epos2_ros.protocol.outbox import Outbox
from epos2_ros.protocol.path_time import PathTime
from epos2_ros.protocol.sdo import SdoRead, SdoWrite
from epos2_ros.protocol.setpoints.axis import STANDING_MS, QueuedAxis

ARRIVAL_MARGIN_MS = 1_000.0  # after the last set-point should be reached
REACTION_MS = 100.0  # by so much at least a standing axis is taken over later than now
OTHER_MODE = 6  # homing, in which nothing moves without bit 4
_STATUSWORD = SdoRead(epos2.STATUSWORD, 0, 2)
_DISPLAY = SdoRead(epos2.MODES_OF_OPERATION_DISPLAY, 0, 1, signed=True)


class SetPoints(Follower):
    """All `axes` follow one reference. `sync_within_us` tells how long before and after it was seen
    the last SYNC may have been."""

    operation = 1
    words = "profile position mode, following"
    start = cia402.NEW_SETPOINT | cia402.CHANGE_IMMEDIATELY
    resumes = True
    confirm_timeout_us = 200_000.0
    unconfirmed_words = "first set-point not acknowledged (bit 12) after the start SYNC"

    def __init__(
        self,
        axes: Sequence[QueuedAxis],
        path_time: PathTime,
        sync_within_us: Callable[[], tuple[float, float]],
        out: Outbox,
    ) -> None:
        super().__init__([axis.drive for axis in axes], out)
        self.axes = tuple(axes)
        self._axis_of = {axis.drive: axis for axis in axes}
        self._path_time = path_time
        self._sync_within_us = sync_within_us
        self._planned: Reference | None = None
        self._refused = ""
        self._left: set[Drive] = set()  # whose set-points may not all have been executed
        self._forgetting: set[Drive] = set()  # in another mode, for that

    def plan(self, reference: Reference) -> None:
        self._planned = reference

    # ------------------------------------------------------------------ at rest

    def rest(self, drive: Drive) -> Sequence[SdoWrite]:
        self._axis_of[drive].rest()
        if drive in self._left:
            self._left.discard(drive)
            self._forgetting.add(drive)
            self._tell_mode(drive, OTHER_MODE)
        return ()

    def _tell_mode(self, drive: Drive, mode: int) -> None:
        write = SdoWrite.integer(epos2.MODES_OF_OPERATION, 0, mode, 1, signed=True)
        self._out.ask(drive.node_id, (write,), (_DISPLAY,), partial(self._shown, drive, mode))

    def _shown(self, drive: Drive, mode: int, values: Sequence[int], error: str) -> None:
        """Its mode of operation, once it was told another."""
        if error:
            self._refused = self._refused or error
            self._forgetting.discard(drive)
        elif values[0] != mode:
            again = partial(self._shown, drive, mode)
            self._out.ask(drive.node_id, reads=(_DISPLAY,), then=again)
        elif mode == OTHER_MODE:
            self._tell_mode(drive, self.operation)
        else:
            self._forgetting.discard(drive)

    def unready(self, drive: Drive, now_us: float) -> str:
        return f"{drive} keeps its set-points" if drive in self._forgetting else ""

    def on_rest(self, drive: Drive) -> None:
        self._axis_of[drive].rest()

    # ------------------------------------------------------------------ before the start

    def begin(self) -> None:
        assert self._planned is not None
        self._refused, self.path_ms = "", 0.0
        write = SdoWrite.integer(epos2.MOTION_PROFILE_TYPE, 0, cia402.TRAPEZOIDAL, 2)
        for axis in self.axes:
            axis.begin(self._planned)
            self._out.ask(axis.drive.node_id, (write,), then=self._written)

    def _written(self, values: Sequence[int], error: str) -> None:
        self._refused = self._refused or error

    def prepare(self, now_us: float) -> bool:
        for axis in self.axes:
            if not axis.prepared:
                self._out.frames.extend(axis.prepare(now_us))
                return True
            self._out.frames.extend(axis.handshake.advance(now_us))
        return False

    def unprepared(self) -> str:
        for axis in self.axes:
            if axis.drive.node_id in self._out.unanswered or not axis.handshake.offered:
                return f"{axis}: its first set-point could not be sent"
        return ""

    def refused(self) -> str:
        return self._refused

    # ------------------------------------------------------------------ in motion

    def started(self, start_us: float) -> None:
        for axis in self.axes:
            self._left.add(axis.drive)
            axis.started(start_us, self._path_time.late_us / 1000)

    def unconfirmed(self) -> Sequence[Drive]:
        return [axis.drive for axis in self.axes if not axis.has_started]

    def advance(self, path_ms: float, now_us: float) -> str:
        self.path_ms = path_ms
        for axis in self.axes:
            self._out.frames.extend(axis.advance(path_ms, now_us))
            if wrong := axis.missed(path_ms):
                return f"{axis}: {wrong}"
            if axis.asks(path_ms, now_us):
                self._out.ask(axis.drive.node_id, reads=(_STATUSWORD,))
        late = [axis.drive for axis in self.axes if self._late(axis, path_ms)]
        return f"target not reached by {names(late)}" if late else ""

    def _late(self, axis: QueuedAxis, path_ms: float) -> bool:
        overdue = axis.over and path_ms > axis.ends_ms + ARRIVAL_MARGIN_MS
        return overdue and not self._at_rest(axis)

    def due_ms(self) -> float:
        return min(axis.due_ms(self._path_time.at_ms) for axis in self.axes)

    def arrived(self) -> bool:
        return all(axis.over and self._at_rest(axis) for axis in self.axes)

    def _at_rest(self, axis: QueuedAxis) -> bool:
        """Whether the drive has said so since it should be there."""
        drive = axis.drive
        told_ms = self._path_time.at_ms(drive.statusword_us)
        reached = bool(drive.statusword & cia402.TARGET_REACHED)
        return reached and told_ms is not None and told_ms >= axis.ends_ms

    def finish(self) -> None:
        self._left.clear()
        text = ", ".join(f"{axis} {axis.error_qc:.0f} counts" for axis in self.axes)
        self._out.announce("followed", f"set-points led at most so far beside the path: {text}")

    # ------------------------------------------------------------------ what they follow

    def replace(self, reference: Reference) -> None:
        for axis in self.axes:
            axis.replace(reference)

    @property
    def committed_ms(self) -> int:
        least_ms = self.path_ms + REACTION_MS
        return math.ceil(max(least_ms, *(axis.committed_ms for axis in self.axes)))

    @property
    def stream_take_over_ms(self) -> float:
        longest_ms = max(axis.stream_longest_ms for axis in self.axes)
        return REACTION_MS + 2 * longest_ms + STANDING_MS

    @property
    def ending(self) -> bool:
        return any(axis.ended for axis in self.axes)

    def demand(self, drive: Drive, path_ms: float) -> tuple[float, float]:
        return self._axis_of[drive].demand(path_ms)

    # ------------------------------------------------------------------ what was on the bus

    def on_report(self, drive: Drive, reported: Set[tuple[int, int]], t_us: float) -> str:
        axis = self._axis_of[drive]
        if (epos2.STATUSWORD, 0) in reported:
            if axis.handshake.acknowledged:
                self._left.add(drive)
            self._out.frames.extend(axis.on_statusword(t_us, self._path_time.at_ms(t_us)))
        if (epos2.POSITION_DEMAND, 0) in reported and drive.demand_qc is not None:
            return axis.audit.on_demand(drive.demand_qc, self._path_time.at_ms(t_us))
        return ""

    def on_answer(self, drive: Drive, data: bytes, t_us: float) -> str:
        statusword = _STATUSWORD.answered(data)
        if statusword is not None:
            drive.report(statusword, t_us)
            path_ms = self._path_time.at_ms(t_us)
            self._out.frames.extend(self._axis_of[drive].on_statusword(t_us, path_ms))
        return ""

    def on_sync(self, drive: Drive, t_us: float, starts: bool) -> str:
        before_us, after_us = (0.0, 0.0) if starts else self._sync_within_us()
        at_ms = self._path_time.at_ms(t_us)
        within_ms = None if at_ms is None else (at_ms - before_us / 1000, at_ms + after_us / 1000)
        return self._axis_of[drive].audit.on_sync(within_ms)

    def on_echo(self, drive: Drive, data: bytes, t_us: float) -> None:
        self._axis_of[drive].handshake.on_echo(data)
