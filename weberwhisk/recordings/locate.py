"""`locate`: one posterior of each row of a table, and one of each touch."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from .. import domain
from .._util import checks
from .._util.values import Array, Flags, Index
from ..cues import Cue
from ..cues.force_map import is_curved
from ..inference import Observer, Status, default_noise
from ..inference.coordinates import in_words
from ..inference.one_distance import ReadingGroup, one_distance
from ..inference.quadrature import TOLERANCE, sums_of
from ..inference.result import distance_prior
from ..mechanics import Profile
from ..receptors import GeneralisedWeber, ReceptorNoise
from ..whisker import Whisker
from .calibration import Calibration, averaged
from .columns import (
    COMMON,
    FROM_SHAPE,
    IN_PLANE,
    check_magnitudes,
    from_shape,
    one_side,
    planar,
    read_contacts,
    signals_of,
    turn_round,
    values_of,
)

#: What `locate` adds to a table.
RESULTS = (
    "radial_distance_mm", "sd_mm", "lower_mm", "upper_mm", "angle_deg", "angle_sd_deg",
    "status", "message",
)  # fmt: skip
TOUCH_RESULTS = (
    "touch_radial_distance_mm", "touch_sd_mm", "touch_lower_mm", "touch_upper_mm", "touch_status",
)  # fmt: skip
#: The sd from measurement errors alone, where receptors have noise as well.
MEASURED = "measurement_sd_mm"
#: Share of a signal that is the noise of receptors that are taken to have none.
NO_NOISE = 1e-6
#: Rows that are located together, for progress and memory.
TOGETHER = 1024
#: How far up to the fold the angles of a touch may go, as shares: with angles flat up to the fold,
#: touches of small angles had errors of 1.4 sd.
SPANS = np.array([0.05, 0.1, 0.2, 0.35, 0.55, 0.8, 1.2])


class _Side(NamedTuple):
    """Rows pushed to one side, and what locates them: without receptors' noise if so wanted."""

    rows: Index
    observer: Observer
    with_receptors: bool


class _Located(NamedTuple):
    """Numbers of n rows: (n, 6) in the order of `RESULTS`, and status."""

    numbers: Array
    status: NDArray[np.int64]


