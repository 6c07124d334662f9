"""Choices to try things with: of observers with known parameters, repeatable to the byte, and of a
rat and two people."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from importlib.resources import as_file, files
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy.stats import beta

from .. import _checks
from .._deprecated import renamed_arguments
from .effects import Effect, History, Overdispersion, check_valued
from .encodings import (
    Encoding,
    IdentityEncoding,
    LogEncoding,
    UnitEncodings,
    chosen_encoding,
    refuse_outside,
    refuse_unencoded,
    unit_encodings,
)
from .io import read_trials
from .psychometric import task_named
from .trials import Trials, notes_of

Array = NDArray[np.float64]

ORDERS = ("standard first", "random")
SIGNED_OFFSETS = tuple(np.linspace(-0.3, 0.3, 9).round(12).tolist())


@renamed_arguments(percept="encoding")
def simulate_trials(
    *,
    weber_fraction: ArrayLike = 0.1,
    standards: ArrayLike = 1.0,
    offsets: ArrayLike | None = None,
    comparisons: ArrayLike | None = None,
    trials_per_level: int = 40,
    lapse_low: float = 0.0,
    lapse_high: float = 0.0,
    bias: ArrayLike = 0.0,
    drift: float = 0.0,
    bias_drift: float = 0.0,
    encoding: Encoding | None = None,
    observer: Any = None,
    noise: str = "weber",
    effects: Sequence[tuple[Effect, float]] = (),
    order: str = "standard first",
    sessions: int = 1,
    subject: str | None = None,
    missing: float = 0.0,
    task: str = "2AFC",
    seed: int | np.random.SeedSequence | np.random.Generator,
) -> Trials:
    """Trials of one observer: every comparison at every standard, shuffled within sessions.

    Parameters
    ----------
    weber_fraction : float, or array_like of shape (sessions,)
        Noise sd of each signal over its mean; one for each session where it is not the same.
    standards : array_like, shape (S,)
        Magnitudes, logarithms (with a log encoding) or radial distances in metres; stimulus 1, but
        where `order` has it otherwise.
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
        In sds of the difference between the two signals, positive towards "second greater".
    drift, bias_drift : float
        A learning animal: how far ln k and the bias go from the first session to the last, in
        equal steps; their mean over the sessions is what is given above.
    encoding : Encoding, optional
        How a stimulus is encoded, any cue and any noise; the magnitude itself by default.
    observer : Observer, optional
        A whisker and a cue: short for `encoding=CueEncoding(observer)`.
    noise : {"weber", "equal-variance"}
    effects : sequence of (Effect, float)
        What else moves the answers, with the value of its parameter: `[(History(), 0.5)]`; see
        `weberwhisk.behaviour.effects`.
    order : {"standard first", "random"}
        "random": in every other trial of each pair the comparison is stimulus 1. Only then is the
        order effect (the `bias`) distinguished from a preference for the comparison
        (`effects.ComparisonBias`).
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
    chosen = task_named(task)
    check_valued(effects)
    for effect, value in effects:
        _checks.number(f"the value of {effect.name}", value, "write 0.2, say")
    _checks.one_of("order", order, ORDERS)
    if order == "random" and chosen.bias_name != "bias":
        raise ValueError(
            f"order={order!r} needs a task of two intervals, got task {task!r}; write task='2AFC', "
            "or leave order out."
        )
    for name, value in (("lapse_low", lapse_low), ("lapse_high", lapse_high), ("missing", missing)):
        if not 0 <= _checks.number(name, value, "write for example 0.02") < 1:
            raise ValueError(
                f"{name} must be zero or more and below 1, got {value:g}; write for example 0.02."
            )
    if lapse_low + lapse_high >= 1:
        raise ValueError(
            f"lapse_low + lapse_high must be below 1, got {lapse_low + lapse_high:g}; "
            "write for example 0.02 for each."
        )
    trials_per_level = _checks.whole("trials_per_level", trials_per_level, "write 40, say")
    sessions = _checks.whole("sessions", sessions, "write 10, say")
    if subject is not None and not isinstance(subject, str | int):
        raise ValueError(f"subject must be a name, got {_checks.shown(subject)}; write 'r1', say.")
    encoded = chosen_encoding(encoding, observer) or IdentityEncoding()
    log_unit = encoded.log_unit if isinstance(encoded, LogEncoding) else None
    is_log = log_unit is not None
    base = np.atleast_1d(
        _checks.finite("standards", standards, "give one stimulus or several")
    ).ravel()
    if not base.size:
        raise ValueError("standards is empty; write standards=1.0, say.")
    levels = _levels(base, offsets, comparisons, is_log)
    shift = _checks.finite("bias", bias, "write for example 0")
    if shift.shape not in ((), (1,), base.shape):
        raise ValueError(
            f"bias has shape {shift.shape} for standards of shape {base.shape}; give one number, "
            "or one a standard."
        )
    shift = np.broadcast_to(shift, base.shape)
    fraction, wander = _course(weber_fraction, sessions, drift, bias_drift)
    stimuli = np.concatenate([base, levels.ravel()])
    refuse_outside(encoded, stimuli)
    refuse_unencoded(encoded, stimuli)

    rng = _checks.generator(seed)
    first, second = np.repeat(base, levels.shape[1]), levels.ravel()
    s0 = first
    if order == "random":  # the same pairs the other way round come after them
        first, second, s0 = np.r_[first, second], np.r_[second, first], np.r_[s0, s0]
    # Uniform numbers alone: the streams of the other distributions may change between versions.
    pair = np.repeat(np.arange(levels.size), trials_per_level)
    place = np.argsort(rng.random(pair.size), kind="stable")
    session = np.empty(pair.size, dtype=np.int64)
    session[place] = np.sort(np.arange(pair.size) % sessions)
    which = pair + levels.size * (np.arange(pair.size) % 2) if order == "random" else pair
    uniform = rng.random(pair.size)
    count = np.where(rng.random(pair.size) < missing, np.nan, 0.0)[place]  # the answers come below
    course, session, which = session[place], session[place] + 1, which[place]
    start = np.searchsorted(session, session)
    columns: dict[str, Any] = {} if subject is None else {"subject": np.full(which.size, subject)}
    frame = pd.DataFrame(
        {
            **columns,
            "session": session,
            "trial": np.arange(which.size) - start + 1,
            "standard": s0[which],
            "stimulus_1": first[which],
            "stimulus_2": second[which],
            "n": np.ones(which.size, dtype=np.int64),
            "count": count,
        }
    )
    scale = "log" if is_log else "linear"
    trials = Trials(frame, chosen, scale, log_unit, "simulated trials", notes_of(frame))
    answers = responses(
        trials,
        encoded,
        weber_fraction=fraction[course % len(fraction)],
        lapse_low=lapse_low,
        lapse_high=lapse_high,
        bias=np.repeat(shift, levels.shape[1])[pair][place] + wander[course % len(wander)],
        noise=noise,
        effects=effects,
        uniform=uniform[place],
        rng=rng,
    )
    return replace(trials, frame=frame.assign(count=np.where(np.isnan(count), np.nan, answers)))


