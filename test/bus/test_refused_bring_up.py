"""Bring-up that fails: any access refused with any abort code, or never answered.

Each run is a bring-up in simulated time of a drive, of any maker, that refuses its n-th access. The
campaign has as many runs as the drive has accesses times the abort codes there are; here each
access meets some codes, and with REFUSALS=all in the environment each meets all. What the line says
is held against what the drive saw, and against the words of CiA 301, 7.2.4.3.17, typed here.
"""

from __future__ import annotations

import os
import re
import struct
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import count

import can
import pytest
from simulated_time import Bench, axes

from epos2_ros.bus.driver import Driver
from epos2_ros.configuration.driver import DriverConfig
from epos2_ros.errors import DriveError
from epos2_ros.sim.cl3e import Cl3e
from epos2_ros.sim.copley import Copley
from epos2_ros.sim.epos2 import Epos2
from epos2_ros.sim.realtime import RealtimeSimulator, now_us

WORDS = {
    0x05030000: "toggle bit",
    0x05040000: "took too long",
    0x05040001: "unknown command",
    0x05040005: "out of memory",
    0x06010000: "can't be accessed",
    0x06010001: "only be written",
    0x06010002: "only be read",
    0x06020000: "no such object",
    0x06040041: "can't be mapped",
    0x06040042: "too many or too long for a PDO",
    0x06040043: "don't go together",
    0x06040047: "incompatible",
    0x06060000: "hardware error",
    0x06070010: "another length",
    0x06070012: "too long",
    0x06070013: "too short",
    0x06090011: "no such sub-index",
    0x06090030: "out of range",
    0x06090031: "too high",
    0x06090032: "too low",
    0x06090036: "maximum is below the minimum",
    0x060A0023: "no resources",
    0x08000000: "general error",
    0x08000020: "can't be transferred or stored",
    0x08000021: "something else has the control",
    0x08000022: "not in the state",
    0x08000023: "no object dictionary",
    0x08000024: "no data",
    0x0F00FFC0: "NMT state",
    0xDEADBEEF: "no document",
}
ABSENT = (0x06020000, 0x06090011)
# Not missed where they are absent.
OPTIONAL = {
    "epos2": {(0x6007, 0), (0x2003, 1)},
    "copley": {(index, n) for index in (0x608F, 0x6091, 0x6092) for n in (1, 2)},
    "cl3e": {(0x60A8, 0), (0x60F2, 0), (0x60A9, 0)},
}
ALL = os.environ.get("REFUSALS") == "all"
CODES_PER_ACCESS = len(WORDS) if ALL else 1
RETRIES = 3  # of an access that is not answered
LIMIT_S = 20.0  # of one drive, as the driver states it
SDO_REQUEST, SDO_ANSWER = 0x600, 0x580


Meet = Callable[[bytes], bytes | None]


class Refuses:
    """A drive whose n-th access (from 0) is met by `meet(request)`: an answer, or None: silence."""

    node_id: int
    _send: Callable[[int, bytes], None]

    def __init__(self, node_id: int, nth: float, meet: Meet, **settings: object) -> None:
        self.accesses: list[bytes] = []
        self.met: bytes | None = None
        self._nth, self._meet = nth, meet
        super().__init__(node_id, **settings)  # type: ignore[call-arg]

    def _on_sdo(self, data: bytes) -> None:
        if data[0] >> 5 in (1, 2):  # initiate download, upload (CiA 301, 7.2.4.3)
            self.accesses.append(data)
            if len(self.accesses) - 1 == self._nth:
                self.met = data
        if data != self.met:
            super()._on_sdo(data)  # type: ignore[misc]
        elif (answer := self._meet(data)) is not None:
            self._send(SDO_ANSWER + self.node_id, answer)


class Refusing(Refuses, Epos2): ...


class RefusingCopley(Refuses, Copley): ...


class RefusingCl3e(Refuses, Cl3e): ...


KINDS = {"epos2": Refusing, "copley": RefusingCopley, "cl3e": RefusingCl3e}


def refuse(code: int) -> Callable[[bytes], bytes]:
    return lambda request: b"\x80" + request[1:4] + code.to_bytes(4, "little")


