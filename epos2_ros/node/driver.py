"""The driver node: a managed ROS 2 node around `epos2_ros.bus.driver.Driver`.

It translates messages and owns no motion logic. What this file keeps to:

* A blocking service or transition never stalls a topic, nor another: what blocks runs in `lanes`,
  and the executor's one thread goes on.
* Transitions follow one another: whoever asks (a service, autostart, Ctrl-C) holds
  `_transitions` meanwhile.
* What goes wrong on purpose (`Epos2RosError`) is one log line and a refused transition or
  `success: false`; the process stays up, so that `configure` can be asked for again.
* What nobody expected, in whatever callback, stops the axes; the node goes on.
"""

from __future__ import annotations

import argparse
import functools
import gc
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import rclpy
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy._rclpy_pybind11 import RCLError, UnknownROSArgsError
from rclpy.clock import Clock, ClockType, ROSClock
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.logging import LoggingSeverity
from rclpy.publisher import Publisher
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from rclpy.utilities import remove_ros_args
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory

from epos2_ros import surroundings
from epos2_ros.bus.driver import Driver
from epos2_ros.bus.supervisor import described
from epos2_ros.configuration.arguments import given_parameters
from epos2_ros.configuration.driver import ClockLimits, DriverConfig
from epos2_ros.configuration.files import DRIVER
from epos2_ros.configuration.names import Names
from epos2_ros.configuration.outputs import CompareConfig
from epos2_ros.errors import Epos2RosError, TrajectoryError
from epos2_ros.motion.move import target_of
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.node import messages
from epos2_ros.node.lanes import Lanes, events_executor, spin
from epos2_ros.node.log_lines import LogLines
from epos2_ros.node.parameters import Parameters
from epos2_ros.node.serialized import read_trajectory
from epos2_ros.protocol.outbox import Event
from epos2_ros.protocol.outputs.outputs import OutputEvent

if TYPE_CHECKING:
    from epos2_ros.node.action import TrajectoryAction

DIAGNOSTICS_PERIOD_S = 1.0
EVENTS_KEPT = 1000  # of an output, for a subscriber that is slow: they come in bursts
CLOCK_READINGS = 3
SET_BACK_NS = 1_000_000_000  # a clock that is behind its last reading by more
SIGNALS_S = 0.25  # between looks for signals
# New objects after which Python looks for garbage, which stops all threads: not amidst the points
# of a long trajectory. Python: 700
GARBAGE_AFTER = 100_000
SWITCH_INTERVAL_S = 0.0005  # how long a received frame waits for a computing thread; Python: 5 ms

MakeDriver = Callable[
    [
        DriverConfig,
        Callable[[Event], None],
        Callable[[OutputEvent], None],
        Callable[[str], None] | None,
    ],
    Driver,
]
Transition = Callable[["DriverNode", LifecycleState], TransitionCallbackReturn]


def _transition(step: Transition) -> Transition:
    """A transition that says why it fails; rclpy alone would swallow the exception."""

    @functools.wraps(step)
    def run(node: DriverNode, state: LifecycleState) -> TransitionCallbackReturn:
        name = step.__name__.removeprefix("on_")
        try:
            return step(node, state)
        except Epos2RosError as error:
            node.get_logger().error(f"{name} failed: {error}")
            return TransitionCallbackReturn.FAILURE
        except Exception:
            node.get_logger().fatal(f"{name} failed:\n{traceback.format_exc()}")
            raise

    return run


