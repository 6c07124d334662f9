"""The psychometric functions of the tasks, against simulation, closed forms and integrals."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from scipy.integrate import quad

import weberwhisk as ww
from weberwhisk.behaviour import (
    CueEncoding,
    IdentityEncoding,
    LogEncoding,
    response_probability,
    simulate_trials,
    task_named,
    threshold,
)
from weberwhisk.behaviour.encodings import refuse_unencoded, unit_encodings
from weberwhisk.commands import SCENES

TWO = task_named("2AFC")
MAGNITUDE = IdentityEncoding()
Z75 = stats.norm.ppf(0.75)


def compliance(whisker: ww.Whisker, tap_angle: float = 0.0) -> CueEncoding:
    return CueEncoding(ww.Observer(whisker, ww.cues.Compliance(tap_angle=tap_angle)))


CONE, CYLINDER = (ww.Whisker(0.05, 1e-4, tip) for tip in (0.0, 1e-4))


def probability(s1, s2, **parameters):  # type: ignore[no-untyped-def]
    return response_probability(TWO, MAGNITUDE, s1, s2, **parameters)


@pytest.mark.parametrize("m", [2, 3, 4, 8])
def test_percent_correct_is_the_greatest_of_m(m: int) -> None:
    task, k, s1, s2 = task_named(f"{m}AFC percent correct"), 0.2, 1.0, 1.25
    exact, _ = quad(
        lambda x: stats.norm.pdf(x, s2, k * s2) * stats.norm.cdf(x, s1, k * s1) ** (m - 1),
        s2 - 12 * k * s2, s2 + 12 * k * s2, epsabs=1e-12,
    )  # fmt: skip
    p = response_probability(task, MAGNITUDE, s1, s2, weber_fraction=k)[0]
    assert p == pytest.approx(exact, abs=1e-11)


def test_guess_rates() -> None:
    far_apart = dict(weber_fraction=0.01, lapse_low=0.03, lapse_high=0.07)
    assert probability(1.0, [1e-3, 1e3], **far_apart) == pytest.approx([0.03, 0.93])
    for m in (2, 4):
        p = response_probability(
            task_named(f"{m}AFC percent correct"), MAGNITUDE, 1.0, [1.0, 3.0],
            weber_fraction=0.01, lapse_high=0.07,
        )  # fmt: skip
        assert p == pytest.approx([1 / m, 0.93])


def test_bias_is_in_sds_of_the_decision_variable() -> None:
    assert probability(1.0, 1.0, weber_fraction=0.1, bias=0.5)[0] == stats.norm.cdf(0.5)


def test_log_form_knows_only_the_ratio() -> None:
    d = np.array([-0.5, -0.1, 0.2, 0.7])
    k = 0.15
    own = response_probability(TWO, LogEncoding(), 3.0, 3.0 + d, weber_fraction=k)
    formula = stats.norm.cdf((np.exp(d) - 1) / (k * np.sqrt(1 + np.exp(2 * d))))
    np.testing.assert_allclose(own, formula, rtol=1e-12)
    np.testing.assert_allclose(own, probability(7.0, 7.0 * np.exp(d), weber_fraction=k), rtol=1e-12)
    decades = response_probability(
        TWO, LogEncoding(np.log(10)), 0.0, d / np.log(10), weber_fraction=k
    )
    np.testing.assert_allclose(own, decades, rtol=1e-12)


@pytest.mark.parametrize("proportion", [0.01, 0.25, 0.5, 0.75, 0.9])
@pytest.mark.parametrize("k", [0.005, 0.1, 0.4])
def test_threshold_of_a_magnitude_has_a_closed_form(proportion: float, k: float) -> None:
    q = k * stats.norm.ppf(proportion)
    exact = (1 + q * np.sqrt(2 - q * q)) / (1 - q * q)
    own = threshold(TWO, MAGNITUDE, 3.0, proportion, weber_fraction=k)
    assert float(own) == pytest.approx(3.0 * exact, rel=1e-13)


def test_threshold_of_percent_correct_inverts_the_curve() -> None:
    task = task_named("4AFC percent correct")
    for upward in (True, False):
        at = threshold(task, MAGNITUDE, 1.0, 0.7, weber_fraction=0.2, upward=upward)
        assert (at > 1) is np.bool_(upward)
        p = response_probability(task, MAGNITUDE, 1.0, at, weber_fraction=0.2)
        assert p[0] == pytest.approx(0.7, abs=1e-12)


def test_threshold_that_no_comparison_reaches_is_infinite() -> None:
    # Φ never passes Φ(1/k): the noise of the greater stimulus grows with it.
    assert probability(1.0, 1e9, weber_fraction=1.0)[0] == pytest.approx(stats.norm.cdf(1.0))
    assert np.isinf(threshold(TWO, MAGNITUDE, 1.0, 0.85, weber_fraction=1.0))
    assert threshold(TWO, MAGNITUDE, 1.0, 0.15, weber_fraction=1.0) == 0.0
    assert np.isfinite(threshold(TWO, MAGNITUDE, 1.0, 0.84, weber_fraction=1.0))


@pytest.mark.parametrize("proportion", [0.0, 1.0, 1.2, np.nan])
def test_threshold_refuses_proportions_that_are_none(proportion: float) -> None:
    with pytest.raises(ValueError, match="proportion must"):
        threshold(TWO, MAGNITUDE, 1.0, proportion, weber_fraction=0.1)


def test_up_and_down_thresholds_differ_at_large_k() -> None:
    """JND conventions (docs/theory/decision.md): at k = 0.2 by 11 % and 8 % from the linear one."""
    k = 0.2
    linear = Z75 * np.sqrt(2) * k
    up, down = (float(threshold(TWO, MAGNITUDE, 1.0, p, weber_fraction=k)) for p in (0.75, 0.25))
    assert (up - 1) / linear == pytest.approx(1.11, abs=5e-3)
    assert (1 - down) / linear == pytest.approx(0.92, abs=5e-3)


def test_cue_encoding_knows_which_way_its_signal_goes() -> None:
    encoding = compliance(CYLINDER)
    assert encoding.direction == -1
    assert encoding.domain == (0.0, 0.05)
    force_map = ww.Observer(ww.Whisker(0.05, 1e-4, 5e-6), ww.cues.ForceMap())
    assert CueEncoding(force_map, 0.1).direction == 1
    with pytest.raises(ValueError, match="needs the deflection angle"):
        CueEncoding(force_map)
    # A cylinder's compliance signal goes as 1/r, so its curve is that of the magnitude, turned.
    cylinder = response_probability(TWO, encoding, 0.02, [0.016, 0.025], weber_fraction=0.2)
    plain = probability(1.0, [0.8, 1.25], weber_fraction=0.2)
    np.testing.assert_allclose(cylinder, plain, rtol=1e-12)


def test_a_cylinders_map_cannot_be_judged_by() -> None:
    encoding = CueEncoding(ww.Observer(CYLINDER, ww.cues.ForceMap()), deflection_angle=0.1)
    with pytest.raises(ValueError, match="these signals do not determine distance"):
        refuse_unencoded(encoding, [0.02, 0.03])


R = np.array([0.02, 0.025])
WHISKER = ww.Whisker(0.05, 1e-4, 5e-6)


def chance_by(noise: ww.receptors.ReceptorNoise, k: float = 0.2) -> tuple[float, np.ndarray]:
    """Chance of "second greater" by the compliance cue, and both its signals."""
    observer = ww.Observer(WHISKER, ww.cues.Compliance(), noise)
    p = response_probability(TWO, CueEncoding(observer), *R, weber_fraction=k)
    return float(p[0]), observer.signals(R[:, None])[0][:, 0]


def test_receptors_of_every_kind_in_the_likelihood() -> None:
    """Each written out: d' of two readings of one signal, which falls with distance."""
    k = 0.2
    _, (m1, m2) = chance_by(ww.receptors.Weber(1.0))
    floor = 0.1 * m1
    response = np.array([m1, m2]) / (1 + np.array([m1, m2]) / m1)
    exact = {
        ww.receptors.Weber(0.3): (m1 - m2) / (k * np.hypot(m1, m2)),
        ww.receptors.LogNormal(0.3): np.log(m1 / m2) / (k * np.sqrt(2)),
        ww.receptors.GeneralisedWeber(0.3, floor=floor): (m1 - m2)
        / np.sqrt(k**2 * (m1**2 + m2**2) + 2 * floor**2),
        ww.receptors.Saturating(0.3, ceiling=m1, floor=floor): (response[0] - response[1])
        / np.sqrt(k**2 * (response**2).sum() + 2 * floor**2),
        ww.receptors.GeneralisedWeber(0.0, floor=floor): (m1 - m2) / (np.sqrt(2) * floor),
    }
    for noise, d in exact.items():
        assert chance_by(noise)[0] == pytest.approx(stats.norm.cdf(d), abs=1e-12), noise


