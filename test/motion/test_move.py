"""Point-to-point moves of joints in profile position mode: units, limits, refusals."""

from __future__ import annotations

import numpy as np
import pytest

from epos2_ros.configuration.driver import AxisConfig
from epos2_ros.errors import TrajectoryError
from epos2_ros.motion.move import moves, target_of
from epos2_ros.motion.trajectory import Trajectory

# 2000 counts, gear 10 and 0.1 m per turn are 200,000 counts per metre, here falling from 0.3 m.
LIFT = AxisConfig(
    "lift", 1, "copley", "prismatic", gear_ratio=10.0, lead=0.1, direction=-1, offset=0.3,
    min_position=-0.1, max_position=0.5, max_velocity=0.2, max_acceleration=1.0,
)  # fmt: skip
TABLE = AxisConfig(
    "table", 2, "copley", counts_per_turn=4000, max_velocity=1.0, max_acceleration=2.0
)


def test_a_move_is_in_counts_of_the_drive_with_sign_and_offset() -> None:
    move = moves([LIFT], {"lift": 1000}, {"lift": 0.1})["lift"]
    assert (move.start, move.end) == pytest.approx((1000, 40_000))
    assert (move.velocity, move.acceleration) == pytest.approx((40_000, 200_000))


def test_joints_arrive_together_in_the_time_that_is_asked_for() -> None:
    together = moves([LIFT, TABLE], {"lift": 0, "table": 0}, {"lift": 0.2, "table": 3.0}, 5.0)
    assert [move.duration_s for move in together.values()] == pytest.approx([5.0, 5.0])
    fast = moves([LIFT, TABLE], {"lift": 0, "table": 0}, {"lift": 0.2, "table": 3.0}, 1.0)
    assert [move.duration_s for move in fast.values()] == pytest.approx([3.5, 3.5])  # 3/1 + 1/2


@pytest.mark.parametrize("inside", [-0.1, 0.5])
def test_a_target_may_be_at_a_limit(inside: float) -> None:
    assert moves([LIFT], {"lift": 0}, {"lift": inside})


@pytest.mark.parametrize(
    ("axis", "standing_qc", "targets", "line"),
    [
        (LIFT, 0, {"lift": -0.11}, "joint 'lift': position -0.11 m is outside its limits -0.1 … 0"),
        (LIFT, 0, {"lift": 0.51}, "joint 'lift': position 0.51 m is outside its limits -0.1 … 0.5"),
        (TABLE, 0, {"table": 4e6}, "joint 'table': position 4e+06 rad is outside its limits"),
        (LIFT, None, {"lift": 0.2}, "joint 'lift': its drive has not said where it stands"),
        (LIFT, 0, {"table": 0.2}, "unknown joint 'table'; the joints are"),
        (AxisConfig("a", 1, "copley", max_velocity=1.0), 0, {"a": 1.0}, "axes.a.max_acceleration"),
        (AxisConfig("a", 1, "copley", max_acceleration=1.0), 0, {"a": 1.0}, "axes.a.max_velocity"),
    ],
)
def test_what_cannot_be_moved_is_refused(
    axis: AxisConfig, standing_qc: int | None, targets: dict[str, float], line: str
) -> None:
    with pytest.raises(TrajectoryError) as refusal:
        moves([axis], {axis.joint: standing_qc}, targets)
    assert str(refusal.value).startswith(line)


@pytest.mark.parametrize("points", [0, 2])
def test_a_move_has_one_point(points: int) -> None:
    message = Trajectory(("a",), np.arange(float(points)), np.zeros((points, 1)))
    with pytest.raises(TrajectoryError, match=f"{points} points; a move has one"):
        target_of(message)
