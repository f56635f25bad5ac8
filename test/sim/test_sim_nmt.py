"""NMT, heartbeat, SYNC and EMCY of the simulated drive: CiA 301, 7.2.5 to 7.2.8, 7.3.2."""

from __future__ import annotations

import pytest
from sim_host import Abort, Host, prompt_drive

from epos2_ros.sim.epos2 import Epos2


@pytest.fixture
def drive() -> Epos2:
    return prompt_drive(1)


@pytest.fixture
def host(drive: Epos2) -> Host:
    return Host(drive)


# --- NMT --------------------------------------------------------------------------------


def test_boot_up_message(host: Host) -> None:
    assert host.heard(0x701) == [b"\x00"]


def states(host: Host) -> list[int]:
    return [data[0] for data in host.heard(0x701)]


def test_states_in_the_heartbeat(host: Host) -> None:
    host.write(0x1017, 0, 10, 2)
    host.run(20)
    assert states(host)[-1] == 0x7F
    for command, state in ((0x01, 0x05), (0x02, 0x04), (0x80, 0x7F)):
        host.nmt(command, 1)
        host.run(20)
        assert states(host)[-1] == state


def test_command_for_all_and_for_another(host: Host) -> None:
    host.write(0x1017, 0, 10, 2)
    host.nmt(0x01, 2)
    host.run(20)
    assert states(host)[-1] == 0x7F
    host.nmt(0x01, 0)
    host.run(20)
    assert states(host)[-1] == 0x05


@pytest.mark.parametrize("command", [0x81, 0x82])
def test_reset_boots_again_with_default_communication(host: Host, command: int) -> None:
    host.map(0x1800, 0x1A5, [0x6041_0010])
    host.write(0x1017, 0, 10, 2)
    host.nmt(0x01)
    host.nmt(command)
    host.run(50)
    assert states(host)[-1] == 0x00  # boot-up, then no heartbeat
    assert host.read(0x1017) == 0
    assert host.read(0x1800, 1) & 0x800007FF == 0x80000181
    assert host.read(0x1A00, 0) == 0


def test_reset_node_resets_the_application_too(host: Host) -> None:
    host.write(0x6065, 0, 77, 4)
    host.enable(1)
    host.nmt(0x82)
    assert host.read(0x6065) == 77
    assert host.status() & 0x6F == 0x27
    host.nmt(0x81)
    assert host.read(0x6065) == 2000
    assert host.status() & 0x6F == 0x40
    assert host.read(0x6061) == host.read(0x6060)


def test_malformed_command_is_ignored(host: Host) -> None:
    host.send(0x000, "01")
    host.send(0x000, "33 01")
    host.write(0x1017, 0, 10, 2)
    host.run(20)
    assert states(host)[-1] == 0x7F


# --- heartbeat --------------------------------------------------------------------------


def test_heartbeat_period(host: Host) -> None:
    host.write(0x1017, 0, 50, 2)
    host.run(501)
    times = [f.t_us for f in host.frames if f.can_id == 0x701][1:]
    assert len(times) >= 10
    for a, b in zip(times, times[1:], strict=False):
        assert b - a == pytest.approx(50_000, abs=200)


def test_lost_heartbeat_is_a_fault(host: Host) -> None:
    """0x1016: node 127, 100 ms. Watching begins with its first heartbeat (7.2.8.2.2.3)."""
    host.write(0x1016, 1, 127 << 16 | 100, 4)
    host.enable(1)
    host.run(300)
    assert host.heard(0x081) == []
    for _ in range(5):
        host.send(0x77F, "05", ms=90)
    assert host.heard(0x081) == []
    host.run(20)
    assert host.heard(0x081) == [bytes.fromhex("30 81 11 00 00 00 00 00")]
    host.run(10)
    assert host.status() & 0x4F == 0x08


def test_lost_heartbeat_is_watched_again(host: Host) -> None:
    host.write(0x1016, 1, 127 << 16 | 100, 4)
    host.send(0x77F, "05", ms=150)
    host.control(0x0080)
    host.run(200)
    assert len([e for e in host.heard(0x081) if e[:2] == b"\x30\x81"]) == 1
    host.send(0x77F, "05", ms=150)
    assert len([e for e in host.heard(0x081) if e[:2] == b"\x30\x81"]) == 2


def test_a_node_is_watched_once(host: Host) -> None:
    host.write(0x1016, 1, 127 << 16 | 100, 4)
    with pytest.raises(Abort) as abort:
        host.write(0x1016, 2, 127 << 16 | 200, 4)
    assert abort.value.code == 0x06040043
    host.write(0x1016, 1, 127 << 16 | 200, 4)
    host.write(0x1016, 2, 126 << 16 | 200, 4)


# --- SYNC -------------------------------------------------------------------------------


