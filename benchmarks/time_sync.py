"""How far apart the drives' clocks are, over SYNC jitter and time stamp noise.

    python -m benchmarks.time_sync                  # standing, the table of docs/time.md
    python -m benchmarks.time_sync --periods        # over the SYNC period
    python -m benchmarks.time_sync --motion         # in motion, with and without the line fit
    python -m benchmarks.time_sync --starts 100     # start spread, and how late they start
    python -m benchmarks.time_sync --sources        # drives as clock master and SYNC producer

In simulated time, the drives' clocks drifting evenly from −100 to +100 ppm, from 2 s after the
bring-up. Jitter is how late the host's thread wakes up (even from 0 on), noise the standard
deviation of its time stamps. Standing drives' clocks are looked at all along, and on either side
of every correction; of a motion it is seen when each drive executed each millisecond of its path.
"""

from __future__ import annotations

import argparse
import itertools
import random
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from simulated_time import Bench, axes

from epos2_ros.configuration.driver import DriverConfig
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.protocol import clock
from epos2_ros.sim.epos2 import Dictionary, Epos2

DRIFT_PPM = 100.0
SETTLED_US = 2e6
LOOK_US = 4.7e3
CONDITIONS = tuple((jitter, noise) for jitter in (0.0, 100.0, 1e3) for noise in (0.0, 20.0, 200.0))


class Drive(Epos2):
    """A drive that says when its clock is about to be corrected, and when it has been."""

    look: Callable[[], object] | None = None

    def _on_timestamp(self, value: int) -> None:
        look = self.look or (lambda: None)
        look()
        super()._on_timestamp(value)
        look()


@dataclass
class Clocks:
    """What was seen of the clocks [µs]."""

    spread: list[float] = field(default_factory=list)  # between the two furthest apart
    worst: float = 0.0  # of it, at any time
    common: list[float] = field(default_factory=list)  # of their mean against true time


def drives(count: int, record: bool, dictionary: Dictionary = Dictionary.MAKER) -> list[Drive]:
    """`count` drives whose clocks start anywhere and drift evenly from −100 to +100 ppm."""
    return [
        Drive(n, drift_ppm=drift, offset_us=1e9 * n, record=record, dictionary=dictionary)
        for n, drift in enumerate(np.linspace(-DRIFT_PPM, DRIFT_PPM, count), start=1)
    ]


def bench(
    jitter_us: float,
    noise_us: float,
    count: int,
    period_s: float,
    record: bool = False,
    source: str = "host",
    producer: str = "host",
) -> Bench:
    """Drives brought up and enabled; the host wakes up late and stamps what it sees badly."""
    rng = random.Random(f"{jitter_us} {noise_us} {count} {period_s}")
    made = Bench(
        DriverConfig(
            axes=axes(count), sync_period=period_s, sync_source=source, sync_producer=producer
        ),
        drives(
            count, record, Dictionary.NOTE if {source, producer} - {"host"} else Dictionary.MAKER
        ),
        bring_up=False,
    )
    made.late_us = lambda: rng.uniform(0.0, jitter_us)
    made.stamp_us = lambda t_us: t_us + rng.gauss(0.0, noise_us)
    made.bring_up()
    made.enable()
    return made


def watch(made: Bench, seconds: float) -> Clocks:
    """The clocks of standing drives."""
    made.run(SETTLED_US / 1e6)
    zero_us = next(t for t, frame, _ in made.frames if frame.can_id == 0x100)
    seen = Clocks()

    def spread() -> float:
        values = [drive.clock.value(made.now_us) for drive in made.drives]
        wide = max(values) - min(values)
        seen.worst = max(seen.worst, wide)
        return wide

    for drive in made.drives:
        drive.look = spread
    end_us = made.now_us + seconds * 1e6
    while made.now_us < end_us:
        made.run(LOOK_US / 1e6)
        seen.spread.append(spread())
        values = [drive.clock.value(made.now_us) for drive in made.drives]
        seen.common.append(float(np.mean(values)) - (made.now_us - zero_us))
        made.frames.clear()
    return seen