class DriverNode(LifecycleNode):
    """`/epos2_driver`. `on_finalized` is called when the lifecycle has come to its end."""

    def __init__(
        self,
        make_driver: MakeDriver = Driver,
        on_finalized: Callable[[], None] = lambda: None,
        **kwargs: Any,
    ) -> None:
        super().__init__(DRIVER, **kwargs)
        self._make_driver = make_driver
        self._on_finalized = on_finalized
        self._driver: Driver | None = None
        self._active = False
        self._lines = LogLines()
        self._lanes = Lanes(self.broke)
        self._transitions = threading.RLock()
        self._declared = Parameters(
            self, changeable=lambda: self._driver is None, set_output=self._set_output
        )
        self._channel = ""
        self._clock_limits = ClockLimits()
        self._effort_told = False
        self._state_ns = -SET_BACK_NS  # of the last joint states
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._topic_timers: list[rclpy.timer.Timer] = []

        self._joint_states = self.create_publisher(JointState, "joint_states", 10)
        self._buffer_status = self.create_publisher(DiagnosticArray, "~/buffer_status", 10)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.create_subscription(
            JointTrajectory,
            "~/joint_trajectory",
            self._lanes.takes("trajectory", self._on_trajectory),
            10,
            raw=True,
        )
        self.create_subscription(
            JointTrajectory, "~/move_to", self._lanes.takes("moves", self._on_move_to), 10
        )
        self._output_events: dict[str, Publisher] = {}
        for output in self._declared.outputs:
            at = f"~/compare/{output}"
            self._output_events[output] = self.create_publisher(JointState, at, EVENTS_KEPT)
            self.create_subscription(
                Float64MultiArray,
                f"{at}/positions",
                self._lanes.takes("outputs", functools.partial(self._on_positions, output)),
                10,
            )
        self._offer(SetBool, "~/enable", self._on_enable)
        self._offer_trigger("~/halt", "halted", lambda driver: driver.halt())
        self._offer_trigger("~/quick_stop", "stopped", lambda driver: driver.quick_stop())
        self._offer_trigger("~/home", "all axes are home", lambda driver: driver.home())
        self._offer_trigger("~/reset_fault", "no fault", lambda driver: driver.reset_fault())

        self._action: TrajectoryAction | None = None
        if find_spec("control_msgs") is not None:  # not among what is needed to run
            from epos2_ros.node.action import TrajectoryAction

            self._action = TrajectoryAction(
                self, self._lanes, self._activated, self._received, self._ros_time, self._host_us
            )

        self._answer_change_state = self._service_change_state.callback
        self._service_change_state.callback = self._on_change_state
        self._lanes.answers("transitions", self._service_change_state)
        for service in self.services:  # an output's parameter is changed in its drive
            if service.srv_type in (SetParameters, SetParametersAtomically):
                self._lanes.answers("outputs", service)
        if self._declared["autostart"]:
            self._autostart_timer = self.create_timer(0.001, self._autostart, clock=self._steady)
        else:
            self._say_what_is_next("unconfigured", "configure")
            self._warn_of_parameters()

    # -- lifecycle ---------------------------------------------------------------------------

    @_transition
    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        config = self._declared.config()
        debugging = self.get_logger().is_enabled_for(LoggingSeverity.DEBUG)
        on_trace = self._on_trace if debugging else None
        slow, line = surroundings.compiling()
        if line:
            (self.get_logger().warning if slow else self.get_logger().info)(line)
        driver = self._make_driver(config, self._on_event, self._on_output, on_trace)
        # What is there by now stays: to look through it for garbage would stop all threads of the
        # process for 70 ms now and then, the one that feeds the drives, too. On a busy machine that
        # is long enough for drives to miss the host's heartbeat, so once more before there is one.
        gc.collect()
        driver.configure()
        gc.freeze()
        self._driver = driver
        self._channel = Names(self.get_fully_qualified_name()).bus(config.channel)
        self._clock_limits = config.clock_limits
        if self._action is not None:
            self._action.configured(config)
        self._topic_timers = [
            self.create_timer(period, publish, clock=self._steady)
            for period, publish in (
                (1.0 / self._declared["state_rate"], self._publish_states),
                (1.0 / self._declared["status_rate"], self._publish_buffer_status),
                (DIAGNOSTICS_PERIOD_S, self._publish_diagnostics),
            )
        ]
        where = f"{len(config.axes)} {{}} on {config.interface} {config.channel}"
        if config.simulate:
            simulated = where.format("simulated drives")
            self.get_logger().warning(f"configured: {simulated}: no real drive moves")
        else:
            self.get_logger().info(f"configured: {where.format('drives')}")
        if not self._declared["autostart"]:
            self._say_what_is_next("all axes off", "activate")
        return TransitionCallbackReturn.SUCCESS

    @_transition
    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._configured().enable()
        self._active = True
        self.get_logger().info("active: all axes enabled, ready for a trajectory")
        return TransitionCallbackReturn.SUCCESS

    @_transition
    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._active = False  # nothing new begins meanwhile
        try:
            self._configured().disable()
        except Epos2RosError:
            self._active = True  # the lifecycle goes back to "active", too
            raise
        self.get_logger().info("inactive: all axes disabled")
        return TransitionCallbackReturn.SUCCESS

    @_transition
    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._release()
        self.get_logger().info("unconfigured: the bus is closed")
        return TransitionCallbackReturn.SUCCESS

    @_transition
    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        try:
            if self._active:
                self.on_deactivate(state)
        finally:
            self._release()
        self.get_logger().info("shut down")
        return TransitionCallbackReturn.SUCCESS

    @_transition
    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._release()
        self.get_logger().info("unconfigured after an error: the bus is closed")
        return TransitionCallbackReturn.SUCCESS

    def shut_down(self) -> None:
        """Stop on the path, disable and close the bus, in whatever state the node is."""
        with self._transitions:
            if self._state_machine.current_state[1] != "finalized":
                self.trigger_shutdown()
        if self._action is not None:
            self._action.close()

    def _release(self) -> None:
        """Closes the bus and ends the topics; harmless when there is nothing to close."""
        self._active = False
        for timer in self._topic_timers:
            self.destroy_timer(timer)
        self._topic_timers = []
        driver, self._driver = self._driver, None
        if driver is not None:
            driver.close()
            gc.unfreeze()

    def destroy_node(self) -> None:
        """After the executor's end."""
        self._lanes.close()
        super().destroy_node()

    def _autostart(self) -> None:
        self.destroy_timer(self._autostart_timer)
        self._lanes.run("transitions", self._start)

    def _start(self) -> None:
        with self._transitions:
            if self.trigger_configure() == TransitionCallbackReturn.SUCCESS:
                self.trigger_activate()

    def _say_what_is_next(self, now: str, transition: str) -> None:
        """The line with which somebody who has to go on by hand knows how."""
        what = "simulated drives" if self._declared["simulate"] else "drives"
        on = f"{self._declared['can.interface']} {self._declared['can.channel']}"
        self.get_logger().info(
            f"{now}, {len(self._declared['joints'])} {what} on {on}; next: "
            f"ros2 lifecycle set {self.get_fully_qualified_name()} {transition}"
        )

    def _warn_of_parameters(self) -> None:
        try:
            self._declared.config()
        except Epos2RosError as error:
            self.get_logger().warning(f"configure will fail: {error}")

    def _on_change_state(
        self, request: ChangeState.Request, response: ChangeState.Response
    ) -> ChangeState.Response:
        """rclpy raises on a transition that the state does not have, which would end the node."""
        with self._transitions:
            try:
                response = self._answer_change_state(request, response)
                if self._state_machine.current_state[1] == "finalized":
                    self._on_finalized()
                return response
            except RCLError:
                state = self._state_machine.current_state[1]
                self.get_logger().warning(
                    f"no transition {request.transition.label or request.transition.id} "
                    f"while the node is {state}"
                )
                response.success = False
                return response

    # -- topics ------------------------------------------------------------------------------

    def _on_trajectory(self, serialized: bytes) -> None:
        try:
            self._activated().submit(self._received(read_trajectory(serialized)))
        except Epos2RosError as error:
            self._refused(f"trajectory refused: {error}")

    def _received(self, trajectory: Trajectory) -> Trajectory:
        """With its stamp, which is a time of the node's clock, in that of the system.

        The drives' time goes on as the system's does: simulated time is compared with it at the
        moment of the message.
        """
        if trajectory.has_effort and not self._effort_told:
            self._effort_told = True
            self.get_logger().warning(
                "effort in a trajectory's points is ignored: the drives follow positions"
            )
        clock = self.get_clock()
        assert isinstance(clock, ROSClock)
        if trajectory.stamp_s is None or not clock.ros_time_is_active:
            return trajectory
        now_ns = clock.now().nanoseconds
        if not now_ns:
            raise TrajectoryError(
                "use_sim_time is true, and no /clock has come yet: header.stamp means nothing"
            )
        return replace(trajectory, stamp_s=trajectory.stamp_s - now_ns * 1e-9 + time.time())

    def _on_move_to(self, message: JointTrajectory) -> None:
        try:
            self._activated().move_to(*target_of(Trajectory.from_message(message)))
        except Epos2RosError as error:
            self._refused(f"move refused: {error}")

    def _on_positions(self, output: str, message: Float64MultiArray) -> None:
        try:
            self._configured().set_positions(output, list(message.data))
            self._declared.note_positions(output, message.data)
        except Epos2RosError as error:
            self._refused(f"positions refused: {error}")

    def _refused(self, line: str) -> None:
        if (admitted := self._lines.admit("refused", line)) is not None:
            self.get_logger().error(admitted)

    def _on_output(self, event: OutputEvent) -> None:
        self._output_events[event.name].publish(
            messages.output_event(event, self._ros_time(event.t_us))
        )

    def _set_output(self, config: CompareConfig) -> None:
        """A parameter of an output has changed while the driver runs."""
        self._configured().set_output(config)

    def _publish_states(self) -> None:
        if (driver := self._driver) is not None:
            if self._action is not None:
                self._action.publish_state(driver)
            states = driver.joint_states()
            stamp_ns = self._ros_ns(states.t_us)
            # Simulated time may stand still, be set back, or not have begun: zero is no time.
            repeated = stamp_ns > 0 and 0 <= self._state_ns - stamp_ns < SET_BACK_NS
            if states.joints and not repeated:
                self._state_ns = stamp_ns
                self._joint_states.publish(messages.joint_state(states, _time(stamp_ns)))

    def _publish_buffer_status(self) -> None:
        if (driver := self._driver) is not None and self._buffer_status.get_subscription_count():
            snapshot = driver.snapshot()
            stamp = self.get_clock().now().to_msg()
            self._buffer_status.publish(messages.buffer_status(snapshot, self._channel, stamp))

    def _publish_diagnostics(self) -> None:
        if (driver := self._driver) is not None:
            snapshot = driver.snapshot()
            stamp = self.get_clock().now().to_msg()
            name = self.get_fully_qualified_name().lstrip("/")
            self._diagnostics.publish(
                messages.diagnostics(snapshot, name, self._channel, stamp, self._clock_limits)
            )

    def _ros_time(self, host_us: float) -> Time:
        """Host time (monotonic [µs]) as ROS time."""
        return _time(self._ros_ns(host_us))

    def _ros_ns(self, host_us: float) -> int:
        return max(0, round(host_us * 1e3) + self._clock_offset_ns())

    def _host_us(self, stamp: Time) -> float:
        """ROS time as host time (monotonic [µs])."""
        return (stamp.sec * 10**9 + stamp.nanosec - self._clock_offset_ns()) / 1e3

    def _clock_offset_ns(self) -> int:
        """ROS time minus host time."""
        readings = []
        for _ in range(CLOCK_READINGS):  # the one that took least was not interrupted
            before = time.monotonic_ns()
            now = self.get_clock().now().nanoseconds
            readings.append((time.monotonic_ns() - before, now - before))
        return min(readings)[1]

    def _on_event(self, event: Event) -> None:
        text: str | None = event.text
        if event.kind not in ("drive", "fault"):  # of the others a commander may cause a flood
            text = self._lines.admit(event.kind, event.text)
        if text is None:
            return
        if event.kind in ("aborted", "fault"):
            self.get_logger().error(text)
        elif event.kind == "warning":
            self.get_logger().warning(text)
        else:
            self.get_logger().info(text)

    def _on_trace(self, line: str) -> None:
        self.get_logger().debug(line)

    # -- services ----------------------------------------------------------------------------

    def _offer(self, kind: Any, name: str, answer: Callable[[Any, Any], Any]) -> None:
        self._lanes.answers(name, self.create_service(kind, name, answer))

    def _offer_trigger(self, name: str, done: str, action: Callable[[Driver], None]) -> None:
        def answer(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            what = name.removeprefix("~/").replace("_", " ")
            return self._answer(response, what, done, lambda: action(self._configured()))

        self._offer(Trigger, name, answer)

    def _on_enable(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        if request.data:
            done = "all axes enabled"
            return self._answer(response, "enable", done, lambda: self._activated().enable())
        done = "all axes disabled"
        return self._answer(response, "disable", done, lambda: self._configured().disable())

    def _answer(self, response: Any, what: str, done: str, action: Callable[[], None]) -> Any:
        try:
            action()
            response.success, response.message = True, done
            self.get_logger().info(f"{what}: {done}")
        except Epos2RosError as error:
            response.success, response.message = False, str(error)
            self.get_logger().warning(f"{what} failed: {error}")
        except Exception as error:
            self.broke("a service", error)
            response.success, response.message = False, f"internal error: {described(error)}"
        return response

    def broke(self, where: str, error: BaseException) -> None:
        """A thread or callback raised what nobody expected: said, and all axes stop."""
        self.get_logger().fatal(
            f"internal error in {where}:\n{''.join(traceback.format_exception(error))}"
        )
        if (driver := self._driver) is not None:
            driver.broke(where, error)

    def _configured(self) -> Driver:
        if self._driver is None:
            raise Epos2RosError("the node is not configured")
        return self._driver

    def _activated(self) -> Driver:
        driver = self._configured()
        if not self._active:
            raise Epos2RosError("the node is not active")
        return driver


def _time(stamp_ns: int) -> Time:
    sec, nanosec = divmod(stamp_ns, 10**9)
    return Time(sec=sec, nanosec=nanosec)


def main(argv: Sequence[str] | None = None) -> int:
    """`epos2_ros driver`: until Ctrl-C, SIGTERM or SIGHUP; then stops on the path and returns 0."""
    args = sys.argv[1:] if argv is None else list(argv)
    usage = argparse.ArgumentParser(
        prog="epos2_ros driver",
        description="The driver node. Parameters are given as to every ROS 2 node: "
        "--ros-args -p NAME:=VALUE or --params-file FILE.",
    )
    # rclpy's own handlers would end the context at once, and the topics with it; here the motion
    # is brought to a stop first. The main thread does nothing but wait, so it gets the signal.
    asked_to_stop, ended = threading.Event(), Future()
    signals: list[str] = []

    def on_signal(number: int, _: object) -> None:
        signals.append(signal.Signals(number).name)
        asked_to_stop.set()

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, on_signal)
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # which `nohup` has asked for
        signal.signal(signal.SIGHUP, on_signal)
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    gc.set_threshold(GARBAGE_AFTER, *gc.get_threshold()[1:])
    try:
        given = given_parameters(args)
        usage.parse_args(remove_ros_args(args))
        more_args, no_log_file = surroundings.without_log_file()
        rclpy.init(args=args + more_args, signal_handler_options=SignalHandlerOptions.NO)
        node = DriverNode(on_finalized=asked_to_stop.set)
        for parameters in given:
            parameters.of(node.get_fully_qualified_name())
    except UnknownROSArgsError as error:
        usage.error(f"unrecognized ROS arguments: {error}")
    except (Epos2RosError, RCLError) as error:
        print(f"epos2_ros driver: {str(error).splitlines()[0]}", file=sys.stderr)
        rclpy.try_shutdown()
        return 2

    logger = node.get_logger()
    if no_log_file:
        logger.warning(no_log_file)
    executor = events_executor()
    executor.add_node(node)
    threading.excepthook = lambda failed: node.broke(
        f"thread {failed.thread.name if failed.thread else ''}",
        failed.exc_value or failed.exc_type(),
    )

    spinning = threading.Thread(
        target=spin, args=(executor, ended, node.broke), name="executor", daemon=True
    )
    spinning.start()
    # Handlers run in this thread only, and a signal that the kernel has handed to another does not
    # wake it.
    while not asked_to_stop.wait(SIGNALS_S):
        pass
    for name in signals:
        logger.info(f"{name}: stopping")
    node.shut_down()
    ended.set_result(None)
    spinning.join()
    executor.shutdown()
    node.destroy_node()
    rclpy.shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
