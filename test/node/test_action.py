"""`~/follow_joint_trajectory` as its clients see it: every outcome, by a real ActionClient, on
simulated drives. Codes: control_msgs/FollowJointTrajectory."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import pytest
import rclpy
from action_msgs.msg import GoalStatus
from builtin_interfaces.msg import Duration, Time
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.action import ActionClient
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.task import Future
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

pytest.importorskip("control_msgs", reason="control_msgs is not installed (test/interfaces/build)")

from control_msgs.action import FollowJointTrajectory  # noqa: E402
from control_msgs.msg import JointTolerance, JointTrajectoryControllerState  # noqa: E402
from control_msgs.srv import QueryTrajectoryState  # noqa: E402

from epos2_ros.node.driver import SWITCH_INTERVAL_S, DriverNode  # noqa: E402
from epos2_ros.node.lanes import events_executor, spin  # noqa: E402

WAIT_S = 30.0  # for something that must happen; reached only when it does not
START_S = 100.0  # likewise, with compiling the search for records on a busy machine
JOINTS = ("a", "b")
START_TOLERANCE = 0.01
MAX_VELOCITY = 3.0
Result = FollowJointTrajectory.Result
PARAMETERS = {
    "joints": list(JOINTS),
    "state_rate": 100.0,
    "can.channel": "action",
    "constraints.start_tolerance": START_TOLERANCE,
    **{
        f"axes.{joint}.{name}": value
        for joint in JOINTS
        for name, value in {
            "gear_ratio": 100.0,
            "max_velocity": MAX_VELOCITY,
            "max_acceleration": 15.0,
            "max_following_error": 10**9,  # a blocked axis is the action's to tell, here
        }.items()
    },
}


class World:
    """A driver node with simulated drives, and a client node."""

    def __init__(self, domain_id: int) -> None:
        self.context = Context()
        rclpy.init(args=[], context=self.context, domain_id=domain_id)
        overrides = [Parameter(name, value=value) for name, value in PARAMETERS.items()]
        self.node = DriverNode(context=self.context, parameter_overrides=overrides)
        self.client = Node("client", context=self.context)
        self._executors = [events_executor(self.context) for _ in range(2)]
        self._ended = Future()
        self._threads = []
        for executor, node in zip(self._executors, (self.node, self.client), strict=True):
            executor.add_node(node)
            loop = threading.Thread(target=spin, args=(executor, self._ended, self.node.broke))
            self._threads.append(loop)
            loop.start()
        name = "/epos2_driver/follow_joint_trajectory"
        self.action = ActionClient(self.client, FollowJointTrajectory, name)
        assert self.action.wait_for_server(WAIT_S)
        self.states: list[JointTrajectoryControllerState] = []
        self.wait(lambda: self.state == "active", START_S)

    @property
    def state(self) -> str:
        return str(self.node._state_machine.current_state[1])

    @property
    def simulation(self) -> Any:
        return self.node._driver._simulation

    @property
    def drives(self) -> list[Any]:
        """The simulated drives themselves."""
        return list(self.simulation._drives)

    def block(self, joint: str, blocked: bool = True) -> None:
        """The axis can't move, or can again."""
        with self.simulation._simulator.lock:
            self.drives[JOINTS.index(joint)].block_rotor(blocked)

    @property
    def here(self) -> np.ndarray:
        """Where the axes stand [rad]."""
        return (
            np.array([drive._motor.position for drive in self.drives]) * 2 * math.pi / (2000 * 100)
        )

    def wait(self, what: Callable[[], Any], seconds: float = WAIT_S) -> None:
        deadline = time.monotonic() + seconds
        while not what():
            assert time.monotonic() < deadline
            time.sleep(0.002)

    def done(self, future: Any) -> Any:
        self.wait(future.done)
        return future.result()

    def ask(self, question: Callable[..., Any], *arguments: Any) -> Any:
        """A future of rclpy's action client, made in the thread that will get the answer: it may
        come before rclpy has noted whose it is."""
        return self.done(self._executors[1].create_task(question, *arguments))

    def call(self, kind: Any, name: str, request: Any) -> Any:
        client = self.client.create_client(kind, f"/epos2_driver/{name}")
        assert client.wait_for_service(WAIT_S)
        answer = self.done(client.call_async(request))
        self.client.destroy_client(client)
        return answer

    def enable(self, on: bool) -> None:
        answer = self.call(SetBool, "enable", SetBool.Request(data=on))
        assert answer.success, answer.message

    def trigger(self, name: str) -> None:
        answer = self.call(Trigger, name, Trigger.Request())
        assert answer.success, answer.message

    def change(self, transition: int) -> None:
        request = ChangeState.Request(transition=Transition(id=transition))
        assert self.call(ChangeState, "change_state", request).success

    def send(self, goal: FollowJointTrajectory.Goal) -> Pursued:
        return Pursued(self, goal)

    def close(self) -> None:
        self.node.shut_down()
        self._ended.set_result(None)
        for thread in self._threads:
            thread.join(WAIT_S)
        for executor in self._executors:
            executor.shutdown()
        self.client.destroy_node()
        self.node.destroy_node()
        self.context.shutdown()


