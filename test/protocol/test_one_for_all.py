"""Whatever happens to one axis: how soon the others begin to stop, and what is said of it.

The bounds are those of docs/architecture.md: a fault, an off clock or path within two SYNC periods,
silence within half a second, each and then the ramp.
"""

from __future__ import annotations

import math
import random
import re

import pytest
from campaign import Action, Axis, Scenario, Trouble, play
from simulated_time import SDO_PATIENCE_US, Bench, axes
from six_axes import all_stand, bench, there_and_back

from epos2_ros.configuration.driver import DriverConfig
from epos2_ros.errors import MotionAborted
from epos2_ros.protocol.phase import Phase
from epos2_ros.sim.epos2 import Dictionary, Epos2

HALT = b"\x1f\x01"
NODES = range(1, 7)
BOOT_US = 262_000.0  # from reset to boot-up, in a trace of a real one


def moving(after_s: float, made: Bench | None = None) -> Bench:
    made = made or bench()
    trajectory = there_and_back(8.0, joints=len(made.drives))
    made.path.submit(trajectory, None, made.now_us)
    made.motion = made.group.motion
    made.run(after_s)
    made.frames.clear()
    return made


def halted_us(made: Bench, but: int) -> float:
    """When the last of the others was told to halt."""
    halts: dict[int, float] = {}
    for t_us, frame, echo in made.frames:
        if echo and frame.data == HALT:
            halts.setdefault(frame.can_id - 0x500, t_us)
    assert halts.keys() >= set(NODES) - {but}
    return max(t_us for node, t_us in halts.items() if node != but)


def reason_of(made: Bench) -> str:
    with pytest.raises(MotionAborted) as caught:
        made.wait(made.motion)
    assert made.group.phase is Phase.FAULT
    said = [event.text for event in made.events if event.kind == "fault"]
    assert said[-1] == str(caught.value) == made.group.reason
    return str(caught.value)


@pytest.mark.parametrize("lasts_s", [0.45, 0.55, 1.0, 3.0])
@pytest.mark.parametrize("at_s", [0.3, 0.35, 0.41, 0.47])
def test_no_drive_is_called_silent_for_a_host_that_did_not_ask_it(at_s, lasts_s):
    """Two of these drives speak when asked only; the EPOS2 sends its heartbeat meanwhile."""
    axes = Axis("epos2", 60.0, ""), Axis("copley", -60.0, ""), Axis("cl3e", 0.0, "")
    stall = Trouble("stall", 0, at_s, 0, lasts_s=lasts_s)
    stage = play(Scenario(axes, (Action("enable", 2.0),), (stall,)))
    said = [event.text for event in stage.events if event.kind == "fault"]
    assert not any("silent" in text for text in said), said
    assert lasts_s < 0.5 or any("the host was not heard" in text for text in said)


@pytest.mark.parametrize("after_s", [1.0, 1.05, 1.111, 1.199, 2.5])
def test_silence_stops_the_others_within_half_a_second(after_s):
    made = moving(after_s)
    silent_us = made.now_us
    made.drives[4].disconnect()
    made.run(0.6)
    assert halted_us(made, but=5) - silent_us <= 500e3
    reason = reason_of(made)
    assert reason.startswith("joint_5 (node 5) is silent: check its power and the bus, ")
    assert reason.endswith(" s into the motion")
    assert after_s < float(reason.split()[-5]) <= after_s + 0.55
    assert all_stand(made)


class StoppedHost(Bench):
    """Hears nothing for `nap_us`, then all at once, what has been due first."""

    wakes_us = -math.inf
    room = 10_000  # frames that are kept for it meanwhile

    def nap(self, seconds: float) -> None:
        self._unheard: list[tuple[int, bytes, float, bool]] = []
        self.wakes_us = self.now_us + seconds * 1e6
        self.late_us = lambda: max(0.0, self.wakes_us - self.now_us)
        self.run(seconds)
        super()._step()
        for frame in self._unheard[: self.room]:
            super()._on_frame(*frame)

    def _on_frame(self, can_id, data, t_us, echo):
        if self.now_us >= self.wakes_us:
            return super()._on_frame(can_id, data, t_us, echo)
        self._unheard.append((can_id, data, t_us, echo))
        return False

    def _step(self):
        if self.now_us >= self.wakes_us:
            super()._step()


class Patient(Epos2):
    """Does not watch its host."""

    def _on_heartbeat(self, node, time_ms, data):
        pass


