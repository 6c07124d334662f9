"""Information of a trial, against brute-force expectations; and the best scheme it leads to."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from analysis_scripts import load
from scipy.special import ndtr
from scipy.stats import beta, lognorm, norm

import weberwhisk as ww
from weberwhisk import cues as kinds
from weberwhisk.behaviour import CueEncoding
from weberwhisk.behaviour.encodings import IdentityEncoding
from weberwhisk.design import (
    Constraints,
    Goal,
    Hypothesis,
    Scheme,
    SubjectPopulation,
    best_scheme,
    information,
    noises,
    smallest,
    taper,
    with_priors,
)
from weberwhisk.design.best import Precision, _Search, _sites
from weberwhisk.design.experiment import WIDE
from weberwhisk.design.experiments import compare, fit

WHISKER = ww.Whisker(50e-3, 100e-6, 5e-6)
TAPERED, CYLINDRICAL = taper(WHISKER)


# -- a referee: draws from the prior, weighted by what was answered before -----------------------


def bits(p):
    p = np.clip(p, 1e-12, 1 - 1e-12)
    return -(p * np.log2(p) + (1 - p) * np.log2(1 - p))


def draws(count, seed):
    """k, lapses and bias from the default priors, without the package: a normal copula."""
    rng = np.random.default_rng(seed)
    z = rng.standard_normal((3, count))
    z[2] = 0.7 * z[1] + np.sqrt(1 - 0.49) * z[2]
    lapses = beta(0.7, 20).ppf(ndtr(z[1:]))
    keep = lapses.sum(axis=0) < 1
    k = 0.1 * np.exp(np.log(3) * z[0])
    return k[keep], lapses[0, keep], lapses[1, keep], rng.standard_normal(count)[keep]


def tap(distance, apex):
    return 1 / distance - 1 / apex


def probability(standard, comparison, apex, k, low, high, bias):
    m0, m1 = tap(standard, apex), tap(comparison, apex)
    p = low + (1 - low - high) * ndtr((m0 - m1) / (k * np.hypot(m0, m1)) + bias)
    return np.clip(p, 1e-15, 1 - 1e-15)


def by_bins(x, weight, p, edges):
    """Information about x: the answer's entropy less its mean entropy in narrow bins of x."""
    at = np.digitize(x, edges)
    mass = np.bincount(at, weight, edges.size + 1)
    up = np.bincount(at, weight * p, edges.size + 1)
    full = mass > 0
    return bits(up.sum()) - mass[full] @ bits(up[full] / mass[full])


APEX = {"tapered": 50e-3 / (1 - 1 / 20), "cylindrical": np.inf}
EDGES = np.linspace(-9, 5, 281)


@pytest.mark.parametrize(
    ("standard", "offset"),
    [
        (15e-3, 3e-3),
        *(pytest.param(r, d, marks=pytest.mark.slow) for r, d in ((45e-3, -2e-3), (30e-3, 0.0))),
    ],
)
def test_information_is_the_expected_gain_of_brute_force(standard, offset):
    """Before any trial: draws from the priors, binned."""
    table = information((TAPERED, CYLINDRICAL), [standard], [offset], jnd_at=40e-3).iloc[0]
    k, low, high, bias = draws(400_000, 1)
    weight = np.full(k.size, 1 / k.size)
    p = {n: probability(standard, standard + offset, a, k, low, high, bias)
         for n, a in APEX.items()}  # fmt: skip
    about_k = np.mean([by_bins(np.log(k), weight, p[n], EDGES) for n in APEX])
    jnd = np.concatenate([np.log(k * 40e-3 * (1 - 40e-3 / a)) for a in APEX.values()])
    about_jnd = by_bins(jnd, np.tile(weight / 2, 2), np.concatenate(list(p.values())), EDGES)
    mean = np.array([weight @ p[n] for n in APEX])
    about_model = bits(mean.mean()) - bits(mean).mean()
    # 280 bins of 400 000 draws add 280/(2·400 000·ln 2) = 5e-4 bits of their own.
    assert table["weber_fraction_bits"] == pytest.approx(about_k, abs=1.2e-3)
    assert table["jnd_bits"] == pytest.approx(about_jnd, abs=1.2e-3)
    # The lapses' prior ends where they fill the curve, which its nodes meet to about 1 %.
    assert table["hypothesis_bits"] == pytest.approx(about_model, rel=0.02, abs=3e-4)


