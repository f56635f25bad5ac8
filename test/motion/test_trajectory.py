"""What a JointTrajectory message may hold, and what is said about one that may not run."""

from __future__ import annotations

import copy
import re
from array import array
from collections.abc import Callable
from time import time as now_s
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from trajectories import NAMES, example, example_message

from epos2_ros.errors import TrajectoryError
from epos2_ros.motion.trajectory import Trajectory

GOOD: dict[str, Any] = {
    "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""},
    "joint_names": ["pan", "tilt"],
    "points": [
        {
            "positions": [0.0, 0.1],
            "velocities": [0.0, 0.0],
            "accelerations": [1.0, 2.0],
            "time_from_start": {"sec": 0, "nanosec": 0},
        },
        {
            "positions": [0.5, 0.6],
            "velocities": [0.3, 0.2],
            "accelerations": [0.0, 0.0],
            "time_from_start": {"sec": 0, "nanosec": 500_000_000},
        },
        {
            "positions": [1.0, 1.1],
            "velocities": [0.0, 0.0],
            "accelerations": [0.0, 0.0],
            "time_from_start": {"sec": 1, "nanosec": 250_000_000},
        },
    ],
}


def message_of(content: dict[str, Any]) -> SimpleNamespace:
    """What rclpy hands over: attributes, and array.array for the numbers."""

    def time_of(value: dict[str, int]) -> SimpleNamespace:
        return SimpleNamespace(sec=value["sec"], nanosec=value["nanosec"])

    return SimpleNamespace(
        header=SimpleNamespace(stamp=time_of(content["header"]["stamp"]), frame_id=""),
        joint_names=list(content["joint_names"]),
        points=[
            SimpleNamespace(
                **{
                    name: array("d", point.get(name, []))
                    for name in ("positions", "velocities", "accelerations", "effort")
                },
                time_from_start=time_of(point["time_from_start"]),
            )
            for point in content["points"]
        ],
    )


def test_values_end_up_where_they_belong() -> None:
    trajectory = Trajectory.from_dict(GOOD)
    assert trajectory.joint_names == ("pan", "tilt")
    np.testing.assert_array_equal(trajectory.times_s, [0.0, 0.5, 1.25])
    np.testing.assert_array_equal(trajectory.positions, [[0.0, 0.1], [0.5, 0.6], [1.0, 1.1]])
    assert trajectory.velocities is not None and trajectory.accelerations is not None
    np.testing.assert_array_equal(trajectory.velocities[1], [0.3, 0.2])
    np.testing.assert_array_equal(trajectory.accelerations[0], [1.0, 2.0])
    assert trajectory.stamp_s is None
    assert trajectory.duration_s == 1.25


@pytest.mark.parametrize("name", NAMES)
def test_a_message_and_its_yaml_are_the_same(name: str) -> None:
    from_dict, content = example(name), example_message(name)
    from_message = Trajectory.from_message(message_of(content))
    assert from_dict.joint_names == from_message.joint_names == tuple(content["joint_names"])
    for field in ("times_s", "positions", "velocities", "accelerations"):
        a, b = getattr(from_dict, field), getattr(from_message, field)
        assert (a is None) == (b is None) == (field not in content["points"][0] and a is None)
        if a is not None:
            np.testing.assert_array_equal(a, b)


def test_a_stamp_is_seconds() -> None:
    content = copy.deepcopy(GOOD)
    content["header"]["stamp"] = {"sec": 1_700_000_000, "nanosec": 250_000_000}
    assert Trajectory.from_dict(content).stamp_s == 1_700_000_000.25
    assert Trajectory.from_message(message_of(content)).stamp_s == 1_700_000_000.25


def test_no_points_mean_stop_whatever_else_there_is() -> None:
    for names in ([], ["pan"], ["nobody", "nobody"]):
        trajectory = Trajectory.from_dict({"joint_names": names, "points": []})
        assert len(trajectory.times_s) == 0


def test_joints_find_their_place_in_any_order() -> None:
    trajectory = Trajectory.from_dict(GOOD)
    assert trajectory.axes(("tilt", "pan")) == [1, 0]
    assert trajectory.axes(("roll", "tilt", "pan"), allow_partial=True) == [2, 1]


def set_to(*path: Any, value: Any) -> Callable[[dict[str, Any]], None]:
    def change(content: dict[str, Any]) -> None:
        for key in path[:-1]:
            content = content[key]
        content[path[-1]] = value

    return change


