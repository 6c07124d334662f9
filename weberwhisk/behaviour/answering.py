"""Answers of known observers to trials that are laid out already."""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from .. import _checks
from .percepts import Percept, refuse_unfelt
from .psychometric import response_probability
from .tasks import task_named
from .trials import LABELS, Trials, notes_of

Array = NDArray[np.float64]

NEEDED = {
    "table": ("subject", "standard", "stimulus_1", "stimulus_2"),
    "animals": ("subject", "weber_fraction", "lapse_low", "lapse_high", "bias"),
}
TRUTH = ("weber_fraction", "lapse_low", "lapse_high", "bias")


def answer_trials(
    table: pd.DataFrame,
    animals: pd.DataFrame,
    *,
    percept: Percept,
    noise: str = "weber",
    missing: float = 0.0,
    task: str = "2AFC",
    seed: int | np.random.SeedSequence | np.random.Generator,
) -> Trials:
    """What observers with known parameters answer to a list of trials.

    `simulate_trials` makes its own list, with the standard always first; this one takes any.

    Parameters
    ----------
    table : DataFrame
        One row a trial: `standard`, `stimulus_1`, `stimulus_2`, and `subject`; `session` and
        `trial` are kept.
    animals : DataFrame
        The truth, as from `draw_animals`: a row for each `subject`, or each of its sessions where
        there is a column `session`.
    percept : Percept
    noise : {"weber", "equal-variance"}
    missing : float
        Share of trials without an answer.
    task : str
        As in `read_trials`.
    seed : int, SeedSequence or Generator

    Raises
    ------
    ValueError
        For stimuli that cannot be felt, and trials of an animal whose truth is not given.

    Examples
    --------
    >>> from weberwhisk.behaviour import IdentityPercept
    >>> table = pd.DataFrame({"subject": "s1", "standard": 1.0, "stimulus_1": [1.0, 1.5],
    ...                       "stimulus_2": [1.5, 1.0]})
    >>> animal = pd.DataFrame([{"subject": "s1", "weber_fraction": 0.01, "lapse_low": 0.0,
    ...                         "lapse_high": 0.0, "bias": 0.0}])
    >>> answer_trials(table, animal, percept=IdentityPercept(), seed=1).frame["count"].tolist()
    [1.0, 0.0]
    """
    asked = task_named(task)
    share = _checks.number("missing", missing, "write for example 0.02")
    _checks.non_negative("missing", share, "write for example 0.02")
    for name, frame in (("table", table), ("animals", animals)):
        lacking = set(NEEDED[name]) - set(getattr(frame, "columns", ()))
        if not isinstance(frame, pd.DataFrame) or lacking:
            raise ValueError(
                f"{name} must be a DataFrame with columns {', '.join(NEEDED[name])}, got "
                f"{f'none called {min(lacking)}' if hasattr(frame, 'columns') else frame!r}."
            )
    _checks.kind("percept", percept, "a Percept", "unit_sd", "write IdentityPercept(), say")
    keys = [name for name in ("subject", "session") if name in animals]
    truth = table[keys].merge(animals, how="left", on=keys, validate="many_to_one")
    unknown = truth["weber_fraction"].isna().to_numpy()
    if unknown.any():
        who = " ".join(str(value) for value in table[keys].iloc[int(np.argmax(unknown))])
        raise ValueError(f"The truth about {who} is not given; add a row of animals for it.")
    rng = _checks.generator(seed)
    columns = ("standard", "stimulus_1", "stimulus_2")
    standard, s1, s2 = (table[name].to_numpy(float) for name in columns)
    refuse_unfelt(percept, np.concatenate([s1, s2, standard]))
    p = np.empty(len(table))
    for _, own in truth.groupby(list(TRUTH), sort=False):
        rows = own.index.to_numpy()
        k, lapse_low, lapse_high, bias = (float(own[name].iloc[0]) for name in TRUTH)
        p[rows] = response_probability(
            asked, percept, s1[rows], s2[rows], standard=standard[rows], weber_fraction=k,
            lapse_low=lapse_low, lapse_high=lapse_high, bias=bias, noise=noise,
        )  # fmt: skip
    # Uniform numbers alone: the streams of the other distributions may change between versions.
    answer = (rng.random(p.size) < p).astype(float)
    answer[rng.random(p.size) < share] = np.nan
    frame = table[[name for name in LABELS if name in table]].assign(
        standard=standard, stimulus_1=s1, stimulus_2=s2, n=np.ones(p.size, np.int64), count=answer
    )
    return Trials(
        frame.reset_index(drop=True), asked, source="simulated trials", notes=notes_of(frame)
    )
