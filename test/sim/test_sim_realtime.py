"""Simulated drives in real time: on python-can buses, behind a terminal, as a program."""

from __future__ import annotations

import os
import re
import select
import signal
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path

import can
import canopen
import numpy as np
import pytest
from sim_host import Host, pvt

from epos2_ros.sim.epos2 import Epos2
from epos2_ros.sim.main import main, node_list
from epos2_ros.sim.realtime import RealtimeSimulator, build_drives, now_us
from epos2_ros.sim.slcan import SlcanAdapter

ROOT = Path(__file__).resolve().parents[2]
PATIENCE_S = 10.0


def until(condition: Callable[[], bool]) -> None:
    """Waits for what another thread or process is to do."""
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, "never happened"
        time.sleep(0.002)


# --- on a bus of python-can -------------------------------------------------------------


@pytest.fixture
def bus(request: pytest.FixtureRequest) -> Iterator[can.BusABC]:
    """The host's end of a virtual bus with the drives of `drives` on it."""
    channel = f"sim-{request.node.name}"
    with (
        can.Bus(interface="virtual", channel=channel, preserve_timestamps=True) as host,
        can.Bus(interface="virtual", channel=channel) as theirs,
    ):
        simulator = RealtimeSimulator(theirs, request.getfixturevalue("drives"))
        simulator.start()
        yield host
        simulator.stop()


@pytest.fixture
def drives() -> list[Epos2]:
    return build_drives([1, 2], drift_ppm=100, record=True)


def send(bus: can.BusABC, can_id: int, data: bytes, stamp_s: float | None = None) -> None:
    bus.send(
        can.Message(
            arbitration_id=can_id,
            data=data,
            is_extended_id=False,
            timestamp=time.time() if stamp_s is None else stamp_s,
        )
    )


def sdo(bus: can.BusABC, request: str, node: int = 1) -> bytes:
    send(bus, 0x600 + node, bytes.fromhex(request))
    while True:
        message = bus.recv(PATIENCE_S)
        assert message is not None
        if message.arbitration_id == 0x580 + node:
            return bytes(message.data)


def test_canopen_library_moves_two_drives(bus: can.BusABC, drives: list[Epos2]) -> None:
    """canopen's own classes find a device they can configure, map and command."""
    with canopen.Network(bus).connect() as network:
        nodes = [network.add_node(n, str(ROOT / "epos2_ros/eds/epos2.eds")) for n in (1, 2)]
        network.nmt.send_command(0x82)
        until(lambda: all(node.nmt.state == "PRE-OPERATIONAL" for node in nodes))  # booted
        for node in nodes:
            assert node.sdo[0x1008].raw == "EPOS2"
            record, word = node.rpdo[1], node.rpdo[2]
            for pdo, entry, transmission in ((record, 0x20C1, 255), (word, 0x6040, 1)):
                pdo.read()
                pdo.clear()
                pdo.add_variable(entry)
                pdo.trans_type = transmission
                pdo.enabled = True
                pdo.save()
            node.sdo[0x6060].raw = 7
            node.nmt.send_command(0x01)
            for command in (0x06, 0x0F):
                node.sdo[0x6040].raw = command
            until(lambda node=node: node.sdo[0x6041].raw & 0x6F == 0x27)
            node.sdo[0x60C4][6].raw = 1
            for point in ((500, 300, 100), (1000, 0, 100), (1000, 0, 0)):
                network.send_message(0x200 + node.id, pvt(*point))
            network.send_message(0x300 + node.id, b"\x1f\x00")
            assert node.sdo[0x60C4][2].raw == 61
            assert not node.sdo[0x6041].raw & 0x1000
        network.sync.transmit()
        until(lambda: all(node.sdo[0x6064].raw == 1000 for node in nodes))
    assert drives[0].ip_start_us == drives[1].ip_start_us
    for drive in drives:
        assert [k for k, _ in drive.executed] == list(range(201))
        assert drive.executed[100] == (100, 500)


def test_sync_counts_from_its_time_stamp(bus: can.BusABC, drives: list[Epos2]) -> None:
    """Two SYNCs that come at once but are stamped 40 ms apart."""
    latched = []
    stamp_s = time.time()
    for age_s in (0.05, 0.01):
        send(bus, 0x080, b"", stamp_s - age_s)
        latched.append(int.from_bytes(sdo(bus, "40 13 10 00 00 00 00 00")[4:], "little"))
    assert (latched[1] - latched[0]) % 2**32 == pytest.approx(40_000, abs=1000)


