"""Command lines with ROS arguments in them: `--ros-args … [--]`."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from epos2_ros.configuration.parameter_file import ParameterFile


def without_ros_arguments(argv: Iterable[str]) -> list[str]:
    """What a launch file adds means nothing to a program without ROS."""
    return _split(argv)[0]


def given_parameters(argv: Iterable[str]) -> list[ParameterFile]:
    """What `--params-file FILE` and `-p NODE:NAME:=VALUE` give, and for which nodes.

    ConfigurationError in one line for a file that is not there, or that rcl would refuse.
    """
    ros = _split(argv)[1]
    given = []
    for option, value in zip(ros, ros[1:], strict=False):
        if option == "--params-file":
            given.append(ParameterFile.read(Path(value)))
        elif option in ("-p", "--param"):
            name, _, text = value.partition(":=")
            node, colon, name = name.rpartition(":")
            if colon:
                section = {f"/{node.lstrip('/')}": {name: text}}
                given.append(ParameterFile(f"{option} {value}", section))
    return given


def _split(argv: Iterable[str]) -> tuple[list[str], Sequence[str]]:
    """The program's own arguments, and those for ROS."""
    own: list[str] = []
    ros: list[str] = []
    inside = False
    for argument in argv:
        if argument == "--ros-args":
            inside = True
        elif inside and argument == "--":
            inside = False
        else:
            (ros if inside else own).append(argument)
    return own, ros
