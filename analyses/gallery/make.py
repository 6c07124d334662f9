"""Charts of what every cue tells of distance, each with its table.

    python analyses/gallery/make.py [folder] [--only NAME] [--short]

Of one whisker 50 mm long with radii of 100 and 5 µm; k = 0.1 throughout. All charts take some
minutes; `--only` makes those that are named, and may be said again:
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

sys.path.insert(0, str(Path(__file__).parent.parent))

from command import options
from gallery import along_plots, along_whisk, array_maps, plots, surveys

import weberwhisk as ww
from weberwhisk._util.output import Run
from weberwhisk.behaviour import (
    CueEncoding,
    Encoding,
    PooledEncoding,
    response_probability,
    task_named,
)
from weberwhisk.design import Hypothesis, Scheme, taper
from weberwhisk.inference import default_noise

W = surveys.WHISKER
LEVELS = (-2.0, -1.2, -0.6, 0.6, 1.2, 2.0)  # sds of the expected difference


class Made(NamedTuple):
    """A chart, and the tables behind it by name."""

    tables: dict[str, pd.DataFrame]
    chart: Any


class Asked(NamedTuple):
    """How much of a chart is made."""

    short: bool = False
    seed: int = surveys.SEED

    def readings(self, times: int = 1) -> int:
        """Posteriors at each distance, few where it is to be quick."""
        return 16 if self.short else 200 * times


def _made(name: str, table: pd.DataFrame, chart: Any) -> Made:
    return Made({name: table}, chart)


def cues(asked: Asked) -> Made:
    """JND of each cue against distance, posteriors over closed forms, where each works"""
    table = surveys.curves(8 if asked.short else 30, asked.readings(), seed=asked.seed)
    return _made("cues", table, plots.cue_jnds(table))


def outcomes(asked: Asked) -> Made:
    """where each cue finds a distance, and what fails elsewhere or by chance"""
    table = surveys.outcomes(25 if asked.short else 100, asked.readings(2), seed=asked.seed)
    return _made("outcomes", table, plots.cue_outcomes(table))


def best_cue(asked: Asked) -> Made:
    """the best cue at every contact, over distance and deflection"""
    table = surveys.best(40 if asked.short else 90)
    return _made("best-cue", table, plots.best_cue(table, surveys.MAPPED))


def ridge(asked: Asked) -> Made:
    """pair plot of the posterior of one reading: a taper's, and a cylinder's ridge"""
    table = surveys.ridge(400 if asked.short else 8000, seed=asked.seed)
    contact = surveys.RIDGE[0] * W.length, surveys.RIDGE[1]
    return _made("ridge", table, plots.ridge(table, contact))


def information(asked: Asked) -> Made:
    """bits about distance that each cue tells alone and adds to the others"""
    table = surveys.bits(40 if asked.short else 400, seed=asked.seed)
    return _made("information", table, plots.cue_information(table))


def weber_2d(asked: Asked) -> Made:
    """Weber's law in two dimensions: either limit, between them, and the false zero"""
    surfaces = {
        name: surveys.surface(*noise, 40 if asked.short else 80)
        for name, noise in surveys.FAMILY.items()
    }
    zero = surveys.false_zero(asked.readings(), seed=asked.seed)
    between = surveys.linear_between()
    chart = plots.weber_2d(surfaces, zero, between, length=W.length, weber_fraction=surveys.K)
    return Made({"weber-2d": zero, "weber-2d-gain": surveys.gain()}, chart)


def figure_4a(asked: Asked) -> Made:
    """the paper's figure 4a: JND by compliance, tapered and cylindrical, with posteriors"""
    places, found = np.linspace(0.05, 0.95, 10) * W.length, {}
    for name, whisker in (("tapered", W), ("cylinder", W.cylinder())):
        observer = ww.Observer(whisker, ww.cues.Compliance(), ww.receptors.Weber(surveys.K))
        how: Any = {"method": "emcee", "n_readings": asked.readings(2), "seed": asked.seed}
        found[name] = ww.jnd_curve(observer, places, **how)
    drawn = ww.plots.jnd_lines(found, length=W.length, weber_fraction=surveys.K)
    tables = {name: curve.table for name, curve in found.items()}
    return _made("figure-4a", pd.concat(tables, names=["whisker"]).reset_index(), drawn)


def figure_4b(asked: Asked) -> Made:
    """the paper's figure 4b: JND by the force map, with noise in the moment alone"""
    table = surveys.surface(surveys.K, surveys.NONE)
    drawn = ww.plots.jnd_surface(table, length=W.length, weber_fraction=surveys.K)
    return _made("figure-4b", table, drawn)


def jnd_surface(asked: Asked) -> Made:
    """figure 4b's surface by full posteriors, with noise in both signals (10 s)"""
    points, draws = 10 if asked.short else 30, min(asked.readings(), 100)
    table = surveys.posterior_surface(points, draws, seed=asked.seed)
    drawn = ww.plots.jnd_surface(table, length=W.length, weber_fraction=surveys.K)
    return _made("jnd-surface", table, drawn)


