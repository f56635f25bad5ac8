"""Streamed points: a message every few milliseconds with one point a little ahead.

Of a message with more points (MoveIt Servo's windows, which overlap) the last one counts, and its
velocity does not: nobody says where the next point will be, so the motion has to end at rest at
the last one, and yet may not stop at each. Every point adds its distance from the one before as a
smooth step, spread over the time until it is due. Steps overlap, so their sum runs evenly
along, like the points seen through a smoothing filter: it never overshoots a point or
turns back unless the points do, the axes keep their proportions, and when the points end
it comes to rest on the last. It lingers there, so that a further point needs no start.

Where messages come late and in a bunch, their steps are begun one after another, a little faster
than they were sent: the axes do not rush to where they would be. Nor where the operator is faster
than the velocity limit: they follow at the limit, as long as they are not too far behind.

Where no messages came for a while and the operator has gone on meanwhile, they make up for that way
at the operator's own pace, beside what it goes on with: at twice its speed in all.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from epos2_ros.errors import TrajectoryError
from epos2_ros.motion.curve import Curve
from epos2_ros.motion.limits import PLANNED_SHARE, RELATIVE_SLACK, Limits
from epos2_ros.motion.reference import Motion
from epos2_ros.motion.trajectory import Trajectory

Array = NDArray[np.float64]

HORIZON_S = 0.25  # how far ahead a stream's messages end, or how long ago they may have ended
POINT_HORIZON_S = 3.0  # a single point on the topic that is due within this time is one of a stream
WINDOW_S = 0.1  # steps take at least this long, if that brings them to rest soon enough
LINGER_S = 0.4  # a stream is not over before nothing has come for so long
_SOON_S = 0.1  # the axes are to rest so long after the last point is due, at the latest
_SHORTEST_S = 0.03
# A step is a quintic from rest to rest. Sums of such steps run evenly where each lasts as many
# periods of the messages: there the velocity's spectrum has its zeros (of j2(πx), x = 1.83, 2.90).
_EVEN = (2.895, 1.834)
_STRETCHES = tuple(1.2**n for n in range(11))  # how much longer a step may take
_LATE_S = 0.5  # and by how much at the most
_STEADY = 8  # so many of these keep the operator's pace, too
_CATCH_UP = 1.25  # so much faster than the operator the axes catch up after a host was late
_PACE = 1.1 * _CATCH_UP  # and so much in a moment, steps being not quite even
_BEHIND_S = 0.2  # and no more behind than this
_KEPT_S = 0.4  # of the points that came, for the operator's pace
_AHEAD_S = 0.4  # an operator may ask for so much more than the axes can do, at their fastest
GAP_S = 0.25  # between two messages: in less an operator does not get far
RESUMED_S = 10.0  # after so long it is another stream
_PEAK = 15 / 8  # of a step's velocity, in its mean
_LEAST_ROOM = 0.1  # share of the velocity limit for making up, where the operator takes all
_INSTANTS = 100  # of the shortest step at which limits are looked at


def is_streamed(trajectory: Trajectory) -> bool:
    """Whether others are to be expected that go on from it: a controller follows its operator.

    READING: no field of a message says so. A single point due in a moment is one of a stream. So
    are, on the topic, where nobody waits for a result: single points due within POINT_HORIZON_S
    (rqt, joysticks), and windows no longer than HORIZON_S whose last point moves or which say
    when they begin (MoveIt Servo's, whose last point rests when the operator lets go). All else is
    a plan; that of an action's goal always has an end.
    """
    count = len(trajectory.times_s)
    if count == 0:
        return False
    if count == 1:
        within_s = POINT_HORIZON_S if trajectory.published else HORIZON_S
        return trajectory.duration_s <= within_s
    return (
        trajectory.published
        and trajectory.duration_s - float(trajectory.times_s[0]) <= HORIZON_S
        and (trajectory.stamp_s is not None or not trajectory.rests)
    )


@dataclass(frozen=True, eq=False)
class Operator:
    """Who sends the points: what came lately, and how far ahead of the axes it is.

    When a point was sent is known from its message: of a single point, that was as long before it
    is due as the message gives it; of a window, whose points are a little ahead of the operator
    always, it is when the last one is due.
    """

    sent_s: Array  # [points]
    points: Array  # [points, axes]
    ahead_s: Array  # [axes], what the way to the last one takes at the limits, less the time it had

    @classmethod
    def of(cls, points: Array, sent_s: Array) -> Operator:
        return cls(sent_s, points, np.zeros(points.shape[1]))

    def sends(
        self,
        point: Array,
        target: Array,
        place: Array,
        limits: Limits,
        sent_s: float,
        asked_s: float,
    ) -> Operator:
        """The same with a further point [axes], due `asked_s` after it was sent.

        The way to it begins at `target`, the last one, and is at most what is left of it from
        `place`, where the axes will be. Raises TrajectoryError where it takes more than _AHEAD_S
        longer than it was given, with all that came before.
        """
        since_s = max(sent_s - float(self.sent_s[-1]), 0.0) if len(self.sent_s) else 0.0
        had_s = since_s + max(asked_s, _AHEAD_S)
        way_s = self.ahead_s + np.abs(point - target) / limits.velocity
        way_s = np.minimum(way_s, np.abs(point - place) / limits.velocity)
        joint = int(np.argmax(way_s))
        if way_s[joint] > had_s * (1 + RELATIVE_SLACK):
            speed, unit = limits.velocity[joint] * way_s[joint] / had_s, limits.units[joint]
            raise TrajectoryError(
                f"joint '{limits.joints[joint]}': velocity {speed:.6g} {unit}/s needed to "
                f"reach point 0, allowed {limits.velocity[joint]:.6g} {unit}/s"
            )
        all_s = np.append(self.sent_s, sent_s)
        kept = all_s >= sent_s - _KEPT_S
        return Operator(
            all_s[kept],
            np.vstack((self.points, point))[kept],
            np.maximum(way_s - since_s, 0.0),
        )

    @property
    def pace(self) -> Array:
        """How fast it goes [axes]; messages that come in a bunch were sent evenly."""
        if len(self.sent_s) < 2:
            return np.full(self.points.shape[1], np.inf)
        gaps_s = np.maximum(np.diff(self.sent_s), max(self.period_s, 1e-3))
        pace: Array = np.max(np.abs(np.diff(self.points, axis=0)) / gaps_s[:, None], axis=0)
        return pace

    @property
    def period_s(self) -> float:
        """How often points come; 0 when that is not known."""
        if len(self.sent_s) < 2:
            return 0.0
        mean_s = float(self.sent_s[-1] - self.sent_s[0]) / (len(self.sent_s) - 1)
        return min(max(mean_s, 0.0), LINGER_S)


@dataclass(frozen=True, eq=False)
class Stream:
    """`base`, which ends at rest, and the steps from there on to `target`."""

    base: Motion
    target: Array  # [axes], where it all ends
    starts_s: Array  # [steps]
    durations_s: Array  # [steps]
    steps: Array  # [steps, axes]
    operator: Operator

    @classmethod
    def after(cls, base: Motion, operator: Operator | None = None) -> Stream:
        """No steps yet: where `base` goes, which is the last point of an `operator` if any."""
        target = base.evaluate(np.array([base.end_s]))[0]
        none = np.zeros((0, len(target)))
        return cls(
            base, target, np.zeros(0), np.zeros(0), none, operator or Operator.of(none, np.zeros(0))
        )

    @property
    def end_s(self) -> float:
        """It lingers at rest, so that a further point needs no start."""
        return LINGER_S + float(np.max(self.starts_s + self.durations_s, initial=self.base.end_s))

    def evaluate(self, t_s: Array, derivative: int = 0) -> Array:
        """Position or its 1st or 2nd derivative at path times t_s [m] → [m, axes]."""
        value = self.base.evaluate(t_s, derivative)
        value = value + _shares(t_s, self.starts_s, self.durations_s, derivative) @ self.steps
        if derivative == 0:
            value += self.target - self.steps.sum(axis=0) - self._base_end
        return value

    def resumed(self, place: Array, since_s: float) -> Stream:
        """At rest at `place` [axes], where it has ended, on a path time whose zero is `since_s` of
        its own: its operator may go on."""
        sent_s = self.operator.sent_s - since_s
        operator = replace(self.operator, sent_s=sent_s)
        return replace(Stream.after(Curve.resting(place)), operator=operator)

    def to(
        self,
        target: Array,
        operator: Operator,
        limits: Limits,
        at_s: float,
        due_s: float,
        near: float = np.inf,
    ) -> Stream | None:
        """The same until `at_s`, then on to `target` [axes], the newest point of its `operator`,
        which is due at `due_s`.

        Takes longer where the limits need it, or the operator's own pace; None if that is not
        enough. After a gap in its messages the operator has gone on where it is not `near` [unit].
        """
        step = target - self.target
        running = self._running(at_s, operator)
        if len(self.starts_s):  # of messages in a bunch, one after another
            least_s = float(self.starts_s[-1]) + operator.period_s / _CATCH_UP
            at_s = max(at_s, min(least_s, at_s + _BEHIND_S))
        shortest_s = running._duration_s(at_s, due_s)
        if np.abs(step).max() > near:
            shortest_s = max(shortest_s, self._made_up_s(step, operator, limits, due_s))
        stretches = [s for s in _STRETCHES if shortest_s * (s - 1) <= _LATE_S]
        most_v, most_a = limits.velocity * PLANNED_SHARE, limits.acceleration * PLANNED_SHARE
        pace = np.minimum(_PACE * operator.pace, most_v)
        # The drives evaluate nothing between the milliseconds.
        grain_ms = max(1, round(1000 / _INSTANTS * min([shortest_s, *running.durations_s])))
        span_ms = 1000 * shortest_s * stretches[-1]
        t_s = at_s + np.arange(0, span_ms, grain_ms) / 1000
        velocity, acceleration = (running.evaluate(t_s, order) for order in (1, 2))

        def keeps(stretch: float, fastest: Array) -> bool:
            start_s, duration_s = np.array([at_s]), np.array([shortest_s * stretch])
            added_v, added_a = (_shares(t_s, start_s, duration_s, i) * step for i in (1, 2))
            return bool(
                np.all(np.abs(velocity + added_v) <= np.maximum(fastest, np.abs(velocity)))
                and np.all(np.abs(velocity + added_v) <= most_v)
                and np.all(np.abs(acceleration + added_a) <= most_a)
            )

        tries = [(s, pace) for s in stretches[:_STEADY]] + [(s, most_v) for s in stretches]
        for stretch, fastest in tries:
            if keeps(stretch, fastest):
                return replace(
                    running,
                    target=target,
                    starts_s=np.append(running.starts_s, at_s),
                    durations_s=np.append(running.durations_s, shortest_s * stretch),
                    steps=np.vstack((running.steps, step)),
                )
        return None

    def _duration_s(self, at_s: float, due_s: float) -> float:
        """How long the step to the newest point is to take."""
        gap_s = self.operator.period_s
        even_s = max(_EVEN[0] * gap_s, WINDOW_S)
        if at_s + even_s > due_s + _SOON_S:
            even_s = max(_EVEN[1] * gap_s, _SHORTEST_S)
        return max(due_s - at_s, even_s)

    def _made_up_s(self, step: Array, operator: Operator, limits: Limits, due_s: float) -> float:
        """How long the step after a gap takes at the operator's pace; 0: there was none, or the
        message says by itself how much time there is."""
        sent_s = float(operator.sent_s[-1])
        since_s = sent_s - float(self.operator.sent_s[-1]) if len(self.operator.sent_s) else 0.0
        if since_s <= GAP_S or due_s - sent_s >= GAP_S:
            return 0.0
        before = self.operator.pace
        pace = np.maximum(np.abs(step) / since_s, np.where(np.isfinite(before), before, 0.0))
        most = limits.velocity * PLANNED_SHARE
        room = np.minimum(pace, np.maximum(most - pace, _LEAST_ROOM * most))
        moves = step != 0
        return float(np.max(_PEAK * np.abs(step[moves]) / room[moves], initial=0.0))

    def _running(self, at_s: float, operator: Operator) -> Stream:
        """What of it is still going on at `at_s`, and what its operator has sent now."""
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
            operator=operator,
        )

    @property
    def _base_end(self) -> Array:
        return self.base.evaluate(np.array([self.base.end_s]))[0]


def _shares(t_s: Array, starts_s: Array, durations_s: Array, derivative: int) -> Array:
    """How much of each step is done at t_s [m], or a derivative of that → [m, steps]."""
    u = (t_s[:, None] - starts_s) / durations_s
    u = np.minimum(np.maximum(u, 0.0), 1.0)  # faster than clip
    if derivative == 0:
        return u * u * u * (10 + u * (6 * u - 15))
    left = u * (1 - u)
    if derivative == 1:
        return 30 * left * left / durations_s
    return 60 * left * (1 - 2 * u) / durations_s**2
