"""Moments of some of a posterior's coordinates, on shared lattices or on a grid for each."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..mechanics.contact import Outcome
from ..observer import Observer
from .densities import taken_apart
from .grid import GridPosterior, integrate
from .lattice import Array, Index, LatticeMoments, OnTiles, Tiled, integrate_on_lattice
from .mode import Mode
from .result import Status
from .solution import mode_root


class Engine(ABC):
    """The moments of all unknowns (B, U) for readings (B, R), over the coordinates of some.

    Parameters
    ----------
    observer : Observer
        Of two unknowns and more.
    reading : array, shape (B, R)
    mode : Mode
        Of these readings.
    tolerance : float

    Attributes
    ----------
    peak : Mode
        That of the coordinates that are summed over.
    nested : bool
        As `lattice` has it.
    coarse : array of bool, shape (B,)
        Where what stands for a coordinate that is not summed over is not fine enough.
    """

    nested = False

    def __init__(self, observer: Observer, reading: Array, mode: Mode, tolerance: float) -> None:
        self.observer, self.reading, self.mode = observer, reading, mode
        self.tolerance, self.peak = tolerance, mode
        self.coarse = np.zeros(len(reading), dtype=bool)

    @abstractmethod
    def tiled(self) -> Tiled:
        """The densities on tiles, and the functions there."""

    @abstractmethod
    def at(self, x: Array, index: Index) -> tuple[Array, Array]:
        """The same at nodes of each posterior's own, (b, N, D): (b, N) and (b, N, C)."""

    def completed(self, found: GridPosterior | LatticeMoments) -> dict[str, Any]:
        """What is not yet that of the unknowns in the functions' moments."""
        return {}

    def sound(self) -> NDArray[np.bool_]:
        """Of which posteriors (B,) the densities that were asked for are to be believed."""
        return np.ones(len(self.reading), dtype=bool)

    def on_lattice(self, ridge: NDArray[np.bool_] | None = None) -> LatticeMoments:
        """By `lattice`, over two coordinates, of ridges (B,) with less care."""
        root = mode_root(self.peak)
        found = integrate_on_lattice(
            self.tiled(),
            self.peak.x,
            root @ root.swapaxes(1, 2),
            self.mode.log_density,
            tolerance=self.tolerance,
            nested=self.nested,
            ridge=ridge,
        )
        return found._replace(converged=found.converged & self.sound(), **self.completed(found))

    def on_grid(self, *, max_points: int, keep_points: bool = False) -> GridPosterior:
        """By `grid`, as `integrate` gives them."""
        density, functions = taken_apart(self.at)
        found = integrate(
            density,
            self.peak.x,
            mode_root(self.peak),
            functions=functions,
            only_functions=True,
            tolerance=self.tolerance,
            max_points=max_points,
            keep_points=keep_points,
        )
        doubted = found.converged & ~self.sound()
        status = np.where(doubted, Status.IMPRECISE, found.status)
        return replace(found, status=status, **self.completed(found))


class AllUnknowns(Engine):
    """The moments over all coordinates: the functions are the unknowns themselves."""

    def tiled(self) -> Tiled:
        return self.on_tiles

    def on_tiles(self, points: Array) -> OnTiles:
        """The densities of pairs of a reading and a tile of nodes (T, N, 2), and the unknowns."""
        contact, log_prior = self.observer.contact(points)
        signals, outcome = self.observer.signals(contact)
        held = outcome == Outcome.HELD
        log_prior = np.where(held, log_prior, -np.inf)
        likelihood = self.observer.noise.prepared(np.where(held[..., None], signals, 1.0))
        values = np.where(held[:, None], np.moveaxis(contact, -1, 1), 0.0)

        def density(row: Index, tile: Index) -> tuple[Array, Array]:
            return likelihood(self.reading[row], tile) + log_prior[tile], values[tile]

        return density

    def at(self, x: Array, index: Index) -> tuple[Array, Array]:
        return self.observer.log_density_and_contact(x, self.reading[index, None])
