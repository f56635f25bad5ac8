"""What one axis is sent, and what its drive makes of it: records, or set-points."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from epos2_ros.configuration.driver import AxisConfig
from epos2_ros.motion import setpoints
from epos2_ros.motion.crossings import Path
from epos2_ros.motion.pvt import Executed, executed, segments
from epos2_ros.motion.record import Record
from epos2_ros.motion.reference import Reference
from epos2_ros.motion.setpoints import SetPoint, SetPointAxis
from epos2_ros.motion.units import AxisUnits
from epos2_ros.protocol.epos2 import RPDO1
from epos2_ros.protocol.families import FAMILIES
from epos2_ros.protocol.frame import Frame
from epos2_ros.protocol.setpoints.handshake import parameters

Array = NDArray[np.float64]
PIECE_MS = 1 << 17  # looked at in one piece


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


class Knots(NamedTuple):
    """The start, and where each record or set-point ends; arrays of one length."""

    k: NDArray[np.int64]  # path time [ms]
    position_qc: Array
    velocity_qc_s: Array


class Sent(NamedTuple):
    """A record or a set-point, as it is told: of whole units of the drive."""

    end_ms: int
    position: int
    velocity: int
    time: int  # [ms]
    frames: tuple[Frame, ...]


@dataclass(frozen=True, eq=False)
class AxisPlan(ABC):
    """One axis; of what it is sent subclasses know."""

    config: AxisConfig
    units: AxisUnits
    start_qc: int  # where it stands
    reference: Reference
    column: int  # of the axis in the reference

    @property
    @abstractmethod
    def count(self) -> int:
        """How many records or set-points it is sent."""

    @abstractmethod
    def sent(self) -> Iterator[Sent]:
        """Each of them."""

    @abstractmethod
    def _curves(self) -> Iterator[tuple[int, Executed]]:
        """Path time at which a part of the motion begins, and the curve from there; in order."""

    @property
    @abstractmethod
    def peaks(self) -> tuple[float, float]:
        """Largest speed [unit/s] and acceleration [unit/s²] of the drive."""

    @property
    @abstractmethod
    def knots(self) -> Knots:
        """Where what it is sent ends."""

    def pieces(self) -> Iterator[Piece]:
        """The whole motion, so much of it at a time that memory does not grow with its length."""
        for begin_ms, drive in self._curves():
            k = begin_ms + np.arange(len(drive.position_qc))
            commanded_qc = self.reference.positions(k)[:, self.column]
            yield Piece(k, drive, np.asarray(drive.position_qc - commanded_qc))

    def samples(self, step_ms: int) -> Piece:
        """Every `step_ms`-th millisecond of it. At a knot the acceleration is that before it."""
        parts = []
        for number, (k, drive, error_qc) in enumerate(self.pieces()):
            here = (k % step_ms == 0) & ((k > k[0]) | (number == 0))
            parts.append((k[here], *(column[here] for column in drive), error_qc[here]))
        k, *curves, error_qc = (np.concatenate(columns) for columns in zip(*parts, strict=True))
        return Piece(k, Executed(*curves), error_qc)

    @cached_property
    def extremes(self) -> tuple[float, float, float]:
        """Lowest and highest position [unit], and largest error [qc]."""
        lowest, highest, error_qc = math.inf, -math.inf, 0.0
        for piece in self.pieces():
            position = self.units.from_qc(piece.path.position_qc)
            lowest, highest = min(lowest, position.min()), max(highest, position.max())
            error_qc = max(error_qc, np.abs(piece.error_qc).max())
        return float(lowest), float(highest), float(error_qc)


@dataclass(frozen=True, eq=False)
class RecordsPlan(AxisPlan):
    """An axis whose drive has a buffer of records."""

    velocity_unit_qc_s: float
    records: tuple[Record, ...]  # the last, of time 0, ends the motion

    @property
    def count(self) -> int:
        return len(self.records)

    def sent(self) -> Iterator[Sent]:
        """A frame for each, as a drive gets it whose buffer is as after power-on."""
        pvt = FAMILIES[self.config.drive].pvt
        assert pvt is not None
        account = pvt.account(self.velocity_unit_qc_s, 0)
        path_ms = 0
        for record in self.records:
            path_ms += record.time
            frame = Frame(RPDO1 + self.config.node_id, account.send(record, 0.0)[-1])
            account.assume_received()
            yield Sent(path_ms, *record, (frame,))

    def _curves(self) -> Iterator[tuple[int, Executed]]:
        start_qc, velocity, begin_ms = self.start_qc, 0, 0
        for records in _batches(self.records):
            drive = executed(start_qc, records, self.velocity_unit_qc_s, velocity)
            yield begin_ms, drive
            start_qc, velocity = records[-1].position, records[-1].velocity
            begin_ms += len(drive.position_qc) - 1

    @property
    def peaks(self) -> tuple[float, float]:
        """Anywhere on the segments."""
        cubic, time_ms = segments(self.start_qc, self.records, self.velocity_unit_qc_s)
        tops = (np.max(top, initial=0.0) for top in cubic.extremes(time_ms * 1e-3))
        velocity, acceleration = (abs(self.units.from_qc_s(float(top))) for top in tops)
        return velocity, acceleration

    @property
    def knots(self) -> Knots:
        """The record that ends the motion is none."""
        rows = [(0, self.start_qc, 0), *((r.time, r.position, r.velocity) for r in self.records)]
        time, position, velocity = np.array(rows[: len(self.records)]).T
        return Knots(
            np.cumsum(time),
            position.astype(np.float64),
            velocity * self.velocity_unit_qc_s,
        )


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


@dataclass(frozen=True, eq=False)
class SetPointsPlan(AxisPlan):
    """An axis whose drive has one set-point active and one queued."""

    limits: SetPointAxis
    points: tuple[SetPoint, ...]

    @property
    def count(self) -> int:
        return len(self.points)

    def sent(self) -> Iterator[Sent]:
        """With the frames of its parameters; controlwords go with them."""
        for point in self.points:
            yield Sent(
                point.end_ms,
                point.target_qc,
                point.velocity,
                point.end_ms - point.begin_ms,
                parameters(point, self.config.node_id),
            )

    def _curves(self) -> Iterator[tuple[int, Executed]]:
        """To the end of the reference, at least: the axis stands there."""
        end_ms, end_qc = 0, float(self.start_qc)
        for begin_ms, curve in setpoints.executed(self.start_qc, self.points, self.limits):
            yield begin_ms, curve
            end_ms, end_qc = begin_ms + len(curve.position_qc) - 1, float(curve.position_qc[-1])
        nothing = not self.points
        while nothing or end_ms < self.reference.end_ms:
            until_ms, nothing = min(end_ms + PIECE_MS, self.reference.end_ms), False
            still = np.zeros(until_ms - end_ms + 1)
            yield end_ms, Executed(still + end_qc, still, still)
            end_ms = until_ms

    @property
    def peaks(self) -> tuple[float, float]:
        """At every millisecond."""
        velocity = acceleration = 0.0
        for _, curve in setpoints.executed(self.start_qc, self.points, self.limits):
            velocity = max(velocity, float(np.abs(curve.velocity_qc_s).max()))
            acceleration = max(acceleration, float(np.abs(curve.acceleration_qc_s2).max()))
        return abs(self.units.from_qc_s(velocity)), abs(self.units.from_qc_s(acceleration))

    @property
    def knots(self) -> Knots:
        rows = [(0, float(self.start_qc), 0.0)]
        for begin_ms, curve in setpoints.executed(self.start_qc, self.points, self.limits):
            k = begin_ms + len(curve.position_qc) - 1
            rows.append((k, float(curve.position_qc[-1]), float(curve.velocity_qc_s[-1])))
        time, position, velocity = np.array(rows).T
        return Knots(time.astype(np.int64), position, velocity)
