"""The host's clock, and when a frame was on the bus by that clock.

Everything runs on CLOCK_MONOTONIC in microseconds. Adapters stamp frames with the system's wall
clock (SocketCAN's kernel stamps, `virtual`, `udp_multicast`) or with a clock of their own
(hardware stamps, counting from when the adapter was plugged in).

The wall clock may be set, forwards or back, at any moment, also between a frame's stamp and when it
is read. So it is compared with the host's clock for each frame, and what it was before it was set
is kept: a frame was on the bus at the latest time by any of these that is not to come yet.
"""

from __future__ import annotations

import math
import time
from collections import deque

WALL_CLOCK_TOLERANCE_US = 5e6
REREAD_US = 100_000.0  # both clocks are slewed alike: only a step of the wall clock parts them
READ_US = 2_000.0  # reading two clocks takes less, unless one is interrupted
STEP_US = 20_000.0  # what is less is no step worth to remember, but a reading that was disturbed
FRAMES_AGE_US = 5e6  # no frame is on its way for so long
UNDISTURBED_US = 5.0  # reading a clock before and after another takes less
READINGS = 10
EARLY_US = 1_000.0  # a frame is never seen before it was stamped, but for errors of the clocks
WINDOW_US = 10e6  # over which an adapter's clock is compared with the host's


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
        self._wall_offset_us = math.inf  # host time minus wall clock …
        self._read_us = -math.inf  # … when it was last read
        self._before: deque[tuple[float, float]] = deque()  # steps: until when what was before them
        self._own_clock = OwnClock()

    def host_us(self, stamp_s: float) -> float:
        """When a frame stamped `stamp_s` [s] by the adapter was on the bus, in host time [µs]."""
        now = now_us()
        if not stamp_s:
            self.source = "time of reception"
            return now
        self._compare(now)
        stamp_us = stamp_s * 1e6
        latest = -math.inf
        for offset in (self._wall_offset_us, *(offset for _, offset in self._before)):
            if latest < stamp_us + offset < now + EARLY_US:
                latest = stamp_us + offset
        if latest > now - WALL_CLOCK_TOLERANCE_US:
            self.source = "system clock of the adapter's driver"
            return min(now, latest)
        self.source = "hardware clock of the adapter"
        return self._own_clock.host_us(stamp_us, now)

    def _compare(self, now: float) -> None:
        """Read the wall clock anew where it was set, or was not read for long."""
        last = self._wall_offset_us
        parted = abs(now - time.time_ns() / 1000 - last) > READ_US
        if parted or now > self._read_us + REREAD_US:
            self._wall_offset_us, self._read_us = wall_offset_us(), now
            if STEP_US < abs(self._wall_offset_us - last) < math.inf:
                self._before.append((now + FRAMES_AGE_US, last))
        while self._before and now > self._before[0][0]:
            self._before.popleft()


class OwnClock:
    """A clock that counts from anywhere, at nearly the host's rate.

    A frame is never seen before it was stamped, so the smallest delay seen lately is the best
    estimate of where that clock's zero is.
    """

    def __init__(self) -> None:
        self._offset_us = self._offset_before_us = math.inf  # smallest of this window, of the last
        self._until_us = -math.inf

    def host_us(self, stamp_us: float, now: float) -> float:
        """When it stood at `stamp_us`, read at `now` [host µs]."""
        if now > self._until_us:
            self._offset_before_us, self._offset_us = self._offset_us, math.inf
            self._until_us = now + WINDOW_US
        self._offset_us = min(self._offset_us, now - stamp_us)
        return stamp_us + min(self._offset_us, self._offset_before_us)
