"""Path time: milliseconds since the SYNC that started the motion, by the master's clock."""

from __future__ import annotations

from epos2_ros.protocol.clock import MasterClock

NOISE_US = 500.0  # of a time stamp, and of the line through many


class PathTime:
    """Of the motion in progress, to come, or last.

    Path time goes by the master's clock. Where that is a drive's, its zero wanders in host time.
    """

    def __init__(self, clock: MasterClock, host_is_master: bool) -> None:
        self.late_us = 0.0  # so much later than it was, at most, the start SYNC may have been seen
        self.start_us: float | None = None  # host time of the start SYNC; None: not started
        self.planned_us: float | None = None  # when it was asked for; None: as soon as possible
        self._start_master_us = 0.0  # the start by the master's clock
        self._clock = clock
        self._host_is_master = host_is_master

    def plan(self, start_us: float | None) -> None:
        """A motion is to begin then."""
        self.start_us, self.planned_us = None, start_us

    def begin(self, t_us: float) -> None:
        """The start SYNC was on the bus."""
        self.start_us, self._start_master_us = t_us, self._clock.master_us(t_us)
        self.late_us = 0.0

    def correct(self, t_us: float) -> None:
        """The start SYNC was on the bus then, by the drives' clocks.

        Less is the noise of these; more is by how much the host has seen it late, as far as it
        can have.
        """
        late_us = (self.start_us or t_us) - t_us
        if NOISE_US < late_us < self.late_us + NOISE_US:
            self.begin(t_us)
        self.late_us = 0.0

    def zero_us(self, now_us: float) -> float:
        """Host time of path time zero; before the start SYNC, as far as is known."""
        if self.start_us is None:
            return self.planned_us or now_us
        if self._host_is_master:
            return self.start_us
        return now_us - self._passed_us(now_us)

    def at_ms(self, now_us: float) -> float | None:
        """Path time at `now_us`; None before the start SYNC."""
        if self.start_us is None:
            return None
        if self._host_is_master:
            return (now_us - self.start_us) / 1000
        return self._passed_us(now_us) / 1000

    def _passed_us(self, now_us: float) -> float:
        """Since the start SYNC, by the clock of the drive that is the master."""
        return self._clock.master_us(now_us) - self._start_master_us

    @property
    def start_error_us(self) -> float | None:
        """How much after the time asked for the last motion began; None: none was asked for."""
        if self.start_us is None or self.planned_us is None:
            return None
        return self.start_us - self.planned_us
