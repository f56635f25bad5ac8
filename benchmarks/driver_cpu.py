"""CPU time and memory of the driver's process: the node with all its topics.

    python -m benchmarks.driver_cpu
    python -m benchmarks.driver_cpu --start 10       # until the first motion

The program `driver` in real time, simulated drives as a process of their own behind an slcan
adapter on a pseudo-terminal, which loses no frame however busy the computer is. CPU time is what
the kernel has counted for the driver's process, user and system, while the axes stand and while
they move as in bus_load; memory is what is resident at the end. The first motion: from the start of
the process, simulated drives in it, until `/joint_states` show a joint of a trajectory that was
published as soon as the node was active.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import yaml

from benchmarks.bus_load import motion
from epos2_ros.demo.child import Child
from epos2_ros.demo.witness import Witness
from epos2_ros.motion.trajectory import Trajectory

AXES = (1, 6, 12, 32)
STANDING_S = 10.0
READY_S = 120.0
DOMAIN_ID = 77
ARRIVED = 1e-3  # rad
MOVED = 1e-4  # rad


def cpu_s(pid: int) -> float:
    """User and system time of a process so far."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def parameters(count: int, rate_hz: float, channel: str) -> dict[str, object]:
    axes, _ = motion(count)
    return {
        "can": {"interface": "slcan", "channel": channel},
        "simulate": False,
        "joints": [axis.joint for axis in axes],
        "axes": {
            axis.joint: {"node_id": axis.node_id, "gear_ratio": 100.0, "offset": axis.offset}
            for axis in axes
        },
        "ipm": {"buffer_time": 2.0},
        "state_rate": rate_hz,
    }


def resident_mb(pid: int) -> float:
    """Of a process, libraries that others share included."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def measure(count: int, rate_hz: float, folder: Path) -> tuple[float, float, float]:
    """Shares of one core while standing, and while moving; memory [MB]."""
    file = folder / "params.yaml"
    options = ["--slcan", "--nodes", f"1-{count}", "--drift-ppm", "50"]
    with Child("simulator", options, {}) as drives:
        channel = drives.first_line(READY_S).split()[-1]
        driver = {"ros__parameters": parameters(count, rate_hz, channel)}
        file.write_text(yaml.safe_dump({"/epos2_driver": driver}))
        env = {"ROS_DOMAIN_ID": str(DOMAIN_ID)}
        with (
            Child("driver", ["--ros-args", "--params-file", str(file)], env) as node,
            Witness(DOMAIN_ID) as witness,
        ):

            def spent(until: Callable[[], bool], limit_s: float) -> float:
                begun, before_s = time.monotonic(), cpu_s(node.pid)
                while not until():
                    witness.spin(0.1)
                    node.check()
                    if time.monotonic() > begun + limit_s:
                        raise SystemExit("\n".join(["the driver said:", *node.lines()]))
                return (cpu_s(node.pid) - before_s) / (time.monotonic() - begun)

            spent(lambda: witness.ready, READY_S)
            end = time.monotonic() + STANDING_S
            standing = spent(lambda: time.monotonic() > end, READY_S)
            _, way = motion(count)
            witness.publish(way)
            end = time.monotonic() + way.duration_s
            moving = spent(
                lambda: time.monotonic() > end and arrived(witness, way), way.duration_s + 15.0
            )
            return standing, moving, resident_mb(node.pid)


def first_motion_s() -> tuple[float, float]:
    """From the start of a process of six simulated axes: until it is active, until one moves."""
    _, way = motion(6)
    env = {"ROS_DOMAIN_ID": str(DOMAIN_ID)}
    with Witness(DOMAIN_ID) as witness:
        begun_s = time.monotonic()
        channel = f"can.channel:=first{os.getpid()}"
        with Child("driver", ["--ros-args", "-p", channel], env) as node:
            log: list[str] = []
            while not any("active: " in line for line in log):
                witness.spin(0.005)
                node.check()
                log += node.lines()
            active_s = time.monotonic() - begun_s
            while not witness.positions:
                witness.spin(0.005)
            before = dict(witness.positions)
            here = np.array([before[joint] for joint in way.joint_names])
            there = Trajectory(way.joint_names, np.array([0.0, 1.0]), np.array([here, here + 0.1]))
            witness.publish(there)
            while all(abs(witness.positions[joint] - before[joint]) < MOVED for joint in before):
                witness.spin(0.005)
                node.check()
            return active_s, time.monotonic() - begun_s


def arrived(witness: Witness, way: Trajectory) -> bool:
    """Whether all axes stand at the end, every record executed."""
    here = np.array([witness.positions[joint] for joint in way.joint_names])
    sent = witness.observed().records_sent.values()
    return (
        not witness.moving and min(sent) > 2 and np.allclose(here, way.positions[-1], atol=ARRIVED)
    )


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--rate", type=float, default=50.0, help="state_rate [Hz]")
    parser.add_argument("--axes", type=int, nargs="+", default=AXES, metavar="N")
    parser.add_argument("--start", type=int, metavar="N", help="N times until the first motion")
    chosen = parser.parse_args(argv)
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    if chosen.start:
        active_s, moved_s = np.median([first_motion_s() for _ in range(chosen.start)], axis=0)
        print(f"active after {active_s:.2f} s, first motion after {moved_s:.2f} s (medians)")
        return
    print("| axes | standing, of one core | per axis | moving | per axis | memory |")
    print("|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for count in chosen.axes:
            standing, moving, memory_mb = measure(count, chosen.rate, Path(folder))
            print(
                f"| {count} | {standing:.1%} | {standing / count:.2%} | {moving:.1%} "
                f"| {moving / count:.2%} | {memory_mb:.0f} MB |",
                flush=True,
            )


if __name__ == "__main__":
    main()
