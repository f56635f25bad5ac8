"""The clocks of host and drives: what the drives' clocks really show, in simulated time.

A simulated drive's clock is offset + rate · true time, so how far apart they are is known exactly.
The rules are those of maxon's application note "Interpolation Position Mode", 2.4 and 3.6.2.
"""

from __future__ import annotations

import math
import random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from simulated_time import Bench, axes

from benchmarks.time_sync import bench, drives, watch, watch_motion
from epos2_ros.configuration.driver import DriverConfig
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.protocol.clock import MasterClock, time_of_day
from epos2_ros.protocol.phase import Phase
from epos2_ros.sim.epos2 import Dictionary, Epos2

WRAP = 1 << 32
SYNC, STAMP = 0x080, 0x400
NODES = range(1, 7)


def clocks(made: Bench) -> np.ndarray:
    return np.array([drive.clock.value(made.now_us) for drive in made.drives])


def run_to_sync(made: Bench) -> None:
    count = made.group.time.sync_count
    made.run(1.0, lambda: made.group.time.sync_count > count)


# ---------------------------------------------------------------------------- together


@pytest.mark.parametrize(
    ("jitter_us", "noise_us", "limit_us"),
    [(0.0, 0.0, 12), (100.0, 20.0, 10.5), (1000.0, 20.0, 10.5), (1000.0, 200.0, 200)],
)
def test_clocks_stay_together_whatever_the_hosts_time_is_worth(jitter_us, noise_us, limit_us):
    """Drives from −100 to +100 ppm; two of them part by 20 µs in a SYNC period of 0.1 s. (SYNCs
    that are exactly so far apart are the worst: what whole microseconds hide is always the same.)
    """
    seen = watch(bench(jitter_us, noise_us, 6, 0.1), 10.0)
    assert seen.worst <= limit_us
    assert np.median(seen.spread) <= 5


def test_paths_stay_together_and_start_as_one():
    seen = watch_motion(bench(100.0, 20.0, 6, 0.1, record=True), 6.0)
    assert seen.spread[0] == 0
    assert seen.worst <= 10


def test_a_shorter_period_brings_them_closer():
    worst = [watch(bench(0.0, 0.0, 6, period_s), 3.0).worst for period_s in (0.2, 0.1, 0.05)]
    assert worst[0] > 1.5 * worst[1] > 2.25 * worst[2]


def test_wrap_around_goes_unnoticed(monkeypatch: pytest.MonkeyPatch):
    """0x1013 wraps every 71.6 minutes: here 3 s after TIME, on the host and on the drives."""
    ahead_us = WRAP - 3e6

    class Drive(Epos2):
        def _on_time(self) -> None:
            super()._on_time()
            self.clock._offset_us += ahead_us

    reset = MasterClock.reset
    monkeypatch.setattr(MasterClock, "reset", lambda self, t_us: reset(self, t_us - ahead_us))
    made = Bench(drives=[Drive(n, drift_ppm=40.0 * (n - 3), record=True) for n in NODES])
    made.enable()
    seen = watch_motion(made, 4.0)
    assert min(drive.clock.value(made.now_us) for drive in made.drives) > WRAP
    assert max(drive.clock.latched for drive in made.drives) < 10e6
    assert seen.worst <= 10.5  # 200 ppm in half a period, and a stamp waits for the bus


def test_one_late_time_stamp_moves_no_drive():
    def run(late_us: float) -> np.ndarray:
        rng = random.Random(1)
        made = Bench(drives=drives(6, record=False))
        made.enable()
        made.stamp_us = lambda t_us: t_us + rng.gauss(0.0, 20.0)
        made.run(3.0)
        run_to_sync(made)
        at_us = made.now_us + 50_000  # before the next SYNC, which is seen late
        made.run(0.05)
        made.stamp_us = lambda t_us: (
            t_us + rng.gauss(0.0, 20.0) + (late_us if t_us < at_us + 60_000 else 0.0)
        )
        made.run(0.3)
        assert any(f.can_id == SYNC and at_us < t < at_us + 60_000 for t, f, _ in made.frames)
        return clocks(made)

    moved_us = run(20_000.0) - run(0.0)
    assert np.abs(moved_us).max() <= 2.0


def test_a_clock_far_off_is_a_fault_and_is_set_anew():
    """Half a SYNC period off, an answer can't be taken for one to this SYNC. (A clock that takes
    time stamps is right again with the next.)"""
    made = Bench(drives=drives(6, record=False))
    made.enable()
    made.run(2.0)
    made.drives[3].clock._offset_us += 80_000
    made.drives[3].clock.correct = lambda timestamp: 0.0
    made.run(1.7)  # until it is asked, and half a second
    assert made.group.phase is Phase.FAULT
    assert made.group.reason == "joint_4 (node 4): its clock is off by +80.0 ms"
    assert made.lost() == [3]
    del made.drives[3].clock.correct
    made.bring_up()
    made.wait(made.group.reset_fault())
    made.enable()
    made.run(2.0)
    assert np.ptp(clocks(made)) <= 10


