"""The phases of a group: the figure in the docs, the table, and what happens are the same."""

from __future__ import annotations

import importlib.util
from pathlib import Path

from epos2_ros.protocol.phase import STEPS, Phase

DOCS = Path(__file__).resolve().parents[2] / "docs"


def test_the_figures_are_those_of_the_code() -> None:
    spec = importlib.util.spec_from_file_location("figures", DOCS / "state_machines.py")
    figures = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(figures)
    page = figures.PAGE.read_text()
    assert all(f"figure: {name}" in page for name in figures.FIGURES)
    assert figures.drawn(page) == page, "run: python docs/state_machines.py"


def test_every_phase_is_left_by_somebody_s_request_or_by_itself() -> None:
    assert set(STEPS) == set(Phase)
    reached, way = set(), {Phase.FAULT}
    while way:
        reached |= way
        way = {after for before in way for after in STEPS[before]} - reached
    assert reached | {Phase.QUICK_STOPPING} == set(Phase)
