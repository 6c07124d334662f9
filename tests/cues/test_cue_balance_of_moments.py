"""Balance of moments (§2h): the angle at which muscle and whisker balance, effort known or felt."""

import numpy as np
import pytest
from cue_checks import moments_by_midpoints
from short_forms import slow_but

import weberwhisk as ww
from weberwhisk import Outcome
from weberwhisk.cues import BalanceOfMoments, Cue, MuscleCurve
from weberwhisk.mechanics import closed_form
from weberwhisk.receptors import GeneralisedWeber
from weberwhisk.sensitivity import prior_draws, weber_propagation

W = ww.Whisker(50e-3, 100e-6, 5e-6)
KNOWN, FELT = BalanceOfMoments(), BalanceOfMoments(effort=None)
LATE = BalanceOfMoments(np.radians(120), effort=0.6, curve=MuscleCurve.NORMALISED)


def felt_contacts(n, seed, cue=FELT, whisker=W):
    """Contacts drawn from the prior, flat over all that balance."""
    rng = np.random.default_rng(seed)
    r = rng.uniform(0, 1, 20 * n) * whisker.length
    theta = rng.uniform(0, np.nanmax(cue.largest_angle(whisker, r)), r.size)
    contact = np.stack([r, theta], axis=-1)
    return contact[cue.signals(whisker, contact)[1] == Outcome.HELD][:n]


@pytest.mark.parametrize("cue", [KNOWN, FELT, LATE], ids=repr)
def test_it_keeps_the_protocol(cue):
    assert isinstance(cue, Cue)
    contact = felt_contacts(100, 1, cue)[:, : len(cue.unknowns)]
    signals, outcome = cue.signals(W, contact)
    assert signals.shape == (100, len(cue.signal_names))
    assert np.array_equal(np.isfinite(signals).all(axis=1), outcome == Outcome.HELD)


@pytest.mark.parametrize("cue", [KNOWN, LATE], ids=repr)
@pytest.mark.parametrize("model", [None, "closed_form"])
def test_the_balance_is_one_from_the_base_to_the_last(cue, model):
    """Three Newton steps from a table, or brackets: either way the effort is the known one."""
    last = _last(cue, model)
    share = np.concatenate([np.geomspace(1e-9, 0.1, 50), 1 - np.geomspace(1e-9, 0.9, 200)])
    r = share * last
    angle, outcome = cue.signals(W, r[:, None], model=model)
    assert (outcome == Outcome.HELD).all()
    assert np.allclose(cue._effort(W, r, angle[:, 0], model), cue.effort, rtol=1e-11, atol=0)


def _last(cue, model):
    r = np.linspace(0.01, 1, 5000) * W.length
    held = cue.signals(W, r[:, None], model=model)[1] == Outcome.HELD
    return r[held].max()


def test_figure_3s_whisker_holds_as_far_as_the_paper_says():
    """§2h: "flick past the object when contact occurred at around 70 per cent"."""
    assert KNOWN.farthest(W) / W.length == pytest.approx(0.697, abs=1e-4)


def test_the_edge_is_where_effort_peaks():
    r = np.linspace(0.05, 0.95, 15) * W.length
    edge = FELT.largest_angle(W, r)
    for at, top in zip(r, edge, strict=True):
        theta = np.linspace(0.002, 0.9999, 3000) * ww.flick_past(W, at).deflection_angle
        moment = ww.press(W, at, theta).normalised_moment
        effort = FELT.curve.gain() * moment / FELT.curve.moment(FELT.impact_angle + theta)
        assert theta[effort.argmax()] == pytest.approx(top, rel=2e-3)


def test_the_jnd_is_the_angles_noise_over_its_slope():
    """Small angle: gain·3θ(L/r − L/A) = effort·curve, so that dθ/dr = θ/r·1/(1 − r/A)."""
    noise = GeneralisedWeber(0.0, floor=0.01)
    cue = BalanceOfMoments(np.radians(113), gain=20.0)  # the muscle at its flat top, held early
    r = np.array([10e-3, 30e-3])
    theta = cue.signals(W, r[:, None], model="closed_form")[0][:, 0]
    expected = 0.01 / theta * r * (1 - r / W.apex_distance)
    jnd = weber_propagation(ww.Observer(W, cue, noise), r[:, None])
    assert jnd == pytest.approx(expected, rel=0.02)
    moment = closed_form.moment(W, r, theta) / W.moment_scale
    assert 20 * moment == pytest.approx(cue.curve.moment(np.radians(113) + theta), rel=1e-9)


