"""What is believed of lapses and biases beforehand, on the coordinates that a grid has for them.

In the normal score z of its prior a lapse near 0 is known from the prior alone, over a width of 1,
and a large one from the answers, over a width that shrinks with their number. The coordinate t
counts both: dt² = dz² + N d(2 asin √λ)², with 2 asin √λ the coordinate in which a proportion of N
answers has an sd of 1/√N. Even nodes in t are then fine where they must be, and nowhere else.

Biases count in sds of the difference between the two signals, which grow with k: PSEs that lie
closer together than a prior expects speak for a small k, a little in one animal, and with every
animal more. So a population's biases are those of the prior all times one factor, which is learnt.
What a change of k does to all biases, the factor undoes: the pull is gone, whatever the prior's
shape and also where the animals share a bias.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import cumulative_simpson
from scipy.interpolate import CubicSpline
from scipy.stats import norm

from .priors import REACH, Priors, quantiles
from .psychometric import Task

if TYPE_CHECKING:
    from .likelihood import Draws, WeberModel

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
        return t if self.to_score is None else self.to_score(_within(t, *self.ends))

    def coordinate(self, z: ArrayLike) -> Array:
        """t at z."""
        z = np.asarray(z, dtype=float)
        return z if self.to_score is None else self.to_coordinate(_within(z, -REACH, REACH))

    def slope(self, t: ArrayLike) -> Array:
        """dz/dt at t."""
        t = np.asarray(t, dtype=float)
        if self.to_score is None:
            return np.ones(t.shape)
        return self.to_score(_within(t, *self.ends), 1)


def _within(values: Array, low: float, high: float) -> Array:
    return np.minimum(np.maximum(values, low), high)  # half of what np.clip costs


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
    if lost.max() <= 0.5:  # no node stands for any past the edge
        return np.asarray(density)
    free = [axis for axis in (0, 1) if lost.shape[axis] > 1]
    across = np.sum([np.abs(np.gradient(lost, axis=axis)) for axis in free], axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(across > 0, np.clip((1 - lost) / across + 0.5, 0.0, 1.0), lost < 1)
        return np.asarray(density + np.log(share))


def lapse_weights(model: WeberModel, low: Array, high: Array) -> Array:
    """Log prior probability of the lapse nodes, (Lo, Hi).

    A first node so low that no trial is lost stands for everything below it.
    """
    pair = [with_tail(model, n, a) for n, a in zip(model.lead[-2:], (low, high), strict=True)]
    weights = np.exp(lapse_prior(model, *pair))
    for i, (whole, axis) in enumerate(zip(pair, (low, high), strict=True)):
        weights *= axis[1] - axis[0] if axis.size > 1 else 1.0
        weights = np.add.reduceat(
            weights, np.r_[0, whole.size - axis.size + 1 : whole.size], axis=i
        )
    with np.errstate(divide="ignore"):
        return np.log(weights)


def with_tail(model: WeberModel, name: str, axis: Array, lowest: float = -4.5) -> Array:
    """The nodes of a lapse carried on below the first, where that is none at all, to a score."""
    if axis.size == 1 or axis[0] > model.no_lapse[name] + 1e-9:
        return axis
    transform = model.transforms[model.lead.index(name)]
    step = axis[1] - axis[0]
    below = max(int((axis[0] - float(transform.coordinate(lowest))) / step), 0)
    return axis[0] + step * np.arange(-below, axis.size)


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
    # A node on the edge stands for as much inside as outside.
    rising = np.heaviside(np.round(1 - low - high, 12), 0.5)
    return float(np.log((weight * rising).sum() / weight.sum()))


def log_score_prior(low: Array, high: Array, correlation: float) -> Array:
    """Log prior density of the scores of both lapses (broadcasts), each of one value if fixed."""
    free = [int(a.size > 1) for a in (low, high)]
    rho = correlation if all(free) else 0.0
    square = free[0] * low**2 + free[1] * high**2 - 2 * rho * low * high
    norm = 0.5 * sum(free) * np.log(2 * np.pi) + 0.5 * np.log1p(-(rho**2))
    return np.asarray(-0.5 * square / (1 - rho**2) - norm)


@dataclass(frozen=True)
class BiasScales:
    """Scales at which members are tabulated, and what lies between them.

    `nodes` (S,) are even in asinh(scale / `unit`), where the unit is what a member's answers tell a
    bias to. Log-likelihoods are even about a scale of zero.
    """

    nodes: Array
    unit: float

    @classmethod
    def between(cls, low: float, high: float, unit: float, step: float = 0.35) -> BiasScales:
        """Nodes over a range, from zero where that is close, so far apart in asinh(scale / unit):
        by default log-likelihoods of one bias err by 1e-3 between them."""
        first, last = np.arcsinh(low / unit), np.arcsinh(high / unit)
        first = 0.0 if first < 2 * step else first
        count = max(int(np.ceil((last - first) / step)), 3) + 1
        return cls(unit * np.sinh(np.linspace(first, last, count)), unit)

    def onto(self, scales: ArrayLike) -> Array:
        """Share of every node in the value at other scales, (..., S): a cubic spline's."""
        wanted = np.asarray(scales, dtype=float)
        if self.nodes.size == 1:
            return np.ones((*wanted.shape, 1))
        at = np.arcsinh(self.nodes / self.unit)
        first: Any = "clamped" if self.nodes[0] == 0 else "not-a-knot"
        spline = CubicSpline(at, np.eye(at.size), bc_type=(first, "not-a-knot"))
        return np.asarray(spline(np.arcsinh(wanted / self.unit)))


