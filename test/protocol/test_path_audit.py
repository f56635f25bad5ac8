"""The audit of the executed path: what it has to notice and when, and what it must not mind.

What a drive executes is computed here by Hermite's form of the cubic (or by the simulated drive);
how far off it may be before it is noticed, from the bound that `path_audit` states.
"""

from __future__ import annotations

import math
import random
from bisect import bisect_left
from collections.abc import Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from simulated_time import Bench, axes
from six_axes import commanded_qc, there_and_back

from benchmarks.time_sync import bench as drifting_bench
from epos2_ros.configuration.driver import DriverConfig
from epos2_ros.errors import MotionAborted
from epos2_ros.motion.record import Record
from epos2_ros.protocol.phase import Phase
from epos2_ros.protocol.pvt.path_audit import PathAudit
from epos2_ros.sim.epos2 import Epos2

UNIT_QC_S = 2000 / 60
PERIOD_US = 100_000.0
WRAP = 1 << 32


# ---------------------------------------------------------------------------- a drive in numbers


def some_records(rng: random.Random, seconds: float, start: int = 0) -> list[Record]:
    """Smooth enough: a random walk of velocities of up to 2000 rpm, with rests between."""
    records, position, speed, total = [], start, 0, 0
    while total < 1000 * seconds:
        time = rng.randint(1, 166)
        target = rng.choice([0, 0, rng.randint(-2000, 2000), speed])
        position += round((speed + target) / 2 * UNIT_QC_S * time / 1000)
        speed, total = target, total + time
        records.append(Record(position, speed, time))
    position += round(speed * UNIT_QC_S * 0.05)
    return [*records, Record(position, 0, 100), Record(position, 0, 0)]


class Executed:
    """What a drive makes of records."""

    def __init__(self, start: int, records: list[Record]) -> None:
        self.knots, self.ends = [(start, 0.0)], [0]
        for record in records:
            if record.time:
                self.knots.append((record.position, record.velocity * UNIT_QC_S))
                self.ends.append(self.ends[-1] + record.time)

    def at(self, k: int) -> float:
        if k <= 0:
            return self.knots[0][0]
        n = bisect_left(self.ends, k)
        if n == len(self.ends):
            return self.knots[-1][0]
        (p0, v0), (p1, v1) = self.knots[n - 1], self.knots[n]
        h = (self.ends[n] - self.ends[n - 1]) * 1e-3
        u = (k - self.ends[n - 1]) * 1e-3 / h
        return (
            (1 + 2 * u) * (1 - u) ** 2 * p0
            + u * (1 - u) ** 2 * h * v0
            + u * u * (3 - 2 * u) * p1
            + u * u * (u - 1) * h * v1
        )


