"""The command `epos2_ros layout`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from epos2_ros.configuration.arguments import without_ros_arguments
from epos2_ros.configuration.driver import DriverConfig
from epos2_ros.configuration.files import DRIVER
from epos2_ros.configuration.names import Names
from epos2_ros.configuration.parameter_file import ParameterFile
from epos2_ros.configuration.parameters import DriverParameters
from epos2_ros.errors import Epos2RosError
from epos2_ros.layout import aggregator, foxglove, plotjuggler
from epos2_ros.layout.tabs import tabs_of

KINDS: dict[str, Callable[[DriverConfig, Names], str]] = {
    "plotjuggler": lambda config, names: plotjuggler.layout(tabs_of(config, names)),
    "foxglove": lambda config, names: foxglove.layout(tabs_of(config, names)),
    "diagnostics": aggregator.file,
}


def main(argv: Sequence[str] | None = None) -> int:
    """Returns 0, or 1 after one line on standard error."""
    parser = argparse.ArgumentParser(
        prog="epos2_ros layout",
        description="Writes a layout of PlotJuggler or Foxglove for the joints and outputs of a "
        "parameter file, or parameters of diagnostic_aggregator for them.",
    )
    parser.add_argument("kind", choices=list(KINDS))
    parser.add_argument(
        "--params",
        type=Path,
        metavar="FILE",
        help="parameters of the driver (default: its own, joint_1 to joint_6)",
    )
    parser.add_argument(
        "--node",
        metavar="NAME",
        help=f"full name of the driver (default: the one in the file, or /{DRIVER})",
    )
    parser.add_argument(
        "--output", type=Path, metavar="FILE", help="where to (default: standard output)"
    )
    arguments = parser.parse_args(without_ros_arguments(sys.argv[1:] if argv is None else argv))
    try:
        text = KINDS[arguments.kind](*read(arguments.params, arguments.node))
        if arguments.output is None:
            sys.stdout.write(text)
        else:
            arguments.output.write_text(text, encoding="utf-8")
    except Epos2RosError as error:
        problem = str(error)
    except BrokenPipeError:
        raise  # whoever reads it has seen enough
    except OSError as error:
        problem = f"can't write {error.filename}: {error.strerror}"
    else:
        return 0
    print(f"epos2_ros layout: {problem}", file=sys.stderr)
    return 1


def read(params: Path | None, node: str | None) -> tuple[DriverConfig, Names]:
    """The driver that a parameter file is for; without one, or a name, the driver's own."""
    if params is None:
        return DriverParameters({}).config(), Names(_full(node or DRIVER))
    file = ParameterFile.read(params)
    name = _full(node or file.node(DRIVER))
    return DriverParameters(file.of(name)).config(), Names(name)


def _full(name: str) -> str:
    return f"/{name.lstrip('/')}"
