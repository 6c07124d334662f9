"""What tiles ask of an observer: the likelihood of all its unknowns, or of all but the last."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..mechanics.contact import Outcome
from ..observer import Observer
from .solution import Array
from .summed import LastSummed, NotSmooth


class AllUnknowns:
    """Every unknown has an axis of the tiles; nodes have the signals themselves."""

    panels = 1

    def __init__(self, observer: Observer) -> None:
        self.observer, self.noise = observer, observer.noise
        self.dim = len(observer.unknowns)
        #: Most boxes: 120 000 in two dimensions, 20 000 in three.
        self.most = 720_000 // 6 ** (self.dim - 1)

    def contact(self, x: Array) -> tuple[Array, Array]:
        """Contacts (..., U) at coordinates x, and ln of the prior."""
        return self.observer.contact(x)

    def signals(self, x: Array, contact: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Signals (..., S) of contacts (..., U), and which are held."""
        signals, outcome = self.observer.signals(contact)
        held = outcome == Outcome.HELD
        return np.where(held[..., None], signals, 1.0), np.asarray(held)

    def views(self, signals: Array) -> list[tuple[Array, Array | None]]:
        """The signals; there is nothing left to know."""
        return [(signals, None)]

    def over_views(self, lengths: list[Array]) -> Array:
        """The lengths (n, d) of boxes, of what the views say."""
        return lengths[0]

    def interval(self, signals: Array, width: float) -> tuple[Array, Array]:
        """Between which readings (..., 1, R) lie."""
        low, high = self.noise.interval(signals, width)
        return low[..., None, :], high[..., None, :]

    def log_likelihood(self, reading: Array, signals: Array) -> Array:
        """ln p(reading | contact), (m, N), for readings (m, R) and nodes (m, N, S)."""
        return self.noise.log_likelihood(reading[:, None], signals)


Likelihood = AllUnknowns | LastSummed


@lru_cache(maxsize=64)
def likelihood_of(observer: Observer) -> Likelihood:
    """Of three unknowns and more the last is summed out, where signals are smooth in it.

    Not so of two cues with an unknown each: the last is known by its own cue as well as any is.
    """
    if (
        len(observer.unknowns) < 3
        or observer.unknowns[-1] not in observer.unknowns[observer.bounded :]
    ):
        return AllUnknowns(observer)
    try:
        return LastSummed(observer)
    except NotSmooth:
        return AllUnknowns(observer)
