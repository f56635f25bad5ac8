"""Position-triggered outputs in random scenarios, armed as the driver does.

What the simulated drives really fired is the truth: no output fires where none was configured, and
where nothing was in the way what the driver reports is what has fired. At places where an axis
rests or turns within some counts of a position, how often it has passed there between two reports
nobody can tell; those don't count.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from typing import Any

from simulated_time import Bench

from epos2_ros.bus.sdo_jobs import perform, read_position, write_all
from epos2_ros.configuration.outputs import CompareConfig
from epos2_ros.errors import DriveError
from epos2_ros.protocol.frame import Frame
from epos2_ros.protocol.outputs.outputs import OutputEvent, Outputs
from epos2_ros.protocol.path_watch import PathWatch, ProfilePathWatch, RecordPathWatch
from epos2_ros.sim.copley import Copley

KINDS = (*[""] * 6, "interval", "crossing")  # of an axis; "": none
START, INTERVAL, CROSSING = 0.003, 0.007, 0.02  # [unit]
NEAR_QC = 5  # of where an axis was slow
SLOW_QC = 4  # so far it goes, at most, from one look to the next where it is slow
REPORTED_S = 0.5  # after an axis has come to rest, and four SYNCs: all is reported


def config_of(joint: str, kind: str) -> CompareConfig:
    """An output of an axis."""
    if kind == "interval":
        return CompareConfig(joint, joint, kind, start=START, interval=INTERVAL)
    return CompareConfig(joint, joint, kind, positions=(CROSSING,))


class StageOutputs:
    """The outputs of a bench, one at most on each axis, and what is asked of them."""

    def __init__(self, bench: Bench, configs: Sequence[CompareConfig]) -> None:
        machine, axes = bench.machine, bench.config.axes
        watches: dict[str, PathWatch] = {d.joint: ProfilePathWatch(d) for d in machine.drives}
        for axis in machine.interpolated.axes:
            watches[axis.drive.joint] = RecordPathWatch(bench.group, axis)
        self.outputs = Outputs(axes, configs, [watches[axis.joint] for axis in axes])
        self.places = [place for place in range(len(axes)) if self.outputs.on_axis(place)]
        self.reported: list[OutputEvent] = []
        self._bench = bench
        self._from = {place: len(self._fired(place)) for place in self.places}
        self._slow: dict[int, set[int]] = {place: set() for place in self.places}
        self._last_qc: dict[int, float] = {}
        self._arm_when: list[tuple[list[int], Callable[[], bool]]] = []

    # ------------------------------------------------------------------ the driver's way

    def arm(self, place: int) -> None:
        """As `OutputService.arm`; DriveError."""
        if place in self.places:
            node = self._bench.nodes[place].node
            write_all(node, self.outputs.arm(place, read_position(node)))

    def disarm(self, place: int) -> None:
        """As `OutputService.disarm`; DriveError."""
        if place in self.places:
            write_all(self._bench.nodes[place].node, self.outputs.disarm(place))

    def arm_when(self, places: Iterable[int], done: Callable[[], bool]) -> None:
        """Soon after `done()`, as `Driver.home`."""
        self._arm_when.append((list(places), done))

    def receive(self, frame: Frame, t_us: float, echo: bool) -> None:
        """After the machine."""
        self.outputs.receive(frame, t_us, echo)
        self.reported += self.outputs.events
        self.outputs.events.clear()

    @property
    def waiting(self) -> bool:
        """Whether `work` has something to do."""
        return bool(self.outputs.jobs) or any(done() for _, done in self._arm_when)

    def work(self) -> None:
        """As the worker."""
        bench = self._bench
        while self.outputs.jobs:
            job = self.outputs.jobs.popleft()
            node = bench.nodes[job.axis].node
            try:
                answer = perform(node, job, lambda: bench.now_us)
            except DriveError as error:
                self.outputs.failed(job, str(error))
            else:
                self.outputs.answered(job, *answer)
        for waiting in [waiting for waiting in self._arm_when if waiting[1]()]:
            self._arm_when.remove(waiting)
            lost = bench.lost()
            for place in waiting[0]:
                if place not in lost:
                    with suppress(DriveError):  # what `Driver.home` answers with
                        self.arm(place)

    # ------------------------------------------------------------------ what is asked of them

    def begin(self) -> None:
        """What has been fired and reported so far does not count."""
        self.reported.clear()
        for place in self.places:
            self._from[place] = len(self._fired(place))
            self._slow[place].clear()

    def look(self, place: int, shaft_qc: float) -> None:
        """Where an axis is now, every few milliseconds."""
        if place in self._slow:
            if abs(shaft_qc - self._last_qc.get(place, shaft_qc)) <= SLOW_QC:
                self._slow[place].add(round(shaft_qc))
            self._last_qc[place] = shaft_qc

    def astray(self) -> str:
        """What was fired where nothing was to be fired; "" if nothing."""
        for place in self.places:
            drive = self._bench.drives[place]
            for value, _ in self._fired_since(place):
                if not self._configured(place, value):
                    return f"{self._joint(place)}: {drive} has fired at {value} qc"
        return ""

    def difference(self) -> str:
        """What was fired and not reported, or the other way round; "" if nothing."""
        for place in self.places:
            to_qc = self.outputs.units[place].to_qc
            reported = [
                (round(to_qc(event.position)), event.velocity > 0)
                for event in self.reported
                if event.joint == self._joint(place)
            ]
            fired = self._clear(place, self._fired_since(place))
            told = self._clear(place, reported)
            if fired != told:
                missing, invented = Counter(fired), Counter(told)
                missing.subtract(told)
                invented.subtract(fired)
                return (
                    f"{self._joint(place)}: not reported {sorted((+missing).elements())[:5]}, not "
                    f"fired {sorted((+invented).elements())[:5]} [qc, upward]; {len(fired)} fired"
                )
        return ""

    def _joint(self, place: int) -> str:
        return self._bench.config.axes[place].joint

    def _fired(self, place: int) -> list[Any]:
        drive: Any = self._bench.drives[place]
        return drive.module.fired if isinstance(drive, Copley) else drive.fired

    def _fired_since(self, place: int) -> Iterator[tuple[int, bool]]:
        for fired in self._fired(place)[self._from[place] :]:
            yield fired.value, fired.rising

    def _clear(self, place: int, events: Iterable[tuple[int, bool]]) -> list[tuple[int, bool]]:
        slow = self._slow[place]
        return [
            (value, rising)
            for value, rising in events
            if not any(value + n in slow for n in range(-NEAR_QC, NEAR_QC + 1))
        ]

    def _configured(self, place: int, value: int) -> bool:
        units, config = self.outputs.units[place], self.outputs.on_axis(place)[0].config
        if config.kind == "crossing":
            return value == round(units.to_qc(CROSSING))
        width = round(units.to_qc(START + INTERVAL)) - round(units.to_qc(START))
        return (value - round(units.to_qc(START))) % width == 0
