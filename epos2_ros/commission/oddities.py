"""What is odd about a bus, one line each: what was seen, and what to do about it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from epos2_ros.bus.health import BusState, Health
from epos2_ros.bus.identity import IDENTITY
from epos2_ros.commission.found import Found
from epos2_ros.commission.makers import HEARTBEAT_TIME, is_drive, maker_of
from epos2_ros.commission.survey import Survey
from epos2_ros.protocol import epos2
from epos2_ros.protocol.timekeeper import HOST_NODE_ID

STOPPED = 4  # NMT state
SERIAL = (IDENTITY, 4)
NO_ACKNOWLEDGE, PROTOCOL = 0x020, 0x088  # classes of error frames (linux/can/error.h)
TOO_OFTEN = 1.5  # heartbeats against what is set
FEW = 4  # heartbeats that tell nothing yet

TERMINATION = (
    "CAN high and low have to be terminated with 120 ohm at both ends, and only there (60 ohm "
    "between them with the power off)"
)


@dataclass
class Wiring:
    """What the adapter says of the bus."""

    health: Health
    error_classes: int = 0  # of all error frames
    takes_frames: bool = True  # what is sent gets onto the bus, as far as can be seen


def oddities(survey: Survey, wiring: Wiring) -> list[str]:
    """The most serious first."""
    return [
        *_of_the_bus(survey, wiring),
        *_doubled_ids(survey, wiring),
        *_of_nodes(survey),
        *_of_other_hosts(survey),
    ]


def doubled(survey: Survey, node_id: int) -> bool:
    """Whether more than one device seems to answer to this id."""
    return bool(survey.strays.get(node_id)) and not survey.heard.requests[node_id]


def _of_the_bus(survey: Survey, wiring: Wiring) -> Iterator[str]:
    health, heard = wiring.health, survey.heard
    quiet = not heard.frames
    if health.state is BusState.OFF:
        yield (
            "the adapter is bus off: a short circuit between CAN high and low, or a wrong bit rate"
        )
    elif health.state in (BusState.PASSIVE, BusState.WARNING):
        yield f"the adapter is {health.state.value}: frames are disturbed or nobody acknowledges"
    if not wiring.takes_frames or (quiet and wiring.error_classes & NO_ACKNOWLEDGE):
        yield (
            "nobody acknowledges what is sent: no drive is powered or connected, or all have "
            "another bit rate"
        )
    elif quiet:
        yield "nothing was heard and nobody answered: power, wiring, bit rate?"
    if quiet:
        yield (
            "an EPOS2 fresh from the factory finds the bit rate by itself, but needs frames for "
            "that: scan once more"
        )
    elif wiring.error_classes & PROTOCOL:
        yield (
            f"{health.error_frames} error frames, so bits are disturbed: {TERMINATION}; or two "
            "devices have one node id, or a device has another bit rate"
        )


def _doubled_ids(survey: Survey, wiring: Wiring) -> Iterator[str]:
    for found in survey.present():
        node_id = found.node_id
        if doubled(survey, node_id):
            serials = " and ".join(map(str, _serial_numbers(found, survey)))
            which = f" (serial numbers {serials})" if " and " in serials else ""
            yield (
                f"node {node_id}: two devices answer to this id{which}: give one of them another "
                "and switch it off and on"
            )
        elif found.answers.get(SERIAL) is None and wiring.error_classes & PROTOCOL:
            yield (
                f"node {node_id} tells no serial number and frames are disturbed: probably two "
                "devices have this id"
            )


def _serial_numbers(found: Found, survey: Survey) -> list[int]:
    """All that were told under this node id."""
    multiplexer = SERIAL[0].to_bytes(2, "little") + bytes([SERIAL[1]])
    others = {
        int.from_bytes(stray.data[4:], "little")
        for stray in survey.strays[found.node_id]
        if stray.data[1:4] == multiplexer and stray.data[0] >> 5 == 2
    }
    own = found.integer(*SERIAL)
    return sorted(others if own is None else others | {own})


def _of_nodes(survey: Survey) -> Iterator[str]:
    heard = survey.heard
    for node_id, found in survey.nodes.items():
        beats = heard.heartbeats.get(node_id, [])
        if beats and not found.answered and not _is_host(survey, found):
            stopped = beats[-1][1] == STOPPED
            why = "it is stopped (NMT), where drives have no SDO" if stopped else "is it a drive?"
            yield f"node {node_id} is heard, but does not answer: {why}"
        if heard.boot_ups[node_id] > maker_of(found).boot_ups and not doubled(survey, node_id):
            yield (
                f"node {node_id} started {heard.boot_ups[node_id]} times: its supply breaks down, "
                "or two devices have this id"
            )
        elif _beats_twice(survey, found) and not doubled(survey, node_id):
            yield (
                f"node {node_id}: heartbeats come more often than it is set to (0x1017): probably "
                "two devices have this id"
            )
        if code := next((code for code in heard.emergencies.get(node_id, []) if code), 0):
            words = maker_of(found).emergency if found.answered else epos2.FAMILY.describe_emergency
            yield f"node {node_id} reported: {words(code)}"
        if found.answered and not is_drive(found):
            yield f"node {node_id} is no drive of CiA 402"
        elif found.answered and node_id == HOST_NODE_ID:
            yield (
                f"node {node_id}: the driver's own heartbeat has this id: give the drive one from "
                f"1 to {HOST_NODE_ID - 1}"
            )


def _beats_twice(survey: Survey, found: Found) -> bool:
    period_ms = found.integer(HEARTBEAT_TIME)
    times = [t_us for t_us, state in survey.heard.heartbeats.get(found.node_id, []) if state]
    if not period_ms or len(times) < FEW:
        return False
    return (len(times) - 1) * period_ms * 1e3 > TOO_OFTEN * (times[-1] - times[0])


def _is_host(survey: Survey, found: Found) -> bool:
    """Whether it is a driver like ours: a heartbeat, and no SDO."""
    node_id = found.node_id
    return node_id == HOST_NODE_ID and not found.answered and node_id in survey.heard.heartbeats


def _of_other_hosts(survey: Survey) -> Iterator[str]:
    heard = survey.heard
    signs = [
        f"{count} {name}"
        for count, name in (
            (heard.nmt, "NMT commands"),
            (heard.sync, "SYNC"),
            (sum(heard.requests.values()), "SDO requests"),
        )
        if count
    ]
    if _is_host(survey, survey.nodes[HOST_NODE_ID]):
        signs.append("a host's heartbeat")
    if signs:
        yield (
            f"another host is at work on this bus ({', '.join(signs)}): answers to it may have "
            "been taken for answers to us"
        )
