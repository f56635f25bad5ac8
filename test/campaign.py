"""Random scenarios over the whole driver below ROS, with troubles: does it keep what it promises?

`make campaign N=1000` runs so many, each from a seed of its own, in simulated time: motion layer,
protocol, bring-up and bus are the real ones, the drives those with their makers' dictionaries. A
scenario that breaks a promise is made smaller as long as it breaks the same one, and printed with
its seed; `--seed` runs one again, and all is the same.

What is asked of every run, at every instant of it (`Watch`) and at its end (`play`), is judged by
what the simulated axes do and by the records that the driver handed over, never by what it says.
"""

from __future__ import annotations

import argparse
import gc
import heapq
import itertools
import logging
import math
import random
import re
import sys
import time
from bisect import bisect_left
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from types import SimpleNamespace
from typing import Any
from unittest import mock

import numpy as np
import stage_outputs
from simulated_time import Bench
from stage_outputs import StageOutputs

from epos2_ros.bus import cia402_node, sdo_access, sdo_client, timestamps
from epos2_ros.bus.timestamps import ReceiveClock
from epos2_ros.configuration.driver import AxisConfig, DriverConfig, HomingConfig
from epos2_ros.errors import BusError, Epos2RosError
from epos2_ros.motion.trajectory import Trajectory
from epos2_ros.protocol.cia402 import State
from epos2_ros.protocol.family import Family
from epos2_ros.protocol.frame import Frame
from epos2_ros.protocol.other_host import OtherHost
from epos2_ros.protocol.phase import BEGUN, Phase
from epos2_ros.sim import copley
from epos2_ros.sim.cl3e import Cl3e
from epos2_ros.sim.copley import Copley
from epos2_ros.sim.epos2 import Dictionary, Epos2

QC_PER_RAD = 2000 * 100 / (2 * math.pi)
MAX_VELOCITY, MAX_ACCELERATION = 3.0, 12.0
UNIT_QC_S = 2000 / 60  # of velocities in records: 1 rpm

# What the configuration implies [s]
RAMP_S = 0.35  # from the greatest velocity, at 10,000 rpm/s, and the lag of the motor
SILENCE_S = 0.5  # until a silent drive, or a host, is noticed
LEFT_S = 1.0  # alone, drives that watch a host have found by then that there is none
ANSWER_S = 60.0  # within which every request is answered; bring-up of a silent drive included
STARTED_US = 400_000.0  # so long the drives have had power when bring-up begins
SAMPLE_US = 4_000.0
WORKER_US = 1_000.0  # until the worker begins what is to be done by SDO
QUEUE = 10  # frames, of SocketCAN
SWAP_US = 20_000.0  # as long a frame waits for one that overtakes it
START = 0x1F  # of a controlword: operation enabled, and bit 4, with which each mode begins
REST_QC = 6.0  # within HISTORY samples: it stands
HISTORY = 6
ENABLED_S = 1.6  # after "enable" axes are ready to move
JOINT = re.compile(r"joint_(\d)")
BLAMED = {  # what may be said of an axis, and what has to have happened to it
    "is silent": ("silent", "power", "other host"),
    "has restarted": ("power", "other host"),
    "clock is off": ("clock", "other host"),
    "come late": ("late SDO", "no SDO", "silent", "other host"),
    "NMT operational": ("power", "other host"),
    "was not read": ("late SDO", "no SDO", "silent", "power"),
    "was lost, repeated": ("clock", "silent"),  # what is sent to a drive that is cut off is lost
    "no answer to SYNC": ("late SDO", "no SDO", "silent", "power", "other host"),
}
KNOWN = (Phase.DISABLED, Phase.STANDING, Phase.FAULT)


class Broken(Exception):
    """A promise that was not kept: `promise` is which, the same for all scenarios."""

    def __init__(self, promise: str, text: str) -> None:
        super().__init__(f"{promise}: {text}")
        self.promise = promise


# ---------------------------------------------------------------------------- scenarios


@dataclass(frozen=True)
class Axis:
    family: str
    drift_ppm: float
    homing: str
    output: str = ""  # the kind of its position-triggered output


@dataclass(frozen=True)
class Action:
    """A request, `after_s` the one before it; `reach` [rad] and `lasts_s` where it is a motion."""

    name: str
    after_s: float
    reach: float = 0.0
    lasts_s: float = 0.0


@dataclass(frozen=True)
class Trouble:
    """`at_s` after action number `after` (-1: after bring-up begins).

    What it needs of: the axis, frames (their function code) and how many of them, a time.
    """

    name: str
    after: int
    at_s: float
    axis: int
    frames: int = 0
    count: int = 1
    lasts_s: float = 0.0


@dataclass(frozen=True)
class Scenario:
    axes: tuple[Axis, ...]
    actions: tuple[Action, ...]
    troubles: tuple[Trouble, ...]
    buffer_time: float = 0.5
    sync_period: float = 0.1
    bitrate: int = 1_000_000
    killed_s: float | None = None  # after the last action, and another host comes so much later
    source: str = "host"  # the clock master, and …
    producer: str = "host"  # … who sends SYNC: the host, or a drive with the note's dictionary
    stamps: bool = True  # of the adapter; else frames have the time at which they are read
    busy_us: float = 0.0  # so late, at most, the driver's thread wakes up
    seed: int = 0


ACTIONS = (
    *("enable", "enable", "move", "move", "move", "move", "move_later", "move_much_later"),
    *("replace", "stream", "stop", "halt", "quick_stop", "disable", "reset_fault", "reset_fault"),
    *("move_to", "home"),
)
TO_DRIVE = {  # function codes of what the host sends, by what may happen to it
    "lose": (0x200, 0x200, 0x300, 0x400, 0x500, 0x080, 0x600, 0x700, 0x000),
    "double": (0x200, 0x300, 0x400, 0x500, 0x080, 0x600),
    "delay": (0x200, 0x300, 0x400, 0x500, 0x080, 0x600),
    "swap": (0x200, 0x400, 0x500),
    "alter": (0x200, 0x200, 0x300, 0x400, 0x500),
}
TO_HOST = {
    "lose": (0x080, 0x180, 0x280, 0x380, 0x480, 0x580, 0x700),
    "double": (0x180, 0x280, 0x380, 0x480, 0x580, 0x700),
    "delay": (0x180, 0x280, 0x380, 0x480, 0x580, 0x700),
    "swap": (0x180, 0x380, 0x480, 0x580),
    "alter": (0x180, 0x280, 0x380, 0x480),
}
EMERGENCIES = (0x2310, 0x3210, 0x4210, 0x7320, 0x8611)


