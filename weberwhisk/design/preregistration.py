"""A plan in words: what it takes for granted, and a text to paste into a preregistration."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

from ..behaviour.encodings import ConstantNoise, described
from .hypotheses import Hypothesis
from .plan import Plan
from .scheme import easy_share
from .trial_lists import ONE_STIMULUS


def preregistration(plan: Plan) -> str:
    """The plan as a preregistration asks for it: question, design, size, analysis, inference.

    Every number is the plan's. What only the experimenter knows stands in square brackets.
    """
    parts = {
        "Question and hypotheses": _question(plan),
        "Design": _design(plan),
        "Order of trials": _order(plan),
        "Sample size": _size(plan),
        "Analysis": _analysis(plan),
        "Inference": _inference(plan),
        "Exclusion": _exclusion(plan),
        "Files": _files(plan),
    }
    text = "\n\n".join(textwrap.fill(f"{title}. {words}", 92) for title, words in parts.items())
    return f"{plan.title}\n\n{text}\n"


def assumptions(plan: Plan) -> list[str]:
    """What the expected numbers hang on, a sentence each."""
    animals, first = plan.animals, plan.hypotheses[0]
    k, task, noise = animals.weber_fraction, first.task, first.noise
    easy = easy_share(plan.scheme, first.encoding, k, task=task, noise=noise)
    lines = [
        f"Weber fraction of the animals: median {animals.weber_fraction:g}, ln k with an sd of "
        f"{animals.spread:g} between animals. None has been measured for whisker force or moment.",
        f"Lapses: {100 * animals.lapse:g} % on either side on average. Biases: sd "
        f"{animals.bias_spread:g} between animals, in sds of the difference of the two signals.",
        f"Distance is encoded through {described(first.encoding)}.",
        "Noise is independent from trial to trial, k is the same in all sessions, and the two "
        "stimuli are encoded alike.",
        f"{100 * easy:.2g} % of the trials are easy (right in 95 %, lapses aside).",
    ]
    return lines


def offsets_in_words(offsets: Sequence[float]) -> str:
    """Offsets in millimetres, those that come with either sign once."""
    millimetres = [float(f"{1e3 * o:.4g}") for o in offsets]
    if sorted(millimetres) == sorted(-o for o in millimetres):
        return ", ".join(f"±{o:.4g}" for o in sorted(millimetres) if o > 0)
    return ", ".join(f"{o:+.4g}" for o in millimetres)


def _question(plan: Plan) -> str:
    names = [h.name for h in plan.hypotheses]
    each = "; ".join(
        f"({i}) {h.name}: distance is encoded through {described(h.encoding)}"
        for i, h in enumerate(plan.hypotheses, 1)
    )
    asked = (
        "Which of these observers makes the choices"
        if len(names) > 1
        else "How large is the Weber fraction k of this observer"
    )
    return f"{asked}? {each}. Each compares two noisy signals, whose sds go with k."


def _design(plan: Plan) -> str:
    scheme, task = plan.scheme, plan.hypotheses[0].task
    question = "which of two radial distances is the farther"
    if task in ONE_STIMULUS:
        question = "whether a radial distance is farther than the standard held in mind"
    levels = "; ".join(
        f"{1e3 * s:.5g} mm against {_numbers([1e3 * c for c in row])} mm"
        for s, row in zip(scheme.standards, scheme.comparisons, strict=True)
    )
    counts = sorted({n for row in scheme.trials for n in row})
    times = f"{counts[0]}" if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
    return (
        f"Task: {task}, {question}. Method of constant stimuli. "
        f"Standards and comparisons: {levels}. Every pair is shown {times} times to each animal: "
        f"{scheme.animals} animal{'s' * (scheme.animals > 1)}, {scheme.n_trials} trials each, in "
        f"{plan.sessions} session{'s' * (plan.sessions > 1)} of at most {plan.trials_per_session}."
    )


def _order(plan: Plan) -> str:
    if plan.hypotheses[0].task in ONE_STIMULUS:
        return (
            "Trials are randomised within blocks that hold every level equally often (within "
            f"one). Lists are drawn beforehand from seed {plan.seed}, a different one for each "
            "animal and session."
        )
    return (
        "Trials are randomised within blocks that hold every pair equally often (within one). The "
        "standard is the first (left) stimulus in half of the trials of every pair, so that either "
        "answer is right equally often; within a session the right answer repeats as often as it "
        f"changes, and not more than {plan.longest_run} times running. Lists are drawn beforehand "
        f"from seed {plan.seed}, a different one for each animal and session."
    )


def _size(plan: Plan) -> str:
    words = f"The aim is {plan.goal}. "
    if plan.power is not None:
        words += plan.power_in_words() + " "
    return (
        f"{words}It assumes animals with a median Weber fraction of "
        f"{plan.animals.weber_fraction:g} (sd of ln k {plan.animals.spread:g}) and lapses of "
        f"{100 * plan.animals.lapse:g} % a side. Each animal is run to the end of its lists, and "
        "no data are looked at to decide when to stop."
    )


def _analysis(plan: Plan) -> str:
    words = {h.name: _as_fitted(h, plan.together) for h in plan.hypotheses}
    same = len({*words.values()}) == 1
    said = [text if same else f"{name}: {text}" for name, text in words.items()]
    return " ".join(
        [
            *said[: 1 if same else None],
            "The Weber fraction is reported as the posterior median with its equal-tailed 95 % "
            "interval.",
        ]
    )


def _as_fitted(h: Hypothesis, together: bool) -> str:
    # A fit by itself shares one bias between the standards; one that differs would pass for a
    # difference between JND curves, so hypotheses leave it free, and the call says so.
    options = [f'bias="{h.bias}"', *([f'noise="{h.noise}"'] if h.noise != "weber" else [])]
    call = f"with {', '.join(options)}; on the command line --bias '{h.bias}'"
    fitted = (
        f"All animals are fitted together (weberwhisk.fit_population {call}), which learns how "
        "their Weber fractions, lapses and biases spread"
        if together
        else f"Each animal is fitted by itself by quadrature (weberwhisk.fit_weber {call})"
    )
    noise = "of its own stimulus" if h.noise == "weber" else "of the standard"
    noise = "of all stimuli alike" if isinstance(h.encoding, ConstantNoise) else noise
    bias = {"none": "no response bias", "shared": "one response bias b",
            "per standard": "a response bias b for each standard"}[h.bias]  # fmt: skip
    chance = "P(second farther) = λ_lo + (1 − λ_lo − λ_hi) Φ((I2 − I1)/√(σ1² + σ2²) + b)"
    if h.task in ONE_STIMULUS:  # b is the criterion c there, and I1 the standard's signal
        chance = f"P({h.asked.answer}) = λ_lo + (1 − λ_lo − λ_hi) Φ((I2 − I1 − c σ1)/σ2)"
        bias = bias.replace("response bias", "criterion").replace(" b", " c")
    priors = ", ".join(
        f"{name.replace('_', ' ')} ~ {h.priors.words(name)}"
        for name in ("weber_fraction", *h.asked.lapses, "bias")
        if name != "bias" or h.bias != "none"
    )
    if not any(h.priors.is_fixed(name) for name in h.asked.lapses):
        rho = h.priors.lapse_correlation
        priors += f"; normal scores of the two lapse rates correlate by {rho:g}"
    return (
        f"{fitted}: {chance}, each signal with the sd {noise}, σ in proportion to k, two lapse "
        f"rates and {bias}. Priors (SciPy): {priors}."
    )


def _inference(plan: Plan) -> str:
    if plan.goal.bayes_factor is None:
        return (
            "The result is the interval of k; it is called precise if its half-width is below "
            f"{100 * (plan.goal.half_width or 0):g} % of the estimate."
        )
    over = "" if plan.together or plan.scheme.animals == 1 else ", multiplied over animals"
    return (
        f"Hypotheses are compared by their exact evidence{over}. One is accepted if it is more "
        f"than {plan.goal.bayes_factor:g} times as probable as every other (Bayes factor); "
        "otherwise the experiment is reported as undecided."
    )


def _exclusion(plan: Plan) -> str:
    return (
        "No trials are left out but those without an answer. An animal whose fit has the status "
        "REVERSED or ONE_SIDED is reported and left out of the conclusion. [Criteria of training "
        "and health.]"
    )


def _files(plan: Plan) -> str:
    from .. import __version__

    return (
        f"weberwhisk {__version__}; plan.json makes these lists again (SHA-256 "
        f"{plan.fingerprint[:16]}…), and `weberwhisk rehearse plan.json` simulates the whole."
    )


def _numbers(values: Sequence[float]) -> str:
    return ", ".join(f"{value:.5g}" for value in values)
