"""What outputs will fire in a motion: known before it runs, held against what they report after.

It looks at what the axes follow, whoever has told them: a reference that is new or has changed, a
move that has been prepared. Predicting a reference takes a while, so a thread of its own does it, a
piece at a time; everything else happens in the reactor's thread.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial

import numpy as np

from epos2_ros.bus.reactor import Reactor
from epos2_ros.bus.supervisor import Supervisor
from epos2_ros.motion.compare import predict
from epos2_ros.motion.crossings import Path
from epos2_ros.motion.foresight import Foresight
from epos2_ros.motion.reference import Reference
from epos2_ros.motion.stream import Stream
from epos2_ros.motion.trapezoid import Trapezoid
from epos2_ros.protocol.machine import Machine
from epos2_ros.protocol.outputs.outputs import Outputs
from epos2_ros.protocol.phase import IN_MOTION, End, Phase

PIECE_MS = 10_000


class Predictor:
    """`warn` gets the lines to be said before a motion; from any thread."""

    def __init__(
        self,
        joints: Sequence[str],
        machine: Machine,
        outputs: Outputs,
        reactor: Reactor,
        warn: Callable[[str], None],
        supervisor: Supervisor,
    ) -> None:
        self._supervisor = supervisor
        self._group = machine.group
        self._following = machine.followers
        self._profile = machine.profile
        self._outputs = outputs
        self._reactor = reactor
        self._warn = warn
        self._followers = [joints.index(drive.joint) for drive in machine.followers.drives]
        self._place = {drive: joints.index(drive.joint) for drive in machine.drives}
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="prediction")
        self._motion: Future[End] | None = None  # along a reference; None: there is none
        self._reference: Reference | None = None  # that it follows, or has followed last
        self._moves: dict[int, Trapezoid] = {}  # by axis, that are under way
        # The predicting thread's own: by output, of the motion in progress.
        self._foresights: dict[str, tuple[int, Foresight]] = {}
        self._until_ms = 0

    def close(self) -> None:
        """Give up what is being predicted."""
        self._reference = None
        self._thread.shutdown(cancel_futures=True)

    def watch(self, now_us: float) -> None:
        """Look whether a motion has begun or is over, and right after what the group follows has
        changed: what is committed to the drives then stays as it was."""
        self._watch_reference(now_us)
        self._watch_moves(now_us)

    # ------------------------------------------------------------------ trajectories

    def _watch_reference(self, now_us: float) -> None:
        group, followers = self._group, self._following
        following = group.phase in IN_MOTION and group.modes == followers.modes
        motion, before = group.motion if following else None, self._motion
        reference = followers.reference
        if motion is not before and before is not None:
            self._finish(self._followers, self._arrival_us, now_us)
        self._motion = motion
        if motion is None or reference is self._reference:
            return
        assert reference is not None
        self._reference = reference
        if motion is before:  # the same up to the end of what is committed
            self._compute(partial(self._extend, reference, followers.committed_ms))
        else:
            self._begin(reference)

    def _begin(self, reference: Reference) -> None:
        foresights = {}
        for column, axis in enumerate(self._followers):
            for name, trigger in self._outputs.triggers(axis).items():
                foresights[name] = column, Foresight(trigger, reference.units[column])
            self._outputs.begin(axis)
        self._compute(partial(self._predict, reference, foresights))

    def _compute(self, job: Callable[[], None]) -> None:
        self._thread.submit(self._supervisor.guarded("predicting outputs", job))

    def _predict(self, reference: Reference, foresights: dict[str, tuple[int, Foresight]]) -> None:
        self._foresights, self._until_ms = foresights, 0
        self._extend(reference, 0)

    def _extend(self, reference: Reference, from_ms: int) -> None:
        """From there on the motion goes along `reference`."""
        if not self._foresights:
            return
        if from_ms > self._until_ms:  # there is a gap: no prediction of this motion
            self._foresights = {}
            for axis in self._followers:
                self._reactor.post(partial(self._outputs.forget, axis))
            return
        self._until_ms = from_ms
        for _, foresight in self._foresights.values():
            foresight.forget(1000.0 * from_ms)
        while self._until_ms < reference.end_ms:
            k = np.arange(self._until_ms, min(self._until_ms + PIECE_MS, reference.end_ms) + 1)
            positions, velocities = reference.positions(k), reference.velocities(k)
            t_us = 1000.0 * k.astype(np.float64)
            for column, foresight in self._foresights.values():
                foresight.extend(Path(t_us, positions[:, column], velocities[:, column]))
            self._until_ms = int(k[-1])
            if self._reference is not reference:
                return  # it has changed in the meantime
        predictions = {name: f.prediction() for name, (_, f) in self._foresights.items()}
        self._reactor.post(partial(self._outputs.expect, predictions))
        if not isinstance(reference.motions[-1], Stream):  # whose end is always a moment ahead
            for name, prediction in predictions.items():
                for warning in prediction.warnings:
                    self._warn(f"compare.{name}: {warning}")

    # ------------------------------------------------------------------ moves

    def _watch_moves(self, now_us: float) -> None:
        group, profile = self._group, self._profile
        moving = group.phase in IN_MOTION and profile in group.modes
        if moving and not self._moves:
            self._moves = {self._place[drive]: move for drive, move in profile.moves.items()}
            for axis, move in self._moves.items():
                self._begin_move(axis, move)
        elif self._moves and not moving:
            self._finish(list(self._moves), self._arrival_us, now_us)
            self._moves = {}

    @property
    def _arrival_us(self) -> float | None:
        """When the motion that has ended began; None when it did not come to its end."""
        arrived = self._group.phase is Phase.STANDING
        return self._group.path_time.start_us if arrived else None

    def _begin_move(self, axis: int, move: Trapezoid) -> None:
        units, path = self._outputs.units[axis], move.path(0.0)
        predictions = {
            name: predict(trigger, path, units)
            for name, trigger in self._outputs.triggers(axis).items()
        }
        self._outputs.begin(axis)
        self._outputs.expect(predictions)
        for name, prediction in predictions.items():
            for warning in prediction.warnings:
                self._warn(f"compare.{name}: {warning}")

    # ------------------------------------------------------------------ the end

    def _finish(self, axes: Sequence[int], start_us: float | None, now_us: float) -> None:
        """The motion of these axes is over, at the end that was predicted if `start_us` is set."""
        for axis in axes:
            if start_us is None:
                self._outputs.forget(axis)
            else:
                self._outputs.finished(axis, start_us, now_us)
