"""The driver node as other nodes see it: lifecycle, topics, services, log. The drives are faked."""

from __future__ import annotations

import gc
import math
import os
import re
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
import yaml
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from driver_program import program as program  # a fixture
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.task import Future
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from shipped import PARAMETER_FILES
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from epos2_ros.bus.lateness import LatenessFigures
from epos2_ros.bus.snapshot import AxisSnapshot, JointStates, OutputSnapshot, Snapshot
from epos2_ros.configuration.driver import ClockLimits, DriverConfig
from epos2_ros.configuration.files import read_parameters
from epos2_ros.configuration.outputs import CompareConfig
from epos2_ros.demo.report import Executed
from epos2_ros.demo.witness import Witness
from epos2_ros.errors import BusError, DriveError, Epos2RosError, TrajectoryError
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.node import messages
from epos2_ros.node.driver import DriverNode, main
from epos2_ros.node.lanes import events_executor, spin
from epos2_ros.protocol.outbox import Event
from epos2_ros.protocol.outputs.outputs import OutputEvent, Tally

JOINT_STATE = ("joint", "position", "velocity", "effort")
WAIT_S = 20.0  # for something that must happen; reached only when it does not
LOG_LINE = re.compile(r"\[(\w+)\] \[[\d.]+\] \[(?:[\w.]+\.)?epos2_driver\]: (.*)")


# maxon, application note "Interpolation Position Mode", table 13; velocity and acceleration
# errors are bits 10 and 11 (the table repeats the numbers of the warnings).
STATUS_BITS = {
    "underflow_warning": 0,
    "overflow_warning": 1,
    "velocity_warning": 2,
    "acceleration_warning": 3,
    "underflow_error": 8,
    "overflow_error": 9,
    "velocity_error": 10,
    "acceleration_error": 11,
    "buffer_enabled": 14,
    "ip_mode_active": 15,
}


def axis_snapshot(joint: str, node_id: int, **values: Any) -> AxisSnapshot:
    standing = {
        "state": "operation enabled",
        "position": 0.0,
        "velocity": 0.0,
        "effort": math.nan,
        "used": 0,
        "free": 64,
        "size": 64,
        "buffered_ms": 0.0,
        "status_word": 0x4000,
        "fault": "",
        "following_error_qc": 0,
        "clock_offset_us": 0.0,
        "clock_drift_ppm": 0.0,
        "executed_qc": 0,
        "records_sent": 0,
    }
    values = {**standing, **values}
    word = values["status_word"]
    flags = {name: bool(word >> bit & 1) for name, bit in STATUS_BITS.items()}
    return AxisSnapshot(joint=joint, node_id=node_id, buffer_flags=flags, **values)


def snapshot_of(*axes: AxisSnapshot, **values: Any) -> Snapshot:
    quiet = {
        "state": "standing",
        "reason": "",
        "bus_load": 0.125,
        "sync_count": 7,
        "sync_time_source": "kernel",
        "dropped_frames": 0,
        "error_frames": 0,
        "refused_frames": 0,
    }
    return Snapshot(axes=axes, **{**quiet, **values})


class FakeDriver:
    """The facade of the bus layer: notes what it is asked, fails or blocks when told to."""

    def __init__(
        self,
        config: DriverConfig,
        on_event: Callable[[Event], None],
        on_output: Callable[[OutputEvent], None],
        on_trace: Callable[[str], None] | None = None,
    ) -> None:
        self.on_trace = on_trace
        self.config = config
        self.on_event = on_event
        self.on_output = on_output
        self.calls: list[str] = []
        self.trajectories: list[Any] = []
        self.outputs = {output.name: output for output in config.outputs}
        self.failures: dict[str, Exception] = {}
        self.blocked: dict[str, threading.Event] = {}
        self.current = snapshot_of(
            *(axis_snapshot(axis.joint, axis.node_id) for axis in config.axes)
        )

    def _do(self, name: str) -> None:
        self.calls.append(name)
        if name in self.blocked:
            assert self.blocked[name].wait(WAIT_S)
        if name in self.failures:
            raise self.failures[name]

    def configure(self) -> None:
        self._do("configure")

    def enable(self) -> None:
        self._do("enable")

    def disable(self) -> None:
        self._do("disable")

    def halt(self) -> None:
        self._do("halt")

    def quick_stop(self) -> None:
        self._do("quick_stop")

    def reset_fault(self) -> None:
        self._do("reset_fault")

    def close(self) -> None:
        self._do("close")

    def submit(self, trajectory: Any) -> None:
        self._do("submit")
        self.trajectories.append(trajectory)

    def set_output(self, config: CompareConfig) -> None:
        self._do(f"set {config.name}")
        self.outputs[config.name] = config

    def set_positions(self, output: str, positions: Sequence[float]) -> None:
        self._do(f"positions of {output}: {list(positions)}")

    def move_to(self, targets: Mapping[str, float], duration_s: float) -> None:
        self._do(f"move to {dict(targets)} in {duration_s:g} s")

    def broke(self, where: str, error: BaseException) -> None:
        self._do(f"broke in {where}: {error}")

    def snapshot(self) -> Snapshot:
        return self.current

    def joint_states(self) -> JointStates:
        heard = [axis for axis in self.current.axes if not axis.silent_s]
        columns = ([getattr(axis, name) for axis in heard] for name in JOINT_STATE)
        return JointStates(time.monotonic_ns() / 1e3, *columns)


