"""How far axes that follow by set-points are from the commanded curve, against the best."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from time import process_time

from epos2_ros.motion.setpoints import LONGEST_MS, SetPointAxis, SetPointFitter

from .cases import Case
from .profiles import smallest_error
from .table import Table

MAX_VELOCITY, MAX_ACCELERATION = 3.0, 10.0  # [rad/s], [rad/s²], as in config/mixed.yaml
VELOCITY_HEADROOM, ACCELERATION_HEADROOM = 1.05, 1.25  # as of the drives' own limits
UNIT_RPM = 0.01
SYNC_MS = 10.0  # where an axis stands it goes on at multiples of it
NOTES = (
    f"errors in qc at every millisecond; limits {MAX_VELOCITY:g} rad/s and "
    f"{MAX_ACCELERATION:g} rad/s², 31,831 qc/rad; units of {UNIT_RPM:g} rpm; best: the whole "
    "motion known, whatever number for a velocity"
)


def tables(cases: Sequence[Case]) -> Iterator[Table]:
    """A row for each axis."""
    rows = []
    for case in cases:
        for column, (position_qc, velocity_qc_s, _) in enumerate(case.curves):
            axis = axis_of(case, column)
            fitter = SetPointFitter(axis, column)
            begun_s = process_time()
            count = followed(fitter, case)
            taken_ms = 1000 * (process_time() - begun_s) / max(count, 1)
            best = smallest_error(position_qc, velocity_qc_s, axis, LONGEST_MS, fitter.error_qc)
            rows.append(
                {
                    "trajectory": case.name,
                    "joint": case.configs[column].joint,
                    "set-points": count,
                    "per s": count / case.seconds,
                    "error": fitter.error_qc,
                    "best": best,
                    "ms of CPU each": taken_ms,
                }
            )
    yield Table("Set-points: largest error against the best", rows, NOTES)


def axis_of(case: Case, column: int) -> SetPointAxis:
    """Its limits and units are those of the table."""
    units = case.units[column]
    unit = UNIT_RPM * units.counts_per_turn / 60
    return SetPointAxis(
        unit,
        unit,
        VELOCITY_HEADROOM * abs(units.to_qc_s(MAX_VELOCITY)),
        ACCELERATION_HEADROOM * abs(units.to_qc_s(MAX_ACCELERATION)),
        sync_ms=SYNC_MS,
    )


def followed(fitter: SetPointFitter, case: Case) -> int:
    """How many set-points the motion takes, asked for as soon as there is room."""
    fitter.begin(case.reference, case.start_qc[fitter.column])
    count = 0
    while not fitter.ended:
        count += fitter.next(fitter.due_ms) is not None
    return count
