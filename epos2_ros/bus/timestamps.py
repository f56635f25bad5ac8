"""The host's clock, and when a frame was on the bus by that clock.

Everything runs on CLOCK_MONOTONIC in microseconds. Adapters stamp frames with the system's wall
clock (SocketCAN's kernel stamps, `virtual`, `udp_multicast`) or with a clock of their own
(hardware stamps, counting from when the adapter was plugged in).
"""

from __future__ import annotations

import math
import time

WALL_CLOCK_TOLERANCE_US = 5e6
REREAD_US = 100_000.0  # both clocks are slewed alike: only a step of the wall clock parts them
UNDISTURBED_US = 5.0  # reading a clock before and after another takes less
READINGS = 10


def now_us() -> float:
    """Host time: CLOCK_MONOTONIC [µs]."""
    return time.monotonic_ns() / 1000


def wall_offset_us() -> float:
    """Host time minus wall clock [µs], both read now with nothing in between."""
    best_ns, offset_ns = 1 << 62, 0
    for _ in range(READINGS):
        before = time.monotonic_ns()
        wall = time.time_ns()
        taken = time.monotonic_ns() - before
        if taken < best_ns:
            best_ns, offset_ns = taken, before + taken // 2 - wall
        if taken < 1000 * UNDISTURBED_US:
            break
    return offset_ns / 1000


class ReceiveClock:
    """Turns an adapter's time stamps into host time."""

    def __init__(self) -> None:
        self.source = "estimate: time of the send call and frame length"
        self._offset_us: float | None = None  # host time minus the adapter's own clock
        self._wall_offset_us = 0.0  # host time minus wall clock …
        self._read_us = -math.inf  # … when it was last read

    def host_us(self, stamp_s: float) -> float:
        """When a frame stamped `stamp_s` [s] by the adapter was on the bus, in host time [µs]."""
        now = now_us()
        if not stamp_s:
            self.source = "time of reception"
            return now
        if now > self._read_us + REREAD_US:
            self._wall_offset_us, self._read_us = wall_offset_us(), now
        on_bus = stamp_s * 1e6 + self._wall_offset_us
        if abs(on_bus - now) < WALL_CLOCK_TOLERANCE_US:
            self.source = "system clock of the adapter's driver"
            return min(now, on_bus)
        # A clock of its own: a frame is never seen before it was stamped, so the smallest delay
        # seen is the best estimate of where that clock's zero is.
        self.source = "hardware clock of the adapter"
        offset = now - stamp_s * 1e6
        if self._offset_us is None or offset < self._offset_us:
            self._offset_us = offset
        return stamp_s * 1e6 + self._offset_us