def config_of(family: str) -> DriverConfig:
    limits = {"max_velocity": 2.0, "max_acceleration": 4.0, "stop_deceleration": 8.0}
    return DriverConfig(axes=axes(2, drive=family, min_position=-1.0, **limits)[1:])


CONFIG = config_of("epos2")


def bring_up(drive: Epos2 | Copley | Cl3e) -> str:
    """What is wrong with it, or ""."""
    family = next(name for name, kind in KINDS.items() if isinstance(drive, kind))
    made = Bench(config_of(family), [drive], bring_up=False)  # type: ignore[list-item]
    made.bus.run_until(400e3, lambda *frame: None)  # it has booted
    begun_us = made.now_us
    try:
        made.bring_up()
    except DriveError as error:
        return str(error)
    finally:
        assert made.now_us - begun_us < LIMIT_S * 1e6
    return ""


def assert_says_what_was_attempted(line: str, request: bytes) -> None:
    """Joint, node, the object by number and name, the value or the PDO."""
    index, subindex = struct.unpack_from("<HB", request, 1)
    assert "\n" not in line
    assert line.startswith("joint_2 (node 2)")
    assert "; check " in line or "; close " in line or "; switch " in line, line
    assert f"(0x{index:04X}-{subindex:02X})" in line
    if 0x1400 <= index <= 0x1BFF:
        kind, number = "TPDO" if index & 0x800 else "RPDO", (index & 0xFF) + 1
        assert re.search(rf"\b{kind}{number}\b", line), line
        assert re.search(r"can't (read the COB-ID|switch|set|clear|map|close) ", line), line
    if 0x1600 <= index <= 0x17FF or 0x1A00 <= index <= 0x1BFF:
        mapped = int.from_bytes(request[4:], "little")
        if subindex and request[0] >> 5 == 1:  # the object that was to be mapped, by name
            assert re.search(rf"map [^;]*\(0x{mapped >> 16:04X}-{mapped >> 8 & 0xFF:02X}\)", line)
    elif request[0] >> 5 == 2:
        assert "can't read " in line
    elif index >= 0x2000 or index < 0x1400:
        assert re.search(r"can't (set .* to -?\d+|let it (watch|be)|reset|disable)", line), line


def cases(family: str) -> Iterator[tuple[int, int]]:
    """Accesses of a bring-up that nothing is wrong with, and codes."""
    drive = KINDS[family](2, float("inf"), lambda request: None)
    assert bring_up(drive) == ""
    codes = list(WORDS)
    for nth in range(len(drive.accesses)):
        for turn in range(CODES_PER_ACCESS):
            yield nth, codes[(nth + turn) % len(codes)]


@pytest.mark.timeout(1800)
@pytest.mark.parametrize("family", KINDS)
def test_any_access_refused_with_any_code(
    family: str, record_property: Callable[..., None]
) -> None:
    runs = 0
    for nth, code in cases(family):
        drive = KINDS[family](2, nth, refuse(code))
        line = bring_up(drive)
        assert drive.met is not None
        key = struct.unpack_from("<HB", drive.met, 1)
        runs += 1
        if key in OPTIONAL[family] and code in ABSENT and drive.met[0] >> 5 == 2:  # looked for
            assert line == ""
            continue
        assert_says_what_was_attempted(line, drive.met)
        assert f"(0x{code:08X})" in line
        assert WORDS[code] in line
        of_ours = key in ((0x2300, 0), (0x100C, 0), (0x1016, 1), (0x60C0, 0)) or key[0] < 0x1C00
        assert not (of_ours and "parameters of axes" in line), line  # it comes from none
    record_property("runs", runs)
    assert runs >= 60 * CODES_PER_ACCESS


@pytest.mark.parametrize("nth", range(0, 95, 1 if ALL else 19))
@pytest.mark.parametrize("family", KINDS)
def test_an_access_that_is_never_answered(family: str, nth: int) -> None:
    drive = KINDS[family](2, nth, lambda request: None)
    line = bring_up(drive)
    if drive.met is None:
        assert nth >= len(drive.accesses)
        return
    assert drive.accesses.count(drive.met) <= RETRIES * 2 + 1
    if nth == 0:
        assert line.startswith("no answer from joint_2 (node 2): check power, wiring, termination")
    else:
        assert_says_what_was_attempted(line, drive.met)
        assert "no answer" in line


