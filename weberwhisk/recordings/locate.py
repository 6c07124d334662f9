"""`locate`: one posterior for each row of a table, and one for each touch.

Columns are read (`columns.py`), noise that was not given is learnt (`learning.py`), and rows and
touches are located under all whiskers and noises that are possible (`mixture.py`).
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from .. import domain
from .._util import checks
from .._util.refusals import Refusal, argument, call, named, remedy, without_remedies
from .._util.values import Array, Index, counted, methods_text
from ..cues import Cue
from ..cues.protocol import is_curved
from ..inference import Observer, Status, default_noise
from ..inference.coordinates import in_words
from ..inference.observer import distance_prior
from ..inference.tree import TOLERANCE
from ..mechanics import Profile
from ..receptors import GeneralisedWeber, ReceptorNoise, Weber
from ..whisker import Assumed, Whisker, is_wire
from .calibrated import Slopes, averaged
from .calibration import Calibration
from .columns import (
    COMMON,
    FROM_SHAPE,
    IN_PLANE,
    SIGNED,
    check_magnitudes,
    from_shape,
    one_side,
    planar,
    read_contacts,
    sign_note,
    signals_of,
    values_of,
)
from .learning import BELIEF, Learnt, learn, rescaled_noise
from .mixture import (
    ERROR,
    MISFIT,
    Cases,
    Done,
    Readings,
    Spread,
    cases_of,
    rows_of,
    touches_of,
    usual_bow,
    whiskers_of,
)

__all__ = ["MEASURED", "OFF_BY", "RESULTS", "TOUCH_RESULTS", "locate", "methods_paragraph"]

#: What `locate` adds to a table.
RESULTS = (
    "radial_distance_mm", "sd_mm", "lower_mm", "upper_mm", "angle_deg", "angle_sd_deg",
    "status", "message",
)  # fmt: skip
TOUCH_RESULTS = (
    "touch_radial_distance_mm", "touch_sd_mm", "touch_lower_mm", "touch_upper_mm", "touch_status",
)  # fmt: skip
#: Column of the sd from measurement errors alone, where receptors have noise as well.
MEASURED = "measurement_sd_mm"
#: Column of the largest deviation of a signal from the fitted contact, in sds.
OFF_BY = "misfit_sd"


def locate(
    table: pd.DataFrame | str | Path, whisker: Whisker | Profile | Calibration, *,
    cue: Cue | None = None, columns: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None, touch: str | Sequence[Any] | None = None,
    noise: ReceptorNoise | ArrayLike | None = None, prior: Mapping[str, Any] | None = None,
    known_stiffness: bool | None = None, progress: Callable[[int, int], None] | None = None,
    workers: int | None = None, scheduler: str | None = None,
) -> pd.DataFrame:  # fmt: skip
    """Infer the radial distance of each contact of a table, with its uncertainty.

    Parameters
    ----------
    table : DataFrame or path
        One row per contact or video frame. Signals are `moment`, `axial_force`,
        `transverse_force`, `deflection_angle`; or `moment_rate` with `angular_velocity`; or the
        six signals `force_x` … `moment_z`. A unit follows the name (`moment_uNm`); without one,
        SI. Measurement errors (`moment_sd_uNm`; without a unit, in that of the signal) are given
        for every signal used or for none. File formats as in `read_trials`.
    whisker : Whisker, Profile or Calibration
        If its shape at rest was not given, its curvature has a normal prior of mean 0 and the sd
        of its follicle or of whiskers in general; ``curvature=0`` makes it straight. A cylinder is
        a wire, and straight unless it was given a curvature. A calibration
        by taps supplies cue and noise: distances are means over draws from its posterior, and
        their sds and intervals include its uncertainty. A table of `tracked_signals` supplies the
        curvature at rest; its moment and forces are proportional to one stiffness, which is then
        taken as known.
    cue : Cue, optional
        By default the one that the columns allow. A given cue decides whether stiffness is known.
    columns : mapping, optional
        From our names to the table's, such as ``{"moment": "M"}``. A minus, as in
        ``{"axial_force": "-Fx"}``, reverses the sign of the column.
    units : mapping, optional
        Units by our names, such as ``{"moment": "µN m"}``.
    touch : str or sequence, optional
        A column, or one value per row, that numbers touches uniquely in the table. Rows that are
        empty or False, or 0 between touches, belong to none. Rows of a touch share distance and
        stiffness, and one unknown largest angle (as a share of the fold), where single rows have a
        flat prior of angle: a touch of two or three rows may be less certain than each row.
    noise : ReceptorNoise or Weber fraction, optional
        Weber fractions, one or one per signal, are those of `inference.default_noise`, independent
        from row to row. By default the table's measurement errors alone; without these a Weber
        fraction per signal is learnt (prior: median 0.2, sd of ln 0.7) from redundant signals and
        from the rows of each touch, whose noise may be shared. Given errors and noise add, and
        `measurement_sd_mm` is the sd from the errors alone.
    prior : mapping, optional
        As for `Observer`.
    known_stiffness : bool, optional
        By default true if Young's modulus is not the default one. An unknown stiffness has the
        published spread of moduli.
    progress : callable, optional
        Called with (rows done, rows in all), where rows of touches count twice.
    workers, scheduler : optional
        Processes, or the address of a dask cluster, as for `weberwhisk.campaign.run`, for tables
        that outgrow a core. The numbers are the same to the bit for any number of workers, each of
        which takes some seconds to start.

    Returns
    -------
    DataFrame
        The table with its index and columns, and `radial_distance_mm`, `sd_mm`, the 95 % interval
        `lower_mm` to `upper_mm`, `angle_deg` and `angle_sd_deg` of the deflection (on a curved
        whisker from first contact), `status` and `message`; with `touch` also
        `touch_radial_distance_mm` and so on, equal in all rows of a touch. With redundant signals
        `misfit_sd` is the largest deviation of a signal at the most probable contact, in sds. Rows
        without a posterior are kept, empty, with the reason as their status. ``attrs["notes"]``
        lists the assumptions: cue, units, signs, noise, priors.

    Raises
    ------
    ValueError
        For columns that are missing or text, unknown units, values apparently in another unit, a
        table that already has the result columns, and signals that do not determine a distance.

    Notes
    -----
    Signs: moment, transverse force and angle (from the base tangent) change sign with the side of
    the push; the axial force is positive in compression. Rows pushed to the negative side are
    mirrored, and so is a curved whisker for them. If rows fit the whisker better in the opposite
    convention, `notes` says so, and how to change it.

    Examples
    --------
    >>> import weberwhisk as ww
    >>> w = ww.Whisker(50e-3, 100e-6, 5e-6, youngs_modulus=3e9, curvature=0)
    >>> b = ww.press(w, [20e-3, 30e-3], 0.3)
    >>> table = pd.DataFrame({"moment_uNm": b.moment * 1e6, "axial_force_uN": b.axial_force * 1e6})
    >>> ww.locate(table, w, noise=0.1)[["radial_distance_mm", "status"]].round(1)
       radial_distance_mm     status
    0                19.6  converged
    1                29.3  converged
    """
    pool = Spread(workers, scheduler)
    if isinstance(whisker, Calibration):
        return _by_calibration(
            whisker, table, cue, noise, columns, units, touch, prior,
            progress=progress, workers=workers, scheduler=scheduler,
        )  # fmt: skip
    checks.kind(
        "whisker", whisker, "a Whisker", "stiffness", "write ww.Whisker.from_identity('C2')"
    )
    raw, si, units_of = read_contacts(table, columns, units)
    for name in (*RESULTS, MEASURED, OFF_BY, *(TOUCH_RESULTS if touch is not None else ())):
        if name in raw:
            raise Refusal(f"The table has a column {name!r} already", remedy="rename or drop it")
    notes: list[str] = []
    several = [c for c in ("whisker", "identity") if c in raw and raw[c].nunique() > 1]
    if several:
        notes.append(f"The column {several[0]!r} names several whiskers: all rows are of one here.")
    if unsaid := [q for q, (_, _, said) in units_of.items() if not said]:
        notes.append(f"No unit was given for {', '.join(unsaid)}: taken as SI (N m, N, rad).")
    touch_names = None if touch is None else _touches_of(raw, touch, notes)
    common, misfit = np.zeros(len(raw)), np.zeros(len(raw))
    bow = usual_bow(whisker) if cue is None or cue.takes_curved else None
    if FROM_SHAPE in raw.get("signals_from", pd.Series(dtype=object)).to_numpy():
        whisker, cue, si, side = from_shape(raw, si, whisker, cue, touch_names, notes)
        common, misfit, bow = values_of(raw, COMMON), values_of(raw, "misfit"), None
    else:
        si = planar(si, notes)
        if notes[-1:] == [IN_PLANE]:
            if is_curved(whisker):
                raise Refusal(
                    "Six signals of a curved whisker do not say how its curvature lies; give "
                    "moment, axial_force and transverse_force in its plane, or a straight whisker; "
                    "of contacts one by one, write "
                    "ww.posterior(ww.Observer(whisker, ww.cues.SpaceMap()), readings)."
                )
            bow = None
        side = one_side(si, touch_names, notes)
        if len({*SIGNED} & {*si}) > 1:
            sign_note(si, side, whiskers_of(whisker, bow), units_of, columns, notes)
    cue, y, covariance = signals_of(si, cue, whisker, known_stiffness, notes, [*raw.columns])
    bow = bow if cue.takes_curved else None
    plain = Observer(whisker, cue, _receptors(noise, whisker, cue), prior or {})  # type: ignore[arg-type]
    if plain.noise.is_categorical or not plain.noise.reads_signals:
        raise Refusal(f"A table holds signals, which {plain.noise!r} does not report.")
    check_magnitudes(plain, y, units_of)
    touches: Index = np.full(len(raw), -1)
    if touch_names is not None:
        touches = _numbered(touch_names)
    readings = Readings(y, side, covariance)

    def of(*laws: Any) -> Cases:
        return cases_of(whisker, cue, bow, laws, prior)

    given = of(noise if isinstance(noise, ReceptorNoise) else partial(_receptors, noise))
    learnt = None
    receptors = covariance is None or noise is not None
    cases = given if receptors else of(without_receptors)
    if noise is None and covariance is None and type(plain.noise) in (Weber, GeneralisedWeber):
        learnt = learn(given, readings, touches)
        cases = of(*(partial(rescaled_noise, factor=factor) for factor in learnt.factors))
    done = Done(progress, len(raw) + int((touches >= 0).sum()))
    if cost := cases.cost(covariance is not None, done.total, workers or 1):
        print(cost, file=sys.stderr, flush=True)
    status, numbers = _located(cases, readings, receptors, pool, done)
    status[(misfit > 10) & (status != Status.NO_CONTACT)] = Status.IMPROBABLE_READING
    results = dict(zip(RESULTS, numbers.T, strict=False))
    if covariance is not None and receptors:
        alone = _located(of(without_receptors), readings, False, pool, Done())
        results[MEASURED] = alone[1][:, 1]
    if y.shape[1] > len(plain.unknowns):
        results[OFF_BY] = numbers[:, 6]
    results["status"] = np.array([Status(s).name.lower() for s in status], dtype=object)
    results["message"] = np.array([Status(s).message for s in status], dtype=object)
    if touch_names is not None:
        each, words = _located_touches(
            cases, numbers[:, :4], status, readings, touches, common, learnt, pool, done
        )
        results |= dict(zip(TOUCH_RESULTS, each.T, strict=False)) | {"touch_status": words}
    notes += [
        _whisker_in_words(whisker, bow),
        f"Cue: {cue!r}.",
        _noise_in_words(plain, covariance is not None, receptors, learnt),
        _priors(plain),
    ]
    if bow is None and (note := plain.note):
        notes.append(note + ".")
    order = (*RESULTS[:6], MEASURED, OFF_BY, *RESULTS[6:], *TOUCH_RESULTS)
    out = raw.assign(**{name: results[name] for name in order if name in results})
    out.attrs = {**raw.attrs, "notes": tuple(notes)}
    return out


def _by_calibration(
    calibration: Calibration, table: Any, cue: Cue | None, noise: Any, columns: Any, units: Any,
    touch: Any, prior: Any, **options: Any,
) -> pd.DataFrame:  # fmt: skip
    """The table located by the best fit of a calibration, and averaged over its samples."""
    if cue is not None or noise is not None:
        raise Refusal(
            "A calibration has its own cue and noise",
            remedy=(
                "leave both out, or write ww.locate(table, calibration.whisker, "
                "cue=calibration.cue, noise=calibration.noise)"
            ),
        )
    columns, units = ({n: v for n, v in (given or {}).items() if n != "radial_distance"}
                      for given in (columns, units))  # fmt: skip
    raw, si, _ = read_contacts(table, columns, units)
    if ("angular_velocity" in si) != calibration.by_velocity:
        having, lacking = ("taps", "contacts") if calibration.by_velocity else ("contacts", "taps")
        raise Refusal(
            f"The {having} have an angular_velocity, the {lacking} have none, and their "
            "slopes cannot be compared",
            remedy="give both or neither",
        )
    best: Any = {"cue": calibration.cue, "noise": calibration.noise}
    located = locate(
        raw, calibration.whisker, **best, columns=columns, units=units, touch=touch, prior=prior,
        **options,
    )  # fmt: skip
    _, y, covariance = signals_of(
        si, calibration.cue, calibration.whisker, True, [], [*raw.columns]
    )
    observer = Observer(calibration.whisker, **best, prior=prior or {})
    slopes = Slopes(
        y[:, 0], np.zeros(len(raw)) if covariance is None else covariance[:, 0, 0],
        np.full(len(raw), -1) if touch is None else _numbered(_touches_of(raw, touch, [])),
        partial(distance_prior, observer),
    )  # fmt: skip
    return averaged(calibration, located, slopes)


def _receptors(noise: Any, whisker: Any, cue: Cue) -> Any:
    """The noise of an observer: as given, or the default noise of a Weber fraction."""
    if noise is None or isinstance(noise, ReceptorNoise):
        return noise
    return default_noise(whisker, cue, noise)


def without_receptors(whisker: Any, cue: Cue) -> ReceptorNoise:
    """Negligible receptor noise (1e-6 of a signal), for use with measurement errors."""
    size, none = len(cue.signal_names), 1e-6
    # A default floor is a hundredth of the usual signal, or one degree.
    floor = 100 * none * default_noise(whisker, cue, none).floors(size)
    return GeneralisedWeber(none, floor=floor)


def _touches_of(raw: pd.DataFrame, touch: Any, notes: list[str]) -> NDArray[np.object_]:
    """The touch of each row; None for rows that belong to none."""
    if isinstance(touch, str):
        if touch not in raw.columns:
            raise Refusal(
                f"The table has no column {touch!r} of touches",
                remedy=f"it has {checks.listed(map(str, raw.columns), 8)}",
            )
        values = raw[touch].to_list()
    else:
        values = checks.several("touch", touch, "write the name of a column")
        if len(values) != len(raw):
            raise Refusal(
                named("touch") + f" must have a value for each of {len(raw)} rows",
                len(values),
                "leave those in no touch None",
            )
    words = [str(value).strip().lower() for value in values]
    zero = np.array([word in ("0", "0.0") for word in words])
    # Rows of 0 in several places are frames without contact, between touches numbered from 1.
    between = zero.any() and not zero.all() and (np.diff(zero, prepend=False) & zero).sum() > 1
    out = np.empty(len(values), dtype=object)
    for i, (value, word) in enumerate(zip(values, words, strict=True)):
        empty = value is None or pd.isna(value) or word in ("", "false") or (zero[i] and between)
        out[i] = None if empty else value
    if any(str(value).strip().lower() == "true" for value in out):
        raise Refusal(
            "touch is True where there is a touch, and does not say which: all would be one. "
            "Number them, in order of time by (t & ~t.shift(fill_value=False)).cumsum().where(t)."
        )
    first = [i for i in range(len(out)) if i == 0 or out[i] != out[i - 1]]
    starts = pd.Series([out[i] for i in first], dtype=object).dropna()
    again = starts[starts.duplicated()].unique()
    if len(again):
        notes.append(
            f"Rows of {len(again)} of {starts.nunique()} touches, such as {again[0]!r}, stand in "
            "several places of the table: one touch each. If numbers begin anew in each trial or "
            "whisker, number touches throughout."
        )
    return out


def _numbered(touches: NDArray[np.object_]) -> Index:
    """The touch of each row as a number, -1 for none."""
    return pd.factorize(pd.Series(touches, dtype=object))[0].astype(np.intp)


def _whisker_in_words(whisker: Any, bow: float | None) -> str:
    plain = getattr(whisker, "whisker", whisker)
    out = (
        f"Whisker: {1e3 * plain.length:.3g} mm long, radius {1e6 * plain.base_radius:.3g} to "
        f"{1e6 * plain.tip_radius:.3g} µm"
    )
    if bow is None and isinstance(plain.curvature, Assumed) and not is_curved(whisker):
        if not (is_wire(plain) or plain.hinge_stiffness):
            return f"{out}, taken as straight."
        what = "a wire and so " if is_wire(plain) else ""
        bent = remedy("; if it is bent, write " + argument("curvature", 5) + ", say")
        return f"{out}, {what}taken as straight" + bent + "."
    if bow is None:
        return f"{out}, {'curved' if is_curved(whisker) else 'straight'}."
    curved = argument("curvature", float(f"{bow:.2g}"))
    if plain.identity:
        curved = call("ww.Whisker.from_identity", "...", argument("curved", True))
    straight = argument("curvature", 0)
    return (
        f"{out}, of unknown shape at rest: its curvature has a normal prior of mean 0 and sd "
        f"{bow:.2g} /m, as is usual of its kind, to either side"
        + remedy(": write " + straight + " of a straight whisker, " + curved + " of a curved one")
        + "."
    )


def _noise_in_words(plain: Observer, measured: bool, receptors: bool, learnt: Learnt | None) -> str:
    """The noise of the table's signals; where it was not given, also how to give it."""
    names, size = plain.cue.signal_names, len(plain.cue.signal_names)
    if learnt is None:
        law = f"{plain.noise!r}" if receptors else ""
        both = " and ".join(filter(None, ["its measurement errors" if measured else "", law]))
        return f"Noise of the table's numbers: {both}."
    factor = np.exp(np.log(learnt.factors).mean(axis=0))
    k = plain.noise.weber_fractions(size) * factor
    fractions = ", ".join(f"{v:.2g} of {n}" for v, n in zip(k, names, strict=True) if v > 0)
    how = (
        f"was learnt from {learnt.source} (belief about k: {BELIEF})" if learnt.source else
        f"follows from nothing in this table: it is as believed of such tables (k {BELIEF})"
    )  # fmt: skip
    return (
        f"The noise of the table's numbers was not given and {how}: k = {fractions}"
        + remedy("; if it was measured, write " + argument("noise", 0.1, of="locate"))
        + "."
    )


