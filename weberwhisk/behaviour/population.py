"""Choices of many animals whose Weber fractions differ, with the truth of each."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.special import ndtri
from scipy.stats import beta as beta_distribution

from .. import _checks
from .simulate import simulate_trials
from .trials import Trials, check_trials, notes_of

Array = NDArray[np.float64]


def simulate_population(
    subjects: int,
    *,
    weber_fraction: float = 0.1,
    spread: float = 0.3,
    session_spread: float = 0.0,
    lapse_low: float = 0.02,
    lapse_high: float = 0.02,
    bias: float = 0.0,
    bias_spread: float = 0.2,
    sessions: int = 1,
    seed: int | np.random.SeedSequence | np.random.Generator,
    **design: Any,
) -> tuple[Trials, pd.DataFrame]:
    """Trials of several animals drawn from one population, and what was drawn.

    Parameters
    ----------
    subjects : int
    weber_fraction : float
        Median of the population.
    spread : float
        Standard deviation of ln k between animals.
    session_spread : float
        Standard deviation of ln k between the sessions of one animal.
    lapse_low, lapse_high : float
        Mean lapse λ at either end, each animal's own from Beta(2, 2/λ − 2).
    bias, bias_spread : float
        Mean and standard deviation of the biases.
    sessions : int
    seed : int, SeedSequence or Generator
    **design
        As for `simulate_trials`: standards, offsets, trials_per_level, percept, task, …

    Returns
    -------
    trials : Trials
        With columns `subject` (s1, s2, …) and `session`.
    truth : DataFrame
        One row an animal: `subject`, `weber_fraction`, `lapse_low`, `lapse_high`, `bias`; drawn to
        four digits, so that what is written down is what was used.

    Examples
    --------
    >>> trials, truth = simulate_population(3, trials_per_level=5, seed=1)
    >>> trials.subjects, truth.columns.tolist()[:2]
    (['s1', 's2', 's3'], ['subject', 'weber_fraction'])
    """
    rng = _checks.generator(seed)
    subjects = _checks.whole("subjects", subjects, "write 6, say")
    truth = draw_animals(
        subjects, weber_fraction=weber_fraction, spread=spread, lapse_low=lapse_low,
        lapse_high=lapse_high, bias=bias, bias_spread=bias_spread, seed=rng,
    )  # fmt: skip
    sessions = _checks.whole("sessions", sessions, "write 10, say")
    _spread("session_spread", session_spread)
    wander = ndtri(np.clip(rng.random((subjects, sessions)), 1e-12, 1 - 1e-12))
    parts = []
    for i, row in enumerate(truth.to_dict("records")):
        animal = {str(name): value for name, value in row.items()}
        k = animal.pop("weber_fraction") * np.exp(session_spread * wander[i])
        parts.append(
            simulate_trials(
                **animal,
                weber_fraction=k if session_spread else k[:1],
                sessions=sessions,
                seed=rng,
                **design,
            )
        )
    return joined(parts), truth


def draw_animals(
    subjects: int,
    *,
    weber_fraction: float = 0.1,
    spread: float = 0.3,
    lapse_low: float = 0.02,
    lapse_high: float = 0.02,
    bias: float = 0.0,
    bias_spread: float = 0.2,
    seed: int | np.random.SeedSequence | np.random.Generator,
) -> pd.DataFrame:
    """Animals drawn from one population: the truth of `simulate_population`, a row an animal.

    Examples
    --------
    >>> draw_animals(2, spread=0.0, bias_spread=0.0, seed=1)[["subject", "weber_fraction"]]
      subject  weber_fraction
    0      s1             0.1
    1      s2             0.1
    """
    subjects = _checks.whole("subjects", subjects, "write 6, say")
    hint = "write for example 0.1"
    _checks.positive("weber_fraction", _checks.number("weber_fraction", weber_fraction, hint), hint)
    _checks.number("bias", bias, "write for example 0")
    for name, value in (
        ("spread", spread),
        ("bias_spread", bias_spread),
        ("lapse_low", lapse_low),
        ("lapse_high", lapse_high),
    ):
        _spread(name, value)
        if name.startswith("lapse") and value >= 0.5:
            raise ValueError(f"{name} must be below 0.5, got {value:g}; write for example 0.02.")
    rng = _checks.generator(seed)
    # Uniform numbers alone, as in `simulate_trials`.
    u = np.clip(rng.random((subjects, 4)), 1e-12, 1 - 1e-12)
    return pd.DataFrame(
        {
            "subject": [f"s{i + 1}" for i in range(subjects)],
            "weber_fraction": _rounded(weber_fraction * np.exp(spread * ndtri(u[:, 0]))),
            "lapse_low": _lapses(lapse_low, u[:, 1]),
            "lapse_high": _lapses(lapse_high, u[:, 2]),
            "bias": _rounded(bias + bias_spread * ndtri(u[:, 3])),
        }
    )


def joined(parts: list[Trials]) -> Trials:
    """Tables of one task and scale, one below the other.

    Raises
    ------
    ValueError
        Where they differ in task, scale or unit, or there is none.
    """
    if not isinstance(parts, list | tuple):
        raise ValueError(f"parts must be a list of Trials, got {_checks.shown(parts)}.")
    for part in parts:
        check_trials(part)
    if not parts:
        raise ValueError("there are no tables to join; give one or more.")
    kinds = {(t.task.name, t.scale, t.log_unit) for t in parts}
    if len(kinds) > 1:
        raise ValueError(
            f"tables of {len(kinds)} kinds (task, scale, unit) were given; join those of one kind."
        )
    if len(parts) == 1:
        return parts[0]
    frame = pd.concat([t.frame for t in parts], ignore_index=True)
    return replace(parts[0], frame=frame, notes=notes_of(frame), rows=None)


def _spread(name: str, value: float) -> None:
    """Refuses what is not one number of zero or more."""
    one = _checks.number(name, value, "write for example 0.02")
    _checks.non_negative(name, one, "write 0.02, say")


def _lapses(mean: float, u: Array) -> Array:
    return _rounded(beta_distribution.ppf(u, 2, 2 / mean - 2)) if mean else np.zeros(u.size)


def _rounded(values: Array) -> Array:
    return np.array([float(f"{v:.4g}") for v in values])
