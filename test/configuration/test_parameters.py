"""Parameters: their declaration, what they make, and the line a wrong one gets."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from math import inf, isfinite, nan
from pathlib import Path
from typing import Any

import pytest
import rclpy
import yaml
from rcl_interfaces.msg import ParameterType
from rclpy.context import Context
from rclpy.node import Node
from rclpy.parameter import Parameter
from shipped import PARAMETER_FILES

from epos2_ros.configuration.driver import AxisConfig, ClockLimits, DriverConfig, HomingConfig
from epos2_ros.configuration.files import read_parameters
from epos2_ros.configuration.parameters import DriverParameters
from epos2_ros.errors import ConfigurationError
from epos2_ros.node.parameters import Parameters


class Made:
    def __init__(self, node: Node) -> None:
        self.node = node
        self.unconfigured = True
        self.parameters = Parameters(node, lambda: self.unconfigured)

    def set(self, name: str, value: Any) -> str:
        """What `ros2 param set` answers: "" or the reason."""
        return self.node.set_parameters([Parameter(name, value=value)])[0].reason


@pytest.fixture
def make() -> Iterator[Callable[..., Made]]:
    context = Context()
    rclpy.init(args=[], context=context)
    nodes: list[Node] = []

    def build(overrides: dict[str, Any] | None = None, file: Path | None = None) -> Made:
        given = [
            Parameter(n, Parameter.Type.NOT_SET) if v is None else Parameter(n, value=v)
            for n, v in (overrides or {}).items()
        ]
        cli = ["--ros-args", "--params-file", str(file)] if file else []
        node = Node("epos2_driver", context=context, parameter_overrides=given, cli_args=cli)
        nodes.append(node)
        return Made(node)

    yield build
    for node in nodes:
        node.destroy_node()
    context.shutdown()


def camera(kind: str, **parameters: Any) -> dict[str, Any]:
    """Parameters of an output."""
    given = {"joint": "joint_1", "kind": kind, **parameters}
    return {
        "outputs": ["camera"],
        **{f"compare.camera.{name}": value for name, value in given.items()},
    }


def refusal(made: Made) -> str:
    with pytest.raises(ConfigurationError) as caught:
        made.parameters.config()
    line = str(caught.value)
    assert "\n" not in line
    return line


def test_without_parameters_six_simulated_axes(make):
    assert make().parameters.config() == DriverConfig(
        axes=tuple(AxisConfig(joint=f"joint_{n}", node_id=n) for n in range(1, 7))
    )


def test_every_value_arrives(make):
    config = make(
        {
            "can.interface": "socketcan",
            "can.channel": "can0",
            "can.bitrate": 500_000,
            "joints": ["x", "arm"],
            "sync.period": 0.05,
            "sync.source": "arm",
            "sync.offset_warning": 50.0,
            "sync.offset_error": 500.0,
            "sync.drift_warning": 150.0,
            "sync.drift_error": 300.0,
            "ipm.buffer_time": 0.25,
            "ipm.tolerance": 2.0,
            "constraints.start_tolerance": 0.002,
            "constraints.goal_time": 0.5,
            "constraints.x.trajectory": 0.01,
            "constraints.x.goal": 0.001,
            "allow_partial_joints_goal": True,
            "state_rate": 100.0,
            "log.file": "/var/log/arm.asc",
            "log.size": 250,
            "axes.x.node_id": 11,
            "axes.x.type": "prismatic",
            "axes.x.counts_per_turn": 4096,
            "axes.x.gear_ratio": 4.8,
            "axes.x.lead": 0.01,
            "axes.x.direction": -1,
            "axes.x.offset": 0.5,
            "axes.x.velocity_notation": -3,
            "axes.x.min_position": -0.1,
            "axes.x.max_position": 0.9,
            "axes.x.max_velocity": 0.2,
            "axes.x.max_acceleration": 1.5,
            "axes.x.stop_deceleration": 3.0,
            "axes.x.max_following_error": 500,
            "axes.x.homing.method": "negative_limit_switch",
            "axes.x.homing.speeds": [0.02, 0.005],
            "axes.x.homing.acceleration": 0.3,
            "axes.x.homing.offset": 0.01,
            "axes.x.homing.order": 2,
        }
    ).parameters.config()
    x = AxisConfig(
        joint="x",
        node_id=11,
        type="prismatic",
        counts_per_turn=4096,
        gear_ratio=4.8,
        lead=0.01,
        direction=-1,
        offset=0.5,
        velocity_notation=-3,
        min_position=-0.1,
        max_position=0.9,
        max_velocity=0.2,
        max_acceleration=1.5,
        stop_deceleration=3.0,
        max_following_error=500,
        homing=HomingConfig(
            "negative_limit_switch", (0.02, 0.005), 0.3, 0.01, order=2
        ),
        path_tolerance=0.01,
        goal_tolerance=0.001,
    )
    assert config == DriverConfig(
        axes=(x, AxisConfig(joint="arm", node_id=2)),
        interface="socketcan",
        channel="can0",
        bitrate=500_000,
        simulate=False,  # a real interface: nothing is simulated unless asked for
        sync_period=0.05,
        sync_source="arm",
        clock_limits=ClockLimits(50.0, 500.0, 150.0, 300.0),
        buffer_time=0.25,
        tolerance=2.0,
        start_tolerance=0.002,
        goal_time=0.5,
        allow_partial_joints_goal=True,
        state_rate=100.0,
        log_file="/var/log/arm.asc",
        log_size=250.0,
    )


def test_simulation_can_be_asked_for_on_a_real_interface(make):
    assert make({"can.interface": "socketcan", "simulate": True}).parameters.config().simulate


def test_whole_numbers_do_where_numbers_are_asked_for(make):
    config = make(
        {
            "axes.joint_1.gear_ratio": 100,
            "axes.joint_1.homing.speeds": [1, 2],
            "axes.joint_1.homing.method": "here",
        }
    ).parameters.config()
    assert config.axes[0].gear_ratio == 100.0
    assert config.axes[0].homing == HomingConfig("here", (1.0, 2.0))


@pytest.mark.parametrize(
    ("overrides", "says"),
    [
        ({"axes.joint_1.node_id": 128}, ["axes.joint_1.node_id", "128", "1 to 127"]),
        ({"axes.joint_1.node_id": 0}, ["axes.joint_1.node_id", "0", "1 to 127"]),
        ({"axes.joint_2.node_id": 5}, ["node_id", "5", "joint_2, joint_5"]),
        ({"axes.joint_1.node_id": "one"}, ["axes.joint_1.node_id", "'one'", "1 to 127"]),
        ({"axes.joint_3.gear_ratio": -1.0}, ["axes.joint_3.gear_ratio", "-1.0", "1e-06"]),
        ({"axes.joint_3.gear_ratio": nan}, ["axes.joint_3.gear_ratio", "nan"]),
        ({"axes.joint_3.gear_ratio": inf}, ["axes.joint_3.gear_ratio", "inf"]),
        ({"axes.joint_3.gear_ratio": True}, ["axes.joint_3.gear_ratio", "true"]),
        ({"axes.joint_1.direction": 2}, ["axes.joint_1.direction", "2", "1 or -1"]),
        ({"axes.joint_1.velocity_notation": 1}, ["velocity_notation", "0, -1, -2 or -3"]),
        ({"axes.joint_1.type": "linear"}, ["axes.joint_1.type", "'linear'", "prismatic"]),
        ({"axes.joint_1.type": "prismatic"}, ["axes.joint_1.lead", "0", "prismatic"]),
        ({"axes.joint_1.drive": "epos4"}, ["axes.joint_1.drive", "'epos4'", "epos2"]),
        (
            {"axes.joint_1.min_position": 2.0, "axes.joint_1.max_position": 1.0},
            ["axes.joint_1.min_position", "2", "max_position, 1"],
        ),
        ({"axes.joint_1.max_velocity": 0.0}, ["axes.joint_1.max_velocity", "0.0"]),
        ({"axes.joint_1.homing.speeds": [0.1]}, ["homing.speeds", "[0.1]", "2 numbers"]),
        ({"joints": None}, ["joints", "[]", "1 to 127 names"]),
        ({"joints": [""]}, ["joints", "['']", "1 to 127 names"]),
        ({"joints": ["a", "b", "a"]}, ["joints", "['a', 'b', 'a']", "once"]),
        ({"joints": "a"}, ["joints", "'a'", "list"]),
        ({"can.bitrate": 1}, ["can.bitrate", "1000000"]),
        ({"can.channel": 0}, ["can.channel", "0", "text"]),
        ({"sync.source": "joint_9"}, ["sync.source", "'joint_9'", "host, joint_1"]),
        ({"sync.producer": "joint_9"}, ["sync.producer", "'joint_9'", "host, joint_1"]),
        (
            {"joints": ["a", "b"], "axes.b.drive": "copley", "sync.source": "b"},
            ["sync.source is 'b'", "must be one of host, a"],
        ),
        ({"sync.period": 0.0}, ["sync.period", "0.0", "0.005"]),
        ({"ipm.tolerance": 0.1}, ["ipm.tolerance", "0.1", "0.5"]),
        ({"state_rate": 0}, ["state_rate", "0", "0.1"]),
        # an output's numbers are finite; inf alone is "not set"
        (
            camera("series", positions=[0.1, inf, 0.3]),
            ["compare.camera.positions", "[0.1, inf, 0.3]", "finite"],
        ),
        (camera("window", window=[0.1, inf]), ["compare.camera.window", "[0.1, inf]", "finite"]),
        (camera("window"), ["compare.camera.window", "not set"]),
        (
            camera("interval", start=0.0, interval=0.1, end=-inf),
            ["compare.camera.end", "-inf", "finite"],
        ),
        ({"outputs": 5}, ["outputs is 5", "names"]),
        ({"outputs": [True]}, ["outputs is [True]", "a bare y, n, on or off is a boolean"]),
        ({"can.channel": False}, ["can.channel is false", "text", "put it in quotes"]),
        # what is not there at all
        ({"ipm.tolerence": 1.0}, ["ipm.tolerence", "1.0", "ipm.tolerance?"]),
        ({"axes.joint_1.gear_ration": 100.0}, ["gear_ration", "100.0", "joint_1.gear_ratio?"]),
        ({"axes.joint_7.node_id": 7}, ["axes.joint_7.node_id", "7", "joint_1, joint_2"]),
        ({"axis.joint_1.node_id": 7}, ["axis.joint_1.node_id", "axes.joint_1.node_id?"]),
    ],
)
def test_a_wrong_parameter_is_one_line_with_name_value_and_what_is_allowed(make, overrides, says):
    line = refusal(make(overrides))
    for words in says:
        assert words in line


def test_more_axes_than_node_ids_is_refused(make):
    assert "1 to 127 names" in refusal(make({"joints": [f"j{n}" for n in range(128)]}))


def test_a_wrong_value_can_be_put_right_without_a_restart(make):
    made = make({"axes.joint_1.gear_ratio": -1.0})
    refusal(made)
    assert made.set("axes.joint_1.gear_ratio", 50.0) == ""
    assert made.parameters.config().axes[0].gear_ratio == 50.0


def test_setting_is_checked_like_the_file(make):
    made = make()
    assert "1 or -1" in made.set("axes.joint_1.direction", 3)
    assert "127" in made.set("axes.joint_1.node_id", 128)
    assert "nan" in made.set("axes.joint_1.max_velocity", nan)
    assert made.parameters.config() == make().parameters.config()


def test_what_has_no_range_to_show_is_checked_all_the_same(make):
    made = make()
    assert "from 1 to 4294967295" in made.set("axes.joint_1.max_following_error", 2**32)
    assert "at least 1e-09" in made.set("axes.joint_1.max_velocity", 0.0)


def test_nothing_changes_while_configured(make):
    made = make()
    made.unconfigured = False
    assert "unconfigured" in made.set("ipm.tolerance", 2.0)
    assert made.parameters.config().tolerance == 1.0


def test_joints_are_fixed_at_start(make):
    assert "read-only" in make().set("joints", ["a"])


def test_rclpys_own_parameters_are_not_ours_to_refuse(make):
    made = make({"use_sim_time": False})
    made.parameters.config()
    made.unconfigured = False
    assert made.set("use_sim_time", True) == ""


def test_every_parameter_is_declared_with_type_description_and_what_is_allowed(make):
    node = make().node
    names = node.list_parameters([], 0).names
    descriptors = {
        d.name: d
        for d in node.describe_parameters(sorted(names))
        if d.name not in ("use_sim_time", "start_type_description_service")
    }
    for name, descriptor in descriptors.items():
        assert descriptor.type != ParameterType.PARAMETER_NOT_SET, name
        assert descriptor.description, name
        assert descriptor.additional_constraints, name
        for range_ in descriptor.floating_point_range:  # rqt_reconfigure stops at an infinite one
            assert isfinite(range_.from_value) and isfinite(range_.to_value), name
        for whole in descriptor.integer_range:  # and at one that Qt's slider can't hold
            assert -(2**31) <= whole.from_value < whole.to_value < 2**31, name
    assert descriptors["sync.period"].floating_point_range[0].to_value == 1.0
    assert descriptors["outputs"].type == ParameterType.PARAMETER_STRING_ARRAY
    assert descriptors["outputs"].read_only
    assert descriptors["axes.joint_1.node_id"].integer_range[0].to_value == 127
    assert node.get_parameter("outputs").value == []
    # `ros2 param dump` reads all values at once, and gets none if one of them is not set
    assert all(p.type_ != Parameter.Type.NOT_SET for p in node.get_parameters(list(descriptors)))


@pytest.mark.parametrize("file", PARAMETER_FILES, ids=lambda file: file.stem)
def test_the_shipped_parameter_files_are_valid(make, file):
    made = make(file=file)
    config = made.parameters.config()
    assert made.node.get_parameters_by_prefix("axes")
    assert config.simulate == (config.interface == "virtual")


@pytest.mark.parametrize("file", PARAMETER_FILES, ids=lambda file: file.stem)
def test_what_ros2_param_dump_writes_makes_the_same_driver_and_plan(make, file, tmp_path):
    """It writes all values, nested by the dots, under the node's full name."""
    made = make(file=file)
    names = made.node.list_parameters([], 0).names
    values = {p.name: p.value for p in made.node.get_parameters(names)}
    section: dict[str, Any] = {}
    for name, value in values.items():
        *parents, last = name.split(".")
        place = section
        for parent in parents:
            place = place.setdefault(parent, {})
        place[last] = value if isinstance(value, (str, int, float)) else list(value)
    dumped = tmp_path / "dumped.yaml"
    dumped.write_text(yaml.dump({"/epos2_driver": {"ros__parameters": section}}))
    again = make(file=dumped).parameters.config()
    assert again == made.parameters.config() == DriverParameters(read_parameters(dumped)).config()


@pytest.mark.parametrize(
    "name",
    ["shoulder_pan_joint", "left-arm/elbow", "panda.joint1", "Joint1", "6_axis"],
)
def test_joints_are_named_as_robots_name_them(make, name):
    axis = make({"joints": [name], f"axes.{name}.node_id": 3}).parameters.config().axes[0]
    assert (axis.joint, axis.node_id) == (name, 3)


@pytest.mark.parametrize("name", ["", " ", "a b", "a:=b", "é", "/a", "a\nb", "{a}"])
def test_a_joint_that_can_be_no_part_of_a_parameter_is_refused(make, name):
    line = refusal(make({"joints": ["ok", name]}))
    assert line.endswith("a list of 1 to 127 names of letters, digits, _, -, . and /, each once")


def test_there_are_parameter_files_for_simulation_and_real_hardware():
    assert {"simulation.yaml", "can0.yaml"} <= {file.name for file in PARAMETER_FILES}
