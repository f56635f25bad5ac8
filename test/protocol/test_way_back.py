"""The way back: whatever state drives are found in, a request brings them to a known one.

Every state below is tried with each maker's drive beside an EPOS2, and with each way back: a reset
of the fault, "enable" at once (and a reset when that is refused), a driver that is started anew.
Judged is what the simulated shafts do. The suite takes one way for each state; `--fuzz 3` all.
"""

from __future__ import annotations

from collections.abc import Callable

import pytest
from campaign import (
    KNOWN,
    QC_PER_RAD,
    RAMP_S,
    SILENCE_S,
    Action,
    Axis,
    Broken,
    Meddling,
    Scenario,
    Stage,
    Trouble,
    _expect,
    _home,
    _move,
    _move_to,
    _shaft_qc,
    _simulated_clock,
    play,
)

from epos2_ros.errors import DriveError, Epos2RosError
from epos2_ros.protocol.phase import Phase
from epos2_ros.sim.cl3e import Cl3e

TROUBLED = 0  # place of the drive
REST_QC = 8.0
MOVE = Action("move", 0.0, 0.4, 2.0)


def nmt(command: int, node: int = 1) -> Callable[[Stage], None]:
    def act(stage: Stage) -> None:
        stage.director.outbox.append((0, bytes((command, node))))
        stage.run(1.2)  # for a second somebody else is taken to be there still

    return act


def write(*accesses: tuple[int, int, int, int]) -> Callable[[Stage], None]:
    """By somebody's SDO: index, subindex, value, bytes; what a drive refuses stays as it is."""

    def act(stage: Stage) -> None:
        for index, subindex, value, size in accesses:
            head = bytes((0x23 | (4 - size) << 2, index & 0xFF, index >> 8, subindex))
            data = head + (value & (1 << 8 * size) - 1).to_bytes(size, "little").ljust(4, b"\0")
            stage.director.outbox.append((0x601, data))
            stage.run(0.005)
        stage.run(0.3)

    return act


def moves(stage: Stage) -> None:
    _move(stage, MOVE)
    stage.run(1.0)


def moves_to(stage: Stage) -> None:
    _move_to(stage, MOVE)
    stage.run(1.0)


def homes(stage: Stage) -> None:
    _home(stage, MOVE)
    stage.run(0.5)


def halts(stage: Stage) -> None:
    moves_to(stage)
    stage.group.halt()
    stage.run(0.03)


def stops(stage: Stage) -> None:
    moves_to(stage)
    stage.group.quick_stop()
    stage.run(0.03)


def fails(stage: Stage) -> None:
    drive = stage.drives[TROUBLED]
    drive.advance(stage.now_us)
    drive._on_communication_error(0x8130)
    drive._send_events()
    drive._arm()
    stage.bus._look_at(TROUBLED)
    stage.run(0.2)


def power_cycled(stage: Stage, heard: bool = True) -> None:
    drive = stage.drives[TROUBLED]
    drive.power_off()
    stage.run(0.05)
    if not heard:
        drive.disconnect()
    drive.power_on(stage.now_us)
    stage.run(1.5)
    drive.reconnect()
    stage.run(0.3)


def other_defaults(stage: Stage) -> None:
    """As somebody has stored them."""
    drive = stage.drives[TROUBLED]
    for key, value in {
        (0x6007, 0): 0, (0x1017, 0): 50, (0x1800, 2): 255, (0x1A00, 0): 0, (0x1400, 2): 1,
        (0x6060, 0): 1, (0x6065, 0): 7, (0x6081, 0): 3, (0x6085, 0): 10**9, (0x605A, 0): 0,
    }.items():  # fmt: skip
        if key in drive.dictionary:
            drive.dictionary[key].stored = value
    power_cycled(stage)


def silent_for_a_while(stage: Stage) -> None:
    stage.drives[TROUBLED].disconnect()
    stage.run(1.2)
    stage.drives[TROUBLED].reconnect()
    stage.run(0.2)


