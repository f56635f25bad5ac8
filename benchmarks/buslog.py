"""What a log costs: its size, CPU time, and how late the driver feeds with and without it.

    python -m benchmarks.buslog                     # ten minutes; the figures of docs/replay.md
    python -m benchmarks.buslog --seconds 60

Two drivers of six axes move at the same time, so that both meet the same neighbours: one with
`log.file`, one without. Each is a process of its own, its simulated drives another behind an slcan
adapter on a pseudo-terminal. Late is how long after it was due a record, a SYNC or a time stamp
was dealt with; CPU time is that of the driver's process.
"""

from __future__ import annotations

import argparse
import gc
import shutil
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import FIRST_EXCEPTION, ProcessPoolExecutor, wait
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from simulated_time import axes

from benchmarks.feeding import AXES, trajectory
from epos2_ros.bus.driver import Driver
from epos2_ros.buslog.writer import earlier_files
from epos2_ros.configuration.driver import DriverConfig
from epos2_ros.demo.child import Child
from epos2_ros.motion import knots
from epos2_ros.protocol.outbox import Event
from epos2_ros.protocol.phase import Phase

READY_S = 60.0
SETTLE_S = 15.0  # for the last record to be executed
SWITCH_INTERVAL_S = 0.0005  # as the node has it
LOOK_S = 0.5


@dataclass
class Cost:
    """Of one run in motion."""

    cpu: float  # share of one core
    late_us: np.ndarray  # of everything that was due
    moved_s: float
    events: list[Event]


def measure(file: Path | None, seconds: float) -> Cost:
    """Six axes in motion for so long; `file`: of the log."""
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    knots.prepare()
    events: list[Event] = []
    options = ["--slcan", "--nodes", f"1-{AXES}", "--drift-ppm", "50"]
    with Child("simulator", options, {}) as drives:
        channel = drives.first_line(READY_S).split()[-1]
        config = DriverConfig(
            axes=axes(AXES),
            interface="slcan",
            channel=channel,
            simulate=False,
            log_file=None if file is None else str(file),
            buffer_time=2.0,
            log_size=1000.0,
        )
        driver = Driver(config, events.append)
        driver.configure()
        gc.collect()
        gc.freeze()
        late_us: list[float] = []
        group, advance = driver._group, driver._group.advance

        def noting(now_us: float) -> None:
            if group.deadline_us <= now_us and group.phase is Phase.MOVING:
                late_us.append(now_us - group.deadline_us)
            advance(now_us)

        group.advance = noting  # type: ignore[method-assign]
        try:
            driver.enable()
            driver.submit(trajectory(seconds, seed=1))
            begun_s, cpu_s = time.monotonic(), time.process_time()
            end_s = begun_s + seconds + SETTLE_S
            time.sleep(seconds)
            cpu = (time.process_time() - cpu_s) / (time.monotonic() - begun_s)
            while driver.snapshot().state == "moving" and time.monotonic() < end_s:
                time.sleep(LOOK_S)
        finally:
            driver.close()
        return Cost(cpu, np.array(late_us), seconds, events)


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="copy the log there")
    chosen = parser.parse_args(argv)
    with (
        tempfile.TemporaryDirectory() as folder,
        ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool,
    ):
        file = Path(folder) / "run.asc"
        runs = [pool.submit(measure, log, chosen.seconds) for log in (None, file)]
        for run in wait(runs, return_when=FIRST_EXCEPTION).done:
            run.result()  # raises at once what one has met
        costs = [run.result() for run in runs]
        files = [file, *earlier_files(file)]
        size = sum(path.stat().st_size for path in files)
        if chosen.keep is not None:
            shutil.copytree(folder, chosen.keep, dirs_exist_ok=True)
    print("| | CPU, of one core | late: median | 99 % | 99.9 % | most [us] | due |")
    print("|---|---|---|---|---|---|---|")
    for name, cost in zip(("without a log", "with"), costs, strict=True):
        late = np.quantile(cost.late_us, [0.5, 0.99, 0.999, 1.0])
        figures = " | ".join(f"{value:.0f}" for value in late)
        print(f"| {name} | {cost.cpu:.2%} | {figures} | {len(cost.late_us)} |")
    for name, cost in zip(("without a log", "with"), costs, strict=True):
        for event in cost.events:
            if event.kind == "fault":  # what stands above is of less than was asked for
                raise SystemExit(f"{name}: {event.text}")
    minutes = chosen.seconds / 60 * AXES
    print(
        f"\n{size / 1e6:.2f} MB for {chosen.seconds:g} s of {AXES} axes: "
        f"{size / minutes / 1e3:.0f} kB per axis and minute"
    )


if __name__ == "__main__":
    main()
