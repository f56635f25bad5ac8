"""From what is known of an axis and its drive to one event for each time an output fires.

Two things are known: the executed path (to the microsecond, but off by the following error) and,
where a drive tells them, the compare module's registers (exact, but seldom read). The rules this
file keeps:

* Where the drive reports, it has the last word on *what* happened: how far its compare values have
  moved by the increment, and which of them have matched (status register, write 1 to clear). The
  path says *when*. Where nothing is reported the path says both.
* A match that was counted or flagged gives one event, once, however seldom the drive is read.
* Around the time of a read it is not known which came first, a crossing on the path or the read;
  what could be meant by this read or the next is decided by the one that it fits.

Nothing here does I/O. Pieces of the executed path come in order (`advance`); the answers to `reads`
come after the piece that covers the time of reading (`report`).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from math import inf
from typing import NamedTuple, Protocol

import numpy as np

from epos2_ros.motion.compare import Trigger
from epos2_ros.motion.crossings import Counts, Crossings, Grid, Path, Points, crossings
from epos2_ros.protocol.sdo import SdoRead, SdoWrite

SLACK_US = 20_000.0
"""How far the path's time of a crossing may be from when the drive saw it: following error, and
latency of SDO and of position samples."""
MATCHES = 0b110  # bits 1 and 2 of the compare module's status: value 0, value 1


class CompareEvent(NamedTuple):
    """An output fired."""

    t_us: float  # host time
    position_qc: int
    velocity_qc_s: float
    rising: bool  # counts were rising


class Tracker(Protocol):
    """Makes events of one output."""

    reads: tuple[SdoRead, ...]  # what to read from the drive; () where it reports nothing
    lost: bool  # the output no longer does what it was armed for: arm it anew

    def advance(self, path: Path) -> list[CompareEvent]:
        """The axis has gone on along `path`, from where it was."""

    def report(
        self, values: Sequence[int], begin_us: float, end_us: float
    ) -> tuple[list[CompareEvent], list[SdoWrite]]:
        """The answers to `reads`, asked between the two times; gives what to write back."""


class ComputedTracker:
    """For outputs that a drive fires without telling: every crossing on the executed path."""

    reads: tuple[SdoRead, ...] = ()
    lost = False

    def __init__(self, trigger: Trigger) -> None:
        self.trigger = trigger

    def advance(self, path: Path) -> list[CompareEvent]:
        return _events(self.trigger.fires(path))

    def report(
        self, values: Sequence[int], begin_us: float, end_us: float
    ) -> tuple[list[CompareEvent], list[SdoWrite]]:
        return [], []


class _Step(NamedTuple):
    """From one cell to the next."""

    t_us: float
    number: int  # of the count between the cells
    rising: bool
    velocity_qc_s: float

    @property
    def cell(self) -> int:
        """Where the axis is after it."""
        return self.number + self.rising


class _Reported:
    """What the trackers of Copley's compare module share: its registers and the path."""

    def __init__(self, reads: tuple[SdoRead, ...], counts: Counts) -> None:
        self.reads = reads
        self.lost = False
        self._counts = counts
        self._steps: deque[_Step] = deque()  # on the path, not yet dealt with
        self._read_us = -inf  # when the drive was last read
        self._position_qc = 0.0  # at the end of the path
        self._velocity_qc_s = 0.0

    def advance(self, path: Path) -> list[CompareEvent]:
        found = crossings(self._counts, path)
        columns = (found.t_us, found.index, found.rising, found.velocity_qc_s)
        self._steps.extend(_Step(*row) for row in zip(*(c.tolist() for c in columns), strict=True))
        self._position_qc = float(path.position_qc[-1])
        self._velocity_qc_s = float(path.velocity_qc_s[-1])
        if self._read_us == -inf:
            self._read_us = float(path.t_us[0])
        return []

    def _event(self, step: _Step) -> CompareEvent:
        count = int(self._counts.count(np.int64(step.number)))
        return CompareEvent(step.t_us, count, step.velocity_qc_s, step.rising)

    def _answer(
        self, steps: Sequence[_Step], status: int
    ) -> tuple[list[CompareEvent], list[SdoWrite]]:
        """Events, and the matches that were read cleared: those only, not what came since."""
        matches = status & MATCHES
        register = self.reads[0]
        clear = [SdoWrite.integer(register.index, register.subindex, matches, register.size)]
        return [self._event(step) for step in steps], clear if matches else []

    def _straight(
        self, first: int, last: int, path: Sequence[_Step], since_us: float, end_us: float
    ) -> list[_Step]:
        """The steps from one cell to another without turning, with the times of the path.

        What the path has not seen is spread over the time before the next that it has seen.
        """
        rising = last > first
        indices = range(first, last) if rising else range(first - 1, last - 1, -1)
        seen: dict[int, _Step] = {}
        for step in path:
            if step.rising == rising:
                seen.setdefault(step.number, step)
        result: list[_Step] = []
        missing: list[int] = []
        for index in indices:
            missing.append(index)
            if index in seen or index == indices[-1]:
                until = seen.get(index, _Step(end_us, index, rising, self._velocity_qc_s))
                gap_us = (until.t_us - since_us) / len(missing)
                result.extend(
                    until._replace(t_us=since_us + n * gap_us, number=i)
                    for n, i in enumerate(missing, 1)
                )
                since_us, missing = until.t_us, []
        return result