class World:
    """A driver node with fake drives, and another node that watches and asks it."""

    def __init__(self, domain_id: int, stderr: Path) -> None:
        self.context = Context()
        rclpy.init(args=[], context=self.context, domain_id=domain_id)
        self.drivers: list[FakeDriver] = []
        self.prepare: Callable[[FakeDriver], None] = lambda driver: None
        self.peer = Node("peer", context=self.context)
        self.log: list[tuple[str, str]] = []  # severity and text of each line of the node
        self.stderr = stderr
        self.node: DriverNode | None = None
        self._executors = [
            SingleThreadedExecutor(context=self.context),
            events_executor(self.context),
        ]
        self._executors[0].add_node(self.peer)
        self._threads: list[threading.Thread] = []
        self._ended = Future()
        self._spin(self._executors[0])

    def _spin(self, executor: Any, node: DriverNode | None = None) -> None:
        thread = threading.Thread(target=executor.spin, daemon=True)
        if node is not None:
            thread = threading.Thread(target=spin, args=(executor, self._ended, node.broke))
        thread.start()
        self._threads.append(thread)

    def _redirect_stderr(self) -> None:
        """Into a file, rcutils' log included: `capfd` loses what comes while it is being read."""
        self._stderr_before = os.dup(2)
        with self.stderr.open("ab") as file:
            os.dup2(file.fileno(), 2)

    def start(self, namespace: str = "", **parameters: Any) -> DriverNode:
        self._redirect_stderr()

        def make(config: DriverConfig, *listeners: Any) -> Any:
            driver = FakeDriver(config, *listeners)
            self.prepare(driver)
            self.drivers.append(driver)
            return driver

        overrides = [Parameter(n.replace("__", "."), value=v) for n, v in parameters.items()]
        self.node = DriverNode(
            make, context=self.context, parameter_overrides=overrides, namespace=namespace
        )
        self._executors[1].add_node(self.node)
        self._spin(self._executors[1], self.node)
        return self.node

    def started(self, **parameters: Any) -> FakeDriver:
        """A node that has activated itself."""
        self.start(**{"joints": ["a", "b"], **parameters})
        self.logged("active: ")
        return self.drivers[0]

    def call(self, kind: Any, name: str, request: Any) -> Any:
        client = self.peer.create_client(kind, name)
        assert client.wait_for_service(WAIT_S)
        done = threading.Event()
        future = client.call_async(request)
        future.add_done_callback(lambda _: done.set())
        assert done.wait(WAIT_S), f"{name} did not answer"
        self.peer.destroy_client(client)
        return future.result()

    def trigger(self, name: str) -> Any:
        return self.call(Trigger, f"/epos2_driver/{name}", Trigger.Request())

    def enable(self, on: bool) -> Any:
        return self.call(SetBool, "/epos2_driver/enable", SetBool.Request(data=on))

    def change(self, transition: int) -> bool:
        request = ChangeState.Request(transition=Transition(id=transition))
        return bool(self.call(ChangeState, "/epos2_driver/change_state", request).success)

    @property
    def state(self) -> str:
        """Once no transition is in progress."""
        while True:
            answer = self.call(GetState, "/epos2_driver/get_state", GetState.Request())
            if answer.current_state.id <= State.PRIMARY_STATE_FINALIZED:
                return str(answer.current_state.label)

    def listen(self, kind: Any, topic: str) -> list[Any]:
        got: list[Any] = []
        self.peer.create_subscription(kind, topic, got.append, 10)
        return got

    def wait(self, what: Callable[[], Any]) -> None:
        deadline = time.monotonic() + WAIT_S
        while not what():
            assert time.monotonic() < deadline
            time.sleep(0.005)

    def lines(self) -> list[str]:
        """What the node has logged so far."""
        self.log = LOG_LINE.findall(self.stderr.read_text())
        return [text for _, text in self.log]

    def logged(self, words: str) -> list[str]:
        """The log as soon as these words are in it."""
        self.wait(lambda: any(words in line for line in self.lines()))
        return self.lines()

    def publish(self, name: str, message: Any) -> None:
        publisher = self.peer.create_publisher(type(message), f"/epos2_driver/{name}", 10)
        self.wait(publisher.get_subscription_count)
        publisher.publish(message)

    def publish_trajectory(self, *joints: str) -> None:
        point = JointTrajectoryPoint(positions=[0.0] * len(joints))
        self.publish("joint_trajectory", JointTrajectory(joint_names=list(joints), points=[point]))

    def close(self) -> None:
        for driver in self.drivers:
            driver.failures.clear()
        if self.node is not None:
            self.node.shut_down()
        self._ended.set_result(None)
        for executor in self._executors:
            executor.shutdown(timeout_sec=0)
        for thread in self._threads:
            thread.join(WAIT_S)
        for executor in self._executors:
            executor.shutdown()
        self.peer.destroy_node()
        if self.node is not None:
            self.node.destroy_node()
        self.context.shutdown()
        os.dup2(self._stderr_before, 2)
        os.close(self._stderr_before)
        sys.stderr.write(self.stderr.read_text())


