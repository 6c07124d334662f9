"""`weberwhisk analyse`: the analysis that a plan lays down, of a rig's own table."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np

import weberwhisk as ww

from ..behaviour.trials import STIMULI
from ..citing import versions_in_words
from ..output import Run, atomic_write, to_json
from ..tables import load_table
from .options import command, wrote

if TYPE_CHECKING:
    import pandas as pd

    from ..design import AnalysisResult

#: What rigs call an answer, and what their codes mean: PsychoPy's keyboard, and 1 or 2 for left or
#: right in a table for Bpod (see `weberwhisk.design.trial_lists`).
SIDES = {"left": "first", "right": "second", 1: "first", 2: "second"}


@command
def analyse(
    file: Annotated[Path, "plan.json, as `weberwhisk design` writes it.", {"metavar": "PLAN"}],
    data: Annotated[list[Path], "Tables of trials.", {"metavar": "DATA..."}],
    out: Path | None = None,
    as_json: bool = False,
) -> None:
    """The preregistered analysis of a plan, on PsychoPy's output or a table for Bpod.

    The tables have the columns of the trial lists, and an answer: PsychoPy's <keyboard>.keys (left
    or right), `response` (1 left, 2 right) or `choice` (1 where the second was judged farther).
    """
    for path in (file, *data):
        if not path.is_file():
            raise ValueError(f"{str(path)!r} is not a file; name a plan.json and tables of trials.")
    plan = ww.read_plan(file)
    trials = rig_trials(data)
    inputs = {"plan": str(file), "trials_sha256": plan.fingerprint, "data": [str(d) for d in data]}
    with Run(out, "analyse", inputs) as run:
        found = plan.analyse(trials, unit=1e-3)
        words = in_words(found, trials, plan)
        run.table("analysis", found.estimates)
        if run.out_dir is not None:
            atomic_write(run.path("analysis.txt"), words)
    if as_json:
        shown = {"log_evidence": found.log_evidence, "favoured": found.favoured()}
        rows = found.estimates.to_dict("records")
        print(to_json({**shown, "left_out": list(found.left_out), "rows": rows}))
        return
    print(words, end="")
    wrote(run)


def rig_trials(files: list[Path]) -> ww.Trials:
    """The trials in one rig's tables, in mm; rows without a stimulus are no trials."""
    import pandas as pd

    tables = [load_table(path)[0] for path in files]
    table = pd.concat(tables, ignore_index=True)
    named = {name: f"{name}_mm" for name in STIMULI if f"{name}_mm" in table}
    if "stimulus_1" in named:
        table = table[table[named["stimulus_1"]].notna()]
    if "trial" not in table and "trial_number" in table:
        named["trial"] = "trial_number"
    labels = None
    if "choice" not in table:
        table = _with_choice(table, files[0])
        labels = {side: which for side, which in SIDES.items() if side in set(table["choice"])}
    return ww.read_trials(table, columns=named, choice_labels=labels)


def _with_choice(table: pd.DataFrame, file: Path) -> pd.DataFrame:
    """The table with its column of answers as `choice`: codes of `SIDES`, or none."""
    keys = [str(name) for name in table if str(name).endswith(".keys")]
    found = [*keys, *(name for name in ("response",) if name in table)]
    if len(found) != 1:
        raise ValueError(
            f"{str(file)!r}: there is no one column of answers, got {', '.join(found) or 'none'}; "
            "call it choice (1 where the second was judged farther), response or <keyboard>.keys."
        )
    given = table[found[0]].map(lambda v: int(v) if isinstance(v, float) and v == v else v)
    return table.assign(choice=given.where(given.isin(list(SIDES)), None))


def in_words(found: AnalysisResult, trials: ww.Trials, plan: ww.design.Plan) -> str:
    """What the planned analysis finds."""
    lines = [
        f"{plan.title}. {trials.n_trials} trials with an answer of {max(len(trials.subjects), 1)} "
        f"animals, analysed as planned; {plan.scheme.total_trials} were planned."
    ]
    for row in found.estimates.to_dict("records"):
        lines.append(
            f"{row['hypothesis']}, {row['subject']}: k = {row['weber_fraction']:.3g}, 95 % between "
            f"{row['lower']:.3g} and {row['upper']:.3g} ({row['status'].lower()})."
        )
    if found.left_out:
        lines.append(f"Left out, as planned: {', '.join(found.left_out)}.")
    if len(found.log_evidence) > 1:
        best = max(found.log_evidence, key=lambda name: found.log_evidence[name])
        size = found.log_bayes_factor(best) / np.log(10)
        need = plan.goal.bayes_factor or 10.0
        verdict = "which meets" if size > np.log10(need) else "which does not meet"
        lines.append(
            f"Best: {best}, by a Bayes factor of 10^{size:.2f}, {verdict} the planned {need:g}."
        )
    lines.append(f"Software: {versions_in_words('numpy', 'scipy')}.")
    return "\n".join(lines) + "\n"
