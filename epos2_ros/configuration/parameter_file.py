"""A ROS parameter file, read as rcl reads it: which node gets what, and of which type.

The driver gets its parameters from rcl, which reads YAML by rules of its own: a bare `y` is a
boolean, a list holds values of one type, `010` is eight. `plan` and `demo` do without rcl, and the
driver says beforehand what is wrong with a file; both read it here, so that they agree.

Source: rcl_yaml_param_parser 9.2 (ROS 2 Jazzy), its README and what it makes of such files. Lists
in lists, maps in lists and empty maps, of which it makes something else, are refused; hexadecimal
fractions are text here.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import yaml

from epos2_ros.errors import ConfigurationError

ANY_NODE = "/**"
_PARAMETERS = "ros__parameters"
_TRUE = frozenset(["y", "Y", "yes", "Yes", "YES", "true", "True", "TRUE", "on", "On", "ON"])
_FALSE = frozenset(["n", "N", "no", "No", "NO", "false", "False", "FALSE", "off", "Off", "OFF"])
_INTEGER = re.compile(r"[+-]?(0[xX][0-9a-fA-F]+|0[0-7]*|[1-9][0-9]*)")
_DECIMAL = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_SPECIAL = re.compile(r"[+-]?(\.inf|\.Inf|\.INF|(?i:inf(inity)?|nan))|\.nan|\.NaN|\.NAN")
_QUOTED = ("'", '"')
_PLAIN = (None, "")  # the style of what is neither quoted nor a block
_STRING_TAG = "tag:yaml.org,2002:str"
_LONGEST_INTEGER = 100  # characters, zeros in front included; Python reads no more than 4300
_SMALLEST_NORMAL = 2.0**-1022
_TYPE_NAMES = {bool: "true or false", int: "a whole number", float: "a number", str: "text"}
# The C parser where PyYAML has it (libyaml); the other does the same, slower.
_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


@dataclass(frozen=True)
class ParameterFile:
    """The parameters in a file, by dotted name, for the nodes whose full names match a pattern."""

    source: str
    sections: dict[str, dict[str, Any]]  # by pattern (`*` one part of a name, `**` any), in order

    @classmethod
    def read(cls, file: Path) -> ParameterFile:
        """ConfigurationError in one line where there is no such file, or rcl would refuse it."""
        try:
            text = file.read_text(encoding="utf-8-sig")
        except OSError as error:
            raise ConfigurationError(f"can't read {file}: {error.strerror}") from error
        except UnicodeError as error:
            raise ConfigurationError(f"can't read {file}: it is not UTF-8 text") from error
        return cls.parse(text, str(file))

    @classmethod
    def parse(cls, text: str, source: str) -> ParameterFile:
        """The same from the file's text."""
        try:
            return cls(source, _Reader(text, source).sections)
        except yaml.YAMLError as error:
            raise ConfigurationError(f"can't read {source}: {' '.join(str(error).split())}") from (
                error
            )
        except RecursionError as error:
            raise ConfigurationError(f"can't read {source}: it is nested too deep") from error

    def reaches(self, node: str) -> bool:
        """Whether something in it is for the node of this full name."""
        return any(_matches(name, node) and given for name, given in self.sections.items())

    def of(self, node: str) -> dict[str, Any]:
        """What reaches the node of this full name; later sections win, as with rcl.

        ConfigurationError, which says for which nodes it has parameters, where that is nothing.
        """
        matching = [name for name in self.sections if _matches(name, node)]
        given = {name: value for key in matching for name, value in self.sections[key].items()}
        if not given:
            self._nothing_for(node)
        return given

    def node(self, name: str) -> str:
        """The full name of the one node `name` that it has parameters of, in any namespace.

        Without such a section it is that node in the root namespace.
        """
        nodes = [key for key in self.sections if "*" not in key and key.endswith(f"/{name}")]
        if len(nodes) > 1 and f"/{name}" not in nodes:
            raise ConfigurationError(
                f"{self.source} has parameters of {', '.join(nodes)}, and not of /{name}: say "
                "which (plan: --node)"
            )
        return nodes[0] if len(nodes) == 1 else f"/{name}"

    def _nothing_for(self, node: str) -> NoReturn:
        others = [name for name, parameters in self.sections.items() if parameters]
        if not others:
            raise ConfigurationError(f"{self.source} has no parameters")
        raise ConfigurationError(
            f"nothing in {self.source} is for {node}: it has parameters of "
            f"{', '.join(others)}; name the node there, or write {ANY_NODE} for any node"
        )


def _matches(pattern: str, node: str) -> bool:
    """As rcl: `*` stands for one part of the name, `**` for any number of them, none included."""
    wild = {"**": "(/[^/]+)*", "*": "/[^/]+"}
    parts = (wild.get(part, f"/{re.escape(part)}") for part in pattern.strip("/").split("/"))
    return re.fullmatch("".join(parts), node) is not None


