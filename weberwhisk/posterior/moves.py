"""emcee moves that pair walkers only inside their own block of rows."""

from __future__ import annotations

from collections.abc import Sequence

import emcee
import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

from .nodes import Nodes

Array = NDArray[np.float64]

#: Share of a posterior's mass below which a cell is not drawn from.
LEAST_SHARE = 1e-5
#: How much wider than at the middle of its cell the last coordinate's proposals are.
WIDER = 1.1
#: Proposals worked out together, unless one step takes more, and the most steps that they are for.
AHEAD, MOST_AHEAD = 24_000, 32


class StackedMove(emcee.moves.Move):
    """An emcee move that pairs walkers only inside their own block of rows.

    Block b owns rows b*W to (b+1)*W. At each step the places 0 to W-1 are split in two halves at
    random; each half is updated against the other, in all blocks at once and in block order.

    Which place pairs with which is drawn once a step and shared by all blocks; the stretch, the
    sign and the acceptance are drawn for each walker. Given the shared draws every block's step
    still leaves its own density invariant, so the blocks stay independent; and each block draws
    only from its own place in the stream, so changing one posterior does not change another.

    Parameters
    ----------
    walkers : int
        Walkers in a block, even.
    rng : numpy.random.Generator
        emcee hands its moves an old `RandomState`; this is faster, and seeded by the caller.
    """

    def __init__(self, walkers: int, rng: np.random.Generator) -> None:
        self.walkers = walkers
        self.rng = rng

    def begin(self, posteriors: int, rows: int) -> None:
        """Told of how many posteriors the blocks are, and how many rows belong to each."""

    def leave(self, stay: NDArray[np.bool_]) -> None:
        """Told which posteriors go on, when the others are done."""

    def proposal(self, active: Array, rest: Array) -> tuple[Array, Array | float]:
        """New places for `active` (blocks, W/2, D) from `rest`, and the log Hastings factor."""
        raise NotImplementedError

    def propose(
        self, model: emcee.model.Model, state: emcee.State
    ) -> tuple[emcee.State, NDArray[np.bool_]]:
        """One step of every walker of every block; emcee calls this."""
        rows, dim = state.coords.shape
        blocks, half = rows // self.walkers, self.walkers // 2
        coords = state.coords.reshape(blocks, self.walkers, dim)
        log_prob = state.log_prob.reshape(blocks, self.walkers)
        accepted = np.zeros((blocks, self.walkers), dtype=bool)
        order = self.rng.permutation(self.walkers)
        for active, rest in ((order[:half], order[half:]), (order[half:], order[:half])):
            old, old_log_prob = coords[:, active], log_prob[:, active]
            new, factor = self.proposal(old, coords[:, rest])
            # emcee's own compute_log_prob_fn converts value by value, at 0.2 µs each.
            new_log_prob = model.log_prob_fn(new.reshape(-1, dim)).reshape(blocks, half)
            # log(u) is the negative of a standard exponential, and never -inf.
            threshold = old_log_prob - factor - self.rng.standard_exponential(new_log_prob.shape)
            take = new_log_prob > threshold
            coords[:, active] = np.where(take[..., None], new, old)
            log_prob[:, active] = np.where(take, new_log_prob, old_log_prob)
            accepted[:, active] = take
        return state, accepted.ravel()


class StackedStretch(StackedMove):
    """Goodman and Weare's (2010) stretch move inside each block.

    A walker moves along the line through a partner of the other half, by a factor z of density
    ∝ 1/√z on (1/stretch, stretch); the Hastings factor is z^(D-1).
    """

    def __init__(self, walkers: int, rng: np.random.Generator, *, stretch: float = 2.0) -> None:
        super().__init__(walkers, rng)
        self.stretch = stretch

    def proposal(self, active: Array, rest: Array) -> tuple[Array, Array | float]:
        blocks, half, dim = active.shape
        partner = rest[:, self.rng.integers(half, size=half)]
        z = ((self.stretch - 1.0) * self.rng.random((blocks, half)) + 1.0) ** 2 / self.stretch
        return partner + z[..., None] * (active - partner), (dim - 1.0) * np.log(z)


