"""The program `drive`: dump, diff and restore, on simulated drives in simulated time."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from makers import facts

from epos2_ros.bus.cl3e import Cl3eNode, Cl3eSettings
from epos2_ros.bus.copley import CopleyNode, CopleySettings
from epos2_ros.bus.epos2 import Epos2Node
from epos2_ros.bus.link import Network
from epos2_ros.bus.settings import drive_settings
from epos2_ros.commission.drive import main
from epos2_ros.commission.drive_file import DriveFile, read_drive_file, to_yaml
from epos2_ros.commission.parameter_access import DriveParameters, Values
from epos2_ros.commission.stored import INTEGERS, parameters_of
from epos2_ros.configuration.driver import AxisConfig, DriverConfig
from epos2_ros.errors import ConfigurationError, DriveError
from epos2_ros.protocol.frame import Frame
from epos2_ros.sim.can_bus import SimulatedBus
from epos2_ros.sim.cl3e import Cl3e, Firmware
from epos2_ros.sim.copley import Copley
from epos2_ros.sim.epos2 import Dictionary, Epos2
from epos2_ros.sim.realtime import RealtimeSimulator, build_copley_drives
from epos2_ros.sim.slcan import SlcanAdapter

ROOT = Path(__file__).resolve().parents[2]
GANTRY = str(ROOT / "config" / "gantry.yaml")
PATIENCE_US = 50_000.0
LOAD = b"load"  # CiA 301, 7.5.2.14


class Bench:
    """canopen's client and drives on one simulated bus, in simulated time."""

    def __init__(self, *drives: Any) -> None:
        self.bus = SimulatedBus()
        for drive in drives:
            self.bus.add(drive)
        self.sent: list[Frame] = []
        self._answered = True
        self.network = Network(self._send)
        self._run(1_000.0)

    def parameters(self, node_id: int = 1) -> DriveParameters:
        made = DriveParameters(self.network, node_id)
        made._node.sdo.RESPONSE_TIMEOUT = 0.01  # what is silent in simulated time stays silent
        return made

    def written(self) -> list[tuple[int, int]]:
        """What was set by SDO so far (initiate download)."""
        downloads = [d for can_id, d, _ in self.sent if can_id & 0x780 == 0x600 and d[0] >> 5 == 1]
        return [struct.unpack_from("<HB", data, 1) for data in downloads]

    def write(self, node_id: int, index: int, subindex: int, data: bytes) -> None:
        """By SDO, four bytes."""
        request = b"\x23" + struct.pack("<HB", index, subindex) + data
        self._send(Frame(0x600 + node_id, request))

    def reset(self, drive: Any) -> None:
        """NMT reset node, and the time it takes."""
        self.bus.host_send(0, bytes([0x81, drive.node_id]))
        self._run(500_000.0)

    def _send(self, frame: Frame) -> None:
        self.sent.append(frame)
        self.bus.host_send(*frame)
        self._answered = not 0x600 < frame.can_id < 0x680
        end_us = self.bus.now_us + PATIENCE_US
        while self.bus.now_us < end_us and not self._answered:
            self._run(min(end_us - self.bus.now_us, 500.0))

    def _run(self, duration_us: float) -> None:
        self.bus.run_until(self.bus.now_us + duration_us, self._see)

    def _see(self, can_id: int, data: bytes, t_us: float, echo: bool) -> bool:
        if not echo:
            self._answered = self._answered or can_id & 0x780 == 0x580
            self.network.notify(can_id, bytearray(data), t_us / 1e6)
        return False


def note(node_id: int) -> Epos2:
    """With the dictionary of the application note."""
    return Epos2(node_id, dictionary=Dictionary.NOTE)


def configured(make: Callable[[int], Any], node_id: int) -> tuple[Bench, Any]:
    """A drive as the driver leaves it: other limits, PDOs of its own."""
    drive = make(node_id)
    bench = Bench(drive)
    epos2 = isinstance(drive, Epos2)
    family = "epos2" if epos2 else type(drive).__name__.lower()
    axis = AxisConfig(
        "arm", node_id, min_position=-1.0, max_position=2.0, max_velocity=1.0,
        max_acceleration=5.0, stop_deceleration=3.0, max_following_error=777,
        velocity_notation=-1 if epos2 else 0, drive=family,
    )  # fmt: skip
    if family == "cl3e":
        Cl3eNode(bench.network, Cl3eSettings.of(axis)).configure()
    elif epos2:
        settings = drive_settings(axis, DriverConfig(axes=(axis,)))
        Epos2Node(bench.network, settings).configure()
    else:
        CopleyNode(bench.network, CopleySettings.of(axis)).configure()
    bench.sent.clear()
    return bench, drive


