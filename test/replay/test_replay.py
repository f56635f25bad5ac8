"""A log tells what happened: every kind of fault by name, and nothing that didn't happen.

The logs are made with simulated drives in simulated time; what is to be found in them is what was
done to the drives.
"""

from __future__ import annotations

import gzip
import json
import math
import os
import random
import re
import struct
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import can
import numpy as np
import pytest
from recorded import Recorded, few
from simulated_time import axes, move_on
from two_processes import TARGET_M, Drives, rig

from epos2_ros.buslog import inputs
from epos2_ros.buslog.writer import earlier_files
from epos2_ros.configuration.driver import DriverConfig
from epos2_ros.errors import DriveError, TrajectoryError
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.protocol.execution import Execution
from epos2_ros.protocol.phase import Phase
from epos2_ros.replay import program
from epos2_ros.sim.copley import Copley
from epos2_ros.sim.epos2 import Dictionary, Epos2

QC_PER_RAD = 2000 * 100 / (2 * math.pi)
AXES = 3


def there_and_back(duration_s: float = 4.0, reach: float = 0.2) -> Trajectory:
    names = tuple(axis.joint for axis in axes(AXES))
    way = np.array([[0.0] * AXES, [reach, reach / 2, -reach / 3], [0.0] * AXES])
    times_s = np.array([0.0, duration_s / 2, duration_s])
    return Trajectory(names, times_s, way, np.zeros_like(way), np.zeros_like(way))


class Replayed(NamedTuple):
    """What the program said."""

    lines: list[tuple[float, str]]  # time, and the rest of the line
    last: list[str]  # after the timeline
    text: str

    def at(self, pattern: str) -> float:
        """The time of the first line that matches."""
        return next(t_s for t_s, text in self.lines if re.search(pattern, text))

    def count(self, pattern: str) -> int:
        return sum(bool(re.search(pattern, text)) for _, text in self.lines)


@pytest.fixture
def replay(capsys: pytest.CaptureFixture[str]) -> Callable[..., Replayed]:
    def run(*arguments: object) -> Replayed:
        status = program.main([str(argument) for argument in arguments])
        said = capsys.readouterr()
        assert status == 0, said.err
        timed, last = [], []
        for line in said.out.splitlines()[3:]:
            if match := re.match(r" *(\d+\.\d{6})  (.*)", line):
                timed.append((float(match[1]), match[2]))
            else:
                last.append(line)
        return Replayed(timed, last, said.out)

    return run


def moving(file: Path, config: DriverConfig | None = None, drives=None, after_s: float = 1.0):
    """A bench with its axes in motion."""
    made = Recorded(file, config or few(AXES), drives)
    made.enable()
    made.path.submit(there_and_back(), None, made.now_us)
    made.run(after_s)
    return made


# ---------------------------------------------------------------------------- faults


def following_error(made: Recorded) -> None:
    made.drives[1].fail(0x8611, made.now_us)


def limit_switch(made: Recorded) -> None:
    made.drives[2].fail(0xFF07, made.now_us)


def over_voltage(made: Recorded) -> None:
    made.drives[0].fail(0x3210, made.now_us)


def over_temperature(made: Recorded) -> None:
    made.drives[0].fail(0x4210, made.now_us)


def stall(made: Recorded, seconds: float) -> None:
    """The host's threads stand; afterwards they find what has come meanwhile."""
    came: list[tuple] = []
    made.bus.run_until(made.now_us + 1e6 * seconds, lambda *frame: came.append(frame))
    for frame in came:
        made._on_frame(*frame)


def host_stalls(made: Recorded) -> None:
    stall(made, 0.9)  # longer than drives wait for the heartbeat of a host


def drive_goes_silent(made: Recorded) -> None:
    made.drives[1].disconnect()


def drive_restarts(made: Recorded) -> None:
    made.drives[1].power_off()
    made.drives[1].power_on(made.now_us)


