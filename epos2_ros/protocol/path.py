"""Which path the group follows: trajectories placed on path time, replaced, stopped.

The group knows records and drives, the motion layer curves; here a trajectory's stamp meets the
group's phase. Three cases: the axes stand (the motion begins with a start SYNC; one that waits
for its own is cancelled), they move (the new trajectory takes over at the end of what is
committed to the drives), or the end is already committed (the new trajectory waits for it and
begins from rest). Points of a stream follow one another so fast that one goes on from the other
also before the start.

Working out how to get onto a new trajectory can take longer than a short buffer lasts. So it is
three steps: `place` and `commit` are quick, and between them `Placement.join` computes on values
that do not change, in whatever thread. Where the drives have meanwhile been fed past the
take-over, `commit` says so, and it is placed anew.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any

import numpy as np

from epos2_ros.configuration.driver import AxisConfig, DriverConfig
from epos2_ros.errors import TrajectoryError
from epos2_ros.motion import pace
from epos2_ros.motion.join import join
from epos2_ros.motion.limits import BEYOND_POINTS, Limits
from epos2_ros.motion.reference import Motion, Reference
from epos2_ros.motion.stop import stop
from epos2_ros.motion.stream import HORIZON_S, RESUMED_S, Stream, is_streamed
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.motion.units import AxisUnits
from epos2_ros.protocol.drive import Drive
from epos2_ros.protocol.execution import Execution
from epos2_ros.protocol.followers import Followers
from epos2_ros.protocol.group import Group
from epos2_ros.protocol.phase import IN_MOTION, NOT_BEGUN, End, Phase
from epos2_ros.protocol.pvt.feeder import HOLD_MS

LATE_START_US = 50_000.0  # a trajectory joined midway from rest starts so much after its message


class Way(Enum):
    """How a trajectory begins."""

    BEGIN = "from rest"
    APPROACH = "from rest at its first point, where the axes go first"
    TAKE_OVER = "from the motion in progress"
    WAIT = "when the motion in progress has ended"


@dataclass(frozen=True)
class Placement:
    """Where on path time a trajectory is to begin, and what the axes are doing until then.

    From rest it is HOLD_MS after the start SYNC, which goes out so much before a given time.
    """

    way: Way
    trajectory: Trajectory
    stamp_us: float | None  # its own zero, in host time; None: as soon as possible
    current: Reference
    at_ms: int
    start_ms: int
    planned_start_us: float | None  # of the start SYNC
    standing_qc: tuple[int | None, ...]  # where the drives hold, when it begins from rest
    limits: Limits
    start_tolerance: float
    allow_partial: bool

    def join(self) -> Reference:
        """The way there and along it; TrajectoryError where there is none."""
        return join(
            self.current,
            self.trajectory,
            self.limits,
            at_ms=self.at_ms,
            start_ms=self.start_ms,
            start_tolerance=self.start_tolerance,
            allow_partial=self.allow_partial,
        )


def refuse_ended(trajectory: Trajectory, stamp_us: float | None, now_us: float) -> None:
    """TrajectoryError (OLD_HEADER_TIMESTAMP) when it is over; its own zero is at `stamp_us`."""
    if stamp_us is not None and stamp_us + trajectory.duration_s * 1e6 <= now_us:
        raise TrajectoryError(
            f"the trajectory ended {(now_us - stamp_us) / 1e6 - trajectory.duration_s:.3f} s "
            "ago: check header.stamp and the clocks",
            TrajectoryError.OLD_HEADER_TIMESTAMP,
        )


def refuse_unreferenced(
    axes: Sequence[AxisConfig], drives: Sequence[Drive], joints: Collection[str]
) -> None:
    """TrajectoryError for one of `joints` that has to be homed before it moves, and is not."""
    for axis, drive in zip(axes, drives, strict=True):
        must = axis.homing is not None and axis.homing.required
        if must and axis.joint in joints and not drive.homed:
            raise TrajectoryError(
                f"joint '{axis.joint}' is not referenced: home it first, by ~/home "
                f"(axes.{axis.joint}.homing.required)"
            )


class PathCommander:
    """Trajectories in, references for the axes of `followers` out. Times are host µs.

    `config` is that of these axes; `approach(targets)` begins a move to joint positions [unit].
    """

    def __init__(
        self,
        group: Group,
        followers: Followers,
        config: DriverConfig,
        approach: Callable[[Mapping[str, float]], object],
    ) -> None:
        self._approach = approach
        self._group = group
        self._followers = followers
        self._config = config
        self.axes = config.axes
        self._units = tuple(AxisUnits.of(axis) for axis in config.axes)
        self._limits = Limits.of(config.axes)
        pace.prepare()
        self._waiting: tuple[Placement, Execution] | None = None
        # What the axes follow, or hold the end of; None: neither.
        self.execution: Execution | None = None

    def submit(
        self,
        trajectory: Trajectory,
        stamp_us: float | None,
        now_us: float,
        execution: Execution | None = None,
    ) -> Execution:
        """Run a trajectory whose own zero is at `stamp_us` (None: now), all in one step.

        TrajectoryError: it is refused, and what the axes are doing goes on untouched.
        """
        execution = execution or Execution()
        placement = self.place(trajectory, stamp_us, now_us)
        self.commit(placement, placement.join(), execution)
        return execution

    def place(
        self,
        trajectory: Trajectory,
        stamp_us: float | None,
        now_us: float,
        lead_ms: int = 0,
    ) -> Placement:
        """Where it begins, by what the group is doing now; it takes over `lead_ms` after the end
        of what is committed. TrajectoryError when it can't begin."""
        streamed = is_streamed(trajectory)
        late_us = HORIZON_S * 1e6 if streamed else 0.0  # what came late is still where to go
        refuse_ended(trajectory, stamp_us, now_us - late_us)
        refuse_unreferenced(self._config.axes, self._followers.drives, trajectory.joint_names)
        group, followers = self._group, self._followers
        if group.standing and not self._streams_on(trajectory):
            return self._from_rest(trajectory, stamp_us, now_us)
        if not self._in_motion or followers.reference is None:
            raise TrajectoryError(f"can't move: the drives are {group.describe_phase()}")
        if followers.ending:
            end_ms = followers.reference.end_ms
            return self._placement(
                Way.WAIT, trajectory, stamp_us, followers.reference.trimmed(end_ms), end_ms, end_ms
            )
        start_us = now_us if stamp_us is None else stamp_us
        return self._placement(
            Way.TAKE_OVER,
            trajectory,
            stamp_us,
            followers.reference,
            self._take_over_ms(streamed, now_us, lead_ms),
            round((start_us - group.path_time.zero_us(now_us)) / 1000),
        )

    def commit(
        self, placement: Placement, reference: Reference, execution: Execution | None = None
    ) -> bool:
        """Follow `reference`, which `placement.join()` gave; False when it came too late."""
        execution = execution or Execution()
        group, followers = self._group, self._followers
        match placement.way:
            case Way.BEGIN:
                if not group.standing or placement.standing_qc != self._standing_qc():
                    return False
                followers.plan(reference)
                group.begin(followers.modes, placement.planned_start_us)
            case Way.APPROACH:
                if not group.standing or placement.standing_qc != self._standing_qc():
                    return False
                trajectory = placement.trajectory
                first = trajectory.positions[0].tolist()
                self._approach(dict(zip(trajectory.joint_names, first, strict=True)))
                self._waiting = placement, execution
                group.out.announce("waiting", "the axes first go to where the trajectory begins")
                return True
            case Way.TAKE_OVER:
                if followers.reference is not placement.current or not self._in_motion:
                    return False
                if followers.ending or followers.committed_ms > placement.at_ms:
                    return False
                followers.replace(reference)
                group.go_on(End.ARRIVED)
                if not is_streamed(placement.trajectory):
                    at_s = placement.at_ms / 1000
                    group.out.announce("replaced", f"another trajectory takes over at {at_s:.3f} s")
            case Way.WAIT:
                if not self._in_motion:
                    return False
                follows = self._waiting is not None and is_streamed(self._waiting[0].trajectory)
                quiet = follows and is_streamed(placement.trajectory)
                self.drop_waiting("another trajectory came before it began", quiet)
                self._waiting = placement, execution
                if not quiet:
                    text = "the trajectory waits for the axes to come to rest"
                    group.out.announce("waiting", text)
                return True
        if reference.remark:
            group.out.announce("warning", f"{BEYOND_POINTS}: {reference.remark}")
        self._follow(execution, placement.start_ms)
        return True

    def stop(self, reason: str = "stopped on request") -> Future[Any] | None:
        """Slow down along the path from the end of what is committed; None if nothing moves.

        What has not begun does not begin, and axes that follow no trajectory are halted. The
        future ends when the axes are at rest.
        """
        self.drop_waiting(reason)
        group, followers = self._group, self._followers
        if not group.moving:
            return group.cancel(reason) if group.motion else None
        if not self._in_motion:
            return group.halt(reason)
        if not followers.ending and followers.reference is not None:
            path = stop(followers.reference, followers.committed_ms, self._limits)
            followers.replace(path)
            group.go_on(End.STOPPED)
            if self.execution is not None:
                self.execution.stop_for(reason)
        return group.motion

    def cancel(self, execution: Execution, reason: str) -> None:
        """Stop as `stop` does, if it is this trajectory that the axes follow or wait for."""
        if self._waiting is not None and self._waiting[1] is execution:
            self.drop_waiting(reason)
        elif self.execution is execution and self._waiting is None:
            self.stop(reason)

    def disable(self) -> Future[None]:
        """Stop on the path, then switch all axes off."""
        self.stop("the drives are to be disabled")
        return self._group.disable()

    def advance(self, now_us: float) -> None:
        """Begin what waits for the axes to stand."""
        phase = self._group.phase
        if not (self._group.moving or self._group.standing):
            self.execution = None
        if self._waiting is None or phase in IN_MOTION or self._group.motion is not None:
            return
        if phase is not Phase.STANDING:
            self.drop_waiting(self._group.describe_phase())
            return
        (waiting, execution), self._waiting = self._waiting, None
        try:
            self.submit(waiting.trajectory, waiting.stamp_us, now_us, execution)
        except TrajectoryError as error:
            self._group.out.announce("aborted", str(error))
            execution.give_up(str(error))

    def _follow(self, execution: Execution, start_ms: int) -> None:
        """The group follows another trajectory from now on."""
        before, self.execution = self.execution, execution
        if before is not None:
            before.give_up("another trajectory has taken over")
        assert self._group.motion is not None
        execution.run(self._group.motion, start_ms)

    def _from_rest(
        self, trajectory: Trajectory, stamp_us: float | None, now_us: float
    ) -> Placement:
        """On a start SYNC: as soon as possible, at the stamp, or joined midway."""
        start_ms, planned_start_us = HOLD_MS, None
        if stamp_us is not None and is_streamed(trajectory):
            # As soon as possible, joined there; a stamp ahead is waited for.
            early_us = stamp_us + 1e6 * float(trajectory.times_s[0]) - now_us
            if early_us > LATE_START_US:
                planned_start_us = now_us + early_us - 1000 * HOLD_MS
            start_ms = HOLD_MS + round((stamp_us - (planned_start_us or now_us)) / 1000)
        elif stamp_us is not None:
            planned_start_us = stamp_us - 1000 * HOLD_MS
            if stamp_us < now_us + LATE_START_US:
                planned_start_us = now_us + LATE_START_US
                start_ms = round((stamp_us - planned_start_us) / 1000)
        here = [
            unit.from_qc(float(demand_qc or 0))
            for unit, demand_qc in zip(self._units, self._standing_qc(), strict=True)
        ]
        if self._config.approach and trajectory.times_s[0] <= 0 and start_ms == HOLD_MS:
            first = dict(zip(trajectory.joint_names, trajectory.positions[0].tolist(), strict=True))
            there = [first.get(unit.joint, at) for unit, at in zip(self._units, here, strict=True)]
            away = max(abs(a - b) for a, b in zip(here, there, strict=True))
            if away > self._config.start_tolerance:
                rest = Reference.at_rest(self._units, there)
                return self._placement(Way.APPROACH, trajectory, stamp_us, rest, HOLD_MS, HOLD_MS)
        rest = Reference.at_rest(self._units, here)
        if is_streamed(trajectory) and (stream := self._left(here, now_us)) is not None:
            rest = replace(rest, motions=(stream,))
        return self._placement(
            Way.BEGIN, trajectory, stamp_us, rest, HOLD_MS, start_ms, planned_start_us
        )

    def _left(self, here: Sequence[float], now_us: float) -> Stream | None:
        """The stream that the axes have come to rest at the end of, a moment ago; None: none."""
        reference = self._followers.reference
        path_ms = self._group.path_time.at_ms(now_us)
        last = None if reference is None else reference.motions[-1]
        if not isinstance(last, Stream) or path_ms is None:
            return None
        ago_s = path_ms / 1000 - last.end_s
        there = zip(self._units, here, last.target.tolist(), strict=True)
        if ago_s > RESUMED_S or any(abs(u.to_qc(a) - u.to_qc(b)) > 1 for u, a, b in there):
            return None
        return last.resumed(np.array(here), path_ms / 1000)

    def _take_over_ms(self, streamed: bool, now_us: float, lead_ms: int) -> int:
        """Path time at which what comes now takes over from the motion in progress."""
        followers = self._followers
        earliest_ms = followers.committed_ms + lead_ms
        if not streamed or not isinstance(self._governing(earliest_ms), Stream):
            return earliest_ms
        path_ms = self._group.path_time.at_ms(now_us) or 0.0
        return max(earliest_ms, round(path_ms + followers.stream_take_over_ms))

    def _governing(self, at_ms: int) -> Motion:
        reference = self._followers.reference
        assert reference is not None
        return reference.governs(at_ms)

    @property
    def _in_motion(self) -> bool:
        """Whether it is a trajectory that the axes follow, or are about to."""
        modes = self._followers.modes
        return self._group.phase in IN_MOTION and bool(modes) and self._group.modes == modes

    def _standing_qc(self) -> tuple[int | None, ...]:
        return tuple(drive.demand_qc for drive in self._followers.drives)

    def _streams_on(self, trajectory: Trajectory) -> bool:
        """Whether it is the next point of a stream whose first has not begun to move."""
        reference = self._followers.reference
        return (
            self._group.phase in NOT_BEGUN
            and self._in_motion
            and is_streamed(trajectory)
            and reference is not None
            and isinstance(reference.motions[-1], Stream)
        )

    def drop_waiting(self, reason: str, quiet: bool = False) -> None:
        """What waits for the end of the motion in progress is not going to begin; `quiet`: the
        log does not say so."""
        waiting, self._waiting = self._waiting, None
        if waiting is not None:
            text = f"cancelled before it began: {reason}"
            if not quiet:
                self._group.out.announce("cancelled", text)
            waiting[1].give_up(text)

    def _placement(
        self,
        way: Way,
        trajectory: Trajectory,
        stamp_us: float | None,
        current: Reference,
        at_ms: int,
        start_ms: int,
        planned_start_us: float | None = None,
    ) -> Placement:
        return Placement(
            way,
            trajectory,
            stamp_us,
            current,
            at_ms,
            start_ms,
            planned_start_us,
            self._standing_qc(),
            self._limits,
            self._config.start_tolerance,
            self._config.allow_partial_joints_goal,
        )
