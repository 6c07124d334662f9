"""Columns of a table of contacts: which they are, in which unit, with which sign."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from .. import _checks
from ..tables import as_number, load_table

Array = NDArray[np.float64]

PREFIX = {"": 1.0, "n": 1e-9, "u": 1e-6, "m": 1e-3, "k": 1e3}
#: Units as people write them, and signs for them.
_WRITTEN = {
    "[µμ]": "u", "°": "deg", "met(re|er)s?": "m", "newtons?": "N", "deg(ree)?s?": "deg",
    "rad(ian)?s?": "rad", "sec(ond)?s?": "s", "nano": "n", "micro": "u", "milli": "m", "kilo": "k",
    r"[\s_·⋅*.-]*s(\^?-1|⁻¹)": "/s", "_?per_?": "/", r"[\s_·⋅×*.-]": "", "Nm/rad": "Nm",
}  # fmt: skip
#: Units of each kind of quantity, without prefix, as they are written without blanks.
_UNITS = {
    "moment": {"nm": 1.0, "nmm": 1e-3},
    "force": {"n": 1.0},
    "angle": {"rad": 1.0, "deg": np.pi / 180},
    "moment_rate": {"nm/s": 1.0, "nmm/s": 1e-3},
    "angular_velocity": {"rad/s": 1.0, "deg/s": np.pi / 180},
}
#: What a table may hold, and of which kind each is.
QUANTITIES = {
    "moment": "moment",
    "axial_force": "force",
    "transverse_force": "force",
    "deflection_angle": "angle",
    "moment_rate": "moment_rate",
    "angular_velocity": "angular_velocity",
    **{f"force_{axis}": "force" for axis in "xyz"},
    **{f"moment_{axis}": "moment" for axis in "xyz"},
}
IN_PLANE = "Six signals were turned into the plane of each push."
#: Sds of measurement errors, such as `moment_sd`, have the unit of their quantity.
NAMES = {**QUANTITIES, **{f"{name}_sd": kind for name, kind in QUANTITIES.items()}}


def unit_factor(text: str, kind: str) -> float | None:
    """SI units in a unit as people write it; None where it is none of that kind."""
    plain = text
    for written, sign in _WRITTEN.items():
        plain = re.sub(written, sign, plain, flags=re.IGNORECASE)
    for unit, factor in _UNITS[kind].items():
        if plain.lower() == unit:
            return factor
        if kind not in ("angle", "angular_velocity") and plain[1:].lower() == unit:
            scale = PREFIX.get(plain[0])
            return None if scale is None else scale * factor
    return None


def find_columns(
    header: list[str], columns: Mapping[str, str] | None, units: Mapping[str, str] | None
) -> dict[str, tuple[str, float, bool]]:
    """For each quantity present: its column, SI units in the column's unit, and if that was said.

    A quantity stands in the column that `columns` names for it, or in one of its own name with a
    unit as suffix or none.
    """
    for argument, name in ((columns, "columns"), (units, "units")):
        if argument is not None and not isinstance(argument, Mapping):
            raise ValueError(
                f"{name} must be a mapping, got {_checks.shown(argument)}; write "
                f'{name}={{"moment": "{"M" if name == "columns" else "uN m"}"}}, say.'
            )
        for key in argument or {}:
            _checks.one_of(f"{name} key", key, NAMES)
    found: dict[str, tuple[str, float, bool]] = {}
    for quantity, column in (columns or {}).items():
        if column not in header:
            raise ValueError(
                f"The table has no column {column!r}, mapped from {quantity!r}; it has "
                f"{_checks.listed(header, 8)}."
            )
        found[quantity] = _of(quantity, column, column, units)
    taken = set((columns or {}).values())
    for column in header:
        if column in taken:
            continue
        # The longest name first, so that `moment_rate` is no moment in a unit "rate".
        for quantity in sorted(NAMES, key=len, reverse=True):
            unit = r"[_ (\[]+(.+?)[)\]]?"
            rest = re.fullmatch(rf"{quantity}(?:{unit})?", column)
            if rest is None and quantity.endswith("_sd"):
                rest = re.fullmatch(rf"{quantity.removesuffix('_sd')}{unit}_sd", column)
            if rest is None or (rest[1] and unit_factor(rest[1], NAMES[quantity]) is None):
                continue
            if quantity in (columns or {}):
                break
            if quantity in found:
                raise ValueError(
                    f"Two columns hold {quantity}, {found[quantity][0]!r} and {column!r}; say "
                    f'which with columns={{"{quantity}": "{column}"}}.'
                )
            found[quantity] = _of(quantity, column, rest[1] or "", units)
            break
    for quantity, (column, _, said) in found.items():
        of = found.get(quantity.removesuffix("_sd"))
        if of is not None and not said:
            found[quantity] = (column, *of[1:])
    for quantity in units or {}:
        if quantity not in found:
            raise ValueError(
                f"A unit was given for {quantity}, which the table has no column of; map one "
                f'with columns={{"{quantity}": …}}.'
            )
    return found


def _of(
    quantity: str, column: str, text: str, units: Mapping[str, str] | None
) -> tuple[str, float, bool]:
    kind = NAMES[quantity]
    given = (units or {}).get(quantity)
    if given is not None:
        factor = unit_factor(str(given), kind)
        if factor is None:
            known = ", ".join(
                {
                    "moment": ("N m", "uN m", "mN mm"),
                    "force": ("N", "mN", "uN"),
                    "moment_rate": ("N m/s", "uN m/s"),
                }.get(kind, tuple(_UNITS[kind]))
            )
            raise ValueError(f"{given!r} is no unit of {quantity}; write one such as {known}.")
        return column, factor, True
    # What stands behind our name, or the longest suffix of another's; there a letter alone before
    # a unit is no prefix: m_Nm is a moment m in N m.
    words = re.split(r"[_ (\[\])]+", text.strip(" )]"))
    last = len(words) - 1
    suffixes = [
        "_".join(words[i:]) for i in range(1, last + 1) if i == last or words[i] not in PREFIX
    ]
    for suffix in suffixes if text == column else [text]:
        factor = unit_factor(suffix, kind) if suffix else None
        if factor is not None:
            return column, factor, True
    return column, 1.0, False


def likely_prefix(times: float, factor: float) -> str:
    """The prefix of a unit with which numbers, now `times` too large, would be as large as usual.

    `factor` is the SI units in the unit in which they were read.
    """
    return min(
        (p for p in PREFIX if p != "k"), key=lambda p: abs(np.log(times * PREFIX[p] / factor))
    )


def values_of(table: pd.DataFrame, column: str) -> Array:
    """A column as numbers, NaN where a cell holds none."""
    series = table[column]
    if getattr(series.dtype, "kind", "O") in "bcmM":
        raise ValueError(f"The column {column!r} holds {series.dtype}; write numbers.")
    out = pd.to_numeric(series, errors="coerce").to_numpy(dtype=float)
    text = series.notna().to_numpy() & np.isnan(out)
    blank = series.astype(str).str.strip().str.lower().isin(("", "nan", "na", "none"))
    text &= ~blank.to_numpy()
    if text.sum() * 2 > len(out):
        raise ValueError(
            f"The column {column!r} holds text such as {series[text].iloc[0]!r}; "
            f"{as_number(series[text].iloc[0])}."
        )
    return out


def planar(si: dict[str, Array], notes: list[str]) -> dict[str, Array]:
    """The signals in the plane of the push from the six of space, where a table has those.

    x is along the base tangent outwards, so that compression is −force_x; a straight whisker bends
    in the plane of the transverse force, whatever its azimuth.
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
    # Moment = contact × force: the force across the base, along the push.
    parts: dict[str, list[tuple[str, Any]]] = {
        "moment": [("moment_y", y), ("moment_z", z)], "axial_force": [("force_x", -1.0)],
        "transverse_force": [("force_y", z), ("force_z", -y)],
    }  # fmt: skip
    for name, terms in parts.items():
        if {part for part, _ in terms} <= set(si):
            out[name] = np.sum([share * si[part] for part, share in terms], axis=0)
        if {f"{part}_sd" for part, _ in terms} <= set(si):
            squares = [(share * si[f"{part}_sd"]) ** 2 for part, share in terms]
            out[f"{name}_sd"] = np.sqrt(np.sum(squares, axis=0))
    notes.append(IN_PLANE)
    return out


