"""`epos2_ros layout`: what it draws is there, and the files are as the applications read them.

What a series is called in PlotJuggler and what a message path of Foxglove finds is worked out here
anew, from messages as the driver makes them.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
import yaml
from builtin_interfaces.msg import Time
from shipped import CONFIG, PARAMETER_FILES

from epos2_ros.bus.settings import machine_of
from epos2_ros.bus.snapshot import JointStates, OutputSnapshot, Snapshot, axis_snapshots
from epos2_ros.configuration.driver import ClockLimits, DriverConfig
from epos2_ros.configuration.parameter_file import ParameterFile
from epos2_ros.layout.program import main, read
from epos2_ros.node import messages
from epos2_ros.protocol.outputs.outputs import OutputEvent, Tally


class Given:
    """A parameter file, where its driver's topics are, and a message on each."""

    def __init__(self, file: Path, namespace: str, arguments: list[str]) -> None:
        config: DriverConfig = read(file, None)[0]
        self.arguments = ["--params", str(file), *arguments]
        node = f"{namespace}/epos2_driver"
        channel = f"{namespace}/{config.channel}".lstrip("/")
        machine = machine_of(config)
        follows = {a.joint: 0 if a.drive == "epos2" else None for a in config.axes}  # 0x20F4
        axes = tuple(
            replace(axis, following_error_qc=follows[axis.joint], silent_s=0.0)
            for axis in axis_snapshots(machine, 0.0, False, {})
        )
        node_ids = {axis.joint: axis.node_id for axis in config.axes}
        outputs = [
            OutputSnapshot(o.name, o.joint, node_ids[o.joint], Tally()) for o in config.outputs
        ]
        snapshot = Snapshot(axes, "standing", "", 0.0, 0, "", 0, 0, 0, outputs=tuple(outputs))
        zeros = [0.0] * len(axes)
        states = JointStates(0.0, [axis.joint for axis in axes], zeros, zeros, zeros)
        limits, told = ClockLimits(), node.lstrip("/")
        self.diagnostics = messages.diagnostics(snapshot, told, channel, Time(), limits)
        buffers = messages.buffer_status(snapshot, channel, Time())
        self.arrays = {"/diagnostics": self.diagnostics, f"{node}/buffer_status": buffers}
        self.states = {f"{namespace}/joint_states": messages.joint_state(states, Time())}
        for o in config.outputs:
            fired = messages.output_event(OutputEvent(o.name, o.joint, 0.0, 0.0, 0.0), Time())
            self.states[f"{node}/compare/{o.name}"] = fired


CASES = [*((file, "") for file in PARAMETER_FILES), (CONFIG / "outputs.yaml", "/robot1")]


@pytest.fixture(params=CASES, ids=lambda case: f"{case[1][1:]}{case[0].stem}")
def given(request: pytest.FixtureRequest) -> Given:
    file, namespace = request.param
    arguments = ["--node", f"{namespace}/epos2_driver"] if namespace else []
    return Given(file, namespace, arguments)


def written(given: Given, kind: str, capsys: pytest.CaptureFixture[str]) -> str:
    assert main([kind, *given.arguments]) == 0
    return capsys.readouterr().out


# -- PlotJuggler -------------------------------------------------------------------------------


def series_of(given: Given) -> Iterator[str]:
    """Those that PlotJuggler makes of the messages, as far as they are numbers."""
    for topic, state in given.states.items():
        for name in state.name:
            yield from (f"{topic}/{name}/{field}" for field in ("position", "velocity", "effort"))
    for topic, array in given.arrays.items():
        for status in array.status:
            for pair in status.values:
                try:
                    float(pair.value)
                except ValueError:
                    continue
                yield f"{topic}/{status.hardware_id}/{status.name}/{pair.key}"


def test_plotjuggler_finds_every_curve(given: Given, capsys: pytest.CaptureFixture[str]) -> None:
    root = ElementTree.fromstring(written(given, "plotjuggler", capsys))
    curves = [curve.attrib["name"] for curve in root.iter("curve")]
    assert set(curves) <= set(series_of(given))
    for state in given.states.values():
        assert all(any(f"/{joint}/position" in curve for curve in curves) for joint in state.name)
    streamed = {topic.attrib["name"] for topic in root.iterfind(".//selected_topics/topic")}
    assert streamed == given.states.keys() | given.arrays.keys()


def test_plotjuggler_reads_the_file(given: Given, capsys: pytest.CaptureFixture[str]) -> None:
    """Elements and attributes are those that its xmlLoadState functions ask for."""
    root = ElementTree.fromstring(written(given, "plotjuggler", capsys))
    assert (root.tag, root.attrib["version"]) == ("root", "2.3.8")
    (widget,) = root.findall("tabbed_widget")
    assert widget.attrib["parent"] == "main_window"
    tabs = widget.findall("Tab")
    assert 0 <= int(widget.find("currentTabIndex").attrib["index"]) < len(tabs)
    for tab in tabs:
        assert tab.attrib["tab_name"]
        (container,) = tab
        (splitter,) = container
        assert (container.tag, splitter.tag) == ("Container", "DockSplitter")
        assert splitter.attrib["orientation"] in "|-"
        count = int(splitter.attrib["count"])
        sizes = [float(size) for size in splitter.attrib["sizes"].split(";")]
        assert len(sizes) == count == len(splitter) >= 1
        assert sum(sizes) == pytest.approx(1, abs=1e-5)
        for area in splitter:
            (plot,) = area
            assert (area.tag, plot.tag, plot.attrib["mode"]) == ("DockArea", "plot", "TimeSeries")
            assert plot.attrib["style"] in ("Lines", "Dots")
            colours = [curve.attrib["color"] for curve in plot.findall("curve")]
            assert colours and all(re.fullmatch("#[0-9a-f]{6}", colour) for colour in colours)
    (plugin,) = root.find("Plugins")
    assert plugin.tag == "plugin"
    assert plugin.attrib["ID"] == root.find("previouslyLoaded_Streamer").attrib["name"]


