"""The group of EPOS2 axes against simulated drives: start, feed, stop, fail, come back.

Expected frames are written down from maxon's application note "Interpolation Position Mode"
(3.7 and "Motion Synchronisation") and CiA 402; expected curves are computed here.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from simulated_time import Bench, axes
from six_axes import (
    NODES,
    QC_PER_RAD,
    all_stand,
    assert_on_path,
    bench,
    drives,
    executed,
    run_motion,
    statusword,
    there_and_back,
)

from epos2_ros.configuration.driver import DriverConfig
from epos2_ros.errors import DriveError, MotionAborted, TrajectoryError
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.protocol.frame import Frame
from epos2_ros.protocol.phase import Phase
from epos2_ros.sim.epos2 import Epos2

# ---------------------------------------------------------------------------- start


def test_the_start_sequence_frame_by_frame():
    made = bench()
    count = made.group.time.sync_count
    made.run(1.0, lambda: made.group.time.sync_count > count)
    made.run(0.06)  # the last of its time stamps goes out after half a SYNC period
    made.frames.clear()
    made.path.submit(there_and_back(), None, made.now_us)
    made.run(1.0, lambda: made.group.phase is Phase.MOVING)

    sent = [(t, f) for t, f, echo in made.frames if echo]
    t_zero = made.drives[0].ip_start_us
    start = next(i for i, (t, f) in enumerate(sent) if t == t_zero)
    assert made.machine.path_time.start_us == pytest.approx(t_zero, abs=1)
    before = [f for _, f in sent[:start] if f.can_id != 0x77F]  # besides the host's heartbeat

    # Motion Synchronisation: "enable ip mode" (0x001F) in each drive's synchronous RPDO, all of
    # them on the bus before the SYNC that makes them count, and nothing between.
    assert sent[start][1] == Frame(0x080)
    assert before[-6:] == [Frame(0x300 + n, b"\x1f\x00") for n in NODES]
    # Before that, records: at least three in every drive (3.6.3 asks for two besides the one in
    # execution), none of them the end record (time 0). And one more SYNC with its time stamps,
    # for the clocks to be together. First of all bit 4 is clear, or it could not rise.
    records = [f for f in before[:-6] if f.can_id & 0x780 == 0x200]
    others = [f.can_id for f in before[:-6] if f.can_id & 0x780 not in (0x200, 0x600)]
    assert others == [0x500 + n for n in NODES] + [0x080] + [0x400 + n for n in NODES]
    assert all(f.data == b"\x0f\x00" for f in before if f.can_id & 0x780 == 0x500)
    for n in NODES:
        mine = [f.data for f in records if f.can_id == 0x200 + n]
        assert len(mine) >= 3
        assert all(data[7] for data in mine)
        # The first holds the position for a millisecond: whatever a drive takes it for.
        assert mine[0] == bytes(7) + b"\x01"
    # Every drive has said, before it was armed, that it has as many as were sent (0x60C4-02).
    first_arming = next(t for t, f in sent if f.can_id & 0x780 == 0x300)
    for n in NODES:
        answers = [f.data for t, f, _ in made.frames if f.can_id == 0x580 + n and t < first_arming]
        assert answers[-1][:4] == b"\x43\xc4\x60\x02"
        free = int.from_bytes(answers[-1][4:8], "little")
        assert 64 - free == sum(f.can_id == 0x200 + n for f in records)
    # Afterwards the time of that SYNC goes to every drive (2.4).
    made.run(0.1)
    after = [f.can_id for t, f, echo in made.frames if echo and t > t_zero]
    answers = [i for i in after[: after.index(0x080)] if i & 0x780 == 0x400]
    assert sorted(answers) == [0x400 + n for n in NODES]
    # All zeros of the paths are the SYNC's arrival.
    assert [drive.ip_start_us for drive in made.drives] == [t_zero] * 6


def test_drives_are_enabled_by_the_documented_controlwords():
    made = Bench(drives=drives())
    made.frames.clear()
    made.enable()
    for n in NODES:
        words = [f.data for _, f, echo in made.frames if echo and f.can_id == 0x500 + n]
        assert words == [b"\x06\x00", b"\x0f\x00"]  # shutdown, switch on (note, table 17)


def test_a_start_at_a_given_time_is_on_that_time():
    made = bench()
    at_us = made.now_us + 437_000.0
    made.path.submit(there_and_back(), at_us, made.now_us)
    made.wait(made.group.motion)
    sync_us = 51.0  # a SYNC's bits at 1 Mbit/s at most: it is on the bus when it has ended
    hold_us = 1000.0  # what the first record takes
    began_us = [drive.ip_start_us + hold_us for drive in made.drives]
    assert all(at_us <= t_us <= at_us + sync_us for t_us in began_us)
    assert_on_path(made)


@pytest.mark.parametrize("late_us", [0.0, 300.0, 2000.0])
def test_how_late_a_start_at_a_given_time_was_is_told(late_us):
    """By a host's thread that wakes up late; by its clock, in which the time was given."""
    made = bench()
    made.late_us = lambda: late_us
    ahead_us = 12_345.0
    made.stamp_us = lambda t_us: t_us + ahead_us
    at_us = made.now_us + 437_000.0
    made.path.submit(there_and_back(), at_us, made.now_us)
    assert made.machine.path_time.start_error_us is None
    made.wait(made.group.motion)
    began_us = made.drives[0].ip_start_us + 1000.0  # what the first record takes
    assert 0.0 <= began_us - at_us <= 2 * late_us + 100  # a frame may wake it earlier
    error_us = began_us + ahead_us - at_us
    assert made.machine.path_time.start_error_us == pytest.approx(error_us, abs=1)
    (text,) = [event.text for event in made.events if event.kind == "started"]
    assert text == f"6 axes started on one SYNC, {error_us:.0f} us after the time asked for"
    run_motion(made)
    assert made.machine.path_time.start_error_us is None  # as soon as possible is no given time


