"""Random motions, stopped, replaced and streamed at random instants: is every one of them fitted?

`python -m benchmarks.campaign --count 100000` runs so many, each from a seed of its own, and prints
every seed whose records were not found, or leave the tolerance or a limit of a drive;
`--seed N` runs one of them again and says what happened when.

Slow axes above all: where a few counts and a few units of velocity are all there is, rounding
leaves the least room.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from epos2_ros.bus.settings import fit_axis
from epos2_ros.configuration.driver import AxisConfig, DriverConfig
from epos2_ros.errors import TrajectoryError
from epos2_ros.motion.curve import Curve
from epos2_ros.motion.fit import Fitter
from epos2_ros.motion.join import join
from epos2_ros.motion.limits import Limits, extremes
from epos2_ros.motion.pvt import executed, segments
from epos2_ros.motion.record import MAX_SEGMENT_MS, Record
from epos2_ros.motion.reference import Reference
from epos2_ros.motion.stop import stop
from epos2_ros.motion.stream import Stream
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.motion.units import AxisUnits
from epos2_ros.protocol.pvt.feeder import MIN_RECORDS_AHEAD, STREAM_SEGMENT_MS

Array = NDArray[np.float64]
Random = np.random.Generator

COUNTS_PER_TURN = (2000, 2000, 2000, 512, 1024, 4096, 40_000)
NOTATIONS = (0, 0, 0, 0, -1, -3)
TOLERANCES_QC = (0.5, 0.6, 1.0, 1.0, 1.0, 2.0, 10.0)
SMOOTHNESSES = (0.0, 0.3, 1.0)
BUFFER_TIMES_S = (0.05, 0.08, 0.15, 0.3, 0.5, 0.5, 1.0)
SLACK_QC = 1e-6
ROUNDING_QC = 0.5  # more than the tolerance, where the fitter says so
LATEST_MS = 1000  # after the end commanded


class Trouble(Exception):
    """What a drive or a user would complain of."""


def some(random: Random, low: float, high: float) -> float:
    """A number between, each decade as likely as the next."""
    return float(np.exp(random.uniform(np.log(low), np.log(high))))


def random_axis(random: Random, number: int) -> AxisConfig:
    """A joint whose limits are 0.5 … 3000 rpm of the motor, reached in 20 ms … 3 s."""
    gear = some(random, 1, 200)
    velocity = some(random, 0.5, 3000) * 2 * math.pi / 60 / gear
    return AxisConfig(
        f"joint_{number}",
        number,
        counts_per_turn=int(random.choice(COUNTS_PER_TURN)),
        gear_ratio=gear,
        direction=int(random.choice((1, -1))),
        velocity_notation=int(random.choice(NOTATIONS)),
        max_velocity=velocity,
        max_acceleration=None if random.random() < 0.05 else velocity / some(random, 0.02, 3),
    )


def random_trajectory(random: Random, limits: Limits, start: Array) -> Trajectory:
    """From `start` through some points to rest, as fast as the limits allow or slower."""
    count = int(random.integers(2, 6))
    steps = np.array([some(random, 0.05, 2) for _ in range(count - 1)])
    times = np.concatenate(([0.0], np.cumsum(steps)))
    speed = limits.velocity * some(random, 0.01, 1)
    ways = random.uniform(-1, 1, (count - 1, len(start))) * speed * steps[:, None]
    ways *= random.random((count - 1, len(start))) < 0.9  # an axis may rest
    positions = start + np.vstack((np.zeros(len(start)), np.cumsum(ways, axis=0)))
    velocities = accelerations = None
    kind = random.random()
    if kind < 0.7:
        velocities = random.uniform(-1, 1, positions.shape) * speed
        velocities[[0, -1]] = 0
    if kind < 0.35:
        accelerations = random.uniform(-1, 1, positions.shape) * speed / steps.mean()
        accelerations[[0, -1]] = 0
    _, velocity, acceleration = extremes(Curve(times, positions, velocities, accelerations))
    slower = max(
        float(np.max(np.maximum(velocity.high, -velocity.low) / limits.velocity)),
        float(np.max(np.maximum(acceleration.high, -acceleration.low) / limits.agility)) ** 0.5,
        1e-3,
    ) * random.choice((1.0, some(random, 1, 10)))
    return Trajectory(
        limits.joints,
        times * slower,
        positions,
        None if velocities is None else velocities / slower,
        None if accelerations is None else accelerations / slower**2,
    )


@dataclass
class Run:
    """One motion, fed to drives as `protocol.feeder` does, and watched."""

    axes: Sequence[AxisConfig]
    config: DriverConfig
    say: Callable[[str], None] | None = None
    records: int = 0
    beyond: int = 0  # how often an axis was off by more than the tolerance, as fast ones may be
    late_ms: int = 0  # how much later than commanded the last axis ended
    ended: set[int] = field(default_factory=set)

    def __post_init__(self) -> None:
        self.limits = Limits.of(self.axes)
        self.units = tuple(AxisUnits.of(axis) for axis in self.axes)
        self.fits = [fit_axis(axis, self.config) for axis in self.axes]
        self.fitter = Fitter(self.fits, self.config.tolerance, smoothness=self.config.smoothness)
        self.last: list[Record] = []
        self.before: list[Record] = []  # the reference
        self.judged: list[list[Record]] = [[] for _ in self.axes]  # or still to be, along it
        self.ends_ms: list[list[int]] = [[] for _ in self.axes]
        self.told_qc = [0.0 for _ in self.axes]  # how far off the fitter said it goes since judged

    def tell(self, text: str) -> None:
        if self.say:
            self.say(text)

    def begin(self, reference: Reference) -> None:
        start = [round(x) for x in reference.positions(np.zeros(1, dtype=np.int64))[0]]
        self.last = [Record(qc, 0, 0) for qc in start]
        self.before = list(self.last)
        self.follow(reference)
        self.fitter.begin(reference, start)

    def replace(self, reference: Reference) -> None:
        self.judge()
        reference = reference.trimmed(min(map(self.fitter.committed_ms, range(len(self.axes)))))
        self.follow(reference)
        self.fitter.replace(reference)

    def follow(self, reference: Reference) -> None:
        self.reference = reference
        self.ahead_ms = self.config.buffer_time * 1000
        if isinstance(reference.motions[-1], Stream):
            self.ahead_ms = min(self.ahead_ms, self.config.stream_ahead * 1000)
        streamed = isinstance(reference.motions[-1], Stream)
        longest = STREAM_SEGMENT_MS if streamed else max(4, self.ahead_ms // MIN_RECORDS_AHEAD)
        self.fitter.max_segment_ms = int(min(MAX_SEGMENT_MS, longest))

    @property
    def committed_ms(self) -> int:
        return max(map(self.fitter.committed_ms, range(len(self.axes))))

    def feed(self, now_ms: float) -> None:
        """All that is due until `now_ms`."""
        while True:
            axis = min(
                (i for i in range(len(self.axes)) if i not in self.ended),
                key=self.due_ms,
                default=None,
            )
            if axis is None or self.due_ms(axis) > now_ms:
                return
            self.next(axis)

    def due_ms(self, axis: int) -> float:
        ends = self.ends_ms[axis]
        fewest = ends[-MIN_RECORDS_AHEAD] if len(ends) >= MIN_RECORDS_AHEAD else -math.inf
        return min(self.fitter.committed_ms(axis) - self.ahead_ms, fewest)

    def next(self, axis: int) -> None:
        k0 = self.fitter.committed_ms(axis)
        try:
            record = self.fitter.next(axis)
        except TrajectoryError as error:
            raise Trouble(
                f"axis {axis} from {k0} of {self.reference.end_ms} ms, {self.last[axis]}: {error}"
            ) from error
        if record is None or k0 > self.reference.end_ms + LATEST_MS:
            raise Trouble(f"axis {axis} is still moving {k0 - self.reference.end_ms} ms too late")
        self.records += 1
        self.told_qc[axis] = max(self.told_qc[axis], self.fitter.off_qc(axis))
        if self.say:
            k1 = np.array([k0 + record.time])
            off = record.position - self.reference.positions(k1)[0, axis]
            unit = self.fits[axis].velocity_unit_qc_s
            swift = record.velocity - self.reference.velocities(k1)[0, axis] / unit
            self.say(
                f"axis {axis} from {k0} to {k1[0]} ms: {tuple(record)}, {off:.3f} qc and "
                f"{swift:.3f} units ({swift * unit / 1000:.4f} qc/ms) beside"
            )
        if record.time == 0:
            self.ended.add(axis)
            self.late_ms = max(self.late_ms, k0 - self.reference.end_ms)
            last = self.reference.positions(np.array([k0]))[0, axis]
            if abs(record.position - last) > 0.5 + SLACK_QC or self.last[axis].velocity:
                raise Trouble(f"axis {axis} ends at {record.position}, not at {last:.3f} qc")
        self.judged[axis].append(record)
        self.last[axis] = record
        self.ends_ms[axis].append(k0 + record.time)

    def judge(self) -> None:
        """What drives make of the records along one reference: do they keep to what they must?"""
        ends_ms = [self.fitter.committed_ms(axis) for axis in range(len(self.axes))]
        since_ms = [
            end_ms - sum(record.time for record in records)
            for end_ms, records in zip(ends_ms, self.judged, strict=True)
        ]
        first_ms = min(since_ms)
        commanded = self.reference.positions(np.arange(first_ms, max(ends_ms) + 1))
        for axis, records in enumerate(self.judged):
            start, moving = self.before[axis], [record for record in records if record.time]
            if moving:
                self.judge_axis(axis, start, moving, commanded[since_ms[axis] - first_ms :, axis])
            self.before[axis] = self.last[axis]
            self.judged[axis], self.told_qc[axis] = [], 0.0

    def judge_axis(
        self, axis: int, start: Record, records: Sequence[Record], commanded: Array
    ) -> None:
        fit, tolerance = self.fits[axis], self.config.tolerance
        way = start.position, records, fit.velocity_unit_qc_s, start.velocity
        position = executed(*way).position_qc
        off = float(np.abs(position - commanded[: len(position)])[1:].max())
        self.beyond += int(off > tolerance + SLACK_QC)
        if off > max(tolerance, self.told_qc[axis]) + SLACK_QC:
            raise Trouble(f"axis {axis} is {off:.3f} qc off, unsaid, before {self.last[axis]}")
        # Of a fast axis the commanded acceleration may jump far between two milliseconds, and the
        # velocity where no acceleration is too much; of a slow one rounding takes half a count.
        jump = fit.max_velocity_qc_s / 1e3
        if fit.max_acceleration_qc_s2 < math.inf:
            jump = min(jump, (fit.max_acceleration_qc_s2 - fit.spare_acceleration_qc_s2) / 1e6)
        if off > tolerance + max(jump / 2, ROUNDING_QC) + SLACK_QC:
            raise Trouble(f"axis {axis} is {off:.3f} qc off, before {self.last[axis]}")
        cubics, times_ms = segments(*way)
        velocity, acceleration = (float(most.max()) for most in cubics.extremes(times_ms / 1000))
        if velocity > fit.max_velocity_qc_s * (1 + 1e-9):
            raise Trouble(f"axis {axis} goes at {velocity:.1f} qc/s, before {self.last[axis]}")
        if acceleration > fit.max_acceleration_qc_s2 * (1 + 1e-9):
            raise Trouble(f"axis {axis}: {acceleration:.1f} qc/s², before {self.last[axis]}")

    def take_over(self, trajectory: Trajectory, now_ms: float, start_ms: int, lead_ms: int) -> bool:
        """Whether it was taken; a way onto it may not exist, or come too late."""
        at_ms = self.committed_ms + lead_ms
        try:
            new = join(self.reference, trajectory, self.limits, at_ms=at_ms, start_ms=start_ms)
        except TrajectoryError as refused:
            self.tell(f"refused: {refused}")
            return False
        self.feed(now_ms + lead_ms / 2)
        if self.ended or self.committed_ms > at_ms:
            return False
        self.replace(new)
        return True


def run(seed: int, say: Callable[[str], None] | None = None) -> Counter[str]:
    """One motion and what happens to it; counts of that. Trouble: what was wrong."""
    random = np.random.default_rng(seed)
    axes = [random_axis(random, i + 1) for i in range(int(random.choice((1, 1, 2))))]
    config = DriverConfig(
        tuple(axes),
        buffer_time=float(random.choice(BUFFER_TIMES_S)),
        tolerance=float(random.choice(TOLERANCES_QC)),
        smoothness=float(random.choice(SMOOTHNESSES)),
    )
    motion = Run(axes, config, say)
    motion.tell(f"{config}\n{motion.fits}")
    place = np.array([units.from_qc(float(random.integers(-1000, 1000))) for units in motion.units])
    trajectory = random_trajectory(random, motion.limits, place)
    rest = Reference.at_rest(motion.units, place)
    motion.begin(join(rest, trajectory, motion.limits, at_ms=0, start_ms=0))
    happened: Counter[str] = Counter(motions=1)
    now_ms = 0.0
    for _ in range(int(random.integers(0, 5))):
        rest_ms = max(motion.reference.end_ms - now_ms, 1.0)
        now_ms += rest_ms * float(random.choice((random.random(), random.random() ** 4)))
        motion.feed(now_ms)
        if motion.ended:
            break
        what = random.random()
        if what < 0.5:
            motion.tell(f"{now_ms:.0f} ms: stop from {motion.committed_ms} ms")
            motion.replace(stop(motion.reference, motion.committed_ms, motion.limits))
            happened["stops"] += 1
        elif what < 0.75:
            at_ms = motion.committed_ms
            lead_ms = int(random.choice((0, 5, 40)))
            here = motion.reference.state(at_ms + lead_ms).position
            new = random_trajectory(random, motion.limits, here)
            start_ms = round(now_ms + random.choice((0.0, 0.0, some(random, 1, 1000))))
            motion.tell(
                f"{now_ms:.0f} ms: replaced from {at_ms} + {lead_ms} ms, start {start_ms} ms"
            )
            happened["replacements"] += motion.take_over(new, now_ms, start_ms, lead_ms)
        else:
            now_ms = stream(random, motion, now_ms, happened)
    motion.feed(math.inf)
    motion.judge()
    happened["records"] = motion.records
    happened["times beyond the tolerance"] = motion.beyond
    happened["late ends"] += motion.late_ms > 0
    motion.tell(f"ended {motion.late_ms} ms late")
    return happened


def stream(random: Random, motion: Run, now_ms: float, happened: Counter[str]) -> float:
    """Some points in a row, as an operator's joystick would send them; returns the time then."""
    period_ms, due_s = some(random, 10, 50), some(random, 0.08, 0.25)
    velocity = motion.limits.velocity * random.uniform(-1, 1, len(motion.axes))
    point = motion.reference.state(motion.reference.end_ms).position
    for _ in range(int(random.integers(1, 40))):
        motion.feed(now_ms)
        if motion.ended:
            break
        if random.random() < 0.1:
            velocity = motion.limits.velocity * random.uniform(-1, 1, len(motion.axes))
        point = point + velocity * period_ms / 1000
        message = Trajectory(motion.limits.joints, np.array([due_s]), point[None, :])
        motion.tell(f"{now_ms:.0f} ms: streamed point {point}")
        happened["points"] += motion.take_over(message, now_ms, round(now_ms), 0)
        now_ms += period_ms * float(random.choice((1.0, random.uniform(0.5, 2))))
    return now_ms


def campaign(seeds: Sequence[int]) -> tuple[Counter[str], dict[int, str]]:
    """Counts over all seeds, and what was wrong with which."""
    counts: Counter[str] = Counter()
    troubles: dict[int, str] = {}
    for seed in seeds:
        try:
            counts += run(seed)
        except Trouble as trouble:
            counts["motions"] += 1
            troubles[seed] = str(trouble)
    return counts, troubles


def main() -> int:
    """Exits with 1 if any motion had trouble."""
    parser = argparse.ArgumentParser(prog="benchmarks.campaign", description=__doc__)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--seed", type=int, help="run this one alone and tell all")
    chosen = parser.parse_args()
    if chosen.seed is not None:
        print(run(chosen.seed, print))
        return 0
    counts, troubles = campaign(range(chosen.first, chosen.first + chosen.count))
    for seed, text in troubles.items():
        print(f"seed {seed}: {text}")
    print(", ".join(f"{number} {what}" for what, number in counts.items()))
    print(f"{len(troubles)} of {counts['motions']} motions had trouble")
    return 1 if troubles else 0


if __name__ == "__main__":
    sys.exit(main())
