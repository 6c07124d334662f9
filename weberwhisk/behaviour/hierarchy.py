"""Many animals at once: each one's Weber fraction and lapses drawn from a population.

ln k of an animal is normal about the population's, with a spread between animals, and if wanted
between the sessions of one animal; the normal scores of its lapses are normal too, and biases are
those of their prior, all times one factor. Each animal's own parameters are integrated out, so that
six numbers describe the population: that many can be integrated as well. No sampler takes part; the
cost grows with the number of animals, not with a power of it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.interpolate import Akima1DInterpolator
from scipy.ndimage import binary_dilation, map_coordinates
from scipy.special import ndtr

from .._values import Array, Index
from .axes import AS_BELIEVED, BiasScales
from .integrate import half_grid_error
from .integrate.batch import Table
from .priors import PopulationPriors

NAMES = (
    "log_weber_fraction", "spread", "session_spread", "bias_scale", "lapse_mean", "lapse_spread",
)  # fmt: skip
ALL = range(len(NAMES))


@dataclass(frozen=True)
class Members:
    """The likelihood of a population's parameters, given the tables of its members: one for each
    animal, or for each session of each animal.

    `animal` (U,) rises and says whose each table is; `scales` are those of the biases at which all
    were made.
    """

    tables: tuple[Table, ...]
    animal: Index
    sessions: bool
    scales: BiasScales = AS_BELIEVED

    @cached_property
    def first(self) -> Index:
        """The first table of each animal."""
        return np.flatnonzero(np.r_[True, np.diff(self.animal) > 0])

    @cached_property
    def _moments(self) -> tuple[Array, Array]:
        """Mean and log sd of ln k of each alone, with the prior's lapses, by scale, (U, S)."""
        found = np.array([_moments(t) for t in self.tables])
        return found[:, 0], found[:, 1]

    @cached_property
    def x(self) -> Array:
        """Nodes of ln k on which all are compared."""
        # However little members tell, spreads are distinguished from 0.1 on.
        step = min(float(np.exp(self._moments[1].min())) / 4, 0.15)
        low = min(t.log_k[0] for t in self.tables) - 0.5
        high = max(t.log_k[-1] for t in self.tables) + 0.5
        return np.arange(low, high + step, step)

    @property
    def step(self) -> float:
        """How far these are apart."""
        return float(self.x[1] - self.x[0])

    def middle(
        self, spread: Array, session_spread: Array, bias_scale: Array
    ) -> tuple[Array, Array]:
        """Where ln k of the population lies given its spreads, and how surely, both (T, Z, B).

        As if every member's likelihood were normal: only the place of nodes depends on it.
        """
        onto = self.scales.onto(bias_scale).T
        mean, log_sd = self._moments
        own_mean, own_sd = mean @ onto, np.exp(log_sd @ onto)  # (U, B)
        precision = 1 / (own_sd[:, None] ** 2 + session_spread[:, None] ** 2)  # (U, Z, B)
        first = self.first
        total = np.add.reduceat(precision, first)
        mean = np.add.reduceat(precision * own_mean[:, None], first) / total
        weight = 1 / (1 / total + spread[:, None, None, None] ** 2)  # (T, A, Z, B)
        sum_of_weights = weight.sum(axis=1)
        return (weight * mean).sum(axis=1) / sum_of_weights, 1 / np.sqrt(sum_of_weights)

    def kernel(self, centre: Array, spread: Array) -> Array:
        """Probability of each node of ln k under normals, (X, ...).

        The end nodes stand for all beyond them, where a likelihood goes on as it was: populations
        out there are unlikely by their prior, and not impossible.
        """
        # A normal narrower than the nodes is as wide as they are: a fifth of what any member tells.
        width = np.maximum(spread, 0.8 * self.step)
        z = (self.x.reshape(-1, *[1] * np.ndim(centre)) - centre) / width
        out: Array = np.exp(-0.5 * z**2) * (self.step / (width * np.sqrt(2 * np.pi)))
        half = 0.5 * self.step / width
        out[0] += ndtr(z[0] - half)
        out[-1] += ndtr(-z[-1] - half)
        return out

    def within(self, session_spread: float) -> Array | None:
        """The kernel of sessions about their animal's ln k, (X, X); none where they are one."""
        if not self.sessions:
            return None
        return self.kernel(self.x, np.full(self.x.shape, session_spread))

    def given_lapses(self, mean: Array, spread: Array, bias_scale: Array) -> Array:
        """Log-likelihood of ln k of every member, (B, J, U, X).

        For J populations of lapses, and each scale of the biases (B,).
        """
        onto = self.scales.onto(bias_scale)
        out = [table.given_lapses(mean, spread, self.x, onto) for table in self.tables]
        return np.array(out).transpose(1, 3, 0, 2)

    def by_animal(self, log_like: Array, within: Array | None) -> tuple[Array, Array]:
        """Log-likelihood of each animal's middle ln k, (..., A, X), and each member's (..., U, X).

        `within` is the kernel of its sessions.
        """
        if within is None:
            return log_like, log_like
        own = _log_product(log_like, within)
        return np.add.reduceat(own, self.first, axis=-2), own

    def log_likelihood(
        self, log_like: Array, within: Array | None, between: Array
    ) -> tuple[Array, Array]:
        """Of the population, (..., MT), by animal (..., A, MT); `between` is the kernel (X, MT)."""
        by_animal = _log_product(self.by_animal(log_like, within)[0], between)
        return by_animal.sum(axis=-2), by_animal


