"""The simulated Copley drive against Copley, "Setting outputs at position", and CiA 402.

Everything is written and read as raw SDO frames; values are typed from the document.
"""

from __future__ import annotations

import struct
from collections.abc import Callable

import pytest
from sim_host import Abort, Host

from epos2_ros.sim.copley import LOOP_US, Copley

CONFIGURATION, STATUS, VALUE_0, VALUE_1 = 0x2160, 0x2161, 0x2162, 0x2163
INCREMENT, PULSE_PERIOD, OUTPUT = 0x2164, 0x2165, 0x2193
RESERVED, OFFSET, DATA = 0x250A, 0x250B, 0x250C
VALUE_RANGE, LENGTH = 0x0609_0030, 0x0607_0010


class Axis(Host):
    """One drive whose shaft is moved by hand, at one count a millisecond where not said else."""

    def __init__(self, position: int = 0, **kwargs: object) -> None:
        self.drive = Copley(1, position=position, **kwargs)  # type: ignore[arg-type]
        super().__init__(self.drive)  # type: ignore[arg-type]
        self._place = float(position)

    def turn(self, target: float, counts_per_ms: float = 1.0) -> None:
        """Evenly to `target`."""
        start_us, start = self.bus.now_us, self._place
        duration_us = abs(target - start) / counts_per_ms * 1000

        def motion(t_us: float) -> tuple[float, float]:
            if t_us >= start_us + duration_us:
                return target, 0.0
            share = (t_us - start_us) / duration_us
            return start + share * (target - start), (target - start) / duration_us * 1e6

        self.drive.move_by_hand(motion)
        self.run(duration_us / 1000 + 1)
        self._place = target

    def module(self, **registers: int) -> None:
        for name, index in (
            ("value_0", VALUE_0),
            ("value_1", VALUE_1),
            ("increment", INCREMENT),
            ("pulse", PULSE_PERIOD),
            ("config", CONFIGURATION),
        ):
            if name in registers:
                self.write(index, 0, registers[name], 4)

    def values(self) -> tuple[int, int]:
        return self.read(VALUE_0, signed=True), self.read(VALUE_1, signed=True)

    @property
    def fired(self) -> list[tuple[int, bool]]:
        return [(event.value, event.rising) for event in self.drive.module.fired]


# --- hardware compare ---------------------------------------------------------------------------


def test_mode_0_of_the_document() -> None:
    """Every 100 counts around 1234; at 1199 value 1 has become 1100."""
    axis = Axis(1234)
    axis.module(value_0=1200, value_1=1300, increment=200, pulse=100, config=1)
    axis.turn(1200)
    assert axis.values() == (1200, 1300)
    assert axis.fired == []
    axis.turn(1199)
    assert axis.values() == (1200, 1100)
    assert axis.fired == [(1200, False)]
    axis.turn(1301)
    assert axis.values() == (1400, 1300)
    assert axis.fired == [(1200, False), (1200, True), (1300, True)]


def test_mode_0_without_increment_pulses_at_fixed_positions_both_ways() -> None:
    axis = Axis(0)
    axis.module(value_0=100, value_1=300, pulse=100, config=1)
    axis.turn(400)
    axis.turn(0)
    assert axis.fired == [(100, True), (300, True), (300, False), (100, False)]
    assert axis.values() == (100, 300)


def test_mode_0_with_the_same_position_twice_pulses_once_a_crossing() -> None:
    axis = Axis(0)
    axis.module(value_0=100, value_1=100, pulse=100, config=1)
    axis.turn(200)
    axis.turn(0)
    assert axis.fired == [(100, True), (100, False)]


def test_mode_1_of_the_document() -> None:
    """Position 123, every 100 counts starting with 5000, in a single direction."""
    axis = Axis(123)
    axis.module(value_0=5000, increment=100, pulse=100, config=0b01001)
    axis.turn(5150, counts_per_ms=50)
    axis.turn(4900)
    axis.turn(5199)
    assert axis.fired == [(5000, True), (5100, True)]
    axis.turn(5200)
    assert axis.fired[2:] == [(5200, True)]
    assert axis.values()[0] == 5300


def test_mode_1_downward() -> None:
    axis = Axis(500)
    axis.module(value_0=300, increment=-100, config=0b01001)
    axis.turn(50)
    axis.turn(500)
    assert axis.fired == [(300, False), (200, False), (100, False)]


def test_mode_2_is_active_above_value_0_and_up_to_value_1() -> None:
    axis = Axis(90)
    axis.module(value_0=100, value_1=110, config=0b10001)
    levels = {}
    for position in (100, 101, 110, 111, 110, 101, 100):
        axis.turn(position)
        levels.setdefault(position, set()).add(axis.read(STATUS) & 1)
    assert levels == {100: {0}, 101: {1}, 110: {1}, 111: {0}}


