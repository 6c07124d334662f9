"""The three engines against brute-force integrals that share no code with them."""

import itertools

import numpy as np
import pytest
from mpmath import mp
from numpy.polynomial.legendre import leggauss
from scipy import stats
from short_forms import slow_but

import weberwhisk as ww
from weberwhisk import Status
from weberwhisk.cues import Compliance, ForceMap
from weberwhisk.receptors import Afferents, SpikeCount, Weber

W = ww.Whisker(50e-3, 100e-6, 5e-6)


def brute_force(observer, reading, floor=0.0):
    """Mean and sd of r for the light tap and a flat prior, by 25-digit integration over r."""
    w = observer.whisker
    with mp.workdps(25):
        c, inverse_apex = mp.mpf(float(w.compliance_constant)), mp.mpf(float(w.taper / w.length))
        k, y, top = mp.mpf(float(observer.noise.weber_fraction)), mp.mpf(reading), mp.mpf(w.length)

        def density(r):
            m = c * (1 / r - inverse_apex)
            sd = mp.sqrt(floor**2 + (k * m) ** 2)
            return mp.exp(-(((y - m) / sd) ** 2) / 2) / sd

        at = min(max(1 / (y / c + inverse_apex), top / 500), top * mp.mpf("0.9999"))
        width = k * at * (1 - at * inverse_apex)
        steps = (-60, -30, -18, -12, -9, -7, -5, -4, -3, -2, -1, 0, 1, 2, 3, 4, 5, 7, 9, 12, 18, 30)
        cuts = [0, *(at + s * width for s in steps if 0 < at + s * width < top), top]
        total, first, second = (
            mp.quad(lambda r, n=n: density(r) * (r - at) ** n, cuts) for n in range(3)
        )
        mean = first / total
        return float(at + mean), float(mp.sqrt(second / total - mean**2))


@pytest.mark.parametrize(
    ("k", "taper"),
    slow_but(itertools.product([0.005, 0.05, 0.2, 0.5], ["tapered", "cylinder"]), quick=(7,)),
)
def test_quadrature_in_one_dimension_is_exact(k, taper):
    w = W if taper == "tapered" else W.cylinder()
    observer = ww.Observer(w, Compliance(), Weber(k))
    readings = observer.read(np.array([[0.02], [0.3], [0.7], [0.95], [0.999]]) * w.length, seed=2)
    p = ww.posterior(observer, readings)
    for i, y in enumerate(readings[:, 0]):
        mean, sd = brute_force(observer, float(y))
        assert abs(p.mean[i] - mean) < 1e-6 * sd
        assert abs(p.sd[i] / sd - 1) < 1e-6
    fine = Status.CONVERGED if k >= 0.01 else Status.OUTSIDE_DOMAIN
    assert np.all(p.status == fine)


def test_quantiles_are_those_of_the_density():
    observer = ww.Observer(W, Compliance(), Weber(0.3))
    p = ww.posterior(observer, observer.read(0.9 * W.length, seed=1))
    r = np.linspace(0, W.length, 2_000_001)[1:-1]
    log = observer.log_likelihood(p.reading, r[:, None])
    cumulative = np.cumsum(np.exp(log - log.max()))
    cumulative /= cumulative[-1]
    for probability in (0.001, 0.025, 0.5, 0.9, 0.999):
        exact = np.interp(probability, cumulative, r)
        assert p.quantile(probability) == pytest.approx(exact, rel=1e-5)
    low, high = p.interval(0.95)
    assert [low, high] == pytest.approx(p.quantile([0.025, 0.975]), rel=1e-13)


