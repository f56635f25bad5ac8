"""How far our number of records is from the fewest there can be (exhaustive search)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

from .cases import Case
from .search import fewest
from .table import Table

TOLERANCE_QC = 1.0
NOTES = (
    "records of all axes, the ones that end the motions included; segments of 1 … 255 ms; "
    "smoothness 0"
)


def tables(cases: Sequence[Case]) -> Iterator[Table]:
    """One row per trajectory; axes are searched side by side, in a process for each core."""
    rows = []
    with ProcessPoolExecutor(mp_context=get_context("spawn")) as pool:
        for case in cases:
            best = pool.map(
                fewest, *zip(*case.curves, strict=True), [TOLERANCE_QC] * len(case.curves)
            )
            optimum = list(best)
            ours = [len(records) for records in case.records(TOLERANCE_QC, smoothness=0.0)]
            rows.append(
                {
                    "trajectory": case.name,
                    "optimum": sum(optimum),
                    "ours": sum(ours),
                    "more [%]": more(ours, optimum),
                }
            )
    yield Table(f"Records at {TOLERANCE_QC:g} qc against the true optimum", rows, NOTES)


def more(ours: Sequence[int], optimum: Sequence[int]) -> float:
    """How much more records ours are than the optimum [%]."""
    return 100 * (sum(ours) / sum(optimum) - 1)