def time(sec: int, nanosec: int) -> dict[str, int]:
    return {"sec": sec, "nanosec": nanosec}


INVALID_GOAL, INVALID_JOINTS = TrajectoryError.INVALID_GOAL, TrajectoryError.INVALID_JOINTS


@pytest.mark.parametrize(
    ("change", "code", "words"),
    [
        (set_to("joint_names", value=["pan", "pan"]), INVALID_JOINTS, ["'pan'", "twice"]),
        (set_to("joint_names", value=[]), INVALID_JOINTS, ["joint_names is empty"]),
        (
            set_to("points", 1, "positions", value=[1.0]),
            INVALID_GOAL,
            ["point 1", "1 positions", "2 joints"],
        ),
        (
            set_to("points", 2, "velocities", value=[0.0, 0.0, 0.0]),
            INVALID_GOAL,
            ["point 2", "3 velocities", "2 joints"],
        ),
        (set_to("points", 1, "velocities", value=[]), INVALID_GOAL, ["point 1", "no velocities"]),
        (
            set_to("points", 0, "accelerations", value=[]),
            INVALID_GOAL,
            ["point 0", "no accelerations"],
        ),
        (
            set_to("points", 1, "positions", value=[0.0, float("nan")]),
            INVALID_GOAL,
            ["'tilt'", "point 1", "positions", "nan", "finite"],
        ),
        (
            set_to("points", 0, "accelerations", value=[float("-inf"), 0.0]),
            INVALID_GOAL,
            ["'pan'", "point 0", "accelerations", "-inf", "finite"],
        ),
        (
            set_to("points", 0, "time_from_start", value=time(-1, 0)),
            INVALID_GOAL,
            ["point 0", "-1 s", "negative"],
        ),
        (
            set_to("points", 2, "time_from_start", value=time(0, 500_000_000)),
            INVALID_GOAL,
            ["point 2", "0.5 s", "not after", "point 1"],
        ),
        (
            set_to("points", 2, "velocities", value=[0.0, -0.1]),
            INVALID_GOAL,
            ["'tilt'", "point 2", "last point still moves", "-0.1"],
        ),
    ],
)
def test_bad_content_is_refused_in_one_line(
    change: Callable[[dict[str, Any]], None], code: int, words: list[str]
) -> None:
    content = copy.deepcopy(GOOD)
    change(content)
    for build in (Trajectory.from_dict, lambda c: Trajectory.from_message(message_of(c))):
        with pytest.raises(TrajectoryError) as refusal:
            build(content).check_rest()  # which a message of the topic need not
        message = str(refusal.value)
        assert refusal.value.code == code
        assert "\n" not in message
        for word in words:
            assert word in message


def test_accelerations_need_velocities_and_points_need_positions() -> None:
    content = copy.deepcopy(GOOD)
    for point in content["points"]:
        del point["velocities"]
    with pytest.raises(TrajectoryError, match="accelerations but no velocities"):
        Trajectory.from_dict(content)
    for point in content["points"]:
        del point["positions"], point["accelerations"]
    with pytest.raises(TrajectoryError, match="no positions"):
        Trajectory.from_dict(content)


def test_unknown_and_missing_joints() -> None:
    trajectory = Trajectory.from_dict(GOOD)
    with pytest.raises(TrajectoryError, match="'tilt' is unknown; this driver has pan, roll") as e:
        trajectory.axes(("pan", "roll"))
    assert e.value.code == TrajectoryError.INVALID_JOINTS
    with pytest.raises(TrajectoryError, match="joint roll missing") as e:
        trajectory.axes(("pan", "tilt", "roll"))
    assert e.value.code == TrajectoryError.INVALID_JOINTS


def test_a_time_that_yaml_leaves_out_is_zero_as_in_a_message() -> None:
    points = [{"positions": [0.0]}, {"positions": [1.0], "time_from_start": {"sec": 2}}]
    trajectory = Trajectory.from_dict({"joint_names": ["a"], "points": points})
    assert trajectory.times_s.tolist() == [0.0, 2.0]


