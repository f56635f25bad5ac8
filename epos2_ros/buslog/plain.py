"""A configuration as plain lists and mappings, and back.

The fields of the dataclasses name themselves, so a log says what the driver was told without a
table that has to follow every new parameter. A log of another version may lack fields or have
others: defaults stand in for the first, and the second are named.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, fields, is_dataclass
from types import NoneType, UnionType
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

T = TypeVar("T")


def to_plain(value: Any) -> Any:
    """A dataclass, with those in it, as JSON can hold it."""
    return asdict(value)


def from_plain(kind: type[T], plain: Any, unknown: list[str]) -> T:
    """The inverse; names of fields that `kind` has not are added to `unknown`.

    Raises TypeError or ValueError where `plain` is not made like that.
    """
    made: T = _build(kind, plain, unknown)
    return made


def _build(kind: Any, plain: Any, unknown: list[str]) -> Any:
    if isinstance(kind, type) and is_dataclass(kind):
        if not isinstance(plain, Mapping):
            raise TypeError(f"{kind} is {plain!r}, not a mapping")
        types = get_type_hints(kind)
        known = {field.name for field in fields(kind)}
        unknown += sorted(set(plain) - known)
        given = {name: _build(types[name], plain[name], unknown) for name in known & set(plain)}
        return kind(**given)
    if get_origin(kind) in (Union, UnionType):
        options = [option for option in get_args(kind) if option is not NoneType]
        return None if plain is None else _build(options[0], plain, unknown)
    if get_origin(kind) is tuple:
        if not isinstance(plain, (list, tuple)):
            raise TypeError(f"{plain!r} is not a list")
        return tuple(_build(get_args(kind)[0], item, unknown) for item in plain)
    if kind is float and type(plain) is int:
        return float(plain)
    if isinstance(kind, type) and not isinstance(plain, kind):
        raise TypeError(f"{plain!r} is not {kind.__name__}")
    return plain
