"""Information of a trial, against brute-force expectations; and the best scheme it leads to."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import ndtr
from scipy.stats import beta

import weberwhisk as ww
from weberwhisk import cues as kinds
from weberwhisk.behaviour import CueEncoding
from weberwhisk.behaviour.encodings import IdentityEncoding
from weberwhisk.design import (
    Constraints,
    Scheme,
    SubjectPopulation,
    best_scheme,
    information,
    noises,
    taper,
)
from weberwhisk.design.best import Precision
from weberwhisk.design.experiment import WIDE
from weberwhisk.design.experiments import fit

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
    table = information((TAPERED, CYLINDRICAL), [standard], [offset]).iloc[0]
    k, low, high, bias = draws(400_000, 1)
    weight = np.full(k.size, 1 / k.size)
    p = {n: probability(standard, standard + offset, a, k, low, high, bias)
         for n, a in APEX.items()}  # fmt: skip
    about_k = np.mean([by_bins(np.log(k), weight, p[n], EDGES) for n in APEX])
    mean = np.array([weight @ p[n] for n in APEX])
    about_model = bits(mean.mean()) - bits(mean).mean()
    # 280 bins of 400 000 draws add 280/(2·400 000·ln 2) = 5e-4 bits of their own.
    assert table["weber_fraction_bits"] == pytest.approx(about_k, abs=1.2e-3)
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


# -- the best scheme -----------------------------------------------------------------------------


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
