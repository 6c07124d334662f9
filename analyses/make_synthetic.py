"""Make `data_synthetic/`: simulated choices and a tracked session, each with its truth beside it.

    python analyses/make_synthetic.py [folder]

The same bytes come out every time; `tests/analyses/test_data_synthetic.py` holds it to that, and
every table to what is expected of its fit.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
from command import ANALYSES, options
from tracked_session import simulate_tracking

from weberwhisk import Observer, Whisker, cues
from weberwhisk.behaviour import CueEncoding, Trials, simulate_population, simulate_trials
from weberwhisk.behaviour.trials import STIMULI

#: What columns of tables hold.
DESCRIPTIONS = {
    "subject": "who answered",
    "session": "session, from 1",
    "trial": "trial within the session, from 1",
    "standard": "stimulus that the others are compared with",
    "stimulus_1": "first stimulus",
    "stimulus_2": "second stimulus",
    "n": "trials in this row",
    "choice": "1: the second was reported greater, 0: the first; empty: no answer",
    "correct": "1: right, 0: wrong; empty: no answer",
    "n_greater": "of these trials, how many reported the second greater",
    "n_correct": "of these trials, how many were right",
}
#: Radial distances are in millimetres.
WHISKERS = {
    "tapered": Whisker(length=50e-3, base_radius=100e-6, tip_radius=5e-6),
    "cylinder": Whisker(length=50e-3, base_radius=100e-6, tip_radius=100e-6),
}
DISTANCES: dict[str, Any] = {
    "weber_fraction": 0.1,
    "lapse_low": 0.02,
    "lapse_high": 0.02,
    "standards": [15.0, 30.0, 42.5],
    "offsets": [-0.15, -0.1, -0.05, 0.0, 0.05, 0.1, 0.15],
    "trials_per_level": 25,
}
# Each: a title, the unit, a seed, what is given to the simulation, and the status of a fit
# (null: a matter of luck).
DATASETS: dict[str, dict[str, Any]] = {
    "weights_three_standards": {
        "title": "Lifted weights: one observer, three standards, nine comparisons at each",
        "unit": "gram",
        "seed": 20110166,
        "truth": {
            "weber_fraction": 0.1,
            "lapse_low": 0.02,
            "lapse_high": 0.02,
            "bias": 0.15,
            "standards": [50.0, 100.0, 200.0],
            "trials_per_level": 30,
            "sessions": 3,
            "missing": 0.01,
            "task": "2AFC",
        },
    },
    "weights_both_orders": {
        "title": "Lifted weights: the standard comes first in half of the trials, and the second "
        "weight is preferred",
        "unit": "gram",
        "seed": 20110176,
        "truth": {
            "weber_fraction": 0.12,
            "lapse_low": 0.02,
            "lapse_high": 0.02,
            "bias": 0.4,
            "standards": [50.0, 100.0],
            "trials_per_level": 40,
            "order": "random",
        },
    },
    "weights_percent_correct": {
        "title": "The odd one of three, scored right or wrong",
        "unit": "gram",
        "seed": 20110167,
        "truth": {
            "weber_fraction": 0.2,
            "lapse_high": 0.03,
            "standards": [100.0],
            "offsets": [0.05, 0.1, 0.2, 0.4, 0.8],
            "trials_per_level": 60,
            "task": "3AFC percent correct",
        },
    },
    "distance_tapered": {
        "title": "Radial distances felt through a tapered whisker by the compliance cue",
        "unit": "mm",
        "seed": 20110168,
        "whisker": "tapered",
        "truth": DISTANCES,
    },
    "distance_cylinder": {
        "title": "The same animal with a cylinder for a whisker",
        "unit": "mm",
        "seed": 20110169,
        "whisker": "cylinder",
        "status": "PRIOR_DEPENDENT",
        "truth": DISTANCES,
    },
    "animals_six": {
        "title": "Six animals of one population, three sessions each",
        "unit": "gram",
        "seed": 20110170,
        "population": True,
        "status": None,  # of each animal for itself
        "truth": {
            "subjects": 6,
            "weber_fraction": 0.12,
            "spread": 0.3,
            "lapse_low": 0.03,
            "lapse_high": 0.03,
            "bias_spread": 0.2,
            "sessions": 3,
            "standards": [50.0, 100.0],
            "trials_per_level": 15,
        },
    },
    "trouble_lapses": {
        "title": "Trouble: a fifth of the easy trials are lost, more at one end",
        "unit": "gram",
        "seed": 20110171,
        "status": "PRIOR_DEPENDENT",
        "truth": {
            "weber_fraction": 0.1,
            "lapse_low": 0.08,
            "lapse_high": 0.2,
            "standards": [50.0, 100.0],
            "trials_per_level": 30,
        },
    },
    "trouble_drift": {
        "title": "Trouble: the animal learns, its Weber fraction falls sevenfold in ten sessions",
        "unit": "gram",
        "seed": 20110172,
        # How far down k may go is a matter of what is believed about lapses.
        "status": "PRIOR_DEPENDENT",
        "truth": {
            "weber_fraction": 0.15,
            "drift": -2.0,
            "bias_drift": 0.8,
            "lapse_low": 0.02,
            "lapse_high": 0.02,
            "sessions": 10,
            "standards": [50.0, 100.0],
            "trials_per_level": 50,
        },
    },
    "trouble_few": {
        "title": "Trouble: three trials of each of nine comparisons",
        "unit": "gram",
        "seed": 20110173,
        "status": None,
        "truth": {"weber_fraction": 0.1, "standards": [100.0], "trials_per_level": 3},
    },
    "trouble_chance": {
        "title": "Trouble: steps far below the threshold, answered at chance",
        "unit": "gram",
        # One set in twenty has a misfit by chance, as 20110174 had.
        "seed": 20110184,
        "status": "LOWER_BOUND",
        "truth": {
            "weber_fraction": 0.3,
            "standards": [100.0],
            "offsets": [-0.01, -0.005, 0.005, 0.01],
            "trials_per_level": 60,
        },
    },
    "trouble_perfect": {
        "title": "Trouble: steps far above the threshold, never answered wrongly",
        "unit": "gram",
        "seed": 20110175,
        "status": "UPPER_BOUND",
        "truth": {
            "weber_fraction": 0.03,
            "standards": [100.0],
            "offsets": [-0.4, -0.3, 0.3, 0.4],
            "trials_per_level": 40,
        },
    },
}


_TYPES = {"f": "number", "i": "integer", "u": "integer", "b": "boolean"}


def describe_table(
    name: str, table: pd.DataFrame, *, unit: str = "", **remarks: Any
) -> dict[str, Any]:
    """A table's entry in a data package: path, schema, and remarks such as `title` and `truth`.

    `name` is that of the file without `.csv`, `unit` that of the stimuli; a column, as
    `Trials.table` gives it, may carry a unit in its name, as `stimulus_1_mm` does.
    """
    fields = []
    for column in map(str, table.columns):
        kind = _TYPES.get(table[column].dtype.kind, "string")
        base = next(
            (known for known in (column, column.rpartition("_")[0]) if known in DESCRIPTIONS), ""
        )
        field = {"name": column, "type": kind, "description": DESCRIPTIONS.get(base, column)}
        if unit and base in STIMULI:
            field["unit"] = unit
        fields.append(field)
    title = {"title": remarks.pop("title")} if "title" in remarks else {}
    return {
        "name": name.replace("_", "-"),
        "path": f"{name}.csv",
        **title,
        "format": "csv",
        "mediatype": "text/csv",
        "encoding": "utf-8",
        "schema": {"fields": fields, "missingValues": [""]},
        **remarks,
    }


def data_package(name: str, title: str, resources: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The contents of a `datapackage.json` for tables described by `describe_table`."""
    return {
        "name": name,
        "title": title,
        "licenses": [{"name": "BSD-3-Clause"}],
        "resources": [dict(entry) for entry in resources],
    }


