"""The benchmarks' baselines and their search, against facts known otherwise."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from benchmarks import __main__ as program
from benchmarks import baselines, cases, frames, search, smoothness
from benchmarks.table import Table
from epos2_ros.motion.pvt import Cubic, executed

Array = NDArray[np.float64]
UNIT_QC_S = 2000 / 60


def there(acceleration_qc_s2: float, end_ms: int = 400) -> Array:
    """Positions from rest to rest, accelerating and then braking alike."""
    t = np.arange(end_ms + 1) / 1000
    half, left = t[end_ms // 2], t[-1] - t
    speeding, braking = acceleration_qc_s2 * t**2 / 2, acceleration_qc_s2 * left**2 / 2
    return np.where(t <= half, speeding, acceleration_qc_s2 * half**2 - braking)


# ------------------------------------------------------------------------- baselines


@settings(max_examples=20, deadline=None)
@given(acceleration=st.floats(2e4, 1e6), tolerance=st.floats(1.0, 20.0))
def test_linear_interpolation_is_off_by_the_sagitta(acceleration: float, tolerance: float) -> None:
    """A chord of constant acceleration is h²/8·a off; rounding adds or hides half a count."""
    errors = baselines.linear_errors(there(acceleration))
    for h in (2, 4, 10, 20, 50):  # the chord's middle is a whole millisecond
        assert abs(errors[h] - acceleration * (h / 1000) ** 2 / 8) <= 0.5 + 1e-6
    least, most = (
        1000 * math.sqrt(8 * error / acceleration) for error in (tolerance - 0.5, tolerance + 0.5)
    )
    # Chords of odd length have no middle, so they may be a little longer.
    assert math.floor(least) <= baselines.reliable(errors, tolerance) <= math.ceil(most) + 1


@settings(max_examples=20, deadline=None)
@given(
    points=st.lists(
        st.tuples(st.integers(-5000, 5000), st.integers(-900, 900)), min_size=1, max_size=5
    ),
    spacing=st.integers(2, 255),
)
def test_a_grid_reproduces_its_own_cubics(points: list[tuple[int, int]], spacing: int) -> None:
    """Cubics between whole counts and whole velocity units, on a grid, are met exactly by it."""
    points = [(0, 0), *points, (17, 0)]
    k, speeds = spacing * np.arange(len(points)), np.array(points)[:, 1] * UNIT_QC_S
    places = np.array(points, dtype=float)[:, 0]
    position = np.concatenate(
        [
            Cubic.between(p0, v0, p1, v1, spacing / 1000).position(np.arange(-spacing, 0) / 1000)
            for p0, v0, p1, v1 in zip(places, speeds, places[1:], speeds[1:], strict=False)
        ]
        + [places[-1:]]
    )
    velocity = np.interp(np.arange(k[-1] + 1), k, speeds)  # right at the knots
    assert baselines.pvt_errors(position, velocity, UNIT_QC_S)[spacing] < 1e-6


def test_reliable_and_luckiest_spacing() -> None:
    errors = np.array([0.0, 0.2, 0.9, 1.1, 0.8, 3.0])
    assert baselines.reliable(errors, 1.0) == 2
    assert baselines.luckiest(errors, 1.0) == 4
    assert baselines.reliable(errors, 5.0) == baselines.luckiest(errors, 5.0) == 5
    for choose in (baselines.reliable, baselines.luckiest):
        with pytest.raises(ValueError, match="no spacing keeps 0.1 qc"):
            choose(errors, 0.1)


def test_the_set_points_end_at_rest_in_the_end() -> None:
    position = there(1e4, end_ms=95)
    points = baselines.set_points(position, 10)
    assert len(points) == 10 and points[-1] == round(position[-1])
    curve = baselines.linear(0, points, 10)
    assert curve[::10].tolist() == [0, *points] and len(curve) == 101


# ------------------------------------------------------------------------- the optimum


@pytest.fixture(autouse=True, scope="module")
def interpreted() -> Iterator[None]:
    """The same search, not compiled: for tiny problems that is quicker."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(search, "_fewest", search._fewest.py_func)
        yield


def brute_force(
    position: Array, velocity: Array, unit_qc_s: float, longest: int, wildest_qc_ms: float
) -> int:
    """The fewest records at 1 qc: every pair of states, with the drive's own formula."""
    end, tolerance = len(position) - 1, 1.0
    reach = math.ceil(wildest_qc_ms / (unit_qc_s * 1e-3))
    states = []  # [states, 2] of each millisecond: position, velocity
    for k in range(end + 1):
        places = np.arange(math.ceil(position[k] - tolerance), position[k] + tolerance + 1e-9)
        speeds = np.arange(-reach, reach + 1) + np.rint(velocity[k] / unit_qc_s)
        states.append(np.stack(np.meshgrid(places, speeds * unit_qc_s), axis=-1).reshape(-1, 2))
    states[0], states[end] = np.array([[round(position[0]), 0.0], [round(position[end]), 0.0]])[
        :, None
    ]
    cost = [np.full(len(each), np.inf) for each in states]
    cost[0][0] = 0.0
    for k0 in range(end):
        for k1 in range(k0 + 1, min(k0 + longest, end) + 1):
            (p0, v0), (p1, v1) = states[k0].T[:, :, None], states[k1].T[:, None, :]
            cubic = Cubic.between(p0, v0, p1, v1, (k1 - k0) / 1000)
            good = np.ones((len(states[k0]), len(states[k1])), dtype=bool)
            for k in range(k0 + 1, k1):
                good &= np.abs(cubic.position(np.float64(k - k1) / 1000) - position[k]) <= tolerance
            through = np.where(good, cost[k0][:, None] + 1, np.inf).min(axis=0)
            cost[k1] = np.minimum(cost[k1], through)
    return int(cost[end][0]) + 1


