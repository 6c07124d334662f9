"""Prior beliefs of a fit: stated, shown, changeable."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats
from scipy.special import ndtr

from .. import _checks
from .trials import Cells

Array = NDArray[np.float64]

PARAMETERS = ("weber_fraction", "lapse_low", "lapse_high", "bias")


@dataclass(frozen=True, eq=False)
class Priors:
    """One frozen SciPy distribution per parameter, or a number where it is known.

    The defaults, and why:

    - `weber_fraction`: log-normal, median 0.1, a factor of 3 either way as one sd (no Weber
      fraction is known for whisker force or moment): 0.012 to 0.86 in 95 %, and 3 is still within
      reach of a few dozen trials of a poor animal.
    - `lapse_low`, `lapse_high`: Beta(0.3, 6), the share of trials lost at each end: mean 5 %, half
      of it below 1.3 %, one in ten above 15 %. A lapse and a poor Weber fraction explain the same
      errors, so this prior moves k. At k = 0.1 and 297 trials, 300 data sets each with lapses of 0,
      0.02 and 0.1 a side, the median k is off by −9, −2 and +25 % and 95 % intervals cover 91, 98
      and 96 %. Beta(0.2, 4): −7, 0 and +30 %, covering 92, 98 and 93 %. Beta(1.5, 20), with no mass
      near zero: −19, −14 and +8 %, covering 73, 88 and 99 %. State what you know of the animal.
    - `bias`: standard normal in sds of the difference between the percepts. The proportion of
      "second greater" between equal stimuli is then uniform between 0 and 1.

    Every fit works in the normal scores of these priors, where each is a standard normal.
    """

    weber_fraction: Any = field(default_factory=lambda: stats.lognorm(np.log(3.0), scale=0.1))
    lapse_low: Any = field(default_factory=lambda: stats.beta(0.3, 6.0))
    lapse_high: Any = field(default_factory=lambda: stats.beta(0.3, 6.0))
    bias: Any = field(default_factory=lambda: stats.norm(0.0, 1.0))

    def __post_init__(self) -> None:
        for name in PARAMETERS:
            prior = getattr(self, name)
            if not hasattr(prior, "ppf"):
                _checks.finite(
                    f"the prior of {name}",
                    prior,
                    "give a frozen distribution such as scipy.stats.beta(0.3, 6), or a number",
                )
        low, high = self.support("weber_fraction")
        if low < 0 or high <= 0:
            raise ValueError(
                f"the prior of weber_fraction must lie above zero, got support {low:g} to "
                f"{high:g}; give for example scipy.stats.lognorm(1.1, scale=0.1)."
            )
        for name in ("lapse_low", "lapse_high"):
            low, high = self.support(name)
            if low < 0 or high > 1:
                raise ValueError(
                    f"the prior of {name} must lie between 0 and 1, got support {low:g} to "
                    f"{high:g}; give for example scipy.stats.beta(0.3, 6)."
                )

    def support(self, name: str) -> tuple[float, float]:
        """Lowest and highest value of a parameter."""
        prior = getattr(self, name)
        if self.is_fixed(name):
            return float(prior), float(prior)
        low, high = prior.support()
        return float(low), float(high)

    def is_fixed(self, name: str) -> bool:
        """Whether the parameter is a known number."""
        return not hasattr(getattr(self, name), "ppf")

    def value(self, name: str, score: ArrayLike) -> Array:
        """The parameter at a normal score: the prior's quantile at Φ(score), exact in both tails.

        Examples
        --------
        >>> Priors().value("weber_fraction", [-1.0, 0.0, 1.0]).round(4)
        array([0.0333, 0.1   , 0.3   ])
        """
        z = np.asarray(score, dtype=float)
        prior = getattr(self, name)
        if self.is_fixed(name):
            return np.full(z.shape, float(prior))
        out = np.empty(z.shape)
        below = z <= 0
        out[below] = prior.ppf(ndtr(z[below]))
        out[~below] = prior.isf(ndtr(-z[~below]))
        return out

    def words(self, name: str) -> str:
        """The prior of a parameter, as one would write it.

        Examples
        --------
        >>> Priors().words("lapse_low")
        'beta(0.3, 6)'
        """
        prior = getattr(self, name)
        if self.is_fixed(name):
            return f"fixed at {float(prior):g}"
        given = [f"{a:.4g}" for a in prior.args] + [f"{k}={v:.4g}" for k, v in prior.kwds.items()]
        return f"{prior.dist.name}({', '.join(given)})"


def priors_for(priors: Any, cells: Cells, unit_known: bool) -> Priors:
    """The priors of a fit: the defaults, with what the user changed.

    Where the unit of a log scale is unknown, the Weber fraction is centred on the median step of
    the table instead of 0.1: scaling the column then scales the answer and nothing else.

    Raises
    ------
    ValueError
        For an unknown parameter, or a prior that is not one.

    Examples
    --------
    >>> one = np.ones(1)
    >>> priors_for({"lapse_low": 0.0}, Cells(one, one, one, one, one), True).words("lapse_low")
    'fixed at 0'
    """
    if isinstance(priors, Priors):
        return priors
    changes = dict(priors or {})
    for name in changes:
        _checks.one_of("the prior's parameter", name, PARAMETERS)
    base = Priors()
    steps = np.abs(cells.stimulus_2 - cells.stimulus_1)
    if not unit_known and np.any(steps > 0):
        scale = float(np.median(steps[steps > 0]))
        base = replace(base, weber_fraction=stats.lognorm(np.log(3.0), scale=scale))
    return replace(base, **changes)
