"""What a survey found, for a person to read."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from epos2_ros.commission.found import Found
from epos2_ros.commission.makers import is_drive, last_error, maker_of, state_in_words
from epos2_ros.commission.oddities import Wiring, oddities
from epos2_ros.commission.survey import Survey
from epos2_ros.protocol import epos2

HEADINGS = ("node", "drive", "firmware", "serial", "state", "NMT", "position", "units", "driver")
RIGHT = (0, 3, 6)  # columns of numbers
# As in heartbeats (CiA 301, 7.2.8.3.2.2); from the boot-up on a device is pre-operational.
NMT_STATES = {0: "pre-operational", 4: "stopped", 5: "operational", 127: "pre-operational"}


def text(survey: Survey, wiring: Wiring, bus_name: str) -> str:
    """The whole report."""
    devices = list(survey.present())
    lines = [f"{bus_name}: {_heard(survey)}", ""]
    if devices:
        lines += [*_table([HEADINGS, *(_row(found, survey) for found in devices)]), ""]
    notes = [note for found in devices for note in _notes(found)]
    if notes:
        lines += [*notes, ""]
    odd = oddities(survey, wiring)
    lines += ["odd:", *(f"  {line}" for line in odd)] if odd else ["nothing odd"]
    return "\n".join(lines)


def _heard(survey: Survey) -> str:
    heard, devices = survey.heard, sum(1 for _ in survey.present())
    beats = sum(len(times) for times in heard.heartbeats.values()) - heard.boot_ups.total()
    counts = [
        f"{count} {name}"
        for count, name in (
            (beats, "heartbeats"),
            (heard.boot_ups.total(), "boot-ups"),
            (sum(map(len, heard.emergencies.values())), "emergencies"),
            (heard.pdos, "PDOs"),
            (heard.sync, "SYNC"),
        )
        if count
    ]
    seconds = (survey.ended_us - survey.began_us) / 1e6
    found = f"{devices} node{'' if devices == 1 else 's'} found"
    return f"{found} in {seconds:.1f} s; heard {', '.join(counts) or 'nothing unasked'}"


def _row(found: Found, survey: Survey) -> tuple[str, ...]:
    maker, identity = maker_of(found), found.identity
    position = found.integer(epos2.POSITION_ACTUAL, signed=True)
    return (
        str(found.node_id),
        f"{identity.maker} {identity.product}",
        maker.firmware(found),
        str(identity.serial_number),
        state_in_words(found),
        _nmt_state(found, survey),
        "" if position is None else f"{position} {maker.counts}",
        maker.units(found) if is_drive(found) else "",
        "no" if maker.lacks(found) else "yes",
    )


def _nmt_state(found: Found, survey: Survey) -> str:
    """By the statusword of a drive that has it there, or the last heartbeat."""
    word = found.integer(epos2.STATUSWORD)
    operational = None if word is None else maker_of(found).operational(word)
    if operational is not None:
        return "operational" if operational else "pre-operational"
    beats = survey.heard.heartbeats.get(found.node_id)
    return NMT_STATES.get(beats[-1][1], "") if beats else ""


def _notes(found: Found) -> Iterator[str]:
    if error := last_error(found):
        yield f"node {found.node_id}: last error: {error}"
    for lack in maker_of(found).lacks(found):
        yield f"node {found.node_id}: the driver can't move it: {lack}"


def _table(rows: Sequence[Sequence[str]]) -> Iterator[str]:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        cells = (
            cell.rjust(width) if place in RIGHT else cell.ljust(width)
            for place, (cell, width) in enumerate(zip(row, widths, strict=True))
        )
        yield "  ".join(cells).rstrip()
