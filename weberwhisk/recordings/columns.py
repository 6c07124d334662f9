"""Columns of a table of contacts: their units and signs, and the cue that they belong to."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pandas as pd

from .._util import checks
from .._util.refusals import Refusal, argument, named, remedy
from .._util.values import Array, Flags
from ..cues import Compliance, Cue, ForceMap, UnknownStiffness
from ..cues.force_map import SIGNALS
from ..cues.protocol import MeasuredAngle, is_curved
from ..cues.unknowns import Friction
from ..inference.observer import Observer
from ..mechanics import Profile, Spiral
from ..mechanics.contact import Outcome
from ..whisker import YOUNGS_MODULUS, Whisker
from .files import refuse_tracked
from .tables import as_number, load_table

PREFIX = {"": 1.0, "n": 1e-9, "u": 1e-6, "m": 1e-3, "k": 1e3}
#: Spellings of units (patterns), and the symbols that replace them.
_WRITTEN = {
    "[µμ]": "u", "°": "deg", "met(re|er)s?": "m", "newtons?": "N", "deg(ree)?s?": "deg",
    "rad(ian)?s?": "rad", "sec(ond)?s?": "s", "nano": "n", "micro": "u", "milli": "m", "kilo": "k",
    r"[\s_·⋅*.-]*s(\^?-1|⁻¹)": "/s", "_?per_?": "/", r"[\s_·⋅×*.-]": "", "Nm/rad": "Nm",
}  # fmt: skip
#: Units of each kind of quantity, without prefixes and blanks.
_UNITS = {
    "moment": {"nm": 1.0, "nmm": 1e-3},
    "force": {"n": 1.0},
    "angle": {"rad": 1.0, "deg": np.pi / 180},
    "moment_rate": {"nm/s": 1.0, "nmm/s": 1e-3},
    "angular_velocity": {"rad/s": 1.0, "deg/s": np.pi / 180},
    "length": {"m": 1.0, "mm": 1e-3, "cm": 1e-2},
}
#: Examples of units, for messages; those of other kinds are in `_UNITS`.
_EXAMPLES = {"moment": "N m, uN m, mN mm", "force": "N, mN, uN", "moment_rate": "N m/s, uN m/s"}
#: Quantities that a table may hold, and the kind of each.
QUANTITIES = {
    "moment": "moment", "axial_force": "force", "transverse_force": "force",
    "deflection_angle": "angle", "moment_rate": "moment_rate",
    "angular_velocity": "angular_velocity", "radial_distance": "length",
    **{f"force_{axis}": "force" for axis in "xyz"},
    **{f"moment_{axis}": "moment" for axis in "xyz"},
}  # fmt: skip
#: Signals whose signs depend on one another; the first in a table gives the side of the push.
SIGNED = ("moment", "deflection_angle", "transverse_force", "axial_force")
IN_PLANE = "Six signals were turned into the plane of each push."
#: Quantities, and sds of measurement errors, such as `moment_sd`, which have the same units.
NAMES = {**QUANTITIES, **{f"{name}_sd": kind for name, kind in QUANTITIES.items()}}
#: Columns of `tracked_signals`: the value of `signals_from`,
FROM_SHAPE = "shape"
#: the correlation of the errors of moment and transverse force,
CORRELATION = "moment_transverse_corr"
#: the part of the distance's sd that all frames share, from the error of the shape at rest,
COMMON = "distance_common_sd_mm"
#: and the curvature at rest: at the base, and its rate along the whisker.
AT_REST = ("rest_curvature_per_m", "rest_curvature_rate_per_m2")


def unit_factor(text: str, kind: str) -> float | None:
    """The size in SI units of a unit as written; None for no unit of that kind."""
    plain = text
    for written, sign in _WRITTEN.items():
        plain = re.sub(written, sign, plain, flags=re.IGNORECASE)
    for unit, factor in _UNITS[kind].items():
        if plain.lower() == unit:
            return factor
        prefix = None if kind in ("angle", "angular_velocity") else PREFIX.get(plain[:1])
        if prefix is not None and plain[1:].lower() == unit:
            return prefix * factor
    return None


def find_columns(
    header: list[str], columns: Mapping[str, str] | None, units: Mapping[str, str] | None
) -> dict[str, tuple[str, float, bool]]:
    """For each quantity: its column, the column's unit in SI units, and whether one was given.

    A quantity is in the column that `columns` maps to it, or in the column of its own name, with or
    without a unit as suffix.
    """
    for name, mapping in (("columns", columns), ("units", units)):
        if mapping is not None and not isinstance(mapping, Mapping):
            raise Refusal(
                named(name) + " must be a mapping",
                checks.shown(mapping),
                "write "
                + argument(name, {"moment": "M" if name == "columns" else "uN m"})
                + ", say",
            )
        for key in mapping or {}:
            checks.one_of(named(name) + " key", key, NAMES)
    sources: dict[str, tuple[str, float, bool]] = {}
    for quantity, column in (columns or {}).items():
        if column not in header and isinstance(column, str):
            column = column.removeprefix("-")
        if column not in header:
            raise Refusal(
                f"The table has no column {column!r}, mapped from {quantity!r}",
                remedy=f"it has {checks.listed(header, 8)}",
            )
        sources[quantity] = _of(quantity, column, _unit_text(quantity, column), units)
    taken = {column for column, _, _ in sources.values()}
    for column in header:
        if column in taken:
            continue
        # Longest names first, so that `moment_rate` is not read as a moment in the unit "rate".
        for quantity in sorted(NAMES, key=len, reverse=True):
            text = _unit_text(quantity, column)
            if text is None:
                continue
            if quantity in (columns or {}):
                break
            if quantity in sources:
                raise Refusal(
                    f"Two columns hold {quantity}, {sources[quantity][0]!r} and {column!r}",
                    remedy="say which with " + argument("columns", {quantity: column}),
                )
            sources[quantity] = _of(quantity, column, text, units)
            break
    for quantity, (column, _, said) in sources.items():
        of = sources.get(quantity.removesuffix("_sd"))
        if of is not None and not said:
            sources[quantity] = (column, *of[1:])
    for quantity in units or {}:
        if quantity not in sources:
            raise Refusal(
                f"A unit was given for {quantity}, which the table has no column of",
                remedy="map one with " + argument("columns", {quantity: ...}),
            )
    return sources


def _unit_text(quantity: str, column: str) -> str | None:
    """The unit behind our name of a quantity, "" for none; None for a column of another name."""
    unit = r"[_ (\[]+(.+?)[)\]]?"
    rest = re.fullmatch(rf"{quantity}(?:{unit})?", column)
    if rest is None and quantity.endswith("_sd"):
        rest = re.fullmatch(rf"{quantity.removesuffix('_sd')}{unit}_sd", column)
    if rest is None or (rest[1] and unit_factor(rest[1], NAMES[quantity]) is None):
        return None
    return rest[1] or ""


def _of(quantity: str, column: str, text: str | None, units: Any) -> tuple[str, float, bool]:
    """Column, unit and whether one was given, of a quantity; `text` is as from `_unit_text`."""
    kind = NAMES[quantity]
    given = (units or {}).get(quantity)
    if given is not None:
        factor = unit_factor(str(given), kind)
        if factor is None:
            examples = _EXAMPLES.get(kind, ", ".join(_UNITS[kind]))
            raise Refusal(
                f"{given!r} is no unit of {quantity}", remedy=f"write one such as {examples}"
            )
        return column, factor, True
    # The text after our name, or the longest suffix of another name that is a unit. A single
    # letter before a unit is then not a prefix: m_Nm is a moment m in N m.
    words = re.split(r"[_ (\[\])]+", column.strip(" )]"))
    last = len(words) - 1
    suffixes = [
        "_".join(words[i:]) for i in range(1, last + 1) if i == last or words[i] not in PREFIX
    ]
    for suffix in suffixes if text is None else [text]:
        factor = unit_factor(suffix, kind) if suffix else None
        if factor is not None:
            return column, factor, True
    return column, 1.0, False


def likely_prefix(times: float, factor: float) -> str:
    """The prefix of a unit that best explains numbers `times` too large.

    `factor` is the size in SI units of the unit in which they were read.
    """
    smaller = (prefix for prefix in PREFIX if prefix != "k")
    return min(smaller, key=lambda p: abs(np.log(times * PREFIX[p] / factor)))


def values_of(table: pd.DataFrame, column: str) -> Array:
    """A column as numbers, NaN where a cell holds none."""
    series = table[column]
    if getattr(series.dtype, "kind", "O") in "bcmM":
        raise Refusal(f"The column {column!r} holds {series.dtype}", remedy="write numbers")
    out = pd.to_numeric(series, errors="coerce").to_numpy(dtype=float)
    text = series.notna().to_numpy() & np.isnan(out)
    blank = series.astype(str).str.strip().str.lower().isin(("", "nan", "na", "none"))
    text &= ~blank.to_numpy()
    if text.sum() * 2 > len(out):
        raise Refusal(
            f"The column {column!r} holds text such as {series[text].iloc[0]!r}",
            remedy=as_number(series[text].iloc[0]),
        )
    return out


def planar(si: dict[str, Array], notes: list[str]) -> dict[str, Array]:
    """Signals in the plane of the push, from the six signals in space where a table has them.

    x is the outward base tangent, so that compression is −force_x. A straight whisker bends in the
    plane of the transverse force, at any azimuth.
    """
    six = [f"{kind}_{axis}" for kind in ("moment", "force") for axis in "xyz"]
    if {"moment_y", "moment_z"} <= set(si):
        azimuth = np.arctan2(si["moment_z"], si["moment_y"])  # 0 of a row without a moment
    elif {"force_x", "force_y", "force_z"} <= set(si):
        azimuth = np.arctan2(si["force_y"], -si["force_z"])
    else:
        return si
    out = {k: v for k, v in si.items() if k.removesuffix("_sd") not in six}
    y, z = np.cos(azimuth), np.sin(azimuth)
    # Moment = contact × force: components of the transverse force along the push.
    components: dict[str, list[tuple[str, Any]]] = {
        "moment": [("moment_y", y), ("moment_z", z)], "axial_force": [("force_x", -1.0)],
        "transverse_force": [("force_y", z), ("force_z", -y)],
    }  # fmt: skip
    for name, terms in components.items():
        if {part for part, _ in terms} <= set(si):
            out[name] = np.sum([share * si[part] for part, share in terms], axis=0)
        if {f"{part}_sd" for part, _ in terms} <= set(si):
            squares = [(share * si[f"{part}_sd"]) ** 2 for part, share in terms]
            out[f"{name}_sd"] = np.sqrt(np.sum(squares, axis=0))
    notes.append(IN_PLANE)
    return out


def one_side(si: dict[str, Array], touch: Any, notes: list[str]) -> Array:
    """Mirror rows in place to positive moments; returns the side of each row, 1 or −1.

    Moment, transverse force and angle change sign with the side.
    """
    turned = ("moment", "moment_rate", "deflection_angle", "transverse_force")
    lead = next((n for n in turned if n in si), None)
    if lead is None:
        return np.ones(len(next(iter(si.values()), [])))
    side = sides_of(si[lead], si.get(f"{lead}_sd"), touch)
    if np.any(side < 0):
        notes.append(
            f"{int((side < 0).sum())} of {side.size} rows mirrored: pushed to the other side "
            f"({lead} below zero)."
        )
    si |= {name: si[name] * side for name in turned if name in si}
    if "angular_velocity" in si:
        si["angular_velocity"] = np.abs(si["angular_velocity"])
    return side


def sides_of(lead: Array, sd: Array | None, touch: Any, within: float = 4.0) -> Array:
    """The side to which each row is pushed, 1 or −1: the sign of its moment.

    A touch has one side. Where the sign of a row is uncertain (`within` that many sds of zero; 4
    is exceeded by one error in 30 000), the likelier side of its whole touch, by Σ ±z²/2, is used.
    """
    side = np.where(lead < 0, -1.0, 1.0)
    if sd is None or touch is None:
        return side
    with np.errstate(divide="ignore", invalid="ignore"):
        z = np.nan_to_num(lead / np.abs(sd), posinf=0.0, neginf=0.0)
    names = pd.Series(touch, dtype=object)
    likelier = pd.Series(z * np.abs(z)).groupby(names).transform("sum").fillna(0.0).to_numpy()
    return np.where((np.abs(z) < within) & (likelier != 0), np.sign(likelier), side)


def seen_from_sides(whisker: Any) -> tuple[Any, Any]:
    """The whisker as pushes to the positive and the negative side meet it, there mirrored."""
    if not is_curved(whisker):
        return whisker, whisker
    if isinstance(whisker, Whisker):
        return whisker, replace(whisker, curvature=-whisker.curvature)
    return whisker, whisker.curved(whisker.law.scaled(np.ones(()), -1.0))


def read_contacts(
    table: Any, columns: Mapping[str, str] | None, units: Mapping[str, str] | None
) -> tuple[pd.DataFrame, dict[str, Array], dict[str, tuple[str, float, bool]]]:
    """The table, its quantities in SI units, and the column of each (see `find_columns`)."""
    raw = _table(table).rename(columns=str)
    if not raw.columns.is_unique:
        twice = raw.columns[raw.columns.duplicated()][0]
        raise Refusal(f"There are two columns {twice!r}", remedy="give each its own name")
    sources = find_columns(list(raw.columns), columns, units)
    if not sources:
        refuse_tracked(raw)
    si = {q: values_of(raw, c) * factor for q, (c, factor, _) in sources.items()}
    for quantity, column in (columns or {}).items():
        if column not in raw and column.startswith("-"):  # of the opposite sign
            si[quantity] = -si[quantity]
    return raw, si, sources


def _table(table: Any) -> pd.DataFrame:
    if isinstance(table, pd.DataFrame):
        raw = table
        if raw.columns.nlevels > 1:
            raise Refusal(
                "The table's columns have several levels", remedy="give each column one name"
            )
    else:
        refuse_tracked(table)
        raw = load_table(table, "contact").frame
        raw = raw.copy()
        for column in raw:  # text files give text in every cell
            number = pd.to_numeric(raw[column], errors="coerce")
            if number.notna().equals(raw[column].notna()):
                raw[column] = number
    if not len(raw):
        raise Refusal("The table has no rows", remedy="give one row per contact under a header")
    return raw


# -- which readings they are ----------------------------------------------------------------------


def reversing(
    quantities: Sequence[str], sources: Mapping[str, tuple[str, float, bool]],
    columns: Mapping[str, str] | None,
) -> dict[str, str]:  # fmt: skip
    """The `columns` to write so that quantities have the opposite sign, by the table's names."""
    # Components in space, from which `planar` computed a signal, are reversed themselves.
    in_space = {"axial_force": ["force_x"], "transverse_force": ["force_y", "force_z"]}
    out = {}
    for quantity in quantities:
        for name in [n for n in in_space.get(quantity, []) if n in sources] or [quantity]:
            column = sources[name][0]
            is_reversed = (columns or {}).get(name, column) != column
            out[name] = column if is_reversed else f"-{column}"
    return out


