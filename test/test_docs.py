"""Every command in README and docs, as it is written.

What can run here runs. Of `ros2 …`, which is not on the index that the tests install from,
everything it would read is checked: messages are made of the YAML, names are those that the node
has, parameter files go through rcl.
"""

from __future__ import annotations

import array
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from importlib.util import find_spec
from itertools import groupby
from pathlib import Path
from typing import Any

import pytest
import rclpy
import yaml
from rcl_parameters import rcl as rcl  # a fixture
from rclpy.context import Context
from rclpy.parameter import Parameter
from shipped import PARAMETER_FILES
from test_packaging import describe as describe  # a fixture

from epos2_ros.__main__ import PROGRAMS
from epos2_ros.configuration.driver import DriverConfig
from epos2_ros.configuration.files import read_parameters
from epos2_ros.configuration.parameters import DriverParameters
from epos2_ros.errors import Epos2RosError
from epos2_ros.motion.move import target_of
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.node.driver import DriverNode
from epos2_ros.plan.planning import make_plan

ROOT = Path(__file__).resolve().parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
FOR_READERS = ("…", "/path/to/", "my.yaml", "arm.asc")  # what they have to put in themselves
OTHER_PACKAGES = ("diagnostic_aggregator", "plotjuggler")
OTHER_NODES = ("/servo_node/", "/move_group/")
WITH_CONTROL_MSGS = ("/epos2_driver/controller_state",)
TIMEOUT_S = 60
OF_THE_SYSTEM = ("sudo", "source", "export", "cd", "rosdep", "colcon", "candump", "git", "gzip")


@dataclass(frozen=True)
class Written:
    """Something to be typed, and where it stands."""

    page: Path
    line: int
    text: str

    def __str__(self) -> str:
        return f"{self.page.name}:{self.line}"


def blocks(page: Path) -> Iterator[tuple[str, int, list[str]]]:
    """Language, first line and lines of every fenced block, and of those that are only indented."""
    lines = page.read_text().splitlines()
    fence: tuple[str, int, str] | None = None
    inside: list[str] = []
    for number, line in enumerate(lines, start=1):
        if match := re.match(r"( *)```(\w*)", line):
            if fence is None:
                fence, inside = (match[2], number + 1, match[1]), []
            else:
                yield fence[0], fence[1], [text.removeprefix(fence[2]) for text in inside]
                fence = None
        elif fence is not None:
            inside.append(line)
        elif re.match(r" {4}(python|make|epos2_ros|ros2|\.venv)\b", line) and not lines[number - 2]:
            yield "sh", number, [line.strip()]


def commands() -> Iterator[Written]:
    """One by one: those of `sh` blocks, and `ros2 …` in the text."""
    for page in PAGES:
        for language, first, lines in blocks(page):
            if language == "sh":
                command, begun = "", first
                for number, line in enumerate(lines, start=first):
                    begun = begun if command else number
                    command += f"{line}\n"
                    if complete(command):
                        if command.strip():
                            yield Written(page, begun, command.strip())
                        command = ""
                assert not command, f"{page.name}:{begun}: {command}"
        text = re.sub(r"```.*?```", lambda m: "\n" * m[0].count("\n"), page.read_text(), flags=re.S)
        for match in re.finditer(r"`((?:ros2|epos2_ros|\.venv/bin/epos2_ros) [^`]+)`", text):
            number = text[: match.start()].count("\n") + 1
            yield Written(page, number, " ".join(match[1].split()))


def complete(command: str) -> bool:
    """Whether the shell would run it, rather than ask for more."""
    if command.rstrip().endswith(("\\", "|")):
        return False
    return subprocess.run(["bash", "-n", "-c", command], capture_output=True).returncode == 0


def words(command: str) -> list[list[str]]:
    """Of each command of a pipe; without comments."""
    lexer = shlex.shlex(command.replace("\\\n", " "), posix=True, punctuation_chars="|<>;&")
    lexer.whitespace_split, lexer.commenters = True, "#"
    return [list(group) for pipe, group in groupby(lexer, lambda word: word == "|") if not pipe]


COMMANDS = list(commands())


def test_the_pages_are_read() -> None:
    kinds = {words(command.text)[0][0] for command in COMMANDS}
    assert {"make", "ros2", ".venv/bin/epos2_ros", "python", "sudo"} <= kinds
    assert len(COMMANDS) > 40
    assert any("time_from_start" in command.text for command in COMMANDS)


