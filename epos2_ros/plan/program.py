"""The command `epos2_ros plan`: a trajectory in; table, drawing and records out."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path

from epos2_ros import surroundings
from epos2_ros.configuration.arguments import number, path_ending, without_ros_arguments
from epos2_ros.configuration.driver import DriverConfig
from epos2_ros.configuration.files import read_parameters, read_trajectories, shipped_parameters
from epos2_ros.configuration.parameters import AXIS, DriverParameters
from epos2_ros.errors import Epos2RosError, TrajectoryError
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.plan import report
from epos2_ros.plan.move import make_move_plan
from epos2_ros.plan.outputs import OutputPlans, write_csv
from epos2_ros.plan.planning import make_plan
from epos2_ros.protocol.families import PROFILE, follows_by

DRAWINGS = (".png", ".svg", ".html")


def main(argv: Sequence[str] | None = None) -> int:
    """Returns 0; or 1 after one line on standard error: refused, or can't be read or written."""
    arguments = _arguments(sys.argv[1:] if argv is None else argv)
    try:
        run(arguments)
    except TrajectoryError as error:
        problem = f"trajectory refused: {error}"
    except Epos2RosError as error:
        problem = str(error)
    except BrokenPipeError:
        raise  # whoever reads the table has seen enough
    except OSError as error:
        problem = f"{error.filename}: {error.strerror}"
    except KeyboardInterrupt:
        return 130
    else:
        return 0
    print(f"epos2_ros plan: {problem}", file=sys.stderr)
    return 1


def run(arguments: argparse.Namespace) -> None:
    """Plan each trajectory as it comes."""
    file: Path = arguments.trajectory
    piped = str(file) == "-"
    name = "standard input" if piped else file.name
    with nullcontext(sys.stdin) if piped else file.open(encoding="utf-8") as lines:
        for number, trajectory in enumerate(read_trajectories(lines, name)):
            if not len(trajectory.times_s):
                raise Epos2RosError(
                    f"{name} has no points: the driver would stop on the path, nothing to plan"
                )
            if number and (arguments.output or arguments.csv or arguments.events):
                raise Epos2RosError(
                    f"{name} goes on: --output, --csv and --events take one trajectory"
                )
            if number:
                print()
            _plan(trajectory, name, arguments)


def _plan(trajectory: Trajectory, name: str, arguments: argparse.Namespace) -> None:
    config, source = _parameters(trajectory, arguments.params, arguments.node)
    if _moves(trajectory, config):
        _plan_move(trajectory, name, source, config, arguments)
        return
    plan = make_plan(trajectory, config, _start(trajectory, arguments), _say_what_is_compiled)
    where = "point 0 is" if arguments.start is None else "--start says"
    if first_s := float(trajectory.times_s[0]):
        where += (
            f", there until {first_s:.3f} s (joined from elsewhere with --start)"
            if arguments.start is None
            else f", joined smoothly to point 0 at {first_s:.3f} s"
        )
    stamp = "" if trajectory.stamp_s is None else "; header.stamp does not count here"
    heading = (
        f"{len(trajectory.times_s)} points, {trajectory.duration_s:.3f} s, "
        f"joints {', '.join(trajectory.joint_names)}\n"
        f"parameters: {source}; tolerance {config.tolerance:g} qc, "
        f"buffer time {config.buffer_time:g} s\n"
        f"start: at once, from rest where {where}{stamp}"
    )
    print(f"{name}: {heading}\n\n{report.text(plan)}", flush=True)
    _write_events(plan.outputs, arguments.events)
    if arguments.csv is not None:
        with arguments.csv.open("w", encoding="utf-8", newline="") as file:
            report.write_csv(plan, file)
    if arguments.output is not None:
        from epos2_ros.plan import plot  # loads matplotlib

        if arguments.output.suffix == ".html":
            page = report.page(plan, name, heading, plot.svg(plan))
            arguments.output.write_text(page, encoding="utf-8")
        else:
            plot.save(plan, name, arguments.output)


