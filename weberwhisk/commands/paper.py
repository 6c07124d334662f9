"""`weberwhisk paper`: its figures and claims, with what is found; `chart`: speed and accuracy."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

import weberwhisk as ww

from .. import surveys
from ..cli import progress
from ..cues import Compliance
from ..mechanics.muscle import MuscleCurve
from ..output import Run, atomic_write, to_json
from .figure import Asked, figure_4a, figure_4b
from .options import command, wrote

if TYPE_CHECKING:
    import pandas as pd


#: The paper's figures in its order, with what each shows.
PANELS = {
    "figure-1d": "1d. dM/dθ is monotonic in radial distance.",
    "figure-2": "2a–f. Large bending of a tapered whisker (radius ratio 20) and a cylinder.",
    "figure-3": "3a–c. Balance of moments: angle of balance, by distance and impact angle.",
    "figure-4a": "4a. JND of radial distance by compliance: closed forms, and posteriors.",
    "figure-4b": "4b. JND by moment and axial force, noise in the moment alone.",
}


@command
def paper(
    short: Annotated[bool, "Few posteriors: seconds."] = False,
    seed: int = surveys.SEED,
    out: Annotated[Path, "Folder for figures and paper.md.", {"metavar": "FOLDER"}] = Path("paper"),
    as_json: bool = False,
) -> None:
    """Every figure of Solomon & Hartmann (2011), and every claim with what we find.

    Writes figures 1d, 2a-f, 3a-c, 4a and 4b with their tables, and paper.md: each equation and
    claim, the numbers found now, the test that shows it, and where the sentence ends.
    """
    from .. import paper as remade
    from ..paper import claims

    inputs = {"radius_ratio": float(surveys.WHISKER.radius_ratio), "short": short}
    with Run(out, "paper", inputs, seed) as run:
        with progress("The paper's figures", len(PANELS) + 1, as_json=as_json) as advance:
            made: dict[str, tuple[dict[str, pd.DataFrame], Any]] = {}
            rates = moment_rates()
            drawn = ww.figures.paper_1d(rates)
            made["figure-1d"] = {"figure-1d": rates}, drawn
            advance()
            arcs, degrees = (remade.ARCS, remade.DEGREES)
            table = remade.contacts(arcs, degrees[::3] if short else degrees)
            chart = ww.figures.paper_2(remade.examples(), remade.lines(), table)
            made["figure-2"] = {"figure-2": table}, chart
            advance()
            step = slice(None, None, 5 if short else 1)
            place, impact = remade.DISTANCES[step], remade.IMPACTS[step]
            a, b = remade.moments(), remade.balance_angles()
            c = remade.surface(MuscleCurve.NORMALISED, place, impact)
            line, angle = remade.dashed_line()
            edge = (line[step], angle[step])
            chart = ww.figures.paper_3(a, remade.muscle(), b, c, edge)
            made["figure-3"] = {"figure-3a": a, "figure-3b": b, "figure-3c": c}, chart
            advance()
            for name, make in (("figure-4a", figure_4a), ("figure-4b", figure_4b)):
                made[name] = make(Asked(short=short, seed=seed))
                advance()
            rows = list(claims.rows())
            advance()
        for name, (tables, chart) in made.items():
            for key, each in tables.items():
                run.table(key, each)
            run.figure(name, chart)
        atomic_write(run.path("paper.md"), as_markdown(rows))
    if as_json:
        print(to_json({"claims": rows, "files": run.files}))
        return
    wrote(run)


def moment_rates() -> pd.DataFrame:
    """Figure 1d: dM/dθ in units of EI/L against r/L, for a cone, R = 20 and a cylinder."""
    import pandas as pd

    from ..paper.claims import CONE, CYLINDER

    share, tables = np.linspace(0.02, 0.995, 200), []
    for name, whisker in (
        ("cone", CONE), ("tapered, R = 20", surveys.WHISKER), ("cylinder", CYLINDER)
    ):  # fmt: skip
        rate = Compliance().signals(whisker, share[:, None] * whisker.length)[0][:, 0]
        columns = {"radial_distance": share, "rate": rate / whisker.moment_scale}
        tables.append(pd.DataFrame(columns).assign(whisker=name))
    return pd.concat(tables, ignore_index=True)


def as_markdown(rows: list[dict[str, str]]) -> str:
    """The claims beside what is found, with the figures."""
    lines = [
        "# Radial distance and Weber's law, remade",
        "",
        "Solomon JH, Hartmann MJZ (2011) *Phil. Trans. R. Soc. B* 366:3049, "
        "doi:10.1098/rstb.2011.0166. Numbers are computed by `weberwhisk paper`; values called the "
        "paper's are those of its text. A whisker of 50 mm, radius ratio 20, and k = 0.1 unless "
        "said otherwise; lengths over L.",
    ]
    for name, words in PANELS.items():
        lines += ["", f"**Figure {words}**", "", f"![{words}]({name}.png)"]
    lines += [
        "",
        "| where | the paper says | we find | where the sentence ends | shown by |",
        "|---|---|---|---|---|",
    ]
    for row in rows:
        cells = [row["where"], row["claim"], row["found"], row["limit"] or "–", f"`{row['test']}`"]
        lines.append(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |")
    return "\n".join(lines) + "\n"


@command
def chart(
    full: Annotated[bool, "Every setting and more data: some ten minutes."] = False,
    out: Path = Path("chart"),
    as_json: bool = False,
) -> None:
    """Chart error against CPU time: beams, posteriors, JND curves and fits, and how each grows.

    Takes about half a minute; with --full ten. Every method is swept over its own knob; time and
    error are of the same run. What needs other packages (PyElastica, dynesty, psignifit and so on)
    is added by analyses/speed_accuracy.py.
    """
    import pandas as pd

    from .. import charts, figures

    foot = charts.machine()
    tables = {}
    with Run(out, "chart", {"full": full, "machine": foot}) as run:
        with progress("Charting", len(charts.PARTS), as_json=as_json) as advance:
            for name, measure in charts.PARTS.items():
                tables[name] = measure(full=full)
                run.table(name, tables[name])
                advance()
        table = pd.concat(tables.values(), ignore_index=True)
        run.figure("speed_accuracy", figures.speed_accuracy(table, foot=foot))
        run.figure("fits_and_growth", figures.fits_and_growth(table, foot=foot))
    if as_json:
        print(to_json({"machine": foot, "rows": table.to_dict("records")}))
        return
    print(foot)
    for name, rows in tables.items():
        shown = rows.drop(columns="part").dropna(axis="columns", how="all")
        print(f"\n{name}\n{shown.to_string(index=False, float_format='{:.3g}'.format)}")
    wrote(run)
