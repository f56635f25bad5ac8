"""The best an axis of set-points could do: the smallest largest error of all on a fine grid.

Dynamic programming, compiled by Numba, apart from the driver's search and with the whole motion
known. A state is a time, how far off the axis is and how much too fast; from every one that can be
reached all others within the longest set-point are tried. Velocities and accelerations are any
numbers, where a drive has whole units only; all else a drive keeps (`epos2_ros.motion.setpoints`)
is kept.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from epos2_ros.motion.setpoints import SetPointAxis

Array = NDArray[np.float64]
GRID_MS = 10
OFFS, SPEEDS = 13, 25  # numbers of levels; odd
PER_OFF = 0.1  # velocities are off by so much of the largest error per ms, at most
HOLDS, RAMPS = 24, 6  # velocities held and ramps that are tried where a set-point ends at rest,
SLOW_MS = 10.0  # where the curve takes longer than this for the largest error
STANDS_QC = 0.5
ENOUGH = 0.98


def smallest_error(
    position_qc: Array,
    velocity_qc_s: Array,
    axis: SetPointAxis,
    longest_ms: int,
    known_qc: float,
) -> float:
    """Of one axis [qc]; `known_qc` is an error that can be kept, beyond which nothing is tried.

    The commanded curve is given at k = 0 … end [ms]; the motion begins and ends at rest.
    """
    stretch = np.full(2 * longest_ms, position_qc[-1])  # it may come to rest a little later
    x = np.concatenate((position_qc, stretch))
    v = np.concatenate((velocity_qc_s * 1e-3, np.zeros(len(stretch))))
    end = math.ceil((len(position_qc) - 1) / GRID_MS)
    limits = (
        axis.max_velocity_qc_s * 1e-3,
        axis.max_acceleration_qc_s2 * 1e-6,
        float(axis.feeding_ms),
        round(axis.sync_ms / GRID_MS),
    )
    best_qc = known_qc
    while True:  # the levels lie the closer, the less is known to be enough
        known_qc, best_qc = (
            best_qc,
            float(_search(x, v, end, *limits, longest_ms // GRID_MS, best_qc)),
        )
        if best_qc > known_qc * ENOUGH:
            return best_qc


@njit(cache=True, fastmath=True)
def _search(x, v, end, fastest, steepest, feeding, sync, longest, known):  # type: ignore[no-untyped-def]
    times = end + longest + 1
    offs = np.linspace(-known, known, OFFS)
    speeds = np.linspace(-known * PER_OFF, known * PER_OFF, SPEEDS)
    moving = np.full((times, OFFS, SPEEDS), np.inf)
    resting = np.full((times, OFFS), np.inf)
    resting[0, OFFS // 2] = 0.0
    best = known
    for i in range(times):
        k = i * GRID_MS
        for off in range(OFFS):
            p = x[k] + offs[off]
            so_far = resting[i, off]
            if so_far < best:
                if abs(p - x[-1]) <= STANDS_QC:
                    best = min(best, max(so_far, _stands(x, k, len(x) - 1, p)))
                _wait(x, resting, i, off, sync, times, offs, so_far, best)
                _go_on(
                    x, v, moving, resting, i, p, 0.0, so_far, offs, speeds,
                    fastest, steepest, feeding, longest, times, best,
                )  # fmt: skip
            for fast in range(SPEEDS):
                so_far = moving[i, off, fast]
                speed = v[k] + speeds[fast]
                if so_far < best:
                    _go_on(
                        x, v, moving, resting, i, p, speed, so_far, offs, speeds,
                        fastest, steepest, feeding, longest, times, best,
                    )  # fmt: skip
    return best


@njit(cache=True, fastmath=True)
def _stands(x, k, to, p):  # type: ignore[no-untyped-def]
    most = 0.0
    for i in range(k, to + 1):
        most = max(most, abs(x[i] - p))
    return most


@njit(cache=True, fastmath=True)
def _wait(x, resting, i, off, sync, times, offs, so_far, best):  # type: ignore[no-untyped-def]
    """Stand until the next SYNC."""
    j = (i // sync + 1) * sync
    if j >= times:
        return
    p = x[i * GRID_MS] + offs[off]
    worst = max(so_far, _stands(x, i * GRID_MS, j * GRID_MS, p))
    if worst < best:
        away = p - x[j * GRID_MS]
        to = int(round((away - offs[0]) / (offs[1] - offs[0])))
        if 0 <= to < len(offs):
            resting[j, to] = min(resting[j, to], worst)


@njit(cache=True, fastmath=True)
def _go_on(  # type: ignore[no-untyped-def]
    x, v, moving, resting, i, p, speed, so_far, offs, speeds,
    fastest, steepest, feeding, longest, times, best,
):  # fmt: skip
    k = i * GRID_MS
    for j in range(i + 1, min(i + longest, times - 1) + 1):
        ms = (j - i) * GRID_MS
        for off in range(len(offs)):
            way = x[j * GRID_MS] + offs[off] - p
            sign = 1.0 if speed > 0.0 or (speed == 0.0 and way > 0.0) else -1.0
            way *= sign
            v0 = speed * sign
            if way <= 0.0 or v0 * v0 > 2 * steepest * way:
                continue
            if abs(v[j * GRID_MS]) * SLOW_MS < best:
                _rest(x, resting, k, j, off, p, sign, way, v0, ms, so_far, fastest, steepest, best)
            if ms < feeding:
                continue
            for fast in range(len(speeds)):
                v1 = (v[j * GRID_MS] + speeds[fast]) * sign
                if v1 <= 0.0 or v1 > fastest or moving[j, off, fast] <= so_far:
                    continue
                if v1 == v0:
                    continue
                ramp = 2 * (v1 * ms - way) / (v1 - v0)
                if not 0.0 < ramp <= ms:
                    continue
                rate = (v1 - v0) / ramp
                if abs(rate) > steepest:
                    continue
                down = steepest
                if rate < 0.0:
                    down = -rate
                    if v0 * v0 > 2 * down * way:
                        continue
                stop = v1 * v1 / (2 * down)
                ramp_way = (v0 + v1) / 2 * ramp
                if rate < 0.0 or ramp_way + stop <= way:
                    brakes = ramp + (way - ramp_way - stop) / v1
                else:
                    so_long = (way - v0 * v0 / (2 * down)) / (1 + rate / down)
                    brakes = (math.sqrt(v0 * v0 + 2 * rate * so_long) - v0) / rate
                if brakes < feeding:
                    continue
                worst = max(so_far, abs(offs[off]))
                limit = min(best, moving[j, off, fast])
                step = max(1, ms // 16)
                for t in range(step, ms, step):
                    if worst >= limit:
                        break
                    at = v0 * t + rate * t * t / 2 if t < ramp else way - v1 * (ms - t)
                    worst = max(worst, abs(p + sign * at - x[k + t]))
                if worst < limit:
                    moving[j, off, fast] = worst


@njit(cache=True, fastmath=True)
def _rest(  # type: ignore[no-untyped-def]
    x, resting, k, j, off, p, sign, way, v0, ms, so_far, fastest, steepest, best
):
    """Set-points that end at rest."""
    mean = way / ms
    for hold in range(2 * HOLDS):
        slows = hold < HOLDS
        top = v0 * (hold + 1) / HOLDS if slows else mean * (1.0 + (hold - HOLDS + 0.5) / HOLDS)
        if top <= 0.0 or (not slows and top <= v0):
            continue
        if top > fastest:
            continue
        for part in range(1 if slows else RAMPS):
            if slows:
                bottom = way - top * ms
                down = (v0 * v0 / 2 - top * v0) / bottom if bottom != 0.0 else -1.0
                if down <= 0.0 or down > steepest or v0 / down > ms:
                    continue
                rate, ramp = -down, (v0 - top) / down
            else:
                ramp = ms * (part + 0.5) / RAMPS * 0.8
                rest = v0 * ramp / 2 + top * (ms - ramp / 2) - way
                if rest <= 0.0:
                    continue
                down, rate = top * top / (2 * rest), (top - v0) / ramp
                if down > steepest or rate > steepest or ramp + top / down > ms:
                    continue
            brakes = ms - top / down
            worst = max(so_far, abs(p + sign * way - x[j * GRID_MS]))
            limit = min(best, resting[j, off])
            step = max(1, ms // 16)
            for t in range(step, ms, step):
                if worst >= limit:
                    break
                if t < ramp:
                    at = v0 * t + rate * t * t / 2
                elif t < brakes:
                    at = way - top * top / (2 * down) - top * (brakes - t)
                else:
                    at = way - down * (ms - t) ** 2 / 2
                worst = max(worst, abs(p + sign * at - x[k + t]))
            if worst < limit:
                resting[j, off] = worst