@pytest.mark.parametrize("nth", [0, 1, 5, 30, 60])
def test_a_drive_that_falls_silent(nth: int) -> None:
    """From its n-th access on nothing more comes."""

    class Silent(Refusing):
        def _on_sdo(self, data: bytes) -> None:
            if len(self.accesses) <= nth:
                super()._on_sdo(data)

    line = bring_up(Silent(2, nth, lambda request: None))
    assert "no answer" in line
    assert "joint_2 (node 2)" in line


def objects_of(drive: Epos2 | Copley | Cl3e) -> dict[tuple[int, int], int]:
    """What it was told: its parameters, but for what time and the host's commands make of them."""
    states = (0x1003, 0x6040)
    return {
        key: entry.value
        for key, entry in drive.dictionary.items()
        if entry.access in ("rw", "rww") and entry.read is None and key[0] not in states
    }


def restarting(family: str, nth: int) -> Epos2 | Copley | Cl3e:
    """Once, and does not answer then."""

    def restart(request: bytes) -> None:
        drive.met = None
        drive.power_off()
        drive.power_on(drive.now_us)

    drive = KINDS[family](2, nth, restart)
    return drive


@pytest.mark.parametrize("family", KINDS)
def test_a_drive_that_restarts_meanwhile_is_not_taken_for_set_up(family: str) -> None:
    """At any access: it is set up as it is without that, or refused with what has happened."""
    whole = KINDS[family](2, float("inf"), lambda request: None)
    assert bring_up(whole) == ""
    last, lines = len(whole.accesses) - 1, []
    for nth in sorted({*range(0, last, 1 if ALL else 9), last - 3, last - 2, last - 1, last}):
        drive = restarting(family, nth)
        lines.append(bring_up(drive))
        if lines[-1] == "":
            assert objects_of(drive) == objects_of(whole), nth
        elif "has restarted" not in lines[-1]:  # between what it has to keep and the look at that
            assert re.match(r"joint_2 \(node 2\) does not keep .* its power supply", lines[-1])
    assert any("has restarted while it was being set up: check " in line for line in lines)


@pytest.mark.parametrize("meet", ["short", "other", "long"])
def test_answers_that_are_none(meet: str) -> None:
    """Too short, of another object, a value of another length."""
    answers: dict[str, Callable[[bytes], bytes]] = {
        "short": lambda request: b"\x60" + request[1:4],
        "other": lambda request: b"\x60" + b"\x41\x60\x00" + bytes(4),
        "long": lambda request: b"\x4f" + request[1:4] + bytes(4),
    }
    for nth in (2, 12, 40):
        line = bring_up(Refusing(2, nth, answers[meet]))
        assert line == "" or line.startswith("joint_2 (node 2): can't "), line


# --- the bus is closed in the end ---------------------------------------------------------------

_channel = count()


@pytest.mark.parametrize("silent", [False, True])
@pytest.mark.parametrize("nth", [0, 3, 25, 61])
def test_the_bus_is_closed_in_the_end(nth: int, silent: bool) -> None:
    """In real time, with threads: soon after, nobody sends, and no thread is left."""
    channel = f"refused {next(_channel)}"
    meet = (lambda request: None) if silent else refuse(0x08000021)
    drive = Refusing(2, nth, meet, t_us=now_us())
    before = set(threading.enumerate())
    with can.Bus(interface="virtual", channel=channel) as bus:
        simulator = RealtimeSimulator(bus, [drive])
        simulator.start()
        config = replace(CONFIG, channel=channel, simulate=False, realtime_priority=0)
        begun_s = time.monotonic()
        try:
            with pytest.raises(DriveError, match=r"joint_2 \(node 2\)"):
                Driver(config).configure()
            assert time.monotonic() - begun_s < 8.0
        finally:
            simulator.stop()
        while bus.recv(0.0) is not None:
            pass
        assert bus.recv(0.3) is None  # the host's heartbeat comes every 0.1 s
    assert {t.name for t in set(threading.enumerate()) - before if t.is_alive()} == set()
