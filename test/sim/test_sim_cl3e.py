"""The simulated CL3-E: against Nanotec's own table, and row by row what its manual's chapter says.

Profiles are compared with closed formulas of constant acceleration and with Ruckig.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator

import pytest
from makers import facts
from sim_host import Abort, Host

from epos2_ros.sim import ramps
from epos2_ros.sim.cl3e import Cl3e, Firmware
from epos2_ros.sim.homing import Switches

NODE = 5
COUNTS_PER_RPM = 2000 / 60  # the presets: 2000 increments a turn, rpm, rpm/s
VELOCITY, ACCELERATION = 600, 60_000  # 20 counts/ms, 2 counts/ms²
SLOW = 300

ON, NEW, NOW, RELATIVE, HALT, PASS = 0x0F, 0x10, 0x20, 0x40, 0x100, 0x200  # controlword
REACHED, ACKNOWLEDGED, BEHIND = 0x0400, 0x1000, 0x2000  # statusword


def seconds(way: float, velocity: float = VELOCITY, acceleration: float = ACCELERATION) -> float:
    """How long a trapezoid takes [ms], by the formulas of constant acceleration."""
    v, a = velocity * COUNTS_PER_RPM / 1e3, acceleration * COUNTS_PER_RPM / 1e6
    peak = min(v, math.sqrt(way * a))
    return way / peak + peak / a


class Rig:
    """One drive, enabled in profile position mode; control and target by RPDO1."""

    def __init__(self, drive: Cl3e | None = None, mode: int = 1, **settings: object) -> None:
        self.drive = drive or Cl3e(1, **{"lag_ms": 0.0, **settings})  # type: ignore[arg-type]
        self.host = host = Host(self.drive)  # type: ignore[arg-type]
        host.run(400)
        host.map(0x1400, 0x201, [0x607A_0020, 0x6040_0010])
        host.map(0x1800, 0x181, [0x6041_0010])
        for n in (0x1401, 0x1402, 0x1403, 0x1801, 0x1802, 0x1803):
            host.write(n, 1, host.read(n, 1) | 1 << 31, 4)
        for index, value in (
            (0x6081, VELOCITY),
            (0x6083, ACCELERATION),
            (0x6084, ACCELERATION),
            (0x6085, ACCELERATION),
            (0x60C6, ACCELERATION),
            (0x607A, 0),
        ):
            host.write(index, 0, value, 4)
        host.write(0x6068, 0, 5, 2)
        host.write(0x6060, 0, mode, 1)
        host.run(5)
        host.nmt(1)
        self.target = 0
        for word in (0x06, 0x07, ON):
            self.word(word)

    def word(self, word: int, target: int | None = None, ms: float = 0.3) -> None:
        self.target = self.target if target is None else target
        data = self.target.to_bytes(4, "little", signed=True) + word.to_bytes(2, "little")
        self.host.send(0x201, data, ms=ms)

    def order(self, target: int, bits: int = 0) -> None:
        """The whole handshake of a set-point that is taken at once."""
        self.word(ON | NEW | bits, target)
        self.word(ON | bits)

    @property
    def status(self) -> int:
        return self.told()[-1]

    def told(self) -> list[int]:
        return [int.from_bytes(data, "little") for data in self.host.heard(0x181)]

    def new(self, mask: int, since: int) -> list[int]:
        """The values of some statusword bits in the frames since then, repetitions left out."""
        return [key for key, _ in itertools.groupby(w & mask for w in self.told()[since:])]

    def path(self, ms: int) -> Iterator[int]:
        for _ in range(ms):
            self.host.run(1)
            yield self.drive.position_demand

    def arrive(self, ms: int = 500) -> int:
        list(self.path(ms))
        assert self.status & REACHED
        return self.drive.position_actual


@pytest.fixture
def rig() -> Rig:
    return Rig()


def refused(host: Host, index: int, subindex: int, value: int, size: int) -> int:
    with pytest.raises(Abort) as abort:
        host.write(index, subindex, value, size)
    return abort.value.code


# --- the maker's dictionary ---------------------------------------------------------------------

SIMULATED_ELSEWHERE = range(0x1F50, 0x1F58)  # loading of firmware
OF_ITS_OWN = {0x1018, 0x2009}  # serial number and node id are this drive's


def test_every_object_is_as_in_the_makers_table() -> None:
    """FIR-v1419: type, access, default and PDO mapping; the table has no ranges."""
    simulated = dict(Cl3e(NODE, firmware=Firmware.V1419).dictionary.items())
    checked = 0
    for fact in facts("cl3_fir_v1419.csv", NODE):
        if fact.index in SIMULATED_ELSEWHERE:
            continue
        entry = simulated.pop((fact.index, fact.subindex))
        assert (entry.type.size, entry.type.signed) == (fact.size, fact.signed), fact.key
        assert entry.access.replace("const", "ro") == fact.access.replace("const", "ro"), fact.key
        assert entry.mappable == fact.mappable, fact.key
        if fact.default is not None and fact.index not in OF_ITS_OWN:
            assert entry.default == fact.default, fact.key
        assert fact.limits is None
        checked += 1
    # the table has the mapped objects of the presets; a PDO has room for eight
    assert all(0x1600 <= index <= 0x1A03 and sub > 0 for index, sub in simulated)
    assert checked > 450


def test_what_later_firmware_has() -> None:
    old, seed, new = (
        {index for (index, _), _ in Cl3e(1, firmware=firmware).dictionary.items()}
        for firmware in (Firmware.V1419, Firmware.V1446, Firmware.V1738)
    )
    assert seed - old == {0x60F2, 0x2067} and not old - seed
    assert new - seed == {0x60A8, 0x60A9}
    assert seed - new == {0x2061, 0x2062, 0x2063, 0x2064, 0x2065, 0x2066}


@pytest.mark.parametrize("index", [0x1016, 0x6007, 0x1006, 0x1013, 0x1029])
def test_objects_that_do_not_exist(rig: Rig, index: int) -> None:
    assert refused(rig.host, index, 0, 0, 4) == 0x06020000


def test_it_sends_no_sync(rig: Rig) -> None:
    assert refused(rig.host, 0x1005, 0, 0x4000_0080, 4) == 0x06090030


def test_two_boot_ups_per_start() -> None:
    host = Host(Cl3e(1))  # type: ignore[arg-type]
    assert host.heard(0x701) == [b"\0", b"\0"]
    host.nmt(0x82)  # the boot loader is not asked
    host.run(400)
    assert len(host.heard(0x701)) == 3
    host.nmt(0x81)
    host.run(10)
    host.send(0x601, "40 00 10 00 00 00 00 00", ms=2)
    assert len(host.heard(0x701)) == 4 and host.heard(0x581) == []
    host.run(400)
    assert len(host.heard(0x701)) == 5
    assert host.read(0x1000) == 0x0004_0192


def test_a_frame_of_zeros_on_rpdo1_as_preset_selects_open_loop() -> None:
    host = Host(Cl3e(1))  # type: ignore[arg-type]
    host.write(0x3202, 0, 1, 4)
    host.nmt(1)
    host.send(0x201, bytes(7))
    assert host.read(0x3202) == 0


def test_life_guarding_by_remote_requests(rig: Rig) -> None:
    host, drive = rig.host, rig.drive

    def ask() -> bytes:
        drive.receive(0x701, b"", host.bus.now_us, remote=True)
        host.run(1)
        return host.heard(0x701)[-1]

    assert [ask(), ask(), ask()] == [b"\x05", b"\x85", b"\x05"]
    host.write(0x100C, 0, 50, 2)
    host.write(0x100D, 0, 3, 1)
    host.run(500)
    assert rig.status & 0x6F == 0x27  # it has not been asked since
    for _ in range(5):
        ask()
        host.run(140)
    assert rig.status & 0x6F == 0x27
    host.run(20)
    assert host.heard(0x081)[-1][:2] == b"\x30\x81"
    assert rig.status & 0x4F == 0x08


def test_a_heartbeat_replaces_guarding(rig: Rig) -> None:
    rig.host.write(0x1017, 0, 100, 2)
    rig.host.run(50)
    before = len(rig.host.heard(0x701))
    rig.drive.receive(0x701, b"", rig.host.bus.now_us, remote=True)
    rig.host.run(10)
    assert len(rig.host.heard(0x701)) == before


# --- modes and states ---------------------------------------------------------------------------


def test_a_set_point_before_the_mode_is_shown_is_ignored_silently() -> None:
    rig = Rig(mode=0)
    rig.host.write(0x6060, 0, 1, 1)
    assert rig.host.read(0x6061) == 0
    rig.order(1000)
    rig.host.run(100)
    assert not rig.status & ACKNOWLEDGED and rig.drive.position_actual == 0
    assert rig.host.read(0x6061) == 1
    rig.order(1000)
    assert rig.arrive() == 1000


def test_preset_target_moves_the_axis_if_it_is_not_written() -> None:
    host = Host(Cl3e(1))  # type: ignore[arg-type]
    assert host.read(0x607A) == 4000
    assert host.read(0x6060) == 0
    assert host.read(0x60F2) == 1


@pytest.mark.parametrize(
    ("option", "state"), [(0, 0x40), (1, 0x40), (2, 0x40), (5, 0x07), (6, 0x07)]
)
def test_what_is_after_a_quick_stop(rig: Rig, option: int, state: int) -> None:
    rig.host.write(0x605A, 0, option, 2)
    rig.order(10_000)
    rig.host.run(50)
    rig.word(0x0B)
    rig.host.run(50)
    assert rig.status & 0x6F == state
    place = rig.drive.position_actual
    assert 0 < place < 10_000
    rig.host.run(50)
    assert rig.drive.position_actual == place


# --- controlword, bit by bit --------------------------------------------------------------------


def test_bit_4_starts_on_a_transition_from_0_to_1_frame_by_frame(rig: Rig) -> None:
    since = len(rig.told())
    rig.word(ON | NEW, 1100)
    assert rig.new(ACKNOWLEDGED, since) == [ACKNOWLEDGED]  # bit 12 set with bit 4
    rig.word(ON | NEW, 500)  # no transition: nothing
    rig.word(ON, 500)
    assert rig.new(ACKNOWLEDGED, since) == [ACKNOWLEDGED, 0]  # and reset with it: time 1
    places = list(rig.path(100))
    wanted_ms = seconds(1100)
    first = next(n for n, place in enumerate(places) if place == 1100)
    assert first == pytest.approx(wanted_ms, abs=2)
    assert rig.new(REACHED, since) == [0, REACHED]
    assert places[-1] == 1100


def test_bit_5_is_carried_out_immediately(rig: Rig) -> None:
    rig.order(1100)
    list(rig.path(30))
    rig.order(300, NOW)
    places = list(rig.path(200))
    assert max(places) < 1100 and places[-1] == 300
    assert rig.status & REACHED


def test_bit_5_clear_completes_the_present_order_first(rig: Rig) -> None:
    rig.order(1100)
    list(rig.path(30))
    rig.order(300)
    places = list(rig.path(250))
    assert max(places) == 1100 and places[-1] == 300


@pytest.mark.parametrize(
    ("option", "base"),
    [(0, 1100), (1, "demand"), (2, "actual")],
    ids=["target", "demand", "actual"],
)
def test_bit_6_counts_from_what_0x60f2_says(option: int, base: int | str) -> None:
    rig = Rig(lag_ms=5.0)
    rig.host.write(0x3202, 0, 1, 4)  # closed loop: the axis is behind its demand
    rig.host.write(0x6065, 0, 1000, 4)
    rig.host.write(0x60F2, 0, option, 2)
    rig.order(1100)
    list(rig.path(30))
    demand, actual = rig.drive.position_demand, rig.drive.position_actual
    assert demand - actual > 50
    rig.order(200, RELATIVE | NOW)
    start = {"demand": demand, "actual": actual}.get(str(base), 1100)
    assert rig.arrive() == pytest.approx(start + 200, abs=21)  # a cycle's way until it came in


def test_bit_6_counts_from_zero_where_there_was_no_target() -> None:
    rig = Rig(position=300)
    rig.host.write(0x60F2, 0, 0, 2)
    rig.order(500, RELATIVE)
    assert rig.arrive() == 500
    rig.order(500, RELATIVE)
    assert rig.arrive() == 1000


@pytest.mark.parametrize(("option", "rate"), [(1, 60_000), (2, 30_000)])
def test_bit_8_halts_with_what_0x605d_says_and_goes_on(rig: Rig, option: int, rate: int) -> None:
    rig.host.write(0x6085, 0, 30_000, 4)
    rig.host.write(0x605D, 0, option, 2)
    rig.order(3000)
    list(rig.path(40))
    before = rig.drive.position_demand
    rig.word(ON | HALT)
    since = len(rig.told())
    *_, stopped = rig.path(60)
    way = 20**2 / (2 * rate * COUNTS_PER_RPM / 1e6)  # v²/2a
    assert stopped - before == pytest.approx(way, abs=21)
    assert rig.status & REACHED and rig.status & 0x6F == 0x27
    rig.word(ON)  # from 1 to 0: accelerates again, on to the target
    assert rig.arrive() == 3000
    assert rig.new(REACHED, since) == [REACHED, 0, REACHED]


def test_a_set_point_during_halt_waits_for_its_end(rig: Rig) -> None:
    rig.word(ON | HALT)
    rig.word(ON | HALT | NEW, 700)
    assert rig.status & ACKNOWLEDGED
    list(rig.path(50))
    assert rig.drive.position_actual == 0
    rig.word(ON)
    assert rig.arrive() == 700


def test_bit_9_passes_the_target_without_braking(rig: Rig) -> None:
    rig.order(1100)
    list(rig.path(20))
    rig.host.write(0x6081, 0, SLOW, 4)
    rig.order(2300, PASS)
    places = list(rig.path(300))
    place = next(n for n, place in enumerate(places) if place >= 1100)
    assert places[place] - places[place - 1] == 20  # the speed of the first until its target
    assert places[place + 20] - places[place + 19] == 10  # then that of the second
    assert places[-1] == 2300


def test_bit_9_is_ignored_where_the_axis_would_need_a_run_up(rig: Rig) -> None:
    rig.order(1100)
    list(rig.path(60))  # it brakes already
    assert 1050 < rig.drive.position_demand < 1100
    rig.order(2300, PASS)
    places = list(rig.path(300))
    assert places.count(1100) >= 1  # it stood there
    around = [b - a for a, b in itertools.pairwise(places) if a <= 1100 <= b]
    assert min(around) <= 1
    assert places[-1] == 2300


# --- statusword, bit by bit ---------------------------------------------------------------------


def test_bit_10_waits_for_window_and_time() -> None:
    rig = Rig(lag_ms=10.0)
    for index, value, size in ((0x3202, 1, 4), (0x6067, 20, 4), (0x6068, 50, 2), (0x6065, 999, 4)):
        rig.host.write(index, 0, value, size)
    rig.order(1100)
    inside = reached = None
    for ms in range(300):
        rig.host.run(1)
        if inside is None and abs(1100 - rig.drive.position_actual) <= 20:
            inside = ms
        if reached is None and rig.status & REACHED:
            reached = ms
    assert inside is not None and reached is not None
    assert reached - inside == pytest.approx(50, abs=2)


@pytest.mark.parametrize(
    ("index", "subindex", "value", "target"),
    [
        (0x607D, 1, -100, -101),
        (0x607D, 2, 1000, 1001),
        (0x607B, 1, -100, -101),
        (0x607B, 2, 1000, 1001),
        (0x6081, 0, 0, 500),
        (0x6083, 0, 0, 500),
        (0x60C5, 0, 0, 500),
        (0x60C6, 0, 0, 500),
    ],
)
def test_bit_12_stays_low_where_the_target_can_t_be(
    rig: Rig, index: int, subindex: int, value: int, target: int
) -> None:
    rig.host.write(index, subindex, value, 4)
    since = len(rig.told())
    rig.order(target)
    list(rig.path(50))
    assert rig.drive.position_demand == 0
    assert not any(word & ACKNOWLEDGED for word in rig.told()[since:])


@pytest.mark.parametrize(("reaction", "state"), [(-1, 0x27), (0, 0x08), (2, 0x08)])
def test_bit_13_follows_from_window_and_time_in_closed_loop(reaction: int, state: int) -> None:
    rig = Rig(lag_ms=0.4)
    for index, value, size in ((0x3202, 1, 4), (0x6066, 40, 2), (0x3700, reaction, 2)):
        rig.host.write(index, 0, value, size)
    rig.drive.block_rotor()
    since = len(rig.told())
    rig.order(2000)
    list(rig.path(50))  # 256 counts behind after some 18 ms
    assert not rig.status & BEHIND
    list(rig.path(20))
    assert rig.new(BEHIND, since)[:2] == [0, BEHIND]
    list(rig.path(50))
    assert rig.status & 0x4F == state & 0x4F


def test_no_bit_13_in_open_loop(rig: Rig) -> None:
    rig.host.write(0x6065, 0, 0, 4)
    rig.order(2000)
    assert rig.arrive() == 2000
    assert not any(word & BEHIND for word in rig.told())


# --- times 1 to 5 of the set-point diagram ------------------------------------------------------


def test_times_1_to_4(rig: Rig) -> None:
    since = len(rig.told())

    def bits() -> list[int]:
        return rig.new(ACKNOWLEDGED, since)

    rig.order(1100)
    assert bits() == [ACKNOWLEDGED, 0]  # time 1: another one can be buffered
    rig.host.write(0x6081, 0, SLOW, 4)  # its parameters are set anew
    rig.word(ON | NEW, 2100)
    rig.word(ON)
    assert bits() == [ACKNOWLEDGED, 0, ACKNOWLEDGED]  # time 2: bit 12 stays, the buffer is full
    rig.host.write(0x6081, 0, VELOCITY, 4)
    rig.order(-5000)  # time 4: ignored
    rig.host.run(20)
    assert bits() == [ACKNOWLEDGED, 0, ACKNOWLEDGED]
    speeds = [b - a for a, b in itertools.pairwise(rig.path(60))]
    assert bits() == [ACKNOWLEDGED, 0, ACKNOWLEDGED, 0]  # time 3: the buffer is empty again
    assert max(speeds[:10]) == 20 and speeds[-1] == 10
    rig.order(1500)
    places = list(rig.path(300))
    assert max(places) == 2100 and places[-1] == 1500
    assert bits() == [ACKNOWLEDGED, 0, ACKNOWLEDGED, 0, ACKNOWLEDGED, 0]


def test_time_5_without_the_buffer(rig: Rig) -> None:
    since = len(rig.told())
    for target in (1100, 2100, -400, 600):
        rig.order(target, NOW)
        rig.host.run(10)
    assert rig.new(ACKNOWLEDGED, since) == [ACKNOWLEDGED, 0] * 4
    assert rig.arrive() == 600


def test_an_immediate_set_point_is_ignored_too_while_bit_12_is_set(rig: Rig) -> None:
    rig.order(1100)
    rig.word(ON | NEW, 2100)
    rig.word(ON)
    rig.order(-500, NOW)
    places = list(rig.path(250))
    assert min(places) >= 0 and places[-1] == 2100


# --- move combinations --------------------------------------------------------------------------


@pytest.mark.parametrize("passing", [0, PASS], ids=["", "bit 9"])
@pytest.mark.parametrize("immediate", [0, NOW], ids=["", "bit 5"])
@pytest.mark.parametrize("relative", [0, RELATIVE], ids=["absolute", "relative"])
@pytest.mark.parametrize("way", [1200, -800])
def test_move_combinations(rig: Rig, passing: int, immediate: int, relative: int, way: int) -> None:
    """The first is absolute, to 1100; the second is slower."""
    rig.order(1100)
    before = list(rig.path(30))
    rig.host.write(0x6081, 0, SLOW, 4)
    here = rig.drive.position_demand
    rig.word(ON | NEW | passing | immediate | relative, way if relative else 1100 + way)
    rig.word(ON | passing | immediate)
    places = before + list(rig.path(400))
    speeds = [b - a for a, b in itertools.pairwise(places)]
    if not relative:
        assert places[-1] == 1100 + way
    elif immediate:  # from the demand, where it was when the order came in
        assert places[-1] == pytest.approx(here + way, abs=21)
    else:  # from where the first one led, or was when the drive next looked
        assert 1100 + way <= places[-1] <= 1100 + way + (20 if passing else 0)
    first = next((n for n, place in enumerate(places) if place >= 1100), None)
    if immediate and way < 0:
        assert first is None  # never there
    elif immediate:
        assert first is not None and speeds[first - 1] == 10  # at the second's speed
    elif passing:
        assert first is not None and speeds[first - 1] == 20
    else:
        assert first is not None and speeds[first - 1] <= 2 and places[first] == 1100
    assert rig.status & REACHED


# --- release of bit 4 by the drive --------------------------------------------------------------


def test_the_drive_releases_bit_4_at_once(rig: Rig) -> None:
    rig.host.write(0x60F2, 0, 0x21, 2)
    since = len(rig.told())
    rig.word(ON | NEW, 1100)
    assert rig.host.read(0x6040) == ON
    rig.word(ON | NEW, 2100)  # a transition again: buffered, bit 4 is only released when it begins
    assert rig.host.read(0x6040) == ON | NEW and rig.status & ACKNOWLEDGED
    list(rig.path(80))
    assert rig.host.read(0x6040) == ON and not rig.status & ACKNOWLEDGED
    assert rig.new(ACKNOWLEDGED, since)[-1] == 0
    assert rig.arrive() == 2100


def test_the_drive_releases_bit_4_at_the_target(rig: Rig) -> None:
    rig.host.write(0x60F2, 0, 0x11, 2)
    rig.word(ON | NEW, 1100)
    list(rig.path(40))
    assert rig.host.read(0x6040) == ON | NEW and rig.status & ACKNOWLEDGED
    list(rig.path(60))
    assert rig.host.read(0x6040) == ON and not rig.status & ACKNOWLEDGED


@pytest.mark.parametrize("value", [0x03, 0x30, 0x04, 0x40, 0x100])
def test_positioning_options_that_it_has_not(rig: Rig, value: int) -> None:
    assert refused(rig.host, 0x60F2, 0, value, 2) == 0x06090030


# --- end velocity -------------------------------------------------------------------------------


def test_end_velocity_is_that_at_the_target(rig: Rig) -> None:
    rig.host.write(0x6082, 0, SLOW, 4)
    rig.order(1100)
    rig.host.write(0x6082, 0, 0, 4)
    rig.order(2000)
    places = list(rig.path(200))
    first = next(n for n, place in enumerate(places) if place >= 1100)
    assert places[first] - places[first - 1] == pytest.approx(10, abs=2)
    assert places[-1] == 2000 and rig.status & REACHED


def test_with_end_velocity_and_no_other_set_point_it_goes_on_until_halted(rig: Rig) -> None:
    rig.host.write(0x6082, 0, SLOW, 4)
    rig.order(1100)
    *_, before, after = rig.path(150)
    assert after - before == 10 and after > 1200 and not rig.status & REACHED
    rig.word(ON | HALT)
    list(rig.path(50))
    assert rig.status & REACHED


def test_chained_relative_moves_with_end_velocity_lose_precision(rig: Rig) -> None:
    """Each counts from the first sample after the target, up to a millisecond's way too far."""
    rig.host.write(0x6081, 0, 611, 4)  # no whole counts per millisecond
    rig.host.write(0x6082, 0, 611, 4)
    rig.order(501, RELATIVE)
    excess = []
    for n in range(1, 5):
        if n == 4:
            rig.host.write(0x6082, 0, 0, 4)
        rig.word(ON | NEW | RELATIVE)
        rig.word(ON)
        rig.host.run_until(lambda: not rig.status & ACKNOWLEDGED, 100)
        excess.append(rig.drive.position_demand)
    list(rig.path(200))
    too_far = rig.drive.position_demand - 5 * 501
    assert 1 <= too_far <= 4 * 21


