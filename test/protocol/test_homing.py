"""Homing and point-to-point moves of EPOS2 axes, in simulated time.

Where an axis ends is worked out here from the machine's switches and maxon's definitions: 0x607C
moves the axis on from its home, and the place is then called 0x2081.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from simulated_time import Bench, axes

from epos2_ros.bus.settings import machine_of
from epos2_ros.configuration.driver import AxisConfig, DriverConfig, HomingConfig
from epos2_ros.errors import ConfigurationError, MotionAborted, TrajectoryError
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.protocol.phase import Phase
from epos2_ros.sim.cl3e import Cl3e
from epos2_ros.sim.copley import Copley
from epos2_ros.sim.epos2 import Epos2
from epos2_ros.sim.homing import Switches

QC_PER_RAD = 2000 * 100 / (2 * math.pi)
SWITCHES = Switches(
    negative_limit=-9000, positive_limit=9000, home=(2000, 2600), index=150,
    negative_stop=-8_500, positive_stop=8_500,
)  # fmt: skip
LIMITS = {"max_velocity": 2.0, "max_acceleration": 8.0}


def homing(method: str, **changes) -> HomingConfig:
    return HomingConfig(method, speeds=(0.2, 0.05), acceleration=2.0, max_travel=2.0, **changes)


def made_bench(*homings: HomingConfig | None, switches: Switches = SWITCHES, **settings) -> Bench:
    made = axes(len(homings), **LIMITS, **settings)
    config = DriverConfig(
        axes=tuple(replace(a, homing=h) for a, h in zip(made, homings, strict=True))
    )
    drives = [
        Epos2(n, drift_ppm=30.0 * (-1) ** n, switches=switches, record=True)
        for n in range(1, len(homings) + 1)
    ]
    bench = Bench(config, drives)
    bench.enable()
    return bench


def home(bench: Bench, seconds: float = 60.0) -> None:
    """As `Driver.home`."""
    for drives in bench.machine.homing_orders():
        places = [bench.machine.drives.index(drive) for drive in drives]
        bench.wait(bench.machine.home(places), seconds)
    bench.run(5.0, lambda: bench.group.phase is Phase.STANDING)


def limits_of(drive: Epos2) -> tuple[int, int]:
    read = (drive.dictionary[0x607D, n].pack() for n in (1, 2))
    return tuple(int.from_bytes(data, "little", signed=True) for data in read)  # type: ignore


# By name, where the machine's place is [qc] at which the drive finds home, and its direction.
PLACES = {
    "current_threshold_negative": (-8_500, -1),
    "current_threshold_positive": (8_500, 1),
    "negative_limit_switch": (-9000, -1),
    "positive_limit_switch": (9000, 1),
    "home_switch_positive": (2000, 1),
    "home_switch_negative": (2600, -1),
    "index_positive": (150, 1),
    "index_negative": (-1850, -1),
    "negative_limit_switch_index": (-7850, -1),
    "home_switch_positive_index": (150, 1),
    "current_threshold_negative_index": (-7850, -1),
}


@pytest.mark.parametrize("back_off", [0.0, 0.01])
@pytest.mark.parametrize("method", PLACES)
def test_an_axis_is_where_it_is_said_to_be_when_homed(method, back_off):
    """`offset` is the position at the end, `back_off` the way from the home to there."""
    bench = made_bench(homing(method, offset=0.5, back_off=back_off), None)
    before = limits_of(bench.drives[0])
    machine_zero = bench.drives[0]._machine_zero
    home(bench)
    place, direction = PLACES[method]
    drive = bench.drives[0]
    called = round(0.5 * QC_PER_RAD)
    assert drive.position_demand == pytest.approx(called, abs=1)
    # in the machine's own coordinates it stands where its home is, less the way it backed off
    at = drive.position_demand - (drive._machine_zero - machine_zero)
    assert at == pytest.approx(place - direction * back_off * QC_PER_RAD, abs=25)  # a cycle's way
    assert bench.machine.drives[0].homed == method
    assert not bench.machine.drives[1].homed
    assert limits_of(drive) == before  # soft limits are on again
    assert bench.group.phase is Phase.STANDING
    # and the next trajectory starts from there
    there = np.array([[0.5, 0.0], [0.6, 0.1]])
    bench.path.submit(
        Trajectory(("joint_1", "joint_2"), np.array([0.0, 1.0]), there), None, bench.now_us
    )
    bench.wait(bench.group.motion)
    assert bench.drives[0].position_demand == pytest.approx(0.6 * QC_PER_RAD, abs=1)


def test_here_moves_nothing():
    bench = made_bench(HomingConfig("here", offset=-1.0))
    home(bench)
    drive = bench.drives[0]
    assert drive.position_demand == round(-1.0 * QC_PER_RAD)
    assert drive.position_demand - drive._machine_zero == 0


def test_the_lowest_order_is_first_and_equal_ones_start_together():
    bench = made_bench(
        homing("index_positive", order=1),
        homing("current_threshold_negative", order=0),
        homing("index_negative", order=1),
    )
    orders = bench.machine.homing_orders()
    assert [[drive.joint for drive in order] for order in orders] == [
        ["joint_2"],
        ["joint_1", "joint_3"],
    ]
    bench.frames.clear()
    home(bench)
    starts = [(t, f.can_id & 0x7F) for t, f, e in bench.frames if f.data == b"\x1f\x00" and e]
    assert [node for _, node in starts] == [2, 1, 3]
    syncs = [t for t, f, _ in bench.frames if f.can_id == 0x080]
    after = [min(s for s in syncs if s > t) for t, _ in starts]
    assert after[0] < after[1] == after[2]


def test_a_dead_switch_does_not_send_the_axis_to_the_far_end():
    bench = made_bench(
        replace(homing("current_threshold_negative"), max_travel=0.3), switches=Switches()
    )
    with pytest.raises(MotionAborted, match=r"joint_1 .* current_threshold_negative .*max_travel"):
        home(bench)
    bench.run(2.0)
    assert bench.group.phase is Phase.FAULT
    assert abs(bench.drives[0].position_demand) < 0.4 * QC_PER_RAD
    assert not bench.machine.drives[0].homed
    way_back(bench)


def test_a_search_that_takes_too_long_is_stopped():
    """The way is too long for its bound only at the speed that was asked for."""
    slow = replace(homing("current_threshold_negative"), speeds=(0.01, 0.01), max_travel=0.05)
    bench = made_bench(slow, switches=Switches())
    bench.drives[0]._switch_speed.value = 0
    motion = bench.machine.home([0])
    bench.drives[0]._switch_speed.check = None
    bench.run(60.0, motion.done)
    assert isinstance(motion.exception(timeout=0), MotionAborted)
    assert "homing by current_threshold_negative failed" in str(motion.exception())


def test_nothing_is_due_for_an_axis_that_is_home_while_another_still_searches():
    near = replace(homing("index_positive"), speeds=(0.2, 0.2), max_travel=0.05)
    slow = replace(homing("current_threshold_negative"), speeds=(0.02, 0.02))
    bench = made_bench(near, slow)
    steps, advance = [], bench.machine.advance

    def counting(now_us: float) -> None:
        steps.append(now_us)
        assert len(steps) < 20_000, f"not waiting any more at {now_us / 1e6:.1f} s"
        advance(now_us)

    bench.machine.advance = counting
    home(bench)
    took_s = (steps[-1] - steps[0]) / 1e6
    assert took_s > 10 + 3 * 0.05 / 0.2  # longer than the first would have been waited for


def test_a_limit_switch_before_the_home_is_a_homing_error():
    dead_home = replace(SWITCHES, home=(math.inf, -math.inf))
    bench = made_bench(homing("home_switch_positive"), switches=dead_home)
    with pytest.raises(MotionAborted, match=r"joint_1 .*home_switch_positive failed at .*bit 13"):
        home(bench)
    way_back(bench)


@pytest.mark.parametrize("stop", ["halt", "quick_stop", "disable"])
def test_a_search_is_stopped_on_request_and_can_be_begun_again(stop):
    bench = made_bench(homing("current_threshold_negative"), None)
    motion = bench.machine.home([0])
    bench.run(0.6)
    assert bench.group.phase is Phase.MOVING
    request = {
        "halt": bench.group.halt,
        "quick_stop": bench.group.quick_stop,
        "disable": bench.path.disable,
    }[stop]()
    bench.wait(request, 10.0)
    assert motion.exception(timeout=0) is not None
    here = bench.drives[0].position_demand
    bench.run(1.0)
    assert bench.drives[0].position_demand == here
    bench.wait(bench.group.enable())
    assert not bench.machine.drives[0].homed
    home(bench)
    assert bench.machine.drives[0].homed


def way_back(bench: Bench) -> None:
    bench.wait(bench.group.reset_fault())
    bench.wait(bench.group.enable())
    bench.wait(bench.machine.move_to({"joint_1": 0.1}))
    assert bench.drives[0].position_demand == round(0.1 * QC_PER_RAD)


def test_a_trajectory_while_homing_is_refused_and_the_search_goes_on():
    bench = made_bench(homing("current_threshold_negative"))
    motion = bench.machine.home([0])
    bench.run(0.6)
    with pytest.raises(TrajectoryError, match="can't move: the drives are moving"):
        point = Trajectory(("joint_1",), np.array([1.0]), np.array([[0.1]]))
        bench.path.submit(point, None, bench.now_us)
    bench.wait(motion)


def test_an_axis_that_has_to_be_homed_does_not_move_before():
    bench = made_bench(homing("current_threshold_negative", required=True), None)
    point = Trajectory(("joint_1", "joint_2"), np.array([0.0, 1.0]), np.zeros((2, 2)))
    words = "joint 'joint_1' is not referenced: home it first"
    with pytest.raises(TrajectoryError, match=words):
        bench.path.submit(point, None, bench.now_us)
    with pytest.raises(TrajectoryError, match=words):
        bench.machine.move_to({"joint_1": 0.1})
    bench.wait(bench.machine.move_to({"joint_2": 0.1}))
    home(bench)
    bench.wait(bench.machine.move_to({"joint_1": 0.1, "joint_2": 0.0}))
    # after a power cycle it is not referenced any more
    bench.drives[0].power_off()
    bench.drives[0].power_on(bench.now_us)
    bench.run(2.0)
    for index in bench.lost():
        bench.bring_up_drive(index)
    bench.group.start_clock(bench.now_us, bytes(6))
    bench.wait(bench.group.reset_fault())
    bench.wait(bench.group.enable())
    with pytest.raises(TrajectoryError, match=words):
        bench.machine.move_to({"joint_1": 0.2})


@pytest.mark.parametrize(
    ("drive", "method", "words"),
    [
        ("epos2", "hard_stop_negative", "maxon's drives have .*current_threshold_negative"),
        ("epos2", "-5", "maxon's drives have"),
        ("copley", "current_threshold_negative", "Copley's drives have .*hard_stop_negative"),
    ],
)
def test_a_method_that_a_family_does_not_have_is_refused(drive, method, words):
    axis = AxisConfig("x", 1, drive=drive, homing=HomingConfig(method))
    with pytest.raises(
        ConfigurationError, match=rf"axes\.x\.homing\.method is '{method}'; .*{words}"
    ):
        machine_of(DriverConfig(axes=(axis,)))


# ---------------------------------------------------------------------------- Copley


def copley_bench(method: str, switches: Switches = SWITCHES, **changes) -> Bench:
    axis = AxisConfig(
        "x", 1, drive="copley", counts_per_turn=2000, gear_ratio=100.0, **LIMITS,
        homing=homing(method, **changes),
    )  # fmt: skip
    bench = Bench(DriverConfig(axes=(axis,)), [Copley(1, switches=switches)])
    bench.enable()
    return bench


COPLEY_PLACES = {
    "hard_stop_positive": (-1, 8_500),
    "hard_stop_negative": (-2, -8_500),
    "hard_stop_positive_index": (-3, 8_150),
    "hard_stop_negative_index": (-4, -7_850),
    "negative_limit_switch": (17, -9000),
    "home_switch_positive_index": (7, 150),
    "index_negative": (33, -1850),
    "here": (35, 0),
}


@pytest.mark.parametrize("method", COPLEY_PLACES)
def test_a_copley_axis_is_where_it_is_said_to_be_when_homed(method):
    """Its −1 and −2 are hard stops without an index, −3 and −4 with; 0x607C moves nothing."""
    bench = copley_bench(method, offset=0.5)
    drive = bench.drives[0]
    before, told = limits_of(drive), len(bench.frames)
    home(bench)
    number, place = COPLEY_PLACES[method]
    written = [
        int.from_bytes(frame.data[4:5], "little", signed=True)
        for _, frame, echo in bench.frames[told:]
        if echo and frame.can_id == 0x601 and frame.data[1:3] == b"\x98\x60"
    ]
    assert written == [number]
    zero = drive._homing.machine_zero
    assert place + zero == pytest.approx(0.5 * QC_PER_RAD, abs=1)  # the home is at `offset`
    assert drive.position_actual - zero == pytest.approx(place, abs=150)  # braked beyond it
    here = drive.position_actual
    bench.run(1.0)
    assert drive.position_actual == here
    assert bench.machine.drives[0].homed == method and limits_of(drive) == before
    bench.wait(bench.machine.move_to({"x": 0.1}))
    assert drive.position_actual == round(0.1 * QC_PER_RAD)


def test_ways_a_copley_axis_fails_to_home():
    limits = Switches(negative_limit=-3000, positive_limit=3000)
    bench = copley_bench("home_switch_positive", limits)
    with pytest.raises(MotionAborted, match=r"x .*home_switch_positive failed at .*bit 13"):
        home(bench)
    bench = copley_bench("hard_stop_negative", Switches())
    with pytest.raises(MotionAborted, match=r"x .*hard_stop_negative .*max_travel"):
        home(bench)
    bench.run(2.0)
    here = bench.drives[0].position_actual
    assert abs(here) < 2.2 * QC_PER_RAD
    bench.run(1.0)
    assert bench.drives[0].position_actual == here
    with pytest.raises(ConfigurationError, match=r"back_off is 0.1; Copley's drives do not"):
        copley_bench("index_positive", back_off=0.1)


@pytest.mark.parametrize("stop", ["halt", "quick_stop", "disable"])
def test_a_copley_axis_stops_searching_on_request(stop):
    bench = copley_bench("negative_limit_switch")
    motion = bench.machine.home([0])
    bench.run(0.6)
    if stop == "disable":
        bench.wait(bench.group.halt())
    bench.wait(getattr(bench.group, stop)())
    bench.run(1.0)
    assert isinstance(motion.exception(timeout=0), MotionAborted)
    here = bench.drives[0].position_actual
    bench.wait(bench.group.enable())
    bench.run(1.0)
    assert bench.drives[0].position_actual == here
    assert not bench.machine.drives[0].homed
    home(bench)
    assert bench.machine.drives[0].homed == "negative_limit_switch"


# ---------------------------------------------------------------------------- point to point


def read(drive: Epos2 | Copley | Cl3e, index: int) -> int:
    return int.from_bytes(drive.dictionary[index, 0].pack(), "little", signed=True)


UNITS = {"epos2": 2000 / 60, "copley": 0.1, "cl3e": 2000 / 6000}  # of velocity [counts/s]


@pytest.mark.parametrize("duration_s", [0.0, 1.37])
def test_axes_of_all_families_leave_on_one_sync_and_arrive_within_a_millisecond(duration_s):
    epos2s = axes(3, **LIMITS)
    others = tuple(
        AxisConfig(f"z_{n}", n, drive=drive, counts_per_turn=2000, gear_ratio=100.0, **LIMITS)
        for n, drive in ((4, "copley"), (5, "copley"), (6, "cl3e"), (7, "cl3e"))
    )
    config = DriverConfig(axes=epos2s + others)
    drives = [Epos2(n, record=True) for n in (1, 2, 3)]
    drives += [Copley(4), Copley(5), Cl3e(6, boot_ms=0.0), Cl3e(7, boot_ms=0.0)]
    bench = Bench(config, drives)
    bench.enable()
    targets = {"joint_1": 1.0, "joint_2": -0.31, "joint_3": 0.05, "z_4": 0.7, "z_5": -0.021}
    targets |= {"z_6": -0.9, "z_7": 0.05}
    asked_us = bench.now_us
    motion = bench.machine.move_to(targets, duration_s)
    bench.run(1.0, lambda: bench.group.phase is Phase.MOVING)
    start_us = bench.machine.path_time.start_us
    assert start_us - asked_us < 0.25e6
    assert {drive.started_us for drive in drives[3:]} == {start_us}
    lasted = []
    for axis, drive in zip(config.axes, drives, strict=True):
        # What it was told: its way at this velocity [qc/s] and acceleration [qc/s²].
        way, v, a = (read(drive, index) for index in (0x607A, 0x6081, 0x6083))
        v, a = v * UNITS[axis.drive], a * (10 if axis.drive == "copley" else UNITS[axis.drive])
        assert way == round(targets[axis.joint] * QC_PER_RAD)
        peak = min(v, math.sqrt(abs(way) * a))
        lasted.append(abs(way) / peak + peak / a)
        assert v <= LIMITS["max_velocity"] * QC_PER_RAD * 1.01
    # 1 rad at 2 rad/s and 8 rad/s² takes 1/2 + 2/8 s
    assert lasted == pytest.approx([max(0.75, duration_s)] * 7, abs=1e-3)
    assert max(lasted) - min(lasted) <= 1e-3
    bench.wait(motion)
    assert bench.group.phase is Phase.STANDING
    arrived = [(drive.arrived_us - start_us) / 1e6 for drive in drives[3:]]
    # each looks once in its cycle, of 250 µs and of 1 ms
    assert arrived == pytest.approx([max(0.75, duration_s)] * 4, abs=1.6e-3)
    for axis, drive in zip(config.axes, drives, strict=True):
        assert drive.position_actual == pytest.approx(targets[axis.joint] * QC_PER_RAD, abs=1)
    there = Trajectory(
        tuple(targets), np.array([0.0, 1.0]), np.array([list(targets.values()), [0.0] * 7])
    )  # fmt: skip
    bench.path.submit(there, None, bench.now_us)
    bench.wait(bench.group.motion)


JERK = 40.0  # [rad/s³]


@pytest.mark.parametrize("duration_s", [0.0, 1.2])
@pytest.mark.parametrize(("reach", "fastest_s"), [(1.0, 0.95), (0.01, 0.2)])
def test_axes_with_limits_of_jerk_arrive_with_those_without(reach, fastest_s, duration_s):
    """At 40 rad/s³ the acceleration of 8 rad/s² takes 0.2 s, the velocity of 2 rad/s 0.45 s and
    1 rad 0.95 s. 0.01 rad takes 4 ∛(0.01 / 2 / 40) = 0.2 s and never all of the acceleration."""
    made = (
        AxisConfig(
            f"z_{n}", n, drive=drive, counts_per_turn=2000, gear_ratio=100.0, **LIMITS,
            max_jerk=JERK if n > 1 else None,
        )
        for n, drive in ((1, "epos2"), (2, "copley"), (3, "cl3e"))
    )  # fmt: skip
    drives = [Epos2(1, record=True), Copley(2), Cl3e(3, boot_ms=0.0)]
    bench = Bench(DriverConfig(axes=tuple(made)), drives)
    bench.enable()
    motion = bench.machine.move_to({"z_1": -reach / 5, "z_2": reach, "z_3": -reach}, duration_s)
    bench.run(1.0, lambda: bench.group.phase is Phase.MOVING)
    start_us = bench.machine.path_time.start_us
    bench.wait(motion)
    lasted_s = max(fastest_s, duration_s)
    arrived = [(drive.arrived_us - start_us) / 1e6 for drive in drives[1:]]
    assert arrived == pytest.approx([lasted_s] * 2, abs=2e-3)
    there = [drive.position_actual for drive in drives[1:]]
    assert there == [round(reach * QC_PER_RAD), round(-reach * QC_PER_RAD)]
    assert read(drives[1], 0x6086) == read(drives[2], 0x6086) == 3
    jerks = [int.from_bytes(drives[2].dictionary[0x60A4, n].pack(), "little") for n in range(1, 5)]
    scale = (fastest_s / lasted_s) ** 3
    assert read(drives[1], 0x2121) * 100 == pytest.approx(JERK * QC_PER_RAD * scale, rel=0.25)
    assert len(set(jerks)) == 1
    assert jerks[0] * 2000 / 60 == pytest.approx(JERK * QC_PER_RAD * scale, rel=0.25)


def test_a_limit_of_jerk_that_a_family_does_not_have_is_refused():
    axis = AxisConfig("x", 1, max_jerk=5.0)
    with pytest.raises(
        ConfigurationError, match=r"axes\.x\.max_jerk is 5; maxon's drives have no limit of jerk"
    ):
        machine_of(DriverConfig(axes=(axis,)))


def test_what_a_move_changes_for_interpolated_position_mode_is_as_before():
    """0x6081 and 0x6083 are its warnings, 0x6084 is its halt (the note, table 4)."""
    bench = made_bench(None, None, stop_deceleration=5.0)
    shared = [(0x6081, 0), (0x6083, 0), (0x6084, 0)]
    before = [bench.drives[0].dictionary[key].pack() for key in shared]
    bench.wait(bench.machine.move_to({"joint_1": 0.3}, 2.0))
    bench.run(2.0, lambda: bench.group.phase is Phase.STANDING)
    assert [bench.drives[0].dictionary[key].pack() for key in shared] == before


@pytest.mark.parametrize("stop", ["halt", "quick_stop", "disable", "stop"])
@pytest.mark.parametrize("after_s", [0.0, 0.001, 0.02, 0.1, 0.3, 0.5])
def test_a_move_is_stopped_at_every_instant_and_does_not_go_on(stop, after_s):
    bench = made_bench(None, None)
    bench.machine.move_to({"joint_1": 0.5, "joint_2": -0.5})
    bench.run(after_s)
    begun = bench.group.moving
    request = {
        "halt": bench.group.halt,
        "quick_stop": bench.group.quick_stop,
        "disable": bench.path.disable,
        "stop": bench.path.stop,
    }[stop]()
    if request is not None:
        bench.run(5.0, request.done)
    bench.run(1.0)
    here = [drive.position_demand for drive in bench.drives]
    if not begun:
        assert here == [0, 0]
    assert bench.group.phase in (Phase.STANDING, Phase.DISABLED)
    bench.wait(bench.group.enable())
    bench.run(1.0)
    assert [drive.position_demand for drive in bench.drives] == here
    bench.wait(bench.machine.move_to({"joint_1": 0.1, "joint_2": 0.1}))
    assert [drive.position_demand for drive in bench.drives] == [round(0.1 * QC_PER_RAD)] * 2


# ---------------------------------------------------------------------------- approach


def from_afar() -> Trajectory:
    points = np.array([[0.4, -0.2], [0.6, 0.0]])
    return Trajectory(("joint_1", "joint_2"), np.array([0.0, 3.0]), points, np.zeros((2, 2)))


def approaching() -> Bench:
    config = DriverConfig(axes=axes(2, **LIMITS), approach=True)
    bench = Bench(config, [Epos2(n, record=True) for n in (1, 2)])
    bench.enable()
    return bench


def test_a_trajectory_that_begins_elsewhere_is_approached():
    bench = approaching()
    execution = bench.path.submit(from_afar(), None, bench.now_us)
    bench.run(20.0, execution.ended.done)
    execution.ended.result(timeout=0)
    assert [drive.position_demand for drive in bench.drives] == [round(0.6 * QC_PER_RAD), 0]
    assert [event.kind for event in bench.events if event.kind == "started"] == ["started"] * 2
    # the records begin where the move has led
    path = np.array([q for _, q in bench.drives[0].recorder.executed()]) / QC_PER_RAD
    assert path[0] == pytest.approx(0.4, abs=1 / QC_PER_RAD)


@pytest.mark.parametrize("after_s", [0.0, 0.01, 0.1, 0.3, 0.6, 1.0])
def test_an_approach_is_stopped_as_every_motion(after_s):
    bench = approaching()
    execution = bench.path.submit(from_afar(), None, bench.now_us)
    bench.run(after_s)
    stopped = bench.path.stop()
    if stopped is not None:
        bench.run(5.0, stopped.done)
    bench.run(2.0)
    assert execution.ended.exception(timeout=0) is not None
    here = [drive.position_demand for drive in bench.drives]
    assert here != [round(0.6 * QC_PER_RAD), 0]
    bench.run(1.0)
    assert [drive.position_demand for drive in bench.drives] == here
    assert bench.group.phase is Phase.STANDING


def test_what_could_not_be_run_is_not_approached():
    bench = approaching()
    points = np.array([[0.4, -0.2], [3.0, 0.0]])  # too fast from there
    fast = Trajectory(("joint_1", "joint_2"), np.array([0.0, 0.5]), points, np.zeros((2, 2)))
    with pytest.raises(TrajectoryError, match="joint_1"):
        bench.path.submit(fast, None, bench.now_us)
    bench.run(1.0)
    assert [drive.position_demand for drive in bench.drives] == [0, 0]