class SingleTracker(_Reported):
    """Modes 1 and 3: value 0 moves on by the increment each time, so it counts the events."""

    def __init__(self, reads: tuple[SdoRead, ...], value_0: int, increment: int) -> None:
        super().__init__(reads, Grid(value_0, abs(increment)))
        self.value_0 = value_0  # where it fires next, as last reported
        self._increment = increment
        self._cell = 0 if increment > 0 else 1  # beside the count that fires next

    def report(
        self, values: Sequence[int], begin_us: float, end_us: float
    ) -> tuple[list[CompareEvent], list[SdoWrite]]:
        status, value_0, _ = values
        fired, rest = divmod(_int32(value_0 - self.value_0), self._increment)
        if rest or fired < 0:  # somebody else has set it
            self.lost = True
            return [], []
        cell = self._cell + (fired if self._increment > 0 else -fired)
        steps = self._straight(self._cell, cell, self._steps, self._read_us, end_us)
        self.value_0, self._cell = value_0, cell
        # Each count fires when it is passed for the first time: nothing is needed of what the
        # drive must have seen, and did not count.
        while self._steps and self._steps[0].t_us < begin_us - SLACK_US:
            self._steps.popleft()
        self._read_us = end_us
        return self._answer(steps, status)


class _CellTracker(_Reported):
    """Where the drive's registers tell in which cell the axis is.

    A turn between two reads leaves no trace in them; there the path has the word.
    """

    def __init__(self, reads: tuple[SdoRead, ...], counts: Counts, position_qc: int) -> None:
        super().__init__(reads, counts)
        self._cell = int(counts.cell(position_qc))  # as the drive has reported it
        self._path_cell = self._cell  # after the steps that have been dealt with

    def _walk_to(
        self, targets: Sequence[int], begin_us: float, end_us: float, moved: bool | None = None
    ) -> list[_Step]:
        """The steps from the cell last reported to one of these; deals with them on the path.

        `moved`: whether there were any, where the drive knows. The path may be behind the drive
        or beside it: it is followed to where it fits best, nearest to the time of the read, and
        from there it is straight to what the drive reports.
        """
        steps = list(self._steps)
        told, cells = self._cell, [self._path_cell, *(step.cell for step in steps)]
        surely = sum(step.t_us < begin_us - SLACK_US for step in steps)
        maybe = sum(step.t_us <= end_us + SLACK_US for step in steps)
        # Steps on the path before it comes to what has been told were told, too.
        begin = cells.index(told) if told in cells else len(cells)
        read_us = (begin_us + end_us) / 2

        def doubt(number: int) -> tuple[int, bool, float]:
            after_us = steps[number - 1].t_us if number else -inf
            before_us = steps[number].t_us if number < len(steps) else inf
            return (
                min(abs(cells[number] - target) for target in targets),
                moved is not None and (number > begin) != moved,
                max(after_us - read_us, read_us - before_us, 0.0),
            )

        possible = range(max(begin, surely), maybe + 1)
        dealt = min(possible, key=doubt, default=surely)
        walk = steps[begin:dealt]
        here = cells[dealt] if possible else told
        self._path_cell = cells[dealt]
        self._cell = min(targets, key=lambda cell: abs(cell - here))
        since_us = walk[-1].t_us if walk else self._read_us
        walk += self._straight(here, self._cell, steps[dealt:], since_us, end_us)
        for _ in range(dealt):
            self._steps.popleft()
        self._read_us = end_us
        return walk


