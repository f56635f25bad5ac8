"""What the drives made of it: figures, limits, table and plot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from epos2_ros.demo.commanded import MARGINS, Array, Commanded, Scale
from epos2_ros.demo.outputs import Event, OutputResult
from epos2_ros.demo.terminal import Terminal
from epos2_ros.errors import Epos2RosError

MAX_SPREAD_US = 1.0
MAX_FINAL_ERROR_QC = 0.5
ROUNDING_QC = 1e-6  # two evaluations of one curve differ by so much at most
WINDOWS_MS = (10, 20, 50, 100)  # over which velocity and acceleration are looked at
MIN_LEVEL, MAX_LEVEL = 2, 64  # records in a drive's buffer while more are to come


@dataclass(frozen=True)
class Observed:
    """What the topics said about a motion, by joint where it is a mapping."""

    records_sent: dict[str, int]
    positions: dict[str, float]  # after it [unit]
    buffer_errors: dict[str, str]  # flags in words, only of joints that had one
    sync_count: int
    bus_load: float  # highest during the motion [%]
    set_points: Mapping[str, int] = field(default_factory=dict)  # taken, of joints that follow so
    stated_qc: Mapping[str, float] = field(default_factory=dict)  # the error said of them
    events: Mapping[str, Sequence[Event]] = field(default_factory=dict)  # by output


@dataclass(frozen=True)
class Executed:
    """One drive's own log of its last motion, cycle by cycle; arrays are [cycles]."""

    time_us: Array
    path_ms: Array
    demand_qc: Array
    level: NDArray[np.int64]

    @classmethod
    def load(cls, log: Path, node_id: int) -> Executed:
        """From the .npz file that the simulated drives leave."""
        with np.load(log) as columns:
            names = ("time_us", "path_ms", "demand_qc", "buffer_level")
            time_us, path_ms, demand_qc, level = (columns[f"node_{node_id}_{n}"] for n in names)
        if not len(path_ms):
            raise Epos2RosError(f"the simulated drive with node id {node_id} did not move")
        begins = np.flatnonzero(np.diff(path_ms) <= 0) + 1
        last = slice(begins[-1] if len(begins) else 0, None)
        t_ms = path_ms[last].astype(np.float64)
        return cls(time_us[last], t_ms, demand_qc[last], level[last])

    @property
    def fed_levels(self) -> NDArray[np.int64]:
        """Buffer levels until the last record came in; after it the buffer runs out as meant."""
        rises = np.flatnonzero(np.diff(self.level) > 0)
        return self.level[: rises[-1] + 2 if len(rises) else 1]

    def since(self, start_us: float) -> Executed:
        """Its path time by another clock."""
        return replace(self, path_ms=(self.time_us - start_us) / 1000.0)

    @property
    def per_ms_qc(self) -> float:
        """The farthest that it moves in a millisecond, by which its drive's clock may be off."""
        passed_ms = np.maximum(np.diff(self.time_us) / 1000.0, 0.5)
        return float(np.max(np.abs(np.diff(self.demand_qc)) / passed_ms))

    @property
    def start_us(self) -> float:
        """True time of the path's zero, from the first control cycle."""
        return float(self.time_us[0] - 1000.0 * self.path_ms[0])


