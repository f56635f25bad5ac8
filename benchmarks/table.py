"""A table as plain data."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple


class Table(NamedTuple):
    """Rows with the same columns; units are in the columns' names."""

    title: str
    rows: Sequence[dict[str, Any]]
    notes: str = ""