def drive_misses_a_record(made: Recorded) -> None:
    drive, missed = made.drives[1], []
    take = drive.receive

    def receive(can_id: int, data: bytes, t_us: float, remote: bool = False) -> bool:
        if can_id == 0x202 and not missed:
            missed.append(data)
            return True
        return take(can_id, data, t_us, remote)

    drive.receive = receive  # type: ignore[method-assign]


def bus_goes_off(made: Recorded) -> None:
    made.run(0.003)  # nothing is on its way
    made.group.bus_failed("socketcan:can0 is bus off: check cable, termination and can.bitrate")
    made.transmitter.push = lambda frame: None  # as the link, which sends nothing any more


def bus_gets_disturbed(made: Recorded) -> None:
    made.group.fail("socketcan:can0 is error passive: frames are disturbed")


FAULTS = [
    (following_error, r"joint_2 \(node 2\): following error \(0x8611\)"),
    (limit_switch, r"joint_3 \(node 3\): positive limit switch \(0xFF07\)"),
    (over_voltage, r"joint_1 \(node 1\): over-voltage \(0x3210\)"),
    (over_temperature, r"joint_1 \(node 1\): over-temperature \(0x4210\)"),
    (host_stalls, r"life guard or heartbeat error: the host was not heard \(0x8130\)"),
    (drive_goes_silent, r"joint_2 \(node 2\) is silent"),
    (drive_restarts, r"joint_2 \(node 2\) has restarted"),
    (drive_misses_a_record, r"joint_2 \(node 2\)"),
    (bus_goes_off, r"socketcan:can0 is bus off"),
    (bus_gets_disturbed, r"socketcan:can0 is error passive"),
]


@pytest.mark.parametrize(("fail", "cause"), FAULTS, ids=[fail.__name__ for fail, _ in FAULTS])
def test_the_fault_is_named_and_when_it_was(fail, cause, tmp_path, replay):
    made = moving(tmp_path / "run.asc")
    failed_s = made.now_us / 1e6
    fail(made)
    made.run(6.0, lambda: made.group.phase is Phase.FAULT)
    made.run(0.3)
    made.close()
    said = replay(tmp_path / "run.asc", "--brief")
    assert failed_s <= said.at(rf"FAULT: .*{cause}") < failed_s + 5.0
    assert said.count("aborted: ") == 1
    assert not said.count("≠"), "what the same code does is what it did"
    (verdict,) = [line for line in said.last if "frames that the driver sent" in line]
    sent = sum(echo and f.can_id & 0x780 != 0x600 and f.can_id != 0 for _, f, echo in made.frames)
    assert verdict == f"all {sent} frames that the driver sent are what it would send now"


def test_what_the_drive_itself_said_is_told_with_its_state_walk(tmp_path, replay):
    made = moving(tmp_path / "run.asc")
    failed_s = made.now_us / 1e6
    following_error(made)
    made.run(1.0)
    made.close()
    said = replay(tmp_path / "run.asc", "--axis", "joint_2", "--from", failed_s)
    assert said.at(r"joint_2 .*emergency: following error \(0x8611\)") < failed_s + 0.01
    assert said.count("operation enabled → fault") == 1
    assert said.count("joint_2 .*motion: .*without its end record") == 1
    assert not said.count("joint_1 .*state") and all(t_s >= failed_s for t_s, _ in said.lines)


def test_a_host_that_is_not_heard_is_what_the_drives_complain_of(tmp_path, replay):
    made = moving(tmp_path / "run.asc", few(AXES, buffer_time=3.0))
    stall(made, 0.7)  # the drives watch for half a second, and hold 3 s of motion
    made.run(4.0)
    made.close()
    said = replay(tmp_path / "run.asc")
    assert said.count(r"FAULT: .*heartbeat error: the host was not heard \(0x8130\)")
    assert said.count(r"emergency: .*not heard \(0x8130\)") == AXES


