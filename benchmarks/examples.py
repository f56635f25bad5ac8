"""Every example on simulated drives in real time, as a user runs it: path errors and starts.

    python -m benchmarks.examples                       # those of examples/
    python -m benchmarks.examples FOLDER_OR_FILE …      # other trajectories

Each on both object dictionaries of the EPOS2, with driver and drives in one process and in two (an
slcan adapter on a pseudo-terminal between them). What was executed is the drives' own log, cycle by
cycle; what was commanded is worked out from the file without the driver's code
(`epos2_ros.demo.commanded`). About three minutes for four examples.
"""

from __future__ import annotations

import argparse
import io
import os
import tempfile
from collections.abc import Iterator, Sequence
from itertools import product
from pathlib import Path

import yaml

from epos2_ros.configuration.files import read_parameters, read_trajectory
from epos2_ros.demo.commanded import HOLD_S, Commanded
from epos2_ros.demo.program import Machine, parameter_file
from epos2_ros.demo.report import Report
from epos2_ros.demo.terminal import Terminal
from epos2_ros.errors import Epos2RosError

QUIET = Terminal(io.StringIO())
EXAMPLES = Path(__file__).parents[1] / "examples"
HEAD = (
    "| example | axes | dictionary | processes | records | path error [qc] | final error [qc] "
    "| starts apart [us] | fewest records | bus load | faults |"
)


def run(file: Path, dictionary: str, two_processes: bool, scratch: Path) -> Report:
    """One example. Epos2RosError when the motion did not come about, or ended in a fault."""
    trajectory = read_trajectory(file)
    given = read_parameters(parameter_file(trajectory.joint_names, scratch))
    params = scratch / "params.yaml"
    parameters = {**given, "simulation.dictionary": dictionary}
    params.write_text(yaml.safe_dump({"/**": {"ros__parameters": parameters}}))
    start = dict(zip(trajectory.joint_names, trajectory.positions[0], strict=True))
    machine = Machine(params, start, scratch)
    observed = machine.run(trajectory, (), two_processes, QUIET)
    return Report.of(
        Commanded(trajectory, HOLD_S, machine.scales),
        trajectory.joint_names,
        machine.scales,
        machine.log,
        observed,
        bitrate=machine.parameters.get("can.bitrate", 1_000_000),
        tolerance_qc=machine.parameters.get("ipm.tolerance", 1.0),
    )


def row(file: Path, dictionary: str, two_processes: bool) -> tuple[str, list[str]]:
    """A line of the table, and what was not as it has to be."""
    first = f"| {file.stem} | "
    place = f"{dictionary} | {'two' if two_processes else 'one'}"
    with tempfile.TemporaryDirectory() as folder:
        try:
            report = run(file, dictionary, two_processes, Path(folder))
        except Epos2RosError as error:
            return f"{first}| {place} | | | | | | | {error} |", [f"{file.stem}: {error}"]
    axes, observed = report.axes, report.observed
    path_qc = max(axis.path_error_qc for axis in axes)
    final_qc = max(abs(axis.final_error_qc) for axis in axes)
    fewest = min(axis.levels[0] for axis in axes)
    records = sum(axis.records_sent for axis in axes)
    return (
        f"{first}{len(axes)} | {place} | {records} | {path_qc:.2f} | {final_qc:.2f} "
        f"| {report.spread_us:.2f} | {fewest} | {observed.bus_load:.1f}% "
        f"| {len(observed.buffer_errors)} |",
        report.failures(),
    )


def files(given: Sequence[Path]) -> Iterator[Path]:
    """Trajectories: those given, and all in folders given."""
    for path in given:
        if path.is_dir():
            yield from sorted(path.glob("*.yaml"))
        else:
            yield path


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("trajectories", nargs="*", type=Path, default=[EXAMPLES])
    parser.add_argument("--dictionary", choices=("maker", "note"), action="append")
    parser.add_argument("--processes", type=int, choices=(1, 2), action="append")
    chosen = parser.parse_args(argv)
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    dictionaries = chosen.dictionary or ("maker", "note")
    print(HEAD)
    print("|" + "---|" * HEAD.count(" | ") + "---|")
    failures: list[str] = []
    for file, dictionary, processes in product(
        files(chosen.trajectories), dictionaries, chosen.processes or (1, 2)
    ):
        line, failed = row(file, dictionary, processes == 2)
        print(line, flush=True)
        failures += [f"{dictionary}, processes: {processes}: {text}" for text in failed]
    if failures:
        raise SystemExit("\n".join(failures))


if __name__ == "__main__":
    main()
