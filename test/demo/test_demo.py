"""The demo: what it measures, what it lets pass, and the whole thing from the command line."""

from __future__ import annotations

import io
import os
import re
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from planners import from_ruckig, from_toppra, planned_axes

from epos2_ros.configuration.driver import DriverConfig
from epos2_ros.configuration.files import read_parameters
from epos2_ros.demo.commanded import HOLD_S, Commanded, Scale, scales
from epos2_ros.demo.outputs import Crossing, OutputResult, expected_of
from epos2_ros.demo.report import Observed, Report
from epos2_ros.demo.terminal import Terminal, bar
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.plan.planning import make_plan

CYCLES = 2000
TURN_QC = 200_000  # 2000 counts and gear 100


def trajectory(times: list[float], positions: Any, **fields: Any) -> Trajectory:
    arrays = {name: np.array(values, dtype=float) for name, values in fields.items()}
    return Trajectory(
        tuple(f"j{n}" for n in range(np.shape(positions)[1])),
        np.array(times, dtype=float),
        np.array(positions, dtype=float),
        **arrays,
    )


# -- what was commanded ----------------------------------------------------------------------


@pytest.mark.parametrize("degree", [3, 5])
def test_a_polynomial_through_its_own_points_is_itself(degree):
    """Any cubic is its own cubic Hermite interpolant, any quintic its own quintic one."""
    coefficients = np.random.default_rng(degree).normal(size=(2, degree + 1))
    curves = [np.polynomial.Polynomial(c) for c in coefficients]
    knots = np.array([0.0, 0.7, 1.0, 2.5])

    def at(t: Any, order: int = 0) -> Any:
        return np.array([c.deriv(order)(t) if order else c(t) for c in curves]).T

    fields = {"velocities": at(knots, 1)}
    if degree == 5:
        fields["accelerations"] = at(knots, 2)
    fields["velocities"][-1] = 0.0  # as every trajectory ends; so look before the last piece
    t = np.linspace(0.0, 0.999, 50)
    assert Commanded(trajectory(list(knots), at(knots), **fields)).at(t) == pytest.approx(at(t))


def test_positions_alone_do_not_overshoot_and_rest_at_both_ends():
    points = np.array([[0.0], [1.0], [1.0], [3.0], [2.0]])
    curve = Commanded(trajectory([0.0, 1.0, 2.0, 2.5, 4.0], points))
    t = np.linspace(0.0, 4.0, 4001)
    p = curve.at(t)[:, 0]
    assert p.max() == pytest.approx(3.0, abs=1e-6)
    assert p.min() >= 0.0
    flat = p[(t >= 1.0) & (t <= 2.0)]
    assert flat == pytest.approx(np.ones_like(flat))
    assert abs(p[1] - p[0]) < 1e-5
    assert abs(p[-1] - p[-2]) < 1e-5


def test_before_and_after_the_curve_rests():
    curve = Commanded(trajectory([0.0, 1.0], [[1.0], [2.0]]))
    assert curve.at(np.array([-1.0, 0.0, 9.0, np.inf]))[:, 0] == pytest.approx([1, 1, 2, 2])


def test_on_the_way_to_a_later_first_point_it_leaves_from_rest():
    """v = 0 … 1 in 1 s and back to the same place: the cubic t³ − t², lowest at 2/3."""
    curve = Commanded(trajectory([1.0, 2.0], [[0.0], [0.5]], velocities=[[1.0], [0.0]]))
    assert curve.at(np.array([0.0, 2 / 3, 1.0]))[:, 0] == pytest.approx([0.0, -4 / 27, 0.0])


def test_scales_come_from_the_parameter_file(tmp_path):
    file = tmp_path / "p.yaml"
    axes = {
        "x": {"type": "prismatic", "lead": 0.01, "gear_ratio": 5.0, "direction": -1, "node_id": 9},
        "a": {"counts_per_turn": 4000, "offset": 0.5},
    }
    parameters = {"joints": ["x", "a"], "axes": axes, "ipm.tolerance": 2.0}
    file.write_text(yaml.safe_dump({"epos2_driver": {"ros__parameters": parameters}}))
    read = read_parameters(file)
    assert read["ipm.tolerance"] == 2.0
    x, a = scales(read)
    assert (x.joint, x.node_id, x.unit) == ("x", 9, "m")
    assert x.to_qc(np.array([0.01])) == pytest.approx([-5 * 2000])
    assert (a.joint, a.node_id, a.unit) == ("a", 2, "rad")
    assert a.to_qc(np.array([0.5 + 2 * np.pi])) == pytest.approx([4000])


