"""The action `~/follow_joint_trajectory`, and `~/controller_state` and `~/query_state` beside it.

As joint_trajectory_controller, with these rules of its own:

* A goal that says no motion is rejected. One that says a motion which can't be run is accepted and
  aborted at once: `error_string` is the only place where a user of MoveIt sees a reason.
* A goal ends when its axes rest, or when another trajectory has taken over.
* Trajectories are submitted in the order in which they were accepted, by one thread; each goal is
  then pursued in a thread of its own. Those of the executor are left to the other callbacks.

Needs control_msgs; nothing else of the package does.
"""

from __future__ import annotations

import threading
import time
import traceback
from collections.abc import Callable, Iterable
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from functools import partial
from typing import Any

from builtin_interfaces.msg import Duration, Time
from control_msgs.action import FollowJointTrajectory
from control_msgs.msg import JointTrajectoryControllerState
from control_msgs.srv import QueryTrajectoryState
from numpy.typing import NDArray
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import GoalEvent, ServerGoalHandle
from rclpy.lifecycle import LifecycleNode
from trajectory_msgs.msg import JointTrajectoryPoint

from epos2_ros.bus.driver import Driver
from epos2_ros.bus.tracking import Tracking
from epos2_ros.configuration.driver import DriverConfig
from epos2_ros.errors import Epos2RosError, TrajectoryError, UnfinishedTrajectory
from epos2_ros.motion.tolerance import JointTolerance, Tolerances
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.node.goal import CANCELED_EARLY, INVALID_GOAL, Outcome, Pursuit, Status, refused
from epos2_ros.node.lanes import Lanes
from epos2_ros.protocol.execution import Execution

CLOSING_S = 1.0  # for clients to be told the last results when the node ends
CANCEL_POLL_S = 0.001  # rclpy has no event for a goal's having become "canceling"

_SETTLE: dict[Status, Callable[[ServerGoalHandle], None]] = {
    Status.SUCCEEDED: ServerGoalHandle.succeed,
    Status.ABORTED: ServerGoalHandle.abort,
    Status.CANCELED: ServerGoalHandle.canceled,
}


class _Goal:
    """An accepted goal that has not ended."""

    def __init__(self, handle: ServerGoalHandle, tolerances: Tolerances) -> None:
        self.handle = handle
        self.tolerances = tolerances
        self.submitted: Future[tuple[Driver, Execution]] = Future()
        self.canceled = False
        self.news = threading.Event()  # something has happened: look at it before its time
        self.told = threading.Event()  # the client can have the result


