"""Profile position and homing mode of the simulated drive (CiA 402)."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from sim_host import Abort, Host, prompt_drive

from epos2_ros.sim import profile
from epos2_ros.sim.epos2 import Epos2
from epos2_ros.sim.homing import Switches

REACHED, ACKNOWLEDGE, ATTAINED, ERROR = 1 << 10, 1 << 12, 1 << 12, 1 << 13

velocities = st.floats(-50, 50)
positions = st.integers(-100_000, 100_000)
positive = st.floats(0.001, 2.0)


@given(positions, velocities, positions, st.floats(0.5, 40), positive, positive)
def test_trapezoid_is_continuous_and_within_its_limits(
    start: int, velocity: float, target: int, speed: float, up: float, down: float
) -> None:
    """Checked on a fine grid by differences: it ends at rest on the target."""
    curve = profile.trapezoid(start, velocity, target, speed, up, down)
    assert curve.at(0.0) == (start, velocity)
    end = curve.duration_ms
    assert curve.at(end) == (target, 0.0)
    steps = 400
    dt = max(end, 1e-6) / steps
    samples = [curve.at(dt * n) for n in range(steps + 1)]
    top = max(speed, abs(velocity)) + 1e-6
    size = max(abs(start), abs(target), top * end, 1.0)
    for (p0, v0), (p1, v1) in zip(samples, samples[1:], strict=False):
        assert abs(v1) <= top
        assert abs(v1 - v0) <= (max(up, down) + 1e-6) * dt + 1e-6
        assert abs(p1 - p0) <= top * dt + 1e-9 * size


def test_trapezoid_takes_the_least_time() -> None:
    """33.3 qc/ms and 1/3 qc/ms²: 100 ms up, 100 ms down, 3333.3 qc each; 10,000 qc: 400 ms."""
    curve = profile.trapezoid(0, 0, 10_000, 100 / 3, 1 / 3, 1 / 3)
    assert curve.duration_ms == pytest.approx(400)
    assert curve.at(100)[0] == pytest.approx(5000 / 3)
    assert curve.at(200) == (pytest.approx(5000), pytest.approx(100 / 3))


@pytest.fixture
def drive() -> Epos2:
    return prompt_drive(1)


@pytest.fixture
def host(drive: Epos2) -> Host:
    host = Host(drive)
    host.enable(1)
    return host


def position(host: Host) -> int:
    return host.read(0x6064, signed=True)


def go(host: Host, target: int, bits: int = 0) -> None:
    host.write(0x607A, 0, target, 4)
    host.control(0x0F)
    host.control(0x1F | bits)


def test_set_point_handshake(host: Host) -> None:
    assert not host.status() & ACKNOWLEDGE
    go(host, 5000)
    assert host.status() & ACKNOWLEDGE
    assert not host.status() & REACHED
    host.control(0x0F)
    assert not host.status() & ACKNOWLEDGE
    host.run(500)
    assert host.status() & REACHED
    assert position(host) == 5000


def test_move_takes_the_time_its_ramps_need(host: Host) -> None:
    """1000 rpm, 10,000 rpm/s, 2000 qc/turn: 100 ms ramps of 1666.7 qc; 10,000 qc: 400 ms."""
    go(host, 10_000)
    host.run(390)
    assert not host.status() & REACHED
    host.run(25)
    assert host.status() & REACHED
    assert position(host) == 10_000


def test_relative_move(host: Host) -> None:
    go(host, 1000)
    host.run(300)
    go(host, -300, 0x40)
    host.run(300)
    assert position(host) == 700


def test_next_set_point_waits_for_the_first(host: Host) -> None:
    go(host, 10_000)
    host.run(100)
    go(host, 2000)
    assert host.status() & ACKNOWLEDGE
    host.control(0x0F)
    assert host.status() & ACKNOWLEDGE  # no place for another one
    host.run(240)
    assert position(host) > 9000
    host.run(600)
    assert position(host) == 2000
    assert not host.status() & ACKNOWLEDGE


def test_set_point_that_counts_at_once(host: Host) -> None:
    go(host, 100_000)
    host.run(200)
    go(host, 2000, 0x20)
    host.run(800)
    assert position(host) == 2000


def test_halt_interrupts_and_release_goes_on(host: Host) -> None:
    go(host, 10_000)
    host.run(150)
    host.control(0x011F)
    host.run(200)
    assert host.status() & REACHED  # bit 10 with halt: the axis stands
    stopped = position(host)
    assert 3000 < stopped < 7000
    host.run(100)
    assert position(host) == stopped
    host.control(0x001F)
    host.run(500)
    assert position(host) == 10_000


def test_target_beyond_the_software_limit(host: Host) -> None:
    host.write(0x607D, 2, 4000, 4)
    go(host, 4001)
    host.run(5)
    assert host.heard(0x081)[0][:2] == b"\x09\xff"
    assert host.status() & 0x4F == 0x08
    assert position(host) == 0


def test_position_window_and_time(host: Host) -> None:
    """0x6067 and 0x6068: within the window for so long."""
    host.write(0x6067, 0, 10, 4)
    host.write(0x6068, 0, 80, 2)
    go(host, 10_000)
    host.run(450)
    assert not host.status() & REACHED
    host.run(60)
    assert host.status() & REACHED


# --- homing -----------------------------------------------------------------------------

SWITCHES = Switches(negative_limit=-5000, positive_limit=9000, home=(2000, 2600), index=150)


def homed(method: int, start: int = 0, offset: int = 0, home_position: int = 0) -> tuple[Host, int]:
    """A host after homing, and where on the machine the axis then stands."""
    drive = prompt_drive(1, position_qc=start, switches=SWITCHES)
    host = Host(drive)
    host.write(0x6098, 0, method, 1)
    host.write(0x6099, 1, 600, 4)
    host.write(0x6099, 2, 60, 4)
    host.write(0x609A, 0, 20_000, 4)
    host.write(0x607C, 0, offset, 4)
    host.write(0x2081, 0, home_position, 4)
    host.enable(6)
    assert not host.status() & ATTAINED
    host.control(0x001F)
    host.run_until(lambda: bool(host.bus.drives[0].status_word & (ATTAINED | ERROR)), 5000)  # type: ignore[attr-defined]
    host.run(50)
    assert host.status() & REACHED
    assert host.read(0x606C, signed=True) == 0
    return host, position(host)


@pytest.mark.parametrize("start", [0, 2300, 8000, -5500])
@pytest.mark.parametrize(
    ("method", "machine"),
    [
        (17, -5000),  # negative limit switch
        (18, 9000),  # positive limit switch
        (23, 2000),  # home switch, looked for in positive direction
        (27, 2600),  # home switch, looked for in negative direction
        (1, -3850),  # the first index pulse (150 + n·2000) above the negative limit switch
        (2, 8150),  # below the positive one
        (7, 150),  # below the home switch
        (11, 4150),  # above it
    ],
)
def test_homing_method(method: int, machine: int, start: int) -> None:
    """Home is 0 afterwards: the switches have moved in the drive's eyes by where home was."""
    host, here = homed(method, start)
    assert host.status() & ATTAINED
    assert not host.status() & ERROR
    assert here == 0
    # home again by the limit switch: its place in the new coordinates tells the old zero
    host.write(0x2081, 0, -5000 - machine, 4)
    host.write(0x6098, 0, 17, 1)
    host.control(0x000F)
    host.control(0x001F)
    host.run(4000)
    assert host.status() & ATTAINED
    assert position(host) == pytest.approx(-5000 - machine, abs=1)


