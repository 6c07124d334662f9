"""Calibration by taps at known distances: stiffness, taper, hinge, gain, and the sensor's noise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
import pandas as pd
from scipy.stats import f as f_distribution

from .. import domain
from .._util import checks
from .._util.importance import SobolPoints, adapted_draws
from .._util.refusals import Advice, Refusal, argument
from .._util.values import Array, Flags, Index, Shown, counted, weighted_quantiles
from .._util.weights import systematic
from ..receptors import Seed, Weber
from ..whisker import Whisker
from .columns import likely_prefix, read_contacts
from .taps import LEAST, HingedTap, Sensor, TapModel, slope_on_hinge

__all__ = ["Calibration", "HingedTap", "calibrate"]

#: Rows are named that are gross with at least this probability.
NAMED = 0.9
#: Draws from the posterior that are kept, and over which `locate` averages.
KEPT = 2000


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
        One row per tap, with the table's index, by distance: distance, measured and fitted slope,
        the residual in sds, and the probability that the tap is gross.
    left_out : DataFrame
        One row per distance: where a calibration without its taps locates them, and the error as
        a share of the length.
    gross : DataFrame
        The taps that are gross with a probability of 0.9 or more: they are believed to say nothing
        of the sensor, and `weber_fraction_if_kept` is what it would be if that tap did.
    p_value : float
        F test of lack of fit: scatter of the distances' means about the curve against the scatter
        of taps at one distance. NaN where no distance was tapped twice (to within 1 % of the
        length), or where there are no more distances than parameters. Gross taps are left out.
    effective_draws : float
        Effective sample size of the posterior; below about a hundred its numbers are imprecise.
    samples : DataFrame
        Draws from the posterior, by the names of `parameters`. ``locate(table, c)`` averages over
        them, so that the calibration's uncertainty widens the intervals.
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
    gross: pd.DataFrame
    p_value: float
    effective_draws: float
    samples: pd.DataFrame
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
        left += self._gross_in_words
        if self.fits:
            return f"The model fits (p = {self.p_value:.2g}); {left}."
        if np.isnan(self.p_value):
            return f"Whether the model fits cannot be tested: tap distances several times; {left}."
        hint = "; let the base be a hinge" if self.cue.hinge == 0 else ""
        return (
            f"The model does not fit (p = {self.p_value:.1g}){hint}; slopes at one distance are "
            f"{100 * self.misfit:.2g} % (sd) off, which widens what is located; {left}."
        )

    @property
    def _gross_in_words(self) -> str:
        if not len(self.gross):
            return ""
        rows = checks.listed(map(str, self.gross.index), 8)
        several = len(self.gross) > 1
        return (
            f"; {counted(len(self.gross), 'tap')} ({'rows' if several else 'row'} {rows}) "
            f"{'do' if several else 'does'} not belong and {'are' if several else 'is'} left out: "
            f"k would be {self.gross.attrs['weber_fraction_if_kept']:.2g} in place of "
            f"{float(self.noise.weber_fraction):.2g}"
        )

    @property
    def sensors(self) -> Sensor:
        """The samples as parameters of sensors, (N,)."""
        draws = {name: column.to_numpy() for name, column in self.samples.items()}
        if "gain" in draws:
            scale = draws["gain"] * self.whisker.compliance_constant
        else:
            scale = 3.0 * draws["stiffness_N_m2"]
        hinge = draws.get("hinge_mm", np.zeros(len(scale)))
        return Sensor(
            scale, draws["apex_distance_mm"] / 1e3, hinge / 1e3, draws["misfit"],
            draws["weber_fraction"],
        )  # fmt: skip


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
    taps = _taps(table, whisker, columns, units, counts)
    rng = checks.generator(seed)
    model = TapModel.of(taps.r, taps.y, whisker.length, hinge)
    mode, covariance = model.mode()
    weighted = adapted_draws(
        model.log_density, mode, np.sqrt(np.diag(covariance)), SobolPoints(len(mode) + 1, rng),
        effective=0.5 * draws, most=draws,
    )  # fmt: skip
    sensor = model.sensor(weighted.values)
    unit = whisker.compliance_constant if counts else 3.0
    named = {"gain" if counts else "stiffness_N_m2": sensor.scale / unit}
    named |= {"apex_distance_mm": 1e3 * sensor.apex}
    named |= {"hinge_mm": 1e3 * sensor.hinge} if hinge else {}
    named |= {"misfit": sensor.misfit, "weber_fraction": sensor.k}
    weight, rows = weighted.weights, {}
    for name, values in named.items():
        mean = weight @ values
        low, high = weighted_quantiles(values, weight, [0.025, 0.975])
        sd = np.sqrt(weight @ (values - mean) ** 2)
        rows[name] = {"mean": mean, "sd": sd, "low_95": low, "high_95": high}
    kept = rng.permutation(systematic(weight, KEPT, rng))
    noise = Weber(float(rows["weber_fraction"]["mean"]))
    fitted = model.sensor(mode).slope(taps.r)
    gross = model.gross_probability(weighted.values[kept])
    residuals = pd.DataFrame({
        "radial_distance_mm": 1e3 * taps.r, "slope": taps.y, "fitted": fitted,
        "residual_sd": (taps.y / fitted - 1) / noise.weber_fraction, "gross_probability": gross,
    }, index=taps.labels)  # fmt: skip
    belongs = gross < NAMED
    found, cue = _as_fitted(model.sensor(mode), whisker, counts)
    return Calibration(
        found, cue, noise, pd.DataFrame.from_dict(rows, orient="index"), residuals,
        _left_out(model, mode, belongs), _gross(model, mode, residuals),
        _lack_of_fit(model, taps.y / fitted, belongs, len(mode) - 2), weighted.effective,
        pd.DataFrame({name: values[kept] for name, values in named.items()}), taps.by_velocity,
    )  # fmt: skip


def _as_fitted(sensor: Sensor, whisker: Whisker, counts: bool) -> tuple[Whisker, HingedTap]:
    """The whisker and its sensor with such parameters."""
    scale, apex, hinge = (float(v) for v in sensor[:3])
    tip = whisker.base_radius * (1 - whisker.length / apex)
    modulus = whisker.youngs_modulus
    if not counts:
        modulus = scale / 3 / (np.pi / 4 * whisker.base_radius**4)
    found = replace(whisker, tip_radius=tip, youngs_modulus=modulus)
    return found, HingedTap(hinge, float(scale / found.compliance_constant) if counts else 1.0)


class _Taps(NamedTuple):
    """Distances (m), ascending, and slopes of taps, with the table's labels of their rows, and
    whether slopes were divided by a velocity."""

    r: Array
    y: Array
    labels: pd.Index
    by_velocity: bool


def _taps(table: Any, whisker: Whisker, columns: Any, units: Any, counts: bool) -> _Taps:
    raw, si, found = read_contacts(table, columns, units)
    if missing := [name for name in ("radial_distance", "moment_rate") if name not in si]:
        raise Refusal(
            "A calibration needs the columns radial_distance_mm and moment_rate",
            remedy=f"map {' and '.join(missing)} with "
            + argument("columns", dict.fromkeys(missing, ...)),
        )
    r = si["radial_distance"]
    y = si["moment_rate"] / si.get("angular_velocity", 1.0)
    known = np.flatnonzero(np.isfinite(r) & np.isfinite(y))
    order = known[np.argsort(r[known], kind="stable")]
    r, y = r[order], y[order]
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
    places = len(TapModel(r, y, whisker.length, True, np.zeros(0, dtype=np.intp)).first)
    if len(r) < 5 or places < 4:
        raise Refusal(
            "A calibration takes five taps or more at four distances or more",
            f"{len(r)} at {places}",
            "add taps",
        )
    if np.any(y <= 0):
        raise Refusal("Slopes must be above zero", f"{y[y <= 0][0]:g}", "leave such taps out")
    apex = max(whisker.apex_distance, 1.01 * r.max())
    usual = whisker.compliance_constant * slope_on_hinge(r, apex, 0.0)
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
    return _Taps(r, y, raw.index[order], "angular_velocity" in si)


def _gross(model: TapModel, mode: Array, residuals: pd.DataFrame) -> pd.DataFrame:
    """The rows that do not belong, and what k would be if they did: each, and in `attrs` all."""
    named = np.flatnonzero(residuals["gross_probability"] >= NAMED)

    def k_with(rows: Index) -> float:
        fit, _ = replace(model, suspects=np.setdiff1d(model.suspects, rows)).mode(mode)
        return float(model.sensor(fit).k)

    out = residuals.iloc[named].copy()
    out["weber_fraction_if_kept"] = [k_with(row) for row in named]
    if named.size:
        out.attrs["weber_fraction_if_kept"] = k_with(named)
    return out


def _left_out(model: TapModel, mode: Array, belongs: Flags) -> pd.DataFrame:
    """Each distance located by the calibration of all others."""
    rows = []
    for group in model.groups:
        others = model.without(np.isin(np.arange(len(model.r)), group))
        sensor = others.sensor(others.mode(mode)[0])
        used = group[belongs[group]] if belongs[group].any() else group
        # slope = scale/(1/(1/r − 1/A) + h), solved for r.
        inside = float(sensor.scale / model.y[used].mean() - sensor.hinge)
        place = model.r[group].mean()
        located = 1 / (1 / inside + 1 / float(sensor.apex)) if inside > 0 else 0.0
        rows.append({"radial_distance_mm": 1e3 * place, "located_mm": 1e3 * located,
                     "error_share": (located - place) / model.length})  # fmt: skip
    return pd.DataFrame(rows)


def _lack_of_fit(model: TapModel, ratio: Array, belongs: Flags, parameters: int) -> float:
    """p of the scatter of the distances' means about 1, against that within distances."""
    groups = [ratio[g[belongs[g]]] for g in model.groups if belongs[g].any()]
    within = sum(((g - g.mean()) ** 2).sum() for g in groups)
    between = sum(len(g) * (g.mean() - 1) ** 2 for g in groups)
    free, rest = len(groups) - parameters, int(belongs.sum()) - len(groups)
    if free < 1 or rest < 1:
        return float("nan")
    noise = max(within / rest, LEAST**2)
    return float(f_distribution.sf(between / free / noise, free, rest))
