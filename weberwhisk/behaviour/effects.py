"""What else may move an animal's answers: each effect one parameter, one short class.

An effect takes the two noisy signals of the plain observer and changes them, as far as its
parameter says; at its `neutral` value it changes nothing. Effects are applied in the order given.
An effect that goes with more than the two stimuli (the session, the answer before) names a column,
a number for each row of the table, and trials that differ in it are counted apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from .. import _checks
from .percepts import Signals, UnitPercepts
from .trials import Trials

Array = NDArray[np.float64]


class Effect(Protocol):
    """A change of the observer with one parameter."""

    @property
    def name(self) -> str:
        """Name of the parameter."""

    @property
    def prior(self) -> Any:
        """Frozen SciPy distribution of the parameter, or a number where it is known."""

    @property
    def neutral(self) -> float:
        """The value at which there is no effect."""

    def bound(self, percepts: UnitPercepts, n: Array) -> Effect:
        """The effect with its scale taken from the stimuli of the table, `n` trials of each."""

    def column(self, trials: Trials) -> Array | None:
        """What the effect goes with, a number a row; None where the stimuli are all of it."""

    def apply(self, felt: Signals, value: Array, column: Array | float) -> Signals:
        """The signals with the effect, (..., C), for a parameter (..., 1)."""


class _Plain:
    """An effect that needs neither a scale nor a column."""

    neutral: float = 0.0

    def bound(self, percepts: UnitPercepts, n: Array) -> Any:
        return self

    def column(self, trials: Trials) -> Array | None:
        return None


# One object each: the table of its quantiles is made once (see `priors.quantiles`).
_NORMAL = {sd: stats.norm(0.0, sd) for sd in (0.3, 0.4, 0.5, 1.0)}
_EXPONENT, _RHO = stats.norm(1.0, 0.15), stats.beta(1.0, 15.0)


@dataclass(frozen=True, eq=False)
class Floor(_Plain):
    """Noise that is left where the signal vanishes: sd² = (kI)² + floor² (generalised Weber).

    `floor` is in the unit of the signal. Its prior is log-normal: median 3 % of the table's typical
    signal (geometric mean), a factor of 4 either way as one sd.

    Examples
    --------
    >>> from weberwhisk import fit_weber, simulate_trials
    >>> trials = simulate_trials(standards=[1.0, 4.0], weber_fraction=0.15, seed=1)
    >>> fit_weber(trials, effects=[Floor()]).parameters
    ('weber_fraction', 'floor', 'lapse_low', 'lapse_high', 'bias')
    """

    prior: Any = None
    name: str = "floor"

    def bound(self, percepts: UnitPercepts, n: Array) -> Floor:
        typical = _typical(percepts, "A floor")
        if self.prior is not None:
            return self
        return replace(self, prior=stats.lognorm(np.log(4.0), scale=0.03 * typical))

    def apply(self, felt: Signals, value: Array, column: Array | float) -> Signals:
        return felt._replace(sd_1=np.hypot(felt.sd_1, value), sd_2=np.hypot(felt.sd_2, value))


@dataclass(frozen=True, eq=False)
class NearMiss(_Plain):
    """The near miss to Weber's law: sd = k I₀ (I/I₀)^exponent, I₀ the table's typical signal.

    The exponent is 1 under Weber's law and about 0.9 for the loudness of pure tones (McGill &
    Goldberg 1968); the Weber fraction is that at I₀, the geometric mean of the signals.
    """

    prior: Any = _EXPONENT
    name: str = "exponent"
    neutral: float = 1.0
    typical: float = 1.0

    def bound(self, percepts: UnitPercepts, n: Array) -> NearMiss:
        return replace(self, typical=_typical(percepts, "A near-miss exponent"))

    def apply(self, felt: Signals, value: Array, column: Array | float) -> Signals:
        one, two = ((np.abs(m) / self.typical) ** (value - 1) for m in (felt.mean_1, felt.mean_2))
        return felt._replace(sd_1=felt.sd_1 * one, sd_2=felt.sd_2 * two)


def _typical(percepts: UnitPercepts, what: str) -> float:
    """Geometric mean of the signals; refused where all are equally noisy."""
    sds = np.concatenate([percepts.sd_1, percepts.sd_2])
    means = np.abs(np.concatenate([percepts.mean_1, percepts.mean_2]))
    if not sds.size:
        return 1.0
    if np.ptp(sds) <= 1e-9 * sds.max() or np.any(means == 0):
        raise ValueError(
            f"{what} shows only where noise grows with the stimulus, got stimuli that are all "
            "equally noisy; leave it out, or give more standards."
        )
    return float(np.exp(np.mean(np.log(means))))


@dataclass(frozen=True, eq=False)
class Contraction(_Plain):
    """The first signal drawn towards the mean of all stimuli: m₁ → m₁ + contraction · (M − m₁).

    Contraction bias (Ashourian & Loewenstein 2011; Akrami et al. 2018): a remembered signal drifts
    towards what is usual. 0 is none, 1 an observer that compares with the mean alone.
    """

    prior: Any = _NORMAL[0.3]
    name: str = "contraction"
    centre: float = 0.0

    def bound(self, percepts: UnitPercepts, n: Array) -> Contraction:
        total = float(n.sum())
        mean = (percepts.mean_1 + percepts.mean_2) @ n / (2 * total) if total else 0.0
        return replace(self, centre=float(mean))

    def column(self, trials: Trials) -> None:
        _needs_order(trials, "Contraction")

    def apply(self, felt: Signals, value: Array, column: Array | float) -> Signals:
        return felt._replace(mean_1=felt.mean_1 + value * (self.centre - felt.mean_1))


@dataclass(frozen=True, eq=False)
class FirstIntervalNoise(_Plain):
    """The order of the intervals matters: the first signal's sd times exp(memory).

    It shows only as far as the noise of the two stimuli of a trial differs: thousands of trials
    with large differences tell it. The order effect that is easily seen is the `bias`.
    """

    prior: Any = _NORMAL[0.4]
    name: str = "memory"

    def column(self, trials: Trials) -> None:
        _needs_order(trials, "FirstIntervalNoise")

    def apply(self, felt: Signals, value: Array, column: Array | float) -> Signals:
        return felt._replace(sd_1=felt.sd_1 * np.exp(value))


@dataclass(frozen=True, eq=False)
class ComparisonBias(_Plain):
    """A push towards the comparison, whichever interval it came in; sds of the difference.

    Where the standard takes turns between the intervals this is told apart from the order effect,
    which is the `bias`.
    """

    prior: Any = _NORMAL[1.0]
    name: str = "comparison_bias"

    def column(self, trials: Trials) -> Array:
        _needs_order(trials, "ComparisonBias")
        s1, s2, standard = (
            trials.frame[c].to_numpy(float) for c in ("stimulus_1", "stimulus_2", "standard")
        )
        return np.sign(np.abs(s2 - standard) - np.abs(s1 - standard))

    def apply(self, felt: Signals, value: Array, column: Array | float) -> Signals:
        return felt._replace(push=felt.push + value * column)


@dataclass(frozen=True, eq=False)
class History(_Plain):
    """A push towards the answer given on the trial before; sds of the difference.

    Positive repeats answers, negative alternates. The first trial of a session, and one after a
    missing answer, has none.
    """

    prior: Any = _NORMAL[0.5]
    name: str = "history"

    def column(self, trials: Trials) -> Array:
        _needs_order(trials, "History")
        frame = trials.frame
        if (frame["n"] != 1).any():
            raise ValueError(
                f"{trials.source}: History needs a row a trial, got counts; give the trials in "
                "their order."
            )
        before = frame["count"].shift(1).to_numpy(float)
        answer = np.where(np.isnan(before), 0.0, 2 * np.nan_to_num(before) - 1)
        for label in ("subject", "session"):
            if label in frame:
                answer[(frame[label] != frame[label].shift(1)).to_numpy()] = 0.0
        return answer

    def apply(self, felt: Signals, value: Array, column: Array | float) -> Signals:
        return felt._replace(push=felt.push + value * column)


@dataclass(frozen=True, eq=False)
class Drift(_Plain):
    """A learning animal, smoothly: ln k goes by `drift` from the first session to the last.

    Linear in the number of the session in its row, or with `of_log` in its logarithm (fast first,
    slow later). The Weber fraction is that in the middle of the course.

    Examples
    --------
    >>> from weberwhisk import simulate_trials
    >>> trials = simulate_trials(sessions=3, trials_per_level=1, seed=1)
    >>> Drift().column(trials)
    array([-0.5, -0.5, -0.5,  0. ,  0. ,  0. ,  0.5,  0.5,  0.5])
    """

    prior: Any = _NORMAL[0.5]
    name: str = "drift"
    of_log: bool = False

    def column(self, trials: Trials) -> Array:
        sessions, place = _sessions(trials, "Drift")
        course = np.log1p(np.arange(len(sessions))) if self.of_log else np.arange(len(sessions))
        return (course / course[-1] - 0.5)[place]

    def apply(self, felt: Signals, value: Array, column: Array | float) -> Signals:
        factor = np.exp(value * column)
        return felt._replace(sd_1=felt.sd_1 * factor, sd_2=felt.sd_2 * factor)


@dataclass(frozen=True, eq=False)
class Step(_Plain):
    """A learning animal, by blocks: ln k changes by this much from session `at` on.

    Several steps make a piecewise course; the Weber fraction is that before the first.

    Examples
    --------
    >>> from weberwhisk import simulate_trials
    >>> trials = simulate_trials(sessions=3, trials_per_level=1, seed=1)
    >>> Step(at=2).name, Step(at=2).column(trials)
    ('step[2]', array([0., 0., 0., 1., 1., 1., 1., 1., 1.]))
    """

    at: Any
    prior: Any = _NORMAL[0.5]

    @property
    def name(self) -> str:
        return f"step[{self.at}]"

    def column(self, trials: Trials) -> Array:
        sessions, place = _sessions(trials, "Step")
        _checks.one_of("the session of a Step", str(self.at), map(str, sessions))
        return (place >= [str(s) for s in sessions].index(str(self.at))).astype(float)

    def apply(self, felt: Signals, value: Array, column: Array | float) -> Signals:
        factor = np.exp(value * column)
        return felt._replace(sd_1=felt.sd_1 * factor, sd_2=felt.sd_2 * factor)


@dataclass(frozen=True, eq=False)
class Overdispersion(_Plain):
    """Answers that scatter more than a coin's: beta-binomial, with intraclass correlation ρ.

    The probability of each pair of stimuli in each session is itself drawn from a beta distribution
    of mean P and variance ρ P (1 − P) (Fründ, Haenel & Wichmann 2011; Schütt et al. 2016). It
    touches the likelihood, not the signals.
    """

    prior: Any = _RHO
    name: str = "overdispersion"

    def column(self, trials: Trials) -> Array | None:
        return None if not trials.sessions else _sessions(trials, "")[1].astype(float)

    def apply(self, felt: Signals, value: Array, column: Array | float) -> Signals:
        return felt


def _sessions(trials: Trials, what: str) -> tuple[list[Any], NDArray[np.intp]]:
    """Sessions in order, and the place of each row's."""
    if what and len(trials.sessions) < 2:
        raise ValueError(
            f"{trials.source}: {what} needs two sessions or more, got {len(trials.sessions)}; "
            "give the table a column 'session'."
        )
    levels, place = np.unique(trials.frame["session"].to_numpy(), return_inverse=True)
    return levels.tolist(), place


def _needs_order(trials: Trials, what: str) -> None:
    if trials.task.bias_name != "bias":
        raise ValueError(
            f"{what} needs to know which interval held which stimulus, got task "
            f"{trials.task.name!r}; it goes with '2AFC' and '2IFC'."
        )


EFFECTS: dict[str, Effect] = {
    "floor": Floor(),
    "near-miss": NearMiss(),
    "contraction": Contraction(),
    "first-interval": FirstIntervalNoise(),
    "comparison-bias": ComparisonBias(),
    "history": History(),
    "drift": Drift(),
    "drift-fast-first": Drift(of_log=True),
    "overdispersion": Overdispersion(),
}


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


def effect_named(text: str) -> Effect:
    """An effect by its name, with the prior that it brings; `step=12` is a step at session 12.

    Raises
    ------
    ValueError
        For an unknown name, with the nearest one.

    Examples
    --------
    >>> effect_named("near-miss").name, effect_named("step=12").name
    ('exponent', 'step[12]')
    """
    name, equals, session = text.partition("=")
    if name == "step" and equals:
        return Step(at=session)
    return EFFECTS[_checks.one_of("effect", text, (*EFFECTS, "step=<session>"))]
