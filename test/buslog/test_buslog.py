"""The log of a bus: what python-can reads of it, that it stays bounded and holds nobody up."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import can
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shipped import PARAMETER_FILES
from simulated_time import axes

from epos2_ros.bus.driver import Driver
from epos2_ros.buslog import asc, inputs, plain, writer
from epos2_ros.buslog.writer import LogWriter
from epos2_ros.configuration.driver import DriverConfig, HomingConfig
from epos2_ros.configuration.files import read_parameters
from epos2_ros.configuration.parameters import DriverParameters
from epos2_ros.errors import ConfigurationError
from epos2_ros.protocol.group import Group
from epos2_ros.protocol.machine import Machine
from epos2_ros.protocol.outbox import Outbox
from epos2_ros.protocol.path import PathCommander
from epos2_ros.sim import main as simulator

BEGIN_US = 5e9
WALL_OFFSET_US = BEGIN_US - 1.7e15  # the log begins at 1,700,000,000 s since 1970


def opened(file: Path, size_bytes: int = 10_000_000, **options) -> LogWriter:
    return LogWriter(file, size_bytes, BEGIN_US, lambda: WALL_OFFSET_US, **options)


def events(file: Path) -> list[asc.EventLine]:
    lines = map(asc.parse, file.read_text(encoding="utf-8").splitlines())
    return [line for line in lines if isinstance(line, asc.EventLine)]


@settings(max_examples=25, deadline=None)
@given(
    frames=st.lists(
        st.tuples(
            st.integers(0, 10**9), st.integers(0, 0x7FF), st.binary(max_size=8), st.booleans()
        ),
        max_size=30,
    )
)
def test_python_can_reads_every_frame_and_trips_over_no_event(frames, tmp_path_factory):
    file = tmp_path_factory.mktemp("log") / "run.asc"
    log = opened(file, preamble=(("configuration", {"axes": ["größe"]}),))
    for t_us, can_id, data, sent in frames:
        log.frame(BEGIN_US + t_us, can_id, data, sent)
        log.event(BEGIN_US + t_us, "warning", "1.0 1  201 Rx d 8 // no frame")
    log.other(BEGIN_US, "error", 0x24, b"\x00" * 8)
    log.other(BEGIN_US, "extended", 0x12345678, b"\x01")
    log.other(BEGIN_US, "remote", 0x701, b"")
    log.close()
    *messages, error, extended, remote = can.LogReader(file)
    assert [(m.arbitration_id, bytes(m.data), not m.is_rx) for m in messages] == [
        frame[1:] for frame in frames
    ]
    for message, (t_us, *_) in zip(messages, frames, strict=True):
        assert message.timestamp == pytest.approx(t_us / 1e6, abs=1e-6)
    assert error.is_error_frame
    assert extended.is_extended_id and extended.arbitration_id == 0x12345678
    assert remote.is_remote_frame and remote.arbitration_id == 0x701
    # And we read what python-can reads.
    parsed = [asc.parse(line) for line in file.read_text(encoding="utf-8").splitlines()]
    ours = [line for line in parsed if isinstance(line, asc.FrameLine)]
    assert [(f.can_id, f.data, f.sent) for f in ours[:-3]] == [frame[1:] for frame in frames]
    assert [f.kind for f in ours[-3:]] == ["error", "extended", "remote"]


def test_monotonic_and_wall_time_can_be_had_from_it(tmp_path):
    log = opened(tmp_path / "run.asc")
    log.frame(BEGIN_US + 12.5e6, 0x80, b"", True)
    log.close()
    begin, clocks = events(tmp_path / "run.asc")
    assert begin.data["host_us"] == BEGIN_US
    assert begin.data["wall_s"] == 1_700_000_000
    assert (clocks.name, clocks.data) == ("clocks", {"wall_offset_us": WALL_OFFSET_US})
    (frame,) = can.ASCReader(tmp_path / "run.asc", relative_timestamp=False)
    assert frame.timestamp == pytest.approx(1_700_000_012.5, abs=1e-3)


def test_files_rotate_within_the_size_and_each_can_be_read_by_itself(tmp_path):
    file, size = tmp_path / "run.asc", 200_000
    preamble = (("configuration", {"some": "thing"}),)
    file.write_text("of an earlier run\n")
    log = opened(file, size, preamble=preamble)
    assert (tmp_path / "run.1.asc").read_text() == "of an earlier run\n"
    for n in range(9_000):
        log.frame(BEGIN_US + n, 0x181, n.to_bytes(4, "big"), False)
    log.close()
    files = [file, *writer.earlier_files(file)]
    assert len(files) > 4
    assert sum(path.stat().st_size for path in files) <= size
    assert set(tmp_path.iterdir()) == set(files)
    numbers = []
    for path in reversed(files):
        about, configuration = events(path)[:2]
        assert about.name == "log" and configuration.data == {"some": "thing"}
        numbers += [int.from_bytes(m.data, "big") for m in can.LogReader(path)]
    assert numbers == list(range(numbers[0], 9_000))  # the newest, without a gap


def test_what_the_disk_does_not_take_in_time_is_dropped_counted_and_said(tmp_path, monkeypatch):
    monkeypatch.setattr(writer, "QUEUE_ENTRIES", 10)
    monkeypatch.setattr(writer, "FLUSH_S", 60.0)
    said: list[str] = []
    log = opened(tmp_path / "run.asc", on_problem=said.append)
    for n in range(25):
        log.frame(BEGIN_US + n, 0x181, bytes([n]), False)
    log.close()
    assert [m.data[0] for m in can.LogReader(tmp_path / "run.asc")] == list(range(10))
    assert events(tmp_path / "run.asc")[-1][1:] == ("dropped", {"entries": 15})
    assert len(said) == 1 and "dropped" in said[0]


def test_a_disk_that_fills_up_ends_the_log_and_nothing_else(tmp_path, monkeypatch):
    said: list[str] = []
    log = opened(tmp_path / "run.asc", on_problem=said.append)
    with Path("/dev/full").open("wb", buffering=0) as full:
        log._out = full
        for n in range(3):
            log.frame(BEGIN_US + n, 0x181, b"", False)
        log.close()
        log.frame(BEGIN_US, 0x181, b"", False)
    assert len(said) == 1 and said[0].endswith("No space left on device; it ends here")


@pytest.mark.parametrize(
    ("name", "problem"),
    [
        ("there/is/no/such/folder.asc", "can't be written: No such file or directory"),
        ("run.txt", "must end in .asc"),
        ("folder.asc", "can't be written: Is a directory"),
    ],
)
def test_a_file_that_cannot_be_written_is_one_line_before_anything_happens(tmp_path, name, problem):
    (tmp_path / "folder.asc").mkdir()
    file = tmp_path / name
    config = DriverConfig(axes=axes(1), interface="none", log_file=str(file))
    with pytest.raises(ConfigurationError) as caught:
        Driver(config).configure()  # there is no such interface; it isn't even tried
    assert str(caught.value).startswith(f"log.file is '{file}'")
    assert problem in str(caught.value)


def test_the_simulator_says_so_too(tmp_path, capsys):
    file = tmp_path / "no" / "run.asc"
    assert simulator.main(["--slcan", "--bus-log", str(file)]) == 2
    line = capsys.readouterr().err
    assert line == (
        f"epos2_ros simulator: --bus-log is '{file}', which can't be written: "
        "No such file or directory\n"
    )


@pytest.mark.parametrize("file", PARAMETER_FILES, ids=lambda file: file.stem)
def test_a_configuration_comes_back_from_json(file):
    config = DriverParameters(read_parameters(file)).config()
    homing = HomingConfig("negative_limit_switch", (0.02, 0.005), order=2)
    homed = replace(config.axes[0], homing=homing)
    for made in (config, replace(config, axes=(homed, *config.axes[1:]))):
        unknown: list[str] = []
        text = json.dumps(plain.to_plain(made))
        assert plain.from_plain(DriverConfig, json.loads(text), unknown) == made
        assert not unknown


def test_a_configuration_of_another_version_has_defaults_and_unknown_names():
    unknown: list[str] = []
    old = {"axes": [{"joint": "x", "node_id": 3, "colour": "red"}], "sync_period": 1}
    config = plain.from_plain(DriverConfig, old, unknown)
    assert (config.axes[0].node_id, config.axes[0].gear_ratio, config.sync_period) == (3, 1.0, 1.0)
    assert unknown == ["colour"]
    for wrong in ({"axes": 3}, {"axes": [{"joint": "x"}]}, [], {"axes": [{"node_id": "x"}]}):
        with pytest.raises((TypeError, ValueError)):
            plain.from_plain(DriverConfig, wrong, [])


@pytest.mark.parametrize(
    "line",
    [
        "0.5 1  181 Rx   d 8 00 01",
        "0.5 1  181 Rx   d 2 GG 01",
        "no frame at all",
        '// @1.5 fault {"text":',
        "\x00\x01",
    ],
)
def test_garbage_is_a_value_error(line):
    with pytest.raises(ValueError):
        asc.parse(line)


INPUTS = {
    Machine: {"receive", "advance", "move_to", "home"},
    Group: {*inputs.REQUESTS, *inputs.REPORTS},
    PathCommander: {*inputs.TRAJECTORIES, *inputs.STOPS},
    Outbox: {"answer"},
}
OTHERS = {  # they change nothing, or are called by what is in the log
    Machine: {"deadline_us", "home_limit_s", "homing_orders"},
    Group: {
        *("receive", "advance", "begin", "cancel", "give_up", "go_on"),
        *("describe_phase", "lost", "moving", "silent", "standing"),
    },
    PathCommander: {"advance", "cancel", "disable", "submit"},
    Outbox: {"announce", "ask", "forget", "unanswered"},
}


@pytest.mark.parametrize("kind", [Machine, Group, PathCommander, Outbox])
def test_whatever_reaches_the_protocol_from_outside_is_in_the_log(kind):
    """A new method belongs into the log's inputs, or among those that need not be there."""
    methods = {n for n, made in vars(kind).items() if callable(made) or isinstance(made, property)}
    public = {name for name in methods if not name.startswith("_")}
    assert public == INPUTS[kind] | OTHERS[kind]