def test_information_after_trials_is_that_of_brute_force():
    """Draws from the priors, weighted by the likelihood of the answers expected before."""
    before = Scheme([15e-3], [-3e-3, 3e-3], 6)
    animal = SubjectPopulation(0.1, 0.0, 0.03, 0.0)
    table = information(
        (TAPERED,), [15e-3, 45e-3], [2e-3], after=before, expected=animal
    ).set_index("standard_mm")  # fmt: skip
    k, low, high, bias = draws(400_000, 2)
    other = np.random.default_rng(3).standard_normal(k.size)
    log_like = 0.0
    for c in (12e-3, 18e-3):
        p = probability(15e-3, c, APEX["tapered"], k, low, high, bias)
        x = 6 * probability(15e-3, c, APEX["tapered"], 0.1, 0.03, 0.03, 0.0)
        log_like = log_like + x * np.log(p) + (6 - x) * np.log1p(-p)
    weight = np.exp(log_like - log_like.max())
    weight /= weight.sum()
    for standard, own in ((15e-3, bias), (45e-3, other)):  # a new standard has a bias of its own
        p = probability(standard, standard + 2e-3, APEX["tapered"], k, low, high, own)
        wanted = by_bins(np.log(k), weight, p, EDGES)
        assert table["weber_fraction_bits"][1e3 * standard] == pytest.approx(wanted, abs=3e-3)


def test_information_is_the_mean_log_posterior_ratio_of_simulated_answers():
    """E ln(p(k | y)/p(k)), the other way round: answers first, then their posteriors."""
    (known,) = with_priors(
        [Hypothesis("a", IdentityEncoding(), bias="none")], lapse_low=0.02, lapse_high=0.02,
        weber_fraction=lognorm(0.5, scale=0.2),
    )  # fmt: skip
    wanted = information([known], [1.0], [0.2])["weber_fraction_bits"][0]
    rng = np.random.default_rng(1)
    k = 0.2 * np.exp(0.5 * rng.standard_normal(200_000))

    def up(k):
        return 0.02 + 0.96 * ndtr(0.2 / (k * np.hypot(1.0, 1.2)))

    yes = rng.random(k.size) < up(k)
    x = np.linspace(-5, 5, 4001)
    marginal = norm.pdf(x) @ up(0.2 * np.exp(0.5 * x)) * (x[1] - x[0])
    gain = np.where(yes, np.log2(up(k) / marginal), np.log2((1 - up(k)) / (1 - marginal)))
    assert wanted == pytest.approx(gain.mean(), abs=4 * gain.std() / np.sqrt(k.size))


def test_information_is_the_slope_of_what_is_expected_to_be_known():
    """One trial more, in place of its expectation: the drop of the entropy of k, by differences."""
    (known,) = with_priors(
        [Hypothesis("a", IdentityEncoding(), bias="none")], lapse_low=0.02, lapse_high=0.02
    )
    x = np.linspace(-6, 6, 6001)

    def entropy(log_like):
        post = np.exp(log_like - 0.5 * x**2)
        post /= post.sum()
        return -(post @ np.log2(np.maximum(post, 1e-300)))

    p = 0.02 + 0.96 * ndtr(0.3 / (0.1 * np.exp(np.log(3) * x) * np.hypot(1.0, 1.3)))
    prior = np.exp(-0.5 * x**2) / np.exp(-0.5 * x**2).sum()
    chance = prior @ p
    drop = entropy(0 * x) - chance * entropy(np.log(p)) - (1 - chance) * entropy(np.log1p(-p))
    table = information([known], [1.0], [0.3])
    assert table["weber_fraction_bits"][0] == pytest.approx(drop, abs=1e-4)
    # One hypothesis: its JND is k times a number, and there is nothing to tell apart.
    assert table["jnd_bits"][0] == pytest.approx(drop, abs=1e-4)
    assert table["hypothesis_bits"][0] == 0


def test_what_is_known_already_is_not_told_again():
    before = Scheme.spaced(TAPERED.encoding, [15e-3, 42e-3], trials=20)
    fresh, after = (
        information((TAPERED, CYLINDRICAL), [15e-3, 30e-3, 42e-3], [1.5e-3], after=scheme)
        for scheme in (None, before)
    )
    for about in ("weber_fraction_bits", "jnd_bits", "hypothesis_bits"):
        assert (after[about] > 0).all()
    assert (after["weber_fraction_bits"] < 0.2 * fresh["weber_fraction_bits"]).all()


