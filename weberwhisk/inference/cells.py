"""Cells of an observer's coordinates: what is kept of each, and the levels of their spacings."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields

import numpy as np
from numpy.typing import NDArray

from .._util.values import Array, Index

__all__ = ["Cells", "Lattices", "Level"]


@dataclass(eq=False)
class Cells:
    """Evaluated cells of one spacing, along the last axis of every array.

    Attributes
    ----------
    given : array, shape (N,)
        The number of what is given.
    place : array, shape (U, N)
        In steps, of the lower corner.
    contact : array, shape (U, N)
        At the middle.
    log_prior, rise : array, shape (N,)
        ln of the prior density, and by how much it may be higher elsewhere in the cell.
    mean, precision, blurred_precision : array, shape (S, N)
        Of a Gaussian reading: mean, 1/sd, and 1/sd if it is as uncertain as signals vary across
        the cell.
    log_scale, blurred_log_scale : array, shape (N,)
        ln of the prior density with the normalising constant of either.
    length : array, shape (U, N)
        By how many sds of a reading signals change across the cell.
    change : array, shape (U F, N)
        By how much features change across it, axis by axis.
    signals : array, shape (S, N)
        For noise that is not Gaussian, with `other_length` (N,), the change in JNDs.
    """

    given: Index
    place: NDArray[np.int32]
    contact: Array
    log_prior: Array
    rise: Array
    mean: Array
    precision: Array
    blurred_precision: Array
    log_scale: Array
    blurred_log_scale: Array
    length: Array
    change: Array
    signals: Array
    other_length: Array

    @property
    def count(self) -> int:
        return len(self.log_prior)

    @property
    def bytes_each(self) -> int:
        """Memory of a cell."""
        arrays = [getattr(self, f.name) for f in fields(self)]
        return sum(a.itemsize * (len(a) if a.ndim > 1 else 1) for a in arrays)


@dataclass(eq=False)
class Level:
    """Cells of one spacing that have been evaluated, to which more are appended.

    By pattern of halved axes, the level of the halves, and where the halves of each cell begin.
    """

    step: Array
    depth: int = 0
    children: dict[tuple[int, ...], tuple[Level, Index]] = field(default_factory=dict)
    count: int = 0
    _room: Cells | None = None

    @property
    def cells(self) -> Cells:
        """All cells; those beyond `count` are room for more."""
        assert self._room is not None
        return self._room

    def append(self, more: Cells) -> int:
        """Keep more cells; the number of the first."""
        first, self.count = self.count, self.count + more.count
        if self._room is None or self.count > self._room.count:
            # Of room that is not used yet there is no memory; copies are what costs.
            size = 3 * self.count + 16
            room = {}
            for f in fields(Cells):
                new = getattr(more, f.name)
                room[f.name] = np.empty((*new.shape[:-1], size), dtype=new.dtype)
                if self._room is not None:
                    room[f.name][..., :first] = getattr(self._room, f.name)[..., :first]
            self._room = Cells(**room)
        for f in fields(Cells):
            getattr(self._room, f.name)[..., first : self.count] = getattr(more, f.name)
        return first


@dataclass(frozen=True, eq=False)
class Lattices:
    """The last cells of readings: a lattice of each, its cells side by side.

    Attributes
    ----------
    step : array, shape (U, n)
        Of the lattice of each reading.
    readings : array, shape (n,)
        The number of each reading.
    first : array, shape (n,)
        Where its cells begin.
    place : array, shape (U, P)
        Of each cell, in steps.
    log : array, shape (P,)
        ln of the density there.
    """

    step: Array
    readings: Index
    first: Index
    place: NDArray[np.int32]
    log: Array

    @property
    def counts(self) -> Index:
        """The number of cells of each reading."""
        return np.diff(self.first, append=len(self.log))

    @property
    def owner(self) -> Index:
        """The number among `readings` of each cell, (P,)."""
        return np.repeat(np.arange(len(self.readings)), self.counts)

    def of(self, kept: NDArray[np.bool_]) -> Lattices:
        """Those of the readings that are kept (n,)."""
        counts, cells = self.counts, np.repeat(kept, self.counts)
        first = np.append(0, np.cumsum(counts[kept])[:-1])
        return Lattices(
            self.step[:, kept], self.readings[kept], first, self.place[:, cells], self.log[cells]
        )

    @classmethod
    def joined(cls, several: Sequence[Lattices]) -> Lattices:
        """Those of all readings of several."""
        if len(several) == 1:
            return several[0]
        cells = [len(each.log) for each in several]
        before = np.append(0, np.cumsum(cells[:-1]))
        return cls(
            np.concatenate([each.step for each in several], axis=1),
            np.concatenate([each.readings for each in several]),
            np.concatenate([each.first + n for each, n in zip(several, before, strict=True)]),
            np.concatenate([each.place for each in several], axis=1),
            np.concatenate([each.log for each in several]),
        )

    def chunks(self, size: int) -> Iterator[Lattices]:
        """The same, of so many readings at a time at most."""
        if len(self.readings) <= size:
            yield self
            return
        number = np.arange(len(self.readings)) // size
        for i in range(number[-1] + 1):
            yield self.of(number == i)