# ---------------------------------------------------------------------------- frame by frame


@pytest.mark.parametrize(
    ("count", "bitrate", "every"), [(1, 1_000_000, 1), (6, 1_000_000, 1), (2, 20_000, 3)]
)
def test_one_stamp_for_each_drive_between_a_sync_and_the_next(count, bitrate, every):
    """At every SYNC, or where to read a clock (250 bits) would be more than a twentieth of the bus
    at every third."""
    config = DriverConfig(axes=axes(count), bitrate=bitrate)
    group = [Epos2(n, drift_ppm=60.0 * (-1) ** n, bitrate=bitrate) for n in range(1, count + 1)]
    made = Bench(config, group)
    made.enable()
    made.run(1.0)
    run_to_sync(made)
    made.frames.clear()
    made.run(2.0)
    run_to_sync(made)
    periods: list[list[int]] = [[]]
    for _, frame, _ in made.frames:
        if frame.can_id == SYNC:
            periods.append([])
        elif frame.can_id & 0x780 == STAMP:
            periods[-1].append(frame.can_id - STAMP)
    assert len(periods) > 20
    with_stamps = [n for n, stamped in enumerate(periods[:-1]) if stamped]
    for number in with_stamps:
        assert sorted(periods[number]) == list(range(1, count + 1))
    assert set(np.diff(with_stamps)) == {every}


def test_clocks_are_read_in_turn_and_all_where_a_motion_begins():
    """One at each SYNC, now and then two; each within a second."""
    made = Bench(drives=drives(6, record=False))
    made.enable()
    made.run(8.0)
    made.frames.clear()
    made.run(10.0)
    told = {n: [t for t, f, _ in made.frames if f.can_id == 0x580 + n] for n in NODES}
    syncs = sum(frame.can_id == SYNC for _, frame, _ in made.frames)
    assert syncs <= sum(map(len, told.values())) <= 1.2 * syncs
    assert max(max(np.diff(times)) for times in told.values()) < 1e6
    made.frames.clear()
    move = Trajectory(tuple(a.joint for a in made.config.axes), np.array([0.3]), np.ones((1, 6)))
    made.path.submit(move, None, made.now_us)
    run_to_sync(made)
    made.run(0.03)
    assert made.group.phase in (Phase.STARTING, Phase.MOVING)
    request = bytes.fromhex("4013100000000000")
    read = {f.can_id - 0x600 for _, f, _ in made.frames if f.data == request}
    assert read == set(NODES)


def test_a_drive_that_loses_little_is_corrected_less_often():
    group = [Epos2(n, drift_ppm=ppm) for n, ppm in enumerate((100, 15, 1), 1)]
    made = Bench(DriverConfig(axes=axes(3)), group)
    made.enable()
    made.run(8.0)
    made.frames.clear()
    made.run(10.0)
    stamps = [sum(f.can_id == STAMP + n for _, f, _ in made.frames) for n in (1, 2, 3)]
    assert stamps[0] >= 99
    assert 30 <= stamps[1] <= 60
    assert stamps[2] <= 20
    assert np.ptp(clocks(made)) <= 10


@pytest.mark.parametrize("jump_us", [60.0, 3_000.0])
def test_a_clock_that_jumps_takes_no_other_along(jump_us):
    """It tells when a SYNC was, in its turn; what it says is compared with the host and others."""
    made = Bench(drives=drives(6, record=False))
    made.enable()
    made.run(8.0)
    before_us = np.delete(clocks(made), 2) - made.now_us
    made.drives[2].clock._offset_us += jump_us
    most_us = 0.0
    for _ in range(200):
        made.run(0.01)
        moved = np.delete(clocks(made), 2) - made.now_us - before_us
        most_us = max(most_us, np.abs(moved).max())
    assert most_us <= 25 if jump_us > 200 else most_us <= jump_us + 25
    assert np.ptp(clocks(made)) <= 12