def test_a_drive_that_does_not_start_is_named(tmp_path, replay):
    class Deaf(Epos2):
        def receive(self, can_id, data, t_us, remote=False):
            return can_id != 0x302 and super().receive(can_id, data, t_us, remote)

    drives = [(Deaf if n == 2 else Epos2)(n, drift_ppm=10.0 * n) for n in range(1, AXES + 1)]
    made = moving(tmp_path / "run.asc", drives=drives)
    made.close()
    said = replay(tmp_path / "run.asc")
    assert said.count(r"FAULT: joint_2 \(node 2\): ") == 1
    active = [text for _, text in said.lines if text.endswith("ip mode active")]
    assert sorted(text.split()[0] for text in active) == ["joint_1", "joint_3"]
    assert not said.count("≠")


def test_a_bring_up_that_fails_is_told_to_the_last_access(tmp_path, replay):
    drives = [Epos2(1), Epos2(3)]
    with pytest.raises(DriveError):
        Recorded(tmp_path / "run.asc", few(AXES), drives)
    said = replay(tmp_path / "run.asc")
    assert said.count(r"configure failed: no answer from joint_2 \(node 2\)") == 1
    asked = r"joint_2 .*SDO: read Device Type \(0x1000-00\): "
    assert said.count(f"{asked}(no answer|aborted by the host)") == 1


# ---------------------------------------------------------------------------- what went well


def test_a_run_from_bring_up_to_the_end_in_words(tmp_path, replay):
    made = moving(tmp_path / "run.asc")
    made.wait(made.group.motion)
    started_s = made.machine.path_time.start_us / 1e6
    made.wait(made.group.disable())
    made.close()
    said = replay(tmp_path / "run.asc")
    assert said.at("the start SYNC, path time zero of joint_1") == pytest.approx(
        started_s, abs=1e-6
    )
    for n in range(1, AXES + 1):
        own = [text for _, text in said.lines if text.startswith(f"joint_{n} (node {n})")]
        states = [match[1] for text in own if (match := re.search(r"state: .*→ (.*) \(", text))]
        walk = [state for state in states if state != "switched on"]  # which may be too short
        assert walk == ["ready to switch on", "operation enabled", "ready to switch on"]
        (summary,) = [text for text in own if "motion: " in text]
        records = [f for _, f, echo in made.frames if echo and f.can_id == 0x200 + n]
        duration_s = sum(f.data[7] for f in records) / 1000
        assert f"motion: {len(records)} records for {duration_s:.3f} s" in summary
        off_qc = float(re.search(r"demand at most ([\d.]+) qc off", summary)[1])
        assert off_qc <= 1.0  # the demand is an integer
    asked = [text.strip() for _, text in said.lines if re.search("asked|: done|trajectory", text)]
    assert asked == [
        "asked to enable",
        "enable: done",
        "trajectory of 3 points over 4 s for joint_1, joint_2, joint_3, at once",
        "asked to disable",
        "disable: done",
    ]
    assert said.count("done: all axes have arrived") == 1
    assert not said.count("≠|FAULT|emergency|aborted")
    assert not said.count("read .*0x1013|read .*0x60C4")  # over and over


def test_take_overs_stops_and_later_trajectories_are_run_again_the_same(tmp_path, replay):
    made = moving(tmp_path / "run.asc")
    names = there_and_back().joint_names
    made.path.submit(
        Trajectory(names, np.array([1.5]), np.array([[0.05] * AXES])), None, made.now_us
    )
    made.run(0.5)
    made.path.stop()
    made.wait(made.group.motion)
    made.wait(made.group.halt())
    made.wait(made.group.quick_stop())
    made.wait(made.group.enable())
    made.close()
    said = replay(tmp_path / "run.asc", "--brief")
    assert said.count("asked to stop on the path") == said.count("quick stop: done") == 1
    assert not said.count("≠")


