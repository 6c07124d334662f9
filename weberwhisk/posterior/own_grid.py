"""Readings that no tiles serve, each on a grid of its own."""

from __future__ import annotations

import numpy as np

from ..observer import Observer
from .grid import integrate
from .solution import Array, Index
from .tiled import Moments
from .tiling import prior_box


class OwnGrids:
    """The posteriors of readings (B, R) by `grid`, over all of the prior."""

    count = 1

    def __init__(self, observer: Observer, reading: Array) -> None:
        self.observer = observer

        def density(x: Array, index: Index) -> Array:
            return observer.log_density(x, reading[index, None])

        boxes = (np.tile(side, (len(reading), 1)) for side in prior_box(observer))
        found = integrate(density, *boxes, functions=lambda x: observer.contact(x)[0])
        self.weights, self.contacts = found.weights, observer.contact(found.points)[0]
        best = self.weights.argmax(axis=1)
        contact = self.contacts[np.arange(len(reading)), best]
        signals = np.nan_to_num(observer.signals(contact)[0], nan=1.0)
        share, none = self.weights.max(axis=1), np.zeros(len(reading))
        self.moments = Moments(
            found.mean, found.sd, found.log_evidence, share, contact, signals, none, none
        )
        self.error = found.error

    def quantiles(self, p: Array, unknown: int) -> tuple[Array, Array]:
        """Quantiles (B, Q), and their errors: what leaving out every other node changes."""
        out, other = np.empty((2, len(self.weights), len(p)))
        for i, (contact, weight) in enumerate(zip(self.contacts, self.weights, strict=True)):
            value, whose = np.unique(contact[:, unknown], return_inverse=True)
            mass = np.bincount(whose, weight)
            for found, some in ((out, slice(None)), (other, slice(None, None, 2))):
                rise = np.cumsum(mass[some]) - mass[some] / 2
                found[i] = np.interp(p, rise / mass[some].sum(), value[some])
        return out, np.abs(out - other)

    def draws(self, count: int, rng: np.random.Generator) -> Array:
        """Contacts (B, count, U) drawn from the nodes."""
        chosen = [rng.choice(len(w), count, p=w) for w in self.weights]
        return np.stack([c[i] for c, i in zip(self.contacts, chosen, strict=True)])
