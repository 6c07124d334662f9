"""One pass of quadrature over posteriors whose grids have the same shape: moments and errors."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .densities import Density, Functions, checked_density
from .nodes import Array, Nodes

if TYPE_CHECKING:
    from .frames import Frames

SLOWEST_FALL = 1 - 1e-6  # from layer to layer of nodes, when the mass beyond the last is guessed
LOST = 0.3  # change of ln Z, from all nodes to every second, at which mass falls between nodes
LEVEL = 1e-9  # sd over mean of a function that only rounding keeps from being constant


@dataclass(frozen=True)
class Pass:
    """What one pass over b posteriors found; z are coordinates in units of the root."""

    found: dict[str, Array]  # fields of `GridPosterior`
    z_mean: Array
    z_cov: Array
    edge_mass: Array  # (b, 2, D): the share of the mass beyond either end of each axis
    edge_error: Array  # (b, 2, D): what that does to the worst of the means and sds
    extent: NDArray[np.int64]  # (b, 2, D): cells below and above the centre that hold mass
    fall: Array  # (b, 2, D): how fast the layers of nodes fall towards either end
    axis_error: Array  # (b, D): what the spacing along one axis does
    points: Array
    weights: Array
    values: Array  # (b, N, Q): the functions
    edges: Array
    shape: tuple[int, ...]

    def of(self, rows: NDArray[np.bool_]) -> Pass:
        """The same of some of the posteriors."""
        named = {
            f.name: getattr(self, f.name)[rows]
            for f in fields(self)
            if f.name not in ("found", "shape")
        }
        return replace(self, found={k: v[rows] for k, v in self.found.items()}, **named)

    def nodes(self, i: int) -> Nodes:
        """The nodes of one posterior."""
        weights = self.weights[i] / max(self.weights[i].sum(), np.finfo(float).tiny)
        points, values = self.points[i].copy(), self.values[i].copy()
        return Nodes(points, weights, self.shape, self.edges[i], values)


def evaluate(
    work: Frames,
    index: NDArray[np.intp],
    log_density: Density,
    functions: Functions | None,
    first: int,
) -> Pass:
    """One pass over posteriors whose grids have the same shape; columns from the `first` on."""
    counts = work.intervals()[index[0]] + 1
    spacing = work.width[index] / 2.0 ** work.level[index]
    lowest = -work.cells[index, 0] * work.width[index]
    node = np.moveaxis(np.indices(counts), 0, -1).reshape(-1, work.dim)
    z = lowest[:, None] + node * spacing[:, None]
    points = work.centre[index, None] + z @ work.root[index].swapaxes(1, 2)
    log_value = checked_density(log_density(points, index), points, index)
    peak = log_value.max(axis=1)
    peak = np.where(np.isfinite(peak), peak, 0.0)
    weights = np.exp(log_value - peak[:, None])
    total = weights.sum(axis=1)
    found = total > 0
    safe = np.where(found, total, 1.0)[:, None]
    values = _columns(points, weights, functions)[..., first:]
    mean = (weights[:, None] @ values)[:, 0] / safe
    off = np.ascontiguousarray((values - mean[:, None]).swapaxes(1, 2))  # (b, C, N)
    sd = np.sqrt((off**2 @ weights[..., None])[..., 0] / safe)
    off /= np.maximum(sd, 1e-100)[..., None]  # a single node has no sd
    # What is the same everywhere is known wherever anything is.
    level = (sd <= LEVEL * np.abs(mean))[..., None]
    off = np.where(level & ~level.all(axis=1, keepdims=True), off[:, :1], off)
    # The mass, first and second moment of every node, as shares of the whole.
    mass = weights / safe
    terms = np.empty((len(index), 1 + 2 * off.shape[1], *counts))
    share = terms.reshape(len(index), terms.shape[1], -1)
    share[:, 0] = mass
    first_moments, second_moments = np.split(share[:, 1:], 2, axis=1)
    np.multiply(mass[:, None], off, out=first_moments)
    np.multiply(first_moments, off, out=second_moments)
    along = [_along(terms, k) for k in range(work.dim)]
    edge_mass, edge_mean, edge_sd, fall = _edges(along, 2 ** work.level[index[0]])
    # Thinned along both axes, errors can cancel: along each alone they show.
    changes = [_resolution(part) for part in ([terms, *along] if work.dim > 1 else along)]
    evidence_change, mean_change, sd_change = (
        np.maximum.reduce(parts) for parts in zip(*changes, strict=True)
    )
    lost = (changes[0][1] >= 1).all(axis=1)
    alone = [np.maximum(mean, sd).max(axis=1) for _, mean, sd in changes[-work.dim :]]
    alone = [np.where(lost, 1.0, error) for error in alone]
    middle = (weights[:, None] @ points)[:, 0] / safe
    centred = points - middle[:, None]
    covariance = (mass[..., None] * centred).swapaxes(1, 2) @ centred
    inverse = np.linalg.inv(work.root[index])
    cell = spacing.prod(axis=1) * np.abs(np.linalg.det(work.root[index]))
    empty = np.where(found, 0.0, np.nan)
    return Pass(
        found={
            "log_evidence": np.where(found, peak + np.log(safe[:, 0] * cell), -np.inf),
            "log_evidence_error": evidence_change + edge_mass.sum(axis=(1, 2)),
            "mean": mean + empty[:, None],
            "sd": sd + empty[:, None],
            "mean_error": mean_change + edge_mean.sum(axis=(1, 2)),
            "sd_error": sd_change + edge_sd.sum(axis=(1, 2)),
            "covariance": covariance + empty[:, None, None],
        },
        z_mean=(inverse @ (middle - work.centre[index])[..., None])[..., 0],
        z_cov=inverse @ covariance @ inverse.swapaxes(1, 2),
        edge_mass=edge_mass,
        edge_error=np.maximum(edge_mean, edge_sd).max(axis=-1),
        extent=_extent(terms[:, 0], work.cells[index], work.tolerance / 10),
        fall=fall,
        axis_error=np.stack(alone, axis=-1),
        points=points,
        weights=weights,
        values=values[..., work.dim - first :],
        edges=work.root[index] * spacing[:, None],
        shape=tuple(int(n) for n in counts),
    )


def _along(terms: Array, axis: int) -> Array:
    """Sums (b, 1 + 2C, nodes) over all axes but one."""
    others = tuple(k + 2 for k in range(terms.ndim - 2) if k != axis)
    return np.asarray(terms.sum(axis=others)) if others else terms


def _resolution(terms: Array) -> tuple[Array, Array, Array]:
    """Error of ln Z (b,), of means and of sds (b, C), from the spacing of the nodes.

    Every second node alone changes them by δ₂, every fourth alone by δ₄. Halving the spacing
    squares the trapezoid rule's error where the density is analytic, and divides it by a power of
    two where it has a kink: the error of all nodes is δ₂³/δ₄² in the one case, δ₂²/δ₄ in the
    other. Three times the latter is claimed, with no trust in a δ₄ above a tenth, as errors of
    order one no longer fall in any order.
    """
    second, fourth = _thinned(terms, 2), _thinned(terms, 4)
    error, mean_error, sd_error = (claimed_error(a, b) for a, b in zip(second, fourth, strict=True))
    # Mass that every second node cannot see lies on few nodes, whose moments mean nothing: a
    # single one of them has no error at all.
    lost = (second[0] > LOST)[:, None]
    return error, np.where(lost, 1.0, mean_error), np.where(lost, 1.0, sd_error)


def claimed_error(second: ArrayLike, fourth: ArrayLike) -> Array:
    """Error claimed of all nodes, given the changes δ₂ and δ₄."""
    second = np.asarray(second)
    trusted = np.clip(fourth, second, np.maximum(second, 0.1))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(second > 0, second * np.fmin(1.0, 3.0 * second / trusted), 0.0)


def _thinned(terms: Array, step: int) -> tuple[Array, Array, Array]:
    """How ln Z (b,), means and sds (b, C) change when of `step` nodes along each axis one is kept.

    `terms` (b, 1 + 2C, nodes along each axis) are the nodes' shares of the mass, of the first
    moments and of the second, so that with all nodes they sum to 1, 0 and 1.
    """
    axes = range(2, terms.ndim)
    kept = (slice((terms.shape[k] - 1) % step // 2, None, step) for k in axes)
    sums = terms[slice(None), slice(None), *kept].sum(axis=tuple(axes))
    mass = sums[:, 0] * float(step) ** len(axes)
    known = mass > 0
    columns = terms.shape[1] // 2
    moments = sums[:, 1:] / np.where(known, sums[:, 0], 1.0)[:, None]
    first, second = moments[:, :columns], moments[:, columns:]
    sd = np.sqrt(np.maximum(second - first**2, 0.0))
    never = np.where(known, 0.0, np.inf)
    return (
        np.abs(np.log(np.where(known, mass, 1.0))) + never,
        np.abs(first) + never[:, None],
        np.abs(sd - 1.0) + never[:, None],
    )


def _edges(along: list[Array], cell: NDArray[np.int64]) -> tuple[Array, Array, Array, Array]:
    """Mass beyond the ends of each axis (b, 2, D), its pull on means and sds (b, 2, D, C), and
    the factor by which they fall from cell to cell (b, 2, D); `cell` (D,) is in nodes.

    Mass and second moments are taken to go on falling as from the last two cells but two to the
    last two (single nodes hit or miss a thin bent ridge), with a cell to spare. Twice that,
    because a power law falls ever more slowly: in the variance of Student's t with three degrees
    of freedom the factor is just two.
    """
    columns = along[0].shape[1] // 2
    layers = []
    for terms, two in zip(along, 2 * cell, strict=True):
        blocks = slice(0, two), slice(two, 2 * two), slice(-2 * two, -two), slice(-two, None)
        layers.append(np.stack([terms[..., block].sum(axis=-1) for block in blocks], axis=1))
    pairs = np.stack(layers, axis=2)
    outer, inner = pairs[:, [0, 3]], pairs[:, [1, 2]]
    judged = [0, *range(columns + 1, 2 * columns + 1)]
    with np.errstate(over="ignore"):  # layers that grow without measure are clipped below
        ratio = outer[..., judged] / np.where(inner[..., judged] > 0, inner[..., judged], 1.0)
    fall = np.sqrt(np.clip(ratio.max(axis=-1), 0.0, SLOWEST_FALL**2))
    beyond = 2.0 * outer * (fall / (1.0 + fall) / (1.0 - fall))[..., None]
    pull = np.abs(beyond[..., 1 : columns + 1])
    return beyond[..., 0], pull, beyond[..., columns + 1 :] / 2, fall


def _extent(mass: Array, cells: NDArray[np.int64], share: float) -> NDArray[np.int64]:
    """Cells (b, 2, D) out to the last layers that hold this share of the mass."""
    dim = mass.ndim - 1
    out = np.empty_like(cells)
    for k in range(dim):
        others = tuple(axis for axis in range(1, dim + 1) if axis != k + 1)
        holds = mass.sum(axis=others) > share
        count = holds.shape[1]
        out[:, 0, k] = cells[:, 0, k] - holds.argmax(axis=1)
        out[:, 1, k] = count - 1 - holds[:, ::-1].argmax(axis=1) - cells[:, 0, k]
    return np.maximum(out, 1)


@lru_cache
def fitting(tolerance: float, dim: int) -> float:
    """Width of a cell that a Gaussian needs.

    With nodes H apart the trapezoid rule changes its variance by 2 u exp(-u), u = 2π²/H². What
    `_resolution` makes of this is held to a quarter of the tolerance.
    """

    def change(h: float) -> float:
        u = 2.0 * np.pi**2 / h**2
        return float(min(dim * 2.0 * u * np.exp(-u), 1.0))

    width = 1.2
    while claimed_error(change(2.0 * width), change(4.0 * width)) > tolerance / 4.0:
        width *= 0.98
    return width


def _columns(points: Array, weights: Array, functions: Functions | None) -> Array:
    """Coordinates and functions of them side by side, (b, N, C); 0 where the density is 0."""
    if functions is None:
        return points
    extra = np.asarray(functions(points), dtype=float)
    if extra.ndim != 3 or extra.shape[:2] != points.shape[:2]:
        raise ValueError(
            f"functions must return shape {(*points.shape[:2], 'Q')} for points of shape "
            f"{points.shape}, got {extra.shape}; put the quantities on the last axis."
        )
    inside = weights[..., None] > 0
    if not np.all(np.isfinite(extra) | ~inside):
        bad = np.argwhere(inside & ~np.isfinite(extra))[0]
        raise ValueError(
            f"functions must be finite where the density is not zero, got {extra[tuple(bad)]} at "
            f"{points[tuple(bad[:2])].tolist()}; return -inf as log-density there."
        )
    return np.concatenate([points, np.where(inside, extra, 0.0)], axis=-1)