class Run:
    """SYNC after SYNC to an audit; the drive's clock drifts, is corrected, and wraps.

    `delay_us`: between SYNC and sample. `knobs` may lose, delay and repeat answers.
    """

    def __init__(
        self,
        sent: list[Record],
        executed: list[Record] | None = None,
        seed: int = 0,
        start: int = 0,
        delay_us: float = 0.0,
        jitter_us: float = 0.0,
        drift: float = 0.0,
        host_late_us: float = 0.0,
        lost: float = 0.0,
        repeated: float = 0.0,
        late: float = 0.0,
        always_late_us: float = 0.0,
        start_syncs_late: int = 0,
        sign: int = 1,
    ) -> None:
        self.audit = PathAudit(UNIT_QC_S, 1.0, PERIOD_US)
        self.audit.rest(start)
        for record in sent:
            self.audit.send(record)
        self.end_ms = sum(record.time for record in sent)
        self.curve = Executed(start, sent if executed is None else executed)
        self.truth = Executed(start, sent)
        self.rng = random.Random(seed)
        self.delay_us, self.jitter_us, self.drift, self.sign = delay_us, jitter_us, drift, sign
        self.host_late_us, self.lost, self.repeated, self.late = host_late_us, lost, repeated, late
        self.start_syncs_late, self.always_late_us = start_syncs_late, always_late_us
        self.worst_qc = 0.0  # of what was not noticed, at a SYNC

    def run(self) -> tuple[str, float]:
        """What the audit says first, and when on the path [s]; ("", inf): nothing."""
        rng, audit = self.rng, self.audit
        t_us, clock, path_us, zero_us = 1e9, rng.uniform(0, WRAP), None, math.inf
        pending: list[tuple[float, Callable[[], str]]] = []
        for number in range(-3, 10**9):
            host_us = t_us + rng.uniform(0, self.host_late_us)
            if number - self.start_syncs_late == 0:
                path_us = 0.0
            if wrong := audit.on_sync(host_us, number == 0):
                return wrong, (t_us - zero_us) / 1e6
            if number == 0:
                zero_us = t_us
            at_us = -1.0 if path_us is None else path_us + self.delay_us
            at_us += rng.uniform(-self.jitter_us, self.jitter_us)
            k = math.floor(at_us / 1000)
            demand = rng.choice([round, math.floor])(self.sign * self.curve.at(k))
            latched = math.floor(clock) % WRAP
            deaf = self.start_syncs_late > number >= 0
            path_s = (t_us - zero_us) / 1e6  # -inf before the start
            step_us = PERIOD_US + rng.uniform(-1e3, 1e3)
            later_us = rng.uniform(0, 250e3) if rng.random() < self.late else 0.0
            if path_s > 2.0:
                later_us += self.always_late_us
            copies = 2 if rng.random() < self.repeated else 1
            if not (deaf or rng.random() < self.lost):
                for copy in range(copies):
                    at_us = host_us + later_us + 300.0 + 10 * copy
                    pending.append((at_us, lambda at, demand=demand: audit.on_demand(demand, at)))
            read_us = host_us + rng.choice([100.0, rng.uniform(0, 50e3)])
            if rng.random() < self.late:  # who is asked answers before the next SYNC, or not
                read_us += rng.uniform(0, 250e3)
            if not deaf and rng.random() >= self.lost and read_us < t_us + step_us:
                pending.append((read_us, lambda at, clock=latched: audit.on_clock(clock, at)))
            pending.sort(key=lambda item: item[0])
            while pending and pending[0][0] < t_us + step_us:
                at, frame = pending.pop(0)
                if wrong := frame(at):
                    return wrong, path_s
            if number > 0:
                off = abs(self.sign * self.curve.at(k) - self.truth.at(math.floor(1000 * path_s)))
                self.worst_qc = max(self.worst_qc, off)
            stamp_us = rng.uniform(-5, 5)  # what the timekeeper puts right
            clock += stamp_us + (1 + self.drift) * step_us
            if path_us is not None:
                path_us += stamp_us + (1 + self.drift) * step_us
            t_us += step_us
            if 1000 * path_s > self.end_ms + 1000:
                return "", math.inf
        raise AssertionError


# ---------------------------------------------------------------------------- no false alarm


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    start=st.integers(-(2**30), 2**30),
    delay_us=st.floats(-2000, 2000),
    drift=st.floats(-500e-6, 500e-6),
    host_late_us=st.sampled_from([0.0, 200.0, 30_000.0]),
)
def test_a_drive_on_its_path_is_never_complained_of(seed, start, delay_us, drift, host_late_us):
    sent = some_records(random.Random(seed), 20.0, start)
    conditions = {"delay_us": delay_us, "jitter_us": 45.0, "drift": drift}
    run = Run(sent, seed=seed, start=start, host_late_us=host_late_us, **conditions)
    assert run.run() == ("", math.inf)


@pytest.mark.parametrize("trouble", ["lost", "repeated", "late"])
def test_answers_lost_late_or_repeated_are_no_fault(trouble):
    """Two hours each; late is anything up to two and a half SYNC periods."""
    sent = some_records(random.Random(trouble), 7200.0)
    run = Run(sent, seed=1, drift=1e-4, jitter_us=40.0, **{trouble: 0.02})
    assert run.run() == ("", math.inf)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_many_troubles_at_once_are_no_fault(seed):
    sent = some_records(random.Random(seed), 60.0)
    run = Run(sent, seed=seed, lost=0.02, repeated=0.05, late=0.02, host_late_us=500.0)
    assert run.run() == ("", math.inf)


@pytest.mark.parametrize("late_us", [120e3, 150e3, 280e3])
def test_a_drive_that_always_answers_late_is_told(late_us):
    records = [Record(3333, 2000, 100), *(Record(3333 + 6667 * n, 2000, 100) for n in range(1, 99))]
    wrong, at_s = Run(records, seed=4, always_late_us=late_us).run()
    assert wrong == "its answers to SYNC come late"
    assert at_s < 2.0 + 0.9


