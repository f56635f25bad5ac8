"""Simulated drives on a python-can bus, in real time.

One thread waits for frames and for whatever the drives are to do next. The drives' time is
CLOCK_MONOTONIC in µs; a frame counts from when the interface stamped it, so a late thread
moves no SYNC.
"""

from __future__ import annotations

import math
import random
import threading
import time
from collections import deque
from collections.abc import Callable, Collection, Sequence
from pathlib import Path

import can

from .cl3e import Cl3e
from .copley import Copley
from .epos2 import Dictionary, Epos2
from .recorder import save
from .slave import Slave

CYCLE_US = 4000.0  # drives are run no more often, for all control cycles since the last time
TRANSMIT_QUEUE = 256  # frames; the oldest are lost when the bus doesn't take them
_LONGEST_WAIT_S = 0.1  # for a frame, so that `stop` is noticed
_OLDEST_STAMP_US = 1e6  # an older time stamp is of another clock
_UNDISTURBED_US = 5.0  # reading three clocks takes less
_CLOCK_READINGS = 10
_READ_US = 2_000.0  # reading them takes less
_STEP_US = 20_000.0  # a reading that was disturbed is not off by so much
_REREAD_US = 100_000.0  # the two clocks go alike; only a step of the wall clock parts them


def now_us() -> float:
    """The drives' time: CLOCK_MONOTONIC [µs]."""
    return time.monotonic_ns() / 1000


def wall_offset_us() -> float:
    """CLOCK_MONOTONIC minus wall clock [µs], read without being interrupted in between."""
    best_us, offset_us = math.inf, 0.0
    for _ in range(_CLOCK_READINGS):
        before = time.monotonic_ns()
        wall = time.time_ns()
        taken_us = (time.monotonic_ns() - before) / 1000
        if taken_us < best_us:
            best_us, offset_us = taken_us, (before - wall) / 1000
        if taken_us < _UNDISTURBED_US:
            break
    return offset_us


def build_drives(
    node_ids: Sequence[int],
    *,
    counts_per_turn: int | Sequence[int] = 2000,
    drift_ppm: float = 0.0,
    seed: int = 0,
    bitrate: int = 1_000_000,
    record: bool = False,
    dictionary: Dictionary = Dictionary.MAKER,
) -> list[Epos2]:
    """Drives whose clocks start anywhere and run at 1 + U(−drift_ppm, drift_ppm)·1e-6."""
    rng = random.Random(seed)
    if isinstance(counts_per_turn, int):
        counts_per_turn = [counts_per_turn] * len(node_ids)
    return [
        Epos2(
            node_id,
            counts_per_turn=counts,
            drift_ppm=rng.uniform(-drift_ppm, drift_ppm),
            offset_us=rng.uniform(0.0, 2.0**32),
            bitrate=bitrate,
            seed=seed + node_id,
            record=record,
            dictionary=dictionary,
            serial=node_id,
            t_us=now_us(),
        )
        for node_id, counts in zip(node_ids, counts_per_turn, strict=True)
    ]


def build_copley_drives(
    node_ids: Sequence[int],
    *,
    drift_ppm: float = 0.0,
    seed: int = 0,
    record: bool = False,
    extrapolated: Collection[int] = (),
) -> list[Copley]:
    """Likewise; the encoders of `extrapolated` nodes are sampled once a loop, not quadrature."""
    rng = random.Random(f"copley {seed}")
    return [
        Copley(
            node_id,
            quadrature=node_id not in extrapolated,
            drift_ppm=rng.uniform(-drift_ppm, drift_ppm),
            offset_us=rng.uniform(0.0, 2.0**32),
            record=record,
            serial=node_id,
            t_us=now_us(),
        )
        for node_id in node_ids
    ]


def build_cl3e_drives(
    node_ids: Sequence[int],
    *,
    counts_per_turn: int | Sequence[int] = 2000,
    drift_ppm: float = 0.0,
    seed: int = 0,
    record: bool = False,
) -> list[Cl3e]:
    """Likewise; what the drives' encoders count is stored in them."""
    rng = random.Random(f"cl3e {seed}")
    if isinstance(counts_per_turn, int):
        counts_per_turn = [counts_per_turn] * len(node_ids)
    return [
        Cl3e(
            node_id,
            counts_per_turn=counts,
            drift_ppm=rng.uniform(-drift_ppm, drift_ppm),
            record=record,
            serial=node_id,
            t_us=now_us(),
        )
        for node_id, counts in zip(node_ids, counts_per_turn, strict=True)
    ]


def save_log(path: str | Path, drives: Sequence[Epos2 | Copley | Cl3e]) -> None:
    """Writes what recording drives have executed as `node_<id>_<column>` into an .npz file."""
    save(path, [(drive.node_id, drive.recorder) for drive in drives if drive.recorder])


