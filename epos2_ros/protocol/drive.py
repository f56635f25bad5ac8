"""One drive as its group sees it: what it last reported, and the frames that command it.

What a PDO means is what it was mapped to, whoever made the drive: a mapping names objects, and here
is what each of them is to the group.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from epos2_ros.protocol import cia402, epos2
from epos2_ros.protocol.cia402 import State
from epos2_ros.protocol.executed_path import Demand
from epos2_ros.protocol.family import Family
from epos2_ros.protocol.frame import Frame
from epos2_ros.protocol.outbox import Outbox
from epos2_ros.protocol.pdo import SYNCHRONOUS, PdoMapping
from epos2_ros.protocol.sdo import SdoRead, SdoWrite

LARGEST_ERROR_QC = 32_767  # a following error has 16 bits: this may stand for any larger one
SAMPLES_APART_S = 0.005, 1.0  # so far apart two positions tell a velocity
_CONTROLLING = frozenset(
    {State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE, State.FAULT_REACTION_ACTIVE}
)  # where a drive controls its position
_NEVER = -math.inf, 0, 0.0, math.inf
SYNC_ANSWER_AGE_US = 50_000.0  # an answer to SYNC may wait so long for its turn on the bus


@dataclass(frozen=True)
class DriveSetup:
    """What the group has to know of a drive before it says anything.

    `velocity_unit`, `acceleration_unit`, `jerk_unit`: of its motion objects [qc/s], [qc/s²],
    [qc/s³].
    """

    joint: str
    node_id: int
    family: Family
    velocity_unit: float
    acceleration_unit: float
    jerk_unit: float
    tpdos: tuple[PdoMapping, ...]


class Drive:
    """Reported state of one drive. Positions are counts; times are host µs."""

    def __init__(self, setup: DriveSetup) -> None:
        self.joint = setup.joint
        self.node_id = setup.node_id
        self.family = setup.family
        self.velocity_unit = setup.velocity_unit
        self.acceleration_unit = setup.acceleration_unit
        self.jerk_unit = setup.jerk_unit
        self.operation = setup.family.rest_operation  # 0x6060, as it was last set
        self.statusword = 0
        self.statusword_us = -math.inf
        self.off_reports = 0  # in a row that name another state than "operation enabled"
        self.active_us = -math.inf  # when bit 12 was last reported set
        self.buffer_status = 0
        self.position_qc: int | None = None
        self.velocity = 0.0  # [velocity_unit]
        self.sample_us = -math.inf  # when that was
        self.current_ma: int | None = None
        self.demand_qc: int | None = None
        self.demand_us = -math.inf
        self.demand_sync_us = -math.inf  # the SYNC that it belongs to
        self.position_sync_us = -math.inf  # the SYNC that `position_qc` belongs to, if to one
        self.following_error_qc: int | None = None
        self.latched: int | None = None  # what its clock was at the last SYNC it answered [µs]
        self.emergency = 0
        self.heard_us = -math.inf
        self.sync_us = -math.inf  # when the last SYNC was
        self.asked_us = -math.inf  # when the last SDO request to it was on the bus
        self.asked_clock = False  # since the last SYNC: what it answers is the clock at that
        self.restarted = False
        self.not_operational = 0  # heartbeats in a row that say so
        self.unanswered = 0  # SYNCs in a row that it has left without an answer
        self.homed = ""  # the method by which it was referenced; "": it was not
        self._borrowed: dict[tuple[int, int], SdoWrite] = {}  # what is to be there again
        self.demand: Demand | None = None  # what it was last told to do; None: not known
        self._layouts = {
            mapping.cob_id + self.node_id: _Layout(setup.family, mapping) for mapping in setup.tpdos
        }
        self.pdo_bytes: Mapping[int, int] = {  # by COB-ID, how long its PDOs are mapped
            cob_id: layout.size for cob_id, layout in self._layouts.items()
        }
        self._tells_velocity = any(
            (epos2.VELOCITY_ACTUAL, 0) in mapping.objects for mapping in setup.tpdos
        )
        self.acceleration_qc_s2 = 0.0  # then
        self._before = _NEVER  # a position's time, it, the mean velocity since so long before
        self._event_us = -math.inf  # of the last statusword that came as an event

    def __str__(self) -> str:
        return f"{self.joint} (node {self.node_id})"

    # What the drive says ---------------------------------------------------------------

    def on_pdo(self, cob_id: int, data: bytes, t_us: float) -> frozenset[tuple[int, int]]:
        """A PDO of its own, of the right length; the objects it has reported.

        A state sampled at a SYNC counts where it is at least as new as that of the last event.
        A drive that controls its position says by its demand, and how far it is from that, where
        it is.
        """
        layout = self._layouts[cob_id]
        values = layout.read(data)
        repeats = layout.synchronous and t_us <= self._event_us + SYNC_ANSWER_AGE_US
        for name, value in values.items():
            if name == "statusword":
                if not repeats:
                    self.report(value, t_us)
            elif name != "position_qc" and (name != "buffer_status" or not repeats):
                setattr(self, name, value)
        if "statusword" in values and not layout.synchronous:
            self._event_us = t_us
        layout.read_us = t_us
        if layout.synchronous:
            self.unanswered = 0
        if "demand_qc" in values:
            self.demand_us, self.demand_sync_us = t_us, self.sync_us
        if (position := _position(values)) is not None:
            self._was_at(position, self.sync_us if layout.synchronous else t_us)
        return layout.objects

    def _was_at(self, position_qc: int, t_us: float) -> None:
        """Its position at a time; one that has been on its way for longer than the last is dropped.

        How fast it was, and how much faster it became, is told by the positions before where the
        drive does not tell it. One that comes to rest is not taken to turn round.
        """
        if t_us < self.sample_us:
            return
        self.position_qc, self.sample_us = position_qc, t_us
        at_sync = t_us == self.sync_us
        if at_sync:
            self.position_sync_us = t_us
        (before_us, before_qc, speed, before_s), (least_s, most_s) = self._before, SAMPLES_APART_S
        apart_s = (t_us - before_us) / 1e6
        if apart_s < least_s or not (at_sync or apart_s > most_s / 2):
            return
        if apart_s > most_s:  # too long ago to tell anything
            before_qc, speed, before_s = position_qc, 0.0, math.inf
        told = self.velocity * self.velocity_unit if self._tells_velocity else None
        mean = (position_qc - before_qc) / apart_s if told is None else told
        over_s = apart_s if told is not None else (apart_s + before_s) / 2
        self.acceleration_qc_s2 = (mean - speed) / over_s
        self._before = t_us, position_qc, mean, apart_s
        if told is None:
            ahead = mean + self.acceleration_qc_s2 * apart_s / 2
            if ahead * mean <= 0:
                ahead = self.acceleration_qc_s2 = 0.0
            self.velocity = ahead / self.velocity_unit

    def on_sync(self, t_us: float) -> None:
        """A SYNC was on the bus."""
        self.sync_us, self.asked_clock = t_us, False
        self.unanswered += 1

    def on_clock_answer(self, data: bytes) -> frozenset[tuple[int, int]]:
        """An SDO answer; the object it has reported if it is what the clock was at the last SYNC.

        Asked before that SYNC, it may be what the clock was at the one before: it reports nothing.
        """
        read = epos2.CLOCK_AT_SYNC
        latched = read.answered(data)
        if latched is None or not self.asked_clock:
            return frozenset()
        self.latched = latched
        return frozenset({(read.index, read.subindex)})

    @property
    def tells_clock(self) -> bool:
        """Whether it answers a SYNC with its clock, in a PDO."""
        clock = epos2.HIGH_RESOLUTION_TIME_STAMP, 0
        return any(clock in layout.objects for layout in self._layouts.values())

    def objects_of(self, cob_id: int) -> frozenset[tuple[int, int]]:
        """What its PDO with this COB-ID carries; nothing if it is none of its PDOs."""
        layout = self._layouts.get(cob_id)
        return frozenset() if layout is None else layout.objects

    def rests(self) -> None:
        """At a position that may be called another from now on."""
        self.velocity = self.acceleration_qc_s2 = 0.0
        self._before = _NEVER

    def report(self, statusword: int, t_us: float) -> None:
        """A statusword, from a PDO or read at bring-up."""
        self.statusword = statusword
        self.statusword_us = t_us
        self.off_reports = 0 if self.state is State.OPERATION_ENABLED else self.off_reports + 1
        if statusword & cia402.OPERATION_MODE_SPECIFIC:
            self.active_us = t_us

    def on_emergency(self, data: bytes) -> int:
        """Error code of the emergency; 0 says that all errors are gone."""
        self.emergency = int(epos2.EMCY_LAYOUT.unpack(data)[0])
        return self.emergency

    def answered_since(self, t_us: float) -> bool:
        """Whether it has answered a SYNC, with all it has to say at one."""
        return all(layout.read_us > t_us for layout in self._layouts.values() if layout.synchronous)

    @property
    def powering_up(self) -> bool:
        """Whether it is on its own way to "operation enabled"."""
        return self.state is State.SWITCHED_ON and bool(self.statusword & self.family.power_up_bit)

    @property
    def state(self) -> State:
        return cia402.state_of(self.statusword)

    @property
    def standing_qc(self) -> int | None:
        """Where it stands, by its own demand if it says that; None: not known."""
        return self.position_qc if self.demand_qc is None else self.demand_qc

    @property
    def velocity_qc_s(self) -> float:
        """When it was last at `position_qc`."""
        return self.velocity * self.velocity_unit

    def trouble(self) -> str:
        """What the drive complains of, in words; "" if nothing."""
        words = []
        if self.emergency:
            words.append(self.family.describe_emergency(self.emergency))
        pvt = self.family.pvt
        if pvt is not None and (errors := pvt.describe_errors(self.buffer_status)):
            words.append(errors)
        if not words and self.statusword & cia402.FAULT_BIT:
            words.append(self.state.value)
        return ": ".join(words)

    # What a mode changes for a while -------------------------------------------------------

    def borrow(
        self,
        writes: Sequence[SdoWrite],
        reads: Sequence[SdoRead],
        out: Outbox,
        then: Callable[[Sequence[int], str], None],
    ) -> None:
        """Write to objects that another mode needs as they were; `reads` are of the same.

        What they hold is read first, once, for `give_back`.
        """
        unknown = [read for read in reads if (read.index, read.subindex) not in self._borrowed]

        def keep(values: Sequence[int], error: str) -> None:
            for read, value in zip(unknown, values, strict=False):
                self._borrowed[read.index, read.subindex] = SdoWrite.integer(
                    read.index, read.subindex, value, read.size, read.signed
                )
            then((), error)

        if unknown:
            out.ask(self.node_id, reads=unknown, then=keep)
        out.ask(self.node_id, writes, then=then)

    def give_back(self) -> list[SdoWrite]:
        """What puts these objects back, each once."""
        writes, self._borrowed = list(self._borrowed.values()), {}
        return writes

    # What the drive is told ------------------------------------------------------------

    def controlword(self, value: int) -> Frame:
        """RPDO4: takes effect at once."""
        return Frame(epos2.RPDO4 + self.node_id, value.to_bytes(2, "little"))

    def synchronous_controlword(self, value: int) -> Frame:
        """RPDO2: takes effect at the next SYNC."""
        return Frame(epos2.RPDO2 + self.node_id, value.to_bytes(2, "little"))

    def time_stamp(self, stamp: int) -> Frame:
        """RPDO3: when the last SYNC was."""
        return Frame(epos2.RPDO3 + self.node_id, stamp.to_bytes(4, "little"))


class _Layout:
    """The bytes of one PDO."""

    def __init__(self, family: Family, mapping: PdoMapping) -> None:
        fields = [family.fields[key] for key in mapping.objects]
        self.read_us = -math.inf
        self.synchronous = mapping.transmission_type == SYNCHRONOUS
        self.objects = frozenset(mapping.objects)
        self._struct = struct.Struct("<" + "".join(field.code for field in fields))
        self._names = [field.name for field in fields]

    @property
    def size(self) -> int:
        return self._struct.size

    def read(self, data: bytes) -> dict[str, int]:
        return dict(zip(self._names, self._struct.unpack(data), strict=True))


def _position(values: Mapping[str, int]) -> int | None:
    """Where an axis is by these reports; None where they don't say.

    READING: what a demand and a following error are in a drive that is off no document says.
    """
    if "position_qc" in values:
        return values["position_qc"]
    error_qc, demand_qc = values.get("following_error_qc"), values.get("demand_qc")
    if error_qc is None or demand_qc is None or abs(error_qc) >= LARGEST_ERROR_QC:
        return None
    controls = cia402.state_of(values.get("statusword", 0)) in _CONTROLLING
    return demand_qc - error_qc if controls else None


def names(drives: Iterable[Drive]) -> str:
    """Drives in a line of text."""
    return ", ".join(map(str, drives))
