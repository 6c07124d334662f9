"""From a table of contacts to radial distances: one posterior a row, and one a touch."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from .. import _checks, domain
from ..cues import Cue
from ..mechanics import Profile
from ..observer import Observer
from ..posterior import Status
from ..receptors import ReceptorNoise
from ..whisker import Whisker
from .calibration import Calibration
from .columns import IN_PLANE, Array, one_side, planar, read_contacts
from .lattice import Cloud, Lattice, Readings
from .readings import check_magnitudes, from_shape, is_curved, signals_of, turn_round
from .signals import FROM_SHAPE
from .touches import touch_posterior

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
_DISAGREE = "rows_disagree"


class _Located(NamedTuple):
    """Numbers of n rows: (n, 6) in the order of `RESULTS`, status, and the cells of each row."""

    numbers: Array
    status: NDArray[np.int64]
    clouds: list[Cloud | None]


def locate(
    table: pd.DataFrame | str | Path,
    whisker: Whisker | Profile | Calibration,
    *,
    cue: Cue | None = None,
    columns: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    touch: str | Sequence[Any] | None = None,
    noise: ReceptorNoise | None = None,
    prior: Mapping[str, Any] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> pd.DataFrame:
    """The radial distance of each contact of a table, with its uncertainty.

    Parameters
    ----------
    table : DataFrame or path
        A row a contact, or a frame: `moment`, `axial_force`, `transverse_force`,
        `deflection_angle`; `moment_rate` with `angular_velocity`; or the six signals `force_x` …
        `moment_z`. Units stand behind the name (`moment_uNm`); without one, SI. A measurement error
        stands in `moment_sd_uNm` and the like, one for every signal used. Files as in
        `read_trials`.
    whisker : Whisker, Profile or Calibration
        A calibration by taps brings cue and noise along, and its uncertainty into the distances:
        means over draws of its posterior, the sds of which are added to those of the rows, and the
        intervals widened as much.
        With another Young's modulus than the default, it is taken as known; else the stiffness is
        unknown, with the published spread of moduli. A table of `tracked_signals` brings its own
        curvature at rest, and its moment and forces are of the same stiffness, which is then taken
        as known.
    cue : Cue, optional
        By default the one that the columns allow. Its stiffness is then as it says.
    columns : mapping, optional
        Our names to the table's, such as ``{"moment": "M"}``.
    units : mapping, optional
        Units of our names, such as ``{"moment": "µN m"}``.
    touch : str or sequence, optional
        A column, or a value a row, that numbers the touches; rows where it is empty, 0 or False
        are in none. Rows of a touch share distance and stiffness.
    noise : ReceptorNoise, optional
        By default the measurement errors alone where the table has them, else the cue's own noise:
        Weber's law with k = 0.1, and one degree of a measured angle. With both, they add, and
        `measurement_sd_mm` is the sd without receptors.
    prior : mapping, optional
        As of `Observer`.
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
        ``attrs["notes"]`` says what was taken for granted: cue, units, signs, noise.

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
        if cue is not None or noise is not None or touch is not None:
            raise ValueError(
                "A calibration has its own cue and noise and locates row by row; leave cue, noise "
                "and touch out, or write locate(table, c.whisker, cue=c.cue, noise=c.noise)."
            )
        return _calibrated(table, whisker, progress, columns=columns, units=units, prior=prior)
    _checks.kind("whisker", whisker, "a Whisker", "stiffness", "write Whisker.from_identity('C2')")
    raw, si, found = read_contacts(table, columns, units)
    header = [str(c) for c in raw.columns]
    for name in (*RESULTS, MEASURED, *(TOUCH_RESULTS if touch is not None else ())):
        if name in header:
            raise ValueError(f"The table has a column {name!r} already; rename or drop it.")
    notes: list[str] = []
    unsaid = [q for q, (_, _, said) in found.items() if not said]
    if unsaid:
        notes.append(f"No unit was given for {', '.join(unsaid)}: taken as SI (N m, N, rad).")
    if FROM_SHAPE in raw.get("signals_from", pd.Series(dtype=object)).to_numpy():
        whisker, cue, si, side = from_shape(raw, si, whisker, cue, notes)
    else:
        si = planar(si, notes)
        if notes[-1:] == [IN_PLANE] and is_curved(whisker):
            raise ValueError(
                "Six signals of a curved whisker do not say how its curvature lies; give moment, "
                "axial_force and transverse_force in its plane, or a straight whisker."
            )
        side = one_side(si, notes)
        turn_round(si, _by_side(side, whisker), notes)
    cue, y, covariance = signals_of(si, cue, whisker, notes, header)
    receptors = covariance is None or noise is not None
    named = None if touch is None else _touches(raw, touch)
    out, done = raw.copy(), 0
    both = (MEASURED,) if covariance is not None and receptors else ()
    found_rows = {name: np.full(len(raw), np.nan) for name in (*RESULTS[:6], *both)}
    words = {"status": np.full(len(raw), "", dtype=object)}
    if named is not None:
        found_rows |= {name: np.full(len(raw), np.nan) for name in TOUCH_RESULTS[:4]}
        words["touch_status"] = words["status"].copy()
    for rows, own in _by_side(side, whisker):
        observer = Observer(own, cue, noise, prior or {})  # type: ignore[arg-type]
        if observer.noise.is_categorical or not observer.noise.reads_signals:
            raise ValueError(f"A table holds signals, which {observer.noise!r} does not report.")
        check_magnitudes(observer, y[rows], found)
        lattice = Lattice(observer, with_receptors=receptors, for_touches=named is not None)
        readings = Readings(y, covariance).take(rows)
        tell = progress and partial(_later, progress, done, len(raw))
        located = _rows(lattice, readings, tell, keep=named is not None)
        done += len(rows)
        for name, column in zip(RESULTS, located.numbers.T, strict=False):
            found_rows[name][rows] = column
        words["status"][rows] = [Status(s).name.lower() for s in located.status]
        if both:
            alone = _rows(Lattice(observer, with_receptors=False), readings, None, keep=False)
            found_rows[MEASURED][rows] = alone.numbers[:, 1]
        if named is not None:
            numbers, status = _of_touches(lattice, readings, located, named[rows])
            for name, column in zip(TOUCH_RESULTS, numbers.T, strict=False):
                found_rows[name][rows] = column
            words["touch_status"][rows] = status
    errors = "its measurement errors" if covariance is not None else ""
    said = " and ".join(filter(None, [errors, f"{observer.noise!r}" if receptors else ""]))
    notes.append(f"Cue: {cue!r}. Noise of the table's numbers: {said}.")
    order = (*RESULTS[:6], *both, *RESULTS[6:], *(TOUCH_RESULTS if named is not None else ()))
    words["message"] = np.array([Status[s.upper()].message for s in words["status"]], dtype=object)
    for name in order:
        out[name] = found_rows[name] if name in found_rows else words[name]
    out.attrs = {**raw.attrs, "notes": tuple(notes)}
    return out


