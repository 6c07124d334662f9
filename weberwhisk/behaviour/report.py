"""A fit told to others: in plain words, for JSON and ArviZ, and beside other beliefs of lapses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import stats

from .._display import interval_text
from ..posterior.arviz_io import to_arviz as convert
from ..threads import one_blas_thread
from . import criticism
from .criticism import prior_draws
from .integrate import refined
from .likelihood import Draws, WeberModel
from .posteriors import QuadraturePosterior, WeberPosterior
from .verdict import FitStatus, too_few_kinds

if TYPE_CHECKING:
    from .population_fit import PopulationFit
    from .result import WeberFit


def report(fit: WeberFit) -> str:
    """The report of a fit, a paragraph a question."""
    return "\n\n".join([_data(fit), _answer(fit), _limits(fit), _next(fit)]) + "\n"


def _data(fit: WeberFit) -> str:
    t = fit.trials
    cells = fit.model.cells
    moved = f", moved by {', '.join(fit.effects)}" if fit.effects else ""
    missing = f", and {t.n_missing} without an answer" if t.n_missing else ""
    return (
        f"Data. {t.source}: {t.n_trials} trials with an answer{missing}; "
        f"{cells.n.size} pair{'s' if cells.n.size != 1 else ''} of stimuli at {t.standards.size} "
        f"standard{'s' if t.standards.size != 1 else ''}; task {t.task.name}. "
        f"Observer: {fit.noise} noise, bias {fit.bias}{moved}, {fit.method}."
    )


def _answer(fit: WeberFit) -> str:
    lines = [f"What the data say. {_sentence(fit.status.message)}"]
    if "weber_fraction" in fit.parameters:
        low, high = fit.interval()
        unit = f" {fit.unit}" if fit.unit else ""
        lines.append(
            f"Weber fraction{unit}: {fit.weber_fraction:.3g}, 95 % between {low:.3g} and "
            f"{high:.3g} "
            f"(prior {fit.model.priors.words('weber_fraction')})."
        )
    for name in fit.parameters:
        if name != "weber_fraction":
            low, high = fit.interval(parameter=name)
            lines.append(
                f"{name}: {fit.posterior.quantile(name, 0.5):.3g} ({low:.3g} to {high:.3g})."
            )
    if fit.status not in (FitStatus.REVERSED, FitStatus.ONE_SIDED, FitStatus.NO_TRIALS):
        for row in fit.threshold().to_dict(orient="records"):
            lines.append(
                f"From standard {row['standard']:.4g}, {row['criterion']}: comparison "
                f"{_number(row['comparison'])} "
                f"({_number(row['lower'])} to {_number(row['upper'])})."
            )
    return "\n".join(lines)


def _limits(fit: WeberFit, least_p: float = 0.01) -> str:
    """What the data cannot say; the curve misses them below that posterior-predictive p."""
    lines = ["What they cannot say.", *fit.notes]
    if fit.unit:
        lines.append(
            "The unit of the logarithm is unknown, so the Weber fraction is counted per unit of "
            "the column, in the form that holds for small steps; log_unit= would make it a ratio."
        )
    if fit.misfit < least_p:
        worst = fit.residuals().sort_values("z", key=np.abs).iloc[-1]
        lines.append(
            f"The curve misses the data (posterior-predictive p = {fit.misfit:.2g}), most at "
            f"{worst['stimulus_1']:.4g} against {worst['stimulus_2']:.4g}: "
            f"{worst['observed']:.2f} seen, {worst['expected']:.2f} expected. "
            f"The interval above takes the model for granted and is too narrow.{_remedy(fit)}"
        )
    lines += _failed_checks(fit, least_p)
    lines += _sensitivity(fit)
    if _poor(fit):
        lines.append(
            "At a Weber fraction this large the curve levels off below 1 of itself, as lapses make "
            "it do; the two are hard to distinguish."
        )
    if len(lines) == 1:
        lines.append("Nothing in the table speaks against the model.")
    return "\n".join(lines)


def _failed_checks(fit: WeberFit, least_p: float) -> list[str]:
    """What the data have too much of, but for the misfit, which has its own sentence."""
    table = criticism.checks(fit).drop(index="levels", errors="ignore")
    return [
        f"The data show what a stationary observer does not ({name}, posterior-predictive "
        f"p = {row['p']:.2g}); try {row['remedy']}."
        for name, row in table[table["p"] < least_p].iterrows()
    ]


def _sensitivity(fit: WeberFit, least: float = 0.05) -> list[str]:
    """How far the answer hangs on what is believed about lapses."""
    if not fit.status.ok:
        return []
    change = fit.lapse_sensitivity["change"]
    if change.abs().max() < least:
        return []
    return [
        "What is believed about lapses moves the Weber fraction: by "
        f"{100 * change.min():+.0f} to {100 * change.max():+.0f} % from an animal that often "
        "lapses to one that never does. Easy trials, or more sessions or animals fitted together, "
        "tell the lapses."
    ]


def _remedy(fit: WeberFit) -> str:
    if fit.model.task.has_bias and fit.bias != "per standard" and fit.trials.standards.size > 1:
        return ' Try bias="per standard".'
    if len(fit.trials.sessions) > 1:
        return " Try fewer sessions: the animal may have changed."
    return ""


def _poor(fit: WeberFit) -> bool:
    return fit.status.ok and fit.weber_fraction > 0.5 and not fit.unit and fit.noise == "weber"


def _next(fit: WeberFit) -> str:
    advice = {
        FitStatus.NO_TRIALS: "Trials with an answer.",
        FitStatus.REVERSED: "Nothing yet: first check which answer means which stimulus, and "
        "their order.",
        FitStatus.ONE_SIDED: "Answers of both kinds: first find out why the animal gave only one.",
        FitStatus.NOT_CONVERGED: f"Nothing yet: first {_instead(fit)}.",
        FitStatus.UNINFORMED: "Comparisons at several distances from the standard, on both sides, "
        "some easy enough that the animal is nearly always right.",
        FitStatus.UPPER_BOUND: "Harder comparisons: closer to the standard than any so far.",
        FitStatus.LOWER_BOUND: "Easier comparisons: further from the standard than any so far.",
    }
    if fit.status in advice:
        return f"What to collect next. {advice[fit.status]}"
    low, high = fit.interval()
    width = np.log(high / low)
    if width <= 0.4:
        return (
            "What to collect next. The interval is within ±20 %; more standards would test "
            "Weber's law."
        )
    # The width of ln k goes as one over the square root of the trials.
    factor = (width / 0.4) ** 2
    return (
        f"What to collect next. About {factor:.1f} times as many trials of the same kind bring the "
        "interval within ±20 %; those answered right 75 to 95 % of the time tell most, and a few "
        "very easy ones tell the lapses."
    )


def _instead(fit: WeberFit) -> str:
    """What to do where a posterior was given up."""
    if not too_few_kinds(fit.model):
        return "fit by the other method, or state more beforehand (priors=)"
    ways = [
        "believe lapses to be few, priors={'lapse_low': scipy.stats.beta(1, 20), "
        "'lapse_high': scipy.stats.beta(1, 20)}"
    ]
    if fit.model.task.has_bias and fit.bias == "shared" and fit.trials.standards.size > 1:
        ways.append('fit bias="per standard"')
    if len(fit.trials.sessions) > 1:
        ways.append(
            "let the sessions learn their lapses from one another, "
            "fit_population(trials, sessions=True)"
        )
    return f"{'; or '.join(ways)}; the other method would give up as well"


def _sentence(message: str) -> str:
    return message[0].upper() + message[1:] + "."


def _number(value: float) -> str:
    return f"{value:.4g}" if np.isfinite(value) else "out of reach"


# What one might believe instead: an animal that never lapses, seldom, or often.
BELIEFS = {"never": 0.0, "seldom": stats.beta(1.0, 20.0), "often": stats.beta(1.0, 9.0)}


@one_blas_thread
def lapse_sensitivity(model: WeberModel, posterior: WeberPosterior) -> pd.DataFrame:
    """Median and 95 % interval of k with other lapse priors than those of the fit.

    Lapses and a poor Weber fraction explain the same errors, so the belief about lapses moves k, by
    less the more easy trials there are.

    Returns
    -------
    DataFrame
        `lapses` ("as fitted", "never", "seldom": Beta(1, 20), "often": Beta(1, 9)),
        `weber_fraction`, `lower`, `upper`, `change` (relative to the fit). Only the fit's own row
        where the Weber fraction is fixed, the task has no free lapse, or emcee was needed.
    """
    own = list(posterior.quantile("weber_fraction", [0.5, 0.025, 0.975]))
    rows = [("as fitted", *own)]
    free = [n for n in model.lapse_names if n in model.names]
    if free and "weber_fraction" in model.names and isinstance(posterior, QuadraturePosterior):
        for words, belief in BELIEFS.items():
            changed: dict[str, Any] = dict.fromkeys(free, belief)
            priors = replace(model.priors, **changed)
            other = replace(model, priors=priors).merged()
            grid = QuadraturePosterior(other, refined(other), 0)
            rows.append((words, *grid.quantile("weber_fraction", [0.5, 0.025, 0.975])))
    table = pd.DataFrame(rows, columns=["lapses", "weber_fraction", "lower", "upper"])
    table["change"] = table["weber_fraction"] / own[0] - 1
    return table


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


def as_dict(fit: WeberFit) -> dict[str, Any]:
    """Everything a reader needs to use or repeat a fit, ready for JSON."""
    low, high = fit.interval() if "weber_fraction" in fit.parameters else (fit.weber_fraction,) * 2
    return {
        "weber_fraction": fit.weber_fraction,
        "lower": low,
        "upper": high,
        "mass": 0.95,
        "unit": fit.unit or "ratio",
        "status": fit.status.name,
        "message": fit.status.message,
        "notes": list(fit.notes),
        "parameters": fit.summary().to_dict(orient="index"),
        "thresholds": _plain(fit.threshold().to_dict(orient="records")),
        "lapse_sensitivity": fit.lapse_sensitivity.to_dict(orient="records"),
        "log_evidence": fit.log_evidence,
        "error": fit.posterior.error if np.isfinite(fit.posterior.error) else None,
        "misfit": fit.misfit,
        "data": {
            "source": fit.trials.source,
            "n_trials": fit.trials.n_trials,
            "n_missing": fit.trials.n_missing,
            "cells": int(fit.model.cells.n.size),
            "standards": fit.trials.standards.tolist(),
        },
        "settings": {
            "task": fit.model.task.name,
            "noise": fit.noise,
            "bias": fit.bias,
            "effects": list(fit.effects),
            "method": fit.method,
            "encoding": type(fit.encoding).__name__,
        },
    }


def _plain(rows: list[dict[Any, Any]]) -> list[dict[Any, Any]]:
    """Infinities as None, which JSON can hold."""
    return [
        {k: None if isinstance(v, float) and not np.isfinite(v) else v for k, v in row.items()}
        for row in rows
    ]


def population_report(fit: PopulationFit) -> str:
    """A population's fit in words, an animal a line."""
    lines = [f"{fit.status.value[0].upper()}{fit.status.value[1:]}."]
    if fit.population is not None:
        for name in fit.parameters:
            low, high = fit.interval(parameter=name)
            middle = float(fit.quantile(name, 0.5))
            words = "median Weber fraction" if name == "weber_fraction" else name.replace("_", " ")
            lines.append(f"Population, {words}: {interval_text(middle, low, high)}.")
    for row in fit.subjects.to_dict("records"):
        k = "left out"
        if row["weber_fraction"] == row["weber_fraction"]:
            k = f"k = {interval_text(row['weber_fraction'], row['lower'], row['upper'])}"
            alone = interval_text(row["alone"], row["alone_lower"], row["alone_upper"])
            k += f"; from its own trials alone {alone}"
        lines.append(f"{row['subject']}: {row['n']} trials; {k}; {row['status']}.")
    return "\n".join([*lines, *fit.notes]) + "\n"
