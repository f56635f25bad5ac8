"""What operators' programs send, followed in simulated time: MoveIt Servo, rqt, joysticks.

What the axes do is read off the simulated drives at every millisecond.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from random import Random

import numpy as np
import pytest
from simulated_time import Bench, axes, drive_of, makers

from epos2_ros.configuration.driver import DriverConfig
from epos2_ros.errors import TrajectoryError, UnfinishedTrajectory
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.protocol.phase import Phase

QC_PER_RAD = 2000 * 100 / (2 * math.pi)
JOINTS = ("joint_1", "joint_2")
MAX_VELOCITY, MAX_ACCELERATION = 2.0, 20.0
SPEED = 0.3  # of joint_1 in the operator's path [rad/s]
RAMP_S = 0.3  # in which the operator's speed comes

Message = Callable[[float, float], Trajectory]  # of the operator's time and the host's [s]


def operator(t_s: float, until_s: float) -> np.ndarray:
    """Where the operator is: joint_1 goes evenly, joint_2 sways; at rest when let go."""
    t_s = min(max(t_s, 0.0), until_s)
    way = t_s - RAMP_S / 2 if t_s > RAMP_S else t_s**2 / (2 * RAMP_S)
    return np.array([SPEED * way, 0.1 * (1 - math.cos(2 * t_s))])


def velocity(t_s: float, until_s: float) -> np.ndarray:
    """As it still moves at the moment of letting go: the last point moves."""
    h = 1e-5
    t_s = min(t_s, until_s - h)
    return (operator(t_s + h, until_s) - operator(t_s - h, until_s)) / (2 * h)


@dataclass
class Form:
    """How a program says where to go."""

    period_s: float
    ahead_s: float
    until_s: float
    window: bool = False
    velocities: bool = True
    due_s: float = 0.0  # of a point that says where the operator is now

    def message(self, t_s: float, now_s: float) -> Trajectory:
        """That of operator's time `t_s`, which is host time `now_s` for stamps."""
        if self.due_s:
            here = operator(t_s, self.until_s)[None, :]
            return Trajectory(JOINTS, np.array([self.due_s]), here, published=True)
        times = np.array([t_s + self.ahead_s])
        if self.window:
            first = max(t_s - self.ahead_s, 0.0)
            times = np.arange(first, t_s + self.ahead_s + 1e-9, self.period_s)
        return Trajectory(
            JOINTS,
            times - times[0] if self.window else np.array([self.ahead_s]),
            np.array([operator(t, self.until_s) for t in times]),
            np.array([velocity(t, self.until_s) for t in times]) if self.velocities else None,
            stamp_s=now_s + times[0] - t_s if self.window else None,
            published=True,
        )


def humble(period_s: float, until_s: float) -> Form:
    return Form(period_s, period_s, until_s)


def jazzy(period_s: float, until_s: float) -> Form:
    return Form(period_s, 0.1, until_s, window=True)


def rqt(due_s: float, until_s: float) -> Form:
    return Form(0.1, 0.0, until_s, due_s=due_s)


@dataclass
class Run:
    """A stream that was followed. Times are the host's [s]."""

    bench: Bench
    refused: list[str] = field(default_factory=list)
    zero_s: float = 0.0  # of the operator's time
    last_due_s: float = 0.0

    def positions(self) -> tuple[np.ndarray, np.ndarray]:
        """Host times [ms] and demand of both axes [ms, axes] [rad]."""
        columns = [[q for _, q in drive.recorder.executed()] for drive in self.bench.drives]
        length = min(map(len, columns))
        path = np.array([c[-length:] for c in columns]).T / QC_PER_RAD
        start_s = self.bench.machine.path_time.start_us / 1e6
        return start_s + np.arange(length) / 1000, path

    def rests_s(self) -> float:
        """From when on nothing moves."""
        t_s, path = self.positions()
        away = np.abs(path - path[-1]).max(axis=1) > 1.5 / QC_PER_RAD
        return float(t_s[np.flatnonzero(away)[-1]])


