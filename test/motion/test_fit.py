"""Records: what a drive makes of them stays within the tolerance, and there are few of them."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from trajectories import NAMES, axes_of, curve_of, example, gentle, limited, trajectories

from epos2_ros.bus.settings import fit_axis
from epos2_ros.configuration.driver import AxisConfig, DriverConfig
from epos2_ros.errors import ConfigurationError, TrajectoryError
from epos2_ros.motion.fit import FitAxis, Fitter
from epos2_ros.motion.record import Record
from epos2_ros.motion.reference import Reference
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.motion.units import AxisUnits

RPM = 2000 / 60  # one velocity unit of an axis with 2000 counts per turn [qc/s]


@dataclass
class Positions:
    """A commanded curve given by its positions [times, axes] [qc] at 0, 1, 2 … ms."""

    values: NDArray[np.float64]
    latest_ms: int = 0  # that was asked for

    @property
    def end_ms(self) -> int:
        return len(self.values) - 1

    def positions(self, k: NDArray[np.int64]) -> NDArray[np.float64]:
        self.latest_ms = max(self.latest_ms, int(k.max()))
        return self.values[np.minimum(k, self.end_ms)]


def commanded(name: str) -> Reference:
    trajectory = example(name)
    units = tuple(AxisUnits.of(axis) for axis in axes_of(trajectory.joint_names))
    return Reference(units, (curve_of(trajectory),))


def first_positions(reference: Reference | Positions) -> list[int]:
    return [round(p) for p in reference.positions(np.array([0]))[0]]


def motion(fitter: Fitter, axes: int) -> list[list[Record]]:
    """All records of all axes, asked for as a feeder does: the axis that has got least first."""
    records: list[list[Record]] = [[] for _ in range(axes)]
    going = set(range(axes))
    while going:
        axis = min(going, key=lambda i: (fitter.committed_ms(i), i))
        record = fitter.next(axis)
        if record is None:
            going.remove(axis)
        else:
            records[axis].append(record)
    return records


def converted(
    reference: Reference | Positions, axes: Sequence[FitAxis] | None = None, **aims: float
) -> list[list[Record]]:
    start = first_positions(reference)
    fitter = Fitter(axes or [FitAxis(RPM)] * len(start), **aims)
    fitter.begin(reference, start)
    return motion(fitter, len(start))


def drive_executes(
    start_qc: int, records: Sequence[Record], unit_qc_s: float = RPM
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Position [qc], largest |velocity| [qc/s] and |acceleration| [qc/s²] of every millisecond.

    Every segment is solved for from its four conditions, apart from how the project does it.
    """
    positions, speeds, accelerations = [float(start_qc)], [0.0], [0.0]
    p0, v0 = float(start_qc), 0.0
    for record in records:
        T = record.time / 1000
        p1, v1 = float(record.position), record.velocity * unit_qc_s
        b, a = np.linalg.solve([[T**2, T**3], [2 * T, 3 * T**2]], [p1 - p0 - v0 * T, v1 - v0])
        t = np.arange(1, record.time + 1) / 1000
        positions += list(p0 + v0 * t + b * t**2 + a * t**3)
        fine = np.linspace(0, T, 20 * record.time + 1)
        speeds.append(float(np.abs(v0 + 2 * b * fine + 3 * a * fine**2).max()))
        accelerations.append(float(np.abs(2 * b + 6 * a * fine).max()))
        p0, v0 = p1, v1
    return np.array(positions), np.array(speeds), np.array(accelerations)


def assert_follows(
    reference: Reference | Positions,
    records: Sequence[Sequence[Record]],
    tolerance_qc: float,
    start: Sequence[int] | None = None,
    max_segment_ms: int = 255,
    unit_qc_s: float = RPM,
) -> None:
    k = np.arange(reference.end_ms + 1)
    wanted = reference.positions(k)
    starts = first_positions(reference) if start is None else start
    for axis, own in enumerate(records):
        *moving, end = own
        assert end == Record(round(float(wanted[-1, axis])), 0, 0)
        assert (moving[-1].position, moving[-1].velocity) == (end.position, 0)
        assert all(1 <= record.time <= max_segment_ms for record in moving)
        assert all(type(x) is int for record in own for x in record)
        position, _, _ = drive_executes(starts[axis], moving, unit_qc_s)
        assert len(position) == len(wanted)
        assert np.abs(position - wanted[:, axis]).max() <= tolerance_qc + 1e-6


