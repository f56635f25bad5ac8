"""The program `check`, used as a person would: questions read from a terminal, answers typed."""

from __future__ import annotations

import io
import math
import os
import pty
import re
import select
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from epos2_ros.bus.driver import Driver
from epos2_ros.commission import first_motion
from epos2_ros.commission.check import main
from epos2_ros.commission.dialogue import Dialogue, NoMoreAnswers, amount
from epos2_ros.commission.first_motion import FirstMotion
from epos2_ros.configuration.driver import AxisConfig, DriverConfig
from epos2_ros.errors import DriveError
from epos2_ros.sim.realtime import RealtimeSimulator, build_copley_drives, build_drives

ROOT = Path(__file__).resolve().parents[2]
GANTRY = str(ROOT / "config" / "gantry.yaml")
PATIENCE_S = 30.0


class Person:
    """Reads what a program of the package says on a terminal, and types."""

    def __init__(self, *arguments: str) -> None:
        self._terminal, theirs = pty.openpty()
        self.program = subprocess.Popen(
            [sys.executable, "-m", "epos2_ros", *arguments],
            cwd=ROOT,
            stdin=theirs,
            stdout=theirs,
            stderr=theirs,
            start_new_session=True,
            preexec_fn=_own_terminal,
        )
        os.close(theirs)
        self.seen = ""
        self._read = 0

    def reads(self, pattern: str) -> re.Match[str]:
        """What has been said since the last match, up to this."""
        deadline = time.monotonic() + PATIENCE_S
        while not (match := re.compile(pattern).search(self.seen, self._read)):
            left = deadline - time.monotonic()
            assert left > 0 and self._more(left), f"{pattern!r} was not said:\n{self.seen}"
        self._read = match.end()
        return match

    def types(self, text: str) -> None:
        os.write(self._terminal, text.encode())

    def answers(self, question: str, text: str) -> None:
        self.reads(question)
        self.types(f"{text}\n")

    def ends(self) -> int:
        """Exit status."""
        deadline = time.monotonic() + PATIENCE_S
        while self._more(max(0.0, deadline - time.monotonic())):
            pass
        return self.program.wait(PATIENCE_S)

    def _more(self, timeout_s: float) -> bool:
        if not select.select([self._terminal], [], [], timeout_s)[0]:
            return False
        try:
            data = os.read(self._terminal, 65536)
        except OSError:  # the program has ended
            return False
        self.seen += data.decode().replace("\r\n", "\n")
        return bool(data)

    def leaves(self) -> None:
        self.program.kill()
        self.program.wait()
        os.close(self._terminal)


def _own_terminal() -> None:
    """Ctrl-C on it is for this program."""
    import fcntl
    import termios

    fcntl.ioctl(0, termios.TIOCSCTTY, 0)


@pytest.fixture
def person() -> Iterator[Any]:
    people: list[Person] = []

    def sit_down(*arguments: str) -> Person:
        people.append(Person(*arguments))
        return people[-1]

    yield sit_down
    for one in people:
        one.leaves()


def test_rehearsal_goes_through_all_steps(person: Any) -> None:
    p = person("check", "--joint", "elbow_joint")
    p.reads("first motion of elbow_joint: node 3 on virtual epos2")
    p.reads("a rehearsal, nothing real moves")
    p.answers("is that safe.*\\[y/N\\]", "perhaps")
    p.answers("please answer y or n", "y")
    p.reads(r"elbow_joint \(node 3\): maxon EPOS2 70/10, firmware 2126h, serial number 3")
    p.answers("push it by how much", "0.1 parsec")
    p.answers("must be a number, of rad or with one of rad, deg", "3deg")
    p.reads(r"elbow_joint went by \+0\.0523\d+ rad \(1667 counts\)")
    p.reads("sign and scale are right")
    p.answers("are these limits right", "y")
    p.answers("harmless", "y")
    p.answers("move elbow_joint by how much", "-0.02")
    p.reads("-0.02 rad and back, 3 s each way, at most 0.01 rad/s")
    p.answers("move now", "y")
    p.reads("it holds, within 0 counts")
    p.reads(r"went by -0\.0(199|200)\d* rad \(-63[67] counts\)")
    p.reads(r"came back to [+-][0-2] counts of where it was, in (6|7)\.\d+ s of 6\.50 s")
    p.reads(r"largest following error: \d+ counts, 0 % of what is allowed")
    p.answers("in this direction", "y")
    p.reads("elbow_joint is as it should be")
    assert p.ends() == 0


