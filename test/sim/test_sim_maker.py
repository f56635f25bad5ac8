"""The simulated EPOS2 with its maker's dictionary: against maxon's own tables, and on the bus."""

from __future__ import annotations

import pytest
from makers import Fact, facts
from sim_host import Abort, Host

from epos2_ros.sim.cia402 import Delays
from epos2_ros.sim.epos2 import Dictionary, Epos2, FirstRecord

NODE = 5
NO_OBJECT, NO_SUBINDEX, NOT_MAPPABLE = 0x06020000, 0x06090011, 0x06040041
STORE = 0x08000020


@pytest.fixture
def host() -> Host:
    return Host(Epos2(1))


def refused(host: Host, index: int, subindex: int, value: int, size: int) -> int:
    with pytest.raises(Abort) as abort:
        host.write(index, subindex, value, size)
    return abort.value.code


# --- against the tables -----------------------------------------------------------------------


def offered(fact: Fact) -> bool:
    """What maxon calls internal is for its own tools; it is not simulated."""
    return fact.subindex == 0 or not fact.name.startswith("Internal")


def test_every_object_is_as_in_the_makers_table() -> None:
    """Software 2126h, the newest met: type, access, default, range and PDO mapping."""
    simulated = dict(Epos2(NODE).dictionary.items())
    checked = 0
    for fact in facts("epos2_70_10_2126.csv", NODE):
        entry = simulated.pop((fact.index, fact.subindex), None)
        if entry is None:
            assert not offered(fact) or "Internal" in fact.name, f"{fact.key} {fact.name}"
            continue
        assert (entry.type.size, entry.type.signed) == (fact.size, fact.signed), fact.key
        assert entry.access.replace("const", "ro") == fact.access.replace("const", "ro"), fact.key
        assert entry.mappable == fact.mappable, fact.key
        if fact.default is not None:
            assert entry.default == fact.default, fact.key
        if fact.limits is not None:
            assert (entry.low, entry.high) == fact.limits, fact.key
        checked += 1
    assert not simulated, "objects that the maker does not have"
    assert checked > 300


@pytest.mark.parametrize("file", ["epos2_50_5_2120.csv", "epos2_70_10_2122.csv"])
def test_what_the_driver_needs_is_alike_in_all_versions(file: str) -> None:
    """Types and the PDOs; the accesses of 2007 (rw, rwr) became rww later."""
    simulated = dict(Epos2(NODE).dictionary.items())
    common = 0
    for fact in facts(file, NODE):
        entry = simulated.get((fact.index, fact.subindex))
        if entry is None or fact.index == 0x2070:  # inputs differ with the hardware
            continue
        assert (entry.type.size, entry.type.signed) == (fact.size, fact.signed), fact.key
        assert entry.mappable == fact.mappable, fact.key
        assert (entry.access in ("ro", "const")) == (fact.access in ("ro", "const")), fact.key
        common += 1
    assert common > 300


# --- what is refused, and with which abort code -------------------------------------------------


@pytest.mark.parametrize("index", [0x1006, 0x1009, 0x100A, 0x605A, 0x605D])
def test_objects_that_do_not_exist(host: Host, index: int) -> None:
    with pytest.raises(Abort) as abort:
        host.read(index)
    assert abort.value.code == NO_OBJECT
    assert refused(host, index, 0, 0, 2) == NO_OBJECT


def test_tpdos_have_no_event_timer(host: Host) -> None:
    assert host.read(0x1800, 0) == 3
    for subindex in (4, 5):
        assert refused(host, 0x1800, subindex, 0, 2) == NO_SUBINDEX


def test_free_records_can_t_be_mapped_but_buffer_clear_can(host: Host) -> None:
    host.write(0x1800, 1, 0xC000_0181, 4)
    host.write(0x1A00, 0, 0, 1)
    assert refused(host, 0x1A00, 1, 0x60C4_0220, 4) == NOT_MAPPABLE
    host.write(0x1400, 1, 0xC000_0201, 4)
    host.write(0x1600, 0, 0, 1)
    host.write(0x1600, 1, 0x60C4_0608, 4)