def test_no_drive_moves_when_one_does_not_become_active():
    class Deaf(Epos2):
        def receive(self, can_id, data, t_us, remote=False):
            return can_id != 0x303 and super().receive(can_id, data, t_us, remote)

    made = Bench(drives=[(Deaf if n == 3 else Epos2)(n) for n in NODES])
    made.enable()
    made.path.submit(there_and_back(), None, made.now_us)
    with pytest.raises(MotionAborted, match=r"joint_3 \(node 3\): .* it has not started with"):
        made.wait(made.group.motion)
    assert made.group.phase is Phase.FAULT
    assert all_stand(made)


# ---------------------------------------------------------------------------- motion


def test_motion_stays_within_tolerance_and_ends_enabled_ready_for_the_next():
    made = bench()
    for _ in range(3):
        run_motion(made)
        assert_on_path(made)
        for drive in made.drives:
            assert statusword(drive) & 0x106F == 0x0027  # enabled, ip inactive
        assert made.group.phase is Phase.STANDING


def test_buffers_hold_the_configured_time_and_never_too_few_or_too_many():
    made = bench()
    made.path.submit(there_and_back(6.0), None, made.now_us)
    made.wait(made.group.motion)
    for axis, drive in zip(made.machine.interpolated.axes, made.drives, strict=True):
        level = np.array(drive.recorder.buffer_level)
        t_ms = np.array(drive.recorder.path_ms)
        assert level[t_ms < 5400].min() >= 2, axis
        assert level.max() <= 64


def test_a_lost_record_stops_all_axes():
    made = bench()
    made.path.submit(there_and_back(4.0), None, made.now_us)
    made.run(1.0)
    lost = []

    def drop(can_id, data, source):
        if can_id == 0x204 and not lost:
            lost.append(data)
            return True
        return False

    made.bus.drop = drop
    with pytest.raises(MotionAborted, match=r"joint_4 \(node 4\)"):
        made.wait(made.group.motion)
    assert lost
    assert made.group.phase is Phase.FAULT
    assert all_stand(made)


# ---------------------------------------------------------------------------- stopping


def test_halt_stops_and_holds_and_the_next_motion_runs():
    made = bench()
    made.path.submit(there_and_back(4.0), None, made.now_us)
    motion = made.group.motion
    made.run(1.0)
    made.wait(made.group.halt())
    with pytest.raises(MotionAborted, match="halted on request"):
        motion.result(timeout=0)
    assert made.group.phase is Phase.STANDING
    assert all_stand(made)
    here = [unit.from_qc(d._demand) for unit, d in zip(made.path._units, made.drives, strict=True)]
    back = Trajectory(
        tuple(f"joint_{n}" for n in NODES), np.array([0.0, 2.0]), np.array([here, [0.0] * 6])
    )
    made.path.submit(back, None, made.now_us)
    made.wait(made.group.motion)
    for drive in made.drives:
        assert abs(drive._demand) <= 0.5