def _course(
    weber_fraction: ArrayLike, sessions: int, drift: float, bias_drift: float
) -> tuple[Array, Array]:
    """The Weber fraction of each session, and what is added to the bias; (sessions,) or (1,)."""
    k = np.atleast_1d(_checks.positive("weber_fraction", weber_fraction, "write for example 0.1"))
    if k.shape not in ((1,), (sessions,)):
        raise ValueError(
            f"weber_fraction has shape {k.shape} for {sessions} sessions; give one number, or one "
            "a session."
        )
    for name, value in (("drift", drift), ("bias_drift", bias_drift)):
        _checks.number(name, value, "write for example -0.5")
        if value and sessions < 2:
            raise ValueError(
                f"{name} goes from the first session to the last, got sessions={sessions}; "
                "write sessions=10, say."
            )
    if not drift and not bias_drift:
        return k, np.zeros(1)
    course = np.linspace(-0.5, 0.5, sessions)
    return k * np.exp(drift * course), bias_drift * course


def _levels(base: Array, offsets: Any, comparisons: Any, is_log: bool) -> Array:
    """Comparisons of every standard, (S, C)."""
    if offsets is not None and comparisons is not None:
        raise ValueError("offsets and comparisons were both given; give one of them.")
    if comparisons is not None:
        given = np.atleast_1d(
            _checks.finite("comparisons", comparisons, "give one level or several")
        )
        if not given.size or given.shape not in (given.shape[-1:], (base.size, given.shape[-1])):
            raise ValueError(
                f"comparisons has shape {given.shape} for {base.size} standards; give one row of "
                "levels, or one row each."
            )
        return np.broadcast_to(given, (base.size, given.shape[-1]))
    relative = np.atleast_1d(
        _checks.finite(
            "offsets", SIGNED_OFFSETS if offsets is None else offsets, "write for example 0.1"
        )
    )
    if relative.ndim > 1 or not relative.size:
        raise ValueError(
            f"offsets must be one row of numbers, got shape {relative.shape}; write "
            "offsets=[-0.1, 0.1], or comparisons= with a row a standard."
        )
    levels = base[:, None] + relative if is_log else base[:, None] * (1 + relative)
    # Twelve digits: a level is written as one would write it, and the same level is one level.
    return np.array([[float(f"{value:.12g}") for value in row] for row in levels])


