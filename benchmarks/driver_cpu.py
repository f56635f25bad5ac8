"""CPU time of the driver's process per axis: the node with all its topics.

    python -m benchmarks.driver_cpu

The program `driver` in real time, simulated drives as a process of their own behind an slcan
adapter on a pseudo-terminal, which loses no frame however busy the computer is. CPU time is what
the kernel has counted for the driver's process, user and system, while the axes stand and while
they move as in bus_load.
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


def measure(count: int, rate_hz: float, folder: Path) -> tuple[float, float]:
    """Shares of one core while standing, and while moving."""
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
            return standing, moving


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
    chosen = parser.parse_args(argv)
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    print("| axes | standing, of one core | per axis | moving | per axis |\n|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for count in chosen.axes:
            standing, moving = measure(count, chosen.rate, Path(folder))
            print(
                f"| {count} | {standing:.1%} | {standing / count:.2%} | {moving:.1%} "
                f"| {moving / count:.2%} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
