"""Position-triggered outputs end to end in simulated time: drives, bus, SDO, events.

What the simulated drives really fired is the truth; times are also worked out by hand.
"""

from __future__ import annotations

import math
import struct
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path as File
from typing import Any

import numpy as np
import pytest
import yaml
from compare_bench import CompareBench, copley_axis

from epos2_ros.bus.sdo_jobs import write_all
from epos2_ros.configuration.driver import AxisConfig, DriverConfig
from epos2_ros.configuration.outputs import CompareConfig
from epos2_ros.errors import ConfigurationError, DriveError, MotionAborted, TrajectoryError
from epos2_ros.motion.compare import Prediction, predict
from epos2_ros.motion.crossings import Path
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.protocol.outputs.outputs import OutputEvent, Outputs, Tally
from epos2_ros.protocol.phase import Phase
from epos2_ros.sim.copley import Copley
from epos2_ros.sim.epos2 import Epos2

COUNT = 0.5e-6  # [m]
LOOP_US = 250.0
BELT = {"type": "prismatic", "counts_per_turn": 2000, "gear_ratio": 100.0, "lead": 0.1}


def gantry() -> DriverConfig:
    return DriverConfig(
        axes=tuple(AxisConfig(f"gantry_{n}", i, **BELT) for i, n in ((1, "x"), (2, "y")))
    )


def output(kind: str, joint: str = "x", **parameters: Any) -> CompareConfig:
    return CompareConfig("camera", joint, kind, **parameters)


def bench(
    *outputs: CompareConfig, drive: Copley | None = None, **changes: Any
) -> tuple[CompareBench, Copley]:
    """x on a Copley drive, y on an EPOS2, enabled."""
    drive = drive or Copley(1)
    config = DriverConfig(axes=(copley_axis("x", 1, **changes), AxisConfig("y", 2)))
    made = CompareBench(config, outputs, [drive, Epos2(2)])
    made.enable()
    return made, drive


def counts(events: list[OutputEvent]) -> list[tuple[int, bool]]:
    return [(round(event.position / COUNT), event.velocity > 0) for event in events]


def fired(drive: Copley) -> list[tuple[int, bool]]:
    return [(event.value, event.rising) for event in drive.module.fired]


def when(way: float) -> float:
    """Time after which a move of 0.2 m at 0.2 m/s and 1 m/s² has come so far [m → s]."""
    if way <= 0.02:
        return math.sqrt(2 * way)
    if way <= 0.18:
        return 0.1 + way / 0.2
    return 1.2 - math.sqrt(max(0.0, 2 * (0.2 - way)))


# --- the raster scan ------------------------------------------------------------------------------


def test_raster_scan_on_a_copley_drive() -> None:
    """Lines of 200 mm to and fro with an output every 1 mm: number, order, positions, times."""
    made, drive = bench(output("interval", start=0.0, interval=0.001, pulse=0.0005))
    by_hand = []
    for line in range(6):
        up = line % 2 == 0
        start_us = made.move(x=0.2 if up else 0.0)
        # The encoder changes to a millimetre's count half a count before it.
        edges = [(n * 2000 - 0.5) * COUNT for n in range(1, 201)]
        times = [when(edge if up else 0.2 - edge) for edge in edges]
        by_hand += sorted((start_us + 1e6 * t, 2000 * n, up) for n, t in enumerate(times, 1))
        made.run(0.3)
    made.run(0.5)
    events = made.of("camera")
    assert len(events) == len(by_hand) == 1200
    assert counts(events) == [(count, up) for _, count, up in by_hand] == fired(drive)
    late_us = np.array([e.t_us - t for e, (t, _, _) in zip(events, by_hand, strict=True)])
    assert np.max(np.abs(late_us)) <= LOOP_US
    really = np.array([f.t_us for f in drive.module.fired])
    assert np.max(np.abs(np.array([e.t_us for e in events]) - really)) <= LOOP_US
    assert made.notices == []


