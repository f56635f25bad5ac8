"""What is wrong with the drives of a bus: what they say, that they are silent, or their clocks.

And which of them can't be trusted any more to be what they were brought up to.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from epos2_ros.protocol.drive import Drive
from epos2_ros.protocol.intake import BOOT_UP, NMT_START, TOGGLE_BIT
from epos2_ros.protocol.outbox import Outbox
from epos2_ros.protocol.phase import BEGUN, ENABLED, Phase
from epos2_ros.protocol.silence import Silence
from epos2_ros.protocol.timekeeper import OPERATIONAL, Timekeeper

OFF_REPORTS = 2  # in a row: a drive has left "operation enabled"
NOT_OPERATIONAL = 2  # heartbeats in a row that say so: a drive has left NMT operational, …
UNANSWERED = 2  # … or one, and so many SYNCs without an answer


class Watch:
    """Over all drives of a bus, from the start of their clocks on. Times are host µs."""

    def __init__(self, drives: Sequence[Drive], time: Timekeeper, out: Outbox) -> None:
        self._drives = tuple(drives)
        self._time = time
        self._out = out
        self._sync = len(drives)  # its place among those that are to be heard
        self._silence = Silence(len(drives) + 1)
        self._places = {drive: place for place, drive in enumerate(drives)}
        self._clocked = {drive: index for index, drive in enumerate(time.drives)}
        self._unheard: set[Drive] = set()  # were silent, and not brought up since
        self._lost: set[Drive] = set()  # to be brought up anew
        self._in_hand: set[Drive] = set()  # the host itself has taken them out of NMT operational

    # ------------------------------------------------------------------ what was on the bus

    def listened(self, t_us: float, ours: bool) -> None:
        """There was a frame on the bus, one of the host's own or anybody's."""
        self._silence.listened(t_us, ours)

    def heard(self, drive: Drive, t_us: float) -> None:
        """It was this drive's."""
        drive.heard_us = t_us
        self._silence.heard(self._places[drive])

    def on_sync(self) -> None:
        """It was a SYNC of a drive."""
        self._silence.heard(self._sync)

    def on_heartbeat(self, drive: Drive, data: bytes) -> bool:
        """Or its answer to life guarding, which has a toggle bit; whether that is trouble.

        One may have waited since before the NMT start.
        """
        if data == BOOT_UP:  # its configuration is gone
            drive.restarted = True
            return True
        if data[0] & ~TOGGLE_BIT == OPERATIONAL[0] or drive in self._in_hand:
            drive.not_operational = 0
            return False
        drive.not_operational += 1
        return _not_operational(drive)

    def taken_in_hand(self, node_id: int) -> None:
        """The host has told this one to be pre-operational, to bring it up anew."""
        taken = {drive for drive in self._drives if drive.node_id == node_id}
        self._in_hand |= taken
        self._lost |= taken

    def on_nmt(self, command: int, node_id: int) -> bool:
        """Another master's: what it stops does not listen to us any more. Whether it was any."""
        if command == NMT_START:
            return False
        for drive in self._drives:
            if node_id in (0, drive.node_id):
                drive.not_operational = NOT_OPERATIONAL
                self._lost.add(drive)
        return True

    # ------------------------------------------------------------------ who is lost

    def doubt(self, drives: Iterable[Drive]) -> None:
        """These do not do what they were told: what they are told by may not be what it was."""
        self._lost.update(drives)

    def may_have_restarted(self, drive: Drive) -> bool:
        """Since it was last brought up: it has said so, or was silent."""
        return drive.restarted or drive in self._unheard

    def brought_up(self, drive: Drive) -> None:
        """Nothing of before counts any more."""
        drive.restarted, drive.not_operational, drive.unanswered = False, 0, 0
        self._lost.discard(drive)
        self._in_hand.discard(drive)
        self._unheard.discard(drive)

    def lost(self) -> list[Drive]:
        """To be brought up anew, until they are.

        Restarted, not operational, clock astray, or without their SYNC; once silent, as they may
        have restarted meanwhile; without something that was to be written to them; or in doubt.
        """
        missing = self._time.producer if self._sync_missing() else None
        self._lost |= {
            drive
            for drive in self._drives
            if self._away(drive)
            or drive.node_id in self._out.half_written
            or self._astray(drive)
            or drive is missing
        }
        return [drive for drive in self._drives if drive in self._lost]

    def clocks_begin(self) -> None:
        """All that were to be brought up anew have been; what their clocks were does not count."""
        self._lost.clear()
        self._silence.heard(self._sync)

    # ------------------------------------------------------------------ what is wrong

    def silent(self, drive: Drive) -> bool:
        """Whether a drive is not heard any more, as far as the bus was listened to."""
        return self._time.running and self._silence.silent(self._places[drive])

    def _sync_missing(self) -> bool:
        """Whether the drive that should has sent no SYNC for long."""
        watched = not self._time.produces and self._time.running
        return watched and self._silence.silent(self._sync, self._time.sync_patience_us)

    def stopped_listening(self, drive: Drive) -> bool:
        """Whether a drive has left NMT operational, and is otherwise as it was brought up."""
        return _not_operational(drive) and not drive.restarted

    def look(self, phase: Phase) -> bool:
        """Whether something is wrong that no frame tells: silence, and clocks that are off."""
        wrong, running, well = self._sync_missing(), self._time.running, self._time.well
        for place, drive in enumerate(self._drives):
            silent = running and self._silence.silent(place)
            if silent:
                self._unheard.add(drive)
            elsewhere = silent or drive.restarted or _not_operational(drive)
            if elsewhere or not well and self._clock_trouble(drive, phase):
                self._lost.add(drive)
                wrong = True
            elif self._left_operation(drive, phase):
                wrong = True
        return wrong

    def complaints(self, phase: Phase) -> str:
        """What is wrong with the drives, axis by axis; "" if nothing."""
        words = []
        for drive in self._drives:
            if away := self._away(drive) or self._left_operation(drive, phase):
                words.append(f"{drive} {away}")
            elif trouble := drive.trouble() or self._clock_trouble(drive, phase):
                words.append(f"{drive}: {trouble}")
        if self._time.producer is not None and self._sync_missing():
            words.append(f"no SYNC from {self._time.producer}")
        return "; ".join(words)

    def _away(self, drive: Drive) -> str:
        """Why a drive can't be commanded, or ""."""
        if self.silent(drive):
            return "is silent: check its power and the bus"
        if drive.restarted:
            return "has restarted: was its power off?"
        if _not_operational(drive):
            return "is no longer in NMT operational: does somebody else command it?"
        return ""

    def _left_operation(self, drive: Drive, phase: Phase) -> str:
        """What is wrong with the state of a drive that is to be enabled, or "".

        One report may have been on its way for long.
        """
        if phase not in ENABLED or drive.off_reports < OFF_REPORTS:
            return ""
        return f"has left operation enabled by itself and is in {drive.state.value}"

    def _astray(self, drive: Drive) -> bool:
        return drive in self._clocked and self._time.astray(self._clocked[drive])

    def _clock_trouble(self, drive: Drive, phase: Phase) -> str:
        """What is wrong with the clock of a drive, or ""; in motion it takes less."""
        index = self._clocked.get(drive)
        return "" if index is None else self._time.trouble(index, phase in BEGUN)


def _not_operational(drive: Drive) -> bool:
    """Whether a drive has left NMT operational: one heartbeat may be of before its NMT start."""
    told = drive.not_operational
    return told >= NOT_OPERATIONAL or (told > 0 and drive.unanswered >= UNANSWERED)
