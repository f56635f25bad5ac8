"""What there is to draw of a driver: tabs of plots, plots of curves, curves of its topics."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from epos2_ros.configuration.driver import AxisConfig, DriverConfig
from epos2_ros.configuration.names import Names
from epos2_ros.protocol.families import FAMILIES, follows_records


@dataclass(frozen=True)
class JointField:
    """`position`, `velocity` or `effort` in a `sensor_msgs/JointState`; `place`: of the joint."""

    topic: str
    joint: str
    place: int
    field: str

    @property
    def label(self) -> str:
        return self.joint


@dataclass(frozen=True)
class StatusValue:
    """A value in a `diagnostic_msgs/DiagnosticArray`."""

    topic: str
    hardware_id: str
    status: str
    key: str
    label: str


Curve = JointField | StatusValue


@dataclass(frozen=True)
class Plot:
    title: str
    curves: tuple[Curve, ...]
    events: bool = False  # each value is one of its own: dots


@dataclass(frozen=True)
class Tab:
    title: str
    plots: tuple[Plot, ...]


def tabs_of(config: DriverConfig, names: Names) -> tuple[Tab, ...]:
    """Positions, errors, buffers, clocks, the bus and, where there are some, outputs."""
    axes, bus = config.axes, names.bus(config.channel)
    states, buffers = names.topic("joint_states"), names.topic("~/buffer_status")
    buffered = [axis for axis in axes if follows_records(axis)]
    followed = [axis for axis in axes if _tells_following_error(axis)]
    timed = [axis for axis in axes if FAMILIES[axis.drive].has_clock]
    node_ids = {axis.joint: axis.node_id for axis in axes}

    def moved(field: str) -> tuple[Curve, ...]:
        return tuple(JointField(states, axis.joint, i, field) for i, axis in enumerate(axes))

    def told(of: Iterable[AxisConfig], key: str) -> tuple[Curve, ...]:
        return tuple(_told(axis.joint, axis.joint, axis.node_id, key) for axis in of)

    def _told(part: str, label: str, node_id: int, key: str) -> StatusValue:
        hardware_id = f"{bus}/{node_id}"
        return StatusValue("/diagnostics", hardware_id, names.status(part), key, label)

    def held(key: str) -> tuple[Curve, ...]:
        return tuple(
            StatusValue(buffers, f"{bus}/{axis.node_id}", axis.joint, key, axis.joint)
            for axis in buffered
        )

    load = StatusValue("/diagnostics", bus, names.status("bus"), "load [%]", "bus load [%]")
    outputs = config.outputs
    tabs = [
        Tab("motion", (Plot("position", moved("position")), Plot("velocity", moved("velocity")))),
        Tab(
            "drives",
            (
                Plot("following error [qc]", told(followed, "following error [qc]")),
                Plot("state (4: operation enabled, 7: fault)", told(axes, "state number")),
            ),
        ),
        Tab(
            "buffers",
            (
                Plot("motion in the buffer [ms]", held("buffered_ms")),
                Plot("records in the buffer", held("used")),
                Plot("underflow warning", held("underflow_warning_number")),
            ),
        ),
        Tab(
            "clocks and bus",
            (
                Plot("clock offset [us]", told(timed, "clock offset [us]")),
                Plot("clock drift [ppm]", told(timed, "clock drift [ppm]")),
                Plot("bus load [%]", (load,)),
            ),
        ),
        Tab(
            "outputs",
            (
                Plot(
                    "where outputs fired",
                    tuple(
                        JointField(names.topic(f"~/compare/{o.name}"), o.joint, 0, "position")
                        for o in outputs
                    ),
                    events=True,
                ),
                Plot(
                    "how often outputs fired",
                    tuple(
                        _told(f"compare.{o.name}", o.name, node_ids[o.joint], "events")
                        for o in outputs
                    ),
                ),
            ),
        ),
    ]
    drawn = (Tab(tab.title, tuple(plot for plot in tab.plots if plot.curves)) for tab in tabs)
    return tuple(tab for tab in drawn if tab.plots)


def _tells_following_error(axis: AxisConfig) -> bool:
    fields = FAMILIES[axis.drive].fields.values()
    return any(field.name == "following_error_qc" for field in fields)
