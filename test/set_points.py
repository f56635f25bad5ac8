"""What a drive with a queue of one makes of set-points, by the simulated drive's ramps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import inf

import numpy as np
from numpy.typing import NDArray

from epos2_ros.motion.setpoints import SetPoint, SetPointAxis
from epos2_ros.sim import ramps


@dataclass
class Executed:
    """What a drive has made of set-points, at every millisecond of path time."""

    position_qc: NDArray[np.float64]
    velocity_qc_ms: NDArray[np.float64]
    begun_ms: list[int]  # when each set-point became the active one


def drive_executes(
    start_qc: int,
    points: Sequence[SetPoint],
    axis: SetPointAxis,
    handshake_ms: Callable[[], int],
    until_ms: int,
) -> Executed:
    """The rules of the chapter, a cycle at a time: one active, one queued, bit 9 as it is queued.

    A set-point is queued so long after the one before has become active; it has to be there before
    that one brakes. One that begins later than the last has ended is begun by the host.
    """
    at = ramps.State(float(start_qc), 0.0, 0.0)
    profile: ramps.Profile | None = None
    since = 0
    positions, velocities, begun = [at.position], [0.0], []
    coming = list(points)
    queued: SetPoint | None = None
    queue_ms = inf

    def limits(point: SetPoint) -> ramps.Limits:
        unit, rate = axis.velocity_unit_qc_s * 1e-3, axis.acceleration_unit_qc_s2 * 1e-6
        return ramps.Limits(
            point.velocity * unit, point.acceleration * rate, point.deceleration * rate
        )

    def begin(point: SetPoint, now: int) -> None:
        nonlocal profile, since, active, queue_ms
        profile, reached = ramps.move(at, float(point.target_qc), 0.0, limits(point))
        assert reached, "it can't brake for its target"
        active, since = point, now
        begun.append(now)
        queue_ms = now + handshake_ms()

    active: SetPoint | None = None
    for now in range(until_ms + 1):
        if now and profile is not None:
            at = profile.at(now - since)
            if now - since >= profile.duration:
                profile = None if not profile.end.velocity else profile
                assert active is not None
                if queued is not None:
                    following, queued = queued, None
                    begin(following, now)
                else:
                    assert not at.velocity, "it runs on"
                    active = None
        if now:
            positions.append(at.position)
            velocities.append(at.velocity)
        if active is None and coming and coming[0].begin_ms == now:
            begin(coming.pop(0), now)
        ends_ms = since + profile.duration if profile is not None else -inf
        if active is not None and queued is None and coming and now == queue_ms:
            if coming[0].begin_ms > ends_ms + 1:
                continue  # it waits for its SYNC
            queued = coming.pop(0)
            if active.passes:
                target, top = float(active.target_qc), limits(active).velocity
                profile, kept = ramps.move(at, target, top, limits(active))
                assert kept, "bit 9 is ignored"
                since = now
    assert not coming and queued is None
    return Executed(np.array(positions), np.array(velocities), begun)
