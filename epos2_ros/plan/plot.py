"""A plan as a drawing: what is commanded, what the drives make of it, the error and the knots."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from epos2_ros.plan.axis import Array, AxisPlan, Piece, SetPointsPlan
from epos2_ros.plan.planning import Plan

ORDERS = ("position", "velocity", "acceleration")  # derivatives of the curves
DRAWN = 200_000  # instants of each curve, at most
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
    step_ms = 1 + plan.reference.end_ms // DRAWN
    for row, axis in enumerate(plan.axes):
        samples, knots = axis.samples(step_ms), Knots.of(axis)
        for order in range(len(ORDERS)):
            commanded = plan.reference.evaluate(samples.k / 1000, order)[:, row]
            _draw_curves(grid[row, order], axis, samples, knots, commanded, order)
            _draw_limits(grid[row, order], _bounds(plan, row, order))
        within_qc = axis.extremes[2] if isinstance(axis, SetPointsPlan) else plan.config.tolerance
        _draw_error(grid[row, -1], samples, knots, within_qc)
    for column, quantity in enumerate((*ORDERS, "executed − commanded")):
        grid[0, column].set_title(quantity)
    for axes in grid.flat:
        axes.grid(alpha=0.25)
        axes.margins(x=0.01)
    for axes in grid[-1]:
        axes.set_xlabel("path time [s]" if step_ms == 1 else f"path time [s], every {step_ms} ms")
    figure.align_ylabels()
    figure.suptitle(title, x=0.01, ha="left")
    figure.legend(
        handles=[
            Line2D([], [], label="commanded", **COMMANDED),
            Line2D([], [], label="executed", **EXECUTED),
            Line2D([], [], label="knots (records, set-points)", **KNOTS),
            Line2D([], [], label="limit", **LIMIT),
            Patch(label="tolerance", **TOLERANCE),
        ],
        loc="outside upper right",
        ncols=5,
        frameon=False,
    )
    return figure


class Knots(NamedTuple):
    """Where the records or set-points of an axis end; of very many every so many."""

    t_s: Array
    curves_qc: tuple[Array, Array]  # position and velocity
    error_qc: Array

    @classmethod
    def of(cls, axis: AxisPlan) -> Knots:
        every = 1 + len(axis.knots.k) // DRAWN
        k, position, velocity = axis.knots
        k, position, velocity = k[::every], position[::every], velocity[::every]
        commanded_qc = axis.reference.positions(k)[:, axis.column]
        return cls(k / 1000, (position, velocity), position - commanded_qc)


def _draw_curves(
    axes: Axes, axis: AxisPlan, samples: Piece, knots: Knots, commanded: Array, order: int
) -> None:
    def in_units(curve: Array) -> Array:
        return axis.units.from_qc_s(curve) if order else axis.units.from_qc(curve)

    t_s = samples.k / 1000
    until = -1 if order == 2 else None  # in its last instant it already rests
    axes.plot(t_s[:until], commanded[:until], **COMMANDED)
    executed = np.asarray(samples.executed[order], dtype=np.float64)
    axes.plot(t_s, in_units(executed), **EXECUTED)
    if order < 2:  # the acceleration jumps at knots
        axes.plot(knots.t_s, in_units(knots.curves_qc[order]), **KNOTS)
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


def _draw_error(axes: Axes, samples: Piece, knots: Knots, tolerance_qc: float) -> None:
    axes.axhspan(-tolerance_qc, tolerance_qc, **TOLERANCE)
    axes.plot(samples.k / 1000, samples.error_qc, **EXECUTED)
    axes.plot(knots.t_s, knots.error_qc, **KNOTS)
    axes.set_ylim(-1.15 * tolerance_qc, 1.15 * tolerance_qc)
    axes.set_ylabel("[qc]")
