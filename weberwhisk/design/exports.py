"""Trial lists as rigs read them: PsychoPy's conditions files, a table for Bpod, and our own.

All are CSV with distances in millimetres. Column names are identifiers in Python and in MATLAB, as
PsychoPy asks of conditions files (`psychopy.data.importConditions`: unique, beginning with a
letter, no spaces or punctuation but underscores) and MATLAB's `readtable` keeps as they are.
"""

from __future__ import annotations

from collections.abc import Iterator

import pandas as pd

STIMULI = ("standard", "stimulus_1", "stimulus_2")
ANSWERS = ("left", "right")  # where the farther stimulus is 1, or 2


def own_table(lists: pd.DataFrame) -> pd.DataFrame:
    """All trials, as `weberwhisk fit` reads them once a column `choice` has been filled in.

    Parameters
    ----------
    lists : DataFrame
        From `trial_lists`, in metres.

    Examples
    --------
    >>> from weberwhisk.design import Scheme, trial_lists
    >>> lists = trial_lists(Scheme([20e-3], [-2e-3, 2e-3], 2), seed=1)
    >>> own_table(lists).columns[4:].tolist()
    ['level', 'standard_mm', 'stimulus_1_mm', 'stimulus_2_mm', 'greater']
    """
    table = lists.assign(**{name: lists[name].map(in_millimetres) for name in STIMULI})
    return table.rename(columns={name: f"{name}_mm" for name in STIMULI})


def psychopy_tables(lists: pd.DataFrame) -> Iterator[tuple[str, pd.DataFrame]]:
    """A conditions file for each session of each animal, with its name.

    The names are those that PsychoPy's own participant and session make:
    `$"psychopy_" + expInfo["participant"] + "_" + expInfo["session"] + ".csv"`, with sessions 001,
    002 and so on; the loop takes it in sequential order, once. `correct_answer` is what a keyboard
    component takes as its correct answer. The number of the trial is not called `trial`, which is
    the name of a routine there.

    Examples
    --------
    >>> from weberwhisk.design import Scheme, trial_lists
    >>> lists = trial_lists(Scheme([20e-3], [-2e-3, 2e-3], 2), seed=1)
    >>> [(name, len(table)) for name, table in psychopy_tables(lists)]
    [('psychopy_s1_001', 4)]
    """
    table = own_table(lists).rename(columns={"trial": "trial_number"})
    table["correct_answer"] = [ANSWERS[greater - 1] for greater in table["greater"]]
    for (subject, session), own in table.groupby(["subject", "session"], sort=False):
        yield f"psychopy_{subject}_{session:03d}", own


def bpod_table(lists: pd.DataFrame) -> pd.DataFrame:
    """All trials in numbers alone, so that MATLAB's `readtable` or `readmatrix` takes them.

    `trial_type` is that of Bpod's examples, 1 where left is right and 2 where right is:
    `T = readtable("bpod.csv"); TrialTypes = T.trial_type(T.subject == 1 & T.session == 3)';`

    Examples
    --------
    >>> from weberwhisk.design import Scheme, trial_lists
    >>> lists = trial_lists(Scheme([20e-3], [-2e-3, 2e-3], 2), seed=1)
    >>> bpod_table(lists).columns[:5].tolist()
    ['subject', 'session', 'block', 'trial', 'trial_type']
    """
    table = own_table(lists)
    table["subject"] = table["subject"].str.removeprefix("s").astype(int)
    table.insert(4, "trial_type", table.pop("greater"))
    return table


def in_millimetres(metres: float) -> float:
    """A length as one would write it: 20.1, not 20.100000000000001."""
    return float(f"{metres * 1e3:.9g}")