def _calibrated(
    table: Any,
    calibration: Calibration,
    progress: Callable[[int, int], None] | None,
    **options: Any,
) -> pd.DataFrame:
    """Distances under each of the calibration's samples, as one."""
    best = (calibration.whisker, calibration.cue, calibration.noise)
    every, passes = [], (*calibration.samples, best)
    for w, c, n in passes:
        every.append(locate(table, w, cue=c, noise=n, **options))
        if progress:
            progress(len(every) * len(every[0]) // len(passes), len(every[0]))
    *every, out = every
    # A draw that has a row beyond the whisker says nothing of it.
    mean, sd = (np.array([e[name] for e in every]) for name in RESULTS[:2])
    known = np.isfinite(mean).sum(axis=0) > len(every) / 2
    total = np.sqrt((np.nanmean(sd[:, known] ** 2, axis=0)) + np.nanvar(mean[:, known], axis=0))
    middle, wider = np.nanmean(mean[:, known], axis=0), total / out["sd_mm"].to_numpy()[known]
    at = np.flatnonzero(known)
    for name in RESULTS[2:4]:
        column = out[name].to_numpy(copy=True)
        column[at] = middle + wider * (column - out[RESULTS[0]].to_numpy())[at]
        out[name] = column
    for name, values in zip(RESULTS[:2], (middle, total), strict=True):
        column = out[name].to_numpy(copy=True)
        column[at] = values
        out[name] = column
    notes = (*out.attrs["notes"], f"Means over {len(every)} draws of the calibration.")
    out.attrs = out.attrs | {"notes": notes}
    return out


def _by_side(side: Array, whisker: Any) -> list[tuple[NDArray[np.intp], Any]]:
    """Rows pushed to either side, and the whisker as it looks from there: mirrored or not."""
    everything = np.arange(len(side))
    if not is_curved(whisker):
        return [(everything, whisker)]
    law = whisker.law if isinstance(whisker, Profile) else Profile.of(whisker).law
    out: list[tuple[NDArray[np.intp], Any]] = []
    for sign in (1.0, -1.0):
        rows = everything[side == sign]
        if rows.size and sign > 0:
            out.append((rows, whisker))
        elif rows.size:
            mirrored = law.scaled(np.ones(()), sign)
            profile = whisker if isinstance(whisker, Profile) else Profile.of(whisker)
            out.append((rows, profile.curved(mirrored)))
    return out


def _later(tell: Callable[[int, int], None], before: int, total: int, done: int, _: int) -> None:
    tell(before + done, total)


def _rows(
    lattice: Lattice,
    readings: Readings,
    progress: Callable[[int, int], None] | None,
    *,
    keep: bool,
) -> _Located:
    n = len(readings.value)
    numbers = np.full((n, 6), np.nan)
    status = np.full(n, int(Status.NOT_A_READING))
    clouds: list[Cloud | None] = [None] * n
    finite = np.asarray(np.isfinite(readings.value).all(axis=1), dtype=bool)
    if readings.covariance is not None:
        finite &= np.isfinite(readings.covariance).all(axis=(1, 2))
    zero = np.asarray((readings.value == 0).any(axis=1))
    status[finite & zero] = Status.NO_CONTACT
    rows = np.flatnonzero(finite & ~zero)
    some = readings.take(rows)
    outside = bool(domain.of_observer(lattice.observer)) and lattice.with_receptors
    prior_sd = _prior_sd(lattice.observer)
    done = n - len(rows)
    for group in lattice.alike(some):
        cloud = lattice.cloud(some.take(group[:1]))
        found = lattice.summarise(cloud, some.take(group), 0.95)
        at = rows[group]
        numbers[at, 0], numbers[at, 1] = found.mean[:, 0], found.sd[:, 0]
        numbers[at, 2:4] = found.ends
        if lattice.observer.bounded > 1:
            numbers[at, 4], numbers[at, 5] = found.mean[:, 1], found.sd[:, 1]
        own = np.full(len(at), int(Status.CONVERGED))
        far = found.mean[:, 0] < domain.CONTACTS[0] * lattice.observer.reach[1]
        own[far | outside] = Status.OUTSIDE_DOMAIN
        own[found.sd[:, 0] > 0.9 * prior_sd] = Status.UNIDENTIFIED
        own[found.off > 5] = Status.IMPROBABLE_READING
        own[~found.precise] = Status.IMPRECISE
        status[at] = own
        for i in at if keep else ():
            clouds[i] = cloud
        done += len(at)
        if progress:
            progress(done, n)
    numbers[:, :4] *= 1e3
    numbers[:, 4:] = np.degrees(numbers[:, 4:])
    return _Located(numbers, status, clouds)


def _prior_sd(observer: Observer) -> float:
    r = np.linspace(*observer.reach, 402)[1:-1]
    weight = observer.distance_prior(r)
    mean = np.average(r, weights=weight)
    return float(np.sqrt(np.average((r - mean) ** 2, weights=weight)))


def _touches(raw: pd.DataFrame, touch: str | Sequence[Any]) -> NDArray[np.object_]:
    """The touch of each row, None where it is in none."""
    if isinstance(touch, str):
        if touch not in raw.columns:
            raise ValueError(
                f"The table has no column {touch!r} of touches; it has "
                f"{_checks.listed(map(str, raw.columns), 8)}."
            )
        values = raw[touch].to_list()
    else:
        values = _checks.several("touch", touch, "write the name of a column")
        if len(values) != len(raw):
            raise ValueError(
                f"touch must have a value for each of {len(raw)} rows, got {len(values)}; leave "
                "those in no touch None."
            )
    out = np.empty(len(values), dtype=object)
    for i, value in enumerate(values):
        empty = value is None or value is False or pd.isna(value) or value == 0
        out[i] = None if empty or str(value).strip() in ("", "0", "False") else value
    return out


def _of_touches(
    lattice: Lattice, readings: Readings, located: _Located, named: NDArray[np.object_]
) -> tuple[Array, NDArray[np.object_]]:
    """Numbers (n, 4) of the touch of each row in the order of `TOUCH_RESULTS`, and its status."""
    numbers = np.full((len(named), 4), np.nan)
    status = np.full(len(named), "no_touch", dtype=object)
    rows_of: dict[Any, list[int]] = {}
    for i, name in enumerate(named):
        if name is not None:
            rows_of.setdefault(name, []).append(i)
    good = (Status.CONVERGED, Status.UNIDENTIFIED, Status.OUTSIDE_DOMAIN)
    for rows in rows_of.values():
        used = [i for i in rows if located.clouds[i] is not None and located.status[i] in good]
        if not used:
            status[rows] = "not_a_reading"
            continue
        clouds = [c for i in used if (c := located.clouds[i]) is not None]
        found = touch_posterior(lattice, clouds, readings.take(used), 0.95)
        numbers[rows] = [1e3 * v for v in (found.mean, found.sd, *found.ends)]
        status[rows] = "converged" if found.agree else _DISAGREE
    return numbers, status
