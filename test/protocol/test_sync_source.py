"""A drive as clock master, and a drive that sends SYNC, in simulated time.

The rules are those of maxon's application note "Interpolation Position Mode", 2.4 and "Motion
Synchronisation", and of CiA 301 for SYNC (0x1005, 0x1006). Drives drift from −100 to +100 ppm.
"""

from __future__ import annotations

import itertools
import math
import warnings

import numpy as np
import pytest
from simulated_time import Bench, axes, downloads
from six_axes import assert_on_path, run_motion, there_and_back

from benchmarks.time_sync import bench, drives, watch, watch_motion
from epos2_ros.bus.driver import Driver
from epos2_ros.configuration.driver import DriverConfig
from epos2_ros.errors import ConfigurationError, DriveError, MotionAborted
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.protocol.clock import MasterClock
from epos2_ros.protocol.frame import Frame
from epos2_ros.protocol.path_time import PathTime
from epos2_ros.protocol.phase import Phase
from epos2_ros.sim.epos2 import Dictionary, Epos2

SYNC, TPDO3, RPDO2, RPDO3 = 0x080, 0x380, 0x300, 0x400
JOINTS = [axis.joint for axis in axes()]
ALL = list(itertools.product(("host", "joint_3"), ("host", "joint_2")))
DRIFT_US = 200e-6 * 100_000 + 2  # two drives in a SYNC period of 0.1 s, two whole ticks


def made(source: str = "host", producer: str = "host", **conditions: float) -> Bench:
    jitter_us, noise_us = conditions.get("jitter_us", 100.0), conditions.get("noise_us", 20.0)
    return bench(jitter_us, noise_us, 6, 0.1, record=True, source=source, producer=producer)


def last(told: list[tuple[int, int, int]], index: int, subindex: int) -> int:
    return [value for i, s, value in told if (i, s) == (index, subindex)][-1]


# ---------------------------------------------------------------------------- clock master


def test_the_masters_tpdo_is_the_others_rpdo():
    """ "Motion Synchronisation": 0x1013 in a synchronous TPDO of the master; on the others in an
    asynchronous RPDO "with the very same COB-ID"."""
    one = made("joint_3")
    for node in range(1, 7):
        told = downloads(one, node)
        if node == 3:
            assert last(told, 0x1802, 1) & ~(1 << 30) == TPDO3 + 3  # bit 30: no remote requests
            assert last(told, 0x1802, 2) == 1
            assert last(told, 0x1A02, 0) == 1
            assert last(told, 0x1A02, 1) == 0x1013_0020
        else:
            assert last(told, 0x1402, 1) == TPDO3 + 3
            assert last(told, 0x1402, 2) == 255
            assert last(told, 0x1602, 0) == 1
            assert last(told, 0x1602, 1) == 0x1013_0020


@pytest.mark.parametrize("producer", ["host", "joint_2"])
def test_the_host_sends_no_time_stamp(producer):
    one = made("joint_3", producer)
    one.run(2.0)
    stamps = [f for _, f, echo in one.frames if echo and f.can_id & 0x780 == RPDO3]
    assert not stamps
    masters = [f for _, f, echo in one.frames if f.can_id == TPDO3 + 3]
    assert len(masters) > 15
    assert all(len(frame.data) == 4 for frame in masters)


@pytest.mark.parametrize(("jitter_us", "noise_us"), [(0.0, 0.0), (1000.0, 200.0)])
def test_clocks_follow_the_masters(jitter_us, noise_us):
    """Right after every SYNC, whatever the host's time is worth; they part until the next."""
    one = made("joint_3", jitter_us=jitter_us, noise_us=noise_us)
    assert watch(one, 10.0).worst <= DRIFT_US
    corrected: list[float] = []
    for drive in one.drives:
        drive.look = lambda: corrected.append(
            np.ptp([drive.clock.value(one.now_us) for drive in one.drives])
        )
    one.run(1.0)
    after_all = corrected[9::10]  # five drives, before and after each
    assert 9 <= len(after_all) <= 11
    assert max(after_all) <= 2.0


