"""What moves an animal's answers: each effect as written by hand, and found where it is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray
from scipy import stats
from scipy.special import ndtr
from short_forms import slow_but

from weberwhisk import Observer, Whisker
from weberwhisk.behaviour import (
    FitStatus,
    IdentityEncoding,
    Trials,
    compare,
    fit_weber,
    read_trials,
    simulate_trials,
    task_named,
)
from weberwhisk.behaviour.effects import (
    EFFECTS,
    BiasDrift,
    Contraction,
    Drift,
    Effect,
    Exponent,
    Floor,
    History,
    NoiseByOrder,
    Overdispersion,
    SessionBias,
    StandardSecond,
    TrialBefore,
    WinStay,
)
from weberwhisk.behaviour.encodings import NOISES, Encoding, Signals
from weberwhisk.behaviour.likelihood import WeberModel, build_model
from weberwhisk.behaviour.predictive import checks
from weberwhisk.cues import Compliance

Array = NDArray[np.float64]
K, LOW, HIGH, BIAS = 0.12, 0.02, 0.03, 0.1
SESSIONS = 5


def design(seed: int, trials: int = 900) -> pd.DataFrame:
    """Three standards that take turns between the intervals, in sessions; no answers yet."""
    rng = np.random.default_rng(seed)
    standard = rng.choice([1.0, 2.0, 4.0], trials)
    other = np.round(standard * rng.choice([0.7, 0.85, 1.0, 1.2, 1.4], trials), 6)
    first = rng.random(trials) < 0.5
    return pd.DataFrame(
        {
            "session": np.sort(np.arange(trials) % SESSIONS) + 1,
            "standard": standard,
            "stimulus_1": np.where(first, standard, other),
            "stimulus_2": np.where(first, other, standard),
            "comparison": other,
        }
    )


def by_hand(name: str, value: float, f: pd.DataFrame, before: Array, k: float = K) -> Array:
    """P(second greater) with an effect, written out; `before` is the last answer, −1, 0 or 1."""
    s1, s2 = f["stimulus_1"].to_numpy(), f["stimulus_2"].to_numpy()
    m1, sd1, sd2, push = s1, k * s1, k * s2, 0.0
    session = f["session"].to_numpy()
    match name:
        case "floor":
            sd1, sd2 = np.hypot(sd1, value), np.hypot(sd2, value)
        case "exponent":
            pairs = f[["standard", "stimulus_1", "stimulus_2"]].drop_duplicates()
            middle = np.exp(np.log(pairs[["stimulus_1", "stimulus_2"]].to_numpy()).mean())
            sd1, sd2 = (k * middle * (s / middle) ** value for s in (s1, s2))
        case "noise_by_order":
            sd1, sd2 = k * s1 * np.exp(-value / 2), k * s2 * np.exp(value / 2)
        case "contraction":
            m1 = s1 + value * (np.mean([s1, s2]) - s1)
        case "standard_second":
            second = np.where(s2 == f["standard"], 0.5, 0.0) - np.where(
                s1 == f["standard"], 0.5, 0.0
            )
            sd1, sd2 = sd1 * np.exp(value * second), sd2 * np.exp(value * second)
        case "history":
            push = value * before
        case "win_stay":
            push = value * np.abs(before) * np.r_[0.0, np.sign(s2 - s1)[:-1]]
        case "drift":
            factor = np.exp(value * ((session - 1) / (SESSIONS - 1) - 0.5))
            sd1, sd2 = sd1 * factor, sd2 * factor
        case "bias_drift":
            push = value * (np.floor(10 * np.arange(len(f)) / len(f)) / 9 - 0.5)
    z = (s2 - m1) / np.hypot(sd1, sd2) + push + BIAS
    return np.asarray(LOW + (1 - LOW - HIGH) * ndtr(z))


def answered(name: str, value: float, seed: int, trials: int = 900) -> Trials:
    """Choices of an observer with one effect, made by hand."""
    f = design(seed, trials)
    u = np.random.default_rng(seed + 1).random(len(f))
    if name not in ("history", "win_stay"):
        choice = (u < by_hand(name, value, f, np.zeros(len(f)))).astype(int)
        return read_trials(f.drop(columns="comparison").assign(choice=choice))
    given = [by_hand(name, value, f, np.full(len(f), b)) for b in (-1.0, 0.0, 1.0)]
    choice, last = np.zeros(len(f), dtype=int), 0
    for i in range(len(f)):
        if i == 0 or f["session"].iloc[i] != f["session"].iloc[i - 1]:
            last = 0
        choice[i] = u[i] < given[last + 1][i]
        last = 2 * choice[i] - 1
    return read_trials(f.drop(columns="comparison").assign(choice=choice))


CASES: dict[str, tuple[Effect, float]] = {
    "floor": (Floor(), 0.3),
    "exponent": (Exponent(), 1.5),
    "noise_by_order": (NoiseByOrder(), -0.8),
    "contraction": (Contraction(), 0.2),
    "standard_second": (StandardSecond(), 0.6),
    "history": (History(), 0.6),
    "win_stay": (WinStay(), 0.6),
    "drift": (Drift(), -1.0),
    "bias_drift": (BiasDrift(), 1.0),
}


def test_every_effect_is_written_by_hand() -> None:
    assert CASES.keys() | {"overdispersion", "session_bias"} == EFFECTS.keys()


def model_of(trials: Trials, effect: Effect) -> WeberModel:
    return build_model(trials, None, None, "shared", "weber", None, [effect])[0]


@pytest.mark.parametrize("name", CASES)
def test_the_likelihood_is_the_observer_written_out(name: str) -> None:
    effect, value = CASES[name]
    trials = answered(name, value, seed=11)
    f, choice = trials.frame, trials.frame["count"].to_numpy(float)
    f = f.assign(
        comparison=np.where(f["stimulus_1"] == f["standard"], f["stimulus_2"], f["stimulus_1"])
    )
    before = np.where(f["session"] == f["session"].shift(1), 2 * f["count"].shift(1) - 1, 0.0)
    p = by_hand(name, value, f, before)
    exact = np.sum(choice * np.log(p) + (1 - choice) * np.log(1 - p))
    one = np.array([K]), np.array([LOW]), np.array([HIGH]), np.array([[BIAS]]), np.array([[value]])
    assert model_of(trials, effect).log_likelihood(*one)[0] == pytest.approx(exact, abs=1e-7)


@pytest.mark.parametrize("name", slow_but(CASES, (1,)))
def test_an_effect_is_found_where_it_is(name: str) -> None:
    effect, value = CASES[name]
    # Lapses known: one dimension less at a time is enough for a test that always runs.
    known = {"lapse_low": LOW, "lapse_high": HIGH}
    trials = answered(name, value, seed=13, trials=3000)
    fit = fit_weber(trials, effects=[effect], priors=known)
    low, high = fit.interval(0.99, parameter=name)
    assert low < value < high
    if name == "noise_by_order":  # nothing to be seen of it at this k, so that its belief decides
        assert fit.status is FitStatus.PRIOR_DEPENDENT
        assert fit.prior_sensitivity["sds"].idxmax() == name
    else:
        assert fit.status is FitStatus.DETERMINED
        assert not low < (1 if name == "exponent" else 0) < high
    low, high = fit.interval(0.99)
    assert low < K < high
    assert fit.effects == (name,)
    assert name in fit.report()


WIDE = {
    "weber_fraction": 0.3, "offsets": [-0.6, -0.4, -0.2, 0.0, 0.3, 0.7, 1.5], "order": "random",
    "trials_per_level": 200,
}  # fmt: skip


def test_noise_by_order_shows_in_wide_comparisons() -> None:
    trials = simulate_trials(**WIDE, effects=[(NoiseByOrder(), -1.5)], seed=4)  # type: ignore[arg-type]
    plain, fit = fit_weber(trials), fit_weber(trials, effects=[NoiseByOrder()])
    assert plain.log_evidence is not None
    assert fit.log_evidence is not None
    assert fit.log_evidence > plain.log_evidence + 3
    low, high = fit.interval(0.99, "noise_by_order")
    assert low < -1.5 < high < 0


# -- overdispersion -------------------------------------------------------------------------------


def scattered(seed: int, rho: float, sessions: int = 3, n: int = 11) -> Trials:
    """Counts of nine levels whose P is drawn anew in every session."""
    rng = np.random.default_rng(seed)
    s2 = 1 + np.linspace(-0.3, 0.3, 9)
    mean = 0.02 + 0.96 * ndtr((s2 - 1) / np.hypot(1, s2) / 0.1)
    rows = []
    for session in range(sessions):
        p = rng.beta(mean * (1 - rho) / rho, (1 - mean) * (1 - rho) / rho)
        rows.append(
            pd.DataFrame(
                {"session": session + 1, "standard": 1.0, "comparison": s2, "n": n,
                 "n_greater": rng.binomial(n, p)}
            )
        )  # fmt: skip
    return read_trials(pd.concat(rows, ignore_index=True))


def test_the_beta_binomial_is_scipys() -> None:
    trials = scattered(21, 0.1)
    model = model_of(trials, Overdispersion())
    p, rho = np.full(model.cells.n.size, 0.3), 0.08
    size = (1 - rho) / rho
    n, x = model.cells.n, model.cells.count
    exact = stats.betabinom(n, p * size, (1 - p) * size).logpmf(x)
    exact -= stats.binom(n, 0.5).logpmf(x) + n * np.log(2)  # without the binomial coefficient
    np.testing.assert_allclose(model.beta_binomial(p, 1 - p, np.array(rho)), exact, atol=1e-9)
    # At ρ = 0 it is the binomial, but for 1e-7 · Σ i/P that keeps log-gammas their digits.
    plain = x * np.log(p) + (n - x) * np.log(1 - p)
    np.testing.assert_allclose(model.beta_binomial(p, 1 - p, np.array(0.0)), plain, atol=2e-5)


def test_overdispersion_by_brute_force() -> None:
    """k and ρ on an even grid, the rest known: medians, ends and evidence."""
    trials = scattered(22, 0.1)
    known: dict[str, Any] = {"lapse_low": 0.02, "lapse_high": 0.02, "bias": 0.0}
    fit = fit_weber(trials, effects=[Overdispersion()], priors=known)
    c = trials.frame
    s2, n, x = (c[name].to_numpy(float) for name in ("stimulus_2", "n", "count"))
    ln_k, rho = np.linspace(np.log(0.02), np.log(0.5), 201), (np.arange(400) + 0.5) / 800
    p = 0.02 + 0.96 * ndtr((s2 - 1) / np.hypot(1, s2) / np.exp(ln_k)[:, None])
    size = ((1 - rho) / rho)[:, None, None]
    log_like = stats.betabinom(n, p * size, (1 - p) * size).logpmf(x)
    log_like -= stats.binom(n, 0.5).logpmf(x) + n * np.log(2)
    log_post = log_like.sum(axis=-1) + stats.beta(1, 15).logpdf(rho)[:, None]
    log_post += stats.norm.logpdf(ln_k, np.log(0.1), np.log(3))
    weight = np.exp(log_post - log_post.max())
    for name, axis, values in (
        ("weber_fraction", 0, np.exp(ln_k)),
        ("overdispersion", 1, rho),
    ):
        m = weight.sum(axis=axis)
        cdf = (np.cumsum(m) - 0.5 * m) / m.sum()
        at = [0.025, 0.5, 0.975]
        exact = np.interp(at, cdf, values)
        np.testing.assert_allclose(fit.posterior.quantile(name, at), exact, rtol=0.01, atol=2e-4)
    evidence = np.log(weight.sum() * (ln_k[1] - ln_k[0]) * (rho[1] - rho[0])) + log_post.max()
    assert fit.log_evidence == pytest.approx(evidence, abs=0.01)


def coverage(count: int) -> tuple[int, int]:
    """How many 95 % intervals cover with the effect and without; lapses known."""
    known: dict[str, Any] = {"lapse_low": 0.02, "lapse_high": 0.02}
    covered = [0, 0]
    for seed in range(count):
        trials = scattered(1000 + seed, 0.05, sessions=1, n=33)
        for i, effects in enumerate(([Overdispersion()], [])):
            low, high = fit_weber(trials, effects=effects, priors=known).interval()
            covered[i] += low < 0.1 < high
    return covered[0], covered[1]


@pytest.mark.slow  # of coverage: `tests/atlas/test_coverage.py`
def test_scatter_widens_the_interval() -> None:
    with_it, _ = coverage(12)
    assert with_it >= 9  # fewer once in 500 at 95 %


@pytest.mark.slow
def test_coverage_with_overdispersion() -> None:
    with_it, without = coverage(400)
    assert with_it >= 0.92 * 400
    assert without < 0.92 * 400


# -- biases by session ----------------------------------------------------------------------------


def of_sessions(trials: Trials, at: dict[str, float]) -> float:
    """Log-probability of all answers, the deviation of each session summed over an even grid."""
    number = np.linspace(-9.0, 9.0, 4001)
    step, total = number[1] - number[0], 0.0
    for _, part in trials.frame.groupby("session"):
        s1, s2, count = (part[c].to_numpy(float) for c in ("stimulus_1", "stimulus_2", "count"))
        d = (s2 - s1) / (at["k"] * np.hypot(s1, s2)) + at["bias"]
        p = LOW + (1 - LOW - HIGH) * ndtr(d + at["sd"] * number[:, None])
        log = stats.norm.logpdf(number) + np.log(np.where(count == 1, p, 1 - p)).sum(axis=1)
        total += np.logaddexp.reduce(log) + np.log(step)
    return float(total)


@pytest.mark.parametrize("sd", [0.0, 0.05, 0.3, 0.8, 3.0])
@pytest.mark.parametrize(("k", "bias"), [(0.06, -0.4), (0.12, 0.1), (0.4, 0.6)])
def test_biases_of_sessions_are_integrated_out(sd: float, k: float, bias: float) -> None:
    trials = simulate_trials(
        weber_fraction=K, bias=BIAS, lapse_low=LOW, lapse_high=HIGH, sessions=5,
        effects=[(SessionBias(), 0.8)], seed=51,
    )  # fmt: skip
    model = model_of(trials, SessionBias())
    one = np.array([k]), np.array([LOW]), np.array([HIGH]), np.array([[bias]]), np.array([[sd]])
    exact = of_sessions(trials, {"k": k, "bias": bias, "sd": sd})
    assert model.log_likelihood(*one)[0] == pytest.approx(exact, abs=2e-3)


def test_the_bias_of_a_session_is_that_of_a_fit_of_it_alone() -> None:
    """Where sessions are long they determine their biases, and the sd between them little else."""
    trials = simulate_trials(
        weber_fraction=K, sessions=4, effects=[(SessionBias(), 0.7)], trials_per_level=400, seed=52
    )
    known = {"weber_fraction": K, "lapse_low": 0.0, "lapse_high": 0.0}
    wide = stats.halfnorm(scale=10.0)
    fit = fit_weber(trials, effects=[SessionBias(wide)], priors=known)
    table = fit.session_biases()
    for session, bias, low, high in table.itertuples(index=False):
        alone = fit_weber(trials.select(session=session), priors=known)
        assert bias == pytest.approx(alone.posterior.mean("bias"), abs=0.01)
        ends = alone.interval(parameter="bias")
        np.testing.assert_allclose([low, high], ends, atol=0.03)
    low, high = fit.interval(0.99, "session_bias")
    assert low < table["bias"].std() < high
    assert low > 0.1
    with pytest.raises(ValueError, match=r"same in all sessions.*SessionBias"):
        fit_weber(trials).session_biases()
    with pytest.raises(ValueError, match=r"states.*one bias for all sessions"):
        fit_weber(trials, effects=[SessionBias()], states=3)


@pytest.mark.slow  # of session_bias: the bias of a session, and `test_causes.py`
def test_sessions_of_a_known_case_differ_in_bias_and_k_stays() -> None:
    """Ten sessions whose biases have an sd of 0.5, k 0.13 (drawn: 0.28 and 0.120)."""
    rng = np.random.default_rng(0)
    parts = []
    for session in range(1, 11):
        b, s2 = rng.normal(0, 0.5), rng.choice([70, 80, 90, 95, 105, 110, 125, 140], 200)
        p = 0.02 + 0.96 * ndtr((s2 - 100) / (0.13 * np.hypot(100, s2)) + b)
        choice = (rng.random(200) < p).astype(int)
        columns = {"stimulus_1": 100, "stimulus_2": s2, "choice": choice}
        labels = {"session": session, "trial": np.arange(1, 201)}
        parts.append(pd.DataFrame(labels | columns))
    trials = read_trials(pd.concat(parts, ignore_index=True))
    plain, fit = fit_weber(trials), fit_weber(trials, effects=[SessionBias()])
    assert fit.status is FitStatus.DETERMINED
    assert plain.log_evidence is not None
    assert fit.log_evidence is not None
    assert fit.log_evidence - plain.log_evidence == pytest.approx(11.6, abs=0.1)
    assert fit.weber_fraction == pytest.approx(0.120, abs=0.001)
    assert checks(fit)["p"].min() > 0.01
    left_out = compare({"plain": plain, "sessions": fit}).table["elpd"]
    assert 5 < left_out["sessions"] - left_out["plain"] < 40


# -- noise that does not grow ---------------------------------------------------------------------


def test_constant_noise_is_the_same_at_every_stimulus() -> None:
    trials = simulate_trials(
        standards=[1.0, 2.0, 4.0], weber_fraction=0.2, noise="constant", trials_per_level=100,
        seed=61,
    )  # fmt: skip
    model = build_model(trials, None, None, "shared", "constant", None)[0]
    cells = model.cells
    typical = np.exp(np.log(np.r_[cells.stimulus_1, cells.stimulus_2]).mean())
    z = (cells.stimulus_2 - cells.stimulus_1) / (0.2 * typical * np.sqrt(2))
    p = ndtr(z)
    exact = np.sum(cells.count * np.log(p) + (cells.n - cells.count) * np.log(1 - p))
    one, none = np.array([0.2]), np.array([0.0])
    assert model.log_likelihood(one, none, none, np.array([[0.0]]))[0] == pytest.approx(exact)
    fits = {noise: fit_weber(trials, noise=noise) for noise in NOISES}
    best = max(fits, key=lambda noise: fits[noise].log_evidence or 0.0)
    assert best == "constant"
    low, high = fits["constant"].interval(0.99)
    assert low < 0.2 < high
    exponent = fit_weber(trials, effects=[Exponent()]).interval(0.99, "exponent")
    assert exponent[0] < 0 < exponent[1] < 0.5
    at = fits["constant"].threshold(4.0)["difference"].iloc[0]
    assert at == pytest.approx(fits["constant"].threshold(1.0)["difference"].iloc[0])
    with pytest.raises(ValueError, match="noise grows with the stimulus"):
        fit_weber(trials, effects=[Exponent()], noise="constant")


def test_constant_noise_of_distances_keeps_their_unit() -> None:
    observer = Observer(Whisker.from_identity("C2"), Compliance())
    given: dict[str, Any] = {"observer": observer, "noise": "constant"}
    trials = simulate_trials(standards=[0.015, 0.02], trials_per_level=5, seed=1, **given)
    fit = fit_weber(trials, **given)
    assert fit.stimulus_unit == fit_weber(trials, observer=observer).stimulus_unit == "m"
    assert "the same noise at every stimulus" in fit.methods()


# -- the other tasks ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("task", "criterion"),
    slow_but([("yes/no", 0.4), ("go/no-go", 0.4), ("same-different", 1.2)], (0, 2)),
)
def test_tasks_with_a_criterion_by_hand_and_back(task: str, criterion: float) -> None:
    trials = simulate_trials(
        task=task, bias=criterion, weber_fraction=K, lapse_low=LOW, lapse_high=HIGH,
        trials_per_level=300, seed=31,
    )  # fmt: skip
    c = trials.cells()
    s1, s2 = c.stimulus_1, c.stimulus_2
    if task == "same-different":
        spread = K * np.hypot(s1, s2)
        edge = criterion * np.sqrt(2) * K * s1
        chance = ndtr((s2 - s1 - edge) / spread) + ndtr((s1 - s2 - edge) / spread)
    else:
        chance = ndtr((s2 - s1 - criterion * K * s1) / (K * s2))
    p = LOW + (1 - LOW - HIGH) * chance
    assert np.all(np.abs(c.count / c.n - p) < 4 * np.sqrt(p * (1 - p) / c.n))
    fit = fit_weber(trials)
    assert "criterion" in fit.parameters
    for name, truth in (("weber_fraction", K), ("criterion", criterion)):
        low, high = fit.interval(0.99, parameter=name)
        assert low < truth < high
    assert task.split("-")[0] in fit.threshold()["criterion"].iloc[0]


# -- misuse ---------------------------------------------------------------------------------------


def test_effects_that_cannot_show_are_refused() -> None:
    plain = simulate_trials(trials_per_level=5, seed=41)
    correct = simulate_trials(task="2AFC percent correct", trials_per_level=5, seed=42)
    counts = read_trials(
        pd.DataFrame({"standard": 1.0, "comparison": [0.9, 1.1], "n": 9, "n_greater": [3, 6]})
    )
    with pytest.raises(ValueError, match="needs two sessions or more, got 1"):
        fit_weber(plain, effects=[Drift()])
    with pytest.raises(ValueError, match="which interval held which"):
        fit_weber(correct, effects=[Contraction()])
    with pytest.raises(ValueError, match="History needs a row a trial"):
        fit_weber(counts, effects=[History()])
    with pytest.raises(ValueError, match="effects must differ"):
        fit_weber(simulate_trials(sessions=2, seed=43), effects=[Drift(), Drift()])
    with pytest.raises(ValueError, match="noise grows with the stimulus"):
        fit_weber(counts, effects=[Floor()], noise="equal-variance")
    assert task_named("same-different").bias_name == "criterion"


def test_what_goes_by_the_trial_before_needs_trials_in_their_order() -> None:
    trials = simulate_trials(sessions=2, trials_per_level=10, seed=1)
    table, effect = trials.table(), History()
    effect.column(read_trials(table), IdentityEncoding())
    torn = pd.concat([table[5:], table[:5]])  # the first session comes back
    by_level = table.sort_values("stimulus_2")
    for numbered in (by_level, torn):  # put in their order when they are read
        column = effect.column(read_trials(numbered), IdentityEncoding())
        assert column.tolist() == effect.column(trials, IdentityEncoding()).tolist()
    unnumbered = (torn.drop(columns="trial"), by_level.drop(columns=["trial", "session"]))
    for disordered in (read_trials(by_level, in_order=False), *map(read_trials, unnumbered)):
        with pytest.raises(ValueError, match="sort by session and trial"):
            effect.column(disordered, IdentityEncoding())
    fit = fit_weber(read_trials(table.sort_values(["session", "stimulus_2"]), in_order=False))
    assert "repetition" in checks(fit_weber(trials)).index
    assert {"trend", "repetition"}.isdisjoint(checks(fit).index)


def test_a_trial_that_is_not_in_the_table_leaves_no_history() -> None:
    """Of one standard of three the trial before in the table was taken for the one before."""
    trials = simulate_trials(
        standards=[1.0, 2.0, 4.0], trials_per_level=20, effects=[(History(), 1.0)], seed=2
    )
    some = trials.select(standard=1.0)
    column = History().column(some, IdentityEncoding())
    whole = History().column(trials, IdentityEncoding())
    own = whole[trials.frame["standard"] == 1.0]
    after = some.frame["trial"].diff() == 1
    assert column[after].tolist() == own[after].tolist()
    assert not column[~after].any()


@dataclass(frozen=True, eq=False)
class RewardBias(TrialBefore):
    """A bias that is another after a rewarded trial."""

    prior: Any = stats.norm(0.0, 0.5)  # noqa: RUF009
    name: str = "reward_bias"

    def shift(self, answer: Array, right: Array) -> Array:
        return (answer * right > 0).astype(float)


@pytest.mark.parametrize("effect", [History(), WinStay(), RewardBias()], ids=lambda e: e.name)
def test_what_goes_by_the_trial_before_is_simulated_as_it_is_fitted(effect: Effect) -> None:
    trials = simulate_trials(
        weber_fraction=K, standards=[1.0, 2.0], sessions=4, trials_per_level=300, missing=0.05,
        effects=[(effect, 0.7)], seed=5,
    )  # fmt: skip
    known: dict[str, Any] = {"weber_fraction": K, "lapse_low": 0.0, "lapse_high": 0.0}
    low, high = fit_weber(trials, effects=[effect], priors=known).interval(0.99, effect.name)
    assert 0 < low < 0.7 < high
    before = 2 * trials.frame["count"].shift(1) - 1
    right = np.sign(trials.frame["stimulus_2"] - trials.frame["stimulus_1"]).shift(1)
    by_hand = {"history": before, "win_stay": right * before**2, "reward_bias": before * right > 0}
    same = trials.frame["session"] == trials.frame["session"].shift(1)
    expected = np.where(same, by_hand[effect.name].astype(float).fillna(0.0), 0.0)
    np.testing.assert_array_equal(effect.column(trials, IdentityEncoding()), expected)


def test_a_fit_with_effects_of_which_all_is_given_is_its_likelihood() -> None:
    trials = simulate_trials(trials_per_level=20, effects=[(History(), 0.4)], seed=1)
    given = {"weber_fraction": 0.1, "lapse_low": 0.02, "lapse_high": 0.02, "bias": 0.1}
    plain = fit_weber(trials, priors=given)
    fit = fit_weber(trials, effects=[History()], priors=given | {"history": 0.0})
    assert fit.status is FitStatus.GIVEN
    assert fit.log_evidence == pytest.approx(plain.log_evidence, abs=1e-9)
    assert fit.posterior.mode() == {}
    with pytest.raises(ValueError, match="every parameter is fixed"):
        fit_weber(trials, effects=[History()], priors=given | {"history": 0.0}, method="emcee")


TREND = stats.norm(0.0, 0.5)


@dataclass(frozen=True, eq=False)
class BiasTrend(Effect):
    """An effect as `docs/howto/own_effect.md` writes it."""

    prior: Any = TREND
    name: str = "bias_trend"

    def column(self, trials: Trials, encoding: Encoding) -> Array:
        place = trials.frame.groupby("session")["trial"].rank(pct=True).to_numpy()
        return np.ceil(4 * place - 1) / 3 - 0.5

    def apply(self, signals: Signals, value: Array, column: Array | float) -> Signals:
        return signals._replace(shift=signals.shift + value * column)


def test_an_effect_of_ones_own_is_simulated_and_found() -> None:
    effect = BiasTrend()
    trials = simulate_trials(
        weber_fraction=0.2, effects=[(effect, 0.8)], sessions=4, trials_per_level=200, seed=3
    )
    known = {"lapse_low": 0.0, "lapse_high": 0.0}
    low, high = fit_weber(trials, effects=[effect], priors=known).interval(0.99, effect.name)
    assert 0 < low < 0.8 < high