def test_mode_3_ends_at_value_1() -> None:
    axis = Axis(0)
    axis.module(value_0=100, value_1=300, increment=100, config=0b11001)
    axis.turn(1000)
    assert axis.fired == [(100, True), (200, True), (300, True)]
    assert axis.read(CONFIGURATION) & 1 == 0
    axis.turn(0)
    axis.turn(1000)
    assert len(axis.fired) == 3


def test_status_flags_are_cleared_by_writing_1() -> None:
    axis = Axis(0)
    axis.module(value_0=100, value_1=200, pulse=1, config=1)
    axis.turn(150)
    assert axis.read(STATUS) == 0b010
    axis.turn(250)
    assert axis.read(STATUS) == 0b110
    axis.write(STATUS, 0, 0b010, 4)
    assert axis.read(STATUS) == 0b100
    axis.write(STATUS, 0, 0b110, 4)
    assert axis.read(STATUS) == 0


def test_pulse_period_counts_10_ns_in_20_bits() -> None:
    axis = Axis(0)
    axis.write(OUTPUT, 1, 16, 10)
    axis.module(value_0=100, value_1=100, pulse=200_000, config=1)
    axis.turn(100)  # fires at 99.5, 1.5 ms ago
    assert axis.drive.output(1)
    axis.run(0.4)
    assert axis.drive.output(1)
    axis.run(0.3)
    assert not axis.drive.output(1)
    axis.write(PULSE_PERIOD, 0, 0xFFF0_0001, 4)  # bits above the 20th don't count
    axis.turn(99)
    assert not axis.drive.output(1)


def test_toggle_and_inversion() -> None:
    axis = Axis(0)
    axis.write(OUTPUT, 2, 16, 10)
    axis.module(value_0=100, value_1=200, config=0b111)
    levels = [axis.drive.output(2)]
    for position in (150, 250, 150, 50):
        axis.turn(position)
        levels.append(axis.drive.output(2))
    assert levels == [True, False, True, False, True]


def test_a_quadrature_encoder_fires_between_two_loops() -> None:
    axis = Axis(0)
    axis.module(value_0=1000, value_1=1000, config=1)
    start_us = axis.bus.now_us
    axis.turn(2000, counts_per_ms=100)
    (event,) = axis.drive.module.fired
    assert event.t_us == pytest.approx(start_us + 9_995.0, abs=0.01)  # at 999.5


# --- position extrapolation -----------------------------------------------------------------------


def slow_down(t_us: float) -> tuple[float, float]:
    """The document's figure: 600,000 counts/s, slowed down by 400,000,000 counts/s²."""
    t = min(t_us * 1e-6, 600_000 / 400e6)
    return 600_000 * t - 200e6 * t**2, 600_000 - 400e6 * t


def figure(**kwargs: object) -> Copley:
    """Loops every 250 µs from time zero, the encoder changing at whole positions."""
    drive = Copley(1, count_offset=0.0, **kwargs)  # type: ignore[arg-type]
    drive.module.values = [460, 460]
    drive.module.configure(1)
    drive.move_by_hand(slow_down)
    for loop in range(1, 12):
        drive.advance(loop * LOOP_US)
    return drive


def test_the_figure_at_rest_at_450_extrapolated_up_to_461() -> None:
    drive = figure(quadrature=False)
    assert drive.position_actual == 450
    assert drive.seen == (0, 461)


def test_the_figure_a_target_of_460_fires_twice_though_never_reached() -> None:
    fired = figure(quadrature=False).module.fired
    assert [(event.value, event.rising) for event in fired] == [(460, True), (460, False)]
    assert fired[0].t_us < fired[1].t_us == 6 * LOOP_US


def test_a_quadrature_encoder_is_not_extrapolated() -> None:
    drive = figure(quadrature=True)
    assert drive.seen == (0, 450)
    assert drive.module.fired == []


# --- software outputs -----------------------------------------------------------------------------


def pin(function: int, first: int = 0, second: int = 0) -> bytes:
    return struct.pack("<Hii", function, first, second)


def software(axis: Axis, number: int) -> list[tuple[int, bool]]:
    return [(event.value, event.level) for event in axis.drive.pins[number - 1].fired]


def test_function_4_within_the_window() -> None:
    axis = Axis(90)
    axis.write_bytes(OUTPUT, 3, pin(4, 100, 110))
    levels = []
    for position in (99, 100, 110, 111, 105):
        axis.turn(position)
        levels.append(axis.drive.output(3))
    assert levels == [False, True, True, False, True]


