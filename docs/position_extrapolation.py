"""Draws docs/position_extrapolation.svg: what a simulated Copley drive makes of a hard stop.

The numbers are those of the figure in Copley, "Setting outputs at position", section "Position
extrapolation": 600,000 counts/s, slowed down by 400,000,000 counts/s², at rest at 450.

    python docs/position_extrapolation.py
"""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np

matplotlib.use("svg")
import matplotlib.pyplot as plt

from epos2_ros.sim.copley import LOOP_US, Copley

VELOCITY, DECELERATION = 600_000.0, 400e6
REST_US = VELOCITY / DECELERATION * 1e6
TARGET = 460
END_US = 2000.0


def motion(t_us: float) -> tuple[float, float]:
    """Position [counts] and velocity [counts/s] of the shaft."""
    t = min(t_us, REST_US) * 1e-6
    return VELOCITY * t - 0.5 * DECELERATION * t**2, VELOCITY - DECELERATION * t


def main() -> None:
    """Steps the drive loop by loop and draws what its compare module saw."""
    drive = Copley(1, quadrature=False, count_offset=0.0)
    drive.module.values = [TARGET, TARGET]
    drive.module.configure(1)
    drive.move_by_hand(motion)
    samples, extrapolated = [], []
    for loop in range(int(END_US / LOOP_US) + 1):
        drive.advance(loop * LOOP_US)
        samples.append((drive.now_us, drive.position_actual))
        extrapolated += [samples[-1], (drive.now_us + LOOP_US, drive.extrapolated)]

    figure, axes = plt.subplots(figsize=(7, 4.2))
    close_up = axes.inset_axes((0.27, 0.07, 0.36, 0.4), xlim=(1200, 1650), ylim=(434, 464))
    fine_us = np.linspace(0.0, END_US, 500)
    for view in (axes, close_up):
        view.plot(fine_us, [motion(t)[0] for t in fine_us], "b", label="actual position")
        view.plot(*zip(*extrapolated, strict=True), "g", lw=1, label="extrapolated position")
        view.plot(*zip(*samples, strict=True), "ro", ms=4, label=f"samples, every {LOOP_US:g} µs")
        view.axhline(TARGET, color="0.5", lw=0.8, ls="--")
        for event in drive.module.fired:
            view.plot(event.t_us, event.value, "k^" if event.rising else "kv", ms=6)
    rest, (_, high) = drive.position_actual, drive.seen
    axes.annotate(f"target {TARGET}, fires twice; extrapolated up to {high}", (20, TARGET + 8))
    axes.annotate(f"at rest at {rest}", (1680, rest - 28))
    axes.indicate_inset_zoom(close_up, edgecolor="0.3")
    close_up.tick_params(labelsize=7)
    axes.set(xlim=(0, END_US), ylim=(0, 500), xlabel="time [µs]", ylabel="position [counts]")
    axes.legend(loc="lower right", fontsize=8)
    axes.grid(alpha=0.3)
    figure.tight_layout()
    figure.savefig(Path(__file__).with_suffix(".svg"), metadata={"Date": None})


if __name__ == "__main__":
    main()
