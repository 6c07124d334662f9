"""What was done, as a methods section says it."""

from __future__ import annotations

from importlib.metadata import version

import numpy as np
import pandas as pd

from .. import __version__
from .._util.values import counted
from ..inference.coordinates import in_words
from ..receptors import Weber
from ..recordings.locate import methods_of
from .cue_encoding import CueEncoding
from .encodings import Encoding, IdentityEncoding, described
from .estimates import Estimates
from .population_fit import PopulationFit
from .tasks import SignedChoice

__all__ = ["methods_paragraph"]

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


def methods_paragraph(fit: Estimates | PopulationFit | pd.DataFrame) -> str:
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
        said = _of_many(fit) if isinstance(fit, PopulationFit) else _of_one(fit)
    made = f"weberwhisk {__version__} (NumPy {np.__version__}, SciPy {version('scipy')})"
    return " ".join([*said, f"This was done with {made}."])


def _of_one(fit: Estimates) -> list[str]:
    trials, cells = fit.trials, fit.model.cells
    missing = f" ({trials.n_missing} without an answer were left out)" if trials.n_missing else ""
    said = [
        f"A model of the observer was fitted to {counted(trials.n_trials, 'trial')}{missing} of "
        f"the task {trials.task.name}, with {counted(cells.n.size, 'pair')} of stimuli at "
        f"{counted(fit.standards.size, 'standard')}.",
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
    if fit.model.n_states > 1:
        said.append(_STATES[fit.model.n_states])
    if fit.effects:
        said.append(f"The model also has these effects: {', '.join(fit.effects)}.")
    return [*said, _priors(fit), _how(fit.method), f"The fit's status: {fit.status.name}."]


def _priors(fit: Estimates, *more: str) -> str:
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
        f"A hierarchical model was fitted to {counted(int(used['n'].sum()), 'trial')} of the task "
        f"{one.trials.task.name}, of {counted(len(used), 'animal')}: ln k is normal between "
        "animals, each learning from the others (partial pooling).",
        *fit.notes,
        _encoded(one.encoding, _NOISE[one.noise]),
        _priors(one, f"spread ~ {in_words(fit.spread_prior)}"),
        _how("quadrature"),
        status,
    ]


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
    by = {"quadrature": "by quadrature", "importance": "by importance sampling"}.get(
        method, f"with {method}"
    )
    return f"Posteriors were computed {by}; estimates are medians with equal-tailed 95 % intervals."
