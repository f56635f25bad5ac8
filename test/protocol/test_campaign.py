"""Every motion is fitted, whenever it is stopped or replaced; `benchmarks.campaign` runs more."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from benchmarks import campaign
from epos2_ros.configuration.driver import AxisConfig, DriverConfig
from epos2_ros.configuration.files import read_parameters, share
from epos2_ros.configuration.parameters import DriverParameters
from epos2_ros.motion.join import join
from epos2_ros.motion.reference import Reference
from epos2_ros.motion.stop import stop
from epos2_ros.motion.trajectory import Trajectory

MOTIONS = 60
LATEST_MS = 255  # a rest may come one longest segment after the commanded one


def test_random_motions_stopped_replaced_and_streamed() -> None:
    counts, troubles = campaign.campaign(range(MOTIONS))
    assert not troubles
    assert counts["motions"] == MOTIONS
    assert min(counts["stops"], counts["replacements"], counts["points"]) >= 10


@pytest.mark.parametrize(
    ("limits", "way", "duration_s", "step_ms"),
    [({}, 0.05, 3.0, 50), ({"max_velocity": 2.0, "max_acceleration": 8.0}, 1.0, 5.0, 250)],
    ids=["the README's first move", "a longer one"],
)
def test_a_slow_move_can_be_stopped_at_any_time(
    limits: dict[str, float], way: float, duration_s: float, step_ms: int
) -> None:
    file = share() / "config" / "can0.yaml"
    config = DriverParameters(read_parameters(file)).config()
    axes = [replace(axis, **limits) for axis in config.axes]
    move = Trajectory(
        ("base",), np.array([0.0, duration_s]), np.array([[0.0], [way]]), np.zeros((2, 1))
    )
    for at_ms in range(0, round(duration_s * 1000), step_ms):
        motion = campaign.Run(axes, config)
        rest = Reference.at_rest(motion.units, np.zeros(len(axes)))
        motion.begin(join(rest, move, motion.limits, at_ms=0, start_ms=0, allow_partial=True))
        motion.feed(at_ms)
        if not motion.ended:
            motion.replace(stop(motion.reference, motion.committed_ms, motion.limits))
        motion.feed(math.inf)
        motion.judge()
        assert len(motion.ended) == len(axes)
        assert motion.late_ms <= LATEST_MS


@pytest.mark.parametrize("tolerance_qc", [1.0, 10.0])
@pytest.mark.parametrize("units", [0.1, 0.66, 0.95, 1.4, 3.4])
def test_an_axis_goes_at_a_limit_of_less_than_a_few_velocity_units(
    units: float, tolerance_qc: float
) -> None:
    """Knots have whole units: none but 0 is below a limit of 0.66 rpm, which has to be kept up."""
    speed = units * 2 * math.pi / 60  # 40,000 counts per turn: a unit are 667 qc/s
    axes = [
        AxisConfig(
            "slow", 1, counts_per_turn=40_000, max_velocity=speed, max_acceleration=2 * speed
        )
    ]
    motion = campaign.Run(axes, DriverConfig(tuple(axes), buffer_time=0.08, tolerance=tolerance_qc))
    times, ways = np.array([0.0, 0.5, 1.5, 2.0]), np.array([[0.0], [0.25], [1.25], [1.5]])
    move = Trajectory(("slow",), times, speed * ways, speed * np.array([[0], [1], [1], [0]]))
    rest = Reference.at_rest(motion.units, np.zeros(1))
    motion.begin(join(rest, move, motion.limits, at_ms=0, start_ms=0))
    motion.fitter.max_segment_ms = 16  # as of streams
    motion.feed(math.inf)
    motion.judge()
    assert motion.ended and motion.late_ms <= LATEST_MS


def test_what_is_wrong_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """A campaign whose judge demands more than the fitter was told has trouble."""
    monkeypatch.setattr(campaign, "SLACK_QC", -0.4)
    _, troubles = campaign.campaign(range(5))
    assert troubles
