"""How much of the bus a motion takes, and how many axes one bus can carry.

    python -m benchmarks.bus_load                   # the tables of docs/time.md
    python -m benchmarks.bus_load --bitrate 500000

The axes of examples/pick_place.yaml, over and over until there are enough, move on drives in
simulated time: every frame takes its real number of bits, stuff bits included, and the lowest
identifier goes first.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from simulated_time import Bench
from trajectories import example

from epos2_ros.configuration.driver import AxisConfig, DriverConfig
from epos2_ros.motion.trajectory import Trajectory

AXES = (1, 6, 12, 32)
STATE_RATES_HZ = (10.0, 50.0, 100.0)
TOLERANCES_QC = (1.0, 10.0)
FULL = 0.60  # of the bus: more leaves too little for SDO and for errors
RECORD, STATE = 0x200, 0x280  # COB-IDs of RPDO1 and TPDO2 without the node id


class Load(NamedTuple):
    """Shares of the bus while the axes move, 0 … 1."""

    records: float
    states: float
    rest: float  # SYNC, the answers to it, time stamps, buffer reports, heartbeats
    sync_late_us: float  # from when a SYNC was to go out to its end on the bus, at worst

    @property
    def total(self) -> float:
        return self.records + self.states + self.rest


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


def measure(count: int, state_rate_hz: float, tolerance_qc: float, bitrate: int) -> Load:
    """The load from the start SYNC to the end of the motion."""
    axes, way = motion(count)
    made = Bench(
        DriverConfig(axes=axes, state_rate=state_rate_hz, tolerance=tolerance_qc, bitrate=bitrate)
    )
    made.enable()
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
    before, begin_us, bits = made.bus.bits_by_function.copy(), made.now_us, made.bus.bits
    made.wait(finished)
    available = (made.now_us - begin_us) / made.bus.bit_us
    spent = made.bus.bits_by_function - before
    sent_us = [t for t, frame, echo in made.frames if echo and frame.can_id == 0x080]
    late_us = [sent - due for due, sent in zip(due_us, sent_us, strict=False)]
    records, states = spent[RECORD] / available, spent[STATE] / available
    return Load(
        records,
        states,
        (made.bus.bits - bits) / available - records - states,
        max(late_us),
    )


def reach(loads: Mapping[int, Load], few: int = 12, many: int = 32) -> int:
    """How many axes before the load passes `FULL`, by the loads of `few` and of `many` axes.

    With many the clocks are not read at every SYNC.
    """
    each = (loads[many].total - loads[few].total) / (many - few)
    return many + math.floor((FULL - loads[many].total) / each)


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--bitrate", type=int, default=1_000_000)
    chosen = parser.parse_args(argv)
    print("| states [Hz] | tolerance [qc] | axes | records | states | rest | load | SYNC [us] |")
    print("|---|---|---|---|---|---|---|---|")
    reaches = []
    for tolerance_qc in TOLERANCES_QC:
        for rate_hz in STATE_RATES_HZ:
            loads = {}
            for count in AXES:
                load = loads[count] = measure(count, rate_hz, tolerance_qc, chosen.bitrate)
                print(
                    f"| {rate_hz:g} | {tolerance_qc:g} | {count} | {load.records:.1%} "
                    f"| {load.states:.1%} | {load.rest:.1%} | {load.total:.1%} "
                    f"| {load.sync_late_us:.0f} |",
                    flush=True,
                )
            reaches.append((rate_hz, tolerance_qc, reach(loads)))
    print(f"\n| states [Hz] | tolerance [qc] | axes before {FULL:.0%} |\n|---|---|---|")
    for rate_hz, tolerance_qc, count in reaches:
        print(f"| {rate_hz:g} | {tolerance_qc:g} | {count} |")


if __name__ == "__main__":
    main()
