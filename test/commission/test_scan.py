"""The program `scan`: a survey in simulated time, on simulated drives of three makers."""

from __future__ import annotations

import re
import struct
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import can
import pytest
import yaml
from cl3e_stub import Cl3eStub
from hypothesis import given, settings
from hypothesis import strategies as st
from socketcan_guest import run_tool

from epos2_ros.bus.health import Health
from epos2_ros.commission import report, wire
from epos2_ros.commission.found import Found
from epos2_ros.commission.makers import last_error, maker_of, state_in_words
from epos2_ros.commission.oddities import Wiring, oddities
from epos2_ros.commission.parameter_file import parameter_file
from epos2_ros.commission.place import Place
from epos2_ros.commission.scan import main
from epos2_ros.commission.survey import Survey
from epos2_ros.commission.uploads import Refusal, Uploads
from epos2_ros.configuration.files import read_parameters
from epos2_ros.configuration.parameters import DriverParameters
from epos2_ros.errors import BusError, DriveError
from epos2_ros.plan import main as plan
from epos2_ros.protocol.frame import Frame
from epos2_ros.sim.can_bus import SimulatedBus
from epos2_ros.sim.copley import Copley
from epos2_ros.sim.epos2 import Epos2
from epos2_ros.sim.realtime import RealtimeSimulator, build_copley_drives, build_drives
from epos2_ros.sim.slcan import SlcanAdapter

ROOT = Path(__file__).resolve().parents[2]
FINE = Wiring(Health())
CAN0 = Place("socketcan", "can0", 1_000_000)


class Scanned:
    """A survey of drives on a bus in simulated time, and what the host sent for it."""

    def __init__(
        self,
        *drives: Any,
        bitrate: int = 1_000_000,
        listen_s: float = 1.0,
        echo: bool = True,
        setup: Callable[[SimulatedBus], None] = lambda bus: None,
        others: Sequence[tuple[float, Frame]] = (),
    ) -> None:
        self.bus = SimulatedBus(bitrate)
        for drive in drives:
            self.bus.add(drive)
        setup(self.bus)
        self.sent: list[Frame] = []
        survey = self.survey = Survey(0.0, bitrate, 1e6 * listen_s)
        others = sorted(others, reverse=True)

        def see(can_id: int, data: bytes, t_us: float, is_echo: bool) -> bool:
            if echo or not is_echo:
                survey.receive(Frame(can_id, bytes(data)), t_us)
            return survey.deadline_us <= self.bus.now_us or survey.done

        while not survey.done:
            survey.advance(self.bus.now_us)
            while survey.outbox:
                frame = survey.outbox.popleft()
                self.sent.append(frame)
                self.bus.host_send(*frame)
                survey.sent(frame)
            while others and others[-1][0] <= self.bus.now_us:
                survey.receive(others.pop()[1], self.bus.now_us)
            due = min(survey.deadline_us, *(t_us for t_us, _ in others[-1:]), 60e6)
            self.bus.run_until(max(due, self.bus.now_us), see)
            assert self.bus.now_us < 60e6, "it never ends"

    @property
    def seconds(self) -> float:
        return (self.survey.ended_us - self.survey.began_us) / 1e6

    @property
    def odd(self) -> list[str]:
        return oddities(self.survey, FINE)

    def __getitem__(self, node_id: int) -> Found:
        return self.survey.nodes[node_id]

    @property
    def present(self) -> list[int]:
        return [found.node_id for found in self.survey.present()]


def only_uploads(frames: Sequence[Frame]) -> bool:
    """SDO requests with the client command specifiers of an upload (CiA 301, 7.2.4.3.5/6)."""
    return all(
        0x601 <= frame.can_id <= 0x67F and len(frame.data) == 8 and frame.data[0] >> 5 in (2, 3)
        for frame in frames
    )


def values_of(drive: Any) -> dict[tuple[int, int], bytes]:
    """All that can be read from it and stays the same by itself."""
    clocks = {(0x1013, 0)}
    return {
        at: entry.pack()
        for at, entry in drive.dictionary.items()
        if at not in clocks and not (at[0] == 0x1003 and at[1])
    }