class DualTracker(_CellTracker):
    """Mode 0 with an increment: the two values flank the position."""

    def __init__(self, reads: tuple[SdoRead, ...], grid: Grid, position_qc: int) -> None:
        super().__init__(reads, grid, position_qc)
        self._grid = grid
        self._last = (0, 0, 0.0)  # values, and where the path was, at the last read
        self._due = 0  # matches that came after the flags, but before the values were read
        self._unseen: dict[int, _Step] = {}  # by flag: turns that the path has not shown yet

    def report(
        self, values: Sequence[int], begin_us: float, end_us: float
    ) -> tuple[list[CompareEvent], list[SdoWrite]]:
        status, value_0, value_1 = values
        matches, told = status & MATCHES, self._cell
        # What has matched without a flag was cleared with those of the last read, or came after
        # this one's were read: whichever is nearer.
        cleared_us = (self._read_us + begin_us) / 2
        fresh = matches & ~self._due | sum(self._unseen)
        moved = bool(fresh) if fresh or not matches else None
        walk = self._walk_to(self._between(value_0, value_1), begin_us, end_us, moved)
        if not fresh and told == self._cell:
            walk = []  # a turn that only the path has seen
        # The values move two steps at a time, so every other count is always value 0's.
        parity = self._grid.at_or_below(value_0) % 2
        last_us = {0b010 if step.number % 2 == parity else 0b100: step.t_us for step in walk}
        for flag, value in ((0b010, value_0), (0b100, value_1)):
            if flag in last_us:
                self._unseen.pop(flag, None)
            elif fresh & flag:
                number = self._grid.at_or_below(value)
                out = _Step(begin_us, number, number == self._cell, self._velocity_qc_s)
                first = self._unseen.setdefault(flag, out)
                if first.t_us < begin_us - SLACK_US:  # the drive has the last word
                    walk += [first, first._replace(rising=not first.rising)]
                    del self._unseen[flag]
        self._due = sum(flag for flag, t_us in last_us.items() if t_us > cleared_us) & ~matches
        self._check(value_0, value_1)
        return self._answer(walk, status)

    def _check(self, value_0: int, value_1: int) -> None:
        """At rest the values have to flank the axis, give or take the following error."""
        low, high = min(value_0, value_1), max(value_0, value_1)
        last, self._last = self._last, (value_0, value_1, self._position_qc)
        margin = self._grid.step / 4
        flanked = (
            high - low == self._grid.step
            and (low - self._grid.origin) % self._grid.step == 0
            and low - margin <= self._position_qc <= high + margin
        )
        self.lost = not flanked and last == self._last

    def _between(self, value_0: int, value_1: int) -> tuple[int, ...]:
        """The cells in which the axis can have been when the values were read.

        Where they moved on in the meantime they are no neighbours; then the last one read counts.
        """
        index_0, index_1 = (self._grid.at_or_below(value) for value in (value_0, value_1))
        if abs(index_0 - index_1) == 1:
            return (max(index_0, index_1),)
        return (index_1, index_1 + 1)


class WindowTracker(_CellTracker):
    """Mode 2: the output's level (bit 0 of the status) tells whether the axis is inside.

    The first level that is read, with the axis where it was armed, tells which level is which.
    """

    def __init__(self, reads: tuple[SdoRead, ...], edges: Points, position_qc: int) -> None:
        super().__init__(reads, edges, position_qc)
        self._level_inside: int | None = None

    def report(
        self, values: Sequence[int], begin_us: float, end_us: float
    ) -> tuple[list[CompareEvent], list[SdoWrite]]:
        status = values[0]
        level = status & 1
        if self._level_inside is None:
            self._level_inside = level if self._cell == 1 else 1 - level
        targets = (1,) if level == self._level_inside else (0, 2)
        return self._answer(self._walk_to(targets, begin_us, end_us), status)


@dataclass
class _Flagged:
    """A match of one of the values was flagged some time in between."""

    begin_us: float
    end_us: float
    explained: bool = False  # by a crossing on the path