def test_any_cue_has_information_and_what_is_not_felt_has_none():
    lapsing = Hypothesis("map", CueEncoding(ww.Observer(WHISKER, kinds.ForceMap()), 0.1))
    table = information([lapsing], [20e-3, 44e-3], [-1e-3, 1e-3, 8e-3])
    assert np.isnan(table["weber_fraction_bits"].to_numpy()).tolist() == [False] * 5 + [True]
    assert (table["weber_fraction_bits"].dropna() > 0).all()


# -- the best scheme -----------------------------------------------------------------------------


@pytest.mark.slow
def test_no_exchange_and_no_other_pair_of_standards_is_better():
    """A problem small enough to try everything."""
    animals, limits = SubjectPopulation(), Constraints(nearest=8e-3, farthest=46e-3)
    goal = Goal(bayes_factor=10)
    sites = _sites((TAPERED, CYLINDRICAL), limits, animals, 1)[::3]
    search = _Search((TAPERED, CYLINDRICAL), sites, animals, goal, limits, 1, 60)
    found = max(search.climb(search.start(2, r))[0]
                for r in (None, np.random.default_rng(1), np.random.default_rng(2)))  # fmt: skip
    every = [
        search.value(((i, (a,)), (j, (b,))))
        for i, j in itertools.combinations(range(len(sites)), 2)
        for a in range(sites[i].sizes.size)
        for b in range(sites[j].sizes.size)
    ]
    assert found == pytest.approx(max(every), abs=1e-6)


def test_the_sketch_judges_as_the_fit_does():
    animals, limits = SubjectPopulation(), Constraints(nearest=8e-3, farthest=46e-3)
    sites = _sites((TAPERED, CYLINDRICAL), limits, animals, 3)
    search = _Search(
        (TAPERED, CYLINDRICAL), sites, animals, Goal(bayes_factor=10), limits, 3, 20
    )  # fmt: skip

    def counts(h: Hypothesis, scheme: Scheme) -> Any:
        return h.expected_counts(scheme, animals.weber_fraction, animals.lapse)[None, None]

    values, exact = [], []
    for places in ((0, 8, 15), (2, 5, 9), (0, 1, 2)):
        choice = tuple((i, (0, 2, 4)) for i in places)
        scheme = search.scheme(choice, 1)
        values.append(search.value(choice))
        exact.append(
            min(
                compare((TAPERED, CYLINDRICAL), h.name, scheme, counts(h, scheme))[0][0]
                for h in (TAPERED, CYLINDRICAL)
            )
        )
    assert np.argsort(values).tolist() == np.argsort(exact).tolist()
    assert values == pytest.approx(exact, abs=0.6)


@pytest.mark.slow
def test_the_best_scheme_beats_a_plain_one_in_simulation():
    limits = Constraints(nearest=8e-3, farthest=46e-3, step=0.1e-3, easy_share=0.15)
    chosen = best_scheme(
        (TAPERED, CYLINDRICAL), constraints=limits, standards=2, pairs=2, trials=180
    )
    best = chosen.scheme
    limits.check(best, TAPERED.encoding)
    # The value is what four in five experiments reach, by simulation.
    assert chosen.value == chosen.table["value"].max()
    other = ww.power(best, (TAPERED, CYLINDRICAL), runs=512, seed=9).runs
    reached = other.groupby("truth")["log_bayes_factor"].quantile(0.2).min()
    assert abs(chosen.value - reached) < 0.6
    plain = Scheme.spaced(TAPERED.encoding, [15e-3, 25e-3, 35e-3], trials=10)
    assert best.n_trials <= plain.n_trials == 180
    found = [
        ww.power(s, (TAPERED, CYLINDRICAL), runs=96, seed=1).table["power"].min()
        for s in (best, plain)
    ]
    assert found[0] > found[1] + 0.15