def scenario_of(seed: int) -> Scenario:
    """The same one for the same seed, in any process."""
    chance = random.Random(seed)
    axes = tuple(
        Axis(
            chance.choice(("epos2", "epos2", "epos2", "epos2", "copley", "cl3e")),
            chance.uniform(-200, 200),
            chance.choice(("", "here", "index_positive")),
            chance.choice(stage_outputs.KINDS),
        )
        for _ in range(chance.choice((1, 2, 2, 3)))
    )
    actions = [Action("enable", chance.choice((0.0, 0.3)))] if chance.random() < 0.9 else []
    for _ in range(chance.randint(1, 6)):
        name = chance.choice(ACTIONS)
        after_s = chance.choice((0.0, 0.001, 0.02, chance.uniform(0, 1.6), chance.uniform(0, 1.6)))
        if actions and actions[-1].name == "enable" and chance.random() < 0.8:
            after_s += ENABLED_S
        reach = chance.uniform(-0.3, 0.3)
        actions.append(Action(name, after_s, reach, chance.uniform(0.5, 1.6)))
    count = chance.choice((0, 1, 1, 1, 2, 2, 3, 6))
    troubles = [_trouble(chance, len(axes), len(actions)) for _ in range(count)]
    return Scenario(
        axes,
        tuple(actions),
        tuple(troubles),
        buffer_time=chance.choice((0.2, 0.3, 0.5, 0.5, 0.8)),
        sync_period=chance.choice((0.05, 0.1, 0.1, 0.1, 0.2)),
        bitrate=chance.choice((500_000, 1_000_000, 1_000_000)),
        killed_s=chance.choice((*[None] * 8, 0.0, 0.3, 1.5)),
        source=_one_of(axes, chance),
        producer=_one_of(axes, chance),
        stamps=chance.random() < 0.75,
        busy_us=chance.choice((0.0, 0.0, 500.0, 5e3, 20e3)),
        seed=seed,
    )


def _one_of(axes: Sequence[Axis], chance: random.Random) -> str:
    joints = [f"joint_{n}" for n, axis in enumerate(axes, 1) if axis.family == "epos2"]
    return chance.choice(joints) if joints and chance.random() < 0.1 else "host"


def _trouble(chance: random.Random, axes: int, actions: int) -> Trouble:
    name = chance.choice(
        (
            *(f"{kind} to drive" for kind in TO_DRIVE),
            *(f"{kind} to host" for kind in TO_HOST),
            *("abort", "no SDO", "late SDO", "emergency", "emergency", "silent", "silent", "power"),
            *("stall", "stall", "clock", "foreign", "length", "wall", "wall", "adapter"),
            "other host",
        )
    )
    kind, _, to = name.partition(" to ")
    table = {"drive": TO_DRIVE, "host": TO_HOST}.get(to)
    return Trouble(
        name,
        chance.randint(-1, actions - 1),
        chance.choice((0.0, chance.uniform(0, 0.01), chance.uniform(0, 0.3), chance.uniform(0, 2))),
        chance.randrange(axes),
        chance.choice(table[kind]) if table else 0,
        chance.choice((1, 1, 1, 2, 5)),
        chance.choice((0.02, 0.1, 0.3, 0.5, 1.0, 3.0, 1e9 if name in ("silent", "power") else 0.2)),
    )


# ---------------------------------------------------------------------------- what happens


class Director:
    """Sits on the bus as a drive would: troubles at their instants, and foreign frames."""

    node_id = -1

    def __init__(self) -> None:
        self.outbox: deque[tuple[int, bytes]] = deque()
        self.on_frame: Callable[[int, bytes, float], object] = lambda can_id, data, t_us: None
        self._agenda: list[tuple[float, int, Callable[[float], object]]] = []
        self._number = itertools.count()

    @property
    def next_event_us(self) -> float:
        return self._agenda[0][0] if self._agenda else math.inf

    def at(self, t_us: float, what: Callable[[float], object]) -> None:
        heapq.heappush(self._agenda, (t_us, next(self._number), what))

    def advance(self, t_us: float) -> None:
        while self._agenda and self._agenda[0][0] <= t_us:
            due_us, _, what = heapq.heappop(self._agenda)
            what(max(due_us, t_us))

    def receive(self, can_id: int, data: bytes, t_us: float, remote: bool = False) -> bool:
        self.on_frame(can_id, data, t_us)
        return False

    def transmitted(self, can_id: int, t_us: float) -> None:
        pass


@dataclass
class Meddling:
    """Something that happens to the next `left` frames of a kind."""

    kind: str
    can_ids: frozenset[int]
    left: int
    delay_us: float
    held: Any = None


class Meddler:
    """On the way to one receiver: loses, doubles, delays, swaps and alters frames."""

    def __init__(self, deliver: Callable[..., Any], stage: Stage, node_id: int) -> None:
        self.work: list[Meddling] = []
        self._deliver, self._stage, self._node_id = deliver, stage, node_id

    def __call__(self, can_id: int, data: bytes, *rest: Any) -> Any:
        for meddling in self.work:
            if can_id not in meddling.can_ids:
                continue
            if meddling.held is not None:
                held, meddling.held = meddling.held, None
                done = self._deliver(can_id, data, *rest)
                return self._deliver(*held) or done
            if not meddling.left:
                continue
            meddling.left -= 1
            self._stage.meddled(self._node_id, can_id)
            match meddling.kind:
                case "lose":
                    return False
                case "double":
                    self._deliver(can_id, data, *rest)
                case "delay":
                    again = (can_id, data, *rest)
                    self._stage.later(meddling.delay_us, lambda _, f=again: self._late(f))
                    return False
                case "swap":
                    meddling.held = held = can_id, data, *rest
                    self._stage.later(SWAP_US, lambda _, m=meddling, f=held: self._release(m, f))
                    return False
                case "abort":
                    data = b"\x80" + data[1:4] + (0x0800_0000).to_bytes(4, "little")
                case "alter" if data:
                    place = self._stage.chance.randrange(8 * len(data))
                    whole = int.from_bytes(data, "little") ^ 1 << place
                    data = whole.to_bytes(len(data), "little")
            break
        return self._deliver(can_id, data, *rest)


    def _release(self, meddling: Meddling, frame: Any) -> None:
        """Nothing has come that it could be swapped with."""
        if meddling.held is frame:
            meddling.held = None
            self._late(frame)

    def _late(self, frame: Any) -> None:
        if self._deliver(*frame):
            self._stage.bus.interrupt()


