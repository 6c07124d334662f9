"""Trials at the places where the whisker was, as measured, in place of where the pole stood.

What an animal encodes is where its whisker touches, and that moves with its head. `with_distances`
puts the located place of every trial into the table, with the sd of its posterior. `fit_weber` then
integrates each trial over it, so that two things stay out of the Weber fraction: how far the animal
moved (the place is known) and how well the experimenter measured (the sd is known).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.optimize import minimize_scalar

from .._util import checks
from .._util.refusals import Refusal, argument, named
from .._util.values import Array, counted
from ..inference.observer import Observer
from ..recordings import locate
from ..recordings.columns import FROM_SHAPE, read_contacts
from ..recordings.tables import load_table
from .cue_encoding import CueEncoding, PooledEncoding
from .encodings import (
    Encoding,
    IdentityEncoding,
    Signals,
    UnitEncodings,
    chosen_encoding,
    gives_signal,
)
from .psychometric import response_probability
from .tasks import SameDifferent, SignedChoice, Task, YesNo
from .trials import SDS, Cells, Trials, check_trials

__all__ = ["at_touches", "estimate_scatter", "over_places", "simulate_moving", "with_distances"]

_HINT = "write distances=ww.locate(contacts, whisker, touch='touch')"
#: Columns of `locate` and of the posterior of a touch: mean, sd, status.
_TOUCH = ("touch_radial_distance_mm", "touch_sd_mm", "touch_status")
_ROW = ("radial_distance_mm", "sd_mm", "status")
_GOOD = ("converged", "unidentified")


class Scatter(NamedTuple):
    """Where the animal's whisker is, beside the place of the pole: mean offset, and sd."""

    offset: float
    sd: float


