"""Events from what is read of a drive now and then: none lost, none twice, each at its time.

A simulated compare module is moved and read at irregular times, with the delays that SDO has; what
the trackers make of it is held against every single time the module really fired.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass, field
from math import cos, pi, sin
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from epos2_ros.configuration.outputs import CompareConfig
from epos2_ros.motion.crossings import Grid, Path, Points
from epos2_ros.motion.units import AxisUnits
from epos2_ros.protocol.outputs.copley import HardwareOutput, compare_reads
from epos2_ros.protocol.outputs.events import (
    CompareEvent,
    DualTracker,
    FlagTracker,
    SingleTracker,
)
from epos2_ros.sim.copley import Copley

COUNTS = AxisUnits("x", "m", 2000, 1.0)
SDO_US = 500.0
Motion = Callable[[float], tuple[float, float]]


def swing(seconds: float, reach: float, hertz: float) -> Motion:
    """To and fro, ever wider and narrower again, from rest to rest; argument in s."""

    def at(t: float) -> tuple[float, float]:
        t = min(max(t, 0.0), seconds)
        envelope, slope = sin(pi * t / seconds) ** 2, pi / seconds * sin(2 * pi * t / seconds)
        w = 2 * pi * hertz
        return (
            1234.2 + reach * envelope * sin(w * t),
            reach * (slope * sin(w * t) + envelope * w * cos(w * t)),
        )

    return at


@dataclass
class Bench:
    """A drive moved along `motion`, read every `read_ms` or so; the path is known `lag_ms` late."""

    motion: Motion
    read_ms: float
    lag_ms: float = 0.0
    seed: int = 0
    events: list[CompareEvent] = field(default_factory=list)
    reads: int = 0

    def run(self, seconds: float, **parameters: Any) -> list[tuple[int, bool, float]]:
        """What the module has fired: value, rising, time [µs]."""
        random_ = random.Random(self.seed)
        output = HardwareOutput(CompareConfig("output", "x", **parameters), COUNTS)
        drive = Copley(1, position=round(self.motion(0.0)[0]))
        for write in output.arm(drive.position_actual):
            drive.dictionary.download(write.index, write.subindex, write.data)
        tracker = output.tracker(drive.position_actual)
        drive.move_by_hand(lambda t_us: self.motion(t_us * 1e-6))
        now_us = path_us = 0.0
        while now_us < seconds * 1e6:
            now_us += self.read_ms * 1000 * random_.uniform(0.3, 1.7)
            begin_us, answers = now_us, []
            for read in tracker.reads:
                drive.advance(now_us)
                data = drive.dictionary.upload(read.index, read.subindex)
                answers.append(read.decode(data))
                now_us += SDO_US * random_.uniform(0.5, 1.5)
            self.events += tracker.advance(self._path(path_us, now_us))
            path_us = now_us
            events, writes = tracker.report(answers, begin_us, now_us)
            self.events += events
            self.reads += 1
            assert not tracker.lost
            for write in writes:
                now_us += SDO_US * random_.uniform(0.5, 1.5)
                drive.advance(now_us)
                drive.dictionary.download(write.index, write.subindex, write.data)
        return [(event.value, event.rising, event.t_us) for event in drive.module.fired]

    def _path(self, begin_us: float, end_us: float) -> Path:
        t_us = np.linspace(begin_us, end_us, max(2, int((end_us - begin_us) / 1000) + 1))
        states = np.array([self.motion((t - 1000 * self.lag_ms) * 1e-6) for t in t_us])
        return Path(t_us, states[:, 0], states[:, 1])

    def compare(self, fired: list[tuple[int, bool, float]], within_us: float) -> None:
        assert [(e.position_qc, e.rising) for e in self.events] == [f[:2] for f in fired]
        late_us = [e.t_us - f[2] for e, f in zip(self.events, fired, strict=True)]
        assert max(map(abs, late_us), default=0.0) <= within_us


KINDS = {
    "every 50 counts, both ways": {"kind": "interval", "start": 0.0, "interval": 50.0},
    "a sequence": {"kind": "interval", "start": 2000.0, "interval": 50.0, "direction": "up"},
    "a sequence with an end": {
        "kind": "interval", "start": 1000.0, "interval": 50.0, "end": -9000.0,
    },
    "one position": {"kind": "crossing", "positions": (5000.0,)},
    "two positions": {"kind": "crossing", "positions": (-3000.0, 5000.0)},
    "a window": {"kind": "window", "window": (-3000.0, 5000.0)},
}  # fmt: skip


@pytest.mark.parametrize("read_ms", [2.0, 20.0, 200.0])
@pytest.mark.parametrize("kind", KINDS)
def test_no_event_is_lost_or_doubled_however_seldom_the_drive_is_read(
    kind: str, read_ms: float
) -> None:
    bench = Bench(swing(2.0, 20_000, 1.4), read_ms)
    fired = bench.run(2.3, **KINDS[kind])
    assert len(fired) >= 4
    bench.compare(fired, within_us=250.0)
    if kind.startswith("every") and read_ms == 200.0:
        assert len(fired) > 50 * bench.reads


@pytest.mark.parametrize("kind", KINDS)
def test_a_path_that_is_behind_only_makes_the_times_late(kind: str) -> None:
    bench = Bench(swing(2.0, 20_000, 1.4), 50.0, lag_ms=2.5)
    bench.compare(bench.run(2.3, **KINDS[kind]), within_us=2750.0)


@settings(max_examples=10, deadline=None)
@given(
    reach=st.floats(500, 30_000),
    hertz=st.floats(0.3, 4.0),
    read_ms=st.floats(3.0, 150.0),
    lag_ms=st.floats(0.0, 1.5),
    seed=st.integers(0, 1000),
    interval=st.integers(20, 500),
)
@example(reach=25843.0, hertz=3.783203125, read_ms=4.0, lag_ms=0.0, seed=564, interval=366)
def test_any_swing(
    reach: float, hertz: float, read_ms: float, lag_ms: float, seed: int, interval: int
) -> None:
    bench = Bench(swing(1.0, reach, hertz), read_ms, lag_ms, seed)
    fired = bench.run(1.3, kind="interval", start=7.0, interval=float(interval))
    bench.compare(fired, within_us=1000 * lag_ms + 250.0)


def test_a_thousand_events_a_second_for_a_minute() -> None:
    """50,000 counts/s to and fro over 100,000 counts, an output every 50: 60,000 events."""

    def shuttle(t: float) -> tuple[float, float]:
        phase = t % 4.0 if t < 60.0 else 0.0
        if phase == 0.0:
            return 0.0, 0.0
        return (50_000 * phase, 50_000.0) if phase < 2 else (200_000 - 50_000 * phase, -50_000.0)

    bench = Bench(shuttle, read_ms=25.0)
    fired = bench.run(60.2, kind="interval", start=25.0, interval=50.0)
    assert len(fired) >= 60_000
    bench.compare(fired, within_us=250.0)


# --- what the path cannot tell --------------------------------------------------------------------


def still(position: float, begin_us: float, end_us: float) -> Path:
    return Path(np.array([begin_us, end_us]), np.full(2, position), np.zeros(2))


def told(tracker: Any, status: int, *values: int, at_ms: float) -> list[tuple[int, bool]]:
    """The next 10 ms at rest at 150, then a read; events as (count, rising)."""
    tracker.advance(still(150.0, 1000 * (at_ms - 10), 1000 * at_ms))
    events, _ = tracker.report((status, *values), 1000 * at_ms, 1000 * at_ms + 500)
    return [(event.position_qc, event.rising) for event in events]


def test_values_that_moved_are_events_even_if_the_path_did_not_see_it() -> None:
    tracker = DualTracker(compare_reads(), Grid(0, 100), 150)
    assert told(tracker, 0, 100, 200, at_ms=10) == []
    # at 270 by the drive: value 1, 200, was crossed, so value 0 is 300
    assert told(tracker, 0b100, 300, 200, at_ms=20) == [(200, True)]
    assert told(tracker, 0b100, 100, 200, at_ms=30) == [(200, False)]


def test_a_turn_that_only_the_flags_show_is_two_events() -> None:
    tracker = DualTracker(compare_reads(), Grid(0, 100), 150)
    told(tracker, 0, 100, 200, at_ms=10)
    seen = [told(tracker, 0b100, 100, 200, at_ms=20)]
    seen += [told(tracker, 0, 100, 200, at_ms=30 + 10 * n) for n in range(8)]
    assert [event for part in seen for event in part] == [(200, True), (200, False)]


def test_a_match_between_flags_and_values_is_told_once() -> None:
    tracker = DualTracker(compare_reads(), Grid(0, 100), 150)
    told(tracker, 0, 100, 200, at_ms=10)
    seen = [told(tracker, 0, 300, 200, at_ms=20), told(tracker, 0b100, 300, 200, at_ms=30)]
    seen += [told(tracker, 0, 300, 200, at_ms=40 + 10 * n) for n in range(8)]
    assert [event for part in seen for event in part] == [(200, True)]


def test_a_flag_without_a_crossing_on_the_path_is_one_event() -> None:
    tracker = FlagTracker(compare_reads(), Points((200,)), (200, 200))
    told(tracker, 0, 200, 200, at_ms=10)
    seen = [told(tracker, 0b110, 200, 200, at_ms=20)]
    seen += [told(tracker, 0, 200, 200, at_ms=30 + 10 * n) for n in range(12)]
    assert [count for part in seen for count, _ in part] == [200]


def test_only_the_flags_that_were_read_are_cleared() -> None:
    tracker = DualTracker(compare_reads(), Grid(0, 100), 150)
    tracker.advance(still(150.0, 0.0, 1000.0))
    assert tracker.report((0b001, 100, 200), 1000.0, 1500.0)[1] == []
    (clear,) = tracker.report((0b101, 300, 200), 2000.0, 2500.0)[1]
    assert (clear.index, clear.data) == (0x2161, bytes.fromhex("04000000"))


def test_a_sequence_counts_over_the_wrap_of_32_bits() -> None:
    tracker = SingleTracker(compare_reads(), 2**31 - 150, 100)
    tracker.advance(still(0.0, 0.0, 1000.0))
    events, _ = tracker.report((0b010, -(2**31) + 50, 0), 1000.0, 1500.0)
    assert len(events) == 2
    assert not tracker.lost


def test_values_that_no_longer_flank_the_axis_are_noticed() -> None:
    tracker = DualTracker(compare_reads(), Grid(0, 100), 150)
    for n in range(1, 3):
        tracker.advance(still(450.0, 1000.0 * n, 1000.0 * n + 1000))
        tracker.report((0, 100, 200), 1000.0 * n + 900, 1000.0 * n + 1000)
    assert tracker.lost


def test_a_sequence_that_somebody_else_has_set_is_noticed() -> None:
    tracker = SingleTracker(compare_reads(), 5000, 100)
    tracker.advance(still(0.0, 0.0, 1000.0))
    assert tracker.report((0, 5050, 0), 1000.0, 1500.0) == ([], [])
    assert tracker.lost
