"""Object dictionaries as their makers write them down: one line of text per sub-object.

The columns are index, sub-index (or a range of like ones), type, access (with * where it can be
mapped into a PDO), default (-: none; id+n: counts from the node id), range (-: none), name.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from .dictionary import (
    INTEGER8,
    INTEGER16,
    INTEGER32,
    OCTET_STRING,
    UNSIGNED8,
    UNSIGNED16,
    UNSIGNED32,
    UNSIGNED64,
    VISIBLE_STRING,
    DataType,
)

_TYPES = {
    "u8": UNSIGNED8,
    "u16": UNSIGNED16,
    "u32": UNSIGNED32,
    "u64": UNSIGNED64,
    "i8": INTEGER8,
    "i16": INTEGER16,
    "i32": INTEGER32,
    "str": VISIBLE_STRING,
    "bytes": OCTET_STRING,
}


@dataclass(frozen=True)
class Row:
    """One sub-object. `low` and `high` are None where the EDS gives no range, `default` where it
    gives none; a default that counts from the node id has it added by `of_node`.
    """

    index: int
    subindex: int
    type: DataType
    access: str
    mappable: bool
    default: int | None
    of_node: bool
    low: int | None
    high: int | None
    name: str

    def default_of(self, node_id: int) -> int | None:
        """The default of the drive with this node id."""
        if self.default is None or not self.of_node:
            return self.default
        return self.default + node_id


@dataclass(frozen=True)
class PdoRow:
    """A PDO as the drive leaves the factory."""

    cob_id: int  # without the node id
    mapping: tuple[int, ...]


def parse(table: str) -> tuple[Row, ...]:
    """All rows of a table."""
    return tuple(row for line in table.strip().splitlines() for row in _rows(line))


def _rows(line: str) -> Iterator[Row]:
    index, subindices, kind, access, default, span, name = line.split(maxsplit=6)
    low, _, high = span.partition("..")
    first, _, last = subindices.partition("-")
    for subindex in range(int(first), int(last or first) + 1):
        yield Row(
            int(index, 16),
            subindex,
            _TYPES[kind],
            access.rstrip("*"),
            access.endswith("*"),
            None if default == "-" else int(default.removeprefix("id+"), 0),
            default.startswith("id+"),
            int(low, 0) if high else None,
            int(high, 0) if high else None,
            name,
        )