def with_distances(
    trials: Trials, distances: pd.DataFrame | str | Path, encoding: Encoding
) -> Trials:
    """The same answers, at the radial distances where the touches of each trial were located.

    Parameters
    ----------
    trials : Trials
        A row a trial, numbered in a column `trial` (within `session` and `subject`, where the
        table has them); stimuli are the nominal radial distances.
    distances : DataFrame or path
        From `locate`, with columns `trial` and `interval` (1 or 2; it may be left out of yes/no and
        go/no-go, where the stimulus is interval 2), and `session` and `subject` as in the trials.
        Of the posterior of a touch where there is one, or any mean and sd: `radial_distance_mm`
        and `sd_mm`. Or the contacts themselves, as `locate` takes them, with measurement errors:
        those of an interval are located as one touch, by the observer's whisker, and by its cue
        where they have that cue's signals.
    encoding : CueEncoding
        Of the observer that is fitted; it says what a unit of the stimulus is.

    Returns
    -------
    Trials
        With located means as `stimulus_1` and `stimulus_2`, their sds in `stimulus_1_sd` and
        `stimulus_2_sd`, and what was done in `notes`. `fit_weber` and `fit_population` integrate
        over them.

    Raises
    ------
    ValueError
        For tables that cannot be joined, several rows of one interval that are no touch, a touch
        that is of both intervals, contacts without measurement errors, sds that are not positive,
        distances of a tenth or a thousand of the nominal ones.

    Notes
    -----
    The place of a trial is nominal + offset + the animal's scatter τ, and the video says it with an
    sd s. Offset and τ are estimated by maximum likelihood, and fits integrate over the product of
    both densities (how-to "Fit where touches were"; regression dilution, Carroll et al. 2006), or
    over the second where no touch was located. All errors are taken to be independent.

    Examples
    --------
    >>> import weberwhisk as ww
    >>> whisker = ww.Whisker(50e-3, 100e-6, 5e-6)
    >>> encoding = CueEncoding(ww.Observer(whisker, ww.cues.Compliance()))
    >>> nominal = ww.simulate_trials(standards=20e-3, encoding=encoding, seed=1)
    >>> trials, located = ww.behaviour.simulate_moving(
    ...     nominal, encoding, weber_fraction=0.1, scatter=2e-3, sd=0.3e-3, seed=2)
    >>> fit = ww.fit_weber(trials, observer=encoding.observer, distances=located)
    >>> low, high = fit.interval(0.95)
    >>> low < 0.1 < high
    True
    """
    check_trials(trials)
    if not isinstance(encoding, CueEncoding | PooledEncoding):
        raise Refusal(
            named("distances") + " were given without a whisker",
            remedy="write observer=ww.Observer(whisker, cue), and nominal distances in metres",
        )
    frame = trials.frame
    if SDS[0] in frame:
        raise Refusal("the trials have located distances already", remedy="give the nominal ones")
    if "trial" not in frame or (frame["n"] > 1).any():
        raise Refusal(
            f"{trials.source}: located distances need a row a trial, numbered in a column 'trial'",
            remedy="name it with " + argument("columns", {"trial": "<its name>"}),
        )
    keys = [c for c in ("subject", "session", "trial") if c in frame]
    if frame.duplicated(keys).any():
        row = frame.loc[frame.duplicated(keys), keys].iloc[0].to_dict()
        raise Refusal(
            f"{trials.source}: there are two trials {_named(row)}",
            remedy="number them within sessions",
        )
    yes_no = isinstance(trials.task, YesNo)
    looks = encoding.looks if isinstance(encoding, PooledEncoding) else (encoding,)
    distances = _located(distances, keys, yes_no, looks[0].observer)
    table = _table(distances, keys, yes_no, 1e-3 / encoding.unit)
    nominal = frame[["stimulus_1", "stimulus_2"]].to_numpy(float)
    index = pd.MultiIndex.from_frame(frame[keys].apply(_as_text))
    mean, sd = np.full(nominal.shape, np.nan), np.full(nominal.shape, np.nan)
    place = index.get_indexer(pd.MultiIndex.from_frame(table[keys]))
    joined = place >= 0
    if not joined.any():
        raise Refusal(
            f"none of the {len(table)} located touches belongs to a trial of {trials.source}",
            remedy=f"the columns {checks.listed(keys)} of both must have the same names",
        )
    which = place[joined], table["interval"].to_numpy(np.intp)[joined] - 1
    mean[which], sd[which] = table.loc[joined, "mean"], table.loc[joined, "sd"]
    _check_unit(mean, nominal)
    scatter = estimate_scatter((mean - nominal).ravel(), sd.ravel())
    seen = np.isfinite(mean)
    measured = seen.any(axis=0) | ~np.array([yes_no, False])
    prior = np.where(measured, nominal + scatter.offset, nominal)
    with np.errstate(divide="ignore"):
        weight = np.where(seen, scatter.sd**2 / (scatter.sd**2 + sd**2), 0.0)
    at = np.where(seen, weight * np.where(seen, mean, 0.0) + (1 - weight) * prior, prior)
    own = np.where(
        seen, np.sqrt(weight) * np.where(seen, sd, 0.0), np.where(measured, scatter.sd, 0)
    )
    lost = ~gives_signal(encoding, at)
    if lost.any():
        raise Refusal(
            f"{int(lost.sum())} located distances give no signal, the first being "
            f"{at[lost][0]:.4g} ({encoding.outcome(float(at[lost][0]))})",
            remedy="leave those trials out, or change the whisker or the cue",
        )
    unit = 1e3 * encoding.unit
    missing, stray = int((measured & ~seen).sum()), int((~joined).sum())
    notes = [
        f"Distances were located: {unit * scatter.offset:+.3g} mm from the nominal places on "
        f"average, scattered by {unit * scatter.sd:.3g} mm, measured to "
        f"{unit * np.nanmedian(sd):.3g} mm; each trial is integrated over where it may have been.",
    ]
    if missing:
        notes.append(f"{counted(missing, 'touch')} not located: taken as scattered about the pole.")
    if stray:
        notes.append(f"{counted(stray, 'located touch')} of no trial: left out.")
    columns = {"stimulus_1": at[:, 0], "stimulus_2": at[:, 1]}
    columns |= {name: own[:, i] for i, name in enumerate(SDS)}
    return replace(trials, frame=frame.assign(**columns), reading=(*trials.reading, *notes))


def at_touches(
    trials: Trials, distances: Any, encoding: Encoding | None, observer: Observer | None
) -> tuple[Trials, Encoding]:
    """`with_distances` for a fit, and its encoding.

    Of an observer that does not know the deflection angle, the encoding is at the median of the
    angles located.
    """
    if observer is not None and encoding is None and "deflection_angle" in observer.unknowns:
        check_trials(trials)
        keys = [c for c in ("subject", "session", "trial") if c in trials.frame]
        distances = _located(distances, keys, isinstance(trials.task, YesNo), observer)
        angle = pd.to_numeric(distances.get("angle_deg", pd.Series(dtype=float)), "coerce")
        if angle.notna().any():
            encoding, observer = CueEncoding(observer, np.radians(angle.median())), None
    chosen = chosen_encoding(encoding, observer) or IdentityEncoding()
    return with_distances(trials, distances, chosen), chosen


