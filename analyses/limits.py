"""What becomes of each method as friction, intrinsic curvature and slip out of the plane grow.

    python analyses/limits.py [folder] [--short]

The paper leaves all three out (§1, "it seems unlikely that their effectiveness would be completely
abolished"). Here the whisker has one of them, and an observer who knows of none reads its signals:
as those of a straight whisker without friction in the plane of its push. Writes limits.csv and
limits.png, by default into analyses/figures, for two distances and a push of ten degrees:

- the *bias* of the radial distance that the observer infers, over the JND of one reading at
  k = 0.1 (of the signals; of the angle, for the balance of moments);
- the *slope* d(inferred)/d(true): 1 where differences between distances are told as if nothing
  had changed, 0 where they are no longer told at all.

The methods: compliance (the moment at the end of the push), sweeping (the moments at eight pushes
up to there, by least squares), the force map (moment and axial force, distance and angle unknown),
the balance of moments (how far past an impact at 60° the muscle turns the whisker).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from command import ANALYSES, options

import weberwhisk as ww
from weberwhisk import plots
from weberwhisk.cues import BalanceOfMoments
from weberwhisk.mechanics import elastica

WHISKER = ww.Whisker(50e-3, base_radius=100e-6, tip_radius=5e-6, youngs_modulus=3e9)
DISTANCES = (0.3, 0.5)  # of the length
PUSH, SWEEP, WEBER_FRACTION = np.radians(10.0), 8, 0.1
#: Of the true distance, to either side, for the slope.
NUDGE = 0.01
BALANCE = BalanceOfMoments(np.radians(60.0))


@dataclass(frozen=True)
class Factor:
    """What is left out, how much of it at most, and the moment and axial force it makes.

    `signals` takes the amount, distances and pushes, arrays that broadcast.
    """

    name: str
    unit: str
    least: float
    most: float
    signals: Callable[[Any, Any, Any], tuple[Any, Any]]


def friction(amount: Any, r: Any, push: Any) -> tuple[Any, Any]:
    """Positive on sliding outwards over the object, negative on sliding inwards."""
    b = ww.press(WHISKER, r, push, np.radians(amount))
    return b.moment, b.axial_force


def curvature(amount: Any, r: Any, push: Any) -> tuple[Any, Any]:
    """Positive towards the push: contact on the convex side."""
    whisker = ww.Whisker(*list(vars(WHISKER).values())[:4], curvature=amount)
    b = ww.press(whisker, r, ww.mechanics.rest_angle(whisker, r) + push)
    return b.moment, b.axial_force


def slip(amount: Any, r: Any, push: Any) -> tuple[Any, Any]:
    """The contact leaves the plane of the push by this angle about the base tangent.

    The whisker is straight and bends in the plane of the contact: only the moment about the axis of
    the push is felt, and the rotation that is known is that in its plane.
    """
    out = np.radians(amount)
    b = ww.press(WHISKER, r, np.arctan(np.tan(push) / np.cos(out)))
    return b.moment * np.cos(out), b.axial_force


FACTORS = (
    Factor("friction", "friction angle (degrees)", -25.6, 25.6, friction),
    Factor("curvature", "intrinsic curvature (1/m)", -12.0, 12.0, curvature),
    Factor("slip", "slip out of the plane (degrees)", 0.0, 60.0, slip),
)


def compliance(signals: Any, r: float) -> float:
    """The distance at which a straight whisker has this moment: it falls with distance."""
    moment, _ = signals(r, PUSH)
    places, table = moments()
    felt = table[:, -1]
    return _where(places, -felt, -moment)


def sweeping(signals: Any, r: float) -> float:
    """The distance whose moments along the sweep are nearest in proportion, by least squares."""
    moment, _ = signals(r, pushes())
    places, table = moments()
    with np.errstate(invalid="ignore", divide="ignore"):
        off = np.sum(np.log(table / moment) ** 2, axis=1)
    if not np.any(np.isfinite(off)):
        return np.nan
    best = int(np.nanargmin(off))
    if best == 0 or not np.isfinite(off[best + 1 : best + 2]).all() or best == len(places) - 1:
        return np.nan  # at the edge: no straight whisker comes near
    near = slice(best - 1, best + 2)
    a, b, _ = np.polyfit(places[near] - places[best], off[near], 2)
    return float(places[best] - b / (2 * a))


def force_map(signals: Any, r: float) -> float:
    """Newton's method on the logarithms of moment and axial force, from the true contact."""
    moment, axial = signals(r, PUSH)
    if not (moment > 0 and axial > 0):
        return np.nan  # a pull: no straight whisker without friction gives that
    x = np.array([r, PUSH])
    for _ in range(60):
        b = elastica.press(WHISKER, *x)
        if not b.held:
            return np.nan
        now = np.array([b.moment, b.axial_force])
        slopes = elastica.signal_jacobian(WHISKER, *x)[:2] / now[:, None]
        step = np.linalg.solve(slopes, np.log([moment, axial]) - np.log(now))
        size = np.max(np.abs(step / x))
        x = x + step * min(1.0, 0.2 / max(size, 0.2))
        if size < 1e-12:
            return float(x[0])
    return np.nan


def balance(signals: Any, r: float) -> float:
    """The distance at which a straight whisker balances the muscle where this one does."""
    low, high = 1e-4, np.radians(60.0)
    gain = BALANCE.curve.gain() / WHISKER.moment_scale
    for _ in range(2):  # coarse steps, then fine ones within the one that it lies in
        theta = np.linspace(low, high, 30)
        moment, _ = signals(r, theta)
        excess = BALANCE.curve.moment(np.radians(60.0) + theta) - gain * moment
        over = np.flatnonzero(~(excess > 0))  # balanced, or flicked past
        if not over.size or not over[0]:
            return np.nan
        i = over[0]
        low, high = theta[i - 1 : i + 1]
    if np.isnan(excess[i]):
        return np.nan
    share = excess[i - 1] / (excess[i - 1] - excess[i])
    angle = low + share * (high - low)
    places, table = angles()
    return _where(places, table, angle)


