"""PDOs of the simulated drive: CiA 301, 7.2.2 and 7.5.2.35 to 7.5.2.38."""

from __future__ import annotations

import pytest
from sim_host import Abort, Host, prompt_drive, pvt

from epos2_ros.sim.epos2 import Epos2

INVALID = 1 << 31
NOT_MAPPABLE, TOO_LONG, STATE, RANGE = 0x06040041, 0x06040042, 0x08000022, 0x06090030


@pytest.fixture
def drive() -> Epos2:
    return prompt_drive(1)


@pytest.fixture
def host(drive: Epos2) -> Host:
    return Host(drive)


def refused(host: Host, index: int, subindex: int, value: int, size: int) -> int:
    with pytest.raises(Abort) as abort:
        host.write(index, subindex, value, size)
    return abort.value.code


# --- configuration ----------------------------------------------------------------------


@pytest.mark.parametrize("number", range(4))
def test_predefined_connection_set(host: Host, number: int) -> None:
    """7.3.5: RPDO n on 0x100 + 0x100·n + node, TPDO n on 0x80 + 0x100·n + node."""
    assert host.read(0x1400 + number, 1) & 0x7FF == 0x201 + 0x100 * number
    assert host.read(0x1800 + number, 1) & 0x7FF == 0x181 + 0x100 * number
    assert host.read(0x1400 + number, 0) == 2
    assert host.read(0x1800 + number, 0) == 3


@pytest.mark.parametrize("index", [0x1404, 0x1604, 0x1804, 0x1A04])
def test_four_pdos_each_way(host: Host, index: int) -> None:
    with pytest.raises(Abort) as abort:
        host.read(index, 0)
    assert abort.value.code == 0x06020000


def test_cob_id_is_fixed_while_valid(host: Host) -> None:
    host.write(0x1400, 1, 0x201, 4)
    assert refused(host, 0x1400, 1, 0x202, 4) == RANGE
    host.write(0x1400, 1, INVALID | 0x202, 4)
    host.write(0x1400, 1, 0x202, 4)
    assert host.read(0x1400, 1) == 0x202


@pytest.mark.parametrize(
    "can_id",
    # 7.3.5, table 40: NMT, reserved, default SDO, NMT error control
    [0x000, 0x001, 0x07F, 0x101, 0x180, 0x581, 0x5FF, 0x601, 0x67F, 0x6E0, 0x701, 0x77F, 0x7FF],
)
def test_restricted_identifiers(host: Host, can_id: int) -> None:
    assert refused(host, 0x1800, 1, can_id, 4) == RANGE


def test_no_extended_identifiers(host: Host) -> None:
    assert refused(host, 0x1800, 1, INVALID | 1 << 29 | 0x181, 4) == RANGE


@pytest.mark.parametrize("transmission", [1, 240, 254, 255])
@pytest.mark.parametrize("index", [0x1400, 0x1800])
def test_transmission_types(host: Host, index: int, transmission: int) -> None:
    host.write(index, 2, transmission, 1)
    assert host.read(index, 2) == transmission


@pytest.mark.parametrize("transmission", [0, 241, 251, 252])
@pytest.mark.parametrize("index", [0x1400, 0x1800])
def test_types_that_do_not_exist(host: Host, index: int, transmission: int) -> None:
    assert refused(host, index, 2, transmission, 1) == RANGE


def test_remote_request_type_is_for_transmission_only(host: Host) -> None:
    host.write(0x1800, 2, 253, 1)
    assert refused(host, 0x1400, 2, 253, 1) == RANGE


def test_inhibit_time_is_fixed_while_valid(host: Host) -> None:
    host.write(0x1800, 3, 50, 2)
    host.write(0x1800, 1, 0x181, 4)
    assert refused(host, 0x1800, 3, 60, 2) == STATE
    assert host.read(0x1800, 3) == 50


def test_mapping_changes_only_while_invalid_and_empty(host: Host) -> None:
    host.write(0x1A00, 1, 0x60410010, 4)
    host.write(0x1A00, 0, 1, 1)
    assert refused(host, 0x1A00, 1, 0x60640020, 4) == STATE
    host.write(0x1800, 1, 0x181, 4)
    assert refused(host, 0x1A00, 0, 0, 1) == STATE
    assert refused(host, 0x1A00, 1, 0x60640020, 4) == STATE
    host.write(0x1800, 1, INVALID | 0x181, 4)
    host.write(0x1A00, 0, 0, 1)
    host.write(0x1A00, 1, 0x60640020, 4)
    host.write(0x1A00, 0, 1, 1)


