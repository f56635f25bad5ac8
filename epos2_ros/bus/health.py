"""What the CAN controller says about the bus, by the error frames of SocketCAN.

Linux, `include/uapi/linux/can/error.h`: the identifier of an error frame is a set of error
classes, its data say more. (python-can's own `state` of a bus is how it was opened.)
"""

from __future__ import annotations

from enum import Enum

CONTROLLER = 0x004  # CAN_ERR_CRTL: its status is in data[1]
BUS_OFF = 0x040  # CAN_ERR_BUSOFF
RESTARTED = 0x100  # CAN_ERR_RESTARTED
CONTROLLER_WARNING = 0x0C  # receiving, transmitting: 96 errors
CONTROLLER_PASSIVE = 0x30  # receiving, transmitting: 128 errors
CONTROLLER_ACTIVE = 0x40


class BusState(Enum):
    """Error states of a CAN controller (ISO 11898-1), as far as it tells."""

    ACTIVE = "error active"
    WARNING = "error warning"
    PASSIVE = "error passive"
    OFF = "bus off"


class Health:
    """Follows the controller's state."""

    def __init__(self) -> None:
        self.state = BusState.ACTIVE
        self.error_frames = 0
        self.transmit_errors = 0  # the controller's own counters, when it last told
        self.receive_errors = 0

    def on_error_frame(self, classes: int, data: bytes) -> None:
        """An error frame of SocketCAN: its identifier without CAN_ERR_FLAG, and its data."""
        self.error_frames += 1
        data = data.ljust(8, b"\0")
        if classes & BUS_OFF:
            self.state = BusState.OFF
        elif classes & RESTARTED:
            self.state = BusState.ACTIVE
        elif classes & CONTROLLER:
            if data[1] & CONTROLLER_PASSIVE:
                self.state = BusState.PASSIVE
            elif data[1] & CONTROLLER_WARNING:
                self.state = BusState.WARNING
            elif data[1] & CONTROLLER_ACTIVE:
                self.state = BusState.ACTIVE
            self.transmit_errors, self.receive_errors = data[6], data[7]
