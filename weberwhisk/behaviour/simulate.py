"""Choices of an observer with known parameters, repeatable to the byte."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from .. import _checks
from .percepts import (
    CuePercept,
    IdentityPercept,
    LogAxisPercept,
    LogPercept,
    Percept,
    refuse_unfelt,
)
from .psychometric import response_probability
from .tasks import task_named
from .trials import Trials

Array = NDArray[np.float64]

SIGNED_OFFSETS = tuple(np.linspace(-0.3, 0.3, 9).round(12).tolist())


def simulate_trials(
    *,
    weber_fraction: float = 0.1,
    standards: ArrayLike = 1.0,
    offsets: ArrayLike | None = None,
    comparisons: ArrayLike | None = None,
    trials_per_level: int = 40,
    lapse_low: float = 0.0,
    lapse_high: float = 0.0,
    bias: ArrayLike = 0.0,
    percept: Percept | None = None,
    observer: Any = None,
    noise: str = "weber",
    sessions: int = 1,
    subject: str | None = None,
    missing: float = 0.0,
    task: str = "2AFC",
    seed: int | np.random.SeedSequence | np.random.Generator,
) -> Trials:
    """Trials of one observer: every comparison at every standard, shuffled within sessions.

    Parameters
    ----------
    weber_fraction : float
        Noise sd of each signal over its mean.
    standards : array_like, shape (S,)
        Stimulus 1: magnitudes, logarithms (with a log percept) or radial distances in metres.
    offsets : array_like, optional
        Comparisons relative to each standard: standard × (1 + offset), or standard + offset on a
        log scale. Nine signed levels to ±0.30 where neither these nor comparisons are given.
    comparisons : array_like, shape (C,) or (S, C), optional
        Comparisons themselves, instead of offsets.
    trials_per_level : int
        Trials of each comparison at each standard, over all sessions together.
    lapse_low, lapse_high : float
        Share of answers lost at either end.
    bias : float or array_like, shape (S,)
        In sds of the difference between the percepts, positive towards "second greater".
    percept : Percept, optional
        How a stimulus is felt; the magnitude itself by default.
    observer : Observer, optional
        A whisker and a cue: short for `percept=CuePercept(observer)`.
    noise : {"weber", "equal-variance"}
    sessions : int
        The trials are dealt out evenly over this many sessions.
    subject : str, optional
        Written in its own column.
    missing : float
        Share of trials on which the animal gives no answer.
    task : str
        As in `read_trials`.
    seed : int, SeedSequence or Generator
        The same seed gives the same trials, on every platform.

    Returns
    -------
    Trials

    Raises
    ------
    ValueError
        For a negative Weber fraction, lapses that do not sum to less than 1, and the like.

    Examples
    --------
    >>> trials = simulate_trials(weber_fraction=0.1, standards=[1.0, 2.0], seed=1)
    >>> trials.n_trials, trials.standards
    (720, array([1., 2.]))
    """
    asked = task_named(task)
    _checks.positive("weber_fraction", weber_fraction, "write for example 0.1")
    for name, value in (("lapse_low", lapse_low), ("lapse_high", lapse_high), ("missing", missing)):
        if float(_checks.non_negative(name, value, "write for example 0.02")) >= 1:
            raise ValueError(f"{name} must be below 1, got {value:g}; write for example 0.02.")
    if lapse_low + lapse_high >= 1:
        raise ValueError(
            f"lapse_low + lapse_high must be below 1, got {lapse_low + lapse_high:g}; "
            "write for example 0.02 for each."
        )
    for name, whole in (("trials_per_level", trials_per_level), ("sessions", sessions)):
        if whole != int(whole) or whole < 1:
            raise ValueError(
                f"{name} must be a whole number of 1 or more, got {whole!r}; write 40."
            )
    if percept is not None and observer is not None:
        raise ValueError("percept and observer were both given; give one of them.")
    felt: Percept = percept or (CuePercept(observer) if observer is not None else IdentityPercept())
    is_log = isinstance(felt, (LogPercept, LogAxisPercept))
    base = np.atleast_1d(
        _checks.finite("standards", standards, "give one stimulus or several")
    ).ravel()
    levels = _levels(base, offsets, comparisons, is_log)
    shift = np.broadcast_to(_checks.finite("bias", bias, "write for example 0"), base.shape)
    _refuse_outside(felt, np.concatenate([base, levels.ravel()]))

    rng = np.random.default_rng(seed)
    s1 = np.repeat(base, levels.shape[1] * trials_per_level)
    s2 = np.repeat(levels.ravel(), trials_per_level)
    p = np.concatenate(
        [
            response_probability(
                asked,
                felt,
                np.full(levels.shape[1], s),
                row,
                weber_fraction=weber_fraction,
                lapse_low=lapse_low,
                lapse_high=lapse_high,
                bias=b,
                noise=noise,
            )
            for s, row, b in zip(base, levels, shift, strict=True)
        ]
    )
    # Uniform numbers alone: the streams of the other distributions may change between versions.
    order = np.argsort(rng.random(s1.size), kind="stable")
    answer = (rng.random(s1.size) < np.repeat(p, trials_per_level)).astype(float)
    answer[rng.random(s1.size) < missing] = np.nan
    session = np.sort(np.arange(s1.size) % sessions) + 1
    first = np.searchsorted(session, session)
    columns: dict[str, Any] = {} if subject is None else {"subject": np.full(s1.size, subject)}
    frame = pd.DataFrame(
        {
            **columns,
            "session": session,
            "trial": np.arange(s1.size) - first + 1,
            "standard": s1[order],
            "stimulus_1": s1[order],
            "stimulus_2": s2[order],
            "n": np.ones(s1.size, dtype=np.int64),
            "count": answer[order],
        }
    )
    lost = int(np.isnan(answer).sum())
    notes = (f"{lost} trials have no answer and stay out of the likelihood.",) if lost else ()
    unit = felt.log_unit if isinstance(felt, (LogPercept, LogAxisPercept)) else None
    return Trials(frame, asked, "log" if is_log else "linear", unit, "simulated trials", notes)


def _levels(base: Array, offsets: Any, comparisons: Any, is_log: bool) -> Array:
    """Comparisons of every standard, (S, C)."""
    if offsets is not None and comparisons is not None:
        raise ValueError("offsets and comparisons were both given; give one of them.")
    if comparisons is not None:
        given = np.atleast_1d(
            _checks.finite("comparisons", comparisons, "give one level or several")
        )
        if given.ndim > 1 and given.shape[0] != base.size:
            raise ValueError(
                f"comparisons has {given.shape[0]} rows for {base.size} standards; "
                "give one row each."
            )
        return np.broadcast_to(given, (base.size, given.shape[-1]))
    relative = np.atleast_1d(
        _checks.finite(
            "offsets", SIGNED_OFFSETS if offsets is None else offsets, "write for example 0.1"
        )
    )
    levels = base[:, None] + relative if is_log else base[:, None] * (1 + relative)
    # Twelve digits: a level is written as one would write it, and the same level is one level.
    return np.array([[float(f"{value:.12g}") for value in row] for row in levels])


def _refuse_outside(percept: Percept, stimuli: Array) -> None:
    low, high = percept.domain
    outside = (stimuli <= low) | (stimuli >= high)
    if outside.any():
        raise ValueError(
            f"stimulus {stimuli[outside][0]:g} lies outside what can be felt, {low:g} to {high:g}; "
            "choose other standards or comparisons."
        )
    refuse_unfelt(percept, stimuli)
