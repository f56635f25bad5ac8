"""What a Copley drive is told, against the examples of Copley, "Setting outputs at position".

The bytes are written out here as the note gives them; counts are the joint's unit.
"""

from __future__ import annotations

from typing import Any

import pytest

from epos2_ros.configuration.outputs import CompareConfig
from epos2_ros.motion.units import AxisUnits
from epos2_ros.protocol.outputs import copley as copley_compare
from epos2_ros.protocol.outputs.copley import (
    CompareModule,
    Function,
    HardwareOutput,
    Mode,
    OutputPin,
    SoftwareOutput,
    load_positions,
    reserve,
)
from epos2_ros.protocol.sdo import SdoWrite

COUNTS = AxisUnits("x", "m", 2000, 1.0)
REVERSED = AxisUnits("x", "m", 2000, -1.0)

CONFIGURATION, STATUS, VALUE_0, VALUE_1 = 0x2160, 0x2161, 0x2162, 0x2163
INCREMENT, PULSE_PERIOD, OUTPUT = 0x2164, 0x2165, 0x2193


def config(kind: str, pin: int = 1, **parameters: Any) -> CompareConfig:
    return CompareConfig("output", "x", kind, pin=pin, **parameters)


def registers(writes: list[SdoWrite]) -> dict[int, int]:
    """What the compare module's registers hold after all writes, signed."""
    return {
        write.index: int.from_bytes(write.data, "little", signed=True)
        for write in writes
        if write.index != OUTPUT
    }


def hardware(units: AxisUnits = COUNTS, position: int = 0, **parameters: Any) -> dict[int, int]:
    return registers(HardwareOutput(config(**parameters), units).arm(position))


def ascii_value(write: SdoWrite) -> tuple[int, int, int, int]:
    """Parameter and values of the note's ASCII command: r0x70 is output 1."""
    first = int.from_bytes(write.data[2:6], "little", signed=True)
    second = int.from_bytes(write.data[6:10], "little", signed=True)
    word = int.from_bytes(write.data[:2], "little")
    return 0x70 + write.subindex - 1, word, first, second


# --- software triggered outputs ---------------------------------------------------------------


def software(units: AxisUnits = COUNTS, **parameters: Any) -> SdoWrite:
    *_, pin = SoftwareOutput(config(method="software", **parameters), units).arm(0)
    assert pin.index == OUTPUT
    assert len(pin.data) == 10
    return pin


def test_function_4_output_3_active_between_10000_and_20000() -> None:
    write = software(kind="window", pin=3, window=(10000.0, 20000.0))
    assert ascii_value(write) == (0x72, 4, 10000, 20000)
    assert write.data == bytes.fromhex("0400 10270000 204E0000")


def test_function_5_output_1_pulses_100_ms_when_123_is_crossed_upward() -> None:
    write = software(kind="crossing", positions=(123.0,), direction="up", pulse=0.1)
    assert ascii_value(write) == (0x70, 5, 123, 100)


def test_functions_6_and_7_pulse_downward_and_both_ways() -> None:
    down = software(kind="crossing", positions=(123.0,), direction="down", pulse=0.1)
    both = software(kind="crossing", positions=(123.0,), direction="both", pulse=0.1)
    assert ascii_value(down) == (0x70, 6, 123, 100)
    assert ascii_value(both) == (0x70, 7, 123, 100)


def test_upward_is_downward_for_the_counts_of_a_reversed_joint() -> None:
    write = software(REVERSED, kind="crossing", positions=(123.0,), direction="up", pulse=0.1)
    assert ascii_value(write) == (0x70, 6, -123, 100)
    window = software(REVERSED, kind="window", window=(100.0, 200.0))
    assert ascii_value(window) == (0x70, 4, -200, -100)


def test_function_9_output_2_pulses_10_ms_at_1000_3000_5000_and_6000() -> None:
    series = SoftwareOutput(
        config("series", pin=2, positions=(1000.0, 3000.0, 5000.0, 6000.0), pulse=0.01), COUNTS
    )
    assert series.words == 8  # "at least 8 words to hold the 4 positions"
    assert reserve(series.words) == SdoWrite(0x250A, 0, bytes.fromhex("0800"))
    offset, positions, pin = series.arm(0)
    assert offset == SdoWrite(0x250B, 0, bytes.fromhex("0000"))
    assert positions == SdoWrite(0x250C, 0, bytes.fromhex("E8030000 B80B0000 88130000 70170000"))
    # function 9; 4 positions; offset 0; 10 ms; reserved
    assert pin == SdoWrite(0x2193, 2, bytes.fromhex("0900 0400 0000 0A00 0000"))


