"""Whatever is on the bus: the simulated drive keeps its rules and never stops responding."""

from __future__ import annotations

import struct

from hypothesis import given, settings
from hypothesis import strategies as st
from sim_host import Host, prompt_drive, pvt

STATES = {0x40, 0x21, 0x23, 0x27, 0x07, 0x0F, 0x08}  # of the status word, mask 0x6F
OBJECTS = [
    (0x1005, 0, 4), (0x1006, 0, 4), (0x1013, 0, 4), (0x1016, 1, 4), (0x1017, 0, 2),
    (0x1400, 1, 4), (0x1400, 2, 1), (0x1600, 0, 1), (0x1600, 1, 4), (0x1800, 1, 4),
    (0x1800, 2, 1), (0x1800, 3, 2), (0x1A00, 0, 1), (0x1A00, 1, 4), (0x20C4, 2, 2),
    (0x6040, 0, 2), (0x6060, 0, 1), (0x6065, 0, 4), (0x6067, 0, 4), (0x6068, 0, 2),
    (0x607A, 0, 4), (0x607C, 0, 4), (0x607D, 1, 4), (0x607D, 2, 4), (0x607F, 0, 4),
    (0x6081, 0, 4), (0x6083, 0, 4), (0x6084, 0, 4), (0x6085, 0, 4), (0x608B, 0, 1),
    (0x6098, 0, 1), (0x6099, 1, 4), (0x609A, 0, 4), (0x60C4, 6, 1), (0x60C5, 0, 4),
]  # fmt: skip
WORDS = [0x00, 0x02, 0x06, 0x07, 0x0F, 0x1F, 0x3F, 0x5F, 0x80, 0x10F, 0x11F]
VALUES = st.one_of(
    st.sampled_from([0, 1, 6, 7, 17, 35, 64, 255, 0x201, 0x181, 0x80000201, 0x40000080]),
    st.sampled_from([0x20C10040, 0x60400010, 0x60410010, 0x60640020, 0x10130020]),
    st.integers(0, 2**32 - 1),
)

Frame = tuple[int, bytes]


def download(target: tuple[int, int, int], value: int) -> Frame:
    index, subindex, size = target
    data = (value % 2 ** (8 * size)).to_bytes(4, "little")
    return 0x601, bytes([0x23 | (4 - size) << 2]) + struct.pack("<HB", index, subindex) + data


frames = st.one_of(
    st.builds(download, st.sampled_from(OBJECTS), VALUES),
    st.builds(download, st.just((0x6040, 0, 2)), st.sampled_from(WORDS)),
    st.tuples(
        st.sampled_from([0x201, 0x301]),
        st.builds(
            pvt, st.integers(-(2**31), 2**31 - 1), st.integers(-(2**23), 2**23 - 1),
            st.integers(0, 255),
        ),
    ),
    st.tuples(st.just(0x201), st.builds(pvt, st.just(0), st.just(0), st.integers(0, 255))),
    st.sampled_from([(0x080, b""), (0x100, bytes(6)), (0x000, b"\x01\x00"), (0x77F, b"\x05")]),
    st.tuples(st.just(0x000), st.binary(max_size=2)),
    st.tuples(st.just(0x601), st.binary(max_size=8)),
    st.tuples(st.integers(0, 0x7FF), st.binary(max_size=8)),
)  # fmt: skip


@settings(max_examples=60, deadline=None)
@given(
    st.booleans(),
    st.lists(st.tuples(frames, st.sampled_from([0.0, 0.2, 3.0, 40.0])), max_size=40),
)
def test_any_traffic(prepared: bool, traffic: list[tuple[Frame, float]]) -> None:
    drive = prompt_drive(1, record=True)
    host = Host(drive)
    if prepared:
        host.prepare_ip()
    for (can_id, data), ms in traffic:
        host.send(can_id, data, ms=ms)
        assert drive.status_word & 0x6F in STATES
        assert 0 <= drive.buffer_level <= 64
        assert drive.next_event_us > drive.now_us - 1e-3
        assert drive.ip_active <= (drive.status_word & 0x6F == 0x27)
    assert all(len(frame.data) <= 8 for frame in host.frames)
    host.nmt(0x81, 1)  # and after a reset it is as good as new
    host.run(2)
    host.prepare_ip()
    assert host.status() & 0x6F == 0x27