@pytest.mark.parametrize("lag_ms", [0.0, 0.4, 3.0])
def test_raster_scan_on_an_epos2(examples: File, lag_ms: float) -> None:
    """The shipped trajectory in interpolated position mode; outputs between the turning points."""
    config = gantry()
    drives = [Epos2(1, lag_ms=lag_ms), Epos2(2, lag_ms=lag_ms)]
    camera = output("interval", "gantry_x", start=0.0005, interval=0.001, pulse=0.0005)
    made = CompareBench(config, [camera], drives)
    made.enable()
    message = yaml.safe_load((examples / "raster_scan.yaml").read_text())
    made.path.submit(Trajectory.from_dict(message), None, made.now_us)
    made.run(1.0)
    made.wait(made.group.motion, 20.0)  # type: ignore[arg-type]
    made.run(0.5)
    events, really = made.of("camera"), drives[0].fired
    assert len(events) == 1200
    assert counts(events) == [(pulse.value, pulse.rising) for pulse in really]
    late_us = [event.t_us - pulse.t_us for event, pulse in zip(events, really, strict=True)]
    assert max(map(abs, late_us)) <= LOOP_US
    # By hand, from the start SYNC and a first record that holds the position for a millisecond:
    # late by how far the axis lags, and by nothing else.
    assert made.machine.path_time.start_us is not None
    zero_us = made.machine.path_time.start_us + 1000
    by_hand = sorted(
        zero_us + 1e6 * (1.5 * line + when(edge if line % 2 == 0 else 0.2 - edge))
        for line in range(6)
        for edge in [(1000 + n * 2000 - 0.5) * COUNT for n in range(200)]
    )
    late = np.array([event.t_us - t for event, t in zip(events, by_hand, strict=True)])
    assert np.max(np.abs(late - np.median(late))) <= LOOP_US
    # What is left of a step falls by 1/e every lag_ms, in steps of 1 ms (the sum of what is left).
    share = 1.0 - math.exp(-1.0 / lag_ms) if lag_ms else 1.0
    assert np.median(late) == pytest.approx(1000 * (1 / share - 1), abs=20.0)
    if lag_ms <= 0.4:
        assert np.max(np.abs(late)) <= LOOP_US


@pytest.mark.parametrize("lag_ms", [0.0, 1.0])
def test_raster_scan_on_a_copley_drive_that_follows_a_trajectory(
    examples: File, lag_ms: float
) -> None:
    """x by PVT segments, y by an EPOS2's records, on one SYNC; the times are those of its path."""
    x, y = gantry().axes
    config = DriverConfig(axes=(replace(x, drive="copley"), y))
    drive = Copley(1, lag_ms=lag_ms, drift_ppm=80.0, offset_us=3e9)
    camera = output("interval", "gantry_x", start=0.0005, interval=0.001, pulse=0.0005)
    made = CompareBench(config, [camera], [drive, Epos2(2)])
    made.enable()
    message = yaml.safe_load((examples / "raster_scan.yaml").read_text())
    made.path.submit(Trajectory.from_dict(message), None, made.now_us)
    made.run(1.0)
    made.wait(made.group.motion, 20.0)  # type: ignore[arg-type]
    made.run(0.5)
    events = made.of("camera")
    assert len(events) == 1200
    assert counts(events) == fired(drive)
    pairs = zip(events, drive.module.fired, strict=True)
    assert max(abs(event.t_us - pulse.t_us) for event, pulse in pairs) <= LOOP_US
    assert made.notices == []


def test_a_host_that_sees_sync_late_tells_the_same(examples: File) -> None:
    """An adapter without time stamps and a busy host: now and then up to 45 ms late."""
    drives = [Epos2(1), Epos2(2)]
    camera = output("interval", "gantry_x", start=0.0005, interval=0.001)
    made = CompareBench(gantry(), [camera], drives)
    made.enable()
    message = yaml.safe_load((examples / "raster_scan.yaml").read_text())
    made.path.submit(Trajectory.from_dict(message), None, made.now_us)
    made.run(1.0, lambda: made.machine.path_time.start_us is not None)

    def seen_us(t_us: float) -> float:
        """Never two in the wrong order."""
        late = math.sin(t_us * 1e-6) > 0.7
        return t_us + 45_000 * (math.sin(t_us * 1e-6) - 0.7) / 0.3 if late else t_us

    made.stamp_us = seen_us
    made.wait(made.group.motion, 20.0)  # type: ignore[arg-type]
    made.run(0.5)
    events, really = made.of("camera"), drives[0].fired
    assert counts(events) == [(pulse.value, pulse.rising) for pulse in really]
    assert len(events) == 1200
    late_us = [event.t_us - pulse.t_us for event, pulse in zip(events, really, strict=True)]
    assert np.max(np.abs(late_us)) <= 5000  # the drives' clocks follow the late stamps a little


