"""Which model does a scene need? Cost and error of the models of bending over natural sweeps.

    python analyses/scene_costs.py [folder] [--short]

A whisk is taken to be a sinusoid of ±22.5° about rest at 8 Hz, the slow end of the 8 to 25 Hz of
§1, quasi-static: the frequency weighs nothing. Objects are met 15° before rest, at rest, or 15°
after it, and contact lasts to the end of protraction or of the contact, whichever is first; it is
sampled at even times, so that each angle weighs as much as the time spent there. Pegs and
cylinders are met at three places along the whisker, walls by the tip at three angles; rolled
whiskers meet pegs alone.

A model's error is what it does to the radial distance inferred from the moment at a known angle,
in JNDs, measured against the lowest model that has all there is. The ladder takes in each scene
the cheapest within 0.1 by its own estimates (`choose_model`). Writes into the folder, by default
analyses/figures, scene_costs.csv (the ladder: a row for each kind of whisker, object and Weber
fraction), scene_costs_models.csv (every model used throughout, and the choice: the map's points)
and scene_costs.png. Times are CPU seconds a contact in bulk, measured in the same run.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np
import pandas as pd
from command import ANALYSES, machine, options
from matplotlib.patches import Patch
from speed_accuracy.beams import timed

import weberwhisk as ww
from weberwhisk import plots
from weberwhisk.mechanics import Choice
from weberwhisk.mechanics.ladder import press_by
from weberwhisk.plots.style import SMALL

Array = np.ndarray
#: Long, middling and short whiskers of the rat (Belli et al. 2017).
IDENTITIES = ("A1", "C2", "D4")
WEBER_FRACTIONS = (0.03, 0.1, 0.3)
TOLERANCE = 0.1
#: Of a whisk: amplitude, and where in it objects are met, rad.
AMPLITUDE, MET = np.radians(22.5), np.radians([-15.0, 0.0, 15.0])
#: Where pegs and cylinders are met, over the length; radius of cylinders over the length.
PLACES, ROUND = (0.3, 0.5, 0.7), 0.1
#: Between whisker and wall as the tip meets it, rad.
INCIDENCE = np.radians([20.0, 40.0, 60.0])
OBJECTS = ("peg", "cylinder", "wall")
#: By how many contacts of one whisker the cheaper models are timed, and the rod in the plane.
BULK, RODS = 300, 12
#: What errors of rounding are drawn as.
FLOOR = 1e-11

COLOURS = ("#F0E442", "#9AD0F0", "#0072B2", "#303030")
NAMES = ("closed form", "elastica", "planar beam", "rod")
LADDER = "the ladder"
KIND_COLOURS = ("#000000", "#CC79A7", "#0072B2", "#56B4E9", "#D55E00")


@dataclass(frozen=True)
class Kind:
    """What a whisker has that models may leave out: aL of y = ax², friction angle, roll, rad."""

    name: str
    bow: float = 0.0
    friction: float = 0.0
    roll: float = 0.0
    objects: tuple[str, ...] = OBJECTS

    def whisker(self, identity: str) -> Any:
        """The whisker of that identity, of this kind."""
        straight = ww.Whisker.from_identity(identity)
        if not self.bow:
            return straight
        return ww.mechanics.Profile.of(straight).curved(
            ww.mechanics.Parabola(self.bow / straight.length)
        )


KINDS = (
    Kind("straight"),
    Kind("straight, friction of −10°", friction=np.radians(-10.0)),
    Kind("curved, convex side", bow=0.2),
    # A whisker bent towards a wall touches it a second time within 3°.
    Kind("curved, concave side", bow=-0.2, objects=("peg", "cylinder")),
    Kind("curved, rolled by 60°", bow=0.2, roll=np.radians(60.0), objects=("peg",)),
)


@dataclass(frozen=True)
class Size:
    """Moments of a whisk's half, which whiskers, places and objects, and contacts to time by."""

    samples: int
    identities: tuple[str, ...]
    places: tuple[int, ...]
    objects: tuple[str, ...]
    bulk: int
    rods: int


