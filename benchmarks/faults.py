"""How soon all axes stand after each kind of fault: the table of docs/faults.md.

    python -m benchmarks.faults             # some minutes
    python -m benchmarks.faults --runs 3    # fewer instants of each

In simulated time, with drives as strict as their makers' dictionaries: each kind of fault at random
instants of a motion at up to full speed, of EPOS2 axes on a path and of all makers' drives going to
positions. `reaction` is from the fault until the last axis that can be told to stop has been (or,
without a host, until the last drive begins to brake by itself), `rest` until the last shaft stands.
"""

from __future__ import annotations

import argparse
import math
import random
import sys
from collections.abc import Callable, Iterator
from typing import NamedTuple

from campaign import (
    MAX_VELOCITY,
    QC_PER_RAD,
    Action,
    Axis,
    Meddling,
    Scenario,
    Stage,
    _move,
    _move_to,
    _shaft_qc,
    _simulated_clock,
)

from epos2_ros.protocol.phase import Phase

RAMP_S = 0.3  # from full speed, by `axes.<joint>.stop_deceleration`
SETTLING_S = 0.06  # of a shaft that follows, and of looking for it
SYNC_S, WATCH_S, SILENCE_S = 0.1, 0.5, 0.5
LOOK_S = 0.005
VICTIM = 1  # place of the drive that has the trouble
ON_PATH = (Axis("epos2", 60.0, ""), Axis("epos2", -60.0, ""), Axis("epos2", 0.0, ""))
TO_POSITIONS = (Axis("epos2", 60.0, ""), Axis("cl3e", -60.0, ""), Axis("copley", 0.0, ""))


class Kind(NamedTuple):
    """A fault: what happens, and within what `reaction` has to be [s]."""

    words: str
    happens: Callable[[Stage], object]
    bound_s: float
    only_on_path: bool = False
    host_lives: bool = True


class Measured(NamedTuple):
    """From the fault on [s]."""

    reaction_s: float
    rest_s: float
    said: str


def _foreign(can_id: int, data: bytes) -> Callable[[Stage], object]:
    return lambda stage: stage.director.outbox.append((can_id, data))


def _fault(stage: Stage) -> None:
    drive = stage.drives[VICTIM]
    drive.advance(stage.now_us)
    drive._on_communication_error(0x7320)
    drive._send_events()
    drive._arm()


def _loses(*can_ids: int) -> Callable[[Stage], object]:
    def happen(stage: Stage) -> None:
        stage.wires[VICTIM].work.append(Meddling("lose", frozenset(can_ids), 1, 0.0))

    return happen


def _halt_is_lost(stage: Stage) -> None:
    _loses(0x500 + VICTIM + 1)(stage)
    stage.group.fail("trouble of any kind")


def _clock_jumps(stage: Stage) -> None:
    drive = stage.drives[VICTIM]
    drive._shift_path(4_000.0)
    drive.clock._offset_us += 4_000.0


def _power_cycle(stage: Stage) -> None:
    drive = stage.drives[VICTIM]
    drive.power_off()
    stage.later(50e3, lambda t_us: drive.power_on(t_us))


def _disturb(stage: Stage) -> None:
    """A controlword that somebody's tool writes by SDO: quick stop."""
    data = bytes((0x2B, 0x40, 0x60, 0x00, 0x02, 0, 0, 0))
    stage.director.outbox.append((0x601 + VICTIM, data))


KINDS = (
    Kind("a drive's fault or emergency", _fault, 0.005),
    Kind("a halt that one drive misses", _halt_is_lost, 0.11),
    Kind("a record lost: from where the path is left", _loses(0x201 + VICTIM), 2 * SYNC_S, True),
    Kind("a drive's clock that jumps", _clock_jumps, SYNC_S + 0.01, True),
    Kind("a drive that leaves “operation enabled”", _disturb, 1.5 * SYNC_S + 0.01),
    Kind("a drive that restarts", _power_cycle, SILENCE_S),
    Kind("a drive without power", lambda stage: stage.drives[VICTIM].power_off(), SILENCE_S),
    Kind("a drive cut off the bus", lambda stage: stage.drives[VICTIM].disconnect(), WATCH_S + 0.1),
    Kind("another host's heartbeat, SYNC or PDO", _foreign(0x77F, b"\x05"), 0.005),
    Kind("NMT “stop all” of another host", _foreign(0, b"\x02\x00"), 0.005),
    Kind("the host killed", lambda stage: None, WATCH_S + 0.1, host_lives=False),
    Kind(
        "the bus cut for all",
        lambda stage: [drive.disconnect() for drive in stage.drives],
        WATCH_S + 0.1,
        host_lives=False,
    ),
)