def grid_truth(observer, reading):
    """Mean and sd of r and θ_d by composite Gauss rules in (ln r, τ), θ_d = limit(r)/cosh τ.

    τ = 0 is the fold, where the density is smooth in τ; far up τ is −ln θ_d, so that the ridge
    towards small r, as narrow as r itself, is resolved as well as the rest.
    """
    x, w = leggauss(8)

    def rule(edges):
        half = np.diff(edges) / 2
        return (edges[:-1, None] + half[:, None] * (x + 1)).ravel(), (half[:, None] * w).ravel()

    length = float(observer.whisker.length)
    ln_r, weight_r = rule(np.log(length) + np.linspace(-9, 0, 241))
    tau, weight_tau = rule(np.linspace(0, 14, 241))
    r = np.exp(ln_r)
    limit = ww.flick_past(observer.whisker, r).deflection_angle
    theta = limit[:, None] / np.cosh(tau)
    slope = weight_r[:, None] * r[:, None] * theta * np.tanh(tau) * weight_tau
    contact = np.stack(np.broadcast_arrays(r[:, None], theta), axis=-1)
    log = np.stack([observer.log_likelihood(reading, part) for part in contact])
    density = np.exp(log - log.max()) * slope
    density /= density.sum()
    mean = np.einsum("rt,rtu->u", density, contact)
    return mean, np.sqrt(np.einsum("rt,rtu->u", density, (contact - mean) ** 2))


@pytest.mark.slow  # to 2e-3, of many contacts: test_tree.py
@pytest.mark.parametrize(
    ("k", "fraction", "degrees"),
    [
        pytest.param(0.1, 0.3, 10, marks=pytest.mark.slow),
        pytest.param(0.1, 0.6, 20, marks=pytest.mark.slow),
        pytest.param(0.2, 0.5, 8, marks=pytest.mark.slow),
        (0.3, 0.8, 6),
    ],
)
def test_quadrature_in_two_dimensions_reaches_1e_4(k, fraction, degrees):
    observer = ww.Observer(W, ForceMap(), Weber(k))
    reading = observer.read([fraction * W.length, np.radians(degrees)], seed=5)
    p = ww.posterior(observer, reading, tolerance=1e-4)
    assert p.status == Status.CONVERGED
    mean, sd = grid_truth(observer, reading)
    for i, name in enumerate(observer.unknowns):
        e = p.estimates[name]
        assert abs(e.mean - mean[i]) < 1e-4 * sd[i]
        assert abs(e.sd / sd[i] - 1) < 1e-4
        assert max(e.mean_error, e.sd_error) < 1e-4 * sd[i]


@pytest.mark.parametrize("k", slow_but([0.02, 0.1, 0.3], (1,)))
def test_emcee_agrees_with_quadrature_within_its_own_error(k):
    observer = ww.Observer(W, Compliance(), Weber(k))
    r = np.random.default_rng(8).uniform(0.1, 0.97, (96, 1)) * W.length
    readings = observer.read(r, seed=1)
    exact = ww.posterior(observer, readings)
    p = ww.posterior(observer, readings, "emcee", seed=2)
    good = p.status == Status.CONVERGED
    assert good.mean() > 0.8
    z = (p.mean - exact.mean)[good] / p.mean_error[good]
    assert np.abs(z).max() < 5
    assert 0.7 < z.std() < 1.5
    z = (p.sd - exact.sd)[good] / p.sd_error[good]
    assert np.abs(z).max() < 5
    assert np.all(np.abs(p.sd / exact.sd - 1)[good] < 0.1)


@pytest.mark.slow
@pytest.mark.parametrize("k", [0.3, 0.5])
def test_emcee_never_calls_a_wrong_sd_converged_on_the_heavy_shelf(k):
    """k ≥ 0.3 near the tip: a shelf towards small r, where short runs are wrong.

    The "shelf" of `test_emcee_hard_cases` is that at 0.3; `test_ensemble` has hundreds of such runs
    on a signal that costs nothing.
    """
    observer = ww.Observer(W, Compliance(), Weber(k))
    readings = observer.read(np.full((48, 1), 0.95 * W.length), seed=3)
    exact = ww.posterior(observer, readings)
    p = ww.posterior(observer, readings, "emcee", seed=4)
    wrong = np.abs(p.sd / exact.sd - 1) > 0.1
    assert not np.any(wrong & (p.status == Status.CONVERGED))


def test_laplace_is_right_where_it_says_so_and_says_where_not():
    for k, share in ((0.02, 1.0), (0.3, 0.0)):
        observer = ww.Observer(W, Compliance(), Weber(k))
        readings = observer.read(np.full((50, 1), 0.9 * W.length), seed=3)
        exact, p = ww.posterior(observer, readings), ww.posterior(observer, readings, "laplace")
        good = p.status == Status.CONVERGED
        assert good.mean() == pytest.approx(share, abs=0.1)
        assert np.all(np.abs(p.sd / exact.sd - 1)[good] < 0.1)
        assert np.all(np.abs(p.mean - exact.mean)[good] < 0.3 * exact.sd[good])
    assert np.abs(p.sd / exact.sd - 1).max() > 0.3  # so the warning was needed