class _Reader:
    """Goes through the events of the YAML parser, which still know what was quoted."""

    def __init__(self, text: str, source: str) -> None:
        self.sections: dict[str, dict[str, Any]] = {}
        self._source = source
        self._events: Iterator[Any] = yaml.parse(text, _LOADER)
        for event in self._events:
            if isinstance(event, yaml.MappingStartEvent):
                self._nodes("")
            elif isinstance(event, yaml.ScalarEvent) and event.value:
                self._refuse(event, "it is not a ROS parameter file")
            elif isinstance(event, yaml.SequenceStartEvent):
                self._refuse(event, "a list where a node's name has to be")

    def _nodes(self, name: str) -> None:
        """A map of namespaces and node names, until `ros__parameters`."""
        for key in self._keys():
            event = next(self._events)
            if not isinstance(event, yaml.MappingStartEvent):
                where = f"below {name}" if name else "at the top"
                allowed = f"only nodes and {_PARAMETERS} can be"
                self._refuse(event, f"{key} has a value {where}, where {allowed}")
            if key == _PARAMETERS and name:
                self._parameters("", self.sections.setdefault(name, {}))
            else:
                self._nodes(f"{name}/{key.strip('/')}")

    def _parameters(self, prefix: str, into: dict[str, Any]) -> None:
        empty = True
        for key in self._keys():
            empty = False
            name, event = prefix + key, next(self._events)
            if isinstance(event, yaml.MappingStartEvent):
                self._parameters(f"{name}.", into)
            elif isinstance(event, yaml.SequenceStartEvent):
                into[name] = self._list(name)
            elif isinstance(event, yaml.ScalarEvent):
                if not event.value and event.style in _PLAIN:
                    self._refuse(event, f"{name} has no value")
                into[name] = _value(event)
            else:
                self._refuse(event, f"{name} is an alias, which ROS does not take")
        if empty and prefix:
            raise ConfigurationError(f"{self._source}: {prefix[:-1]} is empty; leave it out")

    def _list(self, name: str) -> list[Any]:
        values: list[Any] = []
        for event in self._events:
            if isinstance(event, yaml.SequenceEndEvent):
                break
            if not isinstance(event, yaml.ScalarEvent):
                self._refuse(event, f"{name} is a list, and holds more than plain values")
            value = _value(event)
            if values and type(value) is not type(values[0]):
                self._refuse(event, _mixed(name, values[0], value, event.value))
            values.append(value)
        return values

    def _keys(self) -> Iterator[str]:
        """Each key of the map that has begun; what it stands for is read before the next."""
        for event in self._events:
            if isinstance(event, yaml.MappingEndEvent):
                return
            if not isinstance(event, yaml.ScalarEvent):
                self._refuse(event, "a name has to be plain text")
            yield event.value

    def _refuse(self, event: Any, problem: str) -> NoReturn:
        raise ConfigurationError(f"{self._source}, line {event.start_mark.line + 1}: {problem}")


def _mixed(name: str, first: Any, value: Any, written: str) -> str:
    kinds = {type(first), type(value)}
    line = (
        f"{name} holds {written}, {_TYPE_NAMES[type(value)]}, after "
        f"{_TYPE_NAMES[type(first)]}; a list has values of one type"
    )
    if kinds == {int, float}:
        return f"{line}: write whole numbers with .0"
    if kinds == {bool, str}:
        return f"{line}: a bare y, n, on or off is a boolean, put it in quotes"
    return line


def _value(event: Any) -> Any:
    """What rcl makes of a scalar."""
    text: str = event.value
    if event.style in _QUOTED or event.tag == _STRING_TAG:
        return text
    if text in _TRUE:
        return True
    if text in _FALSE:
        return False
    short = len(text) <= _LONGEST_INTEGER
    if short and _INTEGER.fullmatch(text) and -(2**63) <= (whole := _whole(text)) < 2**63:
        return whole
    if _DECIMAL.fullmatch(text) or _SPECIAL.fullmatch(text):
        number = _number(text)
        return text if number is None else number
    return text


def _whole(text: str) -> int:
    digits = text.lstrip("+-")
    octal = len(digits) > 1 and digits[0] == "0" and digits[1] not in "xX"
    return int(text, 8 if octal else 0)


def _number(text: str) -> float | None:
    """None for what is too large or too small for a float, and text to rcl."""
    if _SPECIAL.fullmatch(text):
        return float(text.replace(".", ""))
    number = float(text)
    zero = not re.search("[1-9]", re.split("[eE]", text)[0])
    return number if zero or _SMALLEST_NORMAL <= abs(number) < math.inf else None
