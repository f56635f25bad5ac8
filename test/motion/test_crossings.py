"""When a path passes counts: against an encoder that is simply looked at very often."""

from __future__ import annotations

from bisect import bisect_right

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from epos2_ros.motion.crossings import Crossings, Grid, Path, Points, crossings

FINE = 400  # looks per millisecond


def hermite(path: Path, piece: int, u: NDArray[np.float64]) -> NDArray[np.float64]:
    """Position between knot `piece` and the next, in Bernstein form."""
    h = (path.t_us[piece + 1] - path.t_us[piece]) * 1e-6
    p0, p3 = path.position_qc[piece], path.position_qc[piece + 1]
    p1, p2 = p0 + path.velocity_qc_s[piece] * h / 3, p3 - path.velocity_qc_s[piece + 1] * h / 3
    w = 1 - u
    return w**3 * p0 + 3 * w**2 * u * p1 + 3 * w * u**2 * p2 + u**3 * p3


def looked_at(path: Path, values: list[int]) -> list[tuple[int, bool, float]]:
    """(V, rising, time [µs]) of all changes of the encoder between V − 1 and V."""
    u = np.arange(FINE) / FINE
    pieces = range(len(path.t_us) - 1)
    x = np.concatenate([hermite(path, n, u) for n in pieces] + [path.position_qc[-1:]])
    t = np.concatenate(
        [path.t_us[n] + u * (path.t_us[n + 1] - path.t_us[n]) for n in pieces] + [path.t_us[-1:]]
    )
    count = np.floor(x + 0.5).astype(int)
    found = []
    for n in np.flatnonzero(np.diff(count)):
        low, high = sorted((count[n], count[n + 1]))
        passed = values[bisect_right(values, low) : bisect_right(values, high)]
        rising = bool(count[n + 1] > count[n])
        found += [(v, rising, t[n]) for v in (passed if rising else passed[::-1])]
    return found


def rows(found: Crossings) -> list[tuple[int, bool]]:
    return list(zip(found.count.tolist(), found.rising.tolist(), strict=True))


paths = st.lists(
    st.tuples(st.integers(-300, 300), st.floats(-4e5, 4e5)), min_size=2, max_size=12
).map(
    lambda knots: Path(
        np.arange(len(knots)) * 1000.0,
        np.array([float(p) + 0.25 for p, _ in knots]),
        np.array([v for _, v in knots]),
    )
)


@settings(max_examples=100, deadline=None)
@given(
    path=paths,
    origin=st.integers(-50, 50),
    step=st.integers(1, 90),
    wanted=st.lists(st.integers(-250, 250), min_size=1, max_size=8, unique=True).map(sorted),
)
def test_every_crossing_is_found_once_and_in_order(
    path: Path, origin: int, step: int, wanted: list[int]
) -> None:
    grid = [origin + step * n for n in range(-1000, 1000)]
    for counts, values in ((Grid(origin, step), grid), (Points(tuple(wanted)), wanted)):
        seen, found = looked_at(path, values), crossings(counts, path)
        # A turn within less than a look of a count can be seen or not: leave it out.
        assume(len(seen) == len(found))
        assert rows(found) == [(value, rising) for value, rising, _ in seen]
        late = found.t_us - np.array([t for _, _, t in seen])
        assert np.all((late > -1e-3) & (late < 1000 / FINE + 1e-3))


def test_most_paths_are_seen_alike() -> None:
    """So that the assumption above does not leave out what is to be tested."""
    random = np.random.default_rng(1)
    alike = 0
    for _ in range(100):
        knots = 0.25 + random.integers(-300, 300, 12)
        path = Path(np.arange(12) * 1000.0, knots, random.uniform(-4e5, 4e5, 12))
        found = crossings(Grid(0, 40), path)
        alike += len(found) == len(looked_at(path, [40 * n for n in range(-1000, 1000)]))
    assert alike > 90


def test_pieces_of_a_path_have_the_crossings_of_the_whole() -> None:
    t = np.arange(0.0, 2_000_001.0, 1000.0)
    phase = 2 * np.pi * t * 1e-6
    path = Path(t, 1000 * np.sin(phase), 2000 * np.pi * np.cos(phase))
    whole = rows(crossings(Grid(0, 100), path))
    parts: list[tuple[int, bool]] = []
    for begin in range(0, 2000, 7):
        piece = slice(begin, min(begin + 8, 2001))
        parts += rows(crossings(Grid(0, 100), Path(*(column[piece] for column in path))))
    assert parts == whole
    # up to 1000 and back, down to -1000 and back: 1000 is reached at 999.5, -1000 is not left
    assert len(whole) == 2 * (2 * 10 + 2 * 10)


def test_velocity_and_acceleration_are_those_of_the_path() -> None:
    t = np.arange(0.0, 1_001_000.0, 1000.0)
    s = t * 1e-6
    path = Path(t, 5000 * s**2, 10_000 * s)  # acceleration 10,000
    found = crossings(Points((1250,)), path)
    when = np.sqrt(1249.5 / 5000)
    assert found.t_us == pytest.approx([when * 1e6])
    assert found.velocity_qc_s == pytest.approx([10_000 * when])
    assert found.acceleration_qc_s2 == pytest.approx([10_000])


def test_the_ends_of_a_bounded_grid() -> None:
    t = np.array([0.0, 1e6, 2e6])
    path = Path(t, np.array([-1000.0, 1000.0, -1000.0]), np.zeros(3))
    found = crossings(Grid(0, 100, low=-2, high=3), path)
    up = [-200, -100, 0, 100, 200, 300]
    assert rows(found) == [(v, True) for v in up] + [(v, False) for v in up[::-1]]
