"""Calibration by taps at known distances: stiffness, taper, hinge, gain, and the sensor's noise."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pandas as pd
from scipy.optimize import least_squares, minimize
from scipy.special import expit, ndtri
from scipy.stats import f as f_distribution

from .. import domain
from .._util import checks
from .._util.importance import SobolPoints, adapted_draws
from .._util.refusals import Advice, Refusal, argument
from .._util.values import Array, Index, Shown, weighted_quantiles
from ..cues import Cue
from ..cues.protocol import Encoded
from ..mechanics.contact import Outcome
from ..receptors import Seed, Weber
from ..whisker import Whisker
from .columns import likely_prefix, read_contacts
from .mixture import curvature_at

__all__ = ["Calibration", "HingedTap", "averaged", "calibrate"]

#: Least Weber fraction of a slope: without noise there would be no likelihood.
LEAST = 1e-4
#: Normal priors (mean, sd): logit of length over apex distance; ln of hinge over length; logit of
#: the misfit of one distance; ln of k.
BELIEFS = np.array([[1.5, 2.0], [-3.0, 2.0], [-4.5, 1.5], [-3.0, 1.5]])


@dataclass(frozen=True, eq=False, repr=False)
class HingedTap(Cue):
    """The slope of a light tap on a whisker whose base is a rotational spring (a hinge).

    Whisker and hinge are in series: slope = gain·3EI₀ω/(1/(1/r − 1/A) + h), equation (2.1) with
    the compliance of the hinge, h = 3EI₀/(its rotational stiffness), in metres.

    Parameters
    ----------
    hinge : float
        Compliance h of the hinge, m; 0 for a clamped base.
    gain : float
        Gain of the sensor: its units (counts per second) per N m/s.
    angular_velocity : float
        Angular velocity ω of the tap, rad/s.

    Examples
    --------
    >>> w = Whisker(50e-3, 100e-6, 5e-6)
    >>> soft, stiff = (HingedTap(h).signals(w, np.array([20e-3]))[0][0] for h in (5e-3, 0.0))
    >>> bool(soft < stiff)
    True
    """

    hinge: float = 0.0
    gain: float = 1.0
    angular_velocity: float = 1.0
    signal_names = ("moment_rate",)

    def signals(self, whisker: Whisker, contact: Array, *, model: str | None = None) -> Encoded:
        """The slope (..., 1) and the outcome of contacts (..., 1)."""
        checks.refuse_hinge(whisker, "HingedTap, which has a hinge of its own,")
        r = np.asarray(contact, dtype=float)[..., 0]
        reached = (r > 0) & (r < whisker.apex_distance) & (r <= whisker.length)
        slope = _slope(np.where(reached, r, whisker.length / 2), whisker.apex_distance, self.hinge)
        slope = slope * self.gain * whisker.compliance_constant * self.angular_velocity
        outcome = np.where(reached, Outcome.HELD, Outcome.OUT_OF_REACH).astype(np.int8)
        return np.where(reached, slope, np.nan)[..., None], outcome


def _slope(r: Array, apex: Any, hinge: Any) -> Array:
    return 1 / (1 / (1 / r - 1 / apex) + hinge)


@dataclass(frozen=True, eq=False, repr=False)
class Calibration(Shown):
    """A whisker and its sensor, calibrated by taps at known distances; from `calibrate`.

    Attributes
    ----------
    whisker : Whisker
        With the fitted apex distance and, unless slopes are counts, the fitted stiffness.
    cue : HingedTap
        With the fitted hinge and, where slopes are counts, the fitted gain.
    noise : Weber
        Weber fraction of the sensor: the scatter of taps at one distance.
        ``locate(table, c.whisker, cue=c.cue, noise=c.noise)`` takes whisker, cue and noise as
        exact; ``locate(table, c)`` includes their uncertainty.
    parameters : DataFrame
        Posterior mean, sd and 95 % interval of stiffness (N m²) or gain, apex distance and hinge
        (mm), misfit and Weber fraction. The misfit is the sd, relative to the slope, of the
        deviation from the curve that all slopes at one distance share.
    residuals : DataFrame
        One row per tap: distance, measured and fitted slope, and the residual in sds.
    left_out : DataFrame
        One row per distance: where a calibration without its taps locates them, and the error as
        a share of the length.
    p_value : float
        F test of lack of fit: scatter of the distances' means about the curve against the scatter
        of taps at one distance. NaN where no distance was tapped twice (to within 1 % of the
        length), or where there are no more distances than parameters.
    effective_draws : float
        Effective sample size of the posterior; below about a hundred its numbers are imprecise.
    samples : tuple of (Whisker, HingedTap, Weber)
        Draws from the posterior, with a draw of the misfit in each gain. ``locate(table, c)``
        averages over them, so that the calibration's uncertainty widens the intervals.
    by_velocity : bool
        Whether slopes were divided by an angular velocity; contacts then need one too.
    """

    _figure: ClassVar[str] = "calibrated"
    whisker: Whisker
    cue: HingedTap
    noise: Weber
    parameters: pd.DataFrame
    residuals: pd.DataFrame
    left_out: pd.DataFrame
    p_value: float
    effective_draws: float
    samples: tuple[tuple[Whisker, HingedTap, Weber], ...]
    by_velocity: bool

    def _line(self) -> str:
        return f"k = {float(self.noise.weber_fraction):.3g} of the sensor. {self.message}"

    def _table(self) -> pd.DataFrame:
        return self.parameters

    @property
    def fits(self) -> bool:
        """Whether the curve was tested and explains the distances' means (p above 0.01)."""
        return self.p_value >= 0.01

    @property
    def misfit(self) -> float:
        """Relative sd of the deviation from the curve that all slopes at one distance share."""
        return float(self.parameters["mean"]["misfit"])

    @property
    def message(self) -> str:
        """The quality of the fit, in a sentence."""
        worst = self.left_out["error_share"].abs().max()
        left = f"a distance left out is found within {100 * worst:.1f} % of the length"
        if self.fits:
            return f"The model fits (p = {self.p_value:.2g}); {left}."
        if np.isnan(self.p_value):
            return f"Whether the model fits cannot be tested: tap distances several times; {left}."
        hint = "; let the base be a hinge" if self.cue.hinge == 0 else ""
        return (
            f"The model does not fit (p = {self.p_value:.1g}){hint}; slopes at one distance are "
            f"{100 * self.misfit:.2g} % (sd) off, which widens what is located; {left}."
        )