# -- the node that the commands speak to ------------------------------------------------------


@pytest.fixture(scope="module")
def node() -> Iterator[DriverNode]:
    """With all outputs that config/ has, not configured."""
    context = Context()
    rclpy.init(args=[], context=context)
    given = read_parameters(ROOT / "config" / "outputs.yaml") | {"autostart": False}
    overrides = [Parameter(name, value=value) for name, value in given.items()]
    made = DriverNode(context=context, parameter_overrides=overrides)
    yield made
    made.destroy_node()
    context.shutdown()


def configs() -> Iterator[DriverConfig]:
    yield DriverParameters({}).config()
    for file in PARAMETER_FILES:
        yield DriverParameters(read_parameters(file)).config()


def message(kind: str, text: str) -> Any:
    """What `ros2 topic pub` and `ros2 service call` make of YAML: each field as its type has it."""
    package, folder, name = kind.split("/")
    made = getattr(import_module(f"{package}.{folder}"), name)
    made = made.Request if folder == "srv" else made
    return filled(made(), yaml.safe_load(text or "{}"))


def filled(made: Any, values: dict[str, Any]) -> Any:
    types = made.get_fields_and_field_types()
    for name, value in values.items():
        assert name in types, f"{type(made).__name__} has no {name}, but {', '.join(types)}"
        before = getattr(made, name)
        if isinstance(value, dict):
            filled(before, value)
        elif isinstance(value, list) and types[name].startswith("sequence<double"):
            setattr(made, name, array.array("d", value))
        elif isinstance(value, list) and "/" in types[name]:
            package, element = re.fullmatch(r"sequence<(\w+)/(\w+)>", types[name]).groups()
            kind = getattr(import_module(f"{package}.msg"), element)
            setattr(made, name, [filled(kind(), element_value) for element_value in value])
        else:  # the setter refuses what is of another type
            setattr(made, name, float(value) if isinstance(before, float) else value)
    return made


def check_trajectory(trajectory: Trajectory) -> None:
    """Some driver of ours, whose joints stand at 0, runs it."""
    refusals = []
    for config in configs():
        if {axis.joint for axis in config.axes if axis.drive == "epos2"} == set(
            trajectory.joint_names
        ):
            try:
                make_plan(trajectory, config, [0.0] * len(trajectory.joint_names))
                return
            except Epos2RosError as error:
                refusals.append(str(error))
    pytest.fail(f"no parameter file of ours runs it: {refusals or trajectory.joint_names}")


def check_move(trajectory: Trajectory) -> None:
    targets, _ = target_of(trajectory)
    assert any(
        set(targets) <= {axis.joint for axis in config.axes if axis.drive != "epos2"}
        for config in configs()
    )


# -- one check for each kind of command -------------------------------------------------------


def without(options: dict[str, int], arguments: list[str]) -> list[str]:
    """What follows the options, each with so many values."""
    while arguments[0] in options:
        arguments = arguments[1 + options[arguments[0]] :]
    return arguments


def of_another_node(name: str) -> bool:
    """Of MoveIt or Servo, whose packages are no dependency of ours."""
    return name.startswith(OTHER_NODES)


def check_pub(arguments: list[str], node: DriverNode) -> None:
    topic, kind, *rest = without({"--once": 0, "-1": 0, "--rate": 1}, arguments)
    if of_another_node(topic):
        assert isinstance(yaml.safe_load(rest[0]), dict)
        return
    if rest[:2] == ["--stdin", "<"]:
        text = (ROOT / rest[2]).read_text()
    else:
        (text,) = rest
        assert len(text) < 2**17, "too long for one argument"
    made = message(kind, text)
    offered = dict(node.get_topic_names_and_types())
    assert kind in offered[topic], f"{topic} is {offered.get(topic)}"
    if topic.endswith("/joint_trajectory"):
        check_trajectory(Trajectory.from_message(made))
    if topic.endswith("/move_to"):
        check_move(Trajectory.from_message(made))


def check_echo(arguments: list[str], node: DriverNode) -> None:
    known = {"--once": 0, "--full-length": 0, "--qos-depth": 1, "--field": 1}
    (topic,) = without(known, arguments)
    offered = {name for name, _ in node.get_topic_names_and_types()}
    assert topic in offered or topic in WITH_CONTROL_MSGS
    if "/compare/" in topic:  # with its own depth of 5 it loses what comes in bursts
        assert "--qos-depth" in arguments


