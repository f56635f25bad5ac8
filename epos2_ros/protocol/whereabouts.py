"""Where all axes are at one instant, between and after what their drives say.

An axis that follows a path is where its demand is, less the following error. The demand is known
exactly: the records that were sent, or what a drive makes of its set-points. The following error is
known from every SYNC, where a drive reports it, and goes by the model of a position
controller: a delay times the velocity that long ago, and a rest. What the delay is, the reports
tell; the rest is what the last of them leaves unexplained. A position that is reported in between
corrects it only where it contradicts it, for nobody knows to a millisecond when it was measured.

READING: the application note has the motion begin with its start SYNC, and cycles of 1 ms follow
it; so the demand between two cycles is that of the cubic.

An axis without a known demand (halted, disabled, homing, moved by hand) is carried on from the
newest report by its velocity, as long as the next one may be on its way.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

from epos2_ros.protocol.drive import LARGEST_ERROR_QC, Drive
from epos2_ros.protocol.machine import Machine
from epos2_ros.protocol.phase import BEGUN, NOT_BEGUN, Phase

HEARD_US = 500_000.0  # a drive that was not heard for so long may be anywhere
EVENT_AGE_US = 600.0  # of a position that comes as an event: half a cycle, and its way on the bus
EVENT_LATE_US = 10_000.0  # by so much more it may be older: others come first on the bus
CYCLES_US = 2_000.0  # within so long of a SYNC a drive has its demand from
SEEN_US = 1_000_000.0  # by now a position of a drive that is off would have come again
MAX_DELAY_US = 20_000.0
FORGET = 0.9  # from SYNC to SYNC, of what is known of the delay
SLOW_QC_S = 3_000.0  # at such velocities a delay is hardly to be seen in whole counts
ROUNDING_QC = 2.0  # of the demand and the position, each in whole counts

Planned = Callable[[float], tuple[float, float]]  # host µs to position [qc] and velocity [qc/s]


class AxisNow(NamedTuple):
    """One axis at the instant."""

    place: int  # among the machine's drives
    position_qc: float
    velocity_qc_s: float


class Whereabouts:
    """Of all axes of a machine. Ask in the order of time."""

    def __init__(self, machine: Machine) -> None:
        self._machine = machine
        self._axes = [_Axis(drive) for drive in machine.drives]

    def at(self, t_us: float) -> Sequence[AxisNow]:
        """The axes that are heard, at a time [host µs]; none before all have said where they are.

        `t_us` is now, or a moment ago.
        """
        machine, heard = self._machine, []
        if any(drive.position_qc is None for drive in machine.drives):
            return ()
        for place, (drive, axis) in enumerate(zip(machine.drives, self._axes, strict=True)):
            if t_us > drive.heard_us + HEARD_US or machine.group.silent(drive):
                continue
            planned = self._planned(drive)
            axis.does(t_us, None if planned is None else machine.group.phase in BEGUN)
            if planned is None:
                position_qc, velocity_qc_s = axis.carried_on(t_us)
            else:
                position_qc, velocity_qc_s = axis.following(t_us, planned)
            heard.append(AxisNow(place, position_qc, velocity_qc_s))
        return heard

    def _planned(self, drive: Drive) -> Planned | None:
        """What the axis is to do, if that is known and it does it."""
        machine, demand_qc = self._machine, drive.demand_qc
        if machine.group.phase in NOT_BEGUN or machine.group.phase is Phase.STANDING:
            return None if demand_qc is None else lambda t_us: (float(demand_qc), 0.0)
        if machine.group.phase not in BEGUN:
            return None
        followers = machine.followers
        if not followers.follows(drive) or machine.group.modes != followers.modes:
            return None if drive.demand is None else drive.demand.at
        if machine.path_time.start_us is None:
            return None
        at_ms = machine.path_time.at_ms
        return lambda t_us: followers.demand(drive, at_ms(t_us) or 0.0)


class _Axis:
    """One axis, and what is known of its following error."""

    def __init__(self, drive: Drive) -> None:
        self._drive = drive
        self._delay_us = 0.0
        self._rest_qc = 0.0
        self._squares = self._products = 0.0  # of velocities, and of them with following errors
        self._compared_us = -math.inf  # the last SYNC whose report was taken in, …
        self._seen_us = -math.inf  # … and the last position in between
        self._moves: bool | None = None  # by its plan; None: it has none
        self._since_us = -math.inf  # since when that is so
        self._last = self._left = -math.inf, 0.0, 0.0  # on a path: when, where, how fast; its end

    def does(self, t_us: float, moves: bool | None) -> None:
        """Whether it moves by its plan, or rests, or has none."""
        if moves is not self._moves:
            self._moves, self._since_us = moves, t_us
            if moves is None:
                self._left = self._last

    # ------------------------------------------------------------------ on a path

    def following(self, t_us: float, planned: Planned) -> tuple[float, float]:
        """Position and velocity on a path."""
        self._compare(planned)
        position_qc, velocity = self._behind(t_us, planned)
        self._last = t_us, position_qc, velocity
        return position_qc, velocity

    def _behind(self, t_us: float, planned: Planned) -> tuple[float, float]:
        _, velocity = planned(t_us - self._delay_us)
        position = planned(t_us)[0] - velocity * self._delay_us * 1e-6 - self._rest_qc
        return position, velocity

    def _compare(self, planned: Planned) -> None:
        """Take in what the drive has reported since."""
        drive = self._drive
        sync_us = drive.demand_sync_us
        if sync_us > self._compared_us and (error_qc := self._error_qc()) is not None:
            self._compared_us = sync_us
            position, velocity = planned(sync_us)
            off_qc = abs((drive.demand_qc or 0) - position)
            if off_qc <= abs(velocity) * CYCLES_US * 1e-6 + ROUNDING_QC:
                self._learn(error_qc, planned(sync_us - self._delay_us)[1])
        event_us = drive.sample_us - EVENT_AGE_US
        known_us = max(self._seen_us, self._compared_us, self._since_us + EVENT_LATE_US)
        if event_us > known_us:
            self._seen_us = event_us
            position, velocity = self._behind(event_us, planned)
            off_qc = position - (drive.position_qc or 0)
            if abs(off_qc) > abs(velocity) * EVENT_LATE_US * 1e-6 + ROUNDING_QC:
                self._rest_qc += off_qc

    def _error_qc(self) -> float | None:
        """The following error at the last SYNC with an answer."""
        drive = self._drive
        reported = drive.following_error_qc
        if reported is not None and abs(reported) < LARGEST_ERROR_QC:
            return reported
        if drive.sample_us != drive.demand_sync_us or drive.demand_qc is None:
            return None
        return drive.demand_qc - (drive.position_qc or 0)

    def _learn(self, error_qc: float, velocity: float) -> None:
        if velocity:
            self._squares = max(FORGET * self._squares, SLOW_QC_S**2) + velocity**2
            self._products = FORGET * self._products + velocity * error_qc
            delay_us = 1e6 * self._products / self._squares
            self._delay_us = min(max(delay_us, -MAX_DELAY_US), MAX_DELAY_US)
        rest_qc = error_qc - velocity * self._delay_us * 1e-6
        # Whole counts: in motion what is no more than that is taken for it, and evened out.
        small = bool(velocity) and abs(rest_qc - self._rest_qc) <= ROUNDING_QC
        self._rest_qc += (1 - FORGET if small else 1.0) * (rest_qc - self._rest_qc)

    # ------------------------------------------------------------------ off it

    def carried_on(self, t_us: float) -> tuple[float, float]:
        """Position and velocity from the newest report on, or from where it has left its path."""
        drive = self._drive
        at_sync = drive.sample_us == drive.position_sync_us
        since_us = drive.sample_us - (0.0 if at_sync else EVENT_AGE_US)
        position_qc, velocity = float(drive.position_qc or 0), drive.velocity_qc_s
        acceleration = drive.acceleration_qc_s2
        if not at_sync and self._left[0] <= since_us:  # it is off, and has said where it is
            return position_qc, velocity if t_us < since_us + SEEN_US else 0.0
        if self._left[0] > since_us:
            (since_us, position_qc, velocity), acceleration = self._left, 0.0
        passed_s = min(max(0.0, t_us - since_us), HEARD_US) * 1e-6
        if acceleration * velocity < 0:  # it brakes, to rest
            passed_s = min(passed_s, -velocity / acceleration)
        gained = acceleration * passed_s
        return position_qc + (velocity + gained / 2) * passed_s, velocity + gained
