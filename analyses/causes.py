"""Do fits name the right cause of a misfit, and what does the cause do to the Weber fraction?

Observers are simulated with each cause, with pairs of causes and with none; each table is fitted as
a user would, without effects, and again with the cause that made it ("told"). What is reported to a
user is k with the cause that was found where a check fires, and else without; `right` looks for
causes whether one fires or not. Writes `causes.csv`, a row a fit, and `causes.md`; resumes. Run
``python analyses/causes.py``; `--short` is two observers a row.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import weberwhisk as ww
from weberwhisk.behaviour import States
from weberwhisk.behaviour import effects as of

HERE = Path(__file__).parent
SIZES = (400, 1500)
#: Three standards that take turns between the intervals, in six sessions, and some lapses.
DESIGN: dict[str, Any] = {
    "standards": [1.0, 1.5, 2.25], "order": "random", "sessions": 6,
    "offsets": [-0.35, -0.25, -0.15, -0.05, 0.05, 0.15, 0.25, 0.35], "lapse_low": 0.02,
    "lapse_high": 0.02,
}  # fmt: skip
#: Comparisons far from their standards: what differs between the intervals shows there alone.
WIDE: dict[str, Any] = {"offsets": [-0.75, -0.55, -0.35, -0.15, 0.15, 0.5, 1.0, 2.0]}


@dataclass(frozen=True)
class Kind:
    """Observers of one kind: what `simulate_trials` takes, and the name that is right.

    `accepted` are other names for what cannot be told from it in this design.
    """

    name: str
    given: dict[str, Any] = field(default_factory=dict)
    fitted: dict[str, Any] = field(default_factory=dict)
    accepted: tuple[str, ...] = ()
    weber_fraction: float = 0.15


def _one(name: str, effect: of.Effect, value: float, **more: Any) -> Kind:
    given = {"effects": [(effect, value)]} | more.pop("given", {})
    return Kind(name, given, {"effects": [effect]}, **more)


KINDS = [
    Kind("none"),
    _one("contraction", of.Contraction(), 0.3),
    _one("exponent", of.Exponent(), 2.0, accepted=("floor",)),
    Kind("constant noise", {"noise": "constant"}, {"noise": "constant"}),
    _one("noise_by_order", of.NoiseByOrder(), -1.5, given=WIDE, weber_fraction=0.3),
    _one("standard_second", of.StandardSecond(), 0.7),
    _one("history", of.History(), 0.5),
    _one("win_stay", of.WinStay(), 0.5),
    _one("drift", of.Drift(), -1.2),
    _one("session_bias", of.SessionBias(), 0.6),
    _one("bias_drift", of.BiasDrift(), 1.5, accepted=("session_bias",)),
    _one("overdispersion", of.Overdispersion(), 0.15),
    Kind("states=3", {"states": States(engaged=0.7)}, {"states": 3}, ("states=2",)),
]
PAIRS = [
    ("contraction", "session_bias"), ("contraction", "history"), ("exponent", "session_bias"),
    ("history", "drift"), ("standard_second", "session_bias"), ("contraction", "exponent"),
]  # fmt: skip


def both(first: str, second: str) -> Kind:
    """Observers with two causes."""
    kinds = [next(k for k in KINDS if k.name == name) for name in (first, second)]
    given = [pair for k in kinds for pair in k.given["effects"]]
    effects = [effect for effect, _ in given]
    return Kind(f"{first} + {second}", {"effects": given}, {"effects": effects})


def fitted(kind: Kind, size: int, seed: int) -> dict[str, Any]:
    """One observer: what its fit says, and k with the cause found and with the cause given."""
    design = DESIGN | {"weber_fraction": kind.weber_fraction} | kind.given
    cells = len(design["standards"]) * len(design["offsets"])
    per_level = -(-size // cells)
    trials = ww.simulate_trials(**design, trials_per_level=per_level, seed=seed)
    frame = trials.frame.iloc[:size].drop(columns=["n", "state"], errors="ignore")
    trials = ww.read_trials(frame.rename(columns={"count": "choice"}))
    start = time.process_time()
    fit = ww.fit_weber(trials)
    status = fit.status
    seconds = time.process_time() - start
    seen = fit.unweighed.is_misfit
    # Of observers without a cause those are named that a check makes known.
    best = fit.search.chosen if seen or kind.given else None
    known = ww.fit_weber(trials, **kind.fitted) if kind.fitted else fit
    with_cause = fit if best is None else best.fit
    names = set() if best is None else {cause.name for cause in best.causes}
    return {
        "kind": kind.name, "trials": size, "seed": seed, "status": status.name,
        "seen": seen, "named": best.name if seen and best is not None else "",
        "found": " + ".join(sorted(names)), "right": _is_right(kind, names),
        "plain": fit.weber_fraction, "with_cause": with_cause.weber_fraction,
        "known": known.weber_fraction, "truth": kind.weber_fraction, "seconds": seconds,
    }  # fmt: skip


def _is_right(kind: Kind, names: set[str]) -> bool:
    """Whether the causes found are those that made the answers, and no others."""
    if kind.name == "none":
        return not names
    parts = kind.name.split(" + ")
    if len(parts) > 1:
        return names == {*parts}
    return names == {kind.name} or any(names == {other} for other in kind.accepted)


def table(fits: pd.DataFrame) -> pd.DataFrame:
    """A row for each kind and size."""
    rows = []
    for (kind, size), group in fits.groupby(["kind", "trials"], sort=False):
        reported = group["with_cause"].where(group["seen"], group["plain"])
        k = {"plain": group["plain"], "reported": reported, "told": group["known"]}
        off = {name: np.log(values / group["truth"]) for name, values in k.items()}
        rms = {n: float(np.sqrt((o**2).mean())) for n, o in off.items()}
        rows.append(
            {
                "kind": kind, "trials": size, "observers": len(group),
                "a check fires": group["seen"].mean(), "named": (group["named"] != "").mean(),
                "right": group["right"].mean(),
                "misfit": group["status"].str.startswith("MISFIT").mean(),
                "RMSE plain": rms["plain"], "RMSE reported": rms["reported"],
                "RMSE told": rms["told"], "ratio": rms["reported"] / rms["told"],
                "CPU s": group["seconds"].median(), "most CPU s": group["seconds"].max(),
            }
        )  # fmt: skip
    return pd.DataFrame(rows)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--short", action="store_true")
    parser.add_argument("--observers", type=int, default=20)
    parser.add_argument("--plain", type=int, default=100)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--out", type=Path, default=HERE)
    options = parser.parse_args(arguments)
    kinds = [*KINDS, *(both(*pair) for pair in PAIRS)]
    counts = {kind.name: 2 if options.short else options.observers for kind in kinds}
    counts["none"] = 2 if options.short else options.plain
    path = options.out / "causes.csv"
    fits = pd.read_csv(path, keep_default_na=False) if path.exists() else pd.DataFrame()
    done = {*map(tuple, fits[["kind", "trials", "seed"]].to_numpy().tolist())} if len(fits) else {}
    work = [
        (kind, size, seed)
        for seed in range(max(counts.values()))
        for size in SIZES[::-1]
        for kind in kinds
        if seed < counts[kind.name] and (kind.name, size, seed) not in done
    ]
    with ProcessPoolExecutor(options.workers) as pool:
        for row in pool.map(fitted, *zip(*work, strict=True)) if work else ():
            fits = pd.concat([fits, pd.DataFrame([row])], ignore_index=True)
            fits.to_csv(path, index=False, float_format="%.5g")
    made = table(fits.sort_values("trials", kind="stable"))
    (options.out / "causes.md").write_text(_page(made))
    print(made.round(3).to_string())


def _page(made: pd.DataFrame) -> str:
    lines = [" | ".join(map(str, made.columns)), " | ".join("---" for _ in made.columns)]
    for row in made.itertuples(index=False):
        cells = [f"{v:.2f}" if isinstance(v, float) else str(v) for v in row]
        lines.append(" | ".join(cells))
    text = "\n".join(f"| {line} |" for line in lines)
    return f"# Causes named, and what they do to k\n\n{__doc__}\n{text}\n"


if __name__ == "__main__":
    main()
