"""Which path the group follows: trajectories placed on path time, replaced, stopped.

The group knows records and drives, the motion layer curves; here a trajectory's stamp meets the
group's phase. Three cases: the axes stand (the motion begins with a start SYNC), they move (the
new trajectory takes over at the end of what is committed to the drives), or the end is already
committed (the new trajectory waits for it and begins from rest).
"""

from __future__ import annotations

from concurrent.futures import Future
from typing import NamedTuple

from epos2_ros.config import DriverConfig
from epos2_ros.errors import TrajectoryError
from epos2_ros.motion.join import join
from epos2_ros.motion.limits import Limits
from epos2_ros.motion.reference import Reference
from epos2_ros.motion.stop import stop
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.motion.units import AxisUnits
from epos2_ros.protocol.group import IN_MOTION, Group, Phase

LATE_START_US = 50_000.0  # a trajectory joined midway from rest starts so much after its message


class _Waiting(NamedTuple):
    """A trajectory that begins when the axes have come to rest."""

    trajectory: Trajectory
    start_us: float | None


class PathCommander:
    """Trajectories in, references for the group out. Times are host µs."""

    def __init__(self, group: Group, config: DriverConfig) -> None:
        self._group = group
        self._config = config
        self._units = tuple(AxisUnits.of(axis) for axis in config.axes)
        self._limits = Limits.of(config.axes)
        self._waiting: _Waiting | None = None

    def submit(self, trajectory: Trajectory, start_us: float | None, now_us: float) -> None:
        """Run a trajectory whose own zero is at `start_us` (None: now).

        TrajectoryError: it is refused, and what the axes are doing goes on untouched.
        """
        if start_us is not None and start_us + trajectory.duration_s * 1e6 <= now_us:
            raise TrajectoryError(
                f"the trajectory ended {(now_us - start_us) / 1e6 - trajectory.duration_s:.3f} s "
                "ago: check header.stamp and the clocks",
                TrajectoryError.OLD_HEADER_TIMESTAMP,
            )
        group, feeder = self._group, self._group.feeder
        if group.phase is Phase.STANDING:
            self._begin(trajectory, start_us, now_us)
        elif group.phase in IN_MOTION and feeder.reference is not None:
            if feeder.ending:
                end_ms = feeder.reference.end_ms
                self._join(feeder.reference.trimmed(end_ms), trajectory, end_ms, end_ms)
                self._waiting = _Waiting(trajectory, start_us)
            else:
                self._take_over(trajectory, start_us, now_us)
        else:
            raise TrajectoryError(f"can't move: the drives are {group.describe_phase()}")

    def stop(self) -> Future[None] | None:
        """Slow down along the path from the end of what is committed; None if nothing moves."""
        self._waiting = None
        group = self._group
        if group.phase not in IN_MOTION:
            return None
        if not group.feeder.ending:
            group.replace(lambda current, at_ms: stop(current, at_ms, self._limits))
        return group.motion

    def advance(self, now_us: float) -> None:
        """Begin what waits for the axes to stand."""
        if self._waiting is None or self._group.phase in IN_MOTION:
            return
        waiting, self._waiting = self._waiting, None
        if self._group.phase is Phase.STANDING:
            try:
                self._begin(*waiting, now_us)
            except TrajectoryError as error:
                self._group.announce("aborted", str(error))

    def _begin(self, trajectory: Trajectory, start_us: float | None, now_us: float) -> None:
        """From rest, on a start SYNC: as soon as possible, at the stamp, or joined midway."""
        start_ms = 0
        if start_us is not None and start_us < now_us + LATE_START_US:
            zero_us = now_us + LATE_START_US
            start_ms, start_us = round((start_us - zero_us) / 1000), zero_us
        here = [
            unit.from_qc(float(axis.demand_qc or 0))
            for unit, axis in zip(self._units, self._group.axes, strict=True)
        ]
        rest = Reference.at_rest(self._units, here)
        self._group.begin(self._join(rest, trajectory, 0, start_ms), start_us)

    def _take_over(self, trajectory: Trajectory, start_us: float | None, now_us: float) -> None:
        zero_us = self._group.zero_us(now_us)
        start_ms = round(((now_us if start_us is None else start_us) - zero_us) / 1000)
        self._group.replace(lambda current, at_ms: self._join(current, trajectory, at_ms, start_ms))

    def _join(
        self, current: Reference, trajectory: Trajectory, at_ms: int, start_ms: int
    ) -> Reference:
        return join(
            current,
            trajectory,
            self._limits,
            at_ms=at_ms,
            start_ms=start_ms,
            start_tolerance=self._config.start_tolerance,
            allow_partial=self._config.allow_partial_joints_goal,
        )