def sign_note(
    si: dict[str, Array], side: Array, whiskers: Sequence[Any],
    units_of: Mapping[str, tuple[str, float, bool]], columns: Mapping[str, str] | None,
    notes: list[str],
) -> None:  # fmt: skip
    """Note the sign convention in which the rows fit the whisker clearly better.

    Of `whiskers`, one for each possible shape at rest, pushed to either `side`. Axial forces and
    angles of a curved whisker may have either sign.
    """
    names = [n for n in SIGNED if n in si]
    free = names[1:]  # the first gives the side
    signs = np.array(list(product([1.0, -1.0], repeat=len(free))))
    cost = np.full((len(signs), len(si[names[0]])), np.inf)
    usable = _countable(si, names)
    cost[:, ~usable] = 0.0
    for whisker in whiskers:
        for sign, seen in zip((1, -1), seen_from_sides(whisker), strict=True):
            pushed = np.flatnonzero(usable & (side == sign))
            pushed = pushed[:: 1 + len(pushed) // 60]
            if pushed.size:
                y = np.stack([si[n][pushed] for n in names], axis=-1)
                cost[:, pushed] = np.minimum(cost[:, pushed], _sign_costs(seen, names, y, signs))
    cost = np.where(np.isfinite(cost), cost, 0.0).sum(axis=1)
    best = int(cost.argmin())
    if cost[best] < cost[0] - 6:
        negative = [name for name, sign in zip(free, signs[best], strict=True) if sign < 0]
        quantities = " and ".join(name.replace("_", " ") for name in negative)
        mapped = argument("columns", reversing(negative, units_of, columns))
        notes.append(
            f"The rows fit this whisker better with the {quantities} of the opposite sign, and are "
            "taken as they are: the axial force above zero in compression, angle and transverse "
            "force of the moment's sign"
            + remedy("; if the table has it otherwise, write " + mapped)
            + "."
        )


def _sign_costs(whisker: Any, names: list[str], y: Array, signs: Array) -> Array:
    """How badly rows (n, S) fit a whisker at its best contact, under each choice of signs."""
    observer = Observer(whisker, ForceMap())
    contact = observer.space.constrain(observer.space.spread(np.linspace(0.02, 0.98, 25)))[0]
    signals, outcome = MeasuredAngle(ForceMap(SIGNALS)).signals(observer.whisker, contact)
    by_name = dict(zip((*SIGNALS, "deflection_angle"), signals[outcome == Outcome.HELD].T,
                       strict=True))  # fmt: skip
    model = np.stack([by_name[n] for n in names], axis=-1)
    softer = np.exp(np.linspace(-1.0, 1.0, 9))[:, None]
    scale = np.where(np.array(names) == "deflection_angle", 1.0, softer)
    model = (scale[:, None] * model).reshape(-1, len(names))
    size = 0.02 * (y[:, None] ** 2 + model**2) + 1e-300
    deviations = [(y[:, None] * np.append(1.0, sign) - model) ** 2 / size for sign in signs]
    return np.stack([np.minimum(d.sum(axis=2).min(axis=1), 30.0) for d in deviations])


def _countable(si: dict[str, Array], names: list[str]) -> Flags:
    y = np.stack([si[n] for n in names], axis=-1)
    return np.asarray(np.isfinite(y).all(axis=1) & (y != 0).all(axis=1))


def signals_of(
    si: dict[str, Array], cue: Cue | None, whisker: Any, known_stiffness: bool | None,
    notes: list[str], header: list[str],
) -> tuple[Cue, Array, Array | None]:  # fmt: skip
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
            raise Refusal(
                f"No distance follows from the columns {checks.listed(header, 8)}, of which "
                f"{', '.join(si) or 'none'} is known: needed are two of {', '.join(SIGNALS)}, "
                "or deflection_angle and one of them, or moment_rate and angular_velocity",
                remedy="map them with " + argument("columns", {"moment": "M"}),
            )
        plain: Whisker = getattr(whisker, "whisker", whisker)
        if known_stiffness is None:
            known_stiffness = plain.youngs_modulus != YOUNGS_MODULUS
        if not known_stiffness:
            cue = UnknownStiffness(cue)
            notes.append(
                "Young's modulus is the default, and so taken as unknown: 3.34 GPa with an sd of "
                "ln 0.42"
                + remedy(
                    "; if it was measured, write known_stiffness=True or, on the command line, "
                    "--youngs-modulus-gpa"
                )
                + "."
            )
    names = {"measured_angle": "deflection_angle"}
    required = [names.get(name, name) for name in cue.signal_names]
    missing = [name for name in required if name not in si]
    if missing:
        if not set(missing) <= set(NAMES):
            raise Refusal(f"A table has no signals of {cue!r}", remedy="leave cue out")
        raise Refusal(
            f"The cue {cue!r} needs {', '.join(missing)}, which the table has no column of",
            remedy="map one with " + argument("columns", {missing[0]: ...}),
        )
    y = np.stack([si[name] for name in required], axis=-1)
    scale = np.ones(len(y))
    if required == ["moment_rate"] and "angular_velocity" in si:
        with np.errstate(divide="ignore", invalid="ignore"):
            inner: Any = cue.cue if isinstance(cue, UnknownStiffness) else cue
            scale = getattr(inner, "angular_velocity", 1.0) / si["angular_velocity"]
            y = y * scale[:, None]
        notes.append("The moment's rate was divided by the angular velocity, row by row.")
    sds = [f"{name}_sd" for name in required]
    present = [name for name in sds if name in si]
    if present and len(present) < len(sds):
        raise Refusal(
            f"There is a measurement error in {', '.join(present)}, but none in "
            f"{', '.join(n for n in sds if n not in present)}",
            remedy="give all or none",
        )
    if not present:
        return cue, y, None
    sd = np.abs(np.stack([si[name] for name in sds], axis=-1) * scale[:, None])
    y = np.where(np.all(sd > 0, axis=1, keepdims=True), y, np.nan)
    correlation = np.broadcast_to(np.eye(len(sds)), (len(y), len(sds), len(sds))).copy()
    if CORRELATION in si and required == ["moment", "transverse_force"]:
        correlation[:, 0, 1] = correlation[:, 1, 0] = si[CORRELATION]
    return cue, y, sd[:, :, None] * sd[:, None] * correlation


def check_magnitudes(observer: Observer, y: Array, sources: Mapping[str, Any]) -> None:
    """Refuse columns whose median is far from the usual signal of the whisker."""
    for name, usual, column in zip(
        observer.cue.signal_names, observer.usual_reading, np.abs(y).T, strict=True
    ):
        finite = column[np.isfinite(column) & (column > 0)]
        if not finite.size or not np.isfinite(usual) or name == "measured_angle":
            continue
        times = float(np.median(finite)) / usual
        if 1e-5 < times < 30:
            continue
        unit = {"moment": "N m", "moment_rate": "N m/s"}.get(name, "N")
        # The column in space from which the signal in the plane was computed.
        part = {"moment": "moment_y", "axial_force": "force_x"}.get(name, "force_y")
        name = part if part in sources else name
        header, factor, _ = sources.get(name, (name, 1.0, False))
        unit = likely_prefix(2 * times, factor) + unit
        raise Refusal(
            f"{header!r} is {'far above' if times > 1 else 'far below'} what this whisker "
            f"gives, {times:.2g} times the usual {name.replace('_', ' ')}: did you pass "
            f"{unit}?",
            remedy="write " + argument("units", {name: unit}) + ", say",
        )
    measured = [i for i, n in enumerate(observer.cue.signal_names) if n == "measured_angle"]
    angle = np.abs(y[:, measured])
    angle = angle[np.isfinite(angle)]
    if angle.size and np.median(angle) > np.pi:
        raise Refusal(
            "The deflection angle is above half a turn in most rows: did you pass degrees?",
            remedy="write " + argument("units", {"deflection_angle": "deg"}),
        )


def from_shape(
    raw: pd.DataFrame, si: dict[str, Array], whisker: Any, cue: Cue | None, touch: Any,
    notes: list[str],
) -> tuple[Profile, Cue, dict[str, Array], Array]:  # fmt: skip
    """Whisker, cue, signals and sides of a table of `tracked_signals`, for `locate`."""
    profile = Profile.of(whisker)
    common = [*AT_REST, "friction_angle_deg"]
    missing = [n for n in (*common, "contact", "misfit", CORRELATION, COMMON) if n not in raw]
    missing += [n for n in ("moment", "transverse_force") if n not in si]
    if missing:
        raise Refusal(
            f"A table of tracked shapes has no {', '.join(missing)}",
            remedy=(
                "keep the columns that tracked_signals wrote, or drop signals_from to "
                "locate its forces alone"
            ),
        )
    numbers = raw[common].apply(pd.to_numeric).drop_duplicates()
    if len(numbers) > 1:
        raise Refusal(
            "These rows are of several sessions",
            f"{len(numbers)} shapes at rest or angles of friction",
            "locate each alone",
        )
    *rest, friction = (float(v) for v in numbers.iloc[0])
    side = sides_of(si["moment"], si.get("moment_sd"), touch)
    free = ~raw["contact"].astype(str).str.lower().isin(("true", "1", "1.0")).to_numpy()
    out = {name: np.where(free, 0.0, v * (1 if name.endswith("_sd") else side))
           for name, v in si.items()}  # fmt: skip
    out |= {name: np.where(free, 1.0, v) for name, v in out.items() if name.endswith("_sd")}
    out[CORRELATION] = np.where(free, 0.0, raw[CORRELATION].to_numpy(dtype=float))
    if cue is None:
        cue = ForceMap(["moment", "transverse_force"])
        cue = cue if friction == 0 else Friction(cue, float(np.radians(friction)))
    notes.append(
        "Signals are of tracked shapes: the whisker's stiffness drops out of the distance, and its "
        f"curvature at rest is {rest[0]:.3g} /m at the base and rises by {rest[1]:.3g} /m²."
    )
    return profile.curved(Spiral(*rest)), cue, out, side