def test_without_end_velocity_they_do_not(rig: Rig) -> None:
    for _ in range(5):
        rig.order(501, RELATIVE)
        list(rig.path(60))
    assert rig.drive.position_demand == 5 * 501


# --- limits -------------------------------------------------------------------------------------


@pytest.mark.parametrize(("index", "slower_first"), [(0x60C5, True), (0x60C6, False)])
def test_no_more_acceleration_than_the_most(rig: Rig, index: int, slower_first: bool) -> None:
    rig.host.write(index, 0, 20_000, 4)
    rig.order(3000)
    places = [0, *rig.path(250)]
    speeds = [b - a for a, b in itertools.pairwise(places)]
    steps = [b - a for a, b in itertools.pairwise(speeds)]
    limit = 20_000 * COUNTS_PER_RPM / 1e6
    full = ACCELERATION * COUNTS_PER_RPM / 1e6
    up, down = (limit, full) if slower_first else (full, limit)
    assert max(steps) == pytest.approx(up, abs=1.01)
    assert speeds.index(20) == pytest.approx(20 / up, abs=2)
    still = next(n for n, place in enumerate(places) if place == 3000)
    last_fast = max(n for n, speed in enumerate(speeds) if speed == 20)
    assert still - last_fast == pytest.approx(20 / down, abs=3)


