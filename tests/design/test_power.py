"""Power: against a brute-force simulation that shares no code, against the fits that will be made,
and against what a search with Monte Carlo error may claim."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.special import logsumexp, ndtr, roots_jacobi
from scipy.stats import beta, lognorm, norm
from short_forms import slow_but

import weberwhisk as ww
from weberwhisk.behaviour import States, Trials, fit_population, fit_weber, task_named
from weberwhisk.behaviour.encodings import IdentityEncoding
from weberwhisk.behaviour.priors import SPREAD
from weberwhisk.design import (
    Constraints,
    Evidence,
    Hypothesis,
    Plan,
    Precision,
    Scheme,
    SubjectPopulation,
    cues,
    lattice,
    noises,
    power_analysis,
    taper,
    trial_lists,
    with_priors,
)
from weberwhisk.design.power_analysis import Power, smallest
from weberwhisk.design.scheme import sized
from weberwhisk.design.simulation import compare, fit, simulate

WHISKER = ww.Whisker(50e-3, 100e-6, 5e-6)
TAPERED, CYLINDRICAL = taper(WHISKER)
#: One animal as it is, no two alike in nothing.
ALIKE = SubjectPopulation(0.1, spread=0.0, lapse=0.03, bias_spread=0.0, lapses_vary=False)
LENGTH, APEX = 50e-3, 50e-3 / (1 - 1 / 20)


def design(places, trials):
    """The issue's own: ±0.6, 1.2, 2.0 sd of the tapered prediction."""
    levels = [-2.0, -1.2, -0.6, 0.6, 1.2, 2.0]
    at = np.multiply(places, LENGTH)
    return Scheme.spaced(TAPERED.encoding, at, levels=levels, trials=trials)


# -- a referee that shares no code with the package ----------------------------------------------

PLAIN = {"lapse_low": beta(1, 19), "lapse_high": beta(1, 19), "lapse_correlation": 0.0,
         "bias": norm(0, 1)}  # fmt: skip


def plain_experiments(places, trials, truth, runs, rng):
    """Counts, one (runs, 6) for each standard, and the decision variables of both models."""
    z = np.array([-2.0, -1.2, -0.6, 0.6, 1.2, 2.0])
    counts, scores = [], []
    for r in np.multiply(places, LENGTH):
        c = r + z * 0.1 * np.sqrt(2) * r * (1 - r / APEX)
        both = {}
        for name, far in (("tapered", APEX), ("cylindrical", np.inf)):
            m0, m1 = 1 / r - 1 / far, 1 / c - 1 / far  # moment of a tap; its noise is k m
            both[name] = (m0 - m1) / np.sqrt(m0**2 + m1**2)
        scores.append(both)
        p = 0.03 + 0.94 * ndtr(both[truth] / 0.1)
        counts.append(rng.binomial(trials, p, size=(runs, 6)))
    return counts, scores


def plain_evidence(counts, scores, name, trials):
    """Log evidence of each run: sums over even ln k and PSE, Gauss–Jacobi over the lapses."""
    log_k = np.arange(-7.0, 1.5, 0.14)
    x, w = roots_jacobi(11, 18.0, 0.0)  # the density of Beta(1, 19) on 0 to 1
    lapse, w = (x + 1) / 2, w / w.sum()
    lo, hi = (a.ravel() for a in np.meshgrid(lapse, lapse))
    log_w = np.log(np.outer(w, w)).ravel() + norm(np.log(0.1), np.log(3)).logpdf(log_k)[:, None]
    pse = np.arange(-4.5, 4.6, 0.2)
    log_pse = norm.logpdf(pse) + np.log(0.2)
    total = np.zeros((len(counts[0]), log_k.size, lo.size))
    for n_up, both in zip(counts, scores, strict=True):
        up = ndtr(both[name] / np.exp(log_k)[:, None, None] + pse[:, None])  # (K, B, 6)
        for i in range(lo.size):
            p = lo[i] + (1 - lo[i] - hi[i]) * up
            like = np.tensordot(n_up, np.log(p), (1, 2))
            like += np.tensordot(trials - n_up, np.log1p(-p), (1, 2))
            total[:, :, i] += logsumexp(like + log_pse, axis=2)
    return logsumexp((total + log_w).reshape(len(total), -1), axis=1) + np.log(0.14)


def brute_force(places, trials, truth, runs, seed):
    """Log Bayes factors of the truth, and the counts."""
    other = {"tapered": "cylindrical", "cylindrical": "tapered"}[truth]
    counts, scores = plain_experiments(places, trials, truth, runs, np.random.default_rng(seed))
    evidence = [plain_evidence(counts, scores, name, trials) for name in (truth, other)]
    return evidence[0] - evidence[1], np.concatenate(counts, axis=1)[:, None].astype(float)