@pytest.mark.parametrize("stamp_s", [0.0, 12.5, 4e9])
def test_stamp_of_another_clock_is_not_used(
    bus: can.BusABC, drives: list[Epos2], stamp_s: float
) -> None:
    before = now_us()
    send(bus, 0x080, b"", stamp_s)
    value = int.from_bytes(sdo(bus, "40 13 10 00 00 00 00 00")[4:], "little")
    clock = drives[0].clock
    age = (clock.value(now_us()) - value) % 2**32
    assert age <= clock.rate * (now_us() - before) + 1000


def test_drives_hear_each_other(bus: can.BusABC, drives: list[Epos2]) -> None:
    assert sdo(bus, "23 16 10 01 64 00 01 00", node=2)[0] == 0x60  # watch node 1, 100 ms
    assert sdo(bus, "2B 17 10 00 14 00 00 00", node=1)[0] == 0x60  # every 20 ms
    until(lambda: 1 in drives[1]._deadlines_us)
    assert sdo(bus, "2B 17 10 00 00 00 00 00", node=1)[0] == 0x60
    until(lambda: drives[1].status_word & 0x4F == 0x08)


def test_drives_of_one_seed_are_the_same() -> None:
    one, two, other = (build_drives([1, 2], drift_ppm=100, seed=s) for s in (5, 5, 6))
    rates = [[drive.rate for drive in drives] for drives in (one, two, other)]
    assert rates[0] == rates[1] != rates[2]
    assert all(abs(rate - 1) <= 100e-6 for rate in sum(rates, []))


class Flaky(can.BusABC):
    """A bus that has to be asked several times for everything, and breaks down once."""

    def __init__(self) -> None:
        super().__init__("flaky")
        self.received = deque([can.Message(arbitration_id=0, data=[0x81, 0], is_extended_id=False)])
        self.sent: list[tuple[int, bytes]] = []
        self.attempts = 0
        self.broken = 3

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self.attempts += 1
        if self.attempts % 3:
            raise can.CanOperationError("No buffer space available", 105)
        self.sent.append((msg.arbitration_id, bytes(msg.data)))

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if self.broken:
            self.broken -= 1
            raise can.CanOperationError("Network is down", 100)
        if self.received:
            return self.received.popleft(), True
        time.sleep(timeout or 0)
        return None, True


def test_full_transmit_queue_loses_nothing() -> None:
    """ENOBUFS: sent again, in order; a bus that is down is tried again too."""
    drives = [Epos2(n) for n in (1, 2, 3)]
    bus = Flaky()
    simulator = RealtimeSimulator(bus, drives)
    simulator.start()
    until(lambda: len(bus.sent) >= 6)
    simulator.stop()
    bus.shutdown()
    boot = [(0x701, b"\0"), (0x702, b"\0"), (0x703, b"\0")]
    assert bus.sent == boot + boot  # at power-on, and after the reset


class Backlog(can.BusABC):
    """A bus on which everything has come in before anyone looked."""

    def __init__(self, frames: list[tuple[float, int, bytes]]) -> None:
        super().__init__("backlog")
        self.received = deque(
            can.Message(timestamp=stamp_s, arbitration_id=can_id, data=data, is_extended_id=False)
            for stamp_s, can_id, data in frames
        )
        self.sent: list[int] = []

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self.sent.append(msg.arbitration_id)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if self.received:
            return self.received.popleft(), True
        time.sleep(timeout or 0)
        return None, True


def test_late_thread_gives_every_frame_its_time() -> None:
    """A second of traffic at once: the drive never runs ahead of a record that came in time."""
    drive = Epos2(1, record=True)
    host = Host(drive)
    host.prepare_ip()
    zero_s = time.time() - 0.9
    frames = [(zero_s - 0.05, 0x201, pvt(100 * n, 60, 50)) for n in (1, 2, 3, 4)]
    frames += [(zero_s - 0.01, 0x301, b"\x1f\x00"), (zero_s, 0x080, b"")]
    for n in range(5, 16):
        frames.append((zero_s + 0.05 * n - 0.17, 0x201, pvt(100 * n, 60, 50)))
    frames.append((zero_s + 0.62, 0x201, pvt(1550, 0, 50)))
    frames.append((zero_s + 0.63, 0x201, pvt(1550, 0, 0)))
    bus = Backlog(frames)
    simulator = RealtimeSimulator(bus, [drive])
    simulator.start()
    until(lambda: not drive.ip_active and drive.position_actual == 1550)
    simulator.stop()
    bus.shutdown()
    assert 0x081 not in bus.sent
    assert dict(drive.executed)[400] == 800
    assert drive.executed[-1] == (800, 1550)