def test_moves_and_trajectories_of_copley_axes_are_run_again_the_same(tmp_path, replay):
    first, second = axes(2)
    limits = {"max_velocity": 2.0, "max_acceleration": 4.0}
    config = DriverConfig(axes=(first, replace(second, drive="copley", **limits)))
    drives = [Epos2(1, drift_ppm=20.0), Copley(2)]
    made = Recorded(tmp_path / "run.asc", config, drives)
    made.enable()
    made.wait(made.machine.move_to({"joint_2": 0.3}))
    made.machine.move_to({"joint_2": -0.3})
    made.run(0.3)
    made.wait(made.group.halt())
    move_on(made)
    made.close()
    said = replay(tmp_path / "run.asc")
    assert said.count("asked to move joint_2 to 0.3") == 1
    assert said.count("started on one SYNC") == 3
    assert said.count("joint_2 .*state: .* → operation enabled") == 1
    assert said.count("joint_2 .*controlword .*new set-point") >= 2
    assert said.count("halt: done") == 1
    assert not said.count("≠|FAULT")


def test_how_far_the_clocks_are_off_is_seen(tmp_path, replay):
    drives = [Epos2(n, drift_ppm=ppm) for n, ppm in ((1, 0.0), (2, 400.0), (3, 0.0))]
    made = moving(tmp_path / "run.asc", drives=drives)
    made.wait(made.group.motion)
    made.close()
    said = replay(tmp_path / "run.asc")
    motions = sorted(text for _, text in said.lines if "motion: " in text)
    off_us = [float(re.search(r"clock up to (\d+) us off the others'", t)[1]) for t in motions]
    # Between two SYNCs 400 ppm are 40 us, of which half is given in advance.
    assert off_us[0] <= 2 and 15 <= off_us[1] <= 25 and off_us[2] <= 2


def test_the_drawing_shows_every_axis(tmp_path, replay):
    made = moving(tmp_path / "run.asc")
    following_error(made)
    made.run(1.0)
    made.close()
    replay(tmp_path / "run.asc", "--output", tmp_path / "run.svg")
    assert (tmp_path / "run.svg").stat().st_size > 20_000
    replay(tmp_path / "run.asc", "--axis", "joint_3", "--output", tmp_path / "one.png")
    assert (tmp_path / "one.png").read_bytes().startswith(b"\x89PNG")


def test_the_driver_itself_on_an_adapter_that_is_pulled_out(tmp_path, replay):
    """In real time, without echoes; the drives' process is killed with its log open."""
    drives = Drives(
        "--slcan",
        *("--nodes", "1-2"),
        *("--bus-log", str(tmp_path / "drives.asc")),
        log=tmp_path / "log.npz",
    )
    channel = drives.says.split()[-1]
    try:
        with rig("slcan", channel, log_file=str(tmp_path / "run.asc")) as made:
            made.go_to(TARGET_M)
            drives.kill()
            made.wait(lambda snapshot: snapshot.state == "fault")
    finally:
        drives.kill()
    said = replay(tmp_path / "run.asc")
    assert said.count("done: all axes have arrived") == 1
    assert said.count(f"FAULT: slcan:{channel} ") == 1
    assert not said.count("≠")
    theirs = replay(tmp_path / "drives.asc")
    assert theirs.count("node 1 .*state: .* → operation enabled") == 1
    assert theirs.count("node 2 .*end record, after") == 1


