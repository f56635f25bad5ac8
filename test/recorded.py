"""Runs in simulated time that leave a log, as the driver's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from simulated_time import Bench, axes

from epos2_ros.buslog import inputs
from epos2_ros.buslog.plain import to_plain
from epos2_ros.buslog.writer import LogWriter
from epos2_ros.configuration.driver import DriverConfig
from epos2_ros.errors import Epos2RosError
from epos2_ros.sim.epos2 import Epos2

BEGIN_US = 3.6e9  # host time when simulated time begins: an hour after it was switched on
WALL_OFFSET_US = BEGIN_US - 1.7e15


class Recorded(Bench):
    """A bench whose host clock is `BEGIN_US` ahead of simulated time, with a log.

    Use `close` before reading the log.
    """

    def __init__(
        self, file: Path, config: DriverConfig | None = None, drives: Sequence[Epos2] | None = None
    ) -> None:
        config = config or DriverConfig(axes=axes())
        self.log: LogWriter | None = None
        if drives is None:
            drives = [
                Epos2(a.node_id, drift_ppm=30.0 * (n - 2.4), offset_us=1e6 * n)
                for n, a in enumerate(config.axes)
            ]
        super().__init__(config, drives, bring_up=False)
        self.stamp_us = lambda t_us: round(t_us, 3)  # the driver's own are whole nanoseconds
        self.log = LogWriter(
            file,
            round(config.log_size * 1e6),
            0.0,
            lambda: WALL_OFFSET_US,
            preamble=(("configuration", to_plain(config)),),
        )
        inputs.record(self.machine, self.log, lambda: self.now_us)
        try:
            self.bring_up()
        except Epos2RosError as error:
            self.log.event(self.now_us, "configure_failed", str(error))
            self.close()
            raise

    def _flush(self) -> None:
        if self.log is not None:
            for event in self.machine.out.events:
                self.log.event(self.now_us, event.kind, event.text)
        super()._flush()

    def close(self) -> None:
        assert self.log is not None
        self.log.close()


def few(count: int, **changes: object) -> DriverConfig:
    """A configuration of `count` axes."""
    return replace(DriverConfig(axes=axes(count)), **changes)  # type: ignore[arg-type]
