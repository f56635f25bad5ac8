"""Getting every axis from where it is onto a new curve, as soon as its limits let it.

Each axis crosses over on its own, by the quicker of two ways:

- *fading*: the new curve plus its difference from the old state, which a quintic brings to
  zero. It keeps the shape of the new curve and is nothing at all when both agree.
- *catching up*: a ramp to a steady velocity, and a ramp from that onto the position and
  velocity the new curve will have: quick when the speeds differ much, as from standstill.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from epos2_ros.errors import TrajectoryError
from epos2_ros.motion.curve import hermite
from epos2_ros.motion.limits import Limits
from epos2_ros.motion.reference import Motion, State

Array = NDArray[np.float64]

GRACE_S = 1.0  # how long after the new curve's end an axis may reach it
_LONGEST_FADE_S = 2.0
_SHARE = 0.999  # of the limits, for what lies between the instants looked at


@dataclass(frozen=True, eq=False)
class Crossing:
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
    fades: NDArray[np.bool_]  # [axes]

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
        i = (t >= self.times_s[1]).astype(np.intp) + (t >= self.times_s[2])
        start, end = self._at(self.times_s, i)
        h = np.maximum(end - start, 1e-9)  # empty pieces are never the one asked for
        ends = tuple(self._at(v, i) for v in (self.positions, self.velocities, self.accelerations))
        own = hermite(np.clip((t - start) / h, 0, 1), h, ends, derivative)
        crossing = t < self.times_s[-1]
        value[rows] = np.where(crossing, own + np.where(self.fades, value[rows], 0.0), value[rows])
        return value

    @staticmethod
    def _at(values: Array, i: NDArray[np.intp]) -> tuple[Array, Array]:
        return np.take_along_axis(values, i, axis=0), np.take_along_axis(values, i + 1, axis=0)


def resting_place(state: State, limits: Limits) -> Array:
    """Where the axes stand when they slow down at once, each on its own [axes]."""
    still = np.zeros_like(state.velocity)
    _, way = _ramp(state.velocity, state.acceleration, still, limits.agility)
    return state.position + way


def cross(
    target: Motion,
    state: State,
    limits: Limits,
    at_s: float,
    same: tuple[Array, Array],
    earliest_s: float = 0.0,
) -> Motion:
    """From `state` at path time `at_s` onto `target`, not before `earliest_s` after it.

    Differences of position and velocity up to `same` [axes] count as none. Raises
    TrajectoryError when an axis can't get there before `target` ends, give or take GRACE_S.
    """
    there = State.of(target, at_s)
    gap = State(*(a - b for a, b in zip(state, there, strict=True)))
    apart = (np.abs(gap.position) > same[0]) | (np.abs(gap.velocity) > same[1])
    if not apart.any():
        return target
    latest_s = max(target.end_s - at_s, earliest_s) + GRACE_S
    fading_s = _fading(target, state, gap, limits, at_s, (earliest_s, latest_s))
    catching = _catching_up(target, state, limits, at_s, (earliest_s, latest_s))
    chasing_s = catching.times_s[-1] - at_s
    for joint in np.flatnonzero(apart & np.isinf(fading_s) & np.isinf(chasing_s)):
        unit = limits.units[joint]
        raise TrajectoryError(
            f"joint '{limits.joints[joint]}' can't get onto the trajectory within its limits: "
            f"it is {gap.position[joint]:.4g} {unit} off and {gap.velocity[joint]:.4g} {unit}/s "
            f"too fast when it takes over"
        )
    fades = (fading_s <= chasing_s) | ~apart
    end = np.where(apart, at_s + fading_s, at_s)
    faded = np.stack([np.full_like(end, at_s), end, end, end])

    def merge(start: Array, chased: Array) -> Array:
        return np.where(fades, np.stack([start, *np.zeros((3, len(end)))]), chased)

    return Crossing(
        target,
        np.where(fades, faded, catching.times_s),
        merge(gap.position, catching.positions),
        merge(gap.velocity, catching.velocities),
        merge(gap.acceleration, catching.accelerations),
        fades,
    )


def _fading(
    target: Motion,
    state: State,
    gap: State,
    limits: Limits,
    at_s: float,
    window_s: tuple[float, float],
) -> Array:
    """Shortest fade on every axis [axes] [s]; inf where none keeps the limits."""
    speed, acceleration = _allowed(state, limits)
    shortest_ms = max(int(np.ceil(window_s[0] * 1000)), 2)
    longest_ms = max(int(min(window_s[1], max(_LONGEST_FADE_S, window_s[0])) * 1000), shortest_ms)
    instants = np.arange(longest_ms + 1) / 1000
    there = [target.evaluate(at_s + instants, derivative) for derivative in range(3)]
    bounds = (
        (np.minimum(limits.lower, there[0]), np.maximum(limits.upper, there[0])),
        (-np.maximum(speed, np.abs(there[1])), np.maximum(speed, np.abs(there[1]))),
        (-np.maximum(acceleration, np.abs(there[2])), np.maximum(acceleration, np.abs(there[2]))),
    )
    ends = tuple((value, np.zeros_like(value)) for value in gap)
    result = np.full(len(limits.joints), np.inf)
    for ms in np.unique(np.geomspace(shortest_ms, longest_ms, 60).round().astype(int)):
        h = ms / 1000
        u = (instants[: ms + 1] / h)[:, None]
        fits = np.isinf(result)
        for derivative, (low, high) in enumerate(bounds):
            value = there[derivative][: ms + 1] + hermite(u, np.array(h), ends, derivative)
            fits &= ((value >= low[: ms + 1]) & (value <= high[: ms + 1])).all(axis=0)
        result[fits] = h
        if np.isfinite(result).all():
            break
    return result


def _catching_up(
    target: Motion, state: State, limits: Limits, at_s: float, window_s: tuple[float, float]
) -> Crossing:
    """Earliest catch-up on every axis; its times are inf where none keeps the limits."""
    speed, acceleration = _allowed(state, limits)
    after_s = _candidates(*window_s)
    there = [target.evaluate(at_s + after_s, derivative) for derivative in range(3)]

    def way(w: Array, t: Array, v1: Array, a1: Array) -> tuple[Array, Array, Array]:
        """Distance when the steady velocity is w, and the durations of both ramps."""
        first, first_way = _ramp(state.velocity, state.acceleration, w, acceleration)
        last, last_way = _ramp(v1, -a1, w, acceleration)
        return first_way + last_way + w * (t - first - last), first, last

    # Steady velocities that leave time for both ramps, [candidates, axes].
    t = after_s[:, None]
    room = t * acceleration / 1.5
    middle = (state.velocity + there[1]) / 2
    slowest = np.maximum(middle - room / 2, -speed)
    fastest = np.minimum(middle + room / 2, speed)
    distance = there[0] - state.position
    fits = (
        (np.abs(there[1] - state.velocity) <= room)
        & (way(slowest, t, there[1], there[2])[0] <= distance)
        & (way(fastest, t, there[1], there[2])[0] >= distance)
    )
    first = fits.argmax(axis=0)
    each = np.arange(len(first))
    t = after_s[first]
    position, v1, a1 = (value[first, each] for value in there)
    slow, fast = slowest[first, each], fastest[first, each]
    for _ in range(60):
        w = (slow + fast) / 2
        short = way(w, t, v1, a1)[0] < position - state.position
        slow, fast = np.where(short, w, slow), np.where(short, fast, w)
    _, h0, h1 = way(w, t, v1, a1)
    a0, a1 = (
        _usable(state.acceleration, w - state.velocity, acceleration),
        -_usable(-a1, w - v1, acceleration),
    )
    way0 = _ramp(state.velocity, state.acceleration, w, acceleration)[1]
    after = position - _ramp(v1, -a1, w, acceleration)[1]
    none = np.zeros_like(w)
    result = Crossing(
        target,
        at_s + np.stack([none, h0, t - h1, t]),
        np.stack([state.position, state.position + way0, after, position]),
        np.stack([state.velocity, w, w, v1]),
        np.stack([a0, none, none, a1]),
        np.zeros(len(w), dtype=bool),
    )
    inside = _stays_inside(result, limits, at_s, float(np.max(t)))
    result.times_s[-1, ~(fits.any(axis=0) & inside)] = np.inf
    return result


def _stays_inside(
    crossing: Crossing, limits: Limits, at_s: float, duration_s: float
) -> NDArray[np.bool_]:
    """Whether the way keeps the position limits, or does so as well as its ends do [axes]."""
    way = crossing.evaluate(at_s + np.arange(int(duration_s * 1000) + 1) / 1000)
    ends = crossing.positions[[0, -1]]
    slack = 1e-6 * (limits.upper - limits.lower)
    low = np.minimum(limits.lower, ends.min(axis=0)) - slack
    high = np.maximum(limits.upper, ends.max(axis=0)) + slack
    return np.all((way >= low) & (way <= high), axis=0)


def _allowed(state: State, limits: Limits) -> tuple[Array, Array]:
    """Speed and acceleration to keep; what the axis does already is allowed to go on."""
    return (
        np.maximum(limits.velocity * _SHARE, np.abs(state.velocity)),
        np.maximum(limits.agility * _SHARE, np.abs(state.acceleration)),
    )


def _candidates(earliest_s: float, latest_s: float) -> Array:
    """Durations to try [s]: every millisecond for half a second, then in steps of 2 %."""
    fine = np.arange(1, 501)
    coarse = 500 * 1.02 ** np.arange(1, 400)
    every = earliest_s + np.concatenate((fine, coarse.round())) / 1000
    return every[every <= latest_s]


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
