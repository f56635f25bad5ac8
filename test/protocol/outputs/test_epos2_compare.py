"""What an EPOS2 is told of position compare (0x207A, 0x2079) and position marker (0x2074)."""

from __future__ import annotations

from typing import Any

import canopen
import numpy as np
import pytest
from sim_host import Host, prompt_drive

from epos2_ros.bus.cia402_node import object_dictionary
from epos2_ros.configuration.outputs import CompareConfig
from epos2_ros.motion.crossings import Path
from epos2_ros.motion.units import AxisUnits
from epos2_ros.protocol import epos2
from epos2_ros.protocol.outputs.epos2 import CompareOutput, MarkerOutput
from epos2_ros.sim.epos2 import Epos2

COUNTS = AxisUnits("x", "m", 2000, 1.0)
REVERSED = AxisUnits("x", "m", 2000, -1.0)


def written(units: AxisUnits = COUNTS, kind: str = "crossing", **parameters: Any) -> dict:
    output = CompareOutput(CompareConfig("output", "x", kind, **parameters), units)
    return {
        (write.index, write.subindex): int.from_bytes(write.data, "little", signed=True)
        for write in output.arm(0)
    }


def test_single_position_both_ways_and_in_one_direction() -> None:
    both = written(positions=(5000.0,), pin=4, pulse=0.002)
    assert both[0x207A, 1] == 0b10_00_00_1  # both directions, single, enabled
    assert both[0x207A, 2] == 5000
    assert both[0x207A, 5] == 2000  # µs
    assert both[0x2079, 4] == 1
    assert written(positions=(5000.0,), direction="up")[0x207A, 1] == 0b01_00_00_1
    assert written(positions=(5000.0,), direction="down")[0x207A, 1] == 0b00_00_00_1
    turned = written(REVERSED, positions=(5000.0,), direction="up")
    assert (turned[0x207A, 1], turned[0x207A, 2]) == (0b00_00_00_1, -5000)


def test_sequence_from_start_to_end() -> None:
    up = written(kind="interval", start=1000.0, interval=100.0, end=1500.0)
    assert up[0x207A, 1] == 0b10_01_01_1  # both ways, positive interval, sequence, enabled
    assert (up[0x207A, 2], up[0x207A, 3], up[0x207A, 4]) == (1000, 100, 6)
    down = written(kind="interval", start=1500.0, interval=100.0, end=1000.0, direction="down")
    assert down[0x207A, 1] == 0b00_00_01_1
    assert (down[0x207A, 2], down[0x207A, 3], down[0x207A, 4]) == (1500, 100, 6)


def test_sequence_without_end_reaches_as_far_as_the_drive_can() -> None:
    both = written(kind="interval", start=0.0, interval=100.0)
    assert both[0x207A, 1] == 0b10_10_01_1
    assert both[0x207A, 4] & 0xFFFF == 65535


def test_it_is_set_while_it_is_off() -> None:
    output = CompareOutput(CompareConfig("output", "x", "crossing", positions=(1.0,)), COUNTS)
    writes = [(write.index, write.subindex) for write in output.arm(0)]
    assert writes[0] == (0x207A, 1)
    assert output.arm(0)[0].data == bytes(2)
    assert writes[-2:] == [(0x207A, 1), (0x2079, 1)]


def test_events_of_a_sequence_are_its_positions() -> None:
    config = CompareConfig("output", "x", "interval", start=1000.0, interval=100.0, end=1500.0)
    output = CompareOutput(config, COUNTS)
    t_us = np.arange(0.0, 3_101_000.0, 1000.0)
    position = 2000.0 - np.abs(t_us / 1000.0 - 2000.0)  # to 2000 and back to 900
    path = Path(t_us, position, np.where(t_us < 2e6, 1000.0, -1000.0))
    events = output.tracker(0).advance(path)
    assert [event.position_qc for event in events] == [
        1000, 1100, 1200, 1300, 1400, 1500, 1500, 1400, 1300, 1200, 1100, 1000,
    ]  # fmt: skip
    assert [event.rising for event in events] == [True] * 6 + [False] * 6


def marker() -> tuple[MarkerOutput, Path]:
    """An axis that goes up at 1000 counts/s for a second."""
    t_us = np.arange(0.0, 1_001_000.0, 1000.0)
    path = Path(t_us, t_us / 1000.0, np.full(len(t_us), 1000.0))
    return MarkerOutput(CompareConfig("probe", "x", "marker", direction="up"), COUNTS), path


