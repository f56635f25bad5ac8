"""The command `epos2_ros monitor`: listens to one driver, draws, and passes two keys on."""

from __future__ import annotations

import argparse
import os
import signal
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from types import TracebackType
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import Log
from rclpy._rclpy_pybind11 import RCLError, UnknownROSArgsError
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from epos2_ros.configuration.files import DRIVER
from epos2_ros.configuration.names import Names
from epos2_ros.monitor.seen import ERROR, OK, WARN, Seen

REDRAW_S = 0.2
ANSWER_S = 10.0  # after which a request counts as not answered
REPEAT_S = 1.0  # from when on a key pressed again asks again
LINES_KEPT = 100  # of the log, from before the monitor
STOPS = {"h": "halt", " ": "quick_stop"}
SCROLL = {"up": -1, "down": 1, "page up": -10, "page down": 10}


class Listener:
    """A node that hears one driver and may stop it.

    `driver` is the driver's name, relative to the namespace of this node: `__ns` counts.
    """

    def __init__(self, driver: str, args: Sequence[str] = (), domain_id: int | None = None) -> None:
        self._context = Context()
        options = SignalHandlerOptions.NO
        rclpy.init(
            args=list(args),
            context=self._context,
            domain_id=domain_id,
            signal_handler_options=options,
        )
        self._node = Node(
            f"epos2_monitor_{os.getpid()}",
            context=self._context,
            enable_rosout=False,
            start_parameter_services=False,
        )
        self.seen = Seen(Names(self._node.resolve_topic_name(driver)))
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._taken = 0
        self._outputs: set[str] = set()
        self._asked: dict[str, tuple[Any, float]] = {}  # the answer to come, and since when
        name = self.seen.names.topic
        # Only the newest counts, and is taken when the next picture is due: at any `state_rate`
        # the monitor costs the same.
        self._listen(JointState, name("joint_states"), self.seen.on_joint_states, 1)
        self._listen(DiagnosticArray, name("~/buffer_status"), self.seen.on_buffer_status, 1)
        self._listen(DiagnosticArray, "/diagnostics", self._on_diagnostics, 50)
        self._listen(Log, "/rosout", self.seen.on_log, LINES_KEPT, DurabilityPolicy.TRANSIENT_LOCAL)
        self._clients = {
            stop: self._node.create_client(Trigger, name(f"~/{stop}")) for stop in STOPS.values()
        }

    def __enter__(self) -> Listener:
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

    def take(self) -> None:
        """All that has come."""
        taken = -1
        while taken != self._taken:
            taken = self._taken
            self._executor.spin_once(0)
        for stop, (answer, since_s) in list(self._asked.items()):
            if answer.done():
                done = answer.result().success  # in the words of the driver's own log
                how = "" if done else " failed"
                self._tell(f"{_words(stop)}{how}: {answer.result().message}", OK if done else ERROR)
            elif time.monotonic() - since_s < ANSWER_S:
                continue
            else:
                self._clients[stop].remove_pending_request(answer)
                self._tell(f"{_words(stop)}: NOT ANSWERED for {ANSWER_S:.0f} s", ERROR)
            del self._asked[stop]

    def stop(self, stop: str) -> None:
        """Ask for `halt` or `quick_stop`, now; the answer is an event."""
        client = self._clients[stop]
        now_s = time.monotonic()
        if stop in self._asked and now_s - self._asked[stop][1] < REPEAT_S:
            return  # the key is being held
        if not client.service_is_ready():
            self._tell(f"{_words(stop)} NOT SENT: nobody offers {client.srv_name}", ERROR)
            return
        self._asked[stop] = client.call_async(Trigger.Request()), now_s
        self._tell(f"{_words(stop)}: asked for", WARN)

    def _tell(self, text: str, level: int) -> None:
        self.seen.tell(text, level, time.time())

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        self.seen.on_diagnostics(message, time.monotonic())
        for output in self.seen.outputs.keys() - self._outputs:
            self._outputs.add(output)
            topic = self.seen.names.topic(f"~/compare/{output}")
            self._listen(JointState, topic, partial(self.seen.on_output, output), 1)

    def _listen(
        self,
        kind: Any,
        topic: str,
        take: Callable[[Any], None],
        depth: int,
        durability: DurabilityPolicy = DurabilityPolicy.VOLATILE,
    ) -> None:
        def hear(message: Any) -> None:
            self._taken += 1
            take(message)

        self._node.create_subscription(
            kind, topic, hear, QoSProfile(depth=depth, durability=durability)
        )


def main(argv: Sequence[str] | None = None) -> int:
    """Until q or Ctrl-C. Returns 0; 2 after one line for what can't be."""
    args = sys.argv[1:] if argv is None else list(argv)
    parser = argparse.ArgumentParser(
        prog="epos2_ros monitor",
        description="Live table of all axes and the bus. h halts, space is a quick stop, at once; "
        "q leaves the monitor, and the axes go on.",
    )
    parser.add_argument(
        "--node",
        metavar="NAME",
        default=DRIVER,
        help=f"the driver's name (default: {DRIVER}, in the monitor's namespace)",
    )
    given = parser.parse_args(remove_ros_args(args))
    try:
        from epos2_ros.monitor import view  # with Rich, which nothing else needs
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] != "rich":
            raise
        return _refused("needs Rich: sudo apt install python3-rich, or pip install rich")
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        return _refused("needs a terminal; for anything else there are the driver's topics")
    sys.stdout.reconfigure(errors="replace")  # type: ignore[union-attr]

    def leave(*_: Any) -> None:
        raise KeyboardInterrupt

    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, leave)
    try:
        with Listener(given.node, args) as listener:
            _show(listener, view)
    except UnknownROSArgsError as error:
        parser.error(f"unrecognized ROS arguments: {error}")
    except (RCLError, ValueError) as error:  # a name or remapping that ROS does not take
        return _refused(str(error).splitlines()[0])
    except (KeyboardInterrupt, EOFError):
        pass
    return 0


def _show(listener: Listener, view: Any) -> None:
    from rich.console import Console
    from rich.live import Live

    from epos2_ros.monitor.keyboard import Keyboard

    console, first = Console(), 0
    with (
        Keyboard(sys.stdin.fileno()) as keyboard,
        Live(console=console, screen=True, auto_refresh=False) as live,
    ):
        while True:
            listener.take()
            width, height = console.size
            last = max(0, len(listener.seen.axes) - view.rows(height))
            first = min(first, last)
            now_s = time.monotonic()
            live.update(view.draw(listener.seen, now_s, width, height, first), refresh=True)
            for key in keyboard.pressed(REDRAW_S):
                if key in STOPS:
                    listener.stop(STOPS[key])
                elif key == "q":
                    return
                first = min(max(0, first + SCROLL.get(key, 0)), last)


def _words(stop: str) -> str:
    return stop.replace("_", " ")


def _refused(line: str) -> int:
    print(f"epos2_ros monitor: {line}", file=sys.stderr)
    return 2
