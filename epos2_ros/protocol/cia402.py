"""The power drive state machine of CiA 402: what a statusword says, which controlword comes next.

The rules this file keeps:

* A state is read from the statusword alone (CiA 402-2, "Statusword", bits 0–3, 5 and 6).
* `step` gives the one controlword that brings a drive a transition nearer to the target; the
  caller sends it, waits for the statusword to change and asks again, so the walk starts from
  any state it finds.
* A fault is left only where the caller allows it: a reset is somebody's decision.
"""

from __future__ import annotations

from enum import Enum

# Controlword 0x6040, bits shared by all modes.
SHUTDOWN = 0x0006
SWITCH_ON = 0x0007
ENABLE_OPERATION = 0x000F  # from "ready to switch on" it takes transitions 3 and 4 in one
DISABLE_VOLTAGE = 0x0000
QUICK_STOP = 0x0002
FAULT_RESET = 0x0080  # on the rising edge of bit 7
HALT = 0x0100

# Statusword 0x6041, bits shared by all modes.
FAULT_BIT = 0x0008
TARGET_REACHED = 0x0400
INTERNAL_LIMIT = 0x0800
OPERATION_MODE_SPECIFIC = 0x1000  # bit 12: ip mode active, set-point acknowledged, homing attained

# Profile position mode (CiA 402-2): of the controlword, and of the statusword.
NEW_SETPOINT = 0x0010
CHANGE_IMMEDIATELY = 0x0020
CHANGE_ON_SETPOINT = 0x0200
SETPOINT_ACKNOWLEDGED = OPERATION_MODE_SPECIFIC
TRAPEZOIDAL, JERK_LIMITED = 0, 3  # motion profile type (0x6086)


class State(Enum):
    """States of the power drive system, by the names of CiA 402."""

    NOT_READY_TO_SWITCH_ON = "not ready to switch on"
    SWITCH_ON_DISABLED = "switch on disabled"
    READY_TO_SWITCH_ON = "ready to switch on"
    SWITCHED_ON = "switched on"
    OPERATION_ENABLED = "operation enabled"
    QUICK_STOP_ACTIVE = "quick stop active"
    FAULT_REACTION_ACTIVE = "fault reaction active"
    FAULT = "fault"


_STATES = (
    (0x4F, 0x00, State.NOT_READY_TO_SWITCH_ON),
    (0x4F, 0x40, State.SWITCH_ON_DISABLED),
    (0x6F, 0x21, State.READY_TO_SWITCH_ON),
    (0x6F, 0x23, State.SWITCHED_ON),
    (0x6F, 0x27, State.OPERATION_ENABLED),
    (0x6F, 0x07, State.QUICK_STOP_ACTIVE),
    (0x4F, 0x0F, State.FAULT_REACTION_ACTIVE),
    (0x4F, 0x08, State.FAULT),
)


def state_of(statusword: int) -> State:
    """The state a statusword names; one that names none is a drive not ready to switch on."""
    for mask, value, state in _STATES:
        if statusword & mask == value:
            return state
    return State.NOT_READY_TO_SWITCH_ON


_TO_OPERATION_ENABLED = {
    State.SWITCH_ON_DISABLED: SHUTDOWN,
    State.READY_TO_SWITCH_ON: ENABLE_OPERATION,
    State.SWITCHED_ON: ENABLE_OPERATION,
    State.QUICK_STOP_ACTIVE: DISABLE_VOLTAGE,
}
_TO_READY_TO_SWITCH_ON = {
    State.SWITCH_ON_DISABLED: SHUTDOWN,
    State.SWITCHED_ON: SHUTDOWN,
    State.OPERATION_ENABLED: SHUTDOWN,
    State.QUICK_STOP_ACTIVE: DISABLE_VOLTAGE,
}
_TO_SWITCH_ON_DISABLED = {
    State.READY_TO_SWITCH_ON: DISABLE_VOLTAGE,
    State.SWITCHED_ON: DISABLE_VOLTAGE,
    State.OPERATION_ENABLED: DISABLE_VOLTAGE,
    State.QUICK_STOP_ACTIVE: DISABLE_VOLTAGE,
    State.FAULT: FAULT_RESET,
}
WALKS = {
    State.OPERATION_ENABLED: _TO_OPERATION_ENABLED,
    State.READY_TO_SWITCH_ON: _TO_READY_TO_SWITCH_ON,
    State.SWITCH_ON_DISABLED: _TO_SWITCH_ON_DISABLED,
}


def step(state: State, target: State) -> int | None:
    """The controlword of the next transition on the way from `state` to `target`.

    None where there is nothing to send: the target is reached, or the drive is on its own way
    (start-up, fault reaction), or a fault stands between (only SWITCH_ON_DISABLED resets it).
    """
    return WALKS[target].get(state)