def check_service(arguments: list[str], node: DriverNode) -> None:
    name, kind, *rest = arguments
    if of_another_node(name):
        assert isinstance(yaml.safe_load(rest[0]), dict)
        return
    message(kind, *(rest or [""]))
    services = dict(node.get_service_names_and_types_by_node("epos2_driver", "/"))
    assert kind in services[name]


def check_lifecycle(arguments: list[str], node: DriverNode) -> None:
    name, transition = arguments
    assert name == node.get_fully_qualified_name()
    assert transition in ("configure", "activate", "deactivate", "cleanup", "shutdown")


def check_parameter(arguments: list[str], node: DriverNode) -> None:
    name, parameter, *_ = arguments
    assert name == node.get_fully_qualified_name()
    assert parameter.startswith("<") or node.has_parameter(parameter)


def check_launch(arguments: list[str], launch_arguments: Callable[[str], set[str]]) -> None:
    package, file, *given = arguments
    assert package == "epos2_ros"
    if (ROOT / "examples" / "moveit" / file).exists():
        return  # test_moveit_example has it
    assert (ROOT / "launch" / file).exists()
    for argument in given:
        name, _, value = argument.partition(":=")
        assert name in launch_arguments(file) | {"--show-args"}
        if name in ("params_file", "model") and not value.startswith(FOR_READERS):
            assert (ROOT / value).exists()


def check_program(program: str, arguments: list[str]) -> None:
    """Its options are in its help; files are there; the driver's parameters are its own."""
    assert program in PROGRAMS
    own, _, ros = " ".join(arguments).partition("--ros-args")
    options = set(re.findall(r"(?<!\S)--[a-z][\w-]*", own))
    if options:
        assert options <= options_of(program), options
    given: dict[str, Any] = {}
    pairs = ros.split()
    for option, value in zip(pairs, pairs[1:], strict=False):
        if option == "--params-file" and value not in FOR_READERS:
            given |= read_parameters(ROOT / value)
        elif option == "-p":
            name, _, text = value.partition(":=")
            given[name] = yaml.safe_load(text)
    if given:
        DriverParameters(given).config()


@lru_cache
def options_of(program: str) -> set[str]:
    """In its help, and in that of its own commands."""
    shown = helped(program)
    for commands in re.findall(r"\{([\w,]+)\} \.\.\.", shown):
        shown += "".join(helped(program, name) for name in commands.split(","))
    return set(re.findall(r"--[a-z][\w-]*", shown))


def helped(*program: str) -> str:
    return subprocess.run(
        [sys.executable, "-m", "epos2_ros", *program, "--help"],
        capture_output=True,
        text=True,
        cwd=ROOT,
        env={**os.environ, "COLUMNS": "200"},
    ).stdout


def check_module(arguments: list[str]) -> None:
    """`python -m benchmarks.…`"""
    assert arguments[0] == "-m", arguments
    assert find_spec(arguments[1]) is not None


def check_make(arguments: list[str]) -> None:
    target, *given = arguments
    assert re.search(rf"^{target}:", (ROOT / "Makefile").read_text(), flags=re.M)
    for argument in given:
        for word in argument.partition("=")[2].split():
            if "/" in word:
                assert (ROOT / word).exists()
            elif word.startswith("--") and target == "demo":
                check_program("demo", [word])


