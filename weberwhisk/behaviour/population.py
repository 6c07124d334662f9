"""Choices of many animals drawn from a population, of one that moves, or to any list of trials."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.special import ndtri
from scipy.stats import beta as beta_distribution

from .. import _checks
from .._deprecated import renamed_arguments
from .encodings import CueEncoding, Encoding, LogEncoding, checked_encoding, refuse_unencoded
from .psychometric import response_probability, task_named
from .simulate import simulate_trials
from .trials import LABELS, STIMULI, Trials, check_trials, in_millimetres, notes_of

Array = NDArray[np.float64]


@renamed_arguments(percept="encoding")
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
        As for `simulate_trials`: standards, offsets, trials_per_level, encoding, task, …

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
    """Animals drawn from one population: the truth of `simulate_population`, a row an animal."""
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
    """Tables of one task, scale and unit, one below the other."""
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


def simulate_moving(
    trials: Trials,
    encoding: CueEncoding,
    *,
    weber_fraction: float,
    scatter: float,
    sd: float,
    offset: float = 0.0,
    seed: int | np.random.SeedSequence | np.random.Generator,
    **observer: Any,
) -> tuple[Trials, pd.DataFrame]:
    """An animal that moves: answers to where its whisker touches, and those places as measured.

    Parameters
    ----------
    trials : Trials
        Nominal stimuli, a row a trial; its answers are drawn anew.
    encoding : CueEncoding
    weber_fraction : float
    scatter, offset : float
        Sd and mean of the place of a touch about the nominal one, in the stimulus's unit.
    sd : float
        Of the measurement.
    seed : int, SeedSequence or Generator
    **observer
        Lapses, bias and noise, as of `response_probability`.

    Returns
    -------
    Trials, DataFrame
        The choices, and a table as `with_distances` takes it, with true places in `true_mm`.
    """
    check_trials(trials)
    for name, value in (("scatter", scatter), ("sd", sd)):
        _checks.non_negative(name, value, "write 1e-3, say")
    rng = _checks.generator(seed)
    frame = trials.frame
    nominal = frame[["stimulus_1", "stimulus_2"]].to_numpy(float)
    true = nominal + offset + scatter * rng.standard_normal(nominal.shape)
    p = response_probability(
        trials.task, encoding, true[:, 0], true[:, 1], standard=frame["standard"].to_numpy(float),
        weber_fraction=weber_fraction, **observer,
    )  # fmt: skip
    answers = (rng.random(len(p)) < p).astype(float)
    moved = replace(
        trials, frame=frame.assign(count=np.where(frame["count"].isna(), np.nan, answers))
    )
    mm = 1e3 * encoding.unit
    keys = [c for c in ("subject", "session", "trial") if c in frame]
    parts = [
        frame[keys].assign(
            interval=i + 1,
            radial_distance_mm=mm * (true[:, i] + sd * rng.standard_normal(len(frame))),
            sd_mm=mm * sd,
            true_mm=mm * true[:, i],
        )
        for i in (0, 1)
    ]
    return moved, pd.concat(parts, ignore_index=True)


NEEDED = {
    "table": ("subject", *STIMULI),
    "animals": ("subject", "weber_fraction", "lapse_low", "lapse_high", "bias"),
}
TRUTH = ("weber_fraction", "lapse_low", "lapse_high", "bias")


@renamed_arguments(percept="encoding")
def simulate_responses(
    table: pd.DataFrame,
    animals: pd.DataFrame,
    *,
    encoding: Encoding,
    noise: str = "weber",
    missing: float = 0.0,
    task: str = "2AFC",
    seed: int | np.random.SeedSequence | np.random.Generator,
) -> Trials:
    """What observers with known parameters answer to a list of trials.

    `simulate_trials` makes its own list, with the standard always first; this one takes any: a row
    a trial with `subject`, `standard`, `stimulus_1`, `stimulus_2` (or with `_mm`, as `trial_lists`
    has them, taken in the unit of the encoding), where `session` and `trial` are kept. `animals` is
    the truth, as from `draw_animals`: a row for each `subject`, or each of its sessions where there
    is a column `session`. A share of trials, `missing`, gets no answer.
    """
    chosen = task_named(task)
    share = _checks.number("missing", missing, "write for example 0.02")
    _checks.non_negative("missing", share, "write for example 0.02")
    if isinstance(table, pd.DataFrame):
        unit = 1e3 * getattr(encoding, "unit", 1.0)
        lengths = in_millimetres(table).items()
        table = table.assign(**{ours: table[theirs] / unit for ours, theirs in lengths})
    for name, frame in (("table", table), ("animals", animals)):
        lacking = set(NEEDED[name]) - set(getattr(frame, "columns", ()))
        if not isinstance(frame, pd.DataFrame) or lacking:
            raise ValueError(
                f"{name} must be a DataFrame with columns {', '.join(NEEDED[name])}, got "
                f"{f'none called {min(lacking)}' if hasattr(frame, 'columns') else frame!r}."
            )
    checked_encoding(encoding)
    keys = [name for name in ("subject", "session") if name in animals]
    truth = table[keys].merge(animals, how="left", on=keys, validate="many_to_one")
    unknown = truth[list(TRUTH)].isna().any(axis=1).to_numpy()
    if unknown.any():
        who = " ".join(str(value) for value in table[keys].iloc[int(np.argmax(unknown))])
        raise ValueError(f"The truth about {who} is not given; add a row of animals for it.")
    rng = _checks.generator(seed)
    standard, s1, s2 = (table[name].to_numpy(float) for name in STIMULI)
    refuse_unencoded(encoding, np.concatenate([s1, s2, standard]))
    p = np.empty(len(table))
    for _, own in truth.groupby(list(TRUTH), sort=False):
        rows = own.index.to_numpy()
        k, lapse_low, lapse_high, bias = (float(own[name].iloc[0]) for name in TRUTH)
        p[rows] = response_probability(
            chosen, encoding, s1[rows], s2[rows], standard=standard[rows], weber_fraction=k,
            lapse_low=lapse_low, lapse_high=lapse_high, bias=bias, noise=noise,
        )  # fmt: skip
    # Uniform numbers alone: the streams of the other distributions may change between versions.
    answer = (rng.random(p.size) < p).astype(float)
    answer[rng.random(p.size) < share] = np.nan
    frame = table[[name for name in LABELS if name in table]].assign(
        standard=standard, stimulus_1=s1, stimulus_2=s2, n=np.ones(p.size, np.int64), count=answer
    )
    log_unit = encoding.log_unit if isinstance(encoding, LogEncoding) else None
    return Trials(
        frame.reset_index(drop=True), chosen, "linear" if log_unit is None else "log", log_unit,
        "simulated trials", notes_of(frame),
    )  # fmt: skip
