"""The makers' own object dictionaries as tables, which are beside the project and not in it."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import pytest

SIZES = {"8": 1, "16": 2, "32": 4, "64": 8}


@dataclass(frozen=True)
class Fact:
    """One sub-object as its maker's EDS has it; None where that says nothing."""

    index: int
    subindex: int
    name: str
    size: int  # bytes; 0 for a string or domain
    signed: bool
    access: str
    default: int | None
    limits: tuple[int, int] | None
    mappable: bool

    @property
    def key(self) -> str:
        return f"{self.index:04X}-{self.subindex:02X}"


def facts(file: str, node_id: int) -> list[Fact]:
    """The rows of a maker's table; skips the test where it is not there."""
    for folder in Path(__file__).resolve().parents:
        path = folder / "shared" / "objects" / file
        if path.exists():
            with path.open(encoding="utf-8") as text:
                return [_fact(row, node_id) for row in csv.DictReader(text)]
    pytest.skip(f"the maker's table {file} is not beside the project")


def _fact(row: dict[str, str], node_id: int) -> Fact:
    size, signed = SIZES.get(row["type"][1:], 0), row["type"].startswith("i")

    def number(text: str) -> int | None:
        if not text or not size:
            return None
        of_node = text.startswith("$NODEID+")
        value = int(text.removeprefix("$NODEID+"), 0) + (node_id if of_node else 0)
        return value - (1 << 8 * size) if signed and value >> 8 * size - 1 == 1 else value

    low, high = number(row["low"]), number(row["high"])
    return Fact(
        int(row["index"], 16),
        int(row["subindex"]),
        row["name"],
        size,
        signed,
        row["access"],
        number(row["default"]),
        None if low is None or high is None else (low, high),
        row["pdo_mappable"] == "1",
    )
