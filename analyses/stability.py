"""Stability atlas: where every model, engine, JND and fit is right, warns, refuses, or is wrong.

    python analyses/stability.py [--short] [--seed N] [--only DOMAIN] [folder]

Inside the package's domain (`weberwhisk.domain`) a search (`fault_search.py`) looks for answers
that are wrong and not flagged; outside, for answers without the flag. Each is judged by a reference
that shares nothing with what is judged: SciPy's DOP853 in raw SI for models and JNDs
(`reference_beam`, `reference_rod`), sums over plain grids for posteriors and fits. Writes stability
(CSV: a row for each domain, with what became of its cases; PNG, SVG: maps of all cases) and
stability_cases (CSV: all cases, which replay what is found). With `--only` some domains are
searched and drawn, and the rest of stability is the kept table's. Cases are kept in `parts` as each
domain is done, and taken from there by the next run into the same folder: remove it where the
package has changed. Two runs, each `--only` some, fill two cores, and a third puts all together.
"""

from __future__ import annotations

import os
import pickle
import warnings

os.environ.setdefault("OMP_NUM_THREADS", "1")

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import stability_choices
import stability_outside
import stability_populations
import stability_posteriors
import stability_rungs
import stability_space
import stability_walkers
import stability_whiskers
from command import options
from fault_search import Domain, Fate, search, silent
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from weberwhisk import plots
from weberwhisk._util.output import Run, atomic_write

HERE = Path(__file__).parent
SEED = 20110166
#: Observers of two unknowns or three: a case costs a tenth of a second, by emcee near one.
TWO = (
    "force map",
    "cylinder's ridge",
    "three forces",
    "correlated map",
    "axial force dominates",
    "velocity felt",
    "angle-side-angle",
    "balance of moments",
    "tap and map fused",
    "map and vibration fused",
    "map, stiffness unknown",
    "log-normal map, stiffness unknown",
    "angle-side-angle, side unknown",
)
SAMPLED = (
    "compliance",
    "vibration",
    "vibration, phase",
    "floor and ceiling",
    "log-normal",
    "force map",
    "cylinder's ridge",
    "velocity felt",
    "angle-side-angle",
    "map, stiffness unknown",
    "log-normal map, stiffness unknown",
    "angle-side-angle, side unknown",
)
#: Cues of which also readings are tried that no contact explains.
ODD = ("compliance", "vibration", "vibration, phase", "two taps fused", "force map")
COLOURS = {
    Fate.RIGHT: "#0072B2",
    Fate.WARNED: "#E69F00",
    Fate.REFUSED: "0.75",
    Fate.UNJUDGED: "#CC79A7",
    Fate.SILENT: "#000000",
}


def domains() -> list[tuple[Domain, str, str, str, int]]:
    """Each domain, the panel that it is shown in, its two axes there, and a share of the effort."""
    found = [
        (d, d.name, "distance", "push", 6)
        for d in (*stability_rungs.DOMAINS, stability_choices.DOMAINS[0])
    ]
    for d in (*stability_choices.DOMAINS[1:], *stability_populations.DOMAINS):
        effort = 1 if "emcee" in d.name or "population" in d.name else 2
        found.append((d, "fits of choices", "weber_fraction", "trials", effort))
    for d in stability_walkers.DOMAINS:
        found.append((d, "emcee, started badly", "distance", "k", 2))
    for method in ("quadrature", "laplace", "emcee"):
        for name in SAMPLED if method == "emcee" else stability_posteriors.OBSERVERS:
            two = name in TWO
            effort = (2 if two else 6) if method != "emcee" else (1 if two else 2)
            panel = f"{method}, {'several unknowns' if two else 'one unknown'}"
            d = stability_posteriors.searched(name, method)
            found.append((d, panel, "distance", "k", effort))
            if name in ODD and method != "laplace":
                d = stability_posteriors.searched(name, method, odd=True)
                found.append((d, panel, "distance", "k", 1))
    # Last, though a model: a domain's seed goes by its place, and kept ones stay what they were.
    found += [(d, d.name, "distance", "push", 6) for d in stability_space.DOMAINS]
    found += [(d, "outside the domain", "x", "y", 4) for d in stability_outside.DOMAINS]
    several = "quadrature, several unknowns"
    for d, effort in zip(stability_whiskers.DOMAINS, (4, 4, 1, 1, 1), strict=True):
        found.append((d, several, "distance", "weber_fraction", effort))
    return found


def run_all(
    size: int, generations: int, seed: int, only: Sequence[str], parts: Path
) -> pd.DataFrame:
    """All cases of all domains, or of some, `size` times a domain's effort of each kind."""
    tables = []
    parts.mkdir(parents=True, exist_ok=True)
    for i, (d, panel, x, y, effort) in enumerate(domains()):
        if only and d.name not in only:
            continue
        panel = d.name if only else panel
        part = parts / f"{d.name}, {size}, {generations}, {seed + i}.pkl"
        if part.exists():
            found = pd.read_pickle(part)
        else:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of the references, past the ends of what exists
                found = search(d, size * effort, generations, seed + i)
            atomic_write(part, pickle.dumps(found))
        tables.append(found.assign(panel=panel, across=found[x], up=found[y]))
        print(f"{d.name}: {len(found)} cases, {len(silent(found))} wrong in silence", flush=True)
    return pd.concat(tables, ignore_index=True)


