"""How late a thread wakes: every time it did, in a table of fixed size."""

from __future__ import annotations

from itertools import accumulate
from typing import NamedTuple

_EXACT_US = 16  # below, a class for each microsecond; above, eight for each power of two
_CLASSES = 8
_OCTAVES = 28  # up to an hour, more than which counts as that
_LARGEST_US = (_EXACT_US << _OCTAVES) - 1


class LatenessFigures(NamedTuple):
    """Since the thread was started [µs]. Median and 99 % are never too small, and at most an
    eighth too large."""

    median_us: float
    most_us: float  # 99 % were at most so late
    worst_us: float
    times: int


class Lateness:
    """Takes some 0.5 µs for each wake, and two kilobytes."""

    def __init__(self) -> None:
        self._counts = [0] * (_EXACT_US + _OCTAVES * _CLASSES)
        self._times = 0
        self._worst_us = 0.0

    def add(self, late_us: float) -> None:
        """The thread woke so much later than it was to."""
        self._times += 1
        self._worst_us = max(self._worst_us, late_us)
        self._counts[_class_of(min(max(0, int(late_us)), _LARGEST_US))] += 1

    def figures(self) -> LatenessFigures | None:
        """None before the first time."""
        if not self._times:
            return None
        median_us, most_us = self._quantile_us(0.5), self._quantile_us(0.99)
        return LatenessFigures(median_us, most_us, self._worst_us, self._times)

    def _quantile_us(self, share: float) -> float:
        reached = accumulate(self._counts)
        place = next(i for i, seen in enumerate(reached) if seen >= share * self._times)
        return min(_end_us(place), self._worst_us)


def _class_of(late_us: int) -> int:
    if late_us < _EXACT_US:
        return late_us
    octave = late_us.bit_length() - _EXACT_US.bit_length()  # from 0
    return _EXACT_US + octave * _CLASSES + (late_us >> (octave + 1)) - _CLASSES


def _end_us(place: int) -> float:
    """Where the class ends."""
    if place < _EXACT_US:
        return place + 1.0
    octave, step = divmod(place - _EXACT_US, _CLASSES)
    return float((_CLASSES + step + 1) << (octave + 1))
