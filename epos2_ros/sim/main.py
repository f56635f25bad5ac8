"""The program `simulator`: simulated drives on any python-can bus, until told to stop."""

from __future__ import annotations

import argparse
import os
import signal
import sys
import threading
from pathlib import Path
from typing import NoReturn

import can

from epos2_ros.buslog.writer import LogWriter
from epos2_ros.configuration.arguments import number, without_ros_arguments
from epos2_ros.errors import ConfigurationError, Epos2RosError
from epos2_ros.receive_buffer import deepen

from .epos2 import Dictionary
from .realtime import (
    RealtimeSimulator,
    build_cl3e_drives,
    build_copley_drives,
    build_drives,
    now_us,
    save_log,
    wall_offset_us,
)
from .slcan import SlcanAdapter

BITRATES = (10_000, 20_000, 50_000, 125_000, 250_000, 500_000, 800_000, 1_000_000)  # CiA 301


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        raise ConfigurationError(message)


def node_list(text: str) -> list[int]:
    """Node ids from "1-6" or "1,2,7"; raises `ArgumentTypeError` with what is allowed."""
    nodes: list[int] = []
    for part in text.split(","):
        first, dash, last = part.strip().partition("-")
        if not first.isdecimal() or (dash and not last.isdecimal()):
            raise argparse.ArgumentTypeError(f"{text!r}: node ids like 1-6 or 1,2,7")
        nodes += range(int(first), int(last or first) + 1)
    if not nodes or min(nodes) < 1 or max(nodes) > 127:
        raise argparse.ArgumentTypeError(f"{text!r}: node ids are 1 … 127")
    if len(set(nodes)) < len(nodes):
        raise argparse.ArgumentTypeError(f"{text!r}: a node id appears twice")
    return nodes


def _positive(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r}: must be a positive whole number")
    return int(text)


def _arguments(argv: list[str]) -> argparse.Namespace:
    parser = _Parser(prog="epos2_ros simulator", description=__doc__)
    parser.add_argument("--interface", default="socketcan", help="python-can interface")
    parser.add_argument("--channel", help="its channel, e.g. vcan0")
    parser.add_argument(
        "--slcan", action="store_true", help="be an slcan adapter on a pseudo-terminal instead"
    )
    parser.add_argument(
        "--nodes",
        type=node_list,
        default=node_list("1-6"),
        help="node ids of EPOS2 drives, e.g. 1-6 or 1,2,7",
    )
    parser.add_argument(
        "--copley", type=node_list, default=[], metavar="NODES", help="node ids of Copley drives"
    )
    parser.add_argument(
        "--cl3e", type=node_list, default=[], metavar="NODES", help="node ids of Nanotec CL3-E"
    )
    parser.add_argument("--bitrate", type=int, choices=BITRATES, default=1_000_000)
    parser.add_argument(
        "--counts-per-turn", type=_positive, default=2000, help="of the encoders [qc]"
    )
    parser.add_argument(
        "--drift-ppm",
        type=number(0, 1e6, "a number from 0 on"),
        default=0.0,
        help="clocks drift by up to ± this",
    )
    parser.add_argument(
        "--dictionary",
        type=Dictionary,
        choices=list(Dictionary),
        default=Dictionary.MAKER,
        metavar="{maker,note}",
        help="object dictionary of the EPOS2 drives: the maker's or the application note's",
    )
    parser.add_argument("--seed", type=int, default=0, help="of everything random")
    parser.add_argument(
        "--log", type=Path, metavar="FILE.npz", help="write what was executed here at the end"
    )
    parser.add_argument(
        "--bus-log",
        type=Path,
        metavar="FILE.asc",
        help="log every frame, as the driver's log.file; `replay` and python-can read it",
    )
    parser.add_argument(
        "--bus-log-size",
        type=_positive,
        default=100,
        metavar="MB",
        help="of the log's files together; the oldest are deleted",
    )
    parser.add_argument(
        "--hand",
        action="store_true",
        help="lines of standard input like `3 500` turn the shaft of node 3 by 500 counts, as a "
        "hand would while the motor is without power",
    )
    arguments = parser.parse_args(without_ros_arguments(argv))
    if not arguments.slcan and arguments.channel is None:
        parser.error("--channel is needed (or --slcan)")
    if twice := set(arguments.nodes) & set(arguments.copley):
        parser.error(f"--copley {min(twice)}: an EPOS2 drive has this node id (--nodes)")
    if twice := {*arguments.nodes, *arguments.copley} & set(arguments.cl3e):
        parser.error(f"--cl3e {min(twice)}: another drive has this node id (--nodes, --copley)")
    if arguments.log is not None and arguments.log.suffix != ".npz":
        parser.error(f"--log {arguments.log}: must end in .npz")
    if arguments.log is not None and not os.access(arguments.log.parent, os.W_OK):
        parser.error(f"--log {arguments.log}: can't write to {arguments.log.parent}")
    return arguments


