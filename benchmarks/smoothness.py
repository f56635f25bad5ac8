"""Acceleration of the executed curve against the commanded one: ours, and uniform grids."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from epos2_ros.motion.pvt import executed
from epos2_ros.motion.record import Record

from .baselines import pvt_records
from .cases import Case
from .table import Table

TOLERANCE_QC = 1.0
GRIDS_MS = (10, 20, 50)
WEIGHTS = (0.0, 0.25, 0.5, 1.0)
NOTES = (
    "executed less commanded acceleration at every millisecond, over all axes, as a share of the "
    "largest commanded one of the axis; smoothness is ipm.smoothness"
)


def tables(cases: Sequence[Case]) -> Iterator[Table]:
    """One table per trajectory, one row per way of choosing records."""
    for case in cases:
        rows = [
            row(case, f"ours, smoothness {w:g}", case.records(TOLERANCE_QC, w)) for w in WEIGHTS
        ]
        rows += [row(case, f"grid of {ms} ms", on_grid(case, ms)) for ms in GRIDS_MS]
        yield Table(f"Smoothness at {TOLERANCE_QC:g} qc: {case.name}", rows, NOTES)


def on_grid(case: Case, spacing_ms: int) -> list[list[Record]]:
    return [
        pvt_records(position, velocity, units.velocity_unit_qc_s, spacing_ms)
        for position, velocity, units in zip(
            *(values.T for values in case.commanded), case.units, strict=True
        )
    ]


def row(case: Case, way: str, records: Sequence[Sequence[Record]]) -> dict[str, Any]:
    """Errors of position and acceleration over all axes.

    At a millisecond where the acceleration jumps, executed and commanded curve both count with
    what is before it.
    """
    k = np.arange(1, case.reference.end_ms + 1)
    scale = np.array([units.qc_per_unit for units in case.units])
    commanded = case.reference.evaluate((k - 1e-6) / 1000, 2) * scale
    position, _ = case.commanded
    off_qc, off = 0.0, np.empty_like(commanded)
    for axis, (start_qc, units) in enumerate(zip(case.start_qc, case.units, strict=True)):
        curve = executed(start_qc, records[axis], units.velocity_unit_qc_s)
        off_qc = max(off_qc, float(np.abs(curve.position_qc - position[:, axis]).max()))
        off[:, axis] = curve.acceleration_qc_s2[1:] - commanded[:, axis]
    off /= np.abs(commanded).max(axis=0)
    return {
        "records": way,
        "records/s per axis": sum(map(len, records)) / case.seconds / len(records),
        "largest error [qc]": off_qc,
        "acceleration error, RMS [%]": 100 * float(np.sqrt((off**2).mean())),
        "peak [%]": 100 * float(np.abs(off).max()),
    }
