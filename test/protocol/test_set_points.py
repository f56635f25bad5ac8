"""One trajectory over EPOS2, Copley and CL3-E drives, in simulated time."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from simulated_time import Bench, drive_of, makers, move_on
from test_one_for_all import StoppedHost
from trajectories import example, polynomial

from epos2_ros.configuration.driver import DriverConfig
from epos2_ros.errors import ConfigurationError, MotionAborted, TrajectoryError
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.protocol.phase import Phase
from epos2_ros.protocol.setpoints.handshake import Step
from epos2_ros.sim.cl3e import Cl3e

QC_PER_RAD = 2000 * 100 / (2 * math.pi)
FAMILIES = ("epos2", "epos2", "copley", "epos2", "cl3e", "cl3e")


def bench(
    *families: str,
    names: tuple[str, ...] = (),
    drifts: tuple[float, ...] = (),
    kind: type[Bench] = Bench,
    **settings: object,
) -> Bench:
    """Drives whose quartzes differ; the axes are enabled."""
    axes = makers(*families, max_velocity=3.0, max_acceleration=10.0)
    if names:
        axes = tuple(replace(a, joint=joint) for a, joint in zip(axes, names, strict=True))
    config = DriverConfig(axes=axes, **settings)  # type: ignore[arg-type]
    drifts = drifts or tuple(50.0 * (-1) ** n for n in range(len(axes)))
    drives = [
        drive_of(axis, drift_ppm=drift_ppm, record=True)
        for axis, drift_ppm in zip(config.axes, drifts, strict=True)
    ]
    made = kind(config, drives)
    made.enable()
    return made


def commanded_qc(trajectory: Trajectory, column: int, t_s: np.ndarray) -> np.ndarray:
    """The quintics through the points, at times after the trajectory's zero."""
    times, p = trajectory.times_s, trajectory.positions
    v, a = trajectory.velocities, trajectory.accelerations
    assert v is not None and a is not None
    t = np.clip(t_s, 0.0, times[-1])
    piece = np.clip(np.searchsorted(times, t, side="right") - 1, 0, len(times) - 2)
    commanded = np.empty(len(t))
    for i in np.unique(piece):
        ends = [(p[n, column], v[n, column], a[n, column]) for n in (i, i + 1)]
        here = piece == i
        commanded[here] = polynomial(ends, times[i + 1] - times[i])(t[here] - times[i])
    return commanded * QC_PER_RAD


def executed(made: Bench, drive: Cl3e) -> tuple[np.ndarray, np.ndarray]:
    """Of the motion: true time since the start SYNC [s], and the demand then."""
    start_us = made.machine.path_time.start_us
    assert drive.recorder is not None and start_us is not None
    columns = drive.recorder.arrays()
    t_s = (columns["time_us"] - start_us) / 1e6
    moving = t_s > 0
    return t_s[moving], columns["demand_qc"][moving]


def assert_on_path(made: Bench, trajectory: Trajectory) -> None:
    """Records within a count at every millisecond; set-points within what is said of them, and what
    the axis moves in a millisecond of the drive's own time."""
    queued = {axis.drive.node_id: axis for axis in made.machine.set_points.axes}
    start_us = made.machine.path_time.start_us
    for column, drive in enumerate(made.drives):
        if isinstance(drive, Cl3e):
            t_s, demand = executed(made, drive)
            commanded = commanded_qc(trajectory, column, t_s - 0.001)
            fastest = np.abs(np.diff(demand) / np.diff(1000 * t_s)).max()
            allowed = queued[drive.node_id].error_qc + fastest * 1.0 + 1.0
            assert drive.position_demand == round(commanded[-1])
        else:
            assert drive.ip_start_us == start_us
            t_ms, demand = np.array(drive.recorder.executed()).T
            commanded, allowed = commanded_qc(trajectory, column, t_ms / 1000 - 0.001), 1.0
        assert np.abs(demand - commanded).max() <= allowed, drive.node_id


