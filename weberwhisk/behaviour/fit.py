"""A Weber fraction from a table of choices, by quadrature or by emcee."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _checks
from .._deprecated import renamed_arguments
from ..threads import one_blas_thread
from .effects import Effect, check_effects
from .encodings import (
    NOISES,
    Encoding,
    UnitEncodings,
    chosen_encoding,
    encoding_for,
    refuse_unencoded,
    unit_encodings,
)
from .integrate import refined
from .likelihood import WeberModel, gather
from .located import at_touches, over_places
from .posteriors import (
    QuadraturePosterior,
    SampledPosterior,
    WeberPosterior,
    find_mode,
    log_posterior,
    split,
)
from .priors import priors_for
from .result import WeberFit
from .trials import Cells, Trials, check_trials
from .verdict import verdict

Array = NDArray[np.float64]

BIASES = ("none", "shared", "per standard")
METHODS = ("quadrature", "emcee")


@renamed_arguments(percept="encoding")
@one_blas_thread
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
        Where the touches of each trial were located (`ww.locate`), in place of nominal distances,
        or the contacts to locate by the observer's whisker; see `with_distances`. Of an observer
        that does not know the deflection angle, it is then the median of those located.
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
        trials, encoding = at_touches(trials, distances, encoding, observer)
        observer = None
    model, encoded, chosen = build_model(trials, encoding, observer, bias, noise, priors, effects)
    # One parameter more than five costs a sampler less than a grid.
    by_itself = "quadrature" if sum(model.free) + model.free_bias <= 5 else "emcee"
    used = by_itself if method is None else method
    _checks.one_of("method", used, METHODS)
    rng = _checks.generator(seed)
    fewer = model.merged()
    posterior: WeberPosterior
    if used == "emcee":
        posterior = sample(fewer, seed=rng)
    else:
        posterior = QuadraturePosterior(fewer, refined(fewer), int(rng.integers(2**63)))
    status, notes = verdict(model, posterior)
    return WeberFit(
        trials, model, encoded, noise, chosen, used, posterior, status, (*trials.notes, *notes)
    )


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
    cells, columns, _ = gather(trials, tuple(effects), encoded)
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
        names = names_by_standard(label, levels)
    unit_known = trials.scale == "linear" or trials.log_unit is not None
    believed = priors_for(priors, cells, unit_known, task, by_name, [both])
    model = WeberModel(task, both, cells, believed, group, names, bound, columns)
    return model, encoded, chosen


def names_by_standard(label: str, standards: Array) -> tuple[str, ...]:
    """A name for the bias of each standard, in full where six digits would name two alike."""
    short = tuple(f"{label}[{s:g}]" for s in standards)
    if len(set(short)) == len(short):
        return short
    return tuple(f"{label}[{float(s)!r}]" for s in standards)


def encoding_of(trials: Trials, encoding: Encoding | None, observer: Any, noise: str) -> Encoding:
    """The encoding of a fit: the one given, or that of a whisker, or what the table calls for."""
    given = chosen_encoding(encoding, observer)
    return encoding_for(trials.scale, trials.log_unit, noise) if given is None else given


def pairs_shown(cells: Cells, encoding: Encoding, noise: str) -> UnitEncodings:
    """Both encoded stimuli of every cell, refused where one gives no signal."""
    stimuli = cells.stimulus_1, cells.stimulus_2, cells.standard
    refuse_unencoded(encoding, np.concatenate(stimuli))
    return unit_encodings(encoding, *stimuli, noise)


def sample(
    model: WeberModel,
    *,
    seed: int | np.random.SeedSequence | np.random.Generator,
    ensembles: int = 4,
    precision: float = 0.03,
) -> SampledPosterior:
    """Sample the posterior with emcee, in the coordinates of `stretch` (biases as they are).

    R-hat compares so many independent ensembles; `precision` is the Monte Carlo error requested, in
    posterior sds. `trouble` says so where the run has not converged.
    """
    from ..posterior.arviz_io import Shortfall
    from ..posterior.ensemble import sample_stacked

    rng = np.random.default_rng(seed)
    free = np.flatnonzero(model.free)
    dim = free.size + (model.n_groups if model.free_bias else 0)
    if dim == 0:
        raise ValueError("every parameter is fixed; leave at least one of them a distribution.")
    transforms = [model.transforms[i] for i in free]
    ends = np.array([s.ends for s in transforms]).reshape(-1, 2).T

    def with_scores(theta: Array) -> Array:
        """Scores in place of the coordinates."""
        out = theta.copy()
        for i, transform in enumerate(transforms):
            out[..., i] = transform.score(theta[..., i])
        return out

    def log_density(theta: Array) -> Array:
        t = theta[..., : free.size]
        inside = ((t > ends[0]) & (t < ends[1])).all(axis=-1)
        out = log_posterior(model, with_scores(theta))
        for i, transform in enumerate(transforms):
            out = out + np.log(transform.slope(t[..., i]))
        return np.where(inside, out, -np.inf)

    centre, information = find_mode(model, np.zeros(len(model.lead)))
    root = np.linalg.cholesky(np.linalg.inv(information))
    walkers = max(64, 4 * dim)
    centre[: free.size] = [s.coordinate(z) for s, z in zip(transforms, centre, strict=False)]
    # Of answers at chance lapses take all: the mode lies where they leave no rise, at the edge.
    for _ in range(60):
        if np.isfinite(log_density(centre)):
            break
        centre[: free.size] *= 0.9
    per_score = np.ones(dim)
    at = centre[: free.size]
    per_score[: free.size] = [1 / s.slope(t) for s, t in zip(transforms, at, strict=True)]
    start = centre + rng.standard_normal((1, ensembles, walkers, dim)) @ root.T * per_score
    # A start outside the support is pulled towards the mode until it is inside.
    for _ in range(60):
        lost = ~np.isfinite(log_density(start))
        if not lost.any():
            break
        start[lost] = centre + 0.5 * (start[lost] - centre)
    run = sample_stacked(log_density, start, seed=rng, precision=precision)
    flat = run.values[0].reshape(-1, dim)
    error = float(np.max(run.mcse_mean[0, :dim] / run.sd[0, :dim]))
    trouble = "" if run.converged[0] else f"emcee: {Shortfall(int(run.shortfall[0])).message}"
    draws = model.draws_at(*split(model, with_scores(flat)))
    return SampledPosterior(model, draws, ensembles, error, trouble)
