"""What has been seen, drawn with Rich for a terminal of some size."""

from __future__ import annotations

import math
from collections.abc import Sequence

from rich.bar import Bar
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from epos2_ros.monitor.seen import ERROR, OK, WARN, Axis, Event, Seen

WIDE = 120  # columns from which on states have their whole names, and axes their last event
EVENTS_LEAST = 4  # lines of events that stay, however many axes there are
BAR_WIDTH = 7
KEYS = "[h] halt   [space] quick stop   [↑ ↓] other axes   [q] leave, the axes go on"
STYLES = {OK: "green", WARN: "yellow", ERROR: "bold red"}  # STALE as ERROR
SHORT = {  # of the states of CiA 402
    "not ready to switch on": "not ready",
    "switch on disabled": "off",
    "ready to switch on": "ready",
    "operation enabled": "enabled",
    "quick stop active": "quick stop",
    "fault reaction active": "fault",
    "unknown": "not heard",
}


def style(level: int) -> str:
    """Of a status of this level."""
    return STYLES.get(level, STYLES[ERROR])


def rows(height: int) -> int:
    """How many axes there is room for."""
    return max(1, height - 4 - EVENTS_LEAST)  # header of two lines, names of columns, keys


def draw(seen: Seen, now_s: float, width: int, height: int, first: int = 0) -> RenderableType:
    """All of it in `height` lines of `width` columns; the table begins with axis `first`."""
    axes = list(seen.axes.values())
    shown = axes[first : first + rows(height)]
    silent = seen.silent(now_s)
    left = height - 4 - len(shown)
    events = [_event(event) for event in list(seen.events)[-left:]]
    blank = [Text()] * (left - len(events))
    more = f"   {first + 1} to {first + len(shown)} of {len(axes)}" if shown != axes else ""
    return Group(
        _head(seen),
        _trouble(seen, silent, now_s),
        _table(shown, seen.most_ms, width >= WIDE, silent),
        *events,
        *blank,
        _line(KEYS + more, "reverse"),
    )


def _head(seen: Seen) -> Text:
    bus, parts = seen.bus, [seen.names.node]
    parts.append(bus.get("group", "nothing heard yet"))
    if bus:
        parts.append(f"bus {bus.get('load [%]', '?')} %, {bus.get('controller', '?')}")
        parts.append(f"{bus.get('drives', '?')} drives")
    parts += [f"{name} {count}" for name, count in seen.outputs.items()]
    head = _line("   ".join(map(plain, parts)), "bold")
    head.stylize(style(seen.bus_level), len(parts[0]) + 3, len(parts[0]) + 3 + len(parts[1]))
    return head


def _trouble(seen: Seen, silent: bool, now_s: float) -> Text:
    """The one line that says what is wrong, if something is."""
    if silent:
        since = now_s - seen.heard_s
        age = f" for {since:.0f} s" if math.isfinite(since) else ""
        return _line(f"no /diagnostics{age}: the driver is gone, or not configured", style(ERROR))
    if seen.bus_level >= ERROR:  # why all axes have stopped
        return _line(seen.bus_message, style(ERROR))
    if troubled := seen.in_trouble():
        more = f" (and {len(troubled) - 1} more)" if len(troubled) > 1 else ""
        return _line(f"{troubled[0].joint}: {troubled[0].message}{more}", style(ERROR))
    if seen.bus_level > OK:
        return _line(f"bus: {seen.bus_message}", style(seen.bus_level))
    if seen.dropped:
        return _line(f"{seen.dropped} messages made no sense, and were dropped", style(WARN))
    return Text()


def _table(axes: Sequence[Axis], most_ms: float, wide: bool, silent: bool) -> Table:
    table = Table(box=None, expand=True, padding=(0, 1, 0, 0), header_style="underline")
    table.add_column("axis", no_wrap=True, min_width=8)
    table.add_column("state", no_wrap=True, width=22 if wide else 10)
    table.add_column("position", no_wrap=True, justify="right", width=9)
    table.add_column("velocity", no_wrap=True, justify="right", width=8)
    table.add_column("err qc", no_wrap=True, justify="right", width=6)
    table.add_column("buffer", no_wrap=True, width=BAR_WIDTH)
    table.add_column("ms", no_wrap=True, justify="right", width=5)
    table.add_column("clk µs", no_wrap=True, justify="right", width=6)
    if wide:
        table.add_column("records", no_wrap=True, justify="right", width=7)
        table.add_column("last event", no_wrap=True, ratio=1)
    for axis in axes:
        state = axis.state if wide else SHORT.get(axis.state, axis.state)
        cells: list[RenderableType] = [
            plain(axis.joint),
            Text(plain(state), style(axis.level)),
            _given(axis.position, 4),
            _given(axis.velocity, 4),
            _given(axis.error_qc, 0),
            _buffer(axis, most_ms),
            f"{axis.buffered_ms:.0f}" if axis.size else "",
            _given(axis.clock_us, 0),
        ]
        if wide:
            cells.append(f"{axis.used}/{axis.size}" if axis.size else "")
            cells.append(Text(plain(axis.event), "dim"))
        heard = not silent and axis.state != "unknown"
        table.add_row(*cells, style="" if heard else "dim")
    return table


def _buffer(axis: Axis, most_ms: float) -> RenderableType:
    """The motion in it, a full bar being the most that any axis has had."""
    if axis.size <= 0:
        return Text("none", "dim")
    colour = {OK: "cyan", WARN: "yellow"}.get(axis.buffer_level, "red")
    return Bar(max(most_ms, 1.0), 0, axis.buffered_ms, width=BAR_WIDTH, color=colour)


def _event(event: Event) -> Text:
    return _line(f"{event.time}  {event.text}", "" if event.level == OK else style(event.level))


def _line(text: str, text_style: str) -> Text:
    return Text(plain(text), text_style, no_wrap=True, overflow="ellipsis", end="\n")


def _given(value: float | None, digits: int) -> str:
    if value is None or math.isnan(value):
        return ""
    return f"{round(value, digits) + 0.0:+.{digits}f}"  # never -0


def plain(text: str) -> str:
    """Without what a terminal would take for commands."""
    return "".join(c if c.isprintable() else "?" for c in text)