def one_side(si: dict[str, Array], touch: Any, notes: list[str]) -> Array:
    """Turn every row to positive moments in place; the side of each row, 1 or −1.

    Moment, transverse force and angle change sign with the side.
    """
    turned = ("moment", "moment_rate", "deflection_angle", "transverse_force")
    lead = next((n for n in turned if n in si), None)
    if lead is None:
        return np.ones(len(next(iter(si.values()), [])))
    side = sides_of(si[lead], si.get(f"{lead}_sd"), touch)
    if np.any(side < 0):
        notes.append(
            f"{int((side < 0).sum())} of {side.size} rows are pushed to the other side ({lead} "
            "below zero): mirrored."
        )
    si |= {name: si[name] * side for name in turned if name in si}
    if "angular_velocity" in si:
        si["angular_velocity"] = np.abs(si["angular_velocity"])
    return side


def sides_of(lead: Array, sd: Array | None, touch: Any, within: float = 4.0) -> Array:
    """The side to which each row is pushed, 1 or −1: the sign of its moment.

    A touch has one side. Rows of it whose sign may be that of their measurement error, `within` so
    many sds of zero (one in 30 000 are farther), are on the side that all its rows together are
    likelier to be on, by Σ ±z²/2.
    """
    side = np.where(lead < 0, -1.0, 1.0)
    if sd is None or touch is None:
        return side
    with np.errstate(divide="ignore", invalid="ignore"):
        z = np.nan_to_num(lead / np.abs(sd), posinf=0.0, neginf=0.0)
    names = pd.Series(touch, dtype=object)
    likelier = pd.Series(z * np.abs(z)).groupby(names).transform("sum").fillna(0.0).to_numpy()
    return np.where((np.abs(z) < within) & (likelier != 0), np.sign(likelier), side)


def read_contacts(
    table: Any, columns: Mapping[str, str] | None, units: Mapping[str, str] | None
) -> tuple[pd.DataFrame, dict[str, Array], dict[str, tuple[str, float, bool]]]:
    """The table, its known quantities in SI, and where each of them was found."""
    raw = _table(table).rename(columns=str)
    if not raw.columns.is_unique:
        twice = raw.columns[raw.columns.duplicated()][0]
        raise ValueError(f"There are two columns {twice!r}; give each its own name.")
    found = find_columns(list(raw.columns), columns, units)
    return raw, {q: values_of(raw, c) * factor for q, (c, factor, _) in found.items()}, found


def _table(table: Any) -> pd.DataFrame:
    if isinstance(table, pd.DataFrame):
        raw = table
        if raw.columns.nlevels > 1:
            raise ValueError("The table's columns have several levels; give each column one name.")
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
