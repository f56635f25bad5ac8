"""Bringing up Copley drives with their maker's dictionary, and guarding them.

What real ones need is from Copley's EDS of 2016 and CiA 301, 7.2.8.2.2 (life guarding).
"""

from __future__ import annotations

import struct

import pytest
from simulated_time import Bench

from epos2_ros.configuration.driver import AxisConfig, DriverConfig
from epos2_ros.errors import ConfigurationError, DriveError
from epos2_ros.protocol.phase import Phase
from epos2_ros.sim.copley import Copley
from epos2_ros.sim.epos2 import Epos2

LIFE_US = 500e3
SDO_ANSWER = 0x580


def axis(joint: str = "z", node_id: int = 2, **settings: object) -> AxisConfig:
    settings = {"max_velocity": 20.0, "max_acceleration": 50.0, **settings}
    return AxisConfig(joint, node_id, drive="copley", **settings)  # type: ignore[arg-type]


def bench(*drives: Copley, bring_up: bool = True, **settings: object) -> Bench:
    axes = tuple(axis(f"z{n}", drive.node_id, **settings) for n, drive in enumerate(drives, 1))
    return Bench(DriverConfig(axes=axes), drives, bring_up=bring_up)  # type: ignore[arg-type]


def refusal(drive: Copley, **settings: object) -> str:
    made = bench(drive, bring_up=False, **settings)
    with pytest.raises(DriveError) as error:
        made.bring_up()
    return str(error.value)


# --- bring-up ---------------------------------------------------------------------------------


def test_comes_up_moves_and_is_off_its_factory_pdos() -> None:
    drive = Copley(2)
    made = bench(drive, max_following_error=1234)
    made.enable()
    made.wait(made.machine.move_to({"z1": 1.0}))
    od = drive.dictionary
    assert od[0x2120, 0].value == 1234
    assert (od[0x100C, 0].value, od[0x100D, 0].value, od[0x1017, 0].value) == (100, 5, 0)
    valid = [n for n, pdo in enumerate(drive.rpdos, 1) if pdo.valid]
    assert valid == [1, 2, 3, 4]
    assert [n for n, pdo in enumerate(drive.tpdos, 1) if pdo.valid] == [1, 2, 3, 4]
    assert (od[0x6060, 0].value, od[0x60C0, 0].value) == (7, -2)


def test_nothing_is_written_that_the_maker_does_not_have() -> None:
    made = bench(Copley(2))
    refused = [
        struct.unpack_from("<HB", frame.data, 1)
        for _, frame, _ in made.frames
        if frame.can_id == SDO_ANSWER + 2 and frame.data[0] == 0x80
    ]
    assert set(refused) == {(i, n) for i in (0x608F, 0x6091, 0x6092) for n in (1, 2)}  # looked for


def test_a_desired_state_that_ignores_motion_is_put_right() -> None:
    drive = Copley(2)
    drive.dictionary[0x2300, 0].value = 21
    made = bench(drive)
    assert drive.dictionary[0x2300, 0].value == 30
    made.enable()
    made.wait(made.machine.move_to({"z1": 0.5}))


def test_latched_faults_are_cleared() -> None:
    drive = Copley(2)
    drive._latch(9, 0x8611)
    assert drive.status_word & 0x4F == 0x08
    made = bench(drive)
    assert drive.faults == 0
    made.enable()
    assert made.group.phase is Phase.STANDING


def test_latched_faults_that_stay_are_told_in_words() -> None:
    line = refusal(Copley(2, stuck_faults=1 << 4 | 1 << 7))
    assert line == (
        "z1 (node 2) keeps latched faults: motor over-temperature, feedback (0x00000090); put "
        "right what they say, then switch it off and on again"
    )


@pytest.mark.parametrize(
    "factors",
    [
        {0x608F: (1, 1), 0x6091: (1, 1), 0x6092: (1, 1)},
        {0x608F: (4000, 1), 0x6091: (1, 1), 0x6092: (4000, 1)},
        {0x608F: (2, 1), 0x6091: (1, 2)},
    ],
)
def test_factors_that_leave_counts_are_taken(factors: dict[int, tuple[int, int]]) -> None:
    bench(Copley(2, factors=factors)).enable()


@pytest.mark.parametrize("factors", [{0x6091: (100, 1)}, {0x608F: (1, 0)}, {0x6092: (360, 1)}])
def test_other_factors_are_refused_in_words(factors: dict[int, tuple[int, int]]) -> None:
    line = refusal(Copley(2, factors=factors))
    ((index, (above, below)),) = factors.items()
    assert line.startswith("z1 (node 2) does not count in counts of its encoder: ")
    assert f"(0x{index:04X}-00) is {above}/{below}; set them all to 1/1" in line


def test_limits_that_its_signed_objects_do_not_hold_are_refused() -> None:
    fastest = (2**23 - 1) / 0.255 / (2000 / 6.283185307179586)  # its longest segment has 24 bits
    with pytest.raises(ConfigurationError, match="axes.z1.max_velocity"):
        bench(Copley(2), max_velocity=fastest * 1.01)
    bench(Copley(2), max_velocity=fastest * 0.99)


# --- guarding -----------------------------------------------------------------------------------


def requests(made: Bench, node_id: int) -> list[float]:
    return [t for t, f, echo in made.frames if echo and f.remote and f.can_id == 0x700 + node_id]


def test_it_is_asked_for_as_long_as_the_driver_runs_and_answers_with_the_toggle_bit() -> None:
    made = bench(Copley(2), Copley(3))
    made.enable()
    made.frames.clear()
    made.run(3.0)
    for node_id in (2, 3):
        asked = requests(made, node_id)
        assert len(asked) >= 30
        assert max(b - a for a, b in zip(asked, asked[1:], strict=False)) < 100e3
        answers = [f.data for _, f, echo in made.frames if f.can_id == 0x700 + node_id and not echo]
        assert {data[0] & 0x7F for data in answers} == {0x05}
        toggles = [data[0] >> 7 for data in answers]
        assert all(a != b for a, b in zip(toggles, toggles[1:], strict=False))
    assert made.group.phase is Phase.STANDING


def test_without_the_host_it_stops_by_itself() -> None:
    drive = Copley(2)
    made = bench(drive)
    made.enable()
    made.machine.move_to({"z1": 100.0})
    made.run(1.0)
    made.bus.run_until(made.now_us + LIFE_US + 100e3, lambda *frame: None)  # nobody asks
    assert drive.status_word & 0x4F == 0x08


def test_a_host_that_comes_back_brings_it_up_again() -> None:
    drive = Copley(2)
    made = bench(drive)
    made.enable()
    made.bus.run_until(made.now_us + 2 * LIFE_US, lambda *frame: None)
    again = bench(drive)
    again.enable()
    again.run(2.0)
    assert again.group.phase is Phase.STANDING


def test_beside_drives_that_hear_heartbeats() -> None:
    axes = (AxisConfig("x", 1), axis("z", 2))
    made = Bench(DriverConfig(axes=axes), [Epos2(1), Copley(2)])  # type: ignore[list-item]
    made.enable()
    made.run(2.0)
    assert made.group.phase is Phase.STANDING
    assert requests(made, 2) and not requests(made, 1)
