"""One distance of several readings, to each an angle (and friction) of its own.

Given the distance, readings are independent:
p(r | y₁ … yₙ) ∝ p(r) ∏ᵢ p(yᵢ | r). Each factor is the density of the first coordinate that the
tree has for one reading, over its prior, so that the prior counts once. It is smooth where the
product is sharp: its logarithm is interpolated by splines. An unknown of the whisker, such as
its stiffness, is the same in all readings: it is given at nodes, over which products are summed.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.special import gamma, gammainc, logsumexp, ndtr

from .._util.values import Array, Index, density_quantiles
from .._util.weights import half_error, halves, mixture_moments
from .cells import Lattices
from .coordinates import constrain_distance
from .descent import cell_sums
from .layers import SCORES, LayeredSums
from .nodes import HALVINGS, Axis, Layers
from .observer import Observer, held_prior
from .tree import DROP, TOLERANCE, tree_of
from .weighted import CellSums, Marginals, mixed

__all__ = ["OneDistance", "ReadingGroup", "one_distance", "shared_unknowns"]


class ReadingGroup(NamedTuple):
    """Readings (n, R) of one observer, covariances of their errors, and the set of each, (n,)."""

    observer: Observer
    readings: Array
    covariance: Array | None
    owner: Index


@dataclass(frozen=True, eq=False)
class OneDistance:
    """The posterior of one distance, m; NaN where the readings have none in common.

    `error` is of means and sds, in sds; `shared` has mean, sd and best value of a shared unknown;
    at the most probable distance some reading is `worse` by so many nats than at its own best.
    """

    mean: float = np.nan
    sd: float = np.nan
    r: Array = field(default_factory=lambda: np.full(2, np.nan))
    density: Array = field(default_factory=lambda: np.full(2, np.nan))
    log_evidence: float = -np.inf
    error: float = np.inf
    shared: tuple[float, ...] = ()
    worse: float = np.inf

    def quantiles(self, p: Array) -> Array:
        """Quantiles of the distance, m."""
        return density_quantiles(self.r, self.density, p)

    @property
    def best(self) -> float:
        """The distance of highest density in the coordinate, nearly."""
        return float(self.r[np.argmax(self.density)])


def shared_unknowns(observer: Observer) -> list[str]:
    """The unknowns that are the whisker's, the same in all readings."""
    return [n for n in observer.unknowns[observer.bounded :] if n != "friction_angle"]


def one_distance(
    groups: Sequence[ReadingGroup],
    count: int,
    spans: Array | None = None,
    exponent: Array | None = None,
) -> list[OneDistance]:
    """The posteriors of the distances of `count` sets of readings.

    Groups are of one observer each, all of which reach as far; a set may have readings of several.
    `spans` say how far up to the largest angle the angles of a set may go, as a share: with a span
    s shares u have the density exp(−(u/s)⁴), and each span is as likely. By default, and where the
    angle has a prior, angles are as the observer has them. `exponent` (count,) is the power to
    which the likelihood of a set is taken: below 1 where its readings have noise in common.
    """
    power = np.ones(count) if exponent is None else exponent
    prior = groups[0].observer.prior.get("radial_distance")
    groups = [g._replace(observer=_without_prior(g.observer)) for g in groups]
    observer = groups[0].observer
    if spans is not None and (observer.bounded < 2 or "deflection_angle" in observer.prior):
        spans = None
    names = shared_unknowns(observer)
    every = np.arange(count)
    if not names:
        return _products(groups, every, prior, spans, None, 0, power)
    axis = Axis(names[0], observer)
    at_nodes: list[dict[int, OneDistance]] = [{} for _ in every]
    for halvings in range(HALVINGS + 1):
        nodes = axis.nodes(halvings)
        for node in nodes.tolist():
            new = [i for i in every if _is_near(at_nodes[i], node, int(nodes[1] - nodes[0]))]
            posteriors = _products(groups, np.array(new), prior, spans, axis, node, power)
            log_prior = float(axis.log_prior(node))
            for i, one in zip(new, posteriors, strict=True):
                at_nodes[i][node] = replace(one, log_evidence=one.log_evidence + log_prior)
        error = {i: _summed(axis, at_nodes[i], nodes)[2] for i in every}
        every = np.array([i for i in every if error[i] > TOLERANCE], dtype=int)
        if not every.size:
            break
    return [_mixture(axis, nodes) for nodes in at_nodes]


def _without_prior(observer: Observer) -> Observer:
    """The observer with a flat prior of the distance, which counts once, in the product."""
    if "radial_distance" not in observer.prior:
        return observer
    prior = {n: p for n, p in observer.prior.items() if n != "radial_distance"}
    return replace(observer, prior=prior, noise=observer.noise)


