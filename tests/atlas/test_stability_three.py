"""The sums that judge posteriors of three unknowns are right themselves."""

from __future__ import annotations

import numpy as np
import pytest
from analysis_scripts import load
from scipy.special import expit, logit, ndtr

import weberwhisk as ww

posteriors = load("stability_posteriors")
three = load("stability_three")
whiskers = load("stability_whiskers")
#: Readings that the search of the atlas found, and what plain sums say of the distance, m.
SIDE = [0.5938296, 0.865055]
SIGNATURES = [
    ([6.90542e-06, 2.692324e-4, 0.09225999, 0.7415741], 0.03957581, 7.4266e-5),
    ([6.845715e-06, 2.708523e-4, 0.06523784, 0.7749066], 0.03933569, 1.9361e-4),
]


@pytest.mark.parametrize(
    ("name", "contact", "factors"),
    [
        ("map, stiffness unknown", [25e-3, 0.2, 1.2], [1.05, 0.9]),
        ("log-normal map, stiffness unknown", [25e-3, 0.2, 1.2], [1.05, 0.9]),
        ("angle-side-angle, side unknown", [25e-3, 1.3, 12e-3], [1.02, 1.03]),
    ],
)
def test_the_sum_over_three_unknowns_is_of_the_package_s_model(
    name: str, contact: list[float], factors: list[float]
) -> None:
    """Its density is the observer's, up to a constant, integrated over the last unknown."""
    observer = posteriors.observer(name, 0.1)
    signals, _ = observer.signals(np.array(contact))
    reading = signals * factors
    w, v = np.linspace(-2.0, 2.0, 5), np.linspace(-3.0, 3.0, 7)
    found = three._log_density(observer, reading, w, v, 200)
    low, high = observer.reach
    prior = observer.prior[observer.unknowns[-1]]
    third = prior.ppf(ndtr(np.linspace(-7.5, 7.5, 8001)))
    off = []
    for i, x in enumerate(w):
        r = low + expit(x) * (high - low)
        begin, width = 0.0, float(ww.flick_past(observer.whisker, r).deflection_angle)
        if "side" in observer.unknowns:
            begin, width = observer.cue.bearings[0], np.ptp(observer.cue.bearings)
        for j, y in enumerate(v):
            if found[i, j] < found.max() - 15:  # where there is no mass windows may end too soon
                continue
            contact = np.stack(np.broadcast_arrays(r, begin + width * expit(y), third), axis=-1)
            density = np.exp(observer.log_likelihood(reading, contact)) * prior.pdf(third)
            slope = width * expit(x) * expit(-x) * expit(y) * expit(-y)
            off.append(found[i, j] - np.log(slope * np.trapezoid(density, third)))
    assert len(off) > 2
    np.testing.assert_allclose(off, off[0], atol=2e-3)


def test_a_known_friction_out_of_an_unknown_one_is_the_observer_s_own() -> None:
    """Rows of evidence, at every distance, beside those of an observer that knows the friction."""
    unknown = whiskers.rubbing({"curved": 1, "fraction": 1})
    rubbing = whiskers.cues.Friction(whiskers.cues.ForceMap(), 0.2)
    known = ww.Observer(unknown.whisker, rubbing, unknown.noise)
    reading, _ = known.signals(np.array([30e-3, 0.3]))
    r = np.linspace(25e-3, 35e-3, 9)
    of, one = (posteriors._rows(o, reading, r, 96)[0] for o in (whiskers._at(unknown, 0.2), known))
    away = one > one.max() - 20
    assert away.sum() > 3
    np.testing.assert_allclose(of[away] - of.max(), one[away] - one.max(), atol=1e-3)


@pytest.mark.parametrize("name", posteriors.OBSERVERS)
def test_the_atlas_makes_every_observer_whose_posteriors_it_judges(name: str) -> None:
    """One whose cue had been taken out was found after an hour, by the full form alone."""
    observer = posteriors.observer(name, 0.1)
    contact = observer.space.constrain(np.zeros((1, len(observer.unknowns))))[0]
    assert observer.signals(contact)[1] == ww.Outcome.HELD


def test_the_sum_knows_its_error_and_agrees_with_quadrature() -> None:
    observer = posteriors.observer("map, stiffness unknown", 0.3)
    contact = np.array([25e-3, 0.2, 1.2])
    reading = observer.signals(contact)[0] * [1.1, 0.8]
    near = float(logit(contact[0] / observer.reach[1]))
    mean, sd, known = three.brute(observer, reading, near)
    assert known < 1e-3
    p = ww.posterior(observer, reading)
    np.testing.assert_allclose([p.mean, p.sd], [mean, sd], rtol=5e-3)


def test_a_reading_far_from_its_contact_is_summed_whole() -> None:
    """At k = 0.03 the rule for the stiffness left out a fifth of the sd and claimed 0.4 %."""
    observer = posteriors.observer("map, stiffness unknown", 0.03)
    contact = np.array([4.0418e-3, 0.52105, 0.915753])
    signals, _ = observer.signals(contact)
    reading = signals + np.array([-0.21404752, 3.05672107]) * observer.noise.sd(signals)
    mean, sd, known = three.brute(observer, reading, float(logit(contact[0] / observer.reach[1])))
    assert known < 1e-3
    p = ww.posterior(observer, reading)
    assert p.status == ww.Status.CONVERGED
    np.testing.assert_allclose([p.mean, p.sd], [mean, sd], rtol=5e-3)


def test_nodes_of_a_side_are_halved_until_odd_and_even_ones_agree() -> None:
    """At a third of what these differed by, the sd was 3.7e-3 off, said to be within 7e-4."""
    p = ww.posterior(posteriors.observer("angle-side-angle, side unknown", 0.01), SIDE)
    assert abs(p.mean - 0.02170966) < 1e-3 * p.sd
    assert abs(p.sd / 0.0040749 - 1) < 1e-3


@pytest.mark.parametrize(("reading", "mean", "sd"), SIGNATURES)
def test_laplace_is_at_the_highest_peak_or_says_that_it_is_not_gaussian(
    reading: list[float], mean: float, sd: float
) -> None:
    """A fusion with a signature: it climbed to another peak, up to 18 sd off, in silence."""
    p = ww.posterior(posteriors.observer("map and vibration fused", 0.03), reading, "laplace")
    right = abs(p.mean - mean) < 0.25 * sd and abs(p.sd / sd - 1) < 0.25
    assert right or p.status == ww.Status.NOT_GAUSSIAN