# ------------------------------------------------------------------- within the tolerance


@pytest.mark.parametrize("tolerance", [0.6, 1.0, 10.0])
@pytest.mark.parametrize("name", NAMES)
def test_examples_stay_within_the_tolerance_at_every_millisecond(
    name: str, tolerance: float
) -> None:
    reference = commanded(name)
    assert_follows(reference, converted(reference, tolerance_qc=tolerance), tolerance)


@settings(max_examples=60, deadline=None)
@given(
    trajectory=trajectories(),
    gear_ratio=st.sampled_from([1.0, 10.0, 160.0]),
    tolerance=st.floats(0.6, 20.0),
    longest=st.integers(8, 255),
    smoothness=st.floats(0.0, 10.0),
)
def test_any_trajectory_stays_within_the_tolerance(
    trajectory: Trajectory, gear_ratio: float, tolerance: float, longest: int, smoothness: float
) -> None:
    curve = curve_of(trajectory)
    k = np.arange(int(np.ceil(curve.end_s * 1000)) + 1)
    # A position may be anywhere between two counts, at the start and at the end, too.
    reference = Positions(curve.evaluate(k / 1000) * gear_ratio * 2000 / (2 * np.pi))
    records = converted(
        reference, tolerance_qc=tolerance, max_segment_ms=longest, smoothness=smoothness
    )
    assert_follows(reference, records, tolerance, max_segment_ms=longest)


@settings(max_examples=40, deadline=None)
@given(trajectory=gentle(kinds=("velocities", "accelerations")), share=st.floats(1.0, 1.5))
def test_no_limit_of_a_drive_is_exceeded(trajectory: Trajectory, share: float) -> None:
    # The driver sets the drives' limits above those of the axes, by 5 % and 25 %. Starting from
    # a position rounded by half a count and a velocity rounded by half a unit takes something, too.
    curve = curve_of(trajectory)
    axes = limited(curve, share=share)
    units = tuple(AxisUnits.of(axis) for axis in axes)
    fits = [
        FitAxis(
            u.velocity_unit_qc_s,
            1.05 * float(a.max_velocity) * u.qc_per_unit + u.velocity_unit_qc_s,
            1.25 * float(a.max_acceleration) * u.qc_per_unit + 5000,
        )
        for a, u in zip(axes, units, strict=True)
    ]
    reference = Reference(units, (curve,))
    records = converted(reference, fits)
    assert_follows(reference, records, 1.0)
    for fit, start, own in zip(fits, first_positions(reference), records, strict=True):
        _, speed, acceleration = drive_executes(start, own[:-1])
        assert speed.max() <= fit.max_velocity_qc_s * (1 + 1e-9)
        assert acceleration.max() <= fit.max_acceleration_qc_s2 * (1 + 1e-9)


@pytest.mark.parametrize("unit", [RPM, RPM / 100])
@pytest.mark.parametrize("least_rpm", [1.0, 2.0])
@pytest.mark.parametrize("name", NAMES)
def test_velocities_near_zero_can_be_avoided(name: str, least_rpm: float, unit: float) -> None:
    """Within the same tolerance, for few records more."""
    reference = commanded(name)
    axes = len(first_positions(reference))
    free = converted(reference, [FitAxis(unit)] * axes)
    kept = converted(reference, [FitAxis(unit, least_velocity_qc_s=least_rpm * RPM)] * axes)
    for records in kept:
        speeds = [abs(record.velocity) * unit / RPM for record in records if record.velocity]
        assert min(speeds) >= least_rpm - 1e-9
    assert_follows(reference, kept, 1.0, unit_qc_s=unit)
    assert sum(map(len, kept)) <= 1.15 * sum(map(len, free)) + 5


