"""The driver with simulated CL3-E drives: bring-up, and the handshake of a move frame by frame."""

from __future__ import annotations

import configparser
import itertools
import math
from importlib import resources

import canopen
import pytest
from simulated_time import Bench

from epos2_ros.bus.nodes import check
from epos2_ros.bus.settings import machine_of
from epos2_ros.configuration.driver import AxisConfig, DriverConfig, HomingConfig
from epos2_ros.errors import ConfigurationError, DriveError, MotionAborted
from epos2_ros.protocol import cl3e
from epos2_ros.protocol.phase import Phase
from epos2_ros.sim.cl3e import Cl3e, Firmware
from epos2_ros.sim.homing import Switches

LIMITS = {"max_velocity": 1.0, "max_acceleration": 4.0}
EDS = resources.files("epos2_ros") / "eds" / "cl3e.eds"


def axis(node_id: int = 1, **changes: object) -> AxisConfig:
    settings = {"gear_ratio": 100.0, "counts_per_turn": 2000, **LIMITS, **changes}
    return AxisConfig(f"z_{node_id}", node_id, drive="cl3e", **settings)  # type: ignore[arg-type]


def bench(*drives: Cl3e, bring_up: bool = True, **changes: object) -> Bench:
    config = DriverConfig(axes=tuple(axis(drive.node_id, **changes) for drive in drives))
    made = Bench(config, drives, bring_up=False)  # type: ignore[arg-type]
    made.bus.run_until(400e3, lambda *frame: None)
    if bring_up:
        made.bring_up()
    return made


# --- bring-up -----------------------------------------------------------------------------------


@pytest.mark.parametrize("firmware", Firmware)
def test_bring_up_with_every_edition(firmware: Firmware) -> None:
    drive = Cl3e(1, position=-77, firmware=firmware)
    counts = 3600 if firmware is Firmware.V1738 else 2000
    made = bench(drive, counts_per_turn=counts, stop_deceleration=9.0)
    od = drive.dictionary
    assert od[0x607A, 0].value == -77  # not its preset of 4000
    assert od[0x3202, 0].value == 0
    assert (od[0x6060, 0].value, drive._mode) == (1, 1)
    assert od[0x6082, 0].value == 0 and od[0x605A, 0].value == 6
    per_rpm = 1 if firmware is Firmware.V1738 else 100
    assert od[0x60C6, 0].value >= 4.0 * 100 / (2 * 3.14159265) * 60 * per_rpm  # [0.01] rpm/s
    mapped = {
        od[0x1600 + n, place].value >> 16
        for n in range(4)
        if not od[0x1400 + n, 1].value >> 31
        for place in range(1, od[0x1600 + n, 0].value + 1)
    }
    assert mapped == {0x6040, 0x607A, 0x6081, 0x6083, 0x6084}  # 0x3202 could select open loop
    made.enable()
    made.wait(made.machine.move_to({"z_1": 0.5}))
    assert drive.position_actual == round(0.5 * counts * 100 / (2 * 3.14159265358979))


def test_units_stored_by_somebody_are_refused_in_words() -> None:
    for index, subindex, value, words in (
        (0x2062, 0, 1, r"has 1/1 in Velocity Unit Numerator \(0x2061-00\) .*takes 1/60 only"),
        (0x2063, 0, 5, r"has 5/60 in Acceleration Unit Numerator .*1/60 only"),
        (0x6091, 1, 7, r"has 7/1 in Gear Ratio.*1/1 only"),
        (0x6092, 2, 3, r"has 1/3 in Feed Constant.*1/1 only"),
        (0x608F, 1, 4096, r"counts 4096 per turn .*0x608F-01\).*not 2000: set axes\.z_1\.counts"),
    ):
        drive = Cl3e(1)
        drive.dictionary[index, subindex].value = value
        with pytest.raises(DriveError, match=words):
            bench(drive)
    with pytest.raises(DriveError, match=r"counts 3600 per turn .*0x60A8.*not 2000"):
        bench(Cl3e(1, firmware=Firmware.V1738))


def test_equal_fractions_are_equal() -> None:
    drive = Cl3e(1)
    drive.dictionary[0x2061, 0].value, drive.dictionary[0x2062, 0].value = 2, 120
    bench(drive)


