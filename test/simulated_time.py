"""The real group, transmitter and bring-up against simulated drives, in simulated time.

No thread, no wall clock: `run` jumps from event to event, so minutes of motion take seconds and
every run with the same arguments is the same.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import replace

import numpy as np

from epos2_ros.bus.link import Network
from epos2_ros.bus.nodes import node_of
from epos2_ros.bus.sdo_client import ATTEMPTS
from epos2_ros.bus.sdo_jobs import perform
from epos2_ros.bus.settings import machine_of
from epos2_ros.bus.transmitter import Transmitter
from epos2_ros.configuration.driver import AxisConfig, DriverConfig
from epos2_ros.errors import DriveError
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.protocol.clock import time_of_day
from epos2_ros.protocol.frame import Frame
from epos2_ros.protocol.group import Group
from epos2_ros.protocol.intake import SDO_RESPONSE, Rejects, intake_of
from epos2_ros.protocol.outbox import Event, Poll, SdoRequest
from epos2_ros.protocol.phase import Phase, follows
from epos2_ros.protocol.sdo import SdoRead, SdoWrite
from epos2_ros.protocol.whereabouts import Whereabouts
from epos2_ros.sim.can_bus import Remote, SimulatedBus, TransmitQueueFull
from epos2_ros.sim.cl3e import Cl3e
from epos2_ros.sim.copley import Copley
from epos2_ros.sim.epos2 import Epos2

SDO_PATIENCE_US = 300_000.0  # as long as canopen waits
POLL_PATIENCE_US = 50_000.0  # as `Poller`, …
BUSY_US = 20_000.0  # … with whoever has something else to answer


def axes(count: int = 6, **changes: object) -> tuple[AxisConfig, ...]:
    """`count` axes as in the shared examples: 2000 counts, gear 100."""
    settings: dict[str, object] = {"counts_per_turn": 2000, "gear_ratio": 100.0, **changes}
    return tuple(
        AxisConfig(f"joint_{n}", n, **settings)  # type: ignore[arg-type]
        for n in range(1, count + 1)
    )


def makers(*families: str, **changes: object) -> tuple[AxisConfig, ...]:
    """As `axes`, one for each of these drives."""
    plain = axes(len(families), **changes)
    return tuple(replace(axis, drive=drive) for axis, drive in zip(plain, families, strict=True))


def drive_of(axis: AxisConfig, **settings: object) -> Epos2 | Copley | Cl3e:
    """The simulated drive of an axis; it has been there for a while."""
    if axis.drive == "cl3e":
        settings.pop("offset_us", None)  # it has no clock that could be read
        drive = Cl3e(axis.node_id, boot_ms=0.0, **settings)  # type: ignore[arg-type]
        drive.dictionary[0x608F, 1].preset(axis.counts_per_turn)
        return drive
    kind = Copley if axis.drive == "copley" else Epos2
    return kind(axis.node_id, **settings)  # type: ignore[arg-type]


class Bench:
    """Driver side and drives on one simulated bus.

    `stamp_us(t)`: the host's time stamp of a frame that was on the bus at `t`.
    `late_us()`: by how much the host's thread wakes up late.
    `host_queue`: frames the adapter takes before it is full; None: without end.
    `bus`: that of an earlier host, with the drives on it.
    """

    sdo_patience_s = 0.01  # by the clock of canopen: what is silent in simulated time stays silent

    def __init__(
        self,
        config: DriverConfig | None = None,
        drives: Sequence[Epos2 | Copley | Cl3e] | None = None,
        bring_up: bool = True,
        host_queue: int | None = None,
        bus: SimulatedBus | None = None,
    ) -> None:
        self.config = config or DriverConfig(axes=axes())
        self.bus = bus or SimulatedBus(bitrate=self.config.bitrate, host_queue=host_queue)
        self.stamp_us: Callable[[float], float] = lambda t_us: t_us
        self.late_us: Callable[[], float] = lambda: 0.0
        self.drives = list(drives or map(drive_of, self.config.axes))
        for drive in self.drives if bus is None else ():
            self.bus.add(drive)
        self.machine = machine_of(self.config)
        self.group, self.path = self.machine.group, self.machine.path
        self.whereabouts = Whereabouts(self.machine)
        self._hold_to_its_phases(self.group)
        self.feeder = self.machine.interpolated.feeder
        self.rejects = Rejects()
        self.intake = intake_of(self.machine.drives, self.rejects)
        self.transmitter = Transmitter(self._hand_over, self.config.bitrate, echoes=True)
        self.network = Network(self._send_service)
        self.nodes = [node_of(self.network, axis, self.config) for axis in self.config.axes]
        self.frames: list[tuple[float, Frame, bool]] = []  # all that was on the bus: time, echo
        self.events: list[Event] = []
        self.on_event: Callable[[Event], object] = lambda event: None
        self._due_us = 0.0  # until when the bus runs on without the driver
        self._until: Callable[[], bool] = lambda: False
        self._done_us = -math.inf  # a frame came then, and what was due was done
        self._answered = False  # what canopen asked
        self._serving = False  # canopen waits
        self._job: SdoRequest | None = None  # at work
        self._left: list[SdoWrite | SdoRead] = []  # of it
        self._values: list[int] = []
        self._asked_us = 0.0
        self._unpolled: dict[int, bytes] = {}  # nodes that are to be asked, and what
        self._polled: set[int] = set()  # nodes whose answer to a poll is to come
        self._polled_us = 0.0
        if bring_up:
            self.bring_up()

    @property
    def now_us(self) -> float:
        return self.bus.now_us

    # ------------------------------------------------------------------ the driver's way

    def bring_up(self) -> None:
        """As `Driver.configure`."""
        for index in range(len(self.nodes)):
            self.bring_up_drive(index)
        self.start_clock()

    def start_clock(self) -> None:
        """As `Driver._bring_up`, when the drives are brought up."""
        self.group.start_clock(self.now_us, time_of_day(1_700_000_000))
        self._flush()
        self._produce_sync(round(self.config.sync_period * 1e6))

    def _produce_sync(self, period_us: int) -> None:
        if self.config.sync_producer != "host":
            producer = [axis.joint for axis in self.config.axes].index(self.config.sync_producer)
            self.nodes[producer].produce_sync(period_us)

    def close(self) -> None:
        """As `Driver.close`: the last that the host does."""
        if self.group.phase is not Phase.DISABLED:
            for request in (self.group.quick_stop, self.group.disable):
                self.wait(request())
        self._produce_sync(0)
        lost = self.lost()
        for index, node in enumerate(self.nodes):
            if index not in lost:
                node.leave()
        self._flush()
        self.run(0.001)

    def lost(self) -> list[int]:
        """Places of the drives that are to be brought up anew."""
        return [self.machine.drives.index(drive) for drive in self.group.lost()]

    def bring_up_drive(self, index: int) -> None:
        """Of one drive, also again."""
        node = self.nodes[index]
        node.node.sdo.RESPONSE_TIMEOUT = self.sdo_patience_s
        statusword = node.configure()
        self.group.reconfigured(self.machine.drives[index], statusword, self.now_us, node.units)

    def wait(self, answer: Future[None], seconds: float = 60.0) -> None:
        """Run until the answer is there, and raise what it raises."""
        self.run(seconds, answer.done)
        answer.result(timeout=0)

    def enable(self) -> None:
        self.wait(self.group.enable(), 5.0)

    def run(self, seconds: float, until: Callable[[], bool] = lambda: False) -> None:
        """Simulated time goes on for `seconds`, or until the condition holds."""
        end_us = self.now_us + seconds * 1e6
        self._until = until
        self._done_us = -math.inf
        while self.now_us < end_us and not until():
            if self._done_us < self.now_us:
                self._step()
                if until():
                    break
            self._done_us = -math.inf
            self._due_us = max(self._deadline_us, self.now_us) + self.late_us()
            self.bus.run_until(min(end_us, self._due_us), self._on_frame)
        if not until():
            self._step()
        self._until = lambda: False

    # ------------------------------------------------------------------ inside

    @property
    def _deadline_us(self) -> float:
        return min(self.group.deadline_us, self.transmitter.deadline_us)

    def _hear(self) -> None:
        """What a host that wakes up late has not heard yet."""

    def _step(self) -> None:
        self.machine.advance(self.now_us)
        self._flush()
        while (request := self._next_request()) and not _short(request):
            self._perform(self.machine.out.requests.popleft())

    def _next_request(self) -> SdoRequest | None:
        """What the driver's worker would do now: one request after another."""
        requests = self.machine.out.requests
        free = self._job is None and not self._serving
        if not (requests and free) or (self._polling and requests[0].node_id in self._polled):
            return None
        return requests[0]

    def _serve(self) -> None:
        """As the worker: SDO goes on beside everything else, where each access is a frame."""
        polls = self.machine.out.polls
        while polls:
            self._poll(polls.popleft())
        self._ask_polled()
        if self._job is not None and self.now_us > self._asked_us + ATTEMPTS * SDO_PATIENCE_US:
            self._finish("does not answer")
        request = self._next_request()
        if request is not None and _short(request):
            self._job = self.machine.out.requests.popleft()
            self._left, self._values = [*request.writes, *request.reads], []
            self._access()

    def _poll(self, poll: Poll) -> None:
        """As `ClockReader`: of whoever has nothing else to answer."""
        if self._polling:
            return
        self._unpolled = dict.fromkeys(poll.node_ids, poll.read.request)
        self._polled_us = self.now_us
        self._ask_polled()

    def _ask_polled(self) -> None:
        """Those that have nothing else to answer (any more), soon or not at all."""
        if self.now_us > self._polled_us + BUSY_US:
            self._unpolled.clear()
        busy = self._job.node_id if self._job is not None else 0
        for node_id in [] if self._serving else sorted(self._unpolled.keys() - {busy}):
            self._polled.add(node_id)
            self._push(Frame(0x600 + node_id, self._unpolled.pop(node_id)))

    @property
    def _polling(self) -> bool:
        if self.now_us > self._polled_us + POLL_PATIENCE_US:
            self._polled.clear()
        return bool(self._polled)

    def _access(self) -> None:
        assert self._job is not None
        if not self._left:
            self._finish("")
            return
        self._asked_us = self.now_us
        self._push(Frame(0x600 + self._job.node_id, self._left[0].request))

    def _on_answer(self, data: bytes) -> None:
        """As canopen's client here: only an answer to what was asked counts."""
        what = self._left[0] if self._left else None
        if what is not None and data[1:4] != what.request[1:4]:
            return
        if what is None or data[0] == 0x80:
            self._finish(f"abort {int.from_bytes(data[4:], 'little'):08X}")
            return
        self._left.pop(0)
        if isinstance(what, SdoRead):
            self._values.append(what.decode(data[4:]))
        self._access()

    def _finish(self, error: str) -> None:
        assert self._job is not None
        job, self._job = self._job, None
        if error:
            drive = next(d for d in self.machine.drives if d.node_id == job.node_id)
            error = f"{drive}: {error}"
        self.machine.out.answer(job.number, () if error else self._values, error)

    def _perform(self, request: SdoRequest) -> None:
        node = next(node.node for node in self.nodes if node.node.id == request.node_id)
        values, error = (), ""
        try:
            values, _, _ = perform(node, request, lambda: self.now_us)
        except DriveError as refusal:
            error = str(refusal)
        self.machine.out.answer(request.number, values, error)

    def _flush(self) -> None:
        out = self.machine.out
        while out.frames:
            self._push(out.frames.popleft())
        self._serve()
        self.transmitter.pump(self.now_us)
        for event in out.events:
            self.on_event(event)
        self.events.extend(out.events)
        out.events.clear()

    def _push(self, frame: Frame) -> None:
        self.intake.sending(frame)
        self.transmitter.push(frame)

    @staticmethod
    def _hold_to_its_phases(group: Group) -> None:
        """Whatever a test does, the group goes no other ways than those it says it has."""
        enter = group._enter

        def checked(phase: Phase) -> None:
            assert follows(group.phase, phase), f"{group.phase} --> {phase}"
            enter(phase)

        group._enter = checked  # type: ignore[method-assign]

    def _hand_over(self, frame: Frame) -> bool:
        try:
            self.bus.host_send(frame.can_id, frame.data, **{"remote": True} if frame.remote else {})
        except TransmitQueueFull:
            return False
        return True

    def _send_service(self, frame: Frame) -> None:
        """canopen asks and waits: the answer has to arrive before this returns."""
        self._await(lambda: self._job is None and not self._polling)
        self._push(frame)
        self.transmitter.pump(self.now_us)
        if frame.can_id & 0x780 != 0x600:
            return  # NMT, which nobody answers
        self._answered, self._serving = False, True
        self._await(lambda: self._answered)
        self._serving = False

    def _await(self, what: Callable[[], bool]) -> None:
        end_us, until = self.now_us + SDO_PATIENCE_US, self._until
        self._until = what
        while self.now_us < end_us and not what():
            self._due_us = min(end_us, max(self._deadline_us, self.now_us))
            self.bus.run_until(self._due_us, self._on_frame)
            self._hear()
            self.machine.advance(self.now_us)
            self._flush()
        self._until = until

    def _on_frame(self, can_id: int, data: bytes, t_us: float, echo: bool) -> bool:
        """Returns whether something is due before the time that was run to."""
        frame = Frame(can_id, bytes(data), isinstance(data, Remote))
        self.frames.append((t_us, frame, echo))
        if echo:
            self.transmitter.on_echo(frame)
        elif can_id & 0x780 == 0x580:
            self._answered = self._job is None
            self._polled.discard(can_id & 0x7F)
        if frame.remote:
            self.machine.advance(self.now_us)
            self._flush()
            return self._deadline_us < self._due_us or self._until()
        accepted = echo or self.intake.accepts(frame)
        if accepted:
            self.machine.receive(frame, self.stamp_us(t_us), echo)
            if self._job is not None and not echo and can_id == 0x580 + self._job.node_id:
                self._on_answer(frame.data)
        self.machine.advance(self.now_us)
        self._flush()
        if not self.machine.out.requests:
            self._done_us = self.now_us
        if accepted and not echo and can_id & 0x780 == SDO_RESPONSE:
            self.network.notify(can_id, bytearray(data), t_us / 1e6)
        return self._deadline_us < self._due_us or self._until()


