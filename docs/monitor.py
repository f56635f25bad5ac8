"""Draws docs/monitor.svg: what `monitor` shows while simulated drives run an example.

python docs/monitor.py
"""

from __future__ import annotations

import os
import time
from pathlib import Path

from rich.console import Console

from epos2_ros.configuration.files import DRIVER, read_trajectory, share
from epos2_ros.demo.child import Child
from epos2_ros.demo.program import ros_domain
from epos2_ros.demo.witness import Witness
from epos2_ros.monitor import view
from epos2_ros.monitor.program import REDRAW_S, Listener

WIDTH, HEIGHT = 120, 17
MOTION_S = 8.0  # of the example, before the picture is taken


def main() -> None:
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    trajectory = read_trajectory(share() / "examples" / "pick_place.yaml")
    domain = ros_domain()
    arguments = ["--ros-args", "--params-file", str(share() / "config" / "arm.yaml")]
    start = zip(trajectory.joint_names, trajectory.positions[0], strict=True)
    for joint, position in start:  # simulated drives read 0 at first
        arguments += ["-p", f"{DRIVER}:axes.{joint}.offset:={position:.15f}"]
    with (
        Listener(DRIVER, domain_id=domain) as listener,
        Witness(domain) as witness,
        Child("driver", arguments, {"ROS_DOMAIN_ID": str(domain)}) as driver,
    ):
        while not witness.ready:
            driver.check()
            witness.spin(REDRAW_S)
            listener.take()
        witness.publish(trajectory)
        until = time.monotonic() + MOTION_S
        while time.monotonic() < until:
            witness.spin(REDRAW_S)
            listener.take()
        picture = view.draw(listener.seen, time.monotonic(), WIDTH, HEIGHT)
    console = Console(width=WIDTH, record=True, file=open(os.devnull, "w"))  # noqa: SIM115
    console.print(picture, end="")
    console.save_svg(str(Path(__file__).with_suffix(".svg")), title="ros2 run epos2_ros monitor")


if __name__ == "__main__":
    main()
