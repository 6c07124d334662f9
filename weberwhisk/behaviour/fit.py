"""A Weber fraction from a table of choices."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from .. import _checks
from .._deprecated import renamed_arguments
from ..threads import one_blas_thread
from .effects import Effect, check_effects
from .encodings import (
    NOISES,
    Encoding,
    IdentityEncoding,
    UnitEncodings,
    chosen_encoding,
    encoding_for,
    refuse_unencoded,
    unit_encodings,
)
from .integrate import refined
from .likelihood import WeberModel, gather
from .located import over_places, with_distances
from .posteriors import QuadraturePosterior, WeberPosterior
from .priors import priors_for
from .result import WeberFit
from .trials import Cells, Trials, check_trials
from .verdict import verdict

BIASES = ("none", "shared", "per standard")
METHODS = ("quadrature", "emcee")
MOST_BY_QUADRATURE = 5  # parameters; one more costs a sampler less than a grid


@one_blas_thread
@renamed_arguments(percept="encoding")
def fit_weber(
    trials: Trials,
    *,
    encoding: Encoding | None = None,
    observer: Any = None,
    bias: str | None = None,
    noise: str = "weber",
    effects: Sequence[Effect] = (),
    priors: Any = None,
    method: str | None = None,
    distances: Any = None,
    seed: int | np.random.SeedSequence | np.random.Generator = 0,
) -> WeberFit:
    """Fit the Weber fraction of one observer, with lapses and bias.

    Parameters
    ----------
    trials : Trials
        From `read_trials` or `simulate_trials`; one subject, any number of standards.
    encoding : Encoding, optional
        How a stimulus is encoded. By default the magnitude itself, or its logarithm
        where the table is on a log scale.
    observer : Observer, optional
        A whisker and a cue, where stimuli are radial distances: short for
        `encoding=CueEncoding(observer)`.
    bias : {"none", "shared", "per standard"}, optional
        "shared" by default; percent-correct tasks have none. Of yes/no, go/no-go and
        same–different tasks it is the criterion.
    noise : {"weber", "equal-variance"}
        The sd of each interval's own stimulus, or the textbook form with that of the standard.
    effects : sequence of Effect
        What else may move the answers, a parameter each: a floor, near-miss exponent, drift over
        sessions, history, contraction, overdispersion; see `weberwhisk.behaviour.effects`.
    priors : Priors or mapping, optional
        Frozen SciPy distributions, or numbers for what is known, by parameter:
        `{"lapse_low": scipy.stats.beta(1, 9), "bias": 0.0}`; `{"weber_fraction": "levels"}` where
        the levels were chosen to bracket the animal's thresholds. See `Priors`.
    method : {"quadrature", "emcee"}, optional
        By default quadrature up to five parameters (biases of standards count as one, being
        integrated one by one), and emcee beyond.
    distances : DataFrame or path, optional
        Where the touches of each trial were located (`ww.locate`), in place of nominal distances;
        see `with_distances`.
    seed : int, SeedSequence or Generator
        Of the sampler, and of draws from the posterior.

    Returns
    -------
    WeberFit
        Always read its `status`.

    Raises
    ------
    ValueError
        For several subjects at once, unknown names, stimuli that give no signal.

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
    if distances is not None:
        encoded_as = chosen_encoding(encoding, observer) or IdentityEncoding()
        trials = with_distances(trials, distances, encoded_as)
    model, encoded, chosen = build_model(trials, encoding, observer, bias, noise, priors, effects)
    by_itself = "quadrature" if _dimensions(model) <= MOST_BY_QUADRATURE else "emcee"
    used = by_itself if method is None else method
    _checks.one_of("method", used, METHODS)
    rng = _checks.generator(seed)
    fewer = model.merged()
    posterior: WeberPosterior
    if used == "emcee":
        from .sampling import sample

        posterior = sample(fewer, seed=rng)
    else:
        posterior = QuadraturePosterior(fewer, refined(fewer), int(rng.integers(2**63)))
    status, notes = verdict(model, posterior)
    return WeberFit(
        trials, model, encoded, noise, chosen, used, posterior, status, (*trials.notes, *notes)
    )


def _dimensions(model: WeberModel) -> int:
    return sum(model.free) + model.free_bias


def build_model(
    trials: Trials,
    encoding: Encoding | None,
    observer: Any,
    bias: str | None,
    noise: str,
    priors: Any,
    effects: Sequence[Effect] = (),
) -> tuple[WeberModel, Encoding, str]:
    """The model of a fit, its encoding, and the bias chosen."""
    check_trials(trials)
    check_effects(effects)
    if len(trials.subjects) > 1:
        raise ValueError(
            f"{trials.source}: there are {len(trials.subjects)} subjects "
            f"({_checks.listed(trials.subjects)}) and one observer is fitted at a time; choose "
            "one with "
            f"trials.select(subject={trials.subjects[0]!r})."
        )
    encoded = encoding_of(trials, encoding, observer, noise)
    task = trials.task
    by_itself = "shared" if task.has_bias else "none"
    chosen = by_itself if bias is None else bias
    _checks.one_of("bias", chosen, BIASES)
    if chosen != "none" and not task.has_bias:
        raise ValueError(
            f"{task.name} has no response bias to fit, got bias={bias!r}; leave it out."
        )
    cells, columns = gather(trials, tuple(effects), encoded)
    both = pairs_shown(cells, encoded, noise)
    if cells.sd_1 is not None:
        both = over_places(task, encoded, cells, both, noise)
    if cells.n.size and not (both.sd_1.any() or both.sd_2.any()):
        raise ValueError(
            "no noise of these signals goes with a Weber fraction, so there is none to fit: that "
            "of angles is a constant; give receptors whose noise grows, receptors.Weber(0.1), say."
        )
    bound = tuple(effect.bound(both, cells.n) for effect in effects)
    by_name = {effect.name: effect.prior for effect in bound}
    if len(by_name) < len(bound):
        raise ValueError(
            f"effects must differ, got {', '.join(e.name for e in bound)}; name each once."
        )
    names: tuple[str, ...] = ()
    group = np.zeros(cells.n.size, dtype=np.intp)
    label = task.bias_name or "bias"
    if chosen == "shared":
        names = (label,)
    elif chosen == "per standard":
        levels, group = np.unique(cells.standard, return_inverse=True)
        names = tuple(f"{label}[{s:g}]" for s in levels)
    unit_known = trials.scale == "linear" or trials.log_unit is not None
    believed = priors_for(priors, cells, unit_known, task, by_name, [both])
    model = WeberModel(task, both, cells, believed, group, names, bound, columns)
    return model, encoded, chosen


def encoding_of(trials: Trials, encoding: Encoding | None, observer: Any, noise: str) -> Encoding:
    """The encoding of a fit: the one given, or that of a whisker, or what the table calls for."""
    given = chosen_encoding(encoding, observer)
    return encoding_for(trials.scale, trials.log_unit, noise) if given is None else given


def pairs_shown(cells: Cells, encoding: Encoding, noise: str) -> UnitEncodings:
    """Both encoded stimuli of every cell, refused where one gives no signal."""
    stimuli = cells.stimulus_1, cells.stimulus_2, cells.standard
    refuse_unencoded(encoding, np.concatenate(stimuli))
    return unit_encodings(encoding, *stimuli, noise)
