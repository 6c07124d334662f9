"""The package's posteriors beside the kept truth: how many are off, and how many silently.

    python analyses/accuracy/compare.py [table] [--tolerance 1e-2] [--twice]

Prints a row for each kind of observer and one for all: readings, how many are flagged (any status
but converged), how many are silently beyond the bars, the largest silent error of mean and sd and
of the ends of the 95 % interval, over the sd, and ms a reading. Below are the worst cases.

The bars are 2e-3 sd for mean and sd and 1e-2 sd for the ends of intervals, or three times the error
that is claimed. The ms are of an observer's first reading, with all that is worked out once for it;
`--twice` asks again and counts that. Rows whose truth is itself off by more than a fifth of the bar
are left out.
"""

from __future__ import annotations

import argparse
import csv
import inspect
import json
import time
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from cases import observer_of

import weberwhisk as ww

TABLE = Path(__file__).with_name("truth.csv")
MOMENTS, ENDS = 2e-3, 1e-2


def compared(row: dict[str, str], **how: Any) -> dict[str, Any]:
    """One reading's posterior beside the truth.

    Parameters
    ----------
    row : dict
        A line of the table.
    **how
        As `weberwhisk.posterior` takes it.

    Returns
    -------
    dict
        Errors over the sd, the same over the bar, the status and the time.
    """
    observer, truth = observer_of(json.loads(row["observer"])), json.loads(row["truth"])
    reading = np.array(json.loads(row["reading"]))
    start = time.perf_counter()
    found = ww.posterior(observer, reading, **how)
    took = time.perf_counter() - start
    return {
        "index": int(row["index"]), "kind": row["kind"], "edge": row["edge"],
        "silent": found.status == ww.inference.Status.CONVERGED, "status": found.status.name,
        "ms": 1e3 * took, **off(found, truth, MOMENTS, ENDS),
    }  # fmt: skip


def off(
    found: ww.Posterior, truth: Mapping[str, Iterable[float]], moments: float, ends: float
) -> dict[str, float]:
    """The largest errors of a posterior over the sd, of mean and sd and of ends of the interval,
    and over the bar: these, or three times the error claimed."""
    worst = {"moments": 0.0, "ends": 0.0, "bar": 0.0}
    for name, (mean, sd, *exact) in truth.items():
        one = found.estimates[name]
        turn = 2 * np.pi * np.round((one.mean - mean) / (2 * np.pi)) if name == "azimuth" else 0.0
        interval = found.interval(0.95, of=name) - turn
        apart = np.abs(np.array([one.mean - turn - mean, one.sd - sd])) / sd
        claims = np.array([one.mean_error, one.sd_error]) / sd
        apart_ends = np.abs(interval - exact) / sd
        claims_ends = np.nan_to_num(found.quantile_error([0.025, 0.975], of=name)) / sd
        shares = np.r_[
            apart / np.maximum(moments, 3 * claims), apart_ends / np.maximum(ends, 3 * claims_ends)
        ]
        largest = apart.max(), apart_ends.max(), np.nan_to_num(shares, nan=np.inf).max()
        for key, value in zip(worst, largest, strict=True):
            worst[key] = max(worst[key], float(value))
    return worst


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """A row for each kind, and one for all."""
    rows = []
    for kind, own in [*table.groupby("kind", sort=False), ("all", table)]:
        silent = own[own.silent]
        rows.append(
            {
                "kind": kind,
                "readings": len(own),
                "flagged": int((~own.silent).sum()),
                "silently beyond": int((silent.bar > 1).sum()),
                "worst mean, sd": silent.moments.max(),
                "worst end": silent.ends.max(),
                "ms": own.ms.median(),
                "ms, mean": own.ms.mean(),
            }
        )
    return pd.DataFrame(rows)


def main() -> None:
    """Print the comparison."""
    parser = argparse.ArgumentParser(
        description=inspect.cleandoc(__doc__ or ""),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("table", type=Path, nargs="?", default=TABLE)
    parser.add_argument("--method", default="quadrature", help="by default quadrature")
    parser.add_argument("--tolerance", type=float, help="by default the method's")
    parser.add_argument("--twice", action="store_true", help="time the second look")
    parser.add_argument("--kind", action="append", help="of which alone; may be said again")
    parser.add_argument("--write", type=Path, help="a CSV file for what is found of each reading")
    given = parser.parse_args()
    with given.table.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    if not rows:
        parser.error(f"no reading is in {given.table}; write the table of truth.py")
    kinds = list(dict.fromkeys(row["kind"] for row in rows))
    for kind in given.kind or ():
        if kind not in kinds:
            parser.error(f"no reading is of the kind {kind!r}; write one of {kinds}")
    rows = [row for row in rows if not given.kind or row["kind"] in given.kind]
    sure = [
        row for row in rows
        if float(row["truth_error"]) < MOMENTS / 5 and float(row["quantile_error"]) < ENDS / 5
    ]  # fmt: skip
    how = {"method": given.method, "tolerance": given.tolerance}
    found = []
    for row in sure:
        if given.twice:
            compared(row, **how)
        found.append(compared(row, **how))
    table = pd.DataFrame(found)
    if given.write:
        table.to_csv(given.write, index=False)
    print(summary(table).to_string(index=False, float_format="{:.3g}".format))
    if len(sure) < len(rows):
        print(f"\n{len(rows) - len(sure)} readings are left out: their truth is not good enough.")
    worst = table[table.bar > 1].sort_values("bar", ascending=False)
    if len(worst):
        print("\nBeyond the bars (`bar` is how many times):")
        print(worst.to_string(index=False, float_format="{:.3g}".format))


if __name__ == "__main__":
    main()
