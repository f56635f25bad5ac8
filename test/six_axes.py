"""Six EPOS2 axes in simulated time, and a motion of theirs: commanded, run and executed."""

from __future__ import annotations

import math

import numpy as np
from simulated_time import Bench

from epos2_ros.configuration.driver import DriverConfig
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.sim.epos2 import Epos2

QC_PER_RAD = 2000 * 100 / (2 * math.pi)
NODES = range(1, 7)


def there_and_back(duration_s: float = 2.0, reach: float = 0.3, joints: int = 6) -> Trajectory:
    """A minimum-jerk move out, and back; joint n goes reach·(1 − n/10)."""
    share = [1 - n / 10 for n in range(joints)]
    still = np.zeros((3, joints))
    return Trajectory(
        tuple(f"joint_{n}" for n in range(1, joints + 1)),
        np.array([0.0, duration_s / 2, duration_s]),
        np.array([[0.0] * joints, [reach * s for s in share], [0.0] * joints]),
        still,
        still.copy(),
    )


def commanded_qc(t_ms: np.ndarray, axis: int, duration_s: float = 2.0, reach: float = 0.3):
    """The same, from the minimum-jerk polynomial 10u³ − 15u⁴ + 6u⁵, since the start SYNC.

    The first record holds the position for a millisecond.
    """
    half = duration_s / 2
    t = np.clip((t_ms - 1) / 1000, 0, duration_s)
    u = np.where(t < half, t, duration_s - t) / half
    return reach * (1 - axis / 10) * (10 * u**3 - 15 * u**4 + 6 * u**5) * QC_PER_RAD


def drives(**settings) -> list[Epos2]:
    return [
        Epos2(n, drift_ppm=40.0 * (n - 3), offset_us=1e6 * n, record=True, **settings)
        for n in NODES
    ]


def bench(config: DriverConfig | None = None, **settings) -> Bench:
    made = Bench(config, drives(**settings))
    made.enable()
    return made


def run_motion(made: Bench, trajectory: Trajectory | None = None) -> None:
    made.path.submit(trajectory or there_and_back(), None, made.now_us)
    made.wait(made.group.motion)


def executed(drive: Epos2) -> tuple[np.ndarray, np.ndarray]:
    rows = np.array(drive.recorder.executed())
    return rows[:, 0], rows[:, 1]


def assert_on_path(made: Bench, tolerance_qc: float = 1.0) -> None:
    for axis, drive in enumerate(made.drives):
        t_ms, demand = executed(drive)
        error = np.abs(demand - commanded_qc(t_ms, axis))
        assert error.max() <= tolerance_qc, f"axis {axis} at {t_ms[error.argmax()]} ms"


def statusword(drive: Epos2) -> int:
    return int.from_bytes(drive.dictionary[0x6041, 0].pack(), "little")


def all_stand(made: Bench) -> bool:
    before = [drive._demand for drive in made.drives]
    made.run(0.05)
    return before == [drive._demand for drive in made.drives]
