"""All that reaches the protocol layer from outside, into a log and out of it again.

`Machine` does no I/O and reads no clock, so the frames it was given, the requests, the answers to
its own, and the times at which it was called make it do the same again. Here is the one table of
those calls: `record` notes them while the driver runs, `Repeater` makes them again.

Of the calls of `advance`, those are noted that did something or were due. Frames are the log's own
lines.

A log that has lost its beginning can be entered where the axes stood: now and then, at a SYNC, the
little is noted that a group at rest has to know. Its clock goes its own way from there.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from typing import Any

import numpy as np

from epos2_ros.buslog.writer import LogWriter
from epos2_ros.errors import TrajectoryError
from epos2_ros.motion.reference import Reference
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.protocol import epos2
from epos2_ros.protocol.frame import Frame
from epos2_ros.protocol.group import Phase
from epos2_ros.protocol.machine import Machine
from epos2_ros.protocol.path import Placement

REQUESTS = ("enable", "disable", "halt", "quick_stop", "reset_fault")
STOPS = ("stop", "drop_waiting")
REPORTS = ("start_clock", "fail", "bus_failed")
POINTS_PER_LINE = 50  # so few that making a line keeps no other thread waiting
STATE_US = 5_000_000.0  # so often what a group at rest has to know is noted
EARLY_US = 1_000.0  # so long before a SYNC is seen on the bus it may have been due
AT_REST = (Phase.DISABLED, Phase.STANDING, Phase.FAULT)
PLACEMENTS_KEPT = 16  # between being worked out and being committed

Note = Callable[[tuple[Any, ...], Any], None]  # the arguments of a call, and what it returned


def record(machine: Machine, log: LogWriter, now_us: Callable[[], float]) -> None:
    """From now on what is asked of `machine` goes into `log`."""
    _Recorder(machine, log, now_us)


class _Recorder:
    """Stands between whoever calls and the methods of the machine and its parts."""

    def __init__(self, machine: Machine, log: LogWriter, now_us: Callable[[], float]) -> None:
        group, path = machine.group, machine.path
        self._machine = machine
        self._group = group
        self._log = log
        self._now_us = now_us
        self._inside = False  # a call of ours is running: what it calls is its own doing
        self._phase = group.phase
        self._sending = 0  # frames that waited to be sent before the call
        self._due_us = -math.inf  # when `advance` was wanted
        self._time_us: float | None = None  # when TIME was on the bus
        self._state_us = -math.inf  # when the group's state was noted
        self._last: Trajectory | None = None
        self._placed = 0
        self._placements: OrderedDict[int, Placement] = OrderedDict()
        for name in REQUESTS + REPORTS:
            self._watch(group, name, self._noting(name))
        self._watch(group, "reconfigured", self._note_drive)
        self._watch(machine, "receive", self._note_frame)
        self._watch(machine, "advance", self._note_advance)
        self._watch(machine, "move_to", self._noting("move_to"))
        self._watch(machine.out, "answer", self._noting("sdo"))
        self._watch(path, "place", self._note_placement)
        self._watch(path, "commit", self._note_commit)
        for name in STOPS:
            self._watch(path, name, self._noting(name))

    def _watch(self, target: object, name: str, note: Note) -> None:
        method = getattr(target, name)

        def call(*arguments: Any, **named: Any) -> Any:
            if self._inside:
                return method(*arguments, **named)
            self._inside, self._sending = True, len(self._machine.out.frames)
            self._due_us = self._group.deadline_us
            result: Any = None
            try:
                result = method(*arguments, **named)
            except TrajectoryError as error:
                result = error
                raise
            finally:
                self._inside = False
                note((*arguments, *named.values()), result)
                self._phase = self._group.phase
            return result

        setattr(target, name, call)

    def _noting(self, name: str) -> Note:
        def note(arguments: tuple[Any, ...], result: Any) -> None:
            written = [a.hex() if isinstance(a, bytes) else a for a in arguments]
            self._log.event(self._now_us(), name, written or None)
            if isinstance(result, Future) and name in REQUESTS:
                result.add_done_callback(lambda answer: self._note_answer(name, answer))

        return note

    def _note_drive(self, arguments: tuple[Any, ...], result: Any) -> None:
        drive, *rest = arguments
        written = [self._machine.drives.index(drive), *rest]
        self._log.event(self._now_us(), "reconfigured", written)

    def _note_answer(self, name: str, answer: Future[None]) -> None:
        error = None if answer.cancelled() else answer.exception()
        self._log.event(self._now_us(), "answer", [name, "" if error is None else str(error)])

    def _note_frame(self, arguments: tuple[Any, ...], result: Any) -> None:
        frame, t_us, echo = (*arguments, False)[:3]
        self._log.frame(t_us, frame.can_id, frame.data, echo)
        if frame.can_id == epos2.TIME and echo:
            self._time_us = t_us
        elif frame.can_id == epos2.SYNC and t_us > self._state_us + STATE_US:
            self._note_state(t_us)

    def _note_state(self, t_us: float) -> None:
        group = self._group
        if group.phase in AT_REST and self._time_us is not None:
            self._state_us = t_us
            state = {
                "phase": group.phase.value,
                "reason": group.reason,
                "requests": self._machine.out.count,
                "now_us": t_us,
                "time_us": self._time_us,
                "statuswords": [drive.statusword for drive in group.drives],
                "demands_qc": [drive.demand_qc for drive in group.drives],
            }
            self._log.event(t_us, "state", state)

    def _note_advance(self, arguments: tuple[Any, ...], result: Any) -> None:
        group, now_us = self._group, arguments[0]
        data = {} if group.phase is self._phase else {"phase": group.phase.value}
        if round(now_us, 3) != now_us:  # no host's clock, which counts nanoseconds
            data["now_us"] = now_us
        out = self._machine.out
        sent = len(out.frames) > self._sending
        if sent or out.requests or group.phase is not self._phase or now_us >= self._due_us:
            self._log.event(now_us, "advance", data or None)

    def _note_placement(self, arguments: tuple[Any, ...], result: Any) -> None:
        trajectory, stamp_us, now_us, lead_ms = (*arguments, 0)[:4]
        if trajectory is not self._last:
            self._last = trajectory
            for piece in _pieces(trajectory):
                self._log.event(now_us, "points", piece)
        self._placed += 1
        if isinstance(result, Placement):
            self._placements[self._placed] = result
            if len(self._placements) > PLACEMENTS_KEPT:
                self._placements.popitem(last=False)
        refusal = str(result) if isinstance(result, TrajectoryError) else ""
        self._log.event(now_us, "place", [self._placed, stamp_us, now_us, lead_ms, refusal])

    def _note_commit(self, arguments: tuple[Any, ...], result: Any) -> None:
        placement = arguments[0]
        number = next(n for n, placed in self._placements.items() if placed is placement)
        del self._placements[number]
        done = result if isinstance(result, bool) else str(result)
        self._log.event(self._now_us(), "commit", [number, done])


def _pieces(trajectory: Trajectory) -> Iterator[Callable[[], dict[str, Any]]]:
    """A trajectory as data of several events, each made when it is written."""

    def piece(begin: int) -> dict[str, Any]:
        part = slice(begin, begin + POINTS_PER_LINE)
        fields = ("positions", "velocities", "accelerations")
        arrays = {name: getattr(trajectory, name) for name in fields}
        return {
            "joint_names": trajectory.joint_names,
            "stamp_s": trajectory.stamp_s,
            "from": begin,
            "of": len(trajectory.times_s),
            "times_s": trajectory.times_s[part].tolist(),
            **{name: a[part].tolist() for name, a in arrays.items() if a is not None},
        }

    for begin in range(0, max(1, len(trajectory.times_s)), POINTS_PER_LINE):
        yield lambda begin=begin: piece(begin)  # type: ignore[misc]


class Repeater:
    """Calls the methods of `machine` as a log says. Times are host µs."""

    def __init__(self, machine: Machine) -> None:
        self.trajectory: Trajectory | None = None  # the last one that was placed
        self._machine = machine
        self._group = machine.group
        self._path = machine.path
        self._pieces: list[dict[str, Any]] = []
        self._placements: dict[int, tuple[Placement, Reference]] = {}

    def event(self, t_us: float, name: str, data: Any) -> str:
        """Repeats one; in words, what came of it otherwise than it did, or "".

        ValueError, TypeError, KeyError or IndexError for data that no driver has written.
        """
        group = self._group
        if name == "advance":
            now_us = (data or {}).get("now_us", t_us)
            self._machine.advance(now_us)
        elif name == "start_clock":
            group.start_clock(data[0], bytes.fromhex(data[1]))
        elif name == "reconfigured":
            index, *rest = data
            group.reconfigured(self._machine.drives[index], *rest)
        elif name == "move_to":
            self._machine.move_to(*data)
        elif name == "sdo":
            self._machine.out.answer(*data)
        elif name in REQUESTS + REPORTS:
            getattr(group, name)(*(data or ()))
        elif name == "points":
            self._gather(data)
        elif name == "place":
            return self._place(*data)
        elif name == "commit":
            return self._commit(*data)
        elif name in STOPS:
            getattr(self._path, name)(*(data or ()))
        return ""

    def enter(self, state: dict[str, Any]) -> None:
        """Put a group that has done nothing yet into the state that was noted at a SYNC."""
        group, now_us = self._group, state["now_us"]
        for index, statusword in enumerate(state["statuswords"]):
            drive = group.drives[index]
            group.reconfigured(drive, statusword, now_us)
            drive.demand_qc = state["demands_qc"][index]
        group.start_clock(now_us - EARLY_US, b"")
        group.receive(Frame(epos2.TIME), state["time_us"], echo=True)
        self._machine.out.frames.clear()
        self._machine.out.count = state["requests"]
        group.enter(Phase(state["phase"]), state["reason"])

    def _gather(self, piece: dict[str, Any]) -> None:
        if not piece["from"]:
            self._pieces = []
        self._pieces.append(piece)
        if piece["from"] + len(piece["times_s"]) < piece["of"]:
            return
        whole = {
            name: [row for part in self._pieces for row in part[name]]
            for name in ("times_s", "positions", "velocities", "accelerations")
            if name in piece
        }
        arrays: dict[str, Any]
        arrays = {name: np.array(rows, dtype=np.float64) for name, rows in whole.items()}
        self.trajectory = Trajectory(
            joint_names=tuple(piece["joint_names"]), stamp_s=piece["stamp_s"], **arrays
        )
        self._pieces = []

    def _place(
        self, number: int, stamp_us: float | None, now_us: float, lead_ms: int, refusal: str
    ) -> str:
        if self.trajectory is None:
            raise ValueError("the trajectory is not in the log")
        try:
            placement = self._path.place(self.trajectory, stamp_us, now_us, lead_ms)
            self._placements[number] = placement, placement.join()
        except TrajectoryError as error:
            return "" if refusal == str(error) else f"the trajectory would be refused: {error}"
        return f"the trajectory was refused: {refusal}" if refusal else ""

    def _commit(self, number: int, done: bool | str) -> str:
        if number not in self._placements:
            return ""  # said when it was placed
        try:
            would: bool | str = self._path.commit(*self._placements.pop(number))
        except TrajectoryError as error:
            would = str(error)
        if would == done:
            return ""
        return f"the trajectory {_outcome(done)}; now it {_outcome(would)}"


def _outcome(done: bool | str) -> str:
    """Of committing a trajectory, in words."""
    if isinstance(done, str):
        return f"was refused ({done})"
    return "was taken" if done else "came too late, to be placed anew"