def _priors(observer: Observer) -> str:
    """The priors of a contact's unknowns, in a sentence."""
    low, high = (1e3 * end for end in observer.reach)
    flat = {"radial_distance": f"flat from {low:.3g} to {high:.3g} mm",
            "deflection_angle": "flat up to where the whisker is lost"}  # fmt: skip
    priors = [
        f"{name} {in_words(observer.prior[name]) if name in observer.prior else flat[name]}"
        for name in observer.unknowns
    ]
    return f"Priors: {', '.join(priors)}."


def methods_paragraph(located: pd.DataFrame) -> str:
    """How the contacts of a table from `locate` were located, as text for a methods section."""
    status = located["status"].value_counts()
    counts = ", ".join(f"{n} {str(name).replace('_', ' ')}" for name, n in status.items())
    many = counted(len(located), "row")
    sentences = [f"Radial distances were inferred of {many} of a table ({counts})."]
    if "touch_status" in located:
        touches = located[TOUCH_RESULTS[0]].nunique()
        count = counted(touches, "touch")
        sentences.append(f"Rows of a touch share its distance; {count} located.")
    notes = map(without_remedies, located.attrs["notes"])
    return methods_text([*sentences, *notes, "Posteriors are by quadrature."])


def _located(
    cases: Cases, readings: Readings, receptors: bool, pool: Spread, done: Done
) -> tuple[Index, Array]:
    """Status of each row (n,), and numbers (n, 7): those of `RESULTS`, and `OFF_BY`."""
    y, covariance = readings.y, readings.covariance
    numbers = np.full((len(y), 7), np.nan)
    status: Index = np.full(len(y), int(Status.NOT_A_READING))
    finite = np.isfinite(y).all(axis=1)
    if covariance is not None:
        finite &= np.isfinite(covariance).all(axis=(1, 2))
    zero = (y == 0).any(axis=1)
    status[finite & zero] = Status.NO_CONTACT
    usable = np.flatnonzero(finite & ~zero)
    done(len(y) - len(usable))
    ends, values = rows_of(cases, readings.of(usable), pool, done)
    observer = cases.middle[0][0]
    numbers[usable] = np.column_stack([values[:, :2], ends, values[:, [2, 3, MISFIT]]])
    numbers *= [1e3, 1e3, 1e3, 1e3, 180 / np.pi, 180 / np.pi, 1]
    if observer.bounded < 2:
        numbers[:, 4:6] = np.nan
    mean, sd, error, misfit = values[:, [0, 1, ERROR, MISFIT]].T
    each = np.full(len(usable), int(Status.CONVERGED))
    outside = receptors and all(domain.of_observer(pair[0]) for pair in cases.middle)
    each[(mean < domain.CONTACTS[0] * observer.reach[1]) | outside] = Status.OUTSIDE_DOMAIN
    each[sd > 0.9 * _prior_sd(observer)] = Status.UNIDENTIFIED
    each[~(error <= TOLERANCE)] = Status.IMPRECISE
    each[~(misfit <= 5)] = Status.IMPROBABLE_READING
    status[usable] = each
    return status, numbers


