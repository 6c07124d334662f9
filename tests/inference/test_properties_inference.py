"""Properties of receptors, observers, posteriors and JNDs: symmetries, bounds, round trips."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from property_strategies import POWERS, floats, logarithmic, scaled, whiskers

import weberwhisk as ww
from weberwhisk import Status, cues, receptors
from weberwhisk.mechanics.contact import Outcome
from weberwhisk.sensitivity import fisher_jnd, weber_propagation

FRACTION = logarithmic(1e-3, 1.0)  # Weber fractions
SIGNALS = st.lists(
    st.one_of(logarithmic(1e-12, 1e6), logarithmic(1e-12, 1e6).map(lambda x: -x)),
    min_size=1, max_size=6,
).map(lambda values: np.array(values)[:, None])  # fmt: skip


@st.composite
def noises(draw: st.DrawFn, of: float = 1.0) -> receptors.ReceptorNoise:
    """Any receptor model of one signal whose size is about `of`."""
    k = draw(FRACTION)
    kind = draw(st.integers(0, 4))
    size = of * draw(logarithmic(1e-3, 1e3))
    if kind == 0:
        return receptors.Weber(k)
    if kind == 1:
        return receptors.GeneralisedWeber(k, floor=k * size)
    if kind == 2:
        return receptors.Saturating(k, ceiling=size, floor=k * size)
    if kind == 3:
        return receptors.LogNormal(k)
    return receptors.SpikeCount(receptors.Afferents(8, size / 30, size * 30))


@given(noises(), SIGNALS, st.integers(0, 2**32 - 1))
def test_readings_are_finite_and_likely(
    noise: receptors.ReceptorNoise, signals: np.ndarray, seed: int
) -> None:
    reading = noise.sample(signals, seed)
    np.testing.assert_array_equal(reading, noise.sample(signals, seed))
    assert np.isfinite(reading).all()
    log = noise.log_likelihood(reading, signals)
    assert np.isfinite(log).all()
    sd = noise.sd(signals)
    assert (sd > 0).all()
    assert np.isfinite(noise.mean(signals)).all()
    information = noise.fisher(signals)
    assert np.isfinite(information).all()
    assert (information >= 0).all()
    low, high = noise.interval(signals, 3.0)
    wider = noise.interval(signals, 4.0)
    assert ((wider[0] <= low) & (low <= high) & (high <= wider[1])).all()


@given(FRACTION, SIGNALS, POWERS, st.integers(0, 2**32 - 1))
def test_weber_noise_knows_no_unit(k: float, signals: np.ndarray, size: float, seed: int) -> None:
    for noise in (receptors.Weber(k), receptors.LogNormal(k)):
        reading = noise.sample(signals, seed)
        np.testing.assert_allclose(noise.sample(signals * size, seed), reading * size, rtol=1e-12)
        here = noise.log_likelihood(reading, signals)
        there = noise.log_likelihood(reading * size, signals * size)
        np.testing.assert_allclose(there, here - np.log(size), rtol=1e-10, atol=1e-9)


def fold(w: ww.Whisker, r: float) -> float:
    return float(ww.flick_past(w, r).deflection_angle)


SHARE = floats(0.02, 0.98)


@st.composite
def observed(draw: st.DrawFn) -> tuple[ww.Observer, np.ndarray, np.ndarray]:
    """An observer, a contact and noisy readings of it."""
    w = draw(whiskers())
    k = draw(logarithmic(0.02, 0.4))
    r = draw(SHARE) * w.length
    if draw(st.booleans()):
        observer = ww.Observer(w, cues.Compliance(), receptors.Weber(k))
        contact = np.array([r])
    else:
        observer = ww.Observer(w, cues.ForceMap(), receptors.Weber(k))
        contact = np.array([r, draw(floats(0.01, 0.95)) * fold(w, r)])
    return observer, contact, observer.read(np.tile(contact, (3, 1)), draw(st.integers(0, 10**9)))


def check_posterior(p: ww.inference.Posterior) -> None:
    low, high = p.observer.reach
    length = high - low
    for name in ("mean", "sd", "mean_error", "sd_error"):
        assert np.isfinite(getattr(p, name)).all(), name
    assert ((p.mean > low) & (p.mean < high)).all()
    assert ((p.sd > 0) & (p.sd < length)).all()
    q = p.quantile([0.001, 0.025, 0.25, 0.5, 0.75, 0.975, 0.999])
    assert (np.diff(q, axis=-1) >= 0).all()
    assert ((q >= low) & (q <= high)).all()
    assert np.isfinite(p.log_evidence).all()
    for status in p.status:
        assert Status(int(status)).message


@given(observed())
def test_a_posterior_is_whole(scene: tuple[ww.Observer, np.ndarray, np.ndarray]) -> None:
    observer, _, reading = scene
    p = ww.posterior(observer, reading)
    check_posterior(p)
    sure = p.status == Status.CONVERGED
    assert (p.sd_error <= 0.02 * p.sd)[sure].all()
    alone = ww.posterior(observer, reading[0])
    # Within the tolerance of the two, or within the errors that they confess.
    assert abs(alone.sd - p.sd[0]) <= 0.02 * p.sd[0] + alone.sd_error + p.sd_error[0]


@given(observed())
def test_laplace_is_whole_or_says_so(scene: tuple[ww.Observer, np.ndarray, np.ndarray]) -> None:
    observer, _, reading = scene
    check_posterior(ww.posterior(observer, reading, method="laplace"))


@given(observed(), POWERS, POWERS)
def test_posteriors_know_no_unit(
    scene: tuple[ww.Observer, np.ndarray, np.ndarray], size: float, stiff: float
) -> None:
    observer, _, reading = scene
    w = scaled(observer.whisker, size, stiff)
    other = ww.Observer(w, observer.cue, observer.noise)
    forces = np.array([size**3] + [size**2] * (reading.shape[-1] - 1)) * stiff
    one, two = ww.posterior(observer, reading), ww.posterior(other, reading * forces)
    # The domain of lengths has a unit; nothing else has.
    inside = (one.status != Status.OUTSIDE_DOMAIN) & (two.status != Status.OUTSIDE_DOMAIN)
    np.testing.assert_array_equal(one.status[inside], two.status[inside])
    for name in ("mean", "sd"):
        off = np.abs(getattr(one, name) - getattr(two, name) / size)
        confessed = getattr(one, f"{name}_error") + getattr(two, f"{name}_error") / size
        assert (off <= 0.01 * one.sd + confessed).all(), name


ALL_CUES = [
    lambda w: cues.Compliance(tap_angle=0.05),
    lambda w: cues.ForceMap(("moment", "axial_force", "transverse_force")),
    lambda w: cues.ForceMap(("moment", "transverse_force")),
    lambda w: cues.ForceMap("moment", deflection_angle=0.05),
    lambda w: cues.AngleSideAngle(0.2 * w.length),
    lambda w: cues.TwoWhiskers(0.1 * w.length),
    lambda w: cues.ContactAndDetachment(),
    lambda w: cues.VibrissaLength(),
    lambda w: cues.BalanceOfMoments(),
    lambda w: cues.Vibration(),
    lambda w: cues.UnknownStiffness(cues.Compliance()),
    lambda w: cues.Fused(cues.Compliance(), cues.ForceMap()),
    lambda w: cues.ComparativeLength(
        np.array([1.25, 0.8]) * w.length, np.array([[-0.05, 0.0], [0.05, 0.0]]) * w.length
    ),
]


@pytest.mark.parametrize("make", ALL_CUES)
@settings(max_examples=max(settings.default.max_examples // 3, 2))
@given(data=st.data())
def test_every_cue_has_whole_signals_posteriors_and_jnds(make, data: st.DataObject) -> None:
    # Whiskers of a rat's size: some cues have lengths of their own.
    length = data.draw(floats(10e-3, 60e-3))
    w = ww.Whisker(length, 2e-3 * length, 2e-3 * length * data.draw(floats(0.0, 0.6)))
    observer = ww.Observer(w, make(w))
    r = data.draw(SHARE) * observer.reach[1]
    contact = [r]
    if observer.bounded > 1:
        limit = float(observer.space.angle_range(np.array([r]))[1][0])
        contact.append(data.draw(floats(0.02, 0.9)) * limit)
    contact = observer.at_middle(np.array(contact))
    signals, outcome = observer.signals(contact)
    held = outcome == Outcome.HELD
    assert np.isfinite(signals).all() == held
    assert Outcome(int(outcome)).message
    assume(held)
    reading = observer.read(contact, data.draw(st.integers(0, 10**9)))
    p = ww.posterior(observer, reading, method="quadrature")
    assert np.isfinite([p.mean, p.sd]).all()
    assert observer.reach[0] < p.mean < observer.reach[1]
    assert p.sd > 0
    assert fisher_jnd(observer, contact) > 0
    linear = weber_propagation(observer, contact)
    assert (linear >= 0) | (linear.size == 0) | isinstance(observer.noise, receptors.Events)
