"""All that reaches the protocol layer from outside, into a log and out of it again.

`Machine` does no I/O and reads no clock, so the frames it was given, the requests, the answers to
its own, and the times at which it was called make it do the same again. Here is the one table of
those calls: `record` notes them while the driver runs, `Repeater` makes them again.

Frames are the log's own lines, and every call of `advance` has its place among them.

A log that has lost its beginning can be entered where the axes stood: now and then the numbers in a
machine at rest are noted.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from typing import Any

import numpy as np

from epos2_ros.buslog.state import numbers_in, put_numbers
from epos2_ros.buslog.writer import LogWriter
from epos2_ros.errors import TrajectoryError
from epos2_ros.motion.reference import Reference
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.protocol.drive import Drive
from epos2_ros.protocol.machine import Machine
from epos2_ros.protocol.path import Placement
from epos2_ros.protocol.phase import Phase

# Of the group, …
REQUESTS = ("enable", "disable", "halt", "quick_stop", "reset_fault")
REPORTS = ("start_clock", "reconfigured", "fail", "bus_failed")
# … and of the path commander, whose other methods go by these.
TRAJECTORIES = ("place", "commit")
STOPS = ("stop", "drop_waiting")
POINTS_PER_LINE = 50  # so few that making a line keeps no other thread waiting
STATE_US = 20_000_000.0  # so often the numbers of a machine at rest are noted
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
        self._state_us = -math.inf  # when the group's state was noted
        self._last: Trajectory | None = None
        self._placed = 0
        self._placements: OrderedDict[int, Placement] = OrderedDict()
        for name in REQUESTS + REPORTS:
            self._watch(group, name, self._noting(name))
        self._watch(machine, "receive", self._note_frame)
        self._watch(machine, "advance", self._note_advance)
        self._watch(machine, "move_to", self._noting("move_to"))
        self._watch(machine, "home", self._noting("home"))
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
            self._inside = True
            result: Any = None
            try:
                result = method(*arguments, **named)
            except TrajectoryError as error:
                result = error
                raise
            finally:
                self._inside = False
                note((*arguments, *named.values()), result)
            return result

        setattr(target, name, call)

    def _noting(self, name: str) -> Note:
        def note(arguments: tuple[Any, ...], result: Any) -> None:
            written = list(map(self._written, arguments))
            self._log.event(self._now_us(), name, written or None)
            if isinstance(result, Future) and name in REQUESTS:
                result.add_done_callback(lambda answer: self._note_answer(name, answer))

        return note

    def _written(self, argument: Any) -> Any:
        if isinstance(argument, Drive):
            return self._machine.drives.index(argument)
        return argument.hex() if isinstance(argument, bytes) else argument

    def _note_answer(self, name: str, answer: Future[None]) -> None:
        error = None if answer.cancelled() else answer.exception()
        self._log.event(self._now_us(), "answer", [name, "" if error is None else str(error)])

    def _note_frame(self, arguments: tuple[Any, ...], result: Any) -> None:
        frame, t_us, echo = (*arguments, False)[:3]
        self._log.frame(t_us, frame.can_id, frame.data, echo)
        if t_us > self._state_us + STATE_US and self._at_rest:
            self._state_us = t_us
            state = {"phase": self._group.phase.value, "parts": numbers_in(self._machine)}
            self._log.event(self._now_us(), "state", state)

    @property
    def _at_rest(self) -> bool:
        group, out = self._group, self._machine.out
        waiting = out.frames or out.requests or out.events or out.unanswered
        return group.phase in AT_REST and group.time.running and not waiting

    def _note_advance(self, arguments: tuple[Any, ...], result: Any) -> None:
        now_us = arguments[0]
        exact = round(now_us, 3) == now_us  # as a host's clock is, which counts nanoseconds
        self._log.event(now_us, "advance", None if exact else {"now_us": now_us})

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
        self._refused: dict[int, str] = {}

    def event(self, t_us: float, name: str, data: Any) -> str:
        """Repeats one; in words, what came of it otherwise than it did, or "".

        ValueError, TypeError, KeyError or IndexError for data that no driver has written.
        """
        group = self._group
        if name == "advance":
            now_us = (data or {}).get("now_us", t_us)
            self._machine.advance(now_us)
        elif name == "start_clock":
            group.start_clock(data[0], bytes.fromhex(data[1]), *data[2:])
        elif name == "reconfigured":
            index, *rest = data
            group.reconfigured(self._machine.drives[index], *rest)
        elif name == "move_to":
            self._machine.move_to(*data)
        elif name == "home":
            self._machine.home(*data)
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
        """Put a machine that has done nothing yet into the state that was noted."""
        self._group.phase = Phase(state["phase"])
        put_numbers(self._machine, state["parts"])

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
        except TrajectoryError as error:
            return "" if refusal == str(error) else f"the trajectory would be refused: {error}"
        try:
            self._placements[number] = placement, placement.join()
        except TrajectoryError as error:
            self._refused[number] = str(error)  # as it was then, unless it is committed
        return f"the trajectory was refused: {refusal}; now it would not be" if refusal else ""

    def _commit(self, number: int, done: bool | str) -> str:
        if number in self._refused:
            return f"the trajectory would be refused: {self._refused.pop(number)}"
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