def assert_passes(made: Bench) -> None:
    """No CL3-E comes to rest where its set-points don't."""
    for axis in made.machine.set_points.axes:
        assert axis.handshake.step is Step.FREE
        assert axis.count > 5


@pytest.mark.parametrize("name", ["pick_place", "jerk_limited"])
def test_the_examples(name: str) -> None:
    trajectory = example(name)
    made = bench(*FAMILIES, names=trajectory.joint_names)
    made.path.submit(trajectory, None, made.now_us)
    made.wait(made.group.motion)
    assert made.group.phase is Phase.STANDING
    started, followed, done = (event.text for event in made.events)
    assert (started, done) == ("6 axes started on one SYNC", "all axes have arrived")
    for axis in made.machine.set_points.axes:
        assert f"{axis} {axis.error_qc:.0f} counts" in followed
    assert_on_path(made, trajectory)
    assert_passes(made)

# --- whatever is asked for ----------------------------------------------------------------------

MIXED = ("epos2", "copley", "cl3e", "cl3e")
JOINTS = tuple(f"joint_{n}" for n in range(1, 5))


def wandering(rng: np.random.Generator, duration_s: float = 3.0) -> Trajectory:
    """Points anywhere within 0.4 rad, with velocities at them, from zero on."""
    times = np.linspace(0.0, duration_s, 6)
    p = rng.uniform(-0.4, 0.4, (6, 4))
    p[0] = 0.0
    v = np.zeros((6, 4))
    v[1:-1] = (p[2:] - p[:-2]) / (times[2:] - times[:-2])[:, None] / 2
    return Trajectory(JOINTS, times, p, v, np.zeros((6, 4)))


def assert_stands(made: Bench) -> None:
    """And goes on standing; then follows a path again."""
    assert made.group.phase is Phase.STANDING
    made.run(0.3)
    before = [drive.position_demand for drive in made.drives]
    made.run(0.5)
    assert [drive.position_demand for drive in made.drives] == before
    move_on(made)
    assert not [event for event in made.events if event.kind in ("fault", "aborted")]


@pytest.mark.parametrize("stop", ["stop", "halt", "quick_stop", "disable"])
def test_a_stop_at_any_instant(stop: str, fuzz: int) -> None:
    for seed in range(fuzz):
        rng = np.random.default_rng(seed)
        made = bench(*MIXED)
        made.path.submit(wandering(rng), None, made.now_us)
        made.run(rng.uniform(0.0, 3.2))
        by = made.path if stop in ("stop", "disable") else made.group
        answer = getattr(by, stop)()
        if answer is not None:
            made.wait(answer)
        made.wait(made.group.enable())
        made.run(0.2, lambda made=made: made.group.phase is Phase.STANDING)  # type: ignore[misc]
        assert_stands(made)


def test_replaced_at_any_instant(fuzz: int) -> None:
    for seed in range(fuzz):
        rng = np.random.default_rng(seed)
        made = bench(*MIXED, start_tolerance=10.0)
        for _ in range(4):
            last = wandering(rng)
            made.path.submit(last, None, made.now_us)
            made.run(rng.uniform(0.0, 1.5))
        made.run(15.0, lambda made=made: made.group.phase is Phase.STANDING)  # type: ignore[misc]
        ends = np.round(last.positions[-1] * QC_PER_RAD).tolist()
        assert [drive.position_demand for drive in made.drives] == ends
        assert_stands(made)


# --- on the bus ---------------------------------------------------------------------------------


def out_and_back() -> Trajectory:
    still = np.zeros((3, 2))
    points = np.array([[0.0, 0.0], [0.3, 0.3], [0.0, 0.0]])
    return Trajectory(JOINTS[:2], np.array([0.0, 1.0, 2.0]), points, still, still)


