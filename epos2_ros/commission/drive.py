"""The program `drive`: a drive's stored parameters as a file, so that another can be made alike."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import can
import canopen

from epos2_ros.bus.link import open_bus
from epos2_ros.commission.drive_file import DriveFile, read_drive_file, to_yaml
from epos2_ros.commission.parameter_access import Difference, DriveParameters
from epos2_ros.commission.place import add_place, config_of, place_of
from epos2_ros.configuration.arguments import without_ros_arguments
from epos2_ros.errors import BusError, ConfigurationError, DriveError, Epos2RosError
from epos2_ros.protocol.identity import Identity

DIFFERENT, FAILED = 1, 2  # exit statuses, as of diff


def main(argv: Sequence[str] | None = None) -> int:
    """Returns 0; 1 when something differs in the end, or was not done; 2 after one line of why."""
    arguments = _arguments(sys.argv[1:] if argv is None else argv)
    try:
        status: int = arguments.run(arguments)
    except Epos2RosError as error:
        print(f"epos2_ros drive: {error}", file=sys.stderr)
        return FAILED
    except KeyboardInterrupt:
        return 130
    return status


def dump(arguments: argparse.Namespace) -> int:
    """The parameters to standard output, or a file."""
    with _drive(arguments) as drive:
        text = to_yaml(DriveFile(drive.identity, drive.node_id, drive.read()))
    if arguments.output is None:
        print(text, end="")
        return 0
    try:
        arguments.output.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigurationError(f"can't write {arguments.output}: {error.strerror}") from error
    return 0


def diff(arguments: argparse.Namespace) -> int:
    """Where the drive is not as the file says."""
    file = read_drive_file(arguments.file)
    with _drive(arguments) as drive:
        _check_maker(file, drive)
        differences = drive.differences(file.values)
        print(f"{drive}: {_count(differences)} of {len(file.values)} parameters differ")
    _print(differences)
    return DIFFERENT if differences else 0


def restore(arguments: argparse.Namespace) -> int:
    """Write what differs, after asking."""
    file = read_drive_file(arguments.file)
    with _drive(arguments) as drive:
        _check_maker(file, drive)
        if drive.powered():
            raise DriveError(f"{drive} is switched on: disable it first, nothing was changed")
        differences = drive.differences(file.values)
        print(f"{drive}: {_count(differences)} of {len(file.values)} parameters differ")
        _print(differences)
        if _kind(file.identity) != _kind(drive.identity):
            print(f"the file is of another kind of drive: {_described(file)}")
        if differences:
            question = f"write them to node {drive.node_id}"
            if arguments.store:
                question += ", and store them"
            if not (arguments.yes or _agreed(question)):
                print("nothing was changed")
                return DIFFERENT
            left = drive.restore(file.values)
            if left:
                print(f"{_count(left)} could not be set, nothing was stored:")
                _print(left)
                return DIFFERENT
            print(f"{_count(differences)} written, and read back as written")
        if arguments.store:
            drive.store()
            print("stored: the drive keeps them when it is switched off")
        elif differences:
            print("not stored: the drive forgets them when it is switched off (--store)")
    return 0


@contextmanager
def _drive(arguments: argparse.Namespace) -> Iterator[DriveParameters]:
    node_id = _node_id(arguments)
    with place_of(arguments) as place:
        network = canopen.Network(open_bus(place.interface, place.channel, place.bitrate))
        try:
            network.connect()
            yield DriveParameters(network, node_id)
        except can.CanError as error:
            raise BusError(f"{place.name}: {error}") from error
        finally:
            with suppress(can.CanError, OSError):  # what is gone can't be told to close
                network.disconnect()  # closes the bus, too


def _node_id(arguments: argparse.Namespace) -> int:
    """A number, or with `--params` a joint."""
    text, config = arguments.node, config_of(arguments)
    if text.isdecimal():
        if 1 <= int(text) <= 127:
            return int(text)
        raise ConfigurationError(f"node id {text}: must be from 1 to 127")
    joints = {} if config is None else {axis.joint: axis.node_id for axis in config.axes}
    if text not in joints:
        known = f"one of {', '.join(joints)}" if joints else "joints need --params"
        raise ConfigurationError(f"{text!r} is neither a node id nor a joint: {known}")
    return joints[text]


def _check_maker(file: DriveFile, drive: DriveParameters) -> None:
    if file.identity.vendor_id != drive.identity.vendor_id:
        raise ConfigurationError(f"the file is of {_described(file)}, and this is {drive}")


def _kind(identity: Identity) -> tuple[int, int, int]:
    return identity.vendor_id, identity.product_code, identity.revision


def _described(file: DriveFile) -> str:
    its = file.identity
    return f"a {its.maker} {its.product}, revision 0x{its.revision:08X}"


def _count(differences: Sequence[Difference]) -> str:
    return str(len(differences))


def _print(differences: Sequence[Difference]) -> None:
    for difference in differences:
        print(f"  {difference}")


def _agreed(question: str) -> bool:
    try:
        answer = input(f"{question}? [y/N] ")
    except EOFError:
        print()
        return False
    return answer.strip().lower() in ("y", "yes")


def _arguments(argv: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="epos2_ros drive",
        description="The stored parameters of a drive as a file, to compare and to make another "
        "drive the same. Motor and regulator settings included; node id and bit rate not.",
    )
    commands = parser.add_subparsers(required=True, dest="command")
    file = argparse.ArgumentParser(add_help=False)
    file.add_argument("file", type=Path, metavar="FILE", help="from `drive dump`")
    place = argparse.ArgumentParser(add_help=False)
    place.add_argument("node", metavar="NODE", help="node id, or with --params a joint")
    add_place(place)
    command = commands.add_parser("dump", parents=[place], help="write the parameters down")
    command.add_argument("--output", type=Path, metavar="FILE", help="(default: standard output)")
    command.set_defaults(run=dump)
    command = commands.add_parser("diff", parents=[file, place], help="where the drive differs")
    command.set_defaults(run=diff)
    command = commands.add_parser(
        "restore", parents=[file, place], help="set the drive to the file's values"
    )
    command.add_argument("--yes", action="store_true", help="do not ask")
    command.add_argument(
        "--store", action="store_true", help="let the drive keep them through a power-off"
    )
    command.set_defaults(run=restore)
    return parser.parse_args(without_ros_arguments(argv))