def test_bit_4_falls_before_the_halt_is_released():
    made = bench()
    made.path.submit(there_and_back(4.0), None, made.now_us)
    made.run(1.0)
    made.frames.clear()
    made.wait(made.group.halt())
    for n in NODES:
        words = [f.data for _, f, echo in made.frames if echo and f.can_id == 0x500 + n]
        assert words == [b"\x1f\x01", b"\x0f\x01", b"\x0f\x00"]


def test_stop_on_the_path_leaves_no_axis_off_the_line():
    made = bench()
    made.path.submit(there_and_back(4.0), None, made.now_us)
    made.run(0.7)
    made.path.stop()
    made.wait(made.group.motion)
    assert made.group.phase is Phase.STANDING
    first = executed(made.drives[0])[1]
    assert 0.02 < first[-1] / QC_PER_RAD < 0.3  # stopped on the way out
    for axis, drive in enumerate(made.drives):  # all axes keep the proportions of the line
        demand = executed(drive)[1]
        assert np.abs(demand - first * (1 - axis / 10)).max() <= 2.0


def test_quick_stop_then_enable_again():
    made = bench()
    made.path.submit(there_and_back(4.0), None, made.now_us)
    motion = made.group.motion
    made.run(1.0)
    made.wait(made.group.quick_stop())
    with pytest.raises(MotionAborted, match="quick stop"):
        motion.result(timeout=0)
    assert all_stand(made)
    made.enable()
    assert made.group.phase is Phase.STANDING


def test_disable_and_enable():
    made = bench()
    made.wait(made.group.disable())
    assert [statusword(d) & 0x6F for d in made.drives] == [0x21] * 6
    with pytest.raises(TrajectoryError, match="disabled"):
        made.path.submit(there_and_back(), None, made.now_us)
    made.enable()
    run_motion(made)
    assert_on_path(made)


@pytest.mark.parametrize(("request_", "off"), [("disable", {0x21}), ("quick_stop", {0x40, 0x07})])
def test_what_is_off_stays_off_though_it_was_being_enabled(request_, off):
    """Whenever it is asked for: "enable operation" may just be on its way to a drive."""
    for ms in np.arange(0.0, 12.0, 2.0):
        made = Bench(DriverConfig(axes=axes(2)), [Epos2(1), Epos2(2)])
        made.group.enable()
        made.run(ms / 1000)
        made.wait(getattr(made.group, request_)())
        made.run(1.0)
        assert made.group.phase is Phase.DISABLED
        assert {statusword(drive) & 0x6F for drive in made.drives} <= off, ms


def test_a_drive_that_somebody_else_enables_is_switched_off_again():
    made = bench()
    made.wait(made.group.disable())
    made.drives[2].receive(0x503, b"\x0f\x00", made.now_us)
    assert statusword(made.drives[2]) & 0x6F != 0x21
    made.run(0.5)
    assert [statusword(drive) & 0x6F for drive in made.drives] == [0x21] * 6


# ---------------------------------------------------------------------------- trouble


@pytest.mark.parametrize("code", [0x8611, 0x2310, 0xFF0B])
def test_one_axis_in_trouble_stops_all_and_nothing_restarts_by_itself(code):
    made = bench()
    made.path.submit(there_and_back(4.0), None, made.now_us)
    motion = made.group.motion
    made.run(1.0)
    made.drives[2].fail(code, made.now_us)
    made.run(5.0, motion.done)
    with pytest.raises(MotionAborted, match=rf"joint_3 \(node 3\): .*0x{code:04X}"):
        motion.result(timeout=0)
    made.run(1.0)
    assert made.group.phase is Phase.FAULT
    assert all_stand(made)
    with pytest.raises(DriveError, match="reset the fault first"):
        made.enable()
    made.wait(made.group.reset_fault())
    made.enable()
    assert made.group.phase is Phase.STANDING


def test_all_axes_begin_to_stop_within_a_few_milliseconds_of_a_fault():
    made = bench()
    made.path.submit(there_and_back(4.0), None, made.now_us)
    made.run(1.0)
    made.drives[0].fail(0x8611, made.now_us)
    failed_us = made.now_us
    made.run(0.1)
    halts = {
        f.can_id: t
        for t, f, echo in made.frames
        if echo and f.data == b"\x1f\x01" and t > failed_us
    }
    for n in NODES[1:]:
        assert halts[0x500 + n] - failed_us < 5000