def test_offset_and_drift_are_told():
    """Offset from the master's clock, drift against the host's."""
    one = made("joint_3")
    one.run(12.0)
    clock = one.group.time.clock
    np.testing.assert_allclose(1e6 * clock.drift, np.linspace(-100, 100, 6), atol=3.0)
    apart = (np.linspace(-100, 100, 6) - -20) * 0.1  # in a SYNC period, before the correction
    np.testing.assert_allclose(clock.offset_us, apart, atol=2.0)


def test_the_masters_clock_wraps(monkeypatch: pytest.MonkeyPatch):
    """0x1013 wraps every 71.6 minutes: here 3 s after TIME, on the host and on the drives."""
    ahead_us = 2**32 - 3e6
    reset = MasterClock.reset
    monkeypatch.setattr(MasterClock, "reset", lambda self, t_us: reset(self, t_us - ahead_us))
    group = drives(6, record=True, dictionary=Dictionary.NOTE)
    for drive in group:

        def on_time(drive=drive, set_to_zero=drive._on_time) -> None:
            set_to_zero()
            drive.clock._offset_us += ahead_us

        monkeypatch.setattr(drive, "_on_time", on_time)
    one = Bench(DriverConfig(axes=axes(), sync_source="joint_3"), group)
    one.enable()
    seen = watch_motion(one, 4.0)
    assert max(drive.clock.latched for drive in one.drives) < 10e6
    assert seen.worst <= DRIFT_US


# ---------------------------------------------------------------------------- SYNC producer


def test_the_drive_is_told_period_and_producer_in_this_order():
    """CiA 301: 0x1005 with bit 30 starts SYNC with the period in 0x1006 [µs]."""
    one = made(producer="joint_2")
    told = downloads(one, 2)
    assert (0x1006, 0, 100_000) in told
    assert told.index((0x1006, 0, 100_000)) < told.index((0x1005, 0, 0x4000_0080))
    others = [value for node in (1, 3, 4, 5, 6) for value in downloads(one, node)]
    assert not any(index == 0x1005 and value >> 30 for index, _, value in others)


@pytest.mark.parametrize("source", ["host", "joint_3"])
def test_the_host_sends_no_sync(source):
    one = made(source, "joint_2")
    one.frames.clear()
    one.run(2.0)
    run_motion(one)
    syncs = [(t, echo) for t, f, echo in one.frames if f.can_id == SYNC]
    assert not any(echo for _, echo in syncs)
    period_us = 100_000 / (1 - 60e-6)  # by the quartz of joint_2; a SYNC may wait for the bus
    np.testing.assert_allclose(np.diff([t for t, _ in syncs]), period_us, atol=1000)
    assert 38 <= len(syncs) <= 43


def test_clocks_stay_together_with_the_sync_of_a_drive():
    """As with the host's: 10 µs, twice corrected in a period."""
    # 200 ppm in half a period, and a stamp waits for the bus
    assert watch(made(producer="joint_2"), 10.0).worst <= 10.5


# ---------------------------------------------------------------------------- motion


@pytest.mark.parametrize(("source", "producer"), ALL)
def test_motion_starts_on_one_sync_and_keeps_to_its_path(source, producer):
    one = made(source, producer)
    one.run(1.0)
    run_motion(one, there_and_back())
    assert len({drive.ip_start_us for drive in one.drives}) == 1
    syncs = [t for t, f, _ in one.frames if f.can_id == SYNC]
    assert one.drives[0].ip_start_us in syncs
    assert_on_path(one)


@pytest.mark.parametrize(("source", "producer"), ALL)
def test_paths_stay_together(source, producer):
    seen = watch_motion(made(source, producer), 6.0)
    assert seen.spread[0] == 0
    assert seen.worst <= (10 if source == "host" else DRIFT_US)


