"""The search for the next set-point of one axis: which one leads nearest along the commanded curve.

What a drive makes of a set-point (`setpoints` says why) is a ramp from the velocity at which it
begins to its profile velocity, which it holds; and, where the target is not passed, a ramp to rest
there. Ends are whole milliseconds.

Time ahead is cut into slots. From the best states in each slot, which differ in how far off and how
much too fast they are, set-points of some lengths are tried: how much of each is ramp and where it
ends beside the commanded curve is varied, and the velocity, rounded to whole units, follows. What
they cost is the distance from the commanded curve to the fourth power, over time: so the largest
counts most, and yet all count. The first set-point on the cheapest way is the one that is taken.

Units: ms, qc, qc/ms; velocities of states are whole units, signed.

This is scalar code for `motion/compiled`, and so one module.
"""

from __future__ import annotations

from math import ceil, floor, inf, sqrt
from typing import NamedTuple

from epos2_ros.motion.compiled import Vector, compiled, room, vector

SLOT_MS = 16  # states that end within one are compared
CLASSES = 8  # of states: at rest, waiting, and six by how fast and how far they are
HORIZON = 2  # of the longest set-points looked ahead
FOUND = (
    7  # numbers of a set-point: begin, end, target, velocity, acceleration, deceleration, passes
)
STATE = 4  # numbers of a state: path time, position, velocity, and from when on the next may end
NEXT, WAITS, ENDED = 0, 1, 2  # what `find` finds
_LENGTHS = 7
_RAMPS = 5
_SIDES = 5
_ARRIVALS = 7
_RATES = 8
_TURNS = 3  # places of rest ahead that are tried
_INSTANTS = 12  # at which an error is looked at
_MISS_MS = 20.0  # a velocity that is off costs like a distance of what it does in this time


class Aims(NamedTuple):
    """What set-points of an axis have to keep."""

    velocity_unit: float  # [qc/ms]
    rate_unit: float  # [qc/ms²]
    fastest: float  # [units]
    steepest: float  # [units]
    feeding: float  # [ms]
    sync: float  # [ms]
    longest: float  # [ms]


class Shape(NamedTuple):
    """A ramp, a hold, and maybe a ramp to rest; along its direction."""

    duration: float  # −1: there is none
    way: float
    speed: float  # with which it begins
    rate: float  # of the first ramp, signed
    ramp: float  # how long it takes
    top: float  # velocity held
    brakes: float  # when it begins to brake
    braking: float  # by what


@compiled
def shape(way: float, speed: float, velocity: float, up: float, down: float, passes: bool) -> Shape:
    """What a drive makes of a set-point `way` ahead, begun with `speed`; all are not negative."""
    none = Shape(-1.0, way, speed, 0.0, 0.0, 0.0, 0.0, 0.0)
    if way <= 0.0 or speed * speed > 2 * down * way * (1 - 1e-9):
        return none
    top = velocity
    stop = 0.0 if passes else velocity * velocity / (2 * down)
    rate = up if velocity >= speed else -down
    ramp = (velocity - speed) / rate
    ramp_way = (velocity + speed) / 2 * ramp
    if ramp_way + stop > way + 1e-9:
        if passes or rate < 0.0:
            return none
        top = sqrt((2 * way * up * down + speed * speed * down) / (up + down))
        ramp, stop = (top - speed) / up, top * top / (2 * down)
        ramp_way = (top + speed) / 2 * ramp
    brakes = ramp + max(way - ramp_way - stop, 0.0) / top
    duration = brakes if passes else brakes + top / down
    return Shape(duration, way, speed, rate, ramp, top, brakes, 0.0 if passes else down)


@compiled
def place(of: Shape, t: float) -> float:
    """How far it has come at `t`; beyond its end on at its velocity."""
    if t <= of.ramp:
        return of.speed * t + of.rate * t * t / 2
    if of.braking == 0.0:
        return of.way + of.top * (t - of.duration)
    if t <= of.brakes:
        return of.way - of.top * (of.brakes - t) - of.top * of.top / (2 * of.braking)
    if t >= of.duration:
        return of.way
    return of.way - of.braking * (of.duration - t) ** 2 / 2


