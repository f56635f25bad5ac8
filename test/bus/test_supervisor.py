"""A mistake in any thread: said with its place, the axes stop, and `reset_fault` gets back."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator

import can
import numpy as np
import pytest
from two_processes import SCAN, Rig, rig

from epos2_ros.bus import driver as bus_driver
from epos2_ros.bus import reactor
from epos2_ros.bus.link import Link
from epos2_ros.bus.outputs.predictor import Predictor
from epos2_ros.errors import BusError, DriveError
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.protocol.group import Group
from epos2_ros.protocol.outbox import Event
from epos2_ros.protocol.phase import Phase
from epos2_ros.protocol.timekeeper import Timekeeper

Break = Callable[[Rig], None]


class Mistake(Exception):
    """What nobody expects."""


@pytest.fixture
def made() -> Iterator[Rig]:
    with rig("virtual", f"supervisor {time.monotonic_ns()}", simulate=True) as made:
        made.driver.submit(Trajectory(SCAN.joint_names, np.array([4.0]), np.array([[0.2, -0.1]])))
        made.wait(lambda snapshot: snapshot.state == "moving")
        yield made


def raises_once(monkeypatch: pytest.MonkeyPatch, owner: object, name: str) -> threading.Event:
    """The next call of a method raises `Mistake`."""
    original, raised = getattr(owner, name), threading.Event()

    def method(*arguments: object, **named: object) -> object:
        if not raised.is_set():
            raised.set()
            raise Mistake(name)
        return original(*arguments, **named)

    monkeypatch.setattr(owner, name, method)
    return raised


def assert_stopped_and_said(made: Rig, where: str) -> None:
    made.wait(lambda snapshot: snapshot.state == "fault")
    snapshot = made.wait(lambda s: all(abs(axis.velocity) < 1e-6 for axis in s.axes))
    assert f"internal error in {where}: Mistake: " in snapshot.reason
    assert "test_supervisor.py:" in snapshot.reason
    assert snapshot.internal_errors >= 1
    made.wait(lambda snapshot: made.driver._machine.group.phase is Phase.FAULT)  # no longer halting
    with pytest.raises(DriveError, match="reset the fault first"):
        made.driver.enable()


def assert_comes_back(made: Rig) -> None:
    made.driver.reset_fault()
    made.driver.enable()
    assert made.snapshot().state == "standing"


@pytest.mark.parametrize(
    ("owner", "name"),
    [(Group, "advance"), (Group, "receive"), (Timekeeper, "on_answer"), (Link, "_on_message")],
)
def test_the_drivers_thread(
    made: Rig, owner: type, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    raises_once(monkeypatch, owner, name)
    assert_stopped_and_said(made, "the driver's thread")
    assert_comes_back(made)


def test_sdo(made: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    raised = raises_once(monkeypatch, bus_driver, "perform")
    with pytest.raises(DriveError):
        made.driver.halt()  # clears the buffers at its end
    assert raised.is_set()
    assert_stopped_and_said(made, "SDO")
    assert_comes_back(made)


def test_predicting(made: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    raises_once(monkeypatch, Predictor, "_extend")
    with pytest.raises(DriveError, match="Mistake"):
        made.driver.stop_on_path()  # which is a path of its own
    assert_stopped_and_said(made, "predicting outputs")
    assert_comes_back(made)


def test_whoever_listens_to_events(made: Rig) -> None:
    def fails(event: Event) -> None:
        raise Mistake(event.text)

    made.driver._announce(fails, Event("warning", "unheard"))
    assert_stopped_and_said(made, "announcing")
    assert_comes_back(made)


def test_a_callback_of_the_node(made: Rig) -> None:
    try:
        raise Mistake("in a callback")
    except Mistake as error:
        made.driver.broke("a callback", error)
    assert_stopped_and_said(made, "a callback")
    assert_comes_back(made)


def test_the_receiving_thread_reads_on_or_the_bus_has_failed(
    made: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    link = made.driver._link
    assert link is not None
    receive, left = link._bus.recv, [3]

    def recv(timeout: float | None) -> object:
        if left[0]:
            left[0] -= 1
            raise Mistake("what is this?")
        return receive(timeout)

    monkeypatch.setattr(link._bus, "recv", recv)
    snapshot = made.wait(lambda snapshot: snapshot.rejected.get("unreadable input") == 3)
    assert snapshot.state == "moving"
    left[0] = 1_000_000
    snapshot = made.wait(lambda snapshot: snapshot.state == "fault")
    assert "can't receive: what is this?" in snapshot.reason
    assert_comes_back(made)  # on a new bus
    made.go_to((0.01, 0.01))


def test_when_not_even_stopping_works_the_drives_stop_by_themselves(
    made: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(group: Group, reason: str) -> None:
        raise Mistake(reason)

    monkeypatch.setattr(Group, "fail", fails)
    made.driver.broke("the test", Mistake("the first one"))
    snapshot = made.wait(lambda snapshot: snapshot.state == "fault")
    assert "the first one" in snapshot.reason
    assert made.driver._simulation is not None
    drives = made.driver._simulation._drives
    end_s = time.monotonic() + 10
    while any(drive.status_word & 0x4F != 0x08 for drive in drives):  # fault
        assert time.monotonic() < end_s
        time.sleep(0.05)
    monkeypatch.undo()
    assert_comes_back(made)


def test_a_call_that_the_drivers_thread_does_not_get_to_says_so(
    made: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reactor, "CALL_TIMEOUT_S", 0.1)
    go_on = threading.Event()
    made.driver._reactor.post(lambda: go_on.wait(5.0) and None)
    with pytest.raises(BusError, match=r"busy for 0\.1 s"):
        made.driver.snapshot()
    go_on.set()


def test_what_waits_is_bounded_and_too_much_of_it_a_failure_of_the_bus(
    made: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """While the driver's thread gets to nothing, somebody floods the bus."""
    monkeypatch.setattr(reactor, "MOST_WAITING", 100)
    go_on, link = threading.Event(), made.driver._link
    assert link is not None
    made.driver._reactor.post(lambda: go_on.wait(5.0) and None)
    with can.Bus(link.name.removeprefix("virtual:"), "virtual") as stranger:
        for number in range(300):
            stranger.send(can.Message(arbitration_id=0x7E0, data=bytes([number & 0xFF])))
    time.sleep(0.3)
    assert made.driver._reactor._inbox.qsize() < 110
    go_on.set()
    snapshot = made.wait(lambda snapshot: snapshot.state == "fault")
    assert "brings more than this computer gets to" in snapshot.reason
    assert_comes_back(made)
