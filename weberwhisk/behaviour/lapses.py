"""What is believed of lapses beforehand, and the coordinates that a grid has for them.

In the normal score z of its prior a lapse near 0 is known from the prior alone, over a width of 1,
and a large one from the answers, over a width that shrinks with their number. The coordinate t
counts both: dt² = dz² + N d(2 asin √λ)², with 2 asin √λ the coordinate in which a proportion of N
answers has an sd of 1/√N. Even nodes in t are then fine where they must be, and nowhere else.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import cumulative_simpson
from scipy.interpolate import CubicSpline

from .priors import REACH, Priors, quantiles
from .tasks import Task

if TYPE_CHECKING:
    from .likelihood import WeberModel

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LapseTransform:
    """A variance-stabilising coordinate t of a normal score z; z itself without `to_score`."""

    to_score: Any = None
    to_coordinate: Any = None
    ends: tuple[float, float] = (-REACH, REACH)

    def score(self, t: ArrayLike) -> Array:
        """z at t."""
        t = np.asarray(t, dtype=float)
        return t if self.to_score is None else self.to_score(np.clip(t, *self.ends))

    def coordinate(self, z: ArrayLike) -> Array:
        """t at z."""
        z = np.asarray(z, dtype=float)
        return z if self.to_score is None else self.to_coordinate(np.clip(z, -REACH, REACH))

    def slope(self, t: ArrayLike) -> Array:
        """dz/dt at t."""
        t = np.asarray(t, dtype=float)
        if self.to_score is None:
            return np.ones(t.shape)
        return self.to_score(np.clip(t, *self.ends), 1)


PLAIN = LapseTransform()


def lapse_transform(prior: Any, answers: float) -> LapseTransform:
    """The coordinate for a lapse with that prior, and so many answers to learn it from."""
    return _transform(prior, int(np.round(np.log2(max(answers, 1.0)))))


@lru_cache(maxsize=256)
def _transform(prior: Any, doublings: int) -> LapseTransform:
    z = np.linspace(-REACH, REACH, 1441)
    arc = CubicSpline(z, 2 * np.arcsin(np.sqrt(np.clip(quantiles(prior)(z), 0.0, 1.0))))
    density = np.sqrt(1 + 2.0**doublings * arc(z, 1) ** 2)
    t = cumulative_simpson(density, x=z, initial=0.0)
    t = t - t[z.size // 2]
    return LapseTransform(CubicSpline(t, z), CubicSpline(z, t), (float(t[0]), float(t[-1])))


def score_prior(axis: Array) -> Array:
    """Standard normal log-density of the scores; nothing for a fixed parameter."""
    return -0.5 * axis**2 - 0.5 * np.log(2 * np.pi) if axis.size > 1 else np.zeros(1)


def lapse_prior(model: WeberModel, low: Array, high: Array) -> Array:
    """Log prior density of the lapses on their coordinates, (Lo, Hi).

    Lapses that leave no rise are impossible. A node that stands for some of either kind has the
    share of the possible ones: where few trials leave mass at that edge, sums over nodes that are
    all in or all out went by steps.
    """
    transforms = model.transforms[-2:]
    z = [s.score(t) for s, t in zip(transforms, (low, high), strict=True)]
    slope = [
        np.log(s.slope(t)) * (t.size > 1) for s, t in zip(transforms, (low, high), strict=True)
    ]
    lo, hi = model.lapses(
        model.value("lapse_low", z[0])[:, None], model.value("lapse_high", z[1])[None, :]
    )
    density = log_score_prior(z[0][:, None], z[1][None, :], model.priors.lapse_correlation)
    density += slope[0][:, None] + slope[1] - log_lapses_possible(model.task, model.priors)
    lost = np.broadcast_to(lo + hi, density.shape)
    free = [axis for axis in (0, 1) if lost.shape[axis] > 1]
    across = np.sum([np.abs(np.gradient(lost, axis=axis)) for axis in free], axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(across > 0, np.clip((1 - lost) / across + 0.5, 0.0, 1.0), lost < 1)
        return np.asarray(density + np.log(share))


@lru_cache(maxsize=64)
def log_lapses_possible(task: Task, priors: Priors) -> float:
    """Log prior mass of the lapses that leave the curve rising: λ_lo + λ_hi < 1."""
    z = np.linspace(-REACH, REACH, 181)
    values, scores = [], []
    for name in ("lapse_low", "lapse_high"):
        free = name in task.lapses and not priors.is_fixed(name)
        scores.append(z if free else np.zeros(1))
        values.append(priors.value(name, scores[-1]) * (name in task.lapses))
    low, high = task.asymptotes(values[0][:, None], values[1][None, :])
    weight = np.exp(log_score_prior(scores[0][:, None], scores[1], priors.lapse_correlation))
    rising = np.broadcast_to(low + high < 1, weight.shape)
    return float(np.log(weight[rising].sum() / weight.sum()))


def log_score_prior(low: Array, high: Array, correlation: float) -> Array:
    """Log prior density of the scores of both lapses (broadcasts), each of one value if fixed."""
    free = [int(a.size > 1) for a in (low, high)]
    rho = correlation if all(free) else 0.0
    square = free[0] * low**2 + free[1] * high**2 - 2 * rho * low * high
    norm = 0.5 * sum(free) * np.log(2 * np.pi) + 0.5 * np.log1p(-(rho**2))
    return np.asarray(-0.5 * square / (1 - rho**2) - norm)
