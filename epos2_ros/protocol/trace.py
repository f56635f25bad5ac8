"""Every step of the axes as lines: state walks, phases, batches of records, corrections of clocks.

It looks at what others keep anyway and costs nothing where there is none.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from epos2_ros.protocol.machine import Machine


class Trace:
    """`watch` after everything that may have changed something; `tell` gets the lines."""

    def __init__(self, machine: Machine, tell: Callable[[str], None]) -> None:
        self._group = machine.group
        self._time = machine.time
        self._followers = machine.interpolated.axes
        self._tell = tell
        self._shown: dict[str, Any] = {"sync": machine.time.sync_count}
        self._told = self._sent()  # records of each axis, as last told
        self._sent_before = self._told

    def watch(self) -> None:
        """Tell what has changed since the last call."""
        group = self._group
        self._show("group", group.phase.value, group.reason)
        for drive in group.drives:
            self._show(str(drive), drive.state.value, f"statusword {drive.statusword:04X}h")
        self._show_records()
        self._show_clocks()

    def _show(self, name: str, value: str, why: str) -> None:
        before = self._shown.get(name)
        if before != value:
            self._shown[name] = value
            if before is not None:
                self._tell(f"{name}: {before} → {value}" + (f" ({why})" if why else ""))

    def _sent(self) -> list[int]:
        return [axis.account.sent for axis in self._followers]

    def _show_records(self) -> None:
        """A batch is told when no more records come."""
        sent = self._sent()
        if sent == self._sent_before and sent != self._told:
            parts = []
            for axis, now, before in zip(self._followers, sent, self._told, strict=True):
                new = now - before if now >= before else now  # of a motion that has begun since
                if new:
                    parts.append(f"{axis.drive.joint} {new} (up to {axis.account.committed_ms} ms)")
            if parts:
                self._tell(f"records sent: {', '.join(parts)}")
            self._told = sent
        self._sent_before = sent

    def _show_clocks(self) -> None:
        time = self._time
        if self._shown.get("sync") != time.sync_count:
            self._shown["sync"] = time.sync_count
            offsets = zip(time.drives, time.clock.offset_us.tolist(), strict=True)
            off = ", ".join(
                f"{drive.joint} {offset_us:+.1f}"
                for drive, offset_us in offsets
                if math.isfinite(offset_us)
            )
            off = off or "(not known yet)"
            self._tell(f"SYNC {time.sync_count}: clocks were off by [us] {off}")
