"""What else may move an animal's answers: each effect one parameter, one short class.

An effect takes the two noisy signals of the plain observer and changes them, as far as its
parameter says; at its `neutral` value it changes nothing. Effects are applied in the order given.
An effect that goes with more than the two stimuli (the session, the answer before) names a column,
a number for each row of the table, and trials that differ in it are counted apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ... import _checks
from ..._deprecated import renamed_names
from .kinds import (
    ComparisonBias,
    Contraction,
    Drift,
    Effect,
    FirstIntervalNoise,
    Floor,
    History,
    NearMissExponent,
    Overdispersion,
    PastContraction,
    Step,
)

__all__ = [
    "EFFECTS",
    "ComparisonBias",
    "Contraction",
    "Drift",
    "Effect",
    "FirstIntervalNoise",
    "Floor",
    "History",
    "NearMissExponent",
    "Overdispersion",
    "PastContraction",
    "Step",
    "check_effects",
    "check_valued",
    "effect_named",
    "effect_valued",
]

EFFECTS: dict[str, Effect] = {
    "floor": Floor(),
    "near-miss": NearMissExponent(),
    "contraction": Contraction(),
    "past-contraction": PastContraction(),
    "first-interval": FirstIntervalNoise(),
    "comparison-bias": ComparisonBias(),
    "history": History(),
    "drift": Drift(),
    "drift-fast-first": Drift(of_log=True),
    "overdispersion": Overdispersion(),
}
#: Effects that take a number after their name.
WITH_NUMBER = ("step=<session>", "past-contraction=<half-life in trials>")


def check_effects(effects: Any) -> None:
    """Refuses what is not a sequence of effects, with what to write instead."""
    if isinstance(effects, str) or not isinstance(effects, Sequence):
        raise ValueError(
            f"effects must be a sequence, got {_checks.shown(effects)}; write effects=[Drift()], "
            "say, with Drift from weberwhisk.behaviour.effects."
        )
    for effect in effects:
        named = EFFECTS.get(effect) if isinstance(effect, str) else None
        instead = type(named).__name__ if named else getattr(effect, "__name__", "Drift")
        _checks.kind(
            "an effect", effect, "an Effect", "apply",
            f"write {instead}(), from weberwhisk.behaviour.effects",
        )  # fmt: skip


def check_valued(effects: Any) -> None:
    """Refuses what is not a sequence of effects with their values."""
    hint = (
        "write effects=[(Contraction(), 0.2)], with Contraction from weberwhisk.behaviour.effects"
    )
    try:
        pairs = [(effect, value) for effect, value in effects]
    except (TypeError, ValueError):
        raise ValueError(
            f"effects must be pairs of an effect and its value, got {_checks.shown(effects)}; "
            f"{hint}."
        ) from None
    check_effects([effect for effect, _ in pairs])
    for effect, value in pairs:
        values = _checks.finite(f"the value of {effect.name}", value, hint)
        if isinstance(effect, Overdispersion) and not np.all((values > 0) & (values < 1)):
            raise ValueError(
                f"overdispersion must lie between 0 and 1, got {_checks.shown(value)}; write "
                "0.05, say."
            )


def effect_named(text: str) -> Effect:
    """An effect by its name, with the prior that it brings.

    `step=12` is a step at session 12, and `past-contraction=20` a past that fades with a half-life
    of 20 trials.

    Raises
    ------
    ValueError
        For an unknown name, with the nearest one.

    Examples
    --------
    >>> effect_named("near-miss").name, effect_named("step=12").name
    ('exponent', 'step[12]')
    """
    name, _, given = text.partition("=")
    if name == "step" and given:
        return Step(at=given)
    if name == "past-contraction" and given:
        return PastContraction(
            half_life=float(_checks.positive("half_life", given, "write past-contraction=20, say"))
        )
    return EFFECTS[_checks.one_of("effect", text, (*EFFECTS, *WITH_NUMBER))]


def effect_valued(text: str) -> tuple[Effect, float]:
    """An effect by its name with the value of its parameter after a colon.

    Raises
    ------
    ValueError
        For an unknown name, and a value that is no number.

    Examples
    --------
    >>> effect, value = effect_valued("past-contraction=20:0.3")
    >>> effect.half_life, value
    (20.0, 0.3)
    """
    name, _, value = text.rpartition(":")
    hint = f"write {name or text}:0.3, say"
    return effect_named(name or text), _checks.number("the value of an effect", value, hint)


__getattr__ = renamed_names(__name__, {"NearMiss": "NearMissExponent"})