@pytest.mark.parametrize(
    ("function", "crossings"), [(5, [True, True]), (6, [False]), (7, [True, False, True])]
)
def test_functions_5_6_and_7(function: int, crossings: list[bool]) -> None:
    axis = Axis(100)
    axis.write_bytes(OUTPUT, 1, pin(function, 123, 100))
    for position in (130, 110, 130):
        axis.turn(position)
    fired = axis.drive.pins[0].fired
    assert [event.rising for event in fired] == crossings
    assert {event.value for event in fired} == {123}


def test_a_software_pulse_lasts_its_milliseconds() -> None:
    axis = Axis(0)
    axis.write_bytes(OUTPUT, 1, pin(7, 10, 100))
    axis.turn(20, counts_per_ms=10)
    assert axis.drive.output(1)
    axis.run(95)
    assert axis.drive.output(1)
    axis.run(5)
    assert not axis.drive.output(1)


def load(axis: Axis, at_once: bool) -> None:
    """The document's example, step by step."""
    axis.write(RESERVED, 0, 8, 2)
    axis.write(OFFSET, 0, 0, 2)
    positions = [value.to_bytes(4, "little") for value in (1000, 3000, 5000, 6000)]
    for data in [b"".join(positions)] if at_once else positions:
        axis.write_bytes(DATA, 0, data)
    axis.write_bytes(OUTPUT, 2, bytes.fromhex("0900 0400 0000 0A00 0000"))


@pytest.mark.parametrize("at_once", [True, False])
def test_function_9_of_the_document(at_once: bool) -> None:
    axis = Axis(0)
    load(axis, at_once)
    axis.turn(5500, counts_per_ms=100)
    axis.turn(0, counts_per_ms=100)
    ups, downs = [1000, 3000, 5000], [5000, 3000, 1000]
    assert software(axis, 2) == [(value, True) for value in ups + downs]


def test_function_9_takes_a_new_set_while_it_moves() -> None:
    axis = Axis(0)
    load(axis, at_once=True)
    axis.turn(2000, counts_per_ms=100)
    axis.write(OFFSET, 0, 0, 2)
    axis.write_bytes(DATA, 0, b"".join(v.to_bytes(4, "little") for v in (100, 200, 2500, 2600)))
    axis.turn(7000, counts_per_ms=100)
    assert software(axis, 2) == [(1000, True), (2500, True), (2600, True)]


def test_inversion_and_commanded_position() -> None:
    axis = Axis(0)
    axis.write_bytes(OUTPUT, 1, pin(4 | 1 << 8, 100, 200))
    assert axis.drive.output(1)
    axis.turn(150)
    assert not axis.drive.output(1)


def test_the_trace_memory_takes_no_more_than_is_reserved() -> None:
    axis = Axis(0)
    axis.write(RESERVED, 0, 4, 2)
    axis.write(OFFSET, 0, 0, 2)
    with pytest.raises(Abort) as abort:
        axis.write_bytes(DATA, 0, bytes(12))
    assert abort.value.code == LENGTH
    axis.write_bytes(DATA, 0, bytes(8))
    assert axis.read(OFFSET) == 4


def test_reserved_bits_of_the_configuration_have_to_be_zero() -> None:
    axis = Axis(0)
    for word in (4 | 1 << 9, 4 | 1 << 11, 4 | 1 << 15, 3):
        with pytest.raises(Abort) as abort:
            axis.write_bytes(OUTPUT, 1, word.to_bytes(2, "little") + bytes(8))
        assert abort.value.code == VALUE_RANGE


# --- profile position mode -----------------------------------------------------------------------


def enabled(**kwargs: object) -> Axis:
    axis = Axis(0, **kwargs)
    axis.nmt(0x01)
    for word in (0x06, 0x07, 0x0F):
        axis.write(0x6040, 0, word, 2)
    assert axis.read(0x6041) & 0x6F == 0x27
    axis.write(0x6081, 0, 1_000_000, 4)  # from the factory it is 0
    return axis


def reached(axis: Axis) -> Callable[[], bool]:
    return lambda: bool(axis.drive.status_word & 1 << 10)