def test_nothing_is_done_without_being_agreed(person: Any) -> None:
    p = person("check", "--params", GANTRY, "--joint", "gantry_x")
    p.answers("is that safe", "")
    p.reads("nothing was done")
    assert p.ends() == 1


def test_nothing_moves_without_being_agreed(person: Any) -> None:
    p = person("check", "--params", GANTRY, "--joint", "gantry_x", "--only", "buzz",
               "--amount", "5mm")  # fmt: skip
    p.answers("is that safe", "y")
    p.answers("move now", "no")
    p.reads("nothing moved")
    assert p.ends() == 1
    assert "it holds" not in p.seen


def test_ctrl_c_halts_and_switches_off(person: Any) -> None:
    p = person("check", "--params", GANTRY, "--joint", "gantry_x", "--only", "buzz",
               "--amount", "20mm")  # fmt: skip
    p.answers("is that safe", "y")
    p.answers("move now", "y")
    p.reads("it holds")
    p.reads(r"\+0\.00[1-9]\d* m")  # on its way
    p.types("\x03")
    p.reads("stopped and switched off")
    assert p.ends() == 130


def test_what_was_skipped_is_not_called_right(person: Any) -> None:
    p = person("check", "--params", GANTRY, "--joint", "gantry_x", "--only", "position", "buzz")
    p.answers("is that safe", "y")
    p.answers("push it by how much", "")
    p.answers("move gantry_x by how much", "")
    p.reads("gantry_x is as it should be, but for what was skipped: position, buzz")
    assert p.ends() == 0


@pytest.mark.parametrize("question", ["is that safe", "push it by how much", "move now"])
def test_ctrl_c_ends_at_every_question(person: Any, question: str) -> None:
    step = "position" if "push" in question else "buzz"
    p = person("check", "--params", GANTRY, "--joint", "gantry_x", "--amount", "5mm",
               "--only", step)  # fmt: skip
    if question != "is that safe":
        p.answers("is that safe", "y")
    p.reads(question)
    p.types("\x03")
    assert p.ends() == 130
    assert "Traceback" not in p.seen


def test_hand_on_a_drive_of_another_process(person: Any, tmp_path: Path) -> None:
    """The simulator's own terminal is the hand, and the position is shown while it turns."""
    drives = person("simulator", "--slcan", "--nodes", "3", "--hand")
    path = drives.reads(r"slcan adapter (\S+)")[1]
    file = tmp_path / "arm.yaml"
    file.write_text(
        "/epos2_driver: {ros__parameters: {joints: [arm], can: {interface: slcan, channel: "
        f"{path}}}, axes: {{arm: {{node_id: 3, gear_ratio: 10.0}}}}}}}}\n"
    )
    p = person("check", "--params", str(file), "--only", "position")
    p.answers("is that safe", "y")
    p.reads("turn arm by hand in its positive direction")
    drives.types("3 nonsense\n3 -2000\n")
    drives.reads("a node id and counts")
    drives.reads("node 3: turned by -2000 counts")
    p.reads(r"-0\.62832 rad \(-36\.00°\)")  # a tenth of a turn
    p.types("\n")
    p.answers("by how much did you turn it", "36°")
    p.reads(r"STOP: the sign is wrong: set axes.arm.direction to -1")
    assert p.ends() == 1


# --- without a terminal, on drives that a test can reach into --------------------------------


