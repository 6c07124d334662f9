"""Vibrissa length (§2a): a touch with the tip, with the shaft, or none."""

import numpy as np
import pytest
from cue_checks import moments_by_midpoints
from scipy import stats

import weberwhisk as ww
from weberwhisk import Outcome
from weberwhisk.cues import Cue, VibrissaLength
from weberwhisk.sensitivity import fisher_jnd, weber_propagation

W = ww.Whisker(50e-3, 100e-6, 5e-6)
CUES = [
    VibrissaLength(),
    VibrissaLength(spread=0.02),
    VibrissaLength(spread=0.1, damage=0.3, tip_zone=0.2, reach=2.0),
]
EVERY = pytest.mark.parametrize("cue", CUES, ids=repr)
NONE, TIP, SHAFT = VibrissaLength.reports


@EVERY
def test_it_keeps_the_protocol(cue):
    assert isinstance(cue, Cue)
    r = np.linspace(0.02, 1, 99)[:, None] * cue.farthest(W)
    chances, outcome = cue.signals(W, r)
    assert chances.shape == (99, 2)
    assert np.all(outcome == Outcome.HELD)
    assert np.all(chances >= 0)
    assert np.all(chances.sum(axis=1) <= 1)


@EVERY
def test_chances_are_those_of_whiskers_drawn_at_random(cue):
    n, rng = 200_000, np.random.default_rng(1)
    sigma = np.sqrt(np.log1p(cue.spread**2))
    length = W.length * np.exp(sigma * rng.standard_normal(n) - sigma**2 / 2)
    assert length.mean() == pytest.approx(W.length, rel=2e-3)
    assert length.std() == pytest.approx(cue.spread * W.length, rel=2e-2)
    length = np.where(rng.random(n) < cue.damage, rng.random(n) * length, length)
    for r in np.array([0.3, 0.8, 0.95, 1.2]) * W.length:
        none, tip = cue.signals(W, np.array([r]))[0]
        for p, share in (
            (none, np.mean(length < r)),
            (tip, np.mean((length >= r) & (r > length * (1 - cue.tip_zone)))),
        ):
            assert share == pytest.approx(p, abs=4.5 * np.sqrt(p * (1 - p) / n) + 1e-9)


@EVERY
@pytest.mark.parametrize("event", [NONE, TIP, SHAFT])
def test_the_posterior_is_the_brute_force_integral(cue, event):
    observer = ww.Observer(W, cue)
    p = ww.posterior(observer, event)
    mean, sd = moments_by_midpoints(observer, event)
    assert p.status == 0
    assert p.mean == pytest.approx(mean, abs=2e-3 * sd)
    assert p.sd == pytest.approx(sd, rel=2e-3)
    assert max(p.mean_error, p.sd_error) < 2e-3 * p.sd


def test_the_shafts_posterior_has_the_closed_form_of_a_log_normal_length():
    """Flat prior: ∫rⁿP(length(1 − zone) > r)dr = E[(length(1 − zone))ⁿ⁺¹]/(n + 1)."""
    cue = VibrissaLength(spread=0.1, reach=3.0)  # so far that nothing is cut off
    length = stats.lognorm(np.sqrt(np.log1p(0.01)), scale=0.9 * W.length / np.sqrt(1.01))
    first, second, third = (length.moment(n) for n in (1, 2, 3))
    mean = second / (2 * first)
    p = ww.posterior(ww.Observer(W, cue), SHAFT)
    sd = np.sqrt(third / (3 * first) - mean**2)
    assert p.mean == pytest.approx(mean, abs=2e-3 * sd)
    assert p.sd == pytest.approx(sd, rel=2e-3)


@pytest.mark.parametrize(
    ("event", "low", "high"), [(NONE, 1.0, 1.5), (TIP, 0.9, 1.0), (SHAFT, 0.0, 0.9)]
)
def test_a_known_length_leaves_an_interval(event, low, high):
    p = ww.posterior(ww.Observer(W, VibrissaLength(spread=1e-4)), event)
    sd = (high - low) / np.sqrt(12) * W.length
    assert p.mean == pytest.approx((low + high) / 2 * W.length, abs=2e-3 * sd)
    assert p.sd == pytest.approx(sd, rel=2e-3)
    assert p.interval(0.95) == pytest.approx(
        (low + (high - low) * np.array([0.025, 0.975])) * W.length, abs=1e-2 * sd
    )


def test_one_event_has_a_posterior_but_no_linear_jnd():
    observer = ww.Observer(W, VibrissaLength())
    table = ww.jnd_curve(observer, np.array([5e-3, 45e-3, 70e-3]), n_readings=300, seed=1)
    assert table[["closed_form", "propagation"]].isna().all(axis=None)
    # The mean sd is the chances' mean of three posteriors'.
    sd = [float(ww.posterior(observer, event).sd) for event in (NONE, TIP, SHAFT)]
    chances = observer.signals(np.array([[5e-3], [45e-3], [70e-3]]))[0]
    chances = np.concatenate([chances, 1 - chances.sum(axis=1, keepdims=True)], axis=1)
    error = table["posterior_error"].to_numpy()
    assert np.all(np.abs(table["posterior"] - chances @ sd) < 4.5 * error + 1e-9)
    assert weber_propagation(observer, 45e-3).shape == ()
    # Deep inside the whisker a touch of the shaft is certain: no information.
    assert fisher_jnd(observer, [2e-3]) > 10 * W.length


def test_it_says_where_it_does_not_work():
    cue = VibrissaLength()
    r, outcome = cue.radial_distance(W, [TIP, SHAFT, NONE])
    assert r[0] == pytest.approx(0.95 * W.length)
    assert np.isnan(r[1:]).all()
    assert outcome.tolist() == [Outcome.HELD, Outcome.TIP_NOT_TOUCHED, Outcome.NO_TOUCH]
    chances, outcome = cue.signals(W, np.array([[cue.farthest(W) * 1.01], [-1e-3]]))
    assert np.isnan(chances).all()
    assert np.all(outcome == Outcome.OUT_OF_REACH)
    table = ww.jnd_curve(ww.Observer(W, cue), 90e-3, n_readings=3, seed=1)
    assert table["outcome"][0].startswith("out of reach")


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: VibrissaLength(spread=0), "spread must be above zero"),
        (lambda: VibrissaLength(damage=-0.1), "damage must not be negative"),
        (lambda: VibrissaLength(damage=1.0), "damage must be below 1"),
        (lambda: VibrissaLength(tip_zone=1.5), "tip_zone must be below 1"),
        (lambda: VibrissaLength(reach=0.9), "beyond the whisker's tip, got reach=0.9"),
    ],
)
def test_misuse_is_refused_in_one_sentence(make, words):
    with pytest.raises(ValueError, match=words) as error:
        make()
    assert "\n" not in str(error.value)
