"""Spike counts: Weber's law emerges from a population, and stops where its thresholds do."""

from dataclasses import replace

import numpy as np
import pytest
from analysis_scripts import load
from numpy.polynomial.legendre import leggauss
from scipy import integrate, stats

import weberwhisk as ww
from weberwhisk.cues import Compliance
from weberwhisk.receptors import Afferents, SpikeCount, Weber
from weberwhisk.sensitivity import fisher_jnd, weber_propagation

weber_law = load("receptors").weber_law

SLOW, RAPID = Afferents(75, 1e-8, 1e-5), Afferents(25, 1e-6, 1e-3)
POPULATIONS = {
    "both": SpikeCount(SLOW, RAPID),
    "slow": SpikeCount(SLOW, window=0.1),
    "rapid": SpikeCount(rapid=RAPID, rise_time=0.02, window=0.015),
    "silent at rest": SpikeCount(replace(SLOW, spontaneous_rate=0.0)),
    "noisy at rest": SpikeCount(replace(SLOW, spontaneous_rate=60.0)),
    "random gain": SpikeCount(SLOW, RAPID, gain_sd=0.5),
    "steep": SpikeCount(replace(SLOW, exponent=3.0, number=150)),
}
every_population = pytest.mark.parametrize("noise", POPULATIONS.values(), ids=POPULATIONS)


def test_counts_are_scipys_poisson_and_negative_binomial():
    signals = np.array([[2e-8], [3e-7]])
    for gain_sd in (0.0, 0.3):
        noise = SpikeCount(Afferents(4, 1e-8, 1e-6), Afferents(2, 1e-6, 1e-5), gain_sd=gain_sd)
        counts, mean = noise.sample(signals, seed=1), noise.mean(signals)
        if gain_sd:
            shape = gain_sd**-2
            expected = stats.nbinom.logpmf(counts, shape, shape / (shape + mean))
        else:
            expected = stats.poisson.logpmf(counts, mean)
        assert np.allclose(noise.log_likelihood(counts, signals), expected.sum(axis=1), rtol=1e-12)


# -- Weber's law ----------------------------------------------------------------------------------


@every_population
def test_webers_law_holds_in_the_middle_of_the_thresholds(noise):
    """The sum over evenly spaced afferents is a trapezoid rule, exponentially close to flat."""
    signals = np.geomspace(1e-7, 4e-7, 40)[:, None]
    k = noise.effective_weber_fraction(signals)[:, 0]
    assert np.ptp(k) < 2e-2 * k.mean()
    # The same from the integral over ln c of one afferent's information, by SciPy.
    total = 0.0
    for part, time in noise._classes:
        peak = part.peak_rate * time
        rest = part.spontaneous_rate * noise.window

        def information(log_ratio, part=part, peak=peak, rest=rest):
            s = 1 / (1 + np.exp(-part.exponent * log_ratio))
            mean = rest + peak * s
            slope = peak * part.exponent * s * (1 - s)
            return slope**2 / (mean + (noise.gain_sd * mean) ** 2)

        density = (part.number - 1) / np.log(np.divide(part.highest, part.lowest))
        total += density * integrate.quad(information, -25, 25)[0]
    wide = SpikeCount(
        *(
            part and replace(part, lowest=part.lowest * 1e-6, highest=part.highest * 1e6,
                             number=5 * (part.number - 1) + 1)
            for part in (noise.slow, noise.rapid)
        ),
        window=noise.window,
        rise_time=noise.rise_time,
        gain_sd=noise.gain_sd,
    )  # fmt: skip
    assert wide.effective_weber_fraction([2e-7])[0] == pytest.approx(total**-0.5, rel=1e-6)
    assert weber_law(wide, np.array([2e-7]))[0] == pytest.approx(total**-0.5, rel=1e-6)


def test_the_plateau_is_the_closed_form_of_the_notes():
    noise = SpikeCount(replace(SLOW, lowest=1e-14, highest=1.0, number=401, spontaneous_rate=0.0))
    density, peak, n = 400 / np.log(1e14), 150 * 0.05, 2.0
    k = np.sqrt(2 / (density * peak * n))
    assert noise.effective_weber_fraction([1e-7])[0] == pytest.approx(k, rel=1e-9)
    assert weber_law(noise, np.array([1e-7]))[0] == pytest.approx(k, rel=1e-9)


@every_population
def test_the_closed_form_follows_the_population_to_both_ends(noise):
    signals = np.geomspace(1e-10, 1e-3, 60)
    ratio = weber_law(noise, signals) / noise.effective_weber_fraction(signals[:, None])[:, 0]
    assert np.abs(ratio - 1).max() < 0.03


@pytest.mark.parametrize("exponent", [1.0, 2.0])
def test_webers_law_stops_where_the_thresholds_do(exponent):
    """k goes as I^(−n/2) below them, as I⁻ⁿ once spontaneous spikes take over, as Iⁿ above."""

    def power(spontaneous_rate, signal):
        noise = SpikeCount(replace(SLOW, exponent=exponent, spontaneous_rate=spontaneous_rate))
        low, high = noise.effective_weber_fraction(np.array([[signal], [2 * signal]]))[:, 0]
        return np.log2(high / low)

    assert power(0.0, 1e-8 * 1e-5) == pytest.approx(-exponent / 2, abs=1e-3)
    assert power(5.0, 1e-8 * 1e-5) == pytest.approx(-exponent, abs=1e-2)
    assert power(5.0, 1e-5 * 1e5) == pytest.approx(exponent, abs=1e-3)
    assert SpikeCount(SLOW).effective_weber_fraction([0.0])[0] == np.inf
    assert SpikeCount(SLOW).fisher([0.0])[0, 0] == 0


