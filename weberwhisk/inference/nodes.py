"""Nodes of an unknown that has a prior alone, and the observer to whom its value is given there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from .._util.values import Array, Index
from ..mechanics.contact import Outcome
from .coordinates import from_normal, is_all_around
from .observer import Evaluated, Observer

__all__ = ["HALVINGS", "TURN", "Axis", "Conditional"]

#: Most times that nodes are halved. Steps start at 1.2 sd of the prior, and at 1/16 of a turn.
HALVINGS = 6
FIRST, FARTHEST, TURN = 1.2, 4, 16


class Conditional:
    """An observer whose `further` unknowns, those with priors alone, have given values."""

    def __init__(self, observer: Observer, further: tuple[float, ...]) -> None:
        self.observer, self.further = observer, further
        inner = len(observer.unknowns) - len(further)
        self.unknowns, self.noise = observer.unknowns[:inner], observer.noise
        self.is_smooth, self.circular = observer.is_smooth, observer.circular
        self.space = observer.space
        if observer.bounded == 1 and observer.space.reach_varies:
            self.space = observer.space.reaching(_farthest(observer, further))
        self._hash = hash((observer, further))

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Conditional) or self.further != other.further:
            return False
        return self.observer is other.observer or self.observer == other.observer

    def __hash__(self) -> int:
        return self._hash

    def evaluate(self, x: Array) -> Evaluated:
        """Contacts, prior and signals at coordinates (N, U), as trees ask for them."""
        return self.observer.evaluate(x, self.further, self.space)

    def contact_at(self, x: Array) -> Array:
        """Contacts (..., U) at coordinates (..., U)."""
        with np.errstate(all="ignore"):
            whole = self.observer.contact(x, self.further, self.space)[0]
        return whole[..., : len(self.unknowns)]

    def ends(self) -> tuple[Array, Array]:
        """The coordinates between which there is next to all of the prior."""
        return self.observer.ends(len(self.unknowns))


@dataclass(frozen=True)
class Axis:
    """One unknown that has a prior alone, and what is known of how signals depend on it.

    Nodes are counted in units of the smallest step, from the middle of the prior.
    """

    name: str
    observer: Observer

    @property
    def around(self) -> bool:
        """Whether it is an angle that may be any: a circle, with no ends."""
        return self.name == "azimuth" and is_all_around(self.observer.prior[self.name])

    @property
    def unit(self) -> float:
        return (2 * np.pi / TURN if self.around else FIRST) / 2**HALVINGS

    def nodes(self, halvings: int) -> Index:
        step = 2 ** (HALVINGS - halvings)
        if self.around:
            return np.arange(-TURN // 2 * 2**HALVINGS, TURN // 2 * 2**HALVINGS, step)
        return np.arange(-FARTHEST * 2**HALVINGS, FARTHEST * 2**HALVINGS + 1, step)

    def value(self, node: Any) -> Array:
        """Values of the unknown at nodes, which need not be whole."""
        prior, z = self.observer.prior[self.name], self.unit * np.asarray(node, dtype=float)
        if self.around:
            return np.asarray(float(prior.median()) + z)
        return from_normal(prior)(z)

    def log_prior(self, node: Any) -> Array:
        """ln of the prior density at nodes, over the coordinate."""
        z = self.unit * np.asarray(node, dtype=float)
        if self.around:
            return np.full(z.shape, -np.log(2 * np.pi))
        return np.asarray(-0.5 * (z * z + np.log(2 * np.pi)))

    @property
    def known(self) -> str:
        """How signals at any value follow from those at one, "" where they do not.

        All are proportional to a "stiffness"; the directions of a straight whisker's forces are
        those at an azimuth of 0 "turned" by it; and its roll leaves all "as they are".
        """
        cue, noise = self.observer.cue, self.observer.noise
        if self.name == "stiffness" and cue.is_scale and noise.is_scale_family:
            return "scaled"
        if self.name not in ("azimuth", "roll") or not self.observer.forward.is_flat:
            return ""
        if self.name == "roll":
            return "as they are"
        size = len(cue.signal_names)
        fixed = np.asarray(cue.circular) & (noise.weber_fractions(size) == 0)
        plain = np.array_equal(fixed, cue.circular) and noise.gaussian_on == "linear"
        alone = cue.all_but_one is not None
        return "turned" if alone and plain else ""

    def asked(self, readings: Array, covariance: Array | None, node: int) -> Any:
        """Readings and covariances to ask of the tree at this node, and ln of the Jacobian."""
        value = float(self.value(node))
        if self.known == "turned":
            readings = readings.copy()
            readings[:, self.observer.circular] -= value
        if self.known == "scaled":
            size = readings.shape[1]
            covariance = None if covariance is None else covariance / value**2
            return readings / value, covariance, -size * np.log(value)
        return readings, covariance, 0.0


def _farthest(observer: Observer, further: tuple[float, ...]) -> float:
    """The largest distance at which contact is held where other unknowns are given, m."""
    low, high = observer.reach
    for _ in range(5):  # to a millionth of a millionth of the reach
        r = np.linspace(low, high, 258)[1:-1]
        contact = np.column_stack([r, np.tile(further, (len(r), 1))])
        held = np.flatnonzero(observer.signals(contact)[1] == Outcome.HELD)
        if not held.size or held[-1] == len(r) - 1:
            return float(high)
        low, high = r[held[-1]], r[held[-1] + 1]
    return float(low)