@pytest.mark.parametrize("cue", sorted(SCENES))
def test_every_cue_is_an_encoding_of_distance_with_its_own_jnd(cue: str) -> None:
    observer = ww.Observer(WHISKER, SCENES[cue](WHISKER))
    angle = 0.1 if "deflection_angle" in observer.unknowns else None
    if cue in ("vibrissa-length", "comparative-length"):
        with pytest.raises(ValueError, match="reports events, all or none"):
            CueEncoding(observer, angle)
        return
    encoding = CueEncoding(observer, angle)
    assert encoding.direction == 1  # distance itself, or the balance angle, which grows with it
    contact = R[:, None] if angle is None else np.stack([R, [angle, angle]], axis=-1)
    jnd = ww.sensitivity.weber_propagation(observer, observer.at_middle(contact))
    if cue == "balance-of-moments":  # one signal: the angle is the encoding
        jnd = observer.noise.sd(observer.signals(contact)[0])[:, 0]
    # At the receptors' own Weber fraction, 0.1, the noise is their own.
    first = observer.noise.weber_fractions(len(observer.cue.signal_names))
    k = first[first > 0][0] if first.any() else 0.123
    found = np.hypot(k * encoding.sd_per_weber_fraction(R), encoding.floor_sd(R))
    np.testing.assert_allclose(found, jnd, rtol=1e-6)


