"""Prior beliefs of a fit: stated, shown, changeable."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats
from scipy.integrate import cumulative_simpson
from scipy.interpolate import CubicSpline
from scipy.special import ndtr

from .._util import checks
from .._util.refusals import Refusal
from .._util.values import Array, Fields
from ..inference.coordinates import in_words
from .encodings import UnitEncodings
from .tasks import SameDifferent, Task, YesNo
from .trials import Cells

__all__ = [
    "DEFAULTS", "PLAIN", "REACH", "SPREAD", "TINY", "LapseTransform", "Priors",
    "check_distribution", "lapse_transform", "of_task", "priors_for",
]  # fmt: skip

PARAMETERS = ("weber_fraction", "lapse_low", "lapse_high", "bias")
REACH = 9.0  # scores beyond which no prior has mass
TINY = 1e-300
DISTRIBUTION = "give a frozen distribution such as scipy.stats.beta(1, 20)"

_BELIEFS = {  # one object each, whose quantiles are tabulated once
    "weber_fraction": stats.lognorm(np.log(3.0), scale=0.1),
    "lapse": stats.beta(0.7, 20.0),
    "lapse by levels": stats.beta(0.5, 9.5),
    "bias": stats.norm(0.0, 1.0),
    # "Different" must be said of a difference: a criterion below zero says it of everything.
    "same-different": stats.lognorm(0.7, scale=1.3),
}
SPREAD = stats.halfnorm(scale=0.5)  # of ln k between animals


@dataclass(frozen=True, eq=False, repr=False)
class Priors(Fields):
    """One frozen SciPy distribution per parameter, or a number where it is known.

    The defaults, and why:

    - `weber_fraction`: log-normal, median 0.1, a factor of 3 either way as one sd (no Weber
      fraction is known for whisker force or moment): 0.012 to 0.86 in 95 %, and 3 is still within
      reach of a few dozen trials of a poor animal. An experimenter who chose levels that bracket
      the animal's thresholds may say so by name, `priors={"weber_fraction": "levels"}`, which
      centres the prior of k by them and expects more lapses; the page "Deal with
      lapses" says what that assumes, and when it must not be used.
    - `lapse_low`, `lapse_high`: Beta(0.7, 20), the share of trials lost at each end: mean 3.4 %,
      half of it below 2 %, one in ten above 8 %; normal scores correlated by 0.7, as an animal that
      does not attend errs at both ends. A lapse and a poor Weber fraction explain the same errors,
      so this prior moves k, and no prior suits all animals. This one was chosen by the expected
      squared error of ln k over a stated population of animals and designs, 0.28 over 2400 animals
      and 0.23 over 2400 held out, where Beta(0.3, 3) has 0.32 and 0.31 (`analyses/lapse_prior.md`);
      95 % intervals hold k in 93 and 96 %. Where one answer in ten is lost, k comes out a fifth too
      high. `WeberFit.lapse_sensitivity` shows how far a fit depends on it. State what you know of
      the animal.
    - `bias`: standard normal in sds of the difference between the two signals. The proportion of
      "second greater" between equal stimuli is then uniform between 0 and 1. It is also the
      `criterion` of yes/no tasks; that of the same–different task is log-normal, median 1.3.
    - `effects`: by name; each effect of a fit brings its own (see `weberwhisk.behaviour.effects`).

    Every fit works in the normal scores of these priors, where each is a standard normal.

    Examples
    --------
    >>> known = Priors(lapse_low=0.02, lapse_high=0.02, bias=stats.norm(0.0, 0.5))
    >>> known.is_fixed("lapse_low"), known.words("bias")
    (True, 'norm(0, 0.5)')
    """

    weber_fraction: Any = _BELIEFS["weber_fraction"]
    lapse_low: Any = _BELIEFS["lapse"]
    lapse_high: Any = _BELIEFS["lapse"]
    bias: Any = _BELIEFS["bias"]
    lapse_correlation: float = 0.7
    effects: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not isinstance(self.effects, Mapping):
            raise Refusal(
                "effects must be a mapping of names to priors",
                checks.shown(self.effects),
                "write effects={'drift': scipy.stats.norm(0, 1)}, say",
            )
        for name in (*PARAMETERS, *self.effects):
            prior = self.of(name)
            if self.is_fixed(name) and prior is not None and not isinstance(prior, type):
                checks.number(f"the prior of {name}", prior, DISTRIBUTION + ", or a number")
            else:
                check_distribution(name, prior)
        low, high = self.support("weber_fraction")
        if low < 0 or high <= 0:
            raise Refusal(
                "the prior of weber_fraction must lie above zero",
                f"support {low:g} to {high:g}",
                "give for example scipy.stats.lognorm(1.1, scale=0.1)",
            )
        for name in ("floor", "session_bias"):
            if name in self and self.support(name)[0] < 0:
                raise Refusal(
                    f"the prior of {name} must not reach below zero",
                    f"support from {self.support(name)[0]:g}",
                    "give for example scipy.stats.halfnorm(scale=0.1)",
                )
        for name in ("lapse_low", "lapse_high", "overdispersion"):
            if name not in self:
                continue
            low, high = self.support(name)
            if low < 0 or high > 1:
                raise Refusal(
                    f"the prior of {name} must lie between 0 and 1",
                    f"support {low:g} to {high:g}",
                    "give for example scipy.stats.beta(1, 20)",
                )
        lost = [self.support(name)[0] for name in ("lapse_low", "lapse_high")]
        if sum(lost) >= 1:
            raise Refusal(
                "the priors of lapse_low and lapse_high must leave something",
                f"lapses of {lost[0]:g} and {lost[1]:g} at least",
                "write 0.02 for each, say",
            )
        hint = "write 0 for lapses that know nothing of each other"
        if not -1 < checks.number("lapse_correlation", self.lapse_correlation, hint) < 1:
            raise Refusal(
                "lapse_correlation must lie between -1 and 1",
                f"{self.lapse_correlation:g}",
                "write 0 for lapses that know nothing of each other",
            )

    def __contains__(self, name: str) -> bool:
        return name in PARAMETERS or name in self.effects

    def of(self, name: str) -> Any:
        """The prior of a parameter; a bias of one standard has that of `bias`."""
        if name in self.effects:
            return self.effects[name]
        return getattr(self, name if name in PARAMETERS else "bias")

    def support(self, name: str) -> tuple[float, float]:
        """Lowest and highest value of a parameter."""
        prior = self.of(name)
        if self.is_fixed(name):
            return float(prior), float(prior)
        low, high = prior.support()
        return float(low), float(high)

    def is_fixed(self, name: str) -> bool:
        """Whether the parameter is a known number."""
        return not hasattr(self.of(name), "ppf")

    def value(self, name: str, score: ArrayLike) -> Array:
        """The parameter at a normal score: the prior's quantile at Φ(score), good in both tails.

        Examples
        --------
        >>> Priors().value("weber_fraction", [-1.0, 0.0, 1.0]).round(4)
        array([0.0333, 0.1   , 0.3   ])
        """
        z = np.asarray(score, dtype=float)
        prior = self.of(name)
        if self.is_fixed(name):
            return np.full(z.shape, float(prior))
        return quantiles(prior)(z)

    def log_density(self, name: str, value: ArrayLike) -> Array:
        """Log-density of a free parameter."""
        return np.asarray(self.of(name).logpdf(value), dtype=float)

    def moments(self, name: str) -> tuple[float, float]:
        """Mean and sd of a free parameter; the middle half stands in where there are none."""
        prior = self.of(name)
        mean, sd = float(prior.mean()), float(prior.std())
        if np.isfinite(mean) and np.isfinite(sd):
            return mean, sd
        low, middle, high = (float(q) for q in prior.ppf([0.25, 0.5, 0.75]))
        return middle, (high - low) / 1.35

    def words(self, name: str) -> str:
        """The prior of a parameter, as one would write it.

        Examples
        --------
        >>> Priors().words("lapse_low")
        'beta(0.7, 20)'
        """
        prior = self.of(name)
        if self.is_fixed(name):
            return f"fixed at {float(prior):g}"
        about = " about the levels shown" if getattr(prior, "about_levels", False) else ""
        return in_words(prior) + about


@lru_cache(maxsize=256)
def quantiles(prior: Any) -> Any:
    """A prior's quantiles by normal score, tabulated once: SciPy's own cost more than a fit."""
    shape, loc, scale = prior.dist._parse_args(*prior.args, **prior.kwds)
    if prior.dist.name == "norm":
        return lambda score: loc + scale * score
    if prior.dist.name == "lognorm" and loc == 0:
        return lambda score: scale * np.exp(shape[0] * score)
    z = np.linspace(-REACH, REACH, 721)
    below = z <= 0
    value = np.concatenate([prior.ppf(ndtr(z[below])), prior.isf(ndtr(-z[~below]))])
    if prior.support()[0] < 0:
        return CubicSpline(z, value)
    log_value = CubicSpline(z, np.log(np.maximum(value, TINY)))
    return lambda score: np.exp(log_value(score))


class LapseTransform(NamedTuple):
    """A variance-stabilising coordinate t of a normal score z; z itself without `to_score`.

    In the normal score z of its prior a lapse near 0 is known from the prior alone, over a width of
    1, and a large one from the answers, over a width that shrinks with their number. The coordinate
    counts both: dt² = dz² + N d(2 asin √λ)², with 2 asin √λ the coordinate in which a proportion of
    N answers has an sd of 1/√N. Even nodes in t are then fine where they must be.
    """

    to_score: CubicSpline | None = None
    to_coordinate: CubicSpline | None = None
    ends: tuple[float, float] = (-REACH, REACH)

    def score(self, t: ArrayLike) -> Array:
        """z at t."""
        return np.asarray(t if self.to_score is None else self.to_score(np.clip(t, *self.ends)))

    def coordinate(self, z: ArrayLike) -> Array:
        """t at z."""
        spline = self.to_coordinate
        return np.asarray(z if spline is None else spline(np.clip(z, -REACH, REACH)))

    def slope(self, t: ArrayLike) -> Array:
        """dz/dt at t."""
        if self.to_score is None:
            return np.ones(np.shape(t))
        return np.asarray(self.to_score(np.clip(t, *self.ends), 1))


PLAIN = LapseTransform()


@lru_cache(maxsize=256)
def lapse_transform(prior: Any, doublings: int) -> LapseTransform:
    """The coordinate for a lapse with that prior, and 2^doublings answers to learn it from."""
    z = np.linspace(-REACH, REACH, 1441)
    arc = CubicSpline(z, 2 * np.arcsin(np.sqrt(np.clip(quantiles(prior)(z), 0.0, 1.0))))
    density = np.sqrt(1 + 2.0**doublings * arc(z, 1) ** 2)
    t = cumulative_simpson(density, x=z, initial=0.0)
    t = t - t[z.size // 2]
    return LapseTransform(CubicSpline(t, z), CubicSpline(z, t), (float(t[0]), float(t[-1])))


def check_distribution(name: str, prior: Any) -> None:
    """Refuses what is not a frozen continuous distribution."""
    if isinstance(prior, type) or not (hasattr(prior, "dist") and hasattr(prior.dist, "pdf")):
        raise Refusal(
            f"the prior of {name} must be a frozen continuous distribution",
            checks.shown(prior),
            DISTRIBUTION,
        )


DEFAULTS = Priors()


def levels_prior(
    shown: Iterable[UnitEncodings], task: Task, easiest: float = 1.5, spread: float = 0.46
) -> Any:
    """The belief that the levels shown bracket the thresholds: a log-logistic prior of k.

    Its median is the Weber fraction at which the signals of the easiest pair shown are 1.5 sds
    (`easiest`) of their difference apart, with 0.46 as the sd of ln k (`spread`). Lapses are then
    Beta(0.5, 9.5) unless stated. `analyses/lapse_prior.md` says what it gains, and why it must not
    be used for staircases, for levels chosen badly, or to compare designs.

    Examples
    --------
    >>> pair = UnitEncodings(np.ones(1), np.ones(1), np.array([1.3]), np.array([1.3]))
    >>> from weberwhisk.behaviour import task_named
    >>> prior = levels_prior([pair], task_named("2AFC"))
    >>> float(np.round(prior.median(), 4))  # 0.3 / hypot(1, 1.3) / 1.5
    0.1219
    """
    widest = []
    for pairs in shown:
        if pairs.has_floor:
            raise Refusal(
                "part of the noise does not go with the Weber fraction, and levels inform of "
                "the whole",
                remedy=(
                    "state scipy.stats.lognorm(0.46, scale=0.1) as the prior of "
                    "weber_fraction, say, instead of 'levels'"
                ),
            )
        sd = pairs.sd_2 if isinstance(task, YesNo) else np.hypot(pairs.sd_1, pairs.sd_2)
        gap = np.abs(pairs.mean_2 - pairs.mean_1)[sd > 0] / sd[sd > 0]
        widest += [float(gap.max())] if np.any(gap > 0) else []
    if not widest:
        raise Refusal(
            "no pair of different stimuli was shown, so that there are no levels to lay the "
            "prior of weber_fraction about",
            remedy="leave out 'levels'",
        )
    middle = float(np.exp(np.mean(np.log(widest)))) / easiest
    return _about_levels(middle, spread)


@lru_cache(maxsize=256)
def _about_levels(middle: float, spread: float) -> Any:
    prior: Any = stats.fisk(np.pi / (np.sqrt(3) * spread), scale=middle)
    prior.about_levels = True  # for `Priors.words`: reports say where a belief came from
    return prior


def priors_for(
    priors: Any,
    cells: Cells,
    unit_known: bool,
    task: Task | None = None,
    effects: Mapping[str, Any] | None = None,
    shown: Iterable[UnitEncodings] = (),
) -> Priors:
    """The priors of a fit: the defaults, with what the user changed.

    Where the unit of a log scale is unknown, the Weber fraction is centred on the median step of
    the table instead of 0.1: scaling the column then scales the answer and nothing else. The pairs
    that each animal was shown are needed for the belief "levels" alone.
    """
    own = dict(effects or {})
    if isinstance(priors, Priors):
        if task is not None:
            priors = of_task(priors, task)
        return replace(priors, effects=own | dict(priors.effects)) if own else priors
    if priors is not None and not isinstance(priors, Mapping):
        raise Refusal(
            "priors must be Priors or a mapping",
            checks.shown(priors),
            "write priors={'lapse_low': scipy.stats.beta(1, 9)}, say",
        )
    changes = {"bias" if name == "criterion" else name: p for name, p in dict(priors or {}).items()}
    for name in changes:
        checks.one_of("the prior's parameter", name, (*PARAMETERS, "lapse_correlation", *own))
    own |= {name: changes.pop(name) for name in own if name in changes}
    if isinstance(named := changes.get("weber_fraction"), str):
        checks.one_of("the belief about weber_fraction", named, ("levels",))
        if "floor" in own:
            raise Refusal(
                "a floor is fitted, and levels inform of all noise together",
                remedy="state a prior of weber_fraction, or leave out 'levels' or the floor",
            )
        assert task is not None
        changes["weber_fraction"] = levels_prior(shown, task)
        changes = dict.fromkeys(("lapse_low", "lapse_high"), _BELIEFS["lapse by levels"]) | changes
    steps = np.abs(cells.stimulus_2 - cells.stimulus_1)
    if not unit_known and np.any(steps > 0):
        scale = float(np.median(steps[steps > 0]))
        changes = {"weber_fraction": stats.lognorm(np.log(3.0), scale=scale)} | changes
    if own:
        changes["effects"] = own
    made = replace(DEFAULTS, **changes) if changes else DEFAULTS
    return made if task is None else of_task(made, task)


def of_task(priors: Priors, task: Task) -> Priors:
    """The priors with the task's own belief about its bias, where nothing else is said of it."""
    if isinstance(task, SameDifferent) and priors.bias is _BELIEFS["bias"]:
        return replace(priors, bias=_BELIEFS["same-different"])
    return priors
