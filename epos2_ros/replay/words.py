"""Numbers of CANopen and CiA 402 in words."""

from __future__ import annotations

import canopen

from epos2_ros.protocol import cia402, epos2

_NMT_COMMANDS = {
    0x01: "start",
    0x02: "stop",
    0x80: "enter pre-operational",
    0x81: "reset node",
    0x82: "reset communication",
}
_NMT_STATES = {0: "boot-up", 4: "stopped", 5: "operational", 127: "pre-operational"}
_CONTROLS = (  # CiA 402-2, table of the controlword: mask, value, command
    (0x80, 0x80, "fault reset"),
    (0x02, 0x00, "disable voltage"),
    (0x06, 0x02, "quick stop"),
    (0x0F, 0x0F, "enable operation"),
    (0x0F, 0x07, "switch on"),
    (0x07, 0x06, "shutdown"),
)

_BIT_4 = {1: "new set-point", 6: "start homing", 7: "enable ip mode"}
_BIT_12 = {
    1: ("takes another set-point", "set-point acknowledged"),
    6: ("homing not attained", "homing attained"),
    7: ("ip mode no longer active", "ip mode active"),
}


def nmt_command(command: int) -> str:
    """CiA 301, 7.2.8.3."""
    return _NMT_COMMANDS.get(command, f"unknown command {command:02X}h")


def nmt_state(state: int) -> str:
    """The state that a heartbeat names."""
    return _NMT_STATES.get(state, f"unknown state {state}")


def controlword(value: int, mode: int | None = None) -> str:
    """A controlword as a command; what bit 4 means goes by the mode of operation."""
    command = next((text for mask, bits, text in _CONTROLS if value & mask == bits), "nothing")
    if value & epos2.ENABLE_IP_MODE:
        command += f" + {_BIT_4.get(mode or 0, 'bit 4')}"
    if value & cia402.HALT:
        command += " + halt"
    return f"{value:04X}h, {command}"


def bit_12(mode: int | None, rises: bool) -> str:
    """What a change of this bit of the statusword says in a mode of operation."""
    falling, rising = _BIT_12.get(mode or 0, ("statusword bit 12 cleared", "statusword bit 12 set"))
    return rising if rises else falling


def abort_code(code: int) -> str:
    """CiA 301, table of SDO abort codes."""
    meaning = canopen.SdoAbortedError.CODES.get(code, "no code of CiA 301")
    return f"code {code:08X}h: {meaning}"


def emergency(code: int, register: int, more: bytes) -> str:
    """An emergency, with what it brings along."""
    if code == 0:
        return "emergency: error reset (0x0000)"
    rest = f", {more.hex(' ')}" if any(more) else ""
    what = epos2.FAMILY.describe_emergency(code)
    return f"emergency: {what}, error register {register:02X}h{rest}"


def buffer_flags(word: int) -> list[str]:
    """Names of the bits that are set in 0x20C4-01."""
    return [name.replace("_", " ") for name, bit in epos2.BufferStatus.FLAGS.items() if word & bit]
