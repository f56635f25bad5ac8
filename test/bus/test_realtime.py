"""Real time: who gets it, who does not, what is said without; how late a thread woke."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from two_processes import SCAN, Rig

from epos2_ros.bus import realtime
from epos2_ros.bus.lateness import Lateness
from epos2_ros.bus.reactor import Reactor
from epos2_ros.bus.simulation import Simulation
from epos2_ros.bus.timestamps import now_us
from epos2_ros.configuration.driver import AxisConfig, DriverConfig

PRIORITY = 3
NOBODY = 65534
SOON_S = 5.0


def allowed() -> bool:
    """Whether a thread of this process may have SCHED_FIFO; asked in one that ends."""
    answer: list[bool] = []

    def ask() -> None:
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
        except PermissionError:
            answer.append(False)
        else:
            answer.append(True)

    thread = threading.Thread(target=ask)
    thread.start()
    thread.join()
    return answer[0]


needs_permission = pytest.mark.skipif(not allowed(), reason="SCHED_FIFO is not allowed here")


# -- how late a thread woke -------------------------------------------------------------------


@given(st.lists(st.floats(0.0, 4e9), min_size=1, max_size=300))
def test_figures_are_those_of_all_times_and_an_eighth_too_large_at_most(late_us: list[float]):
    lateness = Lateness()
    for late in late_us:
        lateness.add(late)
    figures = lateness.figures()
    assert figures is not None
    true = np.quantile(late_us, [0.5, 0.99], method="inverted_cdf")
    for figure, exact in zip((figures.median_us, figures.most_us), true, strict=True):
        assert exact <= figure <= exact * 9 / 8 + 1
    assert (figures.worst_us, figures.times) == (max(late_us), len(late_us))


def test_a_day_of_waking_takes_no_more_memory_than_an_hour():
    lateness = Lateness()
    before = sys.getsizeof(lateness._counts)
    for late in range(100_000):
        lateness.add(late * 1e5)  # up to hours, more than which is not told apart
    assert sys.getsizeof(lateness._counts) == before
    assert lateness.figures().worst_us == 99_999 * 1e5  # type: ignore[union-attr]


def test_a_job_at_which_the_thread_is_when_something_falls_due_makes_it_late():
    steps: list[float] = []

    def step() -> float:
        steps.append(now_us())
        return now_us() + 20_000.0

    assert Lateness().figures() is None
    reactor = Reactor(step, pytest.fail)
    reactor.start()
    try:
        reactor.call(lambda: time.sleep(0.1))
        wait(lambda: len(steps) > 5)
        figures = reactor.call(reactor.lateness.figures)
    finally:
        reactor.stop()
    assert figures is not None
    assert figures.worst_us > 70_000  # 100 ms, less the 20 it had time for
    assert figures.median_us < figures.worst_us


# -- where it is allowed ----------------------------------------------------------------------


def wait(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + SOON_S
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def policy(thread_id: int) -> int:
    return os.sched_getscheduler(thread_id) & ~os.SCHED_RESET_ON_FORK


@pytest.fixture
def virtual(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[], Rig]]:
    """A driver that takes its two drives for real ones, in a process whose memory stays free."""
    monkeypatch.setattr(realtime, "lock_memory", lambda: "")
    channel = f"real time {time.monotonic_ns()}"
    axes = tuple(AxisConfig(joint, node) for node, joint in enumerate(SCAN.joint_names, start=1))
    drives = Simulation(DriverConfig(axes=axes, channel=channel))
    made: list[Rig] = []

    def make() -> Rig:
        made.append(Rig("virtual", channel, realtime_priority=PRIORITY))
        made[0].driver.configure()
        return made[0]

    yield make
    for rig in made:
        rig.driver.close()
    drives.close()


@needs_permission
def test_only_the_threads_that_feed_and_receive_are_ahead_of_others(virtual: Callable[[], Rig]):
    made = virtual()
    made.driver.enable()
    threads = {t.name: policy(t.native_id) for t in threading.enumerate() if t.native_id}
    ahead = {name for name, its in threads.items() if its == os.SCHED_FIFO}
    assert ahead == {"reactor", "CAN receiver"}
    assert any(name.startswith("events") for name in threads)  # which the reactor has started
    snapshot = made.snapshot()
    assert (snapshot.scheduling, snapshot.memory_locked) == (f"SCHED_FIFO {PRIORITY}", True)
    assert not [event for event in made.events if event.kind == "warning"]


@needs_permission
def test_a_thread_that_never_waits_does_not_stay_ahead_of_others():
    spinning = threading.Event()
    spinning.set()

    def step() -> float:
        return -np.inf if spinning.is_set() else now_us() + 1000.0

    reactor = Reactor(step, pytest.fail, PRIORITY)
    reactor.start()
    try:
        thread_id = reactor.call(threading.get_native_id)
        wait(lambda: policy(thread_id) == os.SCHED_OTHER)
        spinning.clear()
        wait(lambda: policy(thread_id) == os.SCHED_FIFO)
    finally:
        reactor.stop()


# -- where it is not --------------------------------------------------------------------------


def test_what_is_not_allowed_is_said_in_one_line(
    virtual: Callable[[], Rig], monkeypatch: pytest.MonkeyPatch
):
    def refuse(*arguments: object) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    monkeypatch.setattr(realtime, "lock_memory", lambda: "memory is short")
    made = virtual()
    made.driver.enable()
    (line,) = (event.text for event in made.events if event.kind == "warning")
    assert line.startswith("no real time: SCHED_FIFO is ")
    assert "memory is short" in line
    assert "'@realtime - rtprio 99'" in line
    assert "'@realtime - memlock unlimited'" in line
    assert "\n" not in line
    assert (made.snapshot().scheduling, made.snapshot().memory_locked) == ("SCHED_OTHER", False)


LIMITED = """
import os, resource, sys
from epos2_ros.bus.realtime import Scheduling, lock_memory
rtprio, memlock, user = map(int, sys.argv[1:])
resource.setrlimit(resource.RLIMIT_RTPRIO, (rtprio, rtprio))
resource.setrlimit(resource.RLIMIT_MEMLOCK, (memlock, memlock))
if os.geteuid() == 0:  # what root may is lost with it
    os.setresuid(user, user, user)
scheduling = Scheduling(50)
scheduling.begin()
print(scheduling, scheduling.refusal, sep="|")
print(lock_memory())
bytearray(50_000_000)  # is there all the same
print(*(line.split()[1] for line in open("/proc/self/status") if line.startswith("VmLck")))
"""


def limited(rtprio: int, memlock: int, user: int = NOBODY) -> list[str]:
    """What a process with these limits is told: SCHED_FIFO, memory, kB locked."""
    arguments = [sys.executable, "-c", LIMITED, *map(str, (rtprio, memlock, user))]
    root = Path(__file__).parents[2]
    return subprocess.check_output(arguments, text=True, cwd=root).splitlines()


def test_limits_are_named_and_memory_is_not_locked_up_to_one():
    assert limited(0, 8 << 20) == [
        "SCHED_OTHER|SCHED_FIFO is allowed up to priority 0, not 50",
        "memory may be locked up to 8192 kB, not unlimited",
        "0",
    ]


@needs_permission
@pytest.mark.skipif(not realtime._has(realtime._CAP_IPC_LOCK), reason="needs CAP_IPC_LOCK")
def test_who_may_in_any_case_is_not_held_to_the_limits():
    scheduling, memory, locked_kb = limited(0, 8 << 20, os.geteuid())
    assert (scheduling, memory) == ("SCHED_FIFO 50|", "")
    assert int(locked_kb) > 8192