class TrajectoryAction:
    """The action server of a node.

    `active_driver()` raises Epos2RosError while the node is not active; `to_ros` and `to_host`
    turn host time [µs] into ROS time and back.
    """

    def __init__(
        self,
        node: LifecycleNode,
        lanes: Lanes,
        active_driver: Callable[[], Driver],
        received: Callable[[Trajectory], Trajectory],
        to_ros: Callable[[float], Time],
        to_host: Callable[[Time], float],
    ) -> None:
        self._node = node
        self._active_driver = active_driver
        self._received = received
        self._to_ros = to_ros
        self._to_host = to_host
        self._goal_time_s = self._period_s = 0.0
        # What is accepted next: its request, and how it can be run, or why not.
        self._checked: tuple[Any, Trajectory | TrajectoryError, Tolerances] | None = None
        self._goals: list[_Goal] = []
        self._submitting = ThreadPoolExecutor(1, thread_name_prefix="goals")
        self._state = node.create_publisher(
            JointTrajectoryControllerState, "~/controller_state", 10
        )
        lanes.answers(
            "query", node.create_service(QueryTrajectoryState, "~/query_state", self._on_query)
        )
        self._server = ActionServer(
            node,
            FollowJointTrajectory,
            # rcl applies remapping rules to an action's topics and services, not to its name.
            node.resolve_service_name("~/follow_joint_trajectory"),
            execute_callback=lambda handle: FollowJointTrajectory.Result(),
            goal_callback=self._on_goal,
            handle_accepted_callback=self._on_accepted,
            cancel_callback=self._on_cancel,
        )

    def configured(self, config: DriverConfig) -> None:
        """Its tolerances and rates hold from now on."""
        self._goal_time_s, self._period_s = config.goal_time, 1.0 / config.state_rate

    def close(self) -> None:
        """Wait until all clients can have their results; the axes have to rest by then."""
        until_s = time.monotonic() + CLOSING_S
        for goal in list(self._goals):
            goal.news.set()
            goal.told.wait(max(0.0, until_s - time.monotonic()))
        self._submitting.shutdown(wait=False, cancel_futures=True)

    # -- goals -------------------------------------------------------------------------------

    def _on_goal(self, goal: FollowJointTrajectory.Goal) -> GoalResponse:
        try:
            driver = self._active_driver()
            trajectory = self._trajectory_of(goal)
            if isinstance(trajectory, Trajectory):
                driver.check(trajectory)
        except Epos2RosError as error:
            self._log().error(f"goal rejected: {error}")
            return GoalResponse.REJECT
        parameters = Tolerances.of(driver.trajectory_axes, self._goal_time_s)
        tolerances, warning = parameters.overridden(
            list(map(_tolerance, goal.path_tolerance)),
            list(map(_tolerance, goal.goal_tolerance)),
            goal.goal_time_tolerance.sec + goal.goal_time_tolerance.nanosec / 1e9,
        )
        if warning:
            self._log().warning(f"goal: {warning}")
        self._checked = goal, trajectory, tolerances
        return GoalResponse.ACCEPT

    def _trajectory_of(self, goal: FollowJointTrajectory.Goal) -> Trajectory | TrajectoryError:
        """How it is to be run, or why it can't be; raises TrajectoryError if it says no motion."""
        if goal.multi_dof_trajectory.points:
            return TrajectoryError("multi_dof_trajectory has points; this driver moves joints only")
        try:
            trajectory = self._received(Trajectory.from_message(goal.trajectory))
        except UnfinishedTrajectory as error:
            return error
        if not len(trajectory.times_s):
            raise TrajectoryError("the trajectory has no points; cancel a goal to stop it")
        return trajectory

    def _on_accepted(self, handle: ServerGoalHandle) -> None:
        assert self._checked is not None
        request, trajectory, tolerances = self._checked
        assert handle.request is request
        self._checked = None
        # rclpy keeps the request for 15 minutes; its points have been read.
        request.trajectory.points = []
        goal = _Goal(handle, tolerances)
        self._goals.append(goal)
        handle._update_state(GoalEvent.EXECUTE)
        goal.submitted = self._submitting.submit(self._submit, trajectory)
        threading.Thread(target=self._pursue, args=(goal,), name="goal", daemon=True).start()

    def _on_cancel(self, handle: ServerGoalHandle) -> CancelResponse:
        for goal in list(self._goals):
            if goal.handle is handle:
                goal.canceled = True
                goal.submitted.cancel()
                goal.news.set()
        return CancelResponse.ACCEPT

    def _submit(self, trajectory: Trajectory | TrajectoryError) -> tuple[Driver, Execution]:
        if isinstance(trajectory, TrajectoryError):
            raise trajectory
        driver = self._active_driver()
        execution = driver.submit(trajectory)
        assert execution is not None
        return driver, execution

    def _pursue(self, goal: _Goal) -> None:
        """In the goal's own thread, until it ends."""
        try:
            outcome = self._outcome(goal)
        except Epos2RosError as error:  # the bus has been closed meanwhile
            outcome = Outcome(Status.ABORTED, INVALID_GOAL, str(error))
        except Exception:
            outcome = Outcome(Status.ABORTED, INVALID_GOAL, "an error of the driver; see its log")
            self._log().fatal(f"goal failed:\n{traceback.format_exc()}")
        if outcome.status is Status.ABORTED:
            self._log().error(f"goal aborted: {outcome.words}")
        while outcome.status is Status.CANCELED and not goal.handle.is_cancel_requested:
            time.sleep(CANCEL_POLL_S)
        self._server.notify_execute(goal.handle, partial(self._tell, goal, outcome))

    def _outcome(self, goal: _Goal) -> Outcome:
        try:
            driver, execution = goal.submitted.result()
        except CancelledError:
            return CANCELED_EARLY
        except Epos2RosError as error:
            return refused(error)
        execution.ended.add_done_callback(lambda ended: goal.news.set())
        pursuit, stopped = Pursuit(execution, goal.tolerances), False
        due_s = time.monotonic()
        while True:
            goal.news.clear()
            if goal.canceled:
                pursuit.cancel()
            tracking = driver.track()
            outcome = pursuit.look(tracking)
            if outcome is not None:
                return outcome
            if pursuit.stop_for and not stopped:
                driver.cancel(execution, pursuit.stop_for)
                stopped = True
            if time.monotonic() >= due_s:
                goal.handle.publish_feedback(self._feedback(tracking, execution))
                due_s = max(due_s + self._period_s, time.monotonic())
            goal.news.wait(due_s - time.monotonic())

    def _tell(
        self, goal: _Goal, outcome: Outcome, handle: ServerGoalHandle
    ) -> FollowJointTrajectory.Result:
        """In the executor: the goal's last state, and what its client gets."""
        _SETTLE[outcome.status](handle)
        self._goals.remove(goal)
        goal.told.set()
        return FollowJointTrajectory.Result(error_code=outcome.code, error_string=outcome.words)

    def _feedback(self, tracking: Tracking, execution: Execution) -> FollowJointTrajectory.Feedback:
        feedback = FollowJointTrajectory.Feedback(joint_names=list(tracking.joints))
        feedback.header.stamp = self._to_ros(tracking.stamp_us)
        at_s = tracking.time_from_start_s(execution)
        feedback.desired, feedback.actual, feedback.error = _points(tracking, at_s)
        return feedback

    # -- the state ---------------------------------------------------------------------------

    def publish_state(self, driver: Driver) -> None:
        """`~/controller_state`, where somebody wants it."""
        if not self._state.get_subscription_count():
            return
        tracking = driver.track()
        message = JointTrajectoryControllerState(
            joint_names=list(tracking.joints), speed_scaling_factor=1.0
        )
        message.header.stamp = self._to_ros(tracking.stamp_us)
        execution = tracking.execution
        at_s = 0.0 if execution is None else tracking.time_from_start_s(execution)
        message.reference, message.feedback, message.error = _points(tracking, at_s)
        message.output = message.reference
        self._state.publish(message)

    def _on_query(
        self, request: QueryTrajectoryState.Request, response: QueryTrajectoryState.Response
    ) -> QueryTrajectoryState.Response:
        """What is commanded at a time, from shortly before now on; time zero is now."""
        try:
            tracking = self._active_driver().track()
            at_us = tracking.now_us
            if request.time.sec or request.time.nanosec:
                at_us = self._to_host(request.time)
            state = tracking.commanded(at_us)
        except Epos2RosError as error:
            response.success, response.message = False, str(error)
            return response
        response.success, response.name = True, list(tracking.joints)
        response.position, response.velocity, response.acceleration = (
            values.tolist() for values in state
        )
        return response

    def _log(self) -> Any:
        return self._node.get_logger()


def _tolerance(message: Any) -> JointTolerance:
    return JointTolerance(message.name, message.position, message.velocity, message.acceleration)


def _points(tracking: Tracking, at_s: float) -> Iterable[JointTrajectoryPoint]:
    """Desired, actual, and desired minus actual."""
    desired, position, velocity = tracking.desired, tracking.position, tracking.velocity
    yield _point(at_s, *desired)
    yield _point(at_s, position, velocity)
    yield _point(at_s, desired.position - position, desired.velocity - velocity)


def _point(at_s: float, *values: NDArray[Any]) -> JointTrajectoryPoint:
    """Of positions, velocities and accelerations, as many as there are."""
    fields = dict(zip(("positions", "velocities", "accelerations"), values, strict=False))
    sec, nanosec = divmod(round(at_s * 1e9), 10**9)
    return JointTrajectoryPoint(
        time_from_start=Duration(sec=sec, nanosec=nanosec),
        **{name: row.tolist() for name, row in fields.items()},
    )