def _open_bus(arguments: argparse.Namespace) -> can.BusABC:
    """Raises `ConfigurationError`."""
    if arguments.slcan:
        return SlcanAdapter(arguments.bitrate)
    try:
        bus = can.Bus(
            interface=arguments.interface,
            channel=arguments.channel,
            bitrate=arguments.bitrate,
        )
        deepen(bus)
        return bus
    except (can.CanError, OSError, ValueError, ImportError) as error:
        hint = "; is it there and up (ip link)?" if arguments.interface == "socketcan" else ""
        raise ConfigurationError(
            f"can't open CAN interface {arguments.interface} {arguments.channel}: {error}{hint}"
        ) from error


def _open_log(arguments: argparse.Namespace) -> LogWriter | None:
    """Raises `ConfigurationError`."""
    if arguments.bus_log is None:
        return None

    def complain(text: str) -> None:
        print(f"epos2_ros simulator: {text}", file=sys.stderr)

    size_bytes = arguments.bus_log_size * 1_000_000
    return LogWriter(
        arguments.bus_log, size_bytes, now_us(), wall_offset_us, complain, name="--bus-log"
    )


def _described(arguments: argparse.Namespace) -> str:
    families = {"EPOS2": arguments.nodes, "Copley": arguments.copley, "CL3-E": arguments.cl3e}
    return " and ".join(
        f"{family} drives, nodes {', '.join(map(str, nodes))}"
        for family, nodes in families.items()
        if nodes
    )


def _take_by_hand(simulator: RealtimeSimulator) -> None:
    """Turns shafts as standard input says, to its end."""
    for line in sys.stdin:
        try:
            node, counts = line.split()
            node_id, by = int(node), float(counts)
        except ValueError:
            wrong = f"{line.strip()!r}: a node id and counts, like 3 500"
            print(f"epos2_ros simulator: {wrong}", file=sys.stderr)
            continue
        turned = simulator.push(node_id, by)
        print(f"node {node_id}: {f'turned by {by:g} counts' if turned else 'held'}", flush=True)


def main(argv: list[str] | None = None) -> int:
    """Runs until SIGINT or SIGTERM. Returns 0, or 2 after one line about wrong arguments."""
    try:
        arguments = _arguments(sys.argv[1:] if argv is None else argv)
        log = _open_log(arguments)
        bus = _open_bus(arguments)
    except Epos2RosError as error:
        print(f"epos2_ros simulator: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    stop = threading.Event()
    for each in (signal.SIGINT, signal.SIGTERM):
        signal.signal(each, lambda *_: stop.set())
    drives = build_drives(
        arguments.nodes,
        counts_per_turn=arguments.counts_per_turn,
        drift_ppm=arguments.drift_ppm,
        seed=arguments.seed,
        bitrate=arguments.bitrate,
        record=arguments.log is not None,
        dictionary=arguments.dictionary,
    )
    copley = build_copley_drives(
        arguments.copley, drift_ppm=arguments.drift_ppm, record=arguments.log is not None
    )
    cl3e = build_cl3e_drives(
        arguments.cl3e,
        counts_per_turn=arguments.counts_per_turn,
        drift_ppm=arguments.drift_ppm,
        record=arguments.log is not None,
    )
    observed = {} if log is None else {"on_frame": log.frame}
    simulator = RealtimeSimulator(bus, [*drives, *copley, *cl3e], **observed)
    simulator.start()
    where = f"{arguments.interface} {arguments.channel}"
    if isinstance(bus, SlcanAdapter):
        where = f"the slcan adapter {bus.path}"
    print(f"simulated {_described(arguments)}, on {where}", flush=True)
    if arguments.hand:
        threading.Thread(target=_take_by_hand, args=(simulator,), daemon=True).start()
    stop.wait()
    simulator.stop()
    bus.shutdown()
    if log is not None:
        log.close()
    if arguments.log is not None:
        save_log(arguments.log, [*drives, *copley, *cl3e])
    return 0


if __name__ == "__main__":
    sys.exit(main())