@pytest.mark.parametrize("source", ["host", "joint_3"])
def test_a_start_at_a_given_time_is_on_the_nearest_sync(source):
    one = made(source, "joint_2")
    one.run(1.0)
    for ahead_us in (0.41e6, 0.45e6, 0.49e6):
        at_us = one.now_us + ahead_us
        one.path.submit(there_and_back(), at_us, one.now_us)
        one.wait(one.group.motion)
        late_us = one.drives[0].ip_start_us + 1000.0 - at_us  # the first record takes 1 ms
        assert abs(late_us) <= 50_000 + 1_000
        assert one.machine.path_time.start_error_us == pytest.approx(late_us, abs=200)


def test_feeding_goes_by_the_masters_clock():
    """Which gains 48 ms on the host's in two minutes: more than two records' worth of difference
    in the buffer would be taken for lost ones."""
    note = Dictionary.NOTE
    drifting = [Epos2(n, drift_ppm=400.0, record=True, dictionary=note) for n in (1, 2)]
    one = Bench(DriverConfig(axes=axes(2), sync_source="joint_1", buffer_time=0.1), drifting)
    one.enable()
    one.run(2.0)
    one.path.submit(there_and_back(120.0, reach=2.0, joints=2), None, one.now_us)
    motion = one.group.motion
    assert motion is not None
    one.run(119.0, motion.done)
    path_ms = one.machine.path_time.at_ms(one.now_us)
    assert path_ms == pytest.approx(drifting[0].recorder.path_ms[-1], abs=1.5)
    assert one.machine.path_time.start_us is not None
    assert path_ms - (one.now_us - one.machine.path_time.start_us) / 1000 == pytest.approx(
        47, abs=2
    )
    one.wait(motion)


class LateHost(Bench):
    """It sleeps for a while after each of the first SYNCs, and takes what it then finds for new."""

    def __init__(self, config: DriverConfig, syncs: int, nap_us: float) -> None:
        self._naps, self._nap_us = syncs, nap_us
        self._wakes_us = -math.inf
        self._unheard: list[tuple[int, bytes, bool]] = []
        super().__init__(config, drives(len(config.axes), record=True, dictionary=Dictionary.NOTE))
        self.late_us = lambda: max(0.0, self._wakes_us - self.now_us)

    def _on_frame(self, can_id: int, data: bytes, t_us: float, echo: bool) -> bool:
        if self.now_us >= self._wakes_us:
            if can_id != SYNC or not self._naps:
                return super()._on_frame(can_id, data, t_us, echo)
            self._naps -= 1
            self._wakes_us = self.now_us + self._nap_us
        self._unheard.append((can_id, data, echo))
        return False

    def _hear(self) -> None:
        if self.now_us >= self._wakes_us:
            unheard, self._unheard = self._unheard, []
            for can_id, data, echo in unheard:
                super()._on_frame(can_id, data, self.now_us, echo)

    def _step(self) -> None:
        self._hear()
        if self.now_us >= self._wakes_us:
            super()._step()


@pytest.mark.parametrize("host_is_master", [True, False])
def test_what_never_was_is_before_the_path_and_never_after_it(host_is_master):
    """A drive that has not reported yet; what is never due."""
    path_time = PathTime(MasterClock(2, 100e3, None if host_is_master else 1), host_is_master)
    assert path_time.at_ms(-math.inf) is None
    path_time.begin(5e6)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert [path_time.at_ms(t) for t in (-math.inf, math.inf)] == [-math.inf, math.inf]
        assert path_time.at_ms(5.25e6) == pytest.approx(250.0)


@pytest.mark.parametrize(("source", "producer"), ALL)
@pytest.mark.parametrize(("syncs", "nap_us"), [(1, 40e3), (1, 110e3), (2, 110e3), (3, 260e3)])
def test_a_host_that_notices_the_first_syncs_late_goes_on(source, producer, syncs, nap_us):
    """As a busy computer with an adapter that stamps nothing does: no drive is to blame."""
    config = DriverConfig(axes=axes(), sync_source=source, sync_producer=producer)
    one = LateHost(config, syncs, nap_us)
    one.enable()
    run_motion(one, there_and_back())
    assert_on_path(one)
    one.run(1.0)
    assert one.group.phase is Phase.STANDING
    clocks = [drive.clock.value(one.now_us) for drive in one.drives]
    assert np.ptp(clocks) <= (10 if source == "host" else DRIFT_US)


