"""Comparative vibrissa length (§2b): which whiskers of an array touch, and which do not."""

import numpy as np
import pytest
from cue_checks import moments_by_midpoints
from short_forms import slow_but

import weberwhisk as ww
from weberwhisk import Outcome
from weberwhisk.cues import ComparativeLength, Cue
from weberwhisk.sensitivity import weber_propagation

W = ww.Whisker(33.6e-3, 60e-6, 3e-6)
PAIR = ComparativeLength([41.9e-3], [[-1e-3, 2e-3]])
ROW = ComparativeLength(
    [41.9e-3, 24.3e-3],
    [[-3e-3, 1e-3], [3e-3, -1e-3]],
    sweeps=np.radians([[-50, 60], [-60, 45], [-30, 80]]),
)
EIGHT = ComparativeLength(
    np.linspace(20e-3, 45e-3, 7),
    np.stack([np.linspace(5e-3, -6e-3, 7), np.linspace(-6e-3, 6e-3, 7)], axis=-1),
    poses=3,
)
EVERY = pytest.mark.parametrize("cue", [PAIR, ROW, EIGHT], ids=["pair", "row", "eight"])


def sure(lengths, bases, **options):
    """An array of which everything is known."""
    tiny = {"spread": 1e-4, "base_sd": 1e-9, "angle_sd": 1e-4}
    return ComparativeLength(lengths, bases, position_sd=0.0, orientation_sd=0.0, **tiny, **options)


@EVERY
def test_it_keeps_the_protocol(cue):
    assert isinstance(cue, Cue)
    r = np.linspace(0.02, 1, 40)[:, None] * cue.farthest(W)
    chances, outcome = cue.signals(W, r)
    assert chances.shape == (40, 2 ** (len(cue.lengths) + 1) - 1)
    assert len(cue.signal_names) == chances.shape[1]
    assert np.all(outcome == Outcome.HELD)
    assert np.all(chances >= 0)
    assert np.all(chances.sum(axis=1) <= 1 + 1e-12)


@pytest.mark.parametrize("cue", slow_but([PAIR, ROW], (1,)), ids=["pair", "row"])
def test_chances_are_those_of_arrays_drawn_at_random(cue):
    """Poses, lengths, bases and sectors drawn and the geometry done whisker by whisker."""
    n, rng = 200_000, np.random.default_rng(1)
    sigma = np.sqrt(np.log1p(cue.spread**2))
    bases = np.concatenate([[[0.0, 0.0]], cue.bases])
    for r in (12e-3, 26e-3, 33e-3, 44e-3):
        turn = cue.orientation_sd * rng.standard_normal(n)
        shift = cue.position_sd * rng.standard_normal((n, 2))
        pole = r * np.exp(-1j * turn) + shift @ [1, 1j]
        report = np.zeros((n, len(bases)))
        for k, length in enumerate([W.length, *cue.lengths]):
            base = bases[k] + cue.base_sd * rng.standard_normal((n, 2))
            reach = length * np.exp(sigma * rng.standard_normal(n) - sigma**2 / 2)
            seen = pole - base @ [1, 1j]
            ends = cue.sweeps[k] + cue.angle_sd * rng.standard_normal((n, 2))
            angle = np.angle(seen)
            report[:, k] = (abs(seen) <= reach) & (ends[:, 0] <= angle) & (angle <= ends[:, 1])
        chances, _ = cue.signals(W, np.array([r]))
        for p, pattern in zip(chances, cue.reports, strict=False):
            share = np.mean((report == pattern).all(axis=1))
            # First order in the bases' errors over the distance: 0.3 % of chance.
            assert share == pytest.approx(p, abs=4.5 * np.sqrt(p * (1 - p) / n) + 3e-3)


def test_a_longer_whisker_that_touches_alone_puts_the_object_between_the_lengths():
    """§2b, with bases side by side and everything known: an interval."""
    cue = sure([45e-3], [[0.0, 1e-5]])
    p = ww.posterior(ww.Observer(W, cue), [0, 1])
    sd = (45e-3 - W.length) / np.sqrt(12)
    assert p.mean == pytest.approx((W.length + 45e-3) / 2, abs=2e-3 * sd)
    assert p.sd == pytest.approx(sd, rel=2e-3)
    low, high, outcome = cue.interval(W, [0, 1])
    assert (low, high) == pytest.approx((W.length, 45e-3), rel=1e-6)
    assert outcome == Outcome.HELD
    assert cue.interval(W, [1, 0])[2] == Outcome.CONTRADICTORY
    assert cue.interval(W, [0, 0]) == pytest.approx((45e-3, 67.5e-3, Outcome.NO_TOUCH), rel=1e-6)


