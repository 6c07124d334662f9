"""A paragraph for the methods section of a paper: counts, model, priors, versions."""

from __future__ import annotations

from importlib.metadata import version

import numpy as np

from .. import __version__
from ..receptors import Weber
from .cue_encoding import CueEncoding
from .encodings import Encoding, IdentityEncoding
from .population_fit import PopulationFit
from .priors import PopulationPriors, Priors
from .result import WeberFit
from .tasks import SignedChoice

_NOISE = {
    "weber": "an sd of the Weber fraction k times its own signal",
    "equal-variance": "the sd that the standard's signal gives, k times it",
}


def methods_paragraph(fit: WeberFit | PopulationFit) -> str:
    """What was done to the choices, as a methods section says it; every number is the fit's.

    Parameters
    ----------
    fit : WeberFit or PopulationFit

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
    said = _of_one(fit) if isinstance(fit, WeberFit) else _of_many(fit)
    made = f"weberwhisk {__version__} (NumPy {np.__version__}, SciPy {version('scipy')})"
    return " ".join([*said, f"Fits were made with {made}."])


def _of_one(fit: WeberFit) -> list[str]:
    trials, cells = fit.trials, fit.model.cells
    missing = f" ({trials.n_missing} without an answer were left out)" if trials.n_missing else ""
    said = [
        f"A model of the observer was fitted to {_counted(trials.n_trials, 'trial')}{missing} of "
        f"the task {trials.task.name}, with {_counted(cells.n.size, 'pair')} of stimuli at "
        f"{_counted(trials.standards.size, 'standard')}.",
        _encoded(fit.encoding, _NOISE[fit.noise]),
    ]
    if isinstance(trials.task, SignedChoice) and not fit.effects:
        said.append(
            "The second stimulus is reported greater with probability λ_lo + (1 − λ_lo − λ_hi) "
            f"Φ(d{' + b' * (fit.bias != 'none')}), where d is the difference of the two signals "
            f"over its sd and λ_lo, λ_hi are lapse rates{_bias(fit.bias)}."
        )
    if fit.effects:
        said.append(f"The model also has these effects: {', '.join(fit.effects)}.")
    believed, lapses = fit.model.priors, trials.task.lapses
    priors = [f"{name} ~ {words}" for name, words in fit.summary()["prior"].items()]
    given = ("weber_fraction", *lapses)
    priors += [f"{n} {believed.words(n)}" for n in given if believed.is_fixed(n)]
    said.append(f"Parameters and priors: {', '.join(priors)}{_correlated(believed, lapses)}.")
    return [*said, _how(fit.method), f"The fit's status: {fit.status.name}."]


def _of_many(fit: PopulationFit) -> list[str]:
    trials = int(fit.subjects["n"].sum())
    levels = "" if fit.sessions is None else f" and {_counted(len(fit.sessions), 'session')}"
    priors = [f"{name} ~ {fit.believed.words(name)}" for name in ("weber_fraction", *fit.lapses)]
    own = ["spread", *["session_spread"] * (fit.sessions is not None), "lapse_mean", "lapse_spread"]
    own += ["bias_scale"] * ("bias_scale" in fit.parameters)
    priors += [f"{name} ~ {_prior(fit.priors, name)}" for name in own]
    return [
        f"A hierarchical model was fitted to {_counted(trials, 'trial')} of "
        f"{_counted(len(fit.subjects), 'animal')}{levels}: ln k is normal between animals, each "
        "learning from the others (partial pooling), and so are the normal scores of lapse rates.",
        f"Parameters and priors: {', '.join(priors)}.",
        _how("quadrature"),
        f"The fit's status: {fit.status.name}.",
    ]


def _counted(number: int, thing: str) -> str:
    return f"{number} {thing}{'s' * (number != 1)}"


def _encoded(encoding: Encoding, noise: str) -> str:
    if isinstance(encoding, IdentityEncoding):
        return f"The signal of a stimulus is its magnitude, noisy with {noise}."
    if isinstance(encoding, CueEncoding):
        observer, whisker = encoding.observer, encoding.observer.whisker
        cue, receptors = (type(part).__name__ for part in (observer.cue, observer.noise))
        hinge = whisker.hinge_stiffness
        on = "" if hinge is None else f" on a hinge of {hinge:.4g} N m/rad"
        plain = isinstance(observer.noise, Weber) and len(observer.cue.signal_names) == 1
        return (
            f"Radial distance is encoded through a whisker {whisker.length * 1e3:.4g} mm long, of "
            f"radius {whisker.base_radius * 1e6:.4g} µm at its base and "
            f"{whisker.tip_radius * 1e6:.4g} µm at its tip,{on} by the cue {cue} with receptors "
            f"{receptors}{f': the signal is noisy with {noise}' * plain}."
        )
    return f"Stimuli are encoded by {type(encoding).__name__}."


def _correlated(priors: Priors, lapses: tuple[str, ...]) -> str:
    """How the beliefs about two lapse rates hang together."""
    if len(lapses) < 2 or any(priors.is_fixed(name) for name in lapses):
        return ""
    return f"; the normal scores of the two lapse rates correlate by {priors.lapse_correlation:g}"


def _bias(bias: str) -> str:
    if bias == "none":
        return ""
    return f"; the bias b is {'shared by all standards' if bias == 'shared' else bias}"


def _how(method: str) -> str:
    by = "by quadrature" if method == "quadrature" else f"with {method}"
    return f"Posteriors were computed {by}; estimates are medians with equal-tailed 95 % intervals."


def _prior(priors: PopulationPriors, name: str) -> str:
    prior = getattr(priors, name)
    given = [f"{a:.4g}" for a in prior.args] + [f"{k}={v:.4g}" for k, v in prior.kwds.items()]
    return f"{prior.dist.name}({', '.join(given)})"
