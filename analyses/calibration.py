"""Simulation-based calibration of every cue's posterior, of the engines and of the fits.

    python analyses/calibration.py [--short] [folder] [--workers 2] [--scheduler tcp://...]
    python analyses/calibration.py --draw analyses/figures/calibration.csv [folder]

Truths are drawn from the observer's own prior, readings from `observer.read` (trials from
`simulate_trials`), and the rank of each truth among draws from its posterior must be uniform
(Talts et al. 2018, arXiv 1804.06788), and so must that of its likelihood, which also catches a
posterior that has not looked at the data (Modrák et al. 2023, Bayesian Analysis). Uniform means:
the ECDF stays within simultaneous bands (Säilynoja, Bürkner & Vehtari 2022, Statistics and
Computing 32, 32). The broken models at the end must be caught by the same test. Writes calibration
(CSV, PNG, SVG): ranks' p-values and coverage at 50, 80 and 95 %; `--draw` draws such a table. What
is done is kept beside it (JSON lines), from where the next run into the same folder goes on: remove
it where the package has changed.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from command import options
from matplotlib.figure import Figure
from scipy import stats

import weberwhisk as ww
from weberwhisk import Observer, Status, Whisker, campaign, plots
from weberwhisk._util.output import Run
from weberwhisk.behaviour import Priors, fit_weber, simulate_trials
from weberwhisk.cues import (
    AngleSideAngle,
    BalanceOfMoments,
    ComparativeLength,
    Compliance,
    ContactAndDetachment,
    ForceMap,
    Friction,
    Fused,
    SpaceMap,
    TwoWhiskers,
    UnknownCurvature,
    UnknownStiffness,
    Vibration,
    VibrissaLength,
)
from weberwhisk.cues.force_map import SIGNALS
from weberwhisk.receptors import (
    Afferents,
    GeneralisedWeber,
    LogNormal,
    Saturating,
    SpikeCount,
    Weber,
)
from weberwhisk.sensitivity import prior_draws

Array = np.ndarray
HERE = Path(__file__).parent
SEED = 20110166
#: Draws that a truth is ranked among.
DRAWS = 199
MASSES = (0.5, 0.8, 0.95)

WHISKER = Whisker(50e-3, 100e-6, 5e-6, 3e9)
UNIT = float(WHISKER.compliance_constant / WHISKER.length)
CUES: dict[str, Observer] = {
    name: Observer(WHISKER, cue)
    for name, cue in {
        "vibrissa length (a)": VibrissaLength(),
        "comparative length (b)": ComparativeLength([40e-3, 30e-3], [[0.0, 3e-3], [0.0, 6e-3]]),
        "angle-side-angle (c)": AngleSideAngle(),
        "the same, side unknown (c)": AngleSideAngle(side_sd=1e-3),
        "two whiskers (c)": TwoWhiskers(side=10e-3),
        "contact and detachment (c)": ContactAndDetachment(side=8e-3),
        "vibration (d)": Vibration(3),
        "vibration with phase (d)": Vibration(3, phase=True),
        "compliance (e)": Compliance(),
        "compliance, velocity felt (e)": Compliance(velocity_spread=0.5),
        "force map (f)": ForceMap(),
        "force map, three signals (f)": ForceMap(SIGNALS),
        "moment at a known angle (f)": ForceMap("moment", deflection_angle=0.1),
        "force map, stiffness unknown": UnknownStiffness(ForceMap()),
        "map in space (g)": SpaceMap(),
        "balance of moments (h)": BalanceOfMoments(),
        "balance, effort known (h)": BalanceOfMoments(effort=0.5),
        "compliance and vibration": Fused(Compliance(), Vibration(3, phase=True)),
    }.items()
}
#: Observers of real whiskers, made when they are asked for: each makes a table.
REAL: dict[str, Callable[[], Observer]] = {
    "force map, concave whisker": lambda: Observer(replace(WHISKER, curvature=-12.0), ForceMap()),
    "force map, convex whisker": lambda: Observer(replace(WHISKER, curvature=8.0), ForceMap()),
    "force map, rubbing": lambda: Observer(WHISKER, Friction(ForceMap(), angle=np.radians(15.0))),
    "force map, friction unknown": lambda: Observer(WHISKER, Friction(ForceMap())),
    "force map, curvature uncertain": lambda: Observer(
        replace(WHISKER, curvature=8.0), UnknownCurvature(ForceMap(), 2.0)
    ),
    "map in space, curved whisker": lambda: Observer(replace(WHISKER, curvature=8.0), SpaceMap()),
}
RECEPTORS: dict[str, Observer] = {
    "Weber, k = 0.5": Observer(WHISKER, Compliance(), Weber(0.5)),
    "floor and ceiling": Observer(
        WHISKER, Compliance(), GeneralisedWeber(0.1, floor=0.5 * UNIT, ceiling=5 * UNIT)
    ),
    "saturating": Observer(WHISKER, Compliance(), Saturating(0.1, ceiling=2 * UNIT)),
    "log-normal": Observer(WHISKER, Compliance(), LogNormal(0.2)),
    "spike counts": Observer(
        WHISKER, Compliance(), SpikeCount(Afferents(12, 0.1 * UNIT, 10 * UNIT))
    ),
    "correlated": Observer(WHISKER, ForceMap(), Weber([0.1, 0.2], correlation=0.7)),
}


# -- uniform or not -------------------------------------------------------------------------------


def _depth(ranks: Array, points: Array) -> Array:
    """γ of each row of ranks in (0, 1): the least two-sided binomial tail of its ECDF."""
    n = ranks.shape[-1]
    ordered = np.sort(ranks, axis=-1)
    count = np.stack([np.searchsorted(row, points, side="right") for row in ordered])
    below, above = stats.binom.cdf(count, n, points), stats.binom.sf(count - 1, n, points)
    return np.asarray(2 * np.minimum(below, above).min(axis=-1))


def _points(n: int) -> Array:
    """Where the ECDF of n ranks is looked at."""
    size = min(n, 100)
    return np.arange(1, size) / size


@lru_cache(maxsize=64)
def _depths(n: int) -> Array:
    """γ of 4000 sets of n uniform ranks, ascending: Säilynoja et al.'s algorithm 1."""
    rng = np.random.default_rng(SEED)
    return np.sort(np.concatenate([_depth(rng.random((200, n)), _points(n)) for _ in range(20)]))


