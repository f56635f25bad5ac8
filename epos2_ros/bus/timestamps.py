"""The host's clock, and when a frame was on the bus by that clock.

Everything runs on CLOCK_MONOTONIC in microseconds. Adapters stamp frames with the system's wall
clock (SocketCAN's kernel stamps, `virtual`, `udp_multicast`) or with a clock of their own
(hardware stamps, counting from when the adapter was plugged in).
"""

from __future__ import annotations

import time

WALL_CLOCK_TOLERANCE_S = 5.0


def now_us() -> float:
    """Host time: CLOCK_MONOTONIC [µs]."""
    return time.monotonic_ns() / 1000


def wall_offset_us() -> float:
    """Host time minus wall clock [µs], read now."""
    return time.monotonic_ns() / 1000 - time.time_ns() / 1000


class ReceiveClock:
    """Turns an adapter's time stamps into host time."""

    def __init__(self) -> None:
        self.source = "estimate: time of the send call and frame length"
        self._offset_us: float | None = None  # host time minus the adapter's own clock

    def host_us(self, stamp_s: float) -> float:
        """When a frame stamped `stamp_s` [s] by the adapter was on the bus, in host time [µs]."""
        now = now_us()
        if not stamp_s:
            self.source = "time of reception"
            return now
        if abs(stamp_s - time.time()) < WALL_CLOCK_TOLERANCE_S:
            self.source = "system clock of the adapter's driver"
            return min(now, stamp_s * 1e6 + wall_offset_us())
        # A clock of its own: a frame is never seen before it was stamped, so the smallest delay
        # seen is the best estimate of where that clock's zero is.
        self.source = "hardware clock of the adapter"
        offset = now - stamp_s * 1e6
        if self._offset_us is None or offset < self._offset_us:
            self._offset_us = offset
        return stamp_s * 1e6 + self._offset_us