@pytest.mark.parametrize("producer", ["host", "joint_2"])
@pytest.mark.parametrize("count", [2, 3])
@pytest.mark.parametrize("after", [1, 2, 3, 5, 9])
def test_a_clock_that_jumps_while_the_others_are_not_known_yet(after, count, producer):
    """The clocks go on as fast as time does, and apart by what it was at most."""
    config = DriverConfig(axes=axes(count), sync_producer=producer)
    made = Bench(
        config,
        [
            Epos2(n, offset_us=3e5 * n, drift_ppm=150.0 * (-1) ** n, dictionary=Dictionary.NOTE)
            for n in range(1, count + 1)
        ],
    )
    for _ in range(after):
        run_to_sync(made)
    made.run(0.03)
    made.drives[0].clock._offset_us += 12e3
    made.run(2.5)
    before, begun_us = clocks(made), made.now_us
    made.run(2.0)
    passed_us = made.now_us - begun_us
    assert clocks(made) - before == pytest.approx(np.full(count, passed_us), rel=5e-4)
    assert np.ptp(clocks(made)) < 100


def test_a_stamp_tells_when_the_sync_was():
    """In µs since TIME, but for what the drive drifts until the next."""
    made = Bench(drives=drives(6, record=False))
    made.enable()
    made.run(3.0)
    zero_us = next(t for t, f, _ in made.frames if f.can_id == 0x100)
    sync_us = 0.0
    compared = 0
    for t_us, frame, _ in made.frames:
        if frame.can_id == SYNC:
            sync_us = t_us - zero_us
        elif frame.can_id & 0x780 == STAMP:
            assert abs(int.from_bytes(frame.data, "little") - sync_us) <= 100e-6 * 100_000 + 2
            compared += 1
    assert compared > 150


def test_a_drive_that_missed_a_sync_is_not_corrected_for_it():
    class Deaf(Epos2):
        deaf = False

        def receive(self, can_id, data, t_us, remote=False):
            return not (self.deaf and can_id == SYNC) and super().receive(
                can_id, data, t_us, remote
            )

    made = Bench(drives=[Deaf(n, drift_ppm=30.0 * n) for n in NODES])
    made.enable()
    made.run(2.0)
    made.drives[2].deaf = True
    run_to_sync(made)
    made.frames.clear()
    made.run(0.09)
    stamped = sorted(f.can_id - STAMP for _, f, _ in made.frames if f.can_id & 0x780 == STAMP)
    assert stamped == [1, 2, 4, 5, 6]
    made.drives[2].deaf = False
    made.run(0.3)
    assert np.ptp(clocks(made)) <= 20


@pytest.mark.parametrize("delay_us", [60_000, 110_000, 230_000])
@pytest.mark.parametrize("nodes", [{3}, {1, 3, 5, 6}, set(NODES)])
def test_answers_that_come_late_are_not_taken_for_those_to_the_next_sync(delay_us, nodes):
    made = Bench(drives=drives(6, record=False))
    made.enable()
    made.run(3.0)
    zero_us = clocks(made).mean() - made.now_us
    made.bus.host_delay_us = lambda can_id, _: delay_us if can_id - 0x580 in nodes else 0.0
    made.run(0.55)
    made.bus.host_delay_us = None
    made.run(0.3)
    assert np.ptp(clocks(made)) <= 10
    assert abs(clocks(made).mean() - made.now_us - zero_us) <= 5


def test_sync_waits_for_the_stamps_of_the_last_one():
    """An adapter with several mailboxes sends a SYNC before the stamps queued ahead of it; a
    stamp that comes after the next SYNC would correct by a whole period."""
    made = Bench(drives=drives(6, record=False))
    made.enable()
    made.run(2.0)
    bus, held = made.bus, []
    send = bus.host_send

    def slow_mailbox(can_id: int, data: bytes) -> None:
        if can_id == STAMP + 3 and not held:
            held.append((can_id, data))
        else:
            send(can_id, data)

    bus.host_send = slow_mailbox
    made.run(0.3)
    assert held
    made.frames.clear()
    made.run(0.3)
    assert not any(f.can_id == SYNC for _, f, _ in made.frames)
    send(*held[0])
    made.run(0.3)
    assert sum(f.can_id == SYNC for _, f, _ in made.frames) >= 2
    assert np.ptp(clocks(made)) <= 50


class StarvedHost(Bench):
    """It wakes up to `nap_us` late, for a frame as for what is due, and then hears at once what
    has been on the bus meanwhile."""

    def __init__(self, rng: random.Random) -> None:
        self.nap_us = 0.0
        self._unheard: list[tuple[int, bytes, float, bool]] = []
        self._wakes_us = math.inf
        self._rng = rng
        super().__init__(drives=drives(6, record=True))
        self.late_us = self._nap

    def _nap(self) -> float:
        return self._rng.uniform(0.0, self.nap_us)

    def _on_frame(self, can_id: int, data: bytes, t_us: float, echo: bool) -> bool:
        if not self.nap_us:
            return super()._on_frame(can_id, data, t_us, echo)
        if not self._unheard:
            self._wakes_us = t_us + self._nap()
        self._unheard.append((can_id, data, t_us, echo))
        return self.now_us >= self._wakes_us

    def _hear(self) -> None:
        unheard, self._unheard = self._unheard, []
        for frame in unheard:
            super()._on_frame(*frame)

    def _step(self) -> None:
        self._hear()
        super()._step()


