"""The command `epos2_ros PROGRAM [ARGUMENT …]`: one name for the package's programs."""

from __future__ import annotations

import importlib
import os
import sys

PROGRAMS = {
    "driver": ("epos2_ros.node.driver", "the driver node (ROS arguments: --ros-args …)"),
    "simulator": ("epos2_ros.sim.main", "simulated drives on any python-can bus"),
    "scan": ("epos2_ros.commission.scan", "who is on a bus, and what is odd; changes nothing"),
    "check": ("epos2_ros.commission.check", "the first motion of a joint, step by step"),
    "drive": ("epos2_ros.commission.drive", "a drive's stored parameters: dump, diff, restore"),
    "plan": ("epos2_ros.plan", "a trajectory file as PVT records, errors and bus load; no bus"),
    "replay": ("epos2_ros.replay", "what happened on a bus, from the log of it; no bus"),
    "monitor": ("epos2_ros.monitor", "live table of all axes and the bus, in a terminal"),
    "layout": ("epos2_ros.layout", "a layout of PlotJuggler or Foxglove for a driver's joints"),
    "demo": ("epos2_ros.demo", "driver and simulated drives run a trajectory, with a report"),
}
GET = "rosdep install --from-paths src --ignore-src (see README.md), or pip install ."
USAGE = f"usage: epos2_ros {{{','.join(PROGRAMS)}}} [ARGUMENT …]"
HELP = "\n".join(
    [
        USAGE,
        "",
        *(f"  {name:10} {what}" for name, (_, what) in PROGRAMS.items()),
        "",
        "`epos2_ros PROGRAM --help` tells more.",
    ]
)


def main(argv: list[str] | None = None) -> int:
    """Start the program named first; everything after the name is its own. Returns its status.

    A name that is none of the programs gives one line and 2, a missing ROS one line and 1.
    """
    try:
        status = _run(argv)
        sys.stdout.flush()
    except BrokenPipeError:  # `… | head` has seen enough, which is no error of either
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    return status


def _run(argv: list[str] | None) -> int:
    name, *arguments = (sys.argv[1:] if argv is None else argv) or [""]
    if name in ("-h", "--help"):
        print(HELP)
        return 0
    if name not in PROGRAMS:
        problem = f"epos2_ros: no program {name!r}: one of {', '.join(PROGRAMS)}"
        print(problem if name else USAGE, file=sys.stderr)
        return 2
    try:
        program = importlib.import_module(PROGRAMS[name][0])
    except ModuleNotFoundError as error:
        missing = (error.name or "").partition(".")[0]
        if missing in ("", "epos2_ros"):
            raise
        problem = f"the Python package {missing} is missing: {GET}"
        if missing == "rclpy":
            problem = "needs ROS 2: source its setup.bash, or pip install '.[ros]'"
        print(f"epos2_ros {name}: {problem}", file=sys.stderr)
        return 1
    status: int = program.main(arguments)
    return status


if __name__ == "__main__":
    sys.exit(main())
