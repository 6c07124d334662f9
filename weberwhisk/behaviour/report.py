"""A fit in plain words: what the data say, what they cannot, what to collect next."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from . import criticism
from .status import FitStatus
from .verdict import too_few_kinds

if TYPE_CHECKING:
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
            "it do; the two are hard to tell apart."
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