def curvature(asked: Asked) -> Made:
    """JND of curved and rubbing whiskers, and what taking the rat's as straight costs"""
    points, draws = 5 if asked.short else 13, min(asked.readings(), 12)
    jnds = surveys.curvatures(points, draws, seed=asked.seed)
    biases = surveys.taken_as_straight("C" if asked.short else "ABCDE")
    drawn = plots.curvature(jnds, biases)
    return Made({"curvature": jnds, "curvature-ignored": biases}, drawn)


def along_push(asked: Asked) -> Made:
    """JND of distance against push, for pegs, cylinders and a wall: it depends on slip (§3c)"""
    push = np.radians(np.arange(2.0, 31.0, 7.0 if asked.short else 0.5))
    table = along_whisk.resolution_along_push(W, 0.5 * W.length, push)
    return _made("along-push", table, along_plots.along_push(table))


def lateral_sweep(asked: Asked) -> Made:
    """the distance of a peg and of a cylinder, followed along a sweep by the moment (§2g)"""
    push = np.radians(np.arange(1.0, 31.0, 5.0 if asked.short else 1.0))
    middle = 0.5 * W.length
    draws = 3 if asked.short else 20
    table = along_whisk.lateral_sweep(W, middle, push, n_sweeps=draws, seed=asked.seed)
    return _made("lateral-sweep", table, along_plots.lateral_sweep(table))


def touches(asked: Asked) -> Made:
    """JND of distance against the number of touches, beside 1/√n and what mice do (§4)"""
    # Of a mouse, as what it is beside.
    whisker, tables = ww.Whisker.from_identity("C2", species="mouse"), []
    known = ww.cues.ForceMap()
    for k, cue in ((0.3, known), (0.1, known), (0.1, ww.cues.UnknownStiffness(known))):
        observer = ww.Observer(whisker, cue, default_noise(whisker, cue, k))
        r = 0.6 * whisker.length
        # As likely anywhere in the range, as the prior.
        angle = observer.space.angle_range(np.array([r]))[1]
        name = f"k = {k:g}" if cue is known else "the same, stiffness unknown"
        table = ww.sensitivity.touches_jnd(
            observer,
            r,
            angle * np.array([0.45, 0.15, 0.75, 0.25, 0.55, 0.95, 0.05, 0.35, 0.65, 0.85]),
            (1, 4, 17) if asked.short else (1, 2, 3, 5, 8, 12, 17, 30, 50),
            n_readings=asked.readings() if cue is known else min(asked.readings(), 20),
            seed=asked.seed,
        )
        tables.append(table.assign(receptors=name))
    joined = pd.concat(tables, ignore_index=True)
    return _made("touches", joined, along_plots.touches(joined))


def behaviour(asked: Asked) -> Made:
    """choices and power with curved whiskers, several touches or whiskers, at a pole (minutes)"""
    choices, powers = _choices(asked), _powers(asked)
    drawn = plots.decisions(choices, powers)
    return Made({"behaviour": choices, "behaviour-power": powers}, drawn)


def _two() -> tuple[ww.Whisker, ww.Whisker]:
    """A whisker that is touched on its concave side, and a smaller one whose base is as far off."""
    bowed = replace(W, curvature=-0.6 / W.length)
    sizes = {name: 0.7 * getattr(W, name) for name in ("length", "base_radius", "tip_radius")}
    return bowed, replace(bowed, **sizes)


def _choices(asked: Asked) -> pd.DataFrame:
    """Shares of answers about a pole and one at 0.4 of the length, by moment and axial force."""
    bowed, smaller = _two()
    convex = replace(W, curvature=0.6 / W.length)
    straight, concave, other, far = (
        CueEncoding(ww.Observer(w, ww.cues.ForceMap()), surveys.ANGLE)
        for w in (W, bowed, smaller, convex)
    )
    decisions: dict[str, tuple[Encoding, str]] = {
        "straight": (straight, "2AFC"),
        "concave side": (concave, "2AFC"),
        "convex side": (far, "2AFC"),
        "concave, 5 touches": (PooledEncoding((concave,) * 5), "2AFC"),
        "concave, 2 whiskers": (PooledEncoding((concave, other)), "2AFC"),
        "concave, go/no-go": (concave, "go/no-go"),
    }
    standard = 0.4 * W.length
    r, tables = standard * np.linspace(0.7, 1.3, 13 if asked.short else 61), []
    for name, (encoding, task) in decisions.items():
        chance = response_probability(
            task_named(task), encoding, standard + 0 * r, r, weber_fraction=surveys.K
        )
        right = np.where(r < standard, 1 - chance, chance)
        tables.append(
            pd.DataFrame(
                {"decision": name, "task": task, "standard_mm": 1e3 * standard,
                 "radial_distance_mm": 1e3 * r, "farther": chance, "correct": right}
            )
        )  # fmt: skip
    return pd.concat(tables, ignore_index=True)


