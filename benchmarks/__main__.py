"""Tables of docs/motion.md and docs/mixed.md, also as JSON: `python -m benchmarks [TABLE …]`."""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
from collections.abc import Callable, Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

from . import cases, frames, optimum, set_points, smoothness, speed
from .table import Table

DEFAULT_SEEDS = (1, 2, 3)
PLANNED = ("pick_place", "jerk_limited")
QUICK = ("jerk_limited", "raster_scan")  # what the exhaustive search does in minutes

Tables = Callable[[argparse.Namespace], Iterator[Table]]
TABLES: dict[str, tuple[Tables, str]] = {
    "frames": (
        lambda chosen: frames.tables(cases.all_cases(chosen.seeds)),
        "records and bits on the bus against a PVT grid and linear interpolation",
    ),
    "optimum": (
        lambda chosen: optimum.tables(
            list(map(cases.example, cases.EXAMPLES if chosen.all else QUICK))
        ),
        "number of records against the fewest there can be; minutes",
    ),
    "set-points": (
        lambda chosen: set_points.tables(list(map(cases.example, PLANNED))),
        "error of axes that follow by set-points against the best (docs/mixed.md); minutes",
    ),
    "smoothness": (
        lambda chosen: chain(
            [smoothness.summary(cases.all_cases(chosen.seeds))],
            smoothness.tables(cases.all_cases(chosen.seeds[:1])),
        ),
        "acceleration of the executed curve against the commanded one",
    ),
    "speed": (
        lambda chosen: speed.tables(chosen.points),
        "conversion speed, memory, latency",
    ),
}


def main(argv: Sequence[str] | None = None) -> int:
    """Print each table as soon as it is there, and write them all in the end."""
    chosen = arguments(argv)
    print(f"{machine()}\n")
    tables = []
    for name in chosen.tables:
        for table in TABLES[name][0](chosen):
            print(text(table), flush=True)
            tables.append({"name": name, **table._asdict()})
    content = {"machine": machine(), "seeds": chosen.seeds, "tables": tables}
    chosen.json.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", "utf-8")
    print(f"written to {chosen.json}")
    return 0


def arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="benchmarks",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog="\n".join(f"{name:12}{what}" for name, (_, what) in TABLES.items()),
    )
    parser.add_argument(
        "tables", nargs="*", metavar="TABLE", help=f"{', '.join(TABLES)}; default: all"
    )
    parser.add_argument(
        "--json", type=Path, default=Path("benchmarks.json"), help="default: %(default)s"
    )
    parser.add_argument(
        "--seeds", type=int, nargs="+", default=list(DEFAULT_SEEDS), help="of planned trajectories"
    )
    parser.add_argument("--all", action="store_true", help="optimum: of all four examples")
    parser.add_argument(
        "--points", type=int, default=max(speed.POINTS), help="speed: up to so many"
    )
    chosen = parser.parse_args(argv)
    unknown = [name for name in chosen.tables if name not in TABLES]
    if unknown:
        parser.error(f"no table {unknown[0]!r}: one of {', '.join(TABLES)}")
    chosen.tables = chosen.tables or list(TABLES)
    return chosen


def machine() -> str:
    return f"CPython {platform.python_version()}, {os.cpu_count()} cores, {platform.machine()}"


def text(table: Table) -> str:
    """The table in Markdown."""
    columns = list(table.rows[0])
    lines = [
        f"## {table.title}",
        "",
        f"| {' | '.join(columns)} |",
        f"|{'---|' * len(columns)}",
        *(f"| {' | '.join(written(row[column]) for column in columns)} |" for row in table.rows),
        "",
    ]
    return "\n".join(lines + ([f"({table.notes})", ""] if table.notes else []))


def written(value: Any) -> str:
    """Three digits of a float, all of an integer."""
    if not isinstance(value, float):
        return str(value)
    digits = 0 if abs(value) >= 100 else 1 if abs(value) >= 10 else 2
    return f"{value:.{digits}f}"


if __name__ == "__main__":
    sys.exit(main())
