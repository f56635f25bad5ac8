"""The position-triggered outputs of a simulated Copley drive.

Source: Copley, "Setting outputs at position" (in the text: "the note"). `CompareModule` is the
circuit of section "Hardware triggered outputs", `SoftwarePin` what the firmware does at the
position loop rate. A value V is crossed upward when the encoder goes from V − 1 to V, downward
from V to V − 1: the reading under which the note's example of 1199 comes out.
Times are true time in µs, positions whole encoder counts.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Callable, Sequence
from typing import NamedTuple

PULSE_UNIT_US = 0.01
_INT32 = 1 << 32


class Fired(NamedTuple):
    """An output pulsed or toggled, or went in or out of a window."""

    t_us: float
    value: int  # that was crossed
    rising: bool
    level: bool  # of the output afterwards, before inversion


class CompareModule:
    """Registers 0x2160 … 0x2165 and what the circuit does with them."""

    def __init__(self) -> None:
        self.fired: list[Fired] = []
        self._position = 0
        self.reset()

    def reset(self) -> None:
        """As at power-on."""
        self.configuration = 0
        self.matches = 0  # bits 1 and 2 of the status
        self.values = [0, 0]
        self.increment = 0
        self.pulse_period = 0  # the lower 20 bits count
        self._toggled = False
        self._pulse_end_us = -math.inf

    @property
    def enabled(self) -> bool:
        return bool(self.configuration & 1)

    @property
    def mode(self) -> int:
        return self.configuration >> 3 & 3

    def configure(self, value: int) -> None:
        """0x2160 was written."""
        self.configuration = value
        self._toggled = False
        self._pulse_end_us = -math.inf

    def output(self, t_us: float) -> bool:
        """The output's level, inversion included."""
        inverted = bool(self.configuration & 2)
        if not self.enabled:
            return inverted
        if self.mode == 2:
            active = self._inside
        elif self.configuration & 4:
            active = self._toggled
        else:
            active = t_us < self._pulse_end_us
        return active != inverted

    def status(self, t_us: float) -> int:
        """0x2161."""
        return self.matches | self.output(t_us)

    def stand(self, count: int) -> None:
        """The position is known anew, without having moved there."""
        self._position = count

    def move(self, target: int, when_us: Callable[[int], float]) -> None:
        """The encoder goes to `target`, count by count.

        `when_us(V)` tells when it changes between V − 1 and V.
        """
        while self._position != target:
            rising = target > self._position
            ahead = [value for value in self._watched() if self._passes(value, target)]
            if not ahead:
                self._position = target
                return
            value = min(ahead) if rising else max(ahead)
            self._position = value if rising else value - 1
            self._match(value, rising, when_us(value))

    def _watched(self) -> list[int]:
        if not self.enabled:
            return []
        if self.mode == 1:
            return self.values[:1]
        return self.values + self._edges()

    def _edges(self) -> list[int]:
        """Of the window of mode 2: active above value 0, up to and including value 1."""
        return [value + 1 for value in self.values] if self.mode == 2 else []

    @property
    def _inside(self) -> bool:
        return self.values[0] < self._position <= self.values[1]

    def _passes(self, value: int, target: int) -> bool:
        if target > self._position:
            return self._position < value <= target
        return target < value <= self._position

    def _match(self, value: int, rising: bool, t_us: float) -> None:
        mode = self.mode
        matched = [n for n in (0, 1)[: len(self._watched())] if self.values[n] == value]
        for n in matched:
            self.matches |= 2 << n
        if mode == 0:
            for n in matched:
                self._add(1 - n, self.increment if rising else -self.increment)
            self._fire(value, rising, t_us)
        elif mode == 2:
            if value in self._edges():
                self.fired.append(Fired(t_us, value, rising, self._inside))
        else:
            if 0 in matched and rising == (self.increment > 0):
                self._add(0, self.increment)
                self._fire(value, rising, t_us)
            if mode == 3 and 1 in matched:
                self.configuration &= ~1

    def _add(self, number: int, increment: int) -> None:
        value = self.values[number] + increment
        self.values[number] = (value + _INT32 // 2) % _INT32 - _INT32 // 2

    def _fire(self, value: int, rising: bool, t_us: float) -> None:
        if self.configuration & 4:
            self._toggled = not self._toggled
        else:
            self._pulse_end_us = t_us + (self.pulse_period & 0xF_FFFF) * PULSE_UNIT_US
        self.fired.append(Fired(t_us, value, rising, True))


class SoftwarePin:
    """One output 0x2193-n, looked at once a loop."""

    def __init__(self, trace: TraceMemory) -> None:
        self.fired: list[Fired] = []
        self.word = self.first = self.second = 0
        self._trace = trace
        self._last: int | None = None
        self._inside = False
        self._pulse_end_us = -math.inf

    @property
    def function(self) -> int:
        return self.word & 0xFF

    @property
    def commanded(self) -> bool:
        """Whether it follows the commanded position (bit 14)."""
        return bool(self.word & 1 << 14)

    def configure(self, data: bytes) -> None:
        """0x2193-n was written."""
        self.word = int.from_bytes(data[:2], "little")
        self.first = int.from_bytes(data[2:6], "little", signed=True)
        self.second = int.from_bytes(data[6:10], "little", signed=True)
        self._last = None
        self._inside = False
        self._pulse_end_us = -math.inf

    def output(self, t_us: float) -> bool:
        """The output's level, inversion (bit 8) included."""
        active = self._inside if self.function == 4 else t_us < self._pulse_end_us
        return active != bool(self.word & 1 << 8)

    def sample(self, count: int, t_us: float) -> None:
        """The firmware compares with the position of this loop."""
        last, self._last = self._last, count
        if self.function == 4:
            inside = self.first <= count <= self.second
            if inside != self._inside and last is not None:
                self.fired.append(Fired(t_us, count, count > last, inside))
            self._inside = inside
        elif last is not None and last != count:
            self._compare(last, count, t_us)

    def _compare(self, last: int, count: int, t_us: float) -> None:
        rising = count > last
        if self.function == 9:
            positions = self._trace.positions(self.first >> 16 & 0xFFFF, self.first & 0xFFFF)
            period_ms = self.second & 0xFFFF
        elif self.function in (5, 6, 7):
            wanted = {5: rising, 6: not rising, 7: True}[self.function]
            positions = [self.first] if wanted else []
            period_ms = self.second & 0xFFFF_FFFF
        else:
            return
        low, high = min(last, count), max(last, count)
        passed = positions[bisect_left(positions, low + 1) : bisect_left(positions, high + 1)]
        for position in passed if rising else reversed(passed):
            self._pulse_end_us = t_us + 1000.0 * period_ms
            self.fired.append(Fired(t_us, position, rising, True))


class TraceMemory:
    """The reserved part of the trace memory, in 16-bit words (0x250A … 0x250C)."""

    def __init__(self, size: int) -> None:
        self.size = size
        self.offset = 0
        self._words: list[int] = []

    @property
    def reserved(self) -> int:
        return len(self._words)

    def reserve(self, words: int) -> None:
        self._words = [0] * words
        self.offset = 0

    def fits(self, data: bytes) -> bool:
        """Whether 32-bit positions can be written at the offset."""
        words, rest = divmod(len(data), 2)
        return not rest and words % 2 == 0 and self.offset + words <= self.reserved

    def write(self, data: bytes) -> None:
        """At the offset, which moves on."""
        for n in range(0, len(data), 2):
            self._words[self.offset] = int.from_bytes(data[n : n + 2], "little")
            self.offset += 1

    def positions(self, offset: int, number: int) -> Sequence[int]:
        """32-bit positions from word `offset` on, as many as there are."""
        words = self._words[offset : offset + 2 * number]
        return [
            int.from_bytes((low | high << 16).to_bytes(4, "little"), "little", signed=True)
            for low, high in zip(words[::2], words[1::2], strict=False)
        ]
