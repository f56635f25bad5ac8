"""A stream as MoveIt Servo (Jazzy) publishes it, followed for minutes by real processes.

    python -m benchmarks.servo_stream --minutes 5               # docs/motion.md
    python -m benchmarks.servo_stream --delay 0                 # a publisher that is never late

Publisher, driver and simulated drives (behind an slcan adapter) are processes of their own. The
publisher sends every 34 ms the points from 0.1 s ago to 0.1 s ahead, each message late by a time
evenly distributed up to `--delay`. Fifteen seconds long the six joints sway, then the operator lets
go and nothing is sent for three. What the axes do is what `/joint_states` say of them at their
stamps. Lag: the shift in time by which the operator's path fits best, per burst. Off: what is left
between them then. At rest: from the last point's time on, until all joints are within 1 mrad/s.
"""

from __future__ import annotations

import argparse
import os
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
import yaml
from builtin_interfaces.msg import Duration, Time
from diagnostic_msgs.msg import DiagnosticArray
from numpy.typing import NDArray
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from epos2_ros.demo.child import Child

JOINTS = [f"joint_{n}" for n in range(1, 7)]
TOPIC = "/epos2_driver/joint_trajectory"
DOMAIN_ID = 78
PERIOD_S, WINDOW_S = 0.034, 0.1
BURST_S, PAUSE_S, RAMP_S = 15.0, 3.0, 1.5
REACH = 0.25 * (1 - np.arange(6) / 12)  # [rad]
RATE_HZ = 0.17 + 0.05 * np.arange(6)
READY_S = 120.0
RESTS = 1e-3  # [rad/s]
TROUBLE = ("[ERROR]", "[FATAL]", "[WARN]")

Array = NDArray[np.float64]


def operator(t_s: Array) -> Array:
    """Positions [rad] at times since the burst began [m] → [m, 6]; at rest before and after."""
    t = np.clip(t_s, 0.0, BURST_S)[:, None]
    ramps = [np.clip(x / RAMP_S, 0.0, 1.0) for x in (t, BURST_S - t)]
    come, go = (x**3 * (10 - 15 * x + 6 * x**2) for x in ramps)
    return np.asarray(REACH * come * go * np.sin(2 * np.pi * RATE_HZ * t))


def window(t_s: float, began_s: float) -> JointTrajectory:
    """What Servo says at a time since the burst began."""
    h = 1e-4
    times = np.arange(max(0.0, t_s - WINDOW_S), t_s + WINDOW_S + 1e-9, PERIOD_S)
    times = np.unique(np.minimum(times, BURST_S))
    velocities = (operator(times + h) - operator(times - h)) / (2 * h)
    message = JointTrajectory(joint_names=JOINTS)
    sec, nanosec = divmod(round((began_s + times[0]) * 1e9), 10**9)
    message.header.stamp = Time(sec=sec, nanosec=nanosec)
    for t, position, velocity in zip(times, operator(times), velocities, strict=True):
        message.points.append(
            JointTrajectoryPoint(
                positions=position.tolist(),
                velocities=velocity.tolist(),
                time_from_start=Duration(nanosec=round((t - times[0]) * 1e9)),
            )
        )
    return message


def publish(bursts: int, delay_s: float, seed: int) -> None:
    """The publisher's process; says when each burst began."""
    rng = random.Random(seed)
    rclpy.init()
    node = Node("servo")
    publisher = node.create_publisher(JointTrajectory, TOPIC, 10)
    while not publisher.get_subscription_count():
        time.sleep(0.1)
    for _ in range(bursts):
        began_s = time.time() + 0.2
        print(began_s, flush=True)
        for t_s in np.arange(0.0, BURST_S, PERIOD_S):
            late_s = rng.uniform(0.0, delay_s)
            time.sleep(max(0.0, began_s + t_s + late_s - time.time()))
            publisher.publish(window(float(t_s), began_s))
        time.sleep(PAUSE_S)
    rclpy.shutdown()


class Watch:
    """What the driver's topics say meanwhile."""

    def __init__(self) -> None:
        self.states: list[tuple[float, list[float], list[float]]] = []
        self.late_s: list[float] = []  # of the messages against their stamps
        self.reserve_ms: list[float] = []
        self.states_of_group: set[str] = set()
        self._node = Node("watch")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        deep = QoSProfile(depth=200)
        self._node.create_subscription(JointState, "/joint_states", self._on_state, deep)
        self._node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, deep)

    def spin(self, seconds: float) -> None:
        until_s = time.monotonic() + seconds
        while (left_s := until_s - time.monotonic()) > 0:
            self._executor.spin_once(left_s)

    def _on_state(self, message: JointState) -> None:
        stamp_s = message.header.stamp.sec + message.header.stamp.nanosec * 1e-9
        self.late_s.append(time.time() - stamp_s)
        if list(message.name) == JOINTS:
            self.states.append((stamp_s, list(message.position), list(message.velocity)))

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            values = {pair.key: pair.value for pair in status.values}
            self.states_of_group.add(values.get("group", ""))
            if values.get("least buffer reserve [ms]"):
                self.reserve_ms.append(float(values["least buffer reserve [ms]"]))


