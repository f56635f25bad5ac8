"""Homing mode of a simulated Copley drive.

Sources: CiA 402 for the mode and its standard methods; the maker's EDS for its objects (0x2350 and
0x2351 among them); −1 … −4 against a hard stop, and that the home offset moves nothing, are from
public descriptions of its CANopen objects. READING: zero is 0x607C on from the home; the axis
brakes beyond it and does not go back there.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Protocol

from .dictionary import (
    INTEGER8,
    INTEGER16,
    INTEGER32,
    UNSIGNED16,
    AbortCode,
    Entry,
    ObjectDictionary,
    SdoAbort,
)
from .homing import ACTUAL_POSITION, STANDARD, Search, Stop, Switches, plan
from .profile import Profile, jog, stop

MAX_SPEED = 500_000_000
STOPS = {-1: Stop(1, False), -2: Stop(-1, False), -3: Stop(1, True), -4: Stop(-1, True)}
START, HALT = 1 << 4, 1 << 8


class Axis(Protocol):
    """What it moves. Counts, counts/ms."""

    velocity_unit: float
    acceleration_unit: float

    @property
    @abstractmethod
    def place(self) -> float: ...

    @abstractmethod
    def demand_now(self) -> tuple[float, float]: ...

    @abstractmethod
    def follow(self, profile: Profile) -> None: ...

    @abstractmethod
    def rename(self, shift: float) -> None:
        """Every position is `shift` more from now on; nothing moves."""


class Homing:
    """The mode, as far as it is not the drive's. `turn` [counts]: from index to index."""

    def __init__(self, axis: Axis, switches: Switches, turn: int) -> None:
        self.machine_zero = 0.0  # where the machine's zero is since homing
        self._axis = axis
        self._switches = switches
        self._turn = turn
        self.reset()

    def build(self, od: ObjectDictionary) -> None:
        """Its objects, as the maker's EDS has them."""
        self._offset = od.variable(0x607C, Entry("Homing offset", INTEGER32, mappable=True))
        self._method = od.variable(
            0x6098, Entry("Homing method", INTEGER8, mappable=True, check=_check_method)
        )
        self._speeds = tuple(
            Entry(f"Homing velocity ({name})", INTEGER32, low=0, high=MAX_SPEED, mappable=True)
            for name in ("fast", "slow")
        )
        od.record(0x6099, *self._speeds)
        self._acceleration = od.variable(
            0x609A, Entry("Homing acceleration", INTEGER32, value=10_000, low=1, mappable=True)
        )
        od.variable(0x2350, Entry("Homing current", INTEGER16, value=100, mappable=True))
        od.variable(
            0x2351, Entry("Delay for hard stop homing mode", UNSIGNED16, value=250, mappable=True)
        )
        od.variable(0x2352, Entry("Homing configuration", INTEGER16, mappable=True))

    def reset(self) -> None:
        """Another mode, or switched off."""
        self._searches: list[Search] = []
        self.attained = self.failed = False

    @property
    def searching(self) -> bool:
        return bool(self._searches)

    def command(self, last: int, word: int) -> None:
        """Bit 4 has to stay while the axis searches."""
        rising = word & ~last
        if rising & HALT or last & ~word & START:
            if self._searches:
                self._searches = []
                self._brake()
        elif rising & START and not word & HALT:
            self.attained = self.failed = False
            method, here = self._method.value, self._axis.place
            if method in ACTUAL_POSITION:
                self._found(here)
            else:
                machine = here - self.machine_zero
                self._searches = plan(method, machine, self._switches, self._turn, STOPS)
                self._begin()

    def watch(self) -> None:
        """Once a control cycle: whether the axis has passed what it is searching."""
        if not self._searches:
            return
        search = self._searches[0]
        machine = self._axis.place - self.machine_zero
        ahead = "positive_limit" if search.direction > 0 else "negative_limit"
        if (machine - search.edge) * search.direction >= 0:
            del self._searches[0]
            if self._searches:
                self._begin()
            else:
                self._found(
                    search.edge + self.machine_zero, self._method.value in STOPS and not search.slow
                )
        elif (machine - getattr(self._switches, ahead)) * search.direction > 0:
            self._searches, self.failed = [], True  # a limit switch before what it searches
            self._brake()

    def _begin(self) -> None:
        search, axis = self._searches[0], self._axis
        speed = self._speeds[search.slow].value * axis.velocity_unit
        acceleration = self._acceleration.value * axis.acceleration_unit
        axis.follow(jog(*axis.demand_now(), search.direction * speed, acceleration))

    def _found(self, place: float, against: bool = False) -> None:
        """`against`: it is a stop, on which the axis stands."""
        shift = -self._offset.value - place
        self.machine_zero += shift
        self._axis.rename(shift)
        self.attained = True
        if against:
            self._axis.follow(stop(self._axis.demand_now()[0], 0.0, 1.0))
        else:
            self._brake()

    def _brake(self) -> None:
        axis = self._axis
        axis.follow(stop(*axis.demand_now(), self._acceleration.value * axis.acceleration_unit))


def _check_method(value: int) -> None:
    """READING: of CiA 402's methods it has those with switches and indexes, and its own."""
    if value not in STANDARD and value not in STOPS and value != 0:
        raise SdoAbort(AbortCode.VALUE_RANGE)