class Pursued:
    """A goal on its way."""

    def __init__(self, world: World, goal: FollowJointTrajectory.Goal) -> None:
        self.world = world
        self.feedback: list[FollowJointTrajectory.Feedback] = []
        self.handle = world.done(
            world.ask(
                world.action.send_goal_async, goal, lambda m: self.feedback.append(m.feedback)
            )
        )
        self._result = world.ask(self.handle.get_result_async) if self.handle.accepted else None

    @property
    def running(self) -> bool:
        return self._result is not None and not self._result.done()

    def cancel(self) -> None:
        answer = self.world.done(self.world.ask(self.handle.cancel_goal_async))
        assert answer.goals_canceling

    def ended(self) -> tuple[int, int, str]:
        """Status, error code and words."""
        assert self._result is not None, "the goal was rejected"
        answer = self.world.done(self._result)
        return answer.status, answer.result.error_code, answer.result.error_string


@pytest.fixture(scope="module")
def shared(module_domain_id: int) -> Iterator[World]:
    """One node for all: to bring it up takes longer than most of what is tried here."""
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    before = sys.getswitchinterval()
    sys.setswitchinterval(SWITCH_INTERVAL_S)  # as `main` does
    world = World(module_domain_id)
    yield world
    world.close()
    sys.setswitchinterval(before)


@pytest.fixture
def world(shared: World) -> Iterator[World]:
    """It is active, enabled and free to move, at the beginning as at the end."""
    yield shared
    for joint in JOINTS:
        shared.block(joint, False)
    shared.wait(lambda: all(abs(d._motor.position - d._demand) < 1 for d in shared.drives))
    if shared.state == "inactive":
        shared.change(Transition.TRANSITION_ACTIVATE)
    shared.trigger("halt")
    shared.trigger("reset_fault")
    shared.enable(True)


def seconds(value: float) -> Duration:
    sec, nanosec = divmod(round(value * 1e9), 10**9)
    return Duration(sec=sec, nanosec=nanosec)


def trajectory(
    points: Sequence[tuple[float, Sequence[float]]], joints: Sequence[str] = JOINTS
) -> JointTrajectory:
    """Points (time, positions), at rest at each."""
    return JointTrajectory(
        joint_names=list(joints),
        points=[
            JointTrajectoryPoint(
                positions=list(map(float, positions)),
                velocities=[0.0] * len(positions),
                time_from_start=seconds(t_s),
            )
            for t_s, positions in points
        ],
    )


def to(
    world: World, *target: float, in_s: float = 0.8, **fields: Any
) -> FollowJointTrajectory.Goal:
    """From where the axes stand by so much."""
    here = world.here
    points = [(0.0, here), (in_s, here + target)]
    return FollowJointTrajectory.Goal(trajectory=trajectory(points), **fields)


def tolerance(joint: str, position: float, velocity: float = 0.0) -> JointTolerance:
    return JointTolerance(name=joint, position=position, velocity=velocity)


