"""All of the protocol for one configuration: drives, clocks, modes, group, and who commands them.

No I/O: frames and times go in, `out` says what is to be done. The same machine runs on a real bus,
on simulated drives in simulated time, and over a log.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import replace

from epos2_ros.configuration.driver import AxisConfig, DriverConfig
from epos2_ros.errors import ConfigurationError, TrajectoryError
from epos2_ros.motion.fit import FitAxis
from epos2_ros.motion.move import moves
from epos2_ros.motion.setpoints import SetPointAxis
from epos2_ros.motion.units import AxisUnits
from epos2_ros.protocol import epos2
from epos2_ros.protocol.drive import Drive, DriveSetup
from epos2_ros.protocol.families import FAMILIES, PROFILE, PVT, follows_by
from epos2_ros.protocol.followers import Followers
from epos2_ros.protocol.frame import Frame
from epos2_ros.protocol.group import Group
from epos2_ros.protocol.homing_methods import find
from epos2_ros.protocol.modes.homing import Homing, Search
from epos2_ros.protocol.modes.interpolated import Interpolated
from epos2_ros.protocol.modes.mode import Mode
from epos2_ros.protocol.modes.profile import Profile
from epos2_ros.protocol.modes.setpoints import SetPoints
from epos2_ros.protocol.outbox import Outbox
from epos2_ros.protocol.path import PathCommander, refuse_unreferenced
from epos2_ros.protocol.path_time import PathTime
from epos2_ros.protocol.phase import End
from epos2_ros.protocol.pvt.axis import PvtAxis
from epos2_ros.protocol.pvt.buffer_reads import BufferReads
from epos2_ros.protocol.pvt.feeder import Feeder
from epos2_ros.protocol.pvt.path_audit import patience_syncs
from epos2_ros.protocol.setpoints.axis import QueuedAxis
from epos2_ros.protocol.timekeeper import Timekeeper

SYNC_SEEN_US = 20_000.0


class Machine:
    """`fit_of(axis)`, `set_points_of(axis)`: what the search for records, or for set-points, keeps
    of a drive's limits."""

    def __init__(
        self,
        config: DriverConfig,
        fit_of: Callable[[AxisConfig], FitAxis],
        set_points_of: Callable[[AxisConfig], SetPointAxis],
    ) -> None:
        self.config = config
        self.out = Outbox()
        self.drives = [Drive(_setup(axis, config)) for axis in config.axes]
        by_joint = {drive.joint: drive for drive in self.drives}
        self.time = Timekeeper(
            [drive for drive in self.drives if drive.family.has_clock],
            len(self.drives),
            config.sync_period * 1e6,
            config.bitrate,
            self.out,
            by_joint.get(config.sync_source),
            by_joint.get(config.sync_producer),
            [drive for drive in self.drives if drive.family.life_guarding],
        )
        self.path_time = PathTime(self.time.clock, config.sync_source == "host")
        ways = {axis.joint: follows_by(axis) for axis in config.axes}
        following = tuple(axis for axis in config.axes if ways[axis.joint] != PROFILE)
        self.movers = tuple(axis for axis in config.axes if axis not in following)
        period_us = config.sync_period * 1e6
        records, queued, columns = [], [], []
        for column, axis in enumerate(following):
            drive = by_joint[axis.joint]
            if ways[axis.joint] == PVT:
                records.append(PvtAxis(drive, fit_of(axis), config.tolerance, period_us))
                columns.append(column)
            else:
                patience = patience_syncs(period_us)
                queued.append(QueuedAxis(drive, set_points_of(axis), column, patience))
        self.interpolated = self._interpolated(records, columns)
        self.set_points = SetPoints(queued, self.path_time, self._sync_within_us, self.out)
        self.followers = Followers(
            (self.interpolated, self.set_points), [by_joint[axis.joint] for axis in following]
        )
        self.profile = Profile(self.drives, self.out)
        self.homing = Homing(self.drives, self.out)
        self._homed = {
            drive: axis
            for drive, axis in zip(self.drives, config.axes, strict=True)
            if axis.homing is not None and axis.homing.method
        }
        for drive, axis in self._homed.items():
            _search(axis, drive)  # what can't be is said before anything else
        rest: dict[Drive, Mode] = dict.fromkeys(self.drives, self.profile)
        for mode in self.followers.modes:
            rest |= dict.fromkeys(mode.drives, mode)
        self.group = Group(rest, self.time, self.path_time, self.out)
        self.path = PathCommander(
            self.group,
            self.followers,
            replace(config, axes=following),
            self.move_to,
        )

    def _interpolated(self, axes: list[PvtAxis], columns: Sequence[int]) -> Interpolated:
        config = self.config
        buffer_time_ms = config.buffer_time * 1e3
        stream_ahead_ms = config.stream_ahead * 1e3
        tolerance, smoothness = config.tolerance, config.smoothness
        feeder = Feeder(axes, columns, buffer_time_ms, stream_ahead_ms, tolerance, smoothness)
        reads = BufferReads(axes)
        return Interpolated(axes, feeder, reads, self.path_time, self.out)

    def _sync_within_us(self) -> tuple[float, float]:
        """How long before and after it was seen the last SYNC may have been on the bus.

        Where an adapter gives no frames back it is not seen, but was handed over then; who has
        answered it has heard it. READING: the SYNC of a drive is seen within SYNC_SEEN_US.
        """
        late_us = self.time.seen_late_us
        if math.isfinite(late_us):
            return late_us, 0.0
        return (0.0, math.inf) if self.time.produces else (SYNC_SEEN_US, 0.0)

    # ------------------------------------------------------------------ frames and time

    def receive(self, frame: Frame, t_us: float, echo: bool = False) -> None:
        """Take in a frame from the bus; call `advance` afterwards."""
        self.group.receive(frame, t_us, echo)

    def advance(self, now_us: float) -> None:
        """Do what is due at `now_us`; `deadline_us` says when that is wanted next."""
        self.path.advance(now_us)
        self.group.advance(now_us)

    @property
    def deadline_us(self) -> float:
        return self.group.deadline_us

    # ------------------------------------------------------------------ moves

    def move_to(self, targets: Mapping[str, float], duration_s: float = 0.0) -> Future[End]:
        """Start for these positions [unit], leaving and arriving together.

        As fast as the slowest axis can, or in `duration_s` if that is longer. The future ends with
        the motion. TrajectoryError for an unknown joint, a target outside the limits, or axes that
        don't stand.
        """
        drives = {drive.joint: drive for drive in self.drives}
        refuse_unreferenced(self.config.axes, self.drives, targets)
        standing = {joint: drive.standing_qc for joint, drive in drives.items()}
        together = moves(self.config.axes, standing, targets, duration_s)
        if not self.group.standing:
            raise TrajectoryError(f"can't move: the drives are {self.group.describe_phase()}")
        self.profile.plan({drives[joint]: move for joint, move in together.items()})
        return self._begin(self.profile)

    # ------------------------------------------------------------------ homing

    def homing_orders(self) -> list[list[Drive]]:
        """The drives that are to be homed, those of the lowest order first."""
        orders: dict[int, list[Drive]] = {}
        for drive, axis in zip(self.drives, self.config.axes, strict=True):
            if axis.homing is not None and drive in self._homed:
                orders.setdefault(axis.homing.order, []).append(drive)
        return [orders[order] for order in sorted(orders)]

    def home(self, places: Sequence[int]) -> Future[End]:
        """The drives at these places look for their homes, all at once; the future ends with that.

        TrajectoryError when they don't stand.
        """
        searches = self._searches(places)
        self.homing.plan(searches)
        for drive, search in searches.items():
            self.out.announce("homing", f"{drive}: homing by {search.words} ({search.number})")
        return self._begin(self.homing)

    def home_limit_s(self, places: Sequence[int]) -> float:
        """How long `home` may take; what is longer ends in a fault."""
        return self.homing.time_limit_s(self._searches(places))

    def _searches(self, places: Sequence[int]) -> dict[Drive, Search]:
        """In the units that the drives have now."""
        drives = [self.drives[place] for place in places]
        return {drive: _search(self._homed[drive], drive) for drive in drives}

    def _begin(self, mode: Mode) -> Future[End]:
        self.group.begin([mode])
        assert self.group.motion is not None
        return self.group.motion


