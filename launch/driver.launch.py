"""The driver node with a parameter file: `ros2 launch epos2_ros driver.launch.py`."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import LifecycleNode
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    simulation = PathJoinSubstitution([FindPackageShare("epos2_ros"), "config", "simulation.yaml"])
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "params_file",
                default_value=simulation,
                description="parameters of the driver (default: simulated drives)",
            ),
            LifecycleNode(  # configures and activates itself: parameter `autostart`
                package="epos2_ros",
                executable="driver",
                name="epos2_driver",
                namespace="",
                parameters=[LaunchConfiguration("params_file")],
                output="screen",
            ),
        ]
    )
