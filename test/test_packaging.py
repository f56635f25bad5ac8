"""The package as its users install it: with pip, and with colcon in a workspace."""

from __future__ import annotations

import ast
import os
import runpy
import shutil
import signal
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from ament_index_python.packages import get_package_prefix, get_package_share_directory

from epos2_ros import __main__ as command

ROOT = Path(__file__).resolve().parent.parent
PROGRAMS = {
    "driver", "simulator", "scan", "check", "drive", "replay", "plan", "monitor", "layout", "demo",
}  # fmt: skip
TIMEOUT_S = 100
INSTALLED = Path(sys.executable).parent / "epos2_ros"
INSTALLED_BEFORE = INSTALLED.exists()


def run(*arguments: str | Path, **options: object) -> str:
    """Standard output of a command that succeeds."""
    ended = subprocess.run(
        [str(argument) for argument in arguments],
        text=True,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        timeout=TIMEOUT_S,
        **options,  # type: ignore[call-overload]
    )
    assert ended.returncode == 0, f"{arguments}: {ended.returncode}\n{ended.stdout}{ended.stderr}"
    return str(ended.stdout)


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the checkout, so that builds leave nothing in it."""
    copy = tmp_path_factory.mktemp("workspace") / "src" / "epos2_ros"
    unwanted = shutil.ignore_patterns(".*", "build", "install", "log", "test", "docs", "*.egg-info")
    return Path(shutil.copytree(ROOT, copy, symlinks=True, ignore=unwanted))


@pytest.fixture(scope="module")
def pip_prefix(source: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    prefix = tmp_path_factory.mktemp("pip")
    # Without --ignore-installed pip would remove the package from the environment of the tests.
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation"]
    run(*pip, "--ignore-installed", "--prefix", prefix, source)
    return prefix


@pytest.fixture(scope="module")
def colcon_prefix(source: Path) -> Path:
    workspace = source.parent.parent
    colcon = shutil.which("colcon", path=f"{Path(sys.executable).parent}{os.pathsep}{os.defpath}")
    assert colcon, "colcon is not installed: pip install colcon-common-extensions"
    run(colcon, "build", cwd=workspace)
    return workspace / "install" / "epos2_ros"


@pytest.fixture(params=["pip", "colcon"])
def prefix(request: pytest.FixtureRequest) -> Path:
    found: Path = request.getfixturevalue(f"{request.param}_prefix")
    return found


@pytest.fixture
def outside_env(ros_env: dict[str, str]) -> dict[str, str]:
    """Environment in which ROS is found and the checkout is not."""
    others = [path for path in ros_env["PYTHONPATH"].split(os.pathsep) if path != str(ROOT)]
    return ros_env | {"PYTHONPATH": os.pathsep.join(others)}


@pytest.fixture
def installed_env(prefix: Path, outside_env: dict[str, str]) -> dict[str, str]:
    """Environment in which `prefix` is sourced."""
    (site_packages,) = prefix.glob("lib/python*/site-packages")
    return outside_env | {
        name: f"{path}{os.pathsep}{outside_env[name]}"
        for name, path in (("PYTHONPATH", site_packages), ("AMENT_PREFIX_PATH", prefix))
    }


def test_ament_index_and_ros2_run_find_the_package(
    prefix: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(prefix))
    assert get_package_prefix("epos2_ros") == str(prefix)
    # `ros2 run` and `ros2 pkg executables` take the executable files below lib/<package>
    executables = {
        path.name for path in (prefix / "lib" / "epos2_ros").iterdir() if os.access(path, os.X_OK)
    }
    assert executables == PROGRAMS
    assert os.access(prefix / "bin" / "epos2_ros", os.X_OK)
    share = Path(get_package_share_directory("epos2_ros"))
    for folder, pattern in (
        ("config", "*.yaml"),
        ("config", "*.rviz"),
        ("examples", "*.yaml"),
        ("examples", "*.service"),
        ("launch", "*.launch.py"),
    ):
        ours = {path.name for path in (ROOT / folder).glob(pattern)}
        assert ours and {path.name for path in (share / folder).glob(pattern)} == ours
    assert (share / "package.xml").exists()


def test_installing_elsewhere_leaves_the_environment_as_it_was(
    pip_prefix: Path, tmp_path: Path
) -> None:
    """`.venv/bin/epos2_ros`, which the README names, is still there after the tests."""
    if INSTALLED_BEFORE:
        assert INSTALLED.exists()
        assert "epos2_ros" in run(sys.executable, "-m", "pip", "show", "epos2_ros", cwd=tmp_path)


@pytest.mark.parametrize("program", sorted(PROGRAMS))
def test_installed_program_starts(
    prefix: Path, installed_env: dict[str, str], tmp_path: Path, program: str
) -> None:
    executable = prefix / "lib" / "epos2_ros" / program
    usage = run(executable, "--help", env=installed_env, cwd=tmp_path)
    assert usage.startswith(f"usage: epos2_ros {program} [-h]")


def test_package_data_is_installed_and_imported_from_there(
    prefix: Path, installed_env: dict[str, str], tmp_path: Path
) -> None:
    where = "from importlib.resources import files; print(files('epos2_ros') / 'eds/epos2.eds')"
    eds = Path(run(sys.executable, "-c", where, env=installed_env, cwd=tmp_path).strip())
    assert eds.is_relative_to(prefix) and eds.exists()


@pytest.fixture
def start() -> Iterator[Callable[..., subprocess.Popen[str]]]:
    started: list[subprocess.Popen[str]] = []

    def start(*arguments: str, **options: object) -> subprocess.Popen[str]:
        started.append(subprocess.Popen(arguments, text=True, **options))  # type: ignore
        return started[-1]

    yield start
    for process in started:
        process.kill()
        process.wait()


def test_driver_built_with_colcon_runs_and_ends_on_ctrl_c(
    colcon_prefix: Path,
    outside_env: dict[str, str],
    tmp_path: Path,
    start: Callable[..., subprocess.Popen[str]],
) -> None:
    setup = colcon_prefix.parent / "local_setup.bash"
    driver = colcon_prefix / "lib" / "epos2_ros" / "driver"
    node = start("bash", "-c", f"source {setup} && exec {driver}", env=outside_env, cwd=tmp_path)
    run(sys.executable, "-c", WAIT_FOR_JOINT_STATES, env=outside_env)
    node.send_signal(signal.SIGINT)
    assert node.wait(TIMEOUT_S) == 0


WAIT_FOR_JOINT_STATES = f"""
import rclpy
from sensor_msgs.msg import JointState

