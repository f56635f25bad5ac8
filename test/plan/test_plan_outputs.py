"""What `plan` says of position-triggered outputs: against the trajectory and the document."""

from __future__ import annotations

import csv
import math
import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from trajectories import EXAMPLES, example

from epos2_ros import plan
from epos2_ros.configuration.files import read_parameters
from epos2_ros.demo.commanded import Commanded, scales
from epos2_ros.demo.outputs import expected_of

OUTPUTS = EXAMPLES.parent / "config" / "outputs.yaml"
LOOP_S = 250e-6
BELT = {"type": "prismatic", "counts_per_turn": 2000, "gear_ratio": 100.0, "lead": 0.1}
PROFILE = {**BELT, "drive": "copley", "trajectory": "profile"}


def run(capsys: pytest.CaptureFixture[str], *arguments: Any) -> tuple[int, str, str]:
    status = plan.main([str(argument) for argument in arguments])
    return status, *capsys.readouterr()


def read_events(file: Path) -> list[dict[str, str]]:
    with file.open(newline="") as lines:
        return list(csv.DictReader(lines))


def test_every_crossing_of_the_raster_scan(tmp_path, capsys):
    """An output every millimetre: number, order, counts, and times to one loop of 250 µs."""
    file = tmp_path / "events.csv"
    scan = EXAMPLES / "raster_scan.yaml"
    status, out, err = run(capsys, scan, "--params", OUTPUTS, "--events", file)
    assert (status, err) == (0, "")
    (row,) = [line.split() for line in out.splitlines() if line.startswith("camera on gantry_x")]
    fires, first, last, low, high, slowest, fastest, closest = map(float, row[4:])
    assert (fires, low, high) == (1200, 0.0005, 0.1995)
    # 1 m/s² to 0.2 m/s: the first is after half a millimetre, the closest are at full speed.
    begun = math.sqrt(2 * 0.0005)
    hold = 0.001  # what the first record takes
    assert (first, last) == pytest.approx((hold + begun, hold + 8.7 - begun), abs=LOOP_S)
    assert (slowest, fastest) == pytest.approx((begun, 0.2), rel=1e-2)
    assert closest == pytest.approx(5.0, abs=0.25)
    parameters, trajectory = read_parameters(OUTPUTS), example("raster_scan")
    commanded, scale = Commanded(trajectory, zero_s=hold), scales(parameters)[0]
    expected = expected_of("camera", parameters, commanded, 0, scale)
    events = read_events(file)
    assert [(int(e["count"]), e["rising"] == "1") for e in events] == [e[1:] for e in expected]
    late_s = [float(e["time_s"]) - told.t_s for e, told in zip(events, expected, strict=True)]
    assert max(map(abs, late_s)) < LOOP_S
    assert [float(e["position"]) for e in events] == pytest.approx(
        [told.count_qc * 0.5e-6 for told in expected]
    )
    assert float(events[100]["velocity"]) == pytest.approx(0.2, rel=1e-2)
    assert "compare." not in out  # nothing to warn of


def parameters_of(tmp_path: Path, compare: dict[str, Any], **axis: Any) -> Path:
    section = {
        "joints": ["z"],
        "axes": {"z": {**PROFILE, "max_velocity": 0.2, **axis}},
        "outputs": ["laser"],
        "compare": {"laser": {"joint": "z", **compare}},
    }
    section["axes"]["z"].setdefault("max_acceleration", 1.0)
    file = tmp_path / "copley.yaml"
    file.write_text(yaml.safe_dump({"epos2_driver": {"ros__parameters": section}}))
    return file


def move(tmp_path: Path, target: float, seconds: int = 0) -> Path:
    file = tmp_path / "move.yaml"
    point = {"positions": [target], "time_from_start": {"sec": seconds}}
    file.write_text(yaml.safe_dump({"joint_names": ["z"], "points": [point]}))
    return file