def check_brute_force(places, trials, truth, runs, others=1024):
    hypotheses = with_priors((TAPERED, CYLINDRICAL), **PLAIN)
    scheme = design(places, trials)
    plain, counts = brute_force(places, trials, truth, runs, seed=trials)
    ours, _ = compare(hypotheses, truth, scheme, counts)
    # The same experiments: the same Bayes factors.
    assert np.abs(ours - plain).max() < 0.1
    assert abs(np.mean(ours - plain)) < 0.03
    # Others: the same power, within the Monte Carlo error of both.
    found = ww.power(scheme, hypotheses, expected=ALIKE, truths=[truth], runs=others, seed=2).table[
        "power"
    ][0]
    share = np.mean(plain > np.log(10))
    error = np.sqrt(max(found * (1 - found), 0.01) * (1 / runs + 1 / others))
    assert abs(found - share) < 3.5 * error


@pytest.mark.parametrize("truth", slow_but(["tapered", "cylindrical"], quick=(0,)))
def test_power_is_that_of_a_brute_force_simulation(truth):
    check_brute_force((0.3, 0.6, 0.9), 5, truth, 12, 256)


@pytest.mark.slow
def test_standards_close_together_tell_next_to_nothing():
    found = [
        ww.power(design(p, 20), (TAPERED, CYLINDRICAL), expected=ALIKE, runs=64).table["power"]
        for p in ((0.3, 0.5), (0.3, 0.6, 0.9))
    ]
    assert found[0].max() < 0.2
    assert found[1].min() > 0.7


# -- the same answers as the fits that will be made ----------------------------------------------


def trials_of(scheme, counts, task="2AFC", subject=None):
    cells = scheme.cells()
    frame = pd.DataFrame(
        {
            "standard": cells.standard,
            "stimulus_1": cells.stimulus_1,
            "stimulus_2": cells.stimulus_2,
            "n": cells.n.astype(int),
            "count": counts,
        }
    )
    if subject is not None:
        frame["subject"] = subject
    return Trials(frame, task_named(task))


WEBER = Hypothesis("Weber", IdentityEncoding())
CASES = {
    "tapered, few trials": (TAPERED, design((0.3, 0.9), 5)),
    "cylinder, many trials": (CYLINDRICAL, design((0.3, 0.6, 0.9), 100)),
    "force map": (cues(WHISKER, 0.1)[1], design((0.3, 0.8), 20)),
    "constant noise": (
        noises(IdentityEncoding(), [1.0, 3.0])[1], Scheme([1.0, 3.0], [-0.4, -0.2, 0.2, 0.4]),
    ),
    "shared bias": (Hypothesis("a", IdentityEncoding(), bias="shared"),
                    Scheme([1.0, 2.0], [-0.3, -0.1, 0.1, 0.3])),
    "no bias": (Hypothesis("a", IdentityEncoding(), bias="none"),
                Scheme([1.0, 2.0], [-0.3, -0.1, 0.1, 0.3])),
    "known lapses": (with_priors([WEBER], lapse_low=0.03, lapse_high=0.03)[0],
                     Scheme([1.0], [-0.3, -0.1, 0.1, 0.3])),
    "another prior": (with_priors([WEBER], weber_fraction=lognorm(0.3, scale=0.12))[0],
                      Scheme([1.0], [-0.3, -0.1, 0.1, 0.3])),
    "yes/no": (Hypothesis("a", IdentityEncoding(), task="yes/no"),
               Scheme([1.0], [-0.2, 0.1, 0.2, 0.3])),
    "percent correct": (Hypothesis("a", IdentityEncoding(), task="3AFC percent correct",
                                   bias="none"), Scheme([1.0], [0.05, 0.1, 0.2, 0.5])),
}  # fmt: skip


@pytest.mark.parametrize("case", slow_but(CASES, (0, 2, 4, 8)))
def test_an_experiment_is_fitted_as_fit_weber_fits_it(case):
    hypothesis, scheme = CASES[case]
    counts, _ = simulate(hypothesis, scheme, SubjectPopulation(), 16, np.random.default_rng(5))
    fitted = fit(hypothesis, scheme, counts)
    for i in range(3):
        own = fit_weber(
            trials_of(scheme, counts[i, 0], hypothesis.task), encoding=hypothesis.encoding,
            priors=hypothesis.priors, bias=hypothesis.bias,
        )  # fmt: skip
        low, high = own.interval(0.95)
        assert fitted.log_evidence[i] == pytest.approx(own.log_evidence, abs=0.06)
        # In widths of the interval, which is what a design is about.
        assert fitted.quantiles[i] == pytest.approx(
            [low, own.weber_fraction, high], abs=0.04 * (high - low)
        )


