"""Parameter files: ours says of each what rcl says, and where rcl refuses, in one clear line."""

from __future__ import annotations

import itertools
import re
from typing import Any

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from rcl_parameters import Rcl
from rcl_parameters import rcl as rcl  # a fixture

from epos2_ros.configuration.parameter_file import ParameterFile
from epos2_ros.errors import ConfigurationError


def ours(text: str, node: str = "/epos2_driver") -> dict[str, Any] | None:
    """The same by our reader; rcl has an empty list for "not set"."""
    try:
        file = ParameterFile.parse(text, "file")
    except ConfigurationError as error:
        assert "\n" not in str(error)
        return None
    try:
        given = file.of(node)
    except ConfigurationError:
        return {}
    return {name: None if value == [] else value for name, value in given.items()}


def same(one: Any, other: Any) -> bool:
    """Equal values of equal types; a NaN is one."""
    return repr(one) == repr(other)


def of_any_node(*values: str) -> str:
    lines = [f"    p{number}: {value}\n" for number, value in enumerate(values)]
    return "".join(["/**:\n  ros__parameters:\n", *lines])


SCALARS = re.split(r"\s+", """
y n Y N yes no on off On OFF true FALSE tRUE ~ null 0 1 -1 +1 01 010 08 0x10 0o7
1_000 1. 1.0 .5 -.5 1e3 1e-3 1.e3 1E5 1.5e --1 0x inf -inf .inf +.inf -.nan nan .NaN Infinity
1e400 1e-400 0e-400 99999999999999999999 9223372036854775808 -9223372036854775808
12:30:00 2001-01-01 1,5 = << é can0 joint_1 a.b /dev/ttyACM0 '' '1' "y" 'true'
[] [1,2] [1.0,inf] [y,n] [a,'y'] ['',b] [~,a] [1,] [0x10]
""".strip()) + [
    *["abc def", "!!str 1", "!!str y", "!!int '5'", "!!float 1", "&x 1", "1 # a comment"],
    *["|-\n      5", ">\n      a\n      b", "'a\n      b'"],
]


def test_every_scalar_has_the_value_and_type_that_rcl_gives_it(rcl: Rcl) -> None:
    text = of_any_node(*SCALARS)
    assert same(ours(text), rcl(text))


