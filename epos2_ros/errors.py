"""The exception family of the package.

Every message is one line that a robot builder can act on: what is wrong, where,
and what is allowed.
"""


class Epos2RosError(Exception):
    """Base of everything this package raises on purpose."""


class ConfigurationError(Epos2RosError):
    """A parameter is unknown, of the wrong type or out of range."""


class TrajectoryError(Epos2RosError):
    """A trajectory is refused; the motion in progress goes on untouched.

    `code` is the matching error code of control_msgs/FollowJointTrajectory.
    """

    INVALID_GOAL = -1
    INVALID_JOINTS = -2
    OLD_HEADER_TIMESTAMP = -3

    def __init__(self, message: str, code: int = INVALID_GOAL) -> None:
        super().__init__(message)
        self.code = code


class UnfinishedTrajectory(TrajectoryError):
    """It says a motion, but not how that ends: its last point still moves."""


class BusError(Epos2RosError):
    """The CAN interface can't be opened, or the bus stopped working."""


class DriveError(Epos2RosError):
    """A drive does not answer, is the wrong device, or refuses what it is told."""


class MotionAborted(Epos2RosError):
    """A motion in progress was stopped; the message says by whom and why."""


class MotionStopped(MotionAborted):
    """It was stopped on its path, cancelled before it began, or replaced by another."""