@pytest.mark.parametrize("seed", range(int(os.environ.get("REPLAY_RUNS", "6"))))
def test_whatever_was_asked_in_whatever_phase_is_run_again_the_same(seed, tmp_path, replay):
    """REPLAY_RUNS=200 for a campaign."""
    rng = random.Random(seed)
    source = rng.choice(["host", "host", "joint_2"])
    dictionary = Dictionary.MAKER if source == "host" else Dictionary.NOTE
    drives = [Epos2(n, drift_ppm=30.0 * n, dictionary=dictionary) for n in (1, 2, 3)]
    made = Recorded(tmp_path / "run.asc", few(AXES, sync_source=source), drives)
    made.late_us = lambda: rng.choice([0.0, 300.0, 5_000.0, 60_000.0]) * rng.random()
    names = there_and_back().joint_names

    def submit() -> None:
        target = np.array([[rng.uniform(-0.1, 0.1) for _ in names]])
        stamp_us = rng.choice([None, None, made.now_us + rng.uniform(-1e6, 3e5)])
        trajectory = Trajectory(names, np.array([rng.uniform(0.2, 2.0)]), target)
        executions.append(made.path.submit(trajectory, stamp_us, made.now_us))

    executions: list[Execution] = []
    actions = {
        submit: 8,
        lambda: executions and made.path.cancel(rng.choice(executions[-3:]), "cancelled"): 2,
        made.path.disable: 1,
        made.group.enable: 6,
        made.path.stop: 2,
        made.group.halt: 2,
        made.group.quick_stop: 1,
        made.group.disable: 1,
        made.group.reset_fault: 3,
        lambda: rng.choice(made.drives).fail(rng.choice([0x8611, 0x3210]), made.now_us): 1,
        lambda: made.group.fail("can0 is error passive"): 1,
    }
    made.enable()
    for action in rng.choices(list(actions), list(actions.values()), k=25):
        with suppress(TrajectoryError):
            action()
        made.run(rng.choice([0.0, 0.001, 0.05, 0.4, 1.5]) * rng.random())
    made.run(0.5)
    made.close()
    said = replay(tmp_path / "run.asc", "--brief")
    assert [text for _, text in said.lines if "≠" in text] == []
    assert said.count("asked to") >= 5


# ---------------------------------------------------------------------------- differences


def test_a_record_that_is_not_what_the_driver_would_send_is_told_once(tmp_path, replay):
    made = moving(tmp_path / "run.asc")
    made.wait(made.group.motion)
    made.close()
    lines = (tmp_path / "run.asc").read_text().splitlines(keepends=True)
    place = [n for n, line in enumerate(lines) if re.search(r" 202 +Tx", line)][6]
    *head, data = re.fullmatch(r"(.* d 8) (.*)\n", lines[place]).groups()
    position, *rest = struct.unpack("<iI", bytes.fromhex(data))
    moved = struct.pack("<iI", position + 7, *rest).hex(" ").upper()
    lines[place] = f"{head[0]} {moved}\n"
    (tmp_path / "other.asc").write_text("".join(lines))
    said = replay(tmp_path / "other.asc")
    (line,) = [text for _, text in said.lines if "≠" in text]
    assert f"joint_2 (node 2)  ≠ record to {position + 7} qc" in line
    assert f"it would be record to {position} qc" in line
    assert any("1 are not what it would send now: 1 × record" in line for line in said.last)


def test_a_record_that_was_never_on_the_bus_is_told_and_no_other(tmp_path, replay):
    made = moving(tmp_path / "run.asc")
    lost: list[bytes] = []

    def drop(can_id: int, data: bytes, source: object) -> bool:
        if can_id == 0x202 and not lost:
            lost.append(data)
            return True
        return False

    made.bus.drop = drop
    made.run(4.0)
    made.close()
    said = replay(tmp_path / "run.asc")
    (line,) = [text for _, text in said.lines if "≠" in text]
    position = int.from_bytes(lost[0][:4], "little", signed=True)
    assert f"joint_2 (node 2)  ≠ record to {position} qc" in line and "not on the bus" in line


def test_a_trajectory_that_would_be_refused_is_told(tmp_path, replay):
    made = moving(tmp_path / "run.asc")
    made.close()
    text = (tmp_path / "run.asc").read_text()
    slow = text.replace('"max_velocity": null', '"max_velocity": 0.01')
    (tmp_path / "other.asc").write_text(slow)
    said = replay(tmp_path / "other.asc")
    assert said.count("≠ the trajectory would be refused: .*velocity -?0.1875 rad/s .*allowed") == 1


