"""Random scenarios with troubles, a few of them; `make campaign` runs as many as wanted.

And whether they would notice: with each promise's own part of the driver taken out, a scenario that
runs through otherwise breaks that promise.
"""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from campaign import Action, Axis, Broken, Scenario, Trouble, broken, play, scenario_of, smallest

from epos2_ros.bus.cia402_node import Cia402Node
from epos2_ros.protocol import group, silence, watch
from epos2_ros.protocol.outputs import outputs
from epos2_ros.protocol.pvt import counted, path_audit
from epos2_ros.protocol.setpoints import audit as set_point_audit
from epos2_ros.protocol.setpoints import axis as set_point_axis
from epos2_ros.protocol.synchronous import SynchronousControlwords

SEEDS = range(16)
TWO = (Axis("epos2", 60.0, ""), Axis("epos2", -60.0, ""))
MIXED = (Axis("epos2", 60.0, ""), Axis("cl3e", 0.0, ""))  # one that has no clock to tell
FIRING = (Axis("epos2", 60.0, "", "interval"), Axis("copley", -60.0, "", "interval"))
ENABLE = Action("enable", 0.0)
MOVE = Action("move", 2.0, 0.6, 2.5)
SLOWLY = Action("move", 2.0, 0.3, 1.5)  # no drive complains by itself when a record is lost


@pytest.mark.parametrize("seed", SEEDS)
def test_what_the_driver_promises_holds_whatever_happens(seed):
    play(scenario_of(seed))


def test_the_same_seed_is_the_same_run():
    first, again = (play(scenario_of(7)) for _ in range(2))
    assert first.frames == again.frames
    assert [event.text for event in first.events] == [event.text for event in again.events]


# ---------------------------------------------------------------------------- drivers that break


def nothing(*args, **settings):
    return None


def no_audit(monkeypatch):
    monkeypatch.setattr(path_audit.PathAudit, "on_demand", lambda self, demand_qc, t_us: "")
    monkeypatch.setattr(path_audit.PathAudit, "on_sync", lambda self, t_us, starts: "")

    def believed(self, *args):
        self.reported = True
        return ""

    monkeypatch.setattr(counted.CountedRecords, "report", believed)


def no_look_at_set_points(monkeypatch):
    monkeypatch.setattr(set_point_audit.Audit, "on_sync", lambda self, within_ms: "")
    monkeypatch.setattr(set_point_axis.QueuedAxis, "_deadline_ms", math.inf)


def no_watch_for_silence(monkeypatch):
    no_look_at_set_points(monkeypatch)
    monkeypatch.setattr(silence.Silence, "silent", lambda self, drive: False)


def no_halt_of_the_others(monkeypatch):
    no_look_at_set_points(monkeypatch)
    monkeypatch.setattr(group.Group, "_trouble", nothing)
    monkeypatch.setattr(group.Group, "_watch_drives", nothing)


def no_take_back(monkeypatch):
    monkeypatch.setattr(SynchronousControlwords, "take_back", nothing)


def no_watch_of_the_host(monkeypatch):
    monkeypatch.setattr(Cia402Node, "watch_host", nothing)


def no_answers(monkeypatch):
    monkeypatch.setattr(group.Group, "_grant_requests", nothing)


def no_reasons(monkeypatch):
    monkeypatch.setattr(group.Group, "describe_phase", lambda self: "\n")


def says_off_and_is_not(monkeypatch):
    monkeypatch.setattr(group.Group, "_walk_on", lambda self: self._walked())


def forgets_to_raise(monkeypatch):
    monkeypatch.setattr(group.Group, "_finish_halt", lambda self: 1 / 0)


def does_not_let_go(monkeypatch):
    monkeypatch.setattr(Cia402Node, "leave", nothing)


def does_not_arm_anew(monkeypatch):
    """The outputs of a drive that comes back."""
    arm, armed = outputs.Outputs.arm, set()

    def once(self, axis, position_qc):
        writes = arm(self, axis, position_qc)
        anew = (self, axis) in armed
        armed.add((self, axis))
        return [] if anew else writes

    monkeypatch.setattr(outputs.Outputs, "arm", once)


def tells_half_of_the_events(monkeypatch):
    tell = outputs.Outputs._tell
    monkeypatch.setattr(outputs.Outputs, "_tell", lambda self, armed, events: tell(
        self, armed, list(events)[::2]
    ))


