"""The search for the next knot of one axis: where a segment can end, and which end is best.

From a knot (p₀, v₀) every cubic is p₀ + v₀·t + b·t² + a·t³. To stay within the tolerance of the
commanded position p at a millisecond t it has to satisfy

    (p(t) − tolerance − p₀ − v₀·t)/t²  ≤  b + a·t  ≤  (p(t) + tolerance − p₀ − v₀·t)/t².

So a cubic is a straight line b + a·t, and every millisecond is a window that it must pass through:

- the segment can last as long as a line passes through all windows. Of those that do, two are
  kept: the one that gets highest and the one that gets lowest; a window beyond both is the end, one
  between them turns them (O'Rourke, "An on-line algorithm for fitting straight lines between data
  ranges", Communications of the ACM 24, 1981);
- the cubics that end at time T and position P are the lines through one point, of which every
  window before leaves an interval of slopes: an interval of velocities at the end, of which the
  whole ones are candidates.

Of the candidates the furthest of each class is tried (a class is: below or above the commanded
position, and by how much faster or slower). Chosen is not the longest segment but the one from
whose end the *next* segment gets furthest, because rounded positions and velocities tilt what
follows. Two ends are carried on side by side; a segment later it shows which was better.

What roughness costs is subtracted from how far an end gets: the squared acceleration of the
deviation, summed over the segment.

The search looks at the windows of a few milliseconds of a segment only; a segment is taken when
the exact check, at every millisecond and with the drive's limits, passes.

When an axis comes to rest for at least a longest segment, the search ends where the rest begins,
as if it were the end of the motion, and the rest is kept exactly.

What is committed must lead on whatever the commanded curve is replaced by. So a deviation at a
knot may grow no faster than the acceleration that a drive's limits leave can turn it before the
tolerance. Where the ways found lead nowhere all the same, the search goes back to the committed
knot, and by dynamic programming over a grid of times along knots next to the commanded curve.

At a tolerance of half a count that may be in vain, too: where a curve passes half of a count by a
thousandth of one and turns back, both counts are too far away within a few milliseconds, in which
no drive gets from one to the other. There the tolerance is widened, by half a count at most, as
little as needed; a plan tells how far off each segment is.

Units: ms, qc, qc/ms; velocities of knots are whole drive velocity units.

This is scalar code for `motion/compiled`, and so one module.
"""

from __future__ import annotations

import pathlib
from math import ceil, floor, inf, sqrt
from typing import Any, NamedTuple

from epos2_ros.motion.compiled import COMPILED, Vector, compiled, inlined, room, vector

DEPTH = 3  # segments looked ahead, the one to be committed included
WIDTH = 2  # ways on that are carried along
KNOT = 3  # numbers per knot: path time [ms], position [qc], velocity [units]
_DEBT = KNOT * (DEPTH + 1)  # in a way: its knots, the committed one first, and its debt [ms]
_WAY = _DEBT + 1
PLAN = WIDTH * _WAY + 5  # numbers of a plan: its ways, the best first, and
_WAYS = WIDTH * _WAY
_KNOWN = _WAYS + 1
_COMPLETE = _WAYS + 2
_REST = _WAYS + 3
OFF = _WAYS + 4
# how many ways there are, how many segments of each, whether they reach the end, the path time up
# to which the axis rests, and how far off the last segment committed gets [qc]

_LEVELS = 5  # classes of velocities on either side of the commanded one, at least a unit apart,
_LEVEL = 4.0  # this many tolerances per length of the segment otherwise
_SMOOTHER = 4  # ms between ends of a class that are looked at for being smoother
_SIDES = 4  # below and above the commanded position, far and near
_CLASSES = _SIDES * (2 * _LEVELS + 1)
_BETWEEN = 0.98  # share of the tolerance used where only some milliseconds are looked at
_ROUNDED_END = 0.95  # share used for how far the next segment gets: its end is rounded, too
_AHEAD = (4, 10, 18, 28, 40, 54, 70, 88, 108, 130, 154, 180, 208, 238, 255)  # looked at for it
_STRIDE = 8  # ms between shorter ends; where a class begins, all in between are tried, too
_MOVES = 10  # milliseconds a knot may be moved to make its segments smoother, by even ones,
_TILTS = 2  # and units its velocity may be changed
_STANDS = 0.5 + 1e-6  # how far from where it is to stand a whole count may be
_STEPS = 16  # of a grid of times, in a longest segment, on which knots are searched for one by one,
_NEAR = 2  # at positions next to the commanded one, below and above,
_TURNS = 2  # and velocities on either side of the commanded one, at least a unit apart,
_TURN = 0.5  # this share otherwise of a tolerance per, or what can be turned in, a longest segment
_ASTRAY = 0.1  # records given for a knot to be a tolerance, or the last one a velocity, nearer
_JUMP = 0.5  # how much more may be off of what a jump of acceleration or velocity does within 1 ms
_WIDER = (1 / 8, 1 / 4, 1 / 2)  # counts more where rounding leaves no way within the tolerance
_LATE = 0.01  # and for the motion to end a millisecond sooner
_ROUGHNESS_UNIT = 1e3  # (1/ms)³ per qc²: 1 record for (1000 qc/s²)²·s at a tolerance of 1 qc


