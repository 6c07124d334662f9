"""The whole experiment in simulation: its trial lists answered, fitted as planned, and judged.

Every hypothesis in turn is the truth. Animals are drawn from what the plan expects of them, answer
the very lists that the real ones will see, and their answers go through `Plan.analyse`, as the real
ones will. What is counted is how often the conclusion is the right one.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pandas as pd

from .. import _checks, campaign
from .._values import Shown, interval_text
from ..behaviour.population import simulate_responses
from ..behaviour.verdict import FitStatus
from .plan import Plan
from .plan_file import plan_json, plan_of
from .power_analysis import wilson

NEITHER = "undecided"


@dataclass(frozen=True, repr=False)
class SimulatedStudy(Shown):
    """Outcomes of an experiment that was simulated.

    Parameters
    ----------
    plan : Plan
    table : DataFrame
        One row an experiment:

        - `truth`, the hypothesis that was simulated, and the number of the `run`;
        - `conclusion`, the hypothesis favoured or "undecided" (empty where there is one alone), and
          `log_bayes_factor`, natural, of the truth against the best other;
        - `weber_fraction` and `half_width`, estimate and relative half-width of its 95 % interval,
          of several animals fitted apart the medians; `covered`, the share of these intervals that
          hold the true k; `determined`, the share of fits whose status is that;
        - `right`: the share of conclusions that are right, which is 1 or 0 for a hypothesis
          favoured, and `covered` where the goal is an interval; `reached`, how far the goal was:
          the same for a hypothesis, for an interval the share of animals where it is narrow enough.
    """

    _figure: ClassVar[str] = "rehearsed"
    plan: Plan
    table: pd.DataFrame

    def summary(self) -> pd.DataFrame:
        """How often, by truth, with the Monte Carlo error.

        Returns
        -------
        DataFrame
            Index `truth`; `runs`; `reached`, the share in which the goal was, with its standard
            error `error` and Wilson's 95 % interval `lower` to `upper`; shares of conclusions
            `right`, `wrong` and `undecided`; `covered`; median `half_width`; `bias`, the median
            estimate over the true median, less 1.
        """
        rows = []
        for truth, own in self.table.groupby("truth", sort=False):
            lower, upper = wilson(float(own["reached"].mean()), len(own))
            undecided = float((own["conclusion"] == NEITHER).mean())
            estimate = own["weber_fraction"].median()
            rows.append(
                {
                    "truth": truth,
                    "runs": len(own),
                    "reached": float(own["reached"].mean()),
                    "error": float(own["reached"].std(ddof=0) / np.sqrt(len(own))),
                    "lower": lower,
                    "upper": upper,
                    "right": float(own["right"].mean()),
                    "wrong": float((1 - own["right"] - (own["conclusion"] == NEITHER)).mean()),
                    "undecided": undecided,
                    "covered": float(own["covered"].mean()),
                    "half_width": float(own["half_width"].median()),
                    "bias": float(estimate / self.plan.animals.weber_fraction - 1),
                }
            )
        return pd.DataFrame(rows).set_index("truth")

    def _line(self) -> str:
        rows = self.summary()[["reached", "lower", "upper", "runs"]].iterrows()
        return "goal reached by " + "; ".join(
            f"{truth} {interval_text(*row.iloc[:3])} of {row['runs']:g} runs" for truth, row in rows
        )

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
            lines.append(
                f"When the animals are {truth}: the goal is reached in {100 * row['reached']:.3g} "
                f"± {100 * row['error']:.2g} % of {int(row['runs'])} runs (95 % interval "
                f"{100 * row['lower']:.3g} to {100 * row['upper']:.3g} %), "
                f"{_met(row, plan.goal.share)}; the conclusion is right in "
                f"{100 * row['right']:.3g} %, wrong in {100 * row['wrong']:.3g} % and open in "
                f"{100 * row['undecided']:.3g} %. The 95 % interval of k is ±"
                f"{100 * row['half_width']:.2g} % in the median and holds the truth in "
                f"{100 * row['covered']:.3g} %; the median estimate is {100 * row['bias']:+.2g} % "
                "off."
            )
        return "\n".join(lines) + "\n"


def _met(row: pd.Series, share: float) -> str:
    wanted = f"the {100 * share:.3g} % asked for"
    if row["lower"] > share:
        return f"more than {wanted}"
    if row["upper"] < share:
        return f"less than {wanted}"
    return f"not to be told from {wanted} by so many runs"


def simulate_study(
    plan: Plan,
    runs: int = 100,
    *,
    seed: int | np.random.SeedSequence = 1,
    workers: int = 1,
    scheduler: str | None = None,
    out: str | Path | None = None,
    progress: Callable[[float], None] | None = None,
) -> SimulatedStudy:
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
    SimulatedStudy

    Raises
    ------
    ValueError
        For no runs, and a plan that cannot be written as JSON.

    Examples
    --------
    >>> from weberwhisk import Whisker
    >>> from weberwhisk.design import Goal, Scheme, taper
    >>> tapered, cylindrical = taper(Whisker(50e-3, 100e-6, 5e-6))
    >>> scheme = Scheme.spaced(tapered.encoding, [15e-3, 45e-3], levels=[-2, -1, 1, 2], trials=25)
    >>> plan = Plan(scheme, [tapered, cylindrical], Goal(bayes_factor=10))
    >>> simulate_study(plan, 2, seed=1).table["truth"].tolist()
    ['tapered', 'cylindrical', 'tapered', 'cylindrical']
    """
    _checks.whole("runs", runs, "write 100")
    text = json.dumps(json.loads(plan_json(plan)))
    chunks = [
        {"plan": text, "truth": hypothesis.name, "run": run}
        for run in range(1, int(runs) + 1)
        for hypothesis in plan.hypotheses
    ]
    table = campaign.run(
        one_experiment, chunks, seed=seed, workers=workers, scheduler=scheduler, out=out,
        title="Simulated study", progress=progress,
    )  # fmt: skip
    return SimulatedStudy(plan, table)


def one_experiment(chunk: dict[str, Any], seed: np.random.SeedSequence) -> pd.DataFrame:
    """One experiment, from animals to conclusion: a row of `SimulatedStudy.table`."""
    plan = _plan(chunk["plan"])
    truth = next(h for h in plan.hypotheses if h.name == chunk["truth"])
    of_animals, of_answers = seed.spawn(2)
    animals = plan.animals.draw(plan.scheme.animals, of_animals)
    animals["bias"] += truth.usual_bias
    answers = simulate_responses(
        plan.trials, animals, encoding=truth.encoding, noise=truth.noise, task=truth.task,
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
    conclusion, right, reached = (
        "",
        covered.mean(),
        (half_width <= (plan.goal.half_width or 0.0)).mean(),
    )
    if plan.goal.bayes_factor is not None:
        conclusion = found.favoured(plan.goal.bayes_factor) or NEITHER
        right = reached = float(conclusion == truth.name)
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
            "right": [float(right)],
            "reached": [float(reached)],
        }
    )


@lru_cache(maxsize=4)
def _plan(text: str) -> Plan:
    return plan_of(text)