class Stage(Bench):
    """A bench with a host that may sleep, wires that may be bad, and somebody who watches."""

    sdo_patience_s = 1e-6  # all that comes has come when canopen looks

    def __init__(self, scenario: Scenario, before: Stage | None = None) -> None:
        """`before`: that of a host that is gone, whose drives go on."""
        self.scenario = scenario
        self.chance = random.Random(scenario.seed)
        self.director = before.director if before else Director()
        self.wakes_us = -math.inf  # until when the host is busy elsewhere
        self.woke_us = -math.inf
        self.meddled_us: dict[int, float] = {}  # when a frame of or to a node was meddled with last
        self._unheard: list[tuple[int, bytes, float, bool]] = []
        self._sleeping = False
        config = DriverConfig(
            axes=tuple(_axis(n, axis) for n, axis in enumerate(scenario.axes, 1)),
            buffer_time=scenario.buffer_time,
            sync_period=scenario.sync_period,
            bitrate=scenario.bitrate,
            sync_source=scenario.source,
            sync_producer=scenario.producer,
        )
        drives = before.drives if before else [
            _drive(n, axis, scenario) for n, axis in enumerate(scenario.axes, 1)
        ]
        with mock.patch.object(cia402_node, "object_dictionary", _dictionary_of):
            bus = before.bus if before else None
            super().__init__(config, drives, bring_up=False, host_queue=QUEUE, bus=bus)
        self.wires = before.wires if before else []  # to each drive
        if before is None:
            self.bus.add(self.director)  # type: ignore[arg-type]
            for drive in self.drives:
                wire = Meddler(drive.receive, self, drive.node_id)
                drive.receive = wire  # type: ignore[method-assign]
                self.wires.append(wire)
        self.host_wire = Meddler(self._heard, self, 0)
        self.wall_us = before.wall_us if before else [(-math.inf, 1.7e15)]  # since when, ahead by
        self.stamp_us = self._stamped
        self._clock = ReceiveClock()
        self.late_us = lambda: self.chance.uniform(0.0, scenario.busy_us)
        self._refuses_until_us = -math.inf  # the adapter takes no frames
        names = {drive.node_id: str(drive) for drive in self.machine.drives}
        self._other_host = OtherHost(names, self.machine.time.produces)
        self._listen_for_another_host()
        joints = zip(config.axes, scenario.axes, strict=True)
        outputs = [
            stage_outputs.config_of(axis.joint, made.output)
            for axis, made in joints
            if made.output and axis.drive != "cl3e"  # which has none
        ]
        self.outputs = StageOutputs(self, outputs) if outputs else None
        self.watch = Watch(self)
        self.asked: list[tuple[str, Future[Any]]] = []
        self.refused: list[str] = []
        self.took_twice = ""  # why the way back did not work at once

    # ------------------------------------------------------------------ a host that sleeps

    def _on_frame(self, can_id: int, data: bytes, t_us: float, echo: bool) -> bool:
        if not self.host_wire.work:
            return self._heard(can_id, data, t_us, echo)
        return bool(self.host_wire(can_id, data, t_us, echo))

    def _heard(self, can_id: int, data: bytes, t_us: float, echo: bool) -> bool:
        if self.now_us >= self.wakes_us and not self._sleeping:
            return super()._on_frame(can_id, data, t_us, echo)
        self._unheard.append((can_id, data, t_us, echo))
        return False

    def _step(self) -> None:
        self._sleep()
        super()._step()
        if self.outputs is not None:
            self.outputs.work()

    @property
    def _deadline_us(self) -> float:
        waits = self.outputs is not None and self.outputs.waiting
        soon_us = self.now_us + WORKER_US if waits else math.inf
        return min(super()._deadline_us, soon_us)

    def _hear(self) -> None:
        self._sleep()

    def _sleep(self) -> None:
        """What is due comes first, then all that has come meanwhile."""
        if self.now_us >= self.wakes_us and not self._unheard:
            return
        self._sleeping = True
        while self.now_us < self.wakes_us:
            self.bus.run_until(self.wakes_us, self._on_frame)
        self._sleeping = False
        self.woke_us = self.now_us
        super()._step()
        unheard, self._unheard = self._unheard, []
        for frame in unheard:
            super()._on_frame(*frame)

    # ------------------------------------------------------------------ the computer

    def wall_at_us(self, t_us: float) -> float:
        """The wall clock, which somebody may set."""
        last_us, ahead_us = self.wall_us[-1]
        if last_us > t_us:
            ahead_us = next(ahead for since, ahead in reversed(self.wall_us) if since <= t_us)
        return t_us + ahead_us

    def _stamped(self, t_us: float) -> float:
        """By the driver's own clock, from what the adapter has stamped with the wall clock."""
        if not self.scenario.stamps:
            return self.now_us
        return self._clock.host_us(self.wall_at_us(t_us) / 1e6)

    def _hand_over(self, frame: Frame) -> bool:
        return self.now_us >= self._refuses_until_us and super()._hand_over(frame)

    # ------------------------------------------------------------------ the driver's way

    def _listen_for_another_host(self) -> None:
        """As `Driver._on_frame`."""
        receive = self.machine.receive

        def look(frame: Frame, t_us: float, echo: bool = False) -> None:
            running = self.group.time.running
            if not echo:
                told = self._other_host.look(frame, t_us, running)
                if told and running:
                    self.group.fail(told)
            receive(frame, t_us, echo)
            if self.outputs is not None:
                self.outputs.receive(frame, t_us, echo)

        self.machine.receive = look  # type: ignore[method-assign]

    def _push(self, frame: Frame) -> None:
        self.watch.handed_over(frame)
        super()._push(frame)

    def bring_up_drive(self, index: int) -> None:
        super().bring_up_drive(index)
        if self.outputs is not None:
            self.outputs.arm(index)

    def reset_fault(self) -> Future[None]:
        """As `Driver.reset_fault`."""
        if told := self._other_host.still_there(self.now_us):
            raise BusError(told)
        lost = self.lost() if self.group.time.running else list(range(len(self.nodes)))
        for index in lost:
            self.bring_up_drive(index)
        if lost:
            self.start_clock()
        for drive, node in zip(self.machine.drives, self.nodes, strict=True):
            if drive.state is State.FAULT:
                node.clear_faults()
        return self.group.reset_fault()

    # ------------------------------------------------------------------ troubles

    def later(self, delay_us: float, what: Callable[[float], object]) -> None:
        self.director.at(self.now_us + delay_us, what)

    def meddled(self, node_id: int, can_id: int) -> None:
        if can_id & 0x780 not in (0x200, 0x400):  # which excuse nothing
            self.meddled_us[node_id or can_id & 0x7F] = self.now_us

    def trouble(self, trouble: Trouble) -> Callable[[float], object]:
        def begin(t_us: float) -> None:
            drive, lasts_us = self.drives[trouble.axis], trouble.lasts_s * 1e6
            node = drive.node_id
            kind, _, to = trouble.name.partition(" to ")
            if to == "drive":
                everyone = trouble.frames in (0x080, 0x000)
                ids = frozenset({0x77F} if trouble.frames == 0x700 else {
                    trouble.frames + (0 if everyone else node)
                })
                work = Meddling(kind, ids, trouble.count, trouble.lasts_s * 1e5 % 50_000)
                self.wires[trouble.axis].work.append(work)
                return
            if to == "host" or trouble.name == "abort":
                ids = frozenset({(trouble.frames or 0x580) + node})
                work = Meddling(kind, ids, trouble.count, trouble.lasts_s * 1e5 % 150_000)
                self.host_wire.work.append(work)
                return
            match trouble.name:
                case "no SDO":
                    work = Meddling("lose", frozenset({0x580 + node}), 10**9, 0)
                    self.host_wire.work.append(work)
                    self.later(lasts_us, lambda _: setattr(work, "left", 0))
                case "late SDO":
                    work = Meddling("delay", frozenset({0x580 + node}), 10**9, min(lasts_us, 200e3))
                    self.host_wire.work.append(work)
                    self.later(min(10 * lasts_us, 3e6), lambda _: setattr(work, "left", 0))
                case "emergency":
                    if drive.powered:
                        drive.advance(t_us)
                        code = self.chance.choice(EMERGENCIES)
                        if isinstance(drive, Copley):
                            drive._latch(copley.FOLLOWING_ERROR_BIT, copley.FOLLOWING_ERROR)
                        else:
                            drive.fail(code)
                case "silent":
                    drive.disconnect()
                    self.later(lasts_us, lambda _: drive.reconnect())
                case "power":
                    drive.power_off()
                    self.later(lasts_us, lambda t_us: drive.powered or drive.power_on(t_us))
                case "stall":
                    self.wakes_us = t_us + min(lasts_us, 3e6)
                case "clock":
                    if isinstance(drive, Epos2):
                        if not self.machine.time.produces:  # how late it was seen nobody knows
                            self.meddled(node, 0)
                        jump_us = self.chance.choice((-1, 1)) * 10 ** self.chance.uniform(2, 5)
                        drive._shift_path(jump_us)
                        drive.clock._offset_us += jump_us
                case "wall":
                    ahead_us = self.wall_us[-1][1]
                    step_us = self.chance.choice((-1, 1)) * 10 ** self.chance.uniform(3, 7)
                    self.wall_us.append((t_us, ahead_us + step_us))
                case "adapter":
                    self._refuses_until_us = self.woke_us = t_us + min(lasts_us, 3e6)
                case "other host":
                    self._another_host(t_us, trouble.count)
                case "foreign":
                    self._burst(range(0x001, 0x800), 200)
                case "length":
                    own = [f + node for f in (0x080, 0x180, 0x280, 0x380, 0x480, 0x580, 0x700)]
                    self._burst(own, 20, exact=False)
            self.bus._look_at(trouble.axis)

        return begin

    def _another_host(self, t_us: float, count: int) -> None:
        """Somebody else believes that these drives are his."""
        node = self.chance.choice([0, *(drive.node_id for drive in self.drives)])
        can_id, data = self.chance.choice((
            (0x77F, b"\x05"),
            (0x080, b""),
            (0x100, bytes(6)),
            *((0, bytes((command, node))) for command in (0x01, 0x02, 0x80, 0x81, 0x82)),
            *((0x500 + (node or 1), bytes((word, 0))) for word in (0x00, 0x02, 0x06, 0x0F)),
        ))
        for n in range(count):
            self.director.at(
                t_us + n * 50e3, lambda _: self.director.outbox.append((can_id, data))
            )
        for drive in self.drives:
            self.meddled(drive.node_id, 0)

    def _burst(self, ids: Any, count: int, exact: bool = True) -> None:
        """Frames of no node of ours, or of ours but with a length that they can't have."""
        ours = {0, 0x7F, *(drive.node_id for drive in self.drives)}
        while count:
            can_id, size = self.chance.choice(ids), self.chance.randrange(9)
            if exact and can_id & 0x7F in ours:
                continue
            if not exact:
                size = self.chance.choice((0, 1, 3, 5, 7) if can_id & 0x780 != 0x700 else (0, 2, 8))
                if self.drives and size == self.intake._pdo_bytes.get(can_id):
                    continue
            self.director.outbox.append((can_id, self.chance.randbytes(size)))
            count -= 1

    def heal(self) -> None:
        """No more troubles; every drive has power and hears the others."""
        for wire in (*self.wires, self.host_wire):
            wire.work.clear()
        self.director._agenda.clear()
        self.director.outbox.clear()
        self.watch.go_on()
        self._refuses_until_us = -math.inf
        for drive in self.drives:
            drive.reconnect()
            if not drive.powered:
                drive.power_on(self.now_us)