def encoding_of(name: str) -> CueEncoding | None:
    """How the stimuli of a data set are felt, where there is a whisker."""
    whisker = DATASETS[name].get("whisker")
    return whisker and CueEncoding(Observer(WHISKERS[whisker], cues.Compliance()), unit=1e-3)


def make(name: str) -> tuple[Trials, dict[str, Any]]:
    """One data set, and its truth."""
    entry = DATASETS[name]
    truth = entry["truth"]
    if entry.get("population"):
        trials, animals = simulate_population(**truth, seed=entry["seed"])
        return trials, truth | {"animals": animals.to_dict("records")}
    return simulate_trials(**truth, encoding=encoding_of(name), seed=entry["seed"]), truth


def resource(name: str, trials: Trials, truth: dict[str, Any]) -> dict[str, Any]:
    """Its entry in the data package."""
    entry = DATASETS[name]
    remarks = {"task": trials.task.name, "status": entry.get("status", "DETERMINED")}
    if "whisker" in entry:
        whisker = WHISKERS[entry["whisker"]]
        remarks["whisker"] = {
            "kind": entry["whisker"],
            **{
                field: float(getattr(whisker, field))
                for field in ("length", "base_radius", "tip_radius")
            },
            "cue": "compliance",
        }
    function = "simulate_population" if entry.get("population") else "simulate_trials"
    return describe_table(
        name,
        trials.table(),
        unit=entry["unit"],
        title=entry["title"],
        **remarks,
        truth=truth,
        seed=entry["seed"],
        generator=f"weberwhisk.behaviour.{function}, by analyses/make_synthetic.py",
    )