@pytest.mark.parametrize("segment_ms", [30, 83])
def test_a_drive_that_stands_for_long_at_its_end_is_not_complained_of(segment_ms):
    """However many segments are remembered then."""
    for count in range(60, 150, 3):
        sent = [Record(100 * n, 0, segment_ms) for n in range(1, count + 1)]
        audit, truth = PathAudit(UNIT_QC_S, 1.0, 100e3), Executed(0, sent)
        audit.rest(0)
        for record in [*sent, Record(sent[-1].position, 0, 0)]:
            audit.send(record)
        for number in range(count * segment_ms // 100 + 80):
            t_us = 1e5 * number
            demand = round(truth.at(min(100 * number, count * segment_ms)))
            assert not audit.on_sync(t_us, number == 0)
            assert not audit.on_clock(100_000 * number, t_us + 400.0)
            assert not audit.on_demand(demand, t_us + 500.0)


def test_no_more_answers_are():
    rng = random.Random(3)
    run = Run(some_records(rng, 30.0), seed=3)
    run.audit.on_demand = lambda demand_qc, t_us: ""  # type: ignore[method-assign]
    wrong, _ = run.run()
    assert wrong == "5 SYNCs in a row without its position demand"


# ---------------------------------------------------------------------------- what is noticed


def mutated(records: list[Record], kind: str, at: int, rng: random.Random) -> list[Record]:
    """The records as a drive takes them in: number `at` lost, doubled, swapped or altered."""
    made = list(records)
    record = made[at]
    match kind:
        case "lost":
            del made[at]
        case "doubled":
            made.insert(at, record)
        case "swapped":
            made[at], made[at + 1] = made[at + 1], record
        case "position":
            made[at] = record._replace(position=record.position + rng.choice([-1, 1]) * 64)
        case "velocity":
            made[at] = record._replace(velocity=record.velocity ^ 256)
        case "time":
            made[at] = record._replace(time=record.time % 255 + rng.choice([1, 2, 64]) % 255 or 1)
    return made


KINDS = ("lost", "doubled", "swapped", "position", "velocity", "time")


@pytest.mark.parametrize("kind", KINDS)
def test_whatever_happens_to_a_record_is_noticed_at_the_next_sync_that_shows_it(kind):
    """At a SYNC an axis is never further off than the bound without a complaint: what it moves
    in two control cycles and twice the jitter, and the tolerance and rounding."""
    noticed = 0
    for seed in range(150):
        rng = random.Random(f"{kind} {seed}")
        sent = some_records(rng, 6.0)
        taken = mutated(sent, kind, rng.randrange(len(sent) - 2), rng)
        run = Run(sent, taken, seed=seed, drift=1e-4)
        wrong, _ = run.run()
        noticed += bool(wrong)
        fastest_qc_ms = 2400 * UNIT_QC_S / 1000
        assert run.worst_qc <= fastest_qc_ms * 2.3 + 3, seed
        if wrong:
            assert "a record was lost, repeated or altered" in wrong or "started" in wrong
    assert noticed > 80  # the others concern records of a rest


def test_a_shift_of_one_millisecond_is_noticed_once_the_drive_has_shown_its_delay():
    for seed in range(40):
        rng = random.Random(seed)
        there = [Record(n * 6667, 2000, 100) for n in range(1, 20)]
        sent = [Record(3333, 2000, 100), *(r._replace(position=r.position + 3333) for r in there)]
        at = rng.randrange(5, 15)
        taken = [*sent[:at], sent[at]._replace(time=101), *sent[at + 1 :]]
        wrong, at_s = Run(sent, taken, seed=seed, delay_us=rng.uniform(-900, 900)).run()
        assert "a record was lost, repeated or altered" in wrong
        assert at_s <= 0.1 * at + 0.5 + 0.015  # SYNCs come up to 1 ms late


def test_a_missed_start_is_noticed():
    noticed = 0
    for seed in range(60):
        rng = random.Random(seed)
        sent = [Record(20, 10, 166), *some_records(rng, 6.0, 20)]
        run = Run(sent, seed=seed, start_syncs_late=1)
        wrong, _ = run.run()
        if wrong:
            noticed += 1
            assert "it started one SYNC late" in wrong or "it has not started" in wrong
    assert noticed == 60


def test_another_polarity_or_a_move_before_the_start_is_noticed():
    sent = [Record(1000, 300, 166), Record(2000, 0, 200), Record(2000, 0, 0)]
    wrong, at_s = Run(sent, sign=-1).run()
    assert "velocity notation, polarity or interpolation" in wrong
    assert at_s <= 0.101
    audit = PathAudit(UNIT_QC_S, 1.0, PERIOD_US)
    audit.rest(100)
    audit.on_sync(1000.0, False)
    audit.on_clock(5, 1100.0)
    assert audit.on_demand(102, 1200.0) == ""
    audit.on_clock(6, 1300.0)
    assert audit.on_demand(112, 1400.0) == "its demand has moved by 12 qc while it was to stand"


# ---------------------------------------------------------------------------- the whole group


class Mutating(Epos2):
    """Does something to record number `at` of a motion."""

    kind, at = "", -1
    _count, _held = 0, b""

    def receive(self, can_id, data, t_us, remote=False):
        if can_id == 0x200 + self.node_id:
            taken, self._count = self._count, self._count + 1
            if self._held:
                data, held, self._held = data, self._held, b""
                return super().receive(can_id, data, t_us) and super().receive(can_id, held, t_us)
            if taken == self.at:
                match self.kind:
                    case "lost":
                        return True
                    case "doubled":
                        super().receive(can_id, data, t_us)
                    case "swapped":
                        self._held = data
                        return True
                    case "altered":
                        data = bytes([data[0], data[1] ^ 8, *data[2:]])
        if can_id == 0x080 and self.kind == "deaf to the start" and self._deaf():
            return True
        return super().receive(can_id, data, t_us, remote)

    def _deaf(self) -> bool:
        armed = self.rpdos[1]._waiting is not None
        if armed:
            self.kind = ""
        return armed


def first_stop_us(made: Bench) -> float:
    """When the halt was on the bus."""
    return next(t for t, f, echo in made.frames if echo and f.data == b"\x1f\x01")


@pytest.mark.parametrize("kind", ["lost", "doubled", "swapped", "altered"])
def test_all_axes_stop_within_two_sync_periods(kind):
    for at in (8, 10, 12, 14):
        made = Bench(
            DriverConfig(axes=axes(2)),
            [Mutating(n, record=True, drift_ppm=90.0 * n - 130) for n in (1, 2)],
        )
        made.enable()
        made.drives[1].kind, made.drives[1].at = kind, at
        made.path.submit(there_and_back(joints=2), None, made.now_us)
        with pytest.raises(MotionAborted, match=r"^joint_2 \(node 2\): "):
            made.wait(made.group.motion)
        stop_us = first_stop_us(made)
        rows = zip(*(made.drives[1].recorder.arrays()[c] for c in _COLUMNS), strict=True)
        off = [t for t, k, qc in rows if abs(qc - commanded_qc(k, 1)) > 50 and t < stop_us]
        assert not off or stop_us - off[0] <= 2 * PERIOD_US + 5e3
        made.run(1.0)
        assert made.group.phase is Phase.FAULT


_COLUMNS = ("time_us", "path_ms", "demand_qc")


def test_a_drive_that_misses_the_start_sync_stops_all():
    made = Bench(DriverConfig(axes=axes(2)), [Mutating(n) for n in (1, 2)])
    made.enable()
    made.drives[1].kind = "deaf to the start"
    made.path.submit(there_and_back(joints=2), None, made.now_us)
    with pytest.raises(MotionAborted, match=r"joint_2 \(node 2\): .* not started with the start"):
        made.wait(made.group.motion)
    assert first_stop_us(made) - made.machine.path_time.start_us <= PERIOD_US + 5e3


class Otherwise(Epos2):
    """Takes velocities for those of another notation, and whoever reads it back sees the right."""

    @property
    def _velocity_unit(self) -> float:
        return 10 * super()._velocity_unit


def test_another_velocity_notation_stops_all():
    made = Bench(DriverConfig(axes=axes(2)), [Epos2(1), Otherwise(2)])
    made.enable()
    made.path.submit(there_and_back(joints=2), None, made.now_us)
    with pytest.raises(MotionAborted, match=r"joint_2 \(node 2\)"):
        made.wait(made.group.motion)
    assert first_stop_us(made) - made.machine.path_time.start_us <= 2 * PERIOD_US + 5e3


@pytest.mark.parametrize(("source", "producer"), [("host", "host"), ("joint_3", "joint_2")])
@pytest.mark.parametrize("period_s", [0.05, 0.2])
def test_clean_motion_with_drifting_clocks_late_threads_and_noisy_stamps(
    source, producer, period_s
):
    """From right after the bring-up on."""
    made = drifting_bench(1e3, 200.0, 6, period_s, source=source, producer=producer)
    for _ in range(2):
        made.path.submit(there_and_back(4.0), None, made.now_us)
        made.wait(made.group.motion)
        made.run(0.35)
    assert made.group.phase is Phase.STANDING