# -- rejected: it says no motion ---------------------------------------------------------------


def change_of(**fields: Any) -> Callable[[World], JointTrajectory]:
    def make(world: World) -> JointTrajectory:
        message = to(world, 0.1, 0.1).trajectory
        for name, value in fields.items():
            setattr(message, name, value)
        return message

    return make


def wrong_point(**fields: Any) -> Callable[[World], JointTrajectory]:
    def make(world: World) -> JointTrajectory:
        message = to(world, 0.1, 0.1).trajectory
        for name, value in fields.items():
            setattr(message.points[1], name, value)
        return message

    return make


REJECTED = {
    "unknown joint": change_of(joint_names=["a", "elbow"]),
    "missing joint": lambda world: trajectory([(0.5, [world.here[0]])], ["a"]),
    "doubled joint": change_of(joint_names=["a", "a"]),
    "no joints": change_of(joint_names=[]),
    "no points": change_of(points=[]),
    "too few positions": wrong_point(positions=[0.0]),
    "too many velocities": wrong_point(velocities=[0.0, 0.0, 0.0]),
    "times not increasing": wrong_point(time_from_start=seconds(0.0)),
    "not a number": wrong_point(positions=[math.nan, 0.0]),
}


@pytest.mark.parametrize("malformed", REJECTED.values(), ids=REJECTED)
def test_what_says_no_motion_is_rejected(world, malformed):
    before = world.here
    goal = FollowJointTrajectory.Goal(trajectory=malformed(world))
    assert not world.send(goal).handle.accepted
    assert (world.here == before).all()


def test_what_ended_in_the_past_is_rejected(world):
    goal = to(world, 0.1, 0.1)
    now = world.client.get_clock().now().nanoseconds - 5 * 10**9
    goal.trajectory.header.stamp = Time(sec=now // 10**9, nanosec=now % 10**9)
    assert not world.send(goal).handle.accepted


def test_while_the_node_is_not_active_goals_are_rejected(world):
    goal = to(world, 0.1, 0.1)
    world.change(Transition.TRANSITION_DEACTIVATE)
    assert not world.send(goal).handle.accepted


# -- accepted, and aborted at once: it can't be run --------------------------------------------


def too_fast(world: World) -> FollowJointTrajectory.Goal:
    return to(world, 3.0, 0.0, in_s=0.5)


def elsewhere(world: World) -> FollowJointTrajectory.Goal:
    goal = to(world, 0.1, 0.1)
    goal.trajectory.points[0].positions[1] += 0.5
    return goal


def disabled(world: World) -> FollowJointTrajectory.Goal:
    world.enable(False)
    return to(world, 0.1, 0.1)


def of_frames(world: World) -> FollowJointTrajectory.Goal:
    goal = to(world, 0.1, 0.1)
    point = FollowJointTrajectory.Feedback().multi_dof_desired
    goal.multi_dof_trajectory.points = [point]
    return goal


def unfinished(world: World) -> FollowJointTrajectory.Goal:
    goal = to(world, 0.1, 0.1)
    goal.trajectory.points[1].velocities[1] = 0.5
    return goal


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (too_fast, "joint 'a'"),
        (elsewhere, "joint 'b', point 0"),
        (disabled, "disabled"),
        (of_frames, "multi_dof_trajectory"),
        (unfinished, "joint 'b', point 1: the last point still moves"),
    ],
    ids=["limit", "start", "not enabled", "frames", "unfinished"],
)
def test_what_can_not_be_run_is_aborted_with_the_reason(world, make, words):
    before = world.here
    status, code, said = world.send(make(world)).ended()
    assert (status, code) == (GoalStatus.STATUS_ABORTED, Result.INVALID_GOAL)
    assert words in said
    assert "\n" not in said
    assert world.here == pytest.approx(before, abs=1e-4)


def test_a_goal_that_can_not_be_run_leaves_the_one_in_progress_alone(world):
    first = world.send(to(world, 0.4, 0.0, in_s=1.0))
    time.sleep(0.2)
    assert world.send(too_fast(world)).ended()[0] == GoalStatus.STATUS_ABORTED
    assert first.ended()[:2] == (GoalStatus.STATUS_SUCCEEDED, Result.SUCCESSFUL)


