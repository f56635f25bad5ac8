"""`epos2_ros monitor`: what it makes of the driver's messages, and that its keys ask nothing."""

from __future__ import annotations

import fcntl
import os
import pty
import select
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Callable
from io import StringIO
from types import SimpleNamespace
from typing import Any

import pytest
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from hypothesis import given, settings
from hypothesis import strategies as st
from rcl_interfaces.msg import Log
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from epos2_ros.bus.snapshot import AxisSnapshot, JointStates, OutputSnapshot, Snapshot
from epos2_ros.configuration.driver import ClockLimits
from epos2_ros.configuration.names import Names
from epos2_ros.monitor.keyboard import keys_in
from epos2_ros.monitor.program import Listener, main
from epos2_ros.monitor.seen import Seen
from epos2_ros.node import messages
from epos2_ros.protocol.outputs.outputs import Tally

pytest.importorskip("rich", reason="Rich is not installed")
WAIT_S = 20.0


def axis_of(joint: str, **values: Any) -> AxisSnapshot:
    moving = {
        "node_id": 1,
        "state": "operation enabled",
        "position": 0.0,
        "velocity": 0.0,
        "effort": 0.0,
        "used": 7,
        "free": 57,
        "size": 64,
        "buffered_ms": 900.0,
        "status_word": 0xC000,
        "fault": "",
        "following_error_qc": -12,
        "clock_offset_us": 3.4,
        "clock_drift_ppm": 1.0,
        "executed_qc": 0,
        "records_sent": 7,
        "buffer_flags": {"ip_mode_active": True},
    }
    return AxisSnapshot(joint=joint, **{**moving, **values})


def hear(seen: Seen, *axes: AxisSnapshot, now_s: float = 0.0, **values: Any) -> None:
    """All topics of a driver with these axes, once; as the driver makes the messages."""
    bus = {
        "state": "moving",
        "reason": "",
        "bus_load": 0.0814,
        "sync_count": 1,
        "sync_time_source": "kernel",
        "dropped_frames": 0,
        "error_frames": 0,
        "refused_frames": 0,
        "simulated": True,
    }
    snapshot = Snapshot(axes=axes, **{**bus, **values})
    node = seen.names.node.lstrip("/")
    seen.on_diagnostics(messages.diagnostics(snapshot, node, "can0", Time(), ClockLimits()), now_s)
    seen.on_buffer_status(messages.buffer_status(snapshot, "can0", Time()))
    joints, position = [a.joint for a in axes], [a.position for a in axes]
    states = JointStates(0.0, joints, position, [a.velocity for a in axes], position)
    seen.on_joint_states(messages.joint_state(states, Time()))


def shown(seen: Seen, now_s: float = 0.0, width: int = 80, height: int = 24, first: int = 0) -> str:
    from rich.console import Console

    from epos2_ros.monitor import view

    console = Console(file=StringIO(), width=width, height=height, force_terminal=False)
    console.print(view.draw(seen, now_s, width, height, first), end="")
    return str(console.file.getvalue())  # type: ignore[attr-defined]


def test_eighty_columns_show_every_axis_and_the_bus() -> None:
    seen = Seen(Names())
    hear(
        seen,
        axis_of("shoulder_lift_joint", position=-1.23456, velocity=0.5),
        axis_of("wrist", state="fault", fault="over-current (0x2310)", size=0),
        outputs=(OutputSnapshot("camera", "wrist", 1, Tally(42)),),
    )
    lines = shown(seen).splitlines()
    assert lines[0].split("   ") == [
        "/epos2_driver", "moving", "bus 8.1 %, error active", "simulated drives", "camera 42",
    ]  # fmt: skip
    assert lines[1] == "wrist: over-current (0x2310)"
    lift, wrist = (line.split() for line in lines[3:5])
    assert lift[:5] == ["shoulder_lift_joint", "enabled", "-1.2346", "+0.5000", "-12"]
    assert lift[5].strip("█") == "" and lift[6:] == ["900", "+3"]
    assert wrist[:2] == ["wrist", "fault"] and "none" in wrist  # it has no buffer