def test_a_move_in_the_drives_units() -> None:
    """Velocity in 0.1 counts/s, acceleration in 10 counts/s²: a trapezoid of 1.2 s."""
    axis = enabled()
    axis.write(0x6081, 0, 4_000_000, 4)  # 400,000 counts/s
    axis.write(0x6083, 0, 200_000, 4)  # 2,000,000 counts/s²
    axis.write(0x6084, 0, 200_000, 4)
    axis.write(0x607A, 0, 400_000, 4)
    axis.write(0x6040, 0, 0x1F, 2)
    start_us = axis.bus.now_us
    assert axis.read(0x6041) & 1 << 12
    axis.write(0x6040, 0, 0x0F, 2)
    assert not axis.read(0x6041) & 1 << 12
    axis.run(600 - (axis.bus.now_us - start_us) / 1000)
    assert axis.read(0x6064, signed=True) == pytest.approx(200_000, abs=800)
    assert axis.read(0x606C, signed=True) == pytest.approx(4_000_000, abs=1)
    axis.run_until(reached(axis), 700)
    assert axis.bus.now_us - start_us == pytest.approx(1.2e6, abs=1000)
    assert axis.read(0x6064, signed=True) == 400_000


def test_a_second_setpoint_waits_or_takes_over() -> None:
    axis = enabled()
    axis.write(0x607A, 0, 20_000, 4)
    axis.write(0x6040, 0, 0x1F, 2)
    axis.write(0x6040, 0, 0x0F, 2)
    axis.write(0x607A, 0, 10_000, 4)
    axis.write(0x6040, 0, 0x1F, 2)
    axis.write(0x6040, 0, 0x0F, 2)
    assert axis.read(0x6041) & 1 << 12  # kept until the first is reached
    most = 0
    while not reached(axis)():
        axis.run(5)
        most = max(most, axis.drive.position_actual)
    assert (most, axis.drive.position_actual) == (20_000, 10_000)
    axis.write(0x607A, 0, 20_000, 4)
    axis.write(0x6040, 0, 0x3F, 2)
    axis.write(0x6040, 0, 0x0F, 2)
    axis.run(50)
    axis.write(0x607A, 0, 10_000, 4)
    axis.write(0x6040, 0, 0x3F, 2)
    axis.run_until(reached(axis), 2000)
    assert axis.drive.position_actual == 10_000


def test_a_setpoint_outside_the_limits_is_not_acknowledged() -> None:
    axis = enabled()
    axis.write(0x607D, 1, 0, 4)
    axis.write(0x607D, 2, 1000, 4)
    axis.write(0x607A, 0, 1001, 4)
    axis.write(0x6040, 0, 0x1F, 2)
    axis.run(10)
    assert not axis.read(0x6041) & 1 << 12
    assert axis.drive.position_actual == 0


def test_halt_and_quick_stop() -> None:
    axis = enabled()
    axis.write(0x607A, 0, 1_000_000, 4)
    axis.write(0x6040, 0, 0x1F, 2)
    axis.run(200)
    axis.write(0x6040, 0, 0x10F, 2)
    axis.run_until(reached(axis), 500)
    stopped = axis.drive.position_actual
    assert 0 < stopped < 1_000_000
    axis.write(0x6040, 0, 0x0F, 2)
    axis.run_until(lambda: axis.drive.position_actual == 1_000_000, 20_000)
    axis.write(0x6040, 0, 0x02, 2)
    assert axis.read(0x6041) & 0x6F == 0x07
    axis.write(0x6040, 0, 0x00, 2)
    assert axis.read(0x6041) & 0x4F == 0x40


def test_a_silent_host_is_a_fault_that_a_reset_leaves() -> None:
    axis = enabled()
    axis.write(0x100C, 0, 20, 2)
    axis.write(0x100D, 0, 5, 1)
    axis.run(300)
    assert axis.read(0x6041) & 0x6F == 0x27  # it has not been asked yet
    for _ in range(3):
        axis.bus.host_send(0x701, b"", remote=True)
        axis.run(90)
    assert axis.heard(0x701)[-3:] == [b"\x05", b"\x85", b"\x05"]  # a toggle bit (CiA 301)
    assert axis.read(0x6041) & 0x6F == 0x27
    axis.run(60)
    assert axis.read(0x6041) & 0x4F == 0x08
    assert axis.heard(0x081)[-1][:2] == bytes.fromhex("3081")  # 0x8130
    axis.write(0x6040, 0, 0x00, 2)
    axis.write(0x6040, 0, 0x80, 2)
    assert axis.read(0x6041) & 0x4F == 0x40


def test_identity_and_profile() -> None:
    axis = Axis()
    assert axis.read(0x1000) & 0xFFFF == 402
    assert axis.read(0x1018, 1) == 0xAB  # Copley Controls' number at CiA


def test_outputs_follow_a_profile_move() -> None:
    """A pulse every 1000 counts, by the drive's own motion."""
    axis = enabled()
    axis.module(value_0=0, value_1=1000, increment=2000, pulse=100, config=1)
    axis.write(0x607A, 0, 10_500, 4)
    axis.write(0x6040, 0, 0x1F, 2)
    axis.run_until(reached(axis), 2000)
    assert axis.fired == [(1000 * n, True) for n in range(1, 11)]
