"""The driver on EPOS2 drives as they come: both dictionaries, and what real ones do besides.

The makers' facts are in `test_sim_maker`, which holds the simulated drive to maxon's own tables.
"""

from __future__ import annotations

import struct
from dataclasses import replace

import numpy as np
import pytest
from simulated_time import Bench, axes, downloads
from six_axes import assert_on_path, executed, run_motion, there_and_back

from epos2_ros.configuration.driver import DriverConfig
from epos2_ros.errors import DriveError, MotionAborted
from epos2_ros.protocol import epos2
from epos2_ros.protocol.phase import Phase
from epos2_ros.sim.epos2 import Dictionary, Epos2, FirstRecord

BOTH = pytest.mark.parametrize("dictionary", list(Dictionary))
TWO = DriverConfig(axes=axes(2))


def move(made: Bench) -> None:
    run_motion(made, there_and_back(joints=len(made.drives)))


def bench(*drives: Epos2) -> Bench:
    made = Bench(DriverConfig(axes=axes(len(drives))), drives)
    made.enable()
    return made


# --- both dictionaries, one way -----------------------------------------------------------------


@BOTH
def test_comes_up_and_moves(dictionary: Dictionary) -> None:
    made = bench(*(Epos2(n, dictionary=dictionary, record=True) for n in (1, 2)))
    for _ in range(2):
        move(made)
        assert_on_path(made)
    assert made.group.phase is Phase.STANDING


def test_bring_up_is_the_same_on_both() -> None:
    """One way: not the other one after a refusal. Only 0x6007 is looked for, and the version."""
    told = []
    for dictionary in Dictionary:
        made = Bench(TWO, [Epos2(n, dictionary=dictionary) for n in (1, 2)])
        told.append([w for w in downloads(made, 1) if w[0] & 0xFF00 not in (0x1400, 0x1800)])
        refused = [f for _, f, _ in made.frames if f.can_id == 0x581 and f.data[0] == 0x80]
        assert refused == []
    assert told[0] == told[1]


@BOTH
@pytest.mark.parametrize(
    ("buffer_time", "words", "within_s"),
    [(3.0, "records where .* accounted for", 2.1), (0.5, "its demand is .* off its path", 0.7)],
)
def test_a_lost_record_is_found_by_asking_or_once_it_is_due(
    dictionary: Dictionary, buffer_time: float, words: str, within_s: float
) -> None:
    """Each buffer is read once in two seconds; what is due earlier the demand tells, in two SYNCs.
    The axes are told of it by their halt, whose ramp is included."""
    drives = [Epos2(n, dictionary=dictionary, record=True) for n in (1, 2)]
    made = Bench(replace(TWO, buffer_time=buffer_time), drives)
    made.enable()
    made.path.submit(there_and_back(10.0, joints=2), None, made.now_us)
    made.run(1.5)
    lost_us: list[float] = []

    def drop(can_id: int, data: bytes, source: int) -> bool:
        if can_id == 0x202 and not lost_us:
            lost_us.append(made.now_us)
            return True
        return False

    made.bus.drop = drop
    with pytest.raises(MotionAborted, match=f"joint_2 .*{words}"):
        made.wait(made.group.motion)
    assert made.now_us - lost_us[0] < (within_s + 0.3) * 1e6


def test_what_the_buffer_holds_is_told_from_the_books() -> None:
    made = bench(Epos2(1), Epos2(2))
    made.path.submit(there_and_back(4.0, joints=2), None, made.now_us)
    made.run(1.0)
    for _ in range(50):
        made.run(0.023)
        path_ms = made.machine.path_time.at_ms(made.now_us)
        for axis, drive in zip(made.machine.interpolated.axes, made.drives, strict=True):
            assert abs(axis.account.level(path_ms) - drive.buffer_level) <= 1


def test_a_drive_that_does_not_tell_its_free_records_does_not_start() -> None:
    made = bench(Epos2(1), Epos2(2))
    made.bus.drop = lambda can_id, data, source: can_id == 0x582
    made.path.submit(there_and_back(joints=2), None, made.now_us)
    with pytest.raises(MotionAborted, match=r"joint_2 \(node 2\)"):
        made.wait(made.group.motion)
    assert all(drive.ip_start_us != drive.ip_start_us for drive in made.drives)  # never


def test_a_drive_that_stops_telling_them_in_motion_is_a_warning_said_once() -> None:
    made = bench(*(Epos2(n, record=True) for n in (1, 2)))
    made.path.submit(there_and_back(4.0, joints=2), None, made.now_us)
    made.run(1.0)
    of_the_buffer = bytes.fromhex("43C46002")
    made.bus.drop = lambda can_id, data, source: can_id == 0x582 and data[:4] == of_the_buffer
    made.wait(made.group.motion)
    warnings = [event.text for event in made.events if event.kind == "warning"]
    assert warnings == ["joint_2 (node 2): does not answer"]
    assert made.group.phase is Phase.STANDING


# --- the clocks ---------------------------------------------------------------------------------