@dataclass(frozen=True)
class AxisResult:
    scale: Scale
    executed: Executed
    commanded_qc: Array  # [cycles]; where the driver chooses the curve, the nearest that is right
    tolerance_qc: float
    records_sent: int
    final_error_qc: float
    buffer_error: str
    buffered: bool = True  # by records; else by set-points, of which `records_sent` is the number

    @property
    def error_qc(self) -> Array:
        return self.executed.demand_qc - self.commanded_qc

    @property
    def path_error_qc(self) -> float:
        return float(np.max(np.abs(self.error_qc)))

    @property
    def levels(self) -> tuple[int, int]:
        """Smallest and largest buffer level while it was fed."""
        return int(np.min(self.executed.fed_levels)), int(np.max(self.executed.level))

    @property
    def path_kept(self) -> bool:
        return self.path_error_qc <= self.tolerance_qc + ROUNDING_QC

    def beyond_limits(self) -> str:
        """In words by how much the joint is faster or accelerates more than it may; "" if it isn't.

        Seen over some windows: on average it can't have more than it ever has. The executed curve
        may be the tolerance beside one that keeps to limits and margins.
        """
        scale, off_qc = self.scale, self.tolerance_qc + ROUNDING_QC
        path_qc, count = self.executed.demand_qc, len(self.executed.demand_qc)
        limits = scale.max_velocity, scale.max_acceleration
        for order, (quantity, most, margin) in enumerate(
            zip(("velocity", "acceleration"), limits, MARGINS, strict=True), start=1
        ):
            for window_ms in WINDOWS_MS:
                if not np.isfinite(most) or count <= order * window_ms:
                    continue
                steps, size_s = path_qc, window_ms / 1000
                for _ in range(order):
                    steps = steps[window_ms:] - steps[:-window_ms]
                value = np.abs(steps) - 2**order * off_qc
                value /= size_s**order * abs(scale.qc_per_unit)
                worst = int(np.argmax(value))
                if value[worst] > most * (1 + margin) * (1 + 1e-6):
                    unit = scale.unit + ("/s", "/s²")[order - 1]
                    at_s = self.executed.path_ms[worst] / 1000
                    return (
                        f"{quantity} {value[worst]:.4g} {unit} over {window_ms} ms from "
                        f"{at_s:.3f} s, at most {most * (1 + margin):.4g}"
                    )
        return ""

    @property
    def end_kept(self) -> bool:
        return abs(self.final_error_qc) <= MAX_FINAL_ERROR_QC + ROUNDING_QC

    @property
    def buffer_kept(self) -> bool:
        if not self.buffered:
            return True
        low, high = self.levels
        return low >= MIN_LEVEL and high <= MAX_LEVEL and not self.buffer_error

    def failures(self) -> list[str]:
        """Every limit of the axis that was not kept, one line each."""
        found = []
        if not self.path_kept:
            found.append(f"path error {self.path_error_qc:.2f} qc, at most {self.tolerance_qc:g}")
        if beyond := self.beyond_limits():
            found.append(beyond)
        if not self.buffer_kept:
            low, high = self.levels
            found.append(
                self.buffer_error
                or f"buffer level {low} … {high} records, must be {MIN_LEVEL} … {MAX_LEVEL}"
            )
        if not self.end_kept:
            found.append(f"final error {self.final_error_qc:.2f} qc, at most {MAX_FINAL_ERROR_QC}")
        return [f"{self.scale.joint}: {failure}" for failure in found]


