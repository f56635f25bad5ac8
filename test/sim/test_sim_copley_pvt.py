"""Interpolated position mode of the simulated Copley drive, frame by frame.

Bytes, bits and rules are typed from what the maker's EDS and motion library say of 0x2010 … 0x2013;
the curve is an independent Hermite cubic.
"""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sim_host import Host

from epos2_ros.sim.copley import Copley
from epos2_ros.sim.copley_pvt import Segment

PDO, STATUS_PDO = 0x201, 0x281
FLUSH, POP, CLEAR, RESET = 0x80, 0x81, 0x82, 0x83


def i24(value: int) -> bytes:
    return struct.pack("<i", value)[:3]


def pvt(counter: int, position: int, velocity: int, time_ms: int, form: int = 0) -> bytes:
    return bytes([counter & 7 | form << 3, time_ms]) + i24(position) + i24(velocity)


def initial(counter: int, position: int) -> bytes:
    return bytes([counter & 7 | 4 << 3]) + struct.pack("<i", position) + bytes(3)


class Axis(Host):
    """A drive in mode 7, enabled; 0x2010 in RPDO1, 0x2012 in an event-driven TPDO2."""

    def __init__(self, position: int = 0, submode: int = -2, **kwargs: object) -> None:
        self.drive = Copley(1, position=position, record=True, **kwargs)  # type: ignore[arg-type]
        super().__init__(self.drive)  # type: ignore[arg-type]
        pdos = (0x1400, PDO, 0x2010_0040), (0x1801, STATUS_PDO, 0x2012_0020)
        for record, cob_id, mapped in pdos:
            self.write(record, 1, 1 << 31 | cob_id, 4)
            self.write(record, 2, 255, 1)
            self.write(record + 0x200, 0, 0, 1)
            self.write(record + 0x200, 1, mapped, 4)
            self.write(record + 0x200, 0, 1, 1)
            self.write(record, 1, cob_id, 4)
        self.nmt(0x01)
        self.write(0x6060, 0, 7, 1)
        self.write(0x60C0, 0, submode, 2)
        for word in (0x06, 0x07, 0x0F):
            self.control(word)
        self.run(1)

    def put(self, *frames: bytes) -> None:
        for frame in frames:
            self.send(PDO, frame, ms=0.2)

    def command(self, *data: int) -> None:
        self.send(PDO, bytes(data).ljust(8, b"\0"), ms=51)

    @property
    def next_id(self) -> int:
        return self.read(0x2012) & 0xFFFF

    @property
    def free(self) -> int:
        return self.read(0x2012) >> 16 & 0xFF

    @property
    def errors(self) -> int:
        return self.read(0x2012) >> 24 & 0x7F

    @property
    def empty(self) -> bool:
        return bool(self.read(0x2012) >> 31)

    @property
    def active(self) -> bool:
        return bool(self.status() & 1 << 12)

    def start(self) -> None:
        self.control(0x1F)

    def executed(self) -> tuple[np.ndarray, np.ndarray]:
        t, p = np.array(self.drive.executed).T
        return t, p


def hermite(knots: list[tuple[float, float, int]]) -> np.ndarray:
    """Positions at every ms of knots (position, counts/s, ms to the next), as a polynomial."""
    out = [knots[0][0]]
    for (p0, v0, time_ms), (p1, v1, _) in zip(knots, knots[1:], strict=False):
        s = np.arange(1, time_ms + 1) / time_ms
        duration = time_ms / 1000
        out += list(
            (2 * s**3 - 3 * s**2 + 1) * p0
            + (s**3 - 2 * s**2 + s) * v0 * duration
            + (3 * s**2 - 2 * s**3) * p1
            + (s**3 - s**2) * v1 * duration
        )
    return np.array(out)


# --- bytes --------------------------------------------------------------------------------------


def test_status_at_power_on() -> None:
    """Next id in bits 0–15, free places in 16–23, errors in 24–26, empty in 31."""
    axis = Axis()
    assert axis.read(0x2012) == 1 << 31 | 32 << 16
    assert (axis.read(0x2011), axis.read(0x2013)) == (32, 0)
    axis.put(pvt(0, 0, 0, 10))
    assert axis.read(0x2012) == 31 << 16 | 1
    assert (axis.read(0x2011), axis.read(0x2013)) == (31, 1)