@pytest.mark.parametrize("make", [Epos2, note, Copley, Cl3e])
def test_another_drive_is_made_the_same_through_a_file(
    make: Callable[[int], Any], tmp_path: Path
) -> None:
    bench, _ = configured(make, 5)
    original = bench.parameters(5)
    file = tmp_path / "drive.yaml"
    file.write_text(to_yaml(DriveFile(original.identity, 5, original.read())), encoding="utf-8")
    read = read_drive_file(file)
    assert original.differences(read.values) == []

    fresh = Bench(make(5))
    swapped = fresh.parameters(5)
    before = len(swapped.differences(read.values))
    assert before > 5
    assert swapped.restore(read.values) == []
    assert swapped.differences(read.values) == []
    assert swapped.read() == read.values


def test_factory_reset_is_undone_by_restoring() -> None:
    bench, drive = configured(Epos2, 3)
    parameters = bench.parameters(3)
    kept = parameters.read()
    parameters.store()
    bench.reset(drive)
    assert parameters.differences(kept) == []
    bench.write(3, 0x1011, 1, LOAD)
    bench.reset(drive)
    assert parameters.differences(kept)
    assert parameters.restore(kept) == []
    assert parameters.read() == kept


@pytest.mark.parametrize("make", [Epos2, Copley])
def test_stored_parameters_survive_a_power_off_and_others_do_not(
    make: Callable[[int], Any],
) -> None:
    bench, drive = configured(make, 3)
    parameters = bench.parameters(3)
    kept = parameters.read()
    bench.reset(drive)
    assert parameters.differences(kept), "the driver stores nothing"
    assert parameters.restore(kept) == []
    bench.reset(drive)
    assert parameters.differences(kept), "restoring alone stores nothing"
    assert parameters.restore(kept) == []
    parameters.store()
    bench.reset(drive)
    assert parameters.differences(kept) == []


VALUES = {
    0x6065: st.integers(0, 2**32 - 1),
    0x6081: st.integers(1, 25_000),
    0x6083: st.integers(1, 2**32 - 1),
    0x6084: st.integers(1, 2**32 - 1),
    0x607C: st.integers(-(2**31), 2**31 - 1),
    0x6098: st.sampled_from([35, 1, 2, 17, 18]),
}


@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(values=st.fixed_dictionaries({}, optional=VALUES))
def test_only_what_differs_is_written(values: dict[int, int]) -> None:
    bench = Bench(Epos2(1))
    parameters = bench.parameters()
    before = parameters.read()
    wanted = {**before, **{f"0x{index:04X}-00": value for index, value in values.items()}}
    bench.sent.clear()
    assert parameters.restore(wanted) == []
    differing = {index for index, value in values.items() if before[f"0x{index:04X}-00"] != value}
    assert {index for index, _ in bench.written()} == differing
    assert parameters.read() == wanted


def test_cob_ids_follow_the_node_id() -> None:
    bench, _ = configured(Epos2, 5)
    values = bench.parameters(5).read()
    assert values["0x1400-01"] == "$NODEID+0x200"
    other = Bench(Epos2(9))
    parameters = other.parameters(9)
    assert parameters.restore(values) == []
    drive = other.bus.drives[0]
    assert drive.dictionary.upload(0x1400, 1) == struct.pack("<I", 0x209)
    assert drive.dictionary.upload(0x1014, 0) == struct.pack("<I", 0x089)


def test_cob_id_of_another_drive_stays() -> None:
    bench = Bench(Epos2(5), Epos2(2))
    values: Values = {"0x1402-01": 0x382}  # the time stamp of node 2
    parameters = bench.parameters(5)
    assert parameters.restore(values) == []
    assert parameters.read()["0x1402-01"] == 0x382


def test_what_the_drive_refuses_is_told_with_its_reason() -> None:
    parameters = Bench(Epos2(1)).parameters()
    left = parameters.restore({"0x6098-00": 99, "0x6065-00": 555})
    assert [difference.parameter.name for difference in left] == ["Homing method"]
    assert "0x6098-00 Homing method: 99 wanted, 7 found (" in str(left[0])
    assert parameters.read()["0x6065-00"] == 555


def test_units_come_before_limits_and_the_mode_last() -> None:
    bench = Bench(Epos2(1))
    wanted: Values = {"0x6060-00": 7, "0x607F-00": 2500, "0x6065-00": 5, "0x608B-00": -1}
    assert bench.parameters().restore(wanted) == []
    assert [index for index, _ in bench.written()] == [0x608B, 0x607F, 0x6065, 0x6060]