def test_positions_are_written_at_once_or_one_by_one() -> None:
    offset, *four = load_positions((1000, 3000, 5000, 6000), 0, at_once=False)
    assert offset == SdoWrite(0x250B, 0, bytes(2))
    assert [write.index for write in four] == [0x250C] * 4
    assert [len(write.data) for write in four] == [4] * 4
    at_once = load_positions((1000, 3000, 5000, 6000), 0)[1]
    assert b"".join(write.data for write in four) == at_once.data


def test_series_are_sorted_from_lowest_to_highest_count() -> None:
    series = SoftwareOutput(config("series", positions=(1.0, 2.0, 5.0)), REVERSED)
    data = series.arm(0)[1].data
    counts = [int.from_bytes(data[n : n + 4], "little", signed=True) for n in (0, 4, 8)]
    assert counts == [-5, -2, -1]


def test_configuration_word_bits() -> None:
    assert OutputPin(Function.WINDOW).configuration == 4
    assert OutputPin(Function.WINDOW, inverted=True).configuration == 4 | 1 << 8
    assert OutputPin(Function.CROSSING, axis=1).configuration == 7 | 1 << 12
    assert OutputPin(Function.CROSSING, axis=3).configuration == 7 | 3 << 12
    assert OutputPin(Function.SERIES, commanded=True).configuration == 9 | 1 << 14
    write = software(
        kind="crossing", positions=(123.0,), inverted=True, reference="commanded", pulse=0.1
    )
    assert ascii_value(write)[1] == 0x4107


def test_two_series_of_one_drive_lie_behind_each_other() -> None:
    first = CompareConfig("a", "x", "series", pin=1, positions=(1.0, 2.0), capacity=5)
    second = CompareConfig("b", "x", "series", pin=2, positions=(7.0, 8.0, 9.0))
    outputs = copley_compare.make_outputs([first, second], COUNTS)
    assert copley_compare.trace_words(outputs) == 10 + 6
    offset, _, pin = outputs[1].arm(0)
    assert offset.data == (10).to_bytes(2, "little")
    assert pin.data[2:6] == bytes.fromhex("0300 0A00")  # 3 positions from word 10 on


def test_a_new_set_needs_no_new_configuration() -> None:
    """ "The points can be changed at any time by uploading a new set using step 2"."""
    before = SoftwareOutput(config("series", positions=(1.0, 2.0, 3.0), capacity=4), COUNTS)
    same = before.with_positions((4.0, 5.0, 6.0))
    assert [write.index for write in same.update(before)] == [0x250B, 0x250C]
    assert same.update(before)[1].data == bytes.fromhex("04000000 05000000 06000000")
    # Another number of points: never more of them counted than are written.
    longer, shorter = before.with_positions((1.0, 2.0, 3.0, 4.0)), before.with_positions((9.0,))
    assert [write.index for write in longer.update(before)] == [0x250B, 0x250C, 0x2193]
    assert [write.index for write in shorter.update(before)] == [0x2193, 0x250B, 0x250C]
    assert longer.update(before)[2].data[2:4] == bytes.fromhex("0400")


# --- hardware triggered outputs ---------------------------------------------------------------


def test_function_16_output_2_follows_the_compare_module() -> None:
    """ASCII: s r0x71 16."""
    writes = HardwareOutput(config("crossing", pin=2, positions=(5.0,)), COUNTS).arm(0)
    (pin,) = (write for write in writes if write.index == OUTPUT)
    assert ascii_value(pin) == (0x71, 16, 0, 0)


def test_mode_0_pulses_every_100_counts_around_1234() -> None:
    written = hardware(position=1234, kind="interval", start=0.0, interval=100.0)
    assert written[VALUE_0] == 1200
    assert written[VALUE_1] == 1300
    assert written[INCREMENT] == 200
    assert written[CONFIGURATION] == 1


@pytest.mark.parametrize(("position", "flank"), [(1199, 1100), (1200, 1200), (1299, 1200)])
def test_mode_0_flanks_the_position_as_crossings_count(position: int, flank: int) -> None:
    written = hardware(position=position, kind="interval", start=500.0, interval=100.0)
    assert (written[VALUE_0], written[VALUE_1]) == (flank, flank + 100)