def _shaft_qc(drive: Any) -> float:
    return drive._shaft if isinstance(drive, Copley) else drive._motor.position


_object_dictionary = cia402_node.object_dictionary


@cache
def _dictionary(eds: str) -> Any:
    """Reading one takes a while."""
    return _object_dictionary(SimpleNamespace(eds=eds))  # type: ignore[arg-type]


def _dictionary_of(family: Family) -> Any:
    return _dictionary(family.eds)


def _axis(node_id: int, axis: Axis) -> AxisConfig:
    homing = None
    if axis.homing and axis.family == "epos2":
        homing = HomingConfig(axis.homing, (0.2, 0.05), acceleration=2.0, max_travel=2.0)
    return AxisConfig(
        f"joint_{node_id}", node_id, axis.family, gear_ratio=100.0, homing=homing,
        max_velocity=MAX_VELOCITY, max_acceleration=MAX_ACCELERATION,
        stop_deceleration=MAX_VELOCITY / 0.3,
    )  # fmt: skip


def _drive(node_id: int, axis: Axis, scenario: Scenario) -> Any:
    if axis.family == "copley":
        return Copley(node_id, drift_ppm=axis.drift_ppm, offset_us=1e6 * node_id)
    if axis.family == "cl3e":
        return Cl3e(node_id, drift_ppm=axis.drift_ppm)
    note = {scenario.source, scenario.producer} != {"host"}
    return Epos2(
        node_id, drift_ppm=axis.drift_ppm, offset_us=1e6 * node_id, bitrate=scenario.bitrate,
        dictionary=Dictionary.NOTE if note else Dictionary.MAKER,
    )  # fmt: skip


# ---------------------------------------------------------------------------- what is promised


