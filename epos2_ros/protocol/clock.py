"""The master clock that the drives' motion clocks follow.

Application note 2.4: TIME sets the motion clock of a drive to zero; after every SYNC the master
sends the time at which that SYNC was really on the bus (0x1013), and each drive corrects its
clock by the difference to what it latched. The stamp counts microseconds since TIME and wraps at
2³² (every 71.6 minutes), as the drives' clocks do.
"""

from __future__ import annotations

WRAP_US = 1 << 32
_SECONDS_TO_1984 = 441_763_200  # from 1970-01-01 to 1984-01-01, the epoch of TIME_OF_DAY


class MasterClock:
    """Maps host time [µs] to the time stamps the drives get."""

    def __init__(self) -> None:
        self.last_stamp = 0
        self._zero_us = 0.0

    def reset(self, t_us: float) -> None:
        """TIME was on the bus at `t_us`: the drives count from there."""
        self._zero_us = t_us

    def stamp(self, t_us: float) -> int:
        """High resolution time stamp (0x1013) of a SYNC that was on the bus at `t_us`."""
        self.last_stamp = round(t_us - self._zero_us) % WRAP_US
        return self.last_stamp


def time_of_day(unix_s: float) -> bytes:
    """The six bytes of TIME (CiA 301, TIME_OF_DAY): ms since midnight, days since 1984-01-01."""
    days, seconds = divmod(unix_s - _SECONDS_TO_1984, 86_400)
    return (int(seconds * 1000) & 0x0FFF_FFFF).to_bytes(4, "little") + int(days).to_bytes(
        2, "little"
    )
