"""A Weber fraction from a table of choices."""

from __future__ import annotations

from typing import Any

import numpy as np

from .. import _checks
from .likelihood import WeberModel
from .percepts import NOISES, CuePercept, Percept, percept_for, refuse_unfelt, unit_percepts
from .posteriors import GridPosterior, WeberPosterior
from .priors import Priors, priors_for
from .quadrature import integrate
from .result import WeberFit
from .trials import Trials
from .verdict import verdict

BIASES = ("none", "shared", "per standard")
METHODS = ("quadrature", "emcee")


def fit_weber(
    trials: Trials,
    *,
    percept: Percept | None = None,
    observer: Any = None,
    bias: str | None = None,
    noise: str = "weber",
    priors: Any = None,
    method: str = "quadrature",
    seed: int | np.random.SeedSequence | np.random.Generator = 0,
) -> WeberFit:
    """Fit the Weber fraction of one observer, with lapses and bias.

    Parameters
    ----------
    trials : Trials
        From `read_trials` or `simulate_trials`; one subject, any number of standards.
    percept : Percept, optional
        How a stimulus is felt. By default the magnitude itself, or its logarithm where the table is
        on a log scale.
    observer : Observer, optional
        A whisker and a cue, where stimuli are radial distances: short for
        `percept=CuePercept(observer)`.
    bias : {"none", "shared", "per standard"}, optional
        "shared" by default; percent-correct tasks have none.
    noise : {"weber", "equal-variance"}
        The sd of each interval's own stimulus, or the textbook form with that of the standard.
    priors : Priors or mapping, optional
        Frozen SciPy distributions, or numbers for what is known, by parameter:
        `{"lapse_low": scipy.stats.beta(1, 9), "bias": 0.0}`. See `Priors`.
    method : {"quadrature", "emcee"}
    seed : int, SeedSequence or Generator
        Of the sampler, and of draws from the posterior.

    Returns
    -------
    WeberFit
        Always read its `status`.

    Raises
    ------
    ValueError
        For several subjects at once, unknown names, stimuli that cannot be felt.

    Examples
    --------
    >>> from weberwhisk.behaviour import simulate_trials
    >>> fit = fit_weber(simulate_trials(weber_fraction=0.1, seed=1))
    >>> fit.status.name
    'DETERMINED'
    >>> low, high = fit.interval(0.95)
    >>> low < 0.1 < high
    True
    """
    _checks.one_of("noise", noise, NOISES)
    _checks.one_of("method", method, METHODS)
    model, felt, chosen = build_model(trials, percept, observer, bias, noise, priors)
    rng = np.random.default_rng(seed)
    posterior: WeberPosterior
    if method == "emcee":
        from .sampling import sample

        posterior = sample(model.merged(), seed=rng)
    else:
        fewer = model.merged()
        posterior = GridPosterior(fewer, integrate(fewer), int(rng.integers(2**63)))
    status, notes = verdict(model, posterior)
    return WeberFit(
        trials, model, felt, noise, chosen, method, posterior, status, (*trials.notes, *notes)
    )


def build_model(
    trials: Trials,
    percept: Percept | None,
    observer: Any,
    bias: str | None,
    noise: str,
    priors: Any,
) -> tuple[WeberModel, Percept, str]:
    """The model of a fit, its percept, and the bias chosen."""
    if len(trials.subjects) > 1:
        shown = ", ".join(map(repr, trials.subjects[:4]))
        raise ValueError(
            f"{trials.source}: there are {len(trials.subjects)} subjects ({shown}) and one "
            "observer is fitted at a time; choose one with "
            f"trials.select(subject={trials.subjects[0]!r})."
        )
    if percept is not None and observer is not None:
        raise ValueError("percept and observer were both given; give one of them.")
    felt = percept or (
        CuePercept(observer)
        if observer is not None
        else percept_for(trials.scale, trials.log_unit, noise)
    )
    task = trials.task
    chosen = bias or ("shared" if task.has_bias else "none")
    _checks.one_of("bias", chosen, BIASES)
    if chosen != "none" and not task.has_bias:
        raise ValueError(
            f"{task.name} has no response bias to fit, got bias={bias!r}; leave it out."
        )
    cells = trials.cells()
    refuse_unfelt(felt, np.concatenate([cells.stimulus_1, cells.stimulus_2, cells.standard]))
    names: tuple[str, ...] = ()
    group = np.zeros(cells.n.size, dtype=np.intp)
    if chosen == "shared":
        names = ("bias",)
    elif chosen == "per standard":
        levels, group = np.unique(cells.standard, return_inverse=True)
        names = tuple(f"bias[{s:g}]" for s in levels)
    unit_known = trials.scale == "linear" or trials.log_unit is not None
    believed: Priors = priors_for(priors, cells, unit_known)
    both = unit_percepts(felt, cells.stimulus_1, cells.stimulus_2, cells.standard, noise)
    return WeberModel(task, both, cells, believed, group, names), felt, chosen
