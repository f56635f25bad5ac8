"""What the driver knows, as ROS messages. Pure functions of a snapshot and a stamp.

Layouts: `sensor_msgs/JointState` as joint_state_broadcaster fills it, `diagnostic_msgs` as
diagnostic_updater does: `name` is "node: part", `hardware_id` is "channel/node id", both with the
node's namespace before them if it has one. What is not heard has no state: it is STALE, and not in
the joint states.

Flags, words and states are there as numbers, too, which is all that plotting tools draw: `level`
(0 ok, 1 warning, 2 error, 3 stale), and `NAME_number` or `NAME number` beside NAME. A flag is 1 or
0, a word or error code its value, a state its place in the order in which it is gone through
(`cia402.State`, `Phase`, `BusState`), from 0; -1: unknown.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from enum import Enum
from typing import TYPE_CHECKING

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from sensor_msgs.msg import JointState

from epos2_ros.bus.health import BusState
from epos2_ros.configuration.driver import ClockLimits
from epos2_ros.protocol import cia402
from epos2_ros.protocol.phase import Phase

if TYPE_CHECKING:
    from epos2_ros.bus.snapshot import AxisSnapshot, JointStates, OutputSnapshot, Snapshot
    from epos2_ros.protocol.outputs.outputs import OutputEvent

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
STALE = DiagnosticStatus.STALE


def joint_state(states: JointStates, stamp: Time) -> JointState:
    """Position [rad or m], velocity [per second] and motor current [A] of the joints."""
    message = JointState(name=states.joints, effort=states.effort)
    message.header.stamp = stamp
    message.position = [position + 0.0 for position in states.position]
    message.velocity = [velocity + 0.0 for velocity in states.velocity]  # never -0.0
    return message


def buffer_status(snapshot: Snapshot, channel: str, stamp: Time) -> DiagnosticArray:
    """The interpolation buffer of each drive; the flags are named after 0x20C4-01."""
    return _array(stamp, (_buffer_of(axis, channel) for axis in snapshot.axes if axis.size))


def output_event(event: OutputEvent, stamp: Time) -> JointState:
    """The joint, its position and velocity where an output has fired."""
    message = JointState(name=[event.joint], position=[event.position], velocity=[event.velocity])
    message.header.stamp = stamp
    return message


def diagnostics(
    snapshot: Snapshot, node: str, channel: str, stamp: Time, limits: ClockLimits
) -> DiagnosticArray:
    """The state of each drive, of each position-triggered output and of the bus."""
    axes = [_drive_of(axis, node, channel, limits) for axis in snapshot.axes]
    outputs = [_output_of(output, node, channel) for output in snapshot.outputs]
    return _array(stamp, [*axes, *outputs, _bus_of(snapshot, node, channel)])


def _buffer_of(axis: AxisSnapshot, channel: str) -> DiagnosticStatus:
    flags = axis.buffer_flags
    errors = [name for name, on in flags.items() if on and name.endswith("_error")]
    # An axis that stands has no records to run out of, and says so for ever.
    active = flags["ip_mode_active"]
    warnings = [name for name, on in flags.items() if active and on and name.endswith("_warning")]
    level, message = ERROR if errors else WARN if warnings else OK, (*errors, *warnings, "ok")[0]
    if axis.silent_s:
        level, message = STALE, _not_heard(axis)
    return DiagnosticStatus(
        level=level,
        name=axis.joint,
        message=message.replace("_", " "),
        hardware_id=f"{channel}/{axis.node_id}",
        values=_values(
            {
                **_level(level),
                "records_sent": str(axis.records_sent),
                "used": str(axis.used),
                "free": str(axis.free),
                "size": str(axis.size),
                "buffered_ms": f"{axis.buffered_ms:.0f}",
                "status_word": f"0x{axis.status_word:04X}",
                "status_word_number": str(axis.status_word),
                **{name: str(on).lower() for name, on in flags.items()},
                **{f"{name}_number": str(int(on)) for name, on in flags.items()},
            }
        ),
    )


def _drive_of(axis: AxisSnapshot, node: str, channel: str, limits: ClockLimits) -> DiagnosticStatus:
    if axis.silent_s:
        level, message = STALE, _not_heard(axis)
    elif axis.state in ("fault", "fault reaction active"):
        level, message = ERROR, axis.fault or axis.state
    else:
        level, message = OK if axis.state == "operation enabled" else WARN, axis.state
        clock_level, clock_message = _clock_of(axis, limits)
        if clock_level > level:
            level, message = clock_level, clock_message
    clock_and_error = {
        "following error [qc]": _given(axis.following_error_qc, "d"),
        "clock offset [us]": _given(axis.clock_offset_us, ".1f"),
        "clock drift [ppm]": _given(axis.clock_drift_ppm, ".2f"),
        "least buffer reserve [ms]": _given(axis.reserve_ms, ".0f"),
        "set-points": _given(axis.set_points, "d"),
        "path error of set-points [qc]": _given(axis.path_error_qc, ".1f"),
    }
    who = axis.identity
    identity = (
        {}
        if who is None
        else {
            "product": f"{who.maker} {who.product}",
            "firmware": who.firmware,
            "serial number": str(who.serial_number),
        }
    )
    return DiagnosticStatus(
        level=level,
        name=f"{node}: {axis.joint}",
        message=message,
        hardware_id=f"{channel}/{axis.node_id}",
        values=_values(
            {
                **_level(level),
                "state": "unknown" if axis.silent_s else axis.state,
                "state number": _place(cia402.State, "" if axis.silent_s else axis.state),
                "last emergency": axis.fault or "none",
                "last emergency number": str(axis.emergency),
                "referenced": axis.homed or "no",
                "referenced number": str(int(bool(axis.homed))),
                "not heard for [s]": f"{axis.silent_s:.1f}",
                **{name: text for name, text in clock_and_error.items() if text},
                **identity,
            }
        ),
    )


def _not_heard(axis: AxisSnapshot) -> str:
    return f"not heard any more; it was: {axis.state}"


def _clock_of(axis: AxisSnapshot, limits: ClockLimits) -> tuple[bytes, str]:
    offset_us, drift_ppm = abs(axis.clock_offset_us or 0.0), abs(axis.clock_drift_ppm or 0.0)
    text = f"clock {offset_us:.0f} us off, drifts {drift_ppm:.0f} ppm"
    if offset_us > limits.offset_error_us or drift_ppm > limits.drift_error_ppm:
        return ERROR, text
    if offset_us > limits.offset_warning_us or drift_ppm > limits.drift_warning_ppm:
        return WARN, text
    return OK, ""


def _output_of(output: OutputSnapshot, node: str, channel: str) -> DiagnosticStatus:
    tally = output.tally
    known = tally.predicted is not None
    unknown = "no predicted motion has ended yet" if tally.events else "no motion yet"
    level = WARN if tally.difference else OK
    return DiagnosticStatus(
        level=level,
        name=f"{node}: compare.{output.name}",
        message=tally.difference or ("as predicted" if known else unknown),
        hardware_id=f"{channel}/{output.node_id}",
        values=_values(
            {
                **_level(level),
                "joint": output.joint,
                "events": str(tally.events),
                "predicted in last motion": str(tally.predicted) if known else "",
                "reported in last motion": str(tally.reported) if known else "",
                "farthest from predicted time [us]": f"{tally.late_us:+.0f}" if known else "",
            }
        ),
    )


def _bus_of(snapshot: Snapshot, node: str, channel: str) -> DiagnosticStatus:
    level, message = OK, snapshot.state
    if snapshot.bus_state != "error active":
        level, message = WARN, f"the controller is {snapshot.bus_state}"
    elif snapshot.dropped_frames or snapshot.error_frames:
        level, message = WARN, "frames were lost or disturbed"
    elif any(snapshot.rejected.values()):
        level, message = WARN, "input was dropped that makes no sense here"
    if snapshot.state == "fault":
        level, message = ERROR, snapshot.reason
    late = snapshot.late
    return DiagnosticStatus(
        level=level,
        name=f"{node}: bus",
        message=message,
        hardware_id=channel,
        values=_values(
            {
                **_level(level),
                "group": snapshot.state,
                "group number": _place(Phase, snapshot.state),
                "drives": "simulated" if snapshot.simulated else "real",
                "load [%]": f"{100 * snapshot.bus_load:.1f}",
                "controller": snapshot.bus_state,
                "controller number": _place(BusState, snapshot.bus_state),
                "transmit errors": str(snapshot.transmit_errors),
                "receive errors": str(snapshot.receive_errors),
                "error frames": str(snapshot.error_frames),
                "dropped frames": str(snapshot.dropped_frames),
                "transmit queue full": str(snapshot.refused_frames),
                "SYNC count": str(snapshot.sync_count),
                "SYNC time from": snapshot.sync_time_source,
                "last start late by [us]": _given(snapshot.start_error_us, ".0f"),
                "internal errors": str(snapshot.internal_errors),
                "scheduling": snapshot.scheduling,
                "memory": "locked" if snapshot.memory_locked else "not locked",
                "thread late, median [us]": _given(late and late.median_us, ".0f"),
                "thread late, 99 % [us]": _given(late and late.most_us, ".0f"),
                "thread late, worst [us]": _given(late and late.worst_us, ".0f"),
                **{f"dropped: {kind}": str(n) for kind, n in snapshot.rejected.items()},
            }
        ),
    )


def _level(level: bytes) -> dict[str, str]:
    """The status' level among its values: a plotting tool reads nothing else of a status."""
    return {"level": str(level[0])}


def _place(states: type[Enum], value: str) -> str:
    values = [state.value for state in states]
    return str(values.index(value) if value in values else -1)


def _given(value: float | None, format_spec: str) -> str:
    return "" if value is None else format(value, format_spec)


def _values(pairs: Mapping[str, str]) -> list[KeyValue]:
    return [KeyValue(key=key, value=value) for key, value in pairs.items()]


def _array(stamp: Time, statuses: Iterable[DiagnosticStatus]) -> DiagnosticArray:
    message = DiagnosticArray(status=list(statuses))
    message.header.stamp = stamp
    return message
