"""From an observer and its readings to a posterior, by quadrature, emcee or Laplace."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtri

from .._checks import one_of
from ..observer import Observer
from ..receptors import Seed
from .mode import Mode, find_mode
from .panels import IMPROBABLE, Panels
from .result import Estimate, Posterior, Status

Array = NDArray[np.float64]

#: Error of mean and sd, over the sd, above which a quadrature is called imprecise.
TOLERANCE = {1: 1e-6, 2: 1e-2}
#: Monte Carlo error of the sd, over the sd, that emcee goes on for.
PRECISION = {1: 0.02, 2: 0.03}
ENSEMBLES, WALKERS = 4, {1: 8, 2: 6}
#: Steps after which a posterior that has not converged is called so.
MOST_STEPS = {1: 20_000, 2: 6_000}
#: Posteriors in one emcee run: enough to share its bookkeeping, few enough for the memory.
STACKED = {1: 1024, 2: 1024}


class _Solution(NamedTuple):
    """What a method gives for readings (B, S)."""

    estimates: list[Estimate]
    status: NDArray[np.int8]
    log_evidence: Array
    quantile_of: Callable[[Array], Array]
    draws_of: Callable[[int, Seed], Array]


def posterior(
    observer: Observer,
    reading: ArrayLike,
    method: str = "quadrature",
    *,
    seed: Seed = None,
    tolerance: float | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Posterior:
    """The posterior of a contact given readings of its signals.

    Parameters
    ----------
    observer : Observer
    reading : array, shape (S,) or (B, S)
        One reading or many: the cue's signals in SI units (with one signal also () or (B,)).
    method : {"quadrature", "emcee", "laplace"}
        Quadrature is the reference: exact to about 1e-10 in one dimension, to `tolerance` in two.
        emcee samples thousands of posteriors stacked in one run. Laplace is the Gaussian at the
        mode, and says where that will not do.
    seed : int, SeedSequence or Generator
        Of emcee's walkers; NumPy's global state is neither read nor changed.
    tolerance : float, optional
        Error of mean and sd asked for, over the sd. Default 1e-6 (quadrature in one dimension),
        1e-2 (in two; 1e-4 at some five times the cost), 2 % and 3 % (emcee).
    progress : callable, optional
        Called with (posteriors done, posteriors in all).

    Returns
    -------
    Posterior
        With a `Status` for every reading.

    Raises
    ------
    ValueError
        For a reading of the wrong shape or not finite, an unknown method, a tolerance that is
        not positive.

    Examples
    --------
    >>> from weberwhisk import Observer, Whisker, cues
    >>> observer = Observer(Whisker(50e-3, 100e-6, 5e-6), cues.Compliance())
    >>> reading = observer.read(30e-3, seed=1)
    >>> p = posterior(observer, reading)
    >>> print(f"{p.mean * 1e3:.2f} ± {p.sd * 1e3:.2f} mm, {p.status.message}")
    29.47 ± 1.31 mm, converged
    """
    solve = _METHODS[one_of("method", method, _METHODS)]
    if tolerance is not None and not tolerance > 0:
        raise ValueError(f"tolerance must be above zero, got {tolerance!r}; write 1e-3, say.")
    y = observer.checked_reading(reading)
    single = y.ndim == 1
    rows = y.reshape(-1, y.shape[-1])
    solution = solve(observer, rows, seed, tolerance, progress)

    def shaped(values: Array) -> Any:
        return values[0] if single else values

    return Posterior(
        observer,
        y,
        method,
        {
            name: Estimate(*map(shaped, estimate))
            for name, estimate in zip(observer.unknowns, solution.estimates, strict=True)
        },
        Status(int(solution.status[0])) if single else solution.status,
        shaped(solution.log_evidence),
        solution.quantile_of,
        solution.draws_of,
    )


# -- quadrature ----------------------------------------------------------------------------------

_PANELS: WeakKeyDictionary[Observer, Panels] = WeakKeyDictionary()


def _quadrature(
    observer: Observer, reading: Array, seed: Seed, tolerance: float | None, progress: Any
) -> _Solution:
    if len(observer.unknowns) > 1:
        return _grid(observer, reading, tolerance, progress)
    panels = _PANELS.get(observer) or _PANELS.setdefault(observer, Panels(observer))
    m = panels.moments(reading)
    error = np.maximum(m.mean_error, m.sd_error) / m.sd
    status = np.where(error > (tolerance or TOLERANCE[1]), Status.IMPRECISE, Status.CONVERGED)
    status = np.where(m.improbable, Status.IMPROBABLE_READING, status)

    def quantile_of(p: Array) -> Array:
        return panels.quantiles(reading, p)[:, None, :]

    def draws_of(count: int, seed: Seed) -> Array:
        u = _stratified(len(reading), count, seed)
        return panels.quantiles(reading, u).reshape(len(reading), 4, -1, 1)

    estimate = Estimate(m.mean, m.sd, m.mean_error, m.sd_error)
    return _Solution([estimate], status.astype(np.int8), m.log_evidence, quantile_of, draws_of)


def _grid(observer: Observer, reading: Array, tolerance: float | None, progress: Any) -> _Solution:
    from .grid import GridPosterior, Nodes, integrate

    dim = len(observer.unknowns)
    mode = find_mode(observer, reading)
    root = np.linalg.cholesky(mode.covariance)
    root = root * np.minimum(1.0, WIDEST / np.linalg.norm(root, axis=(1, 2)))[:, None, None]

    contact = observer.contact(mode.x)[0]
    unidentified = _unidentified(observer, contact)
    improbable = _improbable(observer, reading, contact)

    def integral(rows: NDArray[np.intp], *, keep_points: bool = False) -> GridPosterior:
        return integrate(
            lambda x, index: observer.log_density(x, reading[rows[index], None]),
            mode.x[rows],
            root[rows],
            functions=lambda x: observer.contact(x)[0],
            only_functions=True,
            tolerance=tolerance or TOLERANCE[dim],
            # A ridge that no reading resolves is not worth resolving either.
            max_points=MOST_NODES // 100 if unidentified[rows].any() else MOST_NODES,
            keep_points=keep_points,
        )

    order = np.argsort(unidentified, kind="stable")
    parts = []
    for start in range(0, len(reading), STACKED[dim]):
        parts.append(integral(order[start : start + STACKED[dim]]))
        if progress:
            progress(min(start + STACKED[dim], len(reading)), len(reading))
    back = np.argsort(order)
    mean, sd, mean_error, sd_error = (
        np.concatenate([getattr(part, name)[:, dim:] for part in parts])[back]
        for name in ("mean", "sd", "mean_error", "sd_error")
    )
    estimates = [
        Estimate(mean[:, i], sd[:, i], mean_error[:, i] * sd[:, i], sd_error[:, i] * sd[:, i])
        for i in range(dim)
    ]
    converged = np.concatenate([part.converged for part in parts])[back]
    status = np.where(converged, Status.CONVERGED, Status.IMPRECISE)
    status = np.where(unidentified, Status.UNIDENTIFIED, status)
    status = np.where(improbable, Status.IMPROBABLE_READING, status)

    def nodes(row: int) -> Nodes:
        kept = integral(np.array([row]), keep_points=True).nodes
        assert kept is not None
        return kept[0]

    def quantile_of(p: Array) -> Array:
        out = np.empty((len(reading), dim, p.size))
        for row in range(len(reading)):
            kept = nodes(row)
            contact = observer.contact(kept.points)[0]
            out[row] = [kept.quantile(contact[:, i], p) for i in range(dim)]
        return out

    def draws_of(count: int, seed: Seed) -> Array:
        from .arviz_io import resample

        rng = np.random.default_rng(seed)
        out = np.empty((len(reading), 4, count, dim))
        for row in range(len(reading)):
            kept = nodes(row)
            x = resample(kept.points, kept.weights, 4 * count, seed=rng, edges=kept.edges)
            out[row] = observer.contact(rng.permutation(x))[0].reshape(4, count, dim)
        return out

    log_evidence = np.concatenate([part.log_evidence for part in parts])[back]
    return _Solution(estimates, status.astype(np.int8), log_evidence, quantile_of, draws_of)


#: Most nodes in one pass over one posterior.
MOST_NODES = 2_000_000
#: Widest start of a search or of the walkers, in x: the prior itself is a few units wide.
WIDEST = 2.0


def _improbable(observer: Observer, reading: Array, contact: Array) -> NDArray[np.bool_]:
    """Readings more than 5 sd from the signals of their own most probable contact."""
    signals, _ = observer.signals(contact)
    covariance = observer.noise.covariance(signals)
    miss = reading - signals
    square = np.einsum("bi,bi->b", miss, np.linalg.solve(covariance, miss[..., None])[..., 0])
    return np.sqrt(square) > IMPROBABLE


def _stratified(rows: int, count: int, seed: Seed) -> Array:
    """Probabilities (rows, 4·count), one from each stratum, in random order: four chains."""
    rng = np.random.default_rng(seed)
    u = (np.arange(4 * count) + rng.random((rows, 4 * count))) / (4 * count)
    return rng.permuted(np.clip(u, 1e-12, 1 - 1e-12), axis=1)


# -- Laplace -------------------------------------------------------------------------------------


def _laplace(
    observer: Observer, reading: Array, seed: Seed, tolerance: float | None, progress: Any
) -> _Solution:
    mode = find_mode(observer, reading)
    contact, _ = observer.contact(mode.x)
    to_contact = _slope(observer, mode.x)
    covariance = to_contact @ mode.covariance @ np.swapaxes(to_contact, 1, 2)
    sd = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    mean_error, sd_error = _along_axes(observer, reading, mode, sd)
    worst = (np.maximum(mean_error, sd_error) / sd).max(axis=1)
    status = np.where(worst > (tolerance or LAPLACE_MISFIT), Status.NOT_GAUSSIAN, Status.CONVERGED)
    status = np.where(_unidentified(observer, contact), Status.UNIDENTIFIED, status)
    estimates = [
        Estimate(contact[:, i], sd[:, i], mean_error[:, i], sd_error[:, i])
        for i in range(contact.shape[1])
    ]
    log_evidence = mode.log_density + 0.5 * (
        np.linalg.slogdet(mode.covariance)[1] + contact.shape[1] * np.log(2 * np.pi)
    )
    root = np.linalg.cholesky(mode.covariance)

    def quantile_of(p: Array) -> Array:
        spread = np.sqrt(np.diagonal(mode.covariance, axis1=1, axis2=2))
        out = []
        for value in ndtri(p):  # quantiles are carried along each coordinate
            out.append(observer.contact(mode.x + value * spread)[0])
        return np.stack(out, axis=-1)

    def draws_of(count: int, seed: Seed) -> Array:
        z = np.random.default_rng(seed).standard_normal((len(reading), 4 * count, root.shape[1]))
        x = mode.x[:, None] + z @ np.swapaxes(root, 1, 2)
        return observer.contact(x)[0].reshape(len(reading), 4, count, -1)

    return _Solution(estimates, status.astype(np.int8), log_evidence, quantile_of, draws_of)


def _along_axes(observer: Observer, reading: Array, mode: Mode, sd: Array) -> tuple[Array, Array]:
    """How far mean and sd of the contact are from the Gaussian's, (B, U) each.

    Along each axis of the Gaussian the density itself is summed, out to six sd.
    """
    at_mode = observer.contact(mode.x)[0]
    values, vectors = np.linalg.eigh(mode.covariance)
    t = np.linspace(-6, 6, 25)
    mean_error, variance_error = np.zeros((2, *at_mode.shape))
    for axis in range(mode.x.shape[1]):
        reach = np.sqrt(values[:, axis, None]) * vectors[:, :, axis]
        x = mode.x[:, None] + t[:, None] * reach[:, None]
        log = observer.log_density(x, reading[:, None]) - mode.log_density[:, None]
        weight = np.exp(log - log.max(axis=1, keepdims=True))
        weight /= weight.sum(axis=1, keepdims=True)
        contact = observer.contact(x)[0]
        mean = np.einsum("bt,btu->bu", weight, contact)
        variance = np.einsum("bt,btu->bu", weight, (contact - mean[:, None]) ** 2)
        claimed = np.einsum("bue,be->bu", _slope(observer, mode.x), reach) ** 2
        mean_error += np.abs(mean - at_mode)
        variance_error += variance - claimed
    return mean_error, np.abs(np.sqrt(np.maximum(sd**2 + variance_error, 0.0)) - sd)


#: Error of mean or sd, over the sd, up to which Laplace's approximation passes.
LAPLACE_MISFIT = 0.25


def _slope(observer: Observer, x: Array) -> Array:
    """d contact/dx, (B, U, U), by central differences."""
    h = 1e-5
    columns = []
    for axis in range(x.shape[1]):
        offset = np.zeros(x.shape[1])
        offset[axis] = h
        rise = observer.contact(x + offset)[0] - observer.contact(x - offset)[0]
        columns.append(rise / (2 * h))
    return np.stack(columns, axis=-1)


def _unidentified(observer: Observer, contact: Array) -> NDArray[np.bool_]:
    """Posteriors to which the reading adds less than the prior in some direction.

    In the coordinates x a flat prior has a curvature of ¼ and more: information below that
    leaves the prior to decide.
    """
    slope = _slope(observer, observer.coordinates(contact))
    information = np.swapaxes(slope, 1, 2) @ observer.information(contact) @ slope
    known = np.isfinite(information).all(axis=(1, 2))
    least = np.zeros(len(contact))
    least[known] = np.linalg.eigvalsh(information[known])[:, 0]
    return least < 0.25


# -- emcee ---------------------------------------------------------------------------------------


def _emcee(
    observer: Observer, reading: Array, seed: Seed, tolerance: float | None, progress: Any
) -> _Solution:
    from .ensemble import sample_stacked

    dim = len(observer.unknowns)
    size = STACKED[dim]
    # The grid of pieces belongs to the seed, so that results do not depend on who runs which.
    pieces = range(0, len(reading), size)
    seeds = np.random.SeedSequence(int(np.random.default_rng(seed).integers(2**63))).spawn(
        len(pieces)
    )
    samples, modes = [], []
    for i, start in enumerate(pieces):
        rows = reading[start : start + size]
        rng = np.random.default_rng(seeds[i])
        mode = find_mode(observer, rows)

        def density(x: Array, index: NDArray[np.intp], rows: Array = rows) -> Array:
            return observer.log_density(x, rows[index, None])

        def contact(x: Array) -> Array:
            return observer.contact(x)[0]

        samples.append(
            sample_stacked(
                density,
                _start(observer, rows, mode, rng),
                seed=rng,
                functions=contact,
                precision=tolerance or PRECISION[dim],
                max_steps=MOST_STEPS[dim],
                indexed=True,
            )
        )
        modes.append(mode.x)
        if progress:
            progress(min(start + size, len(reading)), len(reading))
    joined = {
        name: np.concatenate([getattr(s, name) for s in samples])
        for name in ("mean", "sd", "mcse_mean", "mcse_sd", "shortfall")
    }
    values = [part for s in samples for part in s.values[..., dim:]]  # each (E, N, U)
    estimates = [
        Estimate(*(joined[key][:, dim + i] for key in ("mean", "sd", "mcse_mean", "mcse_sd")))
        for i in range(dim)
    ]
    at_mode = observer.contact(np.concatenate(modes))[0]
    status = np.where(_unidentified(observer, at_mode), Status.UNIDENTIFIED, 0)
    status = np.where(_improbable(observer, reading, at_mode), Status.IMPROBABLE_READING, status)
    status = np.where(joined["shortfall"] == 0, status, Status.NOT_CONVERGED)

    def quantile_of(p: Array) -> Array:
        flat = [v.reshape(-1, dim) for v in values]
        return np.stack([np.quantile(v, p, axis=0).T for v in flat])

    def draws_of(count: int, seed: Seed) -> Array:
        return np.stack([v[:, -count:] for v in values])

    evidence = np.full(len(reading), np.nan)
    return _Solution(estimates, status.astype(np.int8), evidence, quantile_of, draws_of)


def _start(observer: Observer, reading: Array, mode: Mode, rng: np.random.Generator) -> Array:
    """Walkers (B, E, W, U) about the modes, wider than the posterior, all inside its support."""
    dim = mode.x.shape[1]
    shape = (len(reading), ENSEMBLES, WALKERS[dim], dim)
    root = 1.5 * np.linalg.cholesky(mode.covariance)
    # On a ridge the curvature knows no bound; the prior's width in x is a few units.
    root *= np.minimum(1.0, WIDEST / np.linalg.norm(root, axis=(1, 2)))[:, None, None]
    z = rng.standard_normal(shape)
    x = mode.x[:, None, None] + np.einsum("bde,bnwe->bnwd", root, z)
    for _ in range(30):  # draw in towards the mode what has fallen outside
        value = observer.log_density(x.reshape(len(reading), -1, dim), reading[:, None])
        bad = ~np.isfinite(value).reshape(shape[:3])
        if not bad.any():
            break
        z = np.where(bad[..., None], 0.5 * z, z)
        x = mode.x[:, None, None] + np.einsum("bde,bnwe->bnwd", root, z)
    return x


_METHODS = {"quadrature": _quadrature, "emcee": _emcee, "laplace": _laplace}