def uniform_p(ranks: Array) -> float:
    """How often uniform ranks stray as far from the diagonal as these; p of the band's test."""
    depths = _depths(ranks.size)
    return float(1 + (depths <= _depth(ranks[None], _points(ranks.size))[0]).sum()) / 4001


# -- ranks of posteriors --------------------------------------------------------------------------


def rank(truth: Array, draws: Array, rng: np.random.Generator) -> Array:
    """Ranks in (0, 1) of truths (n,) among draws (n, D), ties broken at random."""
    below = (draws < truth[:, None]).sum(axis=1)
    level = (draws == truth[:, None]).sum(axis=1)
    return np.asarray((below + rng.random(truth.size) * (level + 1)) / (draws.shape[1] + 1))


def posterior_ranks(
    truth: Observer,
    n: int,
    method: str = "quadrature",
    *,
    assumed: Observer | None = None,
    seed: int = SEED,
) -> tuple[dict[str, Array], float]:
    """Ranks of every unknown and of the likelihood, of posteriors not flagged; share flagged.

    `assumed` reads, where it is not `truth` itself that does. A status depends on the reading and
    the walkers alone, so that those without one must be calibrated among themselves.
    """
    rng = np.random.default_rng(seed)
    model = assumed or truth
    contact = prior_draws(truth, n, rng)
    reading = truth.read(contact, rng)
    p = ww.posterior(model, reading, method, seed=rng)
    trusted = np.isin(p.status, (Status.CONVERGED, Status.UNIDENTIFIED, Status.IMPROBABLE_READING))
    # Enough draws of every chain to be far apart from each other, and of them some.
    draws = p.solution.draws(64 if method == "quadrature" else 128, rng)
    draws = draws.reshape(n, -1, draws.shape[-1])
    some = rng.permuted(np.tile(np.arange(draws.shape[1]), (n, 1)), axis=1)[:, :DRAWS]
    draws = np.take_along_axis(draws, some[..., None], axis=1)
    out = {
        name: rank(contact[:, i], draws[..., i], rng)[trusted]
        for i, name in enumerate(truth.unknowns)
    }
    likely = model.log_likelihood(reading[:, None], draws)
    out["likelihood"] = rank(model.log_likelihood(reading, contact), likely, rng)[trusted]
    return out, 1 - float(trusted.mean())


# -- ranks of fits --------------------------------------------------------------------------------

