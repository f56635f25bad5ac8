"""The program `scan`: who is on this bus. It changes nothing on any drive."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence

from epos2_ros.bus.link import open_bus
from epos2_ros.commission import report, wire
from epos2_ros.commission.parameter_file import parameter_file
from epos2_ros.commission.place import Place, add_place, place_of
from epos2_ros.configuration.arguments import number, without_ros_arguments
from epos2_ros.configuration.parameters import BIT_RATES
from epos2_ros.errors import Epos2RosError

LISTEN_S = 1.0
OTHER_BITRATES = """\
to listen at another bit rate, without disturbing anybody:
  sudo ip link set {channel} down
  sudo ip link set {channel} type can bitrate 500000 listen-only on
  sudo ip link set {channel} up && candump {channel}
and back for work: the same with listen-only off"""


def main(argv: Sequence[str] | None = None) -> int:
    """Returns 0 when a device was found, 1 when none was or the bus can't be used."""
    arguments = _arguments(sys.argv[1:] if argv is None else argv)
    try:
        return run(arguments)
    except Epos2RosError as error:
        print(f"epos2_ros scan: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130


def run(arguments: argparse.Namespace) -> int:
    """The report goes to standard output, or beside it where that gets the parameter file."""
    with place_of(arguments) as place:
        beside = sys.stderr if arguments.yaml else sys.stdout
        with open_bus(place.interface, place.channel, place.bitrate) as bus:
            survey, wiring = wire.run(bus, place.bitrate, arguments.listen)
        print(report.text(survey, wiring, place.name), file=beside, flush=True)
        found = any(survey.present())
        if not survey.heard.frames:
            for line in _elsewhere(place):
                print(f"  {line}", file=beside, flush=True)
        if arguments.yaml:
            print(parameter_file(survey, place))
        return 0 if found else 1


def _elsewhere(place: Place) -> Iterator[str]:
    """Where else the drives may be: at another bit rate."""
    if place.interface == "slcan":
        others = sorted((rate for rate in BIT_RATES if rate != place.bitrate), reverse=True)
        yield f"listening at {', '.join(str(rate // 1000) for rate in others)} kbit/s"
        found = wire.busy_bitrate(place.channel, others)
        if found is None:
            yield "nothing is heard at any of them"
        else:
            yield f"there is traffic at {found // 1000} kbit/s: --bitrate {found}"
    if place.interface == "socketcan":
        yield from OTHER_BITRATES.format(channel=place.channel).splitlines()


def _arguments(argv: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="epos2_ros scan",
        description="Who is on this bus: makers, products, firmware, states, and what is odd. "
        "It listens, then reads from every node id; it changes nothing on any drive.",
    )
    add_place(parser)
    parser.add_argument(
        "--listen",
        type=number(0, 60, "a number of seconds from 0 to 60"),
        default=LISTEN_S,
        metavar="SECONDS",
        help=f"listen so long before anything is sent (default: {LISTEN_S:g})",
    )
    parser.add_argument(
        "--yaml",
        action="store_true",
        help="write a parameter file for the drives found to standard output, ready to be edited",
    )
    return parser.parse_args(without_ros_arguments(argv))
