"""The motion clock and the synchronised start of the simulated drives.

maxon, application note "Interpolation Position Mode", 2.4, 3.6.2 and "Motion
Synchronisation". What a clock should show is computed here from true time, offset and drift.
"""

from __future__ import annotations

import pytest
from sim_host import Host, prompt_drive

from epos2_ros.sim.epos2 import Epos2

WRAP = 1 << 32


def latched(host: Host, node: int = 1) -> int:
    return host.read(0x1013, node=node)


def sends_time_stamp(host: Host, node: int, value: int) -> None:
    host.write(0x1013, 0, value % WRAP, 4, node)


def wrapped(difference: float) -> float:
    return (difference + WRAP / 2) % WRAP - WRAP / 2


@pytest.mark.parametrize(("offset", "drift"), [(0, 0), (12_345_678, 100), (4e9, -250)])
def test_sync_latches_the_clock(offset: float, drift: float) -> None:
    host = Host(prompt_drive(1, offset_us=offset, drift_ppm=drift))
    for _ in range(3):
        host.run(1000)
        t_us = host.sync()
        assert latched(host) == int(offset + t_us * (1 + drift * 1e-6)) % WRAP


def test_reading_gives_the_time_of_the_sync_not_of_now() -> None:
    host = Host(prompt_drive(1))
    t_us = host.sync()
    host.run(500)
    assert latched(host) == int(t_us)