def _search(axis: AxisConfig, drive: Drive) -> Search:
    """ConfigurationError for what its family does not have."""
    homing, at = axis.homing, f"axes.{axis.joint}.homing"
    assert homing is not None
    methods, units = drive.family.homing_methods, AxisUnits.of(axis)
    number = find(homing.method, methods, f"{at}.method", drive.family.maker)
    name, direction = methods[number]
    if homing.back_off and not drive.family.backs_off:
        raise ConfigurationError(
            f"{at}.back_off is {homing.back_off:g}; {drive.family.maker}'s drives do not move away "
            "from where their home is, so it must be 0"
        )
    if homing.back_off and not direction:
        raise ConfigurationError(
            f"{at}.back_off is {homing.back_off:g}; by {name} nothing moves, so it must be 0"
        )

    def whole(value: float, unit: float) -> int:
        return max(1, round(abs(units.to_qc_s(value)) / unit))

    fast_slow = homing.speeds
    travel = homing.max_travel
    back_off_qc = round(-direction * abs(units.to_qc_s(homing.back_off)))
    return Search(
        number,
        name,
        None
        if fast_slow is None
        else (whole(fast_slow[0], drive.velocity_unit), whole(fast_slow[1], drive.velocity_unit)),
        None
        if homing.acceleration is None
        else whole(homing.acceleration, drive.acceleration_unit),
        math.inf if travel is None else abs(units.to_qc_s(travel)),
        drive.family.home_objects(round(units.to_qc(homing.offset)), back_off_qc),
    )


def _setup(axis: AxisConfig, config: DriverConfig) -> DriveSetup:
    family, units = FAMILIES[axis.drive], AxisUnits.of(axis)
    if axis.max_jerk is not None and not family.jerk_objects:
        raise ConfigurationError(
            f"axes.{axis.joint}.max_jerk is {axis.max_jerk:g}; {family.maker}'s drives have no "
            "limit of jerk in profile position mode: leave it out"
        )
    is_master = axis.joint == config.sync_source
    tpdos = epos2.CLOCK_MASTER_TPDO_MAPPINGS if is_master else family.tpdos
    return DriveSetup(axis.joint, axis.node_id, family, *family.motion_units(units), tpdos)