FITS: dict[str, dict[str, Any]] = {
    "2AFC, 5 trials a level": {"trials_per_level": 5},
    "2AFC, 40 trials a level": {"trials_per_level": 40},
    "percent correct": {"trials_per_level": 20, "task": "2AFC percent correct"},
    "yes/no": {"trials_per_level": 20, "task": "yes/no"},
    "radial distances": {
        "trials_per_level": 20,
        "observer": CUES["compliance (e)"],
        "standards": 30e-3,
        "offsets": [-0.3, -0.2, -0.1, -0.05, 0.05, 0.1, 0.2, 0.3],
    },
}


def fit_ranks(
    design: dict[str, Any],
    n: int,
    method: str | None = "quadrature",
    *,
    assumed: dict[str, Any] | None = None,
    seed: int = SEED,
) -> tuple[dict[str, Array], float]:
    """Ranks of every parameter of fits to trials of observers drawn from the priors."""
    rng = np.random.default_rng(seed)
    priors = Priors()
    truths: dict[str, list[float]] = {}
    drawn: dict[str, list[Array]] = {}
    flagged = 0
    for _ in range(n):
        low = high = 1.0
        while low + high >= 1:
            score = rng.standard_normal(2)
            score[1] = 0.7 * score[0] + np.sqrt(1 - 0.49) * score[1]
            low, high = priors.lapse_low.ppf(stats.norm.cdf(score))
        truth = {
            "weber_fraction": float(np.exp(np.log(0.1) + np.log(3.0) * rng.standard_normal())),
            "lapse_low": float(low),
            "lapse_high": float(high),
            "bias": float(rng.standard_normal()),
        }
        asked = design.get("task", "2AFC")
        if "percent correct" in asked:
            truth["bias"], truth["lapse_low"] = 0.0, 0.0
        trials = simulate_trials(**design, **truth, seed=rng)
        options = {k: v for k, v in design.items() if k == "observer"} | (assumed or {})
        fit = fit_weber(trials, method=method, seed=rng, **options)
        if fit.posterior.trouble:
            flagged += 1
            continue
        draws = fit.posterior.draws().named(fit.model)
        some = rng.permutation(len(next(iter(draws.values()))))[:DRAWS]
        for name, values in draws.items():
            truths.setdefault(name, []).append(truth["bias" if name == "criterion" else name])
            drawn.setdefault(name, []).append(values[some])
    out = {k: rank(np.array(truths[k]), np.stack(drawn[k]), rng) for k in truths}
    return out, flagged / n


# -- all of it ------------------------------------------------------------------------------------

COMPLIANCE, FORCES = CUES["compliance (e)"], CUES["force map (f)"]
BROKEN: dict[str, tuple[Observer, Observer]] = {
    "k taken for 30 % more": (COMPLIANCE, Observer(WHISKER, Compliance(), Weber(0.13))),
    "k taken for 30 % less": (COMPLIANCE, Observer(WHISKER, Compliance(), Weber(0.07))),
    "noise taken for constant": (
        COMPLIANCE,
        Observer(WHISKER, Compliance(), GeneralisedWeber(0.0, floor=0.1 * UNIT)),
    ),
    "map's k taken for 30 % more": (FORCES, Observer(WHISKER, ForceMap(), Weber(0.13))),
    # Of k = 0.1 and 0.2 the prior bounds so much that 600 readings are needed, with ρ = 0.7.
    "correlation of 0.9 ignored": (
        Observer(WHISKER, ForceMap(), Weber([0.05, 0.1], correlation=0.9)),
        Observer(WHISKER, ForceMap(), Weber([0.05, 0.1])),
    ),
    "whisker taken for 10 % softer": (
        COMPLIANCE,
        Observer(Whisker(50e-3, 100e-6, 5e-6, 2.7e9), Compliance()),
    ),
}
#: Design, and what the fit is told. Within 30 % of the standard its noise is nearly the other's:
#: 400 fits take no notice.
BROKEN_FITS: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "lapses ignored": (
        {"trials_per_level": 40},
        {"priors": {"lapse_low": 0.0, "lapse_high": 0.0}},
    ),
    "noise taken for that of the standard": (
        {"trials_per_level": 40, "offsets": [-0.8, -0.6, -0.4, -0.2, 0.0, 0.2, 0.4, 0.6, 0.8]},
        {"noise": "equal-variance"},
    ),
}
#: Posteriors of one unknown, of two, of three, by emcee, fits by quadrature and by emcee, and how
#: many readings a broken model of posteriors has at the least: with 60 the map's went unnoticed,
#: with 200 the likelihood's ranks give them away.
FULL = (2000, 600, 120, 400, 400, 60, 600)
SHORT = (200, 60, 10, 40, 40, 0, 200)

