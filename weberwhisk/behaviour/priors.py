"""Prior beliefs of a fit: stated, shown, changeable."""

from __future__ import annotations

import ast
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats
from scipy.integrate import cumulative_simpson
from scipy.interpolate import CubicSpline
from scipy.special import ndtr, ndtri

from .._util import checks
from .._util.refusals import Refusal
from .._util.values import Array, Fields
from ..inference.coordinates import in_words
from .encodings import UnitEncodings
from .tasks import SameDifferent, Task, YesNo
from .trials import Cells

__all__ = [
    "DEFAULTS",
    "PLAIN",
    "REACH",
    "SPREAD",
    "TINY",
    "Priors",
    "ScoreTransform",
    "belief_named",
    "bias_transform",
    "check_distribution",
    "lapse_transform",
    "of_task",
    "priors_for",
]  # fmt: skip

PARAMETERS = ("weber_fraction", "lapse_low", "lapse_high", "bias")
REACH = 9.0  # scores beyond which no prior has mass
FARTHEST_BIAS = 1e3  # sds
TINY = 1e-300
DISTRIBUTION = "give a frozen distribution such as scipy.stats.beta(1, 20)"

_BELIEFS = {  # one object each, whose quantiles are tabulated once
    "weber_fraction": stats.lognorm(np.log(3.0), scale=0.1),
    "lapse": stats.beta(0.7, 20.0),
    "lapse by levels": stats.beta(0.5, 9.5),
    "bias": stats.cauchy(0.0, 0.7),
    # "Different" must be said of a difference: a criterion below zero says it of everything.
    "same-different": stats.fisk(1.5, scale=1.6),
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
      and 0.23 over 2400 held out, where Beta(0.3, 3) has 0.31 and 0.30 (`analyses/lapse_prior.md`);
      95 % intervals hold k in 93 and 96 %. Where one answer in ten is lost, k comes out a fifth too
      high. State what you know of the animal. `WeberFit.prior_sensitivity` shows how far a fit
      depends on this belief, and on every other.
    - `bias`: Cauchy, half of it within 0.7 sds of the difference between the two signals, as of a
      standard normal, with tails that give way: an animal whose criterion lies 8 sds away, or to
      whom a comparison 40 % off seems equal, may say so. Where k is small a bias is many sds, so
      that a normal belief pulls k up (`analyses/prior_choice.md`). It is also the `criterion` of
      yes/no tasks; that of the same–different task is log-logistic, median 1.6.
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

    def score(self, name: str, value: ArrayLike) -> Array:
        """The normal score of a free parameter's value, good in both tails.

        Examples
        --------
        >>> Priors().score("weber_fraction", [0.3, 0.9]).round(4)
        array([1., 2.])
        """
        prior, inside = self.of(name), np.asarray(value, dtype=float)
        if self.support(name)[0] == 0:
            inside = np.maximum(inside, TINY)
        with np.errstate(divide="ignore"):  # SciPy's log-logistic takes ln of what is 0 far out
            below, above = ndtri(prior.cdf(inside)), -ndtri(prior.sf(inside))
        return np.clip(np.where(below < 0, below, above), -REACH, REACH)

    def log_density(self, name: str, value: ArrayLike) -> Array:
        """Log-density of a free parameter."""
        return np.asarray(self.of(name).logpdf(value), dtype=float)

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


class ScoreTransform(NamedTuple):
    """A variance-stabilising coordinate t of a normal score z; z itself without `to_score`.

    Where the prior alone informs of a parameter, it is known over a width of 1 in the normal score
    z; where the answers do, over a width that is even in a coordinate of their own. t counts both,
    so that even nodes in t are fine where they must be.
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
        return np.asarray(z if spline is None else spline(np.clip(z, spline.x[0], spline.x[-1])))

    def slope(self, t: ArrayLike) -> Array:
        """dz/dt at t."""
        if self.to_score is None:
            return np.ones(np.shape(t))
        return np.asarray(self.to_score(np.clip(t, *self.ends), 1))


PLAIN = ScoreTransform()


@lru_cache(maxsize=256)
def lapse_transform(prior: Any, doublings: int) -> ScoreTransform:
    """The coordinate for a lapse with that prior, and 2^doublings answers to learn it from.

    dt² = dz² + N d(2 asin √λ)², with 2 asin √λ the coordinate in which a proportion of N answers
    has an sd of 1/√N.
    """
    z = np.linspace(-REACH, REACH, 1441)
    arc = CubicSpline(z, 2 * np.arcsin(np.sqrt(np.clip(quantiles(prior)(z), 0.0, 1.0))))
    density = np.sqrt(1 + 2.0**doublings * arc(z, 1) ** 2)
    t = cumulative_simpson(density, x=z, initial=0.0)
    t = t - t[z.size // 2]
    return ScoreTransform(CubicSpline(t, z), CubicSpline(z, t), (float(t[0]), float(t[-1])))


@lru_cache(maxsize=256)
def bias_transform(prior: Any) -> ScoreTransform:
    """The coordinate for a bias with that prior; its score itself for a normal one.

    Answers know a bias b over a width that is the same wherever it lies, and the scores of a prior
    with heavy tails crowd large ones together: dt² = dz² + dβ² with β = 3 asinh(b/3), even in b
    near 0 and in ln b far from it. Nothing lies beyond 1000 sds.
    """
    if prior.dist.name == "norm":
        return PLAIN
    z = np.linspace(-REACH, REACH, 1441)
    bias = quantiles(prior)(z)
    z, bias = z[np.abs(bias) < FARTHEST_BIAS], bias[np.abs(bias) < FARTHEST_BIAS]
    if z.size < 100:
        return PLAIN
    arc = CubicSpline(z, 3.0 * np.arcsinh(bias / 3.0))
    t = cumulative_simpson(np.hypot(1.0, arc(z, 1)), x=z, initial=0.0)
    t = t - np.interp(0.0, z, t)
    return ScoreTransform(CubicSpline(t, z), CubicSpline(z, t), (float(t[0]), float(t[-1])))


def check_distribution(name: str, prior: Any) -> None:
    """Refuses what is not a frozen continuous distribution."""
    if isinstance(prior, type) or not (hasattr(prior, "dist") and hasattr(prior.dist, "pdf")):
        raise Refusal(
            f"the prior of {name} must be a frozen continuous distribution",
            checks.shown(prior),
            DISTRIBUTION,
        )


def belief_named(text: str) -> Any:
    """A belief by its text: a distribution as SciPy and `Priors.words` have it, or a number.

    Raises
    ------
    ValueError
        For what is neither.

    Examples
    --------
    >>> belief_named("beta(1, 9)").mean(), belief_named("0.02")
    (np.float64(0.1), 0.02)
    """
    example = "write 'beta(1, 9)' as scipy.stats has it, or a number such as 0.02"
    try:
        said = ast.parse(text.strip(), mode="eval").body
        if not isinstance(said, ast.Call):
            return float(ast.literal_eval(said))
        family = said.func.attr if isinstance(said.func, ast.Attribute) else said.func.id  # type: ignore[attr-defined]
        given = [float(ast.literal_eval(one)) for one in said.args]
        more = {str(one.arg): float(ast.literal_eval(one.value)) for one in said.keywords}
        kind = getattr(stats, family, None)
        if not isinstance(kind, stats.rv_continuous):
            raise Refusal("SciPy has no such continuous distribution", repr(family), example)
        made = kind(*given, **more)
        if not np.isfinite(made.median()):
            raise Refusal("A distribution does not have these parameters", repr(text), example)
    except Refusal:
        raise
    except (SyntaxError, ValueError, TypeError, AttributeError) as error:
        raise Refusal("A belief is a distribution or a number", repr(text), example) from error
    return made


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


def usual_bias(task: Task, priors: Priors | None = None) -> float:
    """The prior's median of a criterion; a bias is 0."""
    if task.bias_name != "criterion":
        return 0.0
    return float(of_task(priors or DEFAULTS, task).value("bias", 0.0))


def of_task(priors: Priors, task: Task) -> Priors:
    """The priors with the task's own belief about its bias, where nothing else is said of it."""
    if isinstance(task, SameDifferent) and priors.bias is _BELIEFS["bias"]:
        return replace(priors, bias=_BELIEFS["same-different"])
    return priors
