"""The whole experiment in simulation: its trial lists answered, fitted as planned, and judged.

Every hypothesis in turn is the truth. Animals are drawn from what the plan expects of them, answer
the very lists that the real ones will see, and their answers go through `Plan.analyse`, as the real
ones will. What is counted is how often the conclusion is the right one.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import binomtest

from .. import campaign
from ..behaviour.answering import answer_trials
from ..behaviour.status import FitStatus
from .plan import Plan
from .plan_file import plan_json, plan_of

NEITHER = "undecided"


@dataclass(frozen=True)
class Rehearsal:
    """Outcomes of a rehearsed experiment.

    Parameters
    ----------
    plan : Plan
    table : DataFrame
        One row an experiment: `truth` (the hypothesis that was simulated), `run`, `conclusion`
        (the hypothesis favoured, or "undecided"; empty where there is one hypothesis),
        `log_bayes_factor` (natural log; the truth against the best other), `weber_fraction`
        (median of the animals' estimates, or the population's), `half_width` (of its 95 %
        interval, relative; of several animals the median), `covered` (share of intervals that hold
        the true k), `determined` (share of fits whose status is so), `right` (the conclusion is
        that of the goal).
    """

    plan: Plan = field(repr=False)
    table: pd.DataFrame = field(repr=False)

    def summary(self) -> pd.DataFrame:
        """How often, by truth, with the Monte Carlo error.

        Returns
        -------
        DataFrame
            Index `truth`; `runs`; `right` with its standard error `error` and Wilson's 95 % interval
            `lower` to `upper`; `wrong` (another hypothesis favoured), `undecided`; `covered`, the
            share of 95 % intervals that hold the truth; `half_width`, the median; `bias`, the
            median estimate over the truth, less 1.
        """
        rows = []
        for truth, own in self.table.groupby("truth", sort=False):
            n, hits = len(own), int(own["right"].sum())
            found = binomtest(hits, n).proportion_ci(method="wilson")
            undecided = own["conclusion"] == NEITHER
            other = (own["conclusion"] != truth) & (own["conclusion"] != "") & ~undecided
            share = hits / n
            rows.append(
                {
                    "truth": truth,
                    "runs": n,
                    "right": share,
                    "error": float(np.sqrt(share * (1 - share) / n)),
                    "lower": found.low,
                    "upper": found.high,
                    "wrong": float(other.mean()),
                    "undecided": float(undecided.mean()),
                    "covered": float(own["covered"].mean()),
                    "half_width": float(own["half_width"].median()),
                    "bias": float(
                        own["weber_fraction"].median() / self.plan.animals.weber_fraction - 1
                    ),
                }
            )
        return pd.DataFrame(rows).set_index("truth")

    def report(self) -> str:
        """What came out, in plain words."""
        plan, seen = self.plan, self.summary()
        lines = [
            f"{plan.title}: {plan.scheme.animals} animal{'s' * (plan.scheme.animals > 1)} × "
            f"{plan.scheme.n_trials} trials, simulated {int(seen['runs'].iloc[0])} times under "
            f"{'each hypothesis' if len(seen) > 1 else 'the hypothesis'} and analysed as planned.",
            f"The goal is {plan.goal}.",
        ]
        for truth, row in seen.iterrows():
            met = (
                "reached"
                if row["lower"] >= plan.goal.share
                else "missed"
                if row["upper"] < plan.goal.share
                else "neither reached nor missed for sure with so many runs"
            )
            words = f"When the animals are {truth}: the conclusion is right in {_share(row)}"
            if len(plan.hypotheses) > 1:
                words += (
                    f", undecided in {100 * row['undecided']:.3g} %, and wrong in "
                    f"{100 * row['wrong']:.3g} %"
                )
            lines.append(
                f"{words}; goal {met}. The 95 % interval of k has a median half-width of "
                f"±{100 * row['half_width']:.2g} % and holds the truth in "
                f"{100 * row['covered']:.3g} %; the median estimate is "
                f"{100 * row['bias']:+.2g} % off."
            )
        return "\n".join(lines) + "\n"


def _share(row: Any) -> str:
    return (
        f"{100 * row['right']:.3g} ± {100 * row['error']:.2g} % of {int(row['runs'])} runs (95 % "
        f"interval {100 * row['lower']:.3g} to {100 * row['upper']:.3g} %)"
    )


def rehearse(
    plan: Plan,
    runs: int = 100,
    *,
    seed: int | np.random.SeedSequence = 1,
    workers: int = 1,
    scheduler: str | None = None,
    out: str | Path | None = None,
    progress: Callable[[float], None] | None = None,
) -> Rehearsal:
    """Simulate a planned experiment, fit it as the real data will be fitted, and judge it.

    Parameters
    ----------
    plan : Plan
    runs : int
        Experiments under each hypothesis.
    seed : int or SeedSequence
        Of animals and answers; the trial lists are the plan's own.
    workers, scheduler, out, progress
        See `weberwhisk.campaign.run`: the answer is the same whoever does it, and with `out` a run
        that was broken off goes on where it was.

    Returns
    -------
    Rehearsal

    Raises
    ------
    ValueError
        For no runs, and a plan that cannot be written as JSON.

    Examples
    --------
    >>> from weberwhisk import Whisker
    >>> from weberwhisk.design import Goal, Scheme, taper
    >>> tapered, cylindrical = taper(Whisker(50e-3, 100e-6, 5e-6))
    >>> scheme = Scheme.spaced(tapered.percept, [15e-3, 45e-3], levels=[-2, -1, 1, 2], trials=25)
    >>> plan = Plan(scheme, [tapered, cylindrical], Goal(bayes_factor=10))
    >>> rehearse(plan, 2, seed=1).table["truth"].tolist()
    ['tapered', 'tapered', 'cylindrical', 'cylindrical']
    """
    if runs != int(runs) or runs < 1:
        raise ValueError(f"runs must be a whole number of 1 or more, got {runs!r}; write 100.")
    text = json.dumps(json.loads(plan_json(plan)))
    chunks = [
        {"plan": text, "truth": hypothesis.name, "run": run}
        for hypothesis in plan.hypotheses
        for run in range(1, int(runs) + 1)
    ]
    table = campaign.run(
        one_experiment, chunks, seed=seed, workers=workers, scheduler=scheduler, out=out,
        title="Rehearsal", progress=progress,
    )  # fmt: skip
    return Rehearsal(plan, table)


def one_experiment(chunk: dict[str, Any], seed: np.random.SeedSequence) -> pd.DataFrame:
    """One experiment, from animals to conclusion: a row of `Rehearsal.table`."""
    plan = _plan(chunk["plan"])
    truth = next(h for h in plan.hypotheses if h.name == chunk["truth"])
    of_animals, of_answers = seed.spawn(2)
    animals = plan.animals.draw(plan.scheme.animals, of_animals)
    answers = answer_trials(
        plan.trials, animals, percept=truth.percept, noise=truth.noise, task=truth.task,
        seed=of_answers,
    )  # fmt: skip
    found = plan.analyse(answers)
    rows = found.of(truth.name)
    half_width = (rows["upper"] - rows["lower"]) / (2 * rows["weber_fraction"])
    true_k = (
        np.full(len(rows), plan.animals.weber_fraction)
        if plan.together
        else rows["subject"].map(animals.set_index("subject")["weber_fraction"]).to_numpy(float)
    )
    covered = (rows["lower"] <= true_k) & (true_k <= rows["upper"])
    compared = len(plan.hypotheses) > 1
    conclusion = (found.favoured(plan.goal.bayes_factor or 10.0) or NEITHER) if compared else ""
    right = (
        conclusion == truth.name
        if plan.goal.bayes_factor is not None
        else bool((half_width.median() <= (plan.goal.half_width or 0)) and covered.mean() >= 0.5)
    )
    return pd.DataFrame(
        {
            "truth": [truth.name],
            "run": [chunk["run"]],
            "conclusion": [conclusion],
            "log_bayes_factor": [found.log_bayes_factor(truth.name)],
            "weber_fraction": [float(rows["weber_fraction"].median())],
            "half_width": [float(half_width.median())],
            "covered": [float(covered.mean())],
            "determined": [float((rows["status"] == FitStatus.DETERMINED.name).mean())],
            "right": [right],
        }
    )


@lru_cache(maxsize=4)
def _plan(text: str) -> Plan:
    return plan_of(text)
