"""What the pages in a browser compute. It runs in Pyodide, and in any Python that has weberwhisk.

Each page's function takes the fields of its form, as text, and returns what to show: ``texts``,
``figures`` (SVG), ``tables``, ``files`` to keep, ``menus`` to choose from and fields to ``set``.
"""

from __future__ import annotations

import base64
import io
import json
import re
import tempfile
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import weberwhisk as ww
from weberwhisk import plots
from weberwhisk.behaviour import CueEncoding
from weberwhisk.design import Evidence, Precision, SubjectPopulation
from weberwhisk.design.plan_file import preregistration
from weberwhisk.recordings.tables import load_table

Fields = dict[str, str]
Shown = dict[str, Any]

NONE = ""  # of a menu
ANSWERS = {
    "choice": "which stimulus was greater, or farther",
    "correct": "right or wrong, 1 or 0",
    "n_greater": "a count: second called greater",
    "n_correct": "a count: right",
}


def call(name: str, fields: str) -> str:
    """One of the pages' functions, in JSON; what is wrong with the fields is shown, not raised."""
    try:
        return json.dumps(CALLS[name](json.loads(fields)))
    except ValueError as error:
        return json.dumps({"error": str(error)})


def jnd(fields: Fields) -> Shown:
    """The JND of radial distance along a whisker and a cylinder, and the whisker's force map."""
    whisker, k = _whisker(fields), float(fields["weber_fraction"])
    cylinder = ww.Whisker(whisker.length, whisker.base_radius, whisker.base_radius)
    distances = whisker.length * np.linspace(0.06, 0.96, 16)
    curves = {}
    for name, shape in (("tapered", whisker), ("cylinder", cylinder)):
        observer = ww.Observer(shape, ww.cues.Compliance(), ww.receptors.Weber(k))
        curves[name] = ww.jnd_curve(
            observer, distances, criterion=fields["criterion"], n_readings=60, seed=1
        )
    columns = ["radial_distance_mm", "closed_form_mm", "posterior_mm", "posterior_error_mm"]
    table = pd.concat(
        {name: curve.table.reset_index()[columns] for name, curve in curves.items()},
        names=["whisker", None],
    ).reset_index("whisker")
    middle = {name: np.interp(0.6 * whisker.length, distances, c["posterior"] * 1e3)
              for name, c in curves.items()}  # fmt: skip
    sentence = (
        f"At 0.6 of the length, {0.6e3 * whisker.length:.3g} mm from the base, the JND is "
        f"{middle['tapered']:.3g} mm through this whisker and {middle['cylinder']:.3g} mm through "
        f"a cylinder as thick at its base ({fields['criterion']})."
    )
    return {
        "texts": [_text("In words", sentence)],
        "figures": [
            _figure("JND of radial distance, felt in a light tap", plots.jnd_lines(curves)),
            _figure("Force map: what the base feels of a contact", _force_map(whisker)),
        ],
        "tables": [_table("The curve", table)],
        "files": [_file("jnd.csv", table.to_csv(index=False))],
    }


def mean_whisker(fields: Fields) -> Shown:
    """The sliders of the mean whisker of a follicle."""
    shape = ww.Whisker.from_identity(fields["identity"])
    return {"set": {
        "length_mm": round(shape.length * 1e3, 1),
        "base_radius_um": round(shape.base_radius * 1e6, 1),
        "tip_radius_um": round(shape.tip_radius * 1e6, 2),
    }}  # fmt: skip


def columns(fields: Fields) -> Shown:
    """What a file has, as menus: a guess at which column is which."""
    raw = load_table(fields["file"]).frame
    names = [str(name) for name in raw.columns]
    values = {
        name: raw[name].dropna().astype(str).drop_duplicates().tolist()[:200] for name in names
    }
    answer = next((name for name in names if name in ANSWERS), NONE)
    here: list[list[str]] = [[name, name] for name in names]
    optional = [[NONE, "none"], *here]

    def guess(*candidates: str) -> str:
        return next((name for name in candidates if name in names), NONE)

    return {
        "menus": [
            _menu("first", "First stimulus, or standard", here, guess("stimulus_1", "standard")),
            _menu("second", "Second stimulus", here, guess("stimulus_2", "comparison")),
            _menu("answer", "Answer", here, answer or names[-1]),
            _menu("kind", "The answer is", list(map(list, ANSWERS.items())), answer or "choice"),
            _menu("greater", "Answer that says: second greater", [[NONE, "1"]], NONE)
            | {"values_of": "answer", "values": {k: v for k, v in values.items() if len(v) == 2}},
            _menu("n", "Trials in a row, of counts", optional, guess("n")),
            _menu("subject", "Animal", optional, guess("subject")),
            _menu("of", "Which animal", [[NONE, "all, fitted together"]], NONE)
            | {"values_of": "subject", "values": values},
            _menu("session", "Session", optional, guess("session")),
        ],
        "texts": [_text("File", f"{len(raw)} rows, {len(names)} columns.")],
    }