# -- of one reading --------------------------------------------------------------------------------


class Component(NamedTuple):
    """ln of a density (L, K) of a reading at even places of the first coordinate."""

    start: float
    step: float
    log: Array


def _sums(
    observer: Observer, y: Array, covariance: Array | None, axis: Axis | None, node: int
) -> Iterator[tuple[Index, CellSums, Array]]:
    """Weighted cells of some of the readings, and ln of the evidence that they stand for."""
    slope = 0.0
    if axis:
        y, covariance, slope = axis.for_tree(y, covariance, np.repeat(axis.value(node), len(y)))
    layers = Layers(observer, TOLERANCE, given={axis.name: node} if axis else None)
    if not layers.axes:
        which = np.repeat(layers.numbers(np.empty((0, 1))), len(y)) if axis else None
        tree = layers.tree if axis else tree_of(observer, TOLERANCE)
        sums = cell_sums(tree, y, covariance, which=which, drop=2 * DROP)
        yield np.arange(len(y)), sums, sums.log_evidence + slope
        return
    whole = LayeredSums(layers, y, covariance, 2 * DROP)
    # Nodes of steps that were halved are summed again with the finer ones: all count equally.
    first, second = layers.axes[0].nodes(0)[:2]
    step = (second - first) >> whole.halvings[:, 0]
    for at in whole.at_nodes:
        finest = (at.node[:, 0] - first) % step[at.readings] == 0
        width = np.log(layers.axes[0].unit * step[at.readings])
        yield at.readings, at.sums, np.where(finest, at.log + width + slope, -np.inf)


def _components(
    group: ReadingGroup, axis: Axis | None, node: int, spans: Array | None
) -> tuple[list[list[Component]], Array]:
    """Of each reading what its posterior is a sum of, and the error of its sums."""
    out: list[list[Component]] = [[] for _ in group.readings]
    every = []
    for number, sums, log in _sums(group.observer, group.readings, group.covariance, axis, node):
        every.append((number, log, sums.error))
        for i, one in _layers(sums, spans):
            if np.isfinite(log[i]):
                norm = log[i] - sums.log_evidence[i]
                out[number[i]].append(one._replace(log=one.log + norm))
    number, log, error = map(np.concatenate, zip(*every, strict=True))
    top = np.full(len(out), -1e300)
    np.fmax.at(top, number, log)
    weight = np.exp(np.where(np.isfinite(log), log - top[number], -np.inf))
    total, off = (np.bincount(number, w, len(out)) for w in (weight, weight * np.fmin(error, 1.0)))
    return out, off / np.fmax(total, 1e-300)


@dataclass(frozen=True, eq=False)
class LargestAngles:
    """Densities exp(−(u/s)⁴) of shares u of the largest angle, for spans s (K,), over their means.
    """

    spans: Array

    def at(self, sums: CellSums, lattices: Lattices) -> Array:
        """At the cells of lattices, (K, P)."""
        observer: Any = sums.observer
        owner = lattices.owner
        which = sums.which[lattices.readings[owner]]
        x = (lattices.place + 0.5) * lattices.step[:, owner]
        contact = observer.contact_at(x.T, which)
        least, width = observer.observer.space.angle_range(contact[:, 0], contact)
        share = (contact[:, 1] - least) / np.maximum(width, 1e-300)
        # Over its mean: the integral of exp(−(u/s)⁴) over shares u.
        mean = self.spans * gamma(1.25) * gammainc(0.25, self.spans**-4.0)
        return np.asarray(np.exp(-((share / self.spans[:, None]) ** 4)) / mean[:, None])


def _layers(sums: CellSums, spans: Array | None) -> Iterator[tuple[int, Component]]:
    """ln of the joint density of each reading and the first coordinate, for each span of angles."""
    marginal: Marginals
    for marginal in sums.marginals(factors=None if spans is None else LargestAngles(spans)):
        table = marginal.log if marginal.log.ndim > 2 else marginal.log[..., None]
        lengths = np.isfinite(table).any(axis=-1).cumsum(axis=1).argmax(axis=1) + 1
        for i, start, step, log, end in zip(
            marginal.readings, marginal.start, marginal.step, table, lengths, strict=True
        ):
            yield int(i), Component(start, step, log[:end] + sums.log_slope[i])


