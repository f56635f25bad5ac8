"""Time stamps of frames in host time, whatever becomes of the clock that stamps them."""

from __future__ import annotations

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from two_processes import SCAN, rig

from epos2_ros.bus.timestamps import ReceiveClock
from epos2_ros.motion.trajectory import Trajectory

EPOCH_S = 1.7e9


class Clocks:
    """The host's two clocks, in our hands; `t_s` is true time."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.t_s = 1000.0
        self.wall_s = EPOCH_S  # ahead of true time
        monkeypatch.setattr(time, "monotonic_ns", lambda: round(self.t_s * 1e9))
        monkeypatch.setattr(time, "time_ns", lambda: round((self.t_s + self.wall_s) * 1e9))
        monkeypatch.setattr(time, "time", lambda: self.t_s + self.wall_s)


steps = st.sampled_from([-86_400.0, -4.0, -2.0, -0.3, 0.3, 2.0, 4.0, 86_400.0])


@settings(max_examples=200, deadline=None)
@given(
    st.lists(
        st.tuples(st.floats(1e-5, 0.2), st.floats(1e-5, 0.1), st.none() | steps, st.booleans()),
        min_size=1,
        max_size=40,
    )
)
def test_a_step_of_the_wall_clock_moves_no_frame(
    frames: list[tuple[float, float, float | None, bool]],
) -> None:
    """Each frame: time since the last, how late it is read, a step, before or after its stamp."""
    with pytest.MonkeyPatch.context() as monkeypatch:
        clocks, clock = Clocks(monkeypatch), ReceiveClock()
        clock.host_us(clocks.t_s + clocks.wall_s)
        for gap_s, delay_s, step_s, stamped_first in frames:
            clocks.t_s += gap_s
            if step_s and not stamped_first:
                clocks.wall_s += step_s
            on_bus_s, stamp_s = clocks.t_s, clocks.t_s + clocks.wall_s
            if step_s and stamped_first:
                clocks.wall_s += step_s
            clocks.t_s += delay_s
            # Microseconds since 1970 have 0.25 µs in a float.
            assert clock.host_us(stamp_s) == pytest.approx(on_bus_s * 1e6, abs=1.0)
            assert clock.source == "system clock of the adapter's driver"


def test_a_hardware_clock_that_drifts_is_followed(monkeypatch: pytest.MonkeyPatch) -> None:
    for ppm in (-100.0, 100.0):
        clocks, clock = Clocks(monkeypatch), ReceiveClock()
        rng = np.random.default_rng(1)
        begin_s = clocks.t_s
        for _ in range(36_000):  # an hour
            clocks.t_s += 0.1
            on_bus_s = clocks.t_s
            stamp_s = 5.0 + (on_bus_s - begin_s) * (1 + ppm * 1e-6)
            late_s = rng.exponential(2e-4) + 1e-4
            clocks.t_s += late_s
            found = clock.host_us(stamp_s)
            clocks.t_s -= late_s
        assert clock.source == "hardware clock of the adapter"
        assert abs(found - on_bus_s * 1e6) < 3000.0


@pytest.mark.parametrize("step_s", [-2.0, 4.0])
def test_axes_move_on_when_the_wall_clock_is_set(
    step_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    ahead_s = 0.0
    real, real_ns = time.time, time.time_ns
    monkeypatch.setattr(time, "time", lambda: real() + ahead_s)
    monkeypatch.setattr(time, "time_ns", lambda: real_ns() + round(ahead_s * 1e9))
    with rig("virtual", f"step {step_s}", simulate=True) as made:
        moves = Trajectory(SCAN.joint_names, np.array([2.0]), np.array([[0.05, -0.02]]))
        made.driver.submit(moves)
        made.wait(lambda snapshot: snapshot.state == "moving")
        time.sleep(0.5)
        ahead_s = step_s
        snapshot = made.wait(lambda snapshot: snapshot.state in ("standing", "fault"))
        assert snapshot.state == "standing", snapshot.reason
        for axis in snapshot.axes:
            assert axis.clock_offset_us is not None
            assert abs(axis.clock_offset_us) < 1000.0
