"""How fast trajectories become records, how that grows, and how soon the first record is there.

Every row is measured in a process of its own, on one core.
"""

from __future__ import annotations

import math
import os
import time
import tracemalloc
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any, TypeVar

from builtin_interfaces.msg import Duration
from planners import from_ruckig
from rclpy.serialization import serialize_message
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from epos2_ros.bus.settings import machine_of
from epos2_ros.configuration.driver import DriverConfig
from epos2_ros.motion import knots
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.node.serialized import read_trajectory
from epos2_ros.protocol.phase import Phase

from .cases import EXAMPLES, Case, example, fit, planned
from .table import Table

TOLERANCE_QC = 1.0
POINTS = (100, 1_000, 10_000, 100_000, 1_000_000)
AXES = (1, 2, 4, 8, 16, 32)
AXES_SECONDS = 60
LATENCY_SECONDS = (10, 600)
STEP_S = 0.01
MOVE_S = 1.3  # about what a move of `from_ruckig` takes
REPEATS = 20
LEAST_S = 1.0  # a processor takes a while to get up to speed
ENOUGH_S = 5.0  # no further repeat after this
TRACED_S = 100.0  # tracing memory makes all slower

Row = dict[str, Any]
Result = TypeVar("Result")


def tables(most_points: int) -> Iterator[Table]:
    """Growth with points and with axes, and latency."""
    conditions = (
        f"on one core of {os.cpu_count()}; tolerance {TOLERANCE_QC:g} qc; best of {REPEATS} runs "
        "and more"
    )
    memory = (
        "CPU time. Memory: most that was allocated besides the trajectory, in the first "
        f"{TRACED_S:g} s of it"
    )
    moves = f"moves planned by Ruckig, points {1000 * STEP_S:g} ms apart"
    converted = f"{conditions}, {memory}; {moves}"
    examples = [alone(conversion_of_example, name) for name in EXAMPLES]
    yield Table("Conversion of the examples", examples, f"{conditions}, {memory}")
    points = [alone(conversion, count, 6) for count in POINTS if count <= most_points]
    yield Table("Conversion of six axes, over points", points, converted)
    axes = [alone(conversion, round(AXES_SECONDS / STEP_S), count) for count in AXES]
    yield Table("Conversion of about a minute, over axes", axes, converted)
    delays = [alone(latency, round(seconds / STEP_S)) for seconds in LATENCY_SECONDS]
    yield Table(
        "From the message to the first records of six axes [ms]", delays, f"{conditions}; {moves}"
    )


def alone(measure: Callable[..., Row], *arguments: int | str) -> Row:
    """One measurement in a fresh process on one core."""
    with ProcessPoolExecutor(1, get_context("spawn"), _on_one_core) as pool:
        return pool.submit(measure, *arguments).result()


def conversion(points: int, axes: int) -> Row:
    """Of moves from rest to rest."""
    return converting(motion(points, axes))


def conversion_of_example(name: str) -> Row:
    """Of one of the examples."""
    return {"trajectory": name, **converting(example(name))}


def converting(case: Case) -> Row:
    """Join, limits and all records of a trajectory; what belongs to the axes is there."""
    fitter = case.fitter(TOLERANCE_QC)

    def convert(until_s: float = math.inf) -> tuple[float, float, int]:
        begun_s = time.process_time()
        reference = case.joined()
        joined_s = time.process_time()
        records = fit(fitter, reference, case.start_qc, 1000 * until_s)
        return time.process_time() - begun_s, joined_s - begun_s, sum(map(len, records))

    whole_s, joined_s, records = best(convert)
    return {
        "points": len(case.trajectory.times_s),
        "axes": len(case.configs),
        "motion [s]": case.seconds,
        "join, limits [ms]": 1000 * joined_s,
        "whole [ms]": 1000 * whole_s,
        "× real time": case.seconds / whole_s,
        "µs per record": 1e6 * (whole_s - joined_s) / records,
        "memory [MB]": traced(lambda: convert(TRACED_S)) / 1e6,
    }


def latency(points: int) -> Row:
    """What passes between a message and records for all axes, as in the driver."""
    case = motion(points, 6)
    config = DriverConfig(axes=case.configs)
    message = message_of(case.trajectory)
    serialized = serialize_message(message)

    def first_records() -> tuple[float, float, float, float]:
        machine = machine_of(config)
        feeder = machine.interpolated.feeder
        for drive, start_qc in zip(machine.drives, case.start_qc, strict=True):
            drive.demand_qc = start_qc
        machine.group.phase = Phase.STANDING
        knots.prepare()
        begun_s = time.perf_counter()
        trajectory = read_trajectory(serialized)
        read_s = time.perf_counter()
        reference = machine.path.place(trajectory, None, 0.0).join()
        joined_s = time.perf_counter()
        feeder.begin(reference)
        served: set[str] = set()
        while len(served) < len(config.axes):
            fed = feeder.next(0.0)
            assert fed is not None
            fed[0].send(fed[1], 0.0)
            served.add(fed[0].drive.joint)
        first_s = time.perf_counter()
        while (fed := feeder.next(0.0)) is not None:
            fed[0].send(fed[1], 0.0)
        filled_s = time.perf_counter()
        return first_s - begun_s, read_s - begun_s, joined_s - read_s, filled_s - first_s

    def objects() -> tuple[float]:
        begun_s = time.perf_counter()
        Trajectory.from_message(message)
        return (time.perf_counter() - begun_s,)

    total_s, read_s, join_s, others_s = best(first_records)
    return {
        "motion [s]": case.seconds,
        "points": len(case.trajectory.times_s),
        "read the message": 1000 * read_s,
        "join, limits": 1000 * join_s,
        "first records": 1000 * (total_s - read_s - join_s),
        "sum": 1000 * total_s,
        "other records before the start": 1000 * others_s,
        "(reading rclpy's objects instead)": 1000 * best(objects)[0],
    }


def motion(points: int, axes: int) -> Case:
    """Moves from rest to rest, of about so many points."""
    moves = max(1, round(points * STEP_S / MOVE_S))
    return planned("", from_ruckig(1, moves, STEP_S, axes))


def message_of(trajectory: Trajectory) -> JointTrajectory:
    """As a planner would publish it."""
    rows = (trajectory.positions, trajectory.velocities, trajectory.accelerations)
    columns = [[] if values is None else values.tolist() for values in rows]
    times = [divmod(round(1e9 * t), 10**9) for t in trajectory.times_s.tolist()]
    points = [
        JointTrajectoryPoint(
            positions=p, velocities=v, accelerations=a, time_from_start=Duration(sec=s, nanosec=ns)
        )
        for p, v, a, (s, ns) in zip(*columns, times, strict=True)
    ]
    return JointTrajectory(joint_names=list(trajectory.joint_names), points=points)


def best(run: Callable[[], Result]) -> Result:
    """The result of the quickest run; they begin with their duration [s]."""
    results: list[Any] = []
    taken_s = 0.0
    while (len(results) < REPEATS or taken_s < LEAST_S) and taken_s < ENOUGH_S:
        results.append(run())
        taken_s += results[-1][0]
    quickest: Result = min(results)
    return quickest


def traced(run: Callable[[], object]) -> int:
    """Most that was allocated during a run [bytes]."""
    tracemalloc.start()
    run()
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return most


def _on_one_core() -> None:
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
