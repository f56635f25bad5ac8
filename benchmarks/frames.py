"""Records and bits on the bus at equal error: ours, PVT on a uniform grid, linear interpolation.

Frames as they are on the bus, stuff bits and the gap between frames included: a record is an
RPDO of 8 bytes, a set-point (0x60C1-01) one of 4. SYNC and what the drives report are the same
for all and left out.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from epos2_ros.protocol import epos2
from epos2_ros.sim.can_bus import INTERFRAME_BITS, frame_bits

from .baselines import (
    Array,
    linear_errors,
    luckiest,
    pvt_errors,
    pvt_records,
    reliable,
    set_points,
)
from .cases import Case
from .table import Table

TOLERANCES_QC = (1.0, 2.0, 5.0, 10.0)
NOTES = (
    "× says how many times as many as ours. PVT grid, linear: one spacing for all axes, the "
    "widest that keeps the tolerance as all narrower ones do; best: for each axis the widest that "
    "happens to keep it."
)
_SET_POINT = struct.Struct("<i")


def tables(cases: Sequence[Case]) -> Iterator[Table]:
    """One table for each tolerance."""
    others = [(PvtGrid(case), Linear(case)) for case in cases]
    for tolerance_qc in TOLERANCES_QC:
        rows = [row(case, *ways, tolerance_qc) for case, ways in zip(cases, others, strict=True)]
        yield Table(f"Frames per axis and second at {tolerance_qc:g} qc", rows, NOTES)


def row(case: Case, grid: Uniform, linear: Uniform, tolerance_qc: float) -> dict[str, Any]:
    """Frames and bits of all axes together."""
    records = case.records(tolerance_qc)
    ours = spent(case, [[record.pack() for record in axis] for axis in records])
    axis_seconds = case.seconds * len(case.configs)
    result: dict[str, Any] = {
        "trajectory": case.name,
        "ours [frames/s]": ours.frames / axis_seconds,
        "ours [bit/s]": ours.bits / axis_seconds,
    }
    for name, way in (("PVT grid", grid), ("linear", linear)):
        theirs = spent(case, way.payloads(common_spacing(way, tolerance_qc)))
        best = spent(case, way.payloads(best_spacings(way, tolerance_qc)))
        result |= {
            f"{name} [frames/s]": theirs.frames / axis_seconds,
            f"{name} × frames": theirs.frames / ours.frames,
            f"{name} × bits": theirs.bits / ours.bits,
            f"{name}, best × frames": best.frames / ours.frames,
        }
    return result


class Uniform(Protocol):
    """A way of sending at equal distances in time."""

    errors: Array  # largest error [qc] with every spacing, [axes, 256]

    def payloads(self, spacings_ms: Sequence[int]) -> list[list[bytes]]:
        """The frames' data, axis by axis, each with its spacing."""


class PvtGrid:
    """Rounded PVT records."""

    def __init__(self, case: Case) -> None:
        self._axes = case.curves
        self.errors = np.array([pvt_errors(*axis) for axis in self._axes])

    def payloads(self, spacings_ms: Sequence[int]) -> list[list[bytes]]:
        return [
            [record.pack() for record in pvt_records(*axis, spacing_ms)]
            for axis, spacing_ms in zip(self._axes, spacings_ms, strict=True)
        ]


class Linear:
    """Rounded set-points between which the drive interpolates linearly."""

    def __init__(self, case: Case) -> None:
        self._positions = [position for position, _, _ in case.curves]
        self.errors = np.array([linear_errors(position) for position in self._positions])

    def payloads(self, spacings_ms: Sequence[int]) -> list[list[bytes]]:
        return [
            [_SET_POINT.pack(point) for point in set_points(position, spacing_ms)]
            for position, spacing_ms in zip(self._positions, spacings_ms, strict=True)
        ]


def common_spacing(way: Uniform, tolerance_qc: float) -> list[int]:
    """One spacing for all axes that can be relied on [ms]."""
    return [reliable(way.errors.max(axis=0), tolerance_qc)] * len(way.errors)


def best_spacings(way: Uniform, tolerance_qc: float) -> list[int]:
    """For each axis the widest spacing that happens to keep the tolerance [ms]."""
    return [luckiest(errors, tolerance_qc) for errors in way.errors]


class Spent(NamedTuple):
    frames: int
    bits: int


def spent(case: Case, payloads: Sequence[Sequence[bytes]]) -> Spent:
    """What the RPDOs of all axes take on the bus."""
    frames = [
        (epos2.RPDO1 + config.node_id, data)
        for config, axis in zip(case.configs, payloads, strict=True)
        for data in axis
    ]
    return Spent(len(frames), sum(frame_bits(*frame) + INTERFRAME_BITS for frame in frames))
