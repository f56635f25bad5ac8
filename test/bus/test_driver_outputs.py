"""Position-triggered outputs in the driver: parameters, and events of drives in real time."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus

from epos2_ros.bus.driver import Driver
from epos2_ros.bus.snapshot import OutputSnapshot, Snapshot
from epos2_ros.configuration.driver import (
    AxisConfig,
    ClockLimits,
    DriverConfig,
    HomingConfig,
)
from epos2_ros.configuration.outputs import CompareConfig
from epos2_ros.configuration.parameters import DriverParameters
from epos2_ros.errors import ConfigurationError, DriveError, TrajectoryError
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.node import messages
from epos2_ros.protocol.outbox import Event
from epos2_ros.protocol.outputs.outputs import OutputEvent, Tally
from epos2_ros.sim.realtime import now_us

BELT: dict[str, Any] = {
    "type": "prismatic", "counts_per_turn": 2000, "gear_ratio": 100.0, "lead": 0.1,
}  # fmt: skip
COPLEY: dict[str, Any] = {
    "drive": "copley", "trajectory": "profile", "max_velocity": 0.2, "max_acceleration": 1.0,
    **BELT,
}  # fmt: skip


def parameters(**given: Any) -> DriverParameters:
    at = {f"compare.camera.{name}": value for name, value in given.items()}
    return DriverParameters({"outputs": ["camera"], **at})


def test_outputs_are_read_from_parameters() -> None:
    given = {"joint": "joint_2", "kind": "interval", "start": 0.5, "interval": 1, "end": -1.0}
    (camera,) = parameters(**given, pulse=0.002, inverted=True).config().outputs
    assert camera == CompareConfig(
        "camera", "joint_2", "interval", start=0.5, interval=1.0, end=-1.0, pulse=0.002,
        inverted=True,
    )  # fmt: skip
    (series,) = parameters(joint="joint_1", kind="series", positions=[0, 1.5]).config().outputs
    assert series.positions == (0.0, 1.5)
    assert series.method is None
    assert DriverParameters({"outputs": []}).config().outputs == ()
    assert DriverParameters({}).config().outputs == ()


@pytest.mark.parametrize(
    ("given", "line"),
    [
        ({"kind": "edge"}, "compare.camera.kind is 'edge'; it must be window, crossing, series, "),
        ({}, "compare.camera.joint is not set; it must name the joint whose position triggers"),
        ({"joint": "joint_1"}, "compare.camera.kind is not set; it must be one of window, cross"),
        (
            {"joint": "joint_1", "kind": "crossing", "positions": []},
            "compare.camera.positions is []; a crossing needs positions, all finite",
        ),
        ({"windows": [0.0, 1.0]}, "there is no such parameter; did you mean compare.camera.window"),
        (
            {"joint": "joint_1", "kind": "window", "window": [0.2, 0.1]},
            "compare.camera.window is [0.2, 0.1]; the lower end comes first: [lower, upper]",
        ),
    ],
)  # fmt: skip
def test_a_wrong_parameter_of_an_output_is_one_line(given: dict[str, Any], line: str) -> None:
    with pytest.raises(ConfigurationError) as refused:
        parameters(**given).config()
    assert line in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("name", ["my camera", "a/b", "9", "ä", "a__b", ""])
def test_an_output_whose_name_is_no_topic_is_refused(name: str) -> None:
    given = DriverParameters({"outputs": ["ok", name]})
    assert given.values["outputs"] == []  # the node comes up
    with pytest.raises(ConfigurationError, match="names of letters, digits and _, each once"):
        given.config()


def test_what_the_drive_cannot_do_is_refused_before_the_bus_is_opened() -> None:
    config = parameters(joint="joint_1", kind="window", window=[0.1, 0.2]).config()
    with pytest.raises(ConfigurationError, match="the EPOS2 has crossing, interval and marker"):
        Driver(config)


class Bench:
    """A driver with a Copley axis z beside an EPOS2 axis x, on simulated drives."""

    def __init__(
        self, channel: str, *outputs: CompareConfig, axes: tuple[AxisConfig, ...] = ()
    ) -> None:
        axes = axes or (AxisConfig("x", 1, **BELT), AxisConfig("z", 2, **COPLEY))
        self.events: list[Event] = []
        self.fired: list[OutputEvent] = []
        config = DriverConfig(axes=axes, outputs=outputs, channel=channel)
        self.driver = Driver(config, self.events.append, self.fired.append)

    def __enter__(self) -> Bench:
        self.driver.configure()
        self.driver.enable()
        return self

    def __exit__(self, *_: object) -> None:
        self.driver.close()

    def power(self, node_id: int, on: bool) -> None:
        """A drive loses its power, or gets it back."""
        assert self.driver._simulation is not None
        simulator = self.driver._simulation._simulator
        with simulator.lock:
            drive = next(drive for drive in simulator._drives if drive.node_id == node_id)
            drive.power_on(now_us()) if on else drive.power_off()

    def until(self, condition: Callable[[], bool], seconds: float = 20.0) -> None:
        end = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end, self.events
            time.sleep(0.02)

    @property
    def done(self) -> int:
        """How many motions have ended well."""
        return sum(event.kind == "done" for event in self.events)

    def positions(self, name: str) -> list[float]:
        return [round(event.position, 6) for event in self.fired if event.name == name]


def test_a_copley_axis_moves_beside_an_epos2_and_tells_its_events() -> None:
    laser = CompareConfig("laser", "z", "interval", start=0.0005, interval=0.001)
    glue = CompareConfig("glue", "z", "series", pin=2, positions=(0.01, 0.03), capacity=3)
    with Bench("outputs1", laser, glue) as bench:
        bench.driver.move_to({"z": 0.05})
        up = [round(0.0005 + 0.001 * n, 6) for n in range(50)]
        bench.until(lambda: len(bench.positions("laser")) >= 50)
        assert bench.positions("laser") == up
        bench.until(lambda: bench.positions("glue") == [0.01, 0.03])
        bench.driver.set_positions("glue", (0.005, 0.015, 0.045))
        with pytest.raises(ConfigurationError, match="memory is reserved for 3"):
            bench.driver.set_positions("glue", (0.1, 0.2, 0.3, 0.4))
        coarser = CompareConfig("laser", "z", "interval", start=0.0005, interval=0.002)
        bench.until(lambda: bench.done == 1)
        bench.driver.set_output(coarser)
        bench.driver.move_to({"z": 0.0})
        down = [round(0.0485 - 0.002 * n, 6) for n in range(25)]
        bench.until(lambda: len(bench.positions("laser")) >= 75)
        assert bench.positions("laser")[50:] == down
        bench.until(lambda: bench.positions("glue")[2:] == [0.045, 0.015, 0.005])
        with pytest.raises(TrajectoryError, match="unknown joint 'y'; the joints are x, z"):
            bench.driver.move_to({"y": 0.1})
        with pytest.raises(TrajectoryError, match="position 2000 m is outside its limits"):
            bench.driver.move_to({"z": 2000.0})
        states = {axis.joint: axis.state for axis in bench.driver.snapshot().axes}
        assert list(states.items()) == [("x", "operation enabled"), ("z", "operation enabled")]
        bench.driver.disable()


def line(start: float, end: float, seconds: float) -> Trajectory:
    """x from rest to rest along a cubic."""
    return Trajectory(
        ("x",), np.array([0.0, seconds]), np.array([[start], [end]]), np.zeros((2, 1))
    )


def test_copley_drives_alone_move_and_tell_their_events() -> None:
    axes = (AxisConfig("z", 1, **COPLEY), AxisConfig("w", 2, **COPLEY))
    laser = CompareConfig("laser", "z", "interval", start=0.0005, interval=0.001)
    with Bench("outputs2", laser, axes=axes) as bench:
        assert bench.driver.snapshot().state == "standing"
        bench.driver.move_to({"z": 0.02, "w": 0.01})
        bench.until(lambda: len(bench.positions("laser")) >= 20)
        bench.until(lambda: bench.done == 1)
        with pytest.raises(TrajectoryError) as refused:
            bench.driver.submit(line(0.0, 0.1, 1.0))
        assert str(refused.value) == (
            "joint 'x' is unknown; no joint of this driver follows trajectories"
        )
        bench.driver.disable()
        assert bench.driver.snapshot().state == "disabled"


def test_a_joint_that_is_moved_by_profiles_follows_no_trajectory() -> None:
    with Bench("outputs3") as bench:
        move = Trajectory(("x", "z"), np.array([0.0, 1.0]), np.zeros((2, 2)), np.zeros((2, 2)))
        with pytest.raises(TrajectoryError) as refused:
            bench.driver.submit(move)
    assert str(refused.value) == (
        "joint 'z' can't follow a trajectory: its Copley drive moves in profile position mode, "
        "by ~/move_to (axes.z.trajectory)"
    )


def test_what_is_predicted_of_a_replaced_motion_is_what_comes() -> None:
    """From 0 towards 80 mm, turned round on the way: predicted anew, without a difference."""
    camera = CompareConfig("camera", "x", "interval", start=0.0005, interval=0.001)
    with Bench("outputs4", camera) as bench:
        bench.driver.submit(line(0.0, 0.08, 2.5))
        bench.until(lambda: len(bench.positions("camera")) >= 5)
        back = Trajectory(("x",), np.array([2.0]), np.array([[0.01]]), np.zeros((1, 1)))
        bench.driver.submit(back)
        bench.until(lambda: bench.done == 1)
        bench.until(lambda: bench.driver.snapshot().outputs[0].tally.predicted is not None)
        tally = bench.driver.snapshot().outputs[0].tally
        assert tally.difference == "", bench.events
        assert tally.predicted == tally.reported == tally.events == len(bench.positions("camera"))
        assert bench.positions("camera")[-1] == 0.0105
        assert tally.events > 20
        assert [event for event in bench.events if event.kind == "warning"] == []


def test_what_may_go_wrong_is_said_before_the_motion() -> None:
    """The document's remedy for extrapolated encoders; and a place where the axis turns."""
    laser = CompareConfig(
        "laser", "z", "interval", start=0.0, interval=0.001, pulse=1e-5, extrapolated=True
    )
    camera = CompareConfig("camera", "x", "interval", start=0.0, interval=0.01, pulse=0.0005)
    axes = (
        AxisConfig("x", 1, **BELT),
        AxisConfig("z", 2, **{**COPLEY, "max_velocity": 1.0, "max_acceleration": 100.0}),
    )
    with Bench("outputs5", laser, camera, axes=axes) as bench:
        bench.driver.submit(line(0.0, 0.02, 1.0))
        bench.until(lambda: bench.done == 1)
        bench.driver.move_to({"z": 0.05})
        bench.until(lambda: bench.done == 2)
    kinds = [event.kind for event in bench.events]
    warnings = [event.text for event in bench.events if event.kind == "warning"]
    stops = next(text for text in warnings if text.startswith("compare.camera: "))
    assert "the axis stops or turns at 0.02 m, within 2 counts of an output" in stops
    # ½ · 200,000,000 counts/s² · (250 µs)² = 6.25 counts, told with one digit
    size = next(text for text in warnings if "extrapolated" in text)
    words = "compare.laser: the encoder is extrapolated: outputs fire up to "
    assert size.startswith((f"{words}6.2 counts", f"{words}6.3 counts"))
    assert kinds.index("warning") < kinds.index("done")