def test_object_that_the_drive_lacks_is_a_difference() -> None:
    drive = Epos2(1)
    del drive.dictionary._entries[0x60C5, 0]
    left = Bench(drive).parameters().restore({"0x60C5-00": 5})
    assert str(left[0]).startswith("0x60C5-00 Max acceleration: 5 rpm/s wanted, none found (")


def test_drive_under_power_is_noticed() -> None:
    drive = Epos2(1)
    parameters = Bench(drive).parameters()
    assert not parameters.powered()
    for word, powered in ((0x0121, False), (0x0123, True), (0x0137, True), (0x0108, False)):
        drive.dictionary[0x6041, 0].read = lambda word=word: word  # type: ignore[misc]
        assert parameters.powered() is powered


def test_drive_that_falls_silent_gives_one_line_of_where() -> None:
    drive = Epos2(1)
    bench = Bench(drive)
    parameters = bench.parameters()
    drive.dictionary[0x6083, 0].write = lambda _: drive.disconnect()
    with pytest.raises(DriveError, match="no answer|stopped answering at 0x608"):
        parameters.restore({"0x6083-00": 5, "0x6084-00": 7})
    with pytest.raises(DriveError, match="no answer from node 2"):
        DriveParameters(bench.network, 2)


def test_what_is_no_setting_is_in_no_table() -> None:
    """Commands, set-points, firmware download, memory access, and what would move it on the bus."""
    maxon, copley, nanotec = parameters_of(0xFB), parameters_of(0xAB), parameters_of(0x26C)
    for index in (0x1010, 0x1F50, 0x2005, 0x2009, 0x2300, 0x3203, 0x4000, 0x6040, 0x607A, 0x60FE):
        assert not [address for address in nanotec if address.startswith(f"0x{index:04X}")]
    for index in (0x1010, 0x1011, 0x1013, 0x2000, 0x2001, 0x2026, 0x2FFF, 0x6040, 0x607A, 0x60FF):
        assert not [address for address in maxon if address.startswith(f"0x{index:04X}")]
    for index in (0x1010, 0x2000, 0x2001, 0x2010, 0x2183, 0x21B0, 0x6040, 0x6064, 0x607A, 0x60C1):
        assert not [address for address in copley if address.startswith(f"0x{index:04X}")]
    for address, unit in (("0x6085-00", "rpm/s"), ("0x6410-01", "mA"), ("0x60FB-01", "")):
        assert maxon[address].unit == unit  # quick stop, continuous current, position P-gain
    with pytest.raises(ConfigurationError, match="vendor 0x0000026D are not known"):
        parameters_of(0x26D)


@pytest.mark.parametrize(
    ("vendor", "file", "besides"),
    [
        (0xFB, "epos2_70_10_2126.csv", {0x2070}),
        (0xFB, "epos2_50_5_2120.csv", set()),
        (0xAB, "copley_accelnet_2016.csv", {0x608F, 0x6091, 0x6092}),
        (0x26C, "cl3_fir_v1419.csv", {0x2067, 0x60A8, 0x60A9, 0x60F2}),
    ],
)
def test_the_tables_are_what_the_maker_lets_be_written(
    vendor: int, file: str, besides: set[int]
) -> None:
    """Types, too; `besides` is what other firmware or hardware of the family has."""
    known = {(fact.index, fact.subindex): fact for fact in facts(file, 1)}
    for address, parameter in parameters_of(vendor).items():
        if parameter.is_pdo:
            continue
        fact = known.get((parameter.index, parameter.subindex))
        if fact is None:
            assert parameter.index in besides, address
            continue
        assert fact.access.startswith("rw"), address
        if parameter.type in INTEGERS:
            assert INTEGERS[parameter.type] == (fact.size, fact.signed), address


@pytest.mark.parametrize("firmware", list(Firmware))
def test_every_firmware_of_the_cl3e_can_be_dumped_and_made_alike(firmware: Firmware) -> None:
    drive = Cl3e(4, firmware=firmware)
    parameters = Bench(drive).parameters(4)
    kept = parameters.read()
    assert len(kept) > 150
    for address in ("0x6085-00", "0x608F-01", "0x3202-00", "0x605A-00"):
        changed = {"0x605A-00": 1}.get(address, kept[address] + 1)
        assert parameters.restore({address: changed}) == []
    assert {d.parameter.address for d in parameters.differences(kept)} == {
        "0x6085-00", "0x608F-01", "0x3202-00", "0x605A-00"
    }  # fmt: skip
    assert parameters.restore(kept) == []