@contextmanager
def bench(answers: str, drive: str = "epos2", **axis: Any) -> Iterator[tuple[Any, ...]]:
    """`FirstMotion` of one joint with these answers; the simulated drive, and what was said."""
    channel = f"check {id(answers)} {time.monotonic_ns()}"
    made: list[Any] = build_drives([1]) if drive == "epos2" else build_copley_drives([1])
    config = AxisConfig("arm", 1, drive=drive, **{"gear_ratio": 50.0, **axis})
    with can.Bus(interface="virtual", channel=channel) as theirs:
        simulator = RealtimeSimulator(theirs, made)
        simulator.start()
        driver = Driver(
            DriverConfig(axes=(config,), channel=channel, simulate=False, realtime_priority=0)
        )
        try:
            driver.configure()
            out = io.StringIO()

            talk = Dialogue(io.StringIO(answers), out)
            yield FirstMotion(driver, config, talk, 0.6), simulator, made[0], out, driver
        finally:
            driver.close()
            simulator.stop()


class Turning(io.StringIO):
    """Answers of a person who turns the shaft before the first of them."""

    def __init__(self, answers: str, turn: Any) -> None:
        super().__init__(answers)
        self._turn = turn

    def readline(self, size: int = -1) -> str:  # type: ignore[override]
        if self._turn is not None:
            self._turn()
            self._turn = None
            time.sleep(0.2)
        return super().readline()


BY_HAND = (  # how far the shaft is turned, what the person says, what check says
    (10_000, "0.6283", "sign and scale are right (+0.0 %)"),
    (10_000, "-0.6283", "the sign is wrong: set axes.arm.direction to -1"),
    (10_000, "1.2566", "set axes.arm.gear_ratio to about 25"),
    (10_000, "0.15708", "is axes.arm.counts_per_turn 8000?"),
    (3, "0.5", "the position does not follow"),
    (10_000, "", "skipped"),
    (10_000, "0", "an amount of 0 says nothing"),
)


@pytest.mark.parametrize("drive", ["epos2", "copley"])
def test_hand_tells_sign_and_scale(drive: str) -> None:
    with bench("", drive) as (first, simulator, _, _out, _driver):
        for counts, answer, says in BY_HAND:
            out = io.StringIO()
            turning = Turning(f"\n{answer}\n", partial(simulator.push, 1, counts))
            first._talk = Dialogue(turning, out)
            good = first.position()
            assert says in out.getvalue()
            assert good is ("right" in says or says == "skipped")


def test_prismatic_joint_is_told_its_lead() -> None:
    with bench("", type="prismatic", lead=0.01, gear_ratio=1.0) as (first, simulator, _, out, _d):
        turning = Turning("\n20mm\n", lambda: simulator.push(1, 2000))
        first._talk = Dialogue(turning, out)
        assert not first.position()
    assert ".gear_ratio to about 0.5, or .lead to about 0.02" in out.getvalue()


def test_limits_are_told_and_asked() -> None:
    limits = {"min_position": -0.5, "max_velocity": 0.2, "stop_deceleration": 2.0}
    with bench("y\nn\n", **limits) as (first, _, _drive, out, _d):
        assert first.limits()
        assert not first.limits()
    said = out.getvalue()
    assert "min_position: -0.5 rad, 0.5 rad from where it is" in said
    assert "max_position: none" in said
    assert "max_velocity: 0.2 rad/s (95.49 rpm of the motor)" in said
    assert "at most 0.1 s, within 0.01 rad" in said


def test_axis_beyond_its_limits_stops_the_check() -> None:
    with bench("y\n", min_position=0.1, max_position=1.0) as (first, _, _drive, out, _d):
        assert not first.limits()
    assert "arm is beyond axes.arm.min_position" in out.getvalue()


def test_following_error_is_told_in_all_units() -> None:
    with bench("n\n", max_following_error=500) as (first, _, _drive, out, _d):
        assert not first.following_error()
    assert "500 counts, 0.0314 rad of the joint, 0.25 turns of the motor" in out.getvalue()