@compiled
def _brakes_alone(of: Shape, down: float) -> float:
    """When a drive without a next set-point begins to brake for a target that is to be passed."""
    stop = of.top * of.top / (2 * down)
    ramp_way = (of.speed + of.top) / 2 * of.ramp
    if of.rate <= 0.0 or ramp_way + stop <= of.way:
        return of.ramp + (of.way - ramp_way - stop) / of.top
    so_far = (of.way - of.speed * of.speed / (2 * down)) / (1 + of.rate / down)
    return (sqrt(of.speed * of.speed + 2 * of.rate * so_far) - of.speed) / of.rate


@compiled
def _commanded(positions: Vector, k: int) -> float:
    return positions[min(max(k, 0), len(positions) - 1)]


@compiled
def _fourth(distance: float) -> float:
    square = distance * distance
    return square * square


@compiled
def _standing(positions: Vector, begin: int, end: int, p: float) -> float:
    """What it costs to stand at `p`."""
    step = max(1, (end - begin) // _INSTANTS)
    total = 0.0
    for k in range(begin + step, end + 1, step):
        total += _fourth(p - _commanded(positions, k))
    return total * step


@compiled
def _following(
    positions: Vector, begin: int, p: float, sign: float, of: Shape, most: float
) -> float:
    """What a set-point costs, to its end; something above `most` if it is more than that."""
    end = int(ceil(of.duration - 1e-9))
    step = max(1, end // _INSTANTS)
    total, most = 0.0, most / step
    for i in range(step, end + 1, step):
        total += _fourth(p + sign * place(of, i) - _commanded(positions, begin + i))
        if total > most:
            break
    return total * step


NODE = 4 + FOUND + 2
_COST, _BEFORE = 4 + FOUND, 5 + FOUND


@compiled
def _keep(
    nodes: Vector, index: int, cost: float, before: int, t: float, p: float, v: float, ready: float
) -> None:
    at = index * NODE
    nodes[at], nodes[at + 1], nodes[at + 2], nodes[at + 3] = t, p, v, ready
    nodes[at + _COST], nodes[at + _BEFORE] = cost, before


@compiled
def _slot(end: int, before: int, slots: int) -> int:
    """Where a state belongs that comes after the node `before`: later than that, however short."""
    earliest = 0 if before == slots * CLASSES else before // CLASSES + 1
    return min(max(end // SLOT_MS, earliest), slots - 1)


@compiled
def _offer(
    positions: Vector,
    aims: Aims,
    nodes: Vector,
    keys: Vector,
    slots: int,
    before: int,
    begin: int,
    target: float,
    velocity: float,
    up: float,
    down: float,
    passes: bool,
) -> None:
    """A set-point from a state on; all but `target` in whole units. Kept if none of its class is
    better."""
    at = before * NODE
    p, v, so_far = nodes[at + 1], nodes[at + 2], nodes[at + _COST]
    if not (1 <= velocity <= aims.fastest and 1 <= up <= aims.steepest):
        return
    if not 1 <= down <= aims.steepest:
        return
    sign = 1.0 if target > p else -1.0
    speed = v * sign * aims.velocity_unit
    if speed < 0.0:
        return
    fast, rate = velocity * aims.velocity_unit, down * aims.rate_unit
    of = shape(abs(target - p), speed, fast, up * aims.rate_unit, rate, passes)
    if of.duration < 0.0:
        return
    if passes and (of.duration > 2 * aims.longest or _brakes_alone(of, rate) < aims.feeding):
        return
    ms = int(ceil(of.duration - 1e-9))
    end = begin + ms
    slot = _slot(end, before, slots)
    p1 = p + sign * place(of, float(ms))
    v1 = sign * velocity if passes else 0.0
    astray = p1 - _commanded(positions, end)
    hurry = (
        v1 * aims.velocity_unit
        - (_commanded(positions, end + 1) - _commanded(positions, end - 1)) / 2
    )
    kind = 0
    if passes:
        level = max(aims.velocity_unit, 0.02 * fast)
        kind = 2 + (1 if astray > 0.0 else 0) + (0 if hurry < -level else 2 if hurry < level else 4)
    index = slot * CLASSES + kind
    mean = 1.0 / end if slot == slots - 1 else 1.0
    left = aims.feeding * (_fourth(astray) + _fourth(hurry * _MISS_MS)) / 2
    most = keys[index] / mean - so_far - left
    if most <= 0.0:
        return
    cost = _following(positions, begin, p, sign, of, most)
    if cost < most:
        keys[index] = (so_far + cost + left) * mean
        _keep(nodes, index, so_far + cost, before, end, p1, v1, begin + aims.feeding)
        to = index * NODE + 4
        nodes[to], nodes[to + 1], nodes[to + 2], nodes[to + 3] = begin, end, target, velocity
        nodes[to + 4], nodes[to + 5], nodes[to + 6] = up, down, 1.0 if passes else 0.0


@compiled
def _pass(
    positions: Vector, aims: Aims, nodes: Vector, keys: Vector, slots: int, node: int, begin: int
) -> None:
    """Set-points from a state whose targets are passed."""
    at = node * NODE
    p, v = nodes[at + 1], nodes[at + 2]
    unit, rate_unit = aims.velocity_unit, aims.rate_unit
    least = aims.feeding
    for length in range(_LENGTHS):
        ms = floor(least * (aims.longest / least) ** (length / (_LENGTHS - 1)) + 0.5)
        goal, half = _commanded(positions, begin + ms), _commanded(positions, begin + ms // 2)
        bend = abs(_commanded(positions, begin) - 2 * half + goal)
        for side in range(_SIDES):
            way = goal + (side - _SIDES // 2) * max(0.5, bend / 16) - p
            sign = 1.0 if v > 0.0 or (v == 0.0 and way > 0.0) else -1.0
            way *= sign
            speed = v * sign * unit
            if way <= 0.0:
                continue
            for part in range(_RAMPS):
                ramp = (ms - 1) * part / (_RAMPS - 1)
                fast = floor((way - speed * ramp / 2) / (ms - ramp / 2) / unit + 0.5)
                fast = min(max(fast, 1.0), aims.fastest)
                velocity = fast * unit
                rate = aims.steepest
                if velocity != speed and velocity * ms != way:
                    ramp = 2 * (velocity * ms - way) / (velocity - speed)
                    if 0.0 < ramp <= ms:
                        rate = ceil(abs(velocity - speed) / ramp / rate_unit - 1e-9)
                        rate = min(max(rate, 1.0), aims.steepest)
                slows = velocity < speed
                if slows:
                    rate = max(rate, ceil(speed * speed / (2 * way) / rate_unit))
                    if rate > aims.steepest:
                        continue
                up, down = (aims.steepest, rate) if slows else (rate, aims.steepest)
                ramp = abs(velocity - speed) / (rate * rate_unit)
                x = (speed + velocity) / 2 * ramp + velocity * max(ms - 0.5 - ramp, 0.0)
                target = floor(p + sign * x + 0.5)
                _offer(
                    positions, aims, nodes, keys, slots, node, begin, target, fast, up, down, True
                )


@compiled
def _arrive(
    positions: Vector,
    aims: Aims,
    nodes: Vector,
    keys: Vector,
    slots: int,
    node: int,
    begin: int,
    target: float,
    at_ms: int,
) -> None:
    """Set-points from a state that come to rest at `target`, at about `at_ms`."""
    at = node * NODE
    p, v = nodes[at + 1], nodes[at + 2]
    if target == p:
        return
    sign = 1.0 if target > p else -1.0
    unit, rate_unit = aims.velocity_unit, aims.rate_unit
    way, speed = abs(target - p), v * sign * unit
    steepest = aims.steepest * rate_unit
    if speed < 0.0 or speed * speed > 2 * steepest * way:
        return
    soonest = shape(way, speed, max(speed, aims.fastest * unit), steepest, steepest, False)
    for arrival in range(_ARRIVALS):
        ms = at_ms - begin + (arrival - _ARRIVALS // 2) * 16.0
        ms = max(ms, soonest.duration * (1 + arrival * 0.1))
        least = max(speed * speed / (2 * way), rate_unit)
        for step in range(_RATES):
            down = least * (steepest / least) ** ((step + 0.5) / _RATES)
            down = ceil(down / rate_unit) * rate_unit
            rates = aims.steepest
            left = ms - speed / down
            if left > 0.0 and (way - speed * speed / (2 * down)) <= speed * left:
                velocity = (way - speed * speed / (2 * down)) / left
                _offer(
                    positions,
                    aims,
                    nodes,
                    keys,
                    slots,
                    node,
                    begin,
                    target,
                    max(1.0, floor(velocity / unit + 0.5)),
                    rates,
                    down / rate_unit,
                    False,
                )
                continue
            for part in range(1, _RAMPS):
                ramp = ms * part / _RAMPS
                flat = ms - ramp / 2
                root = flat * flat - 2 * (way - speed * ramp / 2) / down
                if root < 0.0:
                    continue
                velocity = down * (flat - sqrt(root))
                fast = max(1.0, floor(velocity / unit + 0.5))
                rates = max(1.0, floor((fast * unit - speed) / ramp / rate_unit + 0.5))
                _offer(
                    positions,
                    aims,
                    nodes,
                    keys,
                    slots,
                    node,
                    begin,
                    target,
                    fast,
                    rates,
                    down / rate_unit,
                    False,
                )
    if speed > 0.0:
        return
    _offer(
        positions,
        aims,
        nodes,
        keys,
        slots,
        node,
        begin,
        target,
        aims.fastest,
        aims.steepest,
        aims.steepest,
        False,
    )


@compiled
def _turns(positions: Vector, end: int, found: Vector) -> int:
    """Where the commanded curve turns or comes to rest, its end included; how many they are."""
    n, sign = 0, 0.0
    last = min(end, len(positions) - 1)
    for k in range(last):
        step = positions[k + 1] - positions[k]
        now = 1.0 if step > 0.0 else -1.0 if step < 0.0 else 0.0
        if now != sign:
            if sign != 0.0 and n < len(found):
                found[n] = k
                n += 1
            sign = now
    if end < len(positions) and n < len(found):
        found[n] = end
        n += 1
    return n


@compiled
def find(positions: Vector, end: int, given: Vector, state: Vector, found: Vector) -> int:
    """Put the next set-point into `found` and the state at its end into `state`: NEXT.

    WAITS: it is best to stand for two more SYNC periods at least. ENDED: there is none any more,
    the drive stands where the curve ends. `positions` begin at the state's time, and `end` counts
    from there; the curve rests from then on.
    """
    aims = Aims(given[0], given[1], given[2], given[3], given[4], given[5], given[6])
    now = int(state[0])
    slots = int(HORIZON * aims.longest) // SLOT_MS + 1
    nodes = room((slots * CLASSES + 1) * NODE)
    keys = room(slots * CLASSES)
    for i in range(slots * CLASSES):
        keys[i] = inf
    turns = room(64)
    count = _turns(positions, end, turns)
    rest = floor(_commanded(positions, end) + 0.5)
    first = slots * CLASSES
    _keep(nodes, first, 0.0, -1, 0.0, state[1], state[2], state[3] - now)
    best, least = -1, inf
    for entry in range(-1, (slots - 1) * CLASSES):
        node = first if entry < 0 else entry
        if entry >= 0 and keys[node] == inf:
            continue
        at = node * NODE
        t, p, v, cost = int(nodes[at]), nodes[at + 1], nodes[at + 2], nodes[at + _COST]
        ready = nodes[at + 3]
        if v == 0.0:
            if p == rest and t < len(positions):
                total = cost + _standing(positions, t, max(end, t), p)
                mean = total / max(end, slots * SLOT_MS)
                if mean < least:
                    best, least = node, mean
            wait = (floor((now + max(t, ready - 1e-6)) / aims.sync) + 1) * aims.sync - now
            begin = int(floor(wait + 0.5))
            slot = _slot(begin, node, slots)
            index = slot * CLASSES + 1
            total = cost + _standing(positions, t, begin, p)
            key = total / begin if slot == slots - 1 else total
            if key < keys[index]:
                keys[index] = key
                _keep(nodes, index, total, node, begin, p, 0.0, begin)
                nodes[index * NODE + 4] = -1.0
            if t < ready:
                continue
        _pass(positions, aims, nodes, keys, slots, node, t)
        tried = 0
        for i in range(count):
            if turns[i] > t and tried < _TURNS:
                tried += 1
                target = floor(_commanded(positions, int(turns[i])) + 0.5)
                _arrive(positions, aims, nodes, keys, slots, node, t, target, int(turns[i]))
        if end <= t:
            _arrive(positions, aims, nodes, keys, slots, node, t, rest, t)
        if v != 0.0:
            speed = abs(v) * aims.velocity_unit
            way = speed * speed / (2 * aims.steepest * aims.rate_unit)
            target = floor(p + way) + 1 if v > 0.0 else ceil(p - way) - 1
            _offer(
                positions,
                aims,
                nodes,
                keys,
                slots,
                node,
                t,
                target,
                abs(v),
                aims.steepest,
                aims.steepest,
                False,
            )
    for kind in range(CLASSES):
        node = (slots - 1) * CLASSES + kind
        if keys[node] < least:
            best, least = node, keys[node]
    ended = nodes[best * NODE + 1] == rest and end <= len(positions)
    chosen = -1
    while best != first:
        if nodes[best * NODE + 4] >= 0.0:
            chosen = best
        best = int(nodes[best * NODE + _BEFORE])
    if chosen < 0:
        return ENDED if ended else WAITS
    if nodes[chosen * NODE + 4] > max(0.0, state[3] - now) + 2 * aims.sync:
        return WAITS
    for i in range(FOUND):
        found[i] = nodes[chosen * NODE + 4 + i]
    found[0] += now
    found[1] += now
    for i in range(STATE):
        state[i] = nodes[chosen * NODE + i]
    state[0] += now
    state[3] += now
    return NEXT


@compiled
def astray(
    positions: Vector, begin: int, p: float, v: float, given: Vector, found: Vector
) -> float:
    """The largest distance from the commanded curve, at every millisecond to a set-point's end.

    The drive is at `p` with `v` at path time `begin`, with which `positions` begin, too.
    """
    sign = 1.0 if found[2] > p else -1.0
    down, passes = found[5] * given[1], found[6] != 0.0
    of = shape(
        abs(found[2] - p),
        v * sign * given[0],
        found[3] * given[0],
        found[4] * given[1],
        down,
        passes,
    )
    most = 0.0
    for k in range(begin, int(found[1]) + 1):
        x = p + sign * place(of, max(0.0, k - found[0]))
        most = max(most, abs(x - _commanded(positions, k - begin)))
    return most


def horizon_ms(longest_ms: int) -> int:
    """How far ahead the commanded curve is looked at."""
    return (HORIZON + 3) * longest_ms


def state_at_rest(position_qc: float) -> Vector:
    """A state at path time 0, from which the SYNC at that time can start a set-point."""
    return vector((0.0, position_qc, 0.0, 0.0))


def prepare() -> None:
    """Compile this module, or load what an earlier run has compiled, before time matters."""
    aims, found = vector((1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 32.0)), vector([0.0] * FOUND)
    still = vector([0.0] * horizon_ms(32))
    find(still, 0, aims, state_at_rest(0.0), found)
    astray(still, 0, 0.0, 0.0, aims, found)
