"""How much of the bus a motion takes, and how many axes one bus can carry.

    python -m benchmarks.bus_load                   # the tables of docs/time.md
    python -m benchmarks.bus_load --bitrate 500000

The axes of examples/pick_place.yaml, over and over until there are enough, move on drives in
simulated time: every frame takes its real number of bits, stuff bits included, and the lowest
identifier goes first. The drives' clocks drift evenly from −100 to +100 ppm. What is published, and
how often, is not among the parameters: no frame is sent for it.
"""

from __future__ import annotations

import argparse
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from simulated_time import Bench
from trajectories import example

from epos2_ros.configuration.driver import AxisConfig, DriverConfig
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.sim.epos2 import Epos2

AXES = (1, 6, 12, 32, 64)
TOLERANCES_QC = (1.0, 10.0)
FULL = 0.60  # of the bus: more leaves too little for SDO and for errors
KINDS = {
    "records": {0x200},
    "answers to SYNC": {0x480},
    "time stamps": {0x400},
    "reports": {0x180, 0x280},
    "SDO": {0x580, 0x600},
    "heartbeats": {0x700},
}  # by COB-ID without the node id
DRIFT_PPM = 100.0
SETTLED_S = 6.0
LOOK_S = 0.005


class Load(NamedTuple):
    """While the axes move."""

    frames_s: Mapping[str, float]  # of each kind, and of the others
    total: float  # of the bus, 0 … 1
    sync_late_us: float  # from when a SYNC was to go out to its end on the bus, at worst
    apart_us: float  # the times of two drives on their paths, at worst
    reserve_ms: float  # the least that a drive could have done without a record


def motion(count: int) -> tuple[tuple[AxisConfig, ...], Trajectory]:
    """`count` axes and what they do."""
    model = example("pick_place")
    source = np.arange(count) % len(model.joint_names)
    axes = tuple(
        AxisConfig(f"joint_{n}", n, gear_ratio=100.0, offset=float(model.positions[0, joint]))
        for n, joint in enumerate(source, start=1)
    )
    velocities = None if model.velocities is None else model.velocities[:, source]
    accelerations = None if model.accelerations is None else model.accelerations[:, source]
    names = tuple(axis.joint for axis in axes)
    way = Trajectory(names, model.times_s, model.positions[:, source], velocities, accelerations)
    return axes, way


def measure(
    count: int,
    tolerance_qc: float,
    bitrate: int,
    settled_s: float = SETTLED_S,
    lasts_s: float = math.inf,
) -> Load:
    """From the start SYNC, `settled_s` after enabling, to the end of the motion, or for so long."""
    axes, way = motion(count)
    drifts = np.linspace(-DRIFT_PPM, DRIFT_PPM, count) if count > 1 else [DRIFT_PPM]
    made = Bench(
        DriverConfig(axes=axes, tolerance=tolerance_qc, bitrate=bitrate),
        [Epos2(n, drift_ppm=drift, bitrate=bitrate) for n, drift in enumerate(drifts, start=1)],
    )
    made.enable()
    made.run(settled_s)
    made.path.submit(way, None, made.now_us)
    made.run(10.0, lambda: made.machine.path_time.start_us is not None)
    finished = made.group.motion
    assert finished is not None
    due_us: list[float] = []
    sync = made.group.time.sync

    def noting_sync(now_us: float) -> None:
        if not finished.done():  # then it lets the controlwords to all axes go first
            due_us.append(now_us)
        sync(now_us)

    made.group.time.sync = noting_sync
    made.frames.clear()
    begin_us, bits, apart_us = made.now_us, made.bus.bits, 0.0
    began = _clocks(made)
    while not finished.done() and made.now_us < begin_us + lasts_s * 1e6:
        made.run(LOOK_S, finished.done)
        apart_us = max(apart_us, np.ptp(_clocks(made) - began))
    if finished.done():
        finished.result()
    lasted_us = made.now_us - begin_us
    spent = Counter(_kind(frame.can_id) for _, frame, _ in made.frames)
    sent_us = [t for t, frame, echo in made.frames if echo and frame.can_id == 0x080]
    reserves = [axis.account.reserve_ms for axis in made.machine.interpolated.axes]
    return Load(
        {kind: frames / lasted_us * 1e6 for kind, frames in spent.items()},
        (made.bus.bits - bits) * made.bus.bit_us / lasted_us,
        max(sent - due for due, sent in zip(due_us, sent_us, strict=False)),
        apart_us,
        min(reserve for reserve in reserves if reserve is not None),
    )


def _clocks(made: Bench) -> np.ndarray:
    return np.array([drive.clock.value(made.now_us) for drive in made.drives])


def _kind(can_id: int) -> str:
    return next((kind for kind, cob_ids in KINDS.items() if can_id & 0x780 in cob_ids), "others")


def reach(totals: Mapping[int, float], few: int = 12, many: int = 64) -> int:
    """How many axes before the load passes `FULL`, by the loads of `few` and of `many` axes."""
    each = (totals[many] - totals[few]) / (many - few)
    return many + math.floor((FULL - totals[many]) / each)


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--bitrate", type=int, default=1_000_000)
    parser.add_argument("--axes", type=int, nargs="+", default=AXES, metavar="N")
    chosen = parser.parse_args(argv)
    kinds = [*KINDS, "others"]
    print(
        f"| tolerance [qc] | axes | {' | '.join(kinds)} | frames/s | load | SYNC late [us] "
        "| apart [us] | least reserve [ms] |"
    )
    print("|---" * (len(kinds) + 7) + "|")
    reaches = []
    for tolerance_qc in TOLERANCES_QC:
        totals = {}
        for count in chosen.axes:
            load = measure(count, tolerance_qc, chosen.bitrate)
            totals[count] = load.total
            frames = " | ".join(f"{load.frames_s.get(kind, 0.0):.0f}" for kind in kinds)
            print(
                f"| {tolerance_qc:g} | {count} | {frames} | {sum(load.frames_s.values()):.0f} "
                f"| {load.total:.1%} | {load.sync_late_us:.0f} | {load.apart_us:.1f} "
                f"| {load.reserve_ms:.0f} |",
                flush=True,
            )
        if {12, 64} <= totals.keys():
            reaches.append((tolerance_qc, reach(totals)))
    print(f"\n| tolerance [qc] | axes before {FULL:.0%} |\n|---|---|")
    for tolerance_qc, count in reaches:
        print(f"| {tolerance_qc:g} | {count} |")


if __name__ == "__main__":
    main()