@BOTH
def test_a_clock_that_goes_wrong_in_motion_is_a_fault(dictionary: Dictionary) -> None:
    """Whether the dictionary lets a PDO carry the clock or not."""
    made = bench(*(Epos2(n, dictionary=dictionary) for n in (1, 2, 3)))
    made.path.submit(there_and_back(6.0, joints=3), None, made.now_us)
    made.run(2.0)
    made.drives[1]._on_timestamp(made.drives[1].clock.latched + 3_000)  # not the host's
    with pytest.raises(MotionAborted, match=r"joint_2 \(node 2\): its clock is off by \+3.0 ms"):
        made.wait(made.group.motion)
    assert made.group.phase is Phase.FAULT


def test_no_clock_is_sent_by_pdo_and_each_is_read_after_every_sync() -> None:
    made = bench(*(Epos2(n) for n in (1, 2)))
    made.frames.clear()
    made.run(2.05)
    syncs = [t for t, f, _ in made.frames if f.can_id == 0x080]
    for node in (1, 2):
        asked = [t for t, f, _ in made.frames if f.can_id == 0x600 + node]
        assert len(asked) == len(syncs)
        assert all(0 < t - sync < 5_000 for t, sync in zip(asked, syncs, strict=True))
    assert {len(f.data) for _, f, _ in made.frames if f.can_id in (0x481, 0x482)} == {8}


def test_a_clock_that_is_not_read_any_more_is_a_fault_before_it_can_be_far_off() -> None:
    """500 ppm is more than any quartz: 1 ms in 2 s."""
    made = bench(Epos2(1), Epos2(2))
    made.path.submit(there_and_back(8.0, joints=2), None, made.now_us)
    made.run(1.5)
    last_us = made.now_us
    made.bus.drop = lambda can_id, data, source: can_id == 0x582
    with pytest.raises(MotionAborted, match=r"joint_2 .*: its clock \(0x1013\) was not read for 2"):
        made.wait(made.group.motion)
    assert 1.9e6 < made.now_us - last_us < 3e6


def test_a_drive_that_can_t_send_its_clock_is_refused_as_clock_master() -> None:
    made = Bench(DriverConfig(axes=axes(2), sync_source="joint_2"), [Epos2(1), Epos2(2)], False)
    with pytest.raises(DriveError) as refusal:
        made.bring_up()
    assert str(refusal.value) == (
        "joint_2 (node 2) can't be the clock master: it can't send its clock (0x1013 can't be "
        "mapped into a TPDO, as by maxon's EDS of 2011 and later); set sync.source to host"
    )


# --- units --------------------------------------------------------------------------------------


@BOTH
@pytest.mark.parametrize("notation", [0, -1, -2, -3])
@pytest.mark.parametrize("rpm", [None, 249.0])
def test_velocity_units_as_fine_as_0x607f_lets_them_be(
    dictionary: Dictionary, notation: int, rpm: float | None
) -> None:
    """By maxon's EDS it holds 25,000 at most. Read so, it is a limit in units."""
    limit = None if rpm is None else rpm / 60 * 2 * np.pi / 100  # of a joint with a gear of 100
    config = DriverConfig(axes=axes(1, velocity_notation=notation, max_velocity=limit))
    drive = Epos2(1, dictionary=dictionary)
    made = Bench(config, [drive], bring_up=False)
    asked = rpm or 0
    if dictionary is Dictionary.MAKER and asked > 25_000 * 10.0**notation:
        with pytest.raises(DriveError) as refusal:
            made.bring_up()
        assert str(refusal.value).endswith(
            "the value is too high (0x06090031); check axes.joint_1.max_velocity and "
            "axes.joint_1.velocity_notation"
        )
    else:
        made.bring_up()
        made.enable()
        assert drive.dictionary[0x607F, 0].value >= asked * 10.0**-notation * (1 - 1e-9)


# --- the first record ---------------------------------------------------------------------------


@pytest.mark.parametrize("reading", list(FirstRecord))
def test_both_readings_of_the_first_record(reading: FirstRecord) -> None:
    """The path is the commanded one, at most a millisecond early, in both axes alike."""
    made = bench(*(Epos2(n, first_record=reading, record=True, lag_ms=0) for n in (1, 2)))
    early_ms = 1 if reading is FirstRecord.START else 0
    for _ in range(2):
        move(made)
        if not early_ms:
            assert_on_path(made)
        for axis, drive in enumerate(made.drives):
            t_ms, demand = executed(drive)
            half, reach = 1000.0, 0.3 * (1 - axis / 10) * 2000 * 100 / (2 * np.pi)
            t = np.clip(t_ms + early_ms - 1, 0, 2 * half)
            u = np.where(t < half, t, 2 * half - t) / half
            wanted = reach * (10 * u**3 - 15 * u**4 + 6 * u**5)
            assert np.abs(demand - wanted).max() <= 1.0
    assert [event.kind for event in made.events].count("done") == 2


# --- what real drives do ------------------------------------------------------------------------


