"""Choices of observers with known parameters, of one or of a population, repeatable to the byte."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.special import ndtri
from scipy.stats import beta

from .._util import checks
from .._util.refusals import Refusal, argument, named
from .._util.values import Array
from .effects import Effect, Overdispersion, SessionBias, TrialBefore, check_valued
from .encodings import (
    Encoding,
    IdentityEncoding,
    LogEncoding,
    UnitEncodings,
    checked_encoding,
    chosen_encoding,
    refuse_outside,
    refuse_unencoded,
    unit_encodings,
)
from .formula import expanded
from .priors import usual_bias
from .states import States
from .tasks import SameDifferent, Task, task_named
from .trials import LABELS, STIMULI, Trials, in_millimetres, joined, notes_of

__all__ = [
    "SIGNED_OFFSETS", "draw_animals", "simulate_population", "simulate_responses",
    "simulate_trials", "valued_effects",
]  # fmt: skip

ORDERS = ("standard first", "random")
SIGNED_OFFSETS = tuple(np.linspace(-0.3, 0.3, 9).round(12).tolist())


def simulate_trials(
    *,
    weber_fraction: ArrayLike = 0.1,
    standards: ArrayLike = 1.0,
    offsets: ArrayLike | None = None,
    comparisons: ArrayLike | None = None,
    trials_per_level: int = 40,
    lapse_low: float = 0.0,
    lapse_high: float = 0.0,
    bias: ArrayLike | None = None,
    drift: float = 0.0,
    bias_drift: float = 0.0,
    encoding: Encoding | None = None,
    observer: Any = None,
    noise: str = "weber",
    effects: Sequence[tuple[Effect | str, ArrayLike]] = (),
    states: States | None = None,
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
        Magnitudes, logarithms (with a log encoding) or radial distances in metres; stimulus 1,
        unless `order` is "random".
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
        In sds of the difference between the two signals, positive towards "second greater"; of
        yes/no and go/no-go tasks the criterion in sds of stimulus 1, and of a same-different task
        the difference, in sds of it, beyond which the answer is "different". The middle of what
        `fit_weber` believes by default: 0, and of same-different 1.6.
    drift, bias_drift : float
        A learning animal: how far ln k (as by the effect `Drift`) and the bias go from the first
        session to the last, in equal steps; their mean over the sessions is what is given above.
    encoding : Encoding, optional
        How a stimulus is encoded, any cue and any noise; the magnitude itself by default.
    observer : Observer, optional
        A whisker and a cue: short for `encoding=CueEncoding(observer)`.
    noise : {"weber", "equal-variance", "constant"}
    effects : sequence of (Effect, float)
        What else moves the answers, with the value of its parameter: `[(History(), 0.5)]`; see
        `weberwhisk.behaviour.effects`. A formula has a number a term: `[("k ~ session", 0.2)]`.
    states : States, optional
        An animal that is engaged part of the time; `state` of the table says when: "engaged",
        "low" or "high".
    order : {"standard first", "random"}
        "random": in every other trial of each pair the comparison is stimulus 1. Only then is the
        order effect (the `bias`) distinguished from a preference for the comparison.
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
    checks.one_of("order", order, ORDERS)
    if order == "random" and chosen.bias_name != "bias":
        raise Refusal(
            argument("order", order) + " needs a task of two intervals",
            f"task {task!r}",
            "write " + argument("task", "2AFC") + ", or leave order out",
        )
    for name, value in (("lapse_low", lapse_low), ("lapse_high", lapse_high), ("missing", missing)):
        checks.between(name, value, "write for example 0.02", ends="[)")
    if lapse_low + lapse_high >= 1:
        raise Refusal(
            named("lapse_low") + " + " + named("lapse_high") + " must be below 1",
            f"{lapse_low + lapse_high:g}",
            "write for example 0.02 for each",
        )
    trials_per_level = checks.whole("trials_per_level", trials_per_level, "write 40, say")
    sessions = checks.whole("sessions", sessions, "write 10, say")
    if subject is not None and not isinstance(subject, str | int):
        raise Refusal("subject must be a name", checks.shown(subject), "write 'r1', say")
    encoded = chosen_encoding(encoding, observer) or IdentityEncoding()
    base = np.ravel(checks.finite("standards", standards, "give one stimulus or several"))
    if not base.size:
        raise Refusal("standards is empty", remedy="write standards=1.0, say")
    levels = _levels(base, offsets, comparisons, isinstance(encoded, LogEncoding))
    usual = usual_bias(chosen)
    shift = checks.finite("bias", usual if bias is None else bias, f"write for example {usual:g}")
    if isinstance(chosen, SameDifferent) and (shift < 0).any():
        raise Refusal(
            named("bias") + " is the criterion of a same-different task, which is not below 0",
            f"{shift.min():g}",
            f"write for example {usual:g}",
        )
    if shift.shape not in ((), (1,), base.shape):
        raise Refusal(
            named("bias") + f" has shape {shift.shape} for standards of shape {base.shape}",
            remedy="give one number, or one a standard",
        )
    shift = np.broadcast_to(shift, base.shape)
    fraction, wander = _course(weber_fraction, sessions, drift, bias_drift)
    stimuli = np.concatenate([base, levels.ravel()])
    refuse_outside(encoded, stimuli)
    refuse_unencoded(encoded, stimuli)

    rng = checks.generator(seed)
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
    frame = pd.DataFrame({"session": session, "trial": np.arange(which.size) - start + 1})
    frame = frame.assign(
        standard=s0[which], stimulus_1=first[which], stimulus_2=second[which], n=1, count=count
    )
    if subject is not None:
        frame.insert(0, "subject", subject)
    trials = _simulated(frame, chosen, encoded)
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
    if states is not None:
        checks.kind("states", states, "States", "drawn", "write ww.behaviour.States(engaged=0.7)")
        if not chosen.has_bias:
            raise Refusal(
                "states need a task whose answers take a side",
                f"task {task!r}",
                "write " + argument("task", "2AFC") + ", or leave states out",
            )
        state, second = states.drawn(frame, rng.random((2, len(frame))))
        answers = np.where(state > 0, uniform[place] < second, answers)
        frame = frame.assign(state=np.array(["engaged", "low", "high"])[state])
    return replace(trials, frame=frame.assign(count=count + answers))


def _course(
    weber_fraction: ArrayLike, sessions: int, drift: float, bias_drift: float
) -> tuple[Array, Array]:
    """The Weber fraction of each session, and what is added to the bias; (sessions,) or (1,)."""
    k = np.atleast_1d(checks.positive("weber_fraction", weber_fraction, "write for example 0.1"))
    if k.shape not in ((1,), (sessions,)):
        raise Refusal(
            named("weber_fraction") + f" has shape {k.shape} for {sessions} sessions",
            remedy="give one number, or one a session",
        )
    for name, value in (("drift", drift), ("bias_drift", bias_drift)):
        checks.number(name, value, "write for example -0.5")
        if value and sessions < 2:
            raise Refusal(
                f"{name} goes from the first session to the last",
                argument("sessions", sessions),
                "write " + argument("sessions", 10) + ", say",
            )
    if not drift and not bias_drift:
        return k, np.zeros(1)
    course = np.linspace(-0.5, 0.5, sessions)
    return k * np.exp(drift * course), bias_drift * course


def _levels(base: Array, offsets: Any, comparisons: Any, is_log: bool) -> Array:
    """Comparisons of every standard, (S, C)."""
    if offsets is not None and comparisons is not None:
        raise Refusal("offsets and comparisons were both given", remedy="give one of them")
    if comparisons is not None:
        hint = "give one level or several"
        given = np.atleast_1d(checks.finite("comparisons", comparisons, hint))
        if not given.size or given.shape not in (given.shape[-1:], (base.size, given.shape[-1])):
            raise Refusal(
                f"comparisons has shape {given.shape} for {base.size} standards",
                remedy="give one row of levels, or one row each",
            )
        return np.broadcast_to(given, (base.size, given.shape[-1]))
    offsets = SIGNED_OFFSETS if offsets is None else offsets
    relative = np.atleast_1d(checks.finite("offsets", offsets, "write for example 0.1"))
    if relative.ndim > 1 or not relative.size:
        raise Refusal(
            "offsets must be one row of numbers",
            f"shape {relative.shape}",
            "write offsets=[-0.1, 0.1], or comparisons= with a row a standard",
        )
    levels = base[:, None] + relative if is_log else base[:, None] * (1 + relative)
    # Twelve digits: a level is written as one would write it, and the same level is one level.
    return np.array([[float(f"{value:.12g}") for value in row] for row in levels])


def responses(
    trials: Trials,
    encoding: Encoding,
    *,
    weber_fraction: Array,
    lapse_low: Array | float,
    lapse_high: Array | float,
    bias: Array,
    noise: str,
    effects: Sequence[tuple[Effect | str, ArrayLike]],
    uniform: Array,
    rng: np.random.Generator,
) -> Array:
    """Answers, 0 or 1 a row, to trials that are laid out in their order; all arrays a number a row.

    `trials` has NaN for an answer that the animal does not give. `uniform` decides the answers.
    """
    frame, task = trials.frame, trials.task
    shown = frame[["stimulus_1", "stimulus_2", "standard"]].to_numpy(float)
    silent = frame["count"].isna().to_numpy()
    pairs, which = np.unique(shown, axis=0, return_inverse=True)
    which = which.reshape(-1)
    n = np.bincount(which, ~silent).astype(float)
    both = unit_encodings(encoding, pairs[:, 0], pairs[:, 1], pairs[:, 2], noise)
    bound = [(e.bound(both, n), value) for e, value in valued_effects(effects, trials)]
    unit = both.of(which)
    of_rows = UnitEncodings(
        unit.mean_1, weber_fraction * unit.sd_1, unit.mean_2, weber_fraction * unit.sd_2, *unit[4:]
    )
    columns = [e.column(trials, encoding) for e, _ in bound]

    def probability(before: float) -> Array:
        """Of the answer counted, after the other answer (-1), none (0), or itself (1)."""
        encoded = of_rows.encoded(1.0)
        for (effect, value), column in zip(bound, columns, strict=True):
            if isinstance(effect, TrialBefore):
                column = effect.after(trials, before)
            of_trial = 0.0 if column is None else column
            encoded = effect.apply(encoded, np.array([value]), of_trial)
        d, weight = task.decide(encoded)
        up, down = task.chance(d, weight * bias)
        low, high = task.asymptotes(np.asarray(lapse_low), np.asarray(lapse_high))
        p = np.asarray(low * down + (1 - high) * up)
        for (effect, value), column in zip(bound, columns, strict=True):
            if isinstance(effect, Overdispersion):
                keys = np.column_stack([which, np.zeros(len(p)) if column is None else column])
                _, cell = np.unique(keys, axis=0, return_inverse=True)
                drawn = scatter[: len(frame)][cell.reshape(-1)]
                size = 1 / value - 1
                scattered = beta.ppf(drawn, p * size, (1 - p) * size)
                p = np.where(np.isnan(scattered), p, scattered)  # none of it is left at 0 and 1
        return p

    scatter = rng.random(len(frame)) if effects else np.zeros(0)
    for (effect, value), column in zip(bound, columns, strict=True):
        if isinstance(effect, SessionBias) and column is not None:
            of_sessions = ndtri(rng.random(int(column.max(initial=0)) + 1))
            bias = bias + value * of_sessions[column.astype(np.intp)]
    if not any(isinstance(effect, TrialBefore) for effect, _ in bound):
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


def valued_effects(
    effects: Sequence[tuple[Effect | str, ArrayLike]], trials: Trials
) -> list[tuple[Effect, float]]:
    """Effects with a number each, formulas with one a term."""
    pairs: list[tuple[Effect, float]] = []
    for effect, value in effects:
        terms, values = expanded([effect], trials), np.atleast_1d(np.asarray(value, dtype=float))
        if values.shape != (len(terms),):
            names = ", ".join(term.name for term in terms)
            raise Refusal(
                f"effects have a number each, in this order: {names}", checks.shown(value)
            )
        pairs += zip(terms, values.tolist(), strict=True)
    return pairs


def simulate_population(
    subjects: int,
    *,
    weber_fraction: float = 0.1,
    spread: float = 0.3,
    session_spread: float = 0.0,
    lapse_low: float = 0.02,
    lapse_high: float = 0.02,
    bias: float | None = None,
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
        Mean and standard deviation of the biases; the mean as for `simulate_trials`.
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
    rng = checks.generator(seed)
    task = task_named(design.get("task", "2AFC"))
    truth = draw_animals(
        subjects, weber_fraction=weber_fraction, spread=spread, lapse_low=lapse_low,
        lapse_high=lapse_high, bias=usual_bias(task) if bias is None else bias,
        bias_spread=bias_spread, seed=rng,
    )  # fmt: skip
    if isinstance(task, SameDifferent) and (bias is None or bias >= 0):
        truth["bias"] = truth["bias"].clip(lower=0.0)  # no criterion of one animal is below it
    sessions = checks.whole("sessions", sessions, "write 10, say")
    checks.non_negative_number("session_spread", session_spread, "write for example 0.02")
    wander = ndtri(np.clip(rng.random((len(truth), sessions)), 1e-12, 1 - 1e-12))
    tables = []
    for i, row in enumerate(truth.to_dict("records")):
        animal = {str(name): value for name, value in row.items()}
        k = animal.pop("weber_fraction") * np.exp(session_spread * wander[i])
        how = {"sessions": sessions, "seed": rng, **animal, **design}
        tables.append(simulate_trials(weber_fraction=k if session_spread else k[:1], **how))
    return joined(tables), truth


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
    subjects = checks.whole("subjects", subjects, "write 6, say")
    checks.positive_number("weber_fraction", weber_fraction, "write for example 0.1")
    checks.number("bias", bias, "write for example 0")
    for name, value in (("spread", spread), ("bias_spread", bias_spread)):
        checks.non_negative_number(name, value, "write for example 0.02")
    for name, value in (("lapse_low", lapse_low), ("lapse_high", lapse_high)):
        checks.between(name, value, "write for example 0.02", high=0.5, ends="[)")
    rng = checks.generator(seed)
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


def _lapses(mean: float, u: Array) -> Array:
    return _rounded(beta.ppf(u, 2, 2 / mean - 2)) if mean else np.zeros(u.size)


def _rounded(values: Array) -> Array:
    return np.array([float(f"{v:.4g}") for v in values])


TRUTH = ("weber_fraction", "lapse_low", "lapse_high", "bias")


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
    share = checks.non_negative_number("missing", missing, "write for example 0.02")
    if isinstance(table, pd.DataFrame):
        unit = 1e3 * getattr(encoding, "unit", 1.0)
        lengths = in_millimetres(table).items()
        table = table.assign(**{ours: table[theirs] / unit for ours, theirs in lengths})
    for name, frame, needed in (("table", table, STIMULI), ("animals", animals, TRUTH)):
        lacking = {"subject", *needed} - set(getattr(frame, "columns", ()))
        if not isinstance(frame, pd.DataFrame) or lacking:
            raise Refusal(
                f"{name} must be a DataFrame with columns subject, {', '.join(needed)}",
                f"{f'none called {min(lacking)}' if hasattr(frame, 'columns') else frame!r}",
            )
    checked_encoding(encoding)
    keys = [name for name in ("subject", "session") if name in animals]
    truth = table[keys].merge(animals, how="left", on=keys, validate="many_to_one")
    unknown = truth[list(TRUTH)].isna().any(axis=1).to_numpy()
    if unknown.any():
        who = " ".join(str(value) for value in table[keys].iloc[int(np.argmax(unknown))])
        raise Refusal(f"The truth about {who} is not given", remedy="add a row of animals for it")
    rng = checks.generator(seed)
    labels = {name: table[name] for name in LABELS if name in table}
    stimuli = {name: table[name].to_numpy(float) for name in STIMULI}
    refuse_outside(encoding, np.concatenate(list(stimuli.values())))
    refuse_unencoded(encoding, np.concatenate(list(stimuli.values())))
    uniform = rng.random(len(table))
    count = np.where(rng.random(len(table)) < share, np.nan, 0.0)
    frame = pd.DataFrame(labels | stimuli | {"n": 1, "count": count}).reset_index(drop=True)
    trials = _simulated(frame, chosen, encoding)
    answers = responses(
        trials, encoding, **{name: truth[name].to_numpy(float) for name in TRUTH}, noise=noise,
        effects=(), uniform=uniform, rng=rng,
    )  # fmt: skip
    return replace(trials, frame=frame.assign(count=count + answers))


def _simulated(frame: pd.DataFrame, task: Task, encoding: Encoding) -> Trials:
    """Simulated trials on the scale of their encoding."""
    log_unit = encoding.log_unit if isinstance(encoding, LogEncoding) else None
    scale = "linear" if log_unit is None else "log"
    return Trials(frame, task, scale, log_unit, "simulated trials", notes_of(frame))
