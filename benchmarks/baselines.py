"""How others send a motion: PVT records, or set-points, at equal distances in time.

Positions are rounded to whole counts and velocities to whole velocity units, as the drive's
objects hold them, and the curve is looked at every millisecond, as the drive does.

`position_qc` and `velocity_qc_s` are the commanded curve of an axis at k = 0 … end [ms]; it
begins at rest at a whole count.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from epos2_ros.motion.pvt import executed
from epos2_ros.motion.record import Record

Array = NDArray[np.float64]
WIDEST_MS = 255  # time of a record, and interpolation time period 0x60C2-01 in ms: eight bits
SLACK_QC = 1e-6


def grid(end_ms: int, spacing_ms: int) -> NDArray[np.int64]:
    """0, then every `spacing_ms`, then the end."""
    return np.append(np.arange(0, end_ms, spacing_ms), end_ms)


def pvt_records(
    position_qc: Array, velocity_qc_s: Array, velocity_unit_qc_s: float, spacing_ms: int
) -> list[Record]:
    """Records on a grid, rounded, with the one that ends the motion."""
    k = grid(len(position_qc) - 1, spacing_ms)
    positions = np.rint(position_qc[k]).astype(int).tolist()
    velocities = np.rint(velocity_qc_s[k] / velocity_unit_qc_s).astype(int).tolist()
    velocities[-1] = 0
    records = map(Record, positions[1:], velocities[1:], np.diff(k).tolist())
    return [*records, Record(positions[-1], 0, 0)]


def pvt_errors(position_qc: Array, velocity_qc_s: Array, velocity_unit_qc_s: float) -> Array:
    """Largest error [qc] with every spacing 0 … 255 ms; no spacing, no error."""
    start_qc = round(position_qc[0])
    errors = np.zeros(WIDEST_MS + 1)
    for spacing_ms in range(1, len(errors)):
        records = pvt_records(position_qc, velocity_qc_s, velocity_unit_qc_s, spacing_ms)
        curve = executed(start_qc, records, velocity_unit_qc_s)
        errors[spacing_ms] = np.abs(curve.position_qc - position_qc).max()
    return errors


def set_points(position_qc: Array, spacing_ms: int) -> list[int]:
    """0x60C1 set-points, one for the end of each period; the curve rests after its end."""
    k = np.arange(spacing_ms, len(position_qc) - 1 + spacing_ms, spacing_ms)
    at = position_qc[np.minimum(k, len(position_qc) - 1)]
    return [round(position) for position in at.tolist()]


def linear(start_qc: int, points: list[int], spacing_ms: int) -> Array:
    """The curve a drive makes of set-points by linear interpolation, at every millisecond."""
    k = np.arange(len(points) * spacing_ms + 1)
    return np.interp(k, k[::spacing_ms], [start_qc, *points])


def linear_errors(position_qc: Array) -> Array:
    """Largest error [qc] with every spacing 0 … 255 ms; no spacing, no error."""
    start_qc, end_ms = round(position_qc[0]), len(position_qc) - 1
    errors = np.zeros(WIDEST_MS + 1)
    for spacing_ms in range(1, len(errors)):
        curve = linear(start_qc, set_points(position_qc, spacing_ms), spacing_ms)
        held = np.pad(position_qc, (0, len(curve) - 1 - end_ms), mode="edge")
        errors[spacing_ms] = np.abs(curve - held).max()
    return errors


def luckiest(errors: Array, tolerance_qc: float) -> int:
    """The widest spacing that keeps the tolerance, though narrower ones may not [ms].

    ValueError if none does, not even every millisecond.
    """
    return _some(int(np.flatnonzero(errors <= tolerance_qc + SLACK_QC)[-1]), tolerance_qc)


def reliable(errors: Array, tolerance_qc: float) -> int:
    """The widest spacing that keeps the tolerance as all narrower ones do [ms].

    ValueError if none does, not even every millisecond.
    """
    beyond = np.append(errors, np.inf) > tolerance_qc + SLACK_QC
    return _some(int(np.argmax(beyond)) - 1, tolerance_qc)


def _some(spacing_ms: int, tolerance_qc: float) -> int:
    if spacing_ms == 0:
        raise ValueError(f"no spacing keeps {tolerance_qc:g} qc")
    return spacing_ms
