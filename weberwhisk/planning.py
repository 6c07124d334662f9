"""A plan as a folder of files: lists for the rig, a page to print, JSON to have it again."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from . import _checks
from .design.plan_file import plan_json
from .design.preregistration import preregistration
from .design.trial_lists import bpod_table, psychopy_tables
from .output import Run, atomic_write, csv_text

if TYPE_CHECKING:
    from .design import Plan


def write_plan(
    plan: Plan, out: str | os.PathLike[str], *, inputs: Mapping[str, Any] | None = None
) -> Path:
    """Write everything that an experiment needs into one folder; all of it or nothing.

    - ``plan.json``: the plan, for `read_plan` and `weberwhisk rehearse`;
    - ``plan.html``: one page to print; ``preregistration.txt``: its text;
    - ``trials.csv``: all trial lists, which `weberwhisk fit` reads with the answers added;
    - ``psychopy_<animal>_<session>.csv``: a conditions file for every session;
    - ``bpod.csv``: all trials as numbers alone;
    - ``planned_levels.csv``, ``planned_jnds.csv``, ``planned_power.csv`` and figures of them.

    Parameters
    ----------
    plan : Plan
    out : path
        Folder, made if it is missing.
    inputs : mapping, optional
        What was asked, for the record ``design.run.json``.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    ValueError
        As `weberwhisk.output.Run`: where the folder cannot be written or holds files of others.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> from weberwhisk import Whisker
    >>> from weberwhisk.design import Goal, Plan, Scheme, taper
    >>> scheme = Scheme([15e-3, 40e-3], [-2e-3, -1e-3, 1e-3, 2e-3])
    >>> plan = Plan(scheme, taper(Whisker(50e-3, 100e-6, 5e-6)), Goal(bayes_factor=10))
    >>> with TemporaryDirectory() as folder:
    ...     sorted(path.name for path in write_plan(plan, folder).glob("p*.csv"))
    ['planned_jnds.csv', 'planned_levels.csv', 'psychopy_s1_001.csv']
    """
    _checks.kind("plan", plan, "a Plan", "scheme", "write plan_experiment(...), say")
    with Run(out, "design", dict(inputs or {}), plan.seed) as run:
        fill(run, plan)
    assert run.out_dir is not None
    return run.out_dir


def fill(run: Run, plan: Plan) -> None:
    """The files of a plan, into a run that is open; nothing where it has no folder."""
    if run.out_dir is None:
        return
    from . import figures

    for name, text in (
        ("plan.json", plan_json(plan)),
        ("plan.html", figures.plan_page(plan)),
        ("preregistration.txt", preregistration(plan)),
        ("trials.csv", csv_text(plan.trials)),
        ("bpod.csv", csv_text(bpod_table(plan.trials))),
        *((f"{name}.csv", csv_text(table)) for name, table in psychopy_tables(plan.trials)),
    ):
        atomic_write(run.path(name), text)
    run.table("planned_levels", plan.levels)
    run.table("planned_jnds", plan.jnds)
    run.figure("planned_psychometric", figures.figure_of(figures.planned_psychometrics(plan)))
    run.figure("planned_jnd", figures.figure_of(figures.planned_jnds(plan)))
    if plan.power is not None:
        run.table("planned_power", plan.power)
        run.figure("planned_power", figures.figure_of(figures.planned_power(plan)))
