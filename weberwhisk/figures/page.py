"""A plan on one page of paper, and as a folder: lists for the rig, JSON to have it again."""

from __future__ import annotations

import base64
import io
import os
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .. import _checks
from ..design.plan_file import plan_json
from ..design.preregistration import assumptions, offsets_in_words, preregistration
from ..design.trial_lists import bpod_table, psychopy_tables
from ..output import Run, atomic_write, csv_text
from .designs import planned_jnds, planned_power, planned_psychometrics
from .style import DOUBLE, figure_of, new_figure, styled

if TYPE_CHECKING:
    from ..design import Plan


STYLE = """
@page { size: A4; margin: 9mm 11mm; }
body { font: 7.3pt/1.28 "Helvetica Neue", Arial, "DejaVu Sans", sans-serif; color: #111;
  max-width: 188mm; margin: 0 auto; }
h1 { font-size: 13pt; margin: 0 0 1mm; }
h2 { font-size: 9pt; margin: 2.5mm 0 1mm; }
p, ul { margin: 0 0 1mm; }
ul { padding-left: 4mm; }
img { display: block; }
table { border-collapse: collapse; width: 100%; }
td, th { text-align: left; padding: 0.3mm 2mm 0.3mm 0; vertical-align: top; font-weight: normal; }
th { color: #555; white-space: nowrap; }
td:last-child { width: 100%; }
.half { max-width: 50%; }
.two { display: flex; gap: 5mm; } .two > * { flex: 1; min-width: 0; }
.paste { columns: 2; column-gap: 5mm; text-align: left; }
.paste p { orphans: 3; widows: 3; }
"""


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
    >>> from weberwhisk import Whisker
    >>> from weberwhisk.design import Goal, Plan, Scheme, taper
    >>> scheme = Scheme([15e-3, 40e-3], [-2e-3, -1e-3, 1e-3, 2e-3])
    >>> plan = Plan(scheme, taper(Whisker(50e-3, 100e-6, 5e-6)), Goal(bayes_factor=10))
    >>> plan_page(plan).startswith("<!DOCTYPE html>")
    True
    """
    wide = 100 if len(plan.scheme.standards) > 1 else 50
    title, *paragraphs = preregistration(plan).strip().split("\n\n")
    return f"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>
<style>{STYLE}</style></head><body>
<h1>{escape(title)}</h1>
<div class="two"><div>{_table(_numbers(plan))}</div>
<div><h2 style="margin-top:0">Assumptions</h2><ul>{_items(assumptions(plan))}</ul></div></div>
<h2>What is expected of a typical animal</h2>
<p>Bars of shares hold 95 % of what chance makes of one animal's trials. Bands and bars of JNDs are
predicted 95 % intervals, of all its trials and of each standard's. Bars of power are Monte Carlo
errors (95 %).</p>
{_image(figure_of(planned_psychometrics(plan)), "Expected psychometric functions", wide)}
<div class="two">{"".join(_half(*half) for half in _halves(plan))}</div>
<h2>Text for a preregistration</h2>
<div class="paste">{"".join(_paragraph(p) for p in paragraphs)}</div>
</body></html>
"""


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
def _halves(plan: Plan) -> list[tuple[Any, str]]:
    jnd = new_figure(DOUBLE / 2, 2.0)
    planned_jnds(plan, jnd.subplots())
    halves = [(jnd, "Expected JND curves")]
    if plan.power is not None:
        power = new_figure(DOUBLE / 2, 2.0)
        planned_power(plan, power.subplots())
        halves.append((power, "Power"))
    return halves


def _image(figure: Any, alt: str, percent: int = 100) -> str:
    content = io.BytesIO()
    figure.savefig(content, format="svg", metadata={"Date": None})
    text = base64.b64encode(content.getvalue()).decode("ascii")
    source = f"data:image/svg+xml;base64,{text}"
    return f'<img alt="{escape(alt)}" style="width: {percent}%" src="{source}">'


def _half(figure: Any, alt: str) -> str:
    return f'<div class="half">{_image(figure, alt)}</div>'


def _table(rows: Sequence[tuple[str, str]]) -> str:
    inner = "".join(f"<tr><th>{escape(a)}</th><td>{escape(b)}</td></tr>" for a, b in rows)
    return f"<table>{inner}</table>"


def _items(lines: Sequence[str]) -> str:
    return "".join(f"<li>{escape(line)}</li>" for line in lines)


def _paragraph(text: str) -> str:
    head, _, rest = " ".join(text.split()).partition(". ")
    return f"<p><b>{escape(head)}.</b> {escape(rest)}</p>"


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
        run.figure("planned_power", planned_power(plan))