rclpy.init()
node = rclpy.create_node("waiting")
arrived = rclpy.task.Future()
node.create_subscription(JointState, "joint_states", arrived.set_result, 10)
rclpy.spin_until_future_complete(node, arrived, timeout_sec={TIMEOUT_S - 10})
assert arrived.done(), "no joint states"
assert arrived.result().name == [f"joint_{{n}}" for n in range(1, 7)]
"""


class Told:
    """Stands in for what `launch` and `launch_ros` have: it is called, and keeps with what."""

    def __init__(self, *positional: Any, **named: Any) -> None:
        self.positional, self.named = positional, named


class Chosen(Told):
    """LaunchConfiguration: the context says what it is."""

    def perform(self, context: dict[str, str]) -> str:
        return context[self.positional[0]]


class Info(Told):
    """LogInfo."""


@pytest.fixture
def describe(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], Any]:
    """What a launch file describes, to a `launch` that only listens (it is on no index)."""
    actions = ("DeclareLaunchArgument", "OpaqueFunction")
    parts = {
        "launch": {"LaunchContext": dict, "LaunchDescription": Told},
        "launch.actions": {**dict.fromkeys(actions, Told), "LogInfo": Info},
        "launch.substitutions": {"LaunchConfiguration": Chosen, "PathJoinSubstitution": Told},
        "launch_ros.actions": {"LifecycleNode": Told, "Node": Told},
        "launch_ros.parameter_descriptions": {"ParameterValue": Told},
        "launch_ros.substitutions": {"FindPackageShare": Told},
    }
    monkeypatch.setitem(sys.modules, "launch_ros", SimpleNamespace())
    for name, members in parts.items():
        monkeypatch.setitem(sys.modules, name, SimpleNamespace(**members))

    def describe(file: str) -> Any:
        launch_file = runpy.run_path(str(ROOT / "launch" / file))
        return launch_file["generate_launch_description"]()

    return describe


@pytest.fixture
def description(describe: Callable[[str], Any]) -> Any:
    return describe("driver.launch.py")


def actions_of(description: Any, **given: str) -> list[Any]:
    """What `ros2 launch` with these arguments does."""
    *arguments, action = description.positional[0]
    defaults = {a.positional[0]: a.named["default_value"] for a in arguments}
    assert given.keys() <= defaults.keys()
    return list(action.named["function"]({**defaults, **given}))


def launched(description: Any, **given: str) -> Any:
    """The one node that it starts."""
    (node,) = actions_of(description, **given)
    return node


def test_launch_arguments_reach_the_node(description: Any) -> None:
    arguments = {argument.positional[0] for argument in description.positional[0][:-1]}
    assert arguments == {"params_file", "namespace", "name", "use_sim_time", "log_level"}
    file = str(ROOT / "config" / "can0.yaml")
    node = launched(description, params_file=file)
    assert (node.named["name"], node.named["namespace"]) == ("epos2_driver", "")
    assert node.named["parameters"] == [file]
    assert node.named["ros_arguments"] == ["--log-level", "epos2_driver:=info"]
    node = launched(
        description,
        params_file=file,
        namespace="/robot1",
        name="arm",
        use_sim_time="true",
        log_level="debug",
    )
    assert (node.named["name"], node.named["namespace"]) == ("arm", "/robot1")
    assert node.named["parameters"] == [file, {"use_sim_time": True}]
    assert node.named["ros_arguments"] == ["--log-level", "robot1.arm:=debug"]


def test_a_launch_with_a_file_that_is_not_there_is_refused(description: Any) -> None:
    with pytest.raises(FileNotFoundError, match="params_file: there is no file /nonexistent.yaml"):
        launched(description, params_file="/nonexistent.yaml")


VIEWS = ("robot_state_publisher", "rviz2", "diagnostic_aggregator", "plotjuggler_ros")
ARM = {
    "params_file": str(ROOT / "config" / "arm.yaml"),
    "model": str(ROOT / "examples" / "moveit" / "arm.urdf"),
}


def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *packages: str) -> None:
    """These packages and no others, for ament's index."""
    index = tmp_path / "share" / "ament_index" / "resource_index" / "packages"
    index.mkdir(parents=True)
    for package in packages:
        (index / package).touch()
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))


