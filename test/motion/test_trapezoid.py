"""Moves of the profile position mode, worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from epos2_ros.motion.trapezoid import Trapezoid, in_step


def test_a_long_move() -> None:
    """400,000 counts at 400,000 counts/s and 2,000,000 counts/s²: 0.2 s, 0.8 s, 0.2 s."""
    move = Trapezoid(0.0, 400_000.0, 400_000.0, 2e6)
    assert move.duration_s == pytest.approx(1.2)
    path = move.path(5e6)
    assert path.t_us == pytest.approx([5e6, 5.2e6, 6.0e6, 6.2e6])
    assert path.position_qc == pytest.approx([0, 40_000, 360_000, 400_000])
    assert path.velocity_qc_s == pytest.approx([0, 400_000, 400_000, 0])


def test_a_short_move_downward_turns_before_it_has_its_velocity() -> None:
    move = Trapezoid(100.0, -20_000.0 + 100.0, 400_000.0, 2e6)
    assert move.peak == pytest.approx(200_000)
    assert move.duration_s == pytest.approx(0.2)
    path = move.path(0.0)
    assert path.position_qc == pytest.approx([100, -9900, -19_900])
    assert path.velocity_qc_s == pytest.approx([0, -200_000, 0])


def test_an_axis_that_stays_has_no_duration() -> None:
    move = Trapezoid(7.0, 7.0, 1.0, 1.0)
    assert move.duration_s == 0
    assert move.lasting(2.0) == move
    assert move.path(0.0).position_qc.tolist() == [7.0]


@given(
    moves=st.lists(
        st.tuples(st.floats(-1e6, 1e6), st.floats(1e3, 1e6), st.floats(1e4, 1e7)), min_size=1
    ),
    duration_s=st.floats(0.0, 10.0),
)
def test_axes_arrive_together_and_none_is_faster_than_it_may_be(
    moves: list[tuple[float, float, float]], duration_s: float
) -> None:
    alone = [Trapezoid(0.0, float(round(end)), v, a) for end, v, a in moves]
    together = in_step(alone, duration_s)
    longest = max([duration_s, *(move.duration_s for move in alone)])
    for before, move in zip(alone, together, strict=True):
        assert move.peak <= before.velocity * (1 + 1e-9)
        assert move.acceleration <= before.acceleration * (1 + 1e-9)
        if move.end:
            assert move.duration_s == pytest.approx(longest)
            assert np.diff(move.path(0.0).t_us).min() >= 0
