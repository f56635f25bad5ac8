"""The state machine of the simulated drive: CiA 402, device control.

Status words are those of the EPOS2: besides the bits CiA 402 decodes (mask 0x6F) bit 8 is
always set, bit 4 while the power stage is on, bit 9 in NMT operational.
"""

from __future__ import annotations

import pytest
from sim_host import Host, prompt_drive

from epos2_ros.sim.epos2 import Epos2

SWITCH_ON_DISABLED, READY, SWITCHED_ON, ENABLED = 0x0140, 0x0121, 0x0123, 0x0137
QUICK_STOP, FAULT = 0x0117, 0x0108
STATE_BITS = 0x017F
SHUTDOWN, SWITCH_ON, ENABLE, DISABLE_VOLTAGE, STOP, RESET = 0x06, 0x07, 0x0F, 0x00, 0x02, 0x80
PATHS = {
    SWITCH_ON_DISABLED: [],
    READY: [SHUTDOWN],
    SWITCHED_ON: [SHUTDOWN, SWITCH_ON],
    ENABLED: [SHUTDOWN, SWITCH_ON, ENABLE],
    QUICK_STOP: [SHUTDOWN, SWITCH_ON, ENABLE, STOP],
}


@pytest.fixture
def drive() -> Epos2:
    return prompt_drive(1)


@pytest.fixture
def host(drive: Epos2) -> Host:
    return Host(drive)


def state(host: Host) -> int:
    host.run(5)
    return host.status() & STATE_BITS


@pytest.mark.parametrize("start", PATHS, ids=hex)
@pytest.mark.parametrize(
    ("command", "ends"),
    [
        # by command: what each state of PATHS becomes (CiA 402, state transitions 2–12 and 16)
        (SHUTDOWN, [READY, READY, READY, READY, QUICK_STOP]),
        (SWITCH_ON, [SWITCH_ON_DISABLED, SWITCHED_ON, SWITCHED_ON, SWITCHED_ON, QUICK_STOP]),
        (ENABLE, [SWITCH_ON_DISABLED, ENABLED, ENABLED, ENABLED, ENABLED]),
        (DISABLE_VOLTAGE, [SWITCH_ON_DISABLED] * 5),
        (STOP, [SWITCH_ON_DISABLED, SWITCH_ON_DISABLED, SWITCH_ON_DISABLED, QUICK_STOP,
                QUICK_STOP]),
        (RESET, [SWITCH_ON_DISABLED] * 5),  # also a disable voltage: bit 1 is 0
    ],
    ids=["shutdown", "switch on", "enable operation", "disable voltage", "quick stop", "reset"],
)  # fmt: skip
def test_transitions(host: Host, start: int, command: int, ends: list[int]) -> None:
    for word in PATHS[start]:
        host.control(word)
    assert state(host) == start
    host.control(command)
    assert state(host) == ends[list(PATHS).index(start)]


@pytest.mark.parametrize("start", PATHS, ids=hex)
def test_fault_from_every_state(host: Host, drive: Epos2, start: int) -> None:
    for word in PATHS[start]:
        host.control(word)
    drive.fail(0x3220, host.bus.now_us)
    assert state(host) == FAULT
    for word in (SHUTDOWN, SWITCH_ON, ENABLE):
        host.control(word)
        assert state(host) == FAULT
    host.control(RESET)
    assert state(host) == SWITCH_ON_DISABLED


def test_fault_reset_needs_a_rising_edge(host: Host, drive: Epos2) -> None:
    host.control(RESET)  # bit 7 is set already when the fault comes
    drive.fail(0x3220, host.bus.now_us)
    host.control(RESET)
    assert state(host) == FAULT
    host.control(0)
    host.control(RESET)
    assert state(host) == SWITCH_ON_DISABLED


def test_remote_bit_tells_nmt_operational(host: Host) -> None:
    assert not host.status() & 1 << 9
    host.nmt(0x01)
    assert host.status() & 1 << 9