def over_places(
    task: Task, encoding: Encoding, cells: Cells, at_means: UnitEncodings, noise: str
) -> UnitEncodings:
    """Encodings that give every cell's decision variable its mean and variance over the places.

    The decision variable D for k = 1 is a far straighter function of the places than the signals
    are: of a signal r^−p it depends on the ratio of the distances alone. Its moments over the two
    normal posteriors, by Gauss and Hermite's rule and cut off where nothing is encoded, make
    the difference between the means, E D · σ, and the `spread`, Var D · σ².
    """
    if not isinstance(task, SignedChoice | YesNo | SameDifferent):
        raise Refusal(
            f"{task.name} has no likelihood of measured distances, as its answers are scored "
            "by the pole's place",
            remedy="give which was called farther, and " + argument("task", "2AFC"),
        )
    nodes, weights = np.polynomial.hermite_e.hermegauss(9)
    means, sds, shares = [], [], []
    for at, own, fixed in (
        (cells.stimulus_1, cells.sd_1, at_means.sd_1),
        (cells.stimulus_2, cells.sd_2, at_means.sd_2),
    ):
        assert own is not None
        x = at[:, None] + own[:, None] * nodes
        low, high = encoding.domain
        x = np.where((x > low) & (x < high), x, at[:, None])
        x = np.where(gives_signal(encoding, x), x, at[:, None])
        share = (x == at[:, None] + own[:, None] * nodes) * weights
        shares.append(share / share.sum(axis=1, keepdims=True))
        means.append(encoding.direction * encoding.mean(x))
        sds.append(
            encoding.sd_per_weber_fraction(x) if noise == "weber" else fixed[:, None] + 0 * x
        )
    s1, s2 = sds[0][:, :, None], sds[1][:, None, :]
    both = Signals(means[0][:, :, None], s1, means[1][:, None, :], s2)
    share = shares[0][:, :, None] * shares[1][:, None, :]
    d = (both.mean_2 - both.mean_1) / task.decision_sd(both)
    mean = (share * d).sum(axis=(1, 2))
    variance = (share * (d - mean[:, None, None]) ** 2).sum(axis=(1, 2))
    sd_2 = np.sqrt((shares[1] * sds[1] ** 2).sum(axis=1))
    m1, sd_1 = (shares[0] * means[0]).sum(axis=1), (share * (s1 / s2)).sum(axis=(1, 2)) * sd_2
    sd = task.decision_sd(Signals(m1, sd_1, m1, sd_2))
    return at_means._replace(
        mean_1=m1, sd_1=sd_1, mean_2=m1 + mean * sd, sd_2=sd_2, spread=variance * sd**2
    )


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
        checks.non_negative(name, value, "write 1e-3, say")
    rng = checks.generator(seed)
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


def estimate_scatter(gap: Array, sd: Array) -> Scatter:
    """Offset and scatter of places from gaps (n,) to the nominal ones, by maximum likelihood.

    Gaps are measured less nominal, with the sd of each measurement; NaN where there is none.
    """
    some = np.isfinite(gap)
    gap, sd = gap[some], sd[some]

    def at(tau: float) -> tuple[float, float]:
        variance = tau**2 + sd**2
        offset = float((gap / variance).sum() / (1 / variance).sum())
        return offset, float(0.5 * (np.log(variance) + (gap - offset) ** 2 / variance).sum())

    most = float(np.abs(gap - np.median(gap)).max()) or float(sd.max())
    taus = most * np.linspace(0.0, 1.0, 41)
    best = int(np.argmin([at(t)[1] for t in taus]))
    ends = taus[max(best - 1, 0)], taus[min(best + 1, 40)]
    found = minimize_scalar(lambda t: at(t)[1], bounds=ends, method="bounded").x
    tau = float(min((0.0, float(found)), key=lambda t: at(t)[1]))
    return Scatter(at(tau)[0], tau)


def _named(row: Mapping[Any, Any]) -> str:
    return ", ".join(f"{name} = {value!r}" for name, value in row.items())


def _as_text(labels: pd.Series) -> pd.Series:
    """Labels as text; numbers are floats where a row beside them has none."""
    return labels.astype(str).str.removesuffix(".0")


def _refuse_lacking(header: Any, needed: list[str]) -> None:
    lacking = [c for c in needed if c not in header]
    if lacking:
        raise Refusal(
            named("distances") + f" has no column {', '.join(map(repr, lacking))}",
            remedy=f"it needs {', '.join(needed)}",
        )


