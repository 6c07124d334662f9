"""The description beside a table of trials: a Data Package with schema, and truth if simulated.

The format is that of Frictionless Data (specs.frictionlessdata.io/data-package), which other
programs read.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

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
_TYPES = {"f": "number", "i": "integer", "u": "integer", "b": "boolean"}


def describe_table(
    name: str, table: pd.DataFrame, *, unit: str = "", **remarks: Any
) -> dict[str, Any]:
    """A table's entry in a data package: path, schema, and remarks such as `title` and `truth`.

    Parameters
    ----------
    name : str
        Of the file, without `.csv`.
    table : DataFrame
        As `Trials.table` gives it; a column may carry a unit in its name, as `stimulus_1_mm` does.
    unit : str
        Of the stimuli.
    **remarks
        Anything with a JSON form.

    Examples
    --------
    >>> from weberwhisk import simulate_trials
    >>> entry = describe_table("t", simulate_trials(seed=1).table(), unit="g", title="Weights")
    >>> entry["schema"]["fields"][2]
    {'name': 'standard', 'type': 'number', 'description': 'stimulus that the others are compared
    with', 'unit': 'g'}
    """
    fields = []
    for column in map(str, table.columns):
        kind = _TYPES.get(table[column].dtype.kind, "string")
        base = next(
            (known for known in (column, column.rpartition("_")[0]) if known in DESCRIPTIONS), ""
        )
        field = {"name": column, "type": kind, "description": DESCRIPTIONS.get(base, column)}
        if unit and base in ("standard", "stimulus_1", "stimulus_2"):
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
