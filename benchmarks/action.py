"""How long a goal of the action waits for its answer, and its motion for its start.

    python -m benchmarks.action                  # docs/moveit.md

Beside the driver a bare rclpy server that accepts everything: what rclpy takes by itself, most of
it to make Python objects of the points. Both are processes of their own and are asked in turn. The
long goals begin where the robot is not: they are accepted and then aborted, and nothing moves.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import rclpy
from builtin_interfaces.msg import Duration
from control_msgs.action import FollowJointTrajectory
from rclpy.action import ActionClient, ActionServer
from rclpy.executors import MultiThreadedExecutor, SingleThreadedExecutor
from rclpy.node import Node
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

JOINTS = [f"joint_{n}" for n in range(1, 7)]
BARE, DRIVER = "/bare/follow_joint_trajectory", "/epos2_driver/follow_joint_trajectory"
POINTS = (100, 1_000, 5_000, 10_000)
WAIT_S = 60.0


def bare() -> None:
    """The server that accepts everything."""

    def execute(handle: Any) -> FollowJointTrajectory.Result:
        handle.abort()
        return FollowJointTrajectory.Result()

    rclpy.init()
    node = Node("bare")
    ActionServer(node, FollowJointTrajectory, BARE, execute)
    executor = MultiThreadedExecutor(4)
    executor.add_node(node)
    executor.spin()


def goal(points: int, away: float) -> FollowJointTrajectory.Goal:
    """A slow sine of six joints at 100 Hz, `away` [rad] from where a new driver stands."""
    t = np.arange(points) / 100
    swing = 0.02 * np.sin(np.pi * t / t[-1])[:, None] ** 2 * np.arange(1, 1 + len(JOINTS)) + away
    velocities = np.gradient(swing, t, axis=0)
    velocities[[0, -1]] = 0.0
    return FollowJointTrajectory.Goal(
        trajectory=JointTrajectory(
            joint_names=JOINTS,
            points=[
                JointTrajectoryPoint(
                    positions=position.tolist(),
                    velocities=velocity.tolist(),
                    time_from_start=Duration(sec=k // 100, nanosec=k % 100 * 10**7),
                )
                for k, (position, velocity) in enumerate(zip(swing, velocities, strict=True))
            ],
        )
    )


class Client:
    """Sends goals and waits for their answers."""

    def __init__(self) -> None:
        self._node = Node("client")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._actions = {
            name: ActionClient(self._node, FollowJointTrajectory, name) for name in (BARE, DRIVER)
        }

    def connect(self) -> None:
        """Returns when both servers accept goals."""
        for name, action in self._actions.items():
            if not action.wait_for_server(WAIT_S):
                raise SystemExit(f"{name} has not come up")
            while self.send(name, goal(2, 1.0))[0] is None:
                time.sleep(0.1)  # the driver is not active yet

    def send(self, name: str, what: FollowJointTrajectory.Goal) -> tuple[float | None, float]:
        """How long answer and motion took [s]; None for a rejection, NaN where nothing moved."""
        moved: list[float] = []
        begun_s = time.monotonic()

        def on_feedback(message: Any) -> None:
            if not moved and message.feedback.desired.time_from_start.nanosec:
                moved.append(time.monotonic() - begun_s)

        answer = self._actions[name].send_goal_async(what, on_feedback)
        self._executor.spin_until_future_complete(answer, WAIT_S)
        took_s = time.monotonic() - begun_s
        if not answer.result().accepted:
            return None, float("nan")
        ended = answer.result().get_result_async()
        self._executor.spin_until_future_complete(ended, WAIT_S)
        return took_s, moved[0] if moved else float("nan")


@contextmanager
def servers() -> Iterator[Client]:
    """Both, up and ready."""
    commands = (["-m", "benchmarks.action", "--bare"], ["-m", "epos2_ros", "driver"])
    processes = [
        subprocess.Popen([sys.executable, *command], stderr=subprocess.DEVNULL)
        for command in commands
    ]
    rclpy.init()
    try:
        client = Client()
        client.connect()
        yield client
    finally:
        for process in processes:
            process.kill()
            process.wait()
        rclpy.try_shutdown()


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.action")
    parser.add_argument("--goals", type=int, default=21, help="of each length (%(default)s)")
    parser.add_argument("--bare", action="store_true", help=argparse.SUPPRESS)
    chosen = parser.parse_args(argv)
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    if chosen.bare:
        bare()
        return
    with servers() as client:
        print("Median and fastest [ms]:\n")
        print("| points | bare rclpy server | driver | later |\n|---|---|---|---|")
        for points in POINTS:
            what = goal(points, 1.0)
            times_s: dict[str, list[float]] = {BARE: [], DRIVER: []}
            for _ in range(chosen.goals):
                for name, taken_s in times_s.items():
                    took_s, _ = client.send(name, what)
                    assert took_s is not None
                    taken_s.append(1000 * took_s)
            cells = [(statistics.median(taken_s), min(taken_s)) for taken_s in times_s.values()]
            cells.append((cells[1][0] - cells[0][0], cells[1][1] - cells[0][1]))
            shown = " | ".join(f"{median:.1f}, {fastest:.1f}" for median, fastest in cells)
            print(f"| {points} | {shown} |")
        starts_ms = [1000 * client.send(DRIVER, goal(50, 0.0))[1] for _ in range(chosen.goals)]
        print(
            f"\nFrom goal to motion: {statistics.median(starts_ms):.0f} ms, at most "
            f"{max(starts_ms):.0f} ms"
        )


if __name__ == "__main__":
    main()
