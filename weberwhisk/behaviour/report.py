"""A fit reported: in plain words, as a methods section has it, for JSON, and for ArviZ."""

from __future__ import annotations

from importlib.metadata import version
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import pandas as pd

from .. import __version__
from .._values import Array, interval_text
from ..contacts import methods_of
from ..inference.arviz_io import ArvizData
from ..inference.arviz_io import to_arviz as convert
from ..inference.coordinates import in_words
from ..output import plain
from ..receptors import Weber
from . import criticism
from .cue_encoding import CueEncoding
from .encodings import Encoding, IdentityEncoding, described
from .likelihood import Draws
from .psychometric import SignedChoice
from .verdict import FitStatus, too_few_kinds

if TYPE_CHECKING:
    from .fit import WeberFit
    from .population_fit import PopulationFit


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
        f"{_counted(cells.n.size, 'pair')} of stimuli at {_counted(fit.standards.size, 'standard')}"
        f"; task {t.task.name}. "
        f"Observer: {fit.noise} noise, bias {fit.bias}{moved}, {fit.method}."
    )


def _answer(fit: WeberFit) -> str:
    said = fit.status.message
    if fit.status is FitStatus.GIVEN:
        said = f"the Weber fraction was given: {fit.weber_fraction:.3g}"
    lines = [f"What the data say. {_sentence(said)}"]
    if "weber_fraction" in fit.parameters:
        low, high = fit.interval()
        unit = f" {fit.unit}" if fit.unit else ""
        lines.append(
            f"Weber fraction{unit}: {fit.weber_fraction:.3g}, 95 % between {low:.3g} and "
            f"{high:.3g} (prior {fit.model.priors.words('weber_fraction')})."
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
    table = criticism.checks(fit).drop(index="levels", errors="ignore")  # that is the misfit
    lines += [
        f"The data show what a stationary observer does not ({name}, posterior-predictive "
        f"p = {row['p']:.2g}); try {row['remedy']}."
        for name, row in table[table["p"] < least_p].iterrows()
    ]
    if fit.status.ok and (change := fit.lapse_sensitivity["change"]).abs().max() >= 0.05:
        lines.append(
            "What is believed about lapses moves the Weber fraction: by "
            f"{100 * change.min():+.0f} to {100 * change.max():+.0f} % from an animal that often "
            "lapses to one that never does. Easy trials tell the lapses."
        )
    if fit.status.ok and fit.weber_fraction > 0.5 and not fit.unit and fit.noise == "weber":
        lines.append(
            "At a Weber fraction this large the curve levels off below 1 of itself, as lapses make "
            "it do; the two are hard to distinguish."
        )
    if len(lines) == 1:
        lines.append("Nothing in the table speaks against the model.")
    return "\n".join(lines)


def _remedy(fit: WeberFit) -> str:
    if fit.model.task.has_bias and fit.bias != "per standard" and fit.standards.size > 1:
        return ' Try bias="per standard".'
    if len(fit.trials.sessions) > 1:
        return " Try fewer sessions: the animal may have changed."
    return ""


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
        FitStatus.GIVEN: "Nothing for the Weber fraction, which was given.",
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
    if fit.model.task.has_bias and fit.bias == "shared" and fit.standards.size > 1:
        ways.append('fit bias="per standard"')
    return f"{'; or '.join(ways)}; the other method would give up as well"


def _sentence(message: str) -> str:
    return message[0].upper() + message[1:] + "."


def _number(value: float) -> str:
    return f"{value:.4g}" if np.isfinite(value) else "out of reach"


def to_arviz(fit: WeberFit, seed: int = 0) -> ArvizData:
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

    by_cell = model.cell_log_likelihood(*draws.values)
    dims = {name: ["cell"] for name in ("answers", "n", "stimulus_1", "stimulus_2")}
    coords: dict[str, Any] = {"cell": np.arange(cells.n.size)}
    if model.free_bias and many:
        dims["bias"], coords["standard"] = ["standard"], fit.standards
    return convert(
        named(draws),
        prior=named(criticism.prior_draws(model, len(draws), rng)),
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


def as_dict(fit: WeberFit) -> dict[str, object]:
    """Everything a reader needs to use or repeat a fit, ready for JSON."""
    low, high = fit.interval()
    described = {
        "weber_fraction": fit.weber_fraction,
        "lower": low,
        "upper": high,
        "mass": 0.95,
        "unit": fit.unit or "ratio",
        "status": fit.status.name,
        "message": fit.status.message,
        "notes": list(fit.notes),
        "parameters": fit.summary().to_dict(orient="index"),
        "thresholds": fit.threshold().to_dict("records"),
        "lapse_sensitivity": fit.lapse_sensitivity.to_dict("records"),
        "log_evidence": fit.log_evidence,
        "error": fit.posterior.error,
        "misfit": fit.misfit,
        "data": {
            "source": fit.trials.source,
            "n_trials": fit.trials.n_trials,
            "n_missing": fit.trials.n_missing,
            "cells": int(fit.model.cells.n.size),
            "standards": fit.standards.tolist(),
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
    return dict(plain(described))


def population_report(fit: PopulationFit) -> str:
    """A population's fit in words, an animal a line."""
    lines = [_sentence(fit.status.value)]
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


_NOISE = {
    "weber": "an sd of the Weber fraction k times its own signal",
    "equal-variance": "the sd that the standard's signal gives, k times it",
}


def methods_paragraph(fit: WeberFit | PopulationFit | pd.DataFrame) -> str:
    """What was done to choices or contacts, as a methods section says it; numbers are the result's.

    Parameters
    ----------
    fit : WeberFit, PopulationFit or DataFrame
        A table as of `locate`.

    Returns
    -------
    str
        One paragraph without line breaks. Priors are named as SciPy names its distributions.

    Examples
    --------
    >>> from weberwhisk import fit_weber, simulate_trials
    >>> text = methods_paragraph(fit_weber(simulate_trials(trials_per_level=10, seed=1)))
    >>> "lapse_low ~ beta(0.7, 20)" in text
    True
    """
    if isinstance(fit, pd.DataFrame):
        said = methods_of(fit)
    else:
        said = _of_one(cast("WeberFit", fit)) if hasattr(fit, "posterior") else _of_many(fit)
    made = f"weberwhisk {__version__} (NumPy {np.__version__}, SciPy {version('scipy')})"
    return " ".join([*said, f"This was done with {made}."])


def _of_one(fit: WeberFit) -> list[str]:
    trials, cells = fit.trials, fit.model.cells
    missing = f" ({trials.n_missing} without an answer were left out)" if trials.n_missing else ""
    said = [
        f"A model of the observer was fitted to {_counted(trials.n_trials, 'trial')}{missing} of "
        f"the task {trials.task.name}, with {_counted(cells.n.size, 'pair')} of stimuli at "
        f"{_counted(fit.standards.size, 'standard')}.",
        _encoded(fit.encoding, _NOISE[fit.noise]),
    ]
    if fit.model.encodings.has_spread:
        said.append(
            "Stimuli are where the touches were located; each trial is integrated over the error."
        )
    if isinstance(trials.task, SignedChoice) and not fit.effects:
        shared = "shared by all standards" if fit.bias == "shared" else fit.bias
        bias = f"; the bias b is {shared}" if fit.bias != "none" else ""
        said.append(
            "The second stimulus is reported greater with probability λ_lo + (1 − λ_lo − λ_hi) "
            f"Φ(d{' + b' * (fit.bias != 'none')}), where d is the difference of the two signals "
            f"over its sd and λ_lo, λ_hi are lapse rates{bias}."
        )
    if fit.effects:
        said.append(f"The model also has these effects: {', '.join(fit.effects)}.")
    return [*said, _priors(fit), _how(fit.method), f"The fit's status: {fit.status.name}."]


def _priors(fit: WeberFit, *more: str) -> str:
    """Every parameter with its prior, in a sentence."""
    believed, task = fit.model.priors, fit.trials.task
    correlated = ""
    if len(task.lapses) == 2 and not any(believed.is_fixed(name) for name in task.lapses):
        rho = believed.lapse_correlation
        correlated = f"; the normal scores of the two lapse rates correlate by {rho:g}"
    priors = [f"{name} ~ {believed.words(name)}" for name in fit.parameters]
    given = {n: n for n in fit.model.lead if not n.startswith("lapse_") or n in task.lapses}
    given |= {"bias": task.bias_name or ""} if fit.bias != "none" else {}
    priors += [f"{name} {believed.words(n)}" for n, name in given.items() if believed.is_fixed(n)]
    return f"Parameters and priors: {', '.join([*priors, *more])}{correlated}."


def _of_many(fit: PopulationFit) -> list[str]:
    status = f"The fit's status: {fit.status.name}."
    if fit.population is None:
        return [*fit.notes, status]
    used = fit.subjects[fit.subjects["weber_fraction"].notna()]
    one = next(iter(fit.fits.values()))
    return [
        f"A hierarchical model was fitted to {_counted(int(used['n'].sum()), 'trial')} of the task "
        f"{one.trials.task.name}, of {_counted(len(used), 'animal')}: ln k is normal between "
        "animals, each learning from the others (partial pooling).",
        *fit.notes,
        _encoded(one.encoding, _NOISE[one.noise]),
        _priors(one, f"spread ~ {in_words(fit.spread_prior)}"),
        _how("quadrature"),
        status,
    ]


def _counted(number: int, thing: str) -> str:
    return f"{number} {thing}{'s' * (number != 1)}"


def _encoded(encoding: Encoding, noise: str) -> str:
    if isinstance(encoding, IdentityEncoding):
        return f"The signal of a stimulus is its magnitude, noisy with {noise}."
    if isinstance(encoding, CueEncoding):
        observer = encoding.observer
        plain = isinstance(observer.noise, Weber) and len(observer.cue.signal_names) == 1
        return (
            f"Radial distance is encoded through {encoding.described} with receptors "
            f"{type(observer.noise).__name__}{f': the signal is noisy with {noise}' * plain}."
        )
    return f"Stimuli are encoded by {described(encoding)}."


def _how(method: str) -> str:
    by = "by quadrature" if method == "quadrature" else f"with {method}"
    return f"Posteriors were computed {by}; estimates are medians with equal-tailed 95 % intervals."
