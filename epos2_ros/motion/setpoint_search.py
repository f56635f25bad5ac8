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

NEXT, WAITS, ENDED = 0, 1, 2  # what `find` finds
STATE = 4  # numbers of a state: path time, position, velocity, and from when on the next may begin
FOUND = 7  # numbers of a set-point, those of `SetPoint`
PLANNED = 8  # set-points that are kept of a plan
CLEAR_QC = 1.0
"""So much before a target that is to be passed its velocity is reached: a drive that leaves from
between two counts, or in another cycle, would else brake for it ("the bit 9 will get ignored")."""
HORIZON = 3  # of the longest set-points looked ahead
SLOT_MS = 16  # states that end within one are compared, by classes:
RESTING, WAITING, PASSING, PLAN = 0, 1, 2, 8  # PASSING has six, by speed and place
CLASSES = 9
_OWN = -1  # that of these to which a state belongs
_LENGTHS = 7  # of set-points whose targets are passed, the shortest that can be and longer ones,
_SIDES = 5  # their ends beside the commanded curve,
_RAMPS = 5  # and how much of them is ramp
_ARRIVALS = 7  # of those that come to rest, times,
_ARRIVES_MS = 16.0  # so far apart,
_RATES = 8  # decelerations,
_TURNS = 3  # and the next places where the commanded curve turns or rests
_INSTANTS = 12  # at which an error is looked at
_EDGE_MS = 0.01  # so near to a whole millisecond rounding decides when the next begins
_EACH_QC = 2.0  # each set-point costs like this distance for as long as feeding takes
_DEAR = 10.0  # a state so much dearer than another in its slot is not gone on from,
_CHEAP_QC = 4.0  # if it is dearer than this distance for as long as feeding takes
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


class _Ahead(NamedTuple):
    """What is looked at, and the states found so far."""

    positions: Vector  # commanded [qc], from where the committed set-point ends
    aims: Aims
    nodes: Vector
    keys: Vector  # by which nodes of a class are compared
    slots: int


@compiled
def shape(
    way: float, speed: float, velocity: float, up: float, down: float, passes: float
) -> Shape:
    """What a drive makes of a set-point `way` ahead, begun with `speed`; all are not negative.

    `passes`, here and elsewhere: 1 where its target is passed, 0 where it comes to rest there.
    """
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


NODE = STATE + FOUND + 2
_FOUND, _COST, _BEFORE = STATE, STATE + FOUND, STATE + FOUND + 1
# A node: the state at its end, the set-point that leads there (one that begins before everything
# where it is a wait), what all of it costs, and the node it begins at.


@compiled
def _keep(
    nodes: Vector, index: int, cost: float, before: int, t: float, p: float, v: float, ready: float
) -> None:
    at = index * NODE
    nodes[at], nodes[at + 1], nodes[at + 2], nodes[at + 3] = t, p, v, ready
    nodes[at + _COST], nodes[at + _BEFORE] = cost, before
    nodes[at + _FOUND] = -1.0


