"""One trajectory over EPOS2 and Copley drives, in simulated time.

What each drive makes of what it was sent, at every millisecond, against the trajectory's own
polynomials; segments lost one by one; and all that a Copley drive says of its buffer.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from simulated_time import Bench, drive_of, makers
from six_axes import commanded_qc, executed, run_motion, there_and_back
from trajectories import example, polynomial

from epos2_ros.configuration.driver import AxisConfig, DriverConfig
from epos2_ros.errors import ConfigurationError, DriveError, MotionAborted, TrajectoryError
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.protocol.phase import Phase
from epos2_ros.sim.copley import Copley
from epos2_ros.sim.epos2 import Dictionary, Epos2

QC_PER_RAD = 2000 * 100 / (2 * math.pi)
SEGMENTS, ANSWER = 0x200, 0x580


def bench(*families: str, **settings: object) -> Bench:
    """Drives whose quartzes and clocks differ; the axes are enabled."""
    config = DriverConfig(axes=makers(*families), **settings)  # type: ignore[arg-type]
    drives = [
        drive_of(axis, drift_ppm=50.0 * (-1) ** n, offset_us=1e9 * n, record=True)
        for n, axis in enumerate(config.axes)
    ]
    made = Bench(config, drives)
    made.enable()
    return made


def errors_qc(made: Bench, duration_s: float = 2.0) -> list[float]:
    """Of `there_and_back`, the largest of each axis."""
    found = []
    for axis, drive in enumerate(made.drives):
        t_ms, demand = executed(drive)
        assert list(t_ms) == list(range(len(t_ms)))
        found.append(float(np.abs(demand - commanded_qc(t_ms, axis, duration_s)).max()))
    return found


def start_spread_us(made: Bench) -> float:
    starts = [drive.ip_start_us for drive in made.drives]
    return max(starts) - min(starts)


# --- one path ---------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["pick_place", "jerk_limited"])
def test_the_examples(name: str) -> None:
    """At every millisecond within a count of the quintics through the points."""
    trajectory = example(name)
    names = trajectory.joint_names
    families = ("epos2", "epos2", "copley", "epos2", "copley", "epos2")
    axes = tuple(
        replace(axis, joint=joint)
        for axis, joint in zip(makers(*families), names, strict=True)
    )
    drives = [drive_of(a, drift_ppm=40.0 - 20 * a.node_id, record=True) for a in axes]
    made = Bench(DriverConfig(axes=axes), drives)
    made.enable()
    made.path.submit(trajectory, None, made.now_us)
    made.wait(made.group.motion)
    assert start_spread_us(made) == 0.0
    times, p = trajectory.times_s, trajectory.positions
    v, a = trajectory.velocities, trajectory.accelerations
    assert v is not None and a is not None
    for column, drive in enumerate(made.drives):
        t_ms, demand = executed(drive)
        t = np.clip(t_ms / 1000 - 0.001, 0.0, times[-1])
        piece = np.clip(np.searchsorted(times, t, side="right") - 1, 0, len(times) - 2)
        commanded = np.empty(len(t))
        for i in np.unique(piece):
            ends = [(p[n, column], v[n, column], a[n, column]) for n in (i, i + 1)]
            here = piece == i
            commanded[here] = polynomial(ends, times[i + 1] - times[i])(t[here] - times[i])
        assert np.abs(demand - commanded * QC_PER_RAD).max() <= 1.0, names[column]


def test_motions_one_after_the_other_go_on_counting() -> None:
    made = bench("copley", "epos2")
    for _ in range(3):
        run_motion(made, there_and_back(joints=2))
        assert max(errors_qc(made)) <= 1.0
        assert start_spread_us(made) == 0.0
    drive = made.drives[0]
    assert (drive.pvt.refused, drive.pvt.ignored, drive.pvt.errors) == (0, 0, 0)
    assert drive.pvt.next_id > 3 * 10


def test_what_is_sent_first() -> None:
    """A 32-bit position, then segments that begin where the axis stands and are 255 ms at most."""
    made = bench("copley")
    run_motion(made, there_and_back(4.0, joints=1))
    sent = [f.data for _, f, echo in made.frames if echo and f.can_id == SEGMENTS + 1]
    assert [data[0] & 7 for data in sent] == [n % 8 for n in range(len(sent))]
    assert sent[0] == bytes([4 << 3]) + bytes(7)
    assert sent[1] == bytes([1 | 1 << 3, 1]) + bytes(6)  # holds for a millisecond
    assert all(data[0] >> 3 == 1 and 0 < data[1] <= 255 for data in sent[1:-1])  # 10 counts/s
    assert sent[-1][1:] == bytes(7)  # time 0, at rest where it began
    assert sum(data[1] for data in sent[1:]) == 4001


@pytest.mark.parametrize("turns", [-50.0, 50.0])
def test_travel_beyond_24_bits(turns: float) -> None:
    """10,000,000 counts out and back: absolute positions, then distances, then positions."""
    made = bench("copley", "epos2")
    reach = turns * 2 * math.pi
    there = Trajectory(
        ("joint_1", "joint_2"),
        np.array([0.0, 4.0]),
        np.array([[0.0, 0.0], [reach, 0.1]]),
        np.zeros((2, 2)),
        np.zeros((2, 2)),
    )
    made.path.submit(there, None, made.now_us)
    made.wait(made.group.motion)
    t_ms, demand = executed(made.drives[0])
    u = np.clip((t_ms - 1) / 4000, 0, 1)
    commanded = turns * 200_000 * (10 * u**3 - 15 * u**4 + 6 * u**5)
    assert np.abs(demand - commanded).max() <= 1.0
    assert made.drives[0].position_actual == turns * 200_000
    sent = [f.data[0] >> 3 for _, f, echo in made.frames if echo and f.can_id == SEGMENTS + 1]
    assert set(sent) >= {1, 3, 4}  # 10 counts/s: it is told no limit
    back = Trajectory(
        there.joint_names, there.times_s, there.positions[::-1], there.velocities,
        there.accelerations,
    )  # fmt: skip
    made.path.submit(back, None, made.now_us)
    made.wait(made.group.motion)
    assert made.drives[0].position_actual == 0


def test_fine_velocities_where_the_limit_leaves_them() -> None:
    axes = makers("copley", max_velocity=10.0)
    made = Bench(DriverConfig(axes=axes))
    made.enable()
    run_motion(made, there_and_back(joints=1))
    sent = [f.data for _, f, echo in made.frames if echo and f.can_id == SEGMENTS + 1]
    assert {data[0] >> 3 for data in sent} == {0, 4}


def test_clocks_stay_together_in_a_long_motion() -> None:
    made = bench("epos2", "copley", buffer_time=0.3)
    run_motion(made, there_and_back(20.0, joints=2))
    ends = [drive.recorder.time_us[-1] for drive in made.drives]
    assert abs(ends[0] - ends[1]) < 300.0  # by 100 ppm they would be 2 ms apart
    assert max(errors_qc(made, 20.0)) <= 1.0


def test_a_drive_is_the_clock_master_of_both_makers() -> None:
    config = DriverConfig(axes=makers("epos2", "copley"), sync_source="joint_1")
    note = Dictionary.NOTE  # such a drive can send its clock
    master = Epos2(1, dictionary=note, drift_ppm=50.0, record=True)
    made = Bench(config, [master, Copley(2, offset_us=1e9, drift_ppm=-50.0, record=True)])
    made.enable()
    run_motion(made, there_and_back(4.0, joints=2))
    assert max(errors_qc(made, 4.0)) <= 1.0
    ends = [drive.recorder.time_us[-1] for drive in made.drives]
    assert abs(ends[0] - ends[1]) < 300.0


# --- lost on the way --------------------------------------------------------------------------


def lose(drive: Epos2 | Copley, wanted: Callable[[bytes], bool]) -> list[bytes]:
    """The drive does not get those of the PDOs to its buffer that are `wanted`; which."""
    receive, lost = drive.receive, []

    def receiving(can_id: int, data: bytes, t_us: float, remote: bool = False) -> bool:
        if can_id == SEGMENTS + drive.node_id and wanted(data):
            lost.append(data)
            return True
        return receive(can_id, data, t_us, remote)

    drive.receive = receiving  # type: ignore[method-assign]
    return lost


def some(first: int, count: int = 1) -> Callable[[bytes], bool]:
    """So many of them, the `first` being 0."""
    seen = itertools.count()
    return lambda _: first <= next(seen) < first + count


@pytest.mark.parametrize("count", [1, 2, 7])
@pytest.mark.parametrize("first", [0, 1, 5, 8, 14, 20])
def test_lost_segments_are_sent_again_without_a_stop(first: int, count: int) -> None:
    """Of seven in a row, when they come one by one, the last may be too late: then all stop."""
    made = bench("epos2", "copley")
    lost = lose(made.drives[1], some(first, count))
    made.path.submit(there_and_back(3.0, joints=2), None, made.now_us)
    try:
        made.wait(made.group.motion)
    except MotionAborted as error:
        assert count == 7 and first > 5
        assert "its PVT buffer has run empty" in str(error)
        assert not any(drive.ip_active for drive in made.drives)
        return
    t_ms, demand = executed(made.drives[1])
    assert np.abs(demand - commanded_qc(t_ms, 1, 3.0)).max() <= 1.0
    assert (len(lost), len(t_ms)) == (count, 3002)
    assert made.group.phase is Phase.STANDING


def test_every_segment_is_lost_in_turn(fuzz: int) -> None:
    """One of six in a motion, another one of them in the next; `--fuzz 500` is 10,000 of them.

    The path is kept, or all stand within the buffer's half second and a ramp.
    """
    losses = stops = 0
    for motion in range(fuzz):
        made = bench("epos2", "copley")
        duration_s = 12.0 + motion // 6 % 10
        numbers = itertools.count()
        fresh: set[bytes] = set()

        def wanted(
            data: bytes, place: int = motion % 6, numbers: itertools.count = numbers,
            fresh: set[bytes] = fresh,
        ) -> bool:  # fmt: skip
            if data in fresh or data[0] & 0x80:
                return False  # sent again, or a command
            fresh.add(data)
            return next(numbers) % 6 == place

        lost = lose(made.drives[1], wanted)
        try:
            run_motion(made, there_and_back(duration_s, joints=2))
        except MotionAborted as error:
            assert "its PVT buffer has run empty" in str(error)
            assert not any(drive.ip_active for drive in made.drives)
            stops += 1
        else:
            t_ms, demand = executed(made.drives[1])
            assert np.abs(demand - commanded_qc(t_ms, 1, duration_s)).max() <= 1.0
            assert len(t_ms) == 1000 * duration_s + 2
        losses += len(lost)
    assert losses >= 15 * fuzz
    assert stops == 0
    print(f"{losses} segments lost in {fuzz} motions, {stops} stops")


def test_a_repeated_segment_does_no_harm() -> None:
    made = bench("epos2", "copley")
    made.path.submit(there_and_back(3.0, joints=2), None, made.now_us)
    made.run(1.0)
    last = [f for _, f, echo in made.frames if echo and f.can_id == SEGMENTS + 2][-1]
    made.bus.host_send(last.can_id, last.data)
    made.wait(made.group.motion)
    assert made.drives[1].pvt.refused >= 1
    t_ms, demand = executed(made.drives[1])
    assert np.abs(demand - commanded_qc(t_ms, 1, 3.0)).max() <= 1.0


@pytest.mark.parametrize("can_id", [0x182, 0x482, ANSWER + 2])
def test_what_it_says_of_its_buffer_may_get_lost(can_id: int) -> None:
    """Events, answers to SYNC, answers to SDO in motion: the others say it, too."""
    made = bench("epos2", "copley")
    made.path.submit(there_and_back(3.0, joints=2), None, made.now_us)
    made.run(0.5)
    made.bus.drop = lambda identifier, data, source: identifier == can_id
    lost = lose(made.drives[1], some(1))
    made.run(2.0)
    made.bus.drop = None
    made.wait(made.group.motion)
    assert len(lost) == 1
    t_ms, demand = executed(made.drives[1])
    assert np.abs(demand - commanded_qc(t_ms, 1, 3.0)).max() <= 1.0


def test_the_command_that_clears_the_error_may_get_lost() -> None:
    made = bench("epos2", "copley")
    counts = {"segment": 0, "command": 0}

    def wanted(data: bytes) -> bool:
        kind = "command" if data[0] & 0x80 else "segment"
        counts[kind] += 1
        return (kind, counts[kind]) in (("command", 1), ("segment", 5))

    lose(made.drives[1], wanted)
    run_motion(made, there_and_back(3.0, joints=2))
    assert counts["command"] == 2
    t_ms, demand = executed(made.drives[1])
    assert np.abs(demand - commanded_qc(t_ms, 1, 3.0)).max() <= 1.0


def test_what_can_not_be_made_good_in_time_stops_all() -> None:
    """No segment comes through any more: the buffer's half second, and a ramp."""
    made = bench("epos2", "copley")
    made.path.submit(there_and_back(6.0, joints=2), None, made.now_us)
    made.run(1.5)
    lost = lose(made.drives[1], lambda _: losing)
    losing, since_us = True, made.now_us
    with pytest.raises(MotionAborted, match=r"joint_2 \(node 2\): its PVT buffer has run empty"):
        made.wait(made.group.motion)
    assert made.now_us - since_us < 0.5e6 + 0.3e6
    assert not any(drive.ip_active for drive in made.drives)
    assert lost
    losing = False
    made.wait(made.group.reset_fault())
    made.enable()
    assert made.drives[1].pvt.errors == 0
    run_motion(made, Trajectory(
        ("joint_1", "joint_2"), np.array([0.0, 2.0]),
        np.array([[d.position_demand / QC_PER_RAD for d in made.drives], [0.0, 0.0]]),
    ))  # fmt: skip
    assert [drive.position_demand for drive in made.drives] == [0, 0]


