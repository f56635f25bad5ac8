"""What is said of position-triggered outputs before a motion runs."""

from __future__ import annotations

from pathlib import Path as File

import numpy as np
import pytest
import yaml

from epos2_ros.configuration.outputs import CompareConfig
from epos2_ros.motion.compare import Trigger, difference, extrapolation_error, predict
from epos2_ros.motion.crossings import Grid, Path, Points
from epos2_ros.motion.curve import Curve
from epos2_ros.motion.units import AxisUnits
from epos2_ros.protocol.outputs.copley import HardwareOutput

COUNTS = AxisUnits("x", "m", 2000, 1.0)
MILLIMETRES = AxisUnits("x", "m", 2000, 2_000_000.0)


def stop(velocity: float, deceleration: float, before_s: float = 0.0) -> Path:
    """Constant velocity for a while, then deceleration to rest; counts and seconds."""
    ramp_s = velocity / deceleration
    t = np.linspace(0.0, before_s + ramp_s, 2001)
    ramp = np.maximum(t - before_s, 0.0)
    position = velocity * t - 0.5 * deceleration * ramp**2
    return Path(t * 1e6, position, velocity - deceleration * ramp)


def test_extrapolation_error_of_the_document() -> None:
    """400,000,000 counts/s² over 250 µs: about 12.5 counts."""
    assert extrapolation_error(np.array([-400e6])) == pytest.approx([12.5])


def test_a_target_that_is_never_reached_may_fire() -> None:
    """The document's figure: at rest at 450, extrapolated up to 461, a target of 460."""
    trigger = Trigger(Points((460,)), pulse_us=1.0, extrapolated=True)
    prediction = predict(trigger, stop(600_000.0, 400e6), COUNTS)
    assert len(prediction.fired) == 0
    (warning,) = prediction.warnings
    assert "stops at 450 m" in warning
    assert "goes on to 462.5 m" in warning
    assert "quadrature encoder on the drive's primary input" in warning
    far = Trigger(Points((464,)), pulse_us=1.0, extrapolated=True)
    assert predict(far, stop(600_000.0, 400e6), COUNTS).warnings == ()
    quadrature = Trigger(Points((460,)), pulse_us=1.0)
    assert predict(quadrature, stop(600_000.0, 400e6), COUNTS).warnings == ()


def test_dual_mode_may_fire_twice_where_the_axis_slows_down_single_mode_not() -> None:
    dual = Trigger(Grid(0, 100), pulse_us=1.0, extrapolated=True)
    prediction = predict(dual, stop(600_000.0, 400e6), COUNTS)
    assert prediction.fired.count.tolist() == [100, 200, 300, 400]
    assert prediction.error_qc == pytest.approx([12.5] * 4)
    early, twice = prediction.warnings
    assert "up to 12.5 counts (12.5 m) early or late" in early
    assert "4 of 4 outputs may fire twice" in twice
    assert "at constant velocity" in twice
    single = Trigger(Grid(100, 100), falling=False, sequence=True, extrapolated=True)
    assert len(predict(single, stop(600_000.0, 400e6), COUNTS).warnings) == 1


def test_an_output_where_the_axis_stops_is_said() -> None:
    (warning,) = predict(Trigger(Grid(0, 50)), stop(600_000.0, 400e6), COUNTS).warnings
    assert warning.startswith("the axis stops or turns at 450 m, within 2 counts of an output")
    assert predict(Trigger(Grid(25, 50)), stop(600_000.0, 400e6), COUNTS).warnings == ()


def test_an_error_beyond_the_spacing_is_said() -> None:
    trigger = Trigger(Grid(5, 10), extrapolated=True)
    warnings = predict(trigger, stop(600_000.0, 400e6), COUNTS).warnings
    assert "12.5 counts (12.5 m), more than the 10 counts between outputs" in warnings[0]


def test_nothing_is_said_of_crossings_at_constant_velocity() -> None:
    trigger = Trigger(Points((100, 200, 300)), pulse_us=10.0, extrapolated=True)
    path = stop(600_000.0, 400e6, before_s=0.001)  # 600 counts before it slows down
    prediction = predict(trigger, path, COUNTS)
    assert prediction.error_qc == pytest.approx([0.0] * 3, abs=1e-6)
    assert prediction.warnings == ()


def test_pulses_that_overlap_are_said() -> None:
    trigger = Trigger(Points((100, 200, 500)), pulse_us=501.0)
    path = Path(np.array([0.0, 5000.0]), np.array([0.0, 1000.0]), np.full(2, 200_000.0))
    (warning,) = predict(trigger, path, COUNTS).warnings
    assert warning == (
        "1 pulses overlap: a pulse lasts 501 µs, and at 100 m the next edge is 500 µs away"
    )


def test_a_window_shorter_than_the_loop_is_said() -> None:
    trigger = Trigger(Points((100, 120)), sampled=True)
    path = Path(np.array([0.0, 5000.0]), np.array([0.0, 1000.0]), np.full(2, 200_000.0))
    (warning,) = predict(trigger, path, COUNTS).warnings
    assert warning.startswith("1 passes through the window may be missed: the drive's loop lasts")
    assert "100 µs away" in warning