def test_laplaces_evidence_and_quadratures_agree_at_small_k():
    observer = ww.Observer(W, ForceMap(), Weber(0.01))
    reading = observer.read([30e-3, 0.15], seed=1)
    a, b = (ww.posterior(observer, reading, m) for m in ("laplace", "quadrature"))
    assert a.log_evidence == pytest.approx(b.log_evidence, abs=0.02)
    assert a.mean == pytest.approx(b.mean, abs=0.1 * b.sd)


def test_the_cylinders_force_map_is_called_a_ridge():
    observer = ww.Observer(W.cylinder(), ForceMap(), Weber(0.1))
    reading = observer.read([30e-3, 0.2], seed=1)
    for method in ("quadrature", "laplace"):
        assert ww.posterior(observer, reading, method).status == Status.UNIDENTIFIED
    assert ww.posterior(ww.Observer(W, ForceMap()), reading).status != Status.UNIDENTIFIED


def test_an_impossible_reading_is_called_improbable():
    observer = ww.Observer(W, Compliance(), Weber(0.05))
    tip = observer.signals([W.length])[0][0]
    p = ww.posterior(observer, [tip * 0.5])
    assert p.status == Status.IMPROBABLE_READING
    assert 0.9 * W.length < p.mean < W.length  # piled up at the tip
    map_observer = ww.Observer(W, ForceMap(), Weber(0.02))
    signals = map_observer.signals([20e-3, 0.2])[0]
    assert ww.posterior(map_observer, signals * [2.0, 0.5]).status == Status.IMPROBABLE_READING
    # A moment of none, or against the force, was told of the tolerance.
    wrong = ww.posterior(ww.Observer(W, ForceMap()), signals * [[0.0, 1.0], [-1.0, 1.0]])
    assert wrong.status.tolist() == 2 * [Status.IMPROBABLE_READING]


@pytest.mark.parametrize("method", slow_but(["quadrature", "emcee", "laplace"], (0, 2)))
def test_one_reading_gives_scalars_and_many_give_arrays(method):
    observer = ww.Observer(W, ForceMap(), Weber(0.05))
    readings = observer.read([[20e-3, 0.2], [40e-3, 0.1]], seed=1)
    one = ww.posterior(observer, readings[0], method, seed=3)
    assert np.ndim(one.mean) == 0
    assert isinstance(one.status, Status)
    assert one.interval(0.9).shape == (2,)
    many = ww.posterior(observer, readings, method, seed=3)
    assert many.mean.shape == many.sd.shape == many.status.shape == (2,)
    assert many.interval(0.9).shape == (2, 2)
    assert np.all(many.interval(0.5)[:, 0] < many.mean)
    assert len(many.summary()) == 4
    assert len(one.summary()) == 2


@pytest.mark.parametrize("method", ["quadrature", "emcee", "laplace"])
def test_to_arviz_has_draws_of_the_posterior(arviz, method):
    observer = ww.Observer(W, ForceMap(), Weber(0.05))
    p = ww.posterior(observer, observer.read([30e-3, 0.15], seed=1), method, seed=3)
    data = p.to_arviz(draws=400)
    draws = np.asarray(data.posterior["radial_distance"])
    assert draws.shape[0] == 4
    assert draws.mean() == pytest.approx(p.mean, abs=0.25 * p.sd)
    assert draws.std() == pytest.approx(p.sd, rel=0.2)
    assert float(np.max(arviz.rhat(np.asarray(draws)))) < 1.1
    assert "moment" in data.observed_data


