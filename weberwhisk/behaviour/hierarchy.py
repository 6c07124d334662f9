"""Many animals at once: each one's Weber fraction and lapses drawn from a population.

ln k of an animal is normal about the population's, with a spread between animals, and if wanted
between the sessions of one animal; the normal scores of its lapses are normal too. Each animal's
own parameters are integrated out, so that five numbers describe the population: that many can be
integrated as well. No sampler takes part; the cost grows with the number of animals, not with a
power of it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates, zoom
from scipy.special import logsumexp

from .priors import PopulationPriors
from .tabulated import Table

Array = NDArray[np.float64]

NODES_PER_SD = 4.0  # of ln k, for the sharpest member
COARSEST = 0.15  # nodes of ln k, however little members tell: spreads are told apart from 0.1 on
NAMES = ("log_weber_fraction", "spread", "session_spread", "lapse_mean", "lapse_spread")
COARSE = (13, 13, 7, 7, 4)
FINE = (23, 27, 11, 21, 9)
KEPT = 1e-6  # of the peak: what a marginal density may fall to within the axes


@dataclass(frozen=True)
class Members:
    """The tables of a population: one for each animal, or for each session of each animal.

    `animal` (U,) rises and says whose each table is.
    """

    tables: tuple[Table, ...]
    animal: NDArray[np.intp]
    sessions: bool
    lapse_correlation: float

    @property
    def first(self) -> NDArray[np.intp]:
        """The first table of each animal."""
        return np.flatnonzero(np.r_[True, np.diff(self.animal) > 0])

    def axis(self, finest: float) -> Array:
        """Nodes of ln k on which all members are compared."""
        low = min(t.log_k[0] for t in self.tables) - 0.5
        high = max(t.log_k[-1] for t in self.tables) + 0.5
        return np.arange(low, high + finest, finest)


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
        needed = sorted({j for name in names for j in _AXES_OF[name]})
        mass = self.mass.sum(axis=tuple(j for j in range(5) if j not in needed), keepdims=True)
        factor = [FINER[len(needed)] if j in needed and mass.shape[j] > 1 else 1 for j in range(5)]
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


_AXES_OF = {
    "log_weber_fraction": (0, 1, 2),
    "spread": (1,),
    "session_spread": (2,),
    "lapse_mean": (3,),
    "lapse_spread": (4,),
}
FINER = {1: 24, 2: 8, 3: 5}  # by how many axes are interpolated at once


def _zoomed(values: Array, factor: Sequence[int]) -> Array:
    """Cubic interpolation, the ends kept; mirrored at the ends, as a density is about no spread."""
    shape = [n * f - f + 1 for n, f in zip(values.shape, factor, strict=True)]
    # Every axis costs a factor of four, one of a single node too.
    size = [(m, n) for m, n in zip(shape, values.shape, strict=True) if n > 1]
    if not size:
        return values
    out = zoom(np.squeeze(values), [m / n for m, n in size], order=3, mode="mirror")
    return np.asarray(out.reshape(shape), dtype=float)


def _end_weights(shape: Sequence[int]) -> Array:
    """Half at either end of every axis, 1 within."""
    out = np.ones(shape)
    for axis, n in enumerate(shape):
        if n > 1:
            weight = np.ones(n)
            weight[[0, -1]] = 0.5
            out = out * weight.reshape([-1 if i == axis else 1 for i in range(len(shape))])
    return out


class Work:
    """The likelihood of a population's parameters, given its members' tables."""

    def __init__(self, members: Members) -> None:
        self.members = members
        self.mean, self.sd = np.array([_moments(t) for t in members.tables]).T
        self.x = members.axis(min(self.sd.min() / NODES_PER_SD, COARSEST))
        self.step = self.x[1] - self.x[0]

    def middle(self, spread: Array, session_spread: float) -> tuple[Array, Array]:
        """Where ln k of the population lies given its spreads, and how surely, both (T,).

        As if every member's likelihood were normal: only the place of nodes depends on it.
        """
        precision = 1 / (self.sd**2 + session_spread**2)
        first = self.members.first
        total = np.add.reduceat(precision, first)
        mean = np.add.reduceat(precision * self.mean, first) / total
        weight = 1 / (1 / total + spread[:, None] ** 2)
        return weight @ mean / weight.sum(axis=1), 1 / np.sqrt(weight.sum(axis=1))

    def kernel(self, centre: Array, spread: Array) -> Array:
        """Probability of each node of ln k under normals, (X, ...)."""
        # A normal narrower than the nodes is as wide as they are: a fifth of what any member tells.
        width = np.maximum(spread, 0.8 * self.step)
        z = (self.x.reshape(-1, *[1] * np.ndim(centre)) - centre) / width
        return np.exp(-0.5 * z**2) * (self.step / (width * np.sqrt(2 * np.pi)))

    def given_lapses(self, mean: Array, spread: Array) -> Array:
        """Log-likelihood of ln k of every member, (J, U, X), for J populations of lapses."""
        out = [
            table.given_lapses(
                table.lapse_weights(mean, spread, self.members.lapse_correlation), self.x
            )
            for table in self.members.tables
        ]
        return np.moveaxis(np.array(out), -1, 0)

    def by_animal(self, log_like: Array, session_spread: float) -> tuple[Array, Array]:
        """Log-likelihood of each animal's middle ln k, (A, X), and of each member's (U, X)."""
        if not self.members.sessions:
            return log_like, log_like
        top = log_like.max(axis=1, keepdims=True)
        between = self.kernel(self.x, np.full(self.x.shape, session_spread))
        own = np.log(np.maximum(np.exp(log_like - top) @ between, 1e-300)) + top
        return np.add.reduceat(own, self.members.first, axis=0), own

    def log_likelihood(
        self, log_like: Array, session_spread: float, between: Array
    ) -> tuple[Array, Array]:
        """Of the population, (MT,), by animal (A, MT); `between` is the kernel (X, MT)."""
        animal, _ = self.by_animal(log_like, session_spread)
        top = animal.max(axis=1, keepdims=True)
        by_animal = np.log(np.maximum(np.exp(animal - top) @ between, 1e-300)) + top
        return by_animal.sum(axis=0), by_animal


def _moments(table: Table) -> tuple[float, float]:
    """Mean and sd of ln k in the likelihood of a member alone, with the prior's lapses."""
    weights = table.lapse_weights(np.zeros(1), np.ones(1), 0.0)
    log_like = table.given_lapses(weights, table.log_k)[:, 0]
    mass = np.exp(log_like - log_like.max())
    mean = mass @ table.log_k / mass.sum()
    return float(mean), float(np.sqrt(mass @ (table.log_k - mean) ** 2 / mass.sum()))


