"""The posterior of one observer on a grid: marginals, quantiles, and independent draws."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.ndimage import map_coordinates, spline_filter
from scipy.special import ndtr

from .._util.values import Array, Fields, Index
from .axes import bias_at, bias_prior
from .importance import Target
from .integrate import PosteriorGrid, density_of, integrate, log_marginal
from .likelihood import Draws, WeberModel
from .posteriors import find_mode, named_values

__all__ = ["QuadraturePosterior"]


@dataclass(frozen=True, repr=False)
class QuadraturePosterior(Fields):
    """The posterior integrated by quadrature; draws from it are independent and exact."""

    model: WeberModel
    grid: PosteriorGrid
    seed: int = 0
    n_draws: int = 4000
    chains: int = 4
    _curves: dict[str, tuple[Array, Array, Array]] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    @classmethod
    def integrated(cls, model: WeberModel, seed: int = 0) -> QuadraturePosterior:
        """The posterior of a model without effects."""
        return cls(model, integrate(model), seed)

    def recomputed(self, model: WeberModel) -> QuadraturePosterior:
        return self.integrated(model)

    @property
    def target(self) -> Target:
        return Target(self.model)

    @property
    def log_evidence(self) -> float:
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
        """One bias and the density of its coordinate, in which a long tail is short.

        It is the mixture over k of its conditionals. Where a bias follows k closely they are
        narrower than nodes of k are apart, so that their quantiles are interpolated to finer ones.
        """
        blocks = self.grid.biases[group]
        most = max(block.mass.sum(axis=1).max() for block in blocks)
        probability = ndtr(np.linspace(-6.0, 6.0, 601))
        rows, masses = [], []
        for nodes, mass in blocks:
            above = mass.sum(axis=1) > 1e-7 * most
            log_mass = np.log(np.maximum(mass[above], 1e-40))
            finer = np.linspace(0, nodes.shape[1] - 1, 32 * (nodes.shape[1] - 1) + 1)
            weight = np.exp(CubicSpline(np.arange(nodes.shape[1]), log_mass, axis=1)(finer))
            below = np.cumsum(weight, axis=1) - 0.5 * weight
            place = nodes[above, :1] + np.diff(nodes[above, :2]) * finer
            for x, share in zip(place, below / weight.sum(axis=1, keepdims=True), strict=True):
                rows.append(np.interp(probability, share, x))
            masses.append(mass[above].sum(axis=1))
        place, log_mass = np.stack(rows), np.log(np.concatenate(masses))
        if len(place) > 3:
            finer = np.linspace(0, len(place) - 1, 8 * (len(place) - 1) + 1)
            place = PchipInterpolator(np.arange(len(place)), place)(finer)
            log_mass = CubicSpline(np.arange(len(log_mass)), log_mass)(finer)
        share = np.diff(probability, prepend=0.0, append=1.0)
        weight = (np.exp(log_mass)[:, None] * 0.5 * (share[:-1] + share[1:])).ravel()
        place = place.ravel()
        fine = np.linspace(place.min(), place.max(), 801)
        # Each point's mass is shared between the two nearest of the common axis.
        at = (place - fine[0]) / (fine[1] - fine[0])
        left = np.minimum(at.astype(np.intp), fine.size - 2)
        density = np.bincount(left, weight * (1 - (at - left)), fine.size)
        density = density + np.bincount(left + 1, weight * (at - left), fine.size)
        return bias_at(self.model, fine), density.astype(float)

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
        of_groups = self.grid.biases if self.model.free_bias else []
        biases = [
            sum(float((nodes * mass).sum()) for nodes, mass in blocks)
            / sum(float(mass.sum()) for _, mass in blocks)
            for blocks in of_groups
        ]
        start = np.r_[self._scores(point)[np.flatnonzero(self.model.free)], biases]
        return named_values(self.model, find_mode(self.model, start)[0])

    def draws(self) -> Draws:
        return self._draws

    def reproducible_draws(self) -> Draws:
        return self._draws if self.seed == 0 else self._reproducible_draws

    @cached_property
    def _draws(self) -> Draws:
        return self._drawn(np.random.default_rng(self.seed))

    @cached_property
    def _reproducible_draws(self) -> Draws:
        return self._drawn(np.random.default_rng(0))

    def _drawn(self, rng: np.random.Generator) -> Draws:
        coordinates = self._lead_draws(rng)
        bias = self._bias_draws(rng, coordinates)
        return self.model.draws_at(self._scores(coordinates), bias)

    def _lead_draws(self, rng: np.random.Generator) -> Array:
        """Coordinates of k and lapses by rejection, (N, 3): proposed from the grid,
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
        first, last, count = self._bias_span(t[:, 0])
        out = np.empty(first.shape)
        order, done = np.argsort(count, kind="stable"), 0
        while done < k.size:
            i = order[done : done + max(1, 40_000 // (count[order[done]] * max(m.cells.n.size, 1)))]
            done += i.size
            nodes = int(count[i[-1]])
            share = np.linspace(0, 1, nodes)
            score = first[i, None] + (last - first)[i, None] * share[:, None]
            by_cell = m.cell_log_likelihood(
                k[i, None], low[i, None], high[i, None], bias_at(m, score), effects[i, None]
            )
            log_mass = _between(by_cell @ m.membership + bias_prior(m, score))
            share = np.linspace(0, 1, log_mass.shape[1])
            step = (last[i] - first[i]) * share[1]
            score = first[i, None] + (last - first)[i, None] * share[:, None]
            below = np.cumsum(np.exp(log_mass - log_mass.max(axis=1, keepdims=True)), axis=1)
            node = (below < rng.random((len(step), 1, m.n_groups)) * below[:, -1:]).sum(axis=1)
            at = np.take_along_axis(score, node[:, None], axis=1)[:, 0]
            out[i] = at + step * (rng.random(at.shape) - rng.random(at.shape))
        return bias_at(m, out)

    def _bias_span(self, k: Array) -> tuple[Array, Array, Index]:
        """Between which coordinates each bias lies, (M, G), and how many nodes were enough there,
        (M,), by the nodes of k on either side."""
        nodes = self.grid.axes[0]
        left = np.clip(np.searchsorted(nodes, k, side="right") - 1, 0, nodes.size - 1)
        right = np.minimum(left + 1, nodes.size - 1)
        first = [np.minimum(s.first[left], s.first[right]) for s in self.grid.windows]
        last = [np.maximum(s.last[left], s.last[right]) for s in self.grid.windows]
        count = np.maximum(self.grid.bias_nodes[left], self.grid.bias_nodes[right])
        return np.stack(first, axis=1), np.stack(last, axis=1), count


def _between(values: Array) -> Array:
    """Values at even nodes of axis 1, four times as finely by a cubic spline: a log density is as
    good there, and its answers' probabilities are a quarter."""
    nodes = values.shape[1]
    if nodes <= 100:  # beyond, its matrix takes longer than splines do, and 400 MB at 3600 nodes
        return _spline_matrix(nodes) @ values
    return np.asarray(CubicSpline(np.arange(nodes), values, axis=1)(_quarters(nodes)))


@lru_cache(maxsize=64)
def _spline_matrix(nodes: int) -> Array:
    if nodes < 2:
        return np.ones((1, nodes))
    return np.asarray(CubicSpline(np.arange(nodes), np.eye(nodes))(_quarters(nodes)))


def _quarters(nodes: int) -> Array:
    return np.linspace(0, nodes - 1, 4 * (nodes - 1) + 1)