def test_a_log_of_another_version_says_so(whole, tmp_path, replay):
    text = re.sub(r'"version": \d+', '"version": 1', whole.read_text())
    (tmp_path / "old.asc").write_text(text)
    said = replay(tmp_path / "old.asc", "--brief")
    assert said.last[-1].startswith("note: old.asc has events of another version (1, here ")


def test_a_driver_that_is_told_otherwise_differs_in_its_records_alone(tmp_path, replay):
    made = moving(tmp_path / "run.asc")
    made.wait(made.group.motion)
    made.close()
    text = (tmp_path / "run.asc").read_text().replace('"tolerance": 1.0', '"tolerance": 40.0')
    (tmp_path / "other.asc").write_text(text)
    said = replay(tmp_path / "other.asc")
    assert {text.split("≠ ")[1].split()[0] for _, text in said.lines if "≠" in text} >= {"record"}
    assert any("not what it would send now" in line for line in said.last)
    assert said.count("done: all axes have arrived") >= 1


def test_a_log_that_has_lost_its_beginning_is_entered_where_the_axes_stand(
    tmp_path, replay, monkeypatch
):
    monkeypatch.setattr(inputs, "STATE_US", 2e6)
    made = Recorded(tmp_path / "run.asc", few(AXES, log_size=1.0))
    made.enable()
    made.run(3.0)  # so that the last part but one begins well before the last motion
    for _ in range(2):
        made.path.submit(there_and_back(), None, made.now_us)
        made.wait(made.group.motion)
        made.run(4.0)
    made.path.submit(there_and_back(), None, made.now_us)
    made.run(3.0)
    following_error(made)
    made.run(1.0)
    made.close()
    files = [tmp_path / "run.asc", *earlier_files(tmp_path / "run.asc")]
    assert len(files) >= 4
    whole = replay(tmp_path / "run.asc", "--brief")
    assert not whole.count("≠")
    for file in files:
        file.with_name(f"{file.name}.gz").write_bytes(gzip.compress(file.read_bytes()))
    assert replay(tmp_path / "run.asc.gz", "--brief").lines == whole.lines
    for keep in (len(files) - 1, 2):
        for gone in files[keep:]:
            gone.unlink(missing_ok=True)  # the oldest are deleted first
        said = replay(tmp_path / "run.asc", "--brief")
        assert said.count("from here on the protocol is run over the log; group: standing") == 1
        assert not said.count("≠")
        assert said.count(r"FAULT: .*following error \(0x8611\)") == 1
        (verdict,) = [line for line in said.last if "that the driver sent" in line]
        assert re.match(r"all \d{3,} frames that the driver sent are what it would send", verdict)
        part = len(files) - keep + 1
        assert said.last[-1].startswith(f"note: run.{keep - 1}.asc is part {part} of a log")


# ---------------------------------------------------------------------------- other logs


def test_a_log_of_candump_and_others_gives_the_timeline_too(tmp_path, replay):
    made = moving(tmp_path / "run.asc")
    following_error(made)
    made.run(1.0)
    made.close()
    for suffix in (".log", ".blf", ".trc"):
        other = tmp_path / f"candump{suffix}"
        with can.Logger(other) as logger:
            for message in can.LogReader(tmp_path / "run.asc"):
                message.timestamp += 1.7e9
                logger.on_message_received(message)
        said = replay(other)
        assert said.count(r"node 2 .*emergency: following error \(0x8611\)") == 1, suffix
        assert said.count("node 1 .*SDO: read Device Type") == 1
        assert said.count("the start SYNC, path time zero of node 1, node 2, node 3") == 1
        assert said.count("node 1 .*motion: .* in the buffer") == 1
        assert "the protocol is not run over it" in said.text