#: A rat's C2 that whisks against a pole moved from whisk to whisk, as a tracker sees it.
SESSION: dict[str, Any] = {
    "radial_distances": [0.012, 0.016, 0.02, 0.024],
    "frames": 160,
    "frame_rate": 500.0,
    "whisking_hz": 12.5,
    "deflection": 0.25,
    "pixels_per_mm": 20.0,
    "noise_px": 0.3,
    "spacing_px": 12.0,
    "missing": 0.02,
    "seed": 20110177,
}
COLUMNS = {
    "frame": "frame of the video, from 0",
    "x": "point of the whisker, from follicle to tip, pixels",
    "y": "the same, across",
    "time_s": "time, s",
    "whisk": "whisk, from 1; the pole stands elsewhere in each",
    "contact": "whether the whisker touches the pole",
    "tracked": "whether the tracker found the whisker",
    "pole_x": "pole, pixels",
    "pole_y": "the same, across",
    "radial_distance_mm": "follicle to contact, mm; empty without contact, as all below",
    "arc_length_mm": "follicle to contact along the whisker, mm",
    "deflection_angle_deg": "base tangent to the line from follicle to contact",
    "moment_uNm": "bending moment at the base, µN m",
    "axial_force_uN": "force along the base tangent, positive in compression, µN",
    "transverse_force_uN": "force across it, µN",
}


def session() -> dict[str, pd.DataFrame]:
    """The tracked session as a table of points, and its truth."""
    whisker = Whisker.from_identity("C2", curved=True)
    tracking, truth = simulate_tracking(whisker, **SESSION)
    points = tracking[["frame", "x", "y"]].explode(["x", "y"]).astype({"x": float, "y": float})
    return {"tracked_session": points.round(2), "tracked_session_truth": truth.round(6)}


def of_session(name: str, table: pd.DataFrame) -> dict[str, Any]:
    """The entry of a table of the session in the data package."""
    kinds = {"i": "integer", "f": "number", "b": "boolean"}
    fields = [
        {"name": c, "type": kinds[table[c].dtype.kind], "description": COLUMNS[c]} for c in table
    ]
    return {
        "name": name.replace("_", "-"),
        "path": f"{name}.csv",
        "title": "A tracked whisker against a pole"
        + (": what is true" if name.endswith("truth") else ""),
        "format": "csv",
        "mediatype": "text/csv",
        "encoding": "utf-8",
        "schema": {"fields": fields, "missingValues": [""]},
        "whisker": "Whisker.from_identity('C2', curved=True)",
        "simulation": SESSION,
        "generator": "analyses/make_synthetic.py",
    }


def write(folder: Path) -> None:
    """All data sets and their data package."""
    folder.mkdir(parents=True, exist_ok=True)
    resources = []
    for name in DATASETS:
        trials, truth = make(name)
        trials.to_csv(folder / f"{name}.csv")
        resources.append(resource(name, trials, truth))
    for name, table in session().items():
        table.to_csv(folder / f"{name}.csv", index=False, lineterminator="\n")
        resources.append(of_session(name, table))
    package = data_package(
        "weberwhisk-synthetic",
        "Simulated choices with known Weber fractions, and a tracked whisker",
        resources,
    )
    (folder / "datapackage.json").write_text(json.dumps(package, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    write(options(__file__, __doc__, folder=ANALYSES.parent / "data_synthetic").folder)
