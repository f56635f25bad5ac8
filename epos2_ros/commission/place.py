"""Which bus the programs of this room work on: named by itself, or by a parameter file."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from epos2_ros.bus.simulation import Simulation
from epos2_ros.configuration.driver import DriverConfig
from epos2_ros.configuration.files import read_parameters
from epos2_ros.configuration.parameters import BIT_RATES, DriverParameters
from epos2_ros.errors import ConfigurationError

INTERFACE, CHANNEL, BITRATE = "socketcan", "can0", 1_000_000


@dataclass(frozen=True)
class Place:
    """A bus."""

    interface: str
    channel: str
    bitrate: int
    simulated: bool = False  # its drives are in this process

    @property
    def name(self) -> str:
        if self.interface == "socketcan":  # its bit rate is the kernel's business
            return self.channel
        return f"{self.interface} {self.channel}, {self.bitrate // 1000} kbit/s"


def add_place(parser: argparse.ArgumentParser) -> None:
    """Arguments that say which bus."""
    group = parser.add_argument_group("the bus")
    group.add_argument("--interface", help=f"python-can interface (default: {INTERFACE})")
    group.add_argument("--channel", help=f"its channel (default: {CHANNEL})")
    group.add_argument("--bitrate", type=int, choices=BIT_RATES, help=f"(default: {BITRATE})")
    group.add_argument(
        "--params",
        type=Path,
        metavar="FILE",
        help="the bus of these parameters of the driver; with `simulate: true`, simulated drives",
    )


def config_of(arguments: argparse.Namespace) -> DriverConfig | None:
    """The configuration in `--params`; ConfigurationError where it is wrong."""
    if arguments.params is None:
        return None
    return DriverParameters(read_parameters(arguments.params)).config()


@contextmanager
def place_of(arguments: argparse.Namespace) -> Iterator[Place]:
    """The bus that is meant; simulated drives are on it meanwhile, if the parameters say so."""
    config = config_of(arguments)
    given = arguments.interface, arguments.channel, arguments.bitrate
    if config is None:
        interface, channel, bitrate = given
        if interface not in (None, INTERFACE) and channel is None:
            raise ConfigurationError(f"--interface {interface} needs a --channel")
        yield Place(interface or INTERFACE, channel or CHANNEL, bitrate or BITRATE)
        return
    if any(value is not None for value in given):
        raise ConfigurationError("--params says which bus: leave --interface, --channel, … out")
    place = Place(config.interface, config.channel, config.bitrate, config.simulate)
    if not config.simulate:
        yield place
        return
    with simulated(config):
        yield place


@contextmanager
def simulated(config: DriverConfig) -> Iterator[Simulation]:
    """Simulated drives for every joint of the configuration, on its bus."""
    simulation = Simulation(config)
    try:
        yield simulation
    finally:
        simulation.close()
