"""Moves of the profile position mode, worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from epos2_ros.motion.crossings import Path
from epos2_ros.motion.trapezoid import Trapezoid, in_step
from epos2_ros.sim import ramps


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


MOVES = st.tuples(
    st.floats(-1e6, 1e6).filter(lambda way: abs(way) >= 1.0),
    st.floats(1e2, 1e6),
    st.floats(1e3, 1e7),
    st.floats(1e4, 1e10),
)


def hermite(path: Path, t_s: float) -> float:
    """The cubic with the positions and velocities of the knots beside `t_s`."""
    knots_s = path.t_us * 1e-6
    n = min(max(int(np.searchsorted(knots_s, t_s)) - 1, 0), len(knots_s) - 2)
    h = knots_s[n + 1] - knots_s[n]
    u = (t_s - knots_s[n]) / h
    (p, q), (v, w) = path.position_qc[n : n + 2], path.velocity_qc_s[n : n + 2] * h
    return float(
        (1 + 2 * u) * (1 - u) ** 2 * p
        + u * (1 - u) ** 2 * v
        + u**2 * ((3 - 2 * u) * q + (u - 1) * w)
    )


@given(MOVES, st.floats(0.0, 1.0))
def test_with_a_limit_of_jerk_it_is_the_profile_that_integrating_the_jerk_gives(
    move: tuple[float, float, float, float], share: float
) -> None:
    """Against the simulated drives' profiles, which add up phases of constant jerk."""
    way, v, a, j = move
    made = Trapezoid(0.0, way, v, a, j)
    drive, _ = ramps.move(ramps.State(0.0, 0.0, 0.0), way, 0.0, ramps.Limits(v, a, a, (j,) * 4))
    assert made.duration_s == pytest.approx(drive.duration, rel=1e-9)
    path, t_s = made.path(0.0), share * drive.duration
    assert hermite(path, t_s) == pytest.approx(drive.at(t_s).position, abs=1e-6 * abs(way))


@given(MOVES, st.floats(1.0, 3.0))
def test_in_whole_units_it_lasts_as_long_and_jerks_hardly_more(
    move: tuple[float, float, float, float], longer: float
) -> None:
    """In rpm, rpm/s and rpm/s² of a motor of 2000 counts a turn: to 1 ms, where these are small."""
    way, v, a, j = move
    rpm = 2000 / 60
    alone = Trapezoid(0.0, float(round(way)), v, a, j)
    wanted = alone.lasting(longer * alone.duration_s)
    made = wanted.in_units(rpm, rpm, rpm)
    assert made.jerk <= max(1.25 * wanted.jerk, rpm) + rpm
    assert made.peak <= 1.005 * wanted.velocity + 2 * rpm
    if min(wanted.peak, wanted.acceleration, wanted.jerk) > 300 * rpm:
        assert made.duration_s == pytest.approx(wanted.duration_s, abs=1e-3)
