"""The program `check`: the first motion of a joint, asking before anything moves."""

from __future__ import annotations

import argparse
import signal
import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from types import FrameType

from epos2_ros.bus.driver import Driver
from epos2_ros.bus.epos2 import INHIBIT_US
from epos2_ros.commission.dialogue import Dialogue, amount
from epos2_ros.commission.first_motion import FirstMotion, Hand
from epos2_ros.commission.place import simulated
from epos2_ros.configuration.arguments import without_ros_arguments
from epos2_ros.configuration.driver import AxisConfig, DriverConfig
from epos2_ros.configuration.files import read_parameters, share
from epos2_ros.configuration.parameters import DriverParameters
from epos2_ros.errors import ConfigurationError, Epos2RosError
from epos2_ros.motion.units import AxisUnits
from epos2_ros.protocol.outbox import Event

STEPS = {
    "position": "the position follows the hand, in sign and scale",
    "limits": "positions, velocity and acceleration the axis is held to",
    "following_error": "how far it may be behind before the drive gives up",
    "buzz": "a small slow move there and back",
}
REHEARSAL = "arm.yaml"
AT_REST = ("disabled", "fault")  # states of all axes in which nothing is to be stopped
STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM)
TOLD = ("drive", "fault", "warning", "aborted")  # kinds of the driver's events


def main(argv: Sequence[str] | None = None) -> int:
    """Returns 0 when all steps were gone through; 1 after one that was not right, or trouble."""
    arguments = _arguments(sys.argv[1:] if argv is None else argv)
    dialogue = Dialogue(sys.stdin, sys.stdout)
    signal.signal(signal.SIGTERM, _interrupt)
    try:
        return run(arguments, dialogue)
    except Epos2RosError as error:
        print(f"epos2_ros check: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130


def run(arguments: argparse.Namespace, talk: Dialogue) -> int:
    """The whole dialogue."""
    config = _config(arguments.params)
    rehearsal = arguments.params is None and arguments.joint is None
    axis = config.axes[0] if rehearsal else _axis(config, arguments.joint)
    by = _amount(arguments.amount, axis)
    talk.say(
        f"first motion of {axis.joint}: node {axis.node_id} on {config.interface} "
        f"{config.channel}; Ctrl-C stops and switches off at any moment"
    )
    if config.simulate:
        talk.say("the drives are simulated: a rehearsal, nothing real moves")
    if not talk.agreed(f"{axis.joint} is switched off now; is that safe, can nothing fall?"):
        talk.say("nothing was done")
        return 1
    with ExitStack() as stack:
        hand: Hand | None = None
        if config.simulate:
            simulation = stack.enter_context(simulated(config))
            scale = AxisUnits.of(axis).qc_per_unit

            def hand(way: float) -> bool:
                return simulation.push(axis.node_id, way * scale)

        driver = Driver(_alone(config, axis), on_event=lambda event: _tell(talk, event))
        stack.callback(driver.close)
        driver.configure()
        settle_s = max(2 * config.sync_period, max(INHIBIT_US.values()) / 1e6 + 0.1)
        first = FirstMotion(driver, axis, talk, settle_s, hand)
        steps: dict[str, Callable[[], bool]] = {
            "position": first.position,
            "limits": first.limits,
            "following_error": first.following_error,
            "buzz": lambda: first.buzz(by),
        }
        try:
            for name in arguments.only or STEPS:
                talk.say(f"\n{name}: {STEPS[name]}")
                if not steps[name]():
                    return 1
        except (KeyboardInterrupt, Epos2RosError):
            _stop(driver, talk)
            raise
    skipped = f", but for what was skipped: {', '.join(first.skipped)}" if first.skipped else ""
    talk.say(f"\n{axis.joint} is as it should be{skipped}")
    return 0


def _stop(driver: Driver, talk: Dialogue) -> None:
    """Halt and switch off, whoever presses Ctrl-C meanwhile."""
    before = {number: signal.signal(number, signal.SIG_IGN) for number in STOP_SIGNALS}
    talk.say()
    try:
        if driver.snapshot().state not in AT_REST:
            driver.halt()
            driver.disable()
            talk.say("stopped and switched off")
    except Epos2RosError as error:
        talk.say(f"{error}; the drives stop by themselves when they don't hear the host")
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _tell(talk: Dialogue, event: Event) -> None:
    if event.kind in TOLD:
        talk.say(event.text if event.kind == "drive" else f"{event.kind}: {event.text}")


def _alone(config: DriverConfig, axis: AxisConfig) -> DriverConfig:
    """This joint only: one that was not checked yet is not put under power.

    Simulated drives are ours, not the driver's; a single slow axis needs no real time.
    """
    return replace(
        config,
        axes=(axis,),
        outputs=(),
        sync_source="host",
        sync_producer="host",
        simulate=False,
        realtime_priority=0,
    )


def _config(file: Path | None) -> DriverConfig:
    """The configuration; without a file the simulated arm that is shipped."""
    return DriverParameters(read_parameters(file or share() / "config" / REHEARSAL)).config()


def _axis(config: DriverConfig, joint: str | None) -> AxisConfig:
    by_joint = {axis.joint: axis for axis in config.axes}
    if joint is None and len(by_joint) == 1:
        return config.axes[0]
    if joint not in by_joint:
        given = "--joint is needed" if joint is None else f"there is no joint {joint!r}"
        raise ConfigurationError(f"{given}: one of {', '.join(by_joint)}")
    return by_joint[joint]


def _amount(text: str | None, axis: AxisConfig) -> float | None:
    if text is None:
        return None
    try:
        return amount(text, AxisUnits.of(axis).unit)
    except ValueError as error:
        raise ConfigurationError(f"--amount {error}") from None


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt


def _arguments(argv: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="epos2_ros check",
        description="The first motion of a joint, step by step, asking before anything moves: "
        + "; ".join(f"{name}: {what}" for name, what in STEPS.items())
        + ". Without --params it is a rehearsal on simulated drives.",
    )
    parser.add_argument(
        "--params",
        type=Path,
        metavar="FILE",
        help="parameters of the driver; scan --yaml makes a file",
    )
    parser.add_argument("--joint", help="the joint to be moved; the others stay without power")
    parser.add_argument(
        "--amount",
        metavar="AMOUNT",
        help="how far buzz moves it, in rad or m, or like 3deg, 2mm; else check asks",
    )
    parser.add_argument(
        "--only", choices=STEPS, nargs="+", metavar="STEP", help=f"of {', '.join(STEPS)}"
    )
    return parser.parse_args(without_ros_arguments(argv))