@pytest.mark.parametrize("nap_us", [0.0, 1e3, 30e3])
def test_a_motion_may_begin_at_any_moment_of_the_sync_period(nap_us):
    """Its SYNCs come out of turn, also when stamps of the last one are due: half a period after
    it, for the drives that are slow. A stamp taken for that of the wrong SYNC moves a clock by
    the time between the two."""
    rng = random.Random(nap_us)
    made = StarvedHost(rng)
    made.enable()
    made.run(2.0)
    made.nap_us = nap_us
    joints = [axis.joint for axis in made.config.axes]
    spread_us = []
    for drive in made.drives:
        drive.look = lambda: spread_us.append(np.ptp(clocks(made)))
    for number in range(40):
        made.frames.clear()
        run_to_sync(made)
        sync_us = next(t_us for t_us, frame, _ in made.frames if frame.can_id == SYNC)
        after_us = rng.choice([rng.uniform(0.0, 100e3), rng.uniform(49.9e3, 50e3)])
        made.run((sync_us + after_us - made.now_us) / 1e6)
        ends = np.array([[number % 2], [(number + 1) % 2]]) * np.full(6, 0.01)
        at_us = rng.choice([None, made.now_us + rng.uniform(0.05e6, 0.2e6)])
        made.path.submit(Trajectory(joints, np.array([0.0, 0.3]), ends), at_us, made.now_us)
        assert made.group.motion is not None
        made.wait(made.group.motion)
        assert len({drive.ip_start_us for drive in made.drives}) == 1
    assert len(spread_us) > 1000
    # Two drives at ±100 ppm part so far in five periods; a host that wakes up so late that a clock
    # is not read before the next SYNC corrects less often.
    assert max(spread_us) <= (100 if nap_us < 30e3 else 200)


# ---------------------------------------------------------------------------- what is reported


def test_drift_and_offset_are_measured():
    made = bench(100.0, 20.0, 6, 0.1)
    made.run(15.0)
    clock = made.group.time.clock
    ppm = np.array([1e6 * (drive.clock.rate - 1) for drive in made.drives])
    assert np.abs(1e6 * clock.drift - ppm).max() <= 3.0
    assert np.ptp(1e6 * clock.drift - ppm) <= 0.5  # the host's noise is common to all
    assert np.abs(clock.offset_us).max() <= 100e-6 * 100_000 + 3
    assert 5 <= clock.noise_us <= 30  # the median deviation of a normal distribution is 0.67 σ


@given(
    st.lists(st.floats(-200e-6, 200e-6), min_size=1, max_size=8),
    st.floats(0.0, 100.0),
    st.integers(0, WRAP - 1),
    st.integers(0, 1 << 32),
)
@settings(max_examples=30, deadline=None)
def test_stamps_keep_any_drives_at_the_hosts_time(drifts, noise_us, begin_us, seed):
    """Clocks computed here: value = set + rate · passed, read in whole microseconds."""
    rng = random.Random(seed)  # noise, not an opponent: Hypothesis would choose every value of it
    period_us = 100_000.0
    clock = MasterClock(len(drifts), period_us)
    clock.reset(-float(begin_us))
    values = [float(begin_us)] * len(drifts)
    for n in range(1, 120):
        t_us = n * period_us
        values = [v + (1 + d) * period_us for v, d in zip(values, drifts, strict=True)]
        latched = [int(v) % WRAP for v in values]
        clock.on_sync(t_us + rng.uniform(-noise_us, noise_us), latched)
        for drive, value in enumerate(latched):
            stamp = clock.stamp(drive, 0.0)
            values[drive] += (stamp - value + WRAP // 2) % WRAP - WRAP // 2
            clock.corrected(drive, stamp)
        if n > 20:
            middle = np.array(values) + np.array(drifts) * period_us / 2
            assert np.abs(middle - begin_us - t_us).max() <= 5 * noise_us + 6
            assert np.ptp(middle) <= 0.2 * noise_us + 6  # one that loses little may be off by more


@pytest.mark.parametrize(
    ("unix_s", "days", "ms"),
    [(441_763_200.0, 0, 0), (946_684_800.5, 5844, 500), (1_700_000_000.0, 14_562, 80_000_000)],
)
def test_time_of_day(unix_s, days, ms):
    """CiA 301, TIME_OF_DAY; the days between 1984-01-01 and 2000-01-01 are 16·365 + 4."""
    data = time_of_day(unix_s)
    assert int.from_bytes(data[:4], "little") == ms
    assert int.from_bytes(data[4:], "little") == days