def test_an_epos2_that_turns_on_an_output_tells_what_it_fires(examples: File) -> None:
    """On the grid of turning points the drive fires more often; so does the topic."""
    config = gantry()
    drives = [Epos2(1, lag_ms=0.0), Epos2(2, lag_ms=0.0)]
    camera = output("interval", "gantry_x", start=0.0, interval=0.001)
    made = CompareBench(config, [camera], drives)
    made.enable()
    message = yaml.safe_load((examples / "raster_scan.yaml").read_text())
    made.path.submit(Trajectory.from_dict(message), None, made.now_us)
    made.run(1.0)
    made.wait(made.group.motion, 20.0)  # type: ignore[arg-type]
    made.run(0.5)
    assert counts(made.of("camera")) == [(f.value, f.rising) for f in drives[0].fired]


# --- kinds ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("parameters", "expected"),
    [
        ({"kind": "crossing", "positions": (0.01,)}, [(20_000, True), (20_000, False)]),
        (
            {"kind": "crossing", "positions": (0.01, 0.02)},
            [(20_000, True), (40_000, True), (40_000, False), (20_000, False)],
        ),
        (  # above value 0, up to value 1
            {"kind": "window", "window": (0.01, 0.02)},
            [(20_001, True), (40_001, True), (40_001, False), (20_001, False)],
        ),
        (
            {"kind": "interval", "start": 0.01, "interval": 0.005, "direction": "up"},
            [(20_000, True), (30_000, True), (40_000, True)],
        ),
        (
            {"kind": "interval", "start": 0.01, "interval": 0.005, "end": 0.015},
            [(20_000, True), (30_000, True)],
        ),
    ],
)  # fmt: skip
def test_what_the_hardware_fires_is_told(
    parameters: dict[str, Any], expected: list[tuple[int, bool]]
) -> None:
    made, drive = bench(output(**parameters))
    made.move(x=0.024)
    made.move(x=0.0)
    made.run(0.5)
    assert counts(made.of("camera")) == expected == fired(drive)
    for event, really in zip(made.of("camera"), drive.module.fired, strict=True):
        assert abs(event.t_us - really.t_us) <= LOOP_US


@pytest.mark.parametrize(
    ("parameters", "expected"),
    [
        ({"kind": "crossing", "direction": "up", "positions": (0.01,)}, [(20_000, True)]),
        ({"kind": "crossing", "direction": "down", "positions": (0.01,)}, [(20_000, False)]),
        (
            {"kind": "series", "positions": (0.01, 0.015)},
            [(20_000, True), (30_000, True), (30_000, False), (20_000, False)],
        ),
        (  # both ends inside
            {"kind": "window", "method": "software", "window": (0.01, 0.02)},
            [(20_000, True), (40_001, True), (40_001, False), (20_000, False)],
        ),
    ],
)  # fmt: skip
def test_what_software_fires_is_computed(
    parameters: dict[str, Any], expected: list[tuple[int, bool]]
) -> None:
    made, drive = bench(output(pin=3, **parameters))
    made.move(x=0.024)
    made.move(x=0.0)
    made.run(0.5)
    events = made.of("camera")
    assert counts(events) == expected
    really = drive.pins[2].fired
    assert [pulse.rising for pulse in really] == [rising for _, rising in expected]
    for event, pulse in zip(events, really, strict=True):  # the firmware looks once a loop
        assert abs(pulse.t_us - event.t_us - LOOP_US / 2) <= LOOP_US


