"""The command `epos2_ros demo`: from a trajectory file to a verdict."""

from __future__ import annotations

import argparse
import os
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

import yaml

from epos2_ros.configuration.arguments import path_ending
from epos2_ros.configuration.files import (
    DRIVER,
    read_parameters,
    read_trajectory,
    share,
    shipped_parameters,
)
from epos2_ros.configuration.parameters import DriverParameters
from epos2_ros.demo.child import Child
from epos2_ros.demo.commanded import HOLD_S, Commanded, scales
from epos2_ros.demo.outputs import OutputResult, outputs_of
from epos2_ros.demo.report import Observed, Report
from epos2_ros.demo.terminal import Terminal, bar
from epos2_ros.demo.witness import Witness
from epos2_ros.errors import Epos2RosError
from epos2_ros.motion.trajectory import Trajectory

READY_TIMEOUT_S = 60.0  # for the driver to be active: imports, bring-up, clocks
MOVE_TIMEOUT_S = 15.0  # for the start, and beyond the trajectory's duration
REFRESH_S = 0.1


def main(argv: Sequence[str] | None = None) -> int:
    """Returns 0 if everything stayed within its limits, else 1."""
    parser = argparse.ArgumentParser(
        prog="epos2_ros demo",
        description="Starts the driver with simulated drives, publishes a trajectory, and compares "
        "what the drives did with what was commanded.",
    )
    parser.add_argument(
        "trajectory",
        nargs="?",
        type=Path,
        metavar="TRAJECTORY",
        help="a JointTrajectory as YAML (default: the example pick_place)",
    )
    parser.add_argument(
        "--params",
        type=Path,
        metavar="FILE",
        help="parameters of the driver (default: those shipped for the trajectory's joints, "
        "or revolute joints of 2000 counts and gear 100)",
    )
    parser.add_argument(
        "--output",
        type=path_ending(".png"),
        metavar="PNG",
        help="the plot (default: demo_<trajectory>.png)",
    )
    parser.add_argument(
        "--two-processes",
        action="store_true",
        help="drives in a process of their own, behind an slcan adapter on a pseudo-terminal",
    )
    arguments = parser.parse_args(argv)

    def interrupt(*_: Any) -> None:
        raise KeyboardInterrupt

    signal.signal(signal.SIGTERM, interrupt)
    signal.signal(signal.SIGHUP, interrupt)
    try:
        return run(arguments, Terminal())
    except Epos2RosError as error:
        print(f"epos2_ros demo: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("epos2_ros demo: interrupted", file=sys.stderr)
        return 130


def run(arguments: argparse.Namespace, terminal: Terminal) -> int:
    """The whole demo. Epos2RosError when the motion did not come about."""
    file = arguments.trajectory or share() / "examples" / "pick_place.yaml"
    trajectory = read_trajectory(file)
    if len(trajectory.times_s) == 1:
        raise Epos2RosError(f"{file} has one point, and the demo begins there: nothing would move")
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    with tempfile.TemporaryDirectory(prefix="epos2_ros_demo_") as folder:
        scratch = Path(folder)
        params = arguments.params or parameter_file(trajectory.joint_names, scratch)
        start = dict(zip(trajectory.joint_names, trajectory.positions[0], strict=True))
        machine = Machine(params, start, scratch)
        terminal.line(
            f"{file.name}: {len(trajectory.times_s)} points, {trajectory.duration_s:.1f} s, "
            f"joints {', '.join(trajectory.joint_names)}"
        )
        terminal.line(f"drives as in {params.name}, ROS_DOMAIN_ID={machine.domain_id}")
        outputs = outputs_of(machine.parameters, trajectory.joint_names)
        observed = machine.run(trajectory, outputs, arguments.two_processes, terminal)
        commanded = Commanded(trajectory, HOLD_S, machine.scales)
        report = Report.of(
            commanded,
            trajectory.joint_names,
            machine.scales,
            machine.log,
            observed,
            bitrate=machine.parameters.get("can.bitrate", 1_000_000),
            tolerance_qc=machine.parameters.get("ipm.tolerance", 1.0),
        )
        by_joint = {axis.scale.joint: axis for axis in report.axes}
        report = replace(
            report,
            outputs=tuple(
                OutputResult.of(
                    name,
                    machine.parameters,
                    commanded,
                    trajectory.joint_names,
                    by_joint[machine.parameters[f"compare.{name}.joint"]],
                    observed.events[name],
                )
                for name in outputs
            ),
        )
    output = arguments.output or Path(f"demo_{file.stem}.png")
    report.print(terminal)
    try:
        report.plot(output, f"{file.stem}: commanded and executed")
    except OSError as error:
        raise Epos2RosError(f"can't write {output}: {error.strerror}") from error
    terminal.line(f"plot: {output}")
    failures = report.failures()
    for failure in failures:
        terminal.line(terminal.judged(failure, False))
    if not failures:
        terminal.line(terminal.judged("everything within its limits", True))
    return 1 if failures else 0


class Machine:
    """The driver and simulated drives, as a parameter file describes them.

    The robot stands at `start` by joint [unit]: simulated drives read 0 at first.
    """

    def __init__(self, params: Path, start: Mapping[str, float], scratch: Path) -> None:
        given = read_parameters(params, f"/{DRIVER}")
        DriverParameters(given).config()  # what the driver would refuse is refused in its words
        self._offsets = {f"axes.{joint}.offset": float(start[joint]) for joint in start}
        self.parameters = {**given, **self._offsets}
        self.scales = scales(self.parameters)
        self.domain_id = ros_domain()
        self.log = scratch / "executed.npz"
        self._params = params
        self._env = {
            "ROS_DOMAIN_ID": str(self.domain_id),
            "ROS_LOG_DIR": str(scratch),
            "RCUTILS_CONSOLE_OUTPUT_FORMAT": "{severity}: {message}",
            "RCUTILS_COLORIZED_OUTPUT": "0",
        }

    def run(
        self,
        trajectory: Trajectory,
        outputs: Sequence[str],
        two_processes: bool,
        terminal: Terminal,
    ) -> Observed:
        """Starts everything, runs the trajectory, and ends everything, so that the log is there."""
        with ExitStack() as children:
            if two_processes:
                simulator = children.enter_context(self._simulator())
                driver = children.enter_context(self._driver(self._slcan(simulator, terminal)))
            else:
                driver = children.enter_context(self._driver({"simulation.log": str(self.log)}))
            witness = children.enter_context(Witness(self.domain_id, outputs))
            units = {scale.joint: scale.unit for scale in self.scales}
            watch = Watch(driver, witness, units, terminal)
            watch.wait(lambda: witness.ready, READY_TIMEOUT_S, "the driver is not active")
            witness.publish(trajectory)
            watch.follow(trajectory.duration_s)
            status = driver.stop()
            watch.tell()
            if status:
                raise Epos2RosError(f"the driver ended with status {status}")
            return witness.observed()

    def _driver(self, settings: Mapping[str, str]) -> Child:
        arguments = ["--ros-args", "--params-file", str(self._params)]
        offsets = {name: f"{value:.15f}" for name, value in self._offsets.items()}
        for name, value in {**offsets, **settings, "status_rate": "20.0"}.items():
            arguments += ["-p", f"{DRIVER}:{name}:={value}"]
        return Child("driver", arguments, self._env)

    def _simulator(self) -> Child:
        epos2 = [scale for scale in self.scales if scale.drive == "epos2"]
        copley = [scale for scale in self.scales if scale.drive == "copley"]
        cl3e = [scale for scale in self.scales if scale.drive == "cl3e"]
        counts = {
            self.parameters.get(f"axes.{s.joint}.counts_per_turn", 2000) for s in (*epos2, *cl3e)
        }
        if len(counts) > 1:
            raise Epos2RosError("--two-processes needs the same counts_per_turn on every axis")
        arguments = {
            "--nodes": ",".join(str(scale.node_id) for scale in epos2),
            "--bitrate": str(self.parameters.get("can.bitrate", 1_000_000)),
            "--counts-per-turn": str(counts.pop()),
            "--drift-ppm": str(self.parameters.get("simulation.drift_ppm", 0.0)),
            "--seed": str(self.parameters.get("simulation.seed", 0)),
            "--dictionary": str(self.parameters.get("simulation.dictionary", "maker")),
            "--log": str(self.log),
        }
        if copley:
            arguments["--copley"] = ",".join(str(scale.node_id) for scale in copley)
        if cl3e:
            arguments["--cl3e"] = ",".join(str(scale.node_id) for scale in cl3e)
        return Child("simulator", ["--slcan", *chain(*arguments.items())], self._env)

    def _slcan(self, simulator: Child, terminal: Terminal) -> dict[str, str]:
        """Where the driver finds the simulator's bus, which is what it says first."""
        line = simulator.first_line(READY_TIMEOUT_S)
        terminal.line(terminal.faint(f"simulator │ {line}"))
        path = line.rpartition(" ")[2]
        if not path.startswith("/dev/"):
            raise Epos2RosError(f"the simulator did not start: {line}")
        return {"simulate": "false", "can.interface": "slcan", "can.channel": path}


class Watch:
    """Follows the driver: its log and its topics, on the terminal."""

    def __init__(
        self, driver: Child, witness: Witness, units: Mapping[str, str], terminal: Terminal
    ) -> None:
        self._driver = driver
        self._units = units  # by joint
        self._witness = witness
        self._terminal = terminal

    def tell(self) -> None:
        """Shows what the driver has logged; Epos2RosError for an error among it."""
        for line in self._driver.lines():
            self._terminal.line(self._terminal.faint(f"driver │ {line.partition(': ')[2] or line}"))
            if line.startswith(("ERROR: ", "FATAL: ")):
                raise Epos2RosError("the driver reported an error, see above")

    def wait(self, what: Callable[[], bool], timeout_s: float, otherwise: str) -> None:
        """Until `what` is true; Epos2RosError `otherwise`, or when the driver fails."""
        until = time.monotonic() + timeout_s
        while not what():
            self._witness.spin(REFRESH_S)
            self.tell()
            self._driver.check()
            if time.monotonic() > until:
                raise Epos2RosError(f"{otherwise} after {timeout_s:.0f} s")

    def follow(self, duration_s: float) -> None:
        """From the publication to the first messages after the motion."""
        witness = self._witness
        self.wait(lambda: witness.moving, MOVE_TIMEOUT_S, "the axes do not move")
        start = shown = time.monotonic()

        def over() -> bool:
            nonlocal shown
            now = time.monotonic()
            elapsed_s = min(now - start, duration_s)
            if self._terminal.interactive:
                self._terminal.block(self._progress(elapsed_s, duration_s))
            elif now - shown >= 1.0:
                shown += 1.0
                self._terminal.line(self._summary(elapsed_s, duration_s))
            return not witness.moving

        self.wait(over, duration_s + MOVE_TIMEOUT_S, "the axes still move")
        before = dict(witness.messages)
        self.wait(
            lambda: all(witness.messages[topic] > before[topic] + 1 for topic in before),
            MOVE_TIMEOUT_S,
            "no topics",
        )

    def _progress(self, elapsed_s: float, duration_s: float) -> list[str]:
        buffers = self._witness.buffers
        width = max(map(len, buffers))
        lines = [f"{elapsed_s:5.1f} s of {duration_s:.1f} s  {bar(elapsed_s / duration_s, 40)}"]
        for joint, values in buffers.items():
            used, size = int(values["used"]), int(values["size"])
            lines.append(
                f"  {joint:{width}} {self._witness.positions[joint]:+9.4f} {self._units[joint]:3}  "
                f"{bar(used / size, 16)} {used:2} records, {values['buffered_ms']:>4} ms ahead"
            )
        return lines

    def _summary(self, elapsed_s: float, duration_s: float) -> str:
        used = [int(values["used"]) for values in self._witness.buffers.values()]
        ahead = [int(values["buffered_ms"]) for values in self._witness.buffers.values()]
        return (
            f"{elapsed_s:4.0f} s of {duration_s:.1f} s: {min(used)} … {max(used)} records, "
            f"{min(ahead)} … {max(ahead)} ms ahead"
        )


def parameter_file(joints: Sequence[str], scratch: Path) -> Path:
    """The shipped parameter file for simulated drives with these joints, else one made up."""
    if shipped := shipped_parameters(joints):
        return shipped
    axes = {joint: {"counts_per_turn": 2000, "gear_ratio": 100.0} for joint in joints}
    section = {
        "simulate": True,
        "joints": list(joints),
        "axes": axes,
        "ipm": {"buffer_time": 1.0},
    }
    file = scratch / "revolute.yaml"
    file.write_text(yaml.safe_dump({"/**": {"ros__parameters": section}}))
    return file


def ros_domain() -> int:
    """A ROS domain that is not the user's: no robot of theirs may hear this trajectory."""
    domain = 1 + os.getpid() % 100
    return domain + 1 if str(domain) == os.environ.get("ROS_DOMAIN_ID") else domain
