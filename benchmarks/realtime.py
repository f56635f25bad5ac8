"""How late the driver's thread wakes, and what is left in the buffers, on a busy computer.

    python -m benchmarks.realtime                # two minutes; the figures of docs/realtime.md
    python -m benchmarks.realtime --seconds 600  # what to choose ipm.buffer_time by

The program `driver` moves six axes, without real time and with it, on the computer as it is and
under load: a busy loop for each core, files written through to the disk, memory taken and given
back. The simulated drives are a process of their own behind an slcan adapter; drives are no part of
the computer, so it goes before the load (if that is allowed: nice -15). Late is what
`/diagnostics` says at the end, so of all the time since the driver was started.

Then the interpreter's lock: how late a thread wakes beside another that computes in Python all the
time, for some of `sys.setswitchinterval`, and how often that thread has to let it go.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

import yaml
from simulated_time import axes

from benchmarks.feeding import AXES, trajectory
from epos2_ros.bus.lateness import LatenessFigures
from epos2_ros.bus.reactor import Reactor
from epos2_ros.bus.timestamps import now_us
from epos2_ros.demo.child import Child
from epos2_ros.demo.witness import Witness

READY_S = 120.0
SETTLE_S = 10.0  # for the last record, and the last diagnostics
DOMAIN_ID = 78
DRIVES_NICE = -15
BUSY = "while True: pass"
DISK = """
import os, sys
block = os.urandom(8 << 20)
with open(sys.argv[1], "wb") as file:
    while True:
        for _ in range(32):
            file.write(block)
            file.flush()
            os.fsync(file.fileno())
        file.seek(0)
"""
MEMORY = """
import sys
while True:
    taken = bytearray(int(sys.argv[1]) << 20)
    for page in range(0, len(taken), 4096):
        taken[page] = 1
"""

INTERVALS_MS = (5.0, 0.5, 0.1, 0.02)
PERIOD_US = 5_000.0


@contextmanager
def load(folder: Path, memory_mb: int) -> Iterator[None]:
    """All that others may do on a computer."""
    programs = [[BUSY]] * (os.cpu_count() or 1)
    programs += [[DISK, str(folder / "written")], [MEMORY, str(memory_mb)]]
    running = [subprocess.Popen([sys.executable, "-c", *program]) for program in programs]
    try:
        yield
    finally:
        for process in running:
            process.kill()
        for process in running:
            process.wait()


def parameters(channel: str, priority: int, rate_hz: float, buffer_time_s: float) -> dict[str, Any]:
    six = axes(AXES)
    return {
        "can": {"interface": "slcan", "channel": channel},
        "simulate": False,
        "joints": [axis.joint for axis in six],
        "axes": {axis.joint: {"gear_ratio": axis.gear_ratio} for axis in six},
        "ipm": {"buffer_time": buffer_time_s},
        "state_rate": rate_hz,
        "realtime": {"priority": priority},
    }


def measure(
    priority: int, loaded: bool, folder: Path, chosen: argparse.Namespace
) -> dict[str, dict[str, str]]:
    """The last diagnostics of a motion, by joint and "bus"."""
    file = folder / "params.yaml"
    options = ["--slcan", "--nodes", f"1-{AXES}", "--drift-ppm", "50"]
    with Child("simulator", options, {}) as drives:
        channel = drives.first_line(READY_S).split()[-1]
        ahead_of_the_load(drives.pid)
        given = parameters(channel, priority, chosen.rate, chosen.buffer_time)
        file.write_text(yaml.safe_dump({"/epos2_driver": {"ros__parameters": given}}))
        arguments = ["--ros-args", "--params-file", str(file)]
        with (
            Child("driver", arguments, {"ROS_DOMAIN_ID": str(DOMAIN_ID)}) as node,
            Witness(DOMAIN_ID) as witness,
        ):
            end_s = time.monotonic() + READY_S
            while not witness.ready:
                witness.spin(0.1)
                node.check()
                if time.monotonic() > end_s:
                    raise SystemExit("\n".join(["the driver said:", *node.lines()]))
            with load(folder, chosen.memory) if loaded else nullcontext():
                witness.publish(trajectory(chosen.seconds, seed=1))
                witness.spin(chosen.seconds)
            begun = {axis: its["records_sent"] for axis, its in witness.buffers.items()}
            if not all(int(count) > 2 for count in begun.values()):
                raise SystemExit("\n".join(["nothing has moved; the driver said:", *node.lines()]))
            witness.spin(SETTLE_S)
            node.check()
            return witness.diagnostics


def ahead_of_the_load(pid: int) -> None:
    for thread in Path(f"/proc/{pid}/task").iterdir():
        try:
            os.setpriority(os.PRIO_PROCESS, int(thread.name), DRIVES_NICE)
        except PermissionError:
            print("(the simulated drives wait for the load, too: nice is not allowed)")
            return


def beside_a_computation(interval_ms: float, priority: int, seconds: float) -> LatenessFigures:
    """How late a thread wakes that waits most of the time, beside one that never does."""
    before, ended = sys.getswitchinterval(), threading.Event()
    sys.setswitchinterval(interval_ms / 1000)

    def compute() -> None:
        while not ended.is_set():
            sum(range(100))

    def broke(error: Exception) -> None:
        raise error

    waiting = Reactor(lambda: now_us() + PERIOD_US, broke, priority)
    threading.Thread(target=compute, daemon=True).start()
    waiting.start()
    try:
        time.sleep(seconds)
    finally:
        ended.set()
        waiting.stop()
        sys.setswitchinterval(before)
    figures = waiting.lateness.figures()
    assert figures is not None
    return figures


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--seconds", type=float, default=15.0, help="of motion, four times")
    parser.add_argument("--priority", type=int, default=50, help="realtime.priority")
    parser.add_argument("--rate", type=float, default=50.0, help="state_rate [Hz]")
    parser.add_argument("--buffer-time", type=float, default=0.5, help="ipm.buffer_time [s]")
    parser.add_argument("--memory", type=int, default=512, help="taken and given back [MB]")
    chosen = parser.parse_args(argv)
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    print(f"load average of the last minute before: {os.getloadavg()[0]:.1f}\n")
    print(
        "| load | scheduling, memory | late: median [us] | 99 % | worst | least reserve [ms] "
        "| ended |\n|---|---|---|---|---|---|---|"
    )
    with tempfile.TemporaryDirectory() as name:
        for loaded in (False, True):
            for priority in (0, chosen.priority):
                said = measure(priority, loaded, Path(name), chosen)
                bus = said.pop("bus")
                late = [bus[f"thread late, {which} [us]"] for which in ("median", "99 %", "worst")]
                reserve_ms = min(int(its["least buffer reserve [ms]"]) for its in said.values())
                kind = f"{bus['scheduling']}, {bus['memory']}"
                print(
                    f"| {'busy' if loaded else 'as it is'} | {kind} | {' | '.join(late)} "
                    f"| {reserve_ms} | {bus['group']} |",
                    flush=True,
                )
    print("\n| switch interval [ms] | priority | late: median [us] | 99 % | worst |")
    print("|---|---|---|---|---|")
    for interval_ms in INTERVALS_MS:
        for priority in (0, chosen.priority):
            figures = beside_a_computation(interval_ms, priority, chosen.seconds / 5)
            print(
                f"| {interval_ms:g} | {priority} | {figures.median_us:.0f} "
                f"| {figures.most_us:.0f} | {figures.worst_us:.0f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