def integrate_population(
    members: Members, priors: PopulationPriors, log_weber_fraction: Callable[[Array], Array]
) -> Population:
    """The posterior of a population.

    Parameters
    ----------
    members : Members
    priors : PopulationPriors
    log_weber_fraction : callable
        Log-density of the prior of the population's ln k.
    """
    grid = _Grid(Work(members), priors, log_weber_fraction)
    ranges = list(grid.bounds)
    for counts in (COARSE, COARSE, COARSE, FINE):
        grid.lay(ranges, counts)
        log_mass = grid.log_mass()
        ranges = [_narrowed(log_mass, j, grid.axes[j], grid.bounds[j]) for j in range(5)]
    grid.lay(ranges, FINE)
    log_mass = grid.log_mass()
    log_evidence = float(logsumexp(log_mass))
    mass = np.exp(log_mass - log_evidence)
    of_members, of_animals = grid.shrunken(mass)
    # What half the nodes miss, squared: sums over whole bumps converge exponentially. The last
    # axis is cut off at its ends, and converges by a quarter each time.
    missed = [_thinned(mass, j) for j in range(5)]
    error = max(max(missed[:4]) ** 2, missed[4] / 3)
    return Population(
        tuple(grid.axes),
        grid.values(),
        mass,
        grid.work.x,
        of_members,
        of_animals,
        log_evidence,
        error,
    )


