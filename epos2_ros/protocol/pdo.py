"""PDOs as values: what is mapped into which, and how it is sent (CiA 301, 7.2.2)."""

from __future__ import annotations

from dataclasses import dataclass

SYNCHRONOUS = 1
ASYNCHRONOUS = 255


@dataclass(frozen=True)
class PdoMapping:
    """One PDO of a drive: number (1–4), COB-ID without the node id, objects.

    `of_node`: the node whose COB-ID it is; None: the drive's own.
    """

    number: int
    cob_id: int
    transmission_type: int
    objects: tuple[tuple[int, int], ...]
    of_node: int | None = None
