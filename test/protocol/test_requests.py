"""Every request in every phase, and pairs of them: each is answered, and does what it says.

In simulated time, against simulated drives. What is asked of each run is what a user relies on:
no answer stays out; what has not begun when it is stopped never begins; nobody is off without
having been told; a motion never jumps; and afterwards the machine moves again.
`REQUESTS_PAIRS=n` tries n random pairs instead of those of the suite.
"""

from __future__ import annotations

import itertools
import math
import os
import random
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from simulated_time import Bench, drive_of, makers

from epos2_ros.configuration.driver import DriverConfig
from epos2_ros.errors import Epos2RosError
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.protocol.phase import Phase

QC_PER_RAD = 2000 * 100 / (2 * math.pi)
JOINTS = ("joint_1", "joint_2")
MAX_VELOCITY, MAX_ACCELERATION = 3.0, 12.0
OFF_WITHIN_S = 0.5  # what does not move is off so soon after it was asked for
ANSWER_WITHIN_S = 8.0


@dataclass
class Scene:
    """A bench, and what was asked of it."""

    bench: Bench
    asked: list[tuple[str, float, Future[Any] | None, str]] = field(default_factory=list)

    @property
    def phase(self) -> Phase:
        return self.bench.group.phase

    def move(self, to: float, stamp_s: float | None = None, duration_s: float = 0.8) -> None:
        here = [drive.position_demand / QC_PER_RAD for drive in self.bench.drives]
        points = np.array([here, [to, -to]]) if self.resting else np.array([[to, -to]])
        times = np.array([0.0, duration_s]) if self.resting else np.array([duration_s])
        still = np.zeros_like(points)
        now_us = self.bench.now_us
        self.bench.path.submit(
            Trajectory(JOINTS, times, points, still, still.copy()),
            None if stamp_s is None else now_us + stamp_s * 1e6,
            now_us,
        )

    @property
    def resting(self) -> bool:
        return self.bench.group.phase not in (Phase.STARTING, Phase.MOVING)

    def ask(self, name: str) -> None:
        """Make a request, and note the answer or the refusal."""
        answer, refusal = None, ""
        try:
            answer = REQUESTS[name](self)
        except Epos2RosError as error:
            refusal = str(error)
            assert refusal and "\n" not in refusal
        self.asked.append((name, self.bench.now_us, answer, refusal))

    def run_to(self, phase: Phase, seconds: float = 3.0) -> None:
        self.bench.run(seconds, lambda: self.phase is phase)
        assert self.phase is phase, self.bench.group.describe_phase()

    def demands(self) -> list[float]:
        return [drive.position_demand for drive in self.bench.drives]


def disabled(scene: Scene) -> None:
    pass


def enabling(scene: Scene) -> None:
    scene.ask("enable")
    scene.bench.run(0.0005)


def settling(scene: Scene) -> None:
    scene.ask("enable")
    scene.run_to(Phase.SETTLING)


def standing(scene: Scene) -> None:
    scene.bench.enable()


def filling(scene: Scene) -> None:
    standing(scene)
    scene.move(0.3)
    assert scene.phase is Phase.PREPARING


def waiting_for_its_stamp(scene: Scene) -> None:
    standing(scene)
    scene.move(0.3, stamp_s=2.5)
    scene.bench.run(0.7)
    assert scene.phase is Phase.PREPARING


def armed(scene: Scene) -> None:
    standing(scene)
    scene.move(0.3)
    scene.run_to(Phase.ARMING)


def armed_and_seen(scene: Scene) -> None:
    """The controlwords are on the bus and wait for a SYNC at the stamp."""
    standing(scene)
    scene.move(0.3, stamp_s=0.3)
    scene.run_to(Phase.ARMING)
    scene.bench.run(0.008)
    assert scene.phase is Phase.ARMING


def starting(scene: Scene) -> None:
    standing(scene)
    scene.move(0.3)
    scene.run_to(Phase.STARTING)


def moving(scene: Scene) -> None:
    standing(scene)
    scene.move(0.3, duration_s=1.2)
    scene.run_to(Phase.MOVING)
    scene.bench.run(0.4)


def ending(scene: Scene) -> None:
    moving(scene)
    scene.bench.run(2.0, lambda: scene.bench.feeder.ending)
    assert scene.phase is Phase.MOVING


def one_waits_for_the_end(scene: Scene) -> None:
    ending(scene)
    scene.move(0.1)


