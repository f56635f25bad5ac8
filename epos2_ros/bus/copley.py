"""Configuring one Copley drive by SDO, with canopen's own classes.

As for an EPOS2 where CiA 301 and CiA 402 are the same: identity, faults, limits, PDO mapping,
operational; then its mode of motion is profile position. canopen reads the names from the EDS in
`epos2_ros/eds/`.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from importlib import resources

import canopen

from epos2_ros.bus.bringup import DRIVE_HEARTBEAT_MS, HOST_HEARTBEAT_TIMEOUT_MS, STATE_TIMEOUT_S
from epos2_ros.bus.link import Network
from epos2_ros.config import AxisConfig
from epos2_ros.errors import ConfigurationError, DriveError
from epos2_ros.motion.units import UINT32_MAX, AxisUnits, position_limits
from epos2_ros.protocol import cia402, copley, epos2
from epos2_ros.protocol.cia402 import State
from epos2_ros.protocol.epos2 import PdoMapping
from epos2_ros.protocol.sdo import SdoWrite
from epos2_ros.protocol.timekeeper import HOST_NODE_ID


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

    def __str__(self) -> str:
        return f"{self.joint} (node {self.node_id})"


def object_dictionary() -> canopen.ObjectDictionary:
    """The Copley drive's object dictionary, from the package's EDS."""
    with resources.as_file(resources.files("epos2_ros") / "eds" / "copley.eds") as path:
        return canopen.import_od(str(path))


class CopleyNode:
    """SDO access to one drive."""

    def __init__(self, network: Network, settings: CopleySettings) -> None:
        self.settings = settings
        self.node = canopen.RemoteNode(settings.node_id, object_dictionary())
        network[settings.node_id] = self.node

    def configure(self) -> int:
        """Check identity, configure, go operational; the statusword the drive then has."""
        try:
            self.node.nmt.send_command(0x80)  # pre-operational: PDOs are mapped there
            self._check_identity()
            self._leave_operation()
            self._write_objects()
            for mapping in copley.RPDO_MAPPINGS:
                self._map(self.node.rpdo[mapping.number], mapping)
            for mapping in copley.TPDO_MAPPINGS:
                self._map(self.node.tpdo[mapping.number], mapping)
            self.node.nmt.send_command(0x01)  # operational
            return self._read(epos2.STATUSWORD)
        except canopen.SdoAbortedError as error:
            raise DriveError(f"{self.settings}: SDO aborted by the drive: {error}") from error
        except canopen.SdoCommunicationError as error:
            raise DriveError(f"{self.settings} stopped answering SDO requests") from error

    def _check_identity(self) -> None:
        try:
            device_type = self._read(epos2.DEVICE_TYPE)
        except canopen.SdoCommunicationError as error:
            raise DriveError(
                f"no answer from {self.settings}: check power, wiring, termination, the node id "
                "set on the drive and can.bitrate"
            ) from error
        vendor = self._read(epos2.IDENTITY, 1)
        if not epos2.is_drive_profile(device_type) or vendor != copley.VENDOR_ID:
            raise DriveError(
                f"{self.settings} is not a Copley drive: device type 0x{device_type:08X}, vendor "
                f"0x{vendor:08X}; expected profile 402 and Copley's 0x{copley.VENDOR_ID:08X}; "
                f"check axes.{self.settings.joint}.node_id and .drive"
            )

    def _leave_operation(self) -> None:
        """Power off, faults reset: from whatever state an earlier host has left."""
        deadline = time.monotonic() + STATE_TIMEOUT_S
        told: State | None = None
        while (state := cia402.state_of(self._read(epos2.STATUSWORD))) is not (
            State.SWITCH_ON_DISABLED
        ):
            if time.monotonic() > deadline or (state is State.FAULT and told is State.FAULT):
                code = self._read(0x1003, 1) & 0xFFFF
                raise DriveError(
                    f"{self.settings} stays in {state.value}: {epos2.describe_emergency(code)}"
                )
            controlword = cia402.step(state, State.SWITCH_ON_DISABLED)
            if controlword is not None and state is not told:
                if controlword == cia402.FAULT_RESET:  # bit 7 has to rise
                    self._write(epos2.CONTROLWORD, cia402.DISABLE_VOLTAGE, 2)
                self._write(epos2.CONTROLWORD, controlword, 2)
                told = state

    def _write_objects(self) -> None:
        s = self.settings
        self._write(epos2.MODES_OF_OPERATION, copley.MODE_PROFILE_POSITION, 1)
        self._write(epos2.SOFTWARE_POSITION_LIMIT, s.min_position_qc, 4, 1)
        self._write(epos2.SOFTWARE_POSITION_LIMIT, s.max_position_qc, 4, 2)
        if s.stop_deceleration_counts_s2 is not None:
            stop = copley.acceleration_object(s.stop_deceleration_counts_s2)
            self._write(epos2.QUICK_STOP_DECELERATION, stop, 4)
        self._write(epos2.PRODUCER_HEARTBEAT_TIME, DRIVE_HEARTBEAT_MS, 2)
        watched = HOST_NODE_ID << 16 | HOST_HEARTBEAT_TIMEOUT_MS
        self._write(epos2.CONSUMER_HEARTBEAT_TIME, watched, 4, 1)

    def _map(self, pdo: canopen.pdo.PdoMap, mapping: PdoMapping) -> None:
        pdo.clear()
        pdo.cob_id = mapping.cob_id + self.settings.node_id
        pdo.trans_type = mapping.transmission_type
        pdo.event_timer = pdo.inhibit_time = None
        pdo.enabled = True
        for index, subindex in mapping.objects:
            pdo.add_variable(index, subindex)
        pdo.save()

    def _read(self, index: int, subindex: int = 0) -> int:
        return int.from_bytes(self.node.sdo.upload(index, subindex), "little")

    def _write(self, index: int, value: int, size: int, subindex: int = 0) -> None:
        write = SdoWrite.integer(index, subindex, value, size, signed=value < 0)
        self.node.sdo.download(write.index, write.subindex, write.data)
