"""The bounds of docs/faults.md, each at an instant or two; `benchmarks.faults` looks at more."""

from __future__ import annotations

import pytest

from benchmarks import faults


@pytest.mark.parametrize("kind", faults.KINDS, ids=lambda kind: kind.words)
def test_all_stand_within_the_bound(kind: faults.Kind) -> None:
    for on_path, seed in ((True, 3), *([] if kind.only_on_path else [(False, 4)])):
        found = faults.measure(kind, on_path, seed)
        assert found.reaction_s <= kind.bound_s
        assert found.rest_s <= faults.bound_s(kind)
        assert found.said or not kind.host_lives
        assert "\n" not in found.said