class Commanded:
    """The path of one axis by the records that were handed over, cubic between them."""

    def __init__(self, start_qc: float) -> None:
        self.knots = [(start_qc, 0.0)]
        self.ends_ms = [0]

    def add(self, data: bytes) -> None:
        """A record as maxon's note has it: position i32, velocity i24, time u8."""
        time_ms = data[7]
        if time_ms:
            position = int.from_bytes(data[:4], "little", signed=True)
            velocity = int.from_bytes(data[4:7], "little", signed=True) * UNIT_QC_S
            self.knots.append((position, velocity))
            self.ends_ms.append(self.ends_ms[-1] + time_ms)

    def at(self, k_ms: float) -> float:
        if k_ms <= 0:
            return self.knots[0][0]
        n = bisect_left(self.ends_ms, k_ms)
        if n == len(self.ends_ms):
            return self.knots[-1][0]
        (p0, v0), (p1, v1) = self.knots[n - 1], self.knots[n]
        h = (self.ends_ms[n] - self.ends_ms[n - 1]) * 1e-3
        u = (k_ms - self.ends_ms[n - 1]) * 1e-3 / h
        return (
            (1 + 2 * u) * (1 - u) ** 2 * p0
            + u * (1 - u) ** 2 * h * v0
            + u * u * (3 - 2 * u) * p1
            + u * u * (u - 1) * h * v1
        )


class CommandedSegments(Commanded):
    """Likewise by Copley's segments, which say their start; one may be handed over again."""

    def __init__(self, start_qc: float) -> None:
        super().__init__(start_qc)
        self._first = self._count = self._lasts_ms = 0

    def add(self, data: bytes) -> None:
        """Counter and format, time u8, position i24, velocity i24; or a position i32 alone."""
        counter, kind = data[0] & 7, data[0] >> 3
        if data[0] & 0x80 or (self._count and counter != (self._first + self._count) % 8):
            return  # a command, or one that was there before
        self._first = self._first if self._count else counter
        self._count += 1
        if kind == 4:
            self.knots[0] = int.from_bytes(data[1:5], "little", signed=True), 0.0
            return
        position = int.from_bytes(data[2:5], "little", signed=True)
        if kind & 2:
            position += round(self.knots[-1][0])
        unit = 10.0 if kind & 1 else 0.1
        velocity = int.from_bytes(data[5:8], "little", signed=True) * unit
        if self._lasts_ms:
            self.knots.append((position, velocity))
            self.ends_ms.append(self.ends_ms[-1] + self._lasts_ms)
        self._lasts_ms = data[1]


class Watch:
    """Looks at every axis every SAMPLE_US."""

    def __init__(self, stage: Stage) -> None:
        self._stage = stage
        count = len(stage.drives)
        self.commanded: list[Commanded | None] = [None] * count
        self._shafts: list[deque[float]] = [deque(maxlen=HISTORY) for _ in range(count)]
        self._off_us: list[float] = [math.inf] * count  # since when it is off its path
        self._bad_us: list[float] = [math.inf] * count  # since when it is in trouble
        self._good_us: list[float] = [-math.inf] * count  # since when it can be talked to again
        self._moving_allowed_us = -math.inf  # when the group was last in motion or stopping
        self._armed: set[int] = set()  # nodes that the next SYNC sets in motion, by what they got
        self._unheard_us = -math.inf  # until then the host sleeps over one that did so
        stage.director.on_frame = self._on_bus
        enter = stage.group._enter

        def entered(phase: Phase) -> None:
            if phase is Phase.SWITCHING:
                self.commanded = [None] * count
                self._off_us = [math.inf] * count
            enter(phase)

        stage.group._enter = entered  # type: ignore[method-assign]
        self.go_on()

    def go_on(self) -> None:
        self._stage.director.at(self._stage.now_us, self._look)

    def allow(self, until_us: float) -> None:
        """The axes may be moving on from before."""
        self._moving_allowed_us = until_us

    def _on_bus(self, can_id: int, data: bytes, t_us: float) -> None:
        """A motion begins with a SYNC on the bus, whether the host has heard it or not."""
        if can_id == 0x080:
            if self._armed and t_us < self._stage.wakes_us:
                self._unheard_us = self._stage.wakes_us
            self._armed.clear()
        elif can_id & 0x780 == 0x300 and data:
            starts = data[0] & START == START
            (self._armed.add if starts else self._armed.discard)(can_id & 0x7F)

    def handed_over(self, frame: Frame) -> None:
        """A frame of the host. What set-points lead to is looked at elsewhere (test_set_points)."""
        place = (frame.can_id & 0x7F) - 1
        if frame.can_id & 0x780 == 0x200 and not isinstance(self._stage.drives[place], Cl3e):
            commanded = self.commanded[place]
            if commanded is None:
                drive = self._stage.drives[place]
                kind = CommandedSegments if isinstance(drive, Copley) else Commanded
                if kind is CommandedSegments and frame.data[0] & 0x80:
                    return
                commanded = kind(drive._demand)
                self.commanded[place] = commanded
            commanded.add(frame.data)

    def _look(self, t_us: float) -> None:
        stage = self._stage
        stage.director.at(t_us + SAMPLE_US, self._look)
        phase = stage.group.phase
        if phase in BEGUN or phase in (Phase.HALTING, Phase.QUICK_STOPPING):
            self._moving_allowed_us = t_us
        moving = [self._moves(place) for place in range(len(stage.drives))]
        for place, drive in enumerate(stage.drives):
            reachable = drive.powered and drive.connected
            if not reachable:
                self._good_us[place] = t_us
            bad = not reachable or drive.state.name.startswith("FAULT")
            self._bad_us[place] = min(self._bad_us[place], t_us) if bad else math.inf
            if moving[place]:
                self._commands(place, t_us)
        if phase in BEGUN and stage.group.modes == stage.machine.followers.modes:
            self._on_path(t_us)
        self._one_for_all(moving, t_us)

    def _moves(self, place: int) -> bool:
        drive, shafts = self._stage.drives[place], self._shafts[place]
        shafts.append(_shaft_qc(drive))
        if self._stage.outputs is not None:
            self._stage.outputs.look(place, shafts[-1])
        return len(shafts) == HISTORY and abs(shafts[-1] - shafts[0]) > REST_QC

    def _excuse_s(self, place: int) -> float:
        """Frames of this axis were meddled with: what is lost is made good some SYNCs later."""
        node = self._stage.drives[place].node_id
        since_us = self._stage.now_us - self._stage.meddled_us.get(node, -math.inf)
        return 3.0 if since_us < 4e6 else 0.0

    def _commands(self, place: int, t_us: float) -> None:
        """It moves: was it told to?"""
        stage = self._stage
        allowed_us = max(self._moving_allowed_us, self._good_us[place])
        allowed_us = max(allowed_us, min(t_us, self._unheard_us))
        grace_s = 0.06 + self._excuse_s(place)
        if stage.group.phase is Phase.FAULT:
            grace_s += SILENCE_S + RAMP_S
        if t_us - allowed_us > grace_s * 1e6:
            raise Broken("no motion without a command", f"joint_{place + 1} {self._when(t_us)}")

    def _on_path(self, t_us: float) -> None:
        stage = self._stage
        start_us = stage.machine.path_time.start_us
        if start_us is None or t_us < start_us:
            return
        k_ms = math.floor((t_us - start_us) / 1000)
        for place, drive in enumerate(stage.drives):
            path = self.commanded[place]
            enabled = drive.powered and drive.connected and drive.state.name == "OPERATION_ENABLED"
            if path is None or not enabled:
                self._off_us[place] = math.inf
                continue
            demand_qc = drive._demand
            near = [path.at(k_ms)]
            if abs(demand_qc - near[0]) > 2.5:
                near = [path.at(k) for k in range(k_ms - 3, k_ms + 4)]
            if min(near) - 2.5 <= demand_qc <= max(near) + 2.5:
                self._off_us[place] = math.inf
                continue
            off_us = self._off_us[place] = min(self._off_us[place], t_us)
            since_us = max(off_us, stage.woke_us, stage.wakes_us, self._good_us[place])
            bound_s = 2 * stage.config.sync_period + 0.03 + self._excuse_s(place)
            if t_us - since_us > bound_s * 1e6:
                text = f"joint_{place + 1} at {drive._demand:.0f} qc, not {path.at(k_ms):.0f}"
                raise Broken("on the path or stopping", f"{text} {self._when(t_us)}")

    def _one_for_all(self, moving: list[bool], t_us: float) -> None:
        stage = self._stage
        for bad, since_us in enumerate(self._bad_us):
            if since_us == math.inf or not any(moving):
                continue
            since_us = max(since_us, stage.woke_us, stage.wakes_us)
            for other in range(len(moving)):
                bound_s = SILENCE_S + RAMP_S + 0.3
                bound_s += max(self._excuse_s(bad), self._excuse_s(other))
                reached_us = max(since_us, self._good_us[other])
                if other != bad and moving[other] and t_us - reached_us > bound_s * 1e6:
                    text = f"joint_{other + 1} moves, joint_{bad + 1} is in trouble"
                    raise Broken("one for all", f"{text} {self._when(t_us)}")

    def _when(self, t_us: float) -> str:
        return f"at {t_us / 1e6:.3f} s, {self._stage.group.describe_phase()}"