@pytest.fixture(scope="module")
def fleet() -> Scanned:
    """32 drives of three makers on 31 node ids."""
    epos2 = [Epos2(n, serial=1000 + n, position_qc=-n) for n in range(1, 20)]
    copley = [Copley(n, serial=2000 + n) for n in range(20, 28)]
    cl3e = [Cl3eStub(n, serial=3000 + n) for n in (28, 29, 30, 126)]
    drives = [*epos2, *copley, *cl3e, Epos2(7, serial=77)]
    assert len(drives) == 32
    before = [values_of(drive) for drive in drives]
    scanned = Scanned(*drives)
    assert [values_of(drive) for drive in drives] == before
    return scanned


def test_thirty_two_drives_are_found_in_time_without_changing_one(fleet: Scanned) -> None:
    assert fleet.present == [*range(1, 31), 126]
    assert fleet.seconds < 5.0
    assert only_uploads(fleet.sent)
    serials = ((3, "maxon", 1003), (21, "Copley", 2021), (126, "Nanotec", 3126))
    for node_id, maker, serial in serials:
        identity = fleet[node_id].identity
        assert (identity.maker, identity.serial_number) == (maker, serial)
    assert maker_of(fleet[126]).firmware(fleet[126]) == "FIR-v1419-B29378"  # three segments
    assert fleet[5].integer(0x6064, signed=True) == -5


def test_doubled_node_id_is_told_with_both_serial_numbers(fleet: Scanned) -> None:
    doubled = [line for line in fleet.odd if "two devices" in line]
    assert len(doubled) == 1
    assert "node 7: two devices answer to this id (serial numbers 77 and 1007)" in doubled[0]


def test_report_has_a_line_for_every_drive(fleet: Scanned) -> None:
    text = report.text(fleet.survey, FINE, "can0")
    rows = [line for line in text.splitlines() if re.match(r" *\d+  [a-zA-Z]", line)]
    table = {int(line.split()[0]): line for line in rows}
    assert sorted(table) == fleet.present
    assert table[4].endswith("yes") and table[25].endswith("yes") and table[126].endswith("yes")
    assert "switch on disabled  pre-operational" in table[4]
    assert "-4000 units" in table[126] and "rpm, encoder 2000/1" in table[126]


@pytest.mark.parametrize("bitrate", [125_000, 500_000])
def test_slower_buses_take_hardly_longer(bitrate: int) -> None:
    drives = [Epos2(n, serial=n, bitrate=bitrate) for n in range(1, 33)]
    scanned = Scanned(*drives, bitrate=bitrate)
    assert scanned.present == list(range(1, 33))
    assert scanned.seconds < 5.0
    assert scanned.odd == []


def test_slowest_bus_is_scanned_without_mistaking_a_late_answer() -> None:
    scanned = Scanned(Epos2(5, bitrate=10_000), Copley(6), bitrate=10_000)
    assert scanned.present == [5, 6] and scanned.odd == []


def test_bus_stays_free_for_others() -> None:
    scanned = Scanned(*(Epos2(n) for n in range(1, 33)), listen_s=0)
    requests = scanned.bus.bits_by_function[0x600] * scanned.bus.bit_us / 1e6
    assert requests / scanned.seconds < 0.5


def test_empty_bus_says_what_to_look_at() -> None:
    scanned = Scanned()
    assert scanned.present == [] and scanned.seconds < 5.0
    assert any("power, wiring, bit rate" in line for line in scanned.odd)
    with pytest.raises(DriveError, match="no drive was found"):
        parameter_file(scanned.survey, CAN0)


def beat(drive: Epos2, period_ms: int) -> None:
    """Its heartbeat time, by SDO."""
    request = bytes.fromhex("2B171000") + struct.pack("<HH", period_ms, 0)
    drive.receive(0x600 + drive.node_id, request, drive.now_us)
    drive.outbox.clear()


# --- states and what the drives support ---------------------------------------------------


def statusword(drive: Epos2, word: int) -> None:
    drive.dictionary[0x6041, 0].read = lambda: word


@pytest.mark.parametrize(
    ("word", "says"),
    [
        (0x0140, "switch on disabled"),
        (0x0121, "ready to switch on"),
        (0x0123, "switched on"),
        (0x0137, "operation enabled"),
        (0x0117, "quick stop active"),
        (0x0108, "fault"),
        (0x4123, "switched on"),  # refreshing its power stage
        (0x4133, "switched on"),  # measuring
    ],
)
def test_state_is_told_in_words(word: int, says: str) -> None:
    drive = Epos2(1)
    statusword(drive, word)
    assert state_in_words(Scanned(drive, listen_s=0)[1]) == says


