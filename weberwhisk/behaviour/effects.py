"""What else may move an animal's answers: each effect one parameter, one short class.

An effect takes the two noisy signals of the plain observer and changes them, as far as its
parameter says; at its `neutral` value it changes nothing. Effects are applied in the order given.
An effect that goes with more than the two stimuli (the session, the answer before) names a column,
a number for each row of the table, and trials that differ in it are counted apart.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from scipy import stats
from scipy.stats.distributions import rv_frozen

from .. import _checks
from .._values import Array, renamed_names
from .encodings import Encoding, Signals, UnitEncodings
from .trials import SDS, Trials, after_gap, needs_order, needs_rows, session_block, sessions_of

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


class Effect:
    """A change of the observer with one parameter; by default with no scale and no column.

    `name` is that of the parameter; `prior` its frozen SciPy distribution, or a number where it is
    known; at `neutral` there is no effect.
    """

    name: str
    prior: rv_frozen | float | None
    neutral: float = 0.0

    def bound(self, encodings: UnitEncodings, n: Array) -> Effect:
        """The effect with its scale taken from the stimuli of the table, `n` trials of each."""
        return self

    def column(self, trials: Trials, encoding: Encoding) -> Array | None:
        """What the effect goes with, a number a row; None where the stimuli are all of it.

        Zero stands for a trial like any other, where a curve is drawn or a threshold is computed.
        """
        return None

    def apply(self, signals: Signals, value: Array, column: Array | float) -> Signals:
        """The signals with the effect, (..., C), for a parameter (..., 1)."""
        return signals


# One object each: the table of its quantiles is made once (see `priors.quantiles`).
NORMAL = {sd: stats.norm(0.0, sd) for sd in (0.3, 0.4, 0.5, 1.0)}
_EXPONENT, _RHO = stats.norm(1.0, 0.15), stats.beta(1.0, 15.0)


class _OfSessions(Effect):
    """The noise of a session times exp of the value, as far as its column says."""

    def apply(self, signals: Signals, value: Array, column: Array | float) -> Signals:
        factor = np.exp(value * column)
        return signals._replace(sd_1=signals.sd_1 * factor, sd_2=signals.sd_2 * factor)


@dataclass(frozen=True, eq=False)
class Drift(_OfSessions):
    """A learning animal, smoothly: ln k goes by `drift` from the first session to the last.

    Linear in the number of the session in its row, or with `of_log` in its logarithm (fast first,
    slow later). The Weber fraction is that in the middle of the course. Sessions that are not
    numbers go in the order in which they first appear in the table.

    Examples
    --------
    >>> from weberwhisk import simulate_trials
    >>> from weberwhisk.behaviour import IdentityEncoding
    >>> trials = simulate_trials(sessions=3, trials_per_level=1, seed=1)
    >>> Drift().column(trials, IdentityEncoding())
    array([-0.5, -0.5, -0.5,  0. ,  0. ,  0. ,  0.5,  0.5,  0.5])
    """

    prior: rv_frozen | float = NORMAL[0.5]
    name: str = "drift"
    of_log: bool = False

    def column(self, trials: Trials, encoding: Encoding) -> Array:
        sessions, place = sessions_of(trials, "Drift")
        course = np.log1p(np.arange(len(sessions))) if self.of_log else np.arange(len(sessions))
        return (course / course[-1] - 0.5)[place]


@dataclass(frozen=True, eq=False)
class Step(_OfSessions):
    """A learning animal, by blocks: ln k changes by this much from session `at` on.

    Several steps make a piecewise course; the Weber fraction is that before the first. Sessions
    that are not numbers go in the order in which they first appear in the table.

    Examples
    --------
    >>> from weberwhisk import simulate_trials
    >>> from weberwhisk.behaviour import IdentityEncoding
    >>> trials = simulate_trials(sessions=3, trials_per_level=1, seed=1)
    >>> Step(at=2).name, Step(at=2).column(trials, IdentityEncoding())
    ('step[2]', array([0., 0., 0., 1., 1., 1., 1., 1., 1.]))
    """

    at: Hashable
    prior: rv_frozen | float = NORMAL[0.5]

    @property
    def name(self) -> str:  # type: ignore[override]
        return f"step[{self.at}]"

    def column(self, trials: Trials, encoding: Encoding) -> Array:
        sessions, place = sessions_of(trials, "Step")
        _checks.one_of("the session of a Step", str(self.at), map(str, sessions))
        return (place >= [str(s) for s in sessions].index(str(self.at))).astype(float)


@dataclass(frozen=True, eq=False)
class Floor(Effect):
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

    prior: rv_frozen | float | None = None
    name: str = "floor"

    def bound(self, encodings: UnitEncodings, n: Array) -> Floor:
        typical = _typical(encodings, "A floor")
        if self.prior is not None:
            return self
        return replace(self, prior=stats.lognorm(np.log(4.0), scale=0.03 * typical))

    def apply(self, signals: Signals, value: Array, column: Array | float) -> Signals:
        return signals._replace(
            sd_1=np.hypot(signals.sd_1, value), sd_2=np.hypot(signals.sd_2, value)
        )


@dataclass(frozen=True, eq=False)
class NearMissExponent(Effect):
    """The near miss to Weber's law: sd = k I₀ (I/I₀)^exponent, I₀ the table's typical signal.

    The exponent is 1 under Weber's law and about 0.9 for the loudness of pure tones (McGill &
    Goldberg 1968); the Weber fraction is that at I₀, the geometric mean of the signals.
    """

    prior: rv_frozen | float = _EXPONENT
    name: str = "exponent"
    neutral: float = 1.0
    typical: float = 1.0

    def bound(self, encodings: UnitEncodings, n: Array) -> NearMissExponent:
        return replace(self, typical=_typical(encodings, "A near-miss exponent"))

    def apply(self, signals: Signals, value: Array, column: Array | float) -> Signals:
        one, two = (
            (np.abs(m) / self.typical) ** (value - 1) for m in (signals.mean_1, signals.mean_2)
        )
        return signals._replace(sd_1=signals.sd_1 * one, sd_2=signals.sd_2 * two)


def _typical(encodings: UnitEncodings, what: str) -> float:
    """Geometric mean of the signals; refused where all are equally noisy."""
    sds = np.concatenate([encodings.sd_1, encodings.sd_2])
    means = np.abs(np.concatenate([encodings.mean_1, encodings.mean_2]))
    if not sds.size:
        return 1.0
    if np.ptp(sds) <= 1e-9 * sds.max() or np.any(means == 0):
        raise ValueError(
            f"{what} shows only where noise grows with the stimulus, got stimuli that are all "
            "equally noisy; leave it out, or give more standards."
        )
    return float(np.exp(np.mean(np.log(means))))


@dataclass(frozen=True, eq=False)
class FirstIntervalNoise(Effect):
    """The order of the intervals matters: the first signal's sd times exp(memory).

    It shows only as far as the noise of the two stimuli of a trial differs: thousands of trials
    with large differences tell it. The order effect that is easily seen is the `bias`.
    """

    prior: rv_frozen | float = NORMAL[0.4]
    name: str = "memory"

    def column(self, trials: Trials, encoding: Encoding) -> None:
        needs_order(trials, "FirstIntervalNoise")

    def apply(self, signals: Signals, value: Array, column: Array | float) -> Signals:
        return signals._replace(sd_1=signals.sd_1 * np.exp(value))


@dataclass(frozen=True, eq=False)
class Overdispersion(Effect):
    """Answers that scatter more than a coin's: beta-binomial, with intraclass correlation ρ.

    The probability of each pair of stimuli in each session is itself drawn from a beta distribution
    of mean P and variance ρ P (1 − P) (Fründ, Haenel & Wichmann 2011; Schütt et al. 2016). It
    touches the likelihood, not the signals.
    """

    prior: rv_frozen | float = _RHO
    name: str = "overdispersion"

    def column(self, trials: Trials, encoding: Encoding) -> Array | None:
        return None if not trials.sessions else sessions_of(trials, "")[1].astype(float)


@dataclass(frozen=True, eq=False)
class Contraction(Effect):
    """The first signal drawn towards the mean of all stimuli: m₁ → m₁ + contraction · (M − m₁).

    Contraction bias (Ashourian & Loewenstein 2011; Akrami et al. 2018): a remembered signal drifts
    towards what is usual. 0 is none, 1 an observer that compares with the mean alone. M is the mean
    signal of the whole table, as for an animal that has known its stimuli for long;
    `PastContraction` has that of the trials before.
    """

    prior: rv_frozen | float = NORMAL[0.3]
    name: str = "contraction"
    centre: float = 0.0

    def bound(self, encodings: UnitEncodings, n: Array) -> Contraction:
        total = float(n.sum())
        mean = (encodings.mean_1 + encodings.mean_2) @ n / (2 * total) if total else 0.0
        return replace(self, centre=float(mean))

    def column(self, trials: Trials, encoding: Encoding) -> Array | None:
        needs_order(trials, "Contraction")
        return None

    def apply(self, signals: Signals, value: Array, column: Array | float) -> Signals:
        usual = self.centre + column
        return signals._replace(mean_1=signals.mean_1 + value * (usual - signals.mean_1))


@dataclass(frozen=True, eq=False)
class PastContraction(Contraction):
    """The first signal drawn towards the mean of past ones: m₁ → m₁ + value · (M_t − m₁).

    M_t is the mean of both signals of all trials before this one in its session (Akrami et al.
    2018), answered or not. With a `half_life` in trials the past fades: a trial that many trials
    back counts half as much as the last. The first trial of a session has no past and is not
    drawn. M_t is rounded to a hundredth of the standard deviation of the signals, so that trials
    alike are counted together.

    Examples
    --------
    >>> from weberwhisk.behaviour import IdentityEncoding, read_trials
    >>> import pandas as pd
    >>> table = pd.DataFrame({"stimulus_1": [1.0, 2.0, 4.0], "stimulus_2": [3.0, 2.0, 6.0],
    ...                       "choice": [1, 0, 1]})
    >>> PastContraction().column(read_trials(table), IdentityEncoding()).round(1) + 3  # their mean
    array([1., 2., 2.])
    """

    name: str = "past_contraction"
    half_life: float | None = None

    def __post_init__(self) -> None:
        if self.half_life is not None:
            _checks.positive("half_life", self.half_life, "give trials, such as 20")

    def column(self, trials: Trials, encoding: Encoding) -> Array:
        needs_order(trials, "PastContraction")
        needs_rows(trials, "PastContraction")
        frame = trials.frame
        if after_gap(frame).any():
            raise ValueError(
                f"{trials.source}: PastContraction needs all trials of a session, got numbers of "
                "trials that leap; give those without an answer too, and all standards."
            )
        first, second = (
            encoding.direction * encoding.mean(frame[c].to_numpy(float))
            for c in ("stimulus_1", "stimulus_2")
        )
        middle = (first + second) / 2
        answered = middle[frame["count"].notna().to_numpy()]
        usual = answered.mean() if answered.size else 0.0
        ago = pd.Series(middle - usual).groupby(session_block(frame), sort=False)
        if self.half_life is None:
            past = ago.transform(lambda m: m.expanding().mean().shift(1))
        else:
            past = ago.transform(lambda m: m.ewm(halflife=self.half_life).mean().shift(1))
        step = 0.01 * middle.std() or 1.0
        return np.where(past.isna(), first - usual, np.round(past / step) * step)


class _Shift(Effect):
    """A shift of the decision variable by the value times the column."""

    def apply(self, signals: Signals, value: Array, column: Array | float) -> Signals:
        return signals._replace(shift=signals.shift + value * column)


@dataclass(frozen=True, eq=False)
class ComparisonBias(_Shift):
    """A shift towards the comparison, whichever interval it came in; sds of the difference.

    Where the standard takes turns between the intervals this is distinguished from the order
    effect, which is the `bias`.
    """

    prior: rv_frozen | float = NORMAL[1.0]
    name: str = "comparison_bias"

    def column(self, trials: Trials, encoding: Encoding) -> Array:
        needs_order(trials, "ComparisonBias")
        s1, s2, standard = (
            trials.frame[c].to_numpy(float) for c in ("stimulus_1", "stimulus_2", "standard")
        )
        shown = np.isclose(s1, standard, 1e-9, 1e-12) | np.isclose(s2, standard, 1e-9, 1e-12)
        if len(trials) and not shown.any() and SDS[0] not in trials.frame:
            raise ValueError(
                f"{trials.source}: ComparisonBias needs to know which stimulus was the standard, "
                "got standards that were never shown; give the table a column 'standard'."
            )
        return np.sign(np.abs(s2 - standard) - np.abs(s1 - standard))


@dataclass(frozen=True, eq=False)
class History(_Shift):
    """A shift towards the answer given on the trial before; sds of the difference.

    Positive repeats answers, negative alternates. The first trial of a session, and one after a
    missing answer or after a trial that is not in the table, has none.
    """

    prior: rv_frozen | float = NORMAL[0.5]
    name: str = "history"

    def column(self, trials: Trials, encoding: Encoding) -> Array:
        needs_order(trials, "History")
        needs_rows(trials, "History")
        frame = trials.frame
        before = frame["count"].shift(1).to_numpy(float)
        answer = np.where(np.isnan(before), 0.0, 2 * np.nan_to_num(before) - 1)
        answer[(np.diff(session_block(frame), prepend=-1) != 0) | after_gap(frame)] = 0.0
        return answer


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
    hint = "write effects=[(Contraction(), 0.2)], from weberwhisk.behaviour.effects"
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