def _located(distances: Any, keys: list[str], yes_no: bool, observer: Observer) -> pd.DataFrame:
    """A table of located touches: the one given, or its contacts located, a touch an interval."""
    if isinstance(distances, str | Path):
        distances = load_table(distances, "touch").frame
    checks.kind("distances", distances, "a DataFrame or a path", "columns", _HINT)
    if {_TOUCH[0], _ROW[0], _ROW[1]} & set(distances.columns):
        return distances
    raw = distances.copy()
    for column in raw.columns.difference([*keys, "interval"]):  # text files give text
        number = pd.to_numeric(raw[column], errors="coerce")
        raw[column] = raw[column].where(number.isna() & raw[column].notna(), number)
    quantities = read_contacts(raw, None, None)[2]
    if not quantities:
        _refuse_lacking(distances.columns, [*keys, *(() if yes_no else ("interval",)), *_ROW[:2]])
    touch = [*keys, *(("interval",) if "interval" in raw or not yes_no else ())]
    _refuse_lacking(raw.columns, touch)
    if not any(name.endswith("_sd") for name in quantities):
        raise Refusal(
            "the contacts have no measurement errors, and what the receptors add is fitted",
            remedy="give moment_sd and the like, or distances and their sds",
        )
    rows = raw[touch].apply(_as_text).itertuples(index=False)
    some = raw[touch].notna().all(axis=1)
    named = [str(tuple(row)) if known else None for row, known in zip(rows, some, strict=True)]
    # Errors of tracked shapes correlate, as those of moment and transverse force say.
    own = FROM_SHAPE not in set(raw.get("signals_from", ())) and (
        {*observer.cue.signal_names} <= {*quantities}
    )
    cue = observer.cue if own else None
    return locate(raw, observer.whisker, cue=cue, touch=named)


def _table(distances: pd.DataFrame, keys: list[str], yes_no: bool, unit: float) -> pd.DataFrame:
    """One row an interval of a trial: keys as text, interval, and mean and sd in stimulus units."""
    header = [str(c) for c in distances.columns]
    is_touch = _TOUCH[0] in header
    mean, sd, status = _TOUCH if is_touch else _ROW
    _refuse_lacking(header, [*keys, *(() if yes_no else ("interval",)), mean, sd])
    own = pd.DataFrame({key: _as_text(distances[key]) for key in keys})
    own["interval"] = pd.to_numeric(
        distances.get("interval", pd.Series(2, distances.index)), "coerce"
    )
    own["mean"] = unit * pd.to_numeric(distances[mean], errors="coerce")
    own["sd"] = unit * pd.to_numeric(distances[sd], errors="coerce")
    if status in header:
        own = own[distances[status].astype(str).isin(_GOOD)]
    own = own[own["mean"].notna()]
    if not len(own):
        raise Refusal(named("distances") + " has no located touch", remedy=_HINT)
    wrong = own.loc[~own["interval"].isin((1, 2)), "interval"]
    if len(wrong):
        raise Refusal(
            "interval must be 1 or 2", f"{wrong.iloc[0]!r}", "number the two intervals of a trial"
        )
    if not (own["sd"] > 0).all():
        raise Refusal(
            "sds of distances must be above zero", remedy="give what was located, with its sd"
        )
    own["interval"] = own["interval"].astype(int)
    interval = [*keys, "interval"]
    if is_touch:
        own = own.drop_duplicates()
        twice = own.duplicated([*keys, "mean", "sd"])
        if twice.any():
            row = own.loc[twice, keys].iloc[0].to_dict()
            raise Refusal(
                f"one touch is in both intervals of {_named(row)}",
                remedy="number touches by trial and interval",
            )
    elif own.duplicated(interval).any():
        row = own.loc[own.duplicated(interval), interval].iloc[0].to_dict()
        raise Refusal(
            f"there are several rows for {_named(row)}, which share a stiffness and a prior",
            remedy=("give locate a touch a row of the trial with touch=, or one row an interval"),
        )
    # Several touches of an interval are weighted by precision, and their sd is wider where they
    # disagree by more than their own sds (Birge 1932).
    own["w"] = own["sd"] ** -2
    own["wx"] = own["w"] * own["mean"]
    own["wxx"] = own["wx"] * own["mean"]
    sums = own.groupby(interval, sort=False).agg(
        n=("w", "size"), w=("w", "sum"), wx=("wx", "sum"), wxx=("wxx", "sum")
    )
    sums["mean"] = sums["wx"] / sums["w"]
    chi2 = (sums["wxx"] - sums["wx"] * sums["mean"]) / np.maximum(sums["n"] - 1, 1)
    sums["sd"] = np.sqrt(np.maximum(chi2, 1.0) / sums["w"])
    return sums.reset_index()


def _check_unit(mean: Array, nominal: Array) -> None:
    ratio = float(np.nanmedian(mean / nominal))
    if not 1 / 8 < ratio < 8:
        raise Refusal(
            f"located distances are {ratio:.3g} times the nominal ones: radial_distance_mm is "
            "in millimetres, and stimuli are in metres where an observer is given alone (mm "
            "on the command line)",
            remedy="give both in their units",
        )