# ---------------------------------------------------------------------------- trouble


def test_a_sync_before_all_axes_are_armed_stops_all():
    """The controlword of one axis does not get onto the bus for half a period."""
    one = made(producer="joint_2")
    one.run(1.0)
    send, held = one.transmitter._send, []

    def send_late(frame: Frame) -> bool:
        if frame.can_id == RPDO2 + 5 and one.group.phase is Phase.ARMING:
            held.append(frame)
            return True
        return send(frame)

    one.transmitter._send = send_late
    with pytest.raises(MotionAborted, match="SYNC came before the start controlword .* 1 axes"):
        run_motion(one)
    assert held
    one.transmitter._send = send
    send(held[0])  # late, as from an adapter's queue
    one.run(1.0)
    assert one.group.phase is Phase.FAULT
    before = [drive._demand for drive in one.drives]
    one.run(1.0)
    assert [drive._demand for drive in one.drives] == before


@pytest.mark.parametrize("source", ["host", "joint_2", "joint_3"])
def test_without_the_sync_of_the_drive_all_stop_and_come_back(source):
    one = made(source, "joint_2")
    one.run(1.0)
    one.path.submit(there_and_back(20.0), None, one.now_us)
    one.run(2.0)
    one.nodes[1].produce_sync(0)  # as somebody with another tool on the bus would
    with pytest.raises(MotionAborted, match=r"no SYNC from joint_2 \(node 2\)"):
        one.wait(one.group.motion)
    one.run(2.0)
    assert one.group.phase is Phase.FAULT
    assert one.lost() == [1]
    with pytest.raises(DriveError):
        one.wait(one.group.enable())
    one.bring_up()
    one.wait(one.group.reset_fault())
    one.enable()
    run_motion(one, Trajectory(tuple(JOINTS), np.array([2.0]), np.zeros((1, 6)), None, None))
    assert max(abs(drive._demand) for drive in one.drives) <= 1


def test_a_lost_clock_master_stops_all():
    one = made("joint_3")
    one.run(1.0)
    one.path.submit(there_and_back(20.0), None, one.now_us)
    one.run(2.0)
    one.drives[2].disconnect()
    with pytest.raises(MotionAborted, match="joint_3 .* is silent"):
        one.wait(one.group.motion)
    one.run(2.0)
    assert one.group.phase is Phase.FAULT


@pytest.mark.parametrize("who", [2, 1])
def test_answers_to_some_syncs_that_are_lost_change_no_clock(who):
    """Of the clock master, and of another."""
    one = made("joint_3")
    one.run(1.0)
    one.drives[who].disconnect()
    one.run(0.3)
    one.drives[who].reconnect()
    one.run(0.4)
    one.path.submit(there_and_back(1.0), None, one.now_us)
    one.wait(one.group.motion)
    assert not [event.text for event in one.events if event.kind == "fault"]


def test_a_drive_without_0x1006_is_refused_as_sync_producer():
    """The maker's dictionary: it is asked first, and nothing of it is written."""
    config = DriverConfig(axes=axes(2), sync_producer="joint_2")
    one = Bench(config, [Epos2(1), Epos2(2)], bring_up=False)
    with pytest.raises(DriveError) as refusal:
        one.bring_up()
    assert str(refusal.value) == (
        "joint_2 (node 2) can't send SYNC: it has no communication cycle period (0x1006), as no "
        "EPOS2 of known firmware has; set sync.producer to host"
    )
    assert not any(index in (0x1005, 0x1006) for index, _, _ in downloads(one, 2))


def test_a_period_too_short_to_arm_is_refused():
    config = DriverConfig(axes=axes(), sync_producer="joint_2", sync_period=0.02)
    with pytest.raises(ConfigurationError, match="sync.period is 0.02 s; .* at least 0.0435 s"):
        Driver(config).configure()
