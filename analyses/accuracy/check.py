"""The kept truth beside draws from the prior: importance sampling, which shares no grid with it.

    python analyses/accuracy/check.py [table] [--each 2] [--draws 20000000] [--seed 1]

Contacts are drawn flat over distance and angle, further unknowns from their priors, and weighted
with the observer's own likelihood; those that are not held weigh nothing. Of the readings of each
kind with the largest Weber fractions, where draws do best, prints how far mean and sd of the draws
are from the truth, over the sd and over their standard errors.
"""

from __future__ import annotations

import argparse
import csv
import inspect
import json
from pathlib import Path
from typing import Any

import numpy as np
from cases import largest_angle, observer_of
from numpy.typing import NDArray

Array = NDArray[np.float64]

TABLE = Path(__file__).with_name("truth.csv")
BATCH = 500_000


def drawn(row: dict[str, str], draws: int, seed: int) -> tuple[Array, Array, float]:
    """Mean and sd of each unknown (U, 2), their standard errors (U, 2), and effective draws.

    Parameters
    ----------
    row : dict
        A line of the table.
    draws, seed : int
        Contacts drawn in all.
    """
    observer = observer_of(json.loads(row["observer"]))
    reading = np.array(json.loads(row["reading"]))
    truth = np.array([values[:2] for values in json.loads(row["truth"]).values()])
    rng = np.random.default_rng(seed)
    cue, whisker = observer.cue, observer.whisker
    top = 0.0
    if len(cue.unknowns) > 1:  # the highest angle of any contact, and a little more
        some = _contacts(observer, reading, np.zeros(2), 20_000, rng)
        top = 1.02 * float(largest_angle(cue, whisker, some).max())
    # Sums of w, w·u, w·u², w² and so on, with u the unknowns in sds from the truth.
    sums, log_scale = np.zeros((6, len(truth))), -np.inf
    for _ in range(max(draws // BATCH, 1)):
        contact = _contacts(observer, reading, np.array([0.0, top]), BATCH, rng)
        log = observer.log_likelihood(reading, contact)
        if len(cue.unknowns) > 1:
            log[contact[:, 1] > largest_angle(cue, whisker, contact)] = -np.inf
        best = max(log.max(), log_scale)
        if best > log_scale:
            shrink = np.exp(log_scale - best)
            sums *= np.array([1, 1, 1, shrink, shrink, shrink])[:, None] * shrink
            log_scale = best
        weight = np.exp(log - log_scale)[:, None]
        some = weight[:, 0] > 0
        weight, u = weight[some], (contact[some] - truth[:, 0]) / truth[:, 1]
        terms = (weight, weight * u, weight * u**2, weight**2, (weight * u) ** 2,
                 (weight * (u**2 - 1)) ** 2)  # fmt: skip
        sums += np.stack([np.broadcast_to(t.sum(axis=0), len(truth)) for t in terms])
    total = sums[0]
    mean, square = sums[1] / total, sums[2] / total
    sd = np.sqrt(square - mean**2)
    errors = np.stack([np.sqrt(sums[4]) / total, np.sqrt(sums[5]) / total / 2], axis=-1)
    return np.stack([mean, sd - 1], axis=-1), errors, float(total[0] ** 2 / sums[3][0])


def _contacts(
    observer: Any, reading: Array, tops: Array, count: int, rng: np.random.Generator
) -> Array:
    """Contacts (count, U) from the prior, angles between 0 and the second of `tops`."""
    cue = observer.cue
    contact = np.empty((count, len(cue.unknowns)))
    contact[:, 0] = rng.random(count) * cue.farthest(observer.whisker)
    if contact.shape[1] > 1:
        contact[:, 1] = rng.random(count) * tops[1]
    for i, name in enumerate(cue.unknowns[2:], start=2):
        contact[:, i] = observer.prior[name].rvs(count, random_state=rng)
        if name == "azimuth":  # in the turn about the direction read
            first = reading[list(cue.circular).index(True)]
            contact[:, i] -= 2 * np.pi * np.round((contact[:, i] - first) / (2 * np.pi))
    return contact


def main() -> None:
    """Print a row for each unknown of each reading checked."""
    parser = argparse.ArgumentParser(
        description=inspect.cleandoc(__doc__ or ""),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("table", type=Path, nargs="?", default=TABLE)
    parser.add_argument("--each", type=int, default=2, help="readings of each kind; by default 2")
    parser.add_argument("--draws", type=int, default=20_000_000, help="by default 20 million")
    parser.add_argument("--seed", type=int, default=1, help="by default 1")
    given = parser.parse_args()
    with given.table.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    kinds: dict[str, list[dict[str, str]]] = {}
    for row in rows:
        kinds.setdefault(row["kind"], []).append(row)

    def noise(row: dict[str, str]) -> float:
        groups = json.loads(row["observer"])["noise"]
        return float(min(k for group in groups for k in group["k"] if k > 0))

    print("index, kind, unknown: off in mean, in sd (over the sd) | over standard errors | draws")
    for own in kinds.values():
        for row in sorted(own, key=noise)[-given.each :]:
            off, error, size = drawn(row, given.draws, given.seed)
            for name, o, e in zip(json.loads(row["truth"]), off, error, strict=True):
                print(
                    f"{row['index']} {row['kind']}, {name}: {o[0]:+.1e} {o[1]:+.1e} | "
                    f"{o[0] / e[0]:+.1f} {o[1] / e[1]:+.1f} | {size:.2g}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