def calibrate(
    table: pd.DataFrame | str | Path, whisker: Whisker, *, columns: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None, counts: bool = False, hinge: bool = True,
    draws: int = 20_000, seed: Seed = 1,
) -> Calibration:  # fmt: skip
    """Calibrate a whisker and its sensor by taps at known distances.

    Parameters
    ----------
    table : DataFrame or path
        One row per tap: `radial_distance_mm` and `moment_rate`, the slope of the signal over time,
        which is divided by `angular_velocity` where there is such a column. Several taps at each
        distance separate the sensor's noise from the misfit of the model.
    whisker : Whisker
        Gives length, base radius and modulus; taper and stiffness (or gain) are fitted.
    columns, units
        As for `locate`; ``radial_distance`` may be mapped too.
    counts : bool
        Whether slopes are in counts per second. Then the sensor's gain is fitted and the whisker's
        stiffness is taken as given, because slopes determine only their product.
    hinge : bool
        Whether the base may rotate.
    draws : int
        Most draws in one round of importance sampling, which is adapted to the posterior.
    seed : int, SeedSequence or Generator

    Returns
    -------
    Calibration

    Raises
    ------
    ValueError
        For missing columns, fewer than five taps or four distances, distances beyond the whisker
        or apparently in metres, slopes that are not positive and, unless slopes are counts, slopes
        apparently in another unit.

    Examples
    --------
    >>> import weberwhisk as ww
    >>> w = ww.Whisker(50e-3, 100e-6, 5e-6)
    >>> r = np.repeat(np.linspace(10, 40, 7), 5)
    >>> tap = ww.Observer(w, ww.cues.Compliance(), ww.receptors.Weber(0.03))
    >>> slopes = tap.read(r / 1e3, seed=1)[:, 0]
    >>> found = ww.calibrate(pd.DataFrame({"radial_distance_mm": r, "moment_rate": slopes}), w)
    >>> bool(abs(found.noise.weber_fraction - 0.03) < 0.01), found.fits
    (True, True)
    """
    checks.kind("whisker", whisker, "a Whisker", "length", "write ww.Whisker.from_identity('C2')")
    checks.refuse_hinge(whisker, "calibrate, which finds the hinge itself,")
    draws = checks.whole("draws", draws, "write 20000, say", least=1000)
    r, y, by_velocity = _taps(table, whisker, columns, units, counts)
    rng = checks.generator(seed)
    mode, covariance = _mode(r, y, whisker, hinge)
    first = _first_taps(r, whisker)
    weighted = adapted_draws(
        lambda x: _log_density(x, r, y, first, whisker), mode, np.sqrt(np.diag(covariance)),
        SobolPoints(len(mode) + 1, rng), effective=0.5 * draws, most=draws,
    )  # fmt: skip
    x, weight = weighted.values, weighted.weights
    scale, apex, give, misfit, k = _natural(x, whisker)
    unit = whisker.compliance_constant if counts else 3.0
    named = {"gain" if counts else "stiffness_N_m2": scale / unit, "apex_distance_mm": 1e3 * apex}
    named |= {"hinge_mm": 1e3 * give} if hinge else {}
    named |= {"misfit": misfit, "weber_fraction": k}
    rows = {}
    for name, values in named.items():
        mean = weight @ values
        low, high = weighted_quantiles(values, weight, [0.025, 0.975])
        sd = np.sqrt(weight @ (values - mean) ** 2)
        rows[name] = {"mean": mean, "sd": sd, "low_95": low, "high_95": high}
    parameters = pd.DataFrame.from_dict(rows, orient="index")
    found, cue = _as_found(mode, whisker, counts)
    best_scale, best_apex, best_give = _natural(mode, whisker)[:3]
    noise = Weber(float(rows["weber_fraction"]["mean"]))
    fitted = best_scale * _slope(r, best_apex, best_give)
    residuals = pd.DataFrame({
        "radial_distance_mm": 1e3 * r, "slope": y, "fitted": fitted,
        "residual_sd": (y / fitted - 1) / noise.weber_fraction,
    })  # fmt: skip
    # `locate` averages over these: the mean of 24 draws has an sd of a fifth of what they add.
    kept = rng.choice(len(x), 24, p=weight)
    off = misfit[kept] * ndtri((rng.permutation(kept.size) + 0.5) / kept.size)
    samples = tuple(
        (*_as_found(x[i], whisker, counts, 1 + o), Weber(float(k[i])))
        for i, o in zip(kept, off, strict=True)
    )
    return Calibration(
        found, cue, noise, parameters, residuals, _left_out(r, y, whisker, mode),
        _lack_of_fit(r, y / fitted, len(mode) - 2, whisker), weighted.effective,
        samples, by_velocity,
    )  # fmt: skip