def test_mode_0_single_pulse_at_one_or_two_fixed_positions() -> None:
    two = hardware(kind="crossing", positions=(1000.0, 3000.0))
    assert (two[VALUE_0], two[VALUE_1], two[INCREMENT]) == (1000, 3000, 0)
    one = hardware(kind="crossing", positions=(1000.0,))
    assert (one[VALUE_0], one[VALUE_1], one[INCREMENT]) == (1000, 1000, 0)
    assert one[CONFIGURATION] == two[CONFIGURATION] == 1


def test_mode_1_every_100_counts_from_5000_on() -> None:
    up = hardware(position=123, kind="interval", start=5000.0, interval=100.0, direction="up")
    assert (up[VALUE_0], up[INCREMENT]) == (5000, 100)
    assert up[CONFIGURATION] == 0b01001
    down = hardware(position=9000, kind="interval", start=5000.0, interval=100.0, direction="down")
    assert (down[VALUE_0], down[INCREMENT]) == (5000, -100)
    turned = hardware(REVERSED, kind="interval", start=5000.0, interval=100.0, direction="up")
    assert (turned[VALUE_0], turned[INCREMENT]) == (-5000, -100)


def test_mode_2_active_above_value_0_up_to_value_1() -> None:
    written = hardware(kind="window", window=(1000.0, 2000.0))
    assert (written[VALUE_0], written[VALUE_1]) == (1000, 2000)
    assert written[CONFIGURATION] == 0b10001


def test_mode_3_ends_at_value_1() -> None:
    up = hardware(kind="interval", start=5000.0, interval=100.0, end=8000.0)
    assert (up[VALUE_0], up[VALUE_1], up[INCREMENT]) == (5000, 8000, 100)
    assert up[CONFIGURATION] == 0b11001
    down = hardware(kind="interval", start=8000.0, interval=100.0, end=5000.0)
    assert (down[VALUE_0], down[VALUE_1], down[INCREMENT]) == (8000, 5000, -100)


def test_inversion_toggling_and_the_pulse_in_units_of_10_ns() -> None:
    assert CompareModule(Mode.DUAL, 0, inverted=True).configuration == 0b011
    assert CompareModule(Mode.DUAL, 0, toggle=True).configuration == 0b101
    written = hardware(kind="crossing", positions=(5.0,), inverted=True, toggle=True, pulse=0.001)
    assert written[CONFIGURATION] == 0b111
    assert written[PULSE_PERIOD] == 100_000
    longest = hardware(kind="crossing", positions=(5.0,), pulse=0.01048575)
    assert longest[PULSE_PERIOD] == 2**20 - 1


def test_the_module_is_set_while_it_is_off_and_its_flags_are_cleared() -> None:
    writes = HardwareOutput(config("window", window=(1.0, 2.0)), COUNTS).arm(0)
    order = [write.index for write in writes]
    assert order[0] == CONFIGURATION
    assert writes[0].data == bytes(4)
    assert order[-2:] == [CONFIGURATION, OUTPUT]
    assert registers(writes)[STATUS] == 0b110
    assert all(len(write.data) == 4 for write in writes[:-1])


def test_the_objects_of_a_second_axis_lie_0x800_higher() -> None:
    writes = CompareModule(Mode.DUAL, 1200, 1300, 200).writes(axis=1)
    assert {write.index for write in writes} == set(range(0x2960, 0x2966))


def test_what_the_drive_has_in_hardware_is_done_there() -> None:
    def module_serves(**parameters: Any) -> bool:
        (made,) = copley_compare.make_outputs([config(**parameters)], COUNTS)
        return isinstance(made, HardwareOutput)

    assert module_serves(kind="window", window=(1.0, 2.0))
    assert module_serves(kind="crossing", positions=(1.0, 2.0))
    assert module_serves(kind="interval", start=0.0, interval=10.0)
    assert not module_serves(kind="crossing", positions=(1.0,), direction="up")
    assert not module_serves(kind="series", positions=(1.0, 2.0))
    assert not module_serves(kind="window", window=(1.0, 2.0), reference="commanded")
    assert not module_serves(kind="window", window=(1.0, 2.0), method="software")