def watch_motion(made: Bench, seconds: float) -> Clocks:
    """The clocks of drives that move back and forth, going by the time on their paths."""
    made.run(SETTLED_US / 1e6)
    times_s = np.arange(0.0, seconds + 1.0)
    positions = np.outer(np.arange(len(times_s)) % 2, np.linspace(0.1, 0.2, len(made.drives)))
    positions[-1] = 0.0
    joints = tuple(axis.joint for axis in made.config.axes)
    made.path.submit(Trajectory(joints, times_s, positions, None, None), None, made.now_us)
    motion = made.group.motion
    assert motion is not None
    while not motion.done():
        made.run(10.0, motion.done)
        made.frames.clear()
    motion.result()
    columns = [np.array(drive.recorder.time_us) for drive in made.drives if drive.recorder]
    at_us = np.array([column[: min(map(len, columns))] for column in columns])
    spread = np.ptp(at_us, axis=0)
    if spread[0]:
        raise SystemExit(f"the drives started {spread[0]} us apart")
    common = at_us.mean(axis=0) - at_us[0, 0] - 1e3 * np.arange(len(spread))
    return Clocks(spread.tolist(), float(spread.max()), common.tolist())


def starts(made: Bench, count: int) -> tuple[float, np.ndarray]:
    """Of `count` short motions, each at a time given 0.4 s ahead: the most any two drives started
    apart, and how much later than the time given [us]."""
    made.run(SETTLED_US / 1e6)
    joints = tuple(axis.joint for axis in made.config.axes)
    reach = np.linspace(0.01, 0.02, len(joints))
    spread_us, late_us = 0.0, []
    for number in range(count):
        ends = np.array([number % 2 * reach, (number + 1) % 2 * reach])
        at_us = made.now_us + 0.4e6
        move = Trajectory(joints, np.array([0.0, 0.3]), ends, None, None)
        made.path.submit(move, at_us, made.now_us)
        motion = made.group.motion
        assert motion is not None
        made.wait(motion)
        began_us = [drive.ip_start_us for drive in made.drives]
        spread_us = max(spread_us, max(began_us) - min(began_us))
        late_us.append(began_us[0] - at_us)
        made.frames.clear()
    return spread_us, np.array(late_us)


def row(label: str, seen: Clocks) -> None:
    common = np.array(seen.common) - np.mean(seen.common)
    print(
        f"| {label} | {np.median(seen.spread):.1f} | {np.quantile(seen.spread, 0.999):.1f} "
        f"| {seen.worst:.1f} | {np.abs(common).max():.1f} | {np.abs(np.diff(common)).max():.1f} |",
        flush=True,
    )


def head(label: str) -> None:
    print(f"| {label} | median | 99.9 % | worst | common: worst | step |")
    print("|---|---|---|---|---|---|")


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--seconds", type=float, default=600.0, help="of simulated time")
    parser.add_argument("--axes", type=int, default=6)
    parser.add_argument("--period", type=float, default=0.1, help="sync.period [s]")
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--motion", action="store_true", help="in motion, from the drives' logs")
    what.add_argument("--periods", action="store_true", help="over sync.period")
    what.add_argument("--sources", action="store_true", help="over sync.source, sync.producer")
    what.add_argument("--starts", type=int, metavar="N", help="of N motions at a given time")
    chosen = parser.parse_args(argv)
    count, period_s = chosen.axes, chosen.period
    if chosen.periods:
        head("sync.period [s]")
        for period_s in (0.2, 0.1, 0.05, 0.02, 0.01):
            made = bench(100.0, 20.0, count, period_s)
            row(f"{period_s:g}", watch(made, chosen.seconds))
        return
    if chosen.sources:
        head("sync.source, sync.producer, sync.period [s]")
        for source, producer in itertools.product(("host", "joint_3"), ("host", "joint_2")):
            for period_s in (0.1, 0.05):
                made = bench(100.0, 20.0, count, period_s, source=source, producer=producer)
                row(f"{source}, {producer}, {period_s:g}", watch(made, chosen.seconds))
        return
    if chosen.starts:
        print("| SYNC jitter, noise [us] | start spread, worst | start late, median | worst |")
        print("|---|---|---|---|")
        for jitter_us, noise_us in CONDITIONS:
            spread_us, late_us = starts(
                bench(jitter_us, noise_us, count, period_s, record=True), chosen.starts
            )
            print(
                f"| {jitter_us:g}, {noise_us:g} | {spread_us:.1f} | {np.median(late_us):.0f} "
                f"| {late_us.max():.0f} |",
                flush=True,
            )
        return
    head("SYNC jitter, noise [us]")
    if chosen.motion:
        for label, needed in (("without the line", sys.maxsize), ("with it", clock.MIN_FIT)):
            clock.MIN_FIT = needed  # SYNCs seen before there is a line
            made = bench(100.0, 20.0, count, period_s, record=True)
            row(f"100, 20, {label}", watch_motion(made, chosen.seconds))
        return
    for jitter_us, noise_us in CONDITIONS:
        made = bench(jitter_us, noise_us, count, period_s)
        row(f"{jitter_us:g}, {noise_us:g}", watch(made, chosen.seconds))


if __name__ == "__main__":
    main()
