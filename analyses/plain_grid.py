"""Animals, designs and answers, and the posterior of k summed on a plain grid.

Of `lapse_prior.py`, `psignifit_side_by_side.py` and `recovery.py`. The grid over k, both lapses and
the bias shares no code with the package; a belief is a table of weights, which costs next to
nothing to change.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.special import ndtr, ndtri
from scipy.stats import beta, cauchy, norm

Array = NDArray[np.float64]

LAPSES = np.array([0, 2, 5, 10, 16, 24, 34, 46, 60, 80, 105, 135, 170, 220, 290, 400]) / 1000
EDGES = np.r_[0, (LAPSES[1:] + LAPSES[:-1]) / 2, 1]
BIAS = np.arange(-3, 3.01, 0.2)
REACH = np.arange(-3.2, 2.6, 0.12)  # of ln k from where the easiest level is 1 sd away
FINE = 900
SHIPPED_BIAS = cauchy(0, 0.7)


@dataclass(frozen=True, eq=False)
class Design:
    """Pairs of stimuli, (C,), each shown `per_level` times; (N, C) where animals differ in it."""

    name: str
    first: Array
    second: Array
    per_level: Any

    @property
    def drive(self) -> Array:
        """The decision variable for a Weber fraction of 1."""
        return (self.second - self.first) / np.hypot(self.first, self.second)

    @property
    def reach(self) -> float:
        """The largest step, of the logarithm."""
        return float(np.abs(np.log(self.second / self.first)).max())

    @property
    def easiest(self) -> float:
        """The largest drive."""
        return float(np.abs(self.drive).max())


def around(name: str, *offsets: Array, per_level: int, both_orders: bool = False) -> Design:
    """Comparisons (1 + offset) around one standard, or more where their offsets differ."""
    second = 1 + np.concatenate(offsets)
    first = np.ones_like(second)
    if both_orders:
        first, second = np.r_[first, second], np.r_[second, first]
    return Design(name, first, second, per_level)


def even(reach: float, count: int) -> Array:
    return np.linspace(-reach, reach, count)


def log_even(reach: float, count: int) -> Array:
    return np.expm1(even(reach, count))


def either_way(*steps: float) -> Array:
    return np.r_[-np.array(steps[::-1]), steps]


NINE = "9 even levels to ±0.30"
TRAINING = (
    around(NINE, even(0.3, 9), per_level=13),
    around(NINE, even(0.3, 9), per_level=33),
    around(NINE, even(0.3, 9), per_level=111),
    around("7 levels to ±0.5 of the log", log_even(0.5, 7), per_level=20),
    around("7 levels to ±0.5 of the log", log_even(0.5, 7), per_level=70),
    around("5 even levels to ±0.15", even(0.15, 5), per_level=60),
    around("2 standards, 9 equal steps to ±0.4 and ±0.2", even(0.4, 9), even(0.2, 9), per_level=15),
    around("0.1, 0.2, 0.4 of the log", np.expm1(either_way(0.1, 0.2, 0.4)), per_level=50),
)
HELD_OUT = (
    around("±0.02, doubling to ±0.32", either_way(0.02, 0.04, 0.08, 0.16, 0.32), per_level=30),
    around("11 even levels to ±0.5", even(0.5, 11), per_level=27),
    around("9 levels to ±0.9 of the log", log_even(0.9, 9), per_level=33),
    around("7 even levels to ±0.2", even(0.2, 7), per_level=17),
    around("3 standards, 7 equal steps to ±0.3, ±0.15, ±0.1",
           even(0.3, 7), even(0.15, 7), even(0.1, 7), per_level=12),
    around("8 levels without 0 to ±0.24", either_way(0.03, 0.09, 0.15, 0.24), per_level=125),
    around("5 even levels to ±0.30, both orders", even(0.3, 5), per_level=20, both_orders=True),
    around(NINE, even(0.3, 9), per_level=33),
)  # fmt: skip
DESIGNS = {"training": TRAINING, "held out": HELD_OUT}

#: Cells of one animal each: offsets, trials a level, k, both lapses, bias.
CELLS = {
    "k 0.1, 117 trials to ±0.30": (even(0.3, 9), 13, 0.1, 0.02, 0.02, 0.0),
    "k 0.1, 297 trials to ±0.30": (even(0.3, 9), 33, 0.1, 0.02, 0.02, 0.0),
    "k 0.1, 999 trials to ±0.30": (even(0.3, 9), 111, 0.1, 0.02, 0.02, 0.0),
    "k 0.2, 117 trials to ±0.30": (even(0.3, 9), 13, 0.2, 0.02, 0.02, 0.0),
    "k 0.2, 297 trials to ±0.30": (even(0.3, 9), 33, 0.2, 0.02, 0.02, 0.0),
    "k 0.2, 999 trials to ±0.30": (even(0.3, 9), 111, 0.2, 0.02, 0.02, 0.0),
    "k 0.4, 297 trials to ±1.2 of the log": (log_even(1.2, 9), 33, 0.4, 0.02, 0.02, 0.0),
    "k 0.1, 297 trials to ±0.30, lapses 0.1": (even(0.3, 9), 33, 0.1, 0.1, 0.1, 0.0),
    "k 0.1, 297 trials to ±0.30, lapses 0.08 and 0.02, bias 0.5": (
        even(0.3, 9), 33, 0.1, 0.08, 0.02, 0.5),
}  # fmt: skip
#: The stream of each cell; those of cells since dropped stay free.
STREAMS = dict(zip(CELLS, (0, 1, 2, 3, 4, 5, 8, 11, 13), strict=True))


def animals(design: Design, number: int, sets: int, part: str) -> tuple[Array, ...]:
    """k, both lapses and the bias of so many animals, (sets,) each.

    The experimenter has chosen levels that bracket the thresholds: the easiest is 0.8 to 4 sds away
    (held out: to 6), log-uniform. Training: 40 % of animals lose up to 1 % of trials a side, 40 %
    1 to 6 %, 20 % 6 to 18 %, each side its own by a factor of e^0.5 as one sd; biases N(0, 0.4).
    Held out: half lose as many at both ends, Beta(1, 20); half exponentially many, 3 % on average,
    each side by itself; biases Laplace, 0.4.
    """
    held_out = part == "held out"
    rng = np.random.default_rng([2026, number, int(held_out)])
    u, g = rng.random((400, 8)), rng.standard_normal((400, 4))
    top = 6.0 if held_out else 4.0
    k = design.reach / (np.sqrt(2) * 0.8 * (top / 0.8) ** u[:, 0])
    if held_out:
        alike, same = u[:, 1] < 0.5, 1 - (1 - u[:, 2]) ** (1 / 20)
        low, high = (
            np.where(alike, same, np.minimum(-0.03 * np.log(u[:, i]), 0.3)) for i in (3, 4)
        )
        bias = -0.4 * np.where(u[:, 5] < 0.5, 1, -1) * np.log(u[:, 6])
    else:
        kind, share = u[:, 1], u[:, 2]
        often = np.where(kind < 0.8, 0.01 + 0.05 * share, 0.06 + 0.12 * share)
        common = np.where(kind < 0.4, 0.01 * share, often)
        low, high = (np.minimum(common * np.exp(0.5 * g[:, i]), 0.3) for i in (0, 1))
        bias = 0.4 * g[:, 2]
    return k[:sets], low[:sets], high[:sets], bias[:sets]


def population(part: str, number: int, sets: int) -> tuple[Design, Array, tuple[Array, ...]]:
    """A design, the answers "second greater" (sets, C) of animals to it, and their truth."""
    design = DESIGNS[part][number]
    k, low, high, bias = truth = animals(design, number, 400, part)
    p = low[:, None] + (1 - low - high)[:, None] * ndtr(design.drive / k[:, None] + bias[:, None])
    rng = np.random.default_rng([2027, number, int(part == "held out")])
    count = np.array([rng.binomial(design.per_level, row) for row in p], dtype=float)
    return design, count[:sets], tuple(a[:sets] for a in truth)


def cell(name: str, sets: int) -> tuple[Design, Array, float]:
    """The design of a cell, the answers (sets, C) to it, and the Weber fraction."""
    offsets, per_level, k, low, high, bias = CELLS[name]
    design = around(name, offsets, per_level=per_level)
    p = low + (1 - low - high) * ndtr(design.drive / k + bias)
    count = np.random.default_rng([2028, STREAMS[name]]).binomial(per_level, p, (400, p.size))
    return design, count[:sets].astype(float), k


# -- the posterior, summed on plain nodes ----------------------------------------------------------


def weights(cdf: Array, correlation: float) -> Array:
    """Prior probability of the lapse nodes, (Lo·Hi,): that of one at the edges, scores normal."""
    ends = ndtri(np.clip(cdf, 0, 1))
    z = np.linspace(-8, 8, 4001)
    given = ndtr((ends - correlation * z[:, None]) / np.sqrt(1 - correlation**2))
    out = np.zeros((LAPSES.size, LAPSES.size))
    at = np.clip(np.searchsorted(ends, z, side="right") - 1, 0, LAPSES.size - 1)
    np.add.at(out, at, norm.pdf(z)[:, None] * np.diff(given, axis=1))
    return (out / out.sum()).ravel()


def belief(a: float, b: float, correlation: float = 0.7) -> Array:
    """Weights of Beta(a, b) at either end."""
    return weights(beta(a, b).cdf(EDGES), correlation)


def density(
    design: Design, count: Array, beliefs: Array, biases: tuple[Any, ...] = (SHIPPED_BIAS,)
) -> tuple[Array, Array]:
    """Nodes of ln k, (K,), and the likelihood there under each belief, (S, K, B, N).

    Parameters
    ----------
    count : ndarray, shape (N, C)
    beliefs : ndarray, shape (Lo·Hi, B)
        Prior weights of the lapse nodes.
    biases : tuple of distributions, S of them
        Priors of the bias.
    """
    ln_k = np.log(design.reach / np.sqrt(2)) + REACH
    low, high = LAPSES[:, None, None, None], LAPSES[:, None, None]
    both = np.hstack([count, design.per_level - count]).T.astype(np.float32)
    of_bias = np.array([prior.pdf(BIAS) for prior in biases], dtype=np.float32)
    of_bias /= of_bias.sum(axis=1, keepdims=True)
    shape = LAPSES.size**2, BIAS.size, len(count)
    out = np.empty((len(biases), ln_k.size, beliefs.shape[1], len(count)))
    tops = np.empty((ln_k.size, len(count)))
    for i, z in enumerate(design.drive / np.exp(ln_k)[:, None, None] + BIAS[:, None]):
        p = low * ndtr(-z) + (1 - high) * ndtr(z)
        q = (1 - low) * ndtr(-z) + high * ndtr(z)
        logs = np.log(np.maximum(np.concatenate([p, q], axis=-1), 1e-30)).astype(np.float32)
        like = (logs.reshape(-1, len(both)) @ both).reshape(shape)
        tops[i] = like.max(axis=(0, 1))
        np.exp(like - tops[i].astype(np.float32), out=like)
        for s, prior in enumerate(of_bias):
            out[s, i] = beliefs.T @ np.einsum("lbn,b->ln", like, prior)
    return ln_k, out * np.exp(tops - tops.max(axis=0))[:, None]


DEFAULT = norm(np.log(0.1), np.log(3))


def estimates(ln_k: Array, like: Array, prior: Any = DEFAULT) -> dict[str, Array]:
    """Of ln k under a prior, by default that of a fit, from likelihoods (K, ..., N): (..., N).

    Beside the ends of the 95 % interval, median, mean and mode: what is expected to lose least in
    (estimate - k)², which is the mean of k, and in (estimate / k - 1)², E[1/k] / E[1/k²].
    """
    post = like * prior.pdf(ln_k).reshape(ln_k.size, *[1] * (like.ndim - 2), -1)
    log_post = np.log(np.maximum(post / post.max(axis=0), 1e-12))
    fine = np.linspace(ln_k[0], ln_k[-1], FINE)
    post = np.exp(CubicSpline(ln_k, log_post)(fine))
    post /= post.sum(axis=0)
    below = np.cumsum(post, axis=0)
    low, median, high = (fine[np.argmax(below >= p, axis=0)] for p in (0.025, 0.5, 0.975))
    mean = np.tensordot(fine, post, 1)
    of_k, inverse, squared = (np.log(np.tensordot(np.exp(n * fine), post, 1)) for n in (1, -1, -2))
    return {"lower": low, "median": median, "upper": high, "mean": mean,
            "mode": fine[post.argmax(axis=0)], "mean of k": of_k,
            "E[1/k] / E[1/k²]": inverse - squared}  # fmt: skip
