"""A log as a drawing: executed against commanded, buffer levels and clock offsets."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from epos2_ros.replay.history import AxisHistory, Series

COLUMNS = ("position", "demand − curve of the records", "records in the buffer", "clock offset")
ROW_INCH, COLUMN_INCH = 1.9, 4.2
Style = Mapping[str, Any]
COMMANDED: Style = {"color": "0.78", "linewidth": 3.5, "solid_capstyle": "butt"}
DEMAND: Style = {"color": "C0", "linestyle": "", "marker": ".", "markersize": 4}
ACTUAL: Style = {"color": "C2", "linewidth": 0.9}
LEVEL: Style = {"color": "C0", "linewidth": 0.9, "drawstyle": "steps-post"}
REPORTED: Style = {"color": "C3", "linestyle": "", "marker": ".", "markersize": 3}
TROUBLE: Style = {"color": "C3", "linewidth": 0.9, "linestyle": (0, (5, 3))}


def save(
    axes: Sequence[AxisHistory],
    names: Callable[[int], str],
    units: Mapping[int, tuple[str, Callable[[float], float]]],
    span_s: tuple[float, float],
    troubles_s: Sequence[float],
    title: str,
    file: Path,
) -> None:
    """As PNG or SVG, by the name of the file: a row for each axis.

    `units`: by node, the unit of its joint and what makes it of qc; others are drawn in qc.
    `span_s`: from where to where of the log.
    """
    size = len(COLUMNS) * COLUMN_INCH, 1.0 + len(axes) * ROW_INCH
    figure = Figure(figsize=size, layout="constrained")
    grid = figure.subplots(len(axes), len(COLUMNS), sharex=True, squeeze=False)
    for row, axis in zip(grid, axes, strict=True):
        unit, convert = units.get(axis.node, ("qc", float))
        _draw_position(row[0], axis, convert, span_s)
        row[0].set_ylabel(f"{names(axis.node)}\n[{unit}]")
        for motion in axis.motions:
            _plot(row[1], axis.off_curve(motion), span_s, DEMAND)
            until_s = span_s[1] if motion.end_s is None else min(span_s[1], motion.end_s)
            _plot(row[2], motion.levels(until_s), span_s, LEVEL)
        row[1].set_ylabel("[qc]")
        _plot(row[2], axis.reported, span_s, REPORTED)
        _plot(row[3], axis.offset, span_s, DEMAND)
        row[3].set_ylabel("[µs]")
        for part in row:
            part.grid(alpha=0.25)
            for t_s in troubles_s:
                if span_s[0] <= t_s <= span_s[1]:
                    part.axvline(t_s, **TROUBLE)
    for part, heading in zip(grid[0], COLUMNS, strict=True):
        part.set_title(heading)
    for part in grid[-1]:
        part.set_xlabel("time in the log [s]")
    grid[0, 0].set_xlim(*span_s)
    figure.align_ylabels()
    figure.suptitle(title, x=0.01, ha="left")
    figure.legend(
        handles=[
            Line2D([], [], label="commanded (records)", **COMMANDED),
            Line2D([], [], label="demand at SYNC, clock at SYNC", **DEMAND),
            Line2D([], [], label="actual position", **ACTUAL),
            Line2D([], [], label="buffer by the books", **LEVEL),
            Line2D([], [], label="buffer as reported", **REPORTED),
            Line2D([], [], label="fault or emergency", **TROUBLE),
        ],
        loc="outside upper right",
        ncols=6,
        frameon=False,
    )
    figure.savefig(file, dpi=110)


def _draw_position(
    part: Axes, axis: AxisHistory, convert: Callable[[float], float], span_s: tuple[float, float]
) -> None:
    for motion in axis.motions:
        if motion.start_s is None or axis.velocity_unit_qc_s is None or not motion.records:
            continue
        curve = motion.curve_qc(axis.velocity_unit_qc_s)
        t_s = motion.start_s + np.arange(len(curve)) / 1000
        _plot(part, [(t, convert(qc)) for t, qc in zip(t_s, curve, strict=True)], span_s, COMMANDED)
    _plot(part, [(t, convert(qc)) for t, qc in axis.actual], span_s, ACTUAL)
    _plot(part, [(t, convert(qc)) for t, qc in axis.demand], span_s, DEMAND)


def _plot(part: Axes, series: Series, span_s: tuple[float, float], style: Style) -> None:
    inside = [point for point in series if span_s[0] <= point[0] <= span_s[1]]
    if inside:
        part.plot(*zip(*inside, strict=True), **style)
