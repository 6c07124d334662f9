"""Contours recovered along a sweep from moment and push angle alone (§2g), and how they drift.

    python analyses/sweeps.py [folder] [--short]

A whisker is pushed against a peg and a cylinder; its moment is felt with Weber
noise. Writes sweeps (PNG, SVG): the true path of the contact beside the filter's, with two sds; and
sweeps.csv: over many noisy sweeps, the r.m.s. error of r of the iterative update and of the filter
as the push goes on, and the sd that the filter claims.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from command import options
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import weberwhisk as ww
from weberwhisk import plots
from weberwhisk._util.output import Run
from weberwhisk.mechanics.objects import Sweep, cylinder, peg, sweep
from weberwhisk.mechanics.touch import Body
from weberwhisk.receptors import Weber
from weberwhisk.sweeping import SweepFilter, Track, follow

WHISKER = ww.Whisker(length=50e-3, base_radius=100e-6, tip_radius=5e-6, youngs_modulus=3e9)
K = 0.1
PUSH = np.radians(np.arange(1.0, 31.0))
SEED = 20110166
DRAWS, DRAWS_SHORT = 40, 3
BODIES = {
    "peg": peg(30e-3, 0.0),
    "cylinder": cylinder(25e-3, -8e-3, 6e-3),
}


def touched(name: str) -> Sweep:
    """The sweep against a body from just before first contact on."""
    first = sweep(WHISKER, BODIES[name], np.radians([-1.0, 30.0])).first_contact
    return sweep(WHISKER, BODIES[name], np.concatenate([[first - 0.01], first + PUSH]))


def tracks(sweep_of: Sweep, draws: int) -> list[tuple[Track, Track]]:
    """The update's and the filter's track of noisy sweeps."""
    moment = sweep_of.bending.moment[1:, None]
    out = []
    for seed in np.random.SeedSequence(SEED).spawn(draws):
        reading_seed, filter_seed = seed.spawn(2)
        felt = Weber(K).sample(moment, reading_seed)[:, 0]
        out.append((follow(WHISKER, PUSH, felt),
                    SweepFilter(WHISKER, Weber(K))(PUSH, felt, seed=filter_seed)))  # fmt: skip
    return out


def drift(name: str, sweep_of: Sweep, found: list[tuple[Track, Track]]) -> pd.DataFrame:
    """R.m.s. errors of r (m) by push angle; the share of updates that have lost the contact."""
    r = sweep_of.bending.radial_distance[1:]
    update, filtered = (np.array([pair[i].radial_distance for pair in found]) for i in (0, 1))
    lost = np.isnan(update)
    off = np.where(lost, 0.0, update - r)
    return pd.DataFrame(
        {
            "object": name,
            "push_degrees": np.degrees(PUSH),
            "radial_distance": r,
            "update_rms": np.sqrt((off**2).sum(axis=0) / np.maximum((~lost).sum(axis=0), 1)),
            "update_lost": lost.mean(axis=0),
            "filter_rms": np.sqrt(np.nanmean((filtered - r) ** 2, axis=0)),
            "filter_sd": np.sqrt(np.nanmean([p[1].distance_sd ** 2 for p in found], axis=0)),
        }
    )


@plots.styled
def draw(sweeps: dict[str, Sweep], found: dict[str, list[tuple[Track, Track]]]) -> Figure:
    """True and recovered paths, a panel a body, in the frame of the whisker at first contact."""
    figure = plots.new_figure(plots.DOUBLE, 2.8)
    for ax, (name, s) in zip(figure.subplots(1, len(sweeps)), sweeps.items(), strict=True):
        b = s.bending
        angle = b.deflection_angle[1:] - PUSH
        x, y = (1e3 * b.radial_distance[1:] * f(angle) for f in (np.cos, np.sin))
        track = found[name][0][1]
        centre, sd = 1e3 * track.path, 1e3 * track.path_sd
        ax.errorbar(*centre.T, xerr=2 * sd[:, 0], yerr=2 * sd[:, 1], fmt=".", linewidth=0.5,
                    color=plots.COLOURS[1], alpha=0.5, label="filter ± 2 sd")  # fmt: skip
        ax.plot(x, y, "o-", markersize=2, color="black", zorder=3, label="contact")
        _object(ax, BODIES[name], float(s.first_contact))
        ax.set(title=name, xlabel="x (mm)")
    figure.axes[0].set_ylabel("y (mm)")
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


def _object(ax: Axes, body: Body, first: float) -> None:
    """The part of a body that is in sight, turned as the whisker was at first contact."""
    x, y = np.meshgrid(*(np.linspace(*ends, 200) for ends in (ax.get_xlim(), ax.get_ylim())))
    world = 1e-3 * np.array([np.cos(first) * x + np.sin(first) * y,
                             np.cos(first) * y - np.sin(first) * x])  # fmt: skip
    depth = body.depth(*world)
    if (depth > 0).any():
        ax.contourf(x, y, depth, [0, np.inf], colors="0.85", zorder=0)
    else:  # a peg is a point
        ax.plot(*(1e3 * abs(body.corners[0])), "o", markersize=14, color="0.7", zorder=0)
    ax.fill([], [], color="0.85", label="object")


def make(folder: Path, *, short: bool = False) -> pd.DataFrame:
    """Table and figure into `folder`."""
    draws = DRAWS_SHORT if short else DRAWS
    with Run(folder, "sweeps", {"weber_fraction": K, "draws": draws}, SEED) as run:
        sweeps = {name: touched(name) for name in BODIES}
        found = {name: tracks(s, draws) for name, s in sweeps.items()}
        table = pd.concat(
            [drift(name, s, found[name]) for name, s in sweeps.items()], ignore_index=True
        )
        run.table("sweeps", table)
        run.figure("sweeps", draw(sweeps, found))
    return table


if __name__ == "__main__":
    given = options(__file__, __doc__, short="few sweeps, seconds")
    made = make(given.folder, short=given.short)
    print(made.iloc[4::10].to_string(index=False, float_format="{:.4g}".format))
    print(f"Written to {given.folder}.")
