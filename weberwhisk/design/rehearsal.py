"""A plan rehearsed: the planned experiment simulated, and analysed as the real one will be.

Every hypothesis in turn is the truth. Animals are drawn from what the plan expects of them, answer
the very lists that the real ones will see, and their answers go through `Plan.analyse`, as the real
ones will. What is counted is how often the conclusion is the right one.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from .._util import campaign, checks
from ..behaviour.simulate import simulate_responses
from .plan import Plan
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


def one_experiment(chunk: dict[str, Any], seed: np.random.SeedSequence, plan: Plan) -> pd.DataFrame:
    """One experiment, from animals to conclusion: a row of `Power.runs`."""
    truth = next(h for h in plan.hypotheses if h.name == chunk["truth"])
    of_animals, of_answers = seed.spawn(2)
    animals = plan.animals.draw(plan.scheme.animals, of_animals)
    animals["bias"] += truth.usual_bias
    answers = simulate_responses(
        plan.trials, animals, encoding=truth.encoding, noise=truth.noise, task=truth.task,
        seed=of_answers,
    )  # fmt: skip
    result = plan.analyse(answers, check=False)
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