@pytest.mark.slow
def test_animals_share_a_population_as_fit_population_has_it():
    """Evidence and intervals, where lapses and biases are known: a fit learns them from all animals
    together, a simulated experiment from each by itself."""
    scheme = design((0.3, 0.9), 8).with_animals(2)
    counts, _ = simulate(TAPERED, scheme, SubjectPopulation(), 1, np.random.default_rng(3))
    frames = [trials_of(scheme, counts[0, a], subject=f"s{a}").frame for a in range(2)]
    pooled = Trials(pd.concat(frames, ignore_index=True), task_named("2AFC"))
    factors = []
    known = {"lapse_low": 0.02, "lapse_high": 0.02, "bias": 0.0}
    for hypothesis in with_priors([TAPERED, CYLINDRICAL], **known):
        fitted = fit(hypothesis, scheme, counts)
        own = fit_population(pooled, encoding=hypothesis.encoding, priors=hypothesis.priors,
                             bias="per standard", check=False)  # fmt: skip
        low, high = own.interval(0.95)
        assert fitted.log_evidence[0] == pytest.approx(own.log_evidence, abs=0.3)
        assert np.log(fitted.quantiles[0]) == pytest.approx(
            np.log([low, own.weber_fraction, high]), abs=0.05 * np.log(high / low)
        )
        factors.append(fitted.log_evidence[0] - own.log_evidence)
    assert abs(factors[0] - factors[1]) < 0.3


@pytest.mark.slow  # of populations: the test after
def test_intervals_cover_what_the_prior_draws():
    """Rank statistics of draws from the prior: 95 % intervals hold 95 %, whatever the design."""
    scheme = design((0.3, 0.9), 10)
    believed = SubjectPopulation(spread=0.0, lapses_vary=True, lapse=0.05, bias_spread=1.0)
    (hypothesis,) = with_priors(
        [TAPERED], lapse_low=beta(2, 38), lapse_high=beta(2, 38), lapse_correlation=0.0,
        bias=norm(0, 1),
    )  # fmt: skip
    rng = np.random.default_rng(4)
    drawn = [
        simulate(hypothesis, scheme, replace(believed, weber_fraction=float(k)), 1, rng)
        for k in hypothesis.priors.value("weber_fraction", rng.standard_normal(600))
    ]
    counts, k = (np.concatenate(parts) for parts in zip(*drawn, strict=True))
    low, middle, high = fit(hypothesis, scheme, counts).quantiles.T
    assert abs(np.mean((low < k) & (k < high)) - 0.95) < 4 * np.sqrt(0.95 * 0.05 / 600)
    assert abs(np.mean(middle < k) - 0.5) < 4 * np.sqrt(0.25 / 600)


def drawn_from_the_priors(hypothesis, scheme, runs, rng):
    """Experiments on animals whose population is itself drawn from its priors, and its median k."""
    model, believed = hypothesis.model(scheme), hypothesis.priors
    shape = runs, scheme.animals
    middle = believed.value("weber_fraction", rng.standard_normal(runs))
    spread = SPREAD.rvs(runs, random_state=rng)[:, None]
    k = middle[:, None] * np.exp(spread * rng.standard_normal(shape))
    rho = believed.lapse_correlation
    first, second = rng.standard_normal((2, *shape))
    low, high = (
        believed.value(name, z)
        for name, z in (
            ("lapse_low", first),
            ("lapse_high", rho * first + np.sqrt(1 - rho**2) * second),
        )
    )
    possible = (low + high < 1).all(axis=1)
    low, high, k = (a[possible] for a in (low, high, k))
    bias = believed.value("bias", rng.standard_normal((*k.shape, model.n_groups)))
    p, _ = model.probability(k, low, high, bias)
    counts = rng.binomial(model.cells.n.astype(int), np.clip(p, 0, 1)).astype(float)
    return counts, middle[possible]


def covered(hypothesis, scheme, counts, k):
    low, _, high = fit(hypothesis, scheme, counts).quantiles.T
    return np.mean((low < k) & (k < high))


