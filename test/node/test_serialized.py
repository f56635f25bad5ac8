"""Trajectories read from serialized messages, against rclpy's own reading of them."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest
from builtin_interfaces.msg import Duration, Time
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from trajectories import JOINTS, trajectories
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from epos2_ros.errors import TrajectoryError
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.node import serialized
from epos2_ros.node.serialized import read_trajectory


@st.composite
def messages(draw: Any) -> JointTrajectory:
    """What planners send, with names of every length: they decide where the numbers lie."""
    trajectory = draw(trajectories())
    names = [joint + "x" * draw(st.integers(0, 9)) for joint in JOINTS]
    effort = draw(st.booleans())
    rows = [trajectory.positions, trajectory.velocities, trajectory.accelerations]
    points = [
        JointTrajectoryPoint(
            positions=rows[0][i].tolist(),
            velocities=[] if rows[1] is None else rows[1][i].tolist(),
            accelerations=[] if rows[2] is None else rows[2][i].tolist(),
            effort=[1.5] * len(names) if effort else [],
            time_from_start=Duration(sec=int(t), nanosec=round(t % 1 * 1e9) % 10**9),
        )
        for i, t in enumerate(trajectory.times_s)
    ]
    message = JointTrajectory(joint_names=names, points=points)
    message.header.frame_id = draw(st.text("wörld_/", max_size=9))
    message.header.stamp = draw(st.sampled_from([Time(), Time(sec=1_700_000_000, nanosec=7)]))
    return message


def outcome(read: Any, data: Any) -> Any:
    """The trajectory's contents, or why it is refused."""
    try:
        trajectory = read(data)
    except TrajectoryError as error:
        return str(error)
    arrays = (trajectory.times_s, trajectory.positions)
    given = (trajectory.velocities, trajectory.accelerations)
    return (
        trajectory.joint_names,
        trajectory.stamp_s,
        *(values.tolist() for values in arrays),
        *(None if values is None else values.tolist() for values in given),
    )


def by_rclpy(data: bytes) -> Trajectory:
    return Trajectory.from_message(deserialize_message(data, JointTrajectory), published=True)


@settings(max_examples=50, deadline=None)
@given(message=messages())
def test_the_serialized_message_is_read_as_rclpy_reads_it(message: JointTrajectory) -> None:
    data = serialize_message(message)
    with pytest.MonkeyPatch.context() as patch:  # and without rclpy
        patch.delattr(serialized, "deserialize_message")
        assert outcome(read_trajectory, data) == outcome(by_rclpy, data)


@settings(max_examples=50, deadline=None)
@given(message=messages(), choose=st.randoms(use_true_random=False))
def test_points_that_differ_are_refused_in_the_same_words(
    message: JointTrajectory, choose: Any
) -> None:
    """Values missing, too many, not a number, or times that go back."""
    point = choose.choice(message.points)
    field = choose.choice(["positions", "velocities", "accelerations", "effort"])
    values = getattr(point, field)
    spoil = choose.choice(["none", "fewer", "more", "nan", "late", "all", "still"])
    if spoil == "nan":
        setattr(point, field, [np.nan] * len(values))
    elif spoil == "late":
        point.time_from_start = Duration(sec=99)
    elif spoil in ("all", "still"):
        for each in message.points:
            setattr(each, field, [] if spoil == "all" else [0.5] * len(JOINTS))
    else:
        setattr(point, field, {"none": [], "fewer": values[:1]}.get(spoil, [*values, 1.0]))
    data = serialize_message(message)
    assert outcome(read_trajectory, data) == outcome(by_rclpy, data)


@pytest.mark.parametrize("points", [0, 1])
def test_stops_and_streamed_points(points: int) -> None:
    one = JointTrajectoryPoint(positions=[0.1, 0.2], time_from_start=Duration(nanosec=10**8))
    data = serialize_message(JointTrajectory(joint_names=list(JOINTS), points=[one] * points))
    trajectory = read_trajectory(data)
    assert trajectory.positions.tolist() == [[0.1, 0.2]] * points


@settings(max_examples=50, deadline=None)
@given(message=messages(), share=st.floats(0.0, 0.5))
def test_a_damaged_message_is_refused(message: JointTrajectory, share: float) -> None:
    data = serialize_message(message)
    cut = data[: max(4, int(share * len(data)))]  # beyond one half there may be unused bytes
    with pytest.raises(TrajectoryError):
        read_trajectory(cut)


def test_a_length_beyond_all_bounds_is_refused() -> None:
    """4,294,967,295 efforts in the first of three points; time_from_start comes after them."""
    first = JointTrajectoryPoint(positions=[0.1, 0.2], time_from_start=Duration(sec=7))
    points = [first, JointTrajectoryPoint(), JointTrajectoryPoint()]
    data = serialize_message(JointTrajectory(joint_names=list(JOINTS), points=points))
    length = data.index(struct.pack("<i", 7)) - 4
    with pytest.raises(TrajectoryError, match="damaged"):
        read_trajectory(data[:length] + b"\xff" * 4 + data[length + 4 :])
