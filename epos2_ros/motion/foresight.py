"""What one output will fire along a motion that comes piece by piece and may change on the way.

A motion of an hour has millions of milliseconds, and it may be replaced before it is over: so its
crossings are found one piece of path at a time, and only what lies after a change is found anew.
"""

from __future__ import annotations

from math import inf

import numpy as np

from epos2_ros.motion.compare import Prediction, Trigger, assess
from epos2_ros.motion.crossings import Crossings, Grid, Path, Points, Rests, crossings, rests
from epos2_ros.motion.units import AxisUnits


class Foresight:
    """The prediction of one output. Times are µs of the path."""

    def __init__(self, trigger: Trigger, units: AxisUnits) -> None:
        self._trigger = trigger
        self._units = units
        self._fired = [trigger.fires(Path(np.zeros(1), np.zeros(1), np.zeros(1)))]
        self._rests = [Rests(*np.zeros((3, 0)))]
        self._end_us = inf  # when a sequence is over

    def extend(self, path: Path) -> None:
        """The motion goes on along `path`, which begins where the last piece ended."""
        self._rests.append(rests(path))
        if self._end_us < inf:
            return
        trigger = self._left()
        self._fired.append(trigger.fires(path))
        if trigger.sequence and trigger.end is not None:
            ends = crossings(Points((trigger.end,)), path)
            self._end_us = min(ends.t_us, default=inf)

    def forget(self, from_us: float) -> None:
        """From there on the motion goes otherwise."""
        fired, stops = Crossings.joined(self._fired), Rests.joined(self._rests)
        self._fired = [fired.where(fired.t_us < from_us)]
        self._rests = [stops.where(stops.t_us < from_us)]
        if self._end_us >= from_us:
            self._end_us = inf

    def prediction(self) -> Prediction:
        """All of it so far."""
        self._fired, self._rests = [Crossings.joined(self._fired)], [Rests.joined(self._rests)]
        return assess(self._trigger, self._fired[0], self._rests[0], self._units)

    def _left(self) -> Trigger:
        """Of a sequence, what has not been fired yet."""
        last = next((fired for fired in reversed(self._fired) if len(fired)), None)
        if not self._trigger.sequence or last is None:
            return self._trigger
        assert isinstance(self._trigger.counts, Grid)
        step = self._trigger.counts.step if self._trigger.rising else -self._trigger.counts.step
        return self._trigger.going_on_at(int(last.count[-1]) + step)
