"""What else may move an animal's answers: each effect one parameter, one short class.

An effect changes the two noisy signals of the plain observer; at its null it changes nothing.
Effects are applied in the order given. One that depends on more than the two stimuli (the session,
the answer before) has a column, a number for each row of the table; trials that differ in it count
apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from scipy import stats
from scipy.stats.distributions import rv_frozen

from .._util import checks
from .._util.refusals import Refusal, named
from .._util.values import Array, Fields, pd
from .encodings import Encoding, Signals, UnitEncodings
from .trials import STIMULI, Trials, needs_order, needs_rows, needs_standards, sessions_of

__all__ = [
    "EFFECTS", "BiasDrift", "Contraction", "Covariate", "Drift", "Effect", "Exponent", "Floor",
    "History", "NoiseByOrder", "Overdispersion", "SessionBias", "StandardSecond", "TrialBefore",
    "WinStay", "check_effects", "check_valued", "effect_named", "effect_valued", "is_formula",
    "is_possible",
]  # fmt: skip


class Effect:
    """A change of the observer with one parameter; by default with no scale and no column.

    `name` is that of the parameter, `prior` its frozen SciPy distribution or, if known, a number.
    At `null` it changes nothing. `is_scale_free` says that it adds a shift, or multiplies sds by
    a factor that depends on its column and not on the stimuli: pairs of stimuli that are alike by
    Weber's law stay so, and the fit is quicker.
    """

    name: str
    prior: rv_frozen | float | None
    null: ClassVar[float] = 0.0
    is_scale_free: ClassVar[bool] = False

    @property
    def typed(self) -> str:
        """The effect as it is typed, with its default prior."""
        return f"{type(self).__name__}()"

    @property
    def by_name(self) -> str:
        """The text by which `effect_named` knows the effect."""
        return self.name

    def bound(self, encodings: UnitEncodings, n: Array) -> Effect:
        """The effect with its scale taken from the stimuli of the table, `n` trials of each."""
        return self

    def column(self, trials: Trials, encoding: Encoding) -> Array | None:
        """What the effect depends on, a number a row; None where that is the stimuli alone.

        Curves and thresholds are those at 0. `simulate_trials` calls it before there are answers;
        an effect that follows the answer before derives from `TrialBefore`.
        """
        return None

    def apply(self, signals: Signals, value: Array, column: Array | float) -> Signals:
        """The signals with the effect, (..., C), for a parameter (..., 1)."""
        return signals


# One object each: the table of its quantiles is made once (see `priors.quantiles`).
_PRIORS = {
    "drift": stats.norm(0.0, 0.5),
    "bias_drift": stats.norm(0.0, 0.7),
    "overdispersion": stats.beta(1.0, 15.0),
    "contraction": stats.norm(0.0, 0.3),
    "noise_by_order": stats.norm(0.0, 0.7),
    "standard_second": stats.norm(0.0, 0.7),
    "exponent": stats.norm(1.0, 0.5),
    "session_bias": stats.halfnorm(scale=0.5),
    "shift": stats.norm(0.0, 0.5),
}


@dataclass(frozen=True, eq=False, repr=False)
class Drift(Effect, Fields):
    """A learning animal: ln k changes by `drift` from the first session to the last.

    Linear in the number of the session in its row. The Weber fraction is that in the middle of the
    course. Sessions that are not numbers go in the order in which they first appear in the table.

    Examples
    --------
    >>> from weberwhisk import simulate_trials
    >>> from weberwhisk.behaviour import IdentityEncoding
    >>> trials = simulate_trials(sessions=3, trials_per_level=1, seed=1)
    >>> Drift().column(trials, IdentityEncoding())
    array([-0.5, -0.5, -0.5,  0. ,  0. ,  0. ,  0.5,  0.5,  0.5])
    """

    prior: rv_frozen | float = _PRIORS["drift"]
    name: str = "drift"
    is_scale_free: ClassVar[bool] = True

    def column(self, trials: Trials, encoding: Encoding) -> Array:
        sessions, place = sessions_of(trials, "Drift")
        return np.asarray(place / (len(sessions) - 1) - 0.5)

    def apply(self, signals: Signals, value: Array, column: Array | float) -> Signals:
        factor = np.exp(value * column)
        return signals._replace(sd_1=signals.sd_1 * factor, sd_2=signals.sd_2 * factor)


@dataclass(frozen=True, eq=False, repr=False)
class BiasDrift(Effect, Fields):
    """A bias that drifts: it changes by `bias_drift` from the first trial to the last.

    Linear in the place of the row, in ten steps; in sds of the difference. The shared bias is
    that in the middle of the course.

    Examples
    --------
    >>> from weberwhisk import fit_weber, simulate_trials
    >>> trials = simulate_trials(effects=[(BiasDrift(), 1.5)], seed=1)
    >>> low, high = fit_weber(trials, effects=[BiasDrift()]).interval(parameter="bias_drift")
    >>> 0 < low < 1.5 < high
    True
    """

    prior: rv_frozen | float = _PRIORS["bias_drift"]
    name: str = "bias_drift"
    is_scale_free: ClassVar[bool] = True
    steps: ClassVar[int] = 10

    def column(self, trials: Trials, encoding: Encoding) -> Array:
        if not trials.task.has_bias:
            raise Refusal(
                f"{trials.task.name} has no response bias that could drift",
                remedy="leave BiasDrift out",
            )
        needs_rows(trials, "BiasDrift")
        place = np.arange(len(trials.frame)) / max(len(trials.frame), 1)
        return np.floor(self.steps * place) / (self.steps - 1) - 0.5

    def apply(self, signals: Signals, value: Array, column: Array | float) -> Signals:
        return signals._replace(shift=signals.shift + value * column)


@dataclass(frozen=True, eq=False, repr=False)
class Floor(Effect, Fields):
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


@dataclass(frozen=True, eq=False, repr=False)
class Exponent(Effect, Fields):
    """Noise that grows as a power of the signal: sd = k I₀ (I/I₀)^exponent; Weber's law is 1.

    I₀ is the table's typical signal (geometric mean) unless given, and the Weber fraction is that
    of such a signal; 0 is the same noise at every stimulus, ½ that of counts. Weber's law is also
    the middle of the prior, so that 0 and 2 are two sds away. At one standard the exponent is known
    from how lopsided the curve is, and then hardly apart from a bias.

    Examples
    --------
    >>> from weberwhisk import fit_weber, simulate_trials
    >>> trials = simulate_trials(standards=[1, 4, 16], effects=[(Exponent(), 1.5)], seed=1)
    >>> low, high = fit_weber(trials, effects=[Exponent()]).interval(parameter="exponent")
    >>> 1 < low < 1.5 < high
    True
    """

    prior: rv_frozen | float = _PRIORS["exponent"]
    name: str = "exponent"
    null: ClassVar[float] = 1.0
    typical: float | None = None

    def bound(self, encodings: UnitEncodings, n: Array) -> Exponent:
        typical = _typical(encodings, "An exponent of the noise")
        return self if self.typical is not None else replace(self, typical=typical)

    def relative(self, mean: Array | float) -> Array:
        """Signals over the typical one."""
        return np.abs(mean) / (1.0 if self.typical is None else self.typical)

    def apply(self, signals: Signals, value: Array, column: Array | float) -> Signals:
        power = np.asarray(value) - 1
        of_1, of_2 = (self.relative(mean) for mean in (signals.shown_1, signals.shown_2))
        return signals._replace(sd_1=signals.sd_1 * of_1**power, sd_2=signals.sd_2 * of_2**power)


@dataclass(frozen=True, eq=False, repr=False)
class NoiseByOrder(Effect, Fields):
    """The two intervals differ in noise: σ₁ e^(−v/2) and σ₂ e^(v/2), v = `noise_by_order`.

    v is ln of the noise of the second interval over that of the first, beyond what their stimuli
    make of it: negative where the first is blurred by waiting. The Weber fraction is the geometric
    mean of both. Answers depend on the sum of the two variances, so that it shows only where
    comparisons are several times their standards, or fractions of them.

    Examples
    --------
    >>> from weberwhisk import fit_weber, simulate_trials
    >>> trials = simulate_trials(order="random", effects=[(NoiseByOrder(), -1)], seed=1,
    ...                          offsets=[-0.5, -0.2, 0.2, 1.0], weber_fraction=0.3,
    ...                          trials_per_level=300)
    >>> low, high = fit_weber(trials, effects=[NoiseByOrder()]).interval(parameter="noise_by_order")
    >>> low < -1 < high < 0
    True
    """

    prior: rv_frozen | float = _PRIORS["noise_by_order"]
    name: str = "noise_by_order"

    def column(self, trials: Trials, encoding: Encoding) -> Array | None:
        needs_order(trials, "NoiseByOrder")
        return None

    def apply(self, signals: Signals, value: Array, column: Array | float) -> Signals:
        half = np.exp(0.5 * np.asarray(value))
        return signals._replace(sd_1=signals.sd_1 / half, sd_2=signals.sd_2 * half)


@dataclass(frozen=True, eq=False, repr=False)
class StandardSecond(Effect, Fields):
    """Noise that depends on whether the standard came second: ln k changes by `standard_second`.

    From k e^(−v/2) where the standard is stimulus 1 to k e^(v/2) where it is stimulus 2, as when a
    first stimulus is judged by those of earlier trials (the Type B effect of Bausenhart, Dyjas &
    Ulrich 2015). Pairs of equal stimuli lie between.

    Examples
    --------
    >>> from weberwhisk import fit_weber, simulate_trials
    >>> trials = simulate_trials(order="random", effects=[(StandardSecond(), 0.7)], seed=1)
    >>> fit = fit_weber(trials, effects=[StandardSecond()])
    >>> low, high = fit.interval(parameter="standard_second")
    >>> 0 < low < 0.7 < high
    True
    """

    prior: rv_frozen | float = _PRIORS["standard_second"]
    name: str = "standard_second"
    is_scale_free: ClassVar[bool] = True

    def column(self, trials: Trials, encoding: Encoding) -> Array:
        needs_order(trials, "StandardSecond")
        needs_standards(trials, "StandardSecond")
        standard, s1, s2 = (trials.frame[c].to_numpy(float) for c in STIMULI)
        column = 0.5 * ((s2 == standard).astype(float) - (s1 == standard))
        seen = column[trials.answered]
        if not (np.any(seen > 0) and np.any(seen < 0)):
            raise Refusal(
                f"{trials.source}: StandardSecond needs standards in either interval",
                "those of one alone",
                "leave it out",
            )
        return column

    def apply(self, signals: Signals, value: Array, column: Array | float) -> Signals:
        factor = np.exp(value * column)
        return signals._replace(sd_1=signals.sd_1 * factor, sd_2=signals.sd_2 * factor)


def is_possible(
    effect: Effect, trials: Trials, encoding: Encoding, encodings: UnitEncodings, n: Array
) -> bool:
    """Whether a table, with its pairs of stimuli and their trials, can show an effect."""
    try:
        effect.column(trials, encoding)
        effect.bound(encodings, n)
    except Refusal:
        return False
    return True


def _typical(encodings: UnitEncodings, what: str) -> float:
    """Geometric mean of the signals; refused where all are equally noisy."""
    sds = np.concatenate([encodings.sd_1, encodings.sd_2])
    means = np.abs(np.concatenate([encodings.mean_1, encodings.mean_2]))
    if not sds.size:
        return 1.0
    if np.ptp(sds) <= 1e-9 * sds.max() or np.any(means == 0):
        raise Refusal(
            f"{what} shows only where noise grows with the stimulus",
            "stimuli that are all equally noisy",
            "leave it out, or give more standards",
        )
    return float(np.exp(np.mean(np.log(means))))


@dataclass(frozen=True, eq=False, repr=False)
class Overdispersion(Effect, Fields):
    """Answers that scatter more than a coin's: beta-binomial, with intraclass correlation ρ.

    The probability of each pair of stimuli in each session is itself drawn from a beta distribution
    of mean P and variance ρ P (1 − P) (Fründ, Haenel & Wichmann 2011; Schütt et al. 2016). It
    touches the likelihood, not the signals.
    """

    prior: rv_frozen | float = _PRIORS["overdispersion"]
    name: str = "overdispersion"

    def column(self, trials: Trials, encoding: Encoding) -> Array | None:
        return None if not trials.sessions else sessions_of(trials, "")[1].astype(float)


@dataclass(frozen=True, eq=False, repr=False)
class SessionBias(Effect, Fields):
    """A bias of its own in every session: normal about the shared one, with sd `session_bias`.

    A random effect: the biases of the sessions are integrated out, so that they take no parameter
    each. `WeberFit.session_biases` has them. It touches the likelihood, not the signals; the unit
    is that of the bias, or of the criterion.

    Examples
    --------
    >>> from weberwhisk import fit_weber, simulate_trials
    >>> trials = simulate_trials(sessions=8, effects=[(SessionBias(), 0.5)], seed=1)
    >>> fit = fit_weber(trials, effects=[SessionBias()])
    >>> low, high = fit.interval(parameter="session_bias")
    >>> low < 0.5 < high, len(fit.session_biases())
    (True, 8)
    """

    prior: rv_frozen | float = _PRIORS["session_bias"]
    name: str = "session_bias"
    is_scale_free: ClassVar[bool] = True

    def column(self, trials: Trials, encoding: Encoding) -> Array:
        if not trials.task.has_bias:
            raise Refusal(
                f"{trials.task.name} has no response bias that sessions could differ in",
                remedy="leave SessionBias out",
            )
        return sessions_of(trials, "SessionBias")[1].astype(float)


@dataclass(frozen=True, eq=False, repr=False)
class Contraction(Effect, Fields):
    """The first signal drawn towards the mean of all stimuli: m₁ → m₁ + contraction · (M − m₁).

    Contraction bias (Ashourian & Loewenstein 2011; Akrami et al. 2018): a remembered signal drifts
    towards what is usual. 0 is none, 1 an observer that compares with the mean alone. M is the mean
    signal of the whole table, as for an animal that has known its stimuli for long.
    """

    prior: rv_frozen | float = _PRIORS["contraction"]
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
        return signals._replace(mean_1=signals.mean_1 + value * (self.centre - signals.mean_1))


class TrialBefore(Effect):
    """A shift, in sds of the difference, by what the trial before was.

    `shift` says by how much; the first trial of a session, and one after a trial that is not in the
    table, has none.

    Examples
    --------
    >>> class RewardBias(TrialBefore):  # a bias that is another after a rewarded trial
    ...     name, prior = "reward_bias", 0.3
    ...
    ...     def shift(self, answer, right):
    ...         return (answer * right > 0).astype(float)
    >>> from weberwhisk import simulate_trials
    >>> trials = simulate_trials(trials_per_level=1, effects=[(RewardBias(), 0.3)], seed=1)
    """

    is_scale_free: ClassVar[bool] = True

    def column(self, trials: Trials, encoding: Encoding) -> Array:
        needs_order(trials, type(self).__name__)
        needs_rows(trials, type(self).__name__)
        return self.after(trials, 2 * trials.frame["count"].to_numpy(float) - 1)

    def after(self, trials: Trials, answer: Array | float) -> Array:
        """The column, were these the answers: 1 the second, -1 the first, 0 or NaN none."""
        s1, s2 = (trials.frame[c].to_numpy(float) for c in ("stimulus_1", "stimulus_2"))
        given = np.nan_to_num(np.broadcast_to(answer, s1.shape))
        before = np.r_[0.0, self.shift(given, np.sign(s2 - s1))[:-1]]
        return np.where(trials.follows, before, 0.0)

    def shift(self, answer: Array, right: Array) -> Array:
        """How far each trial moves the next, positive towards the second.

        `answer` is 1 for the second, -1 for the first, 0 for none; `right` is the right one, 0 of
        two equal stimuli.
        """
        raise NotImplementedError

    def apply(self, signals: Signals, value: Array, column: Array | float) -> Signals:
        return signals._replace(shift=signals.shift + value * column)


@dataclass(frozen=True, eq=False, repr=False)
class History(TrialBefore, Fields):
    """A shift towards the answer given on the trial before; sds of the difference.

    Positive repeats answers, negative alternates. The first trial of a session, and one after a
    missing answer or after a trial that is not in the table, has none.
    """

    prior: rv_frozen | float = _PRIORS["shift"]
    name: str = "history"

    def shift(self, answer: Array, right: Array) -> Array:
        return answer


@dataclass(frozen=True, eq=False, repr=False)
class WinStay(TrialBefore, Fields):
    """A shift towards the stimulus that was right on the trial before; sds of the difference.

    Win-stay, lose-shift: a right answer is repeated and a wrong one changed, so that the next
    leans to the side that was right. Negative does the opposite. Trials that `History` leaves out
    have none, nor do trials after two equal stimuli.
    """

    prior: rv_frozen | float = _PRIORS["shift"]
    name: str = "win_stay"

    def shift(self, answer: Array, right: Array) -> Array:
        return np.where(answer == 0, 0.0, right)


@dataclass(frozen=True, eq=False, repr=False)
class Covariate(Effect, Fields):
    """What another column of the table does: `Covariate("laser")`.

    On the bias it is a shift in sds of the difference, on the Weber fraction a change of ln k. A
    column of two values counts as 0 for the first in order (0, False) and as 1 for the second; more
    numbers are centred and divided by their sd. The parameter has the column's name.

    Parameters
    ----------
    of : str
        A column of the table.
    on : {"bias", "weber_fraction"}
    prior : frozen SciPy distribution, or number, optional

    Examples
    --------
    >>> from weberwhisk import fit_weber, simulate_trials
    >>> trials = simulate_trials(sessions=2, seed=1)
    >>> fit_weber(trials, effects=[Covariate("session", on="weber_fraction")]).parameters[:2]
    ('weber_fraction', 'session')
    """

    of: str
    on: str = "bias"
    prior: rv_frozen | float = _PRIORS["shift"]
    is_scale_free: ClassVar[bool] = True

    def __post_init__(self) -> None:
        checks.one_of("on", self.on, ("bias", "weber_fraction"))

    @property
    def name(self) -> str:  # type: ignore[override]
        return self.of

    @property
    def typed(self) -> str:
        on = f", on={self.on!r}" if self.on != "bias" else ""
        return f"Covariate({self.of!r}{on})"

    @property
    def by_name(self) -> str:
        on = f":{self.on}" if self.on != "bias" else ""
        return f"covariate:{self.of}{on}"

    def column(self, trials: Trials, encoding: Encoding) -> Array:
        checks.one_of("the column of a Covariate", self.of, map(str, trials.frame.columns))
        if self.on == "bias" and not trials.task.has_bias:
            raise Refusal(
                f"{trials.task.name} has no response bias that {self.of!r} could move",
                remedy=(f"write ww.behaviour.effects.Covariate({self.of!r}, on='weber_fraction')"),
            )
        values = trials.frame[self.of]
        if values[trials.answered].isna().any():
            raise Refusal(
                f"{trials.source}, column {self.of!r}: empty in a trial with an answer",
                remedy="fill it, or remove the trial",
            )
        levels = sorted(set(values.dropna()), key=lambda v: (isinstance(v, str), v))
        if len(levels) == 2:
            return (values == levels[1]).to_numpy(float)
        numbers = pd.to_numeric(values, errors="coerce").to_numpy(float)
        if len(levels) < 2 or not np.isfinite(numbers[trials.answered]).all():
            raise Refusal(
                f"{trials.source}, column {self.of!r}: a Covariate has two values or is a number",
                checks.listed(levels),
                "choose trials with two, trials.select(...)",
            )
        numbers = np.where(np.isfinite(numbers), numbers, np.nanmean(numbers))
        return np.asarray((numbers - numbers.mean()) / numbers.std())

    def apply(self, signals: Signals, value: Array, column: Array | float) -> Signals:
        if self.on == "bias":
            return signals._replace(shift=signals.shift + value * column)
        factor = np.exp(value * column)
        return signals._replace(sd_1=signals.sd_1 * factor, sd_2=signals.sd_2 * factor)


EFFECTS: dict[str, Effect] = {
    effect.name: effect
    for effect in (
        Floor(), Exponent(), Contraction(), NoiseByOrder(), StandardSecond(), History(),
        WinStay(), Drift(), SessionBias(), BiasDrift(), Overdispersion(),
    )
}  # fmt: skip


def is_formula(effect: object) -> bool:
    """Whether an effect is written as a formula, such as `k ~ condition`."""
    return isinstance(effect, str) and "~" in effect


def check_effects(effects: Any) -> None:
    """Refuses what is not a sequence of effects, with what to write instead."""
    if isinstance(effects, str) or not isinstance(effects, Sequence):
        raise Refusal(
            named("effects") + " must be a sequence",
            checks.shown(effects),
            "write effects=[Drift()], say, with Drift from weberwhisk.behaviour.effects",
        )
    for effect in effects:
        if is_formula(effect):
            continue
        usual = EFFECTS.get(effect) if isinstance(effect, str) else None
        instead = type(usual).__name__ if usual else getattr(effect, "__name__", "Drift")
        checks.kind(
            "an effect", effect, "an Effect", "apply",
            f"write {instead}(), from weberwhisk.behaviour.effects",
        )  # fmt: skip


def check_valued(effects: Any) -> None:
    """Refuses what is not a sequence of effects with their values."""
    hint = "write effects=[(Contraction(), 0.2)], from weberwhisk.behaviour.effects"
    try:
        pairs = [(effect, value) for effect, value in effects]
    except (TypeError, ValueError):
        raise Refusal(
            "effects must be pairs of an effect and its value", checks.shown(effects), hint
        ) from None
    check_effects([effect for effect, _ in pairs])
    for effect, value in pairs:
        named_so = effect if is_formula(effect) else effect.name
        values = checks.finite(f"the value of {named_so}", value, hint)
        if isinstance(effect, Overdispersion) and not np.all((values > 0) & (values < 1)):
            raise Refusal(
                "overdispersion must lie between 0 and 1", checks.shown(value), "write 0.05, say"
            )
        if isinstance(effect, SessionBias) and np.any(values < 0):
            raise Refusal(
                "session_bias is an sd and must not be below 0", checks.shown(value), "write 0.3"
            )


def effect_named(name: str) -> Effect | str:
    """An effect by its name, with the prior that it brings; a formula as it is.

    `covariate:laser` is that of a column on the bias, `covariate:laser:weber_fraction` on k.

    Raises
    ------
    ValueError
        For an unknown name, with the nearest one.

    Examples
    --------
    >>> effect_named("drift").prior.std()
    np.float64(0.5)
    """
    if is_formula(name):
        return name
    kind, _, column = name.partition(":")
    if kind == "covariate":
        if not column:
            raise Refusal("covariate names no column", remedy="write covariate:laser, say")
        of, _, on = column.partition(":")
        return Covariate(of, on or "bias")
    return EFFECTS[checks.one_of("effect", name, EFFECTS)]


def effect_valued(text: str) -> tuple[Effect | str, float]:
    """An effect by its name with the value of its parameter after a colon.

    Raises
    ------
    ValueError
        For an unknown name, and a value that is no number.

    Examples
    --------
    >>> effect_valued("history:0.3")[1]
    0.3
    """
    name, _, value = text.rpartition(":")
    start = text if name in ("", "covariate") else name
    number = checks.number("the value of an effect", value, f"write {start}:0.3, say")
    return effect_named(name or text), number