def test_the_posterior_has_the_closed_forms_sd_where_the_noise_is_small():
    observer = ww.Observer(W, KNOWN, GeneralisedWeber(0.0, floor=np.radians(0.02)))
    table = ww.jnd_curve(observer, np.array([5e-3, 15e-3, 30e-3]), n_readings=200, seed=1)
    assert np.all(table["unreliable"] == 0)
    off = np.abs(table["posterior"] - table["propagation"])
    assert np.all(off < 4 * table["posterior_error"] + 1e-3 * table["propagation"])
    assert np.all(
        np.abs(table["estimator"] - table["propagation"]) < 4.5 * table["estimator_error"]
    )


@pytest.mark.parametrize("cue", slow_but([KNOWN, LATE], (1,)), ids=repr)
def test_the_posterior_is_the_brute_force_integral(cue):
    observer = ww.Observer(W, cue)
    for share in (0.2, 0.9):
        reading = observer.read([share * cue.farthest(W)], seed=4)
        p = ww.posterior(observer, reading)
        mean, sd = moments_by_midpoints(observer, reading, 20_001)
        assert p.status == 0
        assert p.mean == pytest.approx(mean, abs=1e-4 * sd)
        assert p.sd == pytest.approx(sd, rel=1e-4)


@pytest.mark.slow  # of balances: above
def test_the_posterior_with_a_felt_effort_is_the_brute_force_integral():
    observer = ww.Observer(W, FELT)
    reading = observer.read([25e-3, 0.1], seed=4)
    p = ww.posterior(observer, reading, tolerance=1e-4)
    n = 1000
    r = (np.arange(n) + 0.5) / n * W.length
    theta = (np.arange(n) + 0.5) / n * 0.25  # 0.25 rad: 8 sd and more above the reading
    weight = np.zeros(n)
    for part in np.array_split(np.arange(n), 10):
        contact = np.stack(np.meshgrid(r[part], theta, indexing="ij"), axis=-1)
        weight[part] = np.exp(observer.log_likelihood(reading, contact)).sum(axis=1)
    mean = weight @ r / weight.sum()
    sd = np.sqrt(weight @ (r - mean) ** 2 / weight.sum())
    assert p.status == 0
    assert p.mean == pytest.approx(mean, abs=1e-4 * sd)
    assert p.sd == pytest.approx(sd, rel=1e-4)


def test_it_says_where_it_does_not_work():
    def names(cue, *contact):
        return Outcome(int(cue.signals(W, np.array(contact))[1])).name

    assert names(KNOWN, 34e-3) == "HELD"
    assert names(KNOWN, 35e-3) == "FLICKED_PAST"
    assert names(KNOWN, 51e-3) == "OUT_OF_REACH"
    # The harder the muscle pushes, the nearer the whisker flicks past.
    reach = [BalanceOfMoments(effort=e).farthest(W) for e in (0.1, 0.5, 1.0, 2.0)]
    assert np.all(np.diff(reach) < 0)
    late = BalanceOfMoments(np.radians(145))
    assert names(late, 30e-3) == "END_OF_WHISKING"
    assert names(BalanceOfMoments(np.radians(145), effort=None), 20e-3, 0.1) == "END_OF_WHISKING"
    edge = float(FELT.largest_angle(W, np.array(25e-3)))
    assert names(FELT, 25e-3, edge * 0.999) == "HELD"
    assert names(FELT, 25e-3, edge * 1.001) == "FLICKED_PAST"
    table = ww.jnd_curve(ww.Observer(W, late), 30e-3, n_readings=3, seed=1)
    assert table["outcome"][0].startswith("end of whisking")


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: BalanceOfMoments(3.0), "impact_angle must be in the range of whisking"),
        (lambda: BalanceOfMoments(1.8, whisking=(0.5, 3.6)), "go up between 0 and π"),
        (lambda: BalanceOfMoments(effort=0.0), "effort must be above zero"),
        (lambda: BalanceOfMoments(gain=-1.0), "gain must be above zero"),
        (
            lambda: ww.Observer(W, BalanceOfMoments(np.radians(149.99), effort=50.0)),
            "No contact balances an effort of 50",
        ),
    ],
)
def test_misuse_is_refused_in_one_sentence(make, words):
    with pytest.raises(ValueError, match=words) as error:
        make()
    assert "\n" not in str(error.value)


def test_the_edge_is_known_where_some_curvatures_reach_no_further():
    """Their largest angle was NaN, which the muscle's curve refused."""
    w = ww.Whisker(50e-3, 100e-6, 5e-6, curvature=5.0)
    observer = ww.Observer(w, ww.cues.UnknownCurvature(FELT, 3.0), ww.receptors.Weber(0.1))
    draws = prior_draws(observer, 50, seed=1)
    assert (observer.signals(draws)[1] == 0).all()
