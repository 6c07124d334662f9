"""Checks of a population: residuals summed over its animals, which see what no animal shows alone.

Every statistic is of the answers given draws of each animal's parameters from all the data, as
posterior-predictive checks are; sums over many animals are normal, so that replicated answers need
not be drawn.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import chdtrc, ndtr

from .._util.values import Array
from .alone import DIRECTIONS, AnimalFits
from .effects import Overdispersion
from .likelihood import Draws, WeberModel
from .population import Population
from .predictive import FALSE_ALARMS

__all__ = ["any_fired", "pooled_checks", "pooled_residuals"]

DRAWS = 100  # of each animal
MOST_STANDARDS = 12  # more are put into so many groups of equal numbers
#: Edges of the groups of levels, in sds of the difference.
EDGES = np.array([-2.5, -1.5, -0.8, -0.3, 0.3, 0.8, 1.5, 2.5])
STATISTICS = ("standards", "levels", "order")


def pooled_residuals(
    fits: AnimalFits, population: Population, subjects: Sequence[Hashable]
) -> dict[str, pd.DataFrame]:
    """Tables of residuals over all animals by name of the check.

    `standards`: by standard and by whether the second stimulus was greater; `levels`: by the
    difference of the signals in sds; `order`: by which interval held the standard, and the side.
    Columns: the groups, `n`, `observed` and `expected` proportions, `z`, and, for each draw, the
    squared residual in its variance in `squares`.
    """
    sums: dict[str, list[pd.DataFrame]] = {name: [] for name in STATISTICS}
    rng = np.random.default_rng(0)
    for number, subject in enumerate(subjects):
        model = fits.model(subject, whole=True)
        draws = _draws(model, population, number, rng)
        p, q = model.expected(draws)
        n, count = model.cells.n, model.cells.count
        variance = n * p * q * _overdispersed(model, draws)
        columns: dict[Any, Array] = {
            "n": n, "count": count, "mean": (n * p).mean(axis=0),
            **{("off", i): row for i, row in enumerate(count - n * p)},
            **{("variance", i): row for i, row in enumerate(variance)},
        }  # fmt: skip
        frame = pd.DataFrame(columns)
        for name, groups in _groups(model, draws, fits.trials[subject].has_standards).items():
            sums[name].append(frame.groupby(groups).sum())
    out = {}
    for name, tables in sums.items():
        if tables:
            table = pd.concat(tables)
            table = table.groupby(level=list(range(table.index.nlevels))).sum()
            out[name] = _residuals(_fewer(table) if name == "standards" else table)
    return out


def _draws(
    model: WeberModel, population: Population, number: int, rng: np.random.Generator
) -> Draws:
    """Parameters of an animal given all answers."""
    weights = population.animal_weights(number)
    values = population.animal_values(number)
    at = rng.choice(weights.size, DRAWS, p=weights)
    named = {name: column[at] for name, column in values.items()}

    def of(name: str) -> Array:
        return named[name] if name in named else np.full(DRAWS, model.fixed_value(name))

    bias = np.full((DRAWS, model.n_groups), model.fixed_bias())
    if model.free_bias:
        bias = np.stack([of(name) for name in model.group_names], axis=1)
    effects = [of(effect.name) for effect in model.effects]
    return Draws(
        of("weber_fraction"), of("lapse_low"), of("lapse_high"), bias,
        np.stack(effects, axis=1) if effects else np.zeros((DRAWS, 0)),
    )  # fmt: skip


def _overdispersed(model: WeberModel, draws: Draws) -> Array | float:
    at = [i for i, effect in enumerate(model.effects) if isinstance(effect, Overdispersion)]
    return 1 + np.maximum(model.cells.n - 1, 0) * draws.effects[:, at[:1]] if at else 1.0


def _groups(model: WeberModel, draws: Draws, has_standards: bool) -> dict[str, list[Array]]:
    """The groups of each cell, by check."""
    cells = model.cells
    side = np.sign(cells.stimulus_2 - cells.stimulus_1)
    middle = Draws(*(np.median(values, axis=0)[None] for values in draws.values))
    d = np.broadcast_to(model.decide(middle.weber_fraction, middle.effects)[0], (1, side.size))[0]
    out = {"levels": [np.searchsorted(EDGES, d)]}
    if has_standards:
        out["standards"] = [cells.standard, side]
        second = np.isclose(cells.stimulus_2, cells.standard)
        first = np.isclose(cells.stimulus_1, cells.standard)
        if (second & ~first).any() and (first & ~second).any():
            out["order"] = [second.astype(float), side]
    return out


def _fewer(table: pd.DataFrame) -> pd.DataFrame:
    """The same with as few groups of standards as can be told apart in a table."""
    standards = table.index.get_level_values(0).to_numpy()
    if np.unique(standards).size <= MOST_STANDARDS:
        return table
    rank = np.argsort(np.argsort(standards, kind="stable"), kind="stable")
    group = rank * MOST_STANDARDS // standards.size
    middle = pd.Series(standards).groupby(group).transform("median").to_numpy()
    return table.groupby([middle, table.index.get_level_values(1).to_numpy()]).sum()


def _residuals(sums: pd.DataFrame) -> pd.DataFrame:
    off = sums[[("off", i) for i in range(DRAWS)]].to_numpy()
    variance = np.maximum(sums[[("variance", i) for i in range(DRAWS)]].to_numpy(), 1e-9)
    n, count, mean = (sums[name].to_numpy() for name in ("n", "count", "mean"))
    z = (off / np.sqrt(variance)).mean(axis=1)
    table = pd.DataFrame({"n": n, "observed": count / n, "expected": mean / n, "z": z}, sums.index)
    table.attrs["squares"] = (off**2 / variance).sum(axis=0)
    return table


def any_fired(residuals: Mapping[str, pd.DataFrame]) -> bool:
    """Whether residuals of all animals together show a misfit."""
    return bool(pooled_checks(residuals, pd.DataFrame(columns=[*DIRECTIONS]))["fired"].any())


def pooled_checks(residuals: Mapping[str, pd.DataFrame], directions: pd.DataFrame) -> pd.DataFrame:
    """A row a check: `observed`, a sum of squares over so many groups or a mean direction in sds of
    it; `groups`, or `animals`; its `p`, and `fired`, whether it is below the threshold.

    Directions are those of each animal's residuals: their sum over the root of their number.
    """
    rows = {}
    for name, table in residuals.items():
        squares = table.attrs["squares"]
        rows[name] = float(squares.mean()), len(table), float(chdtrc(len(table), squares).mean())
    for name in DIRECTIONS:
        values = directions[name].dropna().to_numpy()
        if values.size:
            z = float(values.sum() / np.sqrt(values.size))
            rows[name] = z, values.size, float(2 * ndtr(-abs(z)))
    out = pd.DataFrame.from_dict(rows, "index", columns=["observed", "count", "p"])
    return out.rename_axis("check").assign(fired=out["p"] < FALSE_ALARMS / max(len(out), 1))