def _short(request: SdoRequest) -> bool:
    """Whether each access is one frame there and one back."""
    return all(len(write.data) <= 4 for write in request.writes) and all(
        read.size <= 4 for read in request.reads
    )


def move_on(made: Bench) -> None:
    """From where the axes stand, to zero in two seconds."""
    here = [
        unit.from_qc(float(drive.demand_qc or 0))
        for unit, drive in zip(made.path._units, made.machine.drives, strict=True)
    ]
    there = Trajectory(
        tuple(drive.joint for drive in made.machine.drives),
        np.array([0.0, 2.0]),
        np.array([here, [0.0] * len(here)]),
    )
    made.path.submit(there, None, made.now_us)
    made.wait(made.group.motion)
    assert [drive.position_demand for drive in made.drives] == [0] * len(made.drives)


def downloads(one: Bench, node: int) -> list[tuple[int, int, int]]:
    """What a drive was told by expedited SDO: index, subindex, value, in their order."""
    told = []
    for _, frame, echo in one.frames:
        if echo and frame.can_id == 0x600 + node and frame.data[0] & 0xE0 == 0x20:
            index, subindex = struct.unpack_from("<HB", frame.data, 1)
            size = 4 - (frame.data[0] >> 2 & 3)
            told.append((index, subindex, int.from_bytes(frame.data[4 : 4 + size], "little")))
    return told