@pytest.mark.parametrize("dictionary", list(Dictionary))
def test_time_stamp_in_a_tpdo(dictionary: Dictionary) -> None:
    """The EDS of 2013 has 0x1013 for reception only, the note maps it into the master's TPDO."""
    host = Host(Epos2(1, dictionary=dictionary))
    host.write(0x1802, 1, 0xC000_0381, 4)
    host.write(0x1A02, 0, 0, 1)
    if dictionary is Dictionary.NOTE:
        host.write(0x1A02, 1, 0x1013_0020, 4)
    else:
        assert refused(host, 0x1A02, 1, 0x1013_0020, 4) == NOT_MAPPABLE
    host.write(0x1402, 1, 0xC000_0401, 4)
    host.write(0x1602, 0, 0, 1)
    host.write(0x1602, 1, 0x1013_0020, 4)


@pytest.mark.parametrize("transmission", [1, 255])
@pytest.mark.parametrize("record", [0x1401, 0x1801])
def test_transmission_types(host: Host, record: int, transmission: int) -> None:
    host.write(record, 2, transmission, 1)


@pytest.mark.parametrize("transmission", [0, 2, 240, 252, 254])
@pytest.mark.parametrize("record", [0x1401, 0x1801])
def test_transmission_types_that_it_has_not(host: Host, record: int, transmission: int) -> None:
    assert refused(host, record, 2, transmission, 1) == 0x06090030


def test_sync_is_fixed(host: Host) -> None:
    host.write(0x1005, 0, 0x80, 4)
    assert refused(host, 0x1005, 0, 0x4000_0080, 4) == 0x06090030


# --- fresh from the factory ---------------------------------------------------------------------


def test_a_fresh_drive_takes_controlwords_at_200h_and_tells_its_state() -> None:
    host = Host(Epos2(3))
    host.nmt(0x01)
    assert host.heard(0x183) == [b"\x40\x03"]  # statusword alone: two bytes
    host.send(0x203, "06 00", ms=2)
    assert host.heard(0x183)[-1] == b"\x21\x03"
    host.send(0x303, "06 00 07", ms=2)
    assert host.read(0x6061, node=3) == 7
    host.send(0x403, "06 00 10 00 00 00", ms=2)
    assert host.read(0x607A, node=3) == 16


def test_a_pdo_of_another_length_is_an_error(host: Host) -> None:
    host.nmt(0x01)
    host.send(0x301, "06 00", ms=2)
    assert host.heard(0x081)[-1][:2] == b"\x10\x82"


# --- the time that it takes ---------------------------------------------------------------------


def test_boot_up_is_a_quarter_of_a_second_after_a_reset(host: Host) -> None:
    before_us = host.bus.now_us
    host.nmt(0x81)
    host.run(200)
    assert len(host.heard(0x701)) == 1  # the one at power-on
    host.send(0x601, "40 00 10 00 00 00 00 00", ms=2)
    assert host.heard(0x581) == []
    host.run(100)
    boot_us = [frame.t_us for frame in host.frames if frame.can_id == 0x701][-1]
    assert 262e3 <= boot_us - before_us <= 264e3
    assert host.read(0x1000) == 0x0002_0192


def test_first_enabling_refreshes_and_measures_later_ones_only_refresh(host: Host) -> None:
    host.nmt(0x01)

    def states() -> list[str]:
        host.control(0x06)
        start = len(host.frames)
        host.control(0x0F)
        host.run_until(lambda: host.status() & 0x6F == 0x27, 500)
        told = [f.data[::-1].hex() for f in host.frames[start:] if f.can_id == 0x181]
        return [word for word in told if word not in ("0321",)]

    assert states() == ["4323", "4333", "0737"]  # remote is bit 9, target reached bit 10
    host.control(0x00)
    assert states()[-2:] == ["4323", "0737"]
    host.nmt(0x81)
    host.run(300)
    host.nmt(0x01)
    assert states() == ["4323", "4333", "0737"]


def test_power_is_taken_away_while_it_measures(host: Host) -> None:
    host.control(0x06)
    host.control(0x0F)
    host.run(50)
    assert host.status() & 0xF0FF == 0x4033
    host.control(0x00)
    host.run(500)
    assert host.status() & 0x6F == 0x40


