"""Position-triggered outputs: what should fire along a trajectory, and what the topics told.

Worked out without the driver's own code: positions on a fine grid, whole counts, one step after
another. A value V is crossed upward when the encoder goes from V − 1 to V, that is at V − ½.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from epos2_ros.demo.commanded import Commanded, Scale

if TYPE_CHECKING:
    from epos2_ros.demo.report import AxisResult

GRID_S = 1e-4  # between two of its points the curve is straight, to a thousandth of a count


class Event(NamedTuple):
    """A message on the topic of an output."""

    t_us: float  # CLOCK_MONOTONIC
    position: float  # [unit]
    velocity: float  # [unit/s]


class Crossing(NamedTuple):
    """An output fires, or is told to have fired."""

    t_s: float  # path time
    count_qc: int
    rising: bool


@dataclass(frozen=True)
class OutputResult:
    """One output: what should have come on its topic, and what has."""

    name: str
    joint: str
    expected: tuple[Crossing, ...]
    told: tuple[Crossing, ...]

    @classmethod
    def of(
        cls,
        name: str,
        parameters: Mapping[str, Any],
        commanded: Commanded,
        joints: Sequence[str],
        axis: AxisResult,
        events: Sequence[Event],
    ) -> OutputResult:
        """Of one output on `axis`, whose start gives the time; `joints` are the trajectory's."""
        scale, start_us = axis.scale, axis.executed.start_us
        told = (
            Crossing(
                (event.t_us - start_us) * 1e-6,
                round(float(scale.to_qc(np.float64(event.position)))),
                event.velocity * scale.qc_per_unit > 0,
            )
            for event in events
        )
        column = joints.index(scale.joint)
        expected = expected_of(name, parameters, commanded, column, scale)
        return cls(name, scale.joint, tuple(expected), tuple(told))

    @property
    def failure(self) -> str:
        """In words how number, order or positions differ; "" if they don't."""
        if len(self.told) != len(self.expected):
            return f"{self.name}: {len(self.told)} events, expected {len(self.expected)}"
        for n, (told, expected) in enumerate(zip(self.told, self.expected, strict=True), 1):
            if told[1:] != expected[1:]:
                return (
                    f"{self.name}: event {n} at {told.count_qc} qc {_way(told)}, "
                    f"expected at {expected.count_qc} qc {_way(expected)}"
                )
        return ""

    @property
    def late_us(self) -> tuple[float, float]:
        """Of the times: the median error, and the largest distance of one from it [µs]."""
        pairs = zip(self.told, self.expected, strict=False)
        late = np.array([told.t_s - expected.t_s for told, expected in pairs]) * 1e6
        if not len(late):
            return 0.0, 0.0
        median = float(np.median(late))
        return median, float(np.max(np.abs(late - median)))


def _way(crossing: Crossing) -> str:
    return "upward" if crossing.rising else "downward"


def outputs_of(parameters: Mapping[str, Any], joints: Sequence[str]) -> list[str]:
    """Those whose crossings can be worked out here: positions or intervals on these joints."""
    return [
        name
        for name in parameters.get("outputs") or ()
        if parameters.get(f"compare.{name}.joint") in joints
        and parameters.get(f"compare.{name}.kind") in ("crossing", "interval")
        and f"compare.{name}.end" not in parameters
    ]


def expected_of(
    name: str, parameters: Mapping[str, Any], commanded: Commanded, column: int, scale: Scale
) -> list[Crossing]:
    """Every crossing of one output's positions on the way along the trajectory."""

    def value(parameter: str, default: Any = None) -> Any:
        return parameters.get(f"compare.{name}.{parameter}", default)

    t_s = np.arange(0.0, commanded.duration_s + GRID_S, GRID_S)
    q = scale.to_qc(commanded.at(t_s)[:, column]) + 0.5
    if value("kind") == "interval":
        origin = round(float(scale.to_qc(np.float64(value("start")))))
        step = round(value("interval") * abs(scale.qc_per_unit))
        numbers = np.arange((min(q) - origin) // step, (max(q) - origin) // step + 1)
        counts = origin + step * numbers.astype(int)
    else:
        counts = np.array([round(float(scale.to_qc(np.float64(p)))) for p in value("positions")])
    wanted = {"both": (True, False), "up": (True,), "down": (False,)}[value("direction", "both")]
    up = scale.qc_per_unit > 0
    found = []
    for count in counts:
        above = q >= count
        for i in np.flatnonzero(above[1:] != above[:-1]):
            share = (count - q[i]) / (q[i + 1] - q[i])
            rising = bool(above[i + 1])
            if (rising == up) in wanted:
                found.append(Crossing(float(t_s[i] + share * GRID_S), int(count), rising))
    return sorted(found)