def test_arviz_data_of_many_readings_share_a_dimension_and_say_their_units(arviz, tmp_path):
    observer = ww.Observer(W, ForceMap(), Weber(0.05))
    readings = observer.read([[30e-3, 0.15], [20e-3, 0.2], [40e-3, 0.1]], seed=1)
    p = ww.posterior(observer, readings)
    path = str(tmp_path / "many.nc")
    p.to_arviz(draws=50).to_netcdf(path)
    data = arviz.from_netcdf(path)
    assert set(data["posterior"].sizes) == {"chain", "draw", "reading"}
    assert dict(data["observed_data"].sizes) == {"reading": 3}
    groups = {
        "posterior": {"radial_distance": "m", "deflection_angle": "rad"},
        "observed_data": {"moment": "N m", "axial_force": "N"},
    }
    for group, units in groups.items():
        for name, unit in units.items():
            assert data[group][name].attrs["units"] == unit
    np.testing.assert_array_equal(data["observed_data"]["moment"], readings[:, 0])
    assert "log_likelihood" not in data
    one = p.to_arviz(draws=5, log_likelihood=True).sel(reading=1)
    assert one["log_likelihood"]["contact"].shape == one["posterior"]["radial_distance"].shape
    if hasattr(data, "close"):
        data.close()


def test_arviz_says_how_far_prior_and_reading_move_a_distance(arviz):
    near = stats.norm(28e-3, 1e-3)  # narrower than the likelihood, and beside it
    observer = ww.Observer(W, Compliance(), Weber(0.1), prior={"radial_distance": near})
    reading = observer.read([31e-3], seed=1)
    data = ww.posterior(observer, reading).to_arviz(draws=1000)
    drawn = data["posterior"]["radial_distance"].to_numpy()
    np.testing.assert_allclose(data["log_prior"]["radial_distance"], near.logpdf(drawn))
    direct = observer.log_likelihood(reading, drawn[..., None])
    np.testing.assert_allclose(data["log_likelihood"]["contact"], direct)

    def sensitivity(data, to):
        if arviz.__version__.startswith("0."):
            return float(arviz.psens(data, component=to)["radial_distance"])
        return float(arviz.psense(data, group=to)["radial_distance"])

    assert sensitivity(data, "prior") > 0.05
    flat = ww.posterior(ww.Observer(W, Compliance(), Weber(0.1)), reading).to_arviz(draws=1000)
    assert "log_prior" not in flat
    assert sensitivity(flat, "likelihood") > 0.05


def test_counts_of_spikes_are_integers_and_a_missing_reading_has_no_likelihood():
    observer = ww.Observer(W, Compliance(), SpikeCount(Afferents(75, 1e-8, 1e-5)))
    p = ww.posterior(observer, observer.read([[30e-3]], seed=1))
    assert p.to_arviz(draws=5)["observed_data"]["reading_0"].dtype == np.int64
    seen = ww.Observer(W, Compliance(), Weber(0.1))
    lost = ww.posterior(seen, np.array([[np.nan], [1e-4]])).to_arviz(draws=5, log_likelihood=True)
    missing = np.isnan(lost["log_likelihood"]["contact"].to_numpy())
    assert missing[..., 0].all()
    assert not missing[..., 1].any()


@pytest.mark.parametrize("draws", [0, -3, 2.5, "many"])
def test_draws_for_arviz_are_a_whole_number(draws):
    observer = ww.Observer(W, Compliance(), Weber(0.1))
    with pytest.raises(ValueError, match="draws must be a whole number"):
        ww.posterior(observer, [1e-4]).to_arviz(draws=draws)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda o: ww.posterior(o, [1.0], "mcmc"), "method 'mcmc' is unknown"),
        (lambda o: ww.posterior(o, "loud"), "reading must be a number"),
        (lambda o: ww.posterior(o, [1.0], tolerance=0), "tolerance must be above zero, got 0"),
        (lambda o: ww.posterior(o, [1.0], tolerance="low"), "tolerance must be a number"),
        (lambda o: ww.posterior(o, [1e-4]).interval(1.5), "mass must lie between 0 and 1, got 1.5"),
        (lambda o: ww.posterior(o, [1e-4]).interval(of="angle"), "of 'angle' is unknown"),
        (
            lambda o: ww.posterior(ww.Observer(W, ForceMap()), [1.0, 2.0, 3.0]),
            r"has 2 numbers \(of moment, axial_force\), got shape \(3,\)",
        ),
    ],
)
def test_misuse_is_refused_in_one_sentence(call, words):
    with pytest.raises(ValueError, match=words) as error:
        call(ww.Observer(W, Compliance()))
    assert "\n" not in str(error.value)