class _Curve:
    """ln of the density of one reading over the first coordinate, (K,) of them, by splines."""

    def __init__(self, components: list[Component]) -> None:
        self.top = max(float(part.log.max()) for part in components)
        components = [part for part in components if part.log.max() > self.top - 2 * DROP]
        self.low = min(part.start for part in components)
        self.high = max(part.start + part.step * (len(part.log) - 1) for part in components)
        self._splines = []
        for start, step, log in components:
            place = np.arange(len(log), dtype=float)
            log = np.maximum(log, log.max() - 60.0)
            whole = log[:, 0] > log.max() - 59.0
            if log.shape[1] == 1 and not whole.all():
                log = np.interp(place, place[whole], log[whole, 0])[:, None]
            degree = min(5, (len(log) - 2) // 2 * 2 + 1) if len(log) > 1 else 0
            end = start + step * (len(log) - 1)
            x = np.linspace(start, end, len(log))
            self._splines.append((start, end, make_interp_spline(x, log, k=degree)))

    def __call__(self, x: Array) -> Array:
        """At places (M,), (M, K)."""
        if len(self._splines) == 1:
            return np.asarray(self._splines[0][2](x))
        out: Any = -np.inf
        for start, end, spline in self._splines:
            inside = (x >= start) & (x <= end)
            out = np.logaddexp(out, np.where(inside[:, None], spline(x), -np.inf))
        return np.asarray(out)


# -- products --------------------------------------------------------------------------------------


def _products(
    groups: Sequence[ReadingGroup], sets: Index, prior: Any, spans: Array | None, axis: Axis | None,
    node: int, power: Array,
) -> list[OneDistance]:  # fmt: skip
    """The posteriors of sets of readings where a shared unknown is given at a node."""
    curves: dict[int, list[_Curve | None]] = {int(i): [] for i in sets}
    errors: dict[int, list[float]] = {int(i): [] for i in sets}
    for group in groups:
        in_sets = np.flatnonzero(np.isin(group.owner, sets))
        if not in_sets.size:
            continue
        covariance = None if group.covariance is None else group.covariance[in_sets]
        group = group._replace(readings=group.readings[in_sets], covariance=covariance)
        components, error = _components(group, axis, node, spans)
        for number, of_one, e in zip(in_sets, components, error, strict=True):
            curves[int(group.owner[number])].append(_Curve(of_one) if of_one else None)
            errors[int(group.owner[number])].append(float(e))
    # Infinitely many sds from every contact, as no tree follows, is no distance in common.
    observer = groups[0].observer
    value = float(axis.value(node)) if axis else None
    return [
        _product(observer, [c for c in curves[int(i)] if c], prior, value,
                 float(np.sqrt(np.mean(np.square(errors[int(i)])))), float(power[i]))
        if all(curves[int(i)]) else OneDistance()
        for i in sets
    ]  # fmt: skip


def _product(
    observer: Observer, curves: list[_Curve], prior: Any, value: float | None, error: float,
    power: float,
) -> OneDistance:  # fmt: skip
    """The posterior of one set."""
    low, high = max(c.low for c in curves), min(c.high for c in curves)
    sharp = np.zeros(0)
    if prior is not None:
        ends = observer.space.unconstrain_one(np.array(prior.support(), dtype=float), 0)
        low, high = max(low, float(ends[0])), min(high, float(ends[1]))
        quantiles = prior.ppf(ndtr(np.linspace(-8.0, 8.0, 257)))
        sharp = observer.space.unconstrain_one(quantiles, 0)
        sharp = sharp[np.isfinite(sharp)]
    if not low < high:
        return OneDistance()
    whole = low, high

    def total(x: Array) -> Array:
        flat = _log_prior(observer, x, value)
        out = sum(curve(x) for curve in curves) - len(curves) * flat[:, None]
        out = power * out + flat[:, None]
        if prior is not None:
            out = out + prior.logpdf(observer.space.distance(x))[:, None]
        return np.asarray(logsumexp(out, axis=1) - np.log(out.shape[1]))

    def places(count: int) -> Array:
        x = np.linspace(low, high, count)
        return np.union1d(x, sharp[(sharp > low) & (sharp < high)]) if sharp.size else x

    for _ in range(20):
        x = places(65)
        log = total(x)
        if not np.isfinite(log.max()):
            return OneDistance()
        near = np.flatnonzero(log > log.max() - 36.0)
        low, high = x[max(near[0] - 1, 0)], x[min(near[-1] + 1, len(x) - 1)]
        if len(near) > 24:
            break
    x = places(385)
    log = total(x)
    r, top = observer.space.distance(x), int(log.argmax())
    weight = np.exp(log - log[top]) * np.gradient(x)
    mass = weight.sum()
    mean = float(weight @ r / mass)
    sd = float(np.sqrt(weight @ (r - mean) ** 2 / mass))
    # The product may be cut where a reading is no longer followed.
    share = np.exp(log[[0, -1]] - log[top])
    cut = (low == whole[0] and share[0] > 1e-4) or (high == whole[1] and share[1] > 1e-4)
    inside = prior is None and cut and len(curves) > 1
    density = weight / np.gradient(x) / mass / np.exp(_log_slope(observer, x))
    worse = max(c.top - float(c(x[top : top + 1]).max()) for c in curves)
    return OneDistance(
        mean, sd, r, density, float(log[top] + np.log(mass)), 1.0 if inside else error, (), worse
    )


def _log_slope(observer: Observer, x: Array) -> Array:
    low, high = observer.reach
    return np.asarray(constrain_distance(x)[1] + np.log(high - low))


def _log_prior(observer: Observer, x: Array, value: float | None) -> Array:
    """ln of the flat prior of the first coordinate, at a value of the shared unknown."""
    out = _log_slope(observer, x)
    if observer.bounded < 2:
        return out
    return out + np.log(np.maximum(held_prior(observer, observer.space.distance(x), value), 1e-300))


# -- sums over what is shared ----------------------------------------------------------------------


def _is_near(at_nodes: dict[int, OneDistance], node: int, step: int) -> bool:
    """Whether a node is new, and beside those that have mass."""
    if node in at_nodes:
        return False
    if not at_nodes:
        return True
    old = 2 * step
    if any((k - node) % old == 0 for k in at_nodes) and len(at_nodes) < 3:
        return True
    top = max(one.log_evidence for one in at_nodes.values())
    near = [k for k in at_nodes if abs(k - node) <= old]
    return any(at_nodes[k].log_evidence > top - 24.0 for k in near)


def _summed(
    axis: Axis, at_nodes: dict[int, OneDistance], nodes: Index
) -> tuple[tuple[float, ...], Array, float]:
    """Moments of distance and shared unknown over nodes, shares (N,), and the error in sds.

    That is the square of what sums over odd and even nodes differ by.
    """
    posteriors = [at_nodes.get(k, OneDistance()) for k in nodes.tolist()]
    log = np.array([one.log_evidence for one in posteriors])
    if not np.isfinite(log.max()):
        return (np.nan,) * 4, np.zeros(len(log)), 0.0
    share = np.exp(log - log.max())
    share /= share.sum()
    mean, sd = (np.nan_to_num([getattr(one, n) for one in posteriors]) for n in ("mean", "sd"))
    values = np.stack([mean, axis.value(nodes)], axis=1)
    sds = np.stack([sd, np.zeros(len(sd))], axis=1)
    whole = mixture_moments(share[:, None], values, sds)
    error = 0.0
    for _, half in halves(np.arange(len(nodes))[None]):
        part = mixture_moments((share * half)[:, None], values, sds)
        least_sd = np.maximum(whole.sd, [0.0, 1e-300])
        off = half_error(part.total, part.mean - whole.mean, part.sd, least_sd)
        error = max(error, float(off.max()))
    moments = (*np.stack([whole.mean, whole.sd], axis=1).ravel().tolist(),)
    return moments, share, float(min(error, 1e100) ** 2)


def _mixture(axis: Axis, at_nodes: dict[int, OneDistance]) -> OneDistance:
    """The posterior over nodes, conditional quantiles of the distance interpolated between them."""
    nodes = np.array(sorted(at_nodes))
    step = int(np.diff(nodes).min())
    every = np.arange(nodes[0], nodes[-1] + 1, step)
    (mean, sd, value, value_sd), share, error = _summed(axis, at_nodes, every)
    if not np.isfinite(mean):
        return OneDistance()
    posteriors = [at_nodes.get(int(k), OneDistance()) for k in every]
    has_mass = np.array([one.sd > 0 for one in posteriors])
    log = np.array([one.log_evidence for one in posteriors])
    heavy = np.flatnonzero(has_mass & (share > 1e-9))
    near = slice(max(heavy[0] - 1, 0), heavy[-1] + 2)
    quantile = np.array([one.quantiles(ndtr(SCORES)) for one in posteriors[near]])
    spans = mixed(np.array([0]), log[near], has_mass[near], quantile, SCORES, 16)
    fine = ndtr(np.linspace(SCORES[0], SCORES[-1], 1601))
    r = spans.quantiles(fine)[0]
    best = int(log.argmax())
    inner = share[has_mass] @ [one.error for one in posteriors if one.sd > 0]
    evidence = log[best] + np.log(axis.unit * step / share.max())
    return OneDistance(
        mean, sd, r, np.gradient(fine, r), float(evidence), max(error, float(inner)),
        (value, value_sd, float(axis.value(every[best]))), posteriors[best].worse,
    )  # fmt: skip
