"""A plan as a drawing: what is commanded, what the drives make of it, the error and the knots."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from epos2_ros.plan.planning import Array, AxisPlan, Plan

ORDERS = ("position", "velocity", "acceleration")  # derivatives of the curves
ROW_INCH, COLUMN_INCH = 1.9, 4.2
Style = Mapping[str, Any]
COMMANDED: Style = {"color": "0.78", "linewidth": 3.5, "solid_capstyle": "butt"}
EXECUTED: Style = {"color": "C0", "linewidth": 0.9}
KNOTS: Style = {"color": "C3", "linestyle": "", "marker": ".", "markersize": 3.5}
LIMIT: Style = {"color": "C1", "linewidth": 0.9, "linestyle": (0, (5, 3))}
TOLERANCE: Style = {"color": "C2", "alpha": 0.15, "linewidth": 0}


def save(plan: Plan, title: str, file: Path) -> None:
    """As PNG or SVG, by the name of the file."""
    _figure(plan, title).savefig(file, dpi=110)


def svg(plan: Plan) -> str:
    """The text of an SVG file, without a title."""
    text = io.StringIO()
    _figure(plan, "").savefig(text, format="svg")
    return text.getvalue()


def _figure(plan: Plan, title: str) -> Figure:
    """A row for each axis; a column for each order, and one for the error."""
    columns = len(ORDERS) + 1
    size = columns * COLUMN_INCH, 1.0 + len(plan.axes) * ROW_INCH
    figure = Figure(figsize=size, layout="constrained")
    grid = figure.subplots(len(plan.axes), columns, sharex=True, squeeze=False)
    t_s = np.arange(plan.reference.end_ms + 1) / 1000
    for order, quantity in enumerate(ORDERS):
        commanded = plan.reference.evaluate(t_s, order)
        for row, axis in enumerate(plan.axes):
            _draw_curves(grid[row, order], axis, t_s, commanded[:, row], order)
            _draw_limits(grid[row, order], _bounds(plan, row, order))
        grid[0, order].set_title(quantity)
    for row, axis in enumerate(plan.axes):
        _draw_error(grid[row, -1], axis, t_s, plan.config.tolerance)
    grid[0, -1].set_title("executed − commanded")
    for axes in grid.flat:
        axes.grid(alpha=0.25)
        axes.margins(x=0.01)
    for axes in grid[-1]:
        axes.set_xlabel("path time [s]")
    figure.align_ylabels()
    figure.suptitle(title, x=0.01, ha="left")
    figure.legend(
        handles=[
            Line2D([], [], label="commanded", **COMMANDED),
            Line2D([], [], label="executed", **EXECUTED),
            Line2D([], [], label="knots (records)", **KNOTS),
            Line2D([], [], label="limit", **LIMIT),
            Patch(label="tolerance", **TOLERANCE),
        ],
        loc="outside upper right",
        ncols=5,
        frameon=False,
    )
    return figure


def _draw_curves(axes: Axes, axis: AxisPlan, t_s: Array, commanded: Array, order: int) -> None:
    executed = axis.curve(order)
    until = -1 if order == 2 else None  # in its last instant it already rests
    axes.plot(t_s[:until], commanded[:until], **COMMANDED)
    axes.plot(t_s, executed, **EXECUTED)
    if order < 2:  # the acceleration jumps at knots
        axes.plot(t_s[axis.knots_ms], executed[axis.knots_ms], **KNOTS)
    unit = axis.units.unit + ("", "/s", "/s²")[order]
    axes.set_ylabel(f"[{unit}]" if order else f"{axis.config.joint}\n[{unit}]")


def _bounds(plan: Plan, row: int, order: int) -> tuple[float, float]:
    limits = plan.limits
    if order == 0:
        return float(limits.lower[row]), float(limits.upper[row])
    limit = float((limits.velocity, limits.acceleration)[order - 1][row])
    return -limit, limit


def _draw_limits(axes: Axes, bounds: tuple[float, float]) -> None:
    """Those that are in sight of the curve."""
    low, high = axes.get_ylim()
    margin = (high - low) / 2
    for bound in bounds:
        if low - margin < bound < high + margin:
            axes.axhline(bound, **LIMIT)


def _draw_error(axes: Axes, axis: AxisPlan, t_s: Array, tolerance_qc: float) -> None:
    axes.axhspan(-tolerance_qc, tolerance_qc, **TOLERANCE)
    axes.plot(t_s, axis.error_qc, **EXECUTED)
    axes.plot(t_s[axis.knots_ms], axis.error_qc[axis.knots_ms], **KNOTS)
    axes.set_ylim(-1.15 * tolerance_qc, 1.15 * tolerance_qc)
    axes.set_ylabel("[qc]")