def ramps_of(drive: Cl3e) -> dict[tuple[int, int], float]:
    """What the drive holds of velocities and accelerations, in turns and seconds."""
    od = drive.dictionary
    return {
        (index, subindex): od[index, subindex].value * od[unit, 0].value / od[unit + 1, 0].value
        for unit, keys in (
            (0x2061, ((0x6081, 0), (0x6099, 1), (0x6099, 2))),
            (0x2063, ((0x6083, 0), (0x6084, 0), (0x6085, 0), (0x609A, 0), (0x60C6, 0))),
        )
        for index, subindex in keys
    }


def test_a_drive_is_as_fast_as_it_was_in_finer_units() -> None:
    """Also when it is brought up again."""
    drive = Cl3e(1)
    drive.dictionary[0x6085, 0].value = 777
    before = ramps_of(drive)
    for _ in range(2):
        bench(drive, max_acceleration=None)
        assert ramps_of(drive) == pytest.approx(before)
        assert drive.dictionary[0x2062, 0].value == drive.dictionary[0x2064, 0].value == 6000


def test_units_that_a_host_has_left_half_way_are_those_that_the_drive_has_stored() -> None:
    whole = bench(Cl3e(1))
    writes = [
        frame.data
        for _, frame, echo in whole.frames
        if echo and frame.can_id == 0x601 and frame.data[0] & 0xE0 == 0x20
    ]
    first = next(n for n, data in enumerate(writes) if data[1:3] == b"\x61\x20")
    last = max(n for n, data in enumerate(writes) if data[1:3] == b"\x63\x20")
    before = ramps_of(Cl3e(1))
    for count in range(first, last + 2):
        drive = Cl3e(1)
        od = drive.dictionary
        for data in writes[first:count]:
            index, size = int.from_bytes(data[1:3], "little"), 4 - (data[0] >> 2 & 3)
            od[index, data[3]].value = int.from_bytes(data[4 : 4 + size], "little")
        bench(drive, max_acceleration=None)
        assert ramps_of(drive) == pytest.approx(before)
        assert od[0x2061, 0].value == od[0x2063, 0].value == 1
    drive.dictionary[0x2061, 0].preset(3)
    with pytest.raises(DriveError, match="has 3/60 in .*: set it and store it"):
        bench(drive)


@pytest.mark.parametrize("parameter", ["max_velocity", "max_acceleration", "stop_deceleration"])
def test_what_the_drive_can_t_hold_is_refused(parameter: str) -> None:
    config = axis(**{parameter: 1e12})
    with pytest.raises(ConfigurationError, match=rf"axes\.z_1\.{parameter}: 1e\+12 rad/s"):
        check(config, DriverConfig(axes=(config,)))


def test_every_object_of_bring_up_can_be_refused_in_one_line() -> None:
    class Shut(Cl3e):
        refuses: tuple[int, int] = (0, 0)

    asked = set()
    made = bench(Cl3e(1))
    for _, frame, echo in made.frames:
        if echo and frame.can_id == 0x601 and frame.data[0] & 0xE0 == 0x20:
            asked.add((int.from_bytes(frame.data[1:3], "little"), frame.data[3]))
    assert len(asked) > 30
    for index, subindex in sorted(asked - {(0x1017, 0)})[::4]:
        drive = Cl3e(1)
        drive.dictionary[index, subindex].access = "ro"
        with pytest.raises(DriveError) as refusal:
            bench(drive)
        line = str(refusal.value)
        assert "\n" not in line and line.startswith("z_1 (node 1): can't ")
        assert "refuses it" in line


# --- the handshake, frame by frame --------------------------------------------------------------


