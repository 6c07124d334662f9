"""Where the posteriors of data sets lie on the axes, and how fine the steps of a pass are there.

At each node of the score of k every data set has a window in either lapse and in the coordinate of
every group's bias. A pass over the nodes narrows them to what is near the best node.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._util.values import Array
from .axes import even
from .likelihood import WeberModel

__all__ = ["Profile", "Span", "Steps", "Windows", "narrowed", "whole_prior"]

#: Normal scores of priors between which k and biases are searched, and lapses.
REACH_SCORES, REACH_LAPSES = 8.0, 5.0


class Steps(NamedTuple):
    """Steps of the score of k, of the coordinates of both lapses, and of biases in the least sd
    that a bias can have given the rest."""

    k: float
    low: float
    high: float
    bias: float

    def times(self, *factors: float) -> Steps:
        """The same, all by one factor or each by its own."""
        return Steps(*(np.array(self) * factors).tolist())


class Span(NamedTuple):
    """Windows on one axis, (..., R): infinite the wrong way round where nothing is kept."""

    first: Array
    last: Array

    @property
    def ends(self) -> tuple[float, float]:
        """The span of all windows together."""
        finite = np.isfinite(self.first)
        return float(self.first[finite].min()), float(self.last[finite].max())

    @property
    def kept(self) -> NDArray[np.bool_]:
        """Where there is a window."""
        return np.isfinite(self.first)

    def at(self, place: Any) -> Span:
        """The windows at a place."""
        return Span(self.first[place], self.last[place])


@dataclass(frozen=True)
class Windows:
    """What is kept of R data sets at each of K nodes of the score of k.

    `fraction` (R,) is how far k goes, `nodes` (K,) are its nodes; the others are (K, R), of the
    coordinates of both lapses and of the score of each group's bias.
    """

    nodes: Array
    fraction: Span
    low: Span
    high: Span
    biases: tuple[Span, ...]

    def at(self, nodes: Array) -> Windows:
        """Windows at other nodes of k: those of the two nodes beside each, together."""
        left = np.clip(np.searchsorted(self.nodes, nodes - 1e-9) - 1, 0, self.nodes.size - 1)
        right = np.minimum(left + 1, self.nodes.size - 1)
        first, last = (end[None] for end in self.fraction)
        outside = (nodes[:, None] < first - 1e-9) | (nodes[:, None] > last + 1e-9)

        def moved(span: Span) -> Span:
            first = np.minimum(span.first[left], span.first[right])
            last = np.maximum(span.last[left], span.last[right])
            first[outside], last[outside] = np.inf, -np.inf
            return Span(first, last)

        biases = tuple(moved(span) for span in self.biases)
        return Windows(nodes, self.fraction, moved(self.low), moved(self.high), biases)


def whole_prior(model: WeberModel, count: int) -> Windows:
    """Windows of so many data sets over the whole prior."""

    def span(low: float, high: float, *shape: int) -> Span:
        return Span(np.full(shape, low), np.full(shape, high))

    lapses = []
    for transform, free in zip(model.transforms[-2:], model.free[-2:], strict=True):
        first, last = transform.coordinate([-REACH_LAPSES, REACH_LAPSES]) * free
        lapses.append(span(float(first), float(last), 1, count))
    low, high = lapses
    k = REACH_SCORES * model.free[0]
    ends = model.bias_transform.coordinate([-REACH_SCORES, REACH_SCORES]) * model.free_bias
    biases = tuple(span(*ends.tolist(), 1, count) for _ in range(model.n_groups))
    return Windows(np.zeros(1), span(-k, k, count), low, high, biases)


class Profile(NamedTuple):
    """Nodes of an axis at each node of k, (K, N), and the highest log density with each, of every
    data set, (K, N, R)."""

    nodes: Array
    values: NDArray[np.floating]


def narrowed(
    before: Windows,
    nodes: Array,
    low: Profile,
    high: Profile,
    biases: list[Profile],
    cut: float,
) -> Windows:
    """Windows around the nodes of k that matter, within those before.

    A node `cut` nats under the best counts as empty.
    """
    top = low.values.max(axis=1)  # (K, R)
    least = top.max(axis=0) - cut
    above = top > least
    # Nodes of k are interpolated to the very ends: a whole gap is added.
    ends = _ends(Profile(nodes[None], top[None]), least[None], 1.0)
    limits = before.fraction.ends
    fraction = Span(np.maximum(ends.first[0], limits[0]), np.minimum(ends.last[0], limits[1]))
    least = np.broadcast_to(least, top.shape)

    def window(profile: Profile, old: Span) -> Span:
        ends, (start, end) = _ends(profile, least, 0.15), old.ends
        first = np.where(above, np.maximum(ends.first, start), np.inf)
        last = np.where(above, np.minimum(ends.last, end), -np.inf)
        if nodes.size == 1:
            return Span(first, last)
        # k goes on beyond the last node kept, and the windows with it.
        return Span(_beside(first, np.minimum, np.inf), _beside(last, np.maximum, -np.inf))

    return Windows(
        nodes, fraction, window(low, before.low), window(high, before.high),
        tuple(window(profile, old) for profile, old in zip(biases, before.biases, strict=True)),
    )  # fmt: skip


def _beside(side: Array, nearest: np.ufunc, empty: float) -> Array:
    """Ends (K, R), those of empty nodes as of the nodes beside them."""
    pad = np.full((1, side.shape[1]), empty)
    beside = nearest(np.concatenate([pad, side[:-1]]), np.concatenate([side[1:], pad]))
    return np.where(np.isinf(side), beside, side)


def _ends(profile: Profile, least: Array, beyond: float) -> Span:
    """Where what is above the least begins and ends on an axis, (K, R).

    Linear interpolation puts the ends between nodes; `beyond` of a gap is added.
    """
    nodes, values = profile
    size = nodes.shape[1]
    if size == 1:
        both = np.broadcast_to(nodes, least.shape)
        return Span(both, both)
    full = values > least[:, None].astype(values.dtype)
    gap = (nodes[:, 1] - nodes[:, 0])[:, None]
    m, r = np.ogrid[: least.shape[0], : least.shape[1]]
    # Counted from 1, in small whole numbers: `argmax` over a middle axis takes many times as long.
    number = np.arange(1, size + 1).astype(np.min_scalar_type(size))[:, None]
    begin = (size - (full * number[::-1]).max(axis=1).astype(np.intp)) % size
    end = ((full * number).max(axis=1).astype(np.intp) - 1) % size
    out = []
    for at, step in ((begin, -1), (end, 1)):
        outside = np.minimum(np.maximum(at + step, 0), size - 1)
        outer = np.maximum(np.where(outside == at, -np.inf, values[m, outside, r]), least - 20.0)
        inner = np.maximum(values[m, at, r], least)  # where nothing is above, whatever
        share = beyond + (inner - least) / np.maximum(inner - outer, 1e-9)
        out.append(nodes[m, at] + step * share * gap)
    return Span(*out)


def even_nodes(span: Span, step: float) -> Array:
    """Even nodes over all windows on an axis."""
    return even(*span.ends, step)