def locate(
    table: pd.DataFrame | str | Path,
    whisker: Whisker | Profile | Calibration,
    *,
    cue: Cue | None = None,
    columns: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    touch: str | Sequence[Any] | None = None,
    noise: ReceptorNoise | ArrayLike | None = None,
    prior: Mapping[str, Any] | None = None,
    known_stiffness: bool | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> pd.DataFrame:
    """The radial distance of each contact of a table, with its uncertainty.

    Parameters
    ----------
    table : DataFrame or path
        A row a contact, or a frame: `moment`, `axial_force`, `transverse_force`,
        `deflection_angle`; `moment_rate` with `angular_velocity`; or the six signals `force_x` …
        `moment_z`. Units stand behind the name (`moment_uNm`); without one, SI. A measurement error
        stands in `moment_sd_uNm` and the like, without a unit in its signal's, one for every signal
        used. Files as in `read_trials`.
    whisker : Whisker, Profile or Calibration
        A calibration by taps brings cue and noise along, and its uncertainty into the distances:
        means over draws of its posterior, the sds of which are added to those of the rows and
        touches, and the intervals widened as much. A table of `tracked_signals` brings its own
        curvature at rest, and its moment and forces are of the same stiffness, which is then taken
        as known.
    cue : Cue, optional
        By default the one that the columns allow. Its stiffness is then as it says.
    columns : mapping, optional
        Our names to the table's, such as ``{"moment": "M"}``.
    units : mapping, optional
        Units of our names, such as ``{"moment": "µN m"}``.
    touch : str or sequence, optional
        A column, or a value a row, that numbers the touches throughout the table; rows where it
        is empty, 0 or False are in none. Rows of a touch share distance, stiffness and how far up
        to the fold angles go, which is unknown where a row's may be any: a touch of two or three
        rows may be less certain than they are.
    noise : ReceptorNoise or Weber fraction, optional
        A Weber fraction is that of `inference.default_noise`, one or one for each signal. By
        default the measurement errors alone where the table has them, else the cue's own noise:
        Weber's law with k = 0.1, and one degree of a measured angle. With both, they add, and
        `measurement_sd_mm` is the sd without receptors.
    prior : mapping, optional
        As of `Observer`.
    known_stiffness : bool, optional
        By default, whether Young's modulus is another than the default. Else the stiffness is
        unknown, with the published spread of moduli.
    progress : callable, optional
        Called with (rows done, rows in all).

    Returns
    -------
    DataFrame
        The table, in its own index and columns, and `radial_distance_mm`, `sd_mm`, the 95 %
        interval `lower_mm` to `upper_mm`, `angle_deg` and `angle_sd_deg` of the push (on a curved
        whisker from the first touch), `status` and `message`; with `touch` also
        `touch_radial_distance_mm` and so on, the same in all rows of a touch. Rows that tell of no
        contact stay, empty, and their status says why.
        ``attrs["notes"]`` says what was taken for granted: cue, units, signs, noise, priors.

    Raises
    ------
    ValueError
        For columns that are not there or are text, unknown units, values that are of another unit,
        a table that has these results already, signals from which no distance follows.

    Notes
    -----
    Signs: moment, transverse force and angle (from the base tangent) change sign with the side of
    the push; the axial force is positive in compression. Rows of either side, and tables whose
    rows are likelier to be the whisker's in the opposite convention, are turned, and `notes` says
    so. Seen from the other side, a curved whisker is a mirrored one.

    Examples
    --------
    >>> import weberwhisk as ww
    >>> w = ww.Whisker(50e-3, 100e-6, 5e-6, youngs_modulus=3e9)
    >>> b = ww.press(w, [20e-3, 30e-3], 0.3)
    >>> table = pd.DataFrame({"moment_uNm": b.moment * 1e6, "axial_force_uN": b.axial_force * 1e6})
    >>> ww.locate(table, w)[["radial_distance_mm", "status"]].round(1)
       radial_distance_mm     status
    0                19.6  converged
    1                29.3  converged
    """
    if isinstance(whisker, Calibration):
        if cue is not None or noise is not None:
            raise ValueError(
                "A calibration has its own cue and noise; leave both out, or write "
                "locate(table, c.whisker, cue=c.cue, noise=c.noise)."
            )
        raw, si, _ = read_contacts(table, columns, units)
        if ("angular_velocity" in si) != whisker.by_velocity:
            having, lacking = ("taps", "contacts") if whisker.by_velocity else ("contacts", "taps")
            raise ValueError(
                f"The {having} have an angular_velocity, the {lacking} have none, and their slopes "
                "cannot be compared; give both or neither."
            )

        def located_by(whisker: Whisker, cue: Cue, noise: ReceptorNoise) -> pd.DataFrame:
            return locate(
                raw, whisker, cue=cue, noise=noise, columns=columns, units=units, prior=prior,
                touch=touch,
            )  # fmt: skip

        return averaged(whisker, located_by, progress)
    checks.kind("whisker", whisker, "a Whisker", "stiffness", "write Whisker.from_identity('C2')")
    raw, si, found = read_contacts(table, columns, units)
    header = [str(c) for c in raw.columns]
    for name in (*RESULTS, MEASURED, *(TOUCH_RESULTS if touch is not None else ())):
        if name in header:
            raise ValueError(f"The table has a column {name!r} already; rename or drop it.")
    notes: list[str] = []
    unsaid = [q for q, (_, _, said) in found.items() if not said]
    several = [c for c in ("whisker", "identity") if c in raw and raw[c].nunique() > 1]
    if several:
        notes.append(f"The column {several[0]!r} names several whiskers: all rows are of one here.")
    if unsaid:
        notes.append(f"No unit was given for {', '.join(unsaid)}: taken as SI (N m, N, rad).")
    named = None if touch is None else _touches_of(raw, touch, notes)
    common, misfit = np.zeros(len(raw)), np.zeros(len(raw))
    if FROM_SHAPE in raw.get("signals_from", pd.Series(dtype=object)).to_numpy():
        whisker, cue, si, side = from_shape(raw, si, whisker, cue, named, notes)
        common, misfit = values_of(raw, COMMON), values_of(raw, "misfit")
    else:
        si = planar(si, notes)
        if notes[-1:] == [IN_PLANE] and is_curved(whisker):
            raise ValueError(
                "Six signals of a curved whisker do not say how its curvature lies; give moment, "
                "axial_force and transverse_force in its plane, or a straight whisker; of contacts "
                "one by one, write posterior(Observer(whisker, cues.SpaceMap()), readings)."
            )
        side = one_side(si, named, notes)
        turn_round(si, _by_side(side, whisker), notes)
    cue, y, covariance = signals_of(si, cue, whisker, known_stiffness, notes, header)
    receptors = covariance is None or noise is not None
    out, done = raw.copy(), 0
    both = (MEASURED,) if covariance is not None and receptors else ()
    found_rows = {name: np.full(len(raw), np.nan) for name in (*RESULTS[:6], *both)}
    status = np.zeros(len(raw), dtype=int)
    sides: list[_Side] = []
    for rows, own in _by_side(side, whisker):
        observer = Observer(own, cue, _receptors(noise, own, cue), prior or {})
        if observer.noise.is_categorical or not observer.noise.reads_signals:
            raise ValueError(f"A table holds signals, which {observer.noise!r} does not report.")
        check_magnitudes(observer, y[rows], found)
        exact = observer if covariance is None else _without_receptors(observer)
        sides.append(_Side(rows, observer if receptors else exact, receptors))
        errors = None if covariance is None else covariance[rows]

        def tell(now: int, _: int, before: int = done) -> None:
            if progress:
                progress(before + now, len(raw))

        located = _rows(sides[-1], y[rows], errors, tell)
        done += len(rows)
        for name, column in zip(RESULTS, located.numbers.T, strict=False):
            found_rows[name][rows] = column
        status[rows] = located.status
        if both:
            alone = _rows(_Side(rows, exact, False), y[rows], errors, None)
            found_rows[MEASURED][rows] = alone.numbers[:, 1]
    # A bent whisker more than three times as far off its points as their noise tells of no contact.
    status[(misfit > 10) & (status != Status.NO_CONTACT)] = Status.IMPROBABLE_READING
    words = {"status": np.array([Status(s).name.lower() for s in status], dtype=object)}
    if named is not None:
        each = np.stack([found_rows[name] for name in RESULTS[:4]], axis=1)
        numbers, words["touch_status"] = _of_touches(
            each, sides, status, y, covariance, named, common
        )
        found_rows |= dict(zip(TOUCH_RESULTS, numbers.T, strict=False))
    measured = "its measurement errors" if covariance is not None else ""
    law = f"{observer.noise!r}" if receptors else ""
    said = " and ".join(filter(None, [measured, law]))
    notes.append(
        f"{_whisker_in_words(whisker)} Cue: {cue!r}. Noise of the table's numbers: {said}. "
        f"{_priors(observer)}"
    )
    as_given: Any = whisker
    if note := Observer(as_given, cue, _receptors(noise, as_given, cue), prior or {}).note:
        notes.append(f"{note}.")  # of the whisker as given, which rows may see mirrored
    words["message"] = np.array([Status(s).message for s in status], dtype=object)
    for name in (*RESULTS[:6], *both, *RESULTS[6:], *(TOUCH_RESULTS if named is not None else ())):
        out[name] = found_rows[name] if name in found_rows else words[name]
    out.attrs = {**raw.attrs, "notes": tuple(notes)}
    return out


def _receptors(noise: Any, whisker: Any, cue: Cue) -> Any:
    """The noise of an observer: as it is, or of a Weber fraction."""
    if noise is None or isinstance(noise, ReceptorNoise):
        return noise
    return default_noise(whisker, cue, noise)


def _without_receptors(observer: Observer) -> Observer:
    """The observer with next to no noise of receptors, beside measurement errors."""
    size = len(observer.cue.signal_names)
    usual = default_noise(observer.whisker, observer.cue, NO_NOISE)
    # A default floor is a hundredth of the usual signal, or one degree.
    floor = 100 * NO_NOISE * usual.floors(size)
    return replace(observer, noise=GeneralisedWeber(NO_NOISE, floor=floor))


def _touches_of(
    raw: pd.DataFrame, touch: str | Sequence[Any], notes: list[str]
) -> NDArray[np.object_]:
    """The touch of each row, None where it is in none."""
    if isinstance(touch, str):
        if touch not in raw.columns:
            raise ValueError(
                f"The table has no column {touch!r} of touches; it has "
                f"{checks.listed(map(str, raw.columns), 8)}."
            )
        values = raw[touch].to_list()
    else:
        values = checks.several("touch", touch, "write the name of a column")
        if len(values) != len(raw):
            raise ValueError(
                f"touch must have a value for each of {len(raw)} rows, got {len(values)}; leave "
                "those in no touch None."
            )
    out = np.empty(len(values), dtype=object)
    for i, value in enumerate(values):
        empty = value is None or value is False or pd.isna(value) or value == 0
        out[i] = None if empty or str(value).strip().lower() in ("", "0", "false") else value
    if any(str(value).strip().lower() == "true" for value in out):
        raise ValueError(
            "touch is True where there is a touch, and does not say which: all would be one. "
            "Number them, in order of time by (t & ~t.shift(fill_value=False)).cumsum().where(t)."
        )
    first = [i for i in range(len(out)) if i == 0 or out[i] != out[i - 1]]
    starts = pd.Series([out[i] for i in first], dtype=object).dropna()
    again = starts[starts.duplicated()].unique()
    if len(again):
        notes.append(
            f"{len(again)} of {starts.nunique()} touches, such as {again[0]!r}, have rows in "
            "several places of the table: one touch each. If numbers begin anew in each trial or "
            "whisker, number touches throughout."
        )
    return out


def _whisker_in_words(whisker: Any) -> str:
    plain = getattr(whisker, "whisker", whisker)
    return (
        f"Whisker: {1e3 * plain.length:.3g} mm long, radius {1e6 * plain.base_radius:.3g} to "
        f"{1e6 * plain.tip_radius:.3g} µm, {'curved' if is_curved(whisker) else 'straight'}."
    )


def _priors(observer: Observer) -> str:
    """The priors of what is unknown of a contact, in a sentence."""
    low, high = (1e3 * end for end in observer.reach)
    flat = {"radial_distance": f"flat from {low:.3g} to {high:.3g} mm",
            "deflection_angle": "flat up to where the whisker is lost"}  # fmt: skip
    said = [
        f"{name} {in_words(observer.prior[name]) if name in observer.prior else flat[name]}"
        for name in observer.unknowns
    ]
    return f"Priors: {', '.join(said)}."


def methods_of(located: pd.DataFrame) -> list[str]:
    """What was done to the contacts of a table of `locate`, sentence by sentence."""
    status = located["status"].value_counts()
    counts = ", ".join(f"{n} {str(name).replace('_', ' ')}" for name, n in status.items())
    said = [f"Radial distances were inferred of the {len(located)} rows of a table ({counts})."]
    if "touch_status" in located:
        touches = located[TOUCH_RESULTS[0]].nunique()
        said.append(f"Rows of a touch share its distance; {touches} touches were located.")
    # A note may end in what to write for another model.
    advice = re.compile(r"(; if it was measured,|:) write [^;]*$")
    notes = (advice.sub(".", note) for note in located.attrs["notes"])
    return [*said, *notes, "Posteriors are by quadrature."]


def _by_side(side: Array, whisker: Any) -> list[tuple[Index, Any]]:
    """Rows pushed to either side, and the whisker as it looks from there: mirrored or not."""
    if not is_curved(whisker):
        return [(np.arange(len(side)), whisker)]
    profile = Profile.of(whisker)
    mirrored = profile.curved(profile.law.scaled(np.ones(()), -1.0))
    seen = ((np.flatnonzero(side > 0), whisker), (np.flatnonzero(side < 0), mirrored))
    return [(rows, own) for rows, own in seen if rows.size]


def _rows(
    side: _Side, y: Array, covariance: Array | None, progress: Callable[[int, int], None] | None
) -> _Located:
    """Rows (n, S) one by one, with the covariances (n, S, S) of their measurement errors."""
    n, observer = len(y), side.observer
    numbers = np.full((n, 6), np.nan)
    status = np.full(n, int(Status.NOT_A_READING))
    finite = np.isfinite(y).all(axis=1)
    if covariance is not None:
        finite &= np.isfinite(covariance).all(axis=(1, 2))
    zero = (y == 0).any(axis=1)
    status[finite & zero] = Status.NO_CONTACT
    every = np.flatnonzero(finite & ~zero)
    outside = bool(domain.of_observer(observer)) and side.with_receptors
    prior_sd = _prior_sd(observer)
    done = n - len(every)
    for rows in (every[i : i + TOGETHER] for i in range(0, len(every), TOGETHER)):
        errors = None if covariance is None else covariance[rows]
        found = sums_of(observer, y[rows], errors)
        numbers[rows, 0], numbers[rows, 1] = found.mean[:, 0], found.sd[:, 0]
        numbers[rows, 2:4] = found.quantiles(np.array([0.025, 0.975]), 0)
        if observer.bounded > 1:
            numbers[rows, 4], numbers[rows, 5] = found.mean[:, 1], found.sd[:, 1]
        own = np.full(len(rows), int(Status.CONVERGED))
        near = found.mean[:, 0] < domain.CONTACTS[0] * observer.reach[1]
        own[near | outside] = Status.OUTSIDE_DOMAIN
        own[found.sd[:, 0] > 0.9 * prior_sd] = Status.UNIDENTIFIED
        own[found.error > TOLERANCE] = Status.IMPRECISE
        own[_is_improbable(observer, y[rows], errors, found.best)] = Status.IMPROBABLE_READING
        status[rows] = own
        done += len(rows)
        if progress:
            progress(done, n)
    numbers *= [1e3, 1e3, 1e3, 1e3, 180 / np.pi, 180 / np.pi]
    return _Located(numbers, status)


def _is_improbable(observer: Observer, y: Array, covariance: Array | None, contact: Array) -> Flags:
    """Rows with a signal more than 5 sd from that of their most probable contact."""
    signals = observer.signals(contact)[0]
    variance = observer.noise.sd(signals) ** 2
    if covariance is not None:
        variance = variance + np.diagonal(covariance, axis1=1, axis2=2)
    off = np.abs(y - observer.noise.mean(signals)) / np.sqrt(variance)
    return np.asarray(~(off.max(axis=1) <= 5))


def _prior_sd(observer: Observer) -> float:
    r = np.linspace(*observer.reach, 402)[1:-1]
    weight = distance_prior(observer, r)
    mean = np.average(r, weights=weight)
    return float(np.sqrt(np.average((r - mean) ** 2, weights=weight)))


def _of_touches(
    alone: Array, sides: Sequence[_Side], status: Array, y: Array, covariance: Array | None,
    named: NDArray[np.object_], common: Array,
) -> tuple[Array, NDArray[np.object_]]:  # fmt: skip
    """Numbers (n, 4) of the touch of each row in the order of `TOUCH_RESULTS`, and its status.

    A touch of one row is that row, whose numbers are `alone`. Of several rows, an error that all
    have in common, mm (n,), is not averaged away.
    """
    numbers = np.full((len(named), 4), np.nan)
    words = np.full(len(named), "no_touch", dtype=object)
    touch = pd.Series(named, dtype=object)
    good = np.isin(status, (Status.CONVERGED, Status.UNIDENTIFIED, Status.OUTSIDE_DOMAIN))
    several: list[tuple[Index, Index]] = []  # rows of a touch, and those that are used
    reach = np.full(len(named), np.nan)
    for side in sides:
        reach[side.rows] = side.observer.reach[1]
    for each in touch.groupby(touch, sort=False).indices.values():
        rows = np.asarray(each)
        used = rows[good[rows]]
        words[rows] = "converged" if used.size else "not_a_reading"
        if used.size == 1:
            numbers[rows] = alone[used]
        elif used.size:
            if np.ptp(reach[used]) > 0:
                raise ValueError(
                    "A touch has rows from both sides of a curved whisker, which reach differently "
                    "far at the cue's angle; give the rows of each side a touch of their own."
                )
            several.append((rows, used))
    for begin in range(0, len(several), 64):
        some = several[begin : begin + 64]
        owner = np.full(len(named), -1)
        for i, (_, used) in enumerate(some):
            owner[used] = i
        groups = []
        for side in sides:
            at = side.rows[owner[side.rows] >= 0]
            errors = None if covariance is None else covariance[at]
            if at.size:
                groups.append(ReadingGroup(side.observer, y[at], errors, owner[at]))
        each_found = one_distance(groups, len(some), SPANS)
        for (rows, used), found in zip(some, each_found, strict=True):
            words[rows] = "converged" if np.isfinite(found.mean) else "rows_disagree"
            if np.isfinite(found.mean):
                ends = found.quantiles(np.array([0.025, 0.975]))
                own = 1e3 * np.array([found.mean, found.sd, *ends])
                more = (common[used] ** 2).mean() * (1 - 1 / used.size)
                wider = np.sqrt(1 + more / own[1] ** 2)
                own[1:] = [own[1] * wider, *np.maximum(own[0] + (own[2:] - own[0]) * wider, 0.0)]
                numbers[rows] = own
    return numbers, words
