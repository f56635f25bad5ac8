"""Predictions of motions that come in pieces and change on the way."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from epos2_ros.motion.compare import Trigger, predict
from epos2_ros.motion.crossings import Grid, Path, Points
from epos2_ros.motion.foresight import Foresight
from epos2_ros.motion.units import AxisUnits

COUNTS = AxisUnits("x", "m", 2000, 1.0)
TRIGGERS = [
    Trigger(Grid(30, 100), pulse_us=100.0),
    Trigger(Points((-250, 10, 11, 400)), falling=False, extrapolated=True),
    Trigger(Grid(100, 70), falling=False, sequence=True),
    Trigger(Grid(-20, 90), rising=False, sequence=True, end=-300),
    Trigger(Grid(50, 60), falling=False, sequence=True, end=400),
]


def wander(turns: list[float], from_us: float = 0.0) -> Path:
    """At rest at each of these positions [counts], half a second apart."""
    t = from_us + 5e5 * np.arange(len(turns))
    return Path(t, np.array(turns), np.zeros(len(turns)))


def part(path: Path, begin: int, end: int) -> Path:
    return Path(*(column[begin : end + 1] for column in path))


positions = st.lists(st.floats(-900.0, 900.0), min_size=3, max_size=9)


@settings(deadline=None, max_examples=150)
@given(turns=positions, cut=st.integers(1, 7), number=st.integers(0, len(TRIGGERS) - 1))
def test_in_pieces_it_is_the_same(turns: list[float], cut: int, number: int) -> None:
    path, cut = wander(turns), min(cut, len(turns) - 2)
    foresight = Foresight(TRIGGERS[number], COUNTS)
    foresight.extend(part(path, 0, cut))
    foresight.extend(part(path, cut, len(turns) - 1))
    whole, pieces = predict(TRIGGERS[number], path, COUNTS), foresight.prediction()
    assert pieces.fired.count.tolist() == whole.fired.count.tolist()
    assert pieces.fired.rising.tolist() == whole.fired.rising.tolist()
    assert pieces.fired.t_us == pytest.approx(whole.fired.t_us)
    assert pieces.warnings == whole.warnings


@settings(deadline=None, max_examples=150)
@given(
    turns=positions,
    others=positions,
    cut=st.integers(1, 7),
    number=st.integers(0, len(TRIGGERS) - 1),
)
def test_what_is_replaced_is_forgotten(
    turns: list[float], others: list[float], cut: int, number: int
) -> None:
    """As if the motion had been laid down as it was run in the end."""
    cut = min(cut, len(turns) - 1)
    before = wander(turns)
    run = wander([*turns[: cut + 1], *others])
    foresight = Foresight(TRIGGERS[number], COUNTS)
    foresight.extend(before)
    foresight.forget(5e5 * cut)
    foresight.extend(part(run, cut, len(run.t_us) - 1))
    assert foresight.prediction().fired.count.tolist() == (
        predict(TRIGGERS[number], run, COUNTS).fired.count.tolist()
    )


def test_of_no_motion_nothing_is_predicted() -> None:
    prediction = Foresight(TRIGGERS[0], COUNTS).prediction()
    assert len(prediction.fired) == 0
    assert prediction.warnings == ()