@pytest.mark.parametrize("reference", ["actual", "commanded"])
def test_software_compares_with_the_actual_or_the_commanded_position(reference: str) -> None:
    """The axis is 5 ms late; the output that follows the commanded position is not."""
    crossing = output("crossing", positions=(0.05, 0.1), reference=reference, method="software")
    made, drive = bench(crossing, drive=Copley(1, lag_ms=5.0))
    made.outputs.begin(0)
    made.outputs.expect(foreseen(made, predicted(made, 0.2)))
    start_us = made.move(x=0.2)
    made.outputs.finished(0, start_us, made.now_us)
    made.run(1.0)
    edges = [(n - 0.5) * COUNT for n in (100_000, 200_000)]
    late_us = [
        e.t_us - start_us - 1e6 * when(x) for e, x in zip(made.of("camera"), edges, strict=True)
    ]
    really = [pulse.t_us for pulse in drive.pins[0].fired]
    assert late_us == pytest.approx([5000.0 if reference == "actual" else 0.0] * 2, abs=LOOP_US)
    assert [e.t_us for e in made.of("camera")] == pytest.approx(really, abs=1.5 * LOOP_US)
    assert made.outputs.tally("camera").predicted == 2
    assert made.notices == []


def test_a_reversed_joint_tells_its_own_positions() -> None:
    made, drive = bench(
        output("interval", start=0.01, interval=0.005, direction="up"), direction=-1
    )
    made.move(x=0.024)
    made.run(0.5)
    assert [round(event.position, 9) for event in made.of("camera")] == [0.01, 0.015, 0.02]
    assert all(event.velocity > 0 for event in made.of("camera"))
    assert fired(drive) == [(-20_000, False), (-30_000, False), (-40_000, False)]


@pytest.mark.parametrize(
    ("start", "direction", "says"),
    [
        (0.0, "up", "0 m, on the way up"),
        (0.01, "down", "0.01 m, on the way down"),
        (0.01, "up", ""),
    ],
)
def test_a_sequence_that_begins_behind_the_axis_is_remarked(
    start: float, direction: str, says: str
) -> None:
    made, _ = bench(output("interval", start=start, interval=0.001, direction=direction))
    said = "compare.camera: the axis stands at 0 m; nothing fires before it crosses start, "
    assert made.notices == ([said + says] if says else [])


def test_a_series_gets_a_new_list_while_the_axis_moves() -> None:
    series = output("series", positions=(0.01, 0.15), capacity=3)
    made, drive = bench(series)
    motion = made.start(x=0.2)
    made.run(0.6)  # at 60 to 90 mm
    made.outputs.set_positions("camera", (0.02, 0.12, 0.18))
    made.wait(motion)
    made.run(0.3)
    assert counts(made.of("camera")) == [(20_000, True), (240_000, True), (360_000, True)]
    assert [pulse.value for pulse in drive.pins[0].fired] == [20_000, 240_000, 360_000]
    with pytest.raises(ConfigurationError, match="a list of 4; memory is reserved for 3"):
        made.outputs.set_positions("camera", (0.02, 0.12, 0.18, 0.19))
    with pytest.raises(ConfigurationError, match="there is no output laser; the outputs are camer"):
        made.outputs.set_positions("laser", (0.02,))


def test_an_output_is_configured_anew() -> None:
    made, drive = bench(output("crossing", positions=(0.01,)))
    made.move(x=0.02)
    made.run(0.2)
    changed = output("interval", start=0.0, interval=0.005)
    assert drive.position_actual == 40_000
    write_all(made.sdo[0], made.outputs.reconfigure(changed, drive.position_actual))
    made.move(x=0.0)
    made.run(0.3)
    downward = [(40_000, False), (30_000, False), (20_000, False), (10_000, False)]
    assert counts(made.of("camera")) == [(20_000, True), *downward] == fired(drive)
    with pytest.raises(ConfigurationError, match="lower end comes first"):
        made.outputs.reconfigure(output("window", window=(0.2, 0.1)), 0)