@dataclass(frozen=True)
class Report:
    axes: tuple[AxisResult, ...]
    observed: Observed
    bitrate: int
    outputs: tuple[OutputResult, ...] = ()

    @classmethod
    def of(
        cls,
        commanded: Commanded,
        joints: Sequence[str],
        scales: Sequence[Scale],
        log: Path,
        observed: Observed,
        bitrate: int,
        tolerance_qc: float,
    ) -> Report:
        """`joints` are the trajectory's, in the order of its columns."""
        axes = []
        logs = {s.joint: Executed.load(log, s.node_id) for s in scales if s.joint in joints}
        buffered = [one for joint, one in logs.items() if joint not in observed.set_points]
        for scale in scales:
            if scale.joint not in joints:
                continue  # it holds
            column = joints.index(scale.joint)
            executed, allowed_qc = logs[scale.joint], tolerance_qc
            if scale.joint in observed.set_points:
                if buffered:  # whose clocks the path goes by
                    executed = executed.since(buffered[0].start_us)
                allowed_qc = observed.stated_qc[scale.joint] + executed.per_ms_qc + 1.0
            between = commanded.between(executed.path_ms / 1000.0)
            bounds_qc = scale.to_qc(np.array([side[:, column] for side in between]))
            target_qc = scale.to_qc(commanded.at(np.array([np.inf]))[0, column])
            reached_qc = scale.to_qc(np.float64(observed.positions[scale.joint]))
            axes.append(
                AxisResult(
                    scale=scale,
                    executed=executed,
                    commanded_qc=np.clip(
                        executed.demand_qc, bounds_qc.min(axis=0), bounds_qc.max(axis=0)
                    ),
                    tolerance_qc=allowed_qc,
                    records_sent=observed.set_points.get(scale.joint)
                    or observed.records_sent.get(scale.joint, 0),
                    buffered=scale.joint not in observed.set_points,
                    final_error_qc=float(reached_qc - target_qc),
                    buffer_error=observed.buffer_errors.get(scale.joint, ""),
                )
            )
        return cls(tuple(axes), observed, bitrate)

    @property
    def spread_us(self) -> float:
        starts = [axis.executed.start_us for axis in self.axes if axis.buffered]
        return max(starts) - min(starts) if starts else 0.0

    @property
    def spread_kept(self) -> bool:
        return self.spread_us <= MAX_SPREAD_US

    def failures(self) -> list[str]:
        """Every limit that was not kept, one line each."""
        found = [failure for axis in self.axes for failure in axis.failures()]
        if not self.spread_kept:
            found.append(f"start times {self.spread_us:.2f} µs apart, at most {MAX_SPREAD_US:g}")
        return found + [output.failure for output in self.outputs if output.failure]

    def print(self, terminal: Terminal) -> None:
        """The table and the group's figures."""
        width = max(len(axis.scale.joint) for axis in self.axes)
        title = "records sent  path error [qc]  buffer level  final error [qc]"
        terminal.line()
        terminal.line(terminal.bold(f"{'axis':{width}}  {title}"))
        for axis in self.axes:
            low, high = axis.levels
            path = terminal.judged(f"{axis.path_error_qc:15.2f}", axis.path_kept)
            buffer = terminal.judged(f"{low:6} … {high:<4}", axis.buffer_kept)
            if not axis.buffered:
                path = terminal.judged(
                    f"{axis.path_error_qc:8.0f} ≤ {axis.tolerance_qc:4.0f}", axis.path_kept
                )
                buffer = f"{'set-points':13}"
            final = terminal.judged(f"{axis.final_error_qc:16.2f}", axis.end_kept)
            terminal.line(
                f"{axis.scale.joint:{width}}  {axis.records_sent:12}  {path}  {buffer}  {final}"
            )
        self._print_outputs(terminal)
        spread = terminal.judged(f"{self.spread_us:.2f} µs", self.spread_kept)
        terminal.line()
        terminal.line(
            f"start times {spread} apart, {self.observed.sync_count} SYNC, "
            f"bus load {self.observed.bus_load:.1f} % at {self.bitrate / 1e6:g} Mbit/s"
        )
        terminal.line()

    def _print_outputs(self, terminal: Terminal) -> None:
        """Times are against the commanded curve; an axis that lags is late by so much."""
        if not self.outputs:
            return
        width = max(len("output"), *(len(output.name) for output in self.outputs))
        title = "events  expected  late [µs]  jitter [µs]  axis"
        terminal.line()
        terminal.line(terminal.bold(f"{'output':{width}}  {title}"))
        for output in self.outputs:
            late_us, jitter_us = output.late_us
            told = terminal.judged(f"{len(output.told):6}", not output.failure)
            terminal.line(
                f"{output.name:{width}}  {told}  {len(output.expected):8}  {late_us:9.0f}  "
                f"{jitter_us:11.0f}  {output.joint}"
            )

    def plot(self, file: Path, title: str) -> None:
        """Commanded and executed position, error and buffer level over path time, as PNG."""
        figure = Figure(figsize=(10, 8.5), layout="constrained")
        position, error, level = figure.subplots(3, 1, sharex=True, height_ratios=(3, 2, 1.5))
        figure.suptitle(title)
        for number, axis in enumerate(self.axes):
            scale, executed, colour = axis.scale, axis.executed, f"C{number}"
            t_s = executed.path_ms / 1000.0
            executed_unit = executed.demand_qc / scale.qc_per_unit + scale.offset
            commanded_unit = axis.commanded_qc / scale.qc_per_unit + scale.offset
            position.plot(t_s, executed_unit, colour, linewidth=2.5, alpha=0.6, label=scale.joint)
            position.plot(t_s, commanded_unit, "k", linewidth=0.7, linestyle=(0, (4, 3)))
            error.plot(t_s, axis.error_qc, colour, linewidth=0.7)
            if axis.buffered:
                level.plot(t_s, executed.level, colour, linewidth=0.9, drawstyle="steps-post")
        position.plot([], [], "k", linewidth=0.7, linestyle=(0, (4, 3)), label="commanded")
        position.set_ylabel(f"position [{', '.join(sorted({a.scale.unit for a in self.axes}))}]")
        position.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)
        tolerance_qc = min(axis.tolerance_qc for axis in self.axes)
        for limit in (-tolerance_qc, tolerance_qc):
            error.axhline(limit, color="0.4", linewidth=0.8, linestyle=":")
        error.set_ylabel("executed − commanded [qc]")
        level.axhline(MIN_LEVEL, color="0.4", linewidth=0.8, linestyle=":")
        level.set_ylabel("buffer [records]")
        level.set_ylim(bottom=0)
        level.set_xlabel("path time [s]")
        for axes in (position, error, level):
            axes.grid(alpha=0.25)
            axes.margins(x=0.01)
        figure.savefig(file, dpi=130)
