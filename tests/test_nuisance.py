"""Unknowns that the whisker does not bound: priors of their own, integrated out by every engine."""

import arviz
import numpy as np
import pytest

import weberwhisk as ww
from weberwhisk.cues import (
    AngleSideAngle,
    Compliance,
    ForceMap,
    SpaceMap,
    TwoWhiskers,
    UnknownStiffness,
)
from weberwhisk.jnd import fisher_jnd, weber_propagation
from weberwhisk.posterior import quadrature
from weberwhisk.posterior.mode import find_mode
from weberwhisk.posterior.tiles import AllUnknowns
from weberwhisk.receptors import GeneralisedWeber, LogNormal, Weber

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
    table = ww.jnd_curve(observer, r, n_readings=4, seed=1)
    assert table["propagation"][0] == pytest.approx(expected, rel=1e-9)
    assert table["stiffness"][0] == 1.0


@pytest.mark.parametrize(
    ("noise", "spread", "contact", "off"),
    [
        (LogNormal(0.034374), 0.954101, [37.972e-3, 0.33771, 0.22775], [-0.25682, 0.17446]),
        (
            GeneralisedWeber(0.013195, floor=[1e-9, 1e-7]),
            0.159135,
            [5.5023e-3, 0.63515, 1.21273],
            [2.94878, -0.60280],
        ),
        (
            GeneralisedWeber(0.36712, floor=[1e-9, 1e-7]),
            0.526036,
            [29.872e-3, 0.25749, 0.44616],
            [-0.23246, -0.76139],
        ),
        (
            LogNormal(0.0041098),
            0.175032,
            [1.385e-2, 9.17e-2, 1.052],
            [-1.56, 2.343],
        ),
    ],
    ids=["ridge tens of widths off", "ridge bent", "wide noise", "coarse"],
)
def test_ridges_of_stiffness_are_followed_wherever_they_go(noise, spread, contact, off):
    """0.1, 0.09, 0.02 and 0.014 sd off, with 0.004, 0.001, 0.006 and 0.003 claimed.

    Climbs to the conditional peak gave up eight strides from the mode's regression line; five
    nodes were taken to do for wide noise too; and a grid's first, coarse pass was believed.
    """
    observer = ww.Observer(W, UnknownStiffness(ForceMap(), spread), noise)
    signals, _ = observer.signals(np.array([contact]))
    reading = noise.mean(signals) + np.array(off) * noise.sd(signals)
    assert_as_all_at_once(observer, reading)


@pytest.mark.parametrize(
    "reading", [[1.01138994, 1.22171746], [1.53724756, 1.75161441]], ids=["edge", "far start"]
)
def test_climbs_get_there_from_hundreds_of_sds_away(reading):
    """Newton's method ran along the side's axis to where the second whisker reaches no more.

    There the finite differences were of nothing, and LAPACK gave up.
    """
    cue, noise = TwoWhiskers(side_sd=0.000171472), GeneralisedWeber(0.0, floor=0.00121046)
    assert assert_as_all_at_once(ww.Observer(W, cue, noise), np.array([reading]))


def test_a_corner_that_has_gone_astray_loses_nothing():
    """0.03 sd off, 0.008 claimed: a side at a tile's corner ended on a plateau eighteen sds away.

    Interpolated from there, the peaks along a ridge through the tile were lost too.
    """
    cue, noise = AngleSideAngle(side_sd=0.00224392), GeneralisedWeber(0.0, floor=0.00257202)
    assert assert_as_all_at_once(ww.Observer(W, cue, noise), np.array([[2.31204388, 2.60301952]]))


def test_the_last_unknown_apart_is_as_all_at_once():
    """Distances, angles and last unknowns, of cues and noise drawn at random; the seed is new."""
    seed = np.random.SeedSequence().entropy
    rng = np.random.default_rng(seed)
    judged = 0
    for _ in range(12):
        k, spread = 10 ** rng.uniform([-2.5, -1.5], [-0.3, 0.0])
        soft, side = UnknownStiffness(ForceMap(), spread), 10 ** rng.uniform(-5, -2.61)
        floor = GeneralisedWeber(0.0, floor=0.2 * k)
        observer = [
            ww.Observer(W, AngleSideAngle(side_sd=side), floor),
            ww.Observer(W, TwoWhiskers(side_sd=0.3 * side), floor),
            ww.Observer(W, soft, LogNormal(k)),
            ww.Observer(W, soft, GeneralisedWeber(k, floor=[1e-9, 1e-7])),
            ww.Observer(W, soft, Weber(k)),
        ][rng.integers(5)]
        contact, _ = observer.contact(rng.standard_normal((1, 3)) * [1.2, 1.2, 1.0])
        signals, outcome = observer.signals(contact)
        if outcome[0] != ww.Outcome.HELD:
            continue
        reading = observer.noise.sample(signals, rng)
        if isinstance(observer.noise, LogNormal) and np.any(reading * signals <= 0):
            continue
        judged += assert_as_all_at_once(observer, reading, f"seed {seed}")
    assert judged


def assert_as_all_at_once(observer, reading, hint=""):
    """The last unknown integrated at every contact, against a grid that turns with all three.

    Within the hundredth asked for or twice the error claimed, and the grid's own thousandth.
    Where the grid does not get there nothing is said, and False returned.
    """
    mode = find_mode(observer, reading)
    grid = AllUnknowns(observer, reading, mode, 1e-3).on_grid(max_points=4_000_000)
    found = quadrature._part(observer, reading, 1e-2)
    if not grid.converged[0] or found.status[0] == ww.Status.IMPRECISE:
        return False
    off = np.abs(np.stack([found.moments.mean - grid.mean, found.moments.sd - grid.sd])) / grid.sd
    claimed = np.stack([found.moments.mean_error, found.moments.sd_error])
    bar = np.maximum(0.01, 2 * claimed) + 1e-3
    assert np.all(off < bar), (hint, observer, reading, off, claimed)
    return True
