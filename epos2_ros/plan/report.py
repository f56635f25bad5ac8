"""A plan in words: the table of the axes, the figures of the group, the records as CSV."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from html import escape
from typing import TextIO

from epos2_ros.bus.settings import ACCELERATION_HEADROOM, ROUNDING_S, VELOCITY_HEADROOM
from epos2_ros.motion.limits import BEYOND_POINTS, RELATIVE_SLACK
from epos2_ros.plan import move, outputs
from epos2_ros.plan.axis import AxisPlan, SetPointsPlan
from epos2_ros.plan.move import MovePlan
from epos2_ros.plan.outputs import OutputPlans
from epos2_ros.plan.planning import Plan

HEADINGS = (
    *("axis", "records", "per s", "error [qc]", "position from", "to", "allowed"),
    *("velocity", "allowed", "acceleration", "allowed"),
)
Row = tuple[str, ...]
BEYOND = "*"  # marks what is beyond a limit of the joint
BEYOND_NOTE = (
    f"{BEYOND} beyond the limit, which the commanded curve keeps: records are rounded; drives "
    f"fault at {VELOCITY_HEADROOM:.0%} of the velocity and {ACCELERATION_HEADROOM:.0%} of the "
    f"acceleration, and what a count more within {ROUNDING_S * 1000:g} ms takes on top"
)
QUEUED = "°"  # marks who gets no records
QUEUED_NOTE = (
    f"{QUEUED} set-points of profile position mode: the drive has no buffer of records, and is as "
    "near to the commanded curve as the error says, whatever the tolerance"
)
CSV_COLUMNS = ("joint", "record", "path_ms", "position_qc", "velocity", "time_ms", "frame")


def text(plan: Plan) -> str:
    """For a terminal, section by section."""
    return _sections(
        _table(HEADINGS, rows(plan)) + notes(plan), plan.outputs, _listed(figures(plan))
    )


def move_text(plan: MovePlan) -> str:
    """Likewise, of a move in profile position mode."""
    return _sections(_table(move.HEADINGS, plan.rows), plan.outputs, _listed(plan.figures))


def _sections(axes: list[str], plans: OutputPlans, group: list[str]) -> str:
    fired = _table(outputs.HEADINGS, plans.rows) if plans.outputs else []
    sections = (axes, fired + plans.notes, group)
    return "\n\n".join("\n".join(lines) for lines in sections if lines)


def _table(headings: Row, rows: Sequence[Row]) -> list[str]:
    table = [headings, *rows]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    return [_line(row, widths) for row in table]


def _listed(figures: Sequence[tuple[str, str]]) -> list[str]:
    width = max(len(name) for name, _ in figures)
    return [f"{name:{width}}  {value}" for name, value in figures]


def page(plan: Plan, title: str, source: str, drawing: str) -> str:
    """The same as a web page that needs nothing else; `drawing` is SVG."""
    table = _html_table(HEADINGS, rows(plan))
    if plan.outputs.outputs:
        table += _html_table(outputs.HEADINGS, plan.outputs.rows)
    group = (f"<dt>{escape(name)}</dt><dd>{escape(value)}</dd>" for name, value in figures(plan))
    return _PAGE.format(
        title=escape(title),
        source="<br>\n".join(map(escape, source.splitlines())),
        table=table,
        notes="\n".join(f"<p>{escape(note)}</p>" for note in [*notes(plan), *plan.outputs.notes]),
        group="\n".join(group),
        drawing=drawing[drawing.index("<svg") :],
    )


def write_csv(plan: Plan, file: TextIO) -> None:
    """The records and set-points of each axis as its drive gets them, in order.

    `velocity` is in the drive's velocity units, `path_ms` when the segment ends, `frame` as
    `cansend` takes it; a set-point's parameters are two. Record 0 is not sent, it is where the axis
    stands at the start; a Copley drive gets that position before the first segment.
    """
    table = csv.writer(file)
    table.writerow(CSV_COLUMNS)
    for axis in plan.axes:
        joint = axis.config.joint
        table.writerow((joint, 0, 0, axis.start_qc, 0, 0, ""))
        for number, (end_ms, *told, frames) in enumerate(axis.sent(), 1):
            text = " ".join(f"{frame.can_id:03X}#{frame.data.hex().upper()}" for frame in frames)
            table.writerow((joint, number, end_ms, *told, text))


def rows(plan: Plan) -> list[tuple[str, ...]]:
    """The cells of the table: a row for each axis, and one for all."""
    records = sum(axis.count for axis in plan.axes)
    total = ("all", f"{records}", _per_second(records, plan))
    return [
        *(_row(plan, axis, column) for column, axis in enumerate(plan.axes)),
        total + ("",) * (len(HEADINGS) - len(total)),
    ]


def notes(plan: Plan) -> list[str]:
    """What has to be said of the table."""
    said = [BEYOND_NOTE] if any(BEYOND in cell for row in rows(plan) for cell in row) else []
    if any(isinstance(axis, SetPointsPlan) for axis in plan.axes):
        said.append(QUEUED_NOTE)
    if plan.reference.remark:
        said.append(f"warning: {BEYOND_POINTS}: {plan.reference.remark}")
    return said + [f"warning: {remark}" for remark in plan.remarks]


def figures(plan: Plan) -> list[tuple[str, str]]:
    """Name and value of what concerns the group."""
    load, latency = plan.load, plan.latency
    return [
        ("duration", f"{plan.duration_s:.3f} s"),
        (
            "bus load",
            f"{load.sent + load.others:.1%} at {plan.config.bitrate / 1e6:g} Mbit/s: "
            f"{_kinds(plan)} {load.sent:.1%}, SYNC and reports of the drives {load.others:.1%}; "
            f"{load.busiest:.1%} in the busiest second",
        ),
        (
            "first motion",
            f"{latency.total_ms:.0f} ms after the message is there: {latency.sent} {_kinds(plan)} "
            f"fitted ({latency.computing_ms:.0f} ms, measured here), sent and reported by the "
            "drives, start sent; delays of the adapter come on top",
        ),
    ]


def _row(plan: Plan, axis: AxisPlan, column: int) -> tuple[str, ...]:
    config, limits = axis.config, plan.limits
    lowest, highest, error_qc = axis.extremes
    velocity, acceleration = axis.peaks
    return (
        f"{config.joint} [{axis.units.unit}]",
        f"{QUEUED if isinstance(axis, SetPointsPlan) else ''}{axis.count}",
        _per_second(axis.count, plan),
        f"{error_qc:.2f}",
        _fixed(lowest, 5),
        _fixed(highest, 5),
        _range(config.min_position, config.max_position),
        *_against(velocity, float(limits.velocity[column]), 4),
        *_against(acceleration, float(limits.acceleration[column]), 3),
    )


def _kinds(plan: Plan) -> str:
    """What the axes are sent."""
    queued = {isinstance(axis, SetPointsPlan) for axis in plan.axes}
    kinds = {False: "records", True: "set-points"}
    return " and ".join(kinds[kind] for kind in sorted(queued))


def _per_second(records: int, plan: Plan) -> str:
    return f"{records / plan.duration_s:.1f}" if plan.duration_s else ""


def _range(low: float | None, high: float | None) -> str:
    if low is None and high is None:
        return "any"
    return f"{'−∞' if low is None else f'{low:g}'} … {'∞' if high is None else f'{high:g}'}"


def _against(value: float, limit: float, digits: int) -> tuple[str, str]:
    """A largest value, marked if it is beyond the limit, and the limit."""
    mark = BEYOND if value > limit * (1 + RELATIVE_SLACK) else ""
    return mark + _fixed(value, digits), f"{limit:.4g}" if math.isfinite(limit) else "any"


def _fixed(value: float, digits: int) -> str:
    return f"{round(float(value), digits) + 0.0:.{digits}f}"  # never -0.00


def _line(row: tuple[str, ...], widths: list[int]) -> str:
    name, *cells = row
    numbers = (f"{cell:>{width}}" for cell, width in zip(cells, widths[1:], strict=True))
    return "  ".join((f"{name:{widths[0]}}", *numbers)).rstrip()


def _html_table(headings: Row, rows: Sequence[Row]) -> str:
    lines = [_html_row("th", headings), *(_html_row("td", row) for row in rows)]
    return "\n".join(["<table>", *lines, "</table>\n"])


def _html_row(tag: str, row: tuple[str, ...]) -> str:
    return f"<tr>{''.join(f'<{tag}>{escape(cell)}</{tag}>' for cell in row)}</tr>"


_PAGE = """<!DOCTYPE html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>
body {{ font: 15px/1.5 system-ui, sans-serif; max-width: 1300px; margin: 2em auto; }}
h1 {{ font-size: 1.4em; }}
table {{ border-collapse: collapse; font-variant-numeric: tabular-nums; }}
th, td {{ padding: 0.2em 0.8em; text-align: right; border-bottom: 1px solid #ddd; }}
th:first-child, td:first-child {{ text-align: left; padding-left: 0; }}
dl {{ display: grid; grid-template-columns: max-content auto; gap: 0.2em 1.5em; }}
dt {{ font-weight: 600; }}
dd {{ margin: 0; }}
svg {{ width: 100%; height: auto; }}
</style>
<h1>{title}</h1>
<p>{source}</p>
{table}
{notes}
<dl>
{group}
</dl>
{drawing}
</html>
"""