def half_configured(stage: Stage, nth: int = 25) -> None:
    """A bring-up that ended in the middle."""
    power_cycled(stage)
    wire = Stall(nth)
    stage.host_wire.work.append(wire)
    with pytest.raises(DriveError):
        stage.reset_fault()
    stage.host_wire.work.clear()
    stage.run(0.1)


class Stall(Meddling):
    """The first SDO answers get through, then none."""

    def __init__(self, nth: int) -> None:
        super().__init__("lose", frozenset(), 10**9, 0)
        self._nth = nth
        self.can_ids = self  # type: ignore[assignment]

    def __contains__(self, can_id: int) -> bool:
        self._nth -= can_id == 0x581
        return can_id == 0x581 and self._nth < 0


def one_after_another(*steps: Callable[[Stage], None]) -> Callable[[Stage], None]:
    def act(stage: Stage) -> None:
        for step in steps:
            step(stage)

    return act


STATES: dict[str, Callable[[Stage], None]] = {
    "enabled": lambda stage: stage.run(0.0),
    "following a path": moves,
    "moving to a position": moves_to,
    "homing": homes,
    "halting": halts,
    "in quick stop": stops,
    "in fault": fails,
    "failing in motion": one_after_another(moves_to, fails),
    "pre-operational": nmt(0x80),
    "pre-operational in motion": one_after_another(moves_to, nmt(0x80)),
    "all stopped by NMT in motion": one_after_another(moves_to, nmt(0x02, 0)),
    "communication reset": nmt(0x82),
    "node reset in motion": one_after_another(moves, nmt(0x81)),
    "power-cycled": power_cycled,
    "power-cycled unheard": lambda stage: power_cycled(stage, heard=False),
    "other defaults": other_defaults,
    "silent for a while": silent_for_a_while,
    "half-configured": half_configured,
    "switched off by somebody": write((0x6040, 0, 0x06, 2)),
    "quick-stopped by somebody": write((0x6040, 0, 0x02, 2)),
    "in another mode": write((0x6060, 0, 1, 1), (0x6060, 0, 6, 1)),
    "mapped otherwise": write((0x1801, 1, 0xC0000281, 4), (0x1A01, 0, 0, 1)),
}


def reset(stage: Stage) -> Stage:
    stage.reset_fault()
    return stage


def enable(stage: Stage) -> Stage:
    answer = stage.group.enable()
    stage.run(10.0, answer.done)
    error = answer.exception()
    assert error is None or (str(error).strip() and "\n" not in str(error))
    return stage


def restart(stage: Stage) -> Stage:
    """The old driver is gone without a word."""
    stage.director._agenda.clear()
    again = Stage(stage.scenario, stage)
    again.watch.allow(again.now_us + (SILENCE_S + RAMP_S) * 1e6)
    again.bring_up()
    return again


WAYS = [reset, enable, restart]


def rest(stage: Stage) -> list[float]:
    """Where the shafts come to rest."""
    for _ in range(60):
        before = [_shaft_qc(drive) for drive in stage.drives]
        stage.run(0.05)
        after = [_shaft_qc(drive) for drive in stage.drives]
        if all(abs(a - b) < 0.5 for a, b in zip(before, after, strict=True)):
            return after
    raise AssertionError("the axes do not come to rest")


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("family", ["epos2", "copley", "cl3e"])
def test_from_any_state_a_request_leads_back(family: str, state: str, fuzz: int) -> None:
    number = list(STATES).index(state) + len(family)
    for way in WAYS if fuzz > 1 else [WAYS[number % 3]]:
        axes = (Axis(family, 80.0, "index_positive"), Axis("epos2", -80.0, ""))
        stage = Stage(Scenario(axes, (), (), seed=number))
        with _simulated_clock(stage):
            stage.bus.run_until(400e3, lambda *frame: None)
            stage.bring_up()
            _expect(stage, "enable", stage.group.enable())
            stage.run(0.5)
            STATES[state](stage)
            comes_back(stage, way)