# --- files ----------------------------------------------------------------------------------


FILE = """\
drive: {vendor_id: 0xFB, product_code: 0, revision: 0, serial_number: 1, node_id: 3}
parameters:
  0x6065-00: {value: 2000, name: x}
"""


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("parameters:", "things:", "no file of `drive dump`"),
        ("drive:", "- drive", "can't read"),
        ("node_id: 3", "node_id: three", "drive.node_id must be a whole number"),
        ("0x6065-00", "0x6040-00", "0x6040-00 is no stored parameter"),
        ("0x6065-00", "17", "17 is no stored parameter"),
        ("value: 2000", "value: [1]", "0x6065-00 has no value"),
        ("value: 2000", "value: -1", "-1 is no value of type u32"),
        ("value: 2000", "value: many", "'many' is no value of type u32"),
        ("value: 2000", "value: true", "True is no value of type u32"),
        ("0xFB", "0x1234", "vendor 0x00001234 are not known"),
    ],
)
def test_wrong_file_gets_one_line(old: str, new: str, says: str, tmp_path: Path) -> None:
    file = tmp_path / "drive.yaml"
    file.write_text(FILE.replace(old, new))
    with pytest.raises(ConfigurationError) as refusal:
        read_drive_file(file)
    assert says in str(refusal.value) and "\n" not in str(refusal.value)


@given(text=st.text(max_size=20), data=st.binary(max_size=12))
def test_strings_and_bytes_come_back_from_a_file(text: str, data: bytes) -> None:
    table = parameters_of(0xAB)
    name, output = table["0x21A0-00"], table["0x2193-01"]
    kept = text.encode("latin-1", "ignore").rstrip(b"\0")
    values: Values = {p.address: p.decode(d, 1) for p, d in ((name, kept), (output, data))}
    identity = DriveFile(Bench(Copley(1)).parameters().identity, 1, values)
    read = yaml.safe_load(to_yaml(identity))["parameters"]
    assert name.encode(read["0x21A0-00"]["value"], 1) == kept
    assert output.encode(read["0x2193-01"]["value"], 1) == data


# --- the program ----------------------------------------------------------------------------


def test_program_dumps_compares_and_restores(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """On the simulated drives of a parameter file, which are new at each call."""
    assert main(["dump", "1", "--params", GANTRY]) == 0
    text = capsys.readouterr().out
    assert yaml.safe_load(text)["drive"]["maker"] == "maxon"
    line = next(line for line in text.splitlines() if "0x6065-00" in line)
    assert "value: 2000" in line and 'unit: "qc"' in line and '"Max following error"' in line
    file = tmp_path / "drive.yaml"
    file.write_text(text, encoding="utf-8")
    assert main(["diff", str(file), "gantry_x", "--params", GANTRY]) == 0
    file.write_text(text.replace("value: 2000", "value: 1999"), encoding="utf-8")
    capsys.readouterr()
    assert main(["diff", str(file), "1", "--params", GANTRY]) == 1
    assert "0x6065-00 Max following error: 1999 qc wanted, 2000 qc found" in capsys.readouterr().out

    for answer, status, says in (("y\n", 0, "1 written, and read back"), ("\n", 1, "was changed")):
        monkeypatch.setattr("builtins.input", lambda prompt, answer=answer: answer)
        assert main(["restore", str(file), "1", "--params", GANTRY]) == status
        assert says in capsys.readouterr().out


def test_drive_behind_a_serial_adapter(capsys: pytest.CaptureFixture[str]) -> None:
    with SlcanAdapter(1_000_000) as adapter:
        simulator = RealtimeSimulator(adapter, build_copley_drives([5]))
        simulator.start()
        try:
            assert main(["dump", "5", "--interface", "slcan", "--channel", adapter.path]) == 0
        finally:
            simulator.stop()
    assert yaml.safe_load(capsys.readouterr().out)["drive"]["maker"] == "Copley"


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["dump", "shoulder", "--params", GANTRY], "one of gantry_x, gantry_y"),
        (["dump", "shoulder"], "joints need --params"),
        (["dump", "128", "--params", GANTRY], "must be from 1 to 127"),
        (["diff", "missing.yaml", "1", "--params", GANTRY], "can't read missing.yaml"),
        (["dump", "9", "--params", GANTRY], "no answer from node 9"),
    ],
)
def test_what_can_not_be_gets_one_line(
    arguments: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 2
    output, error = capsys.readouterr()
    assert output == "" and error.count("\n") == 1
    assert error.startswith("epos2_ros drive: ") and says in error
