"""A trajectory that was accepted, from then until it ends."""

from __future__ import annotations

from concurrent.futures import Future

from epos2_ros.errors import MotionStopped
from epos2_ros.protocol.phase import End


class Execution:
    """`ended` gets a result when all axes rest at the trajectory's end.

    Otherwise `MotionStopped`: it was stopped on its path, never began, or another trajectory has
    taken over; or `MotionAborted`: the axes left its path. They rest then, except where another
    trajectory has taken over. `start_ms` is where on path time its own zero is; None until it is
    known.
    """

    def __init__(self) -> None:
        self.ended: Future[None] = Future()
        self.start_ms: int | None = None
        self._stopped_for = ""

    def run(self, motion: Future[End], start_ms: int) -> None:
        """The axes follow it in `motion`."""
        self.start_ms = start_ms
        motion.add_done_callback(self._on_end)

    def stop_for(self, reason: str) -> None:
        """It will be stopped on its path."""
        self._stopped_for = self._stopped_for or reason

    def give_up(self, reason: str) -> None:
        """It is not followed any more."""
        self._end(MotionStopped(reason))

    def _on_end(self, motion: Future[End]) -> None:
        error = motion.exception()
        if error is None and motion.result() is End.STOPPED:
            error = MotionStopped(f"{End.STOPPED.value}: {self._stopped_for}")
        self._end(error)

    def _end(self, error: BaseException | None) -> None:
        if self.ended.done():
            return
        if error is None:
            self.ended.set_result(None)
        else:
            self.ended.set_exception(error)
