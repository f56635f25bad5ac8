"""Joint states against where the motors of the simulated drives really were, in simulated time."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from simulated_time import Bench, axes
from six_axes import there_and_back

from benchmarks.joint_states import bench, compare, stand
from epos2_ros.configuration.driver import DriverConfig
from epos2_ros.errors import MotionAborted
from epos2_ros.protocol.whereabouts import Whereabouts
from epos2_ros.sim.epos2 import Epos2

MOTION = there_and_back(4.0, 0.6, joints=3)


@pytest.mark.parametrize("rate_hz", [10.0, 50.0, 500.0])
def test_every_state_is_of_its_own_stamp(rate_hz):
    """99 % within a count and 2 % of the following error; at 1 rad/s a count takes 31 µs."""
    seen = compare(MOTION, rate_hz)
    assert np.abs(seen.error).max() < 2.0
    assert seen.within >= 0.99
    assert np.abs(seen.velocity_error).max() < 100.0  # one step of 0x606C is 1000 qc/s


def test_how_late_an_axis_follows_is_found_out():
    """A lag of 5 ms is 160 qc at 1 rad/s; it is not known before the first report in motion."""
    seen = compare(MOTION, 50.0, lag_ms=5.0)
    learned = seen.error[15:]
    assert (np.abs(learned) <= seen.allowed[15:]).mean() >= 0.99


def test_states_of_a_standing_axis_go_on():
    count, least_us = stand(30 / 3600, 50.0)
    assert count >= 30 * 50 - 1
    assert least_us == pytest.approx(20e3)


@pytest.fixture
def made() -> Bench:
    return bench(DriverConfig(axes=axes(3), state_rate=50.0), 3, 0.4)


def states(made: Bench, whereabouts: Whereabouts, seconds: float) -> list[list[tuple]]:
    seen = []
    for _ in range(round(seconds * 50)):
        made.run(0.02)
        seen.append(whereabouts.at(made.now_us))
    return seen


def off_qc(made: Bench, state: list[tuple]) -> float:
    """How far the farthest axis is from where its state has it."""
    motors = [made.drives[axis.place]._motor.position for axis in state]
    return max(abs(axis.position_qc - at) for axis, at in zip(state, motors, strict=True))


def fault(made: Bench) -> None:
    made.drives[1].fail(0x2310, made.now_us)


STOPS = {
    "halt": lambda made: made.group.halt(),
    "quick stop": lambda made: made.group.quick_stop(),
    "stop on the path": lambda made: made.path.stop(),
    "a drive's fault": fault,
    "an emergency of ours": lambda made: made.group.fail("a test"),
}


@pytest.mark.parametrize("stop", STOPS.values(), ids=STOPS)
def test_states_go_on_through_every_stop_and_after_it(made, stop):
    whereabouts = Whereabouts(made.machine)
    made.path.submit(MOTION, None, made.now_us)
    motion = made.group.motion
    states(made, whereabouts, 1.0)
    stop(made)
    seen, off = [], []
    for _ in range(100):
        seen += states(made, whereabouts, 0.02)
        off.append(off_qc(made, seen[-1]))
    assert max(off) <= 60.0  # 2 ms at the speed at which they were; SYNCs are 10 ms apart
    assert all(len(state) == 3 for state in seen)
    jumps = np.diff([[axis.position_qc for axis in state] for state in seen], axis=0)
    assert np.abs(jumps).max() < 1.2 * np.abs(jumps[0]).max()  # it only gets slower
    assert off_qc(made, seen[-1]) <= 1.0
    assert all(axis.velocity_qc_s == 0 for axis in seen[-1])
    assert motion.done()
    assert motion.exception() is None or isinstance(motion.exception(), MotionAborted)


@pytest.mark.parametrize(
    ("bitrate", "least_s", "most_s"), [(1_000_000, 0.01, 0.012), (50_000, 0.03, 0.06)]
)
def test_syncs_come_often_while_axes_brake_as_far_as_the_bus_takes_it(bitrate, least_s, most_s):
    """Every 10 ms; the answers of three drives, of 135 bits at most, take a third of the bus."""
    config = DriverConfig(axes=axes(3, stop_deceleration=0.5), bitrate=bitrate)
    made = Bench(config, [Epos2(n, bitrate=bitrate) for n in (1, 2, 3)])
    made.enable()
    made.path.submit(MOTION, None, made.now_us)
    made.run(1.0)
    halted = made.group.halt()
    made.run(0.1)
    made.frames.clear()
    made.run(0.2)
    assert not halted.done()
    syncs = [t for t, f, _ in made.frames if f.can_id == 0x080]
    apart_s = np.diff(syncs) / 1e6
    assert least_s * 0.99 <= apart_s.min()
    assert apart_s.max() <= most_s
    made.wait(halted)
    made.frames.clear()
    made.run(1.0)
    assert sum(f.can_id == 0x080 for _, f, _ in made.frames) == 10


def test_a_blocked_axis_is_where_it_is(made):
    whereabouts = Whereabouts(made.machine)
    made.path.submit(MOTION, None, made.now_us)
    states(made, whereabouts, 0.8)
    made.drives[0].block_rotor()
    states(made, whereabouts, 0.1)
    seen = states(made, whereabouts, 1.0)
    assert off_qc(made, seen[-1]) <= 1.0


@pytest.mark.parametrize("stale", [True, False])
def test_an_axis_that_is_off_and_turned_by_hand_is_where_it_is(made, stale):
    """No document says what demand and following error of a drive are that is off; here they are as
    they were when it was switched off, or go on."""
    whereabouts, drive = Whereabouts(made.machine), made.drives[1]
    made.path.submit(MOTION, None, made.now_us)
    made.wait(made.group.motion)
    made.wait(made.group.disable())
    entries = [drive.dictionary[index, 0] for index in (0x6062, 0x20F4)]
    live = [entry.read for entry in entries]
    for entry, value in [(entry, entry.get()) for entry in entries] if stale else ():
        entry.read = partial(int, value)
    for _ in range(150):  # a turn of the motor in three seconds
        assert drive.push(2000 / 150)
        (state,) = states(made, whereabouts, 0.02)
        assert off_qc(made, state) <= 2000 / 3 * 0.55  # half a second of it
    states(made, whereabouts, 1.2)
    (state,) = states(made, whereabouts, 0.02)
    assert off_qc(made, state) <= 1.0
    assert state[1].velocity_qc_s == 0.0
    for entry, read in zip(entries, live, strict=True):
        entry.read = read
    made.enable()
    assert made.machine.drives[1].standing_qc == drive._motor.measured


def test_a_drive_that_is_not_heard_has_no_state(made):
    whereabouts = Whereabouts(made.machine)
    states(made, whereabouts, 0.1)
    made.drives[1].disconnect()
    seen = states(made, whereabouts, 1.0)
    assert [axis.place for axis in seen[-1]] == [0, 2]
    assert len(seen[int(0.55 * 50)]) == 2


def test_nothing_is_told_before_all_axes_are_known():
    made = Bench(DriverConfig(axes=axes(3)), bring_up=False)
    whereabouts = Whereabouts(made.machine)
    made.bring_up_drive(0)
    assert not whereabouts.at(made.now_us)