Ranks = dict[str, Array]
Job = tuple[str, str, str, Callable[[], tuple[Ranks, float]]]


def jobs(sizes: tuple[int, ...], seed: int) -> Iterator[Job]:
    """Group, name, engine and what to run."""
    sampled, fitted, fits_sampled, noticed = sizes[3:]

    def of(observer: Observer) -> int:
        return sizes[len(observer.unknowns) - 1]

    for group, some in (("cues", CUES), ("receptors", RECEPTORS)):
        for name, o in some.items():
            yield group, name, "quadrature", lambda o=o: posterior_ranks(o, of(o), seed=seed)
    for name, make in REAL.items():
        dear = any(word in name for word in ("uncertain", "unknown"))
        yield (
            "cues",
            name,
            "quadrature",
            lambda make=make, n=sizes[3 if dear else 0]: posterior_ranks(make(), n, seed=seed),
        )
    for name, o in CUES.items():
        yield (
            "emcee",
            name,
            "emcee",
            lambda o=o: posterior_ranks(o, min(of(o), sampled), "emcee", seed=seed),
        )
    for name, design in FITS.items():
        yield "fits", name, "quadrature", lambda d=design: fit_ranks(d, fitted, seed=seed)
    for name, design in FITS.items() if fits_sampled else ():
        yield "fits", name, "emcee", lambda d=design: fit_ranks(d, fits_sampled, "emcee", seed=seed)
    for name, (truth, assumed) in BROKEN.items():
        yield (
            "broken",
            name,
            "quadrature",
            lambda t=truth, a=assumed: posterior_ranks(
                t, max(of(t), noticed), assumed=a, seed=seed
            ),
        )
    for name, (design, assumed) in BROKEN_FITS.items():
        yield (
            "broken",
            name,
            "quadrature",
            lambda a=assumed, d=design: fit_ranks(d, fitted, assumed=a, seed=seed),
        )


@dataclass(frozen=True)
class Row:
    """Ranks of one quantity."""

    group: str
    name: str
    engine: str
    quantity: str
    ranks: Array
    flagged: float

    def numbers(self) -> dict[str, object]:
        """The row of the table."""
        off = np.abs(self.ranks - 0.5) * 2
        covered = {f"covered_{mass:.0%}".rstrip("%"): np.mean(off < mass) for mass in MASSES}
        told = {k: v for k, v in vars(self).items() if k != "ranks"}
        return {**told, "n": self.ranks.size, "p": uniform_p(self.ranks), **covered}


def one_job(chunk: dict[str, Any], seed: np.random.SeedSequence) -> pd.DataFrame:
    """The ranks of one job, as a sweep does it: a row each. Its seed is the chunk's own."""
    for number, (group, name, engine, work) in enumerate(
        jobs(tuple(chunk["sizes"]), chunk["seed"])
    ):
        if number == chunk["job"]:
            ranks, flagged = work()
            rows = [(k, float(u)) for k, v in ranks.items() for u in v]
            frame = pd.DataFrame(rows, columns=["quantity", "rank"]).astype({"rank": float})
            return frame.assign(group=group, name=name, engine=engine, flagged=flagged)
    raise ValueError(f"there is no job {chunk['job']}; give a lower number.")


def run_all(sizes: tuple[int, ...], seed: int = SEED, **how: Any) -> list[Row]:
    """Ranks of everything; `how` is for `campaign.run`."""
    chunks = [
        {"job": i, "name": job[1], "sizes": list(sizes), "seed": seed}
        for i, job in enumerate(jobs(sizes, seed))
    ]
    table = campaign.run(one_job, chunks, seed=seed, **({"title": "calibration"} | how))
    key = ["group", "name", "engine", "quantity", "flagged"]
    return [
        Row(*map(str, labels[:4]), own["rank"].to_numpy(), float(labels[4]))
        for labels, own in table.groupby(key, sort=False)
    ]


def verdict(table: pd.DataFrame) -> str:
    """In a sentence: the smallest p of all that is right, and what of the broken was caught."""
    right, broken = (table[(table["group"] == "broken") == b] for b in (False, True))
    worst = right.loc[right["p"].idxmin()]
    caught = broken.groupby("name")["p"].min()
    return (
        f"{len(right)} sets of ranks: {np.mean(right['p'] > 0.05):.0%} within their 95 % bands, "
        f"the smallest p {worst['p']:.4f} ({worst['name']}, {worst['quantity']}), which the worst "
        f"of as many would be in {1 - (1 - worst['p']) ** len(right):.0%} of such tables. "
        f"Broken models caught at 5 %: {int(np.sum(caught < 0.05))} of {len(caught)}, "
        f"the largest of their p {caught.max():.2g}."
    )