def test_fresh_from_the_factory_and_operational() -> None:
    """All RPDOs valid, TPDO1 with the statusword alone, sent at every change."""
    drives = [Epos2(n, record=True) for n in (1, 2)]
    made = Bench(TWO, drives, bring_up=False)
    made.bus.host_send(0x000, b"\x01\x00")
    made.run(0.01)
    assert any(f.can_id == 0x182 and len(f.data) == 2 for _, f, _ in made.frames)
    made.bring_up()
    made.enable()
    move(made)
    assert_on_path(made)


def test_a_record_is_no_controlword_to_a_drive_that_has_restarted() -> None:
    """After a reset RPDO1 is the controlword again, on the very COB-ID of the records."""
    made = bench(Epos2(1), Epos2(2))
    made.path.submit(there_and_back(4.0, joints=2), None, made.now_us)
    made.run(1.0)
    made.drives[1].power_off()
    made.drives[1].power_on(made.now_us)
    with pytest.raises(MotionAborted, match=r"joint_2 \(node 2\) has restarted"):
        made.wait(made.group.motion)
    made.run(1.0)
    assert made.drives[1].status_word & 0x6F == 0x40  # switch on disabled
    made.bring_up_drive(1)
    made.group.start_clock(made.now_us, bytes(6))
    made.wait(made.group.reset_fault())
    made.enable()


def test_a_drive_that_has_to_detect_the_bit_rate() -> None:
    drives = [Epos2(1, frames_needed=4), Epos2(2, frames_needed=6)]
    made = Bench(TWO, drives, bring_up=False)
    made.bring_up()
    made.enable()
    assert made.group.phase is Phase.STANDING


def test_a_drive_that_is_starting_up_is_waited_for() -> None:
    drives = [Epos2(1), Epos2(2)]
    made = Bench(TWO, drives, bring_up=False)
    made.bus.host_send(0x000, b"\x81\x00")
    made.run(0.01)
    made.bring_up()
    made.enable()
    assert made.lost() == []


@pytest.mark.parametrize("dictionary", list(Dictionary))
def test_a_stored_no_action_on_a_silent_host_is_overwritten(dictionary: Dictionary) -> None:
    drives = [Epos2(n, dictionary=dictionary) for n in (1, 2)]
    drives[1].dictionary[0x6007, 0].value = 0
    made = Bench(TWO, drives)
    assert [drive.dictionary[0x6007, 0].value for drive in drives] == [3, 3]
    assert (0x6007, 0, 3) in downloads(made, 2)
    assert all(index != 0x6007 for index, _, _ in downloads(made, 1))  # it was as it has to be


@pytest.mark.parametrize("revision", [0x2100_0000, 0x2046_0000])
def test_firmware_without_interpolated_position_mode_is_refused(revision: int) -> None:
    made = Bench(TWO, [Epos2(1), Epos2(2, revision=revision)], bring_up=False)
    with pytest.raises(DriveError) as refusal:
        made.bring_up()
    assert str(refusal.value) == (
        f"joint_2 (node 2) has firmware {revision >> 16:04X}h, which has no interpolated position "
        "mode: it takes 2101h or higher; update it with EPOS Studio"
    )


@pytest.mark.parametrize("rpm", [3, 40, 470])
@pytest.mark.parametrize("error_qc", [0, -150])
def test_answers_to_sync_tell_the_velocity(rpm: int, error_qc: int) -> None:
    """0x606C is whole counts per ms, 30 rpm at 2000 qc per turn; positions 0.1 s apart tell 0.6."""
    drive = Bench(TWO).machine.drives[0]
    qc_s = rpm * 2000 / 60
    for n in range(10):
        drive.on_sync(1e5 * n)
        position = int(qc_s * n / 10)
        drive.on_pdo(0x481, struct.pack("<iHh", position + error_qc, 0x0637, error_qc), 1e5 * n + 9)
        assert drive.position_qc == position
    assert abs(drive.velocity_qc_s * 60 / 2000 - rpm) <= 0.6
    for n in range(10, 12):  # it rests
        drive.on_sync(1e5 * n)
        drive.on_pdo(0x481, struct.pack("<iHh", position + error_qc, 0x0637, error_qc), 1e5 * n + 9)
    assert drive.velocity_qc_s == 0.0


def test_a_following_error_that_may_be_any_larger_one_tells_no_position() -> None:
    """0x20F4 has 16 bits."""
    drive = Bench(TWO).machine.drives[0]
    drive.on_sync(1e5)
    drive.on_pdo(0x281, struct.pack("<iHh", 90_000, 0, 0), 1.1e5)
    for n, error_qc in ((2, -32_768), (3, 32_767)):
        drive.on_sync(1e5 * n)
        drive.on_pdo(0x481, struct.pack("<iHh", 0, 0x0637, error_qc), 1e5 * n + 500)
    assert drive.position_qc == 90_000


def test_free_records_are_read_from_the_answer_to_their_own_object_only() -> None:
    assert epos2.FREE_RECORDS.answered(bytes.fromhex("43C46002 3D000000")) == 61
    for other in ("43C46001 40000000", "4BC46002 40000000", "80C46002 00000206", "43C46002"):
        assert epos2.FREE_RECORDS.answered(bytes.fromhex(other)) is None
