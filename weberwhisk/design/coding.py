"""The nouns of a design as JSON, and back: every number to its last bit."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from scipy import stats

from ..behaviour.comparison import ConstantNoise
from ..behaviour.percepts import CuePercept, IdentityPercept, LogAxisPercept, LogPercept
from ..behaviour.priors import Priors
from ..cues import Compliance, ForceMap
from ..observer import Observer
from ..receptors import GeneralisedWeber, Weber
from ..whisker import Whisker
from .goals import Animals, Goal
from .hypotheses import Hypothesis
from .scheme import Constraints, Scheme

# What each is made of: the names of its arguments, `argument=attribute` where these differ.
NOUNS: dict[type, str] = {
    Whisker: "length base_radius tip_radius youngs_modulus curvature density",
    Compliance: "tap_angle angular_velocity velocity_spread",
    ForceMap: "signals=signal_names deflection_angle",
    Weber: "weber_fraction correlation",
    GeneralisedWeber: "weber_fraction floor ceiling correlation",
    Observer: "whisker cue noise",
    CuePercept: "observer deflection_angle unit",
    IdentityPercept: "",
    LogPercept: "log_unit",
    LogAxisPercept: "log_unit",
    ConstantNoise: "base typical",
    Priors: "weber_fraction lapse_low lapse_high bias lapse_correlation",
    Hypothesis: "name percept priors bias noise task",
    Scheme: "standards offsets trials animals",
    Constraints: "nearest farthest step easy_share easy_proportion",
    Goal: "bayes_factor half_width share",
    Animals: "weber_fraction spread lapse bias_spread lapses_vary",
}
KIND = "is"  # the key that says which noun a mapping is


def encode(value: Any) -> Any:
    """A noun, and whatever it is made of, in what JSON has.

    Raises
    ------
    ValueError
        For what has no such form: a cue or a receptor of one's own, say.

    Examples
    --------
    >>> encode(LogPercept(0.5))
    {'is': 'LogPercept', 'log_unit': 0.5}
    >>> encode(stats.beta(0.3, 3))
    {'is': 'beta', 'args': [0.3, 3], 'kwds': {}}
    """
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        return value if np.isfinite(value) else str(value)
    if isinstance(value, list | tuple):
        return [encode(item) for item in value]
    if isinstance(value, dict):
        return {str(key): encode(item) for key, item in value.items()}
    if hasattr(value, "dist") and hasattr(value, "kwds"):
        return {KIND: value.dist.name, "args": encode(value.args), "kwds": encode(value.kwds)}
    if type(value) not in NOUNS:
        known = ", ".join(noun.__name__ for noun in NOUNS)
        raise ValueError(f"{value!r} cannot be written to a plan; make it of {known}.")
    parts = {name: encode(getattr(value, a)) for name, a in _parts(type(value))}
    return {KIND: type(value).__name__, **parts}


def decode(value: Any) -> Any:
    """What `encode` has written.

    Raises
    ------
    ValueError
        For an unknown noun, parts that are missing or too many, or values that the noun refuses.

    Examples
    --------
    >>> decode(encode(LogPercept(0.5)))
    LogPercept(log_unit=0.5, direction=1, domain=(-inf, inf))
    """
    if isinstance(value, list):
        return [decode(item) for item in value]
    if isinstance(value, str) and value in ("inf", "-inf"):
        return float(value)
    if not isinstance(value, dict):
        return value
    parts = {name: decode(item) for name, item in value.items() if name != KIND}
    if KIND not in value:
        return parts
    try:
        return _maker(value[KIND])(**parts)
    except TypeError as error:  # parts missing, or not of this noun
        raise ValueError(f"{value[KIND]!r} is not made of {sorted(parts)} ({error}).") from None


def _maker(kind: Any) -> Callable[..., Any]:
    for noun in NOUNS:
        if noun.__name__ == kind:
            return noun
    distribution = getattr(stats, kind, None) if isinstance(kind, str) else None
    if isinstance(distribution, stats.rv_continuous):
        return partial(_frozen, distribution)
    raise ValueError(f"{kind!r} is nothing that this version knows.")


def _frozen(distribution: Any, *, args: list[float], kwds: dict[str, float]) -> Any:
    return distribution(*args, **kwds)


def _parts(noun: type) -> list[tuple[str, str]]:
    """Arguments of a noun, and the attributes that hold them."""
    pairs = (part.partition("=") for part in NOUNS[noun].split())
    return [(name, attribute or name) for name, _, attribute in pairs]