#: Columns that the figure is drawn from.
DRAWN = ("group", "name", "n", "p", "covered_50", "covered_80", "covered_95")
#: Groups of jobs whose models are right, in plain terms.
GROUPS = {"cues": "cues", "receptors": "receptors", "emcee": "cues by emcee", "fits": "fits"}


@plots.styled
def draw(table: pd.DataFrame) -> Figure:
    """From the table alone: p of all sets of ranks in order, coverage, and what is wrong."""
    figure = plots.new_figure(plots.DOUBLE, 3.0)
    ordered, covered, caught = figure.subplots(1, 3, width_ratios=[1, 1, 0.6])
    ordered.plot([0, 1], [0, 1], color="0.7", linewidth=0.7)
    at = np.linspace(0.005, 0.995, 100)
    # Ranks of one observer go together: as many are independent as there are observers.
    most = int(table.loc[table["group"] == "cues", "name"].nunique())
    low, high = stats.beta.interval(0.95, at * (most + 1), (1 - at) * (most + 1))
    ordered.fill_between(at, low, high, color="0.88", linewidth=0)
    for i, (group, words) in enumerate(GROUPS.items()):
        own = table[table["group"] == group]
        look = {"color": plots.COLOURS[i], "marker": plots.MARKERS[i], "linestyle": ""}
        p = np.sort(own["p"])
        label = f"{words} ({len(own)})"
        ordered.plot((np.arange(len(p)) + 0.5) / len(p), p, markersize=2, label=label, **look)
        for j, mass in enumerate(MASSES):
            off = 100 * (own[f"covered_{mass:.0%}".rstrip("%")] - mass)
            error = 196 * np.sqrt(mass * (1 - mass) / own["n"])
            x = 5 * j + i + np.linspace(-0.35, 0.35, len(own))
            covered.vlines(x, -error, error, color="0.88", linewidth=1.5, zorder=0)
            covered.plot(x, off, markersize=2, **look)
    ordered.set(xlabel="place in order, share", ylabel="p of uniform ranks")
    covered.axhline(0, color="0.7", linewidth=0.7, zorder=0)
    covered.set(xlabel="nominal coverage", ylabel="covered more than nominal (%)")
    covered.set_xticks([5 * j + 1.5 for j in range(3)], [f"{m:.0%}" for m in MASSES])
    worst = table[table["group"] == "broken"].groupby("name", sort=False)["p"].min()
    caught.barh(range(len(worst)), -np.log10(worst), color=plots.COLOURS[0], height=0.6)
    caught.axvline(-np.log10(0.05), color="0.4", linewidth=0.7, linestyle="--")
    caught.text(-np.log10(0.05), -0.55, " p = 0.05", color="0.4", fontsize=6, va="bottom")
    caught.set_yticks(range(len(worst)), list(worst.index))
    caught.set(xlabel="−log10 p", title="wrong on purpose", ylim=(len(worst) - 0.4, -1.1))
    ordered.set_title("right models: p in order")
    covered.set_title("right models: coverage")
    figure.legend(*ordered.get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return figure


def make(
    folder: Path, *, short: bool = False, drawn: pd.DataFrame | None = None, **how: Any
) -> pd.DataFrame:
    """Table, or the one `drawn`, and figure into `folder`; `how` is for `campaign.run`."""
    table = drawn
    if table is None:
        folder.mkdir(parents=True, exist_ok=True)
        log = folder / f"calibration.{'short' if short else 'full'}.jsonl"
        rows = run_all(SHORT if short else FULL, out=log, **how)
        table = pd.DataFrame([r.numbers() for r in rows])
    with Run(folder, "calibration", {"short": short}, SEED) as run:
        run.table("calibration", table)
        run.figure("calibration", draw(table))
    return table


if __name__ == "__main__":
    # By its own name, which workers can import.
    import calibration

    given = options(__file__, __doc__, short="few draws", workers=True, drawn=DRAWN)
    workers = campaign.all_cores(given.workers, given.scheduler)
    made = calibration.make(
        given.folder,
        short=given.short,
        drawn=given.draw,
        workers=workers,
        scheduler=given.scheduler,
    )
    print(made.to_string(index=False, float_format="{:.3g}".format))
    print(verdict(made))
    print(f"Written to {given.folder}.")
