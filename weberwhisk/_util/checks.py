"""Sentences for bad input: what is wrong, the value got, what to write instead."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from typing import Any
from warnings import warn

import numpy as np
from numpy.typing import ArrayLike

from .refusals import Advice, Refusal, argument, named
from .values import Array, Flags

__all__ = [
    "angle", "between", "finite", "generator", "kind", "listed", "mass", "non_negative",
    "non_negative_number", "number", "numbers", "one_of", "one_or_more", "positive",
    "positive_number", "refuse_hinge", "several", "shown", "whole",
]  # fmt: skip


def numbers(name: str, value: ArrayLike, hint: str) -> Array:
    """`value` as a float array, NaN and infinite values included, refused where it is text."""
    try:
        return np.asarray(value, dtype=float)
    except (TypeError, ValueError, OverflowError):
        raise Refusal(_subject(name) + " must be a number", shown(value), hint) from None


def finite(name: str, value: ArrayLike, hint: str) -> Array:
    """`value` as a float array, refused where it is text, NaN or infinite."""
    array = numbers(name, value, hint)
    if not np.all(np.isfinite(array)):
        raise Refusal(_subject(name) + " must be finite", _first(array, ~np.isfinite(array)), hint)
    return array


def angle(name: str, value: ArrayLike, hint: str) -> Array:
    """`value` as finite radians, with a warning beyond a whole turn: likely to be degrees."""
    array = finite(name, value, hint)
    if np.any(beyond := np.abs(array) > 2 * np.pi):
        at = _first(array, beyond)
        said = f"{name} is in radians, got {at}: did you pass degrees? Write np.radians({at})."
        warn(said, stacklevel=3)
    return array


def distance(name: str, value: ArrayLike, hint: str) -> Array:
    """`value` as metres above zero, with a warning beyond 1 m: likely to be millimetres."""
    array = positive(name, value, hint)
    if np.any(beyond := array > 1.0):
        at = float(_first(array, beyond))
        said = f"{name} is in metres, got {at:g}: did you pass millimetres? Write {at:g}e-3."
        warn(said, stacklevel=3)
    return array


def positive(name: str, value: ArrayLike, hint: str) -> Array:
    """`value` as a float array of finite numbers above zero."""
    array = finite(name, value, hint)
    if not np.all(array > 0):
        raise Refusal(_subject(name) + " must be above zero", _first(array, ~(array > 0)), hint)
    return array


def non_negative(name: str, value: ArrayLike, hint: str) -> Array:
    """`value` as a float array of finite numbers of zero or more."""
    array = finite(name, value, hint)
    if not np.all(array >= 0):
        raise Refusal(_subject(name) + " must not be negative", _first(array, array < 0), hint)
    return array


def number(name: str, value: ArrayLike, hint: str) -> float:
    """`value` as one finite number."""
    array = finite(name, value, hint)
    if array.size != 1:
        raise Refusal(_subject(name) + " must be one number", array.size, hint)
    return float(array.reshape(()))


def positive_number(name: str, value: ArrayLike, hint: str) -> float:
    """`value` as one finite number above zero."""
    return number(name, positive(name, value, hint), hint)


def non_negative_number(name: str, value: ArrayLike, hint: str) -> float:
    """`value` as one finite number of zero or more."""
    return number(name, non_negative(name, value, hint), hint)


def between(
    name: str, value: ArrayLike, hint: str, low: float = 0.0, high: float = 1.0, ends: str = "()"
) -> float:
    """`value` as one number from `low` to `high`; a round bracket leaves that end out."""
    one = number(name, value, hint)
    left_out = [end for end, bracket in zip((low, high), ends, strict=True) if bracket in "()"]
    if not low <= one <= high or one in left_out:
        raise Refusal(_subject(name) + f" must lie between {low:g} and {high:g}", f"{one:g}", hint)
    return one


def mass(value: ArrayLike) -> float:
    """A probability mass: one number from 0 to 1."""
    return between("mass", value, "write 0.95, say", ends="[]")


def whole(name: str, value: object, hint: str, least: int = 1) -> int:
    """`value` as a whole number of `least` or more."""
    array = np.asarray(value)
    if array.size == 1 and array.dtype.kind in "iuf":
        number = float(array.reshape(()))
        if number.is_integer() and least <= number < 2**53:
            return int(number)
    raise Refusal(
        _subject(name) + f" must be a whole number of {least} or more", shown(value), hint
    )


def kind(name: str, value: object, expected: str, having: str, hint: str) -> None:
    """Refuses what has no attribute `having`, and classes where one of their objects is wanted."""
    if isinstance(value, type) or not hasattr(value, having):
        raise Refusal(_subject(name) + f" must be {expected}", shown(value), hint)


def several(name: str, value: object, hint: str) -> list[Any]:
    """`value` as a list, refused where it is one thing or text."""
    if isinstance(value, str | bytes | type) or not isinstance(value, Iterable):
        raise Refusal(_subject(name) + " must be a list", shown(value), hint)
    return list(value)


def generator(seed: Any) -> np.random.Generator:
    """The random generator of a seed."""
    try:
        return np.random.default_rng(seed)
    except (TypeError, ValueError):
        raise Refusal(
            named("seed")
            + " must be a whole number of zero or more, a SeedSequence or a Generator",
            shown(seed),
            "write " + argument("seed", 1) + ", say",
        ) from None


def shown(value: object) -> str:
    """A value as it fits into a sentence: itself, or what kind of thing it is.

    Examples
    --------
    >>> shown("file.csv"), shown(np.zeros((9, 9))), shown(float)
    ("'file.csv'", 'an object of type ndarray', 'the class float')
    """
    if isinstance(value, type):
        return f"the class {value.__name__}"
    text = repr(value)
    short = len(text) <= 50 and "\n" not in text and "object at 0x" not in text
    return text if short else f"an object of type {type(value).__name__}"


def listed(values: Iterable[object], most: int = 4) -> str:
    """The first few of many, and that there are more.

    Examples
    --------
    >>> listed(["s1", "s2"]), listed(range(9))
    ("'s1', 's2'", '0, 1, 2, 3, …')
    """
    items = list(values)
    return ", ".join([*map(repr, items[:most]), *(["…"] if len(items) > most else [])])


def refuse_hinge(whisker: Any, what: str) -> None:
    """Refuse a whisker on a hinge, or what is made of one, where the base is taken as clamped."""
    while hasattr(whisker, "whisker"):
        whisker = whisker.whisker
    stiffness = getattr(whisker, "hinge_stiffness", None)
    if stiffness is not None:
        raise Refusal(
            f"{what} takes whiskers with a clamped base",
            f"hinge_stiffness {stiffness:g} N m/rad",
            "write hinge_stiffness=None, or ww.Observer(whisker, cue) with the cue "
            "ww.cues.ForceMap(), ww.cues.Compliance() or ww.cues.BalanceOfMoments()",
        )


def one_of(name: str, value: object, choices: Iterable[str]) -> str:
    """`value` if it is one of `choices`, else a refusal that names the nearest."""
    allowed = list(choices)
    if isinstance(value, str) and value in allowed:
        return value
    near = get_close_matches(str(value), allowed, n=1)
    meant = f" (did you mean {near[0]!r}?)" if near else ""
    raise Refusal(
        _subject(name) + f" {shown(value)} is unknown{meant}",
        remedy=f"choose one of {', '.join(allowed)}",
    )


def one_or_more(name: str, value: Any, choices: Iterable[str]) -> tuple[str, ...]:
    """`value`, a name or a sequence of different names, if all are among `choices`."""
    allowed = list(choices)
    names = (value,) if isinstance(value, str) else value
    hint = f"write {allowed[:2]}, say"
    if not np.iterable(names):
        raise Refusal(_subject(name) + " must be a list of names", shown(value), hint)
    single = f"{name[:-3]}y" if name.endswith("ies") else name.removesuffix("s")
    given = tuple(one_of(single, each, allowed) for each in names)
    if not given or len(set(given)) < len(given):
        raise Refusal(_subject(name) + " must be one or more, each once", list(given), hint)
    return given


def _subject(name: str) -> Advice:
    """What a refusal is about: a parameter, by its name."""
    return name if isinstance(name, Advice) else named(name)


def _first(array: Array, bad: Flags) -> str:
    return f"{array[bad].flat[0] if array.ndim else array[()]:g}"