def test_distances_without_a_signal_are_refused_with_their_outcome() -> None:
    whisker = ww.Whisker(0.05, 1e-4, 5e-6)
    encoding = compliance(whisker, float(ww.flick_past(whisker, 0.04).deflection_angle))
    with pytest.raises(ValueError, match=r"1 of 2 stimuli.*0\.045 \(flicked past"):
        refuse_unencoded(encoding, [0.03, 0.045])
    # A threshold inside the reach is still found beside the part that gives no signal.
    assert 0.03 < threshold(TWO, encoding, 0.03, 0.75, weber_fraction=0.1) < 0.04
    assert np.isinf(threshold(TWO, encoding, 0.039, 0.99, weber_fraction=0.3))


def test_simulated_choices_follow_the_curve() -> None:
    observer = ww.Observer(CONE, ww.cues.Compliance())
    trials = simulate_trials(
        weber_fraction=0.15, standards=[0.02, 0.04], offsets=[-0.1, 0.1], trials_per_level=4000,
        observer=observer, seed=5,
    )  # fmt: skip
    cells = trials.cells()
    p = response_probability(
        TWO, CueEncoding(observer), cells.stimulus_1, cells.stimulus_2, weber_fraction=0.15
    )
    z = (cells.count / cells.n - p) / np.sqrt(p * (1 - p) / cells.n)
    assert np.abs(z).max() < 3.5


def test_unknown_names_are_refused() -> None:
    with pytest.raises(ValueError, match="did you mean '2AFC'"):
        task_named("2AFCC")
    with pytest.raises(ValueError, match="did you mean 'weber'"):
        unit_encodings(MAGNITUDE, 1.0, 1.0, 1.0, "webber")
