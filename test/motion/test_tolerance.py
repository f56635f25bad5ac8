"""Tolerances of a goal: which hold, and what violates them. By the action's definition:
positive holds, 0 is the parameter's, -1 is none, any other negative a mistake."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from epos2_ros.configuration.driver import AxisConfig
from epos2_ros.motion.reference import State
from epos2_ros.motion.tolerance import JointTolerance, Tolerances

JOINTS = ("a", "b", "slide")
PARAMETERS = {"a": (0.1, 0.02), "b": (0.0, 0.0), "slide": (0.003, 0.001)}
STILL = np.zeros(3)


def resting(position: np.ndarray) -> State:
    return State(position, STILL, STILL)


def configured(goal_time: float = 1.0) -> Tolerances:
    axes = tuple(
        AxisConfig(
            joint,
            n,
            type="prismatic" if joint == "slide" else "revolute",
            lead=0.01 if joint == "slide" else None,
            path_tolerance=PARAMETERS[joint][0],
            goal_tolerance=PARAMETERS[joint][1],
        )
        for n, joint in enumerate(JOINTS, start=1)
    )
    return Tolerances.of(axes, goal_time)


value = st.one_of(
    st.sampled_from([0.0, -1.0]), st.floats(1e-6, 10.0), st.floats(-10.0, -1e-6), st.just(math.nan)
)
tolerance = st.builds(JointTolerance, st.sampled_from([*JOINTS, "other"]), value, value, value)
tolerance_lists = st.lists(tolerance, max_size=4, unique_by=lambda t: t.name)


@given(path=tolerance_lists, goal=tolerance_lists, time=value.filter(lambda t: not math.isnan(t)))
def test_which_tolerance_holds(path, goal, time):
    result, warning = configured().overridden(path, goal, time)
    numbers = [n for t in (*path, *goal) for n in t[1:]] + [time]
    known = all(t.name in JOINTS for t in (*path, *goal))
    correct = known and all(n >= 0 or n == -1 for n in numbers)
    assert ("all tolerances are those of the parameters" in warning) == (not correct)
    for bounds, asked, place in ((result.path, path, 0), (result.goal, goal, 1)):
        wanted = {t.name: t for t in asked}
        for axis, joint in enumerate(JOINTS):
            mine = wanted.get(joint) if correct else None
            parameters = (PARAMETERS[joint][place] or math.inf, math.inf)
            limits = bounds.position[axis], bounds.velocity[axis]
            asked_for = (mine.position, mine.velocity) if mine else (0.0, 0.0)
            for limit, number, parameter in zip(limits, asked_for, parameters, strict=True):
                expected = parameter if number == 0 else math.inf if number == -1 else number
                assert limit == expected
    expected_time = 1.0 if not correct or time == 0 else math.inf if time == -1 else time
    assert result.goal_time_s == expected_time


def test_a_goal_time_of_zero_is_no_limit():
    assert configured(goal_time=0.0).goal_time_s == math.inf


@given(
    error=st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3),
    speed=st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3),
    limit=st.floats(1e-3, 1.0),
)
def test_a_violation_names_the_joint_that_is_worst(error, speed, limit):
    bounds = (
        configured()
        .overridden([JointTolerance("a", limit), JointTolerance("b", -1.0, 0.5)], [], 0.0)[0]
        .path
    )
    desired = np.array([0.25, -1.0, 0.1])
    words = bounds.violation(resting(desired), desired + error, np.array(speed))
    # As the difference of what is measured and desired, rounded as numbers are.
    off = np.abs(desired + error - desired)
    excess = {
        ("a", "position"): off[0] / limit,
        ("b", "velocity"): abs(speed[1]) / 0.5,
        ("slide", "position"): off[2] / 0.003,
    }
    worst = max(excess, key=lambda key: excess[key])
    assert bool(words) == (excess[worst] > 1)
    if words:
        tied = [f"joint '{j}': {q}" for (j, q), x in excess.items() if x == excess[worst]]
        assert any(words.startswith(start) for start in tied)


def test_the_words_say_by_how_much_and_whose_limit_it_is():
    tolerances, _ = configured().overridden([JointTolerance("a", 0.05)], [], 0.0)
    desired, measured = np.array([1.0, 0.0, 0.2]), np.array([1.06, 0.0, 0.2])
    assert tolerances.path.violation(resting(desired), measured, STILL) == (
        "joint 'a': position 1.06 rad is 0.06 rad away from 1, allowed 0.05 (path_tolerance)"
    )
    assert tolerances.goal.violation(resting(desired), desired + [0, 0, 0.002], STILL) == (
        "joint 'slide': position 0.202 m is 0.002 m away from 0.2, allowed 0.001 "
        "(constraints.slide.goal)"
    )
    assert not tolerances.path.violation(resting(desired), np.full(3, math.nan), STILL)


def test_what_no_drive_measures_is_said():
    _, warning = configured().overridden([JointTolerance("a", 0.0, 0.0, 1.0)], [], 0.0)
    assert "acceleration" in warning


@pytest.mark.parametrize(
    ("path", "time", "words"),
    [
        ([JointTolerance("arm", 0.1)], 0.0, "there is no joint 'arm'"),
        ([JointTolerance("a", -2.0)], 0.0, "joint 'a': position is -2"),
        ([], -0.5, "goal_time_tolerance is -0.5 s"),
    ],
)
def test_a_mistake_is_named(path, time, words):
    assert words in configured().overridden(path, [], time)[1]