def test_segmented_transfers_and_aborts_are_followed(tmp_path, replay):
    lines = [
        "(0.1) can0 602#4008100000000000",  # Manufacturer Device Name: 8 bytes in two segments
        "(0.2) can0 582#4108100008000000",
        "(0.3) can0 602#6000000000000000",
        "(0.4) can0 582#0045504F53322D37",
        "(0.5) can0 602#7000000000000000",
        "(0.6) can0 582#1D30000000000000",
        "(0.7) can0 602#230016012002C460",  # mapping 0x60C4-02
        "(0.8) can0 582#8000160141000406",
        "(0.9) can0 602#40FF1F0000000000",
        "(1.0) can0 000#8102",
    ]
    (tmp_path / "some.log").write_text("\n".join(lines) + "\n")
    said = replay(tmp_path / "some.log")
    assert said.count(r"read Manufacturer Device Name \(0x1008-00\) = 'EPOS2-70'") == 1
    assert said.count(
        r"write Mapped Object 1 .*\(0x1600-01\) = .*Actual buffer size \(0x60C4-02\), 32 bits: "
        r"aborted by the drive, code 06040041h: Object cannot be mapped to the PDO"
    )
    assert said.count(r"read 0x1FFF-00: no answer") == 1
    assert said.count("NMT: reset node, node 2") == 1


def test_answers_that_stand_before_their_requests_and_block_transfers(tmp_path, replay):
    lines = [
        "(0.1) can0 582#4B41600037070000",  # Statusword 0737h, before it was asked for
        "(0.1) can0 602#4041600000000000",
        "(0.2) can0 602#4140600000000000",
        "(0.3) can0 602#C6C1200080000000",  # block download of 0x20C1
        "(0.4) can0 582#A4C1200010000000",
        "(0.5) can0 602#8123456789ABCDEF",
        "(0.6) can0 582#A201100000000000",
        "(0.7) can0 602#C100000000000000",
        "(0.8) can0 582#A100000000000000",
        "(0.9) can0 602#2F60600007000000",
        "(1.0) can0 582#6060600000000000",
    ]
    (tmp_path / "some.log").write_text("\n".join(lines) + "\n")
    said = replay(tmp_path / "some.log")
    assert [text.split("SDO: ")[1] for _, text in said.lines if "SDO: " in text] == [
        "read Statusword (0x6041-00) = 0737h, operation enabled",
        "read Controlword (0x6040-00): no answer",
        "write Interpolation data record (0x20C1-00), a block transfer",
        "write Modes of Operation (0x6060-00) = 7 (interpolated position)",
    ]


# ---------------------------------------------------------------------------- broken logs


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    """The log of a run with a fault."""
    file = tmp_path_factory.mktemp("log") / "run.asc"
    made = moving(file)
    following_error(made)
    made.run(0.5)
    made.close()
    return file


@pytest.mark.parametrize("seed", range(6))
def test_a_log_cut_short_anywhere_is_replayed_up_to_there(seed, whole, tmp_path, replay):
    data = whole.read_bytes()
    cut = random.Random(seed).randrange(3_000, len(data))
    (tmp_path / "cut.asc").write_bytes(data[:cut])
    said = replay(tmp_path / "cut.asc", "--brief")
    assert not said.count("≠")
    notes = [line for line in said.last if line.startswith("note: ")]
    middle = ["note: cut.asc ends in the middle of a line"]
    assert notes == (middle if data[cut - 1 : cut] != b"\n" else []) or notes == []


@pytest.mark.parametrize("seed", range(10))
def test_garbage_within_is_left_out_counted_and_never_ends_the_replay(
    seed, whole, tmp_path, replay
):
    rng = random.Random(seed)
    lines = whole.read_bytes().splitlines(keepends=True)
    for _ in range(20):
        place = rng.randrange(6, len(lines))
        if b"11 86" in lines[place]:  # the emergency, which is to be found
            continue
        match rng.randrange(4):
            case 0:
                lines[place] = rng.randbytes(rng.randrange(60)) + b"\n"
            case 1:
                lines[place] = lines[place][: rng.randrange(len(lines[place]))] + b"\n"
            case 2:
                lines.insert(place, lines[rng.randrange(6, len(lines))])
            case 3:
                words = lines[place].split(b" ")
                rng.shuffle(words)
                lines[place] = b" ".join(words).strip() + b"\n"
    (tmp_path / "broken.asc").write_bytes(b"".join(lines))
    said = replay(tmp_path / "broken.asc")
    assert said.count("emergency: following error")
    assert sum("not a line of an ASC file" in line for line in said.last) <= 1