# -- Foxglove ----------------------------------------------------------------------------------

PATH = re.compile(
    r"(?P<topic>(?:/[A-Za-z0-9_]*)+)(?:\.(?P<field>\w+)\[(?P<place>\d+)\]"
    r'|\.status\[:\]\{name=="(?P<name>[^"]*)"\}\.values\[:\]\{key=="(?P<key>[^"]*)"\}\.value)'
)


def found(given: Given, path: str) -> Any:
    """What a message path leads to: exactly one value."""
    match = PATH.fullmatch(path)
    assert match, path
    topic = match["topic"]
    if match["field"]:
        return getattr(given.states[topic], match["field"])[int(match["place"])]
    (status,) = (s for s in given.arrays[topic].status if s.name == match["name"])
    (pair,) = (p for p in status.values if p.key == match["key"])
    return pair.value


def leaves(node: Any) -> Iterator[str]:
    if isinstance(node, str):
        yield node
        return
    assert node["direction"] in ("row", "column")
    assert 0 < node["splitPercentage"] < 100
    yield from leaves(node["first"])
    yield from leaves(node["second"])


def test_foxglove_finds_every_value_and_every_panel(
    given: Given, capsys: pytest.CaptureFixture[str]
) -> None:
    data = json.loads(written(given, "foxglove", capsys))
    panels = data["configById"]
    shown = list(leaves(data["layout"]))
    for panel in list(shown):
        if panel.startswith("Tab!"):
            assert 0 <= panels[panel]["activeTabIdx"] < len(panels[panel]["tabs"])
            for tab in panels[panel]["tabs"]:
                assert tab["title"]
                shown += leaves(tab["layout"])
    assert sorted(shown) == sorted(panels)
    for panel, config in panels.items():
        assert panel.partition("!")[0] in ("Plot", "Tab", "DiagnosticSummary")
        for path in config.get("paths", []):
            float(found(given, path["value"]))
            assert path["timestampMethod"] == "headerStamp" and path["enabled"] is True


# -- diagnostic_aggregator ---------------------------------------------------------------------


def test_every_status_is_expected_once(given: Given, capsys: pytest.CaptureFixture[str]) -> None:
    text = written(given, "diagnostics", capsys)
    assert ParameterFile.parse(text, "it").reaches("/analyzers")  # ROS reads it
    (analyzers,) = yaml.safe_load(text).items()
    assert analyzers[0] == "analyzers"  # the name of the aggregator's node
    groups = [g for g in analyzers[1]["ros__parameters"].values() if isinstance(g, dict)]
    assert {group["type"] for group in groups} == {"diagnostic_aggregator/GenericAnalyzer"}
    expected = [name for group in groups for name in group["expected"]]
    assert sorted(expected) == sorted(status.name for status in given.diagnostics.status)
    for group in groups:
        assert group["remove_prefix"][0] == expected[0].partition(": ")[0] + ": "


def test_the_shipped_file_is_for_the_drivers_own_joints(
    capsys: pytest.CaptureFixture[str],
) -> None:
    shipped = yaml.safe_load((CONFIG / "diagnostics.yaml").read_text())
    axes = shipped["analyzers"]["ros__parameters"]["axes"]
    assert axes["expected"] == [f"epos2_driver: joint_{n}" for n in range(1, 7)]
    assert main(["diagnostics"]) == 0
    assert yaml.safe_load(capsys.readouterr().out) == shipped


# -- the command -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "options", "says"),
    [
        (None, [], "can't read "),
        ("/arm: {ros__parameters: {joints: [a]}}", [], "is for /epos2_driver: it has parameters"),
        ("/**: {ros__parameters: {axes: {a: {gear_ratio: 1.0}}}}", [], "axes.a.gear_ratio"),
        (
            "/**: {ros__parameters: {joints: [a]}}",
            ["--output", "/nonexistent/a"],
            "can't write /no",
        ),
    ],
)
def test_what_can_not_be_is_one_line(
    text: str | None,
    options: list[str],
    says: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    file = tmp_path / "my.yaml"
    if text is not None:
        file.write_text(text)
    assert main(["plotjuggler", "--params", str(file), *options]) == 1
    streams = capsys.readouterr()
    assert streams.out == ""
    assert streams.err.startswith("epos2_ros layout: ") and says in streams.err
    assert streams.err.count("\n") == 1


def test_a_file_for_a_node_in_a_namespace_says_which(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, output = tmp_path / "my.yaml", tmp_path / "layout.json"
    file.write_text("/robot1/epos2_driver: {ros__parameters: {joints: [a]}}")
    assert main(["foxglove", "--params", str(file), "--output", str(output)]) == 0
    assert "/robot1/joint_states.position[0]" in output.read_text()
    assert capsys.readouterr().out == ""