def test_a_silent_drive_stops_the_others():
    made = bench()
    made.path.submit(there_and_back(8.0), None, made.now_us)
    motion = made.group.motion
    made.run(1.0)
    made.drives[4].disconnect()
    made.run(6.0, motion.done)
    with pytest.raises(MotionAborted, match=r"joint_5 \(node 5\)"):
        motion.result(timeout=0)
    made.run(0.3)  # it stops by itself, when it has not heard the host for half a second
    assert all_stand(made)


def test_a_restarted_drive_has_to_be_brought_up_again():
    made = bench()
    made.path.submit(there_and_back(8.0), None, made.now_us)
    motion = made.group.motion
    made.run(1.0)
    made.drives[1].power_off()
    made.drives[1].power_on(made.now_us)
    made.run(6.0, motion.done)
    with pytest.raises(MotionAborted, match=r"joint_2 \(node 2\)"):
        motion.result(timeout=0)
    assert made.lost() == [1]


def test_drives_stop_by_themselves_when_the_host_dies():
    made = bench()
    made.path.submit(there_and_back(8.0), None, made.now_us)
    made.run(2.0)
    assert not all_stand(made)
    made.bus.run_until(made.now_us + 3e6, lambda *frame: None)  # nobody listens or feeds
    for drive in made.drives:
        assert statusword(drive) & 0x4F == 0x08  # fault
    before = [drive._demand for drive in made.drives]
    made.bus.run_until(made.now_us + 1e5, lambda *frame: None)
    assert before == [drive._demand for drive in made.drives]


# ---------------------------------------------------------------------------- bring-up


def test_no_answer_says_what_to_check():
    made = Bench(drives=[Epos2(n) for n in NODES if n != 4], bring_up=False)
    with pytest.raises(DriveError, match=r"no answer from joint_4 \(node 4\): check power, wiring"):
        made.bring_up()


def test_another_device_on_a_node_id_is_refused():
    made = Bench(
        drives=[Epos2(n, vendor_id=0x1234 if n == 2 else 0xFB) for n in NODES], bring_up=False
    )
    with pytest.raises(DriveError, match=r"joint_2 \(node 2\) is not an EPOS2.*vendor 0x00001234"):
        made.bring_up()


@pytest.mark.parametrize("fault", [False, True])
def test_bring_up_finds_its_way_from_whatever_an_earlier_host_left(fault):
    made = bench()
    made.path.submit(there_and_back(8.0), None, made.now_us)
    made.run(2.0)
    if fault:
        made.drives[3].fail(0x8611, made.now_us)
    again = Bench.__new__(Bench)
    again.__dict__.update(made.__dict__)
    fresh = Bench(made.config, made.drives, bring_up=False)
    again.__dict__.update(
        {name: getattr(fresh, name) for name in ("group", "path", "network", "transmitter")}
    )
    again.nodes = fresh.nodes
    fresh.bus = made.bus
    fresh.bring_up()
    fresh.enable()
    assert fresh.group.phase is Phase.STANDING


def test_axis_settings_reach_the_drive():
    config = DriverConfig(
        axes=axes(
            1,
            max_velocity=2.0,
            max_acceleration=4.0,
            min_position=-1.0,
            max_position=1.0,
            stop_deceleration=8.0,
            max_following_error=1500,
            direction=-1,
            offset=0.1,
        )
    )
    drive = Epos2(1)
    Bench(config, [drive])
    od = drive.dictionary
    rpm = 2.0 / (2 * math.pi) * 60 * 100  # motor speed at the joint's limit
    assert rpm <= od[0x6081, 0].value <= od[0x607F, 0].value <= rpm * 1.06 + 3
    rpm_s = 4.0 / (2 * math.pi) * 60 * 100
    # In 16 ms a velocity unit, 1 rpm, and from rest to rest a count of 2000 per turn.
    rounding = 1 / 0.016 + 6 / 0.016**2 / 2000 * 60
    assert rpm_s <= od[0x6083, 0].value <= od[0x60C5, 0].value <= rpm_s * 1.26 + rounding
    assert abs(od[0x6084, 0].value - 2 * rpm_s) <= 1
    assert od[0x6085, 0].value == od[0x6084, 0].value
    assert od[0x6065, 0].value == 1500
    # direction −1 turns the limits around; the offset is where the drive reads 0
    assert abs(od[0x607D, 1].value - (-(1.0 - 0.1) * QC_PER_RAD)) <= 4
    assert abs(od[0x607D, 2].value - (1.0 + 0.1) * QC_PER_RAD) <= 4
