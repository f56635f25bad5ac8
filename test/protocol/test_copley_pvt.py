"""What goes into a Copley drive's PVT buffer, byte by byte, and the books of it.

Bytes and bits are typed from what the maker's EDS and motion library say of 0x2010 and 0x2012.
"""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from epos2_ros.motion.record import Record
from epos2_ros.protocol import copley_pvt, epos2
from epos2_ros.protocol.pvt.numbered import NumberedSegments

INT24 = 2**23 - 1
SEQUENCE, OVERFLOW, UNDERFLOW = 1 << 24, 1 << 25, 1 << 26
EMPTY = 1 << 31


def signed(data: bytes) -> int:
    return int.from_bytes(data, "little", signed=True)


@given(
    st.integers(0, 2**16 - 1),
    st.integers(-(2**31), 2**31 - 1),
    st.integers(-INT24, INT24),
    st.integers(-INT24, INT24),
    st.integers(0, 255),
    st.booleans(),
)
def test_a_segment(
    number: int, position: int, way: int, velocity: int, time_ms: int, coarse: bool
) -> None:
    """Counter, format, time, position and velocity; beyond 24 bits the way from the one before."""
    data = copley_pvt.segment(number, position - way, position, velocity, time_ms, coarse)
    assert len(data) == 8
    assert (data[0] & 7, data[0] & 0x80, data[1]) == (number & 7, 0, time_ms)
    kind = data[0] >> 3
    assert kind & 1 == coarse
    assert signed(data[2:5]) == (way if kind & 2 else position)
    assert bool(kind & 2) == (abs(position) > INT24)
    assert signed(data[5:8]) == velocity


@pytest.mark.parametrize("fastest, unit", [(838_860.7, 0.1), (838_861.0, 10.0), (30e6, 10.0)])
def test_the_finest_unit_in_which_velocities_have_24_bits(fastest: float, unit: float) -> None:
    assert copley_pvt.velocity_unit(fastest) == unit
    assert fastest / unit <= INT24


def test_what_helps_a_buffer_that_is_not_as_it_has_to_be() -> None:
    assert copley_pvt.remedy(EMPTY | 32 << 16 | 77) == b""
    assert copley_pvt.remedy(31 << 16 | SEQUENCE)[:1] == b"\x80"  # flush
    assert copley_pvt.remedy(EMPTY | SEQUENCE | UNDERFLOW)[:2] == b"\x82\x05"  # clear these


def test_its_status_in_the_words_of_an_epos2() -> None:
    assert copley_pvt.flags(0, 0).keys() == epos2.BufferStatus.FLAGS.keys()
    told = copley_pvt.flags(UNDERFLOW | OVERFLOW, 0x1027)
    assert [name for name, on in told.items() if on] == [
        "underflow_error", "overflow_error", "buffer_enabled", "ip_mode_active",
    ]  # fmt: skip
    assert copley_pvt.describe_errors(SEQUENCE) == ""
    assert copley_pvt.describe_errors(UNDERFLOW) == "its PVT buffer has run empty"


# --- the books --------------------------------------------------------------------------------


def books(first_id: int = 0, records: int = 3) -> tuple[NumberedSegments, list[bytes]]:
    """So many records sent and seen on the bus at 1 ms, before the start."""
    made = NumberedSegments(0.1, EMPTY | 20 << 16 | first_id)
    sent: list[bytes] = []
    for n in range(records):
        sent += made.send(Record(100 * n, n, 50 if n else 1), 0.0)
    for pdo in sent:
        made.seen_on_bus(pdo, 1000.0)
    return made, sent


def told(made: NumberedSegments, status: int, t_us: float) -> str:
    return made.report(status, t_us, None, None)


def test_the_free_places_of_an_empty_buffer_are_its_size() -> None:
    assert books()[0].size == 20


def test_ids_go_on_from_what_the_drive_had_and_wrap() -> None:
    made, sent = books(first_id=65_534)
    assert [data[0] & 7 for data in sent] == [6, 7, 0, 1]
    assert [data[0] >> 3 for data in sent] == [4, 0, 0, 0]
    assert told(made, 65_535, 2000.0) == "" and not made.reported
    assert told(made, 2, 3000.0) == "" and made.reported
    assert made.repeats() == []


def test_no_more_are_sent_untold_than_the_counter_tells_apart() -> None:
    made, _ = books(records=6)  # and the position before them
    assert made.blocked
    told(made, 4, 2000.0)
    assert not made.blocked


def test_the_last_are_missed_when_they_have_had_their_time() -> None:
    made, sent = books()
    told(made, 2, 20_000.0)
    assert made.repeats() == []  # they may be on their way
    told(made, 2, 30_000.0)
    assert made.repeats() == sent[2:]
    told(made, 2, 40_000.0)
    assert made.repeats() == []  # they are, again


def test_a_sequence_error_is_cleared_and_its_effect_asked_for_before_anything_is_sent() -> None:
    made, sent = books()
    told(made, 1 | SEQUENCE, 5_000.0)
    (command,) = made.repeats()
    assert command[:2] == b"\x82\x01"
    made.seen_on_bus(command, 6_000.0)
    assert made.blocked and 56_000.0 <= made.ask_us <= 60_000.0
    told(made, 1, 30_000.0)
    assert made.repeats() == []  # the buffer is not ready
    told(made, 1 | SEQUENCE, 60_000.0)
    assert made.repeats() == [command]  # the command was lost
    made.seen_on_bus(command, 61_000.0)
    told(made, 1, 120_000.0)
    assert made.repeats() == sent[1:]
    assert not made.blocked


def test_late_reports_change_nothing_and_impossible_ones_are_told() -> None:
    made, _ = books()
    told(made, 4, 9_000.0)
    assert told(made, 2 | SEQUENCE, 10_000.0) == ""
    assert told(made, 4 | SEQUENCE, 8_000.0) == ""
    assert made.repeats() == []
    assert "it wants segment 5 next where 4 is next" in told(made, 5, 11_000.0)