# ---------------------------------------------------------------------------- a run


def _move(
    stage: Stage, action: Action, stamp_s: float | None = None, reach: float | None = None
) -> Future[Any] | None:
    """As a user would: from where the axes say that they stand, or on from where they move."""
    drives = stage.machine.followers.drives
    if not drives:
        return _move_to(stage, action)
    here = [(drive.standing_qc or 0) / QC_PER_RAD for drive in drives]
    to = [at + (action.reach if reach is None else reach) for at in here]
    points, times = np.array([here, to]), np.array([0.0, action.lasts_s])
    if stage.group.moving:
        points, times = points[1:], times[1:]
    still = np.zeros_like(points)
    joints = tuple(drive.joint for drive in drives)
    stamp_us = None if stamp_s is None else stage.now_us + stamp_s * 1e6
    stage.path.submit(Trajectory(joints, times, points, still, still), stamp_us, stage.now_us)
    return stage.group.motion


def _stream(stage: Stage, action: Action) -> Future[Any] | None:
    drives = stage.machine.followers.drives
    if not drives:
        return _move_to(stage, action)
    here = [(drive.standing_qc or 0) / QC_PER_RAD for drive in drives]
    joints = tuple(drive.joint for drive in drives)
    for n in range(1, 25):
        point = np.array([[at + action.reach * n / 25 for at in here]])
        stage.path.submit(Trajectory(joints, np.array([0.12]), point), None, stage.now_us)
        stage.run(0.03)
    return stage.group.motion


def _move_to(stage: Stage, action: Action) -> Future[Any]:
    drives = stage.machine.drives
    targets = {d.joint: (d.standing_qc or 0) / QC_PER_RAD + action.reach for d in drives}
    return stage.machine.move_to(targets, action.lasts_s)


def _home(stage: Stage, action: Action) -> Future[Any] | None:
    orders = stage.machine.homing_orders()
    if not orders:
        return None
    places = [stage.machine.drives.index(drive) for drive in orders[0]]
    if stage.outputs is None or not stage.group.standing:
        return stage.machine.home(places)
    for place in places:
        stage.outputs.disarm(place)
    answer = stage.machine.home(places)
    stage.outputs.arm_when(places, answer.done)
    return answer


REQUESTS: dict[str, Callable[[Stage, Action], Future[Any] | None]] = {
    "enable": lambda stage, _: stage.group.enable(),
    "disable": lambda stage, _: stage.path.disable(),
    "halt": lambda stage, _: stage.group.halt(),
    "quick_stop": lambda stage, _: stage.group.quick_stop(),
    "stop": lambda stage, _: stage.path.stop(),
    "reset_fault": lambda stage, _: stage.reset_fault(),
    "move": _move,
    "move_later": lambda stage, action: _move(stage, action, 0.4),
    "move_much_later": lambda stage, action: _move(stage, action, 2.0),
    "replace": lambda stage, action: _move(stage, action, reach=-action.reach / 2),
    "stream": _stream,
    "move_to": _move_to,
    "home": _home,
}


def _said(stage: Stage, what: str, error: Epos2RosError) -> None:
    text = str(error)
    if not text.strip() or "\n" in text:
        raise Broken("every refusal has a reason", f"{what}: {text!r}")
    stage.refused.append(f"{what}: {text}")


def _bring_up(stage: Stage) -> bool:
    try:
        stage.bring_up()
    except Epos2RosError as error:
        _said(stage, "bring-up", error)
        return False
    return True


def _do(stage: Stage, number: int, action: Action) -> None:
    stage.run(action.after_s)
    _let_loose(stage, number)
    try:
        answer = REQUESTS[action.name](stage, action)
    except Epos2RosError as error:
        _said(stage, action.name, error)
        return
    if answer is not None:
        stage.asked.append((action.name, answer))


def _let_loose(stage: Stage, number: int) -> None:
    for trouble in stage.scenario.troubles:
        if trouble.after == number:
            stage.later(trouble.at_s * 1e6, stage.trouble(trouble))


