"""The numbers in an object and its parts as JSON can hold them, and back into another of its kind.

A part is an object of the protocol layer that an attribute holds, alone or in a list. Whatever else
there is (functions, futures, curves) is left as it is: so this is for machines at rest, whose
future is in their numbers.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from typing import Any

import numpy as np

PACKAGE = "epos2_ros.protocol"
Plain = Any  # what JSON can hold; containers other than lists are {"their name": contents}


class _NotPlain(TypeError):
    """A value that is more than numbers."""


def numbers_in(thing: object) -> dict[str, dict[str, Plain]]:
    """By the way to each part, its attributes that are numbers, texts, or containers of them."""
    found: dict[str, dict[str, Plain]] = {}
    for way, part in _parts(thing):
        numbers = found[way] = {}
        for name, value in vars(part).items():
            try:
                numbers[name] = _plain(value)
            except _NotPlain:
                continue
    return found


def put_numbers(thing: object, found: dict[str, dict[str, Plain]]) -> None:
    """Give `thing` what `numbers_in` found in another; containers stay, their contents change.

    Parts and attributes that `thing` has not are left out. Raises TypeError, ValueError or KeyError
    for what `numbers_in` has not made.
    """
    for way, part in list(_parts(thing)):
        for name, plain in found.get(way, {}).items():
            if name in vars(part):
                _put(part, name, _value(plain))


def _put(part: object, name: str, value: Any) -> None:
    own = getattr(part, name)
    if isinstance(own, (deque, list)) and isinstance(value, (deque, list)):
        own.clear()
        own.extend(value)
    elif isinstance(own, (dict, set)) and type(own) is type(value):
        own.clear()
        own.update(value)
    else:
        setattr(part, name, value)


def _parts(thing: object) -> Iterator[tuple[str, object]]:
    """The way to each, the shortest; `thing` itself comes first."""
    seen = {id(thing)}
    waiting = deque([("", thing)])
    while waiting:
        way, part = waiting.popleft()
        yield way, part
        for name, value in vars(part).items():
            several = isinstance(value, (list, tuple))
            for place, inner in enumerate(value if several else [value]):
                if _is_part(inner) and id(inner) not in seen:
                    seen.add(id(inner))
                    waiting.append((f"{way}.{name}{place if several else ''}", inner))


def _is_part(value: object) -> bool:
    kind = type(value)
    parameters = getattr(kind, "__dataclass_params__", None)
    changes = parameters is None or not parameters.frozen
    return kind.__module__.startswith(PACKAGE) and changes and hasattr(value, "__dict__")


def _plain(value: Any) -> Plain:
    if value is None or type(value) in (bool, int, float, str):
        return value
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        return {"array": value.tolist()}
    if type(value) is dict:
        return {"dict": [[_plain(key), _plain(item)] for key, item in value.items()]}
    if type(value) is list:
        return [_plain(item) for item in value]
    for kind in (tuple, deque, set):
        if type(value) is kind:
            return {kind.__name__: [_plain(item) for item in value]}
    raise _NotPlain


def _value(plain: Plain) -> Any:
    if isinstance(plain, list):
        return [_value(item) for item in plain]
    if not isinstance(plain, dict):
        return plain
    ((kind, contents),) = plain.items()
    if kind == "array":
        return np.array(contents)
    if kind == "dict":
        return {_value(key): _value(item) for key, item in contents}
    containers: dict[str, Any] = {"tuple": tuple, "deque": deque, "set": set}
    return containers[kind](_value(item) for item in contents)
