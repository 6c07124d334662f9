"""From a table of contacts to radial distances: one posterior a row, and one a touch."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from .. import _checks, domain
from ..behaviour.io import load_table
from ..cues import Compliance, Cue, ForceMap, UnknownStiffness
from ..cues.force_map import SIGNALS
from ..observer import Observer
from ..posterior import Status
from ..receptors import GeneralisedWeber, Joint, ReceptorNoise, Weber
from ..whisker import YOUNGS_MODULUS, Whisker
from .columns import Array, find_columns, one_side, planar, values_of
from .lattice import Cloud, Lattice, Readings
from .touches import touch_posterior

#: What `locate` adds to a table.
RESULTS = (
    "radial_distance_mm", "sd_mm", "lower_mm", "upper_mm", "angle_deg", "angle_sd_deg",
    "status", "message",
)  # fmt: skip
TOUCH_RESULTS = (
    "touch_radial_distance_mm", "touch_sd_mm", "touch_lower_mm", "touch_upper_mm", "touch_status",
)  # fmt: skip
_DISAGREE = "rows_disagree"


@dataclass(frozen=True, eq=False, repr=False)
class MeasuredAngle(Cue):
    """A map of forces, and the deflection angle as video shows it, with an error of its own.

    Parameters
    ----------
    cue : Cue
        Of a distance and an unknown deflection angle.

    Examples
    --------
    >>> cue = MeasuredAngle(ForceMap(["moment"]))
    >>> cue.signal_names, cue.unknowns
    (('moment', 'measured_angle'), ('radial_distance', 'deflection_angle'))
    """

    cue: Cue

    @property
    def signal_names(self) -> tuple[str, ...]:
        """The cue's, and the angle."""
        return (*self.cue.signal_names, "measured_angle")

    @property
    def unknowns(self) -> tuple[str, ...]:
        """Those of the cue."""
        return self.cue.unknowns

    def signals(self, whisker: Whisker, contact: Array, *, model: str | None = None) -> Any:
        """The cue's signals and the angle, (..., S), and the outcome."""
        contact = np.asarray(contact, dtype=float)
        signals, outcome = self.cue.signals(whisker, contact, model=model)
        return np.concatenate([signals, contact[..., 1:2]], axis=-1), outcome

    def default_noise(self) -> ReceptorNoise:
        """Weber's law with k = 0.1, and a degree of the angle."""
        angle = GeneralisedWeber(0.0, floor=float(np.radians(1.0)))
        return Joint([Weber(0.1), angle], [len(self.cue.signal_names), 1])


class _Located(NamedTuple):
    """Numbers of n rows: (n, 6) in the order of `RESULTS`, status, and the cells of each row."""

    numbers: Array
    status: NDArray[np.int64]
    clouds: list[Cloud | None]


