"""Acceleration of the executed curve against the commanded one: ours, and uniform grids."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from epos2_ros.motion.pvt import executed
from epos2_ros.motion.record import Record

from .baselines import pvt_records
from .cases import SMOOTHNESS, Case
from .frames import PvtGrid, common_spacing
from .table import Table

TOLERANCE_QC = 1.0
GRIDS_MS = (10, 20, 50)
WEIGHTS = {"fewest": 0.0, "default": SMOOTHNESS, "smoothest": 10.0}
NOTES = (
    "executed less commanded acceleration at every millisecond, over all axes, as a share of the "
    "largest commanded one of the axis; smoothness is ipm.smoothness"
)


def tables(cases: Sequence[Case]) -> Iterator[Table]:
    """One table per trajectory, one row per way of choosing records."""
    for case in cases:
        rows = [
            row(case, f"{name}, smoothness {weight:g}", case.records(TOLERANCE_QC, weight))
            for name, weight in WEIGHTS.items()
        ]
        same, *_ = common_spacing(PvtGrid(case), TOLERANCE_QC)
        for ms in (*GRIDS_MS, same):
            as_exact = f", the widest for {TOLERANCE_QC:g} qc" if ms == same else ""
            rows.append(row(case, f"grid of {ms} ms{as_exact}", on_grid(case, ms)))
        yield Table(f"Smoothness at {TOLERANCE_QC:g} qc: {case.name}", rows, NOTES)


def summary(cases: Sequence[Case]) -> Table:
    """The fewest records, the default, and the widest grid that keeps the tolerance."""
    rows = []
    for case in cases:
        spacing_ms, *_ = common_spacing(PvtGrid(case), TOLERANCE_QC)
        ways = {
            "fewest": case.records(TOLERANCE_QC, 0.0),
            "default": case.records(TOLERANCE_QC, SMOOTHNESS),
            "grid": on_grid(case, spacing_ms),
        }
        fewest, default, grid = (row(case, name, records) for name, records in ways.items())
        per_s, error = "records/s per axis", "acceleration error, RMS [%]"
        rows.append(
            {
                "trajectory": case.name,
                **{f"{way['records']} [records/s]": way[per_s] for way in (fewest, default, grid)},
                "default: more than fewest [%]": 100 * (default[per_s] / fewest[per_s] - 1),
                **{f"{way['records']}: RMS [%]": way[error] for way in (fewest, default, grid)},
            }
        )
    title = (
        f"Smoothness at {TOLERANCE_QC:g} qc: fewest records, default ({SMOOTHNESS:g}), widest grid"
    )
    return Table(title, rows, NOTES)


def on_grid(case: Case, spacing_ms: int) -> list[list[Record]]:
    return [pvt_records(*axis, spacing_ms) for axis in case.curves]


def row(case: Case, way: str, records: Sequence[Sequence[Record]]) -> dict[str, Any]:
    """Errors of position and acceleration over all axes.

    At a millisecond where the acceleration jumps, executed and commanded curve both count with
    what is before it.
    """
    k = np.arange(1, case.reference.end_ms + 1)
    scale = np.array([units.qc_per_unit for units in case.units])
    commanded = case.reference.evaluate((k - 1e-6) / 1000, 2) * scale
    off_qc, off = 0.0, np.empty_like(commanded)
    for axis, (position, _, unit) in enumerate(case.curves):
        curve = executed(case.start_qc[axis], records[axis], unit)
        off_qc = max(off_qc, float(np.abs(curve.position_qc - position).max()))
        off[:, axis] = curve.acceleration_qc_s2[1:] - commanded[:, axis]
    off /= np.abs(commanded).max(axis=0)
    return {
        "records": way,
        "records/s per axis": sum(map(len, records)) / case.seconds / len(records),
        "largest error [qc]": off_qc,
        "acceleration error, RMS [%]": 100 * float(np.sqrt((off**2).mean())),
        "peak [%]": 100 * float(np.abs(off).max()),
    }
