"""The best scheme, and what no scheme can be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import weberwhisk as ww
from weberwhisk import cues as kinds
from weberwhisk.behaviour import CueEncoding, Priors
from weberwhisk.behaviour.encodings import IdentityEncoding
from weberwhisk.design import (
    Constraints,
    Evidence,
    Precision,
    Scheme,
    SubjectPopulation,
    best_scheme,
    noises,
    taper,
)
from weberwhisk.design.simulation import compare, simulate

WHISKER = ww.Whisker(50e-3, 100e-6, 5e-6)
KNOWN = Priors(lapse_low=0.02, lapse_high=0.02)  # two dimensions less at every choice that is tried
TAPERED, CYLINDRICAL = (replace(h, priors=KNOWN) for h in taper(WHISKER))


# -- the best scheme -----------------------------------------------------------------------------


@pytest.mark.slow  # its search: the example of best_scheme
@pytest.mark.parametrize(
    ("goal", "least"),
    [(Evidence(bayes_factor=10), 1.0), (Precision(half_width=0.2), 0.02)],
)
def test_the_best_scheme_reaches_more_than_even_standards(goal, least):
    """In 80 % of experiments of another seed, fitted as data are: nats, or ln of the width."""
    limits = Constraints(nearest=5e-3, farthest=45e-3)
    hypotheses = (TAPERED, CYLINDRICAL)
    found = best_scheme(hypotheses, goal=goal, constraints=limits, runs=128)
    plain = Scheme.spaced(TAPERED.encoding, [15e-3, 25e-3, 35e-3])
    assert found.n_trials == plain.n_trials == 360
    reached = {}
    for scheme in (found, plain):
        counts, _ = simulate(TAPERED, scheme, SubjectPopulation(), 512, np.random.default_rng(9))
        factor, own = compare(hypotheses, "tapered", scheme, counts)
        one = factor if goal.column == "log_bayes_factor" else -np.log(own.half_width)
        reached[scheme] = np.quantile(one, 0.2)
    assert reached[found] > reached[plain] + least


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"constraints": Constraints(nearest=60e-3)}, "leaves nothing that can be encoded"),
        ({"constraints": Constraints(step=20e-3)}, "fewer than standards=3"),
        ({"standards": 15}, "standards must be below 15"),
        ({"trials": 10}, "8 short"),
        ({"pairs": 0}, "pairs must be"),
    ],
)  # fmt: skip
def test_impossible_constraints_are_named_with_by_how_much(options, words):
    with pytest.raises(ValueError, match=words):
        best_scheme((TAPERED, CYLINDRICAL), **options)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (lambda: TAPERED.model(Scheme([51e-3], [1e-3])), "by 1 mm past its tip"),
        (lambda: best_scheme([]), "needs a hypothesis"),
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
