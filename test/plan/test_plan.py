"""The program `plan`: its figures against other ways to get them, its refusals, its files.

What was commanded comes from the demo's evaluation and what a drive makes of records from the
Hermite basis, so nothing of the driver's own motion layer is compared with itself.
"""

from __future__ import annotations

import csv
import io
import math
import os
import re
import struct
import subprocess
import sys
import tracemalloc
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
import yaml
from rclpy.context import Context
from rclpy.node import Node
from set_points import drive_executes
from shipped import PARAMETER_FILES
from simulated_time import Bench
from trajectories import EXAMPLES, NAMES, example, example_message

from epos2_ros import plan, surroundings
from epos2_ros.bus.transmitter import worst_case_bits
from epos2_ros.configuration.driver import AxisConfig
from epos2_ros.configuration.files import read_parameters
from epos2_ros.configuration.parameters import DriverParameters
from epos2_ros.demo.commanded import Commanded
from epos2_ros.errors import ConfigurationError, TrajectoryError
from epos2_ros.motion.record import Record
from epos2_ros.motion.reference import Reference
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.motion.units import AxisUnits
from epos2_ros.node.parameters import Parameters
from epos2_ros.plan import report
from epos2_ros.plan.axis import RecordsPlan, SetPointsPlan
from epos2_ros.plan.planning import make_plan
from epos2_ros.protocol.phase import Phase

CONFIG = EXAMPLES.parent / "config"
QC_PER_TURN = 2000 * 100  # of config/arm.yaml and config/gantry.yaml
QC_PER_UNIT = {"rad": QC_PER_TURN / (2 * math.pi), "m": QC_PER_TURN / 0.1}
RPM_QC_S = 2000 / 60  # the drive's velocity unit


@dataclass
class Ended:
    status: int
    out: str
    err: str

    def row(self, joint: str) -> list[str]:
        """The cells of an axis, from "records" on."""
        (line,) = [line for line in self.out.splitlines() if line.startswith(f"{joint} [")]
        return line.split("]")[1].replace(" … ", "…").split()

    def figure(self, name: str) -> str:
        found = re.search(rf"^{name} +(.+)$", self.out, re.MULTILINE)
        assert found, self.out
        return found[1]


Command = Callable[..., Ended]