class FlagTracker(_Reported):
    """Mode 0 without an increment, fixed values: a flag for each says that it was matched.

    How often, the path says: a flag that is set covers every crossing since the last read.
    """

    def __init__(
        self, reads: tuple[SdoRead, ...], counts: Points, registers: tuple[int, int]
    ) -> None:
        super().__init__(reads, counts)
        self._flags = [
            sum(bit for bit, value in zip((0b010, 0b100), registers, strict=True) if value == count)
            for count in counts.counts
        ]
        self._flagged: list[deque[_Flagged]] = [deque() for _ in counts.counts]
        self._told: list[deque[float]] = [deque() for _ in counts.counts]  # times of late events

    def report(
        self, values: Sequence[int], begin_us: float, end_us: float
    ) -> tuple[list[CompareEvent], list[SdoWrite]]:
        status = values[0]
        for flag, flagged, told in zip(self._flags, self._flagged, self._told, strict=True):
            if status & flag:
                # Whatever comes between this read and the clearing is cleared with it.
                new = _Flagged(self._read_us - SLACK_US, end_us + SLACK_US)
                new.explained = any(t_us >= new.begin_us for t_us in told)
                flagged.append(new)
        self._read_us = end_us
        return self._answer(self._judge(end_us - 2 * SLACK_US), status)

    def _judge(self, settled_us: float) -> list[_Step]:
        """What can be told now. Before `settled_us` nothing changes any more."""
        steps: list[_Step] = []
        while self._steps:
            step = self._steps[0]
            covering = [
                flagged
                for flagged in self._flagged[step.number]
                if flagged.begin_us <= step.t_us <= flagged.end_us
            ]
            if not covering and step.t_us > settled_us:
                break  # and so do those that came after it
            self._steps.popleft()
            if covering:
                steps.append(step)
                self._told[step.number].append(step.t_us)
                for flagged in covering:
                    flagged.explained = True
        for index, (all_flagged, told) in enumerate(zip(self._flagged, self._told, strict=True)):
            while all_flagged and all_flagged[0].end_us < settled_us:
                flagged = all_flagged.popleft()
                if not flagged.explained:  # the drive has the last word
                    middle_us = (flagged.begin_us + flagged.end_us) / 2
                    velocity = self._velocity_qc_s
                    steps.append(_Step(middle_us, index, velocity >= 0, velocity))
            while told and told[0] < settled_us - SLACK_US:
                told.popleft()
        return sorted(steps)


class MarkerTracker:
    """The EPOS2's position marker: captured positions, newest first, and how many there were.

    Their times are when the path was where they were captured, newest before the read.
    """

    lost = False

    def __init__(self, reads: tuple[SdoRead, ...]) -> None:
        self.reads = reads
        self.missed = 0  # captured, but overwritten before they were read
        self._counter: int | None = None
        self._paths: deque[Path] = deque()

    def advance(self, path: Path) -> list[CompareEvent]:
        self._paths.append(path)
        return []

    def report(
        self, values: Sequence[int], begin_us: float, end_us: float
    ) -> tuple[list[CompareEvent], list[SdoWrite]]:
        counter, *captured = values
        before, self._counter = self._counter, counter
        if before is None:
            return [], []
        new = (counter - before) % 0x1_0000
        self.missed += max(0, new - len(captured))
        events = []
        until_us = end_us
        for position in captured[: min(new, len(captured))]:
            event = self._when(position, until_us)
            until_us = event.t_us
            events.append(event)
        while len(self._paths) > 1 and self._paths[0].t_us[-1] < begin_us - SLACK_US:
            self._paths.popleft()
        return events[::-1], []

    def _when(self, position_qc: int, until_us: float) -> CompareEvent:
        """The last time before `until_us` when the path entered the count."""
        entered = Points((position_qc, position_qc + 1))
        found = chain.from_iterable(
            _events(crossings(entered, path)) for path in reversed(self._paths)
        )
        into = [
            event
            for event in found
            if event.t_us <= until_us and event.rising == (event.position_qc == position_qc)
        ]
        if into:
            return max(into)._replace(position_qc=position_qc)
        velocity = float(self._paths[-1].velocity_qc_s[-1]) if self._paths else 0.0
        return CompareEvent(until_us, position_qc, velocity, velocity >= 0)


def _events(found: Crossings) -> list[CompareEvent]:
    columns = (found.t_us, found.count, found.velocity_qc_s, found.rising)
    return [CompareEvent(*row) for row in zip(*(c.tolist() for c in columns), strict=True)]


def _int32(value: int) -> int:
    """The difference of two 32-bit registers, which wrap."""
    return (value + 0x8000_0000) % 0x1_0000_0000 - 0x8000_0000
