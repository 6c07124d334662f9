"""The trials that adaptive placement saves, by simulation.

    python analyses/adaptive.py [folder] [--short] [--workers 2] [--scheduler tcp://...]

Simulated animals with 3 % lapses a side and biases of their own (sd 0.3). One part measures the
Weber fraction of an animal that is as expected (k = 0.1) and of one that is not (0.2): by expected
information, by the same with lapses and bias in the objective (QUEST+), by two staircases, and by
constant stimuli at ±0.6, 1.2 and 2 sd of the expected animal. The other part tells a tapered
whisker from a cylinder. Whatever placed the trials, the same fit reads them (or the placer's own
belief, which is the same). Writes adaptive (PNG, SVG), adaptive_estimation.csv,
adaptive_discrimination.csv and adaptive_trials.csv: trials until the median 95 % interval of k is
within ±40 %, and until the Bayes factor is above 10 in 80 % of runs.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from command import options

import weberwhisk as ww
from weberwhisk import campaign, plots
from weberwhisk._util.output import Run
from weberwhisk.behaviour import IdentityEncoding, response_probability
from weberwhisk.design import (
    BayesianPlacer,
    Hypothesis,
    Proposal,
    Scheme,
    TrialLog,
    lattice,
    taper,
)
from weberwhisk.plots.choices import binomial_interval
from weberwhisk.plots.style import LINES, bars, legend_above, look, mark

LAPSE, BIAS_SD, EXPECTED = 0.03, 0.3, 0.1
WHISKER = ww.Whisker(50e-3, 100e-6, 5e-6)
PLACES = (0.3, 0.6, 0.9)
ESTIMATORS = ("information", "QUEST+", "1-up/2-down", "1-up/3-down", "constant")
DISCRIMINATORS = ("information", "constant")
ANIMALS = {"estimation": 40, "discrimination": 48}
MARKS_SHORT = (10, 20)
MARKS = {"estimation": (30, 60, 90, 120, 180, 240, 300),
         "discrimination": (30, 60, 90, 120, 180)}  # fmt: skip
#: Half width of the interval that is wanted.
WIDTH = 0.4
SEED = 20110166


class Constant(TrialLog):
    """Levels of a scheme in random order, as a placer."""

    def __init__(self, hypotheses: Any, scheme: Scheme, seed: int) -> None:
        super().__init__(hypotheses, scheme)
        self._cells, self._rng = scheme.cells(), np.random.default_rng(seed)

    finished = ""

    def next(self, standard: float | None = None) -> Proposal:
        at = self._rng.integers(self._cells.n.size)
        s1, s2 = self._cells.stimulus_1[at], self._cells.stimulus_2[at]
        return Proposal(len(self._recorded) + 1, float(s1), float(s2))

    def _encode(self, pair: tuple[float, float, float]) -> None:
        """Stimuli of a scheme can be encoded."""

    def _learn(self, pair: tuple[float, float, float], answer: int) -> None:
        """No trial changes what comes next."""


#: Right answers in a row that make it harder.
RULES = {"1-up/2-down": 2, "1-up/3-down": 3}


class Staircase(TrialLog):
    """A transformed up–down rule (Levitt 1971) at one standard, from the easiest level on.

    Levels moved at once are halved with every turn; the side of the comparison is random.
    """

    def __init__(self, hypothesis: Hypothesis, scheme: Scheme, rule: str, seed: int) -> None:
        super().__init__([hypothesis], scheme, seed)
        (standard,), levels = scheme.standards, np.array(scheme.comparisons[0])
        sides = levels[levels < standard], levels[levels > standard][::-1]
        self._sides, self._needed = sides, RULES[rule]
        self._level = self._right = self._way = self._turns = 0

    def _choose(self, number: int, rng: np.random.Generator, standard: float | None) -> Proposal:
        levels = self._sides[int(rng.random(2)[1] < 0.5)]
        at = float(levels[min(self._level, levels.size - 1)])
        return Proposal(number, self.scheme.standards[0], at)

    def _encode(self, pair: tuple[float, float, float]) -> None:
        """Stimuli of a scheme can be encoded."""

    def _learn(self, pair: tuple[float, float, float], answer: int) -> None:
        right = answer == int(pair[1] > pair[0])
        self._right = self._right + 1 if right else 0
        way = -1 if not right else int(self._right >= self._needed)
        if way == 0:
            return
        self._right = 0
        self._turns += self._way not in (0, way)
        self._way = way
        stride = max(4 >> self._turns, 1)
        lowest = max(side.size for side in self._sides) - 1
        self._level = int(np.clip(self._level + way * stride, 0, lowest))


def scene(part: str, method: str, seed: int) -> Any:
    """The placer of one experiment."""
    if part == "estimation":
        hypotheses = [Hypothesis("Weber", IdentityEncoding(), bias="shared")]
        standards = np.array([1.0])
        scheme = lattice(IdentityEncoding(), standards)
    else:
        hypotheses = list(taper(WHISKER))
        standards = np.array(PLACES) * WHISKER.length
        levels = [lattice(h.encoding, standards, each_side=10).offsets for h in hypotheses]
        scheme = Scheme(standards, [sorted({*a, *b}) for a, b in zip(*levels, strict=True)])
    if method == "constant":
        expected = Scheme.spaced(
            hypotheses[0].encoding, standards, weber_fraction=EXPECTED,
            levels=(-2.0, -1.2, -0.6, 0.6, 1.2, 2.0),
        )  # fmt: skip
        return Constant(hypotheses, expected, seed)
    if method.startswith("1-up"):
        return Staircase(hypotheses[0], scheme, rule=method, seed=seed)
    if method == "QUEST+":
        return BayesianPlacer(hypotheses, scheme, goal="everything", easy_share=0.0, seed=seed)
    goal = "weber_fraction" if part == "estimation" else "hypothesis"
    return BayesianPlacer(hypotheses, scheme, goal=goal, seed=seed)


def experiment(chunk: dict[str, Any], seed: np.random.SeedSequence) -> pd.DataFrame:
    """One animal: what is known of it after so many trials."""
    rng = np.random.default_rng(seed)
    placer = scene(chunk["part"], chunk["method"], int(rng.integers(2**31)))
    truth = placer.hypotheses[chunk["truth"]]
    bias = dict(zip(placer.scheme.standards, rng.normal(0, BIAS_SD, 3), strict=False))
    rows = []
    for number in range(1, max(chunk["marks"]) + 1):
        trial = placer.next()
        chance = response_probability(
            truth.asked,
            truth.encoding,
            trial.standard,
            trial.comparison,
            weber_fraction=chunk["weber_fraction"],
            lapse_low=LAPSE,
            lapse_high=LAPSE,
            bias=bias[trial.standard],
        )
        placer.record(trial.standard, trial.comparison, int(rng.random() < chance[0]))
        if number in chunk["marks"]:
            rows.append({"n": number, **known(placer, chunk["truth"])})
    about = {name: chunk[name] for name in ("method", "weber_fraction", "truth", "animal")}
    return pd.DataFrame(rows).assign(**about)


def known(placer: TrialLog, truth: int) -> dict[str, float]:
    """Estimate and interval of k under the truth, and its log Bayes factor over the other."""
    if isinstance(placer, BayesianPlacer) and len(placer.hypotheses) == 2:
        beliefs = list(placer.beliefs.values())
        low, median, high = beliefs[truth].quantile(np.array([0.025, 0.5, 0.975]))
        lead = beliefs[truth].log_evidence - beliefs[1 - truth].log_evidence
        return {"median": median, "low": low, "high": high, "log_bayes_factor": lead}
    fits = list(placer.fits().values())
    low, median, high = fits[truth].posterior.quantile("weber_fraction", [0.025, 0.5, 0.975])
    row = {"median": float(median), "low": float(low), "high": float(high)}
    if len(fits) == 2:
        mine, other = fits[truth].log_evidence, fits[1 - truth].log_evidence
        assert mine is not None
        assert other is not None
        row["log_bayes_factor"] = mine - other
    return row


def chunks(part: str, animals: int, marks: tuple[int, ...]) -> list[dict[str, Any]]:
    """Every animal of every method and truth."""
    estimating = part == "estimation"
    return [
        {"part": part, "method": method, "weber_fraction": k, "truth": truth, "animal": animal,
         "marks": list(marks)}
        for method in (ESTIMATORS if estimating else DISCRIMINATORS)
        for k in ((0.1, 0.2) if estimating else (0.1,))
        for truth in ((0,) if estimating else (0, 1))
        for animal in range(animals)
    ]  # fmt: skip


def summary(estimation: pd.DataFrame, discrimination: pd.DataFrame) -> pd.DataFrame:
    """Trials that each method needs; NaN where it does not get there."""
    rows = []
    half = (estimation["high"] - estimation["low"]) / (estimation["high"] + estimation["low"])
    for (method, k), own in estimation.assign(half=half).groupby(["method", "weber_fraction"]):
        width = own.groupby("n")["half"].median()
        error = np.log(own["median"] / k)[own["n"] == own["n"].max()]
        rows.append(("±40 % interval", method, f"k = {k:g}", crossing(width, WIDTH),
                     float(np.sqrt(np.mean(error**2)))))  # fmt: skip
    for (method, truth), own in discrimination.groupby(["method", "truth"]):
        share = (own["log_bayes_factor"] > np.log(10)).groupby(own["n"]).mean()
        name = ("tapered", "cylinder")[truth]
        rows.append(("Bayes factor > 10 in 80 %", method, name, crossing(-share, -0.8), np.nan))
    names = ["goal", "method", "truth", "trials", "rmse_of_log_k_at_the_end"]
    return pd.DataFrame(rows, columns=names)


def crossing(curve: pd.Series, level: float) -> float:
    """Where a falling curve over n first passes a level, straight lines between points."""
    n, y = curve.index.to_numpy(float), curve.to_numpy(float)
    below = np.flatnonzero(y <= level)
    if not below.size:
        return float("nan")
    i = int(below[0])
    if i == 0:
        return float(n[0])
    return float(n[i - 1] + (n[i] - n[i - 1]) * (y[i - 1] - level) / (y[i - 1] - y[i]))


@plots.styled
def draw(tables: Mapping[str, pd.DataFrame]) -> Any:
    """What simulated experiments know after so many trials, a line a method.

    Parameters
    ----------
    tables : mapping
        ``estimation``: rows with ``method``, ``weber_fraction`` (the truth), ``n``, ``low`` and
        ``high``; ``discrimination``: with ``method``, ``truth``, ``n`` and ``log_bayes_factor``.
    """
    first, second = tables["estimation"], tables["discrimination"]
    ks = sorted(first["weber_fraction"].unique())
    figure = plots.new_figure(plots.DOUBLE, 2.9)
    axes = figure.subplots(1, len(ks) + 1)
    methods = list(dict.fromkeys(first["method"]))
    half = (first["high"] - first["low"]) / (first["high"] + first["low"])
    for ax, k in zip(axes, ks, strict=False):
        for i, method in enumerate(methods):
            own = first[(first["weber_fraction"] == k) & (first["method"] == method)]
            width = half[own.index].groupby(own["n"]).median()
            ax.plot(width.index, 100 * width, **mark(i) | look(i), label=method)
        ax.axhline(40, color="0.7", linewidth=0.8, zorder=0, label="goal")
        ax.text(0.95, 0.93, f"k = {k:g}", ha="right", transform=ax.transAxes)
        ax.set(xlabel="Trials", ylim=(0, 100))
    axes[0].set_ylabel("Half width of the 95 % interval of k (%)")
    legend_above(axes[0])
    ax = axes[len(ks)]
    for truth in sorted(second["truth"].unique()):
        for method in dict.fromkeys(second["method"]):
            own = second[(second["truth"] == truth) & (second["method"] == method)]
            found = (own["log_bayes_factor"] > np.log(10)).groupby(own["n"])
            share, count = found.mean(), found.sum().to_numpy(float)
            low, high = binomial_interval(count, found.size().to_numpy(float))
            style = {"linestyle": LINES[truth % len(LINES)], "elinewidth": 0.8}
            label = f"{method}, {('tapered', 'cylinder')[truth]}"
            ends = 100 * share, 100 * low, 100 * high
            bars(ax, share.index, ends, methods.index(method), **style, label=label)
    ax.axhline(80, color="0.7", linewidth=0.8, zorder=0, label="goal")
    ax.set(xlabel="Trials", ylabel="Runs with Bayes factor > 10 (%)", ylim=(0, 102))
    legend_above(ax)
    return figure


def make(
    folder: Path,
    *,
    short: bool = False,
    workers: int = 1,
    scheduler: str | None = None,
) -> dict[str, pd.DataFrame]:
    """Tables and figure into `folder`; the sweeps stream into files beside it and resume."""
    folder.mkdir(parents=True, exist_ok=True)
    tables = {}
    for part, marks in MARKS.items():
        tables[part] = campaign.run(
            experiment,
            chunks(part, 1 if short else ANIMALS[part], MARKS_SHORT if short else marks),
            seed=SEED,
            workers=workers,
            scheduler=scheduler,
            out=folder / f"adaptive_{part}.{'short' if short else 'full'}.jsonl",
            title=part,
        )
    tables["trials"] = summary(tables["estimation"], tables["discrimination"])
    with Run(folder, "adaptive", {"short": short, "animals": ANIMALS}, SEED) as run:
        for name, table in tables.items():
            run.table(f"adaptive_{name}", table)
        run.figure("adaptive", draw(tables))
    return tables


if __name__ == "__main__":
    # By its own name, which workers can import.
    import adaptive

    given = options(__file__, __doc__, short="one animal, few trials", workers=True)
    made = adaptive.make(
        given.folder,
        short=given.short,
        workers=campaign.all_cores(given.workers, given.scheduler),
        scheduler=given.scheduler,
    )
    print(made["trials"].to_string(index=False, float_format="{:.3g}".format))