def test_a_fault_reset_takes_a_while(host: Host) -> None:
    host.bus.drives[0].fail(0x2310)  # type: ignore[attr-defined]
    host.control(0x80)
    assert host.status() & 0x4F == 0x08
    host.run(30)
    assert host.status() & 0x4F == 0x40


def test_a_drive_that_detects_the_bit_rate_needs_to_hear_frames() -> None:
    host = Host(Epos2(1, frames_needed=3))
    host.run(1000)
    assert host.heard(0x701) == []
    for _ in range(3):
        host.send(0x000, "80 00")
    host.run(300)
    assert host.heard(0x701) == [b"\0"]
    assert host.read(0x1000) == 0x0002_0192


def test_velocity_comes_in_steps_of_a_count_per_millisecond() -> None:
    host = Host(Epos2(1, counts_per_turn=4096, lag_ms=0, delays=Delays()))
    host.prepare_ip()
    host.feed((100, 366, 100), (2600, 366, 100), (5000, 0, 100), (5000, 0, 0))
    host.control(0x001F)
    seen = set()
    for _ in range(250):
        seen.add(host.read(0x606C, signed=True))
    step_rpm = 60e3 / 4096
    assert len(seen) > 10
    assert all(abs(rpm / step_rpm - round(rpm / step_rpm)) < 0.04 for rpm in seen)


# --- the host that falls silent -----------------------------------------------------------------


@pytest.mark.parametrize(("option", "state"), [(3, 0x08), (0, 0x27)])
def test_what_a_silent_host_means_is_stored_in_the_drive(option: int, state: int) -> None:
    host = Host(Epos2(1, delays=Delays()))
    host.write(0x6007, 0, option, 2)
    host.write(0x1010, 1, 0x65766173, 4)
    host.nmt(0x81)
    host.run(1)
    assert host.read(0x6007) == option
    host.enable(7)
    host.write(0x1016, 1, 127 << 16 | 100, 4)
    host.send(0x77F, "05", ms=300)
    assert host.heard(0x081)[-1][:2] == b"\x30\x81"
    assert host.status() & (0x4F if state == 0x08 else 0x6F) == state


def test_storing_takes_its_signature_and_restoring_a_reset(host: Host) -> None:
    host.write(0x6065, 0, 1234, 4)
    assert refused(host, 0x1010, 1, 1, 4) == STORE
    host.write(0x1010, 1, 0x65766173, 4)
    host.write(0x1011, 1, 0x64616F6C, 4)
    assert host.read(0x6065) == 1234
    host.nmt(0x81)
    host.run(300)
    assert host.read(0x6065) == 2000


# --- the first record ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("reading", "before_ms"), [(FirstRecord.SEGMENT, 1), (FirstRecord.START, 0)]
)
def test_a_first_record_that_holds_moves_nothing(reading: FirstRecord, before_ms: int) -> None:
    """1 ms at the standing position: the path is the same, at most a millisecond earlier."""
    drive = Epos2(1, first_record=reading, lag_ms=0, record=True, delays=Delays())
    host = Host(drive)
    host.prepare_ip()
    host.feed((0, 0, 1), (500, 225, 100), (1000, 0, 100), (1000, 0, 0))
    host.control(0x001F)
    host.run(400)
    executed = dict(drive.executed)
    u = [k / 200 for k in range(201)]
    wanted = [1000 * (3 * x**2 - 2 * x**3) for x in u]
    assert [executed[k + before_ms] for k in range(201)] == pytest.approx(wanted, abs=0.01)
    assert not drive.ip_active


def test_a_start_point_elsewhere_jumps() -> None:
    """Why the first record has to be where the axis stands."""
    drive = Epos2(1, first_record=FirstRecord.START, lag_ms=5, delays=Delays())
    host = Host(drive)
    host.prepare_ip()
    host.feed((5000, 0, 100), (5100, 0, 100), (5100, 0, 100), (5100, 0, 0))
    host.control(0x001F)
    host.run(5)
    assert host.heard(0x081)[-1][:2] == b"\x11\x86"  # following error
