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

import pytest
from ament_index_python.packages import get_package_prefix, get_package_share_directory

from epos2_ros import __main__ as command

ROOT = Path(__file__).resolve().parent.parent
PROGRAMS = {"driver", "simulator", "scan", "check", "drive", "replay", "plan", "demo"}
TIMEOUT_S = 100


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
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation"]
    run(*pip, "--prefix", prefix, source)
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
    assert executables >= PROGRAMS
    share = Path(get_package_share_directory("epos2_ros"))
    for folder, pattern in (
        ("config", "*.yaml"),
        ("examples", "*.yaml"),
        ("launch", "*.launch.py"),
    ):
        ours = {path.name for path in (ROOT / folder).glob(pattern)}
        assert ours and {path.name for path in (share / folder).glob(pattern)} == ours
    assert (share / "package.xml").exists()


@pytest.mark.parametrize("program", sorted(PROGRAMS))
def test_installed_program_starts(
    prefix: Path, installed_env: dict[str, str], tmp_path: Path, program: str
) -> None:
    executable = prefix / "lib" / "epos2_ros" / program
    usage = run(executable, "--help", env=installed_env, cwd=tmp_path)
    assert program in usage.splitlines()[0]


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


def test_launch_file_is_python() -> None:
    path = ROOT / "launch" / "driver.launch.py"
    compile(path.read_text(), path, "exec")


def test_launch_file_makes_a_description() -> None:
    pytest.importorskip("launch_ros", reason="launch_ros comes with a ROS installation only")
    description = runpy.run_path(str(ROOT / "launch" / "driver.launch.py"))
    arguments = description["generate_launch_description"]().get_launch_arguments()
    assert {argument.name for argument in arguments} == {"params_file"}


class TestManifest:
    """package.xml against setup.py and against what the code imports."""

    manifest = ElementTree.parse(ROOT / "package.xml").getroot()
    # distributions whose rosdep key or import name is not their own name
    ROSDEP_KEYS = {
        "can": "python3-can",
        "canopen": "canopen-pip",
        "matplotlib": "python3-matplotlib",
        "numpy": "python3-numpy",
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

    def test_missing_ros_gives_one_line_and_1(
        self, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        monkeypatch.setitem(sys.modules, "rclpy", None)
        for name in [name for name in sys.modules if name.startswith("epos2_ros.node")]:
            monkeypatch.delitem(sys.modules, name)
        assert command.main(["driver"]) == 1
        error = capsys.readouterr().err
        assert error.count("\n") == 1 and "ROS 2" in error
