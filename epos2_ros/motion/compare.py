"""Position-triggered outputs before they fire: which, when, where, and what could go wrong.

Source: Copley, "Setting outputs at position" (in the text: "the note"). Everything is in counts of
the encoder and µs; nothing here depends on how a drive is told.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from epos2_ros.motion.crossings import (
    Counts,
    Crossings,
    Grid,
    Path,
    Points,
    Rests,
    crossings,
    rests,
)
from epos2_ros.motion.units import AxisUnits

FloatArray = NDArray[np.float64]

LOOP_US = 250.0
"""The drive looks at its position this often: software outputs, and encoders that are not
quadrature on the primary input (the note, "Position extrapolation")."""


@dataclass(frozen=True)
class Trigger:
    """When an output fires. A window fires at both its edges, in and out."""

    counts: Counts
    rising: bool = True  # fires when a count is crossed upward
    falling: bool = True
    sequence: bool = False  # each count once and in order, from index 0 in the one direction
    end: int | None = None  # of a sequence: crossing this count ends it
    pulse_us: float | None = None  # None: no pulses (a window, or toggling)
    sampled: bool = False  # compared once a loop, by the drive's firmware
    extrapolated: bool = False  # compared with a position extrapolated over the loop

    def fires(self, path: Path) -> Crossings:
        """What fires on the way along `path`, in order."""
        found = crossings(self.counts, path)
        found = found.where((found.rising & self.rising) | (~found.rising & self.falling))
        if not self.sequence:
            return found
        ahead = found.index if self.rising else -found.index
        begun = np.logical_or.accumulate(ahead == 0)
        before = np.maximum.accumulate(np.where(begun, ahead, -1))
        found = found.where(begun & (ahead > np.concatenate([[-1], before])[: len(ahead)]))
        if self.end is not None:
            ends = crossings(Points((self.end,)), path)
            found = found.where(found.t_us <= min(ends.t_us, default=np.inf))
        return found

    def going_on_at(self, count: int) -> Trigger:
        """Of a sequence, what is left when `count` is the next to fire."""
        assert isinstance(self.counts, Grid)
        if self.end is not None and (count > self.end if self.rising else count < self.end):
            return replace(self, counts=Points(()))
        return replace(self, counts=Grid(count, self.counts.step))


NEAR_COUNTS = 2
"""So close to an output it is not known on which side of it the axis stands."""


class Prediction(NamedTuple):
    """What will fire, by how many counts each may be off, and what is to be said of it."""

    fired: Crossings
    error_qc: FloatArray  # ½·a·T² of an extrapolated encoder, else 0
    warnings: tuple[str, ...]


def predict(trigger: Trigger, path: Path, units: AxisUnits) -> Prediction:
    """What `trigger` does along `path`."""
    return assess(trigger, trigger.fires(path), rests(path), units)


def assess(trigger: Trigger, fired: Crossings, stops: Rests, units: AxisUnits) -> Prediction:
    """What is to be said of what fires on a path that stops or turns where `stops` says."""
    error = np.zeros(len(fired))
    if trigger.extrapolated:
        error = extrapolation_error(fired.acceleration_qc_s2)
    warnings = (
        *_about_rests(trigger, stops, units),
        *_about_extrapolation(trigger, stops, fired, error, units),
        *_about_time(trigger, fired, units),
    )
    return Prediction(fired, error, warnings)


def extrapolation_error(acceleration_qc_s2: FloatArray) -> FloatArray:
    """How far the extrapolated position is off at the end of a loop [counts]: ½·|a|·T²."""
    return 0.5 * np.abs(acceleration_qc_s2) * (LOOP_US * 1e-6) ** 2


LATE_US = 5_000.0
"""So late a busy host may read a SYNC off an adapter that has no time stamps; the times of events
are late with it."""


def difference(
    predicted: Crossings, reported: Sequence[tuple[int, bool, float]], zero_us: float = 0.0
) -> tuple[str, float]:
    """In words what was reported otherwise than predicted, "" if nothing; and the time that is
    farthest from its prediction, by how much [µs].

    `reported`: count, rising and time [µs] of each event, in order; `zero_us` is where the
    predicted times begin. A time may be off by `LATE_US`, and by what two counts take.
    """
    if len(reported) != len(predicted):
        return f"{len(predicted)} events predicted, {len(reported)} reported", 0.0
    worst_us, beyond_us, words = 0.0, 0.0, ""
    for n, (count, rising, t_us) in enumerate(reported):
        if (count, rising) != (predicted.count[n], predicted.rising[n]):
            return (
                f"event {n + 1} predicted at count {predicted.count[n]} {_way(predicted.rising[n])}"
                f", reported at {count} {_way(rising)}"
            ), 0.0
        late_us = float(t_us - zero_us - predicted.t_us[n])
        worst_us = max(worst_us, late_us, key=abs)
        slow_us = 2e6 / max(abs(float(predicted.velocity_qc_s[n])), 1.0)
        if abs(late_us) > max(LATE_US + slow_us, abs(beyond_us)):
            beyond_us = late_us
            words = f"event {n + 1} at count {count} came {late_us:+.0f} µs from where predicted"
    return words, worst_us


def _way(rising: bool) -> str:
    return "upward" if rising else "downward"


_REMEDIES = (
    "cross at constant velocity, let the output fire in one direction only, or use a quadrature "
    "encoder on the drive's primary input, which is not extrapolated"
)


def _about_rests(trigger: Trigger, stops: Rests, units: AxisUnits) -> list[str]:
    """Where the axis stops or turns on an output, a count of following error decides."""
    for stop in stops.position_qc:
        near = trigger.counts.cell(stop - NEAR_COUNTS), trigger.counts.cell(stop + NEAR_COUNTS)
        if near[0] != near[1]:
            return [
                f"the axis stops or turns at {units.from_qc(float(stop)):.9g} {units.unit}, within "
                f"{NEAR_COUNTS} counts of an output, which may fire there several times or not at "
                "all; move the outputs (half an interval, say) or the turning point"
            ]
    return []


def _about_extrapolation(
    trigger: Trigger, stops: Rests, fired: Crossings, error: FloatArray, units: AxisUnits
) -> list[str]:
    """The note, "Position extrapolation": fired early or late, twice, or though never reached."""
    warnings: list[str] = []
    if not trigger.extrapolated:
        return warnings
    worst = float(max(error, default=0.0))
    per_count = abs(1 / units.qc_per_unit)
    if worst >= 1:
        size = f"{worst:.1f} counts ({worst * per_count:.3g} {units.unit})"
        if worst > trigger.counts.spacing:
            warnings.append(
                f"the encoder is extrapolated with an error of up to {size}, more than the "
                f"{trigger.counts.spacing:g} counts between outputs; {_REMEDIES}"
            )
        else:
            warnings.append(
                f"the encoder is extrapolated: outputs fire up to {size} early or late; {_REMEDIES}"
            )
        slowing = fired.acceleration_qc_s2 * fired.velocity_qc_s < 0
        twice = int(np.count_nonzero(slowing & (error >= 1)))
        if twice and trigger.rising and trigger.falling:
            warnings.append(
                f"{twice} of {len(fired)} outputs may fire twice: the axis slows down where they "
                f"are, so the extrapolated position passes them and is taken back; {_REMEDIES}"
            )
    acceleration = stops.acceleration_qc_s2
    beyond = stops.position_qc - np.sign(acceleration) * extrapolation_error(acceleration)
    for stop, reach in zip(stops.position_qc, beyond, strict=True):
        if trigger.counts.cell(stop) != trigger.counts.cell(reach):
            warnings.append(
                f"an output may fire that the axis never reaches: it stops at "
                f"{units.from_qc(float(stop)):.9g} {units.unit}, the extrapolated position goes "
                f"on to {units.from_qc(float(reach)):.9g} {units.unit}; {_REMEDIES}"
            )
            break
    return warnings


def _about_time(trigger: Trigger, fired: Crossings, units: AxisUnits) -> list[str]:
    """Pulses that run into each other, and windows over before a software output looks."""
    gaps = np.diff(fired.t_us)
    if trigger.pulse_us is not None:
        short, limit, problem = gaps < trigger.pulse_us, trigger.pulse_us, "pulses overlap"
    elif trigger.sampled and len(gaps):
        short, limit, problem = gaps < LOOP_US, LOOP_US, "passes through the window may be missed"
    else:
        return []
    if not short.any():
        return []
    worst = int(np.argmin(gaps))
    where = units.from_qc(float(fired.count[worst]))
    name = "a pulse" if trigger.pulse_us is not None else "the drive's loop"
    return [
        f"{np.count_nonzero(short)} {problem}: {name} lasts {limit:g} µs, and at "
        f"{where:.9g} {units.unit} the next edge is {gaps[worst]:.0f} µs away"
    ]