def test_a_view_shows_what_the_driver_has(
    describe: Callable[[str], Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    installed(tmp_path, monkeypatch, *VIEWS)
    made = actions_of(describe("view.launch.py"), **ARM, node="/robot1/epos2_driver")
    publisher, rviz, aggregator, plots = (node.named for node in made)
    (told,) = publisher["parameters"]
    assert told["robot_description"].positional == (Path(ARM["model"]).read_text(),)
    assert publisher["namespace"] == rviz["namespace"] == "/robot1"
    assert rviz["arguments"] == ["-d", str(ROOT / "config" / "view.rviz"), "-f", "base_link"]
    assert aggregator["executable"] == "aggregator_node"
    expected = Path(aggregator["parameters"][0]).read_text()
    assert "robot1/epos2_driver: shoulder_pan_joint" in expected
    option, layout = plots["arguments"]
    assert (plots["executable"], option) == ("plotjuggler", "--layout")
    assert "/robot1/joint_states/wrist_3_joint/position" in Path(layout).read_text()


def test_a_view_says_what_is_not_there(
    describe: Callable[[str], Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    installed(tmp_path, monkeypatch, "diagnostic_aggregator")
    view = describe("view.launch.py")
    no_model, aggregator, plots = actions_of(view)
    assert no_model.named["msg"] == "no RViz without model:=ROBOT.urdf"
    assert aggregator.named["package"] == "diagnostic_aggregator"
    assert plots.named["msg"].endswith("(sudo apt install ros-jazzy-plotjuggler-ros)")
    off = dict.fromkeys(("aggregator", "plotjuggler"), "false")
    other = {**ARM, "params_file": str(ROOT / "config" / "gantry.yaml"), **off}
    joints, *missing = actions_of(view, **other)
    assert joints.named["msg"] == "the model has no joints gantry_x, gantry_y"
    assert [isinstance(action, Info) for action in missing] == [True, True]


class TestManifest:
    """package.xml against setup.py and against what the code imports."""

    manifest = ElementTree.parse(ROOT / "package.xml").getroot()
    # distributions whose rosdep key or import name is not their own name
    ROSDEP_KEYS = {
        "can": "python3-can",
        "canopen": "canopen-pip",
        "matplotlib": "python3-matplotlib",
        "numpy": "python3-numpy",
        "rich": "python3-rich",
        "yaml": "python3-yaml",
    }
    OPTIONAL = {"control_msgs", "numba"}

    def test_is_an_ament_python_package_of_format_3(self) -> None:
        assert self.manifest.get("format") == "3"
        assert self.manifest.findtext("name") == "epos2_ros"
        assert self.manifest.findtext("license") == "Apache-2.0"
        assert self.manifest.findtext("export/build_type") == "ament_python"

    def test_has_the_version_of_setup_py(self) -> None:
        tree = ast.parse((ROOT / "setup.py").read_text())
        (version,) = (
            ast.literal_eval(node.value)
            for node in ast.walk(tree)
            if isinstance(node, ast.keyword) and node.arg == "version"
        )
        assert self.manifest.findtext("version") == version

    def test_names_everything_the_code_imports(self) -> None:
        imported = set()
        for path in [*ROOT.glob("epos2_ros/**/*.py"), *ROOT.glob("launch/*.py")]:
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.Import):
                    imported |= {alias.name.partition(".")[0] for alias in node.names}
                elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                    imported.add(node.module.partition(".")[0])
        third_party = imported - set(sys.stdlib_module_names) - {"epos2_ros"} - self.OPTIONAL
        declared = {element.text for element in self.manifest.findall("exec_depend")}
        assert {self.ROSDEP_KEYS.get(name, name) for name in third_party} <= declared


class TestCommand:
    """`epos2_ros PROGRAM …`"""

    def test_help_names_every_program(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert command.main(["--help"]) == 0
        out = capsys.readouterr().out
        assert all(f"\n  {program} " in out for program in PROGRAMS)

    @pytest.mark.parametrize("arguments", [[], ["drvier"], ["drvier", "--help"]])
    def test_no_such_program_gives_one_line_and_2(
        self, arguments: list[str], capsys: pytest.CaptureFixture[str]
    ) -> None:
        assert command.main(arguments) == 2
        streams = capsys.readouterr()
        assert streams.out == ""
        assert streams.err.count("\n") == 1
        assert all(program in streams.err for program in PROGRAMS)

    def test_program_gets_what_follows_its_name_and_gives_the_status(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        given: list[list[str]] = []

        def main(argv: list[str]) -> int:
            given.append(argv)
            return 7

        monkeypatch.setitem(sys.modules, "epos2_ros.node.driver", SimpleNamespace(main=main))
        arguments = ["--ros-args", "-p", "simulate:=true", "--help"]
        assert command.main(["driver", *arguments]) == 7
        monkeypatch.setattr(sys, "argv", ["epos2_ros", "driver", *arguments])
        assert command.main() == 7
        assert given == [arguments, arguments]

    def test_a_missing_package_gives_one_line_that_says_how_to_get_it(
        self, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        """A colcon workspace that was built before rosdep."""
        monkeypatch.setitem(sys.modules, "canopen", None)
        for name in [name for name in sys.modules if name.startswith("epos2_ros.node")]:
            monkeypatch.delitem(sys.modules, name)
        for name in [name for name in sys.modules if name.startswith("epos2_ros.bus")]:
            monkeypatch.delitem(sys.modules, name)
        assert command.main(["driver"]) == 1
        error = capsys.readouterr().err
        assert error.count("\n") == 1
        assert "Python package canopen is missing" in error and "rosdep install" in error

    def test_missing_ros_gives_one_line_and_1(
        self, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        monkeypatch.setitem(sys.modules, "rclpy", None)
        for name in [name for name in sys.modules if name.startswith("epos2_ros.node")]:
            monkeypatch.delitem(sys.modules, name)
        assert command.main(["driver"]) == 1
        error = capsys.readouterr().err
        assert error.count("\n") == 1 and "ROS 2" in error