@pytest.mark.parametrize(
    ("mapping", "entry", "code"),
    [
        (0x1600, 0x6040_0008, NOT_MAPPABLE),  # 16 bits, not 8
        (0x1600, 0x6041_0010, NOT_MAPPABLE),  # the status word is not received
        (0x1A00, 0x20C1_0040, NOT_MAPPABLE),  # a record is not sent
        (0x1600, 0x60C4_0608, NOT_MAPPABLE),  # buffer clear: "PDO Mapping No"
        (0x1600, 0x20C4_0210, NOT_MAPPABLE),  # a warning level neither
        (0x1A00, 0x5000_0020, 0x06020000),
        (0x1A00, 0x20C4_0910, 0x06090011),
    ],
)
def test_what_can_t_be_mapped(host: Host, mapping: int, entry: int, code: int) -> None:
    assert refused(host, mapping, 1, entry, 4) == code


def test_at_most_eight_bytes(host: Host) -> None:
    host.write(0x1600, 1, 0x20C1_0040, 4)
    host.write(0x1600, 2, 0x6040_0010, 4)
    assert refused(host, 0x1600, 0, 2, 1) == TOO_LONG
    assert host.read(0x1600, 0) == 0
    host.write(0x1600, 0, 1, 1)


def test_at_most_eight_entries(host: Host) -> None:
    with pytest.raises(Abort):
        host.write(0x1600, 0, 9, 1)


def test_entry_that_was_never_written_does_not_count(host: Host) -> None:
    host.write(0x1A00, 1, 0x60410010, 4)
    with pytest.raises(Abort):
        host.write(0x1A00, 0, 2, 1)


# --- reception --------------------------------------------------------------------------


def test_asynchronous_rpdo_counts_at_once(host: Host) -> None:
    host.map(0x1400, 0x201, [0x6040_0010])
    host.nmt(0x01)
    host.send(0x201, "06 00")
    assert host.status() & 0x6F == 0x21


def test_synchronous_rpdo_counts_at_the_next_sync_once(host: Host) -> None:
    host.map(0x1400, 0x201, [0x6040_0010], transmission=1)
    host.nmt(0x01)
    host.send(0x201, "06 00")
    assert host.status() & 0x6F == 0x40
    host.sync()
    assert host.status() & 0x6F == 0x21
    host.control(0x0000)
    host.sync()  # the data was used up by the first
    assert host.status() & 0x6F == 0x40


def test_last_data_before_the_sync_wins(host: Host) -> None:
    host.map(0x1400, 0x201, [0x607A_0020], transmission=1)
    host.nmt(0x01)
    host.send(0x201, "01 00 00 00")
    host.send(0x201, "02 00 00 00")
    host.sync()
    assert host.read(0x607A) == 2


def test_several_objects_in_one_rpdo(host: Host) -> None:
    host.map(0x1402, 0x401, [0x607A_0020, 0x6081_0020])
    host.nmt(0x01)
    host.send(0x401, "FE FF FF FF 10 27 00 00")
    assert host.read(0x607A, signed=True) == -2
    assert host.read(0x6081) == 10_000


def test_no_pdo_before_operational(host: Host) -> None:
    host.map(0x1400, 0x201, [0x6040_0010])
    host.send(0x201, "06 00")
    assert host.status() & 0x6F == 0x40


def test_short_rpdo_is_an_error(host: Host) -> None:
    """EMCY 0x8210, and nothing of the frame is used."""
    host.prepare_ip()
    host.send(0x201, pvt(1, 0, 10)[:7])
    assert host.heard(0x081)[-1][:2] == b"\x10\x82"
    assert host.read(0x60C4, 4) == 0


def test_longer_rpdo_is_cut(host: Host) -> None:
    host.map(0x1400, 0x201, [0x6040_0010])
    host.nmt(0x01)
    host.send(0x201, "06 00 FF FF")
    assert host.status() & 0x6F == 0x21
    assert host.heard(0x081) == []


