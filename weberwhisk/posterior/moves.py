"""emcee moves that pair walkers only inside their own block of rows."""

from __future__ import annotations

import emcee
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


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
        self.alive = np.zeros(1, dtype=np.intp)

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


class StackedIndependence(StackedMove):
    """Proposals that do not depend on where a walker is: Student's t about a guess, in each block.

    The guess, a centre and a root of the covariance, is fixed before the run, so this is plain
    Metropolis–Hastings (Tierney 1994, Ann. Stat. 22, 1701). Where the guess is good nearly every
    step is an independent draw; where it is not, walkers linger in tails heavier than t's, which
    the other moves of a mixture help and the run's diagnostics see.

    Parameters
    ----------
    centre : array, shape (B, D)
    root : array, shape (B, D, D)
        Of the covariance of every posterior.
    freedom : float
        Degrees of freedom: tails of the proposal.
    """

    def __init__(
        self,
        walkers: int,
        rng: np.random.Generator,
        *,
        centre: Array,
        root: Array,
        freedom: float = 5.0,
    ) -> None:
        super().__init__(walkers, rng)
        self.centre, self.root, self.freedom = centre, root, freedom
        self.inverse = np.linalg.inv(root)

    def proposal(self, active: Array, rest: Array) -> tuple[Array, Array | float]:
        index = np.repeat(self.alive, len(active) // len(self.alive))
        centre, dim = self.centre[index][:, None], active.shape[-1]
        z = self.rng.standard_normal(active.shape)
        z /= np.sqrt(self.rng.chisquare(self.freedom, active.shape[:2]) / self.freedom)[..., None]
        new = centre + z @ self.root[index].swapaxes(1, 2)
        old = (active - centre) @ self.inverse[index].swapaxes(1, 2)
        squares = [np.square(v).sum(axis=-1) for v in (z, old)]
        logs = [np.log1p(square / self.freedom) for square in squares]
        return new, (self.freedom + dim) / 2 * (logs[0] - logs[1])