class Path(NamedTuple):
    """Commanded positions of an axis on the path-time grid; times count from its first one."""

    positions: Vector  # [qc]
    bends: Vector  # running sum of the squared second differences of positions [qc²/ms⁴]


class Terms(NamedTuple):
    """What every segment of an axis has to keep, and what is aimed at."""

    unit: float  # drive velocity unit [qc/ms]
    tolerance: float  # [qc]
    fastest: float  # [qc/ms]
    steepest: float  # [qc/ms²]
    smoothness: float
    longest: int  # [ms]
    spare: float  # what `steepest` leaves beside any commanded acceleration [qc/ms²]
    slowest: float  # a knot's velocity is none or at least this; whole units [qc/ms]


class _Windows(NamedTuple):
    """What b + a·t may be at some times t of a segment."""

    time: Vector
    low: Vector
    high: Vector


class _Ends(NamedTuple):
    """The best end of every class: how far it gets less what it costs, and where it is."""

    gain: Vector
    k: Vector
    position: Vector
    velocity: Vector
    way: Vector  # index of the way its segment is added to


@inlined
def _copy(source: Vector, at: int, target: Vector, to: int, count: int) -> None:
    for i in range(count):
        target[to + i] = source[at + i]


@inlined
def _tangent(
    windows: _Windows, first: int, n: int, t: float, value: float, sign: float
) -> tuple[int, float]:
    """The line through `value` at t that turns as far as the windows before let it.

    Up for sign 1, down for −1. Returns the window it touches, none before `first`, and its slope.
    """
    bound = windows.low if sign > 0 else windows.high
    touched, least = first, inf
    for i in range(first, n):
        slope = sign * (value - bound[i]) / (t - windows.time[i])
        if slope < least:
            touched, least = i, slope
    return touched, sign * least


@compiled
def _reach(
    path: Path, k: int, p0: float, v0: float, terms: Terms, tolerance: float, windows: _Windows
) -> tuple[float, int]:
    """How long the segment from a knot can get [ms], interpolated, and how long at most."""
    half = terms.steepest / 2  # b is half the acceleration at 0, b + a·3·t that at t
    n = 0
    if half < inf:
        windows.time[0], windows.low[0], windows.high[0] = 0.0, -half, half
        n = 1
    # Of the lines through all windows the one that gets highest and the one that gets lowest.
    rise, top, risen = 0.0, inf, 0
    fall, bottom, fallen = 0.0, -inf, 0
    before, overlap = 1, 1.0
    for step in range(len(_AHEAD)):
        t = _AHEAD[step]
        if before >= terms.longest:
            break
        tt = t * t
        y = path.positions[k + t] - p0 - v0 * t
        low, high = (y - tolerance) / tt, (y + tolerance) / tt
        most, least = rise * t + top, fall * t + bottom
        missed = max(least - high, low - most) * tt
        if missed > 0:
            reach = before + (t - before) * overlap / (overlap + missed)
            return min(reach, float(terms.longest)), min(t - 1, terms.longest)
        overlap = (min(most, high) - max(least, low)) * tt
        windows.time[n], windows.low[n], windows.high[n] = t, low, high
        if n > 0 and most > high:
            risen, rise = _tangent(windows, risen, n, t, high, 1.0)
            top = high - rise * t
        if n > 0 and least < low:
            fallen, fall = _tangent(windows, fallen, n, t, low, -1.0)
            bottom = low - fall * t
        n += 1
        if half < inf and (rise * 3 * t + top < -half or fall * 3 * t + bottom > half):
            return float(before), min(t - 1, terms.longest)
        before = t
    return float(min(before, terms.longest)), terms.longest