@pytest.mark.parametrize("by_sdo", [True, False])
def test_a_segment_comes_by_sdo_as_by_pdo(by_sdo: bool) -> None:
    axis = Axis()
    if by_sdo:
        axis.write_bytes(0x2010, 0, pvt(0, 5, 6, 7))
    else:
        axis.put(pvt(0, 5, 6, 7))
    assert axis.next_id == 1


@given(st.integers(-(2**23), 2**23 - 1), st.integers(-(2**23), 2**23 - 1), st.integers(0, 255))
def test_formats_0_to_3(position: int, velocity: int, time_ms: int) -> None:
    """Bits 0 and 1 of the format: 10 counts/s instead of 0.1, relative instead of absolute."""
    for form in range(4):
        segment = Segment.unpack(pvt(5, position, velocity, time_ms, form))
        assert segment is not None and segment.time_ms == time_ms
        assert segment.place(1000) == position + (1000 if form & 2 else 0)
        per_ms = velocity * (10.0 if form & 1 else 0.1) / 1000
        assert segment.velocity == pytest.approx(per_ms, rel=1e-12)


def test_a_format_that_there_is_not_is_not_taken() -> None:
    axis = Axis()
    axis.put(bytes([9 << 3]) + bytes(7))
    assert (axis.next_id, axis.free) == (0, 32)


# --- the path -----------------------------------------------------------------------------------


def test_segments_say_where_they_start() -> None:
    """Position and velocity at the start of a segment, time to the next; 0: the final command."""
    axis = Axis()
    knots = [(0, 0.0, 100), (50, 1000.0, 200), (300, 1500.0, 255), (500, 0.0, 0)]
    for n, (p, v, t) in enumerate(knots):
        axis.put(pvt(n, p, round(v * 10), t))
    axis.start()
    assert axis.active
    axis.run(600)
    assert not axis.active
    assert axis.status() & 1 << 10
    assert axis.read(0x6062, signed=True) == axis.read(0x6064, signed=True) == 500
    t, p = axis.executed()
    assert list(t) == list(range(556))
    assert np.abs(p - hermite(knots)).max() < 1e-6
    assert (axis.errors, axis.empty) == (0, True)


def test_coarse_velocities_and_distances() -> None:
    axis = Axis(1000)
    axis.put(
        pvt(0, 1000, 0, 100, 1), pvt(1, 2000, 3000, 100, 3), pvt(2, 2000, 0, 0, 2)
    )
    axis.start()
    axis.run(250)
    assert axis.read(0x6062, signed=True) == 5000
    _, p = axis.executed()
    knots = [(1000, 0.0, 100), (3000, 30_000.0, 100), (5000, 0.0, 0)]
    assert np.abs(p - hermite(knots)).max() < 1e-6


def test_a_path_beyond_24_bits() -> None:
    """The 32-bit initial position alone has a place and an id, and no time; then distances."""
    far = 20_000_000
    axis = Axis(far)
    axis.put(initial(0, far), pvt(1, 0, 0, 200, 2), pvt(2, -4000, 0, 0, 2))
    assert (axis.next_id, axis.free) == (3, 29)
    axis.start()
    axis.run(250)
    assert axis.read(0x6064, signed=True) == far - 4000
    t, _ = axis.executed()
    assert t[-1] == 200


def test_absolute_positions_are_sign_extended() -> None:
    axis = Axis(-8_388_608)
    axis.put(pvt(0, -8_388_608, 0, 100), pvt(1, -8_388_000, 0, 0))
    axis.start()
    axis.run(150)
    assert axis.read(0x6064, signed=True) == -8_388_000


def test_linear_segments() -> None:
    axis = Axis()
    for n, (p, t) in enumerate([(0, 100), (1000, 100), (1000, 0)]):
        axis.put(bytes([n | 5 << 3, t]) + struct.pack("<i", p) + bytes(2))
    axis.start()
    axis.run(250)
    _, p = axis.executed()
    assert np.abs(p - np.minimum(np.arange(201) * 10, 1000)).max() < 1e-6


# --- what the counter and the status are for -----------------------------------------------------


