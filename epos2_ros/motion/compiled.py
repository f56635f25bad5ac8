"""Scalar code that Numba compiles where it is installed; without Numba it runs as it is, with the
same results.

What Numba keeps compiled is renewed when the file of the function that was called has changed,
whatever else that calls: so what calls each other is in one module.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

try:
    import numba
except ImportError:
    numba = None  # type: ignore[assignment]

COMPILED = numba is not None
Vector = list[float] | NDArray[np.float64]  # an array with Numba; without, lists are faster
_F = TypeVar("_F", bound=Callable[..., Any])


def compiled(function: _F) -> _F:
    """The same, compiled when it is first called."""
    if not COMPILED:
        return function
    result: Any
    try:
        result = numba.njit(cache=True, error_model="numpy", nogil=True)(function)
    except RuntimeError:  # there is no folder to keep it in that can be written
        result = numba.njit(error_model="numpy", nogil=True)(function)
    return result


def inlined(function: _F) -> _F:
    """Compiled into each place it is called from: for what is quicker than to count the references
    to the vectors it is given."""
    if not COMPILED:
        return function
    result: Any = numba.njit(inline="always")(function)
    return result


def vector(values: Iterable[float]) -> Vector:
    """Numbers as the compiled code takes them."""
    return np.asarray(values, dtype=np.float64) if COMPILED else [float(x) for x in values]


if COMPILED:

    @compiled
    def room(size: int) -> Vector:
        """A vector with nothing in it yet."""
        return np.empty(size)

else:

    def room(size: int) -> Vector:
        """A vector with nothing in it yet."""
        return [0.0] * size