# --- slcan ------------------------------------------------------------------------------


@pytest.fixture
def adapter() -> Iterator[SlcanAdapter]:
    with SlcanAdapter() as adapter:
        yield adapter


@pytest.fixture
def terminal(adapter: SlcanAdapter) -> Iterator[int]:
    """The user's end."""
    descriptor = os.open(adapter.path, os.O_RDWR | os.O_NOCTTY)
    yield descriptor
    os.close(descriptor)


def answers(terminal: int) -> bytes:
    text = b""
    while select.select([terminal], [], [], 0.02)[0]:
        text += os.read(terminal, 1000)
    return text


@pytest.mark.parametrize(
    ("commands", "expected"),
    [
        (b"S8\r", b"\r"),
        (b"S9\r", b"\a"),
        (b"O\r", b"\r"),
        (b"O\rO\r", b"\r\a"),
        (b"O\rS8\r", b"\r\a"),  # the bit rate is set while closed
        (b"C\r", b"\a"),
        (b"O\rC\r", b"\r\r"),
        (b"L\rt1230\r", b"\r\a"),  # listening only
        (b"t1230\r", b"\a"),  # closed
        (b"O\rt1230\r", b"\rz\r"),
        (b"O\rt123211FF\r", b"\rz\r"),
        (b"O\rt12321\r", b"\r\a"),  # two bytes announced
        (b"O\rT000001231AA\r", b"\rZ\r"),
        (b"O\rr1230\r", b"\rz\r"),
        (b"O\rR000001230\r", b"\rZ\r"),
        (b"V\r", b"V1013\r"),
        (b"F\r", b"F00\r"),
        (b"\r", b"\r"),
        (b"?\r", b"\a"),
    ],
)
def test_slcan_commands(
    adapter: SlcanAdapter, terminal: int, commands: bytes, expected: bytes
) -> None:
    os.write(terminal, commands)
    text = b""
    deadline = time.monotonic() + PATIENCE_S
    while len(text) < len(expected) and time.monotonic() < deadline:
        adapter.recv(0.01)
        text += answers(terminal)
    assert text == expected


def test_a_frame_that_is_got_to_late_has_the_time_when_it_came(
    adapter: SlcanAdapter, terminal: int
) -> None:
    """A computer that is busy with something else makes no frame late."""
    written_s = []
    for line in (b"O\r", b"t0800\r", b"t2010\r"):
        written_s.append(time.time())
        os.write(terminal, line)
        assert select.select([adapter._reader], [], [], PATIENCE_S)[0]
        adapter._reader.look()
    late_s = time.time()
    stamps = [adapter.recv(PATIENCE_S).timestamp for _ in range(2)]
    assert written_s[1] <= stamps[0] <= written_s[2] <= stamps[1] <= late_s


def test_a_simulator_that_is_killed_leaves_nothing_behind() -> None:
    """Nor is anything left to wait for when it is the reader of its terminal that is killed."""
    program = "from epos2_ros.sim.slcan import SlcanAdapter as A; a = A(); " + (
        "print(a._reader._process.pid, flush=True); input()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", program], cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as simulator:
        assert simulator.stdout is not None
        reader = os.pidfd_open(int(simulator.stdout.readline()))
        simulator.kill()
        assert select.select([reader], [], [], PATIENCE_S)[0]  # it has ended
        os.close(reader)
    with SlcanAdapter() as adapter:
        adapter._reader._process.kill()
        with pytest.raises(can.CanOperationError, match="reader has ended"):
            adapter.recv(PATIENCE_S)


def test_slcan_frames_both_ways(adapter: SlcanAdapter, terminal: int) -> None:
    os.write(terminal, b"O\rt6018400010000000")
    assert adapter.recv(0.05) is None  # half a line
    os.write(terminal, b"0000\r")
    message = adapter.recv(PATIENCE_S)
    assert message is not None
    assert (message.arbitration_id, message.data.hex()) == (0x601, "4000100000000000")
    answers(terminal)
    adapter.send(can.Message(arbitration_id=0x581, data=b"\x43\x00\xff", is_extended_id=False))
    assert answers(terminal) == b"t58134300FF\r"
    os.write(terminal, b"C\r")
    adapter.recv(0.05)
    answers(terminal)
    adapter.send(can.Message(arbitration_id=0x581, data=b"", is_extended_id=False))
    assert answers(terminal) == b""  # a closed adapter is silent


