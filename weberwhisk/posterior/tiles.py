"""Moments of two unknowns on a lattice, or of more on a grid for each posterior."""

from __future__ import annotations

import numpy as np

from ..mechanics.contact import Outcome
from ..observer import Observer
from .densities import taken_apart
from .grid import GridPosterior, integrate
from .lattice import Array, Index, LatticeMoments, OnTiles, integrate_on_lattice
from .mode import Mode
from .panels import prepared
from .solution import mode_root


class AllUnknowns:
    """The moments of all unknowns (B, U) for readings (B, R), over all of their coordinates.

    Parameters
    ----------
    observer : Observer
        Of two unknowns and more.
    reading : array, shape (B, R)
    mode : Mode
        Of these readings.
    tolerance : float
    """

    def __init__(self, observer: Observer, reading: Array, mode: Mode, tolerance: float) -> None:
        self.observer, self.reading, self.mode = observer, reading, mode
        self.tolerance = tolerance

    def tiled(self, points: Array) -> OnTiles:
        """The densities on tiles, and the unknowns there."""
        contact, log_prior = self.observer.contact(points)
        signals, outcome = self.observer.signals(contact)
        held = outcome == Outcome.HELD
        log_prior = np.where(held, log_prior, -np.inf)
        likelihood = prepared(self.observer.noise, np.where(held[..., None], signals, 1.0))
        values = np.where(held[:, None], np.moveaxis(contact, -1, 1), 0.0)

        def density(row: Index, tile: Index) -> tuple[Array, Array]:
            return likelihood(self.reading[row], tile) + log_prior[tile], values[tile]

        return density

    def on_lattice(self) -> LatticeMoments:
        """By `lattice`, of two unknowns."""
        root = mode_root(self.mode)
        return integrate_on_lattice(
            self.tiled,
            self.mode.x,
            root @ root.swapaxes(1, 2),
            self.mode.log_density,
            tolerance=self.tolerance,
        )

    def on_grid(self, *, max_points: int, keep_points: bool = False) -> GridPosterior:
        """By `grid`."""
        density, functions = taken_apart(
            lambda x, index: self.observer.log_density_and_contact(x, self.reading[index, None])
        )
        return integrate(
            density,
            self.mode.x,
            mode_root(self.mode),
            functions=functions,
            only_functions=True,
            tolerance=self.tolerance,
            max_points=max_points,
            keep_points=keep_points,
        )
