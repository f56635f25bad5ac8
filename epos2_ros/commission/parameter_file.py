"""A parameter file of the driver with one joint per drive found, to be edited."""

from __future__ import annotations

from collections.abc import Iterator

from epos2_ros.commission.found import Found
from epos2_ros.commission.makers import maker_of
from epos2_ros.commission.oddities import doubled
from epos2_ros.commission.place import Place
from epos2_ros.commission.survey import Survey
from epos2_ros.configuration.parameters import AXIS
from epos2_ros.errors import DriveError
from epos2_ros.protocol import epos2
from epos2_ros.protocol.timekeeper import HOST_NODE_ID

ANY_POSITION = (-(2**31), 2**31 - 1)  # 0x607D without limits
COMMENT_COLUMN = 32

HEAD = """\
# Drives found on {place.channel}. Go through every value marked with <- before anything moves.
# Units are those of the joint: rad for a revolute one, m for a prismatic one.
#   ros2 run epos2_ros check --params THIS_FILE --joint JOINT     # the first motion, step by step
#   ros2 run epos2_ros driver --ros-args --params-file THIS_FILE
/**:                            # any node name and namespace
  ros__parameters:
    autostart: false            # wait for `ros2 lifecycle set /epos2_driver configure`, `activate`
    can:
      interface: {place.interface}
      channel: {place.channel!r}
      bitrate: {place.bitrate}
    simulate: {simulate}
    joints: [{joints}]  # <- the order of /joint_states; names as below
    axes:"""


def parameter_file(survey: Survey, place: Place) -> str:
    """All drives that the driver can move, the others as comments. DriveError when there is none.

    Where the drives are simulated by the programs themselves, the file says so, too.
    """
    usable = [found for found in survey.present() if _usable(found)]
    if not usable:
        raise DriveError("no drive was found that the driver could move: no parameter file")
    joints = ", ".join(map(_joint, usable))
    head = HEAD.format(place=place, simulate=str(place.simulated).lower(), joints=joints)
    entries = (line for found in usable for line in _entry(found, survey))
    return "\n".join([head, *entries, *_left_out(survey)])


def _joint(found: Found) -> str:
    return f"joint_{found.node_id}"


def _usable(found: Found) -> bool:
    return found.node_id != HOST_NODE_ID and not maker_of(found).lacks(found)


def _about(found: Found) -> str:
    identity = found.identity
    return (
        f"{identity.maker} {identity.product}, firmware {maker_of(found).firmware(found)}, "
        f"serial number {identity.serial_number}"
    )


def _entry(found: Found, survey: Survey) -> Iterator[str]:
    maker = maker_of(found)
    if doubled(survey, found.node_id):
        yield f"      # TWO DRIVES HAVE NODE ID {found.node_id}; one of them says it is"
    yield f"      {_joint(found)}:  # {_about(found)}"
    counts = maker.counts_per_turn(found)
    encoder = "quadrature counts per motor turn"
    yield from map(
        _line,
        (
            ("drive", maker.drive, ""),
            ("node_id", found.node_id, ""),
            ("type", "revolute", "<- or prismatic, then with lead: metres per output turn"),
            (
                "counts_per_turn",
                counts or AXIS["counts_per_turn"].default,
                f"{encoder}, as the drive is set to" if counts else f"<- {encoder}",
            ),
            ("gear_ratio", 1.0, "<- motor turns per output turn"),
            ("direction", 1, "<- -1 when the joint turns against the motor"),
            ("offset", 0.0, "<- joint position where the drive reads 0"),
            ("velocity_notation", maker.velocity_notation(found), "velocity unit is 10^n rpm"),
            ("# min_position", -0.5, f"<- soft limits: begin narrow{_drive_limits(found)}"),
            ("# max_position", 0.5, ""),
            ("max_velocity", 0.2, "<- [unit/s]: begin slow"),
            ("max_acceleration", 0.5, "<- [unit/s²]"),
            (
                "max_following_error",
                found.integer(epos2.MAX_FOLLOWING_ERROR) or AXIS["max_following_error"].default,
                "[counts]: further behind, the drive gives up with a fault",
            ),
        ),
    )


def _line(entry: tuple[str, object, str]) -> str:
    name, value, comment = entry
    text = f"        {name}: {value}"
    return f"{text.ljust(COMMENT_COLUMN)}  # {comment}" if comment else text


def _drive_limits(found: Found) -> str:
    low, high = (found.integer(epos2.SOFTWARE_POSITION_LIMIT, n, signed=True) for n in (1, 2))
    if (low, high) in ((None, None), ANY_POSITION):
        return ""
    return f"; the drive's are {low} and {high} {maker_of(found).counts}"


def _left_out(survey: Survey) -> Iterator[str]:
    for found in survey.present():
        if not _usable(found):
            reason = "; ".join(maker_of(found).lacks(found)) or "the driver has this node id itself"
            yield f"      # node {found.node_id}, {_about(found)}: left out: {reason}"
