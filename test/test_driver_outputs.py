"""Position-triggered outputs in the driver: parameters, and events of drives in real time."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import pytest

from epos2_ros.bus.driver import Driver
from epos2_ros.compare_config import CompareConfig
from epos2_ros.config import AxisConfig, DriverConfig
from epos2_ros.errors import ConfigurationError, TrajectoryError
from epos2_ros.parameters import DriverParameters
from epos2_ros.protocol.group import Event
from epos2_ros.protocol.outputs import OutputEvent

BELT: dict[str, Any] = {
    "type": "prismatic", "counts_per_turn": 2000, "gear_ratio": 100.0, "lead": 0.1,
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


def test_what_the_drive_cannot_do_is_refused_before_the_bus_is_opened() -> None:
    config = parameters(joint="joint_1", kind="window", window=[0.1, 0.2]).config()
    with pytest.raises(ConfigurationError, match="the EPOS2 has crossing, interval and marker"):
        Driver(config)


class Bench:
    """A driver with a Copley axis z beside an EPOS2 axis x, on simulated drives."""

    def __init__(self, channel: str, *outputs: CompareConfig) -> None:
        axes = (
            AxisConfig("x", 1, **BELT),
            AxisConfig("z", 2, drive="copley", max_velocity=0.2, max_acceleration=1.0, **BELT),
        )
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

    def until(self, condition: Callable[[], bool], seconds: float = 20.0) -> None:
        end = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end, self.events
            time.sleep(0.02)

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
        bench.until(lambda: bench.events[-1].kind == "done")
        bench.driver.set_output(coarser)
        bench.driver.move_to({"z": 0.0})
        down = [round(0.0485 - 0.002 * n, 6) for n in range(25)]
        bench.until(lambda: len(bench.positions("laser")) >= 75)
        assert bench.positions("laser")[50:] == down
        bench.until(lambda: bench.positions("glue")[2:] == [0.045, 0.015, 0.005])
        with pytest.raises(TrajectoryError, match="joint 'x' does not move in profile position"):
            bench.driver.move_to({"x": 0.1})
        with pytest.raises(TrajectoryError, match="position 2000 m is outside its limits"):
            bench.driver.move_to({"z": 2000.0})
        states = {axis.joint: axis.state for axis in bench.driver.snapshot().axes}
        assert list(states.items()) == [("x", "operation enabled"), ("z", "operation enabled")]
        bench.driver.disable()