# -- it is run ---------------------------------------------------------------------------------


def test_a_goal_that_is_reached_succeeds(world):
    before = world.here
    pursued = world.send(to(world, 0.2, -0.3))
    assert pursued.ended() == (GoalStatus.STATUS_SUCCEEDED, Result.SUCCESSFUL, "")
    assert world.here == pytest.approx(before + [0.2, -0.3], abs=1e-3)


def test_feedback_says_what_is_desired_and_what_is(world):
    before = world.here
    pursued = world.send(to(world, 0.4, -0.2))
    pursued.ended()
    assert len(pursued.feedback) > 20  # of 100 a second, on a machine that is busy
    for one in pursued.feedback:
        assert list(one.joint_names) == list(JOINTS)
        actual, desired, error = (
            np.array(p.positions) for p in (one.actual, one.desired, one.error)
        )
        assert error == pytest.approx(desired - actual)
        assert np.abs(error).max() < 0.01
        for point in (one.desired, one.actual, one.error):
            assert len(point.velocities) == 2
            assert point.time_from_start == one.desired.time_from_start
    first, last = pursued.feedback[0], pursued.feedback[-1]
    assert list(first.desired.positions) == pytest.approx(before, abs=1e-3)
    assert list(last.desired.positions) == pytest.approx(before + [0.4, -0.2], abs=0.02)
    times = [p.desired.time_from_start for p in pursued.feedback]
    times_s = [t.sec + t.nanosec / 1e9 for t in times]
    assert times_s == sorted(times_s)
    assert times_s[-1] == pytest.approx(0.8, abs=0.1)


def test_the_result_comes_when_the_axes_rest(world):
    pursued = world.send(to(world, 0.5, 0.0, in_s=0.7))
    pursued.ended()
    at_once = world.here
    time.sleep(0.1)
    assert world.here == pytest.approx(at_once, abs=1e-4)


def test_off_its_path_it_stops_and_says_by_how_much(world):
    goal = to(world, 1.5, 0.5, in_s=2.0, path_tolerance=[tolerance("a", 0.05)])
    pursued = world.send(goal)
    time.sleep(0.7)
    world.block("a")
    status, code, words = pursued.ended()
    assert (status, code) == (GoalStatus.STATUS_ABORTED, Result.PATH_TOLERANCE_VIOLATED)
    assert "joint 'a'" in words
    assert "allowed 0.05" in words
    assert "rad away" in words
    at_once = world.here[1]
    time.sleep(0.1)
    assert world.here[1] == pytest.approx(at_once, abs=1e-4)


def test_not_at_its_goal_it_says_by_how_much_after_the_goal_time(world):
    goal = to(
        world, 0.2, 0.1, goal_tolerance=[tolerance("a", 0.01)], goal_time_tolerance=seconds(0.3)
    )
    world.block("a")
    pursued = world.send(goal)
    status, code, words = pursued.ended()
    assert (status, code) == (GoalStatus.STATUS_ABORTED, Result.GOAL_TOLERANCE_VIOLATED)
    assert "joint 'a'" in words
    assert "0.2 rad away" in words
    assert "allowed 0.01 (goal_tolerance)" in words


def test_reached_within_the_goal_time_it_succeeds(world):
    world.block("a")
    pursued = world.send(
        to(world, 0.2, 0.1, goal_tolerance=[tolerance("a", 0.01)], goal_time_tolerance=seconds(20))
    )
    time.sleep(2.0)
    assert pursued.running
    world.block("a", False)
    assert pursued.ended()[:2] == (GoalStatus.STATUS_SUCCEEDED, Result.SUCCESSFUL)


def test_without_tolerances_a_blocked_axis_is_no_matter_of_the_action(world):
    world.block("a")
    pursued = world.send(to(world, 0.1, 0.1))
    assert pursued.ended()[:2] == (GoalStatus.STATUS_SUCCEEDED, Result.SUCCESSFUL)