def test_an_axis_that_creeps_follows_without_velocities_near_zero() -> None:
    """At half a turn a minute, below what is avoided all along."""
    creep = Positions(np.outer(np.linspace(0.0, 0.5 * RPM * 20, 20_001), [1.0, -1.0]))
    axes = [FitAxis(RPM / 1000, least_velocity_qc_s=2 * RPM)] * 2
    made = converted(creep, axes)
    assert all(not r.velocity or abs(r.velocity) >= 2000 for records in made for r in records)
    assert_follows(creep, made, 1.0, unit_qc_s=RPM / 1000)


@given(
    gear_ratio=st.floats(1.0, 200.0),
    units=st.floats(0.01, 3.0),
    counts_per_turn=st.sampled_from([512, 2000, 40_000]),
)
def test_records_may_have_the_whole_velocity_unit_not_below_the_limit(
    gear_ratio: float, units: float, counts_per_turn: int
) -> None:
    """An axis that has but 0 and one unit to go at would have nothing left."""
    limit = units * 2 * np.pi / 60 / gear_ratio  # one unit is 1 rpm of the motor
    axis = AxisConfig(
        "j", 1, counts_per_turn=counts_per_turn, gear_ratio=gear_ratio, max_velocity=limit
    )
    fit, whole = fit_axis(axis, DriverConfig((axis,))), np.ceil(units * (1 - 1e-9))
    assert fit.velocity_unit_qc_s == pytest.approx(counts_per_turn / 60)
    assert fit.max_velocity_qc_s >= whole * fit.velocity_unit_qc_s


def test_what_no_drive_can_follow_is_refused() -> None:
    t = np.arange(1001) / 1000
    fast = Positions((100_000 * t**2 * (3 - 2 * t))[:, None])  # 150,000 qc/s in the middle
    for limits in ({"max_velocity_qc_s": 140_000.0}, {"max_acceleration_qc_s2": 500_000.0}):
        with pytest.raises(TrajectoryError, match=r"no segment from \d+ ms on stays within 1 qc"):
            converted(fast, [FitAxis(RPM, **limits)])
    converted(fast, [FitAxis(RPM, 150_100.0, 610_000.0)])


@settings(max_examples=80, deadline=None)
@given(
    speed_qc_s=st.floats(0.3, 8.0),
    beyond_qc=st.floats(-4.0, -1.7).map(lambda decades: 10**decades),
    bow_ms=st.integers(4, 40),
    before_ms=st.integers(0, 16),
    sign=st.sampled_from([1, -1]),
)
def test_half_a_count_that_is_just_passed_leaves_a_way_on(
    speed_qc_s: float, beyond_qc: float, bow_ms: int, before_ms: int, sign: int
) -> None:
    """At the least tolerance: a creeping axis is told to turn back in the moment before it hops to
    the next count. That takes 16 ms at its limits; there may be less between the two counts."""
    k, turn_ms, slope = np.arange(2500), 1000, speed_qc_s / 1000
    begin_ms, end_ms = turn_ms - bow_ms, turn_ms + bow_ms
    on = 0.5 + beyond_qc - slope * bow_ms / 2 + slope * (k - begin_ms)
    bow = 0.5 + beyond_qc - slope / bow_ms * (k - turn_ms) ** 2 / 2
    back = bow[end_ms] - slope * (k - end_ms)
    turns = np.select([k < begin_ms, k <= end_ms], [on, bow], back)
    on, turns = (sign * (curve - np.floor(on[0]))[:, None] for curve in (on, turns))
    creeps = FitAxis(RPM, 120.0, 26_000.0, 25_500.0)
    fitter, records, told_qc = Fitter([creeps], 0.5, max_segment_ms=16), [], 0.0
    start = first_positions(Positions(on))
    fitter.begin(Positions(on), start)
    while fitter.committed_ms(0) < begin_ms - before_ms:
        records.append(fitter.next(0))
    assume(fitter.committed_ms(0) <= begin_ms)
    fitter.replace(Positions(turns))
    while (record := fitter.next(0)) is not None:
        records.append(record)
        told_qc = max(told_qc, fitter.off_qc(0))
    position, speed, acceleration = drive_executes(start[0], records[:-1])
    off_qc = np.abs(position[:2500] - turns[: len(position), 0]).max()  # it may rest later
    assert off_qc <= max(0.5, told_qc) + 1e-6
    assert off_qc <= 0.5 + beyond_qc + 1e-6  # both counts are so far away when it turns
    assert speed.max() <= 120.0 and acceleration.max() <= 26_000.0 * (1 + 1e-9)


