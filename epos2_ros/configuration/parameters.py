"""The parameters of the driver: what there is, what is allowed, and what it makes.

Every parameter is one `Spec` in a table. From it come the declaration (type, range and
description, as `ros2 param describe` shows them), the checks and the line a wrong value gets.
"Not set" is a value of the parameter's own type (an infinite limit, an empty name, 0 where 0
makes no sense), so that `ros2 param dump` writes a file which loads again.

Nothing here needs ROS: the node declares these parameters, `plan` reads them from a file.
"""

from __future__ import annotations

import re
from array import array
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from difflib import get_close_matches
from math import inf, isfinite
from typing import Any

from epos2_ros.configuration.driver import (
    AxisConfig,
    ClockLimits,
    DriverConfig,
    HomingConfig,
    SimulationConfig,
)
from epos2_ros.configuration.outputs import DIRECTIONS, KINDS, METHODS, REFERENCES, CompareConfig
from epos2_ros.errors import ConfigurationError

ROS_OWN = ("use_sim_time", "start_type_description_service")  # declared by rclpy itself
MAX_AXES = 127  # CANopen node ids are 1 … 127
# CiA 301, bit rates of the physical layer.
BIT_RATES = (10_000, 20_000, 50_000, 125_000, 250_000, 500_000, 800_000, 1_000_000)


@dataclass(frozen=True)
class Spec:
    """One parameter. The default's type is the parameter's; `low` and `high` are inclusive.

    For a list, `low` and `high` hold for each element, and a list of numbers has the default's
    length; with an `element` to be like it may have any, and is empty by default.
    """

    default: Any
    meaning: str
    low: float = -inf
    high: float = inf
    choices: tuple[Any, ...] = ()
    read_only: bool = False
    element: Any = None

    @property
    def allowed(self) -> str:
        """What may be written, in words."""
        if self.choices:
            *most, last = (choice for choice in self.choices if choice != "")
            return f"{', '.join(map(str, most))} or {last}" if most else str(last)
        if isinstance(self.default, bool):
            return "true or false"
        if isinstance(self.default, int):
            return f"a whole number{self._bounds}"
        if isinstance(self.default, float):
            return f"a number{self._bounds}"
        if isinstance(self.default, str):
            return "text"
        if isinstance(self._like, float):
            length = "" if self._any_length else f"{len(self.default)} "
            return f"a list of {length}numbers{self._bounds}"
        if self._any_length:
            return f"a list of up to {MAX_AXES} names of letters, digits and _, each once"
        return f"a list of 1 to {MAX_AXES} names of letters, digits, _, -, . and /, each once"

    @property
    def _any_length(self) -> bool:
        return self.element is not None

    @property
    def _like(self) -> Any:
        """What a value is like, or each of a list."""
        if self._any_length:
            return self.element
        return self.default[0] if isinstance(self.default, list) else self.default

    @property
    def _bounds(self) -> str:
        low, high = (f"{v:.12g}" for v in (self.low, self.high))
        if isfinite(self.low) and isfinite(self.high):
            return f" from {low} to {high}"
        return f" of at least {low}" if isfinite(self.low) else ""

    def read(self, value: Any) -> Any:
        """The value as this parameter's type; ValueError when it is not allowed.

        Whole numbers are accepted where numbers are asked for, as YAML writers expect.
        """
        if not isinstance(self.default, list):
            return self._read_one(value, self.default)
        if self._any_length and value is None:
            return []  # rcl reads an empty list as "not set"
        if not isinstance(value, (list, tuple, array)):
            raise ValueError
        if self._any_length and not value:
            return []
        values = [self._read_one(v, self._like) for v in value]
        if isinstance(self._like, str):
            named = all(map(_is_token if self._any_length else _is_joint, values))
            valid = named and 1 <= len(set(values)) == len(values) <= MAX_AXES
        else:
            valid = self._any_length or len(values) == len(self.default)
        if not valid:
            raise ValueError
        return values

    def _read_one(self, value: Any, like: Any) -> Any:
        if isinstance(like, float) and type(value) is int:
            value = float(value)
        if type(value) is not type(like):
            raise ValueError
        if self.choices and value not in self.choices:
            raise ValueError
        if type(value) in (int, float) and not self.low <= value <= self.high:
            raise ValueError
        return value

    def complaint(self, name: str, value: Any) -> str:
        """The line for a value that is not allowed."""
        line = f"{name} is {_written(value)}; it must be {self.allowed}"
        values = value if isinstance(value, (list, tuple)) else [value]
        if any(isinstance(v, bool) for v in values) and isinstance(self._like, str):
            return f"{line}; a bare y, n, on or off is a boolean, put it in quotes"
        return line


