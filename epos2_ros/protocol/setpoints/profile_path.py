"""What a drive makes of the set-points that it was given: where its demand is at each instant.

Ramps at constant acceleration and stretches at constant velocity, as `motion.setpoints` says of the
drive. Times are ms of the drive's own plan, positions counts.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import deque
from typing import NamedTuple

from epos2_ros.motion.setpoints import SetPoint

_KEPT_MS = 3_000.0  # of what was executed, for answers that come late


class _Piece(NamedTuple):
    """Constant acceleration from `begins_ms` on; [counts], [counts/ms], [counts/ms²]."""

    begins_ms: float
    position: float
    velocity: float
    acceleration: float


class ProfilePath:
    """Of one axis: at rest before the first set-point, and after the last where that is its end."""

    def __init__(self, position_qc: float) -> None:
        self._pieces: deque[_Piece] = deque([_Piece(-math.inf, position_qc, 0.0, 0.0)])

    def add(
        self, set_point: SetPoint, velocity_unit_qc_s: float, acceleration_unit_qc_s2: float
    ) -> float:
        """One more set-point; when the drive begins to brake for its target unless another is
        queued behind it."""
        begin_ms, (position, velocity) = float(set_point.begin_ms), self.at(set_point.begin_ms)
        sign = math.copysign(1.0, set_point.target_qc - position)
        way, speed = abs(set_point.target_qc - position), velocity * sign
        most = set_point.velocity * velocity_unit_qc_s * 1e-3
        up = set_point.acceleration * acceleration_unit_qc_s2 * 1e-6
        down = set_point.deceleration * acceleration_unit_qc_s2 * 1e-6
        peak = min(most, math.sqrt(max(0.0, (2 * way * up + speed**2) * down / (up + down))))
        top = most if set_point.passes else max(peak, 0.0)
        rate = up if top >= speed else -down
        ramp_ms = (top - speed) / rate
        while self._pieces and self._pieces[-1].begins_ms >= begin_ms:
            self._pieces.pop()
        self._ramp(begin_ms, position, velocity, sign * rate)
        cruise_ms = begin_ms + ramp_ms
        ramp_way = (speed + top) / 2 * ramp_ms
        self._ramp(cruise_ms, position + sign * ramp_way, sign * top, 0.0)
        if top == 0.0:  # nowhere to go
            return cruise_ms
        brakes_ms = cruise_ms + max(0.0, (way - ramp_way - top**2 / (2 * down)) / top)
        if set_point.passes:
            if peak < most:  # the target is too near for that velocity and a ramp to rest
                brakes_ms = begin_ms + (peak - speed) / (up if peak >= speed else -down)
            return brakes_ms
        self._ramp(brakes_ms, self.at(brakes_ms)[0], sign * top, -sign * down)
        self._ramp(brakes_ms + top / down, float(set_point.target_qc), 0.0, 0.0)
        return brakes_ms

    def _ramp(self, begins_ms: float, position: float, velocity: float, rate: float) -> None:
        if self._pieces and self._pieces[-1].begins_ms >= begins_ms:
            self._pieces.pop()
        self._pieces.append(_Piece(begins_ms, position, velocity, rate))

    def at(self, t_ms: float) -> tuple[float, float]:
        """Position [counts] and velocity [counts/ms]."""
        pieces = self._pieces
        place = bisect_right(pieces, t_ms, key=lambda piece: piece.begins_ms) - 1
        begins_ms, position, velocity, rate = pieces[max(place, 0)]
        if not velocity and not rate:
            return position, 0.0
        since_ms = t_ms - begins_ms
        return position + (velocity + rate * since_ms / 2) * since_ms, velocity + rate * since_ms

    def forget(self, now_ms: float) -> None:
        """Drop what ended long ago, so that hours of motion need no memory."""
        while len(self._pieces) > 1 and self._pieces[1].begins_ms < now_ms - _KEPT_MS:
            self._pieces.popleft()