def disturbed(kind: int, wanted: Callable[[int], bool], by: str = "loses") -> tuple[Bench, int]:
    """A motion in which the CL3-E does not get some of its frames, or nobody gets some of its own,
    or it gets them twice; and how many these were."""
    made = bench("epos2", "cl3e")
    seen = itertools.count()
    count = 0

    def meddle(can_id: int) -> bool:
        nonlocal count
        moving = made.group.phase in (Phase.STARTING, Phase.MOVING)
        met = can_id == kind + 2 and moving and wanted(next(seen))
        count += met
        return met

    drive = made.drives[1]
    receive = drive.receive

    def receiving(can_id: int, data: bytes, t_us: float, remote: bool = False) -> bool:
        if not meddle(can_id):
            return receive(can_id, data, t_us, remote)
        return by == "loses" or (receive(can_id, data, t_us) and receive(can_id, data, t_us))

    if kind < 0x200 or kind == 0x380:
        made.bus.drop = lambda can_id, data, source: meddle(can_id)
    else:
        drive.receive = receiving  # type: ignore[method-assign]
    made.path.submit(out_and_back(), None, made.now_us)
    made.wait(made.group.motion)
    return made, count


@pytest.mark.parametrize("kind", [0x200, 0x400, 0x500, 0x180, 0x380])
@pytest.mark.parametrize("first", [0, 1, 2, 3, 7])
def test_a_lost_frame_is_made_good(kind: int, first: int) -> None:
    """Parts of a set-point, controlwords, what the drive says: the path goes on."""
    made, lost = disturbed(kind, lambda n: n == first)
    assert lost == 1
    assert_on_path(made, out_and_back())


@pytest.mark.parametrize("kind", [0x200, 0x400, 0x500])
def test_frames_that_come_twice_do_no_harm(kind: int) -> None:
    made, doubled = disturbed(kind, lambda n: True, "doubles")
    assert doubled > 10
    assert_on_path(made, out_and_back())


def test_a_drive_that_is_only_heard_at_syncs_is_followed() -> None:
    made, lost = disturbed(0x180, lambda n: True)
    assert lost > 10
    assert_on_path(made, out_and_back())


@pytest.mark.parametrize(
    ("kind", "why"),
    [
        (0x500, "a set-point was not acknowledged in time|its queue of set-points is not free"),
        (0x200, "off its path: a set-point was lost"),
        (0x400, "off its path: a set-point was lost"),
    ],
)
def test_what_stays_lost_stops_all(kind: int, why: str) -> None:
    with pytest.raises(MotionAborted, match=rf"joint_2 \(node 2\): .*({why})"):
        disturbed(kind, lambda n: n >= 8)


@pytest.mark.parametrize("at_s", [0.3, 1.2])
def test_a_host_that_stalls(at_s: float) -> None:
    """For 50 ms nothing is to be noticed; for 400 ms the drive brakes to its target by itself."""
    for nap_s, aborts in ((0.05, False), (0.4, True)):
        made = bench("epos2", "cl3e", kind=StoppedHost)
        made.path.submit(out_and_back(), None, made.now_us)
        made.run(at_s)
        made.nap(nap_s)
        if not aborts:
            made.wait(made.group.motion)
            assert_on_path(made, out_and_back())
            continue
        with pytest.raises(MotionAborted, match=r"joint_2 \(node 2\): it was given no further"):
            made.wait(made.group.motion)
        made.wait(made.group.reset_fault())
        made.wait(made.group.enable())
        move_on(made)


# --- what the drive is like -----------------------------------------------------------------------


@pytest.mark.parametrize("drift_ppm", [-150.0, 150.0])
def test_a_drive_s_clock_that_drifts_is_made_up_for(drift_ppm: float) -> None:
    """In 20 s it would be 3 ms off; the set-points are chosen for where it is."""
    made = bench("epos2", "cl3e", drifts=(0.0, drift_ppm))
    p = np.array([[0.0, 0.0], *([[0.3, 0.3], [-0.3, -0.3]] * 2), [0.0, 0.0]])
    still = np.zeros_like(p)
    long = Trajectory(JOINTS[:2], 4.0 * np.arange(len(p)), p, still, still)
    made.path.submit(long, None, made.now_us)
    made.wait(made.group.motion)
    assert_on_path(made, long)