def test_sync_on_another_identifier(host: Host) -> None:
    host.map(0x1800, 0x181, [0x6041_0010], transmission=1)
    host.write(0x1005, 0, 0x90, 4)
    host.nmt(0x01)
    host.send(0x080)
    assert host.heard(0x181) == []
    host.send(0x090, ms=1)
    assert len(host.heard(0x181)) == 1


def test_sync_producer(host: Host, drive: Epos2) -> None:
    """0x1005 bit 30 and 0x1006 in µs; the producer latches its own SYNC."""
    host.write(0x1006, 0, 10_000, 4)
    host.run(30)
    assert host.heard(0x080) == []
    host.write(0x1005, 0, 1 << 30 | 0x80, 4)
    host.run(105)
    frames = [f for f in host.frames if f.can_id == 0x080]
    assert len(frames) == 10
    assert frames[-1].t_us - frames[0].t_us == pytest.approx(90_000, abs=100)
    with pytest.raises(Abort) as abort:
        host.write(0x1005, 0, 1 << 30 | 0x81, 4)  # not while producing
    assert abort.value.code == 0x08000022
    host.write(0x1005, 0, 0x80, 4)
    count = len(host.heard(0x080))
    last_us = [f.t_us for f in host.frames if f.can_id == 0x080][-1]
    host.run(50)
    assert len(host.heard(0x080)) == count
    assert host.read(0x1013) == int(last_us)


# --- EMCY -------------------------------------------------------------------------------


def test_emergency_message(host: Host, drive: Epos2) -> None:
    """Error code, error register, five manufacturer bytes (7.2.7.1)."""
    drive.fail(0x2310, host.bus.now_us)  # over-current: register bits 0 and 1
    host.run(2)
    assert host.heard(0x081) == [bytes.fromhex("10 23 03 00 00 00 00 00")]
    assert host.read(0x1001) == 0x03
    assert host.read(0x1003, 0) == 1
    assert host.read(0x1003, 1) == 0x2310


@pytest.mark.parametrize(
    ("code", "register"),
    # 7.5.2.2: generic, current, voltage, temperature, communication, profile, manufacturer
    [
        (0x1000, 0x01),
        (0x2310, 0x03),
        (0x3210, 0x05),
        (0x4210, 0x09),
        (0x8130, 0x11),
        (0x8611, 0x21),
        (0xFF0C, 0x81),
    ],
)
def test_error_register(host: Host, drive: Epos2, code: int, register: int) -> None:
    drive.fail(code, host.bus.now_us)
    host.run(2)
    assert host.heard(0x081)[0][2] == register


def test_history_keeps_the_newest_first(host: Host, drive: Epos2) -> None:
    codes = [0x2310, 0x3210, 0x3220, 0x4210, 0x7320, 0x8611]
    for code in codes:
        drive.fail(code, host.bus.now_us)
    host.run(2)
    assert host.read(0x1003, 0) == 5
    assert [host.read(0x1003, n) for n in range(1, 6)] == codes[:0:-1]
    host.write(0x1003, 0, 0, 1)
    assert host.read(0x1003, 0) == 0


def test_error_reset_is_announced(host: Host, drive: Epos2) -> None:
    drive.fail(0x3220, host.bus.now_us)
    host.run(5)
    host.control(0x0080)
    host.run(2)
    assert host.heard(0x081)[-1] == bytes(8)
    assert host.read(0x1001) == 0


def test_no_emergency_when_stopped_or_switched_off(host: Host, drive: Epos2) -> None:
    host.nmt(0x02)
    drive.fail(0x2310, host.bus.now_us)
    host.run(2)
    assert host.heard(0x081) == []


def test_emergency_identifier(host: Host, drive: Epos2) -> None:
    host.write(0x1014, 0, 1 << 31 | 0x81, 4)
    host.write(0x1014, 0, 0xA1, 4)
    drive.fail(0x2310, host.bus.now_us)
    host.run(2)
    assert len(host.heard(0x0A1)) == 1
    with pytest.raises(Abort):
        host.write(0x1014, 0, 0xA2, 4)


# --- cable and power --------------------------------------------------------------------


def test_disconnected_drive_neither_hears_nor_speaks(host: Host, drive: Epos2) -> None:
    host.write(0x1017, 0, 10, 2)
    drive.disconnect()
    count = len(host.heard(0x701))
    host.nmt(0x81)
    host.run(50)
    assert len(host.heard(0x701)) == count
    drive.reconnect()
    host.run(20)
    assert states(host)[-1] == 0x7F  # it never heard the reset


def test_power_cycle_boots(host: Host, drive: Epos2) -> None:
    host.write(0x1017, 0, 10, 2)
    drive.power_off()
    host.run(100)
    count = len(host.heard(0x701))
    drive.power_on(host.bus.now_us)
    host.run(1)
    assert host.heard(0x701)[count:] == [b"\x00"]
    assert host.read(0x1017) == 0