def test_polarity_turns_the_direction_round(rig: Rig) -> None:
    rig.word(0x06)
    rig.host.write(0x607E, 0, 0x80, 1)
    rig.word(0x07)
    rig.word(ON)
    rig.order(1000)
    assert rig.arrive() == 1000
    assert rig.host.read(0x6063, signed=True) == -1000


def test_home_offset_moves_nothing(rig: Rig) -> None:
    rig.host.write(0x607C, 0, 500, 4)
    list(rig.path(50))
    assert rig.drive.position_actual == 0


def test_units_are_the_drive_s_to_say(rig: Rig) -> None:
    rig.host.write(0x2061, 0, 1, 4)  # one turn per second
    rig.host.write(0x2062, 0, 1, 4)
    rig.host.write(0x6081, 0, 10, 4)
    rig.order(2000)
    places = list(rig.path(60))
    assert places[40] - places[39] == 20


# --- jerk ---------------------------------------------------------------------------------------


def jerky(host: Host, kind: int, *jerks: int) -> None:
    host.write(0x6086, 0, kind, 2)
    for n, jerk in enumerate(jerks, 1):
        host.write(0x60A4, n, jerk, 4)


@pytest.mark.parametrize("way", [60, 700, 3000, -3000])
def test_jerk_limited_moves_last_as_long_as_ruckig_s(rig: Rig, way: int) -> None:
    ruckig = pytest.importorskip("ruckig")
    jerk = 6_000_000  # 0.2 counts/ms³: 10 ms to full acceleration
    jerky(rig.host, 3, *[jerk] * 4)
    request = ruckig.InputParameter(1)
    request.current_position, request.target_position = [0.0], [float(way)]
    request.max_velocity = [VELOCITY * COUNTS_PER_RPM / 1e3]
    request.max_acceleration = [ACCELERATION * COUNTS_PER_RPM / 1e6]
    request.max_jerk = [jerk * COUNTS_PER_RPM / 1e9]
    profile = ruckig.Trajectory(1)
    ruckig.Ruckig(1).calculate(request, profile)
    rig.order(way)
    places = list(rig.path(300))
    last = next(n for n, place in enumerate(places) if place == way)
    assert last == pytest.approx(profile.duration, abs=4)  # the last half count takes 2.5 ms
    wanted = [profile.at_time(min(ms, profile.duration))[0][0] for ms in range(200)]
    late = min(range(-2, 3), key=lambda d: abs(places[20 + d] - wanted[20]))
    assert places[2 : 190 + late] == pytest.approx(wanted[2 - late : 190], abs=21)