class StackedDifferentialEvolution(StackedMove):
    """Differential evolution (ter Braak 2006; Nelson et al. 2014) inside each block.

    A walker moves by ±γ times the difference of two others of the other half. The sign is drawn
    for each walker, so the move is symmetric whatever pair was drawn. γ is 2.38/√(2D) with 10 %
    jitter (which keeps a small ensemble from living on a lattice) or, in a fraction `unit` of
    the moves, 1: a step from one region of mass to another.
    """

    def __init__(
        self,
        walkers: int,
        rng: np.random.Generator,
        *,
        gamma: float | None = None,
        jitter: float = 0.1,
        unit: float = 0.1,
    ) -> None:
        super().__init__(walkers, rng)
        self.gamma = gamma
        self.jitter = jitter
        self.unit = unit

    def proposal(self, active: Array, rest: Array) -> tuple[Array, Array | float]:
        blocks, half, dim = active.shape
        first = self.rng.integers(half, size=half)
        second = (first + self.rng.integers(1, half, size=half)) % half
        gamma = 2.38 / np.sqrt(2.0 * dim) if self.gamma is None else self.gamma
        step = gamma * (1.0 + self.jitter * self.rng.standard_normal(half))
        step = np.where(self.rng.random(half) < self.unit, 1.0, step)
        sign = self.rng.integers(0, 2, size=(blocks, half), dtype=np.int8) * 2 - 1
        return active + (sign * step)[..., None] * (rest[:, first] - rest[:, second]), 0.0