def judged(states: Sequence[tuple[float, list[float], list[float]]], began_s: float) -> Any:
    """Lag [s], the most that is left then [rad], and rest after the last point [s], of a burst."""
    stamps = np.array([state[0] for state in states]) - began_s
    positions = np.array([state[1] for state in states])
    speed = np.abs([state[2] for state in states]).max(axis=1)
    during = (stamps > 0.0) & (stamps < BURST_S)
    lags = np.arange(-0.05, 0.3, 0.001)
    off = [np.abs(positions[during] - operator(stamps[during] - lag)).mean() for lag in lags]
    lag = float(lags[int(np.argmin(off))])
    left = np.abs(positions[during] - operator(stamps[during] - lag))
    after = stamps[(stamps > BURST_S - 1.0) & (stamps < BURST_S + PAUSE_S - 0.3) & (speed > RESTS)]
    return lag, float(left.max()), float(after.max(initial=BURST_S) - BURST_S)


def run(bursts: int, delay_s: float, ahead_s: float, seed: int, group: str) -> None:
    place = ["--interface", "udp_multicast", "--channel", group] if group else ["--slcan"]
    limits = {"gear_ratio": 100.0, "max_velocity": 2.0, "max_acceleration": 10.0}
    parameters: dict[str, object] = {
        "simulate": False,
        "joints": JOINTS,
        "axes": {joint: {"node_id": n, **limits} for n, joint in enumerate(JOINTS, 1)},
        "ipm": {"stream_ahead": ahead_s},
    }
    with (
        tempfile.TemporaryDirectory() as folder,
        Child("simulator", [*place, "--nodes", "1-6", "--drift-ppm", "50"], {}) as drives,
    ):
        line = drives.first_line(READY_S)
        parameters["can"] = {
            "interface": "udp_multicast" if group else "slcan",
            "channel": group or line.split()[-1],
        }
        file = Path(folder) / "params.yaml"
        file.write_text(yaml.safe_dump({"/epos2_driver": {"ros__parameters": parameters}}))
        with Child("driver", ["--ros-args", "--params-file", str(file)], {}) as driver:
            log: list[str] = []
            until_s = time.monotonic() + READY_S
            while not any("active: " in line for line in log):
                time.sleep(0.1)
                driver.check()
                log += driver.lines()
                if time.monotonic() > until_s:
                    raise SystemExit("\n".join(["the driver said:", *log]))
            rclpy.init()
            watch = Watch()
            command = [sys.executable, "-m", "benchmarks.servo_stream", "--publisher"]
            command += ["--bursts", str(bursts), "--delay", str(delay_s), "--seed", str(seed)]
            servo = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
            try:
                while servo.poll() is None:
                    watch.spin(0.5)
                    driver.check()
            finally:
                servo.kill()
                servo.wait()
            watch.spin(1.0)
            log += driver.lines()
            assert servo.stdout is not None
            report(watch, [float(line) for line in servo.stdout], log)
            rclpy.shutdown()


def report(watch: Watch, begins_s: Sequence[float], log: Sequence[str]) -> None:
    bursts = []
    for began_s in begins_s:
        end_s = began_s + BURST_S + PAUSE_S
        bursts.append(judged([s for s in watch.states if began_s - 0.1 < s[0] < end_s], began_s))
    lag, off, rest = (np.array(each) for each in zip(*bursts, strict=True))
    stamps = np.array([state[0] for state in watch.states])
    told = [line for line in log if line.startswith(TROUBLE)]
    late_ms = 1000 * np.array(watch.late_s)
    print(f"bursts                    {len(bursts)} of {BURST_S:.0f} s")
    print(f"in fault                  {'fault' in watch.states_of_group}")
    print(f"least reserve             {min(watch.reserve_ms, default=np.nan):.0f} ms")
    print(f"lag                       {1000 * np.median(lag):.0f} ms, {1000 * lag.max():.0f} most")
    print(
        f"off the operator's path   {1000 * np.median(off):.1f} mrad, {1000 * off.max():.1f} most"
    )
    print(
        f"at rest after last point  {1000 * np.median(rest):.0f} ms, {1000 * rest.max():.0f} most"
    )
    print(f"/joint_states             {len(stamps)}, {np.diff(stamps).min() * 1e3:.1f} ms apart or")
    print(f"                          more, {np.median(late_ms):.1f} ms late (median)")
    print(f"warnings and errors       {len(told)}")
    print("\n".join(line[:300] for line in told[:8]))


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.servo_stream")
    parser.add_argument("--minutes", type=float, default=3.0, help="of bursts (%(default)s)")
    parser.add_argument("--delay", type=float, default=0.1, help="at most [s] (%(default)s)")
    parser.add_argument("--ahead", type=float, default=0.14, help="ipm.stream_ahead (%(default)s)")
    parser.add_argument("--udp", default="", metavar="GROUP", help="instead of an slcan adapter")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--bursts", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--publisher", action="store_true", help=argparse.SUPPRESS)
    chosen = parser.parse_args(argv)
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    os.environ["ROS_DOMAIN_ID"] = str(DOMAIN_ID)
    if chosen.publisher:
        publish(chosen.bursts, chosen.delay, chosen.seed)
        return
    bursts = chosen.bursts or max(1, round(60 * chosen.minutes / (BURST_S + PAUSE_S)))
    run(bursts, chosen.delay, chosen.ahead, chosen.seed, chosen.udp)


if __name__ == "__main__":
    main()