@pytest.mark.slow
def test_the_best_scheme_for_k_needs_no_more_trials_than_a_plain_one():
    """And far fewer than one of narrow offsets, which leaves lapses and k mixed up."""
    goal, limits = Goal(half_width=0.3), Constraints(farthest=46e-3)
    best = best_scheme([TAPERED], goal=goal, trials=540, constraints=limits).scheme
    places = [15e-3, 30e-3, 45e-3]
    plain, narrow = (
        Scheme.spaced(TAPERED.encoding, places, trials=30, levels=levels)
        for levels in (WIDE, (0.3, 0.6, 0.9))
    )
    found = [smallest(s, [TAPERED], goal=goal, runs=64, seed=1) for s in (best, plain)]
    error = np.hypot(found[0].size_error, found[1].size_error)
    assert found[0].size < found[1].size + 2 * error
    two = [ww.power(s, [TAPERED], goal=goal, trials=[30], runs=64) for s in (best, narrow)]
    assert two[0].table["power"][0] > two[1].table["power"][0] + 0.3


def test_expected_intervals_are_those_of_fits():
    """Of the answers expected of every animal, where there are enough for a normal posterior."""
    scheme = Scheme.spaced(TAPERED.encoding, [15e-3, 40e-3], trials=200, levels=WIDE)
    cells, animals = scheme.cells(), SubjectPopulation()
    precision = Precision(TAPERED, cells.standard, cells.stimulus_2, animals)
    told = precision.half_widths(np.arange(cells.n.size), 200)
    drawn = animals.draw(told.size, 20)
    model = TAPERED.model(scheme)
    bias = np.repeat(drawn["bias"].to_numpy()[:, None], model.n_groups, axis=1)
    k, low, high = drawn[["weber_fraction", "lapse_low", "lapse_high"]].to_numpy().T
    p, _ = model.probability(k, low, high, bias)
    exact = fit(TAPERED, scheme, (200 * p)[:, None]).half_width
    off = np.abs(told / exact - 1)
    assert np.quantile(off, 0.5) < 0.05
    assert np.quantile(off, 0.9) < 0.1  # an animal that lapses much has a skewed posterior


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"constraints": Constraints(nearest=60e-3)}, "leaves nothing that can be encoded"),
        ({"constraints": Constraints(step=20e-3)}, "fewer than standards=3"),
        ({"constraints": Constraints(nearest=25e-3, farthest=26e-3, easy_share=0.5)},
         "fewer than standards=3"),
        ({"trials": 10}, "8 short"),
        ({"pairs": 0}, "pairs must be"),
        ({"constraints": Constraints(nearest=25e-3, farthest=33e-3, easy_share=0.5,
                                     easy_proportion=0.999)}, "fewer than easy_share=0.5"),
    ],
)  # fmt: skip
def test_impossible_constraints_are_named_with_by_how_much(options, words):
    with pytest.raises(ValueError, match=words):
        best_scheme((TAPERED, CYLINDRICAL), **options)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (lambda: information([TAPERED], [51e-3], [1e-3]), "by 1 mm past its tip"),
        (lambda: information([TAPERED], [10e-3, 20e-3], np.zeros((3, 2))), "3 rows for 2"),
        (lambda: information([TAPERED], [10e-3], [np.nan]), "must be finite"),
        (lambda: information([], [10e-3], [1e-3]), "needs a hypothesis"),
        (lambda: noises(IdentityEncoding(), [1.0, 1.0]), "the same noise"),
        (lambda: taper(WHISKER.cylinder()), "no taper to test"),
        (lambda: Constraints(nearest=2e-2, farthest=1e-2), "0.01 short"),
        (lambda: Scheme([10e-3], [1e-3], 0), "got 0"),
        (lambda: Scheme.spaced(OF_THE_MAP, [49e-3]), "flicked past: the whisker holds"),
        (lambda: Constraints(farthest=40e-3).check(Scheme([39e-3], [2e-3]), TAPERED.encoding),
         "by 1 mm"),
    ],
)  # fmt: skip
def test_bad_input_is_refused_in_a_sentence(wrong, words):
    with pytest.raises(ValueError, match=words):
        wrong()


OF_THE_MAP = CueEncoding(ww.Observer(WHISKER, kinds.ForceMap()), np.radians(20))


def test_the_script_writes_its_figures_and_tables(tmp_path):
    made = load("design").make(tmp_path, short=True)
    assert made["power"].groupby("truth")["power"].last().min() > 0.8
    assert (tmp_path / "design_power.csv").exists()
    assert (tmp_path / "design_information.png").stat().st_size > 10_000
