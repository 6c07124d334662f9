"""The same posterior by emcee, through the stacked sampler; the check on the quadrature."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import logsumexp

from ..posterior.ensemble import sample_stacked
from .likelihood import Draws, WeberModel
from .posteriors import find_mode, lead_values, map_point, score_precision
from .priors import REACH

Array = NDArray[np.float64]

#: Draws whose conditional densities of k are averaged.
CONDITIONAL = 400


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
        every = self.sample.weber_fraction.size // CONDITIONAL + 1
        low, high, bias, effects = (
            np.repeat(values[::every, None], axis.size, axis=1)
            for values in (
                self.sample.lapse_low,
                self.sample.lapse_high,
                self.sample.bias,
                self.sample.effects,
            )
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


def sample(
    model: WeberModel,
    *,
    seed: int | np.random.SeedSequence | np.random.Generator,
    ensembles: int = 4,
    precision: float = 0.03,
) -> SampledPosterior:
    """Sample the posterior with emcee, in the coordinates of `stretch` (biases as they are).

    Parameters
    ----------
    model : WeberModel
    seed : int, SeedSequence or Generator
    ensembles : int
        Independent ensembles; R-hat compares them.
    precision : float
        Monte Carlo error asked for, in posterior sds.

    Returns
    -------
    SampledPosterior
        `trouble` says so where the run has not converged.
    """
    rng = np.random.default_rng(seed)
    free = np.flatnonzero(model.free)
    n_bias = model.n_groups if model.free_bias else 0
    dim = free.size + n_bias
    if dim == 0:
        raise ValueError("every parameter is fixed; leave at least one of them a distribution.")
    of_scores = score_precision(model)
    transforms = [model.transforms[i] for i in free]
    ends = np.array([s.ends for s in transforms]).reshape(-1, 2).T

    def scores_of(theta: Array) -> Array:
        columns = [s.score(theta[..., i]) for i, s in enumerate(transforms)]
        return np.stack(columns, axis=-1) if columns else theta[..., :0]

    def unpack(theta: Array) -> tuple[Array, Array, Array, Array, Array]:
        z = np.zeros((*theta.shape[:-1], len(model.lead)))
        z[..., free] = scores_of(theta)
        k, effects, low, high = lead_values(model, z)
        if n_bias:
            bias = theta[..., free.size :]
        else:
            bias = np.full((*k.shape, model.n_groups), model.fixed_bias())
        return k, low, high, bias, effects

    def log_density(theta: Array) -> Array:
        k, low, high, bias, effects = unpack(theta)
        t, scores = theta[..., : free.size], scores_of(theta)
        inside = ((t > ends[0]) & (t < ends[1])).all(axis=-1)
        possible = (sum(model.lapses(low, high)) < 1) & inside
        out = model.log_likelihood(k, low, high, bias, effects)
        out = out - 0.5 * np.einsum("...i,ij,...j->...", scores, of_scores, scores)
        for i, transform in enumerate(transforms):
            out = out + np.log(transform.slope(t[..., i]))
        if n_bias:
            out = out + model.log_bias_prior(bias).sum(axis=-1)
        return np.where(possible, out, -np.inf)

    start_bias = np.full(model.n_groups, model.priors.moments("bias")[0] if n_bias else 0.0)
    mode, information = find_mode(model, np.zeros(len(model.lead)), start_bias)
    scores, bias = mode
    root = np.linalg.cholesky(np.linalg.inv(information))
    walkers = max(64, 4 * dim)
    at = [s.coordinate(z) for s, z in zip(transforms, scores[free], strict=True)]
    centre = np.r_[at, bias if n_bias else ()]
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
    trouble = "" if run.converged[0] else f"emcee: {_reason(run.shortfall[0])}"
    return SampledPosterior(model, Draws(*unpack(flat)), ensembles, error, trouble)


def _reason(shortfall: int) -> str:
    from ..posterior.run import Shortfall

    return Shortfall(int(shortfall)).message
