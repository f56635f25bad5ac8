"""Whatever comes from the bus: nothing raises, what makes no sense changes nothing, and the way
back is known.

Lengths are CiA 301's and those of the EPOS2's mappings: TPDO2, TPDO4, emergencies and SDO
responses have 8 bytes, a heartbeat has one.
"""

from __future__ import annotations

import random

import pytest
from simulated_time import Bench, axes, move_on
from six_axes import assert_on_path, drives, there_and_back

from epos2_ros.configuration.driver import DriverConfig
from epos2_ros.protocol.frame import Frame
from epos2_ros.protocol.phase import Phase
from epos2_ros.sim.epos2 import Epos2

NODES = range(1, 7)
REPORTS = [function + node for function in (0x180, 0x280, 0x480) for node in NODES]


def bench(**settings: object) -> Bench:
    made = Bench(DriverConfig(axes=axes(), **settings), drives())  # type: ignore[arg-type]
    made.enable()
    return made


def inject(made: Bench, frame: Frame) -> None:
    """The host sees a frame that none of the drives has sent."""
    made._on_frame(frame.can_id, frame.data, made.now_us, False)


def malformed(rng: random.Random) -> Frame:
    """Frames that no drive can have sent."""
    kind = rng.randrange(4)
    if kind == 0:
        can_id = rng.choice(REPORTS)
        mapped = 4 if can_id & 0x780 == 0x180 else 8
        return Frame(can_id, rng.randbytes(rng.choice([n for n in range(8) if n != mapped])))
    if kind == 1:
        return Frame(0x080 + rng.choice(NODES), rng.randbytes(rng.randrange(8)))
    if kind == 2:
        unknown = rng.choice([s for s in range(1, 256) if s & 0x7F not in (0, 4, 5, 0x7F)])
        data = rng.choice([b"", rng.randbytes(2), rng.randbytes(8), bytes([unknown])])
        return Frame(0x700 + rng.choice(NODES), data)
    return Frame(0x580 + rng.choice(NODES), rng.randbytes(rng.randrange(8)))


def anything(rng: random.Random) -> Frame:
    """Of any identifier, length and content, most of them near what drives send."""
    can_id = rng.choice([0x000, 0x080, 0x100, *REPORTS, rng.randrange(0x800)])
    if rng.random() < 0.5:
        can_id = rng.choice([0x080, 0x180, 0x280, 0x380, 0x480, 0x580, 0x700]) + rng.choice(NODES)
    data = rng.randbytes(rng.choice([0, 1, 2, 4, 7, 8, 8, 8, 8]))
    if rng.random() < 0.5:  # numbers that occur: small, all ones
        data = bytes(rng.choice([0, 1, 5, 0x27, 0x40, 0xFF]) for _ in data)
    return Frame(can_id, data)


def test_malformed_frames_change_nothing_and_are_counted(fuzz: int) -> None:
    for seed in range(fuzz):
        rng = random.Random(seed)
        made = bench()
        made.path.submit(there_and_back(), None, made.now_us)
        motion, injected = made.group.motion, 0
        while not motion.done():
            for _ in range(5):
                inject(made, malformed(rng))
                injected += 1
            made.run(0.002)
        motion.result(timeout=0)
        assert_on_path(made)
        assert sum(made.rejects.counts.values()) == injected > 3000
        assert set(made.rejects.counts) == {
            "PDO of wrong length",
            "emergency of wrong length",
            "heartbeat of wrong length",
            "heartbeat of unknown state",
            "SDO response of wrong length",
        }
        said = list(made.rejects.notices)
        assert len(said) == len(set(said)) == 5 * len(NODES)  # each once for each drive
        assert any("joint_3 (node 3): emergency 0x083 of " in line for line in said)


def recover(made: Bench) -> None:
    """As `Driver.reset_fault`, then enabled."""
    lost = made.lost()
    for index in lost:
        made.bring_up_drive(index)
    if lost:
        made.group.start_clock(made.now_us, bytes(6))
    made.wait(made.group.reset_fault(), 20.0)
    made.wait(made.group.enable(), 20.0)


PHASES = (
    "before bring-up", "enabling", "standing", "priming", "moving", "halting", "quick stop",
    "disabling", "resetting",
)  # fmt: skip


@pytest.mark.parametrize("when", PHASES)
def test_any_frames_in_any_phase_raise_nothing_and_the_next_motion_runs(
    when: str, fuzz: int
) -> None:
    for seed in range(fuzz):
        rng = random.Random(f"{when} {seed}")
        made = Bench(DriverConfig(axes=axes()), drives(), bring_up=False)
        if when == "before bring-up":
            storm(made, rng)
        made.bring_up()
        if when == "enabling":
            made.group.enable()
        else:
            made.enable()
        if when in ("priming", "moving", "halting", "quick stop"):
            made.path.submit(there_and_back(), None, made.now_us)
        if when in ("moving", "halting", "quick stop"):
            made.run(0.5)
        if when == "halting":
            made.group.halt()
        elif when == "quick stop":
            made.group.quick_stop()
        elif when == "disabling":
            made.group.disable()
        elif when == "resetting":
            made.group.fail("for the test")
            made.group.reset_fault()
        if when != "before bring-up":
            storm(made, rng)
        made.run(8.0)  # whatever a frame looked like, the drives go on saying how it really is
        assert made.group.phase in (Phase.FAULT, Phase.DISABLED, Phase.STANDING), (when, seed)
        recover(made)
        move_on(made)


def storm(made: Bench, rng: random.Random) -> None:
    for _ in range(50):
        for _ in range(rng.randrange(5)):
            inject(made, anything(rng))
        made.run(rng.choice([0.0002, 0.002, 0.02]))


def test_what_a_drive_sends_before_it_is_mapped_is_no_report() -> None:
    """A factory-fresh drive that is operational sends TPDO1 with whatever it carries then."""
    made = Bench(DriverConfig(axes=axes(1)), [Epos2(1)], bring_up=False)
    faults = b"\x08\x02", bytes([8]) * 8
    for data in faults:
        inject(made, Frame(0x181, data))
    assert made.machine.drives[0].statusword == 0
    made.bring_up()
    made.enable()
    made.drives[0].power_off()
    made.drives[0].power_on(made.now_us)  # and what we have mapped is gone
    made.run(0.3)
    before = made.machine.drives[0].statusword
    for data in faults:
        inject(made, Frame(0x181, data))
    assert made.machine.drives[0].statusword == before
    assert not made.rejects.counts
    recover(made)
    inject(made, Frame(0x181, b"\x08\x02"))
    assert made.rejects.counts == {"PDO of wrong length": 1}
    inject(made, Frame(0x181, b"\x08\x02" + bytes(2)))
    assert made.machine.drives[0].statusword == 0x0208
