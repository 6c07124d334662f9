"""A fit reported: in plain words, as a methods section says it, and for JSON."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from typing import Any

import numpy as np
from scipy import stats

from .._util.output import plain
from .._util.refusals import Advice, argument, named
from .._util.values import counted, interval_text, methods_text, paragraphs
from ..receptors import Weber
from .criticism import advice as next_fit
from .cue_encoding import CueEncoding
from .encodings import Encoding, IdentityEncoding, described
from .estimates import Estimates
from .prior_sensitivity import ANSWERS, sentence_of
from .tasks import SignedChoice
from .verdict import FitStatus, too_few_kinds

__all__ = [
    "as_dict", "encoding_in_words", "engine_in_words", "methods", "priors_in_words", "report",
    "sentence",
]  # fmt: skip


def report(fit: Estimates) -> str:
    """The report of a fit, a paragraph a question."""
    parts = {
        "Data": [_data(fit)],
        "What the data say": _answer(fit),
        "What they cannot say": _limits(fit),
        "What to collect next": [_next(fit)],
    }
    return paragraphs(parts)


def _data(fit: Estimates) -> str:
    t = fit.trials
    cells = fit.model.cells
    moved = f", moved by {', '.join(fit.effects)}" if fit.effects else ""
    missing = f", and {t.n_missing} without an answer" if t.n_missing else ""
    return (
        f"{t.source}: {counted(t.n_trials, 'trial')} with an answer{missing}; "
        f"{counted(cells.n.size, 'pair')} of stimuli{_at_standards(fit)}; task {t.task.name}. "
        f"Observer: {fit.noise} noise, bias {fit.bias}{moved}, {fit.method}."
    )


def _at_standards(fit: Estimates) -> str:
    return f" at {counted(fit.standards.size, 'standard')}" if fit.trials.has_standards else ""


def _answer(fit: Estimates) -> list[str]:
    said = fit.status.message
    if fit.status is FitStatus.GIVEN:
        said = f"the Weber fraction was given: {fit.weber_fraction:.3g}"
    lines = [sentence(said)]
    if fit.unweighed.is_misfit and fit.search.sentence:
        lines.append(fit.search.sentence)
    if "weber_fraction" in fit.parameters:
        unit = f" {fit.unit}" if fit.unit else ""
        k = interval_text(fit.weber_fraction, *fit.interval())
        # A number that the model cannot vouch for does not come before what says so.
        lines.insert(
            len(lines) if fit.status.is_misfit else 0,
            f"Weber fraction{unit}: {k}, prior {fit.model.priors.words('weber_fraction')}.",
        )
    lines += fit.remarks
    lines += equality_and_jnds(fit)
    others = [name for name in fit.parameters if name != "weber_fraction"]
    middles = [float(fit.posterior.quantile(name, 0.5)) for name in others]
    return lines + [
        f"{name}: {interval_text(middle, *fit.interval(parameter=name))}."
        for name, middle in zip(others, middles, strict=True)
    ]


def equality_and_jnds(fit: Estimates, unit: str = "", per_unit: float = 1.0) -> list[str]:
    """Point of subjective equality and just noticeable difference from each standard, in sentences.

    Numbers are times `per_unit`, and in that unit. Of a task whose answers do not compare two
    stimuli, the comparisons at its threshold. None where answers do not follow the stimuli.
    """
    if fit.status in (FitStatus.REVERSED, FitStatus.ONE_SIDED, FitStatus.NO_TRIALS):
        return []

    def of(row: Mapping[Hashable, Any], origin: float = 0.0) -> str:
        ends = [per_unit * (row[name] - origin) for name in ("comparison", "lower", "upper")]
        if np.isfinite(ends).all():
            return interval_text(ends[0], ends[1], ends[2], unit)
        middle, low, high = (
            f"{end:.4g}{unit}" if np.isfinite(end) else "out of reach" for end in ends
        )
        return f"{middle} (95 %: {low} to {high})"

    rows = fit.usual_thresholds.to_dict("records")
    if not rows or not isinstance(fit.model.task, SignedChoice):
        return [
            f"From standard {per_unit * row['standard']:.4g}{unit}, {row['criterion']}: "
            f"comparison {of(row)}."
            for row in rows
        ]
    means = [f"JND, from the standard to {rows[0]['criterion']}"]
    equal = _equality(fit)
    if equal:
        means.insert(0, f"PSE, the point of subjective equality: {equal[0]['criterion']}")
    said = [f"{'; '.join(means)}."]
    for i, row in enumerate(rows):
        here = [f"JND {of(row, row['standard'])}"]
        if equal:
            here.insert(0, f"PSE {of(equal[i])}")
        said.append(f"From standard {per_unit * row['standard']:.4g}{unit}: {'; '.join(here)}.")
    return said


def _equality(fit: Estimates) -> list[dict[Hashable, Any]]:
    """Points of subjective equality by standard; none where they are the standards by assumption,
    or the task has none."""
    moved = bool(fit.model.group_names or fit.effects)
    if not (moved and isinstance(fit.model.task, SignedChoice)):
        return []
    return fit.equality_points.to_dict("records")


def _limits(fit: Estimates) -> list[str]:
    """What the data cannot say."""
    lines = [*fit.notes]
    if fit.unit:
        lines.append(
            "The unit of the logarithm is unknown, so the Weber fraction is counted per unit of "
            "the column, in the form that holds for small steps; "
            + named("log_unit")
            + " would make it a ratio."
        )
    sensitive = fit.status.ok or fit.status is FitStatus.PRIOR_DEPENDENT
    if sensitive:
        table = fit.prior_sensitivity.drop(index=ANSWERS, errors="ignore")
        change = table[["change_twice", "change_half"]].astype(float).abs().max(axis=1)
        matter = table[change >= 0.05]
        said = [sentence_of(str(belief), row) for belief, row in matter.iterrows()]
        lines += [line for line in said if line not in lines]
    if fit.status.ok and fit.weber_fraction > 0.5 and not fit.unit and fit.noise == "weber":
        lines.append(
            "At a Weber fraction this large the curve levels off below 1 of itself, as lapses make "
            "it do; the two are hard to distinguish."
        )
    return lines or ["Nothing in the table speaks against the model."]


def _next(fit: Estimates) -> str:
    if (said := next_fit(fit)) is not None:
        return said
    advice = {
        FitStatus.NO_TRIALS: "Trials with an answer.",
        FitStatus.REVERSED: "Nothing yet: first check which answer means which stimulus, and "
        "their order.",
        FitStatus.ONE_SIDED: "Answers of both kinds: first find out why the animal gave only one.",
        FitStatus.NOT_CONVERGED: "Nothing yet: first " + _instead(fit) + ".",
        FitStatus.UNINFORMED: "Comparisons at several distances from the standard, on both sides, "
        "some easy enough that the animal is nearly always right.",
        FitStatus.UPPER_BOUND: "Harder comparisons: closer to the standard than any so far.",
        FitStatus.LOWER_BOUND: "Easier comparisons: further from the standard than any so far.",
        FitStatus.GIVEN: "Nothing for the Weber fraction, which was given.",
    }
    if fit.status in advice:
        return advice[fit.status]
    low, high = fit.interval()
    width = np.log(high / low)
    if width <= 0.4:
        return "The interval is within ±20 %; more standards would test Weber's law."
    # The width of ln k goes as one over the square root of the trials.
    factor = (width / 0.4) ** 2
    return (
        f"About {factor:.1f} times as many trials of the same kind bring the "
        "interval within ±20 %; those answered right 75 to 95 % of the time inform most, and a "
        "few very easy ones determine the lapses."
    )


def _instead(fit: Estimates) -> Advice:
    """What to do where a posterior was given up."""
    by_emcee = fit.method == "emcee"
    if not too_few_kinds(fit.model):
        more = "state more beforehand (" + named("priors") + ")"
        if fit.model.n_states > 1:  # there is no other method
            return more
        if by_emcee:
            return "leave " + named("method") + " out, or " + more
        return "fit with " + argument("method", "emcee") + ", or " + more
    rare = stats.beta(1, 20)
    rare_lapses = argument("priors", {"lapse_low": rare, "lapse_high": rare})
    ways = ["believe lapses to be few, " + rare_lapses]
    if fit.model.task.has_bias and fit.bias == "shared" and fit.standards.size > 1:
        ways.append("fit " + argument("bias", "per standard"))
    return Advice.joined("; or ", ways) + ("" if by_emcee else "; emcee would give up as well")


def sentence(message: str) -> str:
    """A message as a sentence."""
    return message[0].upper() + message[1:] + "."


def as_dict(fit: Estimates) -> dict[str, object]:
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
        "thresholds": fit.usual_thresholds.to_dict("records"),
        "points_of_subjective_equality": _equality(fit),
        "prior_sensitivity": fit.prior_sensitivity.reset_index().to_dict("records"),
        "lapse_sensitivity": fit.lapse_sensitivity.to_dict("records"),
        "log_evidence": fit.log_evidence,
        "error": fit.posterior.error,
        "misfit": fit.misfit,
        "causes": _causes(fit),
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
            "states": fit.model.n_states,
            "method": fit.method,
            "encoding": type(fit.encoding).__name__,
        },
    }
    return dict(plain(described))


def _causes(fit: Estimates) -> list[dict[Hashable, Any]]:
    """Causes of a misfit, where checks see one."""
    if not fit.unweighed.is_misfit:
        return []
    return fit.search.table.reset_index().to_dict("records")


_NOISE = {
    "weber": "an sd of the Weber fraction k times its own signal",
    "equal-variance": "the sd that the standard's signal gives, k times it",
    "constant": "the same sd at every stimulus, k times their geometric mean",
}


def methods(fit: Estimates) -> str:
    """What was done to the choices of one observer."""
    trials, cells = fit.trials, fit.model.cells
    missing = f" ({trials.n_missing} without an answer were left out)" if trials.n_missing else ""
    said = [
        f"A model of the observer was fitted to {counted(trials.n_trials, 'trial')}{missing} of "
        f"the task {trials.task.name}, with {counted(cells.n.size, 'pair')} of stimuli"
        f"{_at_standards(fit)}.",
        encoding_in_words(fit.encoding, fit.noise),
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
    if fit.model.n_states > 1:
        states = {
            2: "two states: engaged, the observer above, and disengaged, with one probability of "
            "the answer, answer_away, whatever the stimuli",
            3: "three states: engaged, the observer above, and two disengaged ones, with "
            "probabilities of the answer, answer_low and answer_high, whatever the stimuli "
            "(Ashwood et al. 2022)",
        }[fit.model.n_states]
        said.append(
            f"The animal is a hidden Markov chain of {states}. Before each trial the state is kept "
            "with probability 1 − switch, and otherwise, as at the start of a session, drawn anew: "
            "engaged with the probability of that name"
            f"{'; side is the share of answer_high in the rest' * (fit.model.n_states == 3)}."
        )
    if fit.effects:
        said.append(f"The model also has these effects: {', '.join(fit.effects)}.")
    said += [
        priors_in_words(fit),
        engine_in_words(fit.method),
        f"The fit's status: {fit.status.name}.",
    ]
    return methods_text(said)


def priors_in_words(fit: Estimates, *more: str) -> str:
    """Every parameter with its prior, in a sentence."""
    believed, task = fit.model.priors, fit.trials.task
    correlated = ""
    if len(task.lapses) == 2 and not any(believed.is_fixed(name) for name in task.lapses):
        rho = believed.lapse_correlation
        correlated = f"; the normal scores of the two lapse rates correlate by {rho:g}"
    said = [f"{name} ~ {believed.words(name)}" for name in fit.parameters]
    given = {n: n for n in fit.model.lead if not n.startswith("lapse_") or n in task.lapses}
    given |= {"bias": task.bias_name or ""} if fit.bias != "none" else {}
    said += [f"{name} {believed.words(n)}" for n, name in given.items() if believed.is_fixed(n)]
    return f"Parameters and priors: {', '.join([*said, *more])}{correlated}."


def encoding_in_words(encoding: Encoding, noise_name: str) -> str:
    """How stimuli become noisy signals, in a sentence."""
    noise = _NOISE[noise_name]
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


def engine_in_words(method: str) -> str:
    """How posteriors were computed, in a sentence."""
    by = {"quadrature": "by quadrature", "importance": "by importance sampling"}.get(
        method, f"with {method}"
    )
    return f"Posteriors were computed {by}; estimates are medians with equal-tailed 95 % intervals."