def locate(
    table: pd.DataFrame | str | Path,
    whisker: Whisker,
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
    whisker : Whisker
        With another Young's modulus than the default, it is taken as known; else the stiffness is
        unknown, with the published spread of moduli.
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
        Weber's law with k = 0.1, and one degree of a measured angle. With both, they add.
    prior : mapping, optional
        As of `Observer`.
    progress : callable, optional
        Called with (rows done, rows in all).

    Returns
    -------
    DataFrame
        The table, in its own index and columns, and `radial_distance_mm`, `sd_mm`, the 95 %
        interval `lower_mm` to `upper_mm`, `angle_deg` and `angle_sd_deg`, `status` and
        `message`; with `touch` also `touch_radial_distance_mm` and so on, the same in all rows of a
        touch. Rows that tell of no contact stay, empty, and their status says why.
        ``attrs["notes"]`` says what was taken for granted: cue, units, signs, noise.

    Raises
    ------
    ValueError
        For columns that are not there or are text, unknown units, values that are of another unit,
        a table that has these results already, signals from which no distance follows.

    Notes
    -----
    Signs: moment, transverse force and angle change sign with the side of the push; the axial
    force is positive in compression. Rows of either side, and tables of the opposite convention,
    are turned, and `notes` says so.

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
    _checks.kind("whisker", whisker, "a Whisker", "length", "write Whisker.from_identity('C2')")
    raw, si, found = read_contacts(table, columns, units)
    header = [str(c) for c in raw.columns]
    for name in (*RESULTS, *(TOUCH_RESULTS if touch is not None else ())):
        if name in header:
            raise ValueError(f"The table has a column {name!r} already; rename or drop it.")
    notes: list[str] = []
    unsaid = [q for q, (_, _, said) in found.items() if not said]
    if unsaid:
        notes.append(f"No unit was given for {', '.join(unsaid)}: taken as SI (N m, N, rad).")
    si = planar(si, notes)
    one_side(si, notes)
    cue, y, covariance = _signals(si, cue, whisker, notes, header)
    observer = Observer(whisker, cue, noise, prior or {})  # type: ignore[arg-type]
    if observer.noise.is_categorical or not observer.noise.reads_signals:
        raise ValueError(f"A table holds signals, which {observer.noise!r} does not report.")
    receptors = covariance is None or noise is not None
    errors = "its measurement errors" if covariance is not None else ""
    said = " and ".join(filter(None, [errors, f"{observer.noise!r}" if receptors else ""]))
    notes.append(f"Cue: {cue!r}. Noise of the table's numbers: {said}.")
    _check_magnitudes(observer, y, found)
    named = None if touch is None else _touches(raw, touch)
    lattice = Lattice(observer, with_receptors=receptors, for_touches=named is not None)
    readings = Readings(y, covariance)
    located = _rows(lattice, readings, progress, keep=named is not None)
    out = raw.copy()
    for name, column in zip(RESULTS, located.numbers.T, strict=False):
        out[name] = column
    out["status"] = [Status(s).name.lower() for s in located.status]
    out["message"] = [Status(s).message for s in located.status]
    if named is not None:
        _add_touches(out, lattice, readings, located, named)
    out.attrs = {**raw.attrs, "notes": tuple(notes)}
    return out


def read_contacts(
    table: Any, columns: Mapping[str, str] | None, units: Mapping[str, str] | None
) -> tuple[pd.DataFrame, dict[str, Array], dict[str, tuple[str, float, bool]]]:
    """The table, its known quantities in SI, and where each of them was found."""
    raw = _table(table)
    found = find_columns([str(c) for c in raw.columns], columns, units)
    return raw, {q: values_of(raw, c) * factor for q, (c, factor, _) in found.items()}, found


def _table(table: Any) -> pd.DataFrame:
    if isinstance(table, pd.DataFrame):
        if not table.columns.is_unique:
            twice = table.columns[table.columns.duplicated()][0]
            raise ValueError(f"There are two columns {str(twice)!r}; give each its own name.")
        raw = table
    else:
        raw, _ = load_table(table, "contact")
        raw = raw.copy()
        for column in raw:  # text files give text in every cell
            number = pd.to_numeric(raw[column], errors="coerce")
            if number.notna().equals(raw[column].notna()):
                raw[column] = number
    if not len(raw):
        raise ValueError("The table has no rows; give one row per contact under a header.")
    return raw


def _signals(
    si: dict[str, Array], cue: Cue | None, whisker: Whisker, notes: list[str], header: list[str]
) -> tuple[Cue, Array, Array | None]:
    """The cue, the readings (n, S) and the covariances of their errors, if the table has any."""
    forces = [name for name in SIGNALS if name in si]
    if cue is None:
        if "moment_rate" in si and "angular_velocity" in si and len(forces) < 2:
            cue = Compliance()
        elif "deflection_angle" in si and forces:
            cue = MeasuredAngle(ForceMap(forces))
        elif len(forces) > 1:
            cue = ForceMap(forces)
        else:
            raise ValueError(
                f"No distance follows from the columns {_checks.listed(header, 8)}, of which "
                f"{', '.join(si) or 'none'} is known: needed are two of {', '.join(SIGNALS)}, or "
                "deflection_angle and one of them, or moment_rate and angular_velocity; map them "
                'with columns={"moment": "M"}, or on the command line with --column moment=M.'
            )
        if whisker.youngs_modulus == YOUNGS_MODULUS:
            cue = UnknownStiffness(cue)
            notes.append("Young's modulus was not given: unknown, 3.34 GPa with an sd of ln 0.42.")
    names = {"measured_angle": "deflection_angle"}
    wanted = [names.get(name, name) for name in cue.signal_names]
    missing = [name for name in wanted if name not in si]
    if missing:
        raise ValueError(
            f"The cue {cue!r} needs {', '.join(missing)}, which the table has no column of; map "
            f'one with columns={{"{missing[0]}": …}}.'
        )
    y = np.stack([si[name] for name in wanted], axis=-1)
    scale = np.ones(len(y))
    if wanted == ["moment_rate"] and "angular_velocity" in si:
        with np.errstate(divide="ignore", invalid="ignore"):
            inner: Any = cue.cue if isinstance(cue, UnknownStiffness) else cue
            scale = getattr(inner, "angular_velocity", 1.0) / si["angular_velocity"]
            y = y * scale[:, None]
        notes.append("The moment's rate was divided by the angular velocity, row by row.")
    sds = [f"{name}_sd" for name in wanted]
    present = [name for name in sds if name in si]
    if present and len(present) < len(sds):
        raise ValueError(
            f"There is a measurement error in {', '.join(present)}, but none in "
            f"{', '.join(n for n in sds if n not in present)}; give all or none."
        )
    if not present:
        return cue, y, None
    sd = np.abs(np.stack([si[name] for name in sds], axis=-1) * scale[:, None])
    y = np.where(np.all(sd > 0, axis=1, keepdims=True), y, np.nan)
    return cue, y, sd[:, :, None] ** 2 * np.eye(len(sds))


def _check_magnitudes(observer: Observer, y: Array, found: Mapping[str, Any]) -> None:
    """Refuse columns whose middle value is far from what the whisker gives."""
    for name, usual, column in zip(
        observer.cue.signal_names, observer.usual_reading, np.abs(y).T, strict=True
    ):
        known = column[np.isfinite(column) & (column > 0)]
        if not known.size or not np.isfinite(usual) or name == "measured_angle":
            continue
        times = float(np.median(known)) / usual
        if 1e-5 < times < 30:
            continue
        prefix = "u" if times > 1e4 or times < 1 else "m"
        unit = {"moment": "N m", "moment_rate": "N m/s"}.get(name, "N")
        hint = f"did you pass {prefix}{unit}?" if times > 1 else "is the unit right?"
        header = found[name][0] if name in found else name
        raise ValueError(
            f"{header!r} is {'far above' if times > 1 else 'far below'} what this whisker gives, "
            f"{times:.2g} times the usual {name.replace('_', ' ')}: {hint} Write "
            f'units={{"{name}": "{prefix}{unit}"}}, say.'
        )
    measured = [i for i, n in enumerate(observer.cue.signal_names) if n == "measured_angle"]
    angle = np.abs(y[:, measured])
    angle = angle[np.isfinite(angle)]
    if angle.size and np.median(angle) > np.pi:
        raise ValueError(
            "The deflection angle is above half a turn in most rows: did you pass degrees? Write "
            'units={"deflection_angle": "deg"}.'
        )


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


def _add_touches(
    out: pd.DataFrame,
    lattice: Lattice,
    readings: Readings,
    located: _Located,
    named: NDArray[np.object_],
) -> None:
    numbers = np.full((len(out), 4), np.nan)
    status = np.full(len(out), "no_touch", dtype=object)
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
    for name, column in zip(TOUCH_RESULTS, numbers.T, strict=False):
        out[name] = column
    out["touch_status"] = status