GROUP: dict[str, Spec] = {
    "autostart": Spec(True, "configure and activate at start", read_only=True),
    "can.interface": Spec("virtual", "python-can interface: socketcan, virtual, slcan, …"),
    "can.channel": Spec("epos2", "channel of the interface, e.g. can0"),
    "can.bitrate": Spec(1_000_000, "bit rate of the bus [bit/s]", choices=BIT_RATES),
    "sync.period": Spec(0.1, "period of the SYNC [s]", 0.005, 1.0),
    "sync.source": Spec("host", "whose clock is the master: host, or a joint with an EPOS2"),
    "sync.producer": Spec(
        "host",
        "who sends SYNC: host, or a joint whose EPOS2 has 0x1006 (no known firmware has)",
    ),
    "sync.offset_warning": Spec(100.0, "clock offset of a drive that is a warning [us]", 1.0, 1e6),
    "sync.offset_error": Spec(1000.0, "clock offset of a drive that is an error [us]", 1.0, 1e6),
    "sync.drift_warning": Spec(200.0, "clock drift of a drive that is a warning [ppm]", 1.0, 500.0),
    "sync.drift_error": Spec(450.0, "clock drift of a drive that is an error [ppm]", 1.0, 500.0),
    "ipm.buffer_time": Spec(
        0.5,
        "motion kept ahead in each drive's buffer, and how long a committed motion is before "
        "a new trajectory can take over [s]",
        0.05,
        10.0,
    ),
    "ipm.stream_ahead": Spec(
        0.14,
        "motion kept ahead while points are streamed (MoveIt Servo): how late the computer may be, "
        "and how much later the axes move [s]",
        0.05,
        1.0,
    ),
    "ipm.tolerance": Spec(
        1.0, "largest deviation of the executed curve from the commanded one [qc]", 0.5, 10_000.0
    ),
    "ipm.smoothness": Spec(
        0.8, "weight of smoothness against few records; 0 is fewest records", 0.0, 1e6
    ),
    "ipm.least_velocity": Spec(
        0.0,
        "velocities in records are 0 or at least this [rpm of the motor]; 0: any. Drivers of two "
        "robots with EPOS2 avoid those below 1 or 2 rpm and call it a limit of maxon's; no text of "
        "maxon's has it. Try 2 if axes stutter at low speed",
        0.0,
        100.0,
    ),
    "constraints.start_tolerance": Spec(
        0.01, "how far the first point may lie from where the robot is [rad or m]", 0.0
    ),
    "constraints.goal_time": Spec(
        1.0, "action: how long after its end a goal may be reached [s]; 0: no limit", 0.0, 1e6
    ),
    "approach": Spec(
        False,
        "where the first point of a trajectory is away from the axes, they go there first, in "
        "profile position mode; false: such a trajectory is refused",
    ),
    "allow_partial_joints_goal": Spec(
        False, "accept a trajectory for some of the joints; the others hold"
    ),
    "state_rate": Spec(50.0, "rate of /joint_states [Hz]", 0.1, 1000.0),
    "status_rate": Spec(10.0, "rate of ~/buffer_status [Hz]", 0.1, 1000.0),
    "realtime.priority": Spec(
        50,
        "SCHED_FIFO priority of the threads that feed the drives and receive, and memory is "
        "locked, where the system allows it; 0: neither",
        0,
        99,
    ),
    "log.file": Spec(
        "", "log of every frame and of what the driver does, for `replay`; ends in .asc; '': none"
    ),
    "log.size": Spec(
        100.0, "of the log's files together; the oldest are deleted [MB]", 1.0, 1_000_000.0
    ),
    "simulation.drift_ppm": Spec(
        0.0, "simulated drives: clocks are off by up to this much [ppm]", 0.0, 10_000.0
    ),
    "simulation.seed": Spec(0, "simulated drives: seed of everything random", 0, 2**31 - 1),
    "simulation.dictionary": Spec(
        "maker",
        "simulated EPOS2: object dictionary of the maker's EDS, or of the application note, which "
        "has 0x1006 (SYNC producer) and maps 0x1013 (clock master) and 0x60C4-02 for transmission",
        choices=("maker", "note"),
    ),
    "simulation.log": Spec("", "simulated drives: .npz file written when the bus closes; '': none"),
}