def test_why_all_axes_have_stopped_comes_before_how_they_are() -> None:
    seen = Seen(Names())
    hear(seen, axis_of("a", silent_s=3.0), state="fault", reason="can0 can't send: no such device")
    assert shown(seen).splitlines()[1] == "can0 can't send: no such device"


def test_a_wide_terminal_has_whole_names_and_last_events() -> None:
    seen = Seen(Names("/robot1/epos2_driver"))
    hear(seen, axis_of("a", silent_s=7.0), axis_of("b"))
    line = Log(name="robot1.epos2_driver", level=20, msg="b: homed by here")
    seen.on_log(line)
    seen.on_log(Log(name="somebody_else", level=20, msg="a: not of the driver"))
    rows = shown(seen, width=130).splitlines()[3:5]
    assert "unknown" in rows[0] and "not heard any more; it was: operation" in rows[0]
    assert "operation enabled" in rows[1] and "7/64" in rows[1] and "homed by here" in rows[1]
    seen.on_output("camera", JointState(name=["b"], position=[0.25], velocity=[0.0]))
    assert "camera fired at +0.2500" in shown(seen, width=130)
    assert "somebody" not in shown(seen) and "not of the driver" not in shown(seen)


def test_a_buffer_that_runs_dry_is_seen_to() -> None:
    seen = Seen(Names())
    hear(seen, axis_of("a", buffered_ms=1000.0), axis_of("b", buffered_ms=1000.0))
    full = shown(seen).count("█")
    hear(seen, axis_of("a", buffered_ms=500.0), axis_of("b", buffered_ms=0.0))
    assert 0.2 * full < shown(seen).count("█") < 0.3 * full


def test_a_driver_that_is_gone_does_not_look_like_one_that_stands() -> None:
    seen = Seen(Names())
    assert "no /diagnostics: the driver is gone" in shown(seen)
    hear(seen, axis_of("a"), now_s=100.0)
    assert "gone" not in shown(seen, now_s=102.0)
    assert "no /diagnostics for 9 s: the driver is gone" in shown(seen, now_s=109.0)
    other = DiagnosticStatus(name="other_node: a", values=[KeyValue(key="state", value="fine")])
    seen.on_diagnostics(DiagnosticArray(status=[other]), 109.0)
    assert "gone" in shown(seen, now_s=109.0)


@settings(max_examples=25, deadline=None)
@given(
    joints=st.lists(st.text(min_size=1, max_size=30), max_size=70, unique=True),
    width=st.integers(40, 200),
    height=st.integers(10, 60),
    first=st.integers(0, 70),
    text=st.text(max_size=200),
    value=st.floats() | st.sampled_from([1e9, -1e9]),
)
def test_it_fits_whatever_there_is_and_leaves_the_terminal_alone(
    joints: list[str], width: int, height: int, first: int, text: str, value: float
) -> None:
    seen = Seen(Names())
    hear(seen, *(axis_of(joint, position=value, velocity=value, fault=text) for joint in joints))
    seen.on_log(Log(name="epos2_driver", level=40, msg=text))
    lines = shown(seen, width=width, height=height, first=first).split("\n")
    assert len([line for line in lines if line]) <= height
    assert all(c.isprintable() for line in lines for c in line)
    assert "[space] quick stop"[: width - 12] in lines[min(height, len(lines)) - 1]


def test_the_keys_are_always_on_the_screen() -> None:
    seen = Seen(Names())
    hear(seen, *(axis_of(f"joint_{n}") for n in range(64)))
    lines = shown(seen, height=24, first=10).splitlines()
    assert len(lines) == 24 and lines[-1].startswith("[h] halt   [space] quick stop")
    assert [line.split()[0] for line in lines[3:19]] == [f"joint_{n}" for n in range(10, 26)]