def test_a_sequence_fires_each_count_once_and_ends() -> None:
    """Single compare mode, with end position: there, back, and there again."""
    t = np.array([0.0, 1e6, 2e6, 3e6])
    path = Path(t, np.array([0.0, 350.0, 50.0, 900.0]), np.zeros(4))
    endless = Trigger(Grid(100, 100), falling=False, sequence=True)
    assert endless.fires(path).count.tolist() == [100, 200, 300, 400, 500, 600, 700, 800, 900]
    ended = Trigger(Grid(100, 100), falling=False, sequence=True, end=500)
    assert ended.fires(path).count.tolist() == [100, 200, 300, 400, 500]
    down = Trigger(Grid(300, 100), rising=False, sequence=True)
    assert down.fires(path).count.tolist() == [300, 200, 100]


def test_a_sequence_begins_only_at_its_start() -> None:
    t = np.array([0.0, 1e6, 2e6, 3e6])
    path = Path(t, np.array([250.0, 500.0, 50.0, 350.0]), np.zeros(4))
    sequence = Trigger(Grid(100, 100), falling=False, sequence=True)
    assert sequence.fires(path).count.tolist() == [100, 200, 300]
    assert np.all(sequence.fires(path).t_us > 2e6)


def raster(file: File) -> tuple[Path, list[tuple[int, bool, float]]]:
    """The example's path of gantry_x, and by hand what an output every 1 mm does on it.

    Lines of 200 mm to and fro, 1.5 s apart, each with 0.2 s of 1 m/s² at both ends. In counts of
    0.5 µm the encoder changes half a count before the millimetre going up, and at the same place
    going down.
    """
    message = yaml.safe_load(file.read_text())
    points = message["points"]
    times = np.array(
        [p["time_from_start"]["sec"] + p["time_from_start"]["nanosec"] * 1e-9 for p in points]
    )
    curve = Curve(
        times,
        np.array([p["positions"] for p in points]),
        np.array([p["velocities"] for p in points]),
    )
    t = np.arange(int(times[-1] * 1000) + 1) / 1000
    qc = MILLIMETRES.to_qc(curve.evaluate(t)[:, 0])
    path = Path(t * 1e6, qc, MILLIMETRES.to_qc_s(curve.evaluate(t, 1)[:, 0]))

    def when(way: float) -> float:
        """Time after which an axis that starts at rest has come so far [m]."""
        if way <= 0.02:
            return float(np.sqrt(2 * way))
        if way <= 0.18:
            return 0.1 + way / 0.2
        return 1.2 - float(np.sqrt(2 * (0.2 - way)))

    events = []
    for line in range(6):
        up = line % 2 == 0
        for n in range(1, 201):
            edge = (n * 2000 - 0.5) / 2e6
            events.append((n * 2000, up, line * 1.5 + when(edge if up else 0.2 - edge)))
    events.sort(key=lambda event: event[2])
    return path, events


def test_raster_scan_with_an_output_every_millimetre(examples: File) -> None:
    path, by_hand = raster(examples / "raster_scan.yaml")
    config = CompareConfig("camera", "x", "interval", start=0.0, interval=0.001, pulse=0.0005)
    fired = predict(HardwareOutput(config, MILLIMETRES).trigger, path, MILLIMETRES).fired
    assert len(fired) == len(by_hand) == 1200
    assert fired.count.tolist() == [count for count, _, _ in by_hand]
    assert fired.rising.tolist() == [up for _, up, _ in by_hand]
    late_us = fired.t_us - 1e6 * np.array([t for _, _, t in by_hand])
    # Half a count is passed slowly where the axis turns: there a rounding error is a while.
    assert np.max(np.abs(late_us)) < 250.0
    assert np.sort(np.abs(late_us))[-7] < 1.0


def test_difference_between_predicted_and_reported() -> None:
    path = Path(np.array([0.0, 1e6]), np.array([0.0, 350.0]), np.full(2, 350.0))
    predicted = Trigger(Grid(0, 100)).fires(path)
    same = [(int(c), True, float(t)) for c, t in zip(predicted.count, predicted.t_us, strict=True)]
    assert difference(predicted, same) == ("", 0.0)
    assert difference(predicted, same[:2])[0] == "3 events predicted, 2 reported"
    late = [same[0], (200, True, same[1][2] + 12_000), same[2]]
    assert difference(predicted, late) == (
        "event 2 at count 200 came +12000 µs from where predicted",
        pytest.approx(12_000),
    )
    little = [same[0], (200, True, same[1][2] - 400), same[2]]
    assert difference(predicted, little) == ("", pytest.approx(-400))
    wrong = [same[0], (200, False, same[1][2]), same[2]]
    assert difference(predicted, wrong)[0] == (
        "event 2 predicted at count 200 upward, reported at 200 downward"
    )


def test_a_fast_crossing_that_is_late_is_told_though_a_slow_one_may_be_later() -> None:
    """At 316 counts/s two counts take 6 ms, at 89,000 counts/s next to nothing."""
    t = np.linspace(0.0, 1.0, 1001)
    predicted = Trigger(Points((1, 40_000))).fires(Path(t * 1e6, 5e4 * t**2, 1e5 * t))
    slow, fast = predicted.t_us
    told = difference(predicted, [(1, True, slow + 7000), (40_000, True, fast + 6000)])
    assert told == (
        "event 2 at count 40000 came +6000 µs from where predicted",
        pytest.approx(7000),
    )
    assert difference(predicted, [(1, True, slow + 7000), (40_000, True, fast)])[0] == ""
