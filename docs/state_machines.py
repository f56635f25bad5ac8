"""Writes the figures of docs/architecture.md that are the code's own tables.

    python docs/state_machines.py

A figure stands between `<!-- figure: name -->` and the next `<!-- end -->`.
"""

from __future__ import annotations

import re
from pathlib import Path

from epos2_ros.protocol import cia402
from epos2_ros.protocol.cia402 import State
from epos2_ros.protocol.phase import FROM_ANYWHERE, STEPS

PAGE = Path(__file__).parent / "architecture.md"
FIGURE = re.compile(r"(<!-- figure: (\w+) -->\n)(.*?)(<!-- end -->)", re.DOTALL)
CONTROLWORDS = {  # what each is called, and the state it leads to
    cia402.SHUTDOWN: ("shutdown", State.READY_TO_SWITCH_ON),
    cia402.ENABLE_OPERATION: ("enable operation", State.OPERATION_ENABLED),
    cia402.DISABLE_VOLTAGE: ("disable voltage", State.SWITCH_ON_DISABLED),
    cia402.FAULT_RESET: ("fault reset", State.SWITCH_ON_DISABLED),
}


def phases() -> str:
    """The phases of a group (`protocol/phase.STEPS`)."""
    steps = [
        f"    {_name(before.value)} --> {_name(after.value)}: {why}"
        for before, row in STEPS.items()
        for after, why in row.items()
    ]
    anywhere = [
        f"    anywhere --> {_name(phase.value)}: {why}" for phase, why in FROM_ANYWHERE.items()
    ]
    return _diagram([*steps, *anywhere])


def walks() -> str:
    """Which controlword goes to a drive in which state (`protocol/cia402.WALKS`), by target."""
    steps = []
    for target, row in cia402.WALKS.items():
        for state, controlword in row.items():
            words, after = CONTROLWORDS[controlword]
            why = f"{words} {controlword:04X}h, on the way to {target.value}"
            steps.append(f"    {_name(state.value)} --> {_name(after.value)}: {why}")
    return _diagram(steps)


def _diagram(lines: list[str]) -> str:
    return "\n".join(("```mermaid", "stateDiagram-v2", *lines, "```", ""))


def _name(words: str) -> str:
    return words.replace(" ", "_")


FIGURES = {"phases": phases, "walks": walks}


def drawn(page: str) -> str:
    """The page with its figures as the tables have them now."""
    return FIGURE.sub(lambda found: found[1] + FIGURES[found[2]]() + found[4], page)


if __name__ == "__main__":
    PAGE.write_text(drawn(PAGE.read_text()))
