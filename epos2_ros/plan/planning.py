"""What the driver would do with a trajectory: its own group and feeder, without a bus.

The group stands where the trajectory begins; from there on everything goes the driver's way
(path, join, feeder, fitters), so what is sent and refused is the driver's, to the last word.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from epos2_ros.bus.cia402_node import DRIVE_HEARTBEAT_MS
from epos2_ros.bus.epos2 import INHIBIT_US
from epos2_ros.bus.nodes import check
from epos2_ros.bus.settings import machine_of, set_point_axis
from epos2_ros.bus.transmitter import worst_case_bits
from epos2_ros.configuration.driver import AxisConfig, DriverConfig
from epos2_ros.motion import knots, setpoint_search
from epos2_ros.motion.limits import Limits
from epos2_ros.motion.move import refuse_trajectory
from epos2_ros.motion.record import Record
from epos2_ros.motion.reference import Reference
from epos2_ros.motion.setpoints import SetPoint, SetPointAxis, SetPointFitter
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.motion.units import AxisUnits
from epos2_ros.plan.axis import AxisPlan, RecordsPlan, SetPointsPlan
from epos2_ros.plan.outputs import OutputPlans
from epos2_ros.protocol.epos2 import POSITION_ACTUAL
from epos2_ros.protocol.families import FAMILIES, PROFILE, SET_POINTS, follows_by
from epos2_ros.protocol.modes.interpolated import Interpolated
from epos2_ros.protocol.pdo import SYNCHRONOUS
from epos2_ros.protocol.phase import Phase
from epos2_ros.protocol.pvt.buffer_reads import LEVEL_ROUND_US
from epos2_ros.protocol.setpoints.handshake import COPIES
from epos2_ros.protocol.timekeeper import CLOCK_ROUND_US, HEARTBEAT_PERIOD_US, READ_SHARE

Array = NDArray[np.float64]

SYNC_BITS, HEARTBEAT_BITS, CONTROLWORD_BITS, STAMP_BITS, PDO_BITS = map(
    worst_case_bits, (0, 1, 2, 4, 8)
)
# Its parameters in two PDOs, which are sent more than once; controlwords in which bit 4 rises and
# falls, and statuswords in which bit 12 does.
SET_POINT_BITS = 2 * COPIES * PDO_BITS + 4 * CONTROLWORD_BITS
BEFORE_PDOS = 8  # of each axis, between the trajectory and the start: SDO, controlwords


@dataclass(frozen=True)
class BusLoad:
    """Shares of the bit rate (0 … 1), stuff bits at worst."""

    sent: float  # records and set-points, on average over the motion
    others: float  # SYNC, clocks, controlwords, heartbeats, and what the drives report
    busiest: float  # all of it, in the busiest second (of a shorter motion: on average)


@dataclass(frozen=True)
class Latency:
    """From the message to the SYNC that starts the motion."""

    sent: int  # records and set-points that have to be in the drives before the start
    computing_ms: float  # join, limits and fitting until the last of them; measured here
    total_ms: float


@dataclass(frozen=True, eq=False)
class Plan:
    """A trajectory as the driver would run it, from rest."""

    trajectory: Trajectory
    config: DriverConfig
    limits: Limits
    reference: Reference
    axes: tuple[AxisPlan, ...]
    load: BusLoad
    latency: Latency
    outputs: OutputPlans
    remarks: tuple[str, ...]  # of the records

    @property
    def duration_s(self) -> float:
        return max(self.reference.end_ms, *(int(axis.knots.k[-1]) for axis in self.axes)) / 1000


def standing(trajectory: Trajectory, config: DriverConfig, start: Sequence[float]) -> list[int]:
    """The counts at which the drives stand, whole ones [qc].

    `start` [unit] is in the order of the trajectory's joints; where other joints stand does not
    matter, as long as they may stand there.
    """
    limits = Limits.of(config.axes)
    given = dict(zip(trajectory.joint_names, start, strict=True))
    positions = np.clip([axis.offset for axis in config.axes], limits.lower, limits.upper)
    return [
        round(AxisUnits.of(axis).to_qc(given.get(axis.joint, float(position))))
        for axis, position in zip(config.axes, positions, strict=True)
    ]


def make_plan(
    trajectory: Trajectory,
    config: DriverConfig,
    start: Sequence[float],
    before_compiling: Callable[[], object] = lambda: None,
) -> Plan:
    """What the driver would do with `trajectory` when its joints stand at `start` [unit].

    Raises what the driver raises: ConfigurationError for a wrong parameter, TrajectoryError for a
    trajectory that is refused. `before_compiling` is called when it is not.
    """
    for axis in config.axes:
        check(axis, config)
    beside = [axis for axis in config.axes if follows_by(axis) == PROFILE]
    refuse_trajectory(beside, trajectory.joint_names)
    whole, config = config, replace(config, axes=tuple(a for a in config.axes if a not in beside))
    machine = machine_of(config)
    starts_qc = standing(trajectory, config, start)
    for drive, start_qc in zip(machine.drives, starts_qc, strict=True):
        drive.demand_qc = start_qc
    machine.group.phase = Phase.STANDING

    begun_s = time.perf_counter()
    reference = machine.path.place(trajectory, None, 0.0).join()
    joined_s = time.perf_counter()
    before_compiling()
    knots.prepare()
    setpoint_search.prepare()
    begun_s += time.perf_counter() - joined_s
    sent: list[_Told] = []
    places = {
        axis.node_id: (axis, AxisUnits.of(axis), start_qc, reference, column)
        for column, (axis, start_qc) in enumerate(zip(config.axes, starts_qc, strict=True))
    }
    queued = [
        _Queued(place, set_point_axis(place[0], config))
        for place in places.values()
        if follows_by(place[0]) == SET_POINTS
    ]
    for one in queued:
        one.next(sent, begun_s)  # before the start each has one
    axes: dict[int, AxisPlan] = {}
    if machine.interpolated.axes:
        machine.interpolated.feeder.begin(reference)
        for node_id, records in _records(machine.interpolated, sent, begun_s).items():
            axes[node_id] = RecordsPlan(*places[node_id], *records)
    for one in queued:
        axes[one.place[0].node_id] = one.all(sent, begun_s)
    in_order = tuple(axes[axis.node_id] for axis in config.axes)
    return Plan(
        trajectory,
        config,
        Limits.of(config.axes),
        reference,
        in_order,
        _bus_load(config, in_order, sent, reference.end_ms),
        _latency(config, sent),
        OutputPlans.of(
            whole,
            {axis.config.joint: (piece.path for piece in axis.pieces()) for axis in in_order},
        ),
        tuple(machine.interpolated.feeder.remarks),
    )


class _Told(NamedTuple):
    """A record or set-point on its way to a drive."""

    at_ms: float  # path time; 0 before the start
    bits: int  # that it takes on the bus, with what the drive answers
    ready_us: float  # when it was there to be sent, before the start

    @classmethod
    def of(cls, due_ms: float, bits: int, begun_s: float) -> _Told:
        return cls(max(due_ms, 0.0), bits, (time.perf_counter() - begun_s) * 1e6)


def _records(
    interpolated: Interpolated, sent: list[_Told], begun_s: float
) -> dict[int, tuple[float, tuple[Record, ...]]]:
    """By node id the velocity unit [qc/s] of its records, and these."""
    feeder = interpolated.feeder
    by_node: dict[int, list[Record]] = {axis.drive.node_id: [] for axis in interpolated.axes}
    while (due_ms := feeder.due_ms) < math.inf:
        fed = feeder.next(due_ms)
        assert fed is not None
        follower, record = fed
        follower.send(record, due_ms)
        follower.account.assume_received()
        by_node[follower.drive.node_id].append(record)
        sent.append(_Told.of(due_ms, PDO_BITS, begun_s))
    return {
        axis.drive.node_id: (axis.fit.velocity_unit_qc_s, tuple(by_node[axis.drive.node_id]))
        for axis in interpolated.axes
    }


class _Queued:
    """One axis that follows by set-points, chosen as soon as its drive has room for another."""

    def __init__(
        self, place: tuple[AxisConfig, AxisUnits, int, Reference, int], limits: SetPointAxis
    ) -> None:
        self.place = place
        self._points: list[SetPoint] = []
        self._fitter = SetPointFitter(limits, place[4])
        self._fitter.begin(place[3], place[2])

    def next(self, sent: list[_Told], begun_s: float) -> None:
        due_ms = self._fitter.due_ms
        if (point := self._fitter.next(due_ms)) is not None:
            self._points.append(point)
            sent.append(_Told.of(due_ms, SET_POINT_BITS, begun_s))

    def all(self, sent: list[_Told], begun_s: float) -> SetPointsPlan:
        """What it is sent until it has come to rest."""
        while not self._fitter.ended:
            self.next(sent, begun_s)
        return SetPointsPlan(*self.place, self._fitter.axis, tuple(self._points))


def _bus_load(
    config: DriverConfig, axes: Sequence[AxisPlan], sent: Sequence[_Told], end_ms: int
) -> BusLoad:
    """A drive answers each SYNC by its synchronous PDOs, and gets a time stamp; it is asked now and
    then what its buffer holds (SDO, there and back), and what its clock was at a SYNC (SDO, too),
    of which no more than READ_SHARE of the bus is taken, as far as it has any. Its position comes
    once in its inhibit time where it is no such answer; what its buffer has taken, for each record
    where that is in a PDO. Before the start each is asked for both, and told by two controlwords.
    """
    count, end_s = len(axes), max(end_ms, 1) / 1000
    window_s, before = min(end_s, 1.0), count * BEFORE_PDOS
    pdos_per_s = 0.0
    for axis in axes:
        family = FAMILIES[axis.config.drive]
        status = None
        if isinstance(axis, RecordsPlan):
            assert family.pvt is not None
            status = family.pvt.status.index, family.pvt.status.subindex
            pdos_per_s += 2 * 1e6 / LEVEL_ROUND_US
        for tpdo in family.tpdos:
            if tpdo.transmission_type == SYNCHRONOUS:
                pdos_per_s += 1 / config.sync_period
            elif (POSITION_ACTUAL, 0) in tpdo.objects:
                pdos_per_s += 1e6 / INHIBIT_US[tpdo.cob_id]
            elif status in tpdo.objects:
                pdos_per_s += axis.count / end_s
    clocks = sum(FAMILIES[axis.config.drive].has_clock for axis in axes)
    reads_per_s = max(1.1 / config.sync_period, clocks * 1e6 / CLOCK_ROUND_US) if clocks else 0.0
    reads_bits_s = 2 * PDO_BITS * reads_per_s
    bits_per_s = (
        pdos_per_s * PDO_BITS
        + min(reads_bits_s, READ_SHARE * config.bitrate)
        + (SYNC_BITS + clocks * STAMP_BITS) / config.sync_period
        + HEARTBEAT_BITS * (1e6 / HEARTBEAT_PERIOD_US + count * 1e3 / DRIVE_HEARTBEAT_MS)
    )
    in_order = sorted(sent)
    at_ms = np.array([told.at_ms for told in in_order])
    until = np.searchsorted(at_ms, at_ms + 1000 * window_s, side="right")
    bits = np.concatenate(([0], np.cumsum([told.bits for told in in_order])))
    most = np.max(bits[until] - bits[:-1], initial=0)  # of them within the window
    return BusLoad(
        sent=float(bits[-1]) / end_s / config.bitrate,
        others=(before * PDO_BITS / end_s + bits_per_s) / config.bitrate,
        busiest=((float(most) + before * PDO_BITS) / window_s + bits_per_s) / config.bitrate,
    )


def _latency(config: DriverConfig, sent: Sequence[_Told]) -> Latency:
    """Each record or set-point is sent when it is worked out and the one before is through; the
    drives are asked whether they have them, one after the other; then controlwords and SYNC."""
    first = [told for told in sent if told.at_ms <= 0]
    count, us_per_bit = len(config.axes), 1e6 / config.bitrate
    through_us = ready_us = 0.0
    for told in sorted(first, key=lambda told: told.ready_us):
        through_us = max(through_us, told.ready_us) + told.bits * us_per_bit
        ready_us = told.ready_us
    start_bits = count * (3 * PDO_BITS + CONTROLWORD_BITS) + SYNC_BITS
    total_us = through_us + start_bits * us_per_bit
    return Latency(len(first), ready_us / 1000, total_us / 1000)