@pytest.mark.parametrize("room", [10_000, 25])
@pytest.mark.parametrize("stamped", [True, False])
def test_a_host_that_did_not_listen_holds_that_against_no_drive(stamped, room):
    """It may have missed what came, too, as when a socket's buffer is full."""
    made = StoppedHost(drives=[Patient(n) for n in NODES])
    made.room = room
    if not stamped:
        made.stamp_us = lambda t_us: made.now_us
    made.enable()
    made.run(1.0)
    rng = random.Random(room)
    for _ in range(12):
        made.nap(rng.uniform(0.1, 1.9))
        made.run(rng.uniform(0.0, 0.3))
    assert made.group.phase is Phase.STANDING, made.group.reason


@pytest.mark.parametrize("off_us", [0.0, BOOT_US, 2e6])
def test_a_power_cycle_is_named_at_once(off_us):
    made = moving(1.3)
    told_us: list[float] = []
    made.on_event = lambda event: event.kind == "fault" and told_us.append(made.now_us)
    cut_us = made.now_us
    made.drives[1].power_off()
    made.run(off_us / 1e6)
    made.drives[1].power_on(made.now_us)
    made.run(1.0, lambda: bool(told_us))
    assert told_us[0] - cut_us <= max(500e3, off_us)
    made.run(0.01)
    said = next(event.text for event in made.events if event.kind == "fault")
    word = "has restarted" if off_us + BOOT_US < 400e3 else "is silent"
    assert said.startswith(f"joint_2 (node 2) {word}")
    assert halted_us(made, but=2) - cut_us <= 500e3
    assert said in reason_of(made)
    # the ramp, for which nobody waits, and an SDO answer, for which the bench does
    assert made.now_us - cut_us <= max(off_us, 500e3) + 1e6 + SDO_PATIENCE_US
    assert made.lost() == [1]


@pytest.mark.parametrize("period", [0.05, 0.1])
@pytest.mark.parametrize("delay_us", [60e3, 101e3, 151e3])
def test_late_answers_are_called_late(delay_us, period):
    """Whichever SYNC they may be taken for."""
    made = Bench(DriverConfig(axes=axes(), sync_period=period))
    made.enable()
    moving(1.0, made)
    made.bus.host_delay_us = lambda can_id, _: delay_us if can_id == 0x580 + 3 else 0.0
    reason = reason_of(made)
    late = "its answers to SYNC come late|its clock .0x1013. was not read"
    assert re.match(rf"joint_3 \(node 3\): ({late})", reason), reason


@pytest.mark.parametrize("delay_us", [60e3, 100e3, 230e3])
def test_a_demand_that_is_heard_late_is_judged_by_its_own_sync(delay_us):
    made = moving(1.0)
    made.bus.host_delay_us = lambda can_id, _: delay_us if can_id == 0x480 + 3 else 0.0
    made.wait(made.group.motion)


@pytest.mark.parametrize("jump_us", [2e3, -3e3, 30e3, 49e3, 80e3])
def test_a_clock_that_jumps_in_motion_is_named(jump_us):
    made = moving(1.0)
    jumped_us = made.now_us
    made.drives[3]._shift_path(jump_us)
    made.drives[3].clock._offset_us += jump_us
    made.run(0.3)
    assert halted_us(made, but=4) - jumped_us <= 200e3
    reason = reason_of(made)
    assert reason.startswith("joint_4 (node 4): its clock is off by ")
    assert float(reason.split()[8]) == pytest.approx(jump_us / 1e3, abs=0.2)


@pytest.mark.parametrize("count", [1, 2])
@pytest.mark.parametrize("jump_us", [1.5e3, 4e3, -4e3])
def test_the_jump_of_an_only_clock_is_not_taken_for_a_late_host(count, jump_us):
    made = moving(1.03, few(count))
    jumped_us = made.now_us
    made.drives[0]._shift_path(jump_us)
    made.drives[0].clock._offset_us += jump_us
    made.run(0.15)
    reason = reason_of(made)
    assert reason.startswith("joint_1 (node 1): its clock is off by "), reason
    assert float(reason.split()[8]) == pytest.approx(jump_us / 1e3, abs=0.6)
    told_us = made.machine.path_time.start_us + float(reason.split(", ")[1].split()[0]) * 1e6
    assert told_us - jumped_us < 101e3


