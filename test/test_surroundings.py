"""The programs where nothing can be kept: no home, no writable installation, a service's user."""

from __future__ import annotations

import configparser
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from driver_program import Program
from driver_program import program as program  # a fixture

from epos2_ros import surroundings
from epos2_ros.configuration.parameters import GROUP

ROOT = Path(__file__).resolve().parent.parent
UNIT = ROOT / "examples" / "epos2_ros.service"
NOWHERE = "/dev/null/nowhere"  # nobody can make a folder there, not even root


@pytest.fixture
def sealed(tmp_path: Path) -> Path:
    """A copy of the package in which nothing compiled can be kept."""
    ignore = shutil.ignore_patterns("__pycache__")
    copy = shutil.copytree(ROOT / "epos2_ros", tmp_path / "epos2_ros", ignore=ignore)
    (copy / "motion" / "__pycache__").touch()  # where the folder would be
    return tmp_path


@pytest.mark.parametrize("given", [{}, {"NUMBA_CACHE_DIR": NOWHERE}])
def test_without_a_writable_folder_it_is_compiled_at_every_start_and_said(
    sealed: Path, ros_env: dict[str, str], given: dict[str, str]
) -> None:
    script = "from epos2_ros import surroundings; print(*surroundings.compiling())"
    env = ros_env | {"PYTHONPATH": str(sealed), "HOME": NOWHERE, "XDG_CACHE_HOME": NOWHERE} | given
    said = subprocess.check_output([sys.executable, "-c", script], env=env, text=True, cwd=sealed)
    assert said.startswith("True compiling the fitter, some 15 s at every start: ")
    assert "NUMBA_CACHE_DIR" in said


def test_what_is_compiled_can_be_kept_elsewhere(
    sealed: Path, ros_env: dict[str, str], tmp_path: Path
) -> None:
    script = "from epos2_ros.motion import knots; print(knots.kept_in(), knots.compiled_before())"
    env = ros_env | {"PYTHONPATH": str(sealed), "HOME": NOWHERE, "XDG_CACHE_HOME": NOWHERE}
    env["NUMBA_CACHE_DIR"] = str(tmp_path / "cache")
    said = subprocess.check_output([sys.executable, "-c", script], env=env, text=True, cwd=sealed)
    folder, _, before = said.strip().rpartition(" ")
    assert Path(folder).is_relative_to(tmp_path / "cache")
    assert before == "False"


def test_without_a_home_the_driver_runs_without_log_file_and_says_so(
    ros_env: dict[str, str], program: Callable[..., Program]
) -> None:
    for name in ("ROS_LOG_DIR", "ROS_HOME"):
        ros_env.pop(name, None)
    ros_env["HOME"] = NOWHERE
    driver = program()
    driver.read_until(f"no log file: {NOWHERE}/.ros/log can't be written; set ROS_LOG_DIR")
    driver.read_until("active: ")
    assert driver.end(signal.SIGTERM) == 0


def test_the_log_folder_is_where_ros_has_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", "/home/me")
    monkeypatch.delenv("ROS_HOME", raising=False)
    monkeypatch.delenv("ROS_LOG_DIR", raising=False)
    assert surroundings.log_folder() == Path("/home/me/.ros/log")
    monkeypatch.setenv("ROS_HOME", "~/ros")
    assert surroundings.log_folder() == Path("/home/me/ros/log")
    monkeypatch.setenv("ROS_LOG_DIR", "/var/log/ros")
    assert surroundings.log_folder() == Path("/var/log/ros")


def test_the_unit_runs_the_driver_as_a_user_of_its_own_and_lets_it_stop() -> None:
    unit = configparser.ConfigParser(strict=False, interpolation=None)
    unit.optionxform = str  # type: ignore[assignment, method-assign]
    unit.read(UNIT)
    service = unit["Service"]
    assert service["User"] not in ("", "root")
    assert "lib/epos2_ros/driver --ros-args --params-file" in service["ExecStart"]
    assert os.access(ROOT / "scripts" / "driver", os.X_OK)
    assert (service["KillSignal"], service["Restart"]) == ("SIGTERM", "on-failure")
    assert service["RestartPreventExitStatus"] == "2"
    assert int(service["LimitRTPRIO"]) >= GROUP["realtime.priority"].default
    assert service["LimitMEMLOCK"] == "infinity"
    assert "RestrictRealtime" not in service
    assert service["CacheDirectory"] in service_environment("NUMBA_CACHE_DIR")
    assert service["LogsDirectory"] in service_environment("ROS_LOG_DIR")


def service_environment(name: str) -> str:
    words = UNIT.read_text().replace("Environment=", " ").split()
    (value,) = (word.partition("=")[2] for word in words if word.startswith(f"{name}="))
    return value


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="needs systemd-analyze")
def test_systemd_finds_nothing_wrong_with_the_unit(tmp_path: Path) -> None:
    copy = tmp_path / UNIT.name  # without the user, who need not exist here
    copy.write_text(UNIT.read_text().replace("User=epos2", "User=root"))
    ended = subprocess.run(["systemd-analyze", "verify", copy], capture_output=True, text=True)
    assert not [line for line in ended.stderr.splitlines() if UNIT.name in line], ended.stderr
