"""Streamed points: a message every few milliseconds with one point a little ahead.

Nobody says where the next point will be, so the motion has to end at rest at the last
one, and yet may not stop at each. Every point adds its distance from the one before as a
smooth step, spread over the time until it is due. Steps overlap, so their sum runs evenly
along, like the points seen through a smoothing filter: it never overshoots a point or
turns back unless the points do, the axes keep their proportions, and when the points end
it comes to rest on the last.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from epos2_ros.errors import TrajectoryError
from epos2_ros.motion.curve import Curve, hermite
from epos2_ros.motion.limits import PLANNED_SHARE, RELATIVE_SLACK, Limits
from epos2_ros.motion.reference import Motion
from epos2_ros.motion.trajectory import Trajectory

Array = NDArray[np.float64]

HORIZON_S = 0.25  # a single point due within this time is one of a stream
WINDOW_S = 0.1  # steps take at least this long, to overlap when the points are near ahead
_STRETCHES = (1.0, 1.25, 1.5, 2.0, 3.0)  # how much longer a step may take
_STEP = ((np.zeros(1), np.ones(1)), (np.zeros(1),) * 2, (np.zeros(1),) * 2)


def is_streamed(trajectory: Trajectory) -> bool:
    """One point, due in a moment: a controller follows its operator (MoveIt Servo)."""
    return len(trajectory.times_s) == 1 and trajectory.duration_s <= HORIZON_S


@dataclass(frozen=True, eq=False)
class Stream:
    """`base`, which ends at rest, and the steps from there on to `target`."""

    base: Motion
    target: Array  # [axes], where it all ends
    starts_s: Array  # [steps]
    durations_s: Array  # [steps]
    steps: Array  # [steps, axes]

    @classmethod
    def after(cls, base: Motion) -> Stream:
        """No steps yet: where `base` goes."""
        target = base.evaluate(np.array([base.end_s]))[0]
        return cls(base, target, np.zeros(0), np.zeros(0), np.zeros((0, len(target))))

    @property
    def end_s(self) -> float:
        return float(np.max(self.starts_s + self.durations_s, initial=self.base.end_s))

    def evaluate(self, t_s: Array, derivative: int = 0) -> Array:
        """Position or its 1st or 2nd derivative at path times t_s [m] → [m, axes]."""
        value = self.base.evaluate(t_s, derivative)
        value = value + _shares(t_s, self.starts_s, self.durations_s, derivative) @ self.steps
        if derivative == 0:
            value += self.target - self.steps.sum(axis=0) - self._base_end
        return value

    def to(self, target: Array, limits: Limits, at_s: float, due_s: float) -> Stream | None:
        """The same until `at_s`, then on to `target` [axes], which is due at `due_s`.

        Takes longer if the acceleration limits need it; None if that is not enough. Raises
        TrajectoryError when the step from the last point asks for more than the velocity
        limit.
        """
        shortest_s = max(due_s - at_s, WINDOW_S)
        step = target - self.target
        speed = np.abs(step) / shortest_s
        if (speed > limits.velocity * (1 + RELATIVE_SLACK)).any():
            joint = int(np.argmax(speed / limits.velocity))
            unit = limits.units[joint]
            raise TrajectoryError(
                f"joint '{limits.joints[joint]}': velocity {speed[joint]:.6g} {unit}/s needed to "
                f"reach point 0, allowed {limits.velocity[joint]:.6g} {unit}/s"
            )
        running = self._running(at_s)
        # The drives evaluate nothing between the milliseconds.
        t_s = at_s + np.arange(round(shortest_s * _STRETCHES[-1] * 1000)) / 1000
        velocity, acceleration = (running.evaluate(t_s, order) for order in (1, 2))
        most_v, most_a = limits.velocity * PLANNED_SHARE, limits.acceleration * PLANNED_SHARE
        for stretch in _STRETCHES:
            start_s, duration_s = np.array([at_s]), np.array([shortest_s * stretch])
            added_v, added_a = (_shares(t_s, start_s, duration_s, i) * step for i in (1, 2))
            if np.all(np.abs(velocity + added_v) <= most_v) and np.all(
                np.abs(acceleration + added_a) <= most_a
            ):
                return replace(
                    running,
                    target=target,
                    starts_s=np.append(running.starts_s, start_s),
                    durations_s=np.append(running.durations_s, duration_s),
                    steps=np.vstack((running.steps, step)),
                )
        return None

    def _running(self, at_s: float) -> Stream:
        """What of it is still going on at `at_s`."""
        on = self.starts_s + self.durations_s > at_s
        base = self.base
        if base.end_s <= at_s:
            base = Curve.resting(self._base_end)
        return replace(
            self,
            base=base,
            starts_s=self.starts_s[on],
            durations_s=self.durations_s[on],
            steps=self.steps[on],
        )

    @property
    def _base_end(self) -> Array:
        return self.base.evaluate(np.array([self.base.end_s]))[0]


def _shares(t_s: Array, starts_s: Array, durations_s: Array, derivative: int) -> Array:
    """How much of each step is done at t_s [m], or a derivative of that → [m, steps]."""
    u = (t_s[:, None] - starts_s) / durations_s
    share = hermite(np.clip(u, 0, 1), durations_s, _STEP, derivative)
    return np.where((u > 0) & (u < 1), share, 0.0) if derivative else share