def test_a_missing_segment_is_a_sequence_error() -> None:
    """It says which id it wants; nothing is taken until the error is cleared by its mask."""
    axis = Axis()
    axis.put(pvt(0, 0, 0, 10), pvt(2, 0, 0, 10))
    assert (axis.next_id, axis.errors, axis.free) == (1, 1, 31)
    axis.put(pvt(1, 0, 0, 10))
    assert (axis.next_id, axis.free) == (1, 31)
    axis.command(CLEAR, 0b110)
    assert axis.errors == 1
    axis.command(CLEAR, 0b001)
    assert axis.errors == 0
    axis.put(pvt(1, 0, 0, 10), pvt(2, 0, 0, 10))
    assert (axis.next_id, axis.errors) == (3, 0)


def test_a_repeated_segment_is_a_sequence_error() -> None:
    axis = Axis()
    axis.put(pvt(0, 0, 0, 10), pvt(0, 0, 0, 10))
    assert (axis.next_id, axis.errors) == (1, 1)


def test_the_id_has_16_bits_of_which_3_come_along() -> None:
    axis = Axis()
    axis.drive.pvt.next_id = 65534
    axis.put(*(pvt(n, 0, 0, 10) for n in (65534, 65535, 0, 1)))
    assert (axis.next_id, axis.errors) == (2, 0)


def test_too_many_segments_are_an_overflow() -> None:
    axis = Axis()
    axis.put(*(pvt(n, 0, 0, 10) for n in range(33)))
    assert (axis.next_id, axis.errors, axis.free) == (32, 2, 0)


def test_the_end_of_a_segment_has_to_be_there_when_it_is_taken() -> None:
    """Else underflow: the axis slows down; what then comes is another path."""
    axis = Axis()
    axis.put(pvt(0, 0, 0, 100), pvt(1, 2000, 400_000, 50))
    axis.start()
    axis.run(95)
    assert (axis.active, axis.errors) == (True, 0)
    axis.run(6)
    assert (axis.active, axis.errors, axis.empty) == (False, 4, True)
    axis.run_until(lambda: bool(axis.status() & 1 << 10), 500)
    # from 40,000 counts/s at 0x6085, 10,000,000 counts/s²
    assert axis.read(0x6064, signed=True) == pytest.approx(2000 + 80, abs=12)
    axis.control(0x0F)
    axis.put(pvt(2, 2080, 0, 10), pvt(3, 2080, 0, 0))
    axis.start()
    assert not axis.active
    axis.command(CLEAR, 4)
    axis.control(0x0F)
    axis.start()
    assert axis.active


def test_a_start_with_one_segment_is_an_underflow() -> None:
    axis = Axis()
    axis.put(initial(0, 0), pvt(1, 0, 0, 100))
    axis.start()
    assert (axis.active, axis.errors) == (False, 4)


def test_it_tells_when_a_segment_is_taken_or_an_error_appears_and_not_when_one_comes() -> None:
    axis = Axis()

    def told() -> list[int]:
        return [int.from_bytes(data, "little") for data in axis.heard(STATUS_PDO)]

    before = len(told())
    axis.put(*(pvt(n, 0, 0, 20) for n in range(3)), pvt(3, 0, 0, 0))
    assert len(told()) == before
    axis.start()
    axis.run(70)
    assert [word >> 16 & 0xFF for word in told()[before:]] == [29, 30, 31, 32]
    assert {word & 0xFFFF for word in told()[before:]} == {4}
    axis.put(pvt(7, 0, 0, 0))
    axis.run(1)
    assert told()[-1] >> 24 & 7 == 1
    count = len(told())
    axis.command(CLEAR, 1)
    assert len(told()) == count


# --- commands -------------------------------------------------------------------------------------


def test_flush_empties_it_and_ends_a_path() -> None:
    axis = Axis()
    axis.put(*(pvt(n, n * n * 100, n * 20_000, 100) for n in range(4)))
    axis.start()
    axis.run(150)
    axis.command(FLUSH)
    assert (axis.active, axis.empty, axis.next_id) == (False, True, 4)
    axis.run(100)
    assert axis.status() & 1 << 10
    assert 200 < axis.read(0x6064, signed=True) < 400


