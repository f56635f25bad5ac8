"""What the driver is told before it starts: one value object per axis, one for the group.

The names are those of the ROS parameters (`axes.<joint>.node_id` is
`AxisConfig.node_id`); `None` means "not set".
"""

from __future__ import annotations

from dataclasses import dataclass, field

from epos2_ros.configuration.outputs import CompareConfig


@dataclass(frozen=True)
class HomingConfig:
    """`axes.<joint>.homing.*`: how an axis finds its home."""

    method: str = ""  # by name, as in protocol.homing_methods; "": it is not homed
    speeds: tuple[float, float] | None = None  # [switch, zero] [unit/s]
    acceleration: float | None = None  # [unit/s²]
    offset: float = 0.0  # where the axis is when homed [unit]
    back_off: float = 0.0  # how far it moves away first [unit]
    order: int = 0
    max_travel: float | None = None  # beyond it the search is stopped [unit]
    required: bool = False  # no motion before it is homed


@dataclass(frozen=True)
class AxisConfig:
    """One joint and the drive that moves it. Joint units are rad (revolute) or m (prismatic)."""

    joint: str
    node_id: int
    drive: str = "epos2"
    type: str = "revolute"
    counts_per_turn: int = 2000  # quadrature counts per motor turn [qc]
    gear_ratio: float = 1.0  # motor turns per output turn
    lead: float | None = None  # prismatic: metres per output turn
    direction: int = 1
    offset: float = 0.0  # joint position where the drive reads 0
    velocity_notation: int = 0  # drive velocity unit is 10^n rpm (0x608B)
    min_position: float | None = None
    max_position: float | None = None
    max_velocity: float | None = None
    max_acceleration: float | None = None
    max_jerk: float | None = None  # of moves in profile position mode
    stop_deceleration: float | None = None
    max_following_error: int = 2000  # [qc], 0x6065
    trajectory: str = ""  # how it follows one: "pvt", "setpoints", "profile"; "": its family's best
    homing: HomingConfig | None = None
    path_tolerance: float = 0.0  # of an action goal [rad or m]; 0: not checked
    goal_tolerance: float = 0.0


@dataclass(frozen=True)
class SimulationConfig:
    """What the simulated drives inside the driver are like (`simulate: true`)."""

    drift_ppm: float = 0.0  # each drive's clock runs at 1 + U(-d, d)·1e-6
    seed: int = 0
    dictionary: str = "maker"  # whose object dictionary an EPOS2 has: "maker" or "note"
    log: str | None = None  # .npz file written at shutdown: executed demand per axis and ms


@dataclass(frozen=True)
class ClockLimits:
    """From where on a drive's clock is reported as a warning or an error in /diagnostics."""

    offset_warning_us: float = 100.0  # from the master's time
    offset_error_us: float = 1000.0
    drift_warning_ppm: float = 200.0  # of its quartz against the host's clock
    drift_error_ppm: float = 450.0


@dataclass(frozen=True)
class DriverConfig:
    """The whole group on one bus."""

    axes: tuple[AxisConfig, ...]
    interface: str = "virtual"
    channel: str = "epos2"
    bitrate: int = 1_000_000
    simulate: bool = True
    sync_period: float = 0.1  # [s]
    sync_source: str = "host"  # whose clock is the master: host or a joint
    sync_producer: str = "host"  # who sends SYNC: host or a joint
    clock_limits: ClockLimits = field(default_factory=ClockLimits)
    buffer_time: float = 0.5  # [s]
    stream_ahead: float = 0.14  # as buffer_time, while points are streamed [s]
    tolerance: float = 1.0  # [qc]
    smoothness: float = 0.8  # as of motion.fit.Fitter
    least_velocity: float = 0.0  # of a record, but 0 [rpm of the motor]
    start_tolerance: float = 0.01  # [rad or m]
    approach: bool = False  # go to the first point, where the axes are away from it
    goal_time: float = 1.0  # [s]; 0: no limit
    allow_partial_joints_goal: bool = False
    state_rate: float = 50.0  # [Hz]
    realtime_priority: int = 50  # SCHED_FIFO, of the threads that feed and receive; 0: ordinary
    outputs: tuple[CompareConfig, ...] = ()
    log_file: str | None = None
    log_size: float = 100.0  # of all its files [MB]
    simulation: SimulationConfig = field(default_factory=SimulationConfig)