def test_a_series_that_grows_takes_no_other_series_memory() -> None:
    first = CompareConfig("glue", "x", "series", positions=(0.01, 0.02), pulse=0.005)
    second = CompareConfig("flash", "x", "series", pin=2, positions=(0.015,), pulse=0.005)
    made, drive = bench(first, second)
    longer = replace(first, positions=(0.005, 0.01, 0.02), capacity=9)
    write_all(made.sdo[0], made.outputs.reconfigure(longer, drive.position_actual))
    made.move(x=0.024)
    made.run(0.3)
    assert counts(made.of("glue")) == [(10_000, True), (20_000, True), (40_000, True)]
    assert [pulse.value for pulse in drive.pins[0].fired] == [10_000, 20_000, 40_000]
    assert [pulse.value for pulse in drive.pins[1].fired] == [30_000]


def test_an_output_that_moves_to_another_pin_leaves_its_own() -> None:
    made, drive = bench(output("crossing", positions=(0.01,)))
    moved = output("crossing", positions=(0.01,), pin=2)
    write_all(made.sdo[0], made.outputs.reconfigure(moved, drive.position_actual))
    functions = [made.sdo[0].sdo.upload(0x2193, pin)[0] for pin in (1, 2)]
    assert functions == [4, 16]  # a window, and the compare module
    low, high = struct.unpack("<ii", made.sdo[0].sdo.upload(0x2193, 1)[2:])
    assert low > high  # which nothing is in


def test_outputs_whose_drive_was_set_by_somebody_else_are_armed_anew() -> None:
    made, drive = bench(output("interval", start=0.0, interval=0.005))
    made.move(x=0.012)
    drive.module.values = [1_000_000, 1_010_000]
    made.run(0.5)
    assert any("no longer fit the axis' position" in notice for notice in made.notices)
    before = len(made.of("camera"))
    made.move(x=0.0)
    made.run(0.5)
    assert counts(made.of("camera"))[before:] == [(20_000, False), (10_000, False)]


def test_the_position_marker_tells_captured_positions() -> None:
    axis = AxisConfig("gantry_x", 1, **BELT)
    drive = Epos2(1)
    probe = CompareConfig("probe", "gantry_x", "marker", direction="up")
    made = CompareBench(DriverConfig(axes=(axis,)), [probe], [drive])
    made.enable()
    trajectory = Trajectory(
        ("gantry_x",), np.array([0.0, 1.0]), np.array([[0.0], [0.1]]), np.zeros((2, 1))
    )
    made.path.submit(trajectory, None, made.now_us)
    captured = []
    for _ in range(3):
        made.run(0.25)
        captured.append((made.now_us, drive.position_actual))
        drive.input_edge(rising=True)
        drive.input_edge(rising=False)
    made.run(1.0)
    events = made.of("probe")
    assert [round(event.position / COUNT) for event in events] == [count for _, count in captured]
    for event, (t_us, _) in zip(events, captured, strict=True):
        assert abs(event.t_us - t_us) < 1500  # the drive captures what it measured last


# --- prediction and report ------------------------------------------------------------------------


def predicted(made: CompareBench, target: float) -> Path:
    """What x will do from rest, in counts from the start SYNC."""
    t = np.arange(0, 1_300_000.0, 1000.0)
    at = np.clip(t / 1e6, 0, 1.2)
    ramp = np.minimum(at, 0.2)
    end = np.maximum(at - 1.0, 0.0)
    x = 0.5 * ramp**2 + 0.2 * np.maximum(at - 0.2, 0.0) - 0.5 * end**2
    v = ramp - end
    return Path(t, target / 0.2 * x / COUNT, target / 0.2 * v / COUNT)


def foreseen(made: CompareBench, path: Path) -> dict[str, Prediction]:
    units = made.outputs.units[0]
    return {
        name: predict(trigger, path, units) for name, trigger in made.outputs.triggers(0).items()
    }