# --------------------------------------------------------------------------- few of them


def grid(reference: Reference, step_ms: int) -> list[list[Record]]:
    """PVT records as others make them: every `step_ms`, rounded."""
    k = np.array([*range(step_ms, reference.end_ms, step_ms), reference.end_ms])
    p = np.round(reference.positions(k)).astype(int)
    v = np.round(reference.velocities(k) / RPM).astype(int)
    times = np.diff(k, prepend=0)
    return [
        [Record(int(a), int(b), int(t)) for a, b, t in zip(pa, va, times, strict=True)]
        for pa, va in zip(p.T, v.T, strict=True)
    ]


@pytest.mark.parametrize("name", NAMES)
def test_a_fraction_of_the_records_of_a_uniform_grid(name: str) -> None:
    reference = commanded(name)
    k = np.arange(reference.end_ms + 1)
    wanted, start = reference.positions(k), first_positions(reference)

    def follows(step_ms: int) -> bool:
        return all(
            np.abs(drive_executes(start[axis], own)[0] - wanted[:, axis]).max() <= 1.0
            for axis, own in enumerate(grid(reference, step_ms))
        )

    coarsest = max(filter(follows, (5, 10, 20, 25, 40, 50)))
    records = sum(len(own) - 1 for own in converted(reference))
    assert 3.5 * records <= len(start) * reference.end_ms / coarsest


def test_a_cubic_is_one_record_between_its_ends_where_the_drive_can_hold_it() -> None:
    t = np.arange(201) / 200
    reference = Positions((1000 * t**2 * (3 - 2 * t))[:, None])
    own = converted(reference)[0]
    assert own == [Record(1000, 0, 200), Record(1000, 0, 0)]


def test_a_rest_is_kept_exactly() -> None:
    ramp = 3000.4 * (np.arange(1001) / 1000) ** 2 * (3 - 2 * np.arange(1001) / 1000)
    there_and_back = np.concatenate((ramp, np.full(3000, ramp[-1]), ramp[::-1]))
    reference = Positions(there_and_back[:, None])
    for smoothness in (0.0, 1.0):
        own = converted(reference, smoothness=smoothness)[0]
        assert_follows(reference, [own], 1.0)
        position, _, _ = drive_executes(0, own[:-1])
        assert len(set(position[1260:3740])) == 1, smoothness
        assert len(own) <= 40


@pytest.mark.parametrize("name", ["jerk_limited", "pick_place"])
def test_more_weight_on_smoothness_makes_it_smoother(name: str) -> None:
    reference = commanded(name)
    k = np.arange(reference.end_ms + 1)
    asked = np.diff(reference.velocities(k), axis=0) * 1000
    roughness, count = [], []
    for smoothness in (0.0, 1.0):
        records = converted(reference, smoothness=smoothness)
        made = np.array(
            [
                np.diff(drive_executes(start, own[:-1])[0], 2) * 1e6
                for start, own in zip(first_positions(reference), records, strict=True)
            ]
        ).T
        roughness.append(float(np.sqrt(np.mean((made - asked[:-1]) ** 2))))
        count.append(sum(map(len, records)))
    assert roughness[1] < 0.7 * roughness[0]
    assert count[0] <= count[1]


# -------------------------------------------------------------------------- without waiting


def test_the_first_records_ask_for_the_next_seconds_only() -> None:
    t = np.arange(600_001) / 1000
    reference = Positions(np.stack([50_000 * np.sin(t / (3 + i)) for i in range(6)], axis=1))
    fitter = Fitter([FitAxis(RPM)] * 6)
    fitter.begin(reference, [0] * 6)
    for _ in range(4):
        for axis in range(6):
            fitter.next(axis)
    assert reference.latest_ms < 6000


