"""Rivals of Weber's law, by name: how noise goes with the signal if not in proportion to it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .._util import checks
from .._util.refusals import Refusal, argument
from .._util.values import Array, plain_number
from ..behaviour.encodings import (
    ConstantNoise,
    Encoding,
    ReplacedNoise,
    checked_encoding,
    described,
    refuse_out_of_reach,
)
from .hypotheses import Hypothesis

__all__ = ["RIVALS", "FlooredNoise", "PowerNoise", "rivals"]

#: Rivals by name.
RIVALS = ("constant", "exponent", "floor")


@dataclass(frozen=True)
class PowerNoise(ReplacedNoise):
    """An encoding whose noise is a power of that of Weber's law: sd = k t (s/t)^exponent.

    s is the sd of the base encoding for a Weber fraction of 1, `typical` t is a middling one, so
    that k remains a fraction. 1 is Weber's law, ½ the noise of counts, 0 the same noise everywhere.

    Examples
    --------
    >>> from weberwhisk.behaviour import IdentityEncoding
    >>> PowerNoise(IdentityEncoding(), 2.0, 0.5).sd_per_weber_fraction([2.0, 8.0])
    array([2., 4.])
    """

    typical: float
    exponent: float

    def sd_per_weber_fraction(self, stimulus: ArrayLike) -> Array:
        sd = self.base.sd_per_weber_fraction(stimulus) / self.typical
        return np.asarray(self.typical * sd**self.exponent)

    @property
    def noise_in_words(self) -> str:
        return f"noise that grows as its power of {self.exponent:g}"

    @property
    def described(self) -> str:
        return f"{described(self.base)}, with {self.noise_in_words}"


@dataclass(frozen=True)
class FlooredNoise(ReplacedNoise):
    """An encoding with Weber noise and a floor: sd² = (k s)² + floor², in the signal's unit.

    Examples
    --------
    >>> from weberwhisk.behaviour import IdentityEncoding
    >>> FlooredNoise(IdentityEncoding(), 0.2).floor_sd([1.0, 2.0])
    array([0.2, 0.2])
    """

    floor: float

    def sd_per_weber_fraction(self, stimulus: ArrayLike) -> Array:
        return self.base.sd_per_weber_fraction(stimulus)

    def floor_sd(self, stimulus: ArrayLike) -> Array:
        """Sd of the noise that does not go with the Weber fraction."""
        return np.full(np.shape(stimulus), self.floor)

    @property
    def noise_in_words(self) -> str:
        return f"noise in proportion to it and a floor of {plain_number(self.floor)} beside"

    @property
    def described(self) -> str:
        return f"{described(self.base)}, with {self.noise_in_words}"


def rivals(
    encoding: Encoding,
    standards: ArrayLike,
    rival: str = "constant",
    *,
    weber_fraction: float = 0.1,
    **options: Any,
) -> tuple[Hypothesis, Hypothesis]:
    """Weber's law against a rival of a name: "constant", "exponent:0.5" or "floor:20".

    Parameters
    ----------
    encoding : Encoding
        With Weber noise.
    standards : array_like
        The typical signal is the geometric mean of those there.
    rival : str
        Its name, and after a colon its number: the exponent, ½ by default, or the floor in the unit
        of the signal, by default the noise at the smallest standard. The number is given, not
        fitted: what is compared is Weber's law and that very rival.
    weber_fraction : float
        Of the expected animals, for the default floor.
    **options
        Of both hypotheses: `priors`, `bias`, `task`.

    Examples
    --------
    >>> from weberwhisk.behaviour import IdentityEncoding
    >>> [h.name for h in rivals(IdentityEncoding(), [300.0, 1200.0], "floor:20")]
    ["Weber's law", 'floor 20']
    """
    checked_encoding(encoding)
    if not isinstance(rival, str):
        raise Refusal("rival must be text", checks.shown(rival), 'write "exponent:0.5", say')
    name, colon, text = rival.partition(":")
    checks.one_of("rival", name, RIVALS)
    at = np.atleast_1d(checks.finite("standards", standards, "give two or more"))
    refuse_out_of_reach(encoding, at, "standard")
    sd = encoding.sd_per_weber_fraction(at)
    if sd.size < 2 or np.ptp(sd) <= 1e-9 * sd.max():
        raise Refusal(
            "Weber's law shows at two standards or more, whose noise differs",
            f"{sd.size} with a noise of {sd.max():g}",
            "give standards far apart",
        )
    typical = float(np.exp(np.mean(np.log(sd))))
    defaults = {"constant": 0.0, "exponent": 0.5, "floor": weber_fraction * float(sd.min())}
    value = defaults[name]
    if colon:
        try:
            value = float(text)
        except ValueError:
            raise Refusal(
                f"the number of the rival {name!r} cannot be read", repr(text),
                "write " + argument("rival", f"{name}:{defaults[name]:g}"),
            ) from None  # fmt: skip
    if name == "constant" and colon:
        raise Refusal("constant noise has no number", repr(text), "leave it out")
    if name == "exponent" and not (np.isfinite(value) and value != 1.0):
        raise Refusal("an exponent of 1 is Weber's law", f"{value:g}", "write 0.5, say")
    if name == "floor":
        checks.positive_number("the floor", value, "write 20, say")
    of_rival: dict[str, Encoding] = {
        "constant": ConstantNoise(encoding, typical),
        "exponent": PowerNoise(encoding, typical, value),
        "floor": FlooredNoise(encoding, value),
    }
    called = "constant noise" if name == "constant" else f"{name} {plain_number(value)}"
    return (
        Hypothesis("Weber's law", encoding, **options),
        Hypothesis(called, of_rival[name], **options),
    )
