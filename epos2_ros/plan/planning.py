"""What the driver would do with a trajectory: its own group and feeder, without a bus.

The group stands where the trajectory begins; from there on everything goes the driver's way
(path, join, feeder, fitter), so records and refusals are the driver's, to the last word.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from epos2_ros.bus.cia402_node import DRIVE_HEARTBEAT_MS
from epos2_ros.bus.epos2 import INHIBIT_US
from epos2_ros.bus.nodes import check
from epos2_ros.bus.settings import machine_of
from epos2_ros.bus.transmitter import worst_case_bits
from epos2_ros.configuration.driver import AxisConfig, DriverConfig
from epos2_ros.motion import knots
from epos2_ros.motion.crossings import Path
from epos2_ros.motion.limits import Limits
from epos2_ros.motion.move import refuse_trajectory
from epos2_ros.motion.pvt import Executed, executed, segments
from epos2_ros.motion.record import Record
from epos2_ros.motion.reference import Reference
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.motion.units import AxisUnits
from epos2_ros.plan.outputs import OutputPlans
from epos2_ros.protocol.epos2 import POSITION_ACTUAL, RPDO1
from epos2_ros.protocol.families import FAMILIES, follows_records
from epos2_ros.protocol.frame import Frame
from epos2_ros.protocol.pdo import SYNCHRONOUS
from epos2_ros.protocol.phase import Phase
from epos2_ros.protocol.pvt.buffer_reads import LEVEL_ROUND_US
from epos2_ros.protocol.timekeeper import CLOCK_ROUND_US, HEARTBEAT_PERIOD_US, READ_SHARE

Array = NDArray[np.float64]
PIECE_MS = 1 << 17  # looked at in one piece

SYNC_BITS, HEARTBEAT_BITS, CONTROLWORD_BITS, STAMP_BITS, PDO_BITS = map(
    worst_case_bits, (0, 1, 2, 4, 8)
)
BEFORE_PDOS = 8  # of each axis, between the trajectory and the start: SDO, controlwords


class Piece(NamedTuple):
    """A part of the motion of one axis; it begins with the millisecond that ended the last."""

    k: NDArray[np.int64]  # path time [ms]
    executed: Executed
    error_qc: Array  # executed less commanded position

    @property
    def path(self) -> Path:
        """What its drive executes."""
        position = self.executed.position_qc.astype(np.float64)
        velocity = self.executed.velocity_qc_s.astype(np.float64)
        return Path(1000.0 * self.k.astype(np.float64), position, velocity)


@dataclass(frozen=True, eq=False)
class AxisPlan:
    """The records of one axis, and what its drive makes of them."""

    config: AxisConfig
    units: AxisUnits
    velocity_unit_qc_s: float  # of the records
    start_qc: int  # where it stands
    records: tuple[Record, ...]  # the last, of time 0, ends the motion
    reference: Reference
    column: int  # of the axis in the reference

    def pieces(self) -> Iterator[Piece]:
        """The whole motion, so much of it at a time that memory does not grow with its length."""
        start_qc, velocity, begin_ms = self.start_qc, 0, 0
        for records in _batches(self.records):
            drive = executed(start_qc, records, self.velocity_unit_qc_s, velocity)
            k = begin_ms + np.arange(len(drive.position_qc))
            commanded_qc = self.reference.positions(k)[:, self.column]
            yield Piece(k, drive, np.asarray(drive.position_qc - commanded_qc))
            start_qc, velocity, begin_ms = records[-1].position, records[-1].velocity, int(k[-1])

    def samples(self, step_ms: int) -> Piece:
        """Every `step_ms`-th millisecond of it. At a knot the acceleration is that before it."""
        parts = []
        for number, (k, drive, error_qc) in enumerate(self.pieces()):
            here = (k % step_ms == 0) & ((k > k[0]) | (number == 0))
            parts.append((k[here], *(column[here] for column in drive), error_qc[here]))
        k, *curves, error_qc = (np.concatenate(columns) for columns in zip(*parts, strict=True))
        return Piece(k, Executed(*curves), error_qc)

    def frames(self) -> Iterator[Frame]:
        """What carries each of its records to a drive whose buffer is as after power-on."""
        pvt = FAMILIES[self.config.drive].pvt
        assert pvt is not None
        account = pvt.account(self.velocity_unit_qc_s, 0)
        for record in self.records:
            yield Frame(RPDO1 + self.config.node_id, account.send(record, 0.0)[-1])
            account.assume_received()

    @cached_property
    def extremes(self) -> tuple[float, float, float]:
        """Lowest and highest position [unit], and largest error [qc]."""
        lowest, highest, error_qc = math.inf, -math.inf, 0.0
        for piece in self.pieces():
            position = self.units.from_qc(piece.path.position_qc)
            lowest, highest = min(lowest, position.min()), max(highest, position.max())
            error_qc = max(error_qc, np.abs(piece.error_qc).max())
        return float(lowest), float(highest), float(error_qc)

    @property
    def peaks(self) -> tuple[float, float]:
        """Largest speed [unit/s] and acceleration [unit/s²] anywhere on the segments."""
        cubic, time_ms = segments(self.start_qc, self.records, self.velocity_unit_qc_s)
        tops = (np.max(top, initial=0.0) for top in cubic.extremes(time_ms * 1e-3))
        velocity, acceleration = (abs(self.units.from_qc_s(float(top))) for top in tops)
        return velocity, acceleration

    @property
    def knots_ms(self) -> NDArray[np.int64]:
        """Path time of each record, the last one aside, and of the start before them."""
        times = [record.time for record in self.records if record.time > 0]
        return np.cumsum([0, *times])


def _batches(records: Sequence[Record]) -> Iterator[list[Record]]:
    """Those of a piece of the motion; the one that ends it, of time 0, comes with the last."""
    batch: list[Record] = []
    duration_ms = 0
    for record in records:
        batch.append(record)
        duration_ms += record.time
        if duration_ms >= PIECE_MS:
            yield batch
            batch, duration_ms = [], 0
    if duration_ms or len(records) <= 1:
        yield batch


@dataclass(frozen=True)
class BusLoad:
    """Shares of the bit rate (0 … 1), stuff bits at worst."""

    records: float  # on average over the motion
    others: float  # SYNC, clocks, controlwords, heartbeats, and what the drives report
    busiest: float  # all of it, in the busiest second (of a shorter motion: on average)


@dataclass(frozen=True)
class Latency:
    """From the message to the SYNC that starts the motion."""

    records: int  # that have to be in the drives before the start
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
        return self.reference.end_ms / 1000


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
    beside = [axis for axis in config.axes if not follows_records(axis)]
    refuse_trajectory(beside, trajectory.joint_names)
    whole, config = config, replace(config, axes=tuple(a for a in config.axes if a not in beside))
    machine = machine_of(config)
    starts_qc = standing(trajectory, config, start)
    for drive, start_qc in zip(machine.drives, starts_qc, strict=True):
        drive.demand_qc = start_qc
    machine.group.phase = Phase.STANDING

    feeder = machine.interpolated.feeder
    begun_s = time.perf_counter()
    reference = machine.path.place(trajectory, None, 0.0).join()
    joined_s = time.perf_counter()
    before_compiling()
    knots.prepare()
    begun_s += time.perf_counter() - joined_s
    feeder.begin(reference)
    by_node: dict[int, list[Record]] = {axis.node_id: [] for axis in config.axes}
    sent_ms: list[float] = []
    ready_us: list[float] = []  # when each of the records before the start is there to be sent
    while (due_ms := feeder.due_ms) < math.inf:
        fed = feeder.next(due_ms)
        assert fed is not None
        follower, record = fed
        follower.send(record, due_ms)
        follower.account.assume_received()
        by_node[follower.drive.node_id].append(record)
        sent_ms.append(max(due_ms, 0.0))
        if due_ms <= 0:
            ready_us.append((time.perf_counter() - begun_s) * 1e6)

    axes = tuple(
        AxisPlan(
            axis,
            AxisUnits.of(axis),
            follower.fit.velocity_unit_qc_s,
            start_qc,
            tuple(by_node[axis.node_id]),
            reference,
            column,
        )
        for column, (axis, follower, start_qc) in enumerate(
            zip(config.axes, machine.interpolated.axes, starts_qc, strict=True)
        )
    )
    return Plan(
        trajectory,
        config,
        Limits.of(config.axes),
        reference,
        axes,
        _bus_load(config, axes, np.array(sent_ms), reference.end_ms),
        _latency(config, ready_us),
        OutputPlans.of(
            whole,
            {axis.config.joint: (piece.path for piece in axis.pieces()) for axis in axes},
        ),
        tuple(feeder.remarks),
    )


def _bus_load(
    config: DriverConfig, axes: Sequence[AxisPlan], sent_ms: Array, end_ms: int
) -> BusLoad:
    """A drive answers each SYNC by its synchronous PDOs, and gets a time stamp; it is asked now and
    then what its buffer holds (SDO, there and back), and what its clock was at a SYNC (SDO, too),
    of which no more than READ_SHARE of the bus is taken. Its position comes once in its inhibit
    time where it is no such answer; what its buffer has taken, for each record where that is in a
    PDO. Before the start each is asked for both, and told by two controlwords."""
    count, end_s = len(axes), max(end_ms, 1) / 1000
    window_s, before = min(end_s, 1.0), count * BEFORE_PDOS
    pdos_per_s = count * 2 * 1e6 / LEVEL_ROUND_US
    for axis in axes:
        family = FAMILIES[axis.config.drive]
        assert family.pvt is not None
        status = family.pvt.status.index, family.pvt.status.subindex
        for tpdo in family.tpdos:
            if tpdo.transmission_type == SYNCHRONOUS:
                pdos_per_s += 1 / config.sync_period
            elif (POSITION_ACTUAL, 0) in tpdo.objects:
                pdos_per_s += 1e6 / INHIBIT_US[tpdo.cob_id]
            elif status in tpdo.objects:
                pdos_per_s += len(axis.records) / end_s
    clocks = sum(FAMILIES[axis.config.drive].has_clock for axis in axes)
    reads_per_s = max(1.1 / config.sync_period, clocks * 1e6 / CLOCK_ROUND_US) if clocks else 0.0
    reads_bits_s = 2 * PDO_BITS * reads_per_s
    bits_per_s = (
        pdos_per_s * PDO_BITS
        + min(reads_bits_s, READ_SHARE * config.bitrate)
        + (SYNC_BITS + count * STAMP_BITS) / config.sync_period
        + HEARTBEAT_BITS * (1e6 / HEARTBEAT_PERIOD_US + count * 1e3 / DRIVE_HEARTBEAT_MS)
    )
    at_ms = np.sort(sent_ms)
    until = np.searchsorted(at_ms, at_ms + 1000 * window_s, side="right")
    most = int(np.max(until - np.arange(len(at_ms))))  # of them within the window
    return BusLoad(
        records=len(sent_ms) * PDO_BITS / end_s / config.bitrate,
        others=(before * PDO_BITS / end_s + bits_per_s) / config.bitrate,
        busiest=((most + before) * PDO_BITS / window_s + bits_per_s) / config.bitrate,
    )


def _latency(config: DriverConfig, ready_us: Sequence[float]) -> Latency:
    """Each record is sent when it is fitted and the one before is through; the drives are asked
    whether they have them, one after the other; then controlwords and SYNC."""
    count, us_per_bit = len(config.axes), 1e6 / config.bitrate
    through_us = 0.0
    for fitted_us in ready_us:
        through_us = max(through_us, fitted_us) + PDO_BITS * us_per_bit
    start_bits = count * (3 * PDO_BITS + CONTROLWORD_BITS) + SYNC_BITS
    total_us = through_us + start_bits * us_per_bit
    return Latency(len(ready_us), ready_us[-1] / 1000, total_us / 1000)
