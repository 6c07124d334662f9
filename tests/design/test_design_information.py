"""The best scheme, and what no scheme can be."""

from __future__ import annotations

import numpy as np
import pytest

import weberwhisk as ww
from weberwhisk import cues as kinds
from weberwhisk.behaviour import CueEncoding
from weberwhisk.behaviour.encodings import IdentityEncoding
from weberwhisk.design import (
    Constraints,
    Scheme,
    SubjectPopulation,
    best_scheme,
    noises,
    taper,
)
from weberwhisk.design.best import Precision
from weberwhisk.design.experiment import WIDE
from weberwhisk.design.experiments import fit

WHISKER = ww.Whisker(50e-3, 100e-6, 5e-6)
TAPERED, CYLINDRICAL = taper(WHISKER)


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