@settings(max_examples=30, deadline=None)
@given(
    steps=st.lists(st.integers(-6, 6), min_size=3, max_size=8),
    # Odd parts of a count, so that no error is the tolerance but for the last digit of a float.
    fractions=st.lists(
        st.integers(-33, 32).map(lambda n: (2 * n + 1) * 0.00685), min_size=9, max_size=9
    ),
    unit=st.sampled_from([1500.0, 3000.0, 7000.0]),
    longest=st.sampled_from([2, 4, 255]),
)
def test_the_search_finds_what_trying_all_finds(
    steps: list[int], fractions: list[float], unit: float, longest: int
) -> None:
    """Rough curves of a few milliseconds in coarse units, so that all can be tried."""
    position = np.concatenate(([0.0], np.cumsum(steps) + fractions[: len(steps)]))
    velocity = np.gradient(position, 1e-3)
    least = search.fewest(position, velocity, unit, 1.0, longest)
    assert least == brute_force(position, velocity, unit, longest, search.WILD_QC_MS)


@settings(max_examples=15, deadline=None)
@given(
    step=st.floats(-20.0, 20.0),
    ripple=st.floats(-3.0, 3.0),
    unit=st.sampled_from([2500.0, 5000.0]),
    end=st.integers(3, 6),
)
def test_wilder_velocities_save_nothing(step: float, ripple: float, unit: float, end: int) -> None:
    """From rest to rest with a ripple, which takes several short segments."""
    u = np.arange(end + 1) / end
    position = step * u**2 * (3 - 2 * u) + ripple * np.sin(2 * np.pi * u) ** 2
    velocity = 6 * step * u * (1 - u) + ripple * 2 * np.pi * np.sin(4 * np.pi * u)
    velocity *= 1000 / end
    wilder = brute_force(position, velocity, unit, 255, 2 * search.WILD_QC_MS)
    assert search.fewest(position, velocity, unit) == wilder


@settings(max_examples=10, deadline=None)
@given(p1=st.integers(-60, 60), time=st.integers(3, 12), offset=st.integers(-(2**30), 2**30))
def test_one_segment_is_enough_for_one_cubic(p1: int, time: int, offset: int) -> None:
    k = np.arange(time + 1)
    cubic = Cubic.between(0, 0, p1, 0, time / 1000)
    position = cubic.position((k - time) / 1000) + offset
    velocity = cubic.velocity((k - time) / 1000)
    assert search.fewest(position, velocity, 3000.0) == 2


# ------------------------------------------------------------------------- ours beside them


def test_smoothness_of_cubics_met_exactly() -> None:
    """The raster's cubics begin and end on whole tenths of a second: a grid of 50 ms has them."""
    case = cases.example("raster_scan")
    records = smoothness.on_grid(case, 50)
    exact = smoothness.row(case, "", records)
    assert exact["acceleration error, RMS [%]"] < 0.1
    assert exact["largest error [qc]"] <= 0.55
    coarse = smoothness.row(case, "", smoothness.on_grid(case, 250))
    assert coarse["acceleration error, RMS [%]"] > 5


def test_the_default_is_as_smooth_as_a_grid_for_a_fifth_more_records_at_most() -> None:
    """In the ones of the benchmark's ten motions that come nearest to it."""
    motions = [cases.example("pick_place"), *cases.all_cases((1, 2, 3))[-3:]]
    for motion in smoothness.summary(motions).rows:
        assert motion["default: RMS [%]"] <= motion["grid: RMS [%]"], motion
        assert motion["default: more than fewest [%]"] <= 20, motion


def test_frames_are_counted_with_their_bits() -> None:
    """At least the 44 + 8·n bits and the gap of 3 (ISO 11898-1), at most a fifth more."""
    case = cases.example("jerk_limited")
    payloads = [[bytes(range(8))] * 3, [bytes(4)]] + [[]] * 4
    counted = frames.spent(case, payloads)
    assert counted.frames == 4
    assert 3 * 111 + 79 <= counted.bits <= 1.2 * (3 * 111 + 79)


def test_all_records_of_a_case_reach_its_end() -> None:
    case = cases.example("jerk_limited")
    for axis, records in enumerate(case.records(5.0)):
        assert records[-1].time == 0
        curve = executed(case.start_qc[axis], records, case.curves[axis][2])
        assert len(curve.position_qc) == case.reference.end_ms + 1


def test_tables_are_printed_and_written(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    def tables(chosen: argparse.Namespace) -> Iterator[Table]:
        yield Table("Seeds", [{"n": seed, "half": seed / 2} for seed in chosen.seeds], "as given")

    monkeypatch.setitem(program.TABLES, "frames", (tables, ""))
    file = tmp_path / "out.json"
    assert program.main(["frames", "--seeds", "3", "7", "--json", str(file)]) == 0
    printed = capsys.readouterr().out
    assert "## Seeds\n\n| n | half |\n|---|---|\n| 3 | 1.50 |\n| 7 | 3.50 |\n" in printed
    (written,) = json.loads(file.read_text("utf-8"))["tables"]
    assert written["rows"] == [{"n": 3, "half": 1.5}, {"n": 7, "half": 3.5}]
    with pytest.raises(SystemExit):
        program.main(["unknown"])
    assert "no table 'unknown'" in capsys.readouterr().err
