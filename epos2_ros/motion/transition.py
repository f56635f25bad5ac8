"""Getting every axis from where it is onto a new curve, as soon as its limits let it.

Each axis crosses over on its own, by the quicker of two ways:

- *fading*: the new curve plus the difference between old and new state, which a quintic
  brings to zero, now or as soon as the new curve leaves room for it. It keeps the shape of
  the new curve, and is nothing at all when both agree.
- *catching up*: a ramp to a steady velocity, and a ramp from that onto the position and
  velocity the new curve will have: quick when the speeds differ much, as from standstill.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from epos2_ros.errors import TrajectoryError
from epos2_ros.motion.curve import hermite
from epos2_ros.motion.limits import PLANNED_SHARE, RELATIVE_SLACK, Limits
from epos2_ros.motion.reference import Motion, State

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

GRACE_S = 1.0  # how long after the new curve's end an axis may reach it
_SOON_MS = 100  # who fades within this time needs nothing quicker
_SHORTEST_FADE_MS, _LONGEST_FADE_MS, _LATEST_FADE_MS = 8, 1000, 4000
_FADE_SAMPLES = 48


@dataclass(frozen=True, eq=False)
class Transition:
    """`target`, reached over up to three quintic pieces of its own on every axis.

    Piece i of an axis lies between times_s[i] and times_s[i + 1]; all arrays but the last
    are [4, axes]. On a fading axis the pieces are added to the target, on others they
    stand for it.
    """

    target: Motion
    times_s: Array
    positions: Array
    velocities: Array
    accelerations: Array
    fades: Mask  # [axes]

    @property
    def end_s(self) -> float:
        return max(self.target.end_s, float(self.times_s[-1].max()))

    def evaluate(self, t_s: Array, derivative: int = 0) -> Array:
        """Position or its 1st or 2nd derivative at path times t_s [m] → [m, axes]."""
        value = self.target.evaluate(t_s, derivative)
        rows = t_s < self.times_s[-1].max()
        if not rows.any():
            return value
        t = t_s[rows, None]
        i = np.add(t >= self.times_s[1], t >= self.times_s[2], dtype=np.intp)
        start, end = self._at(self.times_s, i)
        h = np.maximum(end - start, 1e-9)  # empty pieces are never the one asked for
        ends = tuple(self._at(v, i) for v in (self.positions, self.velocities, self.accelerations))
        own = hermite(np.clip((t - start) / h, 0, 1), h, ends, derivative)
        own += np.where(self.fades, value[rows], 0.0)
        value[rows] = np.where(t < self.times_s[-1], own, value[rows])
        return value

    def where(self, mine: Mask, other: Transition) -> Transition:
        """This way onto the target for the axes `mine`, the other's for the rest."""
        arrays = (field.name for field in fields(self)[1:])
        return Transition(
            self.target,
            *(np.where(mine, getattr(self, name), getattr(other, name)) for name in arrays),
        )

    @staticmethod
    def _at(values: Array, i: NDArray[np.intp]) -> tuple[Array, Array]:
        return np.take_along_axis(values, i, axis=0), np.take_along_axis(values, i + 1, axis=0)


def resting_place(state: State, limits: Limits) -> Array:
    """Where the axes stand when they slow down at once, each on its own [axes]."""
    still = np.zeros_like(state.velocity)
    _, way = _ramp(state.velocity, state.acceleration, still, limits.agility * PLANNED_SHARE)
    return state.position + way


def cross(
    target: Motion,
    state: State,
    limits: Limits,
    at_s: float,
    same: Callable[[State], Mask],
    earliest_s: float = 0.0,
    grace_s: float = GRACE_S,
) -> Motion:
    """From `state` at path time `at_s` onto `target`, not before `earliest_s` after it.

    Axes that are the `same` as the target's state there [axes] need no crossing. Raises
    TrajectoryError when an axis can't get there before `target` ends, give or take `grace_s`.
    """
    there = State.of(target, at_s)
    gap = State(*(a - b for a, b in zip(state, there, strict=True)))
    apart = ~same(there)
    if not apart.any():
        return target
    earliest_ms = round(earliest_s * 1000)
    latest_ms = round((max(target.end_s - at_s, earliest_s) + grace_s) * 1000)
    room = _Room.beside(target, state, limits, at_s, earliest_ms + _SOON_MS)
    way, found = _fading(room, gap, np.where(apart, np.inf, at_s), earliest_ms)
    if not found.all():
        chase, caught = _catching_up(target, state, limits, at_s, earliest_ms, latest_ms)
        before_s = np.where(apart, np.where(caught, chase.times_s[-1], np.inf), at_s)
        longest_ms = max(_LATEST_FADE_MS, earliest_ms + _SOON_MS)
        window_ms = min(latest_ms, longest_ms, (np.max(before_s) - at_s) * 1000)
        room = _Room.beside(target, state, limits, at_s, round(window_ms))
        caught &= room.holds(chase)
        before_s[apart & ~caught] = np.inf
        fade, faded = _fading(room, gap, before_s, earliest_ms)
        faded &= room.holds(fade)
        way, found = fade.where(faded, chase), faded | caught
    for joint in np.flatnonzero(~found):
        unit = limits.units[joint]
        raise TrajectoryError(
            f"joint '{limits.joints[joint]}' can't get onto the trajectory within its limits: "
            f"{gap.position[joint]:.4g} {unit} and {gap.velocity[joint]:.4g} {unit}/s from it "
            f"when it takes over"
        )
    return way