def _settle(stage: Stage, seconds: float = 1.0) -> None:
    """For so long, and until all is answered; then what it says has to be what is."""
    group, since_us = stage.group, stage.now_us

    def over() -> bool:
        answered = all(answer.done() for _, answer in stage.asked)
        rests = group.phase in KNOWN and group.motion is None
        return answered and rests and stage.now_us > since_us + seconds * 1e6

    stage.run(ANSWER_S, over)
    for name, answer in stage.asked:
        if not answer.done():
            raise Broken("every request is answered", f"{name} is not: {group.describe_phase()}")
        if error := answer.exception():
            if not isinstance(error, Epos2RosError):
                raise Broken("no exception", repr(error)) from error
            _said(stage, name, error)
    if not over():
        raise Broken("a known state at the end", group.describe_phase())
    if group.phase is Phase.FAULT and (not group.reason.strip() or "\n" in group.reason):
        raise Broken("every fault has a reason", repr(group.reason))


def _killed(stage: Stage, after_s: float) -> tuple[Stage, bool]:
    """The axes come to rest by themselves; another host finds the drives as they are."""
    stage.heal()
    stage.director._agenda.clear()
    killed_us, bus = stage.now_us, stage.bus
    bus.run_until(killed_us + after_s * 1e6, lambda *frame: None)
    if after_s >= SILENCE_S + RAMP_S + 0.3:
        before = [_shaft_qc(drive) for drive in stage.drives]
        bus.run_until(bus.now_us + 50e3, lambda *frame: None)
        after = [_shaft_qc(drive) for drive in stage.drives]
        if any(abs(a - b) > REST_QC for a, b in zip(after, before, strict=True)):
            raise Broken("the host may fail", f"the axes move {after_s:g} s after it was killed")
    another = Stage(stage.scenario, stage)
    another.events.extend(stage.events)
    another.watch.allow(killed_us + (SILENCE_S + RAMP_S) * 1e6)
    return another, _bring_up(another)


def _harmless(scenario: Scenario, trouble: Trouble) -> bool:
    """Whether it has to go unnoticed; a stall where it is covered by what the buffers hold."""
    streamed = any(action.name == "stream" for action in scenario.actions)
    if trouble.name == "stall" and trouble.after >= 0 and not streamed:
        return trouble.lasts_s <= min(scenario.buffer_time - 0.1, SILENCE_S - 0.1)
    if trouble.name == "length":  # the clock master's frames are read by the others
        return scenario.source == "host"
    return trouble.name in ("wall", "foreign")


def _meddles(scenario: Scenario) -> bool:
    """Whether single frames are lost, late or others than they were: who has, nobody can know."""
    return any(" to " in t.name or t.name in ("abort", "length") for t in scenario.troubles)


def _blames(stage: Stage) -> None:
    """What is said of an axis has happened to it; of troubles that don't touch single frames."""
    troubles = stage.scenario.troubles
    if _meddles(stage.scenario):
        return
    for text in (event.text for event in stage.events if event.kind == "fault"):
        for part in text.split("; "):
            for words, causes in BLAMED.items():
                found = JOINT.search(part)
                if words not in part or found is None:
                    continue
                axis = int(found[1]) - 1
                if not any(_reaches(stage.scenario, t, axis) for t in troubles if t.name in causes):
                    raise Broken("what is said is what has happened", text)


def _reaches(scenario: Scenario, trouble: Trouble, axis: int) -> bool:
    master = scenario.source == f"joint_{trouble.axis + 1}"
    return trouble.axis == axis or trouble.name == "other host" or master


def _as_fired(stage: Stage) -> None:
    """What is reported of outputs is what they have fired, when the axes have come to rest."""
    if stage.outputs is not None:
        stage.run(stage_outputs.REPORTED_S + 4 * stage.config.sync_period)
        if wrong := stage.outputs.difference():
            raise Broken("what is reported is what has fired", wrong)


def _no_fault(stage: Stage) -> None:
    """Where nothing has happened that the driver doesn't bear."""
    for event in stage.events:
        if event.kind == "fault":
            raise Broken("no fault without a cause", event.text)
    _as_fired(stage)


def _agree(stage: Stage) -> None:
    """With nothing in the way, the drives are in the state that the group is said to be in."""
    phase = stage.group.phase
    for place, drive in enumerate(stage.drives):
        state = drive.state.name
        wrong = phase is Phase.STANDING and state != "OPERATION_ENABLED"
        if wrong or (phase is Phase.DISABLED and state == "OPERATION_ENABLED"):
            text = f"joint_{place + 1} is in {state}, the group {stage.group.describe_phase()}"
            raise Broken("what is said is what is", text)


def _expect(stage: Stage, what: str, answer: Future[Any] | None, seconds: float = 20.0) -> None:
    """Of the way back, which has nothing in its way any more."""
    if answer is None:
        return
    stage.run(seconds, answer.done)
    if not answer.done():
        raise Broken("the way back", f"{what} is not answered: {stage.group.describe_phase()}")
    if error := answer.exception():
        raise Broken("the way back", f"{what}: {error}")


def _way_back(stage: Stage, brought_up: bool) -> None:
    """What a lost frame has left behind may come out with the first motion, in words; it has to be
    gone with the second."""
    try:
        if not brought_up:
            stage.bring_up()
        _again(stage)
    except (Broken, Epos2RosError) as error:
        if isinstance(error, Broken) and error.promise != "the way back":
            raise
        if not _meddles(stage.scenario):
            raise Broken("the way back", f"{error}") from error
        stage.took_twice = f"{error}"
        stage.run(0.5)
        _again(stage)


def _go(stage: Stage) -> None:
    """A clean end leaves no drive on, moving or in fault, however long nobody is there."""
    stage.close()
    stage.director._agenda.clear()
    stage.bus.run_until(stage.now_us + LEFT_S * 1e6, lambda *frame: None)
    before = [_shaft_qc(drive) for drive in stage.drives]
    stage.bus.run_until(stage.now_us + 0.1e6, lambda *frame: None)
    for place, drive in enumerate(stage.drives):
        if drive.state.name not in ("SWITCH_ON_DISABLED", "READY_TO_SWITCH_ON"):
            raise Broken("a clean end", f"joint_{place + 1} is left in {drive.state.name}")
        if abs(_shaft_qc(drive) - before[place]) > 0.5:
            raise Broken("a clean end", f"joint_{place + 1} still moves")


def _again(stage: Stage) -> None:
    try:
        _expect(stage, "reset_fault", stage.reset_fault())
        _expect(stage, "enable", stage.group.enable())
        if stage.outputs is not None:
            stage.run(stage_outputs.REPORTED_S + 4 * stage.config.sync_period)
            stage.outputs.begin()
        if stage.machine.followers.drives:
            places = [stage.machine.drives.index(d) for d in stage.machine.followers.drives]
            ends = [round(stage.machine.drives[p].standing_qc + 0.05 * QC_PER_RAD) for p in places]
            _expect(stage, "move", _move(stage, Action("move", 0, 0.05, 0.6)))
            at = [stage.drives[p].position_demand for p in places]
            if any(abs(a - b) > 1.1 for a, b in zip(at, ends, strict=True)):
                raise Broken("the way back", f"the axes arrived at {at}, not at {ends} qc")
        else:
            _expect(stage, "move_to", _move_to(stage, Action("move_to", 0, 0.05, 0.6)))
        _agree(stage)
        _as_fired(stage)
        _expect(stage, "quick_stop", stage.group.quick_stop())
        _expect(stage, "disable", stage.group.disable())
        _agree(stage)
    except Epos2RosError as error:
        raise Broken("the way back", str(error)) from error


