"""Calibration by taps at known distances: stiffness, taper, hinge, gain, and the sensor's noise."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pandas as pd
from scipy.optimize import minimize
from scipy.stats import f as f_distribution

from .. import domain
from .._util import checks
from .._util.values import Array, Shown
from ..cues import Cue
from ..cues.protocol import Encoded
from ..mechanics.contact import Outcome
from ..receptors import Seed, Weber
from ..whisker import Whisker
from .columns import likely_prefix, read_contacts


@dataclass(frozen=True, eq=False, repr=False)
class HingedTap(Cue):
    """The slope of a light tap on a whisker that stands on a rotational spring.

    Whisker and spring are in series: slope = gain·3EI₀ω/(1/(1/r − 1/A) + h), equation (2.1) with
    the hinge's compliance h = 3EI₀/(stiffness of the spring), m.

    Parameters
    ----------
    hinge : float
        h, m; 0 for a clamped base.
    gain : float
        Of the sensor, in its units (counts a second) for each N m/s.
    angular_velocity : float
        ω, rad/s.

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
    """What taps at known distances tell of a whisker and its sensor.

    Attributes
    ----------
    whisker : Whisker
        With the apex distance found, and in SI units the stiffness; else the gain takes it up.
    cue : HingedTap
    noise : Weber
        The sensor's own Weber fraction. ``locate(table, c.whisker, cue=c.cue, noise=c.noise)``
        takes all three as exact, ``locate(table, c)`` does not.
    parameters : DataFrame
        Posterior mean, sd and 95 % interval of stiffness (N m²) or gain, apex distance and hinge
        (mm), Weber fraction.
    residuals : DataFrame
        A row a tap: distance, slope measured and fitted, and the residual in sds.
    left_out : DataFrame
        A row a distance: where its taps are located by a calibration without them, and the error as
        a share of the length.
    p_value : float
        Of the scatter of the distances' means about the curve, beside that of taps at one distance
        (F test of lack of fit). NaN where no distance was tapped twice.
    effective_draws : float
        Of the posterior: below some hundred its numbers are rough.
    samples : tuple of (Whisker, HingedTap, Weber)
        Some draws of the posterior. ``locate(table, c)`` is the mean over them, so that what the
        taps left open widens the distances.
    by_velocity : bool
        Whether slopes were divided by an angular velocity, which contacts then need too.
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
        """Whether the curve explains the distances' means (p above 0.01, or unknown)."""
        return not self.p_value < 0.01

    @property
    def message(self) -> str:
        """How well it went, in a sentence."""
        worst = self.left_out["error_share"].abs().max()
        left = f"a distance left out is found within {100 * worst:.1f} % of the length"
        if self.fits:
            return f"The model fits; {left}."
        hint = "; let the base be a hinge" if self.cue.hinge == 0 else ""
        return f"The model does not fit (p = {self.p_value:.1g}){hint}; {left}."