def test_two_drives_share_an_identifier() -> None:
    """As the time stamp 0x1013 does in the note's "Motion Synchronisation"."""
    host = Host(prompt_drive(1), prompt_drive(2))
    for node in (1, 2):
        host.map(0x1402, 0x155 + 0x100, [0x607A_0020], node=node)
    host.nmt(0x01)
    host.send(0x255, "07 00 00 00")
    assert [host.read(0x607A, node=node) for node in (1, 2)] == [7, 7]


# --- transmission -----------------------------------------------------------------------


def test_event_driven_tpdo_sends_on_change(host: Host) -> None:
    host.map(0x1800, 0x181, [0x6041_0010])
    host.nmt(0x01)
    host.run(50)
    assert host.heard(0x181) == [b"\x40\x03"]  # once on becoming operational (bit 9: remote)
    host.control(0x0006)
    host.run(50)
    assert host.heard(0x181)[1:] == [b"\x21\x03"]
    host.control(0x0006)  # no change, no frame
    host.run(50)
    assert len(host.heard(0x181)) == 2


def test_inhibit_time_spaces_the_frames_and_keeps_the_last_value(host: Host) -> None:
    """0x1800-03 in 100 µs: 100 are 10 ms."""
    host.map(0x1800, 0x181, [0x6041_0010], inhibit=100)
    host.nmt(0x01)
    host.run(20)
    for word in (0x06, 0x07, 0x06, 0x00):
        host.control(word)
    host.run(50)
    frames = [f for f in host.frames if f.can_id == 0x181]
    assert [f.data for f in frames] == [b"\x40\x03", b"\x21\x03", b"\x40\x03"]
    assert frames[2].t_us - frames[1].t_us > 9_800  # a frame may wait for the bus, once


def test_position_is_sent_at_the_inhibit_rate_while_it_changes(host: Host) -> None:
    host.map(0x1801, 0x281, [0x6064_0020, 0x606C_0020], inhibit=200)
    host.prepare_ip()
    host.feed((3000, 900, 100), (6000, 900, 100), (9000, 0, 100), (9000, 0, 0))
    host.control(0x001F)
    host.run(400)
    times = [f.t_us for f in host.frames if f.can_id == 0x281][1:]
    gaps = [b - a for a, b in zip(times, times[1:], strict=False)]
    assert min(gaps) >= 19_900
    assert sorted(gaps)[len(gaps) // 2] == pytest.approx(20_000, abs=150)
    assert host.heard(0x281)[-1] == bytes.fromhex("28 23 00 00 00 00 00 00")  # 9000, at rest


def test_synchronous_tpdo_sends_at_every_nth_sync(host: Host) -> None:
    host.map(0x1800, 0x181, [0x6041_0010], transmission=3)
    host.nmt(0x01)
    counts = []
    for _ in range(6):
        host.sync()
        counts.append(len(host.heard(0x181)))
    assert counts == [0, 0, 1, 1, 1, 2]


def test_clock_master(host: Host, drive: Epos2) -> None:
    """0x1013 in a synchronous TPDO: the time of the very SYNC that asked for it."""
    host.map(0x1802, 0x255, [0x1013_0020], transmission=1)
    host.nmt(0x01)
    host.run(100)
    t_us = host.sync(ms=2)
    assert int.from_bytes(host.heard(0x255)[-1], "little") == int(t_us)
    assert host.read(0x1013) == int(t_us)


def test_free_buffer_size_and_status_in_one_tpdo(host: Host) -> None:
    """The mapping of the note's 3.7, with 0x60C4-02: 8 bytes."""
    host.map(0x1800, 0x181, [0x6041_0010, 0x20C4_0110, 0x60C4_0220], inhibit=50)
    host.prepare_ip()
    host.run(10)
    assert host.heard(0x181)[-1].hex() == "3707" "0140" "40000000"
    host.feed((10, 0, 10))
    host.run(10)
    assert host.heard(0x181)[-1].hex() == "3707" "0140" "3f000000"


def test_remote_request(drive: Epos2, host: Host) -> None:
    host.map(0x1800, 0x181, [0x6041_0010], transmission=253)
    host.nmt(0x01)
    host.run(10)
    assert host.heard(0x181) == []
    drive.receive(0x181, b"", host.bus.now_us, remote=True)
    host.run(1)
    assert host.heard(0x181) == [b"\x40\x03"]