def test_a_set_point_that_is_refused_stops_all() -> None:
    """Beyond the drive's own limits of position, say: bit 12 stays clear."""
    made = bench("epos2", "cl3e")
    drive = made.drives[1]
    made.path.submit(out_and_back(), None, made.now_us)
    made.run(0.4)
    drive.dictionary[0x607D, 2].value = drive.position_demand + 10
    with pytest.raises(MotionAborted, match=r"joint_2 .*: a set-point was not acknowledged"):
        made.wait(made.group.motion)
    assert not made.drives[0].ip_active


def test_a_drive_that_does_not_pass_its_targets_stops_all() -> None:
    """Bit 9 is not known to it: it brakes for each."""
    made = bench("epos2", "cl3e")
    made.drives[1]._hold_speed = lambda: None
    made.path.submit(out_and_back(), None, made.now_us)
    with pytest.raises(MotionAborted, match=r"joint_2 .*: its demand is \d+ qc off its path"):
        made.wait(made.group.motion)


def test_what_an_earlier_move_has_left_is_not_executed() -> None:
    """Halted on its way to a target, with another mode's limits of jerk."""
    axes = makers("epos2", "cl3e", max_velocity=3.0, max_acceleration=10.0)
    made = Bench(DriverConfig(axes=(axes[0], replace(axes[1], max_jerk=50.0))))
    made.enable()
    made.machine.move_to({"joint_2": 4.0})
    made.run(0.8)
    made.wait(made.group.halt())
    here = made.drives[1].position_demand
    assert 0 < here < 4.0 * QC_PER_RAD
    assert_stands(made)


def test_moves_and_trajectories_in_turn() -> None:
    made = bench("epos2", "cl3e")
    for _ in range(2):
        made.wait(made.machine.move_to({"joint_1": 0.1, "joint_2": 0.2}))
        move_on(made)


@pytest.mark.parametrize(
    ("family", "told", "why"),
    [
        ("cl3e", "pvt", "Nanotec's drives have no buffer for PVT records"),
        ("copley", "setpoints", "Copley's drives can't pass a set-point without braking"),
        ("epos2", "setpoints", "maxon's drives can't pass a set-point without braking"),
    ],
)
def test_ways_that_a_family_has_not_are_refused(family: str, told: str, why: str) -> None:
    axis = replace(makers(family)[0], trajectory=told)
    with pytest.raises(ConfigurationError, match=rf"axes.joint_1.trajectory is '{told}'; {why}"):
        Bench(DriverConfig(axes=(axis,)), bring_up=False)


def test_a_cl3e_may_be_left_to_move_to() -> None:
    axes = makers("epos2", "cl3e", max_velocity=3.0, max_acceleration=10.0)
    made = Bench(DriverConfig(axes=(axes[0], replace(axes[1], trajectory="profile"))))
    made.enable()
    made.wait(made.machine.move_to({"joint_2": 0.1}))
    with pytest.raises(TrajectoryError, match="joint 'joint_2' is unknown"):
        made.path.submit(out_and_back(), None, made.now_us)


def test_a_stream_is_followed() -> None:
    """A point every 30 ms, which is due 120 ms later."""
    made = bench("epos2", "cl3e")
    for n in range(60):
        point = np.full((1, 2), 0.3 * math.sin(n / 25))
        streamed = Trajectory(JOINTS[:2], np.array([0.12]), point)
        made.path.submit(streamed, None, made.now_us)
        made.run(0.03)
    made.wait(made.group.motion)
    end_qc = round(point[0, 0] * QC_PER_RAD)
    assert [drive.position_demand for drive in made.drives] == [end_qc, end_qc]
    assert made.machine.set_points.axes[0].count > 10
    assert [event.kind for event in made.events] == ["started", "followed", "done"]