@compiled
def _slot(end: int, before: int, slots: int) -> int:
    """Where a state belongs that comes after the node `before`: later than that, however short."""
    earliest = 0 if before == slots * CLASSES else before // CLASSES + 1
    return min(max(end // SLOT_MS, earliest), slots - 1)


@compiled
def _allowed(
    aims: Aims,
    p: float,
    v: float,
    target: float,
    velocity: float,
    up: float,
    down: float,
    passes: float,
) -> Shape:
    """What a drive makes of a set-point from a state on; its duration is −1 where it can't be."""
    none = Shape(-1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    if not (1 <= velocity <= aims.fastest and 1 <= up <= aims.steepest):
        return none
    if not 1 <= down <= aims.steepest:
        return none
    speed = v * aims.velocity_unit if target > p else -v * aims.velocity_unit
    if speed < 0.0:
        return none
    fast, rate = velocity * aims.velocity_unit, down * aims.rate_unit
    of = shape(abs(target - p), speed, fast, up * aims.rate_unit, rate, passes)
    if of.duration < 0.0 or passes and of.duration > 2 * aims.longest:
        return none
    if abs(of.duration - floor(of.duration + 0.5)) < _EDGE_MS:
        return none
    if passes and _brakes_alone(of, rate) < aims.feeding:
        return none
    if passes and of.way - (of.speed + of.top) / 2 * of.ramp < CLEAR_QC:
        return none
    return of


@compiled
def _miss(ahead: _Ahead, t: int, p: float, v: float) -> float:
    """What it costs that a state is not on the commanded curve."""
    positions, aims = ahead.positions, ahead.aims
    astray = p - _commanded(positions, t)
    pace = (_commanded(positions, t + 1) - _commanded(positions, t - 1)) / 2
    hurry = v * aims.velocity_unit - pace
    return aims.feeding * (_fourth(astray) + _fourth(hurry * _MISS_MS)) / 2


@compiled
def _wait(ahead: _Ahead, before: int, begin: int, kind: int) -> int:
    """Stand from a state on until `begin`; returns the node, −1 if a better one is known."""
    at, slot = before * NODE, _slot(begin, before, ahead.slots)
    t, p, cost = int(ahead.nodes[at]), ahead.nodes[at + 1], ahead.nodes[at + _COST]
    index = slot * CLASSES + kind
    cost += _standing(ahead.positions, t, begin, p)
    key = cost / begin if slot == ahead.slots - 1 else cost
    if key >= ahead.keys[index]:
        return -1
    ahead.keys[index] = key
    _keep(ahead.nodes, index, cost, before, begin, p, 0.0, begin)
    return index


@compiled
def _offer(
    ahead: _Ahead,
    before: int,
    begin: int,
    target: float,
    velocity: float,
    up: float,
    down: float,
    passes: float,
    kind: int,
) -> int:
    """A set-point from a state on, in whole units; returns its node.

    −1: it can't be, or a better one of its class is known.
    """
    positions, aims, nodes, keys, slots = ahead
    at = before * NODE
    p, v, so_far = nodes[at + 1], nodes[at + 2], nodes[at + _COST]
    of = _allowed(aims, p, v, target, velocity, up, down, passes)
    if of.duration < 0.0:
        return -1
    sign = 1.0 if target > p else -1.0
    ms = int(ceil(of.duration - 1e-9))
    end = begin + ms
    slot = _slot(end, before, slots)
    p1 = p + sign * place(of, float(ms)) if passes else target  # exactly, or it would not end
    v1 = sign * velocity if passes else 0.0
    astray = p1 - _commanded(positions, end)
    hurry = v1 * aims.velocity_unit - (
        (_commanded(positions, end + 1) - _commanded(positions, end - 1)) / 2
    )
    if kind == _OWN and not passes:
        kind = RESTING
    elif kind == _OWN:
        level = max(aims.velocity_unit, 0.02 * of.top)
        kind = PASSING + (1 if astray > 0.0 else 0)
        kind += 0 if hurry < -level else 2 if hurry < level else 4
    index = slot * CLASSES + kind
    mean = 1.0 / end if slot == slots - 1 else 1.0
    left = _miss(ahead, end, p1, v1)
    most = keys[index] / mean - so_far - left
    if most <= 0.0:
        return -1
    each = aims.feeding * _fourth(_EACH_QC)
    cost = each + _following(positions, begin, p, sign, of, most - each)
    if cost >= most:
        return -1
    keys[index] = (so_far + cost + left) * mean
    _keep(nodes, index, so_far + cost, before, end, p1, v1, begin + aims.feeding)
    to = index * NODE + _FOUND
    nodes[to], nodes[to + 1], nodes[to + 2], nodes[to + 3] = begin, end, target, velocity
    nodes[to + 4], nodes[to + 5], nodes[to + 6] = up, down, passes
    return index


@compiled
def _pass(ahead: _Ahead, node: int, begin: int) -> None:
    """Set-points from a state whose targets are passed."""
    positions, aims, nodes = ahead.positions, ahead.aims, ahead.nodes
    at = node * NODE
    p, v = nodes[at + 1], nodes[at + 2]
    unit, rate_unit = aims.velocity_unit, aims.rate_unit
    soon = int(aims.feeding)
    pace = abs(_commanded(positions, begin + soon) - _commanded(positions, begin)) / soon
    least = aims.feeding + max(abs(v) * unit, pace) / (2 * aims.steepest * rate_unit) + 2.0
    for length in range(_LENGTHS):
        ms = floor(least * (max(aims.longest / least, 1.5)) ** (length / (_LENGTHS - 1)) + 0.5)
        goal, half = _commanded(positions, begin + ms), _commanded(positions, begin + ms // 2)
        bend = abs(_commanded(positions, begin) - 2 * half + goal)
        for side in range(_SIDES):
            way = goal + (side - _SIDES // 2) * max(0.5, bend / 16) - p
            sign = 1.0 if v > 0.0 or (v == 0.0 and way > 0.0) else -1.0
            way *= sign
            speed = v * sign * unit
            if way <= 0.0:
                continue
            surplus = speed * ms - way
            gentlest = max(speed * speed / (2 * way), 2 * surplus / (ms * ms)) / rate_unit
            gentlest = max(1.0, ceil(gentlest + 1e-6))
            if surplus > 0.0 and gentlest > aims.steepest:
                continue
            for part in range(_RAMPS):
                if surplus > 0.0:
                    rate = gentlest * (aims.steepest / gentlest) ** (part / (_RAMPS - 1))
                    rate = min(1.0 * ceil(rate), aims.steepest)
                    root = ms * ms - 2 * surplus / (rate * rate_unit)
                    fast = (speed - rate * rate_unit * (ms - sqrt(max(root, 0.0)))) / unit
                    fast = min(max(floor(fast + 0.5), 1.0), aims.fastest)
                else:
                    ramp = (ms - 1) * part / (_RAMPS - 1)
                    fast = floor((way - speed * ramp / 2) / (ms - ramp / 2) / unit + 0.5)
                    fast = min(max(fast, 1.0), aims.fastest)
                    rate = aims.steepest
                    if fast * unit > speed and fast * unit * ms > way:
                        ramp = min(2 * (fast * unit * ms - way) / (fast * unit - speed), ms - 1.0)
                        rate = ceil((fast * unit - speed) / ramp / rate_unit - 1e-9)
                        rate = min(max(rate, 1.0), aims.steepest)
                velocity = fast * unit
                up, down = (aims.steepest, rate) if velocity < speed else (rate, aims.steepest)
                ramp = abs(velocity - speed) / (rate * rate_unit)
                x = (speed + velocity) / 2 * ramp + velocity * max(ms - 0.5 - ramp, 0.0)
                target = 1.0 * floor(p + sign * x + 0.5)
                _offer(ahead, node, begin, target, fast, up, down, 1.0, _OWN)


@compiled
def _arrive(ahead: _Ahead, node: int, begin: int, target: float, at_ms: int) -> None:
    """Set-points from a state that come to rest at `target`, at about `at_ms`."""
    aims, at = ahead.aims, node * NODE
    p, v = ahead.nodes[at + 1], ahead.nodes[at + 2]
    sign = 1.0 if target > p else -1.0
    unit, rate_unit = aims.velocity_unit, aims.rate_unit
    way, speed = abs(target - p), v * sign * unit
    steepest = aims.steepest * rate_unit
    if target == p or speed < 0.0 or speed * speed > 2 * steepest * way:
        return
    top = max(speed, aims.fastest * unit)
    soonest = shape(way, speed, top, steepest, steepest, 0.0).duration
    gentlest = max(speed * speed / (2 * way) / rate_unit, 1.0)
    for arrival in range(_ARRIVALS):
        ms = at_ms - begin + (arrival - _ARRIVALS // 2) * _ARRIVES_MS
        ms = max(ms, soonest * (1 + arrival / 10))
        surplus = speed * ms - way
        if surplus > 0.0:  # on as fast as it is, then all of a ramp
            down = ceil(speed * speed / (2 * surplus) / rate_unit - 1e-9) * 1.0
            up = aims.steepest
            _offer(ahead, node, begin, target, abs(v), up, max(down, 1.0), 0.0, _OWN)
        for step in range(_RATES):
            down = 1.0 * ceil(
                gentlest * (aims.steepest / gentlest) ** ((step + 0.5) / _RATES) - 1e-9
            )
            rate = down * rate_unit
            left, held = ms - speed / rate, way - speed * speed / (2 * rate)
            if 0.0 <= held <= speed * left:
                fast = max(1.0, floor(held / left / unit + 0.5))
                up = aims.steepest
                _offer(ahead, node, begin, target, fast, up, down, 0.0, _OWN)
                continue
            for part in range(1, _RAMPS):
                ramp = ms * part / _RAMPS
                flat = ms - ramp / 2
                root = flat * flat - 2 * (way - speed * ramp / 2) / rate
                if root < 0.0:
                    continue
                fast = max(1.0, floor(rate * (flat - sqrt(root)) / unit + 0.5))
                up = max(1.0, floor((fast * unit - speed) / ramp / rate_unit + 0.5))
                _offer(ahead, node, begin, target, fast, up, down, 0.0, _OWN)
    fast = max(abs(v), 1.0) if speed > 0.0 else aims.fastest
    _offer(ahead, node, begin, target, fast, aims.steepest, aims.steepest, 0.0, _OWN)


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
def _replay(ahead: _Ahead, first: int, now: int, plan: Vector) -> None:
    """What was planned before is a way on, too; the state has come to the end of its first."""
    node = first
    for entry in range(1, int(plan[0])):
        at = 1 + entry * FOUND
        begin = int(plan[at]) - now
        if begin > ahead.nodes[node * NODE]:
            node = _wait(ahead, node, begin, PLAN)
        if node < 0 or begin != ahead.nodes[node * NODE]:
            break
        velocity, up, down = plan[at + 3], plan[at + 4], plan[at + 5]
        passes = plan[at + 6]
        node = _offer(ahead, node, begin, plan[at + 2], velocity, up, down, passes, PLAN)
        if node < 0:
            break


@compiled
def _go_on(ahead: _Ahead, node: int, now: int, end: int, turns: Vector, count: int) -> None:
    """All ways on from a state."""
    aims, at = ahead.aims, node * NODE
    t, p, v = int(ahead.nodes[at]), ahead.nodes[at + 1], ahead.nodes[at + 2]
    ready = ahead.nodes[at + 3]
    if v == 0.0:
        sync = floor((now + max(float(t), ready - 1e-6)) / aims.sync) + 1
        _wait(ahead, node, int(floor(sync * aims.sync + 0.5)) - now, WAITING)
        if t < ready and now + t > 0:  # the first is in the drive before the start
            return
    else:
        speed, steepest = abs(v) * aims.velocity_unit, aims.steepest * aims.rate_unit
        way = speed * speed / (2 * steepest)
        for further in (1.0, 2.0, 3.0):  # whatever comes, it can come to rest
            target = floor(p + way) + further if v > 0.0 else ceil(p - way) - further
            _offer(ahead, node, t, target, abs(v), aims.steepest, aims.steepest, 0.0, _OWN)
    _pass(ahead, node, t)
    tried = 0
    for i in range(count):
        if turns[i] > t and tried < _TURNS:
            tried += 1
            target = 1.0 * floor(_commanded(ahead.positions, int(turns[i])) + 0.5)
            _arrive(ahead, node, t, target, int(turns[i]))
    if end <= t:
        _arrive(ahead, node, t, 1.0 * floor(_commanded(ahead.positions, end) + 0.5), t)


@compiled
def _dearest(ahead: _Ahead, first: int) -> float:
    """What a state may cost to be gone on from, in the slot whose first node this is."""
    least = inf
    for kind in range(CLASSES):
        least = min(least, ahead.keys[first + kind])
    return _DEAR * least + ahead.aims.feeding * _fourth(_CHEAP_QC)


@compiled
def find(positions: Vector, end: int, given: Vector, state: Vector, plan: Vector) -> int:
    """Put what is to come into `plan` and the state at the end of its first set-point into `state`.

    NEXT: there is one. WAITS: it is best to stand for longer than it takes to ask again. ENDED:
    there is none any more, the drive stands where the curve ends, within a count. `positions` begin
    at the state's time, and `end` counts from there; the curve rests from then on. `plan` is the
    last call's.
    """
    aims = Aims(given[0], given[1], given[2], given[3], given[4], given[5], given[6])
    now = int(state[0])
    slots = int(HORIZON * aims.longest) // SLOT_MS + 1
    first = slots * CLASSES
    nodes, keys = room((first + 1) * NODE), room(first)
    for i in range(first):
        keys[i] = inf
    turns = room(64)
    count = _turns(positions, end, turns)
    ahead = _Ahead(positions, aims, nodes, keys, slots)
    rest = floor(_commanded(positions, end) + 0.5)
    _keep(nodes, first, 0.0, -1, 0.0, state[1], state[2], state[3] - now)
    _replay(ahead, first, now, plan)
    best, least, dearest = -1, inf, inf
    for entry in range(-1, (slots - 1) * CLASSES):
        node = first if entry < 0 else entry
        if entry >= 0 and entry % CLASSES == 0:
            dearest = _dearest(ahead, entry)
        if entry >= 0 and (keys[node] == inf or keys[node] > dearest):
            continue
        at = node * NODE
        t, p = int(nodes[at]), nodes[at + 1]
        if nodes[at + 2] == 0.0 and p == rest and t < len(positions):
            total = nodes[at + _COST] + _standing(positions, t, max(end, t), p)
            mean = total / max(end, slots * SLOT_MS)
            if mean < least:
                best, least = node, mean
        _go_on(ahead, node, now, end, turns, count)
    for kind in range(CLASSES):
        node = (slots - 1) * CLASSES + kind
        at = node * NODE
        beside = nodes[at + 2] == 0.0 and nodes[at + 1] != rest and nodes[at] >= end
        if beside and best >= 0:
            continue  # a count beside its end a drive would stand for ever
        if keys[node] < least:
            best, least = node, keys[node]
    ended = nodes[best * NODE + 1] == rest and end <= len(positions)
    if state[2] == 0.0 and end <= 0:  # to wait for it to be worth the last count would never end
        ended = ended or abs(state[1] - _commanded(positions, 0)) <= 1.0
    known, chosen, at = 0, -1, best
    while at != first:
        if nodes[at * NODE + _FOUND] >= 0.0:
            known, chosen = known + 1, at
        at = int(nodes[at * NODE + _BEFORE])
    plan[0] = min(known, PLANNED)
    while best != first:
        if nodes[best * NODE + _FOUND] >= 0.0:
            known -= 1
            if known < PLANNED:
                to = 1 + known * FOUND
                for i in range(FOUND):
                    plan[to + i] = nodes[best * NODE + _FOUND + i]
                plan[to] += now
                plan[to + 1] += now
        best = int(nodes[best * NODE + _BEFORE])
    if chosen < 0:
        return ENDED if ended else WAITS
    if plan[1] - now > aims.feeding + 2 * aims.sync:  # there is time to ask again
        plan[0] = 0.0
        return WAITS
    for i in range(STATE):
        state[i] = nodes[chosen * NODE + i]
    state[0] += now
    state[3] += now
    return NEXT


@compiled
def astray(positions: Vector, begin: int, p: float, v: float, given: Vector, plan: Vector) -> float:
    """The largest distance from the commanded curve, at every millisecond of the next set-point.

    The drive is at `p` with `v` at path time `begin`, with which `positions` begin, too.
    """
    since, end, target, velocity, up, down, passes = plan[1:8]
    sign = 1.0 if target > p else -1.0
    way, speed, rate = abs(target - p), v * sign * given[0], down * given[1]
    of = shape(way, speed, velocity * given[0], up * given[1], rate, passes)
    most = 0.0
    for k in range(begin, int(end) + 1):
        x = p + sign * place(of, max(0.0, k - since))
        most = max(most, abs(x - _commanded(positions, k - begin)))
    return most


def horizon_ms(longest_ms: int) -> int:
    """How far ahead the commanded curve is looked at."""
    return (HORIZON + 3) * longest_ms


def state_at_rest(position_qc: float, feeding_ms: float) -> Vector:
    """A state at path time 0: a set-point begins then, or as late as one that is told then can."""
    return vector((0.0, position_qc, 0.0, feeding_ms))


def no_plan() -> Vector:
    """A plan of nothing; else how many set-points it has, and their numbers."""
    return vector([0.0] * (1 + PLANNED * FOUND))


def prepare() -> None:
    """Compile this module, or load what an earlier run has compiled, before time matters."""
    aims, plan = vector((1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 32.0)), no_plan()
    still = vector([0.0] * horizon_ms(32))
    find(still, 0, aims, state_at_rest(0.0, 1.0), plan)
    astray(still, 0, 0.0, 0.0, aims, vector([1.0] * len(plan)))
