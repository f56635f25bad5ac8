"""SDO server and object dictionary of the simulated drive: CiA 301, 7.2.4, byte by byte."""

from __future__ import annotations

import pytest
from sim_host import Abort, Host, prompt_drive

ABORT_TOGGLE = 0x05030000
ABORT_COMMAND = 0x05040001


@pytest.fixture
def host() -> Host:
    return Host(prompt_drive(1))


def test_expedited_upload_of_each_size(host: Host) -> None:
    assert host.ask("40 17 10 00 00 00 00 00").hex() == "4b17100000000000"  # 2 bytes: 0x4B
    assert host.ask("40 00 10 00 00 00 00 00").hex() == "4300100092010200"  # 4 bytes: 0x43
    assert host.ask("40 01 10 00 00 00 00 00").hex() == "4f01100000000000"  # 1 byte: 0x4F


def test_expedited_download_and_upload_again(host: Host) -> None:
    assert host.ask("2B 17 10 00 88 13 00 00").hex() == "6017100000000000"
    assert host.ask("40 17 10 00 00 00 00 00").hex() == "4b17100088130000"


def test_expedited_download_without_size(host: Host) -> None:
    """Bit s = 0: as many bytes as the object has."""
    assert host.ask("22 17 10 00 E8 03 FF FF").hex() == "6017100000000000"
    assert host.read(0x1017) == 1000


def test_segmented_upload(host: Host) -> None:
    """0x1008 is "EPOS2": five bytes don't fit into an expedited transfer."""
    assert host.ask("40 08 10 00 00 00 00 00").hex() == "4108100005000000"
    # toggle 0, 2 bytes without data, last segment: 0x05
    assert host.ask("60 00 00 00 00 00 00 00") == b"\x05EPOS2\0\0"


def test_segmented_download_of_a_record(host: Host) -> None:
    """0x20C1 has 64 bits: seven of the bytes in one segment, one in the next."""
    host.prepare_ip()
    assert host.ask("21 C1 20 00 08 00 00 00").hex() == "60c1200000000000"
    assert host.ask("00 10 27 00 00 00 00 00").hex() == "2000000000000000"
    assert host.ask("1D 64 00 00 00 00 00 00").hex() == "3000000000000000"
    assert host.read(0x60C4, 2) == 63


def test_toggle_error_ends_the_transfer(host: Host) -> None:
    host.ask("40 08 10 00 00 00 00 00")
    assert host.ask("70 00 00 00 00 00 00 00").hex() == "8008100000000305"
    assert host.ask("60 00 00 00 00 00 00 00")[4:].hex() == "01000405"


def test_toggle_error_in_a_download(host: Host) -> None:
    host.prepare_ip()
    host.ask("21 C1 20 00 08 00 00 00")
    assert host.ask("10 00 00 00 00 00 00 00").hex() == "80c1200000000305"


@pytest.mark.parametrize(
    "request_bytes",
    [
        "A0 08 10 00 00 00 00 00",  # block upload is not offered
        "C2 00 10 00 08 00 00 00",  # nor block download
        "E0 00 00 00 00 00 00 00",
        "00 00 00 00 00 00 00 00",  # a segment of no transfer
        "60 00 00 00 00 00 00 00",
    ],
)
def test_unknown_command(host: Host, request_bytes: str) -> None:
    answer = host.ask(request_bytes)
    assert answer[0] == 0x80
    assert answer[4:].hex() == "01000405"


def test_abort_from_the_client_is_not_answered(host: Host) -> None:
    host.ask("40 08 10 00 00 00 00 00")
    host.send(0x601, "80 08 10 00 00 00 04 05")
    assert len(host.heard(0x581)) == 1
    assert host.ask("60 00 00 00 00 00 00 00")[0] == 0x80  # the transfer is over


def test_short_frame_is_no_sdo(host: Host) -> None:
    host.send(0x601, "40 00 10")
    assert host.heard(0x581) == []


@pytest.mark.parametrize(
    ("index", "subindex", "data", "code"),
    [
        (0x6041, 0, "00 00", 0x06010002),  # read only
        (0x1018, 1, "00 00 00 00", 0x06010002),  # constant
        (0x60C4, 2, "00 00 00 00", 0x06010002),
        (0x5FFF, 0, "00", 0x06020000),  # no such object
        (0x60C1, 0, "00 00", 0x06020000),  # CiA 402 has it, the EPOS2 has not
        (0x60C4, 7, "00", 0x06090011),  # no such sub-index
        (0x1018, 5, "00 00 00 00", 0x06090011),
        (0x6040, 0, "00 00 00 00", 0x06070012),  # too long
        (0x6065, 0, "00 00", 0x06070013),  # too short
        (0x20C4, 2, "40 00", 0x06090031),  # 64 > 63
        (0x20C4, 3, "00 00", 0x06090032),  # 0 < 1
        (0x60C0, 0, "00 00", 0x06090030),  # only −1
        (0x60C2, 1, "02", 0x06090030),  # only 1
        (0x1012, 0, "01 01 00 00", 0x06090030),  # only 0x100
        (0x6060, 0, "02", 0x06090030),  # mode 2 does not exist
        (0x1003, 0, "01", 0x06090030),  # only 0 clears the history
    ],
)
def test_refused_downloads(
    host: Host, index: int, subindex: int, data: str, code: int
) -> None:
    with pytest.raises(Abort) as abort:
        host.write_bytes(index, subindex, bytes.fromhex(data))
    assert abort.value.code == code


@pytest.mark.parametrize(
    ("index", "subindex", "code"),
    [
        (0x20C1, 0, 0x06010001),  # write only
        (0x60C4, 5, 0x06010001),
        (0x60C4, 6, 0x06010001),
        (0x60C1, 0, 0x06020000),
        (0x20C4, 4, 0x06090011),
        (0x1003, 1, 0x06090011),  # the history is empty
    ],
)
def test_refused_uploads(host: Host, index: int, subindex: int, code: int) -> None:
    with pytest.raises(Abort) as abort:
        host.read(index, subindex)
    assert abort.value.code == code


def test_length_is_checked_before_the_segments_come(host: Host) -> None:
    assert host.ask("21 40 60 00 08 00 00 00").hex() == "8040600012000706"


def test_segments_that_don_t_add_up(host: Host) -> None:
    host.prepare_ip()
    host.ask("21 C1 20 00 08 00 00 00")
    assert host.ask("01 10 27 00 00 00 00 00").hex() == "80c1200010000706"


def test_refused_value_changes_nothing(host: Host) -> None:
    with pytest.raises(Abort):
        host.write(0x20C4, 2, 64, 2)
    assert host.read(0x20C4, 2) == 4


def test_no_sdo_when_stopped(host: Host) -> None:
    host.nmt(0x02, 1)
    host.send(0x601, "40 00 10 00 00 00 00 00", ms=2)
    assert host.heard(0x581) == []
    host.nmt(0x80, 1)
    assert host.read(0x1000) == 0x00020192