def follow(
    form: Form,
    stream_ahead: float = 0.14,
    late_s: Callable[[], float] = lambda: 0.0,
    delay_s: Callable[[], float] = lambda: 0.0,
    gap_s: tuple[float, float] = (math.inf, math.inf),
) -> Run:
    """The whole stream, and what comes after it; a host wakes up `late_s` late.

    Messages of the operator's times in `gap_s` are lost.
    """
    config = DriverConfig(
        axes=makers(
            "epos2", "copley", max_velocity=MAX_VELOCITY, max_acceleration=MAX_ACCELERATION
        ),
        stream_ahead=stream_ahead,
    )
    bench = Bench(config, [
        drive_of(axis, drift_ppm=60.0 * (-1) ** axis.node_id, record=True) for axis in config.axes
    ])
    bench.enable()
    bench.late_us = lambda: 1e6 * late_s()
    run = Run(bench, zero_s=bench.now_us / 1e6)
    t_s = 0.0
    while t_s + form.ahead_s <= form.until_s + 1e-9:
        if gap_s[0] < t_s < gap_s[1]:
            t_s += form.period_s
            continue
        at_s = run.zero_s + t_s + delay_s()
        if at_s * 1e6 > bench.now_us:
            bench.run(at_s - bench.now_us / 1e6)
        message = form.message(t_s, run.zero_s + t_s)
        stamp_us = None if message.stamp_s is None else message.stamp_s * 1e6
        now_s = bench.now_us / 1e6
        try:
            bench.path.submit(message, stamp_us, bench.now_us)
            run.last_due_s = (message.stamp_s or now_s) + message.duration_s
        except Exception as error:
            run.refused.append(f"{t_s:.3f} s: {error}")
        t_s += form.period_s
    bench.run(10.0, lambda: bench.group.phase in (Phase.STANDING, Phase.FAULT))
    return run


def speeds(run: Run) -> tuple[np.ndarray, np.ndarray]:
    """Operator's times [s] and speeds of both axes, over 5 ms [rad/s]."""
    t_s, path = run.positions()
    return t_s[5:] - run.zero_s, (path[5:] - path[:-5]) * 200


def assert_followed(run: Run, until_s: float, most: float = 1.1) -> None:
    """Nothing refused, no fault, no faster than the operator, and to the last point."""
    assert not run.refused
    assert [event.kind for event in run.bench.events] == ["started", "done"]
    _, speed = speeds(run)
    assert np.abs(speed[:, 0]).max() <= most * SPEED
    assert speed[:, 0].min() >= -0.02  # rounding: whole counts
    _, path = run.positions()
    assert path[-1] == pytest.approx(operator(until_s, until_s), abs=SPEED * 0.1)


FORMS = {
    "Humble": humble(0.034, 2.0),
    "Humble, 30 ms": humble(0.03, 2.0),
    "Humble, 100 Hz": humble(0.01, 2.0),
    "Jazzy": jazzy(0.034, 2.0),
    "Jazzy, 30 ms": jazzy(0.03, 2.0),
    "Jazzy, 100 Hz": jazzy(0.01, 2.0),
}


@pytest.mark.parametrize("name", FORMS)
def test_moveit_servo_is_followed_and_rests_soon_after_its_last_message(name: str) -> None:
    form = FORMS[name]
    run = follow(form, stream_ahead=0.05)
    assert_followed(run, form.until_s)
    t_s, speed = speeds(run)
    even = (t_s > 0.8) & (t_s < form.until_s - 0.1)
    assert speed[even, 0].min() > 0.9 * SPEED
    assert run.rests_s() <= run.last_due_s + 0.1
    acceleration = np.diff(speed, axis=0)[::5] * 200
    assert np.abs(acceleration).max() <= 1.3 * MAX_ACCELERATION


@pytest.mark.parametrize("due_s", [0.25, 0.3, 0.5, 1.0, 3.0])
def test_single_points_ten_times_a_second_are_followed_whenever_they_are_due(due_s: float) -> None:
    form = rqt(due_s, due_s + 2.0)
    run = follow(form)
    assert_followed(run, form.until_s)
    t_s, speed = speeds(run)
    # All steps of the even part overlap from then on: no stop and go.
    even = (t_s > due_s + 1.0) & (t_s < form.until_s)
    assert speed[even, 0].min() > 0.9 * SPEED
    assert run.rests_s() <= run.last_due_s + 0.1


@pytest.mark.parametrize("form", [humble(0.034, 4.0), jazzy(0.034, 4.0)], ids=["Humble", "Jazzy"])
def test_a_late_host_is_no_fault(form: Form) -> None:
    """It wakes up late, and messages come late and in bunches."""
    random = Random(7)

    def late_s() -> float:
        return random.uniform(0, 0.1) if random.random() < 0.1 else 0.0

    run = follow(form, late_s=late_s, delay_s=late_s)
    assert_followed(run, form.until_s, most=2.2)


