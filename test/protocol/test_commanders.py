"""Commanders that do as they like: all requests at once and in every state, floods, garbage.

Each gets an answer within a bound, and when they have calmed down the axes can move.
"""

from __future__ import annotations

import random
import threading
import time
from collections.abc import Callable

import numpy as np
import pytest
from two_processes import SCAN, Rig, rig

from epos2_ros.errors import Epos2RosError
from epos2_ros.motion.trajectory import Trajectory

ANSWER_S = 10.0  # a stop's own limit is 5 s; measured: 0.6 s


def somewhere(rng: random.Random) -> Trajectory:
    target = [[rng.uniform(-0.05, 0.05), rng.uniform(-0.05, 0.05)]]
    return Trajectory(SCAN.joint_names, np.array([rng.uniform(0.3, 2.0)]), np.array(target))


def requests(made: Rig, rng: random.Random) -> list[Callable[[], object]]:
    driver = made.driver
    no_points = Trajectory(SCAN.joint_names, np.zeros(0), np.zeros((0, 2)))
    return [
        driver.enable,
        driver.disable,
        driver.halt,
        driver.quick_stop,
        driver.reset_fault,
        driver.stop_on_path,
        driver.snapshot,
        lambda: driver.submit(no_points),
        lambda: driver.submit(somewhere(rng)),
    ]


class Commanders:
    """Threads that make requests until told to stop; what they got other than an answer."""

    def __init__(self, made: Rig, count: int) -> None:
        self.wrong: list[str] = []
        self.slowest_s = 0.0
        self.answers = 0
        self._stop = threading.Event()
        self._threads = [
            threading.Thread(target=self._run, args=(made, random.Random(n))) for n in range(count)
        ]
        for thread in self._threads:
            thread.start()

    def _run(self, made: Rig, rng: random.Random) -> None:
        asked = requests(made, rng)
        while not self._stop.is_set():
            began_s = time.monotonic()
            try:
                rng.choice(asked)()
            except Epos2RosError as refusal:
                if not str(refusal) or "\n" in str(refusal):
                    self.wrong.append(repr(refusal))
            except BaseException as error:
                self.wrong.append(repr(error))
            self.slowest_s = max(self.slowest_s, time.monotonic() - began_s)
            self.answers += 1
            self._stop.wait(rng.choice([0.0, 0.001, 0.05]))

    def stop(self) -> None:
        self._stop.set()
        for thread in self._threads:
            thread.join()


def trouble(made: Rig, rng: random.Random) -> None:
    simulation = made.driver._simulation
    assert simulation is not None
    drive = rng.choice(simulation._drives)
    match rng.randrange(4):
        case 0 | 1 as kind:
            with simulation._simulator.lock:
                if kind:
                    drive.fail(0x8611)
                else:
                    drive.power_off()
                    drive.power_on(drive.now_us)
        case 2:
            made.driver.broke("the test", ValueError("made up"))
        case 3:
            link = made.driver._link
            assert link is not None
            made.driver._reactor.post(lambda: link.fail("fails for the test"))


@pytest.mark.parametrize("troubled", [False, True])
def test_all_requests_at_once_in_every_state(troubled: bool, fuzz: int) -> None:
    rng = random.Random(1)
    with rig("virtual", f"commanders {troubled}", simulate=True) as made:
        commanders = Commanders(made, 6)
        end_s = time.monotonic() + 3.0 * fuzz
        while time.monotonic() < end_s:
            time.sleep(0.4)
            if troubled:
                trouble(made, rng)
        commanders.stop()
        assert not commanders.wrong
        assert commanders.answers > 50 and commanders.slowest_s < ANSWER_S
        made.wait(lambda snapshot: snapshot.state in ("disabled", "standing", "fault"))
        made.driver.reset_fault()
        made.driver.enable()
        made.go_to((0.01, 0.01))
        closing = Commanders(made, 4)
        time.sleep(0.1)
        made.driver.close()
        time.sleep(0.1)
        closing.stop()
        assert not closing.wrong and closing.slowest_s < ANSWER_S
    assert not [thread for thread in threading.enumerate() if thread.name == "reactor"]