def test_what_was_predicted_is_held_against_what_is_reported() -> None:
    made, drive = bench(output("interval", start=0.0005, interval=0.001))
    predictions = foreseen(made, predicted(made, 0.2))
    assert len(predictions["camera"].fired) == 200
    assert predictions["camera"].warnings == ()
    made.outputs.begin(0)
    made.outputs.expect(predictions)
    start_us = made.move(x=0.2)
    made.outputs.finished(0, start_us, made.now_us)
    made.run(1.0)
    assert len(made.of("camera")) == 200
    assert made.notices == []
    tally = made.outputs.tally("camera")
    assert tally == Tally(200, 200, 200, late_us=tally.late_us)
    assert abs(tally.late_us) <= LOOP_US


def test_a_difference_from_the_prediction_is_told() -> None:
    made, drive = bench(output("interval", start=0.0005, interval=0.001))
    made.outputs.begin(0)
    made.outputs.expect(foreseen(made, predicted(made, 0.2)))
    start_us = made.move(x=0.1)
    made.outputs.finished(0, start_us, made.now_us)
    made.run(1.0)
    assert made.notices == ["compare.camera: 200 events predicted, 100 reported"]


def test_motions_one_right_after_the_other_are_compared_each_with_its_own() -> None:
    """There was no time to predict the first; what it fires belongs to no other."""
    made, drive = bench(output("interval", start=0.0005, interval=0.001))
    made.outputs.begin(0)
    made.move(x=0.2)
    back = predicted(made, -0.2)
    back = Path(back.t_us, 400_000 + back.position_qc, back.velocity_qc_s)
    for path, target in ((back, 0.0), (predicted(made, 0.2), 0.2)):
        made.outputs.begin(0)
        made.outputs.expect(foreseen(made, path))
        start_us = made.move(x=target)
        made.outputs.finished(0, start_us, made.now_us)
    made.run(1.0)
    assert made.notices == []
    tally = made.outputs.tally("camera")
    assert (tally.events, tally.predicted, tally.reported) == (600, 200, 200)


def test_what_is_left_of_a_sequence_is_predicted() -> None:
    made, drive = bench(output("interval", start=0.01, interval=0.01, end=0.05))
    made.move(x=0.025)
    made.run(0.5)
    made.move(x=0.0)
    left = foreseen(made, predicted(made, 0.2))["camera"].fired
    assert left.count.tolist() == [60_000, 80_000, 100_000]


def test_a_sequence_goes_on_where_the_motion_before_will_leave_it() -> None:
    """Also before the drive has reported what that motion fired."""
    made, _ = bench(output("interval", start=0.01, interval=0.01, direction="up"))
    made.outputs.begin(0)
    made.outputs.expect(foreseen(made, predicted(made, 0.055)))
    left = foreseen(made, predicted(made, 0.1))["camera"].fired
    assert left.count.tolist() == [120_000, 140_000, 160_000, 180_000, 200_000]


def test_an_interval_that_is_no_whole_number_of_counts_is_said() -> None:
    axes = (copley_axis(),)
    outputs = Outputs(axes, [output("interval", start=0.0, interval=0.0010003)], [])
    assert list(outputs.notices) == [
        "compare.camera.interval is 0.0010003, which is not a whole number of counts: "
        "outputs are 0.0010005 m apart"
    ]


def test_an_unknown_joint_is_refused() -> None:
    with pytest.raises(ConfigurationError) as refused:
        Outputs((copley_axis(),), [output("crossing", "z", positions=(0.1,))], [])
    assert str(refused.value) == "compare.camera.joint is z; the joints are x"


# --- moves in profile position mode --------------------------------------------------------------


def two(**changes: Any) -> tuple[CompareBench, list[Copley]]:
    drives = [Copley(1, **changes), Copley(2)]
    config = DriverConfig(
        axes=(copley_axis("x", 1), copley_axis("z", 2, max_velocity=0.05), AxisConfig("y", 3))
    )
    made = CompareBench(config, (), [*drives, Epos2(3)])
    made.enable()
    return made, drives


def answer_of(motion: Future[None]) -> str:
    return str(motion.exception(timeout=0))