def test_an_axis_in_trouble_stops_those_of_the_other_family() -> None:
    with Bench("outputs6") as bench:
        bench.driver.submit(line(0.0, 0.1, 3.0))
        bench.until(lambda: any(event.kind == "started" for event in bench.events))
        bench.power(2, on=False)
        bench.until(lambda: bench.driver.snapshot().state == "fault")
        snapshot = bench.driver.snapshot()
        assert "z (node 2) is silent" in snapshot.reason
        silent_s = {axis.joint: axis.silent_s for axis in snapshot.axes}
        assert silent_s.pop("z") > 0.3 and not any(silent_s.values())
        bench.until(lambda: bench.events[-1] == Event("aborted", snapshot.reason))
        with pytest.raises(TrajectoryError, match=r"can't move: .*z \(node 2\) is silent"):
            bench.driver.submit(line(0.05, 0.1, 3.0))


def diagnosed(snapshot: Snapshot) -> dict[str, DiagnosticStatus]:
    array = messages.diagnostics(snapshot, "epos2_driver", "can0", Time(), ClockLimits())
    return {status.name.partition(": ")[2]: status for status in array.status}


def test_a_difference_from_the_prediction_is_a_diagnostic() -> None:
    camera = CompareConfig("camera", "z", "interval", start=0.0005, interval=0.001)
    with Bench("outputs7", camera) as bench:
        before = bench.driver.snapshot()
        assert before.outputs == (OutputSnapshot("camera", "z", 2, Tally()),)
        wrong = Tally(700, 200, 199, 0.0, "200 events predicted, 199 reported")
        after = replace(before, outputs=(OutputSnapshot("camera", "z", 2, wrong),))
    status = diagnosed(before)["compare.camera"]
    assert (status.level, status.message) == (DiagnosticStatus.OK, "no motion yet")
    status = diagnosed(after)["compare.camera"]
    assert (status.level, status.message) == (DiagnosticStatus.WARN, wrong.difference)
    assert status.hardware_id == "can0/2"
    assert [(pair.key, pair.value) for pair in status.values] == [
        ("level", "1"),
        ("joint", "z"),
        ("events", "700"),
        ("predicted in last motion", "200"),
        ("reported in last motion", "199"),
        ("farthest from predicted time [us]", "+0"),
    ]
    # A Copley drive does not report its following error.
    keys = {name: {pair.key for pair in diagnosed(after)[name].values} for name in ("x", "z")}
    assert keys["x"] - keys["z"] == {"following error [qc]"}