@pytest.fixture
def world(ros_domain_id: int, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[World]:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    it = World(ros_domain_id, tmp_path / "stderr")
    yield it
    it.close()


# -- lifecycle -------------------------------------------------------------------------------


def test_it_configures_and_activates_itself(world):
    driver = world.started()
    assert driver.calls == ["configure", "enable"]
    assert world.state == "active"


def test_without_autostart_it_follows_the_transitions(world):
    world.start(autostart=False, joints=["a"])
    assert world.state == "unconfigured"
    assert not world.drivers
    for transition, state, calls in (
        (Transition.TRANSITION_CONFIGURE, "inactive", ["configure"]),
        (Transition.TRANSITION_ACTIVATE, "active", ["configure", "enable"]),
        (Transition.TRANSITION_DEACTIVATE, "inactive", ["configure", "enable", "disable"]),
        (
            Transition.TRANSITION_CLEANUP,
            "unconfigured",
            ["configure", "enable", "disable", "close"],
        ),
    ):
        assert world.change(transition)
        assert world.state == state
        assert world.drivers[0].calls == calls


def test_looking_for_garbage_stops_no_thread_for_long_while_configured(world):
    """Python's collector stops all threads for as long as it takes to look through all objects:
    those that stay for good (ROS, Numba, the drives' dictionaries) are no more looked through."""
    world.started()
    assert len(gc.get_objects()) < gc.get_freeze_count() / 10
    assert world.change(Transition.TRANSITION_DEACTIVATE)
    assert world.change(Transition.TRANSITION_CLEANUP)
    assert gc.get_freeze_count() == 0


def test_shutdown_while_active_disables_and_closes(world):
    driver = world.started()
    assert world.change(Transition.TRANSITION_ACTIVE_SHUTDOWN)
    assert driver.calls == ["configure", "enable", "disable", "close"]
    assert world.state == "finalized"


def test_a_transition_the_state_does_not_have_is_refused_and_the_node_lives_on(world):
    driver = world.started()
    assert not world.change(Transition.TRANSITION_CONFIGURE)
    assert not world.change(Transition.TRANSITION_ACTIVATE)
    assert not world.change(77)
    assert world.state == "active"
    assert driver.calls == ["configure", "enable"]


def test_a_failed_configure_is_one_line_and_can_be_repeated(world):
    reason = "can0: no such interface; see `ip link`"

    def no_bus(driver: FakeDriver) -> None:
        driver.failures["configure"] = BusError(reason)

    world.prepare = no_bus
    world.start(joints=["a"])
    assert world.logged("failed") == [f"configure failed: {reason}"]
    assert world.state == "unconfigured"
    assert world.drivers[0].calls == ["configure"]  # which closes the bus itself when it fails
    world.prepare = lambda driver: None
    assert world.change(Transition.TRANSITION_CONFIGURE)
    assert world.state == "inactive"


def test_a_wrong_parameter_refuses_configure_with_one_line(world):
    world.start(joints=["a"], axes__a__gear_ratio=-2.0)
    (line,) = world.logged("failed")
    assert line.startswith("configure failed: axes.a.gear_ratio is -2.0; it must be ")
    assert world.state == "unconfigured"
    assert not world.drivers


def test_when_an_axis_cannot_be_enabled_the_node_stays_inactive(world):
    def faulty(driver: FakeDriver) -> None:
        driver.failures["enable"] = DriveError("a: over-current (0x2310)")

    world.prepare = faulty
    world.start(joints=["a"])
    assert world.logged("failed")[1:] == ["activate failed: a: over-current (0x2310)"]
    assert world.state == "inactive"
    world.drivers[0].failures.clear()
    assert world.change(Transition.TRANSITION_ACTIVATE)
    assert world.state == "active"


def test_when_an_axis_cannot_be_disabled_the_node_stays_active(world):
    driver = world.started()
    driver.failures["disable"] = DriveError("a (node 1) does not answer")
    assert not world.change(Transition.TRANSITION_DEACTIVATE)
    world.logged("deactivate failed: a (node 1) does not answer")
    assert world.state == "active"
    assert world.enable(True).success
    driver.failures.clear()
    assert world.change(Transition.TRANSITION_DEACTIVATE)
    assert "not active" in world.enable(True).message


def test_an_unexpected_error_is_in_the_log_and_leaves_the_node_unconfigured(world):
    def broken(driver: FakeDriver) -> None:
        driver.failures["enable"] = ZeroDivisionError("a bug")

    world.prepare = broken
    world.start(joints=["a"])
    world.logged("activate failed:")
    world.wait(lambda: "ZeroDivisionError: a bug" in world.stderr.read_text())
    assert world.state == "unconfigured"
    assert world.drivers[0].calls[-1] == "close"


# -- the story in the log ---------------------------------------------------------------------


def test_without_autostart_the_log_says_what_to_type(world):
    world.start(namespace="/robot1", autostart=False, joints=["a"], can__channel="x")
    assert world.logged("next") == [
        "unconfigured, 1 simulated drives on virtual x; next: "
        "ros2 lifecycle set /robot1/epos2_driver configure"
    ]


def test_without_autostart_a_wrong_parameter_is_told_at_start(world):
    world.start(autostart=False, joints=["a"], axes__a__gear_ratio=-2.0)
    line = world.logged("configure will fail")[-1]
    assert line.startswith("configure will fail: axes.a.gear_ratio is -2.0; it must be ")


def test_every_request_and_transition_is_a_line(world):
    driver = world.started(simulate=False)
    count = len(world.lines())
    world.enable(False)
    world.enable(True)
    for name in ("halt", "quick_stop", "reset_fault"):
        world.trigger(name)
    driver.failures["halt"] = DriveError("a does not answer")
    world.trigger("halt")
    driver.failures.clear()
    world.change(Transition.TRANSITION_DEACTIVATE)
    world.change(Transition.TRANSITION_CLEANUP)
    world.change(Transition.TRANSITION_UNCONFIGURED_SHUTDOWN)
    world.logged("shut down")
    assert world.log[count:] == [
        ("INFO", "disable: all axes disabled"),
        ("INFO", "enable: all axes enabled"),
        ("INFO", "halt: halted"),
        ("INFO", "quick stop: stopped"),
        ("INFO", "reset fault: no fault"),
        ("WARN", "halt failed: a does not answer"),
        ("INFO", "inactive: all axes disabled"),
        ("INFO", "unconfigured: the bus is closed"),
        ("INFO", "shut down"),
    ]


@pytest.mark.parametrize(
    ("kind", "level"),
    [
        ("started", "INFO"),
        ("replaced", "INFO"),
        ("stopped", "INFO"),  # somebody has asked for it
        ("cancelled", "INFO"),
        ("warning", "WARN"),
        ("aborted", "ERROR"),
        ("fault", "ERROR"),
    ],
)
def test_only_trouble_is_an_error(world, kind, level):
    world.started().on_event(Event(kind, f"it is {kind}"))
    world.logged(f"it is {kind}")
    assert (level, f"it is {kind}") in world.log


def test_steps_are_told_at_debug_level_and_cost_nothing_otherwise(world):
    assert world.started().on_trace is None
    assert world.change(Transition.TRANSITION_DEACTIVATE)
    assert world.change(Transition.TRANSITION_CLEANUP)
    rclpy.logging.set_logger_level("epos2_driver", rclpy.logging.LoggingSeverity.DEBUG)
    try:
        assert world.change(Transition.TRANSITION_CONFIGURE)
        world.drivers[1].on_trace("a step")
        world.logged("a step")
    finally:
        rclpy.logging.set_logger_level("epos2_driver", rclpy.logging.LoggingSeverity.UNSET)
    assert ("DEBUG", "a step") in world.log


# -- trajectories ----------------------------------------------------------------------------


def test_a_trajectory_reaches_the_drives(world):
    driver = world.started()
    world.publish_trajectory("b", "a")
    world.wait(lambda: driver.trajectories)
    assert driver.trajectories[0].joint_names == ("b", "a")


def test_effort_in_a_point_is_said_to_be_ignored_once(world):
    driver = world.started()
    point = JointTrajectoryPoint(positions=[0.0, 0.0], effort=[1.0, 1.0])
    for _ in range(2):
        world.publish("joint_trajectory", JointTrajectory(joint_names=["a", "b"], points=[point]))
    world.wait(lambda: len(driver.trajectories) == 2)
    world.lines()
    said = [(level, line) for level, line in world.log if "effort" in line]
    assert [level for level, _ in said] == ["WARN"]


class TestSimulatedTime:
    """With `use_sim_time` a stamp is a time of /clock, in messages to the node and from it."""

    @staticmethod
    def stamped(sec: int) -> JointTrajectory:
        point = JointTrajectoryPoint(positions=[0.0, 0.0])
        message = JointTrajectory(joint_names=["a", "b"], points=[point])
        message.header.stamp.sec = sec
        return message

    def test_stamps_in_and_out_mean_the_same_clock(self, world):
        driver = world.started(use_sim_time=True)
        clock = world.peer.create_publisher(Clock, "/clock", 10)
        world.wait(clock.get_subscription_count)
        clock.publish(Clock(clock=Time(sec=1000)))
        states = world.listen(JointState, "/joint_states")
        world.wait(lambda: states and states[-1].header.stamp.sec in (999, 1000))
        before = time.time()
        world.publish("joint_trajectory", self.stamped(1002))
        world.wait(lambda: driver.trajectories)
        # 2 s ahead, in the system's time
        assert before + 2 <= driver.trajectories[0].stamp_s <= time.time() + 2
        world.publish("joint_trajectory", self.stamped(0))
        world.wait(lambda: len(driver.trajectories) == 2)
        assert driver.trajectories[1].stamp_s is None  # now, in any clock

    def test_without_a_clock_a_stamp_is_refused_in_words(self, world):
        world.started(use_sim_time=True)
        world.publish("joint_trajectory", self.stamped(1002))
        world.logged("use_sim_time is true, and no /clock has come yet")
        world.publish("joint_trajectory", self.stamped(0))
        world.wait(lambda: world.drivers[0].trajectories)


def test_a_refused_trajectory_is_one_line(world):
    driver = world.started()
    reason = "joint a, point 3: 2.1 rad/s is over its limit, 2 rad/s"
    driver.failures["submit"] = TrajectoryError(reason)
    before = len(world.lines())
    world.publish_trajectory("a", "b")
    world.logged("refused")
    driver.failures.clear()
    world.publish_trajectory("a", "b")
    world.wait(lambda: driver.trajectories)
    world.lines()
    assert world.log[before:] == [("ERROR", f"trajectory refused: {reason}")]


def test_a_flood_of_refused_trajectories_is_told_in_few_lines(world):
    driver = world.started()
    driver.failures["submit"] = TrajectoryError("point 3: not today")
    point = JointTrajectoryPoint(positions=[0.0, 0.0])
    message = JointTrajectory(joint_names=["a", "b"], points=[point])
    publisher = world.peer.create_publisher(JointTrajectory, "/epos2_driver/joint_trajectory", 10)
    world.wait(publisher.get_subscription_count)

    def publish() -> int:
        publisher.publish(message)
        time.sleep(0.005)
        return driver.calls.count("submit")

    began_s = time.monotonic()
    world.wait(lambda: publish() > 40)
    world.wait(lambda: publish() and "were left out)" in world.stderr.read_text())
    lines = [line for line in world.lines() if line.startswith("trajectory refused: ")]
    assert len(lines) <= 10 * (time.monotonic() - began_s + 1)
    assert world.trigger("halt").success  # and services are answered meanwhile


def test_a_callback_that_raises_stops_the_axes_and_the_next_is_called(world):
    driver = world.started()
    driver.failures["submit"] = ZeroDivisionError("nobody expected this")
    broke = "broke in a callback: nobody expected this"
    for count in (1, 2):
        world.publish_trajectory("a", "b")
        world.wait(lambda count=count: driver.calls.count(broke) == count)
    driver.failures.clear()
    world.publish_trajectory("a", "b")
    world.wait(lambda: driver.trajectories)
    assert "ZeroDivisionError: nobody expected this" in world.stderr.read_text()
    assert world.state == "active"


def test_a_service_that_raises_answers_and_stops_the_axes(world):
    driver = world.started()
    driver.failures["halt"] = ZeroDivisionError("nobody expected this")
    answer = world.trigger("halt")
    assert not answer.success
    assert answer.message.startswith("internal error: ZeroDivisionError: nobody expected this (")
    assert "broke in a service: nobody expected this" in driver.calls
    driver.failures.clear()
    assert world.trigger("halt").success


def test_a_trajectory_is_refused_while_inactive(world):
    driver = world.started()
    assert world.change(Transition.TRANSITION_DEACTIVATE)
    world.publish_trajectory("a", "b")
    world.logged("trajectory refused: the node is not active")
    assert "submit" not in driver.calls


def test_events_of_the_drives_are_logged(world):
    driver = world.started()
    driver.on_event(Event("started", "the group started"))
    driver.on_event(Event("fault", "b: following error (0x8611)"))
    world.logged("0x8611")
    assert world.log[-2:] == [
        ("INFO", "the group started"),
        ("ERROR", "b: following error (0x8611)"),
    ]


# -- topics ----------------------------------------------------------------------------------


def stamp_ns(state: JointState) -> int:
    return int(state.header.stamp.sec * 10**9 + state.header.stamp.nanosec)


def test_joint_states_are_of_the_time_of_their_stamp(world):
    driver = world.started(state_rate=200.0)
    came: list[tuple[float, JointState]] = []
    world.peer.create_subscription(
        JointState, "/joint_states", lambda state: came.append((time.time_ns(), state)), 10
    )
    driver.current = snapshot_of(
        axis_snapshot("a", 1, position=1.5, velocity=-0.5), axis_snapshot("b", 2, effort=2.0)
    )
    world.wait(lambda: len(came) > 100)
    state = came[-1][1]
    assert list(state.name) == ["a", "b"]
    assert list(state.position) == [1.5, 0.0]
    assert list(state.velocity) == [-0.5, 0.0]
    assert math.isnan(state.effort[0])
    assert state.effort[1] == 2.0
    stamps = [stamp_ns(state) for _, state in came]
    assert min(np.diff(stamps)) > 0
    late_ns = [at - stamp for (at, _), stamp in zip(came, stamps, strict=True)]
    assert 0 < np.median(late_ns) < 200e6  # some milliseconds, on a computer that is not as busy


def test_with_simulated_time_that_has_not_begun_there_are_states(world):
    driver = world.started(use_sim_time=True, state_rate=200.0)
    states = world.listen(JointState, "/joint_states")
    world.wait(lambda: states)
    assert (states[0].header.stamp.sec, states[0].header.stamp.nanosec) == (0, 0)
    assert driver.calls == ["configure", "enable"]


def test_buffer_status_and_diagnostics_are_published(world):
    world.started(can__channel="can7")
    buffers = world.listen(DiagnosticArray, "/epos2_driver/buffer_status")
    diagnostics = world.listen(DiagnosticArray, "/diagnostics")
    world.wait(lambda: buffers and diagnostics)
    assert [(s.name, s.hardware_id) for s in buffers[-1].status] == [
        ("a", "can7/1"),
        ("b", "can7/2"),
    ]
    assert [(s.name, s.hardware_id) for s in diagnostics[-1].status] == [
        ("epos2_driver: a", "can7/1"),
        ("epos2_driver: b", "can7/2"),
        ("epos2_driver: bus", "can7"),
    ]
    assert buffers[-1].header.stamp.sec > 0


def test_topics_end_with_cleanup(world):
    driver = world.started(state_rate=200.0)
    states = world.listen(JointState, "/joint_states")
    world.wait(lambda: states)
    assert world.change(Transition.TRANSITION_DEACTIVATE)
    count = len(states)
    world.wait(lambda: len(states) > count)  # where the joints are is known without power too
    assert world.change(Transition.TRANSITION_CLEANUP)
    assert driver.calls[-1] == "close"
    assert world.change(Transition.TRANSITION_CONFIGURE)
    world.drivers[1].current = snapshot_of(axis_snapshot("a", 1, position=9.0))
    world.wait(lambda: states[-1].position[0] == 9.0)


# -- services --------------------------------------------------------------------------------


def test_services_ask_the_drives_and_say_what_was_reached(world):
    driver = world.started()
    for name in ("halt", "quick_stop", "reset_fault"):
        assert world.trigger(name).success
    assert world.enable(False).success
    assert world.enable(True).success
    assert driver.calls == [
        *("configure", "enable", "halt", "quick_stop", "reset_fault", "disable", "enable"),
    ]


@pytest.mark.parametrize("name", ["halt", "quick_stop", "reset_fault", "enable"])
def test_a_service_that_fails_says_which_axis_and_why(world, name):
    driver = world.started()
    reason = "b: still in fault: over-current (0x2310)"
    driver.failures[name] = DriveError(reason)
    answer = world.enable(True) if name == "enable" else world.trigger(name)
    assert not answer.success
    assert answer.message == reason


def test_services_of_a_node_that_is_not_configured_say_so(world):
    world.start(autostart=False)
    for answer in (world.trigger("halt"), world.enable(True), world.enable(False)):
        assert not answer.success
        assert answer.message == "the node is not configured"


def test_enable_belongs_to_an_active_node(world):
    driver = world.started()
    assert world.change(Transition.TRANSITION_DEACTIVATE)
    answer = world.enable(True)
    assert not answer.success
    assert answer.message == "the node is not active"
    assert driver.calls[-1] == "disable"


def test_a_service_that_takes_long_stalls_neither_topics_nor_other_services(world):
    driver = world.started(state_rate=100.0)
    states = world.listen(JointState, "/joint_states")
    driver.blocked = {n: threading.Event() for n in ("enable", "reset_fault")}
    client = world.peer.create_client(SetBool, "/epos2_driver/enable")
    assert client.wait_for_service(WAIT_S)
    enabling = client.call_async(SetBool.Request(data=True))
    world.wait(lambda: driver.calls == ["configure", "enable", "enable"])
    world.publish_trajectory("a", "b")
    world.wait(lambda: driver.trajectories)
    assert world.trigger("halt").success
    count = len(states)
    world.wait(lambda: len(states) > count + 5)
    assert not enabling.done()
    driver.blocked["enable"].set()
    world.wait(enabling.done)
    assert enabling.result().success


# -- messages --------------------------------------------------------------------------------

IP_MODE_ACTIVE = 1 << STATUS_BITS["ip_mode_active"]


def buffer_values(status_word: int, **values: Any) -> tuple[DiagnosticStatus, dict[str, str]]:
    axis = axis_snapshot("a", 3, status_word=status_word, **values)
    (status,) = messages.buffer_status(snapshot_of(axis), "can0", Time()).status
    return status, {value.key: value.value for value in status.values}


@pytest.mark.parametrize("flag", STATUS_BITS)
def test_each_flag_of_the_buffer_status_word_is_a_key(flag):
    status, values = buffer_values(1 << STATUS_BITS[flag] | IP_MODE_ACTIVE)
    assert {name: values[name] for name in STATUS_BITS} == {
        name: "true" if name in (flag, "ip_mode_active") else "false" for name in STATUS_BITS
    }
    if flag.endswith("error"):
        assert (status.level, status.message) == (DiagnosticStatus.ERROR, flag.replace("_", " "))
    elif flag.endswith("warning"):
        assert (status.level, status.message) == (DiagnosticStatus.WARN, flag.replace("_", " "))
    else:
        assert status.level == DiagnosticStatus.OK


def test_flags_words_and_states_are_numbers_too():
    """As Qt's QString::toDouble and JavaScript's Number have them, with which tools read values."""
    axis = axis_snapshot("a", 1, status_word=0xC001, state="fault", homed="here", emergency=0x2310)
    snapshot = snapshot_of(axis, state="fault", bus_state="error passive")
    (buffer,) = messages.buffer_status(snapshot, "can0", Time()).status
    drive, bus = messages.diagnostics(snapshot, "n", "can0", Time(), ClockLimits()).status
    numbers = [
        {v.key: float(v.value) for v in s.values if v.key.endswith("number") or v.key == "level"}
        for s in (buffer, drive, bus)
    ]
    assert numbers[0] == {
        "level": 1,
        "status_word_number": 49153,
        **{f"{name}_number": 0xC001 >> bit & 1 for name, bit in STATUS_BITS.items()},
    }
    assert numbers[1] == {
        "level": 2,
        "state number": 7,  # the last of the states of CiA 402
        "last emergency number": 8976,
        "referenced number": 1,
    }
    assert numbers[2] == {"level": 2, "group number": 15, "controller number": 2}
    silent = replace(axis, silent_s=3.0)
    drive = messages.diagnostics(snapshot_of(silent), "n", "can0", Time(), ClockLimits()).status[0]
    values = {v.key: v.value for v in drive.values}
    assert (values["level"], values["state number"]) == ("3", "-1")


def test_the_worst_flag_speaks():
    status, _ = buffer_values(0x8000 | 0x0001 | 0x0400)
    assert (status.level, status.message) == (DiagnosticStatus.ERROR, "velocity error")


def test_a_standing_axis_that_has_no_records_is_no_warning():
    status, values = buffer_values(0x4001)
    assert (status.level, status.message) == (DiagnosticStatus.OK, "ok")
    assert values["underflow_warning"] == "true"  # it says so all the same
    assert values["ip_mode_active"] == "false"
    status, _ = buffer_values(0x4101)
    assert (status.level, status.message) == (DiagnosticStatus.ERROR, "underflow error")


def test_what_is_not_heard_is_stale():
    silent = axis_snapshot("a", 3, silent_s=7.2)
    (buffer,) = messages.buffer_status(snapshot_of(silent), "can0", Time()).status
    drive = messages.diagnostics(snapshot_of(silent), "n", "can0", Time(), ClockLimits()).status[0]
    for status in (buffer, drive):
        assert status.level == DiagnosticStatus.STALE
        assert status.message == "not heard any more; it was: operation enabled"
    values = {value.key: value.value for value in drive.values}
    assert (values["state"], values["not heard for [s]"]) == ("unknown", "7.2")


def test_nothing_stands_at_minus_zero():
    state = messages.joint_state(JointStates(0.0, ["a"], [-0.0], [-0.0], [math.nan]), Time())
    assert str([*state.position, *state.velocity]) == "[0.0, 0.0]"


def test_joint_states_are_of_those_that_are_heard(world):
    driver = world.started()
    states = world.listen(JointState, "/joint_states")
    world.wait(lambda: states and list(states[-1].name) == ["a", "b"])
    driver.current = snapshot_of(axis_snapshot("a", 1, silent_s=2.0), axis_snapshot("b", 2))
    world.wait(lambda: list(states[-1].name) == ["b"])
    driver.current = snapshot_of(axis_snapshot("a", 1, silent_s=2.0))
    time.sleep(0.1)  # those on their way
    count = len(states)
    time.sleep(0.3)
    assert len(states) == count


def test_without_a_namespace_names_are_short(world):
    world.started()
    array = world.listen(DiagnosticArray, "/diagnostics")
    world.wait(lambda: array)
    names = {status.name for status in array[-1].status}
    ids = {status.hardware_id for status in array[-1].status}
    assert (names, ids) == (
        {"epos2_driver: a", "epos2_driver: b", "epos2_driver: bus"},
        {"epos2", "epos2/1", "epos2/2"},
    )


def test_in_a_namespace_diagnostics_say_which(world):
    world.start(namespace="/robot1", joints=["a"])
    world.logged("active: ")
    array = world.listen(DiagnosticArray, "/diagnostics")
    world.wait(lambda: array)
    assert [(status.name, status.hardware_id) for status in array[-1].status] == [
        ("robot1/epos2_driver: a", "robot1/epos2/1"),
        ("robot1/epos2_driver: bus", "robot1/epos2"),
    ]


def test_buffer_status_has_the_numbers():
    status, values = buffer_values(0xC002, used=61, free=3, buffered_ms=480.0)
    assert (status.name, status.hardware_id) == ("a", "can0/3")
    assert values["used"] == "61"
    assert values["free"] == "3"
    assert values["size"] == "64"
    assert float(values["buffered_ms"]) == 480.0
    assert int(values["status_word"], 16) == 0xC002


@pytest.mark.parametrize(
    ("state", "fault", "level", "message"),
    [
        ("operation enabled", "", DiagnosticStatus.OK, "operation enabled"),
        ("switch on disabled", "", DiagnosticStatus.WARN, "switch on disabled"),
        ("fault", "over-current (0x2310)", DiagnosticStatus.ERROR, "over-current (0x2310)"),
        ("fault reaction active", "", DiagnosticStatus.ERROR, "fault reaction active"),
    ],
)
def test_diagnostics_of_a_drive(state, fault, level, message):
    axis = axis_snapshot(
        "a",
        3,
        state=state,
        fault=fault,
        following_error_qc=-4,
        clock_drift_ppm=12.5,
        reserve_ms=361.6,
    )
    array = messages.diagnostics(snapshot_of(axis), "epos2_driver", "can0", Time(), ClockLimits())
    drive = array.status[0]
    assert (drive.level, drive.message) == (level, message)
    values = {value.key: value.value for value in drive.values}
    assert values["state"] == state
    assert values["following error [qc]"] == "-4"
    assert float(values["clock drift [ppm]"]) == 12.5
    assert values["least buffer reserve [ms]"] == "362"


@pytest.mark.parametrize(
    ("offset_us", "drift_ppm", "level", "message"),
    [
        (-99.0, 199.0, DiagnosticStatus.OK, "operation enabled"),
        (math.nan, 0.0, DiagnosticStatus.OK, "operation enabled"),  # not known yet
        (-101.0, 0.0, DiagnosticStatus.WARN, "clock 101 us off, drifts 0 ppm"),
        (0.0, -201.0, DiagnosticStatus.WARN, "clock 0 us off, drifts 201 ppm"),
        (1001.0, 0.0, DiagnosticStatus.ERROR, "clock 1001 us off, drifts 0 ppm"),
        (0.0, 451.0, DiagnosticStatus.ERROR, "clock 0 us off, drifts 451 ppm"),
    ],
)
def test_a_clock_beyond_its_limits_is_told(offset_us, drift_ppm, level, message):
    axis = axis_snapshot("a", 3, clock_offset_us=offset_us, clock_drift_ppm=drift_ppm)
    limits = ClockLimits(100.0, 1000.0, 200.0, 450.0)
    drive = messages.diagnostics(snapshot_of(axis), "node", "can0", Time(), limits).status[0]
    assert (drive.level, drive.message) == (level, message)


@pytest.mark.parametrize(
    ("values", "level"),
    [
        ({}, DiagnosticStatus.OK),
        ({"dropped_frames": 3}, DiagnosticStatus.WARN),
        ({"error_frames": 1}, DiagnosticStatus.WARN),
        ({"refused_frames": 9}, DiagnosticStatus.OK),  # a full queue only delays
        ({"late": LatenessFigures(80.4, 900.0, 70_000.0, 9)}, DiagnosticStatus.OK),
        ({"state": "fault", "reason": "b: over-current"}, DiagnosticStatus.ERROR),
    ],
)
def test_diagnostics_of_the_bus(values, level):
    snapshot = snapshot_of(axis_snapshot("a", 1), **values)
    bus = messages.diagnostics(snapshot, "epos2_driver", "can0", Time(), ClockLimits()).status[-1]
    assert (bus.level, bus.name) == (level, "epos2_driver: bus")
    told = {v.key: v.value for v in bus.values}
    assert told["load [%]"] == "12.5"
    late = [told[f"thread late, {which} [us]"] for which in ("median", "99 %", "worst")]
    assert late == (["80", "900", "70000"] if "late" in values else ["", "", ""])


@pytest.mark.parametrize(
    ("tally", "level", "message"),
    [
        (Tally(), DiagnosticStatus.OK, "no motion yet"),
        (Tally(5), DiagnosticStatus.OK, "no predicted motion has ended yet"),
        (Tally(4, 2, 2, -31.0), DiagnosticStatus.OK, "as predicted"),
        (
            Tally(3, 2, 1, 0.0, "2 events predicted, 1 reported"),
            DiagnosticStatus.WARN,
            "2 events predicted, 1 reported",
        ),
    ],
)
def test_diagnostics_of_an_output(tally, level, message):
    outputs = (OutputSnapshot("camera", "a", 1, tally),)
    snapshot = snapshot_of(axis_snapshot("a", 1), outputs=outputs)
    status = messages.diagnostics(snapshot, "node", "can0", Time(), ClockLimits()).status[1]
    assert (status.name, status.hardware_id) == ("node: compare.camera", "can0/1")
    assert (status.level, status.message) == (level, message)
    assert {v.key: v.value for v in status.values}["events"] == str(tally.events)


# -- the program -----------------------------------------------------------------------------


def spin_until(witness: Witness, what: Callable[[], bool]) -> None:
    deadline = time.monotonic() + WAIT_S
    while not what():
        assert time.monotonic() < deadline
        witness.spin(0.02)


GANTRY = Path(__file__).parents[2] / "config" / "gantry.yaml"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_ctrl_c_stops_on_the_path(number, program, ros_domain_id, examples, tmp_path):
    if signal.getsignal(number) is signal.SIG_IGN:  # under nohup; children would ignore it, too
        signal.signal(number, signal.SIG_DFL)
    log = tmp_path / "log.npz"
    driver = program(
        *("--ros-args", "--params-file", str(GANTRY)),
        *("-p", f"epos2_driver:simulation.log:={log}"),
    )
    driver.read_until("active: ")
    trajectory = Trajectory.from_dict(yaml.safe_load((examples / "raster_scan.yaml").read_text()))
    with Witness(ros_domain_id) as witness:
        spin_until(witness, lambda: witness.ready)
        witness.publish(trajectory)
        spin_until(witness, lambda: witness.positions["gantry_x"] > 0.05)  # on its first line
        assert driver.end(number) == 0
    steps = ("stopping", "stopped on the path", "inactive: all axes disabled", "shut down")
    told = re.findall("|".join(steps), driver.output)
    assert set(told) == set(steps) and (told[0], told[-1]) == (steps[0], steps[-1]), driver.output
    assert f"{signal.Signals(number).name}: stopping" in driver.output
    assert "Traceback" not in driver.output
    assert "context" not in driver.output
    x, y = (Executed.load(log, node).demand_qc for node in (1, 2))
    assert len(x) < 4500  # of 9000 ms
    assert max(abs(x[-1] - x[-2]), abs(y[-1] - y[-2])) <= 2  # it came to rest …
    assert np.abs(np.diff(x, 2)).max() <= 4  # … as gently as it was told to move, 2 qc/ms² …
    lines = [abs(y), abs(x - 400_000), abs(y - 20_000), abs(x), abs(y - 40_000)]
    assert np.min(lines, axis=0).max() <= 1.0  # … on the lines of the raster


def test_ctrl_c_ends_what_waits_for_its_stamp(program, ros_domain_id, examples, tmp_path):
    """Nothing moves, and the drives are off long before the stamp a minute ahead."""
    log = tmp_path / "log.npz"
    driver = program(
        *("--ros-args", "--params-file", str(GANTRY)),
        *("-p", f"epos2_driver:simulation.log:={log}"),
    )
    driver.read_until("active: ")
    trajectory = Trajectory.from_dict(yaml.safe_load((examples / "raster_scan.yaml").read_text()))
    with Witness(ros_domain_id) as witness:
        spin_until(witness, lambda: witness.ready)
        witness.publish(replace(trajectory, stamp_s=time.time() + 60))
        driver.read_until("waits for its stamp")
        asked = time.monotonic()
        assert driver.end(signal.SIGINT) == 0
        assert time.monotonic() - asked < 10
    assert "cancelled before it began" in driver.output
    assert "Traceback" not in driver.output
    for node in (1, 2):
        with pytest.raises(Epos2RosError, match="did not move"):
            Executed.load(log, node)


def test_after_shutdown_by_lifecycle_the_process_ends(program, ros_domain_id):
    driver = program("--ros-args", "-p", "autostart:=false")
    driver.read_until("next: ros2 lifecycle set /epos2_driver configure")
    context = Context()
    rclpy.init(args=[], context=context, domain_id=ros_domain_id)
    peer = Node("peer", context=context)
    client = peer.create_client(ChangeState, "/epos2_driver/change_state")
    assert client.wait_for_service(WAIT_S)
    end = Transition(id=Transition.TRANSITION_UNCONFIGURED_SHUTDOWN)
    answer = client.call_async(ChangeState.Request(transition=end))
    executor = SingleThreadedExecutor(context=context)
    rclpy.spin_until_future_complete(peer, answer, executor, timeout_sec=WAIT_S)
    assert answer.result().success  # it still answers
    driver.read_until("shut down")
    assert driver.wait() == 0
    peer.destroy_node()
    context.shutdown()


def test_a_driver_that_cannot_configure_stays_up_and_ends_cleanly(program):
    driver = program("--ros-args", "-p", "axes.joint_1.gear_ratio:=-5.0")
    driver.read_until("configure failed: axes.joint_1.gear_ratio is -5.0")
    assert driver.end(signal.SIGINT) == 0
    assert "Traceback" not in driver.output


def test_arguments_ros_cannot_read_are_one_line_and_a_status(program):
    driver = program("--ros-args", "-p", "nonsense")
    driver.read_until("epos2_ros driver: ")
    assert driver.end(0) == 2
    assert "Traceback" not in driver.output


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--params-file", "/nonexistent.yaml"], "can't read /nonexistent.yaml: No such file"),
        (["--params-file", "FILE", "-r", "__ns:=/robot1"], "is for /robot1/epos2_driver: it has "),
        (["--params-file", "FILE", "-r", "__node:=arm"], "is for /arm: it has parameters of /epos"),
        (["-p", "epos2_driver:simulate:=true", "-r", "__node:=arm"], "is for /arm: it has "),
    ],
)
def test_parameters_that_reach_no_node_end_the_start(program, tmp_path, arguments, says):
    """Else the driver would move simulated drives for somebody who believes to move real ones."""
    file = tmp_path / "real.yaml"
    file.write_text("/epos2_driver: {ros__parameters: {can: {interface: socketcan}}}\n")
    driver = program("--ros-args", *(str(file) if a == "FILE" else a for a in arguments))
    driver.read_until(says)
    assert driver.end(0) == 2
    assert driver.output.count("\n") == 1