@pytest.mark.parametrize(("nmt", "says"), [(0x01, "operational"), (0x80, "pre-operational")])
def test_nmt_state_without_heartbeats_is_that_of_the_statusword(nmt: int, says: str) -> None:
    drive = Epos2(1)
    drive.receive(0, bytes([nmt, 1]), 0.0)
    drive.outbox.clear()
    text = report.text(Scanned(drive, listen_s=0).survey, FINE, "can0")
    assert re.search(rf"switch on disabled  {says} ", text)


def test_stopped_drive_is_heard_and_said_to_be_silent() -> None:
    drive = Epos2(4)
    beat(drive, 200)
    drive.receive(0, b"\x02\x04", 0.0)  # NMT stop
    scanned = Scanned(drive)
    assert scanned.present == []
    assert any("node 4 is heard, but does not answer: it is stopped" in s for s in scanned.odd)


def test_last_error_is_told_in_words() -> None:
    drive, other = Epos2(1), Copley(2)
    drive.fail(0x8611)
    drive.fail(0x3210)
    other.emergency(0x2345)
    third = Copley(3)
    third.emergency(0x8130)
    scanned = Scanned(drive, other, third, listen_s=0)
    assert last_error(scanned[1]) == "over-voltage (0x3210)"
    assert last_error(scanned[2]) == "current (0x2345)"
    assert "the host was not heard (0x8130)" in last_error(scanned[3])
    assert last_error(Scanned(Epos2(1), listen_s=0)[1]) == ""


def test_old_firmware_and_missing_objects_are_no_good() -> None:
    old, lame, lost = Epos2(1, revision=0x2100_0000), Epos2(2), Epos2(3)
    for drive, index in ((lame, 0x20C1), (lost, 0x6502)):
        for at in [at for at, _ in drive.dictionary.items() if at[0] == index]:
            del drive.dictionary._entries[at]
        drive.dictionary._indices.discard(index)
    for drive in (old, lame):
        for at in [at for at, _ in drive.dictionary.items() if at[0] == 0x2003]:
            del drive.dictionary._entries[at]
    scanned = Scanned(old, lame, lost, listen_s=0)
    lacks = [maker_of(scanned[n]).lacks(scanned[n]) for n in (1, 2, 3)]
    assert "2100h" in lacks[0][0] and "2101h or newer" in lacks[0][0]
    assert lacks[1] == ["it has no interpolation data record (0x20C1-00)"]
    assert lacks[2] == []


def test_a_copley_drive_without_its_pvt_buffer_is_no_good() -> None:
    drive = Copley(4)
    del drive.dictionary._entries[0x2012, 0]
    drive.dictionary._indices.discard(0x2012)
    scanned = Scanned(drive, Copley(5), listen_s=0)
    assert maker_of(scanned[4]).lacks(scanned[4]) == ["it has no PVT buffer status (0x2012-00)"]
    assert maker_of(scanned[5]).lacks(scanned[5]) == []


# --- what is odd ----------------------------------------------------------------------------


def test_two_alike_on_one_id_are_noticed_by_their_heartbeats_or_answers() -> None:
    twins = [Epos2(9, serial=1), Epos2(9, serial=1)]
    scanned = Scanned(*twins)
    assert [line for line in scanned.odd if "node 9" in line and "two devices" in line]


def test_heartbeats_more_often_than_set_are_odd() -> None:
    drive = Epos2(3)
    beat(drive, 200)
    beats = [(100e3 + 200e3 * k, Frame(0x703, b"\x7f")) for k in range(15)]
    assert any("node 3: heartbeats come more often" in s for s in Scanned(drive, others=beats).odd)


def test_heartbeats_as_set_are_not_odd() -> None:
    drive = Epos2(3)
    beat(drive, 100)
    scanned = Scanned(drive)
    assert scanned.odd == [] and len(scanned.survey.heard.heartbeats[3]) > 10


