"""What the axes did, from the log alone: motions with their records, reports, levels, clocks.

Commanded is the curve of the records that were on the bus, from the position demand that the
drive had reported before; executed is what the drives report at each SYNC. All drives latch their
clocks at the same SYNC, so how far one is off the others needs nobody else's clock.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from epos2_ros.configuration.driver import DriverConfig
from epos2_ros.motion import pvt
from epos2_ros.motion.record import Record
from epos2_ros.motion.units import AxisUnits
from epos2_ros.protocol import cia402, epos2
from epos2_ros.protocol.clock import wrapped
from epos2_ros.protocol.epos2 import BUFFER_SIZE
from epos2_ros.replay.decode import Key, Meaning, Pdo, Sdo, Sync, Time
from epos2_ros.replay.sdo import Transfer
from epos2_ros.replay.timeline import Told

SAMPLE_MS = 1.5  # a drive reports a demand that it had within this of the SYNC
Series = list[tuple[float, float]]  # time in the log [s], value

_DEMAND: Key = (epos2.POSITION_DEMAND, 0)
_ACTUAL: Key = (epos2.POSITION_ACTUAL, 0)
_FOLLOWING: Key = (epos2.FOLLOWING_ERROR_ACTUAL, 0)
_FREE: Key = (epos2.INTERPOLATION_DATA_CONFIGURATION, epos2.ACTUAL_BUFFER_SUBINDEX)
_CLEAR: Key = (epos2.INTERPOLATION_DATA_CONFIGURATION, epos2.BUFFER_CLEAR_SUBINDEX)
_STAMP: Key = (epos2.HIGH_RESOLUTION_TIME_STAMP, 0)
_STATUSWORD: Key = (epos2.STATUSWORD, 0)
_CONTROLWORD: Key = (epos2.CONTROLWORD, 0)
_RECORD: Key = (epos2.INTERPOLATION_DATA_RECORD, 0)


@dataclass
class Motion:
    """Records of one axis from a cleared buffer or an end record on."""

    start_qc: int
    start_s: float | None = None  # of the start SYNC
    end_s: float | None = None  # when the drive no longer interpolated
    records: list[Record] = field(default_factory=list)
    sent_s: list[float] = field(default_factory=list)  # when each was on the bus

    @property
    def ended(self) -> bool:
        """Whether its end record was sent."""
        return bool(self.records) and self.records[-1].time == 0

    def begins_ms(self) -> NDArray[np.float64]:
        """Path time at which each record leaves the buffer."""
        times = np.array([0, *(record.time for record in self.records)], dtype=np.float64)
        return np.cumsum(times)[:-1]

    def levels(self, until_s: float) -> Series:
        """Records in the buffer besides the one in execution, by the books, up to `until_s`."""
        if self.start_s is None:
            return [(t_s, n) for n, t_s in enumerate(self.sent_s, start=1) if t_s <= until_s]
        taken_s = [self.start_s + begin / 1000 for begin in self.begins_ms()]
        changes = sorted([(t, 1) for t in self.sent_s] + [(t, -1) for t in taken_s])
        level, series = 0, []
        for t_s, change in changes:
            if t_s > until_s:
                break
            level += change
            series.append((t_s, float(level)))
        return series

    def fewest(self) -> int | None:
        """In the buffer when a segment began, before the end record was sent."""
        if self.start_s is None or not self.records:
            return None
        last_s = self.sent_s[-1] if self.ended else (self.end_s or self.sent_s[-1])
        levels = [
            bisect_right(self.sent_s, self.start_s + begin / 1000) - n
            for n, begin in enumerate(self.begins_ms(), start=1)
            if self.start_s + begin / 1000 <= last_s
        ]
        return min(levels, default=None)

    def curve_qc(self, velocity_unit_qc_s: float) -> NDArray[np.floating]:
        """What a drive makes of the records, at every millisecond of path time."""
        return pvt.executed(self.start_qc, self.records, velocity_unit_qc_s).position_qc


@dataclass(eq=False)
class AxisHistory:
    """What one node was told and has reported."""

    node: int
    demand: Series = field(default_factory=list)  # [qc], at the time of the SYNC
    actual: Series = field(default_factory=list)  # [qc]
    following: Series = field(default_factory=list)  # [qc]
    reported: Series = field(default_factory=list)  # records in the buffer
    offset: Series = field(default_factory=list)  # of its clock [us], at the time of a SYNC
    motions: list[Motion] = field(default_factory=list)
    velocity_unit_qc_s: float | None = None
    latched: int | None = None  # its clock at the last SYNC
    armed: bool = False
    active: bool = False

    def off_curve(self, motion: Motion) -> Series:
        """How far each reported demand lies off the curve of the records [qc]."""
        if motion.start_s is None or self.velocity_unit_qc_s is None:
            return []
        curve = motion.curve_qc(self.velocity_unit_qc_s)
        end_s = motion.start_s + (len(curve) - 1) / 1000
        if motion.end_s is not None:
            end_s = min(end_s, motion.end_s)
        series = []
        for t_s, qc in self.demand:
            if not motion.start_s < t_s < end_s:
                continue
            at_ms = 1000 * (t_s - motion.start_s)
            first = max(0, int(np.ceil(at_ms - SAMPLE_MS)))
            near = curve[first : int(at_ms + SAMPLE_MS) + 1]
            series.append((t_s, float(qc - np.clip(qc, near.min(), near.max()))))
        return series


class History:
    """Takes the meanings of frames; tells of each motion, axis by axis, when it has ended."""

    def __init__(self, config: DriverConfig | None = None) -> None:
        self.axes: dict[int, AxisHistory] = {}
        self._sync_s = 0.0
        for axis in config.axes if config else ():
            unit = AxisUnits.of(axis).velocity_unit_qc_s
            self.axes[axis.node_id] = AxisHistory(axis.node_id, velocity_unit_qc_s=unit)

    def frame(self, t_s: float, meanings: Iterable[Meaning]) -> Iterator[Told]:
        """A frame that was on the bus."""
        for meaning in meanings:
            match meaning:
                case Sync():
                    self._on_sync(t_s)
                case Time():
                    self._compare_clocks()
                case Sdo(transfer) if transfer.abort is None:
                    self._transferred(t_s, transfer)
                case Pdo():
                    axis = self._axis(meaning.node)
                    if meaning.transmit:
                        yield from self._reported(t_s, axis, meaning)
                    else:
                        self._commanded(t_s, axis, meaning)

    def end(self, t_s: float) -> Iterator[Told]:
        """The log has ended; motions that had not are told as far as they went."""
        for axis in self.axes.values():
            if axis.active:
                yield Told(t_s, axis.node, f"still moving: {self._summary(axis, axis.motions[-1])}")

    # ------------------------------------------------------------------ inside

    def _axis(self, node: int) -> AxisHistory:
        return self.axes.setdefault(node, AxisHistory(node))

    def _on_sync(self, t_s: float) -> None:
        self._compare_clocks()
        self._sync_s = t_s
        for axis in self.axes.values():
            if axis.armed and axis.motions:
                axis.motions[-1].start_s = t_s
            axis.armed = False

    def _compare_clocks(self) -> None:
        """What the drives have answered to the last SYNC, against the median of all."""
        latched = {axis: axis.latched for axis in self.axes.values() if axis.latched is not None}
        some = next(iter(latched.values()), 0)
        apart = {axis: wrapped(clock - some) for axis, clock in latched.items()}
        middle = float(np.median(list(apart.values()))) if apart else 0.0
        for axis, offset_us in apart.items():
            axis.offset.append((self._sync_s, offset_us - middle))
            axis.latched = None

    def _transferred(self, t_s: float, transfer: Transfer) -> None:
        axis, key = self._axis(transfer.node), (transfer.entry, transfer.subindex)
        if transfer.write and key == _CLEAR:
            self._begin(axis)
        elif not transfer.write and key == _FREE and transfer.data:
            axis.reported.append((t_s, float(BUFFER_SIZE - _unsigned(transfer.data))))
        elif not transfer.write and key == _STAMP and transfer.data:
            axis.latched = _unsigned(transfer.data)

    @staticmethod
    def _begin(axis: AxisHistory) -> None:
        """The buffer is empty: what comes next is another motion."""
        if axis.motions and axis.motions[-1].start_s is None:
            axis.motions.pop()
        start_qc = int(axis.demand[-1][1]) if axis.demand else 0
        axis.motions.append(Motion(start_qc))

    def _commanded(self, t_s: float, axis: AxisHistory, pdo: Pdo) -> None:
        if (data := pdo.values.get(_RECORD)) is not None:
            if not axis.motions or axis.motions[-1].ended:
                self._begin(axis)
            motion = axis.motions[-1]
            if not motion.records and axis.demand:
                motion.start_qc = int(axis.demand[-1][1])
            motion.records.append(Record.unpack(data))
            motion.sent_s.append(t_s)
        if (data := pdo.values.get(_CONTROLWORD)) is not None and pdo.synchronous:
            axis.armed = bool(_unsigned(data) & epos2.ENABLE_IP_MODE)

    def _reported(self, t_s: float, axis: AxisHistory, pdo: Pdo) -> Iterator[Told]:
        at_s = self._sync_s if pdo.synchronous else t_s
        for key, series in (
            (_DEMAND, axis.demand),
            (_ACTUAL, axis.actual),
            (_FOLLOWING, axis.following),
        ):
            if (data := pdo.values.get(key)) is not None:
                series.append((at_s, float(int.from_bytes(data, "little", signed=True))))
        if (data := pdo.values.get(_FREE)) is not None:
            axis.reported.append((at_s, float(BUFFER_SIZE - _unsigned(data))))
        if (data := pdo.values.get(_STAMP)) is not None:
            axis.latched = _unsigned(data)
        if (data := pdo.values.get(_STATUSWORD)) is not None:
            yield from self._state(t_s, axis, _unsigned(data))

    def _state(self, t_s: float, axis: AxisHistory, statusword: int) -> Iterator[Told]:
        started = bool(axis.motions) and axis.motions[-1].start_s is not None
        active = started and bool(statusword & epos2.IP_MODE_ACTIVE_STATUSWORD)
        active = active and cia402.state_of(statusword) is cia402.State.OPERATION_ENABLED
        if axis.active and not active:
            motion = axis.motions[-1]
            motion.end_s = t_s
            yield Told(t_s, axis.node, f"motion: {self._summary(axis, motion)}")
        axis.active = active

    @staticmethod
    def _summary(axis: AxisHistory, motion: Motion) -> str:
        begin_s = motion.start_s or 0.0
        end_s = np.inf if motion.end_s is None else motion.end_s

        def largest(series: Series) -> float | None:
            return max((abs(v) for t, v in series if begin_s <= t <= end_s), default=None)

        duration_s = sum(record.time for record in motion.records) / 1000
        parts = [f"{len(motion.records)} records for {duration_s:.3f} s"]
        if motion.end_s is not None and not motion.ended:
            parts.append(f"ended after {motion.end_s - begin_s:.3f} s without its end record")
        if (fewest := motion.fewest()) is not None:
            parts.append(f"at least {fewest} in the buffer")
        if (off := largest(axis.off_curve(motion))) is not None:
            parts.append(f"demand at most {off:.1f} qc off their curve")
        if (following := largest(axis.following)) is not None:
            parts.append(f"following error up to {following:.0f} qc")
        if (offset := largest(axis.offset)) is not None:
            parts.append(f"clock up to {offset:.0f} us off the others'")
        return ", ".join(parts)


def _unsigned(data: bytes) -> int:
    return int.from_bytes(data, "little")