def comes_back(stage: Stage, way: Callable[[Stage], Stage], again: bool = True) -> None:
    """What nobody could know of may come out with the next motion, in words; then it is gone."""
    try:
        stage = way(stage)
        stage.run(5.0, lambda: stage.group.phase in KNOWN)
        begun_at = rest(stage)
        _expect(stage, "reset", stage.reset_fault())
        _expect(stage, "enable", stage.group.enable())
        stage.run(0.3)
        stands_at = rest(stage)
        assert stage.group.phase is Phase.STANDING
        for drive, a, b in zip(stage.drives, begun_at, stands_at, strict=True):
            assert drive.state.name == "OPERATION_ENABLED"
            assert abs(a - b) <= REST_QC, "it has moved without having been told to"
        for place, drive in enumerate(stage.machine.drives):
            assert drive.standing_qc == pytest.approx(_shaft_qc(stage.drives[place]), abs=REST_QC)
        ends = [drive.standing_qc + round(0.05 * QC_PER_RAD) for drive in stage.machine.drives]
        _expect(stage, "move_to", _move_to(stage, Action("move_to", 0.0, 0.05, 0.6)))
        for place, end in enumerate(ends):
            assert _shaft_qc(stage.drives[place]) == pytest.approx(end, abs=REST_QC)
        _expect(stage, "move", _move(stage, Action("move", 0.0, -0.05, 0.6)))
    except (Broken, Epos2RosError) as error:
        if not again or (isinstance(error, Broken) and error.promise != "the way back"):
            raise
        assert stage.group.reason.strip() and "\n" not in stage.group.reason
        comes_back(stage, reset, again=False)


@pytest.mark.parametrize("family", ["epos2", "copley", "cl3e"])
def test_the_first_reset_does_where_nothing_but_a_fault_is_in_the_way(family: str) -> None:
    """One that a Copley drive latches stays until it is told that it may go (0x2183)."""
    emergency = Trouble("emergency", 0, 0.0, 0)
    for action in (Action("enable", 0.0), MOVE):
        stage = Stage(Scenario((Axis(family, 0.0, ""),), (action,), (emergency,)))
        with _simulated_clock(stage):
            stage.bus.run_until(400e3, lambda *frame: None)
            stage.bring_up()
            _expect(stage, "enable", stage.group.enable())
            if action is MOVE:
                moves_to(stage)
            stage.trouble(emergency)(stage.now_us)
            stage.run(1.5)
            assert stage.group.phase is Phase.FAULT
            _expect(stage, "reset_fault", stage.reset_fault())
            _expect(stage, "enable", stage.group.enable())


def test_nobody_else_is_suspected_of_what_the_driver_does_itself() -> None:
    """A bring-up takes a drive out of NMT operational; here for long, as its answers are late, and
    asked for while the axes are still halting."""
    names = ("reset_fault", 1.823), ("move_to", 0.396), ("stream", 1.463), ("reset_fault", 0.02)
    scenario = Scenario(
        (Axis("copley", -104.8, "index_positive"), Axis("epos2", 51.0, "here")),
        (Action("enable", 0.3), *(Action(name, after_s, -0.28, 1.57) for name, after_s in names)),
        (Trouble("late SDO", 2, 0.678, 1, lasts_s=0.3),),
        sync_period=0.2,
        bitrate=500_000,
        killed_s=1.5,
        busy_us=5000.0,
        seed=398254545,
    )
    stage = play(scenario)
    said = [event.text for event in stage.events]
    assert any("come late" in text for text in said)
    assert not any("somebody else" in text for text in said), said


def test_an_unheard_power_cycle_takes_the_reference() -> None:
    for family in ("epos2", "cl3e"):
        axes = (Axis(family, 0.0, "index_positive"),)
        stage = Stage(Scenario(axes, (), ()))
        with _simulated_clock(stage):
            stage.bus.run_until(400e3, lambda *frame: None)
            stage.bring_up()
            if family == "cl3e":
                stage.machine.drives[0].homed = "index_positive"
                assert isinstance(stage.drives[0], Cl3e)
            else:
                _expect(stage, "enable", stage.group.enable())
                _expect(stage, "home", _home(stage, MOVE))
            assert stage.machine.drives[0].homed
            power_cycled(stage, heard=False)
            _expect(stage, "reset", stage.reset_fault())
            assert not stage.machine.drives[0].homed