@pytest.mark.parametrize(
    ("parameter", "value", "line"),
    [
        ("max_velocity", 30.0, "30 m/s is more than the drive can hold (16.4482 m/s)"),
        ("stop_deceleration", 3e4, "30000 m/s² is more than the drive can hold (10737.4 m/s²)"),
    ],
)
def test_what_a_copley_drive_cannot_hold_is_refused(
    parameter: str, value: float, line: str
) -> None:
    """32 bits of 0.1 counts/s and of 10 counts/s², at 2,000,000 counts/m."""
    axis = AxisConfig("z", 1, **{**COPLEY, parameter: value})
    with pytest.raises(ConfigurationError) as refused:
        Driver(DriverConfig(axes=(axis,)))
    assert str(refused.value) == f"axes.z.{parameter}: {line}"


def test_a_copley_drive_that_comes_back_is_armed_anew() -> None:
    laser = CompareConfig("laser", "z", "interval", start=0.0005, interval=0.001)
    with Bench("outputs8", laser) as bench:
        bench.driver.move_to({"z": 0.01})
        bench.until(lambda: bench.done == 1)
        bench.until(lambda: len(bench.positions("laser")) == 10)
        bench.power(2, on=False)
        bench.until(lambda: bench.driver.snapshot().state == "fault")
        bench.power(2, on=True)
        bench.driver.reset_fault()
        assert bench.driver.snapshot().axes[1].state == "switch on disabled"
        bench.driver.enable()
        here = bench.driver.snapshot().axes[1].position
        bench.driver.move_to({"z": here + 0.0052})
        bench.until(lambda: bench.done == 2)
        bench.until(lambda: len(bench.positions("laser")) == 15)
        bench.until(lambda: bench.driver.snapshot().outputs[0].tally.predicted == 5)
        assert bench.driver.snapshot().outputs[0].tally.difference == ""