@pytest.mark.parametrize("renamed", ["__ns:=/robot1", "__node:=arm"])
@pytest.mark.parametrize("file", PARAMETER_FILES)
def test_shipped_parameters_reach_a_driver_of_any_name(file, renamed):
    node = "/robot1/epos2_driver" if "ns" in renamed else "/arm"
    assert read_parameters(file, node) == read_parameters(file)


def test_simulated_drives_are_a_warning_and_a_key_in_diagnostics(world):
    world.started(simulate=True)
    simulated = [level for level, line in world.log if "simulated drives" in line]
    assert simulated == ["WARN"]
    for simulated, says in ((True, "simulated"), (False, "real")):
        snapshot = snapshot_of(axis_snapshot("a", 1), simulated=simulated)
        array = messages.diagnostics(snapshot, "node", "can0", Time(), ClockLimits())
        assert {v.key: v.value for v in array.status[-1].values}["drives"] == says


def test_real_drives_are_no_warning(world):
    world.started(simulate=False)
    assert not [line for level, line in world.log if level != "INFO" or "simulated" in line]


@pytest.mark.parametrize("before", [[], ["--ros-args"]])
def test_main_refuses_arguments_it_does_not_know(before, capsys):
    with pytest.raises(SystemExit) as caught:
        main([*before, "--six-axes"])
    assert caught.value.code == 2
    last_line = capsys.readouterr().err.splitlines()[-1]
    assert last_line.startswith("epos2_ros driver: error: ")
    assert "--six-axes" in last_line
