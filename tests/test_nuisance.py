"""Unknowns that the whisker does not bound: priors of their own, integrated out by every engine."""

import arviz
import numpy as np
import pytest

import weberwhisk as ww
from weberwhisk.cues import Compliance, ForceMap, SpaceMap, UnknownStiffness
from weberwhisk.jnd import fisher_jnd, weber_propagation
from weberwhisk.receptors import Weber

W = ww.Whisker(length=50e-3, base_radius=100e-6, tip_radius=5e-6)


@pytest.fixture(scope="module")
def tap():
    """A tap, the stiffness unknown by 20 %, and the posterior of r on a fine grid."""
    observer = ww.Observer(W, UnknownStiffness(Compliance(), 0.2))
    reading = observer.read([25e-3, 1.1], seed=5)
    r = (np.arange(4000) + 0.5) / 4000 * W.length
    stiffness = np.exp(0.2 * np.linspace(-8, 8, 801))
    contact = np.stack(np.meshgrid(r, stiffness, indexing="ij"), axis=-1)
    weight = np.exp(observer.log_likelihood(reading, contact))
    # ln stiffness is normal; the grid is even in it.
    weight *= np.exp(-0.5 * np.linspace(-8, 8, 801) ** 2)
    density = weight.sum(axis=1) / weight.sum()
    mean = r @ density
    return observer, reading, mean, np.sqrt((r - mean) ** 2 @ density)


@pytest.mark.parametrize(
    ("method", "accuracy"), [("quadrature", 1e-3), ("emcee", 0.1), ("laplace", 0.25)]
)
def test_the_stiffness_is_integrated_out(tap, method, accuracy):
    observer, reading, mean, sd = tap
    p = ww.posterior(observer, reading, method=method, seed=1)
    assert p.status == 0
    assert p.mean == pytest.approx(mean, abs=accuracy * sd)
    assert p.sd == pytest.approx(sd, rel=accuracy)


@pytest.mark.parametrize("method", ["quadrature", "emcee"])
def test_a_third_unknown_that_is_known_changes_nothing(method):
    plain = ww.Observer(W, ForceMap(), Weber(0.05))
    other = ww.Observer(W, UnknownStiffness(ForceMap(), 1e-4), Weber(0.05))
    reading = plain.read([25e-3, 0.3], seed=3)
    p, q = (ww.posterior(o, reading, method=method, seed=2) for o in (plain, other))
    assert p.status == q.status == 0
    error = 6 * np.hypot(p.mean_error, q.mean_error) + 1e-6 * p.sd
    assert q.mean == pytest.approx(p.mean, abs=error)
    assert q.sd == pytest.approx(p.sd, rel=0.15 if method == "emcee" else 1e-3)


@pytest.mark.parametrize("cue", [UnknownStiffness(ForceMap()), SpaceMap()], ids=repr)
def test_emcee_knows_how_three_unknowns_go_together(cue):
    """Means, sds, correlations and the third unknown's quantiles are those of quadrature."""
    observer = ww.Observer(W, cue, None if isinstance(cue, SpaceMap) else Weber(0.1))
    reading = observer.read([25e-3, 0.3, 1.0], seed=4)
    p, q = (ww.posterior(observer, reading, method=m, seed=5) for m in ("emcee", "quadrature"))
    assert p.status == q.status == 0
    chains = p.draws_of(1000, 6)[0]
    ours, theirs = chains.reshape(-1, 3), q.draws_of(1000, 6).reshape(-1, 3)
    for name, found in p.estimates.items():
        exact = q.estimates[name]
        assert np.all(np.abs(found.mean - exact.mean) < 5 * found.mean_error)
        assert found.sd == pytest.approx(exact.sd, rel=0.15)
    independent = min(float(arviz.ess(chains[..., i])) for i in range(3))
    assert independent > 500
    assert np.corrcoef(ours.T) == pytest.approx(np.corrcoef(theirs.T), abs=0.1)
    probability = np.linspace(0.05, 0.95, 19)
    below = np.mean(ours[:, 2, None] < q.quantile(probability, of=cue.unknowns[2]).ravel(), axis=0)
    assert below == pytest.approx(
        probability, abs=1.63 / np.sqrt(independent)
    )  # 1 % of Kolmogorov's


def test_a_wider_prior_of_the_stiffness_widens_the_jnd():
    r = np.array([[25e-3, 0.3, 1.0]])
    jnds = []
    for spread in (1e-6, 0.05, 0.2):
        observer = ww.Observer(W, UnknownStiffness(ForceMap(), spread))
        jnds.append([weber_propagation(observer, r)[0], fisher_jnd(observer, r)[0]])
    plain = ww.Observer(W, ForceMap())
    assert jnds[0] == pytest.approx(
        [weber_propagation(plain, r[:, :2])[0], fisher_jnd(plain, r[:, :2])[0]], rel=1e-6
    )
    assert np.all(np.diff(jnds, axis=0) > 0)


def test_a_taps_jnd_adds_the_variances_of_noise_and_stiffness():
    observer = ww.Observer(W, UnknownStiffness(Compliance(), 0.2))
    r, a = 25e-3, W.apex_distance
    # ln signal has sd k from noise and 0.2 from the stiffness, and slope −A/(r(A − r)) in r.
    expected = np.hypot(0.1, 0.2) * r * (1 - r / a)
    assert weber_propagation(observer, [r, 1.0]) == pytest.approx(expected, rel=1e-9)
    table = ww.jnd_curve(observer, r, draws=4, seed=1)
    assert table["propagation"][0] == pytest.approx(expected, rel=1e-9)
    assert table["stiffness"][0] == 1.0