@pytest.mark.parametrize(
    ("animals", "runs"), [(4, 30), pytest.param(32, 300, marks=pytest.mark.slow)]
)
def test_intervals_cover_populations_that_the_priors_draw(animals, runs):
    scheme = design((0.3, 0.9), 8).with_animals(animals)
    counts, k = drawn_from_the_priors(TAPERED, scheme, runs, np.random.default_rng(1))
    assert abs(covered(TAPERED, scheme, counts, k) - 0.95) < 4 * np.sqrt(0.95 * 0.05 / len(k))


# -- power, and the smallest design ---------------------------------------------------


@pytest.mark.slow  # of power: by a brute force simulation
def test_power_grows_with_trials_and_falls_with_lapses():
    scheme = design((0.3, 0.9), 10)
    options = {"trials": [5, 20], "truths": ["tapered"], "runs": 128, "seed": 3}
    tables = {
        lapse: ww.power(
            scheme, (TAPERED, CYLINDRICAL), expected=SubjectPopulation(lapse=lapse), **options
        ).table.set_index("trials")
        for lapse in (0.0, 0.15)
    }
    found = pd.concat(tables).swaplevel().sort_index()
    assert found["power"][20, 0.0] > found["power"][5, 0.0] + 0.1
    assert found["power"][20, 0.0] > found["power"][20, 0.15] + 0.05
    assert found["half_width"][20, 0.0] < found["half_width"][5, 0.0]
    inside = (found["lower"] <= found["power"]) & (found["power"] <= found["upper"])
    assert inside.all()


