"""What the position-triggered outputs will fire: a table, warnings, and every crossing as CSV."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TextIO

import numpy as np

from epos2_ros.configuration.driver import DriverConfig
from epos2_ros.configuration.outputs import CompareConfig
from epos2_ros.motion.compare import Prediction
from epos2_ros.motion.crossings import Path
from epos2_ros.motion.foresight import Foresight
from epos2_ros.motion.units import AxisUnits
from epos2_ros.protocol.outputs.outputs import Outputs

HEADINGS = (
    *("output", "fires", "first [s]", "last [s]", "position from", "to", "speed from", "to"),
    *("closest [ms]", "error [counts]"),
)
CSV_COLUMNS = (
    *("output", "joint", "event", "time_s", "position", "velocity", "count", "rising"),
    "error_counts",
)


@dataclass(frozen=True)
class OutputPlan:
    """One output along the motion of its joint."""

    config: CompareConfig
    units: AxisUnits
    prediction: Prediction

    @property
    def row(self) -> tuple[str, ...]:
        """Its cells of the table. Speeds are at the crossings; the error is that of an
        extrapolated encoder."""
        fired, units = self.prediction.fired, self.units
        name = f"{self.config.name} on {units.joint} [{units.unit}]"
        if not len(fired):
            return name, "0", *[""] * (len(HEADINGS) - 2)
        position = units.from_qc(fired.count.astype(np.float64))
        speed = np.abs(units.from_qc_s(fired.velocity_qc_s))
        gaps = np.diff(fired.t_us)
        return (
            name,
            f"{len(fired)}",
            f"{fired.t_us[0] * 1e-6:.6f}",
            f"{fired.t_us[-1] * 1e-6:.6f}",
            f"{np.min(position):.6g}",
            f"{np.max(position):.6g}",
            f"{np.min(speed):.4g}",
            f"{np.max(speed):.4g}",
            f"{np.min(gaps) * 1e-3:.3f}" if len(gaps) else "",
            f"{np.max(self.prediction.error_qc):.1f}" if self.config.extrapolated else "",
        )


@dataclass(frozen=True)
class OutputPlans:
    """All outputs on the joints that move."""

    outputs: tuple[OutputPlan, ...] = ()
    remarks: tuple[str, ...] = ()  # of the configuration

    @classmethod
    def of(cls, config: DriverConfig, paths: Mapping[str, Iterable[Path]]) -> OutputPlans:
        """`paths`: by joint, from the start on, piece by piece. ConfigurationError for what drives
        can't do."""
        outputs = Outputs(config.axes, config.outputs, ())
        plans = []
        for index, axis in enumerate(config.axes):
            units, triggers = outputs.units[index], outputs.triggers(index)
            if axis.joint not in paths or not triggers:
                continue
            foreseen = {name: Foresight(trigger, units) for name, trigger in triggers.items()}
            for path in paths[axis.joint]:
                for foresight in foreseen.values():
                    foresight.extend(path)
            for name, foresight in foreseen.items():
                plans.append(OutputPlan(outputs.find(name)[1], units, foresight.prediction()))
        return cls(tuple(plans), tuple(outputs.notices))

    @property
    def rows(self) -> list[tuple[str, ...]]:
        """The table, a row for each output."""
        return [output.row for output in self.outputs]

    @property
    def notes(self) -> list[str]:
        """What is to be said of them."""
        return [
            *self.remarks,
            *(
                f"compare.{output.config.name}: {warning}"
                for output in self.outputs
                for warning in output.prediction.warnings
            ),
        ]


def write_csv(outputs: Sequence[OutputPlan], file: TextIO) -> None:
    """Every crossing, output by output: time from the start, joint units, and counts.

    `rising` says whether counts rise, `error_counts` by how many the crossing may be off where
    the encoder is extrapolated.
    """
    table = csv.writer(file)
    table.writerow(CSV_COLUMNS)
    for output in outputs:
        (fired, errors, _), units = output.prediction, output.units
        for n in range(len(fired)):
            table.writerow(
                (
                    output.config.name,
                    units.joint,
                    n + 1,
                    f"{fired.t_us[n] * 1e-6:.7f}",
                    f"{units.from_qc(float(fired.count[n])):.9g}",
                    f"{units.from_qc_s(float(fired.velocity_qc_s[n])):.6g}",
                    fired.count[n],
                    int(fired.rising[n]),
                    f"{errors[n]:.3g}",
                )
            )