def _say_what_is_compiled() -> None:
    if line := surroundings.compiling()[1]:
        print(f"epos2_ros plan: {line}", file=sys.stderr)


def _moves(trajectory: Trajectory, config: DriverConfig) -> bool:
    """Whether it is a message for `~/move_to`."""
    beside = {axis.joint for axis in config.axes if follows_by(axis) == PROFILE}
    return len(trajectory.times_s) == 1 and set(trajectory.joint_names) <= beside


def _plan_move(
    trajectory: Trajectory,
    name: str,
    source: str,
    config: DriverConfig,
    arguments: argparse.Namespace,
) -> None:
    if arguments.start is None:
        raise Epos2RosError(f"{name} is a move: --start has to say where the joints stand")
    if arguments.csv is not None or arguments.output is not None:
        raise Epos2RosError(f"{name} is a move: it has no records to write or draw")
    plan = make_move_plan(trajectory, config, _start(trajectory, arguments))
    print(
        f"{name}: a move (~/move_to), joints {', '.join(trajectory.joint_names)}\n"
        f"parameters: {source}\n\n{report.move_text(plan)}",
        flush=True,
    )
    _write_events(plan.outputs, arguments.events)


def _start(trajectory: Trajectory, arguments: argparse.Namespace) -> list[float]:
    start = trajectory.positions[0].tolist() if arguments.start is None else arguments.start
    if len(start) != len(trajectory.joint_names):
        raise Epos2RosError(
            f"--start has {len(start)} positions for {len(trajectory.joint_names)} joints"
        )
    return list(start)


def _write_events(plans: OutputPlans, path: Path | None) -> None:
    if path is not None:
        with path.open("w", encoding="utf-8", newline="") as file:
            write_csv(plans.outputs, file)


def _parameters(
    trajectory: Trajectory, file: Path | None, node: str | None
) -> tuple[DriverConfig, str]:
    """The driver's configuration, and in words where it is from."""
    if file is not None:
        return DriverParameters(read_parameters(file, node)).config(), str(file)
    if shipped := shipped_parameters(trajectory.joint_names):
        source = f"{shipped}, which is for these joints"
        return DriverParameters(read_parameters(shipped)).config(), source
    counts, gear = AXIS["counts_per_turn"].default, AXIS["gear_ratio"].default
    source = f"the driver's defaults, {counts} counts per turn and gear ratio {gear:g} (--params)"
    return DriverParameters({"joints": list(trajectory.joint_names)}).config(), source


def _arguments(argv: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="epos2_ros plan",
        description="What the driver would make of a trajectory: the records or set-points of each "
        "axis, their error and extremes, what position-triggered outputs fire, the load of the "
        "bus. One point for joints that follow no trajectory is a move (~/move_to). Needs neither "
        "a bus nor ROS.",
    )
    parser.add_argument(
        "trajectory",
        type=Path,
        metavar="FILE",
        help="a JointTrajectory as YAML, as for `ros2 topic pub`; - reads standard input, several "
        "trajectories, too: ros2 topic echo --full-length TOPIC | epos2_ros plan -",
    )
    parser.add_argument(
        "--params",
        type=Path,
        metavar="FILE",
        help="parameters of the driver (default: those shipped for the trajectory's joints, or "
        "the driver's own)",
    )
    parser.add_argument(
        "--node",
        metavar="NAME",
        help="full name of the node whose parameters these are, if the file has several drivers'",
    )
    parser.add_argument(
        "--start",
        type=number(),
        nargs="+",
        metavar="POSITION",
        help="where the trajectory's joints stand [rad or m] (default: where its first point is)",
    )
    parser.add_argument(
        "--output",
        type=path_ending(*DRAWINGS),
        metavar="FILE",
        help=f"draw the curves, errors and knots; {', '.join(DRAWINGS)}",
    )
    parser.add_argument("--csv", type=Path, metavar="FILE", help="write the records and set-points")
    parser.add_argument(
        "--events",
        type=Path,
        metavar="FILE",
        help="write every crossing of the position-triggered outputs, as CSV",
    )
    return parser.parse_args(without_ros_arguments(argv))
