"""A survey carried out on a CAN interface."""

from __future__ import annotations

import math
from collections.abc import Sequence

import can

from epos2_ros.bus.health import Health
from epos2_ros.bus.link import queue_is_full
from epos2_ros.bus.slcan import SlcanBus
from epos2_ros.bus.timestamps import now_us
from epos2_ros.commission.oddities import Wiring
from epos2_ros.commission.survey import Survey
from epos2_ros.errors import BusError
from epos2_ros.protocol.frame import Frame

LONGEST_WAIT_S = 0.05
RETRY_S = 0.005  # when the adapter's queue is full
STUCK_S = 0.5  # so long nothing can be sent: nobody acknowledges
EACH_BITRATE_S = 1.2  # longer than a usual heartbeat time


def run(bus: can.BusABC, bitrate: int, listen_s: float) -> tuple[Survey, Wiring]:
    """Listen, ask, and give back what was found. BusError when the interface fails."""
    survey = Survey(now_us(), bitrate, 1e6 * listen_s)
    wiring = Wiring(Health())
    full_since_us = math.inf
    while not survey.done:
        survey.advance(now_us())
        wait_s = (survey.deadline_us - now_us()) / 1e6
        while survey.outbox:
            if not _send(bus, survey.outbox[0]):
                wait_s = RETRY_S
                full_since_us = min(full_since_us, now_us())
                if now_us() - full_since_us > 1e6 * STUCK_S:
                    wiring.takes_frames = False
                    survey.give_up(now_us())
                break
            survey.sent(survey.outbox.popleft())
            full_since_us = math.inf
        message = _receive(bus, min(LONGEST_WAIT_S, max(0.0, wait_s)))
        if message is None:
            continue
        if message.is_error_frame:
            wiring.error_classes |= message.arbitration_id
            wiring.health.on_error_frame(message.arbitration_id, bytes(message.data))
        elif not (message.is_remote_frame or message.is_extended_id):
            survey.receive(Frame(message.arbitration_id, bytes(message.data)), now_us())
    return survey, wiring


def busy_bitrate(channel: str, bitrates: Sequence[int]) -> int | None:
    """The first bit rate at which an slcan adapter hears frames.

    The adapter only listens meanwhile (LAWICEL AB, CANUSB manual 1.0, command L): it neither sends
    nor acknowledges, so that a wrong bit rate disturbs nobody. BusError when it fails.
    """
    try:
        with SlcanBus(channel, bitrate=bitrates[0], listen_only=True) as bus:
            for bitrate in bitrates:
                bus.set_bitrate(bitrate)
                if _receive(bus, EACH_BITRATE_S) is not None:
                    return bitrate
    except (can.CanError, OSError) as error:
        raise BusError(f"can't listen on {channel}: {error}") from error
    return None


def _send(bus: can.BusABC, frame: Frame) -> bool:
    """False when the adapter takes nothing at the moment."""
    try:
        bus.send(can.Message(arbitration_id=frame.can_id, data=frame.data, is_extended_id=False))
    except can.CanOperationError as error:
        if queue_is_full(error):
            return False
        raise BusError(f"can't send on {bus.channel_info}: {error}") from error
    return True


def _receive(bus: can.BusABC, timeout_s: float) -> can.Message | None:
    try:
        return bus.recv(timeout_s)
    except (can.CanError, OSError) as error:
        raise BusError(f"can't receive from {bus.channel_info}: {error}") from error
