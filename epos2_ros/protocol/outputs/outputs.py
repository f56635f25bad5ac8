"""All position-triggered outputs of a bus: armed, followed, told as events in joint units.

No I/O: pieces of the axes' paths and answers of drives go in, jobs for SDO and events come out.
A drive is read once for each piece of path, that is once a SYNC; nothing is lost by that.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import inf
from typing import NamedTuple

from epos2_ros.configuration.driver import AxisConfig
from epos2_ros.configuration.outputs import CompareConfig
from epos2_ros.errors import ConfigurationError
from epos2_ros.motion.compare import LATE_US, Prediction, Trigger, difference
from epos2_ros.motion.crossings import Grid, Path
from epos2_ros.motion.units import AxisUnits
from epos2_ros.protocol.frame import Frame
from epos2_ros.protocol.outputs import copley as copley_compare
from epos2_ros.protocol.outputs import epos2 as epos2_compare
from epos2_ros.protocol.outputs.copley import SoftwareOutput
from epos2_ros.protocol.outputs.events import (
    CompareEvent,
    MarkerTracker,
    SingleTracker,
    Tracker,
)
from epos2_ros.protocol.outputs.output import CountScale, Output, check_pins
from epos2_ros.protocol.path_watch import PathWatch
from epos2_ros.protocol.sdo import SdoRead, SdoWrite

SETTLING_US = 300_000.0  # after a motion: what it has fired is reported by then, …
SETTLING_PIECES = 3  # … and when the drive was read so often


class OutputEvent(NamedTuple):
    """An output fired."""

    name: str
    joint: str
    t_us: float  # host time
    position: float  # [unit]
    velocity: float  # [unit/s]


@dataclass(frozen=True)
class SdoJob:
    """Accesses to one drive, in order: first the writes, then the reads."""

    axis: int  # its place among the axes
    output: str
    writes: tuple[SdoWrite, ...] = ()
    reads: tuple[SdoRead, ...] = ()


@dataclass
class Tally:
    """What an output has fired, and how the last motion that was predicted compares."""

    events: int = 0  # in all
    predicted: int | None = None  # of the last motion; None: none yet
    reported: int = 0
    late_us: float = 0.0  # of those times, what is farthest from the prediction
    difference: str = ""  # in words; "" if there is none


@dataclass
class _Run:
    """A motion whose events are held against what was predicted of it."""

    expected: Prediction | None = None
    zero_us: float = inf  # where its predicted times begin, the axis' delay included
    end_us: float = inf
    pieces: int = 0  # of path since its end


@dataclass
class _Armed:
    """An output at work, with what the drive has answered since the last piece of path."""

    axis: int
    output: Output
    tracker: Tracker | None = None
    answer: tuple[Sequence[int], float, float] | None = None
    asked: bool = False
    failing: bool = False  # the last job came to nothing, which has been said
    missed: int = 0  # of a marker
    tally: Tally = field(default_factory=Tally)
    runs: deque[_Run] = field(default_factory=deque)  # begun and not yet compared
    told: list[tuple[int, bool, float]] = field(default_factory=list)  # since the first of them

    @property
    def commanded(self) -> bool:
        """Whether it is the commanded position that fires it."""
        return self.output.config.reference == "commanded"

    def forget(self) -> None:
        """What is under way comes to another end than was predicted."""
        self.runs.clear()
        self.told.clear()


class Outputs:
    """ConfigurationError for what the drives of `axes` can't do."""

    def __init__(
        self,
        axes: Sequence[AxisConfig],
        configs: Sequence[CompareConfig],
        watches: Sequence[PathWatch],
    ) -> None:
        self.watches = tuple(watches)  # [axes]
        self.jobs: deque[SdoJob] = deque()
        self.events: deque[OutputEvent] = deque()
        self.notices: deque[str] = deque()  # for the log
        self._axes = tuple(axes)
        self.units = [AxisUnits.of(axis) for axis in axes]
        self._armed: dict[str, _Armed] = {}
        check_pins(configs)
        joints = [axis.joint for axis in axes]
        for config in configs:
            if config.joint not in joints:
                raise config.refuse("joint", f"the joints are {', '.join(joints)}")
        for index in range(len(axes)):
            for output in self._make(index, configs):
                self._armed[output.config.name] = _Armed(index, output)
                self.notices.extend(CountScale(output.config, self.units[index]).remarks)

    def _make(self, axis: int, configs: Sequence[CompareConfig]) -> Sequence[Output]:
        mine = [config for config in configs if config.joint == self._axes[axis].joint]
        family, units = self._axes[axis].drive, self.units[axis]
        if family == "epos2":
            return epos2_compare.make_outputs(mine, units)
        if family == "copley":
            return copley_compare.make_outputs(mine, units)
        if mine:
            raise mine[0].refuse("joint", f"a drive of family {family} has no such outputs")
        return []

    # ------------------------------------------------------------------ what is told to drives

    def on_axis(self, axis: int) -> list[Output]:
        """The outputs of one drive."""
        return [armed.output for armed in self._armed.values() if armed.axis == axis]

    def find(self, name: str) -> tuple[int, CompareConfig]:
        """The axis of an output, and how it is configured."""
        armed = self._named(name)
        return armed.axis, armed.output.config

    def arm(self, axis: int, position_qc: int) -> list[SdoWrite]:
        """What switches on all outputs of a drive whose axis stands at `position_qc`."""
        mine = [armed for armed in self._armed.values() if armed.axis == axis]
        words = copley_compare.trace_words([armed.output for armed in mine])
        writes = [copley_compare.reserve(words)] if words else []
        for armed in mine:
            writes += self._start(armed, position_qc)
        return writes

    def disarm(self, axis: int) -> list[SdoWrite]:
        """What switches off all outputs of a drive, which are not followed any more."""
        writes: list[SdoWrite] = []
        for armed in self._armed.values():
            if armed.axis == axis:
                armed.tracker = None
                armed.forget()
                writes += armed.output.disarm()
        return writes

    def _start(self, armed: _Armed, position_qc: int) -> list[SdoWrite]:
        armed.tracker = armed.output.tracker(position_qc)
        armed.answer, armed.asked = None, False
        armed.forget()
        self._remark_on_start(armed, position_qc)
        return armed.output.arm(position_qc)

    def _remark_on_start(self, armed: _Armed, position_qc: int) -> None:
        """A sequence fires nothing before its first count is crossed in its direction."""
        trigger, units = armed.output.trigger, self.units[armed.axis]
        if trigger is None or not trigger.sequence or not isinstance(trigger.counts, Grid):
            return
        first = trigger.counts.origin
        if (position_qc >= first) if trigger.rising else (position_qc < first):
            way = "up" if trigger.rising == (units.qc_per_unit > 0) else "down"
            self.notices.append(
                f"compare.{armed.output.config.name}: the axis stands at "
                f"{units.from_qc(float(position_qc)):.9g} {units.unit}; nothing fires before it "
                f"crosses start, {units.from_qc(float(first)):.9g} {units.unit}, on the way {way}"
            )

    def set_positions(self, name: str, positions: Sequence[float]) -> None:
        """A series gets other positions [unit], also while the axis moves."""
        armed = self._named(name)
        before = armed.output
        if not isinstance(before, SoftwareOutput):
            raise before.config.refuse("kind", "only a series takes new positions while in use")
        after = before.with_positions(positions)
        armed.output = after
        armed.tracker = after.tracker(0)
        armed.forget()
        self.jobs.append(SdoJob(armed.axis, name, tuple(after.update(before))))

    def reconfigure(self, config: CompareConfig, position_qc: int) -> list[SdoWrite]:
        """What configures an output anew while its axis stands at `position_qc`."""
        changed = self._named(config.name)
        before = changed.output.config
        if config.joint != before.joint:
            raise config.refuse("joint", "an output can't go to another drive while in use")
        if config.pin != before.pin and self._axes[changed.axis].drive == "epos2":
            raise config.refuse("pin", f"an EPOS2 can't take output {before.pin} back while in use")
        configs = [
            config if armed is changed else armed.output.config for armed in self._armed.values()
        ]
        check_pins(configs)
        mine = [armed for armed in self._armed.values() if armed.axis == changed.axis]
        made = {output.config.name: output for output in self._make(changed.axis, configs)}
        words_before = copley_compare.trace_words([armed.output for armed in mine])
        writes, again = changed.output.disarm(), [changed]
        for armed in mine:
            armed.output = made[armed.output.config.name]
        words = copley_compare.trace_words([armed.output for armed in mine])
        if words != words_before:  # the trace memory is shared out anew, and has to be loaded
            writes.append(copley_compare.reserve(words))
            again = [
                armed
                for armed in mine
                if armed is changed or isinstance(armed.output, SoftwareOutput)
            ]
        for armed in again:
            writes += self._start(armed, position_qc)
        self.notices.extend(CountScale(config, self.units[changed.axis]).remarks)
        return writes

    def _named(self, name: str) -> _Armed:
        if name not in self._armed:
            raise ConfigurationError(
                f"there is no output {name}; the outputs are {', '.join(self._armed) or 'none'}"
            )
        return self._armed[name]

    # ------------------------------------------------------------------ prediction

    def triggers(self, axis: int) -> dict[str, Trigger]:
        """By output, what fires it from now on; of those that positions fire."""
        found = {name: _from_now_on(armed) for name, armed in self._armed.items()}
        return {
            name: trigger
            for name, trigger in found.items()
            if trigger is not None and self._armed[name].axis == axis
        }

    def begin(self, axis: int) -> None:
        """The axis begins a motion that a prediction will be made of."""
        for armed in self._armed.values():
            if armed.axis != axis or armed.output.trigger is None:
                continue
            if armed.runs and armed.runs[-1].expected is None:  # there was no time to predict it
                armed.forget()
            armed.runs.append(_Run())

    def expect(self, predictions: Mapping[str, Prediction]) -> None:
        """By output, the prediction of the motion that began last, instead of an earlier one."""
        for name, prediction in predictions.items():
            if self._armed[name].runs:
                self._armed[name].runs[-1].expected = prediction

    def finished(self, axis: int, start_us: float, end_us: float) -> None:
        """The axis' motion, which was to begin at `start_us`, is over: compare."""
        for armed in self._armed.values():
            if armed.axis == axis and armed.runs:
                delay_us = 0.0 if armed.commanded else self.watches[axis].executed.delay_us
                armed.runs[-1].zero_us, armed.runs[-1].end_us = start_us + delay_us, end_us

    def forget(self, axis: int) -> None:
        """The axis' motion came to another end than was predicted."""
        for armed in self._armed.values():
            if armed.axis == axis:
                armed.forget()

    def tally(self, name: str) -> Tally:
        """What the output has fired so far."""
        return replace(self._named(name).tally)

    def _settle(self, armed: _Armed, now_us: float) -> None:
        """Compare the motion that was over long enough ago for all of it to be reported."""
        run = armed.runs[0] if armed.runs else None
        if run is None or now_us < run.end_us:
            return
        run.pieces += 1
        settled = run.pieces >= SETTLING_PIECES and now_us >= run.end_us + SETTLING_US
        if run.expected is None or not settled:
            return
        armed.runs.popleft()
        from_us = run.zero_us - LATE_US
        until_us = run.end_us + LATE_US if armed.runs else inf  # the next begins after its end
        mine = [event for event in armed.told if from_us <= event[2] < until_us]
        armed.told = [event for event in armed.told if event[2] >= until_us]
        tally, expected = armed.tally, run.expected.fired
        tally.predicted, tally.reported = len(expected), len(mine)
        tally.difference, tally.late_us = difference(expected, mine, run.zero_us)
        if tally.difference:
            self.notices.append(f"compare.{armed.output.config.name}: {tally.difference}")

    # ------------------------------------------------------------------ what comes back

    def receive(self, frame: Frame, t_us: float, echo: bool) -> None:
        """Take in a frame, after those who own the axes have."""
        for axis in {armed.axis for armed in self._armed.values()}:
            path = self.watches[axis].receive(frame, t_us, echo)
            if path is not None:
                self.advance(axis, path)

    def advance(self, axis: int, path: Path) -> None:
        """The axis has gone on along `path`; asks what there is to ask of its drive."""
        executed = self.watches[axis].executed
        for name, armed in self._armed.items():
            tracker = armed.tracker
            if armed.axis != axis or tracker is None:
                continue
            seen = executed.commanded if armed.commanded else path
            self._tell(armed, tracker.advance(seen or path))
            if armed.answer is not None and armed.answer[2] <= path.t_us[-1]:
                self._report(armed, tracker, name)
            if tracker.lost:
                self._rearm(armed, tracker, round(float(path.position_qc[-1])))
            elif tracker.reads and not armed.asked:
                armed.asked = True
                self.jobs.append(SdoJob(axis, name, reads=tracker.reads))
            self._settle(armed, float(path.t_us[-1]))

    def answered(self, job: SdoJob, values: Sequence[int], begin_us: float, end_us: float) -> None:
        """The values that were read for a job, between two times."""
        armed = self._armed[job.output]
        armed.failing = False
        if job.reads and armed.tracker is not None and job.reads == armed.tracker.reads:
            armed.answer = (values, begin_us, end_us)

    def failed(self, job: SdoJob, reason: str) -> None:
        """A job came to nothing; a read is tried again. Said once, until one succeeds."""
        armed = self._armed[job.output]
        if not armed.failing:
            self.notices.append(f"compare.{job.output}: {reason}")
        armed.asked, armed.failing = False, True

    def _report(self, armed: _Armed, tracker: Tracker, name: str) -> None:
        assert armed.answer is not None
        events, writes = tracker.report(*armed.answer)
        armed.answer, armed.asked = None, False
        self._tell(armed, events)
        if writes:
            self.jobs.append(SdoJob(armed.axis, name, tuple(writes)))
        if isinstance(tracker, MarkerTracker) and tracker.missed > armed.missed:
            self.notices.append(
                f"compare.{name}: {tracker.missed - armed.missed} captured positions were "
                "overwritten before they could be read; shorten sync.period"
            )
            armed.missed = tracker.missed

    def _rearm(self, armed: _Armed, tracker: Tracker, position_qc: int) -> None:
        name = armed.output.config.name
        self.notices.append(
            f"compare.{name}: the drive's compare values no longer fit the axis' position "
            "(was it homed, or the drive set by somebody else?); set anew"
        )
        self.jobs.append(SdoJob(armed.axis, name, tuple(self._start(armed, position_qc))))

    def _tell(self, armed: _Armed, events: Sequence[CompareEvent]) -> None:
        units, config = self.units[armed.axis], armed.output.config
        for event in events:
            armed.tally.events += 1
            if armed.runs:
                armed.told.append((event.position_qc, event.rising, event.t_us))
            self.events.append(
                OutputEvent(
                    config.name,
                    config.joint,
                    event.t_us,
                    units.from_qc(float(event.position_qc)),
                    units.from_qc_s(event.velocity_qc_s),
                )
            )


def _from_now_on(armed: _Armed) -> Trigger | None:
    """What is left of a sequence begins at the value that the drive compares with now."""
    trigger, tracker = armed.output.trigger, armed.tracker
    if trigger is None or not isinstance(tracker, SingleTracker):
        return trigger
    last = armed.runs[-1].expected if armed.runs else None
    if last is not None and len(last.fired):  # the drive has not yet reported all of it
        assert isinstance(trigger.counts, Grid)
        step = trigger.counts.step if trigger.rising else -trigger.counts.step
        return trigger.going_on_at(int(last.fired.count[-1]) + step)
    return trigger.going_on_at(tracker.value_0)