METHODS = {
    "compliance": compliance,
    "sweeping": sweeping,
    "force map": force_map,
    "balance of moments": balance,
}


@cache
def pushes() -> Any:
    """The sweep's pushes, rad."""
    return PUSH * np.arange(1, SWEEP + 1) / SWEEP


@cache
def moments() -> tuple[Any, Any]:
    """Distances, and the moment of a straight whisker there at each push of the sweep."""
    places = np.linspace(0.02, 0.98, 6000) * WHISKER.length
    return places, elastica.press(WHISKER, places[:, None], pushes()).moment


@cache
def angles() -> tuple[Any, Any]:
    """Distances, and the angle at which a straight whisker balances the muscle there."""
    places = np.linspace(0.02, 0.98, 6000) * WHISKER.length
    return places, BALANCE.signals(WHISKER, places[:, None])[0][:, 0]


def _where(x: Any, rising: Any, value: float) -> float:
    good = np.isfinite(rising)
    inside = rising[good][0] < value < rising[good][-1]
    return float(np.interp(value, rising[good], x[good])) if inside else np.nan


def jnd(method: str, r: float) -> float:
    """Of r for one reading at k = 0.1 without any of the factors, m."""
    moment_r, _, axial_r, _ = _slopes(r, PUSH)
    if method == "compliance":
        return WEBER_FRACTION / abs(moment_r)
    if method == "sweeping":
        return float(WEBER_FRACTION / np.sqrt(sum(_slopes(r, p)[0] ** 2 for p in pushes())))
    if method == "balance of moments":
        h = NUDGE * r
        up, down = BALANCE.signals(WHISKER, np.array([[r + h], [r - h]]))[0][:, 0]
        return float(WEBER_FRACTION / abs(np.log(up / down) / (2 * h)))
    moment_t, axial_t = _slopes(r, PUSH)[1::2]
    determinant = moment_r * axial_t - moment_t * axial_r
    return float(WEBER_FRACTION * np.hypot(moment_t, axial_t) / abs(determinant))


def _slopes(r: float, push: float) -> tuple[float, float, float, float]:
    """∂ln M/∂r, ∂ln M/∂θ, ∂ln Fx/∂r, ∂ln Fx/∂θ."""
    b = elastica.press(WHISKER, r, push)
    slopes = elastica.signal_jacobian(WHISKER, r, push)[:2]
    moment, axial = slopes / np.array([[b.moment], [b.axial_force]])
    return moment[0], moment[1], axial[0], axial[1]


def measure(points: int) -> pd.DataFrame:
    """A row for each factor, amount, method and distance."""
    rows = []
    for factor in FACTORS:
        for amount in np.linspace(factor.least, factor.most, points):

            def signals(r: Any, push: Any, f: Factor = factor, a: float = amount) -> Any:
                return f.signals(a, r, push)

            for place in DISTANCES:
                r = place * WHISKER.length
                for name, infer in METHODS.items():
                    low, at, high = (infer(signals, r * (1 + s * NUDGE)) for s in (-1, 0, 1))
                    rows.append(
                        {
                            "factor": factor.name,
                            "amount": round(float(amount), 6),
                            "method": name,
                            "r_over_length": place,
                            "inferred_over_true": at / r,
                            "bias_in_jnd": (at - r) / jnd(name, r),
                            "slope": (high - low) / (2 * NUDGE * r),
                        }
                    )
    return pd.DataFrame(rows)


@plots.styled
def draw(table: pd.DataFrame) -> Any:
    """Biases above, slopes below; a column for each factor."""
    figure = plots.new_figure(plots.DOUBLE, 4.6)
    axes = figure.subplots(2, len(FACTORS), sharex="col", sharey="row")
    colours = dict(zip(METHODS, ("#0072B2", "#009E73", "#D55E00", "#CC79A7"), strict=True))
    for factor, (above, below) in zip(FACTORS, axes.T, strict=True):
        mine = table[table["factor"] == factor.name]
        for (name, place), rows in mine.groupby(["method", "r_over_length"], sort=False):
            style = {"color": colours[name], "linestyle": "-" if place == DISTANCES[0] else "--"}
            label = f"{name}, r = {place:g} L"
            above.plot(rows["amount"], rows["bias_in_jnd"], label=label, **style)
            below.plot(rows["amount"], rows["slope"], **style)
        above.axhspan(-1, 1, color="0.9", zorder=0, label="within a JND")
        below.axhline(1, color="0.7", linewidth=0.8, zorder=0)
        below.axhline(0, color="black", linewidth=0.8, zorder=0)
        above.set_title(factor.name)
        below.set_xlabel(factor.unit)
    axes[0, 0].set_ylabel("bias of r / JND at k = 0.1")
    axes[1, 0].set_ylabel("d(inferred r)/d(true r)")
    axes[1, 0].set_ylim(-0.5, 2)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=4)
    return figure


def make(folder: Path, *, short: bool = False) -> pd.DataFrame:
    """Write the table and the figure into `folder`; returns the table."""
    table = measure(3 if short else 25)
    folder.mkdir(parents=True, exist_ok=True)
    table.to_csv(folder / "limits.csv", index=False, float_format="%.4g")
    draw(table).savefig(folder / "limits.png")
    return table


if __name__ == "__main__":
    given = options(__file__, __doc__, folder=ANALYSES / "figures", short="three amounts, seconds")
    make(given.folder, short=given.short)
    print(f"Written to {given.folder}.")