def test_four_jerks_are_those_of_the_four_places() -> None:
    limits = ramps.Limits(20.0, 2.0, 2.0, (0.1, 0.2, 0.4, math.inf))
    profile, kept = ramps.move(ramps.State(0.0, 0.0, 0.0), 3000.0, 0.0, limits)
    assert kept
    accelerations = [profile.at(t / 100).acceleration for t in range(int(profile.duration * 100))]
    steps = [b - a for a, b in itertools.pairwise(accelerations)]
    assert max(steps) == pytest.approx(0.1 / 100)  # begin of acceleration
    slopes = {round(step * 100, 6) for step in steps}
    assert {0.1, -0.2, -0.4} <= slopes
    assert accelerations[-1] == pytest.approx(-2.0)  # no limit at the end
    end = profile.at(profile.duration)
    assert (end.position, end.velocity) == (3000.0, 0.0)


@pytest.mark.parametrize(
    ("kind", "jerks"), [(0, (1000,) * 4), (3, (0,) * 4)], ids=["0x6086", "0x60A4"]
)
def test_two_ways_of_no_jerk_limit(rig: Rig, kind: int, jerks: tuple[int, ...]) -> None:
    jerky(rig.host, kind, *jerks)
    rig.order(1100)
    places = list(rig.path(100))
    last = next(n for n, place in enumerate(places) if place == 1100)
    assert last == pytest.approx(seconds(1100), abs=2)


