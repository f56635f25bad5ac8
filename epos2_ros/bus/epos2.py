"""What is an EPOS2's own in bring-up, in the order of the application note's 3.7."""

from __future__ import annotations

from dataclasses import dataclass, replace

from epos2_ros.bus.cia402_node import GOES_ON, Cia402Node
from epos2_ros.bus.link import Network
from epos2_ros.bus.sdo_access import Refused
from epos2_ros.errors import DriveError
from epos2_ros.protocol import epos2
from epos2_ros.protocol.family import Family
from epos2_ros.protocol.sdo import NOT_MAPPABLE

INHIBIT_US = {
    epos2.TPDO1: 5_000,  # the note's example: 5.0 ms
    epos2.TPDO2: 500_000,  # an axis that is turned by hand while it is off is seen so often
}
_LIMITS = ("min_position", "max_position")


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
    produces_sync: bool = False
    clock_master: int | None = None  # node id of the drive that is; None: the host


def family_of(settings: Epos2Settings) -> Family:
    """With the PDOs of a clock master, or of a drive that follows one."""
    master = settings.clock_master
    if master is None:
        return epos2.FAMILY
    if master == settings.node_id:
        return replace(epos2.FAMILY, tpdos=epos2.CLOCK_MASTER_TPDO_MAPPINGS)
    rpdos = epos2.clock_slave_rpdo_mappings(epos2.RPDO_MAPPINGS, master)
    return replace(epos2.FAMILY, rpdos=rpdos)


class Epos2Node:
    """SDO access to one drive: bring-up, and what of the buffer no PDO can do."""

    def __init__(self, network: Network, settings: Epos2Settings) -> None:
        self.settings = settings
        self.units: tuple[float, float, float] | None = None
        self._access = Cia402Node(network, family_of(settings), settings.joint, settings.node_id)
        self._objects = self._access.objects
        self.node = self._access.node

    def configure(self) -> int:
        """Check identity, configure, go operational; the statusword the drive then has."""
        try:
            return self._access.configure(self._write_objects, INHIBIT_US)
        except Refused as refusal:
            s = self.settings
            if refusal.code == NOT_MAPPABLE and s.clock_master == s.node_id:
                raise DriveError(
                    f"{self._access} can't be the clock master: it can't send its clock (0x1013 "
                    "can't be mapped into a TPDO, as by maxon's EDS of 2011 and later); set "
                    "sync.source to host"
                ) from refusal
            raise

    def produce_sync(self, period_us: int) -> None:
        """The drive sends SYNC from now on; 0: no longer."""
        generates = epos2.GENERATES_SYNC if period_us else 0
        self._objects.write(epos2.COMMUNICATION_CYCLE_PERIOD, period_us)
        self._objects.write(epos2.COB_ID_SYNC, generates | epos2.SYNC)

    def clear_faults(self) -> None:
        """A fault reset needs nothing before."""

    def leave(self) -> None:
        """The host goes: a drive that is off need not watch it any more."""
        self._access.leave()

    def _write_objects(self) -> None:
        self._check_firmware()
        s, write = self.settings, self._objects.write
        if s.produces_sync:
            self._check_sync_producer()
        self._objects.read(epos2.HIGH_RESOLUTION_TIME_STAMP)  # as it will be after each SYNC
        self._access.watch_host()
        write(epos2.COB_ID_SYNC, epos2.SYNC)  # an earlier host may have made it the producer
        self._stop_without_host()
        write(epos2.MODES_OF_OPERATION, epos2.MODE_INTERPOLATED_POSITION)
        for index, subindex, value, parameters in (
            (epos2.VELOCITY_NOTATION_INDEX, 0, s.velocity_notation, ("velocity_notation",)),
            (epos2.INTERPOLATION_SUB_MODE, 0, -1, ()),  # cubic spline (PVT)
            (epos2.MAX_FOLLOWING_ERROR, 0, s.max_following_error_qc, ("max_following_error",)),
            (epos2.SOFTWARE_POSITION_LIMIT, 1, s.min_position_qc, _LIMITS),
            (epos2.SOFTWARE_POSITION_LIMIT, 2, s.max_position_qc, _LIMITS),
            (epos2.MAX_PROFILE_VELOCITY, 0, s.max_velocity, ("max_velocity", "velocity_notation")),
            (epos2.PROFILE_VELOCITY, 0, s.warning_velocity, ("max_velocity",)),
            (epos2.MAX_ACCELERATION, 0, s.max_acceleration_rpm_s, ("max_acceleration",)),
            (epos2.PROFILE_ACCELERATION, 0, s.warning_acceleration_rpm_s, ("max_acceleration",)),
            (epos2.PROFILE_DECELERATION, 0, s.stop_deceleration_rpm_s, ("stop_deceleration",)),
            (epos2.QUICK_STOP_DECELERATION, 0, s.stop_deceleration_rpm_s, ("stop_deceleration",)),
        ):
            if value is not None:
                names = " and ".join(f"axes.{s.joint}.{name}" for name in parameters)
                write(index, value, subindex, check=f"check {names}" if names else "")
        mode = self._objects.read(epos2.MODES_OF_OPERATION_DISPLAY)
        if mode != epos2.MODE_INTERPOLATED_POSITION:
            raise DriveError(
                f"{self._access} stays in mode {mode}, not interpolated position mode (7): its "
                "firmware must be 2101h or higher"
            )

    def _check_firmware(self) -> None:
        """0x1018-03 is the software version times 10000h, 0x2003-01 the version itself."""
        software = self._objects.read(epos2.IDENTITY, epos2.REVISION_SUBINDEX) >> 16
        software = software or self._objects.find(epos2.VERSION, 1) or 0
        if 0 < software < epos2.FIRST_SOFTWARE:
            raise DriveError(
                f"{self._access} has firmware {software:04X}h, which has no interpolated position "
                f"mode: it takes {epos2.FIRST_SOFTWARE:04X}h or higher; update it with EPOS Studio"
            )

    def _check_sync_producer(self) -> None:
        if self._objects.find(epos2.COMMUNICATION_CYCLE_PERIOD) is None:
            raise DriveError(
                f"{self._access} can't send SYNC: it has no communication cycle period (0x1006), "
                "as no EPOS2 of known firmware has; set sync.producer to host"
            )

    def _stop_without_host(self) -> None:
        """What the drive does when the host falls silent: 3 is quick stop, its own preset.

        A 0 that somebody has stored would mean that it goes on. A drive without the object can't
        have stored one.
        """
        if self._objects.find(epos2.ABORT_CONNECTION_OPTION) not in (None, epos2.QUICK_STOP_OPTION):
            name = self._objects.name(epos2.ABORT_CONNECTION_OPTION)
            attempt = f"let it stop when the host falls silent, {name}"
            option = epos2.QUICK_STOP_OPTION
            self._objects.keep(epos2.ABORT_CONNECTION_OPTION, option, 0, attempt, GOES_ON)
