"""A ROS node beside the driver: publishes the trajectory and watches the topics."""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import partial
from math import inf
from types import TracebackType
from typing import Any

import rclpy
from builtin_interfaces.msg import Duration, Time
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.srv import GetState
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from epos2_ros.configuration.files import DRIVER
from epos2_ros.demo.outputs import Event
from epos2_ros.demo.report import Observed
from epos2_ros.motion.trajectory import Trajectory

TOPICS = 3  # /joint_states, ~/buffer_status, /diagnostics
ANSWER_TIMEOUT_S = 1.0
EVENTS_KEPT = 1000  # of an output: they come in bursts
MOVING = "moving"  # of the group, in /diagnostics
SENT, STATED = "set-points", "path error of set-points [qc]"  # of a joint there
QUIET_S = 0.5  # without "ip mode active" a motion counts as over


class Witness:
    """The newest of every topic; `spin` brings in more."""

    def __init__(self, domain_id: int, outputs: Sequence[str] = ()) -> None:
        self.positions: dict[str, float] = {}
        self.buffers: dict[str, dict[str, str]] = {}  # by joint, the keys of ~/buffer_status
        self.diagnostics: dict[str, dict[str, str]] = {}  # by joint, output and "bus"
        self.messages: dict[str, int] = {}  # how many came, by topic
        self._buffer_errors: dict[str, str] = {}
        self._active_at = -inf
        self._sync_count = 0
        self._bus_load = 0.0
        self._context = Context()
        rclpy.init(
            args=[],
            context=self._context,
            domain_id=domain_id,
            signal_handler_options=SignalHandlerOptions.NO,
        )
        self._node = Node("epos2_demo", context=self._context, use_global_arguments=False)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._listen(JointState, "/joint_states", self._on_joint_states)
        self._listen(DiagnosticArray, f"/{DRIVER}/buffer_status", self._on_buffer_status)
        self._listen(DiagnosticArray, "/diagnostics", self._on_diagnostics)
        self._publisher = self._node.create_publisher(
            JointTrajectory, f"/{DRIVER}/joint_trajectory", 1
        )
        self._events: dict[str, list[Event]] = {name: [] for name in outputs}
        for name in outputs:
            self._node.create_subscription(
                JointState, f"/{DRIVER}/compare/{name}", partial(self._on_output, name), EVENTS_KEPT
            )
        self._states = self._node.create_client(GetState, f"/{DRIVER}/get_state")
        self._asked: Any = None
        self._asked_at = -inf

    def __enter__(self) -> Witness:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.shutdown()

    def spin(self, seconds: float) -> None:
        """Takes in what arrives within this time."""
        until = time.monotonic() + seconds
        while (left := until - time.monotonic()) > 0:
            self._executor.spin_once(left)

    @property
    def ready(self) -> bool:
        """Whether the driver is active, listens, and every topic has been heard."""
        return (
            self._active()
            and self._publisher.get_subscription_count() > 0
            and len(self.messages) == TOPICS
        )

    def _active(self) -> bool:
        """As `get_state` answered last; asked anew when that was something else, or is overdue.

        An answer is lost for good when the driver has not yet discovered who asks.
        """
        if self._asked is not None and self._asked.done():
            if self._asked.result().current_state.label == "active":
                return True
        elif time.monotonic() - self._asked_at < ANSWER_TIMEOUT_S:
            return False
        if self._states.service_is_ready():
            self._asked, self._asked_at = (
                self._states.call_async(GetState.Request()),
                time.monotonic(),
            )
        return False

    @property
    def moving(self) -> bool:
        """Whether an axis was in motion within the last `QUIET_S`."""
        return time.monotonic() - self._active_at < QUIET_S

    def publish(self, trajectory: Trajectory) -> None:
        """On `~/joint_trajectory`, to start at its stamp, or now if it has none."""
        self._buffer_errors.clear()
        self._bus_load = 0.0
        for events in self._events.values():
            events.clear()
        fields = {
            "positions": trajectory.positions,
            "velocities": trajectory.velocities,
            "accelerations": trajectory.accelerations,
        }
        message = JointTrajectory(joint_names=list(trajectory.joint_names))
        sec, nanosec = divmod(round((trajectory.stamp_s or 0.0) * 1e9), 10**9)
        message.header.stamp = Time(sec=sec, nanosec=nanosec)
        for i, t_s in enumerate(trajectory.times_s):
            sec, nanosec = divmod(round(t_s * 1e9), 10**9)
            point = JointTrajectoryPoint(time_from_start=Duration(sec=sec, nanosec=nanosec))
            for name, values in fields.items():
                if values is not None:
                    setattr(point, name, values[i].tolist())
            message.points.append(point)
        self._publisher.publish(message)

    def observed(self) -> Observed:
        """What there was to see since the trajectory was published."""
        return Observed(
            records_sent={joint: int(v["records_sent"]) for joint, v in self.buffers.items()},
            positions=dict(self.positions),
            set_points={joint: int(v[SENT]) for joint, v in self.diagnostics.items() if SENT in v},
            stated_qc={
                joint: float(v[STATED]) for joint, v in self.diagnostics.items() if STATED in v
            },
            buffer_errors=dict(self._buffer_errors),
            sync_count=self._sync_count,
            bus_load=self._bus_load,
            events={name: tuple(events) for name, events in self._events.items()},
        )

    def _listen(self, kind: Any, topic: str, take: Any) -> None:
        def hear(message: Any) -> None:
            take(message)
            self.messages[topic] = self.messages.get(topic, 0) + 1

        self._node.create_subscription(kind, topic, hear, 10)

    def _on_output(self, name: str, message: JointState) -> None:
        stamp_ns = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        t_us = (stamp_ns + time.monotonic_ns() - time.time_ns()) / 1000
        self._events[name].append(Event(t_us, message.position[0], message.velocity[0]))

    def _on_joint_states(self, message: JointState) -> None:
        self.positions = dict(zip(message.name, message.position, strict=True))

    def _on_buffer_status(self, message: DiagnosticArray) -> None:
        for status in message.status:
            values = {pair.key: pair.value for pair in status.values}
            self.buffers[status.name] = values
            if values["ip_mode_active"] == "true":
                self._active_at = time.monotonic()
            errors = [k for k, v in values.items() if k.endswith("_error") and v == "true"]
            if errors:
                self._buffer_errors[status.name] = ", ".join(errors).replace("_", " ")

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        self.diagnostics = {
            status.name.rpartition(": ")[2]: {pair.key: pair.value for pair in status.values}
            for status in message.status
        }
        bus = self.diagnostics["bus"]
        if bus["group"] == MOVING:
            self._active_at = time.monotonic()
        self._sync_count = int(bus["SYNC count"])
        self._bus_load = max(self._bus_load, float(bus["load [%]"]))