def test_pop_takes_back_the_newest() -> None:
    axis = Axis()
    axis.put(*(pvt(n, 0, 0, 10) for n in range(5)))
    axis.command(POP, 2, 0)
    assert (axis.next_id, axis.free) == (3, 29)
    axis.command(POP, 9, 0)
    assert (axis.next_id, axis.empty) == (0, True)


def test_the_counter_is_reset() -> None:
    axis = Axis()
    axis.put(pvt(0, 0, 0, 10))
    axis.command(FLUSH)
    axis.command(RESET)
    assert axis.next_id == 0


def test_a_command_takes_50_ms_in_which_nothing_else_comes_in() -> None:
    axis = Axis()
    axis.send(PDO, bytes([FLUSH]) + bytes(7), ms=49)
    axis.put(pvt(0, 0, 0, 10))
    assert (axis.next_id, axis.errors) == (0, 0)
    axis.run(1)
    axis.put(pvt(0, 0, 0, 10))
    assert axis.next_id == 1


# --- when it does nothing -------------------------------------------------------------------------


@pytest.mark.parametrize("case", ["0x2300", "0x60C0", "mode 1", "bit 4 was set"])
def test_it_stays_where_it_is_and_says_nothing(case: str) -> None:
    axis = Axis(submode=0 if case == "0x60C0" else -2)
    if case == "0x2300":
        axis.write(0x2300, 0, 11, 2)
    elif case == "mode 1":
        axis.write(0x607A, 0, 0, 4)
        axis.write(0x6060, 0, 1, 1)
    axis.put(pvt(0, 0, 0, 100), pvt(1, 5000, 0, 0))
    if case == "bit 4 was set":
        axis.control(0x07)
        axis.control(0x1F)  # together with "enable operation"
    axis.start()
    axis.run(200)
    assert axis.read(0x6064, signed=True) == 0
    assert (axis.free, axis.errors) == (30, 0)


@pytest.mark.parametrize("how", ["halt", "bit 4", "quick stop", "mode"])
def test_what_ends_a_path_before_its_end(how: str) -> None:
    axis = Axis()
    axis.put(pvt(0, 0, 0, 100), *(pvt(n, n * 2000 - 1000, 200_000, 100) for n in range(1, 9)))
    axis.start()
    axis.run(250)
    if how == "mode":
        axis.write(0x6060, 0, 1, 1)
    else:
        axis.control({"halt": 0x11F, "bit 4": 0x0F, "quick stop": 0x1B}[how])
    assert not axis.active or how == "mode"
    axis.run_until(lambda: bool(axis.status() & 1 << 10), 300)
    at = axis.read(0x6064, signed=True)
    # 20,000 counts/s by 0x6084, 1,000,000 counts/s², or ten times that
    assert 4000 + (20 if how == "quick stop" else 200) <= at <= 4300 + 40
    left = axis.free
    assert left < 32  # what is in the buffer stays there
    if how == "halt":
        axis.control(0x1F)
        assert axis.active
        assert axis.free > left


def test_halt_on_the_quick_stop_ramp() -> None:
    axis = Axis()
    axis.write(0x605D, 0, 2, 2)
    axis.put(pvt(0, 0, 0, 100), *(pvt(n, n * 2000 - 1000, 200_000, 100) for n in range(1, 9)))
    axis.start()
    axis.run(250)
    before = axis.read(0x6064, signed=True)
    axis.control(0x11F)
    axis.run_until(lambda: bool(axis.status() & 1 << 10), 300)
    assert axis.read(0x6064, signed=True) - before < 200


def test_the_path_goes_by_the_clock_that_0x1013_sets() -> None:
    """A clock 5 ms behind the stamp goes on 5 ms later in its path."""
    axis = Axis(offset_us=1_000_000.0)
    axis.put(pvt(0, 0, 0, 200), pvt(1, 2000, 0, 0))
    sync_us = axis.sync()
    latched = axis.read(0x1013)
    assert abs(latched - (1_000_000 + sync_us)) <= 1
    axis.start()
    axis.run(50)
    axis.sync()
    axis.write(0x1013, 0, axis.read(0x1013) + 5000, 4)
    begun_us = axis.drive.ip_start_us
    axis.run_until(lambda: not axis.active, 300)
    assert (axis.bus.now_us - begun_us) / 1000 == pytest.approx(195, abs=2)