OnFrame = Callable[[float, int, bytes, bool], None]


class RealtimeSimulator:
    """Runs drives on `bus` from `start` to `stop`; the bus stays the caller's.

    `on_frame(t_us, can_id, data, sent)` is called for every data frame, `sent` by a drive or
    received. Whoever touches a drive meanwhile (to let it fail, say) holds `lock`.
    `error` tells why the bus is not usable at the moment, if so.
    """

    def __init__(
        self,
        bus: can.BusABC,
        drives: Sequence[Slave],
        on_frame: OnFrame = lambda t_us, can_id, data, sent: None,
    ) -> None:
        self._on_frame = on_frame
        self.lock = threading.Lock()
        self.error: str | None = None
        self._bus = bus
        self._drives = list(drives)
        self._queue: deque[tuple[Slave, int, bytes]] = deque(maxlen=TRANSMIT_QUEUE)
        self._wall_offset_us = 0.0
        self._wall_read_us = -math.inf
        self._offset_before_us = math.inf  # before the wall clock was set last, a moment ago
        self._stepped_us = -math.inf  # when that was
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="simulated drives", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        """Ends the thread; the drives fall silent."""
        self._stopping.set()
        self._thread.join()

    def push(self, node_id: int, counts: float) -> bool:
        """A hand turns the shaft of one drive; `False`: it is held, or there is no such drive."""
        with self.lock:
            pushed = [d.push(counts) for d in self._drives if d.node_id == node_id]
        return any(pushed)

    def _run(self) -> None:
        last_us = -CYCLE_US
        while not self._stopping.is_set():
            now = now_us()
            if max(self._due_us(), last_us + CYCLE_US) <= now:
                # What came in while this thread was kept waiting came before that moment.
                while self._take(0.0):
                    pass
                with self.lock:
                    for drive in self._drives:
                        drive.advance(now)
                last_us = now
            with self.lock:
                sent = self._flush()
            wait_s = (max(self._due_us(), last_us + CYCLE_US) - now_us()) / 1e6
            if not sent:
                wait_s = min(wait_s, CYCLE_US / 1e6)  # then try again
            self._take(max(0.0, min(wait_s, _LONGEST_WAIT_S)))

    def _due_us(self) -> float:
        return min(drive.next_event_us for drive in self._drives)

    def _take(self, seconds: float) -> bool:
        """Hands the next frame to the drives, if one comes in time; `False` if none did."""
        try:
            message = self._bus.recv(seconds)
            self.error = None
        except can.CanError as error:
            self.error = str(error)
            self._stopping.wait(_LONGEST_WAIT_S)  # the interface is down: look again later
            return False
        if message is None:
            return False
        if not (message.is_extended_id or message.is_error_frame or message.is_fd):
            t_us = self._time_of(message)
            if not message.is_remote_frame:
                self._on_frame(t_us, message.arbitration_id, bytes(message.data), False)
            with self.lock:
                for drive in self._drives:
                    drive.receive(
                        message.arbitration_id, bytes(message.data), t_us, message.is_remote_frame
                    )
        return True

    def _time_of(self, message: can.Message) -> float:
        """When the frame was on the bus; now, if its stamp is not of the system's wall clock.

        That clock may be set between the stamp and now: then it is one of before, or of after.
        """
        now = now_us()
        parted = abs(now - time.time_ns() / 1000 - self._wall_offset_us) > _READ_US
        if parted or now > self._wall_read_us + _REREAD_US:
            offset, self._wall_read_us = wall_offset_us(), now
            if abs(offset - self._wall_offset_us) > _STEP_US:
                self._offset_before_us, self._stepped_us = self._wall_offset_us, now
            elif now > self._stepped_us + _OLDEST_STAMP_US:
                self._offset_before_us = math.inf
            self._wall_offset_us = offset
        offsets = self._wall_offset_us, self._offset_before_us
        times = [message.timestamp * 1e6 + offset for offset in offsets]
        return max((t_us for t_us in times if now - _OLDEST_STAMP_US < t_us < now), default=now)

    def _flush(self) -> bool:
        """Sends what the drives have to say; `False` if the interface didn't take all of it."""
        for drive in self._drives:
            while drive.outbox:
                self._queue.append((drive, *drive.outbox.popleft()))
        while self._queue:
            sender, can_id, data = self._queue[0]
            message = can.Message(arbitration_id=can_id, data=data, is_extended_id=False)
            try:
                self._bus.send(message)
            except can.CanError:
                return False  # kept, and tried again: a full transmit queue, a bus that is down
            self._queue.popleft()
            now = now_us()
            self._on_frame(now, can_id, data, True)
            sender.transmitted(can_id, now)
            for drive in self._drives:  # a bus doesn't give us back what we send ourselves
                if drive is not sender:
                    drive.receive(can_id, data, now)
        return True