# -- it is ended -------------------------------------------------------------------------------


def test_canceled_when_at_rest_on_its_path(world):
    before = world.here
    pursued = world.send(to(world, 1.0, -0.5, in_s=2.5))
    time.sleep(0.8)
    pursued.cancel()
    status, code, _ = pursued.ended()
    at_rest = world.here
    assert (status, code) == (GoalStatus.STATUS_CANCELED, Result.SUCCESSFUL)
    time.sleep(0.1)
    assert world.here == pytest.approx(at_rest, abs=1e-4)
    done = (at_rest - before) / [1.0, -0.5]
    assert 0.1 < done[0] < 0.95
    assert done[0] == pytest.approx(done[1], abs=2e-3)  # both as far along it


def test_canceled_before_it_begins(world):
    before = world.here
    goal = to(world, 0.2, 0.2)
    now = world.client.get_clock().now().nanoseconds + 3 * 10**9
    goal.trajectory.header.stamp = Time(sec=now // 10**9, nanosec=now % 10**9)
    pursued = world.send(goal)
    pursued.cancel()
    assert pursued.ended()[0] == GoalStatus.STATUS_CANCELED
    assert world.here == pytest.approx(before, abs=1e-4)


def test_a_new_goal_takes_over(world):
    before = world.here
    first = world.send(to(world, 1.0, 0.0, in_s=2.0))
    time.sleep(0.6)
    goal = FollowJointTrajectory.Goal(trajectory=trajectory([(2.5, before + [0.4, 0.1])]))
    second = world.send(goal)
    status, code, words = first.ended()
    assert (status, code) == (GoalStatus.STATUS_ABORTED, Result.INVALID_GOAL)
    assert "another trajectory has taken over" in words
    assert second.running  # the first has ended although the axes move
    assert second.ended()[0] == GoalStatus.STATUS_SUCCEEDED
    assert world.here == pytest.approx(before + [0.4, 0.1], abs=1e-3)


def test_a_trajectory_on_the_topic_takes_over(world):
    before = world.here
    publisher = world.client.create_publisher(JointTrajectory, "/epos2_driver/joint_trajectory", 10)
    world.wait(publisher.get_subscription_count)
    pursued = world.send(to(world, 1.0, 0.0, in_s=2.0))
    time.sleep(0.5)
    publisher.publish(trajectory([(2.5, before + [0.3, 0.0])]))
    status, code, words = pursued.ended()
    assert (status, code) == (GoalStatus.STATUS_ABORTED, Result.INVALID_GOAL)
    assert "taken over" in words
    world.wait(lambda: world.here == pytest.approx(before + [0.3, 0.0], abs=1e-3))


@pytest.mark.parametrize(
    ("request_", "words"),
    [
        (lambda world: world.trigger("halt"), "halted on request"),
        (lambda world: world.trigger("quick_stop"), "quick stop"),
        (lambda world: world.change(Transition.TRANSITION_DEACTIVATE), "disabled"),
        (lambda world: world.enable(False), "disabled"),
    ],
    ids=["halt", "quick stop", "deactivate", "disable"],
)
def test_other_ends_are_told_with_their_reason(world, request_, words):
    pursued = world.send(to(world, 1.0, 0.0, in_s=2.0))
    time.sleep(0.5)
    request_(world)
    status, code, said = pursued.ended()
    assert (status, code) == (GoalStatus.STATUS_ABORTED, Result.INVALID_GOAL)
    assert words in said


def test_a_fault_of_a_drive_is_told(world):
    pursued = world.send(to(world, 1.0, 0.0, in_s=2.0))
    time.sleep(0.5)
    with world.simulation._simulator.lock:
        world.drives[1].fail(0x2310)
    status, code, said = pursued.ended()
    assert (status, code) == (GoalStatus.STATUS_ABORTED, Result.INVALID_GOAL)
    assert "b (node 2)" in said
    assert "over-current" in said


def test_goals_that_come_faster_than_they_can_be_run(world):
    """Each takes over from the one before; the last one is reached, and nobody else waits."""
    before = world.here
    goals = [
        FollowJointTrajectory.Goal(trajectory=trajectory([(1.5, before + [0.02 * n, 0.0])]))
        for n in range(1, 16)
    ]
    answers = [world.ask(world.action.send_goal_async, goal) for goal in goals]
    results = [world.ask(world.done(answer).get_result_async) for answer in answers]
    ends = [world.done(result) for result in results]
    assert ends[-1].status == GoalStatus.STATUS_SUCCEEDED
    for end in ends[:-1]:
        assert end.status == GoalStatus.STATUS_ABORTED
        assert "another" in end.result.error_string
    assert world.here == pytest.approx(before + [0.3, 0.0], abs=1e-3)


# -- MoveIt ------------------------------------------------------------------------------------


def moveit_execute(world: World, message: JointTrajectory) -> tuple[int, int, str]:
    """As MoveIt's simple controller manager and its trajectory execution manager: the goal has no
    tolerances, its acceptance is waited for, and after 1.1 times its duration and 0.5 s it is
    cancelled."""
    last = message.points[-1].time_from_start
    patience_s = 1.1 * (last.sec + last.nanosec / 1e9) + 0.5
    pursued = world.send(FollowJointTrajectory.Goal(trajectory=message))
    assert pursued.handle.accepted
    deadline = time.monotonic() + patience_s
    while pursued.running and time.monotonic() < deadline:
        time.sleep(0.005)
    if pursued.running:
        pursued.cancel()
    return pursued.ended()


def test_moveit_plans_are_executed_one_after_the_other(world):
    for turn in (0.3, -0.3, 0.15):
        here = world.here
        times = np.arange(0, 1.0001, 0.1)  # as sampled by MoveIt's time parameterization
        share = 3 * times**2 - 2 * times**3
        slope = 6 * times - 6 * times**2
        message = JointTrajectory(
            joint_names=list(JOINTS),
            points=[
                JointTrajectoryPoint(
                    positions=(here + s * np.array([turn, -turn])).tolist(),
                    velocities=[v * turn, -v * turn],
                    time_from_start=seconds(t),
                )
                for t, s, v in zip(times, share, slope, strict=True)
            ],
        )
        assert moveit_execute(world, message) == (
            GoalStatus.STATUS_SUCCEEDED,
            Result.SUCCESSFUL,
            "",
        )


# -- the state ---------------------------------------------------------------------------------


def test_the_state_of_the_controller(world):
    states: list[JointTrajectoryControllerState] = []
    topic = "/epos2_driver/controller_state"
    subscription = world.client.create_subscription(
        JointTrajectoryControllerState, topic, states.append, 10
    )
    world.wait(lambda: states)
    before = world.here
    world.send(to(world, 0.3, 0.0)).ended()
    world.wait(lambda: list(states[-1].reference.positions) == pytest.approx(before + [0.3, 0.0]))
    world.client.destroy_subscription(subscription)
    for one in states:
        assert list(one.joint_names) == list(JOINTS)
        error = np.array(one.reference.positions) - one.feedback.positions
        assert list(one.error.positions) == pytest.approx(error)
        assert one.output == one.reference
    assert max(one.reference.velocities[0] for one in states) > 0.4
    stamps_s = np.array([one.header.stamp.sec + one.header.stamp.nanosec / 1e9 for one in states])
    assert (np.diff(stamps_s) > -1e-6).all()  # one that is shown twice, by two readings of a clock


def test_the_state_at_a_time(world):
    before = world.here
    pursued = world.send(to(world, 0.4, 0.0, in_s=1.0))
    begins = world.client.get_clock().now()
    time.sleep(0.3)

    def query(after_s: float) -> QueryTrajectoryState.Response:
        ns = begins.nanoseconds + round(after_s * 1e9)
        at = Time(sec=ns // 10**9, nanosec=ns % 10**9)
        return world.call(
            QueryTrajectoryState, "query_state", QueryTrajectoryState.Request(time=at)
        )

    past, middle, end = query(-0.5), query(0.55), query(10.0)
    assert list(past.position) == pytest.approx(before, abs=1e-3)
    assert before[0] + 0.1 < middle.position[0] < before[0] + 0.4
    assert middle.velocity[0] > 0.2
    assert len(middle.acceleration) == 2
    assert list(end.position) == pytest.approx(before + [0.4, 0.0], abs=1e-3)
    assert list(end.velocity) == [0.0, 0.0]
    assert list(middle.name) == list(JOINTS)
    assert all(answer.success for answer in (past, middle, end))
    pursued.ended()
    now = world.call(QueryTrajectoryState, "query_state", QueryTrajectoryState.Request())
    assert list(now.position) == pytest.approx(before + [0.4, 0.0], abs=1e-3)
    world.change(Transition.TRANSITION_DEACTIVATE)
    refused = world.call(QueryTrajectoryState, "query_state", QueryTrajectoryState.Request())
    assert not refused.success
    assert "not active" in refused.message


# -- processes of their own --------------------------------------------------------------------


def test_without_control_msgs_the_driver_runs(ros_env):
    """In a process where it can't be imported."""
    script = (
        "import sys; sys.modules['control_msgs'] = None\n"
        "import rclpy; rclpy.init()\n"
        "from epos2_ros.node.driver import DriverNode\n"
        "from rclpy.lifecycle import TransitionCallbackReturn\n"
        "from rclpy.parameter import Parameter\n"
        "node = DriverNode(parameter_overrides=[Parameter('autostart', value=False)])\n"
        "assert node.trigger_configure() == TransitionCallbackReturn.SUCCESS\n"
        "assert node.trigger_activate() == TransitionCallbackReturn.SUCCESS\n"
        "print(*(name for name, _ in node.get_service_names_and_types_by_node(\n"
        "    'epos2_driver', '/')))\n"
        "node.shut_down(); rclpy.shutdown()\n"
    )
    ended = subprocess.run(
        [sys.executable, "-c", script], env=ros_env, capture_output=True, text=True, timeout=60
    )
    assert ended.returncode == 0, ended.stderr
    assert "/epos2_driver/halt" in ended.stdout
    assert "query_state" not in ended.stdout


def test_a_client_is_told_when_the_driver_is_ended(ros_env, ros_domain_id):
    """Ctrl-C in the middle of a motion: the axes stop on their path, and then the goal ends."""
    driver = subprocess.Popen(
        [sys.executable, "-m", "epos2_ros", "driver", "--ros-args", "-p", "joints:=[a, b]"],
        env=ros_env,
    )
    context = Context()
    rclpy.init(args=[], context=context, domain_id=ros_domain_id)
    node, executor = Node("client", context=context), SingleThreadedExecutor(context=context)
    executor.add_node(node)
    try:
        name = "/epos2_driver/follow_joint_trajectory"
        action = ActionClient(node, FollowJointTrajectory, name)
        assert action.wait_for_server(START_S)
        message = trajectory([(0.0, (0.0, 0.0)), (6.0, (20.0, -20.0))])
        moving = threading.Event()
        deadline = time.monotonic() + START_S
        while True:  # until the driver has activated itself
            answer = action.send_goal_async(
                FollowJointTrajectory.Goal(trajectory=message),
                lambda m: m.feedback.desired.time_from_start.sec and moving.set(),
            )
            executor.spin_until_future_complete(answer, WAIT_S)
            if answer.result().accepted:
                break
            assert time.monotonic() < deadline
            executor.spin_once(0.1)
        result = answer.result().get_result_async()
        while not moving.is_set():
            executor.spin_once(0.1)
            assert time.monotonic() < deadline
        driver.send_signal(signal.SIGINT)
        executor.spin_until_future_complete(result, WAIT_S)
        assert result.done()
        assert result.result().status == GoalStatus.STATUS_ABORTED
        assert "stopped on the path" in result.result().result.error_string
        assert driver.wait(WAIT_S) == 0
    finally:
        driver.kill()
        driver.wait()
        executor.shutdown()
        node.destroy_node()
        context.shutdown()
