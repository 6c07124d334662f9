"""Draw which model of bending each contact needs, for a straight and for a curved whisker.

    python analyses/which_model.py [folder] [--short]

Writes which_model.png into the folder, by default analyses/figures, and prints what share of the
contacts held each model serves. A model serves where it shifts the radial distance that is inferred
from the moment (at a known deflection angle) by less than a tenth of its JND.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from command import ANALYSES, options
from matplotlib.colors import ListedColormap
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

import weberwhisk as ww
from weberwhisk import plots

LENGTH = 50e-3
STRAIGHT = ww.Whisker(LENGTH, base_radius=100e-6, tip_radius=5e-6, youngs_modulus=3e9)
#: y = a·x² with the tip some 0.2 L off the base tangent.
CURVED = ww.mechanics.Profile.of(STRAIGHT).curved(ww.mechanics.Parabola(4.0))
WEBER_FRACTIONS = (0.03, 0.1, 0.3)
TOLERANCE = 0.1
#: Contacts along each axis, and distances at which the end of contact is found.
POINTS, POINTS_SHORT, ENDS, ENDS_SHORT = 240, 28, 80, 12
HIGHEST = np.radians(75.0)

#: From light to dark as the models get dearer, told apart by the colour-blind and in grey.
COLOURS = ("#F0E442", "#9AD0F0", "#0072B2", "#303030")
NAMES = ("closed form", "elastica", "planar beam", "rod")


@dataclass(frozen=True)
class Case:
    """A whisker, its name, and the roll of its curvature against the plane of the push."""

    name: str
    whisker: Any
    roll: float


CASES = (
    Case("straight", STRAIGHT, 0.0),
    Case("curved, y = ax², aL = 0.2", CURVED, 0.0),
    Case("the same, rolled by 60°", CURVED, np.radians(60.0)),
)


def first_touch(case: Case, r: Any) -> Any:
    """Deflection angle at which the resting whisker has the distance r."""
    rest = ww.mechanics.rest_angle(case.whisker, r)
    return np.arctan2(np.sin(rest) * np.cos(case.roll), np.cos(rest))


def end_of_contact(case: Case, r: Any, side: float) -> tuple[Any, Any]:
    """Last deflection angle and what ends contact there; rolled, of the projected whisker."""
    if case.whisker is STRAIGHT:
        end = ww.flick_past(STRAIGHT, r, side=side)
        return end.deflection_angle, end.ended_by
    law = ww.mechanics.Parabola(case.whisker.law.coefficient * np.cos(case.roll))
    flat = case.whisker.curved(law)
    end = ww.flick_past(flat, r, side=side)
    push = end.deflection_angle - ww.mechanics.rest_angle(flat, r)
    return first_touch(case, r) + push, end.ended_by


def models(case: Case, r: Any, theta: Any, weber_fraction: float) -> Any:
    """The model that each contact needs."""
    choice = ww.choose_model(
        case.whisker,
        r,
        theta,
        roll=case.roll,
        weber_fraction=weber_fraction,
        tolerance=TOLERANCE,
    )
    return choice.model


@plots.styled
def draw(points: int, ends: int) -> tuple[Any, pd.DataFrame]:
    """The figure, and the share of the held contacts drawn that each model serves."""
    figure = plots.new_figure(plots.DOUBLE, 6.4)
    axes = figure.subplots(len(CASES), len(WEBER_FRACTIONS), sharex=True, sharey=True)
    shares = []
    # Closer together towards the tip, where the end of contact changes from fold to tip.
    at = np.sin(np.linspace(0.02, np.pi / 2, ends)) * LENGTH
    r, theta = np.linspace(0.01, 0.995, points) * LENGTH, np.linspace(-HIGHEST, HIGHEST, points)
    places, angles = np.meshgrid(r, theta)
    for row, case in zip(axes, CASES, strict=True):
        reached = np.isfinite(first_touch(case, at))
        at = at[reached]
        limits = [end_of_contact(case, at, side) for side in (-1.0, 1.0)]
        low, high = (np.interp(places, at, angle) for angle, _ in limits)
        held = (angles > low) & (angles < high) & (places <= at[-1])
        for ax, k in zip(row, WEBER_FRACTIONS, strict=True):
            needed = models(case, places[held], angles[held], k)
            shown = np.full(held.shape, np.nan)
            shown[held] = needed
            ax.pcolormesh(
                r / LENGTH,
                np.degrees(theta),
                shown,
                cmap=ListedColormap(COLOURS),
                vmin=-0.5,
                vmax=3.5,
                rasterized=True,
            )
            for angle, why in limits:
                tip = why == ww.Outcome.SLIPPED_OFF_TIP
                for mine, style in ((~tip, "-"), (tip | _beside(tip), ":")):
                    line = np.where(mine, np.degrees(angle), np.nan)
                    ax.plot(at / LENGTH, line, style, color="#D55E00", linewidth=1.8)
            ax.plot(
                at / LENGTH, np.degrees(first_touch(case, at)), "--", color="black", linewidth=0.8
            )
            count = (float(np.mean(needed == model)) for model in ww.mechanics.Model)
            shares.append(
                {"whisker": case.name, "weber_fraction": k} | dict(zip(NAMES, count, strict=True))
            )
        row[0].set_ylabel("Deflection angle θ$_d$ (degrees)")
        row[-1].annotate(
            case.name, (1.04, 0.5), xycoords="axes fraction", rotation=-90, va="center"
        )
    _label(axes)
    return figure, pd.DataFrame(shares)


def _beside(mask: Any) -> Any:
    """The places before the first of a run: where one kind of end passes into the other."""
    return np.append(mask[1:], False)


def _label(axes: Any) -> None:
    """Legend and axes."""
    ax = axes[0, 0]
    ax.set_xlim(0, 1)
    ax.set_ylim(-np.degrees(HIGHEST), np.degrees(HIGHEST))
    for above, k in zip(axes[0], WEBER_FRACTIONS, strict=True):
        above.set_title(f"k = {k:g}")
        above.annotate("flicked past", (0.97, 0.93), xycoords="axes fraction", ha="right")
    for below in axes[-1]:
        below.set_xlabel("Radial distance r/L")
    patches = [Patch(facecolor=c, label=n) for c, n in zip(COLOURS, NAMES, strict=True)]
    lines = [
        Line2D([], [], color=colour, linestyle=style, label=label)
        for colour, style, label in (
            ("#D55E00", "-", "fold: flicks past"),
            ("#D55E00", ":", "tip: slips off (last 2 %)"),
            ("black", "--", "first touch"),
        )
    ]
    figure = plots.figure_of(ax)
    figure.legend(handles=patches + lines, loc="outside upper center", ncols=4)


def make(folder: Path, *, short: bool = False) -> pd.DataFrame:
    """Write the figure into `folder`; returns the shares."""
    figure, shares = draw(*((POINTS_SHORT, ENDS_SHORT) if short else (POINTS, ENDS)))
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / "which_model.png")
    return shares


if __name__ == "__main__":
    given = options(__file__, __doc__, folder=ANALYSES / "figures", short="a coarse grid, seconds")
    print(make(given.folder, short=given.short).round(3).to_string(index=False))
    print(f"Written to {given.folder}.")
