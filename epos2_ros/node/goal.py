"""One goal of `~/follow_joint_trajectory`, from its acceptance to its outcome. Without rclpy.

Error codes: control_msgs/FollowJointTrajectory. Where two things have gone wrong the first counts.
"""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

from epos2_ros.bus.tracking import Tracking
from epos2_ros.errors import MotionStopped, TrajectoryError
from epos2_ros.motion.tolerance import Tolerances
from epos2_ros.protocol.execution import Execution

SUCCESSFUL = 0
PATH_TOLERANCE_VIOLATED = -4
GOAL_TOLERANCE_VIOLATED = -5
INVALID_GOAL = TrajectoryError.INVALID_GOAL


class Status(Enum):
    """A goal's last state: action_msgs/GoalStatus."""

    SUCCEEDED = "succeeded"
    ABORTED = "aborted"
    CANCELED = "canceled"


class Outcome(NamedTuple):
    """What the client is told."""

    status: Status
    code: int
    words: str


CANCELED_EARLY = Outcome(Status.CANCELED, SUCCESSFUL, "canceled before it began")


def refused(error: Exception) -> Outcome:
    """The trajectory says a motion, but not one that can be run."""
    code = error.code if isinstance(error, TrajectoryError) else INVALID_GOAL
    return Outcome(Status.ABORTED, code, str(error))


class Pursuit:
    """A goal whose trajectory has been taken.

    `look` at it while it lasts; the axes are to stop on their path when `stop_for` says why.
    """

    def __init__(self, execution: Execution, tolerances: Tolerances) -> None:
        self._execution = execution
        self._tolerances = tolerances
        self._violation = ""
        self._canceled = False
        self._arrived_us: float | None = None

    def cancel(self) -> None:
        """The client wants it to end."""
        self._canceled = True

    @property
    def stop_for(self) -> str:
        """Why the axes are to stop on their path; "": they are not to."""
        return self._violation or ("the goal was canceled" if self._canceled else "")

    def look(self, now: Tracking) -> Outcome | None:
        """How the axes are doing now; what it all ends with, once it does and they rest."""
        if self._execution.ended.done():
            return self._end(now)
        if not self.stop_for:
            off = self._tolerances.path.violation(now.desired, now.position, now.velocity)
            if off:
                at_s = now.time_from_start_s(self._execution)
                self._violation = f"off its path at {at_s:.3f} s: {off}"
        return None

    def _end(self, now: Tracking) -> Outcome | None:
        error = self._execution.ended.exception()
        if self._violation:
            return Outcome(Status.ABORTED, PATH_TOLERANCE_VIOLATED, self._violation)
        if self._canceled and (error is None or isinstance(error, MotionStopped)):
            return Outcome(Status.CANCELED, SUCCESSFUL, f"canceled: {error or 'at its end'}")
        if error is not None:
            return Outcome(Status.ABORTED, INVALID_GOAL, str(error))
        return self._settled(now)

    def _settled(self, now: Tracking) -> Outcome | None:
        """All axes have arrived: are they near enough to their goal by now?"""
        goal = self._tolerances.goal
        if self._arrived_us is None:
            self._arrived_us = now.now_us
        if now.execution is not self._execution and goal.any:
            words = f"given up before it was within its goal tolerance: {now.state}"
            return Outcome(Status.ABORTED, INVALID_GOAL, words)
        off = goal.any and goal.violation(now.commanded(now.now_us), now.position, now.velocity)
        # Nobody is blamed for a report that is older than the end, nor praised.
        reported = not goal.any or now.reported_us.min() >= self._arrived_us
        if reported and not off:
            return Outcome(Status.SUCCEEDED, SUCCESSFUL, "")
        waited_s = (now.now_us - self._arrived_us) / 1e6
        if waited_s < self._tolerances.goal_time_s or not reported:
            return None
        words = f"not at its goal {waited_s:.3f} s after its end: {off}"
        return Outcome(Status.ABORTED, GOAL_TOLERANCE_VIOLATED, words)
