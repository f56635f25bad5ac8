"""The files that the programs read: trajectories and parameters, and those that are shipped."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from epos2_ros.configuration.parameter_file import ParameterFile
from epos2_ros.errors import Epos2RosError
from epos2_ros.motion.trajectory import Trajectory

DRIVER = "epos2_driver"  # the node's name, if it is not remapped

# The C parser where PyYAML has it (libyaml); the other does the same, slower.
_SafeLoader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


class _Loader(_SafeLoader):
    """Takes 1e-3 and inf for numbers, as ROS does; YAML 1.1 wants 1.0e-3 and .inf."""


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"[-+]?((\d+\.?\d*|\.\d+)[eE][-+]?\d+|inf|nan)$"),
    list("-+.0123456789in"),
)


def read_trajectory(file: Path) -> Trajectory:
    """The one trajectory in a file, with at least one point; Epos2RosError in one line."""
    try:
        with file.open(encoding="utf-8") as lines:
            trajectories = list(read_trajectories(lines, str(file)))
    except OSError as error:
        raise Epos2RosError(f"can't read {file}: {error.strerror}") from error
    if len(trajectories) > 1:
        raise Epos2RosError(f"{file} holds {len(trajectories)} trajectories; give one")
    if not len(trajectories[0].times_s):
        raise Epos2RosError(f"{file} has no points")
    return trajectories[0]


def read_trajectories(lines: Iterable[str], source: str) -> Iterator[Trajectory]:
    """The trajectories in YAML as `ros2 topic pub` takes and `ros2 topic echo` prints it.

    Each comes as soon as the `---` after it was read. Raises TrajectoryError for one that is
    refused, Epos2RosError where `source` is no YAML or empty.
    """
    empty = True
    try:
        for text in _documents(lines):
            message = yaml.load(text, _Loader)
            if message is not None:
                empty = False
                yield _trajectory(message, source)
    except (ValueError, yaml.YAMLError) as error:  # no UTF-8, no YAML, no such date
        raise Epos2RosError(f"can't read {source}: {_one_line(error)}") from error
    except RecursionError as error:
        raise Epos2RosError(f"can't read {source}: it is nested too deep") from error
    if empty:
        raise Epos2RosError(f"{source} is empty")


def _documents(lines: Iterable[str]) -> Iterator[str]:
    document: list[str] = []
    for line in lines:
        if line.rstrip() == "---":
            yield "".join(document)
            document.clear()
        else:
            document.append(line)
    yield "".join(document)


def _trajectory(message: Any, source: str) -> Trajectory:
    points = message.get("points") if isinstance(message, Mapping) else None
    if points and isinstance(points, Sequence) and points[-1] == "...":
        raise Epos2RosError(
            f"{source} holds only the first {len(points) - 1} points: "
            "`ros2 topic echo` needs --full-length to print all"
        )
    return Trajectory.from_dict(message)


def read_parameters(file: Path, node: str | None = None) -> dict[str, Any]:
    """The parameters in a ROS parameter file that reach a node, with dotted names.

    Without the node's full name, those of the driver that it is for. ConfigurationError in one
    line where the file can't be read, or nothing in it is for the node.
    """
    parameters = ParameterFile.read(file)
    return parameters.of(node or parameters.node(DRIVER))


def share() -> Path:
    """Where `config` and `examples` are: the checkout, or share/epos2_ros of the installation."""
    for folder in Path(__file__).resolve().parents:
        if (folder / "package.xml").is_file():
            return folder
        if (folder / "share" / "epos2_ros").is_dir():
            return folder / "share" / "epos2_ros"
    raise Epos2RosError("the examples of epos2_ros are not installed: give TRAJECTORY and --params")


def shipped_parameters(joints: Iterable[str]) -> Path | None:
    """The shipped parameter file for simulated drives with these joints, if there is one."""
    for file in sorted((share() / "config").glob("*.yaml")):
        given = ParameterFile.read(file)
        parameters = given.of(f"/{DRIVER}") if given.reaches(f"/{DRIVER}") else {}
        if parameters.get("simulate") and set(parameters["joints"]) == set(joints):
            return file
    return None


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