FULL = Size(24, IDENTITIES, (0, 1, 2), OBJECTS, BULK, RODS)
SHORT = Size(4, ("C2",), (1,), ("peg",), 40, 1)


@dataclass(frozen=True)
class Contacts:
    """Contacts of one whisker (n,), each of as much time."""

    whisker: Any
    distance: Array
    angle: Array
    friction: Array
    roll: float

    def choose(self, k: float) -> Choice:
        """The model that each needs."""
        return ww.choose_model(
            self.whisker, self.distance, self.angle, self.friction, roll=self.roll,
            weber_fraction=k, tolerance=TOLERANCE,
        )  # fmt: skip

    def press(self, model: Any = None) -> ww.mechanics.Bending:
        """By a model; without one by the lowest that has all there is."""
        if model is not None:
            scene = self.whisker, self.distance, self.angle, self.friction, self.roll
            return press_by(*scene, model)
        return ww.press(self.whisker, self.distance, self.angle, self.friction, roll=self.roll)

    def moments(self, models: Array) -> Array:
        """Moments (n,), each by the model named of it; NaN where there is no contact."""
        out = np.full(models.size, np.nan)
        for model in np.unique(models):
            at = np.flatnonzero(models == model)
            out[at] = self._take(at).press(ww.mechanics.Model(int(model))).moment
        return out

    def bulk(self, rows: int) -> Contacts:
        """Repeated up to so many, as what a call costs by itself is no part of a contact's."""
        at = np.arange(max(rows, self.distance.size)) % self.distance.size
        return self._take(at)

    def some(self, most: int) -> Contacts:
        """At most so many, spread evenly."""
        n = self.distance.size
        at = np.linspace(0, n - 1, min(n, most)).round().astype(int)
        return self._take(at)

    def _take(self, at: Array) -> Contacts:
        return replace(
            self, distance=self.distance[at], angle=self.angle[at], friction=self.friction[at]
        )


def rotations(samples: int) -> Array:
    """Rotations since first contact at even times up to the end of protraction, ascending."""
    begin = np.arcsin(MET / AMPLITUDE)[:, None]
    # Even steps of time: an object met late has fewer.
    steps = np.arange(1, samples + 1) / samples * np.pi
    phase = begin + steps
    turned = AMPLITUDE * np.sin(phase) - MET[:, None]
    return np.unique(turned[phase <= np.pi / 2])


def body(kind: Kind, whisker: Any, name: str, at: int) -> ww.sweeping.Body:
    """The object, touched by the resting whisker at rotation 0."""
    length = (
        ww.mechanics.Profile.of(whisker).whisker.length if kind.bow == 0 else whisker.whisker.length
    )
    r = (1.0 if name == "wall" else PLACES[at]) * length
    if name == "wall" and kind.bow:
        # Where the curve ends: its tip lies nearer to the base than its length.
        low, high = 0.5 * length, length
        for _ in range(60):
            r = (low + high) / 2
            low, high = (r, high) if np.isfinite(ww.mechanics.rest_angle(whisker, r)) else (low, r)
        r = low
    rest = float(ww.mechanics.rest_angle(whisker, r))
    x, y = r * np.cos(rest), r * np.sin(rest)
    slope = np.arctan(2 * kind.bow / length * x)
    if name == "peg":
        return ww.sweeping.peg(x, y)
    if name == "wall":
        return ww.sweeping.wall(x, y, slope + INCIDENCE[at])
    radius = ROUND * length
    return ww.sweeping.cylinder(x + radius * np.sin(slope), y - radius * np.cos(slope), radius)