@pytest.mark.parametrize(("bitrate", "resolution"), [(1_000_000, 1), (125_000, 8), (500_000, 2)])
def test_resolution_is_the_bit_time(bitrate: int, resolution: int) -> None:
    """3.6.2: "depends on the selected CAN bitrate (bit time)"."""
    host = Host(prompt_drive(1, offset_us=3.0, drift_ppm=77, bitrate=bitrate), bitrate=bitrate)
    values = []
    for n in range(20):
        host.run(3.137 + n * 0.377)
        t_us = host.sync(ms=2)
        values.append(latched(host))
        assert 0 <= 3.0 + t_us * (1 + 77e-6) - values[-1] < resolution
    assert all(value % resolution == 0 for value in values)
    assert len({value // resolution % 2 for value in values}) == 2


def test_time_stamp_corrects_by_the_difference() -> None:
    host = Host(prompt_drive(1, offset_us=777_000, drift_ppm=0))
    t_us = host.sync()
    sends_time_stamp(host, 1, int(t_us))
    host.run(100)
    t_us = host.sync()
    assert latched(host) == pytest.approx(t_us, abs=1)


@pytest.mark.parametrize("error", [-3000, 5000, WRAP // 2 - 1, -(WRAP // 2)])
def test_difference_is_taken_the_shorter_way_around(error: int) -> None:
    host = Host(prompt_drive(1, offset_us=WRAP - 2000))
    host.sync()
    sends_time_stamp(host, 1, latched(host) + error)
    host.run(10)
    t_us = host.sync()
    assert wrapped(latched(host) - (WRAP - 2000 + t_us + error)) == pytest.approx(0, abs=1)


def test_second_time_stamp_for_one_sync_corrects_again() -> None:
    """By the letter of 3.6.2: the difference to the latched time is used at every write."""
    host = Host(prompt_drive(1))
    host.sync()
    before = latched(host)
    sends_time_stamp(host, 1, before + 100)
    sends_time_stamp(host, 1, before + 100)
    t_us = host.sync()
    assert latched(host) == pytest.approx(t_us + 200, abs=1)


def test_time_stamp_by_pdo() -> None:
    host = Host(prompt_drive(1, offset_us=5000))
    host.map(0x1402, 0x255, [0x1013_0020])
    host.nmt(0x01)
    t_us = host.sync()
    host.send(0x255, int(t_us).to_bytes(4, "little"))
    t_us = host.sync()
    assert latched(host) == pytest.approx(t_us, abs=1)


def test_time_resets_the_clock() -> None:
    """2.4: TIME (0x100) resets the motion clock to zero."""
    host = Host(prompt_drive(1, offset_us=123_456, drift_ppm=50))
    host.run(1000)
    host.send(0x100, "00 00 00 00 00 00")
    reset_us = [f.t_us for f in host.frames if f.can_id == 0x100][0]
    host.run(2000)
    t_us = host.sync()
    assert latched(host) == pytest.approx((t_us - reset_us) * (1 + 50e-6), abs=1)


def test_drift_between_corrections() -> None:
    """100 ppm are 10 µs in 100 ms; a correction each time keeps the clock that close for ever."""
    host = Host(prompt_drive(1, offset_us=1e9, drift_ppm=100))
    errors = []
    for _ in range(50):
        host.run(98)
        t_us = host.sync()
        errors.append(wrapped(latched(host) - t_us))
        sends_time_stamp(host, 1, int(t_us))
    assert max(abs(error) for error in errors[1:]) < 12
    assert min(abs(error) for error in errors[1:]) > 8


# --- interpolation on the motion clock --------------------------------------------------


def line(host: Host, node: int, seconds: int) -> None:
    """A long straight move: 10 qc/ms."""
    points = [(2550 * n, 300, 255) for n in range(1, 4 * seconds + 1)]
    host.feed(*points, (points[-1][0], 0, 0), node=node)


def cycle_times(drive: Epos2) -> dict[int, float]:
    """True time of every path millisecond [µs]."""
    assert drive.recorder is not None
    columns = drive.recorder.arrays()
    return dict(zip(columns["path_ms"].tolist(), columns["time_us"].tolist(), strict=True))


def test_start_at_the_sync() -> None:
    """Nothing happens until the SYNC; its arrival is the zero of the path, in every drive."""
    drives = [
        prompt_drive(n, offset_us=1e6 * n, drift_ppm=40 * n - 100, record=True) for n in (1, 2, 3)
    ]
    host = Host(*drives)
    for node in (1, 2, 3):
        host.prepare_ip(node)
        line(host, node, 1)
    for node in (1, 2, 3):
        host.send(0x300 + node, "1F 00")
        host.run(3 * node)
    assert not any(drive.ip_active for drive in drives)
    assert all(host.read(0x6062, node=node) == 0 for node in (1, 2, 3))
    t_us = host.sync()
    assert all(drive.ip_active for drive in drives)
    assert [drive.ip_start_us for drive in drives] == [t_us] * 3
    assert all(host.status(node) & 1 << 12 for node in (1, 2, 3))
    host.run(500)
    for drive in drives:
        assert cycle_times(drive)[0] == t_us
        times = cycle_times(drive)
        assert times[400] - times[0] == pytest.approx(400_000 / drive.rate, abs=0.01)


def test_second_sync_does_not_start_again() -> None:
    drive = prompt_drive(1, record=True)
    host = Host(drive)
    host.prepare_ip()
    line(host, 1, 1)
    host.send(0x301, "1F 00")
    t_us = host.sync(ms=100)
    host.sync(ms=10)
    host.send(0x301, "1F 00")  # and neither does the same control word
    host.sync(ms=10)
    assert drive.ip_start_us == t_us
    assert len(drive.executed) == len(set(drive.executed))


def test_path_time_follows_corrections() -> None:
    """A clock 5 ms behind is put right in motion: the path jumps 5 ms ahead, cycle by cycle."""
    drive = prompt_drive(1, record=True, lag_ms=0)
    host = Host(drive)
    host.prepare_ip()
    line(host, 1, 2)
    host.control(0x001F)
    host.run(100)
    t_us = host.sync()
    sends_time_stamp(host, 1, latched(host) + 5000)
    host.run(100)
    times = cycle_times(drive)
    assert list(times) == list(range(len(times)))  # every millisecond of the path once
    path = max(times)
    assert times[path] == pytest.approx(drive.ip_start_us + 1000 * path - 5000, abs=1)
    assert t_us < times[path]


def test_path_waits_when_the_clock_is_put_back() -> None:
    drive = prompt_drive(1, record=True, lag_ms=0)
    host = Host(drive)
    host.prepare_ip()
    line(host, 1, 2)
    host.control(0x001F)
    host.run(100)
    host.sync()
    sends_time_stamp(host, 1, latched(host) - 5000)
    host.run(100)
    times = cycle_times(drive)
    gaps = [times[n + 1] - times[n] for n in range(len(times) - 1)]
    assert max(gaps) == pytest.approx(6000, abs=1)
    assert sum(gap > 1500 for gap in gaps) == 1


def test_corrections_at_rest_move_nothing() -> None:
    drive = prompt_drive(1, record=True)
    host = Host(drive)
    host.prepare_ip()
    host.sync()
    sends_time_stamp(host, 1, 1_000_000_000)
    line(host, 1, 1)
    host.control(0x001F)
    host.run(50)
    times = cycle_times(drive)
    assert times[40] - times[0] == pytest.approx(40_000, abs=0.01)


def test_synchronised_drives_stay_together() -> None:
    """±100 ppm, corrected every 100 ms with the true time: within 10 µs and the resolution."""
    drives = [prompt_drive(n, drift_ppm=200 * n - 300, record=True) for n in (1, 2)]
    host = Host(*drives)
    for node in (1, 2):
        host.prepare_ip(node)
        host.map(0x1402, 0x255, [0x1013_0020], node=node)
        line(host, node, 10)
    for _ in range(2):
        t_us = host.sync()
        host.send(0x255, int(t_us).to_bytes(4, "little"))
        host.run(50)
    host.send(0x301, "1F 00")
    host.send(0x302, "1F 00")
    for _ in range(60):
        t_us = host.sync()
        host.send(0x255, int(t_us).to_bytes(4, "little"))
        host.run(99)
    one, two = cycle_times(drives[0]), cycle_times(drives[1])
    assert len(one) > 5900
    # drifting apart at 200 ppm for 100 ms before the next correction
    assert max(abs(one[n] - two[n]) for n in one.keys() & two.keys()) < 20 + 2
    late = [one[n] - drives[0].ip_start_us - 1000 * n for n in one]
    assert max(abs(x) for x in late) < 12


@pytest.mark.parametrize("drift", [-100, 100])
def test_wrap_around_in_motion(drift: float) -> None:
    """The 32 bits run over after 71.6 minutes; the path doesn't notice."""
    drive = prompt_drive(1, offset_us=WRAP - 1_500_000, drift_ppm=drift, record=True, lag_ms=0)
    host = Host(drive)
    host.prepare_ip()
    line(host, 1, 4)
    host.send(0x301, "1F 00")
    values = []
    for _ in range(35):
        host.sync()
        values.append(latched(host))
        sends_time_stamp(host, 1, values[-1])
        host.run(97)
    assert values[0] > WRAP - 1_500_000
    assert values[-1] < WRAP // 2
    times = cycle_times(drive)
    assert list(times) == list(range(len(times)))
    gaps = [times[n + 1] - times[n] for n in range(len(times) - 1)]
    assert max(gaps) - min(gaps) < 0.01
    assert host.heard(0x081) == []