def _as_found(
    x: Array, whisker: Whisker, counts: bool, times: float = 1.0
) -> tuple[Whisker, HingedTap]:
    """The whisker and its sensor at x, with slopes `times` the model's."""
    scale, apex, give = (float(v) for v in _natural(x, whisker)[:3])
    tip = whisker.base_radius * (1 - whisker.length / apex)
    modulus = whisker.youngs_modulus
    if not counts:
        modulus = scale / 3 / (np.pi / 4 * whisker.base_radius**4)
    found = replace(whisker, tip_radius=tip, youngs_modulus=modulus)
    gain = float(scale / found.compliance_constant) if counts else 1.0
    return found, HingedTap(give, times * gain)


def _taps(
    table: Any, whisker: Whisker, columns: Any, units: Any, counts: bool
) -> tuple[Array, Array, bool]:
    """Distances (m) and slopes of the taps; whether slopes were divided by a velocity."""
    _, si, found = read_contacts(table, columns, units)
    if missing := [name for name in ("radial_distance", "moment_rate") if name not in si]:
        raise Refusal(
            "A calibration needs the columns radial_distance_mm and moment_rate",
            remedy=f"map {' and '.join(missing)} with "
            + argument("columns", dict.fromkeys(missing, ...)),
        )
    r = si["radial_distance"]
    y = si["moment_rate"] / si.get("angular_velocity", 1.0)
    known = np.isfinite(r) & np.isfinite(y)
    order = np.argsort(r[known], kind="stable")
    r, y = r[known][order], y[known][order]
    off = (r <= 0) | (r > whisker.length)
    if off.any():
        column, factor, said = found["radial_distance"]
        unit = f"{column!r} was read in {'metres' if factor == 1 else f'units of {factor:g} m'}"
        in_mm = ": write " + argument("units", {"radial_distance": "mm"}) + ", say"
        raise Refusal(
            f"A distance of {1e3 * r[off][0]:g} mm is not on a whisker of "
            f"{1e3 * whisker.length:g} mm",
            remedy=Advice.joined("", [unit, "; correct it" if said else in_mm]),
        )
    if len(r) and np.median(r) < domain.CONTACTS[0] * whisker.length:
        raise Refusal(
            f"Half of the taps are nearer than {1e3 * np.median(r):.2g} mm, on a whisker of "
            f"{1e3 * whisker.length:g} mm: did you pass metres?",
            remedy="radial_distance_mm is in millimetres",
        )
    places = len(_first_taps(r, whisker))
    if len(r) < 5 or places < 4:
        raise Refusal(
            "A calibration takes five taps or more at four distances or more",
            f"{len(r)} at {places}",
            "add taps",
        )
    if np.any(y <= 0):
        raise Refusal("Slopes must be above zero", f"{y[y <= 0][0]:g}", "leave such taps out")
    usual = whisker.compliance_constant * _slope(r, max(whisker.apex_distance, 1.01 * r.max()), 0.0)
    times = float(np.median(y / usual))
    if not counts and not 0.01 < times < 30:
        column, factor, _ = found["moment_rate"]
        unit = likely_prefix(times, factor) + "N m/s"
        raise Refusal(
            f"{column!r} is {times:.2g} times what this whisker gives at 1 rad/s: did you pass "
            f"{unit}?",
            remedy=(
                "write "
                + argument("units", {"moment_rate": unit})
                + ", give angular_velocity in rad/s, or write "
                + argument("counts", True)
                + " for a sensor's own units"
            ),
        )
    return r, y, "angular_velocity" in si


