"""examples/moveit: its files agree with one another, with config/arm.yaml and with the driver.

MoveIt itself is not among what can be installed here, so they are read as it reads them.
"""

from __future__ import annotations

import math
import runpy
import subprocess
import sys
import types
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml

from epos2_ros.configuration.driver import AxisConfig
from epos2_ros.configuration.files import read_parameters
from epos2_ros.configuration.parameters import DriverParameters

ROOT = Path(__file__).resolve().parent.parent
MOVEIT = ROOT / "examples" / "moveit"
ARM = DriverParameters(read_parameters(ROOT / "config" / "arm.yaml")).config()
AXES: dict[str, AxisConfig] = {axis.joint: axis for axis in ARM.axes}
ACTION = "/arm_controller/follow_joint_trajectory"


def yaml_of(name: str) -> dict[str, Any]:
    return yaml.safe_load((MOVEIT / name).read_text())


@pytest.fixture(scope="module")
def urdf() -> ElementTree.Element:
    return ElementTree.parse(MOVEIT / "arm.urdf").getroot()


@pytest.fixture(scope="module")
def srdf() -> ElementTree.Element:
    return ElementTree.parse(MOVEIT / "arm.srdf").getroot()


def joints_of(urdf: ElementTree.Element) -> dict[str, ElementTree.Element]:
    """Those that move, from the base on."""
    return {j.get("name"): j for j in urdf.findall("joint") if j.get("type") != "fixed"}


def chain(urdf: ElementTree.Element, tip: str) -> list[str]:
    """Links from the root to `tip`."""
    above = {j.find("child").get("link"): j.find("parent").get("link") for j in urdf.iter("joint")}
    links = [tip]
    while links[-1] in above:
        links.append(above[links[-1]])
    return links[::-1]


# -- the model ---------------------------------------------------------------------------------


def test_joints_and_their_limits_are_the_drivers(urdf):
    joints = joints_of(urdf)
    assert list(joints) == list(AXES)
    for name, joint in joints.items():
        axis, limit = AXES[name], joint.find("limit")
        assert joint.get("type") == axis.type == "revolute"
        assert float(limit.get("lower")) == axis.min_position
        assert float(limit.get("upper")) == axis.max_position
        assert float(limit.get("velocity")) == axis.max_velocity
        assert float(limit.get("effort")) > 0
        assert np.linalg.norm(list(map(float, joint.find("axis").get("xyz").split()))) == 1


def test_the_links_are_one_chain(urdf):
    links = [link.get("name") for link in urdf.findall("link")]
    assert chain(urdf, "tool0") == links
    assert len(urdf.findall("joint")) == len(links) - 1


def test_what_can_be_seen_can_be_collided_with(urdf):
    for link in urdf.findall("link"):
        shapes = [
            [
                (part.find("origin").attrib, [(s.tag, s.attrib) for s in part.find("geometry")])
                for part in link.findall(kind)
            ]
            for kind in ("visual", "collision")
        ]
        assert shapes[0] == shapes[1]


def test_there_is_no_xacro(urdf):
    text = (MOVEIT / "arm.urdf").read_text()
    assert "xacro" not in text
    assert "${" not in text


def test_the_semantic_description_is_of_that_model(urdf, srdf):
    assert srdf.get("name") == urdf.get("name")
    links = [link.get("name") for link in urdf.findall("link")]
    (group,) = srdf.findall("group")
    ends = group.find("chain")
    assert [ends.get("base_link"), ends.get("tip_link")] == [links[0], links[-1]]
    for state in srdf.findall("group_state"):
        assert state.get("group") == group.get("name")
        values = {j.get("name"): float(j.get("value")) for j in state.findall("joint")}
        assert values.keys() == AXES.keys()
        for joint, value in values.items():
            assert AXES[joint].min_position <= value <= AXES[joint].max_position
    for pair in srdf.findall("disable_collisions"):
        one, other = pair.get("link1"), pair.get("link2")
        adjacent = abs(links.index(one) - links.index(other)) == 1
        assert adjacent == (pair.get("reason") == "Adjacent")


# -- what MoveIt is told -----------------------------------------------------------------------


def test_planning_stays_within_what_the_driver_allows():
    limits = yaml_of("joint_limits.yaml")["joint_limits"]
    assert limits.keys() == AXES.keys()
    for joint, limit in limits.items():
        assert limit["has_velocity_limits"]
        assert limit["has_acceleration_limits"]
        assert 0 < limit["max_velocity"] <= AXES[joint].max_velocity
        assert 0 < limit["max_acceleration"] <= AXES[joint].max_acceleration


def test_the_controller_is_the_drivers_action():
    told = yaml_of("moveit_controllers.yaml")
    manager = told["moveit_simple_controller_manager"]
    (name,) = manager["controller_names"]
    controller = manager[name]
    assert controller["type"] == "FollowJointTrajectory"
    assert f"/{name}/{controller['action_ns']}" == ACTION
    assert controller["joints"] == list(AXES)
    assert told["moveit_manage_controllers"] is False
    execution = told["trajectory_execution"]
    assert execution["allowed_start_tolerance"] <= ARM.start_tolerance


def test_group_and_links_that_are_named_exist(urdf, srdf):
    group = srdf.find("group").get("name")
    assert list(yaml_of("kinematics.yaml")) == [group]
    assert yaml_of("servo.yaml")["moveit_servo"]["move_group_name"] == group
    shown = yaml_of("moveit.rviz")["Visualization Manager"]
    planning = next(d for d in shown["Displays"] if d["Name"] == "MotionPlanning")
    assert planning["Planning Request"]["Planning Group"] == group
    links = [link.get("name") for link in urdf.findall("link")]
    assert shown["Global Options"]["Fixed Frame"] in links


