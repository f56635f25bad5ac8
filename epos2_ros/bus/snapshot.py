"""The drives and their bus at one instant, as the topics show them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from epos2_ros.bus.health import BusState
from epos2_ros.protocol.outputs import Tally


@dataclass(frozen=True)
class AxisSnapshot:
    """One axis as last reported. Joint units; NaN where the drive has not said yet."""

    joint: str
    node_id: int
    state: str  # CiA 402 state
    position: float
    velocity: float
    effort: float  # motor current [A]
    stamp_us: float  # host time of the position sample
    used: int
    free: int
    size: int
    buffered_ms: float
    status_word: int  # 0x20C4-01
    fault: str
    following_error_qc: int | None  # None: this drive does not say
    clock_offset_us: float | None  # None: this drive has no clock that could be set
    clock_drift_ppm: float | None
    executed_qc: int | None  # position demand at the last SYNC
    records_sent: int
    silent_s: float = 0.0  # not heard for so long; 0 as long as it is heard


class OutputSnapshot(NamedTuple):
    """One position-triggered output."""

    name: str
    joint: str
    node_id: int
    tally: Tally


@dataclass(frozen=True)
class Snapshot:
    """The whole group at one instant."""

    axes: tuple[AxisSnapshot, ...]
    state: str
    reason: str
    bus_load: float  # 0 … 1
    sync_count: int
    sync_time_source: str
    dropped_frames: int
    error_frames: int
    refused_frames: int
    bus_state: str = BusState.ACTIVE.value  # of the CAN controller, as far as it tells
    transmit_errors: int = 0  # the controller's counters
    receive_errors: int = 0
    start_error_us: float | None = None  # of the last start at a given time
    outputs: tuple[OutputSnapshot, ...] = ()
    simulated: bool = False  # the drives are simulated, in the driver's own process
    rejected: Mapping[str, int] = field(default_factory=dict)  # input that was dropped, by kind
    internal_errors: int = 0