def test_late_answer_is_not_a_second_device() -> None:
    """A busy drive answers the first request when it was repeated already, then both."""
    held: list[bytes] = []

    class Busy(Epos2):
        """Looks at its first request when the second has come."""

        def receive(self, can_id: int, data: bytes, t_us: float, remote: bool = False) -> bool:
            if can_id == 0x608 and t_us < 200e3:
                held.append(data)
                return True
            while can_id == 0x608 and held:
                super().receive(can_id, held.pop(), t_us)
            return super().receive(can_id, data, t_us, remote)

    scanned, fine = Scanned(Busy(8), listen_s=0), Epos2(8)
    assert scanned.present == [8] and scanned.odd == []
    assert scanned[8].answers == Scanned(fine, listen_s=0)[8].answers


def test_another_host_is_noticed_and_not_taken_for_a_second_device() -> None:
    read = Frame(0x603, bytes.fromhex("4064600000000000"))
    theirs = [(1.3e6, read), (1.3e6, Frame(0x583, bytes.fromhex("4364600001000000")))]
    others = [*theirs, (0.2e6, Frame(0x080)), (0.3e6, Frame(0x77F, b"\x05"))]
    odd = Scanned(Epos2(3), others=others).odd
    assert len(odd) == 1
    assert "another host" in odd[0]
    assert "1 SDO requests" in odd[0] and "a host's heartbeat" in odd[0]


def test_restarting_drive_and_emergencies_are_told() -> None:
    boots = [(1e5 * k, Frame(0x702, b"\0")) for k in range(1, 4)]
    emergency = (2e5, Frame(0x082, bytes.fromhex("2032010000000000")))
    odd = Scanned(Epos2(2), others=[*boots, emergency]).odd
    assert any("node 2 started 4 times" in line for line in odd)
    assert any("node 2 reported: under-voltage (0x3220)" in line for line in odd)


def test_two_boot_ups_are_usual_for_a_cl3e() -> None:
    assert Scanned(Cl3eStub(5)).odd == []


def test_drive_with_the_hosts_node_id_is_told() -> None:
    assert any("node 127: the driver's own heartbeat" in s for s in Scanned(Cl3eStub(127)).odd)


# --- losses and nonsense --------------------------------------------------------------------


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_lost_frames_cost_answers_but_make_none_wrong(seed: int) -> None:
    import random

    rng = random.Random(seed)
    truth = Scanned(Epos2(1, serial=4711), Cl3eStub(2, serial=815), listen_s=0)

    def lossy(bus: SimulatedBus) -> None:
        bus.drop = lambda *_: rng.random() < 0.2

    scanned = Scanned(Epos2(1, serial=4711), Cl3eStub(2, serial=815), listen_s=0, setup=lossy)
    for node_id in (1, 2):
        for at, answer in scanned[node_id].answers.items():
            assert answer in (None, truth[node_id].answers.get(at, answer))
    assert not [line for line in scanned.odd if "two devices" in line]


SDO = st.tuples(st.integers(0x581, 0x5FF), st.binary(max_size=8))
ANY = st.tuples(st.integers(0, 0x7FF), st.binary(max_size=8))


@settings(max_examples=150, deadline=None)
@given(frames=st.lists(st.tuples(SDO | ANY, st.floats(0, 5e4)), max_size=60))
def test_whatever_arrives_the_survey_ends(frames: list[tuple[tuple[int, bytes], float]]) -> None:
    survey, t_us = Survey(0.0, 1_000_000, 0.0), 0.0
    for frame, wait_us in frames:
        survey.receive(Frame(*frame), t_us)
        t_us += wait_us
        survey.advance(t_us)
    while not survey.done:
        t_us = max(t_us, survey.deadline_us)
        survey.advance(t_us)
        assert t_us < 60e6
    assert only_uploads(survey.outbox)
    report.text(survey, FINE, "can0")  # whatever they answered can be told


@settings(max_examples=100, deadline=None)
@given(value=st.binary(max_size=200))
def test_upload_of_any_length(value: bytes) -> None:
    """Against a server written out from CiA 301, 7.2.4.3.5 – 6."""
    got: list[object] = []

    def questions() -> Iterator[tuple[int, int]]:
        got.append((yield 0x2000, 3))  # type: ignore[misc]

    uploads = Uploads(
        {1: questions()},  # type: ignore[dict-item]
        0.0, gap_us=1.0, settle_us=1.0, timeout_us=1e3,
    )  # fmt: skip
    t_us, rest = 0.0, b""
    while not uploads.done:
        t_us = max(t_us + 1, uploads.deadline_us)
        uploads.advance(t_us)
        if not uploads.outbox:
            continue
        can_id, request, _ = uploads.outbox.popleft()
        assert can_id == 0x601
        if request[0] == 0x40:
            assert request == bytes.fromhex("4000200300000000")
            if 1 <= len(value) <= 4:
                answer = bytes([0x43 | 4 - len(value) << 2]) + request[1:4] + value.ljust(4, b"\0")
            else:
                answer, rest = b"\x41" + request[1:4] + struct.pack("<I", len(value)), value
        else:
            part, rest = rest[:7], rest[7:]
            toggle = request[0] & 0x10
            answer = bytes([toggle | 7 - len(part) << 1 | (not rest)]) + part.ljust(7, b"\0")
        uploads.receive(Frame(0x581, answer), t_us + 0.5)
    assert got == [value]