def test_python_can_speaks_to_it(adapter: SlcanAdapter) -> None:
    pytest.importorskip("serial")
    simulator = RealtimeSimulator(adapter, [Epos2(5)])
    simulator.start()
    with can.Bus(
        interface="slcan", channel=adapter.path, bitrate=1_000_000, sleep_after_open=0
    ) as bus:
        answer = sdo(bus, "40 00 10 00 00 00 00 00", node=5)
        assert answer.hex() == "4300100092010200"
    simulator.stop()
    assert adapter.bitrate == 1000


# --- the program ------------------------------------------------------------------------


def test_node_lists() -> None:
    assert node_list("1-3") == [1, 2, 3]
    assert node_list("7") == [7]
    assert node_list("1, 5-6,127") == [1, 5, 6, 127]


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--channel", "x", "--nodes", "0-3"], "node ids are 1 … 127"),
        (["--channel", "x", "--nodes", "120-130"], "node ids are 1 … 127"),
        (["--channel", "x", "--nodes", "a"], "like 1-6"),
        (["--channel", "x", "--nodes", "3-1"], "node ids"),
        (["--channel", "x", "--nodes", "1,1"], "twice"),
        (["--channel", "x", "--bitrate", "123"], "bitrate"),
        (["--channel", "x", "--drift-ppm", "-1"], "drift-ppm"),
        (["--channel", "x", "--counts-per-turn", "0"], "counts-per-turn"),
        (["--channel", "x", "--log", "log.csv"], ".npz"),
        (["--channel", "x", "--log", "/nowhere/log.npz"], "/nowhere"),
        ([], "--channel"),
        (["--channel", "x", "--what"], "--what"),
        (["--interface", "nonsense", "--channel", "x"], "nonsense"),
        (["--interface", "socketcan", "--channel", "nocan0"], "nocan0"),
    ],
)
def test_bad_arguments_get_one_line(
    arguments: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 2
    output, error = capsys.readouterr()
    assert output == ""
    assert error.startswith("epos2_ros simulator: ")
    assert error.count("\n") == 1
    assert says in error


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_program_runs_a_motion_and_writes_its_log(tmp_path: Path, number: int) -> None:
    """Through the terminal, in ASCII; ROS arguments of a launch file are no concern of it."""
    log = tmp_path / "log.npz"
    program = subprocess.Popen(
        [sys.executable, "-m", "epos2_ros", "simulator", "--slcan", "--nodes", "3", "--log", log,
         "--ros-args", "-r", "__node:=simulator", "--params-file", "x.yaml"],
        cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        assert program.stdout is not None
        terminal = os.open(program.stdout.readline().split()[-1], os.O_RDWR | os.O_NOCTTY)
        os.write(terminal, b"S8\rO\r")
        heard = ""

        def ask(request: str, answer: str) -> str:
            """Sends an SDO request; gives what follows `answer` in the response, in hex."""
            nonlocal heard
            os.write(terminal, f"t6038{request:0<16}\r".encode())
            expected = re.compile(f"t5838{answer}([0-9A-F]*)\r")
            while not (match := expected.search(heard)):
                assert select.select([terminal], [], [], PATIENCE_S)[0], f"{request}: no answer"
                heard += os.read(terminal, 1000).decode()
            heard = heard[match.end() :]
            return match[1]

        ask("2F60600007", "60606000")  # mode 7
        ask("2B4060000600", "60406000")
        ask("2B4060000F00", "60406000")
        while int(ask("40416000", "4B416000")[:2], 16) & 0x6F != 0x27:  # operation enabled
            pass
        ask("2FC4600601", "60C46006")  # buffer enabled
        for point in ((200, 120, 50), (400, 0, 50), (400, 0, 0)):
            data = pvt(*point).hex().upper()
            ask("21C1200008000000", "60C12000")
            ask(f"00{data[:14]}", "20")
            ask(f"1D{data[14:]}", "30")
        ask("2B4060001F00", "60406000")
        while int(ask("40C42001", "4BC42001")[2:4], 16) & 0x80:  # ip mode active
            pass
        os.close(terminal)
        program.send_signal(number)
        output, error = program.communicate(timeout=PATIENCE_S)
        assert (program.returncode, error) == (0, "")
    finally:
        program.kill()
    with np.load(log) as columns:
        path, demand = columns["node_3_path_ms"], columns["node_3_demand_qc"]
        assert path.tolist() == list(range(101))
        assert demand[[0, 50, 100]].tolist() == [0, 200, 400]
        assert np.abs(columns["node_3_actual_qc"] - demand).max() < 20
        assert np.all(np.diff(columns["node_3_time_us"]) > 0)
        assert columns["node_3_buffer_level"].tolist()[:2] == [2, 2]