def _prior_sd(observer: Observer) -> float:
    r = np.linspace(*observer.reach, 402)[1:-1]
    weight = distance_prior(observer, r)
    mean = np.average(r, weights=weight)
    return float(np.sqrt(np.average((r - mean) ** 2, weights=weight)))


def _located_touches(
    cases: Cases, alone: Array, status: Index, readings: Readings, touches: Index, common: Array,
    learnt: Learnt | None, pool: Spread, done: Done,
) -> tuple[Array, NDArray[np.object_]]:  # fmt: skip
    """Numbers (n, 4) of each row's touch, in the order of `TOUCH_RESULTS`, and its status.

    A touch with one usable row has that row's numbers from `alone`. The part of the error that all
    rows share, `common` (n,) in mm, does not average out over the rows of a touch.
    """
    numbers = np.full((len(touches), 4), np.nan)
    words = np.full(len(touches), "no_touch", dtype=object)
    good = np.isin(status, (Status.CONVERGED, Status.UNIDENTIFIED, Status.OUTSIDE_DOMAIN))
    several: list[tuple[Index, Index]] = []  # rows of a touch, and those that are used
    reach = np.array([observer.reach[1] for observer in cases.middle[0]])
    reach = np.where(readings.side < 0, reach[1], reach[0])
    order = np.argsort(touches, kind="stable")
    names, first = np.unique(touches[order], return_index=True)
    for name, members in zip(names, np.split(order, first[1:]), strict=True):
        if name < 0:
            continue
        used = members[good[members]]
        words[members] = "converged" if used.size else "not_a_reading"
        if used.size == 1:
            numbers[members] = alone[used]
        elif used.size:
            if np.ptp(reach[used]) > 0:
                raise Refusal(
                    "A touch has rows from both sides of a curved whisker, which reach "
                    "differently far at the cue's angle",
                    remedy="give the rows of each side a touch of their own",
                )
            several.append((members, used))
    done((touches >= 0).sum() - sum(used.size for _, used in several))
    sizes = np.array([used.size for _, used in several], dtype=float)
    exponent = np.ones(len(sizes)) if learnt is None else learnt.exponent(sizes)
    ends, values = touches_of(
        cases, readings, [used for _, used in several], exponent, pool, done
    )
    for (members, used), end, value in zip(several, 1e3 * ends, 1e3 * values, strict=True):
        words[members] = "converged" if np.isfinite(value[0]) else "rows_disagree"
        if np.isfinite(value[0]):
            more = (common[used] ** 2).mean() * (1 - 1 / used.size)
            wider = np.sqrt(1 + more / value[1] ** 2)
            end = np.maximum(value[0] + (end - value[0]) * wider, 0.0)
            numbers[members] = [value[0], value[1] * wider, *end]
    return numbers, words