def arms_elsewhere(monkeypatch):
    arm = outputs.Outputs.arm
    monkeypatch.setattr(outputs.Outputs, "arm", lambda self, axis, position_qc: [
        replace(write, data=(int.from_bytes(write.data, "little") + 3).to_bytes(4, "little"))
        if (write.index, write.subindex) == (0x207A, 2) else write
        for write in arm(self, axis, position_qc)
    ])


def brings_nobody_back(monkeypatch):
    monkeypatch.setattr(watch.Watch, "lost", lambda self: [])


BROKEN_DRIVERS = {
    no_audit: (
        "on the path or stopping",
        Scenario(
            TWO, (ENABLE, SLOWLY), (Trouble("lose to drive", 1, 0.2, 1, 0x200),)
        ),
    ),
    no_watch_for_silence: (
        "one for all",
        Scenario(MIXED, (ENABLE, MOVE), (Trouble("power", 1, 0.2, 1, lasts_s=3.0),)),
    ),
    no_halt_of_the_others: (
        "one for all",
        Scenario(MIXED, (ENABLE, MOVE), (Trouble("power", 1, 0.2, 1, lasts_s=3.0),)),
    ),
    no_take_back: (
        "no fault without a cause",  # of the drive, which starts with an empty buffer
        Scenario(
            TWO,
            (ENABLE, replace(MOVE, name="move_later"), Action("stop", 0.395)),
            (),
        ),
    ),
    no_watch_of_the_host: (
        "the host may fail",
        Scenario(
            MIXED,
            (ENABLE, replace(MOVE, name="move_to", lasts_s=4.0), Action("enable", 1.0)),
            (),
            killed_s=1.5,
        ),
    ),
    does_not_arm_anew: (
        "what is reported is what has fired",
        Scenario(FIRING, (ENABLE, MOVE), (Trouble("power", 1, 0.2, 0, lasts_s=1.0),)),
    ),
    tells_half_of_the_events: (
        "what is reported is what has fired",
        Scenario(FIRING, (ENABLE, MOVE), ()),
    ),
    arms_elsewhere: ("outputs fire where they are to", Scenario(FIRING[:1], (ENABLE, MOVE), ())),
    does_not_let_go: ("a clean end", Scenario(MIXED, (ENABLE,), ())),
    brings_nobody_back: (
        "the way back",
        Scenario(MIXED, (ENABLE, MOVE), (Trouble("power", 1, 0.2, 1, lasts_s=3.0),)),
    ),
    no_answers: (
        "every request is answered",
        Scenario(TWO, (ENABLE, Action("disable", 2.0)), ()),
    ),
    no_reasons: ("every refusal has a reason", Scenario(TWO, (MOVE,), ())),
    says_off_and_is_not: (
        "no fault without a cause",  # which it finds by itself
        Scenario(TWO, (ENABLE,), ()),
    ),
    forgets_to_raise: (
        "no exception",
        Scenario(TWO, (ENABLE, MOVE, Action("halt", 1.0)), ()),
    ),
}


@pytest.mark.parametrize("take_out", BROKEN_DRIVERS, ids=lambda take_out: take_out.__name__)
def test_a_broken_driver_is_caught(take_out, monkeypatch):
    promise, scenario = BROKEN_DRIVERS[take_out]
    play(scenario)
    take_out(monkeypatch)
    with pytest.raises(Broken) as caught:
        play(scenario)
    assert caught.value.promise == promise, caught.value


def test_what_fails_is_made_small(monkeypatch):
    """What is left is what it takes: the move, the record, one axis."""
    scenario = Scenario(
        (*TWO, Axis("copley", 0.0, "")),
        (Action("halt", 0.0), ENABLE, SLOWLY),
        (Trouble("foreign", 1, 0.1, 0), Trouble("lose to drive", 2, 0.2, 1, 0x200, 1)),
    )
    no_audit(monkeypatch)
    found = broken(scenario)
    assert found is not None
    least = smallest(scenario, found.promise)
    assert [action.name for action in least.actions] == ["enable", "move"]
    assert [trouble.name for trouble in least.troubles] == ["lose to drive"]
    assert [axis.family for axis in least.axes] == ["epos2"]