def moving(host: Host) -> None:
    """100 ms into a move at 1000 rpm, 33.3 qc/ms."""
    host.enable(1)
    host.write(0x607A, 0, 1_000_000, 4)
    host.control(0x001F)
    host.run(150)
    assert host.read(0x606C, signed=True) == pytest.approx(1000, abs=15)


@pytest.mark.parametrize(
    ("command", "ramp", "end"),
    [
        (STOP, 0x6085, QUICK_STOP),  # quick stop ramp
        (SWITCH_ON, 0x6084, SWITCHED_ON),  # disable operation: slow down first
        (0x010F, 0x6084, ENABLED),  # halt
    ],
)
def test_ramps(host: Host, command: int, ramp: int, end: int) -> None:
    """From 1000 rpm with 5000 rpm/s: 0.2 s and 1000·2000/60 · 0.2/2 = 3333 qc."""
    host.write(ramp, 0, 5000, 4)
    moving(host)
    start = host.read(0x6062, signed=True)
    host.control(command)
    host.run(150)
    assert host.read(0x606C, signed=True) > 150
    assert not host.status() & 1 << 10
    host.run(100)
    assert state(host) == end
    assert host.read(0x606C, signed=True) == 0
    distance = host.read(0x6064, signed=True) - start
    assert distance == pytest.approx(3333 + 33.3, abs=40)  # 1 ms passes before the answer
    if end != SWITCHED_ON:
        assert host.status() & 1 << 10


def test_fault_reaction_slows_down_before_the_fault(host: Host, drive: Epos2) -> None:
    """State "fault reaction active", power stage on: 0x011F (0x0F under CiA 402's mask)."""
    moving(host)
    drive.fail(0x4210, host.bus.now_us)
    assert host.status() & STATE_BITS == 0x011F
    host.run(60)
    assert 0 < host.read(0x606C, signed=True) < 1000
    host.control(RESET)  # too early
    assert host.status() & STATE_BITS == 0x011F
    host.run(60)
    assert state(host) == FAULT
    assert host.read(0x606C, signed=True) == 0


def test_disable_voltage_while_moving_switches_off_at_once(host: Host) -> None:
    moving(host)
    host.control(DISABLE_VOLTAGE)
    assert host.status() & STATE_BITS == SWITCH_ON_DISABLED
    assert host.read(0x6062, signed=True) == host.read(0x6064, signed=True)


def test_blocked_rotor_is_a_following_error(host: Host, drive: Epos2) -> None:
    """2000 qc at 33.3 qc/ms are passed within 0.1 s: EMCY 0x8611, bit 13 in profile position."""
    moving(host)
    drive.block_rotor()
    host.run(90)
    assert host.heard(0x081) == [bytes.fromhex("11 86 21 00 00 00 00 00")]
    host.run(200)
    assert state(host) == FAULT
    assert host.status() & 1 << 13
    drive.block_rotor(False)
    host.control(RESET)
    assert host.status() & STATE_BITS == SWITCH_ON_DISABLED
    assert not host.status() & 1 << 13


def test_following_error_is_seen_before_it_is_too_large(host: Host, drive: Epos2) -> None:
    moving(host)
    drive.block_rotor()
    host.run(30)
    error = host.read(0x20F4, signed=True)
    assert error == pytest.approx(1050, abs=120)
    demand, actual = host.read(0x6062, signed=True), host.read(0x6064, signed=True)
    assert 0 <= demand - actual - error < 100  # it was read up to 2 ms later


def test_current_follows_acceleration(host: Host) -> None:
    host.enable(1)
    host.write(0x607A, 0, 1_000_000, 4)
    host.control(0x001F)
    host.run(50)
    assert host.read(0x6078, signed=True) > 50
    assert host.read(0x2027, signed=True) == pytest.approx(host.read(0x6078, signed=True), rel=0.2)
    host.run(200)
    assert host.read(0x6078, signed=True) == 0
    assert host.read(0x2027, signed=True) == 0
