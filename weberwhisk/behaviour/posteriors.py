"""What is believed about an observer: mode, marginals, quantiles, and joint draws.

Either posterior has `draws` in `chains` one after another, an estimated `error` relative to the
posterior sd, and `trouble`: why its numbers are not to be relied on, empty where they are.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline, RegularGridInterpolator
from scipy.optimize import minimize
from scipy.special import logsumexp

from .._util.values import Array
from .axes import bias_at, log_lapses_possible
from .integrate import PosteriorGrid, Tolerance, density_of, integrate, log_marginal
from .likelihood import Draws, WeberModel
from .priors import REACH


def score_precision(model: WeberModel) -> Array:
    """Precision matrix of the free lead scores under their prior: the lapses of an observer, one
    at either end, are correlated."""
    free = np.array(model.free)
    covariance = np.eye(free.size)
    if free[-2:].all():
        covariance[-1, -2] = covariance[-2, -1] = model.priors.lapse_correlation
    return np.linalg.inv(covariance[np.ix_(free, free)])


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
    free = scores[..., np.flatnonzero(model.free)]
    out = model.log_likelihood(k, low, high, bias, effects)
    out = out - 0.5 * np.einsum("...i,ij,...j->...", free, score_precision(model), free)
    out = out + model.log_bias_prior(bias).sum(axis=-1)
    return np.where(sum(model.lapses(low, high)) < 1, out, -np.inf)


def find_mode(model: WeberModel, scores: Array) -> tuple[Array, Array]:
    """Mode of the free scores and biases (D,), from these lead scores on, and the Fisher
    information there.

    Levenberg–Marquardt on the binomial likelihood with the priors; only the place of the nodes
    depends on it, so the bias prior enters as a normal of its mean and sd, and overdispersion
    stays where it starts.
    """
    free = np.flatnonzero(model.free)
    n_bias = model.n_groups if model.free_bias else 0
    mean, sd = model.priors.moments("bias") if n_bias else (0.0, 1.0)
    prior_mean = np.r_[np.zeros(free.size), np.full(n_bias, mean)]
    precision = np.diag(np.full(free.size + n_bias, 1 / sd**2))
    precision[: free.size, : free.size] = score_precision(model)
    n, x = model.cells.n, model.cells.count
    if model.dispersed is not None:  # worth fewer trials than there are
        rho = float(model.value(model.effects[model.dispersed].name, 0.0))
        n, x = (a / (1 + np.maximum(model.cells.n - 1, 0) * rho) for a in (n, x))

    def probability(theta: Array) -> tuple[Array, Array]:
        z, bias = split(model, theta)
        k, effects, low, high = model.at_scores(z)
        return model.probability(k, low, np.minimum(high, 1 - low), bias, effects)

    def objective(p: Array, q: Array, theta: Array) -> float:
        off = theta - prior_mean
        return float(x @ np.log(p) + (n - x) @ np.log(q) - 0.5 * off @ precision @ off)

    theta = np.r_[scores[free], prior_mean[free.size :]]
    nudge = 1e-3 * np.eye(theta.size)
    damping, information = 1e-3, precision
    for _ in range(60):
        p, q = probability(np.concatenate([theta[None], theta + nudge, theta - nudge]))
        best = objective(p[0], q[0], theta)
        slopes = (p[1 : 1 + theta.size] - p[1 + theta.size :]) / 2e-3
        gradient = slopes @ (x / p[0] - (n - x) / q[0]) - precision @ (theta - prior_mean)
        information = (slopes * (n / (p[0] * q[0]))) @ slopes.T + precision
        moved = False
        while damping < 1e8:
            step = np.linalg.solve(information + damping * np.diag(np.diag(information)), gradient)
            step = np.clip(step, -2.0, 2.0)
            p, q = probability((theta + step)[None])
            if objective(p[0], q[0], theta + step) >= best:
                theta, damping, moved = theta + step, max(damping * 0.1, 1e-9), True
                break
            damping *= 10
        if not moved or step @ information @ step < 1e-2:
            break
    theta[: free.size] = np.clip(theta[: free.size], -REACH, REACH)
    return theta, information


def map_point(model: WeberModel, scores: Array) -> dict[str, float]:
    """The most probable values of the inferred parameters, found from these lead scores on.

    Most probable in the normal scores of the priors (for the Weber fraction that is in ln k): the
    lapses' density itself has no top, it grows without end towards 0.
    """
    if not model.names:
        return {}
    centre, information = find_mode(model, scores)
    scale = 1 / np.sqrt(np.diag(information))

    def cost(step: Array) -> float:
        return -max(float(log_posterior(model, centre + scale * step)), -1e10)

    found = minimize(cost, np.zeros(centre.size), method="Powell", options={"xtol": 1e-5})
    one = model.draws_at(*split(model, (centre + scale * found.x)[None]))
    return {name: float(value[0]) for name, value in one.named(model).items()}


@dataclass(frozen=True)
class QuadraturePosterior:
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
        cdf = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]))])
        return values, cdf / cdf[-1], density / density.sum()

    @cached_property
    def _grid_of_biases(self) -> PosteriorGrid:
        """The grid, finer in the lapses where each bias by itself leaves these little width."""
        wanted = Tolerance(given_bias=0.2)
        if self.grid.given_bias < wanted.given_bias or np.isinf(self.grid.error):
            return self.grid
        finer = integrate(self.model, wanted)
        return finer if np.isfinite(finer.error) else self.grid

    def _bias_density(self, group: int) -> tuple[Array, Array]:
        """Density of one bias: the mixture over k of its conditionals, each a spline."""
        blocks = self._grid_of_biases.biases[group]
        most = max(mass.sum(axis=1).max() for _, mass in blocks)
        # One conditional alone must be as fine as the common axis; many fill it in between them.
        factor = 32 if sum(len(nodes) for nodes, _ in blocks) < 100 else 8
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
        at = np.unravel_index(int(np.argmax(self.grid.joint)), self.grid.joint.shape)
        point = np.array([a[i] for a, i in zip(self.grid.axes, at, strict=True)])
        return map_point(self.model, self._scores(point))

    def draws(self) -> Draws:
        return self._draws

    @cached_property
    def _draws(self) -> Draws:
        rng = np.random.default_rng(self.seed)
        t = self._lead_draws(rng)
        return self.model.draws_at(self._scores(t), self._bias_draws(rng, t))

    def _lead_draws(self, rng: np.random.Generator) -> Array:
        """Coordinates of k, effects, lapses by rejection, (N, lead): proposed from the grid,
        interpolated linearly, kept by the exact density. For a log-concave bump the ratio of the
        two is bounded in the tails."""
        g = self.grid
        free = [i for i, axis in enumerate(g.axes) if axis.size > 1]
        if not free:
            return np.zeros((self.n_draws, len(g.axes)))
        axes = [g.axes[i] for i in free]
        joint = np.exp(g.joint - g.joint.max()).reshape([a.size for a in axes])
        steps = np.array([a[1] - a[0] for a in axes])
        proposal = RegularGridInterpolator(axes, joint, bounds_error=False, fill_value=0.0)
        cumulative = np.cumsum(joint.ravel())
        kept: list[Array] = []
        bound = 0.0
        while sum(map(len, kept)) < self.n_draws:
            node = np.searchsorted(cumulative, rng.random(2048) * cumulative[-1], side="right")
            place = np.column_stack(
                [a[i] for a, i in zip(axes, np.unravel_index(node, joint.shape), strict=True)]
            )
            place = place + steps * (rng.random(place.shape) - rng.random(place.shape))
            inside = proposal(place)
            place, inside = place[inside > 0], inside[inside > 0]
            z = np.zeros((len(place), len(g.axes)))
            z[:, free] = place
            ratio = np.exp(self._log_density(z, free) - g.joint.max()) / inside
            # The largest ratios are far out, where hardly anything is proposed.
            bound = bound or float(np.quantile(ratio, 0.999))
            kept.append(z[rng.random(len(z)) * bound < ratio])
        return np.concatenate(kept)[: self.n_draws]

    def _scores(self, t: Array) -> Array:
        """Scores at grid coordinates, (..., lead)."""
        columns = [s.score(t[..., i]) for i, s in enumerate(self.model.transforms)]
        return np.stack(columns, axis=-1)

    def _log_density(self, t: Array, free: list[int]) -> Array:
        """Log density of the coordinates at scattered places, (M,), biases integrated."""
        z = self._scores(t)
        log_mass, _, _ = self._conditional(t, 1)
        _, _, low, high = self.model.at_scores(z)
        possible = np.where(sum(self.model.lapses(low, high)) < 1, 0.0, -np.inf)
        precision = score_precision(self.model)
        x = z[:, free]
        prior = -0.5 * np.einsum("mi,ij,mj->m", x, precision, x)
        prior += 0.5 * np.linalg.slogdet(precision)[1] - 0.5 * len(free) * np.log(2 * np.pi)
        prior -= log_lapses_possible(self.model.task, self.model.priors)
        for i in free:
            prior += np.log(self.model.transforms[i].slope(t[:, i]))
        return np.asarray(logsumexp(log_mass, axis=1).sum(axis=1) + prior + possible)

    def _conditional(self, t: Array, finer: int) -> tuple[Array, Array, Array]:
        """Log mass of bias nodes given the rest, at coordinates (M, lead): (M, B, G); the scores
        of these nodes, and their steps (M, G). They lie where the grid found the bias to be."""
        m = self.model
        k, effects, low, high = m.at_scores(self._scores(t))
        first, last = self._bias_span(t)
        count = finer * (self.grid.bias_nodes - 1) + 1
        score = first[:, None] + (last - first)[:, None] * np.linspace(0, 1, count)[:, None]
        step = (last - first) / max(count - 1, 1)
        log_mass, bias = np.empty(score.shape), bias_at(m, score)
        rows = max(1, 40_000 // (count * max(m.cells.n.size, 1)))
        for i in (slice(j, j + rows) for j in range(0, k.size, rows)):
            cells = m.cell_log_likelihood(
                k[i, None], low[i, None], high[i, None], bias[i], effects[i, None]
            )
            log_mass[i] = cells @ m.membership
        if m.free_bias:
            log_mass += -0.5 * score**2 - 0.5 * np.log(2 * np.pi) + np.log(step)[:, None]
        return log_mass, score, step

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

    def _bias_draws(self, rng: np.random.Generator, t: Array) -> Array:
        if not self.model.free_bias:
            return np.full((len(t), self.model.n_groups), self.model.fixed_bias())
        out = []
        for part in np.array_split(t, max(len(t) // 500, 1)):
            log_mass, score, step = self._conditional(part, 4)
            weight = np.cumsum(np.exp(log_mass - log_mass.max(axis=1, keepdims=True)), axis=1)
            wanted = rng.random((len(part), 1, weight.shape[2])) * weight[:, -1:, :]
            at = np.minimum((weight < wanted).sum(axis=1), score.shape[1] - 1)
            node = np.take_along_axis(score, at[:, None, :], axis=1)[:, 0, :]
            out.append(node + step * (rng.random(node.shape) - rng.random(node.shape)))
        return bias_at(self.model, np.concatenate(out))


@dataclass(frozen=True)
class SampledPosterior:
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
        return map_point(self.model, np.zeros(len(self.model.lead)))

    def draws(self) -> Draws:
        return self.sample

    def _column(self, name: str) -> Array:
        named = self.sample.named(self.model)
        return named[name] if name in named else np.full(2, self.model.fixed_value(name))


WeberPosterior: TypeAlias = QuadraturePosterior | SampledPosterior


def sample(
    model: WeberModel,
    *,
    seed: int | np.random.SeedSequence | np.random.Generator,
    ensembles: int = 4,
    precision: float = 0.03,
) -> SampledPosterior:
    """Sample the posterior with emcee, in the coordinates of `stretch` (biases as they are).

    R-hat compares so many independent ensembles; `precision` is the Monte Carlo error requested, in
    posterior sds. `trouble` says so where the run has not converged.
    """
    from .._util.ensemble import Shortfall, sample_stacked

    rng = np.random.default_rng(seed)
    free = np.flatnonzero(model.free)
    dim = free.size + (model.n_groups if model.free_bias else 0)
    if dim == 0:
        raise ValueError("every parameter is fixed; leave at least one of them a distribution.")
    transforms = [model.transforms[i] for i in free]
    ends = np.array([s.ends for s in transforms]).reshape(-1, 2).T

    def with_scores(theta: Array) -> Array:
        """Scores in place of the coordinates."""
        out = theta.copy()
        for i, transform in enumerate(transforms):
            out[..., i] = transform.score(theta[..., i])
        return out

    def log_density(theta: Array) -> Array:
        t = theta[..., : free.size]
        inside = ((t > ends[0]) & (t < ends[1])).all(axis=-1)
        out = log_posterior(model, with_scores(theta))
        for i, transform in enumerate(transforms):
            out = out + np.log(transform.slope(t[..., i]))
        return np.where(inside, out, -np.inf)

    centre, information = find_mode(model, np.zeros(len(model.lead)))
    root = np.linalg.cholesky(np.linalg.inv(information))
    walkers = max(64, 4 * dim)
    centre[: free.size] = [s.coordinate(z) for s, z in zip(transforms, centre, strict=False)]
    # Of answers at chance lapses take all: the mode lies where they leave no rise, at the edge.
    for _ in range(60):
        if np.isfinite(log_density(centre)):
            break
        centre[: free.size] *= 0.9
    per_score = np.ones(dim)
    at = centre[: free.size]
    per_score[: free.size] = [1 / s.slope(t) for s, t in zip(transforms, at, strict=True)]
    start = centre + rng.standard_normal((1, ensembles, walkers, dim)) @ root.T * per_score
    # A start outside the support is pulled towards the mode until it is inside.
    for _ in range(60):
        lost = ~np.isfinite(log_density(start))
        if not lost.any():
            break
        start[lost] = centre + 0.5 * (start[lost] - centre)
    run = sample_stacked(log_density, start, seed=rng, precision=precision)
    flat = run.values[0].reshape(-1, dim)
    error = float(np.max(run.mcse_mean[0, :dim] / run.sd[0, :dim]))
    trouble = "" if run.converged[0] else f"emcee: {Shortfall(int(run.shortfall[0])).message}"
    draws = model.draws_at(*split(model, with_scores(flat)))
    return SampledPosterior(model, draws, ensembles, error, trouble)