def test_a_move_of_a_copley_axis(tmp_path, capsys):
    """0.2 m at 0.2 m/s and 1 m/s²: 20 mm of acceleration, 1.2 s in all."""
    params = parameters_of(tmp_path, {"kind": "crossing", "positions": [0.005, 0.1]})
    file = tmp_path / "events.csv"
    arguments = [move(tmp_path, 0.2), "--params", params, "--start", "0", "--events", file]
    status, out, err = run(capsys, *arguments)
    assert (status, err) == (0, "")
    assert "duration  1.200 s" in out
    low, high = read_events(file)
    edge = 0.005 - 0.25e-6  # the encoder says the nearest count: it changes half a count before
    assert float(low["time_s"]) == pytest.approx(math.sqrt(2 * edge), abs=1e-6)
    assert float(low["velocity"]) == pytest.approx(math.sqrt(2 * edge), rel=1e-4)
    assert float(high["time_s"]) == pytest.approx(0.1 + (0.1 - 0.25e-6) / 0.2, abs=1e-6)
    assert (low["count"], high["count"]) == ("10000", "200000")


def test_extrapolation_is_measured_and_warned_of(tmp_path, capsys):
    """½ · 200,000,000 counts/s² · (250 µs)² = 6.25 counts, with the document's remedies."""
    compare = {"kind": "interval", "start": 0.0, "interval": 2e-6, "pulse": 1e-6}
    params = parameters_of(
        tmp_path, {**compare, "extrapolated": True}, max_velocity=1.0, max_acceleration=100.0
    )
    status, out, _ = run(capsys, move(tmp_path, 0.05), "--params", params, "--start", "0")
    assert status == 0
    (row,) = [line.split() for line in out.splitlines() if line.startswith("laser on z")]
    assert float(row[-1]) == pytest.approx(6.25, abs=0.051)  # one digit behind the point
    notes = [line for line in out.splitlines() if line.startswith("compare.laser: ")]
    assert any(
        re.search(r"up to 6\.[23] counts.*more than the 4 counts between", note) for note in notes
    )
    assert any("may fire twice" in note for note in notes)
    remedies = "cross at constant velocity, let the output fire in one direction only, or use a"
    assert all(remedies in note for note in notes if "extrapolated" in note)


def test_pulses_that_overlap_and_windows_that_are_over_too_soon(tmp_path, capsys):
    compare = {"kind": "interval", "start": 0.0005, "interval": 0.001, "pulse": 0.008}
    params = parameters_of(tmp_path, compare)
    _, out, _ = run(capsys, move(tmp_path, 0.2), "--params", params, "--start", "0")
    assert "pulses overlap: a pulse lasts 8000 µs, and at " in out
    window = {"kind": "window", "method": "software", "window": [0.1, 0.10001]}
    params = parameters_of(tmp_path, window)
    _, out, _ = run(capsys, move(tmp_path, 0.2), "--params", params, "--start", "0")
    assert "1 passes through the window may be missed: the drive's loop lasts 250 µs" in out


@pytest.mark.parametrize(
    ("compare", "arguments", "line"),
    [
        ({"kind": "crossing", "positions": [0.1]}, [], "move.yaml is a move: --start has to say"),
        (
            {"kind": "crossing", "positions": [0.1]},
            ["--start", "0", "--csv", "records.csv"],
            "move.yaml is a move: it has no records to write or draw",
        ),
        (
            {"kind": "marker"},
            ["--start", "0"],
            "compare.laser.kind is marker; a Copley drive has window, crossing, series and interva",
        ),
        (
            {"kind": "window", "window": [0.2, 0.1]},
            ["--start", "0"],
            "compare.laser.window is [0.2, 0.1]; the lower end comes first",
        ),
    ],
)
def test_what_cannot_be_is_one_line(compare, arguments, line, tmp_path, capsys):
    params = parameters_of(tmp_path, compare)
    status, out, err = run(capsys, move(tmp_path, 0.2), "--params", params, *arguments)
    assert (status, out) == (1, "")
    assert line in err
    assert err.count("\n") == 1


def test_a_joint_that_is_moved_by_profiles_in_a_trajectory_is_refused(tmp_path, capsys):
    points = [
        {"positions": [0.0, 0.0, z], "time_from_start": {"sec": sec}}
        for sec, z in ((0, 0.0), (2, 0.1))
    ]
    file = tmp_path / "both.yaml"
    file.write_text(
        yaml.safe_dump({"joint_names": ["gantry_x", "gantry_y", "z"], "points": points})
    )
    status, _, err = run(capsys, file, "--params", OUTPUTS)
    assert status == 1
    assert err == (
        "epos2_ros plan: trajectory refused: joint 'z' can't follow a trajectory: its Copley drive "
        "moves in profile position mode, by ~/move_to (axes.z.trajectory)\n"
    )