@settings(
    max_examples=300,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(st.lists(st.text("0123456789+-.eEyYnNaAiIfFxX", min_size=1, max_size=8), min_size=8))
@example(["+", "."])
def test_so_has_whatever_may_be_a_number(rcl: Rcl, scalars: list[str]) -> None:
    hexadecimal_fraction = re.compile(r"[+-]?0[xX][0-9a-fA-F.]*([.][0-9a-fA-F]*|[pP].*)")
    text = of_any_node(*(s for s in scalars if not hexadecimal_fraction.fullmatch(s)))
    assert same(ours(text), rcl(text)), text


@pytest.mark.parametrize(
    "text",
    [
        "/**:\n  ros__parameters:\n    a.b: 1\n    a: {b: 2, c: {d: [x]}}\n",
        "/**:\n  ros__parameters: {a: 1}\n/**:\n  ros__parameters: {a: 2, b: 1}\n",
        "---\n/**:\n  ros__parameters: {a: 1}\n---\n/**:\n  ros__parameters: {b: 1}\n",
        "robot:\n  epos2_driver:\n    ros__parameters: {a: 1}\n/**: {ros__parameters: {b: 1}}\n",
        "/**:\n  ros__parameters:\n    y: 1\n    1: {y: 3}\n    .a: 1\n",
        "'/**':\r\n  ros__parameters:\r\n    a: x\r\n",
        "\ufeff/**: {ros__parameters: {a: x}}\n",
        "/**:\n  ros__parameters: {}\n",
    ],
)
def test_so_has_every_layout(rcl: Rcl, text: str) -> None:
    assert same(ours(text), rcl(text))


NAMES = ["/**", "/*", "**", "/**/epos2_driver", "/*/epos2_driver", "epos2_driver", "/epos2_driver"]
NAMES += ["/robot/epos2_driver", "robot/*", "/robot/**", "/arm", "/**/robot/epos2_driver"]


@pytest.mark.parametrize("node", ["/epos2_driver", "/robot/epos2_driver", "/a/b/epos2_driver"])
def test_a_section_reaches_the_nodes_that_rcl_gives_it_to(rcl: Rcl, node: str) -> None:
    for names in itertools.chain(((name,) for name in NAMES), itertools.permutations(NAMES, 2)):
        text = "".join(f"'{name}': {{ros__parameters: {{a: '{name}'}}}}\n" for name in names)
        assert ours(text, node) == rcl(text, node), text


REFUSED = {
    "/**:\n  ros__parameters:\n    joints: [x, y]\n": "line 3: joints holds y, true or false, "
    "after text; a list has values of one type: a bare y, n, on or off is a boolean, put it in "
    "quotes",
    "/**:\n  ros__parameters:\n    window: [0, 0.5]\n": "line 3: window holds 0.5, a number, after "
    "a whole number; a list has values of one type: write whole numbers with .0",
    "/**:\n  ros__parameters:\n    a:\n    b: 1\n": "line 3: a has no value",
    "/**:\n  ros__parameters:\n    a: {}\n    b: 1\n": "a is empty; leave it out",
    "/**:\n  ros__parameters:\n    a: &x 1\n    b: *x\n": "line 4: b is an alias",
    "/**:\n  ros_parameters:\n    a: 1\n": "line 3: a has a value below /**/ros_parameters, where "
    "only nodes and ros__parameters can be",
    "/**:\n  ros__parameters: 5\n": "line 2: ros__parameters has a value below /**",
    "/**:\n": "line 1: /** has a value at the top",
    "- a\n": "line 1: a list where a node's name has to be",
    "/**:\n\tros__parameters: {a: 1}\n": "line 2",
    "/**:\n  ros__parameters: {a: 1\n": "line",
    "/**:\n  ros__parameters:\n    a:1\n": "line 3: ros__parameters has a value below /**",
    "/**:\n  ros__parameters:\n    ? [a, b]\n    : 1\n": "line 3: a name has to be plain text",
}


@pytest.mark.parametrize(("text", "says"), REFUSED.items())
def test_what_rcl_refuses_is_refused_in_one_clear_line(rcl: Rcl, text: str, says: str) -> None:
    assert rcl(text) is None
    with pytest.raises(ConfigurationError) as caught:
        ParameterFile.parse(text, "my.yaml")
    line = str(caught.value)
    assert says in line and "my.yaml" in line and "\n" not in line


@pytest.mark.parametrize("text", ["", "# nothing\n", "nothing\n", "/**: {ros__parameters: {}}\n"])
def test_a_file_without_parameters_gives_no_node_any(rcl: Rcl, text: str) -> None:
    assert rcl(text) == {}
    assert not ours(text)


@pytest.mark.parametrize("text", ["", "# nothing\n", "/**: {ros__parameters: {}}\n"])
def test_and_that_is_said(text: str) -> None:
    with pytest.raises(ConfigurationError, match="^my.yaml has no parameters$"):
        ParameterFile.parse(text, "my.yaml").of("/epos2_driver")


@pytest.mark.parametrize(
    ("text", "node"),
    [
        ("/**: {ros__parameters: {a: 1}}", "/epos2_driver"),
        ("/robot1/epos2_driver: {ros__parameters: {a: 1}}", "/robot1/epos2_driver"),
        ("/camera: {ros__parameters: {a: 1}}", "/epos2_driver"),
        ("{/r/epos2_driver: {ros__parameters: {a: 1}}, /c: {ros__parameters: {a: 1}}}",
         "/r/epos2_driver"),
        ("{/r/epos2_driver: {ros__parameters: {a: 1}}, epos2_driver: {ros__parameters: {a: 1}}}",
         "/epos2_driver"),
    ],
)  # fmt: skip
def test_the_driver_that_a_file_is_for(text: str, node: str) -> None:
    assert ParameterFile.parse(text, "file").node("epos2_driver") == node


def test_a_file_for_several_drivers_has_to_be_told_which() -> None:
    file = ParameterFile.parse(
        "{/a/epos2_driver: {ros__parameters: {a: 1}}, /b/epos2_driver: {ros__parameters: {a: 1}}}",
        "both.yaml",
    )
    with pytest.raises(ConfigurationError, match="both.yaml .*/a/epos2_driver, /b/epos2_driver"):
        file.node("epos2_driver")