class _Grid:
    """Nodes of the population's parameters, and what is integrated over them.

    The first axis places ln k in its conditional sds from its conditional middle, given the
    spreads; the last is the log of the lapses' spread.
    """

    def __init__(
        self, work: Work, priors: PopulationPriors, log_weber_fraction: Callable[[Array], Array]
    ) -> None:
        self.work, self.priors, self.log_weber_fraction = work, priors, log_weber_fraction
        tables = work.members.tables
        no_lapses = all(t.low.size == t.high.size == 1 for t in tables)
        self.fixed = [False, False, not work.members.sessions, no_lapses, no_lapses]
        self.bounds: list[tuple[float, float]] = [
            (-12.0, 12.0),
            (0.0, float(priors.spread.ppf(1 - 1e-6))),
            (0.0, float(priors.session_spread.ppf(1 - 1e-6))),
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

    def values(self) -> dict[str, Array]:
        """The parameters at the nodes; they broadcast."""
        place, tau, sigma, mean, spread = self.axes
        middle, sd = np.stack([self.work.middle(tau, s) for s in sigma], axis=-1)  # (T, S)
        log_k = middle + sd * place[:, None, None]
        rest = np.meshgrid(tau, sigma, mean, np.exp(spread), indexing="ij", sparse=True)
        return dict(zip(NAMES, (log_k[..., None, None], *(a[None] for a in rest)), strict=True))

    def log_mass(self) -> Array:
        """Log posterior mass of every node, not normalised."""
        out = np.empty([a.size for a in self.axes])
        for at, log_like, session_spread, between in self._slices():
            total, _ = self.work.log_likelihood(log_like, session_spread, between)
            out[at] = total.reshape(out.shape[:2])
        values, priors = self.values(), self.priors
        scale = np.stack([self.work.middle(self.axes[1], s)[1] for s in self.axes[2]], axis=-1)
        out += self.log_weber_fraction(values[NAMES[0]]) + np.log(scale)[..., None, None]
        for j, name in enumerate(NAMES):
            if self.fixed[j]:
                continue
            axis = self.axes[j]
            weight = np.full(axis.size, np.log(axis[1] - axis[0]))
            # Half a cell at the ends. At a spread of zero that is exact: all is even about it.
            weight[[0, -1]] -= np.log(2.0)
            if j:
                weight += getattr(priors, name).logpdf(np.exp(axis) if j == 4 else axis)
            weight += axis if j == 4 else 0.0
            out += weight.reshape([-1 if i == j else 1 for i in range(5)])
        return out

    def _slices(self) -> Iterator[tuple[Any, Array, float, Array]]:
        """Each population of lapses and session spread: where it goes, the members' likelihood,
        the spread, and the kernel (X, MT) of all populations of ln k."""
        _, tau, sigma, mean, spread = self.axes
        log_k = self.values()[NAMES[0]][..., 0, 0]
        tiled = np.broadcast_to(tau, log_k.shape[:2]).ravel()
        kernels = [self.work.kernel(log_k[..., s].ravel(), tiled) for s in range(sigma.size)]
        for i, m in enumerate(mean):  # a row of lapse populations at a time: they take room
            for j, log_like in enumerate(
                self.work.given_lapses(np.full(spread.size, m), np.exp(spread))
            ):
                for s, session_spread in enumerate(sigma):
                    yield (slice(None), slice(None), s, i, j), log_like, session_spread, kernels[s]

    def shrunken(self, mass: Array) -> tuple[Array, Array]:
        """Posterior probabilities of ln k of each member (U, X) and each animal (A, X)."""
        work = self.work
        size = work.members.first.size, work.x.size
        members, animals = np.zeros((len(work.members.tables), size[1])), np.zeros(size)
        for at, log_like, session_spread, between in self._slices():
            weight = mass[at].ravel()
            if weight.sum() < 1e-9:
                continue
            _, by_animal = work.log_likelihood(log_like, session_spread, between)
            animal, own = work.by_animal(log_like, session_spread)
            # What the others say of an animal: every population by how it fares without it.
            low = by_animal.min(
                axis=1, keepdims=True, where=weight > 1e-12 * weight.max(), initial=np.inf
            )
            believed = (weight * np.exp(np.minimum(low - by_animal, 0.0))) @ between.T
            log_post = animal - low + np.log(np.maximum(believed, 1e-300))
            animals += np.exp(log_post)
            if not work.members.sessions:
                continue
            within = work.kernel(work.x, np.full(work.x.shape, session_spread))
            rest = log_post[work.members.animal] - own  # without this session
            high = rest.max(axis=1, keepdims=True)
            prior = np.log(np.maximum(np.exp(rest - high) @ within.T, 1e-300)) + high
            members += np.exp(prior + log_like)
        animals /= animals.sum(axis=1, keepdims=True)
        if not work.members.sessions:
            return animals, animals
        return members / members.sum(axis=1, keepdims=True), animals


def _narrowed(
    log_mass: Array, index: int, axis: Array, bounds: tuple[float, float]
) -> tuple[float, float]:
    """The part of an axis that holds the mass, a step more on either side."""
    if axis.size == 1:
        return bounds
    others = tuple(i for i in range(log_mass.ndim) if i != index)
    marginal = logsumexp(log_mass, axis=others)
    marginal[[0, -1]] += np.log(2.0)
    held = axis[marginal > marginal.max() + np.log(KEPT)]
    step = axis[1] - axis[0]
    return max(held[0] - step, bounds[0]), min(held[-1] + step, bounds[1])


def _thinned(mass: Array, index: int) -> float:
    """How far the total moves when every other node is left out."""
    if mass.shape[index] == 1:
        return 0.0
    marginal = mass.sum(axis=tuple(i for i in range(5) if i != index))
    return float(abs(np.log(2 * marginal[::2].sum())))