def test_marker_captures_at_the_edges_asked_for() -> None:
    output, _ = marker()
    values = {(w.index, w.subindex): int.from_bytes(w.data, "little") for w in output.arm(0)}
    assert values == {(0x2074, 2): 1, (0x2074, 3): 0, (0x2074, 4): 0}
    reads = output.tracker(0).reads
    assert [(read.index, read.subindex) for read in reads] == [
        (0x2074, 4), (0x2074, 1), (0x2074, 5), (0x2074, 6),
    ]  # fmt: skip


def test_captured_positions_become_events_when_the_path_was_there() -> None:
    output, path = marker()
    tracker = output.tracker(0)
    tracker.advance(path)
    assert tracker.report((7, 0, 0, 0), 0.0, 0.0) == ([], [])  # what was before is not ours
    events, writes = tracker.report((9, 800, 300, 0), 1_000_000.0, 1_000_500.0)
    assert writes == []
    assert [event.position_qc for event in events] == [300, 800]
    assert np.allclose([event.t_us for event in events], [299_500.0, 799_500.0])
    assert tracker.report((9, 800, 300, 0), 1_010_000.0, 1_010_500.0)[0] == []


def test_the_marker_counter_wraps_and_what_was_overwritten_is_counted() -> None:
    output, path = marker()
    tracker = output.tracker(0)
    tracker.advance(path)
    tracker.report((0xFFFF, 0, 0, 0), 0.0, 0.0)
    events, _ = tracker.report((4, 900, 800, 700), 1_000_000.0, 1_000_500.0)
    assert [event.position_qc for event in events] == [700, 800, 900]
    assert tracker.missed == 2


# --- the simulated drive --------------------------------------------------------------------------


def test_the_simulated_drive_has_the_objects_of_the_eds() -> None:
    dictionary = object_dictionary(epos2.FAMILY)
    simulated = Epos2(1).dictionary
    for index in (0x2074, 0x2079, 0x207A):
        for subindex, variable in dictionary[index].items():
            assert isinstance(variable, canopen.objectdictionary.ODVariable)
            entry = simulated[index, subindex]
            assert 8 * entry.type.size == len(variable), f"{index:04X}-{subindex:02X}"
            access = entry.access.replace("const", "ro").replace("rww", "rw")
            assert access == variable.access_type


class Axis(Host):
    """An enabled EPOS2 in profile position mode."""

    def __init__(self) -> None:
        self.drive = prompt_drive(1, lag_ms=0.0)
        super().__init__(self.drive)
        self.nmt(0x01)
        for word in (0x06, 0x07, 0x0F):
            self.write(0x6040, 0, word, 2)

    def go(self, target: int) -> None:
        self.write(0x607A, 0, target, 4)
        self.write(0x6040, 0, 0x3F, 2)
        self.write(0x6040, 0, 0x0F, 2)
        self.run_until(lambda: self.drive.position_actual == target, 5000)

    @property
    def fired(self) -> list[tuple[int, bool]]:
        return [(pulse.value, pulse.rising) for pulse in self.drive.fired]


@pytest.mark.parametrize(
    ("dependency", "fired"),
    [(0, [(1000, False)]), (1, [(1000, True)]), (2, [(1000, True), (1000, False)])],
)
def test_simulated_single_position(dependency: int, fired: list[tuple[int, bool]]) -> None:
    axis = Axis()
    axis.write(0x207A, 2, 1000, 4)
    axis.write(0x207A, 1, 1 | dependency << 5, 2)
    axis.go(2000)
    axis.go(0)
    assert axis.fired == fired


@pytest.mark.parametrize(
    ("interval", "values"),
    [(0, [800, 900, 1000]), (1, [1000, 1100, 1200]), (2, [800, 900, 1000, 1100, 1200])],
)
def test_simulated_sequence_of_three_repetitions(interval: int, values: list[int]) -> None:
    axis = Axis()
    axis.write(0x207A, 2, 1000, 4)
    axis.write(0x207A, 3, 100, 4)
    axis.write(0x207A, 4, 3, 2)
    axis.write(0x2079, 4, 1, 2)
    axis.write(0x207A, 1, 1 | 1 << 1 | interval << 3 | 1 << 5, 2)
    axis.go(2000)
    axis.go(0)
    assert axis.fired == [(value, True) for value in values]
    assert axis.drive.pulses == [4]


def test_simulated_marker_captures_and_remembers() -> None:
    axis = Axis()
    axis.write(0x2074, 2, 2, 1)  # falling edges
    for target in (100, 200, 300):
        axis.go(target)
        axis.drive.input_edge(rising=True)
        axis.drive.input_edge(rising=False)
    assert axis.read(0x2074, 4) == 3
    assert [axis.read(0x2074, sub, signed=True) for sub in (1, 5, 6)] == [300, 200, 100]
