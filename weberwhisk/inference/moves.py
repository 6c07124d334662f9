"""Where walkers of many posteriors may start, and emcee moves that keep them in their own block."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import emcee
import numpy as np
from numpy.typing import ArrayLike
from scipy.special import gammaln

from .._values import Array, Flags, Index


class StackedMove(emcee.moves.Move):
    """An emcee move that pairs walkers only inside their own block of rows.

    Block b owns rows b*W to (b+1)*W, W even. At each step the places 0 to W-1 are split in two
    halves at random; each half is updated against the other, in all blocks at once and in order.

    Which place pairs with which is drawn once a step and shared by all blocks; the stretch, the
    sign and the acceptance are drawn for each walker. Given the shared draws every block's step
    still leaves its own density invariant, so the blocks stay independent; and each block draws
    only from its own place in the stream, so changing one posterior does not change another. emcee
    hands its moves an old `RandomState`; `rng` is faster, and seeded by the caller.
    """

    def __init__(self, walkers: int, rng: np.random.Generator) -> None:
        self.walkers = walkers
        self.rng = rng

    def begin(self, posteriors: int, rows: int) -> None:
        """Told of how many posteriors the blocks are, and how many rows belong to each."""

    def leave(self, stay: Flags) -> None:
        """Told which posteriors go on, when the others are done."""

    def proposal(self, active: Array, rest: Array) -> tuple[Array, Array | float]:
        """New places for `active` (blocks, W/2, D) from `rest`, and the log Hastings factor."""
        raise NotImplementedError

    def propose(self, model: emcee.model.Model, state: emcee.State) -> tuple[emcee.State, Flags]:
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


class StackedMixture(StackedMove):
    """Proposals that do not depend on where a walker is: Student's t about K places each.

    The mixture is fixed before the run, so this is plain Metropolis–Hastings (Tierney 1994, Ann.
    Stat. 22, 1701), right whatever the mixture; where it resembles the density most steps are
    independent draws, and walkers cross from one peak to another in their right proportion.

    As no proposal depends on a walker, all move at once, and where few posteriors are left the
    proposals of many steps are worked out together: so many in all (`ahead`), unless one step takes
    more, and of so many steps (`most_ahead`). `centre` (B, K, D); `root` (B, K, D, D), lower
    triangular, of the covariance of each t but for its own factor ν/(ν − 2); `weight` (B, K).
    """

    def __init__(
        self,
        centre: Array,
        root: Array,
        weight: Array,
        walkers: int,
        rng: np.random.Generator,
        *,
        ahead: int = 24_000,
        most_ahead: int = 32,
    ) -> None:
        super().__init__(walkers, rng)
        self.ahead, self.most_ahead = ahead, most_ahead
        self.centre, self.root = centre, root
        self.inverse = np.asarray(np.linalg.inv(root), dtype=float)
        self.weight = weight
        self.cumulative = np.cumsum(weight, axis=1)[:, :-1]

    def begin(self, posteriors: int, rows: int) -> None:
        self.alive = np.arange(posteriors)
        # Of the proposals ahead, (b, steps, rows, ...): places, log-densities, ln of their own.
        self.next: list[Array] = []
        self.seen = np.full((posteriors, rows, self.centre.shape[2]), np.nan)
        self.proposed = np.empty((posteriors, rows))  # ln of the proposals' density at `seen`

    def leave(self, stay: Flags) -> None:
        self.alive = self.alive[stay]
        self.next = [part[stay] for part in self.next]
        self.seen, self.proposed = self.seen[stay], self.proposed[stay]

    def propose(self, model: emcee.model.Model, state: emcee.State) -> tuple[emcee.State, Flags]:
        """One step of every walker of every posterior; emcee calls this."""
        if not self.next or not self.next[0].shape[1]:
            self._look_ahead(model)
        new, value, drawn = (part[:, 0] for part in self.next)
        self.next = [part[:, 1:] for part in self.next]
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

    def _look_ahead(self, model: emcee.model.Model) -> None:
        """Draw the proposals of the next steps, and work out their densities."""
        count, rows, dim = self.seen.shape
        steps = min(max(self.ahead // (count * rows), 1), self.most_ahead)
        x, drawn = self.draw(steps * rows)
        value = model.log_prob_fn(x.reshape(-1, dim))
        shape = (count, steps, rows)
        self.next = [x.reshape(*shape, dim), value.reshape(shape), drawn.reshape(shape)]

    def draw(self, count: int) -> tuple[Array, Array]:
        """Proposals (b, count, D) for every posterior left, and ln of their density (b, count)."""
        size = (len(self.alive), count)
        u = self.rng.random(size)
        which = (u[..., None] > self.cumulative[self.alive][:, None]).sum(axis=2)
        z = student_t_draws(self.rng, size, self.centre.shape[2])
        row = self.alive[:, None]
        x = self.centre[row, which] + np.einsum("bmij,bmj->bmi", self.root[row, which], z)
        return x, self.log_density(x, self.alive)

    def log_density(self, x: Array, index: Index) -> Array:
        """ln of the density that proposals x (b, m, D) for posteriors `index` (b,) have."""
        out = np.empty(x.shape[:2])
        # A few at a time: what is worked on stays in the cache.
        size = max(1, 20_000 // (x.shape[1] * self.weight.shape[1]))
        for start in range(0, len(x), size):
            part = slice(start, start + size)
            own = index[part]
            each = student_t(x[part], self.centre[own], self.inverse[own])
            out[part] = np.log((each @ self.weight[own][..., None])[..., 0])
        return out


def student_t(x: Array, centre: Array, inverse: Array) -> Array:
    """Densities (b, m, K) at x (b, m, D) of t's with centres (b, K, D) and inverse roots.

    With 4 degrees of freedom, or 5 in odd dimensions, so that the power is a product.
    """
    dim = x.shape[2]
    freedom = 4 + dim % 2
    half = (freedom + dim) / 2
    norm = gammaln(half) - gammaln(freedom / 2) - dim / 2 * np.log(freedom * np.pi)
    height = np.diagonal(inverse, axis1=2, axis2=3).prod(axis=2) * np.exp(norm)
    off = [x[:, :, None, i] - centre[:, None, :, i] for i in range(dim)]
    square = np.ones(1)
    for i in range(dim):  # product by product: a contraction costs several times as much
        z = inverse[:, None, :, i, 0] * off[0]
        for j in range(1, i + 1):
            z += inverse[:, None, :, i, j] * off[j]
        z *= z
        square = square + z / freedom
    fall = square.copy()
    for _ in range(int(half) - 1):
        fall *= square
    return np.asarray(height[:, None] / fall)


def student_t_draws(rng: np.random.Generator, shape: tuple[int, ...], dim: int) -> Array:
    """Draws (*shape, dim) of the t of `student_t` about 0 with the unit matrix."""
    freedom = 4 + dim % 2
    z = rng.standard_normal((*shape, dim))
    return np.asarray(z / np.sqrt(rng.chisquare(freedom, shape) / freedom)[..., None])


MoveMaker = Callable[[int, np.random.Generator], StackedMove]


def recommended_walkers(dim: int) -> int:
    """Walkers in an ensemble that cost least for what they give.

    With four ensembles a run's length is set by 40 autocorrelation times, and these depend little
    on the number of walkers: 4.6, 4.6, 4.7 steps in one dimension with 4, 8, 16 of them, 7.7 and
    8.5 in two with 6 and 8. In one dimension 8 balance that length against 2 % in the sd.
    """
    return max(8 if dim == 1 else 6, 2 * dim + 2)


def default_moves(dim: int) -> list[tuple[MoveMaker, float]]:
    """Moves and the share of the steps that each is given.

    Differential evolution in one dimension; beyond, one step in seven is a stretch to up to eight
    times the distance. Measured, in steps for one independent draw of the mean in one dimension:
    differential evolution 4.6 for a Gaussian and 9 for the shelf that Weber noise of 30 % leaves
    near the tip, the stretch move 27 and 30 (13 and 17 with stretch 8). In two dimensions, in
    evaluations until 3 % in the sd: of a Gaussian 9 500 with differential evolution, 10 000 with
    the mixture, 35 000 with the stretch move; of a banana (y = x²/2 ± 0.3) over 1 000 000,
    690 000 and 680 000, and 330 000 with half of each, which suits strongly curved posteriors.
    """
    if dim == 1:
        return [(StackedDifferentialEvolution, 1.0)]
    return [(StackedDifferentialEvolution, 6.0), (partial(StackedStretch, stretch=8.0), 1.0)]


def checked_start(start: ArrayLike) -> Array:
    """`start` as (B, E, W, D), refused where emcee would go wrong without a word."""
    places = np.asarray(start, dtype=float)
    if places.ndim != 4 or places.size == 0:
        raise ValueError(
            f"start must have shape (B, E, W, D), got {places.shape}; give W walkers for each of "
            "E ensembles of each of B posteriors."
        )
    _, ensembles, walkers, dim = places.shape
    if ensembles < 4:
        raise ValueError(
            f"start must hold at least 4 independent ensembles, got {ensembles}; "
            "convergence is judged by how far they agree."
        )
    if walkers % 2 or walkers < 2 * dim + 2:
        raise ValueError(
            f"start must hold an even number of walkers, at least 2 D + 2 = {2 * dim + 2}, got "
            f"{walkers}; `recommended_walkers({dim})` is {recommended_walkers(dim)}."
        )
    finite = np.isfinite(places).all(axis=(1, 2, 3))
    if not finite.all():
        raise ValueError(
            f"start must be finite, but is not for {np.sum(~finite)} posterior(s), the first being "
            f"{np.argmin(finite)}; draw the walkers inside the support."
        )
    off = places - places.mean(axis=2, keepdims=True)
    widest = np.abs(off).max(axis=2, keepdims=True)
    off /= np.where(widest > 0, widest, 1.0)
    spread = np.linalg.eigvalsh(off.swapaxes(2, 3) @ off)
    flat = (spread[..., 0] <= 1e-12 * spread[..., -1]).any(axis=1)
    if flat.any():
        raise ValueError(
            f"The walkers of an ensemble must differ in every direction, but those of "
            f"{flat.sum()} posterior(s) do not, the first being {np.argmax(flat)}; they would "
            "never leave the line or plane they start on, so scatter them."
        )
    return places


def refuse_outside(log_prob: Array) -> None:
    """Refuse walkers that start where the density is zero: emcee takes them, and they stay."""
    outside = np.isneginf(log_prob).sum(axis=1)
    if outside.any():
        raise ValueError(
            f"{outside.sum()} walker(s) of {np.sum(outside > 0)} posterior(s) start where the "
            f"log-density is -inf, the first in posterior {np.argmax(outside > 0)}; start every "
            "walker inside the support."
        )
