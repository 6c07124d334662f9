"""Events as receptor noise: what is told of chances when one of a few things happens."""

import numpy as np
import pytest

import weberwhisk as ww
from weberwhisk.cues import Compliance, Fused, VibrissaLength
from weberwhisk.receptors import Events, Weber
from weberwhisk.sensitivity import fisher_jnd, weber_propagation

W = ww.Whisker(50e-3, 100e-6, 5e-6)
ONE_HOT = Events([[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 0]])
BINARY = Events([[0, 0], [0, 1], [1, 0], [1, 1]], misreport=0.1)
CHANCE = np.array([0.1, 0.3, 0.15])
EVERY = pytest.mark.parametrize("noise", [ONE_HOT, BINARY], ids=["one-hot", "binary"])


@EVERY
def test_chances_of_all_reports_add_up_to_one(noise):
    log = noise.log_likelihood(noise.reports, CHANCE)
    assert np.exp(log).sum() == pytest.approx(1, rel=1e-14)


@EVERY
def test_moments_are_sums_over_the_reports(noise):
    weight = np.exp(noise.log_likelihood(noise.reports, CHANCE))
    mean = weight @ noise.reports
    off = noise.reports - mean
    assert noise.mean(CHANCE) == pytest.approx(mean, rel=1e-14)
    covariance = (weight[:, None] * off).T @ off
    assert noise.covariance(CHANCE) == pytest.approx(covariance, rel=1e-13, abs=1e-16)
    assert noise.sd(CHANCE) ** 2 == pytest.approx(np.diag(covariance), rel=1e-13)


@EVERY
def test_information_is_the_mean_square_of_the_score(noise):
    h = 1e-6
    score = np.stack(
        [
            noise.log_likelihood(noise.reports, CHANCE + h * e)
            - noise.log_likelihood(noise.reports, CHANCE - h * e)
            for e in np.eye(3)
        ],
        axis=-1,
    ) / (2 * h)
    weight = np.exp(noise.log_likelihood(noise.reports, CHANCE))
    assert noise.fisher(CHANCE) == pytest.approx((weight[:, None] * score).T @ score, rel=1e-7)


@EVERY
def test_samples_come_as_often_as_their_chances(noise):
    n = 100_000
    sample = noise.sample(np.broadcast_to(CHANCE, (n, 3)), seed=1)
    for report in noise.reports:
        p = np.exp(noise.log_likelihood(report, CHANCE))
        share = np.mean((sample == report).all(axis=-1))
        assert share == pytest.approx(p, abs=4.5 * np.sqrt(p * (1 - p) / n))


def test_a_reading_that_reports_no_event_is_refused():
    with pytest.raises(ValueError, match="No contact can give the reading"):
        ww.posterior(ww.Observer(W, VibrissaLength()), [0.0, 1.0])


def test_a_misreport_leaves_every_distance_possible():
    cue = VibrissaLength(spread=0.01)
    sure = ww.posterior(ww.Observer(W, cue), [1.0, 1.0])
    unsure = ww.posterior(ww.Observer(W, cue, Events(cue.reports, misreport=0.2)), [1.0, 1.0])
    # By hand: 1 − ε + ε/3 in the zone of a tenth of the whisker, ε/3 in the rest of 1.5 lengths.
    zone, rest = 0.1 * (1 - 0.2 + 0.2 / 3), 1.4 * 0.2 / 3
    assert unsure.sd > 5 * sure.sd
    expected = (zone * 0.95 + (1.5**2 / 2 - 0.1 * 0.95) * 0.2 / 3) / (zone + rest)
    assert unsure.mean == pytest.approx(expected * W.length, rel=1e-3)


def test_an_event_joins_a_force_in_a_fusion():
    both = ww.Observer(W, Fused(VibrissaLength(spread=0.05), Compliance()))
    touch, tap = (ww.Observer(W, cue) for cue in (VibrissaLength(spread=0.05), Compliance()))
    r = np.array([46e-3])
    assert weber_propagation(both, r) == pytest.approx(weber_propagation(tap, r), rel=1e-12)
    told = [fisher_jnd(observer, r) ** -2 for observer in (both, touch, tap)]
    assert told[0] == pytest.approx(told[1] + told[2], rel=1e-12)
    rate = tap.signals(r)[0]
    p = ww.posterior(both, [1.0, 1.0, *rate])
    at = (np.arange(100_000) + 0.5) / 100_000 * W.length
    log = touch.log_likelihood([1.0, 1.0], at[:, None]) + tap.log_likelihood(rate, at[:, None])
    weight = np.exp(log - log.max())
    assert p.status == 0
    assert p.mean == pytest.approx(weight @ at / weight.sum(), rel=1e-7)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Events([[1.0]]), "a row for each of two events or more"),
        (lambda: Events([[0], [1], [1]]), "3 events and 2 different rows"),
        (lambda: Events([[0], [1]], misreport=1.0), "misreport must be below 1"),
        (lambda: Events([[0], [1]], misreport=-0.1), "misreport must not be negative"),
        (lambda: Events([[0], [1]]).reading_size(2), "take 1 chances, got 2 signals"),
        (lambda: ww.Observer(W, VibrissaLength(), Weber(0.1)), "not what this noise reports"),
        (lambda: ww.Observer(W, Compliance(), Events([[0], [1]])), "not what this noise reports"),
        (
            lambda: ww.Observer(W, VibrissaLength(), Events([[0], [1]])),
            "take 1 chances, got 2 signals",
        ),
    ],
)
def test_misuse_is_refused_in_one_sentence(make, words):
    with pytest.raises(ValueError, match=words) as error:
        make()
    assert "\n" not in str(error.value)


def test_emcee_samples_each_event_once():
    """Readings that come again have the posterior of the first, in their own places."""
    observer = ww.Observer(W, VibrissaLength())
    readings = np.array([[1.0, 0.0], [0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 0.0]])
    p = ww.posterior(observer, readings, method="emcee", seed=1)
    exact = ww.posterior(observer, readings)
    assert np.abs(p.sd / exact.sd - 1).max() < 0.1
    for first, again in ((0, 2), (1, 4)):
        assert p.mean[first] == p.mean[again]
        assert np.array_equal(p.interval(0.95)[first], p.interval(0.95)[again])
    draws = p.solution.draws(8, 1)
    assert draws.shape[0] == 5
    assert np.array_equal(draws[0], draws[2])
    assert not np.array_equal(draws[0], draws[3])