def test_the_smallest_design_reaches_its_goal_and_a_smaller_one_does_not():
    hypotheses = TAPERED, CYLINDRICAL
    scheme, found = smallest(
        design((0.3, 0.9), 10), hypotheses, runs=128, truths=["tapered"], expected=ALIKE, seed=2
    )
    trials = max(map(max, scheme.trials))
    row = found.table.set_index("trials").loc[trials]
    assert row["runs"] == 256
    assert abs(row["power"] - 0.8) < 0.12
    half = sized(scheme, "trials", trials // 2)
    less = ww.power(half, hypotheses, truths=["tapered"], expected=ALIKE, runs=256, seed=3)
    assert less.table["upper"][0] < 0.8
    # Bracketing, not a sweep.
    assert len(found.table) < 10


@pytest.mark.parametrize("start", [10, 40, 300])
@pytest.mark.parametrize(
    ("curve", "most"),
    [  # halving takes 5 or 6 everywhere
        (lambda n: ndtr(1.5 * np.log(n / 53)), 4),
        (lambda n: ndtr(0.2 * np.sqrt(n) - 1.3), 4),
        (lambda n: 0.85 * ndtr(8 * np.log(n / 140)), 6),  # flat beyond
        (lambda n: np.where(n < 97, 0.02, 0.99), 6),  # a step
    ],
)  # fmt: skip
def test_the_smallest_size_is_found_on_curves_of_known_power(
    monkeypatch: pytest.MonkeyPatch, curve, most: int, start: int
) -> None:
    visited = []

    def known(scheme: Scheme, hypotheses, *, goal, runs: int, **_) -> Power:
        n = max(map(max, scheme.trials))
        visited.append(n)
        met = np.arange(runs) < np.round(runs * curve(n))
        table = pd.DataFrame(
            {"truth": "tapered", "trials": n, "animals": 1, "half_width": 0.2, "covers": True,
             "log_bayes_factor": np.where(met, 9.0, 0.0), "estimate": 0.1, "weber_fraction": 0.1}
        )  # fmt: skip
        return Power(goal, power_analysis.summary(table, goal), table)

    monkeypatch.setattr(power_analysis, "power", known)
    found, _ = smallest(design((0.3, 0.9), start), (TAPERED, CYLINDRICAL), runs=100_000)
    size = max(map(max, found.trials))
    assert curve(size) >= 0.8 - 1e-4
    assert curve(0.95 * size - 1) < 0.8
    assert len(set(visited)) <= most + np.ceil(abs(np.log2(size / start)))


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (lambda: ww.power(design((0.3,), 5), [TAPERED], goal=Evidence(bayes_factor=10)),
         "A Bayes factor compares two hypotheses"),
        (lambda: ww.power(design((0.3,), 5), [TAPERED], truths=["tappered"]), "did you mean"),
        (lambda: ww.power(design((0.3,), 5), [TAPERED], trials=[0]), "got 0"),
        (lambda: ww.power(design((0.3,), 5), [TAPERED], runs=0), "got 0"),
        (lambda: ww.power(design((0.3,), 5), [TAPERED], animals=[0]), "animals must be"),
        (lambda: design((0.3,), 5).with_animals(10**9), "up to 10000000 trials, got"),
        (lambda: ww.power(Scheme([49e-3], [-2e-3, 2e-3]), [TAPERED]), "by 1 mm past its tip"),
        (lambda: smallest(design((0.3, 0.5), 5), (TAPERED, CYLINDRICAL), most=10, runs=32),
         "no design of up to 10 trials a comparison.*, which takes"),
        (lambda: smallest(design((0.3,), 5), [TAPERED], vary="lapses"), "choose one of"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused_in_a_sentence(wrong, words):
    with pytest.raises(ValueError, match=words):
        wrong()


WRONG = (
    None,
    "x",
    3.5,
    np.nan,
    np.inf,
    -1,
    [],
    {},
    object(),
    float,
    b"x",
    [None],
    np.zeros((2, 2)),
)
PLAN = {
    "scheme": Scheme([20e-3], [-2e-3, 2e-3], 4), "hypotheses": [TAPERED],
    "goal": Precision(half_width=0.2),
}  # fmt: skip
FEW = {"goal": Precision(half_width=0.2), "runs": 2}


@pytest.mark.parametrize(
    ("call", "taken"),
    [
        (lambda w: Evidence(bayes_factor=10, share=w), ()),
        (lambda w: Precision(half_width=w), ()),
        (lambda w: SubjectPopulation(lapse=w), ()),
        (lambda w: Constraints(nearest=w), (3.5, -1)),  # a level in decibels may be so
        (lambda w: Constraints(farthest=w), (3.5, np.inf)),
        (lambda w: Scheme([20e-3], w), ()),
        (lambda w: Scheme([20e-3], [2e-3], w), ()),
        (lambda w: Scheme.spaced(w, [20e-3]), ()),
        (lambda w: Scheme.spaced(TAPERED.encoding, w), ()),
        (lambda w: Hypothesis("a", w), ()),
        (lambda w: Hypothesis("a", TAPERED.encoding, w), ()),
        (taper, ()),
        (lambda w: noises(w, [1.0, 2.0]), ()),
        (lambda w: noises(TAPERED.encoding, w), ()),
        (lambda w: Plan(**PLAN | {"scheme": w}), ()),
        (lambda w: Plan(**PLAN | {"hypotheses": w}), ()),
        (lambda w: Plan(**PLAN | {"goal": w}), ()),
        (lambda w: Plan(**PLAN | {"animals": w}), ()),
        (lambda w: Plan(**PLAN | {"seed": w}), ()),
        (lambda w: Plan(**PLAN | {"trials_per_session": w}), ()),
        (lambda w: trial_lists(w, seed=1), ()),
        (lambda w: trial_lists(PLAN["scheme"], seed=w), ()),
        (lambda w: ww.power(w, [TAPERED], runs=2), ()),
        (lambda w: ww.power(PLAN["scheme"], w, runs=2), ()),
        (lambda w: ww.power(PLAN["scheme"], [TAPERED], **FEW | {"trials": [w]}), ()),
        (lambda w: ww.power(PLAN["scheme"], [TAPERED], **FEW | {"runs": w}), ()),
        (lambda w: smallest(PLAN["scheme"], [TAPERED], **FEW | {"most": w}), (None,)),
        (lambda w: lattice(w, 20e-3), ()),
        (lambda w: ww.read_plan(w), ("x", b"x")),
    ],
)  # fmt: skip
def test_wrong_types_are_refused_in_a_sentence(call, taken):
    """None, text, infinity, NaN, lists and classes ended in errors of Python's and NumPy's."""
    for wrong in WRONG:
        if any(wrong is one for one in taken):
            continue
        with pytest.raises(ValueError, match=r"\w") as error:
            call(wrong)
        place = error.traceback[-1].path
        assert "weberwhisk" in str(place), (wrong, error.value)


def test_animals_engaged_part_of_the_time_need_more_trials() -> None:
    """Fitted one by one with states; engaged throughout they are those of the fast way."""
    weber = [Hypothesis("Weber", IdentityEncoding(), bias="shared")]
    scheme, goal = Scheme([1.0], [-0.3, -0.2, -0.1, 0.1, 0.2, 0.3], trials=40), Precision(0.3)
    width = {
        engaged: ww.power(
            scheme, weber, goal=goal, runs=4, states=engaged and States(engaged=engaged)
        ).table["half_width"].item()
        for engaged in (None, 1.0, 0.5)
    }  # fmt: skip
    assert width[1.0] == pytest.approx(width[None], rel=0.4)
    assert width[0.5] > width[1.0]
    with pytest.raises(ValueError, match="write together=False"):
        ww.power(scheme, weber, goal=goal, animals=[2], states=States())
