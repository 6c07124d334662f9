"""A plan rehearsed: the planned experiment simulated, and analysed as the real one will be.

Every hypothesis in turn is the truth. Animals are drawn from what the plan expects of them, answer
the very lists that the real ones will see, and their answers go through `Plan.analyse`, as the real
ones will. What is counted is how often the conclusion is the right one.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from .._util import campaign, checks
from ..behaviour.simulate import simulate_responses
from ..behaviour.trials import STIMULI, Trials
from .goals import Contrast
from .hypotheses import Hypothesis
from .plan import AnalysisResult, Plan
from .plan_file import plan_json
from .power_analysis import Power, summary

__all__ = ["simulate_study"]


def simulate_study(
    plan: Plan,
    runs: int = 100,
    *,
    seed: int | np.random.SeedSequence = 1,
    workers: int = 1,
    scheduler: str | None = None,
    out: str | Path | None = None,
    progress: Callable[[float], None] | None = None,
) -> Power:
    """Simulate a planned experiment, fit it as the real data will be fitted, and judge it.

    Parameters
    ----------
    plan : Plan
    runs : int
        Experiments under each hypothesis.
    seed : int or SeedSequence
        Of animals and answers; the trial lists are the plan's own.
    workers, scheduler, out, progress
        See `weberwhisk.campaign.run`: none of them changes the result, and with `out` a run that
        was interrupted is resumed.

    Returns
    -------
    Power
        `runs` has also the number of each `run` of the study.

    Raises
    ------
    ValueError
        For no runs; with `out`, for a plan that cannot be written as JSON.

    Examples
    --------
    >>> from weberwhisk import Whisker
    >>> from weberwhisk.design import Evidence, Scheme, taper
    >>> tapered, cylindrical = taper(Whisker(50e-3, 100e-6, 5e-6))
    >>> scheme = Scheme.spaced(tapered.encoding, [15e-3, 45e-3], levels=[-2, -1, 1, 2], trials=25)
    >>> plan = Plan(scheme, [tapered, cylindrical], Evidence(bayes_factor=10))
    >>> simulate_study(plan, 2, seed=1).runs["truth"].tolist()
    ['tapered', 'cylindrical', 'tapered', 'cylindrical']
    """
    checks.whole("runs", runs, "write 100")
    # A file of runs must say of which plan they are.
    of = "" if out is None else hashlib.sha256(plan_json(plan).encode()).hexdigest()
    chunks = [
        {"plan": of, "truth": hypothesis.name, "run": run}
        for run in range(1, int(runs) + 1)
        for hypothesis in plan.hypotheses
    ]
    table = campaign.run(
        partial(one_experiment, plan=plan), chunks, seed=seed, workers=workers,
        scheduler=scheduler, out=out, title="Simulated study", progress=progress,
    )  # fmt: skip
    return Power(plan.goal, summary(table, plan.goal), table)


def _answered(
    plan: Plan, truth: Hypothesis, animals: pd.DataFrame, seed: np.random.SeedSequence
) -> Trials:
    """What animals answer to a plan's lists; in either condition with a k of their own."""
    of, lists = plan.magnitude, plan.trials
    if not of.is_distance:  # these are read in metres
        lists = lists.rename(columns={of.column(name): name for name in STIMULI})
    if isinstance(plan.goal, Contrast):
        # Another k in another condition is another animal here.
        first = plan.scheme.conditions[0]
        second = np.where(lists["condition"] == first, 0, 1)
        factor = plan.goal.ratio ** np.array([-0.5, 0.5])
        by_condition = [
            animals.assign(
                subject=[f"{s} {j}" for s in animals["subject"]],
                weber_fraction=animals["weber_fraction"] * factor[j],
            )
            for j in range(2)
        ]
        named = [f"{s} {j}" for s, j in zip(lists["subject"], second, strict=True)]
        lists, animals = lists.assign(subject=named), pd.concat(by_condition)
    answers = simulate_responses(
        lists, animals, encoding=truth.encoding, noise=truth.noise, task=truth.task, seed=seed
    )
    columns = {name: plan.trials[name].to_numpy() for name in ("subject", "condition")
               if name in plan.trials}  # fmt: skip
    return replace(answers, frame=answers.frame.assign(**columns))


def _of_contrast(plan: Plan, result: AnalysisResult, chunk: dict[str, Any]) -> pd.DataFrame:
    """A row of `Power.runs` of two conditions."""
    goal, found = plan.goal, result.ratio
    assert isinstance(goal, Contrast)
    assert found is not None
    return pd.DataFrame([{
        "truth": chunk["truth"], "run": chunk["run"],
        "trials": max(map(max, plan.scheme.trials)), "animals": plan.scheme.animals,
        "weber_fraction": goal.ratio, "estimate": found.median, "log_bayes_factor": np.inf,
        "half_width": (found.upper - found.lower) / (2 * found.median),
        "covers": found.lower <= goal.ratio <= found.upper,
        "lower": found.lower, "upper": found.upper,
    }])  # fmt: skip


def one_experiment(chunk: dict[str, Any], seed: np.random.SeedSequence, plan: Plan) -> pd.DataFrame:
    """One experiment, from animals to conclusion: a row of `Power.runs`."""
    truth = next(h for h in plan.hypotheses if h.name == chunk["truth"])
    of_animals, of_answers = seed.spawn(2)
    animals = plan.animals.draw(plan.scheme.animals, of_animals)
    animals["bias"] += truth.usual_bias
    answers = _answered(plan, truth, animals, of_answers)
    result = plan.analyse(answers, check=False)
    if isinstance(plan.goal, Contrast):
        return _of_contrast(plan, result, chunk)
    estimates = result.of(truth.name)
    half_width = (estimates["upper"] - estimates["lower"]) / (2 * estimates["weber_fraction"])
    k: Any = pd.Series(plan.animals.weber_fraction, estimates.index)
    if not plan.together:
        k = estimates["subject"].map(animals.set_index("subject")["weber_fraction"])
    row = {
        "truth": truth.name,
        "run": chunk["run"],
        "trials": max(map(max, plan.scheme.trials)),
        "animals": plan.scheme.animals,
        "weber_fraction": float(k.median()),
        "estimate": float(estimates["weber_fraction"].median()),
        "log_bayes_factor": result.log_bayes_factor(truth.name),
        "half_width": float(half_width.median()),
        "covers": float(((estimates["lower"] <= k) & (k <= estimates["upper"])).mean()),
    }
    row |= plan.goal.animal_columns(half_width)
    return pd.DataFrame([row])