def test_axes_leave_on_one_sync_and_arrive_together() -> None:
    made, drives = two()
    start_us = made.move(x=0.1, z=0.02)
    assert [drive.position_actual for drive in drives] == [200_000, 40_000]
    assert [drive.started_us for drive in drives] == [start_us, start_us]
    # x alone: 0.1 m at 0.2 m/s and 1 m/s² last 0.7 s, and z is made to last as long
    arrivals = [drive.arrived_us - start_us for drive in drives]
    assert arrivals == pytest.approx([0.7e6, 0.7e6], abs=1000.0)


def test_a_start_that_does_not_get_onto_the_bus_before_sync_starts_nobody() -> None:
    """No SYNC may come between two controlwords, or the axes would start apart."""
    made, drives = two()
    made.bus.drop = lambda can_id, data, source: can_id == 0x302  # z's synchronous controlword
    motion = made.start(x=0.1, z=0.02)
    made.run(3.0, motion.done)
    assert answer_of(motion) == "the start controlword was not seen on the bus for 1 axes"
    made.bus.drop = None
    made.run(1.0)
    assert [drive.position_actual for drive in drives] == [0, 0]


def test_a_move_while_moving_is_refused_and_the_next_is_not() -> None:
    made, _ = two()
    motion = made.start(x=0.1)
    made.run(0.4)
    with pytest.raises(TrajectoryError, match="can't move: the drives are moving"):
        made.start(x=0.0)
    made.wait(motion)
    made.move(x=0.0)


def test_a_halted_axis_holds_and_goes_straight_to_its_next_target() -> None:
    made, drives = two()
    motion = made.start(x=0.2)
    made.run(0.5)
    made.wait(made.group.halt(), 5.0)
    held = drives[0].position_actual
    with pytest.raises(MotionAborted, match="halted on request"):
        motion.result(timeout=0)
    made.run(0.5)
    assert drives[0].position_actual == held
    motion, seen = made.start(x=0.0), []
    while not motion.done():
        made.run(0.01)
        seen.append(drives[0].position_actual)
    assert max(seen) <= held + 1  # not on to 0.2 first
    assert drives[0].position_actual == 0


def test_a_refused_setpoint_is_told_with_the_joint() -> None:
    made, drives = two()
    drives[0]._limits[1].value = 1000  # somebody has narrowed its limits
    motion = made.start(x=0.1, z=0.2)
    made.run(4.0, motion.done)
    assert answer_of(motion).startswith("set-point not acknowledged (bit 12): x (node 1)")
    assert made.group.phase is Phase.FAULT
    made.run(1.0)
    assert 0 < drives[1].position_actual < 400_000  # all were stopped


def test_a_silent_drive_stops_the_others() -> None:
    made, drives = two()
    motion = made.start(x=0.2, z=0.25)
    made.run(0.3)
    drives[0].power_off()
    made.run(3.0, motion.done)
    assert "x (node 1) is silent" in answer_of(motion)
    made.run(1.0)
    assert 0 < drives[1].position_actual < 500_000
    with pytest.raises(DriveError):
        made.group.enable().result(timeout=0)


def test_quick_stop_and_back_to_work() -> None:
    made, drives = two()
    motion = made.start(x=0.2)
    made.run(0.5)
    made.wait(made.group.quick_stop(), 5.0)
    assert answer_of(motion) == "quick stop on request"
    made.wait(made.group.enable(), 5.0)
    made.move(x=0.0)
    assert drives[0].position_actual == 0


def test_a_drive_in_fault_is_reset() -> None:
    made, drives = two()
    motion = made.start(x=0.2)
    made.run(0.5)
    drives[0]._on_communication_error(0x8130)
    drives[0]._send_events()
    made.run(1.0, motion.done)
    assert "x (node 1): life guard or heartbeat error" in answer_of(motion)
    made.wait(made.group.reset_fault(), 5.0)
    made.wait(made.group.enable(), 5.0)
    made.move(x=0.0)
    assert drives[0].position_actual == 0


def test_the_wrong_drive_and_no_drive_are_said() -> None:
    axes = (copley_axis("x", 1), AxisConfig("y", 2))
    with pytest.raises(DriveError, match="is not a Copley drive: .* vendor 0x000000FB"):
        CompareBench(DriverConfig(axes=axes), (), [Epos2(1), Epos2(2)])