def responses(
    trials: Trials,
    encoding: Encoding,
    *,
    weber_fraction: Array,
    lapse_low: float,
    lapse_high: float,
    bias: Array,
    noise: str,
    effects: Sequence[tuple[Effect, float]],
    uniform: Array,
    rng: np.random.Generator,
) -> Array:
    """Answers, 0 or 1 a row, to trials that are laid out in their order; all arrays a number a row.

    `trials` has NaN for an answer that the animal does not give. `uniform` decides the answers.
    """
    frame, task = trials.frame, trials.task
    names = ("stimulus_1", "stimulus_2", "standard")
    rows = np.column_stack([frame[name].to_numpy(float) for name in names])
    silent = frame["count"].isna().to_numpy()
    pairs, which = np.unique(rows, axis=0, return_inverse=True)
    which = which.reshape(-1)
    n = np.bincount(which, ~silent).astype(float)
    both = unit_encodings(encoding, pairs[:, 0], pairs[:, 1], pairs[:, 2], noise)
    bound = [(e.bound(both, n), float(value)) for e, value in effects]
    own = both.of(which)
    scaled = UnitEncodings(
        own.mean_1, weber_fraction * own.sd_1, own.mean_2, weber_fraction * own.sd_2, *own[4:]
    )
    columns = [e.column(trials, encoding) for e, _ in bound]

    def probability(before: float) -> Array:
        """Of the answer counted, after the other answer (-1), none (0), or itself (1)."""
        encoded = scaled.encoded(1.0)
        for (effect, value), column in zip(bound, columns, strict=True):
            goes_with = before if isinstance(effect, History) else column
            of_trial = 0.0 if goes_with is None else goes_with
            encoded = effect.apply(encoded, np.array([value]), of_trial)
        d, weight = task.decide(encoded)
        up, down = task.chance(d, weight * bias)
        low, high = task.asymptotes(np.array(lapse_low), np.array(lapse_high))
        p = np.asarray(low * down + (1 - high) * up)
        for (effect, value), column in zip(bound, columns, strict=True):
            if isinstance(effect, Overdispersion):
                _, cell = np.unique(
                    np.column_stack([which, np.zeros(len(p)) if column is None else column]),
                    axis=0,
                    return_inverse=True,
                )
                drawn = scatter[: len(frame)][cell.reshape(-1)]
                size = 1 / value - 1
                found = beta.ppf(drawn, p * size, (1 - p) * size)
                p = np.where(np.isnan(found), p, found)  # none of it is left at 0 and 1
        return p

    scatter = rng.random(len(frame)) if effects else np.zeros(0)
    if not any(isinstance(effect, History) for effect, _ in bound):
        return (uniform < probability(0.0)).astype(float)
    after = (uniform < np.stack([probability(b) for b in (0.0, 1.0, -1.0)])).astype(int)
    session = frame["session"].to_numpy()
    answer, last = np.zeros(len(frame)), 0
    for i in range(len(frame)):
        if i and session[i] != session[i - 1]:
            last = 0
        answer[i] = after[last, i]
        last = 0 if silent[i] else (1 if answer[i] else -1)
    return answer


def load_rat_auditory(sessions: int | Iterable[int] | None = None) -> Trials:
    """One rat comparing two sounds: which was louder?

    Rat W053 of the delayed-comparison task of Akrami, Kopec, Diamond & Brody (2018, Nature
    554:368), the first 40 sessions of its training: 11 489 trials. The stimuli are normalised
    logarithms of the sound level; one unit is an unknown number of natural-log units, so a Weber
    fraction is counted per unit. Neighbouring levels are compared, at several standards. The animal
    is learning: lapses, bias and drift are real.

    Sample data of the psytrack package (github.com/nicholas-roy/psytrack), MIT licence, copyright
    of its author; see `weberwhisk/data/README.md`.

    Parameters
    ----------
    sessions : int or iterable of int, optional
        1 to 40; all by default.

    Examples
    --------
    >>> load_rat_auditory(sessions=range(31, 41)).n_trials
    3101
    """
    with as_file(files("weberwhisk") / "data" / "rat_auditory_2ifc.csv.gz") as path:
        trials = read_trials(
            path,
            columns={"stimulus_1": "s1_z", "stimulus_2": "s2_z"},
            choice_labels={"right": "first", "left": "second"},
            scale="log",
            task="2IFC",
        )
    return trials if sessions is None else trials.select(session=sessions)


def load_numerosity(subject: str | None = None) -> Trials:
    """Two people, each 250 trials: which of two clouds has more dots?

    `stimulus_2` over `stimulus_1` is given by its natural logarithm; a choice of "second" is the
    first colour of the original table.

    Data of the TEfits package (github.com/akcochrane/TEfits), MIT licence; Cochrane, Cui, Hubbard &
    Green (2019); see `weberwhisk/data/README.md`.

    Parameters
    ----------
    subject : {"s1", "s2"}, optional
        Both by default.

    Examples
    --------
    >>> load_numerosity("s1").n_trials
    250
    """
    with as_file(files("weberwhisk") / "data" / "numerosity_2afc.csv") as path:
        trials = read_trials(path, columns={"choice": "response"})
    return trials if subject is None else trials.select(subject=subject)