@pytest.fixture
def command(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> Command:
    """`epos2_ros plan …` in this process, in a folder of its own."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments: Any, stdin: str = "") -> Ended:
        monkeypatch.setattr(sys, "stdin", io.StringIO(stdin))
        try:
            status = plan.main([str(argument) for argument in arguments])
        except SystemExit as end:  # argparse
            status = int(end.code or 0)
        captured = capsys.readouterr()
        return Ended(status, captured.out, captured.err)

    return run


def message(**changes: Any) -> str:
    """A trajectory of two joints as YAML: a turn of a quarter in 2 s."""
    points = [
        {"positions": [0.0, 1.0], "velocities": [0.0, 0.0], "time_from_start": {"sec": 0}},
        {"positions": [1.5, 1.0], "velocities": [0.0, 0.0], "time_from_start": {"sec": 2}},
    ]
    return yaml.safe_dump({"joint_names": ["a", "b"], "points": points, **changes})


def parameters(tmp_path: Path, **given: Any) -> Path:
    file = tmp_path / "parameters.yaml"
    section = {"joints": ["a", "b"], **given}
    file.write_text(yaml.safe_dump({"epos2_driver": {"ros__parameters": section}}))
    return file


# -- figures ---------------------------------------------------------------------------------


def read_csv(file: Path) -> dict[str, list[dict[str, str]]]:
    by_joint: dict[str, list[dict[str, str]]] = {}
    with file.open(newline="") as lines:
        for row in csv.DictReader(lines):
            by_joint.setdefault(row["joint"], []).append(row)
    return by_joint


def executed(rows: list[dict[str, str]]) -> np.ndarray:
    """Position at every millisecond [qc], by the cubic Hermite basis."""
    pieces = [np.array([float(rows[0]["position_qc"])])]
    for before, after in zip(rows, rows[1:], strict=False):
        if (duration := int(after["time_ms"])) == 0:
            break
        u = np.arange(1, duration + 1) / duration
        p0, p1 = (float(row["position_qc"]) for row in (before, after))
        m0, m1 = (float(r["velocity"]) * RPM_QC_S * duration / 1000 for r in (before, after))
        pieces.append(
            (2 * u**3 - 3 * u**2 + 1) * p0
            + (u**3 - 2 * u**2 + u) * m0
            + (3 * u**2 - 2 * u**3) * p1
            + (u**3 - u**2) * m1
        )
    return np.concatenate(pieces)


@pytest.mark.parametrize("name", NAMES)
def test_the_table_is_what_the_records_do(name, command, tmp_path):
    ended = command(EXAMPLES / f"{name}.yaml", "--csv", "records.csv")
    assert (ended.status, ended.err) == (0, "")
    trajectory = example(name)
    by_joint = read_csv(tmp_path / "records.csv")
    assert tuple(by_joint) == trajectory.joint_names
    end_ms = math.ceil(trajectory.duration_s * 1000 - 1e-6)
    path_ms = end_ms + 1  # the first record holds the position for a millisecond
    commanded = Commanded(trajectory, zero_s=0.001).at(np.arange(path_ms + 1) / 1000)
    unit = "m" if name == "raster_scan" else "rad"
    for column, (joint, rows) in enumerate(by_joint.items()):
        path = executed(rows)
        error = np.abs(path - commanded[:, column] * QC_PER_UNIT[unit]).max()
        assert error <= 1.0 + 1e-6
        count, per_s, shown, low, high, _, velocity, *_ = ended.row(joint)
        assert int(count) == len(rows) - 1
        assert float(per_s) == pytest.approx((len(rows) - 1) / trajectory.duration_s, abs=0.051)
        assert float(shown) == pytest.approx(error, abs=0.0051)
        ends = np.array([path.min(), path.max()]) / QC_PER_UNIT[unit]
        assert [float(low), float(high)] == pytest.approx(ends, abs=0.51e-5)
        # between the milliseconds the mean speed is a little below the largest
        fastest = np.abs(np.diff(path)).max() * 1000 / QC_PER_UNIT[unit]
        assert fastest - 1e-4 <= float(velocity) <= fastest + 0.01
    assert ended.figure("duration") == f"{path_ms / 1000:.3f} s"


def of_three_makers(tmp_path: Path) -> Path:
    """The arm, with a Copley drive at its second joint and a CL3-E at its last."""
    given = read_parameters(CONFIG / "arm.yaml")
    for joint, drive in (("shoulder_lift_joint", "copley"), ("wrist_3_joint", "cl3e")):
        given[f"axes.{joint}.drive"] = drive
    given["axes.wrist_3_joint.max_acceleration"] = 10.0
    file = tmp_path / "three.yaml"
    file.write_text(yaml.safe_dump({"/**": {"ros__parameters": given}}))
    return file


def test_set_points_beside_records(command, tmp_path):
    """What the drive makes of them is as far from the trajectory as the table says."""
    params = of_three_makers(tmp_path)
    ended = command(
        *(EXAMPLES / "jerk_limited.yaml", "--params", params),
        *("--csv", "sent.csv", "--output", "drawing.svg"),
    )
    assert (ended.status, ended.err) == (0, "")
    trajectory, rows = example("jerk_limited"), read_csv(tmp_path / "sent.csv")["wrist_3_joint"][1:]
    config = DriverParameters(read_parameters(params)).config()
    planned = make_plan(trajectory, config, trajectory.positions[0].tolist())
    axis = planned.axes[5]
    assert isinstance(axis, SetPointsPlan)
    end_ms = round(1000 * planned.duration_s)
    path = drive_executes(axis.start_qc, axis.points, axis.limits, lambda: 30, end_ms).position_qc
    commanded = Commanded(trajectory, zero_s=0.001).at(np.arange(end_ms + 1) / 1000)[:, 5]
    count, per_s, error, low, high, *_ = ended.row("wrist_3_joint")
    assert count == f"°{len(axis.points)}" == f"°{len(rows)}"
    assert float(per_s) == pytest.approx(len(rows) / planned.duration_s, abs=0.051)
    error_qc = np.abs(path - commanded * QC_PER_UNIT["rad"]).max()
    assert float(error) == pytest.approx(error_qc, abs=0.051)
    assert [float(low), float(high)] == pytest.approx(
        np.array([path.min(), path.max()]) / QC_PER_UNIT["rad"], abs=1e-5
    )
    assert "° set-points of profile position mode" in ended.out
    for row, point in zip(rows, axis.points, strict=True):
        target, ramps = (bytes.fromhex(frame.split("#")[1]) for frame in row["frame"].split())
        assert struct.unpack("<iI", target) == (point.target_qc, point.velocity)
        assert struct.unpack("<II", ramps) == (point.acceleration, point.deceleration)
    others = [joint for joint in trajectory.joint_names if joint != "wrist_3_joint"]
    assert all(float(ended.row(joint)[2]) <= 1.0 for joint in others)


def test_records_of_both_makers(command, tmp_path):
    """Of a Copley axis the frames say where each segment starts: decoded, they keep the path."""
    arguments = ("--params", of_three_makers(tmp_path), "--csv", "records.csv")
    ended = command(EXAMPLES / "pick_place.yaml", *arguments)
    assert (ended.status, ended.err) == (0, "")
    trajectory = example("pick_place")
    by_joint = read_csv(tmp_path / "records.csv")
    assert tuple(by_joint) == trajectory.joint_names
    rows, column = by_joint["shoulder_lift_joint"], 1
    frames = [row["frame"].split("#") for row in rows[1:]]
    assert {can_id for can_id, _ in frames} == {"202"}
    data = [bytes.fromhex(text) for _, text in frames]
    assert [one[0] for one in data] == [n % 8 for n in range(1, len(data) + 1)]  # 0.1 counts/s
    starts = [int.from_bytes(one[2:5], "little", signed=True) for one in data]
    speeds = [int.from_bytes(one[5:8], "little", signed=True) * 0.1 for one in data]
    pieces = [np.array([starts[0]])]
    for n in range(len(data) - 1):
        h = data[n][1] / 1000
        u = np.arange(1, data[n][1] + 1) / data[n][1]
        pieces.append(
            (2 * u**3 - 3 * u**2 + 1) * starts[n]
            + (u**3 - 2 * u**2 + u) * h * speeds[n]
            + (3 * u**2 - 2 * u**3) * starts[n + 1]
            + (u**3 - u**2) * h * speeds[n + 1]
        )
    path = np.concatenate(pieces)
    commanded = Commanded(trajectory, zero_s=0.001).at(np.arange(len(path)) / 1000)
    assert len(path) == math.ceil(trajectory.duration_s * 1000 - 1e-6) + 2
    assert np.abs(path - commanded[:, column] * QC_PER_UNIT["rad"]).max() <= 1.0 + 1e-6
    assert data[-1][1] == 0


def test_largest_velocity_and_acceleration_are_those_of_the_polynomial(command, tmp_path):
    """One cubic over 200 ms and exactly on the grid: it needs no rounding to be followed."""
    params = parameters(
        tmp_path,
        axes={"a": {"counts_per_turn": 60_000, "gear_ratio": 2 * math.pi}},
        ipm={"buffer_time": 1.0},
    )
    points = [  # 60,000 qc per rad, 1,000 qc/s per rpm
        {"positions": [0.0, 0.0], "velocities": [0.0, 0.0], "time_from_start": {}},
        {
            "positions": [0.2, 0.0],
            "velocities": [0.0, 0.0],
            "time_from_start": {"nanosec": 600_000_000},
        },
    ]
    ended = command("-", "--params", params, stdin=message(points=points))
    velocity, _, acceleration, _ = ended.row("a")[-4:]
    assert float(velocity) == pytest.approx(1.5 * 0.2 / 0.6, rel=2e-3)
    assert float(acceleration) == pytest.approx(6 * 0.2 / 0.6**2, rel=0.05)


def test_frames_in_the_csv_are_those_of_the_drive(command, tmp_path):
    command(EXAMPLES / "raster_scan.yaml", "--csv", "records.csv")
    for rows in read_csv(tmp_path / "records.csv").values():
        path_ms = 0
        for number, row in enumerate(rows):
            path_ms += int(row["time_ms"])
            assert (int(row["record"]), int(row["path_ms"])) == (number, path_ms)
        assert rows[0]["frame"] == ""
        for row in rows[1:]:  # position int32, velocity int24, time uint8, little-endian
            can_id, data = row["frame"].split("#")
            payload = bytes.fromhex(data)
            assert can_id == {"gantry_x": "201", "gantry_y": "202"}[row["joint"]]
            assert int.from_bytes(payload[:4], "little", signed=True) == int(row["position_qc"])
            assert int.from_bytes(payload[4:7], "little", signed=True) == int(row["velocity"])
            assert payload[7] == int(row["time_ms"])
        assert rows[-1]["time_ms"] == "0"


def test_plan_and_driver_agree(monkeypatch):
    """The real group on simulated drives: same records, and load and latency as foretold."""
    monkeypatch.setattr("time.perf_counter", lambda: 0.0)  # simulated time stands while computing
    config = DriverParameters(read_parameters(CONFIG / "gantry.yaml")).config()
    trajectory = example("raster_scan")
    planned = make_plan(trajectory, config, [0.0, 0.0])

    bench = Bench(config)
    bench.enable()
    bench.run(6.37)  # the clocks are known by then
    bench.frames.clear()
    sent_us = bench.now_us
    bench.path.submit(trajectory, None, sent_us)
    bench.run(30.0, lambda: bench.group.phase is Phase.STANDING)
    frames = [(t_us, frame) for t_us, frame, _ in bench.frames]

    for axis in planned.axes:
        data = [f.data for _, f in frames if f.can_id == 0x200 + axis.config.node_id]
        assert data == [record.pack() for record in axis.records]
    armed_us = max(t_us for t_us, frame in frames if frame.can_id & 0x780 == 0x300)
    start_us = min(t_us for t_us, frame in frames if frame.can_id == 0x80 and t_us > armed_us)
    assert planned.latency.total_ms == pytest.approx((start_us - sent_us) / 1000, rel=0.25)

    end_us = start_us + planned.duration_s * 1e6
    t_us = np.array([t for t, _ in frames if t <= end_us])
    bits = np.array([worst_case_bits(len(f.data)) for t, f in frames if t <= end_us])
    mean = bits.sum() / config.bitrate / planned.duration_s
    until = np.concatenate(([0], np.cumsum(bits)))
    seconds = until[np.searchsorted(t_us, t_us + 1e6)] - until[:-1]
    # It counts what the drives may report at most; those of axes that rest report nothing.
    assert mean <= planned.load.sent + planned.load.others <= 1.5 * mean
    assert seconds.max() <= planned.load.busiest * config.bitrate <= 1.4 * seconds.max()


# -- where it begins, and whose parameters ---------------------------------------------------


def test_a_goal_alone_is_reached_from_where_the_joints_stand(command):
    goal = [{"positions": [1.0, -2.0], "time_from_start": {"sec": 2}}]
    ended = command("-", "--start", "0.5", "-2", stdin=message(points=goal))
    assert ended.status == 0, ended.err
    assert "where --start says" in ended.out
    tolerance = 1.5 * 2 * math.pi / 2000  # and half a count where it stands
    low, high = map(float, ended.row("a")[3:5])
    assert (low, high) == pytest.approx((0.5, 1.0), abs=tolerance)
    low, high = map(float, ended.row("b")[3:5])
    assert (low, high) == pytest.approx((-2.0, -2.0), abs=tolerance)


def test_parameters_are_those_shipped_for_the_joints(command):
    assert str(CONFIG / "arm.yaml") in command(EXAMPLES / "positions_only.yaml").out
    assert str(CONFIG / "gantry.yaml") in command(EXAMPLES / "raster_scan.yaml").out


def test_unknown_joints_have_the_drivers_defaults(command):
    ended = command("-", "--csv", "records.csv", stdin=message())
    assert "defaults, 2000 counts per turn and gear ratio 1" in ended.out
    rows = read_csv(Path("records.csv"))
    assert int(rows["a"][-1]["position_qc"]) == round(1.5 * 2000 / (2 * math.pi))
    assert float(ended.row("a")[6]) <= float(ended.row("a")[7])


def test_limits_stand_beside_what_is_reached(command, tmp_path):
    limits = {"min_position": -0.5, "max_position": 2.5, "max_acceleration": 9.0}
    params = parameters(
        tmp_path,
        axes={"a": {**limits, "max_velocity": 3.0}, "b": {"max_position": 1.25}},
        ipm={"tolerance": 3, "buffer_time": 0.25},
    )
    ended = command("-", "--params", params, stdin=message())
    assert f"{params}; tolerance 3 qc, buffer time 0.25 s" in ended.out
    a = " ".join(ended.row("a"))
    assert " -0.5…2.5 " in a
    assert re.search(r" 3 \*?[\d.]+ 9$", a)
    assert "−∞…1.25" in ended.row("b")


def test_what_is_beyond_a_limit_is_marked():
    """The driver holds the commanded curve to it, but records are rounded."""
    config = DriverParameters(read_parameters(CONFIG / "gantry.yaml")).config()
    planned = make_plan(example("raster_scan"), config, [0.0, 0.0])
    assert "*" not in report.text(planned)
    limits = replace(planned.limits, velocity=np.array([0.19, 0.19]))  # x has 0.2, y 0.05
    shown = report.text(replace(planned, limits=limits))
    assert re.search(r"^gantry_x .* \*0\.20\d\d +0\.19 ", shown, re.MULTILINE)
    assert re.search(r"^gantry_y .* 0\.05\d\d +0\.19 ", shown, re.MULTILINE)
    assert "\n* beyond the limit" in shown


def test_joints_left_out_hold(command, tmp_path):
    limits = {"min_position": 0.25, "max_position": 1.0}
    params = parameters(
        tmp_path, joints=["c", "a", "b"], axes={"c": limits}, allow_partial_joints_goal=True
    )
    ended = command("-", "--params", params, stdin=message())
    assert ended.status == 0, ended.err
    low, high = ended.row("c")[3:5]
    assert low == high


def test_a_stamp_does_not_count(command):
    ended = command("-", stdin=message(header={"stamp": {"sec": 1_600_000_000, "nanosec": 0}}))
    assert ended.status == 0
    assert "header.stamp does not count" in ended.out


# -- refusals --------------------------------------------------------------------------------

UNSOUND: dict[str, Callable[[dict[str, Any]], None]] = {
    "unknown joint": lambda m: m.update(joint_names=["shoulder_pan", *m["joint_names"][1:]]),
    "missing joint": lambda m: (
        m["joint_names"].pop(),
        [values.pop() for p in m["points"] for values in p.values() if isinstance(values, list)],
    ),
    "twice the same joint": lambda m: m["joint_names"].__setitem__(1, m["joint_names"][0]),
    "too few values": lambda m: m["points"][1]["positions"].pop(),
    "not a number": lambda m: m["points"][2]["velocities"].__setitem__(0, math.nan),
    "time stands": lambda m: m["points"][3].update(m["points"][2]),
    "still moving": lambda m: m["points"][-1]["velocities"].__setitem__(1, 0.2),
    "beyond a limit": lambda m: m["points"][5]["positions"].__setitem__(0, 3.0),
    "too fast": lambda m: m["points"][5]["velocities"].__setitem__(0, 900.0),
    "no end": lambda m: m["points"][-1]["velocities"].__setitem__(0, 0.1),
}


@pytest.mark.parametrize("change", UNSOUND.values(), ids=UNSOUND)
def test_it_refuses_with_the_drivers_words(change, command, tmp_path):
    spoilt = example_message("pick_place")
    change(spoilt)
    given = read_parameters(CONFIG / "arm.yaml") | {"axes.shoulder_pan_joint.max_position": 2.0}
    params = tmp_path / "limited.yaml"
    params.write_text(yaml.safe_dump({"epos2_driver": {"ros__parameters": given}}))
    bench = Bench(DriverParameters(given).config())
    bench.enable()
    with pytest.raises(TrajectoryError) as refusal:
        bench.path.submit(Trajectory.from_dict(spoilt), None, bench.now_us)
    (tmp_path / "spoilt.yaml").write_text(yaml.safe_dump(spoilt))
    ended = command("spoilt.yaml", "--params", params)
    assert ended == Ended(1, "", f"epos2_ros plan: trajectory refused: {refusal.value}\n")


def test_what_has_to_be_compiled_is_said_when_it_is(command, monkeypatch):
    """Not when the trajectory is refused; of several ones, only with the first that is not."""
    said = iter(["compiling"])
    monkeypatch.setattr(surroundings, "compiling", lambda: (False, next(said, "")))
    for refused in ("{", message(joint_names=["a", "a"]), message(points=[])):
        assert "compiling" not in command("-", stdin=refused).err
    assert "compiling" not in command("-", "--start", "0.2", "1.0", stdin=message()).err
    ended = command("-", stdin="---\n".join([message()] * 2))
    assert (ended.status, ended.err) == (0, "epos2_ros plan: compiling\n")


def test_a_message_of_moveit_servo_is_followed_to_its_last_point(command):
    """Its last point moves; without another message the axes come to rest there."""
    window = [
        {
            "positions": [0.3 * t, 0.0],
            "velocities": [0.3, 0.0],
            "time_from_start": {"nanosec": round(1e9 * t)},
        }
        for t in (0.0, 0.034, 0.068, 0.102, 0.136, 0.17)
    ]
    planned = command("-", stdin=message(points=window))
    assert (planned.status, planned.err) == (0, "")
    assert float(planned.row("a")[4]) == pytest.approx(0.3 * 0.17, abs=0.004)


def test_it_refuses_to_begin_far_from_where_the_joints_stand(command):
    ended = command("-", "--start", "0.2", "1.0", stdin=message())
    assert ended.status == 1
    assert "joint 'a', point 0" in ended.err
    assert "constraints.start_tolerance" in ended.err


@pytest.mark.parametrize(
    "given",
    [
        {"axes": {"a": {"gear_ratio": -1.0}}},
        {"axes": {"a": {"type": "prismatic"}}},
        {"axes": {"a": {"node_id": 2}}},
        {"axes": {"a": {"gear": 3.0}}},
        {"ipm": {"tolerence": 2.0}},
        {"joints": ["a", "a"]},
        {"sync": {"source": "c"}},
    ],
    ids=str,
)
def test_it_refuses_parameters_with_the_nodes_words(given, command, tmp_path, node):
    params = parameters(tmp_path, **given)
    with pytest.raises(ConfigurationError) as refusal:
        Parameters(node(params), lambda: True).config()
    ended = command("-", "--params", params, stdin=message())
    assert ended == Ended(1, "", f"epos2_ros plan: {refusal.value}\n")


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"max_velocity": 1e6}, "axes.a.max_velocity: 1e+06 rad/s is more than"),
        ({"stop_deceleration": 1e9, "gear_ratio": 1e6}, "axes.a.stop_deceleration: 1e+09"),
        ({"max_position": 1e6, "gear_ratio": 1e6}, "axes.a.max_position: 1e+06 rad is outside"),
    ],
)
def test_it_refuses_what_no_drive_can_be_set_to(given, says, command, tmp_path):
    ended = command("-", "--params", parameters(tmp_path, axes={"a": given}), stdin=message())
    assert (ended.status, ended.out) == (1, "")
    assert ended.err.startswith(f"epos2_ros plan: {says}")
    assert ended.err.count("\n") == 1


# -- files -----------------------------------------------------------------------------------


@pytest.fixture
def node() -> Iterator[Callable[[Path], Node]]:
    """Starts a node that reads a parameter file as ROS does."""
    context = Context()
    rclpy.init(args=[], context=context)
    nodes: list[Node] = []

    def start(file: Path) -> Node:
        cli = ["--ros-args", "--params-file", str(file)]
        nodes.append(Node("epos2_driver", context=context, cli_args=cli))
        return nodes[-1]

    yield start
    for it in nodes:
        it.destroy_node()
    context.shutdown()


@pytest.mark.parametrize(
    "text",
    [
        *(file.read_text() for file in PARAMETER_FILES),
        "/**: {ros__parameters: {joints: [a], axes: {a: {gear_ratio: 5.0}}}}",
        "/**/epos2_driver: {ros__parameters: {joints: [a], axes.a.gear_ratio: 1e1}}",
        "'*': {ros__parameters: {joints: [a]}}\n/*: {ros__parameters: {ipm.tolerance: 2.5e+0}}",
        "epos2_driver: {ros__parameters: {ipm: {tolerance: 2}}}\n"
        "/**: {ros__parameters: {ipm: {tolerance: 3}, axes: {joint_1: {max_velocity: inf}}}}\n"
        "other: {ros__parameters: {ipm: {tolerance: 4}}}",
        "/**: {ros__parameters: {ipm: {tolerance: 3}}}\n"
        "/epos2_driver: {ros__parameters: {ipm.tolerance: 2, allow_partial_joints_goal: yes}}",
    ],
)
def test_parameter_files_are_read_as_ros_reads_them(text, tmp_path, node):
    file = tmp_path / "file.yaml"
    file.write_text(text)
    as_declared = Parameters(node(file), lambda: True).config()
    assert DriverParameters(read_parameters(file)).config() == as_declared


def test_echoed_trajectories_come_one_by_one():
    """Each is planned when the `---` after it is there, not at the end of the pipe."""
    with subprocess.Popen(
        [sys.executable, "-m", "epos2_ros", "plan", "-"],
        cwd=EXAMPLES.parent,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdin and process.stdout
        for _ in range(2):
            process.stdin.write(f"{message()}---\n")
            process.stdin.flush()
            assert any(line.startswith("first motion") for line in process.stdout)
        process.stdin.close()
        assert process.wait() == 0


def test_a_message_that_echo_has_cut_short_is_told(command):
    cut = yaml.safe_load(message())
    cut["points"].append("...")
    ended = command("-", stdin=yaml.safe_dump(cut))
    assert ended.status == 1
    assert "--full-length" in ended.err


def test_numbers_as_people_write_them(command):
    text = "{joint_names: [a], points: [{positions: [1e-3], time_from_start: {nanosec: 5e8}}]}"
    assert command("-", stdin=text).status == 0


@pytest.mark.parametrize(
    ("stdin", "says"),
    [
        ("", "standard input is empty"),
        ("a: [", "can't read standard input: "),
        ("- 1\n", "not a JointTrajectory"),
        ("points: 3", "not a JointTrajectory: points is 3; it must be a list of points"),
        ("joints: [a]", "not a JointTrajectory: it has 'joints'; a trajectory has header, joint"),
        (message(points=[]), "standard input has no points"),
    ],
)
def test_what_is_no_trajectory_is_one_line(stdin, says, command):
    ended = command("-", stdin=stdin)
    assert (ended.status, ended.out) == (1, "")
    assert says in ended.err
    assert ended.err.count("\n") == 1


@pytest.mark.parametrize(
    "arguments",
    [
        ["nowhere.yaml"],
        ["-", "--params", "nowhere.yaml"],
        ["-", "--csv", "nowhere/records.csv"],
        ["-", "--output", "nowhere/plot.png"],
        ["-", "--output", "nowhere/plot.html"],
    ],
)
def test_files_that_are_not_there_are_one_line(arguments, command):
    ended = command(*arguments, stdin=message())
    assert ended.status == 1
    assert re.fullmatch(r"epos2_ros plan: .*nowhere.*: No such file or directory\n", ended.err)


def test_a_parameter_file_of_another_node_is_refused(command, tmp_path):
    file = tmp_path / "other.yaml"
    file.write_text("other: {ros__parameters: {joints: [a, b]}}")
    ended = command("-", "--params", file, stdin=message())
    assert (ended.status, ended.err) == (
        1,
        f"epos2_ros plan: nothing in {file} is for /epos2_driver: it has parameters of /other; "
        "name the node there, or write /** for any node\n",
    )


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["-", "--output", "plot.pdf"],
        ["-", "--start", "nan", "0"],
        ["-", "--start", "zero"],
        ["-", "--speed", "2"],
    ],
)
def test_wrong_usage_is_status_2(arguments, command):
    ended = command(*arguments, stdin=message())
    assert (ended.status, ended.out) == (2, "")
    assert ended.err.startswith("usage: epos2_ros plan")


@pytest.mark.parametrize("start", ["nan", "inf", "zero"])
def test_a_start_that_is_no_number_is_told_as_such(start, command):
    ended = command("-", "--start", "0.5", start, stdin=message())
    assert ended.err.splitlines()[-1] == (
        f"epos2_ros plan: error: argument --start: '{start}': must be a number"
    )


def test_the_start_has_a_position_for_each_joint(command):
    ended = command("-", "--start", "0.5", stdin=message())
    assert (ended.status, ended.err) == (
        1,
        "epos2_ros plan: --start has 1 positions for 2 joints\n",
    )


def test_one_drawing_is_of_one_trajectory(command):
    ended = command("-", "--csv", "records.csv", stdin=f"{message()}---\n{message()}")
    assert ended.status == 1
    assert "--output, --csv and --events take one trajectory" in ended.err
    assert command("-", "--csv", "records.csv", stdin=f"{message()}---\n").status == 0


def test_ros_arguments_mean_nothing(command):
    ros = ["--ros-args", "-r", "__node:=plan", "-p", "use_sim_time:=true"]
    assert command(*ros, "--", "-", stdin=message()).status == 0
    assert command("-", *ros, stdin=message()).status == 0


def test_neither_ros_nor_matplotlib_is_needed_for_the_table(tmp_path):
    program = (
        "import sys; sys.modules.update(rclpy=None, matplotlib=None);"
        "from epos2_ros.__main__ import main; sys.exit(main(sys.argv[1:]))"
    )
    ended = subprocess.run(
        [sys.executable, "-c", program, "plan", EXAMPLES / "raster_scan.yaml"],
        cwd=EXAMPLES.parent,
        capture_output=True,
        text=True,
    )
    assert (ended.returncode, ended.stderr) == (0, "")
    assert "gantry_y [m]" in ended.stdout


def test_drawings(command, tmp_path):
    for name in ("plot.png", "plot.svg"):
        ended = command("-", "--output", name, stdin=message())
        assert (ended.status, ended.err) == (0, "")
    assert (tmp_path / "plot.png").read_bytes().startswith(b"\x89PNG\r\n")
    assert ElementTree.parse(tmp_path / "plot.svg").getroot().tag.endswith("}svg")


class Page(HTMLParser):
    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.cells: list[str] = []
        self.links: list[str] = []
        self.title = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.links += [
            str(value)
            for name, value in attrs
            if name in ("src", "href", "xlink:href") and not str(value).startswith("#")
        ]

    def handle_data(self, data: str) -> None:
        if self.tags and self.tags[-1] == "td":
            self.cells.append(data.strip())
        if self.tags and self.tags[-1] == "title":
            self.title += data.strip()


@pytest.mark.parametrize("name", ["raster_scan", "pick_place"])
def test_the_plan_is_the_same_however_it_is_cut_into_pieces(name, command, monkeypatch):
    outputs = ("--params", CONFIG / "outputs.yaml") if name == "raster_scan" else ()

    def table() -> str:
        out = command(EXAMPLES / f"{name}.yaml", *outputs).out
        return out[: out.index("first motion")]  # which is measured

    whole = table()
    monkeypatch.setattr("epos2_ros.plan.axis.PIECE_MS", 700)
    assert table() == whole


def test_memory_does_not_grow_with_the_length_of_the_motion():
    """An hour at rest is 3,600,000 milliseconds, of which every curve would have 29 MB."""
    axis = AxisConfig("a", 1)
    records = (*[Record(0, 0, 250)] * 14_400, Record(0, 0, 0))
    units = AxisUnits.of(axis)
    reference = Reference.at_rest([units], [0.0])
    long = RecordsPlan(axis, units, 0, reference, 0, units.velocity_unit_qc_s, records)
    tracemalloc.start()
    try:
        assert long.extremes == (0.0, 0.0, 0.0)
        assert tracemalloc.get_traced_memory()[1] < 25e6
    finally:
        tracemalloc.stop()


def test_whoever_has_seen_enough_can_close_the_pipe(tmp_path):
    """`plan … | head` ends in silence."""
    command = [sys.executable, "-m", "epos2_ros", "plan", str(EXAMPLES / "pick_place.yaml")]
    read, write = os.pipe()
    process = subprocess.Popen(command, stdout=write, stderr=subprocess.PIPE, text=True)
    os.close(write)
    os.close(read)
    assert process.communicate(timeout=60)[1] == ""
    assert process.returncode == 0


def test_it_shows_how_a_first_point_at_a_later_time_is_joined(command):
    """A first point at time 0 is where the robot is; one later is gone to from where it is."""
    one = [{"positions": [0.5, 0.0], "time_from_start": {"sec": 2}}]
    there = command("-", stdin=message(points=one))
    assert "point 0 is, there until 2.000 s (joined from elsewhere with --start)" in there.out
    joined = command("-", "--start", "0", "0", stdin=message(points=one))
    assert "--start says, joined smoothly to point 0 at 2.000 s" in joined.out
    low, high = map(float, joined.row("a")[3:5])
    assert (low, high) == pytest.approx((0.0, 0.5), abs=0.002)
    at_once = command("-", "--start", "0.1", "1", stdin=message())
    assert (at_once.status, "joined" in at_once.out) == (1, False)
    assert "rad away from where it is, allowed 0.01" in at_once.err


def test_the_page_needs_nothing_else(command, tmp_path):
    (tmp_path / "<a&b>.yaml").write_text(message())
    ended = command("<a&b>.yaml", "--output", "plot.html")
    assert (ended.status, ended.err) == (0, "")
    page = Page((tmp_path / "plot.html").read_text())
    assert page.tags.count("svg") == 1
    assert not {"script", "link", "img", "iframe"} & set(page.tags)
    assert page.links == []
    assert page.title == "<a&b>.yaml"
    assert "a [rad]" in page.cells
    assert all(cell in page.cells for cell in ended.row("b"))
