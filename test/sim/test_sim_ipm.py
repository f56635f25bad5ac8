"""Interpolated position mode of the simulated drive.

Against maxon, application note "Interpolation Position Mode" ("the note"): the automaton of
3.2 (tables 2 and 3), control and status word (tables 6, 7, 9, 10), buffer (tables 1, 12, 13,
15, 16), limits (table 4), the sequence of table 17, interruption (3.8). The curve is checked
against the 4×4 system P(0), V(0), P(T), V(T) solved by NumPy.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sim_host import Abort, Host, prompt_drive, pvt

from epos2_ros.sim.epos2 import Epos2

IPM_ERROR = bytes.fromhex("0C FF")
IP_ACTIVE, REACHED, RESERVED = 1 << 12, 1 << 10, 1 << 13
UNDERFLOW_WARNING, OVERFLOW_WARNING, VELOCITY_WARNING, ACCELERATION_WARNING = 1, 2, 4, 8
UNDERFLOW, OVERFLOW, VELOCITY, ACCELERATION = 1 << 8, 1 << 9, 1 << 10, 1 << 11
BUFFER_ENABLED, ACTIVE = 1 << 14, 1 << 15
QC_PER_MS = 2000 / 60_000  # of one rpm with 2000 counts per turn


@pytest.fixture
def drive() -> Epos2:
    return prompt_drive(1, record=True, lag_ms=0)


@pytest.fixture
def host(drive: Epos2) -> Host:
    host = Host(drive)
    host.prepare_ip()
    return host


def level(host: Host) -> int:
    """Records in the buffer, as both objects tell it."""
    used = host.read(0x60C4, 4)
    assert host.read(0x60C4, 2) == 64 - used
    return used


def refuse(host: Host) -> int:
    with pytest.raises(Abort) as abort:
        host.write_bytes(0x20C1, 0, pvt(0, 0, 10))
    return abort.value.code


def faulted(host: Host) -> bool:
    """EMCY 0xFF0C was sent and the drive has gone to fault."""
    host.run(300)
    return host.heard(0x081)[:1] == [IPM_ERROR + bytes.fromhex("81 00 00 00 00 00")] and (
        host.status() & 0x4F == 0x08
    )


MOVE = [(100, 60, 50), (300, 60, 100), (400, 0, 50), (400, 0, 0)]


# --- automaton (figure 5, tables 2 and 3) -----------------------------------------------


def test_selecting_the_mode_clears_the_buffer(host: Host) -> None:
    """Transition I. Table 16 calls a cleared buffer one whose access is disabled."""
    host.feed(*MOVE)
    assert level(host) == 4
    host.write(0x6060, 0, 1, 1)
    assert level(host) == 4
    host.write(0x6060, 0, 7, 1)
    assert level(host) == 0
    assert not host.buffer_status() & BUFFER_ENABLED
    assert refuse(host) == 0x08000022


def test_entering_operation_enabled_clears_the_buffer(host: Host) -> None:
    """The automaton is part of "operation enable": it begins anew (3.2, 3.8)."""
    host.feed(*MOVE)
    host.control(0x0006)
    host.control(0x000F)
    assert level(host) == 0
    assert not host.buffer_status() & BUFFER_ENABLED


def test_same_mode_again_changes_nothing(host: Host) -> None:
    host.feed(*MOVE)
    host.write(0x6060, 0, 7, 1)
    assert level(host) == 4


def test_inactive_accepts_records_and_does_not_move(host: Host) -> None:
    host.feed(*MOVE)
    host.run(200)
    assert level(host) == 4
    assert host.read(0x6062) == 0
    assert not host.status() & IP_ACTIVE


def test_active_accepts_records_and_moves(host: Host) -> None:
    host.feed(*MOVE[:3])
    host.control(0x001F)
    host.feed(MOVE[3])
    assert host.status() & IP_ACTIVE
    assert host.buffer_status() & ACTIVE
    host.run(300)
    assert host.read(0x6062) == 400


def test_bit_4_has_to_rise_in_operation_enabled(drive: Epos2) -> None:
    host = Host(drive)
    host.map(0x1400, 0x201, [0x20C1_0040])
    host.nmt(0x01)
    host.write(0x6060, 0, 7, 1)
    host.control(0x0006)
    host.control(0x001F)  # enable operation and bit 4 at once
    host.write(0x60C4, 6, 1, 1)
    host.feed(*MOVE)
    host.control(0x001F)
    assert not host.status() & IP_ACTIVE
    host.control(0x000F)
    host.control(0x001F)
    assert host.status() & IP_ACTIVE


def test_record_with_time_zero_ends_the_motion(host: Host) -> None:
    """Transition IV: no error, position held, drive still enabled."""
    host.feed(*MOVE)
    host.control(0x001F)
    host.run(250)
    assert not host.status() & IP_ACTIVE
    assert host.status() & 0x6F == 0x27
    assert host.status() & REACHED
    assert host.heard(0x081) == []
    assert host.buffer_status() & 0xFF00 == BUFFER_ENABLED
    assert host.read(0x6064) == 400
    host.control(0x001F)  # bit 4 has not fallen: nothing starts
    assert not host.status() & IP_ACTIVE


def test_next_motion_after_the_end(host: Host, drive: Epos2) -> None:
    host.feed(*MOVE)
    host.control(0x001F)
    host.run(250)
    host.feed((300, -60, 50), (200, 0, 50), (200, 0, 0))
    host.control(0x000F)
    host.control(0x001F)
    host.run(150)
    assert host.read(0x6064) == 200
    assert drive.executed[0] == (0, 400)
    assert drive.executed[-1] == (100, 200)


def test_what_follows_the_end_record_waits_for_the_next_start(host: Host) -> None:
    host.feed((50, 0, 20), (50, 0, 0), (90, 0, 20), (90, 0, 0))
    host.control(0x001F)
    host.run(50)
    assert level(host) == 2
    host.control(0x000F)
    host.control(0x001F)
    host.run(50)
    assert host.read(0x6064) == 90


def test_clearing_bit_4_stops_on_the_profile_ramp(host: Host) -> None:
    host.feed((1000, 600, 100), (3000, 600, 100), (5000, 600, 100), (7000, 600, 100), (7000, 0, 0))
    host.control(0x001F)
    host.run(150)
    host.control(0x000F)
    assert not host.status() & IP_ACTIVE
    before = host.read(0x6062)
    host.run(100)  # 600 rpm at 10,000 rpm/s: 60 ms, 600 qc
    assert 400 < host.read(0x6062) - before < 620
    assert host.status() & 0x6F == 0x27
    assert host.heard(0x081) == []


def test_halt_leaves_ip_mode_inactive_and_release_starts_again(host: Host) -> None:
    """Table 7: halt = 1 stops the axis with profile deceleration, 0 executes bit 4."""
    host.feed(*[(200 * n, 60 * 100 // 100, 100) for n in range(1, 20)], (4000, 0, 0))
    host.control(0x001F)
    host.run(150)
    host.control(0x011F)
    assert not host.status() & IP_ACTIVE
    host.run(50)
    assert host.status() & REACHED  # table 10: with halt, velocity is 0
    waiting = level(host)
    assert waiting == 18
    host.run(100)
    assert level(host) == waiting
    host.control(0x001F)
    assert host.status() & IP_ACTIVE


def test_halt_released_without_bit_4_stays_inactive(host: Host) -> None:
    host.feed(*MOVE)
    host.control(0x001F)
    host.run(50)
    for word in (0x011F, 0x010F, 0x000F):
        host.control(word)
    host.run(100)
    assert not host.status() & IP_ACTIVE


def test_axis_decelerates_before_halt_has_reached_its_target(host: Host) -> None:
    """Table 10: halt = 1, bit 10 = 0 while it decelerates."""
    host.feed(*[(4000 * n, 1200, 100) for n in range(1, 8)], (28000, 0, 0))
    host.control(0x001F)
    host.run(250)
    host.control(0x011F)
    host.run(50)
    assert not host.status() & REACHED  # 1200 rpm at 10,000 rpm/s need 120 ms
    host.run(100)
    assert host.status() & REACHED


def test_leaving_the_mode_deactivates(host: Host) -> None:
    host.feed(*[(200 * n, 60, 100) for n in range(1, 8)])
    host.control(0x001F)
    host.run(50)
    host.write(0x6060, 0, 1, 1)
    assert not host.status() & IP_ACTIVE
    host.run(100)
    assert host.heard(0x081) == []


def test_quick_stop_in_motion(host: Host) -> None:
    host.feed(*[(4000 * n, 1200, 100) for n in range(1, 8)], (28000, 0, 0))
    host.control(0x001F)
    host.run(250)
    host.control(0x0002)
    assert not host.status() & IP_ACTIVE
    assert host.status() & 0x6F == 0x07
    host.run(150)
    assert host.read(0x606C) == 0
    host.control(0x000F)
    assert host.status() & 0x6F == 0x27
    assert level(host) == 0  # re-entered: to be filled again


def test_error_interrupts_and_needs_a_new_start(host: Host, drive: Epos2) -> None:
    """3.8: back into operation enabled, where "ip mode active" is cleared."""
    host.feed(*[(200 * n, 60, 100) for n in range(1, 8)])
    host.control(0x001F)
    host.run(50)
    drive.fail(0x3220, host.bus.now_us)
    host.run(50)
    assert host.status() & 0x4F == 0x08
    assert not host.buffer_status() & ACTIVE
    host.control(0x0080)
    host.control(0x0006)
    host.control(0x000F)
    assert not host.status() & IP_ACTIVE
    assert level(host) == 0


def test_bit_13_is_reserved(host: Host) -> None:
    host.feed(*MOVE)
    host.control(0x001F)
    for _ in range(30):
        assert not host.status() & RESERVED
        host.run(7)


# --- buffer (tables 1, 12, 13, 15, 16) --------------------------------------------------


def test_access_is_disabled_until_enabled(drive: Epos2) -> None:
    host = Host(drive)
    host.map(0x1400, 0x201, [0x20C1_0040])
    host.nmt(0x01)
    host.enable(7)
    assert not host.buffer_status() & BUFFER_ENABLED
    assert refuse(host) == 0x08000022
    host.feed(MOVE[0])  # by PDO there is no answer
    assert level(host) == 0
    assert drive.refused_records == 2
    host.write(0x60C4, 6, 1, 1)
    assert host.buffer_status() & BUFFER_ENABLED
    host.feed(MOVE[0])
    host.write_bytes(0x20C1, 0, pvt(*MOVE[1]))
    assert level(host) == 2
    assert drive.refused_records == 2


def test_records_outside_the_automaton_are_refused(host: Host) -> None:
    """Only "interpolation inactive" and "active" accept input data (table 2)."""
    host.control(0x0006)
    host.write(0x60C4, 6, 1, 1)
    assert refuse(host) == 0x08000022
    host.control(0x000F)
    host.write(0x6060, 0, 1, 1)
    host.write(0x60C4, 6, 1, 1)
    assert refuse(host) == 0x08000022


def test_buffer_clear(host: Host) -> None:
    host.feed(*MOVE)
    host.write(0x60C4, 6, 0, 1)
    assert level(host) == 0
    assert not host.buffer_status() & BUFFER_ENABLED
    host.write(0x60C4, 6, 1, 1)
    host.feed(*MOVE)
    host.write(0x60C4, 6, 1, 1)  # enabling an enabled buffer keeps what is in it
    assert level(host) == 4


def test_the_segment_in_execution_has_left_the_buffer(host: Host) -> None:
    host.feed(*MOVE)
    host.control(0x001F)
    assert level(host) == 3
    host.run(60)
    assert level(host) == 2
    host.run(100)
    assert level(host) == 1


def test_64_records_fit(host: Host) -> None:
    host.feed(*[(0, 0, 100)] * 64)
    assert level(host) == 64
    assert host.heard(0x081) == []


@pytest.mark.parametrize("by_sdo", [False, True])
def test_the_65th_is_an_overflow(host: Host, by_sdo: bool) -> None:
    host.feed(*[(0, 0, 100)] * 64)
    if by_sdo:
        assert refuse(host) == 0x08000022
    else:
        host.feed((0, 0, 100))
    assert faulted(host)
    assert host.buffer_status() & 0x0F00 == OVERFLOW
    assert level(host) == 64


def test_overflow_while_moving_aborts_the_motion(host: Host) -> None:
    host.feed(*[(0, 0, 255)] * 64)
    host.control(0x001F)
    host.feed((0, 0, 255))
    assert host.status() & IP_ACTIVE
    host.feed((0, 0, 255))
    assert faulted(host)
    assert not host.buffer_status() & ACTIVE


@pytest.mark.parametrize("records", [0, 1, 2])
def test_start_with_too_few_records(host: Host, records: int) -> None:
    """At least two in the buffer besides the one in execution (3.6.3, read strictly)."""
    host.feed(*MOVE[:records])
    host.control(0x001F)
    assert faulted(host)
    assert host.buffer_status() & 0x0F00 == UNDERFLOW


def test_start_with_three_records_runs_until_the_first_ends(host: Host) -> None:
    host.feed(*MOVE[:3])
    host.control(0x001F)
    host.run(40)
    assert host.status() & IP_ACTIVE
    host.run(20)
    assert faulted(host)
    assert host.buffer_status() & 0x0F00 == UNDERFLOW


@pytest.mark.parametrize("records", [1, 2])
def test_few_records_are_enough_with_the_end_among_them(host: Host, records: int) -> None:
    host.feed(*MOVE[:records], (100 * records**2, 0, 0))
    host.control(0x001F)
    host.run(300)
    assert host.heard(0x081) == []
    assert host.status() & 0x6F == 0x27


def test_end_record_alone(host: Host) -> None:
    host.feed((0, 0, 0))
    host.control(0x001F)
    assert not host.status() & IP_ACTIVE
    assert host.heard(0x081) == []


def test_clearing_the_buffer_in_motion_is_an_underflow(host: Host) -> None:
    host.feed(*MOVE)
    host.control(0x001F)
    host.write(0x60C4, 6, 0, 1)
    assert faulted(host)
    assert host.buffer_status() & 0x0F00 == UNDERFLOW


def test_underflow_reaction_is_a_ramp(host: Host, drive: Epos2) -> None:
    """The last demand before the error keeps its velocity: no step."""
    host.feed((4000, 1200, 200), (8000, 1200, 100), (12000, 1200, 100))
    host.control(0x001F)
    host.run_until(lambda: not drive.ip_active, 300)
    before = drive.position_demand
    host.run(10)  # 1200 rpm = 40 qc/ms
    assert drive.position_demand - before == pytest.approx(400, abs=50)
    assert host.status() & 0x6F == 0x0F
    host.run(200)
    assert host.status() & 0x4F == 0x08


def test_warning_levels(host: Host) -> None:
    """0x20C4-02: "below this border"; -03: "above this border"."""
    host.write(0x20C4, 2, 3, 2)
    host.write(0x20C4, 3, 5, 2)
    expected = [UNDERFLOW_WARNING] * 3 + [0] * 3 + [OVERFLOW_WARNING] * 2
    for flags in expected:
        assert host.buffer_status() & 0x000F == flags
        host.feed((0, 0, 10))


def test_default_warning_levels(host: Host) -> None:
    """4 and 60 (3.6.4)."""
    host.feed(*[(0, 0, 10)] * 3)
    assert host.buffer_status() & 3 == UNDERFLOW_WARNING
    host.feed((0, 0, 10))
    assert host.buffer_status() & 3 == 0
    host.feed(*[(0, 0, 10)] * 56)
    assert host.buffer_status() & 3 == 0
    host.feed((0, 0, 10))
    assert host.buffer_status() & 3 == OVERFLOW_WARNING


def test_errors_stay_until_the_buffer_is_cleared(host: Host) -> None:
    host.control(0x001F)
    assert faulted(host)
    host.control(0x0080)
    assert host.buffer_status() & UNDERFLOW
    host.write(0x60C4, 6, 0, 1)
    assert not host.buffer_status() & 0x0F00


# --- limits (table 4) -------------------------------------------------------------------


def cruise(host: Host, rpm: int) -> None:
    """Accelerates to `rpm` in 200 ms, keeps it for 600 ms, stops in 200 ms."""
    step = rpm * QC_PER_MS
    host.feed(
        (round(100 * step), rpm, 200),
        *[(round((100 + 100 * n) * step), rpm, 100) for n in range(1, 7)],
        (round(800 * step), 0, 200),
        (round(800 * step), 0, 0),
    )
    host.control(0x001F)


@pytest.mark.parametrize(("limit", "flag"), [(600, 0), (599, VELOCITY_WARNING)])
def test_velocity_warning(host: Host, limit: int, flag: int) -> None:
    """IPM velocity greater than profile velocity (0x6081); whole counts add a little."""
    host.write(0x6081, 0, limit, 4)
    cruise(host, 600)
    host.run(450)
    assert host.buffer_status() & VELOCITY_WARNING == flag
    assert host.status() & IP_ACTIVE
    host.run(800)
    assert host.buffer_status() & VELOCITY_WARNING == 0
    assert host.heard(0x081) == []


@pytest.mark.parametrize(("limit", "error"), [(600, False), (599, True)])
def test_velocity_error(host: Host, limit: int, error: bool) -> None:
    """IPM velocity greater than maximal profile velocity (0x607F): bit 10, trajectory abort."""
    host.write(0x607F, 0, limit, 4)
    cruise(host, 600)
    host.run(1000)
    assert bool(host.buffer_status() & VELOCITY) == error
    assert (IPM_ERROR in [e[:2] for e in host.heard(0x081)]) == error


def test_velocity_between_the_points_counts_too(host: Host) -> None:
    """0 → 1000 qc in 100 ms from rest to rest peaks at 1.5·10 qc/ms = 450 rpm in the middle."""
    host.write(0x6081, 0, 449, 4)
    host.feed((1000, 0, 100), (1000, 0, 100), (1000, 0, 100), (1000, 0, 0))
    host.control(0x001F)
    assert host.buffer_status() & VELOCITY_WARNING
    host.run(150)
    assert not host.buffer_status() & VELOCITY_WARNING


@pytest.mark.parametrize(("limit", "flag"), [(3010, 0), (2990, ACCELERATION_WARNING)])
def test_acceleration_warning(host: Host, limit: int, flag: int) -> None:
    """To 600 rpm in 200 ms: 3000 rpm/s; 0x6083."""
    host.write(0x6083, 0, limit, 4)
    cruise(host, 600)
    assert host.buffer_status() & ACCELERATION_WARNING == flag
    host.run(400)
    assert not host.buffer_status() & ACCELERATION_WARNING


@pytest.mark.parametrize(("limit", "error"), [(3010, False), (2990, True)])
def test_acceleration_error(host: Host, limit: int, error: bool) -> None:
    """0x60C5: bit 11, trajectory abort."""
    host.write(0x60C5, 0, limit, 4)
    cruise(host, 600)
    host.run(100)
    assert bool(host.buffer_status() & ACCELERATION) == error
    assert bool(host.heard(0x081)) == error


@pytest.mark.parametrize(("limit", "error"), [(400, False), (399, True)])
def test_software_position_limit(host: Host, limit: int, error: bool) -> None:
    """0x607D limits the demand: EMCY 0xFF09."""
    host.write(0x607D, 2, limit, 4)
    host.feed(*MOVE)
    host.control(0x001F)
    host.run(300)
    assert ([e[:2] for e in host.heard(0x081)] == [b"\x09\xff"]) == error
    assert (host.status() & 0x4F == 0x08) == error


def test_limit_between_the_points_counts_too(host: Host, drive: Epos2) -> None:
    """From 0 to 0, arriving with −20 qc/ms after 100 ms: the cubic swings out to 296 qc."""
    host.write(0x607D, 2, 10, 4)
    host.feed((0, -600, 100), (0, 0, 100), (0, 0, 100), (0, 0, 0))
    host.control(0x001F)
    host.run(150)
    assert [e[:2] for e in host.heard(0x081)] == [b"\x09\xff"]
    assert max(demand for _, demand in drive.executed) <= 10.5


def test_following_error_limit(drive: Epos2) -> None:
    host = Host(prompt_drive(1, lag_ms=20))  # 20 ms behind: 800 qc at 40 qc/ms
    host.prepare_ip()
    host.write(0x6065, 0, 700, 4)
    host.feed(*[(4000 * n, 1200, 100) for n in range(1, 8)], (28000, 0, 0))
    host.control(0x001F)
    host.run(500)
    assert host.heard(0x081)[0][:2] == b"\x11\x86"


def test_velocity_notation_scales_records_and_limits(drive: Epos2) -> None:
    """0x608B = −2: 60,000 units are 600 rpm = 20 qc/ms."""
    host = Host(drive)
    host.write(0x608B, 0, -2, 1)
    host.write(0x6081, 0, 60_000, 4)
    host.write(0x607F, 0, 60_000, 4)
    host.prepare_ip()
    host.feed((1000, 60_000, 100), (3000, 60_000, 100), (5000, 60_000, 100), (5000, 0, 0))
    host.control(0x001F)
    host.run(150)
    assert host.read(0x606C) == pytest.approx(60_000, rel=1e-6)
    assert not host.buffer_status() & VELOCITY_WARNING
    demand = dict(drive.executed)
    assert demand[150] - demand[149] == pytest.approx(20)


# --- the curve (2.3) --------------------------------------------------------------------


def hermite(p0: float, v0: float, p1: float, v1: float, duration: int) -> np.ndarray:
    """Positions at 1 … duration ms, from the system P(0), V(0), P(T), V(T)."""
    t = float(duration)
    system = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [1, t, t**2, t**3], [0, 1, 2 * t, 3 * t**2]])
    coefficients = np.linalg.solve(system, [p0, v0, p1, v1])
    return np.vander(np.arange(1, duration + 1), 4, increasing=True) @ coefficients


segments = st.tuples(st.integers(-200, 200), st.integers(-600, 600), st.integers(1, 255))


@settings(deadline=None, max_examples=30)
@given(st.lists(segments, min_size=1, max_size=8), st.integers(-(10**9), 10**9))
def test_executed_curve(points: list[tuple[int, int, int]], start: int) -> None:
    """Every control cycle lies on the cubics through the records, from where the axis stands."""
    drive = prompt_drive(1, position_qc=start, record=True, lag_ms=0)
    host = Host(drive)
    host.write(0x6065, 0, 0xFFFFFFFF, 4)
    host.prepare_ip()
    position, records = start, []
    for step, velocity, duration in points:
        position += step
        records.append((position, velocity, duration))
    host.feed(*records, (position, 0, 0))
    host.control(0x001F)
    host.run(sum(point[2] for point in points) + 20)
    expected, p0, v0 = [np.array([start])], float(start), 0.0
    for p1, rpm, duration in records:
        v1 = rpm * QC_PER_MS
        expected.append(hermite(p0, v0, p1, v1, duration))
        p0, v0 = p1, v1
    path, demand = zip(*drive.executed, strict=True)
    assert list(path) == list(range(len(path)))
    assert np.abs(np.array(demand) - np.concatenate(expected)).max() < 1e-4
    assert host.heard(0x081) == []


def test_demand_value_is_the_rounded_curve(host: Host, drive: Epos2) -> None:
    host.feed(*MOVE)
    host.control(0x001F)
    host.run(80)
    assert host.read(0x6062) == round(drive.executed[-1][1])


@pytest.mark.parametrize("data", ["00 00 00 80 00 00 80 00", "FF FF FF 7F FF FF 7F FF"])
def test_extreme_records_are_taken(host: Host, data: str) -> None:
    """Position int32, velocity int24, time uint8 (table 1)."""
    host.send(0x201, data)
    assert level(host) == 1


def test_table_17(drive: Epos2) -> None:
    """The typical commanding sequence, all by SDO, as printed."""
    host = Host(drive)
    host.write(0x6060, 0, 0x07, 1)
    for index, subindex, value in (
        (0x6065, 0, 2000),
        (0x607D, 1, -2147483648),
        (0x607D, 2, 2147483647),
        (0x607F, 0, 25000),
        (0x60C5, 0, 4294967295),
        (0x6081, 0, 1000),
        (0x6083, 0, 10000),
        (0x6085, 0, 10000),  # printed as 0x6084
    ):
        host.write(index, subindex, value, 4)
    host.control(0x0006)
    host.control(0x000F)
    host.write(0x60C4, 6, 0x01, 1)
    fed = 0
    while not host.buffer_status() & OVERFLOW_WARNING:
        fed += 1
        host.write_bytes(0x20C1, 0, pvt(20 * fed, 30, 20))
    assert fed == 61
    host.control(0x001F)
    while fed < 200:
        if host.buffer_status() & UNDERFLOW_WARNING:
            while not host.buffer_status() & OVERFLOW_WARNING:
                fed += 1
                host.write_bytes(0x20C1, 0, pvt(20 * fed, 30, 20))
        host.run(10)
    fed += 1
    host.write_bytes(0x20C1, 0, pvt(20 * fed, 0, 20))
    host.write_bytes(0x20C1, 0, pvt(20 * fed, 0, 0))
    host.run(61 * 20 + 400)
    assert host.heard(0x081) == []
    assert not host.buffer_status() & ACTIVE
    assert host.read(0x6064) == 20 * fed
