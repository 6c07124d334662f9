"""Nodes of unknowns that have priors alone, and the tree of an observer to whom these are given."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from .._util.values import Array, Index
from .coordinates import from_normal, is_all_around, is_discontinuous, within_half_turn
from .observer import Observer
from .tree import Tree, tree_of

__all__ = ["HALVINGS", "TURN", "Axis", "Layers"]

#: Most times that nodes are halved. There are 9 to begin with, within 4.7 sd of a prior, or 16 to a
#: turn.
HALVINGS = 6
FIRST, FARTHEST, TURN = 0.6, 4, 16


@dataclass(frozen=True)
class Axis:
    """One unknown that has a prior alone, and what is known of how signals depend on it.

    Nodes are counted in units of the smallest step, from the middle of the prior. They are even in
    t, where z = t + t³/6 is the standard normal score: even in z, half of them would stand beyond
    2.4 sd (frictions took 33 to 129 nodes, and take 17 to 65).
    """

    name: str
    observer: Observer

    @cached_property
    def middle(self) -> float:
        """The median of the prior."""
        return float(self.observer.prior[self.name].median())

    @cached_property
    def around(self) -> bool:
        """Whether it is an angle that may be any: a circle, with no ends."""
        all_around = self.name == "azimuth" and is_all_around(self.observer.prior[self.name])
        return all_around or self.from_plane

    @property
    def unit(self) -> float:
        return (2 * np.pi / TURN if self.around else FIRST) / 2**HALVINGS

    def nodes(self, halvings: int) -> Index:
        step = 2 ** (HALVINGS - halvings)
        if self.around:
            return np.arange(-TURN // 2 * 2**HALVINGS, TURN // 2 * 2**HALVINGS, step)
        return np.arange(-FARTHEST * 2**HALVINGS, FARTHEST * 2**HALVINGS + 1, step)

    def value(self, node: Any) -> Array:
        """Values of the unknown at nodes, which need not be whole.

        For a roll that is `from_plane`: values of the azimuth less the roll.
        """
        t = self.unit * np.asarray(node, dtype=float)
        if self.from_plane:
            return t
        if self.around:
            return np.asarray(self.middle + t)
        return from_normal(self.observer.prior[self.name], t + t**3 / 6)

    def log_prior(self, node: Any) -> Array:
        """ln of the prior density at nodes, over the coordinate."""
        t = self.unit * np.asarray(node, dtype=float)
        if self.from_plane:
            return np.zeros(t.shape)
        if self.around:
            return np.full(t.shape, -np.log(2 * np.pi))
        z, slope = t + t**3 / 6, 1 + t**2 / 2
        return np.asarray(np.log(slope) - 0.5 * (z * z + np.log(2 * np.pi)))

    @cached_property
    def symmetry(self) -> str:
        """How signals at any value follow from those at one, "" where they do not.

        All are proportional to a "stiffness"; the directions of a straight whisker's forces are
        those at an azimuth of 0 "turned" by it, and its roll leaves all "as they are"; those of a
        curved one are turned by the roll, from the same azimuth from its plane of curvature.
        """
        cue, noise = self.observer.cue, self.observer.noise
        if self.name == "stiffness" and cue.is_scale and noise.is_scale_family:
            return "rescaled"
        if self.name == "roll":
            return "as they are" if self.observer.forward.is_flat else "turned" * self.from_plane
        if self.name == "azimuth" and self.observer.forward.is_flat:
            return "turned" * _is_isotropic(self.observer)
        return ""

    @cached_property
    def from_plane(self) -> bool:
        """Whether nodes of a roll are those of the azimuth from the plane of curvature.

        All rolls at one of these share its tree. Its prior must be one of a whole turn without a
        leap, as nodes of a density with ends would have to meet these, and not narrow.
        """
        if self.name != "roll" or self.observer.forward.is_flat or not _is_isotropic(self.observer):
            return False
        prior = self.observer.prior["roll"]
        if np.ptp(prior.support()) < 2 * np.pi - 1e-9 or is_discontinuous(prior):
            return False
        beyond = prior.cdf(self.middle - np.pi) + prior.sf(self.middle + np.pi)
        # A narrower prior is a ridge of both azimuths, finer than their step after two halvings.
        return bool(beyond < 1e-9 and prior.std() > 2 * np.pi / (4 * TURN))

    def for_tree(self, readings: Array, covariance: Array | None, value: Array) -> Any:
        """Readings and covariances to ask of the tree at values (P,), and ln of the Jacobian."""
        if self.symmetry == "turned":
            readings = readings.copy()
            readings[:, self.observer.circular] -= value[:, None]
        if self.symmetry == "rescaled":
            size = readings.shape[1]
            covariance = None if covariance is None else covariance / value[:, None, None] ** 2
            return readings / value[:, None], covariance, -size * np.log(value)
        return readings, covariance, 0.0


def _is_isotropic(observer: Observer) -> bool:
    """Whether readings turned about the base tangent are as probable of contacts so turned."""
    size, circular = len(observer.cue.signal_names), np.asarray(observer.cue.circular)
    if not observer.cue.is_isotropic or np.any(observer.noise.weber_fractions(size)[circular] != 0):
        return False
    components = observer.noise.components(size)
    return all(c.noise.gaussian_on == "linear" for c in components if circular[c.signals].any())


class Layers:
    """The unknowns of an observer that have priors alone, their nodes, and the tree that serves.

    `given` has the nodes of those that stay where they are.
    """

    def __init__(
        self, observer: Observer, tolerance: float, inner: int | None = None,
        given: Mapping[str, int] | None = None,
    ) -> None:  # fmt: skip
        self.observer, self.tolerance, self.given = observer, tolerance, dict(given or {})
        self.inner = observer.bounded if inner is None else inner
        self._all = [Axis(name, observer) for name in observer.unknowns[self.inner :]]
        self.axes = [axis for axis in self._all if axis.name not in self.given]
        #: The numbers of the axes of the azimuth and of a roll whose nodes are `Axis.from_plane`.
        self.rolled = next(
            ((i - 1, i) for i, axis in enumerate(self.axes) if axis.from_plane), None
        )

    @property
    def tree(self) -> Tree:
        """The tree of distance and angle."""
        return tree_of(self.observer, self.tolerance, self.inner)

    def numbers(self, nodes: Array) -> Index:
        """The numbers (P,) that nodes (D, P) have in the tree, of what is given there."""
        kinds, which = np.unique(self.further(nodes), axis=0, return_inverse=True)
        number = self.tree.observer.number
        return np.array([number(tuple(k)) for k in kinds.tolist()])[which.ravel()]

    def further(self, nodes: Array) -> Array:
        """In the tree that serves nodes (D, P), values (P, F) of what has a prior alone."""
        at = dict(zip((axis.name for axis in self.axes), nodes, strict=True)) | self.given
        standard: dict[str, Any] = {"rescaled": 1.0, "turned": 0.0}
        out = {
            axis.name: standard[axis.symmetry]
            if axis.symmetry in standard
            else axis.value(0 if axis.symmetry else at[axis.name])
            for axis in self._all
        }
        if self.rolled:  # all as without a roll
            out["azimuth"] = self.axes[self.rolled[1]].value(at["roll"])
        columns = [np.broadcast_to(value, nodes.shape[1:]) for value in out.values()]
        return np.stack(columns, axis=-1)

    def for_tree(self, readings: Array, covariance: Array | None, values: list[Array]) -> Any:
        """Readings and covariances to ask of the tree at values (P,), and ln of the Jacobian."""
        slope: Any = 0.0
        for axis, value in zip(self.axes, values, strict=True):
            readings, covariance, more = axis.for_tree(readings, covariance, value)
            slope += more
        return readings, covariance, slope

    def values(self, nodes: Any) -> list[Array]:
        """Values of the unknowns at nodes, (D, ...)."""
        out = [axis.value(node) for axis, node in zip(self.axes, nodes, strict=True)]
        if self.rolled:
            azimuth, roll = self.rolled
            middle = self.axes[roll].middle
            out[roll] = middle + within_half_turn(out[azimuth] - out[roll] - middle)
        return out

    def log_prior(self, nodes: Any, values: list[Array]) -> Array:
        """ln of the prior density at nodes (D, ...) and their values, over their coordinates."""
        out = sum(axis.log_prior(node) for axis, node in zip(self.axes, nodes, strict=True))
        if self.rolled:
            out = out + self.observer.prior["roll"].logpdf(values[self.rolled[1]])
        return np.asarray(out)