class StackedGrid(StackedMove):
    """Proposals that do not depend on where a walker is: cells of a grid over each posterior.

    A cell is drawn by its weight and a point inside it evenly, or, in a share `wide` of the
    steps, Student's t about the grid's mean, which reaches what lies outside. The grid is fixed
    before the run, so this is plain Metropolis–Hastings (Tierney 1994, Ann. Stat. 22, 1701):
    nearly every step is an independent draw, whatever the density's shape. Where the grid has
    missed something, walkers linger there, which the other moves of a mixture help and the run's
    diagnostics see.

    The last coordinate need not be on the grid: given its mean and sd at every node, and how the
    mean changes from node to node, it is drawn from a normal distribution, somewhat wider.

    As no proposal depends on a walker, all move at once, and where few posteriors are left the
    proposals of many steps are drawn and their densities worked out together.

    Parameters
    ----------
    nodes : sequence of Nodes
        The weighted grid of every posterior.
    last : sequence of array, shape (N, 1 + D), optional
        Sd and mean of the last coordinate at the nodes of each, and the slopes of the mean, a step
        along each of the grid's D - 1 axes.
    wide : float
        Share of the proposals that are Student's t.
    freedom : float
        Its degrees of freedom.
    """

    def __init__(
        self,
        walkers: int,
        rng: np.random.Generator,
        *,
        nodes: Sequence[Nodes],
        last: Sequence[Array] | None = None,
        wide: float = 0.05,
        freedom: float = 5.0,
    ) -> None:
        super().__init__(walkers, rng)
        self.wide, self.freedom = wide, freedom
        self.points = np.concatenate([grid.points for grid in nodes])
        weights = np.concatenate([grid.weights for grid in nodes])
        sizes = np.array([len(grid.points) for grid in nodes])
        self.first = np.cumsum(sizes) - sizes
        sums = np.add.reduceat(weights, self.first)
        share = weights / np.repeat(sums, sizes)
        # Cells of no weight are left to the wide proposals: what is searched stays in the cache.
        self.drawn = np.flatnonzero(share > LEAST_SHARE)
        block = np.repeat(np.arange(len(nodes)), sizes)[self.drawn]
        share = np.where(share > LEAST_SHARE, share, 0.0)
        share /= np.repeat(np.add.reduceat(share, self.first), sizes)
        # Cumulative shares, those of block b between b and b + 1: one search serves all blocks.
        below = np.cumsum(share[self.drawn])
        ends = np.searchsorted(block, np.arange(len(nodes)), side="right")
        self.cumulative = below - np.concatenate([[0.0], below[ends - 1]])[block] + block
        self.cumulative[ends - 1] = np.arange(1, len(nodes) + 1)
        self.edges = np.stack([grid.edges for grid in nodes])
        self.into_cells = np.linalg.inv(self.edges)
        self.origin = self.points[self.first]
        self.shape = np.array([grid.shape for grid in nodes])
        self.stride = np.cumprod(self.shape[:, ::-1], axis=1)[:, ::-1] // self.shape
        self.density = share / np.repeat(np.abs(np.linalg.det(self.edges)), sizes)
        share, points = share[self.drawn], self.points[self.drawn]
        self.last = None
        if last is not None:
            self.last = np.concatenate(last)
            self.last[:, 0] *= WIDER
            points = np.column_stack([points, self.last[self.drawn, 1]])
        starts = np.searchsorted(block, np.arange(len(nodes)))
        self.centre = np.add.reduceat(share[:, None] * points, starts)
        off = points - self.centre[block]
        dim = points.shape[1]
        covariance = np.stack(
            [np.add.reduceat(share[:, None] * off[:, [i]] * off, starts) for i in range(dim)],
            axis=1,
        )
        # No narrower than a cell, should a single node hold all of the mass.
        inside = self.edges @ self.edges.swapaxes(1, 2) / 12
        covariance[:, : inside.shape[1], : inside.shape[1]] += inside
        if self.last is not None:
            square = np.square(self.last[self.drawn, 0])
            covariance[:, -1, -1] += np.add.reduceat(share * square, starts)
        self.root = 1.3 * np.linalg.cholesky(covariance)
        self.inverse = np.linalg.inv(self.root)
        half = (freedom + dim) / 2
        self.height = np.abs(np.linalg.det(self.inverse)) * np.exp(
            gammaln(half) - gammaln(freedom / 2) - dim / 2 * np.log(freedom * np.pi)
        )

    def begin(self, posteriors: int, rows: int) -> None:
        self.alive = np.arange(posteriors)
        # Of the proposals ahead, (b, steps, rows, ...): places, log-densities, ln of their own.
        self.ahead: list[Array] = []
        self.seen = np.full((posteriors, rows, self.centre.shape[1]), np.nan)
        self.proposed = np.empty((posteriors, rows))  # ln of the proposals' density at `seen`

    def leave(self, stay: NDArray[np.bool_]) -> None:
        self.alive = self.alive[stay]
        self.ahead = [part[stay] for part in self.ahead]
        self.seen, self.proposed = self.seen[stay], self.proposed[stay]

    def propose(
        self, model: emcee.model.Model, state: emcee.State
    ) -> tuple[emcee.State, NDArray[np.bool_]]:
        """One step of every walker of every posterior; emcee calls this."""
        if not self.ahead or not self.ahead[0].shape[1]:
            self.look_ahead(model)
        (new, value, drawn), self.ahead = (
            [part[:, 0] for part in self.ahead],
            [part[:, 1:] for part in self.ahead],
        )
        coords, log_prob = state.coords.reshape(new.shape), state.log_prob.reshape(value.shape)
        moved = (coords != self.seen).any(axis=(1, 2))  # by another move
        if moved.any():
            self.proposed[moved] = self.log_density(coords[moved], self.alive[moved])
        # log(u) is the negative of a standard exponential, and never -inf.
        threshold = log_prob - self.proposed - self.rng.standard_exponential(value.shape)
        take = value - drawn > threshold
        for kept, candidate in ((log_prob, value), (self.proposed, drawn), (coords, new)):
            kept[take] = candidate[take]
        self.seen[:] = coords
        return state, take.ravel()

    def look_ahead(self, model: emcee.model.Model) -> None:
        """Draw the proposals of the next steps, and work out their densities."""
        count, rows, dim = self.seen.shape
        steps = min(max(AHEAD // (count * rows), 1), MOST_AHEAD)
        x, drawn = self.draw(steps * rows)
        value = model.log_prob_fn(x.reshape(-1, dim))
        shape = (count, steps, rows)
        self.ahead = [x.reshape(*shape, dim), value.reshape(shape), drawn.reshape(shape)]

    def draw(self, count: int) -> tuple[Array, Array]:
        """Proposals (b, count, D) for every posterior left, and ln of their density (b, count)."""
        size = (len(self.alive), count)
        u = self.rng.random(size) * (1 - 1e-12)  # rounding must not lift it into the next block
        where = np.searchsorted(self.cumulative, self.alive[:, None] + u, side="right")
        node = self.drawn[where]
        inside = self.rng.random((*size, self.points.shape[1])) - 0.5
        x = self.points[node] + inside @ self.edges[self.alive].swapaxes(1, 2)
        within = self.density[node]
        if self.last is not None:
            z = self.rng.standard_normal(size)
            mean, sd = self.of_last(self.last, node, inside)
            x = np.concatenate([x, (mean + sd * z)[..., None]], axis=-1)
            within = within * _normal(z) / sd
        far = np.nonzero(self.rng.random(size) < self.wide)
        block = self.alive[far[0]]
        z = self.rng.standard_normal((len(block), x.shape[-1]))
        z /= np.sqrt(self.rng.chisquare(self.freedom, len(block)) / self.freedom)[:, None]
        x[far] = self.centre[block] + np.einsum("bij,bj->bi", self.root[block], z)
        within[far] = self.within(x[far][:, None], block)[:, 0]
        return x, self.mixture(x, within, self.alive)

    def log_density(self, x: Array, index: NDArray[np.intp]) -> Array:
        """ln of the density that proposals x (b, n, D) for posteriors `index` (b,) have."""
        return self.mixture(x, self.within(x, index), index)

    def within(self, x: Array, index: NDArray[np.intp]) -> Array:
        """The density of the cells at x; 0 outside the grid."""
        on_grid = x[..., : self.points.shape[1]]
        steps = (on_grid - self.origin[index][:, None]) @ self.into_cells[index].swapaxes(1, 2)
        top = self.shape[index][:, None] - 1
        cell = np.clip(np.rint(steps), 0, top).astype(np.intp)
        node = self.first[index][:, None] + (cell * self.stride[index][:, None]).sum(axis=-1)
        held = (np.abs(steps - cell) <= 0.5 + 1e-9).all(axis=-1)
        density = np.where(held, self.density[node], 0.0)
        if self.last is None:
            return density
        mean, sd = self.of_last(self.last, node, steps - cell)
        return np.asarray(density * _normal((x[..., -1] - mean) / sd) / sd)

    @staticmethod
    def of_last(last: Array, node: NDArray[np.intp], inside: Array) -> tuple[Array, Array]:
        """Mean and sd of the last coordinate, at places inside cells, in steps from the nodes."""
        sd, mean, *slopes = (column[node] for column in last.T)
        for k, slope in enumerate(slopes):
            mean = mean + slope * inside[..., k]
        return mean, sd

    def mixture(self, x: Array, within: Array, index: NDArray[np.intp]) -> Array:
        """ln of the cells' density `within` at x and of Student's t, each with its share."""
        z = (x - self.centre[index][:, None]) @ self.inverse[index].swapaxes(1, 2)
        power = -(self.freedom + x.shape[-1]) / 2
        fall = np.exp(power * np.log(1 + np.square(z).sum(axis=-1) / self.freedom))
        tails = self.height[index][:, None] * fall
        return np.asarray(np.log((1 - self.wide) * within + self.wide * tails))


def _normal(z: Array) -> Array:
    """The standard normal density."""
    return np.asarray(np.exp(-0.5 * z**2) / np.sqrt(2 * np.pi))