@dataclass(frozen=True, eq=False)
class _Room:
    """What the limits leave around a target at every millisecond of a window.

    Where the target itself, or the axis when it takes over, is beyond the limits' share,
    that is the bound. `there`, `low` and `high` hold position, velocity and acceleration,
    each [window_ms + 1, axes].
    """

    target: Motion
    at_s: float
    there: tuple[Array, ...]
    low: tuple[Array, ...]
    high: tuple[Array, ...]

    @classmethod
    def beside(
        cls, target: Motion, state: State, limits: Limits, at_s: float, window_ms: int
    ) -> _Room:
        speed, acceleration = _allowed(state, limits)
        t_s = at_s + np.arange(window_ms + 1) / 1000
        there = tuple(target.evaluate(t_s, order) for order in range(3))
        lows = np.minimum(limits.lower, state.position), -speed, -acceleration
        highs = np.maximum(limits.upper, state.position), speed, acceleration
        low = (bound - RELATIVE_SLACK * np.abs(bound) for bound in lows)
        high = (bound + RELATIVE_SLACK * np.abs(bound) for bound in highs)
        return cls(
            target,
            at_s,
            there,
            tuple(np.minimum(bound, value) for bound, value in zip(low, there, strict=True)),
            tuple(np.maximum(bound, value) for bound, value in zip(high, there, strict=True)),
        )

    def of(self, axes: Mask) -> _Room:
        """The same for some of the axes."""
        there, low, high = (
            tuple(value[:, axes] for value in values)
            for values in (self.there, self.low, self.high)
        )
        return _Room(self.target, self.at_s, there, low, high)

    @property
    def window_ms(self) -> int:
        return len(self.there[0]) - 1

    def admits(self, order: int, ms: NDArray[np.intp], beside: Array) -> Mask:
        """Whether the `order`-th derivative at `ms` may be this much beside the target's."""
        value = self.there[order][ms] + beside
        return (value >= self.low[order][ms]) & (value <= self.high[order][ms])

    def holds(self, way: Transition) -> Mask:
        """Whether a way onto the target keeps its bounds in the whole window [axes]."""
        ms = np.arange(self.window_ms + 1)
        result = np.ones(self.there[0].shape[1], dtype=bool)
        for order in range(3):
            value = way.evaluate(self.at_s + ms / 1000, order)
            result &= self.admits(order, ms, value - self.there[order]).all(axis=0)
        return result


def _fading(room: _Room, gap: State, before_s: Array, earliest_ms: int) -> tuple[Transition, Mask]:
    """The earliest fades in the window that end before `before_s`, and which axes have one.

    Axes that have no time before `before_s` have nothing to fade, either.
    """
    axes = before_s > room.at_s
    position, velocity, bend = (value[axes] for value in gap)
    mine = room.of(axes)
    ms = np.arange(room.window_ms + 1)
    # Until it fades, the difference stays, or grows with that of the velocities.
    stays = mine.admits(0, ms, position + velocity * (ms / 1000)[:, None])
    may_wait = np.logical_and.accumulate(stays & mine.admits(1, ms, velocity))
    may_wait[0] = True
    waits = np.unique(np.geomspace(1, room.window_ms, 20).astype(int)) - 1
    wait_ms = np.zeros(len(position), dtype=int)
    end_ms = (before_s[axes] - room.at_s) * 1000
    found = np.zeros(len(position), dtype=bool)
    for fade_ms in _fade_durations(earliest_ms, room.window_ms):
        latest = min(np.max(end_ms, initial=0), room.window_ms) - fade_ms
        wait = waits[(waits >= earliest_ms - fade_ms) & (waits <= latest)]
        if len(wait) == 0:
            continue
        sample = np.unique(np.linspace(0, fade_ms, _FADE_SAMPLES + 1).astype(int))
        waited_s = (wait / 1000)[:, None, None]
        ends = (
            (position + velocity * waited_s, np.zeros(1)),
            (velocity, np.zeros(1)),
            (np.where(waited_s == 0, bend, 0.0), np.zeros(1)),
        )
        fits = may_wait[wait]
        for order in (2, 1, 0):
            if not fits.any():
                break
            beside = hermite((sample / fade_ms)[:, None], np.array(fade_ms / 1000), ends, order)
            if order == 2:  # a quintic's peaks may lie between the samples
                beside *= 1 + 5 / (len(sample) - 1) ** 2
            fits &= mine.admits(order, wait[:, None] + sample, beside).all(axis=1)
        first = fits.argmax(axis=0)
        better = fits.any(axis=0) & (wait[first] + fade_ms < end_ms)
        wait_ms[better] = wait[first][better]
        end_ms[better] = wait_ms[better] + fade_ms
        found |= better
    wait_s, end_s, fades = np.zeros(len(axes)), np.zeros(len(axes)), ~axes
    wait_s[axes], end_s[axes], fades[axes] = (
        wait_ms / 1000,
        np.where(found, end_ms / 1000, 0.0),
        found,
    )
    none = np.zeros(len(axes))
    way = Transition(
        room.target,
        room.at_s + np.stack((none, wait_s, end_s, end_s)),
        np.stack((gap.position, gap.position + gap.velocity * wait_s, none, none)),
        np.stack((gap.velocity, gap.velocity, none, none)),
        np.stack((none, np.where(wait_s == 0, gap.acceleration, 0.0), none, none)),
        np.ones(len(axes), dtype=bool),
    )
    return way, fades