#: Of biases that are known, or none.
AS_BELIEVED = BiasScales(np.ones(1), 1.0)


def scaled_prior(priors: Priors, bias: Array, step: Array, scales: Array) -> Array:
    """Log prior mass (..., B, S) of nodes of a bias, of widths `step` (..., B), for each scale."""
    sd = priors.moments("bias")[1]
    # A density narrower than the step of the nodes cannot be seen on them.
    width = np.maximum(scales, 0.8 * step[..., None] / sd)
    density = priors.log_density("bias", bias[..., None] / width) - np.log(width)
    return np.asarray(density + np.log(step)[..., None])


def likely_scales(
    models: Sequence[WeberModel],
    draws: Sequence[Draws],
    prior: Any,
    *,
    margin: float = 2.0,
    likely: float = 20.0,
    far: float = 1e-12,
) -> BiasScales:
    """Nodes over the scales that the members, each fitted alone, do not exclude.

    Their biases are taken for normal here, which decides where the nodes lie and nothing else.
    Scales `likely` nats under the best guess are left out, which may be off by a factor of
    `margin`; beyond a share `far` of their prior they are not looked for.
    """
    priors = models[0].priors
    if not any(model.free_bias for model in models):
        return AS_BELIEVED
    mean, sd = priors.moments("bias")
    own = np.concatenate([d.bias.mean(axis=0) for d in draws])
    variance = np.concatenate([d.bias.var(axis=0) for d in draws])
    # A posterior no narrower than the prior says nothing.
    precision = np.maximum(1 / variance - sd**-2, 1e-6 * sd**-2)
    seen, noise = (own / variance - mean / sd**2) / precision, np.sqrt(1 / precision)
    last = float(prior.isf(far))
    unit = float(np.sqrt(variance.min()) / sd)
    scales = BiasScales.between(0.0, last, unit, 0.1).nodes
    log_density = norm.logpdf(seen, scales[:, None] * mean, np.hypot(scales[:, None] * sd, noise))
    total = np.sum(log_density, axis=1)
    kept = scales[total > total.max() - likely]
    return BiasScales.between(kept[0] / margin, min(kept[-1] * margin, last), unit)
