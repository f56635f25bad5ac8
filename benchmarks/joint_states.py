"""How far joint states are from where the axes really are at their stamp.

    python -m benchmarks.joint_states                       # the table of docs/time.md
    python -m benchmarks.joint_states --lag 5               # drives that follow as late as that
    python -m benchmarks.joint_states --standing 1          # hours

In simulated time, six drives whose clocks drift by −100 to +100 ppm, all examples. The truth is
where the motor of the simulated drive was in its control cycles, joined by straight lines. An error
counts beyond one count and 2 % of the following error that the axis has at the time.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from dataclasses import replace as changed

import numpy as np
from simulated_time import Bench, axes
from trajectories import NAMES, example

from epos2_ros.configuration.driver import DriverConfig
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.protocol.whereabouts import Whereabouts
from epos2_ros.sim.epos2 import Epos2

RATES_HZ = (10.0, 50.0, 500.0)
SETTLED_S = 3.0
AFTER_S = 0.3


class Truth(Epos2):
    """A drive that writes down where its motor is in every cycle."""

    def __init__(self, *args: object, **settings: object) -> None:
        self.cycles: list[tuple[float, float, float]] = []  # host µs, demand, motor [qc]
        super().__init__(*args, **settings)  # type: ignore[arg-type]

    def _control(self) -> None:
        super()._control()
        self.cycles.append((self.now_us, self._demand, self._motor.position))


@dataclass
class Compared:
    """Of all joints, at every message. Arrays are [messages, axes] in qc, or qc/s."""

    stamps_us: list[float]
    error: np.ndarray
    allowed: np.ndarray
    velocity_error: np.ndarray

    @property
    def within(self) -> float:
        """Share of the positions that are as near as they have to be."""
        return float(np.mean(np.abs(self.error) <= self.allowed))


def bench(config: DriverConfig, count: int, lag_ms: float) -> Bench:
    drift = np.linspace(-100, 100, count)
    drives = [
        Truth(n + 1, drift_ppm=float(drift[n]), offset_us=1e5 * n, lag_ms=lag_ms)
        for n in range(count)
    ]
    made = Bench(config, drives)
    made.enable()
    made.run(SETTLED_S)
    return made


def watched(
    made: Bench, whereabouts: Whereabouts, rate_hz: float, until: object
) -> Iterator[tuple[float, list[float], list[float]]]:
    """Stamp, positions and velocities of all axes, at the rate, until it says so."""
    while not until():  # type: ignore[operator]
        made.run(1 / rate_hz)
        now = whereabouts.at(made.now_us)
        if len(now) == len(made.drives):
            positions = [axis.position_qc for axis in now]
            yield made.now_us, positions, [axis.velocity_qc_s for axis in now]


def compare(trajectory: Trajectory, rate_hz: float, lag_ms: float = 0.4) -> Compared:
    """A motion there, and the joint states meanwhile."""
    joints = len(trajectory.joint_names)
    config = DriverConfig(
        axes=tuple(
            changed(axis, joint=name)
            for axis, name in zip(axes(joints), trajectory.joint_names, strict=True)
        ),
        state_rate=rate_hz,
    )
    made = bench(config, joints, lag_ms)
    whereabouts = Whereabouts(made.machine)
    made.path.submit(trajectory, None, made.now_us)
    motion = made.group.motion
    rows = list(watched(made, whereabouts, rate_hz, motion.done))
    end_us = made.now_us + AFTER_S * 1e6
    rows += watched(made, whereabouts, rate_hz, lambda: made.now_us > end_us)
    stamps = np.array([row[0] for row in rows])
    columns = []
    for axis, drive in enumerate(made.drives):
        cycles = np.array(drive.cycles)
        demand, motor = (np.interp(stamps, cycles[:, 0], cycles[:, n]) for n in (1, 2))
        speed = np.interp(stamps, cycles[1:, 0] - 500, np.diff(cycles[:, 2]) * 1000)
        columns.append(
            (
                np.array([row[1][axis] for row in rows]) - motor,
                1 + 0.02 * np.abs(demand - motor),
                np.array([row[2][axis] for row in rows]) - speed,
            )
        )
    error, allowed, velocity = (np.array(each).T for each in zip(*columns, strict=True))
    return Compared(list(stamps), error, allowed, velocity)


def stand(hours: float, rate_hz: float) -> tuple[int, float]:
    """How many states of a standing axis there were, and the least between two stamps [µs]."""
    config = DriverConfig(axes=axes(1), state_rate=rate_hz)
    made = bench(config, 1, 0.4)
    end_us = made.now_us + hours * 3600e6
    states = watched(made, Whereabouts(made.machine), rate_hz, lambda: made.now_us > end_us)
    count, last_us, least_us = 0, -np.inf, np.inf
    for stamp_us, (position,), (velocity,) in states:
        assert position == 0 and velocity == 0
        count, last_us, least_us = count + 1, stamp_us, min(least_us, stamp_us - last_us)
    return count, least_us


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.joint_states")
    parser.add_argument("--lag", type=float, default=0.4, help="of the drives [ms] (%(default)s)")
    parser.add_argument("--standing", type=float, metavar="HOURS", help="of an axis that stands")
    chosen = parser.parse_args(argv)
    if chosen.standing:
        count, least_us = stand(chosen.standing, 50.0)
        print(f"{count} states, stamps at least {least_us / 1000:.3f} ms apart")
        return
    print("| example | rate | within | median | 99 % | worst | velocity, 99 % |")
    print("|---|---|---|---|---|---|---|")
    for name in NAMES:
        for rate_hz in RATES_HZ:
            seen = compare(example(name), rate_hz, chosen.lag)
            error, speed = np.abs(seen.error), np.abs(seen.velocity_error)
            print(
                f"| {name} | {rate_hz:.0f} Hz | {seen.within:.2%} | {np.median(error):.2f} qc "
                f"| {np.quantile(error, 0.99):.2f} qc | {error.max():.1f} qc "
                f"| {np.quantile(speed, 0.99):.0f} qc/s |",
                flush=True,
            )


if __name__ == "__main__":
    main()
