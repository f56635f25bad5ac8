"""Command lines of programs that do without ROS and yet are started like ROS nodes."""

from __future__ import annotations

from collections.abc import Iterable


def without_ros_arguments(argv: Iterable[str]) -> list[str]:
    """A launch file adds `--ros-args … [--]`, which means nothing to a program without ROS."""
    own: list[str] = []
    ros = False
    for argument in argv:
        if argument == "--ros-args":
            ros = True
        elif ros and argument == "--":
            ros = False
        elif not ros:
            own.append(argument)
    return own
