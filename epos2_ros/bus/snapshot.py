"""The drives and their bus at one instant, as the topics show them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from epos2_ros.bus.health import BusState
from epos2_ros.bus.lateness import LatenessFigures
from epos2_ros.motion.units import AxisUnits
from epos2_ros.protocol.identity import Identity
from epos2_ros.protocol.machine import Machine
from epos2_ros.protocol.outputs.outputs import Tally
from epos2_ros.protocol.phase import IN_MOTION
from epos2_ros.protocol.whereabouts import Whereabouts


@dataclass(frozen=True)
class AxisSnapshot:
    """One axis as last reported. Joint units; NaN where the drive has not said yet."""

    joint: str
    node_id: int
    state: str  # CiA 402 state
    position: float
    velocity: float
    effort: float  # motor current [A]
    used: int
    free: int
    size: int
    buffered_ms: float
    status_word: int  # 0x20C4-01 of an EPOS2, 0x2012 of a Copley drive
    fault: str
    following_error_qc: int | None  # None: this drive does not say
    clock_offset_us: float | None  # None: this drive has no clock that could be set
    clock_drift_ppm: float | None
    executed_qc: int | None  # position demand at the last SYNC
    records_sent: int
    buffer_flags: Mapping[str, bool] = field(default_factory=dict)  # of that, by name
    emergency: int = 0  # error code of the last emergency (CiA 301); 0: none, or all are gone
    homed: str = ""  # the method by which it was; "": it was not
    reserve_ms: float | None = None  # least time before an underflow, since the motion began
    silent_s: float = 0.0  # not heard for so long; 0 as long as it is heard
    identity: Identity | None = None  # None until the drive has been brought up
    set_points: int | None = None  # taken since the motion began; None: it follows by none
    path_error_qc: float | None = None  # of what these lead to, from the commanded curve


class JointStates(NamedTuple):
    """The joints that are heard, all at one instant; lists are by joint, in joint units."""

    t_us: float  # host time
    joints: list[str]
    position: list[float]
    velocity: list[float]
    effort: list[float]  # motor current [A]; NaN: the drive does not say


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
    late: LatenessFigures | None = None  # the thread that feeds the drives; None: not yet
    scheduling: str = ""  # of that thread
    memory_locked: bool = False


def joint_states(whereabouts: Whereabouts, machine: Machine, now_us: float) -> JointStates:
    """Where the axes are now; none as long as some have not said it since they were brought up."""
    axes = whereabouts.at(now_us)
    configs = [machine.config.axes[axis.place] for axis in axes]
    units = [AxisUnits.of(config) for config in configs]
    currents = [machine.drives[axis.place].current_ma for axis in axes]
    return JointStates(
        now_us,
        [config.joint for config in configs],
        [unit.from_qc(axis.position_qc) for unit, axis in zip(units, axes, strict=True)],
        [unit.from_qc_s(axis.velocity_qc_s) for unit, axis in zip(units, axes, strict=True)],
        [math.nan if current is None else current / 1000 for current in currents],
    )


def axis_snapshots(
    machine: Machine, now_us: float, deaf: bool, identities: Mapping[str, Identity]
) -> tuple[AxisSnapshot, ...]:
    """Of all axes; `deaf`: nothing is heard any more; `identities`: of their drives, by joint."""
    nan, clock = math.nan, machine.time.clock
    in_motion = machine.group.phase in IN_MOTION
    path_ms = machine.path_time.at_ms(now_us) if in_motion else math.inf
    followers = {axis.drive: axis for axis in machine.interpolated.axes}
    queued = {axis.drive: axis for axis in machine.set_points.axes}
    snapshots = []
    for drive, config in zip(machine.drives, machine.config.axes, strict=True):
        units, known = AxisUnits.of(config), drive.position_qc is not None
        silent_us = now_us - drive.heard_us
        clocked = machine.time.drives.index(drive) if drive in machine.time.drives else None
        follower = followers.get(drive)
        account = follower.account if follower else None
        used, size = (account.level(path_ms), account.size) if account else (0, 0)
        snapshot = AxisSnapshot(
            joint=drive.joint,
            node_id=drive.node_id,
            state=drive.state.value,
            position=units.from_qc(float(drive.position_qc or 0)) if known else nan,
            velocity=units.from_qc_s(drive.velocity_qc_s) if known else nan,
            effort=nan if drive.current_ma is None else drive.current_ma / 1000,
            used=used,
            free=size - used,
            size=size,
            buffered_ms=max(0.0, account.ahead_ms(path_ms)) if account else 0.0,
            status_word=drive.buffer_status,
            fault=drive.trouble(),
            emergency=drive.emergency,
            following_error_qc=drive.following_error_qc,
            clock_offset_us=None if clocked is None else float(clock.offset_us[clocked]),
            clock_drift_ppm=None if clocked is None else 1e6 * float(clock.drift[clocked]),
            executed_qc=drive.demand_qc,
            records_sent=account.sent if account else 0,
            set_points=queued[drive].count if drive in queued else None,
            path_error_qc=queued[drive].error_qc if drive in queued else None,
            homed=drive.homed,
            reserve_ms=account.reserve_ms if account else None,
            buffer_flags={}
            if follower is None
            else follower.buffer.flags(drive.buffer_status, drive.statusword),
            silent_s=silent_us / 1e6 if deaf or machine.group.silent(drive) else 0.0,
            identity=identities.get(drive.joint),
        )
        snapshots.append(snapshot)
    return tuple(snapshots)