def test_outputs_are_armed_again_after_a_homing_that_was_refused_or_stopped() -> None:
    """And not switched off at all while the axes move."""
    laser = CompareConfig("laser", "z", "interval", start=0.0005, interval=0.001)
    homing = HomingConfig("index_positive", (0.02, 0.005), acceleration=0.5, max_travel=0.1)
    axes = (AxisConfig("x", 1, **BELT), AxisConfig("z", 2, **COPLEY, homing=homing))
    with Bench("outputs9", laser, axes=axes) as bench:
        bench.driver.move_to({"z": 0.01})
        with pytest.raises(DriveError, match="can't move: the drives are"):
            bench.driver.home()
        bench.until(lambda: bench.done == 1)
        bench.until(lambda: len(bench.positions("laser")) == 10)
        bench.driver.disable()
        with pytest.raises(DriveError, match="can't move: the drives are disabled"):
            bench.driver.home()
        bench.driver.enable()
        with ThreadPoolExecutor(1) as pool:
            homed = pool.submit(bench.driver.home)
            bench.until(lambda: bench.driver.snapshot().state == "moving")
            bench.driver.halt()
            with pytest.raises(DriveError, match="halted on request"):
                homed.result(10)
        here, before = bench.driver.snapshot().axes[1].position, len(bench.positions("laser"))
        bench.driver.move_to({"z": here - 0.0052})
        bench.until(lambda: bench.done == 2)
        bench.until(lambda: len(bench.positions("laser")) >= before + 5)
