"""MoveIt on the simulated arm of config/arm.yaml: `ros2 launch epos2_ros moveit.launch.py`.

docs/moveit.md says what to do then.
"""

from pathlib import Path
from typing import Any

import yaml
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode, Node
from launch_ros.parameter_descriptions import ParameterValue

HERE = Path(__file__).resolve().parent  # beside it is all that MoveIt has to know


def text(name: str) -> ParameterValue:
    """A file as it stands, for a parameter."""
    return ParameterValue((HERE / name).read_text(), value_type=str)


def parameters(name: str) -> dict[str, Any]:
    """What a YAML file says."""
    return dict(yaml.safe_load((HERE / name).read_text()))


def generate_launch_description() -> LaunchDescription:
    description = {"robot_description": text("arm.urdf")}
    model = {
        **description,
        "robot_description_semantic": text("arm.srdf"),
        "robot_description_kinematics": parameters("kinematics.yaml"),
        "robot_description_planning": parameters("joint_limits.yaml"),
    }
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "params_file",
                default_value=str(HERE.parent.parent / "config" / "arm.yaml"),
                description="parameters of the driver (default: simulated drives)",
            ),
            DeclareLaunchArgument("rviz", default_value="true", description="start RViz"),
            DeclareLaunchArgument("servo", default_value="false", description="start MoveIt Servo"),
            LifecycleNode(  # configures and activates itself: parameter `autostart`
                package="epos2_ros",
                executable="driver",
                name="epos2_driver",
                namespace="",
                parameters=[LaunchConfiguration("params_file")],
                # where moveit_controllers.yaml lets MoveIt look for it
                remappings=[
                    ("~/follow_joint_trajectory", "/arm_controller/follow_joint_trajectory")
                ],
                output="screen",
            ),
            Node(
                package="robot_state_publisher",
                executable="robot_state_publisher",
                parameters=[description],
                output="log",
            ),
            Node(
                package="moveit_ros_move_group",
                executable="move_group",
                parameters=[
                    model,
                    parameters("planning.yaml"),
                    parameters("moveit_controllers.yaml"),
                ],
                output="screen",
            ),
            Node(
                package="rviz2",
                executable="rviz2",
                arguments=["-d", str(HERE / "moveit.rviz")],
                parameters=[model],
                condition=IfCondition(LaunchConfiguration("rviz")),
                output="log",
            ),
            Node(
                package="moveit_servo",
                executable="servo_node",
                name="servo_node",
                parameters=[model, parameters("servo.yaml")],
                condition=IfCondition(LaunchConfiguration("servo")),
                output="screen",
            ),
        ]
    )