@pytest.fixture
def launch_arguments(describe: Callable[[str], Any]) -> Callable[[str], set[str]]:
    return lambda file: {a.positional[0] for a in describe(file).positional[0][:-1]}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Where a reader is, with the command that `make` has installed."""
    for name in ("examples", "config", "docs"):
        (tmp_path / name).symlink_to(ROOT / name)
    scripts = tmp_path / ".venv" / "bin"
    scripts.mkdir(parents=True)
    command = scripts / "epos2_ros"
    command.write_text(f'#!/bin/sh\nPYTHONPATH={ROOT} exec {sys.executable} -m epos2_ros "$@"\n')
    command.chmod(0o755)
    return tmp_path


@pytest.mark.parametrize("command", COMMANDS, ids=str)
def test_a_command_works_as_written(
    command: Written,
    node: DriverNode,
    launch_arguments: Callable[[str], set[str]],
    folder: Path,
) -> None:
    if command.text.endswith(" …") and "\n" not in command.text:  # in the text: a name, no command
        command = Written(command.page, command.line, command.text.removesuffix(" …"))
    checks: dict[tuple[str, ...], Callable[[list[str]], None]] = {
        ("ros2", "topic", "pub"): lambda rest: check_pub(rest, node),
        ("ros2", "topic", "echo"): lambda rest: check_echo(rest, node),
        ("ros2", "service", "call"): lambda rest: check_service(rest, node),
        ("ros2", "lifecycle", "set"): lambda rest: check_lifecycle(rest, node),
        ("ros2", "param", "describe"): lambda rest: check_parameter(rest, node),
        ("ros2", "param", "set"): lambda rest: check_parameter(rest, node),
        ("ros2", "launch"): lambda rest: check_launch(rest, launch_arguments),
        ("python", "-m"): lambda rest: check_module(["-m", *rest]),
        ("make",): check_make,
    }
    for line in words(command.text):
        for start, check in checks.items():
            if tuple(line[: len(start)]) == start and len(line) > len(start):
                check(line[len(start) :])
                break
        else:
            check_other(line)
    if ".venv/bin/epos2_ros plan" in command.text:
        subprocess.run(
            ["bash", "-o", "pipefail", "-c", command.text],
            cwd=folder,
            check=True,
            timeout=TIMEOUT_S,
            stdout=subprocess.DEVNULL,
        )


def check_other(line: list[str]) -> None:
    name = Path(line[0]).name
    if name == "epos2_ros":
        check_program(line[1], line[2:])
    elif line[:2] == ["ros2", "run"]:
        assert line[2] in ("epos2_ros", *OTHER_PACKAGES)
        if line[2] == "epos2_ros" and line[3:]:
            check_program(line[3], line[4:])
    elif line[:2] == ["ros2", "security"]:  # of ros-jazzy-sros2
        for path in (argument for argument in line if "/share/epos2_ros/" in argument):
            assert (ROOT / path.partition("/share/epos2_ros/")[2]).exists()
    elif line[0] not in (*OF_THE_SYSTEM, "echo") and line[:2] not in (
        ["ros2", "topic"],
        ["ros2", "param"],
        ["ros2", "action"],
        ["ros2", "bag"],
        ["ros2", "launch"],
        ["pip", "install"],
    ):
        pytest.fail(f"no way to check {line}")


# -- parameters ------------------------------------------------------------------------------


def parameter_blocks() -> Iterator[Written]:
    for page in PAGES:
        for language, first, lines in blocks(page):
            if language == "yaml":
                yield Written(page, first, "\n".join(lines) + "\n")


def as_file(text: str) -> str:
    """Parameters in a page may stand without the lines that every parameter file begins with."""
    if "ros__parameters" in text:
        return text
    return "/**:\n  ros__parameters:\n" + "".join(f"    {line}\n" for line in text.splitlines())


@pytest.mark.parametrize("block", parameter_blocks(), ids=str)
def test_parameters_in_a_page_are_read_by_ros_and_known(
    block: Written, rcl: Callable[..., Any]
) -> None:
    given = rcl(as_file(block.text))
    assert given, "rcl refuses it, or nothing in it is for the driver"
    named = {v for k, v in given.items() if k.endswith(".joint")}
    joints = given.get("joints") or [*named, "a"]
    made = DriverParameters({**given, "joints": list(joints)})
    assert not made.complaints


@pytest.mark.parametrize("file", PARAMETER_FILES, ids=lambda file: file.name)
def test_parameter_files_are_read_by_ros_as_by_us(file: Path, rcl: Callable[..., Any]) -> None:
    assert rcl(file.read_text()) == read_parameters(file)


def test_every_parameter_in_the_readme_is_one(node: DriverNode) -> None:
    """`axes.<joint>.node_id` and so on, in the table of parameters."""
    text = (ROOT / "README.md").read_text()
    table = text[text.index("### Parameters") : text.index("## What can go wrong")]
    names = [n for row in re.findall(r"^\| (`[^|]*`) \|", table, flags=re.M) for n in row.split()]
    assert len(names) > 30
    stem = ""
    for written in (name.strip("`,") for name in names):
        if written.endswith("…"):
            continue
        if written.startswith("."):
            written = stem + written
        stem = written.rpartition(".")[0]
        name = written.replace("<joint>", "gantry_x").replace("<output>", "camera")
        assert node.has_parameter(name), name


def test_every_link_leads_somewhere() -> None:
    for page in PAGES:
        for target in re.findall(r"\]\(([^)#]+)(?:#[\w-]+)?\)", page.read_text()):
            if "://" not in target:
                assert (page.parent / target).exists(), f"{page.name}: {target}"