def stopping(scene: Scene) -> None:
    moving(scene)
    scene.ask("stop")
    scene.bench.run(0.1)


def halting(scene: Scene) -> None:
    moving(scene)
    scene.ask("halt")
    scene.bench.run(0.01)
    assert scene.phase is Phase.HALTING


def quick_stopping(scene: Scene) -> None:
    moving(scene)
    scene.ask("quick_stop")
    scene.bench.run(0.003)
    assert scene.phase is Phase.QUICK_STOPPING


def quick_stopped(scene: Scene) -> None:
    quick_stopping(scene)
    scene.run_to(Phase.DISABLED)


def disabling(scene: Scene) -> None:
    standing(scene)
    scene.ask("disable")
    assert scene.phase is Phase.DISABLING


def in_fault(scene: Scene) -> None:
    standing(scene)
    scene.bench.group.fail("something is wrong")


def resetting(scene: Scene) -> None:
    in_fault(scene)
    scene.ask("reset_fault")


PHASES: dict[str, Callable[[Scene], None]] = {
    phase.__name__: phase
    for phase in (
        disabled,
        enabling,
        settling,
        standing,
        filling,
        waiting_for_its_stamp,
        armed,
        armed_and_seen,
        starting,
        moving,
        ending,
        one_waits_for_the_end,
        stopping,
        halting,
        quick_stopping,
        quick_stopped,
        disabling,
        in_fault,
        resetting,
    )
}
NOT_BEGUN = ("filling", "waiting_for_its_stamp", "armed", "armed_and_seen")
REQUESTS: dict[str, Callable[[Scene], Future[Any] | None]] = {
    "enable": lambda scene: scene.bench.group.enable(),
    "disable": lambda scene: scene.bench.path.disable(),
    "halt": lambda scene: scene.bench.group.halt(),
    "quick_stop": lambda scene: scene.bench.group.quick_stop(),
    "reset_fault": lambda scene: scene.bench.group.reset_fault(),
    "stop": lambda scene: scene.bench.path.stop(),
    "move": lambda scene: scene.move(0.2),
    "move_at_a_stamp": lambda scene: scene.move(-0.2, stamp_s=0.4),
}
ENDS = ("stop", "halt", "quick_stop", "disable")


def made_scene() -> Scene:
    config = DriverConfig(
        axes=makers(
            "epos2", "copley", max_velocity=MAX_VELOCITY, max_acceleration=MAX_ACCELERATION
        ),
        buffer_time=0.3,
    )
    drives = [
        drive_of(axis, drift_ppm=60.0 * (-1) ** axis.node_id, record=True) for axis in config.axes
    ]
    return Scene(Bench(config, drives))


def settle(scene: Scene) -> None:
    """Run until nothing is left to be answered, then see that all is in order."""
    bench, group = scene.bench, scene.bench.group
    asked_us = bench.now_us

    def over() -> bool:
        answered = all(answer is None or answer.done() for _, _, answer, _ in scene.asked)
        rests = group.phase in (Phase.DISABLED, Phase.STANDING, Phase.FAULT)
        return answered and rests and group.motion is None and bench.now_us > asked_us + 600_000

    bench.run(ANSWER_WITHIN_S, over)
    assert over(), f"{group.describe_phase()}: {[a for a in scene.asked if a[2]]}"


def way_back(scene: Scene) -> None:
    """From wherever it is, the machine moves again, and arrives."""
    bench = scene.bench
    bench.wait(bench.group.reset_fault())
    bench.wait(bench.group.enable())
    scene.move(0.05)
    motion = bench.group.motion
    assert motion is not None
    bench.wait(motion, 10.0)
    for demand, end in zip(scene.demands(), (0.05, -0.05), strict=True):
        assert demand == pytest.approx(end * QC_PER_RAD, abs=0.6)


def assert_no_jump(scene: Scene, quick: bool) -> None:
    """A demand steps by no more than the velocity allows, changes it no faster than ramps do.

    A halt and a quick stop leave the path, on the drive's own ramps (10,000 rpm/s).
    """
    for drive in scene.bench.drives:
        path = np.array([q for _, q in drive.recorder.executed()]) / QC_PER_RAD
        if len(path) > 2:
            assert np.abs(np.diff(path)).max() <= MAX_VELOCITY * 1.06e-3
            if not quick:
                bend = np.abs(np.diff(path, 2)).max() * 1e6
                assert bend <= MAX_ACCELERATION * 1.3 + 2 / QC_PER_RAD * 1e6


