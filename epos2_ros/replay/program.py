"""The command `epos2_ros replay`: a log in; the timeline, differences and a drawing out."""

from __future__ import annotations

import argparse
import heapq
import math
import sys
from collections.abc import Iterator, Sequence
from datetime import datetime
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

from epos2_ros.buslog import plain
from epos2_ros.buslog.asc import EventLine, FrameLine
from epos2_ros.configuration.arguments import number, path_ending, without_ros_arguments
from epos2_ros.configuration.driver import DriverConfig
from epos2_ros.configuration.files import read_parameters
from epos2_ros.configuration.parameters import DriverParameters
from epos2_ros.errors import Epos2RosError
from epos2_ros.motion.units import AxisUnits
from epos2_ros.replay.decode import Decoder, Emergency
from epos2_ros.replay.history import History
from epos2_ros.replay.objects import Objects
from epos2_ros.replay.reader import Line, LogReader
from epos2_ros.replay.rerun import Rerun
from epos2_ros.replay.timeline import Timeline, Told

DRAWINGS = (".png", ".svg")
HEAD_LINES = 50  # within so many the configuration has to come
REORDERED_S = 2.0  # what comes about so much later than it happened is still told in its place
TROUBLE = ("fault", "bus_failed", "aborted")


class Heading(NamedTuple):
    """What a log says of itself, and all its lines."""

    config: DriverConfig | None
    complaints: list[str]
    lines: Iterator[Line]


def main(argv: Sequence[str] | None = None) -> int:
    """Returns 0; or 1 after one line on standard error when nothing can be read or drawn."""
    arguments = _arguments(sys.argv[1:] if argv is None else argv)
    try:
        run(arguments)
    except Epos2RosError as error:
        problem = str(error)
    except BrokenPipeError:  # whoever reads has seen enough
        sys.stderr.close()
        return 0
    except OSError as error:
        problem = f"{error.filename}: {error.strerror}"
    except KeyboardInterrupt:
        return 130
    else:
        return 0
    print(f"epos2_ros replay: {problem}", file=sys.stderr)
    return 1


def run(arguments: argparse.Namespace) -> None:
    """Read the log once, and tell as it goes."""
    reader = LogReader(arguments.log)
    heading = _heading(reader)
    if arguments.params is not None:
        given = DriverParameters(read_parameters(arguments.params)).config()
        heading = heading._replace(config=given)
    config = heading.config
    objects = Objects(config)
    decoder, timeline, history = (
        Decoder(objects, config),
        Timeline(objects, config, arguments.brief),
        History(config),
    )
    rerun = _rerun(reader, config)
    shown = _Shown(arguments, config, timeline)
    print(_title(arguments.log, reader, config, rerun), flush=True)
    t_s, troubles_s = 0.0, []
    for line in heading.lines:
        t_s = max(t_s, line.t_s)
        if isinstance(line, FrameLine):
            meanings = decoder.take(line)
            shown.tell(timeline.frame(line, meanings))
            shown.tell(history.frame(line.t_s, meanings))
            troubles_s += [line.t_s for m in meanings if isinstance(m, Emergency) and m.code]
            if rerun:
                shown.tell(rerun.frame(line))
        else:
            shown.tell(timeline.event(line))
            troubles_s += [line.t_s] if line.name in TROUBLE else []
            if rerun:
                shown.tell(rerun.event(line))
    last = FrameLine(t_s, 0, b"", False)
    shown.tell(timeline.frame(last, decoder.unanswered()))
    shown.tell(history.end(t_s))
    shown.tell(timeline.end(t_s))
    shown.flush()
    print(f"{t_s:.6f} s: end of the log")
    if rerun:
        print(rerun.summary())
    for complaint in [*heading.complaints, *reader.complaints]:
        print(f"note: {complaint}")
    if arguments.output is not None:
        _draw(arguments, config, timeline, history, shown, t_s, troubles_s)


class _Shown:
    """Prints what was asked for: a span of time, some axes."""

    def __init__(
        self, arguments: argparse.Namespace, config: DriverConfig | None, timeline: Timeline
    ) -> None:
        self.from_s, self.to_s = arguments.begin, arguments.end
        self.nodes = {_node(name, config) for name in arguments.axis} if arguments.axis else None
        self._name = timeline.name
        named = [len(timeline.name(axis.node_id)) for axis in config.axes] if config else []
        self._width = max(named, default=8)

        self._waiting: list[tuple[float, int, Told]] = []
        self._count = 0
        self._t_s = 0.0

    def tell(self, lines: Iterator[Told]) -> None:
        """Lines come about in the order in which the driver took notice; they are told in that of
        their times."""
        for told in lines:
            if not self.from_s <= told.t_s <= self.to_s:
                continue
            if self.nodes is not None and told.node is not None and told.node not in self.nodes:
                continue
            self._count += 1
            self._t_s = max(self._t_s, told.t_s)
            heapq.heappush(self._waiting, (told.t_s, self._count, told))
        while self._waiting and self._waiting[0][0] < self._t_s - REORDERED_S:
            self._print(heapq.heappop(self._waiting)[-1])

    def flush(self) -> None:
        """Tell what is left."""
        while self._waiting:
            self._print(heapq.heappop(self._waiting)[-1])

    def _print(self, told: Told) -> None:
        who = "" if told.node is None else self._name(told.node)
        print(f"{told.t_s:12.6f}  {who:{self._width}}  {told.text}")


