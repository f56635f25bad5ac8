"""Layouts of PlotJuggler 3, and what it calls the series of the driver's topics.

As its sources read them: `MainWindow::loadLayoutFromFile` (version, streamer),
`TabbedPlotWidget`, `PlotDocker` and `PlotWidget::xmlLoadState`, `DataStreamROS2` and
`RosParserConfig::xmlLoadState`; series are named in `ParserROS` (`parseDiagnosticMsg`,
`parseJointStateMsg`).
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from epos2_ros.layout.tabs import Curve, JointField, Plot, Tab

VERSION = "2.3.8"  # of the format; PlotJuggler asks before it loads another
STREAMER = "ROS2 Topic Subscriber"
COLOURS = ("#1f77b4", "#d62728", "#2ca02c", "#ff7f0e", "#9467bd", "#8c564b", "#17becf", "#e377c2")


def layout(tabs: Sequence[Tab]) -> str:
    """The XML file; it asks to stream exactly the topics it draws."""
    root = Element("root", version=VERSION)
    widget = SubElement(root, "tabbed_widget", {"parent": "main_window", "name": "Main Window"})
    for tab in tabs:
        _tab(SubElement(widget, "Tab", tab_name=tab.title, containers="1"), tab)
    SubElement(widget, "currentTabIndex", index="0")
    SubElement(root, "use_relative_time_offset", enabled="1")
    plugin = SubElement(SubElement(root, "Plugins"), "plugin", ID=STREAMER)
    for name, value in (
        ("use_header_stamp", "true"),
        ("discard_large_arrays", "true"),
        ("max_array_size", "100"),
        ("boolean_strings_to_number", "true"),
        ("remove_suffix_from_strings", "true"),
    ):
        SubElement(plugin, name, value=value)
    selected = SubElement(plugin, "selected_topics")
    curves = (curve for tab in tabs for plot in tab.plots for curve in plot.curves)
    for topic in dict.fromkeys(curve.topic for curve in curves):
        SubElement(selected, "topic", name=topic)
    SubElement(root, "previouslyLoaded_Streamer", name=STREAMER)
    ElementTree.indent(root)
    return "<?xml version='1.0' encoding='UTF-8'?>\n" + ElementTree.tostring(root, "unicode") + "\n"


def series(curve: Curve) -> str:
    """Its name in PlotJuggler."""
    if isinstance(curve, JointField):
        return f"{curve.topic}/{curve.joint}/{curve.field}"
    return f"{curve.topic}/{curve.hardware_id}/{curve.status}/{curve.key}"


def _tab(into: Element, tab: Tab) -> None:
    count = len(tab.plots)
    sizes = ";".join([f"{1 / count:.6f}"] * count)
    below = {"orientation": "-", "count": str(count), "sizes": sizes}  # one below another
    splitter = SubElement(SubElement(into, "Container"), "DockSplitter", below)
    for plot in tab.plots:
        _plot(SubElement(splitter, "DockArea", name=plot.title), plot)


def _plot(into: Element, plot: Plot) -> None:
    style = "Dots" if plot.events else "Lines"
    made = SubElement(into, "plot", mode="TimeSeries", style=style, flip_x="false", flip_y="false")
    SubElement(made, "range", left="0", right="1", bottom="0", top="1")
    SubElement(made, "limitY")
    for curve, colour in zip(plot.curves, cycle(COLOURS), strict=False):
        SubElement(made, "curve", name=series(curve), color=colour)