# -- what it lets pass -----------------------------------------------------------------------


class Run:
    """A perfect run of two axes, one turn in two seconds, to be spoilt."""

    def __init__(self, folder: Path) -> None:
        self.log = folder / "log.npz"
        self.scales = [
            Scale(f"j{n}", n + 1, "epos2", "rad", TURN_QC / (2 * np.pi), 0.0) for n in (0, 1)
        ]
        self.trajectory = trajectory(
            [0.0, 2.0], [[0, 0], [2 * np.pi, 2 * np.pi]], velocities=[[0, 0], [0, 0]]
        )
        path_ms = np.arange(1, CYCLES + 1)
        u = path_ms / CYCLES
        level = np.minimum(20, (CYCLES - path_ms) // 50)
        level[100] += 1  # the last record comes in
        self.columns: dict[str, Any] = {}
        for node in (1, 2):
            self.columns[f"node_{node}_time_us"] = 7e6 + path_ms * 1000.0
            self.columns[f"node_{node}_path_ms"] = path_ms
            self.columns[f"node_{node}_demand_qc"] = TURN_QC * (3 * u**2 - 2 * u**3)
            self.columns[f"node_{node}_buffer_level"] = level.copy()
        self.positions = {"j0": 2 * np.pi, "j1": 2 * np.pi}
        self.buffer_errors: dict[str, str] = {}

    def report(self) -> Report:
        np.savez(self.log, **self.columns)
        observed = Observed({"j0": 55, "j1": 56}, self.positions, self.buffer_errors, 30, 9.5)
        return Report.of(
            Commanded(self.trajectory),
            self.trajectory.joint_names,
            self.scales,
            self.log,
            observed,
            bitrate=1_000_000,
            tolerance_qc=1.0,
        )


@pytest.fixture
def ran(tmp_path: Path) -> Run:
    return Run(tmp_path)


def test_a_perfect_run_passes(ran, tmp_path):
    report = ran.report()
    assert report.failures() == []
    assert report.spread_us == pytest.approx(0.0)
    out = io.StringIO()
    report.print(Terminal(out))
    assert re.search(r"^j0 +55 +0\.00 +20 … 21 +-?0\.00$", out.getvalue(), re.M)
    assert re.search(r"^j1 +56 ", out.getvalue(), re.M)
    assert "30 SYNC, bus load 9.5 % at 1 Mbit/s" in out.getvalue()
    report.plot(tmp_path / "plot.png", "a turn")
    assert (tmp_path / "plot.png").read_bytes().startswith(b"\x89PNG")


def test_one_millisecond_off_the_path_fails(ran):
    ran.columns["node_2_demand_qc"][777] += 1.2
    (failure,) = ran.report().failures()
    assert failure.startswith("j1: path error 1.20 qc")


def test_an_axis_that_starts_late_fails(ran):
    ran.columns["node_1_time_us"] += 1.5
    report = ran.report()
    assert report.spread_us == pytest.approx(1.5)
    assert [f.split()[:2] for f in report.failures()] == [["start", "times"]]


def test_an_axis_that_does_not_arrive_fails(ran):
    ran.positions["j0"] += 0.6 / (TURN_QC / (2 * np.pi))
    assert [f.split(" qc")[0] for f in ran.report().failures()] == ["j0: final error 0.60"]


@settings(deadline=None, max_examples=25)
@given(
    count=st.integers(-(2**31) + 2, 2**31 - 2),
    scale=st.sampled_from([1.0, -100.0, 160.3]).map(lambda gear: gear * TURN_QC / (2 * np.pi)),
    offset=st.floats(-100.0, 100.0),
    side=st.sampled_from([-0.5, 0.5]),
    beyond=st.sampled_from([0.0, 0.01]),
)
def test_at_rest_on_a_count_next_to_a_fractional_end_is_no_error(
    count: int, scale: float, offset: float, side: float, beyond: float
) -> None:
    """Half a count is what whole ones leave, whatever a float makes of it; more is an error."""
    with tempfile.TemporaryDirectory() as folder:
        run = Run(Path(folder))
        end = (count + (1 + 2 * beyond) * side) / scale + offset
        run.scales = [replace(run.scales[0], qc_per_unit=scale, offset=offset)]
        run.trajectory = trajectory(
            [0.0, 2.0], [[end - TURN_QC / scale, 0], [end, 0]], velocities=[[0, 0], [0, 0]]
        )
        run.columns["node_1_demand_qc"] += (end - offset) * scale - TURN_QC
        run.positions = {"j0": count / scale + offset}
        out = io.StringIO()
        report = run.report()
        report.print(Terminal(out))
    assert bool(report.failures()) == bool(beyond)
    assert ("0.51!" if beyond else "0.50\n") in out.getvalue()


def test_a_buffer_that_nearly_runs_dry_fails(ran):
    ran.columns["node_1_buffer_level"][50] = 1
    assert ran.report().failures() == ["j0: buffer level 1 … 21 records, must be 2 … 64"]


def test_the_run_out_at_the_end_is_no_underflow(ran):
    assert min(ran.columns["node_1_buffer_level"]) == 0
    assert ran.report().axes[0].levels == (20, 21)


def test_a_buffer_error_fails(ran):
    ran.buffer_errors["j1"] = "underflow error"
    assert ran.report().failures() == ["j1: underflow error"]


def test_only_the_last_motion_counts(ran):
    for name, values in list(ran.columns.items()):
        before = np.arange(1, 31) if name.endswith("path_ms") else np.full(30, 99_999)
        ran.columns[name] = np.concatenate([before, values])
    assert ran.report().failures() == []


# -- plans at the limits of the joints, where the driver chooses the curve -------------------


class Planned:
    """A plan at the limits as the driver's records have it executed, to be spoilt."""

    def __init__(self, trajectory: Trajectory, folder: Path) -> None:
        config = DriverConfig(planned_axes(trajectory))
        plan = make_plan(trajectory, config, trajectory.positions[0].tolist())
        self.trajectory, self.log = trajectory, folder / "log.npz"
        self.scales = [
            Scale(
                *(axis.joint, axis.node_id, "epos2", "rad", TURN_QC / (2 * np.pi), 0.0),
                *(axis.max_velocity or np.inf, axis.max_acceleration or np.inf),
            )
            for axis in config.axes
        ]
        self.demand_qc = [axis.samples(1).executed.position_qc for axis in plan.axes]

    def failures(self) -> list[str]:
        columns: dict[str, Any] = {}
        for scale, demand_qc in zip(self.scales, self.demand_qc, strict=True):
            path_ms = np.arange(len(demand_qc))
            node = f"node_{scale.node_id}"
            columns[f"{node}_time_us"] = path_ms * 1000.0
            columns[f"{node}_path_ms"] = path_ms
            columns[f"{node}_demand_qc"] = demand_qc
            columns[f"{node}_buffer_level"] = np.full(len(demand_qc), 9)
        np.savez(self.log, **columns)
        commanded = Commanded(self.trajectory, HOLD_S, self.scales)
        ends = commanded.at(np.array([np.inf]))[0]
        joints = self.trajectory.joint_names
        observed = Observed(
            dict.fromkeys(joints, 1), dict(zip(joints, ends.tolist(), strict=True)), {}, 30, 9.5
        )
        return Report.of(
            commanded, joints, self.scales, self.log, observed, 1_000_000, tolerance_qc=1.0
        ).failures()


@pytest.mark.parametrize("step_s", [0.1, 0.02])
@pytest.mark.parametrize("planner", [from_toppra, from_ruckig])
@pytest.mark.parametrize("velocities", [True, False], ids=["velocities", "positions alone"])
def test_a_plan_at_the_limits_is_right_with_every_curve_that_keeps_them(
    velocities, planner, step_s, tmp_path
):
    message = planner(2, step_s=step_s)
    if not velocities:
        message = replace(message, velocities=None, accelerations=None)
    assert Planned(message, tmp_path).failures() == []


@pytest.mark.parametrize("velocities", [True, False], ids=["velocities", "positions alone"])
def test_between_the_points_of_a_plan_not_every_curve_is_right(velocities, tmp_path):
    """Points missed by 2 counts; a swerve between two of them; or, of positions alone, the
    polynomials after all, which have several times the acceleration."""
    message = from_toppra(2)
    if not velocities:
        message = replace(message, velocities=None, accelerations=None)
    there = Planned(message, tmp_path)
    right = there.demand_qc
    t_s = np.arange(len(right[0])) / 1000 - HOLD_S
    there.demand_qc = [right[0] + 2.1, *right[1:]]
    assert there.failures()[0].startswith("joint_1: path error ")
    swerve_qc = 100 * np.sin(np.pi * np.clip((t_s - 2.0) / 0.1, 0, 1)) ** 2
    there.demand_qc = [*right[:3], right[3] + swerve_qc, *right[4:]]
    assert any(failure.startswith("joint_4: ") for failure in there.failures())
    if not velocities:
        curve = Commanded(message).at(t_s).T
        there.demand_qc = [s.to_qc(q) for s, q in zip(there.scales, curve, strict=True)]
        assert any(": acceleration " in failure for failure in there.failures())


def test_within_its_limits_a_joint_has_to_follow_the_polynomials(tmp_path):
    """Others may be chosen for pieces only that exceed a limit."""
    slow = np.array([[0.0], [0.4], [0.8], [1.0]])
    points = trajectory([0.0, 1.0, 2.0, 3.0], slow, velocities=[[0], [0.4], [0.3], [0]])
    scale = Scale("j0", 1, "epos2", "rad", TURN_QC / (2 * np.pi), 0.0, 1.0, 2.0)
    commanded, t_s = Commanded(points, scales=[scale]), np.linspace(0, 3, 301)
    low, high = commanded.between(t_s)
    np.testing.assert_array_equal(low, high)
    np.testing.assert_array_equal(low, commanded.at(t_s))
    # The first piece begins with 6·0.4 − 2·0.4 = 1.6 rad/s², the others stay below.
    tight = Commanded(points, scales=[replace(scale, max_acceleration=1.5)])
    low, high = tight.between(t_s)
    differs = (low < high).any(axis=1)
    assert differs[(t_s > 0.05) & (t_s < 0.95)].all() and not differs[t_s > 1].any()
    # From rest with 1.2 times 1.5 rad/s².
    assert high[5, 0] == pytest.approx(0.9 * 0.05**2)


# -- position-triggered outputs --------------------------------------------------------------

SWING = trajectory([0.0, 1.0, 2.0], [[0.0], [1.0], [0.0]], velocities=[[0.0], [0.0], [0.0]])


def crossings(direction: str = "both", sign: int = 1, **settings: Any) -> list[Crossing]:
    """On a joint of 1000 counts a metre that goes 1 m out and back, a second each way."""
    given = {f"compare.camera.{n}": v for n, v in settings.items()}
    given["compare.camera.direction"] = direction
    scale = Scale("j0", 1, "epos2", "m", sign * 1000.0, 0.0)
    return expected_of("camera", given, Commanded(SWING), 0, scale)


def test_what_should_fire_is_worked_out_from_the_trajectory():
    """The cubic 3t² − 2t³ is at 0.5 at half its time, and symmetric about it."""
    interval = {"kind": "interval", "start": 0.25, "interval": 0.5}
    assert [c[1:] for c in crossings(**interval)] == [
        *((250, True), (750, True), (750, False), (250, False)),
    ]
    times = [c.t_s for c in crossings(**interval)]
    assert times[0] + times[1] == pytest.approx(1.0, abs=1e-3)
    assert times[0] + times[3] == pytest.approx(2.0, abs=1e-6)
    once = crossings("up", kind="crossing", positions=[0.5005])  # nearest count 500, from 499.5
    assert [c[1:] for c in once] == [(500, True)]
    assert once[0].t_s == pytest.approx(0.5 - 0.0005 / 1.5, abs=1e-6)  # 1.5 m/s there


def test_a_joint_that_counts_backwards_is_seen_from_the_joint():
    up = crossings("up", sign=-1, kind="crossing", positions=[0.5])
    assert [c[1:] for c in up] == [(-500, False)]


@pytest.mark.parametrize(
    ("told", "failure"),
    [
        ([(0.1, 5, True), (0.2, 6, True)], ""),
        ([(0.1, 5, True)], "camera: 1 events, expected 2"),
        (
            [(0.1, 5, True), (0.2, 7, True)],
            "camera: event 2 at 7 qc upward, expected at 6 qc upward",
        ),
        (
            [(0.1, 5, False), (0.2, 6, True)],
            "camera: event 1 at 5 qc downward, expected at 5 qc upward",
        ),
    ],
)  # fmt: skip
def test_other_events_than_expected_fail(told, failure, ran):
    expected = (Crossing(0.1, 5, True), Crossing(0.2, 6, True))
    result = OutputResult("camera", "j0", expected, tuple(Crossing(*event) for event in told))
    assert result.failure == failure
    report = replace(ran.report(), outputs=(result,))
    assert report.failures() == ([failure] if failure else [])
    out = io.StringIO()
    report.print(Terminal(out))
    assert re.search(rf"^camera +{len(told)}!? +2 +0 +0 +j0", out.getvalue(), re.M)


# -- the terminal ----------------------------------------------------------------------------


class Tty(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_away_from_a_terminal_there_are_no_escapes():
    out = io.StringIO()
    terminal = Terminal(out)
    terminal.line(terminal.bold("a") + terminal.judged("b", True) + terminal.judged("c", False))
    assert out.getvalue() == "abc!\n"
    assert not terminal.interactive


def test_a_block_is_redrawn_in_place(monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    out = Tty()
    terminal = Terminal(out)
    terminal.block(["one", "two"])
    terminal.block(["three"])
    terminal.line("four")
    assert out.getvalue() == "one\ntwo\n\x1b[2A\x1b[Jthree\n\x1b[1A\x1b[Jfour\n"


def test_bars_have_eighths():
    assert [bar(share, 2) for share in (-1.0, 0.0, 1 / 16, 0.5, 1.0, 2.0)] == [
        *("  ", "  ", "▏ ", "█ ", "██", "██"),
    ]


# -- from the command line -------------------------------------------------------------------


class Command:
    """`epos2_ros …` as a process of its own."""

    def __init__(self, env: dict[str, str], folder: Path) -> None:
        self._env = env
        self._folder = folder
        self.processes: list[subprocess.Popen[str]] = []

    def __call__(self, *arguments: object) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [sys.executable, "-m", "epos2_ros", *map(str, arguments)],
            env=self._env,
            cwd=self._folder,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        self.processes.append(process)
        return process


@pytest.fixture
def command(ros_env: dict[str, str], tmp_path: Path) -> Iterator[Command]:
    it = Command(ros_env, tmp_path)
    yield it
    for process in it.processes:
        process.kill()
        process.wait()


def children_of(pid: int) -> list[int]:
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    return [int(child) for child in children]


OUTPUTS = Path(__file__).parents[2] / "config" / "outputs.yaml"


@pytest.mark.parametrize("name", ["raster_scan", "pick_place"])
def test_the_demo_runs_an_example_within_its_limits(name, command, examples, tmp_path):
    """In two processes; pick_place on drives of three makers, EPOS2 with the note's dictionary."""
    params = OUTPUTS
    if name == "pick_place":
        given = yaml.safe_load((OUTPUTS.parent / "mixed.yaml").read_text())
        given["/**"]["ros__parameters"]["simulation"]["dictionary"] = "note"
        params = tmp_path / "note.yaml"
        params.write_text(yaml.safe_dump(given))
    demo = command("demo", examples / f"{name}.yaml", "--two-processes", "--params", params)
    output, _ = demo.communicate()
    assert demo.returncode == 0, output
    joints = yaml.safe_load((examples / f"{name}.yaml").read_text())["joint_names"]
    for joint in joints:
        figures = r"\d+ +(?:[01]\.\d\d |\d+ ≤ +\d+  set-points)"  # of records, of set-points
        assert re.search(rf"^{joint} +{figures}", output, re.M), output
    assert "everything within its limits" in output
    assert (tmp_path / f"demo_{name}.png").read_bytes().startswith(b"\x89PNG")
    assert "Traceback" not in output
    if name == "raster_scan":  # 6 lines of 200 mm, a picture every millimetre
        assert re.search(r"^camera +1200 +1200 ", output, re.M), output


def test_a_refused_trajectory_ends_the_demo_with_the_reason(command, examples, tmp_path):
    file = tmp_path / "fast.yaml"
    message = yaml.safe_load((examples / "raster_scan.yaml").read_text())
    for point in message["points"]:  # 4 m/s: 240,000 rpm
        point["positions"] = [20 * position for position in point["positions"]]
        point["velocities"] = [20 * velocity for velocity in point["velocities"]]
    file.write_text(yaml.safe_dump(message))
    demo = command("demo", file)
    output, _ = demo.communicate()
    assert demo.returncode == 1
    assert "trajectory refused" in output
    assert "Traceback" not in output


def test_a_robot_of_the_demo_stands_where_the_trajectory_begins(command, tmp_path):
    points = [
        {"positions": [0.25, -1.0], "time_from_start": {"nanosec": 300_000_000}},
        {"positions": [0.5, -1.5], "time_from_start": {"sec": 1}},
    ]
    file = tmp_path / "short.yaml"
    file.write_text(yaml.safe_dump({"joint_names": ["a", "b"], "points": points}))
    demo = command("demo", file, "--output", "short.png")
    output, _ = demo.communicate()
    assert demo.returncode == 0, output
    assert (tmp_path / "short.png").exists()


def test_a_file_that_is_no_trajectory_is_one_line(command, tmp_path):
    (tmp_path / "bad.yaml").write_text("points: 3")
    demo = command("demo", "bad.yaml")
    output, _ = demo.communicate()
    assert demo.returncode == 1
    assert output.startswith("epos2_ros demo: not a JointTrajectory")
    assert output.count("\n") == 1


@pytest.mark.parametrize(
    ("points", "parameters", "output", "says"),
    [
        (1, None, "x.png", "short.yaml has one point"),
        (2, {"joints": 5}, "x.png", "joints is 5; it must be a list of 1 to 127 names"),
        (2, {"joints": ["a"], "axes": {"a": {"type": "prismatic"}}}, "x.png", "axes.a.lead is 0"),
        (2, None, "x.foo", "argument --output: 'x.foo': must end in .png"),
    ],
)
def test_what_the_demo_cannot_run_is_one_line(points, parameters, output, says, command, tmp_path):
    there = [{"positions": [0.1 * n], "time_from_start": {"sec": n}} for n in range(points)]
    file = tmp_path / "short.yaml"
    file.write_text(yaml.safe_dump({"joint_names": ["a"], "points": there}))
    options = ["short.yaml", "--output", output]
    if parameters:
        sections = {"epos2_driver": {"ros__parameters": parameters}}
        (tmp_path / "bad.yaml").write_text(yaml.safe_dump(sections))
        options += ["--params", "bad.yaml"]
    demo = command("demo", *options)
    said, _ = demo.communicate()
    assert demo.returncode in (1, 2)
    assert "Traceback" not in said
    last_line = said.splitlines()[-1]
    assert last_line.startswith("epos2_ros demo: ")
    assert says in last_line


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_demo_leaves_no_process_behind(number, command, examples):
    demo = command("demo", examples / "positions_only.yaml")
    assert demo.stdout is not None
    children: list[int] = []
    for line in demo.stdout:
        if "active" in line:
            children = children_of(demo.pid)
            os.kill(demo.pid, number)
            break
    assert children
    output, _ = demo.communicate()
    assert demo.returncode == 130, output
    assert "Traceback" not in output
    for child in children:
        assert not Path(f"/proc/{child}").exists()