@pytest.mark.parametrize("text", ["", "many", "nan", "1e999"])
def test_what_makes_no_sense_is_dropped_and_counted(text: str) -> None:
    seen = Seen(Names())
    hear(seen, axis_of("a"))
    before = seen.axes["a"].used
    status = DiagnosticStatus(name="a", values=[KeyValue(key="used", value=text)])
    seen.on_buffer_status(DiagnosticArray(status=[status]))
    seen.on_joint_states(JointState(name=["a", "b"], position=[1.0], velocity=[1.0]))
    assert (seen.axes["a"].used, seen.axes["a"].position, seen.dropped) == (before, 0.0, 2)
    assert "2 messages made no sense" in shown(seen)


def test_keys() -> None:
    assert keys_in("h q\x1b[A\x1b[B\x1b[5~\x1bOB\x1b[1;5C\x1b") == [
        "h", " ", "q", "up", "down", "page up", "down",
    ]  # fmt: skip


def until(true: Callable[[], Any]) -> None:
    end_s = time.monotonic() + WAIT_S
    while not true():
        assert time.monotonic() < end_s
        time.sleep(0.01)


@pytest.mark.realtime
def test_a_key_stops_at_once_and_the_answer_is_told(ros_domain_id: int) -> None:
    asked: list[str] = []
    context = Context()
    context.init(args=[], domain_id=ros_domain_id)
    driver = Node("epos2_driver", namespace="robot1", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(driver)

    def answer(name: str, success: bool, text: str) -> Callable[[Any, Any], Any]:
        def answered(_: Any, response: Any) -> Any:
            asked.append(name)
            response.success, response.message = success, text
            return response

        return answered

    args = ["--ros-args", "-r", "__ns:=/robot1"]
    with Listener("epos2_driver", args, ros_domain_id) as listener:
        listener.stop("halt")
        assert listener.seen.events[-1].text == (
            "halt NOT SENT: nobody offers /robot1/epos2_driver/halt"
        )
        driver.create_service(Trigger, "~/halt", answer("halt", True, "halted"))
        driver.create_service(Trigger, "~/quick_stop", answer("quick_stop", False, "a: is silent"))

        def told(text: str) -> bool:
            executor.spin_once(0.02)
            listener.take()
            return listener.seen.events[-1].text == text

        answers = {"halt": "halt: halted", "quick_stop": "quick stop failed: a: is silent"}
        for stop, text in answers.items():
            until(lambda stop=stop: listener._clients[stop].service_is_ready())
            listener.stop(stop)
            listener.stop(stop)  # the key is held
            until(lambda text=text: told(text))
    assert asked == ["halt", "quick_stop"]
    executor.shutdown()
    driver.destroy_node()
    context.shutdown()


@pytest.mark.realtime
def test_on_a_terminal_it_draws_and_q_leaves_it_as_it_was(ros_env: dict[str, str]) -> None:
    terminal, slave = pty.openpty()
    fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
    before = termios.tcgetattr(slave)
    process = subprocess.Popen(
        [sys.executable, "-m", "epos2_ros", "monitor"],
        env={**ros_env, "TERM": "xterm-256color"},
        stdin=slave,
        stdout=slave,
        stderr=slave,
    )
    drawn = b""
    try:
        while b"halt" not in drawn:
            assert select.select([terminal], [], [], WAIT_S)[0], drawn
            drawn += os.read(terminal, 65536)
        os.write(terminal, b"q")
        assert process.wait(WAIT_S) == 0
    finally:
        process.kill()
    assert termios.tcgetattr(slave) == before
    os.close(slave)
    os.close(terminal)


def test_without_a_terminal_or_rich_there_is_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(isatty=lambda: False))
    assert main([]) == 2
    assert capsys.readouterr().err == (
        "epos2_ros monitor: needs a terminal; for anything else there are the driver's topics\n"
    )
    for name in [name for name in sys.modules if name.split(".")[0] == "rich"]:
        monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.delitem(sys.modules, "epos2_ros.monitor.view")
    monkeypatch.delattr("epos2_ros.monitor.view")
    assert main([]) == 2
    assert capsys.readouterr().err == (
        "epos2_ros monitor: needs Rich: sudo apt install python3-rich, or pip install rich\n"
    )
