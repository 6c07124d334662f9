"""Make the data sets of `data_synthetic/`, each with its truth, seed and schema beside it.

    python analyses/make_synthetic.py [folder]

The same bytes come out every time; `tests/test_data_synthetic.py` holds it to that.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from weberwhisk.behaviour import Trials, simulate_trials

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
}

DESCRIPTIONS = {
    "session": "session, from 1",
    "trial": "trial within the session, from 1",
    "standard": "stimulus that the others are compared with",
    "stimulus_1": "first stimulus",
    "stimulus_2": "second stimulus",
    "choice": "1: the second was reported greater, 0: the first; empty: no answer",
    "correct": "1: right, 0: wrong",
}


def make(name: str) -> Trials:
    """One data set."""
    entry = DATASETS[name]
    return simulate_trials(**entry["truth"], seed=entry["seed"])


def resource(name: str, trials: Trials) -> dict[str, Any]:
    """Its entry in the data package."""
    entry = DATASETS[name]
    table = trials.table()
    return {
        "name": name,
        "path": f"{name}.csv",
        "title": entry["title"],
        "format": "csv",
        "schema": {
            "fields": [
                {
                    "name": column,
                    "type": "number" if table[column].dtype.kind == "f" else "integer",
                    "description": DESCRIPTIONS[column],
                    **({"unit": entry["unit"]} if table[column].dtype.kind == "f" else {}),
                }
                for column in table.columns
            ]
        },
        "truth": entry["truth"],
        "seed": entry["seed"],
        "generator": "weberwhisk.simulate_trials, by analyses/make_synthetic.py",
    }


def write(folder: Path) -> None:
    """All data sets and their data package."""
    folder.mkdir(parents=True, exist_ok=True)
    made = {name: make(name) for name in DATASETS}
    for name, trials in made.items():
        trials.to_csv(folder / f"{name}.csv")
    package = {
        "name": "weberwhisk-synthetic",
        "title": "Simulated choices with known Weber fractions",
        "licenses": [{"name": "BSD-3-Clause"}],
        "resources": [resource(name, trials) for name, trials in made.items()],
    }
    (folder / "datapackage.json").write_text(json.dumps(package, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    default = Path(__file__).parent.parent / "data_synthetic"
    write(Path(sys.argv[1]) if len(sys.argv) > 1 else default)
