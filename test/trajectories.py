"""Trajectories for the tests of the motion layer: the examples, and random ones."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from hypothesis import strategies as st
from numpy.typing import NDArray

from epos2_ros.configuration.driver import AxisConfig
from epos2_ros.motion.curve import Curve
from epos2_ros.motion.join import join
from epos2_ros.motion.limits import Limits, extremes
from epos2_ros.motion.reference import Reference
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.motion.units import AxisUnits

Array = NDArray[np.float64]

EXAMPLES = Path(__file__).parents[1] / "examples"
JOINTS = ("a", "b")  # of random trajectories
NAMES = ("jerk_limited", "pick_place", "positions_only", "raster_scan")


def example_message(name: str) -> dict[str, Any]:
    with (EXAMPLES / f"{name}.yaml").open() as file:
        return yaml.load(file, Loader=yaml.CSafeLoader)


def example(name: str) -> Trajectory:
    return Trajectory.from_dict(example_message(name))


def curve_of(trajectory: Trajectory) -> Curve:
    return Curve(
        trajectory.times_s,
        trajectory.positions,
        trajectory.velocities,
        trajectory.accelerations,
    )


def axes_of(names: tuple[str, ...], **limits: float) -> tuple[AxisConfig, ...]:
    return tuple(
        AxisConfig(name, node_id, gear_ratio=100.0, **limits)
        for node_id, name in enumerate(names, start=1)
    )


def polynomial(ends: list[tuple[float, ...]], h: float) -> np.polynomial.Polynomial:
    """The one polynomial with given derivatives at 0 and h; ends = [(p0, v0, …), (p1, v1, …)]."""
    order = len(ends[0])
    rows, values = [], []
    for t, given in zip((0.0, h), ends, strict=True):
        for derivative, value in enumerate(given):
            row = np.zeros(2 * order)
            for power in range(derivative, 2 * order):
                factor = np.prod(np.arange(power, power - derivative, -1.0))
                row[power] = factor * t ** (power - derivative)
            rows.append(row)
            values.append(value)
    return np.polynomial.Polynomial(np.linalg.solve(np.array(rows), np.array(values)))


def numbers(size: float) -> st.SearchStrategy[float]:
    """Values with six digits: what smaller differences do is for the rounding tests."""
    return st.integers(-1_000_000, 1_000_000).map(lambda n: n * size / 1e6)


@st.composite
def trajectories(
    draw: Callable[..., Any],
    kinds: tuple[str, ...] = ("positions", "velocities", "accelerations"),
    joints: tuple[str, ...] = JOINTS,
    first_s: st.SearchStrategy[float] | None = None,
    points: tuple[int, int] = (2, 7),
    size: float = 1.0,
    step_s: tuple[float, float] = (0.02, 2.0),
) -> Trajectory:
    """Anything a message may hold that starts and ends at rest."""
    kind = draw(st.sampled_from(kinds))
    count = draw(st.integers(*points))
    start = draw(first_s) if first_s is not None else 0.0
    steps = draw(
        st.lists(st.floats(*step_s, allow_subnormal=False), min_size=count - 1, max_size=count - 1)
    )

    def values(most: float, still: bool) -> Array:
        flat = draw(
            st.lists(
                numbers(most * size), min_size=count * len(joints), max_size=count * len(joints)
            )
        )
        result = np.array(flat).reshape(count, len(joints))
        if still:
            result[[0, -1]] = 0.0
        return result

    times = start + np.concatenate(([0.0], np.cumsum(steps)))
    given = ("positions", "velocities", "accelerations").index(kind)
    return Trajectory(
        joints,
        times,
        values(3.0, still=False),
        values(2.0, still=True) if given >= 1 else None,
        values(5.0, still=False) if given >= 2 else None,
    )


def gentle(**kwargs: object) -> st.SearchStrategy[Trajectory]:
    return trajectories(size=0.3, step_s=(0.3, 1.5), **kwargs)


def rest(axes: tuple[AxisConfig, ...], position: Array) -> Reference:
    return Reference.at_rest([AxisUnits.of(axis) for axis in axes], position)


def limited(*curves: Curve, share: float) -> tuple[AxisConfig, ...]:
    """Axes whose limits are `share` of the most that any of the curves asks for."""
    most = [
        np.max([np.maximum(e.high, -e.low) for e in (extremes(c)[order] for c in curves)], axis=0)
        for order in (1, 2)
    ]
    return tuple(
        AxisConfig(
            joint,
            i + 1,
            gear_ratio=10.0,
            max_velocity=max(share * float(most[0][i]), 0.01),
            max_acceleration=max(share * float(most[1][i]), 0.01),
        )
        for i, joint in enumerate(JOINTS)
    )


def from_rest(trajectory: Trajectory, axes: tuple[AxisConfig, ...]) -> Reference:
    return join(
        rest(axes, trajectory.positions[0]), trajectory, Limits.of(axes), at_ms=0, start_ms=0
    )