@pytest.mark.parametrize(("method", "machine"), [(33, -1850), (34, 150)])
def test_index_pulse_alone(method: int, machine: int) -> None:
    """From 0: the next pulse of 150 + n·2000."""
    _, here = homed(method, home_position=777)
    assert here == 777


def test_home_offset_is_travelled_and_then_called_home_position() -> None:
    host, here = homed(17, offset=300, home_position=40)
    assert here == 40
    assert host.status() & 1 << 15  # position referenced to home


@pytest.mark.parametrize("method", [35, 37])
def test_actual_position_is_home(method: int) -> None:
    _, here = homed(method, start=1234, home_position=-7)
    assert here == -7


def test_switch_that_is_not_there_is_a_homing_error() -> None:
    """Method 23 turns at the positive limit switch; at the negative one it gives up."""
    drive = prompt_drive(1, position_qc=3000, switches=Switches(-500, 4000))
    host = Host(drive)
    host.write(0x6098, 0, 23, 1)
    host.enable(6)
    host.control(0x001F)
    host.run(3000)
    assert host.status() & ERROR
    assert not host.status() & ATTAINED
    assert host.read(0x606C, signed=True) == 0


def test_homing_is_interrupted_by_bit_4() -> None:
    drive = prompt_drive(1, switches=SWITCHES)
    host = Host(drive)
    host.write(0x6098, 0, 17, 1)
    host.enable(6)
    host.control(0x001F)
    host.run(200)
    assert not host.status() & REACHED
    host.control(0x000F)
    host.run(300)
    assert host.status() & REACHED
    assert not host.status() & (ATTAINED | ERROR)


def test_method_the_drive_has_not(host: Host) -> None:
    with pytest.raises(Abort) as abort:
        host.write(0x6098, 0, 5, 1)
    assert abort.value.code == 0x06090030