def test_an_altered_segment_stops_all() -> None:
    """With a valid counter and another position: the demand at a SYNC is off its path."""
    made = bench("epos2", "copley")
    made.path.submit(there_and_back(6.0, joints=2), None, made.now_us)
    made.run(1.5)
    made.drives[1].pvt._segments[2] = made.drives[1].pvt._segments[2]._replace(position=0)
    with pytest.raises(MotionAborted, match=r"joint_2 \(node 2\): its demand is \d+ qc off"):
        made.wait(made.group.motion)


# --- states that it may be in -------------------------------------------------------------------


def test_what_an_earlier_host_has_left_is_never_executed() -> None:
    drive = Copley(2, record=True)
    drive.pvt.write(bytes([0, 50]) + bytes(6), 0.0)
    drive.pvt.write(bytes([5, 50]) + bytes(6), 0.0)  # a sequence error
    assert (len(drive.pvt), drive.pvt.errors) == (1, 1)
    config = DriverConfig(axes=makers("epos2", "copley"))
    made = Bench(config, [drive_of(config.axes[0], record=True), drive])
    made.enable()
    assert (len(drive.pvt), drive.pvt.errors) == (0, 0)
    run_motion(made, there_and_back(joints=2))
    assert max(errors_qc(made)) <= 1.0