def calibrate(
    table: pd.DataFrame | str | Path,
    whisker: Whisker,
    *,
    columns: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    counts: bool = False,
    hinge: bool = True,
    draws: int = 20_000,
    seed: Seed = 1,
) -> Calibration:
    """Calibrate a whisker and its sensor by taps at known distances.

    Parameters
    ----------
    table : DataFrame or path
        A row a tap: `radial_distance_mm` and `moment_rate`, the slope of the signal over time; with
        `angular_velocity` the slope is divided by that.
    whisker : Whisker
        Its length, base radius and modulus; taper and stiffness (or gain) are found.
    columns, units
        As of `locate`.
    counts : bool
        The slope is in counts a second: the sensor's gain is found, with the whisker's stiffness as
        given, since one slope cannot tell the two apart.
    hinge : bool
        Whether the base may give way.
    draws : int
        Of the posterior, by importance sampling about its mode.
    seed : int, SeedSequence or Generator

    Returns
    -------
    Calibration

    Raises
    ------
    ValueError
        For columns that are not there, fewer than five taps or four distances, distances that are
        not on the whisker or seem to be in metres, and slopes that are not positive or, unless
        they are counts, not of the unit that they should be.

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
    checks.kind("whisker", whisker, "a Whisker", "length", "write Whisker.from_identity('C2')")
    checks.refuse_hinge(whisker, "calibrate, which finds the hinge itself,")
    draws = checks.whole("draws", draws, "write 20000, say", least=1000)
    r, y, by_velocity = _taps(table, whisker, columns, units, counts)
    places = np.unique(r)
    rng = checks.generator(seed)
    mode, covariance = _mode(r, y, whisker, hinge)
    root = np.linalg.cholesky(covariance)
    normal = rng.standard_normal((draws, len(mode)))
    df = 5  # Student's tails about the mode, heavier than the posterior's
    wider = np.sqrt(df / rng.chisquare(df, draws))[:, None]
    x = mode + (normal * wider) @ root.T
    log = _log_density(x, r, y, whisker)
    log += 0.5 * (df + len(mode)) * np.log1p(((normal * wider) ** 2).sum(axis=1) / df)
    weight = np.exp(log - log.max())
    weight /= weight.sum()
    scale, apex, give, k = _natural(x, whisker)
    unit = whisker.compliance_constant if counts else 3.0
    named = {"gain" if counts else "stiffness_N_m2": scale / unit, "apex_distance_mm": 1e3 * apex}
    named |= {"hinge_mm": 1e3 * give} if hinge else {}
    named["weber_fraction"] = k
    rows = {}
    for name, values in named.items():
        mean = weight @ values
        order = np.argsort(values)
        low, high = np.interp([0.025, 0.975], np.cumsum(weight[order]), values[order])
        sd = np.sqrt(weight @ (values - mean) ** 2)
        rows[name] = {"mean": mean, "sd": sd, "low_95": low, "high_95": high}
    parameters = pd.DataFrame.from_dict(rows, orient="index")
    found, cue = _as_found(mode, whisker, counts)
    best_scale, best_apex, best_give, _ = (float(v) for v in _natural(mode, whisker))
    noise = Weber(float(rows["weber_fraction"]["mean"]))
    fitted = best_scale * _slope(r, best_apex, best_give)
    residual = (y / fitted - 1) / noise.weber_fraction
    residuals = pd.DataFrame(
        {"radial_distance_mm": 1e3 * r, "slope": y, "fitted": fitted, "residual_sd": residual}
    )
    # Draws that `locate` goes by: their mean's sd is a fifth of what they add.
    kept = rng.choice(draws, 24, p=weight)
    return Calibration(
        found, cue, noise, parameters, residuals,
        _left_out(r, y, whisker, hinge), _lack_of_fit(r, y / fitted, len(mode) - 1, places),
        float(1 / (weight**2).sum()),
        tuple((*_as_found(x[i], whisker, counts), Weber(float(k[i]))) for i in kept), by_velocity,
    )  # fmt: skip


def _as_found(x: Array, whisker: Whisker, counts: bool) -> tuple[Whisker, HingedTap]:
    """The whisker and its sensor at x."""
    scale, apex, give, _ = (float(v) for v in _natural(x, whisker))
    tip = whisker.base_radius * (1 - whisker.length / apex)
    modulus = whisker.youngs_modulus
    if not counts:
        modulus = scale / 3 / (np.pi / 4 * whisker.base_radius**4)
    found = replace(whisker, tip_radius=tip, youngs_modulus=modulus)
    return found, HingedTap(give, float(scale / found.compliance_constant) if counts else 1.0)


def _taps(
    table: Any, whisker: Whisker, columns: Any, units: Any, counts: bool
) -> tuple[Array, Array, bool]:
    """Distances, m, and slopes of the taps; whether these were divided by a velocity."""
    raw, si, found = read_contacts(table, columns, units)
    if "radial_distance_mm" not in raw or "moment_rate" not in si:
        raise ValueError(
            "A calibration needs the columns radial_distance_mm and moment_rate; map the slope "
            'with columns={"moment_rate": …}.'
        )
    r = 1e-3 * pd.to_numeric(raw["radial_distance_mm"], errors="coerce").to_numpy(dtype=float)
    y = si["moment_rate"] / si.get("angular_velocity", 1.0)
    known = np.isfinite(r) & np.isfinite(y)
    r, y = r[known], y[known]
    if len(r) < 5 or len(np.unique(r)) < 4:
        raise ValueError(
            f"A calibration takes five taps or more at four distances or more, got {len(r)} at "
            f"{len(np.unique(r))}; add taps."
        )
    off = (r <= 0) | (r > whisker.length)
    if off.any():
        raise ValueError(
            f"A distance of {1e3 * r[off][0]:g} mm is not on a whisker of "
            f"{1e3 * whisker.length:g} mm; radial_distance_mm is in millimetres."
        )
    if np.median(r) < domain.CONTACTS[0] * whisker.length:
        raise ValueError(
            f"Half of the taps are nearer than {1e3 * np.median(r):.2g} mm, on a whisker of "
            f"{1e3 * whisker.length:g} mm: did you pass metres? radial_distance_mm is in "
            "millimetres."
        )
    if np.any(y <= 0):
        raise ValueError(f"Slopes must be above zero, got {y[y <= 0][0]:g}; leave such taps out.")
    usual = whisker.compliance_constant * _slope(r, max(whisker.apex_distance, 1.01 * r.max()), 0.0)
    times = float(np.median(y / usual))
    if not counts and not 0.01 < times < 30:
        column, factor, _ = found["moment_rate"]
        unit = likely_prefix(times, factor) + "N m/s"
        raise ValueError(
            f"{column!r} is {times:.2g} times what this whisker gives at 1 rad/s: did you pass "
            f'{unit}? Write units={{"moment_rate": "{unit}"}}, give angular_velocity in rad/s, or '
            "write counts=True (--counts) for a sensor's own units."
        )
    return r, y, "angular_velocity" in si


def _natural(x: Array, whisker: Whisker) -> tuple[Array, Array, Array, Array]:
    """gain·3EI₀, apex distance, hinge (m) and Weber fraction at x (..., 3 or 4)."""
    apex = whisker.length * (1 + np.exp(-x[..., 1]))
    give = whisker.length * np.exp(x[..., 2]) if x.shape[-1] > 3 else 0.0 * apex
    return np.exp(x[..., 0]), apex, give, np.exp(x[..., -1])


def _log_density(x: Array, r: Array, y: Array, whisker: Whisker) -> Array:
    """ln of the posterior density at x (..., 3 or 4): ln scale, logit taper, (ln hinge), ln k."""
    scale, apex, give, k = (v[..., None] for v in _natural(x, whisker))
    mean = scale * _slope(r, apex, give)
    log = (-0.5 * ((y / mean - 1) / k) ** 2 - np.log(k * mean)).sum(axis=-1)
    # Mean and sd of: logit of length over apex distance, ln of hinge over length, ln k.
    prior = np.array([[1.5, 2.0], [-3.0, 2.0], [-3.0, 1.5]])
    prior = prior if x.shape[-1] > 3 else prior[[0, 2]]
    return log - 0.5 * (((x[..., 1:] - prior[:, 0]) / prior[:, 1]) ** 2).sum(axis=-1)


def _mode(r: Array, y: Array, whisker: Whisker, hinge: bool) -> tuple[Array, Array]:
    """The mode, and the inverse of minus the curvature there."""

    def cost(x: Any) -> float:
        return -float(_log_density(np.asarray(x), r, y, whisker))

    best: Any = None
    for give in (-4.0, -2.0) if hinge else (None,):
        start = [np.log(np.median(y / _slope(r, 1.1 * whisker.length, 0.0))), 1.5]
        start += [give, -2.5] if give is not None else [-2.5]
        found = minimize(
            cost, np.array(start, dtype=float), method="Nelder-Mead",
            options={"xatol": 1e-6, "fatol": 1e-9, "maxiter": 8000},
        )  # fmt: skip
        best = found if best is None or found.fun < best.fun else best
    x, n = np.asarray(best.x), len(best.x)
    step = 1e-3 * np.eye(n)
    both = x + step[:, None] + step[None]
    mixed = _log_density(x + step[:, None] - step[None], r, y, whisker)
    outer = _log_density(x - step[:, None] - step[None], r, y, whisker)
    inner = _log_density(x - step[:, None] + step[None], r, y, whisker)
    curvature = (_log_density(both, r, y, whisker) - mixed - inner + outer) / 4e-6
    value, axes = np.linalg.eigh(-(curvature + curvature.T) / 2)
    return x, (axes / np.maximum(value, 0.1)) @ axes.T


def _left_out(r: Array, y: Array, whisker: Whisker, hinge: bool) -> pd.DataFrame:
    """Each distance located by the calibration of all others."""
    rows = []
    for place in np.unique(r):
        own = r == place
        mode, _ = _mode(r[~own], y[~own], whisker, hinge)
        scale, apex, give, _ = (float(v) for v in _natural(mode, whisker))
        # slope = scale/(1/(1/r − 1/A) + h), solved for r.
        inside = scale / y[own].mean() - give
        found = 1 / (1 / inside + 1 / apex) if inside > 0 else 0.0
        error = (found - place) / whisker.length
        rows.append({"radial_distance_mm": 1e3 * place, "located_mm": 1e3 * found,
                     "error_share": error})  # fmt: skip
    return pd.DataFrame(rows)


def _lack_of_fit(r: Array, ratio: Array, parameters: int, places: Array) -> float:
    """p of the scatter of the means about 1, beside the scatter within distances."""
    groups = [ratio[r == place] for place in places]
    within = sum(((g - g.mean()) ** 2).sum() for g in groups)
    between = sum(len(g) * (g.mean() - 1) ** 2 for g in groups)
    free, rest = len(places) - parameters, len(ratio) - len(places)
    if free < 1 or rest < 1 or not within > 0:
        return float("nan")
    return float(f_distribution.sf(between / free / (within / rest), free, rest))


def averaged(
    calibration: Calibration,
    locate: Callable[[Whisker, Cue, Weber], pd.DataFrame],
    progress: Callable[[int, int], None] | None,
) -> pd.DataFrame:
    """What `locate` makes of a table under each of the calibration's samples, as one table."""
    best = (calibration.whisker, calibration.cue, calibration.noise)
    every, passes = [], (*calibration.samples, best)
    for sample in passes:
        every.append(locate(*sample))
        if progress:
            progress(len(every) * len(every[0]) // len(passes), len(every[0]))
    *every, out = every
    reach = 1e3 * calibration.whisker.length
    for of in ("", "touch_") if "touch_status" in out else ("",):
        found, ends = [f"{of}radial_distance_mm", f"{of}sd_mm"], [f"{of}lower_mm", f"{of}upper_mm"]
        mean, sd = (np.array([e[name] for e in every]) for name in found)
        # A draw that has a row beyond the whisker says nothing of it.
        known = np.isfinite(mean).sum(axis=0) > len(every) / 2
        middle = np.nanmean(mean[:, known], axis=0)
        total = np.sqrt(np.nanmean(sd[:, known] ** 2, axis=0) + np.nanvar(mean[:, known], axis=0))
        r, own = out.loc[known, found].to_numpy().T
        with np.errstate(divide="ignore", invalid="ignore"):
            off = (out.loc[known, ends].to_numpy().T - r) * (total / own)
        off = np.where(own > 0, off, np.outer([-1.96, 1.96], total))
        out.loc[known, ends] = np.clip(middle + off, 0.0, reach).T
        out.loc[known, found] = np.stack([middle, total], axis=1)
    notes = (*out.attrs["notes"], f"Means over {len(every)} draws of the calibration.")
    out.attrs = out.attrs | {"notes": notes}
    return out