def test_a_move_s_frames() -> None:
    drive = Cl3e(1, lag_ms=0.0)
    made = bench(drive)
    made.enable()
    made.run(0.2)
    made.frames.clear()
    made.wait(made.machine.move_to({"z_1": 0.1}))
    told = []
    for _, frame, echo in made.frames:
        word = int.from_bytes(frame.data[:2], "little")
        if echo and frame.can_id in (0x301, 0x501):
            told.append((frame.can_id, word))
        elif frame.can_id == 0x181:
            told.append((frame.can_id, word & 0x1400))
        elif frame.can_id == 0x080 and told and told[-1][0] == 0x301:
            told.append((0x080, 0))
    assert told[:6] == [
        (0x501, 0x000F),  # bit 4 is clear
        (0x301, 0x003F),  # new set-point, immediately: waits for the SYNC
        (0x080, 0),
        (0x181, 0x1000),  # acknowledged, target not reached
        (0x501, 0x000F),  # bit 4 is released
        (0x181, 0x0000),  # another one could come
    ]
    assert told[-1] == (0x181, 0x0400)
    writes = [
        int.from_bytes(frame.data[1:3], "little")
        for _, frame, echo in made.frames
        if echo and frame.can_id == 0x601
    ]
    assert 0x607A in writes and 0x6081 in writes  # written before the start


@pytest.mark.parametrize("stop", ["halt", "quick_stop", "disable"])
@pytest.mark.parametrize("after_s", [0.001, 0.1, 0.3])
def test_a_move_is_stopped_and_does_not_go_on(stop: str, after_s: float) -> None:
    drive = Cl3e(1)
    made = bench(drive, stop_deceleration=8.0)
    made.enable()
    made.machine.move_to({"z_1": 0.5})
    made.run(after_s)
    request = {
        "halt": made.group.halt,
        "quick_stop": made.group.quick_stop,
        "disable": made.path.disable,
    }[stop]()
    made.run(5.0, request.done)
    made.run(1.0)
    here = drive.position_demand
    assert made.group.phase in (Phase.STANDING, Phase.DISABLED)
    made.wait(made.group.enable())
    made.run(1.0)
    assert drive.position_demand == here
    made.wait(made.machine.move_to({"z_1": 0.1}))
    assert drive.position_demand == round(0.1 * 2000 * 100 / (2 * 3.14159265358979))


def test_a_set_point_that_is_not_taken_is_said() -> None:
    drive = Cl3e(1)
    made = bench(drive)
    made.enable()
    drive.dictionary[0x607B, 2].value = 10  # somebody else's limit
    with pytest.raises(MotionAborted, match=r"set-point not acknowledged \(bit 12\): z_1"):
        made.wait(made.machine.move_to({"z_1": 0.5}))


def test_a_blocked_axis_in_closed_loop_is_a_fault() -> None:
    drive = Cl3e(1)
    made = bench(drive)
    drive.dictionary[0x3202, 0].value = 1
    made.enable()
    drive.block_rotor()
    with pytest.raises(MotionAborted, match="following error"):
        made.wait(made.machine.move_to({"z_1": 0.5}))


# --- the EDS ------------------------------------------------------------------------------------


def test_the_eds_is_as_the_simulated_drive() -> None:
    dictionary = canopen.import_od(str(EDS), 5)
    old, new = Cl3e(5).dictionary, Cl3e(5, firmware=Firmware.V1738).dictionary
    for thing in dictionary.values():
        variable = isinstance(thing, canopen.objectdictionary.ODVariable)
        for part in [thing] if variable else thing.values():
            key = part.index, part.subindex
            entry = old[key] if key in old else new[key]
            if entry.type.size:
                assert len(part) == 8 * entry.type.size, f"{key[0]:04X}-{key[1]:02X}"
            readable = part.access_type in ("ro", "const")
            assert readable == (entry.access in ("ro", "const")), f"{key[0]:04X}-{key[1]:02X}"
            if part.default is not None and part.data_type != 9:
                assert part.default == entry.default or key[0] >> 8 in (0x14, 0x18), part.name
    for mapping in (*cl3e.FAMILY.rpdos, *cl3e.FAMILY.tpdos):
        assert all(old[key].mappable for key in mapping.objects)


def test_object_lists_name_every_section_once() -> None:
    """CiA 306."""
    sections = configparser.RawConfigParser()
    sections.read_string(EDS.read_text(encoding="ascii"))
    listed: list[int] = []
    for name in ("MandatoryObjects", "OptionalObjects", "ManufacturerObjects"):
        section = sections[name]
        numbers = range(1, int(section["SupportedObjects"]) + 1)
        listed += [int(section[str(n)], 16) for n in numbers]
        assert len(section) == len(numbers) + 1
    described = {n[:4] for n in sections.sections() if n[:4].isalnum() and n[0] in "1236"}
    assert sorted(f"{index:04X}" for index in listed) == sorted(described)