# -- observers ------------------------------------------------------------------------------------

W = ww.Whisker(50e-3, 100e-6, 5e-6)
UNIT = float(W.compliance_constant / W.length)
OBSERVED = {
    "both": SpikeCount(Afferents(30, 0.01 * UNIT, 100 * UNIT), Afferents(10, UNIT, 1e4 * UNIT)),
    "random gain": SpikeCount(
        Afferents(20, 0.1 * UNIT, 100 * UNIT, spontaneous_rate=0.0), gain_sd=0.3
    ),
    "saturated": SpikeCount(Afferents(10, 0.1 * UNIT, 1 * UNIT)),
}


@pytest.mark.parametrize("noise", OBSERVED.values(), ids=OBSERVED)
def test_quadrature_agrees_with_brute_force(noise):
    observer = ww.Observer(W, Compliance(), noise)
    counts = observer.read(np.array([[0.05], [0.3], [0.7], [0.95]]) * W.length, seed=2)
    found = ww.posterior(observer, counts)
    assert not np.any(found.status == ww.Status.IMPROBABLE_READING)
    x, w = leggauss(6)
    edges = np.concatenate([[0.0], np.geomspace(1e-6, 1e-2, 200), np.linspace(0.011, 1.0, 1200)])
    edges *= W.length
    half = np.diff(edges) / 2
    r = ((edges[:-1] + half)[:, None] + half[:, None] * x).ravel()
    log = observer.log_likelihood(counts[:, None], r[:, None])
    weight = np.exp(log - log.max(axis=1, keepdims=True)) * (half[:, None] * w).ravel()
    weight /= weight.sum(axis=1, keepdims=True)
    mean = weight @ r
    sd = np.sqrt((weight * (r - mean[:, None]) ** 2).sum(axis=1))
    assert np.all(np.abs(found.mean - mean) < 2e-3 * sd)
    assert np.all(np.abs(found.sd / sd - 1) < 2e-3)


@pytest.mark.slow  # the posterior of counts: tests/inference/test_tree.py
def test_the_posterior_is_that_of_webers_law_with_the_effective_k():
    """On a cylinder M ∝ 1/r: ln r is known as well as ln M."""
    w = W.cylinder()
    noise = SpikeCount(
        Afferents(301, 1e-3 * UNIT, 1e3 * UNIT), Afferents(101, 0.1 * UNIT, 1e5 * UNIT)
    )
    contact = np.full((400, 1), 0.3 * w.length)
    observer = ww.Observer(w, Compliance(), noise)
    k = noise.effective_weber_fraction(observer.signals(contact[0])[0])[0]
    assert k == pytest.approx(0.08, abs=0.01)
    # Weber's own Fisher information has the 2 of the spread on top.
    weber = ww.Observer(w, Compliance(), Weber(1 / np.sqrt(k**-2 - 2)))
    sds = [ww.posterior(o, o.read(contact, seed=3)).sd for o in (observer, weber)]
    error = np.hypot(*(sd.std() / np.sqrt(len(sd)) for sd in sds))
    assert error < 0.01 * sds[0].mean()
    # … and the next order, k², is of no interest here.
    assert abs(sds[0].mean() - sds[1].mean()) < 4 * error + k**2 * sds[1].mean()


def test_the_linear_jnd_of_poisson_counts_is_fishers():
    """Both are Σ μ'²/μ: Poisson counts inform by their mean alone."""
    contact = np.array([[0.2], [0.6], [0.9]]) * W.length
    observer = ww.Observer(W, Compliance(), OBSERVED["both"])
    assert np.allclose(weber_propagation(observer, contact), fisher_jnd(observer, contact))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: SpikeCount(), "needs afferents, got none"),
        (lambda: SpikeCount(SLOW, window=0), "window must be above zero, got 0"),
        (lambda: SpikeCount(SLOW, rise_time=-1), "rise_time must be above zero, got -1"),
        (lambda: SpikeCount(SLOW, gain_sd=-1), "gain_sd must not be negative, got -1"),
        (lambda: Afferents(0, 1, 2), "number must be a whole number of 1 or more, got 0"),
        (lambda: Afferents(2.5, 1, 2), "number must be a whole number of 1 or more, got 2.5"),
        (lambda: Afferents(2, 2, 1), "highest must not lie below lowest, got 1.0 below 2.0"),
        (lambda: Afferents(2, 0, 1), "lowest must be above zero, got 0"),
        (lambda: Afferents(2, 1, 2, peak_rate=0), "peak_rate must be above zero"),
        (lambda: Afferents(2, 1, 2, peak_rate=[80.0, 90.0]), "peak_rate must be one number"),
        (lambda: Afferents(2, 1, 2, exponent=0), "exponent must be above zero"),
        (lambda: Afferents(2, 1, 2, spontaneous_rate=-1), "spontaneous_rate must not be negative"),
        (lambda: SpikeCount(Afferents(1, 1, 1)).log_likelihood([1.5], [1.0]), "whole .* got 1.5"),
        (
            lambda: SpikeCount(Afferents(1, 1, 1)).log_likelihood([-1], [1.0]),
            "not negative, got -1",
        ),
        (
            lambda: SpikeCount(Afferents(1, [1, 2], 3)).mean([1.0]),
            "thresholds for 2 signals, got 1",
        ),
    ],
)
def test_nonsense_is_refused(make, words):
    with pytest.raises(ValueError, match=words):
        make()
