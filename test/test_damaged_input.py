"""Trajectories as messages and as files, and parameter files, damaged at random: read or refused
in one line, never anything else."""

from __future__ import annotations

import random
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
from rclpy.serialization import serialize_message
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from epos2_ros.configuration.files import read_parameters, read_trajectories
from epos2_ros.configuration.parameters import DriverParameters
from epos2_ros.errors import Epos2RosError
from epos2_ros.node.serialized import read_trajectory

TRAJECTORY = """\
header: {stamp: {sec: 5, nanosec: 0}, frame_id: ''}
joint_names: [a, b]
points:
- positions: [0.0, 0.0]
  velocities: [0.0, 0.0]
  time_from_start: {sec: 0, nanosec: 0}
- positions: [1.0, -1.0]
  velocities: [0.0, 0.0]
  time_from_start: {sec: 2, nanosec: 500000000}
---
"""
PARAMETERS = """\
/epos2_driver:
  ros__parameters:
    joints: [a, b]
    can: {interface: virtual, channel: x}
    axes:
      a: {node_id: 1, gear_ratio: 2.0, min_position: -1.5}
      b: {node_id: 2, type: prismatic, lead: 0.01}
    outputs: [camera]
    compare: {camera: {joint: a, kind: series, positions: [0.1, 0.2]}}
"""
SNIPPETS = [
    "{", "}", "[", "]", "&a ", "*a", "!!python/object:os.system ", "? ", ": ", "- ", "\t", "\0",
    "\n", "---\n", "...\n", "'", '"', "|", "> ", "1e999", "-.inf", ".nan", "null", "true",
    "2001-99-99", "0x", "<<: *a", "9" * 5000, "ü", "!!binary x", "!!set {a}", "@", "%TAG", "~",
    "-1", "1.5", "[]", "{}", "''",
]  # fmt: skip
NAUGHTY = {
    "deep": "[" * 100_000,
    "deep maps": "{a: " * 5000,
    "deep lists": "- " * 5000,
    "an alias of aliases": "a0: &a0 [x, x]\n"
    + "".join(f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]\n" for n in range(1, 12))
    + "points: *a11\njoint_names: *a11\n",
    "a list in itself": "points: &a [*a]\njoint_names: &b [*b]\n",
    "many digits": f"points: {'9' * 10_000}\n",
}


def messages() -> list[bytes]:
    made = []
    for points in (0, 1, 2, 5):
        for joints in (1, 2, 6):
            message = JointTrajectory(joint_names=[f"j{n}" for n in range(joints)])
            for n in range(points):
                point = JointTrajectoryPoint(positions=[0.1 * n] * joints)
                point.velocities = [0.0] * joints
                point.time_from_start.sec = n
                message.points.append(point)
            made.append(bytes(serialize_message(message)))
    return made


def damaged(data: bytes, rng: random.Random) -> bytes:
    text = bytearray(data)
    for _ in range(rng.randrange(1, 4)):
        at = rng.randrange(len(text) + 1)
        match rng.randrange(5):
            case 0 if at < len(text):
                text[at] ^= 1 << rng.randrange(8)
            case 1:
                del text[at:]
            case 2:
                text[at:at] = rng.randbytes(rng.randrange(20))
            case 3:  # a count, a size
                counts = [b"\xff\xff\xff\xff", b"\xff\xff\xff\x7f", bytes(4), b"\0\0\0\x10"]
                text[at : at + 4] = rng.choice(counts)
            case 4:  # NaN, infinity, the largest time
                numbers = [b"\0\0\0\0\0\0\xf8\x7f", b"\0\0\0\0\0\0\xf0\x7f", b"\xff" * 8]
                text[at : at + 8] = rng.choice(numbers)
    return bytes(text)


def mangled(text: str, rng: random.Random) -> str:
    values = list(re.finditer(r"[^\s:{}\[\],]+", text))
    value = rng.choice(values)
    if rng.random() < 0.7:  # another value, or name, and the rest as it was
        return text[: value.start()] + rng.choice(SNIPPETS) + text[value.end() :]
    letters = list(text)
    for _ in range(rng.randrange(1, 4)):
        at = rng.randrange(len(letters) + 1)
        match rng.randrange(4):
            case 0:
                letters[at:at] = rng.choice(SNIPPETS)
            case 1:
                del letters[at : at + rng.randrange(1, 20)]
            case 2:
                begin = rng.randrange(len(letters) + 1)
                letters[at:at] = letters[begin : begin + 40]
            case 3 if at < len(letters):
                letters[at] = chr(rng.randrange(1, 300))
    return "".join(letters)


def read_or_refused(read: Callable[[], object]) -> bool:
    try:
        read()
    except Epos2RosError as refusal:
        assert str(refusal) and "\n" not in str(refusal) and len(str(refusal)) < 20_000
        return False
    return True


def read_file(text: str) -> object:
    return list(read_trajectories(text.splitlines(keepends=True), "the file"))


def parameters_of(file: Path, text: str) -> object:
    file.write_text(text, encoding="utf-8", errors="surrogatepass")
    return DriverParameters(read_parameters(file)).config()


def test_messages(fuzz: int) -> None:
    rng, whole = random.Random(1), messages()
    read = 0
    for _ in range(3000 * fuzz):
        data = damaged(rng.choice(whole), rng)
        read += read_or_refused(partial(read_trajectory, data))
    assert 0 < read < 3000 * fuzz


def test_trajectory_files(fuzz: int) -> None:
    assert read_or_refused(partial(read_file, TRAJECTORY))
    rng, read = random.Random(1), 0
    for _ in range(500 * fuzz):
        read += read_or_refused(partial(read_file, mangled(TRAJECTORY, rng)))
    assert 0 < read < 500 * fuzz


def test_parameter_files(fuzz: int, tmp_path: Path) -> None:
    file = tmp_path / "parameters.yaml"
    assert read_or_refused(partial(parameters_of, file, PARAMETERS))
    rng, read = random.Random(1), 0
    for _ in range(300 * fuzz):
        read += read_or_refused(partial(parameters_of, file, mangled(PARAMETERS, rng)))
    assert 0 < read < 300 * fuzz


@pytest.mark.parametrize("name", NAUGHTY)
def test_files_made_to_hurt(name: str, tmp_path: Path) -> None:
    text, file = NAUGHTY[name], tmp_path / "parameters.yaml"
    assert not read_or_refused(partial(read_file, text))
    read_or_refused(partial(parameters_of, file, text))
    inside = "/epos2_driver:\n  ros__parameters:\n    " + text.replace("\n", "\n    ")
    read_or_refused(partial(parameters_of, file, inside))
