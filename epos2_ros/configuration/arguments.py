"""Command lines of the programs: ROS arguments in them (`--ros-args … [--]`), types of values."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterable, Sequence
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


def number(
    least: float = -math.inf, most: float = math.inf, words: str = "a number"
) -> Callable[[str], float]:
    """A finite number within limits, as argparse's `type`; `words`: what it must be."""

    def read(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not (math.isfinite(value) and least <= value <= most):
            raise argparse.ArgumentTypeError(f"{text!r}: must be {words}")
        return value

    return read


def path_ending(*suffixes: str) -> Callable[[str], Path]:
    """The path of a file of one of these kinds, as argparse's `type`."""

    def read(text: str) -> Path:
        path = Path(text)
        if path.suffix not in suffixes:
            raise argparse.ArgumentTypeError(f"{text!r}: must end in {', '.join(suffixes)}")
        return path

    return read


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
