"""What is believed about an observer: mode, marginals, quantiles, and joint draws.

Either posterior has `draws` in `chains` one after another, an estimated `error` relative to the
posterior sd, and `trouble`: why its numbers are not to be relied on, empty where they are.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import CubicSpline
from scipy.ndimage import map_coordinates, spline_filter
from scipy.optimize import minimize
from scipy.special import logsumexp

from .._util.refusals import Refusal
from .._util.values import Array, Fields
from .axes import bias_at
from .integrate import PosteriorGrid, density_of, log_marginal
from .likelihood import Draws, WeberModel
from .priors import REACH

__all__ = ["QuadraturePosterior", "SampledPosterior", "WeberPosterior", "prior_draws", "sample"]


def split(model: WeberModel, theta: Array) -> tuple[Array, Array]:
    """Scores (..., lead) and biases (..., G) of the free parameters (..., D), biases last."""
    free = np.flatnonzero(model.free)
    scores = np.zeros((*theta.shape[:-1], len(model.lead)))
    scores[..., free] = np.clip(theta[..., : free.size], -REACH, REACH)
    if model.free_bias:
        return scores, theta[..., free.size :]
    return scores, np.full((*theta.shape[:-1], model.n_groups), model.fixed_bias())


def log_posterior(model: WeberModel, theta: Array) -> Array:
    """Log density of the free scores and biases (..., D), not normalised; −∞ without a rise."""
    scores, bias = split(model, theta)
    k, effects, low, high = model.at_scores(scores)
    free = theta[..., : sum(model.free)]
    out = model.log_likelihood(k, low, high, bias, effects)
    out = out - 0.5 * np.einsum("...i,ij,...j->...", free, model.score_precision, free)
    out = out + model.log_bias_prior(bias).sum(axis=-1)
    return np.where(sum(model.lapses(low, high)) < 1, out, -np.inf)


def find_mode(model: WeberModel, start: Array) -> tuple[Array, Array]:
    """Mode of the free scores and biases (D,), found from a start, and their covariance there."""

    def cost(theta: Array) -> Any:
        return -np.maximum(log_posterior(model, theta), -1e10)

    def slope(theta: Array) -> Array:
        nudge = 1e-4 * np.eye(theta.size)
        return (cost(theta + nudge) - cost(theta - nudge)) / 2e-4

    found = minimize(cost, start, jac=slope, method="BFGS", options={"gtol": 1e-3})
    return found.x, np.asarray(found.hess_inv)


def prior_draws(model: WeberModel, size: int, rng: np.random.Generator) -> Draws:
    """Joint draws from the prior of a model."""
    free = np.array(model.free)
    kept: list[Array] = []
    while sum(map(len, kept)) < size:
        z = rng.standard_normal((size, free.size)) * free
        if free[-2:].all():
            rho = model.priors.lapse_correlation
            z[:, -1] = rho * z[:, -2] + np.sqrt(1 - rho**2) * z[:, -1]
        *_, low, high = model.at_scores(z)
        kept.append(z[sum(model.lapses(low, high)) < 1])
    if model.free_bias:
        uniform = rng.random((size, model.n_groups))
        bias = np.asarray(model.priors.of("bias").ppf(uniform))
    else:
        bias = np.full((size, model.n_groups), model.fixed_bias())
    return model.completed(model.draws_at(np.concatenate(kept)[:size], bias), rng)


def named_values(model: WeberModel, theta: Array) -> dict[str, float]:
    """Free scores and biases (D,) as values of the inferred parameters."""
    one = model.draws_at(*split(model, theta[None]))
    return {name: float(value[0]) for name, value in one.named(model).items()}


@dataclass(frozen=True, repr=False)
class QuadraturePosterior(Fields):
    """The posterior integrated by quadrature; draws from it are independent and exact."""

    model: WeberModel
    grid: PosteriorGrid
    seed: int
    n_draws: int = 4000
    chains: int = 4
    _curves: dict[str, tuple[Array, Array, Array]] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    @property
    def log_evidence(self) -> float | None:
        return self.grid.log_evidence

    @property
    def error(self) -> float:
        return self.grid.error

    @property
    def trouble(self) -> str:
        if np.isinf(self.grid.error):
            return "the posterior is too long and thin for a grid, and the integral was given up"
        if self.grid.error > 0.01:
            return f"the integral has an estimated error of {100 * self.grid.error:.2g} %"
        return ""

    def _curve(self, name: str) -> tuple[Array, Array, Array]:
        """Values (rising), their cumulative probability, and the weight of each in a mean."""
        if name not in self._curves:
            self._curves[name] = self._make_curve(name)
        return self._curves[name]

    def _make_curve(self, name: str) -> tuple[Array, Array, Array]:
        if name not in self.model.names:
            fixed = float(self.model.fixed_value(name))
            return np.array([fixed, fixed]), np.array([0.0, 1.0]), np.array([0.5, 0.5])
        if name in self.model.lead:
            place = self.model.lead.index(name)
            axis = self.grid.axes[place]
            fine, density = density_of(axis, log_marginal(self.grid.joint, place))
            values = self.model.at(name, fine)
        else:
            values, density = self._bias_density(self.model.group_names.index(name))
        cdf = cumulative_trapezoid(density, initial=0)
        return values, cdf / cdf[-1], density / density.sum()

    def _bias_density(self, group: int) -> tuple[Array, Array]:
        """Density of one bias: the mixture over k of its conditionals, each a spline."""
        blocks = self.grid.biases[group]
        most = max(mass.sum(axis=1).max() for _, mass in blocks)
        factor = 32  # finer than the nodes of one conditional, so that it fills the common axis
        places, weights = [], []
        for nodes, mass in blocks:
            above = mass.sum(axis=1) > 1e-7 * most
            if not above.any():
                continue
            count = nodes.shape[1]
            finer = np.linspace(0, count - 1, factor * (count - 1) + 1)
            log_mass = np.log(np.maximum(mass[above], 1e-40))
            weights.append(np.exp(CubicSpline(np.arange(count), log_mass, axis=1)(finer)).ravel())
            score = nodes[above, :1] + (nodes[above, 1:2] - nodes[above, :1]) * finer
            places.append(bias_at(self.model, score).ravel())
        place, weight = np.concatenate(places), np.concatenate(weights)
        keep = weight > 1e-12 * weight.max()
        place, weight = place[keep], weight[keep]
        fine = np.linspace(place.min(), place.max(), 801)
        # Each node's mass is shared between the two nearest points of the common axis.
        at = (place - fine[0]) / (fine[1] - fine[0])
        left = np.minimum(at.astype(np.intp), fine.size - 2)
        share = at - left
        density = np.bincount(left, weight * (1 - share), fine.size)
        density = density + np.bincount(left + 1, weight * share, fine.size)
        return fine, density.astype(float)

    def quantile(self, name: str, probability: ArrayLike) -> Array:
        values, cdf, _ = self._curve(name)
        return np.interp(np.asarray(probability, dtype=float), cdf, values)

    def mean(self, name: str) -> float:
        values, _, weight = self._curve(name)
        return float(weight @ values)

    def sd(self, name: str) -> float:
        values, _, weight = self._curve(name)
        return float(np.sqrt(weight @ (values - weight @ values) ** 2))

    def score_curve(self) -> tuple[Array, Array]:
        log_density = log_marginal(self.grid.joint, 0)
        above = np.flatnonzero(np.isfinite(log_density))
        span = slice(above[0], above[-1] + 1)
        return self.grid.axes[0][span], log_density[span]

    def mode(self) -> dict[str, float]:
        if not self.model.names:
            return {}
        node = np.unravel_index(int(np.argmax(self.grid.joint)), self.grid.joint.shape)
        point = np.array([a[i] for a, i in zip(self.grid.axes, node, strict=True)])
        names = self.model.group_names if self.model.free_bias else ()
        biases = [float(self.quantile(name, 0.5)) for name in names]
        start = np.r_[self._scores(point)[np.flatnonzero(self.model.free)], biases]
        return named_values(self.model, find_mode(self.model, start)[0])

    def draws(self) -> Draws:
        return self._draws

    @cached_property
    def _draws(self) -> Draws:
        rng = np.random.default_rng(self.seed)
        t = self._lead_draws(rng)
        return self.model.draws_at(self._scores(t), self._bias_draws(rng, t))

    def _lead_draws(self, rng: np.random.Generator) -> Array:
        """Coordinates of k, effects, lapses by rejection, (N, lead): proposed from the grid,
        interpolated linearly, kept by a cubic spline of its log density."""
        free = [i for i, axis in enumerate(self.grid.axes) if axis.size > 1]
        out = np.zeros((self.n_draws, len(self.grid.axes)))
        if not free:
            return out
        first, step = np.array([(a[0], a[1] - a[0]) for a in (self.grid.axes[i] for i in free)]).T
        log = self.grid.joint.squeeze() - self.grid.joint.max()
        # A spline through the fall to empty nodes would ring.
        log = np.maximum(log, log[np.isfinite(log)].min() - 1.0)
        spline, last = spline_filter(log), np.array(log.shape) - 1
        cumulative = np.cumsum(np.exp(log).ravel())
        kept, count, bound = [], 0, 0.0
        while count < self.n_draws:
            node = np.searchsorted(cumulative, rng.random(2048) * cumulative[-1], side="right")
            place = np.array(np.unravel_index(node, log.shape), dtype=float)
            place += rng.random(place.shape) - rng.random(place.shape)
            place = place[:, ((place >= 0) & (place <= last[:, None])).all(axis=0)]
            inside = map_coordinates(np.exp(log), place, order=1)
            ratio = np.exp(map_coordinates(spline, place, prefilter=False)) / inside
            # The largest ratios are far out, where hardly anything is proposed.
            bound = bound or float(np.quantile(ratio, 0.999))
            kept.append(place[:, rng.random(ratio.size) * bound < ratio])
            count += kept[-1].shape[1]
        out[:, free] = first + step * np.hstack(kept)[:, : self.n_draws].T
        return out

    def _scores(self, t: Array) -> Array:
        """Scores at grid coordinates, (..., lead)."""
        columns = [s.score(t[..., i]) for i, s in enumerate(self.model.transforms)]
        return np.stack(columns, axis=-1)

    def _bias_draws(self, rng: np.random.Generator, t: Array) -> Array:
        """Biases (N, G) given the rest, at coordinates (N, lead), on nodes where the grid found
        the bias to be."""
        m = self.model
        if not m.free_bias:
            return np.full((len(t), m.n_groups), m.fixed_bias())
        k, effects, low, high = m.at_scores(self._scores(t))
        first, last = self._bias_span(t)
        share = np.linspace(0, 1, 4 * (self.grid.bias_nodes - 1) + 1)
        out = np.empty(first.shape)
        rows = max(1, 40_000 // (share.size * max(m.cells.n.size, 1)))
        for i in (slice(j, j + rows) for j in range(0, k.size, rows)):
            step = (last[i] - first[i]) * share[1]
            score = first[i, None] + (last - first)[i, None] * share[:, None]
            by_cell = m.cell_log_likelihood(
                k[i, None], low[i, None], high[i, None], bias_at(m, score), effects[i, None]
            )
            log_mass = by_cell @ m.membership - 0.5 * score**2
            below = np.cumsum(np.exp(log_mass - log_mass.max(axis=1, keepdims=True)), axis=1)
            node = (below < rng.random((len(step), 1, m.n_groups)) * below[:, -1:]).sum(axis=1)
            at = np.take_along_axis(score, node[:, None], axis=1)[:, 0]
            out[i] = at + step * (rng.random(at.shape) - rng.random(at.shape))
        return bias_at(m, out)

    def _bias_span(self, t: Array) -> tuple[Array, Array]:
        """Between which scores each bias lies, (M, G), by the outer nodes around."""
        axes, (low, high) = self.grid.axes[:-2], self.grid.windows
        shape = [a.size for a in axes]
        first, last = np.full((2, len(low), len(t)), np.array([np.inf, -np.inf])[:, None, None])
        for corner in product((0, 1), repeat=len(axes)):
            at = [
                np.clip(np.searchsorted(a, x, side="right") - 1 + c, 0, a.size - 1)
                for a, x, c in zip(axes, t.T, corner, strict=False)
            ]
            node = np.ravel_multi_index(at, shape)
            first, last = np.minimum(first, low[:, node]), np.maximum(last, high[:, node])
        return first.T, last.T


@dataclass(frozen=True, repr=False)
class SampledPosterior(Fields):
    """Draws by emcee: `chains` independent ensembles one after another."""

    model: WeberModel
    sample: Draws
    chains: int
    error: float
    trouble: str
    log_evidence: float | None = None

    def mean(self, name: str) -> float:
        return float(self._column(name).mean())

    def sd(self, name: str) -> float:
        return float(self._column(name).std())

    def quantile(self, name: str, probability: ArrayLike) -> Array:
        at = np.asarray(probability, dtype=float)
        return np.asarray(np.quantile(self._column(name), at), dtype=float)

    def score_curve(self) -> tuple[Array, Array]:
        """ln of the posterior density of k's score: its own given the rest, averaged over draws.

        Counts of draws would say nothing of ends where there is one in a thousand of them.
        """
        axis = np.linspace(-REACH, REACH, 73)
        few = self.sample.thinned(400)
        low, high, bias, effects = (
            np.repeat(values[:, None], axis.size, axis=1) for values in few.values[1:]
        )
        k = np.broadcast_to(self.model.value("weber_fraction", axis), low.shape)
        log = self.model.log_likelihood(k, low, high, bias, effects) - 0.5 * axis**2
        log -= logsumexp(log, axis=1, keepdims=True)
        return axis, logsumexp(log, axis=0)

    def mode(self) -> dict[str, float]:
        dim = sum(self.model.free) + self.model.free_bias * self.model.n_groups
        return named_values(self.model, find_mode(self.model, np.zeros(dim))[0])

    def draws(self) -> Draws:
        return self.sample

    def _column(self, name: str) -> Array:
        named = self.sample.named(self.model)
        return named[name] if name in named else np.full(2, self.model.fixed_value(name))


WeberPosterior: TypeAlias = QuadraturePosterior | SampledPosterior


def sample(
    model: WeberModel, *, seed: int | np.random.SeedSequence | np.random.Generator
) -> SampledPosterior:
    """Sample the posterior with emcee, four ensembles of the scores and biases.

    `trouble` says so where the run has not converged, to 0.03 sds of every parameter.
    """
    from .._util.sampling import Shortfall, sample_stacked

    rng = np.random.default_rng(seed)
    dim = sum(model.free) + model.free_bias * model.n_groups
    if dim == 0:
        raise Refusal(
            "every parameter is fixed", remedy="leave at least one of them a distribution"
        )

    def log_density(theta: Array) -> Array:
        inside = (np.abs(theta[..., : sum(model.free)]) < REACH).all(axis=-1)
        return np.where(inside, log_posterior(model, theta), -np.inf)

    centre, covariance = find_mode(model, np.zeros(dim))
    root = np.linalg.cholesky(covariance)
    start = centre + rng.standard_normal((1, 4, max(32, 4 * dim), dim)) @ root.T
    # A start outside the support is pulled towards the mode until it is inside.
    while (lost := ~np.isfinite(log_density(start))).any():
        start[lost] = centre + 0.5 * (start[lost] - centre)
    run = sample_stacked(log_density, start, seed=rng, precision=0.03)
    flat = run.values[0].reshape(-1, dim)
    error = float(np.max(run.mcse_mean[0] / run.sd[0]))
    trouble = "" if run.converged[0] else f"emcee: {Shortfall(int(run.shortfall[0])).message}"
    return SampledPosterior(model, model.draws_at(*split(model, flat)), 4, error, trouble)
