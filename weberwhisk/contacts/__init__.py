"""Measured contacts: from trackers' files and tables of forces to distances.

`locate` makes one posterior of each row of a table, and one of each touch.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from .. import _checks, domain
from .._values import Array, Index
from ..cues import Cue
from ..cues.force_map import MeasuredAngle, is_curved
from ..inference import Status
from ..inference.coordinates import in_words
from ..inference.observer import Observer, default_noise
from ..mechanics import Profile
from ..receptors import ReceptorNoise
from ..whisker import Whisker
from .calibration import Calibration, HingedTap, averaged, calibrate
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
from .lattice import Lattice, Readings, refuse_sharp
from .signals import tracked_signals
from .sums import alike, summarise, touch_posterior
from .trackers import read_tracking, simulate_tracking

__all__ = [
    "Calibration", "HingedTap", "MeasuredAngle", "calibrate", "locate", "read_tracking",
    "simulate_tracking", "tracked_signals",
]  # fmt: skip

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


class _Located(NamedTuple):
    """Numbers of n rows: (n, 6) in the order of `RESULTS`, status, and the ends of densities."""

    numbers: Array
    status: NDArray[np.int64]
    between: Array


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
    _checks.kind("whisker", whisker, "a Whisker", "stiffness", "write Whisker.from_identity('C2')")
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
    readings, receptors = Readings(y, covariance), covariance is None or noise is not None
    out, done = raw.copy(), 0
    both = (MEASURED,) if covariance is not None and receptors else ()
    found_rows = {name: np.full(len(raw), np.nan) for name in (*RESULTS[:6], *both)}
    status = np.zeros(len(raw), dtype=int)
    between = np.full((len(raw), 2), np.nan)
    lattices = np.full(len(raw), None, dtype=object)
    for rows, own in _by_side(side, whisker):
        observer = Observer(own, cue, _receptors(noise, own, cue), prior or {})
        if observer.noise.is_categorical or not observer.noise.reads_signals:
            raise ValueError(f"A table holds signals, which {observer.noise!r} does not report.")
        check_magnitudes(observer, y[rows], found)
        refuse_sharp(observer)
        lattice = Lattice(observer, with_receptors=receptors)

        def tell(now: int, _: int, before: int = done) -> None:
            if progress:
                progress(before + now, len(raw))

        located = _rows(lattice, readings.take(rows), tell, keep=named is not None)
        done += len(rows)
        for name, column in zip(RESULTS, located.numbers.T, strict=False):
            found_rows[name][rows] = column
        status[rows], between[rows] = located.status, located.between
        lattices[rows] = Lattice(observer, with_receptors=receptors, for_touches=True)
        if both:
            lattice = Lattice(observer, with_receptors=False)
            alone = _rows(lattice, readings.take(rows), None, keep=False)
            found_rows[MEASURED][rows] = alone.numbers[:, 1]
    # A bent whisker more than three times as far off its points as their noise tells of no contact.
    status[(misfit > 10) & (status != Status.NO_CONTACT)] = Status.IMPROBABLE_READING
    words = {"status": np.array([Status(s).name.lower() for s in status], dtype=object)}
    if named is not None:
        each = np.stack([found_rows[name] for name in RESULTS[:4]], axis=1)
        numbers, words["touch_status"] = _of_touches(
            each, lattices, between, status, readings, named, common
        )
        found_rows |= dict(zip(TOUCH_RESULTS, numbers.T, strict=False))
    errors = "its measurement errors" if covariance is not None else ""
    ks = dict.fromkeys(observer.noise.weber_fractions(y.shape[1]).tolist())
    law = f"{observer.noise!r}, k = {', '.join(f'{k:g}' for k in ks)}" if receptors else ""
    said = " and ".join(filter(None, [errors, law]))
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


def _touches_of(
    raw: pd.DataFrame, touch: str | Sequence[Any], notes: list[str]
) -> NDArray[np.object_]:
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
    lattice: Lattice,
    readings: Readings,
    progress: Callable[[int, int], None] | None,
    *,
    keep: bool,
) -> _Located:
    n = len(readings.value)
    numbers = np.full((n, 6), np.nan)
    status = np.full(n, int(Status.NOT_A_READING))
    between = np.full((n, 2), np.nan)
    finite = np.isfinite(readings.value).all(axis=1)
    if readings.covariance is not None:
        finite &= np.isfinite(readings.covariance).all(axis=(1, 2))
    zero = (readings.value == 0).any(axis=1)
    status[finite & zero] = Status.NO_CONTACT
    rows = np.flatnonzero(finite & ~zero)
    some = readings.take(rows)
    outside = bool(domain.of_observer(lattice.observer)) and lattice.with_receptors
    prior_sd = _prior_sd(lattice.observer)
    done = n - len(rows)
    groups = alike(lattice, some)
    for batch in (groups[i : i + 32] for i in range(0, len(groups), 32)):
        first = some.take([g[0] for g in batch])
        # Cells that others share, or a touch, are sought farther: 5 sd beyond readings 1 sd off.
        drop = np.array([23.0 if keep or len(g) > 1 else 16.0 for g in batch])
        for cells in lattice.search(first, drop):
            at = rows[np.concatenate([batch[i] for i in cells.rows])]
            found = summarise(lattice, cells, batch, some, 0.95)
            numbers[at, 0], numbers[at, 1] = found.mean[:, 0], found.sd[:, 0]
            numbers[at, 2:4], between[at] = found.ends, found.between
            if lattice.observer.bounded > 1:
                numbers[at, 4], numbers[at, 5] = found.mean[:, 1], found.sd[:, 1]
            own = np.full(len(at), int(Status.CONVERGED))
            far = found.mean[:, 0] < domain.CONTACTS[0] * lattice.observer.reach[1]
            own[far | outside] = Status.OUTSIDE_DOMAIN
            own[found.sd[:, 0] > 0.9 * prior_sd] = Status.UNIDENTIFIED
            own[found.off > 5] = Status.IMPROBABLE_READING
            own[~found.precise] = Status.IMPRECISE
            status[at] = own
            done += len(at)
            if progress:
                progress(done, n)
    numbers *= [1e3, 1e3, 1e3, 1e3, 180 / np.pi, 180 / np.pi]
    return _Located(numbers, status, between)


def _prior_sd(observer: Observer) -> float:
    r = np.linspace(*observer.reach, 402)[1:-1]
    weight = observer.distance_prior(r)
    mean = np.average(r, weights=weight)
    return float(np.sqrt(np.average((r - mean) ** 2, weights=weight)))


def _of_touches(
    alone: Array, lattices: NDArray[np.object_], between: Array, status: Array, readings: Readings,
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
    for each in touch.groupby(touch, sort=False).indices.values():
        rows = np.asarray(each)
        used = rows[good[rows]]
        words[rows] = "converged" if used.size else "not_a_reading"
        if used.size == 1:
            numbers[rows] = alone[used]
        elif used.size:
            if len({lattice.observer.reach for lattice in lattices[used]}) > 1:
                raise ValueError(
                    "A touch has rows from both sides of a curved whisker, which reach differently "
                    "far at the cue's angle; give the rows of each side a touch of their own."
                )
            low, high = between[used, 0].max(), between[used, 1].min()
            sides = [(one, used[lattices[used] == one]) for one in dict.fromkeys(lattices[used])]
            found = touch_posterior(
                [(lattice, readings.take(own)) for lattice, own in sides], (low, high), 0.95
            )
            own = 1e3 * np.array([found.mean, found.sd, *found.ends])
            more = (common[used] ** 2).mean() * (1 - 1 / used.size)
            wider = np.sqrt(1 + more / own[1] ** 2)
            own[1:] = [own[1] * wider, *np.maximum(own[0] + (own[2:] - own[0]) * wider, 0.0)]
            numbers[rows] = own
            words[rows] = "converged" if found.agree else "rows_disagree"
    return numbers, words
