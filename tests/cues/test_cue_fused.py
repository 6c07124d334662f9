"""Several cues on one contact: the joint posterior, what each tells, and what they add."""

import numpy as np
import pytest
from cue_checks import (
    agrees_with_brute_force,
    keeps_the_protocol,
    prior_draws,
    small_noise_limit,
)
from short_forms import slow_but

import weberwhisk as ww
from weberwhisk import Outcome
from weberwhisk.cues import (
    Compliance,
    ForceMap,
    Fused,
    UnknownStiffness,
    Vibration,
    VibrissaLength,
)
from weberwhisk.receptors import Afferents, GeneralisedWeber, Joint, SpikeCount, Weber
from weberwhisk.sensitivity import bits as fusing
from weberwhisk.sensitivity import fisher_jnd, weber_propagation

W = ww.Whisker(length=50e-3, base_radius=100e-6, tip_radius=5e-6)
MAP_AND_TAP = Fused(ForceMap(), Compliance())
TWO_TAPS = Fused(Compliance(), Compliance())
SOFT = Fused(
    UnknownStiffness(Compliance()), UnknownStiffness(ForceMap(["moment", "transverse_force"]))
)
CUES = [
    MAP_AND_TAP,
    TWO_TAPS,
    Fused(Compliance(), Vibration(3, phase=True)),
    SOFT,
    Fused(Compliance(velocity_spread=0.3), Fused(Compliance(), Vibration())),
]


@pytest.mark.parametrize("cue", CUES, ids=repr)
def test_the_protocol_is_kept(cue):
    observer = ww.Observer(W, cue)
    contact = prior_draws(observer, 40, 1)
    contact[:, 0] = np.clip(contact[:, 0], 1e-3, 48e-3)
    contact[:, 1:] *= 0.97
    keeps_the_protocol(
        observer, contact[cue.signals(W, contact * [1.001, *np.ones(contact.shape[1] - 1)])[1] == 0]
    )


def test_unknowns_of_one_name_are_one_and_the_bounded_ones_come_first():
    fused = Fused(Compliance(velocity_spread=0.3), UnknownStiffness(ForceMap()), SOFT)
    assert fused.unknowns == (
        "radial_distance",
        "deflection_angle",
        "angular_velocity",
        "stiffness",
    )
    assert TWO_TAPS.signal_names == ("moment_rate_1", "moment_rate_2")
    contact = np.array([20e-3, 0.1, 4.0, 1.5])
    assert fused.part(fused.cues[1], contact).tolist() == [20e-3, 0.1, 1.5]


def test_what_one_cue_cannot_hold_the_fusion_cannot():
    fused = Fused(Vibration(), ForceMap())
    signals, outcome = fused.signals(W, np.array([[20e-3, 0.1], [45e-3, 1.0], [60e-3, 0.1]]))
    assert outcome.tolist() == [Outcome.HELD, Outcome.FLICKED_PAST, Outcome.OUT_OF_REACH]
    assert np.isnan(signals[1:]).all()
    assert np.isfinite(signals[0]).all()
    assert Fused(Compliance(tap_angle=0.4), Vibration()).farthest(W) < W.length


# -- noise -------------------------------------------------------------------------------------

BLOCKS = Joint(
    [
        Weber(0.1),
        GeneralisedWeber(0.2, floor=0.1, correlation=0.4),
        SpikeCount(Afferents(5, 0.1, 10.0)),
    ],
    sizes=[1, 2, 1],
)
SIGNALS = np.array([[1.0, 2.0, 3.0, 0.5], [0.3, 5.0, 0.7, 2.0]])


def test_joint_noise_is_each_models_own():
    parts = [SIGNALS[:, :1], SIGNALS[:, 1:3], SIGNALS[:, 3:]]
    reading = BLOCKS.sample(SIGNALS, seed=1)
    assert reading.shape == (2, BLOCKS.reading_size(4)) == (2, 8)
    pieces = np.split(reading, [1, 3], axis=-1)
    expected = sum(
        n.log_likelihood(y, s) for n, y, s in zip(BLOCKS.noises, pieces, parts, strict=True)
    )
    assert BLOCKS.log_likelihood(reading, SIGNALS) == pytest.approx(expected, rel=1e-12)
    start = 0
    for noise, part, piece in zip(BLOCKS.noises, parts, pieces, strict=True):
        rows = slice(start, start + piece.shape[-1])
        assert np.allclose(BLOCKS.covariance(SIGNALS)[:, rows, rows], noise.covariance(part))
        assert np.allclose(BLOCKS.mean(SIGNALS)[:, rows], noise.mean(part))
        assert np.allclose(BLOCKS.sd(SIGNALS)[:, rows], noise.sd(part))
        low, high = BLOCKS.interval(SIGNALS, 5.0)
        assert np.all(low[:, rows] == noise.interval(part, 5.0)[0])
        assert np.all(high[:, rows] == noise.interval(part, 5.0)[1])
        start = rows.stop
    assert BLOCKS.jacobian(SIGNALS).shape == (2, 8, 4)
    total = sum(
        n.fisher(s).trace(axis1=1, axis2=2) for n, s in zip(BLOCKS.noises, parts, strict=True)
    )
    assert BLOCKS.fisher(SIGNALS).trace(axis1=1, axis2=2) == pytest.approx(total)
    assert BLOCKS.fisher(SIGNALS)[:, 0, 1:] == pytest.approx(0)


# -- posteriors --------------------------------------------------------------------------------


