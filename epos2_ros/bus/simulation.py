"""Drives without hardware, in the driver's own process."""

from __future__ import annotations

from epos2_ros.bus.link import open_bus
from epos2_ros.configuration.driver import DriverConfig
from epos2_ros.protocol import cl3e, copley, epos2
from epos2_ros.sim.cl3e import Cl3e
from epos2_ros.sim.copley import Copley
from epos2_ros.sim.epos2 import Dictionary, Epos2
from epos2_ros.sim.realtime import (
    RealtimeSimulator,
    build_cl3e_drives,
    build_copley_drives,
    build_drives,
    save_log,
)


class Simulation:
    """Simulated drives for every joint of the configuration, on the driver's own bus."""

    def __init__(self, config: DriverConfig) -> None:
        epos2s = [axis for axis in config.axes if axis.drive == epos2.FAMILY.key]
        copleys = [axis for axis in config.axes if axis.drive == copley.FAMILY.key]
        cl3es = [axis for axis in config.axes if axis.drive == cl3e.FAMILY.key]
        self._log = config.simulation.log
        self._drives: list[Epos2 | Copley | Cl3e] = []
        self._drives += build_drives(
            [axis.node_id for axis in epos2s],
            counts_per_turn=[axis.counts_per_turn for axis in epos2s],
            drift_ppm=config.simulation.drift_ppm,
            seed=config.simulation.seed,
            bitrate=config.bitrate,
            dictionary=Dictionary(config.simulation.dictionary),
            record=self._log is not None,
        )
        sampled = {output.joint for output in config.outputs if output.extrapolated}
        self._drives += build_copley_drives(
            [axis.node_id for axis in copleys],
            drift_ppm=config.simulation.drift_ppm,
            seed=config.simulation.seed,
            record=self._log is not None,
            extrapolated=[axis.node_id for axis in copleys if axis.joint in sampled],
        )
        self._drives += build_cl3e_drives(
            [axis.node_id for axis in cl3es],
            counts_per_turn=[axis.counts_per_turn for axis in cl3es],
            drift_ppm=config.simulation.drift_ppm,
            seed=config.simulation.seed,
            record=self._log is not None,
        )
        self._bus = open_bus(config.interface, config.channel, config.bitrate, echoes=False)
        self._simulator = RealtimeSimulator(self._bus, self._drives)
        self._simulator.start()

    def push(self, node_id: int, counts: float) -> bool:
        """A hand turns the shaft of one drive; `False`: the motor holds it."""
        return self._simulator.push(node_id, counts)

    def close(self) -> None:
        """Stop them and write their log."""
        self._simulator.stop()
        self._bus.shutdown()
        if self._log is not None:
            save_log(self._log, self._drives)