@inlined
def _velocity(units: float, terms: Terms) -> float:
    """A knot's velocity of about this [units]: nearer to none than `slowest` there is only none."""
    v = float(floor(units + 0.5))
    least = floor(terms.slowest / terms.unit + 0.5)
    if 0 < abs(v) < least:
        v = 0.0 if 2 * abs(v) < least else (least if v > 0 else -least)
    return v


@inlined
def keeps(
    path: Path, k: int, p0: float, v0: float, time: int, p1: float, v1: float, terms: Terms
) -> bool:
    """Whether a segment keeps the tolerance at every millisecond, and the drive's limits."""
    if 0 < abs(v1) < terms.slowest - terms.unit / 2:
        return False
    mean = (p1 - p0) / time
    b = (3 * mean - 2 * v0 - v1) / time
    a = (v0 + v1 - 2 * mean) / (time * time)
    for t in range(1, time + 1):
        if abs(((a * t + b) * t + v0) * t + p0 - path.positions[k + t]) > terms.tolerance:
            return False
    fastest = abs(v1)
    if a != 0 and 0 < -b / (3 * a) < time:  # the acceleration turns there
        fastest = max(fastest, abs(v0 - b * b / (3 * a)))
    return fastest <= terms.fastest and max(abs(2 * b), abs(2 * b + 6 * a * time)) <= terms.steepest


@compiled
def _off(path: Path, k: int, p0: float, v0: float, time: int, p1: float, v1: float) -> float:
    """How far from the commanded positions a segment gets at any millisecond [qc]."""
    mean = (p1 - p0) / time
    b = (3 * mean - 2 * v0 - v1) / time
    a = (v0 + v1 - 2 * mean) / (time * time)
    most = 0.0
    for t in range(1, time + 1):
        most = max(most, abs(((a * t + b) * t + v0) * t + p0 - path.positions[k + t]))
    return most


@inlined
def _roughness(
    path: Path, k: int, p0: float, v0: float, time: int, p1: float, v1: float, terms: Terms
) -> float:
    """What the roughness of a segment costs, in records: the square of the deviation's
    acceleration, summed over the segment."""
    p, k1, m = path.positions, k + time, time - 1
    if time > 2:
        # Σ (x″ − p″)² with second differences x″ = b + a·t of the segment and p″ of the commanded
        # curve, written out so that it takes the latter's values at both ends only.
        mean = (p1 - p0) / time
        b = 2 * (3 * mean - 2 * v0 - v1) / time
        a = 6 * (v0 + v1 - 2 * mean) / (time * time)
        slope = p[k1] - p[k1 - 1]
        total = (
            path.bends[k1 - 1]
            - path.bends[k]
            - 2 * b * (slope - p[k + 1] + p[k])
            - 2 * a * (m * slope - p[k1 - 1] + p[k])
            + m * b * b
            + m * time * a * (b + a * (2 * time - 1) / 6)
        )
    else:  # ∫ of the square of the cubic with the deviations of position and velocity at both ends
        dp = (p1 - p[k1] - p0 + p[k]) / time
        dv0 = v0 - (4 * p[k + 1] - 3 * p[k] - p[k + 2]) / 2
        dv1 = v1 - (4 * p[k1 + 1] - 3 * p[k1] - p[k1 + 2]) / 2
        total = 4 * (3 * dp * (dp - dv0 - dv1) + dv0 * dv0 + dv0 * dv1 + dv1 * dv1) / time
    weight = terms.smoothness * _ROUGHNESS_UNIT / (terms.tolerance * terms.tolerance)
    return weight * max(total, 0.0)


@inlined
def _speed(p: Vector, k: int, time: int) -> float:
    """Commanded velocity at k [qc/ms] from the `time` milliseconds before, where curvature is."""
    last = p[k] - p[k - 1]
    return last if time < 2 else (3 * last - p[k - 1] + p[k - 2]) / 2