def test_abort_in_the_middle_of_a_transfer_is_the_answer() -> None:
    got: list[object] = []

    def questions() -> Iterator[tuple[int, int]]:
        got.append((yield 0x1008, 0))  # type: ignore[misc]

    uploads = Uploads(
        {1: questions()},  # type: ignore[dict-item]
        0.0, gap_us=1.0, settle_us=1.0, timeout_us=1e3,
    )  # fmt: skip
    uploads.advance(0.0)
    uploads.receive(Frame(0x581, bytes.fromhex("4108100010000000")), 10.0)
    uploads.advance(20.0)
    uploads.receive(Frame(0x581, bytes.fromhex("8008100000000405")), 30.0)
    assert got == [Refusal(0x0504_0000)] and uploads.done


# --- the parameter file ---------------------------------------------------------------------


def test_parameter_file_is_one_the_driver_takes(fleet: Scanned, tmp_path: Path) -> None:
    file = tmp_path / "found.yaml"
    file.write_text(parameter_file(fleet.survey, CAN0), encoding="utf-8")
    config = DriverParameters(read_parameters(file)).config()
    assert [axis.node_id for axis in config.axes] == fleet.present
    assert {axis.node_id for axis in config.axes if axis.drive == "copley"} == set(range(20, 28))
    assert (config.interface, config.channel, config.simulate) == ("socketcan", "can0", False)
    assert "TWO DRIVES HAVE NODE ID 7" in file.read_text(encoding="utf-8")
    cl3e = {axis.node_id for axis in config.axes if axis.drive == "cl3e"}
    assert cl3e == {28, 29, 30, 126}


def test_parameter_file_is_one_plan_takes(tmp_path: Path) -> None:
    file, trajectory = tmp_path / "found.yaml", tmp_path / "trajectory.yaml"
    scanned = Scanned(Epos2(3), listen_s=0)
    file.write_text(parameter_file(scanned.survey, CAN0), encoding="utf-8")
    points = [
        {"positions": [p], "velocities": [0.0], "time_from_start": {"sec": s}}
        for p, s in ((0.0, 0), (0.1, 2))
    ]
    trajectory.write_text(yaml.safe_dump({"joint_names": ["joint_3"], "points": points}))
    assert plan([str(trajectory), "--params", str(file)]) == 0


def test_parameter_file_has_what_the_drive_is_set_to() -> None:
    drive = Epos2(3)
    drive.dictionary.download(0x6065, 0, struct.pack("<I", 555))
    drive.dictionary.download(0x608B, 0, b"\xfe")
    drive.dictionary.download(0x607D, 1, struct.pack("<i", -777))
    text = parameter_file(Scanned(drive, listen_s=0).survey, CAN0)
    axis = yaml.safe_load(text)["/**"]["ros__parameters"]["axes"]["joint_3"]
    assert (axis["max_following_error"], axis["velocity_notation"]) == (555, -2)
    assert "the drive's are -777 and 2147483647 qc" in text


# --- the program ----------------------------------------------------------------------------