def test_a_shorter_whisker_can_touch_what_a_longer_one_does_not():
    """§2b: "several geometric conditions in which a short vibrissa might contact an object"."""
    # The longer one's base is further back than it is longer.
    behind = sure([45e-3], [[-20e-3, 0.0]])
    low, high, outcome = behind.interval(W, [1, 0])
    assert (low, high) == pytest.approx((25e-3, W.length))
    assert outcome == Outcome.HELD
    r = np.array([30e-3])
    assert behind.signals(W, r)[0][2] == pytest.approx(1, abs=1e-9)  # the shorter alone
    p = ww.posterior(ww.Observer(W, behind), [1, 0])
    assert p.interval(0.95) == pytest.approx([25.215e-3, 33.385e-3], abs=2.5e-5)
    # The longer one is not swept so far forward: its sector ends before the object's direction.
    beside = sure([45e-3], [[0.0, -5e-3]], sweeps=np.radians([[-60, 60], [-60, 20]]))
    cut = 5e-3 / np.tan(np.radians(20))  # nearer than this the object is past its sector
    assert beside.interval(W, [1, 0])[:2] == pytest.approx((0, cut), rel=1e-6)
    assert beside.signals(W, np.array([10e-3]))[0][2] == pytest.approx(1, abs=1e-9)


def test_a_pole_beside_the_bases_may_be_behind_some_of_the_whiskers():
    """Two places for one pattern: short whiskers stop short of the one, stand before the other."""
    p = ww.posterior(ww.Observer(W, EIGHT), [1, 0, 0, 0, 1, 1, 1, 1])
    low, middle, high = p.quantile([0.1, 0.4, 0.9])
    assert low < 5e-3
    assert 25e-3 < middle < high < 35e-3


@EVERY
def test_the_posterior_is_the_brute_force_integral(cue):
    observer = ww.Observer(W, cue)
    for touches in observer.read(np.array([[10e-3], [30e-3], [40e-3]]), seed=2):
        p = ww.posterior(observer, touches)
        mean, sd = moments_by_midpoints(observer, touches, 4001)
        assert p.status == 0
        assert p.mean == pytest.approx(mean, abs=2e-3 * sd)
        assert p.sd == pytest.approx(sd, rel=2e-3)


def test_one_event_has_a_posterior_but_no_linear_jnd():
    observer = ww.Observer(W, ROW)
    r = np.array([15e-3, 33e-3])
    table = ww.jnd_curve(observer, r, n_readings=200, seed=1)
    assert table[["closed_form", "propagation"]].isna().all(axis=None)
    assert np.isnan(weber_propagation(observer, r[:, None])).all()
    chance = np.array([observer.signals([[a]])[0][0] for a in r])
    chance = np.concatenate([chance, 1 - chance.sum(axis=1, keepdims=True)], axis=1)
    sd = ww.posterior(observer, ROW.reports).sd
    error = table["posterior_error"].to_numpy()
    assert np.all(
        np.abs(table["posterior"] - chance @ sd) < 4.5 * error + 1e-6
    )  # m: chances of 1e-5 are not drawn


def test_it_says_where_it_does_not_work():
    chances, outcome = ROW.signals(W, np.array([[ROW.farthest(W) * 1.001], [0.0]]))
    assert np.isnan(chances).all()
    assert np.all(outcome == Outcome.OUT_OF_REACH)
    low, high, outcome = PAIR.interval(W, [1, 0])
    assert np.isnan([low, high]).all()
    assert outcome == Outcome.CONTRADICTORY


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: ComparativeLength([], np.zeros((0, 2))), "1 to 7 neighbours"),
        (lambda: ComparativeLength(np.ones(8), np.zeros((8, 2))), "1 to 7 neighbours"),
        (lambda: ComparativeLength([4e-2], [1e-3, 0.0]), "bases must have shape"),
        (lambda: ComparativeLength([4e-2], [[0, 0]], sweeps=[[0, 1]]), "sweeps must be 2 rows"),
        (
            lambda: ComparativeLength([4e-2], [[0, 0]], sweeps=[[0, 1], [1, 0]]),
            "sweeps must be 2 rows",
        ),
        (lambda: ComparativeLength([-4e-2], [[0, 0]]), "lengths must be above zero"),
        (lambda: ComparativeLength([4e-2], [[0, 0]], spread=0), "spread must be above zero"),
        (lambda: PAIR.interval(W, [1, 2]), "touches must be 2 numbers, 0 or 1"),
        (lambda: ww.posterior(ww.Observer(W, PAIR), [1.0, 0.5]), "No contact can give the reading"),
    ],
)
def test_misuse_is_refused_in_one_sentence(make, words):
    with pytest.raises(ValueError, match=words) as error:
        make()
    assert "\n" not in str(error.value)


def test_a_sweep_may_pass_half_a_turn_and_there_may_be_no_contacts():
    """Above the axis a neighbour that faces backwards touched never, below it always."""
    own = ww.Whisker(50e-3, 100e-6, 5e-6)
    small = {"angle_sd": 0.01, "orientation_sd": 0.01, "position_sd": 1e-4, "base_sd": 1e-4}
    back = [[-1, 1], [np.pi - 0.5, np.pi + 0.5]]
    for y in (1e-3, -1e-3):
        cue = ComparativeLength([40e-3], [[60e-3, y]], sweeps=back, **small)
        # Patterns 00, 01 and 10: what is left is that both touch.
        assert cue.signals(own, np.array([30e-3]))[0] == pytest.approx([0, 0, 0], abs=1e-6)
        assert cue.interval(own, [1, 1]) == pytest.approx((20e-3, 50e-3, 0), abs=2e-5)
    assert PAIR.signals(W, np.zeros((0, 1)))[0].shape == (0, 3)
    assert PAIR.jacobian(W, np.zeros((0, 1))).shape == (0, 3, 1)
