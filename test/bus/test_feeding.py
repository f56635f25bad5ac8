"""Feeding for long on a slow bus with a full transmit queue; the hour is in docs/time.md."""

from __future__ import annotations

import pytest

from benchmarks import feeding
from benchmarks.bus_load import measure, reach
from epos2_ros.bus.transmitter import MAX_IN_FLIGHT
from epos2_ros.sim.can_bus import SimulatedBus


def test_no_record_is_lost_repeated_or_overtaken():
    records, refused = feeding.feed(12.0)
    assert records > 300
    assert refused > 50


def test_a_lost_record_would_be_noticed(monkeypatch: pytest.MonkeyPatch):
    complete = SimulatedBus._complete
    records = 0

    def losing(bus: SimulatedBus) -> None:
        nonlocal records
        records += bus._sending is not None and bus._sending[0] & 0x780 == feeding.RECORD
        bus.drop = (lambda *frame: True) if records == 40 else None
        complete(bus)

    monkeypatch.setattr(SimulatedBus, "_complete", losing)
    with pytest.raises(SystemExit, match="lost, repeated or overtaken"):
        feeding.feed(12.0)


def test_64_axes_move_on_one_bus_at_1_mbit_s():
    """Half of it stays free. A SYNC in an adapter's queue waits for three records at most, and
    those, by their identifiers, for one buffer report of every drive."""
    axes, frame_us = 64, 135
    load = measure(axes, 10.0, 1_000_000, settled_s=0.2, lasts_s=0.8)
    assert 0.001 * axes < load.total < 0.5
    assert load.sync_late_us < (MAX_IN_FLIGHT + axes + 1) * frame_us
    assert load.apart_us < 20  # ±100 ppm between two SYNCs, and the stamps of 64 one after another
    assert load.reserve_ms > 300


def test_six_axes_leave_the_bus_quiet():
    load = measure(6, 1.0, 1_000_000)
    assert sum(load.frames_s.values()) <= 250


@pytest.mark.parametrize(("six", "twelve", "axes"), [(0.15, 0.27, 28), (0.35, 0.64, 11)])
def test_how_many_axes_fill_a_bus(six: float, twelve: float, axes: int):
    """Every further axis takes as much as the last; 60 % is full, also with fewer than twelve."""
    assert reach({6: six, 12: twelve}, 6, 12) == axes