def _first_taps(r: Array, whisker: Whisker) -> Index:
    """Index of the first tap at each distance; r ascends, and 1 % of the length is one place."""
    first = [0]
    for i in range(len(r)):
        if r[i] - r[first[-1]] > 0.01 * whisker.length:
            first.append(i)
    return np.array(first[: len(r)], dtype=np.intp)


def _natural(x: Array, whisker: Whisker) -> tuple[Array, Array, Array, Array, Array]:
    """gain·3EI₀, apex distance, hinge (m), misfit and Weber fraction at x (..., 4 or 5)."""
    apex = whisker.length * (1 + np.exp(-x[..., 1]))
    give = whisker.length * np.exp(x[..., 2]) if x.shape[-1] > 4 else 0.0 * apex
    return np.exp(x[..., 0]), apex, give, expit(x[..., -2]), LEAST + np.exp(x[..., -1])


def _log_density(x: Array, r: Array, y: Array, first: Index, whisker: Whisker) -> Array:
    """ln of the posterior density at x: ln scale, logit taper, (ln hinge), logit misfit, ln k.

    Slopes at one distance, relative to the model's, have the covariance k²I + misfit².
    """
    scale, apex, give, misfit, k = (v[..., None] for v in _natural(x, whisker))
    mean = scale * _slope(r, apex, give)
    off = y / mean - 1
    count = np.diff(first, append=len(r))
    middle = np.add.reduceat(off, first, axis=-1) / count
    within = ((off - np.repeat(middle, count, axis=-1)) ** 2).sum(axis=-1) / k[..., 0] ** 2
    shared = k**2 + count * misfit**2
    log = -0.5 * (count * middle**2 / shared + np.log(shared)).sum(axis=-1)
    log -= 0.5 * within + (len(r) - len(first)) * np.log(k[..., 0]) + np.log(mean).sum(axis=-1)
    prior = BELIEFS if x.shape[-1] > 4 else np.delete(BELIEFS, 1, axis=0)
    return log - 0.5 * (((x[..., 1:] - prior[:, 0]) / prior[:, 1]) ** 2).sum(axis=-1)


def _mode(
    r: Array, y: Array, whisker: Whisker, hinge: bool, start: Array | None = None
) -> tuple[Array, Array]:
    """The mode, from a start or from least squares, and the inverse of minus the curvature."""
    first = _first_taps(r, whisker)

    def cost(x: Any) -> float:
        return -float(_log_density(np.asarray(x), r, y, first, whisker))

    def off(x: Array) -> Array:
        """Residuals of the curve; 0.01 of the prior's fix parameters that the taps do not."""
        scale, apex, give = _natural(np.append(x, [0.0, 0.0]), whisker)[:3]
        believed = (x[1:] - BELIEFS[: len(x) - 1, 0]) / BELIEFS[: len(x) - 1, 1]
        return np.append(np.log(y / (scale * _slope(r, apex, give))), 0.01 * believed)

    if start is None:
        scale = np.log(np.median(y / _slope(r, 1.1 * whisker.length, 0.0)))
        curve = least_squares(off, [scale, 1.5, *([-3.0] if hinge else [])])
        spread = np.log(max(float(np.std(off(curve.x)[: len(y)])), LEAST))
        start = np.array([*curve.x, spread, spread])
    x = minimize(cost, start).x
    value, axes = np.linalg.eigh(curvature_at(cost, x, 1e-3))
    return x, (axes / np.maximum(value, 0.1)) @ axes.T


