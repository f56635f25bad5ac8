"""A JointTrajectory as arrays, and what is wrong with it.

Everything here can be said without knowing where the robot is: joints, numbers, times.
Every refusal is one line that names the joint, the point (counted from 0) and the rule.
"""

from __future__ import annotations

import time
from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from epos2_ros.errors import TrajectoryError, UnfinishedTrajectory

REST_VELOCITY = 1e-6  # a last point slower than this is at rest [unit/s]
_FIELDS = ("positions", "velocities", "accelerations")
_MESSAGE_FIELDS = ("header", "joint_names", "points")
_POINT_FIELDS = (*_FIELDS, "effort", "time_from_start")
_ROS_1 = ("seq", "secs", "nsecs")
_SHOWN = 40  # characters of a value that is refused
# What builtin_interfaces/Time and Duration hold: int32 and uint32.
_TIME_FIELDS = {"sec": (-(2**31), 2**31 - 1), "nanosec": (0, 2**32 - 1)}


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Points of a trajectory for some joints, checked; no points mean "stop on the path"."""

    joint_names: tuple[str, ...]
    times_s: NDArray[np.float64]  # [points], time_from_start, increasing
    positions: NDArray[np.float64]  # [points, joints] [unit]
    velocities: NDArray[np.float64] | None = None  # [points, joints] [unit/s]
    accelerations: NDArray[np.float64] | None = None  # [points, joints] [unit/s²]
    stamp_s: float | None = None  # header.stamp; None: as soon as possible
    has_effort: bool = False  # which does not count
    published: bool = False  # on a topic, where others may follow: the last point may still move

    def __post_init__(self) -> None:
        if len(self.times_s):
            _check_joint_names(self.joint_names)
            self._check_values()
            self._check_times()
            if not self.published:
                self.check_rest()

    @classmethod
    def from_dict(cls, message: Any) -> Trajectory:
        """From the mapping that the YAML of `ros2 topic pub` and `echo` holds: a message of the
        topic."""
        _fields_of(message, "not a JointTrajectory: it", "trajectory", _MESSAGE_FIELDS)
        if "points" not in message:
            raise TrajectoryError("not a JointTrajectory: it has no points")
        points = message["points"] or ()
        if not isinstance(points, Sequence) or isinstance(points, str):
            raise TrajectoryError(
                f"not a JointTrajectory: points is {_shown(points)}; it must be a list of points"
            )
        for number, point in enumerate(points):
            _fields_of(point, f"point {number}", "point", _POINT_FIELDS)
        return cls._from_points(
            _names(message.get("joint_names") or ()),
            [
                _time(point.get("time_from_start") or {}, f"point {number}: time_from_start")
                for number, point in enumerate(points)
            ],
            {
                field: [_numbers(point, number, field) for number, point in enumerate(points)]
                for field in _FIELDS
            },
            _stamp(message.get("header") or {}),
            has_effort=any(point.get("effort") for point in points),
            published=True,
        )

    @classmethod
    def from_message(cls, message: Any, published: bool = False) -> Trajectory:
        """From a trajectory_msgs/JointTrajectory (or anything with its attributes)."""
        points, stamp = message.points, message.header.stamp
        times = list(map(attrgetter("time_from_start"), points))
        sec, nanosec = (np.fromiter(map(attrgetter(f), times), float) for f in _TIME_FIELDS)
        return cls._from_points(
            tuple(message.joint_names),
            sec + nanosec * 1e-9,
            {field: list(map(attrgetter(field), points)) for field in _FIELDS},
            stamp.sec + stamp.nanosec * 1e-9,
            has_effort=any(map(len, map(attrgetter("effort"), points))),
            published=published,
        )

    @classmethod
    def _from_points(
        cls,
        joint_names: tuple[str, ...],
        times_s: Sequence[float] | NDArray[np.float64],
        fields: Mapping[str, Sequence[Sequence[float]]],
        stamp_s: float,
        has_effort: bool = False,
        published: bool = False,
    ) -> Trajectory:
        if len(times_s):
            _check_joint_names(joint_names)
        arrays = {name: _matrix(name, rows, joint_names) for name, rows in fields.items()}
        if len(times_s) and arrays["positions"] is None:
            raise TrajectoryError("point 0 has no positions")
        if arrays["accelerations"] is not None and arrays["velocities"] is None:
            raise TrajectoryError("point 0 has accelerations but no velocities")
        positions = arrays.pop("positions")
        return cls(
            joint_names,
            np.array(times_s, dtype=np.float64),
            np.zeros((0, len(joint_names))) if positions is None else positions,
            stamp_s=stamp_s or None,
            has_effort=has_effort,
            published=published,
            **arrays,
        )

    @property
    def duration_s(self) -> float:
        """time_from_start of the last point."""
        return float(self.times_s[-1]) if len(self.times_s) else 0.0

    @property
    def rests(self) -> bool:
        """Whether the last point is at rest; without velocities it is."""
        return self.velocities is None or bool(np.all(np.abs(self.velocities[-1]) <= REST_VELOCITY))

    def axes(self, joints: Sequence[str], allow_partial: bool = False) -> list[int]:
        """Place of each of the trajectory's joints in `joints`, the driver's order.

        Raises TrajectoryError (INVALID_JOINTS) for unknown joints, and for missing ones
        unless `allow_partial`.
        """
        place = {joint: i for i, joint in enumerate(joints)}
        for name in self.joint_names:
            if name not in place:
                known = f"this driver has {', '.join(joints)}"
                none = "no joint of this driver follows trajectories"
                raise TrajectoryError(
                    f"joint '{name}' is unknown; {known if joints else none}",
                    TrajectoryError.INVALID_JOINTS,
                )
        missing = [joint for joint in joints if joint not in self.joint_names]
        if missing and not allow_partial:
            raise TrajectoryError(
                f"joint {', '.join(missing)} missing; allow_partial_joints_goal is false",
                TrajectoryError.INVALID_JOINTS,
            )
        return [place[name] for name in self.joint_names]

    def _check_values(self) -> None:
        for name, values in self._given():
            if values.shape != (len(self.times_s), len(self.joint_names)):
                raise TrajectoryError(
                    f"{name} have shape {values.shape}, "
                    f"expected {len(self.times_s)} points × {len(self.joint_names)} joints"
                )
            bad = ~np.isfinite(values)
            if bad.any():
                point, joint = np.argwhere(bad)[0]
                raise TrajectoryError(
                    f"joint '{self.joint_names[joint]}', point {point}: "
                    f"{name} holds {values[point, joint]}, must be finite"
                )

    def _check_times(self) -> None:
        times = self.times_s
        if not np.isfinite(times).all():
            raise TrajectoryError(
                f"point {np.argmin(np.isfinite(times))}: time_from_start must be finite"
            )
        if times[0] < 0:
            raise TrajectoryError(f"point 0: time_from_start {times[0]:g} s is negative")
        steps = np.diff(times)
        if (steps <= 0).any():
            point = int(np.argmax(steps <= 0)) + 1
            raise TrajectoryError(
                f"point {point}: time_from_start {times[point]:g} s is not after that of "
                f"point {point - 1} ({times[point - 1]:g} s)"
            )

    def check_rest(self) -> None:
        """Raise UnfinishedTrajectory when the last point still moves."""
        if self.velocities is None:
            return
        last = self.velocities[-1]
        joint = int(np.abs(last).argmax())
        if abs(last[joint]) > REST_VELOCITY:
            raise UnfinishedTrajectory(
                f"joint '{self.joint_names[joint]}', point {len(self.times_s) - 1}: the last "
                f"point still moves (velocity {last[joint]:g}, must be 0)"
            )

    def _given(self) -> list[tuple[str, NDArray[np.float64]]]:
        values = (self.positions, self.velocities, self.accelerations)
        return [(name, v) for name, v in zip(_FIELDS, values, strict=True) if v is not None]


def _check_joint_names(names: Sequence[str]) -> None:
    if not names:
        raise TrajectoryError("joint_names is empty", TrajectoryError.INVALID_JOINTS)
    for i, name in enumerate(names):
        if name in names[:i]:
            raise TrajectoryError(
                f"joint '{name}' is named twice in joint_names", TrajectoryError.INVALID_JOINTS
            )


def _fields_of(value: Any, where: str, kind: str, fields: Sequence[str]) -> None:
    """Refuse what is no map, or has other fields than the message has."""
    has = f"a {kind} has {', '.join(fields)}"
    if not isinstance(value, Mapping):
        raise TrajectoryError(f"{where} is {_shown(value)}; {has}")
    for name in value:
        if name not in fields:
            ros1 = " as in ROS 1" if name in _ROS_1 else ""
            raise TrajectoryError(f"{where} has {name!r}{ros1}; {has}")


def _time(value: Any, where: str) -> float:
    """Seconds; a fraction of one belongs into `nanosec` and is not taken for 0."""
    _fields_of(value, where, "time", tuple(_TIME_FIELDS))
    for field, number in value.items():
        low, high = _TIME_FIELDS[field]
        if not (
            isinstance(number, (int, float)) and low <= number <= high and number == int(number)
        ):
            raise TrajectoryError(
                f"{where}: {field} is {_shown(number)}; it must be a whole number "
                f"from {low} to {high}"
            )
    return float(value.get("sec", 0) + value.get("nanosec", 0) * 1e-9)


def _stamp(header: Any) -> float:
    """header.stamp [s]; `auto` and `now`, as `ros2 topic pub` has them, are the time now."""
    if header == "auto":
        return time.time()
    _fields_of(header, "header", "header", ("stamp", "frame_id"))
    stamp = header.get("stamp") or {}
    return time.time() if stamp == "now" else _time(stamp, "header.stamp")


def _names(names: Any) -> tuple[str, ...]:
    if isinstance(names, str) or not isinstance(names, Sequence):
        raise TrajectoryError(f"joint_names is {_shown(names)}; it must be a list of names")
    for name in names:
        if not isinstance(name, str):
            raise TrajectoryError(
                f"joint_names holds {_shown(name)}; it must be a list of names, and a name that "
                "YAML takes for something else be put in quotes"
            )
    return tuple(names)


def _numbers(point: Mapping[str, Any], number: int, field: str) -> Sequence[float]:
    values = point.get(field) or ()
    if isinstance(values, Sequence) and not isinstance(values, str):
        for value in values:
            if not isinstance(value, (int, float)) or isinstance(value, bool):
                raise TrajectoryError(f"point {number}: {field} holds {_shown(value)}, no number")
        return values
    raise TrajectoryError(f"point {number}: {field} is {_shown(values)}; it must be a list")


def _shown(value: Any) -> str:
    """A value as in YAML, on one line."""
    if value is None or isinstance(value, bool):
        return {None: "empty", True: "true", False: "false"}[value]
    text = " ".join(str(value).split())
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}…"


def _matrix(
    name: str, rows: Sequence[Any], joint_names: Sequence[str]
) -> NDArray[np.float64] | None:
    """Rows of a field as [points, joints]; None when no point has it."""
    lengths = np.fromiter(map(len, rows), dtype=np.int64, count=len(rows))
    if not lengths.any():
        return None
    wrong = lengths != len(joint_names)
    if wrong.any():
        point = int(np.argmax(wrong))
        raise TrajectoryError(
            f"point {point} has no {name}, others have: give them for all points or none"
            if lengths[point] == 0
            else f"point {point} has {lengths[point]} {name} for {len(joint_names)} joints"
        )
    try:
        if isinstance(rows[0], array):  # a message's; many times faster than number by number
            flat = np.frombuffer(b"".join(rows), dtype=np.float64)
        else:
            flat = np.fromiter(chain.from_iterable(rows), dtype=np.float64, count=lengths.sum())
    except (TypeError, ValueError) as error:
        raise TrajectoryError(f"{name} hold something that is not a number: {error}") from error
    return flat.reshape(len(rows), len(joint_names))
