"""A fit as ArviZ data, and the Data Package that describes a table of trials."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ..posterior.arviz_io import to_arviz as convert
from .criticism import prior_draws
from .likelihood import Draws

if TYPE_CHECKING:
    from .result import WeberFit


Array = NDArray[np.float64]


def to_arviz(fit: WeberFit, seed: int = 0) -> Any:
    """Posterior, prior, posterior-predictive, log-likelihood and observed data, for ArviZ.

    A cell is a pair of stimuli: `n` trials of which `count` had the answer. Its log-likelihood is
    that of the sequence of answers, binomial coefficient left out. `seed` is that of the draws from
    the prior and of the replicated counts.
    """
    model, chains, cells = fit.model, fit.posterior.chains, fit.model.cells
    draws = fit.posterior.draws()
    rng = np.random.default_rng(seed)

    def chained(values: Array) -> Array:
        size = len(values) // chains
        return values[: size * chains].reshape(chains, size, *values.shape[1:])

    many = fit.bias == "per standard"

    def named(of: Draws) -> dict[str, Array]:
        columns = {
            name: chained(values)
            for name, values in of.named(model).items()
            if name not in model.group_names
        }
        if model.free_bias:
            columns["bias"] = chained(of.bias if many else of.bias[:, 0])
        return columns

    by_cell = model.cell_log_likelihood(
        draws.weber_fraction, draws.lapse_low, draws.lapse_high, draws.bias, draws.effects
    )
    dims = {name: ["cell"] for name in ("answers", "n", "stimulus_1", "stimulus_2")}
    coords: dict[str, Any] = {"cell": np.arange(cells.n.size)}
    if model.free_bias and many:
        dims["bias"], coords["standard"] = ["standard"], fit.trials.standards
    return convert(
        named(draws),
        prior=named(prior_draws(model, len(draws), rng)),
        posterior_predictive={"answers": chained(model.simulate(draws, rng))},
        log_likelihood={"answers": chained(by_cell)},
        observed_data={"answers": cells.count},
        constant_data={
            "n": cells.n,
            "stimulus_1": cells.stimulus_1,
            "stimulus_2": cells.stimulus_2,
        },
        coords=coords,
        dims=dims,
        attrs={"status": fit.status.message, "method": fit.method, "source": fit.trials.source},
    )


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
