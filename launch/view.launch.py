"""What there is to see of a driver that runs: `ros2 launch epos2_ros view.launch.py`.

Each tool is started if it is installed: robot_state_publisher and RViz (with a `model`), the
aggregator of diagnostics, PlotJuggler with a layout. docs/pictures.md says more.
"""

import atexit
import shutil
import tempfile
import xml.etree.ElementTree as ElementTree
from pathlib import Path

from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, LogInfo, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from epos2_ros.configuration.files import share
from epos2_ros.layout import aggregator, plotjuggler
from epos2_ros.layout.program import read
from epos2_ros.layout.tabs import tabs_of


def generate_launch_description() -> LaunchDescription:
    arguments = [
        DeclareLaunchArgument(
            "params_file",
            default_value=str(share() / "config" / "simulation.yaml"),
            description="parameters of the driver, whose joints and outputs are shown",
        ),
        DeclareLaunchArgument(
            "node", default_value="", description="full name of the driver, if not in params_file"
        ),
        DeclareLaunchArgument(
            "model", default_value="", description="URDF of the robot; empty: no RViz"
        ),
        *(
            DeclareLaunchArgument(
                name,
                default_value="true",
                choices=["true", "false"],
                description=f"start {what}, if it is installed",
            )
            for name, what in (
                ("rviz", "RViz"),
                ("aggregator", "diagnostic_aggregator"),
                ("plotjuggler", "PlotJuggler"),
            )
        ),
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=_views)])


def _views(context: LaunchContext) -> list[Node | LogInfo]:
    def given(argument: str) -> str:
        return str(LaunchConfiguration(argument).perform(context))

    config, names = read(Path(given("params_file")), given("node") or None)
    folder = Path(tempfile.mkdtemp(prefix="epos2_ros_view_"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    views: list[Node | LogInfo] = []

    def start(package: str, executable: str, needs: str = "", **settings: object) -> None:
        needs = needs or package
        try:
            get_package_prefix(needs)
        except PackageNotFoundError:
            apt = f"sudo apt install ros-jazzy-{needs.replace('_', '-')}"
            views.append(LogInfo(msg=f"not started: {needs} is not installed ({apt})"))
        else:
            settings = {"output": "log", **settings}
            views.append(Node(package=package, executable=executable, **settings))

    if given("model"):
        text = Path(given("model")).read_text(encoding="utf-8")
        model = ElementTree.fromstring(text)
        moved = {joint.get("name") for joint in model.iter("joint")}
        if missing := [axis.joint for axis in config.axes if axis.joint not in moved]:
            views.append(LogInfo(msg=f"the model has no joints {', '.join(missing)}"))
        start(
            "robot_state_publisher",
            "robot_state_publisher",
            namespace=names.namespace,
            parameters=[{"robot_description": ParameterValue(text, value_type=str)}],
        )
        if given("rviz") == "true":
            settings = ["-d", str(share() / "config" / "view.rviz"), "-f", _root(model)]
            start("rviz2", "rviz2", namespace=names.namespace, arguments=settings)
    else:
        views.append(LogInfo(msg="no RViz without model:=ROBOT.urdf"))
    if given("aggregator") == "true":
        analyzers = folder / "diagnostics.yaml"
        analyzers.write_text(aggregator.file(config, names), encoding="utf-8")
        start("diagnostic_aggregator", "aggregator_node", parameters=[str(analyzers)])
    if given("plotjuggler") == "true":
        layout = folder / "layout.xml"
        layout.write_text(plotjuggler.layout(tabs_of(config, names)), encoding="utf-8")
        arguments = ["--layout", str(layout)]
        start("plotjuggler", "plotjuggler", "plotjuggler_ros", arguments=arguments)
    return views


def _root(model: ElementTree.Element) -> str:
    """The link that is no other's child."""
    children = {child.get("link") for child in model.iterfind("joint/child")}
    return next(
        link.get("name", "") for link in model.iterfind("link") if link.get("name") not in children
    )