@pytest.mark.parametrize("seed", range(int(os.environ.get("REPLAY_RUNS", "6"))))
def test_events_that_no_driver_has_written_end_nothing(seed, whole, tmp_path, capsys):
    rng = random.Random(seed)
    junk = [None, True, -1, 0, 10**30, 1e308, math.nan, "", "x", [], {}, [[1]], {"a": 1}]

    def spoil(value: object) -> object:
        if not value or not isinstance(value, (list, dict)) or rng.random() < 0.2:
            return rng.choice(junk)
        places = list(value) if isinstance(value, dict) else range(len(value))
        place = rng.choice(list(places))
        changed = value.copy()
        changed[place] = spoil(value[place])
        return changed

    lines = whole.read_text().splitlines(keepends=True)
    events = [n for n, line in enumerate(lines) if re.match(r"// @\S+ \w+ [\[{]", line)]
    configuration = next(n for n in events if " configuration " in lines[n])
    for place in {*rng.sample(events, 8), *([configuration] if rng.random() < 0.7 else [])}:
        head, name, data = lines[place].split(" ", 3)[1:]
        spoilt = json.dumps(spoil(json.loads(data)))
        lines[place] = f"// {head} {name} {spoilt}\n"
    lines.insert(rng.randrange(20, len(lines)), f"// @1.0 fault {'[' * 100_000}\n")
    (tmp_path / "spoilt.asc").write_text("".join(lines))
    drawing = [] if seed else ["--output", str(tmp_path / "run.png")]
    status = program.main([str(tmp_path / "spoilt.asc"), *drawing])
    said = capsys.readouterr()
    assert status == 0 and "end of the log" in said.out, said.err


@pytest.mark.parametrize(
    ("name", "content", "problem"),
    [
        ("gone.asc", None, "can't read .*gone.asc: No such file or directory"),
        ("empty.asc", b"", "holds no CAN frame; give a log"),
        ("picture.asc", bytes(range(256)) * 20, "holds no CAN frame .*not a line of an ASC file"),
        ("notes.txt", b"hello", "is no log by its name: it must end in .asc"),
        ("none.blf", b"hello", "holds no CAN frame .*can't be read beyond frame 0"),
        ("plain.log", b"  can0  181   [8]  37 02\n", "holds no CAN frame .*beyond frame 0"),
        ("cut.asc.gz", b"\x1f\x8b\x08\x00hello", "can't read|holds no CAN frame"),
    ],
)
def test_what_is_no_log_is_one_line(name, content, problem, tmp_path, capsys):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    assert program.main([str(tmp_path / name)]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("epos2_ros replay: ")
    assert re.search(problem, line)


def test_frames_of_other_lengths_and_protocols_do_no_harm(whole, tmp_path, replay):
    rng = random.Random(5)
    lines = whole.read_text().splitlines(keepends=True)
    for _ in range(300):
        place = rng.randrange(300, len(lines))
        can_id = rng.choice([rng.randrange(0x800), 0x581, 0x601, 0x81, 0x701, 0x000, 0x100])
        data = rng.randbytes(rng.randrange(9))
        t_s = re.search(r"\d+\.\d+", lines[place])
        way = rng.choice(["Rx", "Tx"])
        at = t_s[0] if t_s else "0.0"
        lines.insert(place, f"{at} 1  {can_id:X}  {way} d {len(data)} {data.hex(' ')}\n")
    (tmp_path / "foreign.asc").write_text("".join(lines))
    said = replay(tmp_path / "foreign.asc")
    assert said.count("emergency: following error")
    assert said.count("none of CANopen's")