def _left_out(r: Array, y: Array, whisker: Whisker, mode: Array) -> pd.DataFrame:
    """Each distance located by the calibration of all others."""
    rows = []
    first = _first_taps(r, whisker)
    for begin, end in zip(first, [*first[1:], len(r)], strict=True):
        own, rest = slice(begin, end), np.r_[:begin, end : len(r)]
        found, _ = _mode(r[rest], y[rest], whisker, len(mode) > 4, mode)
        scale, apex, give = _natural(found, whisker)[:3]
        # slope = scale/(1/(1/r − 1/A) + h), solved for r.
        inside = scale / y[own].mean() - give
        place = r[own].mean()
        located = 1 / (1 / inside + 1 / apex) if inside > 0 else 0.0
        rows.append({"radial_distance_mm": 1e3 * place, "located_mm": 1e3 * located,
                     "error_share": (located - place) / whisker.length})  # fmt: skip
    return pd.DataFrame(rows)


def _lack_of_fit(r: Array, ratio: Array, parameters: int, whisker: Whisker) -> float:
    """p of the scatter of the distances' means about 1, against that within distances."""
    groups = np.split(ratio, _first_taps(r, whisker)[1:])
    within = sum(((g - g.mean()) ** 2).sum() for g in groups)
    between = sum(len(g) * (g.mean() - 1) ** 2 for g in groups)
    free, rest = len(groups) - parameters, len(ratio) - len(groups)
    if free < 1 or rest < 1:
        return float("nan")
    noise = max(within / rest, LEAST**2)
    return float(f_distribution.sf(between / free / noise, free, rest))


def averaged(
    calibration: Calibration,
    locate: Callable[..., pd.DataFrame],
    progress: Callable[[int, int], None] | None,
) -> pd.DataFrame:
    """A table located with each of the calibration's samples, and the average of these tables."""
    best = (calibration.whisker, calibration.cue, calibration.noise)
    every, passes = [], (*calibration.samples, best)
    for whisker, cue, noise in passes:
        every.append(locate(whisker, cue=cue, noise=noise))
        if progress:
            progress(len(every) * len(every[0]) // len(passes), len(every[0]))
    *every, out = every
    reach = 1e3 * calibration.whisker.length
    for of in ("", "touch_") if "touch_status" in out else ("",):
        found, ends = [f"{of}radial_distance_mm", f"{of}sd_mm"], [f"{of}lower_mm", f"{of}upper_mm"]
        mean, sd = (np.array([e[name] for e in every]) for name in found)
        # A draw with which a row has no posterior is left out for that row.
        known = np.isfinite(mean).sum(axis=0) > len(every) / 2
        middle = np.nanmean(mean[:, known], axis=0)
        total = np.sqrt(np.nanmean(sd[:, known] ** 2, axis=0) + np.nanvar(mean[:, known], axis=0))
        r, own = out.loc[known, found].to_numpy().T
        with np.errstate(divide="ignore", invalid="ignore"):
            off = (out.loc[known, ends].to_numpy().T - r) * (total / own)
        off = np.where(own > 0, off, np.outer([-1.96, 1.96], total))
        out.loc[known, ends] = np.clip(middle + off, 0.0, reach).T
        out.loc[known, found] = np.stack([middle, total], axis=1)
    share = f"{100 * calibration.misfit:.2g} % of the slopes"
    note = f"Means over {len(every)} draws of the calibration, whose misfit is {share}."
    out.attrs = out.attrs | {"notes": (*out.attrs["notes"], note)}
    if not calibration.fits:
        tested = "does not fit" if calibration.p_value < 0.01 else "was not tested"
        located = out["radial_distance_mm"].notna()
        out.loc[located, "message"] += f"; the calibration {tested}: widened by {share}"
    return out
