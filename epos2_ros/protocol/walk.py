"""Drives on their way through the states of CiA 402: what they are told, and whether they took it.

A controlword can be lost, and a statusword can be of before it. So a drive is told again what it
does not do, and what it reports counts as an answer only once it can be one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from epos2_ros.protocol import cia402
from epos2_ros.protocol.cia402 import State
from epos2_ros.protocol.drive import Drive
from epos2_ros.protocol.outbox import Outbox

RESEND_US = 200_000.0  # a controlword without effect so long is sent again
STALE_US = 20_000.0  # so long after a controlword a drive may report what was before it, …
QUIET_US = 300_000.0  # … and so long after it would have reported what became of one before


class _Step(NamedTuple):
    """The last controlword that a drive was told."""

    state: State
    sent_us: float


class Walk:
    """The drives of a bus in one phase of their group. Times are host µs."""

    def __init__(self, out: Outbox) -> None:
        self._out = out
        self._steps: dict[Drive, _Step] = {}

    def begin(self) -> None:
        """A phase begins: nobody has been told anything in it."""
        self._steps.clear()

    def step(self, drives: Sequence[Drive], target: State, now_us: float) -> list[Drive]:
        """One transition for every drive that is not at the target; the drives that are not."""
        waiting = [drive for drive in drives if not self._is_at(drive, target, now_us)]
        for drive in waiting:
            controlword = cia402.step(drive.state, target)
            if drive.state is target and drive not in self._steps:
                controlword = cia402.SHUTDOWN
            if controlword is not None and not drive.powering_up:
                self.tell(drive, controlword, now_us)
        return waiting

    def _is_at(self, drive: Drive, target: State, now_us: float) -> bool:
        """Whether a drive is there, and is going to stay."""
        if target is not State.READY_TO_SWITCH_ON:
            return drive.state is target
        if drive.state is target:
            return self.has_taken(drive, target, now_us)
        # Its power stage is off; the fault stays for whoever resets it.
        return drive.state is State.FAULT

    def tell(self, drive: Drive, controlword: int, now_us: float) -> None:
        """Send it, once for each state that the drive is in, and again if that has no effect."""
        last = self._steps.get(drive)
        if last and last.state is drive.state and now_us < last.sent_us + RESEND_US:
            return
        if controlword == cia402.FAULT_RESET:  # bit 7 has to rise
            self._out.frames.append(drive.controlword(cia402.DISABLE_VOLTAGE))
        self._out.frames.append(drive.controlword(controlword))
        self._steps[drive] = _Step(drive.state, now_us)

    def has_taken(self, drive: Drive, state: State, now_us: float) -> bool:
        """Whether a drive in `state` is there by what this phase has told it.

        Where it was there before, "enable operation" may have been on its way to it.
        """
        last = self._steps.get(drive)
        if last is None:
            return False
        if last.state is not state:
            return True
        told_us = last.sent_us
        return drive.statusword_us > told_us + STALE_US or now_us > told_us + QUIET_US
