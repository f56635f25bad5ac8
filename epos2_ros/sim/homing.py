"""Homing methods of CiA 402 as a list of moves, for an axis whose switches are known.

Positions are those of the machine, in qc: they stay when homing gives the axis a new zero.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

ACTUAL_POSITION = (35, 37)
STANDARD = (1, 2, 7, 11, 17, 18, 23, 27, 33, 34, *ACTUAL_POSITION)


class Stop(NamedTuple):
    """A maker's method against a mechanical stop: which way, and whether back to an index."""

    direction: int
    to_index: bool


@dataclass(frozen=True)
class Switches:
    """Where the machine's switches change; without one a search for it never ends.

    The negative limit switch is active below its position, the positive one above; the home
    switch between its two. The index pulse comes once per motor turn, first at `index`.
    """

    negative_limit: float = -math.inf
    positive_limit: float = math.inf
    home: tuple[float, float] = (math.inf, -math.inf)
    index: float = 0.0
    negative_stop: float = -math.inf  # mechanical: the current rises to its threshold there
    positive_stop: float = math.inf


class Search(NamedTuple):
    """Move in `direction` until `edge` is passed."""

    direction: int
    edge: float
    slow: bool


def plan(
    method: int,
    position: float,
    switches: Switches,
    counts_per_turn: int,
    stops: Mapping[int, Stop] = MappingProxyType({}),
) -> list[Search]:
    """The searches of a homing method from `position` on; the last edge is home (CiA 402).

    `stops` are the methods that the drive's maker has besides.

    Methods 1, 2, 7 and 11 go on to the next index pulse after what 17, 18, 23 and 27 do; 33
    and 34 look for an index pulse alone; 35 and 37 take the position as it is.
    """
    if method in stops:
        return _at_the_stop(stops[method], switches, counts_per_turn)
    low, high = switches.home
    searches: list[Search] = []
    if method in (1, 17):
        searches = _off_the_limit(-1, switches.negative_limit, position)
    elif method in (2, 18):
        searches = _off_the_limit(1, switches.positive_limit, position)
    elif method in (7, 23):
        searches = _off_home(1, low, high, switches.positive_limit, position)
    elif method in (11, 27):
        searches = _off_home(-1, high, low, switches.negative_limit, position)
    if method in (1, 2, 7, 11, 33, 34):
        if method < 33:
            direction, start = searches[-1].direction, searches[-1].edge
        else:
            direction, start = -1 if method == 33 else 1, position
        if math.isfinite(start):
            turns = (start - switches.index) / counts_per_turn
            turn = math.floor(turns) + 1 if direction > 0 else math.ceil(turns) - 1
            start = switches.index + turn * counts_per_turn
        searches.append(Search(direction, start, True))
    return searches


def _at_the_stop(method: Stop, switches: Switches, counts_per_turn: int) -> list[Search]:
    """Against a mechanical stop; with an index, back to the first one off it."""
    direction, to_index = method
    stop = switches.positive_stop if direction > 0 else switches.negative_stop
    searches = [Search(direction, stop, False)]
    if to_index and math.isfinite(stop):
        turns = (stop - switches.index) / counts_per_turn
        turn = math.ceil(turns) - 1 if direction > 0 else math.floor(turns) + 1
        searches.append(Search(-direction, switches.index + turn * counts_per_turn, True))
    return searches


def _off_the_limit(direction: int, edge: float, position: float) -> list[Search]:
    """Onto a limit switch fast, unless the axis stands on it; off it slowly."""
    off = Search(-direction, edge, True)
    return [off] if (position - edge) * direction > 0 else [Search(direction, edge, False), off]


def _off_home(
    direction: int, near: float, far: float, limit: float, position: float
) -> list[Search]:
    """Onto the home switch in `direction`, off it over the edge it has on this side.

    An axis beyond the switch turns at the limit switch and comes back to it.
    """
    off = Search(-direction, near, True)
    if (position - far) * direction > 0:
        return [Search(direction, limit, False), Search(-direction, far, False), off]
    if (position - near) * direction > 0:
        return [off]
    return [Search(direction, near, False), off]