def fit(fields: Fields) -> Shown:
    """The Weber fraction of a table of choices."""
    trials, encoding = _trials(fields)
    if len(trials.subjects) > 1:
        return _together(trials, encoding)
    found = ww.fit_weber(trials, encoding=encoding)
    report, summary = found.report(), found.summary().reset_index()
    methods = found.methods()
    shown: Shown = {
        "texts": [_text("Report", report), _text("For a methods section", methods)],
        "tables": [_table("Estimates", summary)],
        "files": [
            _file("fit_report.txt", f"{report}\n{methods}\n"),
            _file("fit.csv", summary.to_csv(index=False)),
        ],
    }
    if trials.n_trials:
        drawn = plots.psychometrics(found, unit="mm" if encoding else "")
        shown["figures"] = [_figure("Choices, and the fitted curves with 95 % bands", drawn)]
    return shown


def plan(fields: Fields) -> Shown:
    """The levels, trial lists and expectations of an experiment."""
    width = fields["goal"] == "interval"
    made = ww.plan_experiment(
        _whisker(fields),
        goal=Precision(half_width=0.2) if width else Evidence(bayes_factor=10.0),
        standards=[float(s) * 1e-3 for s in fields["standards_mm"].replace(",", " ").split()]
        or None,
        trials=int(fields["trials"]),
        animals=int(fields["animals"]),
        expected=SubjectPopulation(weber_fraction=float(fields["weber_fraction"])),
        trials_per_session=int(fields["trials_per_session"]),
        runs=int(fields["runs"]),
        seed=int(fields["seed"]),
        progress=lambda more: None,
    )
    lists = made.trials
    first = lists[(lists["subject"] == lists["subject"].iloc[0]) & (lists["session"] == 1)]
    text = re.sub(r"(?<!\n)\n(?!\n)", " ", preregistration(made))  # its lines were wrapped
    size = (
        f"{made.scheme.total_trials} trials in all: {made.scheme.animals} × "
        f"{made.scheme.n_trials}, in {made.sessions} sessions each. {made.power_in_words()}"
    )
    return {
        "texts": [_text("Size", size), _text("For a preregistration", text) | {"folded": True}],
        "figures": [
            _figure("What a typical animal is expected to answer",
                    plots.planned_psychometrics(made)),
            _figure("Expected JND along the whisker", plots.planned_jnds(made)),
        ],
        "tables": [
            _table("Levels", made.levels),
            _table("First animal's first session", first),
        ],
        "files": [_plan_folder(made)],
    }  # fmt: skip


CALLS = {"jnd": jnd, "mean_whisker": mean_whisker, "columns": columns, "fit": fit, "plan": plan}


def _whisker(fields: Fields) -> ww.Whisker:
    return ww.Whisker(
        float(fields["length_mm"]) * 1e-3,
        float(fields["base_radius_um"]) * 1e-6,
        float(fields["tip_radius_um"]) * 1e-6,
    )


