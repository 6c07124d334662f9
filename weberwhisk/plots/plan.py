"""A plan on one page of paper, and as a folder of everything that an experiment needs."""

from __future__ import annotations

import base64
import io
import os
from collections.abc import Callable, Iterable, Mapping
from html import escape
from importlib import resources
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Any

from .._util import checks
from .._util.output import Run, atomic_write, csv_text
from ..design.plan_file import assumptions, offsets_in_words, plan_json, preregistration
from ..design.session import bpod_table, psychopy_tables
from .designs import planned_jnds, planned_psychometrics, power_curve
from .style import DOUBLE, figure_of, new_figure, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ..design import Plan

__all__ = ["fill", "plan_page", "write_plan"]


def plan_page(plan: Plan) -> str:
    """The plan on one A4 page: numbers, expected curves, assumptions, preregistration.

    Parameters
    ----------
    plan : Plan

    Returns
    -------
    str
        HTML of one file; figures are inside it, as SVG.

    Examples
    --------
    >>> from weberwhisk import plan_experiment
    >>> plan = plan_experiment("C2", standards=[10e-3, 30e-3], trials=10, runs=0)
    >>> plan_page(plan).startswith("<!DOCTYPE html>")
    True
    """
    title, *paragraphs = preregistration(plan).strip().split("\n\n")
    wide = 100 if len(plan.scheme.standards) > 1 else 50
    halves = [_image(_half(planned_jnds, plan), "Expected JND curves")]
    if plan.power is not None:
        halves.append(_image(_half(power_curve, plan), "Power"))
    psychometrics = figure_of(planned_psychometrics(plan))
    heads = (" ".join(p.split()).partition(". ") for p in paragraphs)
    page = resources.files("weberwhisk").joinpath("data/plan.html").read_text("utf-8")
    return Template(page).substitute(
        title=escape(title),
        numbers=_each("<tr><th>{}</th><td>{}</td></tr>", _numbers(plan)),
        assumptions=_each("<li>{}</li>", ((line,) for line in assumptions(plan))),
        psychometrics=_image(psychometrics, "Expected psychometric functions", wide),
        halves="".join(f'<div class="half">{half}</div>' for half in halves),
        preregistration=_each("<p><b>{}.</b> {}</p>", ((h, rest) for h, _, rest in heads)),
    )


def _each(form: str, rows: Iterable[tuple[str, ...]]) -> str:
    """Every row of texts in a form of HTML."""
    return "".join(form.format(*map(escape, row)) for row in rows)


def _numbers(plan: Plan) -> list[tuple[str, str]]:
    scheme = plan.scheme
    return [
        ("Goal", str(plan.goal)),
        ("Hypotheses", ", ".join(h.name for h in plan.hypotheses)),
        ("Animals", f"{scheme.animals}"),
        ("Trials", f"{scheme.n_trials} an animal, {scheme.total_trials} in all"),
        ("Sessions", f"{plan.sessions} an animal, of at most {plan.trials_per_session} trials"),
        ("Standards", ", ".join(f"{s * 1e3:.4g}" for s in scheme.standards) + " mm"),
        *((f"Offsets at {s * 1e3:.4g} mm", f"{offsets_in_words(row)} mm")
          for s, row in zip(scheme.standards, scheme.offsets, strict=True)),
    ]  # fmt: skip


@styled
def _half(draw: Callable[[Plan, Axes], Any], plan: Plan) -> Any:
    figure = new_figure(DOUBLE / 2, 2.0)
    draw(plan, figure.subplots())
    return figure


def _image(figure: Any, alt: str, percent: int = 100) -> str:
    content = io.BytesIO()
    figure.savefig(content, format="svg", metadata={"Date": None})
    text = base64.b64encode(content.getvalue()).decode("ascii")
    source = f"data:image/svg+xml;base64,{text}"
    return f'<img alt="{escape(alt)}" style="width: {percent}%" src="{source}">'


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
        As `Run`: where the folder cannot be written or holds files of others.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> from weberwhisk import plan_experiment
    >>> plan = plan_experiment("C2", standards=[10e-3, 30e-3], trials=10, runs=0)
    >>> with TemporaryDirectory() as folder:
    ...     sorted(path.name for path in write_plan(plan, folder).glob("p*.csv"))
    ['planned_jnds.csv', 'planned_levels.csv', 'psychopy_s1_001.csv']
    """
    checks.kind("plan", plan, "a Plan", "scheme", "write ww.plan_experiment(...), say")
    with Run(out, "design", dict(inputs or {}), plan.seed) as run:
        fill(run, plan)
    assert run.out_dir is not None
    return run.out_dir


def fill(run: Run, plan: Plan) -> None:
    """The files of a plan, into a run that is open; nothing where it has no folder."""
    if run.out_dir is None:
        return
    for name, text in (
        ("plan.json", plan_json(plan)),
        ("plan.html", plan_page(plan)),
        ("preregistration.txt", preregistration(plan)),
        ("trials.csv", csv_text(plan.trials)),
        ("bpod.csv", csv_text(bpod_table(plan.trials))),
        *((f"{name}.csv", csv_text(table)) for name, table in psychopy_tables(plan.trials)),
    ):
        atomic_write(run.path(name), text)
    run.table("planned_levels", plan.levels)
    run.table("planned_jnds", plan.jnds)
    run.figure("planned_psychometric", planned_psychometrics(plan))
    run.figure("planned_jnd", planned_jnds(plan))
    if plan.power is not None:
        run.table("planned_power", plan.power)
        run.figure("planned_power", power_curve(plan))
