"""What was done, as a methods section says it."""

from __future__ import annotations

from .._util.values import counted, methods_text
from ..receptors import Weber
from .cue_encoding import CueEncoding
from .encodings import Encoding, IdentityEncoding, described
from .estimates import Estimates
from .tasks import SignedChoice

__all__ = ["encoded", "how", "of_fit", "priors"]

_NOISE = {
    "weber": "an sd of the Weber fraction k times its own signal",
    "equal-variance": "the sd that the standard's signal gives, k times it",
}

_CHAIN = (
    "Before each trial the state is kept with probability 1 − switch, and otherwise, as at the "
    "start of a session, drawn anew: engaged with the probability of that name"
)
_STATES = {
    2: "The animal is a hidden Markov chain of two states: engaged, the observer above, and "
    "disengaged, with one probability of the answer, answer_away, whatever the stimuli. "
    f"{_CHAIN}.",
    3: "The animal is a hidden Markov chain of three states: engaged, the observer above, and two "
    "disengaged ones, with probabilities of the answer, answer_low and answer_high, whatever the "
    f"stimuli (Ashwood et al. 2022). {_CHAIN}; side is the share of answer_high in the rest.",
}


def of_fit(fit: Estimates) -> str:
    """What was done to the choices of one observer."""
    trials, cells = fit.trials, fit.model.cells
    missing = f" ({trials.n_missing} without an answer were left out)" if trials.n_missing else ""
    said = [
        f"A model of the observer was fitted to {counted(trials.n_trials, 'trial')}{missing} of "
        f"the task {trials.task.name}, with {counted(cells.n.size, 'pair')} of stimuli at "
        f"{counted(fit.standards.size, 'standard')}.",
        encoded(fit.encoding, fit.noise),
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
        said.append(_STATES[fit.model.n_states])
    if fit.effects:
        said.append(f"The model also has these effects: {', '.join(fit.effects)}.")
    said += [priors(fit), how(fit.method), f"The fit's status: {fit.status.name}."]
    return methods_text(said)


def priors(fit: Estimates, *more: str) -> str:
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


def encoded(encoding: Encoding, noise_name: str) -> str:
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


def how(method: str) -> str:
    """How posteriors were computed, in a sentence."""
    by = {"quadrature": "by quadrature", "importance": "by importance sampling"}.get(
        method, f"with {method}"
    )
    return f"Posteriors were computed {by}; estimates are medians with equal-tailed 95 % intervals."