def summary(cases: pd.DataFrame) -> pd.DataFrame:
    """A row for each domain: how many cases met which fate, and the worst excess."""
    counts = cases.groupby(["domain", "fate"], sort=False).size().unstack(fill_value=0)
    counts = counts.reindex(columns=[int(f) for f in Fate], fill_value=0)
    counts.columns = [f.name.lower() for f in Fate]
    judged = cases[np.isfinite(cases["excess"])]
    counts["worst_over_admitted"] = np.exp(judged.groupby("domain")["excess"].max())
    counts["seed"] = cases.groupby("domain")["seed"].first()
    return counts.reset_index()


def conclusions(counts: pd.DataFrame) -> list[str]:
    """Three sentences of a summary: what is silently wrong, what says that it fails, what is right.

    By method, of the cases inside the domain.
    """
    method = counts["domain"].str.split(",").str[0]
    sums = counts.groupby(method, sort=False)[["right", "warned", "refused", "silent"]].sum()
    sums = sums.drop([name for name in sums.index if name.endswith("outside")])
    share = sums["right"] / sums.sum(axis=1)
    wrong = counts[counts["silent"] > 0]
    silently = [f"{n} of {d}" for d, n in zip(wrong["domain"], wrong["silent"], strict=True)]
    fails = [f"{name} {1 - s:.0%}" for name, s in share[share < 2 / 3].sort_values().items()]
    holds = [f"{name} {s:.0%}" for name, s in share[share >= 2 / 3].sort_values().items()]
    return [
        f"Wrong without saying so: {'; '.join(silently) or 'none'} of {int(sums.to_numpy().sum())} "
        "cases that a search for such made.",
        f"Flagged or refused in more than a third: {', '.join(fails) or 'none'}.",
        f"Right in all but those that say so: {', '.join(holds) or 'none'}.",
    ]


def _map(ax: Axes, cases: pd.DataFrame, title: str) -> None:
    for fate in (Fate.REFUSED, Fate.UNJUDGED, Fate.RIGHT, Fate.WARNED, Fate.SILENT):
        some = cases[cases["fate"] == fate]
        ax.plot(
            some["across"],
            some["up"],
            "X" if fate == Fate.SILENT else ".",
            color=COLOURS[fate],
            markersize=5 if fate == Fate.SILENT else 1.8,
            label=fate.words,
        )
    ax.set(xlabel="distance / reach", ylabel="push / last angle")
    for words in (", ", "JND by ", "whiskers in "):
        title = title.replace(words, words.rstrip() + "\n", 1)
    ax.set_title(title, fontsize=7)
    if any(word in title for word in ("unknown", "emcee", "whisker", "uncertain")):
        ax.set(yscale="log", ylabel="Weber fraction k")
    if title.startswith("outside"):
        ax.set(xscale="log", xlabel="outside by (ln)", ylabel="")
        ax.set_yticks(range(len(stability_outside.KINDS)), stability_outside.KINDS)
    elif not title.startswith("fit"):
        ax.set_xticks([0, 1])
    else:
        ax.set(xscale="log", yscale="log", xlabel="Weber fraction", ylabel="trials a level")


@plots.styled
def draw(cases: pd.DataFrame) -> Figure:
    """A map for each model and engine."""
    panels = list(cases["panel"].unique())
    rows = -(-len(panels) // 4)
    figure = plots.new_figure(plots.DOUBLE, 0.4 + 1.9 * rows)
    axes = figure.subplots(rows, 4, squeeze=False).ravel()
    for ax in axes[len(panels) :]:
        ax.axis("off")
    for ax, panel in zip(axes, panels, strict=False):
        _map(ax, cases[cases["panel"] == panel], panel)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, markerscale=2)
    return figure


def make(
    folder: Path, *, short: bool = False, seed: int = SEED, only: Sequence[str] = ()
) -> pd.DataFrame:
    """Tables and figure into `folder`."""
    cases = run_all(*((1, 1) if short else (6, 3)), seed, only, folder / "parts")
    counts = summary(cases)
    if only:
        kept = pd.read_csv(HERE / "figures/stability.csv")
        counts = pd.concat([kept[~kept["domain"].isin(counts["domain"])], counts])
    with Run(folder, "stability", {"short": short, "only": list(only)}, seed) as run:
        run.table("stability", counts)
        run.table("stability_cases", cases.drop(columns=["across", "up"]))
        run.figure("stability", draw(cases))
    return cases


if __name__ == "__main__":
    names = [d.name for d, *_ in domains()]
    given = options(__file__, __doc__, short="few cases", seed=SEED, parts=names)
    made = make(given.folder, short=given.short, seed=given.seed, only=given.only)
    counts = summary(made)
    print(*conclusions(counts), sep="\n")
    print(counts.to_string(index=False, float_format="{:.3g}".format))
    wrong = silent(made).dropna(axis=1, how="all")
    print("Wrong in silence:", "none." if wrong.empty else f"\n{wrong.head(20).to_string()}")
    print(f"Written to {given.folder}.")
