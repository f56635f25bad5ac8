"""Position compare (0x207A, 0x2079) and position marker (0x2074) of a simulated EPOS2.

Objects and bits are from public descriptions of the EPOS2's firmware. A value V is crossed upward
when the encoder goes from V − 1 to V, downward from V to V − 1; within a control cycle the axis
moves evenly. A sequence has as many positions as "interval repetitions" says, the reference first.
"""

from __future__ import annotations

from typing import NamedTuple

from .cia402 import Drive
from .dictionary import INTEGER32, UNSIGNED8, UNSIGNED16, Entry

NUMBER_OF_OUTPUTS = 5
_CYCLE_US = 1000.0
_EDGE = 0.5  # the encoder says the nearest count


class Fired(NamedTuple):
    """The position compare gave a pulse."""

    t_us: float  # true time
    value: int  # that was crossed
    rising: bool


class PositionOutputs(Drive):
    """What a drive with position compare and position marker has besides; a mix-in.

    `fired` keeps the pulses of the position compare, `input_edge` is the marker's input.
    """

    def _build_objects(self) -> None:
        super()._build_objects()
        self.fired: list[Fired] = []
        self._before = self._motor.position
        od = self.dictionary
        self._captured = [
            Entry("Captured position", INTEGER32, "ro", mappable=True),
            Entry("History 1", INTEGER32, "ro"),
            Entry("History 2", INTEGER32, "ro"),
        ]
        self._edge_type = Entry("Edge type", UNSIGNED8, high=2)
        self._marker_mode = Entry("Mode", UNSIGNED8, high=2)
        self._marker_counter = Entry("Counter", UNSIGNED16)
        first, *history = self._captured
        od.record(0x2074, first, self._edge_type, self._marker_mode, self._marker_counter, *history)
        self._outputs = [
            Entry(f"Configuration of digital output {n}", UNSIGNED16, value=15)
            for n in range(1, NUMBER_OF_OUTPUTS + 1)
        ]
        od.record(0x2079, *self._outputs)
        self._compare = Entry("Configuration", UNSIGNED16, mappable=True)
        self._reference = Entry("Reference position", INTEGER32, mappable=True)
        self._width = Entry("Interval width", INTEGER32, low=0)
        self._repetitions = Entry("Interval repetitions", UNSIGNED16)
        self._pulse_us = Entry("Pulse width", UNSIGNED16)
        od.record(
            0x207A,
            self._compare,
            self._reference,
            self._width,
            self._repetitions,
            self._pulse_us,
        )

    @property
    def pulses(self) -> list[int]:
        """Numbers of the digital outputs that follow the position compare."""
        return [n for n, entry in enumerate(self._outputs, 1) if entry.value == 1]

    def input_edge(self, rising: bool) -> None:
        """The marker's digital input changes, now."""
        wanted = {0: True, 1: rising, 2: not rising}[self._edge_type.value]
        single = self._marker_mode.value == 1
        if not wanted or (single and self._marker_counter.value):
            return
        self._marker_counter.value = (self._marker_counter.value + 1) % 0x1_0000
        newest, before, oldest = self._captured
        oldest.value, before.value = before.value, newest.value
        newest.value = self._motor.measured
        self._dirty = True

    def _control(self) -> None:
        super()._control()
        before, self._before = self._before, self._motor.position
        if self._compare.value & 1 and before != self._before:
            self._compare_between(before, self._before)

    def _release(self) -> None:
        super()._release()
        self._before = self._motor.position

    def _home_found(self, place: float) -> None:
        super()._home_found(place)
        self._before = self._motor.position

    def _compare_between(self, before: float, after: float) -> None:
        rising = after > before
        word = self._compare.value
        dependency = word >> 5 & 3
        if dependency != 2 and rising != bool(dependency):
            return
        low, high = sorted((before, after))
        begin_us = self.now_us - _CYCLE_US / self.rate
        fired = []
        for value in self._values(low, high):
            share = (value - _EDGE - before) / (after - before)
            fired.append(Fired(begin_us + share * (self.now_us - begin_us), value, rising))
        self.fired += sorted(fired)

    def _values(self, low: float, high: float) -> list[int]:
        """Those that are crossed between two positions."""
        word, reference, width = self._compare.value, self._reference.value, self._width.value
        if not word >> 1 & 3 or not width:
            candidates = [reference]
        else:
            direction, most = word >> 3 & 3, self._repetitions.value - 1
            first = max(-(-(low + _EDGE - reference) // width), 0 if direction == 1 else -most)
            last = min((high + _EDGE - reference) // width, 0 if direction == 0 else most)
            candidates = [reference + width * n for n in range(int(first), int(last) + 1)]
        return [value for value in candidates if low < value - _EDGE <= high]