@pytest.mark.parametrize("name", ["jerk_limited", "positions_only"])
def test_in_whatever_order_the_axes_are_asked_each_stays_within_the_tolerance(name: str) -> None:
    reference = commanded(name)
    start = first_positions(reference)
    fitter = Fitter([FitAxis(RPM)] * len(start))
    fitter.begin(reference, start)
    records: list[list[Record]] = []
    for axis in reversed(range(len(start))):  # one after the other, each to its end
        own: list[Record] = []
        while (record := fitter.next(axis)) is not None:
            own.append(record)
        records.insert(0, own)
    assert_follows(reference, records, 1.0)


# ------------------------------------------------------------------------------ replacing


@settings(max_examples=40, deadline=None)
@given(
    at=st.integers(50, 2500),
    dive=st.floats(-400.0, 400.0),
    longest=st.integers(16, 255),
    again=st.booleans(),
)
def test_a_new_reference_takes_over_after_what_is_committed(
    at: int, dive: float, longest: int, again: bool
) -> None:
    t = np.arange(4001) / 1000
    old = Positions(np.stack([900 * (1 - np.cos(t)), 500 * t**2 * (4 - t) ** 2 / 16], axis=1))
    old.values[-1] = old.values[-2] = old.values[-3]
    fitter = Fitter([FitAxis(RPM)] * 2, max_segment_ms=longest)
    fitter.begin(old, [0, 0])
    records: list[list[Record]] = [[], []]
    while min(map(fitter.committed_ms, (0, 1))) < at:
        axis = min((0, 1), key=fitter.committed_ms)
        record = fitter.next(axis)
        assert record is not None
        records[axis].append(record)
    join = max(map(fitter.committed_ms, (0, 1)))
    assume(join < 3900)
    new = Positions(old.values.copy())
    s = np.clip((np.arange(4001) - join) / (4000 - join), 0, 1)
    new.values += (dive * s**3 * (10 - 15 * s + 6 * s**2))[:, None]
    fitter.replace(new)
    if again:
        fitter.replace(new)
    rest_of_it = motion(fitter, 2)
    assert_follows(new, [a + b for a, b in zip(records, rest_of_it, strict=True)], 1.0, [0, 0])


def test_after_the_end_is_committed_nothing_can_be_replaced() -> None:
    reference = Positions(np.linspace(0, 3, 301)[:, None])
    fitter = Fitter([FitAxis(RPM)])
    fitter.begin(reference, [0])
    motion(fitter, 1)
    assert fitter.next(0) is None
    with pytest.raises(ValueError, match="end record"):
        fitter.replace(reference)
    fitter.begin(reference, [0])  # a new motion can begin
    assert fitter.next(0) is not None


# ------------------------------------------------------------------------------- settings


@pytest.mark.parametrize(
    ("aims", "message"),
    [
        ({"tolerance_qc": 0.4}, "tolerance is 0.4 qc"),
        ({"tolerance_qc": float("nan")}, "tolerance is nan qc"),
        ({"max_segment_ms": 256}, "longest segment is 256 ms"),
        ({"max_segment_ms": 0}, "longest segment is 0 ms"),
        ({"smoothness": -1.0}, "smoothness is -1"),
        ({"smoothness": float("inf")}, "smoothness is inf"),
    ],
)
def test_bad_settings_are_refused(aims: dict[str, float], message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        Fitter([FitAxis(RPM)], **aims)


def test_without_numba_the_records_are_the_same() -> None:
    program = """
import json, sys
sys.modules["numba"] = None
sys.path[:0] = ["test", "test/motion"]
from test_fit import commanded, converted
print(json.dumps(converted(commanded("raster_scan"))))
"""
    interpreted = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=120
    )
    compiled = converted(commanded("raster_scan"))
    assert json.loads(interpreted.stdout) == json.loads(json.dumps(compiled))