def _node(name: str, config: DriverConfig | None) -> int:
    """The node id of a joint, or a number as it is."""
    joints = {axis.joint: axis.node_id for axis in config.axes} if config else {}
    if name in joints:
        return joints[name]
    if name.isdecimal():
        return int(name)
    known = f"the log's joints are {', '.join(joints)}" if joints else "the log names no joints"
    raise Epos2RosError(f"--axis {name}: no such joint, and no node id; {known}")


def _heading(reader: LogReader) -> Heading:
    """Reads on to the configuration, which is near the beginning or nowhere."""
    lines = iter(reader)
    head: list[Line] = []
    config: DriverConfig | None = None
    complaints: list[str] = []
    for line in lines:
        head.append(line)
        if isinstance(line, EventLine) and line.name == "configuration":
            config, complaints = _configuration(line.data)
            break
        if len(head) >= HEAD_LINES:
            break
    return Heading(config, complaints, chain(head, lines))


def _configuration(data: Any) -> tuple[DriverConfig | None, list[str]]:
    unknown: list[str] = []
    try:
        config = plain.from_plain(DriverConfig, data, unknown)
        Rerun(config, 0.0)  # no driver comes up with what these can't be made of
        Decoder(Objects(config), config)
    except (TypeError, ValueError, ArithmeticError, LookupError, Epos2RosError) as error:
        why = " ".join(f"{type(error).__name__} {error}".split())
        return None, [f"the configuration in the log is none that this version can have: {why}"]
    names = ", ".join(sorted(set(unknown)))
    return config, [f"the log's configuration has more than this version: {names}"] if names else []


def _rerun(reader: LogReader, config: DriverConfig | None) -> Rerun | None:
    if config is None or reader.host_us is None:
        return None
    return Rerun(config, reader.host_us, reader.from_the_start)


def _title(log: Path, reader: LogReader, config: DriverConfig | None, rerun: Rerun | None) -> str:
    began = ""
    if reader.wall_s is not None:
        local = datetime.fromtimestamp(reader.wall_s).astimezone()
        began = f", 0 s is {local:%Y-%m-%d %H:%M:%S.%f %z}"
    joints = ", ".join(f"{a.joint} (node {a.node_id})" for a in config.axes) if config else ""
    whose = f"the driver's, {joints}" if joints else "frames alone, without the driver's events"
    run_again = (
        "lines with ≠: what this version of the driver would do otherwise"
        if rerun
        else "the protocol is not run over it: that takes the driver's log"
    )
    return f"{log.name}: {whose}{began}\n{run_again}\n"


def _draw(
    arguments: argparse.Namespace,
    config: DriverConfig | None,
    timeline: Timeline,
    history: History,
    shown: _Shown,
    end_s: float,
    troubles_s: Sequence[float],
) -> None:
    axes = [axis for axis in history.axes.values() if axis.demand or axis.actual or axis.motions]
    if shown.nodes is not None:
        axes = [axis for axis in axes if axis.node in shown.nodes]
    if not axes:
        raise Epos2RosError(f"{arguments.log.name} holds nothing of these axes to be drawn")
    units = {}
    for axis in config.axes if config else ():
        made = AxisUnits.of(axis)
        units[axis.node_id] = made.unit, made.from_qc
    from epos2_ros.replay import plot  # loads matplotlib

    span_s = max(0.0, shown.from_s), min(end_s, shown.to_s)
    title = arguments.log.name
    plot.save(axes, timeline.name, units, span_s, troubles_s, title, arguments.output)


def _arguments(argv: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="epos2_ros replay",
        description="What happened on a bus, from its log: the timeline in words, where this "
        "version of the driver would do otherwise, and a drawing. Needs neither a bus nor ROS.",
    )
    parser.add_argument(
        "log",
        type=Path,
        metavar="LOG",
        help="a log of the driver (log.file) or of the simulator (--bus-log), or of others, such "
        "as of candump -L, as far as python-can reads them",
    )
    seconds = number(words="a number of seconds")
    parser.add_argument(
        "--from", dest="begin", type=seconds, default=-math.inf, metavar="S", help="[s] in the log"
    )
    parser.add_argument("--to", dest="end", type=seconds, default=math.inf, metavar="S")
    parser.add_argument(
        "--axis", nargs="+", default=[], metavar="JOINT", help="joints or node ids (default: all)"
    )
    parser.add_argument(
        "--brief", action="store_true", help="leave out SDO transfers that went well"
    )
    parser.add_argument(
        "--params",
        type=Path,
        metavar="FILE",
        help="parameters of the driver, where the log does not hold them",
    )
    parser.add_argument(
        "--output",
        type=path_ending(*DRAWINGS),
        metavar="FILE",
        help="draw executed against commanded positions, buffer levels and clock offsets; "
        f"{', '.join(DRAWINGS)}",
    )
    return parser.parse_args(without_ros_arguments(argv))