def test_servo_publishes_where_the_driver_listens():
    servo = yaml_of("servo.yaml")["moveit_servo"]
    assert servo["command_out_topic"] == "/epos2_driver/joint_trajectory"
    assert servo["command_out_type"] == "trajectory_msgs/JointTrajectory"


# -- the launch file ---------------------------------------------------------------------------


class Described:
    """Stands in for what launch and launch_ros make; remembers what it was made of."""

    def __init__(self, *arguments: Any, **named: Any) -> None:
        self.arguments, self.named = arguments, named


@pytest.fixture
def nodes(monkeypatch: pytest.MonkeyPatch) -> dict[str, Mapping[str, Any]]:
    """What the launch file starts, by executable. ROS' launch is not among the wheels."""
    for module, names in {
        "launch": ["LaunchDescription"],
        "launch.actions": ["DeclareLaunchArgument"],
        "launch.conditions": ["IfCondition"],
        "launch.substitutions": ["LaunchConfiguration"],
        "launch_ros": [],
        "launch_ros.actions": ["LifecycleNode", "Node"],
        "launch_ros.parameter_descriptions": ["ParameterValue"],
    }.items():
        stand_in = types.ModuleType(module)
        for name in names:
            setattr(stand_in, name, type(name, (Described,), {}))
        monkeypatch.setitem(sys.modules, module, stand_in)
    made = runpy.run_path(str(MOVEIT / "moveit.launch.py"))["generate_launch_description"]()
    return {d.named["executable"]: d.named for d in made.arguments[0] if "executable" in d.named}


def test_the_launch_file_starts_all_of_it(nodes):
    assert set(nodes) == {
        "driver",
        "robot_state_publisher",
        "move_group",
        "rviz2",
        "servo_node",
    }
    driver = nodes["driver"]
    assert driver["remappings"] == [("~/follow_joint_trajectory", ACTION)]
    assert (driver["package"], driver["name"]) == ("epos2_ros", "epos2_driver")


def test_move_group_gets_the_model_and_how_to_plan_and_execute(nodes):
    told: dict[str, Any] = {}
    for parameters in nodes["move_group"]["parameters"]:
        told |= parameters
    assert told["robot_description"].arguments[0] == (MOVEIT / "arm.urdf").read_text()
    assert told["robot_description_semantic"].arguments[0] == (MOVEIT / "arm.srdf").read_text()
    assert told["robot_description_planning"] == yaml_of("joint_limits.yaml")
    assert told["robot_description_kinematics"] == yaml_of("kinematics.yaml")
    (pipeline,) = told["planning_pipelines"]
    assert told[pipeline]["planning_plugins"]
    assert "moveit_simple_controller_manager" in told


# -- the arm -----------------------------------------------------------------------------------


def test_the_arm_goes_where_a_plan_leads(ros_env, ros_domain_id, srdf):
    """From "upright" to "ready", as MoveIt would: at the limits of joint_limits.yaml, sampled
    every 0.1 s, to the action under its remapped name."""
    pytest.importorskip("control_msgs", reason="control_msgs is not installed")
    import rclpy
    from builtin_interfaces.msg import Duration
    from control_msgs.action import FollowJointTrajectory
    from rclpy.action import ActionClient
    from rclpy.context import Context
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.node import Node
    from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

    states = {
        state.get("name"): [float(j.get("value")) for j in state.findall("joint")]
        for state in srdf.findall("group_state")
    }
    way = np.array(states["ready"]) - states["upright"]
    limits = next(iter(yaml_of("joint_limits.yaml")["joint_limits"].values()))
    # Half as fast as it may, so that a smooth step s(t) keeps both limits between the points, too.
    farthest = np.abs(way).max()
    duration_s = 2 * max(
        1.5 * farthest / limits["max_velocity"],
        math.sqrt(6 * farthest / limits["max_acceleration"]),
    )
    times = np.append(np.arange(0.0, duration_s, 0.1), duration_s)
    u = times / duration_s
    share, slope = 3 * u**2 - 2 * u**3, (6 * u - 6 * u**2) / duration_s
    points = [
        JointTrajectoryPoint(
            positions=(s * way + states["upright"]).tolist(),
            velocities=(v * way).tolist(),
            time_from_start=Duration(sec=int(t), nanosec=round(t % 1 * 1e9)),
        )
        for t, s, v in zip(times, share, slope, strict=True)
    ]
    driver = subprocess.Popen(
        [sys.executable, "-m", "epos2_ros", "driver", "--ros-args"]
        + ["--params-file", str(ROOT / "config" / "arm.yaml")]
        + ["-r", f"~/follow_joint_trajectory:={ACTION}"],
        env=ros_env,
    )
    context = Context()
    rclpy.init(args=[], context=context, domain_id=ros_domain_id)
    node, executor = Node("move_group", context=context), SingleThreadedExecutor(context=context)
    executor.add_node(node)
    try:
        action = ActionClient(node, FollowJointTrajectory, ACTION)
        assert action.wait_for_server(60.0)
        trajectory = JointTrajectory(joint_names=list(AXES), points=points)
        goal = FollowJointTrajectory.Goal(trajectory=trajectory)
        for _ in range(600):  # until the driver has activated itself
            answer = action.send_goal_async(goal)
            executor.spin_until_future_complete(answer, 10.0)
            if answer.result().accepted:
                break
            executor.spin_once(0.1)
        result = answer.result().get_result_async()
        executor.spin_until_future_complete(result, 60.0)
        assert result.result().result.error_string == ""
        assert result.result().result.error_code == FollowJointTrajectory.Result.SUCCESSFUL
    finally:
        driver.terminate()
        assert driver.wait(30.0) == 0
        executor.shutdown()
        node.destroy_node()
        context.shutdown()
