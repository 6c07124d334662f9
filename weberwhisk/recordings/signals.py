"""Signals at the base from tracked shapes, with the errors that follow from tracking."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.stats import chi2

from .._util import checks
from .._util.refusals import Advice, Refusal, argument, call, named
from .._util.values import Array
from ..mechanics import Profile
from ..whisker import Whisker
from .columns import AT_REST, COMMON, CORRELATION, FROM_SHAPE
from .shapes import (
    BENT,
    FREE,
    NAMES,
    NEAR_BASE,
    PLACED,
    Extra,
    Points,
    Shapes,
    contacts_of,
    free_frames,
    in_plane,
    median_shape,
    points_of,
    pole_of,
)
from .trackers import identified_by

#: Signals of a shape, in the order of `Shapes.signals`.
_SIGNALS = ("moment", "axial_force", "transverse_force", "shape_distance", "deflection_angle")


def tracked_signals(
    tracking: pd.DataFrame, whisker: Whisker | Profile, *, pixels_per_mm: float | None = None,
    frame_rate: float | None = None, identity: Any = None, pole: ArrayLike | None = None,
    pole_radius_px: float = 0.0, pole_sd_px: float = 0.5,
    contact: str | Sequence[Any] | None = None, false_alarms: float = 1e-3,
    friction_angle: float = 0.0, friction_sd: float = 0.0,
) -> pd.DataFrame:  # fmt: skip
    """Moment, forces and distance of each contact, from the tracked shape of one whisker.

    Parameters
    ----------
    tracking : DataFrame
        As from `read_tracking`: one row per frame, with points `x` and `y` from the follicle.
    whisker : Whisker or Profile
        Gives length, radii and modulus; the shape at rest is fitted to the frames without contact.
    pixels_per_mm, frame_rate : float
        Of the video; by default those given to `read_tracking`.
    identity
        The whisker, by the table's `name`; by `label` where none is named, by `whisker` where
        none is labelled.
    pole : (x, y) or array (rows, 2), optional
        Centre of a pole of radius `pole_radius_px`, or with radius 0 the contact itself, in pixels
        (x, y, z for points in space); one row per row of `tracking` if it moves. By default the
        contact is the point beyond which the whisker has its shape at rest.
    pole_radius_px, pole_sd_px : float
        Radius of the pole, and the sd of its position.
    contact : str or sequence, optional
        A column, or one value per row, that is true in contact. By default, where the shape
        differs from that of most frames.
    false_alarms : float
        Accepted share of frames without contact that are classified as contacts.
    friction_angle, friction_sd : float
        Friction angle as for `press`, and its sd, rad.

    Returns
    -------
    DataFrame
        One row per frame of the whisker, with its index: `frame`, `time_s`, `contact`, and for
        contacts `moment_uNm`, `axial_force_uN`, `transverse_force_uN` and `deflection_angle_deg`,
        their sds (`moment_sd_uNm` and so on), the correlation `moment_transverse_corr`, and
        `distance_common_sd_mm`, the error that all frames share through the shape at rest;
        `shape_distance_mm` and `shape_distance_sd_mm`, from the shape alone; with a pole also
        `pole_distance_mm` and `pole_distance_sd_mm`; `misfit`, χ² per degree of freedom; `side`, 1
        for a push towards +y of a whisker along +x (to the right in an image, whose y runs down),
        −1 for the other side. Sds include tracking errors across and along the whisker, but no
        receptor noise: see ``locate(…, noise=)``. The curvature at rest is `rest_curvature_per_m`
        + `rest_curvature_rate_per_m2` s. ``attrs["notes"]`` reports results and checks.

    Raises
    ------
    ValueError
        For a missing scale, frame rate, identity or points, fewer than ten frames without contact,
        and a scale at which the tracked whisker is longer than `whisker`.

    Notes
    -----
    M = EI·Δκ at the base (Clack et al. 2012; Pammer et al. 2013), for the planar beam under one
    force that best fits all points; points in space are projected on the plane that they sweep.
    Force and moment are proportional to one stiffness, so the modulus does not affect the distance,
    and `locate` takes it as known. The noise of points follows from their scatter about the fits,
    or from the scatter of curvature between free frames where that implies more.

    Examples
    --------
    >>> import weberwhisk as ww
    >>> w = ww.Whisker.from_identity("C2", curved=True)
    >>> video = ww.read_tracking("C2.whiskers", pixels_per_mm=20, frame_rate=500)  # doctest: +SKIP
    >>> ww.locate(ww.tracked_signals(video, w), w)  # doctest: +SKIP
    """
    checks.kind("whisker", whisker, "a Whisker or Profile", "stiffness", "write ww.Whisker(…)")
    profile = Profile.of(whisker)
    index: Any = getattr(tracking, "index", None)
    if isinstance(tracking, pd.DataFrame):
        tracking = tracking.reset_index(drop=True)  # labels may repeat
    table = _one_whisker(tracking, identity)
    ppm, rate = _scales(tracking, pixels_per_mm, frame_rate)
    for name, value in (("pole_radius_px", pole_radius_px), ("friction_sd", friction_sd)):
        checks.non_negative_number(name, value, "give 0 for none")
    pole_sd_px = checks.positive_number("pole_sd_px", pole_sd_px, "give pixels, 0.5 say")
    friction_angle = checks.number("friction_angle", friction_angle, "give radians, 0 for none")
    if abs(friction_angle) > np.pi / 6 + 1e-12:
        raise Refusal(
            named("friction_angle") + " must be up to 30° either way",
            f"{friction_angle:g} rad",
            f"write radians, such as np.radians({friction_angle:g}) of degrees",
        )
    if not 0 < checks.positive_number("false_alarms", false_alarms, "give 0.001, say") < 1:
        raise Refusal("false_alarms must be below 1", f"{false_alarms:g}", "write 0.001, say")
    length = float(profile.whisker.length)
    unit = 1e3 * length * ppm  # pixels
    plane = in_plane(table, 0.05 * unit)
    points = points_of(table, plane, unit)
    reach = float(np.median(points.arc[:, -1]))
    if not 0.1 < reach < 1.1:
        raise Refusal(
            f"The tracked whisker is {reach * length * 1e3:.3g} mm long at {ppm:g} "
            f"pixels_per_mm, and whisker is {length * 1e3:.3g} mm: a tenth of it is needed, "
            "and no more than it is long",
            remedy="correct one of them",
        )
    where = None if pole is None else pole_of(pole, tracking, table, plane) / unit
    shapes = Shapes(profile, reach)
    extra = Extra(float(friction_angle), max(float(friction_sd), 1e-9))

    # Shape at rest: fit every frame by itself, then take the median of frames without contact.
    start = np.zeros((len(table), len(NAMES)))
    start[:, 0] = np.angle(points.at[:, 2] - points.base)
    start[:, 2] = shapes.place(0.5)
    start[:, 4] = friction_angle
    fitted, _, points = shapes.fit(start, points, extra, FREE)
    bends = fitted[:, 5:8]
    given = None if contact is None else contacts_of(tracking, table, contact)
    free = free_frames(bends, false_alarms) if given is None else ~given
    if free.sum() < 10:
        raise Refusal(
            "The shape at rest takes ten frames without contact",
            int(free.sum()),
            "give a longer part of the video, or other contacts",
        )
    noise = _noise(shapes, fitted[free], points.take(free), extra)
    slips = _slips(fitted[free], points.take(free))
    extra = extra._replace(base_sd=max(noise, slips))
    points = points._replace(weight=points.weight / noise)
    rest = median_shape(bends[free])
    shared = np.cov(bends[free].T) * np.pi / 2 / free.sum()
    touched = np.flatnonzero(~free)
    notes = [f"{free.sum()} of {len(table)} frames are free; the points' noise is "
             f"{noise * unit:.2g} px."]  # fmt: skip
    if given is None:
        notes[0] += f" Contacts: where the shape differs, {100 * false_alarms:g} % false alarms."
    if slips > 2 * noise:
        notes.append(
            f"The first points, from which distances are, are {1e3 * length * slips:.2g} mm (sd) "
            "off along the whisker, as its tracked length tells: counted in the errors."
        )
    out = table[["frame"]].copy()
    out["time_s"] = table["frame"] / rate
    out["contact"] = ~free
    out["signals_from"] = FROM_SHAPE
    # The straight line k₀ + k₁ s closest to the quadratic curvature.
    out[AT_REST[0]] = (rest[0] - rest[2] / 6) / length
    out[AT_REST[1]] = (rest[1] + rest[2]) / length**2
    out["friction_angle_deg"] = np.degrees(friction_angle)
    if touched.size:
        touching, first = points.take(touched), fitted[touched].copy()
        first[:, 5:8] = rest
        alone = _bent(shapes, first, bends[touched], touching, extra)
        columns, in_contact = _columns(shapes, alone, extra, shared), alone
        if where is not None:
            where = where[touched]
            extra = extra._replace(
                pole=where, pole_radius=pole_radius_px / unit, pole_sd=pole_sd_px / unit
            )
            near = np.abs(touching.at - where[:, None]).argmin(axis=1)
            first = shapes.started(first, bends[touched], touching.arc[np.arange(len(near)), near])
            first, _, placed = shapes.fit(first, touching, extra, PLACED)
            in_contact = shapes.fit(first, placed, extra, BENT)
            by_pole = _columns(shapes, in_contact, extra, shared)
            by_pole["pole_distance"] = by_pole.pop("shape_distance")
            columns = columns | by_pole
        notes += _check(shapes, in_contact, shared, columns)
    else:
        names = (*_SIGNALS, *([] if where is None else ["pole_distance"]))
        columns = {name: (np.zeros(0), np.zeros(0)) for name in names}
        columns |= {"corr": np.zeros(0), "common": np.zeros(0), "misfit": np.zeros(0)}
    measured = _in_units(columns, profile.whisker).set_axis(touched)
    measured = measured.reindex(np.arange(len(out))).set_axis(out.index)
    out = pd.concat([out, measured], axis=1).set_axis(index[table.index])
    out.attrs = {"notes": tuple(notes)}
    return out


def _one_whisker(tracking: pd.DataFrame, identity: Any) -> pd.DataFrame:
    if not isinstance(tracking, pd.DataFrame) or not {"frame", "x", "y"} <= set(tracking):
        raise Refusal(
            "tracking needs the points x and y of each frame, as of a .whiskers file or a "
            "table of points",
            remedy="measurements alone do not say the shape",
        )
    by = identified_by(tracking)
    every = tracking
    whiskers = [value for value in tracking[by].unique().tolist() if value != ""]
    whiskers = whiskers if by == "name" else sorted(whiskers)
    if identity is None and len(whiskers) > 1 and tracking["frame"].duplicated().any():
        raise Refusal(
            f"Several whiskers were tracked ({by} {checks.listed(map(str, whiskers), 6)})",
            remedy=(
                "say which with "
                + argument("identity", whiskers[0], of="tracked_signals")
                + ", or leave out the others with "
                + call("read_tracking", argument("shortest_px", ...), argument("follicles", ...))
            ),
        )
    if identity is None and by == "name" and len(whiskers) == 1:
        identity = whiskers[0]
    if identity is not None:
        identity = next((k for k in whiskers if str(k) == str(identity)), identity)
        if identity not in whiskers:
            raise Refusal(
                f"There is no {by} {identity!r}",
                remedy=f"there are {checks.listed(map(str, whiskers), 6)}",
            )
        tracking = tracking[tracking[by] == identity]
        if by == "whisker" and (every["label"] < 0).all():
            _refuse_exchanged(every, identity)
    twice = tracking.loc[tracking["frame"].duplicated(), "frame"]
    if len(twice):
        raise Refusal(
            f"Frame {twice.iloc[0]} has two rows of one {by}",
            remedy=(
                "leave out fur with "
                + call("read_tracking", argument("shortest_px", ...), argument("follicles", ...))
                + ", or rows that repeat"
            ),
        )
    enough = tracking["x"].map(len) >= 6
    if not enough.any():
        raise Refusal("A shape takes six points or more in a frame", remedy="track more points")
    return tracking[enough]


def _refuse_exchanged(tracking: pd.DataFrame, whisker: Any) -> None:
    """Refuse numbers of segments within frames that are not those of one whisker throughout."""
    ends = tracking[["follicle_x", "follicle_y"]]
    chosen = tracking["whisker"] == whisker
    off = np.hypot(*(ends - ends[chosen].median()).to_numpy(dtype=float).T)
    nearest = pd.Series(off, tracking.index).groupby(tracking["frame"]).transform("min")
    frames = tracking.loc[chosen, "frame"]
    several = frames.isin(tracking.loc[~chosen, "frame"]).to_numpy()
    exchanged = (off > nearest)[chosen] & several
    if exchanged.sum() > 0.1 * max(several.sum(), 5):
        raise Refusal(
            f"Whisker {whisker} is not one whisker throughout: in {int(exchanged.sum())} of "
            f"{len(frames)} frames another starts nearer to where it usually does",
            remedy=(
                "leave out the others by "
                + call("read_tracking", argument("follicles", ...))
                + ", the box that it starts in, or track whiskers in the tracker"
            ),
        )


def _scales(tracking: pd.DataFrame, ppm: float | None, rate: float | None) -> tuple[float, float]:
    given = {"pixels_per_mm": ppm, "frame_rate": rate}
    out: dict[str, Any] = {n: tracking.attrs.get(n) if v is None else v for n, v in given.items()}
    missing = [name for name, value in out.items() if value is None]
    if missing:
        usual = {"pixels_per_mm": 20, "frame_rate": 500}
        written = Advice.joined(", ", [argument(name, usual[name]) for name in missing])
        raise Refusal(f"No file tells {' or '.join(missing)}", remedy="write " + written + ", say")
    for name, value in out.items():
        checks.positive_number(name, value, "give a number above zero")
    return float(out["pixels_per_mm"]), float(out["frame_rate"])


def _slips(fitted: Array, points: Points) -> float:
    """Sd of the error of first points along the whisker, lengths; 0 where not significant.

    An error that moves the first point outwards shortens the whisker by as much. Movement of the
    follicle, or loss of the tip, changes only one of the two. So the variance of the error is minus
    their covariance (clipped at 4 sd), if that exceeds three standard errors.
    """
    base = points.base - np.median(points.base.real) - 1j * np.median(points.base.imag)
    place = np.real(base * np.exp(-1j * fitted[:, 0]))
    both = np.stack([place, np.abs(points.at[:, -1] - points.base)])
    off = both - np.median(both, axis=1, keepdims=True)
    most = 4 * 1.4826 * np.median(np.abs(off), axis=1, keepdims=True)
    (own_place, shared), (_, own_length) = np.cov(np.clip(off, -most, most))
    error = np.sqrt((own_place * own_length + shared**2) / len(base))
    return float(np.sqrt(-shared)) if -shared > 3 * error else 0.0


def _noise(shapes: Shapes, fitted: Array, points: Points, extra: Extra) -> float:
    """Sd of a point, lengths: from residuals or from the scatter of curvature, if larger."""
    left = (shapes._residuals(fitted, points, extra)[0][:, : points.at.shape[1]] ** 2).sum(axis=1)
    degrees = (points.weight > 0).sum(axis=1) - len(FREE)
    points_sd = float(np.sqrt(np.median(left / chi2.median(degrees))))
    covariance = shapes.covariance(fitted, points, extra, FREE)[0]
    bends = fitted[:, 5:8] - median_shape(fitted[:, 5:8])
    far = np.einsum("ni,nij,nj->n", bends, np.linalg.inv(covariance[:, 2:, 2:]), bends)
    return max(points_sd, float(np.sqrt(np.median(far) / chi2.median(3))))


Fit = tuple[Array, Array, Points]


def _bent(shapes: Shapes, p: Array, bends: Array, points: Points, extra: Extra) -> Fit:
    """Fits started from the best of several places of the contact."""
    places = np.linspace(0.15, 0.95, 9) * shapes.reach
    out: list[Fit] = []
    for part in np.array_split(np.arange(len(p)), 1 + len(p) // 256):  # to limit memory
        every = np.tile(part, len(places))
        tried = shapes.started(p[every], bends[every], np.repeat(places, len(part)))
        tried, cost, moved = shapes.fit(tried, points.take(every), extra, PLACED, rounds=10)
        best = cost.reshape(len(places), -1).argmin(axis=0) * len(part) + np.arange(len(part))
        out.append(shapes.fit(tried[best], moved.take(best), extra, BENT))
    p, cost = (np.concatenate([fit[i] for fit in out]) for i in (0, 1))
    moved = Points(*(np.concatenate(v) for v in zip(*(fit[2] for fit in out), strict=True)))
    # A fit may fail (1 in 1900: 3 mm off, with a small sd): repeat it from the nearest frame's.
    failed = cost > 10 * (points.weight > 0).sum(axis=1)
    left, good = np.flatnonzero(failed), np.flatnonzero(~failed)
    if left.size and good.size:
        start = p[left]
        start[:, 2:5] = p[good[np.abs(left[:, None] - good).argmin(axis=1)], 2:5]
        again = shapes.fit(start, points.take(left), extra, BENT)
        less = again[1] < cost[left]
        at = left[less]
        p[at], cost[at], moved.arc[at] = again[0][less], again[1][less], again[2].arc[less]
    return p, cost, moved


def _columns(shapes: Shapes, fit: Fit, extra: Extra, shared: Array) -> dict[str, Any]:
    """Signals in units of the whisker and their sds, by name."""
    p, cost, points = fit
    free = (*BENT, 4) if extra.friction_sd > 1e-8 else BENT
    _, covariance, common = shapes.covariance(p, points, extra, free, shared)
    values = shapes.signals(p)
    sd = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    out: dict[str, Any] = {n: (values[:, i], sd[:, i]) for i, n in enumerate(_SIGNALS)}
    out["common"] = np.sqrt(common[:, 3, 3])
    out["corr"] = covariance[:, 0, 2] / (sd[:, 0] * sd[:, 2])
    degrees = (points.weight > 0).sum(axis=1) + 2 * (extra.pole is not None) - len(free)
    out["misfit"] = cost / np.maximum(degrees, 1)
    return out


def _check(shapes: Shapes, fit: Fit, shared: Array, columns: dict[str, Any]) -> list[str]:
    """Notes that compare contact × force with EI·Δκ at the base, and the two distances."""
    p, _, points = fit
    contact_arc = shapes.contact_arc(p)
    near = points._replace(weight=np.where(points.arc < contact_arc[:, None], points.weight, 0.0))
    start = p.copy()
    start[:, 3] = 0.0
    start[:, 8], start[:, 9] = columns["moment"][0], -columns["moment"][0] / contact_arc
    extra = Extra(p[0, 4])
    fitted, _, near = shapes.fit(start, near, extra, NEAR_BASE)
    covariance = shapes.covariance(fitted, near, extra, NEAR_BASE)[0]
    error = covariance[:, 2, 2]
    clear = columns["moment"][0] ** 2 > 25 * error
    if clear.sum() < 5:
        notes = ["EI·Δκ at the base is too uncertain to check contact × force by."]
    else:
        bent, crossed = fitted[clear, 8], columns["moment"][0][clear]
        weight = 1 / (error + columns["moment"][1] ** 2)[clear]
        slope = float((weight * bent * crossed).sum() / (weight * crossed**2).sum())
        se = float((weight * crossed**2).sum() ** -0.5)
        correlation = float(np.corrcoef(bent, crossed)[0, 1])
        # A correlation of 1 attenuated by noise.
        least = 0.97 * float((1 + error[clear].mean() / np.var(crossed)) ** -0.5)
        # Fisher's transformation: arctanh r has an sd of (n − 3)^−½.
        least = float(np.tanh(np.arctanh(least) - 3 / np.sqrt(clear.sum() - 3)))
        good = abs(slope - 1) < 0.05 + 3 * se and correlation > least
        verdict = "agree" if good else "DO NOT agree; check scale, whisker, pole and friction"
        notes = [f"EI·Δκ at the base and contact × force {verdict}: slope {slope:.3g} ± {se:.2g}, "
                 f"r = {correlation:.3f}."]  # fmt: skip
    misfit = float(np.median(columns["misfit"]))
    if misfit > 2:
        notes.append(
            f"The bent whisker does not fit the points: χ² is {misfit:.2g} times what noise gives."
        )
    if "pole_distance" in columns:
        (r, sd), (pole_distance, pole_sd) = columns["shape_distance"], columns["pole_distance"]
        off = (r - pole_distance) / np.hypot(sd, pole_sd)
        beyond = 1e3 * float(shapes.profile.whisker.length) * float(np.median(r - pole_distance))
        notes.append(
            f"The shape alone puts contacts {beyond:.2g} mm beyond the pole (median), "
            f"{np.median(np.abs(off)):.2g} sd off (0.67 expected)."
        )
    return notes


def _in_units(columns: dict[str, Any], whisker: Whisker) -> pd.DataFrame:
    """The signals of shapes in the units of the table, each followed by its sd."""
    force = ("uN", 1e6 * whisker.force_scale)
    length = ("mm", 1e3 * whisker.length)
    units: dict[str, tuple[str, Any]] = {
        "moment": ("uNm", 1e6 * whisker.moment_scale), "axial_force": force,
        "transverse_force": force, "shape_distance": length,
        "deflection_angle": ("deg", 180 / np.pi), "pole_distance": length,
    }  # fmt: skip
    out = {}
    for name, (unit, factor) in units.items():
        if name in columns:
            out[f"{name}_{unit}"], out[f"{name}_sd_{unit}"] = (factor * v for v in columns[name])
    out |= {CORRELATION: columns["corr"], COMMON: length[1] * columns["common"]}
    out["misfit"] = columns["misfit"]
    return pd.DataFrame(out | {"side": np.sign(columns["moment"][0])})
