"""A JointTrajectory straight from its serialized form.

Before rclpy hands a message over it makes Python objects of it: for 60,000 points that takes over
a second, and holds the thread that feeds the drives up for a tenth of one. But the points of a
trajectory have the same fields, so their serialized form is a table, which NumPy reads where it
lies.

Source: OMG, "Common Object Request Broker Architecture" 3.4, part 2, 9.3 (CDR: primitives lie at
multiples of their size, a string or sequence is its length and its elements), and "DDS
Interoperability Wire Protocol" 2.5, 10.2 (the 4 bytes before it, from whose end is counted).
"""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy._rclpy_pybind11 import RMWError
from rclpy.serialization import deserialize_message
from trajectory_msgs.msg import JointTrajectory

from epos2_ros.errors import TrajectoryError
from epos2_ros.motion.trajectory import Trajectory

_HEADER_BYTES = 4
_CDR_LITTLE_ENDIAN = b"\x00\x01"
_FIELDS = ("positions", "velocities", "accelerations", "effort")  # doubles
_COUNT = struct.Struct("<I")


def read_trajectory(data: bytes) -> Trajectory:
    """The trajectory in a serialized trajectory_msgs/JointTrajectory; TrajectoryError if refused.

    Whatever is not a table of points is left to rclpy and to `Trajectory.from_message`.
    """
    try:
        return _from_table(data) or Trajectory.from_message(
            deserialize_message(data, JointTrajectory), published=True
        )
    except (struct.error, UnicodeDecodeError, RMWError) as error:
        raise TrajectoryError(f"the message is damaged: {error}") from error


def _from_table(data: bytes) -> Trajectory | None:
    """The trajectory if all its points have the same fields, for all joints."""
    if not data.startswith(_CDR_LITTLE_ENDIAN):
        return None
    body = memoryview(data)[_HEADER_BYTES:]
    (sec, nanosec), at = struct.unpack_from("<iI", body), 8
    _, at = _string(body, at)  # frame_id
    joints, at = _count(body, at)
    names = []
    for _ in range(joints):
        name, at = _string(body, at)
        names.append(name)
    points, at = _count(body, at)
    if points < 2:
        return None
    counts, second = _point(body, at)
    if second > len(body):
        raise TrajectoryError("the message is damaged: point 0 is longer than all of it")
    # As a point ends where the next one begins, all after the first lie alike.
    table = _layout(second, counts)
    if second + (points - 1) * table.itemsize > len(body):
        return None
    first = np.frombuffer(body, _layout(at, counts), 1, at)
    others = np.frombuffer(body, table, points - 1, second)
    for field, count in zip(_FIELDS, counts, strict=True):
        if count not in (0, joints) or (others[f"number of {field}"] != count).any():
            return None

    def column(name: str) -> NDArray[Any]:
        return np.concatenate((first[name], others[name]))

    given = {
        field: column(field).view("<f8").reshape(points, joints)
        for field, count in zip(_FIELDS[:3], counts, strict=False)
        if count
    }
    if "positions" not in given or ("accelerations" in given and "velocities" not in given):
        return None
    return Trajectory(
        tuple(names),
        column("sec") + column("nanosec") * 1e-9,
        stamp_s=sec + nanosec * 1e-9 or None,
        has_effort=bool(counts[3]),
        published=True,
        **given,
    )


def _count(body: memoryview, at: int) -> tuple[int, int]:
    """The length at or after `at`, and where what follows begins."""
    at += -at % 4
    return _COUNT.unpack_from(body, at)[0], at + 4


def _string(body: memoryview, at: int) -> tuple[str, int]:
    size, at = _count(body, at)
    return str(body[at : at + size - 1], "utf-8"), at + size  # it ends with a zero byte


def _point(body: memoryview, at: int) -> tuple[list[int], int]:
    """How many values each field of the point at `at` has, and where the next point begins."""
    counts = []
    for _ in _FIELDS:
        count, at = _count(body, at)
        counts.append(count)
        at += (-at % 8 + 8 * count) if count else 0
    return counts, at + 8


def _layout(start: int, counts: list[int]) -> np.dtype[Any]:
    """A point that begins at `start`; padding depends on where that is.

    Doubles are bytes here, which NumPy copies faster than numbers that are not aligned.
    """
    fields: dict[str, tuple[object, int]] = {}
    at = start
    for field, count in zip(_FIELDS, counts, strict=True):
        fields[f"number of {field}"] = "<u4", at - start
        at += 4
        if count:
            at += -at % 8
            fields[field] = f"V{8 * count}", at - start
            at += 8 * count
    fields |= {"sec": ("<i4", at - start), "nanosec": ("<u4", at + 4 - start)}
    formats, offsets = zip(*fields.values(), strict=True)
    size = at + 8 - start
    layout: Any = {"names": [*fields], "formats": formats, "offsets": offsets, "itemsize": size}
    return np.dtype(layout)