@pytest.mark.parametrize(
    "content",
    [
        None,
        [],
        {},
        {"joint_names": ["a"], "points": [1]},
        {"joint_names": ["a"], "points": [{"positions": ["x"], "time_from_start": {}}]},
        {"joint_names": ["a"], "points": [{"positions": 1.0, "time_from_start": {}}]},
        {"joint_names": ["a"], "points": [{"positions": [None], "time_from_start": {}}]},
        {"joint_names": 3, "points": [{"positions": [0.0], "time_from_start": {}}]},
        {"joint_names": [["a"]], "points": [{"positions": [0.0], "time_from_start": {}}]},
        {"joint_names": "a", "points": [{"positions": [0.0], "time_from_start": {}}]},
        {
            "header": 1,
            "joint_names": ["a"],
            "points": [{"positions": [0.0], "time_from_start": {}}],
        },
        {"joint_names": ["a"], "points": [{"positions": [0.0], "time_from_start": 1.0}]},
    ],
)
def test_what_is_no_trajectory_is_refused_in_one_line(content: Any) -> None:
    with pytest.raises(TrajectoryError) as refusal:
        Trajectory.from_dict(content)
    assert "\n" not in str(refusal.value)
    assert not re.search("object|Error|NoneType|attribute|argument|'int'", str(refusal.value))


def one(**changes: Any) -> dict[str, Any]:
    point = {"positions": [0.0], "time_from_start": {"sec": 1}, **changes.pop("point", {})}
    return {"joint_names": ["a"], "points": [point], **changes}


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (one(header={"seq": 1}), "header has 'seq' as in ROS 1; a header has stamp, frame_id"),
        (
            one(header={"stamp": {"secs": 1, "nsecs": 0}}),
            "header.stamp has 'secs' as in ROS 1; a time has sec, nanosec",
        ),
        (
            one(point={"time_from_start": {"secs": 1}}),
            "point 0: time_from_start has 'secs' as in ROS 1; a time has sec, nanosec",
        ),
        (
            one(point={"time_from_start": 1.5}),
            "point 0: time_from_start is 1.5; a time has sec, nanosec",
        ),
        (
            one(point={"time_from_start": {"sec": 1.5}}),
            "point 0: time_from_start: sec is 1.5; it must be a whole number from -2147483648 ",
        ),
        (one(point={"positions": 1.0}), "point 0: positions is 1.0; it must be a list"),
        (one(point={"positions": ["x"]}), "point 0: positions holds x, no number"),
        (one(point={"positions": [True]}), "point 0: positions holds true, no number"),
        (one(point={"position": [0.0]}), "point 0 has 'position'; a point has positions, veloc"),
        (one(joint_names=[True]), "joint_names holds true; it must be a list of names, and a name"),
        (one(header="now"), "header is now; a header has stamp, frame_id"),
        (one(header={"stamp": "later"}), "header.stamp is later; a time has sec, nanosec"),
    ],
)
def test_what_a_message_cannot_hold_is_refused_in_words(content: Any, says: str) -> None:
    with pytest.raises(TrajectoryError) as refusal:
        Trajectory.from_dict(content)
    assert str(refusal.value).startswith(says)


@pytest.mark.parametrize("header", ["auto", {"stamp": "now"}, {"stamp": "now", "frame_id": "b"}])
def test_auto_and_now_are_what_ros2_topic_pub_makes_of_them(header: Any) -> None:
    before = now_s()
    stamp_s = Trajectory.from_dict(one(header=header)).stamp_s
    assert stamp_s is not None and before <= stamp_s <= now_s()


@pytest.mark.parametrize("effort", [[], [1.0]])
def test_effort_is_noticed(effort: list[float]) -> None:
    content = one(point={"effort": effort})
    stamped = {"header": {"stamp": {"sec": 0, "nanosec": 0}}, **content}
    stamped["points"][0]["time_from_start"]["nanosec"] = 0
    for trajectory in (Trajectory.from_dict(content), Trajectory.from_message(message_of(stamped))):
        assert trajectory.has_effort == bool(effort)


@pytest.mark.parametrize(
    "time",
    [
        {"sec": 1.5},
        {"sec": float("inf")},
        {"sec": float("nan")},
        {"sec": 1e300},
        {"sec": 2**31},
        {"nanosec": -1},
        {"sec": 1, "nanosec": 0.5},
        {"secs": 1},
        {"sec": 1, "nsec": 500_000_000},
        {"sec": "1"},
    ],
)
def test_a_time_that_no_message_can_hold_is_refused(time: dict[str, Any]) -> None:
    one = {"joint_names": ["a"], "points": [{"positions": [0.0], "time_from_start": time}]}
    stamped = {"header": {"stamp": time}, "joint_names": [], "points": []}
    for content in (one, stamped):
        with pytest.raises(TrajectoryError) as refusal:
            Trajectory.from_dict(content)
        assert "\n" not in str(refusal.value)