@pytest.mark.parametrize("seed", range(40))
def test_profiles_keep_their_limits_and_meet_their_end(seed: int) -> None:
    """From anywhere at any velocity and acceleration, as a drive is when it is given a target."""
    import random

    rng = random.Random(seed)
    jerks = tuple(rng.choice([0.05, 0.3, 1.0, math.inf]) for _ in range(4))
    limits = ramps.Limits(rng.uniform(1, 30), rng.uniform(0.2, 3), rng.uniform(0.2, 3), jerks)
    first, _ = ramps.move(ramps.State(0.0, 0.0, 0.0), rng.uniform(-3000, 3000), 0.0, limits)
    start = first.at(rng.uniform(0, first.duration))
    target, speed = rng.uniform(-3000, 3000), rng.choice([0.0, rng.uniform(0, limits.velocity)])
    profile, kept = ramps.move(start, target, speed, limits)
    dt, before = 0.02, start
    most = max(limits.acceleration, limits.deceleration)
    for n in range(1, int(profile.duration / dt) + 1):
        now = profile.at(n * dt)
        assert abs(now.velocity) <= max(limits.velocity, abs(start.velocity)) * 1.001 + most * dt
        assert abs(now.acceleration) <= most * 1.001
        assert now.velocity - before.velocity == pytest.approx(0, abs=most * dt * 1.01)
        assert abs(now.position - before.position - before.velocity * dt) <= most * dt**2 + 1e-6
        before = now
    end = profile.at(profile.duration)
    assert end.position == target
    assert abs(end.velocity) == pytest.approx(speed if kept else 0.0)


