"""The phases of a group of axes, and from which it goes into which.

`STEPS` is what docs/architecture.md draws and what every run in the tests is held to.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum

from epos2_ros.protocol.cia402 import State


class Phase(Enum):
    """What the group is doing."""

    __hash__ = object.__hash__  # looked up for every frame

    DISABLED = "disabled"
    ENABLING = "enabling"
    READYING = "getting ready"
    SETTLING = "reading the position demand"
    STANDING = "standing"
    SWITCHING = "changing the mode of operation"
    PREPARING = "preparing the drives"
    ARMING = "arming the start"
    STARTING = "starting"
    MOVING = "moving"
    CANCELLING = "taking back the start"
    HALTING = "halting"
    QUICK_STOPPING = "quick stop"
    DISABLING = "disabling"
    RESETTING = "resetting faults"
    FAULT = "fault"


NOT_BEGUN = frozenset({Phase.SWITCHING, Phase.PREPARING, Phase.ARMING})
BEGUN = frozenset({Phase.STARTING, Phase.MOVING})
IN_MOTION = NOT_BEGUN | BEGUN
BRAKING = frozenset({Phase.HALTING, Phase.QUICK_STOPPING})
GETTING_ENABLED = frozenset(
    {Phase.ENABLING, Phase.READYING, Phase.SETTLING, Phase.CANCELLING, Phase.STANDING} | IN_MOTION
)
ENABLED = GETTING_ENABLED - {Phase.ENABLING}
WALK_TARGET = {
    Phase.ENABLING: State.OPERATION_ENABLED,
    Phase.DISABLING: State.READY_TO_SWITCH_ON,
    Phase.RESETTING: State.SWITCH_ON_DISABLED,
}

FROM_ANYWHERE: Mapping[Phase, str] = {
    Phase.QUICK_STOPPING: "quick stop, where drives are on",
    Phase.FAULT: "trouble, where no axis moves",
}
STEPS: Mapping[Phase, Mapping[Phase, str]] = {
    Phase.DISABLED: {Phase.ENABLING: "enable", Phase.DISABLING: "disable"},
    Phase.ENABLING: {Phase.READYING: "operation enabled", Phase.DISABLING: "disable"},
    Phase.READYING: {
        Phase.SETTLING: "mode set, buffers empty",
        Phase.STANDING: "nothing has moved",
        Phase.DISABLING: "disable",
    },
    Phase.SETTLING: {
        Phase.STANDING: "every drive has answered a SYNC",
        Phase.DISABLING: "disable",
    },
    Phase.STANDING: {
        Phase.SWITCHING: "a motion",
        Phase.HALTING: "trouble",
        Phase.DISABLING: "disable",
    },
    Phase.SWITCHING: {
        Phase.PREPARING: "0x6061",
        Phase.CANCELLING: "stopped or replaced",
        Phase.HALTING: "trouble",
        Phase.DISABLING: "disable",
    },
    Phase.PREPARING: {
        Phase.ARMING: "all is in the drives, as they say",
        Phase.CANCELLING: "stopped or replaced",
        Phase.HALTING: "trouble",
        Phase.DISABLING: "disable",
    },
    Phase.ARMING: {
        Phase.STARTING: "controlwords seen on the bus, SYNC sent",
        Phase.CANCELLING: "stopped or replaced",
        Phase.HALTING: "trouble",
        Phase.DISABLING: "disable",
    },
    Phase.STARTING: {
        Phase.MOVING: "every drive has started",
        Phase.HALTING: "halt, or trouble",
    },
    Phase.MOVING: {
        Phase.STANDING: "arrived, in the mode in which it stands",
        Phase.READYING: "arrived, in another mode",
        Phase.HALTING: "halt, or trouble",
    },
    Phase.CANCELLING: {
        Phase.READYING: "taken back in every drive",
        Phase.HALTING: "SYNC came first",
        Phase.DISABLING: "disable",
    },
    Phase.HALTING: {
        Phase.READYING: "on request, all stand",
        Phase.HALTING: "stopped by another master: halted once more",
    },
    Phase.QUICK_STOPPING: {Phase.DISABLED: "all stand"},
    Phase.DISABLING: {Phase.DISABLED: "all are off"},
    Phase.RESETTING: {
        Phase.DISABLED: "no drive is in fault",
        Phase.DISABLING: "disable",
    },
    Phase.FAULT: {Phase.RESETTING: "reset fault", Phase.DISABLING: "disable"},
}

HALTED, QUICK_STOPPED = "halted on request", "quick stop on request"
ON_REQUEST = (HALTED, QUICK_STOPPED)  # reasons that are no fault


def follows(before: Phase, after: Phase) -> bool:
    """Whether a group may go from one phase into the other."""
    return after in STEPS[before] or after in FROM_ANYWHERE


class End(Enum):
    """How a motion ended that was not aborted."""

    ARRIVED = "all axes have arrived"
    STOPPED = "stopped on the path"