def contacts(kind: Kind, identity: str, name: str, size: Size) -> Contacts:
    """The contacts of a whisker with the objects of a name, over all places and whisks."""
    whisker, turned = kind.whisker(identity), rotations(size.samples)
    found = []
    for at in size.places:
        if kind.roll:  # a peg: distance and height stay, the azimuth turns
            r = PLACES[at] * whisker.whisker.length
            rest = float(ww.mechanics.rest_angle(whisker, r))
            first = np.arctan2(np.sin(rest) * np.cos(kind.roll), np.cos(rest))
            b = ww.press(whisker, r, first + turned, kind.friction, roll=kind.roll)
        else:
            angles = np.concatenate([[-0.02], turned])
            b = ww.sweeping.sweep(
                whisker, body(kind, whisker, name, at), angles, kind.friction
            ).bending
        held = np.asarray(b.held)
        # A force on the tip is normal to the object: what tilts it there is as good as friction.
        tilt = np.arctan2(b.axial_force, b.transverse_force) - b.contact_angle
        tilt = np.where(np.abs(tilt - kind.friction) < 1e-7, kind.friction, tilt)
        if kind.roll:
            tilt = np.full(held.shape, kind.friction)
        found.append(np.stack([b.radial_distance, b.deflection_angle, tilt])[:, held])
    r, theta, tilt = np.concatenate(found, axis=1)
    return Contacts(whisker, r, theta, tilt, kind.roll)


def bias(true: ww.mechanics.Bending, moment: Array, k: float) -> Array:
    """Bias of the inferred distance in JNDs; infinite where a model finds no contact."""
    return np.nan_to_num(np.abs(moment / true.moment - 1) / k, nan=np.inf)


def summary(off: Array) -> dict[str, float]:
    """Median, 95 % quantile and worst of the biases where contact is found, and the share lost."""
    found = off[np.isfinite(off)]
    quantiles = np.quantile(found, [0.5, 0.95, 1.0]) if found.size else np.full(3, np.nan)
    names = ("bias_median", "bias_95", "bias_worst")
    return dict(zip(names, quantiles.tolist(), strict=True)) | {"lost": 1 - found.size / off.size}


def used_throughout(
    group: Contacts, true: ww.mechanics.Bending, rung: ww.mechanics.Model, rods: int
) -> tuple[Array, float]:
    """Biases at k = 1 and seconds a contact of one model, whatever the scene."""
    # The rod is dear, and a check of the planar beam in the plane.
    part, exact = group, true
    if rung is ww.mechanics.Model.ROD and not group.roll:
        part = group.some(rods)
        exact = part.press()
    bent, seconds = timed(lambda: part.press(rung))
    return bias(exact, np.asarray(bent.moment), 1.0), seconds / part.distance.size


def measure(size: Size) -> tuple[pd.DataFrame, pd.DataFrame]:
    """The ladder's table, and that of each model used throughout beside the choice."""
    ladder, rungs = [], []
    for kind, name in product(KINDS, size.objects):
        if name not in kind.objects:
            continue
        met = [contacts(kind, identity, name, size) for identity in size.identities]
        groups = met if kind.roll else [group.bulk(size.bulk) for group in met]
        sizes = np.array([group.distance.size for group in groups])
        true, seconds = zip(*(timed(group.press) for group in groups), strict=True)
        complete = float(np.sum(seconds) / sizes.sum())
        fixed = {
            rung: [
                used_throughout(g, b, rung, size.rods) for g, b in zip(groups, true, strict=True)
            ]
            for rung in ww.mechanics.Model
        }
        for k in WEBER_FRACTIONS:
            here = {"whisker": kind.name, "object": name, "weber_fraction": k}
            for rung, found in fixed.items():
                off, cost = zip(*found, strict=True)
                told = {"model": NAMES[rung], "seconds": float(np.average(cost, weights=sizes))}
                rungs.append(here | told | summary(np.concatenate(off) / k))
            choices, choosing = zip(*(timed(partial(g.choose, k)) for g in groups), strict=True)
            felt, pressing = zip(
                *(timed(partial(g.moments, c.model)) for g, c in zip(groups, choices, strict=True)),
                strict=True,
            )
            off = np.concatenate([bias(t, f, k) for t, f in zip(true, felt, strict=True)])
            needed = np.concatenate([choice.model for choice in choices])
            cost = float(np.sum(pressing) / sizes.sum())
            choice_cost, saved = float(np.sum(choosing) / sizes.sum()), complete - cost
            rungs.append(here | {"model": LADDER, "seconds": cost} | summary(off))
            ladder.append(
                here
                | {"contacts": sum(group.distance.size for group in met)}
                | {
                    n: float(np.mean(needed == r))
                    for n, r in zip(NAMES, ww.mechanics.Model, strict=True)
                }
                | summary(off)
                | {
                    "seconds_choosing": choice_cost,
                    "seconds_chosen": cost,
                    "seconds_complete": complete,
                    "seconds_rod": rungs[-2]["seconds"],
                    "saved": saved / complete,
                    # A choice serves many contacts close to it, as a posterior's: how many pay it.
                    "uses_to_pay": choice_cost / saved if saved > 0 else np.inf,
                }
            )
    return pd.DataFrame(ladder), pd.DataFrame(rungs)