def _powers(asked: Asked) -> pd.DataFrame:
    """How often each question is decided, by taps on a pole, by trials of each comparison."""
    bowed, smaller = _two()
    one, other = (CueEncoding(ww.Observer(w, ww.cues.Compliance())) for w in (bowed, smaller))
    questions = {"taper, straight": taper(W), "taper, concave": taper(bowed)}
    for task in ("2AFC", "go/no-go"):
        questions[f"one whisker or two, {task}"] = (
            Hypothesis("one whisker", one, task=task),
            Hypothesis("two whiskers", PooledEncoding((one, other)), task=task),
        )
    trials = (10, 40) if asked.short else (10, 20, 40, 80, 160, 320)
    tables = []
    for name, hypotheses in questions.items():
        # Of the two whiskers both reach the nearer pole, one the farther.
        at = np.array([0.3, 0.8]) * W.length
        scheme = Scheme.spaced(hypotheses[0].encoding, at, weber_fraction=surveys.K, levels=LEVELS)
        runs = 16 if asked.short else 256
        found = ww.power(scheme, hypotheses, trials=trials, runs=runs, seed=asked.seed)
        tables.append(found.table.assign(question=name, goal=found.goal.share))
    return pd.concat(tables, ignore_index=True)


def jnd_limits(asked: Asked) -> Made:
    """limits of torque, threshold and saturation on one JND curve (§3b)"""
    places = np.linspace(0.04, 0.98, 25 if asked.short else 190) * W.length
    table = along_whisk.limits(W, places)
    drawn = along_plots.jnd_limits(table, W.length)
    return _made("jnd-limits", table, drawn)


def reversal(asked: Asked) -> Made:
    """objects pressed and let go with friction, by a base that turns and one that translates"""
    push = np.radians(np.linspace(2.0, 25.0, 4 if asked.short else 47))
    table = along_whisk.reversal(W, 0.5 * W.length, push)
    return _made("reversal", table, along_plots.reversal(table))


def whisking_speed(asked: Asked) -> Made:
    """up to which whisking frequency quasi-static mechanics hold, along the whisker"""
    places = np.linspace(0.05, 0.99, 9 if asked.short else 95) * W.length
    table = along_whisk.speed(W, places)
    drawn = along_plots.whisking_speed(table, W.length)
    return _made("whisking-speed", table, drawn)


def array_resolution(asked: Asked) -> Made:
    """how well the rat's whiskers (rows C to E) resolve a pole's place, over all places"""
    array = _level_array()
    step = 2e-3 if asked.short else 0.4e-3
    x, y = np.arange(4e-3, 58e-3, step), np.arange(-24e-3, 14e-3, step)
    table = array_maps.array_resolution(ww.ArrayObserver(array), x, y)
    return _made("array-resolution", table, along_plots.array_map(table, array))


def array_counts(asked: Asked) -> Made:
    """apertures discriminated by the number of whiskers left intact, by an ideal observer"""
    array, tables = _level_array(), []
    places = np.linspace(-10e-3, 10e-3, 11 if asked.short else 41)
    for k, degrees in ((0.1, 1.0), (0.3, 3.0), (0.6, 6.0)):
        noise = ww.receptors.Weber(k)
        observer = ww.ArrayObserver(array, noise=noise, angle_sd=np.radians(degrees))
        table = array_maps.array_by_count(observer, 25e-3, places, range(1, 21), seed=asked.seed)
        tables.append(table.assign(receptors=f"k = {k:g}, azimuths ± {degrees:g}°"))
    joined = pd.concat(tables, ignore_index=True)
    return _made("array-counts", joined, along_plots.array_counts(joined))


def _level_array() -> ww.WhiskerArray:
    """The rows of a rat's right side that stay within 30° of the horizontal."""
    array = ww.WhiskerArray("rat", "right")
    level = [name for name in array.identities if name[0] in "CDE"]
    return array.only(level).protract(np.radians(40.0))


#: The charts by name.
CHARTS: dict[str, Callable[[Asked], Made]] = {
    chart.__name__.replace("_", "-"): chart
    for chart in (
        cues, outcomes, best_cue, ridge, information, figure_4a, figure_4b, jnd_surface, weber_2d,
        curvature, along_push, lateral_sweep, touches, behaviour, jnd_limits, reversal,
        whisking_speed, array_resolution, array_counts,
    )
}  # fmt: skip


def make(folder: Path, names: list[str], *, short: bool = False) -> None:
    """Tables and figures into `folder`, with a record of each."""
    for name in names:
        with Run(folder, name, {"short": short}, surveys.SEED) as run:
            made = CHARTS[name](Asked(short))
            for key, table in made.tables.items():
                run.table(key, table)
            run.figure(name, made.chart)


if __name__ == "__main__":
    listed = "".join(f"\n    {name:16} {chart.__doc__}" for name, chart in CHARTS.items())
    given = options(__file__, __doc__ + listed, short="few posteriors", parts=tuple(CHARTS))
    make(given.folder, given.only or list(CHARTS), short=given.short)
    print(f"Written to {given.folder}.")