def test_its_buffer_may_be_smaller() -> None:
    made = bench("epos2", "copley")
    made.drives[1].pvt.size = 12
    made.run(0.3)
    run_motion(made, there_and_back(3.0, joints=2))
    assert made.drives[1].pvt.refused == 0


def test_a_buffer_that_is_not_to_be_emptied_is_told() -> None:
    config = DriverConfig(axes=makers("epos2", "copley"))
    made = Bench(config)
    drive = made.drives[1]
    drive.pvt.write(bytes([0, 50]) + bytes(6), made.now_us)
    lose(drive, lambda _: True)
    with pytest.raises(DriveError, match="joint_2 .* its buffer is not empty"):
        made.enable()


def test_a_halt_leaves_nothing_behind() -> None:
    made = bench("epos2", "copley")
    made.path.submit(there_and_back(4.0, joints=2), None, made.now_us)
    made.run(1.0)
    made.wait(made.group.halt())
    assert made.group.phase is Phase.STANDING
    made.run(0.5)
    at = [drive.position_demand for drive in made.drives]
    made.run(0.5)
    assert at == [drive.position_demand for drive in made.drives]
    assert len(made.drives[1].pvt) == 0


def test_moves_and_trajectories_in_turn() -> None:
    """Mode 1 and mode 7, each confirmed by 0x6061; the deceleration is what it was."""
    axes = makers("epos2", "copley", max_velocity=2.0, max_acceleration=8.0)
    made = Bench(DriverConfig(axes=axes))
    made.enable()
    before = made.drives[1].dictionary[0x6084, 0].value
    made.wait(made.machine.move_to({"joint_1": 0.2, "joint_2": 0.1}))
    assert made.drives[1].dictionary[0x6084, 0].value == before
    there = Trajectory(
        ("joint_1", "joint_2"), np.array([0.0, 1.0]), np.array([[0.2, 0.1], [0.0, 0.0]])
    )
    made.path.submit(there, None, made.now_us)
    made.wait(made.group.motion)
    assert [drive.position_demand for drive in made.drives] == [0, 0]


@pytest.mark.parametrize("family", ["epos2", "copley"])
def test_a_joint_of_profiles_is_refused_and_not_missed(family: str) -> None:
    axes = makers("epos2", family, max_velocity=2.0, max_acceleration=8.0)
    axes = axes[0], replace(axes[1], trajectory="profile")
    made = Bench(DriverConfig(axes=axes))
    made.enable()
    assert made.drives[1].dictionary[0x6060, 0].value == 1
    made.wait(made.machine.move_to({"joint_1": 0.0, "joint_2": 0.1}))
    run_motion(made, there_and_back(joints=1))
    with pytest.raises(TrajectoryError, match="joint 'joint_2' is unknown"):
        made.path.submit(there_and_back(joints=2), None, made.now_us)


def test_a_drive_without_a_buffer_is_not_told_to_follow_records() -> None:
    axis = AxisConfig("lift", 3, drive="cl3e", trajectory="pvt")
    with pytest.raises(ConfigurationError, match=r"axes.lift.trajectory is 'pvt'; Nanotec's"):
        Bench(DriverConfig(axes=(axis,)), bring_up=False)