@pytest.mark.parametrize("cue", slow_but(CUES[:3], (0,)), ids=repr)
def test_posteriors_agree_with_brute_force(cue):
    observer = ww.Observer(W, cue)
    agrees_with_brute_force(observer, observer.read(prior_draws(observer, 1, 5), 4))


def test_events_and_forces_are_fused():
    """The tip's touch with a tap: the posterior of both; propagation has the tap alone."""
    cue = Fused(Compliance(), VibrissaLength(spread=0.05))
    observer = ww.Observer(W, cue)
    readings = observer.read([[25e-3], [44e-3], [47e-3]], seed=3)
    agrees_with_brute_force(observer, readings)
    tap = ww.Observer(W, Compliance())
    assert ww.posterior(observer, readings[1]).sd < ww.posterior(tap, readings[1, :1]).sd
    assert weber_propagation(observer, 25e-3) == weber_propagation(tap, 25e-3)
    assert fisher_jnd(observer, 44e-3) < fisher_jnd(tap, 44e-3)


def test_posteriors_have_the_propagated_width_at_small_noise():
    observer = ww.Observer(W, MAP_AND_TAP, MAP_AND_TAP.joint(Weber(0.01), Weber(0.02)))
    small_noise_limit(observer, np.array([[20e-3, 0.2], [35e-3, 0.2]]), draws=50, bias=5e-3)


def _jnds(cue, contact):
    """Fisher JNDs of each cue of a fusion, combined as if they shared only distance; and fused."""
    observer = ww.Observer(W, cue)
    contact = np.atleast_2d(contact)
    each = np.stack([fisher_jnd(o, cue.part(o.cue, contact)) for o in fusing.alone(observer)])
    with np.errstate(divide="ignore"):
        optimal = np.sum(each**-2.0, axis=0) ** -0.5
    return each.min(axis=0), optimal, fisher_jnd(observer, contact)


def test_cues_that_share_distance_alone_combine_optimally():
    contact = np.stack([np.linspace(5e-3, 45e-3, 9), np.full(9, 0.1)], axis=-1)
    best, optimal, together = _jnds(MAP_AND_TAP, contact)
    assert np.allclose(together, optimal, rtol=1e-9)
    assert np.all(together < best)
    assert np.all(best / together <= np.sqrt(2) * (1 + 1e-9))


def test_cues_that_need_the_same_unknown_tell_more_together_than_optimal():
    """Moment and axial force: neither tells anything alone where the angle is unknown."""
    best, optimal, together = _jnds(
        Fused(ForceMap("moment"), ForceMap("axial_force")), [25e-3, 0.2]
    )
    assert np.isinf([best, optimal]).all()
    whole = fisher_jnd(ww.Observer(W, ForceMap()), [25e-3, 0.2])
    assert together[0] == pytest.approx(whole, rel=1e-9)


def test_cues_that_share_a_prior_tell_less_together_than_optimal():
    """The stiffness is as well known beforehand as it is, once and not for each cue."""
    best, optimal, together = _jnds(SOFT, [25e-3, 0.2, 1.0])
    assert optimal < 0.95 * together
    assert together < best


# -- bits --------------------------------------------------------------------------------------


@pytest.mark.parametrize("cue", slow_but([Compliance(), Vibration(2)], (0,)), ids=repr)
def test_information_is_that_of_a_brute_force_sum(cue):
    """I = ∫∫ p(r) p(y|r) ln(p(y|r)/p(y)) on a fine grid of distances and readings."""
    observer = ww.Observer(
        W, cue, GeneralisedWeber(0.2, floor=0.05 if cue.signal_names != ("moment_rate",) else 1e-6)
    )
    r = (np.arange(3000) + 0.5) / 3000 * W.length
    signals, _ = observer.signals(r[:, None])
    low, high = observer.noise.interval(signals[signals[:, 0] < np.quantile(signals, 0.98)], 6.0)
    y = np.concatenate([np.linspace(low.min(), high.max(), 4000)])
    density = np.exp(observer.noise.log_likelihood(y[:, None, None], signals))
    inside = density.sum(axis=0) * (y[1] - y[0]) > 0.999  # all but the nearest distances
    marginal = density.mean(axis=1, keepdims=True)
    ratio = np.log2(np.maximum(density, 1e-300) / np.maximum(marginal, 1e-300))
    told = ((density * ratio).sum(axis=0) * (y[1] - y[0]))[inside].mean()
    bits = ww.information(observer, n_readings=600, seed=1)
    # What the distances left out add is below their share of the most there is.
    assert abs(bits.value - told) < 4 * bits.error + 10 * np.mean(~inside)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: Fused(Compliance()), "two cues or more, got 1"),
        (lambda: TWO_TAPS.joint(Weber(0.1)), "Each of the 2 cues needs one noise model, got 1"),
        (lambda: Joint([Weber(0.1)], sizes=[1, 2]), "Every noise model needs"),
        (lambda: BLOCKS.sd([1.0, 2.0]), "This noise is of 4 signals, got 2"),
        (lambda: fusing.alone(ww.Observer(W, Compliance())), "Only a fusion has parts"),
        (
            lambda: fusing.alone(ww.Observer(W, TWO_TAPS, Weber(0.1))),
            "cue by cue",
        ),
        (
            lambda: ww.information(ww.Observer(W, Compliance()), n_readings=1),
            "n_readings must be a whole number of 2 or more",
        ),
    ],
)
def test_misuse_is_refused_in_one_sentence(call, words):
    with pytest.raises(ValueError, match=words) as error:
        call()
    assert "\n" not in str(error.value)