def measure(kind: Kind, on_path: bool, seed: int) -> Measured:
    """One run. The axes move for two seconds; the fault comes anywhere in there."""
    chance = random.Random(seed)
    stage = Stage(Scenario(ON_PATH if on_path else TO_POSITIONS, (), (), seed=seed))
    with _simulated_clock(stage):
        stage.bus.run_until(400e3, lambda *frame: None)
        stage.bring_up()
        stage.enable()
        stage.run(0.5)
        stage.director._agenda.clear()  # the campaign's own judge
        reach, lasts_s = (MAX_VELOCITY * 0.9, 2.0) if on_path else (MAX_VELOCITY * 0.7, 0.0)
        (_move if on_path else _move_to)(stage, Action("", 0.0, reach, lasts_s))
        stage.run(1.0, lambda: stage.group.phase is Phase.MOVING)
        stage.run(chance.uniform(0.1, 1.0 if on_path else 0.7))
        stage.frames.clear()
        since_us = stage.now_us
        kind.happens(stage)
        for place in range(len(stage.drives)):
            stage.bus._look_at(place)
        if kind.only_on_path and "record" in kind.words:
            since_us = _leaves_its_path_us(stage)
        return _watch(stage, kind, since_us)


def _leaves_its_path_us(stage: Stage) -> float:
    """When the demand of the drive is first off the records that the driver has handed over."""
    drive, path = stage.drives[VICTIM], stage.watch.commanded[VICTIM]
    start_us = stage.machine.path_time.start_us
    assert path is not None and start_us is not None
    while stage.group.phase is Phase.MOVING:
        stage.run(0.001)
        k_ms = math.floor((stage.now_us - start_us) / 1000)
        if min(abs(path.at(k) - drive._demand) for k in range(k_ms - 3, k_ms + 4)) > 3.0:
            return stage.now_us
    return stage.now_us  # it was missed before it was due


def _watch(stage: Stage, kind: Kind, since_us: float) -> Measured:
    """Until all shafts have stood for a while, and what has happened should be known."""
    still, places, began = 0, [_shaft_qc(drive) for drive in stage.drives], [0.0, 0.0, 0.0]
    speeds = [0.0] * 3
    rest_us, known_us = since_us, since_us + (kind.bound_s + 0.1) * 1e6
    while still < 20 or stage.now_us < known_us:
        if kind.host_lives:
            stage.run(LOOK_S)
        else:
            stage.bus.run_until(stage.now_us + LOOK_S * 1e6, lambda *frame: None)
        now = [_shaft_qc(drive) for drive in stage.drives]
        moved = [abs(a - b) for a, b in zip(now, places, strict=True)]
        for place, way in enumerate(moved):
            if not began[place] and way < 0.97 * speeds[place]:
                began[place] = stage.now_us
            speeds[place] = max(speeds[place], way)
        places = now
        if max(moved) > 1.0:
            rest_us, still = stage.now_us, 0
        else:
            still += 1
    said = [event.text for event in stage.events if event.kind == "fault"]
    return Measured((_told_us(stage, kind, began) - since_us) / 1e6,
                    (rest_us - since_us) / 1e6, said[0] if said else "")  # fmt: skip


def _told_us(stage: Stage, kind: Kind, began: list[float]) -> float:
    """When the last drive that can be told was first told to halt, or braked without a host."""
    if not kind.host_lives:
        return max(began)
    halts: dict[int, float] = {}
    for t_us, frame, echo in stage.frames:
        if echo and frame.can_id & 0x780 == 0x500:
            word = int.from_bytes(frame.data, "little")
            if word & 0x100 or word & 0x04 == 0:
                halts.setdefault(frame.can_id & 0x7F, t_us)
                if "misses" in kind.words and word & 0x04 == 0:
                    halts[frame.can_id & 0x7F] = t_us
    return max(halts.values(), default=math.inf)


def bound_s(kind: Kind) -> float:
    """Of `rest`."""
    return kind.bound_s + RAMP_S + SETTLING_S


def rows(runs: int) -> Iterator[tuple[Kind, bool, list[Measured]]]:
    """Every kind in both sorts of motion."""
    for kind in KINDS:
        for on_path in (True,) if kind.only_on_path else (True, False):
            yield kind, on_path, [measure(kind, on_path, seed) for seed in range(runs)]


def main() -> int:
    """Exits with 1 where a bound was missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=20)
    runs = parser.parse_args().runs
    speed = MAX_VELOCITY * QC_PER_RAD * 60 / 2000
    print(f"up to {speed:.0f} rpm, {RAMP_S:g} s from there to rest; SYNC every {SYNC_S:g} s")
    print("| fault | motion | reaction at most | measured | all stand at most | measured |")
    print("|---|---|---|---|---|---|")
    late = False
    for kind, on_path, found in rows(runs):
        reaction = max(one.reaction_s for one in found)
        rest = max(one.rest_s for one in found)
        late = late or reaction > kind.bound_s or rest > bound_s(kind)
        motion = "path" if on_path else "to positions"
        print(
            f"| {kind.words} | {motion} | {kind.bound_s:.3f} s | {reaction:.3f} s "
            f"| {bound_s(kind):.2f} s | {rest:.2f} s |",
            flush=True,
        )
    return late


if __name__ == "__main__":
    sys.exit(main())
