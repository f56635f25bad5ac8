"""Configuring one EPOS2 by SDO, with canopen's own classes.

In the order of the application note's 3.7: mode, limits, PDO mapping; the drive ends up in NMT
operational, powered off, without a fault. canopen reads the names from the EDS in
`epos2_ros/eds/`.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from importlib import resources

import canopen

from epos2_ros.bus.link import Network
from epos2_ros.errors import DriveError
from epos2_ros.protocol import cia402, epos2
from epos2_ros.protocol.cia402 import State
from epos2_ros.protocol.epos2 import PdoMapping
from epos2_ros.protocol.timekeeper import HOST_NODE_ID

DRIVE_HEARTBEAT_MS = 200
HOST_HEARTBEAT_TIMEOUT_MS = 500  # the drive stops by itself when the host is silent so long
BUFFER_STATUS_INHIBIT_US = 5_000  # the note's example: 5.0 ms
STATE_TIMEOUT_S = 5.0


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

    def __str__(self) -> str:
        return f"{self.joint} (node {self.node_id})"


def object_dictionary() -> canopen.ObjectDictionary:
    """The EPOS2's object dictionary, from the package's EDS."""
    with resources.as_file(resources.files("epos2_ros") / "eds" / "epos2.eds") as path:
        return canopen.import_od(str(path))


class Epos2Node:
    """SDO access to one drive: bring-up, and the buffer clear that no PDO can do."""

    def __init__(self, network: Network, settings: Epos2Settings) -> None:
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
            for mapping in epos2.RPDO_MAPPINGS:
                self._map(self.node.rpdo[mapping.number], mapping)
            for mapping in epos2.TPDO_MAPPINGS:
                self._map(self.node.tpdo[mapping.number], mapping)
            self.node.nmt.send_command(0x01)  # operational
            return self._read(epos2.STATUSWORD)
        except canopen.SdoAbortedError as error:
            raise DriveError(f"{self.settings}: SDO aborted by the drive: {error}") from error
        except canopen.SdoCommunicationError as error:
            raise DriveError(f"{self.settings} stopped answering SDO requests") from error

    def clear_buffer(self) -> None:
        """Empty the interpolation buffer and enable access to it (0x60C4-06: 0, then 1)."""
        try:
            for value in (0, 1):
                self._write(
                    epos2.INTERPOLATION_DATA_CONFIGURATION, value, epos2.BUFFER_CLEAR_SUBINDEX
                )
        except (canopen.SdoAbortedError, canopen.SdoCommunicationError) as error:
            raise DriveError(f"{self.settings}: can't clear its buffer: {error}") from error

    # ------------------------------------------------------------------ steps

    def _check_identity(self) -> None:
        try:
            device_type = self._read(epos2.DEVICE_TYPE)
        except canopen.SdoCommunicationError as error:
            raise DriveError(
                f"no answer from {self.settings}: check power, wiring, termination, the node id "
                "set on the drive and can.bitrate"
            ) from error
        vendor = self._read(epos2.IDENTITY, 1)
        if not epos2.is_drive_profile(device_type) or vendor != epos2.VENDOR_ID:
            raise DriveError(
                f"{self.settings} is not an EPOS2: device type 0x{device_type:08X}, vendor "
                f"0x{vendor:08X}; expected profile 402 and maxon's 0x{epos2.VENDOR_ID:08X}; "
                f"check axes.{self.settings.joint}.node_id"
            )

    def _leave_operation(self) -> None:
        """Power off, faults reset: from whatever state an earlier host has left."""
        deadline = time.monotonic() + STATE_TIMEOUT_S
        told: State | None = None
        while True:
            state = cia402.state_of(self._read(epos2.STATUSWORD))
            controlword = cia402.step(state, State.SWITCH_ON_DISABLED)
            if state is State.SWITCH_ON_DISABLED:
                return
            if time.monotonic() > deadline or (state is State.FAULT and told is State.FAULT):
                code = self._read(0x1003, 1) & 0xFFFF
                raise DriveError(
                    f"{self.settings} stays in {state.value}: {epos2.describe_emergency(code)}"
                )
            if controlword is not None and state is not told:
                if controlword == cia402.FAULT_RESET:
                    self._write(epos2.CONTROLWORD, cia402.DISABLE_VOLTAGE)  # bit 7 has to rise
                self._write(epos2.CONTROLWORD, controlword)
                told = state

    def _write_objects(self) -> None:
        s = self.settings
        self._write(epos2.MODES_OF_OPERATION, epos2.MODE_INTERPOLATED_POSITION)
        self._write(epos2.VELOCITY_NOTATION_INDEX, s.velocity_notation)
        self._write(epos2.INTERPOLATION_SUB_MODE, -1)  # cubic spline (PVT)
        self._write(epos2.MAX_FOLLOWING_ERROR, s.max_following_error_qc)
        self._write(epos2.SOFTWARE_POSITION_LIMIT, s.min_position_qc, 1)
        self._write(epos2.SOFTWARE_POSITION_LIMIT, s.max_position_qc, 2)
        for index, value in (
            (epos2.MAX_PROFILE_VELOCITY, s.max_velocity),
            (epos2.PROFILE_VELOCITY, s.warning_velocity),
            (epos2.MAX_ACCELERATION, s.max_acceleration_rpm_s),
            (epos2.PROFILE_ACCELERATION, s.warning_acceleration_rpm_s),
            (epos2.PROFILE_DECELERATION, s.stop_deceleration_rpm_s),
            (epos2.QUICK_STOP_DECELERATION, s.stop_deceleration_rpm_s),
        ):
            if value is not None:
                self._write(index, value)
        self._write(epos2.PRODUCER_HEARTBEAT_TIME, DRIVE_HEARTBEAT_MS)
        self._write(
            epos2.CONSUMER_HEARTBEAT_TIME, HOST_NODE_ID << 16 | HOST_HEARTBEAT_TIMEOUT_MS, 1
        )
        mode = self._read(epos2.MODES_OF_OPERATION_DISPLAY)
        if mode != epos2.MODE_INTERPOLATED_POSITION:
            raise DriveError(
                f"{s} stays in mode {mode}, not interpolated position mode (7): its firmware "
                "must be 2101h or higher"
            )

    def _map(self, pdo: canopen.pdo.PdoMap, mapping: PdoMapping) -> None:
        pdo.clear()
        pdo.cob_id = mapping.cob_id + self.settings.node_id
        pdo.trans_type = mapping.transmission_type
        pdo.event_timer = None
        pdo.inhibit_time = {
            epos2.TPDO1: BUFFER_STATUS_INHIBIT_US // 100,
            epos2.TPDO2: self.settings.state_inhibit_us // 100,
        }.get(mapping.cob_id)
        pdo.enabled = True
        for index, subindex in mapping.objects:
            pdo.add_variable(index, subindex)
        pdo.save()

    def _read(self, index: int, subindex: int = 0) -> int:
        entry = self.node.sdo[index]
        variable = entry if isinstance(entry, canopen.sdo.SdoVariable) else entry[subindex]
        return int(variable.raw)

    def _write(self, index: int, value: int, subindex: int = 0) -> None:
        entry = self.node.sdo[index]
        variable = entry if isinstance(entry, canopen.sdo.SdoVariable) else entry[subindex]
        variable.raw = value
