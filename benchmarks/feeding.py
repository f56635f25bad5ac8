"""Hours of feeding, every record accounted for.

    python -m benchmarks.feeding                    # one hour, six axes; about a quarter of one
    python -m benchmarks.feeding --seconds 60

In simulated time, on a bus of 125 kbit/s and with what real adapters do: a transmit queue of ten
frames, as SocketCAN's, that another program fills to the brim 27 times a second, so that frames of
the driver are refused; a host that wakes up to 1 ms late; time stamps with 20 us of noise; drives
from -100 to +100 ppm. What the fitter made is compared, record by record, with what each drive has
taken in.
"""

from __future__ import annotations

import argparse
import random
from collections import deque
from collections.abc import Sequence

import numpy as np
from simulated_time import Bench, axes

from epos2_ros.configuration.driver import DriverConfig
from epos2_ros.motion.record import Record
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.protocol.frame import Frame
from epos2_ros.protocol.pvt.axis import PvtAxis
from epos2_ros.sim.can_bus import TransmitQueueFull
from epos2_ros.sim.epos2 import Epos2

AXES = 6
QUEUE = 10
CHATTER_S = 0.0371  # no multiple of a period of ours
CHATTER_ID = 0x7E0  # of another program: no CANopen function of ours
RECORD = 0x200  # COB-ID of RPDO1 without the node id
REACH_RAD = 0.3


class Ledger:
    """The records on their way to each drive, and how many have arrived."""

    def __init__(self, made: Bench) -> None:
        self.arrived = 0
        self._sent: dict[int, deque[bytes]] = {drive.node_id: deque() for drive in made.drives}
        for axis in made.machine.interpolated.axes:
            self._note(axis)

    def _note(self, axis: PvtAxis) -> None:
        send, sent = axis.send, self._sent[axis.drive.node_id]

        def noting(record: Record, path_ms: float) -> list[Frame]:
            frames = send(record, path_ms)
            sent.extend(frame.data for frame in frames)
            return frames

        axis.send = noting  # type: ignore[method-assign]

    @property
    def on_the_way(self) -> int:
        return sum(map(len, self._sent.values()))

    def take(self, node_id: int, data: bytes) -> None:
        """A drive has got a record: the next that was made for it, or something is wrong."""
        waiting = self._sent[node_id]
        if not waiting or waiting.popleft() != data:
            raise SystemExit(f"node {node_id}: a record was lost, repeated or overtaken")
        self.arrived += 1


class Drive(Epos2):
    """Tells what records it takes in."""

    ledger: Ledger | None = None

    def receive(self, can_id: int, data: bytes, t_us: float, remote: bool = False) -> bool:
        if self.ledger and can_id == RECORD + self.node_id:
            self.ledger.take(self.node_id, data)
        return super().receive(can_id, data, t_us, remote)


def bench(seed: int) -> tuple[Bench, Ledger]:
    """Drives brought up and enabled on a bus with its troubles."""
    rng = random.Random(seed)
    drives = [Drive(n, drift_ppm=40.0 * (n - 3.5), offset_us=1e9 * n) for n in range(1, AXES + 1)]
    config = DriverConfig(axes=axes(AXES), bitrate=125_000, state_rate=10.0)
    made = Bench(config, drives, host_queue=QUEUE)
    made.late_us = lambda: rng.uniform(0.0, 1000.0)
    made.stamp_us = lambda t_us: t_us + rng.gauss(0.0, 20.0)
    made.enable()
    ledger = Ledger(made)
    for drive in drives:
        drive.ledger = ledger
    return made, ledger


def trajectory(seconds: float, seed: int) -> Trajectory:
    """A point a second, each axis anywhere; rest at the ends."""
    rng = np.random.default_rng(seed)
    times_s = np.arange(0.0, max(seconds, 2.0) + 1.0)
    positions = rng.uniform(-REACH_RAD, REACH_RAD, (len(times_s), AXES))
    positions[[0, -1]] = 0.0
    names = tuple(axis.joint for axis in axes(AXES))
    return Trajectory(names, times_s, positions, None, None)


def feed(seconds: float, seed: int = 1) -> tuple[int, int]:
    """Runs it; how many records arrived, and how many frames the adapter refused meanwhile.

    SystemExit if a record was lost, repeated or overtaken, or the motion stopped early.
    """
    made, ledger = bench(seed)
    made.path.submit(trajectory(seconds, seed), None, made.now_us)
    motion = made.group.motion
    assert motion is not None
    while not motion.done():
        made.run(CHATTER_S, motion.done)
        try:
            while True:
                made.bus.host_send(CHATTER_ID, bytes(8))
        except TransmitQueueFull:
            pass
        made.frames.clear()
    motion.result()
    if ledger.on_the_way:
        raise SystemExit(f"{ledger.on_the_way} records never arrived")
    return ledger.arrived, made.transmitter.refused


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--seconds", type=float, default=3600.0, help="of simulated time")
    parser.add_argument("--seed", type=int, default=1)
    chosen = parser.parse_args(argv)
    records, refused = feed(chosen.seconds, chosen.seed)
    print(
        f"{chosen.seconds:g} s, {AXES} axes: {records} records made, sent and taken in, each once "
        f"and in order; {refused} times the adapter's queue was full"
    )


if __name__ == "__main__":
    main()
