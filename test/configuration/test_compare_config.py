"""Position-triggered outputs as they are configured: what is refused, and with which line."""

from __future__ import annotations

import math
from typing import Any

import pytest

from epos2_ros.configuration.outputs import CompareConfig
from epos2_ros.errors import ConfigurationError
from epos2_ros.motion.units import AxisUnits
from epos2_ros.protocol.outputs import copley as copley_compare
from epos2_ros.protocol.outputs import epos2 as epos2_compare
from epos2_ros.protocol.outputs.output import check_pins

UNITS = AxisUnits("x", "m", 2000, 2_000_000.0)  # 0.5 µm a count


def output(kind: str, **parameters: Any) -> CompareConfig:
    return CompareConfig("camera", "x", kind, **parameters)


REFUSED = {
    "no kind": (
        {"kind": "edge"},
        "compare.camera.kind is edge; it must be one of window, crossing, series, interval, marker",
    ),
    "window upside down": (
        {"kind": "window", "window": (0.2, 0.1)},
        "compare.camera.window is [0.2, 0.1]; the lower end comes first: [lower, upper]",
    ),
    "window without ends": (
        {"kind": "window"},
        "compare.camera.window is not set; a window needs [lower, upper]",
    ),
    "toggle in a window": (
        {"kind": "window", "window": (0.1, 0.2), "toggle": True},
        "compare.camera.toggle is true; in a window the output is active, there is no toggling",
    ),
    "unsorted series": (
        {"kind": "series", "positions": (0.1, 0.3, 0.2)},
        "compare.camera.positions is 0.3 followed by 0.2; "
        "they must be sorted, lowest first, each once",
    ),
    "empty series": (
        {"kind": "series"},
        "compare.camera.positions is []; a series needs positions, all finite",
    ),
    "not a number": (
        {"kind": "series", "positions": (0.1, math.nan)},
        "compare.camera.positions is [0.1, nan]; a series needs positions, all finite",
    ),
    "three crossings": (
        {"kind": "crossing", "positions": (0.1, 0.2, 0.3)},
        "compare.camera.positions is [0.1, 0.2, 0.3]; "
        "a crossing has one position or two; take kind series for more",
    ),
    "interval without start": (
        {"kind": "interval", "interval": 0.001},
        "compare.camera.start is not set; an interval needs the position of a first pulse",
    ),
    "interval of nothing": (
        {"kind": "interval", "start": 0.0, "interval": 0.0},
        "compare.camera.interval is 0; it must be above 0; start, end and direction say where",
    ),
    "against its own direction": (
        {"kind": "interval", "start": 0.0, "interval": 0.001, "end": 0.1, "direction": "down"},
        "compare.camera.direction is down; from start 0 to end 0.1 it is up",
    ),
    "no pulse": (
        {"kind": "crossing", "positions": (0.1,), "pulse": 0.0},
        "compare.camera.pulse is 0; it must be above 0 s",
    ),
    "pin 0": (
        {"kind": "crossing", "positions": (0.1,), "pin": 0},
        "compare.camera.pin is 0; outputs are counted from 1",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_no_drive_could_do_is_refused_with_one_line(case: str) -> None:
    parameters, line = REFUSED[case]
    with pytest.raises(ConfigurationError) as refused:
        output(**parameters)
    assert str(refused.value) == line


REFUSED_BY_COPLEY = {
    "pulse longer than 20 bits of 10 ns": (
        {"kind": "crossing", "positions": (0.1,), "pulse": 0.0105},
        "compare.camera.pulse is 0.0105; the compare hardware makes pulses of 1e-08 to 0.01048575 s"
        " (20 bits of 10 ns); method software goes to hours, in whole milliseconds",
    ),
    "software pulse of half a millisecond": (
        {"kind": "crossing", "positions": (0.1,), "method": "software", "pulse": 0.0015},
        "compare.camera.pulse is 0.0015; "
        "software pulses last whole milliseconds, 0.001 to 4294967.295 s",
    ),
    "series pulse longer than 16 bits of ms": (
        {"kind": "series", "positions": (0.1, 0.2), "pulse": 66.0},
        "compare.camera.pulse is 66; software pulses last whole milliseconds, 0.001 to 65.535 s",
    ),
    "too many positions for the trace memory": (
        {"kind": "series", "positions": tuple(n * 1e-6 for n in range(32768))},
        "compare.camera.positions is a list of 32768; "
        "the drive's trace memory has room for 32767 positions here",
    ),
    "positions on one count": (
        {"kind": "series", "positions": (0.1, 0.1000001)},
        "compare.camera.positions is 0.1 followed by 0.1000001; "
        "they must be 5e-07 m (one count) or more apart",
    ),
    "beyond int32": (
        {"kind": "crossing", "positions": (1074.0,)},
        "compare.camera.positions is 1074; the drive counts from -1073.74 to 1073.74 m",
    ),
    "interval below a count": (
        {"kind": "interval", "start": 0.0, "interval": 2e-7},
        "compare.camera.interval is 2e-07; it must be 5e-07 m (one count) or more",
    ),
    "one direction in hardware": (
        {"kind": "crossing", "positions": (0.1,), "direction": "up", "method": "hardware"},
        "compare.camera.direction is up; "
        "the compare hardware pulses both ways there; method software can",
    ),
    "series in hardware": (
        {"kind": "series", "positions": (0.1, 0.2), "method": "hardware"},
        "compare.camera.kind is series; the compare hardware does window, crossing and interval",
    ),
    "interval in software": (
        {"kind": "interval", "start": 0.0, "interval": 0.001, "method": "software"},
        "compare.camera.kind is interval; software outputs do window, crossing and series",
    ),
    "toggle in software": (
        {"kind": "crossing", "positions": (0.1,), "toggle": True, "method": "software"},
        "compare.camera.toggle is true; software outputs pulse; method hardware can toggle",
    ),
    "commanded position in hardware": (
        {"kind": "crossing", "positions": (0.1,), "reference": "commanded", "method": "hardware"},
        "compare.camera.reference is commanded; "
        "the compare hardware sees the encoder; method software can follow it",
    ),
    "marker": (
        {"kind": "marker"},
        "compare.camera.kind is marker; a Copley drive has window, crossing, series and interval",
    ),
}


@pytest.mark.parametrize("case", REFUSED_BY_COPLEY)
def test_what_a_copley_drive_cannot_do_is_refused_with_what_it_can(case: str) -> None:
    parameters, line = REFUSED_BY_COPLEY[case]
    with pytest.raises(ConfigurationError) as refused:
        copley_compare.make_outputs([output(**parameters)], UNITS)
    assert str(refused.value) == line


REFUSED_BY_EPOS2 = {
    "software": (
        {"kind": "crossing", "positions": (0.1,), "method": "software"},
        "compare.camera.method is software; the EPOS2 compares in hardware only",
    ),
    "window": (
        {"kind": "window", "window": (0.1, 0.2)},
        "compare.camera.kind is window; the EPOS2 has crossing, interval and marker",
    ),
    "two positions": (
        {"kind": "crossing", "positions": (0.1, 0.2)},
        "compare.camera.positions is [0.1, 0.2]; "
        "the EPOS2 compares with one position, or with an interval of them",
    ),
    "pin": (
        {"kind": "crossing", "positions": (0.1,), "pin": 6},
        "compare.camera.pin is 6; the EPOS2 has outputs 1 to 5",
    ),
    "pulse": (
        {"kind": "crossing", "positions": (0.1,), "pulse": 0.07},
        "compare.camera.pulse is 0.07; the EPOS2's pulses last 1e-06 to 0.065535 s",
    ),
    "too many repetitions": (
        {"kind": "interval", "start": 0.0, "interval": 1e-6, "end": 0.1},
        "compare.camera.end is 0.1; the EPOS2 compares with up to 65535 positions, here 100001",
    ),
}


@pytest.mark.parametrize("case", REFUSED_BY_EPOS2)
def test_what_an_epos2_cannot_do_is_refused_with_what_it_can(case: str) -> None:
    parameters, line = REFUSED_BY_EPOS2[case]
    with pytest.raises(ConfigurationError) as refused:
        epos2_compare.make_outputs([output(**parameters)], UNITS)
    assert str(refused.value) == line


def test_an_output_used_twice_is_refused() -> None:
    first = CompareConfig("laser", "x", "crossing", pin=2, positions=(0.1,))
    second = CompareConfig("camera", "x", "window", pin=2, window=(0.1, 0.2))
    with pytest.raises(ConfigurationError) as refused:
        check_pins([first, second])
    assert str(refused.value) == (
        "compare.camera.pin is 2; compare.laser uses output 2 of the drive of x; "
        "each output can do one thing"
    )
    check_pins([first, CompareConfig("camera", "y", "window", pin=2, window=(0.1, 0.2))])


def test_the_one_compare_module_of_an_axis_is_not_shared() -> None:
    configs = [
        CompareConfig("laser", "x", "interval", pin=1, start=0.0, interval=0.001),
        CompareConfig("camera", "x", "window", pin=2, window=(0.1, 0.2)),
    ]
    with pytest.raises(ConfigurationError) as refused:
        copley_compare.make_outputs(configs, UNITS)
    assert str(refused.value) == (
        "compare.camera.method is hardware; the one compare module of x serves compare.laser; "
        "method software needs none"
    )


def test_a_longer_list_than_memory_is_reserved_for_is_refused() -> None:
    config = output("series", positions=(0.1, 0.2), capacity=3)
    series = copley_compare.SoftwareOutput(config, UNITS)
    assert series.with_positions((0.1, 0.2, 0.3)).config.positions == (0.1, 0.2, 0.3)
    with pytest.raises(ConfigurationError) as refused:
        series.with_positions((0.1, 0.2, 0.3, 0.4))
    assert str(refused.value) == (
        "compare.camera.positions is a list of 4; "
        "memory is reserved for 3; set compare.camera.capacity to more"
    )