@inlined
def _enter(
    path: Path,
    k0: int,
    p0: float,
    v0: float,
    t: int,
    debt: float,
    way: int,
    terms: Terms,
    expected: float,
    aside: float,
    level: float,
    windows: _Windows,
    n: int,
    ends: _Ends,
) -> bool:
    """Enter the ends at time t, before which there are n windows.

    Returns whether any is the first of its class.
    """
    steepest, k1 = terms.steepest, k0 + t
    per_t, per_unit, per_level = 1.0 / t, 1.0 / terms.unit, 1.0 / level
    position = path.positions[k1]
    speed = _speed(path.positions, k1, t) * per_unit
    top = terms.fastest * per_unit
    first_of_class = False
    for side in range(_SIDES if aside > 0 else 2):
        p1 = floor(position - aside) if side == 0 else ceil(position + aside)
        if side > 1:
            p1 = floor(position) if side == 2 else ceil(position)
        if abs(p1 - position) > terms.tolerance:
            continue
        c = ((p1 - p0) * per_t - v0) * per_t  # b + a·t of the cubics that end there
        low, high = -inf, inf  # of a, on the way there
        if steepest < inf:  # accelerations are 2·(c − a·t) and 2·(c + 2·a·t)
            low = max((c - steepest / 2) * per_t, (-steepest / 2 - c) * per_t / 2)
            high = min((c + steepest / 2) * per_t, (steepest / 2 - c) * per_t / 2)
        for i in range(n):
            per = 1.0 / (t - windows.time[i])
            low = max(low, (c - windows.high[i]) * per)
            high = min(high, (c - windows.low[i]) * per)
            if low > high:
                break
        if low > high:
            continue
        # Whatever follows, a deviation that grows has to turn before the tolerance.
        off = p1 - position
        slowest = speed - min(sqrt(terms.spare * (terms.tolerance + off)) * per_unit, 1e6)
        fastest = speed + min(sqrt(terms.spare * (terms.tolerance - off)) * per_unit, 1e6)
        slowest = max((v0 + (2 * c + low * t) * t) * per_unit, -top, slowest)
        fastest = min((v0 + (2 * c + high * t) * t) * per_unit, top, fastest)
        first = max(-_LEVELS, ceil((slowest - speed) * per_level - 0.5))
        for j in range(first, min(_LEVELS, floor((fastest - speed) * per_level + 0.5)) + 1):
            one = _LEVELS + j + side * (2 * _LEVELS + 1)
            gain = k1 - debt
            if gain <= ends.gain[one]:
                continue
            if k1 < ends.k[one] and t % _SMOOTHER != 0:
                continue  # only a smoother one can be better; some of them will do
            v1 = _velocity(speed + j * level, terms)
            if not slowest <= v1 <= fastest:
                continue
            gain -= expected * _roughness(path, k0, p0, v0, t, p1, v1 * terms.unit, terms)
            if gain > ends.gain[one]:
                first_of_class = first_of_class or ends.gain[one] == -inf
                ends.gain[one], ends.k[one], ends.way[one] = gain, k1, way
                ends.position[one], ends.velocity[one] = p1, v1
    return first_of_class


