"""Sentences for bad input: what is wrong, the value got, what to write instead."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches

import numpy as np
from numpy.typing import ArrayLike, NDArray


def finite(name: str, value: ArrayLike, hint: str) -> NDArray[np.float64]:
    """`value` as a float array, refused where it is text, NaN or infinite."""
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        raise ValueError(f"{name} must be a number, got {value!r}; {hint}.") from None
    if not np.all(np.isfinite(array)):
        raise ValueError(
            f"{name} must be finite, got {_first(array, ~np.isfinite(array))}; {hint}."
        )
    return array


def positive(name: str, value: ArrayLike, hint: str) -> NDArray[np.float64]:
    """`value` as a float array of finite numbers above zero."""
    array = finite(name, value, hint)
    if not np.all(array > 0):
        raise ValueError(f"{name} must be above zero, got {_first(array, ~(array > 0))}; {hint}.")
    return array


def non_negative(name: str, value: ArrayLike, hint: str) -> NDArray[np.float64]:
    """`value` as a float array of finite numbers of zero or more."""
    array = finite(name, value, hint)
    if not np.all(array >= 0):
        raise ValueError(f"{name} must not be negative, got {_first(array, array < 0)}; {hint}.")
    return array


def one_of(name: str, value: object, choices: Iterable[str]) -> str:
    """`value` if it is one of `choices`, else a refusal that names the nearest."""
    known = list(choices)
    if isinstance(value, str) and value in known:
        return value
    near = get_close_matches(str(value), known, n=1)
    meant = f" (did you mean {near[0]!r}?)" if near else ""
    raise ValueError(f"{name} {value!r} is unknown{meant}; choose one of {', '.join(known)}.")


def _first(array: NDArray[np.float64], bad: NDArray[np.bool_]) -> str:
    return f"{array[bad].flat[0] if array.ndim else array[()]:g}"
