"""The driver node with a parameter file: `ros2 launch epos2_ros driver.launch.py`."""

from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import LifecycleNode
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    simulation = PathJoinSubstitution([FindPackageShare("epos2_ros"), "config", "simulation.yaml"])
    arguments = [
        DeclareLaunchArgument(
            "params_file",
            default_value=simulation,
            description="parameters of the driver (default: simulated drives)",
        ),
        DeclareLaunchArgument("namespace", default_value="", description="of the node"),
        DeclareLaunchArgument("name", default_value="epos2_driver", description="of the node"),
        DeclareLaunchArgument(
            "use_sim_time",
            default_value="false",
            choices=["true", "false"],
            description="true: stamps are times of /clock, whatever the parameter file says",
        ),
        DeclareLaunchArgument(
            "log_level", default_value="info", description="debug, info, warn, error or fatal"
        ),
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=_driver)])


def _driver(context: LaunchContext) -> list[LifecycleNode]:
    """The node, which configures and activates itself: parameter `autostart`."""

    def given(argument: str) -> str:
        return str(LaunchConfiguration(argument).perform(context))

    params_file = given("params_file")
    if not Path(params_file).is_file():  # launch_ros would only warn, and the driver simulate
        raise FileNotFoundError(f"params_file: there is no file {params_file}")
    # Of the driver alone: ROS itself has some thousand lines a second at debug level.
    logger = f"{given('namespace')}/{given('name')}".strip("/").replace("/", ".")
    use_sim_time = [{"use_sim_time": True}] if given("use_sim_time") == "true" else []
    return [
        LifecycleNode(
            package="epos2_ros",
            executable="driver",
            name=given("name"),
            namespace=given("namespace"),
            parameters=[params_file, *use_sim_time],
            ros_arguments=["--log-level", f"{logger}:={given('log_level')}"],
            output="screen",
        )
    ]
