"""What the test of Weber's law says of observers who obey it, and of some who do not.

    python analyses/weber_law.py [folder] [--short] [--sets N]

Writes `weber_law.csv` and `weber_law.md` into this folder, or the one named; observers that the
table has are not tested again, and each kind has as many before any has more. Observers compare
durations about three standards; noise is a power of the duration (exponent 1 obeys), or has a
floor; the first duration is drawn towards the mean of all by contraction, and answers are lost.
"""

from __future__ import annotations

import sys
import time
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import ndtr

sys.path.insert(0, str(Path(__file__).parent))
from command import markdown_table, options, resumed

from weberwhisk import fit_weber
from weberwhisk.behaviour import Trials, read_trials, weber_law_test

STANDARDS = np.array([300.0, 600.0, 1200.0])
K, TYPICAL = 0.12, 600.0


def observer(
    seed: int, n: int, exponent: float, floor: float, contraction: float, lapse: float
) -> Trials:
    """Choices of one observer: which of two durations was the longer?"""
    rng = np.random.default_rng(seed)
    standard = rng.choice(STANDARDS, n)
    comparison = standard * np.exp(rng.choice([-0.5, -0.3, -0.15, 0.15, 0.3, 0.5], n))
    first = rng.random(n) < 0.5
    s1, s2 = np.where(first, [standard, comparison], [comparison, standard])
    sd_1, sd_2 = (np.hypot(K * s * (s / TYPICAL) ** (exponent - 1), floor) for s in (s1, s2))
    remembered = s1 + contraction * (standard.mean() - s1)
    p = lapse + (1 - 2 * lapse) * ndtr((s2 - remembered) / np.hypot(sd_1, sd_2))
    table = {"standard": standard, "stimulus_1": s1, "stimulus_2": s2}
    answers = {"choice": (rng.random(n) < p).astype(int)}
    return read_trials(pd.DataFrame(table | answers), in_order=True)


def _kinds() -> list[dict[str, Any]]:
    kinds: list[dict[str, Any]] = [
        {"exponent": 1.0, "floor": 0.0, "contraction": c, "lapse": lapse, "n": n}
        for n, c, lapse in product((360, 1080), (0.0, 0.5, 1.0, 1.5), (0.0, 0.02, 0.1))
    ]
    departing = [(e, 0.0) for e in (0.5, 1.5, 2.0)] + [(1.0, 30.0), (1.0, 60.0)]
    kinds += [
        {"exponent": e, "floor": floor, "contraction": c, "lapse": 0.02, "n": 1080}
        for (e, floor), c in product(departing, (0.0, 0.5))
    ]
    return kinds


KINDS = _kinds()
WHICH = {tuple(kind.values()): number for number, kind in enumerate(KINDS)}  # for their seeds


def observers(short: bool) -> list[dict[str, Any]]:
    """What the observers are, a dictionary each."""
    return KINDS[::6] if short else KINDS


def tested(number: int, **kind: Any) -> dict[str, Any]:
    """What the test says of one observer: NaN where it says nothing."""
    start = time.process_time()
    test = weber_law_test(fit_weber(observer(1000 * number + WHICH[tuple(kind.values())], **kind)))
    silent = test.verdict.startswith("nothing")
    return kind | {
        "number": number,
        "log_bayes_factor": np.nan if silent else test.log_bayes_factor,
        "least_shown": test.least_shown,
        "cpu_s": time.process_time() - start,
    }


def main() -> None:
    """The observers that the table lacks, and what the test said of all."""
    asked = options(
        __file__, __doc__, folder=Path(__file__).parent, short="few observers, two each", sets=25
    )
    asked.folder.mkdir(parents=True, exist_ok=True)
    kinds, sets = observers(asked.short), 2 if asked.short else asked.sets
    designs = [kind | {"number": number} for number in range(sets) for kind in kinds]
    rows = resumed(asked.folder / "weber_law.csv", tested, designs)
    (asked.folder / "weber_law.md").write_text(page(summary(rows)), "utf-8")


def summary(rows: pd.DataFrame) -> pd.DataFrame:
    """A row a kind of observers."""
    kinds = rows.groupby(list(KINDS[0]), sort=False)
    factor = kinds["log_bayes_factor"]
    return pd.DataFrame({
        "tables": kinds.size(),
        "decisive_against": factor.agg(lambda f: np.mean(f < -np.log(100))),
        "strong_against": factor.agg(lambda f: np.mean(f < -np.log(10))),
        "some_for": factor.agg(lambda f: np.mean(f > np.log(3))),
        "nothing_said": factor.agg(lambda f: np.mean(np.isnan(f))),
        "least_shown": kinds["least_shown"].median(),
        "cpu_s": kinds["cpu_s"].mean(),
    }).reset_index()  # fmt: skip


def page(table: pd.DataFrame) -> str:
    """The table in words."""
    obey = table[(table["exponent"] == 1) & (table["floor"] == 0)]
    against = float(np.average(obey["decisive_against"], weights=obey["tables"]))
    percent = ["decisive_against", "strong_against", "some_for", "nothing_said"]
    shown = table.assign(**{name: (100 * table[name]).round(1) for name in percent}).round(2)
    return "\n".join(
        [
            "# The test of Weber's law: how often it errs, and what it finds",
            "",
            "Made by `weber_law.py`. Shares of tables are in per cent; `least_shown` is the",
            "departure of the exponent from 1 that the tables would show with strong evidence one",
            "time in two, the median over tables (inf: none); `floor` is in ms.",
            "",
            f"Of {int(obey['tables'].sum())} observers who obey, with contraction of 0 to 1.5 and",
            f"lapses of 0 to 10 %, {100 * against:.1f} % are said decisively to break the law.",
            "",
            markdown_table(
                list(shown.columns), [[f"{v:g}" for v in row] for row in shown.to_numpy()]
            ),
            "",
        ]
    )


if __name__ == "__main__":
    main()
