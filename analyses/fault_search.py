"""A search for answers that are wrong in silence: random, at the boundaries, and by evolution.

Used by `stability.py`; has no command of its own. A *domain* names the numbers that a case has and
judges many cases at once against a reference. `search` tries cases all over, cases close to the
special values of each axis (a tip, a fold, an end of the range), and then the descendants of the
worst: children of two parents, moved by a step of any size (an evolution strategy whose fitness is
how far the true error exceeds what the answer admits).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
import pandas as pd

Array = np.ndarray


class Fate(IntEnum):
    """What became of a case."""

    RIGHT = 0
    WARNED = 1
    REFUSED = 2
    SILENT = 3
    UNJUDGED = 4

    @property
    def words(self) -> str:
        """The fate in words."""
        return (
            "right",
            "right as far as its warning says",
            "refused with an outcome",
            "wrong in silence",
            "not judged: the reference itself was not sure",
        )[self]


@dataclass(frozen=True)
class Axis:
    """One number of a case: its range, whether it is spread in the logarithm, special values."""

    low: float
    high: float
    log: bool = False
    special: tuple[float, ...] = ()

    def spread(self, share: Array) -> Array:
        """Values at shares, 0 to 1, of the range."""
        if self.log:
            return self.low * (self.high / self.low) ** share
        return self.low + (self.high - self.low) * share

    def share(self, value: Array) -> Array:
        """The share of the range at which values lie."""
        if self.log:
            return np.log(value / self.low) / np.log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)

    def near(self, rng: np.random.Generator, n: int) -> Array:
        """Values on and close to the special ones and the ends, off by 1 to 1e-12 of the range."""
        places = np.array([self.low, self.high, *self.special])
        at = places[rng.integers(places.size, size=n)]
        off = 10 ** rng.uniform(-12, 0, n) * rng.choice([-1.0, 0.0, 1.0], n, p=[0.4, 0.2, 0.4])
        if self.log:
            value = at * (self.high / self.low) ** off
        else:
            value = at + off * (self.high - self.low)
        return np.clip(value, self.low, self.high)


@dataclass(frozen=True)
class Judged:
    """Fates of n cases; ln of true over admitted error (−∞ where refused); what was seen."""

    fate: Array
    excess: Array
    seen: dict[str, Array]


@dataclass(frozen=True)
class Domain:
    """Cases of one kind, and their judge."""

    name: str
    axes: dict[str, Axis]
    judge: Callable[[dict[str, Array]], Judged]

    def table(self, case: dict[str, Array]) -> pd.DataFrame:
        """Cases judged, a row each."""
        judged = self.judge(case)
        columns: dict[str, Any] = {"domain": self.name, **case, **judged.seen}
        return pd.DataFrame({**columns, "excess": judged.excess, "fate": judged.fate.astype(int)})


def search(domain: Domain, size: int, generations: int, seed: int) -> pd.DataFrame:
    """All cases tried, `size` of them at random, `size` near boundaries, `size` a generation."""
    rng = np.random.default_rng(seed)
    axes = domain.axes
    case = {}
    for name, axis in axes.items():
        value = axis.spread(rng.random(2 * size))
        close = (np.arange(2 * size) >= size) & (rng.random(2 * size) < 0.6)
        case[name] = np.where(close, axis.near(rng, 2 * size), value)
    tried = domain.table(case)
    tried["how"] = np.where(np.arange(2 * size) < size, "random", "boundary")
    tables = [tried]
    for _ in range(generations):
        everything = pd.concat(tables, ignore_index=True)
        fit = everything[np.isfinite(everything["excess"])]
        if fit.empty:
            break
        # The worst, but no two from one spot: a parent is the worst of a few drawn at random.
        drawn = rng.integers(len(fit), size=(2 * size, 6))
        winner = np.take_along_axis(drawn, fit["excess"].to_numpy()[drawn].argmax(1)[:, None], 1)
        one, other = winner[:size, 0], winner[size:, 0]
        child = {}
        step = 10 ** rng.uniform(-5, -0.5, size)
        for name, axis in axes.items():
            share = axis.share(fit[name].to_numpy())
            mixed = np.where(rng.random(size) < 0.8, share[one], share[other])
            moved = mixed + step * rng.standard_normal(size) * (rng.random(size) < 0.6)
            child[name] = axis.spread(np.clip(moved, 0.0, 1.0))
        born = domain.table(child)
        born["how"] = "evolution"
        tables.append(born)
    out = pd.concat(tables, ignore_index=True)
    out["seed"] = seed
    return out


def silent(table: pd.DataFrame) -> pd.DataFrame:
    """The cases that went wrong in silence, the worst first."""
    return table[table["fate"] == Fate.SILENT].sort_values("excess", ascending=False)