# --- homing -------------------------------------------------------------------------------------

SWITCHES = Switches(negative_limit=-9000, positive_limit=9000, home=(2000, 2600), index=150)
QC_PER_RAD = 2000 * 100 / (2 * math.pi)


def homing_bench(method: str, **changes: object) -> Bench:
    homing = HomingConfig(
        method, speeds=(0.2, 0.05), acceleration=2.0, max_travel=2.0, **changes  # type: ignore
    )
    made = bench(Cl3e(1, switches=SWITCHES), homing=homing)
    made.enable()
    return made


@pytest.mark.parametrize(
    ("method", "place"),
    [
        ("negative_limit_switch", -9000), ("positive_limit_switch_index", 8150),
        ("home_switch_positive", 2000), ("home_switch_negative_index", 4150),
        ("index_negative", -1850), ("here", 0),
    ],
)  # fmt: skip
def test_an_axis_is_where_it_is_said_to_be_when_homed(method: str, place: int) -> None:
    """The home is at `offset`, the axis brakes beyond it; nothing moves on from there."""
    made = homing_bench(method, offset=0.5)
    drive = made.drives[0]
    made.frames.clear()
    made.wait(made.machine.home([0]))
    made.run(1.0)
    assert drive.position_actual - drive._machine_zero == pytest.approx(place, abs=150)
    home = place + drive._machine_zero  # in the axis' new coordinates
    assert home == pytest.approx(0.5 * QC_PER_RAD, abs=1)
    assert made.machine.drives[0].homed == method
    assert made.group.phase is Phase.STANDING and drive._mode == 1
    words = [
        int.from_bytes(frame.data, "little") & 0x3400
        for _, frame, echo in made.frames
        if frame.can_id == 0x181 and not echo
    ]
    told = [key for key, _ in itertools.groupby(words)]
    assert told[told.index(0x1000) :][:2] == [0x1000, 0x1400]  # attained, then done
    starts = [
        int.from_bytes(frame.data, "little")
        for _, frame, echo in made.frames
        if echo and frame.can_id in (0x301, 0x501)
    ]
    assert starts[:3] == [0x0F, 0x1F, 0x0F]  # bit 4 rises, and stays until it is done
    made.wait(made.machine.move_to({"z_1": 0.1}))
    assert drive.position_actual == round(0.1 * QC_PER_RAD)


def test_ways_homing_fails() -> None:
    made = homing_bench("home_switch_positive")
    made.drives[0]._switches = Switches(negative_limit=-3000, positive_limit=3000)
    with pytest.raises(MotionAborted, match=r"z_1 .*home_switch_positive failed at .*bit 13"):
        made.wait(made.machine.home([0]))
    made = homing_bench("negative_limit_switch")
    made.drives[0]._switches = Switches()
    with pytest.raises(MotionAborted, match=r"z_1 .*negative_limit_switch .*max_travel"):
        made.wait(made.machine.home([0]))
    made.run(2.0)
    here = made.drives[0].position_actual
    assert abs(here) < 2.2 * QC_PER_RAD
    made.run(1.0)
    assert made.drives[0].position_actual == here


def test_homing_that_is_stopped_is_interrupted() -> None:
    made = homing_bench("negative_limit_switch")
    motion = made.machine.home([0])
    made.run(0.6)
    made.wait(made.group.halt(), 10.0)
    assert isinstance(motion.exception(timeout=0), MotionAborted)
    here = made.drives[0].position_actual
    made.wait(made.group.enable())
    made.run(1.0)
    assert made.drives[0].position_actual == here
    assert not made.machine.drives[0].homed


def test_what_it_has_not_for_homing_is_refused() -> None:
    for homing, words in (
        (HomingConfig("hard_stop_negative"), "Nanotec's drives have .*home_switch"),
        (HomingConfig("index_positive", back_off=0.1), "back_off is 0.1; Nanotec's drives do not"),
    ):
        with pytest.raises(ConfigurationError, match=words):
            machine_of(DriverConfig(axes=(axis(homing=homing),)))
