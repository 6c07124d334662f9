"""Length, direction and curvature of tracked whiskers, in one convention for all files."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from .._util.values import Array, Flags, counted

__all__ = ["angle_and_curvature", "of_points", "segment", "with_angles", "with_lengths"]

#: Names of a length in trackers' tables, in the order in which they are tried.
LENGTHS = ("length_px", "length", "pixel_length", "pixlen")


def segment(*axes: Array) -> dict[str, Any]:
    """Columns of a segment whose points run from follicle to tip: x, y and perhaps z."""
    x, y = axes[:2]
    return {
        **dict(zip("xyz", axes, strict=False)), "follicle_x": x[0], "follicle_y": y[0],
        "tip_x": x[-1], "tip_y": y[-1],
        "length_px": float(np.linalg.norm(np.diff(axes), axis=0).sum()),
    }  # fmt: skip


def angle_and_curvature(x: Any, y: Any) -> tuple[float, float]:
    """Direction at the first of n points (degrees from +x to +y) and mean curvature (1/px).

    From a least-squares parabola in arc length; NaN for fewer than three points.
    """
    z = np.asarray(x) + 1j * np.asarray(y)
    if len(z) < 3:
        return np.nan, np.nan
    arc = np.append(0.0, np.cumsum(np.abs(np.diff(z))))
    bend, start, _ = np.polyfit(arc, z, 2, full=True)[0]  # full: no warning if points coincide
    turn = np.angle(1 + 2 * bend * arc[-1] / start)
    return float(np.degrees(np.angle(start))), float(turn / arc[-1])


def of_points(table: pd.DataFrame) -> pd.DataFrame:
    """The table with angle and curvature by the points where there are three or more in a plane."""
    if "x" not in table or "z" in table:
        return table
    by_row = [angle_and_curvature(*v) for v in table[["x", "y"]].to_numpy()]
    values = pd.DataFrame(
        np.reshape(by_row, (-1, 2)), table.index, ["angle_deg", "curvature_per_px"], dtype=float
    )
    out = table.copy()
    for name in values:
        out[name] = values[name].fillna(table[name])
    return out


# -- what a tracker wrote --------------------------------------------------------------------------


def with_lengths(table: pd.DataFrame, notes: list[str]) -> pd.DataFrame:
    """The table with `length_px` by its points, or a length of the file that its chords bear out.

    Trackers write lengths that are 0, or numbers of points, or in millimetres, under the same
    names; none is shorter than the chord from follicle to tip, or much longer.
    """
    with np.errstate(all="ignore"):
        chord = np.hypot(*(
            (table[f"tip_{a}"] - table[f"follicle_{a}"]).to_numpy(float) for a in "xy"
        ))  # fmt: skip
    arc = _arcs(table)
    by_points = bool(np.isfinite(arc).any())
    least = np.where(np.isfinite(arc), arc, chord)
    checked = np.isfinite(least)
    written = {name: _numbers(table[name]) for name in LENGTHS if name in table}
    by = "their points" if by_points else "the distance from follicle to tip"
    best, source = least, ""
    for name, values in written.items():
        if not checked.any():
            best, source = values, name
            notes.append(f"{name} of the file could not be checked: no row has follicle and tip.")
            break
        most = (1.05 if by_points else 2.0) * least + 5
        with np.errstate(invalid="ignore"):
            good = (values >= 0.97 * least - 2) & (values <= most)
        if good[checked].mean() > 0.7:
            source = name
            best = np.where(np.isfinite(arc), arc, np.where(good | ~checked, values, least))
            if (wrong := int((~good & checked).sum())) and not by_points:
                notes.append(
                    f"{name} of {counted(wrong, 'whisker')} is no length in pixels: length_px of "
                    f"these is {by}."
                )
            break
    if written and not source:
        name, values = next(iter(written.items()))
        middle = np.nanmedian(values) if np.isfinite(values).any() else np.nan
        notes.append(
            f"{' and '.join(written)} of the file {'is' if len(written) == 1 else 'are'} no length "
            f"in pixels (median {middle:.3g} where whiskers are {np.nanmedian(least):.3g} px by "
            f"{by}): length_px is by {by}."
        )
    return table.drop(columns=list(written)).assign(length_px=best)


def _numbers(column: pd.Series) -> Array:
    return pd.to_numeric(column, errors="coerce").to_numpy(dtype=float)


def _arcs(table: pd.DataFrame) -> Array:
    """Lengths along the points of each row; NaN of rows with fewer than two."""
    axes = [a for a in "xyz" if a in table]
    if not {"x", "y"} <= {*axes}:
        return np.full(len(table), np.nan)
    return np.array([
        np.linalg.norm(np.diff(np.stack([np.asarray(v, dtype=float) for v in row])), axis=0).sum()
        if len(row[0]) > 1 else np.nan
        for row in table[axes].to_numpy()
    ])  # fmt: skip


def with_angles(table: pd.DataFrame, notes: list[str]) -> pd.DataFrame:
    """The table with `angle_deg` from +x to +y, whatever axis the tracker counted from.

    Whisk counts from +y to +x where the face is at a side of the image: `from_y` says so where the
    file does; else the axis is that which the chords bear out.
    """
    angle = _numbers(table["angle_deg"])
    if "from_y" in table:
        from_y = table["from_y"].to_numpy(dtype=float)
    else:
        from_y = np.full(len(table), np.nan)
    table = table.drop(columns=["from_y"], errors="ignore")
    if not np.isfinite(angle).any():
        return table
    by_chord = _start(table)
    checked = np.isfinite(angle) & np.isfinite(by_chord)
    unsaid = checked & np.isnan(from_y)
    if unsaid.any():
        off = [np.median(np.abs(_turn(a - by_chord))[unsaid]) for a in (angle, 90 - angle)]
        from_y[np.isnan(from_y)] = float(off[1] < off[0])
        if min(off) > 20:  # of no axis that is known
            notes.append(
                "The file's angles agree with no axis of the image: angle_deg is the direction "
                "from follicle to tip, turned by the curvature."
            )
            return table.assign(angle_deg=np.where(checked, by_chord, np.nan))
    elif np.isnan(from_y).any():
        notes.append(
            "angle_deg is as in the file: without the places of follicle and tip the axis that it "
            "is counted from could not be checked."
        )
    turned = np.where(from_y == 1, 90 - angle, angle)
    if (from_y == 1).any():
        notes.append(
            "The file counts angles from +y to +x, as Whisk does of faces at a side; angle_deg is "
            "from +x to +y."
        )
    return table.assign(angle_deg=_turn(turned))


def _turn(degrees: Any) -> Array:
    """Angles as they are from above −180° to 180°."""
    return np.asarray(180 - (180 - np.asarray(degrees, dtype=float)) % 360)


def _start(table: pd.DataFrame) -> Array:
    """Direction at the follicle of arcs with the chord and mean curvature of each row, degrees."""
    x, y = ((table[f"tip_{a}"] - table[f"follicle_{a}"]).to_numpy(float) for a in "xy")
    total = np.nan_to_num(_total_turn(table))
    return np.asarray(np.degrees(np.arctan2(y, x)) - total / 2)


def _total_turn(table: pd.DataFrame) -> Array:
    """Turn from follicle to tip, degrees; NaN without length or curvature."""
    with np.errstate(all="ignore"):
        turn = np.degrees(_numbers(table["curvature_per_px"]) * _numbers(table["length_px"]))
    return np.where(np.abs(turn) < 720, turn, np.nan)


def seen_from_tip(table: pd.DataFrame, turn: Flags) -> pd.DataFrame:
    """The table with angle and curvature of rows `turn` as seen from the other end, as arcs."""
    total = np.nan_to_num(_total_turn(table))
    angle, curvature = (_numbers(table[n]) for n in ("angle_deg", "curvature_per_px"))
    return table.assign(
        angle_deg=np.where(turn, _turn(angle + total + 180), angle),
        curvature_per_px=np.where(turn, -curvature, curvature),
    )