@pytest.mark.parametrize("count", [1, 2, 3])
@pytest.mark.parametrize("jump_us", [2e3, -9e3, 26e3, -40e3])
def test_a_clock_that_jumps_while_the_axes_stand_is_put_right(count, jump_us):
    """With its next time stamp, and the others' clocks are left alone."""
    made = few(count)
    made.run(1.03)
    made.drives[0].clock._offset_us += jump_us
    made.run(0.3)
    moving(0.0, made)
    made.wait(made.motion)
    made.bus.run_until(made.now_us + 1e5, lambda *frame: None)
    at = [drive.clock.value(made.now_us) for drive in made.drives]
    assert max(at) - min(at) < 100


@pytest.mark.parametrize("count", [1, 2])
@pytest.mark.parametrize("producer", ["host", "joint_1"])
def test_a_host_that_is_late_again_and_again_blames_no_only_clock(count, producer):
    """What has no time stamp of its own is stamped when the host gets to it."""
    made = few(count, producer)
    chance = random.Random(count)
    made.stamp_us = lambda t_us: max(t_us, late_until(t_us))
    late_until = Late(chance)
    moving(0.0, made)
    made.wait(made.motion)


class Late:
    """Again and again the host gets to nothing for a while."""

    def __init__(self, chance: random.Random) -> None:
        self._chance = chance
        self._begins_us = self._ends_us = 0.0

    def __call__(self, t_us: float) -> float:
        while self._ends_us <= t_us:
            self._begins_us = self._ends_us + self._chance.uniform(0, 150e3)
            self._ends_us = self._begins_us + self._chance.uniform(1e3, 70e3)
        return self._ends_us if self._begins_us <= t_us else t_us


def few(count: int, producer: str = "host") -> Bench:
    config = DriverConfig(axes=axes(count), sync_producer=producer)
    drives = [
        Epos2(n, offset_us=3e5 * n, drift_ppm=150.0 * (-1) ** n, dictionary=Dictionary.NOTE)
        for n in range(1, count + 1)
    ]
    made = Bench(config, drives)
    made.run(3.0)
    made.enable()
    return made


def test_a_host_that_notices_one_sync_late_blames_no_clock():
    made = moving(1.0)
    syncs = 0

    def stamp(t_us: float) -> float:
        nonlocal syncs
        syncs += 1
        return t_us + (70e3 if syncs % 50 == 0 else 0.0)

    made.stamp_us = stamp
    made.wait(made.group.motion)


def said_at(reason: str, what: str) -> float:
    """When a reason says that it was [s into the motion]; it says nothing else."""
    match = re.fullmatch(rf"{re.escape(what)}, (\d+\.\d\d\d) s into the motion", reason)
    assert match, reason
    return float(match[1])


def soon_after(time_s: float):
    """Within what a frame takes to get to the host, and the last digit."""
    return pytest.approx(time_s + 0.001, abs=0.002)


class Deaf(Epos2):
    """Does not halt."""

    deaf = False

    def receive(self, can_id, data, t_us, remote=False):
        if self.deaf and can_id == 0x500 + self.node_id and data == HALT:
            return True
        return super().receive(can_id, data, t_us, remote)


def test_who_does_not_halt_is_quick_stopped():
    made = Bench(drives=[(Deaf if n == 6 else Epos2)(n) for n in NODES])
    made.enable()
    moving(1.0, made)
    made.drives[5].deaf = True
    failed_us = made.now_us
    made.drives[0].fail(0x8611, made.now_us)
    reason = reason_of(made)
    into_s = (failed_us - made.machine.path_time.start_us) / 1e6
    assert said_at(reason, "joint_1 (node 1): following error (0x8611)") == soon_after(into_s)
    quick = [t for t, f, echo in made.frames if echo and (f.can_id, f.data) == (0x506, b"\x02\x00")]
    assert len(quick) == 1
    assert quick[0] - failed_us <= 160e3
    assert all_stand(made)
    made.wait(made.group.reset_fault())
    made.enable()


def test_two_axes_in_trouble_are_both_named():
    made = moving(2.0)
    into_s = (made.now_us - made.machine.path_time.start_us) / 1e6
    made.drives[0].fail(0x2310, made.now_us)
    made.run(0.001)
    made.drives[2].fail(0x8611, made.now_us)
    first = "joint_1 (node 1): over-current (0x2310)"
    both = f"{first}; joint_3 (node 3): following error (0x8611)"
    assert said_at(reason_of(made), both) == soon_after(into_s)
    texts = [event.text for event in made.events if event.kind == "fault"]
    assert said_at(texts[0], first) == soon_after(into_s)
    assert len(texts) == 2