def _log_product(log_like: Array, kernel: Array) -> Array:
    """ln of the likelihoods averaged over each column of a kernel."""
    top = log_like.max(axis=-1, keepdims=True)
    return np.log(np.maximum(np.exp(log_like - top) @ kernel, 1e-300)) + top


def _moments(table: Table) -> tuple[Array, Array]:
    """Mean and log sd of ln k in the likelihood of a member alone, with the prior's lapses, for
    every scale of its biases, (S,)."""
    usual = np.zeros(1), np.ones(1)
    log_like = table.given_lapses(*usual, table.log_k, np.eye(len(table.top)))[..., 0]
    mass = np.exp(log_like - log_like.max(axis=1, keepdims=True))
    mass /= mass.sum(axis=1, keepdims=True)
    mean = mass @ table.log_k
    variance = (mass * (table.log_k - mean[:, None]) ** 2).sum(axis=1)
    return mean, 0.5 * np.log(variance)


@dataclass(frozen=True)
class Population:
    """The posterior of the population's parameters on nodes.

    `mass` is the posterior probability of each node, dimensions as in `NAMES`; `values` are their
    parameters, arrays that broadcast to it. `members` (U, X) and `animals` (A, X) are the posterior
    probabilities of ln k on the nodes `log_k` of each session and each animal, given all the data.
    """

    axes: tuple[Array, ...]
    values: dict[str, Array]
    mass: Array
    log_k: Array
    members: Array
    animals: Array
    log_evidence: float
    error: float

    def nodes(self, *names: str) -> tuple[list[Array], Array]:
        """Values of parameters at the nodes, and the probabilities of these, flat.

        The nodes are few, being made for integrals: they are interpolated to many, so that sums up
        to a value make a quantile.
        """
        first = NAMES[0]  # depends on the spreads as well
        needed = sorted({j for n in names for j in (range(4) if n == first else [NAMES.index(n)])})
        mass = self.mass.sum(axis=tuple(j for j in ALL if j not in needed), keepdims=True)
        many = [j for j in needed if mass.shape[j] > 1]
        finer = (1, 24, 8, 5, 3)[len(many)]  # by how many axes are interpolated at once
        factor = [finer if j in many else 1 for j in ALL]
        ends = _end_weights(mass.shape)
        fine = np.exp(_zoomed(np.log(np.maximum(mass / ends, 1e-300)), factor))
        fine *= _end_weights(fine.shape)
        values = []
        for name in names:
            own = self.values[name]
            own_factor = [f if n > 1 else 1 for f, n in zip(factor, own.shape, strict=True)]
            values.append(np.broadcast_to(_zoomed(own, own_factor), fine.shape).ravel())
        return values, fine.ravel() / fine.sum()

    def draws(self, count: int, seed: int) -> dict[str, Array]:
        """Joint draws of the parameters, each (count,): nodes, moved within their cells."""
        rng = np.random.default_rng(seed)
        at = np.unravel_index(
            rng.choice(self.mass.size, count, p=self.mass.ravel()), self.mass.shape
        )
        # Moved by a triangle of a cell's width, as linear interpolation between nodes would; places
        # beyond the first node are reflected, which for a spread is exact.
        place = [
            np.abs(i + (rng.random(count) - rng.random(count)) * (n > 1))
            for i, n in zip(at, self.mass.shape, strict=True)
        ]
        out = {}
        for name in NAMES:
            own = self.values[name]
            used = [p if n > 1 else np.zeros(count) for p, n in zip(place, own.shape, strict=True)]
            out[name] = map_coordinates(own, used, order=1, mode="nearest")
        return out


