"""The first motion of a joint, step by step: nothing moves before a person has agreed.

Each step says what it sees, asks, and gives back whether to go on. The motion is the driver's own.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass

import numpy as np

from epos2_ros.bus.driver import Driver
from epos2_ros.bus.snapshot import AxisSnapshot
from epos2_ros.commission.dialogue import Dialogue
from epos2_ros.configuration.driver import AxisConfig
from epos2_ros.errors import DriveError, MotionAborted, TrajectoryError
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.motion.units import AxisUnits

LEAST_COUNTS = 20  # a change of fewer says nothing of the scale
SCALE_TOLERANCE = 0.05  # a hand and an eye are no better
BUZZ_S = 3.0  # each way, at least
PEAK = 1.5  # of a cubic's velocity, against its mean; its peak acceleration is 6 times p/t²
WATCH_S = 0.02
REACHED = 0.05  # of the amount, by which the farthest point may miss it
DWELL_S = 0.5  # at the far end, where it is looked how far it got
HOLD_S = 1.0
REPORT_S = 3.0  # within this a drive tells where it is, after bring-up

Hand = Callable[[float], bool]
"""Pushes the simulated axis by so much [unit]; False when the motor holds it."""


@dataclass
class Buzz:
    """What was seen of the small motion; joint units."""

    start: float
    farthest: float
    end: float
    following_error_qc: int | None
    seconds: float


class FirstMotion:
    """The steps for one joint; `driver` is configured for it, and it is off.

    `settle_s` after a change all is reported. `hand` is given where the drives are simulated.
    """

    def __init__(
        self,
        driver: Driver,
        axis: AxisConfig,
        dialogue: Dialogue,
        settle_s: float,
        hand: Hand | None = None,
    ) -> None:
        self._driver, self._axis, self._talk, self._hand = driver, axis, dialogue, hand
        self._settle_s = settle_s
        self._units = AxisUnits.of(axis)
        self._unit = self._units.unit
        self.skipped: list[str] = []  # steps that were not taken

    # ------------------------------------------------------------------ position

    def position(self) -> bool:
        """The position follows the hand, in sign and scale."""
        joint, unit = self._axis.joint, self._unit
        before = self._here()
        self._talk.say(f"{joint} is at {self._in_words(before)}")
        moved = self._moved_by_hand(before)
        if moved is None:
            return self._skip("position", "sign and scale are not checked")
        if moved == 0:
            return self._bad("an amount of 0 says nothing")
        seen = self._here() - before
        counts = abs(seen * self._units.qc_per_unit)
        self._talk.say(f"{joint} went by {seen:+.5g} {unit} ({counts:.0f} counts)")
        if counts < LEAST_COUNTS:
            return self._bad(
                "the position does not follow: is it this joint's drive, is the encoder connected?"
            )
        if seen * moved < 0:
            return self._bad(
                f"the sign is wrong: set axes.{joint}.direction to {-self._axis.direction}"
            )
        ratio = seen / moved
        if abs(ratio - 1) > SCALE_TOLERANCE:
            return self._bad(f"the scale is wrong by {ratio:.4g}: {self._better_scale(ratio)}")
        self._talk.say(f"sign and scale are right ({100 * (ratio - 1):+.1f} %)")
        return True

    def _moved_by_hand(self, before: float) -> float | None:
        """By how much a person, or the simulation, has moved the axis; None: not at all."""
        joint, unit, talk = self._axis.joint, self._unit, self._talk
        if self._hand is not None:
            talk.say(
                "nobody can turn a simulated axis: the simulation pushes it, by the scale of the "
                "parameters, so that it can't be wrong"
            )
            by = talk.amount(f"push it by how much [{unit}]? (empty: skip)", unit)
            if by is not None and not self._hand(by):
                raise DriveError(f"{joint} holds: a hand can't turn it")
            time.sleep(self._settle_s)
            return by
        talk.ask(
            f"turn {joint} by hand in its positive direction, by a known amount; then Enter",
            lambda: f"  {self._in_words(self._here())}, {self._here() - before:+.5g} {unit}",
        )
        talk.clear()
        by = talk.amount(f"by how much did you turn it [{unit}]? (empty: skip)", unit)
        if by is not None:
            time.sleep(self._settle_s)  # where nothing changes any more nothing comes
        return by

    def _better_scale(self, ratio: float) -> str:
        axis = self._axis
        if math.isclose(ratio, 4, rel_tol=SCALE_TOLERANCE) or math.isclose(
            ratio, 0.25, rel_tol=SCALE_TOLERANCE
        ):
            counts = round(axis.counts_per_turn * ratio)
            return (
                f"is axes.{axis.joint}.counts_per_turn {counts}? It is four times the encoder's "
                "lines"
            )
        better = f"set axes.{axis.joint}.gear_ratio to about {axis.gear_ratio * ratio:.4g}"
        if axis.lead is not None:
            better += f", or .lead to about {axis.lead / ratio:.4g}"
        return better

    # ------------------------------------------------------------------ limits

    def limits(self) -> bool:
        """What the driver and the drive keep to."""
        axis, unit, talk, here = self._axis, self._unit, self._talk, self._here()
        for name, limit, sign in (
            ("min_position", axis.min_position, -1),
            ("max_position", axis.max_position, 1),
        ):
            if limit is None:
                talk.say(f"{name}: none; the axis may go as far as it can")
                continue
            room = (limit - here) * sign
            talk.say(f"{name}: {limit:g} {unit}, {room:.4g} {unit} from where it is")
            if room < 0:
                return self._bad(f"{axis.joint} is beyond axes.{axis.joint}.{name}: widen it")
        if axis.max_velocity is None:
            talk.say(f"max_velocity: none; the drive's own ({self._rpm(self._fastest())})")
        else:
            rpm = self._rpm(axis.max_velocity)
            talk.say(f"max_velocity: {axis.max_velocity:g} {unit}/s ({rpm})")
        if axis.max_acceleration is None:
            talk.say("max_acceleration: none")
        else:
            talk.say(f"max_acceleration: {axis.max_acceleration:g} {unit}/s²")
        if axis.stop_deceleration and axis.max_velocity:
            seconds = axis.max_velocity / axis.stop_deceleration
            way = axis.max_velocity * seconds / 2
            talk.say(f"halt and quick stop: at most {seconds:.2g} s, within {way:.3g} {unit}")
        return talk.agreed("are these limits right?") or self._bad("set them, then check again")

    def _fastest(self) -> float:
        return self._units.velocity_unasked

    def _rpm(self, velocity: float) -> str:
        rpm = abs(self._units.to_qc_s(velocity)) / self._axis.counts_per_turn * 60
        return f"{rpm:.4g} rpm of the motor"

    # ------------------------------------------------------------------ following error

    def following_error(self) -> bool:
        """How far the axis may be behind before the drive gives up."""
        axis, window = self._axis, self._axis.max_following_error
        way = window / abs(self._units.qc_per_unit)
        turns = window / axis.counts_per_turn
        self._talk.say(
            f"max_following_error: {window} counts, {way:.3g} {self._unit} of the joint, "
            f"{turns:.2g} turns of the motor: so far behind the drive gives up with a fault, and "
            "all axes stop"
        )
        return self._talk.agreed("is less than that harmless?") or self._bad(
            f"lower axes.{axis.joint}.max_following_error, then check again"
        )

    # ------------------------------------------------------------------ buzz

    def buzz(self, amount: float | None) -> bool:
        """A small slow move there and back."""
        joint, unit, talk = self._axis.joint, self._unit, self._talk
        if amount is None:
            question = f"move {joint} by how much, and back [{unit}]? (empty: skip)"
            amount = talk.amount(question, unit)
            if amount is None:
                return self._skip("buzz", "nothing moves")
        counts = abs(amount * self._units.qc_per_unit)
        if counts < LEAST_COUNTS:
            return self._bad(f"{amount:g} {unit} are only {counts:.0f} counts: give more")
        if reason := self._forbidden(amount):
            return self._bad(reason)
        seconds = self._duration(amount)
        talk.say(
            f"{joint} will move by {amount:+.4g} {unit} and back, {seconds:.3g} s each way, at "
            f"most {PEAK * abs(amount) / seconds:.3g} {unit}/s. It is put under power and holds. "
            "Keep a hand on the emergency stop; Ctrl-C halts and switches off."
        )
        if not talk.agreed("move now?"):
            talk.say("nothing moved")
            return False
        self._driver.enable()
        self._watch_holding()
        seen = self._there_and_back(amount, seconds)
        self._driver.disable()
        self._report(amount, 2 * seconds + DWELL_S, seen)
        if abs(seen.farthest - seen.start - amount) > REACHED * abs(amount):
            return self._bad("it did not get there: tune the regulators, look at the load")
        if not talk.agreed(f"did it go by {amount:+.4g} {unit} and back, in this direction?"):
            return self._bad("sign or scale is wrong: check the position by hand")
        return True

    def _forbidden(self, amount: float) -> str:
        """Why the axis may not move so far; "" when it may."""
        axis, target = self._axis, self._here() + amount
        for name, limit, sign in (
            ("min_position", axis.min_position, 1),
            ("max_position", axis.max_position, -1),
        ):
            if limit is not None and (target - limit) * sign < 0:
                return (
                    f"{target:.5g} {self._unit} is beyond axes.{axis.joint}.{name}, {limit:g} "
                    f"{self._unit}"
                )
        for name in ("max_velocity", "max_acceleration"):
            if axis.drive != "epos2" and getattr(axis, name) is None:
                return f"axes.{axis.joint}.{name} is not set; profile position mode needs it"
        return ""

    def _duration(self, amount: float) -> float:
        """One way, within the limits of velocity and acceleration [s]."""
        axis, way = self._axis, abs(amount)
        seconds = BUZZ_S
        if axis.max_velocity is not None:
            seconds = max(seconds, 1.1 * PEAK * way / axis.max_velocity)
        if axis.max_acceleration is not None:
            seconds = max(seconds, 1.1 * math.sqrt(4 * PEAK * way / axis.max_acceleration))
        return seconds

    def _watch_holding(self) -> None:
        """A moment of standing still under power."""
        before, until = self._here(), time.monotonic() + HOLD_S
        while time.monotonic() < until:
            self._talk.show(f"  holding at {self._in_words(self._here())}")
            time.sleep(WATCH_S)
        self._talk.clear()
        drift = abs(self._here() - before) * abs(self._units.qc_per_unit)
        self._talk.say(f"it holds, within {drift:.0f} counts")

    def _there_and_back(self, amount: float, seconds: float) -> Buzz:
        start = self._here()
        seen = Buzz(start, start, start, None, 0.0)
        begun = time.monotonic()
        if self._axis.drive != "epos2":
            self._move_to(start + amount, seconds, seen, amount)
            until = time.monotonic() + DWELL_S
            self._follow(seen, amount, lambda: time.monotonic() < until)
            self._move_to(start, seconds, seen, amount)
        else:
            times = np.cumsum([0.0, seconds, DWELL_S, seconds])
            positions = start + amount * np.array([[0.0], [1.0], [1.0], [0.0]])
            trajectory = Trajectory(
                (self._axis.joint,), times, positions, np.zeros_like(positions)
            )
            execution = self._driver.submit(trajectory)
            assert execution is not None  # it has points
            ended: Future[None] = execution.ended
            self._follow(seen, amount, lambda: not ended.done())
            try:
                ended.result()
            except (MotionAborted, TrajectoryError) as error:
                raise DriveError(str(error)) from error
        seen.seconds = time.monotonic() - begun
        time.sleep(self._settle_s)
        seen.end = self._here()
        return seen

    def _move_to(self, target: float, seconds: float, seen: Buzz, amount: float) -> None:
        self._driver.move_to({self._axis.joint: target}, seconds)
        self._follow(seen, amount, lambda: self._driver.snapshot().state != "standing")

    def _follow(self, seen: Buzz, amount: float, moving: Callable[[], bool]) -> None:
        """Look at the axis while it moves."""
        while moving():
            axis = self._axis_now()
            if (axis.position - seen.farthest) * amount > 0:
                seen.farthest = axis.position
            if axis.following_error_qc is not None:
                lag = abs(axis.following_error_qc)
                seen.following_error_qc = max(lag, seen.following_error_qc or 0)
            self._talk.show(f"  {self._in_words(axis.position)}")
            time.sleep(WATCH_S)
        self._talk.clear()

    def _report(self, amount: float, expected_s: float, seen: Buzz) -> None:
        unit, talk = self._unit, self._talk
        went, left = seen.farthest - seen.start, seen.end - seen.start
        counts = went * self._units.qc_per_unit
        talk.say(f"went by {went:+.5g} {unit} ({counts:+.0f} counts), {amount:+.4g} {unit} wanted")
        talk.say(
            f"came back to {left * self._units.qc_per_unit:+.0f} counts of where it was, in "
            f"{seen.seconds:.2f} s of {expected_s:.2f} s"
        )
        if seen.following_error_qc is not None:
            share = 100 * seen.following_error_qc / self._axis.max_following_error
            talk.say(
                f"largest following error: {seen.following_error_qc} counts, {share:.0f} % of what "
                "is allowed"
            )

    # ------------------------------------------------------------------ inside

    def _axis_now(self) -> AxisSnapshot:
        axes = self._driver.snapshot().axes
        return next(axis for axis in axes if axis.joint == self._axis.joint)

    def _here(self) -> float:
        """Joint position [unit]; DriveError when the drive does not tell it."""
        until = time.monotonic() + REPORT_S
        while math.isnan(position := self._axis_now().position):
            if time.monotonic() > until:
                raise DriveError(f"{self._axis.joint} does not tell its position")
            time.sleep(WATCH_S)
        return position

    def _in_words(self, position: float) -> str:
        degrees = f" ({math.degrees(position):+.2f}°)" if self._unit == "rad" else ""
        return f"{position:+.5f} {self._unit}{degrees}"

    def _skip(self, step: str, text: str) -> bool:
        self.skipped.append(step)
        self._talk.say(f"skipped: {text}")
        return True

    def _bad(self, text: str) -> bool:
        self._talk.say(f"STOP: {text}")
        return False
