"""What is a Copley drive's own in bring-up: its mode of motion is profile position."""

from __future__ import annotations

from dataclasses import dataclass

from epos2_ros.bus.cia402_node import Cia402Node
from epos2_ros.bus.link import Network
from epos2_ros.config import AxisConfig
from epos2_ros.errors import ConfigurationError, DriveError
from epos2_ros.motion.units import UINT32_MAX, AxisUnits, position_limits
from epos2_ros.protocol import copley, epos2


@dataclass(frozen=True)
class CopleySettings:
    """What is written to a drive, in counts; None leaves the drive's value."""

    joint: str
    node_id: int
    min_position_qc: int
    max_position_qc: int
    stop_deceleration_counts_s2: float | None = None  # 0x6085

    @classmethod
    def of(cls, axis: AxisConfig) -> CopleySettings:
        """From the configuration in joint units."""
        units, stop = AxisUnits.of(axis), axis.stop_deceleration
        for parameter, unit, step in (
            ("max_velocity", "/s", copley.VELOCITY_UNIT_COUNTS_S),
            ("max_acceleration", "/s²", copley.ACCELERATION_UNIT_COUNTS_S2),
            ("stop_deceleration", "/s²", copley.ACCELERATION_UNIT_COUNTS_S2),
        ):
            value, most = getattr(axis, parameter), abs(units.from_qc_s(UINT32_MAX * step))
            if value is not None and value > most:
                raise ConfigurationError(
                    f"axes.{axis.joint}.{parameter}: {value:g} {units.unit}{unit} is more than the "
                    f"drive can hold ({most:g} {units.unit}{unit})"
                )
        return cls(
            axis.joint,
            axis.node_id,
            *position_limits(axis, margin_qc=1),
            None if stop is None else abs(units.to_qc_s(stop)),
        )


class CopleyNode:
    """SDO access to one drive."""

    def __init__(self, network: Network, settings: CopleySettings) -> None:
        self.settings = settings
        self._access = Cia402Node(network, copley.FAMILY, settings.joint, settings.node_id)
        self.node = self._access.node

    def configure(self) -> int:
        """Check identity, configure, go operational; the statusword the drive then has."""
        return self._access.configure(self._write_objects)

    def produce_sync(self, period_us: int) -> None:
        """DriveError: sync.producer is to be the host or an EPOS2."""
        raise DriveError(f"{self._access} is not asked to send SYNC: set sync.producer to host")

    def _write_objects(self) -> None:
        s, write = self.settings, self._access.objects.write
        self._access.watch_host()
        write(epos2.MODES_OF_OPERATION, copley.MODE_PROFILE_POSITION)
        write(epos2.SOFTWARE_POSITION_LIMIT, s.min_position_qc, 1)
        write(epos2.SOFTWARE_POSITION_LIMIT, s.max_position_qc, 2)
        if s.stop_deceleration_counts_s2 is not None:
            stop = max(1, round(s.stop_deceleration_counts_s2 / copley.ACCELERATION_UNIT_COUNTS_S2))
            write(epos2.QUICK_STOP_DECELERATION, stop)