@compiled
def _ends(
    path: Path,
    k0: int,
    p0: float,
    v0: float,
    debt: float,
    way: int,
    terms: Terms,
    expected: float,
    aside: float,
    shortest: int,
    latest: int,
    level: float,
    windows: _Windows,
    ends: _Ends,
) -> None:
    """Enter the ends of segments from one knot, which last from `shortest` to `latest`."""
    step = max(1, shortest // 8)
    tolerance = terms.tolerance * _BETWEEN
    for i in range((latest - 1) // step):
        t = (i + 1) * step
        tt = t * t
        y = path.positions[k0 + t] - p0 - v0 * t
        windows.time[i] = t
        windows.low[i], windows.high[i] = (y - tolerance) / tt, (y + tolerance) / tt
    t = latest + 1
    stride = 1
    while t > shortest:
        if t < 0.8 * expected:
            stride = min(step, _STRIDE)
        t -= stride
        # The first of its class is searched for in what has been left out, too.
        for later in range(t, min(t + stride, latest + 1)):
            first_of_class = _enter(
                path,
                k0,
                p0,
                v0,
                later,
                debt,
                way,
                terms,
                expected,
                aside,
                level,
                windows,
                (later - 1) // step,
                ends,
            )
            if later == t and not first_of_class:
                break


@compiled
def _last(path: Path, k: int, p0: float, v0: float, time: int, terms: Terms) -> float:
    """What a segment to the end of the motion, `time` later, costs [ms]; inf if there is none."""
    if time > terms.longest:
        return inf
    rest = floor(path.positions[k + time] + 0.5)
    if not keeps(path, k, p0, v0, time, rest, 0.0, terms):
        return inf
    return time * _roughness(path, k, p0, v0, time, rest, 0.0, terms)


@compiled
def _knot(plan: Vector, way: int, level: int, unit: float) -> tuple[int, float, float]:
    """Path time, position and velocity [qc/ms] of a knot of a way."""
    at = way * _WAY + level * KNOT
    return int(plan[at]), plan[at + 1], plan[at + 2] * unit


@compiled
def _finish(path: Path, plan: Vector, terms: Terms, end: int) -> bool:
    """Add to the way from which it is best a segment that ends the motion, if there is one."""
    known = int(plan[_KNOWN])
    best, least = -1, inf
    for way in range(int(plan[_WAYS])):
        k, p, v = _knot(plan, way, known, terms.unit)
        cost = plan[way * _WAY + _DEBT] + _last(path, k, p, v, end - k, terms)
        if cost < least:
            best, least = way, cost
    if best < 0:
        return False
    _copy(plan, best * _WAY, plan, 0, _WAY)
    at = KNOT * (known + 1)
    plan[at], plan[at + 1], plan[at + 2] = end, floor(path.positions[end] + 0.5), 0.0
    plan[_WAYS], plan[_KNOWN], plan[_COMPLETE] = 1, known + 1, 1
    return True


@compiled
def _grow(path: Path, plan: Vector, terms: Terms, end: int) -> bool:
    """Add to the ways the best segments that end before `end`; whether there are any.

    There are none when tolerance and limits can't be kept.
    """
    unit = terms.unit
    known = int(plan[_KNOWN])
    before = room(WIDTH * _WAY)
    _copy(plan, 0, before, 0, WIDTH * _WAY)
    windows = _Windows(room(_AHEAD[-1]), room(_AHEAD[-1]), room(_AHEAD[-1]))
    ends = _Ends(room(_CLASSES), room(_CLASSES), room(_CLASSES), room(_CLASSES), room(_CLASSES))
    scores = room(_CLASSES)
    level = 1.0
    for search in range(3):  # the second and third are for the rare case that nothing was found
        for c in range(_CLASSES):
            ends.gain[c], ends.k[c] = -inf, 0
        for way in range(int(plan[_WAYS])):
            k0, p0, v0 = _knot(before, way, known, unit)
            expected, latest = _reach(path, k0, p0, v0, terms, terms.tolerance, windows)
            level = max(level, _LEVEL * terms.tolerance / (expected * unit))
            latest = min(latest, end - 1 - k0)
            aside = max(0.0, terms.tolerance / 2 - 0.5)  # below and above: half a tolerance away
            left = end - k0
            if left < 2 * expected:  # it takes two; the second ends exactly where the motion does
                latest, aside = min(latest, max(1, 2 * left // 3)), 0.0
            if search == 2:
                latest = min(latest, 1)
            shortest = 1 if search == 1 else max(1, int(0.6 * min(expected, latest)))
            _ends(
                path,
                k0,
                p0,
                v0,
                before[way * _WAY + _DEBT],
                way,
                terms,
                expected,
                aside,
                shortest,
                latest,
                level,
                windows,
                ends,
            )
        for c in range(_CLASSES):
            scores[c] = ends.gain[c]
            if scores[c] > -inf:
                k1, p1, v1 = int(ends.k[c]), ends.position[c], ends.velocity[c] * unit
                left = end - k1
                cost = _last(path, k1, p1, v1, left, terms)
                if cost < inf:
                    scores[c] += left - cost
                else:
                    ahead = _ROUNDED_END * terms.tolerance
                    reach, _ = _reach(path, k1, p1, v1, terms, ahead, windows)
                    scores[c] += reach if reach < left else left / 2  # it takes two
        n = 0
        while n < WIDTH:
            c = 0
            for other in range(1, _CLASSES):
                if scores[other] > scores[c]:
                    c = other
            if scores[c] == -inf:
                break
            scores[c] = -inf
            way, k1, p1, v1 = int(ends.way[c]), int(ends.k[c]), ends.position[c], ends.velocity[c]
            at = KNOT * (known + 1)
            if n > 0 and plan[at] == k1 and plan[at + 1] == p1 and plan[at + 2] == v1:
                continue  # where below and above are the same
            k0, p0, v0 = _knot(before, way, known, unit)
            if keeps(path, k0, p0, v0, k1 - k0, p1, v1 * unit, terms):
                _copy(before, way * _WAY, plan, n * _WAY, _WAY)
                at += n * _WAY
                plan[at], plan[at + 1], plan[at + 2] = k1, p1, v1
                plan[n * _WAY + _DEBT] = k1 - ends.gain[c]
                n += 1
        if n > 0:
            plan[_WAYS], plan[_KNOWN] = n, known + 1
            return True
    return False


@compiled
def _settle(path: Path, plan: Vector, terms: Terms) -> None:
    """Move the first knot of the best way to where the segments on both sides are smoothest."""
    unit = terms.unit
    k0, p0, v0 = _knot(plan, 0, 0, unit)
    k1, p1, v1 = _knot(plan, 0, 1, unit)
    k2, p2, v2 = _knot(plan, 0, 2, unit)
    longest = max(k1 - k0, k2 - k1)
    least = _roughness(path, k0, p0, v0, k1 - k0, p1, v1, terms)
    least += _roughness(path, k1, p1, v1, k2 - k1, p2, v2, terms)
    first = max(k0 + 2, k1 - _MOVES, k2 - longest)
    for k in range(first, min(k2 - 1, k1 + _MOVES + 1, k0 + longest + 1), 2):
        position = path.positions[k]
        speed = floor(_speed(path.positions, k, 2) / unit + 0.5)
        for side in range(2):
            p = floor(position) if side == 0 else ceil(position)
            for units in range(speed - _TILTS, speed + _TILTS + 1):
                v = units * unit
                roughness = _roughness(path, k0, p0, v0, k - k0, p, v, terms)
                if roughness < least:
                    roughness += _roughness(path, k, p, v, k2 - k, p2, v2, terms)
                if (
                    roughness < least
                    and keeps(path, k0, p0, v0, k - k0, p, v, terms)
                    and keeps(path, k, p, v, k2 - k, p2, v2, terms)
                ):
                    least = roughness
                    plan[KNOT], plan[KNOT + 1], plan[KNOT + 2] = k, p, units


@compiled
def _same(plan: Vector, way: int, other: Vector, knots: int) -> bool:
    """Whether a way begins with the `knots` knots after the committed one in `other`."""
    same = True
    for i in range(KNOT, KNOT * (1 + knots)):
        same = same and plan[way * _WAY + i] == other[i]
    return same


@compiled
def _commit(path: Path, plan: Vector, terms: Terms) -> None:
    """Commit the first knot of the best way, and forget the ways that don't pass it."""
    best = room(_WAY)
    _copy(plan, 0, best, 0, _WAY)
    shared = 1
    if plan[_KNOWN] > 1:
        _settle(path, plan, terms)
        if not _same(plan, 0, best, 1):
            shared = 2
    n = 1
    for way in range(1, int(plan[_WAYS])):
        if _same(plan, way, best, shared):
            _copy(plan, way * _WAY, plan, n * _WAY, _WAY)
            _copy(plan, KNOT, plan, n * _WAY + KNOT, KNOT)
            n += 1
    for way in range(n):
        _copy(plan, way * _WAY + KNOT, plan, way * _WAY, KNOT * DEPTH)
    plan[_WAYS] = n
    plan[_KNOWN] -= 1


@compiled
def _careful(path: Path, plan: Vector, terms: Terms, end: int, near: int, turns: int) -> bool:
    """Look for knots on a grid of times, all pairs of them, for DEPTH longest segments.

    For when the ways that get furthest lead nowhere. The knots come ever nearer to the commanded
    curve, so that whatever comes next can be followed from them. Rest may come later than `end`:
    the time left may be too short to come to a whole count, and the curve rests there anyway.
    """
    unit, per_unit = terms.unit, 1 / terms.unit
    step = max(1, terms.longest // _STEPS)
    reach = max(1, terms.longest // step)
    times, ends = DEPTH * reach, near * (2 * turns + 1)
    level = min(terms.tolerance / terms.longest, terms.steepest * terms.longest / 4) / unit
    level = max(1.0, _TURN * level)
    position, velocity = room((times + 1) * ends), room((times + 1) * ends)
    cost, before = room((times + 1) * ends), room((times + 1) * ends)
    k0, p0, v0 = _knot(plan, 0, 0, unit)
    aside = p0 - path.positions[k0]
    rest = floor(path.positions[max(end, 0)] + 0.5)  # it may have been over before
    for i in range(times + 1):
        k = k0 + i * step
        place = floor(path.positions[k] + aside * (1 - i / times)) - near // 2 + 1
        speed = 0.0 if k >= end or i == 0 else _speed(path.positions, k, i * step) * per_unit
        for one in range(ends):
            at = i * ends + one
            position[at] = place + one // (2 * turns + 1)
            velocity[at] = unit * _velocity(speed + (one % (2 * turns + 1) - turns) * level, terms)
            cost[at], before[at] = inf, -1.0
    position[0], velocity[0], cost[0] = p0, v0, 0.0
    best, least, ended = -1, inf, False
    for i in range(times + 1):
        k = k0 + i * step
        for one in range(ends):
            at = i * ends + one
            if cost[at] == inf:
                continue
            p, v, so_far = position[at], velocity[at], cost[at]
            if k >= end and i > 0 and p == rest and v == 0:
                if so_far + _LATE * (k - end) < least:
                    best, least, ended = at, so_far + _LATE * (k - end), True
                continue
            for later in range(i + 1, min(i + reach, times) + 1):
                time = (later - i) * step
                per_time = 1 / time
                for two in range(ends):
                    to = later * ends + two
                    p1, v1 = position[to], velocity[to]
                    if cost[to] <= so_far + 1 or abs(v1) > terms.fastest:
                        continue
                    mean = (p1 - p) * per_time
                    b, c = (3 * mean - 2 * v - v1) * per_time, (3 * mean - v - 2 * v1) * per_time
                    if 2 * abs(b) > terms.steepest or 2 * abs(c) > terms.steepest:
                        continue
                    if not keeps(path, k, p, v, time, p1, v1, terms):
                        continue
                    astray = _ASTRAY * abs(p1 - path.positions[k + time]) / terms.tolerance
                    total = so_far + 1 + astray + _roughness(path, k, p, v, time, p1, v1, terms)
                    if total < cost[to]:
                        cost[to], before[to] = total, at
    if not ended:
        for one in range(ends):
            at = times * ends + one
            astray = _ASTRAY * abs(one % (2 * turns + 1) - turns)
            if cost[at] + astray < least:
                best, least = at, cost[at] + astray
    if best < 0:
        return False
    found, at = 0, best
    while at > 0:
        found, at = found + 1, int(before[at])
    forget(plan)
    known, at = min(found, DEPTH), best
    plan[_KNOWN], plan[_COMPLETE] = known, 1 if ended and found == known else 0
    for knot in range(found, 0, -1):
        if knot <= known:
            plan[KNOT * knot] = k0 + at // ends * step
            plan[KNOT * knot + 1] = position[at]
            plan[KNOT * knot + 2] = floor(velocity[at] * per_unit + 0.5)
        at = int(before[at])
    return True


@compiled
def _shift(plan: Vector, by: int) -> None:
    """Change all times of a plan."""
    for way in range(WIDTH):
        for level in range(DEPTH + 1):
            plan[way * _WAY + level * KNOT] += by


@compiled
def _complete(path: Path, plan: Vector, terms: Terms, end: int) -> bool:
    """Look ahead until DEPTH segments or the end are known; False if there is no way on."""
    while plan[_KNOWN] < DEPTH and plan[_COMPLETE] == 0:
        if not (_finish(path, plan, terms, end) or _grow(path, plan, terms, end)):
            return False
    return True


@compiled
def forget(plan: Vector) -> None:
    """Keep of a plan what is committed only."""
    plan[_DEBT] = plan[_KNOWN] = plan[_COMPLETE] = plan[_REST] = 0
    plan[_WAYS] = 1


@compiled
def _next_rest(path: Path, k: int, reach: int, last: int, least: int) -> tuple[int, int]:
    """From when to when the axis rests next for at least `least` ms, as far as is known.

    Where no rest begins within `reach`, the end of the motion, `last`.
    """
    p = path.positions
    began = k
    for t in range(k, min(last, len(p) - 1)):
        if p[t + 1] != p[t]:
            if t - began >= least:
                return began, t
            began = t + 1
            if began > k + reach:
                return last, last
    to = min(last, len(p) - 1)
    return (began, to) if to - began >= least else (last, last)


@compiled
def advance(
    positions: Vector, bends: Vector, first_ms: int, end_ms: int, aims: Vector, plan: Vector
) -> int:
    """Commit the next knot of a plan; returns the duration of the segment to it [ms].

    0: none keeps tolerance and limits; −1: the motion has ended. `positions` and `bends` are those
    of `Path` from path time `first_ms` on, at least as far as `looked_at` says; `aims` are the
    fields of `Terms`. Times in a plan are path times. The commanded curve rests from `end_ms` on.
    """
    path = Path(positions, bends)
    _shift(plan, -first_ms)
    start, longest = int(plan[0]), int(aims[5])
    last = end_ms - first_ms
    stands = plan[2] == 0 and abs(plan[1] - positions[start]) <= _STANDS
    if stands and start >= last:
        _shift(plan, first_ms)
        return -1
    end = last
    rests_to = int(plan[_REST]) - first_ms
    if rests_to <= start:
        began, ended = _next_rest(path, start, DEPTH * longest, last, longest)
        if began > start:
            end = began
        elif stands:
            forget(plan)
            plan[_REST], rests_to = ended + first_ms, ended
    found = True
    plan[OFF] = 0.0  # at rest it is half a count at most
    if rests_to > start:
        left = rests_to - start
        plan[0] += left if left <= longest else min(longest, (left + 1) // 2)
    else:
        terms = Terms(aims[0], aims[1], aims[2], aims[3], aims[4], longest, aims[6], aims[7])
        for way in range(int(plan[_WAYS])):
            # of a rest that was not known
            if plan[_COMPLETE] == 0 and _knot(plan, way, int(plan[_KNOWN]), 1.0)[0] > end > start:
                forget(plan)
        # Once the curve rests, it is gone on as was found.
        found = _complete(path, plan, terms, end) if start < end else plan[_KNOWN] > 0
        # Where the ways lead nowhere, go carefully, and in smaller steps. A jump of the commanded
        # acceleration between two milliseconds may be more than can be kept within the tolerance.
        jump = min(aims[2], max(aims[3] - aims[6], 0.0) if aims[3] < inf else inf)
        jump = jump if jump < inf else 0.0
        for wider in range(2 + len(_WIDER)):
            half = longest
            tolerance = aims[1]
            if wider == 1:
                tolerance += _JUMP * jump
            elif wider > 1:
                tolerance += _WIDER[wider - 2]
            while not found and half > 0:
                terms = Terms(aims[0], tolerance, aims[2], aims[3], aims[4], half, aims[6], aims[7])
                for more in range(2):
                    near, turns = _NEAR << more, _TURNS << more
                    found = found or _careful(path, plan, terms, last, near, turns)
                half //= 2
        if found:
            _, p0, v0 = _knot(plan, 0, 0, terms.unit)
            _commit(path, plan, terms)
            k1, p1, v1 = _knot(plan, 0, 0, terms.unit)
            plan[OFF] = _off(path, start, p0, v0, k1 - start, p1, v1)
    _shift(plan, first_ms)
    return int(plan[0]) - first_ms - start if found else 0


@compiled
def bends_of(positions: Vector) -> Vector:
    """As of `Path`."""
    bends = room(len(positions))
    bends[0] = total = 0.0
    for k in range(1, len(positions) - 1):
        bend = positions[k + 1] - 2 * positions[k] + positions[k - 1]
        total += bend * bend
        bends[k] = total
    bends[-1] = total
    return bends


def plan_from_rest(position: float, at_ms: int = 0) -> Vector:
    """A plan of a motion from rest at `position` [qc] at path time `at_ms`."""
    plan = vector([0.0] * PLAN)
    plan[0], plan[1] = float(at_ms), float(position)
    forget(plan)
    return plan


def looked_at(longest: int) -> int:
    """How far from the committed knot the commanded curve is looked at [ms]."""
    return DEPTH * longest + _AHEAD[-1] + 2


def prepare() -> None:
    """Compile this module, or load what an earlier run has compiled, before time matters."""
    still = vector([0.0] * (looked_at(1) + 1))
    aims = vector((1.0, 1.0, inf, inf, 0.0, 1, 0.0, 0.0))
    advance(still, bends_of(still), 0, 2, aims, plan_from_rest(0.0))


def prepared() -> bool:
    """Whether this process has compiled it, or loaded it."""
    function: Any = advance
    return COMPILED and bool(function.signatures)


def kept_in() -> pathlib.Path | None:
    """The folder in which what has been compiled is kept (Numba's choice); None: it is not kept."""
    function: Any = advance
    path = function.stats.cache_path if COMPILED else None
    return pathlib.Path(path) if path is not None else None


def compiled_before() -> bool:
    """Whether `prepare` will find what an earlier run has compiled."""
    folder = kept_in()
    if not COMPILED or folder is None:
        return not COMPILED
    function: Any = advance  # its line is in the name, and changes when this module does
    return any(folder.glob(f"knots.advance-{function.py_func.__code__.co_firstlineno}.*.nbi"))
