"""The drive of each axis as bring-up and SDO see it, by family."""

from __future__ import annotations

from typing import Protocol

from epos2_ros.bus.cl3e import Cl3eNode, Cl3eSettings
from epos2_ros.bus.copley import CopleyNode, CopleySettings
from epos2_ros.bus.epos2 import Epos2Node
from epos2_ros.bus.link import Network
from epos2_ros.bus.sdo_client import RemoteNode
from epos2_ros.bus.settings import clock_master, drive_settings
from epos2_ros.configuration.driver import AxisConfig, DriverConfig
from epos2_ros.errors import ConfigurationError
from epos2_ros.protocol import cl3e, copley, epos2
from epos2_ros.protocol.families import FAMILIES, follows_records


class DriveNode(Protocol):
    """SDO access to one drive. DriveError: which step failed, why, and what to check."""

    node: RemoteNode
    # Of velocity, acceleration and jerk, once it was configured [qc/s] …; None: its family's.
    units: tuple[float, float, float] | None

    def configure(self) -> int:
        """Check identity, configure, go operational; the statusword the drive then has."""

    def produce_sync(self, period_us: int) -> None:
        """The drive sends SYNC from now on; 0: no longer."""

    def clear_faults(self) -> None:
        """What a fault reset by controlword needs before."""

    def leave(self) -> None:
        """The host goes: a drive that is off need not watch it any more."""


def check(axis: AxisConfig, config: DriverConfig) -> None:
    """ConfigurationError for a drive that there is not, or that can't hold what it is set to."""
    if axis.drive not in FAMILIES:
        raise ConfigurationError(
            f"axes.{axis.joint}.drive is {axis.drive!r}; it must be {' or '.join(FAMILIES)}"
        )
    follows_records(axis)
    if axis.drive == copley.FAMILY.key:
        CopleySettings.of(axis)
    elif axis.drive == cl3e.FAMILY.key:
        Cl3eSettings.of(axis)
    else:
        drive_settings(axis, config)


def node_of(network: Network, axis: AxisConfig, config: DriverConfig) -> DriveNode:
    """Of an axis that `check` has passed."""
    match axis.drive:
        case epos2.FAMILY.key:
            return Epos2Node(network, drive_settings(axis, config))
        case copley.FAMILY.key:
            return CopleyNode(network, CopleySettings.of(axis, clock_master(config)))
        case cl3e.FAMILY.key:
            return Cl3eNode(network, Cl3eSettings.of(axis))
    raise AssertionError(axis.drive)
