"""A plan in words: what it assumes, and a text to paste into a preregistration."""

from __future__ import annotations

from collections.abc import Sequence

from .. import __version__
from .._util.values import counted, paragraphs
from ..behaviour.encodings import ConstantNoise, described
from .hypotheses import ONE_STIMULUS, Hypothesis
from .plan import Plan
from .scheme import easy_share

__all__ = ["assumptions", "notes_of", "offsets_in_words", "preregistration"]


def assumptions(plan: Plan) -> list[str]:
    """What the expected numbers hang on, a sentence each."""
    animals, first = plan.animals, plan.hypotheses[0]
    k = animals.weber_fraction
    easy = easy_share(plan.scheme, first.encoding, k, task=first.task, noise=first.noise)
    return [
        f"Weber fraction of the animals: median {k:g}, ln k with an sd of "
        f"{animals.spread:g} between animals. None has been measured for whisker force or moment.",
        f"Lapses: {100 * animals.lapse:g} % on either side on average. Biases: sd "
        f"{animals.bias_spread:g} between animals, in sds of the difference of the two signals.",
        f"Distance is encoded through {described(first.encoding)}.",
        *notes_of(plan.hypotheses),
        "Noise is independent from trial to trial, k is the same in all sessions, and the two "
        "stimuli are encoded alike.",
        f"{100 * easy:.2g} % of the trials are easy (right in 95 %, lapses aside).",
    ]


def notes_of(hypotheses: Sequence[Hypothesis]) -> list[str]:
    """What observers of the hypotheses leave out, a sentence each: a whisker's shape at rest."""
    looks = (look for h in hypotheses for look in getattr(h.encoding, "looks", (h.encoding,)))
    said = (getattr(getattr(look, "observer", None), "note", "") for look in looks)
    return [f"{words}." for words in dict.fromkeys(said) if words]


def offsets_in_words(offsets: Sequence[float]) -> str:
    """Offsets in millimetres, those that come with either sign once."""
    millimetres = [float(f"{1e3 * o:.4g}") for o in offsets]
    if sorted(millimetres) == sorted(-o for o in millimetres):
        return ", ".join(f"±{o:.4g}" for o in sorted(millimetres) if o > 0)
    return ", ".join(f"{o:+.4g}" for o in millimetres)


def preregistration(plan: Plan) -> str:
    """The plan as a preregistration asks for it: question, design, size, analysis, inference.

    Every number is the plan's. What only the experimenter knows stands in square brackets.
    """
    scheme, goal, given, animals = plan.scheme, plan.goal, plan.hypotheses, plan.animals
    task, number = given[0].task, plan.scheme.animals
    encoded = "; ".join(
        f"({i}) {h.name}: distance is encoded through {described(h.encoding)}"
        for i, h in enumerate(given, 1)
    )
    levels = "; ".join(
        f"{1e3 * s:.5g} mm against {', '.join(f'{1e3 * c:.5g}' for c in row)} mm"
        for s, row in zip(scheme.standards, scheme.comparisons, strict=True)
    )
    counts = sorted({n for row in scheme.trials for n in row})
    times = " to ".join(map(str, dict.fromkeys([counts[0], counts[-1]])))
    asked = "Which of these observers makes the choices"
    if len(given) == 1:
        asked = "How large is the Weber fraction k of this observer"
    question, unit, order = (
        "which of two radial distances is the farther",
        "pair",
        "The standard is the first (left) stimulus in half of the trials of every pair, so that "
        "either answer is right equally often; within a session the right answer repeats as often "
        f"as it changes, and not more than {plan.longest_run} times running. ",
    )
    if task in ONE_STIMULUS:
        question = "whether a radial distance is farther than the standard held in mind"
        unit, order = "level", ""
    size = f"The aim is {goal}. " + ("" if plan.power is None else f"{plan.power_in_words()} ")
    fitted = {h.name: _as_fitted(h, plan.together) for h in given}
    analysis = " ".join(f"{name}: {text}" for name, text in fitted.items())
    if len({*fitted.values()}) == 1:
        analysis = fitted[given[0].name]
    over = "" if plan.together or number == 1 else ", multiplied over animals"
    inference = (
        f"Hypotheses are compared by their exact evidence{over}. One is accepted if it is more "
        f"than {goal.bayes_factor or 0:g} times as probable as every other (Bayes factor); "
        "otherwise the experiment is reported as undecided."
    )
    if goal.half_width is not None:
        inference = (
            "The result is the interval of k; it is called precise if its half-width is below "
            f"{100 * goal.half_width:g} % of the estimate."
        )
    parts = {
        "Question and hypotheses": f"{asked}? {encoded}. Each compares two noisy signals, whose "
        "sds go with k.",
        "Design": f"Task: {task}, {question}. Method of constant stimuli. Standards and "
        f"comparisons: {levels}. Every pair is shown {times} times to each animal: "
        f"{counted(number, 'animal')}, {scheme.n_trials} trials each, in "
        f"{counted(plan.sessions, 'session')} of at most {plan.trials_per_session}.",
        "Order of trials": f"Trials are randomised within blocks that hold every {unit} equally "
        f"often (within one). {order}Lists are drawn beforehand from seed {plan.seed}, a "
        "different one for each animal and session.",
        "Sample size": f"{size}It assumes animals with a median Weber fraction of "
        f"{animals.weber_fraction:g} (sd of ln k {animals.spread:g}) and lapses of "
        f"{100 * animals.lapse:g} % a side. Each animal is run to the end of its lists, and no "
        "data are looked at to decide when to stop.",
        "Analysis": f"{analysis} The Weber fraction is reported as the posterior median with its "
        "equal-tailed 95 % interval.",
        "Inference": inference,
        "Exclusion": "No trials are left out but those without an answer. An animal whose fit has "
        "the status REVERSED or ONE_SIDED is reported and left out of the conclusion. [Criteria of "
        "training and health.]",
        "Files": f"weberwhisk {__version__}; plan.json makes these lists again (SHA-256 "
        f"{plan.fingerprint[:16]}…), and `weberwhisk rehearse plan.json` simulates the whole.",
    }
    text = paragraphs({heading: [said] for heading, said in parts.items()}, 92)
    return f"{plan.title}\n\n{text}"


def _as_fitted(h: Hypothesis, together: bool) -> str:
    # A fit by itself shares one bias between the standards; one that differs would pass for a
    # difference between JND curves, so hypotheses leave it free, and the call says so.
    options = [f'bias="{h.bias}"', *([f'noise="{h.noise}"'] if h.noise != "weber" else [])]
    call = f"with {', '.join(options)}; on the command line --bias '{h.bias}'"
    fitted = (
        f"All animals are fitted together (weberwhisk.fit_population {call}), which learns how "
        "their Weber fractions spread"
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