def play(phase: str, requests: tuple[str, ...], delays_s: tuple[float, ...]) -> Scene:
    scene = made_scene()
    PHASES[phase](scene)
    before = scene.demands()
    for request, delay_s in zip(requests, delays_s, strict=True):
        scene.bench.run(delay_s)
        scene.ask(request)
    settle(scene)
    if phase != "in_fault" and phase != "resetting":
        assert not [event for event in scene.bench.events if event.kind == "fault"]
    begins = any(request.startswith("move") for request in requests)
    if phase in NOT_BEGUN and requests[0] in ENDS and delays_s[0] == 0 and not begins:
        assert scene.demands() == before, "what had not begun has begun"
        assert any(event.kind == "cancelled" for event in scene.bench.events)
    if requests[-1] == "disable" and not begins:
        assert scene.phase in (Phase.DISABLED, Phase.FAULT)
    way_back(scene)
    assert_no_jump(scene, bool({"halt", "quick_stop"} & {name for name, *_ in scene.asked}))
    return scene


@pytest.mark.parametrize("request_name", REQUESTS)
@pytest.mark.parametrize("phase", PHASES)
def test_every_request_in_every_phase(phase, request_name):
    play(phase, (request_name,), (0.0,))


def pairs() -> list[tuple[str, tuple[str, str], tuple[float, float]]]:
    every = list(itertools.product(PHASES, REQUESTS, REQUESTS))
    chance = random.Random(11)
    count = int(os.environ.get("REQUESTS_PAIRS", "60"))
    chosen = chance.sample(every, min(count, len(every)))
    delays = (0.0, 0.0002, 0.001, 0.004, 0.02, 0.1, 0.3)
    return [
        (phase, (first, second), (chance.choice((0.0, 0.0, 0.002)), chance.choice(delays)))
        for phase, first, second in chosen
    ]


@pytest.mark.parametrize(("phase", "requests", "delays_s"), pairs())
def test_pairs_of_requests(phase, requests, delays_s):
    play(phase, requests, delays_s)


@pytest.mark.parametrize("phase", NOT_BEGUN)
def test_drives_that_do_not_move_are_off_at_once(phase):
    scene = made_scene()
    PHASES[phase](scene)
    off = scene.bench.path.disable()
    scene.bench.wait(off, OFF_WITHIN_S)
    assert all(drive.dictionary[0x6041, 0].pack()[0] & 0x6F == 0x21 for drive in scene.bench.drives)


@pytest.mark.parametrize("phase", NOT_BEGUN)
def test_a_replacement_begins_at_once_instead_of_what_waited(phase):
    """Not the old one first, and not at its stamp."""
    scene = made_scene()
    PHASES[phase](scene)
    old = scene.bench.group.motion
    asked_us = scene.bench.now_us
    scene.move(-0.25)  # the old one goes to +0.3
    scene.run_to(Phase.MOVING, 0.25)
    assert scene.bench.machine.path_time.start_us - asked_us < 0.2e6
    assert old.exception() is not None and "before it began" in str(old.exception())
    settle(scene)
    path = np.array([q for _, q in scene.bench.drives[0].recorder.executed()]) / QC_PER_RAD
    u = np.clip((np.arange(len(path)) - 1) / 800, 0, 1)  # after a record that holds for 1 ms
    assert np.abs(path + 0.25 * (10 * u**3 - 15 * u**4 + 6 * u**5)).max() <= 1.1 / QC_PER_RAD


@pytest.mark.parametrize("duration_ms", [0, 1, 2, 5, 10, 20, 40, 80, 150])
@pytest.mark.parametrize("hold", [True, False])
def test_a_motion_may_be_short(duration_ms, hold):
    """A hold of 40 ms, or the last 40 ms of a trajectory, is no fault."""
    scene = made_scene()
    reach = 0.0 if hold else MAX_ACCELERATION / 10 * (duration_ms / 1000) ** 2
    standing(scene)
    times = np.array([0.0, duration_ms / 1000]) if duration_ms else np.array([0.0])
    points = np.array([[0.0, 0.0], [reach, -reach]])[: len(times)]
    scene.bench.path.submit(Trajectory(JOINTS, times, points), None, scene.bench.now_us)
    settle(scene)
    assert scene.phase is Phase.STANDING
    assert scene.bench.events[-1].kind == "done"
    way_back(scene)