def _fade_durations(earliest_ms: int, window_ms: int) -> NDArray[np.intp]:
    shortest = max(earliest_ms, _SHORTEST_FADE_MS)
    longest = min(max(earliest_ms, _LONGEST_FADE_MS), window_ms)
    if longest < shortest:
        return np.empty(0, dtype=np.intp)
    return np.unique(np.geomspace(shortest, longest, 12).astype(np.intp))


def _catching_up(
    target: Motion,
    state: State,
    limits: Limits,
    at_s: float,
    earliest_ms: int,
    latest_ms: int,
) -> tuple[Transition, Mask]:
    """The earliest catch-up of every axis, and which axes have one."""
    speed, acceleration = _allowed(state, limits)
    after_s = _candidates(earliest_ms, latest_ms)
    there = [target.evaluate(at_s + after_s, order) for order in range(3)]

    def distance(w: Array, t: Array, v1: Array, a1: Array) -> Array:
        """How far an axis gets when its steady velocity is w."""
        first, first_way = _ramp(state.velocity, state.acceleration, w, acceleration)
        last, last_way = _ramp(v1, -a1, w, acceleration)
        return first_way + last_way + w * (t - first - last)

    # Steady velocities that leave time for both ramps, [candidates, axes].
    t = after_s[:, None]
    room = t * acceleration / 1.5
    middle = (state.velocity + there[1]) / 2
    slowest = np.maximum(middle - room / 2, -speed)
    fastest = np.minimum(middle + room / 2, speed)
    goal = there[0] - state.position
    fits = (
        (np.abs(there[1] - state.velocity) <= room)
        & (distance(slowest, t, there[1], there[2]) <= goal)
        & (distance(fastest, t, there[1], there[2]) >= goal)
    )
    first, each = fits.argmax(axis=0), np.arange(len(speed))
    t = after_s[first]
    position, v1, a1 = (value[first, each] for value in there)
    slow, fast = slowest[first, each], fastest[first, each]
    for _ in range(50):
        w = (slow + fast) / 2
        short = distance(w, t, v1, a1) < position - state.position
        slow, fast = np.where(short, w, slow), np.where(short, fast, w)
    h0, way0 = _ramp(state.velocity, state.acceleration, w, acceleration)
    h1, way1 = _ramp(v1, -a1, w, acceleration)
    none = np.zeros_like(w)
    way = Transition(
        target,
        at_s + np.stack((none, h0, t - h1, t)),
        np.stack((state.position, state.position + way0, position - way1, position)),
        np.stack((state.velocity, w, w, v1)),
        np.stack(
            (
                _usable(state.acceleration, w - state.velocity, acceleration),
                none,
                none,
                -_usable(-a1, w - v1, acceleration),
            )
        ),
        np.zeros(len(w), dtype=bool),
    )
    return way, np.asarray(fits.any(axis=0))


def _allowed(state: State, limits: Limits) -> tuple[Array, Array]:
    """Speed and acceleration to keep; what the axis does already is allowed to go on."""
    return (
        np.maximum(limits.velocity * PLANNED_SHARE, np.abs(state.velocity)),
        np.maximum(limits.agility * PLANNED_SHARE, np.abs(state.acceleration)),
    )


def _candidates(earliest_ms: int, latest_ms: int) -> Array:
    """Durations to try [s]: every millisecond for half a second, then in steps of 2 %."""
    every = np.concatenate((np.arange(1, 501), (500 * 1.02 ** np.arange(1, 400)).round()))
    every += max(earliest_ms - 1, 0)
    return every[every <= latest_ms] / 1000


def _ramp(v: Array, a: Array, w: Array, acceleration: Array) -> tuple[Array, Array]:
    """Duration and distance of a change of speed from v to w, with cubic velocity.

    It starts with the acceleration the axis has if that points the way to go, else with
    none, and ends with none. The peak of such a cubic is 1.5 times its mean slope (less if
    it starts with an acceleration).
    """
    duration = 1.5 * np.abs(w - v) / acceleration
    start = _usable(a, w - v, acceleration)
    return duration, duration * (v + w) / 2 + start * duration**2 / 12


def _usable(a: Array, change: Array, acceleration: Array) -> Array:
    return np.where(a * change > 0, np.clip(a, -acceleration, acceleration), 0.0)
