"""Which path the group follows: trajectories placed on path time, replaced, stopped.

The group knows records and drives, the motion layer curves; here a trajectory's stamp meets the
group's phase. Three cases: the axes stand (the motion begins with a start SYNC), they move (the
new trajectory takes over at the end of what is committed to the drives), or the end is already
committed (the new trajectory waits for it and begins from rest).
"""

from __future__ import annotations

from concurrent.futures import Future

from epos2_ros.config import DriverConfig
from epos2_ros.errors import TrajectoryError
from epos2_ros.motion.curve import Curve
from epos2_ros.motion.limits import Limits, check
from epos2_ros.motion.reference import Reference
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.motion.units import AxisUnits
from epos2_ros.protocol.group import Group


class PathCommander:
    """Trajectories in, references for the group out."""

    def __init__(self, group: Group, config: DriverConfig) -> None:
        self._group = group
        self._config = config
        self._units = tuple(AxisUnits.of(axis) for axis in config.axes)
        self._limits = Limits.of(config.axes)

    def prepare(self, trajectory: Trajectory) -> Trajectory:
        return trajectory

    def submit(self, trajectory: Trajectory, start_us: float | None, now_us: float) -> Future[None]:
        order = trajectory.axes(self._limits.joints)
        import numpy as np
        o = np.argsort(order)
        c = Curve(trajectory.times_s, trajectory.positions[:, o],
            None if trajectory.velocities is None else trajectory.velocities[:, o],
            None if trajectory.accelerations is None else trajectory.accelerations[:, o])
        check(c, self._limits)
        return self._group.begin(Reference(self._units, (c,)), start_us)

    def advance(self, now_us: float) -> None:
        pass