@pytest.mark.parametrize("gap_s", [0.3, 0.52, 1.5])
@pytest.mark.parametrize("kind", [humble, jazzy])
def test_after_a_gap_the_axes_follow_again_and_do_not_rush(
    kind: Callable[[float, float], Form], gap_s: float
) -> None:
    """They rest meanwhile, and the operator gets far ahead. The drives may have to be started."""
    form = kind(0.034, 1.0 + 3 * gap_s + 1.0)
    run = follow(form, gap_s=(1.0, 1.0 + gap_s))
    assert not run.refused
    kinds = {event.kind for event in run.bench.events}
    assert kinds <= {"started", "waiting", "done"}
    t_s, speed = speeds(run)
    # Not at the limit, 2 rad/s, but at the operator's own speed beside that with which it goes on,
    # and somewhat more in a moment, as steps are not quite even.
    assert np.abs(speed[:, 0]).max() <= 2.6 * SPEED
    assert speed[:, 0].min() >= -0.02
    _, path = run.positions()
    assert path[-1] == pytest.approx(operator(form.until_s, form.until_s), abs=SPEED * 0.1)
    assert run.rests_s() <= run.last_due_s + 0.2


def test_of_an_operator_that_was_away_for_long_only_what_is_near_is_followed() -> None:
    """It is a new stream then: points up to 0.4 s away at the velocity limit."""
    bench = Bench(DriverConfig(axes=axes(1, max_velocity=MAX_VELOCITY)))
    bench.enable()

    def send(place: float) -> None:
        point = Trajectory(JOINTS[:1], np.array([0.034]), np.array([[place]]), published=True)
        bench.path.submit(point, None, bench.now_us)

    send(0.1)
    bench.run(9.0)
    send(1.0)  # 0.1 rad/s on average
    bench.run(20.0, lambda: bench.group.phase is Phase.STANDING)
    assert bench.drives[0].position_demand == round(QC_PER_RAD)
    bench.run(11.0)
    with pytest.raises(TrajectoryError, match="joint 'joint_1': velocity .* allowed 2 rad/s"):
        send(1.9)
    send(1.7)


def test_a_creeping_stream_that_rounding_leaves_no_way_is_a_warning_and_no_fault() -> None:
    """At the least tolerance, around half of a count: there no count is near enough at times."""
    random = np.random.default_rng(38)
    slow = axes(1, max_velocity=0.001, max_acceleration=0.02)
    bench = Bench(DriverConfig(axes=slow, tolerance=0.5))
    bench.enable()
    place_qc, speed_qc_s = 0.5, 3.0
    for _ in range(40):
        if random.random() < 0.2:
            speed_qc_s = random.uniform(-8, 8)
        place_qc += speed_qc_s * 0.034
        if abs(place_qc - 0.5) > 0.3:
            speed_qc_s = -speed_qc_s
        point = np.array([[place_qc / QC_PER_RAD]])
        message = Trajectory(JOINTS[:1], np.array([0.034]), point, published=True)
        bench.path.submit(message, None, bench.now_us)
        bench.run(0.034)
    bench.run(3.0, lambda: bench.group.phase is Phase.STANDING)
    assert [event.kind for event in bench.events] == ["started", "warning", "done"]
    assert "joint_1 (node 1) is 0.50" in bench.events[1].text
    assert "ipm.tolerance is 0.5 qc" in bench.events[1].text


def test_a_plan_has_to_end_at_rest_and_a_long_message_is_a_plan() -> None:
    moving = np.full((2, 2), 0.1)
    with pytest.raises(UnfinishedTrajectory):
        Trajectory(JOINTS, np.array([0.0, 0.1]), np.zeros((2, 2)), moving)
    bench = Bench(DriverConfig(axes=axes(2)))
    bench.enable()
    plan = Trajectory(JOINTS, np.array([0.0, 2.0]), np.zeros((2, 2)), moving, published=True)
    with pytest.raises(UnfinishedTrajectory, match="the last point still moves"):
        bench.path.submit(plan, None, bench.now_us)


def test_a_pause_of_the_operator_needs_no_new_start() -> None:
    bench = Bench(DriverConfig(axes=axes(2)))
    bench.enable()
    for n in range(4):
        point = np.array([[0.01 * (n + 1), 0.0]])
        bench.path.submit(
            Trajectory(JOINTS, np.array([0.034]), point, published=True), None, bench.now_us
        )
        bench.run(0.3)  # at rest long since
    bench.run(2.0, lambda: bench.group.phase is Phase.STANDING)
    assert [event.kind for event in bench.events] == ["started", "done"]