def test_program_reports_simulated_drives(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--params", str(ROOT / "config" / "gantry.yaml"), "--listen", "0"]) == 0
    output, error = capsys.readouterr()
    assert "2 nodes found" in output and "nothing odd" in output and error == ""


def test_parameter_file_goes_to_standard_output_alone(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    arguments = ["--params", str(ROOT / "config" / "outputs.yaml"), "--listen", "0", "--yaml"]
    assert main(arguments) == 0
    output, error = capsys.readouterr()
    file = tmp_path / "found.yaml"
    file.write_text(output, encoding="utf-8")
    assert DriverParameters(read_parameters(file)).config().simulate
    assert "nodes found" in error


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--interface", "nonsense", "--channel", "x"], "can't open CAN interface"),
        (["--interface", "slcan"], "needs a --channel"),
        (["--params", "missing.yaml"], "can't read missing.yaml"),
        (["--params", "x.yaml", "--channel", "can0"], "can't read x.yaml"),
    ],
)
def test_what_can_not_be_gets_one_line(
    arguments: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 1
    output, error = capsys.readouterr()
    assert output == "" and error.count("\n") == 1
    assert error.startswith("epos2_ros scan: ") and says in error


def test_silent_bus_gives_one_and_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--interface", "virtual", "--channel", "silent", "--listen", "0"]) == 1
    assert "0 nodes found" in capsys.readouterr().out


@contextmanager
def behind_slcan(bitrate: int, *drives: Any) -> Iterator[str]:
    with SlcanAdapter(bitrate) as adapter:
        simulator = RealtimeSimulator(adapter, drives)
        simulator.start()
        try:
            yield adapter.path
        finally:
            simulator.stop()


def test_other_bit_rate_is_found_by_listening_only(capsys: pytest.CaptureFixture[str]) -> None:
    drive = Epos2(3, t_us=time.monotonic_ns() / 1000)
    beat(drive, 100)
    with behind_slcan(800_000, drive) as path:
        given = ["--interface", "slcan", "--channel", path, "--bitrate", "1000000"]
        assert main([*given, "--listen", "0.2"]) == 1
    assert "there is traffic at 800 kbit/s: --bitrate 800000" in capsys.readouterr().out


@pytest.mark.socketcan
def test_scan_on_socketcan(vcan: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Where our own frames come back, and a queue that is full refuses more."""
    run_tool("ip", "link", "set", vcan, "txqueuelen", "10")
    drives = [*build_drives([1, 2, 3]), *build_copley_drives([9])]
    with can.Bus(interface="socketcan", channel=vcan) as theirs:
        simulator = RealtimeSimulator(theirs, drives)
        simulator.start()
        try:
            assert main(["--interface", "socketcan", "--channel", vcan, "--listen", "0.2"]) == 0
        finally:
            simulator.stop()
    output = capsys.readouterr().out
    assert f"{vcan}: 4 nodes found" in output and "nothing odd" in output


class Adapter(can.BusABC):
    """An interface that gives `frames` and takes what `full` lets it."""

    def __init__(self, frames: Sequence[can.Message] = (), full: bool = False) -> None:
        super().__init__("fake")
        self.frames, self.full = list(frames), full
        self.gone = threading.Event()

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        if self.full:
            raise can.CanOperationError("no room", error_code=105)  # ENOBUFS

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if self.gone.is_set():
            raise can.CanOperationError("network is down")
        if not self.frames:
            time.sleep(min(timeout or 0.0, 0.01))
        return (self.frames.pop(0) if self.frames else None), False


def error_frame(classes: int, data: str) -> can.Message:
    return can.Message(arbitration_id=classes, is_error_frame=True, data=bytes.fromhex(data))


@pytest.mark.parametrize(
    ("frames", "says"),
    [
        ([error_frame(0x004, "0020000000008000")], "error passive"),
        ([error_frame(0x040, "0000000000000000")], "bus off"),
        ([error_frame(0x020, "0000000000000000")], "nobody acknowledges"),
        (
            [
                error_frame(0x088, "0000000200000000"),
                can.Message(arbitration_id=0x181, is_extended_id=False),
            ],
            "120 ohm at both ends",
        ),
    ],
)
def test_what_the_adapter_says_of_the_bus_is_told(frames: list[can.Message], says: str) -> None:
    survey, wiring = wire.run(Adapter(frames), 1_000_000, 0.05)
    assert any(says in line for line in oddities(survey, wiring))


def test_adapter_that_takes_nothing_is_told() -> None:
    survey, wiring = wire.run(Adapter(full=True), 1_000_000, 0.0)
    assert any("nobody acknowledges what is sent" in line for line in oddities(survey, wiring))


def test_adapter_that_fails_gives_one_line() -> None:
    adapter = Adapter()
    adapter.gone.set()
    with pytest.raises(BusError, match="can't receive from .*network is down"):
        wire.run(adapter, 1_000_000, 0.0)