def _zoomed(values: Array, factor: Sequence[int], mirrored: int = 2, bulge: float = 0.5) -> Array:
    """Cubic interpolation, the ends kept; level at the ends, as a density is about no spread.

    By Akima's slopes, which are local: a log density that is cut off at a node, a bounded prior's,
    made a spline overshoot its neighbours by hundreds, and what lay there was the whole posterior.
    `mirrored` nodes beyond an end are what Akima's slope at it needs; `bulge` is how far, in nats,
    a normal's log lies above nodes two of its sds apart.
    """
    for axis, f in enumerate(factor):
        n = values.shape[axis]
        if f == 1 or n == 1:
            continue
        known = np.moveaxis(values, axis, 0)
        # Mirrored at either end, so that the slope is zero there.
        place = np.arange(-mirrored, n + mirrored)
        curve = Akima1DInterpolator(place, known[n - 1 - np.abs(n - 1 - np.abs(place))])
        fine = curve(np.linspace(0, n - 1, n * f - f + 1))
        # Two nodes between two cut-offs still overshoot: no bump that the nodes can tell does so.
        cell = np.minimum(np.arange(len(fine)) // f, n - 2)
        ends = known[cell], known[cell + 1]
        fine = np.clip(fine, np.minimum(*ends) - bulge, np.maximum(*ends) + bulge)
        values = np.moveaxis(fine, 0, axis)
    return values


def _end_weights(shape: Sequence[int]) -> Array:
    """Half at either end of every axis, 1 within."""
    out = np.ones(shape)
    for axis, n in enumerate(shape):
        if n > 1:
            weight = np.ones(n)
            weight[[0, -1]] = 0.5
            out = out * weight.reshape([-1 if i == axis else 1 for i in range(len(shape))])
    return out


def integrate_population(
    members: Members, priors: PopulationPriors, log_weber_fraction: Callable[[Array], Array]
) -> Population:
    """The posterior of a population, given the log-density of the prior of its ln k."""
    grid = _Grid(members, priors, log_weber_fraction)
    ranges = list(grid.bounds)
    coarse, fine = (13, 13, 7, 7, 7, 4), (23, 27, 11, 11, 21, 9)
    finer_biases = (23, 27, 11, 27, 21, 9)  # where their scale has a peak and a long tail
    for counts in (coarse, coarse, coarse, fine):
        grid.lay(ranges, counts)
        log_mass = grid.log_mass()
        mass = np.exp(log_mass - log_mass.max())
        ranges = [_narrowed(mass, j, grid.axes[j], grid.bounds[j]) for j in ALL]
    for counts in (fine, finer_biases):
        grid.lay(ranges, counts)
        log_mass = grid.log_mass()
        top = log_mass.max()
        mass = np.exp(log_mass - top)
        total = mass.sum()
        mass /= total
        missed = [half_grid_error(_marginal(mass, j)) for j in ALL]
        if missed[3] < 0.1:
            break
    of_members, of_animals = grid.shrunken(mass)
    # What half the nodes miss, squared: sums over whole bumps converge exponentially. The last
    # axis is cut off at its ends, and converges by a quarter each time.
    error = max(max(missed[:-1]) ** 2, missed[-1] / 3, _cut_within(log_mass, mass))
    error = np.inf if grid.cut_off(mass) else error
    return Population(
        tuple(grid.axes),
        grid.values(),
        mass,
        grid.members.x,
        of_members,
        of_animals,
        float(top + np.log(total)),
        error,
    )


class _Grid:
    """Nodes of the population's parameters, and what is integrated over them.

    The first axis places ln k in its conditional sds from its conditional middle, given the
    spreads; the biases' scale goes by asinh, the lapses' spread by its log.
    """

    def __init__(
        self,
        members: Members,
        priors: PopulationPriors,
        log_weber_fraction: Callable[[Array], Array],
    ) -> None:
        self.members, self.priors, self.log_weber_fraction = members, priors, log_weber_fraction
        no_lapses = all(t.lapses.possible.size == 1 for t in members.tables)
        scales, self.unit = members.scales.nodes, members.scales.unit
        self.fixed = [
            False, False, not members.sessions, scales.size == 1, no_lapses, no_lapses,
        ]  # fmt: skip
        self.bounds: list[tuple[float, float]] = [
            (-12.0, 12.0),
            *(
                (max(float(prior.support()[0]), 0.0), float(prior.ppf(1 - 1e-6)))
                for prior in (priors.spread, priors.session_spread)
            ),
            (float(np.arcsinh(scales[0] / self.unit)), float(np.arcsinh(scales[-1] / self.unit))),
            (-3.5, 3.5),
            (float(np.log(0.15)), float(np.log(2.0))),
        ]
        self.axes: list[Array] = []

    def lay(self, ranges: Sequence[tuple[float, float]], counts: Sequence[int]) -> None:
        """Even nodes over these ranges."""
        self.axes = [
            np.zeros(1) if f else np.linspace(*r, n)
            for r, n, f in zip(ranges, counts, self.fixed, strict=True)
        ]

    def cut_off(self, mass: Array, share: float = 1e-3) -> bool:
        """Whether scales of the biases that were not tabulated are likely too: whether the density
        at the last is more than that share of the peak."""
        by_scale, ends = _marginal(mass, 3), self.members.scales.nodes[[0, -1]]
        at_end = np.isclose(self.on_axes()[0][3][[0, -1]], ends) & (ends != 0) & (not self.fixed[3])
        return bool(np.any(at_end & (2 * by_scale[[0, -1]] > share * by_scale.max())))

    def on_axes(self) -> tuple[list[Array], list[Array]]:
        """The parameters on their axes (the first is a place yet), and the logs of their slopes."""
        values, slopes = list(self.axes), [np.zeros(axis.size) for axis in self.axes]
        values[3], slopes[3] = (self.unit * f(self.axes[3]) for f in (np.sinh, np.cosh))
        slopes[3] = np.log(slopes[3])
        values[5], slopes[5] = np.exp(self.axes[5]), self.axes[5]
        return values, slopes

    def values(self) -> dict[str, Array]:
        """The parameters at the nodes; they broadcast."""
        place, *spreads, mean, spread = self.on_axes()[0]
        middle, sd = self.members.middle(*spreads)  # (T, Z, B)
        log_k = middle + sd * place[:, None, None, None]
        rest = np.meshgrid(*spreads, mean, spread, indexing="ij", sparse=True)
        return dict(zip(NAMES, (log_k[..., None, None], *(a[None] for a in rest)), strict=True))

    def log_mass(self) -> Array:
        """Log posterior mass of every node, not normalised."""
        out = np.empty([a.size for a in self.axes])
        for at, log_like, within, between in self._slices():
            total, _ = self.members.log_likelihood(log_like, within, between)
            out[at] = total.T.reshape(out[at].shape)
        on_axes, slopes = self.on_axes()
        _, scale = self.members.middle(*on_axes[1:4])
        out += self.log_weber_fraction(self.values()[NAMES[0]]) + np.log(scale)[..., None, None]
        for j, name in enumerate(NAMES):
            if self.fixed[j]:
                continue
            axis = self.axes[j]
            weight = np.log(axis[1] - axis[0]) + slopes[j]
            # Half a cell at the ends. At a spread of zero that is exact: all is even about it.
            weight[[0, -1]] -= np.log(2.0)
            weight += getattr(self.priors, name).logpdf(on_axes[j]) if j else 0.0
            out += weight.reshape([-1 if i == j else 1 for i in ALL])
        return out

    def _slices(
        self, most_numbers: int = 10_000_000
    ) -> Iterator[tuple[Any, Array, Array | None, Array]]:
        """Populations that differ in ln k, its spread and the lapses' spread alone: where they go,
        the members' likelihood (J, U, X), and the kernels of sessions and of animals (X, MT), of
        which so many numbers are kept for other lapses."""
        _, tau, sigma, scale, mean, spread = self.on_axes()[0]
        log_k = self.values()[NAMES[0]][..., 0, 0]
        tiled = np.broadcast_to(tau, log_k.shape[:2]).ravel()
        known: dict[tuple[int, int], Array] = {}
        for i, m in enumerate(mean):  # a row of lapse populations at a time: they take memory
            log_like = self.members.given_lapses(np.full(spread.size, m), spread, scale)
            for s, session_spread in enumerate(sigma):
                within = self.members.within(session_spread)
                for b in range(scale.size):
                    between = known.get((s, b))
                    if between is None:
                        between = self.members.kernel(log_k[..., s, b].ravel(), tiled)
                        if (len(known) + 1) * between.size <= most_numbers:
                            known[s, b] = between
                    yield (slice(None), slice(None), s, b, i), log_like[b], within, between

    def shrunken(self, mass: Array) -> tuple[Array, Array]:
        """Posterior probabilities of ln k of each member (U, X) and each animal (A, X)."""
        members = self.members
        size = members.first.size, members.x.size
        sessions, animals = np.zeros((len(members.tables), size[1])), np.zeros(size)
        for at, every, within, between in self._slices():
            for weight, log_like in zip(mass[at].reshape(-1, len(every)).T, every, strict=True):
                if weight.sum() < 1e-9:
                    continue
                _, by_animal = members.log_likelihood(log_like, within, between)
                animal, own = members.by_animal(log_like, within)
                # What the others say of an animal: every population by how it fares without it.
                low = by_animal.min(
                    axis=1, keepdims=True, where=weight > 1e-12 * weight.max(), initial=np.inf
                )
                believed = (weight * np.exp(np.minimum(low - by_animal, 0.0))) @ between.T
                log_post = animal - low + np.log(np.maximum(believed, 1e-300))
                animals += np.exp(log_post)
                if within is None:
                    continue
                rest = log_post[members.animal] - own  # without this session
                high = rest.max(axis=1, keepdims=True)
                prior = np.log(np.maximum(np.exp(rest - high) @ within.T, 1e-300)) + high
                sessions += np.exp(prior + log_like)
        animals /= animals.sum(axis=1, keepdims=True)
        if not members.sessions:
            return animals, animals
        return sessions / sessions.sum(axis=1, keepdims=True), animals


def _narrowed(
    mass: Array, index: int, axis: Array, bounds: tuple[float, float], least: float = 1e-6
) -> tuple[float, float]:
    """The part of an axis with at least that share of the peak, a step more on either side."""
    if axis.size == 1:
        return bounds
    marginal = _marginal(mass, index)
    marginal[[0, -1]] *= 2.0
    above = axis[marginal > least * marginal.max()]
    step = axis[1] - axis[0]
    return max(above[0] - step, bounds[0]), min(above[-1] + step, bounds[1])


def _marginal(mass: Array, index: int) -> Array:
    """Mass along one axis."""
    return np.asarray(mass.sum(axis=tuple(i for i in ALL if i != index)))


def _cut_within(log_mass: Array, mass: Array) -> float:
    """Up to what share of the posterior is misjudged where a prior ends between two nodes.

    Half a cell beside each node that has an impossible neighbour. Sums do not converge there, and
    leaving out every other node does not show it.
    """
    possible = np.isfinite(log_mass)
    if possible.all():
        return 0.0
    return 0.5 * float(mass[possible & binary_dilation(~possible)].sum())
