"""What is an EPOS2's own in bring-up, in the order of the application note's 3.7."""

from __future__ import annotations

from dataclasses import dataclass, replace

import canopen

from epos2_ros.bus.cia402_node import Cia402Node, Family
from epos2_ros.bus.link import Network
from epos2_ros.errors import DriveError
from epos2_ros.protocol import epos2

BUFFER_STATUS_INHIBIT_US = 5_000  # the note's example: 5.0 ms
EPOS2 = Family(
    "an EPOS2", "maxon", epos2.VENDOR_ID, "epos2.eds", epos2.RPDO_MAPPINGS, epos2.TPDO_MAPPINGS
)


@dataclass(frozen=True)
class Epos2Settings:
    """What is written to a drive, in its own units; None leaves the drive's value."""

    joint: str
    node_id: int
    velocity_notation: int
    max_following_error_qc: int
    min_position_qc: int
    max_position_qc: int
    max_velocity: int | None = None  # 0x607F [velocity units]
    warning_velocity: int | None = None  # 0x6081
    max_acceleration_rpm_s: int | None = None  # 0x60C5
    warning_acceleration_rpm_s: int | None = None  # 0x6083
    stop_deceleration_rpm_s: int | None = None  # 0x6084, 0x6085
    state_inhibit_us: int = 20_000
    clock_master: int | None = None  # node id of the drive that is; None: the host


def family_of(settings: Epos2Settings) -> Family:
    """With the PDOs of a clock master, or of a drive that follows one."""
    master = settings.clock_master
    if master is None:
        return EPOS2
    if master == settings.node_id:
        return replace(EPOS2, tpdos=epos2.CLOCK_MASTER_TPDO_MAPPINGS)
    return replace(EPOS2, rpdos=epos2.clock_slave_rpdo_mappings(master))


class Epos2Node:
    """SDO access to one drive: bring-up, and the buffer clear that no PDO can do."""

    def __init__(self, network: Network, settings: Epos2Settings) -> None:
        self.settings = settings
        self._access = Cia402Node(network, family_of(settings), settings.joint, settings.node_id)
        self.node = self._access.node

    def configure(self) -> int:
        """Check identity, configure, go operational; the statusword the drive then has."""
        inhibit_us = {
            epos2.TPDO1: BUFFER_STATUS_INHIBIT_US,
            epos2.TPDO2: self.settings.state_inhibit_us,
        }
        return self._access.configure(self._write_objects, inhibit_us)

    def clear_buffer(self) -> None:
        """Empty the interpolation buffer and enable access to it (0x60C4-06: 0, then 1)."""
        index, subindex = epos2.INTERPOLATION_DATA_CONFIGURATION, epos2.BUFFER_CLEAR_SUBINDEX
        try:
            for value in (0, 1):
                self._access.write(index, value, subindex)
        except (canopen.SdoAbortedError, canopen.SdoCommunicationError) as error:
            raise DriveError(f"{self._access}: can't clear its buffer: {error}") from error

    def produce_sync(self, period_us: int) -> None:
        """The drive sends SYNC from now on; 0: no longer."""
        generates = epos2.GENERATES_SYNC if period_us else 0
        try:
            self._access.write(epos2.COMMUNICATION_CYCLE_PERIOD, period_us)
            self._access.write(epos2.COB_ID_SYNC, generates | epos2.SYNC)
        except (canopen.SdoAbortedError, canopen.SdoCommunicationError) as error:
            raise DriveError(f"{self._access} can't be the SYNC producer: {error}") from error

    def _write_objects(self) -> None:
        s, write = self.settings, self._access.write
        write(epos2.COB_ID_SYNC, epos2.SYNC)  # an earlier host may have made it the producer
        write(epos2.MODES_OF_OPERATION, epos2.MODE_INTERPOLATED_POSITION)
        write(epos2.VELOCITY_NOTATION_INDEX, s.velocity_notation)
        write(epos2.INTERPOLATION_SUB_MODE, -1)  # cubic spline (PVT)
        write(epos2.MAX_FOLLOWING_ERROR, s.max_following_error_qc)
        write(epos2.SOFTWARE_POSITION_LIMIT, s.min_position_qc, 1)
        write(epos2.SOFTWARE_POSITION_LIMIT, s.max_position_qc, 2)
        for index, value in (
            (epos2.MAX_PROFILE_VELOCITY, s.max_velocity),
            (epos2.PROFILE_VELOCITY, s.warning_velocity),
            (epos2.MAX_ACCELERATION, s.max_acceleration_rpm_s),
            (epos2.PROFILE_ACCELERATION, s.warning_acceleration_rpm_s),
            (epos2.PROFILE_DECELERATION, s.stop_deceleration_rpm_s),
            (epos2.QUICK_STOP_DECELERATION, s.stop_deceleration_rpm_s),
        ):
            if value is not None:
                write(index, value)
        mode = self._access.read(epos2.MODES_OF_OPERATION_DISPLAY)
        if mode != epos2.MODE_INTERPOLATED_POSITION:
            raise DriveError(
                f"{self._access} stays in mode {mode}, not interpolated position mode (7): its "
                "firmware must be 2101h or higher"
            )