AXIS: dict[str, Spec] = {
    "drive": Spec("epos2", "family of the drive", choices=("epos2", "copley", "cl3e")),
    "node_id": Spec(1, "CANopen node id", 1, MAX_AXES),
    "type": Spec("revolute", "revolute [rad] or prismatic [m]", choices=("revolute", "prismatic")),
    "counts_per_turn": Spec(2000, "quadrature counts per motor turn [qc]", 4, 10_000_000),
    "gear_ratio": Spec(1.0, "motor turns per output turn", 1e-6, 1e6),
    "lead": Spec(0.0, "prismatic: metres per output turn; 0: not set", 0.0, 1e3),
    "direction": Spec(1, "1, or -1 when the joint turns against the motor", choices=(1, -1)),
    "offset": Spec(0.0, "joint position where the drive reads 0 [rad or m]", -1e6, 1e6),
    "velocity_notation": Spec(
        0,
        "drive velocity unit is 10^n rpm (object 0x608B); by maxon's EDS max_velocity is at most "
        "25,000 of these units",
        choices=(0, -1, -2, -3),
    ),
    "min_position": Spec(-inf, "lower soft limit [rad or m]; -inf: none"),
    "max_position": Spec(inf, "upper soft limit [rad or m]; inf: none"),
    "max_velocity": Spec(inf, "limit [rad/s or m/s]; inf: none", 1e-9),
    "max_acceleration": Spec(inf, "limit [rad/s² or m/s²]; inf: none", 1e-9),
    "max_jerk": Spec(
        inf, "limit of moves in profile position mode [rad/s³ or m/s³]; inf: none", 1e-9
    ),
    "stop_deceleration": Spec(
        0.0, "of halt and quick stop (0x6084, 0x6085) [unit/s²]; 0: the drive's own", 0.0, 1e9
    ),
    "max_following_error": Spec(2000, "[qc], object 0x6065", 1, 2**32 - 1),
    "trajectory": Spec(
        "",
        "how the axis follows a trajectory: by PVT records (EPOS2, Copley), by setpoints "
        "(CL3-E), or profile: it moves by ~/move_to only; '': the family's best",
        choices=("", "pvt", "setpoints", "profile"),
    ),
    "homing.method": Spec(
        "",
        "by name (current_threshold_negative, home_switch_positive_index, here, …), in the "
        "drive's own sense of direction; empty: not homed",
    ),
    "homing.speeds": Spec(
        [0.0, 0.0], "to the switch and to zero [unit/s]; 0, 0: the drive's own", 0.0, 1e6
    ),
    "homing.acceleration": Spec(0.0, "[unit/s²]; 0: the drive's own", 0.0, 1e9),
    "homing.offset": Spec(0.0, "where the axis is when homed [unit]", -1e6, 1e6),
    "homing.back_off": Spec(
        0.0, "how far it moves away from switch, stop or index first [unit]", 0.0, 1e6
    ),
    "homing.order": Spec(0, "axes of the lowest order home first, equal ones together", 0, 127),
    "homing.max_travel": Spec(
        inf, "beyond this travel the search is stopped [unit]; inf: no bound", 1e-9
    ),
    "homing.required": Spec(False, "no motion before the axis is homed"),
}

CONSTRAINTS: dict[str, Spec] = {
    "trajectory": Spec(
        0.0, "action: how far the joint may be from its path [rad or m]; 0: not checked", 0.0
    ),
    "goal": Spec(0.0, "action: how far it may be from its goal [rad or m]; 0: not checked", 0.0),
}

OUTPUT: dict[str, Spec] = {
    "joint": Spec("", "the joint whose position triggers the output"),
    "kind": Spec("", "window, crossing, series, interval or marker", choices=("", *KINDS)),
    "pin": Spec(1, "number of the output on the joint's drive", 1, 127),
    "method": Spec("", "hardware or software; '': hardware where it can", choices=("", *METHODS)),
    "window": Spec([inf, inf], "[lower, upper] [rad or m]; inf: not set"),
    "positions": Spec([], "of crossing and series [rad or m]", element=0.0),
    "start": Spec(inf, "of interval: a position with a pulse [rad or m]; inf: not set"),
    "interval": Spec(0.0, "from one pulse to the next [rad or m]; 0: not set", 0.0),
    "end": Spec(inf, "of interval: a pulse at most here [rad or m]; inf: none"),
    "direction": Spec("both", "up, down or both", choices=DIRECTIONS),
    "pulse": Spec(0.001, "pulse width [s]", 0.0, 5e6),
    "toggle": Spec(False, "toggle the output instead of giving a pulse"),
    "inverted": Spec(False, "the output is active low"),
    "reference": Spec("actual", "actual or commanded position", choices=REFERENCES),
    "capacity": Spec(0, "positions a series may grow to; 0: as many as it has", 0, 32767),
    "extrapolated": Spec(False, "the drive extrapolates this encoder: it is not quadrature"),
}