@contextmanager
def _simulated_clock(stage: Stage) -> Iterator[None]:
    """Whoever looks at the clock sees that of the bus: a run does not depend on the computer."""
    clock = SimpleNamespace(
        monotonic=lambda: stage.now_us / 1e6,
        time_ns=lambda: round(stage.wall_at_us(stage.now_us) * 1000),
    )
    offset_us = lambda: stage.now_us - stage.wall_at_us(stage.now_us)  # noqa: E731
    with (
        mock.patch.object(timestamps, "time", clock),
        mock.patch.object(timestamps, "now_us", lambda: stage.now_us),
        mock.patch.object(timestamps, "wall_offset_us", offset_us),
        mock.patch.object(cia402_node, "time", clock),
        mock.patch.object(sdo_access, "time", clock),
        mock.patch.object(sdo_client, "time", clock),
    ):
        yield


def play(scenario: Scenario) -> Stage:
    """Run it; Broken when a promise is not kept."""
    stage = Stage(scenario)
    with _simulated_clock(stage):
        try:
            stage.bus.run_until(STARTED_US, lambda *frame: None)
            _let_loose(stage, -1)
            brought_up = _bring_up(stage) or (stage.run(0.5) or _bring_up(stage))
            for number, action in enumerate(scenario.actions if brought_up else ()):
                _do(stage, number, action)
            if scenario.killed_s is not None:
                stage, brought_up = _killed(stage, scenario.killed_s)
            elif brought_up:
                _settle(stage)
            if stage.outputs is not None and (wrong := stage.outputs.astray()):
                raise Broken("outputs fire where they are to", wrong)
            _blames(stage)
            if all(_harmless(scenario, trouble) for trouble in scenario.troubles):
                _no_fault(stage)
            stage.heal()
            if brought_up:
                _settle(stage, 1.5)
                _agree(stage)
            else:
                stage.run(1.5)
            _way_back(stage, brought_up)
            _go(stage)
        except (Broken, KeyboardInterrupt):
            raise
        except Exception as error:
            where = error.__traceback__
            while where and where.tb_next:
                where = where.tb_next
            at = f"{where.tb_frame.f_code.co_filename}:{where.tb_lineno}" if where else ""
            raise Broken("no exception", f"{error!r} {at}") from error
    return stage


def broken(scenario: Scenario) -> Broken | None:
    try:
        play(scenario)
    except Broken as promise:
        return promise
    return None


def smaller(scenario: Scenario) -> Iterator[Scenario]:
    """Without one of its troubles, actions or axes."""
    for name in ("troubles", "actions"):
        parts = getattr(scenario, name)
        for n in range(len(parts)):
            left = parts[:n] + parts[n + 1 :]
            less = replace(scenario, **{name: left})
            if name == "actions":
                moved = [
                    replace(t, after=t.after - (t.after >= n)) for t in scenario.troubles
                ]
                less = replace(less, troubles=tuple(moved))
            yield less
    for n in range(len(scenario.axes) if len(scenario.axes) > 1 else 0):
        left = [t for t in scenario.troubles if t.axis != n]
        yield replace(
            scenario,
            axes=scenario.axes[:n] + scenario.axes[n + 1 :],
            troubles=tuple(replace(t, axis=t.axis - (t.axis > n)) for t in left),
        )


def smallest(scenario: Scenario, promise: str) -> Scenario:
    """As small as it gets while the same promise is broken."""
    while True:
        for less in smaller(scenario):
            found = broken(less)
            if found is not None and found.promise == promise:
                scenario = less
                break
        else:
            return scenario


def report(seed: int, found: Broken) -> None:
    print(f"seed {seed}: {found}", flush=True)
    least = smallest(scenario_of(seed), found.promise)
    print(f"  {broken(least)}\n  {least}", flush=True)


def main() -> int:
    """Exits with 1 if a promise was broken."""
    parser = argparse.ArgumentParser(prog="campaign", description=__doc__)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--seed", type=int, help="run this one alone, and tell what was said")
    parser.add_argument("--whole", action="store_true", help="don't make failures small")
    chosen = parser.parse_args()
    logging.disable(logging.ERROR)  # canopen tells of each time-out
    if chosen.seed is not None:
        return _tell(chosen.seed, chosen.whole)
    counts: Counter[str] = Counter()
    happened: Counter[str] = Counter()
    twice: list[int] = []
    gc.freeze()  # what is there for all of them
    gc.disable()  # but for what each leaves
    begun_s = time.monotonic()
    for number, seed in enumerate(range(chosen.first, chosen.first + chosen.count), 1):
        if number % 50 == 0:
            gc.collect()
        if sys.stderr.isatty():
            print(f"\r{number} of {chosen.count} ", end="", file=sys.stderr)
        try:
            stage = play(scenario_of(seed))
            happened.update(event.kind for event in stage.events)
            happened["refusal"] += len(stage.refused)
            if stage.took_twice:
                twice.append(seed)
            continue
        except Broken as promise:
            found = promise
        counts[found.promise] += 1
        if chosen.whole:
            print(f"seed {seed}: {found}", flush=True)
        else:
            report(seed, found)
    took_s = time.monotonic() - begun_s
    print(f"{chosen.count} scenarios in {took_s:.0f} s, {counts.total()} broke a promise")
    print("of the others: " + ", ".join(f"{n} × {kind}" for kind, n in happened.most_common()))
    if twice:
        print(f"the way back took two attempts with seeds {twice}")
    for promise, count in counts.most_common():
        print(f"  {promise}: {count}")
    return 1 if counts else 0


def _tell(seed: int, whole: bool) -> int:
    print(scenario_of(seed))
    stage: list[Stage] = []
    made = Stage.__init__

    def note(self: Stage, scenario: Scenario, *more: Any) -> None:
        made(self, scenario, *more)
        stage.append(self)

    with mock.patch.object(Stage, "__init__", note):
        found = broken(scenario_of(seed))
    for event in stage[0].events:
        print(f"  {event.kind}: {event.text}")
    for line in stage[0].refused:
        print(f"  refused {line}")
    if stage[0].took_twice:
        print(f"  {stage[0].took_twice}")
    if found is not None and not whole:
        report(seed, found)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