@pytest.mark.parametrize("drive", ["epos2", "copley"])
@pytest.mark.parametrize("by", [0.02, -0.02])
def test_buzz_moves_there_and_back(
    drive: str, by: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(first_motion, "BUZZ_S", 0.5)
    limits = {"max_velocity": 1.0, "max_acceleration": 5.0}
    with bench("y\ny\n", drive, **limits) as (first, _, simulated, out, driver):
        assert first.buzz(by)
        counts = 50 * 2000 / (2 * math.pi) * by
        assert abs(simulated.position_actual) <= 2
        assert driver.snapshot().state == "disabled"
    (seen,) = re.findall(r"\(([+-]\d+) counts\)", out.getvalue())
    assert abs(int(seen) - counts) <= 2


def test_buzz_is_slow_enough_for_the_limits() -> None:
    with bench("n\n", max_velocity=0.01, max_acceleration=0.5) as (first, _, _s, out, _d):
        assert not first.buzz(0.1)
    (seconds,) = re.findall(r"([\d.]+) s each way", out.getvalue())
    assert 1.5 * 0.1 / float(seconds) < 0.01


def test_blocked_axis_ends_with_a_fault_and_no_motion_left() -> None:
    with bench("y\n", max_following_error=300) as (first, simulator, drive, out, driver):
        with simulator.lock:
            drive.block_rotor()
        with pytest.raises(DriveError, match="following error"):
            first.buzz(0.1)
        assert driver.snapshot().state == "fault"


@pytest.mark.parametrize(
    ("axis", "says"),
    [
        ({"max_position": 0.05}, "0.1 rad is beyond axes.arm.max_position, 0.05 rad"),
        ({"drive": "copley"}, "axes.arm.max_velocity is not set"),
    ],
)
def test_what_can_not_be_run_is_refused_before_anything_is_switched_on(
    axis: dict[str, Any], says: str
) -> None:
    with bench("y\n", **axis) as (first, _, _s, out, driver):
        assert not first.buzz(0.1)
        assert driver.snapshot().state == "disabled"
    assert says in out.getvalue()


def test_amount_too_small_to_be_seen_is_refused() -> None:
    with bench("y\n") as (first, _, _s, out, _d):
        assert not first.buzz(1e-4)
    assert "only 2 counts: give more" in out.getvalue()


def test_end_of_the_answers_is_no_consent() -> None:
    with bench("") as (first, _, _s, _o, driver):
        with pytest.raises(NoMoreAnswers):
            first.buzz(0.1)
        assert driver.snapshot().state == "disabled"


# --- words ----------------------------------------------------------------------------------


@given(value=st.floats(-1e6, 1e6), unit=st.sampled_from(["rad", "m"]))
def test_amounts_come_back_in_every_unit(value: float, unit: str) -> None:
    names = {"rad": {"": 1, " rad": 1, "deg": math.pi / 180, "°": math.pi / 180},
             "m": {"": 1, "m": 1, " mm": 1e-3, "cm": 1e-2}}  # fmt: skip
    for name, scale in names[unit].items():
        assert amount(f" {value!r}{name} ", unit) == pytest.approx(value * scale)


@given(text=st.text(max_size=12))
def test_whatever_is_typed_is_an_amount_or_refused(text: str) -> None:
    try:
        assert math.isfinite(amount(text, "rad"))
    except ValueError as error:
        assert "must be a number" in str(error)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--params", GANTRY], "--joint is needed: one of gantry_x, gantry_y"),
        (["--params", GANTRY, "--joint", "z"], "there is no joint 'z': one of gantry_x"),
        (["--params", "missing.yaml"], "can't read missing.yaml"),
        (["--params", GANTRY, "--joint", "gantry_x", "--amount", "3deg"], "--amount '3deg'"),
    ],
)
def test_what_can_not_be_gets_one_line(
    arguments: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 1
    output, error = capsys.readouterr()
    assert output == "" and error.count("\n") == 1
    assert error.startswith("epos2_ros check: ") and says in error
