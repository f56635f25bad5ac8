"""What the drives say of their buffers when they are asked: free records, or the next wanted.

No PDO can carry the free records of an EPOS2 (the application note maps 0x60C4-02, the maker's
dictionaries don't allow it), so the host keeps books (`buffer_account`) and asks now and then:
every drive before a start, which has to report every record that was sent; in motion one after
another, each once in LEVEL_ROUND_US. A lost record may then be found before it is due, and else
by the position demand (`path_audit`) once it is. One answer in motion may be wrong by what was on
its way: the drive is asked again soon, and a second one in a row is a fault.

Somebody else does the asking, by SDO; the answer is seen on the bus as any other frame.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

from epos2_ros.protocol.pvt.axis import PvtAxis

LEVEL_ROUND_US = 2_000_000.0
ASK_AGAIN_US = 50_000.0  # a drive whose answer was not what it has to be


class BufferReads:
    """Puts indices of axes to be asked into `outbox`."""

    def __init__(self, axes: Sequence[PvtAxis]) -> None:
        self.outbox: deque[int] = deque()
        self._axes = axes
        self._pause_us = LEVEL_ROUND_US / max(len(axes), 1)
        self.begin()

    def begin(self) -> None:
        """A new motion: what was reported is of the last one."""
        self._asked_us = [-math.inf for _ in self._axes]
        self._awaited: set[int] = set()
        self._suspects: set[int] = set()  # axes whose last answer was wrong
        self._mute: set[int] = set()  # axes that have failed to answer
        self._next = 0
        self._due_us = -math.inf

    # ------------------------------------------------------------------ before the start

    def unreported(self) -> list[PvtAxis]:
        """Axes that have not yet reported every record they were sent."""
        return [axis for axis in self._axes if not axis.account.reported]

    def ask_all(self, now_us: float) -> None:
        """Ask whoever has not reported all of its records, once these are on the bus."""
        for index, axis in enumerate(self._axes):
            waiting = index in self._awaited or now_us < self._asked_us[index] + ASK_AGAIN_US
            if not (waiting or axis.account.reported) and axis.account.all_on_bus:
                self._ask(index, now_us)

    # ------------------------------------------------------------------ in motion

    @property
    def due_us(self) -> float:
        """When `watch` is wanted next."""
        urgent_us = min(
            (axis.account.ask_us for i, axis in enumerate(self._axes) if i not in self._awaited),
            default=math.inf,
        )
        return min(urgent_us, math.inf if self._awaited else self._due_us)

    def watch(self, now_us: float) -> None:
        """Ask who has to be asked, and the next drive when it is due; one at a time."""
        for index, axis in enumerate(self._axes):
            if axis.account.ask_us <= now_us and index not in self._awaited:
                self._ask(index, now_us)
        if self._axes and not self._awaited and now_us >= self._due_us:
            self._due_us = now_us + self._pause_us
            self._ask(self._next, now_us)
            self._next = (self._next + 1) % len(self._axes)

    # ------------------------------------------------------------------ answers

    def answer(
        self,
        index: int,
        value: int,
        asked_us: float,
        from_ms: float | None,
        to_ms: float | None,
    ) -> str:
        """What a drive said of its buffer some time between two path times (None: not started).

        It was asked at host time `asked_us`. What is wrong with the answer, or "".
        """
        axis = self._axes[index]
        self._awaited.discard(index)
        wrong = axis.account.report(value, asked_us, from_ms, to_ms)
        if not wrong:
            self._suspects.discard(index)
            if axis.account.reported:
                self._asked_us[index] = -math.inf  # it may be asked at once for what comes next
        elif to_ms is not None:
            if index in self._suspects:
                return wrong
            self._suspects.add(index)
            self._next, self._due_us = index, asked_us + ASK_AGAIN_US
        return ""

    def unanswered(self, index: int) -> bool:
        """A drive could not be asked; whether for the first time in this motion."""
        self._awaited.discard(index)
        first = index not in self._mute
        self._mute.add(index)
        return first

    def _ask(self, index: int, now_us: float) -> None:
        self._asked_us[index] = now_us
        self._axes[index].account.asked(now_us)
        self._awaited.add(index)
        self.outbox.append(index)
