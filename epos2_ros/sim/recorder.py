"""What a simulated drive really did, control cycle by control cycle, for tests and logs."""

from __future__ import annotations

from array import array
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

COLUMNS = ("time_us", "path_ms", "demand_qc", "actual_qc", "buffer_level")


class Recorder:
    """Columns of one axis, appended to in every control cycle with ip mode active."""

    def __init__(self) -> None:
        self.time_us = array("d")  # true time
        self.path_ms = array("l")
        self.demand_qc = array("d")
        self.actual_qc = array("d")
        self.buffer_level = array("l")
        self._motion = 0  # where the last motion begins

    def begin(self) -> None:
        """A motion starts."""
        self._motion = len(self.path_ms)

    def add(
        self, time_us: float, path_ms: int, demand_qc: float, actual_qc: float, level: int
    ) -> None:
        self.time_us.append(time_us)
        self.path_ms.append(path_ms)
        self.demand_qc.append(demand_qc)
        self.actual_qc.append(actual_qc)
        self.buffer_level.append(level)

    def executed(self) -> list[tuple[int, float]]:
        """(path time [ms], position demand [qc]) of the last motion."""
        return list(
            zip(self.path_ms[self._motion :], self.demand_qc[self._motion :], strict=True)
        )

    def arrays(self) -> dict[str, np.ndarray[Any, Any]]:
        """All columns, each of shape [cycles]."""
        return {column: np.array(getattr(self, column)) for column in COLUMNS}


def save(path: str | Path, recorders: Iterable[tuple[int, Recorder]]) -> None:
    """Writes an .npz file with `node_<id>_<column>` for each (node id, recorder)."""
    columns: dict[str, Any] = {
        f"node_{node_id}_{column}": values
        for node_id, recorder in recorders
        for column, values in recorder.arrays().items()
    }
    np.savez_compressed(path, **columns)