@plots.styled
def draw(ladder: pd.DataFrame, rungs: pd.DataFrame, foot: str = "") -> Any:
    """Shares of the time in contact by model; the map of cost and error; what choosing costs."""
    figure = plots.new_figure(plots.DOUBLE, 7.6)
    left, right = figure.subfigures(1, 2, width_ratios=(1.15, 1))
    _shares(left.subplots(), ladder)
    above, below = right.subplots(2, 1)
    _map(above, rungs)
    _times(below, ladder)
    figure.legend(
        handles=[Patch(facecolor=c, label=n) for c, n in zip(COLOURS, NAMES, strict=True)],
        loc="outside upper center",
        ncols=4,
    )
    figure.supxlabel(foot or machine(), fontsize=SMALL)
    return figure


def _shares(ax: Any, ladder: pd.DataFrame) -> None:
    """A bar for each row, Weber fractions together."""
    places, labels = [], []
    at = 0.0
    for (kind, name), rows in ladder.groupby(["whisker", "object"], sort=False):
        labels.append((at + len(rows) / 2 - 0.5, f"{kind}, {name}"))
        for _, row in rows.iterrows():
            places.append((at, row))
            at += 1
        at += 0.8
    for y, row in places:
        left = 0.0
        for colour, column in zip(COLOURS, NAMES, strict=True):
            ax.barh(y, row[column], left=left, color=colour, height=1.0, edgecolor="white", lw=0.3)
            left += row[column]
        ax.text(1.01, y, f"{row['weber_fraction']:g}", va="center", fontsize=SMALL)
    ax.set_yticks([y for y, _ in labels], [fill(text, 20) for _, text in labels])
    ax.tick_params(axis="y", length=0, labelsize=SMALL)
    ax.set(
        xlim=(0, 1),
        ylim=(at, -1),
        xlabel="Share of the time in contact",
        title="which model is needed (right: k)",
    )


def _map(ax: Any, rungs: pd.DataFrame) -> None:
    """Error against cost at k = 0.1: every model throughout, and the choice."""
    some = rungs[rungs["weber_fraction"] == 0.1]
    for name, rows in some.groupby("model", sort=False):
        own = name == LADDER
        ax.plot(
            rows["seconds"],
            np.maximum(rows["bias_95"], FLOOR),
            "*" if own else "o",
            color="#D55E00" if own else COLOURS[NAMES.index(str(name))],
            markeredgecolor="black",
            markeredgewidth=0.3,
            markersize=7 if own else 4,
            zorder=3 if own else 2,
            label="the model chosen" if own else None,
        )
    ax.axhline(TOLERANCE, color="black", linestyle="--", linewidth=0.8)
    ax.set(xscale="log", yscale="log", title="k = 0.1, a mark for each whisker and object")
    ax.set(xlabel="CPU time a contact, vectorised (s)", ylabel="Bias of r (JNDs), 95 % quantile")
    ax.legend(loc="center left")