def _trials(fields: Fields) -> tuple[ww.Trials, CueEncoding | None]:
    kind = fields["kind"]
    named = {"stimulus_1": fields["first"], "stimulus_2": fields["second"], kind: fields["answer"]}
    for ours, field in (("n", "n"), ("subject", "subject"), ("session", "session")):
        if fields[field] and (ours != "n" or kind.startswith("n_")):
            named[ours] = fields[field]
    labels = None
    if kind == "choice" and fields["greater"]:
        said = load_table(fields["file"]).frame[fields["answer"]].dropna().drop_duplicates()
        labels = {v: "second" if str(v) == fields["greater"] else "first" for v in said}
    encoding = None
    if fields["scale"] == "whisker":
        encoding = CueEncoding(ww.Observer(_whisker(fields), ww.cues.Compliance()), unit=1e-3)
    trials = ww.read_trials(
        fields["file"], columns=named, choice_labels=labels,
        scale="log" if fields["scale"] == "log" else "linear",
    )  # fmt: skip
    return (trials.select(subject=fields["of"]) if fields["of"] else trials), encoding


def _together(trials: ww.Trials, encoding: CueEncoding | None) -> Shown:
    found = ww.fit_population(trials, encoding=encoding)
    summary = found.summary().reset_index()
    said = "\n".join([f"{found.status.value}.", *found.notes])
    shown: Shown = {
        "texts": [
            _text("Report", said[:1].upper() + said[1:]),
            _text("For a methods section", found.methods()),
        ],
        "tables": [_table("The population", summary), _table("The animals", found.subjects)],
        "files": [_file("animals.csv", found.subjects.to_csv(index=False))],
    }
    if found.population is not None:
        shown["figures"] = [_figure("Each animal, alone and among others", plots.shrinkage(found))]
    return shown


@plots.styled
def _force_map(whisker: ww.Whisker) -> Any:
    """Moment against axial force: lines of one distance, crossed by lines of one deflection."""
    ax = plots.new_figure(4.2, 2.8).subplots()
    distances = np.linspace(0.3, 0.9, 5) * whisker.length
    degrees, crossing = np.geomspace(0.5, 40.0, 80), (2, 5, 10, 20)
    bent = ww.press(whisker, distances[:, None], np.radians(degrees))
    for i, distance in enumerate(distances):
        name = f"r = {distance * 1e3:.3g} mm"
        ax.plot(bent.axial_force[i] * 1e6, bent.moment[i] * 1e9, color=plots.COLOURS[i],
                linestyle=plots.LINES[i % len(plots.LINES)], label=name)  # fmt: skip
    along = ww.press(
        whisker, np.linspace(0.3, 0.9, 60) * whisker.length, np.radians(crossing)[:, None]
    )
    for i in range(len(crossing)):
        name = f"deflection {', '.join(map(str, crossing))}°" if i == 0 else None
        ax.plot(along.axial_force[i] * 1e6, along.moment[i] * 1e9, color="0.6", linewidth=0.8,
                zorder=0, label=name)  # fmt: skip
    ax.set(xscale="log", yscale="log", xlabel="Axial force (µN)", ylabel="Moment (nN m)")
    ax.figure.legend(loc="outside upper center", ncols=3)
    return ax


def _plan_folder(made: Any) -> Shown:
    """Every file of the plan, as `write_plan` writes them, in one archive."""
    content = io.BytesIO()
    with tempfile.TemporaryDirectory() as folder:
        written = ww.write_plan(made, Path(folder, "plan"))
        with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
            for path in sorted(written.rglob("*")):
                archive.write(path, Path("plan", path.relative_to(written)))
    return _file("plan.zip", content.getvalue())


# -- what a page can show -------------------------------------------------------------------------


def _text(title: str, body: str) -> Shown:
    return {"title": title, "body": body}


def _figure(title: str, drawn: Any) -> Shown:
    svg = io.StringIO()
    plots.figure_of(drawn).savefig(svg, format="svg", metadata={"Date": None})
    return {"title": title, "svg": svg.getvalue()}


def _table(title: str, table: pd.DataFrame) -> Shown:
    def cell(value: Any) -> str:
        if isinstance(value, float | np.floating):
            return "–" if np.isnan(value) else f"{value:.4g}"
        return str(value)

    rows = [[cell(value) for value in row] for row in table.itertuples(index=False)]
    return {"title": title, "columns": [str(name) for name in table.columns], "rows": rows}


def _file(name: str, content: str | bytes) -> Shown:
    data = content.encode() if isinstance(content, str) else content
    return {"name": name, "base64": base64.b64encode(data).decode()}


def _menu(name: str, label: str, options: list[list[str]], value: str) -> Shown:
    return {"name": name, "label": label, "options": options, "value": value}
