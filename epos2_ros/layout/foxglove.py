"""Layouts of Foxglove and Lichtblick, its free fork, and message paths to the driver's topics.

As the sources of Foxglove Studio read them: `LayoutData` (panels by id, `Type!name`; a layout is
a tree of rows and columns), `PlotConfig`, the panels Tab and DiagnosticSummary, and the grammar of
message paths. A value that is text is drawn where JavaScript's `Number` takes it for one.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from epos2_ros.layout.tabs import Curve, JointField, Plot, Tab

Node = str | dict[str, Any]
TABS = "Tab!epos2_ros"
DIAGNOSTICS = "DiagnosticSummary!epos2_ros"


def layout(tabs: Sequence[Tab]) -> str:
    """The JSON file: a summary of the diagnostics beside tabs of plots."""
    panels: dict[str, dict[str, Any]] = {
        DIAGNOSTICS: {
            "minLevel": 0,
            "pinnedIds": [],
            "hardwareIdFilter": "",
            "topicToRender": "/diagnostics",
            "sortByLevel": True,
        }
    }
    shown = []
    for t, tab in enumerate(tabs):
        ids = [f"Plot!epos2_ros_{t}_{p}" for p in range(len(tab.plots))]
        panels |= zip(ids, map(_plot, tab.plots), strict=True)
        shown.append({"title": tab.title, "layout": _column(ids)})
    panels[TABS] = {"activeTabIdx": 0, "tabs": shown}
    data = {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": {
            "direction": "row",
            "first": DIAGNOSTICS,
            "second": TABS,
            "splitPercentage": 25,
        },
    }
    return json.dumps(data, indent=2, ensure_ascii=False) + "\n"


def path(curve: Curve) -> str:
    """Where its values are."""
    if isinstance(curve, JointField):
        return f"{curve.topic}.{curve.field}[{curve.place}]"
    status = f'{curve.topic}.status[:]{{name=="{curve.status}"}}'
    return f'{status}.values[:]{{key=="{curve.key}"}}.value'


def _column(panels: Sequence[str]) -> Node:
    """One below another, all of the same height."""
    first, *others = panels
    if not others:
        return first
    return {
        "direction": "column",
        "first": first,
        "second": _column(others),
        "splitPercentage": 100 / len(panels),
    }


def _plot(plot: Plot) -> dict[str, Any]:
    return {
        "foxglovePanelTitle": plot.title,
        "lichtblickPanelTitle": plot.title,
        "paths": [
            {
                "value": path(curve),
                "enabled": True,
                "timestampMethod": "headerStamp",
                "label": curve.label,
                "showLine": not plot.events,
            }
            for curve in plot.curves
        ],
        "xAxisVal": "timestamp",
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "showLegend": True,
        "legendDisplay": "floating",
        "showPlotValuesInLegend": True,
        "isSynced": True,
        "followingViewWidth": 30,
        "sidebarDimension": 240,
    }