def _times(ax: Any, ladder: pd.DataFrame) -> None:
    """How often a choice must be used before it has paid, against what it saves."""
    markers = dict(zip(WEBER_FRACTIONS, "os^", strict=True))
    for k, marker in markers.items():
        rows = ladder[ladder["weber_fraction"] == k]
        for kind, colour in zip(KINDS, KIND_COLOURS, strict=True):
            mine = rows[rows["whisker"] == kind.name]
            ax.plot(
                mine["seconds_complete"] / mine["seconds_chosen"],
                mine["seconds_choosing"] / mine["seconds_complete"],
                marker,
                color=colour,
                markersize=4,
                label=kind.name if k == WEBER_FRACTIONS[0] else None,
            )
    gain = np.geomspace(1.01, 100, 400)
    ax.plot(gain, 1 - 1 / gain, color="black", linewidth=0.8)
    ax.text(100, 0.25, "below the line: pays\nat the first use", ha="right", va="top")
    ax.axvline(1, color="0.6", linewidth=0.8)
    ax.set(xscale="log", yscale="log", ylabel="Choosing, in times of the complete model")
    ax.set_ylim(top=50)  # room for the names
    ax.set(xlabel="Times quicker once chosen")
    ax.set_title("colour: whisker; shape: k")
    shapes = [ax.plot([], [], m, color="0.5", markersize=4, label=f"k = {k:g}")[0]
              for k, m in markers.items()]  # fmt: skip
    ax.add_artist(ax.legend(handles=shapes, loc="lower right"))
    kinds = [h for h in ax.get_legend_handles_labels()[0] if h not in shapes]
    ax.legend(handles=kinds, loc="upper right")


def conclusions(ladder: pd.DataFrame, rungs: pd.DataFrame) -> list[str]:
    """Three sentences: which model which scene needs, where each fails, what more would cost.

    At k = 0.1. A model fails in a scene where it moves the distance by more than 0.1 JND in more
    than 5 % of the contact time.
    """
    at, models = ladder[ladder["weber_fraction"] == 0.1], rungs[rungs["weber_fraction"] == 0.1]
    shares = [
        f"{whisker}: " + ", ".join(f"{m} {s:.0%}" for m, s in own[list(NAMES)].mean().items() if s)
        for whisker, own in at.groupby("whisker", sort=False)
    ]
    bad = models[models["model"].isin(NAMES) & ~(models["bias_95"] <= TOLERANCE)]
    fails = []
    for name, own in bad.groupby("model", sort=False):
        whiskers = own["whisker"].unique()
        every = len(whiskers) == at["whisker"].nunique()
        fails.append(f"{name} with {'every whisker' if every else ' / '.join(whiskers)}")
    costs = [
        f"{whisker} {own['seconds_complete'].sum() / own['seconds_chosen'].sum():.1f} "
        f"(the rod {own['seconds_rod'].sum() / own['seconds_chosen'].sum():.0f})"
        for whisker, own in at.groupby("whisker", sort=False)
    ]
    return [
        f"Cheapest model within 0.1 JND, by share of the contact time: {'; '.join(shares)}.",
        f"Beyond 0.1 JND in more than 5 % of it: {'; '.join(fails) or 'none'}.",
        f"Times as dear a model that has all there is: {'; '.join(costs)}.",
    ]


def make(folder: Path, *, short: bool = False) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Write tables and figure into `folder`; returns the tables."""
    ladder, rungs = measure(SHORT if short else FULL)
    folder.mkdir(parents=True, exist_ok=True)
    ladder.to_csv(folder / "scene_costs.csv", index=False, float_format="%.4g")
    rungs.to_csv(folder / "scene_costs_models.csv", index=False, float_format="%.4g")
    draw(ladder, rungs).savefig(folder / "scene_costs.png")
    return ladder, rungs


if __name__ == "__main__":
    given = options(
        __file__, __doc__, folder=ANALYSES / "figures", short="one whisker, few moments, seconds"
    )
    tables = make(given.folder, short=given.short)
    print(*conclusions(*tables), sep="\n")
    print(tables[0].round(6).to_string(index=False))
    print(f"Written to {given.folder}.")