# --- homing: statusword bits 13, 12 and 10 -------------------------------------------------------


def homing_bits(rig: Rig, since: int) -> list[str]:
    """Bits 13, 12 and 10 before and in the frames since then."""
    words = rig.new(BEHIND | ACKNOWLEDGED | REACHED, since - 1)
    return [f"{w >> 13 & 1}{w >> 12 & 1}{w >> 10 & 1}" for w in words]


def homing_rig(**switches: float) -> Rig:
    rig = Rig(switches=Switches(**switches))  # type: ignore[arg-type]
    rig.host.write(0x320A, 4, 1, 4)
    for index, subindex, value, size in (
        (0x6098, 0, 17, 1), (0x6099, 1, 200, 4), (0x6099, 2, 20, 4), (0x609A, 0, 6000, 4),
        (0x607C, 0, 500, 4), (0x6060, 0, 6, 1),
    ):  # fmt: skip
        rig.host.write(index, subindex, value, size)
    rig.host.run(5)
    return rig


def test_homing_runs_attains_and_is_done_while_bit_4_stays() -> None:
    rig = homing_rig(negative_limit=-400)
    since = len(rig.told())
    rig.word(ON | NEW)
    list(rig.path(500))
    assert homing_bits(rig, since) == ["000", "010", "011"]
    # the switch is now at -500; braking off it goes less than ten counts on, and nothing back
    assert -500 <= rig.drive.position_actual <= -490
    rig.word(ON)
    assert homing_bits(rig, since)[-1] == "011"


def test_homing_without_bit_4_is_interrupted() -> None:
    rig = homing_rig(negative_limit=-4000)
    since = len(rig.told())
    rig.word(ON | NEW)
    list(rig.path(100))
    rig.word(ON)
    list(rig.path(100))
    assert homing_bits(rig, since) == ["000", "001"]


def test_homing_error() -> None:
    rig = homing_rig(negative_limit=-300, positive_limit=300)
    rig.host.write(0x6098, 0, 34, 1)
    rig.host.write(0x6099, 2, 200, 4)
    rig.drive._switches = Switches(positive_limit=300, index=1500)
    since = len(rig.told())
    rig.word(ON | NEW)
    list(rig.path(300))
    assert homing_bits(rig, since) == ["000", "100", "101"]


def test_homing_in_open_loop_needs_the_encoder_s_position() -> None:
    rig = homing_rig(negative_limit=-300)
    rig.host.write(0x320A, 4, -1, 4)
    rig.word(ON | NEW)
    list(rig.path(100))
    assert rig.status & BEHIND and rig.drive.position_actual == 0