class DriverParameters:
    """The parameters of a driver with certain joints: their values, and what is wrong with them.

    `given` is what files and command line say, by dotted name. A wrong value or name keeps
    nothing from coming up: its line is kept in `complaints`, the default stands in, and `config`
    raises it until `set` has put the value right.
    """

    def __init__(self, given: Mapping[str, Any]) -> None:
        self.specs: dict[str, Spec] = {}
        self.values: dict[str, Any] = {}
        self.complaints: dict[str, str] = {}
        joints = [f"joint_{n}" for n in range(1, 7)]
        self._add("joints", Spec(joints, "in the order of /joint_states", read_only=True), given)
        for name, spec in GROUP.items():
            self._add(name, spec, given)
        in_process = self.values["can.interface"] == "virtual"
        self._add("simulate", Spec(in_process, "run a simulated drive for every joint"), given)
        for place, joint in enumerate(self.values["joints"], start=1):
            for name, spec in AXIS.items():
                own = replace(spec, default=place) if name == "node_id" else spec
                self._add(f"axes.{joint}.{name}", own, given)
            for name, spec in CONSTRAINTS.items():
                self._add(f"constraints.{joint}.{name}", spec, given)
        named = "names of the position-triggered outputs"
        self._add("outputs", Spec([], named, read_only=True, element=""), given)
        for output in self.values["outputs"]:
            for name, spec in OUTPUT.items():
                self._add(f"compare.{output}.{name}", spec, given)
        for name in given:
            if name not in self.specs and name not in ROS_OWN:
                self.complaints[name] = self._unknown(name, given[name])

    def set(self, name: str, value: Any) -> None:
        """Take a new value; ConfigurationError when it is not allowed."""
        spec = self.specs[name]
        try:
            self.values[name] = spec.read(value)
        except ValueError:
            raise ConfigurationError(spec.complaint(name, value)) from None
        self.complaints.pop(name, None)

    def config(self) -> DriverConfig:
        """The values as they stand; ConfigurationError for the first that is wrong."""
        for complaint in self.complaints.values():
            raise ConfigurationError(complaint)
        values = self.values
        axes = tuple(self._axis(joint) for joint in values["joints"])
        self._check_group(axes)
        return DriverConfig(
            axes=axes,
            interface=values["can.interface"],
            channel=values["can.channel"],
            bitrate=values["can.bitrate"],
            simulate=values["simulate"],
            sync_period=values["sync.period"],
            sync_source=values["sync.source"],
            sync_producer=values["sync.producer"],
            clock_limits=ClockLimits(
                offset_warning_us=values["sync.offset_warning"],
                offset_error_us=values["sync.offset_error"],
                drift_warning_ppm=values["sync.drift_warning"],
                drift_error_ppm=values["sync.drift_error"],
            ),
            buffer_time=values["ipm.buffer_time"],
            stream_ahead=values["ipm.stream_ahead"],
            tolerance=values["ipm.tolerance"],
            smoothness=values["ipm.smoothness"],
            least_velocity=values["ipm.least_velocity"],
            start_tolerance=values["constraints.start_tolerance"],
            approach=values["approach"],
            goal_time=values["constraints.goal_time"],
            allow_partial_joints_goal=values["allow_partial_joints_goal"],
            state_rate=values["state_rate"],
            realtime_priority=values["realtime.priority"],
            log_file=values["log.file"] or None,
            log_size=values["log.size"],
            outputs=tuple(map(self.output, values["outputs"])),
            simulation=SimulationConfig(
                drift_ppm=values["simulation.drift_ppm"],
                seed=values["simulation.seed"],
                dictionary=values["simulation.dictionary"],
                log=values["simulation.log"] or None,
            ),
        )

    def output(self, name: str) -> CompareConfig:
        """One position-triggered output; ConfigurationError when it can't be."""

        def value(parameter: str) -> Any:
            return self.values[f"compare.{name}.{parameter}"]

        def given(parameter: str) -> Any:
            """None where it has the value that stands for "not set"."""
            own = value(parameter)
            return None if own == OUTPUT[parameter].default else own

        return CompareConfig(
            name=name,
            joint=value("joint"),
            kind=value("kind"),
            pin=value("pin"),
            method=given("method"),
            window=tuple(given("window") or ()) or None,
            positions=tuple(given("positions") or ()),
            start=given("start"),
            interval=given("interval"),
            end=given("end"),
            direction=value("direction"),
            pulse=value("pulse"),
            toggle=value("toggle"),
            inverted=value("inverted"),
            reference=value("reference"),
            capacity=value("capacity"),
            extrapolated=value("extrapolated"),
        )

    def _add(self, name: str, spec: Spec, given: Mapping[str, Any]) -> None:
        self.specs[name], self.values[name] = spec, spec.default
        if name in given:
            try:
                self.set(name, given[name])
            except ConfigurationError as error:
                self.complaints[name] = str(error)

    def _unknown(self, name: str, value: Any) -> str:
        line = f"{name} is {_written(value)}, but there is no such parameter"
        joints = self.values["joints"]
        if name.startswith("axes.") and not any(name.startswith(f"axes.{j}.") for j in joints):
            return f"{line}; the joints are {', '.join(joints)}"
        close = get_close_matches(name, self.specs, n=1)
        return f"{line}; did you mean {close[0]}?" if close else line

    def _axis(self, joint: str) -> AxisConfig:
        at = f"axes.{joint}."

        def value(name: str) -> Any:
            return self.values[at + name]

        if value("type") == "prismatic" and not value("lead"):
            raise ConfigurationError(
                f"{at}lead is 0; a prismatic joint needs the metres per output turn, above 0"
            )
        if not value("min_position") < value("max_position"):
            raise ConfigurationError(
                f"{at}min_position is {value('min_position'):g}; "
                f"it must be below max_position, {value('max_position'):g}"
            )
        homing = None
        if value("homing.method") or value("homing.required"):
            speeds = tuple(value("homing.speeds"))
            homing = HomingConfig(
                method=value("homing.method"),
                speeds=speeds if any(speeds) else None,
                acceleration=value("homing.acceleration") or None,
                offset=value("homing.offset"),
                back_off=value("homing.back_off"),
                order=value("homing.order"),
                max_travel=_finite(value("homing.max_travel")),
                required=value("homing.required"),
            )
        return AxisConfig(
            joint=joint,
            node_id=value("node_id"),
            drive=value("drive"),
            type=value("type"),
            counts_per_turn=value("counts_per_turn"),
            gear_ratio=value("gear_ratio"),
            lead=value("lead") or None,
            direction=value("direction"),
            offset=value("offset"),
            velocity_notation=value("velocity_notation"),
            min_position=_finite(value("min_position")),
            max_position=_finite(value("max_position")),
            max_velocity=_finite(value("max_velocity")),
            max_acceleration=_finite(value("max_acceleration")),
            max_jerk=_finite(value("max_jerk")),
            stop_deceleration=value("stop_deceleration") or None,
            max_following_error=value("max_following_error"),
            trajectory=value("trajectory"),
            homing=homing,
            path_tolerance=self.values[f"constraints.{joint}.trajectory"],
            goal_tolerance=self.values[f"constraints.{joint}.goal"],
        )

    def _check_group(self, axes: tuple[AxisConfig, ...]) -> None:
        uses = Counter(axis.node_id for axis in axes)
        for axis in axes:
            if uses[axis.node_id] > 1:
                joints = ", ".join(a.joint for a in axes if a.node_id == axis.node_id)
                raise ConfigurationError(
                    f"axes.{axis.joint}.node_id is {axis.node_id}, which {joints} share; "
                    "each drive on the bus needs its own, from 1 to 127"
                )
        able = ["host", *(axis.joint for axis in axes if axis.drive == "epos2")]
        for name in ("sync.source", "sync.producer"):
            if self.values[name] not in able:
                raise ConfigurationError(
                    f"{name} is '{self.values[name]}'; it must be one of {', '.join(able)}"
                )


def _is_token(name: str) -> bool:
    """Whether it can be a part of a topic's name."""
    return name.isascii() and name.isidentifier() and "__" not in name


def _is_joint(name: str) -> bool:
    """Whether it can be a part of a parameter's name, on the command line, too."""
    return re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_./-]*", name) is not None


def _finite(value: float) -> float | None:
    return value if isfinite(value) else None


def _written(value: Any) -> str:
    """A value as it would stand in a parameter file."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (str, int, float)):
        return repr(value)
    return str(list(value or ()))  # rcl reads an empty list as "not set", None
