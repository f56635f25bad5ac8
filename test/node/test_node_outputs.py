"""The node's side of position-triggered outputs: parameters that change, topics, refusals."""

from __future__ import annotations

import time
from typing import Any

import pytest
from builtin_interfaces.msg import Duration
from rcl_interfaces.srv import DescribeParameters, GetParameters, SetParametersAtomically
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from test_node import FakeDriver, World
from test_node import world as world  # a fixture
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from epos2_ros.errors import ConfigurationError, DriveError, TrajectoryError
from epos2_ros.protocol.outputs.outputs import OutputEvent

CAMERA = {
    "compare__camera__joint": "a",
    "compare__camera__kind": "interval",
    "compare__camera__start": 0.0,
    "compare__camera__interval": 0.1,
}
LASER = {
    "compare__laser__joint": "b",
    "compare__laser__kind": "crossing",
    "compare__laser__positions": [0.5],
}


def started(world: World, **parameters: Any) -> FakeDriver:
    return world.started(outputs=["camera", "laser"], **{**CAMERA, **LASER, **parameters})


def change(world: World, **values: Any) -> str:
    """Sets parameters together; the reason why not, "" if they were."""
    request = SetParametersAtomically.Request(
        parameters=[
            Parameter(f"compare.{name.replace('__', '.')}", value=value).to_parameter_msg()
            for name, value in values.items()
        ]
    )
    answer = world.call(SetParametersAtomically, "/epos2_driver/set_parameters_atomically", request)
    assert answer.result.successful == (not answer.result.reason)
    return str(answer.result.reason)


def double(world: World, name: str) -> float:
    request = GetParameters.Request(names=[name])
    answer = world.call(GetParameters, "/epos2_driver/get_parameters", request)
    return float(answer.values[0].double_value)


def test_an_event_is_a_message_with_the_time_of_the_crossing(world):
    driver = started(world)
    got = world.listen(JointState, "/epos2_driver/compare/camera")
    publisher = world.node._output_events["camera"]
    world.wait(publisher.get_subscription_count)
    before = time.time_ns()
    driver.on_output(OutputEvent("camera", "a", time.monotonic_ns() / 1e3 - 5e6, 0.25, -1.5))
    world.wait(lambda: got)
    (message,) = got
    assert list(message.name) == ["a"]
    assert (list(message.position), list(message.velocity)) == ([0.25], [-1.5])
    stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
    assert stamp == pytest.approx(before - 5 * 10**9, abs=1e8)  # five seconds ago


def test_new_positions_reach_the_drive_or_are_refused_with_one_line(world):
    driver = started(world)
    world.publish("compare/laser/positions", Float64MultiArray(data=[0.25, 0.5]))
    world.wait(lambda: "positions of laser: [0.25, 0.5]" in driver.calls)
    driver.failures["positions of laser: [0.5]"] = ConfigurationError("only a series takes them")
    world.publish("compare/laser/positions", Float64MultiArray(data=[0.5]))
    assert world.logged("refused")[-1] == "positions refused: only a series takes them"


def test_a_parameter_that_a_topic_has_changed_says_so(world):
    driver = started(world)
    world.publish("compare/laser/positions", Float64MultiArray(data=[0.25, 0.5]))
    request = GetParameters.Request(names=["compare.laser.positions"])

    def shown() -> list[float]:
        answer = world.call(GetParameters, "/epos2_driver/get_parameters", request)
        return list(answer.values[0].double_array_value)

    world.wait(lambda: shown() == [0.25, 0.5])
    assert not [call for call in driver.calls if call == "set laser"]  # it had them already
    assert change(world, laser__pulse=0.01) == ""  # and does not lose them with a later change
    assert driver.outputs["laser"].positions == (0.25, 0.5)


def move(seconds: int, *positions: float) -> JointTrajectory:
    point = JointTrajectoryPoint(positions=list(positions), time_from_start=Duration(sec=seconds))
    return JointTrajectory(joint_names=["a", "b"], points=[point])


def test_a_move_has_one_point(world):
    driver = started(world)
    world.publish("move_to", move(3, 1.0, -0.5))
    world.wait(lambda: "move to {'a': 1.0, 'b': -0.5} in 3 s" in driver.calls)
    two = move(3, 1.0, -0.5)
    two.points.append(JointTrajectoryPoint(positions=[0.0, 0.0], time_from_start=Duration(sec=4)))
    world.publish("move_to", two)
    refused = "move refused: 2 points; a move has one, its target"
    assert world.logged("move refused")[-1] == refused
    driver.failures["move to {'a': 0.0, 'b': 0.0} in 0 s"] = TrajectoryError("it moves already")
    world.publish("move_to", move(0, 0.0, 0.0))
    assert world.logged("it moves already")[-1] == "move refused: it moves already"


def test_a_running_drive_follows_its_parameters(world):
    driver = started(world)
    assert change(world, camera__interval=0.2, camera__pulse=0.004) == ""
    assert [call for call in driver.calls if "set" in call] == ["set camera"]
    assert (driver.outputs["camera"].interval, driver.outputs["camera"].pulse) == (0.2, 0.004)
    assert double(world, "compare.camera.interval") == 0.2
    # What makes no sense half way is one change: an interval becomes a window.
    assert change(world, laser__kind="window", laser__window=[0.1, 0.2]) == ""
    assert driver.outputs["laser"].window == (0.1, 0.2)


def test_what_the_drive_refuses_is_not_changed(world):
    driver = started(world)
    driver.failures["set laser"] = DriveError("node 2 refuses 5 for 0x2193-01")
    assert change(world, camera__interval=0.2, laser__pulse=0.01) == (
        "node 2 refuses 5 for 0x2193-01"
    )
    assert driver.outputs["camera"].interval == 0.1  # it had followed, and is as before
    assert double(world, "compare.camera.interval") == 0.1
    assert double(world, "compare.laser.pulse") == 0.001
    driver.failures.clear()
    assert change(world, camera__toggle=True, laser__toggle=True) == ""
    assert driver.outputs["camera"].interval == 0.1  # nor does it come with a later change
    assert driver.outputs["laser"].pulse == 0.001
    assert change(world, camera__kind="edge").startswith("compare.camera.kind is 'edge'; it must ")
    assert change(world, camera__kind="window") == (
        "compare.camera.window is not set; a window needs [lower, upper]"
    )


def test_when_parameters_can_change_is_described(world):
    started(world)
    request = DescribeParameters.Request(names=["compare.camera.pulse", "ipm.tolerance"])
    answer = world.call(DescribeParameters, "/epos2_driver/describe_parameters", request)
    pulse, tolerance = (descriptor.additional_constraints for descriptor in answer.descriptors)
    assert pulse.endswith("; changes while the axes stand")
    assert tolerance.endswith("; changes only while unconfigured")


def test_an_output_that_cannot_be_refuses_configure_with_one_line(world):
    world.start(joints=["a"], outputs=["camera"], **{**CAMERA, "compare__camera__interval": 0.0})
    (line,) = world.logged("failed")
    assert line.startswith("configure failed: compare.camera.interval is not set; it must be abov")
    assert not world.drivers
    assert change(world, camera__interval=0.5) == ""  # put right while unconfigured
    assert world.change(1)
    assert world.drivers[0].config.outputs[0].interval == 0.5
