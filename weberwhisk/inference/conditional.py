"""An observer to whom the unknowns that have priors alone are given, at numbered nodes."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from .._util.values import Array, Index, distinct
from ..mechanics.contact import Outcome
from .coordinates import AngleScale, PriorScale
from .observer import Observer

__all__ = ["Conditional", "Evaluated"]


class Evaluated(NamedTuple):
    """Contacts (N, U) at coordinates, ln of the prior density there (N,), signals (N, S), scores.

    Where a contact is not held the density is −inf and signals are 0. Scores (N, P) say how far up
    the priors that were given of distance and angle these are, as standard normal scores.
    """

    contact: Array
    log_prior: Array
    signals: Array
    scores: Array


class Conditional:
    """What a tree needs of an observer of its first `inner` unknowns, the others being given.

    Their values (F,) have numbers, in the order in which they are first needed. Where the reach
    depends on them, and no angle is unknown or the prior of the angle begins above 0, distances end
    at a reach of each number's own.
    """

    def __init__(self, observer: Observer, inner: int) -> None:
        self.observer = observer
        self.unknowns = observer.unknowns[:inner]
        self.values = np.zeros((0, len(observer.unknowns) - inner))
        self._numbers: dict[tuple[float, ...], int] = {}
        varies = inner < len(observer.unknowns) and observer.space.reach_varies
        ends = varies and (observer.bounded == 1 or observer.space.is_wedge)
        self._reaches: list[float] | None = [] if ends else None
        if not self.values.shape[1]:
            self.number(())

    def number(self, further: tuple[float, ...]) -> int:
        """The number of values (F,)."""
        if further not in self._numbers:
            self._numbers[further] = len(self._numbers)
            self.values = np.concatenate([self.values, [further]])
            if self._reaches is not None:
                self._reaches.append(_farthest(self.observer, further))
        return self._numbers[further]

    def given(self, which: Index) -> list[Any]:
        """The values at numbers (n,): of each unknown (n,), or one float where all are the same."""
        if len(which) and (which == which[0]).all():
            return self.values[which[0]].tolist()
        return list(self.values[which].T)

    def _space(self, which: Index) -> Any:
        space = self.observer.space
        return space if self._reaches is None else space.reaching(np.array(self._reaches)[which])

    def evaluate(self, x: Array, which: Index) -> Evaluated:
        """At coordinates (N, U) and numbers (N,), without density where contact is lost.

        The same to the bit whatever other coordinates are evaluated with them.
        """
        observer, count, given = self.observer, len(x), list(self.values[which].T)
        if given and (which == which[0]).all():
            # Tables are summed in another order for one value: a last contact has values beside it.
            x, which = np.append(x, x[-1:], axis=0), np.append(which, which[-1:])
            given = [np.append(v, v[-1] * (1 + 1e-9) + 1e-300) for v in given]
        with np.errstate(all="ignore"):
            contact, log_prior = self._space(which).constrain(x, given)
            signals, outcome = observer.cue.signals(
                observer.whisker, contact, model=observer.solver
            )
        in_contact = (outcome == Outcome.HELD) & np.isfinite(log_prior)
        in_contact &= np.isfinite(signals).all(axis=-1)
        with np.errstate(all="ignore"):
            scores = np.where(in_contact[:, None], observer.space.given_scores(contact), 0.0)
        signals = np.where(in_contact[:, None], signals, 0.0)
        log_prior = np.where(in_contact, log_prior, -np.inf)
        return Evaluated(contact[:count], log_prior[:count], signals[:count], scores[:count])

    def contact_at(self, x: Array, which: Index) -> Array:
        """Contacts (N, U) at coordinates (N, U) and numbers (N,), with all that is given."""
        with np.errstate(all="ignore"):
            return self._space(which).constrain(x, self.given(which))[0]

    def second_scale(self, x: Array, which: Index) -> AngleScale | PriorScale:
        """How the second unknown goes with its coordinate, at first ones and numbers (N,)."""
        space = self._space(which)
        if self.observer.bounded < 2:
            return PriorScale(self.observer.prior[self.unknowns[1]], len(x))
        with np.errstate(all="ignore"):
            r = space.distance(x)
            further = [np.broadcast_to(value, r.shape) for value in self.given(which)]
            (r, *further), back = distinct(r, *further)
            return space.angle_scale(np.column_stack([r, 0 * r, *further])).of(back)

    def distance(self, x: Array, which: Index) -> Array:
        """The radial distances (n, L), m, at first coordinates and numbers (n,)."""
        return np.asarray(self._space(which[:, None]).distance(x))


def _farthest(observer: Observer, further: tuple[float, ...]) -> float:
    """The largest distance at which contact is held where other unknowns are given, m."""
    if observer.space.is_wedge:
        return observer.space.open_reach(further)[1]
    low, high = observer.reach
    for _ in range(5):  # to a millionth of a millionth of the reach
        r = np.linspace(low, high, 258)[1:-1]
        contact = np.column_stack([r, np.tile(further, (len(r), 1))])
        in_contact = np.flatnonzero(observer.signals(contact)[1] == Outcome.HELD)
        if not in_contact.size or in_contact[-1] == len(r) - 1:
            return float(high)
        low, high = r[in_contact[-1]], r[in_contact[-1] + 1]
    return float(low)
